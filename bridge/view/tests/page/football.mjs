// A match in the page: the field, what robots believe beside the truth, and their automata.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL node football.mjs
// (the page of `downbeat match robots/match.toml`)

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { launch, open, seriousFaults, until } from './browser.mjs';

let browser;
let page;
let problems;

before(async () => {
  browser = await launch();
  ({ page, problems } = await open(browser, process.env.DOWNBEAT_PAGE));
});
after(() => browser?.close());

const show = (panel) => page.evaluate((hash) => { location.hash = hash; }, panel);

test('the field shows score and time, and each robot believes to be about where it is', async () => {
  await show('match');
  const score = await until('there is a score', async () => /blue 0 : 0 red .*left/.exec(await page.getByTestId('match-score').innerText())?.[0]);
  assert.match(score, /first half, \d+:\d\d left/);
  const rows = page.getByTestId('match-robots').locator('tbody tr');
  await until('four robots are listed', async () => (await rows.count()) === 4);
  for (const [position, name] of ['blue_1', 'blue_2', 'red_1', 'red_2'].entries()) {
    const off = await until(`${name} believes something`, async () => {
      const [shown, states, place, ball] = await rows.nth(position).locator('td').allInnerTexts();
      assert.match(shown, new RegExp(name));
      return /\w/.test(states) && /^\d+ cm$/.test(place) && /^\d+ cm$/.test(ball) && [place, ball];
    });
    for (const distance of off) assert(parseInt(distance, 10) < 60, `${name} is off by ${distance}`);
  }
});

test('the dashboard opens with the field and all players', async () => {
  await show('/dashboard');
  const first = page.locator('[data-testid="dashboard"] > section').first();
  await until('the panel of the match is first', async () => await first.getAttribute('data-testid') === 'panel-match');
  await until('four robots are listed', async () => (await first.getByTestId('match-robots').locator('tbody tr').count()) === 4);
  await until('it and its neighbour fill the width', () => page.getByTestId('dashboard').evaluate((grid) => {
    const [right, ...edges] = [grid, ...grid.querySelectorAll(':scope > section')].map((element) => element.getBoundingClientRect().right);
    return Math.abs(right - edges[1]) < 24;
  }));
  await show('match');
});

test('the field is drawn: carpet, lines, robots and the ball', async () => {
  const counted = () => page.getByTestId('match-field').evaluate((canvas) => {
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    const near = (i, [r, g, b]) => Math.abs(data[i] - r) + Math.abs(data[i + 1] - g) + Math.abs(data[i + 2] - b) < 12;
    const wanted = { carpet: [46, 125, 67], blue: [47, 111, 224], red: [210, 59, 59], ball: [255, 140, 26] };
    return Object.fromEntries(Object.entries(wanted).map(([name, color]) => {
      let count = 0;
      for (let i = 0; i < data.length; i += 4) count += near(i, color) ? 1 : 0;
      return [name, count];
    }));
  });
  const colors = await until('the carpet is drawn', async () => {
    const found = await counted();
    return found.carpet > 0 && found;
  });
  assert(colors.carpet > 20 * (colors.blue + colors.red) && colors.blue > 50 && colors.red > 50 && colors.ball > 10, JSON.stringify(colors));
});

test('what the players did is listed, and who had the ball', async () => {
  const rows = page.getByTestId('match-robots').locator('tbody tr');
  for (let position = 0; position < 4; position++) {
    const cells = await until('the robot has counts', async () => {
      const texts = await rows.nth(position).locator('td').allInnerTexts();
      return /^\d+\.\d m$/.test(texts[8]) && texts;
    });
    for (const column of [5, 6, 7, 9, 10]) assert.match(cells[column], /^\d+/, cells.join('|'));
  }
  assert.match(await page.getByTestId('match-possession').getAttribute('aria-label'), /^Possession of the ball: blue .+ %, red .+ %$/);
});

test('a heat map shows where the ball lay', async () => {
  // A cell in which it always was: its colour on the carpet, almost opaque.
  const cells = () => page.getByTestId('match-field').evaluate((canvas) => {
    const { data } = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height);
    let count = 0;
    for (let i = 0; i < data.length; i += 4) count += Math.abs(data[i] - 234) + Math.abs(data[i + 1] - 138) + Math.abs(data[i + 2] - 30) < 10 ? 1 : 0;
    return count;
  });
  const heat = page.getByLabel('heat map of');
  await heat.selectOption('');
  await until('there is no heat map', async () => (await cells()) < 20);
  await heat.selectOption('ball');
  await until('the cell of the ball is drawn', async () => (await cells()) > 50);
  await heat.selectOption('');
});

test('a chart marks the active state', async () => {
  await show('blue_2-player');
  const active = await until('a state is active', async () => {
    const names = await page.locator('section[aria-current="true"] > strong').allInnerTexts();
    return names.length > 0 && names;
  });
  assert(active.some((name) => ['stand', 'take_position', 'play'].includes(name)), active.join());
});

test('axe finds no serious fault', async () => {
  await show('match');
  await page.getByTestId('match-field').waitFor();
  assert.deepEqual(await seriousFaults(page), []);
});

test('the browser has nothing to complain about', () => {
  assert.deepEqual(problems, []);
});
