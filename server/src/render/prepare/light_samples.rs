//! Sample points on lights, for shadow rays.

use crate::render::settings::{ShadowMethod, ShadowSettings};

/// Sample points on a light's disc, and their weights.
#[derive(Debug, Clone, Default)]
pub(crate) struct LightSamples {
    points: Vec<[f32; 2]>,
    weights: Vec<f32>,
    /// Number of samples cast before deciding whether a point is in penumbra.
    pub(crate) n_first: usize,
    /// Number of samples, including the first, cast before deciding whether a point beside penumbra is in
    /// penumbra too.
    pub(crate) n_outer: usize,
    /// Each sample in each rotation.
    turned: Vec<[Turned; Self::N_ROTATIONS]>,
    key: Option<(ShadowMethod, u32)>,
}

/// A rotated sample.
#[derive(Debug, Clone, Copy, Default)]
struct Turned {
    point: [f32; 2],
    /// Position along a space-filling curve over the disc.
    place: u8,
}

impl LightSamples {
    /// Rotations of the pattern, one per pixel of a 4x4 block: the mean filter averages over them, and for a
    /// static camera the shadow is static.
    const N_ROTATIONS: usize = 16;

    /// Number of positions into which samples of all rotations are sorted; see [`Self::place`].
    pub(crate) const N_PLACES: usize = 64;

    /// Computes the pattern for `settings`, unless it is the current one.
    pub(crate) fn update(&mut self, settings: &ShadowSettings) {
        let key = (settings.method, settings.samples);
        if self.key == Some(key) {
            return;
        }
        let n = settings.samples as usize;
        // A spiral of equal areas (Vogel 1979).
        let spiral = |n: usize| {
            (0..n).map(move |i| {
                let radius = ((i as f64 + 0.5) / n as f64).sqrt();
                let angle = i as f64 * std::f64::consts::PI * (3.0 - 5f64.sqrt());
                [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
            })
        };
        self.key = Some(key);
        self.n_first = 0;
        self.points = match settings.method {
            ShadowMethod::Off => Vec::new(),
            ShadowMethod::Hard => vec![[0.0, 0.0]],
            ShadowMethod::Naive => spiral(n).collect(),
            ShadowMethod::Adaptive | ShadowMethod::AdaptiveNeighbours => {
                self.n_first = FIRST.len();
                let rest = n.saturating_sub(FIRST.len());
                let mut points = FIRST.to_vec();
                // Away from the rim, where the first samples are.
                points.extend(spiral(rest).map(|[x, y]| [0.9 * x, 0.9 * y]));
                DiscCells::new(n).relax(&mut points);
                // A shadow edge that misses the first samples enters over the rim.
                let radius = |[x, y]: [f32; 2]| x * x + y * y;
                points[FIRST.len()..].sort_by(|a, b| radius(*b).total_cmp(&radius(*a)));
                points
            }
        };
        if self.n_first == 0 {
            self.n_first = self.points.len();
        }
        self.n_outer = self.n_first + (self.points.len() - self.n_first).div_ceil(2);
        self.weights = DiscCells::new(n).weights(&self.points);
        // Bayer order: neighbours get very different angles.
        const ORDER: [u8; LightSamples::N_ROTATIONS] =
            [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
        let rotations = ORDER.map(|i| {
            let angle = f32::from(i) * (std::f32::consts::TAU / Self::N_ROTATIONS as f32);
            [angle.cos(), angle.sin()]
        });
        let turned = self.points.iter().map(|[x, y]| {
            rotations.map(|[c, s]| {
                let point = [x * c - y * s, x * s + y * c];
                let place = along_curve(point);
                Turned { point, place }
            })
        });
        self.turned = turned.collect();
    }

    pub(crate) fn len(&self) -> usize {
        self.points.len()
    }

    /// Sample `i` in a rotation.
    #[inline]
    pub(crate) fn point(&self, i: usize, rotation: u8) -> [f32; 2] {
        self.turned[i][usize::from(rotation)].point
    }

    /// Position of a sample along the curve, below [`Self::N_PLACES`]: samples with successive positions are
    /// neighbours on the light, whatever their rotations.
    #[inline]
    pub(crate) fn place(&self, i: usize, rotation: u8) -> u8 {
        self.turned[i][usize::from(rotation)].place
    }

    #[inline]
    pub(crate) fn weight(&self, i: usize) -> f32 {
        self.weights[i]
    }

    /// The index of a pixel's rotation.
    #[inline]
    pub(crate) fn rotation(x: u32, y: u32) -> u8 {
        ((y & 3) * 4 + (x & 3)) as u8
    }
}

/// Position along the Hilbert curve of a point of the disc, on an 8x8 grid.
fn along_curve([x, y]: [f32; 2]) -> u8 {
    let cell = |x: f32| ((x + 1.0) * 4.0).clamp(0.0, 7.0) as u8;
    let (mut x, mut y) = (cell(x), cell(y));
    let mut place = 0;
    for side in [4, 2, 1] {
        let (right, up) = (u8::from(x & side != 0), u8::from(y & side != 0));
        place += side * side * ((3 * right) ^ up);
        // The curve is oriented differently in each quadrant.
        if up == 0 {
            if right == 1 {
                (x, y) = (7 - x, 7 - y);
            }
            (x, y) = (y, x);
        }
    }
    place
}

/// RT2AR's first samples: the centre of a light and the extremes of its disc.
const FIRST: [[f32; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]];

/// The unit disc divided into small cells, each assigned to the nearest of the sample points.
struct DiscCells {
    centres: Vec<[f32; 2]>,
}

impl DiscCells {
    /// A grid for `n` points: at least fifty cells for each.
    fn new(n: usize) -> Self {
        let side = if n <= 64 { 64 } else { 128 };
        let at = move |i: usize| (i as f32 + 0.5) * (2.0 / side as f32) - 1.0;
        Self {
            centres: (0..side * side)
                .map(|i| [at(i % side), at(i / side)])
                .filter(|[x, y]| x * x + y * y <= 1.0)
                .collect(),
        }
    }

    /// For each point: the number of its cells, and the sum of their centres.
    fn of_points(&self, points: &[[f32; 2]]) -> Vec<(f32, [f32; 2])> {
        let mut sums = vec![(0.0, [0.0; 2]); points.len()];
        for &[x, y] in &self.centres {
            let (mut nearest, mut least) = (0, f32::INFINITY);
            for (k, p) in points.iter().enumerate() {
                let distance = (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y);
                if distance < least {
                    (nearest, least) = (k, distance);
                }
            }
            if let Some((n, [sum_x, sum_y])) = sums.get_mut(nearest) {
                *n += 1.0;
                *sum_x += x;
                *sum_y += y;
            }
        }
        sums
    }

    /// The share of the disc for each point. The first samples are chosen to find edges, not to be evenly
    /// distributed: equal weights would bias the penumbra.
    fn weights(&self, points: &[[f32; 2]]) -> Vec<f32> {
        let total = self.centres.len() as f32;
        let shares = self.of_points(points).into_iter();
        shares.map(|(n, _)| n / total).collect()
    }

    /// Moves all points but the first samples repeatedly to the centroid of their cells (Lloyd 1982). A straight
    /// shadow edge then divides the weights almost as evenly as possible: over all edges, 20 samples have an
    /// error of 2.9 % of the light (RMS), a spiral between the first samples has 3.2 %, and the best that a
    /// search over positions and weights found is 2.85 %.
    fn relax(&self, points: &mut [[f32; 2]]) {
        // With 20 points on this grid, the points are stationary after 20 iterations.
        for _ in 0..20 {
            let sums = self.of_points(points);
            for (point, (n, [x, y])) in points.iter_mut().zip(sums).skip(FIRST.len()) {
                if n > 0.0 {
                    *point = [x / n, y / n];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_share_the_disc_out() {
        for samples in [5, 20, 50, 256] {
            let mut pattern = LightSamples::default();
            pattern.update(&ShadowSettings {
                samples,
                ..ShadowSettings::default()
            });
            assert_eq!(pattern.len(), samples as usize);
            let total: f32 = (0..pattern.len()).map(|i| pattern.weight(i)).sum();
            assert!((total - 1.0).abs() < 1e-5);
            // The mean of x^2 over the unit disc is 1/4; a pattern of points at the rim would differ a lot.
            let moment: f32 = (0..pattern.len())
                .map(|i| pattern.weight(i) * pattern.points[i][0].powi(2))
                .sum();
            if samples >= 20 {
                assert!((moment - 0.25).abs() < 0.03, "{samples}: {moment}");
            }
        }
    }

    #[test]
    fn the_curve_visits_every_cell_once_and_steps_to_a_neighbour() {
        let mut cells = [None; LightSamples::N_PLACES];
        for (i, j) in (0..8u8).flat_map(|j| (0..8u8).map(move |i| (i, j))) {
            let middle = |i: u8| (f32::from(i) + 0.5) / 4.0 - 1.0;
            let cell = &mut cells[usize::from(along_curve([middle(i), middle(j)]))];
            assert_eq!(*cell, None);
            *cell = Some((i, j));
        }
        for pair in cells.windows(2) {
            let [Some((i, j)), Some((k, l))] = pair else {
                panic!("{pair:?}");
            };
            assert_eq!(i.abs_diff(*k) + j.abs_diff(*l), 1);
        }
    }
}
