import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { test } from "node:test";
import { WireError, decodeComposite, hello, parseReply } from "../src/protocol.js";

const folder = new URL("../../proto/vectors/", import.meta.url);
const vectors = JSON.parse(readFileSync(new URL("index.json", folder), "utf8"));
const read = (name) => readFileSync(new URL(name, folder));
const REPLIES = new Set(["welcome", "state", "done", "error", "stats", "pong", "bye"]);

function bytes(name) {
  const { buffer, byteOffset, byteLength } = read(name);
  return buffer.slice(byteOffset, byteOffset + byteLength);
}

/** A decoded composite in the terms of the vectors. */
function described(c) {
  const snake = (name) => `${name.replace(/[A-Z]/g, (l) => `_${l.toLowerCase()}`)}_ns`;
  const planes = Object.entries(c.planes).flatMap(([name, { codec, bytes }]) => [
    [`${name}_codec`, codec],
    [name, Buffer.from(bytes).toString("hex")],
  ]);
  return {
    sequence: String(c.sequence),
    capture_ns: String(c.captureNs),
    pose: c.pose,
    camera_intrinsics: c.camera,
    ...Object.fromEntries(Object.entries(c.stampsNs).map(([name, ns]) => [snake(name), String(ns)])),
    dropped_frames: String(c.droppedFrames),
    dropped_composites: String(c.droppedComposites),
    virtual_pixels: c.virtualPixels,
    traced_pixels: c.tracedPixels,
    secondary_rays: c.secondaryRays,
    unknown_rays: c.unknownRays,
    stage_us: c.stageUs,
    ...Object.fromEntries(planes),
  };
}

for (const vector of vectors.filter((v) => v.kind === "composite")) {
  test(`composite ${vector.file}`, () => {
    if (vector.error) {
      assert.throws(() => decodeComposite(bytes(vector.file)), (e) => e instanceof WireError && e.code === vector.error);
    } else {
      assert.deepEqual(described(decodeComposite(bytes(vector.file))), vector.expect);
    }
  });
}

test("a composite cut anywhere is refused, and never read beyond its end", () => {
  const whole = bytes("composite_full.bin");
  for (let n = 0; n < whole.byteLength; n++) {
    assert.throws(() => decodeComposite(whole.slice(0, n)), WireError, `${n} bytes`);
  }
  const longer = new Uint8Array(whole.byteLength + 1);
  longer.set(new Uint8Array(whole));
  assert.throws(() => decodeComposite(longer.buffer), { code: "length" });
});

test("other kinds of binary messages are refused as such", () => {
  for (const { file } of vectors.filter((v) => ["frame", "asset_chunk"].includes(v.kind) && v.expect)) {
    assert.throws(() => decodeComposite(bytes(file)), { code: "unknown_type" }, file);
  }
});

for (const { file, error, expect } of vectors.filter((v) => v.kind === "control")) {
  test(`control ${file}`, () => {
    const text = read(file).toString();
    if (expect && REPLIES.has(expect.type)) assert.equal(parseReply(text).type, expect.type);
    // What is wrong with a request in particular is the server's to say.
    else if (error === "malformed" && !/place|hello|bad_id/.test(file)) {
      assert.throws(() => parseReply(text), { code: "malformed" });
    } else assert.throws(() => parseReply(text), WireError);
  });
}

test("a reply without what it must have is refused", () => {
  assert.throws(() => parseReply('{"type":"welcome"}'), { code: "malformed" });
  assert.throws(() => parseReply('{"type":"state","session":"a","source":null,"objects":[],"settings":{}}'), { code: "malformed" });
  assert.throws(() => parseReply('{"type":"constructor"}'), { code: "unknown_type" });
});

test("the hello says what the vectors of a viewer say, and what this page needs", () => {
  const plain = JSON.parse(read("hello_viewer.json").toString());
  const said = JSON.parse(JSON.stringify(hello({})));
  for (const [field, value] of Object.entries(plain)) assert.deepEqual(said[field], value);
  assert.deepEqual(said.composite, { image: "jpeg", quality: 85, camera: "jpeg" });
  assert.equal(said.credits, 2);
  assert.equal(hello({ session: "s1", scene: "x" }).scene, undefined);
});
