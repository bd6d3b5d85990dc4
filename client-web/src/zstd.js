/**
 * Bounds checks for zstd frames (RFC 8878). The decoder itself is given by the caller: this module
 * ensures that a hostile frame cannot make it allocate more than announced.
 */

import { WireError } from "./wire.js";

const MAGIC = 0xfd2fb528;
/** Most content of a block. */
const BLOCK_BYTES = 128 << 10;
const RUN = 1, COMPRESSED = 2;

/**
 * Decodes a whole zstd frame of `contentBytes` of content, or throws. With the package `fzstd`:
 * `(frame, n) => decompress(frame, new Uint8Array(n))`. Servers use only the codecs that a client
 * requests, so a page that requests `rvl` needs no zstd decoder.
 * @typedef {(frame: Uint8Array<ArrayBuffer>, contentBytes: number) => Uint8Array} Decompress
 */

/**
 * @param {string} expected
 * @param {unknown} got
 */
const corrupt = (expected, got) => new WireError("decode", "depth payload (delta_zstd)", expected, got);

/**
 * Decodes one zstd frame of exactly `contentBytes` of content. Its structure and its announced
 * sizes are checked first, so that a hostile frame allocates nothing beyond that. A checksum is
 * not verified.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {number} contentBytes
 * @param {Decompress} [decompress]
 */
export function readZstd(bytes, contentBytes, decompress) {
  const end = checkedEnd(bytes, contentBytes);
  if (end !== bytes.length) throw corrupt(`one zstd frame of ${end} bytes`, `${bytes.length} bytes`);
  if (!decompress) throw corrupt("a codec other than delta_zstd, as no zstd decoder was given", "zstd");
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
 * Offset of the end of the first frame, after checking its header and the sizes of its blocks.
 * @param {Uint8Array} bytes
 * @param {number} contentBytes
 */
function checkedEnd(bytes, contentBytes) {
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
  let content = 0, compressed = false;
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
    at += 3 + stored;
    if (type === COMPRESSED) compressed = true;
    else content += size;
    if (content > contentBytes) throw corrupt(`${contentBytes} bytes of content`, "more");
  }
  if (compressed && sizeBytes === 0) throw corrupt("a frame that states its content size", "one that does not");
  if (!compressed && content !== contentBytes) throw corrupt(`${contentBytes} bytes of content`, `${content} bytes`);
  return at + (descriptor & 0x04 ? 4 : 0);
}
