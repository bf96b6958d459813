/** Cubes of a level of an octree, in the order of their Morton codes, and a search by place. */

/** Hash table from places with integer coordinates to their numbers. */
export class CubeIndex {
  private readonly table: Int32Array;

  /** places: (n, 3), all different. */
  constructor(private readonly places: ArrayLike<number>) {
    const size = 2 ** Math.ceil(Math.log2(Math.max(4, places.length)));
    this.table = new Int32Array(size).fill(-1);
    for (let i = 0; 3 * i < places.length; i++) this.table[this.slot(places[3 * i]!, places[3 * i + 1]!, places[3 * i + 2]!)] = i;
  }

  private slot(x: number, y: number, z: number): number {
    const { table, places } = this;
    let at = (Math.imul(x, 73856093) ^ Math.imul(y, 19349663) ^ Math.imul(z, 83492791)) >>> 0;
    for (at ^= at >>> 15; ; at++) {
      at &= table.length - 1;
      const i = table[at]!;
      if (i < 0 || (places[3 * i] === x && places[3 * i + 1] === y && places[3 * i + 2] === z)) return at;
    }
  }

  /** The number of a place, −1 if there is none. */
  find(x: number, y: number, z: number): number {
    return this.table[this.slot(x, y, z)]!;
  }
}

/** Numbers (n, 6) of the neighbours of cubes (n, 3), before and behind along x, y, z; −1: none. */
export function neighbourCubes(cubes: Int32Array): Int32Array {
  const index = new CubeIndex(cubes);
  const found = new Int32Array(2 * cubes.length);
  for (let i = 0; 3 * i < cubes.length; i++) {
    const [x, y, z] = [cubes[3 * i]!, cubes[3 * i + 1]!, cubes[3 * i + 2]!];
    found.set([index.find(x - 1, y, z), index.find(x + 1, y, z), index.find(x, y - 1, z)], 6 * i);
    found.set([index.find(x, y + 1, z), index.find(x, y, z - 1), index.find(x, y, z + 1)], 6 * i + 3);
  }
  return found;
}

/** The occupied children of cubes, in order. children: bit mask of octants for each cube. */
export function descend(cubes: Int32Array, children: Uint8Array): { cubes: Int32Array; parents: Int32Array } {
  const parents: number[] = [];
  const places: number[] = [];
  for (let i = 0; i < children.length; i++) {
    for (let octant = 0; octant < 8; octant++) {
      if (!((children[i]! >> octant) & 1)) continue;
      parents.push(i);
      for (let axis = 0; axis < 3; axis++) places.push(2 * cubes[3 * i + axis]! + ((octant >> axis) & 1));
    }
  }
  return { cubes: Int32Array.from(places), parents: Int32Array.from(parents) };
}

export function bitsIn(byte: number): number {
  let count = 0;
  for (let rest = byte; rest; rest &= rest - 1) count++;
  return count;
}
