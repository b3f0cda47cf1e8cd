// @ts-check
// Draws meshes with flat shadows, thick lines, points and the ground, in WebGL 2.

import { product } from './math.js';

/**
 * @typedef {import('./meshes.js').Mesh} Mesh
 * @typedef {{ mesh: Mesh, model: Float32Array, color: number[] }} Item
 * @typedef {{ length: number, width: number, line: number, mark: number, circle: number, area: number[], goal: number, height: number }} Field
 *   a football field; lengths in m
 * @typedef {{ sky: number[], ground: number[], grid: number[], field: number[], line: number[] }} Colors
 * @typedef {{ view: Float32Array, projection: Float32Array, eye: number[], focus: number[] }} Camera
 */

const MESH_VERTEX = `#version 300 es
uniform mat4 camera, model;
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
out vec3 world, facing;
void main() {
  vec4 at = model * vec4(position, 1.0);
  world = at.xyz;
  facing = transpose(inverse(mat3(model))) * normal;
  gl_Position = camera * at;
}`;
const MESH_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 color;
uniform vec3 eye, sky;
in vec3 world, facing;
out vec4 result;
void main() {
  vec3 n = normalize(facing), to = normalize(eye - world);
  if (dot(n, to) < 0.0) n = -n;
  float key = max(dot(n, normalize(vec3(0.45, 0.3, 1.0))), 0.0);
  float fill = max(dot(n, normalize(vec3(-0.6, -0.5, 0.25))), 0.0);
  float rim = pow(1.0 - max(dot(n, to), 0.0), 3.0);
  float shine = pow(max(dot(n, normalize(to + normalize(vec3(0.45, 0.3, 1.0)))), 0.0), 40.0);
  vec3 light = color.rgb * (0.42 + 0.14 * n.z + 0.58 * key + 0.16 * fill) + sky * rim * 0.16 + shine * 0.10;
  result = vec4(light, 1.0) * color.a;
}`;
const SHADOW_FRAGMENT = `#version 300 es
precision highp float;
uniform vec4 color;
in vec3 world, facing;
out vec4 result;
void main() { result = vec4(0.0, 0.0, 0.0, color.a); }`;
const GROUND_VERTEX = `#version 300 es
uniform mat4 camera;
uniform vec3 focus;
uniform float reach;
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  at = focus.xy + corner * reach;
  gl_Position = camera * vec4(at, 0.0, 1.0);
}`;
const GROUND_FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 eye, focus, sky, ground, grid, field, white;
uniform vec2 size, area;
uniform float reach, thick, mark, circle, hasField, hasGrid;
in vec2 at;
out vec4 result;
float lines(float step, float width) {
  vec2 pixel = fwidth(at), off = abs(fract(at / step - 0.5) - 0.5) * step;
  vec2 share = clamp((width * pixel - off) / pixel + 0.5, 0.0, 1.0) * (1.0 - smoothstep(step * 0.12, step * 0.4, pixel));
  return max(share.x, share.y);
}
float along(float distance, float beyond) { return max(abs(distance), beyond + thick * 0.5); }
float painted() {
  vec2 p = abs(at), half_size = size * 0.5;
  float h = thick * 0.5;
  float d = along(p.y - half_size.y + h, p.x - half_size.x);
  d = min(d, along(p.x - half_size.x + h, p.y - half_size.y));
  d = min(d, along(p.x, p.y - half_size.y));
  d = min(d, along(p.x - half_size.x + area.x - h, p.y - area.y * 0.5));
  d = min(d, along(p.y - area.y * 0.5 + h, max(half_size.x - area.x - p.x, p.x - half_size.x)));
  d = min(d, abs(length(p) - circle * 0.5));
  d = min(d, min(length(p - vec2(half_size.x - mark, 0.0)), length(p)) - h);
  float pixel = length(fwidth(at)) * 0.7;
  return clamp((h - d) / pixel + 0.5, 0.0, 1.0) * min(1.0, thick / pixel);
}
void main() {
  float away = length(at - focus.xy) / reach;
  vec3 color = ground;
  if (hasField > 0.5) {
    vec2 out_of = abs(at) - size * 0.5 - 0.7;
    float inside = 1.0 - smoothstep(0.0, 0.05, max(out_of.x, out_of.y));
    color = mix(color, field, inside);
  }
  if (hasGrid > 0.5) {
    float strength = hasField > 0.5 ? 0.22 : 1.0;
    color = mix(color, grid, max(lines(1.0, 0.8) * 0.85, lines(0.1, 0.5) * 0.4) * strength);
  }
  if (hasField > 0.5) color = mix(color, white, painted());
  result = vec4(mix(color, sky, smoothstep(0.25, 1.0, away)), 1.0);
}`;
const LINE_VERTEX = `#version 300 es
uniform mat4 camera;
uniform vec2 screen;
layout(location = 0) in vec3 a;
layout(location = 1) in vec3 b;
layout(location = 2) in vec4 color;
layout(location = 3) in float width;
out vec4 tint;
void main() {
  vec4 p = camera * vec4(a, 1.0), q = camera * vec4(b, 1.0);
  const float near = 0.01;
  if (p.w < near && q.w < near) { gl_Position = vec4(2.0, 2.0, 2.0, 1.0); return; }
  if (p.w < near) p = mix(p, q, (near - p.w) / (q.w - p.w));
  if (q.w < near) q = mix(q, p, (near - q.w) / (p.w - q.w));
  vec2 along = (q.xy / q.w - p.xy / p.w) * screen;
  vec2 across = length(along) > 0.0 ? normalize(vec2(-along.y, along.x)) : vec2(0.0, 1.0);
  bool second = (gl_VertexID & 1) == 1;
  vec4 here = second ? q : p;
  float side = gl_VertexID >> 1 == 0 ? -1.0 : 1.0;
  here.xy += across * side * width / screen * here.w;
  here.z -= 0.0004 * here.w;
  tint = color;
  gl_Position = here;
}`;
const POINT_VERTEX = `#version 300 es
uniform mat4 camera;
uniform vec2 screen;
layout(location = 0) in vec3 a;
layout(location = 2) in vec4 color;
layout(location = 3) in float width;
out vec4 tint;
void main() {
  gl_Position = camera * vec4(a, 1.0);
  gl_PointSize = clamp(width * screen.y / gl_Position.w, 2.0, 40.0);
  tint = color;
}`;
const FLAT_FRAGMENT = `#version 300 es
precision mediump float;
in vec4 tint;
out vec4 result;
void main() { result = vec4(tint.rgb * tint.a, tint.a); }`;

/** Numbers per line: two ends, a colour, a width in pixels. Points have the same, without the second end. */
const LINE = 11;
const SHADOW_LIGHT = [0.45, 0.3, 1.0];

export class Renderer {
  /** @param {HTMLCanvasElement} canvas @throws {Error} if the browser has no WebGL 2 */
  constructor(canvas) {
    const gl = canvas.getContext('webgl2', { antialias: true, stencil: true, alpha: false, powerPreference: 'high-performance' });
    if (!gl) throw new Error('this browser has no WebGL 2');
    this.gl = gl;
    this.canvas = canvas;
    this.programs = {
      mesh: program(gl, MESH_VERTEX, MESH_FRAGMENT), shadow: program(gl, MESH_VERTEX, SHADOW_FRAGMENT),
      ground: program(gl, GROUND_VERTEX, GROUND_FRAGMENT), line: program(gl, LINE_VERTEX, FLAT_FRAGMENT), point: program(gl, POINT_VERTEX, FLAT_FRAGMENT),
    };
    /** @type {Map<Mesh, { vao: WebGLVertexArrayObject, buffers: WebGLBuffer[], count: number, isIndexed: boolean, isUsed: boolean }>} */
    this.meshes = new Map();
    /** @type {WebGLSync | null} */
    this.fence = null;
    this.sinceMs = 0;
    /** How long pictures take, in the mean. */
    this.tookMs = 16;
    this.lineBuffer = gl.createBuffer();
    this.vaos = [0, 1].map((divisor) => {
      const vao = gl.createVertexArray();
      gl.bindVertexArray(vao);
      gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
      [[0, 3, 0], [1, 3, 3], [2, 4, 6], [3, 1, 10]].forEach(([location, size, offset]) => {
        gl.enableVertexAttribArray(location);
        gl.vertexAttribPointer(location, size, gl.FLOAT, false, LINE * 4, offset * 4);
        gl.vertexAttribDivisor(location, divisor);
      });
      return vao;
    });
    gl.bindVertexArray(null);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /**
   * Draws a picture.
   * @param {Camera} camera @param {Colors} colors @param {{ items: Item[], lines: number[], points: number[], field: Field | null, hasGrid: boolean, reach: number }} scene
   */
  draw(camera, colors, { items, lines, points, field, hasGrid, reach }) {
    const { gl, canvas, programs } = this;
    const both = product(camera.projection, camera.view);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(colors.sky[0], colors.sky[1], colors.sky[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);

    // The ground is first and behind everything that lies on it.
    const ground = programs.ground;
    gl.useProgram(ground.program);
    gl.uniformMatrix4fv(ground.at('camera'), false, both);
    gl.uniform3fv(ground.at('focus'), camera.focus);
    gl.uniform1f(ground.at('reach'), reach);
    for (const [name, color] of /** @type {[string, number[]][]} */ ([['sky', colors.sky], ['ground', colors.ground], ['grid', colors.grid], ['field', colors.field], ['white', colors.line]])) {
      gl.uniform3f(ground.at(name), color[0], color[1], color[2]);
    }
    gl.uniform1f(ground.at('hasField'), field ? 1 : 0);
    gl.uniform1f(ground.at('hasGrid'), hasGrid ? 1 : 0);
    if (field) {
      gl.uniform2f(ground.at('size'), field.length, field.width);
      gl.uniform2f(ground.at('area'), field.area[0], field.area[1]);
      gl.uniform1f(ground.at('thick'), field.line);
      gl.uniform1f(ground.at('mark'), field.mark);
      gl.uniform1f(ground.at('circle'), field.circle);
    }
    gl.bindVertexArray(null);
    gl.depthMask(false);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.depthMask(true);

    this.shadows(items, both);
    gl.useProgram(programs.mesh.program);
    gl.uniformMatrix4fv(programs.mesh.at('camera'), false, both);
    gl.uniform3fv(programs.mesh.at('eye'), camera.eye);
    gl.uniform3f(programs.mesh.at('sky'), colors.sky[0], colors.sky[1], colors.sky[2]);
    const opaque = items.filter(({ color }) => color[3] >= 0.99);
    for (const item of opaque) this.mesh(item, programs.mesh);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    for (const item of items) if (item.color[3] < 0.99) this.mesh(item, programs.mesh);
    gl.depthMask(true);

    for (const [numbers, kind, vao] of /** @type {[number[], 'line' | 'point', WebGLVertexArrayObject][]} */ ([[lines, 'line', this.vaos[1]], [points, 'point', this.vaos[0]]])) {
      if (numbers.length === 0) continue;
      gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(numbers), gl.STREAM_DRAW);
      gl.useProgram(programs[kind].program);
      gl.uniformMatrix4fv(programs[kind].at('camera'), false, both);
      gl.uniform2f(programs[kind].at('screen'), canvas.width, canvas.height);
      gl.bindVertexArray(vao);
      if (kind === 'line') gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, numbers.length / LINE);
      else gl.drawArrays(gl.POINTS, 0, numbers.length / LINE);
    }
    gl.bindVertexArray(null);
    this.forgetUnused();
    if (this.fence) gl.deleteSync(this.fence);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    this.sinceMs = performance.now();
    gl.flush();
  }

  /** True until the last picture is complete: pictures that queue up would hold the whole page. */
  isBusy() {
    const { gl, fence } = this;
    if (!fence || gl.isContextLost()) return false;
    if (gl.getSyncParameter(fence, gl.SYNC_STATUS) !== gl.SIGNALED && performance.now() - this.sinceMs < 2000) return true;
    this.tookMs = this.tookMs * 0.8 + (performance.now() - this.sinceMs) * 0.2;
    gl.deleteSync(fence);
    this.fence = null;
    return false;
  }

  /** Throws all meshes on the ground, along the light; the stencil darkens each place once. @param {Item[]} items @param {Float32Array} both */
  shadows(items, both) {
    const { gl, programs: { shadow } } = this;
    const [x, y, z] = SHADOW_LIGHT;
    const onGround = Float32Array.of(1, 0, 0, 0, 0, 1, 0, 0, -x / z, -y / z, 0, 0, 0, 0, 0.0006, 1);
    gl.useProgram(shadow.program);
    gl.uniformMatrix4fv(shadow.at('camera'), false, product(both, onGround));
    gl.enable(gl.BLEND);
    gl.enable(gl.STENCIL_TEST);
    gl.stencilFunc(gl.EQUAL, 0, 0xff);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.INCR);
    gl.depthMask(false);
    for (const item of items) if (item.color[3] > 0.5) this.mesh({ ...item, color: [0, 0, 0, 0.26] }, shadow);
    gl.depthMask(true);
    gl.disable(gl.STENCIL_TEST);
    gl.disable(gl.BLEND);
  }

  /** @param {Item} item @param {ReturnType<typeof program>} using */
  mesh({ mesh, model, color }, using) {
    const { gl } = this;
    const stored = this.meshes.get(mesh) ?? this.store(mesh);
    stored.isUsed = true;
    gl.uniformMatrix4fv(using.at('model'), false, model);
    gl.uniform4f(using.at('color'), color[0], color[1], color[2], color[3]);
    gl.bindVertexArray(stored.vao);
    if (stored.isIndexed) gl.drawElements(gl.TRIANGLES, stored.count, gl.UNSIGNED_INT, 0);
    else gl.drawArrays(gl.TRIANGLES, 0, stored.count);
  }

  /** @param {Mesh} mesh */
  store(mesh) {
    const { gl } = this;
    const vao = gl.createVertexArray();
    /** @type {WebGLBuffer[]} */
    const buffers = [];
    gl.bindVertexArray(vao);
    [mesh.positions, mesh.normals].forEach((numbers, location) => {
      const buffer = gl.createBuffer();
      buffers.push(buffer);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, numbers, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, 3, gl.FLOAT, false, 0, 0);
    });
    if (mesh.indices) {
      const buffer = gl.createBuffer();
      buffers.push(buffer);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, mesh.indices, gl.STATIC_DRAW);
    }
    const stored = { vao, buffers, count: mesh.indices?.length ?? mesh.positions.length / 3, isIndexed: Boolean(mesh.indices), isUsed: true };
    this.meshes.set(mesh, stored);
    return stored;
  }

  /** Meshes that this picture did not show, such as those of changed markers. */
  forgetUnused() {
    for (const [mesh, stored] of this.meshes) {
      if (!stored.isUsed) {
        this.gl.deleteVertexArray(stored.vao);
        stored.buffers.forEach((buffer) => this.gl.deleteBuffer(buffer));
        this.meshes.delete(mesh);
      }
      stored.isUsed = false;
    }
  }

  /** Gives the graphics card back what it held; browsers allow few contexts. */
  destroy() { this.gl.getExtension('WEBGL_lose_context')?.loseContext(); }
}

/** @param {WebGL2RenderingContext} gl @param {string} vertex @param {string} fragment */
function program(gl, vertex, fragment) {
  const built = gl.createProgram();
  for (const [type, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = /** @type {WebGLShader} */ (gl.createShader(type));
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(built, shader);
  }
  gl.linkProgram(built);
  if (!gl.getProgramParameter(built, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`the graphics card refuses a shader: ${gl.getProgramInfoLog(built)}`);
  }
  /** @type {Map<string, WebGLUniformLocation | null>} */
  const places = new Map();
  const at = (/** @type {string} */ name) => {
    if (!places.has(name)) places.set(name, gl.getUniformLocation(built, name));
    return places.get(name) ?? null;
  };
  return { program: built, at };
}
