//! What an experiment tells the program that runs it, and how that program stops it.

use std::fmt;

/// A program that runs experiments. Every method has a default that does nothing, so a host
/// implements what it has a use for; [`Silent`] implements none.
///
/// ```
/// use afterimage::experiment::{Host, Silent, Steps};
///
/// /// Writes remarks and the name of each stretch of work to standard error.
/// #[derive(Debug)]
/// struct Loud;
///
/// impl Host for Loud {
///     fn begin(&self, what: &'static str, steps: u64) -> Box<dyn Steps> {
///         eprintln!("{what}: {steps} steps");
///         Box::new(Silent)
///     }
///
///     fn note(&self, text: &str) {
///         eprintln!("{text}");
///     }
/// }
/// ```
pub trait Host: fmt::Debug + Send + Sync {
    /// A stretch of work of `steps` steps begins. What is returned hears of them, and is dropped
    /// when the work ends, however it ends.
    fn begin(&self, _what: &'static str, _steps: u64) -> Box<dyn Steps> {
        Box::new(Silent)
    }

    /// A remark that is no error: a loader's warning, a stored reference that is made anew.
    fn note(&self, _text: &str) {}

    /// Whether to stop. It is called between any two frames; an experiment that was stopped returns
    /// an error that [is an interruption](crate::Error::is_interrupted), or what it has so far.
    fn stopped(&self) -> bool {
        false
    }
}

/// What hears of the steps of a stretch of work.
pub trait Steps {
    /// The step that runs now is about `text`.
    fn say(&self, _text: &str) {}

    /// A step is done.
    fn step(&self) {}

    /// `done` of `steps` steps are done, as far as is known now.
    fn set(&self, _done: u64, _steps: u64) {}
}

/// The host that shows nothing and never stops.
#[derive(Clone, Copy, Debug, Default)]
pub struct Silent;

impl Host for Silent {}

impl Steps for Silent {}
