/** Reads `.mocz` files of mocodec: compressed human motion. */

export { open, MoczFile } from "./file.js";
export type { Damage, Info, OpenOptions } from "./file.js";
export type { Body } from "./codecs/bodies.js";
export type { Cloud } from "./codecs/clouds/cloud.js";
export type { Event, Extras } from "./extras.js";
export type { Signal } from "./signals/signal.js";
export type { Source } from "./sources.js";
export type { ChunkPlace } from "./container/header.js";
export type { Skeleton } from "./container/skeleton.js";
export { ORDERS, type Limits } from "./container/orders.js";
export { StoredArray, StoredSignal, type Tree, type Value } from "./container/values.js";
export type { PriorLoader } from "./codecs/tempo/prior.js";
export * from "./errors.js";
