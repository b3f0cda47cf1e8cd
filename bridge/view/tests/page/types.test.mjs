// Types and weight of the page.

import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { readFileSync, readdirSync } from 'node:fs';
import { createRequire } from 'node:module';
import { join } from 'node:path';
import { test } from 'node:test';
import { fileURLToPath } from 'node:url';
import { gzipSync } from 'node:zlib';

const folder = fileURLToPath(new URL('../../page/', import.meta.url));
const HEAVIEST = 600_000;

test('the types of all modules fit', { skip: !process.env.DOWNBEAT_NODE_MODULES && 'DOWNBEAT_NODE_MODULES is not set' }, () => {
  const require = createRequire(join(process.env.DOWNBEAT_NODE_MODULES, 'index.js'));
  try {
    execFileSync(process.execPath, [require.resolve('typescript/bin/tsc'), '--project', join(folder, 'jsconfig.json'), '--pretty', 'false'], { encoding: 'utf8' });
  } catch (error) {
    assert.fail(error.stdout || error);
  }
});

test('every script asks for its types to be checked', () => {
  const scripts = readdirSync(folder, { recursive: true }).filter((name) => name.endsWith('.js'));
  assert(scripts.length > 10);
  for (const name of scripts) assert(readFileSync(join(folder, name), 'utf8').startsWith('// @ts-check\n'), name);
});

test('the page is light', () => {
  const files = readdirSync(folder, { recursive: true, withFileTypes: true }).filter((file) => file.isFile() && /\.(html|css|js|svg|png)$/.test(file.name));
  const sizes = files.map((file) => gzipSync(readFileSync(join(file.parentPath ?? file.path, file.name))).length);
  const total = sizes.reduce((sum, size) => sum + size, 0);
  console.log(`${files.length} files, ${total} bytes compressed`);
  assert(total < HEAVIEST, `${total} bytes`);
});
