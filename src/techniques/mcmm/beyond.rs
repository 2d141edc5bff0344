//! Light that a guided direction finds behind the first thing that it meets, and what of a pixel's
//! light is then left to the path tracer.

use glam::Vec3;

use crate::accel::{Hit, HitFilter, HitPoint};
use crate::counters::Counters;
use crate::path::{
    Ending, LightSample, Limits, Steps, Sum, Total, Vertex, Visitor, sampled, walk_from,
};
use crate::surface::bsdf::BsdfSample;

/// Light behind the first hit, which is vertex 1, and where it appears to come from.
///
/// Where vertex 1 is a perfectly specular surface, light seems to come from
///
/// ```text
/// y = x₁ + ω t (|cos θ| / |cos θ'|) (n / n')
/// ```
///
/// with t the way from there to what is met next, θ and n the angle and index on the side of the
/// receiver, θ' and n' on the other one (Rath et al. 2020, eq. 35): a lobe that aims at y from
/// nearby finds the same light. For a mirror it is the image behind it.
struct Beyond<const DELTAS: bool> {
    met: Met,
    from: Vec3,
    direction: Vec3,
    /// (|cos θ| / |cos θ'|) (n / n'), where vertex 1 scattered by a delta.
    stretch: Option<f32>,
}

/// Light that a direction found behind the first hit.
#[derive(Clone, Copy)]
pub(super) struct Met {
    /// Radiance.
    pub(super) sum: Vec3,
    /// Where it appears to come from, or the direction to there.
    pub(super) place: Vec3,
    /// Whether it is a sky, seen through or in a perfectly specular surface.
    pub(super) sky: bool,
}

impl<const DELTAS: bool> Beyond<DELTAS> {
    fn reached(&mut self, number: u32, at: Vec3) {
        if number == 1
            && let Some(stretch) = self.stretch
        {
            self.met.place = self.from + self.direction * (stretch * self.from.distance(at));
        }
    }
}

impl<const DELTAS: bool> Visitor for Beyond<DELTAS> {
    #[inline(always)]
    fn vertex(&mut self, number: u32, _: &Vertex, _: &Hit, point: &HitPoint) {
        self.reached(number.wrapping_sub(1), point.position);
    }

    #[inline(always)]
    fn light(&mut self, _: u32, _: &Vertex, throughput: Vec3, sample: &LightSample) {
        self.met.sum += throughput * sample.contribution();
    }

    #[inline(always)]
    fn follows(&self, _: u32, sample: &BsdfSample) -> bool {
        !DELTAS || sample.delta
    }

    #[inline(always)]
    fn scatter(&mut self, number: u32, at: &Vertex, sample: &BsdfSample, _: Vec3) {
        if number == 1 && sample.delta {
            let cosines = at.outgoing.z.abs() / sample.wi.z.abs();
            self.stretch = Some(cosines / sample.eta).filter(|stretch| stretch.is_finite());
        }
    }

    #[inline(always)]
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Ending, _: &Hit, at: &HitPoint) {
        self.reached(number, at.position);
        self.met.sum += throughput * end.emission * end.share;
    }

    #[inline(always)]
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Ending, _: Vec3) {
        if number == 1 && self.stretch.is_some() {
            // Its image is as far away as itself.
            (self.met.place, self.met.sky) = (self.direction, true);
        }
        self.met.sum += throughput * end.emission * end.share;
    }
}

/// Radiance that arrives along a direction from behind the hit that it met, and where it appears to
/// come from. With `DELTAS` only through perfectly specular surfaces.
pub(super) fn beyond<const DELTAS: bool, F: HitFilter>(
    steps: &Steps<'_, { sampled::ONE }, F>,
    seed: u64,
    (direction, hit, at): (Vec3, &Hit, Vec3),
    limits: Limits,
    counters: &mut Counters,
) -> Met {
    let met = Met { sum: Vec3::ZERO, place: at, sky: false };
    let mut visitor = Beyond::<DELTAS> { met, from: at, direction, stretch: None };
    let from = (seed, 1);
    if DELTAS {
        // No vertex on the way can sample a light.
        let Steps { world, filter } = *steps;
        let steps = Steps::<{ sampled::NONE }, F> { world, filter };
        walk_from::<{ sampled::NONE }, true, F>(
            &steps,
            from,
            (direction, hit),
            limits,
            &mut visitor,
            counters,
        );
    } else {
        walk_from::<{ sampled::ONE }, true, F>(
            steps,
            from,
            (direction, hit),
            limits,
            &mut visitor,
            counters,
        );
    }
    visitor.met
}

/// All light but what comes by a lobe that is not a delta, at the primary hit, through perfectly
/// specular surfaces alone: what is left beside `paths=caustics`.
#[derive(Debug, Default)]
pub(super) struct WithoutCaustics {
    sum: Sum,
    /// Whether the path so far is what the lobes guide.
    guided: bool,
}

impl Visitor for WithoutCaustics {
    #[inline(always)]
    fn light(&mut self, number: u32, at: &Vertex, throughput: Vec3, sample: &LightSample) {
        self.sum.light(number, at, throughput, sample);
    }

    #[inline(always)]
    fn scatter(&mut self, number: u32, _: &Vertex, sample: &BsdfSample, _: Vec3) {
        self.guided = if number == 0 { !sample.delta } else { self.guided && sample.delta };
    }

    #[inline(always)]
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Ending, hit: &Hit, at: &HitPoint) {
        if !self.guided {
            self.sum.emitter(number, throughput, end, hit, at);
        }
    }

    #[inline(always)]
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Ending, direction: Vec3) {
        if !self.guided {
            self.sum.sky(number, throughput, end, direction);
        }
    }
}

impl Total for WithoutCaustics {
    fn total(&self) -> Vec3 {
        self.sum.total()
    }
}

/// All light that leaves the primary hit by a delta: what is left beside `paths=all`.
#[derive(Debug, Default)]
pub(super) struct DeltaFirst(Sum);

impl Visitor for DeltaFirst {
    #[inline(always)]
    fn light(&mut self, number: u32, at: &Vertex, throughput: Vec3, sample: &LightSample) {
        self.0.light(number, at, throughput, sample);
    }

    #[inline(always)]
    fn follows(&self, number: u32, sample: &BsdfSample) -> bool {
        number > 0 || sample.delta
    }

    #[inline(always)]
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Ending, hit: &Hit, at: &HitPoint) {
        self.0.emitter(number, throughput, end, hit, at);
    }

    #[inline(always)]
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Ending, direction: Vec3) {
        self.0.sky(number, throughput, end, direction);
    }
}

impl Total for DeltaFirst {
    fn total(&self) -> Vec3 {
        self.0.total()
    }
}
