//! The two queries, from a ray to a hit.

use glam::{DVec3, Vec3};
#[cfg(target_arch = "x86_64")]
use pulp::NullaryFnOnce;

use super::build::STACK;
use super::node::BoxRay;
use super::quadric;
use super::traverse::{Kernel, Portable, Scaled, Visitor, scale, traverse};
use super::triangle::{Kind, TriangleRay};
use super::{Accel, Bottom, Hit, HitFilter, Ray};

impl Accel {
    /// The hit with the least t in (0, `ray.t_max`) that `filter` accepts; among hits at the very
    /// same t, the first in the scene's order.
    ///
    /// A ray with a NaN, an infinite origin or direction, or no direction misses.
    #[must_use]
    pub fn closest_hit<F: HitFilter>(&self, ray: &Ray, filter: &F) -> Option<Hit> {
        self.query::<F, false>(ray, filter)
    }

    /// Whether `filter` accepts any hit with t in (0, `ray.t_max`).
    ///
    /// The end is robust: a hit whose t is below `t_max` only by what the rounding of the
    /// direction's components to f32 can do is none. So between two points offset from their
    /// surfaces, `direction` = their difference and `t_max` = 1 see neither surface.
    #[must_use]
    pub fn occluded<F: HitFilter>(&self, ray: &Ray, filter: &F) -> bool {
        self.query::<F, true>(ray, filter).is_some()
    }

    #[inline(always)]
    fn query<F: HitFilter, const ANY: bool>(&self, ray: &Ray, filter: &F) -> Option<Hit> {
        #[cfg(target_arch = "x86_64")]
        if let Some(simd) = self.simd {
            return simd.vectorize(Run::<F, ANY> { accel: self, ray, filter, simd });
        }
        run::<Portable, F, ANY>(Portable, self, ray, filter)
    }
}

#[cfg(test)]
impl Accel {
    /// What [`Accel::closest_hit`] must return, by testing everything with the plain tests and no
    /// tree.
    pub(super) fn exhaustive_hit<F: HitFilter>(&self, ray: &Ray, filter: &F) -> Option<Hit> {
        let scaled = scale(ray)?;
        let (limit, limit32) = (scaled.t_max, scaled.t_max as f32);
        let (o, d) = (scaled.origin.as_dvec3(), scaled.direction.as_dvec3());
        let mut query =
            Query::<F, false> { accel: self, ray, filter, scaled, limit, limit32, best: None };
        let instances = match self.top {
            Some(_) => (0..self.placements.len() as u32).map(Some).collect(),
            None => vec![None],
        };
        for instance in instances {
            let bottom = self.bottom(instance.unwrap_or(0));
            let to_object = instance.map(|i| self.placements[i as usize].to_object64);
            let to_object = to_object.unwrap_or(glam::DAffine3::IDENTITY);
            let local = (to_object.transform_point3(o), to_object.transform_vector3(d));
            let mut primitives = Primitives::new(&mut query, bottom, instance, local);
            for number in 0..bottom.slots.len() as u32 {
                if bottom.slots[number as usize].kind() != Kind::Group {
                    primitives.single(Portable, number);
                }
            }
        }
        query.best
    }
}

#[cfg(target_arch = "x86_64")]
struct Run<'a, F, const ANY: bool> {
    accel: &'a Accel,
    ray: &'a Ray,
    filter: &'a F,
    simd: pulp::x86::V3,
}

#[cfg(target_arch = "x86_64")]
impl<F: HitFilter, const ANY: bool> NullaryFnOnce for Run<'_, F, ANY> {
    type Output = Option<Hit>;

    #[inline(always)]
    fn call(self) -> Option<Hit> {
        run::<pulp::x86::V3, F, ANY>(self.simd, self.accel, self.ray, self.filter)
    }
}

#[inline(always)]
fn run<K: Kernel, F: HitFilter, const ANY: bool>(
    kernel: K,
    accel: &Accel,
    ray: &Ray,
    filter: &F,
) -> Option<Hit> {
    let scaled = scale(ray)?;
    let t_max = scaled.t_max;
    let query = Query::<F, ANY> {
        accel,
        ray,
        filter,
        scaled,
        limit: t_max,
        limit32: t_max as f32,
        best: None,
    };
    let (origin, direction) = (scaled.origin, scaled.direction);
    let mut query = query;
    if let Some(top) = &accel.top {
        let boxes = BoxRay::new(origin, direction, top.tree.reach(), false);
        let mut instances = Instances::<F, ANY> { query: &mut query, order: &top.order };
        traverse::<STACK, K, _>(kernel, &top.tree, &boxes, &mut instances);
    } else {
        let bottom = &*accel.bottoms[0];
        let boxes = BoxRay::new(origin, direction, bottom.tree.reach(), false);
        let mut primitives =
            Primitives::new(&mut query, bottom, None, (origin.as_dvec3(), direction.as_dvec3()));
        traverse::<STACK, K, _>(kernel, &bottom.tree, &boxes, &mut primitives);
        if F::ALL
            && !ANY
            && let Some(hit) = &mut query.best
        {
            hit.instance = bottom.cold[hit.primitive as usize].instance;
        }
    }
    query.best
}

/// One search in progress.
struct Query<'a, F, const ANY: bool> {
    accel: &'a Accel,
    ray: &'a Ray,
    filter: &'a F,
    scaled: Scaled,
    /// Upper end of the search, in the scaled ray's units.
    limit: f64,
    limit32: f32,
    best: Option<Hit>,
}

impl<F: HitFilter, const ANY: bool> Query<'_, F, ANY> {
    /// Takes a hit if it is nearer (or as near, and earlier in the scene) and accepted.
    #[inline(always)]
    fn offer(&mut self, t: f64, u: f32, v: f32, primitive: u32, instance: u32) -> bool {
        if t > self.limit {
            return false;
        }
        let hit = Hit { t: (t * self.scaled.unit) as f32, u, v, primitive, instance };
        if t == self.limit && self.best.is_none_or(|best| self.rank(&hit) >= self.rank(&best)) {
            return false;
        }
        if !F::ALL && !self.filter.accept(self.ray, &hit) {
            return false;
        }
        self.limit = t;
        self.limit32 = t as f32;
        self.best = Some(hit);
        true
    }

    #[cold]
    fn rank(&self, hit: &Hit) -> (u32, u32, u32) {
        let cold = &self.accel.bottom(hit.instance).cold[hit.primitive as usize];
        let instance = if self.accel.top.is_some() { hit.instance } else { cold.instance };
        (instance, cold.shape, cold.element)
    }

    /// Whether t plus its uncertainty from a rounded direction is beyond the end:
    /// `2⁻²⁴ Σ |n_i d_i| / |n·d|` of t.
    #[inline(always)]
    fn past_end(&self, t: f64, normal: DVec3) -> bool {
        const ROUNDING: f64 = 1.0 / (1 << 24) as f64;
        let product = normal * self.scaled.direction.as_dvec3();
        let relative = ROUNDING * product.abs().element_sum() / product.element_sum().abs();
        t * (1.0 + relative) >= self.limit
    }
}

/// The leaves of a tree of primitives.
struct Primitives<'q, 'a, F, const ANY: bool> {
    query: &'q mut Query<'a, F, ANY>,
    bottom: &'a Bottom,
    /// The instance, if the tree is one object's.
    instance: Option<u32>,
    triangle: TriangleRay,
    origin: DVec3,
    direction: DVec3,
}

impl<'q, 'a, F: HitFilter, const ANY: bool> Primitives<'q, 'a, F, ANY> {
    #[inline(always)]
    fn new(
        query: &'q mut Query<'a, F, ANY>,
        bottom: &'a Bottom,
        instance: Option<u32>,
        (origin, direction): (DVec3, DVec3),
    ) -> Self {
        let triangle = TriangleRay::new(origin, direction);
        Self { query, bottom, instance, triangle, origin, direction }
    }

    /// True: any hit will do and this is one.
    #[inline(always)]
    fn triangle<K: Kernel>(&mut self, kernel: K, number: u32) -> bool {
        let slot = &self.bottom.slots[number as usize];
        let Some(edges) = kernel.edges(slot, &self.triangle) else { return false };
        let Some((t, u, v)) = self.triangle.distance(&edges, self.query.limit) else {
            return false;
        };
        if ANY && self.query.limit < f64::INFINITY {
            let p0 = slot.column(0);
            let normal = (slot.column(1) - p0).cross(slot.column(2) - p0);
            let normal = match self.instance {
                Some(i) => self.query.accel.placements[i as usize].normal_to_world(normal),
                None => normal,
            };
            if self.query.past_end(t, normal) {
                return false;
            }
        }
        let instance = match self.instance {
            Some(instance) => instance,
            // Looked up once, for the hit that stays, where nobody asks in between.
            None if F::ALL => 0,
            None => self.bottom.cold[number as usize].instance,
        };
        self.query.offer(t, u as f32, v as f32, number, instance) && ANY
    }

    #[inline(never)]
    fn quadric(&mut self, kind: Kind, number: u32) -> bool {
        let slot = &self.bottom.slots[number as usize];
        let instance = self.instance.unwrap_or_else(|| self.bottom.cold[number as usize].instance);
        let placement = &self.query.accel.placements[instance as usize];
        let (mut origin, mut direction) = (self.origin, self.direction);
        if self.bottom.flat && !placement.identity {
            origin = placement.to_object64.transform_point3(origin);
            direction = placement.to_object64.transform_vector3(direction);
        }
        let (center, radius) = (slot.column(0), slot.radius());
        let finite = self.query.limit < f64::INFINITY;
        if kind == Kind::Sphere {
            for t in quadric::sphere_roots(center, radius, origin, direction) {
                // Not accepted, and no reason to skip the other root: NaN.
                if t.is_nan() {
                    continue;
                }
                let at = origin + direction * t - center;
                if ANY && finite && self.query.past_end(t, placement.normal_to_world(at)) {
                    continue;
                }
                let uv = quadric::sphere_encode(at);
                if self.query.offer(t, uv.x, uv.y, number, instance) && ANY {
                    return true;
                }
            }
            return false;
        }
        let normal = slot.column(2).normalize();
        let Some(t) = quadric::disk_root(center, normal, radius, origin, direction) else {
            return false;
        };
        if ANY && finite && self.query.past_end(t, placement.normal_to_world(normal)) {
            return false;
        }
        let uv = quadric::disk_encode(origin + direction * t - center, normal, radius);
        self.query.offer(t, uv.x, uv.y, number, instance) && ANY
    }

    #[inline(always)]
    fn single<K: Kernel>(&mut self, kernel: K, number: u32) -> bool {
        match self.bottom.slots[number as usize].kind() {
            Kind::Triangle => self.triangle(kernel, number),
            kind => self.quadric(kind, number),
        }
    }
}

impl<K: Kernel, F: HitFilter, const ANY: bool> Visitor<K> for Primitives<'_, '_, F, ANY> {
    const ANY: bool = ANY;

    #[inline(always)]
    fn limit(&self) -> f32 {
        self.query.limit32
    }

    #[inline(always)]
    fn leaf(&mut self, kernel: K, first: u32, count: u32) -> bool {
        // Loops, not closures: what the compiler leaves outside of the vectorised function loses
        // its instructions.
        for number in first..first + count {
            if !self.bottom.mixed {
                if self.triangle(kernel, number) {
                    return true;
                }
                continue;
            }
            let slot = &self.bottom.slots[number as usize];
            let (start, members) =
                if slot.kind() == Kind::Group { slot.range() } else { (number, 1) };
            for member in start..start + members {
                if self.single(kernel, member) {
                    return true;
                }
            }
        }
        false
    }
}

/// The leaves of the tree over instances.
struct Instances<'q, 'a, F, const ANY: bool> {
    query: &'q mut Query<'a, F, ANY>,
    order: &'a [u32],
}

impl<K: Kernel, F: HitFilter, const ANY: bool> Visitor<K> for Instances<'_, '_, F, ANY> {
    const ANY: bool = ANY;

    #[inline(always)]
    fn limit(&self) -> f32 {
        self.query.limit32
    }

    #[inline(always)]
    fn leaf(&mut self, kernel: K, first: u32, count: u32) -> bool {
        for &instance in &self.order[first as usize..(first + count) as usize] {
            let accel = self.query.accel;
            let placement = &accel.placements[instance as usize];
            let bottom: &Bottom = &accel.bottoms[placement.bottom as usize];
            let (mut origin, mut direction) =
                (self.query.scaled.origin.as_dvec3(), self.query.scaled.direction.as_dvec3());
            if !placement.identity {
                origin = placement.to_object64.transform_point3(origin);
                direction = placement.to_object64.transform_vector3(direction);
            }
            let (origin32, direction32): (Vec3, Vec3) = (origin.as_vec3(), direction.as_vec3());
            let boxes =
                BoxRay::new(origin32, direction32, bottom.tree.reach(), !placement.identity);
            let mut primitives =
                Primitives::new(self.query, bottom, Some(instance), (origin, direction));
            if traverse::<STACK, K, _>(kernel, &bottom.tree, &boxes, &mut primitives) {
                return true;
            }
        }
        false
    }
}
