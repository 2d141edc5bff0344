//! The chains of a tile's pixels, step by step: each step is taken by all lanes before the next one
//! begins, and no lane leaves early.

use std::cell::RefCell;
use std::ops::RangeInclusive;

use glam::{IVec2, Vec2, Vec3};

use super::beyond::{Met, beyond};
use super::plan::FOLLOWS;
use super::{LOBES, LobeScore, Mcmm, McmmPaths, Planted, ReadsMode};
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::light::NO_LIGHT;
use crate::math::luminance;
use crate::math::rng::{BLOCK_SCATTER, PathSeeds, Purpose, RandomSource, draw4, unit_float};
use crate::pass::{Band, FrameInputs, Pixel, PrimaryHit, Tile};
use crate::path::{Limits, Steps, Vertex, finite_or_counted, sampled};
use crate::plan::Plan;
use crate::resampling::{Estimator, Plain, Reservoir, ShiftMap, metropolis};
use crate::reuse::light_points::Time;
use crate::reuse::lobes::follow::{LightsAt, LobeFollow};
use crate::reuse::lobes::{
    Branch, Densities, Evaluated, Found, Learning, Lobe, LobeChain, LobeSet, LobeState, MOST_LOBES,
    Permutation, Prior, Reads, SetSample, Shape, Shares, StochasticMis, Weights,
};

/// Ω/4π of what lobes of `paths=all` aim at where no emitter says it: a wide lobe, which a few
/// samples narrow to the part of the surface that is bright.
const LIT_SURFACE: f32 = 0.1;

/// What samples are weighed by, as a parameter of types.
pub(super) mod estimator {
    pub(in super::super) const SSMIS: u8 = 0;
    pub(in super::super) const TSMIS: u8 = 1;
    pub(in super::super) const MIXTURE: u8 = 2;
}

/// What all lanes of all tiles need.
pub(super) struct Chains<'a, F> {
    technique: &'a Mcmm,
    inputs: &'a FrameInputs<'a>,
    steps: Steps<'a, { sampled::ONE }, F>,
    limits: Limits,
    hits: &'a [PrimaryHit],
    /// The previous frame's lobes; empty in the first.
    previous: &'a [LobeState],
    reads: Reads,
    shares: Shares,
    learning: Learning,
    prior: Prior,
    /// The previous frame's lights and this one's, where lobes follow them.
    lights: Option<[LightsAt<'a>; 2]>,
}

/// A pixel that scatters.
struct Lane {
    at: Vertex,
    /// The pixel of the previous frame that saw the surface, as near as is known.
    before: IVec2,
    /// Its normal on the side of the camera, where light on the other side cannot come through.
    gate: Option<Vec3>,
    seeds: PathSeeds,
    /// Whether a lobe may draw here.
    guided: bool,
    /// Steps that it takes.
    steps: u32,
    /// The lobe that its chain has come to.
    kept: LobeState,
    sum: Vec3,
}

/// A direction that a technique drew, with light along it.
#[derive(Clone, Copy)]
struct Drawn {
    direction: Vec3,
    /// F of the light that the direction meets.
    direct: Vec3,
    /// F of all light behind that, which no light sample at the primary hit brings.
    beyond: Vec3,
    at: Evaluated,
    found: Found,
}

impl Drawn {
    /// F over the density of a set of `techniques`, given those of its lobes.
    #[inline]
    fn shown(&self, shares: &Shares, lobes: Densities, techniques: f32) -> Vec3 {
        let by = |integrand, at: &Evaluated| {
            let density = shares.mean_density(at, lobes, techniques);
            StochasticMis::radiance(&SetSample { integrand, density })
        };
        let direct = if self.direct == Vec3::ZERO { Vec3::ZERO } else { by(self.direct, &self.at) };
        if self.beyond == Vec3::ZERO {
            return direct;
        }
        direct + by(self.beyond, &Evaluated { light: 0.0, ..self.at })
    }
}

/// The techniques and samples of a lane's estimate by `tsmis`.
struct History {
    set: LobeSet,
    drawn: [Option<Drawn>; MOST_LOBES],
}

impl Default for History {
    fn default() -> Self {
        Self { set: LobeSet::default(), drawn: [None; MOST_LOBES] }
    }
}

/// The local memory of a tile.
struct Memory {
    lanes: [Option<Lane>; MOST_LOBES],
    /// The state that each lane works on, by slot.
    states: [LobeState; MOST_LOBES],
    /// The lobes of the states as they were before the step's draws.
    set: LobeSet,
    /// With `tsmis`, one a lane.
    histories: Vec<History>,
}

impl Default for Memory {
    fn default() -> Self {
        Self {
            lanes: std::array::from_fn(|_| None),
            states: [LobeState::NONE; MOST_LOBES],
            set: LobeSet::default(),
            histories: Vec::new(),
        }
    }
}

thread_local! {
    /// The memory of the tile that a thread works on, kept over bands and frames.
    static MEMORY: RefCell<Box<Memory>> = RefCell::default();
}

impl<'a, F: HitFilter> Chains<'a, F> {
    pub(super) fn new(technique: &'a Mcmm, inputs: &'a FrameInputs<'a>, filter: &'a F) -> Self {
        let world = inputs.world;
        let previous = inputs.at_previous(LOBES);
        let follows = inputs.plan.constant(FOLLOWS) == Some(1);
        let lights = inputs.previous.filter(|_| follows).map(|then| {
            [
                LightsAt { lights: &then.lights, time: Time::Before },
                LightsAt { lights: &world.lights, time: Time::Now },
            ]
        });
        Self {
            technique,
            inputs,
            steps: Steps { world, filter },
            limits: Limits { depth: inputs.shot.depth, roulette_after: technique.roulette_after },
            hits: inputs.read(Plan::HITS),
            previous,
            reads: Reads::new(technique.reads, technique.window(inputs.shot.size[0])),
            shares: technique.shares(),
            learning: technique.learning(),
            prior: technique.prior_of_lobes(),
            lights,
        }
    }

    /// Runs all tiles of a band.
    pub(super) fn run<const ESTIMATOR: u8>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let lobes: &mut [LobeState] = band.take(self.inputs.id(LOBES));
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        MEMORY.with_borrow_mut(|memory| {
            if ESTIMATOR == estimator::TSMIS {
                let lanes = memory.histories.len().max(self.technique.set as usize);
                memory.histories.resize_with(lanes, History::default);
            }
            for tile in band.tiles(self.inputs.shot.size) {
                self.tile::<ESTIMATOR>(&tile, memory, &mut counters);
                for (number, lane) in (0..tile.lanes()).zip(&memory.lanes) {
                    let Some(pixel) = tile.pixel(number) else { continue };
                    let (kept, mean) = match lane {
                        None => (LobeState::NONE, Vec3::ZERO),
                        Some(lane) => (lane.kept, lane.sum / self.inputs.estimates(pixel) as f32),
                    };
                    counters.lobes += u64::from(kept.is_some());
                    lobes[band.local(pixel)] = kept;
                    radiance[band.local(pixel)] = mean.to_array();
                }
            }
        });
        counters
    }

    /// All steps of a tile.
    fn tile<const ESTIMATOR: u8>(&self, tile: &Tile, memory: &mut Memory, counters: &mut Counters) {
        let Memory { lanes, states, set, histories } = memory;
        let count = tile.lanes() as usize;
        let lanes = &mut lanes[..count];
        for (number, lane) in (0..).zip(lanes.iter_mut()) {
            *lane = tile.pixel(number).and_then(|pixel| self.lane(pixel));
        }
        states[..count].fill(LobeState::NONE);
        let most = lanes.iter().flatten().map(|lane| lane.steps).max().unwrap_or(0);
        let mut permutation = Permutation::new(tile.lanes());
        let group = self.technique.steps();
        for step in 0..most {
            // Where states of other lanes come from.
            if ESTIMATOR == estimator::TSMIS && !self.technique.planted(Planted::NoShift) {
                permutation.shift();
                if self.technique.planted(Planted::DeadKeep) {
                    keep_behind_the_dead(lanes, states, &permutation);
                }
            }
            if ESTIMATOR != estimator::MIXTURE {
                for (number, lane) in (0..).zip(lanes.iter()) {
                    if let Some(lane) = lane.as_ref().filter(|lane| step < lane.steps) {
                        let state = &mut states[permutation.slot(number)];
                        self.read(lane, step, state);
                    }
                }
            }
            if ESTIMATOR == estimator::SSMIS {
                set.fill(&states[..count], &self.prior);
                let mut mask = self.inputs.stream(tile.index, Purpose::TileMask, step);
                if !self.technique.planted(Planted::NoTurn) {
                    permutation.turn(mask.index(tile.lanes()));
                }
            }
            let other = lanes.iter().flatten().next().map(|lane| lane.at.surface.position);
            // Draw, weigh, learn.
            for (number, lane) in (0..).zip(lanes.iter_mut()) {
                let Some(lane) = lane.as_mut().filter(|lane| step < lane.steps) else { continue };
                let slot = permutation.slot(number);
                match ESTIMATOR {
                    estimator::SSMIS => {
                        let mut from = lane.at.surface.position;
                        if self.technique.planted(Planted::OtherReceiver) {
                            from = other.unwrap_or(from);
                        }
                        let densities = |direction| (set.densities(from, direction), count as f32);
                        let state = &mut states[slot];
                        self.step(lane, step, set.get(slot), state, densities, counters);
                    }
                    estimator::TSMIS => {
                        let history = &mut histories[number as usize];
                        let place = (step % group) as usize;
                        self.step_of_history(
                            lane,
                            step,
                            place,
                            &mut states[slot],
                            history,
                            counters,
                        );
                        if place + 1 == group as usize {
                            self.show(lane, history, counters);
                        }
                    }
                    _ => self.step_of_mixture(lane, step, counters),
                }
            }
        }
    }

    /// The lane of a pixel; `None` where nothing scatters by a lobe that is not a delta.
    fn lane(&self, pixel: Pixel) -> Option<Lane> {
        let Self { inputs, technique, .. } = self;
        let world = inputs.world;
        let hit = self.hits[pixel.index as usize].get()?;
        let direction = inputs.primary_direction(pixel);
        let at = Vertex::at(world, &hit, &world.accel.point(&hit), direction);
        let bsdf = &at.surface.bsdf;
        if bsdf.is_black() || !bsdf.has_non_delta() {
            return None;
        }
        let rough =
            |lobe: u32| !bsdf.is_delta(lobe) && bsdf.lobe_roughness(lobe) >= technique.roughness;
        let guided = technique.paths == McmmPaths::Direct || (0..bsdf.lobe_count()).any(rough);
        let here = IVec2::new(pixel.x as i32, pixel.y as i32);
        let before = inputs
            .motion
            .and_then(|motion| motion.projection.project(inputs.position_before(&hit)?))
            .map_or(here, |place| place.floor().as_ivec2());
        let gate = (!bsdf.transmits()).then(|| {
            let normal = at.surface.frame.normal;
            if at.outgoing.z < 0.0 { -normal } else { normal }
        });
        let [width, height] = inputs.shot.size;
        let inside = before.cmpge(IVec2::ZERO).all()
            && before.cmplt(IVec2::new(width as i32, height as i32)).all();
        let own = (technique.carry > 0.0 && inside)
            .then(|| self.previous.get((before.y * width as i32 + before.x) as usize))
            .flatten();
        let kept = own.map_or(LobeState::NONE, |own| self.followed(*own));
        Some(Lane {
            at,
            before,
            gate,
            guided,
            seeds: inputs.seeds(pixel.index),
            steps: inputs.estimates(pixel) * technique.steps(),
            kept,
            sum: Vec3::ZERO,
        })
    }

    /// A lobe of the previous frame where its light is now.
    #[inline]
    fn followed(&self, lobe: LobeState) -> LobeState {
        let Some([then, now]) = &self.lights else { return lobe };
        if !lobe.is_some() || lobe.light == NO_LIGHT {
            return lobe;
        }
        let remap = self.inputs.motion.and_then(|motion| motion.lights.as_ref());
        let moved = LobeFollow { remap }.shift(&lobe, then, now);
        moved.map_or(LobeState::NONE, |moved| moved.sample)
    }

    /// What a lane chooses lobes by: their score, 0 where they aim behind an opaque surface. Scores
    /// so small or large that products with densities would not be normal numbers are 0, too.
    #[inline]
    fn score(lane: &Lane, lobe: &LobeState) -> f32 {
        const SCORES: RangeInclusive<f32> = 1e-20..=1e20;
        let hidden = lane
            .gate
            .is_some_and(|normal| normal.dot(lobe.towards(lane.at.surface.position)) <= 0.0);
        if lobe.is_some() && !hidden && SCORES.contains(&lobe.score) { lobe.score } else { 0.0 }
    }

    /// A lane's state, or one that it reads from the previous frame instead.
    #[inline]
    fn read(&self, lane: &Lane, step: u32, state: &mut LobeState) {
        let score = |lobe: &LobeState| Self::score(lane, lobe);
        let until = self.technique.reads_mode == ReadsMode::Until;
        if self.previous.is_empty() || (until && score(state) > 0.0) {
            return;
        }
        let mut random = lane.seeds.stream(Purpose::LobeReads, step);
        let around = (lane.before, self.inputs.shot.size);
        if let Some(read) = self.reads.choose(state, self.previous, around, score, &mut random) {
            *state = self.followed(read);
        }
    }

    /// Draws from the technique of a lobe, or of none; `None` where there is no light.
    fn draw(
        &self,
        lane: &Lane,
        step: u32,
        lobe: Option<&Lobe>,
        counters: &mut Counters,
    ) -> (Branch, Option<Drawn>) {
        let seed = lane.seeds.seed(step);
        let words = draw4(seed, 0, BLOCK_SCATTER);
        let branch = self.shares.branch(unit_float(words[3]), lobe.is_some());
        (branch, self.drawn(lane, (seed, words), branch, lobe, counters))
    }

    fn drawn(
        &self,
        lane: &Lane,
        (seed, words): (u64, [u32; 4]),
        branch: Branch,
        lobe: Option<&Lobe>,
        counters: &mut Counters,
    ) -> Option<Drawn> {
        let Vertex { surface, outgoing } = &lane.at;
        let (direction, value, large) = match (branch, lobe) {
            (Branch::Light, _) => return self.lit(lane, seed, counters),
            (Branch::Lobe, Some(lobe)) => {
                counters.lobe_draws += 1;
                let u = Vec2::new(unit_float(words[1]), unit_float(words[2]));
                let direction = lobe.sample(u);
                let wi = surface.frame.to_local(direction);
                let scattered = surface.bsdf.evaluate(*outgoing, wi);
                (direction, scattered.value, scattered.pdf)
            }
            _ => {
                let sample = surface.bsdf.sample(*outgoing, words).filter(|s| !s.delta)?;
                let direction = surface.frame.to_world(sample.wi).normalize();
                (direction, sample.value, sample.pdf)
            }
        };
        if value == Vec3::ZERO {
            return None;
        }
        let world = self.steps.world;
        let Some(hit) = self.steps.onward(&lane.at, direction, counters) else {
            let (radiance, light, found) = self.sky(direction)?;
            let at = Evaluated { light, large, light_only: false };
            let direct = value * radiance;
            return Some(Drawn { direction, direct, beyond: Vec3::ZERO, at, found });
        };
        let (shape, element) = world.accel.shape_of(&hit);
        let light = world.lights.of_surface(shape, element);
        if light == NO_LIGHT && self.technique.paths == McmmPaths::Direct {
            return None;
        }
        let point = world.accel.point(&hit);
        let end = (light != NO_LIGHT)
            .then(|| self.steps.ending(&lane.at, Some(large), direction, light, &point))
            .flatten();
        let met = (direction, &hit, point.position);
        let Met { sum: beyond, place, sky } = match self.technique.paths {
            McmmPaths::Direct => Met { sum: Vec3::ZERO, place: point.position, sky: false },
            McmmPaths::Caustics => beyond::<true, F>(&self.steps, seed, met, self.limits, counters),
            McmmPaths::All => beyond::<false, F>(&self.steps, seed, met, self.limits, counters),
        };
        let (emission, sampled, solid_angle) = end.map_or((Vec3::ZERO, 0.0, LIT_SURFACE), |end| {
            let alone = end.density / world.lights.choice_probability(light);
            (end.emission, end.density, share_of_sphere(alone))
        });
        if emission == Vec3::ZERO && beyond == Vec3::ZERO {
            return None;
        }
        let at = Evaluated { light: sampled, large, light_only: false };
        let found = Found { light, place, sky, solid_angle };
        Some(Drawn { direction, direct: value * emission, beyond: value * beyond, at, found })
    }

    /// The light of all skies along a direction, and the density of light sampling there, over all
    /// of them.
    fn sky(&self, direction: Vec3) -> Option<(Vec3, f32, Found)> {
        let lights = &self.steps.world.lights;
        let (mut radiance, mut density, mut choice, mut first) = (Vec3::ZERO, 0.0, 0.0, NO_LIGHT);
        for (light, environment) in lights.environments() {
            // A light sample of a sky that is black here never arrives, so it counts for nothing.
            let sent = environment.radiance(direction);
            if sent == Vec3::ZERO {
                continue;
            }
            let probability = lights.choice_probability(light);
            radiance += sent;
            density += probability * environment.pdf(direction);
            choice += probability;
            first = first.min(light);
        }
        let solid_angle = share_of_sphere(density / choice);
        let found = Found { light: first, place: direction, sky: true, solid_angle };
        (radiance != Vec3::ZERO).then_some((radiance, density, found))
    }

    /// A light sample that is seen.
    fn lit(&self, lane: &Lane, seed: u64, counters: &mut Counters) -> Option<Drawn> {
        let lights = &self.steps.world.lights;
        if lights.is_empty() {
            return None;
        }
        let sample = self.steps.light(&lane.at, (seed, 0), counters)?;
        let direction = sample.incident.direction;
        let value = sample.scattered.value;
        let Some(end) = sample.incident.end.filter(|_| !sample.incident.delta) else {
            if sample.incident.delta {
                let at = Evaluated { light: sample.density, large: 0.0, light_only: true };
                let found =
                    Found { light: sample.light, place: direction, sky: true, solid_angle: 1.0 };
                let direct = value * sample.incident.radiance;
                return Some(Drawn { direction, direct, beyond: Vec3::ZERO, at, found });
            }
            let (radiance, light, found) = self.sky(direction)?;
            let at = Evaluated { light, large: sample.scattered.pdf, light_only: false };
            let direct = value * radiance;
            return Some(Drawn { direction, direct, beyond: Vec3::ZERO, at, found });
        };
        let choice = lights.choice_probability(sample.light);
        let at =
            Evaluated { light: sample.density, large: sample.scattered.pdf, light_only: false };
        let found = Found {
            light: sample.light,
            place: end,
            sky: false,
            solid_angle: share_of_sphere(sample.density / choice),
        };
        let direct = value * sample.incident.radiance;
        Some(Drawn { direction, direct, beyond: Vec3::ZERO, at, found })
    }

    /// A step whose sample is weighed by a set of lobes and shown at once; `densities` are theirs
    /// along a direction, and the number of techniques.
    fn step(
        &self,
        lane: &mut Lane,
        step: u32,
        shape: Option<Shape>,
        state: &mut LobeState,
        densities: impl Fn(Vec3) -> (Densities, f32),
        counters: &mut Counters,
    ) {
        let from = lane.at.surface.position;
        let lobe = shape.filter(|_| lane.guided).and_then(|shape| shape.at(from));
        let (branch, drawn) = self.draw(lane, step, lobe.as_ref(), counters);
        let shown = drawn.as_ref().map_or(Vec3::ZERO, |drawn| {
            let (lobes, techniques) =
                if lane.guided { densities(drawn.direction) } else { (Densities::default(), 1.0) };
            drawn.shown(&self.shares, lobes, techniques)
        });
        lane.sum += finite_or_counted(shown, counters);
        self.learn(lane, step, (branch, drawn.as_ref(), lobe.as_ref()), shown, state, counters);
    }

    /// A step of `tsmis`, whose sample waits for the other techniques of its estimate.
    fn step_of_history(
        &self,
        lane: &mut Lane,
        step: u32,
        place: usize,
        state: &mut LobeState,
        history: &mut History,
        counters: &mut Counters,
    ) {
        let from = lane.at.surface.position;
        let shape = state.shape(&self.prior).filter(|_| lane.guided);
        let lobe = shape.and_then(|shape| shape.at(from));
        if place == 0 {
            history.set.clear(self.technique.n as usize);
        }
        history.set.set(place, shape.as_ref());
        let (branch, drawn) = self.draw(lane, step, lobe.as_ref(), counters);
        history.drawn[place] = drawn;
        // What lobes are chosen by is the mean density of the techniques so far.
        let shown = match &drawn {
            Some(drawn) if self.technique.score == LobeScore::Set => {
                let lobes = history.set.densities(from, drawn.direction);
                drawn.shown(&self.shares, lobes, (place + 1) as f32)
            }
            _ => Vec3::ZERO,
        };
        self.learn(lane, step, (branch, drawn.as_ref(), lobe.as_ref()), shown, state, counters);
    }

    /// Σᵢ Fᵢ / Σⱼ p(ωᵢ | tⱼ) over the samples and techniques of an estimate.
    fn show(&self, lane: &mut Lane, history: &History, counters: &mut Counters) {
        let from = lane.at.surface.position;
        let techniques = self.technique.n as f32;
        for drawn in history.drawn[..self.technique.n as usize].iter().flatten() {
            let mut drawn = *drawn;
            if self.technique.planted(Planted::Multiplicity) {
                drawn.at.large *= self.technique.reads as f32;
            }
            let lobes = history.set.densities(from, drawn.direction);
            let shown = drawn.shown(&self.shares, lobes, techniques) / techniques;
            lane.sum += finite_or_counted(shown, counters);
        }
    }

    /// A step of `mixture`: the lane's own lobe and those that it reads are one technique together,
    /// mixed by their scores.
    fn step_of_mixture(&self, lane: &mut Lane, step: u32, counters: &mut Counters) {
        let (mut set, mut scores) = (LobeSet::default(), Weights::default());
        let from = lane.at.surface.position;
        let lobes = self.technique.k;
        set.clear(lobes as usize);
        let mut reservoir = Plain::default();
        let mut random = lane.seeds.stream(Purpose::LobeReads, step);
        for place in 0..lobes as usize {
            let state = if place == 0 {
                lane.kept
            } else {
                let at = self.reads.place(random.word(), lane.before, self.inputs.shot.size);
                let Some(read) = at.and_then(|at| self.previous.get(at as usize)) else { continue };
                self.followed(*read)
            };
            let score = Self::score(lane, &state);
            let Some(shape) = state.shape(&self.prior).filter(|_| score > 0.0) else { continue };
            if shape.at(from).is_none() {
                continue;
            }
            if reservoir.weight_sum() + score < f32::INFINITY {
                set.set(place, Some(&shape));
                scores.set(place, score);
                reservoir.stream((state, shape), score, (), &mut random);
            }
        }
        let chosen = reservoir.selected();
        let (mut state, shape) = chosen.map_or((LobeState::NONE, None), |(s, l)| (s, Some(l)));
        let densities = |direction| {
            let lobes = set.weighted(&scores, from, direction);
            (lobes, if lobes.lobes > 0.0 { lobes.lobes } else { 1.0 })
        };
        self.step(lane, step, shape, &mut state, densities, counters);
    }

    /// The chain's step, and what the lobe that drew learns. `shown` is F over the density of the
    /// set.
    fn learn(
        &self,
        lane: &mut Lane,
        step: u32,
        (branch, drawn, lobe): (Branch, Option<&Drawn>, Option<&Lobe>),
        shown: Vec3,
        state: &mut LobeState,
        counters: &mut Counters,
    ) {
        if self.technique.carry > 0.0 {
            lane.kept.score *= self.technique.carry;
        }
        let from = lane.at.surface.position;
        // Lights that no direction meets are nothing to aim at.
        let drawn = drawn.filter(|drawn| !drawn.at.light_only);
        let Some(drawn) = drawn else {
            if branch == Branch::Lobe {
                *state = state.learnt((from, Vec3::ZERO), None, 0.0, &self.learning);
            }
            return;
        };
        counters.lobe_hits += u64::from(branch == Branch::Lobe);
        let by_branch = |density: f32| luminance(drawn.direct + drawn.beyond) / density;
        let score = match (self.technique.score, branch) {
            (LobeScore::Set, _) => luminance(shown),
            (LobeScore::Branch, Branch::Light) => by_branch(drawn.at.light),
            (LobeScore::Branch, Branch::Large) => by_branch(drawn.at.large),
            (LobeScore::Branch, Branch::Lobe) => {
                by_branch(lobe.map_or(0.0, |lobe| lobe.density(drawn.direction)))
            }
        };
        let sample = (from, drawn.direction);
        if !(score > 0.0 && score < f32::INFINITY) {
            counters.scores_rejected += 1;
            return;
        }
        let anew = branch != Branch::Lobe;
        let proposed = state.moved(sample, &drawn.found, score, anew, &self.learning);
        let mut random = lane.seeds.stream(Purpose::ChainAcceptance, step);
        let mut chain = LobeChain(|| proposed.is_some().then_some(proposed));
        let moved = metropolis(&mut chain, lane.kept, 1, &mut random);
        if moved.accepted > 0 {
            counters.chain_moves += 1;
            (lane.kept, *state) = (moved.state, moved.state);
            if self.technique.planted(Planted::StashFirst) && anew {
                lane.kept.weight = 0.0;
            }
        } else if branch == Branch::Lobe {
            *state = state.learnt(sample, Some(&drawn.found), score, &self.learning);
        }
    }
}

/// A fault that tests plant: explicit moves in which lanes behind one without a pixel keep their
/// own states.
fn keep_behind_the_dead(
    lanes: &[Option<Lane>],
    states: &mut [LobeState; MOST_LOBES],
    permutation: &Permutation,
) {
    let moved = *states;
    let count = lanes.len();
    for lane in 0..count {
        // Before the turn the lane's own state was in the slot of the lane behind it.
        if lanes[(lane + count - 1) % count].is_none() {
            let own = permutation.slot(((lane + 1) % count) as u32);
            states[permutation.slot(lane as u32)] = moved[own];
        }
    }
}

/// Ω/4π of an emitter whose directions are drawn with density 1/Ω.
#[inline]
fn share_of_sphere(density: f32) -> f32 {
    let share = 1.0 / (2.0 * std::f32::consts::TAU * density);
    // A state holds 2⁻³² and more. What light sampling does not find has no density: its share is
    // no number, or infinite.
    if share <= 1.0 { share.max(1e-9) } else { 1.0 }
}
