//! Checks of a document's numbers. Every error names the field's path.

use super::document::{LightKind, LightSpec, MaterialSpec, Object, PlaceFrame, SceneDocument};
use super::environment_spec::EnvironmentSpec;
use super::error::SceneError;
use super::triple::Triple;

/// Largest distance from a frame's origin, metres. Poses in f64 are still precise to less than a millimetre beyond
/// it, but no recording is that large.
const MAX_DISTANCE_M: f64 = 1e9;

/// Largest deviation of a quaternion's length from 1: a rotation typed with three digits passes, a forgotten
/// component does not (heuristic).
const QUATERNION_TOLERANCE: f64 = 1e-2;

/// The document and path of a value, for errors.
#[derive(Clone, Copy)]
pub(super) struct At<'a> {
    file: &'a str,
    path: &'a str,
}

impl At<'_> {
    fn fail<T>(&self, field: &str, problem: String) -> Result<T, SceneError> {
        let path = match (self.path, field) {
            (path, "") => path.to_owned(),
            ("", field) => field.to_owned(),
            (path, field) => format!("{path}.{field}"),
        };
        Err(SceneError::Field {
            file: self.file.to_owned(),
            path,
            problem,
        })
    }

    fn number(&self, field: &str, x: f64, lo: f64, hi: f64) -> Result<(), SceneError> {
        // False for NaN.
        if x >= lo && x <= hi {
            return Ok(());
        }
        self.fail(
            field,
            format!("expected a number from {lo} to {hi}, got {x}"),
        )
    }

    fn numbers(&self, field: &str, xs: &[f64], lo: f64, hi: f64) -> Result<(), SceneError> {
        xs.iter()
            .enumerate()
            .try_for_each(|(i, &x)| self.number(&format!("{field}[{i}]"), x, lo, hi))
    }

    fn direction(&self, field: &str, d: [f64; 3]) -> Result<(), SceneError> {
        self.numbers(field, &d, -MAX_DISTANCE_M, MAX_DISTANCE_M)?;
        if d.iter().map(|x| x * x).sum::<f64>() > 1e-18 {
            return Ok(());
        }
        self.fail(field, format!("expected a direction, got {d:?}"))
    }
}

impl SceneDocument {
    /// Checks everything that can be checked without reading the files that the document names.
    pub(super) fn check(&self) -> Result<(), SceneError> {
        let root = At {
            file: &self.file,
            path: "",
        };
        for (field, n, max) in [
            ("objects", self.objects.len(), Self::MAX_OBJECTS),
            ("lights", self.lights.len(), Self::MAX_LIGHTS),
        ] {
            if n > max {
                return root.fail(field, format!("expected at most {max}, got {n}"));
            }
        }
        for (i, object) in self.objects.iter().enumerate() {
            let path = format!("objects[{i}]");
            check_object(
                object,
                At {
                    path: &path,
                    ..root
                },
            )?;
        }
        for (i, light) in self.lights.iter().enumerate() {
            let path = format!("lights[{i}]");
            check_light(
                light,
                At {
                    path: &path,
                    ..root
                },
            )?;
        }
        if let Some(environment) = &self.environment {
            check_environment(
                environment,
                At {
                    path: "environment",
                    ..root
                },
            )?;
        }
        if let Some(Err(error)) = self.settings.map(|settings| settings.validate()) {
            let field = format!("settings.{}", error.field);
            return root.fail(
                &field,
                format!("expected {}, got {}", error.expected, error.got),
            );
        }
        Ok(())
    }
}

fn check_object(object: &Object, at: At<'_>) -> Result<(), SceneError> {
    if object.mesh.is_empty() {
        return at.fail(
            "mesh",
            "expected the path of a mesh file, got nothing".into(),
        );
    }
    let place = &object.place;
    at.numbers(
        "place.translation",
        &place.translation,
        -MAX_DISTANCE_M,
        MAX_DISTANCE_M,
    )?;
    let length = place.rotation.iter().map(|x| x * x).sum::<f64>().sqrt();
    // An interval, so that NaN fails too.
    if !(1.0 - QUATERNION_TOLERANCE..=1.0 + QUATERNION_TOLERANCE).contains(&length) {
        return at.fail(
            "place.rotation",
            format!(
                "expected a unit quaternion [x, y, z, w], got {:?} of length {length:.4}",
                place.rotation
            ),
        );
    }
    if let Some(Triple(scale)) = place.scale {
        for (i, s) in scale.into_iter().enumerate() {
            // A negative factor mirrors.
            if !(1e-9..=1e9).contains(&s.abs()) {
                return at.fail(
                    "place.scale",
                    format!("expected a number other than 0 from 1e-9 to 1e9 in size, got {s} for axis {i}"),
                );
            }
        }
        if place.size_m.is_some() {
            return at.fail("place", "expected scale or size_m, got both".into());
        }
    }
    if let Some(size) = place.size_m {
        at.number("place.size_m", size, 1e-6, 1e6)?;
    }
    if let Some(pixel) = place.pixel {
        at.numbers("place.pixel", &pixel, -0.5, 1e5)?;
    }
    if let Some(picture) = place.picture {
        at.numbers("place.picture", &picture, 0.0, 1.0)?;
    }
    if place.pixel.is_some() && place.picture.is_some() {
        return at.fail("place", "expected pixel or picture, got both".into());
    }
    let frame = place.effective_frame();
    if place.pixel.is_some() && frame != PlaceFrame::Pixel {
        return at.fail(
            "place.pixel",
            "expected no pixel unless place.frame is \"pixel\"".into(),
        );
    }
    let on_picture = matches!(frame, PlaceFrame::Pixel | PlaceFrame::Surface);
    if place.picture.is_some() && !on_picture {
        return at.fail(
            "place.picture",
            "expected no picture unless place.frame is \"pixel\" or \"surface\"".into(),
        );
    }
    if let Some(material) = &object.material {
        let path = format!("{}.material", at.path);
        check_material(material, At { path: &path, ..at })?;
    }
    if let Some(marker) = &object.marker {
        if marker.family.is_empty() {
            return at.fail(
                "marker.family",
                "expected a name as in \"tag36h11\", got nothing".into(),
            );
        }
        at.number("marker.size_m", marker.size_m, 1e-3, 10.0)?;
        return at.fail(
            "marker",
            "objects that follow a marker are not supported by this build: use place".into(),
        );
    }
    Ok(())
}

fn check_material(material: &MaterialSpec, at: At<'_>) -> Result<(), SceneError> {
    let triples = [
        ("base_color", material.base_color, 1.0),
        ("emissive", material.emissive, 1e6),
        ("attenuation_color", material.attenuation_color, 1.0),
    ];
    for (field, value, hi) in triples {
        if let Some(Triple(rgb)) = value {
            at.numbers(field, &rgb, 0.0, hi)?;
        }
    }
    let numbers = [
        ("metallic", material.metallic, 0.0, 1.0),
        ("roughness", material.roughness, 0.0, 1.0),
        ("transmission", material.transmission, 0.0, 1.0),
        ("ior", material.ior, 1.0, 5.0),
        (
            "attenuation_distance_m",
            material.attenuation_distance_m,
            1e-9,
            1e9,
        ),
    ];
    for (field, value, lo, hi) in numbers {
        if let Some(x) = value {
            at.number(field, x, lo, hi)?;
        }
    }
    Ok(())
}

fn check_light(light: &LightSpec, at: At<'_>) -> Result<(), SceneError> {
    let sphere = [
        ("position", light.position.is_some(), true),
        ("intensity", light.intensity.is_some(), true),
        ("radius", light.radius.is_some(), false),
    ];
    let directional = [
        ("direction", light.direction.is_some(), true),
        ("irradiance", light.irradiance.is_some(), true),
        (
            "angular_radius_deg",
            light.angular_radius_deg.is_some(),
            false,
        ),
    ];
    let (name, own, foreign) = match light.kind {
        LightKind::Sphere => ("sphere", sphere, directional),
        LightKind::Directional => ("directional", directional, sphere),
    };
    for (field, given, required) in own {
        if required && !given {
            return at.fail(field, format!("missing; a {name} light needs it"));
        }
    }
    for (field, given, _) in foreign {
        if given {
            return at.fail(field, format!("a {name} light has no such field"));
        }
    }
    if let Some(position) = light.position {
        at.numbers("position", &position, -MAX_DISTANCE_M, MAX_DISTANCE_M)?;
    }
    if let Some(radius) = light.radius {
        at.number("radius", radius, 0.0, 1e4)?;
    }
    if let Some(direction) = light.direction {
        at.direction("direction", direction)?;
    }
    for (field, value) in [
        ("intensity", light.intensity),
        ("irradiance", light.irradiance),
    ] {
        if let Some(Triple(rgb)) = value {
            at.numbers(field, &rgb, 0.0, 1e9)?;
        }
    }
    if let Some(angle) = light.angular_radius_deg {
        at.number("angular_radius_deg", angle, 0.0, 90.0)?;
    }
    Ok(())
}

fn check_environment(environment: &EnvironmentSpec, at: At<'_>) -> Result<(), SceneError> {
    if environment.map.is_empty() {
        return at.fail(
            "map",
            "expected the path of an .hdr or .exr file, got nothing".into(),
        );
    }
    at.number("intensity", environment.intensity, 0.0, 1e6)?;
    at.number("rotation_deg", environment.rotation_deg, -3600.0, 3600.0)?;
    match environment.up {
        Some(up) => at.direction("up", up),
        None => Ok(()),
    }
}
