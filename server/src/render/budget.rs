//! Keeps a time budget: quality is reduced in steps while frames take longer, and restored when there is time
//! again.
//!
//! The cost of a frame is not known before it is rendered, so the controller uses the previous frames. It reduces
//! quality as soon as one frame is over budget, and restores a step only after [`CALM_FRAMES`] frames that would
//! leave room for it: a picture that flickers between two qualities is worse than either.

use super::settings::{RenderSettings, ShadowMethod};

/// Frames in a row that must leave room before a step is restored; half a second at 30 Hz.
const CALM_FRAMES: u32 = 15;

/// A frame leaves room if it takes less than this share of the budget: a step roughly halves the cost of the
/// stages that it affects.
const ROOM: f32 = 0.6;

/// Least rays per pixel to which a lens is reduced before it is turned off.
const LEAST_LENS_SAMPLES: u32 = 4;

/// Error of large meshes from the second step on, pixels.
const COARSE_PX: f32 = 2.0;

/// The last step: mirrors with one bounce, hard shadows of lamps and none of ambient light, and no lens.
const LAST_STEP: u32 = 5;

/// Longest wait before a step that failed each time is tried again: 16 seconds at 30 Hz.
const MOST_CALM_FRAMES: u32 = 32 * CALM_FRAMES;

/// Keeps frames within [`RenderSettings::budget_ms`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Budget {
    step: u32,
    calm: u32,
    /// Calm frames before a step is restored; doubled each time that this was too early.
    patience: u32,
    /// Frames since the last step was restored; the maximum after quality was reduced again.
    since: u32,
}

impl Default for Budget {
    fn default() -> Self {
        Self {
            step: 0,
            calm: 0,
            patience: CALM_FRAMES,
            since: u32::MAX,
        }
    }
}

impl Budget {
    /// The settings for the next frame.
    pub(super) fn apply(&mut self, asked: &RenderSettings) -> RenderSettings {
        if asked.limit_ms().is_none() {
            *self = Self::default();
        }
        lowered(asked, self.step)
    }

    /// Updates the step from the time that a frame took.
    pub(super) fn learn(&mut self, asked: &RenderSettings, took_ms: f32) {
        let Some(limit_ms) = asked.limit_ms() else {
            return;
        };
        self.since = self.since.saturating_add(1);
        if took_ms > limit_ms {
            if self.since <= CALM_FRAMES {
                self.patience = (2 * self.patience).min(MOST_CALM_FRAMES);
            }
            self.since = u32::MAX;
            // A step about halves the cost, so a frame that is far over budget skips steps.
            let off = (took_ms / limit_ms).log2() as u32;
            self.step = (self.step + off.max(1)).min(LAST_STEP);
            self.calm = 0;
        } else if took_ms < ROOM * limit_ms && self.step > 0 {
            self.calm += 1;
            if self.calm >= self.patience {
                self.step -= 1;
                (self.calm, self.since) = (0, 0);
            }
        } else {
            self.calm = 0;
        }
        if self.since == MOST_CALM_FRAMES {
            self.patience = CALM_FRAMES;
        }
    }
}

/// `asked` with the reductions of `step`: the least visible ones come first.
fn lowered(asked: &RenderSettings, step: u32) -> RenderSettings {
    let mut s = *asked;
    let photons = |parts: u32| match asked.caustics.enabled != Some(false) {
        true => (asked.caustics.photons / parts).max(1000),
        false => asked.caustics.photons,
    };
    if step >= 1 {
        s.edge_samples = (asked.edge_samples / 2).max(1);
        s.glossy_samples = (asked.glossy_samples / 2).max(1);
        s.lens.samples = lens_samples(asked, 2);
        s.ambient.samples = (asked.ambient.samples / 2).max(16);
    }
    // A setting of 0 asks for full detail on purpose, so it is kept.
    if step >= 2 && asked.lod_error_px > 0.0 {
        s.lod_error_px = asked.lod_error_px.max(COARSE_PX);
    }
    if step >= 2 {
        s.edge_samples = 1;
        s.lens.samples = lens_samples(asked, 4);
        s.shadows.samples = (asked.shadows.samples / 2).max(5);
        s.ambient.samples = 16;
        s.caustics.photons = photons(2);
    }
    if step >= 3 {
        s.glossy_samples = (asked.glossy_samples / 4).max(1);
        s.caustics.photons = photons(4);
        s.max_bounces = asked.max_bounces.min(3);
    }
    if step >= 4 {
        s.shadows.samples = 5;
        s.caustics.photons = photons(8);
        s.glossy_samples = 1;
        s.lens.samples = lens_samples(asked, 8);
        s.max_bounces = asked.max_bounces.min(2);
    }
    if step >= LAST_STEP {
        if s.shadows.method != ShadowMethod::Off {
            s.shadows.method = ShadowMethod::Hard;
        }
        s.max_bounces = asked.max_bounces.min(1);
        s.caustics.photons = photons(16);
        s.lens.radius_m = 0.0;
        s.ambient.enabled = false;
    }
    s
}

/// A part of the lens rays, but not so few that their noise is worse than no blur.
fn lens_samples(asked: &RenderSettings, part: u32) -> u32 {
    let samples = asked.lens.samples;
    if asked.lens.radius_m == 0.0 {
        return samples;
    }
    (samples / part).max(samples.min(LEAST_LENS_SAMPLES))
}

/// A setting whose value was reduced for a frame to keep its budget.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Lowered {
    /// Name of the setting, as in the JSON: `shadows.samples`.
    pub setting: &'static str,
    /// The requested value.
    pub asked: String,
    /// The used value.
    pub used: String,
}

impl std::fmt::Display for Lowered {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} {} -> {}", self.setting, self.asked, self.used)
    }
}

/// The settings that are lower in `used` than in `asked`; empty, without allocating, if there are none.
pub(super) fn lowered_settings(asked: &RenderSettings, used: &RenderSettings) -> Vec<Lowered> {
    let numbers = [
        ("edge_samples", asked.edge_samples, used.edge_samples),
        ("glossy_samples", asked.glossy_samples, used.glossy_samples),
        (
            "shadows.samples",
            asked.shadows.samples,
            used.shadows.samples,
        ),
        ("max_bounces", asked.max_bounces, used.max_bounces),
        (
            "ambient.samples",
            asked.ambient.samples,
            used.ambient.samples,
        ),
        (
            "caustics.photons",
            asked.caustics.photons,
            used.caustics.photons,
        ),
        ("lens.samples", asked.lens.samples, used.lens.samples),
    ];
    let mut all: Vec<Lowered> = numbers
        .into_iter()
        .filter(|(_, asked, used)| asked != used)
        .map(|(setting, asked, used)| Lowered {
            setting,
            asked: asked.to_string(),
            used: used.to_string(),
        })
        .collect();
    if asked.shadows.method != used.shadows.method {
        let name = |method: ShadowMethod| format!("{method:?}").to_lowercase();
        all.push(Lowered {
            setting: "shadows.method",
            asked: name(asked.shadows.method),
            used: name(used.shadows.method),
        });
    }
    if asked.ambient.enabled != used.ambient.enabled {
        all.push(Lowered {
            setting: "ambient.enabled",
            asked: asked.ambient.enabled.to_string(),
            used: used.ambient.enabled.to_string(),
        });
    }
    let lengths = [
        ("lod_error_px", asked.lod_error_px, used.lod_error_px),
        ("lens.radius_m", asked.lens.radius_m, used.lens.radius_m),
    ];
    for (setting, asked, used) in lengths {
        if asked != used {
            all.push(Lowered {
                setting,
                asked: asked.to_string(),
                used: used.to_string(),
            });
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::CausticSettings;

    fn asked(budget_ms: f32) -> RenderSettings {
        RenderSettings {
            budget_ms: Some(budget_ms),
            ..RenderSettings::default()
        }
    }

    fn with_lens(samples: u32) -> RenderSettings {
        let mut settings = asked(10.0);
        (settings.lens.radius_m, settings.lens.samples) = (0.01, samples);
        settings
    }

    #[test]
    fn a_lens_loses_rays_first_and_is_given_up_last() {
        let settings = with_lens(25);
        let samples = |step| lowered(&settings, step).lens.samples;
        assert_eq!([0, 1, 2, 3, 4].map(samples), [25, 12, 6, 6, 4]);
        let last = lowered(&settings, LAST_STEP);
        let told = lowered_settings(&settings, &last);
        assert_eq!(
            told.last().unwrap().to_string(),
            "lens.radius_m 0.01 -> 0",
            "{told:?}"
        );
    }

    #[test]
    fn without_a_budget_nothing_is_given_up() {
        let (settings, mut budget) = (asked(0.0), Budget::default());
        for _ in 0..10 {
            budget.learn(&settings, 1e6);
            assert_eq!(budget.apply(&settings), settings);
        }
    }

    #[test]
    fn a_frame_that_is_far_over_gives_up_several_steps_at_once() {
        let settings = asked(20.0);
        for (took_ms, step) in [
            (21.0, 1),
            (79.0, 1),
            (81.0, 2),
            (170.0, 3),
            (1e9, LAST_STEP),
        ] {
            let mut budget = Budget::default();
            budget.learn(&settings, took_ms);
            assert_eq!(budget.step, step, "{took_ms}");
        }
        let mut budget = Budget::default();
        let unlimited = RenderSettings::default();
        budget.learn(&unlimited, 1e9);
        assert_eq!(budget.step, 0);
    }

    /// If a quality is too high each time that it is restored, it is tried at longer and longer intervals.
    #[test]
    fn what_failed_is_tried_less_often() {
        let (settings, mut budget) = (asked(20.0), Budget::default());
        let mut tries = Vec::new();
        for frame in 0..2000 {
            let step = budget.step;
            budget.learn(&settings, if step == 0 { 30.0 } else { 5.0 });
            if step == 0 {
                tries.push(frame);
            }
        }
        // Frame 0, then after 15, 30, 60, 120, 240, 480 and 480 calm frames.
        assert_eq!(tries, [0, 16, 47, 108, 229, 470, 951, 1432, 1913]);
    }

    #[test]
    fn quality_goes_at_once_and_comes_back_slowly() {
        let (settings, mut budget) = (asked(20.0), Budget::default());
        assert_eq!(budget.apply(&settings), settings);
        budget.learn(&settings, 25.0);
        let first = budget.apply(&settings);
        let names = |used: &RenderSettings| -> Vec<&str> {
            let lowered = lowered_settings(&settings, used);
            lowered.iter().map(|lowered| lowered.setting).collect()
        };
        assert_eq!(
            names(&first),
            ["edge_samples", "glossy_samples", "ambient.samples"]
        );
        for _ in 0..10 {
            budget.learn(&settings, 25.0);
        }
        let last = budget.apply(&settings);
        assert_eq!(last.shadows.method, ShadowMethod::Hard);
        assert_eq!(last.max_bounces, 1);
        assert!(names(&last).contains(&"lod_error_px"));
        assert_eq!(last.validate(), Ok(()));
        // Within budget but without room, so the step stays.
        for _ in 0..100 {
            budget.learn(&settings, 15.0);
        }
        assert_eq!(budget.apply(&settings), last);
        for _ in 0..CALM_FRAMES {
            assert_eq!(budget.apply(&settings), last);
            budget.learn(&settings, 5.0);
        }
        assert_ne!(budget.apply(&settings), last);
        for _ in 0..CALM_FRAMES * LAST_STEP {
            budget.learn(&settings, 5.0);
        }
        assert_eq!(budget.apply(&settings), settings);
    }

    #[test]
    fn every_step_costs_no_more_than_the_one_before() {
        for settings in [
            asked(10.0),
            RenderSettings {
                edge_samples: 1,
                glossy_samples: 1,
                max_bounces: 0,
                caustics: CausticSettings {
                    enabled: Some(true),
                    photons: 5000,
                    ..CausticSettings::default()
                },
                ..asked(10.0)
            },
            with_lens(25),
            with_lens(3),
            RenderSettings {
                lod_error_px: 5.0,
                ..asked(10.0)
            },
        ] {
            let mut before = settings;
            for step in 0..=LAST_STEP {
                let now = lowered(&settings, step);
                assert_eq!(now.validate(), Ok(()));
                assert!(now.edge_samples <= before.edge_samples);
                assert!(now.glossy_samples <= before.glossy_samples);
                assert!(now.shadows.samples <= before.shadows.samples);
                assert!(now.max_bounces <= before.max_bounces);
                assert!(now.caustics.photons <= before.caustics.photons);
                assert!(now.lens.samples <= before.lens.samples);
                assert!(now.lens.radius_m <= before.lens.radius_m);
                assert!(now.lod_error_px >= before.lod_error_px);
                before = now;
            }
        }
    }
}
