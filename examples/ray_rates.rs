//! Rays a second of one thread on a scene file, by kind and layout; with a second argument the
//! triangles and rays go to a file, for another tracer to answer (`ray_rates_embree.py` beside this
//! file does it with Embree).
//!
//! `cargo run --release --example ray_rates -- scenes/cornell.pbrt [rays.bin]`
//!
//! Primary rays of a 512² picture, cosine-distributed bounces from their hits, shadow rays to
//! uniform points of the lights. Best of five. Only triangles are written; a scene with other
//! shapes has no file.

use std::fs::File;
use std::hint::black_box;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::time::Instant;

use afterimage::accel::{Accel, AcceptAll, BuildOptions, Layout, Ray};
use afterimage::light::LightPoint;
use afterimage::math::rng::{RandomSource, Stream};
use afterimage::math::warp;
use afterimage::path::shadow_ray;
use afterimage::scene::{Geometry, Scene, load};
use afterimage::world::World;
use glam::Vec2;

const SIDE: u32 = 512;
const REPEATS: usize = 5;
const KINDS: [&str; 3] = ["primary", "bounce", "shadow"];

type Failure = Box<dyn std::error::Error>;

fn main() -> Result<(), Failure> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let Some(scene) = arguments.first() else {
        return Err("give a scene file: ray_rates SCENE [FILE]".into());
    };
    let scene = load::load(Path::new(scene))?.scene.at(0.0);
    let world = World::new(scene, &BuildOptions::default())?;
    let rays = rays(&world);
    println!("million rays a second of one thread");
    for layout in [Layout::Cwbvh, Layout::Bvh2] {
        let accel =
            Accel::build(&world.scene, &BuildOptions { layout, ..BuildOptions::default() })?;
        for (kind, rays) in KINDS.iter().zip(&rays) {
            let best = (0..REPEATS).map(|_| seconds(&accel, rays, *kind == "shadow"));
            let best = best.fold(f64::INFINITY, f64::min);
            println!("{layout:?} {kind} {:.1}", rays.len() as f64 / best * 1e-6);
        }
    }
    if let Some(file) = arguments.get(1) {
        write(Path::new(file), &world.scene, &rays)?;
    }
    Ok(())
}

fn seconds(accel: &Accel, rays: &[Ray], any: bool) -> f64 {
    let begin = Instant::now();
    let mut hits = 0_usize;
    for ray in rays {
        hits += usize::from(if any {
            accel.occluded(ray, &AcceptAll)
        } else {
            accel.closest_hit(ray, &AcceptAll).is_some()
        });
    }
    black_box(hits);
    begin.elapsed().as_secs_f64()
}

/// By kind, in the order of [`KINDS`].
fn rays(world: &World) -> [Vec<Ray>; 3] {
    let mut random = Stream::from_key(1);
    let mut found = [const { Vec::new() }; 3];
    let camera = world.scene.camera.rays([SIDE; 2]);
    for pixel in 0..SIDE * SIDE {
        let at = Vec2::new((pixel % SIDE) as f32 + 0.5, (pixel / SIDE) as f32 + 0.5);
        let ray = camera.ray(at);
        let ray = Ray { origin: ray.origin, direction: ray.direction, t_max: f32::INFINITY };
        found[0].push(ray);
        let Some(hit) = world.closest_hit(&ray) else { continue };
        let surface = world.surface(&hit);
        let mut wi = warp::sample_cosine_hemisphere(Vec2::new(random.uniform(), random.uniform()));
        wi.z *= -surface.frame.normal.dot(ray.direction).signum();
        let direction = surface.frame.to_world(wi);
        let origin = surface.origin(direction);
        found[1].push(Ray { origin, direction, t_max: f32::INFINITY });
        if !world.lights.is_empty() {
            let light = world.lights.choose(random.word(), random.word());
            let point = LightPoint { light, uv: Vec2::new(random.uniform(), random.uniform()) };
            let Some(emitter) = world.lights.emitter(&world.scene, point) else { continue };
            let Some(arrival) = emitter.towards(&world.lights, surface.position) else { continue };
            let end = world.lights.shadow_end(&emitter, surface.position);
            found[2].push(shadow_ray(&surface, arrival.direction, end));
        }
    }
    found
}

/// Little-endian: numbers of triangles and of the three kinds of rays (u32), corners (9 × f32 a
/// triangle), then origin, direction and length of every ray (7 × f32).
fn write(path: &Path, scene: &Scene, rays: &[Vec<Ray>; 3]) -> Result<(), Failure> {
    let mut corners: Vec<[f32; 3]> = Vec::new();
    for instance in &scene.instances {
        let to_world = instance.to_world.fixed();
        for shape in &scene.objects[instance.object.index()].shapes {
            let Geometry::Mesh(mesh) = &shape.geometry else {
                return Err("the scene has spheres or disks; only triangles can be written".into());
            };
            let place = |i: u32| to_world.transform_point3(mesh.positions[i as usize]).to_array();
            corners.extend(mesh.triangles.iter().flat_map(|t| t.map(place)));
        }
    }
    let write = || -> std::io::Result<()> {
        let mut out = BufWriter::new(File::create(path)?);
        let counts = [corners.len() / 3, rays[0].len(), rays[1].len(), rays[2].len()];
        for count in counts {
            out.write_all(&(count as u32).to_le_bytes())?;
        }
        for value in corners.as_flattened() {
            out.write_all(&value.to_le_bytes())?;
        }
        for ray in rays.iter().flatten() {
            let values = [ray.origin.to_array(), ray.direction.to_array()];
            for value in values.as_flattened().iter().chain([&ray.t_max]) {
                out.write_all(&value.to_le_bytes())?;
            }
        }
        out.flush()
    };
    write().map_err(|e| format!("{}: {e}", path.display()).into())
}
