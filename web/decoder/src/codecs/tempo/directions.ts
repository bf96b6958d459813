/** Models 2 and 3 of tempo: bone directions, for joints with names of the prior, or with a stored basis. */

import type { Bytes } from "../../bytes.js";
import { check } from "../../errors.js";
import { readIntegersWithin } from "../../integers/read.js";
import type { Facts } from "../codec.js";
import { Basis, type Model, completedBasis, priorBases, readStoredBasis } from "./model.js";
import { type Matrix, cholesky, divide, matrix } from "./ordered.js";
import { type Prior, jointsByName } from "./prior.js";
import { Tree, breadthFirst, metricOf, parentsInOrder, priorTree, roundedOffsets } from "./trees.js";

const MOST = 2 ** 40;

/** Offsets of the file's skeleton, in the order of a tree. Throws Corrupt without a skeleton. */
export function offsetsInOrder(facts: Facts, order: number[]): Float64Array {
  check(facts.skeleton !== undefined, "tempo: the model needs a skeleton");
  const offsets = roundedOffsets(facts.skeleton.offsets);
  return Float64Array.from(order.flatMap((p) => [offsets[3 * p]!, offsets[3 * p + 1]!, offsets[3 * p + 2]!]));
}

/** Parents of the file's skeleton. Throws Corrupt without one. */
export function skeletonParents(facts: Facts): number[] {
  check(facts.skeleton !== undefined, "tempo: the model needs a skeleton");
  return facts.skeleton.parents;
}

/** The matrix L of a prior of directions. */
export function metricRoot(prior: Prior): Matrix {
  const { shape, data } = prior.arrays.numbers("metric_root");
  return matrix(shape[0]!, shape[1]!, data);
}

/** Model 2, kinds 0 and 1: the prior's joints by name, with the file's skeleton or with measured proportions. */
export function namedDirections(kind: number, part: Bytes, prior: Prior, facts: Facts): Model {
  const joints = jointsByName(prior, facts.names);
  const order = joints.map((_, j) => joints.indexOf(j));
  const rest = priorTree(prior);
  const tree = kind === 0 ? rest.resized(offsetsInOrder(facts, order)) : measured(part, rest);
  part.end();
  const root = metricRoot(prior);
  const { bases, statistics } = priorBases(prior);
  return {
    statistics,
    bases: bases.map((basis) => Basis.of(divide(basis, root))),
    dimensions: rest.dimensions,
    pose: { kind: "tree", tree, order },
  };
}

/** The prior's tree, plus the stored differences of its bones. */
function measured(part: Bytes, rest: Tree): Tree {
  const step = 2 ** (part.foldedWithin(-6000, 6000, "the step of bones") / 32);
  const count = rest.moves.reduce((total, j) => total + (rest.hub[j] ? 3 : 1), 0);
  const numbers = readIntegersWithin(part.rest(), count, 1, -MOST, MOST, "tempo: bones");
  const vectors = rest.vectors.slice();
  let next = 0;
  for (const j of rest.moves) {
    if (rest.hub[j]) {
      for (let c = 0; c < 3; c++) vectors[3 * j + c]! += numbers[next++]! * step;
    } else {
      const factor = Math.max(rest.lengths[j]! + numbers[next++]! * step, 0) / rest.lengths[j]!;
      for (let c = 0; c < 3; c++) vectors[3 * j + c]! *= factor;
    }
  }
  const tree = new Tree(rest.parents, vectors, rest.hub, rest.relative);
  check(tree.dimensions === rest.dimensions, "tempo: a bone without length");
  return tree;
}

/** Model 3: directions with a stored basis. */
export function storedDirections(part: Bytes, prior: Prior, facts: Facts): Model {
  const { points } = facts;
  check(prior.isOfDirections, "tempo: the model needs a prior of directions");
  const step = 2 ** (part.foldedWithin(-2000, 2000, "the step of vectors") / 32);
  const hasTree = part.byte();
  check(hasTree <= 1, "tempo: a tree of an unknown form");
  const sizes = Array.from({ length: 2 + hasTree }, () => part.varint());
  let parents: number[];
  if (hasTree) {
    const numbers = readIntegersWithin(part.take(sizes.shift()!), points, 1, -points, points, "tempo: parents");
    parents = Array.from(numbers, (v, p) => v + p);
  } else {
    parents = skeletonParents(facts);
  }
  const vectors = readIntegersWithin(part.take(sizes[0]!), points, 3, -MOST, MOST, "tempo: vectors");
  const marks = readIntegersWithin(part.take(sizes[1]!), points, 1, 0, 3, "tempo: marks");
  const order = breadthFirst(parents);
  const inOrder = Float64Array.from(order.flatMap((p) => [vectors[3 * p]! * step, vectors[3 * p + 1]! * step, vectors[3 * p + 2]! * step]));
  const marked = (bit: number) => order.map((p) => (marks[p]! & bit) !== 0);
  let tree = new Tree(parentsInOrder(order, parents), inOrder, marked(1), marked(2));
  tree.check();
  if (!hasTree) {
    tree = tree.resized(offsetsInOrder(facts, order));
    tree.check();
  }
  const root = cholesky(metricOf(tree, (Math.sin(1e-4) / 1e-4) ** 2));
  const stored = readStoredBasis(part, tree.dimensions, null, prior);
  const basis = new Basis(divide(stored.known, root), () => divide(completedBasis(stored.known), root));
  return { statistics: stored.statistics, bases: [basis, basis, basis, basis], dimensions: tree.dimensions, pose: { kind: "tree", tree, order } };
}
