/**
 * As much of zstd (RFC 8878) as depth needs: frames of stored and run-length blocks are written
 * and read here; compressed blocks are left to a decoder that is given.
 */

import { WireError } from "./wire.js";

const MAGIC = 0xfd2fb528;
/** Most content of a block. */
const BLOCK_BYTES = 128 << 10;
const STORED = 0, RUN = 1, COMPRESSED = 2;

/**
 * Decodes a whole zstd frame of `contentBytes` of content; may throw whatever it likes. With the
 * package `fzstd`: `(frame, n) => decompress(frame, new Uint8Array(n))`. Servers send planes in
 * the codecs asked for only, so a page that asks for `rvl` needs none.
 * @typedef {(frame: Uint8Array<ArrayBuffer>, contentBytes: number) => Uint8Array} Decompress
 */

/**
 * @param {string} expected
 * @param {unknown} got
 */
const corrupt = (expected, got) => new WireError("decode", "depth payload (delta_zstd)", expected, got);

/**
 * A zstd frame of these bytes: blocks of one repeated byte are written as such, others stored.
 * @param {Uint8Array} content
 */
export function storeZstd(content) {
  /** @type {{type: number, at: number, end: number}[]} */
  const blocks = [];
  for (let at = 0; at === 0 || at < content.length; at += BLOCK_BYTES) {
    const end = Math.min(at + BLOCK_BYTES, content.length);
    const first = content[at];
    let same = at;
    while (same < end && content[same] === first) same += 1;
    blocks.push({ type: same === end && end > at ? RUN : STORED, at, end });
  }
  const payload = blocks.reduce((sum, { type, at, end }) => sum + 3 + (type === RUN ? 1 : end - at), 0);
  // Magic, descriptor, content size of 4 bytes; a single segment, so without a window size.
  const out = new Uint8Array(9 + payload);
  const view = new DataView(out.buffer);
  view.setUint32(0, MAGIC, true);
  view.setUint8(4, 0b1010_0000);
  view.setUint32(5, content.length, true);
  let to = 9;
  blocks.forEach(({ type, at, end }, i) => {
    const header = (i === blocks.length - 1 ? 1 : 0) | (type << 1) | ((end - at) << 3);
    out.set([header & 255, (header >> 8) & 255, header >> 16], to);
    const body = type === RUN ? content.subarray(at, at + 1) : content.subarray(at, end);
    out.set(body, to + 3);
    to += 3 + body.length;
  });
  return out;
}

/**
 * The content of one zstd frame that must have so many bytes. Structure and announced sizes are
 * checked before anything is decoded, so nothing more than that is ever held: a frame with
 * compressed blocks has to state its content size. A checksum is not verified.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {number} contentBytes
 * @param {Decompress} [decompress]
 */
export function readZstd(bytes, contentBytes, decompress) {
  const { blocks, stated, checksumBytes } = layout(bytes, contentBytes);
  const last = blocks.at(-1);
  const end = (last ? last.at + last.stored : 0) + checksumBytes;
  if (end !== bytes.length) throw corrupt(`one zstd frame of ${end} bytes`, `${bytes.length} bytes`);
  if (blocks.some(({ type }) => type === COMPRESSED)) {
    if (!decompress) throw corrupt("stored blocks, as no zstd decoder was given", "compressed ones");
    if (!stated) throw corrupt("a frame that states its content size", "one that does not");
    return decompressed(bytes, contentBytes, decompress);
  }
  const total = blocks.reduce((sum, { size }) => sum + size, 0);
  if (total !== contentBytes) throw corrupt(`${contentBytes} bytes of content`, `${total} bytes`);
  const content = new Uint8Array(contentBytes);
  let to = 0;
  for (const { type, at, size } of blocks) {
    if (type === RUN) content.fill(bytes[at] ?? 0, to, to + size);
    else content.set(bytes.subarray(at, at + size), to);
    to += size;
  }
  return content;
}

/**
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {number} contentBytes
 * @param {Decompress} decompress
 */
function decompressed(bytes, contentBytes, decompress) {
  let content;
  try {
    content = decompress(bytes, contentBytes);
  } catch (error) {
    throw corrupt("zstd that can be decoded", error);
  }
  if (content.length !== contentBytes) throw corrupt(`${contentBytes} bytes of content`, `${content.length} bytes`);
  return content;
}

/**
 * Where the blocks of the first frame are.
 * @param {Uint8Array} bytes
 * @param {number} contentBytes
 */
function layout(bytes, contentBytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const need = (/** @type {number} */ end) => {
    if (end > bytes.length) throw corrupt("a whole zstd frame", `an end after ${bytes.length} bytes`);
  };
  need(5);
  if (view.getUint32(0, true) !== MAGIC) throw corrupt("a zstd frame", "other bytes");
  const descriptor = view.getUint8(4);
  const single = (descriptor & 0x20) !== 0;
  const dictionaryBytes = [0, 1, 2, 4][descriptor & 3] ?? 0;
  const sizeBytes = [single ? 1 : 0, 2, 4, 8][descriptor >> 6] ?? 0;
  if (descriptor & 0x08) throw corrupt("a reserved bit of 0", "1");
  let at = 5 + (single ? 0 : 1);
  need(at + dictionaryBytes + sizeBytes);
  for (let i = 0; i < dictionaryBytes; i++) {
    if (view.getUint8(at + i) !== 0) throw corrupt("a frame without dictionary", "one with");
  }
  at += dictionaryBytes;
  if (sizeBytes > 0) {
    const announced = [
      () => view.getUint8(at),
      () => view.getUint16(at, true) + 256,
      () => view.getUint32(at, true),
      () => Number(view.getBigUint64(at, true)),
    ][descriptor >> 6]?.();
    if (announced !== contentBytes) throw corrupt(`${contentBytes} bytes of content`, `${announced} bytes`);
  }
  at += sizeBytes;
  /** @type {{type: number, at: number, stored: number, size: number}[]} */
  const blocks = [];
  let content = 0;
  for (let last = false; !last; ) {
    need(at + 3);
    const header = view.getUint8(at) | (view.getUint8(at + 1) << 8) | (view.getUint8(at + 2) << 16);
    last = (header & 1) !== 0;
    const type = (header >> 1) & 3;
    const size = header >> 3;
    if (type > COMPRESSED || size > BLOCK_BYTES) {
      throw corrupt(`blocks of types 0 to 2 and at most ${BLOCK_BYTES} bytes`, `type ${type}, ${size} bytes`);
    }
    const stored = type === RUN ? 1 : size;
    need(at + 3 + stored);
    blocks.push({ type, at: at + 3, stored, size });
    at += 3 + stored;
    content += type === COMPRESSED ? 0 : size;
    if (content > contentBytes) throw corrupt(`${contentBytes} bytes of content`, "more");
  }
  return { blocks, stated: sizeBytes > 0, checksumBytes: descriptor & 0x04 ? 4 : 0 };
}
