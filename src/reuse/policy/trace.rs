//! A ray at shading; nothing is kept.

use super::Policy;

/// [`super::Visibility::Trace`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trace;

impl Policy for Trace {
    const TRACES_INITIAL: bool = false;
    const SHADES_BY_RAY: bool = true;
}
