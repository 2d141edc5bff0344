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
mod outcome;
mod pool;
mod restarts;
#[cfg(test)]
mod tests;

use std::sync::Arc;
use std::time::Instant;

use self::counts::Counts;
use self::outcome::judge;
use super::bias;
use super::reference::{ReferenceSettings, SourcedReference};
use super::seeds::SeedUse;
use super::session::{self, Session};
use crate::Result;
use crate::report::Reference;
use crate::stats::{Restarts, Tolerance, Verdict};
use crate::techniques::Technique;

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
    /// An interruption; whatever a loop, a reference or `shown` refuses.
    pub fn run(
        &self,
        session: &Session,
        technique: &Arc<dyn Technique>,
        pool: &mut ReferencePool,
        mut shown: impl FnMut(&StageOutcome, &[Arc<SourcedReference>]) -> Result<()>,
    ) -> Result<TrialOutcome> {
        let running = Running {
            session,
            technique,
            trial: self,
            ages: self.ages.of(session, &**technique),
            against: self.against(&**technique)?,
        };
        let begin = Instant::now();
        let (mut found, mut a_frame) = running.pilot(PILOT)?;
        let length = running.long_pilot(a_frame);
        if length >= 2 * PILOT {
            (found, a_frame) = running.pilot(length)?;
        }

        let made = running.references(pool, &found)?;
        let of_age = |at: usize| &made[at.min(made.len() - 1)].reference;

        let spent = if self.all_in { begin.elapsed().as_secs_f64() } else { 0.0 };
        let frames_left = (self.seconds - spent).max(0.0) / a_frame;
        let mut stages = Vec::new();
        for (seeds, counts) in running.stages(&found, of_age, frames_left)? {
            let second = seeds == SeedUse::SecondStage;
            let tolerance = Tolerance::of(self.delta);
            let tolerance = Tolerance {
                equivalence_alpha: 0.5 * tolerance.equivalence_alpha,
                difference_alpha: if second { tolerance.difference_alpha } else { SCREEN_ALPHA },
                ..tolerance
            };
            let found = running.restarts(seeds, &counts)?;
            let stage = if second { 2 } else { 1 };
            let judged = StageOutcome { stage, ..judge(found, &running.ages, of_age, tolerance)? };
            shown(&judged, &made)?;
            let passed = judged.verdict == Verdict::Pass;
            stages.push(judged);
            if passed || !self.confirm {
                break;
            }
        }
        Ok(TrialOutcome { plan: session.plan(&**technique), stages })
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

impl Running<'_> {
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
    fn stages<'r>(
        &self,
        pilot: &[Restarts],
        of_age: impl Fn(usize) -> &'r Reference,
        frames_left: f64,
    ) -> Result<Vec<(SeedUse, Counts)>> {
        let (trial, ages) = (self.trial, &self.ages[..]);
        let (wanted, counts) = match trial.restarts {
            Some(count) => {
                let all = Counts::all(ages, count);
                (all.clone(), all)
            }
            None => {
                let wanted = needed(pilot, of_age, trial.delta)?.at_most(trial.most);
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

/// Restarts after which every part is as certain as [`RESTART_ERROR`] demands.
fn needed<'a>(
    pilot: &[Restarts],
    of_age: impl Fn(usize) -> &'a Reference,
    delta: f64,
) -> Result<Counts> {
    let tolerance = Tolerance::of(delta);
    let mut wanted = Vec::new();
    for (at, restarts) in pilot.iter().enumerate() {
        let mut most: f64 = 0.0;
        for part in restarts.parts(&bias::exact(of_age(at))?, &tolerance)? {
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
