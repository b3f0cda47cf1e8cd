// @ts-check
// The kinds of modules that there are, with search.

import { h, icon } from '../panel.js';

/** @typedef {import('./asks.js').Profile} Profile */

/** @param {Profile} kind */
const hints = (kind) => [kind.uses_device && !kind.is_emulated ? 'device' : '', kind.is_emulated ? 'emulated' : '', kind.runs === 'detached' ? 'own thread' : ''].filter(Boolean).join(', ');

/** @param {Profile} kind @param {string} text */
const matches = (kind, text) => [kind.kind, kind.about, ...kind.ports.flatMap((port) => [port.name, port.type])].join(' ').toLowerCase().includes(text);

/**
 * @param {HTMLElement} root
 * @param {(kind: Profile) => void} add
 */
export function palette(root, add) {
  /** @type {Profile[]} */
  let kinds = [];
  /** @type {import('./asks.js').Missing[]} */
  let missing = [];
  const list = h('ul', { class: 'kinds' });
  const count = h('p', { class: 'sr', role: 'status' });
  const search = h('input', { type: 'search', placeholder: 'Search', 'aria-label': 'Search kinds', oninput: draw });
  search.addEventListener('keydown', (event) => {
    if (event.key === 'Enter' || event.key === 'ArrowDown') {
      /** @type {HTMLElement | null} */ (list.querySelector('button'))?.focus();
      event.preventDefault();
    }
  });
  list.addEventListener('keydown', (event) => {
    const step = event.key === 'ArrowDown' ? 1 : event.key === 'ArrowUp' ? -1 : 0;
    if (step === 0) return;
    const buttons = [...list.querySelectorAll('button')];
    const next = buttons.indexOf(/** @type {any} */ (document.activeElement)) + step;
    if (next < 0) search.focus();
    else buttons[next]?.focus();
    event.preventDefault();
  });
  root.append(h('h2', null, 'Add a module'), h('div', { class: 'searchbox' }, icon('search'), search), count, list);

  function draw() {
    const text = search.value.trim().toLowerCase();
    const found = kinds.filter((kind) => text === '' || matches(kind, text));
    // A hit in the name comes before one in the text.
    if (text) found.sort((a, b) => Number(b.kind.includes(text)) - Number(a.kind.includes(text)));
    count.textContent = `${found.length} kinds`;
    list.replaceChildren(...found.map((kind) => h('li', null,
      h('button', { type: 'button', class: 'kind', onclick: () => add(kind), title: `Add ${kind.kind}` },
        h('b', null, kind.kind), hints(kind) ? h('small', { class: 'hint' }, hints(kind)) : null, h('span', null, kind.about)))));
    const lacking = missing.filter((kind) => text === '' || kind.kind.includes(text));
    list.append(...lacking.map((kind) => h('li', { class: 'missing muted' }, h('b', null, kind.kind), h('span', null, kind.reason))));
    if (found.length + lacking.length === 0) list.append(h('li', { class: 'muted' }, 'No kind has this in its name, text, topics or types.'));
  }

  return {
    /** @param {Profile[]} found @param {import('./asks.js').Missing[]} lacking */
    show(found, lacking) { kinds = found; missing = lacking; draw(); },
    focus() { search.focus(); search.select(); },
  };
}
