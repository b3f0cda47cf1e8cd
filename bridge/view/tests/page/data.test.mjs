// What the panels of the graph and the timeline compute. `node --test bridge/view/tests/page/data.test.mjs`

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { Chains, drawnOf, wayBetween } from '../../page/panels/graph_chains.js';
import { History, edgesOf, isDebug, isOwn, summary } from '../../page/panels/graph_data.js';
import { Servos, cableTrouble } from '../../page/panels/servos_data.js';
import { Timeline, niceStep, publishersOf } from '../../page/panels/timeline_data.js';

const times = (more = {}) => ({ count: 0, sum_ns: 0, p50_ns: 0, p99_ns: 0, max_ns: 0, ...more });
const moduleOf = (more = {}) => ({
  name: 'walk', state: 'active', is_detached: false, runs: 0, received: 0, published: 0, overruns: 0, panics: 0, restarts: 0, inbox: 0, dropped: 0,
  run_time: times(), ...more,
});
const topicOf = (more = {}) => ({ name: 'imu', message_type: 'Imu', subscribers: 1, messages: 0, dropped: 0, largest_batch: 1, ...more });
const snapshot = (seconds, { modules = [], topics = [], outlets = [] } = {}) => ({ uptime_ns: seconds * 1e9, cycle: 0, is_paused: false, modules, topics, outlets });

test('rates are differences of two snapshots', () => {
  const history = new History();
  // Every fourth run is measured, and takes 2 ms.
  history.add(snapshot(10, { modules: [moduleOf({ runs: 1000, run_time: times({ count: 250, sum_ns: 1e12 }) })], topics: [topicOf({ messages: 500, dropped: 3 })] }));
  history.add(snapshot(12, { modules: [moduleOf({ runs: 1200, run_time: times({ count: 300, sum_ns: 1e12 + 50 * 2e6, p99_ns: 3e6 }) })], topics: [topicOf({ messages: 700, dropped: 7 })] }));
  const walk = history.module('walk');
  assert.deepEqual([walk.hz, walk.share, walk.isLong, walk.isOverrunning], [100, 0.2, false, false]);
  assert.equal(summary(walk).text[0], '100 Hz · 20.0 % core');
  const imu = history.topic('imu');
  assert.deepEqual([imu.hz, imu.dropsPerSecond], [100, 2]);
  assert.deepEqual([history.module('none'), history.topic('none'), history.outlet('none')], [null, null, null]);
});

test('the first snapshot has no rates yet', () => {
  const history = new History();
  history.add(snapshot(10, { modules: [moduleOf({ runs: 1000 })] }));
  assert.equal(history.module('walk').hz, 0);
});

test('a robot that was started again begins from nothing', () => {
  const history = new History();
  history.add(snapshot(100, { modules: [moduleOf({ runs: 9000 })] }));
  history.add(snapshot(1, { modules: [moduleOf({ runs: 10 })] }));
  history.add(snapshot(3, { modules: [moduleOf({ runs: 30 })] }));
  assert.equal(history.module('walk').hz, 10);
});

test('a run that stands still has the rates of the time before', () => {
  const history = new History();
  for (const runs of [1000, 400, 400]) {
    history.add({ ...snapshot(runs / 100, { modules: [moduleOf({ runs })] }), before: snapshot(runs / 100 - 2, { modules: [moduleOf({ runs: runs - 50 })] }) });
    assert.equal(history.module('walk').hz, 25);
    assert.equal(history.module('walk').runs, runs);
  }
});

test('the history does not grow', () => {
  const history = new History();
  for (let look = 0; look < 5000; look += 1) history.add(snapshot(look / 2, { modules: [moduleOf({ runs: look })] }));
  assert(history.looks.length < 30, `${history.looks.length}`);
  assert.equal(history.shares('walk').length, 120);
});

test('a module that needs attention says so in a word', () => {
  const history = new History();
  const of = (more) => {
    history.looks = [];
    history.add(snapshot(0, { modules: [moduleOf()] }));
    history.add(snapshot(2, { modules: [moduleOf({ runs: 250, ...more })] }));
    return summary(history.module('walk'));
  };
  assert.deepEqual([of({}).badge, of({}).tone], [undefined, undefined]);
  assert.equal(of({ overruns: 1 }).tone, 'late');
  assert.equal(of({ run_time: times({ count: 250, sum_ns: 1e9, p99_ns: 9e6 }) }).badge, 'late', 'its 99th percentile is above its period of 8 ms');
  assert.equal(of({ state: 'failed', overruns: 1 }).tone, 'failed');
  assert.equal(of({ state: 'restarting' }).badge, 'restarting');
  assert.equal(of({ state: 'paused' }).badge, 'held');
  assert.equal(of({ state: 'unconfigured' }).badge, 'unconfigured');
  assert.equal(of({ is_detached: true, dropped: 4 }).badge, 'drops');
  assert.match(of({ is_detached: true, inbox: 7 }).text[0], /queue 7$/);
});

test('lateness is forgotten after a while', () => {
  const history = new History();
  for (let second = 0; second < 30; second += 1) history.add(snapshot(second, { modules: [moduleOf({ runs: second * 100, overruns: second < 3 ? 0 : 1 })] }));
  assert.equal(summary(history.module('walk')).tone, undefined);
});

const graph = {
  modules: [{ name: 'eye', is_detached: true }, { name: 'walk', is_detached: false }],
  topics: ['image', 'a', 'b', 'c', 'executor/cycles', 'alone'].map((name) => ({ name, message_type: 'T' })),
  services: [{ name: 'reset', request_type: 'R', response_type: 'S' }],
  outlets: [{ name: 'bag' }],
  edges: [
    ...[0, 1, 2, 3].map((topic) => ({ publishes: { module: 0, topic } })),
    ...[1, 2, 3].map((topic) => ({ subscribes: { module: 1, topic } })),
    { publishes: { module: 1, topic: 4 } }, { leaves: { topic: 0, outlet: 0 } }, { calls: { module: 1, service: 0 } }, { serves: { module: 0, service: 0 } },
  ],
};
const options = { mode: 'nodes', debug: false, outlets: true, services: true, group: false };
const ids = ({ nodes }) => nodes.map(({ id }) => id).sort();
const lines = ({ edges }) => edges.map(({ from, to, label }) => `${from} ${label ?? ''}> ${to}`).sort();

test('topics as nodes', () => {
  const shown = edgesOf(graph, options);
  assert.deepEqual(ids(shown), ['m:eye', 'm:walk', 'o:bag', 's:reset', 't:a', 't:alone', 't:b', 't:c', 't:image']);
  assert.equal(shown.edges.length, 10);
  assert(edgesOf(graph, { ...options, debug: true }).nodes.some(({ id }) => id === 't:executor/cycles'));
  assert(!ids(edgesOf(graph, { ...options, outlets: false, services: false })).some((id) => /^[os]:/.test(id)));
});

test('topics between the same modules as one node', () => {
  const shown = edgesOf(graph, { ...options, group: true });
  const grouped = shown.nodes.find(({ kind }) => kind === 'topics');
  assert.deepEqual([grouped.title, grouped.topics], ['3 topics', ['a', 'b', 'c']]);
  assert(ids(shown).includes('t:image'));
});

test('topics as labels of edges', () => {
  const shown = edgesOf(graph, { ...options, mode: 'labels', services: false });
  assert.deepEqual(ids(shown), ['m:eye', 'm:walk', 'o:bag', 't:alone']);
  assert.deepEqual(lines(shown), ['m:eye 3 topics> m:walk', 'm:eye image> o:bag']);
});

test('modules that the program adds are shown on request', () => {
  const { modules, topics, edges } = graph;
  const more = { ...graph, modules: [...modules, { name: 'step_journal', is_detached: false }], topics: [...topics, { name: 'module_steps', message_type: 'T' }],
    edges: [...edges, { subscribes: { module: 2, topic: 1 } }, { publishes: { module: 2, topic: 6 } }, { calls: { module: 2, service: 0 } }] };
  assert.deepEqual(lines(edgesOf(more, options)), lines(edgesOf(graph, options)));
  assert.equal(edgesOf(more, options).modules, 2);
  assert.equal(edgesOf(more, { ...options, debug: true }).modules, 3);
  assert(isOwn('bridge_services') && isOwn('run_journal') && !isOwn('my_journal'));
});

test('topics about the program are told apart', () => {
  assert.deepEqual(['executor/modules', 'bridge/statistics', 'rosout', 'parameter_events', 'robot/rosout'].map(isDebug), Array(5).fill(true));
  assert.deepEqual(['joint_states', 'my_executor/x', 'bridges', 'rosout_agg'].map(isDebug), Array(4).fill(false));
});

// A sensor, a filter and a motion that goes back to the sensor's module; a watcher beside the way, and a server that the motion asks.
const loop = (() => {
  const modules = ['hardware', 'filter', 'motion', 'watcher', 'server', 'cycle_journal'];
  const topics = ['imu', 'orientation', 'goals', 'note', 'plan'];
  const services = ['where'];
  const index = { module: (name) => modules.indexOf(name), topic: (name) => topics.indexOf(name) };
  const wire = (topic, from, to) => [{ publishes: { module: index.module(from), topic: index.topic(topic) } },
    ...to.map((name) => ({ subscribes: { module: index.module(name), topic: index.topic(topic) } }))];
  return {
    modules: modules.map((name) => ({ name, is_detached: false })), topics: topics.map((name) => ({ name, message_type: 'T' })),
    services: services.map((name) => ({ name, request_type: 'R', response_type: 'S' })), outlets: [{ name: 'bag' }],
    edges: [...wire('imu', 'hardware', ['filter', 'watcher', 'cycle_journal']), ...wire('orientation', 'filter', ['motion', 'watcher']),
      ...wire('goals', 'motion', ['hardware', 'watcher']), ...wire('note', 'watcher', []), ...wire('plan', 'server', []),
      { calls: { module: index.module('motion'), service: 0 } }, { serves: { module: index.module('server'), service: 0 } }, { leaves: { topic: 2, outlet: 0 } }],
  };
})();
const sorted = (set) => [...set].sort();

test('the way of a chain has what lies between its topics, and nothing beside it', () => {
  const way = wayBetween(loop, { from: 'imu', to: 'goals' });
  assert.deepEqual([sorted(way.modules), sorted(way.topics), sorted(way.services)], [['filter', 'motion'], ['goals', 'imu', 'orientation'], []]);
  const drawn = drawnOf(edgesOf(loop, options), way);
  assert.deepEqual(sorted(drawn.nodes), ['m:filter', 'm:motion', 't:goals', 't:imu', 't:orientation']);
  assert.deepEqual(sorted(drawn.edges), ['m:filter→t:orientation', 'm:motion→t:goals', 't:imu→m:filter', 't:orientation→m:motion'], 'not from goals back to hardware');
});

test('the way of a chain where topics are labels begins and ends at the modules outside', () => {
  const drawn = drawnOf(edgesOf(loop, { ...options, mode: 'labels' }), wayBetween(loop, { from: 'imu', to: 'goals' }));
  assert.deepEqual(sorted(drawn.nodes), ['m:filter', 'm:motion']);
  assert.deepEqual(sorted(drawn.edges), ['m:filter→m:motion', 'm:hardware→m:filter', 'm:motion→m:hardware', 'm:motion→m:watcher']);
});

test('services are part of a way that topics alone do not make', () => {
  const way = wayBetween(loop, { from: 'imu', to: 'plan' });
  assert.deepEqual([sorted(way.modules), sorted(way.services)], [['filter', 'motion', 'server'], ['where']]);
  assert(drawnOf(edgesOf(loop, options), way).edges.has('m:motion→s:where service'));
  assert.deepEqual(sorted(wayBetween(loop, { from: 'note', to: 'imu' }).topics), ['imu', 'note'], 'no way: its ends');
});

test('a chain is above its limit while messages were too old in the last ten seconds', () => {
  const chains = new Chains();
  const report = (exceeded) => [{ name: 'way', from: 'a', to: 'b', limit_ns: 1, messages: 9, without_origin: 0, exceeded, p50_ns: 2, p90_ns: 2, p99_ns: 2, max_ns: 2, oldest: '' }];
  const look = (exceeded, nowMs) => { chains.add(report(exceeded), nowMs); return chains.isAbove('way', nowMs); };
  assert.deepEqual([look(5, 0), look(5, 1000), look(6, 2000), look(6, 12_000), look(6, 12_001)], [false, false, true, true, false]);
  assert.equal(look(1, 13_000), false, 'a robot that was started again counts from nothing');
  assert.deepEqual([chains.named('way').exceeded, chains.named('other')], [1, undefined]);
});

// Two threads: `eye` runs by itself and publishes images; `walk` runs in cycles for them, then `legs` for the goals of `walk`.
const trace = {
  threads: ['main', 'eye'],
  events: [
    { kind: 'run', module: 'walk', thread: 0, cycle: 7, begin_ns: 1100, end_ns: 1300, causes: ['message on image', 'timer'] },
    { kind: 'run', module: 'legs', thread: 0, cycle: 7, begin_ns: 1300, end_ns: 1400, causes: ['message on goals'] },
    { kind: 'process', thread: 0, cycle: 7, begin_ns: 1000, end_ns: 1500 },
    { kind: 'sync', thread: 0, cycle: 7, begin_ns: 1500, end_ns: 1600 },
    { kind: 'step', module: 'eye', thread: 1, cycle: 7, begin_ns: 100, end_ns: 900 },
    { kind: 'step', module: 'eye', thread: 1, cycle: 8, begin_ns: 950, end_ns: 2000 },
  ],
};
const publishers = new Map([['image', ['eye']], ['goals', ['walk']]]);

test('a lane per thread, the cycles first', () => {
  const { lanes, cycles, begin, end, modules } = new Timeline(trace, publishers);
  assert.deepEqual(lanes.map(({ name, phases, work }) => [name, phases.length, work.length]), [['main', 2, 2], ['eye', 0, 2]]);
  assert.deepEqual([...cycles], [[7, { begin: 1000, end: 1600 }]]);
  assert.deepEqual([begin, end, modules], [100, 2000, ['eye', 'legs', 'walk']]);
});

test('an arrow comes from the run that published the message', () => {
  const timeline = new Timeline(trace, publishers);
  const [walk] = timeline.byModule.get('walk');
  const [legs] = timeline.byModule.get('legs');
  assert.deepEqual(timeline.causesOf(walk).map(({ cause, topic }) => [cause.begin_ns, topic]), [[100, 'image']], 'not the step that still ran');
  assert.deepEqual(timeline.chainOf(legs).map(({ cause }) => cause.module), ['walk', 'eye']);
});

test('modules that send each other messages are no endless chain', () => {
  const events = [0, 1, 2, 3, 4].flatMap((n) => [
    { kind: 'run', module: 'a', thread: 0, cycle: n, begin_ns: n * 10, end_ns: n * 10 + 2, causes: ['message on y'] },
    { kind: 'run', module: 'b', thread: 0, cycle: n, begin_ns: n * 10 + 2, end_ns: n * 10 + 4, causes: ['message on x'] },
  ]);
  const timeline = new Timeline({ threads: ['main'], events }, new Map([['x', ['a']], ['y', ['b']]]));
  assert.equal(timeline.chainOf(timeline.byModule.get('b')[4]).length, 9);
});

test('statistics count what is in view', () => {
  const timeline = new Timeline(trace, publishers);
  const of = (begin, end) => timeline.statistics(begin, end).map(({ module, runs, longest }) => [module, runs, longest]);
  assert.deepEqual(of(0, 3000), [['eye', 2, 1050], ['walk', 1, 200], ['legs', 1, 100]]);
  assert.deepEqual(of(1350, 1400), [['eye', 1, 1050], ['legs', 1, 100]]);
});

test('what is at a time', () => {
  const timeline = new Timeline(trace, publishers);
  const { work } = timeline.lanes[0];
  assert.equal(timeline.at(work, 1250, 0).module, 'walk');
  assert.equal(timeline.at(work, 1420, 30).module, 'legs');
  assert.equal(timeline.at(work, 1700, 30), null);
});

test('a trace without events', () => {
  const timeline = new Timeline({ threads: [], events: [] });
  assert.deepEqual([timeline.lanes, timeline.statistics(0, 1)], [[], []]);
});

test('publishers come from the graph', () => {
  assert.deepEqual([...publishersOf(graph)].slice(0, 2), [['image', ['eye']], ['a', ['eye']]]);
});

test('steps of an axis are round', () => {
  assert.deepEqual([niceStep(100, 10), niceStep(120, 10), niceStep(999, 3), niceStep(1e9, 8)], [10, 20, 500, 2e8]);
});

test('a bad cable is between the last servo that answers and the first that does not', () => {
  const chain = (/** @type {string} */ lost, bus = 'arm') => [...lost].map((mark, index) => ({ name: `${bus}_${index + 1}`, id: index + 1, bus, level: 0, lostMs: mark === 'x' ? 1000 : -Infinity }));
  assert.equal(cableTrouble(chain('......'), 2000), '');
  assert.match(cableTrouble(chain('...xxx'), 2000), /From arm_4 \(id 4\) on, servos of arm miss answers: look at the cable between arm_3 and arm_4/);
  assert.match(cableTrouble(chain('xxxxxx'), 2000), /No servo of arm answers reliably: its power, or the cable to arm_1/);
  assert.equal(cableTrouble(chain('..x...'), 2000), '', 'one servo alone');
  assert.equal(cableTrouble(chain('.....x'), 2000), '', 'the last one alone');
  assert.equal(cableTrouble(chain('...xxx'), 60_000), '', 'long ago');
  assert.match(cableTrouble([...chain('......', 'legs'), ...chain('.xx', 'arm')], 2000), /cable between arm_1 and arm_2/);
});

/** The diagnostics of an arm whose servos have missed that many answers. */
const diagnosticsOf = (hardware, missed, topics = {}, title = 'so101') => ({ status: [
  { name: `${title}: bus`, hardware_id: hardware, level: 0, message: 'running', values: Object.entries({ port: `memory:${hardware}`, ...topics }).map(([key, value]) => ({ key, value })) },
  ...missed.map((count, place) => ({
    name: `${title}: servo ${10 - place} joint_${'cba'[place]}`, hardware_id: hardware, level: place === 2 ? 1 : 0, message: hardware,
    values: [{ key: 'answers missed', value: String(count) }],
  })),
] });
const stateOf = (name, angle) => ({ name, position: name.map((_, i) => angle + i), velocity: name.map(() => 0), effort: name.map(() => 0) });
const shown = (servos) => servos.groups().map(({ label, joints }) => [label, joints.map(({ name, position, missed, goal }) => [name, position, missed, goal])]);

test('the joints of two arms with the same names are shown each by itself, in the order of the cable', () => {
  const servos = new Servos();
  for (let second = 0; second < 4; second += 1) {
    servos.takeDiagnostics(diagnosticsOf('leader', [5, 5, 5], { joint_states: 'leader/joint_states', joint_commands: 'leader/joint_commands' }), second * 1000);
    servos.takeDiagnostics(diagnosticsOf('follower', [0, 0, 0], { joint_states: 'joint_states', joint_commands: '/joint_goals' }), second * 1000);
  }
  servos.takeStates('/leader/joint_states', stateOf(['joint_a', 'joint_b', 'joint_c'], 0.1), 3000);
  servos.takeStates('/joint_states', stateOf(['joint_a', 'joint_b', 'joint_c'], 7), 3000);
  servos.takeGoals('/joint_goals', stateOf(['joint_a', 'joint_b', 'joint_c'], 20));
  assert.deepEqual(shown(servos), [
    ['leader', [['joint_c', 2.1, 5, NaN], ['joint_b', 1.1, 5, NaN], ['joint_a', 0.1, 5, NaN]]],
    ['follower', [['joint_c', 9, 0, 22], ['joint_b', 8, 0, 21], ['joint_a', 7, 0, 20]]],
  ]);
  const joints = servos.groups().flatMap((group) => group.joints);
  assert.equal(new Set(joints.map(({ key }) => key)).size, 6);
  assert.deepEqual(joints.map(({ id }) => id), [10, 9, 8, 10, 9, 8]);
  assert.equal(cableTrouble(joints, 4000), '', 'counts of one arm are no losses of the other');
  servos.takeDiagnostics(diagnosticsOf('follower', [0, 3, 3]), 4000);
  servos.takeDiagnostics(diagnosticsOf('follower', [0, 4, 4]), 5000);
  const trouble = cableTrouble(servos.groups().flatMap((group) => group.joints), 5500);
  assert.match(trouble, /From joint_b \(id 9\) on, servos of follower miss answers: look at the cable between joint_c and joint_b/);
});

test('an arm whose states are not exposed has rows from its diagnostics', () => {
  const servos = new Servos();
  servos.takeDiagnostics(diagnosticsOf('leader', [1, 1, 1], { joint_states: 'leader/joint_states' }), 0);
  servos.takeDiagnostics(diagnosticsOf('follower', [0, 0, 0], { joint_states: 'joint_states' }), 0);
  servos.takeStates('/joint_states', stateOf(['joint_a'], 1), 0);
  assert.deepEqual(shown(servos).map(([label, joints]) => [label, joints.map(([, position]) => position)]), [['leader', [NaN, NaN, NaN]], ['follower', [NaN, NaN, 1]]]);
});

test('two arms of one description differ by their ports', () => {
  const servos = new Servos();
  for (const port of ['/dev/ttyACM0', '/dev/ttyACM1']) servos.takeDiagnostics(diagnosticsOf('so101', [1], { port }), 0);
  assert.deepEqual(shown(servos).map(([label]) => label), ['so101, /dev/ttyACM0', 'so101, /dev/ttyACM1']);
});

test('buses whose states are merged, and robots that do not name their topics, find them on joint_states', () => {
  const merged = new Servos();
  merged.takeDiagnostics(diagnosticsOf('op3', [1, 1], { joint_states: 'legs/joint_states', joint_commands: 'joint_commands' }), 0);
  merged.takeStates('/joint_states', stateOf(['joint_c', 'joint_b', 'wheel'], 1), 0);
  merged.takeGoals('/joint_commands', stateOf(['joint_c', 'wheel'], 5));
  assert.deepEqual(shown(merged), [['op3', [['joint_c', 1, 1, 5], ['joint_b', 2, 1, NaN]]], ['/joint_states', [['wheel', 3, NaN, 6]]]]);
  const silent = new Servos();
  silent.takeStates('/joint_states', stateOf(['joint_c'], 1), 0);
  silent.takeGoals('/joint_commands', stateOf(['joint_c'], 5));
  assert.deepEqual(shown(silent), [['/joint_states', [['joint_c', 1, NaN, 5]]]]);
  silent.takeDiagnostics(diagnosticsOf('', [2], {}, 'darwin_op'), 0);
  assert.deepEqual(shown(silent), [['darwin_op', [['joint_c', 1, 2, 5]]]]);
  silent.forget();
  assert.deepEqual(shown(silent), [['darwin_op', [['joint_c', 1, NaN, NaN]]]]);
});
