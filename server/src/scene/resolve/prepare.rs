//! Loads all meshes of a document, determines all sizes, and places all objects.

use std::path::PathBuf;

use super::super::document::{Object, PlaceFrame, Placement, SceneDocument};
use super::super::error::SceneError;
use super::super::place::{self, Moved, Oriented, PlaceRequest, Placed, PlacementFrame};
use super::{FIT_SIZE_M, PLAUSIBLE_M, Resolver};

/// An object whose mesh is loaded and whose size is known.
pub(super) struct Prepared<'a> {
    pub(super) object: &'a Object,
    pub(super) name: String,
    /// Key of its model in [`Resolver::models`].
    pub(super) file: PathBuf,
    /// Its placement, with the final size.
    pub(super) placement: Placement,
    pub(super) oriented: Oriented,
}

impl<'a> Resolver<'a> {
    /// Loads all meshes and determines all sizes.
    pub(super) fn prepare(&mut self) -> Result<Vec<Prepared<'a>>, SceneError> {
        let document = self.document;
        let mut all = Vec::with_capacity(document.objects.len());
        for (i, object) in document.objects.iter().enumerate() {
            let path = format!("objects[{i}]");
            let name = SceneDocument::name_of(object);
            let file = self.load(object, &name, &path)?;
            let mut placement = object.place.clone();
            let bounds = self.models[&file].bounds;
            let fail = |(field, problem)| document.field(format!("{path}.place.{field}"), problem);
            let size_m = place::size_m(&placement, bounds).map_err(fail)?;
            let free = placement.scale.is_none() && placement.size_m.is_none();
            if object.bare && free && size_m > 0.0 && !PLAUSIBLE_M.contains(&size_m) {
                placement.size_m = Some(FIT_SIZE_M);
                self.notes.push(format!(
                    "{name} is {} wide in its file: brought to {FIT_SIZE_M} m; --size sets its largest side.",
                    metres(size_m)
                ));
            } else if object.bare && free {
                self.notes.push(format!(
                    "{name} is {} wide, as in its file; --size sets its largest side.",
                    metres(size_m)
                ));
            } else if free && !object.ghost && !PLAUSIBLE_M.contains(&size_m) {
                self.notes.push(format!(
                    "{name} is {} wide; place.size_m sets its largest side.",
                    metres(size_m)
                ));
            } else if !(1e-3..=20.0).contains(&size_m) {
                // Heuristic: rooms are a few metres large, and less than a millimetre is less than a pixel.
                self.notes.push(format!(
                    "{name}: its largest extent is {size_m:.3e} m; place.size_m sets it"
                ));
            }
            let model = &self.models[&file].model;
            let oriented = Oriented::new(&placement, object.up, model, bounds).map_err(fail)?;
            all.push(Prepared {
                object,
                name,
                file,
                placement,
                oriented,
            });
        }
        Ok(all)
    }

    /// Places all objects, and notes which ones had no room at their requested position.
    pub(super) fn place(
        &mut self,
        all: &[Prepared<'_>],
        frame: &PlacementFrame<'_>,
    ) -> Result<Vec<Placed>, SceneError> {
        let requests: Vec<PlaceRequest<'_>> = all
            .iter()
            .map(|prepared| PlaceRequest {
                placement: &prepared.placement,
                oriented: &prepared.oriented,
            })
            .collect();
        let placements = place::place(&requests, frame).map_err(|error| {
            let field = match error.field {
                "" => String::new(),
                field => format!(".{field}"),
            };
            let path = format!("objects[{}].place{field}", error.object);
            self.document.field(path, error.problem)
        })?;
        if let Some(Moved {
            pixel: [u, v],
            level,
        }) = placements.moved
        {
            let on_surface =
                |p: &&Prepared<'_>| p.placement.effective_frame() == PlaceFrame::Surface;
            let names = all.iter().filter(on_surface).map(|p| p.name.as_str());
            let names = names.collect::<Vec<_>>().join(", ");
            let surface = if level {
                "the nearest level surface with room"
            } else {
                "the nearest surface, as none with room is level"
            };
            self.notes.push(format!(
                "{names}: put on {surface}, at pixel ({u:.0}, {v:.0}); --place or place.pixel changes the place."
            ));
        }
        Ok(placements.placed)
    }
}

/// A length as text.
pub(super) fn metres(x: f64) -> String {
    if (0.01..1e4).contains(&x) {
        format!("{x:.2} m")
    } else {
        format!("{x:.1e} m")
    }
}
