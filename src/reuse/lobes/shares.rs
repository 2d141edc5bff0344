//! Techniques as mixtures of their branches, and the estimators over sets of techniques.

use glam::Vec3;

use super::set::Densities;
use crate::resampling::{Claim, Estimator};

/// Shares of a technique's branches; the rest, (1 − c)(1 − b), is the lobe's.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shares {
    /// c of light sampling, in [0, 1).
    pub light: f32,
    /// b of BSDF sampling among the others, in (0, 1]: what a set covers where its lobes do not
    /// reach, so that a sample is worth at most F/((1 − c) b `p_h`).
    pub large: f32,
}

/// Densities at a receiver that do not depend on the lobe, per solid angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluated {
    /// `p_ℓ` of light sampling, the choice of the light included; for lights that no direction
    /// meets the probability of their choice.
    pub light: f32,
    /// `p_h` of BSDF sampling over all lobes that are not deltas; 0 for lights that no direction
    /// meets.
    pub large: f32,
    /// Whether no direction meets the light, so that light sampling alone finds it.
    pub light_only: bool,
}

/// The branches of a technique.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Branch {
    /// Light sampling.
    Light,
    /// BSDF sampling.
    Large,
    /// The lobe.
    Lobe,
}

impl Shares {
    /// The branch of a uniform number: c of light sampling, then b of BSDF sampling, which is all
    /// of the rest where there is no lobe.
    #[inline]
    #[must_use]
    pub fn branch(&self, u: f32, lobe: bool) -> Branch {
        if u < self.light {
            Branch::Light
        } else if !lobe || u < self.light + (1.0 - self.light) * self.large {
            Branch::Large
        } else {
            Branch::Lobe
        }
    }

    /// c `p_ℓ` + (1 − c)(b `p_h` + (1 − b) V), with `p_h` in place of V where there is no lobe.
    #[inline]
    #[must_use]
    pub fn density(&self, at: &Evaluated, lobe: Option<f32>) -> f32 {
        let (sum, lobes) = lobe.map_or((0.0, 0.0), |density| (density, 1.0));
        self.mean_density(at, Densities { sum, lobes }, 1.0)
    }

    /// The mean of [`Shares::density`] over `techniques` of them, of which `lobes` have one.
    #[inline]
    #[must_use]
    pub fn mean_density(&self, at: &Evaluated, lobes: Densities, techniques: f32) -> f32 {
        // An infinite density of light sampling is none where no light is sampled.
        let sampled = if self.light == 0.0 { 0.0 } else { self.light * at.light };
        if at.light_only {
            return sampled;
        }
        let share = lobes.lobes / techniques;
        // Without lobes all of it is p_h, to the bit.
        let large = if share == 0.0 {
            at.large
        } else {
            at.large * (1.0 - share + self.large * share)
                + (1.0 - self.large) * lobes.sum / techniques
        };
        sampled + (1.0 - self.light) * large
    }
}

/// Where the states of a tile's lanes lie after turns of the whole tile: no state moves, so none is
/// lost or doubled, and lanes without a pixel hand theirs on as all others do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Permutation {
    lanes: u32,
    offset: u32,
}

impl Permutation {
    /// Each lane has its own slot.
    #[inline]
    #[must_use]
    pub fn new(lanes: u32) -> Self {
        Self { lanes, offset: 0 }
    }

    /// Each lane takes the state of the lane `by` places ahead, in a ring.
    #[inline]
    pub fn turn(&mut self, by: u32) {
        self.offset = (self.offset + by) % self.lanes;
    }

    /// Each lane takes the state of the lane before it.
    #[inline]
    pub fn shift(&mut self) {
        self.turn(self.lanes - 1);
    }

    /// The slot of a lane's state.
    #[inline]
    #[must_use]
    pub fn slot(&self, lane: u32) -> usize {
        let slot = lane + self.offset;
        (if slot < self.lanes { slot } else { slot - self.lanes }) as usize
    }
}

/// A sample with the density of the set of techniques that it is weighed by: the mean over the set
/// where one of them was chosen uniformly, the sum where each drew one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetSample {
    /// F.
    pub integrand: Vec3,
    /// Mean or summed density.
    pub density: f32,
}

/// These facts decide whether the mean over sets of techniques is right (see the module's head);
/// they are found from parameters and scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "independent conditions, each with a sentence of its own"
)]
pub struct SetConditions {
    /// Whether no sample takes part in the making of a technique that stands below its line: the
    /// set is fixed before the draw, or samples are at least as many steps away as there are
    /// lanes.
    pub blind: bool,
    /// Whether the technique that draws is chosen uniformly among those of the set, or all draw.
    pub uniform: bool,
    /// Whether each draw has numbers of its own, which no frame and no other lane repeats.
    pub fresh: bool,
    /// Whether some technique of every set has a density wherever light arrives.
    pub covers: bool,
    /// Whether lights that no direction meets are sampled, where there are any.
    pub finds_all_lights: bool,
}

/// Stochastic multiple importance sampling: F over the density of a set of techniques (West et al.
/// 2020; Dittebrandt et al. 2023, eq. 8 and 9), with each technique as the mixture of its branches.
#[derive(Clone, Copy, Debug)]
pub struct StochasticMis;

impl Estimator for StochasticMis {
    type State = SetSample;
    type Conditions = SetConditions;

    #[inline]
    fn radiance(state: &SetSample) -> Vec3 {
        state.integrand / state.density
    }

    fn claim(conditions: &SetConditions) -> Claim {
        let SetConditions { blind, uniform, fresh, covers, finds_all_lights } = *conditions;
        let mut reasons = Vec::new();
        for (holds, why) in [
            (blind, "samples take part in the techniques that they are weighed by"),
            (uniform, "the technique that draws is not chosen uniformly"),
            (fresh, "numbers are drawn again that techniques have learnt from"),
            (covers, "there is light where no technique looks"),
            (
                finds_all_lights,
                "no direction meets point, spot and distant lights, and `light` is 0",
            ),
        ] {
            if !holds {
                reasons.push(why.to_string());
            }
        }
        Claim::unless(&reasons)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_neither_lose_nor_double_states() {
        for lanes in [1, 2, 5, 8, 32, 64] {
            let mut states: Vec<u32> = (0..lanes).collect();
            let mut permutation = Permutation::new(lanes);
            for step in 0..3 * lanes {
                // Explicit moves: each lane takes another one's state.
                if step % 3 == 0 {
                    permutation.shift();
                    states.rotate_right(1);
                } else {
                    let by = (step * 7) % lanes;
                    permutation.turn(by);
                    states.rotate_left(by as usize);
                }
                let slots: Vec<u32> =
                    (0..lanes).map(|lane| permutation.slot(lane) as u32).collect();
                assert_eq!(slots, states, "{lanes} lanes, step {step}");
            }
            // The shift is one cycle through all lanes.
            let mut permutation = Permutation::new(lanes);
            (0..lanes).for_each(|_| permutation.shift());
            assert_eq!(permutation, Permutation::new(lanes));
        }
    }

    #[test]
    fn densities_are_those_of_the_branches() {
        let at = Evaluated { light: 3.0, large: 0.5, light_only: false };
        let shares = Shares { light: 0.25, large: 0.2 };
        let with = 0.25 * 3.0 + 0.75 * (0.2 * 0.5 + 0.8 * 7.0);
        assert!((shares.density(&at, Some(7.0)) - with).abs() < 1e-6);
        assert_eq!(shares.density(&at, None), 0.25 * 3.0 + 0.75 * 0.5);
        let mean = shares.mean_density(&at, Densities { sum: 9.0, lobes: 2.0 }, 4.0);
        let each = [Some(7.0), None, Some(2.0), None].map(|lobe| shares.density(&at, lobe));
        assert!((mean - each.iter().sum::<f32>() / 4.0).abs() < 1e-6);
        let only = Evaluated { light_only: true, ..at };
        assert_eq!(shares.density(&only, Some(7.0)), 0.75);
        let none = Shares { light: 0.0, large: 1.0 };
        assert_eq!(none.density(&at, Some(7.0)), 0.5);
        // A set covers at least its defensive share: F / density is at most F / ((1 − c) b p_h).
        assert!(shares.density(&at, Some(0.0)) >= 0.75 * 0.2 * 0.5);
    }

    #[test]
    fn branches_have_their_shares() {
        let shares = Shares { light: 0.25, large: 0.2 };
        let count = |lobe, branch| {
            (0..4000).filter(|i| shares.branch(*i as f32 / 4000.0, lobe) == branch).count()
        };
        let all = |lobe| [Branch::Light, Branch::Large, Branch::Lobe].map(|b| count(lobe, b));
        assert_eq!(all(true), [1000, 600, 2400]);
        assert_eq!(all(false), [1000, 3000, 0]);
    }

    #[test]
    fn claims_name_what_fails() {
        let sound = SetConditions {
            blind: true,
            uniform: true,
            fresh: true,
            covers: true,
            finds_all_lights: true,
        };
        assert_eq!(StochasticMis::claim(&sound), Claim::Unbiased);
        let claim = StochasticMis::claim(&SetConditions { finds_all_lights: false, ..sound });
        assert!(matches!(claim, Claim::Biased(why) if why.contains("`light` is 0")));
        // One sample of one technique is f/p.
        let one = SetSample { integrand: Vec3::splat(3.0), density: 2.0 };
        assert_eq!(StochasticMis::radiance(&one), Vec3::splat(1.5));
    }
}
