//! Converts the poses of objects to and from wire format.

use ghostlight_proto::control::Stands;
use ghostlight_proto::{Code, Pose, WireError};
use glam::{DAffine3, DQuat, DVec3};

use crate::scene::{Scene, SceneObject};

/// Largest distance from the world's origin to which an object can be moved; the same limit as in scene
/// documents.
const MAX_DISTANCE_M: f64 = 1e9;

/// An object's pose: that of its first instance, without the scale; `None` without instances.
pub(super) fn world_from_rigid(object: &SceneObject, scene: &Scene) -> Option<DAffine3> {
    let first = scene.instances[object.instances.clone()].first()?;
    let (_, rotation, translation) = first.world_from_object.to_scale_rotation_translation();
    Some(DAffine3::from_rotation_translation(rotation, translation))
}

/// An object's pose in wire format; `turned` is the sum of its turns, radians.
pub(super) fn stands(object: &SceneObject, scene: &Scene, turned: f64) -> Option<Stands> {
    let rigid = world_from_rigid(object, scene)?;
    let (_, rotation, translation) = rigid.to_scale_rotation_translation();
    Some(Stands {
        pose: Pose {
            translation: translation.to_array(),
            quaternion: rotation.to_array(),
        },
        turned,
    })
}

/// The pose that a client wants restored.
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
    // The length is within 0.01 of 1: checked when the message was parsed.
    let rotation = DQuat::from_array(stands.pose.quaternion).normalize();
    Ok(DAffine3::from_rotation_translation(rotation, translation))
}
