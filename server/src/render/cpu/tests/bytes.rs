//! The same frame gives the same bytes, however it is rendered.

use glam::{DVec3, Vec3};

use super::*;

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let light = Light::Sphere {
        position: DVec3::new(0.4, -0.8, 0.6),
        radius_m: 0.1,
        intensity: Vec3::ONE,
    };
    let objects = [
        (DVec3::new(-0.1, 0.1, 1.6), 0.25, mirror(), false),
        (DVec3::new(0.3, 0.1, 1.4), 0.15, glass(), false),
        (
            DVec3::new(0.1, -0.3, 1.5),
            0.1,
            Material {
                metallic: 1.0,
                roughness: 0.4,
                ..Material::default()
            },
            false,
        ),
    ];
    let scene = scene(&objects, vec![light]);
    let frame = noise();
    let settings = RenderSettings::default();
    let one = render(&scene, &frame, &settings, 1);
    for threads in [2, 5] {
        let other = render(&scene, &frame, &settings, threads);
        assert_eq!(one.color, other.color);
        assert_eq!(one.aovs, other.aovs);
        assert_eq!(one.stats, other.stats);
    }
    let mut again = renderer_of(&scene, 2);
    for _ in 0..2 {
        assert_eq!(
            again
                .render(&frame, &settings, &[], &Uninterrupted)
                .unwrap()
                .color,
            one.color,
            "buffers must not leak between frames"
        );
    }
}

/// Decoding in parallel with building the ghost surface gives the same picture, and a failure of either leaves
/// the renderer usable.
#[test]
fn a_frame_that_is_decoded_while_it_is_rendered_has_the_same_bytes() {
    let object = (DVec3::new(0.1, 0.0, 1.6), 0.25, mirror(), false);
    let scene = scene(
        &[object],
        vec![point_light(DVec3::new(-0.5, 0.0, 0.5), 1.0)],
    );
    let settings = RenderSettings::default();
    let (first, second) = (noise(), wall([90, 120, 150, 255]));
    let geometry = |frame: &RgbdFrame| FrameGeometry {
        index: frame.index,
        time_ns: frame.time_ns,
        depth: frame.depth.clone(),
        intrinsics: frame.intrinsics,
        pose: frame.pose,
    };
    for threads in [1, 3] {
        let mut renderer = renderer_of(&scene, threads);
        for frame in [&first, &second] {
            let expected = render(&scene, frame, &settings, 1);
            let (decoded, rendered) = renderer
                .render_decoding(
                    || Ok::<_, &str>(geometry(frame)),
                    || Ok(frame.color.clone()),
                    &settings,
                    &Aov::ALL,
                    &Uninterrupted,
                )
                .unwrap();
            let rendered = rendered.unwrap();
            assert_eq!(decoded.color, frame.color);
            assert_eq!(rendered.color, expected.color);
            assert_eq!(rendered.aovs, expected.aovs);
            let mut fail = |geometry, color| {
                let failed = renderer.render_decoding(
                    || geometry,
                    || color,
                    &settings,
                    &Aov::ALL,
                    &Uninterrupted,
                );
                failed.map(|_| ()).unwrap_err()
            };
            let picture = || Ok(frame.color.clone());
            assert_eq!(fail(Err("depth"), picture()), "depth");
            assert_eq!(fail(Ok(geometry(frame)), Err("colour")), "colour");
            assert_eq!(fail(Err("depth"), Err("colour")), "colour");
        }
    }
}
