// The MTF of an edge, of one frame and of the picture: curves, 95 % bands, both Nyquist frequencies.

import { post } from "./message.js";

const canvas = document.getElementById("mtf"), note = document.getElementById("mtf-note");
const when = document.getElementById("mtf-when");
const AGAIN_MS = 2000;
const CURVES = [["one", "one frame", [6, 4]], ["fine", "super-resolved", []]];
let box = null, busy = false, found = null, timer = 0;

export function measure(corners) {
  box = corners;
  clearTimeout(timer);
  if (box) ask();
  else {
    found = null;
    note.textContent = "Drag a box over a slanted edge of the picture.";
    when.textContent = "";
    drawCurves();
  }
}

async function ask() {
  if (busy || !box) return;
  busy = true;
  const asked = box;
  when.textContent = "measuring…";
  try {
    const answer = await post("edge", { box: asked });
    if (asked === box) show(answer);
  } catch (error) {
    note.textContent = error.message;
    when.textContent = "";
  }
  busy = false;
  if (box) timer = setTimeout(ask, asked === box ? AGAIN_MS : 0);
}

function show(answer) {
  found = answer;
  when.textContent = `picture ${answer.number}, measured again every few seconds`;
  note.textContent = CURVES.map(([key, name]) => {
    const { why, mtf50, notes, usable } = answer[key];
    if (why) return `${name}: not measured, ${why}.`;
    return `${name}: MTF50 ${mtf50}${usable ? "" : ", not to be relied on"}${notes.length ? ` (${notes.join("; ")})` : ""}.`;
  }).join(" ");
  canvas.setAttribute("aria-label", `MTF curves. ${note.textContent}`);
  drawCurves();
}

export function drawCurves() {
  const dense = window.devicePixelRatio || 1, style = getComputedStyle(document.body);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  const em = parseFloat(style.fontSize);
  const ink = (name) => style.getPropertyValue(name);
  [canvas.width, canvas.height] = [Math.round(width * dense), Math.round(height * dense)];
  const g = canvas.getContext("2d");
  g.scale(dense, dense);
  g.font = `${0.8 * em}px ${style.fontFamily || "sans-serif"}`;
  const nyquist = found?.nyquist ?? { one_lpmm: 1, fine_lpmm: 2 };
  const most = 1.2 * nyquist.fine_lpmm;
  const frame = { left: 2.6 * em, right: width - 0.6 * em, top: 0.6 * em, bottom: height - 2.4 * em };
  const x = (f) => frame.left + (frame.right - frame.left) * f / most;
  const y = (m) => frame.bottom - (frame.bottom - frame.top) * Math.max(0, Math.min(1.2, m)) / 1.2;
  axes(g, { frame, x, y, most, em, ink, known: Boolean(found) });
  if (!found) return;
  for (const [key, name, dash] of CURVES) curve(g, found[key], { x, y, colour: ink(`--${key}`), dash, em });
  const same = nyquist.one_lpmm === nyquist.fine_lpmm;
  CURVES.forEach(([key, name], i) => {
    if (same && i) return;
    const at = x(nyquist[`${key}_lpmm`]);
    g.strokeStyle = g.fillStyle = ink(`--${key}`);
    line(g, [[at, frame.top], [at, frame.bottom]], [2, 3]);
    g.textAlign = "right";
    g.fillText(`Nyquist, ${name}`, at - 4, frame.top + em * (0.8 + 1.1 * i));
  });
}

function axes(g, { frame, x, y, most, em, ink, known }) {
  g.lineWidth = 1;
  g.strokeStyle = ink("--line");
  g.fillStyle = ink("--soft");
  g.textAlign = "right";
  for (const m of [0, 0.25, 0.5, 0.75, 1]) {
    line(g, [[frame.left, y(m)], [frame.right, y(m)]], []);
    g.fillText(m.toFixed(2), frame.left - 5, y(m) + 0.3 * em);
  }
  g.textAlign = "center";
  const step = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100].find((s) => most / s <= 8) ?? most;
  for (let f = 0; known && f <= most; f += step) g.fillText(`${+f.toFixed(2)}`, x(f), frame.bottom + 1.1 * em);
  g.fillText("spatial frequency on the sensor (lp/mm)", (frame.left + frame.right) / 2, frame.bottom + 2.2 * em);
}

function curve(g, data, { x, y, colour, dash, em }) {
  if (data.why) return;
  const f = data.frequency_lpmm, points = (values) => values.map((m, i) => [x(f[i]), y(m ?? 0)]);
  g.strokeStyle = g.fillStyle = colour;
  if (data.low && data.high) {
    const band = [...points(data.high), ...points(data.low).reverse()];
    g.globalAlpha = 0.22;
    g.beginPath();
    for (const one of band) g.lineTo(...one);
    g.fill();
    g.globalAlpha = 1;
  }
  g.lineWidth = Math.max(2, em / 8);
  line(g, points(data.modulation), dash);
  g.lineWidth = 1;
}

function line(g, points, dash) {
  g.setLineDash(dash);
  g.beginPath();
  for (const one of points) g.lineTo(...one);
  g.stroke();
  g.setLineDash([]);
}
