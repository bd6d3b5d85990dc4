/**
 * A WebSocket connection that reconnects by itself. It handles the conversation (hello, pings,
 * credits), not pictures.
 */

import { ServerClock, nowMs } from "./clock.js";
import { decodeComposite } from "./composite.js";
import { parseReply } from "./control.js";
import { SUBPROTOCOL } from "./wire.js";

/** Delay before the second attempt; each failure doubles it. */
const FIRST_RETRY_MS = 500;
/** Longest delay. */
const LAST_RETRY_MS = 15_000;
/** Silence after which the connection counts as lost; the server sends something every second. */
const SILENCE_MS = 6_000;
/** Timeout of an attempt. */
const OPEN_MS = 8_000;
/** The first pings are frequent, for an early estimate of the server's clock. */
const FIRST_PINGS = 5;
const FIRST_PING_MS = 150;
const PING_MS = 2_000;

/** Errors after which reconnecting would fail again. */
const FINAL = new Set(["unauthorized", "version", "hello", "malformed", "unknown_type", "codec", "not_found", "forbidden", "scene"]);

/**
 * Delay before attempt `attempt` (from 1): exponential and half random, so that the clients of a
 * restarted server do not all reconnect at once.
 * @param {number} attempt
 * @param {() => number} random
 */
export function retryDelayMs(attempt, random = Math.random) {
  const whole = Math.min(LAST_RETRY_MS, FIRST_RETRY_MS * 2 ** Math.min(attempt - 1, 16));
  return whole * (0.5 + 0.5 * random());
}

/**
 * @typedef {{phase: "connecting", attempt: number}
 *   | {phase: "open"}
 *   | {phase: "waiting", attempt: number, retryAtMs: number, reason: string}
 *   | {phase: "refused", code: string, reason: string}
 *   | {phase: "closed"}} Phase
 */

/**
 * @typedef {object} Handlers
 * @property {(phase: Phase) => void} phase
 * @property {(reply: import("./control.js").Reply) => void} reply every control message but pongs
 * @property {(composite: import("./composite.js").Composite, arrivedMs: number, bytes: number) => void} composite
 * @property {(error: Error) => void} broken a message that cannot be decoded
 */

export class Connection {
  /** @type {WebSocket | null} */
  #socket = null;
  /** @type {Set<ReturnType<typeof setTimeout>>} */
  #timers = new Set();
  #attempt = 0;
  #pings = 0;
  #lastHeardMs = 0;
  /** The server's last fatal error, shown when the connection closes. */
  #reason = "";
  #refusedBy = "";
  /** Estimate of the server's clock, one per connection. */
  clock = new ServerClock();
  /** @type {Phase} */
  phase = { phase: "closed" };

  /**
   * @param {string} url
   * @param {object} hello first message; may be replaced for the next attempt
   * @param {Handlers} handlers
   * @param {{Socket?: typeof WebSocket, random?: () => number}} [outside] replaced in tests
   */
  constructor(url, hello, handlers, { Socket = globalThis.WebSocket, random = Math.random } = {}) {
    this.url = url;
    this.hello = hello;
    this.handlers = handlers;
    this.Socket = Socket;
    this.random = random;
  }

  /** Connects now; an existing connection is dropped. */
  start() {
    this.#drop();
    this.#attempt += 1;
    this.#reason = "";
    this.#refusedBy = "";
    this.#pings = 0;
    this.clock = new ServerClock();
    this.#enter({ phase: "connecting", attempt: this.#attempt });
    const socket = new this.Socket(this.url, SUBPROTOCOL);
    this.#socket = socket;
    socket.binaryType = "arraybuffer";
    this.#later(OPEN_MS, () => {
      if (this.phase.phase === "connecting") this.#lost("server does not answer");
    });
    // Ignores events of a socket that was dropped.
    const ours = (/** @type {(event: any) => void} */ act) => (/** @type {any} */ event) => {
      if (this.#socket === socket) act(event);
    };
    socket.onopen = ours(() => socket.send(JSON.stringify(this.hello)));
    socket.onmessage = ours((event) => this.#message(event.data));
    socket.onclose = ours((event) => this.#lost(this.#reason || event.reason || "no connection to the server"));
  }

  /** Closes the connection and does not reconnect. */
  stop() {
    this.#drop();
    this.#attempt = 0;
    this.#enter({ phase: "closed" });
  }

  /** If waiting, tries now; the delays continue as they were. */
  retry() {
    if (this.phase.phase === "waiting") this.start();
  }

  /**
   * Sends a control message; returns false without an open connection.
   * @param {object} message
   */
  send(message) {
    if (this.phase.phase !== "open" || !this.#socket) return false;
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  /** @param {unknown} data */
  #message(data) {
    const arrivedMs = nowMs();
    this.#lastHeardMs = arrivedMs;
    try {
      if (typeof data === "string") this.#control(parseReply(data), arrivedMs);
      else if (data instanceof ArrayBuffer) {
        this.handlers.composite(decodeComposite(data), arrivedMs, data.byteLength);
      }
    } catch (error) {
      // A composite that cannot be decoded still used a credit.
      if (typeof data !== "string") this.send({ type: "credit" });
      this.handlers.broken(error instanceof Error ? error : new Error(String(error)));
    }
  }

  /**
   * @param {import("./control.js").Reply} reply
   * @param {number} arrivedMs
   */
  #control(reply, arrivedMs) {
    if (reply.type === "pong") {
      this.clock.add(reply.t, arrivedMs, reply.clock_us / 1e3);
      return;
    }
    if (reply.type === "welcome") {
      this.#attempt = 0;
      this.#enter({ phase: "open" });
      this.#ping();
      this.#watch();
    } else if (reply.type === "error" && reply.fatal) {
      this.#reason = `${reply.what}: expected ${reply.expected}, got ${reply.got}`;
      if (FINAL.has(reply.code)) this.#refusedBy = reply.code;
    } else if (reply.type === "bye") {
      this.#reason ||= reply.reason;
    }
    this.handlers.reply(reply);
  }

  #ping() {
    this.#pings += 1;
    this.send({ type: "ping", t: nowMs() });
    this.#later(this.#pings < FIRST_PINGS ? FIRST_PING_MS : PING_MS, () => this.#ping());
  }

  #watch() {
    this.#later(SILENCE_MS / 3, () => {
      if (nowMs() - this.#lastHeardMs > SILENCE_MS) this.#lost("no message from the server");
      else this.#watch();
    });
  }

  /** @param {string} reason */
  #lost(reason) {
    this.#drop();
    if (this.#refusedBy) {
      this.#attempt = 0;
      this.#enter({ phase: "refused", code: this.#refusedBy, reason });
      return;
    }
    const attempt = Math.max(1, this.#attempt);
    const delay = retryDelayMs(attempt, this.random);
    this.#enter({ phase: "waiting", attempt, retryAtMs: nowMs() + delay, reason });
    this.#later(delay, () => this.start());
  }

  /** Drops the socket and all timers. */
  #drop() {
    for (const timer of this.#timers) clearTimeout(timer);
    this.#timers.clear();
    const socket = this.#socket;
    this.#socket = null;
    // 0: connecting, 1: open.
    if (socket && socket.readyState <= 1) socket.close();
  }

  /**
   * @param {number} ms
   * @param {() => void} act
   */
  #later(ms, act) {
    const timer = setTimeout(() => {
      this.#timers.delete(timer);
      act();
    }, ms);
    this.#timers.add(timer);
  }

  /** @param {Phase} phase */
  #enter(phase) {
    this.phase = phase;
    this.handlers.phase(phase);
  }
}
