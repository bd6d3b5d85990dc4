//! Renders frames of one scene under several settings, and compares pictures.

use anyhow::Result;

use super::lab::Lab;
use super::{median, take_turns};
use ghostlight::frame::{ColorImage, DepthImage, RgbdFrame};
use ghostlight::render::{Aov, AovImage, RenderSettings, Rendered, Renderer, Stage};
use ghostlight::scene::Scene;

/// A picture and its render times.
pub struct Shot {
    /// Milliseconds for the whole frame.
    pub ms: f64,
    /// Milliseconds per stage, in the order of [`Stage::ALL`].
    pub stage_ms: [f64; Stage::ALL.len()],
    /// The last rendered frame; all repetitions are the same.
    pub rendered: Rendered,
}

impl Shot {
    /// Milliseconds of some stages together.
    pub fn stages_ms(&self, stages: &[Stage]) -> f64 {
        stages
            .iter()
            .map(|&stage| self.stage_ms[stage as usize])
            .sum()
    }
}

/// Renders the frame with each of the settings, in turn.
pub fn shoot(
    lab: &Lab,
    frame: &RgbdFrame,
    scene: &Scene,
    settings: &[RenderSettings],
    aovs: &[Aov],
) -> Result<Vec<Shot>> {
    let jobs: Vec<_> = settings
        .iter()
        .map(|settings| (frame, scene, *settings))
        .collect();
    shoot_all(lab, &jobs, aovs)
}

/// Renders frames of several scenes, in turn.
pub fn shoot_all(
    lab: &Lab,
    jobs: &[(&RgbdFrame, &Scene, RenderSettings)],
    aovs: &[Aov],
) -> Result<Vec<Shot>> {
    struct Variant<'a> {
        frame: &'a RgbdFrame,
        settings: RenderSettings,
        renderer: Renderer,
        shots: Vec<Rendered>,
    }
    let mut variants = Vec::with_capacity(jobs.len());
    for &(frame, scene, settings) in jobs {
        variants.push(Variant {
            frame,
            settings,
            renderer: lab.engine().renderer(scene)?,
            shots: Vec::new(),
        });
    }
    let seconds = take_turns(lab.rounds(), &mut variants, |v| {
        // Rendering is never cancelled.
        if let Ok(mut rendered) = v.renderer.render(v.frame, &v.settings, &[]) {
            // Of all repetitions but the last only the times are kept.
            rendered.color.rgba = Vec::new();
            v.shots.push(rendered);
        }
    });
    let mut shots = Vec::with_capacity(jobs.len());
    for (mut variant, seconds) in variants.into_iter().zip(seconds) {
        let stage_ms = std::array::from_fn(|stage| {
            // The first repetition is a warm-up.
            let mut ms: Vec<f64> = variant.shots[1..]
                .iter()
                .map(|shot| shot.stage_ns[stage] as f64 * 1e-6)
                .collect();
            median(&mut ms)
        });
        shots.push(Shot {
            ms: seconds * 1e3,
            stage_ms,
            // AOVs cost time of their own, so they are rendered separately.
            rendered: variant
                .renderer
                .render(variant.frame, &variant.settings, aovs)?,
        });
    }
    Ok(shots)
}

/// Renders one picture without timing it, as a reference.
pub fn once(
    lab: &Lab,
    frame: &RgbdFrame,
    scene: &Scene,
    settings: &RenderSettings,
    aovs: &[Aov],
) -> Result<Rendered> {
    let mut renderer = lab.engine().renderer(scene)?;
    Ok(renderer.render(frame, settings, aovs)?)
}

/// RMSE of two pictures' channels, in display levels (1/255), over the pixels for whose index `counts` returns
/// true; NaN if there are none.
pub fn rmse(a: &ColorImage, b: &ColorImage, counts: impl Fn(usize) -> bool) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for (i, (p, q)) in a.rgba.iter().zip(&b.rgba).enumerate() {
        if counts(i) {
            n += 3;
            for (&p, &q) in p[..3].iter().zip(&q[..3]) {
                sum += (f64::from(p) - f64::from(q)).powi(2);
            }
        }
    }
    (sum / n as f64).sqrt()
}

/// [`rmse`] of one channel.
pub fn rmse_gray(a: &[u8], b: &[u8], counts: impl Fn(usize) -> bool) -> f64 {
    let chosen = a.iter().zip(b).enumerate().filter(|(i, _)| counts(*i));
    let (sum, n) = chosen.fold((0.0, 0usize), |(sum, n), (_, (&p, &q))| {
        (sum + (f64::from(p) - f64::from(q)).powi(2), n + 1)
    });
    (sum / n as f64).sqrt()
}

/// The share of light that remains on real surfaces under shadows of virtual objects, 8-bit.
pub fn shadow_term(rendered: &Rendered) -> &[u8] {
    let found = rendered.aovs.iter().find_map(|(aov, image)| match image {
        AovImage::Gray8(px) if *aov == Aov::Shadow => Some(px.as_slice()),
        _ => None,
    });
    found.unwrap_or_default()
}

/// A setting's value as a point's label, marked if it is the default.
pub(super) fn label(value: u32, is_default: bool) -> String {
    format!("{value}{}", if is_default { " (default)" } else { "" })
}

/// The same view at another size, by nearest-neighbour sampling of colour and depth.
pub fn resized(frame: &RgbdFrame, width: u32, height: u32) -> Result<RgbdFrame> {
    let (w, h) = (frame.color.width, frame.color.height);
    // The new pixel's centre in the old image; both are at most 8192 wide.
    let nearest = |i: u32, to: u32, of: u32| (2 * i + 1) * of / (2 * to);
    let places = || {
        (0..height).flat_map(move |y| {
            let row = nearest(y, height, h) * w;
            (0..width).map(move |x| (row + nearest(x, width, w)) as usize)
        })
    };
    Ok(RgbdFrame {
        color: ColorImage {
            width,
            height,
            rgba: places().map(|at| frame.color.rgba[at]).collect(),
        },
        depth: DepthImage::from_metres(
            width,
            height,
            places().map(|at| frame.depth.z_m[at]).collect(),
        ),
        intrinsics: frame.intrinsics.scaled_to(width, height)?,
        ..*frame
    })
}

/// The view at a width of at most `width` pixels.
pub fn at_most(frame: &RgbdFrame, width: u32) -> Result<RgbdFrame> {
    let (w, h) = (frame.color.width, frame.color.height);
    if w <= width {
        return Ok(frame.clone());
    }
    resized(frame, width, (h * width / w).max(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_in_display_levels() {
        let a = ColorImage::filled(2, 1, [10, 10, 10, 255]);
        let mut b = a.clone();
        b.rgba[1] = [13, 10, 14, 0];
        let all = rmse(&a, &b, |_| true);
        assert!((all - (25.0f64 / 6.0).sqrt()).abs() < 1e-12, "{all}");
        assert_eq!(rmse(&a, &b, |i| i == 0), 0.0);
        assert!(rmse(&a, &b, |_| false).is_nan());
        assert_eq!(rmse_gray(&[1, 2], &[1, 5], |i| i == 1), 3.0);
    }
}
