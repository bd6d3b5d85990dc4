/**
 * Shared parts of the wire format (`proto/README.md`): errors, codecs, header fields, cameras and
 * poses. Independent of sockets and of image decoding.
 */

/** WebSocket subprotocol that a client must offer. */
export const SUBPROTOCOL = "ghostlight.v1";

/** Version of the format. */
export const VERSION = 1;

/** First two bytes of a binary message, "GL", as a little-endian number. */
const MAGIC = 0x4c47;

/** Largest image side of the format, pixels. */
export const MAX_SIDE = 8192;

/** Largest deviation of a quaternion's squared length from 1. */
const MAX_DEVIATION = 0.01;

/** Largest distance of a pose from the origin along each axis, metres. */
const MAX_DISTANCE_M = 1e9;

/** Longest text per part of an error, so that it does not echo a whole hostile message. */
const MAX_TEXT = 300;

/** An invalid message; `code` is one of the format's error codes. */
export class WireError extends Error {
  /**
   * @param {string} code
   * @param {string} what message and field
   * @param {string} expected
   * @param {unknown} got
   */
  constructor(code, what, expected, got) {
    const cut = (/** @type {unknown} */ part) => {
      const text = String(part);
      return text.length > MAX_TEXT ? `${text.slice(0, MAX_TEXT)}...` : text;
    };
    super(`${cut(what)}: expected ${cut(expected)}, got ${cut(got)}`);
    this.name = "WireError";
    this.code = code;
  }
}

/** Kinds of binary messages, by name. */
export const KINDS = /** @type {const} */ ({ frame: 1, composite: 2, "asset chunk": 3 });
/** @typedef {keyof typeof KINDS} Kind */

/** Codes of the codecs, by name. */
export const CODECS = /** @type {const} */ ({
  none: 0, jpeg: 1, png: 2, rgb8: 3, rgba8: 4, gray8: 5, u16: 16, rvl: 17, delta_zstd: 18,
});
/** @typedef {keyof typeof CODECS} Codec */

/** Bytes per pixel of the uncompressed codecs. @type {Partial<Record<Codec, number>>} */
const PIXEL_BYTES = { gray8: 1, u16: 2, rgb8: 3, rgba8: 4 };

const COLOUR = /** @type {const} */ (["jpeg", "png", "rgb8", "rgba8"]);
const DEPTH = /** @type {const} */ (["png", "u16", "rvl", "delta_zstd"]);

/** Codecs allowed for each plane. @type {Record<PlaneName, readonly Codec[]>} */
const ALLOWED = {
  color: COLOUR,
  depth: DEPTH,
  image: COLOUR,
  camera: ["none", ...COLOUR],
  mask: ["none", "png", "gray8"],
  "composite depth": ["none", ...DEPTH],
};

/** @typedef {"color" | "depth" | "image" | "camera" | "mask" | "composite depth"} PlaneName */

/** An encoded image. @typedef {{codec: Codec, bytes: Uint8Array<ArrayBuffer>}} Plane */
/** A rigid motion; the quaternion is x, y, z, w. @typedef {{translation: number[], quaternion: number[]}} Pose */
/** A pinhole camera, pixels. @typedef {{width: number, height: number, fx: number, fy: number, cx: number, cy: number}} Camera */

/**
 * Throws if the codec is not allowed for the plane.
 * @param {PlaneName} plane
 * @param {unknown} codec its name
 * @returns {Codec}
 */
export function checkCodec(plane, codec) {
  const found = ALLOWED[plane].find((name) => name === codec);
  if (found === undefined) throw new WireError("codec", `${plane} codec`, ALLOWED[plane].join(", "), codec);
  return found;
}

/**
 * The codec of a plane by its code.
 * @param {PlaneName} plane
 * @param {number} code
 */
export function codecOf(plane, code) {
  const found = ALLOWED[plane].find((name) => CODECS[name] === code);
  return found ?? checkCodec(plane, code);
}

/**
 * Throws if the payload cannot be an image of the camera's size.
 * @param {PlaneName} name
 * @param {Plane} plane
 * @param {Camera} camera
 */
export function checkPlane(name, { codec, bytes }, { width, height }) {
  checkCodec(name, codec);
  if (!(bytes instanceof Uint8Array)) throw new WireError("malformed", `${name} payload`, "bytes", typeof bytes);
  const pixelBytes = codec === "none" ? 0 : PIXEL_BYTES[codec];
  const n = pixelBytes === undefined ? undefined : pixelBytes * width * height;
  if (n === undefined ? bytes.length > 0 : bytes.length === n) return;
  throw new WireError("size", `${name} payload (${codec})`, `${n ?? "at least 1"} bytes`, `${bytes.length} bytes`);
}

/**
 * Throws if the pose is not a rigid motion.
 * @param {string} what
 * @param {Pose} pose
 */
export function checkPose(what, { translation, quaternion }) {
  for (const [part, values, n] of /** @type {const} */ ([["translation", translation, 3], ["quaternion", quaternion, 4]])) {
    if (!Array.isArray(values) || values.length !== n || !values.every(Number.isFinite)) {
      throw new WireError("pose", `${what} ${part}`, `${n} finite numbers`, values);
    }
  }
  const far = translation.find(x => Math.abs(x) > MAX_DISTANCE_M);
  if (far !== undefined) throw new WireError("pose", `${what} translation`, "at most 1e9 m from the origin", `${far} m`);
  const squared = quaternion.reduce((sum, x) => sum + x * x, 0);
  // Also false for the infinity that huge components square to.
  if (Math.abs(squared - 1) <= MAX_DEVIATION) return;
  throw new WireError("pose", `${what} quaternion`, "a unit quaternion", `squared length ${squared}`);
}

/**
 * Throws on an invalid size or invalid intrinsics.
 * @param {string} what
 * @param {Camera} camera
 */
export function checkCamera(what, camera) {
  const side = (/** @type {number} */ n) => Number.isInteger(n) && n >= 1 && n <= MAX_SIDE;
  if (!side(camera.width) || !side(camera.height)) {
    throw new WireError("size", `${what} size`, `1x1 to ${MAX_SIDE}x${MAX_SIDE}`, `${camera.width}x${camera.height}`);
  }
  for (const field of /** @type {const} */ (["fx", "fy", "cx", "cy"])) {
    const got = camera[field];
    const good = Number.isFinite(got) && (field.startsWith("c") || got > 0);
    if (!good) throw new WireError("intrinsics", `${what} ${field}`, "a finite number, focal lengths above 0", got);
  }
}

/** Reads the header of a message; the constructor checks that its fixed part is complete. */
export class Header {
  /**
   * @param {ArrayBuffer | Uint8Array<ArrayBuffer>} message
   * @param {Kind} kind
   * @param {number} fixed bytes of this version's header
   */
  constructor(message, kind, fixed) {
    const bytes = message instanceof Uint8Array ? message : new Uint8Array(message);
    this.bytes = bytes;
    this.kind = kind;
    this.view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    const { length } = bytes;
    if (length < 4) throw new WireError("malformed", "binary message", "a header", `${length} bytes`);
    if (this.view.getUint16(0, true) !== MAGIC) {
      throw new WireError("malformed", "binary message, offset 0", "GL", `0x${this.view.getUint16(0).toString(16)}`);
    }
    const [version, code] = [this.u8(2), this.u8(3)];
    if (version !== VERSION) throw new WireError("version", "binary message, version", `${VERSION}`, version);
    if (code !== KINDS[kind]) throw new WireError("unknown_type", `${kind}, kind`, `${KINDS[kind]}`, code);
    if (length < fixed) throw new WireError("malformed", `${kind} header`, `at least ${fixed} bytes`, `${length} bytes`);
    /** Where the payloads start. */
    this.end = this.u32(4);
    if (this.end < fixed || this.end > length) {
      throw new WireError("malformed", `${kind}, header bytes`, `${fixed} to ${length} (the message)`, this.end);
    }
  }

  /** @param {number} at */
  u8(at) {
    return this.view.getUint8(at);
  }
  /** @param {number} at */
  u32(at) {
    return this.view.getUint32(at, true);
  }
  /** @param {number} at */
  u64(at) {
    return this.view.getBigUint64(at, true);
  }
  /** @param {number} at */
  i64(at) {
    return this.view.getBigInt64(at, true);
  }
  /** @param {number} at */
  f32(at) {
    return this.view.getFloat32(at, true);
  }
  /** @param {number} at */
  f64(at) {
    return this.view.getFloat64(at, true);
  }
  /**
   * @param {number} at
   * @param {number} n
   */
  f64s(at, n) {
    return Array.from({ length: n }, (_, i) => this.f64(at + 8 * i));
  }
  /**
   * @param {number} at
   * @returns {Pose}
   */
  pose(at) {
    return { translation: this.f64s(at, 3), quaternion: this.f64s(at + 24, 4) };
  }
  /**
   * @param {number} at
   * @returns {Camera}
   */
  camera(at) {
    const f = (/** @type {number} */ i) => this.f64(at + 8 + 8 * i);
    return { width: this.u32(at), height: this.u32(at + 4), fx: f(0), fy: f(1), cx: f(2), cy: f(3) };
  }

  /**
   * Splits everything after the header into payloads of the announced sizes; views into the
   * message.
   * @param {number[]} sizes
   */
  payloads(sizes) {
    const left = this.bytes.length - this.end;
    const announced = sizes.reduce((sum, n) => sum + n, 0);
    if (announced !== left) {
      throw new WireError("length", `${this.kind}, payload bytes`, `${left} (what follows the header)`, announced);
    }
    let at = this.end;
    return sizes.map((n) => this.bytes.subarray(at, (at += n)));
  }
}

/** Builds a message by writing fields at their offsets. */
export class HeaderWriter {
  /**
   * @param {Kind} kind
   * @param {number} headerBytes
   * @param {Uint8Array[]} payloads
   */
  constructor(kind, headerBytes, payloads) {
    const length = payloads.reduce((sum, p) => sum + p.length, headerBytes);
    this.bytes = new Uint8Array(length);
    this.view = new DataView(this.bytes.buffer);
    this.view.setUint16(0, MAGIC, true);
    this.u8(2, VERSION);
    this.u8(3, KINDS[kind]);
    this.u32(4, "header bytes", headerBytes);
    let at = headerBytes;
    for (const payload of payloads) {
      this.bytes.set(payload, at);
      at += payload.length;
    }
  }

  /**
   * @param {number} at
   * @param {number} value
   */
  u8(at, value) {
    this.view.setUint8(at, value);
  }
  /**
   * @param {number} at
   * @param {string} what
   * @param {number} value
   */
  u32(at, what, value) {
    if (!Number.isInteger(value) || value < 0 || value > 0xffff_ffff) {
      throw new WireError("malformed", what, "an integer of 32 bits", value);
    }
    this.view.setUint32(at, value, true);
  }
  /**
   * @param {number} at
   * @param {string} what
   * @param {bigint | number} value
   */
  u64(at, what, value) {
    this.view.setBigUint64(at, integer(what, value, BigInt.asUintN), true);
  }
  /**
   * @param {number} at
   * @param {string} what
   * @param {bigint | number} value
   */
  i64(at, what, value) {
    this.view.setBigInt64(at, integer(what, value, BigInt.asIntN), true);
  }
  /**
   * @param {number} at
   * @param {number} value
   */
  f32(at, value) {
    this.view.setFloat32(at, value, true);
  }
  /**
   * @param {number} at
   * @param {number[]} values
   */
  f64s(at, values) {
    values.forEach((value, i) => this.view.setFloat64(at + 8 * i, value, true));
  }
  /**
   * @param {number} at
   * @param {Pose} pose
   */
  pose(at, { translation, quaternion }) {
    this.f64s(at, translation);
    this.f64s(at + 24, quaternion);
  }
  /**
   * @param {number} at
   * @param {Camera} camera
   */
  camera(at, { width, height, fx, fy, cx, cy }) {
    this.u32(at, "width", width);
    this.u32(at + 4, "height", height);
    this.f64s(at + 8, [fx, fy, cx, cy]);
  }
}

/**
 * @param {string} what
 * @param {bigint | number} value
 * @param {(bits: number, value: bigint) => bigint} cut
 */
function integer(what, value, cut) {
  const good = typeof value === "bigint" ? cut(64, value) === value : Number.isSafeInteger(value);
  const big = good ? BigInt(value) : 0n;
  if (!good || cut(64, big) !== big) throw new WireError("malformed", what, "an integer of 64 bits", value);
  return big;
}
