/**
 * The wire format (`proto/README.md`) for JavaScript clients: view sessions, stream RGB-D, or both.
 *
 * Viewers need only `control.js` and `composite.js`; this module exports everything.
 */

export { encodeRequest, hello, parseReply, parseRequest } from "./control.js";
export { decodeComposite, encodeComposite } from "./composite.js";
export { decodeAssetChunk, decodeFrame, encodeAssetChunk, encodeFrame } from "./frame.js";
export { decodeDeltaZstd, decodeDepth, decodeRvl, encodeDepth, encodeRvl } from "./depth.js";
export { decodePng, encodePng } from "./png.js";
export { CODECS, KINDS, MAX_SIDE, SUBPROTOCOL, VERSION, WireError } from "./wire.js";
