//! Queries against exhaustive search and in the corners. Everything here is exact or counted;
//! nothing is statistical.

use glam::{Affine3A, Quat, Vec2};

use super::*;
use crate::math::offset_origin;
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
    for _ in 0..100_000 {
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
    assert!(hits > 25_000, "{hits}");
}

/// Moving one shape's scene to instances: rotated, sheared, mirrored, all of them placements of
/// three objects.
fn instanced_scene(random: &mut Random) -> Scene {
    let mut scene = Scene::new("instances");
    let objects: Vec<_> = (0..3)
        .map(|_| {
            let shapes = random_shapes(random, 30);
            scene.add_object(Object { name: String::new(), shapes })
        })
        .collect();
    for key in 0..12 {
        let scale = Vec3::new(random.unit() + 0.2, random.unit() + 0.2, random.unit() - 1.2) * 0.5;
        let rotation = Quat::from_axis_angle(random.direction(), random.unit() * 6.0);
        let placed =
            Affine3A::from_scale_rotation_translation(scale, rotation, random.cube() * 2.0);
        scene.add_instance(objects[key % 3], Transform::Fixed(placed), key as u64);
    }
    scene
}

#[test]
fn two_levels_find_what_one_finds() {
    let mut random = Random(2);
    let scene = instanced_scene(&mut random);
    let flat = build(&scene, BuildOptions { two_level: Some(false), ..BuildOptions::default() });
    let accels: Vec<Accel> = variants().into_iter().map(|o| build(&scene, o)).collect();
    assert!(accels.iter().all(|a| a.report().two_level) && !flat.report().two_level);
    let (mut hits, mut different) = (0, 0);
    for _ in 0..10_000 {
        let origin = random.cube() * 3.0;
        let r = ray(origin, random.cube() * 2.0 - origin);
        let expected = accels[0].exhaustive_hit(&r, &AcceptAll);
        for accel in &accels {
            let found = accel.closest_hit(&r, &AcceptAll);
            assert_eq!(
                named(accel, found),
                named(&accels[0], expected),
                "{r:?} {:?}",
                accel.options
            );
            assert_eq!(accel.occluded(&r, &AcceptAll), expected.is_some(), "{r:?}");
        }
        let in_world = flat.closest_hit(&r, &AcceptAll);
        let (Some(a), Some(b)) = (in_world, expected) else {
            different += usize::from(in_world.is_some() != expected.is_some());
            continue;
        };
        hits += 1;
        let (a, b) = (flat.point(&a), accels[0].point(&b));
        if (a.shape, a.element, a.instance) != (b.shape, b.element, b.instance) {
            different += 1;
            continue;
        }
        assert!((a.position - b.position).length() < 1e-5, "{a:?} {b:?}");
        assert!(a.geometric_normal.dot(b.geometric_normal) > 0.99999, "{a:?} {b:?}");
        // The tangent of a sliver is as uncertain as its corners.
        assert!((a.uv - b.uv).length() < 1e-2, "{a:?} {b:?}");
    }
    // Vertices are rounded once more in the flat one: only rays within 1e-6 of an edge may differ.
    assert!(hits > 500 && different < 5, "{hits} {different}");
}

#[test]
fn vector_and_plain_triangle_tests_agree_bit_for_bit() {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = V3::try_new() {
        use triangle::{TriangleRay, edges_avx2, edges_portable};
        let mut random = Random(3);
        let mut accepted = 0;
        for _ in 0..200_000 {
            let slot = Slot::triangle([(); 3].map(|()| random.cube()));
            let mut d = random.cube();
            if random.unit() < 0.2 {
                d[(random.unit() * 3.0) as usize] = -0.0;
            }
            let r = TriangleRay::new(random.cube().as_dvec3(), d.as_dvec3());
            let (a, b) = (edges_portable(&slot, &r), edges_avx2(simd, &slot, &r));
            let (a, b) = (
                a.and_then(|e| r.distance(&e, f64::INFINITY)),
                b.and_then(|e| r.distance(&e, f64::INFINITY)),
            );
            assert_eq!(a, b);
            accepted += usize::from(a.is_some());
        }
        assert!(accepted > 5000, "{accepted}");
    }
}

/// A closed sphere of radius 2 of `rows` × `columns` quads around `center`.
fn tessellated(center: Vec3, rows: u32, columns: u32) -> Mesh {
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..columns {
            let theta = std::f32::consts::PI * row as f32 / rows as f32;
            let phi = std::f32::consts::TAU * column as f32 / columns as f32;
            let d = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            // One vertex at each pole, or the poles would be rings of slivers.
            let d = if row == 0 {
                Vec3::Z
            } else if row == rows {
                -Vec3::Z
            } else {
                d
            };
            mesh.positions.push(center + 2.0 * d);
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let next = (column + 1) % columns;
            let [a, b] = [row * columns + column, row * columns + next];
            let [c, d] = [a + columns, b + columns];
            if row > 0 {
                mesh.triangles.push([a, c, b]);
            }
            if row + 1 < rows {
                mesh.triangles.push([b, c, d]);
            }
        }
    }
    mesh
}

#[test]
fn closed_mesh_is_watertight_at_vertices_and_edges_where_the_stock_test_leaks() {
    let mut stock_misses = 0;
    for center in
        [Vec3::ZERO, Vec3::new(100.0, -50.0, 70.0), Vec3::new(148376.0, 1234.0, -223423.0)]
    {
        let mesh = tessellated(center, 50, 100);
        let stock: Vec<obvhs::triangle::Triangle> = mesh
            .triangles
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.map(|i| Vec3A::from(mesh.positions[i as usize]));
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let params = obvhs::BvhBuildParams::medium_build();
        let stock_tree = obvhs::bvh2::builder::build_bvh2(&stock, params, &mut Default::default());
        let scene = scene_of(vec![shape(Geometry::Mesh(Arc::new(mesh.clone())))]);
        let accels: Vec<Accel> = variants().into_iter().map(|o| build(&scene, o)).collect();
        let mut random = Random(4);
        for _ in 0..20_000 {
            let origin = center + random.cube() * 0.5;
            let corners = mesh.triangles[(random.unit() * mesh.triangles.len() as f32) as usize];
            let [a, b, _] = corners.map(|i| mesh.positions[i as usize]);
            let target = a.lerp(b, if random.unit() < 0.5 { 0.0 } else { random.unit() });
            let r = ray(origin, target - origin);
            for accel in &accels {
                assert!(accel.closest_hit(&r, &AcceptAll).is_some(), "{r:?} {:?}", accel.options);
            }
            let stock_ray = obvhs::ray::Ray::new_inf(r.origin.into(), r.direction.into());
            let mut hit = obvhs::ray::RayHit::none();
            let tests = |ray: &obvhs::ray::Ray, i: usize| {
                stock[stock_tree.primitive_indices[i] as usize].intersect(ray)
            };
            stock_misses += usize::from(!stock_tree.ray_traverse(stock_ray, &mut hit, tests));
        }
    }
    // The control: the stock test must leak here, or the rays are not aimed well.
    assert!(stock_misses > 3000, "{stock_misses}");
}

#[test]
fn rays_from_a_surface_neither_hit_it_nor_leak() {
    let (mut cast, mut bounces) = (0, 0);
    for (scale, offset) in
        [(1e-3, 0.0), (1.0, 0.0), (1e3, 0.0), (1e6, 0.0), (1.0, 1e3), (1e3, 1e6), (1e-10, 0.0)]
    {
        let shift = Vec3::new(1.0, -0.7, 0.3) * offset;
        let mut mesh = tessellated(Vec3::ZERO, 20, 31);
        mesh.positions.iter_mut().for_each(|p| *p = *p * scale + shift);
        let center = shift + Vec3::new(0.4, 0.3, 0.2) * scale;
        let inner = shape(Geometry::Sphere { center, radius: 0.5 * scale });
        let scene = scene_of(vec![shape(Geometry::Mesh(Arc::new(mesh))), inner]);
        for two_level in [Some(false), Some(true)] {
            let accel = build(&scene, BuildOptions { two_level, ..BuildOptions::default() });
            let mut random = Random(5);
            for _ in 0..300 {
                let mut r = ray(shift + Vec3::new(0.0, 0.0, 1.5) * scale, random.direction());
                for _ in 0..30 {
                    let hit =
                        accel.closest_hit(&r, &AcceptAll).expect("no way out of a closed mesh");
                    let p = accel.point(&hit);
                    let side = p.geometric_normal * -p.geometric_normal.dot(r.direction).signum();
                    let mut direction = random.direction();
                    direction *= direction.dot(side).signum();
                    // A direction within its own rounding of the plane belongs to neither side.
                    if direction.dot(side) < 1e-6 {
                        break;
                    }
                    r = ray(offset_origin(p.position, side, p.error), direction);
                    cast += 1;
                    if let Some(next) = accel.closest_hit(&r, &AcceptAll) {
                        let inside_sphere = p.shape == 1 && side.dot(p.geometric_normal) < 0.0;
                        assert!(
                            next.primitive != hit.primitive || inside_sphere,
                            "{scale} {offset} {p:?} {r:?}"
                        );
                        bounces += 1;
                    }
                }
            }
        }
    }
    assert!(cast > 100_000 && bounces == cast, "{cast} {bounces}");
}

#[test]
fn instances_are_left_without_self_hits_under_extreme_transforms() {
    let mut random = Random(6);
    let mut scene = Scene::new("extreme");
    let mesh = tessellated(Vec3::ZERO, 20, 31);
    let shapes = vec![shape(Geometry::Mesh(Arc::new(mesh)))];
    let object = scene.add_object(Object { name: String::new(), shapes });
    let placed = Affine3A::from_scale_rotation_translation(
        Vec3::new(1e2, -1e-2, 1.0),
        Quat::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 1.0),
        Vec3::new(1000.0, -300.0, 20.0),
    );
    scene.add_instance(object, Transform::Fixed(placed), 0);
    let accel = build(&scene, BuildOptions { two_level: Some(true), ..BuildOptions::default() });
    let mut cast = 0;
    for _ in 0..20_000 {
        let from = placed.transform_point3(random.cube());
        let to = placed.transform_point3(random.direction() * 3.0);
        let r = ray(from, to - from);
        let hit = accel.closest_hit(&r, &AcceptAll).expect("no way out of a closed mesh");
        let p = accel.point(&hit);
        for side in [p.geometric_normal, -p.geometric_normal] {
            let mut direction = random.direction();
            direction *= direction.dot(side).signum();
            if direction.dot(side) < 1e-5 {
                continue;
            }
            let next = ray(offset_origin(p.position, side, p.error), direction);
            let found = accel.closest_hit(&next, &AcceptAll);
            assert!(found.is_none_or(|h| h.primitive != hit.primitive), "{p:?} {next:?}");
            cast += 1;
        }
    }
    assert!(cast > 30_000, "{cast}");
}

#[test]
fn segments_between_two_surface_points_see_neither_surface() {
    let mut random = Random(7);
    let (mut clear, mut shadowed) = (0, 0);
    for (scale, offset) in [(1e-3, 0.0), (1.0, 0.0), (1e5, 0.0), (1.0, 1e4), (1e-2, 1e4)] {
        let shift = Vec3::new(1.0, -0.7, 0.3) * offset;
        let mut mesh = tessellated(Vec3::ZERO, 20, 31);
        mesh.positions.iter_mut().for_each(|p| *p = *p * scale + shift);
        let scene = scene_of(vec![shape(Geometry::Mesh(Arc::new(mesh)))]);
        let accel = build(&scene, BuildOptions::default());
        for _ in 0..10_000 {
            // Two points of a convex room, always mutually visible.
            let [a, b] = [(); 2].map(|()| {
                let r = ray(shift + random.cube() * 0.5 * scale, random.direction());
                let hit = accel.closest_hit(&r, &AcceptAll).expect("no way out of a closed mesh");
                accel.point(&hit)
            });
            let inward = |p: &HitPoint| {
                p.geometric_normal * p.geometric_normal.dot(shift - p.position).signum()
            };
            let [from, to] = [&a, &b].map(|p| offset_origin(p.position, inward(p), p.error));
            let segment = Ray { origin: from, direction: to - from, t_max: 1.0 };
            // One facet, or nearly coplanar ones: the segment lies in the surface itself.
            let apart = (b.position - a.position).normalize();
            if apart.dot(inward(&a)) < 1e-2 || apart.dot(inward(&b)) > -1e-2 {
                continue;
            }
            assert!(!accel.occluded(&segment, &AcceptAll), "{scale} {offset} {a:?} {b:?}");
            clear += 1;
            // The control: past its end, the room's wall is in the way.
            shadowed += usize::from(accel.occluded(&Ray { t_max: 1.5, ..segment }, &AcceptAll));
        }
    }
    assert!(clear > 30_000 && shadowed > clear / 2, "{clear} {shadowed}");
}

#[test]
fn hits_are_the_same_bits_at_every_power_of_two_scale() {
    let mut random = Random(8);
    let shapes = random_shapes(&mut random, 100);
    let rays: Vec<Ray> = (0..3000).map(|_| ray(random.cube() * 1.5, random.direction())).collect();
    let scaled = |k: i32| {
        let factor = 2.0_f32.powi(k);
        let shapes = shapes
            .iter()
            .cloned()
            .map(|mut s| {
                s.geometry = match s.geometry {
                    Geometry::Mesh(mesh) => {
                        let mut mesh = Mesh::clone(&mesh);
                        mesh.positions.iter_mut().for_each(|p| *p *= factor);
                        Geometry::Mesh(Arc::new(mesh))
                    }
                    Geometry::Sphere { center, radius } => {
                        Geometry::Sphere { center: center * factor, radius: radius * factor }
                    }
                    Geometry::Disk { center, normal, radius } => {
                        Geometry::Disk { center: center * factor, normal, radius: radius * factor }
                    }
                };
                s
            })
            .collect();
        (factor, scene_of(shapes))
    };
    for layout in [Layout::Cwbvh, Layout::Bvh2] {
        let options = BuildOptions { layout, ..BuildOptions::default() };
        let unit = build(&scaled(0).1, options);
        let expected: Vec<_> = rays.iter().map(|r| unit.closest_hit(r, &AcceptAll)).collect();
        for k in (-40..=20).step_by(4) {
            let (factor, scene) = scaled(k);
            let accel = build(&scene, options);
            for (r, expected) in rays.iter().zip(&expected) {
                let r = Ray { origin: r.origin * factor, ..*r };
                let found = accel.closest_hit(&r, &AcceptAll);
                let found = named(&accel, found.map(|h| Hit { t: h.t / factor, ..h }));
                assert_eq!(found, named(&unit, *expected), "2^{k} {r:?}");
            }
        }
    }
}

#[test]
fn direction_of_any_length_and_with_any_zero_finds_the_same() {
    let mut random = Random(9);
    let scene = scene_of(random_shapes(&mut random, 100));
    for options in variants() {
        let accel = build(&scene, options);
        for _ in 0..2000 {
            let mut r = ray(random.cube(), random.direction());
            let axis = (random.unit() * 3.0) as usize;
            let tiny =
                [0.0, -0.0, f32::from_bits(3), -1e-40, 1e-30][(random.unit() * 5.0) as usize];
            r.direction[axis] = tiny;
            let expected = accel.exhaustive_hit(&r, &AcceptAll);
            assert_eq!(accel.closest_hit(&r, &AcceptAll), expected, "{r:?}");
            r.direction[axis] = 0.0;
            let zero = accel.closest_hit(&r, &AcceptAll);
            for factor in [1e-20_f32, 1e-35, 1e20, 3e37] {
                let power = 2.0_f32.powf(factor.log2().round());
                let long = Ray { direction: r.direction * power, ..r };
                let same = |h: Option<Hit>| h.map(|h| (h.u, h.v, h.primitive));
                assert_eq!(same(accel.closest_hit(&long, &AcceptAll)), same(zero), "{long:?}");
            }
        }
    }
}

#[test]
fn rays_in_the_planes_of_axis_parallel_boxes_are_found() {
    // A grid in the plane z = 1: flat boxes, whose corners' coordinates the rays share.
    let corner = |x: u32, y: u32| Vec3::new(x as f32, y as f32, 1.0);
    let mut corners = Vec::new();
    for (x, y) in (0..16).flat_map(|x| (0..16).map(move |y| (x, y))) {
        corners.extend([corner(x, y), corner(x + 1, y), corner(x + 1, y + 1)]);
        corners.extend([corner(x, y), corner(x + 1, y + 1), corner(x, y + 1)]);
    }
    let scene = scene_of(vec![soup(corners)]);
    for options in variants() {
        let accel = build(&scene, options);
        for (x, y) in (0..=16).flat_map(|x| (0..=16).map(move |y| (x, y))) {
            for z in [-1.0, 3.0] {
                let r = ray(corner(x, y).with_z(z), Vec3::new(-0.0, 0.0, 1.0 - z));
                let hit = accel.closest_hit(&r, &AcceptAll);
                assert_eq!(hit.map(|h| h.t), Some(1.0), "{r:?} {options:?}");
            }
        }
    }
}

#[test]
fn rays_that_are_none_miss() {
    let mut random = Random(10);
    let scene = scene_of(random_shapes(&mut random, 100));
    for options in variants() {
        let accel = build(&scene, options);
        for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY] {
            for axis in 0..3 {
                let mut origin = ray(Vec3::ZERO, Vec3::X);
                let mut direction = origin;
                origin.origin[axis] = bad;
                direction.direction[axis] = bad;
                for r in [origin, direction] {
                    assert_eq!(accel.closest_hit(&r, &AcceptAll), None);
                    assert!(!accel.occluded(&r, &AcceptAll));
                }
            }
        }
        for t_max in [f32::NAN, 0.0, -1.0, -f32::INFINITY] {
            let r = Ray { t_max, ..ray(Vec3::new(0.0, 0.0, -5.0), Vec3::Z) };
            assert_eq!(accel.closest_hit(&r, &AcceptAll), None);
        }
        assert_eq!(accel.closest_hit(&ray(Vec3::ZERO, Vec3::ZERO), &AcceptAll), None);
    }
}

#[test]
fn degenerate_and_wild_primitives_are_dropped_and_counted() {
    let good = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let mut corners = good.to_vec();
    corners.extend([Vec3::ONE; 3]);
    corners.extend([Vec3::ZERO, Vec3::ONE, Vec3::ONE * 2.0]);
    corners.extend([Vec3::NAN, Vec3::X, Vec3::Y]);
    corners.extend([Vec3::INFINITY, Vec3::X, Vec3::Y]);
    corners.extend([Vec3::splat(1e30), Vec3::X, Vec3::Y]);
    let spheres = [0.0, -1.0, f32::NAN, 1e19]
        .map(|radius| shape(Geometry::Sphere { center: Vec3::ZERO, radius }));
    let scene = scene_of([vec![soup(corners)], spheres.to_vec()].concat());
    for options in variants() {
        let accel = build(&scene, options);
        assert_eq!((accel.report().primitives, accel.report().dropped), (1, 9));
        let hit = accel.closest_hit(&ray(Vec3::new(0.2, 0.2, -1.0), Vec3::Z), &AcceptAll);
        assert_eq!(hit.map(|h| h.t), Some(1.0));
    }
}

#[test]
fn nothing_one_and_many_coincident_primitives_build() {
    let triangle = [Vec3::ZERO, Vec3::X, Vec3::Y];
    let r = ray(Vec3::new(0.2, 0.2, -1.0), Vec3::Z);
    for (count, two_level) in
        [0, 1, 65, 100_000].into_iter().flat_map(|n| [(n, Some(false)), (n, Some(true))])
    {
        let corners = triangle.iter().copied().cycle().take(3 * count).collect();
        let scene = scene_of(vec![soup(corners)]);
        for layout in [Layout::Cwbvh, Layout::Bvh2] {
            let accel =
                build(&scene, BuildOptions { layout, two_level, ..BuildOptions::default() });
            assert_eq!(accel.report().primitives, count);
            let hit = accel.closest_hit(&r, &AcceptAll);
            // The first in the scene's order.
            let element = hit.map(|h| accel.point(&h).element);
            assert_eq!(element, (count > 0).then_some(0), "{count} {layout:?}");
        }
    }
    let mut many = Scene::new("coincident instances");
    let object =
        many.add_object(Object { name: String::new(), shapes: vec![soup(triangle.to_vec())] });
    (0..5000).for_each(|key| many.add_instance(object, Transform::IDENTITY, key));
    let accel = build(&many, BuildOptions::default());
    assert_eq!(accel.closest_hit(&r, &AcceptAll).map(|h| h.instance), Some(0));
}

#[test]
fn coplanar_concentric_and_many_primitives_build_to_bounded_depth() {
    let mut random = Random(11);
    let flat = |random: &mut Random| Vec3::new(random.unit(), random.unit(), 0.0);
    let coplanar = soup((0..300_000).map(|_| flat(&mut random)).collect());
    let nested: Vec<Shape> = (1..5000)
        .map(|i| shape(Geometry::Sphere { center: Vec3::ONE, radius: i as f32 * 1e-3 }))
        .collect();
    let geometric: Vec<Shape> = (0..100)
        .map(|i| {
            let size = 2.0_f32.powi(-i);
            soup([Vec3::ZERO, Vec3::X, Vec3::Y].map(|p| (p + Vec3::ONE) * size).to_vec())
        })
        .collect();
    let scattered: Vec<Shape> = (0..1_000_000)
        .map(|_| shape(Geometry::Sphere { center: random.cube(), radius: 1e-3 }))
        .collect();
    for (shapes, seconds) in [(vec![coplanar], 10), (nested, 5), (geometric, 1), (scattered, 20)] {
        let scene = scene_of(shapes);
        let start = std::time::Instant::now();
        let accel = build(&scene, BuildOptions::default());
        assert!(start.elapsed().as_secs() < seconds, "{:?}", start.elapsed());
        assert!(accel.report().depth <= 36, "{:?}", accel.report());
        let r = ray(Vec3::new(0.5, 0.5, 5.0), Vec3::new(0.01, 0.0, -1.0));
        assert_eq!(accel.closest_hit(&r, &AcceptAll), accel.exhaustive_hit(&r, &AcceptAll));
    }
}

#[test]
fn needles_agree_with_a_plane_test_in_f64() {
    let mut random = Random(12);
    let mut hits = 0;
    for _ in 0..5000 {
        let start = random.cube() * 10.0;
        let along = random.direction() * 10.0;
        let across = random.direction() * 1e-5;
        let p = [start, start + along, start + across];
        let accel = build(&scene_of(vec![soup(p.to_vec())]), BuildOptions::default());
        let [a, b, c] = p.map(|p| p.as_dvec3());
        let target = a * 0.3 + b * 0.3 + c * 0.4;
        let origin = random.cube() * 10.0;
        // Aimed in f32, the ray passes the needle's inside only sometimes: the oracle decides.
        let r = ray(origin, target.as_vec3() - origin);
        let (o, d) = (r.origin.as_dvec3(), r.direction.as_dvec3());
        let n = (b - a).cross(c - a);
        let t = n.dot(a - o) / n.dot(d);
        let q = o + d * t;
        let weight = |e0: DVec3, e1: DVec3| (e1 - e0).cross(q - e0).dot(n) / n.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let found = accel.closest_hit(&r, &AcceptAll);
        // f64 itself knows the weights to about 1e-16 / 1e-6 squared here.
        let least = weights.into_iter().fold(f64::INFINITY, f64::min);
        if least.abs() < 1e-3 || n.dot(d).abs() < 1e-6 * n.length() * d.length() {
            continue;
        }
        assert_eq!(found.is_some(), least > 0.0, "{r:?} {weights:?}");
        if let Some(hit) = found {
            hits += 1;
            assert!((f64::from(hit.t) / t - 1.0).abs() < 1e-5, "{} {t}", hit.t);
        }
    }
    assert!(hits > 300, "{hits}");
}

#[test]
fn near_surfaces_are_told_apart() {
    let quad = |z: f32| {
        let p = [Vec3::new(-1.0, -1.0, z), Vec3::new(3.0, -1.0, z), Vec3::new(-1.0, 3.0, z)];
        soup(p.to_vec())
    };
    let gap = 4e-5;
    let accel = build(&scene_of(vec![quad(1.0), quad(1.0 + gap)]), BuildOptions::default());
    let mut random = Random(13);
    for _ in 0..10_000 {
        let direction = Vec3::new(random.unit(), random.unit(), 3.0);
        let first = accel.closest_hit(&ray(Vec3::ZERO, direction), &AcceptAll).expect("in front");
        let p = accel.point(&first);
        assert_eq!(p.shape, 0);
        let origin = offset_origin(p.position, Vec3::Z, p.error);
        let second = accel.closest_hit(&ray(origin, direction), &AcceptAll).expect("behind");
        assert_eq!(accel.point(&second).shape, 1);
    }
}

#[test]
fn normals_keep_their_side_through_instances() {
    let mesh = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        normals: vec![],
        uvs: vec![],
        triangles: vec![[0, 1, 2]],
    };
    let r = ray(Vec3::new(0.2, 0.2, -1.0), Vec3::Z);
    let point = |mesh: &Mesh, scale: Vec3, reverse: bool, two_level: bool| {
        let mut s = shape(Geometry::Mesh(Arc::new(mesh.clone())));
        s.reverse_orientation = reverse;
        let mut scene = scene_of(vec![s]);
        scene.instances[0].to_world = Transform::Fixed(Affine3A::from_scale(scale));
        let options = BuildOptions { two_level: Some(two_level), ..BuildOptions::default() };
        let accel = build(&scene, options);
        let r = Ray { origin: r.origin * scale, direction: r.direction * scale, ..r };
        let hit = accel.closest_hit(&r, &AcceptAll).expect("aimed at it");
        assert_eq!(hit.t, 1.0);
        assert_eq!(accel.point_under(&hit, Affine3A::IDENTITY), Vec3::new(0.2, 0.2, 0.0));
        accel.point(&hit)
    };
    for two_level in [false, true] {
        let normal = |mesh: &Mesh, scale, reverse| {
            let p = point(mesh, scale, reverse, two_level);
            (p.geometric_normal, p.shading_normal)
        };
        // Mirrored across x: the corners turn around in world space, the normal of a face towards
        // +z still does not.
        let stretched = Vec3::new(-1e4, 1.0, 1.0);
        for scale in [Vec3::ONE, stretched] {
            assert_eq!(normal(&mesh, scale, false), (Vec3::Z, Vec3::Z));
            assert_eq!(normal(&mesh, scale, true), (-Vec3::Z, -Vec3::Z));
            // Vertex normals decide the side, whatever `reverse` says.
            let down = Mesh { normals: vec![-Vec3::Z; 3], ..mesh.clone() };
            for reverse in [false, true] {
                assert_eq!(normal(&down, scale, reverse), (-Vec3::Z, -Vec3::Z));
            }
            // An interpolated normal that vanishes or lies behind is not used.
            let zero = Mesh { normals: vec![Vec3::ZERO; 3], ..mesh.clone() };
            assert_eq!(normal(&zero, scale, false), (Vec3::Z, Vec3::Z));
            let mixed = Mesh { normals: vec![-Vec3::Z, Vec3::Z * 2.0, Vec3::Z], ..mesh.clone() };
            assert_eq!(normal(&mixed, scale, false), (Vec3::Z, Vec3::Z));
        }
        assert_eq!(point(&mesh, Vec3::ONE, false, two_level).uv, Vec2::new(0.4, 0.2));
    }
}

#[test]
fn sphere_point_by_hand() {
    let sphere = shape(Geometry::Sphere { center: Vec3::new(0.0, 0.0, 5.0), radius: 2.0 });
    let accel = build(&scene_of(vec![sphere]), BuildOptions::default());
    let hit = accel.closest_hit(&ray(Vec3::new(0.0, -9.0, 5.0), Vec3::Y), &AcceptAll);
    let hit = hit.expect("aimed at it");
    let p = accel.point(&hit);
    assert_eq!((hit.t, p.position), (7.0, Vec3::new(0.0, -2.0, 5.0)));
    assert_eq!((p.geometric_normal, p.uv), (-Vec3::Y, Vec2::new(0.75, 0.5)));
    assert!(
        (accel.tangent(&hit) - Vec3::X * 2.0 * std::f32::consts::TAU).length() < 1e-5,
        "{}",
        accel.tangent(&hit)
    );
}

#[test]
fn singular_transforms_are_refused() {
    for scale in [Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, f32::NAN, 1.0), Vec3::ZERO] {
        let mut scene = scene_of(vec![soup(vec![Vec3::ZERO, Vec3::X, Vec3::Y])]);
        scene.instances[0].to_world = Transform::Fixed(Affine3A::from_scale(scale));
        let error = Accel::build(&scene, &BuildOptions::default()).expect_err("singular");
        assert!(error.is_invalid() && error.to_string().contains("instance 0"), "{error}");
    }
}

#[test]
fn rebuild_shares_what_did_not_change() {
    let mut random = Random(14);
    let mut scene = instanced_scene(&mut random);
    let before = build(&scene, BuildOptions { two_level: Some(true), ..BuildOptions::default() });
    scene.instances[3].to_world = Transform::Fixed(Affine3A::from_translation(Vec3::splat(3.0)));
    let after = before.rebuild(&scene).expect("valid");
    assert!(before.bottoms.iter().zip(&after.bottoms).all(|(a, b)| Arc::ptr_eq(a, b)));
    let fresh = build(&scene, BuildOptions { two_level: Some(true), ..BuildOptions::default() });
    for _ in 0..2000 {
        let r = ray(random.cube() * 3.0, random.direction());
        let expected = named(&fresh, fresh.closest_hit(&r, &AcceptAll));
        assert_eq!(named(&after, after.closest_hit(&r, &AcceptAll)), expected);
    }
}

/// Lets every second triangle pass.
struct Odd<'a>(&'a Accel);

impl HitFilter for Odd<'_> {
    fn accept(&self, _: &Ray, hit: &Hit) -> bool {
        self.0.point(hit).element % 2 == 1
    }
}

#[test]
fn filtered_hits_are_the_nearest_accepted() {
    let mut random = Random(15);
    let scene = scene_of(random_shapes(&mut random, 200));
    for options in variants() {
        let accel = build(&scene, options);
        let mut hits = 0;
        for _ in 0..2000 {
            let r = ray(random.cube() * 1.5, random.direction());
            let expected = accel.exhaustive_hit(&r, &Odd(&accel));
            assert_eq!(accel.closest_hit(&r, &Odd(&accel)), expected);
            assert_eq!(accel.occluded(&r, &Odd(&accel)), expected.is_some());
            hits += usize::from(expected.is_some());
        }
        assert!(hits > 100, "{hits}");
    }
}
