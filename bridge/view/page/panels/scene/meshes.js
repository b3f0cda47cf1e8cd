// @ts-check
// Triangles: basic shapes, and STL files (binary and text).

/** @typedef {{ positions: Float32Array, normals: Float32Array, indices?: Uint32Array }} Mesh */

/** @param {number[][]} points @param {number[][]} normals @param {number[]} indices @returns {Mesh} */
const mesh = (points, normals, indices) =>
  ({ positions: Float32Array.from(points.flat()), normals: Float32Array.from(normals.flat()), indices: Uint32Array.from(indices) });

/** Edges of 1. */
export function box() {
  const [points, normals, indices] = /** @type {[number[][], number[][], number[]]} */ ([[], [], []]);
  for (let axis = 0; axis < 3; axis++) {
    for (const side of [-1, 1]) {
      const start = points.length;
      for (const [u, v] of [[-1, -1], [1, -1], [1, 1], [-1, 1]]) {
        const [point, normal] = [[0, 0, 0], [0, 0, 0]];
        point[axis] = side / 2; point[(axis + 1) % 3] = (u * side) / 2; point[(axis + 2) % 3] = v / 2;
        normal[axis] = side;
        points.push(point); normals.push(normal);
      }
      indices.push(start, start + 1, start + 2, start, start + 2, start + 3);
    }
  }
  return mesh(points, normals, indices);
}

/**
 * A surface of revolution about z, from rings of `[radius, z, normal outward, normal up]`.
 * @param {number[][]} rings @param {number} [segments]
 */
function lathe(rings, segments = 28) {
  const [points, normals, indices] = /** @type {[number[][], number[][], number[]]} */ ([[], [], []]);
  for (const [radius, z, out, up] of rings) {
    for (let i = 0; i <= segments; i++) {
      const angle = (i / segments) * 2 * Math.PI;
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      points.push([radius * c, radius * s, z]);
      normals.push([out * c, out * s, up]);
    }
  }
  const row = segments + 1;
  for (let ring = 0; ring + 1 < rings.length; ring++) {
    for (let i = 0; i < segments; i++) {
      const a = ring * row + i;
      indices.push(a, a + 1, a + row + 1, a, a + row + 1, a + row);
    }
  }
  return mesh(points, normals, indices);
}

/** Radius 1, length 1 along z. */
export const cylinder = () => lathe([[0, -0.5, 0, -1], [1, -0.5, 0, -1], [1, -0.5, 1, 0], [1, 0.5, 1, 0], [1, 0.5, 0, 1], [0, 0.5, 0, 1]]);
/** From a base of radius 1 at z = 0 to a point at z = 1. */
export const cone = () => lathe([[0, 0, 0, -1], [1, 0, 0, -1], [1, 0, 0.7071, 0.7071], [0, 1, 0.7071, 0.7071]]);
/** A cylinder with half spheres at its ends; `length` without these. @param {number} radius @param {number} length */
export function capsule(radius, length) {
  const rings = [];
  for (let i = 0; i <= 16; i++) {
    const angle = -Math.PI / 2 + (Math.PI * Math.min(i, 8)) / 16 + (i > 8 ? (Math.PI * (i - 8)) / 16 : 0);
    const [out, up] = [Math.cos(angle), Math.sin(angle)];
    if (i === 8) rings.push([radius, -length / 2, 1, 0], [radius, length / 2, 1, 0]);
    else rings.push([radius * out, (i < 8 ? -length / 2 : length / 2) + radius * up, out, up]);
  }
  return lathe(rings);
}
/** Radius 1. */
export const sphere = () => capsule(1, 0);

/** @param {ArrayBuffer} buffer @returns {Mesh} @throws {Error} in words, if it is no STL file */
export function parseStl(buffer) {
  const view = new DataView(buffer);
  const count = buffer.byteLength >= 84 ? view.getUint32(80, true) : 0;
  if (buffer.byteLength >= 84 && 84 + count * 50 === buffer.byteLength) {
    const [positions, normals] = [new Float32Array(count * 9), new Float32Array(count * 9)];
    for (let i = 0; i < count; i++) {
      for (let k = 0; k < 9; k++) positions[i * 9 + k] = view.getFloat32(84 + i * 50 + 12 + k * 4, true);
    }
    return flat(positions, normals);
  }
  const text = new TextDecoder().decode(buffer);
  if (!/^\s*solid/.test(text)) throw new Error('the mesh is no STL file');
  const numbers = [...text.matchAll(/vertex\s+(\S+)\s+(\S+)\s+(\S+)/g)].flatMap(([, x, y, z]) => [Number(x), Number(y), Number(z)]);
  const whole = numbers.slice(0, numbers.length - (numbers.length % 9));
  return flat(Float32Array.from(whole), new Float32Array(whole.length));
}

/** The normals of triangles: those in files are often missing. @param {Float32Array} positions @param {Float32Array} normals @returns {Mesh} */
export function flat(positions, normals) {
  for (let i = 0; i + 8 < positions.length; i += 9) {
    const [ax, ay, az] = [positions[i + 3] - positions[i], positions[i + 4] - positions[i + 1], positions[i + 5] - positions[i + 2]];
    const [bx, by, bz] = [positions[i + 6] - positions[i], positions[i + 7] - positions[i + 1], positions[i + 8] - positions[i + 2]];
    const normal = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
    const length = Math.hypot(...normal) || 1;
    for (let k = 0; k < 9; k++) normals[i + k] = normal[k % 3] / length;
  }
  return { positions, normals };
}
