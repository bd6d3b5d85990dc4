//! Reflection depth: numbers of bounces against the maximum.

use anyhow::Result;

use super::frames::{at_most, label, rmse, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Printed, Section, Window, number};
use ghostlight::render::RenderSettings;

const RT2AR: Printed = Printed {
    source: "dos Santos et al. 2012 (RT2AR), section V.D, table 1, without shadows",
    machine: "Core i7 3.06 GHz, GTX 580",
};

/// Two mirrors at an angle of 50 degrees, open towards the camera, with a chrome teapot and a gold ring between
/// them.
pub(super) const MIRRORS: &str = r#"{"version":1,"objects":[
 {"mesh":"../meshes/cube.ply","place":{"frame":"pixel","pixel":[316,285],"translation":[-0.085,0,0],"rotation":[0,-0.21644,0,0.976296],"scale":[0.1,1.8,2.2]},"material":{"preset":"mirror"}},
 {"mesh":"../meshes/cube.ply","place":{"frame":"pixel","pixel":[316,285],"translation":[0.085,0,0],"rotation":[0,0.21644,0,0.976296],"scale":[0.1,1.8,2.2]},"material":{"preset":"mirror"}},
 {"mesh":"../meshes/teapot.ply","place":{"frame":"pixel","pixel":[316,285],"size_m":0.1},"material":{"preset":"chrome"}},
 {"mesh":"../meshes/ring.ply","place":{"frame":"pixel","pixel":[316,285],"translation":[0,0,0.09],"size_m":0.07},"material":{"preset":"gold"}}],
 "lights":[{"type":"sphere","frame":"world","position":[-0.95,-0.3,2.14],"radius":0.13,"intensity":[5.456,5.115,4.495]}]}"#;

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let scene = lab.scene(MIRRORS, &desk.frame)?;
    let frame = at_most(&desk.frame, lab.pick(320, 640))?;
    let all: Vec<RenderSettings> = (0..=8)
        .map(|max_bounces| RenderSettings {
            max_bounces,
            ..RenderSettings::default()
        })
        .collect();
    lab.phase("bounces 0 to 8");
    let shots = shoot(lab, &frame, &scene, &all, &[])?;
    let reference = &shots[8].rendered.color;
    let default = RenderSettings::default().max_bounces as usize;
    let touched = |i: usize| reference.rgba[i] != frame.color.rgba[i];

    let mut section = Section::new();
    section.prose(
        "Two mirrors at an angle of 50 degrees, with a chrome teapot and a gold ring between them, as in a \
         kaleidoscope, on the bundled desk. A path that exceeds the number of bounces takes the environment's \
         radiance. The error is against eight bounces, the maximum, over the pixels that differ from the \
         camera's.",
    );
    let columns = [
        ("frame", "ms"),
        ("error where not the camera's", "1/255"),
        ("whole picture", "1/255"),
        ("secondary rays", ""),
    ];
    let title = format!("Bounces ({}x{})", frame.color.width, frame.color.height);
    let mut curve = Curve::new(title, columns).plot(Axis::Log(0), Axis::Log(1));
    let mut errors = Vec::new();
    for (bounces, shot) in shots.iter().enumerate() {
        let error = rmse(&shot.rendered.color, reference, touched);
        errors.push(error);
        let values = [
            shot.ms,
            error,
            rmse(&shot.rendered.color, reference, |_| true),
            shot.rendered.stats.secondary_rays as f64,
        ];
        let label = label(bounces as u32, bounces == default);
        let point = curve.point("bounces", label, values);
        if bounces == 8 {
            point.reference();
        }
    }
    for (label, fps) in [("RT2AR 0", 74.0), ("RT2AR 3", 60.0), ("RT2AR 5", 60.0)] {
        curve.point("", label, [1e3 / fps]).printed(RT2AR);
    }
    section.curve(curve);
    section.prose(format!(
        "The default of {default} is {}/255 from the reference and costs {} times a frame without reflections.",
        number(errors[default]),
        number(shots[default].ms / shots[0].ms)
    ));
    let window = Window::of_difference(reference, &frame.color, 4);
    let at = |bounces: usize| &shots[bounces].rendered.color;
    section.pictures([
        Picture::new("8 bounces, the reference", at(8), window)?,
        Picture::new(
            format!("{default} bounces, the default"),
            at(default),
            window,
        )?,
        Picture::difference("Difference, 16 times", [at(default), at(8)], 16.0, window)?,
        Picture::new("1 bounce", at(1), window)?,
    ]);
    // Each bounce adds missing light, but a path that is cut off is completed by an estimate. So a single
    // additional bounce may increase the error; four more never do.
    for (few, more) in [(0, 4), (1, 5), (3, 7)] {
        section.bound(Bound::new(
            format!("error of {more} bounces against that of {few}"),
            format!("under {}/255", number(errors[few])),
            format!("{}/255", number(errors[more])),
            errors[more] < errors[few],
        ));
    }
    section.bound(Bound::at_most(
        format!("error of the default, {default} bounces, where not the camera's own"),
        4.0,
        errors[default],
        "/255",
    ));
    Ok(section)
}
