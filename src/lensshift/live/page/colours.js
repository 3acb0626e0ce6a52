// Colour maps: grey, and viridis (of Matplotlib, CC0), which colour-blind people can read as well.

const VIRIDIS =
  "44015444025645045745055946075a46085c460a5d460b5e470d60470e61471063471164471365481467481668481769" +
  "48186a481a6c481b6d481c6e481d6f481f70482071482173482374482475482576482677482878482979472a7a472c7a" +
  "472d7b472e7c472f7d46307e46327e46337f463480453581453781453882443983443a83443b84433d84433e85423f85" +
  "4240864241864142874144874045884046883f47883f48893e49893e4a893e4c8a3d4d8a3d4e8a3c4f8a3c508b3b518b" +
  "3b528b3a538b3a548c39558c39568c38588c38598c375a8c375b8d365c8d365d8d355e8d355f8d34608d34618d33628d" +
  "33638d32648e32658e31668e31678e31688e30698e306a8e2f6b8e2f6c8e2e6d8e2e6e8e2e6f8e2d708e2d718e2c718e" +
  "2c728e2c738e2b748e2b758e2a768e2a778e2a788e29798e297a8e297b8e287c8e287d8e277e8e277f8e27808e26818e" +
  "26828e26828e25838e25848e25858e24868e24878e23888e23898e238a8d228b8d228c8d228d8d218e8d218f8d21908d" +
  "21918c20928c20928c20938c1f948c1f958b1f968b1f978b1f988b1f998a1f9a8a1e9b8a1e9c891e9d891f9e891f9f88" +
  "1fa0881fa1881fa1871fa28720a38620a48621a58521a68522a78522a88423a98324aa8325ab8225ac8226ad8127ad81" +
  "28ae8029af7f2ab07f2cb17e2db27d2eb37c2fb47c31b57b32b67a34b67935b77937b87838b9773aba763bbb753dbc74" +
  "3fbc7340bd7242be7144bf7046c06f48c16e4ac16d4cc26c4ec36b50c46a52c56954c56856c66758c7655ac8645cc863" +
  "5ec96260ca6063cb5f65cb5e67cc5c69cd5b6ccd5a6ece5870cf5773d05675d05477d1537ad1517cd2507fd34e81d34d" +
  "84d44b86d54989d5488bd6468ed64590d74393d74195d84098d83e9bd93c9dd93ba0da39a2da37a5db36a8db34aadc32" +
  "addc30b0dd2fb2dd2db5de2bb8de29bade28bddf26c0df25c2df23c5e021c8e020cae11fcde11dd0e11cd2e21bd5e21a" +
  "d8e219dae319dde318dfe318e2e418e5e419e7e419eae51aece51befe51cf1e51df4e61ef6e620f8e621fbe723fde725";

const opaque = (r, g, b) => (255 << 24 | b << 16 | g << 8 | r) >>> 0;

export const NONE = opaque(120, 120, 120);
export const grey = Uint32Array.from({ length: 256 }, (_, i) => opaque(i, i, i));
export const viridis = Uint32Array.from({ length: 256 }, (_, i) => {
  const [r, g, b] = [0, 2, 4].map((at) => parseInt(VIRIDIS.slice(6 * i + at, 6 * i + at + 2), 16));
  return opaque(r, g, b);
});

// Lowest and highest of most values: stray ones shall not take the contrast of the rest.
export function rangeOf(values) {
  const step = Math.max(1, Math.floor(values.length / 1024));
  const some = [];
  for (let i = 0; i < values.length; i += step) if (values[i] === values[i]) some.push(values[i]);
  if (!some.length) return [0, 1];
  const sorted = Float32Array.from(some).sort();
  const low = sorted[Math.floor(0.005 * (sorted.length - 1))];
  const high = sorted[Math.ceil(0.995 * (sorted.length - 1))];
  return [low, high > low ? high : low + 1e-6];
}

export function paint(canvas, layer, [low, high], table) {
  if (canvas.width !== layer.cols || canvas.height !== layer.rows) {
    canvas.width = layer.cols;
    canvas.height = layer.rows;
  }
  const context = canvas.getContext("2d", { willReadFrequently: true }); // small ones: no need of a GPU
  const image = context.createImageData(layer.cols, layer.rows);
  const pixels = new Uint32Array(image.data.buffer);
  const factor = 255 / (high - low);
  for (let i = 0; i < pixels.length; i++) {
    const value = layer.values[i];
    const level = (value - low) * factor;
    pixels[i] = value === value ? table[level < 0 ? 0 : level > 255 ? 255 : level | 0] : NONE;
  }
  context.putImageData(image, 0, 0);
}
