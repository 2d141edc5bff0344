//! Techniques at equal frame time or equal effort, over independent restarts, against one
//! reference.
//!
//! 1. Effort: efforts are calibrated to the frame time, all techniques by turns, or given.
//! 2. Pilot: a few restarts estimate how much each technique varies, from which follows how good
//!    the reference must be.
//! 3. Reference: see [`super::reference`].
//! 4. Restarts, interleaved over techniques, so that a change of the machine's speed meets all
//!    alike.
//! 5. Curve: the same at other efforts, with fewer restarts.
//! 6. Calibration again: a technique whose frames take another time than before the restarts says
//!    so.

mod budget;
mod contender;
mod curve;
mod files;
mod kept;
mod row;

use std::sync::Arc;

use self::contender::Contender;
use self::kept::{KeptRun, Start, digest};
use super::kept::Keep;
use super::reference::{self, ReferenceSettings, SourcedReference};
use super::session::{self, Session};
use super::{figures, machine};
use crate::frame::Guides;
use crate::picture::Picture;
use crate::plan::Filter;
use crate::report::{BudgetKind, Results, SCHEMA, Warmup};
use crate::techniques::Technique;
use crate::{Error, Result};

#[cfg(feature = "cli")]
pub(crate) use self::{
    files::{file_name, guide_layers, sum},
    row::claim,
};

/// A reference's variance over the smallest mse, unless its time is up first (Celarek et al. 2019
/// on noisy references).
const REFERENCE_SHARE: f64 = 0.01;

/// What a technique may spend on a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spending {
    /// The frame time of the slowest technique at effort 1.
    Slowest,
    /// So many milliseconds.
    Milliseconds(f64),
    /// So many complete independent estimates a pixel, whatever they take.
    Estimates(u32),
}

/// How techniques are compared.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// What each technique may spend on a frame.
    pub spending: Spending,
    /// Number of the frame after a cold start that is judged, at least 1. Of a technique without
    /// history, in a still scene, it is the second at most: all have one law.
    pub frames: u32,
    /// Whether the mean of all frames is judged instead of the last.
    pub accumulate: bool,
    /// Independent restarts a technique.
    pub restarts: u32,
    /// Restarts of each further point of the error-against-time curve; 0 leaves the curve out.
    pub curve_restarts: u32,
    /// Whether the error of every frame is found for all techniques, not just for those with
    /// history.
    pub warmup: bool,
    /// Where the reference comes from.
    pub reference: ReferenceSettings,
    /// Where restarts are kept until the comparison is done, so that one that was interrupted goes
    /// on: with the efforts of its beginning, and with the times that its restarts took.
    pub keep: Option<Keep>,
}

impl Default for Comparison {
    /// Equal frame time, the 16th frame, 20 restarts, 4 for each point of the curve.
    fn default() -> Self {
        Self {
            spending: Spending::Slowest,
            frames: 16,
            accumulate: false,
            restarts: 20,
            curve_restarts: 4,
            warmup: false,
            reference: ReferenceSettings::default(),
            keep: None,
        }
    }
}

/// What a comparison found.
#[derive(Debug)]
pub struct Compared {
    /// Every figure. Its `command` is empty: a program that has one fills it in.
    pub results: Results,
    /// What the pictures were compared with, without emission that is seen directly.
    pub truth: Picture,
    /// Albedo, normals, depth and motion of the judged frame.
    pub guides: Guides,
    /// One a technique, in their order.
    pub shown: Vec<Shown>,
}

/// The picture of a technique's first restart.
#[derive(Debug)]
pub struct Shown {
    /// The technique's specification.
    pub technique: String,
    /// Reflected light.
    pub picture: Option<Picture>,
    /// Emission that is seen directly.
    pub emission: Option<Picture>,
}

/// Which frames of a restart are judged.
#[derive(Clone, Copy, Debug)]
struct JudgedFrames {
    frames: u32,
    accumulate: bool,
}

impl Comparison {
    /// Compares techniques. A host that stops the work while restarts are rendered gets what was
    /// done, marked as [`interrupted`](Results::interrupted); the same again goes on from there
    /// ([`Comparison::keep`]).
    ///
    /// # Errors
    /// An interruption before every technique has a restart; no technique; a warm-up or a mean over
    /// frames of a scene that moves; whatever a loop or a reference refuses.
    pub fn run(&self, session: &Session, techniques: &[Arc<dyn Technique>]) -> Result<Compared> {
        self.refuse(session, techniques)?;
        let judged = JudgedFrames { frames: self.frames, accumulate: self.accumulate };

        let kept = KeptRun::open(self, session, techniques)?;

        // Effort, then a pilot of each technique, unless an interrupted run had them.
        let begun = kept.start(techniques.len())?;
        let budget = match &begun {
            Some(start) => start.budget.clone(),
            None => budget::settle(session, techniques, self.spending)?,
        };
        let mut contenders = Vec::new();
        for (at, technique) in techniques.iter().enumerate() {
            contenders.push(Contender::new(session, technique, at as u32, budget.efforts[at])?);
        }
        let timed = budget.kind == BudgetKind::FrameTime;
        let calibrations = match &begun {
            Some(start) => start.calibrations.clone(),
            None if timed => budget::times(session, &mut contenders)?,
            None => vec![Vec::new(); contenders.len()],
        };
        for (contender, times) in contenders.iter_mut().zip(&calibrations) {
            contender.calibrations[0].clone_from(times);
        }
        let variance = match &begun {
            Some(start) => start.variance,
            None => contender::pilot(session, &mut contenders, judged)?,
        };

        let frozen = session.frozen(self.frames - 1)?;
        let (made, goes_on) = self.reference(&frozen, variance, begun.as_ref())?;
        let truth = made.reference.picture();
        if begun.is_some() && !goes_on {
            session.host().note("warning: the reference is another one than when this comparison was interrupted; its restarts are made anew");
            kept.forget();
        }
        let start = Start { budget, calibrations, variance, truth: digest(&truth) };
        kept.store_start(&start)?;
        let budget = start.budget;
        let guides = Guides::new(frozen.stage.first_world(), None, session.shot.size);

        // Restarts and curves, as far as the host lets them come.
        self.choose_warmups(session, &mut contenders);
        let course = Course { judged, truth: &truth, guides: &guides, kept: &kept };
        let mut interrupted = false;
        match self.restarts(session, &mut contenders, course) {
            Ok(()) => {}
            Err(error) if error.is_interrupted() && contenders.iter().all(Contender::has_any) => {
                interrupted = true;
            }
            Err(error) => return Err(error),
        }
        let mut curves = Vec::new();
        if !interrupted && self.curve_restarts > 0 {
            match self.curves(session, &contenders, course) {
                Ok(found) => curves = found,
                Err(error) if error.is_interrupted() => interrupted = true,
                Err(error) => return Err(error),
            }
        }
        if !interrupted && timed {
            match budget::times(session, &mut contenders) {
                Ok(times) => {
                    contenders.iter_mut().zip(times).for_each(|(c, ms)| c.calibrations[1] = ms);
                }
                Err(error) if error.is_interrupted() => interrupted = true,
                Err(error) => return Err(error),
            }
        }

        let rows = contenders
            .iter()
            .map(|contender| contender.row(session, &budget, judged, &made.reference, &truth))
            .collect::<Result<Vec<_>>>()?;
        let mut results = self.results(session, made, &contenders);
        let smallest = rows
            .iter()
            .filter_map(|row| row.metrics.get("mse"))
            .map(|figure| figure.mean)
            .fold(f64::INFINITY, f64::min);
        results.reference.share_of_smallest_mse =
            results.reference.variance.map(|v| v / smallest).filter(|share| share.is_finite());
        let resumed = contenders.iter().map(|contender| contender.resumed).sum();
        results = Results { interrupted, resumed, rows, curves, ..results };
        if !interrupted {
            kept.forget();
        }
        let shown = contenders
            .into_iter()
            .map(|c| Shown { technique: c.spec, picture: c.shown, emission: c.emission })
            .collect();
        Ok(Compared { results, truth, guides, shown })
    }

    /// The reference, and whether it is the one that restarts of an interrupted run were compared
    /// with: that is not continued, or it would be another.
    fn reference(
        &self,
        frozen: &Session,
        variance: f64,
        begun: Option<&Start>,
    ) -> Result<(SourcedReference, bool)> {
        let nee = session::technique("nee")?;
        if let Some(start) = begun {
            let made = reference::obtain(frozen, &self.reference, &nee, f64::INFINITY)?;
            if digest(&made.reference.picture()) == start.truth {
                return Ok((made, true));
            }
        }
        // The curve's longest frames are four times as long, so their error is as many times
        // smaller.
        let reach = if self.curve_restarts > 0 { 4.0 } else { 1.0 };
        let wanted = REFERENCE_SHARE * variance / reach;
        Ok((reference::obtain(frozen, &self.reference, &nee, wanted)?, false))
    }

    /// Refuses what has no answer.
    fn refuse(&self, session: &Session, techniques: &[Arc<dyn Technique>]) -> Result<()> {
        if techniques.is_empty() {
            return Err(Error::usage("there is no technique to compare; give at least one"));
        }
        if self.frames == 0 {
            return Err(Error::usage("`frames` is 0, but must be at least 1"));
        }
        if self.restarts == 0 {
            return Err(Error::usage("`restarts` is 0, but must be at least 1"));
        }
        if let Spending::Milliseconds(ms) = self.spending
            && !(ms.is_finite() && ms > 0.0)
        {
            return Err(Error::usage(format!("a frame of {ms} ms is none; it must be above 0")));
        }
        let moves = session.stage.facts().moves();
        if self.warmup && moves {
            return Err(Error::usage(
                "`warmup` needs a scene that does not move: its frames have no common reference",
            ));
        }
        if self.accumulate && moves {
            return Err(Error::usage(
                "`accumulate` needs a scene that does not move: the mean over its frames has no reference",
            ));
        }
        Ok(())
    }

    /// Asks for the error of every frame, where that is wanted or telling.
    fn choose_warmups(&self, session: &Session, contenders: &mut [Contender]) {
        if self.accumulate || session.stage.facts().moves() {
            return;
        }
        for contender in contenders {
            if self.warmup || contender.frames.plan().keeps_history() {
                contender.warmup = self.frames;
            }
        }
    }

    /// Everything but rows and curves.
    fn results(
        &self,
        session: &Session,
        made: SourcedReference,
        contenders: &[Contender],
    ) -> Results {
        let machine = machine::describe();
        Results {
            afterimage: env!("CARGO_PKG_VERSION").to_string(),
            commit: machine::commit(),
            machine: match session.device() {
                Some(device) => format!("{machine}; {device}"),
                None => machine,
            },
            command: String::new(),
            scene: session.scene.clone(),
            size: session.shot.size,
            depth: session.shot.depth,
            seed: session.shot.run,
            filter: match session.shot.filter {
                Filter::Point => "point".to_string(),
                Filter::Box => "box".to_string(),
            },
            reference: made.info,
            schema: SCHEMA,
            interrupted: false,
            resumed: 0,
            rows: Vec::new(),
            curves: Vec::new(),
            warmups: contenders
                .iter()
                .filter(|c| c.warmup > 0)
                .map(|c| {
                    let of_frame = |at: usize| {
                        figures::over_restarts(&c.samples.iter().map(|s| s.warmup[at]).collect())
                    };
                    let relmse = (0..c.warmup as usize).map(of_frame).collect();
                    Warmup { technique: c.spec.clone(), relmse }
                })
                .collect(),
            spectra: contenders.iter().map(Contender::spectrum).collect(),
        }
    }
}

/// The inputs that all restarts of a comparison share.
#[derive(Clone, Copy)]
struct Course<'a> {
    judged: JudgedFrames,
    /// The reference picture.
    truth: &'a Picture,
    guides: &'a Guides,
    kept: &'a KeptRun<'a>,
}
