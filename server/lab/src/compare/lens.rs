//! Depth of field: rays per pixel against many more.

use anyhow::Result;

use super::frames::{at_most, label, once, rmse, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Printed, Section, Window, number};
use ghostlight::render::{LensSettings, RenderSettings};

const DOF: Printed = Printed {
    source: "Kan and Kaufmann 2012 (depth of field), table 1, 720x576",
    machine: "GTX 590",
};

/// Rays per pixel, and the noise threshold above which a pixel takes up to sixteen times as many.
const REFERENCE: (u32, f32) = (256, 0.02);

/// Lens radius of a portrait lens, 50 mm at f/1.25: circles of confusion several pixels wide.
const RADIUS_M: f32 = 0.02;

/// In front of the first object: all objects are out of focus, farther ones more.
const FOCUS_M: f32 = 0.8;

fn through(radius_m: f32, samples: u32, noise_threshold: f32) -> RenderSettings {
    let mut settings = RenderSettings {
        lens: LensSettings {
            radius_m,
            focus_m: FOCUS_M,
            samples,
            noise_threshold,
            ..LensSettings::default()
        },
        ..RenderSettings::default()
    };
    settings.bloom.enabled = false;
    settings
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let scene = lab.bundled_scene("materials.json", &desk.frame)?;
    let frame = at_most(&desk.frame, lab.pick(240, 640))?;
    let LensSettings {
        samples,
        noise_threshold,
        ..
    } = LensSettings::default();
    let counts = lab.pick(vec![1, 4, samples], vec![1, 4, 9, 16, samples, 49, 100]);
    lab.phase("a pinhole, and 1 to 100 rays");
    let series = [
        ("as many everywhere", 1.0),
        ("more where they disagree", noise_threshold),
    ];
    let mut variants = vec![("pinhole", 0, through(0.0, samples, noise_threshold))];
    for (series, noise_threshold) in series {
        variants.extend(
            counts
                .iter()
                .map(|&n| (series, n, through(RADIUS_M, n, noise_threshold))),
        );
    }
    let all: Vec<RenderSettings> = variants.iter().map(|variant| variant.2).collect();
    let shots = shoot(lab, &frame, &scene, &all, &[])?;
    lab.phase(&format!("{} rays and more", REFERENCE.0));
    let start = super::clock();
    let settings = through(RADIUS_M, REFERENCE.0, REFERENCE.1);
    let reference = once(lab, &frame, &scene, &settings, &[])?.color;
    let reference_ms = (super::clock() - start) as f64 * 1e-6;
    let pinhole = &shots[0];
    let touched = |i: usize| {
        reference.rgba[i] != frame.color.rgba[i]
            || pinhole.rendered.color.rgba[i] != frame.color.rgba[i]
    };

    let mut section = Section::new();
    section.prose(format!(
        "The bundled scene through a lens of {} mm radius focused at {FOCUS_M} m, in front of all of its solids; \
         lamps reflected in them become small bright discs. Either every pixel takes the same number of rays, or \
         pixels whose two halves of rays differ by `lens.noise_threshold` take up to sixteen times as many. The \
         error is against {} rays, up to sixteen times as many above a threshold of {}, over the pixels that \
         differ from the camera's with or without the lens. `pinhole` is the picture without depth of field.",
        number(f64::from(RADIUS_M) * 1e3),
        REFERENCE.0,
        REFERENCE.1
    ));
    let columns = [
        ("frame", "ms"),
        ("error where not the camera's", "1/255"),
        ("whole picture", "1/255"),
        ("shadow rays", ""),
        ("secondary rays", ""),
    ];
    let title = format!(
        "Rays per pixel ({}x{})",
        frame.color.width, frame.color.height
    );
    let mut curve = Curve::new(title, columns).plot(Axis::Log(0), Axis::Log(1));
    let mut errors = Vec::new();
    for ((series, n, settings), shot) in variants.iter().zip(&shots) {
        let color = &shot.rendered.color;
        let error = rmse(color, &reference, touched);
        errors.push(error);
        let stats = &shot.rendered.stats;
        let label = match n {
            0 => "pinhole".to_owned(),
            &n => label(
                n,
                (settings.lens.samples, settings.lens.noise_threshold)
                    == (samples, noise_threshold),
            ),
        };
        let values = [
            shot.ms,
            error,
            rmse(color, &reference, |_| true),
            stats.shadow_rays as f64,
            stats.secondary_rays as f64,
        ];
        curve.point(*series, label, values);
    }
    curve
        .point(
            series[1].0,
            REFERENCE.0.to_string(),
            [reference_ms, 0.0, 0.0],
        )
        .reference();
    for (label, fps) in [("1 ray per pixel", 59.0), ("25", 12.0), ("49", 7.0)] {
        curve.point("", label, [1e3 / fps]).printed(DOF);
    }
    section.curve(curve);
    let at = |more: bool, samples: u32| {
        let found = counts.iter().position(|&n| n == samples);
        let first = if more { 1 + counts.len() } else { 1 };
        first + found.unwrap_or(0)
    };
    let (default, even) = (at(true, samples), at(false, samples));
    section.prose(format!(
        "The default, {samples} rays and more where these disagree, has an error of {}/255, {samples} rays \
         everywhere {}/255, and the picture without depth of field {}/255; the default takes {} times as long as \
         that picture.",
        number(errors[default]),
        number(errors[even]),
        number(errors[0]),
        number(shots[default].ms / pinhole.ms)
    ));
    let window = Window::of_difference(&reference, &frame.color, 4);
    let result = &shots[default].rendered.color;
    section.pictures([
        Picture::new("Reference", &reference, window)?,
        Picture::new(format!("{samples} rays, the default"), result, window)?,
        Picture::difference("Difference, 8 times", [result, &reference], 8.0, window)?,
        Picture::new("Without depth of field", &pinhole.rendered.color, window)?,
    ]);
    apertures(lab, &frame, &scene, &mut section)?;

    let mut under = |what: String, got: usize, limit: usize| {
        let (got, limit) = (errors[got], errors[limit]);
        section.bound(Bound::new(
            format!("error of {what}"),
            format!("under {}/255", number(limit)),
            format!("{}/255", number(got)),
            got < limit,
        ));
    };
    for pair in counts.windows(2) {
        let [few, many] = [pair[0], pair[1]];
        under(
            format!("{many} rays against that of {few}"),
            at(false, many),
            at(false, few),
        );
    }
    under(
        format!("{samples} rays and more where they disagree against that of {samples}"),
        default,
        even,
    );
    section.bound(Bound::at_most(
        format!("error of the default, {samples} rays and more where they disagree"),
        8.0,
        errors[default],
        "/255",
    ));
    Ok(section)
}

/// The cost of larger apertures, which must grow no faster than their blur.
fn apertures(
    lab: &Lab,
    frame: &ghostlight::frame::RgbdFrame,
    scene: &ghostlight::scene::Scene,
    section: &mut Section,
) -> Result<()> {
    lab.phase("apertures");
    let LensSettings {
        samples,
        noise_threshold,
        ..
    } = LensSettings::default();
    let radii = lab.pick(
        vec![0.0, 0.001, 0.01],
        vec![0.0, 0.001, 0.0025, 0.005, 0.01, 0.02, 0.04],
    );
    let all: Vec<RenderSettings> = radii
        .iter()
        .map(|&radius| through(radius, samples, noise_threshold))
        .collect();
    let shots = shoot(lab, frame, scene, &all, &[])?;
    let columns = [
        ("radius", "mm"),
        ("frame", "ms"),
        ("traced", "% of pixels"),
        ("virtual", "% of pixels"),
    ];
    let mut curve = Curve::new("Aperture, with the default's rays", columns);
    for (&radius, shot) in radii.iter().zip(&shots) {
        let stats = &shot.rendered.stats;
        let percent = |n: u64| 100.0 * n as f64 / stats.pixels as f64;
        let label = match radius {
            0.0 => "pinhole".to_owned(),
            _ => format!("{} mm", number(f64::from(radius) * 1e3)),
        };
        let values = [
            f64::from(radius) * 1e3,
            shot.ms,
            percent(stats.traced_pixels),
            percent(stats.virtual_pixels),
        ];
        curve.point("aperture", label, values);
    }
    section.curve(curve);
    section.prose(
        "A lens whose blur is under half a pixel everywhere (the first ones) casts no rays of its own: its \
         picture is that of the pinhole.",
    );
    let small = &shots[1].rendered.color;
    let differ = (small.rgba.iter().zip(&shots[0].rendered.color.rgba)).filter(|(a, b)| a != b);
    section.bound(Bound::none_of(
        format!(
            "pixels that a lens of {} mm changes",
            number(f64::from(radii[1]) * 1e3)
        ),
        differ.count(),
        small.rgba.len(),
    ));
    Ok(())
}
