//! Tests of vertex colours in whole frames.

use glam::Vec4;

use super::*;
use crate::scene::AlphaMode;

/// A sphere in the middle of the picture, with a mesh coloured by position.
fn colored(material: Material, color: impl Fn(Vec3) -> Vec4) -> Rendered {
    let mut scene = scene(&[(DVec3::new(0.0, 0.0, 1.5), 0.3, material, false)], vec![]);
    let mut mesh = ball();
    mesh.colors = mesh.positions.iter().map(|&p| color(p)).collect();
    scene.meshes = vec![Arc::new(mesh)];
    render(&scene, &wall([188, 188, 188, 255]), &plain(), 1)
}

fn matte(base_color: Vec3) -> Material {
    Material {
        base_color,
        ior: 1.0,
        ..Material::default()
    }
}

fn farthest(a: &Rendered, b: &Rendered) -> u8 {
    let pairs = a.color.rgba.iter().zip(&b.color.rgba);
    let channels = pairs.flat_map(|(a, b)| a.iter().zip(b));
    channels.map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
}

#[test]
fn they_multiply_the_base_colour() {
    let half_red = Vec4::new(0.5, 0.0, 0.0, 1.0);
    for material in [matte(Vec3::ONE), mirror()] {
        let flat = Material {
            base_color: half_red.truncate(),
            ..material.clone()
        };
        let by_vertex = colored(material.clone(), |_| half_red);
        let by_material = colored(flat, |_| Vec4::ONE);
        assert!(farthest(&by_vertex, &by_material) <= 1);
        // Unless the material disables vertex colours.
        let without = Material {
            vertex_colors: false,
            ..material.clone()
        };
        let white = colored(material, |_| Vec4::ONE);
        assert_eq!(farthest(&colored(without, |_| half_red), &white), 0);
    }
}

#[test]
fn they_lie_where_their_vertices_do() {
    let side = |p: Vec3| {
        if p.y < 0.0 {
            Vec4::new(1.0, 0.0, 0.0, 1.0)
        } else {
            Vec4::new(0.0, 1.0, 0.0, 1.0)
        }
    };
    let out = colored(matte(Vec3::ONE), side);
    // The camera's y points down, and so does the sphere's.
    for (y, bright, dark) in [(45, 0, 1), (75, 1, 0)] {
        let pixel = out.color.rgba[at(80, y)];
        assert!(pixel[bright] > 150 && pixel[dark] < 10, "{pixel:?}");
    }
}

#[test]
fn their_alpha_serves_a_mask() {
    let masked = Material {
        alpha: AlphaMode::Mask { cutoff: 0.5 },
        ..matte(Vec3::ONE)
    };
    let n = |alpha: f32| {
        let out = colored(masked.clone(), |_| Vec4::new(1.0, 1.0, 1.0, alpha));
        gray(&out, Aov::Mask).iter().filter(|&&m| m > 0).count()
    };
    assert_eq!(n(0.25), 0);
    assert!(n(0.75) > 1_000);
}
