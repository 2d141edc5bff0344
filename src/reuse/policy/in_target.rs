//! Visibility in every target: what was selected is seen, so shading needs no ray.

use super::Policy;

/// [`super::Visibility::InTarget`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct InTarget;

impl Policy for InTarget {
    const IN_TARGET: bool = true;
    const DROPS_OCCLUDED: bool = true;

    fn visibility(self, _bits: u16) -> Option<f32> {
        Some(1.0)
    }
}

/// The same beside an estimate of the pixel that all inputs of its merges correct: noise in colour,
/// which a reservoir that selects by luminance keeps, averages out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InTargetControl;

impl Policy for InTargetControl {
    const IN_TARGET: bool = true;
    const DROPS_OCCLUDED: bool = true;
    const CONTROL: bool = true;
}
