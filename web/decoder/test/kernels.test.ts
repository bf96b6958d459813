/** Files decode to the same numbers with and without the WebAssembly kernels. */

import { afterEach, describe, expect, test, vi } from "vitest";
import { goldenBytes, priors } from "./golden.js";

const LATTICE = ["tempo-lattice", "tempo-lattice-joints", "tempo-lattice-spikes", "hou2014-markers-fine", "liu2006-markers-fine"];
const ROTATIONS = ["rotations-figure", "rotations-own-frame", "rotations-translations"];
/** Kernels sum products in another order. */
const TOLERANCE = 1e-9;

afterEach(() => {
  vi.unstubAllGlobals();
  vi.resetModules();
});

async function decoded(name: string, withKernels: boolean): Promise<{ positions: Float64Array; rotations: Float64Array | undefined }> {
  vi.resetModules();
  if (!withKernels) vi.stubGlobal("WebAssembly", undefined);
  const { open } = await import("../src/index.js");
  const { kernels } = await import("../src/kernels.js");
  const file = await open(goldenBytes(name), { priors });
  const positions = await file.frames();
  const rotations = file.info.rotations ? await file.rotations() : undefined;
  expect(kernels() !== undefined).toBe(withKernels);
  vi.unstubAllGlobals();
  return { positions, rotations };
}

describe("kernels in WebAssembly", () => {
  test.each(LATTICE)("%s: the same bits", async (name) => {
    const { positions } = await decoded(name, true);
    expect(positions).toEqual((await decoded(name, false)).positions);
  });

  test.each(ROTATIONS)("%s: the same rotations and positions", async (name) => {
    const [one, other] = [await decoded(name, true), await decoded(name, false)];
    for (const key of ["positions", "rotations"] as const) {
      expect(Math.max(...one[key]!.map((v, i) => Math.abs(v - other[key]![i]!)))).toBeLessThanOrEqual(TOLERANCE);
    }
  });
});
