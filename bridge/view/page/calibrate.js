// @ts-check
// The calibration of servos, step by step, while the joints are turned by hand: `downbeat servo calibrate --page`; and the search for offsets, `downbeat servo tune --page`.

import { Editor } from './compose/asks.js';
import { words } from './connection.js';
import { h, replace, setText } from './panel.js';

/**
 * @typedef {{ name: string, id: number, travel: number, place: number, isSilent: boolean }} Joint  `travel`: so far, in degrees; `place`: between
 *   its extremes, from 0 to 1
 * @typedef {{ done: string, lines: string[], question: string, number: number, answers: { answer: string, is: string }[], joints: Joint[], isOver: boolean,
 *   error: string | null }} Shown
 */

const PERIOD_MS = 100;
const program = new Editor();
const question = h('h1', { role: 'status', 'data-testid': 'calibrate-question', style: { fontSize: '1.3rem' } });
const answers = h('div', { style: { display: 'flex', flexWrap: 'wrap', gap: '0.5rem', minHeight: '2.4rem' } });
const problem = h('output', { role: 'status', class: 'notice error', hidden: true, 'data-testid': 'calibrate-problem' });
const joints = h('tbody');
const table = h('table', { 'data-testid': 'calibrate-joints', hidden: true },
  h('thead', null, h('tr', null, ['Joint', 'ID', 'Between its extremes', 'Turned'].map((title) => h('th', { scope: 'col' }, title)))), joints);
const lines = h('ol', { 'aria-label': 'What was found', 'data-testid': 'calibrate-lines', class: 'mono', style: { listStyle: 'none', padding: '0', whiteSpace: 'pre-wrap' } });
const main = /** @type {HTMLElement} */ (document.getElementById('main'));
main.append(h('div', { style: { maxWidth: '46rem', margin: '2rem auto', padding: '0 1rem', display: 'grid', gap: '1rem' } }, question, answers, problem, table, lines));

/** @param {unknown} error */
function fail(error) {
  setText(problem, words(error));
  problem.hidden = false;
}

let asked = -1;
/** @param {Shown} shown */
function show(shown) {
  if (shown.isOver) setText(question, shown.error ? 'It has ended' : shown.done);
  else setText(question, `${shown.question}.`);
  if (shown.error) fail(shown.error);
  const number = shown.isOver ? Infinity : shown.number;
  if (number !== asked) {
    asked = number;
    replace(answers, shown.isOver ? [] : shown.answers.map(({ answer, is }, index) => h('button', {
      type: 'button', class: index === 0 ? 'button primary' : 'button', 'data-testid': `calibrate-${answer || 'done'}`,
      onclick: () => program.ask('answer', { answer, number }).catch(fail),
    }, is[0].toUpperCase() + is.slice(1))));
  }
  table.hidden = shown.joints.length === 0;
  replace(joints, shown.joints.map(({ name, id, travel, place, isSilent }) => {
    const mark = h('i', { style: { left: `${place * 100}%` } });
    return h('tr', { class: isSilent ? 'error' : '' }, h('td', null, name), h('td', { class: 'number' }, String(id)),
      h('td', { style: { minWidth: '12rem' } }, h('div', { class: 'position-meter' }, mark)),
      h('td', { class: 'number' }, isSilent ? 'does not answer' : `${travel.toFixed(1)}°`));
  }));
  replace(lines, shown.lines.map((line) => h('li', null, line)));
}

let isOver = false;
async function look() {
  try {
    const shown = await program.ask('calibration');
    isOver = shown.isOver;
    show(shown);
  } catch (error) {
    if (program.isOpen) fail(error);
  }
  if (!isOver) setTimeout(look, PERIOD_MS);
}
program.addEventListener('state', () => { if (!program.isOpen && !isOver) fail('There is no connection: is the program still running?'); else if (!isOver) problem.hidden = true; });
look();
