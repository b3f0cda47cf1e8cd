// What the layout of graphs promises. `node --test bridge/view/tests/page/layout.test.mjs`

import assert from 'node:assert/strict';
import { test } from 'node:test';
import { eliminateCycles, layout } from '../../page/graph/layout.js';

const node = (id, width = 120, height = 40) => ({ id, width, height });
const edge = (from, to, more = {}) => ({ id: `${from}>${to}`, from, to, ...more });

/** Pseudo random, the same in every run (mulberry32). */
function random(seed) {
  let state = seed;
  return (below) => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), state | 1);
    mixed ^= mixed + Math.imul(mixed ^ (mixed >>> 7), mixed | 61);
    return ((mixed ^ (mixed >>> 14)) >>> 0) % below;
  };
}

/** Modules that publish and subscribe as those of a large robot do. */
function robot(modules, topics, seed) {
  const below = random(seed);
  const nodes = [];
  const edges = [];
  for (let m = 0; m < modules; m += 1) nodes.push(node(`m${m}`, 150, 54));
  for (let t = 0; t < topics; t += 1) {
    nodes.push(node(`t${t}`, 80 + below(80), 24));
    const publisher = below(modules);
    edges.push(edge(`m${publisher}`, `t${t}`));
    for (let s = below(4); s > 0; s -= 1) edges.push(edge(`t${t}`, `m${(publisher + below(8)) % modules}`));
  }
  const once = new Map(edges.map((each) => [each.id, each]));
  return { nodes, edges: [...once.values()] };
}

/** Points along a path of M, L and C, absolute. */
function* walk(path) {
  let [x, y] = [0, 0];
  for (const [, command, text] of path.matchAll(/([MLC])([^MLC]*)/g)) {
    const n = text.split(/[ ,]+/).filter(Boolean).map(Number);
    const [ex, ey] = n.slice(-2);
    for (let step = 0; step <= 24; step += 1) {
      const t = step / 24;
      const bezier = (a, b, c, d) => a * (1 - t) ** 3 + 3 * b * t * (1 - t) ** 2 + 3 * c * t * t * (1 - t) + d * t ** 3;
      if (command === 'C') yield [bezier(x, n[0], n[2], ex), bezier(y, n[1], n[3], ey)];
      else if (command === 'L') yield [x + (ex - x) * t, y + (ey - y) * t];
    }
    [x, y] = [ex, ey];
  }
}

const overlap = (a, b) => a.x < b.x + b.width && b.x < a.x + a.width && a.y < b.y + b.height && b.y < a.y + a.height;
const isInside = ([x, y], box, margin = 0.5) =>
  x > box.x + margin && x < box.x + box.width - margin && y > box.y + margin && y < box.y + box.height - margin;

function assertReadable(graph, made) {
  assert.equal(made.nodes.size, graph.nodes.length);
  const boxes = [...made.nodes.entries()];
  const labels = [...made.edges.entries()].flatMap(([id, { label }]) => (label ? [[`label of ${id}`, label]] : []));
  const all = [...boxes, ...labels];
  all.forEach(([a, boxA], index) => {
    for (const [b, boxB] of all.slice(index + 1)) assert(!overlap(boxA, boxB), `${a} and ${b} overlap`);
    assert(boxA.x >= 0 && boxA.y >= 0, `${a} is outside`);
    assert(boxA.x + boxA.width <= made.width + 0.1 && boxA.y + boxA.height <= made.height + 0.1, `${a} is outside`);
  });
  for (const { id } of graph.edges) {
    const route = made.edges.get(id);
    for (const point of walk(route.path)) {
      assert(point.every(Number.isFinite), `${id}: ${route.path}`);
      for (const [name, box] of boxes) assert(!isInside(point, box), `${id} runs through ${name}`);
    }
  }
}

test('a chain goes from left to right on one line', () => {
  const graph = { nodes: ['a', 'b', 'c'].map((id) => node(id)), edges: [edge('a', 'b'), edge('b', 'c')] };
  const { nodes } = layout(graph);
  assert.deepEqual(['a', 'b', 'c'].map((id) => nodes.get(id).layer), [0, 1, 2]);
  assert(nodes.get('a').x + 120 < nodes.get('b').x && nodes.get('b').x + 120 < nodes.get('c').x);
  assert.equal(new Set(['a', 'b', 'c'].map((id) => Math.round(nodes.get(id).y))).size, 1);
});

test('an edge over several columns passes beside the nodes between', () => {
  const ids = ['a', 'b', 'c', 'd'];
  const graph = { nodes: ids.map((id) => node(id)), edges: [edge('a', 'b'), edge('b', 'c'), edge('c', 'd'), edge('a', 'd'), edge('a', 'c')] };
  assertReadable(graph, layout(graph));
});

test('a cycle has one edge backward, which is drawn around the nodes', () => {
  const ids = ['sense', 'decide', 'move'];
  const edges = [edge('sense', 'decide'), edge('decide', 'move'), edge('move', 'sense'), edge('decide', 'decide')];
  const graph = { nodes: ids.map((id) => node(id)), edges };
  const made = layout(graph);
  assertReadable(graph, made);
  const backward = edges.filter(({ id }) => made.edges.get(id).isBackward).map(({ id }) => id);
  assert.deepEqual(backward, ['move>sense', 'decide>decide']);
  const [first, ...rest] = made.edges.get('move>sense').points;
  assert.equal(first[0], made.nodes.get('move').x + 120, 'leaves at the right');
  assert.equal(rest.at(-1)[0], made.nodes.get('sense').x, 'arrives at the left');
});

test('few edges of a graph with cycles are turned', () => {
  const { nodes, edges } = robot(30, 60, 5);
  const rank = eliminateCycles(nodes, edges);
  const turned = edges.filter(({ from, to }) => rank.get(from) > rank.get(to)).length;
  assert(turned * 6 < edges.length, `${turned} of ${edges.length}`);
});

test('edges begin and end at ports', () => {
  const ports = [{ id: 'x', side: 'out', y: 10 }, { id: 'y', side: 'out', y: 30 }, { id: 'x', side: 'in', y: 20 }];
  const graph = {
    nodes: [{ ...node('a'), ports }, { ...node('b'), ports }],
    edges: [{ id: 'e', from: 'a', to: 'b', fromPort: 'y', toPort: 'x' }],
  };
  const made = layout(graph);
  const { points } = made.edges.get('e');
  assert.deepEqual(points[0], [made.nodes.get('a').x + 120, made.nodes.get('a').y + 30]);
  assert.deepEqual(points.at(-1), [made.nodes.get('b').x, made.nodes.get('b').y + 20]);
});

test('two wires between the ports of two nodes do not cross', () => {
  const out = [{ id: 'top', side: 'out', y: 10 }, { id: 'bottom', side: 'out', y: 30 }];
  const graph = {
    nodes: [{ ...node('a'), ports: out }, node('low'), node('high')],
    edges: [{ id: '1', from: 'a', to: 'low', fromPort: 'bottom' }, { id: '2', from: 'a', to: 'high', fromPort: 'top' }],
  };
  const { nodes } = layout(graph);
  assert(nodes.get('high').y < nodes.get('low').y);
});

test('a label lies on its edge', () => {
  const graph = { nodes: [node('a'), node('b')], edges: [edge('a', 'b', { label: { width: 60, height: 16 } }), edge('b', 'a', { label: { width: 50, height: 16 } })] };
  const made = layout(graph);
  assertReadable(graph, made);
  for (const { id } of graph.edges) {
    const { label, path } = made.edges.get(id);
    assert([...walk(path)].some((point) => isInside(point, label, -0.5)), id);
  }
});

test('crossings that can be avoided are avoided', () => {
  const names = [0, 1, 2, 3, 4, 5, 6, 7];
  const graph = {
    nodes: [...names.map((n) => node(`a${n}`)), ...[...names].reverse().map((n) => node(`b${n}`)), node('root')],
    edges: [...names.map((n) => edge(`a${n}`, `b${n}`)), ...names.map((n) => edge('root', `a${(n * 3) % 8}`))],
  };
  const { nodes } = layout(graph);
  const order = (letter) => names.map((n) => [nodes.get(`${letter}${n}`).y, n]).sort((a, b) => a[0] - b[0]).map(([, n]) => n);
  assert.deepEqual(order('a'), order('b'));
});

test('parts that do not hang together lie apart', () => {
  const nodes = Array.from({ length: 12 }, (_, n) => node(`n${n}`));
  const graph = { nodes, edges: [edge('n0', 'n1'), edge('n2', 'n3'), edge('n3', 'n2')] };
  const made = layout(graph);
  assertReadable(graph, made);
  assert(made.width < 900, 'packed, not in one row');
});

test('sixty modules and a hundred and fifty topics stay readable', () => {
  for (const seed of [1, 2, 3]) {
    const graph = robot(60, 150, seed);
    assertReadable(graph, layout(graph));
  }
});

test('edges may lead downward', () => {
  const graph = robot(20, 40, 4);
  const made = layout(graph, { direction: 'down' });
  assertReadable(graph, made);
  for (const { id, from, to } of graph.edges) {
    const { points } = made.edges.get(id);
    const [upper, lower] = [made.nodes.get(from), made.nodes.get(to)];
    assert.deepEqual(points[0], [upper.x + upper.width / 2, upper.y + upper.height]);
    assert.deepEqual(points.at(-1), [lower.x + lower.width / 2, lower.y]);
  }
  const again = layout(graph, { direction: 'down', previous: made });
  for (const [id, box] of made.nodes) assert(Math.abs(again.nodes.get(id).x - box.x) < 40, `${id} moved without a reason`);
});

test('the same graph gets the same layout', () => {
  const graph = robot(20, 40, 7);
  assert.deepEqual(layout(graph), layout(graph));
});

test('what was shown stays in its place when a node appears', () => {
  const graph = robot(12, 24, 9);
  const previous = layout(graph);
  const again = layout(graph, { previous });
  for (const [id, box] of previous.nodes) {
    assert(Math.abs(again.nodes.get(id).y - box.y) < 30, `${id} moved without a reason`);
  }
  const more = { nodes: [...graph.nodes, node('new')], edges: [...graph.edges, edge('m3', 'new'), edge('new', 'm5')] };
  const made = layout(more, { previous });
  assertReadable(more, made);
  const order = (of, layer) => [...previous.nodes.keys()].filter((id) => previous.nodes.get(id).layer === layer)
    .sort((a, b) => of.nodes.get(a).y - of.nodes.get(b).y);
  const moved = [...previous.nodes.keys()].filter((id) => Math.abs(made.nodes.get(id).y - previous.nodes.get(id).y) > 80);
  assert(moved.length * 4 < previous.nodes.size, `${moved.length} of ${previous.nodes.size} moved far: ${moved}`);
  for (let layer = 0; layer < 4; layer += 1) {
    const stays = order(previous, layer).filter((id) => made.nodes.get(id).layer === layer);
    assert.deepEqual(order(made, layer).filter((id) => stays.includes(id)), stays, `order in column ${layer}`);
  }
});

test('nothing, and edges that lead nowhere', () => {
  const made = layout({ nodes: [], edges: [edge('a', 'b')] });
  assert.deepEqual([made.nodes.size, made.edges.size, made.width, made.height], [0, 0, 0, 0]);
});
