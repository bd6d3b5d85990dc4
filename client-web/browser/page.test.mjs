/**
 * Tests the real page in a real Chromium with the real server and the bundled recording.
 *
 *   GHOSTLIGHT_PROGRAM=target/release/ghostlight node --test client-web/browser/page.test.mjs
 *
 * GHOSTLIGHT_SCREENSHOTS  folder to leave screenshots in
 */

import assert from "node:assert/strict";
import { mkdirSync, mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { after, before, test } from "node:test";
import { Chromium } from "./chromium.mjs";
import { Server, writeStill } from "./server.mjs";

/** Functions injected into the page: they read the picture, and the expected values from the server. */
const TOOLS = `
globalThis.tools = {
  $: (id) => document.getElementById(id),
  /** Pixels of the displayed picture. */
  grab() {
    const from = document.getElementById("canvas");
    const to = new OffscreenCanvas(from.width, from.height).getContext("2d", { willReadFrequently: true });
    to.drawImage(from, 0, 0);
    return to.getImageData(0, 0, from.width, from.height);
  },
  /** The lossless composite sent to another viewer of the session, and the session's state. */
  async truth() {
    const { decodeComposite } = await import("/client/src/protocol.js");
    const [{ session }] = await (await fetch("/api/v1/sessions")).json();
    const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", "ghostlight.v1");
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", version: 1, role: "viewer", session,
      composite: { image: "rgba8", camera: "rgba8", mask: "gray8" } }));
    let state;
    const found = await new Promise((resolve, reject) => {
      setTimeout(() => reject(new Error("truth: no mask within 15 s")), 15_000);
      socket.onclose = (e) => reject(new Error("truth: closed, " + e.reason));
      socket.onmessage = ({ data }) => {
        if (typeof data === "string") {
          const reply = JSON.parse(data);
          if (reply.type === "state") state = reply;
          return;
        }
        const composite = decodeComposite(data);
        socket.send('{"type":"credit"}');
        if (composite.planes.mask.codec === "gray8") resolve(composite);
      };
    });
    socket.onclose = null;
    socket.close();
    return { state, width: found.camera.width, height: found.camera.height,
      image: found.planes.image.bytes, camera: found.planes.camera.bytes, mask: found.planes.mask.bytes };
  },
  /** Mean absolute difference of two RGBA pictures, over the pixels that \`where\` accepts. */
  difference(a, b, where = () => true) {
    let sum = 0, n = 0;
    for (let i = 0; i < a.length / 4; i++) {
      if (!where(i)) continue;
      n += 1;
      for (let c = 0; c < 3; c++) sum += Math.abs(a[4 * i + c] - b[4 * i + c]) / 3;
    }
    return n ? sum / n : NaN;
  },
  /** Centre and lowest row of a mask, pixels. */
  where({ mask, width }) {
    let n = 0, x = 0, y = 0, foot = 0;
    mask.forEach((m, i) => {
      if (m < 128) return;
      n += 1; x += i % width; y += Math.floor(i / width); foot = Math.max(foot, Math.floor(i / width));
    });
    return { n, x: x / n, y: y / n, foot };
  },
  async split(share) {
    const slider = document.getElementById("split");
    slider.value = share;
    slider.dispatchEvent(new Event("input"));
    // The camera's picture is sent on demand; the figures show when it arrives.
    for (let i = 0; share > 0 && i < 200 && !this.message().original; i++) await new Promise((r) => setTimeout(r, 50));
    await new Promise((r) => setTimeout(r, 200));
  },
  /** Size of the last message, KiB, and whether it contained the camera's picture. */
  message() {
    const facts = document.getElementById("facts").textContent;
    return { kib: Number(/Message(\\d+) KiB/.exec(facts)?.[1]), original: facts.includes("with the original") };
  },
  /** Sum and count of a histogram in the server's metrics. */
  async histogram(name, step) {
    const text = await (await fetch("/metrics")).text();
    const value = (what) => Number(text.split(\`ghostlight_\${name}_\${what}{step="\${step}"} \`)[1].split("\\n")[0]);
    return { sum: value("sum"), count: value("count") };
  },
  ms: (id) => parseFloat(document.getElementById(id).textContent),
};`;

const folder = mkdtempSync(join(tmpdir(), "ghostlight-page-"));
const still = join(folder, "still");
let server, browser, page;
const live = `document.readyState === "complete" && location.protocol === "http:" && document.getElementById("status").dataset.phase === "open" && document.getElementById("overlay").hidden`;

async function keep(name) {
  if (!process.env.GHOSTLIGHT_SCREENSHOTS) return;
  mkdirSync(process.env.GHOSTLIGHT_SCREENSHOTS, { recursive: true });
  writeFileSync(join(process.env.GHOSTLIGHT_SCREENSHOTS, `${name}.png`), await page.screenshot());
}

/** Position on the page of a pixel of the 640x480 picture. */
async function spot(u, v) {
  return page.evaluate(`(() => {
    const b = document.getElementById("canvas").getBoundingClientRect();
    return [b.left + (${u} + 0.5) / 640 * b.width, b.top + (${v} + 0.5) / 480 * b.height];
  })()`);
}

before(async () => {
  writeStill(still);
  server = await Server.start(still);
  browser = new Chromium(process.env.CHROMIUM ?? "chromium");
});

after(async () => {
  await browser?.close();
  await server?.end("SIGKILL").catch(() => {});
  rmSync(folder, { recursive: true, force: true });
});

test("pixels arrive soon after the page is opened", async (t) => {
  const start = Date.now();
  page = await browser.open(server.url, { width: 1280, height: 860 });
  await page.until(live, "the first picture");
  t.diagnostic(`first picture after ${Date.now() - start} ms`);
  await page.evaluate(TOOLS);
  const spread = await page.evaluate(`(() => {
    const { data } = tools.grab();
    const luma = Array.from({ length: data.length / 4 }, (_, i) => data[4 * i + 1]);
    return [Math.min(...luma.slice(0, 50000)), Math.max(...luma.slice(0, 50000))];
  })()`);
  assert.ok(spread[1] - spread[0] > 100, `a picture, not a plain colour: ${spread}`);
  assert.equal(await page.evaluate(`tools.$("source").textContent`), "still · teapot");
});

test("the composite differs from the original where the object is, and the slider shows both", async () => {
  const found = await page.evaluate(`(async () => {
    const truth = await tools.truth();
    const composite = tools.grab().data;
    await tools.split(1);
    const original = tools.grab().data;
    await tools.split(0.5);
    const half = tools.grab().data;
    const { width } = truth;
    const left = (i) => i % width < width / 2 - 1, right = (i) => i % width > width / 2 + 1;
    const object = (i) => truth.mask[i] > 250;
    // Far from the object and from its shadows and light.
    const at = tools.where(truth);
    const away = (i) => Math.hypot(i % width - at.x, i / width - at.y) > 200;
    return {
      n: at.n,
      composite: tools.difference(composite, truth.image),
      original: tools.difference(original, truth.camera),
      onObject: tools.difference(composite, original, object),
      away: tools.difference(composite, original, away),
      halfLeft: tools.difference(half, original, left),
      halfRight: tools.difference(half, composite, right),
      halfLeftOfComposite: tools.difference(half, composite, (i) => left(i) && object(i)),
    };
  })()`);
  await keep("split");
  await page.evaluate("tools.split(0)");
  assert.ok(found.n > 1000, `object pixels: ${found.n}`);
  // JPEG at quality 85 has an error of about 2 of 255.
  assert.ok(found.composite < 4, `composite as the server has it: ${found.composite}`);
  assert.ok(found.original < 4, `original as the camera has it: ${found.original}`);
  assert.ok(found.onObject > 20, `on the object: ${found.onObject}`);
  assert.ok(found.away < 1.5, `away from it: ${found.away}`);
  assert.ok(found.halfLeft < 0.5 && found.halfRight < 0.5, `halves: ${JSON.stringify(found)}`);
  assert.ok(found.halfLeftOfComposite > 20, `halves: ${JSON.stringify(found)}`);
});

test("the original is sent only while it is looked at", async (t) => {
  const size = async (wanted) => {
    await page.until(`tools.message().original === ${wanted}`, `the original ${wanted ? "comes" : "stays away"}`);
    return page.evaluate("tools.message().kib");
  };
  const before = await size(false);
  await page.evaluate("tools.split(0.5)");
  const during = await size(true);
  await page.evaluate("tools.split(0)");
  const after = await size(false);
  t.diagnostic(`${before} KiB, ${during} KiB with the original, ${after} KiB again`);
  assert.ok(during > 1.6 * before && after < 1.1 * before, `${before} ${during} ${after}`);
});

test("the slider is worked from the keyboard", async () => {
  await page.evaluate(`tools.$("split").focus()`);
  await page.key("End");
  assert.equal(await page.evaluate(`tools.$("split").value`), "1");
  await page.key("Home");
  assert.equal(await page.evaluate(`tools.$("split").value`), "0");
});

test("a click puts the object on the surface there", async () => {
  const start = await page.evaluate("tools.truth().then(tools.where)");
  const [u, v] = [430, 330];
  await page.click(...(await spot(u, v)));
  const end = await page.until(
    `tools.truth().then(tools.where).then((w) => Math.abs(w.x - ${start.x}) > 60 && w)`,
    "the object moves",
  );
  assert.ok(Math.abs(end.x - u) < 30, `across: ${end.x} for a click at ${u}`);
  // It stands on the point: its base is there or, for a round object, slightly before it.
  assert.ok(end.foot >= v - 5 && end.foot < v + 60, `foot: ${end.foot} for a click at ${v}`);
  const onPage = await page.evaluate(`(async () => {
    const truth = await tools.truth(), composite = tools.grab().data;
    return tools.difference(composite, truth.camera, (i) => truth.mask[i] > 250);
  })()`);
  assert.ok(onPage > 20, `the page shows it there: ${onPage}`);
  await keep("placed");
});

test("a drag turns it, and so do button and keyboard", async () => {
  const angle = (truth) => `${truth}.state.objects[0].stands.turned`;
  const turned = async (what, act) => {
    // The last turns of a drag may still be in flight.
    await page.until(`(async () => {
      const earlier = await tools.truth();
      await new Promise((later) => setTimeout(later, 300));
      tools.before = await tools.truth();
      return ${angle("earlier")} === ${angle("tools.before")};
    })()`, `${what}: the object at rest`);
    await act();
    await page.until(`tools.truth().then((t) =>
      tools.difference(t.image, tools.before.image, (i) => t.mask[i] > 250 || tools.before.mask[i] > 250) > 5)`, what);
    const moved = await page.evaluate(`tools.truth().then((t) => tools.where(t).x - tools.where(tools.before).x)`);
    assert.ok(Math.abs(moved) < 40, `${what}: turned where it stands, not moved by ${moved}`);
    return page.evaluate(`tools.truth().then((t) => ${angle("t")} - ${angle("tools.before")})`);
  };
  const near = (got, expected, what) => assert.ok(Math.abs(got - expected) < 1e-9, `${what}: by ${got}`);
  const [x, y] = await spot(300, 200);
  await turned("drag", () => page.drag(x, y, x + 150, y));
  near(await turned("button", () => page.evaluate(`tools.$("turn-left").click()`)), -Math.PI / 12, "button");
  await page.evaluate(`tools.$("canvas").focus()`);
  near(await turned("key", () => page.key("]", "BracketRight")), Math.PI / 12, "key");
});

test("what the server refuses is said, and the picture goes on", async () => {
  await page.evaluate(`(() => {
    const samples = document.querySelector('[name="shadows.samples"]');
    samples.min = -9;
    samples.value = -9;
    samples.dispatchEvent(new Event("input"));
  })()`);
  await page.until(`/settings.*expected.*got/.test(tools.$("toast").textContent)`, "the refusal");
  await page.until(`document.querySelector('[name="shadows.samples"]').value > 0`, "the control shows what holds");
  assert.ok(await page.evaluate(live));
});

test("switches change the settings of the session, and their way back", async () => {
  const settings = () => page.evaluate("tools.truth().then((t) => t.state.settings)");
  const before = await settings();
  await page.evaluate(`document.querySelector('[name="bloom.enabled"]').click()`);
  await page.until(`tools.truth().then((t) => t.state.settings.bloom.enabled === ${!before.bloom.enabled})`, "bloom");
  await page.evaluate(`(() => {
    const shadows = document.querySelector('[name="shadows.method"]');
    shadows.value = '"off"';
    shadows.dispatchEvent(new Event("change"));
  })()`);
  await page.until(`tools.truth().then((t) => t.state.settings.shadows.method === "off")`, "shadows");
  const changed = await settings();
  assert.equal(changed.bloom.enabled, !before.bloom.enabled, "one switch leaves the other alone");
  await page.evaluate(`tools.$("reset").click()`);
  await page.until(`tools.truth().then((t) => t.state.settings.shadows.method !== "off")`, "back");
  assert.deepEqual(await settings(), before);
});

test("the page's latency agrees with the server's stamps", async (t) => {
  await new Promise((r) => setTimeout(r, 3500));
  // Client and server are on the same machine, so times on its clock are exact.
  const { shown, direct } = await page.evaluate(`(async () => {
    const { decodeComposite } = await import("/client/src/protocol.js");
    const [{ session }] = await (await fetch("/api/v1/sessions")).json();
    const socket = new WebSocket(location.origin.replace("http", "ws") + "/ws", "ghostlight.v1");
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", version: 1, role: "viewer", session }));
    const direct = [], shown = [];
    await new Promise((resolve) => {
      socket.onmessage = ({ data }) => {
        if (typeof data === "string") return;
        const now = performance.timeOrigin + performance.now();
        const { stamps } = decodeComposite(data);
        direct.push(now - stamps.received);
        shown.push(tools.ms("latency"));
        socket.send('{"type":"credit"}');
        if (direct.length === 40) resolve();
      };
    });
    socket.close();
    const middle = (a) => a.sort((x, y) => x - y)[a.length >> 1];
    return { shown: middle(shown), direct: middle(direct) };
  })()`);
  t.diagnostic(`page: ${shown} ms to drawn; by the machine's own clock: ${direct.toFixed(1)} ms to arrived`);
  assert.ok(shown > 0 && direct > 0);
  // Drawing takes some milliseconds, and the two values were measured at different frames.
  assert.ok(Math.abs(shown - direct) < Math.max(25, 0.4 * direct), `${shown} against ${direct}`);
});

test("what the page reports lies between the server's own times", async (t) => {
  // For the same composites: sent, and drawn by the page's clock, and credited by the server's clock.
  const steps = [["step_seconds", "received_to_sent"], ["client_seconds", "received_to_drawn"], ["step_seconds", "received_to_credit"]];
  const all = () => page.evaluate(`Promise.all(${JSON.stringify(steps)}.map((s) => tools.histogram(...s)))`);
  const before = await all();
  await new Promise((r) => setTimeout(r, 2500));
  const after = await all();
  const [sent, drawn, credited] = after.map((h, i) => (1e3 * (h.sum - before[i].sum)) / (h.count - before[i].count));
  const shown = await page.evaluate(`tools.ms("latency")`);
  t.diagnostic(`received to sent ${sent.toFixed(1)} ms, drawn ${drawn.toFixed(1)} ms (page shows ${shown} ms), credited ${credited.toFixed(1)} ms`);
  // The page knows the server's clock to half of its shortest round trip: less than a millisecond here.
  const clock = 1;
  assert.ok(sent - clock < drawn && drawn < credited + clock, `${sent} ${drawn} ${credited}`);
  // A median of three seconds compared with a mean of two and a half.
  assert.ok(Math.abs(shown - drawn) < 3 + 0.3 * drawn, `${shown} shown, ${drawn} reported`);
});

test("a server that is killed and comes back has the object where it was put", async () => {
  assert.equal(await page.evaluate(`tools.$("source").textContent`), "still · teapot");
  const [u, v] = [200, 320];
  await page.click(...(await spot(u, v)));
  await page.until(`tools.truth().then(tools.where).then((w) => Math.abs(w.x - ${u}) < 30)`, "the object moves");
  const [x, y] = await spot(300, 200);
  await page.drag(x, y, x + 90, y);
  // The last turn of a drag is applied a moment after the mouse is released.
  await new Promise((r) => setTimeout(r, 700));
  await page.evaluate("tools.truth().then((t) => { tools.before = t })");
  await server.end("SIGKILL");
  await page.until(`tools.$("status").dataset.phase === "waiting"`, "the loss is seen");
  server = await Server.start(still, new URL(server.url).host);
  await page.until(live, "the picture comes back", 30_000);
  await page.until(`tools.truth().then((t) => {
    const changed = t.mask.reduce((n, m, i) => n + (Math.abs(m - tools.before.mask[i]) > 2), 0);
    return changed === 0 && tools.difference(t.image, tools.before.image) < 0.05;
  })`, "pixel for pixel as it was");
  const shown = await page.evaluate(`(async () => {
    const truth = await tools.truth();
    return tools.difference(tools.grab().data, truth.image);
  })()`);
  assert.ok(shown < 4, `the page shows it: ${shown}`);
  page.errors = page.errors.filter((e) => !/ERR_CONNECTION|Failed to load|WebSocket/.test(e));
});

test("recording and scene are chosen", async () => {
  await page.evaluate(`(() => {
    const list = tools.$("recording");
    list.value = "recording:desk";
    list.dispatchEvent(new Event("change"));
  })()`);
  await page.until(`tools.$("source").textContent === "desk · teapot"`, "recording");
  await page.evaluate(`(() => {
    const list = tools.$("scene");
    list.value = "materials";
    list.dispatchEvent(new Event("change"));
  })()`);
  await page.until(`tools.$("source").textContent === "desk · materials"`, "scene");
  await page.until(`!tools.$("object-row").hidden && tools.$("object").options.length > 2`, "objects to choose from");
  await keep("materials");
});

test("a killed server is reconnected to, and shows what was shown", async () => {
  const errorsSoFar = [...page.errors];
  await server.end("SIGKILL");
  await page.until(`tools.$("status").dataset.phase === "waiting"`, "the loss is seen");
  assert.equal(await page.evaluate(`tools.$("status-text").textContent`), "Disconnected");
  assert.match(await page.evaluate(`tools.$("countdown").textContent`), /next attempt in \d+ s/);
  assert.equal(await page.evaluate(`tools.$("retry").hidden`), false);
  await keep("lost");
  server = await Server.start(still, new URL(server.url).host);
  await page.until(live, "the picture comes back", 30_000);
  assert.equal(await page.evaluate(`tools.$("source").textContent`), "desk · materials");
  // Chromium logs failed connection attempts to a closed port, which are expected.
  const others = page.errors.slice(errorsSoFar.length).filter((e) => !/ERR_CONNECTION|Failed to load|WebSocket/.test(e));
  assert.deepEqual(others, []);
  page.errors = errorsSoFar;
});

test("at phone width every control is in reach, and a tap places", async () => {
  await page.size(390, 844, true);
  await page.until(`innerWidth === 390`, "phone width");
  await keep("phone");
  const found = await page.evaluate(`(() => {
    const out = [], small = [];
    for (const e of document.querySelectorAll("button, select, input, summary, canvas")) {
      const b = e.getBoundingClientRect();
      if (b.width === 0 || e.id === "split" || e.closest("[hidden]")) continue;
      const name = e.id || e.name || e.textContent;
      if (b.left < -0.5 || b.right > 390.5) out.push(name);
      // A switch or slider is operated through its whole label.
      const target = e.closest("label")?.getBoundingClientRect() ?? b;
      if (target.height < 24 || target.width < 24) small.push(name);
    }
    return { wide: document.documentElement.scrollWidth, out, small, picture: tools.$("stage").getBoundingClientRect().width };
  })()`);
  assert.deepEqual({ ...found, picture: 0 }, { wide: 390, out: [], small: [], picture: 0 });
  assert.ok(found.picture > 380, `the picture is as wide as the phone: ${found.picture}`);
  await page.evaluate(`(() => {
    const list = tools.$("scene");
    list.value = "teapot";
    list.dispatchEvent(new Event("change"));
  })()`);
  await page.until(`tools.$("source").textContent === "desk · teapot"`, "scene");
  const start = await page.evaluate("tools.truth().then(tools.where)");
  const [x, y] = await spot(450, 340);
  await page.send("Input.dispatchTouchEvent", { type: "touchStart", touchPoints: [{ x, y }] });
  await page.send("Input.dispatchTouchEvent", { type: "touchEnd", touchPoints: [] });
  await page.until(`tools.truth().then(tools.where).then((w) => w.x - ${start.x} > 50)`, "a tap moves it");
  await page.evaluate(`document.querySelector("#effects").scrollIntoView()`);
  await keep("phone-effects");
});

test("SIGTERM ends the server well, and the page says why", async () => {
  assert.equal(await server.end("SIGTERM"), 0);
  await page.until(`/stop/.test(tools.$("overlay-text").textContent)`, "the reason is shown");
  assert.deepEqual(page.errors.filter((e) => !/ERR_CONNECTION|Failed to load|WebSocket/.test(e)), []);
});
