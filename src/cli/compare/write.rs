//! The files of a comparison.

use std::io::Write as _;
use std::path::Path;

use super::Contender;
use crate::Result;
use crate::frame::Guides;
use crate::picture::Picture;
use crate::report::{
    Layer, Results, Tile, ToneMap, contact_sheet, csv, curve_csv, error_map, error_time_svg,
    markdown, spectrum_csv, warmup_csv, warmup_svg, write_atomic, write_exr, write_png,
};

/// Characters that are safe in file names everywhere; others become `-`.
pub(in crate::cli) fn file_name(text: &str) -> String {
    let safe = |c: char| if c.is_ascii_alphanumeric() || "-_.".contains(c) { c } else { '-' };
    let name: String = text.chars().map(safe).collect();
    if name.trim_matches('.').is_empty() { "scene".to_string() } else { name }
}

/// Writes everything to `folder`. Pictures show directly visible emission too; error maps and metrics leave it out.
pub(super) fn all(
    folder: &Path,
    results: &Results,
    contenders: &[Contender],
    (truth, guides): (&Picture, &Guides),
) -> Result<()> {
    let text =
        |name: &str, text: &str| write_atomic(&folder.join(name), |w| w.write_all(text.as_bytes()));
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
    let tone = ToneMap::for_reference(truth);
    let emission = contenders.iter().find_map(|c| c.emission.as_ref());
    let mut pictures = vec![Some(Tile::new(&sum(truth, emission), tone))];
    let mut errors = vec![None];
    save(folder, "reference", (truth, emission), &guide_layers(guides), tone)?;
    for (at, contender) in contenders.iter().enumerate() {
        let Some(shown) = &contender.shown else { continue };
        let mut name = file_name(&contender.spec);
        // The same technique may be compared with itself.
        if contenders[..at].iter().any(|other| other.spec == contender.spec) {
            name = format!("{name}-{}", at + 1);
        }
        save(folder, &name, (shown, contender.emission.as_ref()), &[], tone)?;
        pictures.push(Some(Tile::new(&sum(shown, contender.emission.as_ref()), tone)));
        errors.push(Some(error_map(shown, truth)));
    }
    write_png(&folder.join("contact.png"), &contact_sheet(&[pictures, errors]))
}

/// Albedo, normal, depth and motion as layers.
pub(in crate::cli) fn guide_layers(guides: &Guides) -> Vec<Layer> {
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

/// One picture as EXR, emission in a layer of its own, and as PNG.
fn save(
    folder: &Path,
    name: &str,
    (picture, emission): (&Picture, Option<&Picture>),
    more: &[Layer],
    tone: ToneMap,
) -> Result<()> {
    let all = sum(picture, emission);
    let mut layers = vec![Layer::rgb("color", &all)];
    layers.extend(emission.map(|e| Layer::rgb("emission", e)));
    layers.extend_from_slice(more);
    write_exr(&folder.join(format!("{name}.exr")), [all.width, all.height], &layers)?;
    write_png(&folder.join(format!("{name}.png")), &Tile::new(&all, tone))
}

/// Reflected light and emission.
pub(in crate::cli) fn sum(picture: &Picture, emission: Option<&Picture>) -> Picture {
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
