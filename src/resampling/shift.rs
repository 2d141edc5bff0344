//! Maps between domains.

use std::fmt;
use std::marker::PhantomData;

use glam::Vec3;

use crate::math::luminance;

/// A value of an integrand, with its one scalarisation.
pub trait Integrand: Copy {
    /// p̂: finite, not negative, and positive wherever the integrand is not 0.
    fn target(&self) -> f32;
}

impl Integrand for f32 {
    #[inline]
    fn target(&self) -> f32 {
        *self
    }
}

impl Integrand for Vec3 {
    #[inline]
    fn target(&self) -> f32 {
        luminance(*self)
    }
}

/// A sample in another domain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shifted<S, I> {
    /// T(x).
    pub sample: S,
    /// The destination's integrand there.
    pub integrand: I,
    /// |∂T/∂x| > 0, in the measure of the samples' weights.
    pub jacobian: f32,
}

/// A partial bijection T between the sample spaces of two domains.
///
/// Laws, wherever both sides are `Some`:
/// 1. `shift(shift(x, a, b), b, a)` is x.
/// 2. The two Jacobians multiply to 1.
/// 3. `shift(x, a, a)` is x itself, with Jacobian 1.
/// 4. T keeps the stratum: `stratum(shift(x, a, b)) == stratum(x)`.
///
/// Whether T is defined may depend on the sample and the two domains only. A failed shift keeps its
/// domain in the MIS weights.
pub trait ShiftMap {
    /// What is moved.
    type Sample: Copy;
    /// Where it can be: all that the integrand depends on besides the sample (surface, view,
    /// lights, frame).
    type Domain;
    /// What is integrated over a domain.
    type Integrand: Integrand;
    /// The part of a sample that no shift changes.
    type Stratum: PartialEq + fmt::Debug;

    /// T(x) from one domain to another, or `None` where it is undefined: the sample then weighs
    /// nothing there.
    fn shift(
        &mut self,
        sample: &Self::Sample,
        from: &Self::Domain,
        to: &Self::Domain,
    ) -> Option<Shifted<Self::Sample, Self::Integrand>>;

    /// The sample's stratum.
    fn stratum(&self, sample: &Self::Sample) -> Self::Stratum;
}

/// The identity between domains that share their sample space; the integrand is a function of
/// sample and domain.
#[derive(Clone, Copy, Debug)]
pub struct Identity<F, S, D> {
    integrand: F,
    types: PhantomData<fn(&S, &D)>,
}

impl<S, D, I, F: FnMut(&S, &D) -> I> Identity<F, S, D> {
    /// The identity for an integrand.
    pub fn new(integrand: F) -> Self {
        Self { integrand, types: PhantomData }
    }
}

impl<S: Copy, D, I: Integrand, F: FnMut(&S, &D) -> I> ShiftMap for Identity<F, S, D> {
    type Sample = S;
    type Domain = D;
    type Integrand = I;
    type Stratum = ();

    #[inline]
    fn shift(&mut self, sample: &S, _from: &D, to: &D) -> Option<Shifted<S, I>> {
        Some(Shifted { sample: *sample, integrand: (self.integrand)(sample, to), jacobian: 1.0 })
    }

    fn stratum(&self, _sample: &S) {}
}
