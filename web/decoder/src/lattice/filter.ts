/** A linear filter of ten features, adapted by recursive least squares (docs/payloads/tempo-lattice.md, "Filter"). */

export const FEATURES = 10;
const FIRST_COVARIANCE = 1 / 128;

export class Filter {
  readonly coefficients = new Float64Array(FEATURES);
  private readonly covariance = new Float64Array(FEATURES * FEATURES);
  private readonly gains = new Float64Array(FEATURES);

  /** Resets the filter to these coefficients. */
  begin(coefficients: Float64Array): void {
    this.coefficients.set(coefficients);
    this.forget();
  }

  private forget(): void {
    this.covariance.fill(0);
    for (let i = 0; i < FEATURES; i++) this.covariance[i * FEATURES + i] = FIRST_COVARIANCE;
  }

  /** f·x, with the features from index `at` on. */
  product(x: Float64Array, at: number): number {
    const f = this.coefficients;
    return (
      f[0]! * x[at]! +
      f[1]! * x[at + 1]! +
      f[2]! * x[at + 2]! +
      f[3]! * x[at + 3]! +
      f[4]! * x[at + 4]! +
      f[5]! * x[at + 5]! +
      f[6]! * x[at + 6]! +
      f[7]! * x[at + 7]! +
      f[8]! * x[at + 8]! +
      f[9]! * x[at + 9]!
    );
  }

  /** One step of recursive least squares. Unrolled, since loops over ten numbers take twice as long. */
  learn(x: Float64Array, at: number, error: number, forgetting: number): void {
    const { covariance: c, coefficients: f } = this;
    let [g0, g1, g2, g3, g4, g5, g6, g7, g8, g9] = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    for (let j = 0, row = 0; j < FEATURES; j++, row += FEATURES) {
      const feature = x[at + j]!;
      g0 += feature * c[row]!;
      g1 += feature * c[row + 1]!;
      g2 += feature * c[row + 2]!;
      g3 += feature * c[row + 3]!;
      g4 += feature * c[row + 4]!;
      g5 += feature * c[row + 5]!;
      g6 += feature * c[row + 6]!;
      g7 += feature * c[row + 7]!;
      g8 += feature * c[row + 8]!;
      g9 += feature * c[row + 9]!;
    }
    const { gains: g } = this;
    g[0] = g0;
    g[1] = g1;
    g[2] = g2;
    g[3] = g3;
    g[4] = g4;
    g[5] = g5;
    g[6] = g6;
    g[7] = g7;
    g[8] = g8;
    g[9] = g9;
    let power = forgetting;
    for (let i = 0; i < FEATURES; i++) power += g[i]! * x[at + i]!;
    if (!(power >= 0.5 * forgetting && power < 1e300)) {
      this.forget();
      return;
    }
    const inverse = 1 / power;
    const growth = 1 / forgetting;
    for (let i = 0, row = 0; i < FEATURES; i++, row += FEATURES) {
      const s = g[i]! * inverse;
      f[i]! += s * error;
      c[row] = (c[row]! - s * g0) * growth;
      c[row + 1] = (c[row + 1]! - s * g1) * growth;
      c[row + 2] = (c[row + 2]! - s * g2) * growth;
      c[row + 3] = (c[row + 3]! - s * g3) * growth;
      c[row + 4] = (c[row + 4]! - s * g4) * growth;
      c[row + 5] = (c[row + 5]! - s * g5) * growth;
      c[row + 6] = (c[row + 6]! - s * g6) * growth;
      c[row + 7] = (c[row + 7]! - s * g7) * growth;
      c[row + 8] = (c[row + 8]! - s * g8) * growth;
      c[row + 9] = (c[row + 9]! - s * g9) * growth;
    }
  }
}
