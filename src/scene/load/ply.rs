//! PLY meshes (crate `ply-rs-bw`, read into our own elements): ASCII, binary of either byte order,
//! gzipped or not.
//!
//! A header may promise any number of elements; it is believed only as far as the bytes behind it
//! reach.

use std::panic::{AssertUnwindSafe, catch_unwind};

use glam::{Vec2, Vec3};
use ply_rs_bw::parser::{ParseError, Parser, Reader};
use ply_rs_bw::ply::{
    ElementDef, Encoding, Property, PropertyAccess, PropertyAccessResult, PropertyType, ScalarType,
};

use crate::error::{Error, Result};
use crate::scene::Mesh;

/// A mesh as the file has it, and what was made of values that are none.
#[derive(Debug)]
pub(super) struct Read {
    /// Its normals may have any length, none, or be no numbers at all.
    pub(super) mesh: Mesh,
    pub(super) warnings: Vec<String>,
}

/// Reads a mesh; errors carry no path.
pub(super) fn from_bytes(bytes: &[u8]) -> Result<Read> {
    let unpacked = super::gunzip(bytes)?;
    let bytes = unpacked.as_deref().unwrap_or(bytes);
    let replaced = without_words(bytes);
    let bytes = replaced.as_deref().unwrap_or(bytes);
    // The parser is other people's; a panic in it is an error of the file, not of the program.
    catch_unwind(AssertUnwindSafe(|| parse(bytes)))
        .unwrap_or_else(|_| Err(Error::syntax("damaged PLY file: its parser failed")))
}

/// An ASCII file with a number beyond all f32 in the place of `nan` and `inf`, which the parser
/// does not know; `None` where there are none.
fn without_words(bytes: &[u8]) -> Option<Vec<u8>> {
    const END: &[u8] = b"end_header";
    let header = bytes.windows(END.len()).position(|window| window == END)? + END.len();
    let (header, data) = bytes.split_at(header);
    let ascii = header.windows(12).any(|window| window == b"format ascii");
    if !ascii || !data.iter().any(|byte| matches!(byte, b'n' | b'N')) {
        return None;
    }
    let mut replaced = header.to_vec();
    for piece in data.split_inclusive(u8::is_ascii_whitespace) {
        let end = piece.iter().position(u8::is_ascii_whitespace).unwrap_or(piece.len());
        let (word, space) = piece.split_at(end);
        let bare = word.strip_prefix(b"-").or(word.strip_prefix(b"+")).unwrap_or(word);
        let known = [&b"nan"[..], b"inf", b"infinity"];
        let other = known.iter().any(|known| bare.eq_ignore_ascii_case(known));
        replaced.extend_from_slice(if other { b"1e999" } else { word });
        replaced.extend_from_slice(space);
    }
    Some(replaced)
}

fn parse(bytes: &[u8]) -> Result<Read> {
    let mut reader = Reader::new(bytes);
    let header = Parser::<Vertex>::new().read_header(&mut reader).map_err(|e| {
        damaged(&e, "its header", "ply, format, comment, obj_info, element, property, end_header")
    })?;
    let damaged = |e: ParseError| {
        damaged(
            &e,
            "the data behind its header",
            "as many numbers of such types as the header says",
        )
    };
    let mut vertices: Option<Vec<Vertex>> = None;
    let mut faces: Option<Vec<Face>> = None;
    let (mut has_normals, mut has_uvs) = (false, false);
    for (_, element) in &header.elements {
        check_count(element, header.encoding, reader.get_ref().len())?;
        match element.name.as_str() {
            "vertex" => {
                let has = |names: &[&str]| {
                    names.iter().all(|name| element.properties.contains_key(*name))
                };
                if !has(&["x", "y", "z"]) {
                    return Err(Error::invalid(
                        "the PLY vertices have no x, y, z; allowed: x y z [nx ny nz] [u v]",
                    ));
                }
                has_normals = has(&["nx", "ny", "nz"]);
                has_uvs = UV_NAMES.iter().any(|pair| has(pair));
                vertices = Some(
                    Parser::<Vertex>::new()
                        .read_payload_for_element(&mut reader, element, &header)
                        .map_err(damaged)?,
                );
            }
            "face" => {
                if !["vertex_indices", "vertex_index"]
                    .iter()
                    .any(|name| element.properties.contains_key(*name))
                {
                    return Err(Error::invalid(
                        "the PLY faces have no list `vertex_indices`; allowed: vertex_indices, vertex_index",
                    ));
                }
                faces = Some(
                    Parser::<Face>::new()
                        .read_payload_for_element(&mut reader, element, &header)
                        .map_err(damaged)?,
                );
            }
            // What follows both is of no interest.
            _ if vertices.is_some() && faces.is_some() => break,
            _ => {
                Parser::<Skipped>::new()
                    .read_payload_for_element(&mut reader, element, &header)
                    .map_err(damaged)?;
            }
        }
    }
    let (Some(vertices), Some(faces)) = (vertices, faces) else {
        return Err(Error::invalid(
            "the PLY file lacks vertices or faces; allowed: elements `vertex` and `face`",
        ));
    };
    to_mesh(&vertices, &faces, has_normals, has_uvs)
}

/// What the parser stumbled over, in our words: its own name its types.
fn damaged(error: &ParseError, part: &str, allowed: &str) -> Error {
    let line = error.line().map_or_else(String::new, |line| format!(", at line {line}"));
    Error::syntax(format!("damaged PLY file: {part} cannot be read{line}; allowed: {allowed}"))
}

/// Names of texture coordinates in use.
const UV_NAMES: [[&str; 2]; 4] =
    [["u", "v"], ["s", "t"], ["texture_u", "texture_v"], ["texture_s", "texture_t"]];

/// Refuses a count that the remaining bytes cannot hold.
fn check_count(element: &ElementDef, encoding: Encoding, bytes: usize) -> Result<()> {
    let size = |kind: &ScalarType| match kind {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    };
    let least: usize = match encoding {
        // A digit and a separator.
        Encoding::Ascii => 2 * element.properties.len(),
        _ => {
            let sizes = element.properties.iter().map(|(_, p)| match &p.data_type {
                PropertyType::Scalar(kind) | PropertyType::List(kind, _) => size(kind),
            });
            sizes.sum()
        }
    };
    // The last line may lack its end.
    let holds = (bytes + 1).checked_div(least).unwrap_or(0);
    if element.count <= holds {
        return Ok(());
    }
    let message = format!(
        "the PLY header promises {} elements `{}`; allowed: at most {holds}, as many as the file can hold",
        element.count, element.name
    );
    Err(Error::invalid(message))
}

fn to_mesh(vertices: &[Vertex], faces: &[Face], has_normals: bool, has_uvs: bool) -> Result<Read> {
    if u32::try_from(vertices.len()).is_err() {
        return Err(Error::invalid(format!(
            "the PLY file has {} vertices; allowed: at most {}",
            vertices.len(),
            u32::MAX
        )));
    }
    let mut triangles = Vec::with_capacity(faces.len());
    for (i, face) in faces.iter().enumerate() {
        let corners = &face.indices;
        if corners.len() < 3 {
            return Err(Error::invalid(format!(
                "face {i} of the PLY file has {} corners; allowed: at least 3",
                corners.len()
            )));
        }
        if let Some(bad) = corners.iter().find(|c| **c < 0 || **c >= vertices.len() as i64) {
            let message = format!(
                "face {i} of the PLY file names vertex {bad}; allowed: 0 to {}",
                vertices.len() as i64 - 1
            );
            return Err(Error::invalid(message));
        }
        // A fan: right for convex polygons.
        triangles.extend(
            corners[1..].windows(2).map(|edge| [corners[0], edge[0], edge[1]].map(|c| c as u32)),
        );
    }
    let positions: Vec<Vec3> = vertices.iter().map(|v| v.position).collect();
    let normals: Vec<Vec3> =
        if has_normals { vertices.iter().map(|v| v.normal).collect() } else { Vec::new() };
    let mut uvs: Vec<Vec2> =
        if has_uvs { vertices.iter().map(|v| v.uv).collect() } else { Vec::new() };
    if let Some(bad) = positions.iter().position(|p| !p.is_finite()) {
        return Err(Error::invalid(format!(
            "vertex {bad} of the PLY file is at {}; allowed: finite numbers",
            positions[bad]
        )));
    }
    let mut warnings = Vec::new();
    if let Some(bad) = uvs.iter().position(|uv| !uv.is_finite()) {
        warnings.push(format!(
            "vertex {bad} has texture coordinates that are not finite; such ones are taken as 0 0"
        ));
        uvs.iter_mut().filter(|uv| !uv.is_finite()).for_each(|uv| *uv = Vec2::ZERO);
    }
    Ok(Read { mesh: Mesh { positions, normals, uvs, triangles }, warnings })
}

/// An element `vertex`.
#[derive(Debug, Default)]
struct Vertex {
    position: Vec3,
    normal: Vec3,
    uv: Vec2,
}

impl PropertyAccess for Vertex {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let target = match name {
            "x" => &mut self.position.x,
            "y" => &mut self.position.y,
            "z" => &mut self.position.z,
            "nx" => &mut self.normal.x,
            "ny" => &mut self.normal.y,
            "nz" => &mut self.normal.z,
            "u" | "s" | "texture_u" | "texture_s" => &mut self.uv.x,
            "v" | "t" | "texture_v" | "texture_t" => &mut self.uv.y,
            _ => return PropertyAccessResult::Ignored,
        };
        match property.to_f32_lossy() {
            Some(value) => {
                *target = value;
                PropertyAccessResult::Set
            }
            None => PropertyAccessResult::UnsupportedType,
        }
    }
}

/// An element `face`.
#[derive(Debug, Default)]
struct Face {
    indices: Vec<i64>,
}

impl PropertyAccess for Face {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        if !matches!(name, "vertex_indices" | "vertex_index") {
            return PropertyAccessResult::Ignored;
        }
        self.indices = match property {
            Property::ListChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUChar(list) => list.into_iter().map(i64::from).collect(),
            Property::ListShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUShort(list) => list.into_iter().map(i64::from).collect(),
            Property::ListInt(list) => list.into_iter().map(i64::from).collect(),
            Property::ListUInt(list) => list.into_iter().map(i64::from).collect(),
            _ => return PropertyAccessResult::UnsupportedType,
        };
        PropertyAccessResult::Set
    }
}

/// An element that is read past.
#[derive(Debug)]
struct Skipped;

impl PropertyAccess for Skipped {
    fn new() -> Self {
        Self
    }
}
