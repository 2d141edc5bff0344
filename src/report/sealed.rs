//! Files of unfinished work: a key of everything that decides their content, the content, and a
//! checksum of both.
//!
//! All values are little-endian; floats keep their bits, so that work that goes on is the work that
//! was never interrupted.

use std::fs;
use std::path::Path;

use super::cache::{CacheKey, checksum};
use super::write_atomic;
use crate::{Error, Result};

const MAGIC: &[u8; 16] = b"afterimage-kept\0";
const FORMAT: u32 = 1;
const HEADER: usize = 16 + 4 + 16;

/// Writes a file in place of the one that is there.
///
/// # Errors
/// Where the operating system refuses.
pub(crate) fn seal(path: &Path, key: CacheKey, content: &Writer) -> Result<()> {
    let mut bytes = Vec::with_capacity(HEADER + content.0.len() + 16);
    bytes.extend_from_slice(MAGIC);
    bytes.extend_from_slice(&FORMAT.to_le_bytes());
    bytes.extend_from_slice(&key.bytes());
    bytes.extend_from_slice(&content.0);
    let sum = checksum(&bytes);
    bytes.extend_from_slice(&sum);
    write_atomic(path, |writer| std::io::Write::write_all(writer, &bytes))
}

/// What `decode` makes of a file's content; none where there is no file. A file that is damaged or
/// of another key is none with a warning.
///
/// # Errors
/// Where the operating system refuses to read a file that is there.
pub(crate) fn unseal<T>(
    path: &Path,
    key: CacheKey,
    decode: impl FnOnce(&mut Reader<'_>) -> Option<T>,
) -> Result<(Option<T>, Option<String>)> {
    let bytes = match fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok((None, None)),
        Err(e) => return Err(Error::io(path, e)),
    };
    Ok(match open(&bytes, key, decode) {
        Ok(found) => (Some(found), None),
        Err(why) => (None, Some(format!("{}: {why}; what it held is made anew", path.display()))),
    })
}

fn open<T>(
    bytes: &[u8],
    key: CacheKey,
    decode: impl FnOnce(&mut Reader<'_>) -> Option<T>,
) -> std::result::Result<T, &'static str> {
    let length = bytes.len().checked_sub(16).filter(|length| *length >= HEADER);
    let (content, sum) = bytes.split_at(length.ok_or("it is cut short")?);
    if content[..16] != *MAGIC || content[16..20] != FORMAT.to_le_bytes() {
        return Err("it is no kept work of this version");
    }
    if sum != checksum(content) {
        return Err("its checksum does not match");
    }
    if content[20..36] != key.bytes() {
        return Err("it belongs to other work");
    }
    let mut reader = Reader(&content[HEADER..]);
    let found = decode(&mut reader).ok_or("its content has another form")?;
    if reader.0.is_empty() { Ok(found) } else { Err("its content has another form") }
}

/// Values, one after another.
#[derive(Debug, Default)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    pub(crate) fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    pub(crate) fn u32(&mut self, value: u32) {
        self.u64(value.into());
    }

    pub(crate) fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.u64(text.len() as u64);
        self.0.extend_from_slice(text.as_bytes());
    }

    /// With their number.
    pub(crate) fn f64s(&mut self, values: &[f64]) {
        self.list(values, |writer, value| writer.f64(*value));
    }

    pub(crate) fn f32s(&mut self, values: &[f32]) {
        self.u64(values.len() as u64);
        for value in values {
            self.0.extend_from_slice(&value.to_le_bytes());
        }
    }

    pub(crate) fn list<T>(&mut self, items: &[T], mut each: impl FnMut(&mut Self, &T)) {
        self.u64(items.len() as u64);
        items.iter().for_each(|item| each(self, item));
    }
}

/// Reads what a [`Writer`] wrote; `None` where it is something else.
#[derive(Debug)]
pub(crate) struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: u64) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(usize::try_from(count).ok()?)?;
        self.0 = rest;
        Some(taken)
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        Some(u64::from_le_bytes(self.take(8)?.try_into().ok()?))
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.u64()?.try_into().ok()
    }

    pub(crate) fn f64(&mut self) -> Option<f64> {
        self.u64().map(f64::from_bits)
    }

    pub(crate) fn text(&mut self) -> Option<String> {
        let count = self.u64()?;
        String::from_utf8(self.take(count)?.to_vec()).ok()
    }

    pub(crate) fn f64s(&mut self) -> Option<Vec<f64>> {
        self.list(Self::f64)
    }

    pub(crate) fn f32s(&mut self) -> Option<Vec<f32>> {
        let count = self.u64()?;
        let (values, _) = self.take(count.checked_mul(4)?)?.as_chunks::<4>();
        Some(values.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect())
    }

    pub(crate) fn list<T>(
        &mut self,
        mut each: impl FnMut(&mut Self) -> Option<T>,
    ) -> Option<Vec<T>> {
        // Nothing is reserved for a number that damage may have made.
        let count = self.u64()?;
        let mut items = Vec::new();
        for _ in 0..count {
            items.push(each(self)?);
        }
        Some(items)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_come_back_by_their_bits_and_damage_is_said() {
        let folder = std::env::temp_dir().join(format!("afterimage-sealed-{}", std::process::id()));
        let path = folder.join("a.kept");
        let [key, other] = ["a", "b"].map(|text| CacheKey::of(|h| h.write(text.as_bytes())));
        let decode = |reader: &mut Reader<'_>| {
            let (text, number) = (reader.text()?, reader.u32()?);
            Some((text, number, reader.f64s()?, reader.f32s()?))
        };
        let nothing = unseal(&path, key, decode).unwrap();
        assert!(nothing.0.is_none() && nothing.1.is_none());
        let floats = vec![0.1, f64::INFINITY, -0.0, 1e-310];
        let mut content = Writer::default();
        content.text("µ");
        content.u32(7);
        content.f64s(&floats);
        content.f32s(&[0.1, f32::MAX]);
        seal(&path, key, &content).unwrap();
        let (found, warning) = unseal(&path, key, decode).unwrap();
        let (text, number, values, singles) = found.unwrap();
        assert!(warning.is_none() && text == "µ" && number == 7 && singles == [0.1, f32::MAX]);
        assert!(values.iter().zip(&floats).all(|(a, b)| a.to_bits() == b.to_bits()));

        let said = |key, decode: &dyn Fn(&mut Reader<'_>) -> Option<u64>| {
            let (none, warning) = unseal(&path, key, decode).unwrap();
            assert!(none.is_none());
            warning.unwrap()
        };
        assert!(said(other, &|reader| reader.u64()).contains("other work"));
        assert!(
            said(key, &|reader| reader.u64()).contains("another form"),
            "more is there than is read"
        );
        let whole = fs::read(&path).unwrap();
        // A digit of a float: only the checksum sees it.
        let mut bytes = whole.clone();
        bytes[whole.len() - 16 - 5] ^= 1;
        fs::write(&path, bytes).unwrap();
        let (none, warning) = unseal(&path, key, decode).unwrap();
        assert!(none.is_none() && warning.unwrap().contains("checksum"));
        for at in [0, 17, 25, HEADER + 3, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            fs::write(&path, bytes).unwrap();
            assert!(said(key, &|reader| reader.u64()).contains("made anew"), "byte {at}");
        }
        for length in [0, 20, HEADER + 15, whole.len() - 1] {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(said(key, &|reader| reader.u64()).contains("made anew"), "length {length}");
        }
        fs::remove_dir_all(folder).unwrap();
    }
}
