//! The data that every backend reads for a frame: the scene relative to the camera, the sensed surface, lights
//! and their samples, the lens, the surroundings and the tile plan. Pure functions and plain data; all of it
//! together is a [`frame::PreparedFrame`].

pub(crate) mod ambient_samples;
pub(crate) mod bsdf;
pub(crate) mod camera_levels;
pub(crate) mod cone;
pub(crate) mod environment;
pub(crate) mod frame;
pub(crate) mod lens;
pub(crate) mod lens_plan;
pub(crate) mod light;
pub(crate) mod light_samples;
pub(crate) mod map_levels;
pub(crate) mod map_light;
pub(crate) mod mask;
pub(crate) mod material;
pub(crate) mod mesh_lods;
pub(crate) mod object;
pub(crate) mod occluder;
pub(crate) mod pinhole;
pub(crate) mod placed;
pub(crate) mod placed_scene;
pub(crate) mod scene;
pub(crate) mod sensed;
pub(crate) mod surface;
pub(crate) mod tile_plan;
