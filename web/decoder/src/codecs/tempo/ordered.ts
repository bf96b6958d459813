/**
 * Ordered arithmetic (docs/payloads/tempo-models.md): float64 operations in exactly the order of the page, because spreads, which
 * choose tables, depend on the results. Plain arithmetic suffices, since JavaScript has no fused multiply-add.
 */

/** A matrix, row by row. */
export interface Matrix {
  rows: number;
  columns: number;
  data: Float64Array;
}

export function matrix(rows: number, columns: number, data: Float64Array = new Float64Array(rows * columns)): Matrix {
  return { rows, columns, data };
}

export function rowOf(m: Matrix, i: number): Float64Array {
  return m.data.subarray(i * m.columns, (i + 1) * m.columns);
}

/** SUM of the first `length` numbers of a buffer, in pairs; the buffer is overwritten. */
export function sum(buffer: Float64Array, length = buffer.length): number {
  if (length === 0) return 0;
  for (let n = length; n > 1; ) {
    const half = n >> 1;
    for (let i = 0; i < half; i++) buffer[i]! += buffer[half + i]!;
    if (n & 1) buffer[0]! += buffer[n - 1]!;
    n = half;
  }
  return buffer[0]!;
}

/** A · B. */
export function product(a: Matrix, b: Matrix): Matrix {
  const out = matrix(a.rows, b.columns);
  for (let r = 0; r < a.rows; r++) {
    const row = rowOf(out, r);
    for (let i = 0; i < a.columns; i++) {
      const factor = a.data[r * a.columns + i]!;
      const other = i * b.columns;
      for (let c = 0; c < b.columns; c++) row[c]! += factor * b.data[other + c]!;
    }
  }
  return out;
}

export function transposed(m: Matrix): Matrix {
  const out = matrix(m.columns, m.rows);
  for (let r = 0; r < m.rows; r++) for (let c = 0; c < m.columns; c++) out.data[c * m.rows + r] = m.data[r * m.columns + c]!;
  return out;
}

export function length(v: ArrayLike<number>): number {
  return Math.sqrt(v[0]! * v[0]! + v[1]! * v[1]! + v[2]! * v[2]!);
}

export function unit(v: ArrayLike<number>): [number, number, number] {
  const size = length(v);
  return [v[0]! / size, v[1]! / size, v[2]! / size];
}

export function cross(a: ArrayLike<number>, b: ArrayLike<number>): [number, number, number] {
  return [a[1]! * b[2]! - a[2]! * b[1]!, a[2]! * b[0]! - a[0]! * b[2]!, a[0]! * b[1]! - a[1]! * b[0]!];
}

/** Squared lengths of rows. */
export function sizes(m: Matrix): Float64Array {
  const buffer = new Float64Array(m.columns);
  return Float64Array.from({ length: m.rows }, (_, i) => {
    const row = rowOf(m, i);
    for (let c = 0; c < m.columns; c++) buffer[c] = row[c]! * row[c]!;
    return sum(buffer);
  });
}

/** ORTHONORMAL: Gram–Schmidt on rows, the longest row first. */
export function orthonormal(from: Matrix, most: number, shortest: number): Matrix {
  const rows = matrix(from.rows, from.columns, from.data.slice());
  const size = sizes(rows);
  const floor = Math.max(shortest, largest(size) * 1e-10);
  const found: Float64Array[] = [];
  const buffer = new Float64Array(Math.max(rows.columns, rows.rows));
  for (let round = 0; round < Math.min(most, rows.rows); round++) {
    const i = indexOfLargest(size);
    if (!(size[i]! >= floor)) break;
    const u = againstFound(rowOf(rows, i), Math.sqrt(size[i]!), found, buffer);
    found.push(u);
    size[i] = 0;
    for (let r = 0; r < rows.rows; r++) {
      if (size[r]! < 0.5 * floor) continue; // stays too short: rows only get shorter
      const row = rowOf(rows, r);
      const part = dot(row, u, buffer);
      for (let c = 0; c < row.length; c++) {
        row[c]! -= u[c]! * part;
        buffer[c] = row[c]! * row[c]!;
      }
      size[r] = sum(buffer, row.length);
    }
  }
  const out = matrix(found.length, from.columns);
  found.forEach((u, i) => rowOf(out, i).set(u));
  return out;
}

/** The unit vector of a row without its components along `found`. */
function againstFound(row: Float64Array, size: number, found: Float64Array[], buffer: Float64Array): Float64Array {
  const v = row.map((x) => x / size);
  const parts = found.map((other) => dot(other, v, buffer));
  for (let c = 0; c < v.length; c++) {
    for (let j = 0; j < found.length; j++) buffer[j] = found[j]![c]! * parts[j]!;
    v[c]! -= sum(buffer, found.length);
  }
  const norm = Math.sqrt(dot(v, v, buffer));
  return v.map((x) => x / norm);
}

function dot(a: Float64Array, b: Float64Array, buffer: Float64Array): number {
  for (let c = 0; c < a.length; c++) buffer[c] = a[c]! * b[c]!;
  return sum(buffer, a.length);
}

function largest(values: Float64Array): number {
  return values.length ? values[indexOfLargest(values)]! : 0;
}

function indexOfLargest(values: Float64Array): number {
  let found = 0;
  for (let i = 1; i < values.length; i++) if (values[i]! > values[found]!) found = i;
  return found;
}

/** PRINCIPAL: ORTHONORMAL vectors of rows, refined once. */
export function principal(rows: Matrix, most: number): Matrix {
  const found = orthonormal(rows, most, 1e-30);
  if (found.rows === 0) return found;
  return orthonormal(product(product(found, transposed(rows)), rows), most, 1e-30);
}

/** CHOLESKY: the lower triangular L with L Lᵀ = A. */
export function cholesky(from: Matrix): Matrix {
  const n = from.rows;
  const a = from.data.slice();
  const lower = matrix(n, n);
  for (let i = 0; i < n; i++) {
    const root = Math.sqrt(a[i * n + i]!);
    for (let r = i; r < n; r++) lower.data[r * n + i] = a[r * n + i]! / root;
    for (let r = i; r < n; r++) {
      for (let c = i; c < n; c++) a[r * n + c]! -= lower.data[r * n + i]! * lower.data[c * n + i]!;
    }
  }
  return lower;
}

/** DIVIDE: rows · L⁻¹. */
export function divide(rows: Matrix, lower: Matrix): Matrix {
  const n = lower.rows;
  const out = matrix(rows.rows, n, rows.data.slice());
  for (let r = 0; r < rows.rows; r++) {
    const row = rowOf(out, r);
    for (let i = n - 1; i >= 0; i--) {
      row[i]! /= lower.data[i * n + i]!;
      for (let j = 0; j < i; j++) row[j]! -= row[i]! * lower.data[i * n + j]!;
    }
  }
  return out;
}

/** Smaller entries of orthonormal rows may be zeros with rounding errors, of either sign. */
const ZERO = 1e-9;

/** COMPLETE: completes orthonormal rows to a basis of the complement of `excluded`. Not in ordered arithmetic. */
export function complete(rows: Matrix, excluded: Matrix = matrix(0, rows.columns)): Matrix {
  const n = rows.columns;
  const count = rows.rows + excluded.rows;
  const q = matrix(count, n); // column i of the page's Q is row i here
  q.data.set(rows.data);
  q.data.set(excluded.data, rows.data.length);
  const mirrors: Float64Array[] = [];
  for (let i = 0; i < count; i++) {
    const u = rowOf(q, i).slice(i);
    u[0]! += u[0]! > (i ? -ZERO : ZERO) ? 1 : -1;
    const size = Math.sqrt(u.reduce((total, x) => total + x * x, 0));
    for (let k = 0; k < u.length; k++) u[k]! /= size;
    mirrors.push(u);
    for (let r = 0; r < count; r++) reflect(rowOf(q, r).subarray(i), u);
  }
  const out = matrix(n - excluded.rows, n);
  out.data.set(rows.data);
  for (let r = rows.rows; r < out.rows; r++) {
    const row = rowOf(out, r);
    row[r + excluded.rows] = 1;
    for (let i = count - 1; i >= 0; i--) reflect(row.subarray(i), mirrors[i]!);
  }
  return out;
}

function reflect(v: Float64Array, u: Float64Array): void {
  let part = 0;
  for (let k = 0; k < u.length; k++) part += u[k]! * v[k]!;
  for (let k = 0; k < u.length; k++) v[k]! -= 2 * u[k]! * part;
}
