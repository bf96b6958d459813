/** The codec `tempo` (docs/payloads/tempo.md): shared bytes and chunks. */

import { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegersWithin } from "../../integers/read.js";
import { halfToEven } from "../../numbers.js";
import { Gaps } from "../../stages.js";
import type { ChunkDecoder, Decoded, Facts, StoredChunk } from "../codec.js";
import { readDirect } from "./direct.js";
import { namedDirections, storedDirections } from "./directions.js";
import { type Model, namedPoints, storedPoints } from "./model.js";
import { toAxes } from "./pose.js";
import { type Prior, type PriorLoader, loadPrior } from "./prior.js";
import { addWaves, synthesised } from "./synthesis.js";
import { readCoefficients } from "./coefficients.js";

const MODEL = 3;
const DIRECT = 4;
const WEIGHTS = 8;
const FALLBACK = 16;
const REPEATS = 32;
const NEIGHBOURS = 64;

/** Reads the shared bytes, and loads the prior that they name. */
export async function openTempo(facts: Facts, priors: PriorLoader): Promise<ChunkDecoder> {
  check(facts.shared.length === (facts.rotations ? 2 : 1), "tempo: a wrong number of shared blobs");
  const { decoder, millihertz } = await openPositions(facts, priors);
  if (!facts.rotations) return decoder;
  const [{ readLayer }, { WithRotations }, { loadKernels }] = await Promise.all([
    import("./rotations/layer.js"),
    import("./rotations/payload.js"),
    import("../../kernels.js"),
  ]);
  await loadKernels();
  const layer = await readLayer(facts.shared[1]!, facts.skeleton, (id) => loadPrior(id, priors));
  return new WithRotations(layer, decoder, millihertz);
}

async function openPositions(facts: Facts, priors: PriorLoader): Promise<{ decoder: ChunkDecoder; millihertz: number }> {
  const part = new Bytes(facts.shared[0]!, "tempo");
  const flags = part.byte();
  const [direct, fallback] = [(flags & DIRECT) !== 0, (flags & FALLBACK) !== 0];
  check(
    flags < 128 && !(direct && fallback) && (!(direct || fallback) || (flags & MODEL) === 0) && !(fallback && flags & (WEIGHTS | NEIGHBOURS)),
    "tempo: flags that contradict each other",
  );
  const repeats = (flags & REPEATS) !== 0;
  const millihertz = repeats ? part.varintWithin(1, 2 ** 40 - 1, "the rate") : halfToEven(1000 * facts.rate);
  const weights = flags & WEIGHTS ? Float64Array.from(part.take(facts.points), (byte) => 2 ** (byte / 16)) : undefined;
  const lattice = flags & NEIGHBOURS ? await latticeOf(part.blob(), facts.points) : undefined;
  if (fallback) {
    const shared = [part.rest()];
    const { openHou2014 } = await import("../hou2014.js");
    const inner = await openHou2014({ points: facts.points, parents: facts.skeleton?.parents, shared });
    return { decoder: new Tempo(facts, { repeats, millihertz, weights, model: undefined, fallback: inner, lattice }), millihertz };
  }
  let model: Model | undefined;
  if (!direct) {
    const id = Array.from(part.take(4), (byte) => byte.toString(16).padStart(2, "0")).join("");
    model = await readModel(flags & MODEL, part, await loadPrior(id, priors), facts);
  }
  part.end();
  return { decoder: new Tempo(facts, { repeats, millihertz, weights, model, fallback: undefined, lattice }), millihertz };
}

async function readModel(number: number, part: Bytes, prior: Prior, facts: Facts): Promise<Model> {
  if (number === 1) return storedPoints(part, prior, facts);
  if (number === 3) return storedDirections(part, prior, facts);
  const kind = part.byte();
  if (number === 0) {
    check(kind <= 1, "tempo: a kind that is reserved");
    return kind === 0 ? namedPoints(part, prior, facts) : (await import("./markers.js")).markersOnBones(part, prior, facts);
  }
  check(kind <= 2 && prior.isOfDirections, "tempo: a kind that is reserved, or a prior of points");
  if (kind < 2) return namedDirections(kind, part, prior, facts);
  return (await import("./matched.js")).matchedSkeleton(part, prior, facts);
}

interface Stream {
  repeats: boolean;
  millihertz: number;
  weights: Float64Array | undefined;
  model: Model | undefined;
  /** Decodes the chunks or, with repeats, their distinct frames. */
  fallback: ChunkDecoder | undefined;
  lattice: LatticeReader | undefined;
}

/** Positions (frames, points, 3) in half steps, for the samples outside `apart`. */
type LatticeReader = (data: Uint8Array, frames: number, apart: Uint8Array | null) => Float64Array;

async function latticeOf(neighbours: Uint8Array, points: number): Promise<LatticeReader> {
  const [{ readLattice, readNetwork }, { loadKernels }] = await Promise.all([import("../../lattice/lattice.js"), import("../../kernels.js")]);
  await loadKernels();
  const network = readNetwork(neighbours, points);
  return (data, frames, apart) => readLattice(data, frames, points, apart, network);
}

class Tempo implements ChunkDecoder {
  constructor(
    private readonly facts: Facts,
    private readonly stream: Stream,
  ) {}

  decode(window: StoredChunk[], which: number): Decoded {
    const { frames, payload } = window[which]!;
    if (!this.stream.repeats) return { positions: this.chunk(payload, frames) };
    const { lengths, rest } = readRuns(payload, frames);
    const distinct = this.chunk(rest, lengths.length);
    return { positions: repeated(distinct, lengths, frames, 3 * this.facts.points) };
  }

  private chunk(payload: Uint8Array, frames: number): Float64Array {
    const { points, up } = this.facts;
    const { weights, model, millihertz, fallback, lattice } = this.stream;
    if (fallback) return fallback.decode([{ frames, payload }], 0).positions;
    const part = new Bytes(payload, "tempo");
    const flags = part.byte();
    check(flags < 16 && (flags & 3) !== 3, "tempo: flags of a chunk that are reserved");
    const gaps = Gaps.read(flags & 8 ? part.blob() : new Uint8Array(0), frames, points);
    const grid = flags & 4 ? 2 ** (part.foldedWithin(-51_200, 51_200, "the grid") / 256) : 0;
    let positions: Float64Array;
    if (flags & 1) {
      positions = readDirect(part.rest(), frames, 3 * points);
      scale(positions, grid, weights, points);
    } else if (flags & 2) {
      check(lattice !== undefined, "tempo: a lattice without neighbours");
      positions = lattice(part.rest(), frames, gaps.apart());
      scale(positions, grid, weights, points);
    } else {
      check(model !== undefined, "tempo: coefficients without a model");
      const coefficients = readCoefficients(part, frames, points, millihertz, model.statistics);
      positions = synthesised(coefficients, model, frames, points, millihertz);
      addWaves(positions, coefficients, frames, points, grid, weights);
    }
    gaps.restore(positions);
    toAxes(positions, up);
    return positions;
  }
}

/** Multiplies integers by the grid, and divides them by the weights of their points. */
function scale(positions: Float64Array, grid: number, weights: Float64Array | undefined, points: number): void {
  for (let i = 0; i < positions.length; i++) {
    const value = positions[i]! * grid;
    positions[i] = weights ? value / weights[Math.floor(i / 3) % points]! : value;
  }
}

function readRuns(payload: Uint8Array, frames: number): { lengths: Float64Array; rest: Uint8Array } {
  const part = new Bytes(payload, "tempo");
  const count = part.varintWithin(1, frames, "the number of distinct frames");
  const size = part.varint();
  let lengths: Float64Array;
  if (size) lengths = readIntegersWithin(part.take(size), count, 1, 1, frames, "tempo: runs");
  else {
    const each = part.varint();
    lengths = new Float64Array(count).fill(each);
    lengths[count - 1] = frames - (count - 1) * each;
    check((each >= 1 || count === 1) && lengths[count - 1]! >= 1, "tempo: runs that do not fit");
  }
  check(lengths.reduce((sum, length) => sum + length, 0) === frames, "tempo: runs that do not fit");
  return { lengths, rest: part.rest() };
}

function repeated(distinct: Float64Array, lengths: Float64Array, frames: number, lanes: number): Float64Array {
  const out = new Float64Array(frames * lanes);
  let at = 0;
  lengths.forEach((length, i) => {
    for (let n = 0; n < length; n++, at += lanes) out.set(distinct.subarray(i * lanes, (i + 1) * lanes), at);
  });
  return out;
}
