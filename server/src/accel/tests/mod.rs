//! What the whole module promises; see also the oracle.

mod agreement;
mod degenerate;
mod instances;
mod shaft;
mod shapes;
mod watertight;

use std::sync::Arc;

use fearless_simd::Level;
use glam::Affine3A;

use super::*;
use crate::scene::Mesh;

/// Every instruction set that this machine can run.
pub(crate) fn levels() -> Vec<Level> {
    let best = Level::new();
    let mut levels = vec![Level::fallback()];
    #[cfg(target_arch = "x86_64")]
    {
        levels.extend(best.as_sse4_2().map(Level::Sse4_2));
        levels.extend(best.as_avx2().map(Level::Avx2));
        levels.extend(best.as_avx512().map(Level::Avx512));
    }
    #[cfg(not(target_arch = "x86_64"))]
    levels.push(best);
    levels
}

pub(crate) fn blas(mesh: &Mesh) -> Arc<Blas> {
    Arc::new(Blas::build(mesh, BuildLimits::default()).unwrap())
}

pub(crate) fn placed(blas: &Arc<Blas>, camera_from_object: Affine3A) -> TlasInstance {
    TlasInstance {
        blas: Arc::clone(blas),
        camera_from_object,
        mask: MASK_VIRTUAL,
        filtered: false,
    }
}

pub(crate) fn tlas(level: Level, instances: &[TlasInstance]) -> Tlas {
    let mut tlas = Tlas::with_level(level);
    tlas.rebuild(instances);
    tlas
}

/// Up to sixteen rays as a packet, and the lanes they fill.
pub(crate) fn packet(rays: &[Ray]) -> (RayPacket, u16) {
    let mut packet = RayPacket::default();
    for (lane, ray) in rays.iter().enumerate() {
        packet.set(lane, ray);
    }
    (packet, ((1_u32 << rays.len()) - 1) as u16)
}

/// Checks wide and packet kernels of `tlas` against `expected`, the scalar hits of `rays`.
pub(crate) fn check_kernels(tlas: &Tlas, rays: &[Ray], expected: &[Option<Hit>]) {
    for (rays, expected) in rays.chunks(16).zip(expected.chunks(16)) {
        let (packet, active) = packet(rays);
        let mut hits = HitPacket::default();
        tlas.intersect_packet(&packet, active, u8::MAX, &mut hits);
        let occluded = tlas.occluded_packet(&packet, active, u8::MAX);
        for (lane, (ray, &expected)) in rays.iter().zip(expected).enumerate() {
            let level = tlas.level();
            assert_eq!(
                tlas.intersect(ray, u8::MAX),
                expected,
                "wide {level:?} {ray:?}"
            );
            assert_eq!(
                tlas.occluded(ray, u8::MAX),
                expected.is_some(),
                "wide any {level:?} {ray:?}"
            );
            assert_eq!(
                hits.get(lane),
                expected,
                "packet {level:?} lane {lane} {ray:?}"
            );
            assert_eq!(
                occluded >> lane & 1 != 0,
                expected.is_some(),
                "packet any {level:?} {ray:?}"
            );
        }
    }
}
