/** Inverse DCT along time, for many columns. */

/** Sums of at most this many frequencies are computed term by term: halving them takes longer. */
const FEW_FREQUENCIES = 32;
/** Most halvings: each divides by small cosines, which loses precision. */
const MOST_HALVINGS = 6;

/**
 * Frame t is Σ_f c_f · y[f] · cos(π (t + ½) f / F), with c₀ = √(1 / F) and c_f = √(2 / F).
 *
 * y: (frequencies, lanes), overwritten; frequencies ≤ frames. The result is (frames, lanes).
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
 * Two sums of half the size. The even frequencies are one of them. With θ = π (t + ½) / frames and y[−1] = 0, the odd ones give
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

/** Term by term, two frames at a time. Frames t and frames − 1 − t share the sums of even and of odd frequencies. */
function direct(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array): void {
  const cosines = quarterTurns(frames);
  const evens = new Float64Array(2 * lanes);
  const odds = new Float64Array(2 * lanes);
  for (let t = 0; t < frames / 2; t += 2) {
    parity(y, 0, frequencies, frames, lanes, t, cosines, evens);
    parity(y, 1, frequencies, frames, lanes, t, cosines, odds);
    for (let n = 0; n < 2 && t + n < frames / 2; n++) {
      const at = (t + n) * lanes;
      const mirror = (frames - 1 - t - n) * lanes;
      for (let c = 0, i = n * lanes; c < lanes; c++, i++) {
        out[mirror + c] = evens[i]! - odds[i]!;
        out[at + c] = evens[i]! + odds[i]!;
      }
    }
  }
}

/** The sums over frequencies first, first + 2, … at frames t and t + 1, (2, lanes), four frequencies at a time. */
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
  const nextStep = (2 * (2 * t + 3)) % turn;
  let place = ((2 * t + 1) * first) % turn;
  let next = ((2 * t + 3) * first) % turn;
  out.fill(0);
  let f = first;
  for (; f + 6 < frequencies; f += 8) {
    const a = cosines[place]!;
    const b = cosines[(place + step) % turn]!;
    const c = cosines[(place + 2 * step) % turn]!;
    const d = cosines[(place + 3 * step) % turn]!;
    place = (place + 4 * step) % turn;
    const a1 = cosines[next]!;
    const b1 = cosines[(next + nextStep) % turn]!;
    const c1 = cosines[(next + 2 * nextStep) % turn]!;
    const d1 = cosines[(next + 3 * nextStep) % turn]!;
    next = (next + 4 * nextStep) % turn;
    const ia = f * lanes;
    const ib = ia + 2 * lanes;
    const ic = ib + 2 * lanes;
    const id = ic + 2 * lanes;
    for (let k = 0; k < lanes; k++) {
      const ya = y[ia + k]!;
      const yb = y[ib + k]!;
      const yc = y[ic + k]!;
      const yd = y[id + k]!;
      out[k]! += a * ya + b * yb + c * yc + d * yd;
      out[lanes + k]! += a1 * ya + b1 * yb + c1 * yc + d1 * yd;
    }
  }
  for (; f < frequencies; f += 2) {
    const a = cosines[place]!;
    const a1 = cosines[next]!;
    place = (place + step) % turn;
    next = (next + nextStep) % turn;
    for (let k = 0, i = f * lanes; k < lanes; k++, i++) {
      out[k]! += a * y[i]!;
      out[lanes + k]! += a1 * y[i]!;
    }
  }
}

let lastFrames = 0;
let lastCosines = new Float64Array(0);

/** cos(π i / (2 frames)) for i = 0 … 4 · frames − 1, a whole turn. */
function quarterTurns(frames: number): Float64Array {
  if (frames !== lastFrames) {
    lastFrames = frames;
    lastCosines = Float64Array.from({ length: 4 * frames }, (_, i) => Math.cos((Math.PI * i) / (2 * frames)));
  }
  return lastCosines;
}
