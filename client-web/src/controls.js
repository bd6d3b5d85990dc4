/** Lists and settings controls. Settings that the server does not have are left out. */

import { element, make } from "./dom.js";

/**
 * One control; `path` is the setting's place in the JSON.
 * @typedef {{path: string, label: string, kind: "switch"}
 *   | {path: string, label: string, kind: "choice", options: [string | number | boolean | null, string][]}
 *   | {path: string, label: string, kind: "range", min: number, max: number, step: number}} Effect
 */

/** @type {Effect[]} */
export const EFFECTS = [
  {
    path: "shadows.method", label: "Shadows", kind: "choice",
    options: [
      ["off", "Off"],
      ["hard", "Hard"],
      ["adaptive", "Soft"],
      ["adaptive_neighbours", "Soft, thin shadows too"],
      ["naive", "Soft, all rays"],
    ],
  },
  { path: "shadows.samples", label: "Shadow rays", kind: "range", min: 5, max: 64, step: 1 },
  { path: "max_bounces", label: "Reflection depth", kind: "range", min: 0, max: 8, step: 1 },
  { path: "glossy_samples", label: "Glossy rays", kind: "range", min: 1, max: 32, step: 1 },
  { path: "glossy_sharing", label: "Shared glossy rays", kind: "range", min: 0, max: 1, step: 0.05 },
  { path: "edge_samples", label: "Smooth edges", kind: "choice", options: [[1, "Off"], [2, "2 rays"], [4, "4 rays"], [8, "8 rays"], [16, "16 rays"]] },
  { path: "lod_error_px", label: "Mesh error, px", kind: "range", min: 0, max: 4, step: 0.25 },
  { path: "lens.radius_m", label: "Lens radius, m", kind: "range", min: 0, max: 0.03, step: 0.001 },
  { path: "lens.focus_m", label: "Focus, m", kind: "range", min: 0.2, max: 5, step: 0.05 },
  { path: "lens.samples", label: "Lens rays", kind: "range", min: 1, max: 100, step: 1 },
  { path: "ambient.enabled", label: "Contact shadows", kind: "switch" },
  {
    path: "caustics.enabled", label: "Caustics", kind: "choice",
    options: [[null, "Automatic (for glass)"], [true, "On"], [false, "Off"]],
  },
  { path: "bloom.enabled", label: "Bloom", kind: "switch" },
  { path: "bloom.intensity", label: "Bloom strength", kind: "range", min: 0, max: 1, step: 0.05 },
  { path: "glare.enabled", label: "Glare", kind: "switch" },
  { path: "glare.intensity", label: "Glare strength", kind: "range", min: 0, max: 1, step: 0.05 },
  {
    path: "ghost.holes", label: "Depth holes", kind: "choice",
    options: [["show_real", "Show camera"], ["show_virtual", "Show object"], ["fill", "Fill in"]],
  },
  {
    path: "budget_ms", label: "Time per frame", kind: "choice",
    options: [[null, "Keep the source's rate"], [0, "Unlimited"], [8, "8 ms"], [16, "16 ms"], [33, "33 ms"], [66, "66 ms"], [100, "100 ms"]],
  },
  {
    path: "ghost.traversal", label: "Ray walk", kind: "choice",
    options: [["pyramid", "Pyramid"], ["dda", "Every cell"], ["bresenham", "RT2AR, two samples"], ["bresenham_nearest", "RT2AR, nearest"]],
  },
];

/**
 * @param {unknown} settings
 * @param {string} path
 */
export function readPath(settings, path) {
  return path.split(".").reduce(
    (at, key) => (at !== null && typeof at === "object" ? /** @type {Record<string, unknown>} */ (at)[key] : undefined),
    settings,
  );
}

/**
 * A copy of the settings with one value changed.
 * @param {Record<string, unknown>} settings
 * @param {string} path
 * @param {unknown} value
 * @returns {Record<string, unknown>}
 */
export function withPath(settings, path, value) {
  const [key = "", ...rest] = path.split(".");
  const inner = /** @type {Record<string, unknown>} */ (settings[key] ?? {});
  return { ...settings, [key]: rest.length ? withPath(inner, rest.join("."), value) : value };
}

/**
 * @typedef {object} ControlHandlers
 * @property {(choice: {recording?: string, scene?: string, session?: string}) => void} play
 * @property {(object: string) => void} object
 * @property {(path: string, value: unknown) => void} effect
 * @property {() => void} reset
 * @property {(direction: 1 | -1) => void} turn
 */

export class Controls {
  #recording = element("recording", HTMLSelectElement);
  #scene = element("scene", HTMLSelectElement);
  #object = element("object", HTMLSelectElement);
  #list = element("effect-list", HTMLDivElement);
  /** @type {Map<string, (value: unknown) => void>} */
  #show = new Map();

  /** @param {ControlHandlers} handlers */
  constructor(handlers) {
    this.handlers = handlers;
    this.#recording.addEventListener("change", () => {
      const [kind, name] = split(this.#recording.value);
      handlers.play(kind === "session" ? { session: name } : { recording: name });
    });
    this.#scene.addEventListener("change", () => handlers.play({ scene: this.#scene.value }));
    this.#object.addEventListener("change", () => handlers.object(this.#object.value));
    element("reset", HTMLButtonElement).addEventListener("click", () => handlers.reset());
    element("turn-left", HTMLButtonElement).addEventListener("click", () => handlers.turn(-1));
    element("turn-right", HTMLButtonElement).addEventListener("click", () => handlers.turn(1));
  }

  /**
   * Updates the lists of recordings, scenes and sessions.
   * @param {{recordings: {name: string, frames: number, width: number, height: number, duration_s: number}[],
   *   scenes: {name: string}[],
   *   sessions: {session: string, source: {kind: string, name: string}}[]}} offer
   * @param {string} chosen `session:…` or `recording:…`
   */
  offer({ recordings, scenes, sessions }, chosen) {
    const group = (/** @type {string} */ label, /** @type {HTMLOptionElement[]} */ options) =>
      options.length ? [make("optgroup", { label }, ...options)] : [];
    this.#recording.replaceChildren(
      ...group("Recordings", recordings.map((r) =>
        new Option(`${r.name} (${r.duration_s.toFixed(1)} s)`, `recording:${r.name}`))),
      ...group("Sessions under way", sessions.map((s) =>
        new Option(`${s.source.name || s.session} (${s.source.kind})`, `session:${s.session}`))),
    );
    this.#recording.value = chosen;
    const scene = this.#scene.value;
    this.#scene.replaceChildren(...scenes.map((s) => new Option(s.name)));
    this.#scene.value = scene;
  }

  /**
   * Updates the controls from the session's state.
   * @param {import("./control.js").State} state
   * @param {{control: boolean, object: string | null, chosen: string}} here
   */
  show(state, { control, object, chosen }) {
    element("effects", HTMLFieldSetElement).disabled = !control;
    // Anyone may watch another source; only the owner may change the scene.
    this.#scene.disabled = !control || state.source.kind === "live";
    this.#object.disabled = !control;
    this.#recording.value = chosen;
    const names = new Set([...this.#scene.options].map((o) => o.value));
    if (state.scene !== null && !names.has(state.scene)) this.#scene.add(new Option(state.scene));
    this.#scene.value = state.scene ?? "";
    this.#object.replaceChildren(...state.objects.map((o) => new Option(o.name)));
    this.#object.value = object ?? "";
    element("object-row", HTMLElement).hidden = state.objects.length < 2;
    element("turn-row", HTMLElement).hidden = object === null || !control;
    element("turn-label", HTMLElement).textContent = `Turn the ${object}`;
    this.#effects(state.settings);
  }

  /** @param {Record<string, unknown>} settings */
  #effects(settings) {
    const there = EFFECTS.filter((e) => readPath(settings, e.path) !== undefined);
    if (there.map((e) => e.path).join() !== [...this.#show.keys()].join()) {
      this.#show.clear();
      this.#list.replaceChildren(...there.map((e) => this.#control(e)));
    }
    for (const [path, show] of this.#show) show(readPath(settings, path));
  }

  /** @param {Effect} effect */
  #control(effect) {
    const { path, label } = effect;
    const change = (/** @type {unknown} */ value) => this.handlers.effect(path, value);
    switch (effect.kind) {
      case "switch": {
        const box = make("input", { type: "checkbox", name: path });
        box.setAttribute("role", "switch");
        box.addEventListener("change", () => change(box.checked));
        this.#show.set(path, (value) => (box.checked = value === true));
        return make("label", {}, label, box);
      }
      case "choice": {
        const select = make("select", { name: path });
        for (const [value, text] of effect.options) select.add(new Option(text, JSON.stringify(value)));
        select.addEventListener("change", () => change(JSON.parse(select.value)));
        this.#show.set(path, (value) => {
          const text = JSON.stringify(value);
          if (![...select.options].some((o) => o.value === text)) select.add(new Option(String(value), text));
          select.value = text;
        });
        return make("label", {}, label, select);
      }
      case "range": {
        const { min, max, step } = effect;
        const range = make("input", { type: "range", name: path, min: `${min}`, max: `${max}`, step: `${step}` });
        const output = make("output");
        range.addEventListener("input", () => {
          output.value = range.value;
          change(range.valueAsNumber);
        });
        this.#show.set(path, (value) => {
          // While the user drags, the server's answers do not move the slider.
          if (range.matches(":active")) return;
          // Removes the rounding of 32-bit floats.
          const shown = Number(Number(value).toPrecision(6));
          range.max = `${Math.max(max, shown)}`;
          range.value = `${shown}`;
          output.value = `${shown}`;
        });
        return make("label", {}, label, make("span", { className: "range" }, range, output));
      }
    }
  }
}

/**
 * @param {string} value
 * @returns {[string, string]}
 */
function split(value) {
  const at = value.indexOf(":");
  return [value.slice(0, at), value.slice(at + 1)];
}
