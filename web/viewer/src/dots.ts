/**
 * Points drawn as lit discs that face the camera, one vertex a point: without a graphics card, spheres of triangles take four times
 * as long.
 */

import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Points, ShaderMaterial } from "three";

const VERTEX = `
attribute vec3 tint;
#ifdef FLAT
uniform float radius;
#else
attribute float radius;
#endif
uniform float pixels;
varying vec3 shade;
varying vec3 sun;
void main() {
  shade = tint;
  sun = normalize((viewMatrix * vec4(2.0, 5.0, 3.0, 0.0)).xyz);
  vec4 centre = modelViewMatrix * vec4(position, 1.0);
  vec4 place = projectionMatrix * centre;
  // as near as the front of a sphere, so that the disc covers the ends of bones
  vec4 front = projectionMatrix * (centre + vec4(0.0, 0.0, radius, 0.0));
  gl_Position = radius > 0.0 ? vec4(place.xy, front.z / front.w * place.w, place.w) : vec4(2.0, 2.0, 2.0, 1.0);
  gl_PointSize = max(1.5, pixels * projectionMatrix[1][1] * radius / -centre.z);
}`;

const FRAGMENT = `
uniform float opacity;
varying vec3 shade;
varying vec3 sun;
void main() {
  vec2 p = vec2(2.0, -2.0) * (gl_PointCoord - 0.5);
  float r = dot(p, p);
  if (r > 1.0) discard;
#ifdef FLAT
  gl_FragColor = vec4(shade, opacity);
#else
  float edge = smoothstep(1.0, 1.0 - 2.0 * fwidth(sqrt(r)), sqrt(r));
  float light = 0.51 + 0.51 * max(0.0, dot(vec3(p, sqrt(1.0 - r)), sun));
  gl_FragColor = vec4(shade * light, opacity * edge);
  #include <colorspace_fragment>
#endif
}`;

/** Coordinates of points without a position, which must not be visible. */
const OUT_OF_SIGHT_M = 1e30;

export class Dots {
  readonly object: Points<BufferGeometry, ShaderMaterial>;
  private capacity = 0;

  /** isFlat: points of a cloud, without light, of one radius, in sRGB bytes: a third of the data to upload. */
  constructor(
    opacity: number,
    private readonly isFlat: boolean,
  ) {
    const material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      defines: isFlat ? { FLAT: "" } : {},
      uniforms: { pixels: { value: 1 }, opacity: { value: opacity }, radius: { value: 0 } },
      transparent: !isFlat, // for smooth edges
      depthWrite: opacity === 1,
    });
    this.object = new Points(new BufferGeometry(), material);
    this.object.frustumCulled = false;
    this.object.renderOrder = opacity < 1 ? 1 : 0;
    this.object.onBeforeRender = (renderer) => {
      material.uniforms.pixels.value = renderer.domElement.height;
    };
  }

  /** Draw points at positions (n · 3; NaN: gap) in linear colours (n · 3, 0 to 1), with one radius; `selected` is larger. */
  show(positions: Float32Array, colours: Float32Array, radius: number, selected: number): void {
    const count = positions.length / 3;
    this.reserve(count);
    const [place, tint, size] = this.attributes("position", "tint", "radius");
    const [at, sizes] = [place.array as Float32Array, size.array as Float32Array];
    (tint.array as Float32Array).set(colours);
    for (let i = 0, k = 0; i < count; i++, k += 3) {
      const isGap = Number.isNaN(positions[k]);
      sizes[i] = isGap ? 0 : radius;
      at[k] = isGap ? 0 : positions[k];
      at[k + 1] = isGap ? 0 : positions[k + 1];
      at[k + 2] = isGap ? 0 : positions[k + 2];
    }
    if (selected >= 0) sizes[selected] *= 1.8;
    for (const attribute of [place, tint, size]) attribute.needsUpdate = true;
  }

  /** Draw flat points at positions (n · 3) in colours (n · 3, 0 to 255), or in one. */
  showFlat(positions: Float32Array, colours: Uint8Array | [number, number, number], radius: number): void {
    const count = positions.length / 3;
    this.reserve(count);
    const [place, tint] = this.attributes("position", "tint");
    const at = place.array as Float32Array;
    at.set(positions);
    for (let k = 0; k < 3 * count; k++) if (Number.isNaN(at[k])) at[k] = OUT_OF_SIGHT_M;
    const shades = tint.array as Uint8Array;
    if (colours instanceof Uint8Array) shades.set(colours);
    else for (let k = 0; k < 3 * count; k += 3) shades.set(colours, k);
    this.object.material.uniforms.radius.value = radius;
    for (const attribute of [place, tint]) {
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, 3 * count);
      attribute.needsUpdate = true;
    }
  }

  private attributes(...names: string[]): BufferAttribute[] {
    return names.map((name) => this.object.geometry.getAttribute(name) as BufferAttribute);
  }

  private reserve(count: number): void {
    const { isFlat, object } = this;
    if (count > this.capacity) {
      this.capacity = isFlat ? Math.ceil(1.25 * count) : count;
      object.geometry.dispose();
      object.geometry = new BufferGeometry();
      const add = (name: string, attribute: BufferAttribute) => object.geometry.setAttribute(name, attribute.setUsage(DynamicDrawUsage));
      const numbers = (width: number) => new BufferAttribute(new Float32Array(width * this.capacity), width);
      add("position", numbers(3));
      add("tint", isFlat ? new BufferAttribute(new Uint8Array(3 * this.capacity), 3, true) : numbers(3));
      if (!isFlat) add("radius", numbers(1));
    }
    object.geometry.setDrawRange(0, count);
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}
