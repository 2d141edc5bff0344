//! A technique rung by rung, so that the first rung that fails names the part that is wrong.
//!
//! A rung is parameters and a motion. Still rungs stand on still scenes, moving ones on scenes in
//! which only the named thing moves ([`super::moving`]); every frame that is judged has a reference
//! of its own time. References are shared between rungs.
//!
//! With a folder to keep work in ([`Trial::keep`]) a ladder may be interrupted at any time. How
//! many restarts a rung has follows from its pilot alone, never from the time that there is: a rung
//! is judged when it has them, in whichever run that is, and what was judged stays.

mod kept;

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::kept::Until;
use super::moving::{Slide, only};
use super::session::Session;
use super::trial::{ReferencePool, StageOutcome, Trial, TrialOutcome, TrialPlan};
use crate::plan::Claim;
use crate::stats::{Part, Verdict};
use crate::techniques::{Entry, Moving, Rung, Technique};
use crate::{Error, Result};

/// Share of a rung's time that its references may take where the ladder's time is limited; what
/// they leave is for restarts.
const REFERENCE_SHARE: f64 = 0.3;

/// The most restarts that a pilot may choose for a rung that claims a bias: it cannot fail, and how
/// small its bias is need not be known as well as that there is none.
const BIASED_MOST: u32 = 4096;

/// How a technique is tested rung by rung.
#[derive(Clone, Debug, Default)]
pub struct Ladder {
    /// Only the rung of this name, or rungs whose name contains it; `still`: all without motion.
    pub rungs: Option<String>,
    /// Minutes that all rungs may take. Where no work is kept they get as many restarts as fit.
    /// Where it is, rungs that are not decided get the time in order of what they need, the
    /// cheapest first, so that as many as possible are decided; the rest stays open, and goes on in
    /// the next run.
    pub minutes: Option<f64>,
    /// How each rung is tested. Its time and number are the ladder's, and only a claim of no bias
    /// is confirmed by a second stage.
    pub trial: Trial,
}

/// A rung on a scene that is not judged yet, and what it is going to cost.
#[derive(Clone, Debug)]
pub struct PlannedRung {
    /// The rung's name.
    pub rung: &'static str,
    /// The technique's specification on this rung.
    pub technique: String,
    /// The scene as it was given.
    pub scene: String,
    /// The rung's number in the whole ladder.
    pub number: u32,
    /// Restarts and time of the stage that is next; `None` where there was no time for the pilot.
    pub cost: Option<TrialPlan>,
}

/// Scenes that a ladder stands on. Each rung is run on all of one list.
#[derive(Clone, Copy, Debug)]
pub struct LadderScenes<'a> {
    /// For rungs without motion.
    pub still: &'a [Session],
    /// For rungs with motion, which is made where a scene stands still.
    pub moving: &'a [Session],
}

/// What a ladder found.
#[derive(Debug)]
pub struct LadderOutcome {
    /// The rungs that were run, in order.
    pub rows: Vec<LadderRow>,
    /// Rungs that there was no time for.
    pub open: Vec<PlannedRung>,
    /// Whether the host stopped the ladder before its last rung.
    pub interrupted: bool,
}

/// A rung on a scene, as it was found.
#[derive(Clone, Debug, PartialEq)]
pub struct LadderRow {
    /// The rung's name.
    pub rung: &'static str,
    /// The technique's specification on this rung.
    pub technique: String,
    /// The scene as it was given.
    pub scene: String,
    /// What the technique promises there.
    pub claim: Claim,
    /// Frames that were judged.
    pub ages: Vec<u32>,
    /// What was measured, whatever was claimed.
    pub verdict: Verdict,
    /// The image's quantity whose interval reaches farthest, with its age.
    pub worst_image: Option<(u32, Part)>,
    /// The same of the tiles.
    pub worst_tile: Option<(u32, Part)>,
    /// Confidence of the intervals.
    pub confidence: f64,
    /// Restarts that were judged at the first and at the last age.
    pub restarts: [u64; 2],
    /// The rung's number in the whole ladder, whatever part of it was run: what its seeds derive
    /// from.
    pub number: u32,
    /// The stage that decided: 1 or 2.
    pub stage: u32,
}

impl LadderRow {
    fn new(task: &Task<'_>, ages: Vec<u32>, outcome: TrialOutcome) -> Self {
        let judged = outcome.last();
        let worst = |image: bool| judged.worst(image).map(|(frames, part)| (frames, *part));
        Self {
            rung: task.rung.name,
            scene: task.session.scene.clone(),
            ages,
            verdict: judged.verdict,
            worst_image: worst(true),
            worst_tile: worst(false),
            confidence: judged.confidence(),
            restarts: counts(judged),
            number: task.number,
            stage: judged.stage,
            technique: outcome.plan.technique,
            claim: outcome.plan.claim,
        }
    }

    /// Whether a technique that claims to be unbiased was found biased.
    #[must_use]
    pub fn failed(&self) -> bool {
        self.claim == Claim::Unbiased && self.verdict == Verdict::Fail
    }
}

/// Restarts that were judged at the first and at the last age.
fn counts(judged: &StageOutcome) -> [u64; 2] {
    let ends = [judged.ages.first(), judged.ages.last()];
    ends.map(|age| age.map_or(0, |age| age.restarts.count()))
}

/// A rung on a scene, before it is run.
struct Task<'a> {
    number: u32,
    rung: &'static Rung,
    technique: Arc<dyn Technique>,
    session: &'a Session,
}

impl Task<'_> {
    /// The rung before anything is known of its cost.
    fn planned(&self) -> PlannedRung {
        PlannedRung {
            rung: self.rung.name,
            technique: self.technique.spec(),
            scene: self.session.scene.clone(),
            number: self.number,
            cost: None,
        }
    }

    /// The scene with the rung's motion, over as many frames as the longest trial has.
    fn moved(&self, longest_age: u32) -> Result<Session> {
        let seconds = longest_age.max(2) as f32 / self.session.shot.fps as f32;
        let scene = self.session.stage.scene();
        self.session.with_scene(only(scene, self.rung.moving, Slide::Rung(seconds))?)
    }
}

impl Ladder {
    /// Path segments that a technique's rungs are usually run with: 2 where only direct light is
    /// its own, since everything longer would hide it behind noise; `None`: the scene's.
    #[must_use]
    pub fn depth(entry: &Entry) -> Option<u32> {
        entry.direct.then_some(2)
    }

    /// Runs the rungs of a technique, registered or not, whose own parameters are `keys`
    /// (`key=value,key=value`); `each` gets every row as soon as it is found. A host that stops the
    /// ladder gets the rows that were found.
    ///
    /// # Errors
    /// A specification that some rung's parameters contradict, and no rung of the wanted name,
    /// before any work; whatever a trial refuses.
    pub fn run(
        &self,
        entry: &Entry,
        keys: &str,
        scenes: LadderScenes<'_>,
        mut each: impl FnMut(&LadderRow),
    ) -> Result<LadderOutcome> {
        if self.trial.reference.file.is_some() {
            return Err(Error::usage(
                "a reference file is one picture, but a ladder has many scenes: leave out either",
            ));
        }
        let tasks = self.tasks(entry, keys, scenes)?;
        if self.trial.keep.is_some() {
            return self.begun(&tasks)?.run_kept(&tasks, each);
        }
        let begin = Instant::now();
        let progress = tasks[0].session.host().begin("ladder", tasks.len() as u64);
        let mut pool = ReferencePool::default();
        let mut rows = Vec::new();
        for (done, task) in tasks.iter().enumerate() {
            progress.say(&format!("{} on {}", task.rung.name, task.session.scene));
            let left = self.minutes.map(|m| (60.0 * m - begin.elapsed().as_secs_f64()).max(0.0));
            let seconds = left.map_or(f64::INFINITY, |left| allowance(left, tasks.len() - done));
            match self.rung(task, seconds, &mut pool) {
                Ok(row) => {
                    each(&row);
                    rows.push(row);
                }
                Err(error) if error.is_interrupted() => {
                    return Ok(LadderOutcome { rows, open: Vec::new(), interrupted: true });
                }
                Err(error) => return Err(error),
            }
            progress.step();
        }
        Ok(LadderOutcome { rows, open: Vec::new(), interrupted: false })
    }

    /// The cost of each rung that is not decided, estimated by a pilot. Nothing is judged.
    ///
    /// # Errors
    /// Those of [`Ladder::run`], and an interruption.
    pub fn plan(
        &self,
        entry: &Entry,
        keys: &str,
        scenes: LadderScenes<'_>,
        mut each: impl FnMut(&PlannedRung),
    ) -> Result<Vec<PlannedRung>> {
        let tasks = self.tasks(entry, keys, scenes)?;
        let ladder = self.begun(&tasks)?;
        let progress = tasks[0].session.host().begin("pilots", tasks.len() as u64);
        let mut planned = Vec::new();
        for task in &tasks {
            progress.say(&format!("{} on {}", task.rung.name, task.session.scene));
            let session = task.moved(ladder.trial.ages.longest())?;
            if ladder.kept_row(task, &session)?.is_none() {
                let rung = ladder.planned(task, &session)?;
                each(&rung);
                planned.push(rung);
            }
            progress.step();
        }
        Ok(planned)
    }

    /// The ladder that goes on with what is kept; where all shall be fresh, that is forgotten
    /// first.
    fn begun(&self, tasks: &[Task<'_>]) -> Result<Self> {
        let mut ladder = self.clone();
        if let Some(keep) = ladder.trial.keep.as_mut().filter(|keep| keep.fresh) {
            keep.fresh = false;
            for task in tasks {
                let session = task.moved(self.trial.ages.longest())?;
                self.forget_row(task, &session)?;
                self.rung_trial(task, &session, 0.0).forget(&session, &task.technique)?;
            }
        }
        Ok(ladder)
    }

    /// Rungs whose work is kept: the decided ones as they are, then the others, as far as the time
    /// reaches.
    fn run_kept(
        &self,
        tasks: &[Task<'_>],
        mut each: impl FnMut(&LadderRow),
    ) -> Result<LadderOutcome> {
        let host = tasks[0].session.host();
        let progress = host.begin("ladder", tasks.len() as u64);
        let end = self.minutes.map(|m| Instant::now() + Duration::from_secs_f64(60.0 * m.min(1e6)));
        let mut outcome = LadderOutcome { rows: Vec::new(), open: Vec::new(), interrupted: false };
        let mut undecided = Vec::new();
        for task in tasks {
            let mut session = task.moved(self.trial.ages.longest())?;
            if let Some(row) = self.kept_row(task, &session)? {
                each(&row);
                outcome.rows.push(row);
                progress.step();
                continue;
            }
            if let Some(end) = end {
                session = session.heard_by(|host| Arc::new(Until::new(host, end)));
            }
            undecided.push((task, session, None));
        }

        // Where time is short, pilots say which rungs it decides most of.
        let mut stopped = None;
        if end.is_some() {
            for (task, session, cost) in &mut undecided {
                progress.say(&format!("pilot of {} on {}", task.rung.name, session.scene));
                match self.planned(task, session) {
                    Ok(planned) => *cost = planned.cost,
                    Err(error) => {
                        stopped = Some(error);
                        break;
                    }
                }
            }
            let seconds = |cost: &Option<TrialPlan>| cost.as_ref().map_or(f64::MAX, |c| c.seconds);
            undecided.sort_by(|a, b| seconds(&a.2).total_cmp(&seconds(&b.2)));
        }
        let mut pool = ReferencePool::default();
        for (task, session, cost) in undecided {
            progress.say(&format!("{} on {}", task.rung.name, session.scene));
            let found = match stopped.take() {
                Some(error) => Err(error),
                None => self.rung_on(task, &session, f64::INFINITY, &mut pool),
            };
            match found {
                Ok(row) => {
                    self.keep_row(task, &session, &row)?;
                    each(&row);
                    outcome.rows.push(row);
                    progress.step();
                }
                Err(error) if error.is_interrupted() => {
                    outcome.interrupted |= task.session.host().stopped();
                    let planned = PlannedRung { cost: cost.clone(), ..task.planned() };
                    // The restarts of this stage are on disk by now.
                    let now = cost.and_then(|_| self.planned(task, &session).ok());
                    outcome.open.push(now.unwrap_or(planned));
                    stopped = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        outcome.rows.sort_by_key(|row| row.number);
        outcome.open.sort_by_key(|rung| rung.number);
        Ok(outcome)
    }

    /// Estimates the cost of a rung.
    fn planned(&self, task: &Task<'_>, session: &Session) -> Result<PlannedRung> {
        let trial = self.rung_trial(task, session, f64::INFINITY);
        Ok(PlannedRung { cost: Some(trial.plan(session, &task.technique)?), ..task.planned() })
    }

    /// Runs one rung within `seconds`.
    fn rung(&self, task: &Task<'_>, seconds: f64, pool: &mut ReferencePool) -> Result<LadderRow> {
        self.rung_on(task, &task.moved(self.trial.ages.longest())?, seconds, pool)
    }

    /// The trial of a rung.
    fn rung_trial(&self, task: &Task<'_>, session: &Session, seconds: f64) -> Trial {
        let unbiased = session.plan(&*task.technique).claim == Claim::Unbiased;
        Trial {
            seconds,
            all_in: true,
            confirm: unbiased,
            most: if unbiased { self.trial.most } else { self.trial.most.min(BIASED_MOST) },
            number: task.number,
            ..self.trial.clone()
        }
    }

    /// Runs one rung on the scene with its motion.
    fn rung_on(
        &self,
        task: &Task<'_>,
        session: &Session,
        seconds: f64,
        pool: &mut ReferencePool,
    ) -> Result<LadderRow> {
        let ages = self.trial.ages.of(session, &*task.technique);
        let mut trial = self.rung_trial(task, session, seconds);
        // A reference serves later rungs too, so its time counts for all of them; its remaining
        // noise is part of every interval.
        let share = REFERENCE_SHARE * seconds / ages.len() as f64;
        trial.reference.seconds = trial.reference.seconds.min(share.max(1.0));
        let outcome = trial.run(session, &task.technique, pool, |_, _| Ok(()))?;
        Ok(LadderRow::new(task, ages, outcome))
    }

    /// Every wanted rung on every scene; wrong specifications are found before any work.
    fn tasks<'a>(
        &self,
        entry: &Entry,
        keys: &str,
        scenes: LadderScenes<'a>,
    ) -> Result<Vec<Task<'a>>> {
        // A message about the given parameters shall not be one about a rung's.
        entry.parse(keys)?;
        let ladder = entry.ladder();
        let wanted =
            |rung: &Rung| self.rungs.as_ref().is_none_or(|text| is_wanted(rung, text, ladder));
        let mut tasks = Vec::new();
        let mut number = 0;
        for rung in ladder {
            let technique: Arc<dyn Technique> = entry.parse(&merged(keys, rung.keys))?.into();
            let sessions = if rung.moving == Moving::Still { scenes.still } else { scenes.moving };
            for session in sessions {
                tasks.push(Task { number, rung, technique: technique.clone(), session });
                number += 1;
            }
        }
        tasks.retain(|task| wanted(task.rung));
        if tasks.is_empty() {
            let names: Vec<&str> = ladder.iter().map(|rung| rung.name).collect();
            let text = self.rungs.as_deref().unwrap_or_default();
            return Err(Error::usage(format!(
                "no rung's name contains `{text}`; known: {}; and `still` for all without motion",
                names.join("; ")
            )));
        }
        Ok(tasks)
    }
}

/// Seconds for the next of `tasks`, so that easy ones leave time to hard ones and all together keep
/// within `left`.
fn allowance(left: f64, tasks: usize) -> f64 {
    left * (2.0 / tasks as f64).min(1.0)
}

/// Whether `text` names a rung of a ladder: wholly, where one has just that name, else in part.
fn is_wanted(rung: &Rung, text: &str, ladder: &[Rung]) -> bool {
    let named = ladder.iter().any(|rung| rung.name == text);
    let still = text == "still" && rung.moving == Moving::Still;
    if named { rung.name == text } else { rung.name.contains(text) || still }
}

/// A technique's parameters with a rung's in place of its own.
fn merged(own: &str, rung: &str) -> String {
    fn pairs(text: &str) -> impl Iterator<Item = &str> {
        text.split(',').filter(|pair| !pair.is_empty())
    }
    fn key(pair: &str) -> &str {
        pair.split('=').next().unwrap_or_default()
    }
    let kept = pairs(own).filter(|pair| pairs(rung).all(|other| key(other) != key(pair)));
    kept.chain(pairs(rung)).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::techniques::{REGISTRY, find};

    fn ladder(spec: &str) -> &'static [Rung] {
        find(REGISTRY, spec).unwrap().0.ladder()
    }

    #[test]
    fn a_rungs_parameters_win() {
        assert_eq!(merged("", ""), "");
        assert_eq!(merged("", "x=1"), "x=1");
        assert_eq!(merged("y=2,x=3", "x=1,z=4"), "y=2,x=1,z=4");
        assert_eq!(merged("y=2", ""), "y=2");
    }

    #[test]
    fn every_rung_of_a_registered_technique_parses_and_has_a_name_of_its_own() {
        for entry in REGISTRY {
            let ladder = entry.ladder();
            for (at, rung) in ladder.iter().enumerate() {
                assert!(ladder[..at].iter().all(|other| other.name != rung.name), "{}", rung.name);
                entry.parse(rung.keys).unwrap();
            }
        }
        assert_eq!(ladder("nee").len(), 5);
        assert!(ladder("restir-di").len() > 15);
    }

    #[test]
    fn a_rungs_whole_name_means_it_alone() {
        let asked = |text: &str| -> Vec<&str> {
            let ladder = ladder("restir-di");
            let wanted = ladder.iter().filter(|rung| is_wanted(rung, text, ladder));
            wanted.map(|rung| rung.name).collect()
        };
        assert_eq!(asked("mutations"), ["mutations"]);
        assert_eq!(asked("mutation"), ["mutations", "moving, mutations"]);
        assert!(asked("moving").len() > 3 && asked("still").len() > 10);
    }

    #[test]
    fn allowances_never_exceed_what_is_left() {
        let mut left = 100.0;
        for tasks in (1..=40).rev() {
            let seconds = allowance(left, tasks);
            assert!(seconds > 0.0 || left == 0.0);
            left -= seconds;
            assert!(left >= 0.0, "{left}");
        }
    }
}
