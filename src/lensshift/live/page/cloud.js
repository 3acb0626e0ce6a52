// The point cloud: one point a pixel, its distance along where the pixel looks; WebGL2.

import { grey, rangeOf, viridis } from "./colours.js";

const canvas = document.getElementById("cloud"), note = document.getElementById("cloud-note");
const colour = document.getElementById("colour"), flying = document.getElementById("flying");
const gl = canvas.getContext("webgl2", { antialias: false, alpha: true });
const VERTEX = `#version 300 es
in vec3 look; in float metres; in float shade; in float flies;
uniform vec3 middle; uniform vec2 turn; uniform vec4 lens; uniform vec2 limits; uniform float keep;
out float level;
void main() {
  level = clamp((shade - limits.x) / (limits.y - limits.x), 0.0, 1.0);
  vec3 p = look * metres - middle;
  p = vec3(cos(turn.x) * p.x + sin(turn.x) * p.z, p.y, cos(turn.x) * p.z - sin(turn.x) * p.x);
  p = vec3(p.x, cos(turn.y) * p.y - sin(turn.y) * p.z, sin(turn.y) * p.y + cos(turn.y) * p.z);
  float z = p.z + lens.x, near = 0.02 * lens.x, far = 20.0 * lens.x;
  gl_Position = vec4(5.0 * p.x / lens.y, -5.0 * p.y, (z * (far + near) - 2.0 * far * near) / (far - near), z);
  gl_PointSize = clamp(1.1 * lens.w * metres * 2.5 * lens.z / z, 1.5, 64.0);
  if (!(metres > 0.0) || flies > keep) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision mediump float; in float level; uniform sampler2D map; out vec4 seen;
void main() { seen = vec4(texture(map, vec2(level * 255.0 / 256.0 + 0.5 / 256.0, 0.5)).rgb, 1.0); }`;

let turn = [0.5, 0.3], zoom = 1, latest = null, range = null, ranged = "";
let program, buffers = {}, uniforms = {}, maps = {}, pitch = 0.01, middle = null, size = 1;

if (gl) begin();
else note.textContent = "This browser has no WebGL2, which the point cloud needs.";

function begin() {
  program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  for (const [name, count] of [["look", 3], ["metres", 1], ["shade", 1], ["flies", 1]]) {
    buffers[name] = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    const place = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, count, gl.FLOAT, false, 0, 0);
  }
  for (const name of ["middle", "turn", "lens", "limits", "keep"]) uniforms[name] = gl.getUniformLocation(program, name);
  for (const [name, table] of [["amplitude", grey.map((x, i) => grey[Math.min(255, 50 + Math.round(0.8 * i))])], ["distance", viridis]]) {
    maps[name] = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, maps[name]);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(table.buffer));
    for (const end of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, end, gl.NEAREST);
  }
  gl.enable(gl.DEPTH_TEST);
}

function put(name, values) {
  gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
  gl.bufferData(gl.ARRAY_BUFFER, values, gl.DYNAMIC_DRAW);
}

// Where the pixels look [row col 3]; changes with scale and source only.
export function setDirections(values, rows, cols) {
  if (!gl) return;
  put("look", values);
  const a = 3 * (Math.floor(rows / 2) * cols + Math.floor(cols / 2)), b = a + (cols > 1 ? 3 : 0);
  pitch = Math.hypot(values[a] - values[b], values[a + 1] - values[b + 1], values[a + 2] - values[b + 2]) || 0.01;
  latest = { count: rows * cols, cols };
  middle = null;
}

export function showCloud(head, layers) {
  const metres = layers.get("distance");
  if (!gl) return;
  if (!metres || !latest || metres.values.length !== latest.count) {
    if (!metres) note.textContent = "These frames hold no distances.";
    return;
  }
  const shade = layers.get(colour.value) ?? metres, flies = layers.get("flying");
  const now = rangeOf(shade.values);
  range = range && ranged === colour.value ? range.map((x, i) => x + 0.15 * (now[i] - x)) : now;
  ranged = colour.value;
  put("metres", metres.values.map((x) => (x === x ? x : -1)));
  put("shade", shade.values);
  put("flies", flies ? flies.values : new Float32Array(latest.count));
  const [low, high] = rangeOf(metres.values);
  if (!middle) {
    middle = [0, 0, 0.5 * (low + high)];
    size = Math.max(0.1, latest.cols * pitch * middle[2], high - low);
  }
  const share = flies ? flies.values.reduce((sum, x) => sum + x, 0) / latest.count : 0;
  note.textContent = [
    `${latest.count.toLocaleString("en")} pixels, ${low.toFixed(2)} to ${high.toFixed(2)} m`,
    flies ? `${(100 * share).toFixed(1)} % flying ${flying.checked ? "shown" : "left out"}` : "flying pixels are not known",
    head.field_assumed ? "field of view not known: 40° across assumed" : "drag or arrow keys turn, wheel or + − zoom",
  ].join(" · ");
  drawCloud();
}

export function drawCloud() {
  if (!gl || !latest || !middle || !range) return;
  const dense = Math.min(window.devicePixelRatio || 1, 2);
  const [width, height] = [Math.round(canvas.clientWidth * dense), Math.round(canvas.clientHeight * dense)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const shape = width / height;
  gl.uniform3fv(uniforms.middle, middle);
  gl.uniform2fv(uniforms.turn, turn);
  gl.uniform4f(uniforms.lens, size * Math.max(1.8, 3.4 / shape) / zoom, shape, height, pitch);
  gl.uniform2fv(uniforms.limits, range);
  gl.uniform1f(uniforms.keep, flying.checked ? 2 : 0.5);
  gl.bindTexture(gl.TEXTURE_2D, maps[colour.value]);
  gl.drawArrays(gl.POINTS, 0, latest.count);
}

canvas.onpointerdown = (event) => canvas.setPointerCapture(event.pointerId);
canvas.onpointermove = (event) => {
  if (event.buttons) orbit(event.movementX / 200, event.movementY / 200);
};
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  scale(Math.exp(-event.deltaY / 600));
}, { passive: false });
canvas.onkeydown = (event) => {
  const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
  if (step) orbit(...step);
  else if (event.key === "+" || event.key === "=") scale(1.15);
  else if (event.key === "-") scale(1 / 1.15);
  else if (event.key === "0") { turn = [0.5, 0.3]; zoom = 1; drawCloud(); }
  else return;
  event.preventDefault();
};
colour.onchange = flying.onchange = () => { range = null; };

function orbit(yaw, tilt) {
  turn = [turn[0] + yaw, Math.max(-1.5, Math.min(1.5, turn[1] + tilt))];
  drawCloud();
}

function scale(factor) {
  zoom = Math.max(0.2, Math.min(20, zoom * factor));
  drawCloud();
}
