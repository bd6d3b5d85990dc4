//! The scene relative to the camera of a frame: objects in the frame's levels of detail, lights, and the
//! acceleration structure.

use crate::accel::{Tlas, TlasInstance};
use crate::frame::RgbdFrame;
use crate::render::checkpoint::{Cancelled, Pulse};
use crate::scene::Light;

use super::lens::Lens;
use super::light::{CameraLight, camera_from_object};
use super::object::Object;
use super::occluder::Occluders;
use super::placed::Placed;
use super::tile_plan::ObjectBounds;

/// Objects placed between two checkpoints.
const PLACED_AT_ONCE: usize = 1 << 12;

/// Objects and lights in camera space. Buffers are kept between frames.
pub(crate) struct PlacedScene {
    /// In the order of objects.
    pub(crate) objects: Vec<Placed>,
    pub(crate) tlas: Tlas,
    /// Object and level of detail of each instance that casts shadows in place of its object; in the acceleration
    /// structure these follow the objects' own instances.
    pub(crate) shadow_lods: Vec<(u32, usize)>,
    pub(crate) occluders: Occluders,
    /// Bounds of the objects that can be hit.
    pub(crate) bounds: Vec<ObjectBounds>,
    pub(crate) lights: Vec<CameraLight>,
    instances: Vec<TlasInstance>,
    shadow_instances: Vec<TlasInstance>,
}

impl PlacedScene {
    /// Empty.
    pub(crate) fn new() -> Self {
        Self {
            objects: Vec::new(),
            tlas: Tlas::new(),
            shadow_lods: Vec::new(),
            occluders: Occluders::default(),
            bounds: Vec::new(),
            lights: Vec::new(),
            instances: Vec::new(),
            shadow_instances: Vec::new(),
        }
    }

    /// Places objects and lights relative to the camera of a frame; large meshes in levels of detail whose error
    /// is at most `lod_error_px` pixels.
    pub(crate) fn place(
        &mut self,
        frame: &RgbdFrame,
        (objects, lights): (&[Object], &[Light]),
        lod_error_px: f32,
        lens: Option<&Lens>,
        pulse: &Pulse<'_>,
    ) -> Result<(), Cancelled> {
        let camera_from_world = frame.pose.inverse();
        let focal_px = frame.intrinsics.fx.max(frame.intrinsics.fy) as f32;
        self.objects.clear();
        self.instances.clear();
        self.shadow_instances.clear();
        self.shadow_lods.clear();
        for (i, object) in objects.iter().enumerate() {
            if i.is_multiple_of(PLACED_AT_ONCE) {
                pulse.check()?;
            }
            let camera_from_object =
                camera_from_object(&camera_from_world, &object.world_from_object);
            let (placed, instance, shadow) =
                object.place(camera_from_object, focal_px, lod_error_px);
            self.objects.push(placed);
            self.instances.push(instance);
            if let Some((instance, lod)) = shadow {
                self.shadow_instances.push(instance);
                self.shadow_lods.push((i as u32, lod));
            }
        }
        self.occluders.update(objects, &self.objects);
        // Instances of objects come first, in their order.
        self.instances.append(&mut self.shadow_instances);
        if !self.tlas.rebuild_while(&self.instances, || pulse.go_on()) {
            return Err(Cancelled);
        }
        self.bounds.clear();
        let bounds = (0..objects.len()).filter_map(|i| self.tlas.bounds(i as u32));
        let bounds =
            bounds.map(|(low, high)| ObjectBounds::new(low, high, &frame.intrinsics, lens));
        self.bounds.extend(bounds);
        self.lights.clear();
        let before_camera = |light| CameraLight::new(light, &camera_from_world);
        self.lights.extend(lights.iter().map(before_camera));
        Ok(())
    }
}
