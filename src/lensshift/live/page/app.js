// The page: asks for a picture, draws it, asks for the next; so a slow browser slows nobody else.

import { drawCloud, setDirections, showCloud } from "./cloud.js";
import { get, post, unpacked } from "./message.js";
import { drawCurves, measure } from "./mtf.js";
import { forgetBox, show, whenBoxed } from "./picture.js";

const at = (id) => document.getElementById(id);
const shown = []; // when pictures were shown, ms
// What tests read: pictures shown, the age of the latest ones in seconds, errors.
const stats = { shown: 0, ages: [], points: 0, rate: () => rate(), failures: [] };
globalThis.lensshift = stats;
addEventListener("error", (event) => stats.failures.push(event.message));
addEventListener("unhandledrejection", (event) => stats.failures.push(String(event.reason)));

const TOLD_MS = 200; // numbers that change faster cannot be read
let geometry = "", age = null, scale = 0, told = 0;

function connect() {
  const socket = new WebSocket(new URL("pictures", location.href.replace(/^http/, "ws")));
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { tell("state", ""); socket.send("next"); };
  socket.onclose = () => {
    tell("state", "No connection to lensshift; trying again.");
    setTimeout(connect, 2000);
  };
  socket.onmessage = ({ data }) => {
    const came = performance.now();
    requestAnimationFrame(async () => {
      // The next one travels while this one is drawn; a tab that stands still asks for none.
      if (socket.readyState === WebSocket.OPEN) socket.send("next");
      const { head, layers } = unpacked(data);
      if (layers.size) await draw(head, layers, came);
      if (came - told < TOLD_MS && head.number) return;
      told = came;
      numbers(head);
    });
  };
}

async function draw(head, layers, came) {
  if (head.geometry !== geometry) await look(head);
  if (scale && head.made.scale !== scale) forgetBox();
  scale = head.made.scale;
  show(head, layers);
  showCloud(head, layers);
  const now = performance.now();
  age = { seconds: head.age_s + (now - came) / 1000, at: now };
  stats.shown += 1;
  stats.points = layers.get("distance")?.values.length ?? 0;
  stats.ages.push(age.seconds);
  if (stats.ages.length > 300) stats.ages.shift();
  shown.push(now);
  while (shown.length && shown[0] < now - 3000) shown.shift();
}

async function look(head) {
  const answer = await fetch("directions");
  if (!answer.ok || answer.headers.get("X-Geometry") !== head.geometry) return; // the next one fits
  const [rows, cols] = head.geometry.split("-")[0].split("x").map(Number);
  setDirections(new Float32Array(await answer.arrayBuffer()), rows, cols);
  geometry = head.geometry;
}

const rate = () => {
  const now = performance.now(), recent = shown.filter((t) => t > now - 3000);
  return recent.length > 1 ? (recent.length - 1) / ((now - recent[0]) / 1000) : 0;
};

function tell(id, text) {
  if (at(id).textContent !== text) at(id).textContent = text;
}

function numbers(head) {
  const { bursts_hz, frames_hz, pictures_hz, shift } = head.numbers;
  tell("source", head.source);
  tell("state", head.problem || (head.ended ? "No more frames come." : head.warning));
  tell("n-bursts", bursts_hz === null ? "–" : bursts_hz.toFixed(1));
  tell("n-rates", `${frames_hz.toFixed(1)} frames, ${pictures_hz.toFixed(1)} pictures, ${rate().toFixed(1)} shown per s`);
  tell("n-shift", shift ? `${shift.rms_px.toFixed(3)} px` : "–");
  tell("n-shift-note", shift
    ? `rms, registered (± ${shift.sigma_px.toFixed(3)} px) against planned, ${shift.ago_s.toFixed(0)} s ago`
    : "registered against planned; not measured yet");
  if (head.made) made(head);
  const recording = head.recording;
  at("record").setAttribute("aria-pressed", Boolean(recording));
  tell("record", recording ? `Stop (${recording.frames} frames)` : "Record");
  const { scale: factor, method, blur_px } = head.settings;
  choose("pattern", head.pattern);
  choose("scale", String(factor));
  choose("method", method);
  if (document.activeElement !== at("blur")) at("blur").value = blur_px ?? "";
}

function made(head) {
  const { residual, made: { frames, places, pace, event, method, scale: factor, psf_px } } = head;
  tell("n-residual", residual === null ? "–" : residual.toFixed(2));
  at("n-residual").classList.toggle("bad", residual > 2);
  tell("n-residual-note", residual === null ? "this method does not compare" : "rms over the picture; 1 where all is well");
  tell("made", `picture ${head.number}: ${method} ×${factor}, ${frames} of ${places} places, ${pace}${event ? `, ${event}` : ""}`);
  at("blur").placeholder = psf_px === null || psf_px === undefined ? "known" : Number(psf_px).toFixed(2);
}

function choose(id, value) {
  const field = at(id);
  if (document.activeElement !== field && field.value !== value) field.value = value;
}

setInterval(() => {
  if (!age) return;
  const seconds = age.seconds + (performance.now() - age.at) / 1000;
  const latest = stats.ages.slice(-60), mean = latest.reduce((a, b) => a + b, 0) / latest.length;
  tell("n-age", seconds > 1 ? `${seconds.toFixed(1)} s` : `${Math.round(1000 * mean)} ms`);
  at("n-age").classList.toggle("bad", seconds > 1);
  tell("n-age-note", "since its latest frame had come, when drawn");
}, 250);

async function ask(path, content) {
  try {
    const answer = await post(path, content);
    tell("said", answer.files ? `saved ${answer.files.join(", ")}` : "");
  } catch (error) {
    tell("said", error.message);
  }
}

function fill(id, names) {
  at(id).replaceChildren(...names.map((name) => new Option(name, name)));
}

async function begin() {
  const { patterns, methods, most_scale, most_blur_px } = await get("begin");
  fill("pattern", patterns);
  fill("method", methods);
  fill("scale", Array.from({ length: most_scale }, (_, i) => String(i + 1)));
  at("blur").max = most_blur_px;
  at("pattern").onchange = (event) => { ask("control", { pattern: event.target.value }); event.target.blur(); };
  at("method").onchange = (event) => { ask("control", { method: event.target.value }); event.target.blur(); };
  at("scale").onchange = (event) => { ask("control", { scale: Number(event.target.value) }); event.target.blur(); };
  at("blur").onchange = ({ target }) => ask("control", { blur_px: target.value === "" ? null : Number(target.value) });
  at("record").onclick = () => ask("control", { record: at("record").getAttribute("aria-pressed") !== "true" });
  at("snapshot").onclick = () => { tell("said", "saving…"); ask("snapshot"); };
  at("controls").onsubmit = (event) => event.preventDefault();
  whenBoxed(measure);
  connect();
}

const systemDark = matchMedia("(prefers-color-scheme: dark)");
function theme(name) {
  document.documentElement.dataset.theme = name;
  drawCurves();
}
at("theme").onclick = () => theme(document.documentElement.dataset.theme === "dark" ? "light" : "dark");
systemDark.onchange = () => theme(systemDark.matches ? "dark" : "light");
theme(systemDark.matches ? "dark" : "light");
// The window is not all that changes their size: a wide picture takes the whole first row.
const redraw = new ResizeObserver(() => { drawCurves(); drawCloud(); });
for (const id of ["mtf", "cloud"]) redraw.observe(document.getElementById(id));
begin();
