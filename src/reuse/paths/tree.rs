//! One walk streamed into a reservoir: every light sample and every emitter that it meets is the
//! end of a path.

use glam::Vec3;

use super::{Anchor, Connects, Ending, NO_LOBE, PathSample, Reconnection};
use crate::accel::{Hit, HitPoint};
use crate::light::Lights;
use crate::math::luminance;
use crate::math::rng::RandomSource;
use crate::path::{Ending as Found, LightSample, Vertex, Visitor};
use crate::resampling::{Plain, Reservoir};
use crate::surface::bsdf::BsdfSample;

/// How the walk left a vertex.
#[derive(Clone, Copy, Debug, Default)]
struct Left {
    position: Vec3,
    lobe: u8,
    rough: bool,
    /// p(ω, ℓ); 0 for deltas.
    density: f32,
}

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
}

/// How the walk arrived at a vertex.
#[derive(Clone, Copy, Debug)]
struct Arrived {
    hit: Hit,
    /// Whether the pair with the vertex before may be connected, as far as that vertex and the
    /// distance say.
    reachable: bool,
    /// g from the vertex before.
    geometry: f32,
}

/// The [`Visitor`] that makes a path of each end: w = p̂ / q, with q the chance that roulette left
/// the path to its end, and their weights' share of one walk among several.
///
/// Ends of one walk lie in different parts of the sample space (they differ in length or in
/// technique), so each counts in full: W = Σw / p̂(Y), not divided by their number.
#[derive(Debug)]
pub struct Tree<'a, R> {
    lights: &'a Lights,
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
    left: Left,
    arrived: Option<Arrived>,
    open: Option<Open>,
}

impl<'a, R: RandomSource> Tree<'a, R> {
    /// Streams the walk of `seed`, one of `walks`, into a reservoir that selects by `random`, which
    /// must not be the path's own numbers.
    pub fn new(
        lights: &'a Lights,
        connects: Connects,
        (seed, walks): (u64, u32),
        reservoir: &'a mut Plain<PathSample>,
        random: &'a mut R,
    ) -> Self {
        Self {
            lights,
            connects,
            seed,
            share: 1.0 / walks as f32,
            reservoir,
            random,
            sum: Vec3::ZERO,
            clean: Vec3::ONE,
            survival: 1.0,
            left: Left::default(),
            arrived: None,
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

    /// g from the vertex that was left last to a point, and whether that is far enough away.
    fn reach(&self, at: &HitPoint) -> (f32, bool) {
        let way = at.position - self.left.position;
        let squared = way.length_squared();
        let cosine = at.geometric_normal.dot(way).abs() / squared.sqrt();
        (cosine / squared, squared >= self.connects.distance * self.connects.distance)
    }

    /// The reconnection of a path that goes on behind x_r, and ends with `light` of `density`.
    fn behind(
        &self,
        number: u32,
        open: &Open,
        light: Vec3,
        share: f32,
        density: f32,
    ) -> Reconnection {
        let at_last = u32::from(open.vertex) == number;
        Reconnection {
            vertex: open.vertex,
            lobes: open.lobes,
            anchor: Anchor::Surface(open.hit),
            direction: open.direction,
            radiance: if at_last { light } else { open.suffix * light * share },
            density: open.density,
            light_density: if at_last { density } else { 0.0 },
        }
    }
}

/// A hit as an anchor.
fn anchor(hit: &Hit) -> Anchor {
    Anchor::Surface(Hit { t: 0.0, ..*hit })
}

impl<R: RandomSource> Visitor for Tree<'_, R> {
    #[inline]
    fn vertex(&mut self, number: u32, at: &Vertex, hit: &Hit, point: &HitPoint) {
        self.arrived = (number > 0).then(|| {
            let (geometry, far) = self.reach(point);
            Arrived { hit: Hit { t: 0.0, ..*hit }, reachable: far && self.left.rough, geometry }
        });
        // What follows is about the way from here.
        self.left.position = at.surface.position;
    }

    #[inline]
    fn light(&mut self, number: u32, at: &Vertex, throughput: Vec3, sample: &LightSample) {
        let contribution = sample.contribution();
        self.sum += throughput * contribution;
        let bsdf = &at.surface.bsdf;
        let incident = &sample.incident;
        let rough = || {
            let least = self.connects.roughness;
            (0..bsdf.lobe_count()).any(|lobe| bsdf.lobe_roughness(lobe) >= least)
        };
        let reconnection = match (&self.open, &self.arrived) {
            (Some(open), _) => Reconnection {
                vertex: open.vertex,
                lobes: open.lobes,
                anchor: Anchor::Surface(open.hit),
                direction: open.direction,
                radiance: open.suffix * contribution,
                density: open.density,
                light_density: 0.0,
            },
            (None, Some(arrived)) if arrived.reachable && rough() => Reconnection {
                vertex: number as u8,
                lobes: [self.left.lobe, NO_LOBE],
                anchor: Anchor::Surface(arrived.hit),
                direction: incident.direction,
                radiance: incident.radiance,
                density: self.left.density * arrived.geometry,
                light_density: sample.density,
            },
            // A point on a light is kept whatever the distance and the lobes.
            (None, _) => {
                let from = at.surface.position;
                let point = self.lights.point_towards(sample.light, from, sample.u);
                let chance = self.lights.choice_probability(sample.light);
                Reconnection {
                    vertex: number as u8 + 1,
                    lobes: [NO_LOBE; 2],
                    anchor: Anchor::Point(point),
                    direction: incident.direction,
                    radiance: incident.radiance,
                    density: chance * incident.pdf,
                    light_density: 0.0,
                }
            }
        };
        let ending = Ending::Light { delta: incident.delta };
        self.stream(number, contribution, ending, Some(reconnection));
    }

    #[inline]
    fn scatter(&mut self, number: u32, at: &Vertex, sample: &BsdfSample, direction: Vec3) {
        let bsdf = &at.surface.bsdf;
        let lobe = u32::from(sample.lobe);
        let factor = sample.value / sample.pdf;
        let rough = !sample.delta && bsdf.lobe_roughness(lobe) >= self.connects.roughness;
        // Only a pair that may be connected asks for the density.
        let density = if rough && self.open.is_none() {
            bsdf.evaluate_lobe(lobe, at.outgoing, sample.wi).pdf
        } else {
            0.0
        };
        self.clean *= factor;
        match &mut self.open {
            Some(open) => open.suffix *= factor,
            None => {
                self.open =
                    self.arrived.filter(|arrived| arrived.reachable && rough).map(|arrived| Open {
                        vertex: number as u8,
                        lobes: [self.left.lobe, sample.lobe],
                        hit: arrived.hit,
                        direction,
                        density: self.left.density * arrived.geometry * density,
                        suffix: Vec3::ONE,
                    });
            }
        }
        self.left = Left { lobe: sample.lobe, rough, density, ..self.left };
    }

    #[inline]
    fn survive(&mut self, survival: f32) {
        self.survival *= survival;
    }

    #[inline]
    fn emitter(&mut self, number: u32, throughput: Vec3, end: &Found, hit: &Hit, at: &HitPoint) {
        self.sum += throughput * end.emission * end.share;
        let reconnection = match &self.open {
            Some(open) => Some(self.behind(number, open, end.emission, end.share, end.density)),
            None => {
                let (geometry, far) = self.reach(at);
                (far && self.left.rough).then(|| Reconnection {
                    vertex: number as u8 + 1,
                    lobes: [self.left.lobe, NO_LOBE],
                    anchor: anchor(hit),
                    direction: (at.position - self.left.position).normalize(),
                    radiance: end.emission,
                    density: self.left.density * geometry,
                    light_density: 0.0,
                })
            }
        };
        self.stream(number, end.emission * end.share, Ending::Emitter, reconnection);
    }

    #[inline]
    fn sky(&mut self, number: u32, throughput: Vec3, end: &Found, direction: Vec3) {
        self.sum += throughput * end.emission * end.share;
        let reconnection = match &self.open {
            Some(open) => Some(self.behind(number, open, end.emission, end.share, end.density)),
            None => self.left.rough.then(|| Reconnection {
                vertex: number as u8 + 1,
                lobes: [self.left.lobe, NO_LOBE],
                anchor: Anchor::Sky { light: end.light },
                direction,
                radiance: end.emission,
                density: self.left.density,
                light_density: 0.0,
            }),
        };
        self.stream(number, end.emission * end.share, Ending::Sky, reconnection);
    }
}
