//! Fields of messages in the form of the index: 64-bit integers as strings, payloads in hexadecimal.

use ghostlight_proto::{
    AssetChunk, Composite, CompositeHeader, Frame, FrameHeader, Payloads, Stamps,
};
use serde_json::{Value, json};

pub(crate) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

pub(crate) fn unhex(value: &Value) -> Vec<u8> {
    let text = value.as_str().unwrap();
    (0..text.len() / 2)
        .map(|i| u8::from_str_radix(&text[2 * i..2 * i + 2], 16).unwrap())
        .collect()
}

fn text(value: &Value) -> u64 {
    value.as_str().unwrap().parse().unwrap()
}

fn time(value: &Value) -> i64 {
    value.as_str().unwrap().parse().unwrap()
}

fn small(value: &Value) -> u32 {
    u32::try_from(value.as_u64().unwrap()).unwrap()
}

fn of<T: serde::de::DeserializeOwned>(value: &Value) -> T {
    serde_json::from_value(value.clone()).unwrap()
}

pub(crate) fn frame_fields(f: &Frame) -> Value {
    let h = &f.header;
    json!({
        "sequence": h.sequence.to_string(), "capture_ns": h.capture_ns.to_string(),
        "pose": h.pose, "color_camera": h.color, "depth_camera": h.depth,
        "color_from_depth": h.color_from_depth, "metres_per_unit": h.metres_per_unit,
        "max_depth_m": h.max_depth_m, "color_codec": h.color_codec, "depth_codec": h.depth_codec,
        "color": hex(f.color), "depth": hex(f.depth),
    })
}

pub(crate) fn frame_from<'a>(v: &Value, color: &'a [u8], depth: &'a [u8]) -> Frame<'a> {
    Frame {
        header: FrameHeader {
            sequence: text(&v["sequence"]),
            capture_ns: time(&v["capture_ns"]),
            pose: of(&v["pose"]),
            color: of(&v["color_camera"]),
            depth: of(&v["depth_camera"]),
            color_from_depth: of(&v["color_from_depth"]),
            metres_per_unit: of(&v["metres_per_unit"]),
            color_codec: of(&v["color_codec"]),
            depth_codec: of(&v["depth_codec"]),
            max_depth_m: of(&v["max_depth_m"]),
        },
        color,
        depth,
    }
}

pub(crate) fn composite_fields(c: &Composite) -> Value {
    let (h, s, p) = (&c.header, &c.header.stamps, &c.planes);
    json!({
        "sequence": h.sequence.to_string(), "capture_ns": h.capture_ns.to_string(),
        "pose": h.pose, "camera_intrinsics": h.camera,
        "received_ns": s.received_ns.to_string(), "decode_start_ns": s.decode_start_ns.to_string(),
        "decoded_ns": s.decoded_ns.to_string(), "render_start_ns": s.render_start_ns.to_string(),
        "render_end_ns": s.render_end_ns.to_string(),
        "encode_start_ns": s.encode_start_ns.to_string(),
        "encoded_ns": s.encoded_ns.to_string(), "sent_ns": s.sent_ns.to_string(),
        "dropped_frames": h.dropped_frames.to_string(),
        "dropped_composites": h.dropped_composites.to_string(),
        "image_codec": h.image_codec, "camera_codec": h.camera_codec,
        "mask_codec": h.mask_codec, "depth_codec": h.depth_codec,
        "virtual_pixels": h.virtual_pixels, "traced_pixels": h.traced_pixels,
        "secondary_rays": h.secondary_rays, "unknown_rays": h.unknown_rays,
        "stage_us": h.stage_us,
        "image": hex(p.image), "camera": hex(p.camera), "mask": hex(p.mask), "depth": hex(p.depth),
    })
}

pub(crate) fn composite_from<'a>(v: &Value, planes: &'a [Vec<u8>; 4]) -> Composite<'a> {
    let [image, camera, mask, depth] = planes;
    Composite {
        header: CompositeHeader {
            sequence: text(&v["sequence"]),
            capture_ns: time(&v["capture_ns"]),
            pose: of(&v["pose"]),
            camera: of(&v["camera_intrinsics"]),
            stamps: Stamps {
                received_ns: time(&v["received_ns"]),
                decode_start_ns: time(&v["decode_start_ns"]),
                decoded_ns: time(&v["decoded_ns"]),
                render_start_ns: time(&v["render_start_ns"]),
                render_end_ns: time(&v["render_end_ns"]),
                encode_start_ns: time(&v["encode_start_ns"]),
                encoded_ns: time(&v["encoded_ns"]),
                sent_ns: time(&v["sent_ns"]),
            },
            dropped_frames: text(&v["dropped_frames"]),
            dropped_composites: text(&v["dropped_composites"]),
            image_codec: of(&v["image_codec"]),
            camera_codec: of(&v["camera_codec"]),
            mask_codec: of(&v["mask_codec"]),
            depth_codec: of(&v["depth_codec"]),
            virtual_pixels: small(&v["virtual_pixels"]),
            traced_pixels: small(&v["traced_pixels"]),
            secondary_rays: small(&v["secondary_rays"]),
            unknown_rays: small(&v["unknown_rays"]),
            stage_us: of(&v["stage_us"]),
        },
        planes: Payloads {
            image,
            camera,
            mask,
            depth,
        },
    }
}

pub(crate) fn chunk_fields(c: &AssetChunk) -> Value {
    json!({ "upload": c.upload, "offset": c.offset.to_string(), "bytes": hex(c.bytes) })
}
