/** Extras of a file: the value tree, its arrays and signals (docs/format.md, "Extras"). */

import { Bytes } from "./bytes.js";
import { fillArray } from "./container/arrays.js";
import { type Header, checksumHolds } from "./container/header.js";
import { StoredArray, type Tree, TreeReader, checkEvents, treeStream } from "./container/values.js";
import { check } from "./errors.js";
import type { ByteSource } from "./sources.js";

const SPARE_BYTES = 2 ** 28;
const UNPACK_RATIO = 1024;

/** A recorded event. */
export interface Event {
  /** Seconds from the first frame. */
  time: number;
  label: string;
  context: string;
}

export interface Extras {
  tree: Tree;
  events: Event[];
}

export async function readExtras(source: ByteSource, header: Header, headerEnd: number): Promise<Extras> {
  const { section, unpacked, signals } = header.extras;
  if (section === 0) return { tree: Object.create(null) as Tree, events: [] };
  const bytes = await source.read(headerEnd, section + 4);
  check(checksumHolds(bytes), "the extras are damaged: their checksum does not match");
  check(unpacked <= SPARE_BYTES + UNPACK_RATIO * (section + signals), "the extras: an unpacked size that is out of range");
  const part = new Bytes(bytes.subarray(0, section), "the extras");
  const stream = treeStream(part);
  const reader = new TreeReader(new Bytes(stream, "the extras"), true);
  const tree = reader.all();
  let budget = unpacked - stream.length;
  for (const item of reader.pending) {
    if (item instanceof StoredArray) budget -= fillArray(item, part, budget);
  }
  part.end();
  checkEvents(tree);
  return { tree, events: eventsOf(tree) };
}

function eventsOf(tree: Tree): Event[] {
  const events = (tree["events"] ?? []) as Tree[];
  return events.map((event) => ({
    time: event["time_s"] as number,
    label: String(event["label"] ?? ""),
    context: String(event["context"] ?? ""),
  }));
}
