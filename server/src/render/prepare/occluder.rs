//! Virtual objects as a few spheres: in which directions from a point they can be, and how much light they can
//! occlude.

use glam::Vec3A;

use super::object::Object;
use super::placed::Placed;

/// Objects that fill less than this cosine-weighted share of a point's hemisphere are ignored, and so is a change
/// of less than half of it. Half of an 8-bit step is at least 1/230 of a pixel's light: `0.5 / 255` of the coded
/// value, times the transfer curve's exponent of 2.2. An object that reflects half of its light, or a point with
/// half of its light from a lamp, changes by half of what the object fills.
pub(crate) const LEAST_SHARE: f32 = 1.0 / 115.0;

/// Most spheres; if there are more objects, neighbouring objects share them.
pub(crate) const MAX_OCCLUDERS: usize = 6;

/// A bounding sphere of some objects, camera space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Occluder {
    pub(crate) center: Vec3A,
    pub(crate) radius: f32,
}

/// All virtual objects, and the sphere of each.
#[derive(Debug, Clone, Default)]
pub(crate) struct Occluders {
    pub(crate) balls: Vec<Occluder>,
    /// Per instance of the scene; `u8::MAX` for objects that are not virtual.
    of_instance: Vec<u8>,
    // Buffers that are kept between frames.
    all: Vec<(u32, Occluder)>,
}

impl Occluders {
    /// Updates the spheres for the current poses of the objects.
    pub(crate) fn update(&mut self, objects: &[Object], placed: &[Placed]) {
        self.balls.clear();
        self.of_instance.clear();
        self.of_instance.resize(objects.len(), u8::MAX);
        self.all.clear();
        for (i, (object, placed)) in (0..).zip(objects.iter().zip(placed)) {
            if object.ghost {
                continue;
            }
            let Some(ball) = object.lods.ball else {
                continue;
            };
            let (center, radius) = placed.ball(ball);
            if center.is_finite() && radius > 0.0 && radius.is_finite() {
                self.all.push((i, Occluder { center, radius }));
            }
        }
        // Splits the largest part at the median of its longest side until there are enough parts.
        let mut parts = Vec::with_capacity(MAX_OCCLUDERS);
        if !self.all.is_empty() {
            parts.push(0..self.all.len());
        }
        while parts.len() < MAX_OCCLUDERS {
            let size = |part: &std::ops::Range<usize>| match part.len() {
                0 | 1 => f32::NEG_INFINITY,
                _ => around(&self.all[part.clone()]).radius,
            };
            let largest =
                (0..parts.len()).max_by(|&a, &b| size(&parts[a]).total_cmp(&size(&parts[b])));
            let Some(largest) = largest.filter(|&i| parts[i].len() > 1) else {
                break;
            };
            let part = parts[largest].clone();
            let all = &mut self.all[part.clone()];
            let (low, high) = all.iter().fold(
                (Vec3A::INFINITY, Vec3A::NEG_INFINITY),
                |(low, high), (_, ball)| (low.min(ball.center), high.max(ball.center)),
            );
            let axis = (high - low).max_position();
            let by_axis = |a: &(u32, Occluder), b: &(u32, Occluder)| {
                let along = a.1.center[axis].total_cmp(&b.1.center[axis]);
                along.then(a.0.cmp(&b.0))
            };
            all.sort_unstable_by(by_axis);
            let middle = part.start + part.len() / 2;
            parts[largest] = part.start..middle;
            parts.push(middle..part.end);
        }
        for (k, part) in parts.into_iter().enumerate() {
            self.balls.push(around(&self.all[part.clone()]));
            for (i, _) in &self.all[part] {
                self.of_instance[*i as usize] = k as u8;
            }
        }
    }

    /// The sphere that contains an instance.
    pub(crate) fn of(&self, instance: u32) -> Option<usize> {
        let k = *self.of_instance.get(instance as usize)?;
        (k != u8::MAX).then_some(usize::from(k))
    }

    /// Whether objects can change the ambient light of any point in a sphere, whatever its normal.
    pub(crate) fn reach(&self, (center, radius): (Vec3A, f32)) -> bool {
        let sum: f32 = self
            .balls
            .iter()
            .map(|ball| {
                let distance = (ball.center - center).length() - radius;
                // The form factor of a sphere is at most this.
                if distance <= ball.radius {
                    1.0
                } else {
                    (ball.radius / distance).powi(2)
                }
            })
            .sum();
        sum.is_nan() || sum >= LEAST_SHARE
    }
}

impl Occluder {
    /// An upper bound on the share of light that the sphere can occlude at a point.
    pub(crate) fn form_factor_bound(&self, point: Vec3A, normal: Vec3A) -> f32 {
        let to = self.center - point;
        let along = to.dot(normal);
        if along <= -self.radius {
            return 0.0;
        }
        let squared = to.length_squared();
        let sine_squared = self.radius * self.radius / squared;
        if sine_squared.is_nan() || sine_squared >= 1.0 {
            return 1.0;
        }
        // The cosine to the normal is largest at the side of the cone nearest to the normal.
        let (sine, cosine) = (sine_squared.sqrt(), (1.0 - sine_squared).sqrt());
        let c = (along / squared.sqrt()).clamp(-1.0, 1.0);
        let largest = if c >= cosine {
            1.0
        } else {
            c * cosine + (1.0 - c * c).sqrt() * sine
        };
        // Projected solid angle over pi, with that cosine for the whole cone.
        (2.0 * (1.0 - cosine) * largest.max(0.0)).min(1.0)
    }
}

/// A bounding sphere of spheres.
fn around(balls: &[(u32, Occluder)]) -> Occluder {
    if let [(_, only)] = balls {
        return *only;
    }
    let (low, high) = balls.iter().fold(
        (Vec3A::INFINITY, Vec3A::NEG_INFINITY),
        |(low, high), (_, ball)| {
            let r = Vec3A::splat(ball.radius);
            (low.min(ball.center - r), high.max(ball.center + r))
        },
    );
    let center = (low + high) * 0.5;
    let reach = |ball: &Occluder| (ball.center - center).length() + ball.radius;
    let radius = balls
        .iter()
        .map(|(_, ball)| reach(ball))
        .fold(0.0, f32::max);
    Occluder { center, radius }
}
