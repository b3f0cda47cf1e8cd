// node --test bridge/view/tests/page/cdr.test.mjs
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { decoder, encode, getter, numericPaths, parseSchema, template } from '../../page/cdr.js';

const SEPARATOR = '='.repeat(80);
const JOINT_STATE = `std_msgs/Header header
string[] name
float64[] position # rad
float64[] velocity
float64[] effort
${SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
${SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
`;

test('a message survives', () => {
  const schema = parseSchema('sensor_msgs/msg/JointState', JOINT_STATE);
  const message = {
    header: { stamp: { sec: 5, nanosec: 7 }, frame_id: 'grün' }, name: ['a', 'head_pan'],
    position: Float64Array.of(0.5, -1), velocity: new Float64Array(0), effort: Float64Array.of(NaN),
  };
  const bytes = encode(schema, { ...message, effort: ['nan'] });
  assert.deepEqual(decoder(schema)(bytes), message);
  // The same at an odd offset of a frame.
  const frame = new Uint8Array(bytes.length + 13);
  frame.set(bytes, 13);
  assert.deepEqual(decoder(schema)(frame.subarray(13)), message);
});

test('a long message survives', () => {
  const schema = parseSchema('a/msg/B', 'string[] text\nfloat64[] numbers\nwstring wide\nuint8[] bytes\n');
  const message = {
    text: Array.from({ length: 300 }, (_, i) => 'x'.repeat(i)), numbers: Float64Array.from({ length: 999 }, (_, i) => i / 7),
    wide: 'ä\u{1f600}'.repeat(200), bytes: Uint8Array.from({ length: 5000 }, (_, i) => i % 256),
  };
  assert.deepEqual(decoder(schema)(encode(schema, message)), message);
});

test('fields are aligned after the header, big endian is read', () => {
  const schema = parseSchema('a/msg/B', 'uint8 a\nfloat64 b\nint16[3] c\nbool d\nint64 e\n');
  const little = encode(schema, { a: 1, b: 2.5, c: [1, -2, 3], d: true, e: -5 });
  assert.equal(little.length, 4 + 8 + 8 + 6 + 1 + 1 + 8);
  const big = new Uint8Array(40);
  const view = new DataView(big.buffer);
  view.setUint8(4, 1); view.setFloat64(12, 2.5); view.setInt16(20, 1); view.setInt16(22, -2); view.setInt16(24, 3);
  view.setUint8(26, 1); view.setBigInt64(28, -5n);
  const expected = { a: 1, b: 2.5, c: Int16Array.of(1, -2, 3), d: true, e: -5 };
  assert.deepEqual(decoder(schema)(little), expected);
  assert.deepEqual(decoder(schema)(big), expected);
});

test('definitions have constants, defaults, bounds and comments', () => {
  const schema = parseSchema('a/msg/B', [
    'uint8 KIND=3 # of it', "string TEXT='a # b'", 'string<=10 name "x#y" # why', 'int32[<=2] few [1, 2]', 'Inner[] inner', 'Empty nothing',
    SEPARATOR, 'MSG: a/Inner', 'float32 x 1.5', SEPARATOR, 'MSG: a/Empty',
  ].join('\n'));
  assert.deepEqual(schema.root.constants, [{ name: 'KIND', type: 'uint8', value: 3 }, { name: 'TEXT', type: 'string', value: 'a # b' }]);
  assert.deepEqual(template(schema), { name: 'x#y', few: [1, 2], inner: [], nothing: {} });
  assert.equal(schema.root.fields[0].comment, 'why');
  const read = decoder(schema)(encode(schema, { inner: [{}] }));
  assert.deepEqual(read, { name: 'x#y', few: Int32Array.of(1, 2), inner: [{ x: 1.5 }], nothing: {} });
});

test('a value that does not fit is named', () => {
  const schema = parseSchema('sensor_msgs/msg/JointState', JOINT_STATE);
  const problem = (/** @type {any} */ message) => { try { encode(schema, message); return ''; } catch (error) { return String(error); } };
  assert.match(problem({ position: [1, 'two'] }), /position\[1\]: expected a number, found "two"/);
  assert.match(problem({ header: { stamp: { nanosec: -1 } } }), /header\.stamp\.nanosec: expected a whole number from 0 to 4294967295, found -1/);
  assert.match(problem({ positions: [] }), /positions: sensor_msgs\/JointState has no such field/);
  assert.match(problem({ name: 'a' }), /name: expected a list/);
});

test('a damaged message is an error and allocates nothing', () => {
  const schema = parseSchema('sensor_msgs/msg/JointState', JOINT_STATE);
  const bytes = encode(schema, { name: ['a'], position: [1] });
  for (let length = 0; length < bytes.length; length++) {
    assert.throws(() => decoder(schema)(bytes.subarray(0, length)), `${length} bytes`);
  }
  const huge = Uint8Array.from([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255]);
  assert.throws(() => decoder(schema)(huge), /ends too early/);
  assert.throws(() => decoder(schema)(Uint8Array.of(0, 3, 0, 0)), /encapsulation 3/);
});

test('numbers are found by their paths', () => {
  const message = { a: { b: [{ x: 1 }, { x: 2n }] }, c: Float64Array.of(3), image: new Uint8Array(9), on: true, text: 'no' };
  assert.deepEqual(numericPaths(message), ['a.b[0].x', 'a.b[1].x', 'c[0]', 'on']);
  assert.deepEqual(numericPaths(message).map((path) => getter(path)(message)), [1, 2, 3, 1]);
  assert.ok(Number.isNaN(getter('a.none[3].y')(message)));
});
