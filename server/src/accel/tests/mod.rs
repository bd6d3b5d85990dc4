//! What the whole module promises; see also the oracle.

mod agreement;
mod degenerate;
mod instances;
mod shaft;
mod watertight;

use std::sync::Arc;

use glam::Affine3A;

pub(crate) use crate::hard::kernels::{agree, levels, packet, tlas};

use super::*;
use crate::scene::Mesh;

pub(crate) fn blas(mesh: &Mesh) -> Arc<Blas> {
    Arc::new(Blas::build(mesh, BuildLimits::default()).unwrap())
}

pub(crate) fn placed(blas: &Arc<Blas>, camera_from_object: Affine3A) -> TlasInstance {
    TlasInstance {
        blas: Arc::clone(blas),
        camera_from_object,
        mask: MASK_VIRTUAL,
        filtered: false,
    }
}

/// Checks wide and packet kernels of `tlas` against `expected`, the scalar hits of `rays`.
pub(crate) fn check_kernels(tlas: &Tlas, rays: &[Ray], expected: &[Option<Hit>]) {
    assert_eq!(agree(tlas, rays).unwrap(), expected);
}
