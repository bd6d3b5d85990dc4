//! Runs every kernel of [`ghostlight::accel`] on every instruction set; all must agree to the bit.

use std::sync::Arc;

use fearless_simd::Level;
use glam::Affine3A;

use ghostlight::accel::{
    BOX_PAD, Blas, BuildLimits, Hit, HitPacket, MASK_VIRTUAL, Ray, RayPacket, Tlas, TlasInstance,
};
use ghostlight::scene::Mesh;

/// Every instruction set of this machine.
pub fn levels() -> Vec<Level> {
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

/// A mesh, built and placed.
pub(super) fn placed(mesh: &Mesh, camera_from_object: Affine3A) -> Result<TlasInstance, String> {
    let blas = Blas::build(mesh, BuildLimits::default()).map_err(|e| e.to_string())?;
    Ok(TlasInstance {
        blas: Arc::new(blas),
        camera_from_object,
        mask: MASK_VIRTUAL,
        filtered: false,
    })
}

/// The acceleration structure of instances, for kernels of one instruction set.
pub fn tlas(level: Level, instances: &[TlasInstance]) -> Tlas {
    let mut tlas = Tlas::with_level(level);
    tlas.rebuild(instances);
    tlas
}

/// The acceleration structure of a single placed mesh.
pub(super) fn one(level: Level, mesh: &Mesh, place: Affine3A) -> Result<Tlas, String> {
    Ok(tlas(level, &[placed(mesh, place)?]))
}

/// Up to sixteen rays as a packet, and its active lanes.
pub fn packet(rays: &[Ray]) -> (RayPacket, u16) {
    let mut packet = RayPacket::default();
    for (lane, ray) in rays.iter().enumerate() {
        packet.set(lane, ray);
    }
    (packet, ((1_u32 << rays.len()) - 1) as u16)
}

/// The hits of the scalar reference; an error if another kernel differs in any bit.
pub fn agree(tlas: &Tlas, rays: &[Ray]) -> Result<Vec<Option<Hit>>, String> {
    let expected: Vec<Option<Hit>> = rays
        .iter()
        .map(|ray| tlas.intersect_scalar(ray, u8::MAX))
        .collect();
    let (packets, active): (Vec<_>, Vec<_>) = rays.chunks(16).map(packet).unzip();
    let mut groups = vec![HitPacket::default(); packets.len()];
    tlas.intersect_packets(&packets, &active, u8::MAX, &mut groups);
    for (i, (rays, expected)) in rays.chunks(16).zip(expected.chunks(16)).enumerate() {
        let (packet, active) = (packets[i], active[i]);
        let mut hits = HitPacket::default();
        tlas.intersect_packet(&packet, active, u8::MAX, &mut hits);
        let occluded = tlas.occluded_packet(&packet, active, u8::MAX);
        for (lane, (ray, &expected)) in rays.iter().zip(expected).enumerate() {
            let found = [
                ("single", tlas.intersect(ray, u8::MAX)),
                ("packet", hits.get(lane)),
                ("group of packets", groups[i].get(lane)),
            ];
            if let Some((kernel, hit)) = found.into_iter().find(|(_, hit)| *hit != expected) {
                return Err(format!(
                    "{kernel}, {:?}, {ray:?}: {hit:?}, reference {expected:?}",
                    tlas.level()
                ));
            }
            let any = [
                tlas.occluded_scalar(ray, u8::MAX),
                tlas.occluded(ray, u8::MAX),
                occluded >> lane & 1 != 0,
            ];
            if any != [expected.is_some(); 3] {
                return Err(format!(
                    "any hit, {:?}, {ray:?}: {any:?}, {expected:?}",
                    tlas.level()
                ));
            }
        }
    }
    Ok(expected)
}

/// Displacement in camera space (metres) that rounding may cause for this ray and mesh: the padding of an AABB at
/// camera scale, which is derived to cover it (`BOX_PAD`), times the condition number of the transform.
pub fn rounding(mesh: &Mesh, at: &Affine3A, ray: &Ray) -> f64 {
    let norm = |m: glam::Mat3A| {
        (0..3)
            .map(|i| m.row(i).abs().element_sum())
            .fold(0.0, f32::max)
    };
    let condition = norm(at.matrix3) * norm(at.matrix3.inverse());
    let reach = mesh
        .positions
        .iter()
        .fold(ray.origin.abs().max_element(), |reach, &p| {
            reach.max(at.transform_point3a(p.into()).abs().max_element())
        });
    f64::from(3.0 * BOX_PAD * condition * 2.0 * reach)
}
