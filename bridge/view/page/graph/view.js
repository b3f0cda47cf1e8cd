// @ts-check
/**
 * Draws a graph as SVG: zoom, pan, selection, keyboard, ports with wires that are dragged.
 *
 * ```js
 * const view = new GraphView(element, { label: 'Modules and topics', onSelect: (id) => show(id) });
 * view.show({
 *   nodes: [{ id: 'm:walk', kind: 'module', title: 'walk', lines: ['125 Hz'] }, { id: 't:imu', kind: 'topic', title: 'imu' }],
 *   edges: [{ id: 'e1', from: 't:imu', to: 'm:walk' }],
 * });
 * view.update('m:walk', { lines: ['124 Hz'], tone: 'late', badge: '! late' });
 * view.destroy();
 * ```
 *
 * Keys: arrows go to the nearest node in that direction, Enter selects, Escape clears the selection, `+` and `-` zoom, `0` shows
 * all, Shift with arrows pans; Alt with arrows moves a node where nodes are movable. Tab goes on to the ports of the current node:
 * Enter begins a wire there, arrows go through the ports that it may end at, Enter connects, Escape gives up.
 *
 * @module
 */

import { directPath, layout, portY } from './layout.js';

/** @typedef {'ok' | 'late' | 'failed' | 'held' | 'restarting' | 'idle' | 'new' | 'error'} Tone */
/** @typedef {{ id: string, side: 'in' | 'out', label: string, type?: string, tone?: Tone, description?: string }} Port */
/**
 * @typedef {object} ViewNode
 * @property {string} id
 * @property {string} kind 'module', 'topic', 'service', 'outlet' or another one, drawn as a box; becomes a class
 * @property {string} title
 * @property {string[]} [lines] below the title
 * @property {string} [value] at the right of the title of a node without lines
 * @property {string} [badge] a word or two at the upper right
 * @property {Tone} [tone]
 * @property {number} [meter] 0 to 1, a bar at the lower edge
 * @property {boolean} [isDouble] has a second border
 * @property {boolean} [isFaint] drawn paler
 * @property {Port[]} [ports]
 * @property {string} [description] what a screen reader says; the texts otherwise
 * @property {number} [width] at least as wide as the texts otherwise
 */
/**
 * @typedef {object} ViewEdge
 * @property {string} id
 * @property {string} from
 * @property {string} to
 * @property {string} [fromPort]
 * @property {string} [toPort]
 * @property {string} [label]
 * @property {boolean} [isDashed]
 * @property {boolean} [isFaint]
 * @property {number} [weight] width of the line, 1 by default
 * @property {Tone} [tone]
 */
/** @typedef {{ node: string, port: string }} PortRef */
/**
 * @typedef {object} GraphViewOptions
 * @property {string} label what a screen reader calls the graph
 * @property {(id: string | null) => void} [onSelect]
 * @property {(id: string) => void} [onOpen] a double click, or Enter on the selected node
 * @property {(id: string | null) => void} [onSelectEdge] makes edges selectable
 * @property {(id: string) => void} [onRemove] Delete on a node
 * @property {(id: string) => void} [onRemoveEdge] Delete on the selected edge
 * @property {(id: string, x: number, y: number) => void} [onMove] makes nodes movable
 * @property {(from: PortRef, to: PortRef) => void} [onConnect] makes wires draggable, from an 'out' port to an 'in' port
 * @property {(from: PortRef, to: PortRef) => string | null} [refusal] why a wire may not be, or null
 * @property {'right' | 'down' | 'fitting'} [direction] where edges lead, 'right' by default; 'fitting' takes the direction
 *   in which more can be read in the place that there is
 * @property {import('./layout.js').LayoutOptions} [layout]
 */

const SVG = 'http://www.w3.org/2000/svg';
const TITLE = 18;
const LINE = 15;
const PORT = 20;
const FAR = 0.5;
/** Below this, not even names can be read. */
const READABLE = 0.26;
const [LEAST_ZOOM, MOST_ZOOM] = [0.08, 3];
/** @type {Record<string, [number, number]>} */
const DIRECTIONS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

/** Adds the stylesheet of a module beside it, once. */
export function loadStyle(/** @type {string | URL} */ url) {
  const href = new URL(url, document.baseURI).href;
  if ([...document.styleSheets].some((sheet) => sheet.href === href)) return;
  if (document.querySelector(`link[href="${href}"]`)) return;
  const link = document.createElement('link');
  link.rel = 'stylesheet';
  link.href = href;
  document.head.append(link);
}

/** @typedef {{ node: ViewNode, box: import('./layout.js').Box, ports: import('./layout.js').LayoutPort[], group: SVGGElement, body: SVGGElement }} Drawn */
/** @typedef {{ edge: ViewEdge, group: SVGGElement, line: SVGPathElement, hit: SVGPathElement | null, arrow: SVGPathElement, label: SVGGElement | null }} DrawnEdge */

export class GraphView {
  /**
   * @param {HTMLElement} container
   * @param {GraphViewOptions} options
   */
  constructor(container, options) {
    loadStyle(new URL('./graph.css', import.meta.url));
    this.options = options;
    /** @type {Map<string, Drawn>} */
    this.drawn = new Map();
    /** @type {Map<string, DrawnEdge>} */
    this.drawnEdges = new Map();
    /** @type {import('./layout.js').Layout | undefined} */
    this.placed = undefined;
    /** @type {string | null} */
    this.selected = null;
    /** @type {string | null} */
    this.selectedEdge = null;
    /** @type {string | null} */
    this.current = null;
    /** What is drawn clearly while the rest is pale. @type {{ nodes: Set<string>, edges: Set<string> } | null} */
    this.found = null;
    this.isManual = false;
    /** @type {'right' | 'down'} */
    this.direction = 'right';
    /** How large the graph is in each direction. */
    this.extents = { right: { width: 1, height: 1 }, down: { width: 1, height: 1 } };
    this.scale = { k: 1, x: 0, y: 0 };
    this.hasMoved = false;
    /** @type {{ from: PortRef & { side: 'in' | 'out' }, end: [number, number] } | null} */
    this.wire = null;
    /** @type {Map<number, [number, number]>} */
    this.pointers = new Map();

    this.root = document.createElement('div');
    this.root.className = 'graph-view';
    this.svg = svg('svg', { class: 'graph-canvas', role: 'group', 'aria-label': options.label, 'aria-roledescription': 'graph' });
    this.world = svg('g', { class: 'graph-world' });
    this.edgeLayer = svg('g', { class: 'graph-edges', 'aria-hidden': 'true' });
    this.nodeLayer = svg('g', { class: 'graph-nodes' });
    this.wireLine = svg('path', { class: 'graph-wire', 'aria-hidden': 'true' });
    this.world.append(this.edgeLayer, this.nodeLayer, this.wireLine);
    this.svg.append(this.world);
    this.spoken = document.createElement('div');
    this.spoken.className = 'graph-spoken';
    this.spoken.setAttribute('role', 'status');
    this.buttons = document.createElement('div');
    this.buttons.className = 'graph-buttons';
    for (const [text, label, action] of /** @type {[string, string, () => void][]} */ ([
      ['+', 'Zoom in', () => this.zoomBy(1.3)],
      ['−', 'Zoom out', () => this.zoomBy(1 / 1.3)],
      ['⤢', 'Show all', () => this.fit()],
    ])) {
      const button = document.createElement('button');
      button.type = 'button';
      button.textContent = text;
      button.title = label;
      button.setAttribute('aria-label', label);
      button.addEventListener('click', action);
      this.buttons.append(button);
    }
    this.root.append(this.svg, this.buttons, this.spoken);
    container.append(this.root);

    this.svg.addEventListener('pointerdown', (event) => this.pointerDown(event));
    this.svg.addEventListener('keydown', (event) => this.keyDown(event));
    this.svg.addEventListener('focusin', (event) => this.focusIn(event));
    this.svg.addEventListener('dblclick', (event) => {
      const id = nodeOf(event.target);
      if (id) this.options.onOpen?.(id);
    });
    this.svg.addEventListener('wheel', (event) => {
      event.preventDefault();
      const [x, y] = this.local(event);
      this.zoomAt(Math.exp(-event.deltaY * (event.ctrlKey ? 0.01 : 0.0016)), x, y);
    }, { passive: false });
    /** @type {{ nodes: ViewNode[], edges: ViewEdge[] } | null} */
    this.graph = null;
    this.resize = new ResizeObserver(() => {
      if (this.graph && !this.isManual && this.fitting() !== this.direction) this.show(this.graph, { keepPlaces: false });
      else if (!this.hasMoved) this.fit(true);
    });
    this.resize.observe(this.svg);
  }

  /**
   * Shows a graph. What was shown before keeps its place as far as possible; the selection stays if its node does.
   * @param {{ nodes: ViewNode[], edges: ViewEdge[] }} graph
   * @param {{ positions?: Map<string, { x: number, y: number }>, keepPlaces?: boolean }} [places] upper left corners chosen by hand:
   *   then edges go directly from port to port, and nodes without a position get one below the others
   */
  show(graph, places = {}) {
    const sized = graph.nodes.map((node) => ({ node, ...sizeOf(node) }));
    const layoutNodes = sized.map(({ node, width, height, ports }) => ({ id: node.id, width, height, ports }));
    const layoutEdges = graph.edges.map((edge) => ({
      ...edge,
      label: edge.label ? { width: textWidth(edge.label, 11) + 12, height: 18 } : undefined,
    }));
    this.isManual = places.positions !== undefined;
    /** @type {Partial<Record<'right' | 'down', import('./layout.js').Layout>>} */
    const fresh = {};
    if (this.options.direction === 'fitting' && !this.isManual) {
      for (const side of /** @type {const} */ (['right', 'down'])) {
        fresh[side] = layout({ nodes: layoutNodes, edges: layoutEdges }, { ...this.options.layout, direction: side });
        this.extents[side] = fresh[side];
      }
    }
    const direction = this.fitting();
    const before = places.keepPlaces === false || direction !== this.direction ? undefined : this.placed;
    this.direction = direction;
    this.graph = graph;
    const placed = (before && !this.isManual ? undefined : fresh[direction]) ?? layout({ nodes: layoutNodes, edges: layoutEdges }, { ...this.options.layout, direction, ...(before && !this.isManual ? { previous: before } : {}) });
    if (places.positions) placeByHand(placed, places.positions);
    this.placed = placed;

    const ids = new Set(graph.nodes.map(({ id }) => id));
    for (const [id, { group }] of this.drawn) {
      if (ids.has(id)) continue;
      group.remove();
      this.drawn.delete(id);
    }
    const hadNodes = this.drawn.size > 0;
    for (const { node, ports } of sized) {
      const box = /** @type {import('./layout.js').Box} */ (placed.nodes.get(node.id));
      let drawn = this.drawn.get(node.id);
      if (!drawn) {
        const group = svg('g', { 'data-node': node.id });
        const body = svg('g', { class: 'graph-body', role: 'button', tabindex: '-1', 'data-node': node.id });
        group.append(body);
        drawn = { node, box, ports, group, body };
        this.drawn.set(node.id, drawn);
      }
      this.nodeLayer.append(drawn.group);
      Object.assign(drawn, { node, box, ports });
      this.drawNode(drawn);
    }
    for (const { group } of this.drawnEdges.values()) group.remove();
    this.drawnEdges.clear();
    for (const edge of graph.edges) if (ids.has(edge.from) && ids.has(edge.to)) this.drawEdge(edge);
    if (this.selected && !ids.has(this.selected)) this.select(null);
    if (this.selectedEdge && !this.drawnEdges.has(this.selectedEdge)) this.selectEdge(null);
    if (!this.current || !ids.has(this.current)) this.current = graph.nodes[0]?.id ?? null;
    this.markCurrent();
    this.markSelection();
    this.markFound();
    if (!hadNodes || !this.hasMoved) this.fit(true);
  }

  /**
   * Changes what a node shows without moving anything.
   * @param {string} id
   * @param {Partial<Omit<ViewNode, 'id' | 'ports' | 'width'>>} changes
   */
  update(id, changes) {
    const drawn = this.drawn.get(id);
    if (!drawn) return;
    const node = drawn.node;
    const isSame = Object.entries(changes).every(([key, value]) => {
      const old = node[/** @type {keyof ViewNode} */ (key)];
      return Array.isArray(value) ? String(old) === String(value) : old === value;
    });
    if (isSame) return;
    drawn.node = { ...node, ...changes };
    this.drawNode(drawn);
  }

  /**
   * @param {string} id
   * @param {Partial<Pick<ViewEdge, 'weight' | 'tone' | 'isFaint'>>} changes
   */
  updateEdge(id, changes) {
    const drawn = this.drawnEdges.get(id);
    if (!drawn) return;
    drawn.edge = { ...drawn.edge, ...changes };
    styleEdge(drawn);
  }

  /**
   * @param {string | null} id
   * @param {{ quiet?: boolean }} [how]
   */
  select(id, { quiet = false } = {}) {
    if (this.selected === id) return;
    this.selected = id;
    if (id) {
      this.current = id;
      this.selectedEdge = null;
      this.markCurrent();
    }
    this.markSelection();
    if (!quiet) this.options.onSelect?.(id);
  }

  /** @param {string | null} id */
  selectEdge(id) {
    if (this.selectedEdge === id) return;
    this.selectedEdge = id;
    if (id && this.selected) this.select(null);
    this.markSelection();
    this.options.onSelectEdge?.(id);
  }

  /**
   * Draws these nodes and edges clearly and the others paler, until the next call; all alike with null.
   * @param {Set<string> | null} nodes @param {Set<string>} [edges]
   */
  highlight(nodes, edges = new Set()) {
    this.found = nodes && { nodes, edges };
    this.root.classList.toggle('is-searching', nodes !== null);
    this.markFound();
  }

  markFound() {
    for (const [id, { group }] of this.drawn) group.classList.toggle('is-found', this.found?.nodes.has(id) ?? false);
    for (const [id, { group }] of this.drawnEdges) group.classList.toggle('is-found', this.found?.edges.has(id) ?? false);
  }

  /** Brings a node into view and gives it the keyboard's focus. */
  focus(/** @type {string} */ id) {
    const drawn = this.drawn.get(id);
    if (!drawn) return;
    this.current = id;
    this.markCurrent();
    drawn.body.focus({ preventScroll: true });
    this.reveal(id);
  }

  /** Pans until the node is in view. */
  reveal(/** @type {string} */ id) {
    const box = this.drawn.get(id)?.box;
    if (!box) return;
    const { k } = this.scale;
    const { width, height } = this.size();
    const margin = 24;
    const [left, top] = [box.x * k + this.scale.x, box.y * k + this.scale.y];
    const [right, bottom] = [left + box.width * k, top + box.height * k];
    if (left < margin) this.scale.x += margin - left;
    else if (right > width - margin) this.scale.x += width - margin - right;
    if (top < margin) this.scale.y += margin - top;
    else if (bottom > height - margin) this.scale.y += height - margin - bottom;
    this.applyScale();
  }

  /** Where edges lead in this place. @returns {'right' | 'down'} */
  fitting() {
    const { direction = 'right' } = this.options;
    if (direction !== 'fitting') return direction;
    const { width, height } = this.size();
    if (width === 0 || height === 0) return this.direction;
    const scale = (/** @type {{ width: number, height: number }} */ extent) => Math.min(1, width / extent.width, height / extent.height);
    // What is shown is kept unless the other direction is clearly better.
    const bias = this.direction === 'down' ? 0.9 : 1.2;
    return scale(this.extents.down) > scale(this.extents.right) * bias ? 'down' : 'right';
  }

  /** Shows the whole graph, as large as it can be; its beginning where `isReadable` and the whole would be too small to read. */
  fit(isReadable = false) {
    const { width, height } = this.size();
    if (!this.placed || width === 0 || height === 0) return;
    const bounds = this.bounds();
    const margin = 20;
    const whole = Math.min((width - 2 * margin) / Math.max(1, bounds.width), (height - 2 * margin) / Math.max(1, bounds.height));
    const k = Math.min(1.15, Math.max(isReadable ? READABLE : LEAST_ZOOM, whole));
    const begin = (/** @type {number} */ space, /** @type {number} */ extent) => Math.max(isReadable ? margin : -Infinity, (space - extent * k) / 2);
    this.scale = { k, x: begin(width, bounds.width) - bounds.x * k, y: begin(height, bounds.height) - bounds.y * k };
    this.hasMoved = false;
    this.applyScale();
  }

  /** @param {number} factor */
  zoomBy(factor) {
    const { width, height } = this.size();
    this.zoomAt(factor, width / 2, height / 2);
  }

  /** The middle of what is in view, in the graph's own coordinates: a place for a new node. */
  centre() {
    const { width, height } = this.size();
    const { k, x, y } = this.scale;
    return { x: (width / 2 - x) / k, y: (height / 2 - y) / k };
  }

  /** The graph's coordinates of a point of the screen. */
  toGraph(/** @type {{ clientX: number, clientY: number }} */ event) {
    const [x, y] = this.local(event);
    return { x: (x - this.scale.x) / this.scale.k, y: (y - this.scale.y) / this.scale.k };
  }

  /** Where the nodes are: upper left corners and sizes. */
  positions() {
    return new Map([...this.drawn].map(([id, { box }]) => [id, { ...box }]));
  }

  destroy() {
    this.resize.disconnect();
    this.root.remove();
  }

  // Drawing

  /** @param {Drawn} drawn */
  drawNode({ node, box, ports, group, body }) {
    const marks = ['is-near', 'is-selected', 'is-found'].filter((mark) => group.classList.contains(mark));
    group.setAttribute('class', classes('graph-node', `kind-${node.kind}`, node.tone && `tone-${node.tone}`, node.isFaint && 'is-faint', ...marks));
    group.setAttribute('transform', `translate(${box.x},${box.y})`);
    body.setAttribute('aria-roledescription', node.kind);
    // The texts are the name otherwise.
    if (node.description !== undefined) body.setAttribute('aria-label', node.description);
    else body.removeAttribute('aria-label');
    /** @type {Part[]} */
    const parts = [];
    if (node.isDouble) parts.push(part('path', { class: 'graph-outer', d: shape(node.kind, -3, -3, box.width + 6, box.height + 6) }));
    parts.push(part('path', { class: 'graph-shape', d: shape(node.kind, 0, 0, box.width, box.height) }));
    const inset = insetOf(node.kind);
    const isRow = !node.lines?.length && !node.ports?.length;
    const baseline = isRow ? box.height / 2 + 4.5 : 19;
    parts.push(label('graph-title', inset, baseline, node.title));
    if (node.value !== undefined) parts.push(label('graph-value', box.width - inset, baseline, node.value, 'end'));
    (node.lines ?? []).forEach((line, index) => parts.push(label('graph-line', inset, 19 + LINE * (index + 1) + 1, line)));
    if (node.badge) {
      const width = textWidth(node.badge, 10.5, 650) + 12;
      parts.push(part('rect', { class: 'graph-badge', x: box.width - width - 6, y: 6, width, height: 17, rx: 8.5 }));
      parts.push(label('graph-badge-text', box.width - 12, 18, node.badge, 'end'));
    }
    if (node.meter !== undefined) {
      const width = box.width - 2 * inset;
      parts.push(part('rect', { class: 'graph-track', x: inset, y: box.height - 9, width, height: 3, rx: 1.5 }));
      parts.push(part('rect', { class: 'graph-meter', x: inset, y: box.height - 9, width: Math.max(1.5, width * Math.min(1, node.meter)), height: 3, rx: 1.5 }));
    }
    patch(body, parts);
    if (node.ports) this.drawPorts({ node, box, ports, group, body });
    else for (const port of group.querySelectorAll(':scope > .graph-port')) port.remove();
  }

  /** @param {Drawn} drawn */
  drawPorts({ node, box, ports, group }) {
    const focused = document.activeElement?.closest('.graph-port');
    const had = focused && group.contains(focused) ? portOf(focused) : null;
    for (const port of group.querySelectorAll(':scope > .graph-port')) port.remove();
    for (const port of node.ports ?? []) {
      const y = ports.find(({ id, side }) => id === port.id && side === port.side)?.y ?? box.height / 2;
      const isIn = port.side === 'in';
      const label = port.description ?? `${isIn ? 'input' : 'output'} ${port.label} of ${node.title}${port.type ? `, ${port.type}` : ''}`;
      const element = svg('g', {
        class: classes('graph-port', `side-${port.side}`, port.tone && `tone-${port.tone}`),
        transform: `translate(${isIn ? 0 : box.width},${y})`,
        role: 'button', tabindex: this.current === node.id ? '0' : '-1', 'aria-label': label,
        'data-node': node.id, 'data-port': port.id, 'data-side': port.side,
      });
      const title = svg('title');
      title.textContent = port.type ? `${port.label}: ${port.type}` : port.label;
      element.append(
        title,
        svg('circle', { class: 'graph-port-hit', r: 11 }),
        svg('circle', { class: 'graph-port-dot', r: 5 }),
        text('graph-port-label', isIn ? 11 : -11, 4, port.label, isIn ? 'start' : 'end'),
      );
      group.append(element);
      if (had?.port === port.id && had.side === port.side) element.focus({ preventScroll: true });
    }
  }

  /** @param {ViewEdge} edge */
  drawEdge(edge) {
    const group = svg('g', { 'data-edge': edge.id });
    const line = svg('path', { class: 'graph-line-path' });
    const arrow = svg('path', { class: 'graph-arrow' });
    const hit = this.options.onSelectEdge ? svg('path', { class: 'graph-hit' }) : null;
    if (hit) group.append(hit);
    group.append(line, arrow);
    /** @type {SVGGElement | null} */
    let label = null;
    const box = this.placed?.edges.get(edge.id)?.label;
    if (edge.label && box && !this.isManual) {
      label = svg('g', { class: 'graph-edge-label', transform: `translate(${box.x},${box.y})` });
      label.append(svg('rect', { width: box.width, height: box.height, rx: 9 }), text('', box.width / 2, 12.5, edge.label, 'middle'));
      group.append(label);
    }
    const drawn = { edge, group, line, hit, arrow, label };
    this.drawnEdges.set(edge.id, drawn);
    this.edgeLayer.append(group);
    this.traceEdge(drawn);
    styleEdge(drawn);
  }

  /** @param {DrawnEdge} drawn */
  traceEdge({ edge, line, hit, arrow }) {
    const [from, to] = [this.drawn.get(edge.from), this.drawn.get(edge.to)];
    if (!from || !to) return;
    const route = this.isManual ? undefined : this.placed?.edges.get(edge.id);
    if (route && this.direction === 'down') {
      const [x, y] = [to.box.x + to.box.width / 2, to.box.y];
      line.setAttribute('d', route.path);
      hit?.setAttribute('d', route.path);
      arrow.setAttribute('d', `M${x - 4},${y - 7}L${x},${y}L${x + 4},${y - 7}Z`);
      return;
    }
    const y2 = to.box.y + portY({ ...to.box, id: '', ports: to.ports }, 'in', edge.toPort);
    const x2 = to.box.x - (edge.toPort === undefined ? 0 : 5);
    const y1 = from.box.y + portY({ ...from.box, id: '', ports: from.ports }, 'out', edge.fromPort);
    const path = route?.path ?? directPath([from.box.x + from.box.width, y1], [x2, y2]);
    line.setAttribute('d', path);
    hit?.setAttribute('d', path);
    arrow.setAttribute('d', `M${x2 - 7},${y2 - 4}L${x2},${y2}L${x2 - 7},${y2 + 4}Z`);
  }

  markCurrent() {
    for (const [id, { group, body }] of this.drawn) {
      const tabIndex = id === this.current ? '0' : '-1';
      body.setAttribute('tabindex', tabIndex);
      for (const port of group.querySelectorAll(':scope > .graph-port')) port.setAttribute('tabindex', tabIndex);
    }
  }

  markSelection() {
    /** @type {Set<string>} */
    const near = new Set();
    for (const [id, { edge, group }] of this.drawnEdges) {
      const isNear = this.selected !== null && (edge.from === this.selected || edge.to === this.selected);
      if (isNear) near.add(edge.from).add(edge.to);
      group.classList.toggle('is-near', isNear);
      group.classList.toggle('is-selected', id === this.selectedEdge);
    }
    this.root.classList.toggle('has-selection', this.selected !== null);
    for (const [id, { group, body }] of this.drawn) {
      group.classList.toggle('is-selected', id === this.selected);
      group.classList.toggle('is-near', near.has(id));
      body.setAttribute('aria-pressed', String(id === this.selected));
    }
  }

  // Zoom and pan

  size() {
    return { width: this.svg.clientWidth, height: this.svg.clientHeight };
  }

  bounds() {
    let [left, top, right, bottom] = [0, 0, this.isManual ? 1 : this.placed?.width ?? 1, this.isManual ? 1 : this.placed?.height ?? 1];
    if (this.isManual && this.drawn.size > 0) [left, top, right, bottom] = [Infinity, Infinity, -Infinity, -Infinity];
    for (const { box } of this.drawn.values()) {
      left = Math.min(left, box.x);
      top = Math.min(top, box.y);
      right = Math.max(right, box.x + box.width);
      bottom = Math.max(bottom, box.y + box.height);
    }
    return { x: left, y: top, width: right - left, height: bottom - top };
  }

  applyScale() {
    const { k, x, y } = this.scale;
    this.world.setAttribute('transform', `translate(${x},${y}) scale(${k})`);
    this.root.classList.toggle('is-far', k < FAR);
  }

  /**
   * @param {number} factor
   * @param {number} x
   * @param {number} y
   */
  zoomAt(factor, x, y) {
    const k = Math.min(MOST_ZOOM, Math.max(LEAST_ZOOM, this.scale.k * factor));
    const by = k / this.scale.k;
    this.scale = { k, x: x - (x - this.scale.x) * by, y: y - (y - this.scale.y) * by };
    this.hasMoved = true;
    this.applyScale();
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  pan(dx, dy) {
    this.scale.x += dx;
    this.scale.y += dy;
    this.hasMoved = true;
    this.applyScale();
  }

  /**
   * @param {{ clientX: number, clientY: number }} event
   * @returns {[number, number]}
   */
  local(event) {
    const { left, top } = this.svg.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  // Pointers

  /** @param {PointerEvent} event */
  pointerDown(event) {
    if (event.button !== 0) return;
    const start = /** @type {[number, number]} */ ([event.clientX, event.clientY]);
    this.pointers.set(event.pointerId, start);
    const target = event.target instanceof Element ? event.target : null;
    const port = this.options.onConnect ? portOf(target) : null;
    const id = nodeOf(target);
    const edge = target?.closest('[data-edge]')?.getAttribute('data-edge') ?? null;
    const drawn = id ? this.drawn.get(id) : undefined;
    const origin = drawn ? { ...drawn.box } : null;
    let hasDragged = false;
    if (port) this.beginWire(port);
    const move = (/** @type {PointerEvent} */ moved) => {
      const last = this.pointers.get(moved.pointerId);
      if (!last) return;
      const at = /** @type {[number, number]} */ ([moved.clientX, moved.clientY]);
      const [dx, dy] = [at[0] - last[0], at[1] - last[1]];
      if (!hasDragged && Math.hypot(at[0] - start[0], at[1] - start[1]) < 4) return;
      hasDragged = true;
      this.pointers.set(moved.pointerId, at);
      if (this.pointers.size === 2) {
        const other = [...this.pointers].find(([pointer]) => pointer !== moved.pointerId)?.[1] ?? at;
        const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
        const now = Math.hypot(at[0] - other[0], at[1] - other[1]);
        const [x, y] = this.local({ clientX: (at[0] + other[0]) / 2, clientY: (at[1] + other[1]) / 2 });
        this.pan(dx / 2, dy / 2);
        if (before > 0) this.zoomAt(now / before, x, y);
      } else if (this.wire) {
        const { x, y } = this.toGraph(moved);
        this.wire.end = [x, y];
        this.drawWire();
        this.markTarget(portOf(document.elementFromPoint(moved.clientX, moved.clientY)));
      } else if (drawn && origin && this.options.onMove) {
        const { k } = this.scale;
        this.moveNode(drawn, origin.x + (at[0] - start[0]) / k, origin.y + (at[1] - start[1]) / k);
      } else {
        this.pan(dx, dy);
      }
    };
    const end = (/** @type {PointerEvent} */ ended) => {
      if (ended.pointerId !== event.pointerId) return;
      this.pointers.delete(event.pointerId);
      removeEventListener('pointermove', move);
      removeEventListener('pointerup', end);
      removeEventListener('pointercancel', end);
      this.root.classList.remove('is-dragging');
      const isCancelled = ended.type === 'pointercancel';
      if (this.wire && hasDragged) {
        this.endWire(isCancelled ? null : portOf(document.elementFromPoint(ended.clientX, ended.clientY)));
      } else if (this.wire && port) {
        // A click on a port leaves the wire open: a click or Enter on another port ends it.
        this.speak(`Wire from ${port.port}: choose where it ends`);
      } else if (this.wire) {
        this.endWire(null);
      } else if (port) {
        return;
      } else if (hasDragged && drawn && this.options.onMove) {
        this.options.onMove(drawn.node.id, drawn.box.x, drawn.box.y);
      } else if (!hasDragged && !isCancelled) {
        if (id) this.select(id);
        else if (edge && this.options.onSelectEdge) this.selectEdge(edge);
        else {
          this.select(null);
          this.selectEdge(null);
        }
      }
    };
    addEventListener('pointermove', move);
    addEventListener('pointerup', end);
    addEventListener('pointercancel', end);
    this.root.classList.add('is-dragging');
  }

  /**
   * @param {Drawn} drawn
   * @param {number} x
   * @param {number} y
   */
  moveNode(drawn, x, y) {
    [drawn.box.x, drawn.box.y] = [Math.round(x), Math.round(y)];
    drawn.group.setAttribute('transform', `translate(${drawn.box.x},${drawn.box.y})`);
    for (const edge of this.drawnEdges.values()) {
      if (edge.edge.from !== drawn.node.id && edge.edge.to !== drawn.node.id) continue;
      this.placed?.edges.delete(edge.edge.id);
      this.traceEdge(edge);
    }
  }

  // Wires

  /** @param {PortRef & { side: 'in' | 'out' }} port */
  beginWire(port) {
    if (this.wire) return this.endWire(port);
    this.wire = { from: port, end: this.portPlace(port) };
    this.root.classList.add('is-wiring');
    for (const [id, { node, group }] of this.drawn) {
      for (const element of group.querySelectorAll(':scope > .graph-port')) {
        const other = /** @type {PortRef & { side: 'in' | 'out' }} */ (portOf(element));
        const isSame = other.node === port.node && other.port === port.port && other.side === port.side;
        element.classList.toggle('is-possible', this.mayConnect(port, other) === null && !isSame);
        element.classList.toggle('is-origin', isSame && id === node.id);
      }
    }
    this.drawWire();
  }

  /** @param {(PortRef & { side: 'in' | 'out' }) | null} port */
  endWire(port) {
    const begun = this.wire?.from;
    this.wire = null;
    this.wireLine.removeAttribute('d');
    this.root.classList.remove('is-wiring');
    for (const element of this.nodeLayer.querySelectorAll('.graph-port')) element.classList.remove('is-possible', 'is-target', 'is-origin');
    if (!begun || !port || (begun.node === port.node && begun.port === port.port && begun.side === port.side)) return;
    const refusal = this.mayConnect(begun, port);
    if (refusal !== null) {
      this.speak(refusal);
      this.showRefusal(refusal);
      return;
    }
    const [from, to] = begun.side === 'out' ? [begun, port] : [port, begun];
    this.options.onConnect?.({ node: from.node, port: from.port }, { node: to.node, port: to.port });
  }

  /**
   * @param {PortRef & { side: 'in' | 'out' }} one
   * @param {PortRef & { side: 'in' | 'out' }} other
   * @returns {string | null}
   */
  mayConnect(one, other) {
    if (one.side === other.side) return 'A wire goes from an output to an input.';
    const [from, to] = one.side === 'out' ? [one, other] : [other, one];
    return this.options.refusal?.({ node: from.node, port: from.port }, { node: to.node, port: to.port }) ?? null;
  }

  /** @param {(PortRef & { side: 'in' | 'out' }) | null} port */
  markTarget(port) {
    for (const element of this.nodeLayer.querySelectorAll('.graph-port.is-target')) element.classList.remove('is-target');
    if (port) this.portElement(port)?.classList.add('is-target');
  }

  drawWire() {
    if (!this.wire) return;
    const { from, end } = this.wire;
    const place = this.portPlace(from);
    this.wireLine.setAttribute('d', from.side === 'out' ? directPath(place, end) : directPath(end, place));
  }

  /**
   * @param {PortRef & { side: 'in' | 'out' }} port
   * @returns {[number, number]}
   */
  portPlace({ node, port, side }) {
    const drawn = this.drawn.get(node);
    if (!drawn) return [0, 0];
    const y = drawn.box.y + portY({ ...drawn.box, id: '', ports: drawn.ports }, side, port);
    return [drawn.box.x + (side === 'out' ? drawn.box.width : 0), y];
  }

  /**
   * @param {PortRef & { side: 'in' | 'out' }} port
   * @returns {SVGGElement | null}
   */
  portElement({ node, port, side }) {
    const { group } = this.drawn.get(node) ?? {};
    const ports = /** @type {SVGGElement[]} */ ([...(group?.querySelectorAll(':scope > .graph-port') ?? [])]);
    return ports.find((element) => element.getAttribute('data-port') === port && element.getAttribute('data-side') === side) ?? null;
  }

  /** @param {string} words */
  showRefusal(words) {
    const note = document.createElement('div');
    note.className = 'graph-refusal';
    note.textContent = words;
    this.root.append(note);
    setTimeout(() => note.remove(), 4000);
  }

  /** @param {string} words */
  speak(words) {
    this.spoken.textContent = words;
  }

  // Keyboard

  /** @param {FocusEvent} event */
  focusIn(event) {
    const id = nodeOf(event.target);
    if (!id || id === this.current) return;
    this.current = id;
    this.markCurrent();
  }

  /** @param {KeyboardEvent} event */
  keyDown(event) {
    const handled = this.press(event);
    if (handled) {
      event.preventDefault();
      event.stopPropagation();
    }
  }

  /** @param {KeyboardEvent} event */
  press(event) {
    if (event.ctrlKey || event.metaKey) return false;
    const port = portOf(event.target);
    const direction = DIRECTIONS[event.key];
    if (event.key === 'Escape') {
      if (this.wire) this.endWire(null);
      else if (this.selected || this.selectedEdge) {
        this.select(null);
        this.selectEdge(null);
      } else return false;
      return true;
    }
    if (event.key === '+' || event.key === '=') return this.zoomBy(1.3), true;
    if (event.key === '-') return this.zoomBy(1 / 1.3), true;
    if (event.key === '0') return this.fit(), true;
    if (event.key === 'Delete' || event.key === 'Backspace') {
      if (this.selectedEdge && this.options.onRemoveEdge) return this.options.onRemoveEdge(this.selectedEdge), true;
      if (this.current && this.options.onRemove && !port) return this.options.onRemove(this.current), true;
      return false;
    }
    if (port && this.options.onConnect) {
      if (event.key === 'Enter' || event.key === ' ') {
        const isNew = this.wire === null;
        this.beginWire(port);
        if (isNew) this.speak(`Wire from ${port.port}. Arrows choose where it ends, Enter connects, Escape gives up.`);
        return true;
      }
      if (direction) {
        this.nextPort(port, direction[0] + direction[1]);
        return true;
      }
      return false;
    }
    const drawn = this.current ? this.drawn.get(this.current) : undefined;
    if (direction && event.shiftKey) return this.pan(-60 * direction[0], -60 * direction[1]), true;
    if (direction && event.altKey && drawn && this.options.onMove) {
      this.moveNode(drawn, drawn.box.x + 20 * direction[0], drawn.box.y + 20 * direction[1]);
      this.options.onMove(drawn.node.id, drawn.box.x, drawn.box.y);
      this.reveal(drawn.node.id);
      return true;
    }
    if (direction) {
      const next = this.neighbour(direction);
      if (next) this.focus(next);
      return true;
    }
    if ((event.key === 'Enter' || event.key === ' ') && this.current) {
      if (this.selected === this.current && event.key === 'Enter' && this.options.onOpen) this.options.onOpen(this.current);
      else this.select(this.current);
      return true;
    }
    return false;
  }

  /**
   * The nearest node in a direction; what an edge leads to counts as nearer.
   * @param {[number, number]} direction
   * @returns {string | null}
   */
  neighbour([dx, dy]) {
    const here = this.current ? this.drawn.get(this.current)?.box : undefined;
    if (!here) return this.drawn.keys().next().value ?? null;
    const linked = new Set([...this.drawnEdges.values()].flatMap(({ edge }) =>
      edge.from === this.current ? [edge.to] : edge.to === this.current ? [edge.from] : []));
    let best = null;
    let least = Infinity;
    for (const [id, { box }] of this.drawn) {
      if (id === this.current) continue;
      const x = box.x + box.width / 2 - here.x - here.width / 2;
      const y = box.y + box.height / 2 - here.y - here.height / 2;
      const along = x * dx + y * dy;
      const across = Math.abs(x * dy + y * dx);
      // Columns touch at no point: a step to the left or right leaves the column.
      const isBeyond = dx !== 0 ? along > (here.width + box.width) / 2 : along > 4 && Math.abs(x) < (here.width + box.width) / 2;
      if (!isBeyond) continue;
      const cost = (along + across * 2) * (dx !== 0 && linked.has(id) ? 0.35 : 1);
      if (cost < least) [best, least] = [id, cost];
    }
    return best;
  }

  /**
   * While a wire is open: the next port that it may end at. Otherwise the next one of the same node.
   * @param {PortRef & { side: 'in' | 'out' }} port
   * @param {number} step
   */
  nextPort(port, step) {
    const elements = /** @type {SVGGElement[]} */ ([...this.nodeLayer.querySelectorAll('.graph-port')]);
    const here = this.portElement(port);
    const candidates = elements.filter((element) => element === here ||
      (this.wire ? element.classList.contains('is-possible') : element.getAttribute('data-node') === port.node));
    const index = here ? candidates.indexOf(here) : -1;
    const next = candidates[(index + step + candidates.length) % candidates.length];
    const ref = next && portOf(next);
    if (!ref) return;
    this.current = ref.node;
    this.markCurrent();
    next.focus({ preventScroll: true });
    this.reveal(ref.node);
    if (this.wire) {
      this.wire.end = this.portPlace(ref);
      this.drawWire();
      this.markTarget(ref);
    }
  }
}

/** @param {DrawnEdge} drawn */
function styleEdge({ edge, group, line }) {
  const marks = ['is-near', 'is-selected', 'is-found'].filter((mark) => group.classList.contains(mark));
  group.setAttribute('class', classes('graph-edge', edge.tone && `tone-${edge.tone}`, edge.isDashed && 'is-dashed', edge.isFaint && 'is-faint', ...marks));
  line.setAttribute('stroke-width', String(edge.weight ?? 1.25));
}

/**
 * @param {import('./layout.js').Layout} placed
 * @param {Map<string, { x: number, y: number }>} positions
 */
function placeByHand(placed, positions) {
  let bottom = -Infinity;
  let left = Infinity;
  for (const [id, box] of placed.nodes) {
    const place = positions.get(id);
    if (!place) continue;
    [box.x, box.y] = [place.x, place.y];
    bottom = Math.max(bottom, box.y + box.height);
    left = Math.min(left, box.x);
  }
  if (!Number.isFinite(bottom)) return;
  let x = left;
  for (const [id, box] of placed.nodes) {
    if (positions.has(id)) continue;
    [box.x, box.y] = [x, bottom + 40];
    x += box.width + 40;
  }
}

/** @param {ViewNode} node */
function sizeOf(node) {
  const ins = (node.ports ?? []).filter(({ side }) => side === 'in');
  const outs = (node.ports ?? []).filter(({ side }) => side === 'out');
  const lines = node.lines?.length ?? 0;
  const portRows = Math.max(ins.length, outs.length);
  const head = TITLE + 10 + lines * LINE;
  const isRow = lines === 0 && portRows === 0;
  const height = isRow ? 26 : head + portRows * PORT + (portRows > 0 ? 6 : 4) + (node.meter === undefined ? 0 : 6);
  const inset = insetOf(node.kind);
  const title = textWidth(node.title, 13, 600) + (node.badge ? textWidth(node.badge, 10.5, 650) + 20 : 0);
  const value = node.value === undefined ? 0 : Math.max(52, textWidth(node.value, 11)) + 10;
  let width = Math.max(title + value, ...(node.lines ?? []).map((line) => textWidth(line, 11))) + 2 * inset;
  for (let row = 0; row < portRows; row += 1) {
    width = Math.max(width, textWidth(ins[row]?.label ?? '', 11.5) + textWidth(outs[row]?.label ?? '', 11.5) + 44);
  }
  /** @type {import('./layout.js').LayoutPort[]} */
  const ports = [ins, outs].flatMap((side) => side.map((port, row) => ({ id: port.id, side: port.side, y: head + PORT * row + PORT / 2 })));
  return { width: Math.ceil(Math.max(width, node.width ?? 0)), height, ports };
}

/** @param {string} kind */
function insetOf(kind) {
  return kind === 'topic' || kind === 'topics' ? 13 : kind === 'service' || kind === 'outlet' ? 16 : 11;
}

/**
 * @param {string} kind
 * @param {number} x
 * @param {number} y
 * @param {number} width
 * @param {number} height
 */
function shape(kind, x, y, width, height) {
  const [right, bottom, middle] = [x + width, y + height, y + height / 2];
  switch (kind) {
    case 'service': {
      const cut = 10;
      return `M${x + cut},${y}H${right - cut}L${right},${middle}L${right - cut},${bottom}H${x + cut}L${x},${middle}Z`;
    }
    case 'outlet':
      return `M${x},${y}H${right - 10}L${right},${middle}L${right - 10},${bottom}H${x}L${x + 8},${middle}Z`;
    default: {
      const r = kind === 'topic' || kind === 'topics' ? height / 2 : 7;
      return `M${x + r},${y}H${right - r}A${r},${r} 0 0 1 ${right},${y + r}V${bottom - r}A${r},${r} 0 0 1 ${right - r},${bottom}` +
        `H${x + r}A${r},${r} 0 0 1 ${x},${bottom - r}V${y + r}A${r},${r} 0 0 1 ${x + r},${y}Z`;
    }
  }
}

/** @type {CanvasRenderingContext2D | null} */
let ruler = null;
/** @type {Map<string, number>} */
const measured = new Map();

/**
 * @param {string} words
 * @param {number} size in pixels
 * @param {number} [weight]
 */
function textWidth(words, size, weight = 400) {
  const key = `${weight} ${size} ${words}`;
  const known = measured.get(key);
  if (known !== undefined) return known;
  ruler ??= document.createElement('canvas').getContext('2d');
  if (!ruler) return words.length * size * 0.58;
  ruler.font = `${weight} ${size}px system-ui, sans-serif`;
  const { width } = ruler.measureText(words);
  // Live figures would fill it.
  if (measured.size > 2000) measured.clear();
  measured.set(key, width);
  return width;
}

/** @param {EventTarget | null} target */
function nodeOf(target) {
  return target instanceof Element ? target.closest('[data-node]')?.getAttribute('data-node') ?? null : null;
}

/**
 * @param {EventTarget | null} target
 * @returns {(PortRef & { side: 'in' | 'out' }) | null}
 */
function portOf(target) {
  const element = target instanceof Element ? target.closest('.graph-port') : null;
  const node = element?.getAttribute('data-node');
  const port = element?.getAttribute('data-port');
  const side = element?.getAttribute('data-side');
  return node && port && (side === 'in' || side === 'out') ? { node, port, side } : null;
}

/** @typedef {{ name: 'path' | 'rect' | 'text', attributes: Record<string, string | number>, words: string }} Part */

/**
 * @param {Part['name']} name
 * @param {Record<string, string | number>} attributes
 * @returns {Part}
 */
function part(name, attributes, words = '') {
  return { name, attributes, words };
}

/**
 * @param {string} className
 * @param {number} x
 * @param {number} y
 * @param {string} words
 * @param {'start' | 'end'} [anchor]
 */
function label(className, x, y, words, anchor = 'start') {
  return part('text', { class: className, x, y, 'text-anchor': anchor }, words);
}

/**
 * Changes what differs, so that what is under a pointer stays the same element.
 * @param {SVGGElement} body
 * @param {Part[]} parts
 */
function patch(body, parts) {
  const isSame = body.children.length === parts.length && parts.every(({ name }, index) => body.children[index].localName === name);
  if (!isSame) body.replaceChildren(...parts.map(({ name }) => svg(name)));
  parts.forEach(({ attributes, words }, index) => {
    const element = body.children[index];
    for (const [key, value] of Object.entries(attributes)) {
      if (element.getAttribute(key) !== String(value)) element.setAttribute(key, String(value));
    }
    // The blank keeps words apart that are read one after the other.
    if (words && element.textContent !== `${words} `) element.textContent = `${words} `;
  });
}

/**
 * @template {keyof SVGElementTagNameMap} K
 * @param {K} name
 * @param {Record<string, string | number>} [attributes]
 * @returns {SVGElementTagNameMap[K]}
 */
function svg(name, attributes = {}) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, String(value));
  return element;
}

/**
 * @param {string} className
 * @param {number} x
 * @param {number} y
 * @param {string} words
 * @param {'start' | 'middle' | 'end'} [anchor]
 */
function text(className, x, y, words, anchor = 'start') {
  const element = svg('text', { class: className, x, y, 'text-anchor': anchor });
  element.textContent = words;
  return element;
}

/** @param {...(string | false | null | undefined)} names */
function classes(...names) {
  return names.filter(Boolean).join(' ');
}
