/** Rotations as quaternions (w, x, y, z). */

/** Rotation by `angle` (radians) about a coordinate axis. */
export function about(axis: number, angle: number): [number, number, number, number] {
  const q: [number, number, number, number] = [Math.cos(angle / 2), 0, 0, 0];
  q[axis + 1] = Math.sin(angle / 2);
  return q;
}

/** a · b. */
export function multiplied(a: ArrayLike<number>, b: ArrayLike<number>): [number, number, number, number] {
  const [aw, ax, ay, az] = [a[0]!, a[1]!, a[2]!, a[3]!];
  const [bw, bx, by, bz] = [b[0]!, b[1]!, b[2]!, b[3]!];
  return [
    aw * bw - ax * bx - ay * by - az * bz,
    aw * bx + ax * bw + ay * bz - az * by,
    aw * by - ax * bz + ay * bw + az * bx,
    aw * bz + ax * by - ay * bx + az * bw,
  ];
}

/** The product of rotations about the axes of `order` ("zyx" is Rz · Ry · Rx) by these angles, radians. */
export function fromEuler(order: string, angles: ArrayLike<number>): [number, number, number, number] {
  let q: [number, number, number, number] = [1, 0, 0, 0];
  for (let i = 0; i < order.length; i++) q = multiplied(q, about("xyz".indexOf(order[i]!), angles[i]!));
  return q;
}
