/** Inverse DCT along time of many columns at once. */

/** Sums of at most this many frequencies are made term by term: halving them would not pay. */
const FEW_FREQUENCIES = 32;
/** Halvings at most: each divides by small cosines, which costs digits. */
const MOST_HALVINGS = 6;

/**
 * Frame t is Σ_f c_f · y[f] · cos(π (t + ½) f / F), with c₀ = √(1 / F) and c_f = √(2 / F).
 *
 * y: (frequencies, lanes), frequencies ≤ frames; it is overwritten. The result is (frames, lanes).
 */
export function inverseDct(y: Float64Array, frequencies: number, frames: number, lanes: number): Float64Array {
  const out = new Float64Array(frames * lanes);
  if (frequencies === 0 || lanes === 0) return out;
  const first = Math.sqrt(1 / frames);
  const others = Math.sqrt(2 / frames);
  for (let i = 0; i < y.length; i++) y[i]! *= i < lanes ? first : others;
  sum(y, frequencies, frames, lanes, out, MOST_HALVINGS);
  return out;
}

/** out[t] = Σ_f y[f] · cos(π (t + ½) f / frames). */
function sum(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array, halvings: number): void {
  if (frames % 2 || frequencies <= FEW_FREQUENCIES || halvings === 0) direct(y, frequencies, frames, lanes, out);
  else halved(y, frequencies, frames, lanes, out, halvings);
}

/**
 * Two sums of half the size. Even frequencies are one as they stand. With θ = π (t + ½) / frames and y[−1] = 0, odd ones are
 *
 *     Σ y[2f+1] cos((2f+1) θ) = 1 / (2 cos θ) · Σ (y[2f+1] + y[2f−1]) cos(2f θ)
 *
 * since 2 cos θ cos((2f+1) θ) = cos(2f θ) + cos((2f+2) θ). The second half of the frames mirrors the first, odd parts negated.
 */
function halved(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array, halvings: number): void {
  const half = frames / 2;
  const evens = (frequencies + 1) >> 1;
  const odds = Math.min((frequencies >> 1) + 1, half);
  const even = new Float64Array(evens * lanes);
  const odd = new Float64Array(odds * lanes);
  for (let f = 0; f < evens; f++) even.set(y.subarray(2 * f * lanes, (2 * f + 1) * lanes), f * lanes);
  for (let f = 0; f < odds; f++) {
    if (2 * f + 1 < frequencies) odd.set(y.subarray((2 * f + 1) * lanes, (2 * f + 2) * lanes), f * lanes);
    if (f > 0) for (let c = 0, i = f * lanes, k = (2 * f - 1) * lanes; c < lanes; c++, i++, k++) odd[i]! += y[k]!;
  }
  const evenSum = new Float64Array(half * lanes);
  const oddSum = new Float64Array(half * lanes);
  sum(even, evens, half, lanes, evenSum, halvings - 1);
  sum(odd, odds, half, lanes, oddSum, halvings - 1);
  for (let t = 0; t < half; t++) {
    const factor = 1 / (2 * Math.cos((Math.PI * (t + 0.5)) / frames));
    const mirror = (frames - 1 - t) * lanes;
    for (let c = 0, i = t * lanes; c < lanes; c++, i++) {
      const e = evenSum[i]!;
      const o = oddSum[i]! * factor;
      out[i] = e + o;
      out[mirror + c] = e - o;
    }
  }
}

/** Term by term. Frames t and frames − 1 − t share the sums of even and of odd frequencies. */
function direct(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array): void {
  const cosines = quarterTurns(frames);
  const evens = new Float64Array(lanes);
  const odds = new Float64Array(lanes);
  for (let t = 0; t < frames / 2; t++) {
    parity(y, 0, frequencies, frames, lanes, t, cosines, evens);
    parity(y, 1, frequencies, frames, lanes, t, cosines, odds);
    const at = t * lanes;
    const mirror = (frames - 1 - t) * lanes;
    for (let c = 0; c < lanes; c++) {
      out[mirror + c] = evens[c]! - odds[c]!;
      out[at + c] = evens[c]! + odds[c]!;
    }
  }
}

/** The sum over frequencies first, first + 2, … at frame t, four at a time. */
function parity(
  y: Float64Array,
  first: number,
  frequencies: number,
  frames: number,
  lanes: number,
  t: number,
  cosines: Float64Array,
  out: Float64Array,
): void {
  const turn = 4 * frames;
  const step = (2 * (2 * t + 1)) % turn;
  let place = ((2 * t + 1) * first) % turn;
  out.fill(0);
  let f = first;
  for (; f + 6 < frequencies; f += 8) {
    const a = cosines[place]!;
    const b = cosines[(place + step) % turn]!;
    const c = cosines[(place + 2 * step) % turn]!;
    const d = cosines[(place + 3 * step) % turn]!;
    place = (place + 4 * step) % turn;
    const ia = f * lanes;
    const ib = ia + 2 * lanes;
    const ic = ib + 2 * lanes;
    const id = ic + 2 * lanes;
    for (let k = 0; k < lanes; k++) out[k]! += a * y[ia + k]! + b * y[ib + k]! + c * y[ic + k]! + d * y[id + k]!;
  }
  for (; f < frequencies; f += 2) {
    const a = cosines[place]!;
    place = (place + step) % turn;
    for (let k = 0, i = f * lanes; k < lanes; k++, i++) out[k]! += a * y[i]!;
  }
}

let lastFrames = 0;
let lastCosines = new Float64Array(0);

/** cos(π i / (2 frames)) for a whole turn, i = 0 … 4 · frames − 1. */
function quarterTurns(frames: number): Float64Array {
  if (frames !== lastFrames) {
    lastFrames = frames;
    lastCosines = Float64Array.from({ length: 4 * frames }, (_, i) => Math.cos((Math.PI * i) / (2 * frames)));
  }
  return lastCosines;
}
