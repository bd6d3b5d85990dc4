/** Depth in the codecs of the wire format: 16-bit samples in row order. */

import { decodePng, encodePng } from "./png.js";
import { MAX_SIDE, WireError } from "./wire.js";
import { readZstd } from "./zstd.js";

/**
 * @param {string} codec
 * @param {string} expected
 * @param {unknown} got
 */
const corrupt = (codec, expected, got) => new WireError("decode", `depth payload (${codec})`, expected, got);

/** @param {number} n */
function checkPixels(n) {
  if (Number.isInteger(n) && n >= 0 && n <= MAX_SIDE * MAX_SIDE) return;
  throw new WireError("size", "depth", `0 to ${MAX_SIDE * MAX_SIDE} pixels`, n);
}

/**
 * RVL (Wilson 2017, "Fast Lossless Depth Image Compression").
 * @param {Uint16Array} pixels
 */
export function encodeRvl(pixels) {
  const n = pixels.length;
  checkPixels(n);
  // A difference takes at most 6 nibbles, and the two lengths of a pair of runs at most 2 more
  // than the runs have pixels: 8 nibbles per pixel, plus 2.
  const out = new DataView(new ArrayBuffer(4 * n + 8));
  let at = 0, word = 0, nibbles = 0;
  const put = (/** @type {number} */ value) => {
    do {
      const rest = value >>> 3;
      word = (word << 4) | (value & 7) | (rest ? 8 : 0);
      if (++nibbles === 8) {
        out.setInt32(at, word, true);
        at += 4;
        word = nibbles = 0;
      }
      value = rest;
    } while (value);
  };
  let last = 0;
  for (let i = 0; i < n; ) {
    const zeros = i;
    while (i < n && pixels[i] === 0) i += 1;
    const run = i;
    while (i < n && pixels[i] !== 0) i += 1;
    put(run - zeros);
    put(i - run);
    for (let j = run; j < i; j++) {
      const value = pixels[j] ?? 0;
      const d = value - last;
      last = value;
      put((d << 1) ^ (d >> 31));
    }
  }
  if (nibbles > 0) {
    out.setInt32(at, word << (4 * (8 - nibbles)), true);
    at += 4;
  }
  return new Uint8Array(out.buffer.slice(0, at));
}

/**
 * `nPixels` samples from RVL.
 * @param {Uint8Array} bytes
 * @param {number} nPixels
 */
export function decodeRvl(bytes, nPixels) {
  checkPixels(nPixels);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0, word = 0, nibbles = 0;
  const get = () => {
    for (let value = 0, shift = 0; ; shift += 3) {
      if (nibbles === 0) {
        if (at + 4 > bytes.length) throw corrupt("rvl", "more 32-bit words", "the end");
        word = view.getInt32(at, true);
        at += 4;
        nibbles = 8;
      }
      const nibble = word >>> 28;
      word <<= 4;
      nibbles -= 1;
      // A 17-bit zigzag difference needs 6 nibbles, a run in 8192 x 8192 pixels 9.
      if (shift > 24) throw corrupt("rvl", "numbers of at most 9 nibbles", "a longer one");
      value |= (nibble & 7) << shift;
      if (nibble < 8) return value;
    }
  };
  const pixels = new Uint16Array(nPixels);
  let last = 0;
  for (let i = 0; i < nPixels; ) {
    const zeros = get(), run = get();
    const room = nPixels - i;
    if (zeros + run === 0 || zeros + run > room) {
      throw corrupt("rvl", `runs of 1 to ${room} pixels (what is left)`, `${zeros} zeros and ${run} others`);
    }
    i += zeros;
    for (const end = i + run; i < end; i++) {
      const z = get();
      last += (z >>> 1) ^ -(z & 1);
      if (!(last > 0 && last < 65536)) throw corrupt("rvl", "non-zero samples of 1 to 65535", last);
      pixels[i] = last;
    }
  }
  if (at !== bytes.length || word !== 0) throw corrupt("rvl", `the end after ${nPixels} pixels`, `${bytes.length - at} bytes more`);
  return pixels;
}

/**
 * `nPixels` samples from differences in byte planes.
 * @param {Uint8Array<ArrayBuffer>} bytes
 * @param {number} nPixels
 * @param {import("./zstd.js").Decompress} [decompress] a zstd decoder
 */
export function decodeDeltaZstd(bytes, nPixels, decompress) {
  checkPixels(nPixels);
  const planes = readZstd(bytes, 2 * nPixels, decompress);
  const pixels = new Uint16Array(nPixels);
  let last = 0;
  for (let i = 0; i < nPixels; i++) {
    last += (planes[i] ?? 0) | ((planes[nPixels + i] ?? 0) << 8);
    pixels[i] = last;
    last &= 0xffff;
  }
  return pixels;
}

/**
 * Encodes a depth plane. Servers also accept `delta_zstd`, which needs a zstd compressor; `rvl`
 * compresses about as well without one.
 * @param {"u16" | "rvl" | "png"} codec
 * @param {Uint16Array} pixels
 * @param {{width: number, height: number}} size
 * @returns {Promise<import("./wire.js").Plane>}
 */
export async function encodeDepth(codec, pixels, { width, height }) {
  if (pixels.length !== width * height) {
    throw new WireError("size", "depth", `${width * height} pixels`, pixels.length);
  }
  switch (codec) {
    case "u16": {
      const view = new DataView(new ArrayBuffer(2 * pixels.length));
      pixels.forEach((pixel, i) => view.setUint16(2 * i, pixel, true));
      return { codec, bytes: new Uint8Array(view.buffer) };
    }
    case "rvl":
      return { codec, bytes: encodeRvl(pixels) };
    case "png":
      return { codec, bytes: await encodePng({ width, height, kind: "gray16", samples: pixels }) };
    default:
      throw new WireError("codec", "depth codec", "u16, rvl, png", codec);
  }
}

/**
 * Decodes a depth plane.
 * @param {import("./wire.js").Plane} plane
 * @param {{width: number, height: number}} size
 * @param {import("./zstd.js").Decompress} [decompress]
 * @returns {Promise<Uint16Array>}
 */
export async function decodeDepth({ codec, bytes }, { width, height }, decompress) {
  const n = width * height;
  checkPixels(n);
  switch (codec) {
    case "u16": {
      if (bytes.length !== 2 * n) throw new WireError("size", "depth payload (u16)", `${2 * n} bytes`, `${bytes.length} bytes`);
      const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
      return Uint16Array.from({ length: n }, (_, i) => view.getUint16(2 * i, true));
    }
    case "rvl":
      return decodeRvl(bytes, n);
    case "delta_zstd":
      return decodeDeltaZstd(bytes, n, decompress);
    case "png": {
      const { samples } = await decodePng(bytes, { width, height, kind: "gray16" });
      return /** @type {Uint16Array} */ (samples);
    }
    default:
      throw new WireError("codec", "depth codec", "u16, rvl, delta_zstd, png", codec);
  }
}
