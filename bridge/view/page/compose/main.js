// @ts-check
// The editor of a robot file: list of kinds, graph, forms, text, problems, and the robot that runs.

import { h, icon, iconButton } from '../panel.js';
import { Editor } from './asks.js';
import { Canvas } from './canvas.js';
import { drawer } from './drawer.js';
import { inspector } from './inspector.js';
import { palette } from './palette.js';
import { textView } from './text.js';

/** @typedef {import('./asks.js').Doc} Doc */
/** @typedef {import('./asks.js').Profiles} Profiles */

const LOOK_MS = 700;
const DISK_MS = 4000;

const byId = (/** @type {string} */ id) => /** @type {HTMLElement} */ (document.getElementById(id));
const editor = new Editor();
/** @type {Doc | null} */
let doc = null;
/** @type {Profiles | null} */
let profiles = null;
/** @type {{ module: string } | { wire: number } | null} */
let selection = null;
let isRunning = false;
let isStarting = false;
let nextLine = 0;
/** Edits one after the other: each is made on what the one before left. @type {Promise<any>} */
let queue = Promise.resolve();

// ---- the parts of the page

const kinds = palette(byId('palette'), (kind) => add(kind.kind));
const canvas = new Canvas(byId('graph'), {
  select, edit, remove,
  open: (module) => { select({ module }); showSide('properties'); props.focus('name'); },
  moved: (places) => { if (doc) { doc.layout = places; doc.is_dirty = true; drawTop(); } queue = queue.then(() => editor.ask('layout', { modules: places })).catch(report); },
});
const properties = h('div', { class: 'scroll', id: 'properties', role: 'tabpanel', 'aria-label': 'Properties' });
const text = h('div', { class: 'text', id: 'text', role: 'tabpanel', 'aria-label': 'Text', hidden: true });
const sideTabs = [['properties', 'Properties'], ['text', 'Text']].map(([id, title]) => h('button', { type: 'button', role: 'tab', 'aria-controls': id, onclick: () => showSide(id) }, title));
byId('side').append(h('div', { class: 'tabs', role: 'tablist', onkeydown: (/** @type {KeyboardEvent} */ event) => {
  if (event.key !== 'ArrowLeft' && event.key !== 'ArrowRight') return;
  const other = sideTabs[(sideTabs.indexOf(/** @type {any} */ (document.activeElement)) + 1) % 2];
  other.click();
  other.focus();
} }, sideTabs), properties, text);
const props = inspector(properties, { edit, remove, select, goTo: (line) => { showSide('text'); toml.goTo(line); } });
const toml = textView(text, (changed) => change(() => editor.ask('edit', { edits: [{ op: 'text', text: changed }] }), true));
const below = drawer(byId('drawer'), (problem) => {
  if (problem.module) {
    select({ module: problem.module });
    canvas.view.reveal(problem.module);
    showSide('properties');
    if (problem.key && props.focus(problem.key)) return;
    canvas.view.focus(problem.module);
  } else if (problem.line) {
    showSide('text');
    toml.goTo(problem.line);
  }
});
const welcome = h('div', { class: 'welcome', hidden: true });
byId('graph').append(welcome);

const title = h('h1', { class: 'mono' });
const state = h('span', { class: 'chip plain', role: 'status' });
const undo = iconButton('lifecycle', 'Undo (Ctrl+Z)', () => step('undo'), { class: 'icon-button undo' });
const redo = iconButton('lifecycle', 'Redo (Ctrl+Shift+Z)', () => step('redo'));
const save = h('button', { type: 'button', class: 'button', onclick: () => store(), title: 'Save (Ctrl+S)' }, 'Save');
const arrange = h('button', { type: 'button', class: 'button', title: 'Place the modules by themselves', onclick: tidy }, icon('graph'), 'Arrange');
const run = h('button', { type: 'button', class: 'button primary', onclick: () => start(false) }, icon('play'), 'Run');
const record = h('button', { type: 'button', class: 'button', onclick: () => start(true), title: 'Run, and record a bag beside the robot file' }, icon('recording'), 'Record');
const stop = h('button', { type: 'button', class: 'button danger', onclick: halt, hidden: true }, icon('close'), 'Stop');
const live = h('a', { class: 'button live', target: '_blank', rel: 'noopener', hidden: true }, icon('scene'), 'Watch it');
const theme = iconButton('auto', 'Light or dark', () => {
  const present = document.documentElement.dataset.theme ?? (matchMedia('(prefers-color-scheme: dark)').matches ? 'dark' : 'light');
  document.documentElement.dataset.theme = present === 'dark' ? 'light' : 'dark';
  try { localStorage.setItem('downbeat.theme', document.documentElement.dataset.theme); } catch { /* not kept */ }
});
byId('top').append(
  h('div', { class: 'brand' }, h('img', { src: 'icon.svg', alt: 'downbeat' })), title, state,
  h('div', { class: 'group' }, undo, redo), save, arrange, h('span', { class: 'spacer' }), live, run, record, stop, theme);
try {
  const kept = localStorage.getItem('downbeat.theme');
  if (kept === 'light' || kept === 'dark') document.documentElement.dataset.theme = kept;
} catch { /* the system's choice */ }
showSide('properties');

// ---- what is shown

/** @param {string} id */
function showSide(id) {
  properties.hidden = id !== 'properties';
  text.hidden = id !== 'text';
  document.body.classList.toggle('has-text', id === 'text');
  for (const tab of sideTabs) {
    const isChosen = tab.getAttribute('aria-controls') === id;
    tab.setAttribute('aria-selected', String(isChosen));
    tab.tabIndex = isChosen ? 0 : -1;
  }
}

/** @param {Doc} shown */
function show(shown) {
  doc = shown;
  const { modules, wires, problems } = doc.picture;
  if (selection && 'module' in selection && !modules.some(({ name }) => name === /** @type {any} */ (selection).module)) selection = null;
  if (selection && 'wire' in selection && selection.wire >= wires.length) selection = null;
  // Before the graph draws: it lets go of a module that is gone, and a renamed one would count as gone.
  canvas.view.select(selection && 'module' in selection ? selection.module : null, { quiet: true });
  canvas.show(doc);
  props.show(doc, selection);
  toml.show(doc.text, problems);
  below.show(problems);
  welcome.hidden = modules.length > 0 || problems.some(({ line }) => line > 0 && doc?.text.trim() !== '' && modules.length === 0 && !doc?.sections.robot);
  drawTop();
}

function drawTop() {
  if (!doc) return;
  const errors = doc.picture.problems.filter(({ severity }) => severity === 'error').length;
  title.textContent = doc.name;
  title.title = doc.path;
  document.title = `${doc.is_dirty ? '• ' : ''}${doc.name} · compose`;
  const [words, tone] = !editor.isOpen ? ['no connection', 'error'] : doc.is_changed_on_disk ? ['changed on disk', 'warn']
    : errors ? [`${errors} ${errors === 1 ? 'problem' : 'problems'}`, 'error'] : doc.is_dirty ? ['not saved', 'accent'] : doc.is_new ? ['new file', ''] : ['saved', 'ok'];
  state.textContent = words;
  state.className = `chip plain ${tone}`;
  undo.disabled = !doc.can_undo;
  redo.disabled = !doc.can_redo;
  save.disabled = !doc.is_dirty && !doc.is_new && !doc.is_changed_on_disk;
  save.classList.toggle('primary', doc.is_dirty);
  arrange.disabled = Object.keys(doc.layout).length === 0;
  run.disabled = record.disabled = errors > 0 || isRunning || isStarting || doc.picture.modules.length === 0;
  run.hidden = record.hidden = isRunning;
  stop.hidden = !isRunning;
}

/** @param {{ module: string } | { wire: number } | null} selected */
function select(selected) {
  selection = selected;
  if (selected && 'module' in selected) canvas.view.select(selected.module, { quiet: true });
  if (selected && text.hidden === false) { /* the text stays beside the graph */ }
  if (doc) props.show(doc, selection);
}

/** @param {any} error */
function report(error) {
  const note = h('div', { class: 'toast error' }, h('p', null, error instanceof Error ? error.message : String(error)), iconButton('close', 'Close', () => note.remove()));
  byId('toasts').append(note);
  setTimeout(() => note.remove(), 9000);
}

/** @param {string} words */
function tell(words) {
  const note = h('div', { class: 'toast done' }, h('p', null, words), iconButton('close', 'Close', () => note.remove()));
  byId('toasts').append(note);
  setTimeout(() => note.remove(), 4000);
}

// ---- what is done

/**
 * Asks for a change, after those before it; returns what is wrong with it.
 * @param {() => Promise<any>} ask
 * @param {boolean} [isQuiet]
 * @returns {Promise<string | null>}
 */
function change(ask, isQuiet = false) {
  const done = queue.then(ask).then((answer) => { show(answer); return null; }, (error) => {
    if (!isQuiet) { report(error); if (doc) show(doc); }
    return String(error.message ?? error);
  });
  queue = done;
  return done;
}

/** @param {any[]} edits */
function edit(edits) {
  // A module keeps its selection under its new name.
  const renamed = edits.find((one) => one.op === 'rename_module');
  change(async () => {
    const answer = await editor.ask('edit', { edits });
    if (renamed && selection && 'module' in selection && selection.module === renamed.module) selection = { module: renamed.name };
    return answer;
  });
}

/** @param {string} kind */
function add(kind) {
  const before = new Set(doc?.picture.modules.map(({ name }) => name));
  change(() => editor.ask('edit', { edits: [{ op: 'add_module', kind }] })).then((wrong) => {
    const added = doc?.picture.modules.find(({ name }) => !before.has(name));
    if (wrong !== null || !added || !doc) return;
    if (Object.keys(doc.layout).length > 0) {
      const { x, y } = canvas.view.centre();
      doc.layout = { ...canvas.places(), [added.name]: { x: x - 80, y: y - 40 } };
      editor.ask('layout', { modules: doc.layout }).catch(report);
      canvas.show(doc);
    }
    select({ module: added.name });
    canvas.view.reveal(added.name);
    canvas.view.speak(`${added.name} is added`);
  });
}

/** @param {string} module */
function remove(module) {
  if (selection && 'module' in selection && selection.module === module) select(null);
  edit([{ op: 'remove_module', module }]);
}

/** @param {'undo' | 'redo'} which */
function step(which) {
  change(() => editor.ask(which)).then(() => { if (doc) toml.reset(doc.text); });
}

function tidy() {
  if (!doc) return;
  doc.layout = {};
  queue = queue.then(() => editor.ask('layout', { modules: {} })).then(() => editor.ask('document')).then(show).catch(report);
  canvas.show(doc);
  canvas.view.fit();
}

/** @param {boolean} [overwrite] @returns {Promise<boolean>} whether it is saved */
async function store(overwrite = false) {
  try {
    await queue;
    const answer = await editor.ask('save', { overwrite });
    if (answer.conflict) return await settle(answer.conflict.text);
    show(answer);
    tell(`${answer.name} is saved.`);
    return true;
  } catch (error) {
    report(error);
    return false;
  }
}

/** Somebody else has changed the file. @param {string | null} theirs @returns {Promise<boolean>} */
function settle(theirs) {
  return new Promise((resolve) => {
    const dialog = h('dialog', { class: 'conflict', 'aria-labelledby': 'conflict-title' });
    const end = (/** @type {Promise<boolean> | boolean} */ result) => { dialog.close(); dialog.remove(); resolve(result); };
    dialog.append(...[
      h('h2', { id: 'conflict-title' }, theirs === null ? 'The file was deleted' : 'The file was changed by another program'),
      h('p', null, 'Nothing was saved. Take the file as it is on the disk now (yours comes back with Undo), or write yours over it.'),
      theirs === null ? null : h('pre', { class: 'theirs', tabIndex: 0, 'aria-label': 'The file on the disk' }, difference(theirs, doc?.text ?? '')),
      h('div', { class: 'foot' },
        h('button', { type: 'button', class: 'button', onclick: () => end(false) }, 'Cancel'),
        h('span', { class: 'spacer' }),
        theirs === null ? null : h('button', { type: 'button', class: 'button', onclick: () => end(change(() => editor.ask('reload')).then((wrong) => { if (doc) toml.reset(doc.text); return wrong === null; })) }, 'Take the file'),
        h('button', { type: 'button', class: 'button danger', onclick: () => end(store(true)) }, 'Write mine')),
    ].filter((part) => part !== null));
    dialog.addEventListener('cancel', () => end(false));
    document.body.append(dialog);
    dialog.showModal();
  });
}

/** Lines that only one of the two has, by order. @param {string} theirs @param {string} mine */
function difference(theirs, mine) {
  const own = new Set(mine.split('\n'));
  const other = new Set(theirs.split('\n'));
  return [
    ...theirs.split('\n').map((line) => h('span', { class: own.has(line) ? '' : 'added' }, `${own.has(line) ? '  ' : '> '}${line}\n`)),
    ...mine.split('\n').filter((line) => !other.has(line)).map((line) => h('span', { class: 'lost' }, `< ${line}\n`)),
  ];
}

/** @param {boolean} isRecorded */
async function start(isRecorded) {
  if (!doc) return;
  if ((doc.is_dirty || doc.is_new || doc.is_changed_on_disk) && !await store()) return;
  isStarting = true;
  nextLine = 0;
  below.clear();
  below.choose('tab-output');
  drawTop();
  try {
    await editor.ask('run', { record: isRecorded });
  } catch (error) {
    report(error);
  }
  isStarting = false;
  await watch();
}

async function halt() {
  stop.disabled = true;
  try { await editor.ask('stop'); } catch (error) { report(error); }
  stop.disabled = false;
  await watch();
}

/** What the robot prints, and whether it runs. */
async function watch() {
  if (!editor.isOpen) return;
  try {
    /** @type {import('./asks.js').Output} */
    const output = await editor.ask('output', { after: nextLine });
    if (output.next < nextLine) { nextLine = 0; below.clear(); return; }
    nextLine = output.next;
    below.print(output.lines);
    const wasRunning = isRunning;
    isRunning = output.is_running;
    live.hidden = !output.url;
    if (output.url) live.href = output.url;
    if (wasRunning && !isRunning) tell(output.bag ? `The robot has stopped. The bag is ${output.bag}.` : 'The robot has stopped.');
    if (wasRunning !== isRunning) drawTop();
  } catch { /* asked again */ }
}

function drawWelcome() {
  welcome.replaceChildren(h('h2', null, 'Compose a robot'),
    h('p', { class: 'muted' }, 'Begin with a template, or add modules from the list on the left.'),
    h('div', { class: 'templates' }, (profiles?.templates ?? []).filter(({ name }) => name !== 'empty').map((template) => h('button', { type: 'button', class: 'template', onclick: () => edit([{ op: 'template', name: template.name }]) },
      h('b', null, template.title), h('span', null, template.about)))),
    h('p', { class: 'muted small' }, 'Drag from a port to a port to draw a wire. With the keyboard: Tab to a port, Enter, arrows, Enter.'));
}

addEventListener('keydown', (event) => {
  const isCommand = event.ctrlKey || event.metaKey;
  const isInText = event.target instanceof HTMLTextAreaElement || event.target instanceof HTMLInputElement;
  if (isCommand && event.key === 's') { event.preventDefault(); store(); }
  else if (isCommand && !isInText && event.key.toLowerCase() === 'z') { event.preventDefault(); step(event.shiftKey ? 'redo' : 'undo'); }
  else if (isCommand && !isInText && event.key === 'y') { event.preventDefault(); step('redo'); }
  else if (event.key === '/' && !isInText && !isCommand) { event.preventDefault(); kinds.focus(); }
});
addEventListener('beforeunload', (event) => { if (doc?.is_dirty) event.preventDefault(); });

editor.addEventListener('state', async () => {
  drawTop();
  if (!editor.isOpen) return;
  try {
    profiles = await editor.ask('profile');
    kinds.show(/** @type {Profiles} */ (profiles).kinds, /** @type {Profiles} */ (profiles).missing);
    props.know(/** @type {Profiles} */ (profiles));
    drawWelcome();
    show(await editor.ask('document'));
    await watch();
  } catch (error) {
    report(error);
  }
});
setInterval(() => { if (isRunning || isStarting) watch(); }, LOOK_MS);
// Who comes back may have changed files that the robot names.
addEventListener('focus', () => {
  if (editor.isOpen && doc) queue = queue.then(() => editor.ask('document', { refresh: true })).then(show).catch(() => undefined);
});
// Another program, or another page, may have changed it.
setInterval(async () => {
  if (!editor.isOpen || document.hidden || !doc) return;
  try {
    const now = await queue.then(() => editor.ask('document'));
    if (now.revision !== doc.revision) show(now);
    else if (now.is_changed_on_disk !== doc.is_changed_on_disk) { doc.is_changed_on_disk = now.is_changed_on_disk; drawTop(); }
  } catch { /* asked again */ }
}, DISK_MS);
