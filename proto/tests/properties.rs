//! Arbitrary bytes never panic, and encoded messages decode to the same content.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

#[allow(dead_code, reason = "the fields are read by the other test")]
mod vector_set;

use ghostlight_proto::control::{Reply, Request};
use ghostlight_proto::{AssetChunk, Composite, Frame, Kind, depth};
use proptest::prelude::*;
use vector_set::vectors;

fn decode_everything(bytes: &[u8]) {
    let _ = Kind::of(bytes);
    let _ = Frame::decode(bytes);
    let _ = Composite::decode(bytes);
    let _ = AssetChunk::decode(bytes);
    for n in [0, 1, 12, 4096] {
        let _ = depth::decode_rvl(bytes, n);
        let _ = depth::decode_delta_zstd(bytes, n);
    }
    let text = String::from_utf8_lossy(bytes);
    let _ = Request::parse(&text);
    let _ = Reply::parse(&text);
}

/// Depth-like samples: smooth runs, holes and noise.
fn samples() -> impl Strategy<Value = Vec<u16>> {
    let run = prop_oneof![
        (1usize..40).prop_map(|n| vec![0u16; n]),
        (any::<u16>(), 1u16..40)
            .prop_map(|(start, n)| (0..n).map(|i| start.wrapping_add(i)).collect()),
        prop::collection::vec(any::<u16>(), 1..40),
    ];
    prop::collection::vec(run, 0..12).prop_map(|runs| runs.concat())
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        decode_everything(&bytes);
    }

    /// Random bytes rarely pass the first check; damaged messages do.
    #[test]
    fn damaged_messages_never_panic(
        which in any::<prop::sample::Index>(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
        cut in any::<prop::sample::Index>(),
        cut_it in any::<bool>(),
    ) {
        thread_local!(static ALL: Vec<Vec<u8>> =
            vectors().into_iter().map(|(_, bytes)| bytes).filter(|b| !b.is_empty()).collect());
        let mut bytes = ALL.with(|all| which.get(all).clone());
        for (at, value) in damage {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if cut_it {
            let n = cut.index(bytes.len());
            bytes.truncate(n);
        }
        decode_everything(&bytes);
    }

    #[test]
    fn depth_codecs_are_lossless(pixels in samples()) {
        let n = pixels.len();
        prop_assert_eq!(&depth::decode_rvl(&depth::encode_rvl(&pixels), n).unwrap(), &pixels);
        let zstd = depth::encode_delta_zstd(&pixels).unwrap();
        prop_assert_eq!(&depth::decode_delta_zstd(&zstd, n).unwrap(), &pixels);
        // A different size than the sender's is an error, not a different picture.
        prop_assert!(depth::decode_rvl(&depth::encode_rvl(&pixels), n + 1).is_err());
        prop_assert!(depth::decode_delta_zstd(&zstd, n + 1).is_err());
    }

    #[test]
    fn ids_survive(id in any::<u64>(), angle in -10.0..10.0f64) {
        let request = |angle| Request::Turn(ghostlight_proto::control::Turn {
            object: "a \"b\"".into(),
            angle,
        });
        let (got, again) = Request::parse(&request(angle).to_text(Some(id)));
        prop_assert_eq!(got, Some(id));
        // The JSON parser rounds to within one unit in the last place.
        let Ok(Request::Turn(turn)) = again else { panic!("{again:?}") };
        prop_assert!((turn.angle - angle).abs() <= f64::EPSILON * angle.abs());
        prop_assert_eq!(&turn.object, "a \"b\"");
    }
}
