//! One technique on one scene against a reference: how many restarts, two stages, a verdict.
//!
//! 1. A pilot of [`PILOT`] restarts says how long a frame takes and how much the means vary; where
//!    time allows, a longer one, up to [`LONG_PILOT`], says it better. From that follows how many
//!    restarts the first stage needs at each age: young frames vary most and cost least, so most
//!    restarts end early. Pilots are never tested, so this choice costs nothing of any α.
//! 2. First stage. All parts ([`crate::stats::agreement`]) of all ages are judged together. A pass
//!    ends the trial.
//! 3. Otherwise the second stage decides: fresh seeds, four times as many restarts. It comes first
//!    where time allows less than half of what the first stage needs.
//!
//! Levels: a wrong picture has two chances to pass, so each stage tests equivalence at α/2 =
//! 5·10⁻⁴. Nothing fails but by the second stage at 10⁻⁴ (Holm), whatever the first one said: both
//! share the reference's error, so their levels must not be multiplied.

mod counts;
mod kept;
mod outcome;
mod pool;
mod restarts;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Instant;

use self::counts::Counts;
use self::kept::{KeptTrial, Stages};
use self::outcome::judge;
use super::kept::Keep;
use super::reference::{ReferenceSettings, SourcedReference};
use super::seeds::SeedUse;
use super::session::{self, Session};
use crate::stats::{self, Restarts, Tolerance, Verdict};
use crate::techniques::Technique;
use crate::{Error, Result};

pub use self::outcome::{AgeOutcome, StageOutcome, TrialOutcome};
pub use self::pool::ReferencePool;

/// Restarts of the pilots, at least and at most: rare bright ones say most of how much the means
/// vary.
const PILOT: u32 = 8;
const LONG_PILOT: u32 = 64;
/// Share of a trial's time that the long pilot may take.
const PILOT_SHARE: f64 = 0.05;
/// Level at which the first stage calls a difference certain, which only the second may confirm.
const SCREEN_ALPHA: f64 = 1e-2;
/// Standard error of a part over restarts that passes almost surely, in margins: with the
/// reference's 0.1 the margin is then 6.3 standard errors, of which the test at 5·10⁻⁴ takes 3.3.
const RESTART_ERROR: f64 = 0.12;

/// Frames after a cold start that are judged, rising.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ages {
    /// Exactly these.
    Given(Vec<u32>),
    /// Those of these that can differ: frame 1 alone where a technique keeps no history and nothing
    /// moves.
    Distinct(Vec<u32>),
}

impl Ages {
    /// The ages that are judged for a technique on a session's scene.
    #[must_use]
    pub fn of(&self, session: &Session, technique: &dyn Technique) -> Vec<u32> {
        match self {
            Self::Given(ages) => ages.clone(),
            Self::Distinct(ages) => {
                let history = session.plan(technique).keeps_history();
                if history || session.stage.facts().moves() { ages.clone() } else { vec![1] }
            }
        }
    }

    /// The last frame that may be judged.
    #[must_use]
    pub fn longest(&self) -> u32 {
        let (Self::Given(ages) | Self::Distinct(ages)) = self;
        ages.last().copied().unwrap_or(1)
    }
}

/// How a technique's mean is tested.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Which frames are judged.
    pub ages: Ages,
    /// Complete independent estimates a pixel and frame
    /// ([`Shot::effort`](crate::plan::Shot::effort)).
    pub effort: f32,
    /// Bias of the image that passes, as a share of its mean; tiles may have twice as much.
    pub delta: f64,
    /// Restarts of the first stage; `None`: as many as a pilot says.
    pub restarts: Option<u32>,
    /// The most restarts that the pilot may choose.
    pub most: u32,
    /// Seconds that restarts may take in all, as the pilot's clock says.
    pub seconds: f64,
    /// Whether `seconds` are for pilots and references, too.
    pub all_in: bool,
    /// Whether a second stage follows a first one that is no pass.
    pub confirm: bool,
    /// Number of the trial in its run: no two share a seed.
    pub number: u32,
    /// What makes the reference; `None`: `nee`, and `bsdf` for `nee` itself.
    pub against: Option<Arc<dyn Technique>>,
    /// Where references come from.
    pub reference: ReferenceSettings,
    /// Where restarts are kept, so that a trial that was interrupted goes on: with the same numbers
    /// of restarts, whatever `seconds` says then, to the same bits. A trial that is over is
    /// forgotten.
    pub keep: Option<Keep>,
}

/// What a trial is going to cost.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialPlan {
    /// Frames that will be judged.
    pub ages: Vec<u32>,
    /// Restarts that the stage has at each age.
    pub restarts: Vec<u32>,
    /// Of these, at the first age, those that are done already.
    pub done: u32,
    /// The stage that is next: 1 or 2.
    pub stage: u32,
    /// Seconds that the rest of the stage takes, as the pilot's clock says.
    pub seconds: f64,
}

impl Default for Trial {
    /// δ = 0.5 % at frames 1, 2, 5, 20 and 50, in at most 20 minutes of restarts.
    fn default() -> Self {
        Self {
            ages: Ages::Distinct(vec![1, 2, 5, 20, 50]),
            effort: 1.0,
            delta: 0.005,
            restarts: None,
            most: 1 << 15,
            seconds: 1200.0,
            all_in: false,
            confirm: true,
            number: 0,
            against: None,
            reference: ReferenceSettings::default(),
            keep: None,
        }
    }
}

impl Trial {
    /// δ = 1 % at frames 1, 5 and 20, in at most a minute of restarts: finds large errors only.
    #[must_use]
    pub fn quick() -> Self {
        Self { ages: Ages::Distinct(vec![1, 5, 20]), delta: 0.01, seconds: 60.0, ..Self::default() }
    }

    /// What makes the reference for a technique; none is its own judge.
    ///
    /// # Errors
    /// None today: both defaults are registered.
    pub fn against(&self, technique: &dyn Technique) -> Result<Arc<dyn Technique>> {
        match &self.against {
            Some(against) => Ok(against.clone()),
            None => session::technique(other_than(&technique.spec())),
        }
    }

    /// Runs the trial; `shown` gets every stage as soon as it is judged, with the references of its
    /// ages (one for all where nothing moves).
    ///
    /// # Errors
    /// An interruption; ages that do not rise from 1 or more, a δ that is no share, no restarts;
    /// whatever a loop, a reference or `shown` refuses.
    pub fn run(
        &self,
        session: &Session,
        technique: &Arc<dyn Technique>,
        pool: &mut ReferencePool,
        mut shown: impl FnMut(&StageOutcome, &[Arc<SourcedReference>]) -> Result<()>,
    ) -> Result<TrialOutcome> {
        let running = Running::new(self, session, technique)?;
        let kept = KeptTrial::open(&running)?;
        let begin = Instant::now();
        let (found, a_frame) = running.pilots(&kept)?;

        let made = running.references(pool, &found)?;
        let of_age = |at: usize| &made[at.min(made.len() - 1)].reference;

        // What was decided is kept, so that a trial that goes on has the same stages.
        let stages = kept.stages()?;
        let mut state = match stages {
            Some(stages) => stages,
            None => {
                let spent = if self.all_in { begin.elapsed().as_secs_f64() } else { 0.0 };
                let frames_left = (self.seconds - spent).max(0.0) / a_frame;
                let all = running.stages(&found, frames_left)?;
                Stages { all, judged: 0, done: 0, sums: Vec::new() }
            }
        };
        kept.store_stages(&state)?;
        let mut stages = Vec::new();
        for (seeds, counts) in state.all.clone().into_iter().skip(state.judged) {
            let second = seeds == SeedUse::SecondStage;
            let tolerance = Tolerance::of(self.delta);
            let tolerance = Tolerance {
                equivalence_alpha: 0.5 * tolerance.equivalence_alpha,
                difference_alpha: if second { tolerance.difference_alpha } else { SCREEN_ALPHA },
                ..tolerance
            };
            let begun = (state.done, std::mem::take(&mut state.sums));
            let found = running.more_restarts(seeds, &counts, begun.0, begun.1, |done, sums| {
                // Nothing is kept of nothing.
                let sums = if done == 0 { Vec::new() } else { sums.to_vec() };
                kept.store_stages(&Stages { done, sums, ..state.clone() })
            })?;
            let stage = if second { 2 } else { 1 };
            let judged = StageOutcome { stage, ..judge(found, &running.ages, of_age, tolerance)? };
            shown(&judged, &made)?;
            let passed = judged.verdict == Verdict::Pass;
            stages.push(judged);
            (state.judged, state.done) = (state.judged + 1, 0);
            if passed || !self.confirm || state.judged == state.all.len() {
                break;
            }
            kept.store_stages(&state)?;
        }
        kept.remove();
        Ok(TrialOutcome { plan: session.plan(&**technique), stages })
    }
}

impl Trial {
    /// Forgets what is kept of the trial.
    pub(super) fn forget(&self, session: &Session, technique: &Arc<dyn Technique>) -> Result<()> {
        KeptTrial::open(&Running::new(self, session, technique)?)?.remove();
        Ok(())
    }

    /// What the trial is going to cost, from its pilot; nothing is judged, and no reference made.
    ///
    /// # Errors
    /// As [`Trial::run`].
    pub fn plan(&self, session: &Session, technique: &Arc<dyn Technique>) -> Result<TrialPlan> {
        let running = Running::new(self, session, technique)?;
        let kept = KeptTrial::open(&running)?;
        let (found, a_frame) = running.pilots(&kept)?;
        let stages = match kept.stages()? {
            Some(stages) => stages,
            None => {
                let all = running.stages(&found, self.seconds / a_frame)?;
                Stages { all, judged: 0, done: 0, sums: Vec::new() }
            }
        };
        let (seeds, counts) = &stages.all[stages.judged];
        let ages = &running.ages;
        let left = counts.frames(ages) - counts.up_to(stages.done).frames(ages);
        Ok(TrialPlan {
            ages: ages.clone(),
            restarts: counts.0.clone(),
            done: stages.done,
            stage: if *seeds == SeedUse::SecondStage { 2 } else { 1 },
            seconds: left as f64 * a_frame,
        })
    }
}

/// A technique compared with itself is never found wrong.
fn other_than(spec: &str) -> &'static str {
    if spec.split(':').next() == Some("nee") { "bsdf" } else { "nee" }
}

/// A trial with what it runs on.
struct Running<'a> {
    session: &'a Session,
    technique: &'a Arc<dyn Technique>,
    trial: &'a Trial,
    ages: Vec<u32>,
    against: Arc<dyn Technique>,
}

impl<'a> Running<'a> {
    fn new(
        trial: &'a Trial,
        session: &'a Session,
        technique: &'a Arc<dyn Technique>,
    ) -> Result<Self> {
        let ages = trial.ages.of(session, &**technique);
        let against = trial.against(&**technique)?;
        let running = Self { session, technique, trial, ages, against };
        running.refuse()?;
        Ok(running)
    }

    /// The kept pilot, or a short one and, where there is time, a long one; with the seconds that a
    /// frame took.
    fn pilots(&self, kept: &KeptTrial<'_>) -> Result<(Vec<Restarts>, f64)> {
        if let Some(pilot) = kept.pilot()? {
            return Ok(pilot);
        }
        let (mut found, mut a_frame) = self.pilot(PILOT)?;
        let length = self.long_pilot(a_frame);
        if length >= 2 * PILOT {
            (found, a_frame) = self.pilot(length)?;
        }
        kept.store_pilot(&found, a_frame)?;
        Ok((found, a_frame))
    }

    /// Refuses what has no answer.
    fn refuse(&self) -> Result<()> {
        let Trial { delta, restarts, .. } = *self.trial;
        let rising = self.ages.is_sorted_by(|a, b| a < b);
        if self.ages.first().is_none_or(|first| *first == 0) || !rising {
            let ages = &self.ages;
            return Err(Error::usage(format!("ages are {ages:?}, but must rise from 1 or more")));
        }
        if !(delta > 0.0 && delta < 1.0) {
            return Err(Error::usage(format!("`delta` is {delta}, but must be a share in (0, 1)")));
        }
        if restarts.is_some_and(|restarts| restarts < 2) {
            return Err(Error::usage("`restarts` must be 2 or more: one has no variance"));
        }
        Ok(())
    }

    /// A pilot with `count` restarts, and the seconds that a frame took.
    fn pilot(&self, count: u32) -> Result<(Vec<Restarts>, f64)> {
        let begin = Instant::now();
        let counts = Counts::all(&self.ages, count);
        let found = self.restarts(SeedUse::Pilot, &counts)?;
        Ok((found, begin.elapsed().as_secs_f64() / counts.frames(&self.ages) as f64))
    }

    /// Restarts for which [`PILOT_SHARE`] of the time is enough, at most [`LONG_PILOT`]; none where
    /// their number is given.
    fn long_pilot(&self, a_frame: f64) -> u32 {
        if self.trial.restarts.is_some() {
            return 0;
        }
        let longest = self.ages.last().copied().unwrap_or(1);
        let length = PILOT_SHARE * self.trial.seconds / (a_frame * f64::from(longest));
        (length as u32).min(LONG_PILOT)
    }

    /// A reference for each age where anything moves, else one for all. The pilot has the parts.
    fn references(
        &self,
        pool: &mut ReferencePool,
        pilot: &[Restarts],
    ) -> Result<Vec<Arc<SourcedReference>>> {
        let count = if self.session.stage.facts().moves() { self.ages.len() } else { 1 };
        self.ages[..count]
            .iter()
            .zip(pilot)
            .map(|(&age, like)| {
                pool.obtain(&self.session.frozen(age - 1)?, self.trial, &self.against, like)
            })
            .collect()
    }

    /// The stages that time allows, with their seeds and numbers of restarts.
    fn stages(&self, pilot: &[Restarts], frames_left: f64) -> Result<Vec<(SeedUse, Counts)>> {
        let (trial, ages) = (self.trial, &self.ages[..]);
        let (wanted, counts) = match trial.restarts {
            Some(count) => {
                let all = Counts::all(ages, count);
                (all.clone(), all)
            }
            None => {
                let wanted =
                    needed(pilot, self.session.shot.size, trial.delta)?.at_most(trial.most);
                let share = if trial.confirm { 0.2 } else { 1.0 };
                (wanted.clone(), wanted.within(ages, share * frames_left))
            }
        };
        // Where time is so short that the first stage would rarely pass, the second gets all of it.
        let frames = |counts: &Counts| counts.frames(ages) as f64;
        let screen = !trial.confirm || frames(&counts) >= 0.5 * frames(&wanted);
        let share = if screen { 0.8 } else { 1.0 };
        let more = wanted.times(4).within(ages, share * frames_left);
        let first = screen.then_some((SeedUse::Restart, counts));
        Ok(first.into_iter().chain([(SeedUse::SecondStage, more)]).collect())
    }
}

/// Restarts after which every part is as certain as [`RESTART_ERROR`] demands. The pilot's own
/// means say what the margins are shares of, so that this can be asked before there is a reference.
fn needed(pilot: &[Restarts], [width, height]: [u32; 2], delta: f64) -> Result<Counts> {
    let tolerance = Tolerance::of(delta);
    let mut wanted = Vec::new();
    for restarts in pilot {
        let mean = restarts.mean_picture();
        let truth = stats::Truth::exact(width as usize, height as usize, mean)?;
        let mut most: f64 = 0.0;
        for part in restarts.parts(&truth, &tolerance)? {
            let error = part.test.standard_error / (RESTART_ERROR * part.delta * part.scale);
            // A black part has no error and no scale.
            if error.is_finite() {
                most = most.max(error * error);
            }
        }
        wanted.push((restarts.count() as f64 * most).ceil().min(1e9) as u32);
    }
    Ok(Counts::wanted(wanted))
}
