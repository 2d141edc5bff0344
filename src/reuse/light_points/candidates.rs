//! A pixel's own candidates: light samples and BSDF samples with one mixture density, and light
//! points made ahead in tiles.

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};
use pulp::{Arch, NullaryFnOnce};

use super::{LightMeasure, Receiver, Sight};
use crate::accel::{HitFilter, Ray};
use crate::counters::Counters;
use crate::light::{EmitterPoint, EmitterPoints, LightPoint, NO_LIGHT};
use crate::math::rng::{BLOCK_LIGHT, BLOCK_SCATTER, PathSeeds, RandomSource, draw4, unit_float};
use crate::math::{LANES, Lanes, luminances};
use crate::resampling::{Finished, Plain, Reservoir};
use crate::world::World;

/// A light point made ahead, with its emitter and density: 60 bytes.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C)]
pub struct TileEntry {
    pub(super) emitter: EmitterPoint,
    pub(super) light: u32,
    pub(super) uv: [f32; 2],
    /// In the light's measure, the choice of the light included; 0: emits nothing.
    pub(super) density: f32,
}

/// Entries of a tile: 15 KB, so that a tile stays in the nearest cache.
pub(crate) const TILE: u32 = 256;

/// Fills an entry of a tile with the 128 random bits `words`: a light by power, a point uniform on
/// it.
#[must_use]
pub fn fill_tile(world: &World, words: [u32; 4], counters: &mut Counters) -> TileEntry {
    counters.tile_entries += 1;
    if world.lights.is_empty() {
        return TileEntry::zeroed();
    }
    let light = world.lights.choose(words[0], words[1]);
    let point = LightPoint { light, uv: Vec2::new(unit_float(words[2]), unit_float(words[3])) };
    let density = world.lights.uniform_density(point);
    match world.lights.emitter(&world.scene, point) {
        // A density may underflow.
        Some(emitter) if density > 0.0 => {
            TileEntry { emitter, light, uv: point.uv.to_array(), density }
        }
        _ => TileEntry::zeroed(),
    }
}

/// Where candidates come from.
#[derive(Clone, Copy, Debug)]
pub struct Candidates<'a> {
    /// Light samples.
    pub lights: u32,
    /// BSDF samples; each sees all emitters along its ray.
    pub bsdf: u32,
    /// Light points made ahead to draw from, instead of from the light table.
    pub tile: Option<&'a [TileEntry]>,
    /// Whether any emitter is a surface, so that BSDF samples need a ray.
    pub surfaces: bool,
}

/// The candidate that was selected, as its receiver sees it.
#[derive(Clone, Copy, Debug)]
pub struct Chosen {
    /// The light point.
    pub point: LightPoint,
    /// Its emitter.
    pub emitter: EmitterPoint,
    /// What the receiver makes of it.
    pub sight: Sight,
    weight_sum: f32,
}

/// A candidate on its way through the reservoir.
#[derive(Clone, Copy)]
struct Offered {
    point: LightPoint,
    /// Whether the point's place holds the numbers that it is drawn with, from which the place
    /// follows.
    drawn: bool,
}

/// The chosen one of a receiver's candidates, numbered from `first`: wᵢ = p̂(yᵢ) / (Mₗ pₗ + Mᵦ pᵦ),
/// so that W = Σw / p̂(Y). The density of both techniques together stands below the line (balance
/// heuristic; Veach 1997), so it may be asked for candidates of either.
#[inline(never)] // One call a pixel; every policy's kernel would hold a copy.
pub fn candidates(
    receiver: &Receiver<'_>,
    from: &Candidates<'_>,
    (seeds, first): (PathSeeds, u32),
    selection: &mut impl RandomSource,
    counters: &mut Counters,
) -> Option<Chosen> {
    let world = receiver.world();
    let (lights, scene) = (&world.lights, &*world.scene);
    let (surface, outgoing) = receiver.surface();
    let mut reservoir = Plain::default();
    if lights.is_empty() {
        // A host may switch off all lights of a scene that was planned with some.
        return None;
    }
    let shares @ (light_share, bsdf_share) = (from.lights as f32, from.bsdf as f32);
    Arch::new().dispatch(LightSamples {
        receiver,
        from,
        numbers: (seeds, first),
        shares,
        reservoir: &mut reservoir,
        selection,
    });
    counters.candidates += u64::from(from.lights);
    for candidate in 0..from.bsdf {
        let number = first + from.lights + candidate;
        let words = draw4(seeds.seed(number), 0, BLOCK_SCATTER);
        counters.candidates += 1;
        let Some(sample) = surface.bsdf.sample(*outgoing, words).filter(|s| !s.delta) else {
            continue;
        };
        let direction = surface.frame.to_world(sample.wi).normalize();
        let mut offer = |point: LightPoint| {
            let Some(emitter) = lights.emitter(scene, point) else { return };
            let Some(sight) = receiver.sight(&emitter) else { return };
            let density = if from.tile.is_some() {
                lights.uniform_density(point)
            } else {
                lights.density_towards(point, surface.position, sight.arrival.geometry)
            };
            let weight = sight.target() / (light_share * density + bsdf_share * sight.bsdf_density);
            reservoir.stream(Offered { point, drawn: false }, weight, (), selection);
        };
        for (light, environment) in lights.environments() {
            if let Some(uv) = environment.invert(direction) {
                offer(LightPoint { light, uv });
            }
        }
        if from.surfaces
            && let Some(emitters) = world.emitters()
        {
            counters.emitter_rays += 1;
            let ray = Ray { origin: surface.origin(direction), direction, t_max: f32::INFINITY };
            emitters.along(&ray, lights, offer);
        }
    }
    counters.weights_rejected += u64::from(reservoir.rejected());
    // Evaluated once more: cheaper than to carry it along with every candidate that was selected
    // for a while.
    reservoir.selected().and_then(|Offered { point, drawn }| {
        let point = if drawn {
            lights.point_towards(point.light, surface.position, point.uv)
        } else {
            point
        };
        let (sight, emitter) = receiver.look(point)?;
        Some(Chosen { point, emitter, sight, weight_sum: reservoir.weight_sum() })
    })
}

/// Streams a receiver's light samples, [`LANES`] at a time.
struct LightSamples<'a, 'r, R> {
    receiver: &'a Receiver<'r>,
    from: &'a Candidates<'a>,
    /// The pixel's seeds, and the first candidate's number.
    numbers: (PathSeeds, u32),
    /// Light samples and BSDF samples in all.
    shares: (f32, f32),
    reservoir: &'a mut Plain<Offered>,
    selection: &'a mut R,
}

impl<R: RandomSource> NullaryFnOnce for LightSamples<'_, '_, R> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { receiver, from, numbers: (seeds, first), shares, reservoir, selection } = self;
        let (lights, scene) = (&receiver.world().lights, &*receiver.world().scene);
        let (surface, outgoing) = receiver.surface();
        let count = from.lights;
        for start in (0..count).step_by(LANES) {
            let lanes = LANES.min((count - start) as usize);
            let number = |lane: usize| first + start + lane as u32;
            let mut emitters = EmitterPoints::DARK;
            let mut density = Lanes::ZERO;
            let mut points = [LightPoint { light: NO_LIGHT, uv: Vec2::ZERO }; LANES];
            if let Some(tile) = from.tile {
                let mut words = [0; 4];
                for (lane, point) in points.iter_mut().enumerate().take(lanes) {
                    // An entry takes one word: four candidates share a draw.
                    if lane % 4 == 0 {
                        words = draw4(seeds.seed(number(lane)), 0, BLOCK_LIGHT);
                    }
                    let at = (u64::from(words[lane % 4]) * tile.len() as u64) >> 32;
                    let entry = &tile[at as usize];
                    emitters.set(lane, &entry.emitter);
                    density.0[lane] = entry.density;
                    *point = LightPoint { light: entry.light, uv: Vec2::from(entry.uv) };
                }
            } else {
                for (lane, point) in points.iter_mut().enumerate().take(lanes) {
                    let words = draw4(seeds.seed(number(lane)), 0, BLOCK_LIGHT);
                    let light = lights.choose(words[0], words[1]);
                    let uv = Vec2::new(unit_float(words[2]), unit_float(words[3]));
                    *point = LightPoint { light, uv };
                    if let Some(emitter) =
                        lights.emitter_towards(scene, light, surface.position, uv)
                    {
                        emitters.set(lane, &emitter);
                    }
                }
            }
            let arrivals = emitters.towards(lights, surface.position);
            let wi = surface.frame.lanes_to_local(arrivals.direction);
            let (value, pdf) = surface.bsdf.evaluate_lanes(*outgoing, &wi, arrivals.lit());
            let target = luminances(value.times(arrivals.radiance));
            if from.tile.is_none() {
                for (lane, point) in points.iter().enumerate().take(lanes) {
                    if target.0[lane] > 0.0 {
                        let geometry = arrivals.geometry.0[lane];
                        density.0[lane] =
                            lights.density_towards(*point, surface.position, geometry);
                    }
                }
            }
            let both = density * shares.0 + pdf * arrivals.geometry * shares.1;
            let weight = target / both;
            for (lane, point) in points.into_iter().enumerate().take(lanes) {
                // Written so that NaN is offered, and counted.
                if target.0[lane] <= 0.0 {
                    continue;
                }
                let offered = Offered { point, drawn: from.tile.is_none() };
                reservoir.stream(offered, weight.0[lane], (), selection);
            }
        }
    }
}

impl Chosen {
    /// F of the candidate, unshadowed.
    #[inline]
    #[must_use]
    pub fn integrand(&self) -> Vec3 {
        self.sight.integrand
    }

    /// Whether nothing stands between the receiver and the candidate: one shadow ray.
    #[inline]
    #[must_use]
    pub fn is_seen<F: HitFilter>(
        &self,
        receiver: &Receiver<'_>,
        filter: &F,
        counters: &mut Counters,
    ) -> bool {
        receiver.sees(self.sight.arrival.direction, &self.emitter, filter, counters)
    }

    /// The finished reservoir: W = Σw / p̂(Y).
    #[inline]
    #[must_use]
    pub fn finish(&self, confidence: f32) -> Finished<LightPoint, LightMeasure> {
        Finished::from_sum(Some(self.point), self.weight_sum, self.sight.target(), 1.0, confidence)
    }
}
