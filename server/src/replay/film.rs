//! Writes composites to an MP4 that browsers and players can open: H.264 (Constrained Baseline, 4:2:0, flagged as
//! BT.709 limited range), `moov` before `mdat`.
//!
//! H.264 in 4:2:0 needs even sizes: for an odd size, the last row or column is repeated.

use std::path::Path;

use muxide::api::{Muxer, MuxerBuilder, VideoCodec};
use openh264::OpenH264API;
use openh264::encoder::{
    Complexity, Encoder, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange,
    RateControlMode, UsageType, VuiConfig,
};
use openh264::formats::YUVSlices;
use yuv::{
    BufferStoreMut, YuvConversionMode, YuvPlanarImageMut, YuvRange, YuvStandardMatrix,
    rgba_to_yuv420,
};

use super::Rendered;
use super::error::{FilmError, ReplayError, write_error};
use crate::frame::ColorImage;
use crate::output::{Draft, Sink};

/// Frames per second if there are no usable time stamps.
const NOMINAL_HZ: f64 = 30.0;
/// Most frames between two key frames, so that players can seek.
const KEY_EVERY: u32 = 60;
/// Range of quantiser steps (0 finest to 51) for the encoder: constant quality rather than constant bitrate. For
/// Kinect pictures of 640x480 at 30 Hz this gives 8 to 10 Mbit/s and 38 dB.
const QUANTISER: (u8, u8) = (17, 21);
/// Longer pauses between frames are shortened to the nominal frame time: they are gaps in the recording.
const LONGEST_PAUSE_S: f64 = 1.0;

/// A film being written.
pub(super) struct Film {
    file: Draft,
    track: Option<Track>,
}

impl Film {
    pub(super) fn new(path: &Path) -> Result<Self, ReplayError> {
        Ok(Self {
            file: Draft::file(path).map_err(|error| write_error(path, error))?,
            track: None,
        })
    }

    pub(super) fn write(&mut self, time_ns: i64, rendered: &Rendered) -> Result<(), ReplayError> {
        let color = &rendered.color;
        let wrap = |path: &Path, source| ReplayError::Film {
            path: path.to_owned(),
            source,
        };
        let track = match &mut self.track {
            Some(track) => track,
            none => {
                let file = self.file.create();
                let file = file.map_err(|error| write_error(self.file.destination(), error))?;
                let track = Track::new(file, color.width, color.height)
                    .map_err(|error| wrap(self.file.destination(), error))?;
                none.insert(track)
            }
        };
        track
            .write(time_ns, color)
            .map_err(|error| wrap(self.file.destination(), error))
    }

    pub(super) fn finish(self) -> Result<(), ReplayError> {
        if let Some(track) = self.track {
            track.muxer.finish().map_err(|error| ReplayError::Film {
                path: self.file.destination().to_owned(),
                source: FilmError::Container(error.to_string()),
            })?;
        }
        let path = self.file.destination().to_owned();
        self.file
            .commit()
            .map_err(|error| write_error(&path, error))
    }
}

struct Track {
    /// Size of the pictures; the film has the next even size.
    size: (u32, u32),
    encoder: Encoder,
    muxer: Muxer<std::io::BufWriter<Sink>>,
    last: Option<(i64, f64)>,
    padded: Vec<[u8; 4]>,
    y: Vec<u8>,
    u: Vec<u8>,
    v: Vec<u8>,
    packet: Vec<u8>,
}

impl Track {
    fn new(file: Sink, width: u32, height: u32) -> Result<Self, FilmError> {
        let (even_width, even_height) = (width.next_multiple_of(2), height.next_multiple_of(2));
        let n = even_width as usize * even_height as usize;
        // The modes with a target bitrate drop frames to keep it, or warn on stderr that they may. This mode only
        // uses the range of quantisers.
        let config = EncoderConfig::new()
            .usage_type(UsageType::CameraVideoRealTime)
            .complexity(Complexity::High)
            .rate_control_mode(RateControlMode::Bufferbased)
            .qp(QpRange::new(QUANTISER.0, QUANTISER.1))
            .max_frame_rate(FrameRate::from_hz(NOMINAL_HZ as f32))
            .skip_frames(false)
            .intra_frame_period(IntraFramePeriod::from_num_frames(KEY_EVERY))
            .vui(VuiConfig::bt709());
        let encoder = Encoder::with_api_config(OpenH264API::from_source(), config)
            .map_err(|error| refused(width, height, &error))?;
        let muxer = MuxerBuilder::new(std::io::BufWriter::new(file))
            .video(VideoCodec::H264, even_width, even_height, NOMINAL_HZ)
            .build()
            .map_err(|error| FilmError::Container(error.to_string()))?;
        Ok(Self {
            size: (width, height),
            encoder,
            muxer,
            last: None,
            padded: Vec::new(),
            y: vec![0; n],
            u: vec![0; n / 4],
            v: vec![0; n / 4],
            packet: Vec::new(),
        })
    }

    fn write(&mut self, time_ns: i64, color: &ColorImage) -> Result<(), FilmError> {
        let (width, height) = self.size;
        if (color.width, color.height) != self.size {
            return Err(FilmError::Size(width, height, color.width, color.height));
        }
        let (even_width, even_height) = (width.next_multiple_of(2), height.next_multiple_of(2));
        let rgba = if (even_width, even_height) == self.size {
            color.bytes()
        } else {
            pad(color, even_width, even_height, &mut self.padded);
            bytemuck::cast_slice(&self.padded)
        };
        let mut planes = YuvPlanarImageMut {
            y_plane: BufferStoreMut::Borrowed(&mut self.y),
            y_stride: even_width,
            u_plane: BufferStoreMut::Borrowed(&mut self.u),
            u_stride: even_width / 2,
            v_plane: BufferStoreMut::Borrowed(&mut self.v),
            v_stride: even_width / 2,
            width: even_width,
            height: even_height,
        };
        rgba_to_yuv420(
            &mut planes,
            rgba,
            even_width * 4,
            YuvRange::Limited,
            YuvStandardMatrix::Bt709,
            YuvConversionMode::Balanced,
        )
        .map_err(|error| FilmError::Colour(error.to_string()))?;

        let seconds = seconds_of(self.last, time_ns);
        self.last = Some((time_ns, seconds));
        let size = (even_width as usize, even_height as usize);
        let strides = (size.0, size.0 / 2, size.0 / 2);
        let picture = YUVSlices::new((&self.y, &self.u, &self.v), size, strides);
        let stamp = openh264::Timestamp::from_millis((seconds * 1e3) as u64);
        let packet = self
            .encoder
            .encode_at(&picture, stamp)
            .map_err(|error| refused(width, height, &error))?;
        let key = matches!(packet.frame_type(), FrameType::IDR);
        self.packet.clear();
        packet.write_vec(&mut self.packet);
        self.muxer
            .write_video(seconds, &self.packet, key)
            .map_err(|error| FilmError::Container(error.to_string()))
    }
}

fn refused(width: u32, height: u32, error: &openh264::Error) -> FilmError {
    FilmError::Encoder {
        width,
        height,
        reason: error.to_string(),
    }
}

/// Time at which a picture is shown, seconds: the previous picture's time plus the difference of their time
/// stamps, or plus the nominal frame time if the stamps stand still, run backwards or pause.
fn seconds_of(last: Option<(i64, f64)>, time_ns: i64) -> f64 {
    let Some((last_ns, last_s)) = last else {
        return 0.0;
    };
    let step = time_ns.saturating_sub(last_ns) as f64 * 1e-9;
    // The encoder's resolution is a millisecond.
    let step = if (1e-3..=LONGEST_PAUSE_S).contains(&step) {
        step
    } else {
        1.0 / NOMINAL_HZ
    };
    last_s + step
}

/// The picture with its last row and column repeated.
fn pad(color: &ColorImage, width: u32, height: u32, padded: &mut Vec<[u8; 4]>) {
    padded.clear();
    for y in 0..height.min(color.height + 1) {
        let start = y.min(color.height - 1) as usize * color.width as usize;
        let row = &color.rgba[start..start + color.width as usize];
        padded.extend_from_slice(row);
        let last = row.last().copied().unwrap_or_default();
        padded.extend(std::iter::repeat_n(last, (width - color.width) as usize));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_shown_as_they_were_taken() {
        assert_eq!(seconds_of(None, 77), 0.0);
        let later = |ns| seconds_of(Some((1_000, 2.0)), ns) - 2.0;
        assert!((later(50_001_000) - 0.05).abs() < 1e-12);
        for odd in [1_000, 0, i64::MIN, i64::MAX, 5_000_000_000] {
            assert!((later(odd) - 1.0 / 30.0).abs() < 1e-12, "{odd}");
        }
    }

    #[test]
    fn an_odd_picture_repeats_its_edge() {
        let color = ColorImage {
            width: 3,
            height: 1,
            rgba: vec![[1; 4], [2; 4], [3; 4]],
        };
        let mut padded = Vec::new();
        pad(&color, 4, 2, &mut padded);
        let row = [[1; 4], [2; 4], [3; 4], [3; 4]];
        assert_eq!(padded, [row, row].concat());
    }
}
