// A motion of an arm that is no humanoid, made in the page by hand: limp, three poses, saved, played.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL DOWNBEAT_FILE=FILE_OF_MOTIONS node arm_motions.mjs

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import { after, before, test } from 'node:test';
import { launch, look, open, seriousFaults, until } from './browser.mjs';

let browser;
let page;
let problems;

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
  await look(page, 'motions');
  await page.getByTestId('motion-chosen').waitFor();
});
after(() => browser?.close());

const click = (name) => page.getByTestId(`motion-${name}`).click();
const note = () => page.getByTestId('motion-note').innerText();
const angle = (joint) => page.getByLabel(`${joint}, degrees`, { exact: true });
const turn = async (joint, degrees) => {
  await angle(joint).fill(String(degrees));
  await angle(joint).blur();
};

test('three poses of the arm are taken, saved and played', async () => {
  await page.getByTestId('motion-name').fill('reach');
  await page.getByTestId('motion-name').blur();
  await click('limp');
  await click('take');
  await until('the pose of the arm is the first frame', async () => (await angle('elbow_flex').inputValue()) !== '');
  await click('hold');
  for (const degrees of [40, -20]) {
    await click('copy');
    await turn('elbow_flex', degrees);
  }
  await click('save');
  await until('it is saved', async () => (await note()).startsWith('Saved in '));
  assert.match(readFileSync(process.env.DOWNBEAT_FILE, 'utf8'), /\[reach\][^]*elbow_flex = 40\.0[^]*elbow_flex = -20\.0/);
  await page.getByTestId('motion-speed').fill('100');
  await click('play');
  await until('it plays', async () => page.getByTestId('motion-play').isDisabled());
  await until('it has ended', async () => !(await page.getByTestId('motion-play').isDisabled()));
});

test('nothing is wrong', async () => {
  assert.deepEqual(await seriousFaults(page), []);
  assert.deepEqual(problems, []);
});
