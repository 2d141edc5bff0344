//! Work that outlives an interruption: where it is kept, and for which program.
//!
//! Restarts are independent and numbered, so work that is interrupted goes on with the next number
//! and ends with the bits of work that was not. A kept file is valid for one program on one kind of
//! device: pictures of another build may be others, and nobody would see that two kinds were mixed.

use std::hash::Hasher;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use super::host::{Host, Steps};
use super::reference::ReferenceSettings;
use super::session::Session;
use crate::report::{CacheKey, default_cache_dir};
use crate::{Error, Result};

/// Time between two writes of unfinished work.
pub(super) const STORE_EVERY: Duration = Duration::from_secs(20);

/// Where unfinished work is kept.
#[derive(Clone, Debug)]
pub struct Keep {
    /// The folder; it need not exist.
    pub folder: PathBuf,
    /// Whether what is kept there already is made anew.
    pub fresh: bool,
}

impl Keep {
    /// In the folder `kept` beside references.
    ///
    /// # Errors
    /// There is no [`default_cache_dir`], and `reference` names no folder.
    pub fn beside(reference: &ReferenceSettings, fresh: bool) -> Result<Self> {
        let folder = match &reference.cache {
            Some(folder) => folder.clone(),
            None => default_cache_dir()?,
        };
        Ok(Self { folder: folder.join("kept"), fresh })
    }
}

/// The key of work on a session: everything that decides its bits, this program included.
pub(super) fn key(session: &Session, extra: &str) -> Result<CacheKey> {
    let (run, fps) = (session.shot.run, session.shot.fps);
    let (device, program) = (session.device(), program()?);
    Ok(session.key(&format!("{extra} run {run} fps {fps} on {device:?} by {program}")))
}

/// A digest of the program that runs.
fn program() -> Result<&'static str> {
    static PROGRAM: OnceLock<Option<String>> = OnceLock::new();
    let digest = || {
        let bytes = std::fs::read(std::env::current_exe().ok()?).ok()?;
        Some(CacheKey::of(|hasher: &mut dyn Hasher| hasher.write(&bytes)).to_string())
    };
    PROGRAM.get_or_init(digest).as_deref().ok_or_else(|| {
        Error::usage("this program's own file cannot be read, so no work can be kept for it")
    })
}

/// A host whose time is limited: it stops the work when the time is up.
#[derive(Debug)]
pub(super) struct Until {
    inner: Arc<dyn Host>,
    end: Instant,
}

impl Until {
    pub(super) fn new(inner: Arc<dyn Host>, end: Instant) -> Self {
        Self { inner, end }
    }
}

impl Host for Until {
    fn begin(&self, what: &'static str, steps: u64) -> Box<dyn Steps> {
        self.inner.begin(what, steps)
    }

    fn note(&self, text: &str) {
        self.inner.note(text);
    }

    fn stopped(&self) -> bool {
        self.inner.stopped() || Instant::now() >= self.end
    }
}
