use super::*;
use crate::scene::Wrap;
use crate::scene::test_data::png;

/// Reads a library in a folder of textures, and returns its materials and notes.
struct Case {
    folder: tempfile::TempDir,
}

/// Name and colour of each texture.
const TEXTURES: [(&str, [u8; 4]); 8] = [
    ("tex.png", [255, 0, 0, 255]),
    ("my tex.png", [0, 255, 0, 255]),
    ("Textures/Wood.PNG", [0, 0, 255, 255]),
    ("half.png", [128, 128, 128, 255]),
    ("cut.png", [255, 255, 255, 64]),
    ("normal.png", [128, 128, 255, 255]),
    ("height.png", [90, 90, 90, 255]),
    ("a #1.png", [9, 9, 9, 255]),
];

impl Case {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, rgba) in TEXTURES {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, png(2, 1, rgba)).unwrap();
        }
        Self { folder }
    }

    fn read(&self, text: &[u8]) -> (Option<Entry>, Vec<String>) {
        std::fs::write(self.folder.path().join("l.mtl"), text).unwrap();
        let mut notes = Vec::new();
        let names = [b"l.mtl".to_vec()];
        let context = LoadContext::default();
        let mut library = load(
            &context,
            &names,
            self.folder.path(),
            Path::new("m.obj"),
            &mut notes,
        );
        let entry = library.get("a");
        notes.extend(library.into_notes());
        (entry, notes)
    }

    fn material(&self, lines: &str) -> (Material, Vec<String>) {
        let (entry, notes) = self.read(format!("newmtl a\n{lines}\n").as_bytes());
        (entry.unwrap().material, notes)
    }
}

#[test]
fn paths_stay_in_the_folder() {
    for bad in ["../x.mtl", "/etc/passwd", "a/../../b", "", ".", ".."] {
        assert!(inside(bad).is_err(), "{bad}");
    }
    assert!(inside("a/b.mtl").is_ok() && inside("./b.mtl").is_ok());
}

#[test]
fn values_are_read_and_odd_ones_counted() {
    let case = Case::new();
    let (a, notes) = case.material(
        "Kd 0.5 # all three\nNs 30\nd 0.25\nNi 1.33\nPm 2\nKe 1 nan 1\nmap_Kd ../x.png\nillum 2\nKa 1 1 1",
    );
    assert_eq!(
        (a.base_color, a.transmission, a.ior, a.metallic),
        (Vec3::splat(0.5), 0.75, 1.33, 0.0)
    );
    assert!((a.roughness - 0.5).abs() < 1e-6);
    assert_eq!(notes.len(), 2, "{notes:?}");
    assert!(notes[0].contains("2 unusable lines"), "{notes:?}");
    assert!(notes[1].contains("\"../x.png\" left out"), "{notes:?}");
}

#[test]
fn opacity_wins_over_transparency_in_any_order() {
    let case = Case::new();
    for (lines, expected) in [
        ("d 1\nTr 1", 0.0),
        ("Tr 1\nd 1", 0.0),
        ("Tr 0\nd 0.25", 0.75),
        ("d -halo 0.25", 0.75),
        ("Tr 0.25", 0.25),
        ("Kd 1 1 1", 0.0),
    ] {
        assert_eq!(case.material(lines).0.transmission, expected, "{lines}");
    }
}

#[test]
fn textures_are_found_as_blender_and_windows_write_them() {
    let case = Case::new();
    for (line, expected) in [
        ("map_Kd tex.png", 0),
        ("map_Kd .\\tex.png", 0),
        ("map_Kd C:\\Users\\me\\tex.png", 0),
        ("map_kd \"tex.png\"", 0),
        ("map_Kd tex.png   # comment", 0),
        ("map_Kd tex.png \t ", 0),
        ("\tmap_Kd -s 1 1 1 -o 0 0 0 tex.png", 0),
        ("map_Kd -s 1 tex.png", 0),
        (
            "map_Kd -s 1 1 -t 0 0 0 -blendu on -blendv off -bm 1 tex.png",
            0,
        ),
        (
            "map_Kd -mm 0 1 -clamp on -cc on -texres 512 -imfchan r tex.png",
            0,
        ),
        ("map_Kd -type sphere -boost 2 my tex.png", 1),
        ("map_Kd my tex.png", 1),
        ("map_Kd C:\\my files\\My Tex.png", 1),
        ("map_Kd my tex.png -s 1 1 1", 1),
        ("map_Kd textures\\wood.png", 2),
        ("map_Kd /home/me/wood.png", 2),
        ("map_Kd a #1.png", 7),
    ] {
        let (material, notes) = case.material(line);
        assert!(notes.is_empty(), "{line}: {notes:?}");
        let texture = material.base_color_texture.expect(line);
        assert_eq!(
            (texture.rgba[0], texture.reading.srgb),
            (TEXTURES[expected].1, true),
            "{line}"
        );
        let clamped = line.contains("-clamp on");
        let wrap = if clamped { Wrap::Clamp } else { Wrap::Repeat };
        assert_eq!(texture.reading.wrap, [wrap; 2], "{line}");
        // Without a colour of its own.
        assert_eq!(material.base_color, Vec3::ONE);
    }
    for line in [
        "map_Kd",
        "map_Kd -s 1 1 1",
        "map_Kd none.png",
        "map_Kd l.mtl",
        "map_Kd .",
    ] {
        let (material, notes) = case.material(line);
        assert!(material.base_color_texture.is_none());
        assert_eq!(notes.len(), 1, "{line}: {notes:?}");
    }
    let (black, notes) = case.material("Kd 0 0 0\nmap_Kd tex.png");
    assert_eq!((black.base_color, notes.len()), (Vec3::ONE, 1));
}

#[test]
fn scales_and_offsets_change_texture_coordinates() {
    let case = Case::new();
    let text = b"newmtl a\nmap_Kd -s 2 3 1 -o 0.5 0.25 0 tex.png\nmap_Ke tex.png\n";
    let (entry, notes) = case.read(text);
    // u = 2 u + 0.5; v, from the bottom, 3 v + 0.25.
    let mut uvs = [Vec2::new(0.25, 1.0 - 0.5)];
    entry.unwrap().uvs.apply_to(&mut uvs);
    assert_eq!(uvs, [Vec2::new(1.0, 1.0 - 1.75)]);
    assert!(notes[0].contains("the first counts"), "{notes:?}");
}

#[test]
fn maps_of_other_things_are_put_together() {
    let case = Case::new();
    let (material, notes) = case.material("map_Kd tex.png\nmap_d cut.png");
    assert_eq!(
        material.base_color_texture.unwrap().rgba[1],
        [255, 0, 0, 64]
    );
    assert_eq!(material.alpha, AlphaMode::Mask { cutoff: 0.5 });
    let (material, _) = case.material("Kd 1 0 0\nmap_d half.png");
    assert_eq!(
        material.base_color_texture.unwrap().rgba[0],
        [255, 255, 255, 128]
    );
    let (material, _) = case.material("map_Ke tex.png");
    assert_eq!(
        (material.emissive, material.emissive_texture.is_some()),
        (Vec3::ONE, true)
    );
    let (material, more) =
        case.material("Pr 0.1\nPm 0\nmap_Pr half.png\nmap_Pm -imfchan r tex.png");
    let texture = material.metallic_roughness_texture.unwrap();
    assert_eq!(
        (texture.rgba[0], texture.reading.srgb),
        ([255, 128, 255, 255], false)
    );
    assert_eq!((material.roughness, material.metallic), (1.0, 1.0));
    assert!(notes.is_empty() && more.is_empty(), "{notes:?} {more:?}");
    for line in ["map_Bump -bm 0.5 normal.png", "norm -bm 0.5 height.png"] {
        let (material, notes) = case.material(line);
        assert!(
            material.normal_texture.is_some() && notes.is_empty(),
            "{notes:?}"
        );
        assert_eq!(material.normal_scale, 0.5);
    }
    let (material, notes) = case.material("bump height.png\ndisp height.png\nmap_Ks tex.png");
    assert!(material.normal_texture.is_none());
    assert!(notes[0].contains("not rendered: disp, map_ks"), "{notes:?}");
    assert!(notes[1].contains("heights"), "{notes:?}");
}

#[test]
fn libraries_have_several_names_blanks_and_repeated_materials() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("a.mtl", "newmtl a\nKd 1 0 0\nnewmtl shared\nKd 1 0 0\n");
    write("b.mtl", "newmtl b\nKd 0 1 0\nnewmtl shared\nKd 0 1 0\n");
    write(
        "with blank.mtl",
        "newmtl c c\r\nKd 0 0 1\r\nnewmtl c c\r\nKd 1 1 1\r\n",
    );
    write("m.mtl", "newmtl own\nKd 1 1 0\n");
    let read = |lines: &[&str], name: &str| {
        let lines: Vec<Vec<u8>> = lines.iter().map(|line| line.as_bytes().to_vec()).collect();
        let mut notes = Vec::new();
        let context = LoadContext::default();
        let mut library = load(
            &context,
            &lines,
            folder.path(),
            Path::new("x/m.obj"),
            &mut notes,
        );
        let color = library.get(name).map(|entry| entry.material.base_color);
        notes.extend(library.into_notes());
        (color, notes.len())
    };
    for lines in [
        &["a.mtl b.mtl"][..],
        &["a.mtl", "B.mtl"],
        &[".\\a.mtl \"b.mtl\" # both"],
    ] {
        assert_eq!(read(lines, "a"), (Some(Vec3::X), 0));
        assert_eq!(read(lines, "b"), (Some(Vec3::Y), 0));
        assert_eq!(read(lines, "shared"), (Some(Vec3::X), 0));
        assert_eq!(read(lines, "A # comment"), (Some(Vec3::X), 0));
        assert_eq!(read(lines, "missing"), (None, 1));
        // Exporters' names for "no material" give no material and no note.
        assert_eq!(read(lines, "None"), (None, 0));
    }
    assert_eq!(read(&["with blank.mtl"], "c c"), (Some(Vec3::ONE), 1));
    assert_eq!(read(&["with blank.mtl a.mtl"], "a"), (Some(Vec3::X), 1));
    assert_eq!(
        read(&["gone.mtl a.mtl"], "own"),
        (Some(Vec3::new(1., 1., 0.)), 1)
    );
    assert_eq!(read(&["", "."], "a"), (None, 2));
}

#[test]
fn coded_colours_are_made_linear() {
    let of = |rgb: [f32; 3]| {
        let coded = [Vec3::from(rgb).extend(1.0), Vec3::ZERO.extend(1.0)];
        linear_from_coded(coded.iter().copied())[0].truncate()
    };
    assert_eq!(of([1.0, 0.0, 0.0]), Vec3::X);
    assert_eq!(of([255.0, 0.0, 300.0]), Vec3::new(1.0, 0.0, 1.0));
    let half = of([0.5, 127.5 / 255.0, 0.0]);
    assert!(
        (half - Vec3::new(0.214, 0.214, 0.0)).abs().max_element() < 1e-3,
        "{half}"
    );
    assert!(of([127.5, 127.5, 0.0]).distance(half) < 1e-6);
    assert_eq!(of([f32::NAN, 0.0, 0.0]), Vec3::ONE);
}
