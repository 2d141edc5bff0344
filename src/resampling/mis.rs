//! MIS weights of resampling, as pure functions of targets and confidences.
//!
//! For a sample y in the canonical domain, fromⱼ = p̂←ⱼ(y) is input j's target there, and C = Σ cⱼ
//! over all accepted inputs, cκ the canonical's.
//!
//! | family | weight of input i at y | shifts | unbiased |
//! |---|---|---|---|
//! | [`Family::Constant`] | cᵢ / C | k | only where every input reaches whatever the canonical integrand needs (1/M) |
//! | [`Family::InverseCount`] | cᵢ / Σ cⱼ over fromⱼ > 0, at the selected y | ≤ 2k | yes, if the inputs' supports are those of their targets (1/Z) |
//! | [`Family::Contribution`] | cᵢ fromₛ / Σ cⱼ fromⱼ at the selected y, s its source | ≤ 2k | the same; Bitterli et al. 2020, eq. 22 |
//! | [`Family::Balance`] | cᵢ fromᵢ / Σ cⱼ fromⱼ | k (k + 1) | yes (Talbot; Lin et al. 2022, eq. 36) |
//! | [`Family::Pairwise`] | pairs with the canonical, shares cⱼ / (C − cκ) | 2k | yes |
//! | [`Family::DefensivePairwise`] | the same with shares cⱼ / C, and cκ / C for the canonical alone | 2k | yes, and mκ ≥ cκ / C |
//!
//! All need cκ > 0 and a canonical sample that can be drawn wherever the canonical target is
//! positive.

/// Which MIS weights a merge uses; see the module's table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Family {
    /// Cheapest; darkens where neighbours cannot reach what this pixel sees.
    Constant,
    /// Counts who could have made the selected sample; noisy where targets differ.
    InverseCount,
    /// As `InverseCount`, weighted by targets; the bound on weights that others have is missing.
    Contribution,
    /// Least noise, quadratic cost.
    Balance,
    /// Linear cost; noisy where all neighbours differ from this pixel.
    Pairwise,
    /// Linear cost, and never much noisier than no reuse.
    #[default]
    DefensivePairwise,
}

impl Family {
    /// All, in the order of the module's table.
    pub const ALL: [Self; 6] = [
        Self::Constant,
        Self::InverseCount,
        Self::Contribution,
        Self::Balance,
        Self::Pairwise,
        Self::DefensivePairwise,
    ];

    /// As in a SPEC.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::InverseCount => "inverse-count",
            Self::Contribution => "contribution",
            Self::Balance => "balance",
            Self::Pairwise => "pairwise",
            Self::DefensivePairwise => "defensive",
        }
    }

    /// Whether the weights sum to 1 over the inputs that reach a sample, so that a merge is
    /// unbiased whatever the supports.
    #[must_use]
    pub const fn partitions_unity(self) -> bool {
        !matches!(self, Self::Constant)
    }

    /// Whether the same holds for the weights of the single terms, so that their sum may be shown
    /// as well as the selected sample. `InverseCount` and `Contribution` know their weights only
    /// after the selection: their terms have constant ones.
    #[must_use]
    pub const fn terms_partition_unity(self) -> bool {
        matches!(self, Self::Balance | Self::Pairwise | Self::DefensivePairwise)
    }
}

/// x / (x + y) for x ≥ 0 and y ≥ 0; 0 where x is 0. By the ratio, so that neither product nor sum
/// overflows.
#[inline]
#[must_use]
pub fn share(x: f32, y: f32) -> f32 {
    if x > 0.0 { 1.0 / (1.0 + y / x) } else { 0.0 }
}

/// Weight of input i among all: cᵢ fromᵢ / Σ cⱼ fromⱼ, `others` being the pairs (cⱼ, fromⱼ) of the
/// other inputs.
#[inline]
#[must_use]
pub fn balance(own: (f32, f32), others: impl Iterator<Item = (f32, f32)>) -> f32 {
    let (confidence, target) = own;
    if confidence <= 0.0 || target <= 0.0 {
        return 0.0;
    }
    // Ratios of targets: sums of huge targets would overflow. A ratio may still be infinite, so
    // what counts for nothing is left out.
    let rivals = others.filter(|&(c, _)| c > 0.0);
    1.0 / (1.0 + rivals.map(|(c, from)| c / confidence * (from / target)).sum::<f32>())
}

/// The two confidences that pairwise weights of one merge share.
#[derive(Clone, Copy, Debug)]
pub struct Pairwise {
    /// cκ.
    pub canonical: f32,
    /// C − cκ.
    pub others: f32,
    /// Whether the canonical keeps a share of its own.
    pub defensive: bool,
}

impl Pairwise {
    /// What input j's pair is worth.
    #[inline]
    #[must_use]
    pub fn pair(&self, confidence: f32) -> f32 {
        confidence / if self.defensive { self.canonical + self.others } else { self.others }
    }

    /// Weight of input j at its own sample; `from` = p̂←ⱼ(y) there, `target` = p̂(y).
    #[inline]
    #[must_use]
    pub fn other(&self, confidence: f32, from: f32, target: f32) -> f32 {
        if from <= 0.0 {
            return 0.0;
        }
        self.pair(confidence) / (1.0 + self.canonical / self.others * (target / from))
    }

    /// The canonical's part of input j's pair, at the canonical sample; `from` = p̂←ⱼ(y) there,
    /// `target` = p̂(y) > 0.
    #[inline]
    #[must_use]
    pub fn canonical_part(&self, confidence: f32, from: f32, target: f32) -> f32 {
        self.pair(confidence) / (1.0 + self.others / self.canonical * (from / target))
    }

    /// The canonical's share besides the pairs.
    #[inline]
    #[must_use]
    pub fn canonical_alone(&self) -> f32 {
        if self.defensive { self.canonical / (self.canonical + self.others) } else { 0.0 }
    }
}

/// All weights of a family at one sample y, input 0 being the canonical: the plain form that the
/// partition of unity is tested on. `from` are p̂←ⱼ(y). For 1/Z and contribution weights entry i is
/// what a sample that was selected from input i counts.
#[must_use]
pub fn weights(family: Family, confidences: &[f32], from: &[f32]) -> Vec<f32> {
    let n = confidences.len();
    let total: f32 = confidences.iter().sum();
    let pairwise = Pairwise {
        canonical: confidences[0],
        others: total - confidences[0],
        defensive: family == Family::DefensivePairwise,
    };
    (0..n)
        .map(|i| match family {
            Family::Constant => confidences[i] / total,
            Family::InverseCount => {
                let reach: f32 = (0..n).filter(|&j| from[j] > 0.0).map(|j| confidences[j]).sum();
                if from[i] > 0.0 { confidences[i] / reach } else { 0.0 }
            }
            Family::Contribution | Family::Balance => balance(
                (confidences[i], from[i]),
                (0..n).filter(|&j| j != i).map(|j| (confidences[j], from[j])),
            ),
            Family::Pairwise | Family::DefensivePairwise if n == 1 || pairwise.others <= 0.0 => {
                f32::from(u8::from(i == 0))
            }
            Family::Pairwise | Family::DefensivePairwise if i == 0 => {
                let parts =
                    (1..n).map(|j| pairwise.canonical_part(confidences[j], from[j], from[0]));
                pairwise.canonical_alone() + if from[0] > 0.0 { parts.sum() } else { 0.0 }
            }
            Family::Pairwise | Family::DefensivePairwise => {
                pairwise.other(confidences[i], from[i], from[0])
            }
        })
        .collect()
}
