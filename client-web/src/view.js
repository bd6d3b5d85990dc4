/** Input on the picture: a click places the object, a drag turns it, the slider compares with the camera. */

import { element } from "./dom.js";

/** Pointer movement below which a press counts as a click, CSS pixels; larger for touch. */
const CLICK_PX = { mouse: 4, other: 9 };
/** Whether the main pointer is a finger. */
const TOUCH = matchMedia("(pointer: coarse)").matches;
/** Radians per drag across the whole width. */
const TURN_PER_WIDTH = 2 * Math.PI;
/** Step of the keyboard cursor, as a share of the width. */
const CROSS_STEP = 0.02;
/** Angle of one turn by keyboard or button, radians. */
export const KEY_TURN = Math.PI / 12;

/**
 * @typedef {object} ViewHandlers
 * @property {(pixel: [number, number]) => void} place pixel of the frame
 * @property {(angle: number) => void} turn radians, counter-clockwise seen from above
 * @property {(share: number) => void} split
 */

export class View {
  stage = element("stage", HTMLDivElement);
  canvas = element("canvas", HTMLCanvasElement);
  #cross = element("cross", HTMLDivElement);
  #ripple = element("ripple", HTMLDivElement);
  #overlay = element("overlay", HTMLDivElement);
  #toast = element("toast", HTMLDivElement);
  #hint = element("hint", HTMLParagraphElement);
  #hints = { pointer: "", keys: "" };
  #size = { width: 640, height: 480 };
  /** Keyboard cursor, as shares of width and height. */
  #at = { x: 0.5, y: 0.5 };
  /** @type {{id: number, x: number, y: number, lastX: number, moved: boolean} | null} */
  #press = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  #toastTimer;

  /** @param {ViewHandlers} handlers */
  constructor(handlers) {
    this.handlers = handlers;
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (e) => this.#down(e));
    canvas.addEventListener("pointermove", (e) => this.#move(e));
    canvas.addEventListener("pointerup", (e) => this.#up(e, true));
    canvas.addEventListener("pointercancel", (e) => this.#up(e, false));
    canvas.addEventListener("keydown", (e) => this.#key(e));
    canvas.addEventListener("focus", () => this.#hintNow());
    canvas.addEventListener("blur", () => {
      this.#cross.hidden = true;
      this.#hintNow();
    });
    this.#ripple.addEventListener("animationend", () => (this.#ripple.hidden = true));
    const slider = element("split", HTMLInputElement);
    const split = () => {
      const share = slider.valueAsNumber;
      this.stage.style.setProperty("--split", String(share));
      this.stage.classList.toggle("split", share > 0);
      this.stage.classList.toggle("split-far", share > 0.8);
      slider.setAttribute("aria-valuetext", `${Math.round(100 * share)} percent original`);
      handlers.split(share);
    };
    slider.addEventListener("input", split);
    // Browsers restore the slider's value when a page is reloaded.
    split();
  }

  /**
   * Size of the frames.
   * @param {number} width
   * @param {number} height
   */
  resize(width, height) {
    if (width === this.#size.width && height === this.#size.height) return;
    this.#size = { width, height };
    this.stage.style.setProperty("--ratio", String(width / height));
  }

  /**
   * Updates the hints to the actions that are available.
   * @param {{object: string | null, control: boolean}} what
   */
  describe({ object, control }) {
    this.stage.classList.toggle("readonly", !control || object === null);
    if (!control) this.#hints.pointer = "View only: the owner of the session controls it.";
    else if (object === null) this.#hints.pointer = "This scene has no objects: the picture is the camera's.";
    else this.#hints.pointer = `${TOUCH ? "Tap" : "Click"} to place the ${object}; drag sideways to turn it.`;
    const works = control && object !== null;
    this.#hints.keys = works ? `Arrow keys move the cursor, Enter places the ${object}, [ and ] turn it.` : this.#hints.pointer;
    this.#hintNow();
  }

  /** Shows the keyboard hint while the picture has keyboard focus. */
  #hintNow() {
    const text = this.canvas.matches(":focus-visible") ? this.#hints.keys : this.#hints.pointer;
    if (this.#hint.textContent !== text) this.#hint.textContent = text;
  }

  /**
   * Covers the picture with a message; `null` removes it.
   * @param {string | null} text
   */
  showOverlay(text) {
    this.#overlay.hidden = text === null;
    element("overlay-text", HTMLParagraphElement).textContent = text ?? "";
  }

  /**
   * Shows a message for five seconds; an empty text removes the current one.
   * @param {string} text
   */
  toast(text) {
    this.#toast.textContent = text;
    clearTimeout(this.#toastTimer);
    if (text) this.#toastTimer = setTimeout(() => (this.#toast.textContent = ""), 5_000);
  }

  /** @param {PointerEvent} event */
  #down(event) {
    if (event.button !== 0 || this.#press) return;
    this.canvas.setPointerCapture(event.pointerId);
    this.#press = { id: event.pointerId, x: event.clientX, y: event.clientY, lastX: event.clientX, moved: false };
  }

  /** @param {PointerEvent} event */
  #move(event) {
    const press = this.#press;
    if (!press || event.pointerId !== press.id) return;
    const bound = event.pointerType === "mouse" ? CLICK_PX.mouse : CLICK_PX.other;
    if (!press.moved && Math.hypot(event.clientX - press.x, event.clientY - press.y) > bound) {
      press.moved = true;
      this.stage.classList.add("turning");
    }
    if (!press.moved) return;
    const across = (event.clientX - press.lastX) / this.canvas.clientWidth;
    press.lastX = event.clientX;
    if (across !== 0) this.handlers.turn(across * TURN_PER_WIDTH);
  }

  /**
   * @param {PointerEvent} event
   * @param {boolean} done
   */
  #up(event, done) {
    const press = this.#press;
    if (!press || event.pointerId !== press.id) return;
    this.#press = null;
    this.stage.classList.remove("turning");
    if (!done || press.moved) return;
    const box = this.canvas.getBoundingClientRect();
    this.#place((event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height);
  }

  /**
   * @param {number} x share of the width
   * @param {number} y share of the height
   */
  #place(x, y) {
    const { width, height } = this.#size;
    const inside = (/** @type {number} */ share, /** @type {number} */ n) =>
      // Pixel centres are whole numbers.
      Math.min(n - 1, Math.max(0, share * n - 0.5));
    this.#at = { x, y };
    for (const mark of [this.#ripple, this.#cross]) {
      mark.style.left = `${100 * x}%`;
      mark.style.top = `${100 * y}%`;
    }
    this.#ripple.hidden = true;
    // Reading the size forces a layout, which restarts the animation.
    void this.#ripple.offsetWidth;
    this.#ripple.hidden = false;
    this.handlers.place([inside(x, width), inside(y, height)]);
  }

  /** @param {KeyboardEvent} event */
  #key(event) {
    const step = event.shiftKey ? CROSS_STEP / 4 : CROSS_STEP;
    /** @type {Record<string, () => void>} */
    const keys = {
      ArrowLeft: () => this.#cruise(-step, 0),
      ArrowRight: () => this.#cruise(step, 0),
      ArrowUp: () => this.#cruise(0, -step),
      ArrowDown: () => this.#cruise(0, step),
      Enter: () => this.#place(this.#at.x, this.#at.y),
      " ": () => this.#place(this.#at.x, this.#at.y),
      "[": () => this.handlers.turn(-KEY_TURN),
      "]": () => this.handlers.turn(KEY_TURN),
    };
    const act = keys[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  }

  /**
   * @param {number} dx
   * @param {number} dy
   */
  #cruise(dx, dy) {
    const clamp = (/** @type {number} */ v) => Math.min(1, Math.max(0, v));
    this.#at = { x: clamp(this.#at.x + dx), y: clamp(this.#at.y + dy) };
    this.#cross.style.left = `${100 * this.#at.x}%`;
    this.#cross.style.top = `${100 * this.#at.y}%`;
    this.#cross.hidden = false;
  }
}
