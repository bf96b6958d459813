/** The least-squares rotation between two sets of vectors (Kabsch's problem), by Horn's quaternion. */

import { matrixOf } from "../../geometry.js";

/**
 * The matrix (3, 3), row by row, of the rotation R that minimises Σ |R from − to|², without reflection.
 *
 * It is the eigenvector of the largest eigenvalue of a symmetric (4, 4) matrix, found by Jacobi's rotations.
 */
export function nearestRotation(from: ArrayLike<number>[], to: ArrayLike<number>[]): number[] {
  const s = new Float64Array(9); // s[3 i + j] = Σ from_i · to_j
  from.forEach((a, n) => {
    for (let i = 0; i < 3; i++) for (let j = 0; j < 3; j++) s[3 * i + j]! += a[i]! * to[n]![j]!;
  });
  const [xx, xy, xz, yx, yy, yz, zx, zy, zz] = s as unknown as [number, number, number, number, number, number, number, number, number];
  const q = strongest([
    [xx + yy + zz, yz - zy, zx - xz, xy - yx],
    [yz - zy, xx - yy - zz, xy + yx, zx + xz],
    [zx - xz, xy + yx, yy - xx - zz, yz + zy],
    [xy - yx, zx + xz, yz + zy, zz - xx - yy],
  ]);
  return matrixOf(q);
}

const SWEEPS = 30;

/** The unit eigenvector of the largest eigenvalue of a symmetric (4, 4) matrix. */
function strongest(a: number[][]): number[] {
  const v = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].map((j) => (i === j ? 1 : 0)));
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    for (let p = 0; p < 3; p++) for (let q = p + 1; q < 4; q++) if (a[p]![q] !== 0) rotate(a, v, p, q);
  }
  let best = 0;
  for (let i = 1; i < 4; i++) if (a[i]![i]! > a[best]![best]!) best = i;
  return v.map((row) => row[best]!);
}

/** One rotation of Jacobi's method, which makes a[p][q] zero. */
function rotate(a: number[][], v: number[][], p: number, q: number): void {
  const theta = (a[q]![q]! - a[p]![p]!) / (2 * a[p]![q]!);
  const t = (theta < 0 ? -1 : 1) / (Math.abs(theta) + Math.sqrt(theta * theta + 1));
  const c = 1 / Math.sqrt(t * t + 1);
  const s = t * c;
  for (const m of [a, v]) {
    for (let k = 0; k < 4; k++) {
      const [kp, kq] = [m[k]![p]!, m[k]![q]!];
      m[k]![p] = c * kp - s * kq;
      m[k]![q] = s * kp + c * kq;
    }
  }
  for (let k = 0; k < 4; k++) {
    const [pk, qk] = [a[p]![k]!, a[q]![k]!];
    a[p]![k] = c * pk - s * qk;
    a[q]![k] = s * pk + c * qk;
  }
}
