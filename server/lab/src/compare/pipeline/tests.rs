//! Runs the experiment at a very small size.

use std::path::Path;

use super::*;
use crate::compare::LabOptions;

#[test]
fn a_small_room_has_every_region_and_geometry_is_right() {
    let lab = Lab::new(LabOptions {
        quick: true,
        threads: 2,
        backend: ghostlight::render::Backend::Auto,
        home: Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."),
        data: None,
        quiet: true,
    })
    .unwrap();
    let plan = Plan::every_material(Lighting::Open, (96, 72), 4);
    let stage = Stage::build(&lab, &plan, &mut Rooms::default()).unwrap();
    let rendered = stage
        .composite(Depth::Exact, false, &settings(false))
        .unwrap();
    let tally = Tally::new(&stage, &rendered.color);
    for region in Region::ALL.into_iter().chain((1..=5).map(Region::Thing)) {
        assert!(
            tally.count(region) > 8,
            "{region:?}: {}",
            tally.count(region)
        );
        assert!(tally.rmse(region).is_finite() && tally.p99(region) >= tally.bias(region).abs());
    }
    let n: usize = Region::ALL.iter().map(|&region| tally.count(region)).sum();
    assert_eq!(n, 96 * 72);
    let mut section = Section::new();
    check_geometry(&stage, &mut section).unwrap();
    // Camera picture and ground truth have the same noise where there is no object.
    let untouched = Tally::new(&stage, &stage.camera);
    let noise = stage.noise_tally();
    assert!(untouched.rmse(Region::Rest) < noise.rmse(Region::Rest));
    // Adding the objects brings the picture nearer to the ground truth.
    assert!(tally.rmse(Region::Object) < untouched.rmse(Region::Object));
    assert_eq!(section.bounds.len(), 3);
    for bound in &section.bounds {
        assert!(bound.kept, "{bound:?}");
    }
}
