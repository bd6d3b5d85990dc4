//! What every stage of a frame reads.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket, Tlas};
use crate::frame::{RgbdFrame, depth_sigma_m};
use crate::ghost::GhostSurface;
use crate::render::RenderSettings;
use crate::render::checkpoint::Pulse;
use crate::scene::Material;

use super::ambient::{AmbientChange, AmbientPattern, AmbientTile, Occluders};
use super::camera_levels::CameraLevels;
use super::cone::RayCone;
use super::environment::Surroundings;
use super::lens::Lens;
use super::light::CameraLight;
use super::pattern::LightPattern;
use super::photon::PhotonMap;
use super::shadow_group::lanes;
use super::surface::Surface;
use super::tile::{Pixel, PixelLight, TILE_PIXELS, Tile, TileGrid};
use super::{MASK_TRANSMISSIVE, Object, Placed};

/// Everything the stages of one frame read.
pub(super) struct FrameContext<'a> {
    pub(super) frame: &'a RgbdFrame,
    pub(super) settings: &'a RenderSettings,
    pub(super) pulse: &'a Pulse<'a>,
    pub(super) tlas: &'a Tlas,
    pub(super) ghost: &'a GhostSurface,
    pub(super) objects: &'a [Object],
    pub(super) placed: &'a [Placed],
    pub(super) materials: &'a [Material],
    pub(super) material_needs_light: &'a [bool],
    pub(super) lights: &'a [CameraLight],
    pub(super) pattern: &'a LightPattern,
    /// `None` if there are no caustics.
    pub(super) photons: Option<&'a PhotonMap>,
    pub(super) surroundings: Surroundings<'a>,
    /// `None` if nothing reflects or refracts roughly.
    pub(super) camera_levels: Option<&'a CameraLevels>,
    pub(super) ambient_pattern: &'a AmbientPattern,
    pub(super) occluders: &'a Occluders,
    /// Object and version of each instance that casts an object's shadow in its place; they follow the
    /// objects' own.
    pub(super) shadow_versions: &'a [(u32, usize)],
    /// Change of ambient light per pixel of the tiles; empty if there is none.
    pub(super) ambient: &'a [AmbientTile],
    /// Ambient irradiance on virtual surfaces beyond that of the surroundings, per pixel of tiles that see
    /// any, none of others; empty if it is not looked for.
    pub(super) object_ambient: &'a [Vec<Vec3A>],
    /// Depth that primary rays compare with, NaN where none.
    pub(super) occlusion_depth: &'a [f32],
    pub(super) grid: &'a TileGrid,
    pub(super) tiles: &'a [Tile],
    /// Light after the filter; empty if there is none.
    pub(super) filtered: &'a [Box<[PixelLight; TILE_PIXELS]>],
    pub(super) glass: Glass,
    pub(super) has_ghost_objects: bool,
    pub(super) has_filtered: bool,
    /// fx, fy, cx, cy.
    pub(super) pinhole: [f32; 4],
    /// `None` for a pinhole.
    pub(super) lens: Option<&'a Lens>,
}

/// What lets light through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Glass {
    /// Nothing.
    None,
    /// It all leaves as much of light as this object does: which of them a shadow ray meets first is
    /// not asked.
    Alike(u32),
    /// This and that.
    Various,
}

impl Glass {
    pub(super) fn of(objects: &[Object]) -> Self {
        let mut glass = (0..)
            .zip(objects)
            .filter(|(_, object)| object.mask & MASK_TRANSMISSIVE != 0);
        let Some((first, object)) = glass.next() else {
            return Self::None;
        };
        if glass.all(|(_, other)| other.shadow_tint == object.shadow_tint) {
            Self::Alike(first)
        } else {
            Self::Various
        }
    }
}

/// Lights from which on shading a single surface takes tens of microseconds.
const MANY_LIGHTS: usize = 64;

impl FrameContext<'_> {
    /// Passes the checkpoint; false if the frame is given up. What is written after that counts for
    /// nothing, so loops just end.
    #[inline]
    pub(super) fn go_on(&self) -> bool {
        self.pulse.go_on()
    }

    /// The same before surface `i` of a loop: not before each where one takes less than a microsecond.
    #[inline]
    pub(super) fn go_on_at(&self, i: usize) -> bool {
        let slow = self.photons.is_some() || self.lights.len() > MANY_LIGHTS;
        if slow || i.is_multiple_of(16) {
            self.pulse.go_on()
        } else {
            !self.pulse.is_stopped()
        }
    }

    /// Direction of a primary ray, z = 1.
    #[inline]
    pub(super) fn ray_direction(&self, u: f32, v: f32) -> Vec3A {
        ray_direction(self.pinhole, u, v)
    }

    /// How wide a pixel's cone is at a depth, and how it grows. A lens ray's is taken as that.
    pub(super) fn pixel_cone(&self, depth: f32) -> RayCone {
        let spread = 1.0 / self.pinhole[0].abs();
        RayCone {
            width: spread * depth,
            spread,
        }
    }

    /// What a pixel's own ray met.
    pub(super) fn primary_surface(&self, hit: &Hit, x: u32, y: u32) -> Surface {
        let direction = self.ray_direction(x as f32, y as f32);
        self.surface(hit, direction, self.pixel_cone(hit.t))
    }

    /// How far from where a ray starts the ghost surface is not to be trusted: within the sensor's noise,
    /// for an object that stands on a surface starts its rays there.
    pub(super) fn lift(&self, p: Vec3A) -> f32 {
        self.settings.ghost.bias_sigmas * depth_sigma_m(p.z.max(0.0))
    }

    /// Depth of what is real at a pixel, filled in as the settings say; NaN in a hole.
    #[inline]
    pub(super) fn real_depth(&self, x: u32, y: u32) -> f32 {
        self.occlusion_depth[y as usize * self.frame.color.width as usize + x as usize]
    }

    /// Normal of the ghost surface at a pixel, towards the camera where none can be fitted.
    pub(super) fn real_normal(&self, x: u32, y: u32) -> Vec3A {
        self.ghost
            .normal_at(x, y)
            .or_else(|| (-self.ray_direction(x as f32, y as f32)).try_normalize())
            .unwrap_or(-Vec3A::Z)
    }

    /// Whether ambient light changes anywhere in an active tile.
    pub(super) fn has_ambient(&self, slot: usize) -> bool {
        self.ambient.get(slot).is_some_and(AmbientTile::any)
    }

    /// Em / Er at a place of an active tile where lamps are as they were.
    pub(super) fn ambient_share(&self, slot: usize, place: usize) -> Vec3A {
        self.ambient
            .get(slot)
            .map_or(Vec3A::ONE, |tile| tile.share_at(place))
    }

    /// Change of ambient light at a place of an active tile.
    pub(super) fn ambient_at(&self, slot: usize, place: usize) -> AmbientChange {
        self.ambient
            .get(slot)
            .map_or_else(AmbientChange::default, |tile| tile.at(place))
    }

    /// Object, and version of its mesh, that an instance of the acceleration structure stands for.
    pub(super) fn object_of(&self, instance: u32) -> (u32, usize) {
        let i = instance as usize;
        match self.placed.get(i) {
            Some(placed) => (instance, placed.version),
            None => self.shadow_versions[i - self.placed.len()],
        }
    }

    /// Triangles of all objects as the frame shows them.
    pub(super) fn n_triangles(&self) -> u64 {
        let of = |(object, placed): (&Object, &Placed)| {
            object.shape.versions[placed.version].mesh.triangles.len() as u64
        };
        self.objects.iter().zip(self.placed).map(of).sum()
    }

    pub(super) fn project(&self, p: Vec3A) -> (f32, f32) {
        let [fx, fy, cx, cy] = self.pinhole;
        (fx * p.x / p.z + cx, fy * p.y / p.z + cy)
    }

    /// The record of a pixel; that of a copied tile sees the camera.
    pub(super) fn pixel(&self, x: u32, y: u32) -> Pixel {
        self.grid
            .locate(x, y)
            .map_or_else(Pixel::default, |(tile, place)| {
                self.tiles[tile].pixels[place]
            })
    }

    /// Light of a pixel after the filter.
    pub(super) fn light(&self, x: u32, y: u32) -> PixelLight {
        self.grid
            .locate(x, y)
            .map_or_else(PixelLight::default, |(tile, place)| {
                let filtered = self.filtered.get(tile);
                let mut light = match filtered.filter(|_| self.tiles[tile].has_penumbra) {
                    Some(filtered) => filtered[place],
                    None => self.light_in(tile, place),
                };
                let ambient = self.object_ambient.get(tile);
                if let Some(&ambient) = ambient.and_then(|tile| tile.get(place)) {
                    light.object.ambient = ambient;
                }
                light
            })
    }

    /// Light of a pixel before the filter; `None` if nothing asked.
    pub(super) fn raw_light(&self, x: u32, y: u32) -> Option<PixelLight> {
        self.grid
            .locate(x, y)
            .map(|(tile, place)| self.light_in(tile, place))
    }

    /// Light before the filter at a place of an active tile.
    fn light_in(&self, slot: usize, place: usize) -> PixelLight {
        let tile = &self.tiles[slot];
        if tile.only_ambient {
            return PixelLight {
                ghost: self.ambient_share(slot, place),
                ..PixelLight::default()
            };
        }
        tile.light[place]
    }

    /// What each ray meets first among what its mask names, sixteen rays at a time: fastest where
    /// neighbours in the list are neighbours in space.
    pub(super) fn intersect_all(
        &self,
        rays: &[Ray],
        mask_of: impl Fn(usize) -> u8,
        hits: &mut Vec<Option<Hit>>,
    ) {
        hits.clear();
        let mut packet = RayPacket::default();
        let mut found = HitPacket::default();
        let n = rays.len();
        for rays in rays.chunks(16) {
            if !self.go_on() {
                hits.resize(n, None);
                return;
            }
            for (lane, ray) in rays.iter().enumerate() {
                packet.set(lane, ray);
            }
            let first = hits.len();
            hits.resize(first + rays.len(), None);
            // Lanes with the same mask go together: mostly all.
            let mut open = (u32::MAX >> (32 - rays.len())) as u16;
            while open != 0 {
                let mask = mask_of(first + open.trailing_zeros() as usize);
                let alike = |&lane: &usize| mask_of(first + lane) == mask;
                let active = lanes(open)
                    .filter(alike)
                    .fold(0, |all, lane| all | 1 << lane);
                self.intersect_packet(&packet, active, mask, &mut found);
                for lane in lanes(active) {
                    hits[first + lane] = found.get(lane);
                }
                open &= !active;
            }
        }
    }

    pub(super) fn occluded(&self, ray: &Ray, mask: u8) -> bool {
        if self.has_filtered {
            self.tlas
                .occluded_filtered(ray, mask, &|hit| self.is_solid(hit))
        } else {
            self.tlas.occluded(ray, mask)
        }
    }

    pub(super) fn intersect_packet(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        hits: &mut HitPacket,
    ) {
        if self.has_filtered {
            self.tlas.intersect_packet_filtered(
                rays,
                active,
                mask,
                &|_, hit| self.is_solid(hit),
                hits,
            );
        } else {
            self.tlas.intersect_packet(rays, active, mask, hits);
        }
    }

    pub(super) fn intersect_packets(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        hits: &mut [HitPacket],
    ) {
        if self.has_filtered {
            let solid = |_, hit: &Hit| self.is_solid(hit);
            self.tlas
                .intersect_packets_filtered(rays, active, mask, &solid, hits);
        } else {
            self.tlas.intersect_packets(rays, active, mask, hits);
        }
    }

    pub(super) fn occluded_packet(&self, rays: &RayPacket, active: u16, mask: u8) -> u16 {
        if self.has_filtered {
            self.tlas
                .occluded_packet_filtered(rays, active, mask, &|_, hit| self.is_solid(hit))
        } else {
            self.tlas.occluded_packet(rays, active, mask)
        }
    }
}

pub(super) fn ray_direction([fx, fy, cx, cy]: [f32; 4], u: f32, v: f32) -> Vec3A {
    Vec3A::new((u - cx) / fx, (v - cy) / fy, 1.0)
}
