/** Numbers as text. */

/** Units of length in a metre. */
const UNITS = { m: 1, cm: 100, mm: 1000, in: 1 / 0.0254 } as const;
export type Unit = keyof typeof UNITS;

let chosen: Unit | null = null;

/** Show lengths in this unit; null: choose it by the length. */
export function useUnit(unit: Unit | null): void {
  chosen = unit;
}

/** A length in metres, in the chosen unit or one that suits it; three digits, or all if `isExact`. */
export function length(metres: number | null | undefined, isExact = false): string {
  if (metres === null || metres === undefined || Number.isNaN(metres)) return "–";
  if (chosen) return `${digits(metres * UNITS[chosen])} ${chosen}`;
  if (metres === 0) return "0 mm";
  const size = Math.abs(metres);
  const [factor, unit] = size < 1e-6 ? [1e9, "nm"] : size < 1e-4 ? [1e6, "µm"] : size < 0.1 ? [1e3, "mm"] : size < 1 ? [100, "cm"] : [1, "m"];
  const text = isExact ? digits(metres * factor) : threeDigits(metres * factor);
  return `${text} ${unit}`;
}

/** A text of a file. Control characters and direction marks become their code points, so that no name can look like another. */
export function readable(text: string): string {
  return text.replace(/[\p{Cc}\p{Zl}\p{Zp}\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/gu, (character) => `⟨${character.codePointAt(0)!.toString(16).toUpperCase().padStart(4, "0")}⟩`);
}

function digits(value: number): string {
  return Number(value.toPrecision(3)).toLocaleString("en", { maximumSignificantDigits: 3 });
}

function threeDigits(value: number): string {
  const size = Math.abs(value);
  return value.toFixed(size < 9.995 ? 2 : size < 99.95 ? 1 : 0);
}

/** Bytes with a decimal unit. */
export function bytes(count: number | null): string {
  if (count === null) return "–";
  if (count < 1000) return `${count} B`;
  if (count < 1e6) return `${digits(count / 1e3)} kB`;
  if (count < 1e9) return `${digits(count / 1e6)} MB`;
  return `${digits(count / 1e9)} GB`;
}

/** A time: 4.250 s below a minute, 1:04.250 above. */
export function time(seconds: number): string {
  if (seconds < 60) return `${seconds.toFixed(2)} s`;
  const minutes = Math.floor(seconds / 60);
  const rest = (seconds - 60 * minutes).toFixed(2).padStart(5, "0");
  return minutes < 60 ? `${minutes}:${rest}` : `${Math.floor(minutes / 60)}:${String(minutes % 60).padStart(2, "0")}:${rest}`;
}

/** A whole number with thousands separated. */
export function whole(count: number): string {
  return count.toLocaleString("en");
}

/** A ratio: "217 : 1". */
export function ratio(value: number | null): string {
  return value === null ? "–" : `${value >= 100 ? whole(Math.round(value)) : digits(value)} : 1`;
}

/** Promises in words. */
export function promise(values: Record<string, number>): string {
  const words = Object.entries(values).map(([name, value]) => {
    if (name === "max_error") return `max ${length(value, true)}`;
    if (name === "mean_error") return `mean ${length(value, true)}`;
    if (name === "max_rotation") return `rotation ${digits(value)}°`;
    if (name === "ratio") return `ratio ${digits(value)}`;
    if (name === "size") return `size ${bytes(value)}`;
    if (name === "psnr") return `${digits(value)} dB`;
    return `${name} ${digits(value)}`;
  });
  return words.join(", ") || "none";
}
