//! Soft shadows: RT2AR's adaptive sampling against 4096 samples.

use anyhow::Result;

use super::frames::{Shot, at_most, label, once, rmse, rmse_gray, shadow_term, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Printed, Section, Window};
use ghostlight::frame::{ColorImage, RgbdFrame};
use ghostlight::render::{
    Aov, FrameStats, RenderSettings, Rendered, ShadowMethod, ShadowSettings, Stage,
};
use ghostlight::scene::Scene;

/// A scene that casts shadows.
struct Subject {
    name: String,
    frame: RgbdFrame,
    scene: Scene,
    bundled: bool,
}

const RT2AR: Printed = Printed {
    source: "dos Santos et al. 2012 (RT2AR), section V.C, figure 12",
    machine: "Core i7 3.06 GHz, GTX 580",
};

/// Frames per second that RT2AR prints.
const THEIRS: [(&str, f64); 6] = [
    ("RT2AR off", 108.0),
    ("RT2AR hard", 84.0),
    ("RT2AR naive 20", 7.0),
    ("RT2AR adaptive 20", 31.0),
    ("RT2AR adaptive 20 + filter", 30.0),
    ("RT2AR adaptive 50 + filter", 20.0),
];

/// Smallest difference of the shadow term that counts, in 8-bit levels: rounding alone makes a difference of one.
const LEVELS: u8 = 2;

/// Radius of RT2AR's mean filter, pixels.
const FILTER_PX: u32 = 2;

/// The baseline of RT2AR's figure: all samples from every pixel.
const NAIVE: ShadowSettings = ShadowSettings {
    method: ShadowMethod::Naive,
    samples: 20,
    filter_radius_px: 0,
    skip_proven: false,
};

/// Samples of the reference.
fn reference_samples(lab: &Lab) -> u32 {
    lab.pick(256, 4096)
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let mut section = Section::new();
    let samples = reference_samples(lab);
    section.prose(format!(
        "One ray to the light's centre (`hard`), N rays everywhere (`naive`), or five first and the other N - 5 \
         only where these disagree (`adaptive`, RT2AR), or also where those of a neighbour disagree (`adaptive, \
         neighbours`), with or without a mean filter over the penumbra ({FILTER_PX} pixels' radius). The \
         reference casts {samples} rays per light everywhere. The shadow term is the share of light that virtual \
         objects leave on real surfaces; its error is in display levels (1/255). A pixel is in penumbra if the \
         reference differs there from `hard` by more than {LEVELS} levels. `wrongly lit or dark` is the share of \
         these pixels that a variant classifies as fully lit or dark; `wrongly penumbra` is the reverse, as a \
         share of all shaded pixels."
    ));
    section.prose(
        "Rays per traced pixel include pixels that are obviously not shaded, which lowers the figure. Rays per \
         lit or dark point include only points that cast rays and found no penumbra, towards virtual and real \
         objects together. `naive, everywhere` is RT2AR's baseline: every pixel with depth casts all samples. All \
         other variants leave out blocks of pixels that one traversal of the BVH proves to be lit, which changes \
         no pixel. Bloom and anti-aliasing are off.",
    );
    for subject in subjects(lab)? {
        lab.phase(&subject.name);
        one(lab, &subject, &mut section)?;
    }
    Ok(section)
}

/// The bundled scenes, and a plastic teapot in the real recordings.
fn subjects(lab: &mut Lab) -> Result<Vec<Subject>> {
    // The bounds are for a full-size picture: in a smaller one, a filter of some pixels blurs more.
    let width = 640;
    let desk = lab.desk()?;
    let mut subjects = Vec::new();
    for (name, file) in [
        ("mirror teapot, two lights", "teapot.json"),
        ("seven solids, two lights", "materials.json"),
    ] {
        subjects.push(Subject {
            name: format!("{}: {name}", desk.name),
            scene: lab.bundled_scene(file, &desk.frame)?,
            frame: at_most(&desk.frame, width)?,
            bundled: true,
        });
    }
    let real: Vec<_> = lab
        .views()?
        .iter()
        .filter(|view| view.real)
        .cloned()
        .collect();
    // A quick run leaves out the real recordings.
    let n = lab.pick(0, real.len());
    for view in real.into_iter().take(n) {
        let [u, v] = view.place;
        let document = format!(
            r#"{{"version":1,"objects":[{{"mesh":"../meshes/teapot.ply","place":{{"frame":"pixel","pixel":[{u},{v}],"size_m":{}}},
                "material":{{"preset":"plastic"}}}}],
                "lights":[{{"type":"sphere","frame":"first_camera","position":[-0.5,-1.2,0.4],"radius":0.1,"intensity":[4,4,4]}}]}}"#,
            view.size_m
        );
        subjects.push(Subject {
            name: format!("{}: plastic teapot, one light", view.name),
            scene: lab.scene(&document, &view.frame)?,
            frame: at_most(&view.frame, width)?,
            bundled: false,
        });
    }
    Ok(subjects)
}

fn settings(shadows: ShadowSettings) -> RenderSettings {
    let mut settings = RenderSettings {
        shadows,
        edge_samples: 1,
        ..RenderSettings::default()
    };
    settings.bloom.enabled = false;
    settings
}

/// Series, label, settings; the first three are `off`, `hard` and [`NAIVE`].
fn variants(lab: &Lab) -> Vec<(&'static str, String, ShadowSettings)> {
    let with = |method, samples, filter_radius_px| ShadowSettings {
        method,
        samples,
        filter_radius_px,
        skip_proven: true,
    };
    let mut variants = vec![
        ("off", "off".to_owned(), with(ShadowMethod::Off, 5, 0)),
        ("hard", "hard".to_owned(), with(ShadowMethod::Hard, 5, 0)),
        ("naive, everywhere", NAIVE.samples.to_string(), NAIVE),
    ];
    for (series, method, radius) in [
        ("naive", ShadowMethod::Naive, 0),
        ("adaptive", ShadowMethod::Adaptive, 0),
        ("adaptive, neighbours", ShadowMethod::AdaptiveNeighbours, 0),
        ("adaptive + filter", ShadowMethod::Adaptive, FILTER_PX),
    ] {
        // In a quick run the reference has 256 samples.
        for &samples in lab.pick(&[5, 20, 22, 50][..], &[5, 20, 22, 50, 256]) {
            let shadows = with(method, samples, radius);
            let label = label(samples, shadows == ShadowSettings::default());
            variants.push((series, label, shadows));
        }
    }
    for radius in [1, 4] {
        let shadows = with(ShadowMethod::Adaptive, 20, radius);
        variants.push((
            "adaptive 20, other filters",
            format!("{radius} px"),
            shadows,
        ));
    }
    variants
}

/// The pixels of the reference that are in penumbra, and those that are shaded at all.
struct Truth<'a> {
    term: &'a [u8],
    hard: &'a [u8],
}

impl Truth<'_> {
    fn is_shaded(&self, i: usize) -> bool {
        self.term[i] < 255 || self.hard[i] < 255
    }

    fn is_penumbra(&self, i: usize) -> bool {
        self.term[i].abs_diff(self.hard[i]) > LEVELS
    }

    /// Shares in percent: penumbra points that were classified as lit or dark, and the reverse.
    fn misjudged(&self, rendered: &Rendered) -> [f64; 2] {
        if rendered.stats.shadow_rays == 0 {
            // Without classified points there are no shares.
            return [f64::NAN; 2];
        }
        let term = shadow_term(rendered);
        let (mut penumbra, mut shaded, mut lost, mut invented) = (0u32, 0u32, 0u32, 0u32);
        for i in (0..term.len()).filter(|&i| self.is_shaded(i)) {
            let called = term[i].abs_diff(self.hard[i]) > LEVELS;
            shaded += 1;
            penumbra += u32::from(self.is_penumbra(i));
            lost += u32::from(self.is_penumbra(i) && !called);
            invented += u32::from(!self.is_penumbra(i) && called);
        }
        [
            f64::from(lost) / f64::from(penumbra) * 100.0,
            f64::from(invented) / f64::from(shaded) * 100.0,
        ]
    }
}

/// Rays cast per point that was classified as fully lit or dark.
fn rays_per_settled(stats: &FrameStats) -> f64 {
    (stats.shadow_rays - stats.penumbra_rays) as f64
        / (stats.shadow_points - stats.penumbra_points) as f64
}

fn one(lab: &Lab, subject: &Subject, section: &mut Section) -> Result<()> {
    let Subject { frame, scene, .. } = subject;
    let variants = variants(lab);
    let all: Vec<RenderSettings> = variants.iter().map(|(_, _, s)| settings(*s)).collect();
    let shots = shoot(lab, frame, scene, &all, &[Aov::Shadow])?;
    let samples = reference_samples(lab);
    lab.phase(&format!("{}: {samples} samples", subject.name));
    let best = settings(ShadowSettings {
        method: ShadowMethod::Naive,
        samples,
        filter_radius_px: 0,
        skip_proven: true,
    });
    let start = super::clock();
    let reference = once(lab, frame, scene, &best, &[Aov::Shadow])?;
    let reference_ms = (super::clock() - start) as f64 * 1e-6;

    let truth = Truth {
        term: shadow_term(&reference),
        hard: shadow_term(&shots[1].rendered),
    };
    let columns = [
        ("frame", "ms"),
        ("shadow term where shaded", "1/255"),
        ("shadow term in penumbra", "1/255"),
        ("shadow term, whole picture", "1/255"),
        ("composite, whole picture", "1/255"),
        ("wrongly lit or dark", "%"),
        ("wrongly penumbra", "%"),
        ("rays per traced pixel and light", ""),
        ("rays per lit or dark point and light", ""),
        ("shadow stages", "ms"),
        ("times as fast as naive 20 everywhere", ""),
    ];
    let mut curve = Curve::new(
        format!(
            "{} ({}x{})",
            subject.name, frame.color.width, frame.color.height
        ),
        columns,
    )
    .plot(Axis::Log(0), Axis::Log(1));
    let lights = scene.lights.len().max(1) as f64;
    let stages_ms = |shot: &Shot| shot.stages_ms(&[Stage::Shadow, Stage::ShadowFilter]);
    let naive_ms = stages_ms(&shots[2]);
    let row = |rendered: &Rendered, ms: f64, stages_ms: f64| -> Vec<f64> {
        let term = shadow_term(rendered);
        let [lost, invented] = truth.misjudged(rendered);
        let traced = rendered.stats.traced_pixels.max(1) as f64;
        vec![
            ms,
            rmse_gray(term, truth.term, |i| truth.is_shaded(i)),
            rmse_gray(term, truth.term, |i| truth.is_penumbra(i)),
            rmse_gray(term, truth.term, |_| true),
            rmse(&rendered.color, &reference.color, |_| true),
            lost,
            invented,
            rendered.stats.shadow_rays as f64 / traced / lights,
            rays_per_settled(&rendered.stats),
            stages_ms,
            naive_ms / stages_ms,
        ]
    };
    for ((series, label, _), shot) in variants.iter().zip(&shots) {
        curve.point(
            *series,
            label.as_str(),
            row(&shot.rendered, shot.ms, stages_ms(shot)),
        );
    }
    curve
        .point(
            "naive",
            samples.to_string(),
            row(&reference, reference_ms, f64::NAN),
        )
        .reference();
    for (label, fps) in THEIRS {
        curve.point("", label, [1e3 / fps]).printed(RT2AR);
    }
    section.curve(curve);

    let default = ShadowSettings::default();
    let Some(at) = variants.iter().position(|(_, _, s)| *s == default) else {
        anyhow::bail!("the default shadow settings are not among those compared");
    };
    section.pictures(pictures(
        &reference,
        &shots[at].rendered,
        &shots[0].rendered.color,
    )?);
    if subject.bundled {
        let values = row(&shots[at].rendered, f64::NAN, f64::NAN);
        let name = &subject.name;
        section.bound(Bound::at_most(
            format!("{name}: shadow term of the default settings, whole picture, RMSE"),
            1.0,
            values[3],
            "/255",
        ));
        section.bound(Bound::at_most(
            format!("{name}: composite of the default settings, RMSE"),
            1.0,
            values[4],
            "/255",
        ));
        section.bound(Bound::at_most(
            format!("{name}: rays per traced pixel and light, default settings"),
            7.5,
            values[7],
            "",
        ));
        section.bound(Bound::at_most(
            format!("{name}: rays per lit or dark point and light, default settings"),
            7.5,
            values[8],
            "",
        ));
    }
    Ok(())
}

fn pictures(reference: &Rendered, result: &Rendered, off: &ColorImage) -> Result<[Picture; 3]> {
    // The window in which shadows change the picture.
    let window = Window::of_difference(&reference.color, off, 8);
    Ok([
        Picture::new("Reference", &reference.color, window)?,
        Picture::new("Default: adaptive, 22", &result.color, window)?,
        Picture::difference(
            "Difference, 16 times; red where the default is brighter",
            [&result.color, &reference.color],
            16.0,
            window,
        )?,
    ])
}
