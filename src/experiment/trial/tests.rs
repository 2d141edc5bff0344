//! Do verdicts, numbers of restarts and references of each age come out as they must?

use std::sync::Arc;

use glam::Vec3;

use super::counts::FEWEST;
use super::*;
use crate::experiment::moving::{Slide, only};
use crate::experiment::{Session, SessionSettings, bias};
use crate::pass::{Band, FrameInputs};
use crate::picture::Picture;
use crate::plan::{Plan, Shot};
use crate::report::Reference;
use crate::stats::Place;
use crate::techniques::Moving;

const SIZE: [u32; 2] = [16, 16];

/// Grey pixels uniform in [0, 2) times `gain` in the upper left tile: c = 0.58, 7.2 % in a tile of
/// 64 pixels.
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
    // 3000 restarts: standard error of a tile 0.13 % and as much of the reference; its margin is 2
    // %.
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
}

#[test]
fn the_pilot_asks_for_more_restarts_where_less_is_known() {
    let ask = |delta: f64| needed(&[sample(PILOT, 50_000, 1.0)], SIZE, delta).unwrap().0[0];
    // A tile varies by 7.2 % a restart: (7.2 / (0.12 · 2))² = 900, the largest of five estimates
    // from eight restarts.
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
fn penumbra() -> Session {
    let scene = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
    let scene = crate::scene::load::load(&scene).unwrap().scene;
    let scene = only(&scene, Moving::Light, Slide::Rung(0.2)).unwrap();
    let settings =
        SessionSettings { size: Some([16, 16]), depth: Some(2), ..SessionSettings::default() };
    Session::new(scene, &settings).unwrap()
}

/// A trial of a technique where the light moves; δ = 5 %, ages 1 and 3, a reference for each.
fn moving_light(technique: &Arc<dyn Technique>) -> TrialOutcome {
    moving_light_in(technique, "late", |trial| trial)
}

/// The same with changes, and a cache of its own.
fn moving_light_in(
    technique: &Arc<dyn Technique>,
    cache: &str,
    changed: impl FnOnce(Trial) -> Trial,
) -> TrialOutcome {
    let session = penumbra();
    let cache =
        std::env::temp_dir().join(format!("afterimage-trial-{cache}-{}", std::process::id()));
    let trial = Trial {
        ages: Ages::Given(vec![1, 3]),
        effort: 4.0,
        delta: 0.05,
        most: 1000,
        seconds: f64::INFINITY,
        against: Some(session::technique("nee:roulette=60").unwrap()),
        reference: ReferenceSettings { file: None, seconds: 4.0, cache: Some(cache.clone()) },
        ..Trial::default()
    };
    let trial = changed(trial);
    let mut pool = ReferencePool::default();
    let outcome = trial.run(&session, technique, &mut pool, |_, _| Ok(())).unwrap();
    // One a frame: they are not the same picture.
    assert_eq!(pool.known.len(), 2);
    std::fs::remove_dir_all(cache).unwrap();
    outcome
}

#[test]
fn a_technique_late_by_a_frame_fails_where_the_light_moves_and_the_punctual_one_passes() {
    let nee = session::technique("nee").unwrap();
    let punctual = moving_light(&nee);
    assert_eq!(punctual.last().verdict, Verdict::Pass);
    let late: Arc<dyn Technique> = Arc::new(Late(nee));
    let late = moving_light(&late);
    assert_eq!((late.stages.len(), late.last().verdict), (2, Verdict::Fail));
    // At the cold start there is no frame before.
    assert_ne!(late.last().ages[0].verdict(), Verdict::Fail);
    assert_eq!(late.last().ages[1].verdict(), Verdict::Fail);
}

/// A technique that notes what it renders: run, frame, kernel and where the band begins.
#[derive(Debug)]
struct Noted(Arc<dyn Technique>, std::sync::Mutex<Vec<[u64; 4]>>);

impl Technique for Noted {
    fn spec(&self) -> String {
        self.0.spec()
    }

    fn validate(&self) -> Result<()> {
        self.0.validate()
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
        let (frame, at) = (inputs.frame.into(), band.range.start.into());
        self.1.lock().unwrap().push([inputs.shot.run, frame, kernel.into(), at]);
        self.0.run(kernel, inputs, band)
    }
}

/// Pilot and both stages of a trial render restarts of their own: nothing is rendered twice.
#[test]
fn no_stage_has_the_restarts_of_another() {
    let noted = Arc::new(Noted(session::technique("nee").unwrap(), Default::default()));
    let technique: Arc<dyn Technique> = noted.clone();
    let outcome = moving_light_in(&technique, "stages", |trial| {
        // So few that the first stage decides nothing.
        Trial { restarts: Some(2), delta: 1e-4, ..trial }
    });
    assert_eq!(outcome.stages.len(), 2);
    let mut notes = noted.1.lock().unwrap().clone();
    let count = notes.len();
    notes.sort_unstable();
    notes.dedup();
    assert!(count > 100);
    assert_eq!(notes.len(), count, "something was rendered twice");
}

#[test]
fn restarts_are_counted_alike_by_any_number_of_threads() {
    let technique = session::technique("restir-di").unwrap();
    let bits = |threads: usize, run: u64| -> Vec<[u64; 2]> {
        let mut session = penumbra();
        session.shot.run = run;
        let against = session::technique("nee").unwrap();
        let trial = Trial::default();
        let ages = vec![1, 3];
        let running =
            Running { session: &session, technique: &technique, trial: &trial, ages, against };
        let counts = Counts(vec![37, 21]);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let found = pool.install(|| running.restarts(SeedUse::Restart, &counts)).unwrap();
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

#[test]
fn no_technique_is_its_own_judge() {
    assert_eq!(other_than("nee"), "bsdf");
    assert_eq!(other_than("nee:roulette=3"), "bsdf");
    assert_eq!(other_than("bsdf"), "nee");
}

#[test]
fn ages_begin_at_a_cold_start_and_rise() {
    for Trial { ages, .. } in [Trial::default(), Trial::quick()] {
        let (Ages::Given(list) | Ages::Distinct(list)) = &ages;
        assert!(list[0] == 1 && list.is_sorted() && list.last() == Some(&ages.longest()));
    }
}

#[test]
fn settings_without_an_answer_are_refused_before_any_work() {
    let (session, nee) = (penumbra(), session::technique("nee").unwrap());
    let default = Trial::default;
    for (trial, why) in [
        (Trial { ages: Ages::Given(vec![]), ..default() }, "rise"),
        (Trial { ages: Ages::Given(vec![0, 1]), ..default() }, "rise"),
        (Trial { ages: Ages::Given(vec![3, 2]), ..default() }, "rise"),
        (Trial { ages: Ages::Given(vec![2, 2]), ..default() }, "rise"),
        (Trial { delta: 0.0, ..default() }, "share"),
        (Trial { delta: f64::NAN, ..default() }, "share"),
        (Trial { restarts: Some(1), ..default() }, "2 or more"),
    ] {
        let outcome = trial.run(&session, &nee, &mut ReferencePool::default(), |_, _| Ok(()));
        let error = outcome.unwrap_err();
        assert!(error.is_usage() && error.to_string().contains(why), "{error}");
    }
}
