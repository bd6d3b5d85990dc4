/**
 * Control messages: JSON objects with a `type`. Readers return exactly the fields of the format,
 * with defaults filled in.
 */

import { CODECS, VERSION, WireError, checkCodec, checkPose } from "./wire.js";

/** Longest `name` in a hello, characters. */
const MAX_NAME = 64;
/** Revision of a server that sends none. */
const FIRST_REVISION = 1;

/** @typedef {import("./wire.js").Codec} Codec */

/**
 * Pose of an object in world space.
 * @typedef {import("./wire.js").Pose & {turned: number}} Stands
 */

/**
 * @typedef {{type: "welcome", version: number, revision: number, server: string, session: string, role: string,
 *   control: boolean, credits: number, clock_us: number, stages: string[], limits: Record<string, number>}} Welcome
 * @typedef {{type: "state", session: string, source: {kind: "recording" | "live", name: string}, scene: string | null,
 *   objects: {name: string, stands?: Stands}[], settings: Record<string, unknown>}} State
 * @typedef {{type: "done", id?: number, request: string, note?: string}} Done
 * @typedef {{type: "error", id?: number, sequence?: number, code: string, what: string, expected: string,
 *   got: string, fatal: boolean}} ErrorReply
 * @typedef {{type: "stats", frames_received: number, frames_rendered: number, frames_dropped: number,
 *   frames_refused: number, composites_sent: number, composites_dropped: number, viewers: number,
 *   source_period_us?: number, lowered?: string[]}} Stats
 * @typedef {{type: "pong", t: number, clock_us: number}} Pong
 * @typedef {{type: "bye", reason: string}} Bye
 * @typedef {Welcome | State | Done | ErrorReply | Stats | Pong | Bye} Reply
 */

/** The planes that a client requests, with their codecs. @typedef {{image: Codec, quality: number, camera: Codec, mask: Codec, depth: Codec}} Planes */

/** Checks a value and returns it as the format defines it. @typedef {(value: any, what: string) => any} Read */

/** @param {unknown} value */
const kindOf = (value) => (value === null ? "null" : Array.isArray(value) ? "array" : typeof value);

/**
 * A reader of values that satisfy `test`.
 * @param {string} expected
 * @param {(value: any) => boolean} test
 * @returns {Read}
 */
const a = (expected, test) => (value, what) => {
  if (test(value)) return value;
  throw new WireError("malformed", what, expected, kindOf(value) === "object" ? "an object" : JSON.stringify(value) ?? "nothing");
};

const text = a("a string", (v) => typeof v === "string");
const flag = a("true or false", (v) => typeof v === "boolean");
const number = a("a finite number", Number.isFinite);
const any = a("an object", (v) => kindOf(v) === "object");
const whole = (/** @type {number} */ most) => a(`an integer from 0 to ${most}`, (v) => Number.isInteger(v) && v >= 0 && v <= most);
const u8 = whole(255);
const u32 = whole(0xffff_ffff);
// Accepts larger integers than JavaScript holds exactly; JSON.parse rounds those.
const u64 = a("an integer from 0", (v) => Number.isInteger(v) && v >= 0);
const oneOf = (/** @type {string[]} */ ...names) => a(`one of ${names.join(", ")}`, (v) => names.includes(v));
const codec = oneOf(...Object.keys(CODECS));

/**
 * @param {Read} item
 * @param {number} [length]
 * @returns {Read}
 */
const list = (item, length) => (value, what) => {
  if (!Array.isArray(value) || (length !== undefined && value.length !== length)) {
    throw new WireError("malformed", what, `a list${length === undefined ? "" : ` of ${length}`}`, kindOf(value));
  }
  return value.map((v, i) => item(v, `${what}[${i}]`));
};

/** An optional field with its default; `undefined` leaves it out. */
class Missing {
  /**
   * @param {Read} read
   * @param {unknown} value
   */
  constructor(read, value) {
    this.read = read;
    this.value = value;
  }
}
const or = (/** @type {unknown} */ value, /** @type {Read} */ read) => new Missing(read, value);
/** An optional field in which `null` means missing. */
const maybe = (/** @type {Read} */ read) => new Missing((v, what) => (v === null ? undefined : read(v, what)), undefined);
const nullable = (/** @type {Read} */ read) => (/** @type {any} */ v, /** @type {string} */ what) => (v === null ? null : read(v, what));

/**
 * @param {Record<string, Read | Missing>} fields
 * @returns {Read}
 */
const object = (fields) => (value, what) => {
  if (kindOf(value) !== "object") throw new WireError("malformed", what, "an object", kindOf(value));
  /** @type {Record<string, unknown>} */
  const out = {};
  for (const [name, field] of Object.entries(fields)) {
    const has = Object.hasOwn(value, name);
    const read = field instanceof Missing ? field.read : field;
    if (!has && !(field instanceof Missing)) throw new WireError("malformed", `${what}, ${name}`, "a value", "nothing");
    const got = has ? read(value[name], `${what}, ${name}`) : /** @type {Missing} */ (field).value;
    if (got !== undefined) out[name] = got;
  }
  return out;
};

const stands = object({ translation: list(number, 3), quaternion: list(number, 4), turned: or(0, number) });
const COMPOSITE = { image: "jpeg", quality: 85, camera: "none", mask: "none", depth: "none" };
const PLANE_CODECS = { image: codec, camera: codec, mask: codec, depth: codec };

/**
 * Checks that each codec is allowed for its plane, and the range of the quality.
 * @param {Planes} planes
 * @param {string} what
 */
function checkPlanes({ image, quality, camera, mask, depth }, what) {
  checkCodec("image", image);
  checkCodec("camera", camera);
  checkCodec("mask", mask);
  checkCodec("composite depth", depth);
  if (quality < 1 || quality > 100) throw new WireError("malformed", `${what}quality`, "1 to 100", quality);
}

/** Fields of each request, and checks across fields. @type {Record<string, [Read, ((request: any) => void)?]>} */
const REQUESTS = {
  hello: [
    object({
      version: u64,
      role: oneOf("producer", "viewer"),
      token: maybe(text),
      name: or("", text),
      session: maybe(text),
      recording: maybe(text),
      scene: maybe(text),
      control: or("owner", oneOf("owner", "anyone")),
      credits: or(2, u32),
      composite: or(COMPOSITE, nullable(object({
        image: or("jpeg", codec), quality: or(85, u8), camera: or("none", codec), mask: or("none", codec), depth: or("none", codec),
      }))),
    }),
    ({ version, name, credits, composite }) => {
      if (version !== VERSION) throw new WireError("version", "hello, version", `${VERSION}`, version);
      if ([...name].length > MAX_NAME) throw new WireError("malformed", "hello, name", `at most ${MAX_NAME} characters`, [...name].length);
      if (credits === 0) throw new WireError("malformed", "hello, credits", "at least 1", 0);
      if (composite) checkPlanes(composite, "hello, composite.");
    },
  ],
  scene: [object({
    scene: a("a scene's name or document", (v) => typeof v === "string" || kindOf(v) === "object"),
  })],
  settings: [object({ settings: any })],
  asset: [object({ upload: u32, name: text, bytes: u64 })],
  play: [object({ recording: maybe(text), scene: maybe(text) })],
  planes: [
    object({ ...Object.fromEntries(Object.entries(PLANE_CODECS).map(([name, read]) => [name, maybe(read)])), quality: maybe(u8) }),
    (planes) => checkPlanes({ ...COMPOSITE, ...planes }, "planes, "),
  ],
  place: [
    object({ object: text, pixel: maybe(list(number, 2)), stands: maybe(stands) }),
    ({ pixel, stands }) => {
      if ((pixel === undefined) === (stands === undefined)) {
        throw new WireError("malformed", "place", "one of pixel and stands", pixel === undefined ? "none" : "both");
      }
      if (stands) checkPose("place, stands", stands);
    },
  ],
  turn: [object({ object: text, angle: number })],
  credit: [object({ n: or(1, u32), latency_us: maybe(u32), draw_us: maybe(u32) })],
  ping: [object({ t: number })],
  bye: [object({ reason: or("", text) })],
};

const LIMITS = ["message_bytes", "side_px", "pixels", "scene_bytes", "asset_bytes", "assets_bytes", "credits"];
const STATS = [
  "frames_received", "frames_rendered", "frames_dropped", "frames_refused", "composites_sent", "composites_dropped", "viewers",
];
const counts = (/** @type {string[]} */ names) => Object.fromEntries(names.map((name) => [name, u64]));

/** Fields of each reply. @type {typeof REQUESTS} */
const REPLIES = {
  welcome: [object({
    version: u64, revision: or(FIRST_REVISION, u32), server: text, session: text, role: oneOf("producer", "viewer"),
    control: flag, credits: u32, clock_us: u64, stages: list(text), limits: object(counts(LIMITS)),
  })],
  state: [object({
    session: text,
    source: object({ kind: oneOf("recording", "live"), name: text }),
    scene: or(null, nullable(text)),
    objects: list(object({ name: text, stands: maybe(stands) })),
    settings: (value) => value,
  })],
  done: [object({ id: maybe(u64), request: text, note: maybe(text) })],
  error: [object({
    id: maybe(u64), sequence: maybe(u64), code: text, what: text, expected: text, got: text, fatal: flag,
  })],
  stats: [object({ ...counts(STATS), source_period_us: maybe(u64), lowered: maybe(list(text)) })],
  pong: [object({ t: number, clock_us: u64 })],
  bye: REQUESTS["bye"] ?? [any],
};

/**
 * @param {string} message
 * @param {Record<string, [Read, ((value: any) => void)?]>} kinds
 */
function parse(message, kinds) {
  let body;
  try {
    body = JSON.parse(message);
  } catch (error) {
    throw new WireError("malformed", "control message", "JSON", error);
  }
  return check(body, kinds);
}

/**
 * @param {any} body
 * @param {Record<string, [Read, ((value: any) => void)?]>} kinds
 */
function check(body, kinds) {
  const { id, type } = object({ id: maybe(u64), type: text })(body, "control message");
  const kind = Object.hasOwn(kinds, type) ? kinds[type] : undefined;
  if (!kind) throw new WireError("unknown_type", "control message, type", Object.keys(kinds).join(", "), type);
  const [read, together] = kind;
  const fields = read(body, type);
  together?.(fields);
  return { type, ...(id === undefined ? {} : { id }), ...fields };
}

/**
 * Decodes a control message of the server.
 * @param {string} message
 * @returns {Reply}
 */
export const parseReply = (message) => parse(message, REPLIES);

/**
 * Decodes a control message of a client.
 * @param {string} message
 * @returns {{type: string, id?: number, [field: string]: any}}
 */
export const parseRequest = (message) => parse(message, REQUESTS);

/**
 * Encodes a request; throws if a server would reject it.
 * @param {{type: string, [field: string]: unknown}} request
 */
export const encodeRequest = (request) => JSON.stringify(check(request, REQUESTS));

/**
 * The first message of this page.
 * @param {{token?: string, session?: string, recording?: string, scene?: string}} choice
 * @param {Codec} camera codec of the camera's picture
 */
export function hello({ token, session, recording, scene }, camera = "none") {
  // An existing session has its own recording and scene.
  const what = session ? { session } : { recording, scene };
  return {
    type: "hello",
    version: VERSION,
    role: "viewer",
    name: "browser",
    credits: 2,
    composite: { image: "jpeg", quality: 85, camera },
    token,
    ...what,
  };
}
