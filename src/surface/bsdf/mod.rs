//! How a point of a surface scatters light: a few lobes, each with its value, density, sample and
//! inverse.
//!
//! Directions are unit vectors in the local shading frame (normal +z) and point away from the
//! surface; `wo` is where the light is looked at from, `wi` where it comes from. Radiance is
//! transported: light refracted into a medium of η times the index leaves with 1/η² of its value.
//!
//! | symbol | meaning |
//! |---|---|
//! | value | `f(o, i) \|cos θ_i\|`; for a delta lobe its weight times its probability |
//! | p(i, ℓ) | density of choosing lobe ℓ *and* direction i, per solid angle of i: "joint" |
//! | p(i) | Σ p(i, ℓ) over the lobes that are not deltas: "marginal" |
//!
//! A material's lobes are numbered from 0, at most 6, in an order that never depends on its
//! parameters: paths store lobe numbers. One word chooses the lobe, two floats its direction; a
//! lobe's direction map is invertible ([`Bsdf::invert`]).
//!
//! Both sides: opaque surfaces reflect on the side of `wo`. At `o_z` = 0 or `i_z` = 0 everything is
//! zero. Surfaces with α < 10⁻³ are deltas (as in pbrt-v4).

mod coated;
mod conductor;
mod dielectric;
mod fresnel;
mod ggx;
mod interface;
mod lambert;
mod metallic;

use glam::{Vec2, Vec3};

use crate::math::rng::unit_float;
use crate::math::{LANES, Lanes, Lanes3, Mask};
use coated::Coated;
use conductor::Conductor;
use dielectric::{Dielectric, ThinDielectric};
use ggx::Ggx;
use lambert::{Diffuse, DiffuseTransmission};
use metallic::Metallic;

#[cfg(feature = "gpu")]
pub(crate) use coated::coat_alpha;
#[cfg(feature = "gpu")]
pub(crate) use interface::{NODES, index_cell, rows_of};
pub use metallic::MetallicRoughness;

/// A material evaluated at a point: up to 6 lobes.
#[derive(Clone, Copy, Debug)]
pub struct Bsdf {
    kind: Kind,
}

/// What light does at a pair of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Evaluation {
    /// `f(o, i) |cos θ_i|`, per channel, in sr⁻¹.
    pub value: Vec3,
    /// Per solid angle of `wi`.
    pub pdf: f32,
}

impl Evaluation {
    /// Nothing is scattered and nothing sampled.
    pub const ZERO: Self = Self { value: Vec3::ZERO, pdf: 0.0 };
}

/// A sampled direction.
#[derive(Clone, Copy, Debug)]
pub struct BsdfSample {
    /// Where the light comes from.
    pub wi: Vec3,
    /// `f |cos θ_i|` of all lobes that are not deltas; for a delta its share of the light times
    /// `pdf`.
    pub value: Vec3,
    /// Marginal density per solid angle; for a delta its probability. Positive.
    pub pdf: f32,
    /// The lobe that was chosen.
    pub lobe: u8,
    /// Whether the direction was the only one of its lobe: no light sampling can find it.
    pub delta: bool,
    /// Whether the light crosses the surface.
    pub transmission: bool,
    /// Index of refraction at `wi` over that at `wo`; 1 unless refracted.
    pub eta: f32,
}

impl BsdfSample {
    /// The density that light sampling of the same direction is weighed against; `None` after a
    /// delta, which no light sample finds.
    #[inline(always)]
    #[must_use]
    pub fn beside_lights(&self) -> Option<f32> {
        (!self.delta).then_some(self.pdf)
    }
}

/// What a family of lobes answers. Lobe sets are bit masks, so that one lobe and all lobes are the
/// same code.
trait Lobes {
    /// Number of lobes.
    fn count(&self) -> u32;
    /// Whether the lobe is a delta.
    fn is_delta(&self, lobe: u32) -> bool;
    /// Whether no light leaves in any direction.
    fn is_black(&self) -> bool;
    /// Whether any lobe with light is not a delta.
    fn has_non_delta(&self) -> bool {
        (0..self.count()).any(|lobe| !self.is_delta(lobe))
    }
    /// Probability of choosing the lobe; they sum to 1, and any lobe with a value has one.
    fn probability(&self, lobe: u32, wo: Vec3) -> f32;
    /// Sums over those of `lobes` that are not deltas; the density is joint.
    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation;
    /// All lobes at those of eight `wi` that are `alive`; zero at the others.
    fn evaluate_lanes(&self, wo: Vec3, wi: &Lanes3, alive: Mask) -> (Lanes3, Lanes) {
        let (mut value, mut pdf) = (Lanes3::ZERO, Lanes::ZERO);
        for lane in 0..LANES {
            if alive.get(lane) {
                let one = self.evaluate(wo, wi.get(lane), ALL);
                value.set(lane, one.value.to_array());
                pdf.0[lane] = one.pdf;
            }
        }
        (value, pdf)
    }
    /// The direction map of a lobe that is not a delta; `None` where it leaves the lobe's
    /// hemisphere.
    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3>;
    /// Inverse of [`Lobes::direction`] for a `wi` with a positive density.
    fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2>;
    /// The direction of a delta lobe.
    fn delta(&self, _lobe: u32, _wo: Vec3) -> Option<DeltaSample> {
        None
    }
    /// Index of refraction at `wi` over that at `wo` of a lobe that is not a delta.
    fn eta(&self, _lobe: u32, _wo: Vec3) -> f32 {
        1.0
    }
    /// Diffuse and specular colour.
    fn albedo(&self) -> Vec3;
    /// α of a lobe, the smaller one where it is stretched: 1 for diffuse lobes, 0 for deltas.
    fn roughness(&self, lobe: u32) -> f32;
    /// Whether light may cross the surface.
    fn transmits(&self) -> bool {
        false
    }
}

/// A direction of a delta lobe.
struct DeltaSample {
    wi: Vec3,
    value: Vec3,
    /// Of the lobe.
    pdf: f32,
    eta: f32,
}

/// All lobes of [`Lobes::evaluate`].
const ALL: u32 = u32::MAX;

/// Whether `lobe` is in the set `lobes`.
#[inline]
fn select(lobes: u32, lobe: u32) -> bool {
    lobes >> lobe & 1 != 0
}

/// Both directions mirrored in z where `wo` is behind the surface.
#[inline]
fn mirror_to_front(wo: Vec3, wi: Vec3) -> (Vec3, Vec3) {
    let side = 1.0_f32.copysign(wo.z);
    (Vec3::new(wo.x, wo.y, wo.z * side), Vec3::new(wi.x, wi.y, wi.z * side))
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    One(Part),
    Mix(Mix),
}

/// One material's lobes.
#[derive(Clone, Copy, Debug)]
enum Part {
    Diffuse(Diffuse),
    DiffuseTransmission(DiffuseTransmission),
    Conductor(Conductor),
    Dielectric(Dielectric),
    ThinDielectric(ThinDielectric),
    Coated(Coated),
    Metallic(Metallic),
}

macro_rules! each_part {
    ($part:expr, $lobes:ident => $result:expr) => {
        match $part {
            Part::Diffuse($lobes) => $result,
            Part::DiffuseTransmission($lobes) => $result,
            Part::Conductor($lobes) => $result,
            Part::Dielectric($lobes) => $result,
            Part::ThinDielectric($lobes) => $result,
            Part::Coated($lobes) => $result,
            Part::Metallic($lobes) => $result,
        }
    };
}

macro_rules! each {
    ($bsdf:expr, $lobes:ident => $result:expr) => {
        match &$bsdf.kind {
            Kind::One(part) => each_part!(part, $lobes => $result),
            Kind::Mix($lobes) => $result,
        }
    };
}

/// The weighted union of two materials' lobes; the second's follow the first's.
#[derive(Clone, Copy, Debug)]
struct Mix {
    parts: [Part; 2],
    /// Of the values; they sum to 1.
    weights: [f32; 2],
    /// Of choosing a part: its weight, unless the other is black.
    probabilities: [f32; 2],
}

impl Mix {
    fn new(parts: [Part; 2], amount: f32) -> Self {
        let amount = amount.clamp(0.0, 1.0);
        let weights = [1.0 - amount, amount];
        let black = parts.map(|part| each_part!(part, lobes => lobes.is_black()));
        let probabilities = match black {
            [true, false] if amount > 0.0 => [0.0, 1.0],
            [false, true] if amount < 1.0 => [1.0, 0.0],
            _ => weights,
        };
        Self { parts, weights, probabilities }
    }

    /// Which part a lobe belongs to, and its number there.
    #[inline]
    fn part_of(&self, lobe: u32) -> (usize, u32) {
        let first = self.parts[0].count();
        if lobe < first { (0, lobe) } else { (1, lobe - first) }
    }
}

impl Part {
    #[inline]
    fn count(&self) -> u32 {
        each_part!(self, lobes => lobes.count())
    }
}

impl Lobes for Mix {
    fn transmits(&self) -> bool {
        self.parts.iter().any(|part| each_part!(part, lobes => lobes.transmits()))
    }

    fn count(&self) -> u32 {
        self.parts[0].count() + self.parts[1].count()
    }

    fn is_delta(&self, lobe: u32) -> bool {
        let (part, lobe) = self.part_of(lobe);
        each_part!(&self.parts[part], lobes => lobes.is_delta(lobe))
    }

    fn is_black(&self) -> bool {
        (0..2).all(|i| {
            self.weights[i] == 0.0 || each_part!(&self.parts[i], lobes => lobes.is_black())
        })
    }

    fn has_non_delta(&self) -> bool {
        (0..2).any(|i| {
            self.weights[i] > 0.0 && each_part!(&self.parts[i], lobes => lobes.has_non_delta())
        })
    }

    fn probability(&self, lobe: u32, wo: Vec3) -> f32 {
        let (part, lobe) = self.part_of(lobe);
        self.probabilities[part] * each_part!(&self.parts[part], l => l.probability(lobe, wo))
    }

    fn evaluate(&self, wo: Vec3, wi: Vec3, lobes: u32) -> Evaluation {
        let mut sum = Evaluation::ZERO;
        let masks = [lobes, lobes >> self.parts[0].count()];
        for (i, (part, mask)) in self.parts.iter().zip(masks).enumerate() {
            // The first part must not see the second's bits, nor compute anything for an empty set.
            let mask = mask & ((1 << part.count()) - 1);
            if mask != 0 && self.weights[i] > 0.0 {
                let part = each_part!(part, l => l.evaluate(wo, wi, mask));
                sum.value += self.weights[i] * part.value;
                sum.pdf += self.probabilities[i] * part.pdf;
            }
        }
        sum
    }

    fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        let (part, lobe) = self.part_of(lobe);
        each_part!(&self.parts[part], lobes => lobes.direction(lobe, wo, u))
    }

    fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        let (part, lobe) = self.part_of(lobe);
        each_part!(&self.parts[part], lobes => lobes.invert(lobe, wo, wi))
    }

    fn delta(&self, lobe: u32, wo: Vec3) -> Option<DeltaSample> {
        let (part, lobe) = self.part_of(lobe);
        let sample = each_part!(&self.parts[part], lobes => lobes.delta(lobe, wo))?;
        Some(DeltaSample {
            value: self.weights[part] * sample.value,
            pdf: self.probabilities[part] * sample.pdf,
            ..sample
        })
    }

    fn eta(&self, lobe: u32, wo: Vec3) -> f32 {
        let (part, lobe) = self.part_of(lobe);
        each_part!(&self.parts[part], lobes => lobes.eta(lobe, wo))
    }

    fn albedo(&self) -> Vec3 {
        (0..2).map(|i| self.weights[i] * each_part!(&self.parts[i], lobes => lobes.albedo())).sum()
    }

    fn roughness(&self, lobe: u32) -> f32 {
        let (part, lobe) = self.part_of(lobe);
        each_part!(&self.parts[part], lobes => lobes.roughness(lobe))
    }
}

/// The lobe that a word chooses. All 32 bits count: a lobe of probability 10⁻⁶ is chosen that
/// often.
#[inline]
fn choose_lobe<L: Lobes>(lobes: &L, wo: Vec3, word: u32) -> Option<u32> {
    let count = lobes.count();
    if count == 1 {
        return Some(0);
    }
    let u = f64::from(word) * (1.0 / 4_294_967_296.0);
    let mut below = 0.0;
    let mut last = None;
    for lobe in 0..count {
        let p = lobes.probability(lobe, wo);
        if p > 0.0 {
            below += f64::from(p);
            last = Some(lobe);
            if u < below {
                break;
            }
        }
    }
    last
}

#[inline]
fn sample_lobes<L: Lobes>(lobes: &L, wo: Vec3, words: [u32; 4]) -> Option<BsdfSample> {
    let lobe = choose_lobe(lobes, wo, words[0])?;
    if lobes.is_delta(lobe) {
        let DeltaSample { wi, value, pdf, eta } = lobes.delta(lobe, wo)?;
        let transmission = wo.z * wi.z < 0.0;
        let lobe = lobe as u8;
        return (pdf > 0.0).then_some(BsdfSample {
            wi,
            value,
            pdf,
            lobe,
            delta: true,
            transmission,
            eta,
        });
    }
    let wi = lobes.direction(lobe, wo, Vec2::new(unit_float(words[1]), unit_float(words[2])))?;
    let Evaluation { value, pdf } = lobes.evaluate(wo, wi, ALL);
    (pdf > 0.0).then(|| BsdfSample {
        wi,
        value,
        pdf,
        lobe: lobe as u8,
        delta: false,
        transmission: wo.z * wi.z < 0.0,
        eta: lobes.eta(lobe, wo),
    })
}

impl Bsdf {
    #[inline]
    fn one(part: Part) -> Self {
        Self { kind: Kind::One(part) }
    }

    /// Lambert reflection with albedo `reflectance` in [0, 1].
    #[inline]
    #[must_use]
    pub fn diffuse(reflectance: Vec3) -> Self {
        Self::one(Part::Diffuse(Diffuse { reflectance }))
    }

    /// Lambert reflection (lobe 0) and transmission (lobe 1); per channel the albedos sum to at
    /// most 1.
    #[inline]
    #[must_use]
    pub fn diffuse_transmission(reflectance: Vec3, transmittance: Vec3) -> Self {
        Self::one(Part::DiffuseTransmission(DiffuseTransmission::new(reflectance, transmittance)))
    }

    /// A metal with index of refraction η + i k; a mirror where both `alpha` are below 10⁻³.
    #[inline]
    #[must_use]
    pub fn conductor(eta: Vec3, k: Vec3, alpha: Vec2) -> Self {
        Self::one(Part::Conductor(Conductor { eta, k, surface: Ggx::new(alpha) }))
    }

    /// A metal with reflectance `color` at normal incidence: η = 1, k = 2 √r/√(1 − r).
    #[inline]
    #[must_use]
    pub fn metal(color: Vec3, alpha: Vec2) -> Self {
        Self::one(Part::Conductor(Conductor::from_reflectance(color, Ggx::new(alpha))))
    }

    /// Glass of index `eta` inside over outside: reflection (lobe 0) and refraction (lobe 1),
    /// deltas where both `alpha` are below 10⁻³.
    #[inline]
    #[must_use]
    pub fn dielectric(eta: f32, alpha: Vec2) -> Self {
        Self::one(Part::Dielectric(Dielectric::new(eta, alpha)))
    }

    /// A thin pane of index `eta`: mirrored (lobe 0) or straight through (lobe 1).
    #[inline]
    #[must_use]
    pub fn thin_dielectric(eta: f32) -> Self {
        Self::one(Part::ThinDielectric(ThinDielectric { eta }))
    }

    /// A dielectric coat of index `eta` >= 1 (lobe 0) over a Lambert base (lobe 1): an analytic
    /// plastic.
    #[inline]
    #[must_use]
    pub fn coated_diffuse(reflectance: Vec3, eta: f32, alpha: Vec2) -> Self {
        Self::one(Part::Coated(Coated::new(reflectance, eta, alpha)))
    }

    /// glTF's metallic-roughness surface: specular (lobe 0), diffuse (lobe 1), thin-walled
    /// transmission (lobe 2).
    #[inline]
    #[must_use]
    pub fn metallic_roughness(parameters: &MetallicRoughness) -> Self {
        Self::one(Part::Metallic(Metallic::new(parameters)))
    }

    /// `1 − amount` of the first and `amount` of the second one's light. `None` where either is
    /// itself a mix.
    #[must_use]
    pub fn mix(first: &Self, second: &Self, amount: f32) -> Option<Self> {
        match (first.kind, second.kind) {
            (Kind::One(first), Kind::One(second)) => {
                Some(Self { kind: Kind::Mix(Mix::new([first, second], amount)) })
            }
            _ => None,
        }
    }

    /// Number of lobes, 1 to 6.
    #[inline]
    #[must_use]
    pub fn lobe_count(&self) -> u32 {
        each!(self, lobes => lobes.count())
    }

    /// Whether a lobe scatters into one direction only.
    #[inline]
    #[must_use]
    pub fn is_delta(&self, lobe: u32) -> bool {
        each!(self, lobes => lobes.is_delta(lobe))
    }

    /// Whether any lobe can be met by light sampling.
    #[inline]
    #[must_use]
    pub fn has_non_delta(&self) -> bool {
        each!(self, lobes => lobes.has_non_delta())
    }

    /// Whether light may cross the surface.
    #[inline]
    #[must_use]
    pub fn transmits(&self) -> bool {
        each!(self, lobes => lobes.transmits())
    }

    /// Whether no light leaves in any direction: neither light sampling nor scattering can
    /// contribute.
    #[inline]
    #[must_use]
    pub fn is_black(&self) -> bool {
        each!(self, lobes => lobes.is_black())
    }

    /// A direction. `words[0]` chooses the lobe with all of its bits, `words[1]` and `words[2]` the
    /// direction (as [`unit_float`]).
    ///
    /// Value and density of a sample that is not a delta are totals over all lobes that are not.
    /// `None` is a sample of value 0: a microfacet reflected below the horizon, `o_z` = 0, or no
    /// lobe has light.
    #[inline]
    #[must_use]
    pub fn sample(&self, wo: Vec3, words: [u32; 4]) -> Option<BsdfSample> {
        if wo.z == 0.0 {
            return None;
        }
        each!(self, lobes => sample_lobes(lobes, wo, words))
    }

    /// All lobes that are not deltas, with the marginal density.
    #[inline]
    #[must_use]
    pub fn evaluate(&self, wo: Vec3, wi: Vec3) -> Evaluation {
        each!(self, lobes => lobes.evaluate(wo, wi, ALL))
    }

    /// [`Bsdf::evaluate`] of eight `wi`, value and density, to the bit; where not `alive` it may be
    /// anything finite.
    #[inline(always)]
    pub(crate) fn evaluate_lanes(&self, wo: Vec3, wi: &Lanes3, alive: Mask) -> (Lanes3, Lanes) {
        match &self.kind {
            Kind::One(Part::Diffuse(diffuse)) => diffuse.evaluate_lanes(wo, wi, alive),
            _ => self.other_lanes(wo, wi, alive),
        }
    }

    #[inline(never)]
    fn other_lanes(&self, wo: Vec3, wi: &Lanes3, alive: Mask) -> (Lanes3, Lanes) {
        each!(self, lobes => lobes.evaluate_lanes(wo, wi, alive))
    }

    /// One lobe, with its joint density (the lobe's probability times its own); zero for deltas.
    /// The sum over lobes is [`Bsdf::evaluate`].
    #[inline]
    #[must_use]
    pub fn evaluate_lobe(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Evaluation {
        debug_assert!(lobe < 32);
        each!(self, lobes => lobes.evaluate(wo, wi, 1 << lobe))
    }

    /// All lobes that are not deltas with the marginal density, and the joint density of one of
    /// them: [`Bsdf::evaluate`] and the density of [`Bsdf::evaluate_lobe`] in one call.
    #[inline]
    #[must_use]
    pub fn evaluate_with_lobe(&self, lobe: u32, wo: Vec3, wi: Vec3) -> (Evaluation, f32) {
        each!(self, lobes => {
            let total = lobes.evaluate(wo, wi, ALL);
            let joint = if lobes.count() == 1 {
                if lobe == 0 { total.pdf } else { 0.0 }
            } else {
                lobes.evaluate(wo, wi, 1 << lobe).pdf
            };
            (total, joint)
        })
    }

    /// The direction that a lobe's map makes of two floats in [0, 1), as [`Bsdf::sample`] does;
    /// `None` where it leaves the lobe's hemisphere, and for deltas.
    #[inline]
    #[must_use]
    pub fn direction(&self, lobe: u32, wo: Vec3, u: Vec2) -> Option<Vec3> {
        each!(self, lobes => {
            let mapped = wo.z != 0.0 && lobe < lobes.count() && !lobes.is_delta(lobe);
            if mapped { lobes.direction(lobe, wo, u) } else { None }
        })
    }

    /// The floats from which a lobe's direction map makes `wi`; `None` where it never does, and for
    /// deltas.
    #[inline]
    #[must_use]
    pub fn invert(&self, lobe: u32, wo: Vec3, wi: Vec3) -> Option<Vec2> {
        each!(self, lobes => {
            let reachable = lobe < lobes.count() && lobes.evaluate(wo, wi, 1 << lobe).pdf > 0.0;
            if reachable { lobes.invert(lobe, wo, wi) } else { None }
        })
    }

    /// Probability of choosing a lobe, deltas included; they sum to 1.
    #[inline]
    #[must_use]
    pub fn lobe_probability(&self, lobe: u32, wo: Vec3) -> f32 {
        each!(self, lobes => lobes.probability(lobe, wo))
    }

    /// Diffuse and specular colour together, in [0, 1]: a guide for denoisers.
    #[inline]
    #[must_use]
    pub fn albedo(&self) -> Vec3 {
        each!(self, lobes => lobes.albedo()).clamp(Vec3::ZERO, Vec3::ONE)
    }

    /// α of a lobe, the smaller one where it is stretched: 1 for diffuse lobes, 0 for deltas.
    #[inline]
    #[must_use]
    pub fn lobe_roughness(&self, lobe: u32) -> f32 {
        each!(self, lobes => lobes.roughness(lobe))
    }
}

#[cfg(test)]
mod tests;
