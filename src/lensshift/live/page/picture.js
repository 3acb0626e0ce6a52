// The picture: layers, the wipe between one frame and the super-resolved one, read-out, the box.

import { grey, paint, rangeOf, viridis } from "./colours.js";

const at = (id) => document.getElementById(id);
const stage = at("stage"), wipe = at("wipe"), box = at("box"), before = at("before");
const tabs = [...document.querySelectorAll('[role="tab"]')];
const clamp = (x, low, high) => Math.min(high, Math.max(low, x));
const MOST_WIDE = 0.72, LEAST_EM = 26, BELOW_EM = 15; // share of the picture, least width of both columns, height below it
const CALM = 0.15; // share of a new colour range that counts at once, so that colours do not flicker

let wanted = "amplitude", shown = null, range = null, ranged = "", share = 0.5;
let corners = null; // of the box: [row start, row stop, col start, col stop], HR px
let pointer = null; // where the mouse is, as shares of the width and height
let onBox = () => {};

export const whenBoxed = (listener) => { onBox = listener; };

const unitOf = (layer) => (layer.unit ? ` ${layer.unit}` : "");
export const number = (value, unit) =>
  value !== value ? "none" : unit === "m" ? `${value.toFixed(4)} m` : `${value.toPrecision(4)}`;

// Layer and the layer of one frame beside it, which std and misfit do not have.
function chosen(layers) {
  if (wanted === "std") {
    const name = layers.has("std.distance") ? "std.distance" : "std.amplitude";
    return [layers.get(name), null, `standard deviation of the ${name.slice(4)}`];
  }
  if (wanted === "misfit") return [layers.get("misfit"), null, "misfit: residual over noise, 1 where all is well"];
  return [layers.get(wanted), layers.get(`one.${wanted}`), wanted];
}

export function show(head, layers) {
  shown = { head, layers };
  draw();
}

function draw() {
  if (!shown) return;
  const { head, layers } = shown;
  const [layer, one, words] = chosen(layers);
  const any = layers.get("amplitude") ?? layers.get("distance");
  stage.style.aspectRatio = `${any.cols} / ${any.rows}`;
  layOut(any.cols / any.rows);
  at("tag-one").hidden = wipe.hidden = before.hidden = !one;
  at("tag-fine").textContent = layer ? (one ? "super-resolved" : words) : `no ${words} with this method`;
  at("fine").hidden = !layer;
  if (layer) {
    const now = rangeOf(layer.values), key = `${wanted} ${layer.unit}`;
    range = ranged === key && range ? range.map((x, i) => x + CALM * (now[i] - x)) : now;
    ranged = key;
    const table = wanted === "amplitude" ? grey : viridis;
    paint(at("fine"), layer, range, table);
    if (one) {
      paint(at("coarse"), one, range, table);
      // The frame was taken with the image moved: move it back, so that the halves meet.
      const [row, col] = head.one_offset_px;
      at("coarse").style.transform = `translate(${-100 * col / one.cols}%, ${-100 * row / one.rows}%)`;
    }
    at("low").textContent = number(range[0], layer.unit);
    at("high").textContent = number(range[1], layer.unit);
    at("ramp").dataset.map === wanted || ramp(table);
  } else {
    at("low").textContent = at("high").textContent = "";
  }
  placeWipe();
  placeBox();
  read();
}

// The picture stands beside the other two, above the curves, or above both: where it leaves no room
// empty. On a narrow page all stand below each other.
function layOut(ratio) {
  const panels = at("panels"), em = parseFloat(getComputedStyle(document.body).fontSize), width = panels.offsetWidth;
  const others = [...at("picture").children].filter((one) => one !== stage), edge = 1.4 * em + 2;
  const around = others.reduce((sum, one) => sum + one.offsetHeight + 0.4 * em, 0.8 * em + 2);
  const high = Math.max(innerHeight - panels.offsetTop - 0.6 * em, 30 * em);
  const [alone, above] = [high, high - BELOW_EM * em].map((height) => ratio * (height - around) + edge);
  const most = Math.min(MOST_WIDE * width, width - LEAST_EM * em);
  const beside = 0.85 * alone <= most || above < 0.5 * width; // of a low page the curves would take too much
  panels.className = beside ? "beside" : above < width ? "above" : "wide";
  const column = beside ? alone : above;
  panels.style.setProperty("--column", `${Math.max(Math.min(most, column), LEAST_EM * em)}px`);
  stage.style.maxWidth = `${innerWidth > 800 ? column - edge : 0.58 * ratio * innerHeight}px`;
}

function ramp(table) {
  const values = Float32Array.from({ length: 256 }, (_, i) => i);
  paint(at("ramp"), { rows: 1, cols: 256, values }, [0, 255], table);
  at("ramp").dataset.map = wanted;
}

function placeWipe() {
  wipe.style.left = `${100 * share}%`;
  before.style.clipPath = `inset(0 ${100 * (1 - share)}% 0 0)`;
  stage.setAttribute("aria-valuenow", Math.round(100 * share));
  stage.setAttribute("aria-valuetext", `one frame on the left ${Math.round(100 * share)} percent`);
}

function placeBox() {
  box.hidden = !corners;
  if (!corners || !shown) return;
  const { rows, cols } = size();
  const [top, bottom, left, right] = corners;
  box.style.top = `${100 * top / rows}%`;
  box.style.left = `${100 * left / cols}%`;
  box.style.height = `${100 * (bottom - top) / rows}%`;
  box.style.width = `${100 * (right - left) / cols}%`;
}

const size = () => shown.layers.get("amplitude") ?? shown.layers.get("distance");

function read() {
  if (!pointer || !shown) return;
  const [layer, one] = chosen(shown.layers);
  if (!layer) return;
  const row = clamp(Math.floor(pointer.y * layer.rows), 0, layer.rows - 1);
  const col = clamp(Math.floor(pointer.x * layer.cols), 0, layer.cols - 1);
  const scale = shown.head.made.scale;
  const parts = [`row ${row}, column ${col} px (${(row / scale).toFixed(1)}, ${(col / scale).toFixed(1)} of a frame)`];
  parts.push(`${wanted} ${number(layer.values[row * layer.cols + col], layer.unit)}`);
  if (one) {
    const [down, right] = shown.head.one_offset_px;
    const r = clamp(Math.floor(pointer.y * one.rows + down), 0, one.rows - 1);
    const c = clamp(Math.floor(pointer.x * one.cols + right), 0, one.cols - 1);
    parts.push(`one frame ${number(one.values[r * one.cols + c], one.unit)}`);
  }
  const metres = shown.layers.get("distance");
  if (metres && wanted !== "distance") parts.push(`distance ${number(metres.values[row * metres.cols + col], "m")}`);
  at("readout").textContent = parts.join(" · ");
}

function select(tab) {
  wanted = tab.dataset.layer;
  for (const one of tabs) {
    one.setAttribute("aria-selected", one === tab);
    one.tabIndex = one === tab ? 0 : -1;
  }
  draw();
}

tabs.forEach((tab, i) => {
  tab.onclick = () => select(tab);
  tab.onkeydown = (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const next = tabs[(i + step + tabs.length) % tabs.length];
    next.focus();
    select(next);
  };
});

const place = (event) => {
  const area = stage.getBoundingClientRect();
  return { x: clamp((event.clientX - area.left) / area.width, 0, 1), y: clamp((event.clientY - area.top) / area.height, 0, 1) };
};
let dragging = null; // "wipe", or where a box began

stage.onpointerdown = (event) => {
  stage.setPointerCapture(event.pointerId);
  dragging = !wipe.hidden && event.target === wipe ? "wipe" : place(event);
};
stage.onpointermove = (event) => {
  pointer = place(event);
  if (dragging === "wipe") { share = pointer.x; placeWipe(); }
  else if (dragging && shown) { corners = between(dragging, pointer); placeBox(); }
  read();
};
stage.onpointerup = (event) => {
  const began = dragging;
  dragging = null;
  if (!began || began === "wipe" || !shown) return;
  const [top, bottom, left, right] = between(began, place(event));
  corners = bottom - top > 1 && right - left > 1 ? [top, bottom, left, right] : null;
  placeBox();
  onBox(corners);
};
stage.onpointercancel = () => { dragging = null; };

function between(a, b) {
  const { rows, cols } = size();
  const ends = (x, y, n) => [Math.floor(Math.min(x, y) * n), Math.ceil(Math.max(x, y) * n)];
  return [...ends(a.y, b.y, rows), ...ends(a.x, b.x, cols)];
}

const ARROWS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

stage.onkeydown = (event) => {
  const arrow = ARROWS[event.key];
  if (event.key === "b" || event.key === "B") putBox();
  else if (event.key === "Escape") { corners = null; onBox(null); }
  else if (event.key === "Home") share = 0;
  else if (event.key === "End") share = 1;
  else if (arrow && (event.shiftKey || event.altKey)) moveBox(arrow, event.altKey);
  else if (arrow && arrow[1]) share = clamp(share + 0.02 * arrow[1], 0, 1);
  else return;
  event.preventDefault();
  placeWipe();
  placeBox();
};

function putBox() {
  if (!shown) return;
  const { rows, cols } = size(), part = (n, m) => [Math.floor(n / 2 - m / 2), Math.ceil(n / 2 + m / 2)];
  const side = Math.min(rows, 32);
  corners = [...part(rows, side), ...part(cols, Math.min(cols, side))];
  onBox(corners);
}

function moveBox([down, right], resize) {
  if (!shown || !corners) return;
  const { rows, cols } = size();
  const [top, bottom, left, height, width] = [corners[0], corners[1], corners[2], corners[1] - corners[0], corners[3] - corners[2]];
  if (resize) corners = [top, clamp(bottom + down, top + 2, rows), left, clamp(corners[3] + right, left + 2, cols)];
  else {
    const y = clamp(top + down, 0, rows - height), x = clamp(left + right, 0, cols - width);
    corners = [y, y + height, x, x + width];
  }
  onBox(corners);
}

// A box of another scale is of other pixels.
export function forgetBox() {
  corners = null;
  placeBox();
  onBox(null);
}
