/** Where the server's clock stands, seen from this one. */

/** Pings remembered: old ones are forgotten, since two clocks drift apart. */
const WINDOW = 16;

/** Estimates the server's clock from pings: the one with the shortest round trip is right. */
export class ServerClock {
  /** @type {{offsetMs: number, roundTripMs: number}[]} */
  #samples = [];

  /**
   * A ping's answer. All times in milliseconds since the Unix epoch.
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

  /** What to add to this clock's time to get the server's; `undefined` before the first pong. */
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
