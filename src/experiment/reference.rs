//! The picture that the others are compared with: read from a file, taken from the cache, or made
//! with a technique until it is good enough.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::bias;
use super::seeds::{SeedUse, seed};
use super::session::{self, Mean, Session};
use crate::picture::Picture;
use crate::plan::{Filter, Shot};
use crate::report::{
    CacheKey, Reference, ReferenceCache, ReferenceInfo, default_cache_dir, read_exr,
};
use crate::stats::{Criteria, Verdict};
use crate::techniques::Technique;
use crate::{Error, Result};

#[cfg(test)]
mod tests;

/// Estimates a frame: enough that primary hits, which all share with point sampling, cost little.
const EFFORT: u32 = 4;
/// References are shared by runs of any seed, so theirs is fixed.
const SEED: u64 = 0x5eed_0000_0000_0001;
/// A reference is never finished before: its variance itself must be known.
const FEWEST_FRAMES: u64 = 16;
/// A new picture of an unchanged scene raises this, so that old references are not used.
const IMAGES: u32 = 1;
/// Frames of effort 1 that a stored reference is checked against.
const CHECK_FRAMES: u32 = 32;
/// Time between two writes of an unfinished reference.
const STORE_EVERY: Duration = Duration::from_secs(20);

/// Where references come from.
#[derive(Clone, Debug)]
pub struct ReferenceSettings {
    /// A multilayer EXR to compare with instead of making a reference.
    pub file: Option<PathBuf>,
    /// Seconds after which the making of a reference ends; the noise that remains is stated.
    pub seconds: f64,
    /// Folder in which references are kept; `None`: `$XDG_CACHE_HOME/afterimage` or
    /// `~/.cache/afterimage`.
    pub cache: Option<PathBuf>,
}

impl Default for ReferenceSettings {
    /// A reference in at most 60 seconds, and kept in the user's cache.
    fn default() -> Self {
        Self { file: None, seconds: 60.0, cache: None }
    }
}

impl ReferenceSettings {
    /// The size in pixels that a file dictates, and whether the file can be read at all.
    ///
    /// # Errors
    /// As [`read_exr`].
    pub fn size(&self) -> Result<Option<[u32; 2]>> {
        let Some(path) = &self.file else { return Ok(None) };
        let picture = read_exr(path)?.picture;
        Ok(Some([picture.width, picture.height]))
    }
}

/// A reference and where it is from.
#[derive(Debug)]
pub struct SourcedReference {
    /// Means, with variances unless it is from a file.
    pub reference: Reference,
    /// What made it, and how good it is.
    pub info: ReferenceInfo,
}

/// The reference for a session whose scene does not move, made with `technique`, with a pixel
/// variance of at most `variance` unless the time is up first.
pub(super) fn obtain(
    session: &Session,
    settings: &ReferenceSettings,
    technique: &Arc<dyn Technique>,
    variance: f64,
) -> Result<SourcedReference> {
    if let Some(path) = &settings.file {
        return from_file(session, path);
    }
    let cache = ReferenceCache::new(match &settings.cache {
        Some(folder) => folder.clone(),
        None => default_cache_dir()?,
    });
    let key = session.key(&format!("{} effort {EFFORT} images {IMAGES}", technique.spec()));
    let (stored, warning) = cache.load(key)?;
    if let Some(warning) = warning {
        session.host().note(&format!("warning: {warning}"));
    }
    let mut stored = stored.filter(|r| r.size() == session.shot.size);
    if let Some(reference) = &stored
        && !agrees(session, technique, reference)?
    {
        session.host().note(
            "warning: the stored reference differs from what is rendered now; it is made anew",
        );
        stored = None;
    }
    let mut source = if stored.is_some() { "cache" } else { "made" };
    let mut reference = stored.unwrap_or_else(|| Reference::new(session.shot.size));
    if !good(&reference, variance) {
        if source == "cache" {
            source = "cache, continued";
        }
        let making = Making { session, technique, cache: &cache, key };
        making.improve(&mut reference, variance, settings.seconds)?;
    }
    session.check()?;
    let info = ReferenceInfo {
        source: source.to_string(),
        technique: Some(technique.spec()),
        samples: Some(reference.frames() * u64::from(EFFORT)),
        variance: reference.variance(),
        share_of_smallest_mse: None,
    };
    Ok(SourcedReference { reference, info })
}

/// A reference in the making, and where it is kept.
struct Making<'a> {
    session: &'a Session,
    technique: &'a Arc<dyn Technique>,
    cache: &'a ReferenceCache,
    key: CacheKey,
}

impl Making<'_> {
    /// Adds frames until the variance is low enough or the time is up, and stores what there is,
    /// now and then as well as in the end.
    fn improve(&self, reference: &mut Reference, variance: f64, seconds: f64) -> Result<()> {
        let begin = Instant::now();
        let mut stored_at = begin;
        let seconds = if seconds.is_nan() { 0.0 } else { seconds.clamp(0.0, 1e6) };
        let limit = Duration::from_secs_f64(seconds);
        let progress = self.session.host().begin("reference", 1);
        // Frames of one session have consecutive numbers under one seed, and no two sessions start
        // after equally many frames.
        let run = seed(SEED, SeedUse::Reference, 0, reference.frames() as u32);
        let mut frames = self.session.start_reference(self.technique, EFFORT as f32, run)?;
        while !good(reference, variance) {
            let frame = match self.session.next(&mut frames) {
                Ok(frame) => frame,
                Err(error) => {
                    self.cache.store(self.key, reference)?;
                    return Err(error);
                }
            };
            let picture = frame.picture();
            let bad = frame.counters.non_finite;
            if bad > 0 || picture.non_finite() > 0 {
                let message = format!("{bad} estimates of the reference are not finite");
                return Err(Error::invalid(message));
            }
            reference.add(&picture);
            let now = reference.frames();
            let needed = match reference.variance().filter(|_| now >= FEWEST_FRAMES) {
                Some(v) => (now as f64 * v / variance).ceil().min(1e9) as u64,
                None => FEWEST_FRAMES,
            };
            progress.set(now, needed);
            if begin.elapsed() > limit && now >= FEWEST_FRAMES {
                break;
            }
            if stored_at.elapsed() > STORE_EVERY {
                self.cache.store(self.key, reference)?;
                stored_at = Instant::now();
            }
        }
        self.cache.store(self.key, reference)
    }
}

fn good(reference: &Reference, variance: f64) -> bool {
    reference.frames() >= FEWEST_FRAMES && reference.variance().is_some_and(|v| v <= variance)
}

/// Whether fresh frames have the stored reference's means: a renderer that changed under an
/// unchanged version is found so.
///
/// α = 10⁻⁶ in all. Student's t with 31 degrees of freedom exceeds 6.8 with probability 10⁻⁷, so 32
/// frames of 256² pixels with c = σ/μ = 1 show a change of 0.5 % of the whole picture.
fn agrees(
    session: &Session,
    technique: &Arc<dyn Technique>,
    reference: &Reference,
) -> Result<bool> {
    let mut frames = session.start_reference(technique, 1.0, seed(SEED, SeedUse::Check, 0, 0))?;
    let mut fresh = bias::restarts(session.shot.size)?;
    for _ in 0..CHECK_FRAMES {
        fresh.push(&session.next(&mut frames)?.picture().pixels)?;
    }
    let criteria =
        Criteria { delta: 1e-9, difference_alpha: 1e-7, tile_alpha: 1e-7, ..Criteria::default() };
    Ok(bias::judge(&fresh, reference, &criteria)?.verdict != Verdict::Fail)
}

/// Reflected light of a picture that may hold emission: what the file tells apart, else what this
/// scene emits.
fn from_file(session: &Session, path: &Path) -> Result<SourcedReference> {
    let file = read_exr(path)?;
    let size = [file.picture.width, file.picture.height];
    if size != session.shot.size {
        let [width, height] = session.shot.size;
        let message = format!(
            "the reference is {}x{}, but the pictures are {width}x{height}",
            size[0], size[1]
        );
        return Err(Error::invalid(message).with_path(path));
    }
    let emission = match file.emission {
        Some(emission) if emission.pixels.len() == file.picture.pixels.len() => emission,
        Some(_) => {
            return Err(Error::invalid("its emission layer has another size than its picture")
                .with_path(path));
        }
        None => seen_emission(session)?,
    };
    let pixels = file
        .picture
        .pixels
        .iter()
        .zip(&emission.pixels)
        .map(|(all, emitted)| *all - *emitted)
        .collect();
    let picture = Picture::new(size[0], size[1], pixels);
    if picture.non_finite() > 0 {
        let message = format!("{} of its pixels are not finite", picture.non_finite());
        return Err(Error::invalid(message).with_path(path));
    }
    let info = ReferenceInfo {
        source: path.display().to_string(),
        technique: None,
        samples: None,
        variance: None,
        share_of_smallest_mse: None,
    };
    Ok(SourcedReference { reference: Reference::from_picture(&picture), info })
}

/// Directly visible emission: one frame is exact with point sampling; with a box filter it is
/// averaged.
fn seen_emission(session: &Session) -> Result<Picture> {
    let count = if session.shot.filter == Filter::Point { 1 } else { 256 };
    let technique = session::technique("bsdf")?;
    // Depth 1 renders nothing but what is seen directly.
    let shot =
        Shot { depth: 1, effort: 1.0, run: seed(SEED, SeedUse::Reference, 1, 0), ..session.shot };
    let mut frames = crate::frame::FrameLoop::new(technique, &session.stage, shot)?;
    let mut mean = Mean::new(session.shot.size);
    for _ in 0..count {
        mean.add(&session.next(&mut frames)?.emission(), 1);
    }
    Ok(mean.picture())
}
