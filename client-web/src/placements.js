/**
 * The user's placements, kept so that a new session after a lost connection looks the same.
 * They are poses in world space (`state.objects[].stands`), not pixels: the camera moves.
 */

/** @typedef {import("./control.js").State} State */
/** @typedef {import("./control.js").Stands} Stands */

export class Placements {
  /** Source and scene that the placements belong to. */
  #of = "";
  /** Objects that the user moved, with their last pose. @type {Map<string, Stands | null>} */
  #moved = new Map();
  /** Whether the session has applied them. Before that, its poses are not the user's. */
  #settled = true;

  /**
   * Records that the user moves an object.
   * @param {string} name
   */
  touch(name) {
    if (!this.#moved.has(name)) this.#moved.set(name, null);
  }

  /** Begins a new connection, in whose session every object is at the scene's place. */
  begin() {
    this.#settled = false;
  }

  /**
   * Takes over the poses of a `state` message.
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

  /** Requests that restore all placements. */
  requests() {
    return [...this.#moved].flatMap(([object, stands]) => (stands ? [{ type: "place", object, stands }] : []));
  }

  /** All placements are restored. */
  settle() {
    this.#settled = true;
  }
}
