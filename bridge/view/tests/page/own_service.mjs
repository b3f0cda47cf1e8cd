// The page calls a service of a type that only a library of the robot knows, as its panels do.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_PAGE=URL node own_service.mjs

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { launch, open } from './browser.mjs';

let browser;
let page;
let problems;

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
});
after(() => browser?.close());

test('a service is called with the definition that the robot sent, and a refusal has its words', async () => {
  const { type, response, reason } = await page.evaluate(async () => {
    const { robot } = globalThis;
    if (!robot.services.size) await new Promise((resolve) => { robot.addEventListener('services', resolve, { once: true }); });
    const { type } = robot.services.get('/level');
    const request = (/** @type {number} */ angle) => ({ tilt: { header: { stamp: { sec: 0, nanosec: 0 }, frame_id: 'wall' }, angle } });
    const response = await robot.call('/level', request(0.75));
    const reason = await robot.call('/level', request(9)).catch((/** @type {Error} */ error) => error.message);
    return { type, response, reason };
  });
  assert.equal(type, 'lab_msgs/srv/Level');
  assert.equal(response.is_level, false);
  assert.equal(response.why, 'it leans 0.750000');
  assert.match(reason, /it has fallen over/);
});

test('the browser complained about nothing', () => {
  assert.deepEqual(problems, []);
});
