//! Are seeds of different uses different, and are they used for what they are for?

use std::collections::HashSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

use super::*;
use crate::Result;
use crate::counters::Counters;
use crate::experiment::{
    Ages, Comparison, Host, ReferencePool, ReferenceSettings, Session, SessionSettings, Silent,
    Spending, Steps, Trial, technique,
};
use crate::pass::{Band, FrameInputs};
use crate::plan::{Plan, SceneFacts, Shot};
use crate::scene::load::load;
use crate::techniques::Technique;

#[test]
fn uses_techniques_and_restarts_have_seeds_of_their_own() {
    let mut seen = HashSet::new();
    for run in [0, 1, u64::MAX] {
        for what in [
            SeedUse::Restart,
            SeedUse::Calibration,
            SeedUse::Pilot,
            SeedUse::Curve,
            SeedUse::Reference,
            SeedUse::SecondStage,
            SeedUse::Check,
        ] {
            for technique in 0..10 {
                for index in 0..100 {
                    assert!(seen.insert(seed(run, what, technique, index)));
                }
            }
        }
    }
}

/// A stretch of work and the seeds of each technique's frames in it.
#[derive(Debug)]
struct Stretch {
    what: &'static str,
    seeds: [HashSet<u64>; 2],
}

/// What begins, and which seeds are used until the next thing does.
#[derive(Clone, Debug, Default)]
struct Record(Arc<Mutex<Vec<Stretch>>>);

impl Record {
    /// What was recorded so far.
    fn take(&self) -> Vec<Stretch> {
        std::mem::take(&mut self.0.lock().unwrap())
    }
}

impl Host for Record {
    fn begin(&self, what: &'static str, _steps: u64) -> Box<dyn Steps> {
        self.0.lock().unwrap().push(Stretch { what, seeds: Default::default() });
        Box::new(Silent)
    }
}

/// `nee`, which says what seeds its frames have.
#[derive(Debug)]
struct Recorded {
    number: usize,
    inner: Arc<dyn Technique>,
    record: Record,
}

impl Recorded {
    fn pair(record: &Record) -> [Arc<dyn Technique>; 2] {
        [0, 1].map(|number| -> Arc<dyn Technique> {
            Arc::new(Self { number, inner: technique("nee").unwrap(), record: record.clone() })
        })
    }
}

impl Technique for Recorded {
    fn spec(&self) -> String {
        format!("recorded-{}", self.number)
    }

    fn validate(&self) -> Result<()> {
        Ok(())
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        self.inner.plan(facts, shot)
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        let mut record = self.record.0.lock().unwrap();
        // What is rendered before anything has begun is a stretch of its own.
        if record.is_empty() {
            record.push(Stretch { what: "before", seeds: Default::default() });
        }
        record.last_mut().unwrap().seeds[self.number].insert(inputs.shot.run);
        drop(record);
        self.inner.run(kernel, inputs, band)
    }
}

/// Small pictures of the penumbra, a fresh cache, and what is recorded.
fn recorded(name: &str) -> (Session, ReferenceSettings, Record) {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
    let settings =
        SessionSettings { size: Some([8, 6]), depth: Some(2), ..SessionSettings::default() };
    let record = Record::default();
    let session =
        Session::with_host(load(&scene).unwrap().scene, &settings, Arc::new(record.clone()));
    let cache =
        std::env::temp_dir().join(format!("afterimage-seeds-{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&cache);
    (session.unwrap(), ReferenceSettings { file: None, seconds: 1.0, cache: Some(cache) }, record)
}

/// What ran, and how many seeds each technique had there.
fn summary(stretches: &[Stretch]) -> Vec<(&'static str, [usize; 2])> {
    stretches.iter().map(|s| (s.what, [s.seeds[0].len(), s.seeds[1].len()])).collect()
}

/// That no seed is in two sets.
fn assert_disjoint<'a>(sets: impl IntoIterator<Item = &'a HashSet<u64>>) {
    let mut seen = HashSet::new();
    for set in sets {
        assert!(set.iter().all(|seed| seen.insert(*seed)), "a seed has two uses");
    }
}

#[test]
fn pilots_stages_and_references_of_a_trial_share_no_seed() {
    let (session, reference, record) = recorded("trial");
    let [tested, against] = Recorded::pair(&record);
    let trial = |number| Trial {
        ages: Ages::Given(vec![1, 2]),
        most: 70,
        number,
        against: Some(against.clone()),
        reference: reference.clone(),
        ..Trial::default()
    };
    let run = |number| {
        let mut pool = ReferencePool::default();
        let outcome = trial(number).run(&session, &tested, &mut pool, |_, _| Ok(())).unwrap();
        assert_eq!(outcome.stages.len(), 2, "margins are too narrow for a pass");
        record.take()
    };
    let first = run(0);
    // The pilot, the long one, the reference, and two stages.
    let stretches = [
        ("restarts", [8, 0]),
        ("restarts", [64, 0]),
        ("reference", [0, 1]),
        ("restarts", [70, 0]),
        ("restarts", [280, 0]),
    ];
    let found = summary(&first);
    assert!(
        found.iter().filter(|s| s.0 != "reference").eq([0, 1, 3, 4].map(|i| &stretches[i])),
        "{found:?}"
    );
    assert!(found.iter().any(|s| *s == stretches[2]), "{found:?}");
    // The second pilot begins with the restarts of the first: neither is tested.
    assert!(first[0].seeds[0].is_subset(&first[1].seeds[0]));

    // A trial with another number, whose reference is stored: that is checked, and continued.
    let second = run(1);
    let own = first.iter().skip(1).chain(second.iter().skip(1)).map(|s| &s.seeds[0]);
    let judge = |made: bool| -> HashSet<u64> {
        let all = first.iter().chain(&second);
        let used = all.filter(|s| (s.what == "reference") == made).flat_map(|s| &s.seeds[1]);
        used.copied().collect()
    };
    let (references, checks) = (judge(true), judge(false));
    assert!(!references.is_empty() && checks.len() == 1, "{references:?}, {checks:?}");
    assert_disjoint(own.chain([&references, &checks]));
    std::fs::remove_dir_all(reference.cache.unwrap()).unwrap();
}

#[test]
fn calibration_pilot_restarts_and_curve_of_a_comparison_share_no_seed() {
    let (session, reference, record) = recorded("compare");
    let comparison = Comparison {
        spending: Spending::Slowest,
        frames: 2,
        restarts: 3,
        curve_restarts: 2,
        reference: reference.clone(),
        ..Comparison::default()
    };
    comparison.run(&session, &Recorded::pair(&record)).unwrap();
    let found = record.take();
    let of = |what: &str| -> Vec<&Stretch> { found.iter().filter(|s| s.what == what).collect() };
    let calibrations = of("calibration");
    let [search, before, after] = calibrations[..] else { panic!("{:?}", summary(&found)) };
    assert_eq!(before.seeds, after.seeds, "the same frames are measured twice");
    let [pilot, restarts, curve] = ["pilot", "restarts", "curve"].map(|what| of(what)[0]);
    for (stretch, count) in [(before, 1), (pilot, 2), (restarts, 3)] {
        assert!(stretch.seeds.iter().all(|s| s.len() == count), "{}", stretch.what);
    }
    // Two or three other efforts, each with two restarts.
    assert!(curve.seeds.iter().all(|s| s.len() == 4 || s.len() == 6), "{:?}", summary(&found));
    let uses = [search, before, pilot, restarts, curve];
    assert_disjoint(uses.iter().flat_map(|stretch| &stretch.seeds));
    std::fs::remove_dir_all(reference.cache.unwrap()).unwrap();
}
