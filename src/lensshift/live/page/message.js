// The bytes of lensshift.live.picture: a JSON head, then layers of 16 bits a pixel.

export function unpacked(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const layers = new Map();
  let start = 4 + length;
  for (const { name, unit, rows, cols, low, step } of head.layers ?? []) {
    const codes = new Uint16Array(buffer, start, rows * cols);
    const values = new Float32Array(codes.length);
    for (let i = 0; i < codes.length; i++) values[i] = codes[i] ? low + (codes[i] - 1) * step : NaN;
    layers.set(name, { unit, rows, cols, values });
    start += 2 * codes.length;
  }
  return { head, layers };
}

async function answered(response) {
  const content = await response.json();
  if (!response.ok) throw new Error(content.error ?? `the server answered ${response.status}`);
  return content;
}

export const get = async (path) => answered(await fetch(path));
export const post = async (path, content = {}) =>
  answered(await fetch(path, { method: "POST", body: JSON.stringify(content) }));
