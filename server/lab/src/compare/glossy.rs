//! Rough reflections: few rays at the first bounce against many.

use anyhow::{Context, Result};

use super::frames::{Shot, at_most, label, once, rmse, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Section, Window, number};
use ghostlight::render::RenderSettings;

/// Metal of three roughnesses.
const SCENE: &str = r#"{"version":1,"objects":[
 {"mesh":"../meshes/sphere.ply","place":{"frame":"pixel","pixel":[275,285],"size_m":0.12},"material":{"preset":"gold"}},
 {"mesh":"../meshes/teapot.ply","place":{"frame":"pixel","pixel":[330,300],"size_m":0.2},"material":{"preset":"brushed_metal"}},
 {"mesh":"../meshes/cylinder.ply","place":{"frame":"pixel","pixel":[375,290],"size_m":0.11},"material":{"preset":"brushed_metal","roughness":0.6}}],
 "lights":[{"type":"sphere","frame":"world","position":[-0.95,-0.3,2.14],"radius":0.13,"intensity":[5.456,5.115,4.495]}]}"#;

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let scene = lab.scene(SCENE, &desk.frame)?;
    let frame = at_most(&desk.frame, lab.pick(320, 640))?;
    let with = |glossy_samples, glossy_sharing| {
        let mut settings = RenderSettings {
            glossy_samples,
            glossy_sharing,
            edge_samples: 1,
            ..RenderSettings::default()
        };
        settings.bloom.enabled = false;
        settings
    };
    let samples = [1, 2, 4, 8, 16, 32, 64];
    let default = RenderSettings::default().glossy_samples;
    lab.phase("1 to 64 rays");
    let sharing = RenderSettings::default().glossy_sharing;
    let each = |sharing| samples.map(|n| with(n, sharing));
    let settings = [each(0.0), each(sharing)].concat();
    let shots = shoot(lab, &frame, &scene, &settings, &[])?;
    let (alone, shared) = shots.split_at(samples.len());
    let most = lab.pick(512, 4096);
    lab.phase(&format!("{most} rays"));
    let start = super::clock();
    let reference = once(lab, &frame, &scene, &with(most, 0.0), &[])?.color;
    let reference_ms = (super::clock() - start) as f64 * 1e-6;
    let touched = |i: usize| reference.rgba[i] != frame.color.rgba[i];

    let mut section = Section::new();
    section.prose(format!(
        "A gold sphere, a teapot and a cylinder of brushed metal, of roughness 0.1, 0.35 and 0.6. A rough \
         reflection is estimated with several rays at the first bounce (for a metal, as many as the setting says) \
         and with one at each later bounce. The reference takes {most}. Neighbouring pixels whose lobes point the \
         same way share their rays and send fewer of them (`glossy_sharing`)."
    ));
    let columns = [
        ("frame", "ms"),
        ("error where not the camera's", "1/255"),
        ("whole picture", "1/255"),
    ];
    let title = format!(
        "Rays per rough reflection ({}x{})",
        frame.color.width, frame.color.height
    );
    let mut curve = Curve::new(title, columns).plot(Axis::Log(0), Axis::Log(1));
    let mut errors = |series: &str, shots: &[Shot], is_default: bool| -> Vec<f64> {
        let each = samples.iter().zip(shots);
        each.map(|(&n, shot)| {
            let color = &shot.rendered.color;
            let error = rmse(color, &reference, touched);
            let values = [shot.ms, error, rmse(color, &reference, |_| true)];
            curve.point(series, label(n, is_default && n == default), values);
            error
        })
        .collect()
    };
    let errors_alone = errors("each pixel its own rays", alone, false);
    let errors_shared = errors("rays shared", shared, true);
    curve
        .point("reference", most.to_string(), [reference_ms, 0.0, 0.0])
        .reference();
    section.curve(curve);
    let order = -slope(&samples.map(f64::from), &errors_alone);
    section.prose(format!(
        "Without sharing, the error falls as the number of rays to the power of -{}; independent random rays would \
         give -0.5.",
        number(order)
    ));
    let window = Window::of_difference(&reference, &frame.color, 4);
    let at = samples.iter().position(|&n| n == default);
    let at = at.context("the default is not among the numbers of rays compared")?;
    let result = &shared[at].rendered.color;
    section.pictures([
        Picture::new("Reference", &reference, window)?,
        Picture::new(format!("{default} rays, the default"), result, window)?,
        Picture::difference("Difference, 8 times", [result, &reference], 8.0, window)?,
    ]);
    section.bound(Bound::at_least(
        "power of the number of rays with which the error falls, each pixel its own rays",
        0.33,
        order,
        "",
    ));
    section.bound(Bound::at_most(
        "error of the default with shared rays, against each pixel its own",
        errors_alone[at],
        errors_shared[at],
        "/255",
    ));
    Ok(section)
}

/// Slope of the line of least squares through the logarithms of both.
fn slope(x: &[f64], y: &[f64]) -> f64 {
    let mean = |values: &[f64]| values.iter().map(|v| v.ln()).sum::<f64>() / values.len() as f64;
    let (mean_x, mean_y) = (mean(x), mean(y));
    let pairs = x.iter().zip(y);
    let (xy, xx) = pairs.fold((0.0, 0.0), |(xy, xx), (x, y)| {
        let dx = x.ln() - mean_x;
        (xy + dx * (y.ln() - mean_y), xx + dx * dx)
    });
    xy / xx
}
