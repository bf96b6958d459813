/**
 * Points drawn as lit discs that face the camera. One vertex a point: spheres of triangles take four times as long without a graphics
 * card.
 */

import { BufferAttribute, BufferGeometry, DynamicDrawUsage, Points, ShaderMaterial } from "three";

const VERTEX = `
attribute vec3 tint;
attribute float radius;
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
uniform bool isFlat;
varying vec3 shade;
varying vec3 sun;
void main() {
  vec2 p = vec2(2.0, -2.0) * (gl_PointCoord - 0.5);
  float r = dot(p, p);
  if (r > 1.0) discard;
  float edge = isFlat ? 1.0 : smoothstep(1.0, 1.0 - 2.0 * fwidth(sqrt(r)), sqrt(r));
  float light = isFlat ? 1.0 : 0.51 + 0.51 * max(0.0, dot(vec3(p, sqrt(1.0 - r)), sun));
  gl_FragColor = vec4(shade * light, opacity * edge);
  #include <colorspace_fragment>
}`;

export class Dots {
  readonly object: Points<BufferGeometry, ShaderMaterial>;
  private capacity = 0;

  /** isFlat: without light, as the coloured points of a cloud are. */
  constructor(
    opacity: number,
    private readonly isFlat: boolean,
  ) {
    const material = new ShaderMaterial({
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: { pixels: { value: 1 }, opacity: { value: opacity }, isFlat: { value: isFlat } },
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

  /** Draw points at positions (n · 3), NaN for none, in linear colours (n · 3, 0 to 1), with one radius; `selected` is larger. */
  show(positions: Float32Array, colours: Float32Array, radius: number, selected = -1): void {
    const count = positions.length / 3;
    this.reserve(count);
    const { geometry } = this.object;
    const [place, tint, size] = ["position", "tint", "radius"].map((name) => geometry.getAttribute(name) as BufferAttribute);
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
    geometry.setDrawRange(0, count);
  }

  private reserve(count: number): void {
    if (count <= this.capacity) return;
    this.capacity = this.isFlat ? Math.ceil(1.25 * count) : count;
    this.object.geometry.dispose();
    this.object.geometry = new BufferGeometry();
    for (const [name, width] of [["position", 3], ["tint", 3], ["radius", 1]] as const) {
      this.object.geometry.setAttribute(name, new BufferAttribute(new Float32Array(width * this.capacity), width).setUsage(DynamicDrawUsage));
    }
  }

  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}
