/** Composites: the server's result for a frame, with its planes, counts and times. */

import { CODECS, Header, HeaderWriter, WireError, checkCamera, checkPlane, checkPose, codecOf } from "./wire.js";

const HEADER_BYTES = 240;
/** Largest number of render stages. */
const MAX_STAGES = 64;

const STAMPS = /** @type {const} */ ([
  "received", "decodeStart", "decoded", "renderStart", "renderEnd", "encodeStart", "encoded", "sent",
]);
const PLANES = /** @type {const} */ (["image", "camera", "mask", "depth"]);

/** @typedef {(typeof STAMPS)[number]} StampName */
/** @typedef {(typeof PLANES)[number]} CompositePlane */
/** @typedef {import("./wire.js").Plane} Plane */

/**
 * Moments of a frame on the server's clock, milliseconds since the Unix epoch (exact to 256 ns).
 * @typedef {object} Stamps
 * @property {number} received complete at the server
 * @property {number} decodeStart
 * @property {number} decoded
 * @property {number} renderStart
 * @property {number} renderEnd
 * @property {number} encodeStart
 * @property {number} encoded
 * @property {number} sent
 */

/**
 * @typedef {object} Composite
 * @property {bigint} sequence
 * @property {bigint} captureNs on the capturing machine's clock
 * @property {import("./wire.js").Pose} pose world_from_camera
 * @property {import("./wire.js").Camera} camera
 * @property {Record<StampName, bigint>} stampsNs
 * @property {Stamps} stamps
 * @property {bigint} droppedFrames of the session, never rendered
 * @property {bigint} droppedComposites not sent to this client
 * @property {number} virtualPixels
 * @property {number} tracedPixels
 * @property {number} secondaryRays
 * @property {number} unknownRays
 * @property {number[]} stageUs microseconds per render stage
 * @property {Record<CompositePlane, Plane>} planes views into the message
 */

/** @param {CompositePlane} name */
const wireName = (name) => (name === "depth" ? "composite depth" : name);

/** @param {Pick<Composite, "pose" | "camera" | "stageUs" | "planes">} composite */
function check({ pose, camera, stageUs, planes }) {
  checkPose("composite pose", pose);
  checkCamera("composite", camera);
  if (stageUs.length > MAX_STAGES) {
    throw new WireError("malformed", "composite, number of stages", `at most ${MAX_STAGES}`, stageUs.length);
  }
  for (const name of PLANES) checkPlane(wireName(name), planes[name], camera);
}

/**
 * Decodes and checks a composite. Its planes stay encoded and are views into the message.
 * @param {ArrayBuffer | Uint8Array<ArrayBuffer>} message
 * @returns {Composite}
 */
export function decodeComposite(message) {
  const h = new Header(message, "composite", HEADER_BYTES);
  const nStages = h.u8(236);
  if (h.end < HEADER_BYTES + 4 * nStages) {
    const expected = `at least ${HEADER_BYTES + 4 * nStages} for ${nStages} stages`;
    throw new WireError("malformed", "composite, header bytes", expected, h.end);
  }
  const codecs = PLANES.map((name, i) => codecOf(wireName(name), h.u8(200 + i)));
  const payloads = h.payloads(PLANES.map((_, i) => h.u32(204 + 4 * i)));
  const planes = /** @type {Record<CompositePlane, Plane>} */ ({});
  PLANES.forEach((name, i) => {
    planes[name] = /** @type {Plane} */ ({ codec: codecs[i], bytes: payloads[i] });
  });
  const stampsNs = /** @type {Record<StampName, bigint>} */ ({});
  const stamps = /** @type {Stamps} */ ({});
  STAMPS.forEach((name, i) => {
    stampsNs[name] = h.i64(120 + 8 * i);
    stamps[name] = Number(stampsNs[name]) / 1e6;
  });
  const composite = {
    sequence: h.u64(8),
    captureNs: h.i64(16),
    pose: h.pose(24),
    camera: h.camera(80),
    stampsNs,
    stamps,
    droppedFrames: h.u64(184),
    droppedComposites: h.u64(192),
    virtualPixels: h.u32(220),
    tracedPixels: h.u32(224),
    secondaryRays: h.u32(228),
    unknownRays: h.u32(232),
    stageUs: Array.from({ length: nStages }, (_, i) => h.u32(HEADER_BYTES + 4 * i)),
    planes,
  };
  check(composite);
  return composite;
}

/**
 * Encodes a composite as servers do; for tests of clients.
 * @param {Omit<Composite, "stamps">} composite
 */
export function encodeComposite(composite) {
  check(composite);
  const { planes, stageUs } = composite;
  const headerBytes = Math.ceil((HEADER_BYTES + 4 * stageUs.length) / 8) * 8;
  const out = new HeaderWriter("composite", headerBytes, PLANES.map((name) => planes[name].bytes));
  out.u64(8, "composite sequence", composite.sequence);
  out.i64(16, "composite capture time", composite.captureNs);
  out.pose(24, composite.pose);
  out.camera(80, composite.camera);
  STAMPS.forEach((name, i) => out.i64(120 + 8 * i, `composite ${name}`, composite.stampsNs[name]));
  out.u64(184, "dropped frames", composite.droppedFrames);
  out.u64(192, "dropped composites", composite.droppedComposites);
  PLANES.forEach((name, i) => {
    out.u8(200 + i, CODECS[planes[name].codec]);
    out.u32(204 + 4 * i, `${name} bytes`, planes[name].bytes.length);
  });
  const { virtualPixels, tracedPixels, secondaryRays, unknownRays } = composite;
  [virtualPixels, tracedPixels, secondaryRays, unknownRays].forEach((n, i) => out.u32(220 + 4 * i, "composite counts", n));
  out.u8(236, stageUs.length);
  stageUs.forEach((us, i) => out.u32(HEADER_BYTES + 4 * i, "stage time", us));
  return out.bytes;
}
