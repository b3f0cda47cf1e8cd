// @ts-check
// The robot as a graph: modules with ports, wires between them.

import { GraphView } from '../graph/view.js';

/** @typedef {import('./asks.js').Doc} Doc */
/** @typedef {import('./asks.js').ShownPort} ShownPort */
/** @typedef {import('./asks.js').PortName} PortName */

/** @param {ShownPort} port */
export const isSource = (port) => port.does === 'publishes' || port.does === 'serves';

/** The last part of a type's name. @param {string} type */
export const shortType = (type) => type.replace(/<.*>/, '').split(/\/|::/).pop() ?? type;

/** Ports of a topic, a service and an action may have one name. @param {ShownPort} port */
const portId = (port) => `${port.is} ${port.name}`;
/** @param {string} id */
const portName = (id) => id.slice(id.indexOf(' ') + 1);

export class Canvas {
  /**
   * @param {HTMLElement} container
   * @param {{ select: (selection: { module: string } | { wire: number } | null) => void, edit: (edits: any[]) => void,
   *   remove: (module: string) => void, open: (module: string) => void, moved: (places: Record<string, { x: number, y: number }>) => void }} actions
   */
  constructor(container, actions) {
    this.actions = actions;
    /** @type {Doc | null} */
    this.doc = null;
    this.view = new GraphView(container, {
      label: 'Modules and wires',
      onSelect: (id) => actions.select(id === null ? null : { module: id }),
      onOpen: (id) => actions.open(id),
      onSelectEdge: (id) => { if (id !== null) actions.select({ wire: Number(id) }); },
      onRemove: (id) => actions.remove(id),
      onRemoveEdge: (id) => this.cut(Number(id)),
      onMove: () => actions.moved(this.places()),
      onConnect: (from, to) => actions.edit([{ op: 'connect', from: this.name(from), to: this.name(to) }]),
      refusal: (from, to) => this.refusal(from, to),
      layout: { nodeGap: 28, columnGap: 64 },
    });
  }

  /** @param {{ node: string, port: string }} port @returns {PortName} */
  name({ node, port }) { return { module: node, port: portName(port) }; }

  /** @param {{ node: string, port: string }} ref @param {boolean} isOut */
  find({ node, port }, isOut) {
    return this.doc?.picture.modules.find(({ name }) => name === node)?.ports.find((known) => portId(known) === port && isSource(known) === isOut);
  }

  /** @param {{ node: string, port: string }} from @param {{ node: string, port: string }} to */
  refusal(from, to) {
    const [source, sink] = [this.find(from, true), this.find(to, false)];
    if (!source || !sink) return 'There is no such port.';
    if (source.is !== sink.is) return `${source.name} is a ${source.is}, ${sink.name} a ${sink.is}.`;
    if (source.type !== sink.type) return `${source.name} carries ${source.type}, ${sink.name} takes ${sink.type}.`;
    return null;
  }

  /** @param {number} index */
  cut(index) {
    const wire = this.doc?.picture.wires[index];
    if (wire) this.actions.edit([{ op: 'disconnect', to: wire.to }]);
  }

  /** Places of all modules. */
  places() {
    return Object.fromEntries([...this.view.positions()].map(([id, { x, y }]) => [id, { x, y }]));
  }

  /** @param {Doc} doc */
  show(doc) {
    this.doc = doc;
    const { modules, wires, problems, topics } = doc.picture;
    const exposed = new Set(topics.filter((topic) => topic.is_exposed).map((topic) => `${topic.is} ${topic.name}`));
    const wired = new Set(wires.flatMap((wire) => [`o ${wire.is} ${wire.from.module} ${wire.from.port}`, `i ${wire.is} ${wire.to.module} ${wire.to.port}`]));
    const worst = (/** @type {string} */ name) => {
      const own = problems.filter((problem) => problem.module === name);
      return own.some(({ severity }) => severity === 'error') ? 'error' : own.length > 0 ? 'late' : undefined;
    };
    const nodes = modules.map((module) => {
      const tone = worst(module.name);
      const lines = module.kind === module.name ? [] : [module.kind];
      const badge = tone === 'error' ? '! wrong' : tone === 'late' ? 'unfed' : module.profile?.is_emulated ? 'emulated' : undefined;
      return {
        id: module.name,
        kind: 'module',
        title: module.name,
        lines,
        badge,
        // In the order of what is seen.
        description: [module.name, ...lines, badge, 'module'].filter(Boolean).join(', '),
        tone: /** @type {any} */ (tone),
        isDouble: (module.given.synchrony ?? module.profile?.runs) === 'detached',
        width: 150,
        ports: module.ports.map((port) => {
          const isOut = isSource(port);
          const isRenamed = port.topic !== port.name;
          const mark = exposed.has(`${port.is} ${port.topic}`) ? ' · ROS' : '';
          const text = isRenamed ? (isOut ? `${port.name} → ${port.topic}` : `${port.topic} → ${port.name}`) : port.name;
          const hasWire = wired.has(`${isOut ? 'o' : 'i'} ${port.is} ${module.name} ${port.name}`);
          return {
            id: portId(port),
            side: /** @type {'in' | 'out'} */ (isOut ? 'out' : 'in'),
            label: `${text}${mark}`,
            type: `${port.does} ${port.is === 'topic' ? '' : `${port.is} `}${port.type}`,
            description: `${text}${mark}, ${module.name} ${port.does} this ${port.is}, ${shortType(port.type)}${hasWire ? '' : ', not connected'}`,
          };
        }),
      };
    });
    const edges = wires.map((wire, index) => ({
      id: String(index),
      from: wire.from.module,
      to: wire.to.module,
      fromPort: `${wire.is} ${wire.from.port}`,
      toPort: `${wire.is} ${wire.to.port}`,
      isDashed: wire.is !== 'topic',
      tone: /** @type {any} */ (wire.is_sound ? undefined : 'error'),
      weight: 1.6,
    }));
    const places = Object.entries(doc.layout);
    this.view.show({ nodes, edges }, places.length > 0 ? { positions: new Map(places) } : {});
  }
}
