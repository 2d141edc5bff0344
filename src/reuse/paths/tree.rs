//! One walk streamed into a reservoir: every light sample and every emitter that it meets is the
//! end of a path.

use glam::Vec3;

use super::ends::{LightEnd, light_end};
use super::trail::Trail;
use super::{Anchor, Connects, Ending, NO_LOBE, Next, PathSample, Place, Reconnection};
use crate::accel::{Hit, HitPoint};
use crate::light::LightPoint;
use crate::math::luminance;
use crate::math::rng::RandomSource;
use crate::path::{Ending as Found, LightSample, Vertex, Visitor};
use crate::resampling::{Plain, Reservoir};
use crate::surface::bsdf::BsdfSample;
use crate::world::World;

/// A connectable pair's second vertex, and what came after it.
#[derive(Clone, Copy, Debug)]
struct Open {
    vertex: u8,
    lobes: [u8; 2],
    hit: Hit,
    direction: Vec3,
    density: f32,
    /// Π f/p̄ behind it.
    suffix: Vec3,
    /// The vertex behind it.
    next: Next,
    /// Π f/p̄ behind that.
    beyond: Vec3,
}

/// The [`Visitor`] that makes a path of each end: w = p̂ / q, with q the chance that roulette left
/// the path to its end, and their weights' share of one walk among several.
///
/// Ends of one walk lie in different parts of the sample space (they differ in length or in
/// technique), so each counts in full: W = Σw / p̂(Y), not divided by their number.
///
/// With `MUTABLE`, paths know what follows their `x_r`.
#[derive(Debug)]
pub struct Tree<'a, R, const MUTABLE: bool> {
    world: &'a World,
    connects: Connects,
    seed: u64,
    /// 1 over the number of walks.
    share: f32,
    reservoir: &'a mut Plain<PathSample>,
    random: &'a mut R,
    /// Σ F/q: what the walk's path tracer shows.
    pub sum: Vec3,
    /// Π f/p̄ without roulette.
    clean: Vec3,
    survival: f32,
    trail: Trail,
    /// The hit at the vertex that the walk is at.
    hit: Hit,
    /// The direction that the walk left it by.
    direction: Vec3,
    open: Option<Open>,
}

impl<'a, R: RandomSource, const MUTABLE: bool> Tree<'a, R, MUTABLE> {
    /// Streams the walk of `seed`, one of `walks`, into a reservoir that selects by `random`, which
    /// must not be the path's own numbers.
    pub fn new(
        world: &'a World,
        connects: Connects,
        (seed, walks): (u64, u32),
        reservoir: &'a mut Plain<PathSample>,
        random: &'a mut R,
    ) -> Self {
        Self {
            world,
            connects,
            seed,
            share: 1.0 / walks as f32,
            reservoir,
            random,
            sum: Vec3::ZERO,
            clean: Vec3::ONE,
            survival: 1.0,
            trail: Trail::default(),
            hit: Hit { t: 0.0, u: 0.0, v: 0.0, primitive: 0, instance: 0 },
            direction: Vec3::Z,
            open: None,
        }
    }

    fn stream(
        &mut self,
        number: u32,
        contribution: Vec3,
        ending: Ending,
        reconnection: Option<Reconnection>,
    ) {
        let integrand = self.clean * contribution;
        let weight = luminance(integrand) / self.survival * self.share;
        let (seed, last) = (self.seed, number as u8);
        let sample = PathSample { seed, integrand, last, ending, reconnection };
        self.reservoir.stream(sample, weight, (), self.random);
    }

    /// The reconnection of a path that goes on behind `x_r`, and meets an end at a place.
    fn behind(&self, number: u32, open: &Open, end: &Found, place: Place) -> Reconnection {
        let Found { emission: light, share, density, .. } = *end;
        let at_last = u32::from(open.vertex) == number;
        let next = match number - u32::from(open.vertex) {
            _ if !MUTABLE => Next::default(),
            0 => Next::end(place),
            1 => open.next.lit(light, density),
            _ => open.next.lit(open.beyond * light * share, 0.0),
        };
        Reconnection {
            vertex: open.vertex,
            lobes: open.lobes,
            anchor: Anchor::Surface(open.hit),
            direction: open.direction,
            radiance: if at_last { light } else { open.suffix * light * share },
            density: open.density,
            light_density: if at_last { density } else { 0.0 },
            next,
        }
    }

    /// What follows `x_r` on a path that vertex `number` behind it ends with a light sample.
    fn next(&self, number: u32, open: &Open, sample: &LightSample) -> Next {
        if !MUTABLE {
            Next::default()
        } else if number == u32::from(open.vertex) + 1 {
            let incident = &sample.incident;
            Next::vertex(&self.hit, NO_LOBE, incident.direction)
                .lit(incident.radiance, sample.density)
        } else {
            open.next.lit(open.beyond * sample.contribution(), 0.0)
        }
    }

    /// The point that was sampled, as it is kept; `None` where rounding moved it behind the light.
    fn point(&self, at: &Vertex, sample: &LightSample) -> Option<(LightPoint, LightEnd)> {
        let from = at.surface.position;
        let point = self.world.lights.point_towards(sample.light, from, sample.u);
        light_end(self.world, from, point).map(|end| (point, end))
    }
}

/// A hit without its t, which is of no use elsewhere.
fn place(hit: &Hit) -> Hit {
    Hit { t: 0.0, ..*hit }
}

impl<R: RandomSource, const MUTABLE: bool> Visitor for Tree<'_, R, MUTABLE> {
    #[inline]
    fn vertex(&mut self, number: u32, at: &Vertex, hit: &Hit, point: &HitPoint) {
        self.trail.arrive(&self.connects, number, at, (point, hit.t));
        self.hit = place(hit);
    }

    #[inline]
    fn light(&mut self, number: u32, at: &Vertex, throughput: Vec3, sample: &LightSample) {
        let contribution = sample.contribution();
        self.sum += throughput * contribution;
        let incident = &sample.incident;
        let reconnection = match &self.open {
            Some(open) => Some(Reconnection {
                vertex: open.vertex,
                lobes: open.lobes,
                anchor: Anchor::Surface(open.hit),
                direction: open.direction,
                radiance: open.suffix * contribution,
                density: open.density,
                light_density: 0.0,
                next: self.next(number, open, sample),
            }),
            None if self.trail.connects(
                &self.connects,
                &at.surface.bsdf,
                None,
                sample.scattered.pdf,
            ) =>
            {
                Some(Reconnection {
                    vertex: number as u8,
                    lobes: [self.trail.lobe, NO_LOBE],
                    anchor: Anchor::Surface(self.hit),
                    direction: incident.direction,
                    radiance: incident.radiance,
                    density: self.trail.density * self.trail.way.geometry,
                    light_density: sample.density,
                    next: match MUTABLE.then(|| self.point(at, sample)).flatten() {
                        Some((point, _)) => Next::end(Place::Light(point)),
                        None => Next::default(),
                    },
                })
            }
            // A point on a light is kept whatever the distance and the lobes; nothing is where
            // rounding moved it behind the light.
            None => self.point(at, sample).map(|(point, end)| Reconnection {
                vertex: number as u8 + 1,
                lobes: [NO_LOBE; 2],
                anchor: Anchor::Point(point),
                direction: Vec3::ZERO,
                radiance: Vec3::ZERO,
                density: end.density,
                light_density: 0.0,
                next: Next::default(),
            }),
        };
        let ending = Ending::Light { delta: incident.delta };
        self.stream(number, contribution, ending, reconnection);
    }

    #[inline]
    fn scatter(&mut self, number: u32, at: &Vertex, sample: &BsdfSample, direction: Vec3) {
        let bsdf = &at.surface.bsdf;
        let lobe = u32::from(sample.lobe);
        let factor = sample.value / sample.pdf;
        let rough = !sample.delta && self.connects.is_rough(bsdf, lobe);
        let connects = self.open.is_none()
            && self.trail.connects(&self.connects, bsdf, Some(lobe), sample.pdf);
        // Only a pair that may be connected asks for the density.
        let density = if self.open.is_none() && (rough || connects) {
            bsdf.evaluate_lobe(lobe, at.outgoing, sample.wi).pdf
        } else {
            0.0
        };
        self.clean *= factor;
        match &mut self.open {
            Some(open) => {
                open.suffix *= factor;
                if MUTABLE && number == u32::from(open.vertex) + 1 {
                    open.next = Next::vertex(&self.hit, sample.lobe, direction);
                } else if MUTABLE {
                    open.beyond *= factor;
                }
            }
            None if connects => {
                self.open = Some(Open {
                    vertex: number as u8,
                    lobes: [self.trail.lobe, sample.lobe],
                    hit: self.hit,
                    direction,
                    density: self.trail.density * self.trail.way.geometry * density,
                    suffix: Vec3::ONE,
                    next: Next::default(),
                    beyond: Vec3::ONE,
                });
            }
            None => {}
        }
        self.trail.leave(sample.lobe, rough, sample.pdf, density);
        self.direction = direction;
    }

    #[inline]
    fn survive(&mut self, survival: f32) {
        self.survival *= survival;
    }

    #[inline]
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Found, hit: &Hit, at: &HitPoint) {
        self.sum += throughput * end.emission * end.share;
        let reconnection = match &self.open {
            Some(open) => Some(self.behind(number, open, end, Place::Surface(place(hit)))),
            None => {
                let way = self.trail.way_to(at);
                let connects = self.trail.rough && self.trail.leaves_to(&self.connects, &way);
                connects.then(|| Reconnection {
                    vertex: number as u8 + 1,
                    lobes: [self.trail.lobe, NO_LOBE],
                    anchor: Anchor::Surface(place(hit)),
                    direction: Vec3::ZERO,
                    radiance: Vec3::ZERO,
                    density: self.trail.density * way.geometry,
                    light_density: 0.0,
                    next: Next::default(),
                })
            }
        };
        self.stream(number, end.emission * end.share, Ending::Emitter, reconnection);
    }

    #[inline]
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Found, direction: Vec3) {
        self.sum += throughput * end.emission * end.share;
        let reconnection = match &self.open {
            Some(open) => Some(self.behind(number, open, end, Place::Sky)),
            None => self.trail.rough.then(|| Reconnection {
                vertex: number as u8 + 1,
                lobes: [self.trail.lobe, NO_LOBE],
                anchor: Anchor::Sky { light: end.light },
                direction,
                radiance: end.emission,
                density: self.trail.density,
                light_density: 0.0,
                next: Next::default(),
            }),
        };
        let sky = self.world.lights.environments().position(|(light, _)| light == end.light);
        let ending = Ending::Sky { sky: sky.unwrap_or(0) as u32 };
        self.stream(number, end.emission * end.share, ending, reconnection);
    }
}
