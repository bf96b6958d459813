/** The picture: figures of points and links, or point clouds, over a ground grid, under a camera that can follow. */

import {
  AmbientLight,
  BufferAttribute,
  BufferGeometry,
  Color,
  CylinderGeometry,
  DirectionalLight,
  DynamicDrawUsage,
  GridHelper,
  Group,
  InstancedMesh,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  MeshLambertMaterial,
  PerspectiveCamera,
  Quaternion,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { Dots } from "./dots.ts";
import type { Frame } from "./frames.ts";
import type { Palette } from "./theme.ts";

const TRAIL_SECONDS = 2;
const UPWARDS = new Vector3(0, 1, 0);
/** Sides of a bone: the fewest that look round, since triangles are slow without a graphics card. */
const BONE_SIDES = 6;
/** Narrower pictures show the figure lower, by this share of their height. */
const NARROW_PX = 720;
const LOWERED = 0.08;

/** One motion as points and bones: positions are set once a frame. */
export class Figure {
  readonly group = new Group();
  private readonly dots: Dots;
  private readonly bones: InstancedMesh;
  private readonly trail: LineSegments;
  private readonly matrix = new Matrix4();
  private readonly colour = new Color();
  private readonly from = new Vector3();
  private readonly along = new Vector3();
  private readonly thickness = new Vector3();
  private readonly turn = new Quaternion();

  constructor(
    readonly links: [number, number][],
    private readonly size: number,
    isGhost: boolean,
  ) {
    this.dots = new Dots(isGhost ? 0.45 : 1, false);
    const material = new MeshLambertMaterial({ transparent: isGhost, opacity: isGhost ? 0.35 : 1, depthWrite: !isGhost });
    this.bones = new InstancedMesh(new CylinderGeometry(1, 1, 1, BONE_SIDES, 1, true), material, Math.max(1, links.length));
    this.bones.count = links.length;
    this.bones.frustumCulled = false;
    this.bones.renderOrder = isGhost ? 1 : 0;
    this.bones.instanceMatrix.setUsage(DynamicDrawUsage);
    for (let i = 0; i < links.length; i++) this.bones.setColorAt(i, this.colour.set(0xffffff));
    this.trail = new LineSegments(new BufferGeometry(), new LineBasicMaterial({ transparent: true, opacity: 0.8 }));
    this.trail.frustumCulled = false;
    this.trail.visible = false;
    this.group.add(this.bones, this.trail, this.dots.object);
  }

  /** Show a frame. colours: of the points (points · 3, 0 to 1). */
  show(frame: Frame, colours: Float32Array, selected: number): void {
    this.dots.show(frame.positions, colours, this.size, selected);
    this.links.forEach(([a, b], k) => this.showBone(k, a, b, frame.positions, colours));
    this.bones.instanceMatrix.needsUpdate = true;
    if (this.bones.instanceColor) this.bones.instanceColor.needsUpdate = true;
  }

  /** Place bone k between two points; with size 0 if one of them is missing. */
  private showBone(k: number, a: number, b: number, p: Float32Array, colours: Float32Array): void {
    this.from.set(p[3 * a], p[3 * a + 1], p[3 * a + 2]);
    this.along.set(p[3 * b], p[3 * b + 1], p[3 * b + 2]).sub(this.from);
    const length = this.along.length();
    if (!(length > 1e-9)) this.matrix.makeScale(0, 0, 0);
    else {
      this.from.addScaledVector(this.along, 0.5);
      this.turn.setFromUnitVectors(UPWARDS, this.along.divideScalar(length));
      this.matrix.compose(this.from, this.turn, this.thickness.set(0.42 * this.size, length, 0.42 * this.size));
    }
    this.bones.setMatrixAt(k, this.matrix);
    const [u, v] = [3 * a, 3 * b];
    this.colour.setRGB((colours[u] + colours[v]) / 2, (colours[u + 1] + colours[v + 1]) / 2, (colours[u + 2] + colours[v + 2]) / 2);
    this.bones.setColorAt(k, this.colour);
  }

  /** Show the path of points: segments (n · 6) between the positions of neighbouring frames. */
  showTrail(segments: Float32Array, colour: number): void {
    const isEmpty = segments.length === 0;
    if (isEmpty && !this.trail.visible) return;
    this.trail.visible = !isEmpty;
    this.trail.geometry.dispose();
    this.trail.geometry = new BufferGeometry().setAttribute("position", new BufferAttribute(segments, 3));
    (this.trail.material as LineBasicMaterial).color.set(colour);
  }

  dispose(): void {
    this.dots.dispose();
    for (const part of [this.bones, this.trail]) part.geometry.dispose();
  }
}

/** One sequence of point clouds. */
export class CloudFigure {
  readonly group = new Group();
  private readonly dots = new Dots(1, true);

  constructor(private readonly size: number) {
    this.group.add(this.dots.object);
  }

  show({ positions, colours }: Frame, neutral: Color): void {
    const hex = neutral.getHex();
    this.dots.showFlat(positions, colours?.length ? colours : [hex >> 16, (hex >> 8) & 255, hex & 255], this.size / 2);
  }

  dispose(): void {
    this.dots.dispose();
  }
}

export class Stage {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 0.01, 500);
  readonly controls: OrbitControls;
  private grid: GridHelper | null = null;
  private dirty = true;
  /** No graphics card: only stills have smooth edges, from twice the pixels. Multisampling costs a fifth of the frame rate. */
  private readonly isSoftware: boolean;
  private isMoving = false;

  constructor(
    readonly canvas: HTMLCanvasElement,
    onDraw: () => void,
  ) {
    this.isSoftware = drawsInSoftware();
    this.renderer = new WebGLRenderer({ canvas, antialias: !this.isSoftware, alpha: false });
    this.renderer.setPixelRatio(this.ratio);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.addEventListener("change", () => {
      this.dirty = true;
      onDraw();
    });
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, 5, 3);
    this.scene.add(new AmbientLight(0xffffff, 1.6), sun);
    new ResizeObserver(() => {
      this.resize();
      onDraw();
    }).observe(canvas.parentElement!);
    this.resize();
  }

  private get ratio(): number {
    return this.isSoftware ? (this.isMoving ? 1 : 2) : Math.min(2, devicePixelRatio);
  }

  /** Set whether the recording plays. */
  setMoving(isMoving: boolean): void {
    if (isMoving === this.isMoving) return;
    this.isMoving = isMoving;
    if (!this.isSoftware) return;
    document.documentElement.toggleAttribute("data-layers", isMoving); // used in style.css
    this.renderer.setPixelRatio(this.ratio);
    this.dirty = true;
  }

  /** Set the background to the colour of the page. */
  setBackground(colour: number): void {
    this.renderer.setClearColor(colour);
    this.dirty = true;
  }

  /** Draw the ground at a height, with lines one metre apart (or a tenth, or ten, for small and large recordings). */
  setGround(centre: Vector3, height: number, extent: number, palette: Palette): void {
    if (this.grid) {
      this.scene.remove(this.grid);
      this.grid.dispose();
    }
    const spacing = 10 ** Math.round(Math.log10(Math.max(1e-3, extent)) - 0.3);
    const lines = Math.min(60, 2 * Math.ceil(extent / spacing / 2 + 4));
    this.grid = new GridHelper(lines * spacing, lines, palette.gridStrong, palette.grid);
    this.grid.position.set(Math.round(centre.x / spacing) * spacing, height, Math.round(centre.z / spacing) * spacing);
    this.scene.add(this.grid);
    this.dirty = true;
  }

  /** Place the camera so that a box of this size around the centre fills the picture. */
  frame(centre: Vector3, size: number): void {
    const narrow = Math.max(1, 0.9 / this.camera.aspect);
    const distance = (0.62 * size * narrow) / Math.tan((this.camera.fov * Math.PI) / 360);
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).add(new Vector3(0.55, 0.28, 0.85).normalize().multiplyScalar(distance));
    this.camera.near = distance / 200;
    this.camera.far = distance * 60;
    this.camera.updateProjectionMatrix();
    this.controls.update();
  }

  /** Move camera and target together. */
  follow(target: Vector3): void {
    const move = target.clone().sub(this.controls.target);
    this.camera.position.add(move);
    this.controls.target.copy(target);
    this.dirty = true;
  }

  /** Pixel of the canvas at which a point of the scene is drawn. */
  project(position: Vector3): Vector2 {
    this.camera.updateMatrixWorld();
    const p = position.clone().project(this.camera);
    return new Vector2(((p.x + 1) / 2) * this.canvas.clientWidth, ((1 - p.y) / 2) * this.canvas.clientHeight);
  }

  /** The point of a frame nearest to the pixel (x, y), within 18 pixels; −1 for none. place: recording to scene. */
  pick(x: number, y: number, positions: Float32Array, place: (position: Vector3) => Vector3): number {
    let best = -1;
    let nearest = 18;
    const p = new Vector3();
    for (let i = 0; i < positions.length / 3; i++) {
      if (Number.isNaN(positions[3 * i])) continue;
      const at = this.project(place(p.set(positions[3 * i], positions[3 * i + 1], positions[3 * i + 2])));
      const distance = Math.hypot(at.x - x, at.y - y);
      if (distance < nearest) {
        nearest = distance;
        best = i;
      }
    }
    return best;
  }

  invalidate(): void {
    this.dirty = true;
  }

  draw(): void {
    if (!this.dirty) return;
    this.dirty = false;
    this.renderer.render(this.scene, this.camera);
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement!;
    this.renderer.setSize(Math.max(1, width), Math.max(1, height), false);
    this.camera.aspect = Math.max(1, width) / Math.max(1, height);
    // in a narrow picture the numbers are above the figure, in a wide one beside it
    if (width < NARROW_PX) this.camera.setViewOffset(width, height, 0, -LOWERED * height, width, height);
    else this.camera.clearViewOffset();
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

}

/** Whether the browser draws without a graphics card. */
function drawsInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  const name = gl ? String(gl.getParameter(gl.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl.RENDERER)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

/** Number of frames in a trail. */
export function trailFrames(rate: number): number {
  return Math.round(TRAIL_SECONDS * rate);
}
