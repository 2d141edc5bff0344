//! Does work that is interrupted go on, and end with the bits of work that was not?

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex};

use afterimage::experiment::{
    Ages, Compared, Comparison, Host, Keep, Ladder, LadderOutcome, LadderRow, LadderScenes,
    PlannedRung, ReferencePool, ReferenceSettings, Session, SessionSettings, Spending, Trial,
    technique,
};
use afterimage::report::{Results, Row};
use afterimage::techniques::{Entry, REGISTRY, find};

use crate::support::room;

/// Stops the work before so many frames, and hears remarks.
#[derive(Debug)]
struct Fuse {
    left: AtomicI64,
    notes: Mutex<Vec<String>>,
}

const FOREVER: i64 = i64::MAX / 2;

impl Fuse {
    fn new() -> Arc<Self> {
        Arc::new(Self { left: AtomicI64::new(FOREVER), notes: Mutex::default() })
    }

    /// Frames that may be rendered from now on.
    fn set(&self, frames: i64) {
        self.left.store(frames, Ordering::SeqCst);
    }

    /// Frames that were rendered since it was set to [`FOREVER`].
    fn spent(&self) -> i64 {
        FOREVER - self.left.load(Ordering::SeqCst)
    }

    fn notes(&self) -> Vec<String> {
        std::mem::take(&mut *self.notes.lock().unwrap())
    }
}

impl Host for Fuse {
    fn note(&self, text: &str) {
        self.notes.lock().unwrap().push(text.to_string());
    }

    fn stopped(&self) -> bool {
        self.left.fetch_sub(1, Ordering::SeqCst) <= 0
    }
}

/// A fresh folder with a session whose work can be stopped.
struct Place {
    folder: PathBuf,
    fuse: Arc<Fuse>,
    session: Session,
}

impl Place {
    fn new(name: &str, size: [u32; 2]) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("kept-{name}"));
        let _ = fs::remove_dir_all(&folder);
        let fuse = Fuse::new();
        let settings =
            SessionSettings { size: Some(size), depth: Some(2), ..SessionSettings::default() };
        let session = Session::with_host(room(), &settings, fuse.clone()).unwrap();
        Self { folder, fuse, session }
    }

    fn reference(&self) -> ReferenceSettings {
        let cache = Some(self.folder.join("cache"));
        ReferenceSettings { file: None, seconds: 60.0, cache }
    }

    fn keep(&self, name: &str) -> Option<Keep> {
        Some(Keep { folder: self.folder.join(name), fresh: false })
    }

    /// All kept files.
    fn files(&self, name: &str) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.folder.join(name)];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).into_iter().flatten() {
                let path = entry.unwrap().path();
                if path.is_dir() { folders.push(path) } else { found.push(path) }
            }
        }
        found.sort();
        found
    }

    /// Changes a byte in the middle of every kept file, and says how many there are.
    fn damage(&self, name: &str) -> usize {
        let files = self.files(name);
        for file in &files {
            let mut bytes = fs::read(file).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            fs::write(file, bytes).unwrap();
        }
        files.len()
    }
}

fn nee() -> &'static Entry {
    find(REGISTRY, "nee").unwrap().0
}

/// The ladder of `nee` in margins so wide that it takes no time, with two ages that nothing tells
/// apart.
fn ladder(place: &Place, name: &str) -> Ladder {
    Ladder {
        rungs: Some("still".to_string()),
        minutes: None,
        trial: Trial {
            ages: Ages::Given(vec![1, 3]),
            delta: 0.08,
            reference: place.reference(),
            keep: place.keep(name),
            ..Trial::default()
        },
    }
}

fn climb(place: &Place, ladder: &Ladder) -> LadderOutcome {
    let sessions = [place.session.clone()];
    let scenes = LadderScenes { still: &sessions, moving: &sessions };
    ladder.run(nee(), "", scenes, |_| ()).unwrap()
}

fn plan(place: &Place, ladder: &Ladder) -> Vec<PlannedRung> {
    let sessions = [place.session.clone()];
    let scenes = LadderScenes { still: &sessions, moving: &sessions };
    ladder.plan(nee(), "", scenes, |_| ()).unwrap()
}

/// Rows whose every bit can be compared.
fn bits(rows: &[LadderRow]) -> Vec<String> {
    rows.iter()
        .map(|row| {
            let of = |worst: &Option<(u32, afterimage::stats::Part)>| {
                worst.map(|(age, part)| {
                    let test = part.test;
                    let values = [test.difference, test.standard_error, test.dof, part.scale];
                    (age, part.place, part.quantity, values.map(f64::to_bits))
                })
            };
            let looks = (row.verdict, row.restarts, row.stage, row.confidence.to_bits());
            format!("{} {looks:?} {:?} {:?}", row.rung, of(&row.worst_image), of(&row.worst_tile))
        })
        .collect()
}

#[test]
fn a_ladder_that_is_stopped_again_and_again_has_the_rows_of_one_that_is_not() {
    let place = Place::new("ladder", [12, 10]);
    // References are made first, so that all runs have the same.
    let whole = ladder(&place, "whole");
    let expected = climb(&place, &whole);
    assert!(!expected.rows.is_empty() && expected.open.is_empty() && !expected.interrupted);
    let bits_expected = bits(&expected.rows);
    let restarts: u64 = expected.rows.iter().map(|row| row.restarts[0]).sum();

    // A plan says what was done, and costs pilots alone.
    let planned = plan(&place, &ladder(&place, "planned"));
    assert_eq!(planned.len(), expected.rows.len());
    for (rung, row) in planned.iter().zip(&expected.rows) {
        let cost = rung.cost.as_ref().unwrap();
        let names = (rung.rung, &rung.technique, rung.number);
        assert_eq!(names, (row.rung, &row.technique, row.number));
        assert_eq!((cost.stage, cost.done, &cost.ages), (1, 0, &row.ages));
        assert!(cost.seconds > 0.0 && cost.restarts.is_sorted_by(|a, b| a >= b));
        let ends = [cost.restarts[0], cost.restarts[cost.restarts.len() - 1]].map(u64::from);
        assert_eq!((row.stage, row.restarts), (1, ends));
    }

    // What is judged is kept: no restart is rendered for it again.
    place.fuse.set(FOREVER);
    assert_eq!(bits(&climb(&place, &whole).rows), bits_expected);
    assert_eq!(place.fuse.spent(), 0);
    assert!(plan(&place, &whole).is_empty());

    // Stopped after ever other numbers of frames, in pilots, stages and between them.
    assert!(stopped_again_and_again(&place, &ladder(&place, "again"), &expected) > 3);

    // Fresh, all is done again, once.
    let mut fresh = whole.clone();
    fresh.trial.keep.as_mut().unwrap().fresh = true;
    place.fuse.set(FOREVER);
    assert_eq!(bits(&climb(&place, &fresh).rows), bits_expected);
    assert!(place.fuse.spent() as u64 >= restarts);
    let _ = fs::remove_dir_all(&place.folder);
}

/// Runs a ladder that is stopped before it is done, until it is, and says how many runs it took.
/// Its rows are the expected ones.
fn stopped_again_and_again(place: &Place, ladder: &Ladder, expected: &LadderOutcome) -> i64 {
    for run in 0..1000 {
        place.fuse.set(110 + 17 * run);
        let outcome = climb(place, ladder);
        assert_eq!(outcome.rows.len() + outcome.open.len(), expected.rows.len());
        assert_eq!(outcome.interrupted, !outcome.open.is_empty());
        if !outcome.interrupted {
            assert_eq!(bits(&outcome.rows), bits(&expected.rows));
            return run + 1;
        }
    }
    panic!("it does not go on");
}

/// Few restarts decide nothing, so that a second stage follows: a first one that was judged is not
/// judged again.
#[test]
fn a_ladder_that_is_stopped_between_two_stages_looks_as_often() {
    let place = Place::new("stages", [12, 10]);
    let few = |name: &str| {
        let mut ladder = ladder(&place, name);
        ladder.trial.restarts = Some(20);
        ladder
    };
    let expected = climb(&place, &few("whole"));
    assert!(expected.rows.iter().all(|row| row.stage == 2 && row.restarts == [80, 80]));
    assert!(stopped_again_and_again(&place, &few("again"), &expected) > 2);
    let _ = fs::remove_dir_all(&place.folder);
}

/// However often a trial is stopped, each of its stages is judged once, after its own restarts.
#[test]
fn a_trial_that_is_stopped_looks_once_at_each_stage() {
    let place = Place::new("looks", [12, 10]);
    let nee = technique("nee").unwrap();
    let trial = |name: &str| Trial { restarts: Some(20), ..ladder(&place, name).trial };
    let mut looks = Vec::new();
    let mut run = |name: &str| {
        let mut pool = ReferencePool::default();
        trial(name).run(&place.session, &nee, &mut pool, |judged, _| {
            looks.push((judged.stage, judged.ages[0].restarts.count()));
            Ok(())
        })
    };
    run("whole").unwrap();
    let mut runs = 0;
    loop {
        runs += 1;
        assert!(runs < 200, "it does not go on");
        place.fuse.set(110 + 7 * runs);
        match run("again") {
            Ok(_) => break,
            Err(error) => assert!(error.is_interrupted(), "{error}"),
        }
    }
    assert!(runs > 2, "{runs} runs");
    assert_eq!(looks, [(1, 20), (2, 80)].repeat(2));
    let _ = fs::remove_dir_all(&place.folder);
}

#[test]
fn a_damaged_file_of_a_ladder_is_made_anew_with_a_warning() {
    let place = Place::new("damaged", [12, 10]);
    let expected = bits(&climb(&place, &ladder(&place, "whole")).rows);
    let stopped = ladder(&place, "stopped");
    // Enough for a pilot of eight restarts, one of 64, the check of the reference, and a part of
    // the first stage.
    place.fuse.set(3 * 72 + 32 + 100);
    let outcome = climb(&place, &stopped);
    assert!(outcome.interrupted && outcome.rows.is_empty());
    let done = outcome.open[0].cost.as_ref().map_or(0, |cost| cost.done);
    place.fuse.notes();
    let damaged = place.damage("stopped");
    place.fuse.set(FOREVER);
    assert_eq!(bits(&climb(&place, &stopped).rows), expected);
    let notes = place.fuse.notes();
    let anew = notes.iter().filter(|note| note.contains("made anew")).count();
    assert_eq!((anew, damaged), (damaged, 2), "{notes:?}; {done} restarts were done");

    // Rows as well.
    let damaged = place.damage("stopped");
    assert!(damaged > 0);
    assert_eq!(bits(&climb(&place, &stopped).rows), expected);
    let notes = place.fuse.notes();
    assert_eq!(notes.iter().filter(|note| note.contains("made anew")).count(), damaged);
    let _ = fs::remove_dir_all(&place.folder);
}

#[test]
fn other_settings_are_other_work() {
    let place = Place::new("others", [8, 6]);
    let base = ladder(&place, "kept");
    climb(&place, &base);
    let rows = place.files("kept").len();
    assert!(plan(&place, &base).is_empty());
    let seed = {
        let mut session = place.session.clone();
        session.shot.run = 2;
        Place { session, folder: place.folder.clone(), fuse: place.fuse.clone() }
    };
    let with = |change: &dyn Fn(&mut Trial)| {
        let mut other = base.clone();
        change(&mut other.trial);
        other
    };
    for (what, place, other) in [
        ("seed", &seed, base.clone()),
        ("margin", &place, with(&|trial| trial.delta = 0.081)),
        ("ages", &place, with(&|trial| trial.ages = Ages::Given(vec![1, 2]))),
        ("effort", &place, with(&|trial| trial.effort = 2.0)),
        ("judge", &place, with(&|trial| trial.against = Some(technique("ris").unwrap()))),
    ] {
        assert_eq!(plan(place, &other).len(), rows, "{what}");
    }
}

#[test]
fn a_ladder_without_time_leaves_rungs_open_and_the_next_run_decides_them() {
    let place = Place::new("time", [12, 10]);
    let whole = climb(&place, &ladder(&place, "whole"));
    let mut short = ladder(&place, "short");
    short.minutes = Some(1e-9);
    let outcome = climb(&place, &short);
    assert!(!outcome.interrupted && outcome.rows.is_empty());
    assert_eq!(outcome.open.len(), whole.rows.len());
    short.minutes = Some(60.0);
    let outcome = climb(&place, &short);
    assert!(outcome.open.is_empty());
    assert_eq!(bits(&outcome.rows), bits(&whole.rows));
    let _ = fs::remove_dir_all(&place.folder);
}

fn comparison(place: &Place, name: &str) -> Comparison {
    Comparison {
        spending: Spending::Estimates(1),
        frames: 3,
        restarts: 5,
        curve_restarts: 2,
        reference: place.reference(),
        keep: place.keep(name),
        ..Comparison::default()
    }
}

fn compare(place: &Place, comparison: &Comparison) -> afterimage::Result<Compared> {
    let techniques = ["nee", "restir-di"].map(|spec| technique(spec).unwrap());
    comparison.run(&place.session, &techniques)
}

/// All that does not depend on a clock.
fn timeless(results: &Results) -> String {
    let row = |row: &Row| {
        let mut metrics = row.metrics.clone();
        metrics.remove("ttuv");
        let seeds: Vec<u64> = row.samples.iter().map(|sample| sample.seed).collect();
        let warmups: Vec<&Vec<f64>> = row.samples.iter().map(|sample| &sample.warmup).collect();
        format!("{metrics:?} {:?} {:?} {seeds:?} {warmups:?}", row.rays_per_pixel, row.bias)
    };
    let rows: Vec<String> = results.rows.iter().map(row).collect();
    let points = results.curves.iter().flat_map(|curve| &curve.points);
    let curves: Vec<String> = points.map(|p| format!("{} {:?}", p.effort, p.relmse)).collect();
    format!("{rows:?} {curves:?} {:?} {:?}", results.warmups, results.spectra)
}

#[test]
fn a_comparison_that_is_stopped_goes_on_with_its_restarts_and_their_times() {
    let place = Place::new("compare", [16, 12]);
    let expected = compare(&place, &comparison(&place, "whole")).unwrap();
    assert!(place.files("whole").is_empty(), "what is done is forgotten");
    let expected_shown: Vec<_> = expected.shown.iter().map(|s| s.picture.clone()).collect();

    let kept = comparison(&place, "kept");
    let (mut runs, mut restarts) = (0, 0);
    let mut times: Vec<Vec<f64>> = Vec::new();
    let done = loop {
        // Eight frames of pilots and 32 that check the reference come first.
        place.fuse.set(43 + 4 * runs);
        runs += 1;
        assert!(runs < 100, "it does not go on");
        match compare(&place, &kept) {
            Ok(compared) if !compared.results.interrupted => break compared,
            Ok(compared) => {
                let found = &compared.results;
                restarts = found.rows[0].restarts;
                // Restarts keep their times.
                let now: Vec<Vec<f64>> =
                    found.rows[0].samples.iter().map(|sample| sample.ms.clone()).collect();
                assert_eq!(now[..times.len()], times[..]);
                times = now;
            }
            Err(error) => assert!(error.is_interrupted(), "{error}"),
        }
    };
    let notes = place.fuse.notes();
    assert!(!notes.iter().any(|note| note.contains("warning")), "{notes:?}");
    assert!(runs > 2 && restarts > 0 && !times.is_empty(), "{runs} runs");
    let results = &done.results;
    assert!(results.resumed > 0);
    let samples = &results.rows[0].samples;
    assert!(times.iter().zip(samples).all(|(ms, sample)| *ms == sample.ms));
    assert_eq!(timeless(results), timeless(&expected.results));
    let shown: Vec<_> = done.shown.iter().map(|s| s.picture.clone()).collect();
    assert_eq!(shown, expected_shown);
    let emission = |compared: &Compared| compared.shown[1].emission.clone();
    assert_eq!(emission(&done), emission(&expected));
    assert!(place.files("kept").is_empty());
    let _ = fs::remove_dir_all(&place.folder);
}

#[test]
fn damaged_swapped_and_unwanted_restarts_of_a_comparison_are_made_anew() {
    let place = Place::new("compare-damaged", [16, 12]);
    let expected = compare(&place, &comparison(&place, "whole")).unwrap().results;
    let kept = comparison(&place, "kept");
    let stop = |frames: i64| {
        place.fuse.set(frames);
        if let Ok(compared) = compare(&place, &kept) {
            assert!(compared.results.interrupted);
        }
        place.fuse.notes();
    };
    let is_restart = |path: &PathBuf| path.extension().is_some_and(|e| e == "restart");
    let goes_on = |comparison: &Comparison| {
        place.fuse.set(FOREVER);
        let results = compare(&place, comparison).unwrap().results;
        assert_eq!(timeless(&results), timeless(&expected));
        (results.resumed, place.fuse.notes())
    };

    stop(55);
    let damaged: Vec<PathBuf> = place.files("kept").into_iter().filter(is_restart).collect();
    assert!(damaged.len() > 2, "{damaged:?}");
    place.damage("kept");
    let (resumed, notes) = goes_on(&kept);
    assert!(resumed == 0 && notes.iter().any(|note| note.contains("made anew")), "{notes:?}");

    // One restart's file under another's name has the right key.
    stop(55);
    let restarts: Vec<PathBuf> = place.files("kept").into_iter().filter(is_restart).collect();
    fs::copy(&restarts[0], &restarts[1]).unwrap();
    let (resumed, notes) = goes_on(&kept);
    assert_eq!(resumed as usize, restarts.len() - 1);
    assert!(notes.iter().any(|note| note.contains("another form")), "{notes:?}");

    // A fresh one uses none.
    stop(55);
    let mut fresh = kept.clone();
    fresh.keep.as_mut().unwrap().fresh = true;
    assert_eq!(goes_on(&fresh), (0, Vec::new()));
    let _ = fs::remove_dir_all(&place.folder);
}
