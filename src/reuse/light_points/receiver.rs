//! Receivers, and the shift of light points between them.

use glam::Vec3;

use crate::accel::{AcceptAll, Hit, HitFilter};
use crate::counters::Counters;
use crate::light::{Arrival, EmitterPoint, LightPoint, LightRemap};
use crate::math::luminance;
use crate::path::shadow_ray;
use crate::resampling::{Measure, ShiftMap, Shifted};
use crate::surface::SurfacePoint;
use crate::world::World;

/// Area on shapes, solid angle on environments, counting on point, spot and distant lights: the
/// kind belongs to the light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightMeasure;

impl Measure for LightMeasure {
    const NAME: &'static str = "area, solid angle or counting, by kind of light";
}

/// The frame that a receiver belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Time {
    /// This frame.
    Now,
    /// The previous frame.
    Before,
}

/// A primary hit as a domain: surface, view, lights, frame.
#[derive(Debug)]
pub struct Receiver<'a> {
    world: &'a World,
    time: Time,
    /// With the direction to the camera in its local frame.
    surface: (SurfacePoint, Vec3),
}

/// A light point as a receiver sees it.
#[derive(Clone, Copy, Debug)]
pub struct Sight {
    /// F, without visibility.
    pub integrand: Vec3,
    /// Density of BSDF sampling in the light's measure; 0 for lights that no direction meets.
    pub bsdf_density: f32,
    /// Where the light is.
    pub arrival: Arrival,
}

impl<'a> Receiver<'a> {
    /// A hit of `world` by a primary ray along unit `direction`.
    #[inline]
    #[must_use]
    pub fn new(world: &'a World, hit: Hit, direction: Vec3, time: Time) -> Self {
        let surface = world.surface(&hit);
        let outgoing = surface.frame.to_local(-direction);
        Self { world, time, surface: (surface, outgoing) }
    }

    /// Its world.
    #[inline]
    #[must_use]
    pub fn world(&self) -> &'a World {
        self.world
    }

    /// The surface, and the direction to the camera in its local frame.
    #[inline]
    #[must_use]
    pub fn surface(&self) -> &(SurfacePoint, Vec3) {
        &self.surface
    }

    /// Whether light can reach the camera from here by a lobe that is not a delta.
    #[inline]
    #[must_use]
    pub fn scatters(&self) -> bool {
        let bsdf = &self.surface().0.bsdf;
        !bsdf.is_black() && bsdf.has_non_delta()
    }

    /// What the receiver makes of an emitter's point; `None` where F is 0.
    #[inline]
    #[must_use]
    pub fn sight(&self, emitter: &EmitterPoint) -> Option<Sight> {
        let (surface, outgoing) = self.surface();
        let arrival = emitter.towards(&self.world.lights, surface.position)?;
        let scattered = surface.bsdf.evaluate(*outgoing, surface.frame.to_local(arrival.direction));
        let integrand = scattered.value * arrival.radiance;
        (integrand != Vec3::ZERO).then_some(Sight {
            integrand,
            bsdf_density: scattered.pdf * arrival.geometry,
            arrival,
        })
    }

    /// F of a light point of the receiver's own frame, with its emitter.
    #[inline(never)] // Asked in many places of each kernel; a copy in each made them slow to build and no faster.
    #[must_use]
    pub fn look(&self, point: LightPoint) -> Option<(Sight, EmitterPoint)> {
        let emitter = self.world.lights.emitter(&self.world.scene, point)?;
        Some((self.sight(&emitter)?, emitter))
    }

    /// Whether nothing stands between the receiver and an emitter's point: one shadow ray.
    #[inline(never)] // As `look`.
    #[must_use]
    pub fn sees<F: HitFilter>(
        &self,
        direction: Vec3,
        emitter: &EmitterPoint,
        filter: &F,
        counters: &mut Counters,
    ) -> bool {
        let (surface, _) = self.surface();
        let end = self.world.lights.shadow_end(emitter, surface.position);
        counters.shadow_rays += 1;
        !self.world.accel.occluded(&shadow_ray(surface, direction, end), filter)
    }
}

/// The shift of light points: T(y) is the same place on the same light, wherever that light stands
/// in the other frame's table.
///
/// With `IN_TARGET`, the integrand includes visibility: one shadow ray a shift, in the world of the
/// destination.
#[derive(Debug)]
pub struct LightPointShift<'a, F, const IN_TARGET: bool> {
    /// Which hits stop a shadow ray now; the previous frame's world brings its own.
    pub filter: &'a F,
    /// Where lights of the other frame are; `None`: at the same place.
    pub remap: Option<&'a LightRemap>,
    /// Work done.
    pub counters: Counters,
}

impl<'a, F: HitFilter, const IN_TARGET: bool> LightPointShift<'a, F, IN_TARGET> {
    /// A map between receivers of this frame and, through `remap`, of the previous one.
    #[inline]
    #[must_use]
    pub fn new(filter: &'a F, remap: Option<&'a LightRemap>) -> Self {
        Self { filter, remap, counters: Counters::default() }
    }

    /// The light point in the other frame, with |∂T|.
    #[inline]
    fn carry(
        &self,
        point: LightPoint,
        from: &Receiver<'_>,
        to: &Receiver<'_>,
    ) -> Option<(LightPoint, f32)> {
        if from.time == to.time {
            return Some((point, 1.0));
        }
        let light = match (self.remap, to.time) {
            (None, _) => point.light,
            (Some(remap), Time::Now) => remap.to_current(point.light)?,
            (Some(remap), Time::Before) => remap.to_previous(point.light)?,
        };
        let (here, there) = (&from.world.lights, &to.world.lights);
        let moved = LightPoint { light, ..point };
        let jacobian = there.scaling(moved, here, point);
        (there.same_kind(light, here, point.light) && jacobian > 0.0 && jacobian.is_finite())
            .then_some((moved, jacobian))
    }
}

impl<'a, F: HitFilter, const IN_TARGET: bool> ShiftMap for LightPointShift<'a, F, IN_TARGET> {
    type Sample = LightPoint;
    type Domain = Receiver<'a>;
    type Integrand = Vec3;
    /// A light point never leaves its light; its index is that of one frame's table, so only its
    /// place is compared.
    type Stratum = [u32; 2];

    #[inline]
    fn shift(
        &mut self,
        sample: &LightPoint,
        from: &Receiver<'a>,
        to: &Receiver<'a>,
    ) -> Option<Shifted<LightPoint, Vec3>> {
        self.counters.shifts += 1;
        let shifted = self.carry(*sample, from, to).and_then(|(point, jacobian)| {
            let (sight, emitter) = to.look(point)?;
            // A filter looks hits up in its own world.
            let (direction, counters) = (sight.arrival.direction, &mut self.counters);
            let seen = !IN_TARGET
                || match to.time {
                    Time::Now => to.sees(direction, &emitter, self.filter, counters),
                    Time::Before if to.world.has_alpha => {
                        to.sees(direction, &emitter, &to.world.alpha_mask(), counters)
                    }
                    Time::Before => to.sees(direction, &emitter, &AcceptAll, counters),
                };
            seen.then_some(Shifted { sample: point, integrand: sight.integrand, jacobian })
        });
        self.counters.shifts_failed += u64::from(shifted.is_none());
        shifted
    }

    fn stratum(&self, sample: &LightPoint) -> [u32; 2] {
        sample.uv.to_array().map(f32::to_bits)
    }
}

impl Sight {
    /// p̂ without visibility.
    #[inline]
    #[must_use]
    pub fn target(&self) -> f32 {
        luminance(self.integrand)
    }
}
