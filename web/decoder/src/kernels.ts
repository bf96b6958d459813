/**
 * Kernels in WebAssembly: the C++ of the Python package's compiled module (wasm/kernels.cpp). scripts/wasm writes kernels.json.
 * Without WebAssembly the TypeScript code decodes. It also decodes streams that kernels refuse, and reports their errors.
 */

import { inflate } from "./inflate.js";
import stored from "./kernels.json";

interface Exports {
  memory: WebAssembly.Memory;
  /** Frees all memory. */
  begin(): void;
  /** Allocates memory, and returns its address. */
  reserve(bytes: number): number;
  lattice(...numbers: number[]): number;
  joints(...numbers: number[]): number;
}

type Numbers = Uint8Array | Int32Array | BigInt64Array | Float64Array;

/** Calls kernels. All calls use one memory, which keeps the last call's arguments and result. */
export class Kernels {
  private constructor(private readonly exports: Exports) {}

  /** Loads the kernels; undefined if the engine lacks WebAssembly SIMD or the page forbids it. */
  static async load(): Promise<Kernels | undefined> {
    const { sin, cos, acos, atan2, hypot } = Math;
    try {
      const code = inflate(Uint8Array.from(atob(stored.code), (character) => character.charCodeAt(0)), stored.bytes);
      const { instance } = await WebAssembly.instantiate(code as BufferSource, { env: { sin, cos, acos, atan2, hypot } });
      return new Kernels(instance.exports as unknown as Exports);
    } catch {
      return undefined;
    }
  }

  /** Calls a kernel with arrays and numbers. Returns `count` float64, valid until the next call; null if the kernel refuses. */
  call(name: "lattice" | "joints", given: (Numbers | number)[], count: number): Float64Array | null {
    const { exports } = this;
    try {
      exports.begin();
      const numbers = given.map((each) => (typeof each === "number" ? each : this.copied(each)));
      const at = exports[name](...numbers);
      return at === 0 ? null : new Float64Array(exports.memory.buffer, at, count);
    } catch (error) {
      if (error instanceof WebAssembly.RuntimeError) return null; // out of memory
      throw error;
    }
  }

  private copied(values: Numbers): number {
    const at = this.exports.reserve(values.byteLength);
    new Uint8Array(this.exports.memory.buffer, at, values.byteLength).set(new Uint8Array(values.buffer, values.byteOffset, values.byteLength));
    return at;
  }
}

let loading: Promise<void> | undefined;
let loaded: Kernels | undefined;

/** Loads the kernels, once. */
export function loadKernels(): Promise<void> {
  return (loading ??= Kernels.load().then((found) => void (loaded = found)));
}

/** The kernels, if `loadKernels` could load them. */
export function kernels(): Kernels | undefined {
  return loaded;
}
