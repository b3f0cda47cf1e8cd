// What a newcomer sees: her robot, which moves. Ends when it was seen.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL node first_look.mjs

import assert from 'node:assert/strict';
import { launch, look, open, until } from './browser.mjs';

const browser = await launch();
try {
  const { page, problems } = await open(browser, process.env.DOWNBEAT_PAGE);
  await look(page, 'scene');
  const picture = () => page.getByTestId('panel-scene').first().locator('canvas').first().screenshot();
  const before = await picture();
  await until('the robot moves', async () => !before.equals(await picture()));
  assert.deepEqual(problems, []);
} finally {
  await browser.close();
}
