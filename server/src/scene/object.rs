//! Objects of a scene: which instances are theirs, and moving them as one.

use std::ops::Range;

use glam::{DAffine3, DVec3};

use super::Scene;
use super::document::{PicturePoint, Placement};
use super::place::{self, Oriented, PlaceError, PlaceRequest, Placed, PlacementFrame};

/// One object of the scene's document, placed. It moves as one: all its instances keep their
/// places within it.
#[derive(Debug, Clone)]
pub struct SceneObject {
    /// As the document names it; two objects may share a name.
    pub name: String,
    /// Its instances in [`Scene::instances`].
    pub instances: Range<usize>,
    /// As the document asks for it, with the size that it came to have.
    pub(super) placement: Placement,
    pub(super) oriented: Oriented,
    /// Of each instance, in order.
    pub(super) model_from_mesh: Vec<DAffine3>,
    pub(super) world_from_oriented: DAffine3,
}

/// The line that an object turns about, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pivot {
    /// The middle of the object's bounds, metres.
    pub point: DVec3,
    /// The direction that the object stands up in, unit length.
    pub axis: DVec3,
}

impl SceneObject {
    /// What it turns about: the middle of its bounds, so that it turns on the spot.
    pub fn pivot(&self) -> Pivot {
        let (lo, hi) = self.oriented.bounds_m;
        Pivot {
            point: self.world_from_oriented.transform_point3((lo + hi) / 2.0),
            axis: self.world_from_oriented.transform_vector3(DVec3::Y),
        }
    }

    /// Where it would stand on the real surface at a point of a frame's picture.
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

    /// World from object space of each of its instances, in order.
    pub(super) fn instance_transforms(&self) -> impl Iterator<Item = DAffine3> {
        let world_from_model = self.oriented.world_from_model(self.world_from_oriented);
        self.model_from_mesh
            .iter()
            .map(move |&model_from_mesh| world_from_model * model_from_mesh)
    }
}

impl Scene {
    /// Puts an object where it was placed.
    ///
    /// # Panics
    /// If there are fewer than `object` + 1 objects.
    pub fn put(&mut self, object: usize, placed: &Placed) {
        self.set_object(object, placed.world_from_oriented);
    }

    /// Moves an object by a rigid motion of the world.
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
