/** The page: ties picture, controls and figures to the worker. */

import { nowMs } from "./clock.js";
import { Controls, readPath, withPath } from "./controls.js";
import { element } from "./dom.js";
import { hello } from "./control.js";
import { Placements } from "./placements.js";
import { Requests } from "./requests.js";
import { QualityView } from "./quality.js";
import { StatsView } from "./stats.js";
import { KEY_TURN, View } from "./view.js";

/** How often sessions of others are looked for while there is nothing to show. */
const LOOK_MS = 2_000;
/** How long the original is still sent after the slider went back: it may be a moment only. */
const ORIGINAL_MS = 2_000;
/** How often the list of sessions is brought up to date otherwise. */
const SESSIONS_MS = 10_000;

/**
 * @typedef {import("./decoder.worker.js").ToWorker} ToWorker
 * @typedef {import("./decoder.worker.js").FromWorker} FromWorker
 * @typedef {{recordings: any[], scenes: any[], sessions: any[]}} Offer
 */

const here = new URL(document.baseURI);
const parameters = new URLSearchParams(here.search);

/** What to watch; `?session=`, `?recording=` and `?scene=` of the address come first. */
const wish = {
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
/** The server's settings, to go back to. @type {Record<string, unknown> | null} */
let initial = null;
/** What the user made of them; survives a reconnection. @type {Record<string, unknown> | null} */
let changed = null;
/** @type {import("./connection.js").Phase} */
let phase = { phase: "closed" };
let started = false;
/** A picture has come on this connection. */
let shown = false;
/** Whether the camera's own picture is sent beside the composite: only while it is looked at. */
let sendsOriginal = false;
/** @type {ReturnType<typeof setTimeout> | undefined} */
let originalTimer;
const placements = new Placements();
/** The user's placements are on their way to a session that was lost and is back. */
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
  greet(false);
}

/**
 * Says what the next connection begins with.
 * @param {boolean} now whether to begin it at once
 */
function greet(now) {
  tell({ kind: "hello", hello: hello(wish, sendsOriginal ? "jpeg" : "none"), now });
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
  const ownRecording = control && state?.source.kind === "recording" && !wish.session;
  if (choice.session) {
    wish.session = choice.session;
    connect();
  } else if (ownRecording) {
    requests.ask("play", { type: "play", ...choice }, (waiting) => ({ ...waiting, ...choice }));
  } else {
    // Away from another's session, to one of our own.
    wish.session = undefined;
    Object.assign(wish, choice);
    connect();
  }
}

/** Starts over with what is wished for now. */
function connect() {
  requests.clear();
  shown = false;
  if (started) return greet(true);
  started = true;
  const url = new URL("ws", here);
  url.protocol = here.protocol === "https:" ? "wss:" : "ws:";
  url.search = url.hash = "";
  const canvas = view.canvas.transferControlToOffscreen();
  greet(false);
  tell({ kind: "start", url: url.href, canvas }, [canvas]);
}

/** Puts what the user moved back, once there is a frame to see it in. */
function putBack() {
  if (!restoring || !shown || !state) return;
  restoring = false;
  const mine = control && !wish.session && state.source.kind === "recording";
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
  const chosen = wish.session ? `session:${wish.session}` : `recording:${now.source.name}`;
  controls.show(now, { control, object, chosen });
  view.describe({ object, control });
  stats.source(now.source.kind);
  element("source", HTMLElement).textContent = [now.source.name || now.session, now.scene].filter(Boolean).join(" · ");
}

/** @param {import("./control.js").Reply} reply */
function take(reply) {
  switch (reply.type) {
    case "welcome":
      control = reply.control;
      placements.begin();
      restoring = true;
      stats.begin(reply.stages);
      quality.begin();
      if (changed && control) requests.ask("settings", { type: "settings", settings: changed });
      void look();
      break;
    case "state":
      initial ??= reply.settings;
      // A scene may bring its own settings: those are then what there is to go back to.
      if (state && state.scene !== reply.scene && JSON.stringify(state.settings) !== JSON.stringify(reply.settings)) {
        initial = reply.settings;
        changed = null;
      }
      placements.note(reply);
      present(reply);
      if (!wish.session && reply.source.kind === "recording") {
        // A connection that is lost comes back to what was seen last.
        wish.recording = reply.source.name;
        wish.scene = reply.scene ?? undefined;
        greet(false);
      }
      break;
    case "done":
      answered(reply.id);
      // What went wrong before is over once something is put somewhere.
      if (reply.note || reply.request === "place") view.toast(reply.note ?? "");
      break;
    case "stats":
      quality.note(reply, { budgetMs: readPath(state?.settings, "budget_ms"), control });
      break;
    case "error":
      answered(reply.id);
      if (!reply.fatal) view.toast(inWords(reply));
      // The controls show what the server has, not what it refused.
      if (reply.code === "settings") changed &&= state?.settings ?? null;
      if (state) present(state);
      break;
  }
}

/**
 * An error for the person who looks: short where it is theirs to mend.
 * @param {import("./control.js").ErrorReply} error
 */
function inWords({ code, what, expected, got }) {
  if (code === "object" && what.startsWith("place")) return "No depth measured near there.";
  return `${what}: expected ${expected}, got ${got}`;
}

/** @param {import("./connection.js").Phase} now */
function enter(now) {
  phase = now;
  requests.clear();
  if (now.phase !== "open") shown = false;
  element("status", HTMLElement).dataset["phase"] = now.phase;
  element("retry", HTMLButtonElement).hidden = now.phase !== "waiting";
  // What nobody would hear cannot be chosen.
  element("panel", HTMLElement).inert = now.phase === "waiting" || now.phase === "connecting";
  if (now.phase === "refused") {
    if (now.code === "unauthorized") return askToken();
    if (now.code === "not_found" && (wish.session || wish.recording || wish.scene)) {
      // What was watched is gone, as after a restart with other recordings: show what there is.
      wish.session = wish.recording = wish.scene = undefined;
      return void begin();
    }
    if (now.code === "not_found") return void begin();
    view.veil(now.reason);
  }
  describe();
}

/** The state in words; counts down while it waits. */
function describe() {
  // The countdown is for the eye alone: a screen reader would announce every second of it.
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
      say(control ? "Live" : "Live, watching");
      if (shown) view.veil(null);
      else view.veil(state?.source.kind === "live" ? "Waiting for the camera…" : "Waiting for the first picture…");
      break;
    case "waiting": {
      const seconds = Math.max(0, Math.ceil((phase.retryAtMs - nowMs()) / 1e3));
      say("Lost", `; next attempt in ${seconds} s`);
      const reason = phase.reason.replace(/^./, (first) => first.toUpperCase());
      view.veil(`${reason}.\nThis page goes on by itself as soon as the server is back.`);
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
      take(data.reply);
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
worker.addEventListener("error", (event) => view.veil(`The viewer could not start: ${event.message || "its worker failed"}`));

/** The token of the address's fragment, which servers do not see and which is then removed. */
function takeToken() {
  const given = new URLSearchParams(here.hash.slice(1)).get("token");
  if (given) {
    sessionStorage.setItem("token", given);
    history.replaceState(null, "", here.pathname + here.search);
  }
  return sessionStorage.getItem("token") ?? undefined;
}

function askToken() {
  const wrong = wish.token !== undefined;
  wish.token = undefined;
  sessionStorage.removeItem("token");
  element("token-form", HTMLFormElement).hidden = false;
  element("token", HTMLInputElement).focus();
  view.veil(wrong ? "Wrong token." : "This server shows its pictures to those who have its token.");
  element("status-text", HTMLElement).textContent = wrong ? "Wrong token" : "Token wanted";
}

/**
 * What the server offers; `null`: it wants a token, or does not answer.
 * @returns {Promise<Offer | null>}
 */
async function look() {
  const headers = wish.token ? { Authorization: `Bearer ${wish.token}` } : undefined;
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
    // The connection itself will say what is wrong.
    return null;
  }
  const own = wish.session ? null : state?.session;
  const sessions = offer.sessions.filter((s) => s.session !== own);
  const chosen = wish.session ? `session:${wish.session}` : `recording:${state?.source.name ?? wish.recording}`;
  controls.offer({ ...offer, sessions }, chosen);
  if (state) present(state);
  return offer;
}

/** Connects, once there is something to watch. */
async function begin() {
  const found = await look();
  if (found && found.recordings.length === 0 && !wish.session) {
    const first = found.sessions[0];
    if (!first) {
      element("status-text", HTMLElement).textContent = "Waiting for a stream";
      view.veil("This server has no recording to play.\nStart it with --recording, or stream frames to it with “ghostlight send”: they will be shown here.");
      setTimeout(() => void begin(), LOOK_MS);
      return;
    }
    wish.session = first.session;
  }
  connect();
}

element("token-form", HTMLFormElement).addEventListener("submit", (event) => {
  event.preventDefault();
  wish.token = element("token", HTMLInputElement).value;
  sessionStorage.setItem("token", wish.token);
  element("token-form", HTMLFormElement).hidden = true;
  void begin();
});
element("retry", HTMLButtonElement).addEventListener("click", () => tell({ kind: "retry" }));
setInterval(() => {
  // Not while it is open: that would close it.
  if (phase.phase === "open" && !document.hidden && document.activeElement !== element("recording", HTMLSelectElement)) void look();
}, SESSIONS_MS);
addEventListener("online", () => tell({ kind: "retry" }));
document.addEventListener("visibilitychange", () => {
  tell({ kind: "hidden", hidden: document.hidden });
  if (!document.hidden) tell({ kind: "retry" });
});

void begin();
