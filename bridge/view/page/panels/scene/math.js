// @ts-check
// Vectors, quaternions (x, y, z, w), poses, and matrices in columns, as WebGL has them.

/**
 * @typedef {number[]} Vec3
 * @typedef {number[]} Quat
 * @typedef {{ p: Vec3, q: Quat }} Pose  `a_from_b`: turns by `q`, then moves by `p`
 */

/** @type {() => Pose} */
export const identity = () => ({ p: [0, 0, 0], q: [0, 0, 0, 1] });
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
/** @param {Vec3} a @param {number} s @returns {Vec3} */
export const scale = (a, s) => [a[0] * s, a[1] * s, a[2] * s];
/** @param {Vec3} a @param {Vec3} b */
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
/** @param {Vec3} a @param {Vec3} b @returns {Vec3} */
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
/** @param {Vec3} a @returns {Vec3} */
export const unit = (a) => scale(a, 1 / (Math.hypot(...a) || 1));

/** @param {Quat} a @param {Quat} b @returns {Quat} */
export const multiply = (a, b) => [
  a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1],
  a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
  a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3],
  a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2],
];
/** @param {Quat} q @param {Vec3} v @returns {Vec3} */
export function rotate(q, v) {
  const t = scale(cross(q, v), 2);
  return add(add(v, scale(t, q[3])), cross(q, t));
}
/** @param {Vec3} axis @param {number} angle @returns {Quat} */
export function turn(axis, angle) {
  const s = Math.sin(angle / 2);
  const [x, y, z] = unit(axis);
  return [x * s, y * s, z * s, Math.cos(angle / 2)];
}
/** Roll, pitch, yaw about fixed axes, as in URDF. @param {number} r @param {number} p @param {number} y @returns {Quat} */
export const rollPitchYaw = (r, p, y) => multiply(turn([0, 0, 1], y), multiply(turn([0, 1, 0], p), turn([1, 0, 0], r)));

/** @param {Pose} a @param {Pose} b @returns {Pose} */
export const compose = (a, b) => ({ p: add(a.p, rotate(a.q, b.p)), q: multiply(a.q, b.q) });
/** @param {Pose} a @returns {Pose} */
export function inverse({ p, q }) {
  const back = [-q[0], -q[1], -q[2], q[3]];
  return { p: scale(rotate(back, p), -1), q: back };
}

/** @param {Pose} pose @param {Vec3} [size] @returns {Float32Array} */
export function matrix({ p, q }, size = [1, 1, 1]) {
  const [x, y, z, w] = q;
  const [a, b, c] = size;
  return Float32Array.of(
    (1 - 2 * (y * y + z * z)) * a, 2 * (x * y + z * w) * a, 2 * (x * z - y * w) * a, 0,
    2 * (x * y - z * w) * b, (1 - 2 * (x * x + z * z)) * b, 2 * (y * z + x * w) * b, 0,
    2 * (x * z + y * w) * c, 2 * (y * z - x * w) * c, (1 - 2 * (x * x + y * y)) * c, 0,
    p[0], p[1], p[2], 1,
  );
}
/** @param {Float32Array} a @param {Float32Array} b */
export function product(a, b) {
  const out = new Float32Array(16);
  for (let column = 0; column < 4; column++) {
    for (let row = 0; row < 4; row++) {
      let sum = 0;
      for (let k = 0; k < 4; k++) sum += a[k * 4 + row] * b[column * 4 + k];
      out[column * 4 + row] = sum;
    }
  }
  return out;
}
/** @param {number} fieldOfView rad, vertical @param {number} aspect @param {number} near @param {number} far */
export function perspective(fieldOfView, aspect, near, far) {
  const f = 1 / Math.tan(fieldOfView / 2);
  return Float32Array.of(f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0);
}
/** @param {Vec3} eye @param {Vec3} target @param {Vec3} up */
export function lookAt(eye, target, up) {
  const back = unit(sub(eye, target));
  const right = unit(cross(up, back));
  const over = cross(back, right);
  return Float32Array.of(right[0], over[0], back[0], 0, right[1], over[1], back[1], 0, right[2], over[2], back[2], 0,
    -dot(right, eye), -dot(over, eye), -dot(back, eye), 1);
}
/** Where a point is on the screen: x and y from −1 to 1, and the distance; nothing behind the camera. @param {Float32Array} m @param {Vec3} p */
export function project(m, p) {
  const at = (/** @type {number} */ row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row];
  const w = at(3);
  return w > 1e-6 ? [at(0) / w, at(1) / w, w] : null;
}

/** @param {{ x: number, y: number, z: number }} v @returns {Vec3} */
export const vector = (v) => [v.x, v.y, v.z];
/** Of a message `geometry_msgs/Pose`. @param {any} pose @returns {Pose} */
export function poseOf({ position, orientation: { x, y, z, w } }) {
  const length = Math.hypot(x, y, z, w);
  return { p: vector(position), q: length > 1e-9 ? [x / length, y / length, z / length, w / length] : [0, 0, 0, 1] };
}
