use std::sync::mpsc::channel;

use glam::{DAffine3, DVec3};

use super::*;
use crate::camera::{Intrinsics, Pose};
use crate::frame::{ColorImage, DepthImage, RgbdFrame};
use crate::render::{Cancel, RenderSettings};
use crate::scene::{Instance, Material};
use crate::shapes;

fn scene() -> Scene {
    let mesh = Arc::new(shapes::teapot(8));
    Scene {
        instances: vec![Instance {
            name: "teapot".to_owned(),
            mesh: 0,
            material: 0,
            world_from_object: DAffine3::IDENTITY,
            ghost: false,
        }],
        materials: vec![Material::default()],
        meshes: vec![mesh],
        ..Scene::default()
    }
}

fn engine(threads: usize) -> Engine {
    Engine::new(Backend::Auto, threads, || 0).unwrap()
}

#[test]
fn it_has_a_backend_and_as_many_threads_as_it_was_told() {
    let engine = engine(3);
    assert_eq!(engine.backend(), Backend::Cpu);
    assert_eq!(engine.threads(), 3);
    let error = Engine::new(Backend::Gpu, 1, || 0).err().unwrap();
    assert!(matches!(error, RenderError::NoGpu), "{error}");
}

#[test]
fn two_renderers_of_equal_meshes_share_them_until_both_are_gone() {
    let engine = engine(2);
    // Read twice, as in two sessions: equal, but not the same object.
    let first = engine.renderer(&scene()).unwrap();
    let second = engine.renderer(&scene()).unwrap();
    assert_eq!(engine.mesh_builds(), 1);
    assert_eq!(first.memory(), second.memory());
    assert!(first.memory() > 0);
    drop(first);
    let third = engine.renderer(&scene()).unwrap();
    assert_eq!(engine.mesh_builds(), 1);
    drop((second, third));
    drop(engine.renderer(&scene()).unwrap());
    assert_eq!(engine.mesh_builds(), 2);
}

#[test]
fn renderers_whose_frames_take_turns_share_buffers_and_keep_their_pictures() {
    let frame = |width: u32, height: u32| RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage::filled(width, height, [90, 120, 150, 255]),
        depth: DepthImage::from_metres(width, height, vec![2.0; (width * height) as usize]),
        intrinsics: Intrinsics::new(60.0, 60.0, 31.5, 23.5, width, height).unwrap(),
        pose: Pose::IDENTITY,
    };
    let mut scenes = [scene(), scene()];
    for (scene, z) in scenes.iter_mut().zip([1.0, 1.5]) {
        let place = DAffine3::from_translation(DVec3::new(0.0, 0.2, z));
        scene.instances[0].world_from_object = place * DAffine3::from_scale(DVec3::splat(0.1));
    }
    let frames = [frame(64, 48), frame(96, 64)];
    let settings = RenderSettings::default();
    let alone = [0, 1].map(|i| {
        let mut renderer = engine(1).renderer(&scenes[i]).unwrap();
        renderer.render(&frames[i], &settings, &[]).unwrap().color
    });
    let engine = engine(2);
    let mut renderers = [0, 1].map(|i| engine.renderer(&scenes[i]).unwrap());
    for _ in 0..3 {
        for i in [0, 1] {
            let rendered = renderers[i].render(&frames[i], &settings, &[]).unwrap();
            assert_eq!(rendered.color, alone[i]);
        }
    }
    let buffers = engine.0.buffers.lock().unwrap().upgrade().unwrap();
    assert_eq!(buffers.n_free(), 1);
    drop(renderers);
    drop(buffers);
    assert!(engine.0.buffers.lock().unwrap().upgrade().is_none());
}

#[test]
fn a_renderer_that_was_given_up_leaves_no_mesh_behind() {
    let engine = engine(2);
    let cancel = Cancel::new();
    cancel.set();
    let error = engine.renderer_while(&scene(), &cancel).err().unwrap();
    assert!(matches!(error, RenderError::Cancelled), "{error}");
    assert_eq!(engine.mesh_builds(), 0);
    let renderer = engine.renderer(&scene()).unwrap();
    assert_eq!(engine.mesh_builds(), 1);
    drop(renderer);
}

#[test]
fn loads_share_threads_that_end_with_the_last_of_them() {
    let engine = engine(2);
    let name = || std::thread::current().name().map(str::to_owned);
    let (begun, begins) = channel();
    let (end, ends) = channel::<()>();
    let of_first = engine.clone();
    let first = std::thread::spawn(move || {
        let work = move || {
            begun.send(()).unwrap();
            ends.recv().unwrap();
        };
        of_first.load(work).unwrap();
    });
    begins.recv().unwrap();
    let loading = || engine.0.loading.lock().unwrap().upgrade();
    let before = loading().unwrap();
    assert!(engine.load(name).unwrap().unwrap().starts_with("load-"));
    assert!(Arc::ptr_eq(&before, &loading().unwrap()));
    drop(before);
    end.send(()).unwrap();
    first.join().unwrap();
    assert!(loading().is_none());
}
