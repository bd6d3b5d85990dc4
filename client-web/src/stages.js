/** Time of a frame in each step, from capture to drawing. */

/**
 * The steps of a frame, in order; their times add up to the latency.
 * `label` and `about` are shown on the page.
 */
export const WAYS = /** @type {const} */ ([
  { name: "waiting", label: "Waiting", about: "for the renderer, or for a credit of this page" },
  { name: "decode", label: "Read", about: "colour and depth decoded" },
  { name: "render", label: "Render", about: "ray tracing and compositing" },
  { name: "encode", label: "Encode", about: "picture compressed and handed to the network" },
  { name: "network", label: "Network", about: "sent to arrived, by the estimated server clock" },
  { name: "page", label: "Draw", about: "decoded and drawn here" },
]);

/** @typedef {(typeof WAYS)[number]["name"]} WayName */

/**
 * Measurements of one frame.
 * @typedef {object} Sample
 * @property {number} sequence
 * @property {number} drawnMs when it was drawn, this machine's clock
 * @property {number | null} latencyMs from received by the server to drawn; null while the server's clock is unknown
 * @property {Record<WayName, number>} waysMs
 * @property {number[]} stageMs render stages
 * @property {number} width
 * @property {number} height
 * @property {number} bytes
 * @property {boolean} original whether the camera's own picture came along
 * @property {number} droppedFrames so far
 * @property {number} droppedComposites so far
 * @property {number} virtualPixels
 * @property {number} tracedPixels
 * @property {number} secondaryRays
 * @property {number} unknownRays
 */

/**
 * @param {import("./composite.js").Composite} composite
 * @param {number} arrivedMs on this clock
 * @param {number} drawnMs on this clock
 * @param {number | undefined} offsetMs server's clock minus this one
 * @param {number} bytes
 * @returns {Sample}
 */
export function measure(composite, arrivedMs, drawnMs, offsetMs, bytes) {
  const s = composite.stamps;
  return {
    sequence: Number(composite.sequence),
    drawnMs,
    latencyMs: offsetMs === undefined ? null : drawnMs + offsetMs - s.received,
    waysMs: {
      waiting: s.decodeStart - s.received + (s.renderStart - s.decoded) + (s.encodeStart - s.renderEnd),
      decode: s.decoded - s.decodeStart,
      render: s.renderEnd - s.renderStart,
      encode: s.sent - s.encodeStart,
      network: offsetMs === undefined ? 0 : arrivedMs + offsetMs - s.sent,
      page: drawnMs - arrivedMs,
    },
    stageMs: composite.stageUs.map((us) => us / 1e3),
    width: composite.camera.width,
    height: composite.camera.height,
    bytes,
    original: composite.planes.camera.codec !== "none",
    droppedFrames: Number(composite.droppedFrames),
    droppedComposites: Number(composite.droppedComposites),
    virtualPixels: composite.virtualPixels,
    tracedPixels: composite.tracedPixels,
    secondaryRays: composite.secondaryRays,
    unknownRays: composite.unknownRays,
  };
}

/** The last frames, and statistics over the last seconds. */
export class History {
  /** @type {Sample[]} */
  samples = [];

  /**
   * @param {number} capacity frames kept
   * @param {number} windowMs over which statistics are taken
   */
  constructor(capacity = 150, windowMs = 3_000) {
    this.capacity = capacity;
    this.windowMs = windowMs;
  }

  /** @param {Sample} sample */
  add(sample) {
    this.samples.push(sample);
    if (this.samples.length > this.capacity) this.samples.shift();
  }

  clear() {
    this.samples = [];
  }

  /**
   * @param {number} nowMs
   */
  summary(nowMs) {
    const recent = this.samples.filter((s) => nowMs - s.drawnMs <= this.windowMs);
    const first = recent[0];
    const last = recent.at(-1);
    const spanMs = first && last ? last.drawnMs - first.drawnMs : 0;
    // n frames span n - 1 periods.
    const rate = (/** @type {number} */ n) => (spanMs > 0 ? (n * 1e3) / spanMs : 0);
    const latencies = recent.flatMap((s) => (s.latencyMs === null ? [] : [s.latencyMs]));
    return {
      fps: rate(recent.length - 1),
      bitsPerSecond: rate(recent.slice(1).reduce((sum, s) => sum + 8 * s.bytes, 0)),
      latencyMs: percentile(latencies, 0.5),
      latency95Ms: percentile(latencies, 0.95),
      waysMs: WAYS.map(({ name }) => percentile(recent.map((s) => s.waysMs[name]), 0.5)),
      stageMs: (last?.stageMs ?? []).map((_, i) => percentile(recent.map((s) => s.stageMs[i] ?? 0), 0.5)),
      last,
    };
  }
}

/**
 * Nearest-rank percentile; null for an empty list.
 * @param {number[]} values
 * @param {number} share
 */
export function percentile(values, share) {
  if (values.length === 0) return null;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.max(0, Math.ceil(share * sorted.length) - 1)] ?? null;
}
