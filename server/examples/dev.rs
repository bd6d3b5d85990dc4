use ghostlight::*;
use std::path::Path;
fn now() -> u64 { static T: std::sync::OnceLock<std::time::Instant> = std::sync::OnceLock::new(); T.get_or_init(std::time::Instant::now).elapsed().as_nanos() as u64 }
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let rec = recording::Recording::open(Path::new(&a[1]), &Default::default()).unwrap();
    for n in rec.notes() { eprintln!("{n}"); }
    let px: Option<[f64;2]> = a.get(4).filter(|s| s.as_str() != "-").map(|s| { let v: Vec<f64> = s.split(',').map(|x| x.parse().unwrap()).collect(); [v[0], v[1]] });
    let settings: render::RenderSettings = a.get(5).map(|s| serde_json::from_str(s).unwrap()).unwrap_or_default();
    let first = rec.frame(0).unwrap();
    let mut surface = ghost::GhostSurface::new();
    surface.rebuild(&first.depth, &first.intrinsics, &settings.ghost);
    let (doc, dir) = scene::SceneDocument::load(Path::new(&a[2])).unwrap();
    let (sc, notes) = doc.resolve(&dir, &scene::ResolveOptions { place_pixel: px, first_frame: &first, surface: &surface }).unwrap();
    for n in notes { eprintln!("{n}"); }
    let mut r = render::Renderer::cpu(&sc, 2, now).unwrap();
    let mut times = vec![];
    let n = rec.len().min(a.get(6).map(|s| s.parse().unwrap()).unwrap_or(10));
    let mut sums = [0u64; 8];
    for i in 0..n {
        let f = rec.frame(i).unwrap();
        let out = r.render(&f, &settings, &[]);
        times.push(out.total_ns);
        for k in 0..8 { sums[k] += out.stage_ns[k]; }
        if i == 0 || i == n - 1 {
            let bytes = out.color.rgba.iter().flatten().copied().collect::<Vec<u8>>();
            image::save_buffer(format!("{}{}.png", a[3], i), &bytes, out.color.width, out.color.height, image::ColorType::Rgba8).unwrap();
            println!("{:?}", out.stats);
        }
    }
    times.sort();
    println!("median {:.2} ms", times[n / 2] as f64 / 1e6);
    for s in render::Stage::ALL { println!("{:14} {:.3}", s.name(), sums[s as usize] as f64 / 1e6 / n as f64); }
}
