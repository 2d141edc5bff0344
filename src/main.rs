//! The `afterimage` command.

fn main() -> std::process::ExitCode {
    afterimage::cli::run()
}
