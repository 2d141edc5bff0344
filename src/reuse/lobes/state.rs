//! The state of a lobe: 32 bytes a pixel, and how it learns.

use std::f32::consts::LN_2;

use bytemuck::{Pod, Zeroable};
use glam::Vec3;

use super::Shape;
use crate::math::vmf::approximate_vmf_kappa;
use crate::math::{exp, ln};

/// Bits of [`LobeState::bits`] that hold N, which is at most [`LobeState::MOST_SAMPLES`].
const COUNT_BITS: u32 = 11;
const COUNT_MASK: u32 = (1 << COUNT_BITS) - 1;
/// Where the prior's 1 − `r_p` begins: 15 bits, −log₂ of it in steps of 2⁻¹⁰.
const PRIOR_FROM: u32 = 16;
const PRIOR_MASK: u32 = (1 << 15) - 1;
const PRIOR_STEPS: f32 = 1024.0;
/// ln (1 − `r_p`) of one step.
pub(super) const BORN_OF: f32 = -LN_2 / PRIOR_STEPS;
const SKY: u32 = 1 << 31;

/// A lobe as it lies in the loop's buffers; all zeros is none.
///
/// | word | field |
/// |---|---|
/// | 0–2 | ȳ |
/// | 3 | 1 − r̄ |
/// | 4 | w̄ |
/// | 5 | f |
/// | 6 | N 11 bits, 5 spare, 1 − `r_p` of the emitter 15, sky 1 |
/// | 7 | light |
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct LobeState {
    /// ȳ: where light comes from; of a sky the mean direction to it.
    pub target: [f32; 3],
    /// 1 − r̄ in [0, 1]: kept instead of r̄, which has no digits left for κ near 1.
    pub spread: f32,
    /// w̄ > 0, or 0: none.
    pub weight: f32,
    /// f of the sample that the chain last moved to.
    pub score: f32,
    bits: u32,
    /// The light that the lobe was born of, in the table of the frame that wrote it.
    pub light: u32,
}

/// Samples that a lobe is worth before the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// `N_p` ≥ 0.
    pub count: f32,
    /// 1 − `r_p`; `None`: Ω/4π of the emitter that the lobe was born of, as its first receiver saw
    /// it.
    pub spread: Option<f32>,
}

/// How a lobe weighs new samples against old ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Learning {
    /// Most samples that it counts, at most [`LobeState::MOST_SAMPLES`].
    pub cap: u32,
    /// Least share of a new sample, so that old ones are forgotten.
    pub least: f32,
}

/// Light that a direction found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Its number.
    pub light: u32,
    /// Where it is, or the direction to it.
    pub place: Vec3,
    /// Whether it comes from a sky.
    pub sky: bool,
    /// Ω/4π of the emitter as seen from the receiver, in (0, 1].
    pub solid_angle: f32,
}

impl LobeState {
    /// None.
    pub const NONE: Self =
        Self { target: [0.0; 3], spread: 0.0, weight: 0.0, score: 0.0, bits: 0, light: 0 };

    /// Largest N.
    pub const MOST_SAMPLES: u32 = 1024;

    /// Whether there is a lobe.
    #[inline]
    #[must_use]
    pub fn is_some(&self) -> bool {
        self.weight > 0.0
    }

    /// N.
    #[inline]
    #[must_use]
    pub fn count(&self) -> u32 {
        self.bits & COUNT_MASK
    }

    /// Whether the target is a direction.
    #[inline]
    #[must_use]
    pub fn is_sky(&self) -> bool {
        self.bits & SKY != 0
    }

    /// 1 − `r_p` of the emitter that it was born of.
    #[inline]
    #[must_use]
    pub fn born_of(&self) -> f32 {
        exp(self.born_of_code() * BORN_OF)
    }

    /// A lobe that has learnt nothing yet, of the emitter that was found.
    #[inline]
    fn born(found: &Found) -> Self {
        let steps = -ln(found.solid_angle) * (PRIOR_STEPS / LN_2);
        let code = (steps.round() as u32).min(PRIOR_MASK);
        let sky = if found.sky { SKY } else { 0 };
        Self { bits: code << PRIOR_FROM | sky, light: found.light, ..Self::NONE }
    }

    /// The direction to the target.
    #[inline]
    #[must_use]
    pub fn towards(&self, from: Vec3) -> Vec3 {
        let target = Vec3::from(self.target);
        if self.is_sky() { target } else { target - from }
    }

    /// The chain moves to a sample of score `score` > 0 that `found` light in the unit direction
    /// `direction` from `from`, drawn by this lobe or, with `anew`, by another branch: a lobe of
    /// its own then begins, as where one of a sky meets a surface or the reverse.
    #[inline]
    #[must_use]
    pub fn moved(
        self,
        (from, direction): (Vec3, Vec3),
        found: &Found,
        score: f32,
        anew: bool,
        learning: &Learning,
    ) -> Self {
        let anew = anew || !self.is_some() || self.is_sky() != found.sky;
        let lobe = if anew { Self::born(found) } else { self };
        let mut lobe = lobe.learnt((from, direction), Some(found), score, learning);
        lobe.score = score;
        lobe
    }

    /// The lobe after a sample that it drew: `found` light with `score`, or nothing. Its scores'
    /// running mean w̄ ← w̄ + (w − w̄) α with α = max(1/N, `least`) weighs the sample in ȳ and r̄;
    /// one that found nothing, or light of another kind, narrows the lobe (N grows) and fades it.
    #[inline]
    #[must_use]
    pub fn learnt(
        mut self,
        (from, direction): (Vec3, Vec3),
        found: Option<&Found>,
        score: f32,
        learning: &Learning,
    ) -> Self {
        let count = (self.count() + 1).min(learning.cap);
        self.bits = self.bits & !COUNT_MASK | count;
        let share = (1.0 / count as f32).max(learning.least);
        let found = found.filter(|found| found.sky == self.is_sky() && score > 0.0);
        let Some(found) = found else {
            self.weight -= self.weight * share;
            return self;
        };
        let weight = self.weight + (score - self.weight) * share;
        if !(weight > 0.0 && weight < f32::INFINITY) {
            return Self::NONE;
        }
        // The sample's share of the new mean, in [0, 1].
        let step = (score * share / weight).min(1.0);
        let target = Vec3::from(self.target);
        self.target = (target + (found.place - target) * step).to_array();
        self.weight = weight;
        // 1 − |(1 − step) r̄ μ + step ω| without the cancellation, μ the direction to the new mean:
        // with e = (1 − step)(1 − r̄) and c = |ω − μ| the square of the length is (1 − e)² − q,
        // q = (1 − step) r̄ step c².
        let Some(mean) = self.towards(from).try_normalize() else { return Self::NONE };
        let left = 1.0 - step;
        let e = left * self.spread;
        let q = left * (1.0 - self.spread) * step * direction.distance_squared(mean);
        // Rounding may lead beyond 0 and 1.
        let length = ((1.0 - e) * (1.0 - e) - q).max(0.0).sqrt();
        self.spread = ((e * (2.0 - e) + q) / (1.0 + length)).clamp(0.0, 1.0);
        self
    }

    /// 15 bits of 1 − `r_p` of the emitter that it was born of.
    #[inline(always)]
    pub(super) fn born_of_code(&self) -> f32 {
        (self.bits >> PRIOR_FROM & PRIOR_MASK) as f32
    }

    /// The lobe without its receiver, by the mean cosine r = (`N_p` `r_p` + N² r̄) / (`N_p` + N²)
    /// (Dittebrandt et al. 2023): κ is the same for all receivers. `None` where there is no lobe,
    /// or a state that makes none.
    #[inline]
    #[must_use]
    pub fn shape(&self, prior: &Prior) -> Option<Shape> {
        let count = self.count() as f32;
        let spread = (0.0..=1.0).contains(&self.spread);
        let usable = self.weight > 0.0 && self.weight < f32::INFINITY && count > 0.0 && spread;
        if !usable {
            return None;
        }
        let squared = count * count;
        let before = prior.spread.unwrap_or_else(|| self.born_of());
        let spread = (prior.count * before + squared * self.spread) / (prior.count + squared);
        let kappa = approximate_vmf_kappa(spread).min(Shape::MOST_KAPPA);
        Shape::new(self.target.into(), self.is_sky(), kappa)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Frame;
    use crate::math::rng::{RandomSource, Stream};
    use crate::math::vmf::sample_vmf;
    use glam::{DVec3, Vec2};

    const ALL: Learning = Learning { cap: 1024, least: 0.0 };

    fn found(place: Vec3) -> Found {
        Found { light: 3, place, sky: false, solid_angle: 0.01 }
    }

    #[test]
    fn records_are_of_32_bytes() {
        assert_eq!(size_of::<LobeState>(), 32);
        assert_eq!(LobeState::NONE, LobeState::zeroed());
        assert!(
            !LobeState::NONE.is_some()
                && LobeState::NONE.shape(&Prior { count: 1.0, spread: None }).is_none()
        );
        for share in [1.0_f32, 0.5, 0.1, 3e-4, 1e-7] {
            let lobe = LobeState::born(&Found { solid_angle: share, ..found(Vec3::Y) });
            assert!((lobe.born_of() / share - 1.0).abs() < 4e-4, "{share}: {}", lobe.born_of());
        }
    }

    /// After k samples with α = 1/N the state is that of the weighted means: ȳ and w̄ exactly, r̄
    /// where the direction to the mean does not turn (all on one sphere around the receiver would).
    #[test]
    fn learning_is_a_weighted_mean() {
        let mut random = Stream::from_key(1);
        let from = Vec3::new(0.3, -0.2, 0.1);
        let center = Vec3::new(1.0, 3.0, -2.0);
        let mut lobe = LobeState::NONE;
        let (mut weights, mut places, mut count) = (0.0_f64, DVec3::ZERO, 0);
        for number in 0..500 {
            let offset = Vec3::new(random.uniform(), random.uniform(), random.uniform()) - 0.5;
            let place = center + offset * 0.4;
            let score = if number % 5 == 3 { 0.0 } else { 0.2 + random.uniform() };
            let direction = (place - from).normalize();
            lobe = if number == 0 {
                lobe.moved((from, direction), &found(place), score, true, &ALL)
            } else {
                lobe.learnt((from, direction), Some(&found(place)), score, &ALL)
            };
            count += 1;
            weights += f64::from(score);
            places += place.as_dvec3() * f64::from(score);
            let mean = places / weights;
            assert!((Vec3::from(lobe.target).as_dvec3() - mean).length() < 1e-5, "{number}");
            let weight = weights / f64::from(count);
            assert!((f64::from(lobe.weight) / weight - 1.0).abs() < 1e-5);
            assert_eq!(lobe.count(), count);
            assert!((0.0..=1.0).contains(&lobe.spread));
        }
        // A sample that finds nothing leaves ȳ and r̄, counts, and narrows what has a wide prior.
        let prior = Prior { count: 50.0, spread: Some(1.0) };
        let fewer = LobeState { bits: lobe.bits & !COUNT_MASK | 5, ..lobe };
        let after = fewer.learnt((from, Vec3::X), None, 0.0, &ALL);
        assert_eq!((after.target, after.spread, after.count()), (fewer.target, fewer.spread, 6));
        assert!(after.weight < fewer.weight);
        assert!(after.shape(&prior).unwrap().kappa > fewer.shape(&prior).unwrap().kappa);
    }

    /// A lobe that learns from directions of a von Mises–Fisher distribution finds its κ.
    #[test]
    fn lobes_find_the_concentration() {
        for kappa in [20.0_f32, 500.0, 1e4] {
            let mut random = Stream::from_key(2);
            let axis = Vec3::new(0.3, 0.8, -0.4).normalize();
            let frame = Frame::from_normal(axis);
            let mut lobe = LobeState::NONE;
            for number in 0..1000 {
                let u = Vec2::new(random.uniform(), random.uniform());
                let direction = frame.to_world(sample_vmf(kappa, u));
                let sky = Found { sky: true, ..found(direction) };
                lobe = lobe.moved((Vec3::ZERO, direction), &sky, 1.0, number == 0, &ALL);
            }
            let learnt = lobe.shape(&Prior { count: 0.0, spread: Some(1.0) }).unwrap().kappa;
            // 1000 samples find κ to 3 %; the mean's own direction was learnt with them.
            assert!((learnt / kappa - 1.0).abs() < 0.15, "{kappa}: {learnt}");
        }
    }

    /// κ with a prior as in double precision, for N up to 1024, and the prior itself without
    /// samples.
    #[test]
    fn concentrations_keep_their_digits() {
        for count in [1_u32, 2, 30, 100, 1024] {
            for spread in [0.0_f32, 1e-7, 1e-3, 0.5, 0.99] {
                let lobe = LobeState {
                    weight: 1.0,
                    spread,
                    bits: count,
                    target: [0.0, 0.0, 1.0],
                    ..LobeState::NONE
                };
                let prior = Prior { count: 0.1, spread: Some(1.0) };
                let n = f64::from(count);
                let d = (0.1 + n * n * f64::from(spread)) / (0.1 + n * n);
                let r = 1.0 - d;
                let expected =
                    (r * (3.0 - r * r) / (d * (2.0 - d))).min(f64::from(Shape::MOST_KAPPA));
                let found = f64::from(lobe.shape(&prior).unwrap().kappa);
                assert!(
                    (found / expected - 1.0).abs() < 1e-5,
                    "{count} {spread}: {found} {expected}"
                );
            }
        }
    }

    /// Nothing that a state may hold makes a lobe that is none: zeros, infinities, what is no
    /// number, receivers at the target.
    #[test]
    fn degenerate_states_make_no_lobe() {
        let sound = LobeState { weight: 1.0, bits: 3, target: [0.0, 0.0, 1.0], ..LobeState::NONE };
        let prior = Prior { count: 0.1, spread: Some(1.0) };
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];
        let at = |lobe: &LobeState| lobe.shape(&prior).and_then(|shape| shape.at(Vec3::ZERO));
        assert!(at(&sound).is_some());
        for value in bad.into_iter().chain([0.0, -1.0]) {
            assert!(at(&LobeState { weight: value, ..sound }).is_none(), "w̄ = {value}");
        }
        for value in bad {
            assert!(at(&LobeState { target: [value, 0.0, 1.0], ..sound }).is_none(), "{value}");
        }
        assert!(at(&LobeState { spread: f32::NAN, ..sound }).is_none());
        assert!(at(&LobeState { spread: 1.0, ..sound }).is_none(), "κ = 0");
        assert!(at(&LobeState { bits: 0, ..sound }).is_none(), "N = 0");
        assert!(at(&LobeState { target: [0.0; 3], ..sound }).is_none(), "ȳ at the receiver");
        // Scores beyond numbers end a lobe.
        let huge = sound.moved((Vec3::ZERO, Vec3::Z), &found(Vec3::Z), f32::MAX, false, &ALL);
        let huge = huge.learnt((Vec3::ZERO, Vec3::Z), Some(&found(Vec3::Z)), f32::MAX, &ALL);
        assert!(huge.shape(&prior).is_none_or(|shape| shape.kappa.is_finite()));
        let fading = (0..3000).fold(sound, |lobe, _| {
            lobe.learnt((Vec3::ZERO, Vec3::Z), None, 0.0, &Learning { cap: 1024, least: 0.1 })
        });
        assert!(at(&fading).is_none_or(|lobe| lobe.density(Vec3::Z).is_finite()));
    }

    /// A lobe of a sky does not become one of a surface, or the reverse: another begins.
    #[test]
    fn skies_and_surfaces_are_not_mixed() {
        let sky = Found { sky: true, ..found(Vec3::Y) };
        let lobe = LobeState::NONE.moved((Vec3::ZERO, Vec3::Y), &sky, 1.0, true, &ALL);
        assert!(lobe.is_sky());
        let kept = lobe.learnt((Vec3::ZERO, Vec3::Z), Some(&found(Vec3::Z)), 5.0, &ALL);
        assert_eq!((kept.target, kept.is_sky(), kept.count()), (lobe.target, true, 2));
        let moved = lobe.moved((Vec3::ZERO, Vec3::Z), &found(Vec3::Z), 5.0, false, &ALL);
        assert_eq!((moved.target, moved.is_sky(), moved.count()), ([0.0, 0.0, 1.0], false, 1));
    }
}
