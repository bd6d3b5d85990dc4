//! Tests that meshes are closed, of volumes, and of the teapot against the published one.

use super::*;

/// Signed volume; also checks that every edge is shared by two triangles, once in each direction.
fn closed_volume(mesh: &Mesh, name: &str) -> f64 {
    let mut places: HashMap<[u32; 3], u32> = HashMap::new();
    let ids: Vec<u32> = mesh
        .positions
        .iter()
        .map(|p| {
            let n = places.len() as u32;
            // Watertight meshes need equal bits, not equality within a tolerance.
            *places
                .entry(p.to_array().map(|x| (x + 0.0).to_bits()))
                .or_insert(n)
        })
        .collect();
    let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
    let mut volume = 0.0;
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
        volume += a.dot(b.cross(c)) / 6.0;
        assert!(
            (b - a).cross(c - a).length() > 1e-13,
            "{name}: sliver {a} {b} {c}"
        );
        for (i, j) in [(0, 1), (1, 2), (2, 0)] {
            *edges
                .entry((ids[t[i] as usize], ids[t[j] as usize]))
                .or_default() += 1;
        }
    }
    for (&(a, b), &n) in &edges {
        assert_eq!(n, 1, "{name}: edge {a}-{b} used {n} times in one direction");
        assert_eq!(edges.get(&(b, a)), Some(&1), "{name}: edge {a}-{b} is open");
    }
    volume
}

#[test]
fn shipped_meshes_are_closed_and_stand_on_zero() {
    for (name, mesh) in shipped() {
        let volume = closed_volume(&mesh, name);
        assert!(volume > 0.0, "{name} is inside out: {volume}");
        let (low, high) = mesh.bounds().unwrap();
        assert!(low.y.abs() < 1e-7 && high.y > 0.01, "{name} {low} {high}");
        assert_eq!(mesh.normals.len(), mesh.positions.len());
        for n in &mesh.normals {
            assert!((n.length() - 1.0).abs() < 1e-5, "{name} {n}");
        }
        // Normals agree with those of their triangles.
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize].as_dvec3());
            let face = (b - a).cross(c - a).normalize_or_zero();
            let mean = t
                .iter()
                .map(|&i| mesh.normals[i as usize].as_dvec3())
                .sum::<DVec3>();
            assert!(face.dot(mean) > 0.0, "{name} {a} {face} {mean}");
        }
    }
}

#[test]
fn solids_have_their_volumes() {
    let near =
        |got: f64, expected: f64| assert!((got / expected - 1.0).abs() < 0.01, "{got} {expected}");
    near(
        closed_volume(&sphere(0.05, 4), "sphere"),
        4.0 / 3.0 * PI * 0.05f64.powi(3),
    );
    near(
        closed_volume(&ring(0.045, 0.008, 128, 32), "ring"),
        2.0 * PI * PI * 0.045 * 0.008 * 0.008,
    );
    near(
        closed_volume(&cylinder(0.035, 0.10, 0.0005, 96), "cylinder"),
        PI * 0.035 * 0.035 * 0.10,
    );
    near(
        closed_volume(&cone(0.045, 0.11, 96), "cone"),
        PI * 0.045 * 0.045 * 0.11 / 3.0,
    );
    near(closed_volume(&cube(0.08, 0.0004), "cube"), 0.08f64.powi(3));
}

#[test]
fn the_teapot_is_newells() {
    let mesh = teapot(TEAPOT_SIDE);
    // 32 patches of 512 triangles; the 8 patches with a pole (knob, bottom) lose the 16 triangles without area.
    // Closing adds a ring of 128 beside the lid and four caps of 32.
    assert_eq!(mesh.triangles.len(), 32 * 512 - 8 * 16 + 128 + 4 * 32);
    let (low, high) = mesh.bounds().unwrap();
    assert!((high.x - low.x - 0.24).abs() < 1e-4);
    // Its height is 3.15 for a width of 6.43 (Newell's units).
    assert!(((high.y - low.y) / (high.x - low.x) - 3.15 / 6.43).abs() < 0.01);
}

#[test]
fn the_teapot_equals_the_published_one() {
    let Some(data) = std::env::var_os("GHOSTLIGHT_DATA") else {
        assert!(
            !std::env::var("GHOSTLIGHT_REQUIRE").is_ok_and(|r| r.contains("data")),
            "GHOSTLIGHT_REQUIRE asks for data, GHOSTLIGHT_DATA is not set"
        );
        eprintln!("SKIPPED: GHOSTLIGHT_DATA not set");
        return;
    };
    let path = std::path::Path::new(&data).join("meshes/utah-teapot-16k.obj");
    let text = std::fs::read_to_string(&path).unwrap();
    let published: Vec<DVec3> = text
        .lines()
        .filter_map(|line| line.strip_prefix("v "))
        .map(|line| {
            let x: Vec<f64> = line
                .split_whitespace()
                .map(|w| w.parse().unwrap())
                .collect();
            DVec3::new(x[0], x[1], x[2])
        })
        .collect();
    assert!(published.len() > 8_000);
    let ours: Vec<DVec3> = teapot::patches()
        .iter()
        .flat_map(|patch| {
            (0..=TEAPOT_SIDE).flat_map(move |i| {
                (0..=TEAPOT_SIDE).map(move |j| {
                    let at = |k: u32| f64::from(k) / f64::from(TEAPOT_SIDE);
                    teapot::evaluate(patch, at(i), at(j)).0
                })
            })
        })
        .collect();
    // The published file may be rotated about its axis and mirrored, but has the same scale and axis.
    let extent = |points: &[DVec3]| {
        points
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(a, b), p| {
                (a.min(*p), b.max(*p))
            })
    };
    let ((a0, a1), (b0, b1)) = (extent(&published), extent(&ours));
    println!("published {a0} {a1}, ours {b0} {b1}");
    let scale = (a1.z - a0.z) / (b1.z - b0.z);
    let mut grid: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    let cell = |p: DVec3| (p * 50.0).to_array().map(|x| x.floor() as i64);
    for &p in &ours {
        let p = (p - DVec3::Z * b0.z) * scale + DVec3::Z * a0.z;
        grid.entry(cell(p)).or_default().push(p);
    }
    let mut far = 0;
    for &p in &published {
        let [x, y, z] = cell(p);
        let near = (-1..=1).any(|i| {
            (-1..=1).any(|j| {
                (-1..=1).any(|k| {
                    grid.get(&[x + i, y + j, z + k])
                        .is_some_and(|list| list.iter().any(|q| q.distance(p) < 1e-4))
                })
            })
        });
        far += u32::from(!near);
    }
    assert_eq!(far, 0, "of {} points", published.len());
}
