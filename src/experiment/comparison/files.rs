//! The files of a comparison.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::{Compared, Shown};
use crate::Result;
use crate::frame::Guides;
use crate::picture::Picture;
use crate::report::{
    Layer, Tile, ToneMap, contact_sheet, csv, curve_csv, error_map, error_time_svg, markdown,
    spectrum_csv, warmup_csv, warmup_svg, write_atomic, write_exr, write_png,
};

/// Characters that are safe in file names everywhere; others become `-`.
pub(crate) fn file_name(text: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    let name: String = text.chars().map(safe).collect();
    if name.trim_matches('.').is_empty() { "scene".to_string() } else { name }
}

impl Compared {
    /// Writes everything to `folder`: results.json, tables, curves, plots, and pictures as EXR and
    /// PNG. Pictures show directly visible emission too; error maps and metrics leave it out.
    ///
    /// # Errors
    /// Where the operating system refuses to write.
    pub fn write(&self, folder: &Path) -> Result<()> {
        self.write_texts(folder)?;
        self.write_pictures(folder)
    }

    fn write_texts(&self, folder: &Path) -> Result<()> {
        let results = &self.results;
        let text = |name: &str, text: &str| {
            write_atomic(&folder.join(name), |w| w.write_all(text.as_bytes()))
        };
        let json = serde_json::to_string_pretty(results)
            .map_err(|e| crate::Error::invalid(format!("cannot write the results as JSON: {e}")))?;
        text("results.json", &json)?;
        text("table.md", &markdown(results))?;
        text("table.csv", &csv(results))?;
        if !results.curves.is_empty() {
            text("curve.csv", &curve_csv(results))?;
            if let Some(svg) = error_time_svg(&results.scene, &results.curves)? {
                text("error_time.svg", &svg)?;
            }
        }
        text("spectrum.csv", &spectrum_csv(results))?;
        if !results.warmups.is_empty() {
            text("warmup.csv", &warmup_csv(results))?;
            if let Some(svg) = warmup_svg(&results.scene, &results.warmups)? {
                text("warmup.svg", &svg)?;
            }
        }
        Ok(())
    }

    fn write_pictures(&self, folder: &Path) -> Result<()> {
        let Self { truth, guides, shown: all, .. } = self;
        let tone = ToneMap::for_reference(truth);
        let emission = all.iter().find_map(|shown| shown.emission.as_ref());
        let mut pictures = vec![Some(Tile::new(&sum(truth, emission), tone))];
        let mut errors = vec![None];
        let layers = guide_layers(guides);
        save(&folder.join("reference"), Light { reflected: truth, emission }, &layers, tone)?;
        for (at, shown) in all.iter().enumerate() {
            let Shown { technique, picture: Some(picture), emission } = shown else { continue };
            let mut name = file_name(technique);
            // The same technique may be compared with itself.
            if all[..at].iter().any(|other| other.technique == *technique) {
                name = format!("{name}-{}", at + 1);
            }
            let light = Light { reflected: picture, emission: emission.as_ref() };
            save(&folder.join(name), light, &[], tone)?;
            pictures.push(Some(Tile::new(&sum(picture, emission.as_ref()), tone)));
            errors.push(Some(error_map(picture, truth)));
        }
        write_png(&folder.join("contact.png"), &contact_sheet(&[pictures, errors]))
    }
}

/// A picture in its two parts.
struct Light<'a> {
    reflected: &'a Picture,
    emission: Option<&'a Picture>,
}

/// Albedo, normal, depth and motion as layers.
pub(crate) fn guide_layers(guides: &Guides) -> Vec<Layer> {
    let [width, height] = guides.size;
    let motion = Layer {
        name: "motion".to_string(),
        channels: vec![
            ("X", guides.motion.iter().map(|m| m.x).collect()),
            ("Y", guides.motion.iter().map(|m| m.y).collect()),
        ],
    };
    vec![
        Layer::rgb("albedo", &Picture::new(width, height, guides.albedo.clone())),
        Layer::xyz("normal", &guides.normal),
        Layer::scalar("depth", "Z", guides.depth.clone()),
        motion,
    ]
}

/// Writes one picture as EXR, emission in a layer of its own, and as PNG. `path` is without its
/// extension, and may have dots.
fn save(path: &Path, light: Light<'_>, more: &[Layer], tone: ToneMap) -> Result<()> {
    let all = sum(light.reflected, light.emission);
    let mut layers = vec![Layer::rgb("color", &all)];
    layers.extend(light.emission.map(|e| Layer::rgb("emission", e)));
    layers.extend_from_slice(more);
    let with = |extension: &str| {
        let mut path = path.as_os_str().to_os_string();
        path.push(extension);
        PathBuf::from(path)
    };
    write_exr(&with(".exr"), [all.width, all.height], &layers)?;
    write_png(&with(".png"), &Tile::new(&all, tone))
}

/// Reflected light and emission.
pub(crate) fn sum(picture: &Picture, emission: Option<&Picture>) -> Picture {
    match emission {
        Some(emission) => {
            let pixels =
                picture.pixels.iter().zip(&emission.pixels).map(|(a, b)| *a + *b).collect();
            Picture::new(picture.width, picture.height, pixels)
        }
        None => picture.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_files_are_safe() {
        assert_eq!(file_name("restir-di:visibility=wis,cap=5"), "restir-di-visibility-wis-cap-5");
        assert_eq!(file_name("../a b"), "..-a-b");
        assert_eq!(file_name(".."), "scene");
    }
}
