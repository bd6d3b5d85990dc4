import assert from "node:assert/strict";
import { test } from "node:test";
import { readPath, withPath } from "../src/controls.js";
import { Placements } from "../src/placements.js";
import { Requests } from "../src/requests.js";
import { assess } from "../src/quality.js";
import { History, WAYS, measure, percentile } from "../src/stages.js";

/** A composite with 2 ms between consecutive stamps, on a clock that is 1 s ahead. */
function composite(received = 101_000) {
  const names = ["received", "decodeStart", "decoded", "renderStart", "renderEnd", "encodeStart", "encoded", "sent"];
  return {
    sequence: 5n,
    stamps: Object.fromEntries(names.map((name, i) => [name, received + 2 * i])),
    stageUs: [500, 1500],
    camera: { width: 4, height: 3 },
    droppedFrames: 2n,
    droppedComposites: 1n,
    planes: { camera: { codec: "none" } },
    virtualPixels: 6, tracedPixels: 8, secondaryRays: 10, unknownRays: 1,
  };
}

test("the ways of a frame add up to its latency, whatever the clocks' offset", () => {
  const sample = measure(composite(), 100_015, 100_018, 1000, 400);
  assert.equal(sample.latencyMs, 18);
  assert.deepEqual(sample.waysMs, { waiting: 6, decode: 2, render: 2, encode: 4, network: 1, page: 3 });
  assert.equal(WAYS.reduce((sum, { name }) => sum + sample.waysMs[name], 0), sample.latencyMs);
  assert.deepEqual(sample.stageMs, [0.5, 1.5]);
});

test("nothing is claimed of the network before the server's clock is known", () => {
  const sample = measure(composite(), 100_015, 100_018, undefined, 400);
  assert.equal(sample.latencyMs, null);
  assert.equal(sample.waysMs.network, 0);
});

test("figures are of the last seconds only", () => {
  const history = new History(100, 1000);
  const add = (drawnMs, latencyMs) =>
    history.add({ ...measure(composite(), 0, 0, 0, 1250), drawnMs, latencyMs });
  for (let i = 0; i < 50; i++) add(i * 10, 500);
  for (let i = 0; i < 11; i++) add(10_000 + i * 100, i + 1);
  const summary = history.summary(11_000);
  assert.equal(summary.fps, 10);
  assert.equal(summary.bitsPerSecond, 100_000);
  assert.equal(summary.latencyMs, 6);
  assert.equal(summary.latency95Ms, 11);
  assert.deepEqual(summary.stageMs, [0.5, 1.5]);
  const nothing = history.summary(99_000);
  assert.deepEqual([nothing.fps, nothing.latencyMs, nothing.last], [0, null, undefined]);
  for (let i = 0; i < 500; i++) add(20_000 + i, 1);
  assert.equal(history.samples.length, 100);
});

test("percentiles are of the nearest rank", () => {
  assert.equal(percentile([], 0.5), null);
  assert.equal(percentile([3], 0.95), 3);
  assert.equal(percentile([4, 1, 3, 2], 0.5), 2);
  assert.equal(percentile([...Array(100).keys()], 0.95), 94);
});

test("one setting changes and the others stay", () => {
  const before = { bloom: { enabled: true, levels: 5 }, max_bounces: 5 };
  assert.deepEqual(withPath(before, "bloom.enabled", false), { bloom: { enabled: false, levels: 5 }, max_bounces: 5 });
  assert.equal(before.bloom.enabled, true);
  assert.equal(withPath(before, "max_bounces", 2).max_bounces, 2);
  assert.equal(readPath(before, "bloom.levels"), 5);
  assert.equal(readPath(before, "max_bounces.no"), undefined);
});

test("one request of a lane is under way; those behind it become one", () => {
  const sent = [];
  const requests = new Requests((r) => sent.push(r));
  const turn = (angle) => requests.ask("turn", { angle }, (waiting) => ({ angle: waiting.angle + angle }));
  [1, 2, 4, 8].forEach(turn);
  requests.ask("place", { pixel: [1, 2] });
  assert.deepEqual(sent, [{ angle: 1, id: 1 }, { pixel: [1, 2], id: 2 }]);
  requests.answered(undefined);
  requests.answered(77);
  requests.answered(1);
  assert.deepEqual(sent[2], { angle: 14, id: 3 });
  requests.answered(3);
  assert.equal(sent.length, 3);
  assert.equal(requests.idle, false);
  requests.answered(2);
  assert.equal(requests.idle, true);
  turn(16);
  requests.clear();
  turn(32);
  assert.deepEqual(sent.slice(3).map((r) => r.angle), [16, 32]);
});

test("what the user moved is put back into a session that begins anew, and nothing else is", () => {
  const stands = (x) => ({ translation: [x, 0, 2], quaternion: [0, 0, 0, 1], turned: 0 });
  const state = (objects, scene = "teapot") => ({
    source: { kind: "recording", name: "desk" }, scene,
    objects: Object.entries(objects).map(([name, x]) => (x === null ? { name } : { name, stands: stands(x) })),
  });
  const placements = new Placements();
  placements.begin();
  placements.note(state({ pot: null, cup: null }));
  assert.deepEqual(placements.requests(), []);
  placements.settle();
  placements.touch("pot");
  placements.note(state({ pot: 5, cup: 6 }));
  const back = [{ type: "place", object: "pot", stands: stands(5) }];
  assert.deepEqual(placements.requests(), back);
  // The connection is lost; in the new session every object is at the scene's place.
  placements.begin();
  placements.note(state({ pot: 1, cup: 2 }));
  assert.deepEqual(placements.requests(), back);
  placements.settle();
  placements.note(state({ pot: 5, cup: 2 }));
  assert.deepEqual(placements.requests(), back);
  // Placements do not apply to another scene, nor to the first scene when it is shown again.
  placements.note(state({ pot: 5 }, "materials"));
  assert.deepEqual(placements.requests(), []);
  placements.note(state({ pot: 5 }));
  assert.deepEqual(placements.requests(), []);
});

test("what is lowered, and a rate that is missed, are said with the choice that helps", () => {
  const counts = (received, rendered, more = {}) => ({ frames_received: received, frames_rendered: rendered, ...more });
  const before = counts(100, 90);
  const second = (rendered, more) => counts(130, 90 + rendered, { source_period_us: 33_333, ...more });
  const lowered = { lowered: ["shadows.samples 22 -> 11", "no_such.setting 4 -> 2"] };
  assert.equal(assess(before, second(30), null), null);
  // A difference of one frame does not count as a missed rate, and neither does a source that sends few frames.
  assert.equal(assess(before, second(27), 0), null);
  assert.equal(assess(before, counts(102, 90), 0), null);
  assert.deepEqual(assess(before, second(30, lowered), null), {
    text: "Reduced to keep 30 frames per second: shadow rays 22 → 11, no_such.setting 4 → 2",
    choice: "finer",
  });
  assert.match(assess(before, second(30, lowered), 16).text, /^Reduced to keep the limit of 16 ms: /);
  const slow = assess(before, second(12, lowered), null);
  assert.match(slow.text, /^Too slow for 30 frames per second even at reduced quality \(12 of 30 frames/);
  assert.equal(slow.choice, "finer");
  assert.deepEqual(assess(before, second(12), 0), { text: "Slower than the source: 12 of 30 frames in the last second", choice: "faster" });
  // The renderer cannot save this time.
  assert.equal(assess(before, second(12), null).choice, null);
});
