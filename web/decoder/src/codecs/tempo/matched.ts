/** Model 2, kind 2 of tempo: skeletons with other joint names, matched to the prior's. Ordered arithmetic, except completions. */

import type { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegersWithin } from "../../integers/read.js";
import type { Facts } from "../codec.js";
import { metricRoot, offsetsInOrder, skeletonParents } from "./directions.js";
import { BAND_STARTS, SPREADS, square } from "./logarithms.js";
import { readLevel, readLevels, variancesOf, weighted } from "./markers.js";
import { Basis, FIRST_ROWS, type Model, bandOf, completedBasis, predictSpreads, scalePlace, statisticsOf } from "./model.js";
import { type Matrix, cholesky, cross, divide, length, matrix, orthonormal, principal, product, rowOf, sizes, transposed, unit } from "./ordered.js";
import type { Prior } from "./prior.js";
import { Tree, breadthFirst, metricOf, parentsInOrder, priorTree, rotationsOf } from "./trees.js";

const MOST = 2 ** 40;
const BODY = -1;

/** Stored data of each point, in the order of the tree. */
interface Stored {
  hasTree: boolean;
  order: number[];
  parents: number[];
  /** The prior's joint of each point, −1 for none. */
  joints: number[];
  marks: number[];
  /** Bone vectors (points, 3), metres. */
  vectors: Float64Array;
}

export function matchedSkeleton(part: Bytes, prior: Prior, facts: Facts): Model {
  const theirs = priorTree(prior);
  const digits = part.foldedWithin(-40, 40, "the step of vectors");
  const levels = readLevels(part, { rest: -24, white: -150 });
  const unpredicted = readLevel(part);
  const stored = readStored(part, digits, theirs, facts);
  part.end();
  const paths = bonePaths(stored, theirs);
  const rest = treeAtRest(stored, paths, theirs);
  rest.check();
  const body = bodyTree(stored, rest, facts);
  const { dimensions } = rest;

  const root = cholesky(metricOf(rest));
  const y = squaredStatistics(prior);
  const { bases, variances } = predictedBases(rest, paths, root, y, prior, theirs);
  const statistics = statisticsOf(prior, "", dimensions);
  predictSpreads(statistics, variances, medians(prior), levels);
  for (let i = 0; i < dimensions; i++) {
    const row = (FIRST_ROWS + i) * SPREADS;
    for (let f = 0; f < SPREADS; f++) {
      if (isZero(rowOf(variances[bandOf(f)]!, i))) statistics.spreads[row + f]! += 4 * unpredicted;
    }
    statistics.means[FIRST_ROWS + i] = statistics.spreads[row]!;
  }
  scalePlace(statistics, theirs.points, facts.points);
  const withRoot = bases.map((basis) => new Basis(divide(basis, root), () => divide(completedBasis(basis), root)));
  return { statistics, bases: withRoot, dimensions, pose: { kind: "tree", tree: body, order: stored.order } };
}

function isZero(row: Float64Array): boolean {
  return row.every((v) => v === 0);
}

function readStored(part: Bytes, digits: number, theirs: Tree, facts: Facts): Stored {
  const { points } = facts;
  const hasTree = part.byte();
  check(hasTree <= 1, "tempo: a tree of an unknown form");
  const numbers = readIntegersWithin(part.blob(), points, 3, -2 * points - 64, 2 * points + 64, "tempo: joints");
  const joints: number[] = [];
  for (let p = 0; p < points; p++) {
    joints.push((joints[p - 1] ?? -1) + 1 + numbers[3 * p]!);
    check(joints[p]! >= -1 && joints[p]! < theirs.points, "tempo: a joint that the prior does not have");
  }
  const marks = joints.map((joint, p) => numbers[3 * p + 1]! + (joint >= 0 ? (theirs.hub[joint] ? 1 : 0) + (theirs.relative[joint] ? 2 : 0) : 0));
  check(marks.every((mark) => mark >= 0 && mark <= 3), "tempo: a mark that is out of range");
  if (!hasTree) check(joints.every((_, p) => numbers[3 * p + 2] === 0), "tempo: a parent without a tree");
  const parents = hasTree ? expectedParents(joints, theirs).map((parent, p) => parent + numbers[3 * p + 2]!) : skeletonParents(facts);
  const counts: number[] = joints.map((joint, p) => (joint < 0 ? 3 : hasTree ? (marks[p]! & 1 ? 3 : 1) : 0));
  const total = counts.reduce((sum, count) => sum + count, 0);
  const values = readIntegersWithin(part.rest(), total, 1, -MOST, MOST, "tempo: vectors");
  const vectors = new Float64Array(3 * points);
  let next = 0;
  counts.forEach((count, p) => {
    for (let c = 0; c < count; c++) vectors[3 * p + c] = values[next++]! * 2 ** -digits;
  });
  const order = breadthFirst(parents);
  return {
    hasTree: hasTree === 1,
    order,
    parents: parentsInOrder(order, parents),
    joints: order.map((p) => joints[p]!),
    marks: order.map((p) => marks[p]!),
    vectors: Float64Array.from(order.flatMap((p) => [...vectors.subarray(3 * p, 3 * p + 3)])),
  };
}

function expectedParents(joints: number[], theirs: Tree): number[] {
  const last = new Int32Array(theirs.points).fill(-1);
  joints.forEach((joint, p) => {
    if (joint >= 0) last[joint] = p;
  });
  return joints.map((joint, p) => {
    if (joint < 0) return p - 1;
    let above = theirs.parents[joint]!;
    while (above >= 0 && last[above]! < 0) above = theirs.parents[above]!;
    return above >= 0 ? last[above]! : -1;
  });
}

/** For each point, the path of prior bones that its bone corresponds to, from the end upwards. */
function bonePaths({ joints, parents }: Stored, theirs: Tree): number[][] {
  const paths: number[][] = [];
  joints.forEach((joint, j) => {
    let above = parents[j]!;
    while (above >= 0 && joints[above]! < 0) above = parents[above]!;
    if (joint < 0 || theirs.parents[joint]! < 0) paths.push([]);
    else if (above < 0) paths.push([joint]);
    else if (joints[above] === joint) paths.push(paths[above]!.length ? paths[above]! : [joint]);
    else {
      const line = [joint];
      let end = theirs.parents[joint]!;
      while (end >= 0 && end !== joints[above]) {
        line.push(end);
        end = theirs.parents[end]!;
      }
      paths.push(end >= 0 ? line : [joint]);
    }
  });
  return paths;
}

function treeAtRest({ joints, parents, marks, vectors }: Stored, paths: number[][], theirs: Tree): Tree {
  const rest = vectors.slice();
  joints.forEach((joint, j) => {
    if (joint < 0) return;
    for (let c = 0; c < 3; c++) rest[3 * j + c] = paths[j]!.reduce((sum, bone) => sum + theirs.vectors[3 * bone + c]!, 0);
  });
  return new Tree(parents, rest, marks.map((mark) => (mark & 1) !== 0), marks.map((mark) => (mark & 2) !== 0));
}

/** The tree of the decoded positions. */
function bodyTree({ hasTree, order, joints, vectors }: Stored, rest: Tree, facts: Facts): Tree {
  let body: Tree;
  if (!hasTree) body = rest.resized(offsetsInOrder(facts, order));
  else {
    const own = vectors.slice();
    joints.forEach((joint, j) => {
      if (joint < 0) return;
      const size = rest.lengths[j]!;
      const factor = size > 0 ? Math.max(size + vectors[3 * j]!, 0) / size : 1;
      for (let c = 3 * j; c < 3 * j + 3; c++) own[c] = rest.hub[j] ? rest.vectors[c]! + vectors[c]! : rest.vectors[c]! * factor;
    });
    body = new Tree(rest.parents, own, rest.hub, rest.relative);
  }
  body.check();
  check(body.moves.length === rest.moves.length && body.moves.every((j, i) => j === rest.moves[i]), "tempo: the bones with a direction differ from those at rest");
  return body;
}

/** Statistic f of component i of the prior: its mean for f = 0, otherwise spread f. */
function statisticOf(prior: Prior, i: number, f: number): number {
  const row = FIRST_ROWS + i;
  return f === 0 ? prior.arrays.numbers("means").data[row]! : prior.arrays.numbers("spreads").data[row * SPREADS + f]!;
}

function squaredStatistics(prior: Prior): Matrix {
  const components = prior.arrays.numbers("means").data.length - FIRST_ROWS;
  const y = matrix(components, SPREADS);
  for (let i = 0; i < y.data.length; i++) y.data[i] = square(statisticOf(prior, Math.floor(i / SPREADS), i % SPREADS));
  return y;
}

/** The median of each column of the statistics: the mean of the two in the middle, rounded towards 0. */
function medians(prior: Prior): number[] {
  const components = prior.arrays.numbers("means").data.length - FIRST_ROWS;
  return Array.from({ length: SPREADS }, (_, f) => {
    const column = Array.from({ length: components }, (_, i) => statisticOf(prior, i, f)).sort((a, b) => a - b);
    const middle = components >> 1;
    return components % 2 ? column[middle]! : Math.trunc((column[middle - 1]! + column[middle]!) / 2);
  });
}

/** For each band, the basis before completion, and the variances of its components (dimensions, 18). */
function predictedBases(rest: Tree, paths: number[][], root: Matrix, y: Matrix, prior: Prior, theirs: Tree): { bases: Matrix[]; variances: Matrix[] } {
  const n = rest.dimensions;
  const map = coordinateMap(rest, paths, theirs);
  const { shape, data } = prior.arrays.numbers("bases");
  const [, rows, columns] = shape as [number, number, number];
  const bases: Matrix[] = [];
  const variances: Matrix[] = [];
  for (let band = 0; band < 4; band++) {
    const components = matrix(rows, columns, data.subarray(band * rows * columns, (band + 1) * rows * columns));
    const a = product(product(divide(components, metricRoot(prior)), map), root);
    const first = principal(weighted(a, y, Math.max(BAND_STARTS[band]!, 1), BAND_STARTS[band + 1]!), n);
    const d = joined(first, orthonormal(outside(a, first), n - first.rows, 1e-14));
    bases.push(d);
    variances.push(variancesOf(d, a, y, n));
  }
  return { bases, variances };
}

/** The rows of A, scaled to unit length, then projected onto the complement of D. */
function outside(a: Matrix, d: Matrix): Matrix {
  let e = matrix(a.rows, a.columns, a.data.slice());
  sizes(a).forEach((size, r) => {
    const norm = Math.sqrt(Math.max(size, 1e-30));
    const row = rowOf(e, r);
    for (let c = 0; c < row.length; c++) row[c]! /= norm;
  });
  for (let round = 0; round < 2; round++) {
    const along = product(product(e, transposed(d)), d);
    e = matrix(e.rows, e.columns, e.data.map((v, i) => v - along.data[i]!));
  }
  return e;
}

function joined(a: Matrix, b: Matrix): Matrix {
  const out = matrix(a.rows + b.rows, a.columns);
  out.data.set(a.data);
  out.data.set(b.data, a.data.length);
  return out;
}

/** The map M (dimensions of the prior, dimensions of the file). */
function coordinateMap(rest: Tree, paths: number[][], theirs: Tree): Matrix {
  const out = matrix(theirs.dimensions, rest.dimensions);
  const rotated = new Map<number, (readonly [number, number, number] | undefined)[]>();
  theirs.moves.forEach((bone) => rotated.set(bone, []));
  rotationsOf(theirs).forEach(({ axis, bones }, i) => bones.forEach((bone) => (rotated.get(bone)![i] = axis)));
  const none = [0, 0, 0] as const;
  const axisOf = (bone: number, i: number) => rotated.get(bone)?.[i] ?? none;
  for (let i = 0; i < theirs.dimensions; i++) {
    const row = rowOf(out, i);
    const turns: [number, number, number][] = [];
    rest.joints.forEach((joint, number) => {
      const ref = joint.reference === BODY ? none : turns[joint.reference]!;
      if (joint.isHub) {
        const bone = rest.bonesOf(number).map((j) => paths[j]!.at(-1)).find((b) => b !== undefined && theirs.hub[b]);
        const own = bone === undefined ? none : axisOf(bone, i).map((v, c) => v - ref[c]!);
        row.set(own, joint.dimension);
        turns.push([ref[0] + own[0]!, ref[1] + own[1]!, ref[2] + own[2]!]);
        return;
      }
      const path = paths[joint.bone]!;
      if (path.length === 0) {
        turns.push([...ref]);
        return;
      }
      const v = rest.vectors.subarray(3 * joint.bone, 3 * joint.bone + 3);
      const size = length(v);
      let moved = cross(ref, unit(v)).map((x) => -x) as [number, number, number];
      for (const bone of path) {
        const scaled = [0, 1, 2].map((c) => theirs.vectors[3 * bone + c]! / size);
        const more = cross(axisOf(bone, i), scaled);
        moved = [moved[0] + more[0], moved[1] + more[1], moved[2] + more[2]];
      }
      const { first, second } = joint;
      const own0 = moved[0] * first[0] + moved[1] * first[1] + moved[2] * first[2];
      const own1 = moved[0] * second[0] + moved[1] * second[1] + moved[2] * second[2];
      row[joint.dimension] = own0;
      row[joint.dimension + 1] = own1;
      turns.push([0, 1, 2].map((c) => ref[c]! + own0 * second[c]! - own1 * first[c]!) as [number, number, number]);
    });
  }
  return out;
}
