/**
 * Requests in flight. Changes that come faster than the server answers (a slider, a drag) are
 * merged: each lane has at most one request in flight and one waiting.
 */
export class Requests {
  #next = 1;
  /** @type {Map<number, {lane: string}>} */
  #open = new Map();
  /** @type {Map<string, {inFlight: boolean, waiting: object | null}>} */
  #lanes = new Map();

  /** @param {(message: object) => void} send */
  constructor(send) {
    this.send = send;
  }

  /**
   * @param {string} lane requests of one lane are sent one at a time
   * @param {object} request without id
   * @param {(waiting: any) => object} [merge] combines the waiting request with this one; by default this one replaces it
   */
  ask(lane, request, merge = () => request) {
    const at = this.#lanes.get(lane) ?? { inFlight: false, waiting: null };
    this.#lanes.set(lane, at);
    if (at.inFlight) {
      at.waiting = at.waiting ? merge(at.waiting) : request;
      return;
    }
    at.inFlight = true;
    const id = this.#next++;
    this.#open.set(id, { lane });
    this.send({ ...request, id });
  }

  /**
   * Handles the answer to a request, success or error.
   * @param {number | undefined} id
   */
  answered(id) {
    const open = id === undefined ? undefined : this.#open.get(id);
    if (id === undefined || !open) return;
    this.#open.delete(id);
    const at = this.#lanes.get(open.lane);
    if (!at) return;
    at.inFlight = false;
    const { waiting } = at;
    at.waiting = null;
    if (waiting) this.ask(open.lane, waiting);
  }

  /** Whether there are no unanswered requests. */
  get idle() {
    return this.#open.size === 0;
  }

  /** Discards all requests, after a connection has ended. */
  clear() {
    this.#open.clear();
    this.#lanes.clear();
  }
}
