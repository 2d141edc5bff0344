//! A trial on disk: its pilot, its stages and their numbers of restarts, and the sums over the
//! restarts that are done.
//!
//! Numbers of restarts are decided once, from the pilot, and kept: a trial that goes on looks at
//! its data after the same restarts as one that was never interrupted, and never twice.

use std::path::PathBuf;

use super::counts::Counts;
use super::{Ages, Running};
use crate::Result;
use crate::experiment::bias;
use crate::experiment::kept;
use crate::experiment::seeds::SeedUse;
use crate::experiment::session::Session;
use crate::report::CacheKey;
use crate::report::sealed::{Reader, Writer, seal, unseal};
use crate::stats::Restarts;

/// Where a trial is kept; nowhere, where it is not.
pub(super) struct KeptTrial<'a> {
    session: &'a Session,
    files: Option<Files>,
}

struct Files {
    key: CacheKey,
    pilot: PathBuf,
    stages: PathBuf,
}

/// Stages as far as they are.
#[derive(Clone, Debug)]
pub(super) struct Stages {
    /// With their seeds and numbers of restarts.
    pub(super) all: Vec<(SeedUse, Counts)>,
    /// How many of them were judged, and were no pass.
    pub(super) judged: usize,
    /// Restarts of the next one that are done, and their sums, one an age.
    pub(super) done: u32,
    pub(super) sums: Vec<Restarts>,
}

impl<'a> KeptTrial<'a> {
    /// What is kept of a trial; a fresh one forgets it.
    pub(super) fn open(running: &Running<'a>) -> Result<Self> {
        let session = running.session;
        let Some(keep) = &running.trial.keep else { return Ok(Self { session, files: None }) };
        let key = running.key()?;
        let path = |what: &str| keep.folder.join(format!("{key}.{what}"));
        let files = Files { key, pilot: path("pilot"), stages: path("stages") };
        if keep.fresh {
            files.remove();
        }
        Ok(Self { session, files: Some(files) })
    }

    fn load<T>(
        &self,
        path: impl Fn(&Files) -> &PathBuf,
        decode: impl FnOnce(&mut Reader<'_>) -> Option<T>,
    ) -> Result<Option<T>> {
        let Some(files) = &self.files else { return Ok(None) };
        let (found, warning) = unseal(path(files), files.key, decode)?;
        if let Some(warning) = warning {
            self.session.host().note(&format!("warning: {warning}"));
        }
        Ok(found)
    }

    /// A pilot and the seconds that a frame of it took.
    pub(super) fn pilot(&self) -> Result<Option<(Vec<Restarts>, f64)>> {
        let size = self.session.shot.size;
        self.load(
            |files| &files.pilot,
            |reader| {
                let a_frame = reader.f64()?;
                Some((read_sums(reader, size)?, a_frame))
            },
        )
    }

    pub(super) fn store_pilot(&self, pilot: &[Restarts], a_frame: f64) -> Result<()> {
        let Some(files) = &self.files else { return Ok(()) };
        let mut writer = Writer::default();
        writer.f64(a_frame);
        writer.list(pilot, |writer, sums| writer.f64s(&sums.state()));
        seal(&files.pilot, files.key, &writer)
    }

    pub(super) fn stages(&self) -> Result<Option<Stages>> {
        let size = self.session.shot.size;
        self.load(
            |files| &files.stages,
            |reader| {
                let all = reader.list(|reader| {
                    let seeds = match reader.u32()? {
                        1 => SeedUse::Restart,
                        2 => SeedUse::SecondStage,
                        _ => return None,
                    };
                    Some((seeds, Counts(reader.list(Reader::u32)?)))
                })?;
                let judged = reader.u32()? as usize;
                let done = reader.u32()?;
                let sums = read_sums(reader, size)?;
                let whole = sums.is_empty() == (done == 0) && judged < all.len();
                whole.then_some(Stages { all, judged, done, sums })
            },
        )
    }

    pub(super) fn store_stages(&self, stages: &Stages) -> Result<()> {
        let Some(files) = &self.files else { return Ok(()) };
        let mut writer = Writer::default();
        writer.list(&stages.all, |writer, (seeds, counts)| {
            writer.u32(if *seeds == SeedUse::SecondStage { 2 } else { 1 });
            writer.list(&counts.0, |writer, count| writer.u32(*count));
        });
        writer.u32(stages.judged as u32);
        writer.u32(stages.done);
        writer.list(&stages.sums, |writer, sums| writer.f64s(&sums.state()));
        seal(&files.stages, files.key, &writer)
    }

    /// Forgets a trial that is over.
    pub(super) fn remove(&self) {
        self.files.iter().for_each(Files::remove);
    }
}

impl Files {
    /// What cannot be removed is found again, and is as good as new.
    fn remove(&self) {
        for path in [&self.pilot, &self.stages] {
            let _ = std::fs::remove_file(path);
        }
    }
}

fn read_sums(reader: &mut Reader<'_>, size: [u32; 2]) -> Option<Vec<Restarts>> {
    reader.list(|reader| bias::restarts(size).ok()?.restore(&reader.f64s()?))
}

impl Running<'_> {
    /// The key of everything that decides this trial's restarts and how many there are, but the
    /// time that there is.
    pub(super) fn key(&self) -> Result<CacheKey> {
        let trial = self.trial;
        let ages = match &trial.ages {
            Ages::Given(_) => "given",
            Ages::Distinct(_) => "distinct",
        };
        kept::key(
            self.session,
            &format!(
                "trial of {} effort {} ages {ages} {:?} delta {} restarts {:?} most {} confirm {} \
                 number {} against {}",
                self.technique.spec(),
                trial.effort,
                self.ages,
                trial.delta,
                trial.restarts,
                trial.most,
                trial.confirm,
                trial.number,
                self.against.spec()
            ),
        )
    }
}
