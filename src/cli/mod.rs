//! The `afterimage` command: parsed arguments to an experiment to a report. One module a command;
//! what they run is in [`crate::experiment`].
//!
//! Exit status: 0 done; 1 a verdict failed where `--check` asked for it; 2 bad input or options,
//! with the reason in one line on standard error; 130 stopped by Ctrl-C, after whole files of what
//! was done were written.
//!
//! Figures and tables go to standard output; progress, warnings and errors to standard error.

mod args;
mod command_line;
mod compare;
mod diff;
mod generate;
mod host;
mod inspect;
mod interrupt;
mod ladder;
mod lag;
mod list;
mod part;
mod plan;
mod progress;
mod render;
mod verify;

use std::io::Write as _;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

use crate::Result;

const EXAMPLES: &str = "\
Examples:
  afterimage compare scenes/cornell.pbrt
        all techniques at equal frame time: table, plot and pictures in out/cornell
  afterimage compare many-lights:1000 --techniques 'nee;bsdf' --spp 4 --restarts 30
        two techniques at equal effort on a generated scene
  afterimage render scenes/glass.pbrt --spp 256 --out glass.exr
        one picture, with glass.png beside it
  afterimage verify nee scenes/penumbra.pbrt --check
        is it unbiased? exit status 1 if not
  afterimage verify nee --ladder --quick
        rung by rung: still, moving camera, light, occluder
  afterimage lag scenes/penumbra.pbrt --technique nee
        how many frames does a sudden change take to show?
  afterimage plan scenes/cornell.pbrt --technique nee
        what runs, what is skipped, and why

`afterimage COMMAND --help` explains each command.";

#[derive(Parser, Debug)]
#[command(
    name = "afterimage",
    version,
    about = "Runs light-sample reuse methods on a scene and measures them against each other",
    after_help = EXAMPLES,
    max_term_width = 120
)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    Compare(compare::CompareArgs),
    Render(render::RenderArgs),
    Verify(verify::VerifyArgs),
    Lag(lag::LagArgs),

    Inspect(inspect::InspectArgs),
    Plan(plan::PlanArgs),
    Diff(diff::DiffArgs),
    Generate(generate::GenerateArgs),
    List(list::ListArgs),
}

/// How a command ended, where it did not end in an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Status {
    /// As asked.
    Done,
    /// A verdict failed and `--check` was given.
    CheckFailed,
    /// Stopped by the user; what was done is written.
    Interrupted,
}

/// Runs the command that the process' arguments ask for.
#[must_use]
pub fn run() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    interrupt::listen();
    let result = match &cli.command {
        Command::Compare(args) => compare::run(args),
        Command::Render(args) => render::run(args),
        Command::Verify(args) => verify::run(args),
        Command::Lag(args) => lag::run(args),

        Command::Inspect(args) => inspect::run(args),
        Command::Plan(args) => plan::run(args),
        Command::Diff(args) => diff::run(args),
        Command::Generate(args) => generate::run(args),
        Command::List(args) => list::run(args),
    };
    match result {
        Ok(Status::Done) => ExitCode::SUCCESS,
        Ok(Status::CheckFailed) => ExitCode::from(1),
        Ok(Status::Interrupted) => ExitCode::from(interrupt::STATUS),
        Err(error) if error.is_interrupted() => {
            eprintln!("{error}");
            ExitCode::from(interrupt::STATUS)
        }
        Err(error) => {
            eprintln!("error: {}", one_line(&error.to_string()));
            ExitCode::from(2)
        }
    }
}

/// Help and version go to standard output; a wrong option becomes one line on standard error.
fn usage(error: &clap::Error) -> ExitCode {
    use clap::error::ErrorKind;
    match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            // A closed pipe is the reader's wish.
            let _ = error.print();
            ExitCode::SUCCESS
        }
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            let _ = error.print();
            ExitCode::from(2)
        }
        _ => {
            eprintln!("{}", one_line(&error.to_string()));
            ExitCode::from(2)
        }
    }
}

/// The reason without the usage lines that clap adds, on one line.
fn one_line(text: &str) -> String {
    let reason = text.lines().map(str::trim).take_while(|l| !l.starts_with("Usage:"));
    let parts: Vec<&str> =
        reason.filter(|l| !l.is_empty() && !l.starts_with("For more information")).collect();
    parts.join(" ")
}

/// Prints to standard output. A reader that has gone away (`| head`) is no error.
fn print(text: &str) -> Result<()> {
    let mut out = std::io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(crate::Error::io("standard output", e))
        }
        _ => Ok(()),
    }
}

/// A line on standard error that is no error.
fn note(text: &str) {
    progress::aside(|| eprintln!("{text}"));
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory as _;

    #[test]
    fn the_definition_is_sound_and_every_command_teaches_by_example() {
        let mut command = Cli::command();
        command.clone().debug_assert();
        assert!(command.render_long_help().to_string().contains("Examples:"));
        for sub in command.get_subcommands_mut().filter(|sub| sub.get_name() != "help") {
            let help = sub.render_long_help().to_string();
            assert!(help.contains("Example"), "{}", sub.get_name());
        }
    }

    #[test]
    fn usage_errors_are_one_line() {
        for line in [
            "compare",
            "compare x --spp 1 --frame-time 2",
            "render x --depth 0",
            "compar x",
            "diff a.exr",
        ] {
            let words = ["afterimage"].into_iter().chain(line.split(' '));
            let error = Cli::try_parse_from(words).unwrap_err();
            let text = one_line(&error.to_string());
            assert!(
                text.starts_with("error: ") && !text.contains('\n') && !text.contains("Usage"),
                "{text}"
            );
        }
    }
}
