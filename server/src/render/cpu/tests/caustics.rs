//! Tests of photons against closed forms, and of invariants.

use std::f64::consts::PI;

use glam::{DQuat, DVec3, Vec3};

use super::*;
use crate::render::{AmbientSettings, CausticSettings};

fn caustics(photons: u32, radius_m: f32) -> RenderSettings {
    RenderSettings {
        caustics: CausticSettings {
            enabled: Some(true),
            photons,
            radius_m,
        },
        // Photons alone; ambient light has its own tests.
        ambient: AmbientSettings {
            enabled: false,
            ..AmbientSettings::default()
        },
        ..plain()
    }
}

/// A square of two triangles over (-1, 1)^2 that faces -z.
fn sheet() -> Mesh {
    Mesh {
        positions: vec![
            Vec3::new(-1.0, -1.0, 0.0),
            Vec3::new(1.0, -1.0, 0.0),
            Vec3::new(1.0, 1.0, 0.0),
            Vec3::new(-1.0, 1.0, 0.0),
        ],
        triangles: vec![[0, 2, 1], [0, 3, 2]],
        ..Mesh::default()
    }
}

/// Turns object `i` into a square of side `2 half` that faces `normal`.
fn flatten(scene: &mut Scene, i: usize, half: f64, normal: DVec3) {
    if scene.meshes.len() == 1 {
        scene.meshes.push(Arc::new(sheet()));
    }
    let instance = &mut scene.instances[i];
    instance.mesh = 1;
    instance.world_from_object = DAffine3::from_scale_rotation_translation(
        DVec3::splat(half),
        DQuat::from_rotation_arc(-DVec3::Z, normal),
        instance.world_from_object.translation,
    );
}

fn rendered(
    scene: &Scene,
    frame: &RgbdFrame,
    settings: &RenderSettings,
) -> (CpuRenderer, Rendered) {
    let mut renderer = renderer_of(scene, 1);
    let out = renderer
        .render(frame, settings, &Aov::ALL, &Uninterrupted)
        .unwrap();
    (renderer, out)
}

const LEVEL: u8 = 100;

/// A mirror, at the left of the picture or outside of it, that reflects a point light onto the wall.
struct Image {
    light: DVec3,
    intensity: f64,
    mirror: DVec3,
    half: f64,
    normal: DVec3,
}

impl Image {
    fn new() -> Self {
        let (light, mirror) = (DVec3::new(0.3, 0.0, 0.8), DVec3::new(-0.9, 0.0, 1.2));
        let towards = |p: DVec3| (p - mirror).normalize_or_zero();
        Self {
            light,
            intensity: 2.0,
            mirror,
            half: 0.2,
            // Half way between the directions to the light and to the wall's centre.
            normal: (towards(light) + towards(DVec3::new(0.1, 0.0, 2.0))).normalize_or_zero(),
        }
    }

    fn lights(&self) -> Vec<Light> {
        vec![point_light(self.light, self.intensity as f32)]
    }

    /// Irradiance of the mirrored light on the wall at `p`; `None` within `margin` metres of the edge of the
    /// mirror's reflection.
    fn irradiance(&self, p: DVec3, margin: f64) -> Option<f64> {
        let image = self.light - self.normal * (2.0 * (self.light - self.mirror).dot(self.normal));
        let way = p - image;
        let t = (self.mirror - image).dot(self.normal) / way.dot(self.normal);
        let turn = DQuat::from_rotation_arc(-DVec3::Z, self.normal);
        let off = image + way * t - self.mirror;
        let from_edge = [DVec3::X, DVec3::Y].map(|axis| self.half - off.dot(turn * axis).abs());
        let inside = from_edge[0].min(from_edge[1]);
        // The mirror is tilted against the wall: a metre on the wall is at most this far on the mirror.
        let margin = margin * t / (way.normalize_or_zero().dot(self.normal)).abs();
        if inside.abs() < margin {
            return None;
        }
        let e = self.intensity * way.z / way.length().powi(3);
        Some(if inside > 0.0 { e } else { 0.0 })
    }

    /// Real irradiance of the wall: a uniform environment of [`LEVEL`], and the lamp.
    fn real(&self, p: DVec3) -> f64 {
        let to = self.light - p;
        PI * f64::from(linear_from_srgb(LEVEL)) - self.intensity * to.z / to.length().powi(3)
    }

    /// Relative standard error of independent photons under a kernel: the integral of its square is 4 / (3 pi
    /// r^2). Stratified photons have less.
    fn sigma(renderer: &CpuRenderer, e: f64, radius: f64) -> f64 {
        let buffers = renderer.buffers.last();
        let photons = buffers.photons.map().ghost_photons();
        let largest = photons.map(|p| p.flux.x.abs()).fold(0.0, f32::max);
        (4.0 * f64::from(largest) / (3.0 * PI * radius * radius * e)).sqrt()
    }

    /// Compares the light that a frame adds to the wall with `sign` times the mirrored irradiance.
    fn check(&self, renderer: &CpuRenderer, frame: &RgbdFrame, radius: f64, sign: f64) {
        let (mut inside, mut outside) = (0, 0);
        let share_at = |x, y| {
            let buffers = renderer.buffers.last();
            let found = buffers.grid.locate(x, y);
            found.map_or(1.0, |(tile, place)| {
                f64::from(buffers.lit[tile].light[place].ghost.x)
            })
        };
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let p = frame.intrinsics.unproject(f64::from(x), f64::from(y), 2.0);
                let Some(e) = self.irradiance(p, radius) else {
                    continue;
                };
                let share = share_at(x, y);
                if e == 0.0 {
                    outside += u32::from((x, y) != (0, 0));
                    if sign > 0.0 {
                        assert_eq!(share, 1.0, "{x} {y}");
                    }
                    continue;
                }
                inside += 1;
                let got = (share - 1.0) * self.real(p);
                let sigma = Self::sigma(renderer, e, radius);
                // Plus 2e-3 of the spherical harmonics of a uniform environment.
                assert!(
                    (got / (sign * e) - 1.0).abs() < 4.0 * sigma + 4e-3,
                    "{x} {y}: {got} against {e}, sigma {sigma}"
                );
            }
        }
        assert!(inside > 300 && outside > 1000, "{inside} {outside}");
    }
}

#[test]
fn a_flat_mirror_lights_the_wall_like_the_light_behind_it() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let image = Image::new();
    let mut scene = scene(&[(image.mirror, 1.0, mirror(), false)], image.lights());
    flatten(&mut scene, 0, image.half, image.normal);
    let radius = 0.04;
    let mut settings = caustics(400_000, radius);
    for method in [ShadowMethod::AdaptiveNeighbours, ShadowMethod::Off] {
        settings.shadows.method = method;
        let (renderer, out) = rendered(&scene, &frame, &settings);
        image.check(&renderer, &frame, f64::from(radius), 1.0);
        assert!(out.stats.photons > 300_000 && out.stats.photons_stored > 100_000);
    }
}

/// Light reflected by a modelled real mirror is in the camera's picture already. Nothing changes until a virtual
/// object blocks it.
#[test]
fn a_real_mirrors_light_is_taken_away_and_never_added() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let image = Image::new();
    let settings = caustics(400_000, 0.04);
    let real = (image.mirror, 1.0, mirror(), true);
    let elsewhere = (DVec3::new(0.9, 0.9, 1.0), 0.05, Material::default(), false);
    let mut alone = scene(&[real.clone(), elsewhere], image.lights());
    flatten(&mut alone, 0, image.half, image.normal);
    let (renderer, out) = rendered(&alone, &frame, &settings);
    assert!(out.stats.photons > 300_000);
    assert_eq!(
        renderer
            .buffers
            .last()
            .photons
            .map()
            .ghost_photons()
            .count(),
        0
    );

    let between = image.light.lerp(image.mirror, 0.3);
    let blocker = (between, 0.15, Material::default(), false);
    let mut blocked = scene(&[real, blocker], image.lights());
    flatten(&mut blocked, 0, image.half, image.normal);
    let (renderer, _) = rendered(&blocked, &frame, &settings);
    image.check(
        &renderer,
        &frame,
        f64::from(settings.caustics.radius_m),
        -1.0,
    );
}

/// The flux from a square mirror is its solid angle of the light times its reflectance: no photons are lost
/// between emission, Russian roulette and map.
#[test]
fn stored_flux_is_what_the_mirror_catches() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let material = Material {
        base_color: Vec3::splat(0.7),
        ..mirror()
    };
    let (half, distance, intensity) = (0.15, 0.5, 3.0);
    let light = vec![point_light(DVec3::new(0.0, 0.0, 1.0), intensity)];
    let mut scene = scene(&[(DVec3::new(0.0, 0.0, 0.5), 1.0, material, false)], light);
    flatten(&mut scene, 0, half, DVec3::Z);
    let photons = 100_000;
    let (renderer, _) = rendered(&scene, &frame, &caustics(photons, 0.01));
    let buffers = renderer.buffers.last();
    let (got, n) = buffers
        .photons
        .map()
        .ghost_photons()
        .fold((0.0, 0u32), |(sum, n), photon| {
            (sum + f64::from(photon.flux.x), n + 1)
        });
    let (h2, d2) = (half * half, distance * distance);
    let solid_angle = 4.0 * (h2 / (h2 + d2)).asin();
    // Schlick's term is under 1e-4 up to the 23 degrees at the corners.
    let expected = f64::from(intensity) * solid_angle * 0.7;
    // Independent photons: each hits or misses, and is reflected or not.
    let sigma = (1.0 / f64::from(n)).sqrt();
    assert!(
        (got / expected - 1.0).abs() < 4.0 * sigma,
        "{got} against {expected}, sigma {sigma}"
    );
}

/// A glass sphere in parallel light with the wall at its paraxial focus. By Snell's law, light at height b
/// arrives at a known height, so a circle contains the light that entered below a certain b.
#[test]
fn a_glass_ball_focuses_where_snell_says() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let (radius, ior, e) = (0.2, 1.5, 2.0);
    // n r / (2 (n - 1)) behind the centre.
    let focal = ior * radius / (2.0 * (ior - 1.0));
    let light = vec![Light::Directional {
        direction: DVec3::Z,
        angular_radius_rad: 0.0,
        irradiance: Vec3::splat(e),
    }];
    let center = DVec3::new(0.0, 0.0, 2.0 - focal);
    let scene = scene(&[(center, radius, glass(), false)], light);
    let (renderer, _) = rendered(&scene, &frame, &caustics(200_000, 0.01));
    // Height on the wall, and the share transmitted by both surfaces.
    let arrival = |b: f64, radius: f64| {
        let (inward, refracted) = ((b / radius).asin(), (b / (ior * radius)).asin());
        let turn = 2.0 * (inward - refracted);
        // It leaves at an angle of 2 refracted - inward, towards and past the axis.
        let out = 2.0 * refracted - inward;
        let (y, z) = (radius * out.sin(), radius * out.cos());
        let height = y - (focal - z) * turn.tan();
        // Fresnel's sine and tangent laws; the rays of the rings do not hit the sphere at normal incidence.
        let (sum, difference) = (inward + refracted, inward - refracted);
        let (across, along) = (difference.sin() / sum.sin(), difference.tan() / sum.tan());
        let passes = 1.0 - 0.5 * (across * across + along * along);
        (height.abs(), passes * passes)
    };
    let within = |circle: f64, radius: f64| {
        let steps = 4000;
        let step = 0.9 * radius / f64::from(steps);
        let ring = |i: u32| {
            let b = (f64::from(i) + 0.5) * step;
            let (height, passes) = arrival(b, radius);
            if height < circle {
                f64::from(e) * passes * 2.0 * PI * b * step
            } else {
                0.0
            }
        };
        (0..steps).map(ring).sum::<f64>()
    };
    for circle in [0.01, 0.02, 0.04] {
        let (mut got, mut n) = (0.0, 0u32);
        for photon in renderer.buffers.last().photons.map().ghost_photons() {
            if f64::from(photon.position.truncate().length()) < circle {
                got += f64::from(photon.flux.x);
                n += 1;
            }
        }
        // The mesh is inside its sphere by up to 1 % of the radius; four standard errors; and light reflected
        // twice inside, at most the square of the 4 % at normal incidence.
        let error = 4.0 / f64::from(n).sqrt() + 2e-3;
        let sizes = [0.98, 0.99, 1.0].map(|size| within(circle, radius * size));
        let low = sizes.into_iter().fold(f64::INFINITY, f64::min) * (1.0 - error);
        let high = sizes.into_iter().fold(0.0, f64::max) * (1.0 + error);
        assert!(
            n > 5000 && (low..high).contains(&got),
            "{circle}: {low} {got} {high}"
        );
    }
}

/// A matte surface in front of the wall receives the light of
/// [`a_flat_mirror_lights_the_wall_like_the_light_behind_it`] in its place: its colour is albedo times irradiance
/// over pi, and no light passes it.
#[test]
fn virtual_surfaces_show_photons_too() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let image = Image::new();
    let albedo = 0.4;
    let matte = Material {
        base_color: Vec3::splat(albedo),
        ior: 1.0,
        ..Material::default()
    };
    let plane = 1.9;
    let objects = [
        (image.mirror, 1.0, mirror(), false),
        (DVec3::new(0.0, 0.0, plane), 1.0, matte, false),
    ];
    let mut scene = scene(&objects, image.lights());
    flatten(&mut scene, 0, image.half, image.normal);
    flatten(&mut scene, 1, 0.75, -DVec3::Z);
    let radius = 0.03;
    let (renderer, out) = rendered(&scene, &frame, &caustics(400_000, radius));
    let buffers = renderer.buffers.last();
    assert_eq!(buffers.photons.map().ghost_photons().count(), 0);
    let largest = buffers.photons.map().mesh_photons();
    let largest = largest.iter().map(|p| p.flux.x).fold(0.0, f32::max);
    let mut lit = 0;
    for y in 12..HEIGHT - 12 {
        for x in 30..WIDTH - 30 {
            let p = frame
                .intrinsics
                .unproject(f64::from(x), f64::from(y), plane);
            let Some(e) = image.irradiance(p, f64::from(radius)) else {
                continue;
            };
            let sigma =
                (4.0 * f64::from(largest) * e / (3.0 * PI * f64::from(radius).powi(2))).sqrt();
            lit += u32::from(e > 0.0);
            let shown = |e: f64| {
                let l = f64::from(albedo) / PI * (image.real(p) + e);
                srgb_from_linear(l as f32)
            };
            let error = 4.0 * sigma + 4e-3 * image.real(p);
            let range = shown(e - error).saturating_sub(1)..=shown(e + error).saturating_add(1);
            let got = out.color.rgba[at(x, y)][0];
            assert!(range.contains(&got), "{x} {y}: {got}, expected {range:?}");
        }
    }
    assert!(lit > 300, "{lit}");
}

#[test]
fn what_is_not_specular_makes_no_photons() {
    let frame = noise();
    let plastic = Material {
        roughness: 0.2,
        ..Material::default()
    };
    let rough = Material {
        roughness: 0.7,
        metallic: 1.0,
        ..Material::default()
    };
    for material in [Material::default(), plastic, rough] {
        let object = (DVec3::new(0.0, 0.1, 1.6), 0.3, material, false);
        let scene = scene(
            &[object],
            vec![point_light(DVec3::new(0.4, -0.8, 0.6), 1.0)],
        );
        let asked = caustics(10_000, 0.01);
        let without = RenderSettings {
            caustics: plain().caustics,
            ..asked
        };
        let off = render(&scene, &frame, &without, 1);
        let on = render(&scene, &frame, &asked, 1);
        assert_eq!(on.stats.photons, 0);
        assert_eq!((on.color, on.aovs), (off.color, off.aovs));
    }
    let unlit = scene(&[(DVec3::Z, 0.3, mirror(), false)], vec![]);
    let none = scene(&[], vec![point_light(DVec3::ZERO, 1.0)]);
    for scene in [unlit, none] {
        let on = render(&scene, &frame, &caustics(10_000, 0.01), 1);
        assert_eq!(on.stats.photons, 0);
    }
}

/// In the shadow of glass there is the light of its photons and no other; the reference sums all photons for
/// every pixel.
#[test]
fn glass_blocks_light_that_comes_as_photons() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let (lamp, center, radius) = (DVec3::new(-0.6, 0.0, 0.5), DVec3::new(-0.1, 0.0, 1.3), 0.1);
    let scene = scene(
        &[(center, radius, glass(), false)],
        vec![point_light(lamp, 2.0)],
    );
    let (renderer, _) = rendered(&scene, &frame, &caustics(5000, 0.02));
    let buffers = renderer.buffers.last();
    let ambient = PI * f64::from(linear_from_srgb(LEVEL));
    let (mut dark, mut lit) = (0, 0);
    for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
        let p = frame.intrinsics.unproject(f64::from(x), f64::from(y), 2.0);
        let to = lamp - p;
        // The mesh is inside its sphere by up to 1 % of the radius.
        if (center - p).cross(to).length() / to.length() > 0.98 * radius {
            continue;
        }
        let e = -2.0 * to.z / to.length().powi(3);
        // A pixel is 14 mm wide, so the kernel has the requested radius.
        let photons: f64 = buffers
            .photons
            .map()
            .ghost_photons()
            .map(|photon| {
                let d2 = photon.position.as_dvec3().distance_squared(p) / 0.02f64.powi(2);
                f64::from(photon.flux.x) * 2.0 / (PI * 0.02f64.powi(2)) * (1.0 - d2).max(0.0)
            })
            .sum();
        let (tile, place) = buffers.grid.locate(x, y).unwrap();
        let share = f64::from(buffers.lit[tile].light[place].ghost.x);
        let expected = (ambient + photons) / (ambient + e);
        // The error of the spherical harmonics of a uniform environment, and of photons that make less than a
        // quarter of a code.
        let step = linear_from_srgb(LEVEL + 1) - linear_from_srgb(LEVEL);
        let unseen = 0.25 * PI * f64::from(step) / (ambient + e);
        assert!(
            (share - expected).abs() < 4e-3 * expected + unseen,
            "{x} {y}: {share} {expected}"
        );
        dark += 1;
        lit += u32::from(photons > 0.0);
    }
    assert!(dark > 300 && lit > 100, "{dark} {lit}");
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_in_any_order_of_frames() {
    let objects = [
        (DVec3::new(-0.1, 0.1, 1.6), 0.25, mirror(), false),
        (DVec3::new(0.3, 0.1, 1.4), 0.15, glass(), false),
        (DVec3::new(0.1, 0.4, 1.7), 0.2, Material::default(), false),
        (DVec3::new(-0.5, 0.1, 1.8), 0.2, mirror(), true),
    ];
    let lamp = Light::Sphere {
        position: DVec3::new(0.4, -0.8, 0.6),
        radius_m: 0.1,
        intensity: Vec3::ONE,
    };
    let sun = Light::Directional {
        direction: DVec3::new(0.1, 0.6, 0.8).normalize_or_zero(),
        angular_radius_rad: 0.01,
        irradiance: Vec3::splat(0.5),
    };
    let scene = scene(&objects, vec![lamp, sun]);
    let frame = noise();
    let settings = caustics(20_000, 0.02);
    let one = render(&scene, &frame, &settings, 1);
    assert!(one.stats.photons_stored > 1000);
    for threads in [2, 5] {
        let other = render(&scene, &frame, &settings, threads);
        assert_eq!((&one.color, &one.aovs), (&other.color, &other.aovs));
        assert_eq!(one.stats, other.stats);
    }
    let off = render(&scene, &frame, &plain(), 1);
    let mut again = renderer_of(&scene, 2);
    let more = caustics(50_000, 0.03);
    for (settings, expected) in [
        (&settings, Some(&one)),
        (&more, None),
        (&settings, Some(&one)),
        (&plain(), Some(&off)),
        (&settings, Some(&one)),
    ] {
        let out = again.render(&frame, settings, &[], &Uninterrupted).unwrap();
        if let Some(expected) = expected {
            assert_eq!(
                out.color, expected.color,
                "buffers must not leak between frames"
            );
        }
    }
}

/// Lights and generators at singularities of the formulas: no more light than is emitted, and every pixel finite.
#[test]
fn hard_cases_stay_within_what_the_light_emits() {
    let frame = wall([LEVEL, LEVEL, LEVEL, 255]);
    let center = DVec3::new(0.0, 0.0, 1.5);
    for material in [mirror(), glass()] {
        for (size, offset, light_radius) in [
            // Inside, exactly in the centre, touching from inside and outside, around the generator.
            (0.2, DVec3::X * 0.1, 0.0),
            (0.2, DVec3::ZERO, 0.05),
            (0.2, DVec3::ZERO, 0.0),
            (0.2, DVec3::X * 0.2, 0.0),
            (0.2, DVec3::X * 0.25, 0.05),
            (0.2, DVec3::X * 0.22, 0.05),
            (0.2, DVec3::ZERO, 0.5),
            // Of zero or almost zero size; behind the wall.
            (0.0, DVec3::X * 0.3, 0.1),
            (1e-6, DVec3::X * 0.3, 0.1),
            (0.2, DVec3::Z * 3.0, 0.1),
        ] {
            let lamp = Light::Sphere {
                position: center + offset,
                radius_m: light_radius,
                intensity: Vec3::ONE,
            };
            let object = (center, size, material.clone(), false);
            let scene = scene(&[object], vec![lamp]);
            let (renderer, out) = rendered(&scene, &frame, &caustics(20_000, 0.01));
            let buffers = renderer.buffers.last();
            let photons = || buffers.photons.map().ghost_photons();
            assert!(photons().all(|p| p.flux.is_finite() && p.position.is_finite()));
            let stored: f64 = photons().map(|p| f64::from(p.flux.x)).sum();
            let what = format!("{size} {offset} {light_radius}: {stored}");
            // Four standard errors of 20,000 photons that hit or miss.
            assert!(
                stored <= 4.0 * PI * (1.0 + 4.0 / 20_000f64.sqrt()),
                "{what}"
            );
            assert!(
                size > 0.0 || (stored == 0.0 && out.stats.photons == 0),
                "{what}"
            );
            let shares = buffers.lit.iter().flat_map(|tile| tile.light.iter());
            assert!(
                shares.into_iter().all(|light| light.ghost.is_finite()),
                "{what}"
            );
        }
    }
}
