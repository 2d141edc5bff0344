//! What a result promises about its mean.

use std::fmt;

/// What a result promises about its mean.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Claim {
    /// The expectation is the light transport up to the depth limit, in every frame.
    Unbiased,
    /// The expectation tends to it as frames or samples grow.
    Consistent,
    /// It does not; here is why.
    Biased(String),
}

impl Claim {
    /// Unbiased, unless there are reasons.
    #[must_use]
    pub fn unless(reasons: &[String]) -> Self {
        if reasons.is_empty() { Self::Unbiased } else { Self::Biased(reasons.join("; ")) }
    }
}

impl fmt::Display for Claim {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unbiased => f.write_str("unbiased"),
            Self::Consistent => f.write_str("consistent"),
            Self::Biased(why) => write!(f, "biased: {why}"),
        }
    }
}
