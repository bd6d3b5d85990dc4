//! The rays of soft shadows: to virtual occluders in packets, to real ones in batches.

use std::ops::Range;

use glam::Vec3A;

use crate::accel::{HitPacket, MASK_GHOST, Ray, RayPacket};

use super::context::Glass;
use super::light::CameraLight;
use super::pattern::LightPattern;
use super::shadow_group::{Buffers, CHUNK, Cast, LANES, ShadowGroup, lanes};
use super::{FrameContext, MASK_GLASS, MASK_OPAQUE, MASK_SHADOW, MASK_SHEET, MASK_TRANSMISSIVE};

impl FrameContext<'_> {
    /// Rays to virtual occluders for what is to do, packed sixteen at a time across lanes and
    /// samples: neighbours on the light together, for they meet the same parts of meshes.
    pub(super) fn cast_virtual(&self, group: &mut ShadowGroup, chunk: &Range<usize>) {
        let ShadowGroup {
            points,
            on_ghost,
            cast,
            ..
        } = group;
        for (k, i) in chunk.clone().enumerate() {
            cast.samples[k].cast |= cast.todo[k];
            if self.pattern.point(i, 0) != [0.0; 2] {
                for lane in lanes(cast.todo[k] & !cast.opened) {
                    cast.discs[lane].open();
                }
                cast.opened |= cast.todo[k];
            }
        }
        if cast.virtual_clear {
            return;
        }
        // A counting sort by place.
        let mut ends = [0_u16; LightPattern::N_PLACES + 1];
        for (k, i) in chunk.clone().enumerate() {
            for lane in lanes(cast.todo[k]) {
                cast.n_rays[lane] += 1;
                ends[usize::from(self.pattern.place(i, cast.rotations[lane])) + 1] += 1;
            }
        }
        for place in 0..LightPattern::N_PLACES {
            ends[place + 1] += ends[place];
        }
        let n = usize::from(ends[LightPattern::N_PLACES]);
        let mut owners = [(0_u8, 0_u8); CHUNK * LANES];
        for (k, i) in chunk.clone().enumerate() {
            for lane in lanes(cast.todo[k]) {
                let place = self.pattern.place(i, cast.rotations[lane]);
                let end = &mut ends[usize::from(place)];
                owners[usize::from(*end)] = (k as u8, lane as u8);
                *end += 1;
            }
        }
        let mut rays = RayPacket::default();
        for owners in owners[..n].chunks(LANES) {
            for (slot, &(k, lane)) in owners.iter().enumerate() {
                let (i, lane) = (chunk.start + usize::from(k), usize::from(lane));
                let disc = &cast.discs[lane];
                rays.set(
                    slot,
                    &Ray {
                        origin: points[lane].origin,
                        direction: disc.direction(self.pattern.point(i, cast.rotations[lane])),
                        t_min: 0.0,
                        t_max: disc.t_max,
                    },
                );
            }
            self.resolve_packet(&rays, owners, *on_ghost, cast);
        }
    }

    /// Traces a packet, one ray per owner (sample, lane).
    fn resolve_packet(
        &self,
        rays: &RayPacket,
        owners: &[(u8, u8)],
        on_ghost: bool,
        cast: &mut Cast,
    ) {
        let active = (u32::MAX >> (32 - owners.len())) as u16;
        let opaque = if on_ghost { MASK_SHADOW } else { MASK_OPAQUE };
        // With caustics the light of what bends it arrives as photons.
        let (stops, tints) = match self.photons {
            Some(_) => (opaque | MASK_GLASS, MASK_SHEET),
            None => (opaque, MASK_TRANSMISSIVE),
        };
        let blocked = self.occluded_packet(rays, active, stops);
        for slot in lanes(blocked) {
            let (k, lane) = (usize::from(owners[slot].0), usize::from(owners[slot].1));
            cast.samples[k].virtual_blocked |= 1 << lane;
            cast.touched |= 1 << lane;
        }
        let open = active & !blocked;
        if cast.glass && open != 0 {
            let mut hits = HitPacket::default();
            let tinted = if let Glass::Alike(glass) = self.glass {
                hits.instance = [glass; LANES];
                self.occluded_packet(rays, open, tints)
            } else {
                self.intersect_packet(rays, open, tints, &mut hits);
                let met = |&slot: &usize| hits.instance[slot] != u32::MAX;
                lanes(open).filter(met).fold(0, |all, slot| all | 1 << slot)
            };
            for slot in lanes(tinted) {
                let (k, lane) = (usize::from(owners[slot].0), usize::from(owners[slot].1));
                cast.samples[k].glass[lane] = hits.instance[slot];
                cast.samples[k].tinted |= 1 << lane;
                cast.touched |= 1 << lane;
            }
        }
    }

    /// Queues rays to real occluders for what is to do: for a virtual point wherever light is left;
    /// for a ghost point only where something virtual takes light (the ratio is one elsewhere,
    /// whatever is real); none where it is proven that nothing real is in the way.
    pub(super) fn queue_real(
        &self,
        group: &mut ShadowGroup,
        g: usize,
        chunk: &Range<usize>,
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        let cast = &mut group.cast;
        cast.relevant = cast.active & !cast.real_lit_everywhere;
        if group.on_ghost {
            cast.relevant &= cast.touched;
        }
        let mut starts = [(Vec3A::ZERO, 0.0); LANES];
        let mut normals = NormalMemo::default();
        for lane in lanes(cast.relevant) {
            let point = &mut group.points[lane];
            // Lifted off the sheet by the sensor's noise, or a noisy surface shadows itself.
            let lift = self.lift(point.origin);
            let mut origin = point.origin;
            if group.on_ghost {
                if point.normal == Vec3A::ZERO {
                    point.normal = self.ghost_normal(point.x, point.y, &mut normals);
                }
                origin += point.normal * lift;
            }
            starts[lane] = (origin, lift);
        }
        self.prove_clear(cast, &starts, light, buffers);
        for lane in lanes(cast.relevant & !cast.clear) {
            let disc = &cast.discs[lane];
            let (origin, lift) = starts[lane];
            for (k, i) in chunk.clone().enumerate() {
                let bit = 1 << lane;
                let needless = !group.on_ghost && cast.samples[k].virtual_blocked & bit != 0;
                if needless || cast.todo[k] & bit == 0 {
                    continue;
                }
                let direction = disc.direction(self.pattern.point(i, cast.rotations[lane]));
                cast.n_rays[lane] += 1;
                buffers.rays.push(Ray {
                    origin,
                    direction,
                    t_min: lift / direction.length().max(f32::MIN_POSITIVE),
                    t_max: disc.t_max,
                });
                buffers.owners.push((g as u32, k as u8, lane as u8));
            }
        }
    }

    /// Asks once for all lanes that look for real occluders whether there can be any. Once one group
    /// got no proof the others are not asked: what is in the way at one place of a tile mostly is at
    /// the next, and a light beside something real is never proven.
    fn prove_clear(
        &self,
        cast: &mut Cast,
        starts: &[(Vec3A, f32); LANES],
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        let asked = cast.relevant & !cast.clear_asked;
        // Modelled real things are not on the sheet.
        let may_ask = self.settings.shadows.skip_proven && !self.has_ghost_objects;
        if asked == 0 || !may_ask || buffers.light_unclear {
            return;
        }
        cast.clear_asked |= asked;
        let (mut points, mut n, mut radius) = ([Vec3A::ZERO; LANES], 0, 0.0f32);
        for lane in lanes(asked) {
            let (origin, lift) = starts[lane];
            let (point, spread) = cast.discs[lane].start_of_rays(origin, lift);
            points[n] = point;
            n += 1;
            radius = radius.max(spread);
        }
        if self
            .ghost
            .is_unoccluded(&points[..n], radius, light.beam_end())
        {
            cast.clear |= asked;
        } else {
            buffers.light_unclear = true;
        }
    }

    /// Traces what was queued.
    pub(super) fn cast_real(&self, groups: &mut [ShadowGroup], buffers: &mut Buffers<'_>) {
        let Buffers {
            rays,
            owners,
            blocked,
            ..
        } = buffers;
        blocked.clear();
        blocked.resize(rays.len(), false);
        self.ghost.occluded_batch(rays, blocked);
        for ((ray, &(g, k, lane)), &blocked) in rays.iter().zip(&**owners).zip(&**blocked) {
            if blocked || (self.has_ghost_objects && self.occluded(ray, MASK_GHOST)) {
                groups[g as usize].cast.samples[usize::from(k)].real_blocked |= 1 << lane;
            }
        }
    }

    /// Normal of the ghost surface for shading: that of the 2x2 block, if its corner lies on the same
    /// surface (fits are wider than that, and cost more than the rays); towards the camera where none
    /// can be fitted.
    pub(super) fn ghost_normal(&self, x: u32, y: u32, memo: &mut NormalMemo) -> Vec3A {
        let block = (x & !1, y & !1);
        let z =
            |(x, y): (u32, u32)| self.frame.depth.z_m[(y * self.frame.color.width + x) as usize];
        let step = self.settings.ghost.edge_relative * z((x, y));
        let fit = |(x, y): (u32, u32)| {
            self.ghost
                .normal_at(x, y)
                .or_else(|| (-self.ray_direction(x as f32, y as f32)).try_normalize())
                .unwrap_or(-Vec3A::Z)
        };
        // False for a NaN on either side.
        if (z((x, y)) - z(block)).abs() < step {
            *memo.of_block[(y >> 1 & 1) as usize][(x >> 1 & 1) as usize]
                .get_or_insert_with(|| fit(block))
        } else {
            fit((x, y))
        }
    }
}

/// Normals of the 2x2 blocks of one 4x4 block.
#[derive(Default)]
pub(super) struct NormalMemo {
    of_block: [[Option<Vec3A>; 2]; 2],
}
