/** Vectors and rotations. Rotations are unit quaternions (w, x, y, z). */

export type Vector = [number, number, number];
export type Quaternion = [number, number, number, number];

export const NO_ROTATION: Quaternion = [1, 0, 0, 0];

export function dot(a: Vector, b: Vector): number {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

export function cross(a: Vector, b: Vector): Vector {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}

export function plus(a: Vector, b: Vector): Vector {
  return [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
}

export function minus(a: Vector, b: Vector): Vector {
  return [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
}

export function times(factor: number, v: Vector): Vector {
  return [factor * v[0], factor * v[1], factor * v[2]];
}

export function lengthOf(v: Vector): number {
  return Math.sqrt(dot(v, v));
}

export function normalised(v: Vector): Vector {
  return times(1 / lengthOf(v), v);
}

/** Rotation by `angle` (radians) about a unit vector. */
export function aboutAxis(axis: Vector, angle: number): Quaternion {
  const sine = Math.sin(angle / 2);
  return [Math.cos(angle / 2), sine * axis[0], sine * axis[1], sine * axis[2]];
}

/** Rotation by `angle` (radians) about a coordinate axis. */
export function about(axis: number, angle: number): Quaternion {
  const q: Quaternion = [Math.cos(angle / 2), 0, 0, 0];
  q[axis + 1] = Math.sin(angle / 2);
  return q;
}

/** a · b. */
export function multiplied(a: Quaternion, b: Quaternion): Quaternion {
  const aw = a[0];
  const ax = a[1];
  const ay = a[2];
  const az = a[3];
  const bw = b[0];
  const bx = b[1];
  const by = b[2];
  const bz = b[3];
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

export function inverse(q: Quaternion): Quaternion {
  return [q[0], -q[1], -q[2], -q[3]];
}

/** v rotated by q. */
export function rotated(q: Quaternion, v: Vector): Vector {
  const w = q[0];
  const x = q[1];
  const y = q[2];
  const z = q[3];
  const tx = 2 * (y * v[2] - z * v[1]);
  const ty = 2 * (z * v[0] - x * v[2]);
  const tz = 2 * (x * v[1] - y * v[0]);
  return [v[0] + w * tx + y * tz - z * ty, v[1] + w * ty + z * tx - x * tz, v[2] + w * tz + x * ty - y * tx];
}

export function unitQuaternion(q: ArrayLike<number>): Quaternion {
  const w = q[0]!;
  const x = q[1]!;
  const y = q[2]!;
  const z = q[3]!;
  const factor = 1 / Math.sqrt(w * w + x * x + y * y + z * z);
  return [w * factor, x * factor, y * factor, z * factor];
}

/** Product of rotations about the axes of `order` ("zyx" is Rz · Ry · Rx). angles: radians. */
export function fromEuler(order: string, angles: ArrayLike<number>): Quaternion {
  let q = NO_ROTATION;
  for (let i = 0; i < order.length; i++) q = multiplied(q, about("xyz".indexOf(order[i]!), angles[i]!));
  return q;
}

/** Inverse of `fromEuler`; the second angle is in −π/2 … π/2. */
export function toEuler(order: string, q: Quaternion): Vector {
  const [i, j, k] = Array.from(order, (letter) => "xyz".indexOf(letter)) as Vector;
  const sign = (j - i + 3) % 3 === 1 ? 1 : -1;
  const m = matrixOf(q);
  const at = (row: number, column: number) => m[3 * row + column]!;
  const second = Math.asin(Math.min(1, Math.max(-1, sign * at(i, k))));
  return [Math.atan2(-sign * at(j, k), at(k, k)), second, Math.atan2(-sign * at(i, j), at(i, i))];
}

/** The matrix (3, 3) of a rotation, row by row. */
export function matrixOf(q: ArrayLike<number>): number[] {
  const w = q[0]!;
  const x = q[1]!;
  const y = q[2]!;
  const z = q[3]!;
  return [
    1 - 2 * (y * y + z * z),
    2 * (x * y - w * z),
    2 * (x * z + w * y),
    2 * (x * y + w * z),
    1 - 2 * (x * x + z * z),
    2 * (y * z - w * x),
    2 * (x * z - w * y),
    2 * (y * z + w * x),
    1 - 2 * (x * x + y * y),
  ];
}

/** The quaternion of a matrix, given row by row; its component of the largest magnitude is positive. */
export function fromMatrix(m: ArrayLike<number>): Quaternion {
  const xx = m[0]!;
  const yy = m[4]!;
  const zz = m[8]!;
  // four times the square of each component
  const w4 = 1 + xx + yy + zz;
  const x4 = 1 + xx - yy - zz;
  const y4 = 1 - xx + yy - zz;
  const z4 = 1 - xx - yy + zz;
  if (w4 >= x4 && w4 >= y4 && w4 >= z4) return unitQuaternion([w4, m[7]! - m[5]!, m[2]! - m[6]!, m[3]! - m[1]!]);
  if (x4 >= y4 && x4 >= z4) return unitQuaternion([m[7]! - m[5]!, x4, m[1]! + m[3]!, m[2]! + m[6]!]);
  if (y4 >= z4) return unitQuaternion([m[2]! - m[6]!, m[1]! + m[3]!, y4, m[5]! + m[7]!]);
  return unitQuaternion([m[3]! - m[1]!, m[2]! + m[6]!, m[5]! + m[7]!, z4]);
}
