//! Composites against ground truth: a path-traced room that contains the objects.
//!
//! The oracle renders the room alone and with the objects, with the same estimator and the same random numbers.
//! Ghostlight gets the first picture, its depth (exact, or with a multiple of the sensor's noise) and the same
//! lamps, and must reproduce the second. As with a real camera, it does not get the room outside the picture,
//! indirect light, or the real materials.

mod stage;
mod tally;

use anyhow::Result;

use super::{Axis, Bound, Curve, Lab, Picture, Section, number};
use crate::synth::{Depth, Lighting};
use ghostlight::frame::ColorImage;
use ghostlight::render::RenderSettings;
use stage::{Plan, Rooms, Stage};
use tally::{Region, Tally};

/// Multiples of the sensor's noise. Level zero still has the sensor's holes; exact depth has none.
const LEVELS: [f64; 4] = [0.0, 0.5, 1.0, 2.0];

/// How much differences are amplified in pictures.
const GAIN: f32 = 4.0;

/// Runs the experiment.
pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let mut section = Section::new();
    section.prose(
        "Reference: unbiased path tracing in double precision of a room with the objects in it. Input: the same \
         estimator's picture of the empty room and its depth. Errors are in 8-bit sRGB codes against the values \
         of the reference, over all channels. *object* is every pixel that shows an object or touches its \
         outline, *shadow* every pixel at which an object hides a lamp, *rest* all others, which objects affect \
         by indirect light alone. If the error grows with the sensor's noise, the sensor is the limit; otherwise \
         the renderer is. `truth's noise` is the standard error of the reference: no RMSE below it can be \
         measured.",
    );
    section.prose(
        "`guessed`: surroundings are estimated from the picture, as without an environment map. `probe`: the \
         scene has a map that was path traced at the objects' position. `finest`: 64 rays per edge pixel and \
         rough reflection, 256 per shadow, 8 bounces. Post-processing is off throughout.",
    );
    let plans: Vec<Plan> = lab.pick(
        vec![Plan::every_material(Lighting::Open, (200, 150), 48)],
        Plan::full(),
    );
    let mut rooms = Rooms::default();
    for plan in &plans {
        measure(lab, plan, &mut rooms, &mut section)?;
    }
    Ok(section)
}

/// Settings without post-processing: the defaults, or the finest.
fn settings(finest: bool) -> RenderSettings {
    let mut settings = RenderSettings::default();
    settings.bloom.enabled = false;
    if finest {
        settings.edge_samples = 64;
        settings.glossy_samples = 64;
        settings.max_bounces = 8;
        settings.shadows.method = ghostlight::render::ShadowMethod::Naive;
        settings.shadows.samples = 256;
        settings.shadows.filter_radius_px = 0;
    }
    settings
}

fn measure(lab: &mut Lab, plan: &Plan, rooms: &mut Rooms, section: &mut Section) -> Result<()> {
    let stage = Stage::build(lab, plan, rooms)?;
    lab.phase(&format!("{}: composites", plan.name));
    let depth = |level: Option<f64>| level.map_or(Depth::Exact, Depth::Sensed);
    let levels: Vec<Option<f64>> = std::iter::once(None)
        .chain(LEVELS.into_iter().map(Some))
        .collect();

    let columns = [
        ("noise", "sigma"),
        ("object, RMSE", "1/255"),
        ("object, p99", "1/255"),
        ("shadow, RMSE", "1/255"),
        ("shadow, p99", "1/255"),
        ("rest, RMSE", "1/255"),
        ("rest, p99", "1/255"),
    ];
    let title = format!("{}: error against sensor noise", plan.name);
    let mut curve = Curve::new(title, columns).plot(Axis::Linear(0), Axis::Linear(1));
    let row = |tally: &Tally, level: f64| {
        let mut cells = vec![level];
        for region in Region::ALL {
            cells.extend([tally.rmse(region), tally.p99(region)]);
        }
        cells
    };
    let mut shown: Vec<ColorImage> = Vec::new();
    for (series, probe, finest) in [
        ("guessed", false, false),
        ("probe", true, false),
        ("probe, finest", true, true),
    ] {
        for &level in &levels {
            // Takes long, and the sensor's part is known from the other settings.
            if finest && !(level.is_none() || level == Some(1.0)) {
                continue;
            }
            let rendered = stage.composite(depth(level), probe, &settings(finest))?;
            let tally = Tally::new(&stage, &rendered.color);
            let label = match level {
                None => "exact depth".to_owned(),
                Some(level) => format!("{level} sigma, holes"),
            };
            curve.point(series, label, row(&tally, level.unwrap_or(0.0)));
            if level.is_none() && series == "guessed" {
                check_geometry(&stage, section)?;
            }
            if !finest && !probe && (level.is_none() || level == Some(1.0)) {
                shown.push(rendered.color);
            }
        }
    }
    let untouched = Tally::new(&stage, &stage.camera);
    curve.point(
        "the camera's picture, nothing added",
        "",
        row(&untouched, f64::NAN),
    );
    let noise = stage.noise_tally();
    curve
        .point("truth's noise", "", row(&noise, f64::NAN))
        .reference();
    section.curve(curve);

    let names: Vec<(&str, u32)> = plan
        .things
        .iter()
        .zip(1u32..)
        .map(|(thing, k)| (thing.name, k))
        .collect();
    if names.len() > 1 {
        by_material(&stage, plan, &names, section)?;
    }

    let truth = stage.truth_image();
    let mut pictures = vec![Picture::new(format!("{}: truth", plan.name), &truth, None)?];
    let told = ["exact depth", "1 sigma, holes"];
    for (image, told) in shown.iter().zip(told) {
        pictures.push(Picture::new(format!("composite, {told}"), image, None)?);
        pictures.push(Picture::difference(
            format!("composite less truth, {told}, x{GAIN}"),
            [image, &truth],
            GAIN,
            None,
        )?);
    }
    pictures.push(Picture::new("what the camera sees", &stage.camera, None)?);
    section.pictures(pictures);
    Ok(())
}

/// Errors of each object, with exact depth.
fn by_material(
    stage: &Stage,
    plan: &Plan,
    names: &[(&str, u32)],
    section: &mut Section,
) -> Result<()> {
    let columns = [
        ("guessed, RMSE", "1/255"),
        ("probe, RMSE", "1/255"),
        ("probe, finest, RMSE", "1/255"),
        ("mean error, probe, finest", "1/255"),
        ("p99, probe, finest", "1/255"),
        ("truth's noise", "1/255"),
        ("pixels", ""),
    ];
    let title = format!("{}: error by material, exact depth", plan.name);
    let mut curve = Curve::new(title, columns);
    let tallies: Vec<Tally> = [(false, false), (true, false), (true, true)]
        .into_iter()
        .map(|(probe, finest)| {
            let rendered = stage.composite(Depth::Exact, probe, &settings(finest))?;
            Ok(Tally::new(stage, &rendered.color))
        })
        .collect::<Result<_>>()?;
    let noise = stage.noise_tally();
    for &(name, thing) in names {
        let region = Region::Thing(thing);
        let last = &tallies[2];
        curve.point(
            "",
            name,
            [
                tallies[0].rmse(region),
                tallies[1].rmse(region),
                last.rmse(region),
                last.bias(region),
                last.p99(region),
                noise.rmse(region),
                last.count(region) as f64,
            ],
        );
    }
    section.curve(curve);
    Ok(())
}

/// Checks the results that depend on geometry alone, with exact depth: no pixel may be wrong.
fn check_geometry(stage: &Stage, section: &mut Section) -> Result<()> {
    let name = &stage.name;
    // Ambient light and caustics reach far, so they are off: lamps and outlines alone decide which pixels change.
    let mut lamps_only = settings(false);
    lamps_only.ambient.enabled = false;
    lamps_only.caustics.enabled = Some(false);
    let rendered = stage.composite(Depth::Exact, false, &lamps_only)?;
    let (mut inside, mut wrong_inside) = (0, 0);
    let (mut outside, mut wrong_outside) = (0, 0);
    let (mut free, mut touched) = (0, 0);
    for (i, &mask) in rendered.mask.iter().enumerate() {
        if stage.is_inside(i) {
            inside += 1;
            wrong_inside += usize::from(mask != 255);
        } else if stage.is_outside(i) {
            outside += 1;
            wrong_outside += usize::from(mask != 0);
        }
        if stage.is_free(i) {
            free += 1;
            touched += usize::from(rendered.color.rgba[i] != stage.camera.rgba[i]);
        }
    }
    section.bound(Bound::none_of(
        format!("{name}: pixels within an object that do not show it wholly"),
        wrong_inside,
        inside,
    ));
    section.bound(Bound::none_of(
        format!("{name}: pixels clear of every object that show one"),
        wrong_outside,
        outside,
    ));
    section.bound(Bound::none_of(
        format!(
            "{name}: pixels out of reach of every object and shadow that differ from the camera's"
        ),
        touched,
        free,
    ));
    section.prose(format!(
        "{name}: {} pixels inside objects, {} outside of them, {} away from objects and shadows.",
        number(f64::from(inside as u32)),
        number(f64::from(outside as u32)),
        number(f64::from(free as u32)),
    ));
    Ok(())
}

#[cfg(test)]
mod tests;
