// Composes a robot of four modules from nothing: with the mouse and with the keyboard; checks, saves, runs and records it.
//
//   DOWNBEAT=… DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… node compose.mjs FOLDER [PICTURES]

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { readFileSync, readdirSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { createInterface } from 'node:readline';
import { WATCHDOG_MS, downbeat, launch, seriousFaults, until } from './browser.mjs';
import { readFileSync as read } from 'node:fs';
import { createRequire } from 'node:module';

const [folder, pictures] = process.argv.slice(2);
const file = join(folder, 'robot.toml');
const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, 'index.js'));

const EXPECTED = `[robot]
name = "robot"

[[module]]
name = "emulator"
kind = "darwin_op_emulator"
settings = { link = "memory:test" }

[[module]]
name = "darwin_op"
kind = "darwin_op"
settings = { port = "memory:test" }
remap = { joint_commands = "joint_goals" }

[[module]]
name = "stand_nod_wave"
kind = "stand_nod_wave"

[[module]]
name = "joint_command_mux"
kind = "joint_command_mux"

[expose]
out = ["joint_states"]

[record]
except = ["bus/exchanges"]
`;

const program = spawn(process.env.DOWNBEAT, ['compose', file, '--port', '0'], { stdio: ['ignore', 'pipe', 'inherit'] });
const ended = new Promise((resolve) => program.on('exit', resolve));
const browser = await launch();
try {
  const url = await new Promise((resolve, reject) => {
    const timer = setTimeout(() => reject(new Error('the editor prints no address')), WATCHDOG_MS);
    program.on('exit', () => reject(new Error('the editor has ended')));
    createInterface({ input: program.stdout }).on('line', (line) => {
      const found = /open in a browser: (\S+)/.exec(line);
      if (found) { clearTimeout(timer); resolve(found[1]); }
    });
  });
  await compose(url);
} finally {
  await browser.close();
  program.kill('SIGINT');
  await ended;
}

async function compose(url) {
  const context = await browser.newContext({ viewport: { width: 1366, height: 768 }, colorScheme: 'light', reducedMotion: 'reduce' });
  const page = await context.newPage();
  page.setDefaultTimeout(WATCHDOG_MS);
  const problems = [];
  page.on('pageerror', (error) => problems.push(error.stack ?? String(error)));
  page.on('console', (message) => { if (message.type() === 'error') problems.push(message.text()); });
  await page.addInitScript(read(require.resolve('axe-core/axe.min.js'), 'utf8'));
  const picture = async (name) => { if (pictures) await page.screenshot({ path: join(pictures, `${name}.png`) }); };
  const state = page.locator('.top .chip');
  const is = (words) => until(`the page says "${words}"`, async () => (await state.textContent()) === words);
  const port = (module, side, name) => page.locator(`.graph-port[data-node="${module}"][data-side="${side}"][data-port="topic ${name}"]`);
  const wires = () => page.locator('.graph-edge').count();
  const field = (key) => page.locator(`#properties [data-key="${key}"]`);
  const give = async (key, value) => { await field(key).fill(value); await field(key).press('Tab'); };
  const onDisk = () => readFileSync(file, 'utf8');

  // Nothing is there yet.
  await page.goto(url);
  await page.locator('.kind').first().waitFor();
  assert(!page.url().includes('token'), 'the token leaves the address bar');
  await page.getByText('Compose a robot').waitFor();
  await is('new file');
  assert(await page.getByRole('button', { name: 'Run', exact: true }).isDisabled());
  await picture('beginning');
  const wrapped = (selector) => page.locator(selector).evaluateAll((names) => names
    .filter((name) => name.getClientRects().length !== 1 || name.clientHeight > 26).map((name) => name.textContent));
  assert.deepEqual(await wrapped('.kind b'), [], 'the names of kinds stay on one line');

  // Modules, found by search and added with mouse and keyboard.
  const search = page.getByRole('searchbox', { name: 'Search kinds' });
  const add = async (text, kind) => {
    await search.fill(text);
    await until('the search narrows the list', async () => await page.locator('.kind b').first().textContent() === kind);
    await search.press('Enter');
    await page.keyboard.press('Enter');
    await field('name').and(page.locator(`[value="${kind}"]`)).waitFor();
  };
  await add('darwin_op_em', 'darwin_op_emulator');
  await give('settings.link', 'memory:test');
  await give('name', 'emulator');
  await page.locator('.graph-body[data-node="emulator"][aria-pressed="true"]').waitFor();
  assert.equal(await field('name').inputValue(), 'emulator', 'a renamed module stays selected');
  await search.fill('');
  await page.getByTitle('Add darwin_op', { exact: true }).click();
  await page.locator('.graph-body[data-node="darwin_op"]').waitFor();
  await give('settings.port', 'memory:test');
  await add('nod and', 'stand_nod_wave');
  await add('joint_command_m', 'joint_command_mux');
  await search.fill('');
  const before = await wires();

  // A wire without a mouse: from a port to a port.
  await port('joint_command_mux', 'out', 'joint_goals').focus();
  await page.keyboard.press('Enter');
  await until('the wire can end somewhere', async () => await page.locator('.graph-port.is-possible').count() > 0);
  const target = port('darwin_op', 'in', 'joint_commands');
  for (let step = 0; step < 40 && !await target.evaluate((element) => element === document.activeElement); step += 1) await page.keyboard.press('ArrowDown');
  await page.keyboard.press('Enter');
  await until('the wire is there', async () => await wires() === before + 1);
  // Cut it, and draw it with the mouse.
  await page.keyboard.press('Control+z');
  await until('the wire is gone', async () => await wires() === before);
  await page.getByRole('button', { name: 'Show all' }).click();
  await port('joint_command_mux', 'out', 'joint_goals').locator('.graph-port-dot').dragTo(target.locator('.graph-port-dot'));
  await until('the wire is there again', async () => await wires() === before + 1);
  // Types are checked while a wire is drawn.
  await port('darwin_op', 'out', 'imu/data_raw').locator('.graph-port-dot').dragTo(target.locator('.graph-port-dot'));
  await page.locator('.graph-refusal').filter({ hasText: 'sensor_msgs/msg/Imu' }).waitFor();
  assert.equal(await wires(), before + 1);

  // Names of settings stay on one line, also long ones.
  for (const module of ['darwin_op', 'stand_nod_wave']) {
    await page.locator(`.graph-body[data-node="${module}"] .graph-title`).click();
    await page.locator('.row > label').first().waitFor();
    assert.deepEqual(await wrapped('.row > label'), []);
    const cut = await page.locator('.row > label').evaluateAll((names) => names.filter((name) => name.scrollWidth > name.clientWidth + 1).map((name) => name.textContent));
    assert.deepEqual(cut, []);
  }
  // A problem, with its place.
  await page.locator('.graph-body[data-node="darwin_op"] .graph-title').click();
  await give('settings.gyro_axes', 'x y up');
  await is('1 problem');
  await page.locator('.graph-body[data-node="stand_nod_wave"] .graph-title').click();
  await page.locator('button.problem').filter({ hasText: 'axes' }).click();
  await until('the field has the focus', () => field('settings.gyro_axes').evaluate((element) => element === document.activeElement));
  await picture('problem');
  assert(await page.getByRole('button', { name: 'Run', exact: true }).isDisabled());
  await page.getByRole('button', { name: /^Undo/ }).click();
  await is('not saved');

  // What ROS 2 sees and what is recorded: ticks.
  await page.keyboard.press('Escape');
  await page.locator('.graph-canvas').click({ position: { x: 12, y: 12 } });
  await page.getByRole('checkbox', { name: 'Expose joint_states to ROS 2' }).check();
  await until('it is exposed', async () => await page.locator('.graph-port-label').filter({ hasText: 'joint_states · ROS' }).count() > 0);
  await page.getByRole('checkbox', { name: 'Record bus/exchanges' }).uncheck();
  await picture('composed');

  // The text beside the graph.
  await page.getByRole('tab', { name: 'Text' }).click();
  const text = page.getByRole('textbox', { name: 'Text of the robot file' });
  await until('the text has all', async () => await text.inputValue() === EXPECTED);
  await text.fill(`${EXPECTED}[launcher`);
  await page.getByRole('alert').filter({ hasText: /line \d+:/ }).waitFor();
  await text.fill(`${EXPECTED}# by hand\n`);
  await until('the text is taken', async () => !await page.locator('#toml-problem').isVisible());
  await text.fill(EXPECTED);
  await until('it is as before', async () => await page.locator('#toml-problem').isHidden());
  await picture('text');
  await page.waitForTimeout(700);

  await page.keyboard.press('Control+s');
  await is('saved');
  assert.equal(onDisk(), EXPECTED);

  // Places of modules are in a file of their own.
  await page.getByRole('tab', { name: 'Properties' }).click();
  const body = page.locator('.graph-body[data-node="emulator"]');
  await body.focus();
  await page.keyboard.press('Alt+ArrowDown');
  await is('not saved');
  await page.keyboard.press('Control+s');
  await is('saved');
  assert.equal(onDisk(), EXPECTED);
  assert(JSON.parse(readFileSync(`${file}.layout.json`, 'utf8')).modules.emulator.y !== undefined);

  // Somebody else changes the file.
  writeFileSync(file, EXPECTED.replace('name = "robot"', 'name = "other"'));
  await is('changed on disk');
  await page.keyboard.press('Control+s');
  const dialog = page.getByRole('dialog');
  await dialog.getByText('> name = "other"').waitFor();
  await dialog.getByRole('button', { name: 'Take the file' }).click();
  await is('saved');
  await page.getByRole('button', { name: /^Undo/ }).click();
  await is('not saved');
  await page.keyboard.press('Control+s');
  await is('saved');
  assert.equal(onDisk(), EXPECTED);

  for (const colorScheme of ['light', 'dark']) {
    await page.emulateMedia({ colorScheme });
    assert.deepEqual(await seriousFaults(page), [], colorScheme);
  }
  await picture('dark');
  await page.emulateMedia({ colorScheme: 'light' });

  // It runs and is recorded, and its page shows it.
  await page.getByRole('button', { name: 'Record', exact: true }).click();
  const live = page.getByRole('link', { name: 'Watch it' });
  await live.waitFor();
  await picture('running');
  const [robot] = await Promise.all([context.waitForEvent('page'), live.click()]);
  await robot.locator('h1').filter({ hasText: 'robot' }).waitFor({ timeout: WATCHDOG_MS });
  await robot.close();
  const bag = await until('a bag is there', () => readdirSync(folder).find((name) => name.startsWith('robot_')));
  await until('the bag has messages', async () => {
    const info = await downbeat('bag', 'info', join(folder, bag)).catch(() => '');
    return /joint_states/.test(info);
  });
  await page.getByRole('button', { name: 'Stop' }).click();
  await page.locator('.out').filter({ hasText: 'recorded' }).first().waitFor();
  await page.getByRole('button', { name: 'Record', exact: true }).waitFor();
  const info = await downbeat('bag', 'info', join(folder, bag));
  assert.match(info, /Topic: \/joint_states/);
  assert.doesNotMatch(info, /Topic: \/bus\/exchanges/);
  assert.deepEqual(problems, []);
}
