/** A linear filter of ten features, found by recursive least squares (docs/payloads/tempo-lattice.md, "Filter"). */

export const FEATURES = 10;
const FIRST_COVARIANCE = 1 / 128;

export class Filter {
  readonly coefficients = new Float64Array(FEATURES);
  private readonly covariance = new Float64Array(FEATURES * FEATURES);
  private readonly gains = new Float64Array(FEATURES);

  /** Begins with these coefficients. */
  begin(coefficients: Float64Array): void {
    this.coefficients.set(coefficients);
    this.forget();
  }

  private forget(): void {
    this.covariance.fill(0);
    for (let i = 0; i < FEATURES; i++) this.covariance[i * FEATURES + i] = FIRST_COVARIANCE;
  }

  /** f·x, for features from index `at` on. */
  product(x: Float64Array, at: number): number {
    let sum = 0;
    for (let i = 0; i < FEATURES; i++) sum += this.coefficients[i]! * x[at + i]!;
    return sum;
  }

  learn(x: Float64Array, at: number, error: number, forgetting: number): void {
    const { covariance: c, gains: g, coefficients: f } = this;
    g.fill(0);
    for (let j = 0; j < FEATURES; j++) {
      const feature = x[at + j]!;
      const row = j * FEATURES;
      for (let i = 0; i < FEATURES; i++) g[i]! += feature * c[row + i]!;
    }
    let power = forgetting;
    for (let i = 0; i < FEATURES; i++) power += g[i]! * x[at + i]!;
    if (!(power >= 0.5 * forgetting && power < 1e300)) {
      this.forget();
      return;
    }
    const inverse = 1 / power;
    const growth = 1 / forgetting;
    for (let i = 0; i < FEATURES; i++) {
      const s = g[i]! * inverse;
      f[i]! += s * error;
      const row = i * FEATURES;
      for (let j = 0; j < FEATURES; j++) c[row + j] = (c[row + j]! - s * g[j]!) * growth;
    }
  }
}
