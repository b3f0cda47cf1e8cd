// A six-joint arm is calibrated in the page, while an emulated hand turns its joints.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_FOLDER=FOLDER node calibrate.mjs
// (the folder has `real.toml`, the arm as it is, and `arm.toml`, how it is described)

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { existsSync } from 'node:fs';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { after, before, test } from 'node:test';
import { launch, seriousFaults, until } from './browser.mjs';

const [real, description, port] = ['real.toml', 'arm.toml', 'port'].map((name) => join(process.env.DOWNBEAT_FOLDER, name));
/** How far each joint can be turned from where it is at 0, in rad. */
const STOPS = { shoulder_pan: [-1.9, 1.8], shoulder_lift: [-1.7, 1.6], elbow_flex: [-1.6, 1.5], wrist_flex: [-1.5, 1.4], wrist_roll: [-2.5, 2.6], gripper: [-0.1, 1.6] };
const programs = [];
let hand;
let browser;
let page;

/** A program, and its lines so far. */
function start(...line) {
  const child = spawn(process.env.DOWNBEAT, line, { stdio: ['pipe', 'pipe', 'inherit'] });
  const lines = [];
  createInterface({ input: child.stdout }).on('line', (text) => lines.push(text));
  programs.push(child);
  return { child, lines };
}

async function turn(joint, angle) {
  const from = hand.lines.length;
  hand.child.stdin.write(`turn ${joint} ${angle}\n`);
  await until(`${joint} is turned`, () => hand.lines.slice(from).some((line) => line.includes(`${joint} is turned`)));
}

before(async () => {
  hand = start('emulate', 'servos', real, '--link', port, '--by-hand');
  await until('the arm is there', () => existsSync(port));
  const { lines } = start('servo', 'calibrate', description, '--port', port, '--timeout-ms', '200', '--margin', '0.05', '--page', '0');
  const url = await until('the page is open', () => /open in a browser: (\S+)/.exec(lines.join('\n'))?.[1]);
  browser = await launch();
  page = await browser.newPage();
  page.setDefaultTimeout(60_000);
  await page.goto(url);
});
after(async () => {
  await browser?.close();
  programs.forEach((child) => child.kill());
});

const question = () => page.getByTestId('calibrate-question').innerText();
const asks = (text) => until(`it asks: ${text}`, async () => (await question()).includes(text));
const done = () => page.getByTestId('calibrate-done').click();

test('each step is asked for in the page, and the joints are shown while they turn', async () => {
  await asks('lose their torque now: hold the robot');
  await done();
  await asks('from one stop to the other');
  await until('six joints are listed', async () => (await page.getByTestId('calibrate-joints').locator('tbody tr').count()) === 6);
  for (const [joint, stops] of Object.entries(STOPS)) for (const angle of [...stops, 0]) await turn(joint, angle);
  const travel = page.getByTestId('calibrate-joints').locator('tbody tr', { hasText: 'gripper' }).locator('td').last();
  await until('the travel of the gripper is shown', async () => Math.abs(parseFloat(await travel.innerText()) - 97.4) < 1);
  assert.deepEqual(await seriousFaults(page).catch(() => []), []);
  await done();
  await asks('where they are to be at 0 rad');
  assert.equal(await page.getByTestId('calibrate-middle').innerText(), 'The middle between their stops');
  await done();
  await asks('shoulder_pan: turn it a little');
  await done();
  await until('too little is said', async () => (await page.getByTestId('calibrate-lines').innerText()).includes('shoulder_pan was turned by less than 3 degrees'));
  for (const joint of Object.keys(STOPS)) {
    await asks(`${joint}: turn it a little in its positive direction`);
    await turn(joint, 0.3);
    await done();
  }
  await asks('Calibrated');
  assert.match(await page.getByTestId('calibrate-lines').innerText(), /gripper +zero +\d+ +sign +1 +limits -0\.0[45]\d to 1\.5[45]\d rad[^]*wrote .*arm\.toml; the joints are still limp/);
});
