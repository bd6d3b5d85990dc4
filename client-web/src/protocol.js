/**
 * Messages of the wire format (`proto/README.md`), as far as a viewer needs them.
 * Knows nothing of sockets or pictures.
 */

/** What the WebSocket must offer. */
export const SUBPROTOCOL = "ghostlight.v1";

/** Version of the format. */
export const VERSION = 1;

const KIND_COMPOSITE = 2;
const COMPOSITE_HEADER_BYTES = 240;

/** Codecs by their code. */
const CODECS = /** @type {const} */ ({
  0: "none", 1: "jpeg", 2: "png", 3: "rgb8", 4: "rgba8", 5: "gray8", 16: "u16", 17: "rvl", 18: "delta_zstd",
});

/** @typedef {(typeof CODECS)[keyof typeof CODECS]} Codec */

const COLOUR = /** @type {readonly string[]} */ (["jpeg", "png", "rgb8", "rgba8"]);

/** Codecs that each plane of a composite may have. */
const ALLOWED = {
  image: COLOUR,
  camera: ["none", ...COLOUR],
  mask: ["none", "png", "gray8"],
  depth: ["none", "png", "u16", "rvl", "delta_zstd"],
};

/** @typedef {keyof typeof ALLOWED} PlaneName */
/** @typedef {{codec: Codec, bytes: Uint8Array<ArrayBuffer>}} Plane */

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
 * @property {bigint} captureNs on the clock of whoever captured
 * @property {{translation: number[], quaternion: number[]}} pose world_from_camera
 * @property {{width: number, height: number, fx: number, fy: number, cx: number, cy: number}} camera
 * @property {Record<StampName, bigint>} stampsNs
 * @property {Stamps} stamps
 * @property {bigint} droppedFrames of the session, never rendered
 * @property {bigint} droppedComposites not sent to this client
 * @property {number} virtualPixels
 * @property {number} tracedPixels
 * @property {number} secondaryRays
 * @property {number} unknownRays
 * @property {number[]} stageUs microseconds per render stage
 * @property {Record<PlaneName, Plane>} planes views into the message
 */

const STAMPS = /** @type {const} */ ([
  "received", "decodeStart", "decoded", "renderStart", "renderEnd", "encodeStart", "encoded", "sent",
]);

/** @typedef {(typeof STAMPS)[number]} StampName */

/** A message that cannot be used; `code` is one of the format's error codes. */
export class WireError extends Error {
  /**
   * @param {string} code
   * @param {string} what
   * @param {string} expected
   * @param {unknown} got
   */
  constructor(code, what, expected, got) {
    super(`${what}: expected ${expected}, got ${got}`);
    this.name = "WireError";
    this.code = code;
  }
}

/**
 * Reads a composite. Its planes are views into `buffer`.
 * @param {ArrayBuffer} buffer
 * @returns {Composite}
 */
export function decodeComposite(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < 4) {
    throw new WireError("malformed", "message", "a header", `${buffer.byteLength} bytes`);
  }
  if (view.getUint16(0, true) !== 0x4c47) {
    throw new WireError("malformed", "message, first bytes", "GL", `0x${view.getUint16(0).toString(16)}`);
  }
  if (view.getUint8(2) !== VERSION) {
    throw new WireError("version", "message, version", String(VERSION), view.getUint8(2));
  }
  if (view.getUint8(3) !== KIND_COMPOSITE) {
    throw new WireError("unknown_type", "message, kind", `${KIND_COMPOSITE} (composite)`, view.getUint8(3));
  }
  if (buffer.byteLength < COMPOSITE_HEADER_BYTES) {
    const expected = `at least ${COMPOSITE_HEADER_BYTES} bytes`;
    throw new WireError("malformed", "composite", expected, `${buffer.byteLength} bytes`);
  }
  const u32 = (/** @type {number} */ at) => view.getUint32(at, true);
  const f64 = (/** @type {number} */ at, /** @type {number} */ n) =>
    Array.from({ length: n }, (_, i) => view.getFloat64(at + 8 * i, true));

  const start = u32(4);
  const nStages = view.getUint8(236);
  if (start < COMPOSITE_HEADER_BYTES + 4 * nStages || start > buffer.byteLength) {
    const expected = `${COMPOSITE_HEADER_BYTES + 4 * nStages} to ${buffer.byteLength}`;
    throw new WireError("malformed", "composite, header bytes", expected, start);
  }
  const [fx, fy, cx, cy] = /** @type {[number, number, number, number]} */ (f64(88, 4));
  const stampsNs = /** @type {Record<StampName, bigint>} */ ({});
  const stamps = /** @type {Stamps} */ ({});
  STAMPS.forEach((name, i) => {
    stampsNs[name] = view.getBigInt64(120 + 8 * i, true);
    stamps[name] = Number(stampsNs[name]) / 1e6;
  });
  return {
    sequence: view.getBigUint64(8, true),
    captureNs: view.getBigInt64(16, true),
    pose: { translation: f64(24, 3), quaternion: f64(48, 4) },
    camera: { width: u32(80), height: u32(84), fx, fy, cx, cy },
    stampsNs,
    stamps,
    droppedFrames: view.getBigUint64(184, true),
    droppedComposites: view.getBigUint64(192, true),
    virtualPixels: u32(220),
    tracedPixels: u32(224),
    secondaryRays: u32(228),
    unknownRays: u32(232),
    stageUs: Array.from({ length: nStages }, (_, i) => u32(COMPOSITE_HEADER_BYTES + 4 * i)),
    planes: planes(view, start),
  };
}

/**
 * @param {DataView<ArrayBuffer>} view
 * @param {number} start
 * @returns {Record<PlaneName, Plane>}
 */
function planes(view, start) {
  let at = start;
  const found = /** @type {Record<PlaneName, Plane>} */ ({});
  /** @type {PlaneName[]} */ (["image", "camera", "mask", "depth"]).forEach((name, i) => {
    const code = view.getUint8(200 + i);
    const length = view.getUint32(204 + 4 * i, true);
    const codec = CODECS[/** @type {keyof typeof CODECS} */ (code)];
    if (codec === undefined || !ALLOWED[name].includes(codec)) {
      throw new WireError("codec", `composite, ${name} codec`, ALLOWED[name].join(", "), codec ?? code);
    }
    if (at + length > view.byteLength) {
      throw new WireError("length", `composite, ${name}`, `${length} bytes`, `${view.byteLength - at}`);
    }
    found[name] = { codec, bytes: new Uint8Array(view.buffer, at, length) };
    at += length;
  });
  if (at !== view.byteLength) {
    throw new WireError("length", "composite", `${at} bytes`, `${view.byteLength}`);
  }
  return found;
}

/**
 * @typedef {{type: "welcome", version: number, server: string, session: string, role: string, control: boolean,
 *   credits: number, clock_us: number, stages: string[], limits: Record<string, number>}} Welcome
 * @typedef {{type: "state", session: string, source: {kind: "recording" | "live", name: string},
 *   scene: string | null, objects: {name: string}[], settings: Record<string, unknown>}} State
 * @typedef {{type: "done", id?: number, request: string}} Done
 * @typedef {{type: "error", id?: number, sequence?: number, code: string, what: string, expected: string,
 *   got: string, fatal?: boolean}} ErrorReply
 * @typedef {{type: "stats", frames_received: number, frames_rendered: number, frames_dropped: number,
 *   frames_refused: number, composites_sent: number, composites_dropped: number, viewers: number}} Stats
 * @typedef {{type: "pong", t: number, clock_us: number}} Pong
 * @typedef {{type: "bye", reason: string}} Bye
 * @typedef {Welcome | State | Done | ErrorReply | Stats | Pong | Bye} Reply
 */

/** What must be there in each reply, and of which kind, before anything relies on it. */
const FIELDS = /** @type {Record<string, Record<string, string>>} */ ({
  welcome: { session: "string", control: "boolean", clock_us: "number", stages: "array", limits: "object" },
  state: { session: "string", source: "object", objects: "array", settings: "object" },
  done: { request: "string" },
  error: { code: "string", what: "string", expected: "string", got: "string" },
  stats: { frames_dropped: "number", composites_dropped: "number", viewers: "number" },
  pong: { t: "number", clock_us: "number" },
  bye: { reason: "string" },
});

/**
 * Reads a control message of the server.
 * @param {string} text
 * @returns {Reply}
 */
export function parseReply(text) {
  let reply;
  try {
    reply = JSON.parse(text);
  } catch (error) {
    throw new WireError("malformed", "control message", "JSON", error);
  }
  const kind = (/** @type {unknown} */ value) =>
    value === null ? "null" : Array.isArray(value) ? "array" : typeof value;
  if (kind(reply) !== "object" || typeof reply.type !== "string") {
    throw new WireError("malformed", "control message", "an object with a type", kind(reply));
  }
  const fields = Object.hasOwn(FIELDS, reply.type) ? FIELDS[reply.type] : undefined;
  if (!fields) throw new WireError("unknown_type", "control message, type", Object.keys(FIELDS).join(", "), reply.type);
  for (const [name, expected] of Object.entries(fields)) {
    if (kind(reply[name]) !== expected) {
      throw new WireError("malformed", `${reply.type}, ${name}`, expected, kind(reply[name]));
    }
  }
  return reply;
}

/**
 * The first message of a viewer.
 * @param {{token?: string, session?: string, recording?: string, scene?: string}} choice
 */
export function hello({ token, session, recording, scene }) {
  // A session that exists has its own recording and scene.
  const what = session ? { session } : { recording, scene };
  return {
    type: "hello",
    version: VERSION,
    role: "viewer",
    name: "browser",
    credits: 2,
    composite: { image: "jpeg", quality: 85, camera: "jpeg" },
    token,
    ...what,
  };
}
