/** Links between markers: pairs of constant distance, as in mocodec's geometry/links.py. */

const RIGID_M = 0.012;
const LONGEST_M = 0.6;
const FIRM_M = 0.004;
const WEIGHT_OF_SPREAD = 12;

/** Pairs of points to connect: a minimum spanning forest and near rigid neighbours. sample: frames (points · 3) in metres. */
export function findLinks(sample: Float64Array[], points: number): [number, number][] {
  const pairs: { a: number; b: number; weight: number; isFirm: boolean }[] = [];
  for (let a = 0; a < points; a++) {
    for (let b = a + 1; b < points; b++) {
      const { mean, spread } = distance(sample, a, b);
      if (!(spread <= RIGID_M && mean <= LONGEST_M && mean > 1e-6)) continue;
      pairs.push({ a, b, weight: mean + WEIGHT_OF_SPREAD * spread, isFirm: spread <= FIRM_M });
    }
  }
  pairs.sort((p, q) => p.weight - q.weight);
  const root = Array.from({ length: points }, (_, i) => i);
  const find = (i: number): number => (root[i] === i ? i : (root[i] = find(root[i])));
  const firmOf = new Array<number>(points).fill(0);
  const links: [number, number][] = [];
  for (const { a, b, isFirm } of pairs) {
    const [u, v] = [find(a), find(b)];
    const isNear = isFirm && (firmOf[a] < 2 || firmOf[b] < 2);
    if (isFirm) {
      firmOf[a]++;
      firmOf[b]++;
    }
    if (u === v && !isNear) continue;
    root[u] = v;
    links.push([a, b]);
  }
  return links;
}

/** Mean and standard deviation of the distance of two points, metres; infinite if fewer than two frames have both. */
function distance(sample: Float64Array[], a: number, b: number): { mean: number; spread: number } {
  let count = 0;
  let sum = 0;
  let squares = 0;
  for (const p of sample) {
    const d = Math.hypot(p[3 * a] - p[3 * b], p[3 * a + 1] - p[3 * b + 1], p[3 * a + 2] - p[3 * b + 2]);
    if (Number.isNaN(d)) continue;
    count++;
    sum += d;
    squares += d * d;
  }
  if (count < 2) return { mean: Infinity, spread: Infinity };
  const mean = sum / count;
  return { mean, spread: Math.sqrt(Math.max(0, squares / count - mean * mean)) };
}
