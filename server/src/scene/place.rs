//! Where an object stands.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::document::{PlaceFrame, Placement, UpAxis};
use super::model::Model;
use super::resolve::{ResolveOptions, bounds_under};
use super::spot::Ground;
use super::triple::Triple;
use crate::frame::{RgbdFrame, is_valid_depth};

/// Radius around a pixel within which the surface's plane is fitted, pixels per pixel of
/// image width: 6 px at 640, wide enough to average a depth sensor's noise, narrow enough to
/// stay on one thing (heuristic).
pub(super) const PLANE_RADIUS: f32 = 6.0 / 640.0;

/// Fits tried while looking for the nearest pixel with a surface.
const MAX_SEARCHED: usize = 5_000;

/// A placed object.
pub(super) struct Placed {
    pub(super) world_from_model: DAffine3,
    /// Normal of the real surface it stands on, camera axes.
    pub(super) surface_normal: Option<DVec3>,
    /// Nothing was measured where it was put: the pixel where it stands instead.
    pub(super) instead: Option<[f64; 2]>,
}

/// A model scaled, upright and turned, but not put anywhere yet.
#[derive(Clone, Copy)]
pub(super) struct Turned {
    pub(super) turned_from_model: DMat3,
    /// Largest extent, metres.
    pub(super) size_m: f64,
}

impl Turned {
    /// A model of known bounds as its placement has it, or the field that cannot be met, and why.
    pub(super) fn new(
        placement: &Placement,
        up_axis: UpAxis,
        (lo, hi): (DVec3, DVec3),
    ) -> Result<Self, Refusal> {
        let extent = (hi - lo).max_element();
        let scale = match (placement.scale, placement.size_m) {
            (Some(Triple(scale)), _) => DVec3::from(scale),
            (None, Some(size)) => DVec3::splat(size / extent),
            (None, None) => DVec3::ONE,
        };
        if !scale.is_finite() {
            return Err((
                "size_m",
                format!("expected a mesh with an extent, got {extent}"),
            ));
        }
        let upright_from_model = match up_axis {
            UpAxis::Y => DMat3::IDENTITY,
            // z becomes y, -y becomes z.
            UpAxis::Z => DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
        } * DMat3::from_diagonal(scale);
        let rotation = DQuat::from_array(placement.rotation).normalize();
        Ok(Self {
            turned_from_model: DMat3::from_quat(rotation) * upright_from_model,
            size_m: ((hi - lo) * scale).abs().max_element(),
        })
    }

    /// Half of what it covers of a surface that it stands on, metres.
    pub(super) fn radius_m(&self, model: &Model) -> f64 {
        let (lo, hi) = bounds_under(model, self.turned_from_model).unwrap_or_default();
        (hi.x - lo.x).max(hi.z - lo.z) / 2.0
    }
}

/// The rotation that takes y to `up` and turns z towards `front` as far as that allows; if
/// `front` lies along `up`, towards `instead`.
pub(super) fn upright(up: DVec3, front: DVec3, instead: DVec3) -> DQuat {
    let across = |d: DVec3| {
        let flat = d - up * up.dot(d);
        // Under a degree off the axis its direction is chance (heuristic).
        (flat.length() > 0.017 * d.length()).then(|| flat.normalize_or_zero())
    };
    let z = across(front)
        .or_else(|| across(instead))
        .unwrap_or_else(|| up.any_orthonormal_vector());
    let x = up.cross(z);
    DQuat::from_mat3(&DMat3::from_cols(x, up, z)).normalize()
}

/// Places a model, on `ground` if its frame is `surface`, or says which field of the placement
/// cannot be met, and why.
pub(super) fn place(
    placement: &Placement,
    turned: &Turned,
    model: &Model,
    ground: Option<Ground>,
    options: &ResolveOptions<'_>,
) -> Result<Placed, Refusal> {
    let turned_from_model = turned.turned_from_model;
    let translation = DVec3::from(placement.translation);
    let pose = options.first_frame.pose.to_affine();
    let on = |Ground { point, normal }: Ground| {
        // Towards the camera; seen from straight above, towards the image's lower edge.
        let camera_from_surface =
            DAffine3::from_rotation_translation(upright(normal, -point, DVec3::Y), point);
        // Of the turned vertices rather than the turned box, which would hover.
        let (lo, hi) = bounds_under(model, turned_from_model).unwrap_or_default();
        let bottom_centre = DVec3::new((lo.x + hi.x) / 2.0, lo.y, (lo.z + hi.z) / 2.0);
        pose * camera_from_surface * DAffine3::from_translation(translation - bottom_centre)
    };
    let (mut surface_normal, mut instead) = (None, None);
    let world_from_turned = match (placement.effective_frame(), ground) {
        (PlaceFrame::World, _) => DAffine3::from_translation(translation),
        // Upright in the first camera's view (its y points down), front towards it.
        (PlaceFrame::FirstCamera, _) => {
            let stand = upright(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::Y);
            pose * DAffine3::from_rotation_translation(stand, translation)
        }
        (PlaceFrame::Surface, Some(ground)) => {
            surface_normal = Some(ground.normal);
            on(ground)
        }
        (PlaceFrame::Pixel | PlaceFrame::Surface, _) => {
            let depth = &options.first_frame.depth;
            let pixel = placement
                .effective_pixel(depth.width, depth.height)
                .ok_or_else(|| {
                    (
                        "pixel",
                        "missing; place.frame \"pixel\" needs it or picture".to_owned(),
                    )
                })?;
            let (ground, elsewhere) = surface_at(pixel, options)?;
            instead = elsewhere;
            surface_normal = Some(ground.normal);
            on(ground)
        }
    };
    Ok(Placed {
        world_from_model: world_from_turned * DAffine3::from_mat3(turned_from_model),
        surface_normal,
        instead,
    })
}

/// Which field is wrong, and how.
type Refusal = (&'static str, String);

/// The surface at a pixel or, where nothing was measured, at the nearest pixel that has one, which
/// then comes second.
fn surface_at(
    [u, v]: [f64; 2],
    options: &ResolveOptions<'_>,
) -> Result<(Ground, Option<[f64; 2]>), Refusal> {
    let frame = options.first_frame;
    let (width, height) = (frame.depth.width, frame.depth.height);
    // Negated, so that NaN fails too.
    if !((-0.5..f64::from(width) - 0.5).contains(&u)
        && (-0.5..f64::from(height) - 0.5).contains(&v))
    {
        return Err((
            "pixel",
            format!("expected a pixel of the {width}x{height} image, got ({u}, {v})"),
        ));
    }
    if let Some(ground) = Ground::at([u, v], options) {
        return Ok((ground, None));
    }
    let nearest = by_distance(frame, u, v).into_iter().find_map(|pixel| {
        let ground = Ground::at(pixel, options)?;
        Some((ground, Some(pixel)))
    });
    nearest.ok_or_else(|| {
        (
            "pixel",
            format!(
                "pixel ({u}, {v}) has no measured surface in the first frame, and none near it has one"
            ),
        )
    })
}

/// Pixels with a depth, nearest to (u, v) first; [`MAX_SEARCHED`] at most.
fn by_distance(frame: &RgbdFrame, u: f64, v: f64) -> Vec<[f64; 2]> {
    let mut pixels: Vec<(f64, u32, u32)> = Vec::new();
    for y in 0..frame.depth.height {
        for x in 0..frame.depth.width {
            let z = frame.depth.z_m[y as usize * frame.depth.width as usize + x as usize];
            if is_valid_depth(z) {
                let distance = (f64::from(x) - u).powi(2) + (f64::from(y) - v).powi(2);
                pixels.push((distance, y, x));
            }
        }
    }
    let order = |a: &(f64, u32, u32), b: &(f64, u32, u32)| {
        a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2)))
    };
    if pixels.len() > MAX_SEARCHED {
        pixels.select_nth_unstable_by(MAX_SEARCHED, order);
        pixels.truncate(MAX_SEARCHED);
    }
    pixels.sort_by(order);
    pixels
        .into_iter()
        .map(|(_, y, x)| [f64::from(x), f64::from(y)])
        .collect()
}
