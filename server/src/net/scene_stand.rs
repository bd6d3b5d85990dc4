//! Where the objects of a session's scene stand: what they are put on, and turn about.

use ghostlight_proto::control::Stands;
use ghostlight_proto::{Code, Pose, WireError};
use glam::{DAffine3, DQuat, DVec3};

use crate::frame::RgbdFrame;
use crate::ghost::{GhostSettings, GhostSurface};
use crate::scene::{Instance, Scene, SceneDocument, Standing, Surface};

/// Farthest from the world's origin that an object is put back to, as scene documents have it.
const MAX_DISTANCE_M: f64 = 1e9;

/// The line an object stands on, in world axes: what it turns about.
#[derive(Clone, Copy)]
pub(super) struct Stand {
    pub(super) point: DVec3,
    pub(super) axis: DVec3,
}

/// One object of the scene.
pub(super) struct Object {
    /// Its instances in the scene.
    pub(super) instances: std::ops::Range<usize>,
    pub(super) stand: Stand,
    /// What `turn` has added up to, radians.
    pub(super) turned: f64,
}

impl Object {
    /// Where it is: its first instance, without the scale; nowhere, if it has none.
    pub(super) fn rigid(&self, scene: &Scene) -> Option<DAffine3> {
        let first = scene.instances[self.instances.clone()].first()?;
        let (_, rotation, translation) = first.world_from_object.to_scale_rotation_translation();
        Some(DAffine3::from_rotation_translation(rotation, translation))
    }

    /// The same as the wire has it.
    pub(super) fn stands(&self, scene: &Scene) -> Option<Stands> {
        let (_, rotation, translation) = self.rigid(scene)?.to_scale_rotation_translation();
        Some(Stands {
            pose: Pose {
                translation: translation.to_array(),
                quaternion: rotation.to_array(),
            },
            turned: self.turned,
        })
    }
}

/// Where the wire says that an object was.
pub(super) fn pose_of(stands: &Stands) -> Result<DAffine3, WireError> {
    let translation = DVec3::from_array(stands.pose.translation);
    if translation.abs().max_element() > MAX_DISTANCE_M {
        return Err(WireError::new(
            Code::Pose,
            "place, stands",
            format_args!("a translation of at most {MAX_DISTANCE_M} m"),
            translation,
        ));
    }
    // Within 0.01 of unit length: checked where the message was read.
    let rotation = DQuat::from_array(stands.pose.quaternion).normalize();
    Ok(DAffine3::from_rotation_translation(rotation, translation))
}

/// Where each object's instances are, and what it stands on.
pub(super) fn objects(
    document: &SceneDocument,
    scene: &Scene,
    standings: &[Standing],
) -> Vec<Object> {
    let mut start = 0;
    let mut all = Vec::with_capacity(document.objects.len());
    for (object, &Standing { up: axis, .. }) in document.objects.iter().zip(standings) {
        let name = SceneDocument::name_of(object);
        // Objects come in the document's order; two of one name that follow each other are
        // told apart by nobody, and move as one.
        let n = scene.instances[start..]
            .iter()
            .take_while(|instance| instance.name == name)
            .count();
        let instances = start..start + n;
        all.push(Object {
            stand: Stand {
                point: middle(&scene.instances[instances.clone()], scene, axis),
                axis,
            },
            instances,
            turned: 0.0,
        });
        start += n;
    }
    all
}

/// The middle of an object's bounds across an axis: it then turns on the spot.
fn middle(instances: &[Instance], scene: &Scene, axis: DVec3) -> DVec3 {
    let side = axis.any_orthonormal_vector();
    let to_axes = DQuat::from_mat3(&glam::DMat3::from_cols(side, axis, side.cross(axis)));
    let mut bounds: Option<(DVec3, DVec3)> = None;
    for instance in instances {
        let mesh = &scene.meshes[instance.mesh as usize];
        for position in &mesh.positions {
            let world = instance
                .world_from_object
                .transform_point3(position.as_dvec3());
            let p = to_axes.conjugate() * world;
            bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
        }
    }
    bounds.map_or(DVec3::ZERO, |(lo, hi)| to_axes * ((lo + hi) / 2.0))
}

/// The real surface that a frame's depth shows.
pub(super) struct Sensed(GhostSurface);

impl Sensed {
    /// With the default settings.
    pub(super) fn new(frame: &RgbdFrame) -> Self {
        let mut surface = GhostSurface::new();
        surface.rebuild(&frame.depth, &frame.intrinsics, &GhostSettings::default());
        Self(surface)
    }
}

impl Surface for Sensed {
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)> {
        let plane = self.0.plane_at(u, v, radius_px.round() as u32);
        plane.map(|(point, normal)| (point.as_dvec3(), normal.as_dvec3()))
    }
}
