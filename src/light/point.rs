//! Light points as resampling wants them: what a light sends from a point, apart from what a
//! receiver makes of it, in the measure of the light itself.
//!
//! | light | measure | `geometry` |
//! |---|---|---|
//! | triangle, sphere, disk | area | \|cos θ\| / d² |
//! | environment | solid angle | 1 |
//! | point, spot | counting | 1 / d² |
//! | distant | counting | 1 |

use bytemuck::{Pod, Zeroable};
use glam::{Vec2, Vec3};

use super::{Incident, Light, LightPoint, Lights, Surface};
use super::{area, constant, extent, mix_uvs};
use super::{one_minus_cos_cone, sample_sphere_cone, spot_falloff};
use crate::accel::{Hit, HitPoint};
use crate::math::{LANES, Lanes, Lanes3, Mask, gamma, offset_origin, warp};
use crate::scene::Scene;

/// How an [`EmitterPoint`] sends light.
mod kind {
    /// From one side of a surface.
    pub(super) const ONE_SIDED: u32 = 0;
    /// From both sides of a surface.
    pub(super) const TWO_SIDED: u32 = 1;
    /// From the inside of a sphere, or both sides: whoever is outside sees the cap that faces him,
    /// not the far one's inside.
    pub(super) const HOLLOW: u32 = 2;
    /// In all directions from a point.
    pub(super) const POINT: u32 = 3;
    /// The same, narrowed by the light's cone.
    pub(super) const SPOT: u32 = 4;
    /// From infinity.
    pub(super) const INFINITE: u32 = 5;
    /// From a surface that no ray meets, from one side or both.
    pub(super) const UNMET: u32 = 6;

    /// Whether it lies on a surface.
    #[inline(always)]
    pub(super) fn has_surface(kind: u32) -> bool {
        kind <= HOLLOW || kind == UNMET
    }
}

/// A light point in world space without a receiver: 44 bytes, so that a pass can prepare many.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct EmitterPoint {
    /// Where it is; for light from infinity the unit direction to it.
    position: [f32; 3],
    /// Unit normal of the side that emits; 0 without a surface.
    normal: [f32; 3],
    /// Radiance, intensity or irradiance.
    radiance: [f32; 3],
    kind: u32,
    light: u32,
}

/// What an [`EmitterPoint`] sends to a receiver.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// Unit direction from the receiver to the light.
    pub direction: Vec3,
    /// Radiance times geometry: with the BSDF's value, the integrand over light points.
    pub radiance: Vec3,
    /// Density per solid angle over density in the light's measure; 0 for lights that no direction
    /// meets.
    pub geometry: f32,
}

/// Direction and squared distance from a receiver to a light point, and the cosine there.
struct Facing {
    direction: Vec3,
    squared: f32,
    cos: f32,
}

impl Light {
    /// A point of a sphere light, whose outward normal there is `normal`.
    #[inline]
    fn on_sphere(
        &self,
        scene: &Scene,
        light: u32,
        position: Vec3,
        normal: Vec3,
    ) -> Option<EmitterPoint> {
        let outward = match self.surface {
            Surface::Sphere { outward, .. } => outward,
            _ => 1.0,
        };
        let radiance = self.sent(scene, self.uv_on_sphere(normal));
        let kind = match self.side() {
            kind::UNMET => kind::UNMET,
            _ if self.is_hollow() => kind::HOLLOW,
            _ => kind::ONE_SIDED,
        };
        EmitterPoint::new(light, position, normal * outward, radiance, kind)
    }

    #[inline]
    fn side(&self) -> u32 {
        match (self.met, self.two_sided) {
            (false, _) => kind::UNMET,
            (true, true) => kind::TWO_SIDED,
            (true, false) => kind::ONE_SIDED,
        }
    }
}

impl EmitterPoint {
    /// `None` where nothing is emitted.
    #[inline]
    fn new(light: u32, position: Vec3, normal: Vec3, radiance: Vec3, kind: u32) -> Option<Self> {
        (radiance != Vec3::ZERO).then(|| Self {
            position: position.to_array(),
            normal: normal.to_array(),
            radiance: radiance.to_array(),
            kind,
            light,
        })
    }

    /// Where it is; for light from infinity the unit direction to it.
    #[cfg(test)]
    pub(crate) fn place(&self) -> Vec3 {
        self.position.into()
    }

    /// A receiver at `from` as a point that is not at infinity sees it; `None` at the point itself,
    /// at an edge and behind.
    #[inline]
    fn facing(&self, lights: &Lights, from: Vec3) -> Option<Facing> {
        let to_light = Vec3::from(self.position) - from;
        let squared = to_light.length_squared();
        if squared == 0.0 {
            return None;
        }
        let direction = to_light / squared.sqrt();
        // 0 for lights without a surface, whose kind is neither.
        let cos = -direction.dot(Vec3::from(self.normal));
        let dark = match self.kind {
            kind::ONE_SIDED => cos <= 0.0,
            kind::TWO_SIDED => cos == 0.0,
            kind::HOLLOW => lights.hollow_is_dark(self.light, from, cos),
            kind::UNMET if lights.lights[self.light as usize].two_sided => cos == 0.0,
            kind::UNMET => cos <= 0.0,
            _ => false,
        };
        (!dark).then_some(Facing { direction, squared, cos })
    }

    /// What arrives at `from`; `None` where nothing does.
    #[inline]
    #[must_use]
    pub fn towards(&self, lights: &Lights, from: Vec3) -> Option<Arrival> {
        let radiance = Vec3::from(self.radiance);
        if self.kind == kind::INFINITE {
            let geometry = if lights.is_environment(self.light) { 1.0 } else { 0.0 };
            let direction = self.position.into();
            return Some(Arrival { direction, radiance, geometry });
        }
        let Facing { direction, squared, cos } = self.facing(lights, from)?;
        if kind::has_surface(self.kind) {
            let geometry = cos.abs() / squared;
            let radiance = radiance * geometry;
            return (radiance != Vec3::ZERO && geometry.is_finite()).then_some(Arrival {
                direction,
                radiance,
                geometry: if self.kind == kind::UNMET { 0.0 } else { geometry },
            });
        }
        let share =
            if self.kind == kind::SPOT { lights.spot_share(self.light, direction) } else { 1.0 };
        let radiance = radiance * (share / squared);
        (radiance != Vec3::ZERO && radiance.is_finite()).then_some(Arrival {
            direction,
            radiance,
            geometry: 0.0,
        })
    }
}

/// Eight [`EmitterPoint`]s side by side.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmitterPoints {
    position: Lanes3,
    normal: Lanes3,
    radiance: Lanes3,
    kind: [u32; LANES],
    light: [u32; LANES],
}

/// What eight points send to one receiver; nothing, where `radiance` is 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Arrivals {
    /// As [`Arrival::direction`].
    pub direction: Lanes3,
    /// As [`Arrival::radiance`].
    pub radiance: Lanes3,
    /// As [`Arrival::geometry`].
    pub geometry: Lanes,
}

impl Arrivals {
    /// Where anything arrives.
    #[inline(always)]
    pub(crate) fn lit(&self) -> Mask {
        let Lanes3 { x, y, z } = self.radiance;
        // A texture's channel may be negative.
        Lanes::ZERO.below(x.abs() + y.abs() + z.abs())
    }
}

impl EmitterPoints {
    /// Points that send nothing.
    pub(crate) const DARK: Self = Self {
        position: Lanes3::ZERO,
        normal: Lanes3::ZERO,
        radiance: Lanes3::ZERO,
        kind: [kind::POINT; LANES],
        light: [0; LANES],
    };

    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, point: &EmitterPoint) {
        self.position.set(lane, point.position);
        self.normal.set(lane, point.normal);
        self.radiance.set(lane, point.radiance);
        self.kind[lane] = point.kind;
        self.light[lane] = point.light;
    }

    fn get(&self, lane: usize) -> EmitterPoint {
        EmitterPoint {
            position: self.position.get(lane).to_array(),
            normal: self.normal.get(lane).to_array(),
            radiance: self.radiance.get(lane).to_array(),
            kind: self.kind[lane],
            light: self.light[lane],
        }
    }

    /// [`EmitterPoint::towards`] of each, to the bit.
    #[inline(always)]
    pub(crate) fn towards(&self, lights: &Lights, from: Vec3) -> Arrivals {
        let to_light = self.position.minus(from);
        let squared = to_light.dot(to_light);
        let length = squared.sqrt();
        let direction = to_light.map(|x| x / length);
        // −cos: minus would be one more operation.
        let away = direction.dot(self.normal);
        let kinds = |kind: u32| Mask::of(|i| self.kind[i] == kind);
        let spots = kinds(kind::SPOT);
        let mut share = Lanes::splat(1.0);
        if spots.any() {
            for lane in (0..LANES).filter(|lane| spots.get(*lane)) {
                share.0[lane] = lights.spot_share(self.light[lane], direction.get(lane));
            }
        }
        let bare = kinds(kind::POINT).or(spots);
        let factor = bare.select(share, away.abs()) / squared;
        let radiance = self.radiance.map(|x| x * factor);
        let away = kinds(kind::TWO_SIDED).select(Lanes::ZERO - away.abs(), away);
        let surface = away.below(Lanes::ZERO).and(factor.finite());
        let point = radiance.x.finite().and(radiance.y.finite()).and(radiance.z.finite());
        let lit = bare.and(point).or(surface.and(bare.not()));
        let kept = |x: Lanes| lit.select(x, Lanes::ZERO);
        let geometry = bare.select(Lanes::ZERO, kept(factor));
        let mut all = Arrivals { direction, radiance: radiance.map(kept), geometry };
        let others = Mask::of(|i| self.kind[i] == kind::HOLLOW || self.kind[i] >= kind::INFINITE);
        if others.any() {
            for lane in (0..LANES).filter(|lane| others.get(*lane)) {
                let (direction, radiance, geometry) = match self.get(lane).towards(lights, from) {
                    Some(one) => (one.direction, one.radiance, one.geometry),
                    None => (Vec3::Z, Vec3::ZERO, 0.0),
                };
                all.direction.set(lane, direction.to_array());
                all.radiance.set(lane, radiance.to_array());
                all.geometry.0[lane] = geometry;
            }
        }
        all
    }
}

impl Lights {
    /// The light's side of a light point; `None` where it emits nothing at all.
    #[inline]
    #[must_use]
    pub fn emitter(&self, scene: &Scene, point: LightPoint) -> Option<EmitterPoint> {
        let record = &self.lights[point.light as usize];
        match record.surface {
            // Most lights are triangles: their case is compiled into the caller.
            Surface::Triangle { corner, edge1, edge2, normal, .. } => {
                let b = warp::sample_uniform_triangle(point.uv);
                let position = corner + edge1 * b.y + edge2 * b.z;
                let radiance = record.sent(scene, mix_uvs(record.uvs, b));
                EmitterPoint::new(point.light, position, normal, radiance, record.side())
            }
            _ => self.other_emitter(scene, point),
        }
    }

    #[inline(never)]
    fn other_emitter(&self, scene: &Scene, point: LightPoint) -> Option<EmitterPoint> {
        let record = &self.lights[point.light as usize];
        let make = |position, normal, radiance, kind| {
            EmitterPoint::new(point.light, position, normal, radiance, kind)
        };
        let emitted = |uv: Vec2| record.sent(scene, uv);
        match record.surface {
            Surface::Triangle { .. } => None,
            Surface::Sphere { center, radius, .. } => {
                let normal = warp::sample_uniform_sphere(point.uv);
                record.on_sphere(scene, point.light, center + normal * radius, normal)
            }
            Surface::Disk { center, frame, radius } => {
                let d = warp::sample_disk(point.uv);
                let position = center + (frame.tangent * d.x + frame.bitangent * d.y) * radius;
                make(position, frame.normal, emitted(0.5 * (d + 1.0)), record.side())
            }
            Surface::Point { position } => {
                make(position, Vec3::ZERO, constant(record), kind::POINT)
            }
            Surface::Spot { position, .. } => {
                make(position, Vec3::ZERO, constant(record), kind::SPOT)
            }
            Surface::Distant { direction } => {
                make(direction, Vec3::ZERO, constant(record), kind::INFINITE)
            }
            Surface::Environment { index } => {
                let (_, environment) = &self.environments[index as usize];
                let direction = environment.sample(point.uv);
                make(direction, Vec3::ZERO, environment.radiance(direction), kind::INFINITE)
            }
        }
    }

    /// Density of a point that is drawn uniformly on its light (an environment: by its own
    /// density), the choice of the light included, in the light's measure.
    #[inline]
    #[must_use]
    pub fn uniform_density(&self, point: LightPoint) -> f32 {
        self.choice_probability(point.light) / self.measure(point)
    }

    /// What a unit of `uv` is worth in the light's measure: its area; 1 / density for environments;
    /// 1 for point, spot and distant lights.
    #[inline]
    #[must_use]
    pub fn measure(&self, point: LightPoint) -> f32 {
        match self.lights[point.light as usize].surface {
            Surface::Environment { index } => {
                let (_, environment) = &self.environments[index as usize];
                1.0 / environment.pdf(environment.sample(point.uv))
            }
            Surface::Point { .. } | Surface::Spot { .. } | Surface::Distant { .. } => 1.0,
            surface => area(surface),
        }
    }

    /// |∂T/∂y| of a light point that was `then` and keeps its place on the light, `now`: the ratio
    /// of areas, of densities for environments, whose image may be another one.
    #[inline]
    #[must_use]
    pub fn scaling(&self, now: LightPoint, before: &Self, then: LightPoint) -> f32 {
        self.measure(now) / before.measure(then)
    }

    /// Whether a point keeps its meaning between two lights: both are of the same kind.
    #[inline]
    #[must_use]
    pub fn same_kind(&self, light: u32, other: &Self, of_other: u32) -> bool {
        let (a, b) = (self.lights[light as usize].surface, other.lights[of_other as usize].surface);
        std::mem::discriminant(&a) == std::mem::discriminant(&b)
    }

    /// The point of `light` at `uv`; lights without extent have one only.
    #[inline]
    #[must_use]
    pub fn point_with(&self, light: u32, uv: Vec2) -> LightPoint {
        let place = match self.lights[light as usize].surface {
            Surface::Point { .. } | Surface::Spot { .. } | Surface::Distant { .. } => Vec2::ZERO,
            _ => uv,
        };
        LightPoint { light, uv: place }
    }

    /// A point of `light` for a receiver at `from`: spheres seen from outside are drawn in the cone
    /// they fill, all else uniformly. With its density given the light, in the light's measure; its
    /// arrival at the receiver is what the density of a cone depends on.
    #[inline]
    #[must_use]
    pub fn point_towards(&self, light: u32, from: Vec3, u: Vec2) -> LightPoint {
        match self.lights[light as usize].cap(from) {
            Some((center, radius)) => {
                let at = sample_sphere_cone(from, center, radius, u);
                let normal = at.map_or(Vec3::Z, |at| (at - center) / radius);
                LightPoint { light, uv: warp::invert_uniform_sphere(normal) }
            }
            None => self.point_with(light, u),
        }
    }

    /// The emitter of [`Lights::point_towards`] without the detour over u and v, to rounding.
    // A function of its own would be compiled without the vectors of the loop that calls it.
    #[inline(always)]
    #[must_use]
    pub fn emitter_towards(
        &self,
        scene: &Scene,
        light: u32,
        from: Vec3,
        u: Vec2,
    ) -> Option<EmitterPoint> {
        let record = &self.lights[light as usize];
        match record.cap(from) {
            Some((center, radius)) => {
                let position = sample_sphere_cone(from, center, radius, u)?;
                record.on_sphere(scene, light, position, (position - center) / radius)
            }
            None => self.emitter(scene, self.point_with(light, u)),
        }
    }

    /// A point of `light` for a receiver at `from`, drawn with the numbers `u`, as path tracing
    /// wants it: per solid angle. `None` where it can send nothing there.
    #[inline]
    #[must_use]
    pub fn sample_towards(
        &self,
        scene: &Scene,
        light: u32,
        from: Vec3,
        u: Vec2,
    ) -> Option<Incident> {
        let emitter = self.emitter_towards(scene, light, from, u)?;
        if kind::has_surface(emitter.kind) {
            let Facing { direction, squared, cos } = emitter.facing(self, from)?;
            let pdf = self.density_from(light, from, squared, cos);
            // Per solid angle the geometry stands in the density, not in the radiance.
            let radiance = Vec3::from(emitter.radiance);
            let end = self.shadow_end(&emitter, from);
            return (pdf > 0.0 && pdf.is_finite()).then_some(Incident {
                direction,
                end,
                radiance,
                pdf,
                delta: emitter.kind == kind::UNMET,
            });
        }
        let Arrival { direction, radiance, .. } = emitter.towards(self, from)?;
        let end = self.shadow_end(&emitter, from);
        match self.lights[light as usize].surface {
            Surface::Environment { index } => {
                let pdf = self.environments[index as usize].1.pdf(direction);
                (pdf > 0.0).then_some(Incident { direction, end, radiance, pdf, delta: false })
            }
            _ => Some(Incident { direction, end, radiance, pdf: 1.0, delta: true }),
        }
    }

    /// Density of [`Lights::point_towards`] at a point whose arrival has `geometry`, the choice of
    /// the light included, in the light's measure.
    #[inline]
    #[must_use]
    pub fn density_towards(&self, point: LightPoint, from: Vec3, geometry: f32) -> f32 {
        match self.lights[point.light as usize].cap(from) {
            Some((center, radius)) => {
                self.choice_probability(point.light)
                    * warp::uniform_cone_pdf(one_minus_cos_cone(from, center, radius))
                    * geometry
            }
            None => self.uniform_density(point),
        }
    }

    /// Where a shadow ray from `from` to a light point ends: off the light's surface, on the
    /// receiver's side; `None`: at infinity.
    #[inline]
    #[must_use]
    pub fn shadow_end(&self, emitter: &EmitterPoint, from: Vec3) -> Option<Vec3> {
        let at = Vec3::from(emitter.position);
        match emitter.kind {
            kind::INFINITE => None,
            kind::POINT | kind::SPOT => Some(at),
            _ => {
                let normal = Vec3::from(emitter.normal);
                let side = 1.0_f32.copysign((from - at).dot(normal));
                // Five roundings lie between a light's corners and the point; the shadow ray must
                // end before the surface.
                let surface = self.lights[emitter.light as usize].surface;
                let error = gamma(8) * (at.abs() + extent(surface));
                Some(offset_origin(at, normal * side, error))
            }
        }
    }

    /// The light point at a hit of surface light `light`.
    #[inline]
    #[must_use]
    pub fn point_at(&self, light: u32, hit: &Hit, point: &HitPoint) -> LightPoint {
        let uv = match self.lights[light as usize].surface {
            Surface::Sphere { center, radius, .. } => {
                warp::invert_uniform_sphere(((point.position - center) / radius).normalize())
            }
            Surface::Disk { center, frame, radius } => {
                let d = (point.position - center) / radius;
                warp::invert_disk(Vec2::new(d.dot(frame.tangent), d.dot(frame.bitangent)))
            }
            _ => {
                // Rounding may leave a weight below 0 by an ulp.
                let (b1, b2) = (hit.u.max(0.0), hit.v.max(0.0));
                warp::invert_uniform_triangle(Vec3::new((1.0 - b1 - b2).max(0.0), b1, b2))
            }
        };
        LightPoint { light, uv }
    }

    /// Whether a hollow sphere's point, whose stored normal has `cos` to the receiver, sends
    /// nothing there.
    fn hollow_is_dark(&self, light: u32, from: Vec3, cos: f32) -> bool {
        let record = &self.lights[light as usize];
        match record.surface {
            Surface::Sphere { outward, .. } if record.cap(from).is_some() => {
                !record.two_sided || cos * outward <= 0.0
            }
            _ if record.two_sided => cos == 0.0,
            _ => cos <= 0.0,
        }
    }

    #[inline]
    fn is_environment(&self, light: u32) -> bool {
        matches!(self.lights[light as usize].surface, Surface::Environment { .. })
    }

    /// Share of a spot light's intensity for a receiver that sees it in `direction`.
    fn spot_share(&self, light: u32, direction: Vec3) -> f32 {
        match self.lights[light as usize].surface {
            Surface::Spot { axis, cos_inner, cos_outer, falloff, .. } => {
                spot_falloff((-direction).dot(axis), cos_inner, cos_outer, falloff)
            }
            _ => 1.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::array::from_fn;
    use std::sync::Arc;

    use glam::Affine3A;

    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::scene::{
        Color, Geometry, Light, LightKind, Material, Mesh, Scalar, Shape, SpotFalloff, Transform,
    };
    use crate::world::bounds;

    fn scene() -> Scene {
        let mut scene = Scene::new("lights");
        let black =
            scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) });
        let triangle = Geometry::Mesh(Arc::new(Mesh {
            positions: vec![
                Vec3::new(-1.0, 2.0, 0.0),
                Vec3::new(1.0, 2.5, 0.0),
                Vec3::new(0.0, 2.0, 1.0),
            ],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        }));
        let sphere = Geometry::Sphere { center: Vec3::new(2.0, 1.0, 0.0), radius: 0.5 };
        let disk =
            Geometry::Disk { center: Vec3::new(-2.0, 1.0, 0.0), normal: Vec3::X, radius: 0.4 };
        for geometry in [triangle, sphere, disk] {
            scene.add_shape(Shape::new(geometry, black).emitting(Vec3::new(3.0, 2.0, 1.0)));
        }
        let place = Affine3A::from_translation(Vec3::new(0.3, 1.5, -0.7));
        let falloff = SpotFalloff::Smoothstep;
        for (key, kind) in [
            LightKind::Point { intensity: Vec3::ONE },
            LightKind::Spot { intensity: Vec3::ONE, cos_inner: 0.9, cos_outer: -0.5, falloff },
            LightKind::Distant { irradiance: Vec3::ONE },
            LightKind::Environment { radiance: Vec3::ONE, image: None },
        ]
        .into_iter()
        .enumerate()
        {
            scene.lights.push(Light { to_world: Transform::Fixed(place), kind, key: key as u64 });
        }
        scene
    }

    /// Balls of any size as seen from 1 m: `1 − cos` in f64, `sin² / (1 + cos)`.
    #[test]
    fn cones_of_small_and_far_balls_keep_their_digits() {
        for exponent in 1..=18 {
            let radius = 0.5_f32.powi(exponent);
            let sin2 = f64::from(radius) * f64::from(radius);
            let wanted = sin2 / (1.0 + (1.0 - sin2).sqrt());
            let found = f64::from(one_minus_cos_cone(Vec3::ZERO, Vec3::Y, radius));
            assert!((found / wanted - 1.0).abs() < 4e-7, "2^-{exponent}: {found} {wanted}");
        }
    }

    /// Arrivals are what `sample_towards` reports, in the light's measure: radiance · geometry /
    /// density in one is radiance / pdf in the other.
    #[test]
    fn arrivals_agree_with_light_sampling_per_solid_angle() {
        let scene = scene();
        let lights = Lights::build(&scene, bounds(&scene));
        let mut random = Stream::from_key(5);
        let mut met = vec![0; lights.len()];
        for _ in 0..4000 {
            let from = 3.0 * Vec3::new(random.uniform(), random.uniform(), random.uniform()) - 1.5;
            let u = Vec2::new(random.uniform(), random.uniform());
            for light in 0..lights.len() as u32 {
                let incident = lights.sample_towards(&scene, light, from, u);
                let point = lights.point_towards(light, from, u);
                let arrival = lights.emitter(&scene, point).and_then(|e| e.towards(&lights, from));
                let (Some(incident), Some(arrival)) = (incident, arrival) else {
                    continue;
                };
                let direct = lights.emitter_towards(&scene, light, from, u).unwrap();
                let same = direct.towards(&lights, from).unwrap();
                assert!(
                    (same.radiance - arrival.radiance).length() <= 2e-3 * same.radiance.length()
                );
                if incident.radiance == Vec3::ZERO || incident.pdf > 1e3 {
                    continue;
                }
                met[light as usize] += 1;
                let density = lights.density_towards(point, from, arrival.geometry);
                let a = incident.radiance / (incident.pdf * lights.choice_probability(light));
                let b = arrival.radiance / density;
                assert!((a - b).length() <= 2e-3 * a.length(), "light {light}: {a} against {b}");
                assert!((incident.direction - arrival.direction).length() < 1e-3, "light {light}");
                if !incident.delta {
                    let pdf = density / arrival.geometry / lights.choice_probability(light);
                    assert!((pdf / incident.pdf - 1.0).abs() < 2e-3, "light {light}");
                }
            }
        }
        assert!(met.iter().all(|&n| n > 100), "{met:?}");
    }

    /// Lights of one object, of one shape, of several instances and of none all have keys of their
    /// own: reuse finds them again by these.
    #[test]
    fn every_light_has_a_key_of_its_own() {
        let mut scene = scene();
        let mut object = crate::scene::Object::default();
        for number in [0, 0, 1, 2] {
            let mut shape = scene.objects[number].shapes[0].clone();
            if let Geometry::Mesh(mesh) = &mut shape.geometry {
                let mesh = Arc::make_mut(mesh);
                mesh.triangles = vec![[0, 1, 2], [2, 1, 0]];
            }
            object.shapes.push(shape);
        }
        let object = scene.add_object(object);
        for key in [0xFFFF_FFFF, 1 << 40] {
            scene.add_instance(object, Transform::IDENTITY, key);
        }
        let lights = Lights::build(&scene, bounds(&scene));
        let keys: std::collections::BTreeSet<[u64; 2]> =
            (0..lights.len() as u32).map(|light| lights.key(light)).collect();
        assert_eq!((lights.len(), keys.len()), (3 + 2 * 6 + 4, 19));
    }

    #[test]
    fn eight_side_by_side_have_the_bits_of_each() {
        let mut scene = scene();
        for (two_sided, inward, alpha) in [
            (true, false, None),
            (false, true, None),
            (true, false, Some(Scalar::Constant(0.0))),
            (false, true, Some(Scalar::Constant(0.0))),
        ] {
            for mut shape in [0, 1, 2].map(|object: usize| scene.objects[object].shapes[0].clone())
            {
                shape.alpha = alpha;
                shape.reverse_orientation = inward;
                shape.emission.as_mut().unwrap().two_sided = two_sided;
                scene.add_shape(shape);
            }
        }
        let falloff = SpotFalloff::Smoothstep;
        let kind =
            LightKind::Spot { intensity: Vec3::ONE, cos_inner: 0.5, cos_outer: 0.2, falloff };
        let to_world = Transform::Fixed(Affine3A::from_translation(Vec3::NEG_X));
        scene.lights.push(Light { to_world, kind, key: 9 });
        let lights = Lights::build(&scene, bounds(&scene));

        let mut random = Stream::from_key(5);
        // Of each kind of point: how many send nothing, how many something.
        let mut met = [[0; 2]; 7];
        for round in 0..6000 {
            let points: [_; LANES] = from_fn(|_| {
                let light = (random.uniform() * lights.len() as f32) as u32;
                let uv = Vec2::new(random.uniform(), random.uniform());
                lights.emitter(&scene, lights.point_with(light, uv)).unwrap()
            });
            let from = match round % 8 {
                0 => points[0].place(),
                // Inside of the spheres.
                1 => Vec3::new(2.1, 0.8, 0.1),
                _ => 3.0 * Vec3::new(random.uniform(), random.uniform(), random.uniform()) - 1.5,
            };
            let mut all = EmitterPoints::DARK;
            for (lane, point) in points.iter().enumerate() {
                all.set(lane, point);
            }
            let arrivals = all.towards(&lights, from);
            for (lane, point) in points.iter().enumerate() {
                let one = point.towards(&lights, from);
                let kind = point.kind as usize;
                met[kind][usize::from(one.is_some())] += 1;
                assert_eq!(arrivals.lit().get(lane), one.is_some(), "{point:?} from {from}");
                if let Some(one) = one {
                    assert_eq!(arrivals.direction.get(lane), one.direction);
                    assert_eq!(arrivals.radiance.get(lane), one.radiance);
                    assert_eq!(arrivals.geometry.0[lane], one.geometry);
                }
            }
        }
        for (kind, [dark, lit]) in met.into_iter().enumerate() {
            assert!(
                lit > 100 && (dark > 100 || !kind::has_surface(kind as u32)),
                "{kind}: {dark}, {lit}"
            );
        }
    }
}
