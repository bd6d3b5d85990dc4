use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::channel;

use super::*;
use crate::render::{Cancel, Uninterrupted};
use crate::shapes;

fn mesh(detail: u32) -> Arc<Mesh> {
    Arc::new(shapes::teapot(detail))
}

fn build(meshes: &[&Arc<Mesh>]) -> Result<Vec<BuiltLods>, RenderError> {
    let build = |mesh: &&Arc<Mesh>| Some(MeshLods::new(mesh, &Uninterrupted));
    Ok(meshes.iter().map(build).collect())
}

fn only(lods: Vec<SharedLods>) -> Arc<MeshLods> {
    assert_eq!(lods.len(), 1);
    lods.into_iter().next().unwrap().unwrap()
}

#[test]
fn equal_meshes_are_built_once_and_others_are_told_apart() {
    let cache = MeshCache::default();
    let mut other = Mesh::clone(&mesh(4));
    // One bit of one coordinate differs.
    let x = &mut other.positions[0].x;
    *x = f32::from_bits(x.to_bits() ^ 1);
    let meshes = [mesh(4), Arc::new(other), mesh(4)];
    let lods = cache.lods(&meshes, &Uninterrupted, build).unwrap();
    let lods: Vec<_> = lods.into_iter().map(Result::unwrap).collect();
    assert_eq!(cache.n_builds(), 2);
    assert!(Arc::ptr_eq(&lods[0], &lods[2]));
    assert!(!Arc::ptr_eq(&lods[0], &lods[1]));
    let again = only(cache.lods(&[mesh(4)], &Uninterrupted, build).unwrap());
    assert!(Arc::ptr_eq(&again, &lods[0]));
}

#[test]
fn what_nobody_holds_is_freed_and_built_again() {
    let cache = MeshCache::default();
    let lods = only(cache.lods(&[mesh(4)], &Uninterrupted, build).unwrap());
    let weak = Arc::downgrade(&lods);
    drop(lods);
    assert!(weak.upgrade().is_none());
    drop(cache.lods(&[mesh(5)], &Uninterrupted, build).unwrap());
    assert_eq!(cache.table().states.len(), 1);
    drop(cache.lods(&[mesh(4)], &Uninterrupted, build).unwrap());
    assert_eq!(cache.n_builds(), 3);
}

#[test]
fn a_mesh_of_the_same_hash_is_built_for_its_own_and_not_shared() {
    let cache = MeshCache::default();
    let first = mesh(4);
    let held = only(
        cache
            .lods(std::slice::from_ref(&first), &Uninterrupted, build)
            .unwrap(),
    );
    // Simulates equal hashes of the first and second mesh.
    let second = mesh(5);
    let key = cache.key(&second);
    let state = State::Built(Arc::downgrade(&held));
    cache.table().states.insert(key, state);
    let other = only(
        cache
            .lods(std::slice::from_ref(&second), &Uninterrupted, build)
            .unwrap(),
    );
    assert!(Arc::ptr_eq(other.mesh(), &second));
    assert!(Arc::ptr_eq(held.mesh(), &first));
}

#[test]
fn a_build_in_progress_is_waited_for() {
    let cache = MeshCache::default();
    let builds = AtomicUsize::new(0);
    let (begun, begins) = channel();
    let (end, ends) = channel::<()>();
    let ends = Mutex::new(ends);
    std::thread::scope(|scope| {
        let first = scope.spawn(|| {
            let slow = |meshes: &[&Arc<Mesh>]| {
                builds.fetch_add(1, Ordering::Relaxed);
                begun.send(()).unwrap();
                ends.lock().unwrap().recv().unwrap();
                build(meshes)
            };
            only(cache.lods(&[mesh(4)], &Uninterrupted, slow).unwrap())
        });
        begins.recv().unwrap();
        let second = scope.spawn(|| {
            let counted = |meshes: &[&Arc<Mesh>]| {
                builds.fetch_add(1, Ordering::Relaxed);
                build(meshes)
            };
            only(cache.lods(&[mesh(4)], &Uninterrupted, counted).unwrap())
        });
        end.send(()).unwrap();
        let (first, second) = (first.join().unwrap(), second.join().unwrap());
        assert!(Arc::ptr_eq(&first, &second));
    });
    assert_eq!(builds.into_inner(), 1);
}

#[test]
fn who_waits_builds_it_when_the_builder_gives_up_and_may_give_up_alone() {
    let cache = MeshCache::default();
    let (begun, begins) = channel();
    let cancel = Cancel::new();
    std::thread::scope(|scope| {
        let first = scope.spawn(|| {
            let given_up = |meshes: &[&Arc<Mesh>]| {
                begun.send(()).unwrap();
                while !cancel.is_set() {
                    std::thread::yield_now();
                }
                Ok(meshes.iter().map(|_| None).collect())
            };
            cache.lods(&[mesh(4)], &cancel, given_up).err()
        });
        begins.recv().unwrap();
        // A third one stops waiting, which does not affect the others.
        let gone = Cancel::new();
        gone.set();
        let third = cache.lods(&[mesh(4)], &gone, build).err();
        assert!(matches!(third, Some(RenderError::Cancelled)));
        let second = scope.spawn(|| only(cache.lods(&[mesh(4)], &Uninterrupted, build).unwrap()));
        cancel.set();
        assert!(matches!(
            first.join().unwrap(),
            Some(RenderError::Cancelled)
        ));
        assert!(!second.join().unwrap().mesh().triangles.is_empty());
    });
    assert_eq!(cache.n_builds(), 1);
}
