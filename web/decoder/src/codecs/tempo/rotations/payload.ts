/** Payloads of streams with rotations (docs/payloads/tempo-rotations.md): side values, corrections, or all angles directly. */

import { Bytes } from "../../../bytes.js";
import { inverseDct } from "../../../dct.js";
import { check } from "../../../errors.js";
import { type Quaternion, type Vector, multiplied, unitQuaternion } from "../../../geometry.js";
import { kernels } from "../../../kernels.js";
import type { ChunkDecoder, Decoded, StoredChunk } from "../../codec.js";
import { readCoefficients } from "../coefficients.js";
import { readDirect } from "../direct.js";
import { addWaves } from "../synthesis.js";
import { type Tables, solveAll, tablesOf } from "./compiled.js";
import { FIXED } from "./joints.js";
import type { Layer } from "./layer.js";
import { type Pose, forward, solve } from "./solve.js";

const DIRECT = 1;
const CORRECTED = 2;
const SIDE_SCALE = 3;
const SHRINK = 0.05;
const FIRST_ROWS = 4;

/** Inputs of the rotations: targets (frames, joints, 3), metres, and side values (frames, side values). */
interface Aims {
  targets: Float64Array;
  side: Float64Array;
}

export class WithRotations implements ChunkDecoder {
  private tables: Tables | undefined;

  /** targets: decodes the stream without rotations. */
  constructor(
    private readonly layer: Layer,
    private readonly targets: ChunkDecoder,
    private readonly millihertz: number,
  ) {}

  decode(window: StoredChunk[], which: number): Decoded {
    const { frames, payload } = window[which]!;
    const part = new Bytes(payload, "tempo");
    const own = new Bytes(part.blob(), "tempo");
    const targets = this.targets.decode([{ frames, payload: part.rest() }], 0).positions;
    const joints = this.layer.rules.parents.length;
    const { aims, poseOf } = this.poses(own, targets, frames);
    const loaded = kernels();
    if (aims && loaded) {
      this.tables ??= tablesOf(this.layer.rules);
      const solved = solveAll(loaded, this.tables, aims.targets, aims.side, frames);
      if (solved) return solved;
    }
    const rotations = new Float64Array(4 * frames * joints);
    const positions = new Float64Array(3 * frames * joints);
    for (let t = 0; t < frames; t++) {
      const { local, positions: placed } = poseOf(t);
      for (let j = 0, at = 4 * t * joints; j < joints; j++, at += 4) {
        const q = local[j]!;
        rotations[at] = q[0];
        rotations[at + 1] = q[1];
        rotations[at + 2] = q[2];
        rotations[at + 3] = q[3];
      }
      for (let j = 0, at = 3 * t * joints; j < joints; j++, at += 3) {
        const p = placed[j]!;
        positions[at] = p[0];
        positions[at + 1] = p[1];
        positions[at + 2] = p[2];
      }
    }
    return { positions, rotations };
  }

  /** The pose of each frame. aims: targets and side values that give the poses; absent in direct payloads. */
  private poses(own: Bytes, targets: Float64Array, frames: number): { aims?: Aims; poseOf: (t: number) => Pose } {
    const { layer } = this;
    const count = layer.nominal.length;
    if (own.left === 0) return this.aimed({ targets, side: repeated(layer.nominal, frames) });
    const kind = own.byte();
    check(kind < DIRECT + CORRECTED, "tempo: rotations of an unknown kind");
    const grid = kind ? 2 ** (own.foldedWithin(-51_200, 51_200, "the grid") / 256) : 0;
    if (kind === DIRECT) return { poseOf: this.direct(own.rest(), frames, grid) };
    const groups = Math.ceil(count / 3);
    const joints = layer.rules.parents.length;
    const coefficients = readCoefficients(own, frames, joints + groups, this.millihertz, layer.statistics, false);
    const side = this.sideValues(coefficients.values, coefficients.frequencies, coefficients.step, frames);
    if (kind !== CORRECTED) return this.aimed({ targets, side });
    // targets, then side values, three to a point and scaled to metres, so that corrections apply to both
    const lanes = 3 * (joints + groups);
    const both = new Float64Array(frames * lanes);
    const scale = SIDE_SCALE * layer.reach;
    for (let t = 0; t < frames; t++) {
      both.set(targets.subarray(3 * t * joints, 3 * (t + 1) * joints), t * lanes);
      for (let i = 0; i < count; i++) both[t * lanes + 3 * joints + i] = scale * side[t * count + i]!;
    }
    addWaves(both, coefficients, frames, joints + groups, grid, undefined);
    const corrected = new Float64Array(targets.length);
    for (let t = 0; t < frames; t++) {
      corrected.set(both.subarray(t * lanes, t * lanes + 3 * joints), 3 * t * joints);
      for (let i = 0; i < count; i++) side[t * count + i] = both[t * lanes + 3 * joints + i]! / scale;
    }
    return this.aimed({ targets: corrected, side });
  }

  private aimed(aims: Aims): { aims: Aims; poseOf: (t: number) => Pose } {
    const { rules, nominal } = this.layer;
    const count = nominal.length;
    const poseOf = (t: number) => solve(rules, vectorsAt(aims.targets, t, rules.parents.length), aims.side.subarray(t * count, (t + 1) * count));
    return { aims, poseOf };
  }

  /** Side values (frames, side values) from coefficients (frequencies, rows). */
  private sideValues(values: Float64Array, frequencies: number, step: number, frames: number): Float64Array {
    const { nominal, toSide } = this.layer;
    const count = nominal.length;
    const rows = FIRST_ROWS + count;
    const size = 2 ** (step / 32);
    const y = new Float64Array(frequencies * count);
    for (let f = 0; f < frequencies; f++) {
      for (let i = 0; i < count; i++) {
        const v = values[f * rows + FIRST_ROWS + i]!;
        if (v === 0) continue;
        const c = (v > 0 ? v - SHRINK : v + SHRINK) * size;
        for (let k = 0; k < count; k++) y[f * count + k]! += c * toSide.data[i * count + k]!;
      }
    }
    const side = inverseDct(y, frequencies, frames, count);
    for (let i = 0; i < side.length; i++) side[i]! += nominal[i % count]!;
    return side;
  }

  /** "Direct": angles, quaternions and positions of joints at targets, all on the grid. */
  private direct(data: Uint8Array, frames: number, grid: number): (t: number) => Pose {
    const { rules } = this.layer;
    const reaches = this.reaches();
    const widths = rules.joints.map(({ rule, form }) => (rule === FIXED ? 0 : form ? form.free.length : 4));
    const held = rules.joints.map(({ placed }, j) => placed || rules.parents[j]! < 0);
    const columns = widths.reduce((sum, width) => sum + width, 0) + 3 * held.filter(Boolean).length;
    const numbers = readDirect(data, frames, columns).map((v) => v * grid);
    return (t) => {
      let at = t * columns;
      const local: Quaternion[] = [];
      const places: Vector[] = [];
      rules.joints.forEach(({ usual, form }, j) => {
        const own = numbers.subarray(at, at + widths[j]!).map((v) => v / reaches[j]!);
        at += widths[j]!;
        local.push(widths[j] === 0 ? usual : form ? form.rotation(own) : multiplied(usual, unitQuaternion(own)));
        places.push(held[j] ? (Array.from(numbers.subarray(at, at + 3)) as Vector) : [0, 0, 0]);
        if (held[j]) at += 3;
      });
      return { local, positions: forward(rules, local, places) };
    };
  }

  /** Length of the chain below each joint, metres: the lever of its rotation. */
  private reaches(): number[] {
    const { rules, reach } = this.layer;
    const below = rules.parents.map(() => reach);
    for (let j = rules.parents.length - 1; j >= 0; j--) {
      const size = Math.hypot(...rules.offsets[j]!);
      if (rules.ownFrame) below[j]! += size;
      const parent = rules.parents[j]!;
      if (parent >= 0) below[parent] = Math.max(below[parent]!, below[j]! + (rules.ownFrame ? 0 : size));
    }
    return below;
  }
}

function repeated(values: Float64Array, times: number): Float64Array {
  const out = new Float64Array(values.length * times);
  for (let t = 0; t < times; t++) out.set(values, t * values.length);
  return out;
}

function vectorsAt(positions: Float64Array, frame: number, points: number): Vector[] {
  const out: Vector[] = [];
  for (let i = 3 * frame * points; i < 3 * (frame + 1) * points; i += 3) out.push([positions[i]!, positions[i + 1]!, positions[i + 2]!]);
  return out;
}
