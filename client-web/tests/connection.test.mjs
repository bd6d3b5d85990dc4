import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { beforeEach, afterEach, mock, test } from "node:test";
import { ServerClock } from "../src/clock.js";
import { Connection, retryDelayMs } from "../src/connection.js";

const WELCOME = JSON.parse(readFileSync(new URL("../../proto/vectors/welcome.json", import.meta.url), "utf8"));

/** A socket that is controlled by the test and records the messages sent to it. */
class FakeSocket {
  static made = [];
  readyState = 0;
  sent = [];
  constructor(url, protocol) {
    Object.assign(this, { url, protocol });
    FakeSocket.made.push(this);
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  close() {
    this.readyState = 3;
  }
  open() {
    this.readyState = 1;
    this.onopen({});
  }
  hear(data) {
    this.onmessage({ data: typeof data === "object" && !(data instanceof ArrayBuffer) ? JSON.stringify(data) : data });
  }
  welcome() {
    this.hear(WELCOME);
  }
  lose(reason = "") {
    this.readyState = 3;
    this.onclose({ code: 1006, reason });
  }
}
const last = () => FakeSocket.made.at(-1);

let seen;
function connect() {
  seen = { phases: [], replies: [], composites: [], broken: [] };
  const connection = new Connection("ws://x/ws", { type: "hello" }, {
    phase: (phase) => seen.phases.push(phase),
    reply: (reply) => seen.replies.push(reply),
    composite: (...composite) => seen.composites.push(composite),
    broken: (error) => seen.broken.push(error),
  }, { Socket: FakeSocket, random: () => 1 });
  connection.start();
  return connection;
}
const phases = () => seen.phases.map((p) => p.phase);

beforeEach(() => {
  FakeSocket.made = [];
  mock.timers.enable({ apis: ["setTimeout", "Date"] });
});
afterEach(() => mock.timers.reset());

test("says hello with the subprotocol, and is open with the welcome", () => {
  connect();
  assert.equal(last().protocol, "ghostlight.v1");
  assert.deepEqual(phases(), ["connecting"]);
  last().open();
  assert.deepEqual(last().sent, [{ type: "hello" }]);
  last().welcome();
  assert.deepEqual(phases(), ["connecting", "open"]);
  assert.equal(last().sent[1].type, "ping");
});

test("pauses double up to a bound, and half of each is chance", () => {
  const longest = [1, 2, 3, 4, 5, 6, 7, 100].map((n) => retryDelayMs(n, () => 1));
  assert.deepEqual(longest, [500, 1000, 2000, 4000, 8000, 15000, 15000, 15000]);
  assert.equal(retryDelayMs(3, () => 0), 1000);
});

test("a lost connection comes back, later each time, and at once after it was good again", () => {
  connect();
  last().open();
  last().welcome();
  last().lose();
  for (const delay of [500, 500, 1000, 2000]) {
    const n = FakeSocket.made.length;
    assert.equal(seen.phases.at(-1).phase, "waiting");
    mock.timers.tick(delay - 1);
    assert.equal(FakeSocket.made.length, n, `before ${delay} ms`);
    mock.timers.tick(1);
    assert.equal(FakeSocket.made.length, n + 1, `after ${delay} ms`);
    last().lose();
  }
  mock.timers.tick(4000);
  last().open();
  last().welcome();
  last().lose();
  const n = FakeSocket.made.length;
  mock.timers.tick(500);
  assert.equal(FakeSocket.made.length, n + 1);
});

test("retry does not wait; a socket that was given up changes nothing any more", () => {
  const connection = connect();
  const first = last();
  first.lose();
  connection.retry();
  assert.equal(FakeSocket.made.length, 2);
  first.lose();
  first.welcome();
  assert.deepEqual(phases(), ["connecting", "waiting", "connecting"]);
  mock.timers.tick(500);
  assert.equal(FakeSocket.made.length, 2);
});

test("an answer that does not come is a failed attempt", () => {
  connect();
  mock.timers.tick(8_000);
  assert.equal(seen.phases.at(-1).phase, "waiting");
  assert.match(seen.phases.at(-1).reason, /does not answer/);
});

test("a refusal is not repeated, a full server is asked again", () => {
  const refuse = (code) => {
    connect();
    last().open();
    last().hear({ type: "error", code, what: "hello", expected: "a", got: "b", fatal: true });
    last().hear({ type: "bye", reason: "later words" });
    last().lose("closed");
  };
  refuse("unauthorized");
  assert.deepEqual(seen.phases.at(-1), { phase: "refused", code: "unauthorized", reason: "hello: expected a, got b" });
  const n = FakeSocket.made.length;
  mock.timers.tick(60_000);
  assert.equal(FakeSocket.made.length, n);
  refuse("limit");
  assert.equal(seen.phases.at(-1).phase, "waiting");
  assert.match(seen.phases.at(-1).reason, /expected a, got b/);
});

test("composites arrive decoded; one that cannot be read is told, and its credit given back", () => {
  const connection = connect();
  last().open();
  last().welcome();
  const { buffer, byteOffset, byteLength } = readFileSync(new URL("../../proto/vectors/composite_full.bin", import.meta.url));
  last().hear(buffer.slice(byteOffset, byteOffset + byteLength));
  assert.equal(seen.composites[0][0].sequence, 7n);
  assert.equal(seen.composites[0][2], byteLength);
  last().hear(new ArrayBuffer(10));
  assert.equal(seen.broken.length, 1);
  assert.deepEqual(last().sent.at(-1), { type: "credit" });
  last().hear("{");
  assert.equal(seen.broken.length, 2);
  assert.equal(connection.phase.phase, "open");
});

test("stop ends it for good", () => {
  const connection = connect();
  last().open();
  last().welcome();
  connection.stop();
  assert.equal(last().readyState, 3);
  mock.timers.tick(60_000);
  assert.equal(FakeSocket.made.length, 1);
  assert.equal(connection.send({ type: "credit" }), false);
});

test("the clock is that of the ping with the shortest round trip, among the newest", () => {
  const clock = new ServerClock();
  assert.equal(clock.offsetMs, undefined);
  clock.add(1000, 1040, 5035); // the answer was delayed: an error of 15 ms
  clock.add(2000, 2002, 6001); // exact: 4000 ms
  clock.add(3000, 3030, 7001);
  assert.equal(clock.offsetMs, 4000);
  assert.equal(clock.roundTripMs, 2);
  clock.add(10, 5, 0); // a clock that was set back is ignored
  assert.equal(clock.roundTripMs, 2);
  // Clocks drift: old measurements are dropped.
  for (let i = 0; i < 16; i++) clock.add(0, 10, 4105);
  assert.equal(clock.offsetMs, 4100);
});
