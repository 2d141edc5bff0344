//! A scene at one time, ready to be asked by rays: acceleration structure, light table, shapes.

mod motion;

use std::cell::RefCell;
use std::sync::{Arc, OnceLock};

use glam::{Vec3, Vec3A};

use crate::accel::{Accel, AcceptAll, BuildOptions, Hit, HitFilter, HitPoint, MAX_COORDINATE, Ray};
use crate::error::Result;
use crate::light::{LightPoint, Lights};
use crate::scene::{Geometry, LightKind, Object, ObjectId, Scene, Shape};
use crate::surface::{AlphaMask, ShapeInfo, SurfacePoint, placed_shapes};

pub use motion::{InstanceRemap, Motion};

/// What had to be made for a world, beyond what it shares with the one before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Built {
    /// Trees over the primitives of an object, or of a whole scene without moving parts.
    pub trees: u32,
    /// Trees over instances.
    pub instance_trees: u32,
    /// Trees over the surfaces that emit.
    pub emitter_trees: u32,
    /// Tables of lights.
    pub light_tables: u32,
}

/// Everything that a path needs to know of the scene in one frame.
#[derive(Clone, Debug)]
pub struct World {
    /// With fixed transforms.
    pub scene: Arc<Scene>,
    /// Geometry.
    pub accel: Accel,
    /// Emitters.
    pub lights: Arc<Lights>,
    /// By running number.
    pub shapes: Vec<ShapeInfo>,
    /// Whether any shape lets rays through by its coverage.
    pub has_alpha: bool,
    /// Whether camera rays pass the back of any shape.
    pub has_one_sided: bool,
    /// Whether the camera alone may have changed since the world that this one was made from.
    #[cfg_attr(not(feature = "gpu"), expect(dead_code, reason = "asked by the second backend"))]
    pub(crate) only_camera: bool,
    emitters: OnceLock<(Arc<Emitters>, bool)>,
    built: Built,
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
        let lights = Arc::new(Lights::build(&scene, bounds(&scene)));
        Ok(Self::with(scene, accel, lights))
    }

    /// The world of the next frame. What has not changed is shared with this one: trees of objects,
    /// the tree over instances, the emitters' tree, the table of lights.
    ///
    /// # Errors
    /// As [`World::new`].
    pub fn next(&self, scene: Scene) -> Result<Self> {
        let objects = same_objects(&self.scene, &scene);
        let places = objects && same_places(&self.scene, &scene, |_| true);
        let emitting = objects && same_places(&self.scene, &scene, emits);
        let lights =
            emitting && same_lights(&self.scene, &scene) && (places || !lit_from_afar(&scene));
        let only_camera = places && lights && self.scene.materials == scene.materials;
        let accel = if places { self.accel.clone() } else { self.accel.rebuild(&scene)? };
        let lights = if lights {
            self.lights.clone()
        } else {
            Arc::new(Lights::build(&scene, bounds(&scene)))
        };
        let emitters = OnceLock::new();
        if let Some((shared, _)) = self.emitters.get().filter(|_| emitting) {
            let _ = emitters.set((shared.clone(), false));
        }
        let built = Built {
            trees: if places { 0 } else { accel.report().built as u32 },
            instance_trees: u32::from(!places && accel.report().two_level),
            emitter_trees: 0,
            light_tables: u32::from(!Arc::ptr_eq(&lights, &self.lights)),
        };
        Ok(Self { only_camera, emitters, built, ..Self::with(scene, accel, lights) })
    }

    fn with(scene: Scene, accel: Accel, lights: Arc<Lights>) -> Self {
        let shapes = placed_shapes(&scene);
        let has_alpha = shapes.iter().any(|shape| shape.alpha.is_some());
        let has_one_sided = shapes.iter().any(|shape| shape.one_sided);
        let built = Built {
            trees: accel.report().built as u32,
            instance_trees: u32::from(accel.report().two_level),
            emitter_trees: 0,
            light_tables: 1,
        };
        Self {
            scene: Arc::new(scene),
            accel,
            lights,
            shapes,
            has_alpha,
            has_one_sided,
            only_camera: false,
            emitters: OnceLock::new(),
            built,
        }
    }

    /// What had to be made for it.
    #[must_use]
    pub fn built(&self) -> Built {
        let emitter_trees = u32::from(self.emitters.get().is_some_and(|(_, built)| *built));
        Built { emitter_trees, ..self.built }
    }

    /// Builds what [`World::emitters`] gives; once a world, so that no pass waits for it.
    ///
    /// # Errors
    /// Geometry that no acceleration structure can be built for.
    pub fn prepare_emitters(&self) -> Result<()> {
        if self.emitters.get().is_none() {
            let emitters = Emitters::new(&self.scene, &self.lights)?;
            let _ = self.emitters.set((Arc::new(emitters), true));
        }
        Ok(())
    }

    /// The emitting surfaces; `None` before [`World::prepare_emitters`].
    #[inline]
    #[must_use]
    pub fn emitters(&self) -> Option<&Emitters> {
        self.emitters.get().map(|(emitters, _)| &**emitters)
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

/// Whether two scenes place the same objects, in the same order.
fn same_objects(a: &Scene, b: &Scene) -> bool {
    a.objects.len() == b.objects.len()
        && a.instances.len() == b.instances.len()
        && a.objects.iter().zip(&b.objects).all(|(a, b)| Arc::ptr_eq(a, b))
        && a.instances.iter().zip(&b.instances).all(|(a, b)| a.object == b.object)
}

/// Whether two scenes with the same objects and fixed transforms have them in the same places, as
/// far as `asked` says.
fn same_places(a: &Scene, b: &Scene, asked: impl Fn(&Object) -> bool) -> bool {
    a.instances.iter().zip(&b.instances).all(|(was, is)| {
        was.to_world.fixed() == is.to_world.fixed() || !asked(&a.objects[was.object.index()])
    })
}

fn emits(object: &Object) -> bool {
    object.shapes.iter().any(|shape| shape.emission.is_some())
}

/// Whether there is light from infinity, whose power depends on how large the scene is.
fn lit_from_afar(scene: &Scene) -> bool {
    let afar = |kind| matches!(kind, LightKind::Distant { .. } | LightKind::Environment { .. });
    scene.lights.iter().any(|light| afar(light.kind))
}

/// Whether two scenes whose emitting objects are the same, in the same places, have the same
/// lights: as bright, by the same keys.
fn same_lights(a: &Scene, b: &Scene) -> bool {
    a.lights.len() == b.lights.len()
        && a.instances.iter().zip(&b.instances).all(|(a, b)| a.key == b.key)
        && a.lights.iter().zip(&b.lights).all(|(a, b)| {
            a.key == b.key && a.kind == b.kind && a.to_world.fixed() == b.to_world.fixed()
        })
        && a.textures == b.textures
        && a.images.len() == b.images.len()
        && a.images.iter().zip(&b.images).all(|(a, b)| Arc::ptr_eq(a, b))
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

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec2, Vec4};

    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::scene::{
        Color, Image, ImageData, Material, Mesh, Shape, Texture, TextureKind, Transform, Wrap,
    };

    /// Lamps of each kind, one-sided and two-sided, turned around and not, where instances mirror
    /// and scale them. Each is 10 m from the next; the emission of meshes is a texture.
    fn lamps() -> Scene {
        let mut scene = Scene::new("lamps");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        let colors =
            [Vec4::new(1.0, 2.0, 9.0, 1.0), Vec4::ONE, Vec4::X, Vec4::new(5.0, 1.0, 3.0, 1.0)];
        let data = ImageData::Float(colors.map(|c| c.to_array()).to_vec());
        let image = scene.add_image(Image { width: 2, height: 2, data });
        let kind = TextureKind::Image { image, wrap: Wrap::Clamp, scale: 1.0, invert: false };
        let texture = scene.add_texture(Texture { kind, mapping: glam::Affine2::IDENTITY });
        let mesh = Geometry::Mesh(Arc::new(Mesh {
            positions: vec![
                Vec3::ZERO,
                Vec3::X,
                Vec3::new(1.0, 1.2, 0.0),
                Vec3::new(0.1, 1.0, 0.2),
            ],
            uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }));
        let normal = Vec3::new(1.0, 2.0, -1.0).normalize();
        let disk = Geometry::Disk { center: Vec3::new(0.2, 0.1, 0.0), normal, radius: 0.7 };
        let ball = Geometry::Sphere { center: Vec3::new(0.0, 0.3, 0.0), radius: 0.6 };
        let turn = Quat::from_euler(glam::EulerRot::XYZ, 0.3, -1.0, 2.0);
        let mut key = 0;
        for geometry in [mesh, disk, ball] {
            let is_mesh = matches!(geometry, Geometry::Mesh(_));
            let scale = if is_mesh { Vec3::new(1.4, 0.8, 1.1) } else { Vec3::splat(1.5) };
            for (mirror, reverse, two_sided) in
                [(1.0, false, false), (-1.0, false, false), (1.0, true, false), (-1.0, true, true)]
            {
                let mut shape = Shape::new(geometry.clone(), black).emitting(Vec3::splat(2.0));
                shape.reverse_orientation = reverse;
                let emission = shape.emission.as_mut().unwrap();
                emission.two_sided = two_sided;
                if is_mesh {
                    emission.radiance = Color::Texture(texture);
                }
                let shapes = vec![shape];
                let object = scene.add_object(Object { name: String::new(), shapes });
                let place = glam::Affine3A::from_scale_rotation_translation(
                    scale * Vec3::new(mirror, 1.0, 1.0),
                    turn,
                    10.0 * key as f32 * Vec3::X,
                );
                scene.add_instance(object, Transform::Fixed(place), key);
                key += 1;
            }
        }
        scene
    }

    /// A ray that meets a lamp and light sampling say the same of it: which side shines, what it
    /// sends, where its points are and how densely it is sampled.
    #[test]
    fn lamps_are_sampled_as_rays_meet_them() {
        let world = World::new(lamps(), &BuildOptions::default()).unwrap();
        let (lights, scene) = (&world.lights, &*world.scene);
        let mut random = Stream::from_key(3);
        let mut seen = vec![[0; 2]; lights.len()];
        for round in 0..40_000 {
            let light = round % lights.len() as u32;
            let u = Vec2::new(random.uniform(), random.uniform());
            let target = lights.emitter(scene, LightPoint { light, uv: u });
            let Some(target) = target.map(|emitter| emitter.place()) else { continue };
            let offset = Vec3::new(random.uniform(), random.uniform(), random.uniform()) - 0.5;
            let from = target + 4.0 * offset;
            let direction = (target - from).normalize();
            let Some(hit) =
                world.closest_hit(&Ray { origin: from, direction, t_max: f32::INFINITY })
            else {
                continue;
            };
            let point = world.accel.point(&hit);
            let cosine = -direction.dot(point.geometric_normal);
            if lights.of_surface(point.shape, point.element) != light || cosine.abs() < 0.05 {
                continue;
            }
            let met = lights.emitted(scene, light, point.uv, cosine);
            seen[light as usize][usize::from(met != Vec3::ZERO)] += 1;
            let there = lights.emitter(scene, lights.point_at(light, &hit, &point)).unwrap();
            assert!((there.place() - point.position).length() < 2e-4 * from.length(), "{light}");
            let arrival = there.towards(lights, from);
            assert_eq!(arrival.is_some(), met != Vec3::ZERO, "{light} from {from}: {met}");
            if let Some(arrival) = arrival {
                let sent = arrival.radiance / arrival.geometry;
                assert!((sent - met).length() < 5e-3 * met.length(), "{light}: {sent} {met}");
            }
            // The same with the point that light sampling draws.
            let Some(incident) = lights.sample_towards(scene, light, from, u) else { continue };
            let ray = Ray { origin: from, direction: incident.direction, t_max: f32::INFINITY };
            let Some(hit) = world.closest_hit(&ray) else { continue };
            let point = world.accel.point(&hit);
            let cosine = -ray.direction.dot(point.geometric_normal);
            if lights.of_surface(point.shape, point.element) != light || cosine.abs() < 0.05 {
                continue;
            }
            let met = lights.emitted(scene, light, point.uv, cosine);
            assert!((incident.radiance - met).length() < 5e-3 * met.length(), "{light}: {met}");
            let pdf = lights.pdf_towards(light, from, point.position, cosine);
            assert!((pdf / incident.pdf - 1.0).abs() < 1e-2, "{light}: {pdf} {}", incident.pdf);
        }
        for (light, [dark, bright]) in seen.into_iter().enumerate() {
            assert!(bright > 20, "lamp {light} is seen {bright} times");
            let two_sided = [6, 7, 11, 15].contains(&light);
            assert!(two_sided == (dark == 0), "lamp {light} is dark {dark} times");
        }
    }

    /// Power decides how often a lamp is chosen: one that shines on both sides has twice as much.
    #[test]
    fn a_lamp_that_shines_on_both_sides_is_chosen_twice_as_often() {
        let mut scene = Scene::new("power");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        for two_sided in [false, true] {
            let disk = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Z, radius: 1.0 };
            let mut shape = Shape::new(disk, black).emitting(Vec3::ONE);
            shape.emission.as_mut().unwrap().two_sided = two_sided;
            scene.add_shape(shape);
        }
        let lights = Lights::build(&scene, bounds(&scene));
        let chances = [0, 1].map(|light| lights.choice_probability(light));
        assert!((chances[1] / chances[0] - 2.0).abs() < 1e-6, "{chances:?}");
    }

    /// Through the holes of a ball that shines inwards, too, its far side is seen.
    #[test]
    fn the_far_side_of_a_ball_with_holes_is_sampled() {
        let mut scene = Scene::new("holes");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 1.0 };
        let mut shape = Shape::new(ball, black).emitting(Vec3::ONE);
        shape.emission.as_mut().unwrap().two_sided = true;
        shape.alpha = Some(crate::scene::Scalar::Constant(0.5));
        scene.add_shape(shape);
        let lights = Lights::build(&scene, bounds(&scene));
        let mut random = Stream::from_key(1);
        let far = (0..1000).filter(|_| {
            let u = Vec2::new(random.uniform(), random.uniform());
            let emitter = lights.emitter_towards(&scene, 0, 3.0 * Vec3::X, u);
            emitter.is_some_and(|emitter| emitter.place().x < 0.0)
        });
        let far = far.count();
        assert!((400..600).contains(&far), "{far} of 1000 on the far half");
    }

    /// A world where nothing but the camera moved has the accelerator of the one before, not
    /// another one of the same trees.
    #[test]
    fn what_stays_is_not_built_in_silence() {
        let options = BuildOptions { two_level: Some(true), ..BuildOptions::default() };
        let world = World::new(lamps(), &options).unwrap();
        let mut scene = lamps();
        scene.objects.clone_from(&world.scene.objects);
        let next = world.next(scene.clone()).unwrap();
        assert!(world.accel.report().built > 1);
        assert_eq!(next.accel.report(), world.accel.report());
        let placed = scene.instances[0].to_world.fixed();
        let up = glam::Affine3A::from_translation(Vec3::Y);
        scene.instances[0].to_world = Transform::Fixed(up * placed);
        let control = world.next(scene).unwrap();
        assert_eq!(control.accel.report().built, 0, "a tree over instances alone");
    }

    /// A sky's power grows with the scene, so the choice among lights is another one where
    /// something has moved far away, though no light has.
    #[test]
    fn a_sky_is_chosen_as_often_as_the_scene_is_large() {
        let mut scene = Scene::new("growing");
        let reflectance = Color::Constant(Vec3::ZERO);
        let black = scene.add_material(Material::Diffuse { reflectance });
        let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 1.0 };
        scene.add_shape(Shape::new(ball.clone(), black));
        scene.add_shape(Shape::new(ball, black).emitting(Vec3::ONE));
        let kind = LightKind::Environment { radiance: Vec3::ONE, image: None };
        scene.lights.push(crate::scene::Light { to_world: Transform::IDENTITY, kind, key: 9 });
        let world = World::new(scene.clone(), &BuildOptions::default()).unwrap();
        let far = glam::Affine3A::from_translation(Vec3::X * 50.0);
        scene.instances[0].to_world = Transform::Fixed(far);
        scene.objects.clone_from(&world.scene.objects);
        let next = world.next(scene.clone()).unwrap();
        let anew = World::new(scene, &BuildOptions::default()).unwrap();
        let chances = [&world, &next, &anew].map(|world| {
            let (sky, _) = world.lights.environments().next().unwrap();
            world.lights.choice_probability(sky)
        });
        assert_eq!(chances[1], chances[2]);
        assert!(chances[1] > chances[0] + 0.01, "{chances:?}");
    }
}
