//! Finished reservoirs of paths as they lie in the loop's buffers.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use super::{Anchor, Ending, Next, PathSample, Reconnection};
use crate::accel::Hit;
use crate::light::LightPoint;
use crate::math::luminance;
use crate::resampling::{ContributionWeight, Finished, PrimarySample, Shifted};
use crate::reuse::StoredReservoir;

/// A finished reservoir of one pixel: 20 words, 80 bytes, exact.
///
/// | word | field |
/// |---|---|
/// | 0 | W |
/// | 1–3 | F |
/// | 4–5 | seed |
/// | 6 | n, r (0: none), confidence, age, 8 bits each |
/// | 7 | ending 2, delta light 1, anchor 2, `ℓ_{r−1}` 3, `ℓ_r` 3 bits, the sky that the path ends in 21 |
/// | 8–11 | anchor: instance, primitive, u, v; or light, u, v |
/// | 12–14 | direction |
/// | 15–17 | radiance |
/// | 18 | density |
/// | 19 | light density |
///
/// All zeros is an empty record without confidence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct PathRecord([u32; 20]);

/// The same with what follows `x_r`: 120 bytes, for paths that are mutated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct MutableRecord {
    /// All else.
    pub path: PathRecord,
    /// What follows.
    pub next: Next,
}

/// Largest confidence that a record holds.
const MAX_CONFIDENCE: f32 = 255.0;

const fn bits(word: u32, from: u32, count: u32) -> u32 {
    word >> from & ((1 << count) - 1)
}

impl PathRecord {
    /// A finished reservoir and its sample's age in frames, which saturates.
    #[must_use]
    pub fn new(finished: &Finished<PathSample, PrimarySample>, age: u32) -> Self {
        let mut words = [0; 20];
        let confidence = finished.confidence.min(MAX_CONFIDENCE) as u32;
        words[6] = confidence << 16 | age.min(255) << 24;
        let Some(sample) = &finished.sample else { return Self(words) };
        words[0] = finished.weight.get().to_bits();
        words[1..4].copy_from_slice(&sample.integrand.to_array().map(f32::to_bits));
        words[4..6].copy_from_slice(&[sample.seed as u32, (sample.seed >> 32) as u32]);
        words[6] |= u32::from(sample.last);
        words[7] = match sample.ending {
            Ending::Light { delta } => u32::from(delta) << 2,
            Ending::Emitter => 1,
            Ending::Sky { .. } => 2,
            Ending::Direct => 3,
        };
        if let Ending::Sky { sky } = sample.ending {
            words[7] |= sky << 11;
        }
        let Some(reconnection) = &sample.reconnection else { return Self(words) };
        words[6] |= u32::from(reconnection.vertex) << 8;
        let lobes = reconnection.lobes.map(u32::from);
        words[7] |= lobes[0] << 5 | lobes[1] << 8;
        match reconnection.anchor {
            Anchor::Surface(hit) => {
                let place = [hit.instance, hit.primitive, hit.u.to_bits(), hit.v.to_bits()];
                words[8..12].copy_from_slice(&place);
            }
            Anchor::Point(LightPoint { light, uv }) => {
                words[7] |= 1 << 3;
                words[8..11].copy_from_slice(&[light, uv.x.to_bits(), uv.y.to_bits()]);
            }
            Anchor::Sky { light } => {
                words[7] |= 2 << 3;
                words[8] = light;
            }
        }
        words[12..15].copy_from_slice(&reconnection.direction.to_array().map(f32::to_bits));
        words[15..18].copy_from_slice(&reconnection.radiance.to_array().map(f32::to_bits));
        words[18] = reconnection.density.to_bits();
        words[19] = reconnection.light_density.to_bits();
        Self(words)
    }

    /// The finished reservoir.
    #[must_use]
    pub fn finished(&self) -> Finished<PathSample, PrimarySample> {
        let words = &self.0;
        let float = |at: usize| f32::from_bits(words[at]);
        let triple = |at: usize| Vec3::new(float(at), float(at + 1), float(at + 2));
        let confidence = self.confidence();
        let weight = float(0);
        if weight == 0.0 {
            return Finished::empty(confidence);
        }
        let ending = match bits(words[7], 0, 2) {
            0 => Ending::Light { delta: bits(words[7], 2, 1) != 0 },
            1 => Ending::Emitter,
            2 => Ending::Sky { sky: words[7] >> 11 },
            _ => Ending::Direct,
        };
        let vertex = bits(words[6], 8, 8) as u8;
        let anchor = match bits(words[7], 3, 2) {
            0 => Anchor::Surface(Hit {
                t: 0.0,
                u: float(10),
                v: float(11),
                primitive: words[9],
                instance: words[8],
            }),
            1 => Anchor::Point(LightPoint { light: words[8], uv: Vec2::new(float(9), float(10)) }),
            _ => Anchor::Sky { light: words[8] },
        };
        let reconnection = (vertex > 0).then(|| Reconnection {
            vertex,
            lobes: [bits(words[7], 5, 3) as u8, bits(words[7], 8, 3) as u8],
            anchor,
            direction: triple(12),
            radiance: triple(15),
            density: float(18),
            light_density: float(19),
            next: Next::default(),
        });
        let sample = PathSample {
            seed: u64::from(words[4]) | u64::from(words[5]) << 32,
            integrand: triple(1),
            last: bits(words[6], 0, 8) as u8,
            ending,
            reconnection,
        };
        Finished { sample: Some(sample), weight: ContributionWeight::new(weight), confidence }
    }

    /// Its fields for people, as names and values.
    pub(crate) fn describe(&self) -> Vec<(&'static str, String)> {
        let confidence = ("confidence", self.confidence().to_string());
        let Finished { sample: Some(sample), weight, .. } = self.finished() else {
            return vec![("sample", "none".to_string()), confidence];
        };
        let ending = match sample.ending {
            Ending::Light { delta: false } => "light sample",
            Ending::Light { delta: true } => "light without a surface",
            Ending::Emitter => "emitter",
            Ending::Sky { .. } => "sky",
            Ending::Direct => "direct light",
        };
        let mut all = vec![
            ("seed", format!("{:016x}", sample.seed)),
            ("segments", (u32::from(sample.last) + 2).to_string()),
            ("ends with", ending.to_string()),
            ("F", format!("{:?}", sample.integrand.to_array())),
            ("W", format!("{:.3e}", weight.get())),
            confidence,
            ("age", self.age().to_string()),
        ];
        match sample.reconnection {
            None => all.push(("reconnects", "nowhere".to_string())),
            Some(kept) => {
                all.push(("reconnects at vertex", kept.vertex.to_string()));
                all.push(("by lobes", format!("{:?}", kept.lobes)));
                all.push(("density", format!("{:.3e}", kept.density)));
            }
        }
        all
    }

    /// Whether both records hold a sample, and it is the same one: the same seed, or for direct
    /// light, which has none, the same light point; and the same `x_r`, which mutations move.
    #[must_use]
    pub fn is_same(&self, other: &Self) -> bool {
        let (own, other) = (&self.0, &other.0);
        own[0] != 0
            && other[0] != 0
            && own[4..6] == other[4..6]
            && own[7] & 3 == other[7] & 3
            && own[8..12] == other[8..12]
    }

    /// F of the sample; 0 without one.
    #[inline]
    #[must_use]
    pub fn integrand(&self) -> Vec3 {
        Vec3::from([1, 2, 3].map(|at| f32::from_bits(self.0[at])))
    }

    /// c: 0 where the surface scatters nothing.
    #[inline]
    #[must_use]
    pub fn confidence(&self) -> f32 {
        bits(self.0[6], 16, 8) as f32
    }

    /// Frames since the sample was a fresh candidate.
    #[inline]
    #[must_use]
    pub fn age(&self) -> u32 {
        bits(self.0[6], 24, 8)
    }
}

impl MutableRecord {
    /// A finished reservoir and its sample's age in frames, which saturates.
    #[must_use]
    pub fn new(finished: &Finished<PathSample, PrimarySample>, age: u32) -> Self {
        let kept = finished.sample.and_then(|sample| sample.reconnection);
        let next = kept.map_or(Next::default(), |kept| kept.next);
        Self { path: PathRecord::new(finished, age), next }
    }

    /// The finished reservoir.
    #[must_use]
    pub fn finished(&self) -> Finished<PathSample, PrimarySample> {
        let mut finished = self.path.finished();
        let kept = finished.sample.as_mut().and_then(|sample| sample.reconnection.as_mut());
        if let Some(kept) = kept {
            kept.next = self.next;
        }
        finished
    }
}

/// Records of paths in a buffer.
pub(crate) trait Records:
    StoredReservoir<Sample = PathSample, Measure = PrimarySample>
{
    /// Whether they keep what follows `x_r`.
    const MUTABLE: bool;

    /// All else.
    fn path(&self) -> &PathRecord;
}

impl Records for PathRecord {
    const MUTABLE: bool = false;

    #[inline]
    fn path(&self) -> &PathRecord {
        self
    }
}

impl Records for MutableRecord {
    const MUTABLE: bool = true;

    #[inline]
    fn path(&self) -> &PathRecord {
        &self.path
    }
}

/// What both have in common, since only [`MutableRecord`] has more of a sample.
macro_rules! stored {
    ($record:ty) => {
        impl StoredReservoir for $record {
            type Sample = PathSample;
            type Measure = PrimarySample;

            #[inline]
            fn new(
                finished: &Finished<PathSample, PrimarySample>,
                _target: f32,
                age: u32,
                _: u16,
            ) -> Self {
                Self::new(finished, age)
            }

            #[inline]
            fn finished(&self) -> Finished<PathSample, PrimarySample> {
                self.finished()
            }

            #[inline]
            fn target(&self) -> f32 {
                luminance(self.path().integrand())
            }

            #[inline]
            fn confidence(&self) -> f32 {
                self.path().confidence()
            }

            #[inline]
            fn age(&self) -> u32 {
                self.path().age()
            }

            #[inline]
            fn policy_bits(&self) -> u16 {
                0
            }

            #[inline]
            fn is_same(&self, other: &Self) -> bool {
                self.path().is_same(other.path())
            }

            #[inline]
            fn emptied(&self) -> Self {
                Self::new(&Finished::empty(self.confidence()), self.age())
            }

            /// Within a frame T keeps all but F and the density.
            #[inline]
            fn slot(shifted: &Shifted<PathSample, Vec3>) -> [f32; 4] {
                let [r, g, b] = shifted.integrand.to_array();
                let density = shifted.sample.reconnection.as_ref().map_or(1.0, |kept| kept.density);
                [r, g, b, density]
            }

            #[inline]
            fn arrived(&self, [r, g, b, density]: [f32; 4]) -> Option<Shifted<PathSample, Vec3>> {
                if density == 0.0 {
                    return None;
                }
                let integrand = Vec3::new(r, g, b);
                let mut sample = PathSample { integrand, ..self.finished().sample? };
                let mut jacobian = 1.0;
                if let Some(kept) = &mut sample.reconnection {
                    jacobian = density / kept.density;
                    kept.density = density;
                }
                Some(Shifted { sample, integrand, jacobian })
            }
        }
    };
}

stored!(PathRecord);
stored!(MutableRecord);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    /// Everything that a record holds, at its limits too, comes back.
    #[test]
    fn records_come_back() {
        assert_eq!(size_of::<PathRecord>(), 80);
        let mut random = Stream::from_key(3);
        for round in 0..40_000 {
            let endings = [
                Ending::Light { delta: false },
                Ending::Light { delta: true },
                Ending::Emitter,
                Ending::Sky { sky: (1 << 21) - 1 },
                Ending::Direct,
            ];
            let mut float = || f32::from_bits(random.word() & 0x7FFF_FFFF);
            let mut finite = || loop {
                let x = float();
                if x.is_finite() {
                    return x;
                }
            };
            let [a, b, c, d, e, f, g, h] = [(); 8].map(|()| finite());
            let direction = Vec3::from([(); 3].map(|()| finite()));
            let hit = Hit { t: 0.0, u: 0.25, v: -0.0, primitive: 1 << 29, instance: u32::MAX };
            let uv = Vec2::new(0.0, 1.0 - f32::EPSILON);
            let anchors = [
                Anchor::Surface(hit),
                Anchor::Point(LightPoint { light: u32::MAX - 1, uv }),
                Anchor::Sky { light: 0 },
            ];
            let anchor = anchors[random.index(3) as usize];
            let reconnection = (round % 5 > 0).then(|| Reconnection {
                vertex: [1, 2, 100, 255][random.index(4) as usize],
                lobes: [random.index(8) as u8, random.index(8) as u8],
                anchor,
                direction,
                radiance: Vec3::new(a, b, 0.0),
                density: c,
                light_density: d,
                next: Next::default(),
            });
            let sample = PathSample {
                seed: u64::from(random.word()) << 32 | u64::from(random.word()),
                integrand: Vec3::new(e, f, g),
                last: [0, 1, 7, 255][random.index(4) as usize],
                ending: endings[random.index(5) as usize],
                reconnection,
            };
            let confidence = [0.0, 1.0, 21.0, 255.0][random.index(4) as usize];
            let weight = ContributionWeight::new(h.max(f32::MIN_POSITIVE));
            let finished = Finished { sample: Some(sample), weight, confidence };
            let record = PathRecord::new(&finished, round);
            assert_eq!(record.finished(), finished);
            assert_eq!((record.age(), record.confidence()), (round.min(255), confidence));
            assert_eq!(record.integrand(), sample.integrand);
        }
        let empty = Finished::empty(9.0);
        assert_eq!(PathRecord::new(&empty, 0).finished(), empty);
        assert_eq!(PathRecord::zeroed().finished(), Finished::empty(0.0));
    }
}
