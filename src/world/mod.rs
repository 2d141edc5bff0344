//! A scene at one time, ready to be asked by rays: acceleration structure, light table, shapes.

mod motion;

use std::cell::RefCell;
use std::sync::{Arc, OnceLock};

use glam::{Vec3, Vec3A};

use crate::accel::{Accel, AcceptAll, BuildOptions, Hit, HitFilter, HitPoint, MAX_COORDINATE, Ray};
use crate::error::Result;
use crate::light::{LightPoint, Lights};
use crate::scene::{Geometry, Object, ObjectId, Scene, Shape};
use crate::surface::{AlphaMask, ShapeInfo, SurfacePoint, placed_shapes};

pub use motion::{InstanceRemap, Motion};

/// Everything that a path needs to know of the scene in one frame.
#[derive(Clone, Debug)]
pub struct World {
    /// With fixed transforms.
    pub scene: Arc<Scene>,
    /// Geometry.
    pub accel: Accel,
    /// Emitters.
    pub lights: Lights,
    /// By running number.
    pub shapes: Vec<ShapeInfo>,
    /// Whether any shape lets rays through by its coverage.
    pub has_alpha: bool,
    /// Whether camera rays pass the back of any shape.
    pub has_one_sided: bool,
    emitters: OnceLock<Arc<Emitters>>,
}

/// The surfaces that emit and that rays meet, without all others: what a ray would meet if nothing
/// stood in between.
#[derive(Clone, Debug)]
pub struct Emitters {
    accel: Accel,
    /// First light of each shape in `accel`.
    first: Vec<u32>,
}

impl Emitters {
    fn new(scene: &Scene, lights: &Lights) -> Result<Self> {
        let mut only = Scene::new("emitters");
        for instance in &scene.instances {
            let object = &scene.objects[instance.object.index()];
            let met = |shape: &&Shape| shape.emission.is_some() && !shape.is_unmet();
            let shapes: Vec<_> = object.shapes.iter().filter(met).cloned().collect();
            if !shapes.is_empty() {
                only.objects.push(Arc::new(Object { name: String::new(), shapes }));
                let id = ObjectId(only.objects.len() as u32 - 1);
                only.add_instance(id, instance.to_world.clone(), instance.key);
            }
        }
        let options = BuildOptions { two_level: Some(false), ..BuildOptions::default() };
        Ok(Self { accel: Accel::build(&only, &options)?, first: lights.firsts() })
    }

    /// Their geometry, and the first light of each shape in it.
    #[cfg(feature = "gpu")]
    pub(crate) fn parts(&self) -> (&Accel, &[u32]) {
        (&self.accel, &self.first)
    }

    /// All points of emitting surfaces along a ray, in no particular order, occluded ones among
    /// them.
    #[inline]
    pub fn along(&self, ray: &Ray, lights: &Lights, visit: impl FnMut(LightPoint)) {
        struct All<'a, V>(&'a Emitters, &'a Lights, RefCell<V>);
        impl<V: FnMut(LightPoint)> HitFilter for All<'_, V> {
            #[inline]
            fn accept(&self, _: &Ray, hit: &Hit) -> bool {
                let Self(Emitters { accel, first }, lights, visit) = self;
                let point = accel.point(hit);
                let light = first[point.shape as usize] + point.element;
                visit.borrow_mut()(lights.point_at(light, hit, &point));
                false
            }
        }
        let none = self.accel.closest_hit(ray, &All(self, lights, RefCell::new(visit)));
        debug_assert!(none.is_none());
    }
}

/// The one thing that kernels specialise on: whether hits must be asked for their coverage.
pub(crate) trait WithFilter {
    type Output;
    fn run<F: HitFilter + Sync>(self, filter: F) -> Self::Output;
}

impl World {
    /// Prepares a scene, whose transforms are fixed (see [`Scene::at`]).
    ///
    /// # Errors
    /// Whatever [`Scene::validate`] refuses, and geometry that no acceleration structure can be
    /// built for.
    pub fn new(scene: Scene, options: &BuildOptions) -> Result<Self> {
        scene.validate()?;
        let accel = Accel::build(&scene, options)?;
        Ok(Self::with_accel(scene, accel))
    }

    /// The world of the next frame: bottom levels of geometry are shared with this one.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn next(&self, scene: Scene) -> Result<Self> {
        if same_geometry(&self.scene, &scene) {
            let next = Self::with_accel(scene, self.accel.clone());
            return Ok(Self { emitters: self.emitters.clone(), ..next });
        }
        let accel = self.accel.rebuild(&scene)?;
        Ok(Self::with_accel(scene, accel))
    }

    fn with_accel(scene: Scene, accel: Accel) -> Self {
        let shapes = placed_shapes(&scene);
        let lights = Lights::build(&scene, bounds(&scene));
        let has_alpha = shapes.iter().any(|shape| shape.alpha.is_some());
        let has_one_sided = shapes.iter().any(|shape| shape.one_sided);
        let emitters = OnceLock::new();
        let scene = Arc::new(scene);
        Self { scene, accel, lights, shapes, has_alpha, has_one_sided, emitters }
    }

    /// Builds what [`World::emitters`] gives; once a world, so that no pass waits for it.
    ///
    /// # Errors
    /// Geometry that no acceleration structure can be built for.
    pub fn prepare_emitters(&self) -> Result<()> {
        if self.emitters.get().is_none() {
            let emitters = Emitters::new(&self.scene, &self.lights)?;
            let _ = self.emitters.set(Arc::new(emitters));
        }
        Ok(())
    }

    /// The emitting surfaces; `None` before [`World::prepare_emitters`].
    #[inline]
    #[must_use]
    pub fn emitters(&self) -> Option<&Emitters> {
        self.emitters.get().map(|emitters| &**emitters)
    }

    /// The filter of scenes with coverage.
    #[inline]
    #[must_use]
    pub fn alpha_mask(&self) -> AlphaMask<'_> {
        AlphaMask { scene: &self.scene, accel: &self.accel, shapes: &self.shapes }
    }

    /// Runs a kernel with the filter that this world needs.
    pub(crate) fn with_filter<K: WithFilter>(&self, kernel: K) -> K::Output {
        if self.has_alpha { kernel.run(self.alpha_mask()) } else { kernel.run(AcceptAll) }
    }

    /// The nearest surface along a ray.
    #[must_use]
    pub fn closest_hit(&self, ray: &Ray) -> Option<Hit> {
        if self.has_alpha {
            self.accel.closest_hit(ray, &self.alpha_mask())
        } else {
            self.accel.closest_hit(ray, &AcceptAll)
        }
    }

    /// The nearest surface that is seen along a ray from the camera: such a ray passes the backs of
    /// one-sided surfaces ([`Scene::is_one_sided`]), which all other rays meet, and find black.
    #[must_use]
    pub fn camera_hit(&self, ray: &Ray) -> Option<Hit> {
        if self.has_alpha {
            self.camera_hit_with(ray, &self.alpha_mask())
        } else {
            self.camera_hit_with(ray, &AcceptAll)
        }
    }

    /// As [`World::camera_hit`], of what `filter` accepts.
    #[inline]
    #[must_use]
    pub fn camera_hit_with<F: HitFilter>(&self, ray: &Ray, filter: &F) -> Option<Hit> {
        let hit = self.accel.closest_hit(ray, filter)?;
        if !self.has_one_sided || !self.is_hidden_back(ray, &hit) {
            return Some(hit);
        }
        self.camera_hit_behind(ray, filter)
    }

    /// The nearest hit that is no hidden back.
    #[inline(never)]
    fn camera_hit_behind<F: HitFilter>(&self, ray: &Ray, filter: &F) -> Option<Hit> {
        struct Fronts<'a, F>(&'a World, &'a F);
        impl<F: HitFilter> HitFilter for Fronts<'_, F> {
            #[inline]
            fn accept(&self, ray: &Ray, hit: &Hit) -> bool {
                !self.0.is_hidden_back(ray, hit) && (F::ALL || self.1.accept(ray, hit))
            }
        }
        self.accel.closest_hit(ray, &Fronts(self, filter))
    }

    /// Whether a ray meets the back of a one-sided surface.
    fn is_hidden_back(&self, ray: &Ray, hit: &Hit) -> bool {
        let (shape, _) = self.accel.shape_of(hit);
        self.shapes[shape as usize].one_sided
            && ray.direction.dot(self.accel.point(hit).geometric_normal) > 0.0
    }

    /// The surface at a hit.
    #[inline]
    #[must_use]
    pub fn surface(&self, hit: &Hit) -> SurfacePoint {
        self.surface_at(hit, &self.accel.point(hit))
    }

    /// As [`World::surface`], for a hit whose geometry is known.
    #[inline]
    #[must_use]
    pub fn surface_at(&self, hit: &Hit, point: &HitPoint) -> SurfacePoint {
        SurfacePoint::new(&self.scene, &self.shapes, &self.accel, hit, point)
    }

    /// Radiance from infinity along unit `direction`.
    #[inline]
    #[must_use]
    pub fn escaped_radiance(&self, direction: Vec3) -> Vec3 {
        self.lights.environments().map(|(_, environment)| environment.radiance(direction)).sum()
    }
}

/// Whether two scenes with fixed transforms have the same objects in the same places.
fn same_geometry(a: &Scene, b: &Scene) -> bool {
    a.objects.len() == b.objects.len()
        && a.instances.len() == b.instances.len()
        && a.objects.iter().zip(&b.objects).all(|(a, b)| Arc::ptr_eq(a, b))
        && a.instances
            .iter()
            .zip(&b.instances)
            .all(|(a, b)| a.object == b.object && a.to_world.fixed() == b.to_world.fixed())
}

/// The world-space box around all shapes, corners beyond [`MAX_COORDINATE`] left out; the unit box
/// around the origin for an empty scene.
#[must_use]
pub fn bounds(scene: &Scene) -> [Vec3; 2] {
    let (mut low, mut high) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    for instance in &scene.instances {
        let to_world = instance.to_world.fixed();
        for shape in &scene.objects[instance.object.index()].shapes {
            let mut add = |p: Vec3| {
                let p = to_world.transform_point3a(p.into());
                // NaN compares false.
                if p.abs().cmple(Vec3A::splat(MAX_COORDINATE)).all() {
                    low = low.min(p);
                    high = high.max(p);
                }
            };
            match &shape.geometry {
                Geometry::Mesh(mesh) => mesh.positions.iter().for_each(|p| add(*p)),
                Geometry::Sphere { center, radius } | Geometry::Disk { center, radius, .. } => {
                    for corner in 0..8 {
                        let sign = |bit: u32| if corner & bit == 0 { -*radius } else { *radius };
                        add(*center + Vec3::new(sign(1), sign(2), sign(4)));
                    }
                }
            }
        }
    }
    if low.cmple(high).all() { [low.into(), high.into()] } else { [-Vec3::ONE, Vec3::ONE] }
}
