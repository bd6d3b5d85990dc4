//! Frame time against the size of the scene: triangles, objects, lights, pixels.

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3, Vec3};

use super::frames::{resized, shoot_all};
use super::{Axis, Curve, Lab, Printed, Section, View, number};
use ghostlight::frame::RgbdFrame;
use ghostlight::render::RenderSettings;
use ghostlight::scene::{Light, Scene};
use ghostlight::shapes;

const RT2AR: Printed = Printed {
    source: "dos Santos et al. 2012 (RT2AR), section V.D, figure 13",
    machine: "Core i7 3.06 GHz, GTX 580",
};

/// One size, and what to render.
struct Case {
    size: f64,
    label: String,
    frame: Arc<RgbdFrame>,
    scene: Scene,
    settings: RenderSettings,
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let desk = lab.desk()?;
    let teapot = lab.bundled_scene("teapot.json", &desk.frame)?;
    let frame = Arc::new(desk.frame.clone());
    let mut section = Section::new();
    section.prose(
        "The mirror teapot on the bundled desk at default settings (five bounces, adaptive shadows of 22 \
         samples), 640x480 with two lights, with one quantity varied at a time. Large meshes are shown at full \
         detail (`lod_error_px` 0); their levels of detail are another experiment. The growth exponent is the \
         slope of a straight line through the logarithms: 1 is linear growth, 0 is none. All sizes of a plot are \
         rendered in turn.",
    );
    triangles(lab, &teapot, &frame, &mut section)?;
    pixels(lab, &desk, &teapot, &mut section)?;
    lights(lab, &teapot, &frame, &mut section)?;
    bounces(lab, &desk, &mut section)?;
    instances(lab, &teapot, &frame, &mut section)?;
    Ok(section)
}

/// Renders all cases, plots them, and reports how the time grows.
fn plot(
    lab: &Lab,
    title: &str,
    quantity: &'static str,
    cases: &[Case],
    x: fn(usize) -> Axis,
    section: &mut Section,
) -> Result<Curve> {
    lab.phase(title);
    let jobs: Vec<_> = cases
        .iter()
        .map(|case| (&*case.frame, &case.scene, case.settings))
        .collect();
    let shots = shoot_all(lab, &jobs, &[])?;
    let columns = [(quantity, ""), ("frame", "ms"), ("of the smallest", "x")];
    let y: fn(usize) -> Axis = match x(0) {
        Axis::Log(_) => Axis::Log,
        Axis::Linear(_) => Axis::Linear,
    };
    let mut curve = Curve::new(title, columns).plot(x(0), y(1));
    for (case, shot) in cases.iter().zip(&shots) {
        let values = [case.size, shot.ms, shot.ms / shots[0].ms];
        curve.point("", case.label.as_str(), values);
    }
    let sizes: Vec<f64> = cases.iter().map(|case| case.size).collect();
    let times: Vec<f64> = shots.iter().map(|shot| shot.ms).collect();
    let exponent = slope(&sizes, &times);
    let (first, last) = (sizes[0].max(1.0), sizes[sizes.len() - 1]);
    section.prose(format!(
        "{title}: {} times the {quantity} cost {} times the time; the growth exponent is {}.",
        number((last / first).round()),
        number(times[times.len() - 1] / times[0]),
        number(exponent)
    ));
    Ok(curve)
}

/// Slope of the least-squares line through the logarithms of the positive pairs.
fn slope(x: &[f64], y: &[f64]) -> f64 {
    let pairs: Vec<(f64, f64)> = x
        .iter()
        .zip(y)
        .filter(|(x, y)| **x > 0.0 && **y > 0.0)
        .map(|(x, y)| (x.ln(), y.ln()))
        .collect();
    let n = pairs.len() as f64;
    let mean = |f: fn(&(f64, f64)) -> f64| pairs.iter().map(f).sum::<f64>() / n;
    let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
    let covariance: f64 = pairs.iter().map(|(x, y)| (x - mx) * (y - my)).sum();
    let variance: f64 = pairs.iter().map(|(x, _)| (x - mx).powi(2)).sum();
    covariance / variance
}

fn triangles(
    lab: &Lab,
    teapot: &Scene,
    frame: &Arc<RgbdFrame>,
    section: &mut Section,
) -> Result<()> {
    // 64 n^2 triangles, and a few for the caps.
    let sides: &[u32] = lab.pick(&[4, 16, 64], &[4, 8, 16, 32, 64, 125, 177]);
    let cases: Vec<Case> = sides
        .iter()
        .map(|&side| {
            let mut scene = teapot.clone();
            let mesh = shapes::teapot(side);
            let n = mesh.triangles.len();
            scene.meshes[0] = Arc::new(mesh);
            Case {
                size: n as f64,
                label: thousands(n),
                frame: Arc::clone(frame),
                scene,
                // Meshes at full detail: the question is how the time grows with size, not how levels of detail
                // limit it.
                settings: RenderSettings {
                    lod_error_px: 0.0,
                    ..RenderSettings::default()
                },
            }
        })
        .collect();
    let mut curve = plot(
        lab,
        "Triangles of one teapot, as they are",
        "triangles",
        &cases,
        Axis::Log,
        section,
    )?;
    for (label, n, fps) in [
        ("RT2AR teapot", 14_280.0, 95.0),
        ("RT2AR dragons + teapot", 2.2e6, 112.0),
    ] {
        curve.point("", label, [n, 1e3 / fps]).printed(RT2AR);
    }
    section.curve(curve);
    Ok(())
}

fn thousands(n: usize) -> String {
    match n {
        0..1_000_000 => format!("{} K", (n + 500) / 1000),
        _ => format!("{:.1} M", n as f64 * 1e-6),
    }
}

fn pixels(lab: &Lab, desk: &View, teapot: &Scene, section: &mut Section) -> Result<()> {
    let sizes: &[(u32, u32)] = lab.pick(
        &[(160, 120), (320, 240), (640, 480)],
        &[
            (160, 120),
            (320, 240),
            (640, 480),
            (960, 720),
            (1280, 720),
            (1920, 1080),
        ],
    );
    let mut cases = Vec::new();
    for &(width, height) in sizes {
        cases.push(Case {
            size: f64::from(width * height),
            label: format!("{width}x{height}"),
            frame: Arc::new(resized(&desk.frame, width, height)?),
            scene: teapot.clone(),
            settings: RenderSettings::default(),
        });
    }
    let curve = plot(
        lab,
        "Pixels of the same view",
        "pixels",
        &cases,
        Axis::Log,
        section,
    )?;
    section.curve(curve);
    Ok(())
}

fn lights(lab: &Lab, teapot: &Scene, frame: &Arc<RgbdFrame>, section: &mut Section) -> Result<()> {
    let counts: &[u32] = lab.pick(&[1, 4, 16], &[1, 2, 4, 8, 16]);
    let middle = teapot.instances[0].world_from_object.translation;
    let cases: Vec<Case> = counts
        .iter()
        .map(|&n| {
            let mut scene = teapot.clone();
            scene.lights = (0..n)
                .map(|k| {
                    // In a circle above the teapot; together as bright as one lamp.
                    let angle = f64::from(k) * std::f64::consts::TAU / f64::from(n) + 0.7;
                    Light::Sphere {
                        position: middle + DVec3::new(1.2 * angle.cos(), 1.2 * angle.sin(), 1.2),
                        radius_m: 0.13,
                        intensity: Vec3::splat(5.0 / n as f32),
                    }
                })
                .collect();
            Case {
                size: f64::from(n),
                label: n.to_string(),
                frame: Arc::clone(frame),
                scene,
                settings: RenderSettings::default(),
            }
        })
        .collect();
    let curve = plot(lab, "Lights", "lights", &cases, Axis::Log, section)?;
    section.curve(curve);
    Ok(())
}

fn bounces(lab: &Lab, desk: &View, section: &mut Section) -> Result<()> {
    let scene = lab.scene(super::reflections::MIRRORS, &desk.frame)?;
    let frame = Arc::new(desk.frame.clone());
    let counts: &[u32] = lab.pick(&[0, 2, 8], &[0, 1, 2, 3, 4, 5, 6, 7, 8]);
    let cases: Vec<Case> = counts
        .iter()
        .map(|&max_bounces| Case {
            size: f64::from(max_bounces),
            label: max_bounces.to_string(),
            frame: Arc::clone(&frame),
            scene: scene.clone(),
            settings: RenderSettings {
                max_bounces,
                ..RenderSettings::default()
            },
        })
        .collect();
    let curve = plot(
        lab,
        "Bounces between two mirrors",
        "bounces",
        &cases,
        Axis::Linear,
        section,
    )?;
    section.curve(curve);
    Ok(())
}

fn instances(
    lab: &Lab,
    teapot: &Scene,
    frame: &Arc<RgbdFrame>,
    section: &mut Section,
) -> Result<()> {
    let sides: &[u32] = lab.pick(&[1, 3, 10], &[1, 2, 3, 5, 7, 10]);
    let whole = teapot.instances[0].world_from_object;
    let cases: Vec<Case> = sides
        .iter()
        .map(|&side| {
            let mut scene = teapot.clone();
            let n = f64::from(side);
            scene.instances = (0..side * side)
                .map(|k| {
                    let mut instance = teapot.instances[0].clone();
                    // A square area on the desk, as wide as the one teapot.
                    let cell = |i: u32| ((f64::from(i) + 0.5) / n - 0.5) * 0.3;
                    let offset = DVec3::new(cell(k % side), cell(k / side), 0.0);
                    instance.world_from_object = DAffine3::from_translation(offset)
                        * whole
                        * DAffine3::from_scale(DVec3::splat(1.0 / n));
                    instance
                })
                .collect();
            Case {
                size: n * n,
                label: (side * side).to_string(),
                frame: Arc::clone(frame),
                scene,
                settings: RenderSettings::default(),
            }
        })
        .collect();
    let title = "Instances of one teapot in the same field";
    let curve = plot(lab, title, "instances", &cases, Axis::Log, section)?;
    section.curve(curve);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_is_the_power() {
        let x = [1.0, 2.0, 8.0, 100.0];
        let y = x.map(|x: f64| 3.0 * x.powf(0.7));
        assert!((slope(&x, &y) - 0.7).abs() < 1e-12);
        // A zero has no logarithm.
        assert!((slope(&[0.0, 1.0, 4.0], &[9.0, 2.0, 8.0]) - 1.0).abs() < 1e-12);
    }
}
