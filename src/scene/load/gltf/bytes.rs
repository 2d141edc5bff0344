//! The bytes of a glTF file: container, resources, accessors. Every range is checked here, so
//! nothing later can read outside of it.

use std::borrow::Cow;
use std::cell::Cell;
use std::ops::Range;
use std::path::{Path, PathBuf};

use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Root, accessor, buffer};

use crate::error::{Error, Result};

/// Splits a binary glTF into its JSON and its binary chunk; anything that does not begin with
/// `glTF` is JSON.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| -> Option<u32> {
        Some(u32::from_le_bytes(bytes.get(at..at.checked_add(4)?)?.try_into().ok()?))
    };
    let cut = || Error::syntax("the binary glTF ends inside a header; it was cut short");
    let version = word(4).ok_or_else(cut)?;
    if version != 2 {
        let message = format!("the binary glTF has version {version}; allowed: 2");
        return Err(Error::unsupported(message));
    }
    let length = word(8).ok_or_else(cut)? as usize;
    if length > bytes.len() {
        let message =
            format!("the binary glTF says it has {length} bytes, there are {}", bytes.len());
        return Err(Error::syntax(message));
    }
    let mut json = None;
    let mut binary = None;
    let mut at = 12;
    while at < length {
        let size = word(at).ok_or_else(cut)? as usize;
        let kind = word(at + 4).ok_or_else(cut)?.to_le_bytes();
        let Some(chunk) = bytes.get(at + 8..).and_then(|rest| rest.get(..size)) else {
            let message =
                format!("the chunk at byte {at} has {size} bytes, which the file does not hold");
            return Err(Error::syntax(message));
        };
        match &kind {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if json.is_some() && binary.is_none() => binary = Some(chunk),
            // The specification wants unknown chunks to be skipped.
            _ => {}
        }
        at += 8 + size;
    }
    let json = json.ok_or_else(|| Error::syntax("the binary glTF has no JSON chunk"))?;
    Ok((json, binary))
}

/// What a URI refers to.
pub(super) enum Resource {
    /// Decoded from the URI itself.
    Inline(Vec<u8>),
    /// A file.
    File(PathBuf),
}

/// Resolves a URI beside the file `scene`.
pub(super) fn resolve(uri: &str, scene: &Path) -> Result<Resource> {
    if let Some(rest) = uri.strip_prefix("data:") {
        let (about, data) = rest
            .split_once(',')
            .ok_or_else(|| Error::syntax("a `data:` URI without a comma before its data"))?;
        let inline =
            if about.ends_with(";base64") { base64(data)? } else { percent_decoded(data)? };
        return Ok(Resource::Inline(inline));
    }
    let shown: String = uri.chars().take(80).collect();
    if uri.starts_with('/') || uri.split('/').next().is_some_and(|first| first.contains(':')) {
        let message = format!("the URI `{shown}`; allowed: relative paths and `data:` URIs");
        return Err(Error::unsupported(message));
    }
    let decoded = String::from_utf8(percent_decoded(uri)?)
        .map_err(|_| Error::syntax(format!("the URI `{shown}` is not UTF-8 once decoded")))?;
    let file = Path::new(&decoded);
    if decoded.is_empty() || decoded.contains('\0') || file.is_absolute() {
        let message = format!("the URI `{shown}`; allowed: relative paths and `data:` URIs");
        return Err(Error::unsupported(message));
    }
    let file = scene.parent().unwrap_or(Path::new("")).join(file);
    // A device or a pipe would have no end.
    match std::fs::metadata(&file) {
        Err(error) => Err(Error::io(&file, error)),
        Ok(about) if !about.is_file() => {
            Err(Error::invalid("is not a regular file").with_path(&file))
        }
        Ok(_) => Ok(Resource::File(file)),
    }
}

/// Undoes `%41` (RFC 3986).
fn percent_decoded(text: &str) -> Result<Vec<u8>> {
    let mut decoded = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        rest = after;
        if byte == b'%' {
            let digit =
                |i: usize| after.get(i).and_then(|&b| (b as char).to_digit(16)).map(|d| d as u8);
            let (Some(high), Some(low)) = (digit(0), digit(1)) else {
                return Err(Error::syntax(
                    "a `%` in a URI without two hexadecimal digits behind it",
                ));
            };
            decoded.push(high << 4 | low);
            rest = &after[2..];
        } else {
            decoded.push(byte);
        }
    }
    Ok(decoded)
}

/// Base64 (RFC 4648), with or without padding.
fn base64(text: &str) -> Result<Vec<u8>> {
    let text = text.trim_end_matches('=').as_bytes();
    let mut decoded = Vec::with_capacity(text.len() / 4 * 3 + 2);
    for (group, four) in text.chunks(4).enumerate() {
        let mut bits = 0_u32;
        for (i, &byte) in four.iter().enumerate() {
            let digit = match byte {
                b'A'..=b'Z' => byte - b'A',
                b'a'..=b'z' => byte - b'a' + 26,
                b'0'..=b'9' => byte - b'0' + 52,
                b'+' => 62,
                b'/' => 63,
                _ => {
                    let at = 4 * group + i;
                    let message =
                        format!("byte {byte} at {at} of base64 data; allowed: A-Z a-z 0-9 + /");
                    return Err(Error::syntax(message));
                }
            };
            bits |= u32::from(digit) << (18 - 6 * i);
        }
        let whole = match four.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return Err(Error::syntax("base64 data that ends inside a byte")),
        };
        decoded.extend_from_slice(&bits.to_be_bytes()[1..=whole]);
    }
    Ok(decoded)
}

/// The buffers of a file and typed access to them.
pub(super) struct Buffers<'a> {
    root: &'a Root,
    bytes: Vec<Cow<'a, [u8]>>,
    /// Elements that may still be decoded: a small file can refer to the same bytes any number of
    /// times.
    budget: Cell<u64>,
}

/// Equally spaced elements.
struct Rows<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Rows<'a> {
    fn row(&self, i: usize) -> &'a [u8] {
        &self.bytes[i * self.stride..][..self.size]
    }
}

impl<'a> Buffers<'a> {
    /// Reads every buffer. `binary` is the chunk of a binary glTF.
    pub(super) fn read(root: &'a Root, binary: Option<&'a [u8]>, scene: &Path) -> Result<Self> {
        let mut bytes = Vec::with_capacity(root.buffers.len());
        let mut total = 0_u64;
        for (i, buffer) in root.buffers.iter().enumerate() {
            let at = |field: &str| format!("buffers[{i}].{field}");
            let data = match (&buffer.uri, binary) {
                (Some(uri), _) => match resolve(uri, scene).map_err(|e| e.at_json(at("uri")))? {
                    Resource::Inline(data) => Cow::Owned(data),
                    Resource::File(file) => {
                        Cow::Owned(super::super::read(&file).map_err(|e| e.at_json(at("uri")))?)
                    }
                },
                (None, Some(chunk)) if i == 0 => Cow::Borrowed(chunk),
                (None, _) => {
                    let message = "missing; only the first buffer of a binary glTF may be without";
                    return Err(Error::invalid(message).at_json(at("uri")));
                }
            };
            if (data.len() as u64) < buffer.byte_length.0 {
                let message =
                    format!("is {}, but there are {} bytes", buffer.byte_length.0, data.len());
                return Err(Error::invalid(message).at_json(at("byteLength")));
            }
            total = total.saturating_add(data.len() as u64);
            bytes.push(data);
        }
        // Honest files decode every byte about once; 16 leaves room for shared vertices.
        let budget = Cell::new((1 << 22) + total.saturating_mul(16));
        Ok(Self { root, bytes, budget })
    }

    /// Takes `elements` from what may be decoded.
    pub(super) fn spend(&self, elements: u64, place: &str) -> Result<()> {
        match self.budget.get().checked_sub(elements) {
            Some(left) => {
                self.budget.set(left);
                Ok(())
            }
            None => {
                let message = "refers to far more data than the file holds: the same bytes are used too many times";
                Err(Error::invalid(message).at_json(place))
            }
        }
    }

    /// The bytes of a buffer view.
    pub(super) fn view(&self, index: Index<buffer::View>) -> Result<&[u8]> {
        let i = index.value();
        let view = self.root.get(index).ok_or_else(|| missing("bufferViews", i))?;
        let buffer = self
            .bytes
            .get(view.buffer.value())
            .ok_or_else(|| missing("buffers", view.buffer.value()))?;
        let start = view.byte_offset.map_or(0, |offset| offset.0);
        let range = start
            .checked_add(view.byte_length.0)
            .and_then(|end| buffer.get(usize::try_from(start).ok()?..usize::try_from(end).ok()?));
        range.ok_or_else(|| {
            let message = format!(
                "bytes {start} and {} more; the buffer has {}",
                view.byte_length.0,
                buffer.len()
            );
            Error::invalid(message).at_json(format!("bufferViews[{i}]"))
        })
    }

    fn rows(
        &self,
        view: Index<buffer::View>,
        offset: u64,
        count: usize,
        size: usize,
        place: &str,
    ) -> Result<Rows<'_>> {
        let bytes = self.view(view)?;
        let stride = self.root.get(view).and_then(|v| v.byte_stride).map_or(size, |s| s.0);
        let needed = (count as u64)
            .saturating_sub(1)
            .checked_mul(stride as u64)
            .and_then(|all| all.checked_add(if count == 0 { 0 } else { size as u64 }));
        let tail = usize::try_from(offset).ok().and_then(|offset| bytes.get(offset..));
        match (needed, tail) {
            (Some(needed), Some(tail)) if needed <= tail.len() as u64 => {
                Ok(Rows { bytes: tail, stride, size })
            }
            _ => {
                let message = format!(
                    "{count} elements of {size} bytes, {stride} apart, from byte {offset} on do not fit into the {} bytes \
                     of bufferViews[{}]",
                    bytes.len(),
                    view.value()
                );
                Err(Error::invalid(message).at_json(place))
            }
        }
    }

    fn accessor(&self, index: Index<Accessor>) -> Result<(&'a Accessor, usize, String)> {
        let i = index.value();
        let accessor = self.root.get(index).ok_or_else(|| missing("accessors", i))?;
        let place = format!("accessors[{i}]");
        let count = usize::try_from(accessor.count.0)
            .ok()
            .filter(|&count| count <= u32::MAX as usize)
            .ok_or_else(|| {
                let message = format!("is {}; allowed: below 2^32", accessor.count.0);
                Error::invalid(message).at_json(format!("{place}.count"))
            })?;
        Ok((accessor, count, place))
    }

    /// The number of elements of an accessor.
    pub(super) fn count(&self, index: Index<Accessor>) -> Result<usize> {
        Ok(self.accessor(index)?.1)
    }

    /// Elements of `N` numbers, integers normalised where the accessor says so. `range` must lie
    /// inside the accessor.
    pub(super) fn floats<const N: usize>(
        &self,
        index: Index<Accessor>,
        range: Option<Range<usize>>,
    ) -> Result<Vec<[f32; N]>> {
        let values = self.numbers(index, range.clone())?;
        if let Some(i) = values.iter().position(|v: &[f32; N]| v.iter().any(|x| !x.is_finite())) {
            let element = range.map_or(0, |range| range.start) + i;
            let message = format!("element {element} is {:?}; allowed: finite numbers", values[i]);
            return Err(Error::invalid(message).at_json(format!("accessors[{}]", index.value())));
        }
        Ok(values)
    }

    /// As [`Buffers::floats`], where the numbers may be infinite or none.
    pub(super) fn numbers<const N: usize>(
        &self,
        index: Index<Accessor>,
        range: Option<Range<usize>>,
    ) -> Result<Vec<[f32; N]>> {
        let (accessor, count, place) = self.accessor(index)?;
        let wanted = match N {
            1 => Type::Scalar,
            2 => Type::Vec2,
            3 => Type::Vec3,
            4 => Type::Vec4,
            _ => Type::Mat4,
        };
        let component = component(accessor, &place)?;
        if accessor.type_ != Checked::Valid(wanted) {
            let message = format!("is {}; allowed here: {}", shown(accessor), type_name(wanted));
            return Err(Error::invalid(message).at_json(format!("{place}.type")));
        }
        if component == ComponentType::U32 {
            let message = "is 5125 (unsigned int); allowed here: bytes, shorts and floats";
            return Err(Error::invalid(message).at_json(format!("{place}.componentType")));
        }
        let range = range.unwrap_or(0..count);
        self.spend(range.len() as u64, &place)?;
        let decode = |row: &[u8]| -> [f32; N] {
            std::array::from_fn(|i| {
                number(component, accessor.normalized, &row[i * component.size()..])
            })
        };
        let size = N * component.size();
        let mut values = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
                let rows = self.rows(view, offset, count, size, &place)?;
                range.clone().map(|i| decode(rows.row(i))).collect()
            }
            None => vec![[0.0; N]; range.len()],
        };
        if let Some(sparse) = &accessor.sparse {
            let (indices, rows) = self.sparse(sparse, count, size, &place)?;
            for (i, index) in indices.into_iter().enumerate() {
                if range.contains(&(index as usize)) {
                    values[index as usize - range.start] = decode(rows.row(i));
                }
            }
        }
        Ok(values)
    }

    /// Unsigned integers.
    pub(super) fn indices(&self, index: Index<Accessor>) -> Result<Vec<u32>> {
        let (accessor, count, place) = self.accessor(index)?;
        let component = component(accessor, &place)?;
        if accessor.type_ != Checked::Valid(Type::Scalar) {
            let message = format!("is {}; allowed for indices: SCALAR", shown(accessor));
            return Err(Error::invalid(message).at_json(format!("{place}.type")));
        }
        self.spend(count as u64, &place)?;
        let size = component.size();
        let mut values: Vec<u32> = match accessor.buffer_view {
            Some(view) => {
                let offset = accessor.byte_offset.map_or(0, |offset| offset.0);
                let rows = self.rows(view, offset, count, size, &place)?;
                (0..count)
                    .map(|i| integer(component, rows.row(i), &place))
                    .collect::<Result<_>>()?
            }
            None => vec![0; count],
        };
        if let Some(sparse) = &accessor.sparse {
            let (indices, rows) = self.sparse(sparse, count, size, &place)?;
            for (i, index) in indices.into_iter().enumerate() {
                values[index as usize] = integer(component, rows.row(i), &place)?;
            }
        }
        Ok(values)
    }

    /// The replaced elements of a sparse accessor: their indices, all below `count`, and their
    /// rows.
    fn sparse(
        &self,
        sparse: &accessor::sparse::Sparse,
        count: usize,
        size: usize,
        place: &str,
    ) -> Result<(Vec<u32>, Rows<'_>)> {
        let at = |field: &str| format!("{place}.sparse.{field}");
        let replaced = usize::try_from(sparse.count.0).ok().filter(|&n| n <= count);
        let Some(replaced) = replaced else {
            let message = format!("is {}; the accessor has {count}", sparse.count.0);
            return Err(Error::invalid(message).at_json(at("count")));
        };
        self.spend(replaced as u64, place)?;
        let Checked::Valid(component) = sparse.indices.component_type else {
            let message = "allowed: 5121, 5123, 5125";
            return Err(Error::invalid(message).at_json(at("indices.componentType")));
        };
        let component = component.0;
        let rows = self.rows(
            sparse.indices.buffer_view,
            sparse.indices.byte_offset.0,
            replaced,
            component.size(),
            &at("indices"),
        )?;
        let mut indices = Vec::with_capacity(replaced);
        for i in 0..replaced {
            let index = integer(component, rows.row(i), &at("indices"))?;
            if index as usize >= count {
                let message = format!("element {i} is {index}; allowed: below {count}");
                return Err(Error::invalid(message).at_json(at("indices")));
            }
            indices.push(index);
        }
        let values = &sparse.values;
        let rows =
            self.rows(values.buffer_view, values.byte_offset.0, replaced, size, &at("values"))?;
        Ok((indices, rows))
    }
}

fn missing(list: &str, index: usize) -> Error {
    Error::invalid("is referred to, but does not exist").at_json(format!("{list}[{index}]"))
}

fn shown(accessor: &Accessor) -> &'static str {
    match accessor.type_ {
        Checked::Valid(kind) => type_name(kind),
        Checked::Invalid => "unknown",
    }
}

/// As glTF writes it.
fn type_name(kind: Type) -> &'static str {
    match kind {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}

fn component(accessor: &Accessor, place: &str) -> Result<ComponentType> {
    match accessor.component_type {
        Checked::Valid(component) => Ok(component.0),
        Checked::Invalid => Err(Error::invalid("allowed: 5120, 5121, 5122, 5123, 5125, 5126")
            .at_json(format!("{place}.componentType"))),
    }
}

fn integer(component: ComponentType, row: &[u8], place: &str) -> Result<u32> {
    match component {
        ComponentType::U8 => Ok(u32::from(row[0])),
        ComponentType::U16 => Ok(u32::from(u16::from_le_bytes([row[0], row[1]]))),
        ComponentType::U32 => Ok(u32::from_le_bytes([row[0], row[1], row[2], row[3]])),
        _ => Err(Error::invalid("allowed for indices: 5121, 5123, 5125")
            .at_json(format!("{place}.componentType"))),
    }
}

/// glTF 2.0, section 3.11: a normalised signed integer c is max(c / m, −1), m the largest.
fn number(component: ComponentType, normalized: bool, row: &[u8]) -> f32 {
    let (value, largest) = match component {
        ComponentType::I8 => (f32::from(row[0] as i8), 127.0),
        ComponentType::U8 => (f32::from(row[0]), 255.0),
        ComponentType::I16 => (f32::from(i16::from_le_bytes([row[0], row[1]])), 32_767.0),
        ComponentType::U16 => (f32::from(u16::from_le_bytes([row[0], row[1]])), 65_535.0),
        ComponentType::U32 => {
            (u32::from_le_bytes([row[0], row[1], row[2], row[3]]) as f32, 4_294_967_295.0)
        }
        ComponentType::F32 => {
            return f32::from_le_bytes([row[0], row[1], row[2], row[3]]);
        }
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_of_rfc_4648() {
        for (text, bytes) in
            [("", ""), ("Zg==", "f"), ("Zm8=", "fo"), ("Zm9v", "foo"), ("Zm9vYg", "foob")]
        {
            assert_eq!(base64(text).unwrap(), bytes.as_bytes());
        }
        assert!(base64("Zm9vY").unwrap_err().is_syntax());
        assert!(base64("Zm 9").unwrap_err().is_syntax());
    }

    #[test]
    fn percent_decoding() {
        assert_eq!(percent_decoded("a%20b%C3%a4").unwrap(), "a bä".as_bytes());
        assert!(percent_decoded("a%2").is_err());
        assert!(percent_decoded("%zz").is_err());
    }

    #[test]
    fn only_relative_uris_are_followed() {
        for uri in
            ["/etc/hostname", "file:///etc/hostname", "http://a.b/c", "%2Fetc%2Fhostname", ""]
        {
            assert!(resolve(uri, Path::new("a.gltf")).err().unwrap().is_unsupported(), "{uri}");
        }
        assert!(resolve("no such.bin", Path::new("a.gltf")).err().unwrap().is_io());
    }

    #[test]
    fn signed_normalisation_is_clamped() {
        assert_eq!(number(ComponentType::I8, true, &[0x80]), -1.0);
        assert_eq!(number(ComponentType::I8, true, &[0x81]), -1.0);
        assert_eq!(number(ComponentType::U16, true, &[0xFF, 0xFF]), 1.0);
        assert_eq!(number(ComponentType::U8, false, &[7]), 7.0);
    }

    #[test]
    fn a_cut_container_is_refused() {
        assert!(split(b"glTF").unwrap_err().is_syntax());
        assert!(split(b"glTF\x01\0\0\0\x0c\0\0\0").unwrap_err().is_unsupported());
        assert!(split(b"glTF\x02\0\0\0\x0c\0\0\0").unwrap_err().is_syntax());
        assert!(split(b"glTF\x02\0\0\0\x14\0\0\0\xff\xff\xff\xffJSON").unwrap_err().is_syntax());
        let whole = b"glTF\x02\0\0\0\x16\0\0\0\x02\0\0\0JSON{}";
        assert_eq!(split(whole).unwrap(), (&b"{}"[..], None));
    }
}
