use super::*;
use crate::camera::Intrinsics;
use crate::frame::{ColorImage, DepthImage, RgbdFrame};
use crate::scene::{ObjectFlags, PicturePoint, Surface};
use glam::DAffine3;
use proptest::prelude::*;

mod bad;
mod own_place;

/// A plane in camera axes, with a hole in the left part of the image.
struct Plane {
    intrinsics: Intrinsics,
    point: DVec3,
    normal: DVec3,
    hole_until: f32,
}

impl Surface for Plane {
    fn plane_at(&self, u: f32, v: f32, _radius_px: f32) -> Option<(DVec3, DVec3)> {
        if u < self.hole_until {
            return None;
        }
        let ray = self.intrinsics.unproject(f64::from(u), f64::from(v), 1.0);
        let z = self.point.dot(self.normal) / ray.dot(self.normal);
        (z > 0.0).then(|| (ray * z, self.normal))
    }
}

/// A camera 0.8 m over a floor, looking down at 30 degrees, somewhere in the world.
fn floor() -> (RgbdFrame, Plane) {
    let intrinsics = Intrinsics::new(100.0, 100.0, 49.5, 39.5, 100, 80).unwrap();
    let tilt = 30f64.to_radians();
    let normal = DVec3::new(0.0, -tilt.cos(), -tilt.sin());
    let plane = Plane {
        intrinsics,
        point: -normal * 0.8,
        normal,
        hole_until: 10.0,
    };
    let z = (0..80)
        .flat_map(|v| (0..100).map(move |u| (u as f32, v as f32)))
        .map(|(u, v)| {
            plane
                .plane_at(u, v, 1.0)
                .map_or(f32::NAN, |(p, _)| p.z as f32)
        })
        .collect();
    let frame = RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage::filled(100, 80, [0; 4]),
        depth: DepthImage::from_metres(100, 80, z),
        intrinsics,
        pose: Pose {
            rotation: DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 0.7),
            translation: DVec3::new(5.0, -3.0, 2.0),
        },
    };
    (frame, plane)
}

/// A box 1 wide (x), 2 high (y), 4 deep (z), its corner at the origin.
const BRICK: &str = "v 0 0 0\nv 1 0 0\nv 1 2 0\nv 0 2 0\nv 0 0 4\nv 1 0 4\nv 1 2 4\nv 0 2 4\nf 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 3 4 8 7\nf 2 3 7 6\nf 1 5 8 4\n";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("brick.obj"), BRICK).unwrap();
    let mut hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
    hdr.extend([128, 64, 0, 129, 8, 8, 8, 129]);
    std::fs::write(folder.path().join("sky.hdr"), hdr).unwrap();
    folder
}

fn resolve_document(document: &SceneDocument) -> Result<(Scene, Vec<String>), SceneError> {
    let folder = folder();
    let (frame, surface) = floor();
    let frame = PlacementFrame {
        frame: &frame,
        surface: &surface,
    };
    document.resolve(folder.path(), &frame)
}

fn resolve(text: &str) -> Result<(Scene, Vec<String>), SceneError> {
    resolve_document(&SceneDocument::parse(text, "scene.json")?)
}

/// With the command line's `--place`.
fn resolve_at(text: &str, pixel: [f64; 2]) -> Result<(Scene, Vec<String>), SceneError> {
    let folder = folder();
    let file = folder.path().join("scene.json");
    std::fs::write(&file, text).unwrap();
    let flags = ObjectFlags {
        place: Some(PicturePoint::Pixel(pixel)),
        ..ObjectFlags::default()
    };
    let (mut document, _) = flags.document(Some(&file))?;
    document.file = "scene.json".to_owned();
    resolve_document(&document)
}

fn object(fields: &str) -> String {
    format!("{{\"version\": 1, \"objects\": [{{\"mesh\": \"brick.obj\", {fields}}}]}}")
}

/// Corners of the first instance in the first camera's axes.
fn corners(scene: &Scene) -> Vec<DVec3> {
    let (frame, _) = floor();
    let camera_from_world = frame.pose.inverse();
    scene.meshes[0]
        .positions
        .iter()
        .map(|p| {
            let p = scene.instances[0]
                .world_from_object
                .transform_point3(p.as_dvec3());
            camera_from_world.transform_point(p)
        })
        .collect()
}

#[test]
fn a_pixel_placement_stands_upright_facing_the_camera() {
    for (rotation, scale) in [
        ("[0, 0, 0, 1]", "0.1"),
        ("[0, 0, 0.3826834, 0.9238795]", "[0.1, 0.2, 0.05]"),
        ("[0.1, 0.7, -0.1, 0.7]", "-0.1"),
    ] {
        let text = object(&format!(
            "\"place\": {{\"pixel\": [60, 50], \"rotation\": {rotation}, \"scale\": {scale}}}"
        ));
        let (scene, notes) = resolve(&text).unwrap();
        // A scene without lights gets one, with a note; there are no other notes.
        assert_eq!(notes.len(), 1, "{notes:?}");
        assert!(notes[0].contains("names no light"), "{notes:?}");
        assert_eq!(scene.lights.len(), 1);
        let (frame, plane) = floor();
        let (point, up) = plane.plane_at(60.0, 50.0, 6.0).unwrap();
        let z = (-point - up * up.dot(-point)).normalize_or_zero();
        let x = up.cross(z);
        // In the placed frame, it touches the surface and is centred over the pixel.
        let placed: Vec<DVec3> = corners(&scene)
            .iter()
            .map(|p| {
                let d = *p - point;
                DVec3::new(d.dot(x), d.dot(up), d.dot(z))
            })
            .collect();
        let lo = placed.iter().copied().reduce(DVec3::min).unwrap();
        let hi = placed.iter().copied().reduce(DVec3::max).unwrap();
        assert!(lo.y.abs() < 1e-9 && hi.y > 0.05, "{lo} {hi}");
        assert!((lo + hi).x.abs() < 1e-9 && (lo + hi).z.abs() < 1e-9);
        assert!(frame.pose.translation.is_finite());
    }
    // Without rotation, width, height and depth are along the placed axes, with the front towards the camera.
    let (scene, _) = resolve(&object(
        "\"place\": {\"pixel\": [49.5, 50], \"size_m\": 0.4}",
    ))
    .unwrap();
    let c = corners(&scene);
    let (_, plane) = floor();
    let [width, height, depth] = [c[1] - c[0], c[3] - c[0], c[4] - c[0]];
    assert!(
        (width - DVec3::new(0.1, 0.0, 0.0)).length() < 1e-9,
        "{width}"
    );
    assert!((height - plane.normal * 0.2).length() < 1e-9, "{height}");
    assert!(
        (depth.length() - 0.4).abs() < 1e-9 && depth.z < -0.3,
        "{depth}"
    );
}

#[test]
fn translation_moves_along_the_surface() {
    let base = resolve(&object("\"place\": {\"pixel\": [60, 50]}"))
        .unwrap()
        .0;
    let moved = resolve(&object(
        "\"place\": {\"pixel\": [60, 50], \"translation\": [0, 0.25, 0]}",
    ))
    .unwrap()
    .0;
    let (_, plane) = floor();
    let shift = corners(&moved)[0] - corners(&base)[0];
    assert!((shift - plane.normal * 0.25).length() < 1e-9, "{shift}");
}

#[test]
fn world_and_camera_frames_are_rigid() {
    let (scene, _) = resolve(&object(
        "\"place\": {\"frame\": \"world\", \"translation\": [1, 2, 3], \"rotation\": [0, 0, 0.70710678, 0.70710678]}",
    ))
    .unwrap();
    let p = scene.instances[0]
        .world_from_object
        .transform_point3(DVec3::X);
    assert!((p - DVec3::new(1.0, 3.0, 3.0)).length() < 1e-7, "{p}");
    // Upright in the first camera's view: the brick's height points up, its front towards the camera.
    let (scene, _) = resolve(&object(
        "\"place\": {\"frame\": \"first_camera\", \"translation\": [0, 0, 3]}",
    ))
    .unwrap();
    let c = corners(&scene);
    assert!((c[0] - DVec3::new(0.0, 0.0, 3.0)).length() < 1e-9);
    assert!((c[3] - c[0] - DVec3::new(0.0, -2.0, 0.0)).length() < 1e-9);
    assert!((c[4] - c[0] - DVec3::new(0.0, 0.0, -4.0)).length() < 1e-9);
    // A mesh with z up: z becomes up, -y becomes the front.
    let (scene, _) = resolve(&object(
        "\"up\": \"z\", \"place\": {\"frame\": \"first_camera\"}",
    ))
    .unwrap();
    let c = corners(&scene);
    assert!((c[4] - c[0] - DVec3::new(0.0, -4.0, 0.0)).length() < 1e-9);
    assert!((c[3] - c[0] - DVec3::new(0.0, 0.0, 2.0)).length() < 1e-9);
}

#[test]
fn the_place_flag_overrides_the_first_object() {
    let flagged = resolve_at(
        &object("\"place\": {\"frame\": \"world\", \"translation\": [9, 9, 9]}"),
        [60.0, 50.0],
    )
    .unwrap()
    .0;
    let written = resolve(&object("\"place\": {\"pixel\": [60, 50]}"))
        .unwrap()
        .0;
    assert_eq!(corners(&flagged), corners(&written));
    for (pixel, expected) in [
        (
            [100.0, 50.0],
            "scene.json: objects[0].place.pixel: expected a pixel of the 100x80 image, got (100, 50)",
        ),
        (
            [f64::NAN, 50.0],
            "scene.json: objects[0].place.pixel[0]: expected a number from -0.5 to 100000, got NaN",
        ),
    ] {
        let error = resolve_at(&object("\"ghost\": true"), pixel).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
    let error = resolve_at("{\"version\": 1}", [1.0, 1.0]).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("expected an object that it is for"),
        "{error}"
    );
}

#[test]
fn an_object_moves_to_a_pixel_as_if_its_document_said_so() {
    let (frame, surface) = floor();
    let frame = PlacementFrame {
        frame: &frame,
        surface: &surface,
    };
    let size = "\"rotation\": [0, 0.6, 0, 0.8], \"size_m\": 0.2";
    let at = |scene: &Scene, pixel| scene.objects[0].at(PicturePoint::Pixel(pixel), &frame);
    for before in [
        "\"frame\": \"world\", \"translation\": [9, 9, 9]",
        "\"frame\": \"surface\"",
        "\"pixel\": [30, 60]",
    ] {
        let text = object(&format!("\"place\": {{{before}, {size}}}"));
        let (mut scene, _) = resolve(&text).unwrap();
        assert_eq!(scene.objects[0].instances, 0..1);
        let placed = at(&scene, [60.0, 50.0]).unwrap();
        assert_eq!(placed.nearest_px, None);
        scene.put(0, &placed);
        let text = object(&format!("\"place\": {{\"pixel\": [60, 50], {size}}}"));
        let (there, _) = resolve(&text).unwrap();
        assert_eq!(corners(&scene), corners(&there), "{before}");
        // The centre of its bounds is above the pixel; its up direction is the floor's normal.
        let pivot = scene.objects[0].pivot();
        let pose = &frame.frame.pose;
        let (point, normal) = surface.plane_at(60.0, 50.0, 6.0).unwrap();
        assert!((pivot.axis - pose.rotation * normal).length() < 1e-9);
        let over = pivot.point - pose.transform_point(point);
        let height = over.dot(pivot.axis);
        assert!((over - pivot.axis * height).length() < 1e-9 && height > 0.04);
        // Turned about this axis, it stays in place.
        let turn = DAffine3::from_translation(pivot.point)
            * DAffine3::from_axis_angle(pivot.axis, 0.7)
            * DAffine3::from_translation(-pivot.point);
        scene.move_object(0, turn);
        let turned = scene.objects[0].pivot();
        assert!((turned.point - pivot.point).length() < 1e-9);
        assert!(corners(&scene)[1].distance(corners(&there)[1]) > 0.01);
    }
    let (scene, _) = resolve(&object("\"place\": {\"size_m\": 0.2}")).unwrap();
    let error = at(&scene, [100.0, 50.0]).unwrap_err();
    assert_eq!(error.field, "pixel");
    assert_eq!(
        error.to_string(),
        "expected a pixel of the 100x80 image, got (100, 50)"
    );
    // In the hole, it is placed at the hole's edge.
    let placed = at(&scene, [3.0, 50.0]).unwrap();
    assert_eq!(placed.nearest_px, Some([10.0, 50.0]));
}

#[test]
fn meshes_and_materials_are_shared() {
    let text = "{\"version\": 1, \"objects\": [
        {\"mesh\": \"brick.obj\", \"name\": \"a\"},
        {\"mesh\": \"brick.obj\", \"ghost\": true},
        {\"mesh\": \"brick.obj\", \"material\": {\"preset\": \"glass\", \"ior\": 1.33}}]}";
    let (scene, _) = resolve(text).unwrap();
    assert_eq!(
        (
            scene.meshes.len(),
            scene.instances.len(),
            scene.materials.len()
        ),
        (1, 3, 2)
    );
    assert_eq!(scene.instances[0].material, scene.instances[1].material);
    assert_eq!(
        (
            scene.instances[0].name.as_str(),
            scene.instances[1].name.as_str()
        ),
        ("a", "brick")
    );
    assert!(!scene.instances[0].ghost && scene.instances[1].ghost);
    let glass = &scene.materials[scene.instances[2].material as usize];
    assert_eq!((glass.transmission, glass.ior), (1.0, 1.33));
}

#[test]
fn lights_and_environment_come_in_world_axes() {
    let text = "{\"version\": 1,
        \"objects\": [{\"mesh\": \"brick.obj\", \"place\": {\"pixel\": [60, 50]}}],
        \"lights\": [
            {\"type\": \"sphere\", \"position\": [0, -1.5, 1], \"radius\": 0.1, \"intensity\": [20, 20, 10]},
            {\"type\": \"sphere\", \"frame\": \"world\", \"position\": [0, -1.5, 1], \"intensity\": 3},
            {\"type\": \"directional\", \"direction\": [0, 2, 0], \"irradiance\": [2, 2, 2]}],
        \"environment\": {\"map\": \"sky.hdr\", \"intensity\": 2}}";
    let (scene, _) = resolve(text).unwrap();
    let (frame, plane) = floor();
    let pose = frame.pose;
    assert_eq!(
        scene.lights,
        [
            Light::Sphere {
                position: pose.transform_point(DVec3::new(0.0, -1.5, 1.0)),
                radius_m: 0.1,
                intensity: Vec3::new(20.0, 20.0, 10.0),
            },
            Light::Sphere {
                position: DVec3::new(0.0, -1.5, 1.0),
                radius_m: 0.05,
                intensity: Vec3::splat(3.0),
            },
            Light::Directional {
                direction: (pose.rotation * DVec3::Y).normalize_or_zero(),
                angular_radius_rad: 0.27f64.to_radians(),
                irradiance: Vec3::splat(2.0),
            },
        ]
    );
    let environment = scene.environment.unwrap();
    assert_eq!(environment.radiance[0], Vec3::new(2.0, 1.0, 0.0));
    // Up is the floor's normal; the middle column is ahead.
    let up = environment.world_from_map * DVec3::Y;
    assert!((up - pose.rotation * plane.normal).length() < 1e-9, "{up}");
    let ahead = environment.world_from_map * DVec3::NEG_Z;
    assert!(ahead.dot(pose.rotation * DVec3::Z) > 0.8);
    // Unless the document says otherwise.
    let turned = text.replace("\"intensity\": 2}", "\"up\": [1, 0, 0]}");
    let up = resolve(&turned)
        .unwrap()
        .0
        .environment
        .unwrap()
        .world_from_map
        * DVec3::Y;
    assert!((up - pose.rotation * DVec3::X).length() < 1e-9);
}

proptest! {
    #[test]
    fn a_damaged_document_gives_a_scene_or_one_line(
        changes in prop::collection::vec((any::<prop::sample::Index>(), "[-0-9a-z{}\\[\\],:\"]{0,3}"), 1..4),
    ) {
        let mut text = "{\"version\": 1, \"objects\": [{\"mesh\": \"brick.obj\", \"place\": {\"pixel\": [60, 50], \"scale\": [1, 2, 3], \"rotation\": [0, 0, 0, 1]}, \"material\": {\"preset\": \"glass\", \"ior\": 1.3}}], \"lights\": [{\"type\": \"sphere\", \"position\": [0, 1, 2], \"intensity\": 5}], \"environment\": {\"map\": \"sky.hdr\", \"rotation_deg\": 9}}".to_owned();
        for (at, insert) in changes {
            let at = at.index(text.len());
            text.replace_range(at..=at, &insert);
        }
        if let Err(error) = resolve(&text) {
            let line = error.to_string();
            prop_assert!(line.starts_with("scene.json: ") && !line.contains('\n'), "{}", line);
        }
    }
}

#[test]
fn odd_sizes_are_noted() {
    let (_, notes) = resolve(&object("\"place\": {\"scale\": 100}")).unwrap();
    assert!(
        notes[0].contains("largest extent is 4.000e2 m"),
        "{notes:?}"
    );
}

#[test]
fn a_document_beside_its_files_is_inspected() {
    let folder = folder();
    let path = folder.path().join("scene.json");
    std::fs::write(
        &path,
        "{\"version\": 1, \"objects\": [{\"mesh\": \"brick.obj\", \"material\": {\"preset\": \"mirror\"}}], \"lights\": [], \"environment\": {\"map\": \"sky.hdr\"}}",
    )
    .unwrap();
    let inspection = crate::scene::inspect_scene(&path).unwrap();
    assert_eq!(inspection.objects[0].triangles, 12);
    assert_eq!(inspection.objects[0].max, [1.0, 2.0, 4.0]);
    let text = inspection.to_string();
    assert!(
        text.contains("12 triangles") && text.contains("mirror (metal"),
        "{text}"
    );
    assert!(text.contains("sky.hdr, 2x1"), "{text}");
    assert!(serde_json::to_string(&inspection).is_ok());
    let missing = crate::scene::inspect_scene(&folder.path().join("none.json")).unwrap_err();
    assert!(
        missing.to_string().ends_with("none.json: no such file"),
        "{missing}"
    );
    let directory = SceneDocument::load(folder.path()).unwrap_err();
    assert!(
        directory.to_string().contains("expected a file"),
        "{directory}"
    );
}
