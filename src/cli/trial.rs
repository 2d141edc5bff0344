//! One technique on one scene against a reference: how many restarts, two stages, a verdict.
//!
//! 1. A pilot of [`PILOT`] restarts says how long a frame takes and how much the means vary; where time allows, a longer one, up to
//!    [`LONG_PILOT`], says it better. From that follows how many restarts the first stage needs at each age: young frames vary most and cost
//!    least, so most restarts end early. Pilots are never tested, so this choice costs nothing of any α.
//! 2. First stage. All parts ([`crate::stats::agreement`]) of all ages are judged together. A pass ends the trial.
//! 3. Otherwise the second stage decides: fresh seeds, four times as many restarts. It comes first where time allows less than half of what
//!    the first stage needs.
//!
//! Levels: a wrong picture has two chances to pass, so each stage tests equivalence at α/2 = 5·10⁻⁴. Nothing fails but by the second
//! stage at 10⁻⁴ (Holm), whatever the first one said: both share the reference's error, so their levels must not be multiplied.

use std::sync::Arc;
use std::time::Instant;

use rayon::prelude::*;

use super::args::ReferenceArgs;
use super::engine::{self, Engine};
use super::progress::Progress;
use super::reference::{self, Made};
use super::seeds::{Part as Seeds, seed};
use super::{bias, note};
use crate::Result;
use crate::frame::FrameLoop;
use crate::picture::Picture;
use crate::plan::Plan;
use crate::report::{CacheKey, Reference};
use crate::stats::{self, Part, Place, Quantity, Restarts, Tolerance, Verdict, agreement};
use crate::techniques::Technique;

/// Restarts of the pilots, at least and at most: rare bright ones say most of how much the means vary.
const PILOT: u32 = 8;
const LONG_PILOT: u32 = 64;
/// Of a trial's time, what the long pilot may take.
const PILOT_SHARE: f64 = 0.05;
/// Pixels up to which each thread renders restarts of its own. Threads that share a frame wait for each other after every pass: with 64 × 64 pixels
/// two of them made a seventh fewer restarts than on their own; larger pictures have tasks enough, and a loop a thread would fill the caches.
const PIXELS_APART: usize = 1 << 15;
/// Bytes of pictures that may wait to be counted.
const WAITING: usize = 1 << 26;
/// Fewer restarts leave Student's quantiles wide, and a skewness unseen that would shift them.
const FEWEST: u32 = 64;
/// Level at which the first stage calls a difference certain, which only the second may confirm.
const SCREEN_ALPHA: f64 = 1e-2;
/// The reference's standard error of any part, in margins.
const REFERENCE_ERROR: f64 = 0.1;
/// Standard error of a part over restarts that passes almost surely, in margins: with the reference's 0.1 the margin is then 6.3
/// standard errors, of which the test at 5·10⁻⁴ takes 3.3.
const RESTART_ERROR: f64 = 0.12;

/// How a trial is run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Settings<'a> {
    /// Frames after the cold start that are judged, rising.
    pub ages: &'a [u32],
    /// Estimates a pixel and frame.
    pub effort: u32,
    /// δ of the image.
    pub delta: f64,
    /// Restarts of the first stage; by the pilot where none.
    pub restarts: Option<u32>,
    /// Most restarts that the pilot may ask for.
    pub most: u32,
    /// Seconds that restarts may take in all, as the pilot's clock says.
    pub seconds: f64,
    /// Whether these are for pilots and references, too.
    pub all_in: bool,
    /// Whether a second stage follows a first one that is no pass.
    pub confirm: bool,
    /// Seed of the run.
    pub run: u64,
    /// Number of the trial in its run: no two share a seed.
    pub number: u32,
    /// Technique of the reference.
    pub against: &'a str,
    /// Where references come from.
    pub reference: &'a ReferenceArgs,
}

impl Settings<'_> {
    /// The last frame that is judged.
    fn longest(&self) -> u32 {
        self.ages.last().copied().unwrap_or(1)
    }
}

/// References that trials of one run share.
#[derive(Debug, Default)]
pub(super) struct References {
    known: Vec<(CacheKey, Arc<Made>)>,
}

impl References {
    /// The reference for `engine`, whose every part is to be known to [`REFERENCE_ERROR`]. `like` has the parts.
    fn obtain(
        &mut self,
        engine: &Engine,
        settings: &Settings<'_>,
        like: &Restarts,
    ) -> Result<Arc<Made>> {
        let key = engine.key(settings.against);
        if let Some((_, made)) = self.known.iter().find(|(known, _)| *known == key) {
            return Ok(made.clone());
        }
        let tolerance = Tolerance::of(settings.delta);
        // A first guess from the image as a whole; a black one sets no target.
        let error = REFERENCE_ERROR * settings.delta * like.luminance().mean();
        let mut variance = error * error * engine.shot.pixels() as f64;
        if variance.is_nan() || variance <= 0.0 {
            variance = f64::INFINITY;
        }
        let mut args = settings.reference.clone();
        let begin = Instant::now();
        let mut made = reference::obtain(engine, &args, settings.against, variance)?;
        // Dark tiles may need more, and then all of the picture gets it.
        for _ in 0..3 {
            let error = reference_error(like, &made.reference, &tolerance)? / REFERENCE_ERROR;
            args.reference_time = settings.reference.reference_time - begin.elapsed().as_secs_f64();
            let Some(now) = made.reference.variance() else { break };
            if error < 1.1 || args.reference_time < 0.5 {
                break;
            }
            made = reference::obtain(engine, &args, settings.against, now / (error * error))?;
        }
        let made = Arc::new(made);
        self.known.push((key, made.clone()));
        Ok(made)
    }
}

/// The largest standard error of a part that the reference alone causes, in margins.
fn reference_error(like: &Restarts, reference: &Reference, tolerance: &Tolerance) -> Result<f64> {
    let with = like.parts(&bias::truth(reference)?, tolerance)?;
    let without = like.parts(&bias::exact(reference)?, tolerance)?;
    Ok(with
        .iter()
        .zip(&without)
        .map(|(with, without)| {
            let square = with.test.standard_error.powi(2) - without.test.standard_error.powi(2);
            square.max(0.0).sqrt() / (with.delta * with.scale)
        })
        .filter(|error| error.is_finite())
        .fold(0.0, f64::max))
}

/// One age of one stage.
#[derive(Debug)]
pub(super) struct Age {
    /// Frames since the cold start.
    pub frames: u32,
    pub restarts: Restarts,
    pub parts: Vec<Part>,
    pub verdicts: Vec<Verdict>,
}

impl Age {
    pub(super) fn verdict(&self) -> Verdict {
        self.verdicts.iter().copied().fold(Verdict::Pass, Verdict::and)
    }

    /// Luminance of the image.
    pub(super) fn image(&self) -> &Part {
        &self.parts[0]
    }

    /// Tiles in which any quantity fails.
    pub(super) fn tiles_failed(&self) -> usize {
        let mut tiles: Vec<Place> = self
            .parts
            .iter()
            .zip(&self.verdicts)
            .filter(|(part, verdict)| part.place != Place::Image && **verdict == Verdict::Fail)
            .map(|(part, _)| part.place)
            .collect();
        tiles.dedup();
        tiles.len()
    }
}

/// Restarts that were judged.
#[derive(Debug)]
pub(super) struct Judged {
    /// 1 or 2: which seeds these are.
    pub stage: u32,
    pub ages: Vec<Age>,
    pub verdict: Verdict,
    /// That each part was tested at.
    pub tolerance: Tolerance,
}

impl Judged {
    /// Confidence of the interval that a pass places inside the margins.
    pub(super) fn confidence(&self) -> f64 {
        1.0 - 2.0 * self.tolerance.equivalence_alpha
    }

    /// The part whose interval reaches farthest, of the image or of the tiles, with its age.
    pub(super) fn worst(&self, image: bool) -> Option<(u32, &Part)> {
        let confidence = self.confidence();
        self.ages
            .iter()
            .flat_map(|age| age.parts.iter().map(move |part| (age.frames, part)))
            .filter(|(_, part)| (part.place == Place::Image) == image)
            .max_by(|(_, a), (_, b)| a.reach(confidence).total_cmp(&b.reach(confidence)))
    }
}

/// A trial with all its stages.
#[derive(Debug)]
pub(super) struct Outcome {
    pub plan: Plan,
    /// The first, the second, or both.
    pub stages: Vec<Judged>,
}

impl Outcome {
    /// The stage that decided.
    pub(super) fn last(&self) -> &Judged {
        &self.stages[self.stages.len() - 1]
    }
}

/// Runs a trial; `shown` gets every stage as soon as it is judged.
pub(super) fn run(
    engine: &Engine,
    technique: &Arc<dyn Technique>,
    settings: &Settings<'_>,
    references: &mut References,
    mut shown: impl FnMut(&Judged, &[Arc<Made>]) -> Result<()>,
) -> Result<Outcome> {
    let plan = engine.plan(&**technique);
    let begin = Instant::now();
    let (mut found, mut a_frame) = pilot(engine, technique, settings, PILOT)?;
    let length = long_pilot(settings, a_frame);
    if length >= 2 * PILOT {
        (found, a_frame) = pilot(engine, technique, settings, length)?;
    }

    let moving = engine.stage.facts().moves();
    let made = settings.ages[..if moving { settings.ages.len() } else { 1 }]
        .iter()
        .zip(&found)
        .map(|(&age, like)| references.obtain(&engine.frozen(age - 1)?, settings, like))
        .collect::<Result<Vec<_>>>()?;
    let of_age = |at: usize| &made[at.min(made.len() - 1)].reference;

    let spent = if settings.all_in { begin.elapsed().as_secs_f64() } else { 0.0 };
    let affordable = |share: f64| share * (settings.seconds - spent).max(0.0) / a_frame;
    let (wanted, counts) = match settings.restarts {
        Some(count) => {
            let all = Counts::all(settings.ages, count);
            (all.clone(), all)
        }
        None => {
            let wanted = needed(&found, of_age, settings)?.at_most(settings.most);
            let share = if settings.confirm { 0.2 } else { 1.0 };
            (wanted.clone(), wanted.within(settings.ages, affordable(share)))
        }
    };
    // Where time is so short that the first stage would rarely pass, the second gets all of it.
    let frames = |counts: &Counts| counts.frames(settings.ages) as f64;
    let screen = !settings.confirm || frames(&counts) >= 0.5 * frames(&wanted);
    let more = wanted.times(4).within(settings.ages, affordable(if screen { 0.8 } else { 1.0 }));
    let mut stages = Vec::new();
    for (part, counts, difference_alpha) in
        [(Seeds::Restart, &counts, SCREEN_ALPHA), (Seeds::SecondStage, &more, 1e-4)]
            .into_iter()
            .skip(usize::from(!screen))
    {
        let tolerance = Tolerance::of(settings.delta);
        let tolerance = Tolerance {
            equivalence_alpha: 0.5 * tolerance.equivalence_alpha,
            difference_alpha,
            ..tolerance
        };
        let found = restarts(engine, technique, settings, part, counts)?;
        let stage = if part == Seeds::Restart { 1 } else { 2 };
        let judged = Judged { stage, ..judge(found, settings.ages, of_age, tolerance)? };
        shown(&judged, &made)?;
        let passed = judged.verdict == Verdict::Pass;
        stages.push(judged);
        if passed || !settings.confirm {
            break;
        }
    }
    Ok(Outcome { plan, stages })
}

/// Restarts for which [`PILOT_SHARE`] of the time is enough, at most [`LONG_PILOT`]; none where their number is given.
fn long_pilot(settings: &Settings<'_>, a_frame: f64) -> u32 {
    if settings.restarts.is_some() {
        return 0;
    }
    let length = PILOT_SHARE * settings.seconds / (a_frame * f64::from(settings.longest()));
    (length as u32).min(LONG_PILOT)
}

/// A pilot with `count` restarts, and the seconds that a frame took.
fn pilot(
    engine: &Engine,
    technique: &Arc<dyn Technique>,
    settings: &Settings<'_>,
    count: u32,
) -> Result<(Vec<Restarts>, f64)> {
    let begin = Instant::now();
    let counts = Counts::all(settings.ages, count);
    let found = restarts(engine, technique, settings, Seeds::Pilot, &counts)?;
    Ok((found, begin.elapsed().as_secs_f64() / counts.frames(settings.ages) as f64))
}

/// Restarts that reach each age: never more than reach the one before.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Counts(Vec<u32>);

impl Counts {
    /// All of `count` restarts reach the last age.
    fn all(ages: &[u32], count: u32) -> Self {
        Self(vec![count; ages.len()])
    }

    /// As many as each age asks for; who reaches an age has been at those before.
    fn wanted(mut wanted: Vec<u32>) -> Self {
        let mut later = FEWEST;
        for count in wanted.iter_mut().rev() {
            *count = (*count).max(later);
            later = *count;
        }
        Self(wanted)
    }

    fn at_most(mut self, most: u32) -> Self {
        self.0.iter_mut().for_each(|count| *count = (*count).min(most.max(FEWEST)));
        self
    }

    fn times(&self, factor: u32) -> Self {
        Self(self.0.iter().map(|count| count.saturating_mul(factor)).collect())
    }

    /// How many ages the restart of this number reaches.
    fn reached(&self, index: u32) -> usize {
        self.0.iter().take_while(|count| index < **count).count()
    }

    /// Frames to render in all.
    fn frames(&self, ages: &[u32]) -> u64 {
        let next = self.0[1..].iter().chain(&[0]);
        let ending = self.0.iter().zip(next).map(|(here, next)| here - next);
        ending.zip(ages).map(|(count, &age)| u64::from(count) * u64::from(age)).sum()
    }

    /// Fewer of all, but never fewer than [`FEWEST`], so that about `frames` frames are rendered.
    fn within(self, ages: &[u32], frames: f64) -> Self {
        let share = (frames / self.frames(ages) as f64).min(1.0);
        let fewer = |count: u32| ((share * f64::from(count)) as u32).max(FEWEST.min(count));
        Self(self.0.into_iter().map(fewer).collect())
    }
}

/// Independent restarts, looked at at every age that they reach. They are counted in the order of their numbers, so that sums are the same
/// for any number of threads.
fn restarts(
    engine: &Engine,
    technique: &Arc<dyn Technique>,
    settings: &Settings<'_>,
    part: Seeds,
    counts: &Counts,
) -> Result<Vec<Restarts>> {
    let total = counts.0[0];
    let mut found = Vec::new();
    for _ in settings.ages {
        found.push(bias::restarts(engine.shot.size)?);
    }
    let progress = Progress::new("restarts", u64::from(total));
    progress.say(&technique.spec());
    let pixels = engine.shot.pixels();
    let apart = engine.device().is_none() && pixels <= PIXELS_APART;
    let threads = if apart { rayon::current_num_threads().min(total as usize) } else { 1 };
    let mut loops = Vec::new();
    for _ in 0..threads.max(1) {
        loops.push(engine.start(technique, settings.effort, 0)?);
    }
    let waiting = loops.len() * settings.ages.len() * pixels * size_of::<glam::Vec3>();
    let each = if loops.len() == 1 { 1 } else { (WAITING / waiting).clamp(1, 8) };
    let mut next = 0;
    let stride = loops.len();
    while next < total {
        let batch = next..total.min(next + (each * stride) as u32);
        // Restart i belongs to loop i modulo their number: fewer and fewer reach the later ages, so neighbours take the same time.
        let rendered = loops
            .par_iter_mut()
            .enumerate()
            .map(|(at, frames)| {
                let own = batch.clone().skip(at).step_by(stride);
                own.map(|index| {
                    frames.restart(seed(settings.run, part, settings.number, index));
                    pictures_at(frames, &settings.ages[..counts.reached(index)])
                })
                .collect()
            })
            .collect::<Result<Vec<Vec<_>>>>()?;
        for index in 0..batch.len() {
            let pictures = &rendered[index % stride][index / stride];
            for (restarts, picture) in found.iter_mut().zip(pictures) {
                restarts.push(&picture.pixels)?;
            }
            progress.step();
        }
        next = batch.end;
    }
    let bad: u64 = found.iter().map(Restarts::not_finite).sum();
    if bad > 0 {
        note(&format!("warning: {bad} pixels of `{}` are not finite", technique.spec()));
    }
    Ok(found)
}

/// The pictures of a restart at `ages`.
fn pictures_at(frames: &mut FrameLoop, ages: &[u32]) -> Result<Vec<Picture>> {
    let mut done = 0;
    ages.iter()
        .map(|&age| {
            while done + 1 < age {
                engine::next(frames)?;
                done += 1;
            }
            done += 1;
            Ok(engine::next(frames)?.picture())
        })
        .collect()
}

/// Restarts after which every part is as certain as [`RESTART_ERROR`] asks for.
fn needed<'a>(
    pilot: &[Restarts],
    of_age: impl Fn(usize) -> &'a Reference,
    settings: &Settings<'_>,
) -> Result<Counts> {
    let tolerance = Tolerance::of(settings.delta);
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

/// Judges all ages together.
fn judge<'a>(
    found: Vec<Restarts>,
    frames: &[u32],
    of_age: impl Fn(usize) -> &'a Reference,
    tolerance: Tolerance,
) -> Result<Judged> {
    let mut ages = Vec::new();
    for (at, (restarts, &frames)) in found.into_iter().zip(frames).enumerate() {
        let parts = restarts.parts(&bias::truth(of_age(at))?, &tolerance)?;
        ages.push(Age { frames, restarts, parts, verdicts: Vec::new() });
    }
    let all: Vec<Part> = ages.iter().flat_map(|age| age.parts.iter().copied()).collect();
    let stats::Agreement { verdict, parts } = agreement(&all, &tolerance);
    let mut verdicts = parts.into_iter();
    for age in &mut ages {
        age.verdicts = verdicts.by_ref().take(age.parts.len()).collect();
    }
    Ok(Judged { stage: 1, ages, verdict, tolerance })
}

/// A part's bias with its interval, in percent: `+0.12 [-0.03, +0.27]`.
pub(super) fn percent(part: &Part, confidence: f64) -> String {
    let (low, high) = part.relative_interval(confidence);
    format!("{:+.2} [{:+.2}, {:+.2}]", 100.0 * part.relative(), 100.0 * low, 100.0 * high)
}

/// Where, without what goes without saying: `blue`, `(16, 0)`, `blue of (16, 0)`; empty for the image's luminance.
pub(super) fn place(part: &Part) -> String {
    let quantity = match part.quantity {
        Quantity::Luminance => "",
        Quantity::Red => "red",
        Quantity::Green => "green",
        Quantity::Blue => "blue",
    };
    match part.place {
        Place::Image => quantity.to_string(),
        Place::Tile { x, y } if quantity.is_empty() => format!("({x}, {y})"),
        Place::Tile { x, y } => format!("{quantity} of ({x}, {y})"),
    }
}

#[cfg(test)]
mod tests {
    use super::super::motion::{self, Motion};
    use super::*;
    use crate::pass::{Band, FrameInputs};
    use crate::plan::Shot;
    use glam::Vec3;

    const SIZE: [u32; 2] = [16, 16];

    /// Grey pixels uniform in [0, 2) times `gain` in the upper left tile: c = 0.58, 7.2 % in a tile of 64 pixels.
    fn picture(key: u32, gain: f32) -> Picture {
        let pixels = (0..256)
            .map(|at| {
                let factor = if at % 16 < 8 && at / 16 < 8 { gain } else { 1.0 };
                let u = crate::math::rng::unit_float(crate::math::rng::pcg4d([key, at, 3, 5])[0]);
                Vec3::splat(2.0 * factor * u)
            })
            .collect();
        Picture::new(16, 16, pixels)
    }

    fn sample(count: u32, key: u32, gain: f32) -> Restarts {
        let mut restarts = bias::restarts(SIZE).unwrap();
        for at in 0..count {
            restarts.push(&picture(key + at, gain).pixels).unwrap();
        }
        restarts
    }

    fn reference() -> Reference {
        let mut reference = Reference::new(SIZE);
        for at in 0..6000 {
            reference.add(&picture(1_000_000 + at, 1.0));
        }
        reference
    }

    #[test]
    fn one_bad_age_fails_the_trial_and_is_named_the_worst() {
        // 3000 restarts: standard error of a tile 0.13 % and as much of the reference; its margin is 2 %.
        let reference = reference();
        let tolerance = Tolerance::of(0.01);
        let outcome = |gain: f32, count: u32| {
            let found = vec![sample(count, 0, 1.0), sample(count, 10_000, gain)];
            judge(found, &[1, 20], |_| &reference, tolerance).unwrap()
        };
        let good = outcome(1.0, 3000);
        assert_eq!(good.verdict, Verdict::Pass);
        assert!(good.worst(true).unwrap().1.reach(good.confidence()) < 1.0);
        assert_eq!(outcome(1.0, 8).verdict, Verdict::Inconclusive, "too few restarts");

        let bad = outcome(1.02, 3000);
        assert_eq!(bad.verdict, Verdict::Fail);
        assert_eq!((bad.ages[0].verdict(), bad.ages[1].verdict()), (Verdict::Pass, Verdict::Fail));
        assert_eq!(bad.ages[1].tiles_failed(), 1);
        let (frames, part) = bad.worst(false).unwrap();
        assert_eq!((frames, part.place), (20, Place::Tile { x: 0, y: 0 }));
        assert!((part.relative() - 0.02).abs() < 0.006, "{}", part.relative());
        assert!(place(part).ends_with("(0, 0)"), "{}", place(part));
    }

    #[test]
    fn the_pilot_asks_for_more_restarts_where_less_is_known() {
        let reference = reference();
        let args = ReferenceArgs { reference: None, reference_time: 1.0, cache: None };
        let ask = |delta: f64| {
            let settings = Settings {
                ages: &[1],
                effort: 1,
                delta,
                restarts: None,
                most: 1000,
                seconds: f64::INFINITY,
                all_in: false,
                confirm: true,
                run: 1,
                number: 0,
                against: "nee",
                reference: &args,
            };
            needed(&[sample(PILOT, 50_000, 1.0)], |_| &reference, &settings).unwrap().0[0]
        };
        // A tile varies by 7.2 % a restart: (7.2 / (0.12 · 2))² = 900, the largest of five estimates from eight restarts.
        assert!((500..4000).contains(&ask(0.01)), "{}", ask(0.01));
        let ratio = f64::from(ask(0.005)) / f64::from(ask(0.01));
        assert!((3.9..4.1).contains(&ratio), "{ratio}");
    }

    #[test]
    fn young_frames_get_more_restarts_and_the_budget_holds() {
        let ages = [1, 5, 20];
        let counts = Counts::wanted(vec![1000, 100, 10]);
        assert_eq!(counts.0, [1000, 100, FEWEST]);
        assert_eq!(Counts::wanted(vec![10, 300, 100]).0, [300, 300, 100]);
        let frames = 900 + (100 - 64) * 5 + 64 * 20;
        assert_eq!(counts.frames(&ages), frames);
        assert_eq!(Counts::all(&ages, 7).frames(&ages), 140);
        let half = counts.clone().within(&ages, 0.5 * frames as f64);
        assert_eq!(half.0, [500, FEWEST, FEWEST]);
        assert_eq!(counts.clone().within(&ages, 1e9), counts);
        assert_eq!(counts.at_most(200).0, [200, 100, FEWEST]);
    }

    /// `nee`, as if the lights were where they were a frame ago.
    #[derive(Debug)]
    struct Late(Arc<dyn Technique>);

    impl Technique for Late {
        fn spec(&self) -> String {
            "late".to_string()
        }

        fn validate(&self) -> Result<()> {
            Ok(())
        }

        fn plan(&self, facts: &crate::plan::SceneFacts, shot: &Shot) -> Plan {
            self.0.plan(facts, shot)
        }

        fn run(
            &self,
            kernel: u32,
            inputs: &FrameInputs<'_>,
            band: &mut Band<'_>,
        ) -> crate::counters::Counters {
            let world = inputs.previous.unwrap_or(inputs.world);
            self.0.run(kernel, &FrameInputs { world, ..*inputs }, band)
        }
    }

    /// Small pictures of the penumbra, whose light moves by an eighth of its side a frame.
    fn penumbra() -> Engine {
        let scene = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
        let scene = crate::scene::load::load(&scene).unwrap().scene;
        let scene = motion::only(&scene, Motion::Light, 0.2).unwrap();
        let filter = crate::plan::Filter::Point;
        let shot = Shot { size: [16, 16], depth: 2, filter, run: 1, effort: 1.0, fps: 30 };
        let stage = crate::frame::Stage::new(scene).unwrap();
        let backend = crate::frame::Backend::Cpu;
        Engine { scene: "x".into(), name: "x".into(), stage, shot, backend }
    }

    /// A trial of a technique where the light moves; δ = 5 %, ages 1 and 3, a reference for each.
    fn moving_light(technique: &Arc<dyn Technique>) -> Outcome {
        let engine = penumbra();
        let cache = std::env::temp_dir().join(format!("afterimage-trial-{}", std::process::id()));
        let args =
            ReferenceArgs { reference: None, reference_time: 4.0, cache: Some(cache.clone()) };
        let settings = Settings {
            ages: &[1, 3],
            effort: 4,
            delta: 0.05,
            restarts: None,
            most: 1000,
            seconds: f64::INFINITY,
            all_in: false,
            confirm: true,
            run: 1,
            number: 0,
            against: "nee:roulette=60",
            reference: &args,
        };
        let mut references = References::default();
        let outcome = run(&engine, technique, &settings, &mut references, |_, _| Ok(())).unwrap();
        // One a frame: they are not the same picture.
        assert_eq!(references.known.len(), 2);
        std::fs::remove_dir_all(cache).unwrap();
        outcome
    }

    #[test]
    fn a_technique_late_by_a_frame_fails_where_the_light_moves_and_the_punctual_one_passes() {
        let nee = engine::technique("nee").unwrap();
        let punctual = moving_light(&nee);
        assert_eq!(punctual.last().verdict, Verdict::Pass);
        let late: Arc<dyn Technique> = Arc::new(Late(nee));
        let late = moving_light(&late);
        assert_eq!((late.stages.len(), late.last().verdict), (2, Verdict::Fail));
        // At the cold start there is no frame before.
        assert_ne!(late.last().ages[0].verdict(), Verdict::Fail);
        assert_eq!(late.last().ages[1].verdict(), Verdict::Fail);
    }

    #[test]
    fn restarts_are_counted_alike_by_any_number_of_threads() {
        let engine = penumbra();
        let technique = engine::technique("restir-di").unwrap();
        let args = ReferenceArgs { reference: None, reference_time: 1.0, cache: None };
        let bits = |threads: usize, run: u64| -> Vec<[u64; 2]> {
            let settings = Settings {
                ages: &[1, 3],
                effort: 1,
                delta: 0.05,
                restarts: None,
                most: 1000,
                seconds: 1.0,
                all_in: false,
                confirm: true,
                run,
                number: 0,
                against: "nee",
                reference: &args,
            };
            let counts = Counts(vec![37, 21]);
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let found = pool
                .install(|| restarts(&engine, &technique, &settings, Seeds::Restart, &counts))
                .unwrap();
            assert_eq!([found[0].count(), found[1].count()], [37, 21]);
            let moments = |restarts: &Restarts| {
                let luminance = restarts.luminance();
                [luminance.mean(), luminance.variance()].map(f64::to_bits)
            };
            found.iter().map(moments).collect()
        };
        let one = bits(1, 1);
        assert!(bits(3, 1) == one && bits(64, 1) == one);
        assert_ne!(bits(3, 2), one, "other seeds must differ");
    }
}
