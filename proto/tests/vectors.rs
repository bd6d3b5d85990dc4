//! The vectors in `vectors/` are equal to those of `vector_set`, decode to the fields in their index, and encode to
//! the same bytes.
//!
//! The index contains the fields chosen by `vector_set`, not the output of a decoder. After a change of the format,
//! write the vectors again with `WRITE_VECTORS=1 cargo test -p ghostlight-proto the_folder`.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

mod vector_set;

use std::path::PathBuf;

use ghostlight_proto::control::{Reply, Request};
use ghostlight_proto::{AssetChunk, Composite, Frame, WireError, depth};
use serde_json::Value;
use vector_set::fields::{
    chunk_fields, composite_fields, composite_from, frame_fields, frame_from, hex, unhex,
};
use vector_set::vectors;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("vectors")
}

fn index_text(entries: &[&Value]) -> String {
    let mut text = serde_json::to_string_pretty(entries).unwrap();
    text.push('\n');
    text
}

fn write(all: &[(Value, Vec<u8>)], index: &str) {
    if folder().is_dir() {
        std::fs::remove_dir_all(folder()).unwrap();
    }
    std::fs::create_dir_all(folder()).unwrap();
    for (entry, bytes) in all {
        std::fs::write(folder().join(entry["file"].as_str().unwrap()), bytes).unwrap();
    }
    std::fs::write(folder().join("index.json"), index).unwrap();
}

#[test]
fn the_folder_holds_what_the_vector_set_says() {
    let all = vectors();
    let index = index_text(&all.iter().map(|(entry, _)| entry).collect::<Vec<_>>());
    if std::env::var_os("WRITE_VECTORS").is_some() {
        write(&all, &index);
    }
    let again = "; WRITE_VECTORS=1 cargo test -p ghostlight-proto the_folder writes them anew";
    let read = |file: &str| std::fs::read(folder().join(file)).unwrap_or_default();
    assert!(read("index.json") == index.as_bytes(), "index.json{again}");
    for (entry, bytes) in &all {
        let file = entry["file"].as_str().unwrap();
        // Another release of zstd may compress differently; the decoded content is compared below.
        if !file.ends_with(".delta_zstd") {
            assert!(read(file) == *bytes, "{file}{again}");
        }
    }
    let there = std::fs::read_dir(folder()).unwrap().count();
    assert_eq!(there, all.len() + 1, "files in the folder{again}");
}

/// Decodes a vector by its kind; returns its fields in the form of the index.
fn decode(entry: &Value, bytes: &[u8]) -> Result<Value, WireError> {
    let n_pixels = || {
        let side = |name: &str| entry[name].as_u64().unwrap() as usize;
        side("width") * side("height")
    };
    let pixels = |p: Vec<u16>| serde_json::json!({ "pixels": p });
    match entry["kind"].as_str().unwrap() {
        "frame" => Frame::decode(bytes).map(|f| frame_fields(&f)),
        "composite" => Composite::decode(bytes).map(|c| composite_fields(&c)),
        "asset_chunk" => AssetChunk::decode(bytes).map(|c| chunk_fields(&c)),
        "rvl" => depth::decode_rvl(bytes, n_pixels()).map(pixels),
        "delta_zstd" => depth::decode_delta_zstd(bytes, n_pixels()).map(pixels),
        "request" => {
            let (id, request) = Request::parse(std::str::from_utf8(bytes).unwrap());
            let text = request?.to_text(id);
            Ok(serde_json::from_str(&text).unwrap())
        }
        "reply" => {
            let reply = Reply::parse(std::str::from_utf8(bytes).unwrap())?;
            Ok(serde_json::from_str(&reply.to_text()).unwrap())
        }
        other => panic!("kind {other} of the index is unknown"),
    }
}

#[test]
fn every_vector_reads_and_writes_as_its_index_says() {
    let text = std::fs::read_to_string(folder().join("index.json")).unwrap();
    let index: Vec<Value> = serde_json::from_str(&text).unwrap();
    assert!(index.len() >= 90, "only {} vectors", index.len());
    for entry in &index {
        let file = entry["file"].as_str().unwrap();
        let bytes = std::fs::read(folder().join(file)).unwrap();
        match (decode(entry, &bytes), entry.get("error")) {
            (Ok(fields), None) => assert_eq!(fields, entry["expect"], "{file}"),
            (Err(e), Some(code)) => assert_eq!(e.code.name(), code, "{file}: {e}"),
            (Ok(_), Some(code)) => panic!("{file}: decoded, expected {code}"),
            (Err(e), None) => panic!("{file}: {e}"),
        }
        let Some(expect) = entry.get("expect") else {
            continue;
        };
        let pixels: Vec<u16> = expect["pixels"]
            .as_array()
            .map(|p| p.iter().map(|v| v.as_u64().unwrap() as u16).collect())
            .unwrap_or_default();
        // A longer header, as from a later version, decodes but is not encoded.
        if file.contains("long_header") {
            continue;
        }
        match entry["kind"].as_str().unwrap() {
            "frame" => {
                let (color, depth) = (unhex(&expect["color"]), unhex(&expect["depth"]));
                let frame = frame_from(expect, &color, &depth);
                assert_eq!(hex(&frame.encode().unwrap()), hex(&bytes), "{file}");
            }
            "composite" => {
                let planes = ["image", "camera", "mask", "depth"].map(|p| unhex(&expect[p]));
                let composite = composite_from(expect, &planes);
                assert_eq!(hex(&composite.encode().unwrap()), hex(&bytes), "{file}");
            }
            "asset_chunk" => {
                let payload = unhex(&expect["bytes"]);
                let chunk = AssetChunk {
                    upload: expect["upload"].as_u64().unwrap() as u32,
                    offset: expect["offset"].as_str().unwrap().parse().unwrap(),
                    bytes: &payload,
                };
                assert_eq!(hex(&chunk.encode().unwrap()), hex(&bytes), "{file}");
            }
            "rvl" => assert_eq!(depth::encode_rvl(&pixels), bytes, "{file}"),
            "delta_zstd" => {
                let again = depth::encode_delta_zstd(&pixels).unwrap();
                assert_eq!(
                    depth::decode_delta_zstd(&again, pixels.len()).unwrap(),
                    pixels
                );
            }
            _ => {}
        }
    }
}
