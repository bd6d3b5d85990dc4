//! Tests of materials against closed forms: furnace tests, and lamps of the same power and any size.

use super::*;

/// Mean and largest difference from a uniform environment, 8-bit steps, over the pixels that a sphere covers.
fn difference(material: &Material, settings: &RenderSettings) -> (f64, i32) {
    let level = 120;
    let frame = wall([level, level, level, 255]);
    let ball = [(DVec3::new(0.05, -0.03, 1.2), 0.3, material.clone(), false)];
    let out = render(&scene(&ball, vec![]), &frame, settings, 1);
    let mask = gray(&out, Aov::Mask);
    let pixels = mask.iter().zip(&out.color.rgba);
    let covered: Vec<i32> = pixels
        .filter(|&(&mask, _)| mask == 255)
        .map(|(_, pixel)| i32::from(pixel[1]) - i32::from(level))
        .collect();
    assert!(covered.len() > 2000);
    let sum: i32 = covered.iter().sum();
    let worst = *covered.iter().max_by_key(|d| d.abs()).unwrap();
    (f64::from(sum) / covered.len() as f64, worst)
}

/// Materials that reflect or transmit all light are invisible in a uniform environment, whatever their roughness
/// and index. Bounds are 8-bit steps at 120, where one is 1.9 % of the light.
#[test]
fn white_materials_vanish_in_a_furnace_at_any_roughness_and_index() {
    let settings = RenderSettings {
        glossy_samples: 32,
        max_bounces: 8,
        ..plain()
    };
    let mut wrong = Vec::new();
    let mut check = |what: &str, material: &Material, bound: f64| {
        let (mean, worst) = difference(material, &settings);
        eprintln!("{what}: mean {mean:.2}, worst {worst}");
        // At an outline, half of a lobe is below the surface: that pixel loses up to a quarter of its light, 13
        // steps. A rough thin surface has two such lobes, and 32 rays of them are noisy.
        let most = if material.thin { 40 } else { 20 };
        if mean.abs() > bound || worst.abs() > most {
            wrong.push(format!("{what}: mean {mean}, worst {worst}"));
        }
    };
    let white = Material {
        base_color: Vec3::ONE,
        ..Material::default()
    };
    for roughness in [0.0_f32, 0.1, 0.3, 0.55, 0.8, 1.0] {
        let metal = Material {
            metallic: 1.0,
            roughness,
            ..white.clone()
        };
        check(&format!("metal {roughness}"), &metal, 1.0);
        for ior in [1.1_f64, 1.5, 2.4] {
            // A share of the light that the boundary reflects is lost between microfacets, except for what is
            // reflected again: `f0 (1 - f0) 0.6 alpha`. An 8-bit step is 1 / 54 of the light here.
            let f0 = ((ior - 1.0) / (ior + 1.0)).powi(2);
            let alpha = f64::from(roughness * roughness);
            let lost = 54.0 * f0 * (1.0 - f0) * 0.6 * alpha;
            let dielectric = Material {
                roughness,
                ior: ior as f32,
                ..white.clone()
            };
            check(
                &format!("dielectric {roughness} {ior}"),
                &dielectric,
                1.0 + lost,
            );
        }
        let coated = Material {
            clearcoat: 1.0,
            clearcoat_roughness: 0.1,
            ..metal.clone()
        };
        check(&format!("coated metal {roughness}"), &coated, 2.0);
        let sheet = Material {
            transmission: 1.0,
            thin: true,
            roughness,
            ..white.clone()
        };
        check(&format!("sheet {roughness}"), &sheet, 3.0);
        // Rougher solid glass loses more: 2.2 steps at 0.3 and 17 at 0.55.
        if roughness <= 0.3 {
            let glass = Material {
                thin: false,
                ..sheet
            };
            check(&format!("glass {roughness}"), &glass, 3.0);
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// The total light of a lamp's highlight is the same for any size of the lamp: as long as the lamp is small
/// against its distance, its size only spreads the highlight.
#[test]
fn a_lamp_of_any_size_gives_the_same_highlight() {
    let mut wrong = Vec::new();
    for (metallic, roughness) in [(1.0, 0.1), (1.0, 0.15), (1.0, 0.3), (0.0, 0.2), (0.0, 0.5)] {
        let material = Material {
            base_color: Vec3::splat(if metallic > 0.0 { 1.0 } else { 0.0 }),
            metallic,
            roughness,
            ..Material::default()
        };
        let energy = |radius_m: f64| {
            let lamp = Light::Sphere {
                position: DVec3::new(-0.5, -0.8, 0.1),
                radius_m,
                intensity: Vec3::splat(0.2),
            };
            let ball = [(DVec3::new(0.0, 0.0, 1.2), 0.3, material.clone(), false)];
            let settings = RenderSettings {
                glossy_samples: 64,
                ..plain()
            };
            let scene = scene(&ball, vec![lamp]);
            let mut renderer = renderer_of(&scene, 1);
            // Enough resolution for the smallest highlight to be wider than a pixel.
            let (width, height) = (4 * WIDTH, 4 * HEIGHT);
            let n = (width * height) as usize;
            let frame = RgbdFrame {
                color: ColorImage::filled(width, height, [0, 0, 0, 255]),
                depth: DepthImage::from_metres(width, height, vec![2.0; n]),
                intrinsics: Intrinsics::new(560.0, 560.0, 319.5, 239.5, width, height).unwrap(),
                ..wall([0; 4])
            };
            renderer
                .render(&frame, &settings, &[], &Uninterrupted)
                .unwrap();
            let buffers = renderer.buffers.last();
            let tiles = buffers.shaded.iter();
            let light = tiles.flat_map(|tile| tile.virtual_light.iter());
            light.map(|light| f64::from(light.y)).sum::<f64>()
        };
        let small = energy(0.002);
        assert!(small > 0.0);
        for radius_m in [0.01, 0.03, 0.1] {
            let ratio = energy(radius_m) / small;
            eprintln!("metallic {metallic}, roughness {roughness}, {radius_m} m: {ratio:.4}");
            // Where rays see the lamp, because half its angle is larger than the lobe's width, the error of the
            // shading model is visible: it widens lobes, and uses the reflectance and shadowing at their centre.
            let by_rays =
                metallic > 0.0 && 0.5 * radius_m >= f64::from(roughness * roughness) * 1.2;
            if (ratio - 1.0).abs() > if by_rays { 0.04 } else { 0.02 } {
                wrong.push(format!(
                    "metallic {metallic}, roughness {roughness}, {radius_m} m: {ratio}"
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Neighbours that share the rays of a rough reflection need fewer of them for less error. The wall is black and
/// white, so most lobes see both.
#[test]
fn shared_reflections_have_less_error_with_fewer_rays() {
    let mut frame = wall([255; 4]);
    for (i, pixel) in frame.color.rgba.iter_mut().enumerate() {
        if i as u32 % WIDTH < WIDTH / 2 {
            *pixel = [0, 0, 0, 255];
        }
    }
    let metal = Material {
        base_color: Vec3::ONE,
        metallic: 1.0,
        roughness: 0.6,
        ..Material::default()
    };
    let ball = [(DVec3::new(0.05, -0.03, 1.0), 0.35, metal, false)];
    let scene = scene(&ball, vec![]);
    let with = |glossy_samples, glossy_sharing| {
        let settings = RenderSettings {
            glossy_samples,
            glossy_sharing,
            edge_samples: 1,
            ..plain()
        };
        render(&scene, &frame, &settings, 1)
    };
    let many = with(64, 0.0);
    let error = |out: &Rendered| {
        let pairs = out.color.rgba.iter().zip(&many.color.rgba);
        let squares: f64 = pairs
            .map(|(a, b)| f64::from(a[1].abs_diff(b[1])).powi(2))
            .sum();
        squares.sqrt()
    };
    let (alone, shared) = (
        with(8, 0.0),
        with(8, RenderSettings::default().glossy_sharing),
    );
    let (before, now) = (error(&alone), error(&shared));
    // If all 25 pixels of a window shared, the rays would fall by 5 and the error by 25^(1/4), to 0.45. Pixels at
    // outlines have fewer neighbours, and the reference has an error of its own, sqrt(8 / 64) of that of 8 rays.
    assert!(now < 0.7 * before, "{now} {before}");
    let rays = (shared.stats.secondary_rays, alone.stats.secondary_rays);
    assert!(2 * rays.0 < rays.1, "{rays:?}");
}
