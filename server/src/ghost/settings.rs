//! How the ghost surface is made from depth, and how rays are traced against it.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How secondary rays find the ghost surface. All report the nearest hit along the ray.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Traversal {
    /// RT2AR's walk (section IV.B): one nearest sample per major-axis step. Approximate.
    BresenhamNearest,
    /// RT2AR's walk with both the floor and the ceiling sample of each step. Approximate.
    Bresenham,
    /// Every cell that the ray crosses. Exact.
    Dda,
    /// Min/max pyramid over the cells. Exact, and the fastest.
    #[default]
    Pyramid,
}

/// What a primary ray sees where the sensor measured nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HolePolicy {
    /// The camera's pixel: virtual objects never cover a hole.
    ShowReal,
    /// The virtual object: a hole never occludes.
    ShowVirtual,
    /// Depth is filled in from around the hole, the farther side wins (a structured-light
    /// sensor's holes lie on the background beside an edge). Where nothing was measured within the
    /// fill's reach (64 pixels along the row or column), nothing is known to be in front and the
    /// virtual object shows: it stays when depth drops out. It then also covers a real thing in
    /// front that the sensor does not see at all (too near, black, mirroring): `show_real` hides
    /// the object instead. Such pixels are counted in `FrameStats::unmeasured_pixels`.
    #[default]
    Fill,
}

/// How the ghost surface is made from depth.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GhostSettings {
    /// Neighbours are connected while their depths differ by less than
    /// `edge_relative * z + edge_sigmas * sigma(z)`. Relative part, 0.001..=1; too small
    /// tears slanted surfaces, too large webs foreground to background.
    #[schemars(range(min = 0.001, max = 1.0))]
    pub edge_relative: f32,
    /// Sensor part, in standard deviations of the depth noise, 0..=20.
    #[schemars(range(min = 0.0, max = 20.0))]
    pub edge_sigmas: f32,
    /// A virtual surface this many standard deviations of depth noise behind the ghost surface still
    /// shows, 0..=20. Keeps noise from eating an object's foot; too large lets objects shine through
    /// thin things.
    #[schemars(range(min = 0.0, max = 20.0))]
    pub occlusion_sigmas: f32,
    /// Secondary and shadow rays ignore the ghost surface within this many standard deviations of
    /// depth noise of where they start, 0..=20. Too small and a noisy surface shadows itself, too
    /// large and contact shadows of real things are lost.
    #[schemars(range(min = 0.0, max = 20.0))]
    pub bias_sigmas: f32,
    /// Holes.
    pub holes: HolePolicy,
    /// How secondary rays find the surface.
    pub traversal: Traversal,
}

impl Default for GhostSettings {
    fn default() -> Self {
        Self {
            edge_relative: 0.03,
            edge_sigmas: 3.0,
            occlusion_sigmas: 2.0,
            bias_sigmas: 4.0,
            holes: HolePolicy::default(),
            traversal: Traversal::default(),
        }
    }
}
