//! A technique with what was measured of it.

use std::sync::Arc;

use super::{Comparison, Course, JudgedFrames};
use crate::experiment::calibrate::median_p99;
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::{Mean, Session};
use crate::experiment::{bias, figures};
use crate::frame::{Frame, FrameLoop};
use crate::metrics;
use crate::picture::Picture;
use crate::report::{PassSample, Sample};
use crate::stats::{Moments, Restarts};
use crate::techniques::Technique;
use crate::{Error, Result};

/// Restarts of the pilot.
const PILOT: u32 = 2;

/// See the module's head.
pub(super) struct Contender {
    pub(super) spec: String,
    pub(super) technique: Arc<dyn Technique>,
    pub(super) number: u32,
    pub(super) effort: f32,
    pub(super) frames: FrameLoop,
    /// Steady frames before the first restart and after the last one, where there is a frame time
    /// to keep.
    pub(super) calibrations: [Vec<f64>; 2],
    /// The measurements of each restart.
    pub(super) samples: Vec<Sample>,
    /// How many of them an interrupted run made.
    pub(super) resumed: u32,
    pub(super) restarts: Restarts,
    /// Frames whose `relmse` is wanted; 0: none.
    pub(super) warmup: u32,
    /// Power of the error in each ring.
    pub(super) rings: Vec<Moments>,
    /// For figures that need all restarts at once.
    pub(super) pictures: Vec<Picture>,
    pub(super) shown: Option<Picture>,
    pub(super) emission: Option<Picture>,
}

/// A restart as it was rendered.
pub(super) struct Rendered {
    pub(super) sample: Sample,
    /// The judged frame, or the mean of all where frames are accumulated.
    pub(super) picture: Picture,
    /// Emission that is seen directly in the judged frame.
    pub(super) emission: Picture,
}

impl Contender {
    pub(super) fn new(
        session: &Session,
        technique: &Arc<dyn Technique>,
        number: u32,
        effort: f32,
    ) -> Result<Self> {
        Ok(Self {
            spec: technique.spec(),
            technique: technique.clone(),
            number,
            effort,
            frames: session.start(technique, effort, 0)?,
            calibrations: Default::default(),
            samples: Vec::new(),
            resumed: 0,
            restarts: bias::restarts(session.shot.size)?,
            warmup: 0,
            rings: vec![Moments::new(); figures::RINGS],
            pictures: Vec::new(),
            shown: None,
            emission: None,
        })
    }

    pub(super) fn has_any(&self) -> bool {
        self.restarts.count() > 0
    }

    /// Steady frames of all restarts; the first ones where there are no others.
    pub(super) fn times(&self) -> Vec<f64> {
        self.samples.iter().flat_map(Sample::steady).copied().collect()
    }

    /// Median steady frame.
    pub(super) fn median(&self) -> f64 {
        median_p99(&self.times())[0]
    }

    /// A metric over restarts.
    pub(super) fn metric(&self, name: &str) -> Moments {
        self.samples.iter().filter_map(|sample| sample.metrics.get(name).copied()).collect()
    }

    /// Frames that a picture of the judged quality takes where no time is measured: without
    /// history, all frames are alike.
    fn needed_frames(&self, judged: JudgedFrames) -> u32 {
        if judged.accumulate || self.frames.plan().keeps_history() { judged.frames } else { 1 }
    }

    /// The seed of a restart.
    pub(super) fn seed(&self, session: &Session, index: u32) -> u64 {
        seed(session.shot.run, SeedUse::Restart, self.number, index)
    }

    /// Renders a restart and measures its frames.
    fn restart(
        &mut self,
        session: &Session,
        index: u32,
        judged: JudgedFrames,
        truth: &Picture,
    ) -> Result<Rendered> {
        let seed = self.seed(session, index);
        let mut sample = Sample { seed, ..Sample::default() };
        let wanted = self.warmup;
        let mut emission = None;
        let mut compared = Ok(());
        self.frames.restart(seed);
        let picture = judged_picture(session, &mut self.frames, judged, |at, frame| {
            if at < wanted {
                match figures::relmse(&frame.picture(), truth) {
                    Ok(relmse) => sample.warmup.push(relmse),
                    Err(error) => compared = Err(error),
                }
            }
            sample.ms.push(frame.milliseconds());
            sample.non_finite += frame.counters.non_finite;
            // Passes that run in the first frame only are no part of a steady frame, unless there
            // is no other.
            if at > 0 || judged.frames == 1 {
                add_work(&mut sample, frame);
            }
            if at + 1 == judged.frames {
                emission = Some(frame.emission());
            }
        })?;
        compared?;
        let emission = emission.unwrap_or_else(|| Picture::new(0, 0, Vec::new()));
        Ok(Rendered { sample, picture, emission })
    }

    /// Adds a restart to everything that is said about restarts.
    fn judge(&mut self, rendered: Rendered, course: Course<'_>, keep: bool) -> Result<()> {
        let Course { truth, guides, .. } = course;
        let Rendered { mut sample, picture, emission } = rendered;
        self.restarts.push(&picture.pixels)?;
        for (ring, power) in self.rings.iter_mut().zip(figures::spectrum(&picture, truth)?) {
            ring.push(power);
        }
        let guides = metrics::Guides {
            albedo: &guides.albedo,
            normal: &guides.normal,
            depth: &guides.depth,
        };
        let found = figures::of_picture(&picture, truth, Some(&guides))?;
        sample.metrics = found.into_iter().map(|(name, value)| (name.to_string(), value)).collect();
        self.samples.push(sample);
        if keep {
            self.pictures.push(picture.clone());
        }
        self.shown.get_or_insert(picture);
        self.emission.get_or_insert(emission);
        Ok(())
    }
}

/// Adds rays and pass times of a steady frame.
fn add_work(sample: &mut Sample, frame: &Frame<'_>) {
    for (name, count) in frame.counters.entries() {
        if let Some(kind) = name.strip_suffix("_rays") {
            *sample.rays.entry(kind.to_string()).or_default() += count;
        }
    }
    for &(name, ms) in frame.passes {
        match sample.passes.iter_mut().find(|pass| pass.name == name) {
            Some(pass) => pass.ms.push(ms),
            None => sample.passes.push(PassSample { name: name.to_string(), ms: vec![ms] }),
        }
    }
}

/// The smallest variance of a pixel among techniques: a lower bound of their mean squared errors,
/// found without a reference.
pub(super) fn pilot(
    session: &Session,
    contenders: &mut [Contender],
    judged: JudgedFrames,
) -> Result<f64> {
    let progress = session.host().begin("pilot", contenders.len() as u64 * u64::from(PILOT));
    let mut smallest = f64::INFINITY;
    for contender in contenders {
        let judged = JudgedFrames { frames: contender.needed_frames(judged), ..judged };
        let mut restarts = bias::restarts(session.shot.size)?;
        for index in 0..PILOT {
            progress.say(&contender.spec);
            let run = seed(session.shot.run, SeedUse::Pilot, contender.number, index);
            contender.frames.restart(run);
            let picture = judged_picture(session, &mut contender.frames, judged, |_, _| {})?;
            restarts.push(&picture.pixels)?;
            progress.step();
        }
        let variance = bias::mean_variance(&restarts, session.shot.pixels());
        // A picture without any noise (black, or emission only) says nothing about what the
        // reference needs.
        if variance > 0.0 {
            smallest = smallest.min(variance);
        }
    }
    Ok(smallest)
}

/// Renders from a cold start, hands each frame to `each`, and gives the picture that is judged.
pub(super) fn judged_picture(
    session: &Session,
    frames: &mut FrameLoop,
    judged: JudgedFrames,
    mut each: impl FnMut(u32, &Frame<'_>),
) -> Result<Picture> {
    let mut mean = judged.accumulate.then(|| Mean::new(frames.shot().size));
    for index in 0..judged.frames {
        let frame = session.next(frames)?;
        each(index, &frame);
        if let Some(mean) = &mut mean {
            mean.add(&frame.picture(), 1);
        }
        if index + 1 == judged.frames {
            return Ok(mean.map_or_else(|| frame.picture(), |m| m.picture()));
        }
    }
    Err(Error::usage("`frames` is 0, but must be at least 1"))
}

impl Comparison {
    /// All restarts of all techniques, by turns.
    pub(super) fn restarts(
        &self,
        session: &Session,
        contenders: &mut [Contender],
        course: Course<'_>,
    ) -> Result<()> {
        let Course { judged, truth, kept, .. } = course;
        let moves = session.stage.facts().moves();
        let steps = u64::from(self.restarts) * contenders.len() as u64;
        let progress = session.host().begin("restarts", steps);
        let keep = self.restarts >= figures::COVARIANCE_NEEDS;
        for index in 0..self.restarts {
            for contender in contenders.iter_mut() {
                progress.say(&contender.spec);
                // Without history and motion all frames have one law: a first and a steady one give
                // picture and times.
                let all = moves || contender.warmup > 0;
                let needed =
                    if all { judged.frames } else { contender.needed_frames(judged).max(2) };
                let judged = JudgedFrames { frames: judged.frames.min(needed), ..judged };
                let rendered = match kept.restart(contender, index)? {
                    Some(rendered) => {
                        contender.resumed += 1;
                        rendered
                    }
                    None => {
                        let made = contender.restart(session, index, judged, truth)?;
                        kept.store_restart(contender, index, &made)?;
                        made
                    }
                };
                contender.judge(rendered, course, keep)?;
                progress.step();
            }
        }
        Ok(())
    }
}
