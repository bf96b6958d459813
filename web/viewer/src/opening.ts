/** Opens .mocz files with the decoder in web/decoder. */

import { type MoczFile, type PriorLoader, type Source, open } from "../../decoder/src/index.js";

/** Loads priors from a folder beside the page. */
const priors: PriorLoader = async (id) => {
  const url = new URL(`priors/${id}.npz`, location.href);
  const response = await fetch(url).catch(() => null);
  if (!response?.ok) throw new Error(`the file needs the prior ${id}, which is not beside this page: use "mocodec view"`);
  return new Uint8Array(await response.arrayBuffer());
};

/** Open a file; damaged chunks become gaps. */
export async function openFile(source: Source): Promise<MoczFile> {
  return open(source, { priors, salvage: true });
}
