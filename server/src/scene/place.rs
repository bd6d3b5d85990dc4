//! Placement of objects: a pure function of their shapes, the requested placements, and one frame. The command line
//! uses it for a document's objects, the service for each click on its page.

use glam::{DAffine3, DMat3, DQuat, DVec3};

use super::document::{PlaceFrame, Placement, UpAxis};
use super::model::Model;
use super::spot::{self, Ground, LOWER_MIDDLE, SpotRequest};
use super::triple::Triple;
use crate::frame::{RgbdFrame, is_valid_depth};
use crate::ghost::DepthPlanes;

/// Radius around a pixel in which the surface's plane is fitted, pixels per pixel of image width: 6 px at 640, wide
/// enough to average a depth sensor's noise, narrow enough to stay on one surface (heuristic).
pub(super) const PLANE_RADIUS: f32 = 6.0 / 640.0;

/// Most plane fits in the search for the nearest pixel with a surface.
const MAX_SEARCHED: usize = 5_000;

/// The frame that placements are relative to.
#[derive(Clone, Copy)]
pub struct PlacementFrame<'a> {
    /// Frame with camera, size and depth.
    pub frame: &'a RgbdFrame,
    /// The real surface measured in the frame.
    pub surface: &'a dyn Surface,
}

/// A real surface on which objects can be placed.
pub trait Surface: Sync {
    /// The plane that fits the surface within `radius_px` of pixel (u, v): a point and the
    /// unit normal that faces the camera, both in camera axes, metres; `None` in a hole.
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)>;
}

/// The surface of a depth map; planes are fitted on demand.
impl Surface for DepthPlanes<'_> {
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)> {
        let (point, normal) = self.at(u, v, radius_px.round() as u32)?;
        Some((point.as_dvec3(), normal.as_dvec3()))
    }
}

/// A request to place an object.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlaceRequest<'a> {
    pub(super) placement: &'a Placement,
    pub(super) oriented: &'a Oriented,
}

/// The resulting placement of an object.
#[derive(Debug, Clone, Copy)]
pub struct Placed {
    /// World from the scaled, upright and rotated model ([`Oriented`]).
    pub(super) world_from_oriented: DAffine3,
    /// Normal of the real surface under the object, camera axes.
    pub(super) surface_normal: Option<DVec3>,
    /// The pixel that is used instead if there is no depth at the requested one.
    pub nearest_px: Option<[f64; 2]>,
}

/// Placements of objects that were placed together.
#[derive(Debug)]
pub(super) struct Placements {
    /// One per object, in order.
    pub(super) placed: Vec<Placed>,
    /// New position of the objects on [`PlaceFrame::Surface`], if they had no room at their own pixels.
    pub(super) moved: Option<Moved>,
}

/// The new position of objects that had no room at their own pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Moved {
    /// Pixel of their centre.
    pub(super) pixel: [f64; 2],
    /// Whether the surface is level.
    pub(super) level: bool,
}

/// Why an object cannot be placed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{problem}")]
pub struct PlaceError {
    /// Index among the objects placed together.
    pub object: usize,
    /// The field of its placement that cannot be satisfied; empty for the placement as a whole.
    pub field: &'static str,
    /// The expected and the actual value.
    pub problem: String,
}

/// A model that is scaled, upright and rotated, but not yet positioned: the input of placement.
#[derive(Debug, Clone, Copy)]
pub(super) struct Oriented {
    pub(super) oriented_from_model: DMat3,
    /// Largest extent along the model's own axes, metres.
    pub(super) size_m: f64,
    /// Bounds of the oriented vertices, metres. The bounds of the oriented box would be larger, and the object would
    /// float above the surface.
    pub(super) bounds_m: (DVec3, DVec3),
}

impl Oriented {
    /// A model with the given bounds, scaled and rotated by its placement.
    pub(super) fn new(
        placement: &Placement,
        up_axis: UpAxis,
        model: &Model,
        bounds: (DVec3, DVec3),
    ) -> Result<Self, Refusal> {
        let scale = scale_of(placement, bounds)?;
        let upright_from_model = match up_axis {
            UpAxis::Y => DMat3::IDENTITY,
            // z becomes y, -y becomes z.
            UpAxis::Z => DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y),
        } * DMat3::from_diagonal(scale);
        let rotation = DQuat::from_array(placement.rotation).normalize();
        let oriented_from_model = DMat3::from_quat(rotation) * upright_from_model;
        Ok(Self {
            oriented_from_model,
            size_m: size_m(placement, bounds)?,
            bounds_m: model.bounds_under(oriented_from_model).unwrap_or_default(),
        })
    }

    /// Half the side of the square that it covers on a surface, metres.
    fn radius_m(&self) -> f64 {
        let (lo, hi) = self.bounds_m;
        (hi.x - lo.x).max(hi.z - lo.z) / 2.0
    }

    /// World from model space.
    pub(super) fn world_from_model(&self, world_from_oriented: DAffine3) -> DAffine3 {
        world_from_oriented * DAffine3::from_mat3(self.oriented_from_model)
    }
}

/// Metres per unit of a model with the given bounds, along its own axes.
fn scale_of(placement: &Placement, (lo, hi): (DVec3, DVec3)) -> Result<DVec3, Refusal> {
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
    Ok(scale)
}

/// Largest extent of a model with the given bounds along its own axes, metres.
pub(super) fn size_m(placement: &Placement, bounds: (DVec3, DVec3)) -> Result<f64, Refusal> {
    let scale = scale_of(placement, bounds)?;
    Ok(((bounds.1 - bounds.0) * scale).abs().max_element())
}

/// The rotation that maps y to `up` and turns z as far as possible towards `front`; if `front` is parallel to `up`,
/// towards `instead`.
pub(super) fn upright(up: DVec3, front: DVec3, instead: DVec3) -> DQuat {
    let across = |d: DVec3| {
        let flat = d - up * up.dot(d);
        // Within a degree of `up`, the direction is only noise (heuristic).
        (flat.length() > 0.017 * d.length()).then(|| flat.normalize_or_zero())
    };
    let z = across(front)
        .or_else(|| across(instead))
        .unwrap_or_else(|| up.any_orthonormal_vector());
    let x = up.cross(z);
    DQuat::from_mat3(&DMat3::from_cols(x, up, z)).normalize()
}

/// Places objects in a frame: those on [`PlaceFrame::Surface`] together, each of the others alone. Depends on nothing
/// but its arguments.
pub(super) fn place(
    requests: &[PlaceRequest<'_>],
    frame: &PlacementFrame<'_>,
) -> Result<Placements, PlaceError> {
    let (grounds, moved) = shared_grounds(requests, frame)?;
    let placed = requests.iter().zip(grounds).enumerate();
    let placed = placed.map(|(object, (request, ground))| {
        place_on(request, ground, frame).map_err(|(field, problem)| PlaceError {
            object,
            field,
            problem,
        })
    });
    Ok(Placements {
        placed: placed.collect::<Result<_, _>>()?,
        moved,
    })
}

/// Places a single object, as [`place`] does.
pub(super) fn place_one(
    request: PlaceRequest<'_>,
    frame: &PlacementFrame<'_>,
) -> Result<Placed, PlaceError> {
    let grounds = shared_grounds(&[request], frame)?.0;
    let ground = grounds.into_iter().next().flatten();
    place_on(&request, ground, frame).map_err(|(field, problem)| PlaceError {
        object: 0,
        field,
        problem,
    })
}

/// Common grounds of the objects on [`PlaceFrame::Surface`]; `None` for the others.
fn shared_grounds(
    requests: &[PlaceRequest<'_>],
    frame: &PlacementFrame<'_>,
) -> Result<(Vec<Option<Ground>>, Option<Moved>), PlaceError> {
    let depth = &frame.frame.depth;
    let theirs: Vec<usize> = (0..requests.len())
        .filter(|&i| requests[i].placement.effective_frame() == PlaceFrame::Surface)
        .collect();
    let mut grounds = vec![None; requests.len()];
    let Some(&first) = theirs.first() else {
        return Ok((grounds, None));
    };
    let wanted: Vec<SpotRequest> = theirs
        .iter()
        .map(|&i| {
            let mut placement = requests[i].placement.clone();
            let picture = *placement.picture.get_or_insert(LOWER_MIDDLE);
            SpotRequest {
                pixel: placement
                    .effective_pixel(depth.width, depth.height)
                    .unwrap_or(picture),
                radius_m: requests[i].oriented.radius_m(),
            }
        })
        .collect();
    let Some(found) = spot::find(&wanted, frame) else {
        return Err(PlaceError {
            object: first,
            field: "",
            problem: "the first frame has no measured surface to stand on".into(),
        });
    };
    let level = found.level;
    let moved = found.moved_to.map(|pixel| Moved { pixel, level });
    for (i, ground) in theirs.into_iter().zip(found.grounds) {
        grounds[i] = Some(ground);
    }
    Ok((grounds, moved))
}

/// Places an object, on `ground` if its frame is [`PlaceFrame::Surface`].
fn place_on(
    &PlaceRequest {
        placement,
        oriented,
    }: &PlaceRequest<'_>,
    ground: Option<Ground>,
    frame: &PlacementFrame<'_>,
) -> Result<Placed, Refusal> {
    let translation = DVec3::from(placement.translation);
    let pose = frame.frame.pose.to_affine();
    let on = |Ground { point, normal }: Ground| {
        // Front towards the camera or, if seen from straight above, towards the image's lower edge.
        let camera_from_surface =
            DAffine3::from_rotation_translation(upright(normal, -point, DVec3::Y), point);
        let (lo, hi) = oriented.bounds_m;
        let bottom_centre = DVec3::new((lo.x + hi.x) / 2.0, lo.y, (lo.z + hi.z) / 2.0);
        pose * camera_from_surface * DAffine3::from_translation(translation - bottom_centre)
    };
    let (mut surface_normal, mut nearest_px) = (None, None);
    let world_from_oriented = match (placement.effective_frame(), ground) {
        (PlaceFrame::World, _) => DAffine3::from_translation(translation),
        // Upright in the first camera's view (its y axis points down), front towards the camera.
        (PlaceFrame::FirstCamera, _) => {
            let stand = upright(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::Y);
            pose * DAffine3::from_rotation_translation(stand, translation)
        }
        (PlaceFrame::Surface, Some(ground)) => {
            surface_normal = Some(ground.normal);
            on(ground)
        }
        (PlaceFrame::Pixel | PlaceFrame::Surface, _) => {
            let depth = &frame.frame.depth;
            let pixel = placement
                .effective_pixel(depth.width, depth.height)
                .ok_or_else(|| {
                    (
                        "pixel",
                        "missing; place.frame \"pixel\" needs it or picture".to_owned(),
                    )
                })?;
            let (ground, elsewhere) = surface_at(pixel, frame)?;
            nearest_px = elsewhere;
            surface_normal = Some(ground.normal);
            on(ground)
        }
    };
    Ok(Placed {
        world_from_oriented,
        surface_normal,
        nearest_px,
    })
}

/// The field that cannot be satisfied, and the reason.
pub(super) type Refusal = (&'static str, String);

/// The surface at a pixel. If there is no depth: the surface at the nearest pixel that has one, and that pixel.
fn surface_at(
    [u, v]: [f64; 2],
    view: &PlacementFrame<'_>,
) -> Result<(Ground, Option<[f64; 2]>), Refusal> {
    let frame = view.frame;
    let (width, height) = (frame.depth.width, frame.depth.height);
    // Negated, so that NaN is rejected too.
    if !((-0.5..f64::from(width) - 0.5).contains(&u)
        && (-0.5..f64::from(height) - 0.5).contains(&v))
    {
        return Err((
            "pixel",
            format!("expected a pixel of the {width}x{height} image, got ({u}, {v})"),
        ));
    }
    if let Some(ground) = Ground::at([u, v], view) {
        return Ok((ground, None));
    }
    let nearest = by_distance(frame, u, v).into_iter().find_map(|pixel| {
        let ground = Ground::at(pixel, view)?;
        Some((ground, Some(pixel)))
    });
    nearest.ok_or_else(|| {
        (
            "pixel",
            format!(
                "pixel ({u}, {v}) has no measured surface in the first frame, and neither has any pixel near it"
            ),
        )
    })
}

/// Pixels with a depth, nearest to (u, v) first; at most [`MAX_SEARCHED`].
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
