use super::*;
use glam::DQuat;

const VGA: [f64; 4] = [585.0, 585.0, 320.0, 240.0];

fn camera(k: [f64; 4], width: u32, height: u32) -> Intrinsics {
    Intrinsics::new(k[0], k[1], k[2], k[3], width, height).unwrap()
}

/// A rig like a Kinect's, with a rotation and an offset along every axis.
fn beside() -> Pose {
    Pose {
        rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.01, -0.02, 0.015),
        translation: DVec3::new(-0.027, 0.004, 0.006),
    }
}

/// A plane `n . p = 1`, and its exact depth in a camera.
#[derive(Clone, Copy)]
struct Plane(DVec3);

impl Plane {
    fn depth_at(self, k: &Intrinsics, u: f64, v: f64) -> f64 {
        1.0 / self.0.dot(k.unproject(u, v, 1.0))
    }

    /// The same plane in the axes that `pose` transforms to.
    fn moved(self, pose: &Pose) -> Self {
        let n = pose.rotation * self.0;
        Self(n / (1.0 + n.dot(pose.translation)))
    }

    fn image(self, k: &Intrinsics) -> DepthImage {
        let z = (0..k.n_pixels()).map(|i| {
            let (x, y) = (i as u32 % k.width, i as u32 / k.width);
            self.depth_at(k, x.into(), y.into()) as f32
        });
        DepthImage::from_metres(k.width, k.height, z.collect())
    }
}

/// Largest relative error of depth against a plane, and the number of compared pixels: those whose ray hits the depth
/// camera's image at least `margin_px` from its border.
fn compare(
    got: &DepthImage,
    plane: Plane,
    depth_k: &Intrinsics,
    color_from_depth: &Pose,
    color_k: &Intrinsics,
    margin_px: f64,
) -> (f64, usize) {
    let (mut worst, mut n) = (0.0f64, 0);
    let seen = plane.moved(color_from_depth);
    for y in 0..color_k.height {
        for x in 0..color_k.width {
            let (u, v) = (f64::from(x), f64::from(y));
            let truth = seen.depth_at(color_k, u, v);
            let p = color_from_depth
                .inverse()
                .transform_point(color_k.unproject(u, v, truth));
            let (du, dv) = depth_k.project(p);
            let inside =
                |at: f64, size: u32| at > margin_px - 0.5 && at < f64::from(size) - 0.5 - margin_px;
            if inside(du, depth_k.width) && inside(dv, depth_k.height) {
                let z = f64::from(got.z_m[(y * color_k.width + x) as usize]);
                assert!(
                    z.is_finite(),
                    "hole at {x} {y} (depth pixel {du:.2} {dv:.2})"
                );
                worst = worst.max((z / truth - 1.0).abs());
                n += 1;
            }
        }
    }
    (worst, n)
}

#[test]
fn the_same_camera_returns_the_same_bits() {
    let k = camera(VGA, 64, 48);
    let mut z: Vec<f32> = (0..64 * 48).map(|i| 1.0 + (i % 17) as f32 * 0.3).collect();
    z[100] = 0.0;
    let depth = DepthImage::from_metres(64, 48, z);
    let address = depth.z_m.as_ptr();
    let bits = |d: &DepthImage| d.z_m.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
    let before = bits(&depth);
    let after = register_depth(depth, &k, &Pose::IDENTITY, &k);
    assert_eq!(bits(&after), before);
    assert_eq!(after.z_m.as_ptr(), address, "not even copied");
}

/// A plane is exact at every pixel up to rounding, up to the border of the outermost pixels' footprints, with
/// magnification, reduction and rotation.
#[test]
fn a_slanted_plane_is_exact_at_sub_pixel_level() {
    let plane = Plane(DVec3::new(0.08, -0.15, 0.6));
    let depth_k = camera([146.0, 146.0, 80.0, 60.0], 160, 120);
    for (color_k, pose) in [
        (camera([131.7, 132.4, 80.3, 59.7], 160, 120), beside()),
        (
            camera([1095.0, 1095.0, 599.5, 449.5], 1200, 900),
            Pose::IDENTITY,
        ),
        (camera([800.0, 800.0, 500.0, 380.0], 1000, 760), beside()),
        (camera([60.0, 60.0, 33.0, 25.0], 66, 50), beside()),
    ] {
        let got = register_depth(plane.image(&depth_k), &depth_k, &pose, &color_k);
        let (worst, n) = compare(&got, plane, &depth_k, &pose, &color_k, 0.01);
        // Vertex w, three products and a quotient in f32; edge functions of coordinates near 1000 have an error of
        // 1e-4 px, which changes w by its slope of under 1e-3 per pixel.
        assert!(
            worst < 3e-6,
            "{}x{}: {worst:e}",
            color_k.width,
            color_k.height
        );
        assert!(n > color_k.n_pixels() / 3, "{n} pixels compared");
    }
}

/// A near half-plane before a far wall: the edge is exactly at the end of the near pixels' footprints, and the
/// uncovered area is invalid.
#[test]
fn a_step_edge_stays_sharp_and_uncovers_a_hole_of_the_right_width() {
    let k = camera([500.0, 500.0, 159.5, 119.5], 320, 240);
    let (near, far) = (1.0f32, 2.0f32);
    let edge_px = 160; // First far pixel.
    let z = (0..k.n_pixels()).map(|i| {
        if (i as u32 % 320) < edge_px {
            near
        } else {
            far
        }
    });
    let depth = DepthImage::from_metres(320, 240, z.collect());
    // The colour camera is 20.2 mm to the right: the near plane moves left by 10.1 px, the far one by 5.05.
    let pose = Pose {
        rotation: DQuat::IDENTITY,
        translation: DVec3::new(-0.0202, 0.0, 0.0),
    };
    let got = register_depth(depth, &k, &pose, &k);
    let row = &got.z_m[120 * 320..121 * 320];
    let last_near = row.iter().rposition(|&z| (z - near).abs() < 1e-5).unwrap();
    let first_far = row.iter().position(|&z| (z - far).abs() < 1e-5).unwrap();
    // Footprints end at 159.5: the near plane ends at 149.4, the far one begins at 154.45.
    assert_eq!((last_near, first_far), (149, 155));
    assert!(
        row[150..155].iter().all(|z| z.is_nan()),
        "{:?}",
        &row[145..160]
    );
    // Seen from the left, the near plane covers the far one and nothing is uncovered at the edge.
    let pose = Pose {
        rotation: DQuat::IDENTITY,
        translation: DVec3::new(0.0202, 0.0, 0.0),
    };
    let z = (0..k.n_pixels()).map(|i| {
        if (i as u32 % 320) < edge_px {
            near
        } else {
            far
        }
    });
    let got = register_depth(
        DepthImage::from_metres(320, 240, z.collect()),
        &k,
        &pose,
        &k,
    );
    let row = &got.z_m[120 * 320..121 * 320];
    assert!(
        (row[169] - near).abs() < 1e-5 && (row[170] - far).abs() < 1e-5,
        "{:?}",
        &row[165..175]
    );
    assert!(row[12..].iter().all(|&z| is_valid_depth(z)));
}

#[test]
fn a_lone_pixel_covers_its_footprint() {
    let depth_k = camera([20.0, 20.0, 4.0, 4.0], 9, 9);
    let color_k = depth_k.scaled_to(90, 90).unwrap();
    let mut z = vec![0.0; 81];
    z[4 * 9 + 4] = 2.0;
    let got = register_depth(
        DepthImage::from_metres(9, 9, z),
        &depth_k,
        &Pose::IDENTITY,
        &color_k,
    );
    let covered: Vec<usize> = (0..90 * 90)
        .filter(|&i| is_valid_depth(got.z_m[i]))
        .collect();
    assert_eq!(covered.len(), 100);
    assert!(
        covered
            .iter()
            .all(|i| (40..50).contains(&(i % 90)) && (40..50).contains(&(i / 90)))
    );
    assert!(covered.iter().all(|&i| (got.z_m[i] - 2.0).abs() < 1e-6));
}

#[test]
fn odd_sizes_and_hostile_cameras_return() {
    let one = camera([1.0, 1.0, 0.0, 0.0], 1, 1);
    let got = register_depth(
        DepthImage::from_metres(1, 1, vec![1.0]),
        &one,
        &Pose::IDENTITY,
        &camera([3.0, 3.0, 1.0, 1.0], 3, 3),
    );
    assert_eq!(got.z_m.iter().filter(|z| is_valid_depth(**z)).count(), 9);
    let wide = camera([1e-3, 1e9, -1e6, 1e6], 7, 5);
    let plain = camera(VGA, 640, 480);
    let tall = camera(VGA, 5, 7);
    let behind = Pose {
        rotation: DQuat::from_rotation_y(3.0),
        translation: DVec3::new(1e9, 0.0, -1.0),
    };
    for (from, to) in [
        (&wide, &plain),
        (&plain, &wide),
        (&tall, &wide),
        (&wide, &tall),
    ] {
        for pose in [Pose::IDENTITY, beside(), behind] {
            let depth =
                DepthImage::from_metres(from.width, from.height, vec![1.0; from.n_pixels()]);
            let got = register_depth(depth, from, &pose, to);
            assert_eq!(got.z_m.len(), to.n_pixels());
        }
    }
}

/// Prints the time of a registration of Kinect size; use `--release`.
#[test]
fn timing_of_a_kinect_frame() {
    let (from, to) = (
        camera(VGA, 640, 480),
        camera([527.0, 529.5, 321.3, 238.8], 640, 480),
    );
    // Uneven depth with holes and steps, as in scans of rooms.
    let z = (0..from.n_pixels()).map(|i| {
        let (x, y) = (i % 640, i / 640);
        let noise = crate::numerics::uniform(i as u32, 0, 0);
        let hole = crate::numerics::uniform((x / 32 + y / 32 * 20) as u32, 1, 0) < 0.1;
        let step = if (x / 80 + y / 60) % 3 == 0 { 0.4 } else { 0.0 };
        if hole {
            0.0
        } else {
            1.5 + step + 0.004 * noise
        }
    });
    let depth = DepthImage::from_metres(640, 480, z.collect());
    let mut times: Vec<f64> = (0..9)
        .map(|_| {
            let input = depth.clone();
            let start = std::time::Instant::now();
            let out = register_depth(input, &from, &beside(), &to);
            assert!(out.invalid_share() < 0.5);
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!(
        "registration of 640x480 to 640x480: median {:.2} ms, least {:.2} ms",
        times[4], times[0]
    );
}

#[test]
fn the_outcome_is_the_same_on_any_number_of_threads() {
    let (from, to) = (camera(VGA, 160, 120), camera(VGA, 160, 120));
    let z = (0..from.n_pixels()).map(|i| 1.0 + crate::numerics::uniform(i as u32, 0, 0));
    let depth = DepthImage::from_metres(160, 120, z.collect());
    let outcome = |n: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(n)
            .build()
            .unwrap();
        let out = pool.install(|| register_depth(depth.clone(), &from, &beside(), &to));
        out.z_m.iter().map(|z| z.to_bits()).collect::<Vec<_>>()
    };
    let one = outcome(1);
    assert_eq!(outcome(2), one);
    assert_eq!(outcome(5), one);
}
