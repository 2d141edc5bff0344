//! Lobes that learn where light comes from: the Markov-chain mixture of von Mises–Fisher lobes, and
//! the stochastic multiple importance sampling that makes it unbiased whatever the lobes are.
//!
//! | symbol | here | meaning |
//! |---|---|---|
//! | ȳ | [`LobeState::target`] | weighted mean of the places that light came from; of skies the mean direction |
//! | r̄ | [`LobeState::spread`] is 1 − r̄ | mean cosine of the directions around the one to ȳ |
//! | w̄ | [`LobeState::weight`] | running mean of the scores, 0: no lobe |
//! | f | [`LobeState::score`] | score of the sample that the lobe's chain last moved to |
//! | N | [`LobeState::count`] | samples that the lobe has learnt from |
//! | `N_p`, `r_p` | [`Prior`] | samples that the lobe is worth before the first, and their mean cosine |
//! | V | [`Lobe::density`] | von Mises–Fisher density of a lobe as a receiver sees it |
//! | `p_h`, `p_ℓ` | | densities of BSDF sampling and of light sampling at the receiver |
//! | b, c | [`Shares`] | shares of BSDF sampling and of light sampling in each technique |
//! | p(ω) | [`Shares::density`] | c `p_ℓ` + (1 − c)(b `p_h` + (1 − b) V): one technique, as the mixture of its branches |
//!
//! A technique is a lobe with the defensive branches around it; where a pixel has no lobe, V is
//! `p_h`. States are handed from pixel to pixel and frame to frame as they are: a target is a place
//! in the world, and each receiver makes a lobe of its own of it ([`Shape::at`]). Nothing is
//! shifted between pixels, so no Jacobian takes part. Between frames a lobe follows the light that
//! it was born of ([`follow`]).
//!
//! # When the mean is right
//!
//! Given all techniques whose densities stand below the line of an estimate, each sample is
//! distributed as its own technique says, and (for one sample of T techniques) the technique is
//! chosen uniformly; and the set covers what is integrated. Nothing is asked of how the techniques
//! came to be. So no path may lead from a sample's numbers to a technique of the same estimate:
//!
//! | estimator | why none does |
//! |---|---|
//! | ssmis: one sample a step, mean density of the tile's T lobes | the set is fixed before the draw, and the lanes' lobes are turned by a number of the tile's own |
//! | tsmis: n samples a pixel, the sum of its own n techniques' densities | states move on one lane before each step, so a sample meets the pixel that drew it after T ≥ n steps only |
//! | mixture: one sample of K lobes mixed by score | the lobes are loaded before the draw |
//!
//! Papers: A. Dittebrandt, V. Schüßler, J. Hanika, S. Herholz, C. Dachsbacher (2023), *Markov Chain
//! Mixture Models for Real-Time Direct Illumination*; R. West, I. Georgiev, A. Gruson, T. Hachisuka
//! (2020), *Continuous Multiple Importance Sampling* (stochastic MIS); L. Alber, J. Hanika, C.
//! Dachsbacher (2025), *Real-Time Markov Chain Path Guiding* (the mixture of K lobes).

mod chain;
pub mod follow;
mod reads;
mod set;
mod shares;
mod state;
#[cfg(test)]
mod tests;

pub use chain::LobeChain;
pub(crate) use reads::Reads;
pub use set::{Densities, Lobe, LobeSet, MOST_LOBES, Shape, Weights};
pub use shares::{Branch, Evaluated, Permutation, SetConditions, SetSample, Shares, StochasticMis};
pub use state::{Found, Learning, LobeState, Prior};
