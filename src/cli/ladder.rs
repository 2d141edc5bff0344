//! `verify --ladder`: a technique rung by rung, so that the first rung that fails names the part that is wrong.
//!
//! A rung is parameters and a motion. Still rungs stand on still scenes, moving ones on scenes in which only the named thing moves
//! ([`super::motion`]); every frame that is judged has a reference of its own time. References are shared between rungs.

use std::fmt::Write as _;
use std::io::Write as _;
use std::sync::Arc;
use std::time::Instant;

use super::engine::{self, Engine};
use super::motion::{self, Motion};
use super::progress::Progress;
use super::trial::{self, Judged, Outcome, References, Settings};
use super::verify::{VerifyArgs, existing};
use super::{Status, machine, note, print};
use crate::plan::Claim;
use crate::report::{align, write_atomic};
use crate::stats::Verdict;
use crate::techniques::Technique;
use crate::{Error, Result};

/// A line of a ladder.
struct Rung {
    name: &'static str,
    /// Added to SPEC; what is given here wins.
    keys: &'static str,
    motion: Motion,
}

const fn rung(name: &'static str, keys: &'static str, motion: Motion) -> Rung {
    Rung { name, keys, motion }
}

/// By technique; the last is for all others. Each rung adds to those before, as far as a line can.
const LADDERS: [(&str, &[Rung]); 2] = [
    (
        "restir-di",
        &[
            rung("initial", "cap=0,neighbours=0", Motion::Still),
            rung("spatial, constant", "cap=0,mis=constant", Motion::Still),
            rung("spatial, inverse-count", "cap=0,mis=inverse-count", Motion::Still),
            rung("spatial, contribution", "cap=0,mis=contribution", Motion::Still),
            rung("spatial, balance", "cap=0,mis=balance", Motion::Still),
            rung("spatial, pairwise", "cap=0,mis=pairwise", Motion::Still),
            rung("spatial, defensive", "cap=0,mis=defensive", Motion::Still),
            rung("temporal", "neighbours=0", Motion::Still),
            rung("full", "", Motion::Still),
            rung("moving camera", "", Motion::Camera),
            rung("moving light", "", Motion::Light),
            rung("moving occluder", "", Motion::Occluder),
            rung("mutations", "mutations=1", Motion::Still),
            rung("moving, mutations", "mutations=1", Motion::All),
            rung("visibility trace", "visibility=trace", Motion::Still),
            rung("moving, visibility trace", "visibility=trace", Motion::All),
            rung("visibility bitterli", "visibility=bitterli", Motion::Still),
            rung("visibility reuse", "visibility=reuse", Motion::Still),
            rung("visibility wis", "visibility=wis", Motion::Still),
            rung("visibility wis-cv", "visibility=wis-cv", Motion::Still),
            rung("moving, visibility wis-cv", "visibility=wis-cv", Motion::All),
            rung("decoupled", "decoupled=true", Motion::Still),
            rung("two rounds", "rounds=2", Motion::Still),
        ],
    ),
    (
        "",
        &[
            rung("still", "", Motion::Still),
            rung("moving camera", "", Motion::Camera),
            rung("moving light", "", Motion::Light),
            rung("moving occluder", "", Motion::Occluder),
            rung("moving all", "", Motion::All),
        ],
    ),
];

/// Scenes of still rungs, the most telling first.
const STILL: [&str; 4] = [
    "scenes/penumbra.pbrt",
    "scenes/cornell.pbrt",
    "scenes/many_lights.pbrt",
    "scenes/plates.pbrt",
];
/// Scenes of moving rungs.
const MOVING: [&str; 2] = ["scenes/penumbra.pbrt", "scenes/moving.pbrt"];
/// Direct light: what samples of lights can make. Everything longer hides it behind noise.
const DEPTH: u32 = 2;
/// Of a quick ladder.
const QUICK_MINUTES: f64 = 7.0;
/// Of a rung's time, what its references may take where the ladder's time is limited; what they leave is for restarts.
const REFERENCE_SHARE: f64 = 0.3;

/// A rung on a scene.
struct Task<'a> {
    /// In the whole ladder, whatever part of it is run: what its seeds derive from.
    number: u32,
    rung: &'a Rung,
    technique: Arc<dyn Technique>,
    scene: String,
}

/// A finished task, as the table shows it.
struct Row {
    cells: Vec<String>,
    failed: bool,
    /// Why the technique is biased, where it says so.
    reason: Option<(String, String)>,
}

pub(super) fn run(args: &VerifyArgs) -> Result<Status> {
    if args.reference.reference.is_some() {
        return Err(Error::usage(
            "--reference is one picture, but a ladder has many scenes: leave out either",
        ));
    }
    let tasks = tasks(args)?;
    let against = args.against(&*tasks[0].technique)?;
    let minutes = args.minutes.or(args.quick.then_some(QUICK_MINUTES));
    let begin = Instant::now();
    let progress = Progress::new("ladder", tasks.len() as u64);
    let mut references = References::default();
    let mut rows = Vec::new();
    let mut interrupted = false;
    for (done, task) in tasks.iter().enumerate() {
        progress.say(&format!("{} on {}", task.rung.name, task.scene));
        let left = minutes.map(|m| (60.0 * m - begin.elapsed().as_secs_f64()).max(0.0));
        let seconds = left.map_or(f64::INFINITY, |left| allowance(left, tasks.len() - done));
        let engine = engine(args, task)?;
        let ages = args.ages(&engine, &*task.technique);
        let claim = engine.plan(&*task.technique).claim;
        // A reference serves later rungs too, so its time counts for all of them; its remaining noise is part of every interval.
        let mut reference = args.reference.clone();
        let share = REFERENCE_SHARE * seconds / ages.len() as f64;
        reference.reference_time = reference.reference_time.min(share.max(1.0));
        let settings = Settings {
            seconds,
            all_in: true,
            confirm: claim == Claim::Unbiased,
            number: task.number,
            reference: &reference,
            ..args.settings(&ages, &against)
        };
        match trial::run(&engine, &task.technique, &settings, &mut references, |_, _| Ok(())) {
            Ok(outcome) => {
                let row = row(task, &ages, &outcome);
                note(&row.cells.join("  "));
                rows.push(row);
            }
            Err(error) if error.is_interrupted() => {
                interrupted = true;
                break;
            }
            Err(error) => return Err(error),
        }
        progress.step();
    }
    drop(progress);
    let text = markdown(args, &tasks[0], &rows, begin.elapsed().as_secs_f64(), interrupted)?;
    print(&text)?;
    if let Some(path) = &args.out {
        write_atomic(path, |w| w.write_all(text.as_bytes()))?;
    }
    if interrupted {
        return Ok(Status::Interrupted);
    }
    let failed = rows.iter().any(|row| row.failed);
    Ok(if failed && args.check { Status::CheckFailed } else { Status::Done })
}

/// Seconds for the next of `tasks`, so that easy ones leave time to hard ones and all together keep within `left`.
fn allowance(left: f64, tasks: usize) -> f64 {
    left * (2.0 / tasks as f64).min(1.0)
}

/// Every rung on every scene; wrong specifications are found before any work.
fn tasks(args: &VerifyArgs) -> Result<Vec<Task<'static>>> {
    let name = args.technique.split(':').next().unwrap_or_default();
    // An unknown technique shall not be told that a rung's parameters are wrong.
    engine::technique(&args.technique)?;
    let wanted = |rung: &Rung| args.rungs.as_ref().is_none_or(|text| is_wanted(rung, text, name));
    let mut tasks = Vec::new();
    let mut number = 0;
    for rung in rungs(name) {
        let technique = engine::technique(&merged(&args.technique, rung.keys))?;
        for scene in scenes(args, rung)? {
            tasks.push(Task { number, rung, technique: technique.clone(), scene });
            number += 1;
        }
    }
    tasks.retain(|task| wanted(task.rung));
    if tasks.is_empty() {
        let names: Vec<&str> = rungs(name).iter().map(|rung| rung.name).collect();
        let text = args.rungs.as_deref().unwrap_or_default();
        return Err(Error::usage(format!(
            "no rung's name contains `{text}`; known: {}; and `still` for all without motion",
            names.join("; ")
        )));
    }
    Ok(tasks)
}

/// Whether `text` asks for a rung of `technique`: by its name, where one has just that, else by a part of it.
fn is_wanted(rung: &Rung, text: &str, technique: &str) -> bool {
    let named = rungs(technique).iter().any(|rung| rung.name == text);
    let still = text == "still" && rung.motion == Motion::Still;
    if named { rung.name == text } else { rung.name.contains(text) || still }
}

fn rungs(technique: &str) -> &'static [Rung] {
    let own = LADDERS.iter().find(|(name, _)| *name == technique);
    own.unwrap_or(&LADDERS[LADDERS.len() - 1]).1
}

fn scenes(args: &VerifyArgs, rung: &Rung) -> Result<Vec<String>> {
    if !args.scenes.is_empty() {
        return Ok(args.scenes.clone());
    }
    let all: &[&str] = if rung.motion == Motion::Still { &STILL } else { &MOVING };
    existing(if args.quick { &all[..1] } else { all })
}

/// A SPEC with a rung's parameters in place of its own.
fn merged(spec: &str, keys: &str) -> String {
    let (name, own) = spec.split_once(':').unwrap_or((spec, ""));
    let key = |pair: &str| pair.split('=').next().unwrap_or_default().to_string();
    let mut all: Vec<String> = own
        .split(',')
        .filter(|pair| !pair.is_empty() && !keys.split(',').any(|k| key(k) == key(pair)))
        .map(String::from)
        .collect();
    all.extend(keys.split(',').filter(|pair| !pair.is_empty()).map(String::from));
    if all.is_empty() { name.to_string() } else { format!("{name}:{}", all.join(",")) }
}

fn engine(args: &VerifyArgs, task: &Task<'_>) -> Result<Engine> {
    let mut picture = args.picture.clone();
    picture.depth = Some(picture.depth.unwrap_or(DEPTH));
    let mut engine = Engine::open(&task.scene, &picture, args.filter, None)?;
    args.shrink(&mut engine);
    let longest = args.longest_age();
    let seconds = longest.max(2) as f32 / engine.shot.fps as f32;
    engine.with_scene(motion::only(engine.stage.scene(), task.rung.motion, seconds)?)
}

/// How many restarts were judged at the first age and, where fewer came so far, at the last.
fn restarts(judged: &Judged) -> String {
    let count = |age: Option<&trial::Age>| age.map_or(0, |age| age.restarts.count());
    let (first, last) = (count(judged.ages.first()), count(judged.ages.last()));
    if first == last { first.to_string() } else { format!("{first} to {last}") }
}

fn row(task: &Task<'_>, ages: &[u32], outcome: &Outcome) -> Row {
    let judged = outcome.last();
    let confidence = judged.confidence();
    let claim = &outcome.plan.claim;
    let worst = |image: bool| {
        judged.worst(image).map_or_else(String::new, |(frames, part)| {
            let place = trial::place(part);
            let place = if place.is_empty() { place } else { format!("{place} ") };
            format!("{} {place}at {frames}", trial::percent(part, confidence))
        })
    };
    let ages: Vec<String> = ages.iter().map(u32::to_string).collect();
    Row {
        cells: vec![
            task.rung.name.to_string(),
            format!("`{}`", outcome.plan.technique),
            scene_name(&task.scene),
            match claim {
                Claim::Biased(_) => "biased".to_string(),
                other => other.to_string(),
            },
            ages.join(", "),
            verdict(claim, judged.verdict).to_string(),
            worst(true),
            worst(false),
            restarts(judged),
            format!("{}, stage {}", task.number, judged.stage),
        ],
        failed: *claim == Claim::Unbiased && judged.verdict == Verdict::Fail,
        reason: match claim {
            Claim::Biased(why) => Some((outcome.plan.technique.clone(), why.clone())),
            _ => None,
        },
    }
}

/// What a measurement says about a claim. Only who claims to be unbiased can fail.
fn verdict(claim: &Claim, measured: Verdict) -> &'static str {
    match (claim, measured) {
        (Claim::Unbiased, measured) => measured.name(),
        (Claim::Biased(_), Verdict::Fail) => "biased as claimed",
        (Claim::Biased(_), Verdict::Pass) => "claims bias, within margins",
        (Claim::Biased(_), Verdict::Inconclusive) => "claims bias, undecided",
        (Claim::Consistent, Verdict::Fail) => "biased at these ages, claims consistency",
        (Claim::Consistent, measured) => measured.name(),
    }
}

/// A file's stem; a generator as it is.
fn scene_name(scene: &str) -> String {
    let stem = std::path::Path::new(scene).file_stem().map(|s| s.to_string_lossy().into_owned());
    stem.unwrap_or_else(|| scene.to_string())
}

fn markdown(
    args: &VerifyArgs,
    first: &Task<'_>,
    rows: &[Row],
    seconds: f64,
    interrupted: bool,
) -> Result<String> {
    const COLUMNS: [&str; 10] = [
        "rung",
        "spec",
        "scene",
        "claim",
        "ages",
        "verdict",
        "worst image bias, %",
        "worst tile bias, %",
        "restarts",
        "seeds",
    ];
    let shot = engine(args, first)?.shot;
    let mut text = format!(
        "`{}`, commit {}, {}; {seconds:.0} s.\n\n",
        machine::command(),
        machine::commit(),
        machine::describe()
    );
    let _ = writeln!(
        text,
        "{}x{} on {}, depth {}. Margins: {} % of the image, {} % of a tile (of at least a tenth of the image's mean), luminance and each \
         channel, at every age. Brackets: 99.9 % intervals, the reference's error included; a pass has all of them inside the margins.\n",
        shot.size[0],
        shot.size[1],
        scene_name(&first.scene),
        shot.depth,
        100.0 * args.delta(),
        200.0 * args.delta()
    );
    let header = COLUMNS.map(String::from);
    let body: Vec<Vec<String>> = rows.iter().map(|row| row.cells.clone()).collect();
    text.push_str(&align(&header, &body));
    let mut reasons: Vec<&(String, String)> =
        rows.iter().filter_map(|row| row.reason.as_ref()).collect();
    reasons.dedup();
    for (spec, why) in reasons {
        let _ = writeln!(text, "\n`{spec}` is biased: {why}.");
    }
    let _ = writeln!(
        text,
        "\nSeeds derive from --seed {}, the row's number and stage, and the restart, from 0. Stage 2 has none of the restarts of stage 1.",
        args.picture.seed
    );
    if interrupted {
        text.push_str("\nStopped by the user: the rungs below were not tried.\n");
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rungs_parameters_win() {
        assert_eq!(merged("a", ""), "a");
        assert_eq!(merged("a", "x=1"), "a:x=1");
        assert_eq!(merged("a:y=2,x=3", "x=1,z=4"), "a:y=2,x=1,z=4");
        assert_eq!(merged("a:y=2", ""), "a:y=2");
    }

    #[test]
    fn every_ladder_of_a_known_technique_parses_and_names_its_rungs_once() {
        for (name, rungs) in LADDERS {
            for (at, rung) in rungs.iter().enumerate() {
                assert!(rungs[..at].iter().all(|other| other.name != rung.name), "{}", rung.name);
                if crate::techniques::REGISTRY.iter().any(|entry| entry.name == name) {
                    crate::techniques::parse(&merged(name, rung.keys)).unwrap();
                }
            }
        }
        assert_eq!(rungs("nee").len(), 5);
        assert!(rungs("restir-di").len() > 15);
    }

    #[test]
    fn a_rungs_whole_name_asks_for_it_alone() {
        let asked = |text: &str| -> Vec<&str> {
            let all = rungs("restir-di").iter();
            all.filter(|rung| is_wanted(rung, text, "restir-di")).map(|rung| rung.name).collect()
        };
        assert_eq!(asked("mutations"), ["mutations"]);
        assert_eq!(asked("mutation"), ["mutations", "moving, mutations"]);
        assert!(asked("moving").len() > 3 && asked("still").len() > 10);
    }

    #[test]
    fn only_a_claim_of_no_bias_can_fail() {
        let biased = Claim::Biased("it forgets".to_string());
        assert_eq!(verdict(&Claim::Unbiased, Verdict::Fail), "fail");
        assert_eq!(verdict(&biased, Verdict::Fail), "biased as claimed");
        assert!(verdict(&biased, Verdict::Pass).contains("within"));
        assert!(verdict(&Claim::Consistent, Verdict::Fail).contains("consistency"));
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
