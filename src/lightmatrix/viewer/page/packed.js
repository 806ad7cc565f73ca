// Numbers on their way from Python, as packed.py writes them.

const MAGIC = "LMVIEW1\n";
const TYPES = { u1: Uint8Array, u2: Uint16Array, u4: Uint32Array, f2: Uint16Array, f4: Float32Array };

/** The header and the arrays of a packed message. */
export function unpack(buffer) {
  const decoder = new TextDecoder();
  if (decoder.decode(new Uint8Array(buffer, 0, MAGIC.length)) !== MAGIC) throw new Error("The data is not for this viewer.");
  const start = MAGIC.length + 4;
  const length = new DataView(buffer).getUint32(MAGIC.length, true);
  const header = JSON.parse(decoder.decode(new Uint8Array(buffer, start, length)));
  const arrays = {};
  for (const [name, { type, count, offset }] of Object.entries(header.arrays)) {
    arrays[name] = new TYPES[type](buffer, start + length + offset, count);
  }
  return { header, arrays };
}

/** All 65,536 numbers of half precision, times a factor. */
export function halves(scale) {
  const table = new Float64Array(65536);
  for (let bits = 0; bits < 65536; bits++) {
    const exponent = (bits >> 10) & 31, fraction = bits & 1023;
    const size = exponent === 0 ? fraction * 2 ** -24 : (1024 + fraction) * 2 ** (exponent - 25);
    table[bits] = (bits & 32768 ? -size : size) * scale;
  }
  return table;
}

/** A number of three digits, as people write it. */
export function number(value) {
  if (!Number.isFinite(value)) return "unknown";
  const size = Math.abs(value);
  return size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(1) : String(+value.toPrecision(3));
}
