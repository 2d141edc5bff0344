//! `verify --ladder`: the table of a [`Ladder`].

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use super::command_line::command_line;
use super::part::{percent, place};
use super::verify::{VerifyArgs, existing};
use super::{Status, note, print};
use crate::experiment::{
    Keep, Ladder, LadderOutcome, LadderRow, LadderScenes, PlannedRung, Session, Trial, machine,
};
use crate::plan::{Claim, Shot};
use crate::report::{align, write_atomic};
use crate::stats::{Part, Verdict};
use crate::techniques::{self, Entry, REGISTRY};
use crate::{Error, Result};

/// Scenes of still rungs, the most telling first. `many_lights` takes as long as all others
/// together, by the power of its rungs: it is verified where it is named.
const STILL: [&str; 3] = ["scenes/penumbra.pbrt", "scenes/cornell.pbrt", "scenes/plates.pbrt"];
/// Scenes of moving rungs.
const MOVING: [&str; 2] = ["scenes/penumbra.pbrt", "scenes/moving.pbrt"];
/// Minutes of a quick ladder, and of a full one.
const QUICK_MINUTES: f64 = 7.0;
const MINUTES: f64 = 120.0;

pub(super) fn run(args: &VerifyArgs) -> Result<Status> {
    if args.reference.reference.is_some() {
        return Err(Error::usage(
            "--reference is one picture, but a ladder has many scenes: leave out either",
        ));
    }
    if args.changes.motion.is_some() {
        return Err(Error::usage(
            "--motion is one motion, but a ladder's rungs have their own: leave out either",
        ));
    }
    // A wrong name is found before scenes are loaded.
    let (entry, keys) = techniques::find(REGISTRY, &args.technique)?;
    let trial = args.trial()?;
    let keep = if args.quick { None } else { Some(Keep::beside(&trial.reference, args.fresh)?) };
    let ladder = Ladder {
        rungs: args.rungs.clone(),
        minutes: Some(args.minutes.unwrap_or(if args.quick { QUICK_MINUTES } else { MINUTES })),
        trial: Trial { keep, ..trial },
    };
    let (still, moving) = if args.scenes.is_empty() {
        (
            sessions(args, entry, &defaults(args, &STILL)?)?,
            sessions(args, entry, &defaults(args, &MOVING)?)?,
        )
    } else {
        let own = sessions(args, entry, &args.scenes)?;
        (own.clone(), own)
    };
    let begin = Instant::now();
    let scenes = LadderScenes { still: &still, moving: &moving };
    if args.plan {
        let seen = |rung: &PlannedRung| note(&plan_cells(rung).join("  "));
        let planned = ladder.plan(entry, keys, scenes, seen)?;
        print(&plan_table(&planned))?;
        return Ok(Status::Done);
    }
    let found = ladder.run(entry, keys, scenes, |row| note(&cells(row).join("  ")))?;
    let text = markdown(&ladder, &found, &still[0], begin.elapsed().as_secs_f64());
    print(&text)?;
    if let Some(path) = &args.out {
        write_atomic(path, |w| w.write_all(text.as_bytes()))?;
    }
    if found.interrupted {
        return Ok(Status::Interrupted);
    }
    let failed = found.rows.iter().any(LadderRow::failed);
    Ok(if failed && args.check { Status::CheckFailed } else { Status::Done })
}

/// Those of the repository's scenes that rungs stand on where none is named.
fn defaults(args: &VerifyArgs, all: &[&str]) -> Result<Vec<String>> {
    existing(if args.quick { &all[..1] } else { all })
}

fn sessions(args: &VerifyArgs, entry: &Entry, scenes: &[String]) -> Result<Vec<Session>> {
    let mut picture = args.picture.clone();
    picture.depth = picture.depth.or_else(|| Ladder::depth(entry));
    scenes.iter().map(|scene| args.open(scene, &picture, None)).collect()
}

/// A row of the table.
fn cells(row: &LadderRow) -> Vec<String> {
    let worst = |found: &Option<(u32, Part)>| {
        found.as_ref().map_or_else(String::new, |(frames, part)| {
            let place = place(part);
            let place = if place.is_empty() { place } else { format!("{place} ") };
            format!("{} {place}at {frames}", percent(part, row.confidence))
        })
    };
    let ages: Vec<String> = row.ages.iter().map(u32::to_string).collect();
    let [first, last] = row.restarts;
    vec![
        row.rung.to_string(),
        format!("`{}`", row.technique),
        scene_name(&row.scene),
        match &row.claim {
            Claim::Biased(_) => "biased".to_string(),
            other => other.to_string(),
        },
        ages.join(", "),
        verdict(&row.claim, row.verdict).to_string(),
        worst(&row.worst_image),
        worst(&row.worst_tile),
        if first == last { first.to_string() } else { format!("{first} to {last}") },
        format!("{}, stage {}", row.number, row.stage),
    ]
}

/// Restarts and minutes of rungs that are not decided, and of all together.
fn plan_table(planned: &[PlannedRung]) -> String {
    const COLUMNS: [&str; 8] =
        ["rung", "spec", "scene", "ages", "restarts", "done", "minutes", "seeds"];
    let body: Vec<Vec<String>> = planned.iter().map(plan_cells).collect();
    let mut text = align(&COLUMNS.map(String::from), &body);
    let seconds: f64 =
        planned.iter().filter_map(|rung| rung.cost.as_ref()).map(|c| c.seconds).sum();
    let _ = writeln!(
        text,
        "\n{} rungs to be decided, {:.1} minutes in all, without references. A first stage that is no pass, of a claim of no bias, is followed by a second one \
         of four times as many restarts.",
        planned.len(),
        seconds / 60.0
    );
    text
}

/// A row of that table.
fn plan_cells(rung: &PlannedRung) -> Vec<String> {
    let head = [rung.rung.to_string(), format!("`{}`", rung.technique), scene_name(&rung.scene)];
    let rest = match &rung.cost {
        None => ["", "", "", ""].map(String::from),
        Some(cost) => {
            let ages: Vec<String> = cost.ages.iter().map(u32::to_string).collect();
            let ends = [cost.restarts.first(), cost.restarts.last()];
            let [first, last] = ends.map(|count| count.copied().unwrap_or(0));
            [
                ages.join(", "),
                if first == last { first.to_string() } else { format!("{first} to {last}") },
                cost.done.to_string(),
                format!("{:.2}", cost.seconds / 60.0),
            ]
        }
    };
    let stage = rung.cost.as_ref().map_or(1, |cost| cost.stage);
    let seeds = [format!("{}, stage {stage}", rung.number)];
    head.into_iter().chain(rest).chain(seeds).collect()
}

/// What a measurement says about a claim. Only a technique that claims to be unbiased can fail.
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
    let stem = Path::new(scene).file_stem().map(|s| s.to_string_lossy().into_owned());
    stem.unwrap_or_else(|| scene.to_string())
}

fn markdown(ladder: &Ladder, found: &LadderOutcome, first: &Session, seconds: f64) -> String {
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
    let Shot { size: [width, height], depth, run, .. } = first.shot;
    let mut text = format!(
        "`{}`, commit {}, {}; {seconds:.0} s.\n\n",
        command_line(),
        machine::commit(),
        machine::describe()
    );
    let _ = writeln!(
        text,
        "{width}x{height} on {}, depth {depth}. Margins: {} % of the image, {} % of a tile (of at least a tenth of the image's mean), luminance and each \
         channel, at every age. Brackets: 99.9 % intervals, the reference's error included; a pass has all of them inside the margins.\n",
        scene_name(&first.scene),
        100.0 * ladder.trial.delta,
        200.0 * ladder.trial.delta
    );
    let header = COLUMNS.map(String::from);
    let body: Vec<Vec<String>> = found.rows.iter().map(cells).collect();
    text.push_str(&align(&header, &body));
    let reason = |row: &LadderRow| match &row.claim {
        Claim::Biased(why) => Some((row.technique.clone(), why.clone())),
        _ => None,
    };
    let mut reasons: Vec<(String, String)> = found.rows.iter().filter_map(reason).collect();
    reasons.dedup();
    for (spec, why) in reasons {
        let _ = writeln!(text, "\n`{spec}` is biased: {why}.");
    }
    let _ = writeln!(
        text,
        "\nSeeds derive from --seed {run}, the row's number and stage, and the restart, from 0. Stage 2 has none of the restarts of stage 1."
    );
    if found.interrupted && ladder.trial.keep.is_none() {
        text.push_str("\nStopped by the user: the rungs below were not tried.\n");
    } else if !found.open.is_empty() {
        let why = if found.interrupted { "Stopped by the user" } else { "The time was up" };
        let _ = writeln!(
            text,
            "\n{why} before these rungs were decided; the same command goes on with them.\n"
        );
        text.push_str(&plan_table(&found.open));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_claim_of_no_bias_can_fail() {
        let biased = Claim::Biased("it forgets".to_string());
        assert_eq!(verdict(&Claim::Unbiased, Verdict::Fail), "fail");
        assert_eq!(verdict(&biased, Verdict::Fail), "biased as claimed");
        assert!(verdict(&biased, Verdict::Pass).contains("within"));
        assert!(verdict(&Claim::Consistent, Verdict::Fail).contains("consistency"));
    }
}
