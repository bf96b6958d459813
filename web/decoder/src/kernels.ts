/**
 * Kernels in WebAssembly: the C++ of the Python package's compiled module (wasm/kernels.cpp). scripts/wasm writes kernels.json.
 * The code in TypeScript does the same where an engine cannot run them, and says what is wrong with bytes that they refuse.
 */

import { inflate } from "./inflate.js";
import stored from "./kernels.json";

interface Exports {
  memory: WebAssembly.Memory;
  /** Frees all memory. */
  begin(): void;
  /** Takes memory, and returns its address. */
  reserve(bytes: number): number;
  lattice(...numbers: number[]): number;
  joints(...numbers: number[]): number;
}

type Numbers = Uint8Array | Int32Array | BigInt64Array | Float64Array;

/** Called kernels share one memory, which holds what the last call was given and returned. */
export class Kernels {
  private constructor(private readonly exports: Exports) {}

  /** The kernels; undefined where the engine has no WebAssembly with vectors, or the page does not allow it. */
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

  /** Calls a kernel with arrays and numbers. The result: `count` float64, valid until the next call; null if it refuses. */
  call(name: "lattice" | "joints", given: (Numbers | number)[], count: number): Float64Array | null {
    const { exports } = this;
    try {
      exports.begin();
      const numbers = given.map((each) => (typeof each === "number" ? each : this.copied(each)));
      const at = exports[name](...numbers);
      return at === 0 ? null : new Float64Array(exports.memory.buffer, at, count);
    } catch (error) {
      if (error instanceof WebAssembly.RuntimeError) return null; // no memory
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

/** The kernels, if `loadKernels` has found that they can be used. */
export function kernels(): Kernels | undefined {
  return loaded;
}
