//! What a path has behind `x_r`, as a mutation of `x_r` needs it.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use super::NO_LOBE;
use crate::accel::Hit;
use crate::light::LightPoint;
use crate::math::{octahedral_decode, octahedral_encode};

/// What follows `x_r`: the vertex or the end after it, and what that sends on, in 40 bytes as they
/// lie in a record, so that copies are exact. All zeros: nothing is kept, and `x_r` does not move.
///
/// | word | field |
/// |---|---|
/// | 0–3 | place: instance, primitive, u, v; or light, u, v |
/// | 4–5 | direction onward: its octahedral code, 29 bits each; in the low bits of word 4 the lobe, of word 5 the kind of place |
/// | 6–8 | radiance |
/// | 9 | light density |
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Next([u32; 10]);

/// Where a path goes from `x_r`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// To the vertex `v_{r+1}`, or the emitter that `v_r` met.
    Surface(Hit),
    /// To the light that `v_r` sampled.
    Light(LightPoint),
    /// To the sky.
    Sky,
}

/// Bits of a word that the octahedral code leaves.
const LOW: u32 = 3;
/// Largest code.
const MOST: f64 = ((1_u32 << 29) - 1) as f64;

impl Next {
    /// Where `x_r` is the last vertex: its end.
    #[must_use]
    pub fn end(place: Place) -> Self {
        let mut words = [0; 10];
        match place {
            Place::Surface(hit) => {
                words[..4].copy_from_slice(&[
                    hit.instance,
                    hit.primitive,
                    hit.u.to_bits(),
                    hit.v.to_bits(),
                ]);
                words[5] = 1;
            }
            Place::Light(LightPoint { light, uv }) => {
                words[..3].copy_from_slice(&[light, uv.x.to_bits(), uv.y.to_bits()]);
                words[5] = 2;
            }
            Place::Sky => words[5] = 3,
        }
        words[4] = u32::from(NO_LOBE);
        Self(words)
    }

    /// A vertex that is left along a unit direction by a lobe; [`NO_LOBE`]: to a light that it
    /// samples.
    #[must_use]
    pub fn vertex(hit: &Hit, lobe: u8, direction: Vec3) -> Self {
        let Self(mut words) = Self::end(Place::Surface(*hit));
        let p = octahedral_encode(direction);
        let code = |x: f32| ((0.5 * (f64::from(x) + 1.0) * MOST).round() as u32) << LOW;
        words[4] = code(p.x) | u32::from(lobe);
        words[5] |= code(p.y);
        Self(words)
    }

    /// The same at another place on a surface.
    #[must_use]
    pub fn moved_to(self, hit: &Hit) -> Self {
        let (Self(mut words), Self(there)) = (self, Self::end(Place::Surface(*hit)));
        words[..4].copy_from_slice(&there[..4]);
        Self(words)
    }

    /// The same with what arrives along the direction: Π f/p̄ of `v_{r+2}` … `v_n` times the light
    /// and its ω; where `v_{r+1}` is the last vertex the light alone, with p ℓ of the end.
    #[must_use]
    pub fn lit(self, radiance: Vec3, light_density: f32) -> Self {
        let Self(mut words) = self;
        words[6..9].copy_from_slice(&radiance.to_array().map(f32::to_bits));
        words[9] = light_density.to_bits();
        Self(words)
    }

    /// `None` where nothing is kept.
    #[must_use]
    pub fn place(&self) -> Option<Place> {
        let [a, b, c, d, _, kind, ..] = self.0;
        match kind & ((1 << LOW) - 1) {
            0 => None,
            1 => Some(Place::Surface(Hit {
                t: 0.0,
                u: f32::from_bits(c),
                v: f32::from_bits(d),
                primitive: b,
                instance: a,
            })),
            2 => {
                let uv = Vec2::new(f32::from_bits(b), f32::from_bits(c));
                Some(Place::Light(LightPoint { light: a, uv }))
            }
            _ => Some(Place::Sky),
        }
    }

    /// The lobe that `v_{r+1}` is left by.
    #[must_use]
    pub fn lobe(&self) -> u8 {
        (self.0[4] & ((1 << LOW) - 1)) as u8
    }

    /// The unit direction that `v_{r+1}` is left by.
    #[must_use]
    pub fn direction(&self) -> Vec3 {
        let decode = |word: u32| (f64::from(word >> LOW) / MOST * 2.0 - 1.0) as f32;
        octahedral_decode(Vec2::new(decode(self.0[4]), decode(self.0[5])))
    }

    /// What arrives along it.
    #[must_use]
    pub fn radiance(&self) -> Vec3 {
        Vec3::from([6, 7, 8].map(|at| f32::from_bits(self.0[at])))
    }

    /// p ℓ of an end at `v_{r+1}`.
    #[must_use]
    pub fn light_density(&self) -> f32 {
        f32::from_bits(self.0[9])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::math::warp::sample_uniform_sphere;

    /// Everything comes back, directions to single precision, at seams and poles too.
    #[test]
    fn what_follows_comes_back() {
        let mut random = Stream::from_key(5);
        let poles = [Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y, Vec3::Z, -Vec3::Z];
        for round in 0..20_000 {
            let uv = Vec2::new(random.uniform(), random.uniform());
            let direction = match poles.get(round) {
                Some(pole) => *pole,
                None if round % 3 == 0 => Vec3::new(uv.x - 0.5, uv.y - 0.5, 0.0).normalize(),
                None => sample_uniform_sphere(uv),
            };
            let hit = Hit { t: 0.0, u: uv.x, v: -0.0, primitive: u32::MAX, instance: 1 << 31 };
            let lobe = (round % 8) as u8;
            let radiance = Vec3::new(uv.x, 1e-30, 3e38);
            let next = Next::vertex(&hit, lobe, direction).lit(radiance, 1e-20);
            assert_eq!(next.place(), Some(Place::Surface(hit)));
            assert_eq!(
                (next.lobe(), next.radiance(), next.light_density()),
                (lobe, radiance, 1e-20)
            );
            let error = (next.direction() - direction).length();
            assert!(error < 3e-7, "{direction}: {error:e}");
            let point = LightPoint { light: u32::MAX - 1, uv };
            assert_eq!(Next::end(Place::Light(point)).place(), Some(Place::Light(point)));
        }
        assert_eq!(Next::end(Place::Sky).place(), Some(Place::Sky));
        assert_eq!((Next::default().place(), size_of::<Next>()), (None, 40));
    }
}
