// @ts-check
// The life cycle of modules, and its transitions.

import { empty, h, replace, setText } from '../panel.js';
import { words } from '../connection.js';

/** What each state allows (design.ros2.org/articles/node_lifecycle.html). @type {Record<string, string[]>} */
const TRANSITIONS = { unconfigured: ['configure', 'shutdown'], inactive: ['activate', 'cleanup', 'shutdown'], active: ['deactivate', 'shutdown'] };
/** @type {Record<string, string>} */
const LOOKS = { active: 'ok', inactive: 'warn', unconfigured: '', paused: 'warn', restarting: 'warn', failed: 'error', finalized: '' };

/** @type {import('../panel.js').Panel} */
export default {
  id: 'lifecycle',
  title: 'Lifecycle',
  create(root, robot, view) {
    /** @type {Map<string, { element: HTMLElement, chip: HTMLElement, actions: HTMLElement, state: string }>} */
    const rows = new Map();
    const body = h('tbody', null);
    const problem = h('div', { class: 'notice error', role: 'alert', hidden: true });
    const table = h('div', { class: 'scroll' }, h('table', { 'data-testid': 'lifecycle' }, h('thead', null, h('tr', null,
      h('th', { scope: 'col' }, 'Module'), h('th', { scope: 'col' }, 'State'), h('th', { scope: 'col' }, h('span', { class: 'sr' }, 'Transitions')))), body));

    /** @param {string} module @param {string} transition */
    async function change(module, transition) {
      if (transition === 'shutdown' && !confirm(`Shut ${module} down? It cannot be started again.`)) return;
      try { await robot.ask('transition', { module, transition }); problem.hidden = true; } catch (error) { setText(problem, `${module}: ${words(error)}`); problem.hidden = false; }
      await look();
    }

    async function look() {
      if (robot.state !== 'open') return;
      try {
        const modules = await robot.ask('lifecycle');
        replace(root, [problem, table]);
        view.setTitle(`${modules.length}`);
        replace(body, modules.map((/** @type {{ module: string, state: string }} */ { module, state }) => {
          let row = rows.get(module);
          if (!row) {
            const [chip, actions] = [h('span', null), h('div', { class: 'row' })];
            row = { element: h('tr', null, h('td', null, module), h('td', null, chip), h('td', null, actions)), chip, actions, state: '' };
            rows.set(module, row);
          }
          if (row.state !== state) {
            row.state = state;
            row.chip.className = `chip ${LOOKS[state] ?? ''}`;
            setText(row.chip, state);
            row.actions.replaceChildren(...(TRANSITIONS[state] ?? []).map((transition) => h('button', {
              type: 'button', class: `button${transition === 'shutdown' ? ' danger' : ''}`, disabled: !robot.mayChange, 'aria-label': `${transition} ${module}`, onclick: () => change(module, transition) }, transition)));
          }
          return row.element;
        }));
      } catch (error) { if (rows.size === 0) replace(root, [empty('No life cycle here.', words(error))]); }
    }
    robot.every(1000, look);
    return { destroy() {} };
  },
};
