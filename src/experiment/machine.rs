//! Where and with what a run was made.

use std::process::Command;

/// The commit this binary was built from: `AFTERIMAGE_COMMIT` of the build, else that of the
/// checkout it was built in (with `+` where files differ from it), else `unknown`. A binary older
/// than its checkout names the checkout's.
pub(crate) fn commit() -> String {
    if let Some(commit) = option_env!("AFTERIMAGE_COMMIT") {
        return commit.to_string();
    }
    let folder = env!("CARGO_MANIFEST_DIR");
    let git = |arguments: &[&str]| {
        let output = Command::new("git").arg("-C").arg(folder).args(arguments).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_string())
    };
    // An unpacked package inside some other repository is not that repository's commit.
    if !std::path::Path::new(folder).join(".git").exists() {
        return "unknown".to_string();
    }
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else {
        return "unknown".to_string();
    };
    let changed =
        git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|s| !s.is_empty());
    if changed { format!("{commit}+") } else { commit }
}

/// Processor, threads in use, operating system.
pub(crate) fn describe() -> String {
    let processor = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|text| {
            text.lines().find_map(|l| {
                l.strip_prefix("model name")?.split_once(':').map(|(_, v)| v.trim().to_string())
            })
        })
        .unwrap_or_else(|| std::env::consts::ARCH.to_string());
    format!("{processor}, {} threads, {}", rayon::current_num_threads(), std::env::consts::OS)
}
