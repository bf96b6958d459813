/** Nearest neighbours of each point within a set: a k-d tree, exact for integers; equal distances are sorted by number. */

const LEAF = 8;

interface Node {
  first: number;
  last: number;
  /** Axis of the split, −1: leaf. Then the greatest coordinate of the first child, the least of the second, the second child. */
  axis: number;
  low: number;
  high: number;
  second: number;
}

/** Numbers (n, count) of the `count` nearest other points of each point (n, 3), nearest first; n > count. */
export function nearestOthers(points: Float64Array, count: number): Int32Array {
  const size = points.length / 3;
  const order = Int32Array.from({ length: size }, (_, i) => i);
  const nodes: Node[] = [];
  build(points, order, nodes, 0, size);
  const result = new Int32Array(count * size);
  const squares = new Float64Array(count);
  const rows = new Int32Array(count);
  const away = [0, 0, 0];
  for (let own = 0; own < size; own++) {
    squares.fill(Infinity);
    rows.fill(size);
    visit(0, 0);
    result.set(rows, count * own);

    function visit(at: number, box: number): void {
      const node = nodes[at]!;
      if (node.axis < 0) {
        for (let i = node.first; i < node.last; i++) offer(order[i]!);
        return;
      }
      const x = points[3 * own + node.axis]!;
      const isFirstNearer = x - node.low < node.high - x;
      visit(isFirstNearer ? at + 1 : node.second, box);
      const before = away[node.axis]!;
      const now = Math.max(before, isFirstNearer ? node.high - x : x - node.low);
      const beyond = box - before * before + now * now;
      if (beyond > squares[count - 1]!) return;
      away[node.axis] = now;
      visit(isFirstNearer ? node.second : at + 1, beyond);
      away[node.axis] = before;
    }

    function offer(row: number): void {
      if (row === own) return;
      const [x, y, z] = [points[3 * row]! - points[3 * own]!, points[3 * row + 1]! - points[3 * own + 1]!, points[3 * row + 2]! - points[3 * own + 2]!];
      const square = x * x + y * y + z * z;
      const isNearer = (k: number) => square < squares[k]! || (square === squares[k]! && row < rows[k]!);
      if (!isNearer(count - 1)) return;
      let k = count - 1;
      for (; k > 0 && isNearer(k - 1); k--) [squares[k], rows[k]] = [squares[k - 1]!, rows[k - 1]!];
      [squares[k], rows[k]] = [square, row];
    }
  }
  return result;
}

function build(points: Float64Array, order: Int32Array, nodes: Node[], first: number, last: number): number {
  const node: Node = { first, last, axis: -1, low: 0, high: 0, second: 0 };
  const here = nodes.push(node) - 1;
  if (last - first <= LEAF) return here;
  let widest = 0;
  let axis = -1;
  for (let d = 0; d < 3; d++) {
    let [least, most] = [Infinity, -Infinity];
    for (let i = first; i < last; i++) {
      least = Math.min(least, points[3 * order[i]! + d]!);
      most = Math.max(most, points[3 * order[i]! + d]!);
    }
    if (most - least > widest) [widest, axis] = [most - least, d];
  }
  if (axis < 0) return here;
  order.subarray(first, last).sort((i, j) => points[3 * i + axis]! - points[3 * j + axis]!);
  const middle = (first + last) >> 1;
  node.axis = axis;
  node.low = points[3 * order[middle - 1]! + axis]!;
  node.high = points[3 * order[middle]! + axis]!;
  build(points, order, nodes, first, middle);
  node.second = build(points, order, nodes, middle, last);
  return here;
}
