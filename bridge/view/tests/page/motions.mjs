// A motion made in the page: three key frames, seen in 3D, saved, and played by a robot in simulated physics.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL DOWNBEAT_FILE=FILE_OF_MOTIONS node motions.mjs

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

const file = () => readFileSync(process.env.DOWNBEAT_FILE, 'utf8');
const problem = () => page.getByTestId('motion-problem').innerText();
const note = () => page.getByTestId('motion-note').innerText();
const click = (name) => page.getByTestId(`motion-${name}`).click();
const angle = (joint) => page.getByLabel(`${joint}, degrees`, { exact: true });
const turn = async (joint, degrees) => {
  await angle(joint).fill(String(degrees));
  await angle(joint).blur();
};
const picture = () => page.getByTestId('motion-picture').screenshot();

test('the motions of the file are listed, and a mirror image is left alone', async () => {
  await page.getByTestId('motion-chosen').selectOption('nod');
  assert.equal(await page.getByTestId('motion-frames').locator('tbody tr').count(), 1);
  assert.equal(await angle('head_tilt').inputValue(), '10');
  await page.getByTestId('motion-chosen').selectOption('nod_left');
  assert.match(await note(), /mirror image of nod/);
  assert(await page.getByTestId('motion-save').isDisabled());
});

test('three key frames are made from the pose of the robot and by hand', async () => {
  await page.getByTestId('motion-chosen').selectOption('');
  await page.getByTestId('motion-name').fill('greet');
  await page.getByTestId('motion-name').blur();
  await click('take');
  await until('the pose of the robot is the first frame', async () => (await angle('r_knee').inputValue()) !== '');
  assert(Math.abs(Number(await angle('r_knee').inputValue()) - 53) < 8, 'the robot stands');
  const standing = await picture();
  await click('copy');
  await turn('r_sho_pitch', 60);
  await until('the arm is raised in 3D', async () => !(await picture()).equals(standing));
  await click('copy');
  await turn('r_sho_pitch', -60);
  assert.equal(await page.getByTestId('motion-frames').locator('tbody tr').count(), 3);
  await page.getByTestId('motion-frame-2').click();
  assert.equal(await angle('r_sho_pitch').inputValue(), '60');
});

test('what the robot cannot do is refused with the reason', async () => {
  await page.getByLabel('Way of frame 3, s').fill('0.05');
  await page.getByLabel('Way of frame 3, s').blur();
  await click('save');
  await until('the reason is shown', async () => /r_sho_pitch would turn at .*a duration_s of .* suffices/.test(await problem()));
  assert(!file().includes('greet'));
  await page.getByLabel('Way of frame 3, s').fill('0.8');
  await page.getByLabel('Way of frame 3, s').blur();
});

test('a preview shows it in 3D and does not move the robot', async () => {
  await page.getByTestId('motion-frame-2').click();
  const raised = await picture();
  await click('preview');
  await until('the preview is at its end', async () => /Preview: 1\.8 s of 1\.8 s/.test(await note()));
  await until('the arm is down again', async () => !(await picture()).equals(raised));
  assert.equal(await problem(), '');
});

test('it is saved in the file, whose other lines stay', async () => {
  const before = file();
  await click('save');
  await until('it is saved', async () => (await note()).startsWith('Saved in '));
  const after = file();
  assert(after.startsWith(before), 'nothing else has changed');
  assert.match(after.slice(before.length), /^\n\[greet\]\n[^]*\[\[greet\.frame\]\]\nduration_s = 0\.8\ndegrees = \{ r_sho_pitch = -60\.0 \}\n$/);
});

test('it is played', async () => {
  await page.getByTestId('motion-speed').fill('100');
  await click('play');
  await until('it plays', async () => page.getByTestId('motion-play').isDisabled());
  await until('it has ended', async () => !(await page.getByTestId('motion-play').isDisabled()));
  assert.equal(await problem(), '');
});

test('nothing serious is wrong for those who use a screen reader', async () => {
  assert.deepEqual(await seriousFaults(page), []);
  assert.deepEqual(problems, []);
});
