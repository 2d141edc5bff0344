//! The picture that the others are compared with: read from a file, taken from the cache, or made with `nee` until it is good enough.

use std::path::Path;
use std::time::{Duration, Instant};

use super::args::ReferenceArgs;
use super::engine::{self, Engine};
use super::progress::Progress;
use super::seeds::{Part, seed};
use super::{interrupt, note};
use crate::picture::Picture;
use crate::report::{Reference, ReferenceCache, ReferenceInfo, default_cache_dir, read_exr};
use crate::stats::{Criteria, Verdict};
use crate::{Error, Result};

/// Estimates a frame: enough that primary hits, which all share with point sampling, cost little.
const EFFORT: u32 = 4;
/// References are shared by runs of any seed, so theirs is fixed.
const SEED: u64 = 0x5eed_0000_0000_0001;
/// Never stop before: the variance itself must be known.
const FEWEST_FRAMES: u64 = 16;
/// A new picture of an unchanged scene raises this, so that old references are not used.
const IMAGES: u32 = 1;
/// Frames of effort 1 that a stored reference is checked against.
const CHECK_FRAMES: u32 = 32;
/// Between two writes of an unfinished reference.
const STORE_EVERY: Duration = Duration::from_secs(20);

/// A reference and where it is from.
#[derive(Debug)]
pub(super) struct Made {
    pub reference: Reference,
    pub info: ReferenceInfo,
}

/// Checks what can be checked before anything is rendered, and gives the size that a file dictates.
pub(super) fn file_size(args: &ReferenceArgs) -> Result<Option<[u32; 2]>> {
    let Some(path) = &args.reference else { return Ok(None) };
    let picture = read_exr(path)?.picture;
    Ok(Some([picture.width, picture.height]))
}

/// The reference for `engine`, whose scene does not move, with a pixel variance of at most `variance` unless the time is up first.
pub(super) fn obtain(
    engine: &Engine,
    args: &ReferenceArgs,
    spec: &str,
    variance: f64,
) -> Result<Made> {
    if let Some(path) = &args.reference {
        return from_file(engine, path);
    }
    let cache = ReferenceCache::new(match &args.cache {
        Some(folder) => folder.clone(),
        None => default_cache_dir()?,
    });
    let technique = engine::technique(spec)?;
    let key = engine.key(&format!("{} effort {EFFORT} images {IMAGES}", technique.spec()));
    let (stored, warning) = cache.load(key)?;
    if let Some(warning) = warning {
        note(&format!("warning: {warning}"));
    }
    let mut stored = stored.filter(|r| r.size() == engine.shot.size);
    if let Some(reference) = &stored
        && !agrees(engine, spec, reference)?
    {
        note("warning: the stored reference differs from what is rendered now; it is made anew");
        stored = None;
    }
    let mut source = if stored.is_some() { "cache" } else { "made" };
    let mut reference = stored.unwrap_or_else(|| Reference::new(engine.shot.size));
    if !good(&reference, variance) {
        if source == "cache" {
            source = "cache, continued";
        }
        let begin = Instant::now();
        let mut stored_at = begin;
        let limit = Duration::from_secs_f64(args.reference_time.min(1e6));
        let progress = Progress::new("reference", 1);
        // Frames of one session have consecutive numbers under one seed, and no two sessions start after equally many frames.
        let first = reference.frames() as u32;
        let mut frames =
            engine.start_reference(&technique, EFFORT, seed(SEED, Part::Reference, 0, first))?;
        while !good(&reference, variance) {
            let frame = match engine::next(&mut frames) {
                Ok(frame) => frame,
                Err(error) => {
                    cache.store(key, &reference)?;
                    return Err(error);
                }
            };
            let picture = frame.picture();
            if frame.counters.non_finite > 0 || picture.non_finite() > 0 {
                let message = format!(
                    "{} estimates of the reference are not finite",
                    frame.counters.non_finite
                );
                return Err(Error::invalid(message));
            }
            reference.add(&picture);
            let now = reference.frames();
            if let Some(v) = reference.variance().filter(|_| now >= FEWEST_FRAMES) {
                let needed = (now as f64 * v / variance).ceil().min(1e9) as u64;
                progress.set(now, needed);
            } else {
                progress.set(now, FEWEST_FRAMES);
            }
            if begin.elapsed() > limit && now >= FEWEST_FRAMES {
                break;
            }
            if stored_at.elapsed() > STORE_EVERY {
                cache.store(key, &reference)?;
                stored_at = Instant::now();
            }
        }
        cache.store(key, &reference)?;
    }
    interrupt::check()?;
    let info = ReferenceInfo {
        source: source.to_string(),
        technique: Some(technique.spec()),
        samples: Some(reference.frames() * u64::from(EFFORT)),
        variance: reference.variance(),
        share_of_smallest_mse: None,
    };
    Ok(Made { reference, info })
}

fn good(reference: &Reference, variance: f64) -> bool {
    reference.frames() >= FEWEST_FRAMES && reference.variance().is_some_and(|v| v <= variance)
}

/// Whether fresh frames have the stored reference's means: a renderer that changed under an unchanged version is found so.
///
/// α = 10⁻⁶ in all. Student's t with 31 degrees of freedom exceeds 6.8 with probability 10⁻⁷, so 32 frames of 256² pixels with
/// c = σ/μ = 1 show a change of 0.5 % of the whole picture.
fn agrees(engine: &Engine, spec: &str, reference: &Reference) -> Result<bool> {
    let mut frames =
        engine.start_reference(&engine::technique(spec)?, 1, seed(SEED, Part::Check, 0, 0))?;
    let mut fresh = super::bias::restarts(engine.shot.size)?;
    for _ in 0..CHECK_FRAMES {
        fresh.push(&engine::next(&mut frames)?.picture().pixels)?;
    }
    let criteria =
        Criteria { delta: 1e-9, difference_alpha: 1e-7, tile_alpha: 1e-7, ..Criteria::default() };
    Ok(super::bias::judge(&fresh, reference, &criteria)?.verdict != Verdict::Fail)
}

/// Reflected light of a picture that may hold emission: what the file tells apart, else what this scene emits.
fn from_file(engine: &Engine, path: &Path) -> Result<Made> {
    let file = read_exr(path)?;
    let size = [file.picture.width, file.picture.height];
    if size != engine.shot.size {
        let [width, height] = engine.shot.size;
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
        None => seen_emission(engine)?,
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
    Ok(Made { reference: Reference::from_picture(&picture), info })
}

/// Directly visible emission: one frame is exact with point sampling; with a box filter it is averaged.
pub(super) fn seen_emission(engine: &Engine) -> Result<Picture> {
    let count = if engine.shot.filter == crate::plan::Filter::Point { 1 } else { 256 };
    let technique = engine::technique("bsdf")?;
    // Depth 1 renders nothing but what is seen directly.
    let shot = crate::plan::Shot {
        depth: 1,
        effort: 1.0,
        run: seed(SEED, Part::Reference, 1, 0),
        ..engine.shot
    };
    let mut frames = crate::frame::FrameLoop::new(technique, &engine.stage, shot)?;
    let mut mean = engine::Mean::new(engine.shot.size);
    for _ in 0..count {
        mean.add(&engine::next(&mut frames)?.emission(), 1);
    }
    Ok(mean.picture())
}
