/**
 * A page with a camera, like that of a headset or tablet: it encodes RGB-D frames with the client's
 * modules, streams them to the real server and decodes the composites.
 */

import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { mkdtempSync, rmSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Chromium } from "./chromium.mjs";
import { Server, writeStill } from "./server.mjs";

const folder = mkdtempSync(join(tmpdir(), "ghostlight-stream-"));
let server, browser, page;

before(async () => {
  const still = join(folder, "still");
  writeStill(still);
  server = await Server.start(still);
  browser = new Chromium(process.env.CHROMIUM ?? "chromium");
  page = await browser.open(`${server.url}/version`, { width: 400, height: 300 });
  await page.until(`location.pathname === "/version" && document.readyState === "complete"`, "a page of the server's");
});

after(async () => {
  await browser?.close();
  await server?.end("SIGKILL").catch(() => {});
  rmSync(folder, { recursive: true, force: true });
});

/** Runs in the page: a producer that sends one frame for each pair of codecs. */
async function stream() {
  const wire = await import("/client/src/protocol.js");
  const width = 160, height = 120, n = width * height;
  const camera = { width, height, fx: 131, fy: 131, cx: 79.5, cy: 59.5 };
  const still = { translation: [0, 0, 0], quaternion: [0, 0, 0, 1] };
  // A wall that recedes from 1 m to 2 m, with no depth at its left edge; a picture of smooth colours.
  const depth = Uint16Array.from({ length: n }, (_, i) => (i % width < 9 ? 0 : 1000 + Math.round(((i % width) * 1000) / width)));
  const rgba = new Uint8ClampedArray(4 * n);
  for (let i = 0; i < n; i++) rgba.set([40 + (i % width), 90, 200 - Math.floor(i / width), 255], 4 * i);
  const rgb = new Uint8Array(3 * n);
  for (let i = 0; i < n; i++) rgb.set(rgba.subarray(4 * i, 4 * i + 3), 3 * i);
  const canvas = new OffscreenCanvas(width, height);
  canvas.getContext("2d").putImageData(new ImageData(rgba, width, height), 0, 0);
  const jpeg = new Uint8Array(await (await canvas.convertToBlob({ type: "image/jpeg", quality: 0.95 })).arrayBuffer());
  const colours = {
    rgb8: rgb, rgba8: new Uint8Array(rgba), jpeg, png: await wire.encodePng({ width, height, kind: "rgb8", samples: rgb }),
  };
  const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", wire.SUBPROTOCOL);
  socket.binaryType = "arraybuffer";
  const waiting = [], arrived = [];
  let failure = null;
  const next = (what) => new Promise((resolve, reject) => {
    const found = arrived.findIndex(what);
    if (failure) reject(failure);
    else if (found >= 0) resolve(arrived.splice(found, 1)[0]);
    else waiting.push({ what, resolve, reject });
  });
  const fail = (error) => {
    failure = error;
    waiting.splice(0).forEach(({ reject }) => reject(error));
  };
  socket.onclose = (e) => fail(new Error(`closed: ${e.code} ${e.reason}`));
  socket.onmessage = ({ data }) => {
    try {
      const message = typeof data === "string" ? wire.parseReply(data) : wire.decodeComposite(data);
      const at = waiting.findIndex(({ what }) => what(message));
      if (at >= 0) waiting.splice(at, 1)[0].resolve(message);
      else arrived.push(message);
    } catch (error) {
      fail(error);
    }
  };
  await new Promise((resolve) => (socket.onopen = resolve));
  const ask = (request) => socket.send(wire.encodeRequest(request));
  const planes = { image: "rgb8", camera: "png", mask: "gray8", depth: "png" };
  ask({ type: "hello", version: 1, role: "producer", name: "page", composite: { ...planes } });
  await next((m) => m.type === "welcome");
  // An object, uploaded in two parts.
  const mesh = new TextEncoder().encode("v -1 0 -1\nv 1 0 -1\nv 0 0 1\nv 0 1 0\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 3 1 4\n");
  ask({ type: "asset", id: 1, upload: 7, name: "pyramid.obj", bytes: mesh.length });
  for (const [from, to] of [[0, 30], [30, mesh.length]]) {
    socket.send(wire.encodeAssetChunk({ upload: 7, offset: from, bytes: mesh.slice(from, to) }));
  }
  await next((m) => m.type === "done" && m.id === 1);
  ask({ type: "scene", id: 2, scene: { version: 1, objects: [{ name: "pyramid", mesh: "pyramid.obj",
    place: { pixel: [80, 60], size_m: 0.3 }, material: { preset: "matte" } }] } });
  await next((m) => m.type === "done" && m.id === 2);
  const results = [];
  let sequence = 2n ** 60n;
  for (const color of Object.keys(colours)) {
    for (const codec of ["u16", "rvl", "png"]) {
      sequence += 1n;
      ask({ type: "planes", id: 9, depth: codec });
      await next((m) => m.type === "done" && m.id === 9);
      socket.send(wire.encodeFrame({
        sequence, captureNs: -5n, pose: still, colorCamera: camera, depthCamera: camera, colorFromDepth: still,
        metresPerUnit: 0.001, maxDepthM: 0, color: { codec: color, bytes: colours[color] },
        depth: await wire.encodeDepth(codec, depth, camera),
      }));
      const composite = await next((m) => m.type === "error" || (m.planes && m.sequence === sequence && m.planes.depth.codec === codec));
      if (composite.type === "error") throw new Error(JSON.stringify(composite));
      ask({ type: "credit", n: 2 });
      const { image, camera: seen, mask } = composite.planes;
      const original = (await wire.decodePng(seen.bytes, { width, height, kind: "rgb8" })).samples;
      const mm = await wire.decodeDepth(composite.planes.depth, camera);
      let loss = 0, wrongDepth = 0, drawn = 0, changed = 0;
      for (let i = 0; i < n; i++) {
        loss = Math.max(loss, ...[0, 1, 2].map((c) => Math.abs(original[3 * i + c] - rgb[3 * i + c])));
        if (mask.bytes[i] > 0) drawn += 1;
        else if (mm[i] !== depth[i]) wrongDepth += 1;
        if ([0, 1, 2].some((c) => image.bytes[3 * i + c] !== original[3 * i + c])) changed += 1;
      }
      results.push({ pair: `${color} ${codec}`, loss, wrongDepth, drawn, changed, n, captureNs: `${composite.captureNs}` });
    }
  }
  socket.onclose = null;
  socket.close();
  return results;
}

test("every pair of codecs goes up from a page, and what comes back fits", async () => {
  const results = await page.evaluate(`(${stream})()`);
  assert.equal(results.length, 12);
  for (const { pair, loss, wrongDepth, drawn, changed, n, captureNs } of results) {
    assert.equal(captureNs, "-5", pair);
    // A browser's JPEG at quality 0.95 has an error of a few of 255; the other codecs are exact.
    assert.ok(loss <= (pair.startsWith("jpeg") ? 12 : 0), `${pair}: colour off by ${loss}`);
    assert.equal(wrongDepth, 0, `${pair}: depth where nothing was drawn`);
    assert.ok(drawn > 100 && drawn < n / 2 && changed >= drawn / 2, `${pair}: ${drawn} pixels drawn, ${changed} changed`);
  }
});

test("the page plays over TLS", async (t) => {
  const files = ["cert", "key"].map((kind) => join(folder, `${kind}.pem`));
  const made = spawnSync("openssl", [
    "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=localhost", "-out", files[0], "-keyout", files[1],
  ]);
  if (made.status !== 0) {
    console.log("SKIPPED: openssl is not here to make a certificate");
    return t.skip();
  }
  const secure = await Server.start(join(folder, "still"), "127.0.0.1:0", ["--tls-cert", files[0], "--tls-key", files[1]]);
  // The certificate is self-signed.
  const trusting = new Chromium(process.env.CHROMIUM ?? "chromium", ["--ignore-certificate-errors"]);
  try {
    assert.match(secure.url, /^https:/);
    const watched = await trusting.open(secure.url, { width: 800, height: 600 });
    await watched.until(`location.protocol === "https:" && isSecureContext
      && document.getElementById("status")?.dataset.phase === "open" && document.getElementById("overlay").hidden`, "a picture");
    assert.deepEqual(watched.errors, []);
  } finally {
    await trusting.close();
    await secure.end("SIGKILL");
  }
});
