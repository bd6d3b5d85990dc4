/** The line that says which settings the server reduces to keep the source's rate. */

import { EFFECTS } from "./controls.js";
import { element } from "./dom.js";

/** Share of the source's frames below which its rate counts as missed. */
const KEPT = 0.9;
/** Seconds without a message before the line is hidden, so that it does not flicker. */
const CALM = 3;

/**
 * @typedef {import("./control.js").Stats} Stats
 * @typedef {{text: string, choice: "finer" | "faster" | null}} Line
 */

/**
 * A reduced setting under its label on the page; the server sends `edge_samples 4 -> 2`.
 * @param {string} lowered
 */
function inWords(lowered) {
  const [, path = "", change = lowered] = /^(\S+) (.*)$/.exec(lowered) ?? [];
  const label = EFFECTS.find((effect) => effect.path === path)?.label ?? path;
  return `${label.toLowerCase()} ${change.replace("->", "→")}`;
}

/**
 * The message for the second between two reports, or `null`.
 * @param {Stats} before
 * @param {Stats} now
 * @param {unknown} budgetMs the setting: null keeps the source's rate, 0 is no limit
 * @returns {Line | null}
 */
export function assess(before, now, budgetMs) {
  const received = now.frames_received - before.frames_received;
  const rendered = now.frames_rendered - before.frames_rendered;
  const missed = received >= 5 && rendered < KEPT * received;
  const lowered = now.lowered ?? [];
  const rate = now.source_period_us ? `${Math.round(1e6 / now.source_period_us)} frames per second` : "the rate";
  const shown = `${rendered} of ${received} frames in the last second`;
  if (lowered.length > 0) {
    const what = lowered.map(inWords).join(", ");
    const limit = typeof budgetMs === "number" ? `the limit of ${budgetMs} ms` : rate;
    const text = missed ? `Too slow for ${limit} even at reduced quality (${shown}): ${what}` : `Reduced to keep ${limit}: ${what}`;
    return { text, choice: "finer" };
  }
  if (!missed) return null;
  return { text: `Slower than the source: ${shown}`, choice: budgetMs === null ? null : "faster" };
}

/** The line under the figures. */
export class QualityView {
  #line = element("quality", HTMLElement);
  #text = element("quality-text", HTMLElement);
  #button = element("quality-choice", HTMLButtonElement);
  /** @type {Stats | null} */
  #before = null;
  #calm = 0;
  /** @type {"finer" | "faster" | null} */
  #choice = null;

  /** @param {(budgetMs: number | null) => void} choose called with the new value of `budget_ms` */
  constructor(choose) {
    this.#button.addEventListener("click", () => choose(this.#choice === "finer" ? 0 : null));
  }

  /** Resets the state for a new connection. */
  begin() {
    this.#before = null;
    this.#show(null, false);
  }

  /**
   * Handles the server's counts, which arrive once a second.
   * @param {Stats} stats
   * @param {{budgetMs: unknown, control: boolean}} here
   */
  note(stats, { budgetMs, control }) {
    const line = this.#before && assess(this.#before, stats, budgetMs);
    this.#before = stats;
    this.#calm = line ? 0 : this.#calm + 1;
    if (line || this.#calm >= CALM) this.#show(line, control);
  }

  /**
   * @param {Line | null} line
   * @param {boolean} control
   */
  #show(line, control) {
    this.#line.hidden = line === null;
    this.#choice = line?.choice ?? null;
    if (this.#text.textContent !== (line?.text ?? "")) this.#text.textContent = line?.text ?? "";
    this.#button.hidden = !control || this.#choice === null;
    this.#button.textContent = this.#choice === "finer" ? "Finer" : "Faster";
    this.#button.title = this.#choice === "finer" ? "Full quality, without a time limit" : "Reduce quality where the source's rate requires it";
  }
}
