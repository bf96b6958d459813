/** Orders of axes, and joint limits in them. */

export const ORDERS = ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"] as const;

/** Limits of each joint: order of axes, least and greatest angle of each axis, and frame of the axes. */
export interface Limits {
  /** Index in ORDERS for each joint. */
  orders: number[];
  /** (joints, 3, 2), radians; ±∞ for an axis without limits. */
  ranges: Float64Array;
  /** (joints, 4), quaternions, w first. */
  axes: Float64Array;
}
