//! Objects of a scene: their instances, and moving them as a unit.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Scene;
use super::document::{PicturePoint, Placement};
use super::place::{self, Oriented, PlaceError, PlaceRequest, Placed, PlacementFrame};

/// A placed object of the scene's document. It moves as a unit: its instances keep their positions relative to each
/// other.
#[derive(Debug, Clone)]
pub struct SceneObject {
    /// Name in the document; two objects may share a name.
    pub name: String,
    /// Its instances in [`Scene::instances`].
    pub instances: Range<usize>,
    /// The placement in the document, with the resolved size.
    pub(super) placement: Placement,
    pub(super) oriented: Oriented,
    /// One per instance, in order.
    pub(super) model_from_mesh: Vec<DAffine3>,
    pub(super) world_from_oriented: DAffine3,
}

/// The axis that an object turns about, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pivot {
    /// Centre of the object's bounds, metres.
    pub point: DVec3,
    /// The object's upright direction, unit length.
    pub axis: DVec3,
}

impl SceneObject {
    /// The turning axis, through the centre of the bounds, so that the object turns on the spot.
    pub fn pivot(&self) -> Pivot {
        let (lo, hi) = self.oriented.bounds_m;
        Pivot {
            point: self.world_from_oriented.transform_point3((lo + hi) / 2.0),
            axis: self.world_from_oriented.transform_vector3(DVec3::Y),
        }
    }

    /// The placement of the object on the real surface at a pixel of a frame.
    pub fn at(
        &self,
        point: PicturePoint,
        frame: &PlacementFrame<'_>,
    ) -> Result<Placed, PlaceError> {
        place::place_one(
            PlaceRequest {
                placement: &self.placement.on_surface_at(point),
                oriented: &self.oriented,
            },
            frame,
        )
    }

    /// World from object space for each of its instances, in order.
    pub(super) fn instance_transforms(&self) -> impl Iterator<Item = DAffine3> {
        let world_from_model = self.oriented.world_from_model(self.world_from_oriented);
        self.model_from_mesh
            .iter()
            .map(move |&model_from_mesh| world_from_model * model_from_mesh)
    }
}

impl Scene {
    /// Moves an object to a placement.
    ///
    /// # Panics
    /// If there are fewer than `object` + 1 objects.
    pub fn put(&mut self, object: usize, placed: &Placed) {
        self.set_object(object, placed.world_from_oriented);
    }

    /// Moves an object by a rigid motion in world space.
    ///
    /// # Panics
    /// If there are fewer than `object` + 1 objects.
    pub fn move_object(&mut self, object: usize, motion: DAffine3) {
        self.set_object(object, motion * self.objects[object].world_from_oriented);
    }

    fn set_object(&mut self, object: usize, world_from_oriented: DAffine3) {
        let object = &mut self.objects[object];
        object.world_from_oriented = world_from_oriented;
        let instances = &mut self.instances[object.instances.clone()];
        for (instance, transform) in instances.iter_mut().zip(object.instance_transforms()) {
            instance.world_from_object = transform;
        }
    }
}
