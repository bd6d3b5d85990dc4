/** A zstd decoder from a package, for tests only. */

const decompress = await import("fzstd").then((fzstd) => fzstd.decompress, () => null);

/** The reason to skip tests of compressed blocks, or false. */
export const missing = decompress ? false : "fzstd is not installed: npm --prefix client-web ci";
if (missing) console.log(`SKIPPED: ${missing}`);

/** The decoder in the form that `readZstd` expects. */
export const unzstd = decompress ? (frame, n) => decompress(frame, new Uint8Array(n)) : undefined;
