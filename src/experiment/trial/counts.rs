//! How many restarts reach each age of a trial.

/// Fewer restarts leave Student's quantiles wide, and a skewness unseen that would shift them.
pub(super) const FEWEST: u32 = 64;

/// Restarts that reach each age: never more than reach the one before.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Counts(pub Vec<u32>);

impl Counts {
    /// All of `count` restarts reach the last age.
    pub(super) fn all(ages: &[u32], count: u32) -> Self {
        Self(vec![count; ages.len()])
    }

    /// As many as each age needs. A restart that reaches an age has been at those before.
    pub(super) fn wanted(mut wanted: Vec<u32>) -> Self {
        let mut later = FEWEST;
        for count in wanted.iter_mut().rev() {
            *count = (*count).max(later);
            later = *count;
        }
        Self(wanted)
    }

    pub(super) fn at_most(mut self, most: u32) -> Self {
        self.0.iter_mut().for_each(|count| *count = (*count).min(most.max(FEWEST)));
        self
    }

    pub(super) fn times(&self, factor: u32) -> Self {
        Self(self.0.iter().map(|count| count.saturating_mul(factor)).collect())
    }

    /// Of the restarts before number `done`.
    pub(super) fn up_to(&self, done: u32) -> Self {
        Self(self.0.iter().map(|count| (*count).min(done)).collect())
    }

    /// How many ages the restart of this number reaches.
    pub(super) fn reached(&self, index: u32) -> usize {
        self.0.iter().take_while(|count| index < **count).count()
    }

    /// Frames to render in all.
    pub(super) fn frames(&self, ages: &[u32]) -> u64 {
        let next = self.0[1..].iter().chain(&[0]);
        let ending = self.0.iter().zip(next).map(|(here, next)| here - next);
        ending.zip(ages).map(|(count, &age)| u64::from(count) * u64::from(age)).sum()
    }

    /// Fewer of all, but never fewer than [`FEWEST`], so that about `frames` frames are rendered.
    pub(super) fn within(self, ages: &[u32], frames: f64) -> Self {
        let share = (frames / self.frames(ages) as f64).min(1.0);
        let fewer = |count: u32| ((share * f64::from(count)) as u32).max(FEWEST.min(count));
        Self(self.0.into_iter().map(fewer).collect())
    }
}
