/** Offset between the server's clock and this one. */

/** Number of recent pings used; older ones are dropped because clocks drift. */
const WINDOW = 16;

/** Estimates the server's clock from pings; the one with the shortest round trip counts. */
export class ServerClock {
  /** @type {{offsetMs: number, roundTripMs: number}[]} */
  #samples = [];

  /**
   * Adds the answer to a ping. All times in milliseconds since the Unix epoch.
   * @param {number} sentMs on this clock
   * @param {number} receivedMs on this clock
   * @param {number} serverMs on the server's
   */
  add(sentMs, receivedMs, serverMs) {
    const roundTripMs = receivedMs - sentMs;
    if (!(roundTripMs >= 0)) return;
    this.#samples.push({ offsetMs: serverMs - (sentMs + receivedMs) / 2, roundTripMs });
    if (this.#samples.length > WINDOW) this.#samples.shift();
  }

  get #best() {
    return this.#samples.reduce(
      (best, s) => (best && best.roundTripMs <= s.roundTripMs ? best : s),
      /** @type {{offsetMs: number, roundTripMs: number} | undefined} */ (undefined),
    );
  }

  /** Server's clock minus this clock, milliseconds; `undefined` before the first pong. */
  get offsetMs() {
    return this.#best?.offsetMs;
  }

  /** Shortest round trip; half of it bounds the error of the offset. */
  get roundTripMs() {
    return this.#best?.roundTripMs;
  }
}

/** Now, milliseconds since the Unix epoch, advancing monotonically. */
export const nowMs = () => performance.timeOrigin + performance.now();
