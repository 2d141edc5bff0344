//! Rays a second on one core: primary, bounce (cosine) and shadow rays; ours in both layouts and
//! with plain tests, against obvhs' own traversal with its own triangle test. Every engine gets the
//! same rays.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use afterimage::accel::{Accel, AcceptAll, BuildOptions, Layout, Ray};
use afterimage::math::offset_origin;
use afterimage::scene::{Geometry, MaterialId, Mesh, Object, Scene, Shape, Transform};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec2, Vec3};
use obvhs::triangle::Triangle;

/// Primary rays a side of the picture.
const SIZE: u32 = 256;

fn hash(n: u32) -> f32 {
    let mut h = n.wrapping_mul(0x9e37_79b9);
    h = (h ^ (h >> 16)).wrapping_mul(0x21f0_aaad);
    h = (h ^ (h >> 15)).wrapping_mul(0x735a_2d97);
    (h >> 8) as f32 / (1 << 24) as f32
}

fn scene_of(name: &str, mesh: Mesh) -> Scene {
    let mut scene = Scene::new(name);
    let shapes = vec![Shape::new(Geometry::Mesh(Arc::new(mesh)), MaterialId(0))];
    let object = scene.add_object(Object { name: String::new(), shapes });
    scene.add_instance(object, Transform::IDENTITY, 0);
    scene
}

/// A bumpy sphere seen from inside, 262,144 triangles.
fn bumps() -> Scene {
    let (rows, columns) = (256_u32, 512_u32);
    let mut mesh = Mesh::default();
    for row in 0..=rows {
        for column in 0..columns {
            let theta = std::f32::consts::PI * (row as f32 / rows as f32);
            let phi = std::f32::consts::TAU * (column as f32 / columns as f32);
            let radius = 2.0
                + 0.5 * (theta * 20.0).sin() * (phi * 14.0).sin()
                + 0.02 * hash(row * columns + column);
            let d = Vec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            mesh.positions.push(d * radius);
        }
    }
    for (row, column) in (0..rows).flat_map(|r| (0..columns).map(move |c| (r, c))) {
        let next = (column + 1) % columns;
        let [a, b] = [row * columns + column, row * columns + next];
        mesh.triangles.extend([[a, a + columns, b], [b, a + columns, b + columns]]);
    }
    scene_of("bumps", mesh)
}

/// A closed room with two boxes, 36 triangles.
fn boxes() -> Scene {
    let mut mesh = Mesh::default();
    for (low, high) in [(-2.0, 2.0), (-1.2, -0.4), (0.5, 1.1)] {
        let base = mesh.positions.len() as u32;
        for i in 0..8 {
            let pick = |bit: u32| if i >> bit & 1 == 0 { low } else { high };
            mesh.positions
                .push(Vec3::new(pick(0), pick(1), pick(2)) + Vec3::new(0.0, 0.0, 0.01 * low));
        }
        for face in
            [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
        {
            let [a, b, c, d] = face.map(|i: u32| base + i);
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mut scene = scene_of("boxes", mesh);
    scene.camera.to_world =
        Transform::Fixed(glam::Affine3A::from_translation(Vec3::new(0.1, 0.2, -1.9)));
    scene
}

/// Primary, bounce and shadow rays.
fn rays(scene: &Scene, accel: &Accel) -> [Vec<Ray>; 3] {
    let (mut primary, mut bounce, mut shadow) = (vec![], vec![], vec![]);
    let mut origins = vec![];
    let camera_rays = scene.camera.rays([SIZE; 2]);
    for y in 0..SIZE {
        for x in 0..SIZE {
            let n = y * SIZE + x;
            let position = Vec2::new(x as f32 + hash(2 * n), y as f32 + hash(2 * n + 1));
            let camera = camera_rays.ray(position);
            let ray =
                Ray { origin: camera.origin, direction: camera.direction, t_max: f32::INFINITY };
            primary.push(ray);
            let Some(hit) = accel.closest_hit(&ray, &AcceptAll) else { continue };
            let p = accel.point(&hit);
            let side = p.geometric_normal * -p.geometric_normal.dot(ray.direction).signum();
            let origin = offset_origin(p.position, side, p.error);
            let (z, phi) = (2.0 * hash(n ^ 0x5555) - 1.0, std::f32::consts::TAU * hash(n ^ 0xaaaa));
            let r = (1.0 - z * z).sqrt();
            let direction = side + Vec3::new(r * phi.cos(), r * phi.sin(), z) * 0.999;
            bounce.push(Ray { origin, direction, t_max: f32::INFINITY });
            origins.push(origin);
        }
    }
    for (i, &origin) in origins.iter().enumerate() {
        let other = origins[(hash(i as u32 + 77) * origins.len() as f32) as usize];
        if other != origin {
            shadow.push(Ray { origin, direction: other - origin, t_max: 1.0 });
        }
    }
    [primary, bounce, shadow]
}

fn triangles(scene: &Scene) -> Vec<Triangle> {
    let mut all = vec![];
    for instance in &scene.instances {
        let to_world = instance.to_world.fixed();
        for shape in &scene.objects[instance.object.index()].shapes {
            if let Geometry::Mesh(mesh) = &shape.geometry {
                all.extend(mesh.triangles.iter().map(|t| {
                    let [v0, v1, v2] =
                        t.map(|i| to_world.transform_point3(mesh.positions[i as usize]).into());
                    Triangle { v0, v1, v2 }
                }));
            }
        }
    }
    all
}

fn traversal(criterion: &mut Criterion) {
    let mut scenes = vec![boxes(), bumps()];
    let file = Path::new("../shared/scenes/veach-ajar/scene.pbrt");
    #[cfg(feature = "load")]
    if file.exists() {
        let loaded = afterimage::scene::load::load(file).expect("the scene loads");
        scenes.push(loaded.scene.at(0.0));
    }
    if !file.exists() {
        eprintln!("{} is not there, left out", file.display());
    }
    let ours = [
        ("cwbvh", BuildOptions::default()),
        ("cwbvh plain", BuildOptions { portable: true, ..BuildOptions::default() }),
        ("bvh2", BuildOptions { layout: Layout::Bvh2, ..BuildOptions::default() }),
    ];
    for scene in &scenes {
        let accels = ours.map(|(name, options)| {
            (name, Accel::build(scene, &options).expect("the scene is valid"))
        });
        eprintln!("{}: {:?}", scene.name, accels[0].1.report());
        let sets = rays(scene, &accels[0].1);
        let stock = triangles(scene);
        let params = obvhs::BvhBuildParams::medium_build();
        let tree = obvhs::cwbvh::builder::build_cwbvh(&stock, params, &mut Default::default());
        // In leaf order, as ours are.
        let leaves: Vec<Triangle> =
            tree.primitive_indices.iter().map(|&i| stock[i as usize]).collect();
        for (kind, set) in ["primary", "bounce", "shadow"].into_iter().zip(&sets) {
            let mut group = criterion.benchmark_group(format!("{}/{kind}", scene.name));
            group.throughput(Throughput::Elements(set.len() as u64));
            for (name, accel) in &accels {
                group.bench_function(*name, |b| {
                    b.iter(|| match kind {
                        "shadow" => {
                            set.iter().filter(|r| accel.occluded(black_box(r), &AcceptAll)).count()
                        }
                        _ => set
                            .iter()
                            .filter(|r| accel.closest_hit(black_box(r), &AcceptAll).is_some())
                            .count(),
                    });
                });
            }
            group.bench_function("obvhs", |b| {
                b.iter(|| {
                    set.iter()
                        .filter(|r| {
                            let r = black_box(r);
                            let ray = obvhs::ray::Ray::new(
                                r.origin.into(),
                                r.direction.into(),
                                0.0,
                                r.t_max,
                            );
                            if kind == "shadow" {
                                !tree.ray_traverse_miss(ray, |ray, i| leaves[i].intersect(ray))
                            } else {
                                let mut hit = obvhs::ray::RayHit::none();
                                tree.ray_traverse(ray, &mut hit, |ray, i| leaves[i].intersect(ray))
                            }
                        })
                        .count()
                });
            });
            group.finish();
        }
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .sample_size(10)
        .warm_up_time(std::time::Duration::from_millis(200))
        .measurement_time(std::time::Duration::from_millis(600))
        .without_plots();
    targets = traversal
}
criterion_main!(benches);
