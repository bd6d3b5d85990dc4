/** Starts the real server with the bundled recording. */

import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import { cpSync, mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const recordings = fileURLToPath(new URL("../../recordings/", import.meta.url));
const program = process.env.GHOSTLIGHT_PROGRAM;
assert.ok(program, "GHOSTLIGHT_PROGRAM: expected the program to test, got nothing");

/** Writes a recording of one frame, so that pictures taken at different times can be compared. */
export function writeStill(folder) {
  for (const [list, plane] of [["rgb.txt", "rgb"], ["depth.txt", "depth"]]) {
    const lines = readFileSync(join(recordings, "desk", list), "utf8").split("\n");
    const first = lines.find((line) => line && !line.startsWith("#"));
    const file = first.split(" ")[1];
    mkdirSync(join(folder, plane), { recursive: true });
    cpSync(join(recordings, "desk", file), join(folder, file));
    writeFileSync(join(folder, list), `${first}\n`);
  }
  for (const file of ["groundtruth.txt", "manifest.json"]) {
    cpSync(join(recordings, "desk", file), join(folder, file));
  }
}

/** The server process, with the still and the bundled recording. */
export class Server {
  /** Starts the process; resolves when it reports its address. */
  static async start(still, listen = "127.0.0.1:0", more = []) {
    const server = new Server();
    const scenes = ["scenes/teapot.json", "scenes"].flatMap((s) => ["--scene", join(recordings, s)]);
    const offered = [still, join(recordings, "desk")].flatMap((r) => ["--recording", r]);
    // Pictures are compared, so quality must not depend on the load of this machine.
    const settings = join(still, "settings.json");
    writeFileSync(settings, JSON.stringify({ budget_ms: 0 }));
    const fixed = more.includes("--settings") ? [] : ["--settings", settings];
    server.child = spawn(program, ["serve", "--listen", listen, ...offered, ...scenes, ...fixed, ...more], { stdio: ["ignore", "pipe", "pipe"] });
    let said = "";
    server.url = await new Promise((resolve, reject) => {
      const hear = (text) => {
        said += text;
        const found = /https?:\/\/(\S+)/.exec(said);
        if (found) resolve(found[0]);
      };
      server.child.stdout.setEncoding("utf8").on("data", hear);
      server.child.stderr.setEncoding("utf8").on("data", hear);
      server.child.once("exit", (code) => reject(new Error(`server exited with ${code}: ${said}`)));
    });
    return server;
  }

  async end(signal) {
    const gone = new Promise((resolve) => this.child.once("exit", (code) => resolve(code)));
    this.child.kill(signal);
    return gone;
  }
}
