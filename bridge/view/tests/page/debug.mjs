// A recorded walk in the debugger: why the robot fell, in five clicks, and each cycle as the terminal shows it.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_PAGE=URL node debug.mjs

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { launch, look, open, seriousFaults, until } from './browser.mjs';

let browser;
let page;
let problems;

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
  await look(page, 'debug');
  await page.getByTestId('debug').waitFor();
});
after(() => browser?.close());

const where = () => page.getByTestId('debug-where').innerText();
const details = () => page.getByTestId('debug-details').innerText();
const isIdle = () => until('the debugger has answered', async () => (await page.locator('[data-testid=debug][aria-busy]').count()) === 0);

test('why the robot fell is found in five clicks', async () => {
  // 1: the states of the robot.
  await page.getByTestId('debug-name').selectOption('robot_state');
  const falling = page.getByTestId('debug-messages').locator('li', { hasText: 'falling' }).first();
  await falling.waitFor();
  // 2: where it begins to fall.
  await falling.getByRole('button').click();
  await until('it stands where the robot falls', async () => (await page.locator('tr[data-module=falls] [data-why^="robot_state#"]').count()) > 0);
  const fall = Number(/, (\d+\.\d+) s/.exec(await where())[1]);
  await isIdle();
  // 3: what led to it.
  await page.locator('tr[data-module=falls] [data-why^="robot_state#"]').click();
  const chain = page.getByTestId('debug-why');
  await chain.waitFor();
  assert.match(await chain.innerText(), /published by falls[^]*published by imu_filter[^]*published by hardware \(timer\)/);
  await isIdle();
  // 4: the measurement at the beginning of the chain.
  await chain.locator('[data-cause="imu/data_raw"]').click();
  await until('the measurement is shown', async () => (await details()).startsWith('imu/data_raw #'));
  const [x, y, z] = [...(await details()).matchAll(/linear_acceleration:\s+x: (\S+)\s+y: (\S+)\s+z: (\S+)/g)][0].slice(1).map(Number);
  const tilt = (Math.atan2(Math.hypot(x, y), z) * 180) / Math.PI;
  assert(tilt > 20, `the trunk is tilted by ${tilt}°, by ${x}, ${y}, ${z}`);
  await isIdle();
  // 5: what the module that measured it holds.
  await page.locator('tr[data-module=hardware]').getByRole('button', { name: 'hardware' }).click();
  await page.getByTestId('debug-settings').waitFor();
  // The other panels stand there too.
  const shown = await page.evaluate(() => Number(window.robot.playback.timeNs - window.robot.playback.startNs) / 1e9);
  assert(Math.abs(shown - fall) < 0.05, `${shown} s, and the fall is at ${fall} s`);
});

const command = async (text) => {
  const line = page.getByLabel('Command of the debugger');
  await isIdle();
  await line.fill(text);
  await line.press('Enter');
  await isIdle();
};

test('the graph and the joints are those of where it stands', async () => {
  const rate = async () => {
    const node = page.locator('[data-node="t:joint_states"].graph-body');
    await node.waitFor();
    return Number(/([\d.]+) Hz/.exec(await node.textContent())?.[1]);
  };
  const seen = [];
  for (const cycle of [1000, 2000]) {
    await look(page, 'debug');
    await command(`go #${cycle}`);
    await look(page, 'graph');
    await until(`joint states come at 125 Hz, and not ${await rate()}`, async () => Math.abs((await rate()) - 125) < 5);
    const nodes = await page.locator('.graph-body').evaluateAll((bodies) => bodies.map((body) => body.dataset.node));
    for (const module of ['hardware', 'imu_filter', 'gait', 'falls', 'mux']) assert(nodes.includes(`m:${module}`), `${nodes}`);
    // The bag has no description of the robot for the view in 3D.
    await look(page, 'servos');
    const positions = await until('the joints are otherwise', async () => {
      const shown = await page.getByTestId('panel-servos').first().innerText();
      return shown.includes('r_knee') && !seen.includes(shown) && shown;
    });
    seen.push(positions);
  }
  await look(page, 'debug');
});

test('it goes on and back, to conditions, and says what is wrong', async () => {
  await command('go #1000');
  assert.match(await where(), /^Cycle #1000,/);
  await page.getByRole('button', { name: 'Step', exact: true }).click();
  await until('it has gone on', async () => (await where()).startsWith('Cycle #1001,'));
  await isIdle();
  await page.getByRole('button', { name: 'Back', exact: true }).click();
  await until('it has gone back', async () => (await where()).startsWith('Cycle #1000,'));
  await command("until robot_state.data == 'falling'");
  assert((await page.locator('tr[data-module=falls]').count()) === 1, await where());
  await command('go nowhere');
  assert.match(await page.getByTestId('debug').getByRole('alert').innerText(), /go where\?/);
  assert.deepEqual(await seriousFaults(page), []);
  assert.deepEqual(problems, []);
});
