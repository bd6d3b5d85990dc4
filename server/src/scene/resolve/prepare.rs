//! What comes before placing: every mesh is loaded, every size settled, and objects that look for
//! a place of their own find it together.

use std::path::PathBuf;

use super::super::document::{Object, PlaceFrame, Placement, SceneDocument};
use super::super::error::SceneError;
use super::super::place::Turned;
use super::super::spot::{self, Ground, LOWER_MIDDLE, Wanted};
use super::{FIT_SIZE_M, PLAUSIBLE_M, ResolveOptions, Resolver};

/// An object whose mesh is loaded and whose size is known.
pub(super) struct Prepared<'a> {
    pub(super) object: &'a Object,
    pub(super) name: String,
    /// Its model, among [`Resolver::models`].
    pub(super) file: PathBuf,
    /// Its placement, with the pixel and size that are meant.
    pub(super) placement: Placement,
    /// The field that errors about its pixel name.
    pub(super) pixel_field: String,
    pub(super) turned: Turned,
}

impl<'a> Resolver<'a> {
    /// Loads every mesh and settles every size.
    pub(super) fn prepare(
        &mut self,
        options: &ResolveOptions<'_>,
    ) -> Result<Vec<Prepared<'a>>, SceneError> {
        let document = self.document;
        let mut all = Vec::with_capacity(document.objects.len());
        for (i, object) in document.objects.iter().enumerate() {
            let path = format!("objects[{i}]");
            let name = SceneDocument::name_of(object);
            let file = self.load(object, &name, &path)?;
            let mut placement = object.place.clone();
            let mut pixel_field = format!("{path}.place.pixel");
            if let (0, Some(pixel)) = (i, options.place_pixel) {
                if placement.effective_frame() != PlaceFrame::Pixel {
                    placement.translation = [0.0; 3];
                }
                placement.frame = Some(PlaceFrame::Pixel);
                placement.pixel = Some(pixel);
                placement.picture = None;
                pixel_field = "--place".to_owned();
            }
            let bounds = self.models[&file].bounds;
            let fail = |(field, problem)| document.field(format!("{path}.place.{field}"), problem);
            let mut turned = Turned::new(&placement, object.up, bounds).map_err(fail)?;
            let size_m = turned.size_m;
            let free = placement.scale.is_none() && placement.size_m.is_none();
            if object.bare && free && size_m > 0.0 && !PLAUSIBLE_M.contains(&size_m) {
                placement.size_m = Some(FIT_SIZE_M);
                turned = Turned::new(&placement, object.up, bounds).map_err(fail)?;
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
                // Heuristic: rooms are a few metres, and less than a millimetre is less than a
                // pixel.
                self.notes.push(format!(
                    "{name}: its largest extent is {size_m:.3e} m; place.size_m sets it"
                ));
            }
            all.push(Prepared {
                object,
                name,
                file,
                placement,
                pixel_field,
                turned,
            });
        }
        Ok(all)
    }

    /// Where objects whose frame is `surface` stand, together; `None` for the others.
    pub(super) fn grounds(
        &mut self,
        all: &[Prepared<'_>],
        options: &ResolveOptions<'_>,
    ) -> Result<Vec<Option<Ground>>, SceneError> {
        let depth = &options.first_frame.depth;
        let theirs: Vec<usize> = (0..all.len())
            .filter(|&i| all[i].placement.effective_frame() == PlaceFrame::Surface)
            .collect();
        let mut grounds = vec![None; all.len()];
        let Some(&first) = theirs.first() else {
            return Ok(grounds);
        };
        let wanted: Vec<Wanted> = theirs
            .iter()
            .map(|&i| {
                let mut placement = all[i].placement.clone();
                let picture = *placement.picture.get_or_insert(LOWER_MIDDLE);
                Wanted {
                    pixel: placement
                        .effective_pixel(depth.width, depth.height)
                        .unwrap_or(picture),
                    radius_m: all[i].turned.radius_m(&self.models[&all[i].file].model),
                }
            })
            .collect();
        let Some(found) = spot::find(&wanted, options) else {
            return Err(self.document.field(
                format!("objects[{first}].place"),
                "the first frame has no measured surface to stand on".into(),
            ));
        };
        let names: Vec<&str> = theirs.iter().map(|&i| all[i].name.as_str()).collect();
        let names = names.join(", ");
        if let Some([u, v]) = found.moved_to {
            let surface = if found.level {
                "the nearest level surface with room"
            } else {
                "the nearest surface, as none with room is level"
            };
            self.notes.push(format!(
                "{names}: put on {surface}, at pixel ({u:.0}, {v:.0}); --place or place.pixel puts it elsewhere."
            ));
        }
        for (i, ground) in theirs.into_iter().zip(found.grounds) {
            grounds[i] = Some(ground);
        }
        Ok(grounds)
    }
}

/// A length for people.
pub(super) fn metres(x: f64) -> String {
    if (0.01..1e4).contains(&x) {
        format!("{x:.2} m")
    } else {
        format!("{x:.1e} m")
    }
}
