//! The CPU backend: stages over tiles, in the order of [`Stage::ALL`].
//!
//! Each stage reads the results of earlier stages and writes only records of its own tile, so the result does not
//! depend on the number of threads.

mod ambient;
mod aov;
pub(crate) mod buffers;
mod encode;
mod ghost;
mod light_field;
mod lighting;
mod path;
mod photons;
mod plan;
pub mod post;
mod primary;
mod scatter;
mod scratch;
mod shade;
mod shadow;
mod shadow_filter;
mod tile;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::{DAffine3, Mat3A};

use crate::frame::{ColorImage, FrameGeometry, RgbdFrame};
use crate::scene::{Light, Material, Scene};

use super::aov::Aov;
use super::checkpoint::{Cancelled, Checkpoint, Pulse};
use super::error::RenderError;
use super::prepare::ambient_samples::AmbientSamples;
use super::prepare::environment::Surroundings;
use super::prepare::frame::PreparedFrame;
use super::prepare::lens::Lens;
use super::prepare::light_samples::LightSamples;
use super::prepare::map_levels::MapLevels;
use super::prepare::map_light::{MapLight, lights_and_map};
use super::prepare::mask::MASK_GLASS;
use super::prepare::material::{needs_light, scatters_roughly};
use super::prepare::mesh_lods::MeshLods;
use super::prepare::object::{Object, Transmissive, objects};
use super::prepare::pinhole::Pinhole;
use super::prepare::placed_scene::PlacedScene;
use super::prepare::scene::SceneQuery;
use super::prepare::sensed::{Sensed, occlusion_depth};
use super::prepare::tile_plan::{Reach, TILE_PIXELS};
use super::rendered::Rendered;
use super::settings::{RenderSettings, ShadowMethod};
use super::stage::{Clock, Stage, StageTimes};
use super::stats::FrameStats;
use super::threads::{Threads, Workers};
use ambient::input::AmbientInput;
use aov::aov_image;
use buffers::{BufferPool, FrameBuffers};
use encode::encode;
use light_field::{LightField, RawLight, SurfaceLight};
use lighting::Lighting;
use photons::PhotonMap;
use plan::plan_tiles;
use post::composite::Composite;
use shade::input::{ShadeInput, ShadeTile};
use shade::rough::{RoughPixels, RoughTile};
use shade::shaded::Shaded;
use tile::{LightTile, PixelLight, PrimaryPixels, PrimaryTile};

/// Tiles allocated between two checkpoints.
const GROWN_AT_ONCE: usize = 1 << 6;

/// Renders frames of one scene.
pub struct CpuRenderer {
    threads: Arc<Threads>,
    clock: Clock,
    /// Notes about unusual properties of the scene, one sentence each.
    pub(super) notes: Vec<String>,
    /// Memory held for the scene in addition to its own meshes, bytes.
    pub(super) memory: u64,
    objects: Vec<Object>,
    materials: Vec<Material>,
    material_needs_light: Vec<bool>,
    lights: Vec<Light>,
    map: Option<MapLight>,
    buffers: Arc<BufferPool>,
    // Fields for each frame, which are small.
    placed: PlacedScene,
    ambient_samples: AmbientSamples,
    light_samples: LightSamples,
    lens: Lens,
}

impl CpuRenderer {
    /// A renderer of a scene whose meshes have been built; `threads` and `buffers` are shared with other
    /// renderers.
    pub(super) fn new(
        scene: &Scene,
        lods: Vec<Result<Arc<MeshLods>, String>>,
        threads: Arc<Threads>,
        buffers: Arc<BufferPool>,
        clock: Clock,
    ) -> Result<Self, RenderError> {
        let (mut notes, mut memory) = (Vec::new(), 0);
        let mut shared = Vec::with_capacity(lods.len());
        for (i, lods) in lods.into_iter().enumerate() {
            let object = || {
                let of_mesh = scene.instances.iter().find(|x| x.mesh as usize == i);
                of_mesh.map_or_else(String::new, |x| x.name.clone())
            };
            let lods = lods.map_err(|reason| RenderError::Mesh {
                object: object(),
                reason,
            })?;
            if lods.without_lods {
                notes.push(format!(
                    "{}: shown without coarser levels of detail: too many triangles meet at one place",
                    object()
                ));
            }
            memory += lods.memory();
            shared.push(lods);
        }
        let material_needs_light: Vec<bool> = scene.materials.iter().map(needs_light).collect();
        let objects = objects(scene, &shared, &material_needs_light);
        let (lights, map) = lights_and_map(scene);
        memory += map.as_ref().map_or(0, |_| MapLevels::BYTES);
        Ok(Self {
            threads,
            clock,
            notes,
            memory,
            objects,
            materials: scene.materials.clone(),
            material_needs_light,
            lights,
            map,
            buffers,
            placed: PlacedScene::new(),
            ambient_samples: AmbientSamples::default(),
            light_samples: LightSamples::default(),
            lens: Lens::default(),
        })
    }

    /// Moves an instance of the scene; nothing is rebuilt. An index past the last is ignored.
    pub fn set_transform(&mut self, instance: usize, world_from_object: DAffine3) {
        if let Some(object) = self.objects.get_mut(instance) {
            object.world_from_object = world_from_object;
        }
    }

    /// Renders one frame, unless `checkpoint` cancels it.
    pub fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Cancelled> {
        let pulse = Pulse::new(checkpoint);
        let begun = (self.clock)();
        pulse.check()?;
        let start = (self.clock)();
        let buffers = Arc::clone(&self.buffers);
        let mut lent = buffers.lend(frame.color.rgba.len());
        if self.needs_ghost(aovs) {
            let FrameBuffers { ghost, filled, .. } = &mut *lent;
            let (depth, intrinsics) = (&frame.depth, &frame.intrinsics);
            let workers = Workers {
                threads: &self.threads,
                pulse: &pulse,
            };
            ghost::rebuild(ghost, filled, depth, intrinsics, &settings.ghost, workers);
        }
        let spent = Spent {
            waited_ns: start - begun,
            ghost_ns: (self.clock)() - start,
        };
        self.render_over_ghost(&mut lent, frame, settings, aovs, spent, &pulse)
    }

    /// Decodes a frame and renders it; see [`super::Renderer::render_decoding`].
    pub fn render_decoding<E: Send>(
        &mut self,
        geometry: impl FnOnce() -> Result<FrameGeometry, E>,
        color: impl FnOnce() -> Result<ColorImage, E> + Send,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, Cancelled>), E> {
        let pulse = Pulse::new(checkpoint);
        let needs_ghost = self.needs_ghost(aovs);
        let clock = self.clock;
        let buffers = Arc::clone(&self.buffers);
        let workers = Workers {
            threads: &self.threads,
            pulse: &pulse,
        };
        let decode = || {
            let geometry = geometry()?;
            // A frame that is held waits here, without buffers.
            let begun = clock();
            let on = pulse.go_on();
            let mut lent = buffers.lend(geometry.depth.z_m.len());
            let start = clock();
            if needs_ghost && on {
                let FrameBuffers { ghost, filled, .. } = &mut *lent;
                let (depth, intrinsics) = (&geometry.depth, &geometry.intrinsics);
                ghost::rebuild(ghost, filled, depth, intrinsics, &settings.ghost, workers);
            }
            let spent = Spent {
                waited_ns: start - begun,
                ghost_ns: clock() - start,
            };
            Ok((geometry, lent, spent))
        };
        let (geometry, color) = workers.join(decode, color);
        let color = color?;
        let (geometry, mut lent, spent) = geometry?;
        let frame = geometry.with_color(color);
        let rendered = self.render_over_ghost(&mut lent, &frame, settings, aovs, spent, &pulse);
        Ok((frame, rendered))
    }

    /// An empty scene needs nothing, not even the ghost surface.
    fn needs_ghost(&self, aovs: &[Aov]) -> bool {
        !nothing_virtual(&self.objects) || aovs.contains(&Aov::Normal)
    }

    /// The stages after the ghost surface.
    fn render_over_ghost(
        &mut self,
        buffers: &mut FrameBuffers,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        spent: Spent,
        pulse: &Pulse<'_>,
    ) -> Result<Rendered, Cancelled> {
        pulse.check()?;
        let start = (self.clock)();
        let mut times = StageTimes::start(self.clock);
        times.ns[Stage::Ghost as usize] = spent.ghost_ns;
        let pinhole = Pinhole::new(&frame.intrinsics);
        let size = [frame.color.width, frame.color.height];
        let workers = Workers {
            threads: &self.threads,
            pulse,
        };

        let has_lens = self.lens.update(&settings.lens, frame, pinhole);
        self.placed.place(
            frame,
            (&self.objects, &self.lights),
            settings.lod_error_px,
            has_lens.then_some(&self.lens),
            pulse,
        )?;
        self.light_samples.update(&settings.shadows);
        let nothing_virtual = nothing_virtual(&self.objects);
        let depth = occlusion_depth(frame, settings, &buffers.filled.z_m);
        let lens = has_lens.then_some(&self.lens);
        let prepared = PreparedFrame {
            settings,
            pulse,
            sensed: Sensed {
                color: &frame.color,
                measured: &frame.depth.z_m,
                depth,
                ghost: &buffers.ghost,
                settings: &settings.ghost,
                pinhole,
            },
            scene: SceneQuery {
                pulse,
                tlas: &self.placed.tlas,
                objects: &self.objects,
                placed: &self.placed.objects,
                materials: &self.materials,
                shadow_lods: &self.placed.shadow_lods,
                has_filtered: self.objects.iter().any(|object| object.filtered),
            },
            world_from_camera: Mat3A::from_quat(frame.pose.rotation.as_quat()),
            lights: &self.placed.lights,
            light_samples: &self.light_samples,
            ambient_samples: &self.ambient_samples,
            occluders: &self.placed.occluders,
            material_needs_light: &self.material_needs_light,
            transmissive: Transmissive::of(&self.objects),
            has_ghost_objects: self.objects.iter().any(|object| object.ghost),
            lens,
        };
        times.done(Stage::Plan);

        let glass = |object: &Object| object.mask == MASK_GLASS;
        let lit_glass = !self.lights.is_empty() && self.objects.iter().any(glass);
        let caustics = settings.caustics.wanted(lit_glass) && !nothing_virtual;
        let photons = match caustics {
            true => photons::trace(&prepared, &mut buffers.photons, workers),
            false => None,
        };
        times.done(Stage::Photons);
        pulse.check()?;

        if nothing_virtual {
            buffers.grid.reset(size[0], size[1]);
            buffers.tiles.clear();
        } else {
            let lights = match settings.shadows.method {
                ShadowMethod::Off => &[],
                _ => prepared.lights,
            };
            let reach = Reach {
                pulse,
                depth,
                size,
                pinhole,
                objects: &self.placed.bounds,
                tlas: prepared.scene.tlas,
                lights,
                occluders: settings.ambient.enabled.then_some(prepared.occluders),
                skip_proven: settings.shadows.skip_proven,
                lens,
            };
            plan_tiles(
                &reach,
                photons,
                workers,
                &mut buffers.plans,
                &mut buffers.grid,
                &mut buffers.tiles,
            );
        }
        let (grid, tiles) = (&buffers.grid, buffers.tiles.as_slice());
        let n_tiles = tiles.len();
        let n_filtered = match settings.shadows.filter_radius_px {
            0 => 0,
            _ => n_tiles,
        };
        let unlit = || Box::new([PixelLight::default(); TILE_PIXELS]);
        let primary = grow(&mut buffers.primary, n_tiles, PrimaryTile::new, pulse)?;
        let lit = grow(&mut buffers.lit, n_tiles, LightTile::new, pulse)?;
        let filtered = grow(&mut buffers.filtered, n_filtered, unlit, pulse)?;
        let rough = grow(&mut buffers.rough, n_tiles, RoughTile::default, pulse)?;
        let shaded = grow(&mut buffers.shaded, n_tiles, Shaded::new, pulse)?;
        if n_tiles > 0 && self.map.is_none() {
            buffers.camera_environment.rebuild(&frame.color, workers);
        }
        let roughly = n_tiles > 0 && self.materials.iter().any(scatters_roughly);
        if roughly {
            buffers.camera_levels.rebuild(&frame.color, workers);
        }
        let lighting = Lighting {
            surroundings: match &self.map {
                None => Surroundings::Camera(&buffers.camera_environment),
                Some(light) => light.surroundings(prepared.world_from_camera),
            },
            camera_levels: roughly.then_some(&buffers.camera_levels),
            photons,
        };
        times.done(Stage::Plan);
        pulse.check()?;

        workers.for_each(primary.iter_mut().zip(tiles), |(out, tile)| {
            primary::trace_tile(&prepared, tile, out);
        });
        let primary = &*primary;
        let pixels = PrimaryPixels {
            grid,
            tiles: primary,
        };
        times.done(Stage::Primary);
        pulse.check()?;

        let ambient_input = AmbientInput {
            frame: &prepared,
            surroundings: &lighting.surroundings,
            grid,
        };
        let (ambient, ambient_rays) = buffers.ambient.run(ambient_input, tiles, workers);
        times.done(Stage::Ambient);
        pulse.check()?;

        let read = tiles.iter().zip(primary).enumerate();
        let each = lit.iter_mut().zip(read);
        workers.for_each(each, |(out, (slot, (tile, primary)))| {
            let this = (slot, tile, primary);
            buffers.shadow_scratch.with(|scratch| {
                shadow::trace_tile(&prepared, &lighting, ambient, this, out, scratch);
            });
        });
        let raw = RawLight {
            grid,
            tiles: lit,
            ambient,
        };
        times.done(Stage::Shadow);
        pulse.check()?;

        let each = filtered.iter_mut().zip(tiles.iter().zip(raw.tiles));
        workers.for_each(each, |(out, this)| {
            shadow_filter::filter_tile(&prepared, pixels, raw, this, out);
        });
        let surfaces = SurfaceLight { raw, filtered };
        times.done(Stage::ShadowFilter);
        pulse.check()?;

        let object_ambient: &[_] = match settings.ambient.enabled {
            true => {
                let objects = &mut buffers.object_ambient;
                objects.run(ambient_input, surfaces, (tiles, primary), workers)
            }
            false => &[],
        };
        let input = ShadeInput {
            frame: &prepared,
            lighting,
            primary: pixels,
            light: LightField {
                surfaces,
                object_ambient,
            },
        };
        times.done(Stage::Ambient);
        pulse.check()?;

        let shade_tiles = tiles
            .iter()
            .zip(primary)
            .enumerate()
            .map(|(slot, (tile, primary))| ShadeTile {
                slot,
                tile,
                primary,
            });
        // The camera's picture, over which the composite is written, is copied meanwhile.
        let ((), rgba) = workers.join(
            || {
                let read = shade_tiles.clone().zip(raw.tiles);
                let each = shaded.iter_mut().zip(&mut *rough).zip(read);
                workers.for_each(each, |(out, (this, lit))| {
                    buffers
                        .shade_scratch
                        .with(|scratch| shade::shade_tile(&input, this, lit, out, scratch));
                });
            },
            || frame.color.rgba.clone(),
        );
        pulse.check()?;
        let rough = RoughPixels {
            grid,
            tiles: rough,
            size,
        };
        let each = shaded.iter_mut().zip(shade_tiles);
        workers.for_each(each, |(out, this)| {
            buffers
                .shade_scratch
                .with(|scratch| shade::finish_tile(&input, this, rough, out, scratch));
        });
        let shaded = &*shaded;
        times.done(Stage::Shade);
        pulse.check()?;

        let mut composite = Composite::new(
            prepared.sensed,
            grid,
            (tiles, shaded),
            &mut buffers.composite,
            workers,
        );
        for pass in &mut buffers.passes {
            if pulse.go_on() {
                pass.run(settings, &mut composite);
            }
        }
        times.done(Stage::Post);
        pulse.check()?;

        let [width, height] = size;
        let mut color = ColorImage {
            width,
            height,
            rgba,
        };
        encode(grid, shaded, &buffers.composite, &mut color, workers);
        times.done(Stage::Encode);
        pulse.check()?;
        let total_ns = spent.waited_ns + spent.ghost_ns + ((self.clock)() - start);

        let mut stats = FrameStats {
            pixels: frame.color.rgba.len() as u64,
            ambient_rays,
            photons: photons.map_or(0, |map| u64::from(map.n_emitted)),
            photons_stored: photons.map_or(0, PhotonMap::n_stored),
            triangles: prepared.scene.n_triangles(),
            ..FrameStats::default()
        };
        for tile in shaded {
            stats.add(&tile.stats);
        }
        let aovs = aovs
            .iter()
            .map(|&aov| (aov, aov_image(&input, shaded, aov)))
            .collect();
        Ok(Rendered {
            color,
            aovs,
            stage_ns: times.ns,
            total_ns,
            stats,
            lowered: Vec::new(),
        })
    }
}

/// Times of a frame before the stages after the ghost surface.
#[derive(Clone, Copy)]
struct Spent {
    /// Time for which the frame was held before it began.
    waited_ns: u64,
    ghost_ns: u64,
}

/// Whether there is no virtual object to show.
fn nothing_virtual(objects: &[Object]) -> bool {
    objects.iter().all(|object| object.ghost)
}

/// The first `n` elements of a list, which grows as needed. It grows in steps: for a large picture, growing takes
/// longer than the time allowed between two checkpoints.
fn grow<'a, T>(
    list: &'a mut Vec<T>,
    n: usize,
    new: impl Fn() -> T,
    pulse: &Pulse<'_>,
) -> Result<&'a mut [T], Cancelled> {
    list.reserve(n.saturating_sub(list.len()));
    while list.len() < n {
        if list.len().is_multiple_of(GROWN_AT_ONCE) {
            pulse.check()?;
        }
        list.push(new());
    }
    Ok(&mut list[..n])
}
