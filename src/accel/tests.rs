//! Queries against exhaustive search and in the corners. Everything here is exact or counted; nothing is statistical.

use super::*;
use crate::scene::{MaterialId, Mesh, Shape, Transform};

/// A small generator of its own, so that these scenes never change with the crate's.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        // Knuth's MMIX congruential generator; its upper bits are enough to place triangles.
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1 << 24) as f32
    }

    fn cube(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit()) * 2.0 - 1.0
    }

    fn direction(&mut self) -> Vec3 {
        loop {
            let v = self.cube();
            if v.length_squared() > 0.01 && v.length_squared() < 1.0 {
                return v.normalize();
            }
        }
    }
}

fn shape(geometry: Geometry) -> Shape {
    Shape::new(geometry, MaterialId(0))
}

fn mesh(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>) -> Shape {
    shape(Geometry::Mesh(Arc::new(Mesh { positions, triangles, ..Mesh::default() })))
}

/// Separate triangles.
fn soup(corners: Vec<Vec3>) -> Shape {
    let count = corners.len() as u32 / 3;
    mesh(corners, (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect())
}

fn scene_of(shapes: Vec<Shape>) -> Scene {
    let mut scene = Scene::new("test");
    let object = scene.add_object(Object { name: String::new(), shapes });
    scene.add_instance(object, Transform::IDENTITY, 0);
    scene
}

fn random_shapes(random: &mut Random, count: usize) -> Vec<Shape> {
    let mut corners = Vec::new();
    for _ in 0..count {
        let center = random.cube();
        let size = 0.6 * random.unit();
        corners.extend([(); 3].map(|()| center + random.cube() * size));
    }
    let mut shapes = vec![soup(corners)];
    for _ in 0..count / 4 {
        let (center, radius) = (random.cube(), 0.1 * random.unit() + 1e-4);
        let normal = random.direction();
        shapes.push(shape(Geometry::Sphere { center, radius }));
        shapes.push(shape(Geometry::Disk { center: random.cube(), normal, radius }));
    }
    shapes
}

fn ray(origin: Vec3, direction: Vec3) -> Ray {
    Ray { origin, direction, t_max: f32::INFINITY }
}

fn build(scene: &Scene, options: BuildOptions) -> Accel {
    Accel::build(scene, &options).expect("the scene is valid")
}

fn variants() -> Vec<BuildOptions> {
    let mut all = Vec::new();
    for layout in [Layout::Cwbvh, Layout::Bvh2] {
        for portable in [false, true] {
            for quality in [Quality::Fast, Quality::Medium, Quality::High] {
                all.push(BuildOptions { layout, portable, quality, two_level: None });
            }
        }
    }
    all
}

/// A hit in terms that do not depend on the order of leaves.
fn named(accel: &Accel, hit: Option<Hit>) -> Option<([u32; 3], u32, u32, u32)> {
    hit.map(|h| {
        let point = accel.point(&h);
        ([h.t, h.u, h.v].map(f32::to_bits), point.shape, point.element, h.instance)
    })
}

#[test]
fn every_tree_and_kernel_finds_what_exhaustive_search_finds() {
    let mut random = Random(1);
    let scene = scene_of(random_shapes(&mut random, 200));
    let accels: Vec<Accel> = variants().into_iter().map(|o| build(&scene, o)).collect();
    let mut hits = 0;
    for _ in 0..20_000 {
        let mut r = ray(random.cube() * 1.5, random.direction());
        if random.unit() < 0.3 {
            r.direction[(random.unit() * 3.0) as usize] = 0.0;
        }
        let expected = named(&accels[0], accels[0].exhaustive_hit(&r, &AcceptAll));
        hits += usize::from(expected.is_some());
        for accel in &accels {
            let found = named(accel, accel.closest_hit(&r, &AcceptAll));
            assert_eq!(found, expected, "{r:?} {:?}", accel.options);
            assert_eq!(accel.occluded(&r, &AcceptAll), expected.is_some(), "{r:?}");
        }
    }
    assert!(hits > 5000, "{hits}");
}
