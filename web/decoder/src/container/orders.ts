/** Orders of axes, and joint limits in them. */

export const ORDERS = ["xyz", "xzy", "yxz", "yzx", "zxy", "zyx"] as const;

/** For each joint: its order of axes, the least and greatest angle of each (radians), and the frame of the axes. */
export interface Limits {
  /** Index in ORDERS of each joint. */
  orders: number[];
  /** (joints, 3, 2), radians; ±∞ for an axis without limits. */
  ranges: Float64Array;
  /** (joints, 4), quaternions, w first. */
  axes: Float64Array;
}
