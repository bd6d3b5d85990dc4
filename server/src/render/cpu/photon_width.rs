//! How wide a photon's kernel is: as narrow as asked for where photons are many, wider where they are
//! few.
//!
//! A fixed kernel (Kan and Kaufmann 2012) narrow enough for a focus shows every single photon of the
//! faint light around it. So photons are counted first in coarse cells of space, a pilot estimate
//! of their density, and each gets the narrowest of three widths that gathers enough (Abramson
//! 1982, "On bandwidth variation in kernel estimates": a width per sample keeps each sample's whole
//! weight, so no light is lost or made). Counts are whole numbers, the same in whatever order they
//! are made; cells lie along world axes, so that a camera that moves past changes no width.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use glam::{Mat3A, Vec3A};

use crate::camera::Pose;

/// Widths of kernels: 1, 2 and 4 times the narrowest.
pub(super) const WIDTHS: usize = 3;

/// Photons that a kernel should gather: their weighted mean is then good to sqrt(4/3 / 50), 16 %.
const WANTED: f32 = 50.0;

/// Side of a cell in radii of the narrowest kernel, that of a kernel of the widest.
const CELL_RADII: f32 = 8.0;

/// Fewest buckets that cells are hashed into.
const LEAST_BUCKETS: usize = 1 << 12;

/// Photons per cell.
#[derive(Default)]
pub(super) struct Pilot {
    /// A power of two of them. Cells that share one take each other for denser than they are.
    counts: Vec<AtomicU32>,
    world_from_camera: Mat3A,
    /// The camera in its cell, metres along world axes.
    camera_in_cell: Vec3A,
    cell_m: f32,
}

impl Pilot {
    /// Forgets all counts; up to `photons` are to come.
    pub(super) fn reset(&mut self, photons: u32, radius_m: f32, pose: &Pose) {
        let n = (photons as usize).next_power_of_two().max(LEAST_BUCKETS);
        self.counts.clear();
        self.counts.resize_with(n, AtomicU32::default);
        self.cell_m = CELL_RADII * radius_m;
        self.world_from_camera = Mat3A::from_quat(pose.rotation.as_quat());
        // In f64: a world origin far away leaves no rounding.
        let cell = f64::from(self.cell_m);
        let camera = pose.translation;
        self.camera_in_cell = (camera - (camera / cell).floor() * cell).as_vec3a();
    }

    fn bucket(&self, p: Vec3A) -> usize {
        let in_world = self.world_from_camera * p + self.camera_in_cell;
        let cell = (in_world / self.cell_m).floor().as_ivec3();
        let [x, y, z] = cell.to_array().map(|i| i as u32);
        crate::numerics::hash(x, y, z) as usize & (self.counts.len() - 1)
    }

    /// Counts a photon at `p`, camera space.
    pub(super) fn count(&self, p: Vec3A) {
        self.counts[self.bucket(p)].fetch_add(1, Relaxed);
    }

    /// Which width a photon at `p` gets: radius times two to this power.
    pub(super) fn width(&self, p: Vec3A) -> u8 {
        let n = self.counts[self.bucket(p)].load(Relaxed) as f32;
        // A surface through a cell has about the area of a side.
        let gathers = n * std::f32::consts::PI / (CELL_RADII * CELL_RADII);
        if gathers >= WANTED {
            0
        } else if 4.0 * gathers >= WANTED {
            1
        } else {
            2
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn pose(angle: f64, x: f64) -> Pose {
        Pose {
            rotation: DQuat::from_rotation_y(angle),
            translation: DVec3::new(x, -1.0, 3.0),
        }
    }

    /// Cells of 8 radii whose kernels would gather 49 and 51 photons, and a quarter of that.
    #[test]
    fn the_fewer_photons_the_wider() {
        let p = Vec3A::new(0.01, 0.02, 1.0);
        for (gathered, width) in [(51.0, 0), (49.0, 1), (13.0, 1), (12.0, 2), (0.1, 2)] {
            let mut pilot = Pilot::default();
            pilot.reset(100, 0.01, &pose(0.0, 0.0));
            let n = (gathered * 64.0 / std::f32::consts::PI).round() as u32;
            (0..n).for_each(|_| pilot.count(p));
            assert_eq!(pilot.width(p), width, "{gathered}");
        }
    }

    /// What shares a cell in the world does so from any pose.
    #[test]
    fn cells_stay_where_they_are_in_the_world() {
        let points: Vec<DVec3> = (0..200)
            .map(|i| DVec3::new(0.007 * f64::from(i), 0.3, 0.011 * f64::from(i % 17)))
            .collect();
        let shares = |pose: &Pose| -> Vec<bool> {
            let mut pilot = Pilot::default();
            // So many buckets that chance puts no two of these cells into one.
            pilot.reset(1 << 20, 0.004, pose);
            let inverse = pose.inverse();
            let buckets: Vec<usize> = points
                .iter()
                .map(|&p| pilot.bucket(inverse.transform_point(p).as_vec3a()))
                .collect();
            let pairs = buckets
                .iter()
                .flat_map(|a| buckets.iter().map(move |b| a == b));
            pairs.collect()
        };
        let here = shares(&pose(0.0, 0.0));
        assert!(here.iter().filter(|same| **same).count() > 2 * points.len());
        for moved in [pose(0.3, 0.1), pose(-2.0, 12.34)] {
            assert_eq!(shares(&moved), here);
        }
    }
}
