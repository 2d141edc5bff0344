//! Ctrl-C: the first asks the run to stop between two frames and write what it has, the second ends
//! the process.

use std::sync::Once;
use std::sync::atomic::{AtomicBool, Ordering};

/// Exit status of an interrupted run: 128 + SIGINT, as shells report it.
pub(super) const STATUS: u8 = 130;

static ASKED: AtomicBool = AtomicBool::new(false);
static INSTALLED: Once = Once::new();

/// Starts to listen. Where the system has no such signal, runs cannot be interrupted cleanly, and
/// that is all.
pub(super) fn listen() {
    INSTALLED.call_once(|| {
        let _ = ctrlc::set_handler(|| {
            if ASKED.swap(true, Ordering::SeqCst) {
                std::process::exit(i32::from(STATUS));
            }
        });
    });
}

/// Whether the user asked to stop.
pub(super) fn asked() -> bool {
    ASKED.load(Ordering::SeqCst)
}
