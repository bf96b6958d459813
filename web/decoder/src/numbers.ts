/** Rounding and clipping of numbers. */

/** Rounds halves to even: 0.5 to 0, 1.5 to 2. */
export function halfToEven(value: number): number {
  const floor = Math.floor(value);
  const rest = value - floor;
  return rest > 0.5 || (rest === 0.5 && floor % 2 !== 0) ? floor + 1 : floor;
}

export function clip(value: number, least: number, most: number): number {
  return value < least ? least : value > most ? most : value;
}

export function clip8(value: number): number {
  return value < 0 ? 0 : value > 255 ? 255 : value;
}
