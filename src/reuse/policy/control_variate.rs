//! Outcomes correct an estimate that is kept beside the reservoir (Tokuyoshi 2024): the passes do
//! the arithmetic, with [`super::super::Control`] as the state.

use super::Policy;

/// [`super::Visibility::WisControlVariate`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct WisControlVariate;

impl Policy for WisControlVariate {
    const TRACES_TERMS: bool = true;
    const KEEPS_OUTCOME: bool = true;
    const CONTROL: bool = true;
}
