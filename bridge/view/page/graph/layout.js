// @ts-check
/**
 * A layered layout of directed graphs from left to right, after Sugiyama: cycles are broken, vertices get layers, long edges get a
 * bend in each layer they pass, crossings are reduced, and coordinates are chosen so that edges are short and straight.
 *
 * Inside a column an edge runs horizontally in a lane of its own; it turns only between columns. So no edge passes through a node.
 *
 * References:
 * - K. Sugiyama, S. Tagawa, M. Toda: Methods for Visual Understanding of Hierarchical System Structures, 1981.
 * - P. Eades, X. Lin, W. F. Smyth: A fast and effective heuristic for the feedback arc set problem, 1993 (cycles).
 * - W. Barth, M. Jünger, P. Mutzel: Simple and Efficient Bilayer Cross Counting, 2002.
 * - M. J. Best, N. Chakravarti: Active set algorithms for isotonic regression, 1990 (coordinates within a column).
 *
 * @module
 */

/** @typedef {{ id: string, side: 'in' | 'out', y: number }} LayoutPort `y` counts from the node's top. */
/** @typedef {{ id: string, width: number, height: number, ports?: LayoutPort[] }} LayoutNode */
/**
 * An edge leaves the right side of `from` and enters the left side of `to`, at a port or in the middle of the side.
 * A label is placed on the edge, in a place of its own.
 * @typedef {{ id: string, from: string, to: string, fromPort?: string, toPort?: string,
 *   label?: { width: number, height: number } }} LayoutEdge
 */
/** @typedef {{ x: number, y: number, width: number, height: number }} Box `x` and `y` are the upper left corner. */
/** @typedef {{ path: string, points: [number, number][], isBackward: boolean, label?: Box }} Route */
/** @typedef {{ nodes: Map<string, Box & { layer: number }>, edges: Map<string, Route>, width: number, height: number }} Layout */
/**
 * @typedef {object} LayoutOptions
 * @property {number} [nodeGap] between two nodes of a column
 * @property {number} [edgeGap] between an edge and what is beside it
 * @property {number} [columnGap] between two columns, at least
 * @property {number} [aspect] width by height that unconnected parts are packed to
 * @property {'right' | 'down'} [direction] where edges lead; downward they leave at the bottom and enter at the top, and ports are ignored
 * @property {Layout} [previous] what has been shown: nodes that it knows stay where they are as far as possible
 */

/**
 * What has a place in a column: a node, a bend of an edge or the label of one.
 * @typedef {object} Vertex
 * @property {LayoutNode | null} node
 * @property {number} layer
 * @property {number} order
 * @property {number} width
 * @property {number} height
 * @property {number} y of its centre
 * @property {Link[]} left
 * @property {Link[]} right
 * @property {Vertex | null} hook the node beside which a backward edge turns around
 * @property {number | null} anchor where its centre has been
 */
/**
 * From a vertex to one of the next column; offsets from the vertices' centres.
 * @typedef {{ a: Vertex, b: Vertex, aOffset: number, bOffset: number, weight: number }} Link
 */
/** @typedef {{ edge: LayoutEdge, bends: Vertex[], label: Vertex | null, isBackward: boolean }} Chain */

const DEFAULTS = { nodeGap: 16, edgeGap: 9, columnGap: 36, aspect: 1.7, direction: /** @type {'right' | 'down'} */ ('right') };
const SWEEPS = 16;
const RELAXATIONS = 24;

/**
 * Edges whose ends are not among the nodes are left out. The same graph always gets the same layout.
 * @param {{ nodes: LayoutNode[], edges: LayoutEdge[] }} graph
 * @param {LayoutOptions} [options]
 * @returns {Layout}
 */
export function layout(graph, options = {}) {
  const settings = { ...DEFAULTS, ...options };
  if (settings.direction === 'down') {
    const previous = options.previous && transpose(options.previous);
    const turned = (/** @type {{ width: number, height: number }} */ size) => ({ width: size.height, height: size.width });
    const nodes = graph.nodes.map(({ id, width, height }) => ({ id, width: height, height: width }));
    const edges = graph.edges.map(({ id, from, to, label }) => ({ id, from, to, label: label && turned(label) }));
    return transpose(layout({ nodes, edges }, { ...settings, direction: 'right', aspect: 1 / settings.aspect, previous }));
  }
  const known = new Set(graph.nodes.map((node) => node.id));
  const edges = graph.edges.filter((edge) => known.has(edge.from) && known.has(edge.to));
  const parts = components(graph.nodes, edges).map((part) => layoutPart(part.nodes, part.edges, settings));
  return pack(parts, settings);
}

/**
 * The path of an edge between nodes whose places somebody else chose. It avoids nothing.
 * @param {[number, number]} start right side of the first node
 * @param {[number, number]} end left side of the second one
 * @returns {string}
 */
export function directPath(start, end) {
  const [x1, y1] = start;
  const [x2, y2] = end;
  if (x2 >= x1 + 24) return `M${f(x1)},${f(y1)}${curve(x1, y1, x2, y2)}`;
  // Backward: out to the right, over or under, and in from the left.
  const reach = 28 + Math.min(60, Math.abs(y2 - y1) / 6);
  const middle = Math.abs(y2 - y1) < 60 ? Math.max(y1, y2) + 56 : (y1 + y2) / 2;
  return `M${f(x1)},${f(y1)}C${f(x1 + reach)},${f(y1)} ${f(x1 + reach)},${f(middle)} ${f(x1)},${f(middle)}` +
    `L${f(x2)},${f(middle)}C${f(x2 - reach)},${f(middle)} ${f(x2 - reach)},${f(y2)} ${f(x2)},${f(y2)}`;
}

/**
 * @param {LayoutNode} node
 * @param {'in' | 'out'} side
 * @param {string | undefined} port
 * @returns {number} from the node's top
 */
export function portY(node, side, port) {
  const found = port === undefined ? undefined : node.ports?.find(({ id, side: s }) => id === port && s === side);
  return found ? found.y : node.height / 2;
}

/**
 * @param {LayoutNode[]} nodes
 * @param {LayoutEdge[]} edges
 */
function components(nodes, edges) {
  /** @type {Map<string, string>} */
  const parent = new Map(nodes.map((node) => [node.id, node.id]));
  const root = (/** @type {string} */ id) => {
    let at = id;
    while (parent.get(at) !== at) {
      const above = /** @type {string} */ (parent.get(at));
      parent.set(at, /** @type {string} */ (parent.get(above)));
      at = above;
    }
    return at;
  };
  for (const edge of edges) parent.set(root(edge.from), root(edge.to));
  /** @type {Map<string, { nodes: LayoutNode[], edges: LayoutEdge[] }>} */
  const parts = new Map();
  for (const node of nodes) {
    const key = root(node.id);
    const part = parts.get(key) ?? { nodes: [], edges: [] };
    part.nodes.push(node);
    parts.set(key, part);
  }
  for (const edge of edges) parts.get(root(edge.from))?.edges.push(edge);
  return [...parts.values()];
}

/**
 * @param {LayoutNode[]} nodes
 * @param {LayoutEdge[]} edges
 * @param {Required<Omit<LayoutOptions, 'previous'>> & LayoutOptions} settings
 * @returns {Layout}
 */
function layoutPart(nodes, edges, settings) {
  const rank = eliminateCycles(nodes, edges);
  const layerOf = assignLayers(nodes, edges, rank, settings.previous);
  const { layers, chains, vertexOf } = buildLayers(nodes, edges, layerOf, settings);
  orderLayers(layers, vertexOf, settings.previous);
  placeVertices(layers, settings);
  return route(layers, chains, vertexOf, settings);
}

/**
 * Ranks the nodes so that few edges go from a higher rank to a lower one.
 * @param {LayoutNode[]} nodes
 * @param {LayoutEdge[]} edges
 * @returns {Map<string, number>}
 */
export function eliminateCycles(nodes, edges) {
  /** @type {Map<string, string[]>} */
  const successors = new Map(nodes.map(({ id }) => [id, []]));
  /** @type {Map<string, string[]>} */
  const predecessors = new Map(nodes.map(({ id }) => [id, []]));
  for (const { from, to } of edges) {
    if (from === to) continue;
    successors.get(from)?.push(to);
    predecessors.get(to)?.push(from);
  }
  const left = new Set(nodes.map(({ id }) => id));
  const degree = (/** @type {Map<string, string[]>} */ of, /** @type {string} */ id) =>
    (of.get(id) ?? []).reduce((sum, other) => sum + (left.has(other) ? 1 : 0), 0);
  /** @type {string[]} */
  const head = [];
  /** @type {string[]} */
  const tail = [];
  while (left.size > 0) {
    let progressed = true;
    while (progressed) {
      progressed = false;
      for (const id of [...left]) {
        if (degree(successors, id) === 0) {
          tail.push(id);
        } else if (degree(predecessors, id) === 0) {
          head.push(id);
        } else {
          continue;
        }
        left.delete(id);
        progressed = true;
      }
    }
    let best = null;
    let bestDelta = -Infinity;
    for (const id of left) {
      const delta = degree(successors, id) - degree(predecessors, id);
      if (delta > bestDelta) [best, bestDelta] = [id, delta];
    }
    if (best !== null) {
      head.push(best);
      left.delete(best);
    }
  }
  return new Map([...head, ...tail.reverse()].map((id, index) => [id, index]));
}

/**
 * @param {LayoutNode[]} nodes
 * @param {LayoutEdge[]} edges
 * @param {Map<string, number>} rank
 * @param {Layout | undefined} previous
 * @returns {Map<string, number>}
 */
function assignLayers(nodes, edges, rank, previous) {
  // What has been shown keeps its direction, so that a new edge does not turn the picture around.
  const key = (/** @type {string} */ id) => previous?.nodes.get(id)?.layer;
  const isReversed = (/** @type {string} */ a, /** @type {string} */ b) => {
    const [layerA, layerB] = [key(a), key(b)];
    if (layerA !== undefined && layerB !== undefined && layerA !== layerB) return layerA > layerB;
    return (rank.get(a) ?? 0) > (rank.get(b) ?? 0);
  };
  /** @typedef {{ id: string, ahead: { to: string, length: number }[], behind: { to: string, length: number }[] }} Entry */
  /** @type {Map<string, Entry>} */
  const entries = new Map(nodes.map(({ id }) => [id, { id, ahead: [], behind: [] }]));
  for (const edge of edges) {
    if (edge.from === edge.to) continue;
    const reversed = isReversed(edge.from, edge.to);
    const [a, b] = reversed ? [edge.to, edge.from] : [edge.from, edge.to];
    const length = edge.label && !reversed ? 2 : 1;
    entries.get(a)?.ahead.push({ to: b, length });
    entries.get(b)?.behind.push({ to: a, length });
  }
  const order = topological(nodes, entries);
  /** @type {Map<string, number>} */
  const layer = new Map();
  const at = (/** @type {string} */ id) => layer.get(id) ?? 0;
  for (const id of order) {
    const behind = entries.get(id)?.behind ?? [];
    layer.set(id, Math.max(0, ...behind.map(({ to, length }) => at(to) + length)));
  }
  // Sources move towards what they feed, and nodes with as many edges on both sides stay.
  for (let round = 0, moved = true; moved && round < 8; round += 1) {
    moved = false;
    for (const id of round % 2 === 0 ? [...order].reverse() : order) {
      const entry = entries.get(id);
      if (!entry || (entry.ahead.length === 0 && entry.behind.length === 0)) continue;
      const lowest = Math.max(0, ...entry.behind.map(({ to, length }) => at(to) + length));
      const highest = Math.min(...entry.ahead.map(({ to, length }) => at(to) - length));
      const pull = entry.ahead.length - entry.behind.length;
      let wanted = at(id);
      if (pull > 0 && Number.isFinite(highest)) wanted = highest;
      if (pull < 0) wanted = lowest;
      if (wanted !== at(id)) {
        layer.set(id, wanted);
        moved = true;
      }
    }
  }
  return layer;
}

/**
 * @param {LayoutNode[]} nodes
 * @param {Map<string, { ahead: { to: string }[], behind: { to: string }[] }>} entries
 */
function topological(nodes, entries) {
  const waiting = new Map(nodes.map(({ id }) => [id, entries.get(id)?.behind.length ?? 0]));
  const order = nodes.map(({ id }) => id).filter((id) => waiting.get(id) === 0);
  for (let index = 0; index < order.length; index += 1) {
    for (const { to } of entries.get(order[index])?.ahead ?? []) {
      const rest = (waiting.get(to) ?? 0) - 1;
      waiting.set(to, rest);
      if (rest === 0) order.push(to);
    }
  }
  if (order.length < nodes.length) {
    // Directions kept from before and those of new edges can disagree: break the circle at the first node in it.
    const done = new Set(order);
    for (const { id } of nodes) {
      if (done.has(id)) continue;
      const entry = entries.get(id);
      if (entry) {
        for (const { to } of entry.behind.filter(({ to }) => !done.has(to))) {
          const other = entries.get(to);
          const index = other?.ahead.findIndex((link) => link.to === id) ?? -1;
          if (other && index >= 0) other.ahead.splice(index, 1);
        }
        entry.behind = entry.behind.filter(({ to }) => done.has(to));
      }
      return topological(nodes, entries);
    }
  }
  return order;
}

/**
 * @param {LayoutNode[]} nodes
 * @param {LayoutEdge[]} edges
 * @param {Map<string, number>} layerOf
 * @param {LayoutOptions} settings
 */
function buildLayers(nodes, edges, layerOf, settings) {
  const used = [...new Set(nodes.map(({ id }) => layerOf.get(id) ?? 0))];
  const count = Math.max(...used) + 1;
  /** @type {Vertex[][]} */
  const layers = Array.from({ length: count }, () => []);
  /** @type {Map<string, Vertex>} */
  const vertexOf = new Map();
  const add = (/** @type {Partial<Vertex> & { layer: number }} */ partial) => {
    const vertex = /** @type {Vertex} */ ({
      node: null, order: 0, width: 0, height: 0, y: 0, left: [], right: [], hook: null, anchor: null, ...partial,
    });
    layers[vertex.layer].push(vertex);
    return vertex;
  };
  for (const node of nodes) {
    const before = settings.previous?.nodes.get(node.id);
    const anchor = before ? before.y + before.height / 2 : null;
    const { width, height } = node;
    vertexOf.set(node.id, add({ node, layer: layerOf.get(node.id) ?? 0, width, height, anchor }));
  }
  /** @type {Chain[]} */
  const chains = [];
  for (const edge of edges) {
    const from = /** @type {Vertex} */ (vertexOf.get(edge.from));
    const to = /** @type {Vertex} */ (vertexOf.get(edge.to));
    const fromNode = /** @type {LayoutNode} */ (from.node);
    const toNode = /** @type {LayoutNode} */ (to.node);
    const outOffset = portY(fromNode, 'out', edge.fromPort) - from.height / 2;
    const inOffset = portY(toNode, 'in', edge.toPort) - to.height / 2;
    const isBackward = from.layer >= to.layer;
    const first = isBackward ? to.layer : from.layer + 1;
    const last = isBackward ? from.layer : to.layer - 1;
    /** @type {Vertex[]} */
    const bends = [];
    const labelled = edge.label ? Math.floor((first + last) / 2) : -1;
    /** @type {Vertex | null} */
    let label = null;
    for (let layer = first; layer <= last; layer += 1) {
      const size = layer === labelled && edge.label ? edge.label : { width: 0, height: 0 };
      const bend = add({ layer, width: size.width, height: size.height });
      if (layer === labelled) label = bend;
      bends.push(bend);
    }
    const link = (/** @type {Vertex} */ a, /** @type {Vertex} */ b, aOffset = 0, bOffset = 0, weight = 1) => {
      const made = { a, b, aOffset, bOffset, weight };
      a.right.push(made);
      b.left.push(made);
    };
    for (let index = 1; index < bends.length; index += 1) link(bends[index - 1], bends[index], 0, 0, 6);
    if (isBackward) {
      bends[0].hook = to;
      bends[bends.length - 1].hook = from;
      bends.reverse();
    } else if (bends.length === 0) {
      link(from, to, outOffset, inOffset);
    } else {
      link(from, bends[0], outOffset, 0, 2);
      link(bends[bends.length - 1], to, 0, inOffset, 2);
    }
    chains.push({ edge, bends, label, isBackward });
  }
  return { layers, chains, vertexOf };
}

/**
 * @param {Vertex[][]} layers
 * @param {Map<string, Vertex>} vertexOf
 * @param {Layout | undefined} previous
 */
function orderLayers(layers, vertexOf, previous) {
  const number = () => layers.forEach((layer) => layer.forEach((vertex, index) => { vertex.order = index; }));
  initialOrder(layers, vertexOf);
  number();
  let best = layers.map((layer) => [...layer]);
  let fewest = crossings(layers);
  for (let sweep = 0; sweep < SWEEPS && fewest > 0; sweep += 1) {
    const isForward = sweep % 2 === 0;
    for (let step = 1; step < layers.length; step += 1) {
      sortByBarycentre(layers[isForward ? step : layers.length - 1 - step], isForward ? 'left' : 'right');
    }
    exchange(layers);
    const now = crossings(layers);
    if (now < fewest) [best, fewest] = [layers.map((layer) => [...layer]), now];
  }
  layers.forEach((layer, index) => layer.splice(0, layer.length, ...best[index]));
  number();
  if (previous) keepOrder(layers);
  number();
}

/**
 * Depth first, so that what hangs together begins side by side.
 * @param {Vertex[][]} layers
 * @param {Map<string, Vertex>} vertexOf
 */
function initialOrder(layers, vertexOf) {
  /** @type {Set<Vertex>} */
  const seen = new Set();
  /** @type {Vertex[][]} */
  const ordered = layers.map(() => []);
  for (const start of [...vertexOf.values()].sort((a, b) => a.layer - b.layer)) {
    const stack = [start];
    while (stack.length > 0) {
      const vertex = /** @type {Vertex} */ (stack.pop());
      if (seen.has(vertex)) continue;
      seen.add(vertex);
      ordered[vertex.layer].push(vertex);
      for (const { b } of [...vertex.right].reverse()) stack.push(b);
    }
  }
  layers.forEach((layer, index) => {
    // Bends of backward edges hang on no node: each goes beside the one it turns around at.
    const rest = layer.filter((vertex) => !seen.has(vertex));
    layer.splice(0, layer.length, ...ordered[index], ...rest);
  });
}

/**
 * Nodes that were shown before get the order they had; what is new keeps its place between its neighbours.
 * @param {Vertex[][]} layers
 */
function keepOrder(layers) {
  for (const layer of layers) {
    const slots = layer.flatMap((vertex, index) => (vertex.anchor === null ? [] : [index]));
    const sorted = slots.map((index) => layer[index]).sort((a, b) => (a.anchor ?? 0) - (b.anchor ?? 0));
    slots.forEach((slot, index) => { layer[slot] = sorted[index]; });
  }
  layers.forEach((layer) => layer.forEach((vertex, index) => { vertex.order = index; }));
  // The others follow their neighbours again.
  for (const side of /** @type {const} */ (['left', 'right'])) {
    for (const layer of layers) {
      const position = new Map(layer.map((vertex) => [vertex, barycentre(vertex, side)]));
      for (const vertex of layer.filter(({ anchor }) => anchor === null)) {
        const wanted = position.get(vertex) ?? null;
        if (wanted === null) continue;
        layer.splice(layer.indexOf(vertex), 1);
        const index = layer.findIndex((other) => (position.get(other) ?? -Infinity) > wanted);
        layer.splice(index < 0 ? layer.length : index, 0, vertex);
      }
      layer.forEach((vertex, index) => { vertex.order = index; });
    }
  }
}

/**
 * @param {Vertex} vertex
 * @param {'left' | 'right'} side
 * @returns {number | null}
 */
function barycentre(vertex, side) {
  const links = vertex[side];
  if (links.length === 0) return null;
  let sum = 0;
  for (const link of links) {
    const [other, offset] = side === 'left' ? [link.a, link.aOffset] : [link.b, link.bOffset];
    sum += other.order + 0.9 * fraction(offset, other);
  }
  return sum / links.length;
}

/**
 * @param {Vertex[]} layer
 * @param {'left' | 'right'} side
 */
function sortByBarycentre(layer, side) {
  /** @type {Map<Vertex, number>} */
  const wanted = new Map();
  for (const vertex of layer) {
    const own = barycentre(vertex, side);
    if (own !== null) wanted.set(vertex, own);
  }
  for (const vertex of layer) {
    if (!vertex.hook || wanted.has(vertex)) continue;
    const beside = wanted.get(vertex.hook);
    if (beside !== undefined) wanted.set(vertex, beside + 1e-3);
  }
  const slots = layer.flatMap((vertex, index) => (wanted.has(vertex) ? [index] : []));
  const sorted = slots.map((index) => layer[index])
    .sort((a, b) => (wanted.get(a) ?? 0) - (wanted.get(b) ?? 0) || a.order - b.order);
  slots.forEach((slot, index) => { layer[slot] = sorted[index]; });
  layer.forEach((vertex, index) => { vertex.order = index; });
}

/**
 * Exchanges neighbours while that removes crossings.
 * @param {Vertex[][]} layers
 */
function exchange(layers) {
  for (let round = 0, improved = true; improved && round < 6; round += 1) {
    improved = false;
    for (const layer of layers) {
      for (let index = 1; index < layer.length; index += 1) {
        const [upper, lower] = [layer[index - 1], layer[index]];
        const asIs = pairCrossings(upper, lower);
        if (asIs === 0 || asIs <= pairCrossings(lower, upper)) continue;
        [layer[index - 1], layer[index]] = [lower, upper];
        [upper.order, lower.order] = [index, index - 1];
        improved = true;
      }
    }
  }
}

/**
 * @param {Vertex} upper
 * @param {Vertex} lower
 */
function pairCrossings(upper, lower) {
  let count = 0;
  for (const high of upper.right) for (const low of lower.right) if (isAbove(low, high, 'b')) count += 1;
  for (const high of upper.left) for (const low of lower.left) if (isAbove(low, high, 'a')) count += 1;
  return count;
}

/**
 * @param {Link} one
 * @param {Link} other
 * @param {'a' | 'b'} end
 */
function isAbove(one, other, end) {
  const offset = end === 'a' ? 'aOffset' : 'bOffset';
  return one[end].order < other[end].order || (one[end] === other[end] && one[offset] < other[offset]);
}

/**
 * How many pairs of links cross: inversions, counted with a tree of sums.
 * @param {Vertex[][]} layers
 */
function crossings(layers) {
  let count = 0;
  for (const layer of layers) {
    const links = layer.flatMap((vertex) => vertex.right);
    const place = (/** @type {Link} */ link) => link.b.order + 0.9 * fraction(link.bOffset, link.b);
    const places = [...new Set(links.map(place))].sort((a, b) => a - b);
    const rank = new Map(places.map((value, index) => [value, index + 1]));
    const tree = new Int32Array(places.length + 1);
    links.sort((one, other) => one.a.order - other.a.order || one.aOffset - other.aOffset);
    let inserted = 0;
    for (let begin = 0, end = 0; begin < links.length; begin = end) {
      // Links from the same place do not cross each other.
      while (end < links.length && links[end].a === links[begin].a && links[end].aOffset === links[begin].aOffset) end += 1;
      for (const link of links.slice(begin, end)) {
        count += inserted;
        for (let at = rank.get(place(link)) ?? 0; at > 0; at -= at & -at) count -= tree[at];
      }
      for (const link of links.slice(begin, end)) {
        inserted += 1;
        for (let at = rank.get(place(link)) ?? 1; at <= places.length; at += at & -at) tree[at] += 1;
      }
    }
  }
  return count;
}

/**
 * @param {number} offset from the vertex's centre
 * @param {Vertex} vertex
 */
function fraction(offset, vertex) {
  return vertex.height > 0 ? offset / vertex.height : 0;
}

/**
 * Each column in turn moves to where its neighbours pull it, as far as order and distances let it: a regression with least squares.
 * @param {Vertex[][]} layers
 * @param {Required<Omit<LayoutOptions, 'previous'>>} settings
 */
function placeVertices(layers, settings) {
  for (const layer of layers) {
    let at = 0;
    layer.forEach((vertex, index) => {
      at += index > 0 ? separation(layer[index - 1], vertex, settings) : 0;
      vertex.y = at;
    });
    for (const vertex of layer) vertex.y -= at / 2;
  }
  for (let round = 0; round < RELAXATIONS; round += 1) {
    const sides = round >= RELAXATIONS - 8 ? 'both' : round % 2 === 0 ? 'left' : 'right';
    const columns = round % 2 === 0 ? layers : [...layers].reverse();
    for (const layer of columns) relax(layer, sides, settings);
  }
}

/**
 * @param {Vertex[]} layer
 * @param {'left' | 'right' | 'both'} sides
 * @param {Required<Omit<LayoutOptions, 'previous'>>} settings
 */
function relax(layer, sides, settings) {
  /** @type {{ value: number, weight: number, count: number }[]} */
  const blocks = [];
  let shift = 0;
  /** @type {number[]} */
  const shifts = [];
  layer.forEach((vertex, index) => {
    if (index > 0) shift += separation(layer[index - 1], vertex, settings);
    shifts.push(shift);
    let [sum, weight] = [vertex.y * 0.05, 0.05];
    const pull = (/** @type {number} */ y, /** @type {number} */ by) => { sum += y * by; weight += by; };
    if (sides !== 'right') for (const { a, aOffset, bOffset, weight: by } of vertex.left) pull(a.y + aOffset - bOffset, by);
    if (sides !== 'left') for (const { b, aOffset, bOffset, weight: by } of vertex.right) pull(b.y + bOffset - aOffset, by);
    if (vertex.hook) pull(vertex.hook.y, 0.5);
    if (vertex.anchor !== null) pull(vertex.anchor, 40);
    let block = { value: sum / weight - shift, weight, count: 1 };
    while (blocks.length > 0 && blocks[blocks.length - 1].value > block.value) {
      const above = /** @type {typeof block} */ (blocks.pop());
      const total = above.weight + block.weight;
      const value = (above.value * above.weight + block.value * block.weight) / total;
      block = { value, weight: total, count: above.count + block.count };
    }
    blocks.push(block);
  });
  let index = 0;
  for (const { value, count } of blocks) {
    for (let i = 0; i < count; i += 1, index += 1) layer[index].y = value + shifts[index];
  }
}

/**
 * @param {Vertex} upper
 * @param {Vertex} lower
 * @param {Required<Omit<LayoutOptions, 'previous'>>} settings
 */
function separation(upper, lower, settings) {
  const gap = upper.node && lower.node ? settings.nodeGap : settings.edgeGap;
  return (upper.height + lower.height) / 2 + gap;
}

/**
 * @param {Vertex[][]} layers
 * @param {Chain[]} chains
 * @param {Map<string, Vertex>} vertexOf
 * @param {Required<Omit<LayoutOptions, 'previous'>>} settings
 * @returns {Layout}
 */
function route(layers, chains, vertexOf, settings) {
  /** @type {{ left: number, right: number, gap: number }[]} */
  const columns = [];
  let x = 0;
  const turns = layers.map((layer) => layer.filter(({ hook }) => hook).length);
  layers.forEach((layer, index) => {
    const width = Math.max(...layer.map((vertex) => vertex.width), 0);
    const links = layer.reduce((sum, vertex) => sum + vertex.right.length, 0);
    const gap = settings.columnGap + Math.min(70, 0.7 * links) + Math.min(40, 4 * ((turns[index] ?? 0) + (turns[index + 1] ?? 0)));
    // The first column leaves room at its left for edges that turn around there.
    if (index === 0 && turns[0] > 0) x = settings.columnGap / 2;
    columns.push({ left: x, right: x + width, gap });
    x += width + gap;
  });
  const lastTurns = turns[turns.length - 1] > 0 ? settings.columnGap / 2 : 0;
  const width = columns[columns.length - 1].right + lastTurns;
  let top = Infinity;
  let bottom = -Infinity;
  for (const layer of layers) {
    for (const vertex of layer) {
      top = Math.min(top, vertex.y - vertex.height / 2);
      bottom = Math.max(bottom, vertex.y + vertex.height / 2);
    }
  }
  /** @type {Layout} */
  const made = { nodes: new Map(), edges: new Map(), width, height: bottom - top };
  const box = (/** @type {Vertex} */ vertex) => {
    const { left } = columns[vertex.layer];
    const { width, height } = vertex;
    return { x: left, y: vertex.y - height / 2 - top, width, height };
  };
  for (const [id, vertex] of vertexOf) made.nodes.set(id, { ...box(vertex), layer: vertex.layer });
  for (const chain of chains) {
    const { edge, bends, label, isBackward } = chain;
    const from = /** @type {Vertex} */ (vertexOf.get(edge.from));
    const to = /** @type {Vertex} */ (vertexOf.get(edge.to));
    const [fromBox, toBox] = [box(from), box(to)];
    const y1 = fromBox.y + portY(/** @type {LayoutNode} */ (from.node), 'out', edge.fromPort);
    const y2 = toBox.y + portY(/** @type {LayoutNode} */ (to.node), 'in', edge.toPort);
    const start = fromBox.x + fromBox.width;
    const pen = new Pen(start, y1);
    const reach = (/** @type {number} */ gap, /** @type {number} */ dy) => Math.min(gap * 0.45, 14 + Math.abs(dy) * 0.22);
    if (isBackward) {
      const [fromColumn, toColumn] = [columns[from.layer], columns[to.layer]];
      pen.line(fromColumn.right, y1);
      const first = bends[0].y - top;
      pen.turn(fromColumn.right, first, reach(from.layer + 1 < columns.length ? fromColumn.gap : settings.columnGap, first - y1));
      bends.forEach((bend, index) => {
        if (index > 0) pen.curve(columns[bend.layer].right, bend.y - top);
        pen.line(columns[bend.layer].left, bend.y - top);
      });
      const gap = to.layer > 0 ? columns[to.layer - 1].gap : settings.columnGap;
      pen.turn(toColumn.left, y2, -reach(gap, y2 - pen.y));
    } else {
      pen.line(columns[from.layer].right, y1);
      for (const bend of bends) {
        pen.curve(columns[bend.layer].left, bend.y - top);
        pen.line(columns[bend.layer].right, bend.y - top);
      }
      pen.curve(columns[to.layer].left, y2);
    }
    pen.line(toBox.x, y2);
    made.edges.set(edge.id, { path: pen.path, points: pen.points, isBackward, ...(label ? { label: box(label) } : {}) });
  }
  return made;
}

/** Draws a path of lines and curves whose ends are horizontal. */
class Pen {
  /**
   * @param {number} x
   * @param {number} y
   */
  constructor(x, y) {
    this.x = x;
    this.y = y;
    this.path = `M${f(x)},${f(y)}`;
    /** @type {[number, number][]} */
    this.points = [[x, y]];
  }

  /**
   * @param {number} x
   * @param {number} y
   */
  line(x, y) {
    if (x === this.x && y === this.y) return;
    this.path += `L${f(x)},${f(y)}`;
    this.move(x, y);
  }

  /**
   * @param {number} x
   * @param {number} y
   */
  curve(x, y) {
    this.path += curve(this.x, this.y, x, y);
    this.move(x, y);
  }

  /**
   * Turns around; `reach` is positive to the right.
   * @param {number} x
   * @param {number} y
   * @param {number} reach
   */
  turn(x, y, reach) {
    this.path += `C${f(this.x + reach)},${f(this.y)} ${f(x + reach)},${f(y)} ${f(x)},${f(y)}`;
    this.points.push([x + reach * 0.75, (this.y + y) / 2]);
    this.move(x, y);
  }

  /**
   * @param {number} x
   * @param {number} y
   */
  move(x, y) {
    [this.x, this.y] = [x, y];
    this.points.push([x, y]);
  }
}

/**
 * @param {number} x1
 * @param {number} y1
 * @param {number} x2
 * @param {number} y2
 */
function curve(x1, y1, x2, y2) {
  const middle = (x1 + x2) / 2;
  return `C${f(middle)},${f(y1)} ${f(middle)},${f(y2)} ${f(x2)},${f(y2)}`;
}

/** @param {number} value */
function f(value) {
  return String(Math.round(value * 10) / 10);
}

/**
 * Puts unconnected parts beside and below each other. Parts that were shown before stay near their places.
 * @param {Layout[]} parts
 * @param {Required<Omit<LayoutOptions, 'previous'>> & LayoutOptions} settings
 * @returns {Layout}
 */
function pack(parts, settings) {
  const gap = 2 * settings.nodeGap;
  const area = parts.reduce((sum, part) => sum + (part.width + gap) * (part.height + gap), 0);
  const widest = Math.max(0, ...parts.map((part) => part.width));
  const wanted = Math.max(widest, Math.sqrt(area * settings.aspect));
  /** @type {{ part: Layout, x: number, y: number }[]} */
  const placed = [];
  const indexOf = new Map(parts.map((part, index) => [part, index]));
  const byHeight = [...parts].sort((a, b) => b.height - a.height || (indexOf.get(a) ?? 0) - (indexOf.get(b) ?? 0));
  const known = byHeight.map((part) => ({ part, offset: shiftFrom(part, settings.previous) }));
  for (const { part, offset } of known) if (offset) placed.push({ part, ...offset });
  separate(placed, gap);
  let shelf = { x: 0, y: Math.max(0, ...placed.map(({ part, y }) => y + part.height + gap)), height: 0 };
  for (const { part, offset } of known) {
    if (offset) continue;
    if (shelf.x > 0 && shelf.x + part.width > wanted) shelf = { x: 0, y: shelf.y + shelf.height + gap, height: 0 };
    placed.push({ part, x: shelf.x, y: shelf.y });
    shelf.x += part.width + gap;
    shelf.height = Math.max(shelf.height, part.height);
  }
  /** @type {Layout} */
  const all = { nodes: new Map(), edges: new Map(), width: 0, height: 0 };
  for (const { part, x, y } of placed) {
    for (const [id, node] of part.nodes) all.nodes.set(id, { ...node, x: node.x + x, y: node.y + y });
    for (const [id, edge] of part.edges) all.edges.set(id, moveRoute(edge, x, y));
    all.width = Math.max(all.width, x + part.width);
    all.height = Math.max(all.height, y + part.height);
  }
  return all;
}

/**
 * @param {Layout} part
 * @param {Layout | undefined} previous
 */
function shiftFrom(part, previous) {
  let [x, y, count] = [0, 0, 0];
  for (const [id, node] of part.nodes) {
    const before = previous?.nodes.get(id);
    if (!before) continue;
    x += before.x - node.x;
    y += before.y - node.y;
    count += 1;
  }
  return count === 0 ? null : { x: Math.max(0, x / count), y: Math.max(0, y / count) };
}

/**
 * Pushes parts down that overlap others.
 * @param {{ part: Layout, x: number, y: number }[]} placed
 * @param {number} gap
 */
function separate(placed, gap) {
  const sorted = [...placed].sort((a, b) => a.y - b.y);
  sorted.forEach((lower, index) => {
    for (let again = true; again;) {
      again = false;
      for (const upper of sorted.slice(0, index)) {
        const isBeside = lower.x >= upper.x + upper.part.width || upper.x >= lower.x + lower.part.width;
        const isBelow = lower.y >= upper.y + upper.part.height || upper.y >= lower.y + lower.part.height;
        if (isBeside || isBelow) continue;
        lower.y = upper.y + upper.part.height + gap;
        again = true;
      }
    }
  });
}

/**
 * Exchanges x and y.
 * @param {Layout} made
 * @returns {Layout}
 */
function transpose(made) {
  const turn = (/** @type {Box} */ box) => ({ ...box, x: box.y, y: box.x, width: box.height, height: box.width });
  /** @type {Layout['nodes']} */
  const nodes = new Map();
  for (const [id, box] of made.nodes) nodes.set(id, { ...turn(box), layer: box.layer });
  /** @type {Layout['edges']} */
  const edges = new Map();
  for (const [id, { path, points, isBackward, label }] of made.edges) {
    edges.set(id, {
      path: path.replace(/(-?[\d.]+),(-?[\d.]+)/g, '$2,$1'),
      points: points.map(([x, y]) => [y, x]),
      isBackward,
      ...(label ? { label: turn(label) } : {}),
    });
  }
  return { nodes, edges, width: made.height, height: made.width };
}

/**
 * @param {Route} edge
 * @param {number} x
 * @param {number} y
 * @returns {Route}
 */
function moveRoute(edge, x, y) {
  if (x === 0 && y === 0) return edge;
  let isX = false;
  const path = edge.path.replace(/-?\d+(\.\d+)?/g, (value) => {
    isX = !isX;
    return f(Number(value) + (isX ? x : y));
  });
  /** @type {[number, number][]} */
  const points = edge.points.map(([px, py]) => [px + x, py + y]);
  const label = edge.label && { ...edge.label, x: edge.label.x + x, y: edge.label.y + y };
  return { path, points, isBackward: edge.isBackward, ...(label ? { label } : {}) };
}
