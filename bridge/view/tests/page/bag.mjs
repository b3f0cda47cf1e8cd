// A bag in the page: what is shown after a seek is what the bag has at that time.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_PAGE=URL DOWNBEAT_BAG=… DOWNBEAT_FOLDER=… node bag.mjs
// (the last is a folder for files; the bag has /joint_states and is shown paused)

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { join } from 'node:path';
import { after, before, test } from 'node:test';
import { downbeat, launch, look, open, seriousFaults, until } from './browser.mjs';

const TOPIC = '/joint_states';
let browser;
let page;
let problems;
/** When each message was recorded, the stamp in it, and a position. @type {{ time: bigint, stamp: string, position: number }[]} */
let messages;

before(async () => {
  const tables = join(process.env.DOWNBEAT_FOLDER, 'tables');
  await downbeat('bag', 'export', '--format', 'jsonl', '--topics', TOPIC, '--output', tables, process.env.DOWNBEAT_BAG);
  messages = readFileSync(join(tables, 'joint_states.jsonl'), 'utf8').trim().split('\n').map((line) => {
    const [, time] = /"log_time":(\d+)/.exec(line);
    const { header, position } = JSON.parse(line).message;
    return { time: BigInt(time), stamp: `${header.stamp.sec}.${String(header.stamp.nanosec).padStart(9, '0')}`, position: position[0] };
  });
  assert(messages.length > 50, `${messages.length} messages`);
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
});
after(() => browser?.close());

const now = async () => BigInt(await page.evaluate(() => String(window.robot.playback.timeNs)));
const start = async () => BigInt(await page.evaluate(() => String(window.robot.playback.startNs)));
const length = () => page.evaluate(() => Number(window.robot.playback.endNs - window.robot.playback.startNs) / 1e9);
const bar = () => page.getByTestId('seek');
const seek = async (part) => bar().fill(String(Math.round(Number(await bar().getAttribute('max')) * part)));
const stamp = async () => /(\d{10}\.\d{9})/.exec(await page.getByTestId('message').evaluate((tree) => tree.textContent))?.[1];

test('the seek bar leads every panel to the messages of that time', async () => {
  await look(page, 'topics');
  await page.getByTestId('topics').getByRole('button', { name: TOPIC, exact: true }).click();
  for (const part of [0.25, 0.8, 0.5, 0.99]) {
    await seek(part);
    const wanted = (await length()) * part;
    const time = await until(`${part} of the bag is shown`, async () => {
      const at = await now();
      return Math.abs(Number(at - (await start())) / 1e9 - wanted) < 0.05 && at;
    });
    const expected = messages.filter((message) => message.time <= time).at(-1);
    await until(`the message of ${expected.stamp} is shown, not ${await stamp()}`, async () => (await stamp()) === expected.stamp);
    const [shown] = (await page.getByTestId('position').innerText()).split(' ');
    assert(Math.abs(Number(shown) - wanted) < 0.2, `${shown} s is shown at ${wanted} s`);
  }
});

test('it plays, and pauses', async () => {
  await seek(0.1);
  const wanted = (await length()) * 0.1;
  const begin = await until('the beginning is shown', async () => {
    const at = await now();
    return Math.abs(Number(at - (await start())) / 1e9 - wanted) < 0.05 && at;
  });
  await page.getByTestId('play').click();
  await until('time goes on', async () => (await now()) > begin + 50_000_000n);
  await page.getByTestId('play').click();
  await until('it is paused', () => page.evaluate(() => window.robot.playback.status !== 'playing'));
  const stopped = await now();
  await page.waitForTimeout(300);
  assert.equal(await now(), stopped);
});

test('a curve covers the whole bag with its extremes', async () => {
  // At the beginning, the joints were not known yet.
  await seek(0.5);
  await look(page, 'plot');
  await until('lines are drawn', async () => /\d/.test(await page.getByTestId('plot-legend').innerText()));
  const { fields } = await page.evaluate((topic) => window.robot.ask('series', { topic, fields: ['position[0]'], points: 400 }), TOPIC);
  const positions = messages.map(({ position }) => position);
  assert.equal(Math.max(...fields[0].v), Math.max(...positions));
  assert.equal(Math.min(...fields[0].v), Math.min(...positions));
});

for (const scheme of ['light', 'dark']) {
  test(`axe finds no serious fault at a bag, ${scheme}`, async () => {
    const seen = await open(browser, process.env.DOWNBEAT_PAGE, { scheme });
    const faults = [];
    for (const view of ['dashboard', 'topics', 'plot', 'graph', 'timeline', 'parameters', 'recording']) {
      await look(seen.page, view);
      await seen.page.waitForTimeout(500);
      faults.push(...(await seriousFaults(seen.page)).map((fault) => `${view}: ${fault}`));
    }
    assert.deepEqual(faults, []);
    await seen.close();
  });
}

test('the browser has nothing to complain about', () => {
  assert.deepEqual(problems, []);
});
