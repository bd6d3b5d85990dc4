//! Options of the caller, which override the content of the recording's folder.

use crate::camera::Pose;

use super::error::RecordingError;
use super::location::Location;
use super::rig::{CameraModel, DepthRays};
use super::trajectory::Trajectory;
use super::{Listing, OpenOptions, folders, open3d};

/// Options for listing frames: if the caller gives a trajectory, frames need no pose of their own.
pub(super) fn listing_options(options: &OpenOptions) -> OpenOptions {
    OpenOptions {
        assume_static: options.assume_static || options.trajectory.is_some(),
        ..options.clone()
    }
}

/// Applies the caller's depth camera and poses to a listing.
pub(super) fn apply(
    listing: &mut Listing,
    root: &Location,
    options: &OpenOptions,
) -> Result<(), RecordingError> {
    apply_depth_camera(listing, root, options)?;
    if let Some(path) = &options.trajectory {
        let mut notes = std::mem::take(&mut listing.notes);
        notes.retain(|note| !note.contains("taken to be at rest"));
        let entries = &mut listing.entries;
        let deviation = Trajectory::read(&Location::from(path.as_path()))?.apply(
            entries,
            listing.stamped,
            options,
            &mut notes,
        )?;
        listing.notes = notes;
        listing.pose_deviation = Some(deviation);
        if listing.layout == open3d::WITHOUT_POSES {
            listing.layout = folders::LAYOUT.name;
        }
    }
    Ok(())
}

fn apply_depth_camera(
    listing: &mut Listing,
    root: &Location,
    options: &OpenOptions,
) -> Result<(), RecordingError> {
    if options.depth_intrinsics.is_none() && options.color_from_depth.is_none() {
        return Ok(());
    }
    let (own, was) = match &listing.rig.depth {
        DepthRays::Own {
            camera,
            color_from_depth,
        } => (Some(camera.clone()), *color_from_depth),
        DepthRays::Registered => (None, Pose::IDENTITY),
    };
    let camera = match (options.depth_intrinsics, own) {
        (Some(focal), _) => CameraModel::given(focal, root)?,
        (None, Some(own)) => own,
        (None, None) => {
            let mut color = listing.rig.color.clone();
            // Numbers without a size are for the colour pictures' size.
            if color.size.is_none() {
                // A picture that cannot be decoded is left out later.
                let mut images = listing.entries.iter();
                let image = images.find_map(|entry| entry.color.color().ok());
                color.size = image.map(|image| (image.width, image.height));
            }
            color
        }
    };
    let color_from_depth = options.color_from_depth.unwrap_or(was);
    if listing.poses_of_depth {
        let moved = was.then(&color_from_depth.inverse());
        for entry in &mut listing.entries {
            entry.pose = entry.pose.then(&moved);
        }
    }
    listing.rig.depth = DepthRays::Own {
        camera,
        color_from_depth,
    };
    let [x, y, z] = (color_from_depth.translation * 1e3).to_array();
    listing.notes.push(format!(
        "Depth is warped into colour from a camera of its own at {x:.1} {y:.1} {z:.1} mm, as given."
    ));
    Ok(())
}
