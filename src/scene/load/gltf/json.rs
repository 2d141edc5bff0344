//! What the JSON alone can tell: whether it is glTF 2.0, and of which extensions. Messages are in
//! words; those of the crates that read it name their own types.

use gltf::json::Root;
use gltf::json::validation::{Checked, Error as Fault, Validate};

use super::super::Warnings;
use crate::error::{Error, Result};

/// Extensions that are read. `KHR_mesh_quantization` only allows more number formats, all of which
/// are read.
const EXTENSIONS: [&str; 8] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// The JSON as glTF. Channels of animations without a node, which extensions have, are left out:
/// the crate would refuse them.
pub(super) fn parse(json: &[u8], warnings: &mut Warnings) -> Result<Root> {
    let error = match Root::from_slice(json) {
        Ok(root) => return Ok(root),
        Err(error) => error,
    };
    if error.is_data()
        && let Ok(mut value) = serde_json::from_slice::<serde_json::Value>(json)
    {
        let mut dropped = false;
        let animations = value.get_mut("animations").and_then(|a| a.as_array_mut());
        for (a, animation) in animations.into_iter().flatten().enumerate() {
            let Some(channels) = animation.get_mut("channels").and_then(|c| c.as_array_mut())
            else {
                continue;
            };
            let all = channels.len();
            channels.retain(|c| c.pointer("/target").is_none_or(|t| t.get("node").is_some()));
            if channels.len() < all {
                dropped = true;
                warnings
                    .add(format!("animations[{a}].channels: some drive no node; they are ignored"));
            }
        }
        if dropped && let Ok(root) = Root::from_slice(value.to_string().as_bytes()) {
            return Ok(root);
        }
    }
    let (line, column) = (error.line() as u32, error.column() as u32);
    Err(Error::syntax(format!("not glTF 2.0: {}", of_json(&error))).at_line(line, column))
}

/// What is wrong with a JSON text, in words: the crate's own name its types and the place again.
fn of_json(error: &serde_json::Error) -> String {
    use serde_json::error::Category;
    match error.classify() {
        Category::Eof => "the JSON text ends too early".to_string(),
        Category::Syntax | Category::Io => "the text is not JSON".to_string(),
        Category::Data => {
            let text = error.to_string();
            let end = text.find(", expected").or_else(|| text.find(" at line "));
            let found = &text[..end.unwrap_or(text.len())];
            let found = found.strip_prefix("invalid type: ").unwrap_or(found);
            let found: String = found.chars().filter(|c| !c.is_control()).take(80).collect();
            format!("{found} does not fit there")
        }
    }
}

/// Whether files that require an extension are shown without it: it adds to how a surface looks.
fn can_be_left_out(extension: &str) -> bool {
    extension.starts_with("KHR_materials_") || extension == "KHR_xmp_json_ld"
}

/// What the JSON alone can tell: versions, extensions, indices.
pub(super) fn check(root: &Root, warnings: &mut Warnings) -> Result<()> {
    if !root.asset.version.starts_with("2.") {
        let message = format!("is `{}`; allowed: 2.0", root.asset.version);
        return Err(Error::unsupported(message).at_json("asset.version"));
    }
    for (i, name) in root.extensions_required.iter().enumerate() {
        if !EXTENSIONS.contains(&name.as_str()) && !can_be_left_out(name) {
            let message = format!("is `{name}`; allowed: {}", EXTENSIONS.join(", "));
            return Err(Error::unsupported(message).at_json(format!("extensionsRequired[{i}]")));
        }
    }
    for (i, name) in root.extensions_used.iter().enumerate() {
        if !EXTENSIONS.contains(&name.as_str()) {
            let known = EXTENSIONS.join(", ");
            warnings.add(format!("extensionsUsed[{i}]: `{name}` is ignored; read are: {known}"));
        }
    }
    // The crate's own check indexes the accessors with POSITION before it has checked that index.
    for (m, mesh) in root.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            for (semantic, accessor) in &primitive.attributes {
                let place = format!("meshes[{m}].primitives[{p}].attributes");
                let Checked::Valid(semantic) = semantic else {
                    warnings.add(format!(
                        "{place}: names that glTF 2.0 does not know are ignored; those of applications begin with `_`"
                    ));
                    continue;
                };
                if accessor.value() >= root.accessors.len() {
                    let name = semantic.to_string();
                    let message =
                        format!("is {}; allowed: below {}", accessor.value(), root.accessors.len());
                    return Err(Error::invalid(message).at_json(format!("{place}.{name}")));
                }
            }
        }
    }
    let mut first = None;
    root.validate(root, gltf::json::Path::new, &mut |path, fault| {
        let place = path().to_string();
        // Checked above, and more kindly. Bounds of POSITION are not needed, and a primitive
        // without POSITION shows nothing.
        let known = place.starts_with("extensionsRequired") || place.contains(".attributes");
        if first.is_none() && !known {
            first = Some((place, fault));
        }
    });
    let Some((place, fault)) = first else { return Ok(()) };
    let message = match fault {
        Fault::IndexOutOfBounds => "refers to what does not exist",
        Fault::Missing => "is missing",
        Fault::Invalid => "is nothing that glTF 2.0 knows",
        Fault::Oversize => "is too large",
        Fault::Unsupported => "is not read",
    };
    Err(Error::invalid(message).at_json(of_file(&place)))
}

/// A place with the names of extensions as files have them; the crate writes those of its fields.
fn of_file(place: &str) -> String {
    let names = [
        ("khrLightsPunctual", "KHR_lights_punctual"),
        ("textureTransform", "KHR_texture_transform"),
        ("emissiveStrength", "KHR_materials_emissive_strength"),
        ("specular", "KHR_materials_specular"),
        ("transmission", "KHR_materials_transmission"),
        ("volume", "KHR_materials_volume"),
        ("ior", "KHR_materials_ior"),
    ];
    names.into_iter().fold(place.to_string(), |place, (field, name)| {
        place.replace(&format!("extensions.{field}"), &format!("extensions.{name}"))
    })
}
