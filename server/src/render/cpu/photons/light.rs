//! Light from photons: irradiance at a point, from the density of photons around it.
//!
//! Distance is measured in the plane of the surface's normal, so that sensor noise along the normal costs no
//! light. A photon lights only surfaces that face it, are part of its own object and are near its plane: not the
//! wall beside a table, nor a table's underside. Where a surface ends within the kernel, the part of the kernel
//! beyond the edge is lost, so a caustic darkens towards an edge over one radius.

use glam::Vec3A;

use crate::numerics::linear_from_srgb;
use crate::render::cpu::tile::Tile;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::sensed::{NormalMemo, Sensed};
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};

use super::map::{Footprint, PhotonMap, kernel};

/// Largest distance from the plane of the surface at which a photon counts, as a share of the kernel's radius.
const THICKNESS: f32 = 0.5;

/// Photons that brighten a pixel by less than this share of an 8-bit step are ignored, so that its real light
/// need not be computed.
const LEAST_STEP: f32 = 0.25;

/// Light from photons on the ghost surface of a tile. A buffer of a thread.
#[derive(Default)]
pub(crate) struct PhotonLight {
    /// Per pixel of the tile; empty if no photon reaches it.
    irradiance: Vec<Vec3A>,
    /// Camera space; NaN in a hole.
    points: Vec<Vec3A>,
    /// Zero where it has not been computed.
    normals: Vec<Vec3A>,
}

impl PhotonLight {
    /// Irradiance and unit normal at a pixel of the tile; `None` where photons change nothing.
    pub(crate) fn at(&self, place: usize) -> Option<(Vec3A, Vec3A)> {
        let e = *self.irradiance.get(place)?;
        (e != Vec3A::ZERO).then(|| (e, self.normals[place]))
    }
}

/// Sums the photons on the ghost surface of a tile.
pub(crate) fn gather_tile(
    photons: Option<&PhotonMap>,
    frame: &PreparedFrame<'_>,
    tile: &Tile,
    out: &mut PhotonLight,
) {
    let sensed = &frame.sensed;
    out.irradiance.clear();
    let Some(photons) = photons.filter(|_| tile.has_photons) else {
        return;
    };
    out.irradiance.resize(TILE_PIXELS, Vec3A::ZERO);
    out.normals.clear();
    out.normals.resize(TILE_PIXELS, Vec3A::ZERO);
    out.points.clear();
    out.points.resize(TILE_PIXELS, Vec3A::NAN);
    for (dx, dy) in (0..tile.height).flat_map(|dy| (0..tile.width).map(move |dx| (dx, dy))) {
        let (x, y) = (tile.x0 + dx, tile.y0 + dy);
        out.points[Tile::index(dx, dy)] = sensed.point_at(x, y);
    }
    let mut memos: [NormalMemo; 16] = std::array::from_fn(|_| NormalMemo::default());
    let of_tile = photons.of_tile(tile.x0 / TILE, tile.y0 / TILE);
    for (i, photon) in of_tile.enumerate() {
        if i.is_multiple_of(256) && !frame.go_on() {
            return;
        }
        let footprint = Footprint::new(sensed.pinhole, photon);
        // Casts saturate, so a photon outside the tile gives an empty range.
        let span = |[low, high]: [f32; 2], first: u32, n: u32| {
            let first = first as f32;
            let end = (high - first + 1.0).clamp(0.0, n as f32) as u32;
            (low - first).max(0.0) as u32..end
        };
        let radius = photon.radius;
        let thickness = THICKNESS * radius + sensed.lift(photon.position);
        let farthest = radius * radius + thickness * thickness;
        for dy in span(footprint.y, tile.y0, tile.height) {
            for dx in span(footprint.x, tile.x0, tile.width) {
                let place = Tile::index(dx, dy);
                let away = out.points[place] - photon.position;
                let squared = away.length_squared();
                // True for NaN, which is a hole.
                if squared.is_nan() || squared >= farthest {
                    continue;
                }
                let normal = &mut out.normals[place];
                if *normal == Vec3A::ZERO {
                    let memo = &mut memos[(dy / 4 * 4 + dx / 4) as usize];
                    *normal = sensed.block_normal(tile.x0 + dx, tile.y0 + dy, memo);
                }
                let across = away.dot(*normal);
                if across.abs() <= thickness && photon.direction.dot(*normal) < 0.0 {
                    let k = kernel(squared - across * across, radius);
                    out.irradiance[place] += photon.flux * k;
                }
            }
        }
    }
    for (dx, dy) in (0..tile.height).flat_map(|dy| (0..tile.width).map(move |dx| (dx, dy))) {
        let e = &mut out.irradiance[Tile::index(dx, dy)];
        if *e != Vec3A::ZERO && !shows(sensed, *e, tile.x0 + dx, tile.y0 + dy) {
            *e = Vec3A::ZERO;
        }
    }
}

/// Whether photons of irradiance `e` can be visible at a pixel: a white surface reflects `e / pi`.
fn shows(sensed: &Sensed<'_>, e: Vec3A, x: u32, y: u32) -> bool {
    let pixel = sensed.color.rgba[(y * sensed.color.width + x) as usize];
    let brighter = e.abs() * std::f32::consts::FRAC_1_PI;
    (0..3).any(|c| {
        let code = pixel[c].min(254);
        let step = linear_from_srgb(code + 1) - linear_from_srgb(code);
        brighter[c] >= LEAST_STEP * step
    })
}

/// Irradiance from photons on the visible side of a mesh.
pub(crate) fn photon_irradiance(photons: Option<&PhotonMap>, surface: &Surface) -> Vec3A {
    let Some(photons) = photons else {
        return Vec3A::ZERO;
    };
    let radius = photons.mesh_radius();
    let mut sum = Vec3A::ZERO;
    for photon in photons.near(surface.position) {
        let away = photon.position - surface.position;
        let across = away.dot(surface.normal);
        if photon.instance == surface.instance
            && across.abs() <= THICKNESS * radius
            && photon.direction.dot(surface.geometric_normal) < 0.0
        {
            sum += photon.flux * kernel(away.length_squared() - across * across, radius);
        }
    }
    sum
}

/// The share of light that photons of irradiance `e` add at a pixel of the ghost surface with the real irradiance
/// `real`. The camera's pixel gives the surface's reflectance, `rho = pi Ic / Er`; if the modelled light is too
/// little to explain the pixel, the surface is taken as white.
pub(crate) fn photon_share(sensed: &Sensed<'_>, e: Vec3A, real: Vec3A, x: u32, y: u32) -> Vec3A {
    let least = sensed.color_at(x, y) * std::f32::consts::PI;
    let real = real.max(least);
    let share = e / real.max(Vec3A::splat(f32::MIN_POSITIVE));
    // A black pixel stays black, however bright its photons.
    Vec3A::select(real.cmpgt(Vec3A::ZERO), share, Vec3A::ZERO)
        .clamp(Vec3A::splat(-f32::MAX), Vec3A::splat(f32::MAX))
}
