use super::*;
use crate::scene::LoadContext;
use proptest::prelude::*;

/// A polygon with its own positions.
fn polygon(points: &[DVec3]) -> Polygons {
    let mut polygons = Polygons {
        positions: points.to_vec(),
        ..Polygons::default()
    };
    let corners: Vec<_> = (0..points.len() as u32).map(|i| [i, NONE, NONE]).collect();
    polygons.push(&corners);
    polygons
}

fn build(polygons: Polygons) -> (Mesh, Vec<String>) {
    let mut notes = Vec::new();
    let built = polygons
        .build("m", &mut notes, &mut LoadContext::default().scratch("test"))
        .unwrap();
    assert_eq!(built.faces.len(), built.mesh.triangles.len());
    (built.mesh, notes)
}

/// Area vector, and area.
fn areas(mesh: &Mesh) -> (DVec3, f64) {
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
        0.5 * (b - a).cross(c - a)
    };
    let vectors = || mesh.triangles.iter().map(area);
    (vectors().sum(), vectors().map(DVec3::length).sum())
}

/// An L whose inner corner is the third.
const L: [[f64; 2]; 6] = [[2., 0.], [2., 1.], [1., 1.], [1., 2.], [0., 2.], [0., 0.]];

#[test]
fn concave_polygons_are_not_filled_whichever_way_they_lie() {
    for (x, y) in [
        (DVec3::X, DVec3::Y),
        (DVec3::Y, DVec3::X),
        (DVec3::Y, DVec3::Z),
        (DVec3::NEG_Z, DVec3::X),
        (DVec3::X, DVec3::NEG_Z),
        (DVec3::new(0.6, 0.8, 0.0), DVec3::Z),
    ] {
        for first in 0..L.len() {
            let mut points: Vec<DVec3> = L.iter().map(|p| x * p[0] + y * p[1]).collect();
            points.rotate_left(first);
            let (mesh, notes) = build(polygon(&points));
            assert_eq!((mesh.triangles.len(), notes.len()), (4, 0), "{notes:?}");
            let (vector, area) = areas(&mesh);
            assert!((area - 3.0).abs() < 1e-6, "{area} from corner {first}");
            assert!(vector.distance(3.0 * x.cross(y)) < 1e-6, "{vector}");
        }
    }
}

#[test]
fn convex_polygons_stay_fans_and_bent_ones_are_cut() {
    let square = [DVec3::ZERO, DVec3::X, DVec3::ONE.with_z(0.0), DVec3::Y];
    let (mesh, _) = build(polygon(&square));
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    // A non-planar arrow head: any triangulation keeps its outline seen from above.
    let arrow = [[0., 0., 0.], [2., -1., 0.3], [1., 0., -0.2], [2., 1., 0.1]].map(DVec3::from);
    for first in 0..4 {
        let mut points = arrow;
        points.rotate_left(first);
        let (mesh, _) = build(polygon(&points));
        let flat = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
            0.5 * (b - a).cross(c - a).z
        };
        let parts: Vec<f64> = mesh.triangles.iter().map(flat).collect();
        assert!(parts.iter().all(|&part| part > 0.0), "{parts:?}");
        assert!((parts.iter().sum::<f64>() - 1.0).abs() < 1e-6);
    }
}

#[test]
fn faces_with_bad_corners_are_left_out_and_the_rest_stays() {
    let nan = DVec3::new(0.0, f64::NAN, 0.0);
    let mut polygons = polygon(&[DVec3::ZERO, DVec3::X, DVec3::Y, nan, DVec3::Z]);
    polygons.ends.clear();
    polygons.corners.clear();
    polygons.uvs = vec![Vec2::ONE];
    polygons.push(&[[0, 0, NONE], [1, 7, NONE], [2, 0, NONE]]);
    polygons.push(&[[0, 0, NONE], [1, 0, NONE], [3, 0, NONE]]);
    polygons.push(&[[0, 0, 0], [1, 0, 0], [9, 0, 0], [3, 0, 0]]);
    polygons.push(&[[0, 0, NONE], [BAD, 0, NONE], [2, 0, NONE]]);
    polygons.push(&[[0, 0, NONE], [2, 0, NONE], [4, 0, NONE]]);
    let (mesh, notes) = build(polygons);
    assert_eq!(mesh.triangles.len(), 2);
    assert!(mesh.positions.iter().all(|p| p.is_finite()));
    assert_eq!(notes.len(), 4, "{notes:?}");
    for (note, expected) in notes.iter().zip([
        "1 texture coordinates left out",
        "1 faces left out: corners that are nowhere (face 2: vertex 4 at (0, NaN, 0))",
        "normals left out",
        "2 faces left out: corners that are no vertices (the first: face 3: expected a vertex of 5, got 10)",
    ]) {
        assert!(note.contains(expected), "{note}");
    }
}

#[test]
fn what_lies_far_away_is_moved_in_double() {
    let corners = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.25]].map(DVec3::from);
    for (at, moved) in [
        ([4_500_000., 0., 0.], [4_500_000., 0., 0.]),
        (
            [500_000.5, 5_000_000.25, 300.],
            [500_000., 5_000_000., 300.],
        ),
        ([-500_000., 0., 1.], [-500_000., 0., 0.]),
        ([9e9, 0., 0.], [9e9, 0., 0.]),
        ([900., 0., 1.], [0.; 3]),
    ] {
        let (at, moved) = (DVec3::from(at), DVec3::from(moved));
        let (mesh, notes) = build(polygon(&corners.map(|p| p + at)));
        assert_eq!(notes.len(), usize::from(moved != DVec3::ZERO), "{notes:?}");
        for (p, corner) in mesh.positions.iter().zip(corners) {
            assert_eq!(*p, (corner + at - moved).as_vec3());
        }
    }
    // A single vertex far away removes its face and does not move the mesh.
    let mut polygons = polygon(&[corners[0], corners[1], corners[2], DVec3::splat(1e9)]);
    polygons.ends.clear();
    polygons.corners.clear();
    for [a, b, c] in [[0, 1, 2], [0, 2, 3], [2, 1, 0]] {
        polygons.push(&[[a, NONE, NONE], [b, NONE, NONE], [c, NONE, NONE]]);
    }
    let (mesh, notes) = build(polygons);
    assert_eq!(mesh.triangles.len(), 2);
    assert_eq!(mesh.bounds(), Some((Vec3::ZERO, Vec3::new(1.0, 1.0, 0.0))));
    assert!(
        notes[0].starts_with("1 faces left out: corners that are too far"),
        "{notes:?}"
    );
}

#[test]
fn colours_of_faces_split_vertices_and_those_of_vertices_do_not() {
    let mut polygons = polygon(&[DVec3::ZERO, DVec3::X, DVec3::new(1., 1., 0.), DVec3::Y]);
    polygons.ends.clear();
    polygons.corners.clear();
    for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
        polygons.push(&[[a, NONE, NONE], [b, NONE, NONE], [c, NONE, NONE]]);
    }
    polygons.face_colors = vec![Vec4::new(1., 0., 0., 1.), Vec4::new(0., 1., 0., 1.)];
    let mut by_vertex = Polygons {
        positions: polygons.positions.clone(),
        corners: polygons.corners.clone(),
        ends: polygons.ends.clone(),
        ..Polygons::default()
    };
    let (mesh, _) = build(polygons);
    assert_eq!(mesh.positions.len(), 6);
    for (triangle, color) in mesh.triangles.iter().zip([Vec3::X, Vec3::Y]) {
        for &i in triangle {
            assert_eq!(mesh.colors[i as usize].truncate(), color);
        }
    }
    by_vertex.colors = vec![Vec4::ONE; 4];
    let (mesh, _) = build(by_vertex);
    assert_eq!((mesh.positions.len(), mesh.colors.len()), (4, 4));
}

#[test]
fn what_would_take_too_long_is_cut_as_a_fan() {
    let n = 3_000;
    let zigzag = |i: u32| {
        DVec3::new(
            f64::from(i * (i % 7)),
            f64::from(u32::from(i.is_multiple_of(3))),
            0.0,
        )
    };
    let points: Vec<DVec3> = (0..n).map(zigzag).collect();
    let (mesh, notes) = build(polygon(&points));
    // Equal points become one vertex.
    let first = points[0].as_vec3();
    let at_first = |&i: &u32| mesh.positions[i as usize] == first;
    assert!(mesh.triangles.iter().all(|t| t.iter().any(at_first)));
    assert_eq!(notes.len(), 1, "{notes:?}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    /// A star with any radii: concave but simple, so its area is known.
    #[test]
    fn stars_keep_their_area(radii in prop::collection::vec(0.2f64..2.0, 3..60), turn in 0.0f64..6.0) {
        let n = radii.len() as f64;
        let points: Vec<DVec3> = radii
            .iter()
            .enumerate()
            .map(|(i, r)| {
                let angle = i as f64 / n * std::f64::consts::TAU + turn;
                DVec3::new(r * angle.cos(), 0.3 * r * angle.sin(), r * angle.sin())
            })
            .collect();
        let mut exact = 0.0;
        for (i, &r) in radii.iter().enumerate() {
            exact += 0.5 * r * radii[(i + 1) % radii.len()] * (std::f64::consts::TAU / n).sin();
        }
        let (mesh, _) = build(polygon(&points));
        let (vector, area) = areas(&mesh);
        let exact = exact * 1.09f64.sqrt();
        prop_assert!((area - exact).abs() < 1e-4 * exact, "{area} against {exact}");
        prop_assert!((vector.length() - exact).abs() < 1e-4 * exact);
        prop_assert!(vector.y < 0.0);
    }

    /// Corners in any order, repeated, collinear or crossing: the triangles use only the polygon's corners.
    #[test]
    fn any_polygon_is_cut_or_refused(
        points in prop::collection::vec(prop::array::uniform3(-3i8..3), 3..40),
        scale in prop_oneof![Just(1.0f64), Just(1e-3), Just(1e5), Just(1e12)],
    ) {
        let points: Vec<DVec3> = points
            .iter()
            .map(|p| DVec3::from(p.map(f64::from)) * scale)
            .collect();
        let mut notes = Vec::new();
        if let Ok(built) = polygon(&points).build("m", &mut notes, &mut LoadContext::default().scratch("test")) {
            let n = built.mesh.positions.len() as u32;
            prop_assert!(built.mesh.triangles.len() <= points.len() - 2);
            prop_assert!(built.mesh.triangles.iter().flatten().all(|&i| i < n));
        }
    }
}
