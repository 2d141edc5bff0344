//! The shift of paths: replay the numbers up to the vertex before `x_r`, connect to it, and keep
//! the rest (hybrid shift; Lin et al. 2022, section 7).

use glam::Vec3;

use super::ends::{Leaves, LightEnd, Met, Onward, Sight, end_at, light_end, onward_from};
use super::failure::Failure;
use super::replay::Replay;
use super::suffix::{Suffix, Turn, light_again};
use super::trail::Way;
use super::{Anchor, Connects, Ending, NO_LOBE, PathSample, Reconnection, ShiftKind};
use crate::accel::{AcceptAll, Hit, HitFilter, HitPoint};
use crate::counters::Counters;
use crate::light::LightPoint;
use crate::path::{Steps, Vertex, power_heuristic, sampled, shadow_ray};
use crate::resampling::{ShiftMap, Shifted};
use crate::reuse::light_points::Time;
use crate::surface::SurfacePoint;
use crate::surface::bsdf::Evaluation;
use crate::world::{Motion, World};

/// A primary hit as a domain of paths.
#[derive(Clone, Copy, Debug)]
pub struct PathReceiver<'a> {
    /// Its world.
    pub world: &'a World,
    /// Its frame.
    pub time: Time,
    /// The primary ray's unit direction.
    pub direction: Vec3,
    /// The primary hit.
    pub hit: Hit,
}

/// The shift between the receivers of one frame, and of it and the previous one.
///
/// \|∂T\| is the ratio of the [densities](Reconnection::density) of both paths: what the numbers of
/// `x_r`'s two directions are worth in the measure of `x_r`, the same measure for both.
#[derive(Debug)]
pub struct PathShift<'a, F> {
    /// Which hits count now; the previous frame's world brings its own.
    pub filter: &'a F,
    /// Which pairs may be connected.
    pub connects: Connects,
    /// What leads from the previous frame to this one; `None` where shifts stay in one frame.
    pub motion: Option<&'a Motion>,
    /// Whether lights or geometry move, so that what lies behind `x_r` is traced again in another
    /// frame.
    pub retraces: bool,
    /// Whether `x_r` may have moved, so that the path's numbers say nothing of what follows it up
    /// to [`Reconnection::next`].
    pub mutable: bool,
    /// Work done, and shifts that were undefined, by reason.
    pub counters: Counters,
    /// Why the last shift that was undefined was.
    pub lost: Option<Failure>,
}

/// How the vertex before `x_r` is left towards it.
pub(super) struct Left {
    pub(super) way: Way,
    pub(super) direction: Vec3,
    /// All lobes.
    pub(super) total: Evaluation,
    /// p(`ω_{r−1}`, `ℓ_{r−1}`).
    pub(super) joint: f32,
}

/// What a connection gives.
#[derive(Clone, Copy, Debug)]
pub(super) struct Connected {
    pub(super) integrand: Vec3,
    pub(super) ending: Ending,
    pub(super) reconnection: Option<Reconnection>,
    pub(super) jacobian: f32,
}

impl<'a, F: HitFilter> PathShift<'a, F> {
    /// A map between receivers of one frame and, with `motion`, of the previous one.
    #[must_use]
    pub fn new(filter: &'a F, connects: Connects, motion: Option<&'a Motion>) -> Self {
        let counters = Counters::default();
        let [retraces, mutable] = [false; 2];
        Self { filter, connects, motion, retraces, mutable, counters, lost: None }
    }

    /// The same, which traces what lies behind `x_r` again where the frame changes.
    #[must_use]
    pub fn retracing(self, retraces: bool) -> Self {
        Self { retraces, ..self }
    }

    /// The same for paths that are mutated.
    #[must_use]
    pub fn mutable(self, mutable: bool) -> Self {
        Self { mutable, ..self }
    }

    /// T, or why it is undefined.
    ///
    /// # Errors
    /// The first reason that was met.
    pub fn try_shift(
        &mut self,
        sample: &PathSample,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
    ) -> Result<Shifted<PathSample, Vec3>, Failure> {
        let world = to.world;
        let connected = match to.time {
            Time::Before if world.has_alpha => self.connect(sample, from, to, &world.alpha_mask()),
            Time::Before => self.connect(sample, from, to, &AcceptAll),
            Time::Now => {
                let filter = self.filter;
                self.connect(sample, from, to, filter)
            }
        }?;
        let Connected { integrand, ending, reconnection, jacobian } = connected;
        let finite = integrand.is_finite() && jacobian.is_finite() && jacobian > 0.0;
        let sample = PathSample { integrand, ending, reconnection, ..*sample };
        // p̂ may overflow or vanish where no channel does.
        if !finite || !sample.target().is_finite() {
            return Err(Failure::NotFinite);
        }
        if sample.target() <= 0.0 {
            return Err(Failure::Back);
        }
        Ok(Shifted { sample, integrand, jacobian })
    }

    fn connect<G: HitFilter>(
        &mut self,
        sample: &PathSample,
        from: &PathReceiver<'_>,
        to: &PathReceiver<'_>,
        filter: &G,
    ) -> Result<Connected, Failure> {
        let steps = Steps::<{ sampled::ONE }, G> { world: to.world, filter };
        // A path that ends in a sky is lost where that sky is, whatever lies before.
        let sky = match sample.ending {
            Ending::Sky { sky } => self.sky_there(sky, from, to)?,
            _ => 0,
        };
        let at_once = sample.reconnection.is_some_and(|kept| kept.vertex == 1);
        if self.connects.kind == ShiftKind::Reconnection && !at_once {
            return Err(Failure::Replay);
        }
        let Some(kept) = &sample.reconnection else {
            return self.replay_to_the_end(&steps, sample, to, sky);
        };
        let replay = self.replay(&steps, sample.seed, to, u32::from(kept.vertex) - 1)?;
        // A place on x_r that stays the same may have another size in the other frame.
        let (connected, ratio) = match kept.anchor {
            Anchor::Point(point) => {
                let (point, ratio) = self.point_there(point, from, to)?;
                let ends = (sample, kept);
                let (connected, sight) =
                    self.connect_light_point(to.world, &replay, ends, point)?;
                self.look(&steps, &replay.vertex.surface, sight)?;
                (connected, ratio)
            }
            Anchor::Sky { light } => {
                let light = self.light_there(light, from, to)?;
                let ending = Ending::Sky { sky };
                let there = (light, ending, kept.direction);
                let connected = self.connect_sky(to.world, &replay, kept, there)?;
                self.look(&steps, &replay.vertex.surface, (kept.direction, None))?;
                (connected, 1.0)
            }
            Anchor::Surface(hit) => {
                let (hit, point, ratio) = self.hit_there(&hit, from, to)?;
                let connected = if kept.vertex > sample.last {
                    let at = (&hit, &point);
                    let (connected, sight) = self.connect_emitter(to.world, &replay, kept, at)?;
                    self.look(&steps, &replay.vertex.surface, sight)?;
                    connected
                } else {
                    let again = self.retraces_between(from, to).then_some((sky, from, to));
                    let at = (&hit, &point);
                    self.connect_surface(&steps, &replay, sample, kept, at, again)?
                };
                (connected, ratio)
            }
        };
        Ok(Connected { jacobian: connected.jacobian * ratio, ..connected })
    }

    /// All lobes at the vertex before `x_r` towards `direction`, and the joint density of
    /// `ℓ_{r−1}`. Fails where that lobe would connect an earlier pair, or not this one.
    #[inline]
    fn leave(
        &self,
        replay: &Replay,
        lobe: u8,
        direction: Vec3,
    ) -> Result<(Evaluation, f32), Failure> {
        let Vertex { surface, outgoing } = &replay.vertex;
        let lobe = u32::from(lobe);
        let bsdf = &surface.bsdf;
        if lobe >= bsdf.lobe_count() || bsdf.is_delta(lobe) || !self.connects.is_rough(bsdf, lobe) {
            return Err(Failure::Lobe);
        }
        let wi = surface.frame.to_local(direction);
        let (total, joint) = bsdf.evaluate_with_lobe(lobe, *outgoing, wi);
        if joint <= 0.0 || total.value == Vec3::ZERO {
            return Err(Failure::Lobe);
        }
        if replay.trail.connects(&self.connects, bsdf, Some(lobe), total.pdf) {
            return Err(Failure::Earlier);
        }
        Ok((total, joint))
    }

    /// Leaves the vertex before `x_r` towards a point by `ℓ_{r−1}`. Fails where that may not be
    /// connected.
    #[inline]
    pub(super) fn leave_to(
        &self,
        replay: &Replay,
        lobe: u8,
        point: &HitPoint,
    ) -> Result<Left, Failure> {
        let way = replay.trail.way_to(point);
        let direction = point.position - replay.vertex.surface.position;
        let direction = direction / direction.length();
        let (total, joint) = self.leave(replay, lobe, direction)?;
        if !replay.trail.first(&self.connects, &way, total.pdf) {
            return Err(Failure::Near);
        }
        Ok(Left { way, direction, total, joint })
    }

    /// Fails where something stands between a surface and a point: one ray, off both surfaces.
    #[inline]
    pub(super) fn look<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        surface: &SurfacePoint,
        (direction, end): Sight,
    ) -> Result<(), Failure> {
        self.counters.shadow_rays += 1;
        let ray = shadow_ray(surface, direction, end);
        if steps.world.accel.occluded(&ray, steps.filter) {
            return Err(Failure::Occluded);
        }
        Ok(())
    }

    /// `x_r` is a vertex that scatters. `again` has the path's sky in the destination's world where
    /// what lies behind is traced there, and both receivers.
    fn connect_surface<G: HitFilter>(
        &mut self,
        steps: &Steps<'_, { sampled::ONE }, G>,
        replay: &Replay,
        sample: &PathSample,
        kept: &Reconnection,
        (hit, point): (&Hit, &HitPoint),
        again: Option<(u32, &PathReceiver<'_>, &PathReceiver<'_>)>,
    ) -> Result<Connected, Failure> {
        let Left { way, direction, total, joint } = self.leave_to(replay, kept.lobes[0], point)?;
        let vertex = Vertex::new(steps.world, hit, point, direction).ok_or(Failure::Back)?;
        let mut suffix = Suffix::kept(sample, kept);
        let samples_light = kept.lobes[1] == NO_LOBE;
        let mut onward = Onward { total: Evaluation::ZERO, joint: 0.0 };
        if !(samples_light && again.is_some()) {
            onward = onward_from(&vertex, kept.lobes[1], suffix.direction)?;
        }
        self.look(steps, &replay.vertex.surface, (direction, Some(end_at(point, direction))))?;
        if let Some((sky, from, to)) = again {
            if samples_light {
                let scattered;
                (suffix, scattered) = if self.mutable {
                    self.lit_again(steps, &vertex, kept, (from, to))?
                } else {
                    let numbers = (sample.seed, kept.vertex.into());
                    let light = light_again(steps, &vertex, numbers, &mut self.counters)?;
                    (Suffix::lit(&light), light.scattered)
                };
                onward = Onward { total: scattered, joint: 1.0 };
            } else {
                let turn =
                    if self.mutable { self.turn_of(sample, kept, from)? } else { Turn::Drawn };
                let along = (kept, onward.total.pdf, turn);
                suffix = self.traced(steps, &vertex, sample, along, sky)?;
            }
        }
        let Suffix { radiance, light_density, ending, .. } = suffix;
        if !replay.trail.onward(&self.connects, &way, &vertex.surface.bsdf, onward.total.pdf) {
            return Err(Failure::Near);
        }
        let leaves = Leaves::new(samples_light, ending, kept.vertex == sample.last);
        let behind = leaves.made_of(&onward.total, radiance, light_density);
        let density = joint * way.geometry * onward.joint;
        let Suffix { direction, next, ratio, .. } = suffix;
        let reconnection = Reconnection {
            density,
            anchor: Anchor::Surface(*hit),
            direction,
            radiance,
            light_density,
            next,
            ..*kept
        };
        Ok(Connected {
            integrand: replay.throughput * (total.value / total.pdf) * behind,
            ending,
            reconnection: Some(reconnection),
            jacobian: density / kept.density * ratio,
        })
    }

    /// `x_r` is the emitter that the last direction met, if nothing stands between.
    pub(super) fn connect_emitter(
        &self,
        world: &World,
        replay: &Replay,
        kept: &Reconnection,
        (hit, point): (&Hit, &HitPoint),
    ) -> Result<(Connected, Sight), Failure> {
        let Left { way, direction, total, joint } = self.leave_to(replay, kept.lobes[0], point)?;
        let met = Met::new(world, replay.vertex.surface.position, direction, point)?;
        let share = power_heuristic(total.pdf, met.density);
        let density = joint * way.geometry;
        let anchor = Anchor::Surface(*hit);
        let connected = Connected {
            integrand: replay.throughput * (total.value / total.pdf) * met.emission * share,
            ending: Ending::Emitter,
            reconnection: Some(Reconnection { density, anchor, ..*kept }),
            jacobian: density / kept.density,
        };
        Ok((connected, (direction, Some(end_at(point, direction)))))
    }

    /// `x_r` is a direction of a sky, if nothing stands there.
    pub(super) fn connect_sky(
        &self,
        world: &World,
        replay: &Replay,
        kept: &Reconnection,
        (light, ending, direction): (u32, Ending, Vec3),
    ) -> Result<Connected, Failure> {
        let lights = &world.lights;
        let (total, joint) = self.leave(replay, kept.lobes[0], direction)?;
        let (_, sky) =
            lights.environments().find(|(sky, _)| *sky == light).ok_or(Failure::LightGone)?;
        let emission = sky.radiance(direction);
        let pdf = lights.choice_probability(light) * sky.pdf(direction);
        let share = power_heuristic(total.pdf, pdf);
        let anchor = Anchor::Sky { light };
        Ok(Connected {
            integrand: replay.throughput * (total.value / total.pdf) * emission * share,
            ending,
            reconnection: Some(Reconnection {
                density: joint,
                anchor,
                direction,
                radiance: emission,
                ..*kept
            }),
            jacobian: joint / kept.density,
        })
    }

    /// `x_r` is a point on a light that `v_n` sampled, if nothing stands between.
    pub(super) fn connect_light_point(
        &self,
        world: &World,
        replay: &Replay,
        (sample, kept): (&PathSample, &Reconnection),
        point: LightPoint,
    ) -> Result<(Connected, Sight), Failure> {
        let Vertex { surface, outgoing } = &replay.vertex;
        let emitter = world.lights.emitter(&world.scene, point).ok_or(Failure::LightGone)?;
        let direct = sample.ending == Ending::Direct;
        let LightEnd { arrival, density } = if direct {
            let arrival = emitter.towards(&world.lights, surface.position).ok_or(Failure::Back)?;
            LightEnd { arrival, density: 1.0 }
        } else {
            light_end(world, surface.position, point).ok_or(Failure::Back)?
        };
        let scattered = surface.bsdf.evaluate(*outgoing, surface.frame.to_local(arrival.direction));
        if scattered.value == Vec3::ZERO {
            return Err(Failure::Back);
        }
        if replay.trail.connects(&self.connects, &surface.bsdf, None, scattered.pdf) {
            return Err(Failure::Earlier);
        }
        let delta = arrival.geometry == 0.0;
        let share = if direct || delta {
            1.0
        } else {
            power_heuristic(density / arrival.geometry, scattered.pdf)
        };
        let end = world.lights.shadow_end(&emitter, surface.position);
        let reconnection = Reconnection { density, anchor: Anchor::Point(point), ..*kept };
        let connected = Connected {
            integrand: replay.throughput * scattered.value * arrival.radiance * (share / density),
            ending: if direct { Ending::Direct } else { Ending::Light { delta } },
            reconnection: Some(reconnection),
            jacobian: density / kept.density,
        };
        Ok((connected, (arrival.direction, end)))
    }
}

impl<'a, F: HitFilter> ShiftMap for PathShift<'a, F> {
    type Sample = PathSample;
    type Domain = PathReceiver<'a>;
    type Integrand = Vec3;
    /// n, kind of end, r and the lobes around `x_r`.
    type Stratum = (u8, std::mem::Discriminant<Ending>, Option<(u8, [u8; 2])>);

    fn shift(
        &mut self,
        sample: &PathSample,
        from: &PathReceiver<'a>,
        to: &PathReceiver<'a>,
    ) -> Option<Shifted<PathSample, Vec3>> {
        self.counters.shifts += 1;
        // From a receiver to itself T is the identity, whose F is known.
        if std::ptr::eq(from, to) {
            return Some(Shifted { sample: *sample, integrand: sample.integrand, jacobian: 1.0 });
        }
        match self.try_shift(sample, from, to) {
            Ok(shifted) => Some(shifted),
            Err(failure) => {
                self.counters.shifts_failed += 1;
                *failure.counter(&mut self.counters) += 1;
                self.lost = Some(failure);
                None
            }
        }
    }

    fn stratum(&self, sample: &PathSample) -> Self::Stratum {
        let kept = sample.reconnection.as_ref();
        let connection = kept.map(|kept| (kept.vertex, kept.lobes));
        (sample.last, std::mem::discriminant(&sample.ending), connection)
    }
}
