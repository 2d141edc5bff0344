//! Initial visibility is folded into W (Bitterli et al. 2020, alg. 5): an occluded fresh sample is
//! dropped, although targets know no visibility. Biased: a pixel that sees what a neighbour does
//! not never gets it from there.

use super::Policy;

/// [`super::Visibility::Bitterli`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bitterli;

impl Policy for Bitterli {
    const DROPS_OCCLUDED: bool = true;
    const SHADES_BY_RAY: bool = true;
}
