// @ts-check
// What the selected thing is, as forms: a module, a wire, or the robot.

import { h, icon, iconButton } from '../panel.js';
import { isSource, shortType } from './canvas.js';
import { field, words } from './fields.js';

/** @typedef {import('./asks.js').Doc} Doc */
/** @typedef {import('./asks.js').Module} Module */
/** @typedef {import('./asks.js').ShownPort} ShownPort */
/** @typedef {import('./asks.js').Profiles} Profiles */
/** @typedef {import('./asks.js').Problem} Problem */
/** @typedef {{ edit: (edits: any[]) => void, remove: (module: string) => void, select: (selection: any) => void, goTo: (line: number) => void }} Actions */

/**
 * Keys of `[[module]]` that every kind has.
 * @type {{ key: string, label: string, about: string, type: string, choices?: string[], fallback?: string }[]}
 */
const OPTIONS = [
  { key: 'synchrony', label: 'Runs', about: 'in cycles with work, in every cycle, or on its own thread', type: 'text', choices: ['when_due', 'every_cycle', 'detached'] },
  { key: 'priority', label: 'Priority', about: 'of its own thread, 1 to 99 (SCHED_FIFO)', type: 'integer' },
  { key: 'cpus', label: 'CPUs', about: 'of its own thread, from 0', type: 'integers' },
  { key: 'inbox', label: 'Inbox', about: 'batches that wait per topic if it is detached', type: 'integer' },
  { key: 'initial_state', label: 'Starts as', about: 'the lifecycle state after the start', type: 'text', choices: ['active', 'inactive', 'unconfigured'], fallback: 'active' },
  { key: 'restart', label: 'Restart', about: 'after a panic: never, always, or in the text how many times', type: 'text', choices: ['never', 'always'], fallback: 'never' },
  { key: 'deadline', label: 'Deadline', about: 'how long a run may take, such as 20ms', type: 'text' },
];

/** Longer names do not fit beside their field. */
const LONG_NAME = 16;
/** Keys of other kinds that are booleans. */
const FLAGS = new Set(['reload', 'isolate']);

const VERBS = /** @type {Record<string, string>} */ ({ publishes: 'Publishes', subscribes: 'Subscribes to', serves: 'Serves', calls: 'Calls' });

let lastId = 0;
const newId = () => `f${lastId += 1}`;

/**
 * A row of a form.
 * @param {{ label: string, about?: string, type: string, value: any, fallback?: any, range?: [number, number], choices?: string[],
 *   name: string, problem?: string, isRequired?: boolean }} row
 * @param {(value: any) => void} change
 */
function row({ label, about, problem, isRequired, name, ...rest }, change) {
  const id = newId();
  const isGiven = rest.value !== undefined && rest.value !== null;
  const notes = [about, rest.range ? `${rest.range[0]} to ${rest.range[1]}` : ''].filter(Boolean).join('; ');
  const control = field({ id, label, describedBy: `${id}-about`, ...rest }, change);
  control.dataset.key = name;
  if (problem) control.setAttribute('aria-invalid', 'true');
  return h('div', { class: `row${isGiven ? ' given' : ''}${isRequired && !isGiven ? ' required' : ''}` },
    h('label', { for: id, title: label, class: label.length + (isRequired ? ' required'.length : 0) > LONG_NAME ? 'long' : '' }, label, isRequired ? h('span', { class: 'needed' }, ' required') : null),
    isGiven && !isRequired ? iconButton('close', `Back to the default of ${label}`, () => change(null), { class: 'icon-button reset' }) : null,
    control,
    h('p', { class: 'about', id: `${id}-about` }, notes),
    problem ? h('p', { class: 'problem', role: 'alert' }, problem) : null);
}

/** @param {string} title @param {boolean} isOpen @param {string} id @param {...(Node | null)} children */
function group(title, isOpen, id, ...children) {
  const details = h('details', { class: 'section', open: remembered.get(id) ?? isOpen, ontoggle: () => remembered.set(id, details.open) },
    h('summary', null, title), ...children);
  return details;
}
/** Which groups are open. @type {Map<string, boolean>} */
const remembered = new Map();

/** @param {boolean} checked @param {string} label @param {string} hint @param {(on: boolean) => void} change */
function tick(checked, label, hint, change) {
  const box = h('input', { type: 'checkbox', checked, onchange: () => change(box.checked) });
  return h('label', { class: 'tick', title: hint }, box, label);
}

/** @param {HTMLElement} root @param {Actions} actions */
export function inspector(root, actions) {
  /** @type {Doc | null} */
  let doc = null;
  /** @type {Profiles | null} */
  let profiles = null;
  /** @type {{ module: string } | { wire: number } | null} */
  let selection = null;

  // An answer may redraw the form while somebody types: what is typed and marked goes over to the new field.
  /** @typedef {HTMLInputElement | HTMLTextAreaElement} Typed */
  /** @type {{ field: Typed, value: string } | null} */
  let begun = null;
  /** A field with text that its browser does not count as typed. @type {Typed | null} */
  let carried = null;
  const typed = (/** @type {EventTarget | null} */ target) =>
    target instanceof HTMLTextAreaElement || (target instanceof HTMLInputElement && target.type === 'text') ? target : null;
  const commit = () => { const field = carried; carried = null; field?.dispatchEvent(new Event('change')); };
  root.addEventListener('focusin', ({ target }) => { const field = typed(target); begun = field && { field, value: field.value }; });
  root.addEventListener('change', () => { carried = null; if (begun) begun.value = begun.field.value; }, true);
  root.addEventListener('focusout', ({ target }) => { if (carried !== null && target === carried && carried.isConnected) commit(); });
  root.addEventListener('keydown', ({ key, target }) => { if (key === 'Enter' && carried !== null && target === carried && carried instanceof HTMLInputElement) commit(); });

  function draw() {
    if (!doc || !profiles) return;
    const focused = /** @type {HTMLElement | null} */ (document.activeElement);
    const key = root.contains(focused) ? focused?.dataset.key : undefined;
    const text = begun && begun.field === focused && begun.field.value !== begun.value ? begun.field.value : null;
    const { selectionStart = null, selectionEnd = null } = typed(focused) ?? {};
    carried = null;
    const top = root.scrollTop;
    const module = selection && 'module' in selection ? doc.picture.modules.find(({ name }) => name === /** @type {any} */ (selection).module) : undefined;
    const wire = selection && 'wire' in selection ? doc.picture.wires[selection.wire] : undefined;
    const owner = JSON.stringify(module ? module.name : wire ? wire.topic : null);
    const isSame = owner === shown;
    shown = owner;
    root.replaceChildren(...(module ? ofModule(doc, module) : wire ? ofWire(doc, wire) : ofRobot(doc, profiles)));
    root.scrollTop = top;
    if (!key || !isSame) return;
    const again = /** @type {HTMLElement | null} */ (root.querySelector(`[data-key="${CSS.escape(key)}"]`));
    again?.focus({ preventScroll: true });
    const field = typed(again);
    if (!field) return;
    if (text !== null) {
      field.value = text;
      carried = field;
    }
    field.setSelectionRange(selectionStart, selectionEnd);
  }
  /** Whose form is shown. */
  let shown = '';

  /** @param {Doc} doc @param {Module} module */
  function ofModule(doc, module) {
    const { name, kind, given, profile } = module;
    const problems = doc.picture.problems.filter((problem) => problem.module === name);
    const of = (/** @type {string} */ key) => problems.find((problem) => problem.key === key)?.problem;
    const index = doc.picture.modules.indexOf(module);
    const shown = new Set((profile?.settings ?? []).map((setting) => `settings.${setting.name}`));
    const others = problems.filter((problem) => !problem.key || !shown.has(problem.key));
    const nameField = h('input', { type: 'text', value: name, 'aria-label': 'Name of the module', spellcheck: false, autocomplete: 'off', class: 'name', dataset: { key: 'name' },
      onchange: () => { if (nameField.value !== name) { if (nameField.value) actions.edit([{ op: 'rename_module', module: name, name: nameField.value }]); else nameField.value = name; } } });
    const unknown = Object.entries(given.settings ?? {}).filter(([setting]) => profile && !profile.settings.some((known) => known.name === setting));
    const settings = [...(profile?.settings ?? [])].sort((a, b) => Number(b.is_required) - Number(a.is_required));
    const keys = (profile?.keys ?? []).map((key) => row({
      label: key.name, name: key.name, type: FLAGS.has(key.name) ? 'bool' : 'text', value: given[key.name], isRequired: key.is_required, problem: of(key.name),
      about: key.name === 'path' ? 'the shared library, relative to the robot file' : key.name === 'module' ? 'file and class, such as level_head.py:LevelHead' : key.name === 'reload' ? 'a changed file takes over while the robot runs' : key.name === 'isolate' ? 'in a process of its own' : '',
    }, (value) => actions.edit([{ op: 'set_key', module: name, key: key.name, value }])));
    return [
      h('header', { class: 'head' },
        nameField,
        h('div', { class: 'chips' }, h('span', { class: 'chip plain accent' }, kind),
          profile?.is_emulated ? h('span', { class: 'chip plain warn' }, 'emulated') : null,
          profile?.uses_device && !profile.is_emulated ? h('span', { class: 'chip plain' }, 'device') : null,
          profile?.periods_s.map((period) => h('span', { class: 'chip plain' }, `every ${period} s`))),
        h('p', { class: 'muted' }, profile?.about ?? 'This program has no such kind of module.'),
        others.map((problem) => h('p', { class: `notice ${problem.severity}` }, problem.problem))),
      keys.length ? group('Source', true, `source ${kind}`, ...keys) : null,
      settings.length || unknown.length ? group(`Settings`, true, `settings ${kind}`,
        ...settings.map((setting) => row({
          label: setting.name, about: setting.description + (setting.is_file ? ' (a file)' : ''), type: setting.type, value: given.settings?.[setting.name], fallback: setting.default,
          range: setting.range, choices: setting.choices, name: `settings.${setting.name}`, problem: of(`settings.${setting.name}`), isRequired: setting.is_required,
        }, (value) => actions.edit([{ op: 'set_setting', module: name, setting: setting.name, value, is_double: setting.type.startsWith('double') }]))),
        ...unknown.map(([setting, value]) => h('div', { class: 'row given' }, h('label', { title: setting, class: setting.length > LONG_NAME ? 'long' : '' }, setting),
          iconButton('close', `Remove ${setting}`, () => actions.edit([{ op: 'set_setting', module: name, setting, value: null }]), { class: 'icon-button reset' }),
          h('code', null, words(value)), h('p', { class: 'problem' }, 'The kind has no such setting.')))) : null,
      module.ports.length ? group('Ports', true, 'ports', ...module.ports.map((port) => ofPort(doc, module, port))) : null,
      group('How it runs', false, 'options', ...OPTIONS.map((option) => row({
        label: option.label, about: option.about, type: option.type, value: given[option.key], fallback: option.key === 'synchrony' ? profile?.runs : option.fallback,
        choices: option.choices, name: option.key, problem: of(option.key),
      }, (value) => actions.edit([{ op: 'set_key', module: name, key: option.key, value }])))),
      h('footer', { class: 'foot' },
        h('button', { type: 'button', class: 'button', disabled: index === 0, onclick: () => actions.edit([{ op: 'move_module', module: name, to: index - 1 }]), title: 'Modules start in the order of the file' }, 'Earlier'),
        h('button', { type: 'button', class: 'button', disabled: index === doc.picture.modules.length - 1, onclick: () => actions.edit([{ op: 'move_module', module: name, to: index + 1 }]) }, 'Later'),
        h('button', { type: 'button', class: 'button', onclick: () => actions.goTo(module.line) }, 'In the text'),
        h('span', { class: 'spacer' }),
        h('button', { type: 'button', class: 'button danger', onclick: () => actions.remove(name) }, icon('trash'), 'Remove')),
    ].filter((part) => part !== null);
  }

  /** @param {Doc} doc @param {Module} module @param {ShownPort} port */
  function ofPort(doc, module, port) {
    const isOut = isSource(port);
    const topic = doc.picture.topics.find((known) => known.is === port.is && known.name === port.topic);
    const partners = doc.picture.wires.filter((wire) => wire.is === port.is && (isOut ? wire.from : wire.to).module === module.name && (isOut ? wire.from : wire.to).port === port.name)
      .map((wire) => isOut ? wire.to : wire.from);
    const fitting = doc.picture.modules.flatMap((other) => other.ports
      .filter((known) => known.is === port.is && known.type === port.type && isSource(known) !== isOut)
      .map((known) => ({ module: other.name, port: known.name, topic: known.topic })));
    const id = newId();
    const connected = (/** @type {{ module: string, port: string }} */ other) => partners.some((partner) => partner.module === other.module && partner.port === other.port);
    const free = fitting.filter((other) => !connected(other));
    const choose = h('select', { id, 'aria-label': `Connect ${port.name} ${isOut ? 'to' : 'from'}`, dataset: { key: `wire ${port.is} ${port.name}` }, onchange: () => {
      const other = free[Number(choose.value)];
      if (!other) return;
      const [from, to] = isOut ? [{ module: module.name, port: port.name }, { module: other.module, port: other.port }] : [{ module: other.module, port: other.port }, { module: module.name, port: port.name }];
      actions.edit([{ op: 'connect', from, to }]);
    } }, h('option', { value: '' }, free.length ? (isOut ? 'connect to…' : 'connect from…') : 'nothing else fits'),
      free.map((other, index) => h('option', { value: String(index) }, `${other.module} · ${other.port}`)));
    choose.disabled = free.length === 0;
    const topicId = newId();
    const name = h('input', { type: 'text', id: topicId, value: port.topic === port.name ? '' : port.topic, placeholder: port.name, spellcheck: false, autocomplete: 'off',
      'aria-label': `Name of ${port.name} in the robot`, dataset: { key: `remap.${port.is}.${port.name}` },
      onchange: () => actions.edit([{ op: 'set_topic', module: module.name, port: port.name, topic: name.value.trim() || null }]) });
    return h('div', { class: `port ${isOut ? 'out' : 'in'}` },
      h('div', { class: 'port-head' }, h('span', { class: 'muted' }, VERBS[port.does], port.is === 'topic' ? '' : ` ${port.is}`), ' ', h('b', { class: 'mono' }, port.name)),
      h('p', { class: 'type mono', title: port.type }, port.type.includes('::') ? shortType(port.type) : port.type),
      h('div', { class: 'port-row' }, h('label', { for: topicId, class: 'muted' }, port.is), name),
      partners.length ? h('ul', { class: 'partners' }, partners.map((partner) => h('li', null,
        h('button', { type: 'button', class: 'link', onclick: () => actions.select({ module: partner.module }) }, `${isOut ? '→' : '←'} ${partner.module} · ${partner.port}`),
        iconButton('close', `Cut the wire to ${partner.module}`, () => actions.edit([{ op: 'disconnect', to: isOut ? { module: partner.module, port: partner.port } : { module: module.name, port: port.name } }]), { class: 'icon-button small' })))) : null,
      choose,
      topic ? ticks(topic) : null);
  }

  /** @param {import('./asks.js').Topic} topic */
  function ticks(topic) {
    const way = { out: 'ROS 2 receives it', in: 'ROS 2 sends it', services: 'ROS 2 may call it', calls: 'a server in ROS 2 answers', actions: 'ROS 2 may use it', action_calls: 'a server in ROS 2 executes it' }[topic.list] ?? '';
    return h('div', { class: 'ticks' },
      tick(topic.is_exposed, 'ROS 2', `${way}${topic.by_pattern ? `, by the pattern ${topic.by_pattern}` : ''}`,
        (on) => actions.edit([{ op: 'expose', list: topic.list, name: topic.name, on, ...(topic.list === 'calls' || topic.list === 'action_calls' ? { type: topic.type } : {}) }])),
      topic.is === 'topic' ? tick(topic.is_recorded, 'Record', 'A recording has its messages', (on) => actions.edit([{ op: 'record', topic: topic.name, on }])) : null);
  }

  /** @param {Doc} doc @param {import('./asks.js').Wire} wire */
  function ofWire(doc, wire) {
    const topic = doc.picture.topics.find((known) => known.is === wire.is && known.name === wire.topic);
    return [
      h('header', { class: 'head' }, h('h2', { class: 'mono' }, wire.topic), h('p', { class: 'muted' }, topic?.type ?? ''),
        wire.is_sound ? null : h('p', { class: 'notice error' }, 'The two ends have different types.')),
      h('div', { class: 'sheet' },
        h('p', null, 'from ', h('button', { type: 'button', class: 'link', onclick: () => actions.select({ module: wire.from.module }) }, `${wire.from.module} · ${wire.from.port}`)),
        h('p', null, 'to ', h('button', { type: 'button', class: 'link', onclick: () => actions.select({ module: wire.to.module }) }, `${wire.to.module} · ${wire.to.port}`)),
        topic ? ticks(topic) : null,
        h('button', { type: 'button', class: 'button danger', onclick: () => actions.edit([{ op: 'disconnect', to: wire.to }]) }, icon('trash'), 'Cut the wire')),
    ];
  }

  /** @param {Doc} doc @param {Profiles} profiles */
  function ofRobot(doc, profiles) {
    const { robot, launcher, record, expose, view } = doc.sections;
    const set = (/** @type {string[]} */ path) => (/** @type {any} */ value) => actions.edit([{ op: 'set', path, value }]);
    const short = robot?.launcher;
    const setLauncher = (/** @type {any} */ value) => actions.edit([
      ...(short === undefined ? [] : [{ op: 'set', path: ['robot', 'launcher'], value: null }]), { op: 'set', path: ['launcher', 'kind'], value }]);
    const topics = doc.picture.topics;
    return [
      h('header', { class: 'head' }, h('h2', null, 'Robot'), h('p', { class: 'muted' }, 'Select a module or a wire to see its properties.')),
      group('Robot', true, 'robot',
        row({ label: 'Name', about: 'also of its ROS 2 node', type: 'text', value: robot?.name, name: 'robot.name', isRequired: true }, (value) => { if (value) set(['robot', 'name'])(value); else draw(); }),
        row({ label: 'Namespace', about: 'of its ROS 2 node', type: 'text', value: robot?.namespace, fallback: '/', name: 'robot.namespace' }, set(['robot', 'namespace'])),
        row({ label: 'Launcher', about: 'how the modules of a cycle share threads', type: 'text', choices: profiles.launchers, value: launcher?.kind ?? short, fallback: 'linear', name: 'launcher.kind' }, setLauncher),
        (launcher?.kind ?? short) === 'pool' ? row({ label: 'Threads', about: 'of the pool', type: 'integer', value: launcher?.threads ?? robot?.threads, name: 'launcher.threads' }, set([launcher ? 'launcher' : 'robot', 'threads'])) : null),
      group(`Topics, services, actions`, true, 'topics', topics.length
        ? h('table', { class: 'topics' }, h('thead', null, h('tr', null, h('th', { scope: 'col' }, 'Name'), h('th', { scope: 'col', title: 'Exposed to ROS 2' }, 'ROS 2'), h('th', { scope: 'col' }, 'Record'))),
          h('tbody', null, topics.map((topic) => h('tr', null,
            h('td', { title: topic.type }, h('span', { class: 'mono' }, topic.name), h('small', { class: 'muted' }, `${topic.is === 'topic' ? '' : `${topic.is} · `}${shortType(topic.type)}${topic.has_source ? '' : ' · from outside'}`)),
            h('td', null, bare(topic.is_exposed, `Expose ${topic.name} to ROS 2`, (on) => actions.edit([{ op: 'expose', list: topic.list, name: topic.name, on, ...(topic.list === 'calls' || topic.list === 'action_calls' ? { type: topic.type } : {}) }]))),
            h('td', null, topic.is === 'topic' ? bare(topic.is_recorded, `Record ${topic.name}`, (on) => actions.edit([{ op: 'record', topic: topic.name, on }])) : null)))))
        : h('p', { class: 'muted pad' }, 'Modules bring them.')),
      group('Recording', false, 'record',
        row({ label: 'Compression', about: 'of chunks', type: 'text', choices: ['none', 'lz4', 'zstd'], value: record?.compression, name: 'record.compression' }, set(['record', 'compression'])),
        row({ label: 'Longest file', about: 'the bag goes on in a new file, such as 5m', type: 'text', value: record?.max_bag_duration, name: 'record.max_bag_duration' }, set(['record', 'max_bag_duration'])),
        row({ label: 'Snapshot', about: 'only the last time on request, such as 10s', type: 'text', value: record?.snapshot, name: 'record.snapshot' }, set(['record', 'snapshot']))),
      group('ROS 2', false, 'ros',
        row({ label: 'Parameters', about: 'settings that are parameters: module.setting, or *', type: 'texts', value: expose?.parameters, name: 'expose.parameters' }, set(['expose', 'parameters'])),
        row({ label: 'Clock', about: 'publish the time of the robot, or follow /clock', type: 'text', choices: ['publish', 'follow'], value: typeof expose?.clock === 'string' ? expose.clock : undefined, name: 'expose.clock' }, set(['expose', 'clock'])),
        row({ label: 'Log', about: 'whether the log goes to /rosout', type: 'bool', value: expose?.rosout, fallback: true, name: 'expose.rosout' }, set(['expose', 'rosout'])),
        row({ label: 'Diagnostics', about: 'whether the process reports on its modules', type: 'bool', value: expose?.diagnostics, fallback: true, name: 'expose.diagnostics' }, set(['expose', 'diagnostics']))),
      view ? null : null,
    ].filter((part) => part !== null);
  }

  /** @param {boolean} checked @param {string} label @param {(on: boolean) => void} change */
  function bare(checked, label, change) {
    const box = h('input', { type: 'checkbox', checked, 'aria-label': label, dataset: { key: label }, onchange: () => change(box.checked) });
    return box;
  }

  return {
    /** @param {Profiles} found */
    know(found) { profiles = found; draw(); },
    /** @param {Doc} shown @param {{ module: string } | { wire: number } | null} selected */
    show(shown, selected) {
      if (JSON.stringify(selected) !== JSON.stringify(selection)) root.scrollTop = 0;
      doc = shown;
      selection = selected;
      draw();
    },
    /** Gives a field the focus. @param {string} key */
    focus(key) {
      const control = /** @type {HTMLElement | null} */ (root.querySelector(`[data-key="${CSS.escape(key)}"]`));
      const details = control?.closest('details');
      if (details) details.open = true;
      control?.focus();
      control?.scrollIntoView({ block: 'center' });
      return control !== null;
    },
  };
}
