/**
 * Requests under way. Of changes that follow each other faster than the server carries them
 * out (a slider, a drag) only one is under way, and those behind it become one.
 */
export class Requests {
  #next = 1;
  /** @type {Map<number, {lane: string}>} */
  #open = new Map();
  /** @type {Map<string, {under: boolean, waiting: object | null}>} */
  #lanes = new Map();

  /** @param {(message: object) => void} send */
  constructor(send) {
    this.send = send;
  }

  /**
   * @param {string} lane requests of one lane go one after another
   * @param {object} request without id
   * @param {(waiting: any) => object} [merge] what waits already, and this; by default this replaces it
   */
  ask(lane, request, merge = () => request) {
    const at = this.#lanes.get(lane) ?? { under: false, waiting: null };
    this.#lanes.set(lane, at);
    if (at.under) {
      at.waiting = at.waiting ? merge(at.waiting) : request;
      return;
    }
    at.under = true;
    const id = this.#next++;
    this.#open.set(id, { lane });
    this.send({ ...request, id });
  }

  /**
   * The answer to a request, good or bad.
   * @param {number | undefined} id
   */
  answered(id) {
    const open = id === undefined ? undefined : this.#open.get(id);
    if (id === undefined || !open) return;
    this.#open.delete(id);
    const at = this.#lanes.get(open.lane);
    if (!at) return;
    at.under = false;
    const { waiting } = at;
    at.waiting = null;
    if (waiting) this.ask(open.lane, waiting);
  }

  /** Whether every answer has come. */
  get idle() {
    return this.#open.size === 0;
  }

  /** A connection ended: nothing will be answered any more. */
  clear() {
    this.#open.clear();
    this.#lanes.clear();
  }
}
