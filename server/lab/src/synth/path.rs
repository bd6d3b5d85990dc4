//! The path of a hand-held camera: a slow drift around the desk, with the sway and tremor of a hand.
//!
//! Every coordinate is a sum of sines under 4 Hz, so velocity and acceleration are bounded and the pose is exact
//! at any time, not only at frames.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};

use super::room::DESK_Z;
use ghostlight::camera::Pose;
use ghostlight::numerics::uniform;

/// Centre of the drift, world metres.
const CENTRE: DVec3 = DVec3::new(0.10, -0.50, DESK_Z + 0.70);

/// The point that the camera looks at, world metres.
const TARGET: DVec3 = DVec3::new(0.07, 0.62, DESK_Z + 0.085);

/// Period of the drift, seconds.
const DRIFT_S: f64 = 4.9;

/// Frequencies of a hand's sway, Hz. Physiological tremor of an arm that holds a weight has its power below 4 Hz,
/// because the inertia of the device filters higher frequencies.
const SWAY_HZ: [f64; 4] = [0.43, 0.91, 1.73, 3.1];

/// Amplitude of each frequency, metres. Half of the same number, in radians, is the amplitude of rotation.
const SWAY: [f64; 4] = [0.0060, 0.0028, 0.0010, 0.00035];

/// A path; different seeds sway differently along the same drift.
#[derive(Debug, Clone, Copy)]
pub(super) struct Path {
    seed: u32,
}

impl Path {
    /// The path of a seed.
    pub(super) fn new(seed: u32) -> Self {
        Self { seed }
    }

    fn sway(&self, t: f64, dimension: u32) -> f64 {
        SWAY_HZ
            .iter()
            .zip(SWAY)
            .enumerate()
            .map(|(k, (hz, amplitude))| {
                let phase = f64::from(uniform(k as u32, self.seed, dimension));
                amplitude * (TAU * (hz * t + phase)).sin()
            })
            .sum()
    }

    /// World from camera at `t` seconds from the start.
    pub(super) fn pose(&self, t: f64) -> Pose {
        let drift = TAU * t / DRIFT_S;
        // The drift starts at rest on the left, turns at rest on the right, and is fastest in the middle.
        let swing = -drift.cos();
        let sway = |d: u32| DVec3::new(self.sway(t, d), self.sway(t, d + 1), self.sway(t, d + 2));
        let position = CENTRE
            + DVec3::new(
                0.135 * swing,
                0.045 * (drift * 0.5 + 0.3).sin() - 0.02,
                0.035 * (drift * 0.8).sin(),
            )
            + sway(10);
        let target =
            TARGET + DVec3::new(-0.045 * swing, 0.0, 0.012 * (drift * 0.6).cos()) + sway(20) * 0.8;
        let forward = (target - position).normalize_or_zero();
        let right = forward.cross(DVec3::Z).normalize_or_zero();
        let down = forward.cross(right);
        let level = DQuat::from_mat3(&DMat3::from_cols(right, down, forward));
        let roll =
            DQuat::from_rotation_z(0.018 * (drift * 0.7 + 1.0).sin() + 0.9 * self.sway(t, 30));
        Pose {
            rotation: (level * roll).normalize(),
            translation: position,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_could_have_done_it() {
        for seed in 0..4 {
            let path = Path::new(seed);
            let step = 1e-3;
            let (mut speed, mut acceleration, mut turn) = (0f64, 0f64, 0f64);
            for i in 0..6000 {
                let t = f64::from(i) * step;
                let [a, b, c] = [0.0, step, 2.0 * step].map(|d| path.pose(t + d));
                speed = speed.max((b.translation - a.translation).length() / step);
                let second = c.translation - 2.0 * b.translation + a.translation;
                acceleration = acceleration.max(second.length() / (step * step));
                turn = turn.max(a.rotation.angle_between(b.rotation) / step);
            }
            // A slow walkaround: TUM's fr1/desk has 0.41 m/s and 23 deg/s on average.
            assert!((0.1..0.4).contains(&speed), "{speed} m/s");
            assert!(acceleration < 2.0, "{acceleration} m/s2");
            assert!((0.1..0.6).contains(&turn), "{turn} rad/s");
        }
    }

    #[test]
    fn the_bundled_stretch_moves_as_far_as_it_should() {
        let path = Path::new(1);
        let poses: Vec<Pose> = (0..72).map(|i| path.pose(f64::from(i) / 30.0)).collect();
        let (mut far, mut turned) = (0f64, 0f64);
        for a in &poses {
            for b in &poses {
                far = far.max(a.translation.distance(b.translation));
                turned = turned.max(a.rotation.angle_between(b.rotation).to_degrees());
            }
        }
        assert!((0.2..0.35).contains(&far), "{far} m");
        assert!((12.0..25.0).contains(&turned), "{turned} degrees");
    }
}
