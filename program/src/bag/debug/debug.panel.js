// @ts-check
// A replay that stands at a cycle: what ran in it and why, and ways on and back.

import { empty, h, replace, setText } from '/panel.js';
import { words } from '/connection.js';

/**
 * @typedef {{ topic: string, first: number, count: number }} Messages
 * @typedef {{ module: string, causes: string[], step: number | null, received: Messages[], published: Messages[], got: { event: string }[], gave: string[] }} Run
 * @typedef {{ position: number, cycle: number, time_ns: number, runs: Run[], given: Messages[], events: string[], difference: string | null }} Cycle
 * @typedef {{ messages?: Messages, call?: { event: string, from: string }, time_ns: number, cycle: number, run: { module: string, causes: string[], got: string[] } | null, because: Why[],
 *   known: [Messages, number][], rest: string | null }} Why
 */

/** @param {Messages} messages */
const name = ({ topic, first, count }) => (count === 1 ? `${topic} #${first}` : `${topic} #${first} to #${first + count - 1}`);

/** @param {number} ns */
const milliseconds = (ns) => `${(ns / 1e6).toFixed(3)} ms`;

export default {
  /** @param {HTMLElement} root @param {any} robot */
  create(root, robot) {
    const where = h('b', { role: 'status', 'data-testid': 'debug-where' });
    const problem = h('div', { class: 'notice error', role: 'alert', hidden: true });
    const note = h('p', { class: 'muted' });
    const runs = h('div', { 'data-testid': 'debug-runs' });
    const details = h('div', { 'data-testid': 'debug-details' });
    const line = h('input', { type: 'text', class: 'mono', placeholder: "go 5s, until robot_state.data == 'falling', next gait", 'aria-label': 'Command of the debugger' });
    line.addEventListener('keydown', ({ key }) => { if (key === 'Enter' && line.value.trim()) obey(line.value); });
    /** @param {string} text @param {string} command @param {string} [title] */
    const button = (text, command, title) =>
      h('button', { type: 'button', class: 'button', title: title ?? command, 'data-command': command, onclick: () => obey(command) }, text);
    const names = h('select', { 'aria-label': 'Module or topic', 'data-testid': 'debug-name', onchange: () => list(names.value) });
    const tools = h('div', { class: 'row' }, button('First', 'go start'), button('Back', 'back'), button('Step', 'step'), button('Last', 'go end'),
      names, h('button', { type: 'button', class: 'button', 'data-testid': 'debug-last', onclick: () => obey(`last ${names.value}`) }, 'Last of it'),
      h('button', { type: 'button', class: 'button', 'data-testid': 'debug-next', onclick: () => obey(`next ${names.value}`) }, 'Next of it'));
    const difference = h('div', { class: 'row' });
    const sheet = h('div', { class: 'sheet', 'data-testid': 'debug' }, h('div', { class: 'row' }, where), tools, h('div', { class: 'row' }, line), problem, difference, runs, details, note);
    let startNs = 0;
    let isBusy = false;

    /** Carries out a command, and shows what it answers. @param {string} command */
    async function obey(command) {
      if (isBusy) return;
      isBusy = true;
      sheet.setAttribute('aria-busy', 'true');
      try {
        const answer = await robot.ask('debug_command', { line: command });
        problem.hidden = true;
        if (answer.cycle) show(answer.cycle);
        if (answer.message) showMessage(answer.message);
        if (answer.module) showModule(answer.module);
        if (answer.why) replace(details, [h('h3', null, 'Why?'), h('ul', { 'data-testid': 'debug-why' }, chain(answer.why, null))]);
      } catch (error) {
        setText(problem, words(error));
        problem.hidden = false;
      }
      isBusy = false;
      sheet.removeAttribute('aria-busy');
    }

    /** @param {number} ns */
    const seconds = (ns) => `${((ns - startNs) / 1e9).toFixed(6)} s`;

    /** A message, and the buttons that belong to it. @param {Messages} messages */
    function chip(messages) {
      const last = messages.first + messages.count - 1;
      return h('span', { class: 'row' }, h('button', { type: 'button', class: 'chip mono', title: 'Show it', onclick: () => see(messages.topic, last) }, name(messages)),
        h('button', { type: 'button', class: 'chip', title: 'What led to it', 'data-why': `${messages.topic}#${last}`, onclick: () => obey(`why ${messages.topic}#${last}`) }, 'why?'));
    }

    /** Goes to a message and shows it. @param {string} topic @param {number} number */
    async function see(topic, number) {
      await obey(`go ${topic}#${number}`);
      await obey(`print ${topic}`);
    }

    /** @param {Cycle} cycle */
    function show(cycle) {
      setText(where, `Cycle #${cycle.cycle}, ${seconds(cycle.time_ns)} into the bag`);
      const event = (/** @type {string} */ text) => h('div', { class: 'mono', 'data-testid': 'debug-event' }, text);
      const row = (/** @type {Run} */ run) => h('tr', { 'data-module': run.module },
        h('td', null, h('button', { type: 'button', class: 'chip', title: 'Settings and state', onclick: () => obey(`module ${run.module}`) }, run.module)),
        h('td', null, [...run.causes, ...(run.received.length ? ['messages'] : [])].join(', ') + (run.step === null ? '' : ` (run ${run.step})`)),
        h('td', null, run.received.map(chip), run.got.map((got) => event(got.event))), h('td', null, run.published.map(chip), run.gave.map(event)));
      const rows = cycle.runs.map(row);
      if (cycle.given.length) rows.unshift(h('tr', null, h('td', { class: 'muted' }, 'from the bag'), h('td', null), h('td', null), h('td', null, cycle.given.map(chip))));
      replace(runs, [rows.length ? h('table', null, h('thead', null, h('tr', null, ['module', 'ran for', 'received', 'published'].map((title) => h('th', null, title)))), h('tbody', null, rows)) : empty('No module ran in this cycle.'),
        cycle.events.length ? h('ul', { class: 'mono', 'data-testid': 'debug-events' }, cycle.events.map((event) => h('li', null, event))) : null].filter((each) => each !== null));
      if (robot.playback) robot.control({ play: false, seekNs: BigInt(Math.round(cycle.time_ns)) });
    }

    /** @param {{ topic: string, number: number, type_name: string, yaml: string }} message */
    function showMessage(message) {
      replace(details, [h('h3', null, `${message.topic} #${message.number}, ${message.type_name}`), h('pre', { class: 'mono' }, message.yaml)]);
    }

    /** @param {{ name: string, settings: [string, string][], state: string | null }} module */
    function showModule(module) {
      const settings = module.settings.map(([setting, value]) => `${setting}: ${value}`).join('\n');
      replace(details, [h('h3', null, module.name), h('pre', { class: 'mono', 'data-testid': 'debug-settings' }, settings),
        module.state ? h('pre', { class: 'mono', 'data-testid': 'debug-state' }, module.state) : empty('It shows nothing of itself.', 'The function debug of the trait Module does, variables in C and C++.')]);
    }

    /** @param {Why} why @param {number | null} effectNs @returns {HTMLElement} */
    function chain(why, effectNs) {
      const { messages, call } = why;
      const from = call ? `${call.from} did not run in it` : 'from the bag: it came from outside these modules';
      const by = why.run ? `${call ? 'made' : 'published'} by ${why.run.module}${why.run.causes.length ? ` (${why.run.causes.join(', ')})` : ''}` : from;
      const delay = effectNs === null ? '' : `, ${milliseconds(effectNs - why.time_ns)} earlier`;
      const there = messages
        ? h('button', { type: 'button', class: 'chip mono', title: 'Go there', 'data-cause': messages.topic, onclick: () => see(messages.topic, messages.first + messages.count - 1) }, name(messages))
        : h('button', { type: 'button', class: 'chip mono', title: 'Go there', 'data-call': call?.from, onclick: () => obey(`go #${why.cycle}`) }, call?.event);
      return h('li', null, there,
        ` in cycle #${why.cycle}${delay}: ${by}${why.rest ? `; ${why.rest}` : ''}`,
        why.run?.got.length ? h('ul', null, why.run.got.map((event) => h('li', null, `it got: ${event}`))) : null,
        why.known.length ? h('ul', null, why.known.map(([messages, timeNs]) => h('li', { class: 'muted' }, `it knew ${name(messages)}, ${milliseconds(why.time_ns - timeNs)} old`))) : null,
        why.because.length ? h('ul', null, why.because.map((cause) => chain(cause, why.time_ns))) : null);
    }

    /** Lists the messages of a topic. @param {string} topic */
    async function list(topic) {
      try {
        const { messages, is_cut } = await robot.ask('debug_messages', { topic: `/${topic}` });
        const rows = messages.map((/** @type {{ time_ns: number, text: string }} */ message, /** @type {number} */ number) =>
          h('li', null, h('button', { type: 'button', class: 'chip mono', 'data-message': `${topic}#${number}`, onclick: () => obey(`go ${topic}#${number}`) }, `#${number}`), ` ${seconds(message.time_ns)}: ${message.text}`));
        replace(details, [h('h3', null, topic), h('ul', { 'data-testid': 'debug-messages' }, rows), is_cut ? h('p', { class: 'muted' }, `Only the first ${messages.length}.`) : null]);
        problem.hidden = true;
      } catch { /* A module has no messages. */ }
    }

    (async () => {
      try {
        const { about, modules, topics, cycles, difference: first, help, cycle } = await robot.ask('debug');
        startNs = about.start_ns;
        const option = (/** @type {string} */ value) => h('option', { value }, value);
        replace(names, [h('optgroup', { label: 'Topics' }, topics.map((/** @type {[string, number]} */ [topic]) => option(topic))), h('optgroup', { label: 'Modules' }, modules.map(option))]);
        replace(difference, first ? [button('First difference', 'go difference'), h('span', { class: 'muted' }, first)] : []);
        setText(note, [`${cycles} cycles.`, ...about.notes].join(' '));
        line.title = help;
        replace(root, [sheet]);
        show(cycle);
      } catch (error) { replace(root, [empty('Nothing is debugged here.', words(error))]); }
    })();
    return { destroy() {} };
  },
};
