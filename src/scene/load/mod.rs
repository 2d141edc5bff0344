//! Scenes from files.
//!
//! | here | reads |
//! |---|---|
//! | [`load`] | a scene file, by its extension |
//! | [`pbrt_from_bytes`] | pbrt-v4 text in memory |
//! | [`gltf_from_bytes`] | glTF 2.0 in memory, text or binary |
//! | [`ply_from_bytes`] | a PLY mesh in memory, gzip or not |
//! | [`image_from_bytes`] | PNG, JPEG, TGA, Radiance HDR, PFM or OpenEXR in memory |
//!
//! Every refusal and every warning names the file and the line or JSON path, what was found and
//! what is allowed or was done. What is ignored or approximated is a warning in
//! [`Loaded::warnings`]. Limits are on bytes and on depth, never on a count of things that a scene
//! may well have. `docs/scenes.md` lists what is read and how spectra become RGB.

mod black;
mod coincident;
mod gltf;
mod normals;
mod pbrt;
mod picture;
mod ply;
mod precision;

use std::collections::HashSet;
use std::io::Read;
use std::path::Path;

pub use picture::Encoding;

use super::{Image, Loaded, Mesh};
use crate::error::{Error, Result};

/// Files above this size are refused: 4 GiB.
const MAX_FILE_BYTES: u64 = 1 << 32;

/// Gzipped files above this size unpacked are refused: 2 GiB.
const MAX_UNPACKED_BYTES: u64 = 1 << 31;

/// Reads a scene: `.pbrt` is pbrt-v4 text, `.gltf` and `.glb` are glTF 2.0. The result is valid
/// (see [`super::Scene::validate`]).
///
/// # Errors
/// The file cannot be read, is not what its extension says, or uses something outside
/// `docs/scenes.md`.
pub fn load(path: &Path) -> Result<Loaded> {
    if path.is_dir() {
        let message = "a folder, but a scene is a file in it: .pbrt, .gltf, .glb";
        return Err(Error::unsupported(message).with_path(path));
    }
    match extension(path).as_str() {
        "pbrt" => pbrt::load(path),
        "gltf" | "glb" => gltf::load(path),
        other => {
            let found = if other.is_empty() { "none".to_string() } else { format!("`.{other}`") };
            let message =
                format!("the scene's file extension is {found}; allowed: .pbrt, .gltf, .glb");
            Err(Error::unsupported(message).with_path(path))
        }
    }
}

/// Reads pbrt-v4 text. `path` names it in messages and need not exist; files that it refers to are
/// sought beside it.
///
/// # Errors
/// As [`load`].
pub fn pbrt_from_bytes(text: &[u8], path: &Path) -> Result<Loaded> {
    pbrt::from_bytes(text, path)
}

/// Reads a glTF 2.0 file, JSON or binary. `path` names it in messages; buffers and images are
/// sought beside it.
///
/// # Errors
/// As [`load`].
pub fn gltf_from_bytes(bytes: &[u8], path: &Path) -> Result<Loaded> {
    gltf::from_bytes(bytes, path)
}

/// Reads a PLY mesh: ASCII, binary of either byte order, or one of these gzipped. Polygons become
/// triangle fans. Triangles at a vertex whose normal has no direction have their faces' own.
///
/// # Errors
/// Bytes that are no PLY mesh, positions that are not finite, indices out of range, more data
/// declared than there is.
pub fn ply_from_bytes(bytes: &[u8]) -> Result<Mesh> {
    let ply::Read { mut mesh, .. } = ply::from_bytes(bytes)?;
    if !mesh.normals.is_empty() {
        let unit = mesh.normals.iter().map(|n| n.as_dvec3().try_normalize().map(|n| n.as_vec3()));
        let unit = unit.collect();
        normals::set(&mut mesh, unit, false);
    }
    Ok(mesh)
}

/// Decodes a picture by its leading bytes.
///
/// # Errors
/// Bytes that are no PNG, JPEG, TGA, Radiance HDR, PFM or OpenEXR, damaged ones, or a picture above
/// 32,768 pixels a side or 1 GiB decoded.
pub fn image_from_bytes(bytes: &[u8], encoding: Encoding) -> Result<Image> {
    picture::image_from_bytes(bytes, encoding)
}

/// The lower-case extension, or an empty string.
fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// A whole file, of bounded size.
fn read(path: &Path) -> Result<Vec<u8>> {
    let about = std::fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if about.is_dir() {
        return Err(Error::invalid("is a folder; a file is needed").with_path(path));
    }
    if about.len() > MAX_FILE_BYTES {
        let message = format!("has {} bytes; allowed: at most {MAX_FILE_BYTES}", about.len());
        return Err(Error::invalid(message).with_path(path));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e))
}

/// What gzipped bytes hold, at most [`MAX_UNPACKED_BYTES`]; `None` for others.
fn gunzip(bytes: &[u8]) -> Result<Option<Vec<u8>>> {
    if !bytes.starts_with(&[0x1f, 0x8b]) {
        return Ok(None);
    }
    let mut unpacked = Vec::new();
    let mut reader = flate2::read::MultiGzDecoder::new(bytes).take(MAX_UNPACKED_BYTES + 1);
    let read = reader.read_to_end(&mut unpacked);
    read.map_err(|e| Error::syntax(format!("damaged gzip data: {e}")))?;
    if unpacked.len() as u64 > MAX_UNPACKED_BYTES {
        return Err(Error::invalid(format!(
            "unpacks to more than {MAX_UNPACKED_BYTES} bytes; allowed: as many"
        )));
    }
    Ok(Some(unpacked))
}

/// Whether any placed surface emits.
fn emits(scene: &super::Scene) -> bool {
    let mut objects = scene.instances.iter().map(|i| &scene.objects[i.object.index()]);
    objects.any(|object| object.shapes.iter().any(|shape| shape.emission.is_some()))
}

/// What is placed at the scene's first time, and where.
fn placed(scene: &super::Scene) -> impl Iterator<Item = (&super::Instance, glam::Affine3A)> {
    let at = |i: &super::Instance| i.to_world.shown_at(scene.time[0]);
    scene.instances.iter().filter_map(move |i| at(i).map(|to_world| (i, to_world)))
}

/// Warns of geometry that renders otherwise than it is meant.
fn warn_of_geometry(scene: &super::Scene, warnings: &mut Warnings) {
    precision::warn(scene, warnings);
    coincident::warn(scene, warnings);
}

/// Warnings without repetition, in the order they were found.
#[derive(Debug, Default)]
struct Warnings {
    /// In front of each.
    prefix: String,
    list: Vec<String>,
    seen: HashSet<String>,
    dropped: usize,
}

impl Warnings {
    /// More than this many help nobody.
    const MAX: usize = 200;

    /// Of a file, which each of them names first.
    fn of(file: &Path) -> Self {
        let mut warnings = Self::default();
        warnings.about(file);
        warnings
    }

    /// As [`Warnings::of`] from here on.
    fn about(&mut self, file: &Path) -> &mut Self {
        self.prefix = format!("{}: ", file.display());
        self
    }

    /// Adds a warning unless the same one is there.
    fn add(&mut self, warning: impl std::fmt::Display) {
        let warning = format!("{}{warning}", self.prefix);
        if !self.seen.contains(&warning) {
            if self.list.len() < Self::MAX {
                self.seen.insert(warning.clone());
                self.list.push(warning);
            } else {
                self.dropped += 1;
            }
        }
    }

    /// Adds a warning unless another one with the same `topic` is there.
    fn add_once(&mut self, topic: &str, warning: impl std::fmt::Display) {
        if self.seen.insert(format!("\0{topic}")) {
            self.add(warning);
        }
    }

    /// The warnings about a scene in `file`, all of which name a file.
    fn into_vec(mut self, file: &Path) -> Vec<String> {
        if self.dropped > 0 {
            self.list.push(format!("{}: {} more warnings", file.display(), self.dropped));
        }
        self.list
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_extension_lists_the_known_ones() {
        let error = load(Path::new("a.obj")).unwrap_err();
        assert_eq!(
            error.to_string(),
            "a.obj: the scene's file extension is `.obj`; allowed: .pbrt, .gltf, .glb"
        );
        assert!(load(Path::new("a")).unwrap_err().to_string().contains("extension is none"));
    }

    #[test]
    fn a_missing_file_is_an_io_error_that_names_it() {
        let error = load(Path::new("no-such-folder/a.pbrt")).unwrap_err();
        assert!(error.is_io());
        assert_eq!(error.to_string(), "no-such-folder/a.pbrt: no such file");
    }

    #[test]
    fn warnings_are_not_repeated_and_bounded() {
        let mut warnings = Warnings::default();
        warnings.add("a");
        warnings.add("a");
        warnings.add_once("t", "b");
        warnings.add_once("t", "c");
        for i in 0..300 {
            warnings.add(format!("{i}"));
        }
        let list = warnings.into_vec(Path::new("s.pbrt"));
        assert_eq!(list[..3], ["a", "b", "0"]);
        assert_eq!(list.len(), 201);
        assert_eq!(list[200], "s.pbrt: 102 more warnings");
    }
}
