//! Converts an environment map to a few directional lights and an ambient remainder, after Debevec 2005, "A Median
//! Cut Algorithm for Light Probe Sampling": the map is repeatedly split at the median of a region's energy; each
//! region becomes a light.
//!
//! There are two differences from the paper. Radiance up to twice the map's mean stays ambient, so that lights are
//! placed where the map is bright; wide sources are left to the ambient stage, which computes their shadows. And each
//! light has its region's *net* flux (the integral of radiance times direction), which is the flux that a diffuse
//! surface facing it receives; the plain sum of the paper would be too bright for wide regions.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use glam::DVec3;

use super::environment::Harmonics;
use super::{Environment, Light};

/// Rec.709 luminance weights.
const LUMINANCE: DVec3 = DVec3::new(0.2126, 0.7152, 0.0722);

/// Radiance up to this multiple of the map's mean luminance stays ambient (heuristic: a higher value leaves small
/// bright sources to the few rays of the ambient stage, a lower value spends lights on walls).
const AMBIENT_SHARE: f64 = 2.0;

/// Width of [`Environment::coarse`], texels: 6 degrees each.
const COARSE_WIDTH: u32 = 64;

/// The ambient part of a radiance.
fn ambient_part(radiance: DVec3, threshold: f64) -> DVec3 {
    let luminance = radiance.dot(LUMINANCE);
    if luminance > threshold {
        radiance * (threshold / luminance)
    } else {
        radiance
    }
}

/// An environment split into lights and an ambient remainder.
#[derive(Debug, Clone)]
pub struct EnvironmentLights {
    /// Directional lights, brightest first.
    pub lights: Vec<Light>,
    /// The remainder that the lights do not include.
    pub ambient: Harmonics,
    /// Luminance up to which radiance is ambient.
    pub threshold: f64,
}

/// Columns and rows of a region, half-open.
#[derive(Debug, Clone, Copy)]
struct Region {
    columns: (usize, usize),
    rows: (usize, usize),
}

impl Environment {
    /// Number of lights that represents a map well enough for soft shadows at an acceptable cost.
    pub const DEFAULT_LIGHTS: usize = 8;

    /// The map as at most `n` directional lights, whose angular radius is the spread of their region, and the ambient
    /// remainder. Net flux in luminance is preserved exactly.
    pub fn to_lights(&self, n: usize) -> EnvironmentLights {
        let mean = self.mean_radiance().as_dvec3().dot(LUMINANCE);
        let threshold = AMBIENT_SHARE * mean;
        let ambient_part = |radiance| ambient_part(radiance, threshold);
        let ambient = self.harmonics_of(ambient_part);
        let table = Table::new(self, |radiance| {
            radiance.dot(LUMINANCE) - ambient_part(radiance).dot(LUMINANCE)
        });
        let mut lights: Vec<(f64, Light)> = table
            .cut(n)
            .into_iter()
            .filter_map(|region| self.light_of(&region, ambient_part))
            .collect();
        // The sort is stable: equal lights keep their order.
        lights.sort_by(|a, b| b.0.total_cmp(&a.0));
        EnvironmentLights {
            lights: lights.into_iter().map(|(_, light)| light).collect(),
            ambient,
            threshold,
        }
    }

    /// A coarse map, each texel the mean of its part of the sphere, of radiance up to a luminance of `threshold`: the
    /// part that the lights do not include, or with an infinite threshold all radiance.
    pub fn coarse(&self, threshold: f64) -> Environment {
        let (width, height) = (
            self.width.min(COARSE_WIDTH),
            self.height.min(COARSE_WIDTH / 2),
        );
        let mut sums = vec![(DVec3::ZERO, 0.0); width as usize * height as usize];
        for row in 0..self.height {
            let solid_angle = self.solid_angle(row);
            let to_row = (u64::from(row) * u64::from(height) / u64::from(self.height)) as usize;
            for (column, radiance) in self.row(row).iter().enumerate() {
                let to_column = column * width as usize / self.width as usize;
                let (sum, weight) = &mut sums[to_row * width as usize + to_column];
                *sum += ambient_part(radiance.as_dvec3(), threshold) * solid_angle;
                *weight += solid_angle;
            }
        }
        let texels = sums
            .into_iter()
            .map(|(sum, weight)| (sum / weight).as_vec3());
        Environment {
            width,
            height,
            radiance: Arc::new(texels.collect()),
            world_from_map: self.world_from_map,
        }
    }

    fn light_of(
        &self,
        region: &Region,
        ambient_part: impl Fn(DVec3) -> DVec3,
    ) -> Option<(f64, Light)> {
        // Net flux per channel, and the scalar flux in luminance.
        let mut net = [DVec3::ZERO; 3];
        let mut flux = 0.0;
        for row in region.rows.0..region.rows.1 {
            let solid_angle = self.solid_angle(row as u32);
            let texels = &self.row(row as u32)[region.columns.0..region.columns.1];
            for (i, radiance) in texels.iter().enumerate() {
                let radiance = radiance.as_dvec3();
                let excess = (radiance - ambient_part(radiance)) * solid_angle;
                let direction = self.direction((region.columns.0 + i) as u32, row as u32);
                for (sum, x) in net.iter_mut().zip(excess.to_array()) {
                    *sum += direction * x;
                }
                flux += excess.dot(LUMINANCE);
            }
        }
        let towards = net[0] * LUMINANCE.x + net[1] * LUMINANCE.y + net[2] * LUMINANCE.z;
        let direction = towards.try_normalize()?;
        // For a uniform cap of half-angle a, the mean cosine is (1 + cos a) / 2.
        let mean_cosine = (towards.length() / flux).min(1.0);
        let angular_radius_rad = (2.0 * mean_cosine - 1.0)
            .clamp(-1.0, 1.0)
            .acos()
            .min(FRAC_PI_2);
        let irradiance = DVec3::from(net.map(|n| n.dot(direction).max(0.0)));
        Some((
            towards.length(),
            Light::Directional {
                direction: -direction,
                angular_radius_rad,
                irradiance: irradiance.as_vec3(),
            },
        ))
    }
}

/// Summed-area table of energy.
struct Table {
    width: usize,
    height: usize,
    /// `(width + 1) * (height + 1)` sums over all texels above and to the left.
    sums: Vec<f64>,
}

impl Table {
    fn new(environment: &Environment, energy: impl Fn(DVec3) -> f64) -> Self {
        let (width, height) = (environment.width as usize, environment.height as usize);
        let stride = width + 1;
        let mut sums = vec![0.0; stride * (height + 1)];
        for row in 0..height {
            let solid_angle = environment.solid_angle(row as u32);
            let mut row_sum = 0.0;
            for (column, radiance) in environment.row(row as u32).iter().enumerate() {
                row_sum += energy(radiance.as_dvec3()) * solid_angle;
                sums[(row + 1) * stride + column + 1] = sums[row * stride + column + 1] + row_sum;
            }
        }
        Self {
            width,
            height,
            sums,
        }
    }

    fn energy(&self, region: &Region) -> f64 {
        let at = |column: usize, row: usize| self.sums[row * (self.width + 1) + column];
        let ((c0, c1), (r0, r1)) = (region.columns, region.rows);
        at(c1, r1) - at(c0, r1) - at(c1, r0) + at(c0, r0)
    }

    /// Splits the region with the most energy until there are `n` regions.
    fn cut(&self, n: usize) -> Vec<Region> {
        let whole = Region {
            columns: (0, self.width),
            rows: (0, self.height),
        };
        // Below the rounding error of the sums, a region is not split.
        let least = self.energy(&whole) * 1e-9;
        let mut done = Vec::new();
        let mut open = if n > 0 && least > 0.0 {
            vec![whole]
        } else {
            Vec::new()
        };
        while !open.is_empty() {
            let (brightest, _) = open
                .iter()
                .enumerate()
                .max_by(|a, b| self.energy(a.1).total_cmp(&self.energy(b.1)))
                .unwrap_or((0, &whole));
            if open.len() + done.len() >= n {
                break;
            }
            let region = open.swap_remove(brightest);
            match self.halve(&region) {
                Some((a, b)) => open.extend([a, b].into_iter().filter(|r| self.energy(r) > least)),
                None => done.push(region),
            }
        }
        done.extend(open);
        done
    }

    /// Splits at the median of energy across the longer side (a row is shorter near the poles).
    fn halve(&self, region: &Region) -> Option<(Region, Region)> {
        let ((c0, c1), (r0, r1)) = (region.columns, region.rows);
        let theta = std::f64::consts::PI * (r0 + r1) as f64 / (2 * self.height) as f64;
        let wide = (c1 - c0) as f64 * 2.0 / self.width as f64 * theta.sin();
        let high = (r1 - r0) as f64 / self.height as f64;
        let by_column = (wide >= high && c1 - c0 > 1) || r1 - r0 <= 1;
        let (lo, hi) = if by_column { (c0, c1) } else { (r0, r1) };
        if hi - lo < 2 {
            return None;
        }
        let split = |at: usize| {
            if by_column {
                (
                    Region {
                        columns: (c0, at),
                        ..*region
                    },
                    Region {
                        columns: (at, c1),
                        ..*region
                    },
                )
            } else {
                (
                    Region {
                        rows: (r0, at),
                        ..*region
                    },
                    Region {
                        rows: (at, r1),
                        ..*region
                    },
                )
            }
        };
        let half = self.energy(region) / 2.0;
        let (mut a, mut b) = (lo + 1, hi - 1);
        while a < b {
            let middle = (a + b) / 2;
            if self.energy(&split(middle).0) < half {
                a = middle + 1;
            } else {
                b = middle;
            }
        }
        Some(split(a))
    }
}

#[cfg(test)]
mod tests {
    use super::super::environment::tests::{brute_force, directions, painted};
    use super::*;
    use glam::{DQuat, Vec3};

    fn room() -> Environment {
        painted(64, DQuat::from_rotation_x(0.3), |d| {
            let lamp = d.dot(DVec3::new(0.0, 0.8, 0.6)) > 0.97;
            let window = d.dot(DVec3::new(0.96, 0.28, 0.0)) > 0.93;
            if lamp {
                Vec3::new(30.0, 25.0, 18.0)
            } else if window {
                Vec3::new(6.0, 7.0, 9.0)
            } else {
                Vec3::splat(0.4 + 0.2 * d.y as f32)
            }
        })
    }

    fn luminance_net(environment: &Environment) -> DVec3 {
        let [r, g, b] = environment.harmonics().net_flux();
        r * LUMINANCE.x + g * LUMINANCE.y + b * LUMINANCE.z
    }

    #[test]
    fn net_flux_is_preserved() {
        let environment = room();
        for n in [0, 1, 2, 7, 8, 64] {
            let reduced = environment.to_lights(n);
            assert!(reduced.lights.len() <= n);
            let [r, g, b] = reduced.ambient.net_flux();
            let mut sum = r * LUMINANCE.x + g * LUMINANCE.y + b * LUMINANCE.z;
            for light in &reduced.lights {
                let Light::Directional {
                    direction,
                    irradiance,
                    ..
                } = light
                else {
                    panic!("{light:?}");
                };
                assert!((direction.length() - 1.0).abs() < 1e-12);
                sum -= *direction * irradiance.as_dvec3().dot(LUMINANCE);
            }
            let total = luminance_net(&environment);
            let error = (sum - total).length() / total.length();
            // Results are f32; without lights the bright part is missing.
            assert_eq!(error < 1e-5, n > 0, "{n}: {error}");
        }
    }

    #[test]
    fn diffuse_light_matches_the_map() {
        let environment = room();
        let mean = std::f64::consts::PI * environment.mean_radiance().as_dvec3().dot(LUMINANCE);
        let mean_error = |n: usize| {
            let reduced = environment.to_lights(n);
            let errors = directions().map(|normal| {
                let mut irradiance = reduced.ambient.irradiance(normal.as_vec3()).as_dvec3();
                for light in &reduced.lights {
                    if let Light::Directional {
                        direction,
                        irradiance: e,
                        ..
                    } = light
                    {
                        irradiance += e.as_dvec3() * (-direction.dot(normal)).max(0.0);
                    }
                }
                let exact = brute_force(&environment, normal).dot(LUMINANCE);
                (irradiance.dot(LUMINANCE) - exact).abs() / mean
            });
            errors.sum::<f64>() / 40.0
        };
        // A light represents its region by one direction, so surfaces that see half of the region have an error; more
        // lights reduce it.
        let (few, many) = (mean_error(Environment::DEFAULT_LIGHTS), mean_error(128));
        assert!(few < 0.05 && many < 0.5 * few, "{few} {many}");
    }

    #[test]
    fn lights_sit_where_the_map_is_bright() {
        let reduced = room().to_lights(8);
        let lamp = DVec3::new(0.0, 0.8, 0.6);
        let Light::Directional {
            direction,
            angular_radius_rad,
            ..
        } = reduced.lights[0]
        else {
            panic!();
        };
        let window = DVec3::new(0.96, 0.28, 0.0);
        assert!((-direction).dot(lamp) > 0.97 || (-direction).dot(window) > 0.93);
        assert!(angular_radius_rad < 0.4, "{angular_radius_rad}");
        // One lamp in the dark: the light has the lamp's own size, acos(0.97) = 0.245 rad.
        let lone = painted(128, DQuat::IDENTITY, |d| {
            Vec3::splat(if d.dot(lamp) > 0.97 { 10.0 } else { 0.0 })
        });
        let Light::Directional {
            direction,
            angular_radius_rad,
            ..
        } = lone.to_lights(1).lights[0]
        else {
            panic!();
        };
        assert!((-direction).dot(lamp) > 0.9999);
        assert!(
            (angular_radius_rad - 0.245).abs() < 0.01,
            "{angular_radius_rad}"
        );
    }

    #[test]
    fn dark_and_tiny_maps_are_no_trouble() {
        assert!(
            painted(8, DQuat::IDENTITY, |_| Vec3::ZERO)
                .to_lights(8)
                .lights
                .is_empty()
        );
        for light in painted(1, DQuat::IDENTITY, |_| Vec3::ONE)
            .to_lights(8)
            .lights
        {
            let Light::Directional { irradiance, .. } = light else {
                panic!()
            };
            assert!(irradiance.is_finite());
        }
        // A uniform map is completely ambient.
        let uniform = painted(16, DQuat::IDENTITY, |_| Vec3::ONE).to_lights(8);
        assert!(uniform.lights.is_empty());
    }
}
