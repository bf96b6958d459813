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
  Points,
  PointsMaterial,
  Quaternion,
  Scene,
  SphereGeometry,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import type { Frame } from "./frames.ts";
import type { Palette } from "./theme.ts";

const POINTS_AS_SPHERES = 2000;
const TRAIL_SECONDS = 2;
const UPWARDS = new Vector3(0, 1, 0);

/** One motion as spheres and lines: positions are set once a frame. */
export class Figure {
  readonly group = new Group();
  private spheres: InstancedMesh | null = null;
  private dots: Points | null = null;
  private bones: InstancedMesh;
  private trail: LineSegments;
  private readonly matrix = new Matrix4();
  private readonly colour = new Color();
  private readonly from = new Vector3();
  private readonly along = new Vector3();
  private readonly thickness = new Vector3();
  private readonly turn = new Quaternion();

  constructor(
    readonly points: number,
    readonly links: [number, number][],
    private size: number,
    isGhost: boolean,
  ) {
    if (points <= POINTS_AS_SPHERES) {
      const material = new MeshLambertMaterial({ transparent: isGhost, opacity: isGhost ? 0.45 : 1, depthWrite: !isGhost });
      this.spheres = new InstancedMesh(new SphereGeometry(1, 14, 10), material, Math.max(1, points));
      this.spheres.count = points;
      this.spheres.frustumCulled = false;
      this.spheres.instanceMatrix.setUsage(DynamicDrawUsage);
      for (let i = 0; i < points; i++) this.spheres.setColorAt(i, this.colour.set(0xffffff));
      this.group.add(this.spheres);
    } else {
      this.dots = new Points(dynamicGeometry(points), new PointsMaterial({ size: 2 * size, vertexColors: true }));
      this.dots.frustumCulled = false;
      this.group.add(this.dots);
    }
    const material = new MeshLambertMaterial({ transparent: isGhost, opacity: isGhost ? 0.35 : 1, depthWrite: !isGhost });
    this.bones = new InstancedMesh(new CylinderGeometry(1, 1, 1, 8, 1, true), material, Math.max(1, links.length));
    this.bones.count = links.length;
    this.bones.frustumCulled = false;
    this.bones.instanceMatrix.setUsage(DynamicDrawUsage);
    for (let i = 0; i < links.length; i++) this.bones.setColorAt(i, this.colour.set(0xffffff));
    this.trail = new LineSegments(dynamicGeometry(0), new LineBasicMaterial({ transparent: true, opacity: 0.8 }));
    this.trail.frustumCulled = false;
    this.group.add(this.bones, this.trail);
  }

  /** Show a frame; colours (points · 3, 0 to 1) of the points. */
  show(frame: Frame, colours: Float32Array, selected: number): void {
    const p = frame.positions;
    for (let i = 0; i < this.points; i++) {
      const isGap = Number.isNaN(p[3 * i]);
      const radius = isGap ? 0 : this.size * (i === selected ? 1.8 : 1);
      if (this.spheres) {
        this.matrix.makeScale(radius, radius, radius);
        this.matrix.setPosition(isGap ? 0 : p[3 * i], isGap ? 0 : p[3 * i + 1], isGap ? 0 : p[3 * i + 2]);
        this.spheres.setMatrixAt(i, this.matrix);
        this.spheres.setColorAt(i, this.colour.setRGB(colours[3 * i], colours[3 * i + 1], colours[3 * i + 2]));
      }
    }
    if (this.spheres) {
      this.spheres.instanceMatrix.needsUpdate = true;
      if (this.spheres.instanceColor) this.spheres.instanceColor.needsUpdate = true;
    }
    if (this.dots) {
      fill(this.dots.geometry, "position", p.map((value) => (Number.isNaN(value) ? 1e6 : value)));
      fill(this.dots.geometry, "color", colours);
    }
    this.links.forEach(([a, b], k) => this.showBone(k, a, b, p, colours));
    this.bones.instanceMatrix.needsUpdate = true;
    if (this.bones.instanceColor) this.bones.instanceColor.needsUpdate = true;
  }

  /** A cylinder between two points; of no size if one of them is missing. */
  private showBone(k: number, a: number, b: number, p: Float32Array, colours: Float32Array): void {
    this.from.set(p[3 * a], p[3 * a + 1], p[3 * a + 2]);
    this.along.set(p[3 * b], p[3 * b + 1], p[3 * b + 2]).sub(this.from);
    const length = this.along.length();
    if (!(length > 1e-9)) this.matrix.makeScale(0, 0, 0);
    else {
      this.turn.setFromUnitVectors(UPWARDS, this.along.clone().divideScalar(length));
      this.from.addScaledVector(this.along, 0.5);
      this.matrix.compose(this.from, this.turn, this.thickness.set(0.42 * this.size, length, 0.42 * this.size));
    }
    this.bones.setMatrixAt(k, this.matrix);
    const [u, v] = [3 * a, 3 * b];
    this.colour.setRGB((colours[u] + colours[v]) / 2, (colours[u + 1] + colours[v + 1]) / 2, (colours[u + 2] + colours[v + 2]) / 2);
    this.bones.setColorAt(k, this.colour);
  }

  /** Show the path of points: segments (n · 6) between the positions of neighbouring frames. */
  showTrail(segments: Float32Array, colour: number): void {
    this.trail.geometry.dispose();
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(segments, 3));
    this.trail.geometry = geometry;
    (this.trail.material as LineBasicMaterial).color.set(colour);
  }

  dispose(): void {
    for (const part of [this.spheres, this.dots, this.bones, this.trail]) part?.geometry.dispose();
  }

}

/** One sequence of point clouds. */
export class CloudFigure {
  readonly group = new Group();
  private dots: Points;

  constructor(size: number) {
    this.dots = new Points(new BufferGeometry(), new PointsMaterial({ size, vertexColors: true, sizeAttenuation: true }));
    this.dots.frustumCulled = false;
    this.group.add(this.dots);
  }

  show(frame: Frame, neutral: Color): void {
    const count = frame.positions.length / 3;
    const colours = new Float32Array(count * 3);
    const one = new Color();
    for (let i = 0; i < count; i++) {
      if (frame.colours?.length) {
        one.setRGB(frame.colours[3 * i] / 255, frame.colours[3 * i + 1] / 255, frame.colours[3 * i + 2] / 255, "srgb");
      } else one.copy(neutral);
      one.toArray(colours, 3 * i);
    }
    this.dots.geometry.dispose();
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(frame.positions, 3));
    geometry.setAttribute("color", new BufferAttribute(colours, 3));
    this.dots.geometry = geometry;
  }

  dispose(): void {
    this.dots.geometry.dispose();
  }
}

function dynamicGeometry(count: number): BufferGeometry {
  const geometry = new BufferGeometry();
  for (const name of ["position", "color"]) {
    geometry.setAttribute(name, new BufferAttribute(new Float32Array(3 * count), 3).setUsage(DynamicDrawUsage));
  }
  return geometry;
}

function fill(geometry: BufferGeometry, name: string, values: Float32Array): void {
  const attribute = geometry.getAttribute(name) as BufferAttribute;
  (attribute.array as Float32Array).set(values);
  attribute.needsUpdate = true;
}

export class Stage {
  readonly renderer: WebGLRenderer;
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(32, 1, 0.01, 500);
  readonly controls: OrbitControls;
  private grid: GridHelper | null = null;
  private dirty = true;

  constructor(
    readonly canvas: HTMLCanvasElement,
    onDraw: () => void,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.renderer.setPixelRatio(Math.min(2, devicePixelRatio));
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

  /** Put the camera where a box of this size around the centre fills the picture. */
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

  /** A point of the scene in the picture, pixels of the canvas. */
  project(position: Vector3): Vector2 {
    this.camera.updateMatrixWorld();
    const p = position.clone().project(this.camera);
    return new Vector2(((p.x + 1) / 2) * this.canvas.clientWidth, ((1 - p.y) / 2) * this.canvas.clientHeight);
  }

  /** The point of a frame nearest to the pixel (x, y), within 18 pixels; −1 for none. place: from its axes to the scene's. */
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
    this.camera.updateProjectionMatrix();
    this.dirty = true;
  }

}

/** How many frames of a trail to draw. */
export function trailFrames(rate: number): number {
  return Math.round(TRAIL_SECONDS * rate);
}
