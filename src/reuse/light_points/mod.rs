//! Direct light at a primary hit: the domain whose samples are light points.
//!
//! | here | meaning |
//! |---|---|
//! | [`Receiver`] | a primary hit with its view, its lights and its frame: all that the integrand depends on besides the light point |
//! | F(y) | f(ωₒ, ω) \|cos\| Lₑ G: the integrand over light points, without visibility; all lobes that are not deltas |
//! | p̂(y) | luminance of F, times visibility where the policy says so |
//! | [`LightMeasure`] | area on shapes, solid angle on environments, counting on point, spot and distant lights |
//! | [`LightPointShift`] | the shift: a light point keeps its place on its light; \|∂T\| is the ratio of the light's areas |
//! | [`Record`] | a finished reservoir as it lies in a buffer: 24 bytes |
//!
//! Candidates come from light sampling and from BSDF sampling with one mixture density (balance
//! heuristic). BSDF sampling takes *all* points of emitters along its ray, occluded ones too: the
//! target knows no visibility, so neither may the source. (Taking the first hit only makes the
//! source blind to points that another pixel sees, which biases every reuse of the sample by up to
//! the BSDF's share.)

mod candidates;
mod domain;
mod initial;
mod mutate;
mod receiver;
mod record;
mod sources;
#[cfg(test)]
mod tests;
pub(crate) mod twin;

pub use candidates::{Candidates, Chosen, TileEntry, candidates, fill_tile};
pub(crate) use domain::LightPoints;
pub(crate) use initial::{Sources, TILES};
pub use mutate::{LightPointMutator, PointState};
pub use receiver::{LightMeasure, LightPointShift, Receiver, Sight, Time};
pub use record::Record;
pub use sources::LightTiles;
pub(crate) use sources::{PATHS, Supplied, Supply};
