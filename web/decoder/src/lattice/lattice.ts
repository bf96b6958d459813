/**
 * The lattice engine (docs/payloads/tempo-lattice.md): predicts samples from decoded ones and adds residuals on a lattice.
 * All float64 operations follow the order of the page, since later bits depend on every rounding.
 */

import { Bytes } from "../bytes.js";
import { check } from "../errors.js";
import { readIntegersWithin } from "../integers/read.js";
import { kernels } from "../kernels.js";
import { AdaptiveBits, RATE, SQUASH, STRETCH } from "./bits.js";
import { FEATURES, Filter } from "./filter.js";
import { type Surroundings, halfOctaves, readPoint } from "./points.js";
import { Samples, byFrame } from "./samples.js";

const NEIGHBOURS = 3;
const MOST_LEVELS = 6;
const MOST_ACTIVITY = 4000;
const LIMIT = 2 ** 40;
const NO_MORE = -1;
/** Larger chunks do not fit in the kernel's memory. */
const MOST_KERNEL_SAMPLES = 2 ** 24;
/** Numbers of a sample in the kernel: x, y, z, 0. */
const KERNEL_LANES = 4;

/** Neighbours of each point (points, 3), −1: none, and the coding order of points. */
export interface Network {
  neighbours: Int32Array;
  sequence: Int32Array;
}

/** Reads the blob of neighbours in the shared bytes. */
export function readNetwork(data: Uint8Array, points: number): Network {
  const numbers = readIntegersWithin(data, points, NEIGHBOURS, -points, points, "lattice: neighbours");
  const neighbours = new Int32Array(numbers.length).fill(NO_MORE);
  for (let p = 0; p < points; p++) {
    for (let q = 0; q < NEIGHBOURS; q++) {
      const difference = numbers[NEIGHBOURS * p + q]!;
      if (difference === 0) continue;
      const other = p - difference;
      check(other >= 0 && other < points && (q === 0 || neighbours[NEIGHBOURS * p + q - 1] !== NO_MORE), "lattice: a neighbour that does not exist");
      neighbours[NEIGHBOURS * p + q] = other;
    }
  }
  return { neighbours, sequence: sequenceOf(neighbours, points) };
}

/** The coding order, in rounds: each appends, ascending, the points whose neighbours are all in earlier rounds. */
function sequenceOf(neighbours: Int32Array, points: number): Int32Array {
  const waiting = new Int32Array(points);
  const followers: number[][] = Array.from({ length: points }, () => []);
  neighbours.forEach((other, i) => {
    if (other < 0) return;
    waiting[Math.floor(i / NEIGHBOURS)]!++;
    followers[other]!.push(Math.floor(i / NEIGHBOURS));
  });
  const sequence: number[] = [];
  let round = Array.from({ length: points }, (_, p) => p).filter((p) => waiting[p] === 0);
  while (round.length > 0) {
    for (const p of round) sequence.push(p);
    const next: number[] = [];
    for (const p of round) for (const follower of followers[p]!) if (--waiting[follower]! === 0) next.push(follower);
    round = next.sort((a, b) => a - b);
  }
  check(sequence.length === points, "lattice: a cycle of neighbours");
  return Int32Array.from(sequence);
}

/** Positions (frames, points, 3) in half steps. apart: (frames, points), 1 in gaps and frozen runs, or null. */
export function readLattice(data: Uint8Array, frames: number, points: number, apart: Uint8Array | null, network: Network): Float64Array {
  const part = new Bytes(data, "lattice");
  const kind = part.byte();
  const levels = kind & 127;
  check(levels <= MOST_LEVELS, "lattice: too many levels");
  const spikes = kind & 128 ? part.blob() : null;
  const stream = part.rest();
  const positions = readByKernel(stream, frames, points, levels, apart, network) ?? readStream(stream, frames, points, levels, apart, network);
  if (spikes) addSpikes(spikes, positions, frames * points);
  return positions;
}

function readStream(stream: Uint8Array, frames: number, points: number, levels: number, apart: Uint8Array | null, network: Network): Float64Array {
  const bits = new AdaptiveBits(stream);
  const samples = new Samples(frames, points, apart);
  new Engine(samples, levels, network, bits).run();
  bits.end();
  return samples.byFrame();
}

/** Reads a stream with the kernel; null without a kernel, and if it refuses the stream. */
function readByKernel(
  stream: Uint8Array,
  frames: number,
  points: number,
  levels: number,
  apart: Uint8Array | null,
  { sequence, neighbours }: Network,
): Float64Array | null {
  const loaded = kernels();
  if (!loaded || frames * points === 0 || frames * points > MOST_KERNEL_SAMPLES) return null;
  const mask = apart ?? new Uint8Array(frames * points);
  const given = [stream, stream.length, frames, points, mask, sequence, neighbours, levels, SQUASH, STRETCH, RATE];
  const samples = loaded.call("lattice", given, KERNEL_LANES * frames * points);
  return samples && byFrame(samples, frames, points, KERNEL_LANES);
}

function addSpikes(data: Uint8Array, positions: Float64Array, count: number): void {
  const part = new Bytes(data, "lattice");
  const n = part.varintWithin(1, count, "the number of spikes");
  const numbers = readIntegersWithin(part.rest(), n, 4, -LIMIT, LIMIT, "lattice: spikes");
  let at = 0;
  for (let i = 0; i < n; i++) {
    at += numbers[4 * i]!;
    check(at >= 0 && at < count, "lattice: a spike without a sample");
    for (let c = 0; c < 3; c++) positions[3 * at + c]! += numbers[4 * i + 1 + c]!;
  }
}

/** State of a level, kept from point to point. */
interface LevelState {
  mean: Float64Array;
  activity: number;
}

class Engine {
  private readonly levelStates: LevelState[];
  private readonly filter = new Filter();
  private readonly features = new Float64Array(3 * FEATURES);
  private readonly base = new Float64Array(3);
  /** f·x of each coordinate. */
  private readonly products = new Float64Array(3);
  private readonly linear = new Float64Array(3);
  private readonly predicted = new Float64Array(3);
  private readonly axes = new Float64Array(9);
  private readonly z = new Float64Array(3);
  private readonly around: Surroundings;
  private readonly others = new Int32Array(NEIGHBOURS);
  // state of the current point
  private point = 0;
  private isFirst = true;
  private distances = 0;
  private weights = 0;
  // state of the point's current level
  private level = 0;
  private half = 0;
  private step = 0;
  private slow = 0;
  private a = 0;
  private b = 0;
  /** e of "Along the direction to the partner". */
  private excess = 0;

  constructor(
    private readonly samples: Samples,
    private readonly levels: number,
    private readonly network: Network,
    private readonly bits: AdaptiveBits,
  ) {
    this.levelStates = Array.from({ length: levels + 1 }, (_, level) => {
      const mean = new Float64Array(FEATURES);
      if (level > 0) mean[0] = -0.0625;
      return { mean, activity: 1024 };
    });
    this.around = { class: 0, slow: 0, before: 0, before2: 0, beside: new Int32Array(NEIGHBOURS), after: 0, around: 0, radial: 0 };
  }

  run(): void {
    for (const point of this.network.sequence) {
      this.point = point;
      this.distances = 0;
      this.weights = 0;
      this.others.set(this.network.neighbours.subarray(NEIGHBOURS * point, NEIGHBOURS * (point + 1)));
      for (let level = 0; level <= this.levels; level++) this.runLevel(level);
      this.isFirst = false;
    }
  }

  private runLevel(level: number): void {
    const state = this.levelStates[level]!;
    this.level = level;
    this.half = 2 ** (this.levels - level);
    this.step = level ? 2 * this.half : this.half;
    this.filter.begin(state.mean);
    this.slow = state.activity;
    this.a = 0.001;
    this.b = 0;
    for (let t = level ? this.half : 0; t < this.samples.frames; t += this.step) this.sample(t);
    for (let i = 0; i < FEATURES; i++) state.mean[i] = (state.mean[i]! + this.filter.coefficients[i]!) / 2;
    state.activity = Math.floor((7 * state.activity + 3 * this.slow) / 10);
  }

  private sample(t: number): void {
    const { samples, point, step, predicted, linear } = this;
    if (samples.isApart(t, point)) {
      this.predictBeside(t);
      samples.set(t, point, predicted);
      samples.setActivity(t, point, t >= step ? samples.activity(t - step, point) : 0, 0);
      return;
    }
    const inside = this.isInside(t);
    if (inside) this.predictInside(t);
    else this.predictBeside(t);
    const directed = inside && this.direct(t);
    if (inside && !directed) predicted.set(linear);
    this.look(t, inside, directed);
    readPoint(this.bits, this.around, this.z);
    this.place(directed);
    samples.set(t, point, predicted);
    this.update(t, inside, directed);
  }

  private isInside(t: number): boolean {
    const { samples, point, half } = this;
    if (this.level === 0) return t >= 2 * half && !samples.isApart(t - half, point) && !samples.isApart(t - 2 * half, point);
    return t + half < samples.frames && !samples.isApart(t - half, point) && !samples.isApart(t + half, point);
  }

  /** "Beside gaps and ends": writes `predicted`. */
  private predictBeside(t: number): void {
    const { samples, point, half, predicted } = this;
    const partner = this.others[0]!;
    const hasBefore = t >= half;
    const hasAfter = this.level > 0 && t + half < samples.frames;
    const apartBefore = hasBefore && samples.isApart(t - half, point);
    const apartAfter = hasAfter && samples.isApart(t + half, point);
    for (let c = 0; c < 3; c++) {
      let value: number;
      if (!hasBefore && !hasAfter) value = partner < 0 ? 0 : samples.get(t, partner, c);
      else if (hasBefore && hasAfter && apartBefore === apartAfter) value = (samples.get(t - half, point, c) + samples.get(t + half, point, c)) / 2;
      else {
        const s = hasBefore && !(hasAfter && apartBefore) ? t - half : t + half;
        value = samples.get(s, point, c);
        if (partner >= 0) value += samples.get(t, partner, c) - samples.get(s, partner, c);
      }
      predicted[c] = Math.abs(value) < LIMIT ? value : 0;
    }
  }

  /** "Inside": writes `base`, `features`, `products` and `linear`. */
  private predictInside(t: number): void {
    const { samples, base, linear, features, filter, products, others } = this;
    features.fill(0);
    if (this.level === 0) this.featuresOfFirst(t);
    else this.featuresBetween(t);
    for (let q = 0; q < NEIGHBOURS && others[q]! >= 0; q++) {
      const at = 3 * (others[q]! * samples.frames + t);
      if (this.level === 0) this.besideFirst(t, at, 4 + 2 * q);
      else this.besideBetween(t, at, 4 + 2 * q);
    }
    for (let c = 0; c < 3; c++) {
      const product = filter.product(features, c * FEATURES);
      const value = base[c]! + product;
      products[c] = product;
      linear[c] = Math.abs(value) < LIMIT ? value : Math.abs(base[c]!) < LIMIT ? base[c]! : 0;
    }
  }

  /** Features of level 0: second differences Z(s) − 2 Z(s − half) + Z(s − 2 half) of the point itself. */
  private featuresOfFirst(t: number): void {
    const { samples, point, half, base, features } = this;
    const { values, frames } = samples;
    const at = 3 * (point * frames + t);
    const h = 3 * half;
    for (let c = 0; c < 3; c++) base[c] = 2 * values[at - h + c]! - values[at - 2 * h + c]!;
    for (let i = 0; i < 4 && t >= (i + 3) * half; i++) {
      for (let c = 0, s = at - (i + 1) * h; c < 3; c++, s++) features[c * FEATURES + i] = values[s]! - 2 * values[s - h]! + values[s - 2 * h]!;
    }
  }

  /** Features of level 0: second differences of a neighbour. at: index of its sample t. */
  private besideFirst(t: number, at: number, feature: number): void {
    const { half, features } = this;
    const { values, frames } = this.samples;
    const h = 3 * half;
    const hasNext = t + half < frames;
    for (let c = 0, s = at, x = feature; c < 3; c++, s++, x += FEATURES) {
      features[x] = values[s]! - 2 * values[s - h]! + values[s - 2 * h]!;
      if (hasNext) features[x + 1] = values[s + h]! - 2 * values[s]! + values[s - h]!;
    }
  }

  private featuresBetween(t: number): void {
    const { samples, point, half, base, features } = this;
    const { values, frames } = samples;
    const h = 3 * half;
    for (let c = 0, s = 3 * (point * frames + t), x = 0; c < 3; c++, s++, x += FEATURES) {
      const left = values[s - h]!;
      const right = values[s + h]!;
      const left3 = t >= 3 * half ? values[s - 3 * h]! : 2 * left - right;
      const right3 = t + 3 * half < frames ? values[s + 3 * h]! : 2 * right - left;
      const left5 = t >= 5 * half ? values[s - 5 * h]! : 2 * left3 - left;
      const right5 = t + 5 * half < frames ? values[s + 5 * h]! : 2 * right3 - right;
      base[c] = (left + right) / 2;
      features[x] = left3 - left - (right - right3);
      if (t >= 2 * half) features[x + 1] = values[s - 2 * h]! - (left3 + left) / 2;
      features[x + 2] = left5 - left3 - (right3 - right5);
      if (t >= 4 * half) features[x + 3] = values[s - 4 * h]! - (left3 + left5) / 2;
    }
  }

  /** Features of higher levels: Z(s) − (Z(s − half) + Z(s + half)) / 2 of a neighbour, 0 at the ends. at: index of its sample t. */
  private besideBetween(t: number, at: number, feature: number): void {
    const { half, features } = this;
    const { values, frames } = this.samples;
    const h = 3 * half;
    const hasBefore = t >= 2 * half;
    const hasAfter = t + 2 * half < frames;
    for (let c = 0, s = at, x = feature; c < 3; c++, s++, x += FEATURES) {
      const here = values[s]!;
      const left = values[s - h]!;
      const right = values[s + h]!;
      features[x] = here - (left + right) / 2;
      const before = hasBefore ? left - (values[s - 2 * h]! + here) / 2 : 0;
      const after = hasAfter ? right - (here + values[s + 2 * h]!) / 2 : 0;
      features[x + 1] = before + after;
    }
  }

  /** "Along the direction to the partner": writes `axes`, `predicted` and e. Returns whether the direction is used. */
  private direct(t: number): boolean {
    const { samples, linear, axes, predicted } = this;
    const partner = this.others[0]!;
    if (partner < 0 || !(this.weights > 0)) return false;
    const dx = linear[0]! - samples.get(t, partner, 0);
    const dy = linear[1]! - samples.get(t, partner, 1);
    const dz = linear[2]! - samples.get(t, partner, 2);
    const l = Math.sqrt(dx * dx + dy * dy + dz * dz);
    if (!(l > 8)) return false;
    const ux = dx / l;
    const uy = dy / l;
    const uz = dz / l;
    const e = this.distances / this.weights - l;
    const share = Math.min(1, Math.max(0, this.b / this.a));
    const along = share * e;
    predicted[0] = linear[0]! + along * ux;
    predicted[1] = linear[1]! + along * uy;
    predicted[2] = linear[2]! + along * uz;
    const ax = Math.abs(ux);
    const ay = Math.abs(uy);
    const az = Math.abs(uz);
    const k = ax < ay ? (ax < az ? 0 : 2) : ay < az ? 1 : 2;
    const uk = k === 0 ? ux : k === 1 ? uy : uz;
    let vx = (k === 0 ? 1 : 0) - uk * ux;
    let vy = (k === 1 ? 1 : 0) - uk * uy;
    let vz = (k === 2 ? 1 : 0) - uk * uz;
    const size = Math.sqrt(vx * vx + vy * vy + vz * vz);
    vx /= size;
    vy /= size;
    vz /= size;
    axes[0] = ux;
    axes[1] = uy;
    axes[2] = uz;
    axes[3] = vx;
    axes[4] = vy;
    axes[5] = vz;
    axes[6] = uy * vz - uz * vy;
    axes[7] = uz * vx - ux * vz;
    axes[8] = ux * vy - uy * vx;
    this.excess = e;
    return true;
  }

  /** Fills `around` with the activities around a sample. */
  private look(t: number, inside: boolean, directed: boolean): void {
    const { samples, point, half, step, around, others } = this;
    const { frames } = samples;
    around.class = inside ? Math.min(this.level, 5) : this.isFirst && t === 0 ? 6 : 7;
    around.slow = this.slow;
    const before = t >= step ? samples.activity(t - step, point) : this.slow >> 8;
    around.before = before;
    around.before2 = t >= 2 * step ? samples.activity(t - 2 * step, point) : before;
    let last = before;
    for (let q = 0; q < NEIGHBOURS; q++) {
      if (others[q]! >= 0) last = samples.activity(t, others[q]!);
      around.beside[q] = last;
    }
    around.after = others[0]! >= 0 && t + step < frames ? samples.activity(t + step, others[0]!) : around.beside[0]!;
    if (this.level === 0) around.around = 2 * before;
    else {
      const left = samples.activity(t - half, point);
      around.around = t + half < frames ? left + samples.activity(t + half, point) : 2 * left;
    }
    around.radial = 0;
    if (directed) {
      const r1 = t >= step ? samples.radialActivity(t - step, point) : 0;
      const r2 = t >= 2 * step ? samples.radialActivity(t - 2 * step, point) : 0;
      around.radial = 1 + halfOctaves(16 * (r1 + r2));
    }
  }

  /** Adds the lattice point to `predicted`. */
  private place(directed: boolean): void {
    const { predicted, z, axes } = this;
    for (let c = 0; c < 3; c++) {
      predicted[c]! += directed ? axes[c]! * z[0]! + axes[3 + c]! * z[1]! + axes[6 + c]! * z[2]! : z[c]!;
    }
  }

  /** "After each sample". */
  private update(t: number, inside: boolean, directed: boolean): void {
    const { samples, point, z, predicted, linear, base, features, filter, axes, products } = this;
    const radial = Math.abs(z[0]!);
    const activity = Math.min(MOST_ACTIVITY, radial + Math.abs(z[1]!) + Math.abs(z[2]!));
    samples.setActivity(t, point, activity, Math.min(MOST_ACTIVITY, radial));
    if (inside) this.slow += (256 * activity - this.slow) >> 4;
    const partner = this.others[0]!;
    if (partner >= 0) {
      const dx = predicted[0]! - samples.get(t, partner, 0);
      const dy = predicted[1]! - samples.get(t, partner, 1);
      const dz = predicted[2]! - samples.get(t, partner, 2);
      this.distances = 0.995 * this.distances + Math.sqrt(dx * dx + dy * dy + dz * dz);
      this.weights = 0.995 * this.weights + 1;
    }
    if (directed) {
      const e = this.excess;
      let along = 0;
      for (let c = 0; c < 3; c++) along += (predicted[c]! - linear[c]!) * axes[c]!;
      this.a = 0.98 * this.a + e * e;
      this.b = 0.98 * this.b + e * along;
    }
    if (!inside) return;
    for (let c = 0; c < 3; c++) {
      // learning changes the filter, so only the first coordinate's product is still valid
      const product = c === 0 ? products[0]! : filter.product(features, c * FEATURES);
      filter.learn(features, c * FEATURES, predicted[c]! - base[c]! - product, c === 0 ? 0.999 : 1);
    }
  }
}
