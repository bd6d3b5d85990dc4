//! Converts cameras and poses between the wire format and the server's types. Incoming values are validated.

use ghostlight_proto::{self as wire, Code, WireError};

use crate::camera::{CameraError, Intrinsics, Pose};

pub(super) fn intrinsics_to_wire(k: &Intrinsics) -> wire::Intrinsics {
    wire::Intrinsics {
        width: k.width,
        height: k.height,
        fx: k.fx,
        fy: k.fy,
        cx: k.cx,
        cy: k.cy,
    }
}

pub(super) fn intrinsics_from_wire(k: &wire::Intrinsics) -> Result<Intrinsics, WireError> {
    Intrinsics::new(k.fx, k.fy, k.cx, k.cy, k.width, k.height).map_err(invalid)
}

pub(super) fn pose_to_wire(pose: &Pose) -> wire::Pose {
    wire::Pose {
        translation: pose.translation.to_array(),
        quaternion: pose.rotation.to_array(),
    }
}

pub(super) fn pose_from_wire(pose: &wire::Pose) -> Result<Pose, WireError> {
    Pose::from_quaternion(pose.quaternion, pose.translation).map_err(invalid)
}

/// The wire format validates its fields first; this reports what it does not check.
fn invalid(error: CameraError) -> WireError {
    let code = match error {
        CameraError::Intrinsics { .. } => Code::Intrinsics,
        CameraError::Size { .. } => Code::Size,
        CameraError::NotFinite { .. }
        | CameraError::NotRotation { .. }
        | CameraError::TooFar { .. } => Code::Pose,
    };
    WireError::new(code, "frame", "a camera", error)
}
