//! The part of Embree 4's C interface (`embree4/rtcore*.h`) that the benchmark uses, from a library named at run
//! time. Every call is `unsafe` for the same reason: its signature is declared here by hand.

use std::ffi::{c_char, c_int, c_uint, c_void};
use std::ptr;

use ghostlight::accel::{Ray, RayPacket};
use glam::Vec3A;
use libloading::Library;

const GEOMETRY_TRIANGLE: c_int = 0;
const BUFFER_INDEX: c_int = 0;
const BUFFER_VERTEX: c_int = 1;
const FORMAT_UINT3: c_int = 0x5003;
const FORMAT_FLOAT3: c_int = 0x9003;
const SCENE_ROBUST: c_int = 4;
const QUALITY_MEDIUM: c_int = 1;
const QUERY_COHERENT: c_uint = 1 << 16;
const INVALID: u32 = u32::MAX;

/// `RTCRayHit`.
#[derive(Clone, Copy)]
#[repr(C, align(16))]
pub struct RayHit {
    origin: [f32; 3],
    near: f32,
    direction: [f32; 3],
    time: f32,
    far: f32,
    mask: u32,
    id: u32,
    flags: u32,
    normal: [f32; 3],
    uv: [f32; 2],
    primitive: u32,
    geometry: u32,
    /// Instance and, since 4.3, primitive within an instance array.
    instance: [u32; 5],
}

/// `RTCRayHit16`.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub struct RayHit16 {
    origin: [[f32; 16]; 3],
    near: [f32; 16],
    direction: [[f32; 16]; 3],
    time: [f32; 16],
    far: [f32; 16],
    mask: [u32; 16],
    id: [u32; 16],
    flags: [u32; 16],
    normal: [[f32; 16]; 3],
    uv: [[f32; 16]; 2],
    primitive: [u32; 16],
    geometry: [u32; 16],
    instance: [[u32; 16]; 2],
}

/// `RTCIntersectArguments` and `RTCOccludedArguments`, which have the same layout.
#[repr(C)]
struct Arguments {
    flags: c_uint,
    features: c_uint,
    context: *mut c_void,
    filter: *mut c_void,
    callback: *mut c_void,
}

type Query1 = unsafe extern "C" fn(*mut c_void, *mut RayHit, *mut Arguments);
type Query16 = unsafe extern "C" fn(*const c_int, *mut c_void, *mut RayHit16, *mut Arguments);

/// A mesh in an Embree scene. It is never freed, because a benchmark ends with its process.
pub struct Scene {
    scene: *mut c_void,
    intersect1: Query1,
    occluded1: Query1,
    intersect16: Query16,
    occluded16: Query16,
}

impl Scene {
    /// Builds with medium quality, like the other kernels of the benchmark; `robust` makes it watertight.
    pub fn new(
        library: &'static Library,
        corners: &[Vec3A],
        triangles: &[[u32; 3]],
        robust: bool,
    ) -> Result<Self, libloading::Error> {
        // SAFETY: signatures as in embree4/rtcore_device.h, _scene.h, _geometry.h and _buffer.h; buffers are written
        // within their requested sizes.
        unsafe {
            macro_rules! get {
                ($name:literal: $type:ty) => {
                    *library.get::<$type>(concat!($name, "\0").as_bytes())?
                };
            }
            let new_device =
                get!("rtcNewDevice": unsafe extern "C" fn(*const c_char) -> *mut c_void);
            let new_scene = get!("rtcNewScene": unsafe extern "C" fn(*mut c_void) -> *mut c_void);
            let set_flags = get!("rtcSetSceneFlags": unsafe extern "C" fn(*mut c_void, c_int));
            let set_quality =
                get!("rtcSetSceneBuildQuality": unsafe extern "C" fn(*mut c_void, c_int));
            let new_geometry =
                get!("rtcNewGeometry": unsafe extern "C" fn(*mut c_void, c_int) -> *mut c_void);
            let new_buffer = get!("rtcSetNewGeometryBuffer": unsafe extern "C" fn(*mut c_void, c_int, c_uint, c_int, usize, usize) -> *mut c_void);
            let commit_geometry = get!("rtcCommitGeometry": unsafe extern "C" fn(*mut c_void));
            let attach =
                get!("rtcAttachGeometry": unsafe extern "C" fn(*mut c_void, *mut c_void) -> c_uint);
            let commit_scene = get!("rtcCommitScene": unsafe extern "C" fn(*mut c_void));
            let device = new_device(c"threads=1".as_ptr());
            let scene = new_scene(device);
            set_flags(scene, if robust { SCENE_ROBUST } else { 0 });
            set_quality(scene, QUALITY_MEDIUM);
            let geometry = new_geometry(device, GEOMETRY_TRIANGLE);
            let vertices = new_buffer(geometry, BUFFER_VERTEX, 0, FORMAT_FLOAT3, 12, corners.len());
            for (i, corner) in corners.iter().enumerate() {
                vertices.cast::<[f32; 3]>().add(i).write(corner.to_array());
            }
            let indices = new_buffer(geometry, BUFFER_INDEX, 0, FORMAT_UINT3, 12, triangles.len());
            ptr::copy_nonoverlapping(triangles.as_ptr(), indices.cast(), triangles.len());
            commit_geometry(geometry);
            attach(scene, geometry);
            commit_scene(scene);
            Ok(Self {
                scene,
                intersect1: get!("rtcIntersect1": Query1),
                occluded1: get!("rtcOccluded1": Query1),
                intersect16: get!("rtcIntersect16": Query16),
                occluded16: get!("rtcOccluded16": Query16),
            })
        }
    }

    /// Traces rays one at a time; returns the number of hits.
    pub fn singles(&self, rays: &[RayHit], any: bool) -> usize {
        let query = if any { self.occluded1 } else { self.intersect1 };
        let mut hits = 0;
        for ray in rays {
            let mut ray = *ray;
            // SAFETY: a ray and hit in Embree's layout; a null pointer for the arguments is allowed. `rtcOccluded1`
            // reads and writes its first part, a ray.
            unsafe { query(self.scene, &mut ray, ptr::null_mut()) };
            hits += usize::from(if any {
                ray.far == f32::NEG_INFINITY
            } else {
                ray.geometry != INVALID
            });
        }
        hits
    }

    /// Traces rays sixteen at a time, declared as coherent; returns the number of hits.
    pub fn packets(&self, packets: &[(RayHit16, [c_int; 16])], any: bool) -> usize {
        let query = if any {
            self.occluded16
        } else {
            self.intersect16
        };
        let mut arguments = Arguments {
            flags: QUERY_COHERENT,
            features: c_uint::MAX,
            context: ptr::null_mut(),
            filter: ptr::null_mut(),
            callback: ptr::null_mut(),
        };
        let mut hits = 0;
        for (rays, valid) in packets {
            let mut rays = *rays;
            // SAFETY: as for single rays.
            unsafe { query(valid.as_ptr(), self.scene, &mut rays, &mut arguments) };
            hits += (0..16)
                .filter(|&lane| {
                    valid[lane] != 0
                        && if any {
                            rays.far[lane] == f32::NEG_INFINITY
                        } else {
                            rays.geometry[lane] != INVALID
                        }
                })
                .count();
        }
        hits
    }
}

/// A ray in Embree's layout.
pub fn single(ray: &Ray) -> RayHit {
    RayHit {
        origin: ray.origin.to_array(),
        near: ray.t_min,
        direction: ray.direction.to_array(),
        time: 0.0,
        far: ray.t_max,
        mask: u32::MAX,
        id: 0,
        flags: 0,
        normal: [0.0; 3],
        uv: [0.0; 2],
        primitive: INVALID,
        geometry: INVALID,
        instance: [INVALID; 5],
    }
}

/// A packet in Embree's layout, and its active lanes (-1).
pub fn sixteen((packet, active): &(RayPacket, u16)) -> (RayHit16, [c_int; 16]) {
    let rays = RayHit16 {
        origin: packet.origin,
        near: packet.t_min,
        direction: packet.direction,
        time: [0.0; 16],
        far: packet.t_max,
        mask: [u32::MAX; 16],
        id: [0; 16],
        flags: [0; 16],
        normal: [[0.0; 16]; 3],
        uv: [[0.0; 16]; 2],
        primitive: [INVALID; 16],
        geometry: [INVALID; 16],
        instance: [[INVALID; 16]; 2],
    };
    let valid = std::array::from_fn(|lane| -c_int::from(active >> lane & 1 != 0));
    (rays, valid)
}
