//! Mutations of `x_r`: the direction that `v_{r−1}` is left by takes a small step in the numbers
//! of its lobe, and what follows `x_r` stays where it is (Fickel 2023, chapter 5; Sawhney et al.
//! 2024).
//!
//! | symbol | meaning |
//! |---|---|
//! | u | the two numbers from which `ℓ_{r−1}` made `ω_{r−1}` |
//! | T | (u, …) ↦ (u', …), with the numbers of `x_r` and `v_{r+1}` that lead from the new `x_r` to the old `v_{r+1}` and on |
//! | M | what the numbers that T changes are worth: p(`ω_r`, `ℓ_r`) g p(`ω_{r+1}`, `ℓ_{r+1}`), with g = \|cos\|/d² at `v_{r+1}` |
//! | A | p̂ M |
//!
//! F is in the measure of the path's numbers, where \|∂T\| = M'/M, so a step is accepted with
//! min(1, A'/A): the determinant is block-triangular, and a step of u itself is symmetric. F holds
//! the same densities as quotients, so A has only f and s = p ℓ/p̄ of `x_r` and `v_{r+1}`, and no
//! density that may vanish.
//!
//! | what follows `x_r` | M |
//! |---|---|
//! | a vertex that scatters on | p(`ω_r`, `ℓ_r`) g p(`ω_{r+1}`, `ℓ_{r+1}`) |
//! | a vertex that samples a light | p(`ω_r`, `ℓ_r`) g: that vertex's light numbers stay |
//! | an emitter that `v_r` met | p(`ω_r`, `ℓ_r`) g |
//! | a sky | p(`ω_r`, `ℓ_r`): the direction stays |
//! | a point on a light that `v_r` sampled | its density, choice included |
//! | nothing: `x_r` is the emitter or the sky | 1: u moves what is met |
//! | nothing: `x_r` is a point on a light | its density, and the area of a unit of its u, v: these take the step |
//!
//! Paths without `x_r`, and those whose `v_{r+1}` is left by a lobe that is not rough, stay: the
//! kernel is the identity on them, and no step leads there or away.

use glam::{Vec2, Vec3};

use super::ends::{Leaves, Met, Onward, Sight, end_at, onward_from};
use super::failure::Failure;
use super::replay::Replay;
use super::shift::{Connected, Left, PathReceiver, PathShift};
use super::suffix::{Lit, Suffix};
use super::{Anchor, NO_LOBE, PathSample, Place, Reconnection};
use crate::accel::{Hit, HitFilter, HitPoint};
use crate::light::LightPoint;
use crate::math::luminance;
use crate::math::rng::RandomSource;
use crate::path::{Steps, Vertex, sampled};
use crate::resampling::{Mutator, Proposal, SmallStep};
use crate::world::World;

/// A chain's state: a path whose `x_r` may have moved.
#[derive(Clone, Copy, Debug)]
pub struct PathState {
    /// u, or the u and v of `x_r` on its light.
    numbers: Vec2,
    path: Connected,
    /// A.
    flow: f32,
}

impl PathState {
    /// The path, all else as in the one that the chain began with.
    #[must_use]
    pub fn sample(&self, of: &PathSample) -> PathSample {
        let Connected { integrand, ending, reconnection, .. } = self.path;
        PathSample { integrand, ending, reconnection, ..*of }
    }

    /// A: the chain's invariant density in its numbers, to a constant.
    #[must_use]
    pub fn flow(&self) -> f32 {
        self.flow
    }
}

/// What follows `x_r`, which stays while `x_r` moves.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "one a chain, which is never moved")]
enum Following {
    /// Nothing: `x_r` is the end.
    Nothing,
    Sky,
    Light(LightPoint),
    /// The emitter that ends the path.
    Emitter(HitPoint),
    /// A vertex. Only the direction that it is met from changes.
    Vertex(HitPoint, Vertex),
}

impl Following {
    fn new(world: &World, sample: &PathSample, kept: &Reconnection) -> Option<Self> {
        if !matches!(kept.anchor, Anchor::Surface(_)) || kept.vertex > sample.last {
            return Some(Self::Nothing);
        }
        Some(match kept.next.place()? {
            Place::Sky => Self::Sky,
            Place::Light(point) => Self::Light(point),
            Place::Surface(hit) => {
                let point = world.accel.point(&hit);
                if kept.vertex == sample.last {
                    return Some(Self::Emitter(point));
                }
                let vertex = Vertex::new(world, &hit, &point, kept.direction)?;
                Self::Vertex(point, vertex)
            }
        })
    }
}

/// The kernel for one path at its primary hit, with steps of `K`.
#[derive(Debug)]
pub struct PathMutator<'s, 'a, F, K> {
    shift: &'s mut PathShift<'a, F>,
    steps: Steps<'a, { sampled::ONE }, F>,
    sample: PathSample,
    kept: Reconnection,
    /// The path up to `v_{r−1}`.
    replay: Replay,
    following: Following,
    kernel: std::marker::PhantomData<K>,
}

impl<'s, 'a, F: HitFilter, K: SmallStep> PathMutator<'s, 'a, F, K> {
    /// The kernel for a path of this receiver, and the state to begin with; `None` where the path
    /// stays. Work is counted by the shift map, which replays what lies before `x_r`.
    pub fn new(
        shift: &'s mut PathShift<'a, F>,
        receiver: &PathReceiver<'a>,
        sample: &PathSample,
    ) -> Option<(Self, PathState)> {
        let kept = sample.reconnection?;
        let following = Following::new(receiver.world, sample, &kept)?;
        let steps = Steps { world: receiver.world, filter: shift.filter };
        let end = u32::from(kept.vertex) - 1;
        let replay = shift.replay(&steps, sample.seed, receiver, end).ok()?;
        let (sample, kernel) = (*sample, std::marker::PhantomData);
        let mut mutator = Self { shift, steps, sample, kept, replay, following, kernel };
        let state = mutator.begin().ok()?;
        Some((mutator, state))
    }

    /// The state of the path as it is, which is seen.
    fn begin(&mut self) -> Result<PathState, Failure> {
        let world = self.steps.world;
        let (direction, (path, measure)) = match self.kept.anchor {
            Anchor::Point(point) => return Ok(self.on_light(point)?.0),
            Anchor::Sky { .. } => (self.kept.direction, self.in_sky(self.kept.direction)?),
            Anchor::Surface(hit) => {
                let way = world.accel.point(&hit).position - self.replay.vertex.surface.position;
                let state =
                    if self.is_end() { self.on_emitter(&hit)? } else { self.on_surface(&hit)?.0 };
                (way.normalize(), state)
            }
        };
        let Vertex { surface, outgoing } = &self.replay.vertex;
        let wi = surface.frame.to_local(direction);
        let lobe = self.kept.lobes[0].into();
        let numbers = surface.bsdf.invert(lobe, *outgoing, wi).ok_or(Failure::Lobe)?;
        regular(numbers, path, measure)
    }

    /// Whether `x_r` is the path's end.
    fn is_end(&self) -> bool {
        self.kept.vertex > self.sample.last
    }

    /// A step of the direction that `v_{r−1}` is left by.
    fn turn(&mut self, from: Vec2, random: &mut impl RandomSource) -> Result<PathState, Failure> {
        let numbers = K::step(from, random);
        let Vertex { surface, outgoing } = &self.replay.vertex;
        let wi = surface.bsdf.direction(self.kept.lobes[0].into(), *outgoing, numbers);
        let direction = surface.frame.to_world(wi.ok_or(Failure::Lobe)?).normalize();
        let hit = self.steps.onward(&self.replay.vertex, direction, &mut self.shift.counters);
        let (path, measure) = match (self.kept.anchor, hit) {
            (Anchor::Sky { .. }, None) => self.in_sky(direction)?,
            (Anchor::Surface(_), Some(hit)) if self.is_end() => self.on_emitter(&hit)?,
            (Anchor::Surface(_), Some(hit)) => {
                let (state, (vertex, sight)) = self.on_surface(&hit)?;
                self.shift.look(&self.steps, &vertex.surface, sight)?;
                state
            }
            _ => return Err(Failure::Length),
        };
        regular(numbers, path, measure)
    }

    /// A step of the point on a light that is `x_r`.
    fn slide(&mut self, from: Vec2, random: &mut impl RandomSource) -> Result<PathState, Failure> {
        let Anchor::Point(LightPoint { light, .. }) = self.kept.anchor else {
            return Err(Failure::LightGone);
        };
        let point = self.steps.world.lights.point_with(light, K::step(from, random));
        // Lights without extent have one point.
        if point.uv == from {
            return Err(Failure::LightGone);
        }
        let (state, sight) = self.on_light(point)?;
        self.shift.look(&self.steps, &self.replay.vertex.surface, sight)?;
        Ok(state)
    }

    fn in_sky(&self, direction: Vec3) -> Result<(Connected, f32), Failure> {
        let Anchor::Sky { light } = self.kept.anchor else { return Err(Failure::LightGone) };
        let there = (light, self.sample.ending, direction);
        let path = self.shift.connect_sky(self.steps.world, &self.replay, &self.kept, there)?;
        Ok((path, 1.0))
    }

    fn on_emitter(&self, hit: &Hit) -> Result<(Connected, f32), Failure> {
        let world = self.steps.world;
        let (hit, point) = (Hit { t: 0.0, ..*hit }, world.accel.point(hit));
        let at = (&hit, &point);
        let (path, _) = self.shift.connect_emitter(world, &self.replay, &self.kept, at)?;
        Ok((path, 1.0))
    }

    fn on_light(&self, point: LightPoint) -> Result<(PathState, Sight), Failure> {
        let world = self.steps.world;
        let path = (&self.sample, &self.kept);
        let (path, sight) = self.shift.connect_light_point(world, &self.replay, path, point)?;
        let density = path.reconnection.map_or(1.0, |kept| kept.density);
        Ok((regular(point.uv, path, density * world.lights.measure(point))?, sight))
    }

    /// The path through a vertex that scatters, its M, and what must see each other for it.
    #[expect(clippy::type_complexity, reason = "a state and a ray")]
    fn on_surface(&mut self, hit: &Hit) -> Result<((Connected, f32), (Vertex, Sight)), Failure> {
        let world = self.steps.world;
        let (kept, last) = (&self.kept, self.kept.vertex == self.sample.last);
        let (shift, replay) = (&*self.shift, &self.replay);
        let point = world.accel.point(hit);
        let Left { way, direction, total, joint } =
            shift.leave_to(replay, kept.lobes[0], &point)?;
        let vertex = Vertex::new(world, hit, &point, direction).ok_or(Failure::Back)?;
        let bsdf = &vertex.surface.bsdf;
        let samples_light = kept.lobes[1] == NO_LOBE;
        let lobe = (!samples_light).then_some(u32::from(kept.lobes[1]));
        if lobe.is_some_and(|lobe| lobe >= bsdf.lobe_count() || bsdf.is_delta(lobe)) {
            return Err(Failure::Lobe);
        }
        if !shift.connects.second(bsdf, lobe) {
            return Err(Failure::Near);
        }
        let path = (&self.sample, kept);
        let behind = Behind::new(world, shift, &mut self.following, path, &vertex)?;
        let Behind { suffix, onward, end, measure } = behind;
        let there = onward.total;
        if !replay.trail.onward(&shift.connects, &way, bsdf, there.pdf) {
            return Err(Failure::Near);
        }
        let leaves = Leaves::new(samples_light, suffix.ending, last);
        let behind = leaves.made_of(&there, suffix.radiance, suffix.light_density);
        let density = joint * way.geometry * onward.joint;
        let Suffix { direction, radiance, light_density, ending, next, .. } = suffix;
        let reconnection = Reconnection {
            vertex: kept.vertex,
            lobes: kept.lobes,
            anchor: Anchor::Surface(Hit { t: 0.0, ..*hit }),
            direction,
            radiance,
            density,
            light_density,
            next,
        };
        let path = Connected {
            integrand: replay.throughput * (total.value / total.pdf) * behind,
            ending,
            reconnection: Some(reconnection),
            jacobian: 1.0,
        };
        Ok(((path, onward.joint * measure), (vertex, (direction, end))))
    }
}

/// What follows `x_r`.
struct Behind {
    suffix: Suffix,
    onward: Onward,
    /// Where a ray from `x_r` ends.
    end: Option<Vec3>,
    /// M without p(`ω_r`, `ℓ_r`).
    measure: f32,
}

impl Behind {
    /// What follows a new `x_r` at `vertex`, if nothing stands between.
    #[inline]
    fn new<F: HitFilter>(
        world: &World,
        shift: &PathShift<'_, F>,
        following: &mut Following,
        (sample, kept): (&PathSample, &Reconnection),
        vertex: &Vertex,
    ) -> Result<Self, Failure> {
        let (next, from) = (kept.next, vertex.surface.position);
        let mut suffix = Suffix::kept(sample, kept);
        let point = match following {
            Following::Nothing => return Err(Failure::Length),
            Following::Light(point) => {
                let Lit { suffix, scattered, density, end } = Lit::new(world, vertex, *point)?;
                let onward = Onward { total: scattered, joint: 1.0 };
                return Ok(Self { suffix, onward, end, measure: density });
            }
            Following::Sky => {
                let onward = onward_from(vertex, kept.lobes[1], kept.direction)?;
                return Ok(Self { suffix, onward, end: None, measure: 1.0 });
            }
            Following::Emitter(point) | Following::Vertex(point, _) => *point,
        };
        let way = point.position - from;
        let squared = way.length_squared();
        if squared == 0.0 {
            return Err(Failure::Near);
        }
        let direction = way / squared.sqrt();
        let onward = onward_from(vertex, kept.lobes[1], direction)?;
        let mut measure = direction.dot(point.geometric_normal).abs() / squared;
        if let Following::Vertex(_, there) = following {
            there.outgoing = there.surface.frame.to_local(-direction);
            let samples_light = next.lobe() == NO_LOBE;
            let left = if samples_light {
                onward_from(there, NO_LOBE, next.direction())?
            } else {
                let (total, joint) = shift.turned(there, &next)?;
                Onward { total, joint }
            };
            measure *= left.joint;
            let last = kept.vertex + 1 == sample.last;
            let leaves = Leaves::new(samples_light, sample.ending, last);
            suffix.radiance = leaves.made_of(&left.total, next.radiance(), next.light_density());
        } else {
            let met = Met::new(world, from, direction, &point)?;
            (suffix.radiance, suffix.light_density) = (met.emission, met.density);
        }
        suffix.direction = direction;
        Ok(Self { suffix, onward, end: Some(end_at(&point, direction)), measure })
    }
}

/// A state, if A is a number that a chain can divide by: the same test for the state that a chain
/// begins with and for all that it is proposed.
fn regular(numbers: Vec2, path: Connected, measure: f32) -> Result<PathState, Failure> {
    let flow = luminance(path.integrand) * measure;
    // Below that A'/A loses digits.
    let kept = path.reconnection.is_some_and(|kept| kept.density.is_normal());
    if flow.is_normal() && flow > 0.0 && kept && path.integrand.is_finite() {
        Ok(PathState { numbers, path, flow })
    } else {
        Err(Failure::NotFinite)
    }
}

impl<F: HitFilter, K: SmallStep> Mutator for PathMutator<'_, '_, F, K> {
    type State = PathState;

    fn propose(
        &mut self,
        state: &PathState,
        random: &mut impl RandomSource,
    ) -> Option<Proposal<PathState>> {
        self.shift.counters.mutations += 1;
        let proposed = match self.kept.anchor {
            Anchor::Point(_) => self.slide(state.numbers, random),
            _ => self.turn(state.numbers, random),
        };
        let next = proposed.ok()?;
        Some(Proposal { state: next, acceptance: (next.flow / state.flow).min(1.0) })
    }
}
