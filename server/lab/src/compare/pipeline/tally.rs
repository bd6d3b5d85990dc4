//! Errors of a composite, by region.

use super::stage::Stage;
use crate::compare::quantile;
use ghostlight::frame::ColorImage;

/// A part of the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Region {
    /// Pixels that show an object or touch its outline.
    Object,
    /// Pixels at which an object hides a lamp.
    Shadow,
    /// All other pixels.
    Rest,
    /// One object's part of [`Region::Object`].
    Thing(u32),
}

impl Region {
    /// Regions that together make up the picture.
    pub(super) const ALL: [Self; 3] = [Self::Object, Self::Shadow, Self::Rest];
}

/// Errors of every pixel.
pub(super) struct Tally {
    /// Number of the object (0 for none), and whether in shadow.
    places: Vec<(u32, bool)>,
    /// Error of each channel, 8-bit codes.
    errors: Vec<[f64; 3]>,
}

/// A linear value as an 8-bit sRGB code, not rounded (IEC 61966-2-1).
fn code(linear: f64) -> f64 {
    let x = linear.clamp(0.0, 1.0);
    let encoded = if x <= 0.003_130_8 {
        12.92 * x
    } else {
        1.055 * x.powf(1.0 / 2.4) - 0.055
    };
    255.0 * encoded
}

impl Tally {
    /// Errors of a picture against the ground truth.
    pub(super) fn new(stage: &Stage, image: &ColorImage) -> Self {
        Self::of(stage, |i| {
            let truth = stage.truth.pixels[i].mean.to_array();
            std::array::from_fn(|c| f64::from(image.rgba[i][c]) - code(truth[c]))
        })
    }

    /// The standard error of the ground truth: half the difference of the codes one standard error above and
    /// below.
    pub(super) fn of_noise(stage: &Stage) -> Self {
        Self::of(stage, |i| {
            let pixel = &stage.truth.pixels[i];
            let high = (pixel.mean + pixel.standard_error).to_array();
            let low = (pixel.mean - pixel.standard_error).to_array();
            std::array::from_fn(|c| 0.5 * (code(high[c]) - code(low[c])))
        })
    }

    fn of(stage: &Stage, error: impl Fn(usize) -> [f64; 3]) -> Self {
        let n = stage.truth.pixels.len();
        Self {
            places: (0..n)
                .map(|i| (stage.thing(i), stage.is_shadowed(i)))
                .collect(),
            errors: (0..n).map(error).collect(),
        }
    }

    fn of_region(&self, region: Region) -> impl Iterator<Item = &[f64; 3]> {
        let within = move |&(thing, shadowed): &(u32, bool)| match region {
            Region::Object => thing != 0,
            Region::Thing(own) => thing == own,
            Region::Shadow => thing == 0 && shadowed,
            Region::Rest => thing == 0 && !shadowed,
        };
        let places = self.places.iter().zip(&self.errors);
        places
            .filter(move |(place, _)| within(place))
            .map(|(_, e)| e)
    }

    /// Number of pixels in a region.
    pub(super) fn count(&self, region: Region) -> usize {
        self.of_region(region).count()
    }

    /// RMSE over channels; NaN of an empty region.
    pub(super) fn rmse(&self, region: Region) -> f64 {
        let squares: f64 = self.of_region(region).flatten().map(|e| e * e).sum();
        (squares / (3 * self.count(region)) as f64).sqrt()
    }

    /// Mean error over channels: positive if brighter than the ground truth.
    pub(super) fn bias(&self, region: Region) -> f64 {
        let sum: f64 = self.of_region(region).flatten().sum();
        sum / (3 * self.count(region)) as f64
    }

    /// 99th percentile of the largest error among a pixel's channels.
    pub(super) fn p99(&self, region: Region) -> f64 {
        let worst = |e: &[f64; 3]| e.iter().fold(0.0f64, |a, b| a.max(b.abs()));
        quantile(
            &mut self.of_region(region).map(worst).collect::<Vec<_>>(),
            0.99,
        )
    }
}
