//! A technique with what was measured of it.

use std::sync::Arc;

use super::{Against, Comparison, JudgedFrames};
use crate::counters::Counters;
use crate::experiment::calibrate::median_p99;
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::{Mean, Session, add_times};
use crate::experiment::{bias, figures};
use crate::frame::{Frame, FrameLoop};
use crate::metrics;
use crate::picture::Picture;
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
    pub(super) steady: Vec<f64>,
    pub(super) first: Vec<f64>,
    /// Each restart's median steady frame.
    pub(super) medians: Moments,
    /// Median steady frame before the first restart and after the last one, where there is a frame
    /// time to keep.
    pub(super) calibrated: Option<f64>,
    pub(super) recalibrated: Option<f64>,
    pub(super) passes: Vec<(&'static str, Vec<f64>)>,
    pub(super) work: Counters,
    pub(super) work_frames: u64,
    pub(super) restarts: Restarts,
    pub(super) metrics: Vec<(&'static str, Moments)>,
    /// `relmse` of each frame, where that is wanted.
    pub(super) warmup: Vec<Moments>,
    /// Power of the error in each ring.
    pub(super) rings: Vec<Moments>,
    /// For figures that need all restarts at once.
    pub(super) pictures: Vec<Picture>,
    pub(super) shown: Option<Picture>,
    pub(super) emission: Option<Picture>,
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
            steady: Vec::new(),
            first: Vec::new(),
            medians: Moments::new(),
            calibrated: None,
            recalibrated: None,
            passes: Vec::new(),
            work: Counters::default(),
            work_frames: 0,
            restarts: bias::restarts(session.shot.size)?,
            metrics: Vec::new(),
            warmup: Vec::new(),
            rings: vec![Moments::new(); figures::RINGS],
            pictures: Vec::new(),
            shown: None,
            emission: None,
        })
    }

    pub(super) fn has_any(&self) -> bool {
        self.restarts.count() > 0
    }

    pub(super) fn make_room_for_warmup(&mut self, frames: u32) {
        self.warmup = vec![Moments::new(); frames as usize];
    }

    /// Steady frames; the first ones where there are no others.
    pub(super) fn times(&self) -> &[f64] {
        if self.steady.is_empty() { &self.first } else { &self.steady }
    }

    /// Median steady frame.
    pub(super) fn median(&self) -> f64 {
        median_p99(self.times())[0]
    }

    /// Frames that a picture of the judged quality takes where no time is measured: without
    /// history, all frames are alike.
    fn needed_frames(&self, judged: JudgedFrames) -> u32 {
        if judged.accumulate || self.frames.plan().keeps_history() { judged.frames } else { 1 }
    }

    /// Renders a restart and measures its frames; gives the judged picture.
    fn restart(
        &mut self,
        session: &Session,
        index: u32,
        judged: JudgedFrames,
        truth: &Picture,
    ) -> Result<Picture> {
        let Self { number, frames, steady, first, passes, work, work_frames, .. } = self;
        let (warmup, emission) = (&mut self.warmup, &mut self.emission);
        frames.restart(seed(session.shot.run, SeedUse::Restart, *number, index));
        let mut compared = Ok(());
        let (first_before, steady_before) = (first.len(), steady.len());
        let picture = judged_picture(session, frames, judged, |at, frame| {
            if let Some(moments) = warmup.get_mut(at as usize) {
                match figures::relmse(&frame.picture(), truth) {
                    Ok(relmse) => moments.push(relmse),
                    Err(error) => compared = Err(error),
                }
            }
            let times = if at == 0 { &mut *first } else { &mut *steady };
            times.push(frame.milliseconds());
            // Passes that run in the first frame only are no part of a steady frame, unless there
            // is no other.
            if at > 0 || judged.frames == 1 {
                *work = *work + frame.counters;
                *work_frames += 1;
                add_times(passes, frame);
            }
            if emission.is_none() && at + 1 == judged.frames {
                *emission = Some(frame.emission());
            }
        })?;
        compared?;
        // A restart of a single frame has no steady one.
        let own = &steady[steady_before..];
        let own = if own.is_empty() { &first[first_before..] } else { own };
        self.medians.push(median_p99(own)[0]);
        Ok(picture)
    }

    /// Adds a restart's picture to everything that is said about pictures.
    fn judge(&mut self, picture: Picture, against: Against<'_>, keep: bool) -> Result<()> {
        let Against { truth, guides } = against;
        self.restarts.push(&picture.pixels)?;
        for (ring, power) in self.rings.iter_mut().zip(figures::spectrum(&picture, truth)?) {
            ring.push(power);
        }
        let guides = metrics::Guides {
            albedo: &guides.albedo,
            normal: &guides.normal,
            depth: &guides.depth,
        };
        for (name, value) in figures::of_picture(&picture, truth, Some(&guides))? {
            match self.metrics.iter_mut().find(|(known, _)| *known == name) {
                Some((_, moments)) => moments.push(value),
                None => self.metrics.push((name, [value].into_iter().collect())),
            }
        }
        if keep {
            self.pictures.push(picture.clone());
        }
        self.shown.get_or_insert(picture);
        Ok(())
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
        judged: JudgedFrames,
        against: Against<'_>,
    ) -> Result<()> {
        let moves = session.stage.facts().moves();
        let steps = u64::from(self.restarts) * contenders.len() as u64;
        let progress = session.host().begin("restarts", steps);
        let keep = self.restarts >= figures::COVARIANCE_NEEDS;
        for index in 0..self.restarts {
            for contender in contenders.iter_mut() {
                progress.say(&contender.spec);
                // Without history and motion all frames have one law: a first and a steady one give
                // picture and times.
                let all = moves || !contender.warmup.is_empty();
                let needed =
                    if all { judged.frames } else { contender.needed_frames(judged).max(2) };
                let judged = JudgedFrames { frames: judged.frames.min(needed), ..judged };
                let picture = contender.restart(session, index, judged, against.truth)?;
                contender.judge(picture, against, keep)?;
                progress.step();
            }
        }
        Ok(())
    }
}
