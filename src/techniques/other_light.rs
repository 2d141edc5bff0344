//! All light that a technique for direct light leaves to the path tracer: a pass that several
//! share.

use glam::Vec3;

use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::pass::{Band, FrameInputs, PrimaryHit};
use crate::path::{Limits, Steps, Total, finite_or_counted, sampled, walk};
use crate::plan::Plan;
use crate::reuse::light_points::PATHS;

/// Adds what the visitor `V` sums of walks to the radiance that is there already; a walk leaves out
/// light that comes straight to the primary hit and leaves it by a lobe that is not a delta. With
/// `ALL` it leaves out nothing, and the sum is all light.
pub(super) fn add<const ALL: bool, V: Total, F: HitFilter>(
    inputs: &FrameInputs<'_>,
    filter: &F,
    roulette_after: u32,
    band: &mut Band<'_>,
) -> Counters {
    let mut counters = Counters::default();
    let hits = inputs.read::<PrimaryHit>(Plan::HITS);
    let limits = Limits { depth: inputs.shot.depth, roulette_after };
    let steps = Steps::<{ sampled::ONE }, F> { world: inputs.world, filter };
    let pixels = band.pixels();
    let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
    for (pixel, out) in pixels.zip(radiance) {
        let mut sum = Vec3::ZERO;
        let estimates = inputs.estimates(pixel);
        if let Some(hit) = hits[pixel.index as usize].get() {
            let primary = (inputs.primary_direction(pixel), &hit);
            let seeds = inputs.seeds(pixel.index);
            for sample in 0..estimates {
                let seed = seeds.seed(if ALL { sample } else { PATHS + sample });
                let mut path = V::default();
                walk::<{ sampled::ONE }, ALL, F>(
                    &steps,
                    seed,
                    primary,
                    limits,
                    &mut path,
                    &mut counters,
                );
                sum += finite_or_counted(path.total(), &mut counters);
            }
        }
        // The mean is taken as `nee` takes it, whose bits these are where `ALL` is asked for.
        let mean = sum * (1.0 / estimates as f32);
        *out = if ALL { mean } else { Vec3::from(*out) + mean }.to_array();
    }
    counters
}
