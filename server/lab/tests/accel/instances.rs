//! Instances: transforms, masks, filters, many of them, and frames that reuse memory.

use std::sync::Arc;

use fearless_simd::Level;
use glam::{Affine3A, Quat, Vec3, Vec3A};

use super::{blas, check_kernels, levels, packet, placed, tlas};
use ghostlight::accel::{
    Hit, HitPacket, MASK_GHOST, MASK_VIRTUAL, NO_HIT, Ray, Tlas, TlasInstance,
};
use ghostlight::numerics::gamma;
use ghostlight_lab::hard::shapes::{Dice, aimed, icosphere, mesh};

#[test]
fn barycentrics_belong_to_vertices_1_and_2() {
    let mesh = mesh(vec![Vec3::ZERO, Vec3::X, Vec3::Y], vec![[0, 1, 2]]);
    let at = Affine3A::from_scale(Vec3::new(-2.0, 2.0, 2.0));
    for level in levels() {
        let tlas = tlas(level, &[placed(&blas(&mesh), at)]);
        let target = at.transform_point3a(Vec3A::new(0.25, 0.5, 0.0));
        let ray = aimed(Vec3A::new(0.5, 0.0, -4.0), target);
        let hit = tlas.intersect(&ray, 1).unwrap();
        assert!(
            (hit.u - 0.25).abs() < gamma(40) && (hit.v - 0.5).abs() < gamma(40),
            "{hit:?}"
        );
        check_kernels(&tlas, &[ray], &[Some(hit)]);
    }
}

#[test]
fn masks_choose_instances() {
    let shared = blas(&icosphere(1));
    let near = TlasInstance {
        mask: MASK_GHOST,
        ..placed(&shared, Affine3A::from_translation(Vec3::Z * 3.0))
    };
    let far = placed(&shared, Affine3A::from_translation(Vec3::Z * 6.0));
    for level in levels() {
        let tlas = tlas(level, &[near.clone(), far.clone()]);
        let ray = aimed(Vec3A::ZERO, Vec3A::Z);
        let (rays, active) = packet(&[ray; 16]);
        for (mask, expected) in [
            (MASK_GHOST, Some(0)),
            (MASK_VIRTUAL, Some(1)),
            (MASK_GHOST | MASK_VIRTUAL, Some(0)),
            (4, None),
        ] {
            assert_eq!(tlas.intersect(&ray, mask).map(|h| h.instance), expected);
            assert_eq!(
                tlas.intersect_scalar(&ray, mask).map(|h| h.instance),
                expected
            );
            assert_eq!(tlas.occluded(&ray, mask), expected.is_some());
            let mut hits = HitPacket::default();
            tlas.intersect_packet(&rays, active, mask, &mut hits);
            assert_eq!(hits.instance, [expected.unwrap_or(NO_HIT); 16]);
            let occluded = tlas.occluded_packet(&rays, active, mask);
            assert_eq!(occluded, if expected.is_some() { u16::MAX } else { 0 });
        }
    }
}

#[test]
fn inactive_lanes_report_nothing() {
    for level in levels() {
        let tlas = tlas(level, &[placed(&blas(&icosphere(1)), Affine3A::IDENTITY)]);
        let ray = aimed(Vec3A::Z * 3.0, Vec3A::ZERO);
        let (mut rays, _) = packet(&[ray; 16]);
        rays.origin[0][3] = f32::NAN;
        let active = 0b1010_0110_0000_0101;
        let mut hits = HitPacket {
            instance: [5; 16],
            ..HitPacket::default()
        };
        tlas.intersect_packet(&rays, active, 1, &mut hits);
        for lane in 0..16 {
            assert_eq!(
                hits.get(lane).is_some(),
                active >> lane & 1 != 0,
                "{level:?} {lane}"
            );
        }
        assert_eq!(tlas.occluded_packet(&rays, active, 1), active);
        assert_eq!(tlas.occluded_packet(&rays, 0, 1), 0);
        // Groups with all, some or none of a packet's lanes, and with inactive lanes.
        for n in [1, 2, 4, 5, 9] {
            let rays = vec![rays; n];
            let actives: Vec<u16> = (0..n)
                .map(|i| active.rotate_left(3 * i as u32) & !8 & if i == 1 { 0 } else { u16::MAX })
                .collect();
            let mut hits = vec![hits; n];
            tlas.intersect_packets(&rays, &actives, 1, &mut hits);
            for (hits, active) in hits.iter().zip(actives) {
                let found = (0..16).filter(|&lane| hits.get(lane).is_some());
                assert_eq!(found.fold(0, |all, lane| all | 1 << lane), active);
            }
        }
    }
}

#[test]
fn filters_are_asked_for_filtered_instances_only() {
    let shared = blas(&icosphere(3));
    let masked = TlasInstance {
        filtered: true,
        ..placed(&shared, Affine3A::from_translation(Vec3::Z * 3.0))
    };
    let solid = placed(&shared, Affine3A::from_translation(Vec3::Z * 6.0));
    let mut dice = Dice(32, 0);
    let rays: Vec<Ray> = (0..320)
        .map(|_| aimed(Vec3A::ZERO, Vec3A::Z * 3.0 + dice.direction() * 1.2))
        .collect();
    let opaque = |hit: &Hit| hit.instance != 0 || hit.triangle.is_multiple_of(3);
    for level in levels() {
        let tlas = tlas(level, &[masked.clone(), solid.clone()]);
        let (mut through, mut stopped) = (0, 0);
        let (packets, actives): (Vec<_>, Vec<_>) = rays.chunks(16).map(packet).unzip();
        let mut groups = vec![HitPacket::default(); packets.len()];
        // A ray from the origin is identified by its direction.
        let ask = |lane: usize, hit: &Hit| {
            let point = rays[lane].direction * hit.t;
            assert!(hit.instance == 0 && ((point - Vec3A::Z * 3.0).length() - 1.0).abs() < 0.05);
            opaque(hit)
        };
        tlas.intersect_packets_filtered(&packets, &actives, 1, &ask, &mut groups);
        for (chunk, group) in rays.chunks(16).zip(groups) {
            let (rays, active) = packet(chunk);
            let ask = |lane: usize, hit: &Hit| {
                assert!(lane < 16 && hit.instance == 0);
                opaque(hit)
            };
            let mut hits = HitPacket::default();
            tlas.intersect_packet_filtered(&rays, active, 1, &ask, &mut hits);
            let occluded = tlas.occluded_packet_filtered(&rays, active, 1, &ask);
            for (lane, ray) in chunk.iter().enumerate() {
                let expected = tlas.intersect_filtered_scalar(ray, 1, &opaque);
                assert_eq!(tlas.intersect_filtered(ray, 1, &opaque), expected);
                assert_eq!(hits.get(lane), expected);
                assert_eq!(group.get(lane), expected);
                assert_eq!(tlas.occluded_filtered(ray, 1, &opaque), expected.is_some());
                assert_eq!(occluded >> lane & 1 != 0, expected.is_some());
                assert!(expected.is_none_or(|h| opaque(&h)));
                // The queries without a filter treat it as solid.
                let plain = tlas.intersect(ray, 1);
                through += usize::from(plain != expected);
                stopped += usize::from(plain == expected && plain.is_some());
            }
        }
        assert!(through > 50 && stopped > 20, "{through} {stopped}");
    }
}

#[test]
fn an_instance_out_of_range_hides_no_other() {
    let shared = blas(&icosphere(1));
    // In its object space, directions are longer than the limit for rays.
    let scale = Affine3A::from_scale(Vec3::splat(1e-19));
    let tiny = placed(&shared, Affine3A::from_translation(Vec3::Z * 3.0) * scale);
    let behind = placed(&shared, Affine3A::from_translation(Vec3::Z * 6.0));
    for level in levels() {
        let tlas = tlas(level, &[tiny.clone(), behind.clone()]);
        let ray = aimed(Vec3A::ZERO, Vec3A::Z);
        let hit = tlas.intersect_scalar(&ray, 1);
        assert_eq!(hit.map(|hit| hit.instance), Some(1));
        check_kernels(&tlas, &[ray; 16], &[hit; 16]);
        let beside = Ray { t_max: 4.0, ..ray };
        check_kernels(&tlas, &[beside; 16], &[None; 16]);
    }
}

#[test]
fn bounds_hold_the_instance() {
    let at = Affine3A::from_scale_rotation_translation(
        Vec3::new(-2.0, 0.5, 1e-3),
        Quat::from_rotation_y(0.7),
        Vec3::new(10.0, -3.0, 2.0),
    );
    let mut shifted = icosphere(2);
    shifted
        .positions
        .iter_mut()
        .for_each(|p| *p += Vec3::splat(50.0));
    let tlas = tlas(Level::new(), &[placed(&blas(&shifted), at)]);
    let (low, high) = tlas.bounds(0).unwrap();
    for &p in &shifted.positions {
        let p = at.transform_point3a(p.into());
        // The transform's rounding error is relative to its terms, 100 and 25 m.
        let slack = Vec3A::splat(gamma(4) * 200.0);
        assert!((p + slack).cmpge(low).all() && (p - slack).cmple(high).all());
    }
}

#[test]
fn ten_thousand_instances_find_the_same_as_a_loop() {
    let shared = blas(&icosphere(0));
    let mut dice = Dice(33, 0);
    let instances: Vec<_> = (0..10_000)
        .map(|_| {
            let at = Vec3::new(dice.signed(), dice.signed(), dice.signed()) * 20.0;
            let turn = Quat::from_rotation_x(dice.unit());
            let scale = Vec3::splat(0.1 + 0.2 * dice.unit());
            placed(
                &shared,
                Affine3A::from_scale_rotation_translation(scale, turn, at),
            )
        })
        .collect();
    let all = tlas(Level::new(), &instances);
    let rays: Vec<Ray> = (0..160)
        .map(|_| aimed(dice.direction() * 30.0, dice.direction() * 10.0))
        .collect();
    // Four instances at a time, each traced by a plain loop; the nearest hit of all.
    let mut expected = vec![None::<Hit>; rays.len()];
    let mut few = Tlas::new();
    for (i, four) in instances.chunks(4).enumerate() {
        few.rebuild(four);
        for (best, ray) in expected.iter_mut().zip(&rays) {
            if let Some(mut hit) = few.intersect_scalar(ray, 1) {
                hit.instance += 4 * i as u32;
                if best.is_none_or(|b| hit.t < b.t) {
                    *best = Some(hit);
                }
            }
        }
    }
    assert!(expected.iter().flatten().count() > 50);
    check_kernels(&all, &rays, &expected);
}

#[test]
fn frames_are_rebuilt_in_place() {
    let shared = blas(&icosphere(1));
    let at = |z: f32| placed(&shared, Affine3A::from_translation(Vec3::Z * z));
    let mut tlas = Tlas::new();
    assert!(tlas.is_empty());
    let ray = aimed(Vec3A::ZERO, Vec3A::Z);
    check_kernels(&tlas, &[ray], &[None]);
    for z in [3.0, 5.0] {
        tlas.rebuild(&[at(z), at(9.0)]);
        assert_eq!(tlas.len(), 2);
        let hit = tlas.intersect(&ray, 1).unwrap();
        assert!(hit.t < z && hit.t > z - 1.0 - gamma(10) * z, "{hit:?}");
    }
    assert_eq!(Arc::strong_count(&shared), 3);
    tlas.rebuild(&[]);
    assert_eq!(
        (tlas.intersect(&ray, 1), Arc::strong_count(&shared)),
        (None, 1)
    );
}
