/**
 * Errors that the decoder throws on purpose, sorted by what the caller can do next. Names as in the Python package.
 *
 *     MocodecError
 *     ├── BadInput             the source or the arguments are not usable: correct them
 *     │   └── FrameOutOfRange  there is no frame with this number
 *     ├── UnknownCodec         the file names a codec that this version does not have
 *     ├── Unsupported          the file is fine, but this decoder cannot decode this part of it
 *     ├── TooNew               the file has a later format version
 *     ├── Truncated            the file ends too early: fetch it again
 *     └── Corrupt              bytes are damaged: restore the file from a copy
 */

/** Base class of all errors that the decoder throws on purpose. Messages have no control characters. */
export class MocodecError extends Error {
  /** Name of the class, even if a bundler renames the class. */
  override name = "MocodecError";

  constructor(message: string) {
    super(printable(message));
  }
}

/** The source or the arguments are not usable. */
export class BadInput extends MocodecError {
  override name = "BadInput";
}

/** There is no frame with this number. */
export class FrameOutOfRange extends BadInput {
  override name = "FrameOutOfRange";
}

/** This version does not have the file's codec. */
export class UnknownCodec extends MocodecError {
  override name = "UnknownCodec";
}

/** The file is fine, but this decoder cannot decode this part of it. */
export class Unsupported extends MocodecError {
  override name = "Unsupported";
}

/** The file has a later format version than this version reads. */
export class TooNew extends MocodecError {
  override name = "TooNew";
}

/** The data ends before it should. */
export class Truncated extends MocodecError {
  override name = "Truncated";
}

/** Damaged data: a checksum, a length or a bound does not hold. */
export class Corrupt extends MocodecError {
  override name = "Corrupt";
}

/** Throws Corrupt unless the condition holds. */
export function check(condition: boolean, message: string): asserts condition {
  if (!condition) throw new Corrupt(message);
}

/** The text without control characters, which could move the cursor of a terminal. */
function printable(text: string): string {
  return text.replace(/[\p{Cc}\p{Cf}\p{Zl}\p{Zp}]/gu, "\ufffd");
}
