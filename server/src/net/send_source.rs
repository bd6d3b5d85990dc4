//! A recording as frame messages, encoded ahead on a separate thread.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result};
use ghostlight_proto::{Codec, Frame, FrameHeader, Pose};
use tokio::sync::mpsc;

use super::camera::{intrinsics_to_wire, pose_to_wire};
use super::encode::{encode_color, encode_depth};
use crate::frame::{RgbdFrame, is_valid_depth};
use crate::recording::{OpenOptions, Recording};

/// Depth units per metre on the wire: those of the TUM benchmark, 0.2 mm to 13.1 m.
const UNITS_PER_METRE: f64 = 5000.0;

/// Number of messages encoded ahead.
const AHEAD: usize = 4;

/// Most bytes of messages kept, so that later rounds need no encoding.
const MAX_KEPT: usize = 512 << 20;

/// One frame, complete but for its number and capture time.
pub(super) struct Prepared {
    /// Time since the recording's first frame, plus whole rounds, nanoseconds.
    pub(super) due_ns: i64,
    /// The message.
    pub(super) message: Arc<Vec<u8>>,
}

/// Frames of a recording, repeated `rounds` times, until the receiver is dropped. An error is the last item.
pub(super) fn frames(
    path: &Path,
    open: &OpenOptions,
    rounds: u64,
    quality: u8,
) -> Result<mpsc::Receiver<Result<Prepared>>> {
    let recording = Recording::open(path, open).with_context(|| path.display().to_string())?;
    let (sender, receiver) = mpsc::channel(AHEAD);
    std::thread::Builder::new()
        .name("frames".to_owned())
        .spawn(move || {
            if let Err(error) = prepare(&recording, rounds, quality, &sender) {
                // Fails if the receiver is gone.
                let _ = sender.blocking_send(Err(error));
            }
        })
        .context("starting a thread")?;
    Ok(receiver)
}

fn prepare(
    recording: &Recording,
    rounds: u64,
    quality: u8,
    sender: &mpsc::Sender<Result<Prepared>>,
) -> Result<()> {
    let times = recording.times_ns();
    let first = times.first().copied().unwrap_or(0);
    let length = times.last().map_or(0, |last| last - first);
    let gap = length / (times.len() as i64 - 1).max(1);
    // For each frame from the first on: its message, or `None` if it cannot be read.
    let mut kept: Vec<Option<Arc<Vec<u8>>>> = Vec::new();
    let mut kept_bytes = 0;
    let mut unread = 0;
    for round in 0..rounds {
        for (i, time) in times.iter().enumerate() {
            let message = match kept.get(i) {
                Some(message) => message.clone(),
                None => {
                    let message = match recording.frame(i) {
                        Ok(frame) => Some(Arc::new(encode(&frame, quality)?)),
                        Err(error) if error.is_of_frame() && unread + 1 < times.len() => {
                            if round == 0 {
                                tracing::warn!(frame = i, %error, "left out");
                                unread += 1;
                            }
                            None
                        }
                        Err(error) => return Err(error.into()),
                    };
                    // Only kept without gaps from the first frame on, so that the index fits.
                    if rounds > 1 && kept.len() == i && kept_bytes < MAX_KEPT {
                        kept_bytes += message.as_ref().map_or(0, |message| message.len());
                        kept.push(message.clone());
                    }
                    message
                }
            };
            let Some(message) = message else { continue };
            let due_ns = round as i64 * (length + gap) + time - first;
            if sender
                .blocking_send(Ok(Prepared { due_ns, message }))
                .is_err()
            {
                return Ok(());
            }
        }
    }
    Ok(())
}

fn encode(frame: &RgbdFrame, quality: u8) -> Result<Vec<u8>> {
    let camera = intrinsics_to_wire(&frame.intrinsics);
    let units: Vec<u16> = frame
        .depth
        .z_m
        .iter()
        .map(|&z| match (f64::from(z) * UNITS_PER_METRE).round() {
            units if is_valid_depth(z) && (1.0..65535.0).contains(&units) => units as u16,
            _ => 0,
        })
        .collect();
    let color = encode_color(&frame.color, Codec::Jpeg, quality)?;
    let size = (frame.depth.width, frame.depth.height);
    let depth = encode_depth(size, &units, Codec::DeltaZstd)?;
    let header = FrameHeader {
        sequence: 0,
        capture_ns: 0,
        pose: pose_to_wire(&frame.pose),
        color: camera,
        depth: camera,
        color_from_depth: Pose::IDENTITY,
        metres_per_unit: 1.0 / UNITS_PER_METRE,
        color_codec: Codec::Jpeg,
        depth_codec: Codec::DeltaZstd,
        max_depth_m: 0.0,
    };
    let message = Frame {
        header,
        color: &color,
        depth: &depth,
    };
    Ok(message.encode()?)
}
