// @ts-check
// What was detected in a picture, as shapes in its pixels. One reader per message type: to show another type, add its reader here, or
// call `registerOverlay` from the script of a panel.

/**
 * @typedef {{ kind: 'polygon' | 'line' | 'circle' | 'points' | 'text', points: number[][], radius?: number, text?: string, color?: string }} Shape
 * @typedef {(message: any, width: number, height: number) => Shape[]} Reader  `width` and `height` are those of the picture
 */

/** @type {Map<string, Reader>} */
const readers = new Map();

/** @param {string} schemaName such as `vision_msgs/msg/Detection2DArray` @param {Reader} reader */
export function registerOverlay(schemaName, reader) { readers.set(schemaName, reader); }
/** @param {string} schemaName */
export const overlayOf = (schemaName) => readers.get(schemaName);

/** `center` is a `vision_msgs/Pose2D` or, before version 4, a `geometry_msgs/Pose2D`. @param {any} box @returns {number[][]} */
function corners({ center, size_x: width, size_y: height }) {
  const { x, y } = center.position ?? center;
  const [c, s] = [Math.cos(center.theta ?? 0), Math.sin(center.theta ?? 0)];
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
    const [u, v] = [(a * width) / 2, (b * height) / 2];
    return [x + u * c - v * s, y + u * s + v * c];
  });
}
/** @param {any} result @returns {string} */
function label(result) {
  const hypothesis = result?.hypothesis ?? result;
  if (!hypothesis) return '';
  const name = hypothesis.class_id ?? hypothesis.id ?? '';
  return Number.isFinite(hypothesis.score) ? `${name} ${Math.round(hypothesis.score * 100)} %` : String(name);
}
/** @param {any} detection @returns {Shape} */
const detection2d = (detection) => ({ kind: 'polygon', points: corners(detection.bbox), text: label(detection.results[0]) || detection.id });
registerOverlay('vision_msgs/msg/Detection2D', (message) => [detection2d(message)]);
registerOverlay('vision_msgs/msg/Detection2DArray', ({ detections }) => detections.map(detection2d));
registerOverlay('vision_msgs/msg/BoundingBox2DArray', ({ boxes }) => boxes.map((/** @type {any} */ box) => ({ kind: 'polygon', points: corners(box) })));

// ros-sports/soccer_interfaces: objects in the picture.
/** @param {any} confidence */
const share = (confidence) => {
  const level = typeof confidence === 'object' && confidence ? confidence.confidence : confidence;
  return Number.isFinite(level) && level >= 0 ? ` ${Math.round(level * 100)} %` : '';
};
/** @param {string} name @param {(item: any) => any} boxOf @returns {(item: any) => Shape} */
const boxed = (name, boxOf) => (item) => ({ kind: 'polygon', points: corners(boxOf(item)), text: name + share(item.confidence) });
registerOverlay('soccer_vision_2d_msgs/msg/BallArray', ({ balls }) => balls.map(boxed('ball', (ball) => ball.bb)));
registerOverlay('soccer_vision_2d_msgs/msg/RobotArray', ({ robots }) => robots.map(boxed('robot', (robot) => robot.bb)));
registerOverlay('soccer_vision_2d_msgs/msg/ObstacleArray', ({ obstacles }) => obstacles.map(boxed('obstacle', (obstacle) => obstacle.bb)));
registerOverlay('soccer_vision_2d_msgs/msg/GoalpostArray', ({ posts }) => posts.map(boxed('post', (post) => post.bb)));
registerOverlay('soccer_vision_2d_msgs/msg/MarkingArray', ({ ellipses = [], intersections = [], segments = [] }) => [
  ...segments.map((/** @type {any} */ s) => ({ kind: 'line', points: [[s.start.x, s.start.y], [s.end.x, s.end.y]] })),
  ...intersections.map((/** @type {any} */ i) => ({ kind: 'points', points: [[i.center.x, i.center.y]], text: `${i.num_rays} lines` })),
  ...ellipses.map((/** @type {any} */ e) => ({ kind: 'polygon', points: corners(e.bb ?? { center: e.center, size_x: e.size_x, size_y: e.size_y }) })),
]);
registerOverlay('soccer_vision_2d_msgs/msg/FieldBoundary', ({ points }) => [{ kind: 'line', points: points.map((/** @type {any} */ { x, y }) => [x, y]) }]);

registerOverlay('visualization_msgs/msg/ImageMarker', (marker) => {
  const { r, g, b } = marker.outline_color;
  const color = `rgb(${[r, g, b].map((part) => Math.round(part * 255)).join(' ')})`;
  const points = marker.points.map((/** @type {any} */ { x, y }) => [x, y]);
  const pairs = () => Array.from({ length: points.length >> 1 }, (_, i) => ({ kind: /** @type {const} */ ('line'), points: points.slice(2 * i, 2 * i + 2), color }));
  switch (marker.type) {
    case 0: return [{ kind: 'circle', points: [[marker.position.x, marker.position.y]], radius: marker.scale, color }];
    case 1: return [{ kind: 'line', points, color }];
    case 2: return pairs();
    case 3: return [{ kind: 'polygon', points, color }];
    case 4: return [{ kind: 'points', points, color }];
    default: return [];
  }
});
