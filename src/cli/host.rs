//! The terminal as the host of experiments: progress bars, remarks on standard error, Ctrl-C.

use std::sync::Arc;

use super::progress::Progress;
use super::{interrupt, note};
use crate::experiment::{Host, Steps};

/// See the module's head.
#[derive(Debug)]
pub(super) struct Terminal;

/// The one host of this program.
pub(super) fn terminal() -> Arc<dyn Host> {
    Arc::new(Terminal)
}

impl Host for Terminal {
    fn begin(&self, what: &'static str, steps: u64) -> Box<dyn Steps> {
        Box::new(Progress::new(what, steps))
    }

    fn note(&self, text: &str) {
        note(text);
    }

    fn stopped(&self) -> bool {
        interrupt::asked()
    }
}
