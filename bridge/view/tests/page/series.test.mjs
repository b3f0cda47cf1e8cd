// node --test bridge/view/tests/page/series.test.mjs
import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Series, ticks } from '../../page/panels/plot/series.js';

/** @param {Series} series @param {number} from @param {number} to @param {number} columns */
function drawn(series, from, to, columns) {
  /** @type {[number, number][]} */
  const points = [];
  series.visit(from, to, columns, (time, value) => points.push([time, value]));
  return points;
}

test('the newest points are kept', () => {
  const series = new Series(3000);
  for (let i = 0; i < 10_000; i++) series.push(i, -i);
  assert.equal(series.length, 3000);
  assert.deepEqual([series.time(0), series.value(0), series.time(2999)], [7000, -7000, 9999]);
  assert.equal(series.valueAt(8000.5), -8000);
  assert.ok(Number.isNaN(series.valueAt(6999)));
  assert.deepEqual(series.range(7999.5, 8000.5), [-8001, -7999]);
});

test('time that runs backward begins anew', () => {
  const series = new Series();
  series.push(5, 1);
  series.push(6, 1);
  series.push(2, 7);
  assert.deepEqual([series.length, series.value(0)], [1, 7]);
});

test('no peak is lost, and few points are drawn', () => {
  const series = new Series(20_000);
  for (let i = 0; i < 12_500; i++) series.push(i * 0.008, i === 6011 ? 99 : i === 6013 ? -99 : Math.sin(i / 50));
  const points = drawn(series, 0, 100, 300);
  assert.ok(points.length <= 4 * 302, `${points.length} points`);
  const values = points.map(([, value]) => value);
  assert.deepEqual([Math.max(...values), Math.min(...values)], [99, -99]);
  assert.ok(points.every(([time], i) => i === 0 || time >= points[i - 1][0]), 'in the order of time');
  assert.deepEqual(points[0], [0, 0]);
  assert.equal(points.at(-1)?.[0], series.time(12_499));
});

test('few points are drawn as they are, gaps stay gaps', () => {
  const series = new Series();
  [1, NaN, NaN, 3].forEach((value, i) => series.push(i, value));
  assert.deepEqual(drawn(series, 0, 3, 100), [[0, 1], [1, NaN], [2, NaN], [3, 3]]);
  const many = new Series();
  for (let i = 0; i < 1000; i++) many.push(i, i > 400 && i < 600 ? NaN : i);
  assert.equal(drawn(many, 0, 1000, 10).filter(([, value]) => Number.isNaN(value)).length, 1);
});

test('marks are round', () => {
  assert.deepEqual(ticks(0.3, 10.2, 5).at, [2, 4, 6, 8, 10]);
  assert.equal(ticks(0, 0.7, 4).step, 0.2);
  assert.deepEqual(ticks(1, 1, 4).at, [1]);
});
