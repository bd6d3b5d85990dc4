//! Ray kernels on meshes: every instruction set against scalar code, and f32 against f64.

use std::sync::Arc;

use anyhow::Result;
use fearless_simd::Level;
use rayon::prelude::*;

use super::mesh_rays::{packets, placed, placement, primary, shadow_and_bounce};
use super::{Bound, Curve, Lab, Section, median, number, quantile, take_turns};
use crate::oracle::triangles::{OracleInstance, any, closest};
use ghostlight::accel::{Blas, BuildLimits, Hit, HitPacket, MASK_VIRTUAL, Ray, RayPacket, Tlas};
use ghostlight::numerics::gamma;
use ghostlight::scene::Mesh;
use ghostlight::shapes::ripples;

/// Every instruction set of this machine, the best first.
fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = Vec::new();
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_avx512().map(Level::Avx512));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
    }
    #[cfg(not(target_arch = "x86_64"))]
    levels.push(best);
    levels.push(Level::fallback());
    levels
}

fn name_of(level: Level) -> String {
    let name = format!("{level:?}");
    name.split('(').next().unwrap_or_default().to_lowercase()
}

/// The results of a kernel, one per ray.
type Found = Vec<Option<Hit>>;

/// A function that traces a set of rays.
struct Kernel<'a> {
    series: String,
    form: &'static str,
    run: Box<dyn Fn() -> Found + 'a>,
}

/// The result of an occlusion query in the form of a hit: its fields mean nothing.
const SOME: Hit = Hit {
    t: 0.0,
    instance: 0,
    triangle: 0,
    u: 0.0,
    v: 0.0,
};

fn kernels<'a>(
    tlases: &'a [Tlas],
    rays: &'a [Ray],
    packets: &'a [(RayPacket, u16)],
    shadow: bool,
) -> Vec<Kernel<'a>> {
    let mut kernels = Vec::new();
    for tlas in tlases {
        let series = name_of(tlas.level());
        kernels.push(Kernel {
            series: series.clone(),
            form: "packets of 16",
            run: Box::new(move || in_packets(tlas, packets, rays.len(), shadow)),
        });
        if !shadow {
            let (rays, active): (Vec<_>, Vec<_>) = packets.iter().copied().unzip();
            kernels.push(Kernel {
                series: series.clone(),
                form: "groups of packets",
                run: Box::new(move || in_groups(tlas, &rays, &active)),
            });
        }
        kernels.push(Kernel {
            series,
            form: "single ray, 8 wide",
            run: Box::new(move || {
                let one = |ray| match shadow {
                    true => tlas.occluded(ray, MASK_VIRTUAL).then_some(SOME),
                    false => tlas.intersect(ray, MASK_VIRTUAL),
                };
                rays.iter().map(one).collect()
            }),
        });
    }
    let tlas = &tlases[0];
    kernels.push(Kernel {
        series: "scalar".to_owned(),
        form: "single ray, plain code",
        run: Box::new(move || {
            let one = |ray| match shadow {
                true => tlas.occluded_scalar(ray, MASK_VIRTUAL).then_some(SOME),
                false => tlas.intersect_scalar(ray, MASK_VIRTUAL),
            };
            rays.iter().map(one).collect()
        }),
    });
    kernels
}

fn in_packets(tlas: &Tlas, packets: &[(RayPacket, u16)], n: usize, shadow: bool) -> Found {
    let mut found = Vec::with_capacity(n);
    let mut hits = HitPacket::default();
    for (packet, active) in packets {
        let lanes = active.count_ones() as usize;
        if shadow {
            let blocked = tlas.occluded_packet(packet, *active, MASK_VIRTUAL);
            found.extend((0..lanes).map(|lane| (blocked >> lane & 1 != 0).then_some(SOME)));
        } else {
            tlas.intersect_packet(packet, *active, MASK_VIRTUAL, &mut hits);
            found.extend((0..lanes).map(|lane| hits.get(lane)));
        }
    }
    found
}

/// Traces four packets at a time, like the primary rays of a tile.
fn in_groups(tlas: &Tlas, rays: &[RayPacket], active: &[u16]) -> Found {
    let mut found = Vec::with_capacity(16 * rays.len());
    let mut hits = [HitPacket::default(); 4];
    for (rays, active) in rays.chunks(4).zip(active.chunks(4)) {
        let hits = &mut hits[..rays.len()];
        tlas.intersect_packets(rays, active, MASK_VIRTUAL, hits);
        for (hits, active) in hits.iter().zip(active) {
            found.extend((0..active.count_ones() as usize).map(|lane| hits.get(lane)));
        }
    }
    found
}

pub(super) fn run(lab: &mut Lab) -> Result<Section> {
    let mut section = Section::new();
    section.prose(
        "A rippled torus in a 640x480 view: its primary rays and, from each of their hits, one shadow ray to a \
         small lamp and one bounce in a random direction. One thread. Scalar code is the reference that every \
         other kernel must equal bit for bit; it is itself compared with a test of every triangle in double \
         precision.",
    );
    let meshes: &[(&str, u32, u32)] = lab.pick(
        &[("16 K", 128, 64)],
        &[("16 K", 128, 64), ("100 K", 320, 160), ("1 M", 1000, 500)],
    );
    for &(name, n, m) in meshes {
        lab.phase(&format!("{name} triangles"));
        let mesh = ripples(n, m);
        let blas = Arc::new(Blas::build(&mesh, BuildLimits::default())?);
        let tlases: Vec<Tlas> = levels()
            .into_iter()
            .map(|level| placed(level, &blas))
            .collect();
        let primary = primary();
        let (shadow, bounce) = shadow_and_bounce(&tlases[0], &mesh, &primary);
        let sets = [("primary", primary), ("shadow", shadow), ("bounce", bounce)];
        speed(lab, name, &tlases, &sets, &mut section);
        if mesh.triangles.len() < 20_000 {
            lab.phase("every triangle in double precision");
            truth(lab, &mesh, &tlases[0], &sets, &mut section);
        }
    }
    Ok(section)
}

fn speed(
    lab: &Lab,
    name: &str,
    tlases: &[Tlas],
    sets: &[(&str, Vec<Ray>); 3],
    section: &mut Section,
) {
    let columns = [
        ("primary", "Mray/s"),
        ("shadow", "Mray/s"),
        ("bounce", "Mray/s"),
        ("primary / scalar", "x"),
        ("shadow / scalar", "x"),
        ("bounce / scalar", "x"),
    ];
    // By series and form; there is no any-hit query for groups.
    let mut rates: Vec<((String, &str), [f64; 3])> = Vec::new();
    let (mut differ, mut compared) = (0, 0);
    // Every third tile of 64 rays is enough for a quick run.
    let step = lab.pick(3, 1);
    for (set, (what, rays)) in sets.iter().enumerate() {
        let rays: Vec<Ray> = rays.chunks(64).step_by(step).flatten().copied().collect();
        let packets = packets(&rays);
        let mut variants: Vec<(Kernel<'_>, Found)> =
            kernels(tlases, &rays, &packets, *what == "shadow")
                .into_iter()
                .map(|kernel| (kernel, Found::new()))
                .collect();
        let seconds = take_turns(lab.rounds(), &mut variants, |(kernel, found)| {
            *found = (kernel.run)()
        });
        let plain = variants.len() - 1;
        for (at, ((kernel, found), seconds)) in variants.iter().zip(seconds).enumerate() {
            let different = found.iter().zip(&variants[plain].1).filter(|(a, b)| a != b);
            differ += different.count() + found.len().abs_diff(rays.len());
            // Scalar code is not compared with itself.
            compared += if at == plain { 0 } else { rays.len() };
            let name = (kernel.series.clone(), kernel.form);
            let row = rates.iter().position(|(of, _)| *of == name);
            let row = row.unwrap_or_else(|| {
                rates.push((name, [f64::NAN; 3]));
                rates.len() - 1
            });
            rates[row].1[set] = rays.len() as f64 / seconds * 1e-6;
        }
    }
    let mut curve = Curve::new(format!("{name} triangles"), columns);
    let plain = rates.last().map_or([f64::NAN; 3], |(_, rate)| *rate);
    for (i, ((series, form), rate)) in rates.iter().enumerate() {
        let ratio = |set: usize| rate[set] / plain[set];
        let values = [rate[0], rate[1], rate[2], ratio(0), ratio(1), ratio(2)];
        let point = curve.point(series.as_str(), *form, values);
        if i + 1 == rates.len() {
            point.reference();
        }
    }
    section.curve(curve);
    section.bound(Bound::none_of(
        format!("{name} triangles: rays that a kernel ends otherwise than plain code, in any bit"),
        differ,
        compared,
    ));
}

/// Compares scalar code with a test of every triangle in double precision.
fn truth(lab: &Lab, mesh: &Mesh, tlas: &Tlas, sets: &[(&str, Vec<Ray>); 3], section: &mut Section) {
    let columns = [
        ("rays checked", ""),
        ("rounding decides", ""),
        ("missed", ""),
        ("false hits", ""),
        ("other triangle", ""),
        ("median error of t", ""),
        ("99th percentile", ""),
        ("largest", ""),
    ];
    let mut curve = Curve::new("Floats against doubles, 16 K triangles", columns);
    let place = placement();
    let reach = mesh.positions.iter().fold(0.0f32, |reach, &p| {
        reach.max(place.transform_point3a(p.into()).abs().max_element())
    });
    let n: usize = lab.pick(1_000, 60_000);
    let (mut wrong, mut checked) = (0, 0);
    let mut largest = 0f64;
    for (what, rays) in sets {
        let step = rays.len().div_ceil(n).max(1);
        let shadow = *what == "shadow";
        let verdicts: Vec<_> = lab.pool().install(|| {
            let chosen: Vec<&Ray> = rays.iter().step_by(step).collect();
            chosen
                .into_par_iter()
                .map(|ray| {
                    let instance = OracleInstance {
                        mesh,
                        camera_from_object: place,
                        mask: MASK_VIRTUAL,
                        // Transforming to the instance's space and computing the point on the ray takes under 64
                        // roundings of coordinates no larger than those of the origin or the mesh.
                        uncertainty: f64::from(
                            gamma(64) * reach.max(ray.origin.abs().max_element()),
                        ),
                    };
                    if shadow {
                        let hit = tlas.occluded_scalar(ray, MASK_VIRTUAL).then_some(SOME);
                        (any(&[instance], ray, MASK_VIRTUAL), hit)
                    } else {
                        let hit = tlas.intersect_scalar(ray, MASK_VIRTUAL);
                        (closest(&[instance], ray, MASK_VIRTUAL), hit)
                    }
                })
                .collect()
        });
        let (mut unsure, mut missed, mut invented, mut other) = (0, 0, 0, 0);
        let mut errors = Vec::new();
        for (verdict, hit) in &verdicts {
            match (verdict.hit, hit) {
                _ if verdict.margin <= 0.0 => unsure += 1,
                (Some(_), None) => missed += 1,
                (None, Some(_)) => invented += 1,
                (Some(expected), Some(hit)) if !shadow => {
                    other += usize::from(expected.triangle != hit.triangle as usize);
                    errors.push((f64::from(hit.t) - expected.t).abs() / expected.t);
                }
                _ => {}
            }
        }
        wrong += missed + invented + other;
        checked += verdicts.len() - unsure;
        let most = errors.iter().copied().fold(0.0, f64::max);
        largest = largest.max(most);
        let counts = [verdicts.len(), unsure, missed, invented, other];
        let mut values: Vec<f64> = counts.iter().map(|&n| n as f64).collect();
        values.extend([
            median(&mut errors),
            quantile(&mut errors, 0.99),
            if shadow { f64::NAN } else { most },
        ]);
        curve.point(*what, *what, values);
    }
    section.curve(curve);
    section.prose(format!(
        "The largest relative error of a hit's t is {}; one rounding of a float is 6.0e-8.",
        number(largest)
    ));
    section.bound(Bound::none_of(
        "rays that plain code ends otherwise than doubles, where rounding does not decide",
        wrong,
        checked,
    ));
}
