//! Content of the vectors.

mod control;
pub(crate) mod fields;

use fields::{chunk_fields, composite_fields, composite_from, frame_fields};
use ghostlight_proto::{
    AssetChunk, Codec, Composite, CompositeHeader, Frame, FrameHeader, Intrinsics, Payloads, Pose,
    depth,
};
use serde_json::{Value, json};

fn camera(width: u32, height: u32) -> Intrinsics {
    Intrinsics {
        width,
        height,
        fx: 525.25,
        fy: 524.75,
        cx: f64::from(width) / 2.0 - 0.5,
        cy: f64::from(height) / 2.0 - 0.5,
    }
}

const POSE: Pose = Pose {
    translation: [1.5, -0.25, 100_000.125],
    quaternion: [0.5, -0.5, 0.5, 0.5],
};

/// Depth with every case that a codec distinguishes: holes at both ends, the extreme values, steps in both
/// directions.
const PIXELS: [u16; 12] = [0, 0, 1000, 1003, 1001, 0, 65535, 1, 40000, 39990, 7, 0];

fn frame<'a>(color: &'a [u8], depth: &'a [u8]) -> Frame<'a> {
    Frame {
        header: FrameHeader {
            sequence: 0x0102_0304_0506_0708,
            capture_ns: -1_500_000_000_000_000_123,
            pose: POSE,
            color: camera(2, 2),
            depth: camera(4, 3),
            color_from_depth: Pose {
                translation: [0.025, 0.0, -0.001],
                quaternion: [0.0, 0.0, 0.0, 1.0],
            },
            metres_per_unit: 0.0002,
            color_codec: Codec::Rgb8,
            depth_codec: Codec::U16,
            max_depth_m: 7.5,
        },
        color,
        depth,
    }
}

fn put(bytes: &[u8], offset: usize, value: &[u8]) -> Vec<u8> {
    let mut out = bytes.to_vec();
    out[offset..offset + value.len()].copy_from_slice(value);
    out
}

/// A message with eight additional header bytes.
fn longer(message: &[u8]) -> Vec<u8> {
    let header_bytes = u32::from_le_bytes(message[4..8].try_into().unwrap());
    let (header, payloads) = message.split_at(header_bytes as usize);
    let mut out = put(header, 4, &(header_bytes + 8).to_le_bytes());
    out.extend_from_slice(b"\xAA\xBB\xCC\xDD\xEE\xFF\x00\x11");
    out.extend_from_slice(payloads);
    out
}

/// Every vector: its index entry and its bytes.
pub(crate) fn vectors() -> Vec<(Value, Vec<u8>)> {
    let mut all = Vec::new();
    let color: Vec<u8> = (0..12).map(|i| i * 21).collect();
    let units: Vec<u8> = PIXELS.iter().flat_map(|p| p.to_le_bytes()).collect();
    let plain = frame(&color, &units);
    let bytes = plain.encode().unwrap();
    let mut good = |file: &str, kind: &str, expect: Value, bytes: Vec<u8>| {
        all.push((json!({"file": file, "kind": kind, "expect": expect}), bytes));
    };
    good(
        "frame_raw.bin",
        "frame",
        frame_fields(&plain),
        bytes.clone(),
    );

    good(
        "frame_long_header.bin",
        "frame",
        frame_fields(&plain),
        longer(&bytes),
    );

    let rvl = depth::encode_rvl(&PIXELS);
    let mut coded = frame(&[0xFF, 0xD8, 0xFF, 0xD9], &rvl);
    coded.header.color_codec = Codec::Jpeg;
    coded.header.depth_codec = Codec::Rvl;
    coded.header.max_depth_m = 0.0;
    good(
        "frame_jpeg_rvl.bin",
        "frame",
        frame_fields(&coded),
        coded.encode().unwrap(),
    );

    let planes: [Vec<u8>; 4] = [
        vec![0xFF, 0xD8, 0xFF, 0xD9],
        (0..48).collect(),
        (0..12).map(|i| 255 - i * 20).collect(),
        rvl.clone(),
    ];
    let full = composite_from(
        &json!({
            "sequence": "7", "capture_ns": "-5", "pose": POSE, "camera_intrinsics": camera(4, 3),
            "received_ns": "1700000000000000001", "decode_start_ns": "1700000000000000002",
            "decoded_ns": "1700000000000000003", "render_start_ns": "1700000000000000004",
            "render_end_ns": "1700000000000000005", "encode_start_ns": "1700000000000000006",
            "encoded_ns": "1700000000000000007", "sent_ns": "1700000000000000008",
            "dropped_frames": "4294967296", "dropped_composites": "3",
            "image_codec": "jpeg", "camera_codec": "rgba8", "mask_codec": "gray8",
            "depth_codec": "rvl", "virtual_pixels": 5, "traced_pixels": 9, "secondary_rays": 17,
            "unknown_rays": 2, "stage_us": [10, 20, 4_000_000_000u32],
        }),
        &planes,
    );
    let composite = full.encode().unwrap();
    good(
        "composite_full.bin",
        "composite",
        composite_fields(&full),
        composite.clone(),
    );
    let bare = Composite {
        header: CompositeHeader {
            camera_codec: Codec::None,
            mask_codec: Codec::None,
            depth_codec: Codec::None,
            stage_us: Vec::new(),
            ..full.header.clone()
        },
        planes: Payloads {
            image: &planes[0],
            ..Payloads::default()
        },
    };
    good(
        "composite_bare.bin",
        "composite",
        composite_fields(&bare),
        bare.encode().unwrap(),
    );

    let chunk = AssetChunk {
        upload: 3,
        offset: 65536,
        bytes: b"v 0 0 0\n",
    };
    let chunk_bytes = chunk.encode().unwrap();
    good(
        "asset_chunk.bin",
        "asset_chunk",
        chunk_fields(&chunk),
        chunk_bytes.clone(),
    );

    // Written as by a later version: the message decodes, and the rest of the header is skipped.
    for (file, kind, fields, bytes) in [
        (
            "composite_long_header.bin",
            "composite",
            composite_fields(&full),
            longer(&composite),
        ),
        (
            "asset_chunk_long_header.bin",
            "asset_chunk",
            chunk_fields(&chunk),
            longer(&chunk_bytes),
        ),
    ] {
        good(file, kind, fields, bytes);
    }
    for (file, kind, text, read) in control::GOOD {
        let expect: Value = serde_json::from_str(read.unwrap_or(text)).unwrap();
        good(file, kind, expect, text.as_bytes().to_vec());
    }

    let zeros = vec![0u16; 4096];
    let mut sized = |file: &str, kind: &str, w: u32, h: u32, pixels: &[u16], bytes: Vec<u8>| {
        let entry = json!({"file": file, "kind": kind, "width": w, "height": h,
            "expect": {"pixels": pixels}});
        all.push((entry, bytes));
    };
    sized("depth.rvl", "rvl", 4, 3, &PIXELS, rvl.clone());
    sized(
        "depth_empty.rvl",
        "rvl",
        64,
        64,
        &zeros,
        depth::encode_rvl(&zeros),
    );
    let zstd = depth::encode_delta_zstd(&PIXELS).unwrap();
    sized(
        "depth.delta_zstd",
        "delta_zstd",
        4,
        3,
        &PIXELS,
        zstd.clone(),
    );

    let mut bad_sized = |file: &str, kind: &str, bytes: Vec<u8>| {
        let entry = json!({"file": file, "kind": kind, "width": 4, "height": 3,
            "error": "decode"});
        all.push((entry, bytes));
    };
    bad_sized("bad_truncated.rvl", "rvl", rvl[..rvl.len() - 4].to_vec());
    bad_sized(
        "bad_trailing.rvl",
        "rvl",
        [&rvl[..], &[0, 0, 0, 0]].concat(),
    );
    bad_sized("bad_no_progress.rvl", "rvl", vec![0; 64]);
    bad_sized("bad_too_many.rvl", "rvl", depth::encode_rvl(&[5; 13]));
    bad_sized(
        "bad_truncated.delta_zstd",
        "delta_zstd",
        zstd[..zstd.len() - 3].to_vec(),
    );
    bad_sized(
        "bad_trailing.delta_zstd",
        "delta_zstd",
        [&zstd[..], b"x"].concat(),
    );
    // 64 MiB of zeros in 2 KiB.
    let bomb = zstd::bulk::compress(&vec![0; 64 << 20], 19).unwrap();
    bad_sized("bad_bomb.delta_zstd", "delta_zstd", bomb);

    let mut bad = |file: &str, kind: &str, code: &str, bytes: Vec<u8>| {
        all.push((json!({"file": file, "kind": kind, "error": code}), bytes));
    };
    bad("bad_empty.bin", "frame", "malformed", Vec::new());
    bad("bad_magic.bin", "frame", "malformed", put(&bytes, 0, b"LG"));
    bad("bad_version.bin", "frame", "version", put(&bytes, 2, &[2]));
    bad(
        "bad_kind.bin",
        "frame",
        "unknown_type",
        put(&bytes, 3, &[9]),
    );
    bad(
        "bad_header_bytes.bin",
        "frame",
        "malformed",
        put(&bytes, 4, &u32::MAX.to_le_bytes()),
    );
    bad(
        "bad_header_short.bin",
        "frame",
        "malformed",
        put(&bytes, 4, &8u32.to_le_bytes()),
    );
    bad(
        "bad_truncated_header.bin",
        "frame",
        "malformed",
        bytes[..200].to_vec(),
    );
    bad(
        "bad_truncated_payload.bin",
        "frame",
        "length",
        bytes[..bytes.len() - 1].to_vec(),
    );
    bad(
        "bad_trailing.bin",
        "frame",
        "length",
        [&bytes[..], b"x"].concat(),
    );
    bad(
        "bad_sizes.bin",
        "frame",
        "length",
        put(&bytes, 228, &u32::MAX.to_le_bytes()),
    );
    bad(
        "bad_pose_nan.bin",
        "frame",
        "pose",
        put(&bytes, 24, &f64::NAN.to_le_bytes()),
    );
    bad(
        "bad_pose_scale.bin",
        "frame",
        "pose",
        put(&bytes, 48, &2f64.to_le_bytes()),
    );
    bad(
        "bad_pose_huge.bin",
        "frame",
        "pose",
        put(&bytes, 72, &1e200f64.to_le_bytes()),
    );
    bad(
        "bad_pose_far.bin",
        "frame",
        "pose",
        put(&bytes, 40, &(-1e12f64).to_le_bytes()),
    );
    bad(
        "bad_extrinsics_far.bin",
        "frame",
        "pose",
        put(&bytes, 160, &1e200f64.to_le_bytes()),
    );
    bad(
        "bad_extrinsics.bin",
        "frame",
        "pose",
        put(&bytes, 208, &f64::INFINITY.to_le_bytes()),
    );
    bad(
        "bad_fx_zero.bin",
        "frame",
        "intrinsics",
        put(&bytes, 88, &0f64.to_le_bytes()),
    );
    bad(
        "bad_fy_negative.bin",
        "frame",
        "intrinsics",
        put(&bytes, 136, &(-5f64).to_le_bytes()),
    );
    bad(
        "bad_cx_nan.bin",
        "frame",
        "intrinsics",
        put(&bytes, 104, &f64::NAN.to_le_bytes()),
    );
    bad(
        "bad_unit.bin",
        "frame",
        "intrinsics",
        put(&bytes, 216, &0f64.to_le_bytes()),
    );
    bad(
        "bad_max_depth.bin",
        "frame",
        "intrinsics",
        put(&bytes, 236, &(-1f32).to_le_bytes()),
    );
    bad(
        "bad_width_zero.bin",
        "frame",
        "size",
        put(&bytes, 80, &0u32.to_le_bytes()),
    );
    bad(
        "bad_height_huge.bin",
        "frame",
        "size",
        put(&bytes, 124, &9000u32.to_le_bytes()),
    );
    bad(
        "bad_size_not_payload.bin",
        "frame",
        "size",
        put(&bytes, 80, &3u32.to_le_bytes()),
    );
    bad(
        "bad_color_codec.bin",
        "frame",
        "codec",
        put(&bytes, 224, &[99]),
    );
    bad(
        "bad_depth_codec.bin",
        "frame",
        "codec",
        put(&bytes, 225, &[1]),
    );
    bad(
        "bad_composite_stages.bin",
        "composite",
        "malformed",
        put(&composite, 236, &[200]),
    );
    bad(
        "bad_composite_mask.bin",
        "composite",
        "codec",
        put(&composite, 202, &[1]),
    );
    bad(
        "bad_chunk_empty.bin",
        "asset_chunk",
        "length",
        chunk_bytes[..24].to_vec(),
    );
    bad(
        "bad_composite_pose.bin",
        "composite",
        "pose",
        put(&composite, 48, &2f64.to_le_bytes()),
    );
    bad(
        "bad_composite_fx.bin",
        "composite",
        "intrinsics",
        put(&composite, 88, &0f64.to_le_bytes()),
    );
    bad(
        "bad_composite_size.bin",
        "composite",
        "size",
        put(&composite, 80, &5u32.to_le_bytes()),
    );
    bad(
        "bad_composite_trailing.bin",
        "composite",
        "length",
        [&composite[..], b"x"].concat(),
    );
    bad(
        "bad_composite_none_with_bytes.bin",
        "composite",
        "size",
        put(&composite, 202, &[0]),
    );
    bad(
        "bad_frame_is_composite.bin",
        "frame",
        "unknown_type",
        composite.clone(),
    );
    bad(
        "bad_chunk_is_frame.bin",
        "asset_chunk",
        "unknown_type",
        bytes.clone(),
    );
    bad(
        "bad_chunk_truncated.bin",
        "asset_chunk",
        "malformed",
        chunk_bytes[..20].to_vec(),
    );
    for (file, kind, code, text) in control::BAD {
        bad(file, kind, code, text.as_bytes().to_vec());
    }
    all
}
