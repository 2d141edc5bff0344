//! One pixel: its surface, the lights as it sees them, a technique's estimates one by one, and what
//! the technique keeps of it.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::seeds::{SeedUse, seed};
use super::session::Session;
use crate::accel::Ray;
use crate::counters::Counters;
use crate::frame::Frame;
use crate::math::rng::{RandomSource, Stream};
use crate::path::{emitted, power_heuristic};
use crate::plan::{Elements, Plan};
use crate::reuse::light_points::{Receiver, Time};
use crate::techniques::Technique;
use crate::world::World;
use crate::{Error, Result};

/// What is looked at.
#[derive(Clone, Copy, Debug)]
pub struct Inspection {
    /// The pixel, from the upper left corner.
    pub pixel: [u32; 2],
    /// Number of the frame after a cold start, at least 1.
    pub frame: u32,
    /// Light samples, and independent estimates.
    pub samples: u32,
}

/// What was seen at a pixel.
#[derive(Debug)]
pub struct Inspected {
    /// The surface in the pixel's centre; the sky's radiance where there is none.
    pub surface: std::result::Result<SeenSurface, Vec3>,
    /// Light samples as the surface sees them; none where it does not scatter or there is no light.
    pub candidates: Vec<Candidate>,
    /// What ran.
    pub plan: Plan,
    /// The pixel's value in each restart.
    pub estimates: Vec<Vec3>,
    /// What the technique's buffers held of the pixel after the last restart, where it says
    /// something.
    pub state: Vec<BufferState>,
}

/// What one buffer held of a pixel, as its technique [describes](Technique::describe) it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BufferState {
    /// The buffer's name in the plan.
    pub buffer: &'static str,
    /// Names and values.
    pub fields: Vec<(&'static str, String)>,
}

/// The surface in a pixel's centre.
#[derive(Clone, Debug)]
pub struct SeenSurface {
    /// Distance from the camera.
    pub distance: f32,
    /// Where it is.
    pub position: Vec3,
    /// Its shading normal.
    pub normal: Vec3,
    /// The share of light that it scatters.
    pub albedo: Vec3,
    /// What it emits towards the camera.
    pub emitted: Vec3,
    /// Every light with the probability that it is chosen, the likeliest first.
    pub lights: Vec<(u32, f32)>,
}

/// A light sample, with what resampling and MIS make of it. Densities are in the light's own
/// measure.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The light's number.
    pub light: u32,
    /// What it sends; `None` where the point faces away or the surface does not reflect it.
    pub sight: Option<CandidateSight>,
}

/// What a light sample sends to the surface.
#[derive(Clone, Copy, Debug)]
pub struct CandidateSight {
    /// The target p of resampling.
    pub target: f32,
    /// Density of light sampling.
    pub by_light: f32,
    /// Density of BSDF sampling.
    pub by_bsdf: f32,
    /// Share of light sampling by the balance heuristic.
    pub balance: f32,
    /// Share of light sampling by the power heuristic, as in `nee`.
    pub power: f32,
    /// Target over density.
    pub weight: f32,
    /// Whether nothing stands between.
    pub seen: bool,
}

impl Default for Inspection {
    /// Eight samples of the first frame's upper left pixel.
    fn default() -> Self {
        Self { pixel: [0, 0], frame: 1, samples: 8 }
    }
}

impl Inspection {
    /// Looks at the pixel with a technique.
    ///
    /// # Errors
    /// An interruption; a pixel outside the picture, frame 0; whatever a loop refuses.
    pub fn run(&self, session: &Session, technique: &Arc<dyn Technique>) -> Result<Inspected> {
        let [x, y] = self.pixel;
        let [width, height] = session.shot.size;
        if x >= width || y >= height {
            return Err(Error::usage(format!(
                "pixel {x},{y} does not exist, it must be inside {width}x{height}"
            )));
        }
        if self.frame == 0 {
            return Err(Error::usage("frame 0 does not exist, the first is 1"));
        }
        let frozen = session.frozen(self.frame - 1)?;
        let (surface, receiver) =
            seen_surface(frozen.stage.first_world(), self.pixel, session.shot.size);
        let candidates = receiver.map_or_else(Vec::new, |receiver| {
            let key = seed(session.shot.run, SeedUse::Pilot, 0, 0);
            candidates(&receiver, self.samples, &mut Stream::from_key(key))
        });

        let progress = session.host().begin("estimates", u64::from(self.samples));
        let mut frames = session.start(technique, 1.0, 0)?;
        let plan = frames.plan().clone();
        let mut estimates = Vec::new();
        let mut state = Vec::new();
        for index in 0..self.samples {
            frames.restart(seed(session.shot.run, SeedUse::Restart, 0, index));
            for _ in 1..self.frame {
                session.next(&mut frames)?;
            }
            let frame = session.next(&mut frames)?;
            estimates.push(frame.picture().at(x, y));
            state = described(&plan, &**technique, &frame, (y * width + x) as usize);
            progress.step();
        }
        Ok(Inspected { surface, candidates, plan, estimates, state })
    }
}

/// What a technique's buffers hold of a pixel, where it says something.
fn described(
    plan: &Plan,
    technique: &dyn Technique,
    frame: &Frame<'_>,
    pixel: usize,
) -> Vec<BufferState> {
    let pixels = plan.buffers.iter().filter(|buffer| buffer.elements == Elements::Pixels);
    let state = pixels.filter_map(|buffer| {
        let words = buffer.bytes as usize / 4;
        let element = frame.buffer(buffer.name)?.get(words * pixel..words * (pixel + 1))?;
        Some(BufferState { buffer: buffer.name, fields: technique.describe(buffer, element) })
    });
    state.filter(|state| !state.fields.is_empty()).collect()
}

/// Light samples as a receiver sees them.
fn candidates(receiver: &Receiver<'_>, count: u32, random: &mut Stream) -> Vec<Candidate> {
    let world = receiver.world();
    let lights = &world.lights;
    if lights.is_empty() || !receiver.scatters() {
        return Vec::new();
    }
    let position = receiver.surface().0.position;
    let mut work = Counters::default();
    let mut one = || {
        let light = lights.choose(random.word(), random.word());
        let u = Vec2::new(random.uniform(), random.uniform());
        let point = lights.point_towards(light, position, u);
        let Some((sight, emitter)) = receiver.look(point) else {
            return Candidate { light, sight: None };
        };
        let by_light = lights.density_towards(point, position, sight.arrival.geometry);
        let by_bsdf = sight.bsdf_density;
        let seen = receiver.sees(sight.arrival.direction, &emitter, &world.alpha_mask(), &mut work);
        // BSDF sampling never meets a light without a surface.
        let meets = sight.arrival.geometry > 0.0;
        let sight = CandidateSight {
            target: sight.target(),
            by_light,
            by_bsdf,
            balance: by_light / (by_light + by_bsdf),
            power: if meets { power_heuristic(by_light, by_bsdf) } else { 1.0 },
            weight: sight.target() / by_light,
            seen,
        };
        Candidate { light, sight: Some(sight) }
    };
    (0..count).map(|_| one()).collect()
}

/// The surface in the pixel's centre, and the receiver that it is; the sky's radiance where there
/// is none.
fn seen_surface(
    world: &World,
    pixel: [u32; 2],
    size: [u32; 2],
) -> (std::result::Result<SeenSurface, Vec3>, Option<Receiver<'_>>) {
    let at = Vec2::new(pixel[0] as f32 + 0.5, pixel[1] as f32 + 0.5);
    let ray = world.scene.camera.rays(size).ray(at);
    let hit = world.camera_hit(&Ray {
        origin: ray.origin,
        direction: ray.direction,
        t_max: f32::INFINITY,
    });
    let Some(hit) = hit else {
        return (Err(world.escaped_radiance(ray.direction)), None);
    };
    let point = world.surface(&hit);
    let surface = SeenSurface {
        distance: hit.t,
        position: ray.origin + hit.t * ray.direction,
        normal: point.frame.normal,
        albedo: point.bsdf.albedo(),
        emitted: emitted(world, &world.accel.point(&hit), ray.direction),
        lights: lights(world),
    };
    (Ok(surface), Some(Receiver::new(world, hit, ray.direction, Time::Now)))
}

/// The lights by the probability that they are chosen.
fn lights(world: &World) -> Vec<(u32, f32)> {
    let chance = |light: u32| world.lights.choice_probability(light);
    let mut all: Vec<(u32, f32)> =
        (0..world.lights.len() as u32).map(|light| (light, chance(light))).collect();
    all.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    all
}
