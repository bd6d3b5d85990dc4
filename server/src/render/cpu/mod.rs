//! The CPU backend: stages over tiles, in the order of [`Stage::ALL`].
//!
//! Each stage reads what the ones before it wrote and writes records of its own tile only, so tiles
//! run on any number of threads with the same result.

mod ambient;
pub mod bloom;
mod bsdf;
mod camera_levels;
mod caustic;
mod cone;
mod context;
mod defocus;
mod environment;
mod filter;
pub mod glare;
pub mod highlight;
mod lending;
mod lens;
mod lens_plan;
mod lens_walk;
mod light;
mod map_levels;
mod object;
mod output;
mod path;
mod pattern;
mod photon;
mod photon_light;
mod photon_trace;
mod plan;
mod primary;
mod real;
mod scatter;
mod shade;
mod shadow;
mod shadow_group;
mod shadow_rays;
mod shape;
mod surface;
mod tile;

#[cfg(test)]
mod tests;

use std::sync::Arc;

use glam::{DAffine3, Mat3A};
use rayon::prelude::*;

use crate::accel::{MASK_GHOST, MASK_VIRTUAL, Tlas, TlasInstance};
use crate::frame::{ColorImage, FrameGeometry, RgbdFrame};
use crate::ghost::{FilledDepth, GhostSurface};
use crate::scene::{Light, Material, Scene};

use super::checkpoint::{Pulse, Workers};
use super::{Aov, Clock, FrameStats, RenderError, RenderSettings, Rendered, ShadowMethod, Stage};
use super::{Cancelled, Checkpoint};
use ambient::{AmbientPattern, ObjectAmbient, Occluders, RealAmbient};
use camera_levels::CameraLevels;
use context::{FrameContext, Glass, ray_direction};
use environment::{CameraEnvironment, Surroundings};
use lending::Lending;
use lens::Lens;
use light::{CameraLight, camera_from_object};
use map_levels::MapLevels;
use object::{MapLight, Object, Placed, lights_and_map, needs_light, objects};
use output::{Post, aov_image, encode};
use path::Scratch;
use pattern::LightPattern;
use photon::PhotonMap;
use photon_trace::PhotonScratch;
use plan::{ObjectBounds, Reach, TilePlan, plan_tiles};
use real::{occlusion_depth, rebuild};
use scatter::scatters_roughly;
use shade::Shaded;
use shadow_group::ShadowScratch;
use shape::Shape;
use tile::{PixelLight, TILE_PIXELS, Tile, TileGrid};

/// Tiles made between two checkpoints.
const GROWN_AT_ONCE: usize = 1 << 6;

/// Objects put before the camera between two checkpoints.
const PLACED_AT_ONCE: usize = 1 << 12;

/// Virtual objects that bend light: what they let through is photons' where there are caustics.
const MASK_GLASS: u8 = 4;
/// Virtual objects that let light through straight on: thin sheets, and what is blended.
const MASK_SHEET: u8 = 16;
/// Virtual objects that let light through: shadow rays are tinted, not stopped.
const MASK_TRANSMISSIVE: u8 = MASK_GLASS | MASK_SHEET;
/// Virtual objects that stop light.
const MASK_OPAQUE: u8 = MASK_VIRTUAL;
/// Virtual objects that stop light, as they cast shadows on what is real: a coarser version of them
/// may do.
const MASK_SHADOW: u8 = 8;
/// Everything virtual, as it casts shadows on what is real.
const MASK_SHADOW_ANY: u8 = MASK_SHADOW | MASK_TRANSMISSIVE;
/// Everything virtual.
const MASK_VIRTUAL_ANY: u8 = MASK_OPAQUE | MASK_TRANSMISSIVE;
/// Everything that a mixed ray meets.
const MASK_ALL: u8 = MASK_VIRTUAL_ANY | MASK_GHOST;

/// Renders frames of one scene. Buffers live as long as it does.
pub struct CpuRenderer {
    pool: rayon::ThreadPool,
    clock: Clock,
    /// What was odd about the scene, one sentence each.
    pub(super) notes: Vec<String>,
    /// Held for the scene beside its own meshes, bytes.
    pub(super) memory: u64,
    objects: Vec<Object>,
    materials: Vec<Material>,
    material_needs_light: Vec<bool>,
    lights: Vec<Light>,
    map: Option<MapLight>,
    // Per frame.
    ghost: GhostSurface,
    filled: FilledDepth,
    placed: Vec<Placed>,
    tlas: Tlas,
    tlas_instances: Vec<TlasInstance>,
    shadow_instances: Vec<TlasInstance>,
    /// Object and version of each of them.
    shadow_versions: Vec<(u32, usize)>,
    occluders: Occluders,
    ambient_pattern: AmbientPattern,
    ambient: RealAmbient,
    object_ambient: ObjectAmbient,
    bounds: Vec<ObjectBounds>,
    plans: Vec<TilePlan>,
    camera_lights: Vec<CameraLight>,
    camera_environment: CameraEnvironment,
    camera_levels: CameraLevels,
    pattern: LightPattern,
    photons: PhotonMap,
    lens: Lens,
    grid: TileGrid,
    tiles: Vec<Tile>,
    filtered: Vec<Box<[PixelLight; TILE_PIXELS]>>,
    shaded: Vec<Shaded>,
    post: Post,
    shadow_scratch: Lending<ShadowScratch>,
    shade_scratch: Lending<Scratch>,
    photon_scratch: Lending<PhotonScratch>,
}

impl CpuRenderer {
    /// As [`Self::new_while`], to its end.
    #[cfg(test)]
    fn new(scene: &Scene, threads: usize, clock: Clock) -> Result<Self, RenderError> {
        Self::new_while(scene, threads, clock, &super::Uninterrupted)
    }

    /// Builds acceleration structures for a scene, while `checkpoint` lets it. `threads` 0 means one per
    /// core.
    pub fn new_while(
        scene: &Scene,
        threads: usize,
        clock: Clock,
        checkpoint: &dyn Checkpoint,
    ) -> Result<Self, RenderError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .thread_name(|i| format!("render-{i}"))
            .build()
            .map_err(|e| RenderError::Threads(e.to_string()))?;
        let shape = |mesh| {
            let go_on = checkpoint.go_on();
            go_on.then(|| Shape::new(mesh, checkpoint))
        };
        let shapes: Option<Vec<_>> = pool.install(|| scene.meshes.par_iter().map(shape).collect());
        let Some(shapes) = shapes.filter(|_| checkpoint.go_on()) else {
            return Err(RenderError::Cancelled);
        };
        let (mut notes, mut memory) = (Vec::new(), 0);
        let mut shared = Vec::with_capacity(shapes.len());
        for (i, shape) in shapes.into_iter().enumerate() {
            let object = || {
                let of_mesh = scene.instances.iter().find(|x| x.mesh as usize == i);
                of_mesh.map_or_else(String::new, |x| x.name.clone())
            };
            let shape = shape.map_err(|reason| RenderError::Mesh {
                object: object(),
                reason,
            })?;
            if shape.without_versions {
                notes.push(format!(
                    "{}: shown without coarser versions: too many triangles meet at one place",
                    object()
                ));
            }
            memory += shape.memory();
            shared.push(Arc::new(shape));
        }
        let material_needs_light: Vec<bool> = scene.materials.iter().map(needs_light).collect();
        let objects = objects(scene, &shared, &material_needs_light);
        let (lights, map) = lights_and_map(scene);
        memory += map.as_ref().map_or(0, |_| MapLevels::BYTES);
        let threads = pool.current_num_threads();
        Ok(Self {
            pool,
            clock,
            notes,
            memory,
            objects,
            materials: scene.materials.clone(),
            material_needs_light,
            lights,
            map,
            ghost: GhostSurface::new(),
            filled: FilledDepth::default(),
            placed: Vec::new(),
            tlas: Tlas::new(),
            tlas_instances: Vec::new(),
            shadow_instances: Vec::new(),
            shadow_versions: Vec::new(),
            occluders: Occluders::default(),
            ambient_pattern: AmbientPattern::default(),
            ambient: RealAmbient::new(threads),
            object_ambient: ObjectAmbient::new(threads),
            bounds: Vec::new(),
            plans: Vec::new(),
            camera_lights: Vec::new(),
            camera_environment: CameraEnvironment::default(),
            camera_levels: CameraLevels::default(),
            pattern: LightPattern::default(),
            photons: PhotonMap::default(),
            lens: Lens::default(),
            grid: TileGrid::default(),
            tiles: Vec::new(),
            filtered: Vec::new(),
            shaded: Vec::new(),
            post: Post::default(),
            shadow_scratch: Lending::new(threads),
            shade_scratch: Lending::new(threads),
            photon_scratch: Lending::new(threads),
        })
    }

    /// Number of render threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }

    /// Moves an instance of the scene; nothing is built anew. An index past the last is ignored.
    pub fn set_transform(&mut self, instance: usize, world_from_object: DAffine3) {
        if let Some(object) = self.objects.get_mut(instance) {
            object.world_from_object = world_from_object;
        }
    }

    /// Renders one frame, while `checkpoint` lets it.
    pub fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Cancelled> {
        let pulse = Pulse::new(checkpoint);
        pulse.check()?;
        let start = (self.clock)();
        if self.needs_ghost(aovs) {
            let (ghost, filled) = (&mut self.ghost, &mut self.filled);
            let (depth, intrinsics) = (&frame.depth, &frame.intrinsics);
            self.pool
                .install(|| rebuild(ghost, filled, depth, intrinsics, &settings.ghost));
        }
        let ghost_ns = (self.clock)() - start;
        self.render_over_ghost(frame, settings, aovs, ghost_ns, &pulse)
    }

    /// Decodes a frame and renders it; see [`super::Renderer::render_decoding`].
    pub fn render_decoding<E: Send>(
        &mut self,
        geometry: impl FnOnce() -> Result<FrameGeometry, E> + Send,
        color: impl FnOnce() -> Result<ColorImage, E> + Send,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, Cancelled>), E> {
        let pulse = Pulse::new(checkpoint);
        let needs_ghost = self.needs_ghost(aovs);
        let clock = self.clock;
        let (ghost, filled) = (&mut self.ghost, &mut self.filled);
        let (color, geometry) = self.pool.join(color, || {
            let geometry = geometry()?;
            let start = clock();
            if needs_ghost && pulse.go_on() {
                let (depth, intrinsics) = (&geometry.depth, &geometry.intrinsics);
                rebuild(ghost, filled, depth, intrinsics, &settings.ghost);
            }
            Ok((geometry, clock() - start))
        });
        let color = color?;
        let (geometry, ghost_ns) = geometry?;
        let frame = geometry.with_color(color);
        let rendered = self.render_over_ghost(&frame, settings, aovs, ghost_ns, &pulse);
        Ok((frame, rendered))
    }

    /// Whether nothing virtual is there to show.
    fn nothing_virtual(&self) -> bool {
        self.objects.iter().all(|object| object.ghost)
    }

    /// An empty scene models nothing: not even the ghost surface is built.
    fn needs_ghost(&self, aovs: &[Aov]) -> bool {
        !self.nothing_virtual() || aovs.contains(&Aov::Normal)
    }

    /// The stages after the ghost surface, which took `ghost_ns` to build.
    fn render_over_ghost(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        ghost_ns: u64,
        pulse: &Pulse<'_>,
    ) -> Result<Rendered, Cancelled> {
        pulse.check()?;
        let clock = self.clock;
        let start = clock();
        let mut timer = StageTimer {
            clock,
            last: start,
            stage_ns: [0; Stage::ALL.len()],
        };
        timer.stage_ns[Stage::Ghost as usize] = ghost_ns;
        let pinhole = {
            let k = &frame.intrinsics;
            [k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32]
        };

        let has_lens = self.lens.update(&settings.lens, frame, pinhole);
        self.place(frame, settings.detail_px, has_lens, pulse)?;
        self.pattern.update(&settings.shadows);
        // What is known from the start; the rest is put in as stages find it.
        let (nowhere, no_tiles) = (CameraEnvironment::default(), TileGrid::default());
        let mut ctx = FrameContext {
            frame,
            settings,
            pulse,
            tlas: &self.tlas,
            ghost: &self.ghost,
            objects: &self.objects,
            placed: &self.placed,
            materials: &self.materials,
            material_needs_light: &self.material_needs_light,
            lights: &self.camera_lights,
            pattern: &self.pattern,
            photons: None,
            surroundings: Surroundings::Camera(&nowhere),
            camera_levels: None,
            ambient_pattern: &self.ambient_pattern,
            occluders: &self.occluders,
            shadow_versions: &self.shadow_versions,
            ambient: &[],
            object_ambient: &[],
            occlusion_depth: occlusion_depth(frame, settings, &self.filled.z_m),
            grid: &no_tiles,
            tiles: &[],
            filtered: &[],
            glass: Glass::of(&self.objects),
            has_ghost_objects: self.objects.iter().any(|object| object.ghost),
            has_filtered: self.objects.iter().any(|object| object.filtered),
            pinhole,
            lens: has_lens.then_some(&self.lens),
        };
        timer.done(Stage::Plan);
        let glass = |object: &Object| object.mask == MASK_GLASS;
        let lit_glass = !self.lights.is_empty() && self.objects.iter().any(glass);
        if settings.caustics.wanted(lit_glass) && !self.nothing_virtual() {
            let (photons, scratch) = (&mut self.photons, &self.photon_scratch);
            if photons.rebuild(&ctx, scratch, &self.pool) {
                ctx.photons = Some(&self.photons);
            }
        }
        timer.done(Stage::Photons);
        pulse.check()?;

        let n_tiles = if self.nothing_virtual() {
            self.grid.reset(frame.color.width, frame.color.height);
            0
        } else {
            let lights: &[CameraLight] = if settings.shadows.method == ShadowMethod::Off {
                &[]
            } else {
                &self.camera_lights
            };
            let reach = Reach {
                pulse,
                depth: occlusion_depth(frame, settings, &self.filled.z_m),
                size: [frame.color.width, frame.color.height],
                pinhole,
                objects: &self.bounds,
                tlas: &self.tlas,
                lights,
                photons: ctx.photons,
                occluders: settings.ambient.enabled.then_some(&self.occluders),
                skip_proven: settings.shadows.skip_proven,
                lens: has_lens.then_some(&self.lens),
            };
            plan_tiles(
                &reach,
                &self.pool,
                &mut self.plans,
                &mut self.grid,
                &mut self.tiles,
            )
        };
        let n_filtered = match settings.shadows.filter_radius_px {
            0 => 0,
            _ => n_tiles,
        };
        let unlit = || Box::new([PixelLight::default(); TILE_PIXELS]);
        grow(&mut self.filtered, n_filtered, unlit, pulse)?;
        grow(&mut self.shaded, n_tiles, Shaded::new, pulse)?;
        if n_tiles > 0 && self.map.is_none() {
            self.pool
                .install(|| self.camera_environment.rebuild(&frame.color));
        }
        if n_tiles > 0 && self.materials.iter().any(scatters_roughly) {
            self.pool
                .install(|| self.camera_levels.rebuild(&frame.color, pulse));
            ctx.camera_levels = Some(&self.camera_levels);
        }
        timer.done(Stage::Plan);
        pulse.check()?;

        ctx.surroundings = match &self.map {
            None => Surroundings::Camera(&self.camera_environment),
            Some(light) => Surroundings::Map {
                map: &light.map,
                world_from_camera: Mat3A::from_quat(frame.pose.rotation.as_quat()),
                ambient: &light.ambient,
                coarse: &light.coarse,
                levels: &light.levels,
                threshold: light.threshold,
            },
        };
        ctx.grid = &self.grid;
        let tiles = &mut self.tiles[..n_tiles];
        let filtered = &mut self.filtered[..n_filtered];
        let shaded = &mut self.shaded[..n_tiles];
        self.pool.install(|| {
            tiles
                .par_iter_mut()
                .filter(|_| pulse.go_on())
                .for_each(|tile| primary::trace_tile(&ctx, tile))
        });
        timer.done(Stage::Primary);
        pulse.check()?;
        let (changes, ambient_rays) = self.pool.install(|| self.ambient.run(&ctx, tiles));
        ctx.ambient = changes;
        timer.done(Stage::Ambient);
        pulse.check()?;
        self.pool.install(|| {
            // Of a frame that is given up thousands of tiles may be left.
            let tiles = tiles.par_iter_mut().enumerate();
            tiles.filter(|_| pulse.go_on()).for_each(|(slot, tile)| {
                self.shadow_scratch
                    .with(|scratch| shadow::trace_tile(&ctx, tile, slot, scratch));
            });
        });
        timer.done(Stage::Shadow);
        pulse.check()?;
        let tiles = &*tiles;
        ctx.tiles = tiles;
        self.pool.install(|| {
            filtered
                .par_iter_mut()
                .zip(tiles)
                .filter(|_| pulse.go_on())
                .for_each(|(out, tile)| filter::filter_tile(&ctx, tile, out));
        });
        timer.done(Stage::ShadowFilter);
        pulse.check()?;
        ctx.filtered = &*filtered;
        if settings.ambient.enabled {
            let objects = &mut self.object_ambient;
            ctx.object_ambient = self.pool.install(|| objects.run(&ctx, tiles));
        }
        timer.done(Stage::Ambient);
        pulse.check()?;
        // The picture that the composite is written over is copied on the way.
        let ((), rgba) = self.pool.join(
            || {
                let pairs = shaded.par_iter_mut().zip(tiles.par_iter().enumerate());
                pairs.filter(|_| pulse.go_on()).for_each(|(out, tile)| {
                    self.shade_scratch
                        .with(|scratch| shade::shade_tile(&ctx, tile, out, scratch));
                });
            },
            || frame.color.rgba.clone(),
        );
        timer.done(Stage::Shade);
        pulse.check()?;

        let shaded = &*shaded;
        let (width, height) = (frame.color.width, frame.color.height);
        let workers = Workers {
            pool: &self.pool,
            pulse,
        };
        let spread = self
            .post
            .run(workers, tiles, shaded, width, height, settings);
        timer.done(Stage::Post);
        pulse.check()?;
        let mut color = ColorImage {
            width,
            height,
            rgba,
        };
        let added = spread.then_some(self.post.added.as_slice());
        self.pool
            .install(|| encode(&ctx, shaded, added, &mut color));
        timer.done(Stage::Encode);
        let total_ns = ghost_ns + (clock() - start);

        let mut stats = FrameStats {
            pixels: frame.color.rgba.len() as u64,
            ambient_rays,
            photons: ctx.photons.map_or(0, |map| u64::from(map.n_emitted)),
            photons_stored: ctx.photons.map_or(0, PhotonMap::n_stored),
            triangles: ctx.n_triangles(),
            ..FrameStats::default()
        };
        for tile in shaded {
            stats.add(&tile.stats);
        }
        let aovs = aovs
            .iter()
            .map(|&aov| (aov, aov_image(&ctx, shaded, aov)))
            .collect();
        Ok(Rendered {
            color,
            aovs,
            stage_ns: timer.stage_ns,
            total_ns,
            stats,
            lowered: Vec::new(),
        })
    }

    /// Puts objects and lights before the camera.
    fn place(
        &mut self,
        frame: &RgbdFrame,
        detail_px: f32,
        has_lens: bool,
        pulse: &Pulse<'_>,
    ) -> Result<(), Cancelled> {
        let camera_from_world = frame.pose.inverse();
        let focal_px = frame.intrinsics.fx.max(frame.intrinsics.fy) as f32;
        self.placed.clear();
        self.tlas_instances.clear();
        self.shadow_instances.clear();
        self.shadow_versions.clear();
        for (i, object) in self.objects.iter().enumerate() {
            if i.is_multiple_of(PLACED_AT_ONCE) {
                pulse.check()?;
            }
            let camera_from_object =
                camera_from_object(&camera_from_world, &object.world_from_object);
            let (placed, instance, shadow) = object.place(camera_from_object, focal_px, detail_px);
            self.placed.push(placed);
            self.tlas_instances.push(instance);
            if let Some((instance, version)) = shadow {
                self.shadow_instances.push(instance);
                self.shadow_versions.push((i as u32, version));
            }
        }
        self.occluders.update(&self.objects, &self.placed);
        // Instances of objects come first, in their order.
        self.tlas_instances.append(&mut self.shadow_instances);
        if !self
            .tlas
            .rebuild_while(&self.tlas_instances, || pulse.go_on())
        {
            return Err(Cancelled);
        }
        self.bounds.clear();
        let bounds = (0..self.objects.len()).filter_map(|i| self.tlas.bounds(i as u32));
        let lens = has_lens.then_some(&self.lens);
        let bounds =
            bounds.map(|(low, high)| ObjectBounds::new(low, high, &frame.intrinsics, lens));
        self.bounds.extend(bounds);
        self.camera_lights.clear();
        self.camera_lights.extend(
            self.lights
                .iter()
                .map(|light| CameraLight::new(light, &camera_from_world)),
        );
        Ok(())
    }
}

/// Makes a list at least so long: in a large picture that takes longer than a checkpoint may be away.
fn grow<T>(
    list: &mut Vec<T>,
    n: usize,
    new: impl Fn() -> T,
    pulse: &Pulse<'_>,
) -> Result<(), Cancelled> {
    list.reserve(n.saturating_sub(list.len()));
    while list.len() < n {
        if list.len().is_multiple_of(GROWN_AT_ONCE) {
            pulse.check()?;
        }
        list.push(new());
    }
    Ok(())
}

struct StageTimer {
    clock: Clock,
    last: u64,
    stage_ns: [u64; Stage::ALL.len()],
}

impl StageTimer {
    fn done(&mut self, stage: Stage) {
        let now = (self.clock)();
        self.stage_ns[stage as usize] += now - self.last;
        self.last = now;
    }
}
