/** Files that a user drops on the page: .mocz, decoded here; two of equal shape are compared. */

import type { Session } from "./session.ts";

export async function dropped(files: File[], progress: (share: number) => void): Promise<Session> {
  void files;
  progress(0);
  throw new Error("this page cannot open files yet: run mocodec view FILE");
}
