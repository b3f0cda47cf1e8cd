// Takes the pictures of docs/view.md: the views of the page at a running robot, in light, and some in dark and on a phone.
//
// Usage: DOWNBEAT_NODE_MODULES=… DOWNBEAT_CHROMIUM=… DOWNBEAT_PAGE=URL node pictures.mjs FOLDER

import { join } from 'node:path';
import { VIEWS, launch, look, open } from './browser.mjs';

const folder = process.argv[2];
const browser = await launch();

async function take(names, look_, wait) {
  const { page, close } = await open(browser, process.env.DOWNBEAT_PAGE, look_);
  for (const [view, name] of names) {
    await look(page, view);
    if (view === 'topics') await page.getByTestId('topics').getByRole('button', { name: '/joint_states', exact: true }).click();
    await page.waitForTimeout(wait);
    await page.screenshot({ path: join(folder, `${name}.jpg`), type: 'jpeg', quality: 80 });
  }
  await close();
}

await take(VIEWS.map((view) => [view, view]), { width: 1280, height: 800 }, 7000);
await take([['dashboard', 'dashboard_dark']], { scheme: 'dark', width: 1280, height: 800 }, 7000);
await take([['dashboard', 'dashboard_phone']], { width: 390, height: 844 }, 7000);
await browser.close();
