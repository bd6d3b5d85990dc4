/**
 * The worker: connection, decoding and drawing. A busy page thread then delays no picture.
 */

import { nowMs } from "./clock.js";
import { Connection } from "./connection.js";
import { measure } from "./stages.js";

/**
 * @typedef {ImageBitmap | VideoFrame} Picture
 * @typedef {import("./composite.js").Composite} Composite
 */

/**
 * Messages of the page to the worker.
 * @typedef {{kind: "hello", hello: object, now: boolean}
 *   | {kind: "start", url: string, canvas: OffscreenCanvas}
 *   | {kind: "request", request: object}
 *   | {kind: "split", share: number}
 *   | {kind: "hidden", hidden: boolean}
 *   | {kind: "retry"}} ToWorker
 */

/**
 * Messages of the worker to the page.
 * @typedef {{kind: "phase", phase: import("./connection.js").Phase}
 *   | {kind: "reply", reply: import("./control.js").Reply}
 *   | {kind: "broken", message: string}
 *   | {kind: "frame", sample: import("./stages.js").Sample}} FromWorker
 */

/** @param {FromWorker} message */
const tell = (message) => postMessage(message);

/** @type {Connection | null} */
let connection = null;
/** Hello message of the next connection. */
let helloMessage = {};
/** @type {OffscreenCanvas | null} */
let canvas = null;
/** @type {OffscreenCanvasRenderingContext2D | null} */
let context = null;

/** Share of the width, from the left, that shows the camera's picture. */
let split = 0;
let hidden = false;
/** Credits held back while the page is hidden. */
let owed = 0;

/** The newest picture, kept for redrawing when the slider moves. @type {Picture | null} */
let image = null;
/** The camera's picture under it. @type {Picture | null} */
let camera = null;
/** @type {import("./wire.js").Plane | null} */
let cameraPlane = null;
/** Pictures are drawn in the order of arrival. */
let turn = Promise.resolve();

/**
 * Decodes a JPEG plane. ImageDecoder is faster but exists only in secure contexts.
 * @param {import("./wire.js").Plane} plane
 * @returns {Promise<Picture>}
 */
async function decode(plane) {
  if (plane.codec !== "jpeg") throw new Error(`picture: expected jpeg, as requested, got ${plane.codec}`);
  if ("ImageDecoder" in self) {
    const decoder = new ImageDecoder({ data: plane.bytes, type: "image/jpeg" });
    try {
      return (await decoder.decode()).image;
    } finally {
      decoder.close();
    }
  }
  return createImageBitmap(new Blob([plane.bytes], { type: "image/jpeg" }));
}

function draw() {
  if (!context || !canvas || !image) return;
  const { width, height } = canvas;
  context.drawImage(image, 0, 0);
  const edge = Math.round(split * width);
  if (edge > 0 && camera) {
    context.drawImage(camera, 0, 0, edge, height, 0, 0, edge, height);
  }
}

/**
 * @param {Composite} composite
 * @param {number} arrivedMs
 * @param {number} bytes
 */
async function show(composite, arrivedMs, bytes) {
  const from = connection;
  /** @type {{type: "credit", latency_us?: number, draw_us?: number}} */
  const credit = { type: "credit" };
  try {
    const { width, height } = composite.camera;
    const wanted = split > 0 && composite.planes.camera.codec !== "none";
    const [nextImage, nextCamera] = await Promise.all([
      decode(composite.planes.image),
      wanted ? decode(composite.planes.camera) : null,
    ]);
    image?.close();
    camera?.close();
    [image, camera, cameraPlane] = [nextImage, nextCamera, composite.planes.camera];
    if (canvas && (canvas.width !== width || canvas.height !== height)) {
      canvas.width = width;
      canvas.height = height;
    }
    draw();
    if (!from) return;
    const sample = measure(composite, arrivedMs, nowMs(), from.clock.offsetMs, bytes);
    tell({ kind: "frame", sample });
    // Reported to the server's metrics. The clock estimate may be off by more than a short latency.
    const us = (/** @type {number} */ ms) => Math.min(0xffff_ffff, Math.max(0, Math.round(1e3 * ms)));
    credit.draw_us = us(sample.waysMs.page);
    if (sample.latencyMs !== null) credit.latency_us = us(sample.latencyMs);
  } catch (error) {
    tell({ kind: "broken", message: String(error) });
  } finally {
    if (hidden) owed += 1;
    else from?.send(credit);
  }
}

/** Redraws after the slider moved; decodes the camera's picture if that was skipped so far. */
async function resplit() {
  if (split > 0 && !camera && cameraPlane && cameraPlane.codec !== "none") {
    camera = await decode(cameraPlane);
  }
  draw();
}

/** @param {unknown} error */
const broken = (error) => tell({ kind: "broken", message: String(error) });

addEventListener("message", (/** @type {MessageEvent<ToWorker>} */ { data }) => {
  switch (data.kind) {
    case "start":
      canvas = data.canvas;
      context = canvas.getContext("2d", { alpha: false });
      connection = new Connection(data.url, helloMessage, {
        phase: (phase) => {
          // Credits count per connection.
          if (phase.phase === "open") owed = 0;
          tell({ kind: "phase", phase });
        },
        reply: (reply) => tell({ kind: "reply", reply }),
        broken,
        composite: (...arrived) => {
          turn = turn.then(() => show(...arrived));
        },
      });
      connection.start();
      break;
    case "hello":
      helloMessage = data.hello;
      if (!connection) break;
      connection.hello = helloMessage;
      if (data.now) connection.start();
      break;
    case "request":
      connection?.send(data.request);
      break;
    case "split":
      split = data.share;
      turn = turn.then(resplit).catch(broken);
      break;
    case "hidden":
      hidden = data.hidden;
      if (!hidden && owed > 0) {
        connection?.send({ type: "credit", n: owed });
        owed = 0;
      }
      break;
    case "retry":
      connection?.retry();
      break;
  }
});
