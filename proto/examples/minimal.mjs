// A complete client: streams RGB-D frames to Ghostlight and returns the composites. Runs in a page and in Node 22
// (`node minimal.mjs [ws://127.0.0.1:8080/ws [token]]`; Node 20: `node --experimental-websocket ...`). Written from
// ../README.md alone. The frames show a grey wall 1 m away; replace them with your camera.

const WIDTH = 320, HEIGHT = 240, FOCAL = 262.5, HEADER = 240;

export function frameMessage(sequence, rgb, depthMm) {
  const view = new DataView(new ArrayBuffer(HEADER + rgb.byteLength + depthMm.byteLength));
  const f64 = (offset, values) => values.forEach((v, i) => view.setFloat64(offset + 8 * i, v, true));
  [0x47, 0x4c, 1, 1].forEach((byte, i) => view.setUint8(i, byte)); // "GL", version, frame
  view.setUint32(4, HEADER, true);
  view.setBigUint64(8, BigInt(sequence), true);
  view.setBigInt64(16, BigInt(Math.round(now() * 1e3)) * 1000n, true); // capture time, ns
  f64(24, [0, 0, 0, 0, 0, 0, 1]); // pose: translation, quaternion x y z w
  for (const camera of [80, 120]) { // colour, depth
    view.setUint32(camera, WIDTH, true), view.setUint32(camera + 4, HEIGHT, true);
    f64(camera + 8, [FOCAL, FOCAL, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5]);
  }
  f64(160, [0, 0, 0, 0, 0, 0, 1, 0.001]); // depth is registered, in millimetres
  view.setUint8(224, 3), view.setUint8(225, 16); // rgb8, u16
  view.setUint32(228, rgb.byteLength, true), view.setUint32(232, depthMm.byteLength, true);
  new Uint8Array(view.buffer, HEADER).set(rgb);
  new Uint8Array(view.buffer, HEADER + rgb.byteLength).set(new Uint8Array(depthMm.buffer));
  return view.buffer; // depthMm is little-endian on every machine that runs this
}

const now = () => performance.timeOrigin + performance.now(); // ms

export function readComposite(buffer) {
  const view = new DataView(buffer), start = view.getUint32(4, true);
  const time = (offset) => Number(view.getBigInt64(offset, true)) / 1e6;
  return {
    sequence: Number(view.getBigUint64(8, true)), latencyMs: now() - time(16), serverMs: time(176) - time(120),
    image: new Blob([new Uint8Array(buffer, start, view.getUint32(204, true))], { type: "image/jpeg" }),
  };
}

/** Sends `n` frames, each after the composite of the previous one; resolves to the composites. */
export function run(url, token, n = 10) {
  return new Promise((resolve, reject) => {
    const socket = new WebSocket(url, "ghostlight.v1"), composites = [];
    const rgb = new Uint8Array(3 * WIDTH * HEIGHT).fill(128), depthMm = new Uint16Array(WIDTH * HEIGHT).fill(1000);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", version: 1, role: "producer", token }));
    socket.onclose = (event) => reject(new Error(`closed: ${event.code} ${event.reason}`));
    socket.onmessage = ({ data }) => {
      const control = typeof data === "string" ? JSON.parse(data) : null;
      if (control?.type === "error") reject(new Error(`${control.what}: expected ${control.expected}, got ${control.got}`));
      if (!control) composites.push(readComposite(data)), socket.send('{"type":"credit"}');
      if (composites.length === n) resolve(composites), socket.close();
      else if (!control || control.type === "welcome") socket.send(frameMessage(composites.length, rgb, depthMm));
    };
  });
}

if (globalThis.process?.argv[1]?.endsWith("minimal.mjs")) {
  const composites = await run(process.argv[2] ?? "ws://127.0.0.1:8080/ws", process.argv[3]);
  for (const c of composites) console.log(`frame ${c.sequence}: ${c.latencyMs.toFixed(1)} ms, ${c.serverMs.toFixed(1)} ms in the server`);
}
