/** Entry point of the page: connects picture, controls and figures to the worker. */

import { nowMs } from "./clock.js";
import { Controls, readPath, withPath } from "./controls.js";
import { element } from "./dom.js";
import { hello } from "./control.js";
import { Placements } from "./placements.js";
import { Requests } from "./requests.js";
import { QualityView } from "./quality.js";
import { StatsView } from "./stats.js";
import { KEY_TURN, View } from "./view.js";

/** Interval of polling for other clients' sessions while there is nothing to show. */
const POLL_MS = 2_000;
/** How long the camera's picture is still requested after the slider returns to zero: short drags
 * past zero then need no new request. */
const ORIGINAL_MS = 2_000;
/** Interval of refreshing the lists while connected. */
const SESSIONS_MS = 10_000;

/**
 * @typedef {import("./decoder.worker.js").ToWorker} ToWorker
 * @typedef {import("./decoder.worker.js").FromWorker} FromWorker
 * @typedef {{recordings: any[], scenes: any[], sessions: any[]}} Offer
 */

const here = new URL(document.baseURI);
const parameters = new URLSearchParams(here.search);

/** The source that the page connects to. The URL parameters `session`, `recording` and `scene` preset it. */
const target = {
  session: parameters.get("session") ?? undefined,
  recording: parameters.get("recording") ?? undefined,
  scene: parameters.get("scene") ?? undefined,
  token: takeToken(),
};

/** @type {Offer} */
let offer = { recordings: [], scenes: [], sessions: [] };
/** @type {import("./control.js").State | null} */
let state = null;
let control = false;
/** @type {string | null} */
let object = null;
/** Settings that "reset" restores: the server's or the scene's. @type {Record<string, unknown> | null} */
let initial = null;
/** Settings as changed by the user, sent again after a reconnection. @type {Record<string, unknown> | null} */
let changed = null;
/** @type {import("./connection.js").Phase} */
let phase = { phase: "closed" };
let started = false;
/** Whether this connection has delivered a picture. */
let shown = false;
/** Whether the camera's picture is requested beside the composite: only while the slider shows it. */
let sendsOriginal = false;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let originalTimer;
const placements = new Placements();
/** Whether the user's placements still have to be sent again after a reconnection. */
let restoring = false;

const worker = new Worker(new URL("./decoder.worker.js", import.meta.url), { type: "module" });
/**
 * @param {ToWorker} message
 * @param {Transferable[]} [transfer]
 */
const tell = (message, transfer = []) => worker.postMessage(message, transfer);

const requests = new Requests((request) => tell({ kind: "request", request }));
const stats = new StatsView();
const view = new View({
  place(pixel) {
    if (object === null || !control) return;
    placements.touch(object);
    requests.ask("place", { type: "place", object, pixel });
  },
  turn,
  split(share) {
    tell({ kind: "split", share });
    clearTimeout(originalTimer);
    if (share > 0) original(true);
    else originalTimer = setTimeout(() => original(false), ORIGINAL_MS);
  },
});
const controls = new Controls({
  play,
  object(name) {
    object = name;
    if (state) present(state);
  },
  effect,
  reset() {
    changed = null;
    if (initial) requests.ask("settings", { type: "settings", settings: initial });
  },
  turn: (direction) => turn(direction * KEY_TURN),
});

const quality = new QualityView((budgetMs) => effect("budget_ms", budgetMs));

/**
 * @param {string} path
 * @param {unknown} value
 */
function effect(path, value) {
  const settings = withPath(changed ?? state?.settings ?? {}, path, value);
  changed = settings;
  requests.ask("settings", { type: "settings", settings });
}

/** @param {boolean} wanted */
function original(wanted) {
  if (wanted === sendsOriginal) return;
  sendsOriginal = wanted;
  requests.ask("planes", { type: "planes", camera: wanted ? "jpeg" : "none" });
  handshake(false);
}

/**
 * Sets the hello message of the next connection.
 * @param {boolean} now whether to reconnect at once
 */
function handshake(now) {
  tell({ kind: "hello", hello: hello(target, sendsOriginal ? "jpeg" : "none"), now });
}

/** @param {number} angle */
function turn(angle) {
  if (object === null || !control) return;
  const name = object;
  placements.touch(name);
  requests.ask(`turn ${name}`, { type: "turn", object: name, angle }, (waiting) => ({
    ...waiting,
    angle: waiting.angle + angle,
  }));
}

/** @param {{recording?: string, scene?: string, session?: string}} choice */
function play(choice) {
  const ownRecording = control && state?.source.kind === "recording" && !target.session;
  if (choice.session) {
    target.session = choice.session;
    connect();
  } else if (ownRecording) {
    requests.ask("play", { type: "play", ...choice }, (waiting) => ({ ...waiting, ...choice }));
  } else {
    // Leaves the watched session and starts one of our own.
    target.session = undefined;
    Object.assign(target, choice);
    connect();
  }
}

/** Connects, or reconnects, to the current target. */
function connect() {
  requests.clear();
  shown = false;
  if (started) return handshake(true);
  started = true;
  const url = new URL("ws", here);
  url.protocol = here.protocol === "https:" ? "wss:" : "ws:";
  url.search = url.hash = "";
  const canvas = view.canvas.transferControlToOffscreen();
  handshake(false);
  tell({ kind: "start", url: url.href, canvas }, [canvas]);
}

/** After a reconnection, restores the user's placements as soon as a frame is shown. */
function putBack() {
  if (!restoring || !shown || !state) return;
  restoring = false;
  const mine = control && !target.session && state.source.kind === "recording";
  for (const request of mine ? placements.requests() : []) requests.ask(`back ${request.object}`, request);
  if (requests.idle) placements.settle();
}

/** @param {number | undefined} id */
function answered(id) {
  requests.answered(id);
  if (!restoring && requests.idle) placements.settle();
}

/** @param {import("./control.js").State} now */
function present(now) {
  state = now;
  const names = now.objects.map((o) => o.name);
  if (object === null || !names.includes(object)) object = names[0] ?? null;
  const chosen = target.session ? `session:${target.session}` : `recording:${now.source.name}`;
  controls.show(now, { control, object, chosen });
  view.describe({ object, control });
  stats.source(now.source.kind);
  element("source", HTMLElement).textContent = [now.source.name || now.session, now.scene].filter(Boolean).join(" · ");
}

/** @param {import("./control.js").Reply} reply */
function onReply(reply) {
  switch (reply.type) {
    case "welcome":
      control = reply.control;
      placements.begin();
      restoring = true;
      stats.begin(reply.stages);
      quality.begin();
      if (changed && control) requests.ask("settings", { type: "settings", settings: changed });
      void refreshLists();
      break;
    case "state":
      initial ??= reply.settings;
      // A scene may bring its own settings, which "reset" then restores.
      if (state && state.scene !== reply.scene && JSON.stringify(state.settings) !== JSON.stringify(reply.settings)) {
        initial = reply.settings;
        changed = null;
      }
      placements.note(reply);
      present(reply);
      if (!target.session && reply.source.kind === "recording") {
        // A reconnection returns to what was shown last.
        target.recording = reply.source.name;
        target.scene = reply.scene ?? undefined;
        handshake(false);
      }
      break;
    case "done":
      answered(reply.id);
      // A successful placement clears the message of an earlier error.
      if (reply.note || reply.request === "place") view.toast(reply.note ?? "");
      break;
    case "stats":
      quality.note(reply, { budgetMs: readPath(state?.settings, "budget_ms"), control });
      break;
    case "error":
      answered(reply.id);
      if (!reply.fatal) view.toast(inWords(reply));
      // The controls show the server's settings, not the refused ones.
      if (reply.code === "settings") changed &&= state?.settings ?? null;
      if (state) present(state);
      break;
  }
}

/**
 * The text of an error message: short where the user can correct it.
 * @param {import("./control.js").ErrorReply} error
 */
function inWords({ code, what, expected, got }) {
  if (code === "object" && what.startsWith("place")) return "No depth was measured near this point.";
  return `${what}: expected ${expected}, got ${got}`;
}

/** @param {import("./connection.js").Phase} now */
function enter(now) {
  phase = now;
  requests.clear();
  if (now.phase !== "open") shown = false;
  element("status", HTMLElement).dataset["phase"] = now.phase;
  element("retry", HTMLButtonElement).hidden = now.phase !== "waiting";
  // Controls are disabled while there is no connection.
  element("panel", HTMLElement).inert = now.phase === "waiting" || now.phase === "connecting";
  if (now.phase === "refused") {
    if (now.code === "unauthorized") return askToken();
    if (now.code === "not_found" && (target.session || target.recording || target.scene)) {
      // The target no longer exists, for example after a restart with other recordings: take the default.
      target.session = target.recording = target.scene = undefined;
      return void begin();
    }
    if (now.code === "not_found") return void begin();
    view.showOverlay(now.reason);
  }
  describe();
}

/** Shows the connection's state as text, with a countdown while it waits. */
function describe() {
  // The countdown has its own element, hidden from screen readers, which would read every second.
  const say = (/** @type {string} */ text, countdown = "") => {
    const show = (/** @type {string} */ id, /** @type {string} */ now) => {
      const span = element(id, HTMLElement);
      if (span.textContent !== now) span.textContent = now;
    };
    show("status-text", text);
    show("countdown", countdown);
  };
  switch (phase.phase) {
    case "connecting":
      say(phase.attempt > 1 ? `Reconnecting, attempt ${phase.attempt}…` : "Connecting…");
      break;
    case "open":
      say(control ? "Live" : "Live, view only");
      if (shown) view.showOverlay(null);
      else view.showOverlay(state?.source.kind === "live" ? "Waiting for the camera…" : "Waiting for the first picture…");
      break;
    case "waiting": {
      const seconds = Math.max(0, Math.ceil((phase.retryAtMs - nowMs()) / 1e3));
      say("Disconnected", `; next attempt in ${seconds} s`);
      const reason = phase.reason.replace(/^./, (first) => first.toUpperCase());
      view.showOverlay(`${reason}.\nThe page reconnects as soon as the server is back.`);
      break;
    }
    case "refused":
      say("Refused");
      break;
    case "closed":
      break;
  }
}
setInterval(() => {
  if (phase.phase === "waiting") describe();
}, 500);

worker.addEventListener("message", (/** @type {MessageEvent<FromWorker>} */ { data }) => {
  switch (data.kind) {
    case "phase":
      enter(data.phase);
      break;
    case "reply":
      onReply(data.reply);
      break;
    case "broken":
      view.toast(data.message);
      break;
    case "frame":
      view.resize(data.sample.width, data.sample.height);
      stats.add(data.sample);
      if (!shown) {
        shown = true;
        describe();
        putBack();
      }
      break;
  }
});
worker.addEventListener("error", (event) => view.showOverlay(`The viewer could not start: ${event.message || "its worker failed"}`));

/** Reads the token from the URL fragment, which browsers do not send, and removes it there. */
function takeToken() {
  const given = new URLSearchParams(here.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", here.pathname + here.search);
  }
  return sessionStorage.getItem("token") ?? undefined;
}

function askToken() {
  const wrong = target.token !== undefined;
  target.token = undefined;
  sessionStorage.removeItem("token");
  element("token-form", HTMLFormElement).hidden = false;
  element("token", HTMLInputElement).focus();
  view.showOverlay(wrong ? "Wrong token." : "This server requires a token.");
  element("status-text", HTMLElement).textContent = wrong ? "Wrong token" : "Token required";
}

/**
 * Fetches the lists of recordings, scenes and sessions; `null` if the server requires a token or does not answer.
 * @returns {Promise<Offer | null>}
 */
async function refreshLists() {
  const headers = target.token ? { Authorization: `Bearer ${target.token}` } : undefined;
  try {
    const lists = await Promise.all(
      ["recordings", "scenes", "sessions"].map(async (name) => {
        const response = await fetch(new URL(`api/v1/${name}`, here), { headers });
        if (!response.ok) throw new Error(`${name}: ${response.status}`);
        return response.json();
      }),
    );
    offer = { recordings: lists[0], scenes: lists[1], sessions: lists[2] };
  } catch {
    // The connection reports the reason.
    return null;
  }
  const own = target.session ? null : state?.session;
  const sessions = offer.sessions.filter((s) => s.session !== own);
  const chosen = target.session ? `session:${target.session}` : `recording:${state?.source.name ?? target.recording}`;
  controls.offer({ ...offer, sessions }, chosen);
  if (state) present(state);
  return offer;
}

/** Connects as soon as there is a recording or session to show. */
async function begin() {
  const found = await refreshLists();
  if (found && found.recordings.length === 0 && !target.session) {
    const first = found.sessions[0];
    if (!first) {
      element("status-text", HTMLElement).textContent = "Waiting for a stream";
      view.showOverlay("This server has no recording to play.\nStart it with --recording, or stream frames to it with “ghostlight send”. They appear here.");
      setTimeout(() => void begin(), POLL_MS);
      return;
    }
    target.session = first.session;
  }
  connect();
}

element("token-form", HTMLFormElement).addEventListener("submit", (event) => {
  event.preventDefault();
  target.token = element("token", HTMLInputElement).value;
  sessionStorage.setItem("token", target.token);
  element("token-form", HTMLFormElement).hidden = true;
  void begin();
});
element("retry", HTMLButtonElement).addEventListener("click", () => tell({ kind: "retry" }));
setInterval(() => {
  // Replacing the options would close an open list.
  if (phase.phase === "open" && !document.hidden && document.activeElement !== element("recording", HTMLSelectElement)) void refreshLists();
}, SESSIONS_MS);
addEventListener("online", () => tell({ kind: "retry" }));
document.addEventListener("visibilitychange", () => {
  tell({ kind: "hidden", hidden: document.hidden });
  if (!document.hidden) tell({ kind: "retry" });
});

void begin();
