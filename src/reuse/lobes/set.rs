//! Lobes as a receiver sees them: one at a time, and a set at once.

use glam::{Vec2, Vec3};
use pulp::{Arch, NullaryFnOnce};

use super::state::BORN_OF;
use super::{LobeState, Prior};
use crate::math::vmf::{peak, peaks, sample_vmf, vmf_pdf_below_peak};
use crate::math::{Frame, LANES, Lanes, Lanes3, Mask};

/// Most lobes of a set.
pub const MOST_LOBES: usize = 64;

/// Squared distances from which on, and up to which, a direction to a target is a unit vector:
/// 1/d² and d² are normal numbers.
const NEAREST: f32 = 1e-30;
const FARTHEST: f32 = 1e30;

/// A lobe without its receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shape {
    /// Where it aims; of a sky the direction.
    pub target: Vec3,
    /// 1, or 0 for a sky, whose direction is the same for all receivers.
    pub anchored: f32,
    /// κ in (0, [`Shape::MOST_KAPPA`]].
    pub kappa: f32,
    /// V at its mean direction.
    pub peak: f32,
}

impl Shape {
    /// Largest κ: a cone of 0.1°, below which directions themselves are rounded.
    pub const MOST_KAPPA: f32 = 1e6;

    /// `None` where κ is not a positive number.
    #[inline]
    #[must_use]
    pub fn new(target: Vec3, sky: bool, kappa: f32) -> Option<Self> {
        let anchored = if sky { 0.0 } else { 1.0 };
        (kappa > 0.0 && kappa <= Self::MOST_KAPPA).then(|| Self {
            target,
            anchored,
            kappa,
            peak: peak(kappa),
        })
    }

    /// The lobe at a receiver; `None` where the target is at the receiver or not finite.
    #[inline]
    #[must_use]
    pub fn at(&self, from: Vec3) -> Option<Lobe> {
        let way = self.target - from * self.anchored;
        let squared = way.length_squared();
        (squared > NEAREST && squared < FARTHEST).then(|| Lobe {
            mean: way / squared.sqrt(),
            kappa: self.kappa,
            peak: self.peak,
        })
    }
}

/// A lobe at a receiver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// μ.
    pub mean: Vec3,
    /// κ.
    pub kappa: f32,
    peak: f32,
}

impl Lobe {
    /// V(ω).
    #[inline]
    #[must_use]
    pub fn density(&self, direction: Vec3) -> f32 {
        vmf_pdf_below_peak(self.peak, self.kappa, direction.distance_squared(self.mean))
    }

    /// A direction with density V.
    #[inline]
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Vec3 {
        Frame::from_normal(self.mean).to_world(sample_vmf(self.kappa, u)).normalize()
    }
}

/// Eight shapes side by side; a peak of 0 is none.
#[derive(Clone, Copy, Debug)]
struct Group {
    target: Lanes3,
    anchored: Lanes,
    kappa: Lanes,
    peak: Lanes,
}

impl Group {
    const NONE: Self =
        Self { target: Lanes3::ZERO, anchored: Lanes::ZERO, kappa: Lanes::ZERO, peak: Lanes::ZERO };

    /// The shapes of up to eight states, eight at once: those of [`LobeState::shape`], bit for bit.
    #[inline(always)]
    fn of(states: &[LobeState], prior: &Prior) -> Self {
        let mut group = Self::NONE;
        let (mut count, mut spread, mut weight, mut born) =
            (Lanes::ZERO, Lanes::ZERO, Lanes::ZERO, Lanes::ZERO);
        for (lane, state) in states.iter().enumerate() {
            group.target.set(lane, state.target);
            group.anchored.0[lane] = if state.is_sky() { 0.0 } else { 1.0 };
            count.0[lane] = state.count() as f32;
            spread.0[lane] = state.spread;
            weight.0[lane] = state.weight;
            born.0[lane] = state.born_of_code();
        }
        let before = prior.spread.map_or_else(|| (born * BORN_OF).exp(), Lanes::splat);
        let squared = count * count;
        let d = (before * prior.count + squared * spread) / (squared + prior.count);
        // This is `approximate_vmf_kappa`, cut off at the largest.
        let r = Lanes::splat(1.0) - d;
        let kappa = r * (Lanes::splat(3.0) - r * r) / (d * (Lanes::splat(2.0) - d));
        let most = Lanes::splat(Shape::MOST_KAPPA);
        let kappa = kappa.below(most).select(kappa, most);
        let (none, positive) = (Lanes::ZERO, Lanes::ZERO.below(d));
        group.kappa = positive.select(kappa, most);
        let sound = Mask::of(|lane| (0.0..=1.0).contains(&spread.0[lane]));
        let there = none
            .below(weight)
            .and(weight.finite())
            .and(sound)
            .and(none.below(count))
            .and(none.below(group.kappa));
        group.peak = there.select(peaks(group.kappa), none);
        group
    }

    /// V of each at a receiver, and where there is one.
    #[inline(always)]
    fn densities(&self, from: Vec3, direction: Vec3) -> (Lanes, Mask) {
        let way = Lanes3 {
            x: self.target.x - self.anchored * from.x,
            y: self.target.y - self.anchored * from.y,
            z: self.target.z - self.anchored * from.z,
        };
        let squared = way.dot(way);
        let distance = squared.sqrt();
        let chord = Lanes3 {
            x: Lanes::splat(direction.x) - way.x / distance,
            y: Lanes::splat(direction.y) - way.y / distance,
            z: Lanes::splat(direction.z) - way.z / distance,
        };
        let exponent = self.kappa * -0.5 * chord.dot(chord);
        let there = Lanes::splat(NEAREST)
            .below(squared)
            .and(squared.below(Lanes::splat(FARTHEST)))
            .and(Lanes::ZERO.below(self.peak));
        (self.peak * exponent.exp(), there)
    }
}

/// Up to [`MOST_LOBES`] lobes, some of which may be none.
#[derive(Clone, Debug)]
pub struct LobeSet {
    groups: [Group; MOST_LOBES / LANES],
    used: usize,
}

/// Σ V and how many lobes there are, as a receiver sees a set.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Densities {
    /// Σ V(ω) over the lobes.
    pub sum: f32,
    /// Their number.
    pub lobes: f32,
}

impl Default for LobeSet {
    fn default() -> Self {
        Self { groups: [Group::NONE; MOST_LOBES / LANES], used: 0 }
    }
}

impl LobeSet {
    /// A set of `len` places, all empty.
    #[inline]
    pub fn clear(&mut self, len: usize) {
        self.used = len.div_ceil(LANES);
        self.groups[..self.used].fill(Group::NONE);
    }

    /// The set of the lobes of `states`.
    #[inline]
    pub fn fill(&mut self, states: &[LobeState], prior: &Prior) {
        self.used = states.len().div_ceil(LANES);
        let groups = &mut self.groups[..self.used];
        Arch::new().dispatch(Fill { groups, states, prior });
    }

    /// Puts a shape, or none, in a place.
    #[inline]
    pub fn set(&mut self, place: usize, shape: Option<&Shape>) {
        let group = &mut self.groups[place / LANES];
        let lane = place % LANES;
        match shape {
            None => group.peak.0[lane] = 0.0,
            Some(shape) => {
                group.target.set(lane, shape.target.to_array());
                group.anchored.0[lane] = shape.anchored;
                group.kappa.0[lane] = shape.kappa;
                group.peak.0[lane] = shape.peak;
            }
        }
    }

    /// The shape in a place.
    #[inline]
    #[must_use]
    pub fn get(&self, place: usize) -> Option<Shape> {
        let (group, lane) = (&self.groups[place / LANES], place % LANES);
        (group.peak.0[lane] > 0.0).then(|| Shape {
            target: group.target.get(lane),
            anchored: group.anchored.0[lane],
            kappa: group.kappa.0[lane],
            peak: group.peak.0[lane],
        })
    }

    /// Σ V(ω) over the lobes of the set at a receiver, and their number: eight at a time.
    #[inline]
    #[must_use]
    pub fn densities(&self, from: Vec3, direction: Vec3) -> Densities {
        Arch::new().dispatch(Sum {
            groups: &self.groups[..self.used],
            from,
            direction,
            weights: None,
        })
    }

    /// Σ s V(ω) with a weight for each place, and Σ s, over the lobes.
    #[inline]
    #[must_use]
    pub fn weighted(&self, weights: &Weights, from: Vec3, direction: Vec3) -> Densities {
        let weights = Some(&weights.0[..]);
        Arch::new().dispatch(Sum { groups: &self.groups[..self.used], from, direction, weights })
    }
}

/// A number for each place of a set.
#[derive(Clone, Debug)]
pub struct Weights([Lanes; MOST_LOBES / LANES]);

impl Default for Weights {
    fn default() -> Self {
        Self([Lanes::ZERO; MOST_LOBES / LANES])
    }
}

impl Weights {
    /// Changes a place's number.
    #[inline]
    pub fn set(&mut self, place: usize, weight: f32) {
        self.0[place / LANES].0[place % LANES] = weight;
    }
}

struct Fill<'a> {
    groups: &'a mut [Group],
    states: &'a [LobeState],
    prior: &'a Prior,
}

impl NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (group, states) in self.groups.iter_mut().zip(self.states.chunks(LANES)) {
            *group = Group::of(states, self.prior);
        }
    }
}

struct Sum<'a> {
    groups: &'a [Group],
    from: Vec3,
    direction: Vec3,
    weights: Option<&'a [Lanes]>,
}

impl NullaryFnOnce for Sum<'_> {
    type Output = Densities;

    #[inline(always)]
    fn call(self) -> Densities {
        let Self { groups, from, direction, weights } = self;
        // Each group's numbers go through memory: a sum that is carried from group to group in
        // lanes is not made into vectors.
        let mut values = [[0.0; LANES]; MOST_LOBES / LANES];
        let mut lobes = [[0.0; LANES]; MOST_LOBES / LANES];
        for (at, group) in groups.iter().enumerate() {
            let (density, there) = group.densities(from, direction);
            let weight = weights.map_or(Lanes::splat(1.0), |weights| weights[at]);
            values[at] = there.select(density * weight, Lanes::ZERO).0;
            lobes[at] = there.select(weight, Lanes::ZERO).0;
        }
        let total = |parts: &[[f32; LANES]]| parts.iter().map(halves).sum();
        Densities { sum: total(&values[..groups.len()]), lobes: total(&lobes[..groups.len()]) }
    }
}

/// The sum of eight numbers by halves.
#[inline(always)]
fn halves(v: &[f32; LANES]) -> f32 {
    ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    fn shapes(random: &mut Stream, count: usize) -> Vec<Option<Shape>> {
        let shape = |place: usize| {
            let mut next = || 4.0 * random.uniform() - 2.0;
            let target = Vec3::new(next(), next(), next());
            let kappa = (6.0 * next()).exp();
            // One aims at a receiver of the test, some are none.
            let target = if place == 3 { Vec3::ONE } else { target };
            Shape::new(target, place % 5 == 1, if place % 7 == 2 { 0.0 } else { kappa.min(1e6) })
        };
        (0..count).map(shape).collect()
    }

    /// A set has the bits of its lobes one at a time.
    #[test]
    fn a_set_is_its_lobes() {
        let mut random = Stream::from_key(5);
        for count in [1, 5, 8, 17, 32, 64] {
            let all = shapes(&mut random, count);
            let mut set = LobeSet::default();
            let mut weights = Weights::default();
            set.clear(count);
            for (place, shape) in all.iter().enumerate() {
                set.set(place, shape.as_ref());
                weights.set(place, 0.5 + place as f32);
                assert_eq!(set.get(place), *shape);
            }
            for case in 0..200 {
                let mut next = || 2.0 * random.uniform() - 1.0;
                let from = if case == 0 { Vec3::ONE } else { Vec3::new(next(), next(), next()) };
                let direction = Vec3::new(next(), next(), next() + 1e-3).normalize();
                let each = |weight: &dyn Fn(usize) -> f32| {
                    let mut parts = [[[0.0; LANES]; MOST_LOBES / LANES]; 2];
                    for (place, shape) in all.iter().enumerate() {
                        if let Some(lobe) = shape.and_then(|shape| shape.at(from)) {
                            let w = weight(place);
                            parts[0][place / LANES][place % LANES] = lobe.density(direction) * w;
                            parts[1][place / LANES][place % LANES] = w;
                        }
                    }
                    let total = |part: &[[f32; LANES]]| part.iter().map(halves).sum::<f32>();
                    Densities { sum: total(&parts[0]), lobes: total(&parts[1]) }
                };
                assert_eq!(set.densities(from, direction), each(&|_| 1.0));
                let own = set.weighted(&weights, from, direction);
                assert_eq!(own, each(&|place| 0.5 + place as f32));
            }
        }
    }

    /// Filled from states, whatever they hold, a set has the bits of their shapes.
    #[test]
    fn a_filled_set_is_the_shapes_of_its_states() {
        let mut random = Stream::from_key(7);
        let (mut there, mut count) = (0, 0);
        for case in 0..3_000 {
            let wild = case % 2 == 0;
            let states: Vec<LobeState> = (0..[1, 7, 32, 64][case % 4])
                .map(|_| {
                    let words: [u32; 8] = std::array::from_fn(|_| random.word());
                    let mut state: LobeState = bytemuck::cast(words);
                    if !wild {
                        state.target = std::array::from_fn(|_| 3.0 * random.uniform());
                        state.spread = random.uniform().powi(9);
                        state.weight = random.uniform();
                    }
                    state
                })
                .collect();
            for spread in [None, Some(1.0), Some(0.0), Some(0.01)] {
                let prior = Prior { count: [0.0, 0.1, 1.0][case % 3], spread };
                let mut set = LobeSet::default();
                set.fill(&states, &prior);
                for (place, state) in states.iter().enumerate() {
                    let shape = state.shape(&prior);
                    let bits = |shape: Option<Shape>| {
                        shape.map(|Shape { target, anchored, kappa, peak }| {
                            let [x, y, z] = target.to_array();
                            [x, y, z, anchored, kappa, peak].map(f32::to_bits)
                        })
                    };
                    assert_eq!(bits(set.get(place)), bits(shape), "{state:?} {prior:?}");
                    there += u32::from(shape.is_some());
                    count += 1;
                }
            }
        }
        assert!(there > 10_000 && count - there > 10_000, "{there} of {count}");
    }

    /// The sum does not depend on the order of its members but for rounding, and opposite lobes add
    /// up without cancellation.
    #[test]
    fn order_and_company_do_not_matter() {
        let mut random = Stream::from_key(6);
        let all = shapes(&mut random, 32);
        let direction = Vec3::new(0.2, 0.9, -0.3).normalize();
        let sum = |order: &dyn Fn(usize) -> usize, count: usize| {
            let mut set = LobeSet::default();
            set.clear(count);
            (0..count).for_each(|place| set.set(place, all[order(place) % 32].as_ref()));
            set.densities(Vec3::ZERO, direction)
        };
        let (forth, back, twice) = (sum(&|p| p, 32), sum(&|p| 31 - p, 32), sum(&|p| p, 64));
        assert_eq!(forth.lobes, back.lobes);
        assert!((forth.sum / back.sum - 1.0).abs() < 1e-6);
        assert!((twice.sum / forth.sum - 2.0).abs() < 1e-6 && twice.lobes == 2.0 * forth.lobes);
        let mut set = LobeSet::default();
        set.clear(2);
        let pair = [Vec3::Z, Vec3::NEG_Z].map(|at| Shape::new(at, true, 50.0).unwrap());
        pair.iter().enumerate().for_each(|(at, shape)| set.set(at, Some(shape)));
        let alone = pair[0].at(Vec3::ZERO).unwrap().density(Vec3::Z);
        assert!((set.densities(Vec3::ZERO, Vec3::Z).sum / alone - 1.0).abs() < 1e-6);
    }
}
