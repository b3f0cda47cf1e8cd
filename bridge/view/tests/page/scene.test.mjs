// node --test bridge/view/tests/page/scene.test.mjs
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { compose, inverse, matrix, product, rollPitchYaw, rotate, turn } from '../../page/panels/scene/math.js';
import { box, capsule, parseStl } from '../../page/panels/scene/meshes.js';
import { Transforms } from '../../page/panels/scene/transforms.js';
import { forward } from '../../page/panels/scene/urdf.js';

/** @param {number[]} found @param {number[]} expected */
const near = (found, expected) => found.forEach((value, i) => assert.ok(Math.abs(value - expected[i]) < 1e-9, `${found} is not ${expected}`));
const at = (/** @type {number} */ x, /** @type {number} */ y, /** @type {number} */ z, yaw = 0) => ({ p: [x, y, z], q: turn([0, 0, 1], yaw) });

test('roll, pitch and yaw turn about fixed axes', () => {
  near(rotate(rollPitchYaw(Math.PI / 2, 0, Math.PI / 2), [0, 1, 0]), [0, 0, 1]);
  near(rotate(rollPitchYaw(0, Math.PI / 2, 0), [1, 0, 0]), [0, 0, -1]);
});

test('a pose and its inverse are nothing, as matrices too', () => {
  const pose = { p: [1, -2, 3], q: rollPitchYaw(0.3, -0.7, 2) };
  near(compose(pose, inverse(pose)).p, [0, 0, 0]);
  const unit = product(matrix(pose), matrix(inverse(pose)));
  unit.forEach((value, i) => assert.ok(Math.abs(value - (i % 5 === 0 ? 1 : 0)) < 1e-5));
});

test('frames are found across the tree, and foreign ones are not', () => {
  const frames = new Transforms();
  frames.set('odom', 'base', at(1, 0, 0, Math.PI / 2), 0n);
  frames.set('base', 'head', at(0.5, 0, 1), 0n);
  frames.set('odom', 'goal', at(1, 3, 0), 0n);
  near(frames.lookup('/odom', 'head')?.p ?? [], [1, 0.5, 1]);
  near(frames.lookup('head', 'goal')?.p ?? [], [2.5, 0, -1]);
  assert.equal(frames.lookup('odom', 'elsewhere'), null);
});

test('the true pose carries the tree of the odometry', () => {
  const frames = new Transforms();
  frames.set('odom', 'base', at(2, 0, 0), 0n);
  for (const x of [7, 8]) {
    frames.join('world', 'base', at(x, 1, 0, Math.PI / 2), 0n);
    near(frames.lookup('world', 'base')?.p ?? [], [x, 1, 0]);
    near(frames.lookup('world', 'odom')?.p ?? [], [x, -1, 0]);
  }
  // Odometry that already is in the world is not hung into itself.
  frames.set('world', 'odom', at(0, 0, 0), 0n);
  frames.join('world', 'base', at(5, 5, 0), 0n);
  near(frames.lookup('world', 'base')?.p ?? [], [2, 0, 0]);
});

test('a circle of frames ends', () => {
  const frames = new Transforms();
  frames.set('a', 'b', at(1, 0, 0), 0n);
  frames.set('b', 'a', at(1, 0, 0), 0n);
  assert.ok(frames.root('a'));
  frames.join('world', 'a', at(0, 0, 0), 0n);
});

test('joints move their links, mimics follow', () => {
  const joint = (/** @type {any} */ more) => ({ name: 'j', type: 'revolute', parent: 'base', child: 'arm', origin: at(0, 0, 1), axis: [0, 1, 0], lower: -1, upper: 1, ...more });
  const description = { name: 'r', root: 'base', links: new Map(), joints: [
    joint({}), joint({ name: 'slide', type: 'prismatic', parent: 'arm', child: 'hand', origin: at(1, 0, 0), axis: [1, 0, 0] }),
    joint({ name: 'other', type: 'fixed', parent: 'arm', child: 'tip', origin: at(0, 0, 2) }),
    joint({ name: 'twin', parent: 'base', child: 'second', mimic: { joint: 'j', factor: -1, offset: 0 } }),
  ] };
  const poses = forward(description, (name) => ({ j: Math.PI / 2, slide: 0.5 })[name]);
  near(poses.get('hand')?.p ?? [], [0, 0, -0.5]);
  near(poses.get('tip')?.p ?? [], [2, 0, 1]);
  near(rotate(poses.get('second')?.q ?? [], [1, 0, 0]), [0, 0, 1]);
});

test('a measured position has precedence over that of a joint that is mimicked', () => {
  const joint = (/** @type {string} */ name, /** @type {any} */ mimic) =>
    ({ name, type: 'prismatic', parent: 'palm', child: name, origin: at(0, 0, 0), axis: [1, 0, 0], lower: 0, upper: 1, mimic });
  const mimic = { joint: 'left', factor: -1, offset: 0.5 };
  const description = { name: 'r', root: 'palm', links: new Map(), joints: [joint('left', undefined), joint('right', mimic)] };
  const right = (/** @type {Record<string, number>} */ positions) => forward(description, (name) => positions[name]).get('right')?.p ?? [];
  near(right({ left: 0.2 }), [0.3, 0, 0]);
  near(right({ left: 0.2, right: 0.9 }), [0.9, 0, 0]);
  near(right({}), [0.5, 0, 0]);
});

test('shapes are closed and face outward', () => {
  for (const { positions, normals, indices } of [box(), capsule(0.5, 2)]) {
    let volume = 0;
    const point = (/** @type {number} */ i) => [...positions.slice(3 * i, 3 * i + 3)];
    for (let i = 0; i < (indices?.length ?? 0); i += 3) {
      const [a, b, c] = [0, 1, 2].map((k) => point(/** @type {Uint32Array} */ (indices)[i + k]));
      volume += (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])) / 6;
    }
    assert.ok(volume > 0.9, `volume ${volume}`);
    for (let i = 0; i < normals.length; i += 3) assert.ok(Math.abs(Math.hypot(normals[i], normals[i + 1], normals[i + 2]) - 1) < 1e-3);
  }
});

test('STL is read in both forms, and nothing else', () => {
  const binary = new DataView(new ArrayBuffer(134));
  binary.setUint32(80, 1, true);
  [0, 0, 0, 1, 0, 0, 0, 1, 0].forEach((value, i) => binary.setFloat32(96 + 4 * i, value, true));
  const text = new TextEncoder().encode('solid a\nfacet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1e0 0\nendloop\nendfacet\nendsolid a\n');
  for (const buffer of [binary.buffer, text.buffer]) {
    const { positions, normals } = parseStl(/** @type {ArrayBuffer} */ (buffer));
    assert.deepEqual([...positions], [0, 0, 0, 1, 0, 0, 0, 1, 0]);
    assert.deepEqual([...normals.slice(0, 3)], [0, 0, 1]);
  }
  assert.throws(() => parseStl(new TextEncoder().encode('<COLLADA/>').buffer), /no STL/);
});
