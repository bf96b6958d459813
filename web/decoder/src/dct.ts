/** Inverse DCT along time of many columns at once. */

/** Sizes up to this one are summed term by term. */
const SMALL = 8;
/** Halvings at most: each divides by small cosines, which costs digits. */
const MOST_HALVINGS = 6;

/**
 * Frame t is Σ_f c_f · y[f] · cos(π (t + ½) f / F), with c₀ = √(1 / F) and c_f = √(2 / F).
 *
 * y: (frequencies, lanes), frequencies ≤ frames; the result is (frames, lanes).
 */
export function inverseDct(y: Float64Array, frequencies: number, frames: number, lanes: number): Float64Array {
  const out = new Float64Array(frames * lanes);
  if (frequencies === 0) return out;
  const scaled = new Float64Array(frequencies * lanes);
  const first = Math.sqrt(1 / frames);
  const others = Math.sqrt(2 / frames);
  for (let i = 0; i < scaled.length; i++) scaled[i] = y[i]! * (i < lanes ? first : others);
  sum(scaled, frequencies, frames, lanes, out, MOST_HALVINGS);
  return out;
}

/** out[t] = Σ_f y[f] · cos(π (t + ½) f / frames). */
function sum(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array, halvings: number): void {
  if (frames % 2 || frames <= SMALL || frequencies <= 2 || halvings === 0) direct(y, frequencies, frames, lanes, out);
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
    for (let c = 0; c < lanes; c++) {
      const above = 2 * f + 1 < frequencies ? y[(2 * f + 1) * lanes + c]! : 0;
      const below = f > 0 ? y[(2 * f - 1) * lanes + c]! : 0;
      odd[f * lanes + c] = above + below;
    }
  }
  const evenSum = new Float64Array(half * lanes);
  const oddSum = new Float64Array(half * lanes);
  sum(even, evens, half, lanes, evenSum, halvings - 1);
  sum(odd, odds, half, lanes, oddSum, halvings - 1);
  for (let t = 0; t < half; t++) {
    const factor = 1 / (2 * Math.cos((Math.PI * (t + 0.5)) / frames));
    const mirror = (frames - 1 - t) * lanes;
    for (let c = 0, i = t * lanes; c < lanes; c++, i++) {
      const part = oddSum[i]! * factor;
      out[i] = evenSum[i]! + part;
      out[mirror + c] = evenSum[i]! - part;
    }
  }
}

/** Term by term; both halves of the frames share the products. */
function direct(y: Float64Array, frequencies: number, frames: number, lanes: number, out: Float64Array): void {
  const cosines = Float64Array.from({ length: 4 * frames }, (_, i) => Math.cos((Math.PI * i) / (2 * frames)));
  const half = Math.ceil(frames / 2);
  for (let t = 0; t < half; t++) {
    const at = t * lanes;
    const mirror = (frames - 1 - t) * lanes;
    for (let f = 0; f < frequencies; f++) {
      const cosine = cosines[((2 * t + 1) * f) % (4 * frames)]!;
      const row = f * lanes;
      const mirrored = f & 1 ? -cosine : cosine;
      if (mirror === at) for (let c = 0; c < lanes; c++) out[at + c]! += cosine * y[row + c]!;
      else {
        for (let c = 0; c < lanes; c++) {
          const value = y[row + c]!;
          out[at + c]! += cosine * value;
          out[mirror + c]! += mirrored * value;
        }
      }
    }
  }
}
