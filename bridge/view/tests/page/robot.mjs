// Each view of the page, at a running emulated robot: what it shows is compared with what other commands of the program say.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT=PROGRAM DOWNBEAT_PAGE=URL DOWNBEAT_FOLDER=… node robot.mjs
// (the last is the folder in which the robot runs)

import assert from 'node:assert/strict';
import { existsSync } from 'node:fs';
import { resolve } from 'node:path';
import { after, before, test } from 'node:test';
import { VIEWS, downbeat, facts, launch, look, open, seriousFaults, until } from './browser.mjs';

const url = process.env.DOWNBEAT_PAGE;
let browser;
let page;
let problems;

const snapshot = async () => JSON.parse(await downbeat('top', '--json'));
const whole = (text) => Number(text.replaceAll(',', ''));
/** The message that `topic echo` prints next, as lines of YAML. */
const echo = async (topic) => (await downbeat('topic', 'echo', '--once', topic, '--full-length', '--spin-time', '40')).split('\n');
/** The items below a key of a message. */
const items = (lines, key) => {
  const at = lines.indexOf(`${key}:`);
  const rest = lines.slice(at + 1);
  const end = rest.findIndex((line) => !line.startsWith('- '));
  return rest.slice(0, end).map((line) => line.slice(2));
};

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, url));
});
after(() => browser?.close());

test('the address bar does not keep the token', async () => {
  assert(!page.url().includes('token'), page.url());
  assert(url.includes('token'));
});

test('the graph has all modules and topics', async () => {
  await look(page, 'graph');
  await page.locator('.graph-body').first().waitFor();
  const { modules, topics } = await snapshot();
  const nodes = await page.locator('.graph-body').evaluateAll((bodies) => bodies.map((body) => body.dataset.node));
  const of = (kind) => nodes.filter((id) => id.startsWith(kind)).map((id) => id.slice(2)).sort();
  const named = (list, isHidden) => list.map(({ name }) => name).filter((name) => !isHidden.test(name)).sort();
  assert.deepEqual(of('m:'), named(modules, /_journal$|^bridge_services$|^process_diagnostics$|^latency_watch$/));
  assert.deepEqual(of('t:'), named(topics, /^(executor|bridge|record)\/|(^|\/)(rosout|parameter_events)$|^cycle_(messages|times)$|^module_(steps|settings|events|runs)$/));
  assert(of('m:').includes('hardware') && of('t:').includes('joint_states'));
  await page.getByTestId('graph-filter').click();
  await page.getByTestId('graph-debug').check();
  const all = await page.locator('.graph-body').evaluateAll((bodies) => bodies.map((body) => body.dataset.node));
  assert.deepEqual(all.filter((id) => id.startsWith('m:')).length, modules.length);
  assert.deepEqual(all.filter((id) => id.startsWith('t:')).length, topics.length);
  await page.getByTestId('graph-debug').uncheck();
});

test('a module of the graph shows true counts and its settings', async () => {
  await look(page, 'graph');
  await page.locator('[data-node="m:mux"].graph-body').click();
  const runs = (from) => from.modules.find(({ name }) => name === 'mux').runs;
  const list = page.getByTestId('graph-detail').getByTestId('graph-facts');
  const earlier = runs(await snapshot());
  const shown = await until('the count grows', async () => {
    const { Runs } = await facts(list);
    return whole(Runs) > earlier && whole(Runs);
  });
  const later = runs(await snapshot());
  assert(shown <= later, `${earlier} < ${shown} <= ${later}`);
  // Late where the machine is too busy for a loop of 8 ms.
  assert.match(await page.getByTestId('graph-state').innerText(), /^(active|late)$/);
  const settings = await facts(page.getByTestId('graph-settings').locator('dl'));
  const hold = await downbeat('param', 'get', '/darwin_op', 'mux.hold_s', '--hide-type', '--spin-time', '40');
  assert.equal(Number(settings.hold_s), Number(hold));
  assert.match(await page.getByTestId('graph-detail').innerText(), /kind joint_command_mux/);
});

test('a topic of the graph shows its type and its last message', async () => {
  await look(page, 'graph');
  await page.locator('[data-node="t:joint_states"].graph-body').click();
  assert.equal(await page.getByTestId('graph-type').innerText(), 'sensor_msgs/msg/JointState');
  const names = items(await echo('/joint_states'), 'name');
  assert.equal(names.length, 20);
  const message = await until('a message is shown', async () => {
    const text = await page.getByTestId('graph-message').innerText();
    return text.includes('position') && text;
  });
  const shown = JSON.parse(/name: (\[[^\]]*\])/.exec(message)[1]);
  assert.deepEqual(shown, names);
});

test('a topic of the graph leads to its raw messages and to a plot', async () => {
  await look(page, 'graph');
  await page.locator('[data-node="t:imu/data_raw"].graph-body').click();
  await until('a message is shown', async () => (await page.getByTestId('graph-message').innerText()).includes('linear_acceleration'));
  await page.getByTestId('graph-raw').click();
  await page.getByTestId('message').filter({ hasText: 'angular_velocity' }).waitFor();
  await look(page, 'graph');
  await page.locator('[data-node="t:imu/data_raw"].graph-body').click();
  await until('a message is shown', async () => (await page.getByTestId('graph-message').innerText()).includes('linear_acceleration'));
  await page.getByTestId('graph-plot').click();
  await page.getByTestId('plot-legend').filter({ hasText: 'linear_acceleration' }).waitFor();
});

test('the graph lists the measured chains, warns of those above their limit, and marks the way of the chosen one', async () => {
  await look(page, 'graph');
  const table = page.getByTestId('graph-chains');
  await table.waitFor();
  const row = (name) => table.locator(`tr[data-chain=${name}]`);
  const cells = (name) => row(name).evaluate((each) => [...each.cells].map((cell) => cell.innerText.trim()));
  const shown = await until('both chains have figures', async () => {
    const both = await Promise.all(['reaction', 'motion'].map(cells));
    return both.every((each) => /\d (µs|ms)$/.test(each[2])) && both;
  });
  assert.deepEqual(shown.map((each) => each[1]), ['joint_states → joint_goals', 'joint_states → motion/joint_commands']);
  assert.deepEqual([await table.locator('tbody tr').count(), shown[0][6]], [2, '0']);
  assert.match(shown[1][7], /^joint_states waited .+ for motion, which kept it/);
  // Times of the newest messages: between what the command says before and after.
  const measured = async () => (await snapshot()).latencies.find(({ name }) => name === 'motion');
  const earlier = await measured();
  const exceeded = await until('the count of old messages grows', async () => {
    const number = whole(/[\d,]+$/.exec((await cells('motion'))[6])[0]);
    return number > earlier.exceeded && number;
  });
  const later = await measured();
  assert(exceeded <= later.exceeded, `${earlier.exceeded} < ${exceeded} <= ${later.exceeded}`);
  const mark = (name) => row(name).getByText('above the limit');
  await mark('motion').waitFor();
  assert(await mark('reaction').isHidden());

  const button = row('reaction').getByRole('button');
  await button.focus();
  await page.keyboard.press('Enter');
  await until('the chain is chosen', async () => (await button.getAttribute('aria-pressed')) === 'true');
  const found = () => page.locator('.graph-node.is-found .graph-body').evaluateAll((bodies) => bodies.map((body) => body.dataset.node).sort());
  const edges = () => page.locator('.graph-edge.is-found').evaluateAll((groups) => groups.map((group) => group.dataset.edge).sort());
  const way = ['m:motion', 'm:mux', 't:joint_goals', 't:joint_states', 't:motion/joint_commands'];
  assert.deepEqual(await found(), way);
  assert.deepEqual(await edges(), ['m:motion→t:motion/joint_commands', 'm:mux→t:joint_goals', 't:joint_states→m:motion', 't:motion/joint_commands→m:mux']);
  assert.equal(await page.locator('.graph-edge.is-found.tone-late').count(), 0);
  await row('motion').getByRole('button').click();
  await until('the other chain is marked, in the colour of warnings', async () => (await page.locator('.graph-edge.is-found.tone-late').count()) === 2);
  assert.deepEqual(await found(), ['m:motion', 't:joint_states', 't:motion/joint_commands']);
  // Nodes are drawn again with each look at the robot.
  const text = () => page.locator('[data-node="m:motion"].graph-body').evaluate((body) => body.textContent);
  const before = await text();
  await until('the figures of a module change', async () => (await text()) !== before);
  assert.deepEqual(await found(), ['m:motion', 't:joint_states', 't:motion/joint_commands'], 'still marked');
  await row('motion').getByRole('button').click();
  await until('nothing is marked', async () => (await found()).length === 0);
});

test('the graph is used with the keyboard, and searched', async () => {
  await look(page, 'graph');
  const at = () => page.evaluate(() => document.activeElement?.getAttribute('data-node'));
  await page.locator('[data-node="m:hardware"].graph-body').focus();
  const reached = new Set([await at()]);
  for (const key of ['ArrowDown', 'ArrowRight', 'ArrowRight', 'ArrowLeft', 'ArrowUp', 'ArrowDown']) {
    await page.keyboard.press(key);
    reached.add(await at());
  }
  assert(reached.size >= 3 && !reached.has(null), [...reached].join());
  await page.keyboard.press('Enter');
  const selected = await at();
  assert.equal(await page.getByTestId('graph-detail-title').innerText(), selected.slice(2));
  await page.keyboard.press('Escape');
  assert(await page.getByTestId('graph-detail').isHidden());
  if (await page.getByTestId('graph-search').isHidden()) await page.getByTestId('graph-filter').click();
  await page.getByTestId('graph-search').fill('MUX');
  const found = await page.locator('.graph-node.is-found .graph-body').evaluateAll((bodies) => bodies.map((body) => body.dataset.node));
  assert(found.includes('m:mux') && found.every((id) => /mux/i.test(id)), found.join());
  await page.getByTestId('graph-search').press('Enter');
  assert.equal(await page.getByTestId('graph-detail-title').innerText(), found[0].slice(2));
  await page.getByTestId('graph-search').fill('');
});

test('wires are drawn between ports with the mouse and with the keyboard', async () => {
  const seen = await open(browser, url);
  const { page: sheet } = seen;
  await look(sheet, 'log');
  await sheet.evaluate(async () => {
    const { GraphView } = await import('/graph/view.js');
    const stage = document.createElement('div');
    Object.assign(stage.style, { position: 'fixed', inset: '0', zIndex: '99', background: 'Canvas' });
    document.body.append(stage);
    window.wires = [];
    const port = (id, side) => ({ id, side, label: id });
    const view = new GraphView(stage, {
      label: 'Wires', onConnect: (from, to) => window.wires.push(`${from.node}.${from.port} > ${to.node}.${to.port}`),
      refusal: (from, to) => (from.port === 'text' && to.port !== 'words' ? 'the types differ' : null),
    });
    view.show({
      nodes: [{ id: 'a', kind: 'module', title: 'a', ports: [port('text', 'out'), port('number', 'out')] },
        { id: 'b', kind: 'module', title: 'b', ports: [port('words', 'in'), port('value', 'in')] }],
      edges: [{ id: 'e', from: 'a', to: 'b', fromPort: 'number', toPort: 'value' }],
    });
  });
  const dot = async (node, port) => {
    const box = await sheet.locator(`.graph-port[data-node=${node}][data-port=${port}] .graph-port-dot`).boundingBox();
    return [box.x + box.width / 2, box.y + box.height / 2];
  };
  const drag = async (from, to) => {
    await sheet.mouse.move(...from);
    await sheet.mouse.down();
    await sheet.mouse.move(...to, { steps: 5 });
    await sheet.mouse.up();
  };
  const wires = () => sheet.evaluate(() => window.wires.splice(0));
  await sheet.locator('.graph-port').first().waitFor();
  await drag(await dot('a', 'text'), await dot('b', 'words'));
  assert.deepEqual(await wires(), ['a.text > b.words']);
  await drag(await dot('b', 'value'), await dot('a', 'number'));
  assert.deepEqual(await wires(), ['a.number > b.value'], 'from the input too');
  await drag(await dot('a', 'text'), await dot('b', 'value'));
  await sheet.locator('.graph-refusal', { hasText: 'the types differ' }).waitFor();
  await drag(await dot('a', 'text'), [20, 20]);
  assert.deepEqual(await wires(), []);
  await sheet.locator('.graph-body[data-node=a]').focus();
  for (const key of ['Tab', 'Enter', 'ArrowDown', 'Enter']) await sheet.keyboard.press(key);
  assert.deepEqual(await wires(), ['a.text > b.words'], 'the only port that it may end at');
  await seen.close();
});

test('the timeline has runs of the modules that run, in cycles of now', async () => {
  await look(page, 'timeline');
  const { modules, cycle: earlier } = await snapshot();
  await page.getByTestId('timeline-table').click();
  const rows = page.getByTestId('timeline-events').locator('tbody tr');
  const cells = await until('a trace of newer cycles is shown', async () => {
    const all = await rows.evaluateAll((each) => each.map((row) => [...row.cells].map((cell) => cell.textContent)));
    return all.length > 0 && all.every((row) => Number(row[3]) >= earlier) && all;
  });
  const { cycle: later } = await snapshot();
  const names = new Set([...modules.map(({ name }) => name), 'Process phase', 'Sync phase']);
  for (const [name, , , cycle] of cells) {
    assert(names.has(name), name);
    assert(Number(cycle) <= later, `${cycle} <= ${later}`);
  }
  assert(cells.some(([name]) => name === 'mux'), 'mux runs in each cycle');
  assert(cells.some(([, , , , , cause]) => cause.includes('message on')), 'causes are known');
  await page.getByTestId('timeline-table').click();
  await page.getByTestId('timeline-canvas').focus();
  await page.keyboard.press('ArrowRight');
  await until('a run is named', async () => /cycle \d+/.test(await page.getByTestId('timeline-focused').innerText()));
});

test('the robot is paused, runs one cycle for one click, and goes on', async () => {
  await look(page, 'timeline');
  await page.getByTestId('timeline-pause').click();
  await until('the robot is paused', async () => (await snapshot()).is_paused);
  const { cycle } = await snapshot();
  assert.equal((await snapshot()).cycle, cycle, 'no cycle runs');
  await page.getByTestId('timeline-step').click();
  await until('one cycle ran', async () => (await snapshot()).cycle === cycle + 1);
  const shown = page.getByText(/This is cycle \d+/);
  await shown.waitFor();
  const number = Number(/cycle (\d+)/.exec(await shown.innerText())[1]);
  assert(number === cycle || number === cycle + 1, `${number} after ${cycle}`);
  assert.equal((await snapshot()).cycle, cycle + 1, 'not more');
  await page.getByTestId('timeline-pause').click();
  await until('the robot goes on', async () => (await snapshot()).cycle > cycle + 1);
});

test('a parameter set in the page is set for others', async () => {
  await look(page, 'parameters');
  const field = page.locator('[id="setting-mux.hold_s"]');
  await field.fill('3.25');
  await field.press('Enter');
  await until('the parameter is set', async () => (await downbeat('param', 'get', '/darwin_op', 'mux.hold_s', '--spin-time', '40')).includes('3.25'));
  await field.fill('soon');
  await field.press('Enter');
  await page.locator('[id="setting-mux.hold_s-problem"]').filter({ hasText: /\S/ }).waitFor();
  assert((await downbeat('param', 'get', '/darwin_op', 'mux.hold_s', '--spin-time', '40')).includes('3.25'));
  await field.press('Escape');
});

test('servos stand where the robot says', async () => {
  await look(page, 'servos');
  await page.getByRole('button', { name: 'rad', exact: true }).click();
  const read = async () => {
    const lines = await echo('/joint_states');
    const positions = items(lines, 'position').map(Number);
    return new Map(items(lines, 'name').map((name, index) => [name, positions[index]]));
  };
  const earlier = await read();
  const rows = await page.getByTestId('servos').locator('tbody tr').evaluateAll((each) => each.map((row) => [...row.cells].map((cell) => cell.textContent)));
  const later = await read();
  const shown = new Map(rows.map((row) => [row[1], Number(row[2].replace('−', '-'))]));
  assert.deepEqual([...shown.keys()].sort(), [...earlier.keys()].sort());
  // Head and arms move.
  const still = [...earlier.keys()].filter((name) => Math.abs(earlier.get(name) - later.get(name)) < 0.01);
  assert(still.length >= 6, still.join());
  for (const name of still) assert(Math.abs(shown.get(name) - earlier.get(name)) < 0.15, `${name}: ${shown.get(name)}, not ${earlier.get(name)}`);
});

test('diagnostics show every part that reports', async () => {
  await look(page, 'diagnostics');
  const names = (await echo('/diagnostics')).flatMap((line) => /^(?:- | {2})name: '?(.*?)'?$/.exec(line)?.[1] ?? []);
  assert(names.length > 0);
  await until('all parts are shown', async () => {
    const text = await page.getByTestId('diagnostics').evaluate((list) => list.textContent);
    return names.every((name) => text.includes(name.split(' ').at(-1)));
  });
});

test('the list of topics has types and counts, and a published message arrives', async () => {
  await look(page, 'topics');
  await page.getByTestId('topics-search').fill('joint_commands');
  const row = page.getByTestId('topics').getByRole('button', { name: '/joint_commands', exact: true });
  await row.click();
  await page.getByText('Publish on this topic').click();
  const count = async () => (await snapshot()).topics.find(({ name }) => name === 'joint_commands').messages;
  const earlier = await count();
  const message = JSON.parse(await page.getByTestId('publish-text').inputValue());
  await page.getByTestId('publish-text').fill(JSON.stringify({ ...message, name: ['head_pan'], position: [0.1] }));
  await page.getByTestId('publish').click();
  await until('the message arrives', async () => (await count()) === earlier + 1);
  await page.getByTestId('message').filter({ hasText: 'head_pan' }).waitFor();
  await page.getByTestId('topics-search').fill('');
});

test('states of the life cycle are those of the modules', async () => {
  await look(page, 'lifecycle');
  const { modules } = await snapshot();
  const rows = await until('all modules are listed', async () => {
    const all = await page.getByTestId('lifecycle').locator('tbody tr').evaluateAll((each) => each.map((row) => [row.cells[0].textContent, row.cells[1].textContent]));
    return all.length === modules.length && all;
  });
  assert.deepEqual(rows.sort(), modules.map(({ name, state }) => [name, state]).sort());
});

test('a recording is started and stopped, and is a bag', async () => {
  await look(page, 'recording');
  await page.getByTestId('record').click();
  const path = await until('a bag is written', async () => /Writes to (.*)\./.exec(await page.locator('.sheet').innerText())?.[1]);
  await page.getByTestId('recording-mark').waitFor();
  await until('messages are counted', async () => whole((await page.locator('.fact').first().innerText()).split('\n')[1].replace('–', '0')) > 20);
  await page.getByTestId('stop_recording').click();
  await page.getByText('Not recording').waitFor();
  const bag = resolve(process.env.DOWNBEAT_FOLDER, path);
  assert(existsSync(bag), bag);
  assert.match(await downbeat('bag', 'info', bag), /joint_states/);
});

test('the log and the plot have something to show', async () => {
  await look(page, 'log');
  await page.getByTestId('log').waitFor();
  await look(page, 'plot');
  const legend = page.getByTestId('plot-legend');
  await until('lines are drawn', async () => /\d/.test(await legend.innerText()));
});

test('the dashboard shows the robot, and a theme is chosen', async () => {
  await look(page, 'dashboard');
  await page.getByTestId('panel-graph').locator('.graph-body').first().waitFor();
  assert.equal(await page.getByTestId('robot-name').innerText(), 'darwin_op');
  const background = () => page.evaluate(() => getComputedStyle(document.documentElement).backgroundColor);
  const light = await background();
  await until('it is dark', async () => {
    await page.getByTestId('theme').click();
    return (await background()) !== light;
  });
  await until('it is as before', async () => {
    await page.getByTestId('theme').click();
    return /as the system/.test(await page.getByTestId('theme').getAttribute('aria-label'));
  });
});

test('the dashboard follows the topics of the robot until somebody places a panel', async () => {
  await look(page, 'dashboard');
  const kept = () => page.evaluate(() => JSON.parse(localStorage.getItem('downbeat.layout.darwin_op') ?? '{}').cards?.map(({ kind }) => kind));
  assert.equal(await kept(), undefined);
  const shown = () => page.locator('[data-testid="dashboard"] > section').evaluateAll((cards) => cards.map((card) => card.dataset.testid));
  const first = await shown();
  await page.evaluate(() => {
    const { robot } = window;
    robot.channels.set('/late', { topic: '/late', schemaName: 'sensor_msgs/msg/CompressedImage' });
    robot.dispatchEvent(new Event('channels'));
  });
  await until('a camera that appears is shown', async () => (await shown()).includes('panel-camera'));
  await page.evaluate(() => {
    const { robot } = window;
    robot.channels.delete('/late');
    robot.dispatchEvent(new Event('channels'));
  });
  await until('and is gone with its topic', async () => JSON.stringify(await shown()) === JSON.stringify(first));
  await page.getByTestId('add-panel').click();
  await page.getByRole('menuitem', { name: 'Servos' }).click();
  await until('an edited layout is kept', async () => (await kept())?.includes('servos'));
  await page.getByTestId('add-panel').click();
  await page.getByRole('menuitem', { name: 'Panels as at first' }).click();
  await until('and then no longer', async () => (await kept()) === undefined);
});

for (const scheme of ['light', 'dark']) {
  test(`axe finds no serious fault, ${scheme}`, async () => {
    const seen = await open(browser, url, { scheme });
    const faults = [];
    for (const view of VIEWS) {
      await look(seen.page, view);
      // What is asked for arrives.
      await seen.page.waitForTimeout(700);
      faults.push(...(await seriousFaults(seen.page)).map((fault) => `${view}: ${fault}`));
    }
    assert.deepEqual(faults, []);
    assert.deepEqual(seen.problems, []);
    await seen.close();
  });
}

test('nothing is wider than a phone', async () => {
  const phone = await open(browser, url, { width: 360, height: 740 });
  for (const view of VIEWS) {
    await look(phone.page, view);
    const width = await phone.page.evaluate(() => document.documentElement.scrollWidth);
    assert(width <= 360, `${view} is ${width} px wide`);
  }
  await phone.close();
});

test('who has no token may look, and cannot pause', async () => {
  const seen = await open(browser, url.replace(/#.*/, ''));
  await look(seen.page, 'timeline');
  await until('the panel knows', async () => seen.page.getByTestId('timeline-pause').isDisabled());
  const refusal = await seen.page.evaluate(() => window.robot.ask('pause').catch((error) => error.message));
  assert.match(refusal ?? 'paused', /only look/);
  assert.equal((await snapshot()).is_paused, false);
  await seen.close();
});

test('how long the first picture takes', async () => {
  const seen = await open(browser, url);
  const ms = await seen.page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime);
  // Measured, not demanded: the machine may be busy.
  console.log(`first contentful paint after ${Math.round(ms)} ms`);
  await seen.close();
});

test('the browser has nothing to complain about', () => {
  assert.deepEqual(problems, []);
});
