//! Levels of detail of large meshes: time and error against the allowed error.

use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{DAffine3, DVec3};

use super::frames::{once, rmse, rmse_gray, shadow_term, shoot};
use super::{Axis, Bound, Curve, Lab, Picture, Section, Window, number};
use ghostlight::render::{Aov, RenderSettings};
use ghostlight::scene::{Preset, Scene};
use ghostlight::shapes;

/// How many times the error of full-detail meshes the default may have, both against the reference.
const WORSE: f64 = 1.1;
/// Largest RMSE of shadows where there are any, display levels: less than the error of casting 22 rays (1.3 under
/// one teapot; see `shadows`).
const SHADOWS: f64 = 1.0;

/// Two teapots side by side on the desk, of `64 side^2` triangles each.
fn pair(teapot: &Scene, side: u32, preset: Preset) -> Scene {
    let mut scene = teapot.clone();
    scene.meshes[0] = Arc::new(shapes::teapot(side));
    let material = scene.instances[0].material as usize;
    scene.materials[material] = preset.material();
    let mut second = scene.instances[0].clone();
    let aside = DAffine3::from_translation(DVec3::new(-0.4, 0.0, 0.0));
    second.world_from_object = aside * second.world_from_object;
    scene.instances.push(second);
    scene
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let teapot = lab.bundled_scene("teapot.json", &desk.frame)?;
    let side = lab.pick(32, 125);
    let with = |lod_error_px, edge_samples| {
        let mut settings = RenderSettings {
            lod_error_px,
            edge_samples,
            ..RenderSettings::default()
        };
        settings.bloom.enabled = false;
        settings
    };
    let RenderSettings {
        lod_error_px: default,
        edge_samples,
        ..
    } = RenderSettings::default();
    let limits: &[f32] = lab.pick(&[0.0, 0.5, 2.0], &[0.0, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0]);
    let mut section = Section::new();
    section.prose(format!(
        "Two teapots of {} triangles each on the bundled desk, 640x480. A frame shows every large mesh at the \
         coarsest level of detail whose error is at most `lod_error_px` pixels. The error was measured when the \
         mesh was loaded: rays along the normals give the distance to the level and the difference of normals. \
         Shadows on real surfaces use a separate level, for which only positions count. The reference shows the \
         meshes at full detail, with many rays for every pixel that differs from a neighbour. There are two \
         errors: against that reference, and against the meshes at full detail with the same rays; the latter is \
         mostly different noise.",
        64 * side * side
    ));
    for (name, preset) in [("mirror", Preset::Mirror), ("plastic", Preset::Plastic)] {
        let scene = pair(&teapot, side, preset);
        lab.phase(&format!("{name}: {} limits", limits.len()));
        let all: Vec<RenderSettings> = limits.iter().map(|&px| with(px, edge_samples)).collect();
        let shots = shoot(lab, &desk.frame, &scene, &all, &[Aov::Shadow])?;
        lab.phase(&format!("{name}: reference"));
        let mut settings = with(0.0, lab.pick(16, 64));
        settings.edge_contrast = 0.0;
        let reference = once(lab, &desk.frame, &scene, &settings, &[])?.color;
        let as_is = &shots[0].rendered.color;
        let camera = &desk.frame.color;
        let touched = |i: usize| reference.rgba[i] != camera.rgba[i];
        let columns = [
            ("frame", "ms"),
            ("error where not the camera's", "1/255"),
            ("against the same rays", "1/255"),
            ("triangles", ""),
            ("times as fast", "x"),
        ];
        let title = format!("Two {name} teapots (640x480)");
        let mut curve = Curve::new(title, columns).plot(Axis::Linear(0), Axis::Linear(1));
        let mut errors = Vec::new();
        for (&px, shot) in limits.iter().zip(&shots) {
            let color = &shot.rendered.color;
            let error = rmse(color, &reference, touched);
            errors.push(error);
            let label = match px {
                0.0 => "as they are".to_owned(),
                px if px == default => format!("{px} px (default)"),
                px => format!("{px} px"),
            };
            curve.point(
                "",
                label,
                [
                    shot.ms,
                    error,
                    rmse(color, as_is, touched),
                    shot.rendered.stats.triangles as f64,
                    shots[0].ms / shot.ms,
                ],
            );
        }
        curve.point("", "reference", [f64::NAN, 0.0]).reference();
        section.curve(curve);
        let at = limits
            .iter()
            .position(|&px| px == default)
            .context("expected the default among the limits compared")?;
        let result = &shots[at].rendered.color;
        section.prose(format!(
            "{name}: the default is {} times as fast, with an error of {} instead of {}/255.",
            number(shots[0].ms / shots[at].ms),
            number(errors[at]),
            number(errors[0])
        ));
        let window = Window::of_difference(&reference, camera, 4);
        section.pictures([
            Picture::new("Reference", &reference, window)?,
            Picture::new("The default", result, window)?,
            Picture::new("As they are", as_is, window)?,
            Picture::difference(
                "Default and as they are, 8 times",
                [result, as_is],
                8.0,
                window,
            )?,
        ]);
        section.bound(Bound::at_most(
            format!("{name}: error of the default against that of the meshes as they are"),
            WORSE,
            errors[at] / errors[0],
            " times",
        ));
        let [shadow, as_it_is] = [at, 0].map(|i| shadow_term(&shots[i].rendered));
        section.bound(Bound::at_most(
            format!("{name}: shadows by coarser levels, where there are any"),
            SHADOWS,
            rmse_gray(shadow, as_it_is, |i| as_it_is[i] != u8::MAX),
            "/255",
        ));
    }
    Ok(section)
}
