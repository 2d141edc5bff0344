//! The loop's own pass: what primary rays meet.

use crate::accel::{HitFilter, Ray};
use crate::counters::Counters;
use crate::pass::{Band, FrameInputs, PrimaryHit};
use crate::path::emitted;
use crate::plan::Plan;
use crate::world::WithFilter;

/// Traces primary rays through pixel centres and writes hits and directly visible emission.
pub(super) fn primary_hits(inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
    struct Hits<'a, 'b, 'c>(&'a FrameInputs<'b>, &'a mut Band<'c>);
    impl WithFilter for Hits<'_, '_, '_> {
        type Output = Counters;

        fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
            let Self(inputs, band) = self;
            let world = inputs.world;
            let hits: &mut [PrimaryHit] = band.take(Plan::HITS);
            let emission: &mut [[f32; 3]] = band.take(Plan::EMISSION);
            let first = band.range.start * band.width;
            for (local, (out, seen)) in hits.iter_mut().zip(emission).enumerate() {
                let pixel = first + local as u32;
                let ray = inputs.camera.ray(inputs.sample_position(
                    pixel % band.width,
                    pixel / band.width,
                    0,
                ));
                let hit = world.camera_hit_with(
                    &Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY },
                    &filter,
                );
                *seen = match &hit {
                    Some(hit) => emitted(world, &world.accel.point(hit), ray.direction),
                    None => world.escaped_radiance(ray.direction),
                }
                .to_array();
                *out = hit.into();
            }
            Counters {
                primary_rays: u64::from(band.range.end - band.range.start) * u64::from(band.width),
                ..Counters::default()
            }
        }
    }
    inputs.world.with_filter(Hits(inputs, band))
}
