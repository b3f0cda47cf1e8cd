// Episodes of demonstrations, begun, kept and discarded by buttons and by keys.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL node episodes.mjs

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { launch, look, open, seriousFaults, until } from './browser.mjs';

let browser;
let page;
let problems;

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
  await look(page, 'episodes');
  await page.getByTestId('episode-start').waitFor();
});
after(() => browser?.close());

const says = (what) => until(`the panel says ${what}`, async () => what.test(await page.getByTestId('episode-state').innerText()));

test('before the first episode there is nothing to keep', async () => {
  await says(/No episode yet/);
  assert(await page.getByTestId('episode-keep').isDisabled());
  await page.keyboard.press('ArrowRight');
  await until('it says what to do', async () => /no episode is under way/.test(await page.getByTestId('episode-problem').innerText()));
});

test('buttons begin and keep an episode', async () => {
  await page.getByTestId('episode-start').click();
  await says(/Episode 0 is recorded · \d/);
  assert.equal(await page.getByTestId('episode-task').innerText(), 'put the cube into the box');
  await page.getByTestId('episode-keep').click();
  await says(/Episode 0 is kept/);
  assert.equal(await page.getByTestId('episode-problem').innerText(), '');
});

test('keys begin and discard one', async () => {
  await page.locator('body').click({ position: { x: 1, y: 1 } });
  await page.keyboard.press('Space');
  await says(/Episode 1 is recorded/);
  await page.keyboard.press('ArrowLeft');
  await says(/Episode 1 is discarded/);
});

test('the servos of both arms have rows of their own', async () => {
  await look(page, 'servos');
  const lines = page.getByTestId('servos').locator('tbody tr');
  const cells = () => lines.evaluateAll((each) => each.map((row) => [...row.cells].map((cell) => cell.textContent)));
  const arms = ['follower (emulated)', 'leader (emulated)'];
  // Until the first diagnostics arrive, joints are shown by their topics.
  const rows = await until('both arms are shown', async () => {
    const found = await cells();
    const titles = found.filter((row) => row.length === 1).flat().sort();
    return titles.join() === arms.join() && found.every(([, , position]) => position === undefined || /\d/.test(position)) && found;
  });
  const ids = rows.filter((row) => row.length > 1).map(([id]) => id);
  assert.deepEqual(ids, [...'123456123456'], 'in the order of the cable');
  await look(page, 'episodes');
});

test('nothing serious is wrong for those who use a screen reader', async () => {
  assert.deepEqual(await seriousFaults(page), []);
  assert.deepEqual(problems, []);
});
