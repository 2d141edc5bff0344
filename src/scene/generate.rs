//! Scenes made in memory.
//!
//! `many-lights:N[:SEED]` is N small coloured emitters of very different size and power among
//! blocks on a floor. Draws of light i depend on the seed and i only. All lights together emit
//! [`TOTAL_POWER`] whatever N is, and cover about the same area, so that pictures for different N
//! look alike while their sampling problem grows.

use std::fmt::Write as _;
use std::sync::Arc;

use glam::{Affine3A, Vec3};

use super::{
    Camera, Color, ConductorColor, Geometry, Material, MaterialId, Mesh, Object, Roughness, Scene,
    Shape, Transform,
};
use crate::error::{Error, Result};
use crate::math::luminance;
use crate::math::rng::{RandomSource, Stream, pcg4d};

/// What all lights of `many-lights` emit together: luminance of the power in W.
const TOTAL_POWER: f64 = 900.0;

/// More would need several GB.
const MAX_LIGHTS: u32 = 16_000_000;

/// Powers before scaling span this many decades.
const POWER_DECADES: f32 = 4.0;

/// Radii of lights in scene units for N up to 1,000; beyond they shrink by √(1000 / N).
const RADII: [f32; 2] = [0.008, 0.16];

const EYE: Vec3 = Vec3::new(0.0, 6.0, -15.0);
const TARGET: Vec3 = Vec3::new(0.0, 1.3, 0.0);
const FOV_DEGREES: f32 = 38.0;

/// What each stream is drawn for; part of its key.
const BLOCKS: u32 = 1;
const LIGHTS: u32 = 2;

/// A scene by its specification, such as `many-lights:1000` or `many-lights:1000:7` (seed 7; 1 if
/// left out).
///
/// # Errors
/// An unknown name, or numbers that are none or out of range.
pub fn generate(spec: &str) -> Result<Scene> {
    let (n, seed) = parse(spec)?;
    Ok(many_lights(n, seed))
}

/// The pbrt text of a scene by its specification: what [`generate`] makes, in a file of its own.
///
/// # Errors
/// As [`generate`].
pub fn generate_pbrt(spec: &str) -> Result<String> {
    let (n, seed) = parse(spec)?;
    Ok(to_pbrt(&many_lights(n, seed), n, seed))
}

fn parse(spec: &str) -> Result<(u32, u64)> {
    let allowed =
        format!("allowed: many-lights:N[:SEED], N from 1 to {MAX_LIGHTS}, SEED below 2^64");
    let refuse =
        |what: String| Error::usage(format!("the generated scene `{spec}`: {what}; {allowed}"));
    let mut parts = spec.split(':');
    let name = parts.next().unwrap_or_default();
    if name != "many-lights" {
        return Err(refuse(format!("no generator is called `{name}`")));
    }
    let count =
        parts.next().ok_or_else(|| refuse("the number of lights is missing".to_string()))?;
    let n = count.parse::<u32>().ok().filter(|n| (1..=MAX_LIGHTS).contains(n));
    let n = n.ok_or_else(|| refuse(format!("`{count}` is no number of lights")))?;
    let seed = match parts.next() {
        None => 1,
        Some(seed) => seed.parse().map_err(|_| refuse(format!("`{seed}` is no seed")))?,
    };
    match parts.next() {
        None => Ok((n, seed)),
        Some(more) => Err(refuse(format!("`{more}` is too much"))),
    }
}

/// The scene `many-lights:n:seed`; `n` is raised to 1 and lowered to 16 million.
///
/// All emitters are shapes of one object, the light number i at place i: that is their identity.
/// Three in four are one-sided triangles, the rest spheres. Radii and powers are log-uniform over
/// 1.3 and 4 decades; the powers are then scaled to 900 W (luminance) in total, up to 0.1 % by
/// rounding to the digits that the pbrt file shows. Memory and time grow linearly.
#[must_use]
pub fn many_lights(n: u32, seed: u64) -> Scene {
    let n = n.clamp(1, MAX_LIGHTS);
    let mut scene = Scene::new(format!("many-lights:{n}:{seed}"));
    scene.film = [640, 360];
    scene.depth = 5;
    scene.camera =
        Camera { to_world: Transform::Fixed(look_at(EYE, TARGET)), fov: FOV_DEGREES.to_radians() };
    let boxes = add_blocks(&mut scene, seed);
    add_lights(&mut scene, n, seed, &boxes);
    scene
}

fn look_at(eye: Vec3, target: Vec3) -> Affine3A {
    let forward = (target - eye).normalize();
    let right = Vec3::Y.cross(forward).normalize();
    let up = forward.cross(right);
    Affine3A::from_cols(right.into(), up.into(), forward.into(), eye.into())
}

/// Numbers that depend on the seed, a purpose and an index only.
fn stream(seed: u64, purpose: u32, index: u32) -> Stream {
    let [a, b, ..] = pcg4d([seed as u32, (seed >> 32) as u32, purpose, index]);
    Stream::from_key(u64::from(a) | u64::from(b) << 32)
}

/// Rounded to a multiple of 1 / `steps`: the nearest float to a short decimal, which therefore
/// prints as that decimal.
fn round(value: f32, steps: f32) -> f32 {
    (value * steps).round() / steps
}

/// Rounded to four significant decimal digits.
fn four_digits(value: f32) -> f32 {
    if value <= 0.0 {
        return 0.0;
    }
    let exponent = 3 - f64::from(value).log10().floor() as i32;
    let steps = 10_f64.powi(exponent);
    ((f64::from(value) * steps).round() / steps) as f32
}

/// Floor and blocks; returns the blocks' corners.
fn add_blocks(scene: &mut Scene, seed: u64) -> Vec<[Vec3; 2]> {
    let floor = scene.add_material(Material::Diffuse {
        reflectance: Color::Constant(Vec3::new(0.55, 0.53, 0.5)),
    });
    let paints =
        [Vec3::new(0.7, 0.68, 0.64), Vec3::new(0.6, 0.32, 0.22), Vec3::new(0.25, 0.42, 0.5)];
    let mut materials: Vec<MaterialId> = paints
        .into_iter()
        .map(|paint| scene.add_material(Material::Diffuse { reflectance: Color::Constant(paint) }))
        .collect();
    for (alpha, reflectance) in [(0.1, Vec3::new(0.9, 0.72, 0.45)), (0.3, Vec3::splat(0.75))] {
        materials.push(scene.add_material(Material::Conductor {
            color: ConductorColor::Reflectance(Color::Constant(reflectance)),
            roughness: Roughness::isotropic(alpha),
        }));
    }
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
    let positions = corners.iter().map(|&(x, z)| Vec3::new(40.0 * x, 0.0, 40.0 * z)).collect();
    let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
    scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), floor));

    let mut boxes = Vec::new();
    let mut random = stream(seed, BLOCKS, 0);
    for row in 0..5 {
        for column in 0..7 {
            // Every cell draws the same numbers, whether it holds a block or not.
            let [there, x, z, width, depth, height] = std::array::from_fn(|_| random.uniform());
            let material = materials[random.index(materials.len() as u32) as usize];
            if there > 0.55 {
                continue;
            }
            let center = Vec3::new(
                2.4 * (column as f32 - 3.0) + x - 0.5,
                0.0,
                2.4 * (row as f32 - 1.0) + z - 0.5,
            );
            let half = Vec3::new(0.3 + 0.45 * width, 0.0, 0.3 + 0.45 * depth);
            let height = 0.3 + 2.4 * height * height;
            let low = (center - half).map(|v| round(v, 1000.0));
            // Blocks reach below the floor, so that no two faces coincide.
            let high = (center + half + height * Vec3::Y).map(|v| round(v, 1000.0));
            let low = low.with_y(-0.1);
            boxes.push([low, high]);
            scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(block(low, high))), material));
        }
    }
    boxes
}

/// The corner number i is `high` along the axes whose bit is set in i; all faces look outward.
fn block(low: Vec3, high: Vec3) -> Mesh {
    let positions = (0..8_u32)
        .map(|i| {
            let pick = |bit: u32, a: f32, b: f32| if i >> bit & 1 == 0 { a } else { b };
            Vec3::new(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z))
        })
        .collect();
    let triangles = vec![
        [0, 2, 3],
        [0, 3, 1],
        [4, 5, 7],
        [4, 7, 6],
        [0, 4, 6],
        [0, 6, 2],
        [1, 3, 7],
        [1, 7, 5],
        [0, 1, 5],
        [0, 5, 4],
        [2, 6, 7],
        [2, 7, 3],
    ];
    Mesh { positions, triangles, ..Mesh::default() }
}

fn add_lights(scene: &mut Scene, n: u32, seed: u64, boxes: &[[Vec3; 2]]) {
    let black = scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) });
    let shrink = (1000.0 / n as f32).sqrt().min(1.0);
    let steps = if shrink < 0.3 { 100_000.0 } else { 10_000.0 };
    let mut shapes = Vec::with_capacity(n as usize);
    let mut powers = Vec::with_capacity(n as usize);
    let mut total = 0.0_f64;
    for i in 0..n {
        let mut random = stream(seed, LIGHTS, i);
        let kind = random.index(4);
        let radius = shrink * RADII[0] * (RADII[1] / RADII[0]).powf(random.uniform());
        let power = 10_f32.powf(POWER_DECADES * (random.uniform() - 0.5));
        let color = color(random.uniform(), 0.85 * random.uniform());
        // Facing: more down than up.
        let z = 2.0 * random.uniform() - 1.0;
        let (sin, cos) = (std::f32::consts::TAU * random.uniform()).sin_cos();
        let flat = (1.0 - z * z).max(0.0).sqrt();
        let normal = (Vec3::new(flat * cos, z, flat * sin) - 0.75 * Vec3::Y).normalize_or(-Vec3::Y);
        let turn = std::f32::consts::TAU * random.uniform();
        let center = free_place(&mut random, radius, boxes);
        let rounded = |v: Vec3| v.map(|x| round(x, steps));
        let (geometry, area) = if kind == 0 {
            let radius = round(radius, steps).max(1.0 / steps);
            let area = 4.0 * std::f32::consts::PI * radius * radius;
            (Geometry::Sphere { center: rounded(center), radius }, area)
        } else {
            let (a, b) = normal.any_orthonormal_pair();
            let corner = |third: f32| {
                let (sin, cos) = (turn + third * std::f32::consts::TAU / 3.0).sin_cos();
                rounded(center + radius * (cos * a + sin * b))
            };
            let positions = vec![corner(0.0), corner(1.0), corner(2.0)];
            let area =
                0.5 * (positions[1] - positions[0]).cross(positions[2] - positions[0]).length();
            let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
            (Geometry::Mesh(Arc::new(mesh)), area)
        };
        shapes.push(Shape::new(geometry, black).emitting(color / area));
        powers.push(power);
        total += f64::from(power);
    }
    for (shape, power) in shapes.iter_mut().zip(powers) {
        let power = (f64::from(power) * TOTAL_POWER / total / std::f64::consts::PI) as f32;
        if let Some(emission) = &mut shape.emission
            && let Color::Constant(radiance) = &mut emission.radiance
        {
            *radiance = (*radiance * power).map(four_digits);
        }
    }
    let lights = scene.add_object(Object { name: "lights".to_string(), shapes });
    scene.add_instance(lights, Transform::IDENTITY, scene.instances.len() as u64);
}

/// A hue in [0, 1) mixed with white, of luminance 1.
fn color(hue: f32, saturation: f32) -> Vec3 {
    let channel = |shift: f32| ((6.0 * (hue + shift).fract() - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    let pure = Vec3::new(channel(0.0), channel(2.0 / 3.0), channel(1.0 / 3.0));
    let mixed = Vec3::ONE.lerp(pure, saturation);
    mixed / luminance(mixed)
}

/// A place between the blocks or above them.
fn free_place(random: &mut Stream, radius: f32, boxes: &[[Vec3; 2]]) -> Vec3 {
    let margin = Vec3::splat(radius + 0.02);
    for _ in 0..16 {
        let [x, y, z] = std::array::from_fn(|_| random.uniform());
        // More of them low, where they light the floor and the blocks from close by.
        let place = Vec3::new(18.0 * x - 9.0, radius + 0.1 + 4.5 * y * y, 12.0 * z - 4.0);
        let inside = |[low, high]: &[Vec3; 2]| {
            (place.cmpgt(*low - margin) & place.cmplt(*high + margin)).all()
        };
        if !boxes.iter().any(inside) {
            return place;
        }
    }
    // Never seen, since blocks fill a small part of the space; all of them end below 3.
    Vec3::new(18.0 * random.uniform() - 9.0, 4.0 + random.uniform(), 12.0 * random.uniform() - 4.0)
}

/// A generated scene as pbrt-v4 text, one line a light. Only what [`many_lights`] uses is written.
fn to_pbrt(scene: &Scene, n: u32, seed: u64) -> String {
    let mut text = format!(
        "# many_lights: {n} coloured emitters of very different size and power above blocks on a floor.\n\
         # Stresses: the choice of one light out of many; most matter nowhere, each matters somewhere.\n\
         # Known: all lights together emit {TOTAL_POWER} W (Rec. 709 luminance); a triangle of area A and radiance L emits pi A L,\n\
         # a sphere of radius r emits 4 pi^2 r^2 L. Powers span {POWER_DECADES} decades, radii from {} to {} (triangles: circumscribed).\n\
         # Made by: afterimage generate many-lights:{n}:{seed}\n\n",
        RADII[0], RADII[1]
    );
    let mut line = |args: std::fmt::Arguments<'_>| {
        // Writing into a String does not fail.
        let _ = text.write_fmt(args);
        text.push('\n');
    };
    line(format_args!(
        "Film \"rgb\" \"integer xresolution\" {} \"integer yresolution\" {}",
        scene.film[0], scene.film[1]
    ));
    line(format_args!("Integrator \"path\" \"integer maxdepth\" {}", scene.depth - 1));
    line(format_args!(
        "LookAt {}  {}  0 1 0",
        numbers(&EYE.to_array()),
        numbers(&TARGET.to_array())
    ));
    line(format_args!("Camera \"perspective\" \"float fov\" {FOV_DEGREES}\n\nWorldBegin\n"));
    for (i, material) in scene.materials.iter().enumerate() {
        let about = match material {
            Material::Diffuse { reflectance: Color::Constant(c) } => {
                format!("\"diffuse\" \"rgb reflectance\" [ {} ]", numbers(&c.to_array()))
            }
            Material::Conductor {
                color: ConductorColor::Reflectance(Color::Constant(c)),
                roughness,
            } => {
                let super::Scalar::Constant(alpha) = roughness.u else { continue };
                format!(
                    "\"conductor\" \"rgb reflectance\" [ {} ] \"float roughness\" {alpha} \"bool remaproughness\" false",
                    numbers(&c.to_array())
                )
            }
            _ => continue,
        };
        line(format_args!("MakeNamedMaterial \"m{i}\" \"string type\" {about}"));
    }
    let mut current = None;
    for shape in scene.instances.iter().flat_map(|i| &scene.objects[i.object.index()].shapes) {
        if current.replace(shape.material) != Some(shape.material) {
            line(format_args!("\nNamedMaterial \"m{}\"", shape.material.0));
        }
        let mut about = String::new();
        if let Some(emission) = &shape.emission
            && let Color::Constant(radiance) = emission.radiance
        {
            about = format!(
                "AttributeBegin AreaLightSource \"diffuse\" \"rgb L\" [ {} ] ",
                numbers(&radiance.to_array())
            );
        }
        match &shape.geometry {
            Geometry::Mesh(mesh) => {
                let points: Vec<f32> = mesh.positions.iter().flat_map(|p| p.to_array()).collect();
                let corners: Vec<String> =
                    mesh.triangles.iter().flatten().map(u32::to_string).collect();
                let _ = write!(
                    about,
                    "Shape \"trianglemesh\" \"point3 P\" [ {} ] \"integer indices\" [ {} ]",
                    numbers(&points),
                    corners.join(" ")
                );
            }
            Geometry::Sphere { center, radius } => {
                let _ = write!(
                    about,
                    "Translate {} Shape \"sphere\" \"float radius\" {radius}",
                    numbers(&center.to_array())
                );
            }
            Geometry::Disk { .. } => continue,
        }
        if shape.emission.is_some() {
            about.push_str(" AttributeEnd");
        }
        line(format_args!("{about}"));
    }
    text
}

fn numbers(values: &[f32]) -> String {
    // Adding 0 turns -0 into 0.
    let words: Vec<String> = values.iter().map(|v| (v + 0.0).to_string()).collect();
    words.join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lights(scene: &Scene) -> &[Shape] {
        &scene.objects.last().unwrap().shapes
    }

    fn power(shape: &Shape) -> f64 {
        let Color::Constant(radiance) = shape.emission.unwrap().radiance else { panic!() };
        let area = match &shape.geometry {
            Geometry::Sphere { radius, .. } => 4.0 * std::f32::consts::PI * radius * radius,
            Geometry::Mesh(mesh) => {
                let p = &mesh.positions;
                0.5 * (p[1] - p[0]).cross(p[2] - p[0]).length()
            }
            Geometry::Disk { .. } => panic!(),
        };
        std::f64::consts::PI * f64::from(area) * f64::from(luminance(radiance))
    }

    #[test]
    fn total_power_does_not_depend_on_the_number() {
        for n in [1, 10, 1000, 30_000] {
            let scene = many_lights(n, 1);
            assert_eq!(lights(&scene).len(), n as usize);
            let powers: Vec<f64> = lights(&scene).iter().map(power).collect();
            let total: f64 = powers.iter().sum();
            assert!((total / TOTAL_POWER - 1.0).abs() < 1e-3, "{n}: {total}");
            if n >= 1000 {
                let (low, high) =
                    powers.iter().fold((f64::MAX, 0.0_f64), |(a, b), &p| (a.min(p), b.max(p)));
                assert!(high / low > 3e3, "{n}: {low} to {high}");
            }
        }
    }

    #[test]
    fn the_same_specification_gives_the_same_scene() {
        let text = |spec| generate_pbrt(spec).unwrap();
        assert_eq!(text("many-lights:50"), text("many-lights:50:1"));
        assert_ne!(text("many-lights:50:2"), text("many-lights:50:1"));
        // 6 lines of comment, 5 of camera, 6 materials, 50 lights and some blocks.
        assert!(
            text("many-lights:50").lines().filter(|l| l.contains("AreaLightSource")).count() == 50
        );
    }

    #[test]
    fn every_number_gives_a_valid_scene() {
        for n in [1, 999, 20_000] {
            many_lights(n, 9).validate().unwrap();
        }
    }

    #[cfg(feature = "load")]
    #[test]
    fn all_scenes_of_the_repository_load() {
        use crate::scene::load::load;
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let read = |name: &str| {
            let loaded =
                load(&folder.join(name).with_extension("pbrt")).unwrap_or_else(|e| panic!("{e}"));
            assert!(loaded.warnings.is_empty(), "{name}: {:?}", loaded.warnings);
            loaded.scene
        };
        for (name, emitters) in [
            ("cornell", 1),
            ("furnace", 1),
            ("penumbra", 1),
            ("plates", 4),
            ("slit", 1),
            ("glass", 1),
            ("moving", 2),
        ] {
            let scene = read(name);
            let found =
                scene.objects.iter().flat_map(|o| &o.shapes).filter(|s| s.emission.is_some());
            assert_eq!(found.count(), emitters, "{name}");
            assert_eq!(scene.moves(), name == "moving", "{name}");
        }
        assert_eq!(read("moving").time, [0.0, 1.0]);
        // The file holds the generated scene: the same camera, film, depth and lights.
        let (file, made) = (read("many_lights"), many_lights(1000, 1));
        assert_eq!((file.film, file.depth), (made.film, made.depth));
        let difference = file.camera.to_world.fixed().inverse() * made.camera.to_world.fixed();
        assert!(difference.abs_diff_eq(Affine3A::IDENTITY, 1e-5), "{difference}");
        let of_file: Vec<&Shape> =
            file.objects.iter().flat_map(|o| &o.shapes).filter(|s| s.emission.is_some()).collect();
        assert_eq!(of_file.len(), 1000);
        for (a, b) in of_file.into_iter().zip(lights(&made)) {
            let (a, b) = (a.emission.unwrap(), b.emission.unwrap());
            let (Color::Constant(x), Color::Constant(y)) = (a.radiance, b.radiance) else {
                panic!()
            };
            assert!((x * a.scale).abs_diff_eq(y, 1e-6 * y.max_element()), "{x} {y}");
        }
    }

    #[test]
    fn positions_print_short() {
        let text = generate_pbrt("many-lights:1000:3").unwrap();
        let longest = text.lines().filter(|l| l.contains("AreaLight")).map(str::len).max().unwrap();
        assert!(longest < 240, "{longest}");
    }

    #[test]
    fn nothing_is_degenerate_at_a_hundred_thousand() {
        let scene = many_lights(100_000, 5);
        for shape in lights(&scene) {
            let power = power(shape);
            assert!(power.is_finite() && power > 0.0, "{shape:?}");
            match &shape.geometry {
                Geometry::Mesh(mesh) => assert!(mesh.positions.iter().all(|p| p.y > 0.0)),
                Geometry::Sphere { center, radius } => assert!(center.y > *radius),
                Geometry::Disk { .. } => panic!(),
            }
        }
    }

    #[test]
    fn blocks_face_outward() {
        let mesh = block(Vec3::ZERO, Vec3::new(1.0, 2.0, 3.0));
        let center = Vec3::new(0.5, 1.0, 1.5);
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            assert!((b - a).cross(c - a).dot(a - center) > 0.0, "{t:?}");
        }
    }

    #[test]
    fn wrong_specifications_say_what_is_allowed() {
        for (spec, found) in [
            ("many-light:10", "no generator is called `many-light`"),
            ("many-lights", "the number of lights is missing"),
            ("many-lights:0", "`0` is no number of lights"),
            ("many-lights:x", "`x` is no number of lights"),
            ("many-lights:5:-1", "`-1` is no seed"),
            ("many-lights:5:1:2", "`2` is too much"),
        ] {
            let error = generate(spec).unwrap_err();
            assert!(error.is_usage());
            let text = error.to_string();
            assert!(
                text.starts_with(&format!(
                    "the generated scene `{spec}`: {found}; allowed: many-lights:N[:SEED]"
                )),
                "{text}"
            );
        }
    }

    /// Writes the scene of the repository anew:
    /// `cargo test --release --lib write_many_lights -- --ignored`.
    #[test]
    #[ignore = "writes scenes/many_lights.pbrt"]
    fn write_many_lights() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/many_lights.pbrt");
        std::fs::write(path, generate_pbrt("many-lights:1000:1").unwrap()).unwrap();
    }

    #[test]
    fn the_file_in_scenes_is_the_generated_one() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/scenes/many_lights.pbrt");
        let file = std::fs::read_to_string(path).unwrap();
        assert!(file == generate_pbrt("many-lights:1000:1").unwrap(), "{path} is stale");
    }
}
