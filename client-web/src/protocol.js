/**
 * The wire format (`proto/README.md`) for clients in JavaScript: watch, stream RGB-D, or both.
 *
 * What a page needs to watch is in `control.js` and `composite.js`; this is everything.
 */

export { encodeRequest, hello, parseReply, parseRequest } from "./control.js";
export { decodeComposite, encodeComposite } from "./composite.js";
export { decodeAssetChunk, decodeFrame, encodeAssetChunk, encodeFrame } from "./frame.js";
export { decodeDeltaZstd, decodeDepth, decodeRvl, encodeDeltaZstd, encodeDepth, encodeRvl } from "./depth.js";
export { decodePng, encodePng } from "./png.js";
export { CODECS, KINDS, MAX_SIDE, SUBPROTOCOL, VERSION, WireError } from "./wire.js";
