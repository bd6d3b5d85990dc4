//! Guarantees of the acceleration structure: every kernel finds the hits of the scalar reference, and these are
//! correct.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

mod agreement;
#[path = "../data/mod.rs"]
mod data;
mod degenerate;
mod instances;
mod shaft;
mod watertight;

use std::sync::Arc;

use glam::Affine3A;

use ghostlight_lab::hard::kernels::{agree, levels, packet, tlas};

use ghostlight::accel::{Blas, BuildLimits, Hit, MASK_VIRTUAL, Ray, Tlas, TlasInstance};
use ghostlight::scene::Mesh;

fn blas(mesh: &Mesh) -> Arc<Blas> {
    Arc::new(Blas::build(mesh, BuildLimits::default()).unwrap())
}

fn placed(blas: &Arc<Blas>, camera_from_object: Affine3A) -> TlasInstance {
    TlasInstance {
        blas: Arc::clone(blas),
        camera_from_object,
        mask: MASK_VIRTUAL,
        filtered: false,
    }
}

/// Checks the wide and packet kernels of `tlas` against `expected`, the scalar hits of `rays`.
fn check_kernels(tlas: &Tlas, rays: &[Ray], expected: &[Option<Hit>]) {
    assert_eq!(agree(tlas, rays).unwrap(), expected);
}
