// A motion of an arm that is no humanoid, made in the page: limp, three poses into which a hand turns its emulated
// joints, one of them on another way, saved, played.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_PAGE=URL DOWNBEAT_FILE=FILE_OF_MOTIONS node arm_motions.mjs
// (the robot has the topic `hand` of its emulator, in the domain ROS_DOMAIN_ID)

import assert from 'node:assert/strict';
import { spawnSync } from 'node:child_process';
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
/** The angle of a joint in the chosen frame. */
const taken = async (joint) => Number(await angle(joint).inputValue() || NaN);
/** Turns joints of the emulated arm; one that holds stays where it is. */
function turn(degrees) {
  const [names, angles] = [Object.keys(degrees), Object.values(degrees).map((angle) => (angle * Math.PI) / 180)];
  const line = ['topic', 'pub', '--once', '-w', '1', '/hand', 'sensor_msgs/msg/JointState', `{name: [${names}], position: [${angles}]}`];
  const { status, stdout, stderr } = spawnSync(process.env.DOWNBEAT, line, { encoding: 'utf8' });
  assert.equal(status, 0, stdout + stderr);
}
/** Takes the pose as a frame again and again, until the hand has brought the arm there; deletes those before. */
async function take(degrees) {
  const rows = page.getByTestId('motion-frames').locator('tbody tr');
  const kept = await rows.count();
  await until(`a frame with ${JSON.stringify(degrees)}`, async () => {
    turn(degrees);
    await click('take');
    const angles = await Promise.all(Object.keys(degrees).map(taken));
    return Object.values(degrees).every((wanted, index) => Math.abs(angles[index] - wanted) < 1);
  });
  while (await rows.count() > kept + 1) await rows.nth(kept).getByRole('button', { name: 'Delete' }).click();
}

test('three poses into which a hand brings the limp arm are taken, saved and played', async () => {
  await page.getByTestId('motion-name').fill('reach');
  await page.getByTestId('motion-name').blur();
  await click('limp');
  for (const pose of [{ elbow_flex: 0, shoulder_pan: 10 }, { elbow_flex: 40, shoulder_pan: -15 }, { elbow_flex: -20, shoulder_pan: 0 }]) await take(pose);
  await click('hold');
  assert.equal(await page.getByTestId('motion-frames').locator('tbody tr').count(), 3);
  await page.getByLabel('Way of frame 3, s').fill('1.7');
  await page.getByLabel('Way of frame 3, s').blur();
  await click('save');
  await until('it is saved', async () => (await note()).startsWith('Saved in '));
  assert.match(readFileSync(process.env.DOWNBEAT_FILE, 'utf8'), /\[reach\][^]*elbow_flex = (39|40)\.[^]*duration_s = 1\.7\ndegrees = \{[^}]*elbow_flex = -(19|20)\./);
  await page.getByTestId('motion-speed').fill('100');
  await click('play');
  await until('it plays', async () => page.getByTestId('motion-play').isDisabled());
  await until('it has ended', async () => !(await page.getByTestId('motion-play').isDisabled()));
});

test('nothing is wrong', async () => {
  assert.deepEqual(await seriousFaults(page), []);
  assert.deepEqual(problems, []);
});
