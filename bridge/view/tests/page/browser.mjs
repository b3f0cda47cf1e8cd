// A browser that looks at the page, for the tests and the bench beside this file.

import { execFile } from 'node:child_process';
import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { promisify } from 'node:util';

const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, 'index.js'));
const { chromium } = require('playwright-core');
const axe = readFileSync(require.resolve('axe-core/axe.min.js'), 'utf8');

/** Generous: the machine may be busy. */
export const WATCHDOG_MS = 60_000;

/** The views that the navigation leads to. */
export const VIEWS = ['dashboard', 'scene', 'camera', 'graph', 'timeline', 'servos', 'plot', 'log', 'diagnostics', 'parameters', 'topics', 'lifecycle', 'recording'];

export const launch = () =>
  chromium.launch({ executablePath: process.env.DOWNBEAT_CHROMIUM, args: ['--no-sandbox', '--headless=new'], timeout: WATCHDOG_MS });

/**
 * Opens the page and waits until it shows the robot. `problems` collects what the browser complains about.
 * @param {{ scheme?: 'light' | 'dark', width?: number, height?: number }} [look]
 */
export async function open(browser, url, { scheme = 'light', width = 1280, height = 800 } = {}) {
  const context = await browser.newContext({ viewport: { width, height }, colorScheme: scheme, reducedMotion: 'reduce' });
  const page = await context.newPage();
  page.setDefaultTimeout(WATCHDOG_MS);
  const problems = [];
  page.on('pageerror', (error) => problems.push(error.stack ?? String(error)));
  page.on('console', (message) => { if (message.type() === 'error') problems.push(`${message.text()} ${message.location().url}`); });
  await page.addInitScript(axe);
  await page.goto(url);
  await page.getByTestId('connection').filter({ hasText: /Live|Paused|Playing/ }).waitFor();
  return { page, problems, close: () => context.close() };
}

/** Goes to a view and waits for its panel. */
export async function look(page, view) {
  await page.evaluate((hash) => { location.hash = hash; }, view);
  await page.getByTestId(view === 'dashboard' ? 'dashboard' : `panel-${view}`).first().waitFor();
  const problem = page.getByText('This panel cannot be shown.');
  if (await problem.count()) throw new Error(`${view}: ${await page.locator('.card-body').first().innerText()}`);
}

/** What axe-core calls serious or critical, as lines. */
export async function seriousFaults(page) {
  const { violations } = await page.evaluate(() => globalThis.axe.run(document, { resultTypes: ['violations'] }));
  return violations.filter(({ impact }) => impact === 'serious' || impact === 'critical')
    .flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) => `${id}: ${target} ${failureSummary}`));
}

/** Asks again and again until `ask` returns something true, which is returned. */
export async function until(what, ask) {
  const begin = Date.now();
  for (;;) {
    const answer = await ask();
    if (answer) return answer;
    if (Date.now() - begin > WATCHDOG_MS) throw new Error(`gave up waiting until ${what}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

/** Runs the program `downbeat` and returns what it prints. */
export async function downbeat(...line) {
  const { stdout } = await promisify(execFile)(process.env.DOWNBEAT, line, { maxBuffer: 64 << 20, timeout: WATCHDOG_MS });
  return stdout;
}

/** The terms and values of a list of facts. */
export const facts = (list) =>
  list.evaluate((element) => Object.fromEntries([...element.querySelectorAll('dt')].map((term) => [term.textContent, term.nextElementSibling?.textContent])));
