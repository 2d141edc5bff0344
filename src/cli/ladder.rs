//! `verify --ladder`: the table of a [`Ladder`].

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::Instant;

use super::command_line::command_line;
use super::part::{percent, place};
use super::verify::{VerifyArgs, existing};
use super::{Status, note, print};
use crate::experiment::{Ladder, LadderOutcome, LadderRow, LadderScenes, Session, machine};
use crate::plan::{Claim, Shot};
use crate::report::{align, write_atomic};
use crate::stats::{Part, Verdict};
use crate::techniques::{self, REGISTRY};
use crate::{Error, Result};

/// Scenes of still rungs, the most telling first.
const STILL: [&str; 4] = [
    "scenes/penumbra.pbrt",
    "scenes/cornell.pbrt",
    "scenes/many_lights.pbrt",
    "scenes/plates.pbrt",
];
/// Scenes of moving rungs.
const MOVING: [&str; 2] = ["scenes/penumbra.pbrt", "scenes/moving.pbrt"];
/// Minutes of a quick ladder.
const QUICK_MINUTES: f64 = 7.0;

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
    let ladder = Ladder {
        rungs: args.rungs.clone(),
        minutes: args.minutes.or(args.quick.then_some(QUICK_MINUTES)),
        trial: args.trial()?,
    };
    let (still, moving) = if args.scenes.is_empty() {
        (sessions(args, &defaults(args, &STILL)?)?, sessions(args, &defaults(args, &MOVING)?)?)
    } else {
        let own = sessions(args, &args.scenes)?;
        (own.clone(), own)
    };
    let begin = Instant::now();
    let scenes = LadderScenes { still: &still, moving: &moving };
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

fn sessions(args: &VerifyArgs, scenes: &[String]) -> Result<Vec<Session>> {
    let mut picture = args.picture.clone();
    picture.depth = Some(picture.depth.unwrap_or(Ladder::DEPTH));
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
    if found.interrupted {
        text.push_str("\nStopped by the user: the rungs below were not tried.\n");
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
