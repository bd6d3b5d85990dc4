/** Figures, graph and table of frame times. */

import { element, make } from "./dom.js";
import { History, WAYS, percentile } from "./stages.js";
import { nowMs } from "./clock.js";

/** Interval of updating the figures; faster is unreadable. */
const FIGURES_MS = 400;
/** Frame period of a camera at 30 Hz. */
const PERIOD_MS = 1e3 / 30;

/** @param {number | null | undefined} value milliseconds */
const ms = (value) => (value === null || value === undefined ? "–" : `${value.toFixed(1)} ms`);
const count = new Intl.NumberFormat("en").format;

export class StatsView {
  history = new History();
  #graph = element("graph", HTMLCanvasElement);
  /** @type {{bar: HTMLSpanElement, value: HTMLTableCellElement}[]} */
  #rows = [];
  #colours = WAYS.map((_, i) => getComputedStyle(document.documentElement).getPropertyValue(`--way-${i}`));
  #writtenMs = 0;
  #scheduled = false;
  #ceilingMs = 2 * PERIOD_MS;

  constructor() {
    element("legend", HTMLUListElement).replaceChildren(
      ...WAYS.map(({ label, about }, i) => {
        const item = make("li", { title: about }, label);
        item.style.setProperty("--key", `var(--way-${i})`);
        return item;
      }),
    );
    new ResizeObserver(() => this.#schedule()).observe(this.#graph);
    setInterval(() => this.#schedule(), 1_000);
  }

  /**
   * A connection begins: clears the frames of the previous one.
   * @param {string[]} stages names of the render stages
   */
  begin(stages) {
    this.history.clear();
    const row = (/** @type {string} */ label, /** @type {number | null} */ way) => {
      const bar = make("span", { className: "bar" });
      bar.setAttribute("aria-hidden", "true");
      const value = make("td", {}, "–");
      const name = make("th", { scope: "row", className: way === null ? "" : "key" }, label);
      const colour = `var(--way-${way ?? WAYS.findIndex((w) => w.name === "render")})`;
      name.style.setProperty("--key", colour);
      bar.style.setProperty("--key", colour);
      const line = make("tr", { className: way === null ? "sub" : "" }, name, value, make("td", {}, bar));
      return { line, bar, value };
    };
    const rows = WAYS.flatMap(({ name, label }, i) => {
      const own = row(label, i);
      return name === "render" ? [own, ...stages.map((s) => row(s.replaceAll("_", " "), null))] : [own];
    });
    element("stage-rows", HTMLTableSectionElement).replaceChildren(...rows.map((r) => r.line));
    this.#rows = rows;
    this.#writtenMs = 0;
  }

  /** @param {import("./stages.js").Sample} sample */
  add(sample) {
    this.history.add(sample);
    this.#schedule();
  }

  /**
   * Labels the latency: it is measured from capture for recordings, from reception for live sources.
   * @param {"recording" | "live"} kind
   */
  source(kind) {
    const label = kind === "live" ? "Received to drawn" : "Capture to drawn";
    element("latency-label", HTMLElement).textContent = label;
  }

  #schedule() {
    if (this.#scheduled) return;
    this.#scheduled = true;
    requestAnimationFrame(() => {
      this.#scheduled = false;
      this.#draw();
      const now = nowMs();
      if (now - this.#writtenMs >= FIGURES_MS) {
        this.#writtenMs = now;
        this.#write(now);
      }
    });
  }

  /** @param {number} now */
  #write(now) {
    const s = this.history.summary(now);
    const set = (/** @type {string} */ id, /** @type {string} */ text) => {
      element(id, HTMLElement).textContent = text;
    };
    set("fps", s.fps.toFixed(1));
    set("latency", ms(s.latencyMs));
    set("latency95", ms(s.latency95Ms));
    set("bitrate", `${(s.bitsPerSecond / 1e6).toFixed(1)} Mbit/s`);
    const last = s.last;
    if (!last) return;
    set("dropped", count(last.droppedFrames + last.droppedComposites));
    const before = WAYS.findIndex((w) => w.name === "render") + 1;
    const values = [...s.waysMs.slice(0, before), ...s.stageMs, ...s.waysMs.slice(before)];
    const most = Math.max(1, ...s.waysMs.map((v) => v ?? 0));
    this.#rows.forEach(({ bar, value }, i) => {
      const v = values[i] ?? null;
      value.textContent = v === null ? "–" : v.toFixed(2);
      bar.style.setProperty("--share", `${(v ?? 0) / most}`);
    });
    const share = (/** @type {number} */ n) => `${((100 * n) / (last.width * last.height)).toFixed(1)} %`;
    const facts = {
      "Frame": count(last.sequence),
      "Size": `${last.width} × ${last.height}`,
      "Message": `${(last.bytes / 1024).toFixed(0)} KiB${last.original ? ", with the original" : ""}`,
      "Virtual pixels": share(last.virtualPixels),
      "Ray traced": share(last.tracedPixels),
      "Reflection rays": count(last.secondaryRays),
      "Reflection rays without data": last.secondaryRays
        ? `${((100 * last.unknownRays) / last.secondaryRays).toFixed(1)} %`
        : "–",
      "Never rendered": `${count(last.droppedFrames)} frames`,
      "Skipped for this page": `${count(last.droppedComposites)} composites`,
    };
    element("facts", HTMLElement).replaceChildren(
      ...Object.entries(facts).flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]),
    );
  }

  /** Draws one stacked bar per frame, newest at the right. */
  #draw() {
    const scale = devicePixelRatio;
    const width = Math.round(this.#graph.clientWidth * scale);
    const height = Math.round(this.#graph.clientHeight * scale);
    if (width === 0 || height === 0) return;
    if (this.#graph.width !== width || this.#graph.height !== height) {
      this.#graph.width = width;
      this.#graph.height = height;
    }
    const g = this.#graph.getContext("2d");
    if (!g) return;
    g.clearRect(0, 0, width, height);
    const { samples, capacity } = this.history;
    const totals = samples.map((s) => WAYS.reduce((t, w) => t + Math.max(0, s.waysMs[w.name]), 0));
    // A single late frame may be clipped, so that it does not flatten all others.
    const peak = Math.max(PERIOD_MS, percentile(totals, 0.97) ?? 0);
    // The scale grows at once and shrinks slowly, so that bars stay comparable.
    this.#ceilingMs = Math.max(peak * 1.25, this.#ceilingMs * 0.99);
    const y = (/** @type {number} */ t) => height - (t / this.#ceilingMs) * height;
    const step = width / capacity;
    samples.forEach((sample, i) => {
      const x = width - (samples.length - i) * step;
      let total = 0;
      WAYS.forEach(({ name }, way) => {
        const t = Math.max(0, sample.waysMs[name]);
        g.fillStyle = this.#colours[way] ?? "#888";
        g.fillRect(x, y(total + t), Math.max(1, step - scale), y(total) - y(total + t));
        total += t;
      });
    });
    g.font = `${11 * scale}px system-ui, sans-serif`;
    g.textBaseline = "bottom";
    for (const periods of [1, 3, 9, 27]) {
      const t = periods * PERIOD_MS;
      if (t > 0.85 * this.#ceilingMs || (periods > 1 && t * 3 <= this.#ceilingMs)) continue;
      const at = Math.round(y(t)) + 0.5;
      g.fillStyle = "rgb(232 237 242 / 25%)";
      g.fillRect(0, at, width, scale);
      // The outline keeps the text readable on bars.
      g.strokeStyle = "rgb(13 15 18 / 80%)";
      g.lineWidth = 3 * scale;
      g.strokeText(`${Math.round(t)} ms`, 2 * scale, at - scale);
      g.fillStyle = "rgb(232 237 242 / 85%)";
      g.fillText(`${Math.round(t)} ms`, 2 * scale, at - scale);
    }
  }
}
