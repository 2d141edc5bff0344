//! An unfinished comparison on disk: what was settled before its restarts, and each restart by its
//! technique's number and its own.
//!
//! Efforts follow from measured times, so a comparison that goes on has those of its beginning; so
//! are the times of each restart, which stay with it. What is finished is forgotten: times are
//! measured anew by whoever compares again.

use std::fs;
use std::path::PathBuf;
use std::sync::Arc;

use glam::Vec3;

use super::budget::Settled;
use super::contender::{Contender, Rendered};
use super::{Comparison, Spending};
use crate::Result;
use crate::experiment::kept;
use crate::experiment::session::Session;
use crate::picture::Picture;
use crate::report::sealed::{Reader, Writer, seal, unseal};
use crate::report::{BudgetKind, CacheKey, PassSample, Sample};
use crate::techniques::Technique;

/// Where a comparison is kept; nowhere, where it is not.
pub(super) struct KeptRun<'a> {
    session: &'a Session,
    files: Option<Files>,
}

struct Files {
    key: CacheKey,
    folder: PathBuf,
}

/// The decisions that are made before the first restart.
#[derive(Clone, Debug)]
pub(super) struct Start {
    pub(super) budget: Settled,
    /// Steady frames of each technique before its restarts; none without a frame time to keep.
    pub(super) calibrations: Vec<Vec<f64>>,
    /// The pilot found this value.
    pub(super) variance: f64,
    /// A digest of what pictures are compared with.
    pub(super) truth: String,
}

/// A digest of a picture's bits.
pub(super) fn digest(picture: &Picture) -> String {
    CacheKey::of(|hasher| hasher.write(bytemuck::cast_slice(&picture.pixels))).to_string()
}

impl<'a> KeptRun<'a> {
    pub(super) fn open(
        comparison: &Comparison,
        session: &'a Session,
        techniques: &[Arc<dyn Technique>],
    ) -> Result<Self> {
        let Some(keep) = &comparison.keep else { return Ok(Self { session, files: None }) };
        let specs: Vec<String> = techniques.iter().map(|technique| technique.spec()).collect();
        let spending = match comparison.spending {
            Spending::Slowest => "slowest".to_string(),
            Spending::Milliseconds(ms) => format!("{ms} ms"),
            Spending::Estimates(spp) => format!("{spp} estimates"),
        };
        let Comparison { frames, accumulate, warmup, .. } = comparison;
        let file = &comparison.reference.file;
        let key = kept::key(
            session,
            &format!(
                "comparison of {specs:?} at {spending} frames {frames} accumulate {accumulate} \
                 warmup {warmup} file {file:?}"
            ),
        )?;
        let files = Files { key, folder: keep.folder.join(key.to_string()) };
        let kept = Self { session, files: Some(files) };
        if keep.fresh {
            kept.forget();
        }
        Ok(kept)
    }

    fn load<T>(
        &self,
        name: &str,
        decode: impl FnOnce(&mut Reader<'_>) -> Option<T>,
    ) -> Result<Option<T>> {
        let Some(Files { key, folder }) = &self.files else { return Ok(None) };
        let (found, warning) = unseal(&folder.join(name), *key, decode)?;
        if let Some(warning) = warning {
            self.session.host().note(&format!("warning: {warning}"));
        }
        Ok(found)
    }

    fn store(&self, name: &str, write: impl FnOnce(&mut Writer)) -> Result<()> {
        let Some(Files { key, folder }) = &self.files else { return Ok(()) };
        let mut writer = Writer::default();
        write(&mut writer);
        seal(&folder.join(name), *key, &writer)
    }

    pub(super) fn start(&self, techniques: usize) -> Result<Option<Start>> {
        self.load("start", |reader| {
            let kind = match reader.u32()? {
                0 => BudgetKind::FrameTime,
                1 => BudgetKind::Spp,
                _ => return None,
            };
            let value = reader.f64()?;
            let efforts = reader.f32s()?;
            let calibrations = reader.list(Reader::f64s)?;
            let (variance, truth) = (reader.f64()?, reader.text()?);
            let whole = efforts.len() == techniques && calibrations.len() == techniques;
            let budget = Settled { kind, value, efforts };
            whole.then_some(Start { budget, calibrations, variance, truth })
        })
    }

    pub(super) fn store_start(&self, start: &Start) -> Result<()> {
        self.store("start", |writer| {
            writer.u32(u32::from(start.budget.kind == BudgetKind::Spp));
            writer.f64(start.budget.value);
            writer.f32s(&start.budget.efforts);
            writer.list(&start.calibrations, |writer, times| writer.f64s(times));
            writer.f64(start.variance);
            writer.text(&start.truth);
        })
    }

    /// A restart of a contender that an earlier run made.
    pub(super) fn restart(&self, contender: &Contender, index: u32) -> Result<Option<Rendered>> {
        let size = self.session.shot.size;
        let seed = contender.seed(self.session, index);
        let pixels = size[0] as usize * size[1] as usize;
        let picture = |reader: &mut Reader<'_>| {
            let values = reader.f32s()?;
            let (values, rest) = values.as_chunks::<3>();
            let whole = values.len() == pixels && rest.is_empty();
            let colours = values.iter().map(|rgb| Vec3::from_array(*rgb)).collect();
            whole.then(|| Picture::new(size[0], size[1], colours))
        };
        self.load(&restart_name(contender, index), |reader| {
            let sample = read_sample(reader)?;
            let whole = sample.seed == seed
                && !sample.ms.is_empty()
                && sample.warmup.len() == contender.warmup as usize;
            let (judged, emission) = (picture(reader)?, picture(reader)?);
            whole.then_some(Rendered { sample, picture: judged, emission })
        })
    }

    pub(super) fn store_restart(
        &self,
        contender: &Contender,
        index: u32,
        rendered: &Rendered,
    ) -> Result<()> {
        let Rendered { sample, picture, emission } = rendered;
        self.store(&restart_name(contender, index), |writer| {
            write_sample(writer, sample);
            for picture in [picture, emission] {
                writer.f32s(bytemuck::cast_slice(&picture.pixels));
            }
        })
    }

    /// A restart of a point of a curve, by its effort and its number.
    pub(super) fn curve_restart(
        &self,
        contender: &Contender,
        place: (f32, u32),
        seed: u64,
    ) -> Result<Option<Sample>> {
        self.load(&curve_name(contender, place), |reader| {
            let (mut sample, relmse) = (read_sample(reader)?, reader.f64()?);
            sample.metrics.insert("relmse".to_string(), relmse);
            (sample.seed == seed && !sample.ms.is_empty()).then_some(sample)
        })
    }

    pub(super) fn store_curve_restart(
        &self,
        contender: &Contender,
        place: (f32, u32),
        sample: &Sample,
    ) -> Result<()> {
        self.store(&curve_name(contender, place), |writer| {
            write_sample(writer, sample);
            writer.f64(sample.metrics["relmse"]);
        })
    }

    /// Removes everything.
    pub(super) fn forget(&self) {
        let Some(Files { folder, .. }) = &self.files else { return };
        // A file that cannot be removed is overwritten later, or its key does not fit.
        let _ = fs::remove_dir_all(folder);
        if let Some(parent) = folder.parent() {
            // Only where nothing else is kept.
            let _ = fs::remove_dir(parent);
        }
    }
}

fn restart_name(contender: &Contender, index: u32) -> String {
    format!("{}-{index}.restart", contender.number)
}

fn curve_name(contender: &Contender, (effort, index): (f32, u32)) -> String {
    format!("{}-{effort}-{index}.curve", contender.number)
}

/// All but metrics, which are of the picture.
fn write_sample(writer: &mut Writer, sample: &Sample) {
    let Sample { seed, ms, rays, passes, metrics: _, warmup, non_finite } = sample;
    writer.u64(*seed);
    writer.f64s(ms);
    let rays: Vec<(&String, &u64)> = rays.iter().collect();
    writer.list(&rays, |writer, (kind, count)| {
        writer.text(kind);
        writer.u64(**count);
    });
    writer.list(passes, |writer, pass| {
        writer.text(&pass.name);
        writer.f64s(&pass.ms);
    });
    writer.f64s(warmup);
    writer.u64(*non_finite);
}

fn read_sample(reader: &mut Reader<'_>) -> Option<Sample> {
    Some(Sample {
        seed: reader.u64()?,
        ms: reader.f64s()?,
        rays: reader.list(|reader| Some((reader.text()?, reader.u64()?)))?.into_iter().collect(),
        passes: reader
            .list(|reader| Some(PassSample { name: reader.text()?, ms: reader.f64s()? }))?,
        warmup: reader.f64s()?,
        non_finite: reader.u64()?,
        ..Sample::default()
    })
}
