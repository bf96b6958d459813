/** Extras of a file: the value tree, its arrays and signals (docs/format.md, "Extras"). */

import { Bytes } from "./bytes.js";
import { fillArray } from "./container/arrays.js";
import { type Header, checksumHolds } from "./container/header.js";
import { CodedSignal, StoredArray, type Tree, TreeReader, checkEvents, sizeOf, treeStream } from "./container/values.js";
import { fromText } from "./container/tables.js";
import { check } from "./errors.js";
import labWords from "./lab_words.json";
import { type CodedPlace, type Signal, readHead, signalsOf } from "./signals/signal.js";
import type { ByteSource } from "./sources.js";

const SPARE_BYTES = 2 ** 28;
const UNPACK_RATIO = 1024;
const CHECKSUM_BYTES = 4;

/** A recorded event. */
export interface Event {
  /** Seconds from the first frame. */
  time: number;
  label: string;
  context: string;
}

/** All content besides the points. */
export interface Extras {
  /** All entries: parameters, notes, arrays, signals. */
  tree: Tree;
  events: Event[];
  signals: Signal[];
}

export async function readExtras(source: ByteSource, header: Header, headerEnd: number): Promise<Extras> {
  const { section, unpacked, signals } = header.extras;
  if (section === 0) return { tree: Object.create(null) as Tree, events: [], signals: [] };
  const bytes = await source.read(headerEnd, section + CHECKSUM_BYTES);
  check(checksumHolds(bytes), "the extras are damaged: their checksum does not match");
  check(unpacked <= SPARE_BYTES + UNPACK_RATIO * (section + signals), "the extras: an unpacked size that is out of range");
  const part = new Bytes(bytes.subarray(0, section), "the extras");
  const stream = treeStream(part, fromText(labWords.dictionary));
  const reader = new TreeReader(new Bytes(stream, "the extras"), true);
  const tree = reader.all();
  const places = new Map<CodedSignal, CodedPlace>();
  let budget = unpacked - stream.length;
  const start = headerEnd + section + CHECKSUM_BYTES;
  let offset = start;
  for (const item of reader.pending) {
    if (item instanceof StoredArray) budget -= fillArray(item, part, budget);
    else {
      const { head, bytes: size, type } = readHead(part, item);
      budget -= type.width * sizeOf(item.shape);
      check(budget >= 0, "the extras: a signal that is larger than declared");
      places.set(item, { head, offset, type });
      offset += size;
    }
  }
  part.end();
  check(offset === start + signals, "the extras: chunks of signals that do not fit");
  checkEvents(tree);
  return { tree, events: eventsOf(tree), signals: signalsOf(tree, source, places) };
}

function eventsOf(tree: Tree): Event[] {
  const events = (tree["events"] ?? []) as Tree[];
  return events.map((event) => ({
    time: event["time_s"] as number,
    label: String(event["label"] ?? ""),
    context: String(event["context"] ?? ""),
  }));
}
