//! Progress bars with the time left, on standard error; hidden where it is no terminal.

use std::sync::LazyLock;
use std::time::Duration;

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};

use crate::experiment::Steps;

/// Bars of a run, one below the other: a ladder has one, and each of its rungs others.
static BARS: LazyLock<MultiProgress> = LazyLock::new(MultiProgress::new);

/// Does what writes to standard error while no bar is drawn.
pub(super) fn aside(write: impl FnOnce()) {
    BARS.suspend(write);
}

/// A bar of `steps` steps that vanishes when dropped.
pub(super) struct Progress {
    bar: ProgressBar,
}

impl Progress {
    pub(super) fn new(what: &'static str, steps: u64) -> Self {
        let bar = BARS.add(ProgressBar::new(steps));
        let template = "{prefix:>12} [{bar:32}] {pos}/{len} {msg} ({eta} left)";
        // The template is a constant; were it wrong, the plain bar would do.
        let style =
            ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(what);
        bar.enable_steady_tick(Duration::from_millis(200));
        Self { bar }
    }
}

impl Steps for Progress {
    fn say(&self, text: &str) {
        self.bar.set_message(text.to_string());
    }

    fn step(&self) {
        self.bar.inc(1);
    }

    fn set(&self, done: u64, steps: u64) {
        self.bar.set_length(steps.max(done));
        self.bar.set_position(done);
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
        BARS.remove(&self.bar);
    }
}
