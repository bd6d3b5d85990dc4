/**
 * Where the user put things, so that a session that was lost looks the same when it is back.
 * Places are in the world (`state.objects[].stands`), not on the screen: the camera has moved
 * since.
 */

/** @typedef {import("./control.js").State} State */
/** @typedef {import("./control.js").Stands} Stands */

export class Placements {
  /** What they belong to: another room or scene has other places. */
  #of = "";
  /** Objects that the user moved, and where they stood last. @type {Map<string, Stands | null>} */
  #moved = new Map();
  /** Whether the session has them: until then its own places say nothing of the user's. */
  #settled = true;

  /**
   * The user moves an object.
   * @param {string} name
   */
  touch(name) {
    if (!this.#moved.has(name)) this.#moved.set(name, null);
  }

  /** A new connection: its session has everything where the scene puts it. */
  begin() {
    this.#settled = false;
  }

  /**
   * What the server says of the session.
   * @param {State} state
   */
  note(state) {
    const of = JSON.stringify([state.source, state.scene]);
    if (of !== this.#of) {
      this.#of = of;
      this.#moved.clear();
    }
    if (!this.#settled) return;
    for (const { name, stands } of state.objects) {
      if (stands && this.#moved.has(name)) this.#moved.set(name, stands);
    }
  }

  /** Requests that put everything back. */
  requests() {
    return [...this.#moved].flatMap(([object, stands]) => (stands ? [{ type: "place", object, stands }] : []));
  }

  /** They were carried out, or there were none. */
  settle() {
    this.#settled = true;
  }
}
