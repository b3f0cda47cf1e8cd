// @ts-check
// Settings of modules: descriptions, ranges, and changes that are refused at their place.

import { empty, h, replace, setText } from '../panel.js';
import { words } from '../connection.js';

/**
 * @typedef {{ module: string, name: string, description?: string, value: any, type?: string, range?: [number, number], read_only?: boolean }} Setting
 * @typedef {ReturnType<typeof rowOf>} Row
 */

const PERIOD_MS = 1500;

/** @type {import('../panel.js').Panel} */
export default {
  id: 'parameters',
  title: 'Parameters',
  create(root, robot, view) {
    /** @type {{ closed: string[] }} */
    const options = { closed: [], ...view.get() };
    /** @type {Map<string, Row>} */
    const rows = new Map();
    /** @type {Map<string, { element: HTMLDetailsElement, body: HTMLElement, count: HTMLElement }>} */
    const groups = new Map();
    /** @type {Setting[]} */
    let settings = [];
    let hasAsk = true;
    const find = h('input', { type: 'search', placeholder: 'Search', 'aria-label': 'Search in parameters', 'data-testid': 'parameters-search', oninput: () => show() });
    const list = h('div', { class: 'tree scroll', 'data-testid': 'parameters' });
    const locked = h('div', { class: 'notice', hidden: true }, 'Look only: open the link that the program printed to change values.');
    root.append(h('div', { class: 'bar-row' }, find), locked, list);

    /** @param {Setting} setting @param {any} value */
    async function set({ module, name }, value) {
      if (hasAsk) { await robot.ask('set', { module, name, value }); await look(); return; }
      robot.setParameter(`${module}.${name}`, value);
    }

    async function look() {
      if (robot.state !== 'open') return;
      try {
        settings = await robot.ask('settings');
        hasAsk = true;
      } catch (error) {
        hasAsk = false;
        settings = [...robot.parameters.values()].map(({ name, value, type }) => {
          const dot = name.indexOf('.');
          return { module: dot < 0 ? '' : name.slice(0, dot), name: name.slice(dot + 1), value, type };
        });
        if (settings.length === 0) { replace(list, [empty('No parameters here.', words(error))]); return; }
      }
      show();
    }

    function show() {
      locked.hidden = robot.mayChange || Boolean(robot.info?.isBag);
      const text = find.value.trim().toLowerCase();
      const wanted = settings.filter(({ module, name, description }) => !text || `${module}.${name} ${description ?? ''}`.toLowerCase().includes(text));
      wanted.sort((a, b) => a.module.localeCompare(b.module) || a.name.localeCompare(b.name));
      /** @type {Map<string, Setting[]>} */
      const byModule = new Map();
      for (const setting of wanted) byModule.set(setting.module, [...(byModule.get(setting.module) ?? []), setting]);
      view.setTitle(`${settings.length}`);
      const elements = [...byModule].map(([module, members]) => {
        let group = groups.get(module);
        if (!group) {
          const [body, count] = [h('div', { style: { paddingInlineStart: '0' } }), h('span', { class: 'muted number' })];
          const element = h('details', { open: !options.closed.includes(module) }, h('summary', null, h('b', { style: { fontWeight: '600' } }, module), count), body);
          element.addEventListener('toggle', () => {
            if (find.value) return;
            options.closed = [...groups].filter(([, { element: each }]) => !each.open).map(([name]) => name);
            view.set(options);
          });
          group = { element, body, count };
          groups.set(module, group);
        }
        if (text) group.element.open = true;
        setText(group.count, String(members.length));
        replace(group.body, members.map((setting) => {
          const key = `${module}.${setting.name}`;
          let row = rows.get(key);
          if (!row) { row = rowOf(setting, (value) => set(setting, value)); rows.set(key, row); }
          row.show(setting, robot.mayChange);
          return row.element;
        }));
        return group.element;
      });
      replace(list, elements.length > 0 ? elements : [empty(settings.length > 0 ? 'Nothing found.' : 'No parameters here.')]);
    }
    robot.addEventListener('parameters', () => { if (!hasAsk) look(); });
    robot.addEventListener('status', (/** @type {CustomEvent} */ event) => {
      // Without asks a refusal comes as a message that names the parameter.
      const name = /^the parameter (\S+) was not set: /.exec(event.detail.text);
      if (name) rows.get(name[1])?.refuse(event.detail.text.slice(name[0].length));
    });
    robot.every(PERIOD_MS, look);
    return { destroy() {} };
  },
};

/** Which editor a setting has; one whose number is not finite has no value in JSON. @param {Setting} setting */
function kindOf({ value, type = '' }) {
  if (Array.isArray(value) || (/_array$/.test(type) && type !== 'byte_array')) return 'list';
  if (typeof value === 'boolean') return 'bool';
  return typeof value === 'number' || /^(integer|double|float64)$/.test(type) ? 'number' : 'text';
}

/** @param {any} value */
const show = (value) => (value === undefined || value === null ? '' : typeof value === 'string' ? value : JSON.stringify(value));

/** @param {Setting} first @param {(value: any) => Promise<void>} set */
function rowOf(first, set) {
  const id = `setting-${first.module}.${first.name}`;
  const kind = kindOf(first);
  const isWhole = first.type === 'integer';
  const problem = h('p', { class: 'problem', id: `${id}-problem`, role: 'alert', hidden: true });
  const about = h('p', { class: 'about', id: `${id}-about` });
  const input = h('input', kind === 'bool' ? { type: 'checkbox', id } : { type: 'text', id, inputMode: kind === 'number' ? 'decimal' : 'text', spellcheck: false, autocomplete: 'off' });
  input.setAttribute('aria-describedby', `${id}-about ${id}-problem`);
  const slider = kind === 'number' && first.range ? h('input', { type: 'range', 'aria-label': `${first.name}, slider`, min: String(first.range[0]), max: String(first.range[1]), step: isWhole ? '1' : 'any' }) : null;
  const note = h('span', { class: 'muted' });
  const element = h('div', { class: 'setting', 'data-testid': id }, h('label', { for: id }, first.name), about, h('div', { class: 'value' }, input, slider, note), problem);
  /** @type {any} */
  let present;
  let isDirty = false;

  /** @param {string} text */
  function refuse(text) { setText(problem, text); problem.hidden = false; input.setAttribute('aria-invalid', 'true'); }
  function accept() { problem.hidden = true; input.removeAttribute('aria-invalid'); isDirty = false; }

  /** @returns {any} */
  function wanted() {
    if (kind === 'bool') return input.checked;
    if (kind === 'text') return input.value;
    if (kind === 'list') {
      try { const value = JSON.parse(input.value); if (Array.isArray(value)) return value; } catch { /* said below */ }
      throw new Error('expected a list such as [1, 2] or ["a", "b"]');
    }
    const value = Number(input.value.trim().replace(',', '.').replace('−', '-'));
    if (input.value.trim() === '' || !Number.isFinite(value)) throw new Error('expected a number');
    if (isWhole && !Number.isInteger(value)) throw new Error('expected a whole number');
    const { range } = first;
    if (range && (value < range[0] || value > range[1])) throw new Error(`expected ${range[0]} to ${range[1]}`);
    return value;
  }
  async function commit() {
    try {
      const value = wanted();
      if (JSON.stringify(value) === JSON.stringify(present)) { accept(); return; }
      await set(value);
      accept();
    } catch (error) { refuse(words(error)); }
  }
  input.addEventListener('input', () => { isDirty = true; });
  input.addEventListener('change', commit);
  input.addEventListener('keydown', (event) => {
    if (event.key === 'Escape') { accept(); display(); }
  });
  slider?.addEventListener('input', () => { isDirty = true; input.value = isWhole ? slider.value : String(Number(Number(slider.value).toPrecision(4))); });
  slider?.addEventListener('change', commit);

  function display() {
    if (isDirty) return;
    if (kind === 'bool') input.checked = Boolean(present);
    else if (document.activeElement !== input || input.value === '') input.value = show(present);
    if (slider && document.activeElement !== slider) slider.value = String(present);
  }
  return {
    element, refuse,
    /** @param {Setting} setting @param {boolean} mayChange */
    show({ value, description, range, read_only: isReadOnly }, mayChange) {
      present = value;
      setText(about, description ?? '');
      setText(note, [range && !slider ? `${range[0]} to ${range[1]}` : '', isReadOnly ? 'fixed at the start' : ''].filter(Boolean).join(', '));
      input.disabled = Boolean(isReadOnly) || !mayChange;
      if (slider) slider.disabled = input.disabled;
      display();
    },
  };
}
