/**
 * The kinds of PNG in the wire format: 8-bit RGB, RGBA and grey, and 16-bit grey, which browsers
 * decode to only 8 bits. Deflate is provided by the browser.
 */

import { WireError } from "./wire.js";

const SIGNATURE = [0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a];

/** Bytes per pixel, bit depth and colour type. */
const KINDS = /** @type {const} */ ({
  gray8: { pixel: 1, depth: 8, type: 0 },
  gray16: { pixel: 2, depth: 16, type: 0 },
  rgb8: { pixel: 3, depth: 8, type: 2 },
  rgba8: { pixel: 4, depth: 8, type: 6 },
});
/** @typedef {keyof typeof KINDS} PngKind */
/** @typedef {{width: number, height: number, kind: PngKind}} PngHead */

/**
 * @param {string} expected
 * @param {unknown} got
 */
const corrupt = (expected, got) => new WireError("decode", "PNG", expected, got);

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, i) => {
  let c = i;
  for (let k = 0; k < 8; k++) c = c & 1 ? 0xedb88320 ^ (c >>> 1) : c >>> 1;
  return c;
});

/** @param {Uint8Array} bytes */
function crc32(bytes) {
  let c = ~0;
  for (const byte of bytes) c = (CRC_TABLE[(c ^ byte) & 255] ?? 0) ^ (c >>> 8);
  return ~c >>> 0;
}

/**
 * Passes bytes through a browser stream; returns at most `limit` bytes.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {CompressionStream | DecompressionStream} stream
 * @param {number} limit
 */
async function through(bytes, stream, limit) {
  const writer = stream.writable.getWriter();
  // The reader gets this error as well.
  const written = writer.write(bytes).then(() => writer.close()).catch(() => {});
  const reader = stream.readable.getReader();
  /** @type {Uint8Array[]} */
  const parts = [];
  let n = 0;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) break;
    parts.push(value);
    n += value.length;
    if (n > limit) {
      await reader.cancel().catch(() => {});
      throw corrupt(`${limit} bytes of pixels`, "more");
    }
  }
  await written;
  const out = new Uint8Array(n);
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}

/**
 * @param {string} name
 * @param {Uint8Array} content
 */
function chunk(name, content) {
  const out = new Uint8Array(12 + content.length);
  const view = new DataView(out.buffer);
  view.setUint32(0, content.length);
  out.set([...name].map((c) => c.charCodeAt(0)), 4);
  out.set(content, 8);
  view.setUint32(8 + content.length, crc32(out.subarray(4, 8 + content.length)));
  return out;
}

/**
 * @param {PngHead & {samples: Uint8Array | Uint16Array}} image samples in row order
 */
export async function encodePng({ width, height, kind, samples }) {
  const { pixel, depth, type } = KINDS[kind];
  const row = pixel * width;
  if (samples.length * samples.BYTES_PER_ELEMENT !== row * height) {
    throw new WireError("size", "PNG", `${width}x${height} pixels of ${kind}`, `${samples.length} samples`);
  }
  const plain = new Uint8Array(row * height);
  if (samples instanceof Uint16Array) samples.forEach((v, i) => plain.set([v >> 8, v & 255], 2 * i));
  else plain.set(samples);
  // Each row is coded as its difference to the one above ("Up"), which compresses depth well and is fast.
  const rows = new Uint8Array((row + 1) * height);
  for (let y = 0; y < height; y++) {
    const to = y * (row + 1);
    rows[to] = 2;
    for (let x = 0; x < row; x++) {
      const above = y > 0 ? plain[(y - 1) * row + x] ?? 0 : 0;
      rows[to + 1 + x] = (plain[y * row + x] ?? 0) - above;
    }
  }
  const head = new Uint8Array(13);
  const view = new DataView(head.buffer);
  view.setUint32(0, width);
  view.setUint32(4, height);
  head.set([depth, type, 0, 0, 0], 8);
  const packed = await through(rows, new CompressionStream("deflate"), Infinity);
  const parts = [new Uint8Array(SIGNATURE), chunk("IHDR", head), chunk("IDAT", packed), chunk("IEND", new Uint8Array(0))];
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}

/**
 * Decodes a PNG, which must have this size and kind; never allocates more than these require.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {PngHead} expected
 * @returns {Promise<PngHead & {samples: Uint8Array | Uint16Array}>}
 */
export async function decodePng(bytes, { width, height, kind }) {
  const { pixel, depth, type } = KINDS[kind];
  const { head, data } = chunks(bytes);
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const size = `${view.getUint32(0)}x${view.getUint32(4)}`;
  if (size !== `${width}x${height}`) throw new WireError("size", "PNG", `${width}x${height}`, size);
  if (head[8] !== depth || head[9] !== type || head[10] || head[11] || head[12]) {
    throw corrupt(`${kind}, not interlaced`, `bit depth ${head[8]}, colour type ${head[9]}, interlace ${head[12]}`);
  }
  const row = pixel * width;
  const length = (row + 1) * height;
  const rows = await through(data, new DecompressionStream("deflate"), length).catch((error) => {
    throw error instanceof WireError ? error : corrupt("pixels that can be inflated", error);
  });
  if (rows.length !== length) throw corrupt(`${length} bytes of pixels`, rows.length);
  const plain = unfilter(rows, row, height, pixel);
  const samples = depth === 16
    ? Uint16Array.from({ length: width * height }, (_, i) => ((plain[2 * i] ?? 0) << 8) | (plain[2 * i + 1] ?? 0))
    : plain;
  return { width, height, kind, samples };
}

/**
 * Header and compressed pixels.
 * @param {Uint8Array<ArrayBuffer>} bytes
 */
function chunks(bytes) {
  if (!SIGNATURE.every((byte, i) => bytes[i] === byte)) throw corrupt("a PNG", "other bytes");
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  /** @type {Uint8Array<ArrayBuffer> | null} */
  let head = null;
  /** @type {Uint8Array<ArrayBuffer>[]} */
  const data = [];
  for (let at = 8; ; ) {
    if (at + 12 > bytes.length) throw corrupt("an IEND chunk", "the end");
    const length = view.getUint32(at);
    const end = at + 8 + length;
    if (end + 4 > bytes.length) throw corrupt(`a chunk of ${length} bytes`, `${bytes.length - at - 12} bytes`);
    if (view.getUint32(end) !== crc32(bytes.subarray(at + 4, end))) throw corrupt("a chunk that fits its checksum", "another");
    const name = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    const content = bytes.subarray(at + 8, end);
    if (name === "IHDR" && length === 13) head = content;
    if (name === "IDAT") data.push(content);
    if (name === "IEND") break;
    at = end + 4;
  }
  if (!head) throw corrupt("an IHDR chunk of 13 bytes", "none");
  const whole = new Uint8Array(data.reduce((sum, part) => sum + part.length, 0));
  let to = 0;
  for (const part of data) {
    whole.set(part, to);
    to += part.length;
  }
  return { head, data: whole };
}

/**
 * Undoes the rows' filters.
 * @param {Uint8Array} rows
 * @param {number} row bytes per row
 * @param {number} height
 * @param {number} pixel bytes per pixel
 */
function unfilter(rows, row, height, pixel) {
  const out = new Uint8Array(row * height);
  for (let y = 0; y < height; y++) {
    const from = y * (row + 1) + 1;
    const to = y * row;
    const filter = rows[from - 1] ?? 0;
    if (filter > 4) throw corrupt("filters 0 to 4", filter);
    for (let x = 0; x < row; x++) {
      const left = x >= pixel ? out[to + x - pixel] ?? 0 : 0;
      const above = y > 0 ? out[to + x - row] ?? 0 : 0;
      const corner = x >= pixel && y > 0 ? out[to + x - row - pixel] ?? 0 : 0;
      out[to + x] = (rows[from + x] ?? 0) + predicted(filter, left, above, corner);
    }
  }
  return out;
}

/**
 * @param {number} filter
 * @param {number} left
 * @param {number} above
 * @param {number} corner
 */
function predicted(filter, left, above, corner) {
  switch (filter) {
    case 1:
      return left;
    case 2:
      return above;
    case 3:
      return (left + above) >> 1;
    case 4: {
      const [a, b, c] = [Math.abs(above - corner), Math.abs(left - corner), Math.abs(left + above - 2 * corner)];
      if (a <= b && a <= c) return left;
      return b <= c ? above : corner;
    }
    default:
      return 0;
  }
}
