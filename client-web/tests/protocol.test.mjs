/** Decodes and encodes every vector of the format, and decodes damaged messages. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import {
  WireError, decodeAssetChunk, decodeComposite, decodeDeltaZstd, decodeFrame, decodeRvl, encodeAssetChunk,
  encodeComposite, encodeFrame, encodeRequest, encodeRvl, hello, parseReply, parseRequest,
} from "../src/protocol.js";
import { randoms } from "./random.mjs";
import { missing, unzstd } from "./unzstd.mjs";

const folder = new URL("../../proto/vectors/", import.meta.url);
const vectors = JSON.parse(readFileSync(new URL("index.json", folder), "utf8"));
const read = (name) => new Uint8Array(readFileSync(new URL(name, folder)));
const hex = (bytes) => Buffer.from(bytes).toString("hex");
const unhex = (text) => new Uint8Array(Buffer.from(text, "hex"));

const snake = (name) => name.replace(/[A-Z]/g, (letter) => `_${letter.toLowerCase()}`);
const plane = (from, name) => ({ codec: from[`${name}_codec`], bytes: unhex(from[name]) });
const planes = (names, of) => Object.fromEntries(names.flatMap((name) => [
  [`${name}_codec`, of[name].codec], [name, hex(of[name].bytes)],
]));
const STAMPS = ["received", "decodeStart", "decoded", "renderStart", "renderEnd", "encodeStart", "encoded", "sent"];
const PLANES = ["image", "camera", "mask", "depth"];
const SMALL = ["virtualPixels", "tracedPixels", "secondaryRays", "unknownRays"];
const LARGE = ["sequence", "captureNs", "droppedFrames", "droppedComposites"];

/** For each kind: decoding, the decoded fields in the form of the index, and encoding from these. */
const KINDS = {
  frame: {
    read: decodeFrame,
    told: (f) => ({
      sequence: `${f.sequence}`, capture_ns: `${f.captureNs}`, pose: f.pose, color_camera: f.colorCamera,
      depth_camera: f.depthCamera, color_from_depth: f.colorFromDepth, metres_per_unit: f.metresPerUnit,
      max_depth_m: f.maxDepthM, ...planes(["color", "depth"], f),
    }),
    write: (e) => encodeFrame({
      sequence: BigInt(e.sequence), captureNs: BigInt(e.capture_ns), pose: e.pose, colorCamera: e.color_camera,
      depthCamera: e.depth_camera, colorFromDepth: e.color_from_depth, metresPerUnit: e.metres_per_unit,
      maxDepthM: e.max_depth_m, color: plane(e, "color"), depth: plane(e, "depth"),
    }),
  },
  composite: {
    read: decodeComposite,
    told: (c) => ({
      pose: c.pose, camera_intrinsics: c.camera, stage_us: c.stageUs, ...planes(PLANES, c.planes),
      ...Object.fromEntries(LARGE.map((name) => [snake(name), `${c[name]}`])),
      ...Object.fromEntries(SMALL.map((name) => [snake(name), c[name]])),
      ...Object.fromEntries(STAMPS.map((name) => [`${snake(name)}_ns`, `${c.stampsNs[name]}`])),
    }),
    write: (e) => encodeComposite({
      pose: e.pose, camera: e.camera_intrinsics, stageUs: e.stage_us,
      planes: Object.fromEntries(PLANES.map((name) => [name, plane(e, name)])),
      ...Object.fromEntries(LARGE.map((name) => [name, BigInt(e[snake(name)])])),
      ...Object.fromEntries(SMALL.map((name) => [name, e[snake(name)]])),
      stampsNs: Object.fromEntries(STAMPS.map((name) => [name, BigInt(e[`${snake(name)}_ns`])])),
    }),
  },
  asset_chunk: {
    read: decodeAssetChunk,
    told: (c) => ({ upload: c.upload, offset: `${c.offset}`, bytes: hex(c.bytes) }),
    write: (e) => encodeAssetChunk({ upload: e.upload, offset: BigInt(e.offset), bytes: unhex(e.bytes) }),
  },
  rvl: {
    read: (bytes, { width, height }) => decodeRvl(bytes, width * height),
    told: (pixels) => ({ pixels: [...pixels] }),
    write: (e) => encodeRvl(Uint16Array.from(e.pixels)),
  },
  delta_zstd: {
    read: (bytes, { width, height }) => decodeDeltaZstd(bytes, width * height, unzstd),
    told: (pixels) => ({ pixels: [...pixels] }),
    // Only decoded here: encoding needs a zstd compressor.
    write: null,
  },
  request: {
    read: (bytes) => parseRequest(new TextDecoder().decode(bytes)),
    told: (request) => request,
    write: (e) => new TextEncoder().encode(encodeRequest(e)),
    free: true,
  },
  reply: {
    read: (bytes) => parseReply(new TextDecoder().decode(bytes)),
    told: (reply) => reply,
    write: (e) => new TextEncoder().encode(JSON.stringify(e)),
    free: true,
  },
};

test("there are vectors of every kind, good and bad", () => {
  for (const kind of Object.keys(KINDS)) {
    for (const outcome of ["expect", "error"]) {
      assert.ok(vectors.some((v) => v.kind === kind && outcome in v), `${kind}: ${outcome}`);
    }
  }
});

for (const vector of vectors) {
  const { file, kind, expect, error } = vector;
  const skip = kind === "delta_zstd" && expect ? missing : false;
  test(`${kind} ${file}`, { skip }, () => {
    const { read: decode, told, write, free } = KINDS[kind];
    if (error) {
      assert.throws(() => decode(read(file), vector), (e) => {
        assert.ok(e instanceof WireError, `${e.stack}`);
        return e.code === error;
      });
      return;
    }
    assert.deepEqual(told(decode(read(file), vector)), expect);
    if (!write) return;
    const written = write(expect);
    assert.deepEqual(told(decode(written, vector)), expect, "what is written is read back");
    // A longer header, as from a later version, decodes but is not encoded.
    if (!free && !file.includes("long_header")) assert.equal(hex(written), hex(read(file)));
  });
}

test("a message within a larger buffer is read where it lies", () => {
  const whole = read("composite_full.bin");
  const around = new Uint8Array(whole.length + 14);
  around.set(whole, 7);
  const { planes: found } = decodeComposite(around.subarray(7, 7 + whole.length));
  assert.equal(hex(found.mask.bytes), vectors.find((v) => v.file === "composite_full.bin").expect.mask);
});

test("what a server would refuse is not sent", () => {
  const good = decodeFrame(read("frame_raw.bin"));
  const refused = (change, code) => assert.throws(() => encodeFrame({ ...good, ...change }), { name: "WireError", code });
  refused({ pose: { translation: [0, 0, NaN], quaternion: [0, 0, 0, 1] } }, "pose");
  refused({ pose: { translation: [0, 0], quaternion: [0, 0, 0, 1] } }, "pose");
  refused({ pose: { translation: [0, 0, 0], quaternion: [0, 0, 0, 0] } }, "pose");
  refused({ colorCamera: { ...good.colorCamera, fx: 0 } }, "intrinsics");
  refused({ colorCamera: { ...good.colorCamera, width: 2.5 } }, "size");
  refused({ depthCamera: { ...good.depthCamera, height: 4 } }, "size");
  refused({ metresPerUnit: Infinity }, "intrinsics");
  refused({ maxDepthM: -1 }, "intrinsics");
  refused({ color: { codec: "rvl", bytes: good.color.bytes } }, "codec");
  refused({ color: { codec: "jpeg", bytes: new Uint8Array(0) } }, "size");
  refused({ depth: { codec: "u16", bytes: good.depth.bytes.subarray(2) } }, "size");
  refused({ sequence: -1 }, "malformed");
  refused({ sequence: 2n ** 64n }, "malformed");
  refused({ captureNs: 1.5 }, "malformed");
  assert.throws(() => encodeAssetChunk({ upload: 1, offset: 0, bytes: new Uint8Array(0) }), { code: "length" });
  assert.throws(() => encodeAssetChunk({ upload: 2 ** 32, offset: 0, bytes: new Uint8Array(1) }), { code: "malformed" });
  assert.throws(() => encodeRequest({ type: "turn", object: "cup", angle: NaN }), { code: "malformed" });
  assert.throws(() => encodeRequest({ type: "constructor" }), { code: "unknown_type" });
});

test("errors do not echo a hostile message whole", () => {
  const error = (() => {
    try {
      return parseReply(JSON.stringify({ type: "x".repeat(100_000) }));
    } catch (e) {
      return e;
    }
  })();
  assert.ok(error.message.length < 1000, `${error.message.length} characters`);
});

test("the hello says what the vectors of a viewer say, and what this page needs", () => {
  const plain = JSON.parse(new TextDecoder().decode(read("hello_viewer.json")));
  const said = JSON.parse(JSON.stringify(hello({})));
  for (const [field, value] of Object.entries(plain)) assert.deepEqual(said[field], value);
  assert.deepEqual(said.composite, { image: "jpeg", quality: 85, camera: "none" });
  assert.equal(said.credits, 2);
  assert.equal(hello({ session: "s1", scene: "x" }).scene, undefined);
  assert.equal(hello({}, "jpeg").composite.camera, "jpeg");
  encodeRequest(hello({ token: "t", recording: "r", scene: "s" }));
});

/** Runs every decoder: each returns a message or the format's error, and allocates no more than requested. */
function readEverything(bytes) {
  const text = new TextDecoder().decode(bytes);
  const readers = [
    decodeFrame, decodeComposite, decodeAssetChunk, () => parseReply(text), () => parseRequest(text),
    ...[0, 1, 12, 4096].flatMap((n) => [(b) => decodeRvl(b, n), (b) => decodeDeltaZstd(b, n), (b) => decodeDeltaZstd(b, n, unzstd)]),
  ];
  for (const reader of readers) {
    try {
      reader(bytes);
    } catch (error) {
      if (!(error instanceof WireError)) throw new Error(`${reader}: ${error.stack}\non ${hex(bytes)}`);
    }
  }
}

test("arbitrary bytes are read or refused", () => {
  const random = randoms(1);
  for (let i = 0; i < 3000; i++) {
    const bytes = random.bytes(random.below(600));
    // Random bytes rarely pass the first check, so some get a valid header.
    if (i % 3 === 1) bytes.set([0x47, 0x4c, 1, 1 + (i % 4)].slice(0, bytes.length));
    if (i % 3 === 2) bytes.set([0x28, 0xb5, 0x2f, 0xfd].slice(0, bytes.length));
    readEverything(bytes);
  }
});

test("damaged messages are read or refused", () => {
  const random = randoms(2);
  const all = vectors.map(({ file }) => read(file)).filter((bytes) => bytes.length);
  for (let i = 0; i < 6000; i++) {
    let bytes = all[random.below(all.length)].slice();
    for (let n = random.below(8); n > 0; n--) bytes[random.below(bytes.length)] = random.below(256);
    if (random.below(2)) bytes = bytes.slice(0, random.below(bytes.length));
    readEverything(bytes);
  }
});

test("a good message cut anywhere, or with more behind it, is refused", { skip: missing }, () => {
  for (const { file, kind, error, ...size } of vectors) {
    if (error || ["request", "reply"].includes(kind)) continue;
    const whole = read(file);
    for (let n = 0; n < whole.length; n++) {
      // A chunk of a file may have any length.
      if (kind === "asset_chunk" && n > whole.length - 8) continue;
      assert.throws(() => KINDS[kind].read(whole.slice(0, n), size), WireError, `${file}: ${n} bytes`);
    }
    if (kind !== "asset_chunk") {
      assert.throws(() => KINDS[kind].read(new Uint8Array([...whole, 0]), size), WireError, file);
    }
  }
});
