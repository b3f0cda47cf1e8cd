// node --test bridge/view/tests/page/camera.test.mjs
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { pixels } from '../../page/panels/camera/pixels.js';
import { overlayOf } from '../../page/panels/camera/overlays.js';

/** Red, green, blue and alpha of each pixel. @param {string} encoding @param {number[]} data @param {Record<string, any>} [more] */
function shown(encoding, data, more = {}) {
  const image = { width: 2, height: 1, encoding, is_bigendian: 0, step: 0, data: Uint8Array.from(data), ...more };
  const out = new Uint32Array(image.width * image.height);
  pixels(image, out);
  const bytes = new Uint8Array(out.buffer);
  return Array.from(out, (_, i) => [...bytes.slice(4 * i, 4 * i + 4)]);
}

test('colours are in their order', () => {
  const expected = [[1, 2, 3, 255], [4, 5, 6, 255]];
  assert.deepEqual(shown('rgb8', [1, 2, 3, 4, 5, 6]), expected);
  assert.deepEqual(shown('bgr8', [3, 2, 1, 6, 5, 4]), expected);
  assert.deepEqual(shown('rgba8', [1, 2, 3, 0, 4, 5, 6, 0]), expected);
  assert.deepEqual(shown('bgra8', [3, 2, 1, 0, 6, 5, 4, 0]), expected);
  assert.deepEqual(shown('mono8', [7, 200]), [[7, 7, 7, 255], [200, 200, 200, 255]]);
});

test('rows have their step, depths their own scale', () => {
  assert.deepEqual(shown('mono8', [1, 2, 0, 0, 3, 4], { height: 2, step: 4 }).map(([red]) => red), [1, 2, 3, 4]);
  assert.deepEqual(shown('mono16', [0, 128, 255, 255]).map(([red]) => red), [127, 255]);
  assert.deepEqual(shown('mono16', [128, 0, 255, 255], { is_bigendian: 1 }).map(([red]) => red), [127, 255]);
  assert.deepEqual(shown('16UC1', [100, 0, 200, 0]).map(([red]) => red), [0, 255]);
});

test('white, black and red survive YUV', () => {
  assert.deepEqual(shown('yuv422_yuy2', [235, 128, 16, 128]), [[254, 254, 254, 255], [0, 0, 0, 255]]);
  assert.deepEqual(shown('uyvy', [128, 235, 128, 16]), [[254, 254, 254, 255], [0, 0, 0, 255]]);
  const [[red, green, blue]] = shown('yuyv', [81, 90, 81, 240]);
  assert.ok(red > 250 && green < 5 && blue < 5, `${red} ${green} ${blue}`);
  assert.deepEqual(shown('nv12', [235, 16, 235, 16, 128, 128], { height: 2 }), [[254, 254, 254, 255], [0, 0, 0, 255], [254, 254, 254, 255], [0, 0, 0, 255]]);
});

test('a mosaic has the colours of its square', () => {
  assert.deepEqual(shown('bayer_rggb8', [10, 20, 40, 30], { height: 2 })[0], [10, 30, 30, 255]);
  assert.deepEqual(shown('bayer_bggr8', [30, 20, 40, 10], { height: 2 })[0], [10, 30, 30, 255]);
});

test('what cannot be shown is said', () => {
  assert.throws(() => shown('theora', [1]), /"theora" are not shown/);
  assert.throws(() => shown('rgb8', [1, 2, 3]), /has only 3 bytes/);
  assert.throws(() => shown('mono8', [1, 2, 3, 4], { height: 2, step: 1 }), /has only 4 bytes/);
});

test('detections are boxes with their names', () => {
  const bbox = { center: { position: { x: 10, y: 20 }, theta: 0 }, size_x: 4, size_y: 2 };
  const message = { detections: [{ id: '', bbox, results: [{ hypothesis: { class_id: 'ball', score: 0.873 } }] }] };
  assert.deepEqual(overlayOf('vision_msgs/msg/Detection2DArray')?.(message, 100, 100), [
    { kind: 'polygon', points: [[8, 19], [12, 19], [12, 21], [8, 21]], text: 'ball 87 %' },
  ]);
});
