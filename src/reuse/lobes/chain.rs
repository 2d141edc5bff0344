//! The chain that decides which lobes live on.

use super::LobeState;
use crate::math::rng::RandomSource;
use crate::resampling::{Mutator, Proposal};

/// Independence Metropolis on a sample ω and the technique t that drew it, by scores f = F(ω)/p(ω |
/// t): a proposal is accepted with probability min(1, f'/f) (Dittebrandt et al. 2023, alg. 3).
///
/// Its target is P(t) F(ω), its proposals have the density P(t) p(ω | t), so their ratio is the
/// score's. The kernel keeps that target exactly where t is drawn independently of the chain's
/// state. Where t is the chain's own lobe it does not (with F = (3, 1) a step leaves (13/5, 7/5)),
/// and need not: the mean of a pixel asks nothing of how lobes came to be.
#[derive(Debug)]
pub struct LobeChain<D>(pub D);

impl<D: FnMut() -> Option<LobeState>> Mutator for LobeChain<D> {
    type State = LobeState;

    /// Proposes the lobe that the technique's draw makes; `None` where the draw found nothing. A
    /// state without a score is left at once.
    #[inline]
    fn propose(
        &mut self,
        state: &LobeState,
        _random: &mut impl RandomSource,
    ) -> Option<Proposal<LobeState>> {
        let proposed = (self.0)()?;
        let ratio = proposed.score / state.score;
        // Written so that 0/0 and x/0 accept.
        let acceptance = if ratio < 1.0 && state.is_some() { ratio } else { 1.0 };
        Some(Proposal { state: proposed, acceptance })
    }
}
