//! References: a picture as a mean and a variance a pixel over independent frames, kept on disk so
//! that it is made once and can be continued.
//!
//! A file is `KEY.reference`: magic, format version, key, size, frame count, six f64 a pixel (mean
//! and Σ(x − mean)² of R, G, B), all little-endian, then a checksum of everything before it.

use std::fs;
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};

use glam::Vec3;

use super::write_atomic;
use crate::picture::Picture;
use crate::{Error, Result};

const MAGIC: &[u8; 16] = b"afterimage-ref\0\0";
const FORMAT: u32 = 1;
const HEADER: usize = 16 + 4 + 16 + 8 + 8;

/// 128 bits over everything that a reference depends on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CacheKey([u64; 2]);

impl CacheKey {
    /// The key of the bytes that `feed` hands to its argument.
    ///
    /// Two of std's 64-bit hashers with different prefixes: enough against accident, which is all
    /// that a private cache needs, and no dependency. A release of Rust may change them; references
    /// are then made anew.
    #[must_use]
    pub fn of(feed: impl Fn(&mut dyn Hasher)) -> Self {
        Self([0x6166_7465_7269_6d61_u64, 0x6765_5f72_6566_5f32].map(|prefix| {
            let mut hasher = DefaultHasher::new();
            hasher.write_u64(prefix);
            feed(&mut hasher);
            hasher.finish()
        }))
    }

    pub(super) fn bytes(self) -> [u8; 16] {
        let mut bytes = [0; 16];
        bytes[..8].copy_from_slice(&self.0[0].to_le_bytes());
        bytes[8..].copy_from_slice(&self.0[1].to_le_bytes());
        bytes
    }
}

impl std::fmt::Display for CacheKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:016x}{:016x}", self.0[0], self.0[1])
    }
}

/// Running mean and variance of independent frames (Welford 1962), in f64.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    size: [u32; 2],
    frames: u64,
    pixels: Vec<[f64; 6]>,
}

impl Reference {
    /// No frames yet.
    #[must_use]
    pub fn new(size: [u32; 2]) -> Self {
        Self { size, frames: 0, pixels: vec![[0.0; 6]; size[0] as usize * size[1] as usize] }
    }

    /// A picture without a known variance, as read from a file.
    #[must_use]
    pub fn from_picture(picture: &Picture) -> Self {
        let mut reference = Self::new([picture.width, picture.height]);
        reference.add(picture);
        reference
    }

    /// Width and height.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Frames so far.
    #[must_use]
    pub fn frames(&self) -> u64 {
        self.frames
    }

    /// Adds a frame that is independent of all before. Its size must be this one's.
    pub fn add(&mut self, frame: &Picture) {
        debug_assert_eq!(frame.pixels.len(), self.pixels.len());
        self.frames += 1;
        let share = 1.0 / self.frames as f64;
        for (state, value) in self.pixels.iter_mut().zip(&frame.pixels) {
            let [mean_r, mean_g, mean_b, m2_r, m2_g, m2_b] = *state;
            let old = [mean_r, mean_g, mean_b];
            let x = [value.x, value.y, value.z].map(f64::from);
            let delta: [f64; 3] = std::array::from_fn(|c| x[c] - old[c]);
            let mean: [f64; 3] = std::array::from_fn(|c| old[c] + delta[c] * share);
            let after: [f64; 3] = std::array::from_fn(|c| x[c] - mean[c]);
            *state = [
                mean[0],
                mean[1],
                mean[2],
                m2_r + delta[0] * after[0],
                m2_g + delta[1] * after[1],
                m2_b + delta[2] * after[2],
            ];
        }
    }

    /// The mean picture.
    #[must_use]
    pub fn picture(&self) -> Picture {
        let pixels =
            self.pixels.iter().map(|p| Vec3::new(p[0] as f32, p[1] as f32, p[2] as f32)).collect();
        Picture { width: self.size[0], height: self.size[1], pixels }
    }

    /// Variance of the mean, averaged over pixels and channels; `None` with fewer than two frames.
    #[must_use]
    pub fn variance(&self) -> Option<f64> {
        let sum: f64 = self.pixels.iter().map(|p| p[3] + p[4] + p[5]).sum();
        self.of_mean(sum / (3.0 * self.pixels.len() as f64))
    }

    /// Variance of the mean of every pixel and channel; `None` with fewer than two frames.
    #[must_use]
    pub fn pixel_variances(&self) -> Option<Vec<Vec3>> {
        let vector = |p: &[f64; 6]| {
            let [r, g, b] = [p[3], p[4], p[5]].map(|m2| self.of_mean(m2).map(|v| v as f32));
            Some(Vec3::new(r?, g?, b?))
        };
        self.pixels.iter().map(vector).collect()
    }

    /// Σ(x − mean)² over frames to the variance of the mean.
    fn of_mean(&self, m2: f64) -> Option<f64> {
        let n = self.frames as f64;
        (self.frames >= 2).then(|| m2 / ((n - 1.0) * n))
    }

    fn encode(&self, key: CacheKey) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(HEADER + self.pixels.len() * 48 + 16);
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&FORMAT.to_le_bytes());
        bytes.extend_from_slice(&key.bytes());
        bytes.extend_from_slice(&self.size[0].to_le_bytes());
        bytes.extend_from_slice(&self.size[1].to_le_bytes());
        bytes.extend_from_slice(&self.frames.to_le_bytes());
        for value in self.pixels.iter().flatten() {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        let sum = checksum(&bytes);
        bytes.extend_from_slice(&sum);
        bytes
    }

    fn decode(bytes: &[u8], key: CacheKey) -> std::result::Result<Self, &'static str> {
        let (header, _) = bytes.split_at_checked(HEADER).ok_or("it is cut short")?;
        if header[..16] != *MAGIC || header[16..20] != FORMAT.to_le_bytes() {
            return Err("it is no reference of this version");
        }
        let (content, sum) = bytes.split_at_checked(bytes.len() - 16).ok_or("it is cut short")?;
        if sum != checksum(content) {
            return Err("its checksum does not match");
        }
        if header[20..36] != key.bytes() {
            return Err("it belongs to another scene or setting");
        }
        let word = |at: usize| u32::from_le_bytes(std::array::from_fn(|i| header[at + i]));
        let size = [word(36), word(40)];
        let frames = u64::from_le_bytes(std::array::from_fn(|i| header[44 + i]));
        let (values, rest) = content[HEADER..].as_chunks::<8>();
        let (pixels, odd) = values.as_chunks::<6>();
        if !rest.is_empty()
            || !odd.is_empty()
            || pixels.len() as u64 != u64::from(size[0]) * u64::from(size[1])
        {
            return Err("its length does not match its size");
        }
        let pixels = pixels.iter().map(|p| p.map(f64::from_le_bytes)).collect();
        Ok(Self { size, frames, pixels })
    }
}

pub(super) fn checksum(bytes: &[u8]) -> [u8; 16] {
    CacheKey::of(|hasher| hasher.write(bytes)).bytes()
}

/// `$XDG_CACHE_HOME/afterimage`, else `~/.cache/afterimage`.
///
/// # Errors
/// Where neither variable is set to an absolute path.
pub fn default_cache_dir() -> Result<PathBuf> {
    let absolute =
        |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    absolute("XDG_CACHE_HOME")
        .or_else(|| absolute("HOME").map(|home| home.join(".cache")))
        .map(|base| base.join("afterimage"))
        .ok_or_else(|| Error::usage("neither XDG_CACHE_HOME nor HOME is set: name a folder for references with --cache DIR"))
}

/// A folder of references.
#[derive(Clone, Debug)]
pub struct ReferenceCache {
    folder: PathBuf,
}

impl ReferenceCache {
    /// The folder need not exist.
    #[must_use]
    pub fn new(folder: impl Into<PathBuf>) -> Self {
        Self { folder: folder.into() }
    }

    /// Where the reference of `key` is kept.
    #[must_use]
    pub fn path(&self, key: CacheKey) -> PathBuf {
        self.folder.join(format!("{key}.reference"))
    }

    /// The stored reference, or none; a damaged one is none with a warning, and is replaced by the
    /// next [`Self::store`].
    ///
    /// # Errors
    /// Where the operating system refuses to read a file that is there.
    pub fn load(&self, key: CacheKey) -> Result<(Option<Reference>, Option<String>)> {
        let path = self.path(key);
        let bytes = match fs::read(&path) {
            Ok(bytes) => bytes,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok((None, None)),
            Err(e) => return Err(Error::io(path, e)),
        };
        Ok(match Reference::decode(&bytes, key) {
            Ok(reference) => (Some(reference), None),
            Err(why) => (None, Some(damaged(&path, why))),
        })
    }

    /// Stores a reference in place of the one that is there.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn store(&self, key: CacheKey, reference: &Reference) -> Result<()> {
        let bytes = reference.encode(key);
        write_atomic(&self.path(key), |writer| std::io::Write::write_all(writer, &bytes))
    }
}

fn damaged(path: &Path, why: &str) -> String {
    format!("{}: {why}; the reference is made anew", path.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(text: &str) -> CacheKey {
        CacheKey::of(|h| h.write(text.as_bytes()))
    }

    fn frame(values: [f32; 2]) -> Picture {
        Picture { width: 2, height: 1, pixels: values.map(Vec3::splat).to_vec() }
    }

    #[test]
    fn keys_differ_in_both_halves() {
        let (a, b) = (key("a"), key("b"));
        assert!(a.0[0] != b.0[0] && a.0[1] != b.0[1] && a.0[0] != a.0[1]);
        assert_eq!(a, key("a"));
    }

    #[test]
    fn mean_and_variance_by_hand() {
        let mut reference = Reference::new([2, 1]);
        for values in [[1.0, 5.0], [3.0, 5.0], [5.0, 5.0]] {
            reference.add(&frame(values));
        }
        assert_eq!(reference.picture().pixels, vec![Vec3::splat(3.0), Vec3::splat(5.0)]);
        // Pixel 0: s² = 4, of the mean 4/3; pixel 1: 0; averaged 2/3.
        assert!((reference.variance().unwrap() - 2.0 / 3.0).abs() < 1e-12);
        let variances = reference.pixel_variances().unwrap();
        assert!(
            (variances[0] - Vec3::splat(4.0 / 3.0)).length() < 1e-6 && variances[1] == Vec3::ZERO
        );
        assert_eq!(Reference::from_picture(&frame([1.0, 2.0])).variance(), None);
    }

    #[test]
    fn stored_references_continue_and_damaged_ones_are_refused() {
        let folder = std::env::temp_dir().join(format!("afterimage-cache-{}", std::process::id()));
        let cache = ReferenceCache::new(&folder);
        let mut reference = Reference::new([2, 1]);
        reference.add(&frame([1.0, 5.0]));
        assert_eq!(cache.load(key("s")).unwrap(), (None, None));
        cache.store(key("s"), &reference).unwrap();
        let (back, warning) = cache.load(key("s")).unwrap();
        let mut back = back.unwrap();
        assert!(warning.is_none() && back == reference);
        for r in [&mut back, &mut reference] {
            r.add(&frame([2.0, 3.0]));
        }
        assert_eq!(back, reference);

        let path = cache.path(key("s"));
        let whole = fs::read(&path).unwrap();
        for at in [0, 17, 30, 45, 70, whole.len() - 1] {
            let mut bytes = whole.clone();
            bytes[at] ^= 1;
            fs::write(&path, bytes).unwrap();
            let (none, warning) = cache.load(key("s")).unwrap();
            assert!(none.is_none() && warning.unwrap().contains("made anew"), "byte {at}");
        }
        for length in [0, 10, HEADER, whole.len() - 8] {
            fs::write(&path, &whole[..length]).unwrap();
            assert!(cache.load(key("s")).unwrap().0.is_none(), "length {length}");
        }
        // A file under another key's name.
        fs::write(cache.path(key("t")), &whole).unwrap();
        assert!(cache.load(key("t")).unwrap().0.is_none());
        fs::remove_dir_all(folder).unwrap();
    }
}
