//! `ghostlight presets`.

use anyhow::Result;
use ghostlight::output;
use ghostlight::scene::Preset;

/// List the material presets.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight presets
  ghostlight replay my-recording --object duck.glb --material gold --out film.mp4

In a scene document: \"material\": {\"preset\": \"gold\", \"roughness\": 0.3}; fields beside the
preset override it.")]
pub(crate) struct PresetsArgs {}

pub(crate) fn run(_: &PresetsArgs) -> Result<()> {
    Ok(output::print(table().trim_end())?)
}

/// One line for each preset: name, appearance, and definition.
fn table() -> String {
    Preset::ALL
        .map(|preset| {
            let material = preset.material();
            let base = material.base_color;
            let kind = if material.transmission > 0.0 {
                format!(
                    "transmission {}, ior {}",
                    material.transmission, material.ior
                )
            } else {
                format!(
                    "base_color {:.3} {:.3} {:.3}, metallic {}",
                    base.x, base.y, base.z, material.metallic
                )
            };
            format!(
                "{:<14} {:<45} {kind}, roughness {}\n",
                preset.name(),
                preset.about(),
                material.roughness
            )
        })
        .concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_has_a_line_and_documents_know_its_name() {
        let table = table();
        assert_eq!(table.lines().count(), Preset::ALL.len());
        for (line, preset) in table.lines().zip(Preset::ALL) {
            let name = line.split_whitespace().next().unwrap();
            let text = format!(
                "{{\"version\": 1, \"objects\": [{{\"mesh\": \"a.obj\", \"material\": {{\"preset\": \"{name}\"}}}}]}}"
            );
            let document = ghostlight::scene::SceneDocument::parse(&text, "scene").unwrap();
            let material = document.objects[0].material.clone().unwrap();
            assert_eq!(material.preset, Some(preset));
        }
    }
}
