/** Messages of a producer: RGB-D frames and the files of its scene. */

import { CODECS, Header, HeaderWriter, WireError, checkCamera, checkPlane, checkPose, codecOf } from "./wire.js";

const FRAME_HEADER_BYTES = 240;
const CHUNK_HEADER_BYTES = 24;

/**
 * @typedef {object} Frame
 * @property {bigint} sequence chosen by the client, returned with the composite
 * @property {bigint} captureNs on the client's clock, returned with the composite
 * @property {import("./wire.js").Pose} pose world_from_camera, of the colour camera
 * @property {import("./wire.js").Camera} colorCamera
 * @property {import("./wire.js").Camera} depthCamera
 * @property {import("./wire.js").Pose} colorFromDepth identity where depth is registered to colour
 * @property {number} metresPerUnit 0.001 for millimetres
 * @property {number} maxDepthM larger depth is invalid; 0: no bound
 * @property {import("./wire.js").Plane} color
 * @property {import("./wire.js").Plane} depth
 */

/** @param {Frame} frame */
function checkFrame({ pose, colorCamera, depthCamera, colorFromDepth, metresPerUnit, maxDepthM, color, depth }) {
  checkPose("frame pose", pose);
  checkCamera("frame colour", colorCamera);
  checkCamera("frame depth", depthCamera);
  checkPose("frame color_from_depth", colorFromDepth);
  if (!(Number.isFinite(metresPerUnit) && metresPerUnit > 0)) {
    throw new WireError("intrinsics", "frame metres per unit", "a finite number above 0", metresPerUnit);
  }
  if (!(Number.isFinite(maxDepthM) && maxDepthM >= 0)) {
    throw new WireError("intrinsics", "frame largest depth", "a finite number of metres, 0 for no bound", maxDepthM);
  }
  checkPlane("color", color, colorCamera);
  checkPlane("depth", depth, depthCamera);
}

/**
 * Decodes and checks a frame; its payloads stay encoded and are views into the message.
 * @param {ArrayBuffer | Uint8Array<ArrayBuffer>} message
 * @returns {Frame}
 */
export function decodeFrame(message) {
  const h = new Header(message, "frame", FRAME_HEADER_BYTES);
  const [colorCodec, depthCodec] = [codecOf("color", h.u8(224)), codecOf("depth", h.u8(225))];
  const [color, depth] = /** @type {[Uint8Array<ArrayBuffer>, Uint8Array<ArrayBuffer>]} */ (
    h.payloads([h.u32(228), h.u32(232)])
  );
  const frame = {
    sequence: h.u64(8),
    captureNs: h.i64(16),
    pose: h.pose(24),
    colorCamera: h.camera(80),
    depthCamera: h.camera(120),
    colorFromDepth: h.pose(160),
    metresPerUnit: h.f64(216),
    maxDepthM: h.f32(236),
    color: { codec: colorCodec, bytes: color },
    depth: { codec: depthCodec, bytes: depth },
  };
  checkFrame(frame);
  return frame;
}

/**
 * Encodes a frame; throws if a server would reject it.
 * @param {Frame} frame
 */
export function encodeFrame(frame) {
  checkFrame(frame);
  const { color, depth } = frame;
  const out = new HeaderWriter("frame", FRAME_HEADER_BYTES, [color.bytes, depth.bytes]);
  out.u64(8, "frame sequence", frame.sequence);
  out.i64(16, "frame capture time", frame.captureNs);
  out.pose(24, frame.pose);
  out.camera(80, frame.colorCamera);
  out.camera(120, frame.depthCamera);
  out.pose(160, frame.colorFromDepth);
  out.f64s(216, [frame.metresPerUnit]);
  out.u8(224, CODECS[color.codec]);
  out.u8(225, CODECS[depth.codec]);
  out.u32(228, "colour bytes", color.bytes.length);
  out.u32(232, "depth bytes", depth.bytes.length);
  out.f32(236, frame.maxDepthM);
  return out.bytes;
}

/**
 * A chunk of an uploaded file.
 * @typedef {object} AssetChunk
 * @property {number} upload as announced
 * @property {bigint | number} offset offset in the file
 * @property {Uint8Array<ArrayBuffer>} bytes at least one
 */

/** @param {AssetChunk} chunk */
function checkChunk({ bytes }) {
  if (!(bytes?.length > 0)) throw new WireError("length", "asset chunk", "at least 1 byte", "0 bytes");
}

/**
 * Decodes and checks an asset chunk; its bytes are a view into the message.
 * @param {ArrayBuffer | Uint8Array<ArrayBuffer>} message
 * @returns {AssetChunk & {offset: bigint}}
 */
export function decodeAssetChunk(message) {
  const h = new Header(message, "asset chunk", CHUNK_HEADER_BYTES);
  const chunk = { upload: h.u32(8), offset: h.u64(16), bytes: h.bytes.subarray(h.end) };
  checkChunk(chunk);
  return chunk;
}

/**
 * Encodes an asset chunk.
 * @param {AssetChunk} chunk
 */
export function encodeAssetChunk(chunk) {
  checkChunk(chunk);
  const out = new HeaderWriter("asset chunk", CHUNK_HEADER_BYTES, [chunk.bytes]);
  out.u32(8, "asset chunk upload", chunk.upload);
  out.u64(16, "asset chunk offset", chunk.offset);
  return out.bytes;
}
