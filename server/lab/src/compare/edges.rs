//! Anti-aliasing: more rays at edges of the picture, against more rays everywhere.

use anyhow::{Context, Result};

use super::frames::{at_most, label, once, rmse, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Printed, Section, Window, number};
use ghostlight::render::RenderSettings;

const HQ: Printed = Printed {
    source: "Kan and Kaufmann 2012 (reflection, refraction, caustics), table 1, ring, 720x576, photons kept",
    machine: "GTX 590",
};

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let scene = lab.bundled_scene("materials.json", &desk.frame)?;
    let frame = at_most(&desk.frame, lab.pick(320, 640))?;
    let with = |edge_contrast, edge_samples| {
        let mut settings = RenderSettings {
            edge_samples,
            edge_contrast,
            ..RenderSettings::default()
        };
        settings.bloom.enabled = false;
        settings
    };
    let mut variants = vec![("one ray", 1, with(1.0, 1))];
    let counts = &[4, 16, 64][..lab.pick(2, 3)];
    for (series, contrast) in [
        ("outlines", 1.0),
        ("outlines + contrast 0.1", 0.1),
        ("every difference", 0.0),
    ] {
        variants.extend(counts.iter().map(|&n| (series, n, with(contrast, n))));
    }
    let RenderSettings {
        edge_contrast,
        edge_samples,
        ..
    } = RenderSettings::default();
    let default_settings = with(edge_contrast, edge_samples);
    let all: Vec<RenderSettings> = variants.iter().map(|(_, _, s)| *s).collect();
    lab.phase("1 to 64 rays");
    let shots = shoot(lab, &frame, &scene, &all, &[])?;
    let most = lab.pick(100, 1024);
    lab.phase(&format!("{most} rays"));
    let start = super::clock();
    let reference = once(lab, &frame, &scene, &with(0.0, most), &[])?.color;
    let reference_ms = (super::clock() - start) as f64 * 1e-6;
    let touched = |i: usize| reference.rgba[i] != frame.color.rgba[i];

    let mut section = Section::new();
    section.prose(format!(
        "Seven solids of the bundled scene. Additional rays are cast for pixels on outlines of virtual objects \
         and, with `edge_contrast` under 1, for those that differ from a neighbour by that share of the display's \
         range; with 0, for every pixel that differs at all. The reference takes {most} rays wherever pixels \
         differ."
    ));
    let columns = [
        ("frame", "ms"),
        ("error where not the camera's", "1/255"),
        ("whole picture", "1/255"),
    ];
    let title = format!(
        "Rays per edge pixel ({}x{})",
        frame.color.width, frame.color.height
    );
    let mut curve = Curve::new(title, columns).plot(Axis::Log(0), Axis::Log(1));
    let mut errors = Vec::new();
    for ((series, n, settings), shot) in variants.iter().zip(&shots) {
        let color = &shot.rendered.color;
        let error = rmse(color, &reference, touched);
        errors.push(error);
        curve.point(
            *series,
            label(*n, *settings == default_settings),
            [shot.ms, error, rmse(color, &reference, |_| true)],
        );
    }
    curve
        .point(
            "every difference",
            most.to_string(),
            [reference_ms, 0.0, 0.0],
        )
        .reference();
    for (label, ms, printed) in [
        ("HQ 1 ray per pixel", 1e3 / 20.0, HQ),
        ("HQ 4", 1e3 / 10.0, HQ),
        ("HQ 9", 1e3 / 5.7, HQ),
    ] {
        curve.point("", label, [ms]).printed(printed);
    }
    section.curve(curve);
    let position = |settings: RenderSettings| {
        let found = variants.iter().position(|(_, _, s)| *s == settings);
        found.context("expected the default and dearer settings among those compared")
    };
    let default_at = position(default_settings)?;
    let default = errors[default_at];
    section.prose(format!(
        "The default ({edge_samples} rays on outlines and where the contrast is over {edge_contrast}) takes the error from \
         {} to {}/255 for {} times the time.",
        number(errors[0]),
        number(default),
        number(shots[default_at].ms / shots[0].ms)
    ));
    let window = Window::of_difference(&reference, &frame.color, 4);
    let result = &shots[default_at].rendered.color;
    section.pictures([
        Picture::new("Reference", &reference, window)?,
        Picture::new(
            format!("{edge_samples} rays on edges, the default"),
            result,
            window,
        )?,
        Picture::difference("Difference, 8 times", [result, &reference], 8.0, window)?,
        Picture::new("One ray a pixel", &shots[0].rendered.color, window)?,
    ]);
    for (what, settings, limit) in [
        (
            "the default against that of one ray",
            default_settings,
            errors[0],
        ),
        (
            "16 rays at every difference against that of the default",
            with(0.0, 16),
            default,
        ),
    ] {
        let got = errors[position(settings)?];
        section.bound(Bound::new(
            format!("error of {what}"),
            format!("under {}/255", number(limit)),
            format!("{}/255", number(got)),
            got < limit,
        ));
    }
    Ok(section)
}
