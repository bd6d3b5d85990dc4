/** Another's zstd decoder, a package for tests only. */

const decompress = await import("fzstd").then((fzstd) => fzstd.decompress, () => null);

/** Why tests of compressed blocks are skipped, or false. */
export const missing = decompress ? false : "fzstd is not installed: npm --prefix client-web ci";
if (missing) console.log(`SKIPPED: ${missing}`);

/** As `readZstd` takes it. */
export const unzstd = decompress ? (frame, n) => decompress(frame, new Uint8Array(n)) : undefined;
