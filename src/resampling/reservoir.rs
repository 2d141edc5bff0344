//! Reservoirs: weighted reservoir sampling (Chao 1982) in its streaming form, and what it leaves
//! behind.

use std::fmt;
use std::marker::PhantomData;

use glam::Vec3;

use crate::math::rng::RandomSource;

/// The measure that a [`ContributionWeight`] is relative to, as a type: weights of different
/// measures cannot be mixed.
pub trait Measure: Copy + Default + fmt::Debug + PartialEq + 'static {
    /// For people.
    const NAME: &'static str;
}

/// Counting, or any measure that is the same for all domains: finite sets, toys, the unit interval.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Counting;

impl Measure for Counting {
    const NAME: &'static str = "counting";
}

/// The random numbers that a path is made of; a fresh path has W = 1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PrimarySample;

impl Measure for PrimarySample {
    const NAME: &'static str = "primary sample space";
}

/// An unbiased contribution weight W: E\[f(Y) W\] = ∫ f dμ for every f that is 0 where the sample's
/// source cannot reach, with μ the measure M.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(transparent)]
pub struct ContributionWeight<M>(f32, PhantomData<M>);

impl<M: Measure> ContributionWeight<M> {
    /// No sample.
    pub const ZERO: Self = Self(0.0, PhantomData);

    /// A weight, finite and not negative.
    #[inline]
    #[must_use]
    pub fn new(weight: f32) -> Self {
        debug_assert!(weight >= 0.0 && weight.is_finite(), "a contribution weight is {weight}");
        Self(weight, PhantomData)
    }

    /// As a number.
    #[inline]
    #[must_use]
    pub fn get(self) -> f32 {
        self.0
    }
}

/// What a reservoir leaves behind: one sample, its contribution weight, and how much it counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finished<S, M> {
    /// `None` exactly where the weight is 0.
    pub sample: Option<S>,
    /// W.
    pub weight: ContributionWeight<M>,
    /// c ≥ 0. An empty reservoir keeps its confidence: it says that there was nothing.
    pub confidence: f32,
}

impl<S, M: Measure> Finished<S, M> {
    /// No sample.
    #[must_use]
    pub fn empty(confidence: f32) -> Self {
        Self { sample: None, weight: ContributionWeight::ZERO, confidence }
    }

    /// A sample with W = `weight_sum` / `target` · `scale`; none where that is 0, or not finite, as
    /// 0/0 and x/0 are where p̂ is 0.
    #[inline]
    #[must_use]
    pub fn from_sum(
        sample: Option<S>,
        weight_sum: f32,
        target: f32,
        scale: f32,
        confidence: f32,
    ) -> Self {
        let weight = weight_sum / target * scale;
        match sample {
            Some(sample) if weight > 0.0 && weight.is_finite() => {
                Self { sample: Some(sample), weight: ContributionWeight::new(weight), confidence }
            }
            _ => Self::empty(confidence),
        }
    }
}

/// A stream of weighted candidates in, one finished sample out. The streaming form (this trait) and
/// the finished form ([`Finished`]) are two types, so Σw is never taken for W.
///
/// Laws:
/// 1. After candidates with weights w₁ … wₙ, candidate i is selected with probability wᵢ / Σw,
///    whatever their order.
/// 2. A candidate of weight 0 is never selected and changes neither Σw nor what was selected.
/// 3. `finish(p̂(Y), c)` has W = Σw / p̂(Y), and no sample where either is 0.
/// 4. A weight that is negative, infinite or NaN, or that would make Σw infinite, is counted by
///    `rejected` and changes nothing else.
///
/// Σw is summed in f32: with more than 2¹⁴ candidates of equal weight its error exceeds 5·10⁻⁵.
pub trait Reservoir: Default {
    /// What is chosen.
    type Sample: Copy;
    /// What each candidate brings besides, to be averaged over all candidates.
    type Carried: Copy;

    /// Takes a candidate; true if it is now the selected one.
    fn stream(
        &mut self,
        sample: Self::Sample,
        weight: f32,
        carried: Self::Carried,
        random: &mut impl RandomSource,
    ) -> bool;

    /// The selected candidate.
    fn selected(&self) -> Option<Self::Sample>;

    /// Σw.
    fn weight_sum(&self) -> f32;

    /// Candidates whose weight was not a finite number of at least 0.
    fn rejected(&self) -> u32;

    /// The finished form; `target` is p̂ of the selected sample.
    #[inline]
    fn finish<M: Measure>(&self, target: f32, confidence: f32) -> Finished<Self::Sample, M> {
        self.finish_scaled(1.0, target, confidence)
    }

    /// As [`finish`](Self::finish), W multiplied by `scale`: for MIS weights that are known only
    /// after the selection.
    #[inline]
    fn finish_scaled<M: Measure>(
        &self,
        scale: f32,
        target: f32,
        confidence: f32,
    ) -> Finished<Self::Sample, M> {
        Finished::from_sum(self.selected(), self.weight_sum(), target, scale, confidence)
    }
}

/// The methods that a wrapper passes on to the reservoir inside.
macro_rules! pass_on {
    () => {
        #[inline]
        fn selected(&self) -> Option<Self::Sample> {
            self.inner.selected()
        }

        #[inline]
        fn weight_sum(&self) -> f32 {
            self.inner.weight_sum()
        }

        #[inline]
        fn rejected(&self) -> u32 {
            self.inner.rejected()
        }
    };
}

/// Weighted reservoir sampling with nothing besides.
#[derive(Clone, Copy, Debug)]
pub struct Plain<S> {
    selected: Option<S>,
    weight_sum: f32,
    rejected: u32,
}

impl<S> Default for Plain<S> {
    #[inline]
    fn default() -> Self {
        Self { selected: None, weight_sum: 0.0, rejected: 0 }
    }
}

impl<S: Copy> Reservoir for Plain<S> {
    type Sample = S;
    type Carried = ();

    #[inline]
    fn stream(
        &mut self,
        sample: S,
        weight: f32,
        _carried: (),
        random: &mut impl RandomSource,
    ) -> bool {
        let sum = self.weight_sum + weight;
        // Written so that NaN fails too.
        if !(weight >= 0.0 && sum < f32::INFINITY) {
            self.rejected += 1;
            return false;
        }
        if weight == 0.0 {
            return false;
        }
        self.weight_sum = sum;
        let selected = random.choose(weight, sum);
        if selected {
            self.selected = Some(sample);
        }
        selected
    }

    #[inline]
    fn selected(&self) -> Option<S> {
        self.selected
    }

    #[inline]
    fn weight_sum(&self) -> f32 {
        self.weight_sum
    }

    #[inline]
    fn rejected(&self) -> u32 {
        self.rejected
    }
}

/// A reservoir that also averages what its candidates' shadow rays said: V̄ = Σ V̄ᵢ wᵢ / Σ wᵢ
/// (Tokuyoshi 2024, eq. 4), the mean of the visibility under the very distribution that the sample
/// is drawn from.
#[derive(Clone, Copy, Debug, Default)]
pub struct WithVisibility<R> {
    inner: R,
    visible: f32,
}

impl<R: Reservoir> WithVisibility<R> {
    /// V̄ in \[0, 1\]; 1 where nothing was streamed (W is 0 there, so it never counts).
    #[inline]
    #[must_use]
    pub fn visibility(&self) -> f32 {
        let sum = self.inner.weight_sum();
        // A mean of numbers in [0, 1] may round beyond 1.
        if sum > 0.0 { (self.visible / sum).min(1.0) } else { 1.0 }
    }

    /// The reservoir without the average.
    #[inline]
    #[must_use]
    pub fn inner(&self) -> &R {
        &self.inner
    }
}

impl<R: Reservoir> Reservoir for WithVisibility<R> {
    type Sample = R::Sample;
    type Carried = (R::Carried, f32);

    #[inline]
    fn stream(
        &mut self,
        sample: Self::Sample,
        weight: f32,
        (carried, visibility): Self::Carried,
        random: &mut impl RandomSource,
    ) -> bool {
        debug_assert!((0.0..=1.0).contains(&visibility), "a visibility is {visibility}");
        let rejected = self.inner.rejected();
        let selected = self.inner.stream(sample, weight, carried, random);
        if self.inner.rejected() == rejected {
            self.visible += visibility * weight;
        }
        selected
    }

    pass_on!();
}

/// A reservoir that also sums its candidates' own contributions, Σ mᵢ F(yᵢ) Wᵢ \|∂T\|: decoupled
/// shading. It has the mean of F(Y) W and less noise in colour, because no colour is chosen
/// (Rao–Blackwell over the index).
#[derive(Clone, Copy, Debug, Default)]
pub struct WithRadiance<R> {
    inner: R,
    radiance: Vec3,
}

impl<R: Reservoir> WithRadiance<R> {
    /// The sum.
    #[inline]
    #[must_use]
    pub fn radiance(&self) -> Vec3 {
        self.radiance
    }

    /// The reservoir without the sum.
    #[inline]
    #[must_use]
    pub fn inner(&self) -> &R {
        &self.inner
    }
}

impl<R: Reservoir> Reservoir for WithRadiance<R> {
    type Sample = R::Sample;
    type Carried = (R::Carried, Vec3);

    #[inline]
    fn stream(
        &mut self,
        sample: Self::Sample,
        weight: f32,
        (carried, radiance): Self::Carried,
        random: &mut impl RandomSource,
    ) -> bool {
        let rejected = self.inner.rejected();
        let selected = self.inner.stream(sample, weight, carried, random);
        if self.inner.rejected() == rejected {
            self.radiance += radiance;
        }
        selected
    }

    pass_on!();
}
