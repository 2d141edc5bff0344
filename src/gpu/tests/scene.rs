//! Functions of a scene: rays, textures, materials, lights, environments. The scene has every kind
//! of each.

use std::sync::Arc;

use glam::{Affine2, Affine3A, Quat, Vec2, Vec3, Vec4};

use super::{N, bits, close, device, float, run, run_changed, unit};
use crate::accel::{Hit, Ray};
use crate::light::LightPoint;
use crate::math::rng::{RandomSource, Stream};
use crate::math::warp;
use crate::scene::{
    Channel, Color, ConductorColor, Emission, EnvironmentMapping, Geometry, Image, ImageData,
    Light, LightKind, Material, MaterialId, Mesh, Roughness, Scalar, Scene, Shape, SpotFalloff,
    Texture, TextureKind, Transform, Wrap,
};
use crate::surface::material::evaluate_material;
use crate::world::World;

fn image(width: u32, height: u32, data: ImageData) -> Image {
    Image { width, height, data }
}

/// One of each.
///
/// Coverage between 0 and 1 is a coin that hashes the ray's bits, so backends, whose last bits
/// differ, throw different ones: `coins` has one such surface.
fn scene(coins: bool) -> Scene {
    let mut random = Stream::from_key(77);
    let mut scene = Scene::new("one of each");
    let mut bytes = |n: u32| (0..n).map(|_| random.word().to_le_bytes()).collect::<Vec<_>>();
    let srgb = scene.add_image(image(5, 7, ImageData::Srgb8(bytes(35))));
    let linear = scene.add_image(image(4, 3, ImageData::Linear8(bytes(12))));
    let floats = (0..64).map(|i| [0.1 + (i % 7) as f32, 0.5, 0.02 * i as f32, 1.0]).collect();
    let sky = scene.add_image(image(8, 8, ImageData::Float(floats)));
    for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Black, Wrap::Mirror] {
        scene.add_texture(Texture {
            kind: TextureKind::Image { image: srgb, wrap, scale: 0.9, invert: wrap == Wrap::Clamp },
            mapping: Affine2::from_angle_translation(0.3, Vec2::new(0.1, -0.4)),
        });
    }
    let data = scene.add_texture(Texture::image(linear));
    let constant = scene.add_texture(Texture {
        kind: TextureKind::Constant(Vec4::new(0.4, 0.5, 0.6, 0.7)),
        mapping: Affine2::IDENTITY,
    });
    let checks = scene.add_texture(Texture {
        kind: TextureKind::Checkerboard {
            first: Color::Texture(data),
            second: Color::Constant(Vec3::new(0.2, 0.3, 0.8)),
        },
        mapping: Affine2::from_scale(Vec2::new(5.1, 2.9)),
    });
    let product = scene.add_texture(Texture {
        kind: TextureKind::Product { first: checks, second: constant },
        mapping: Affine2::IDENTITY,
    });
    let mask = scene.add_texture(Texture {
        kind: TextureKind::Threshold {
            value: Scalar::Texture(product, Channel::Mean),
            cutoff: 0.2,
        },
        mapping: Affine2::IDENTITY,
    });
    let color = Color::Texture(product);
    let grey = Color::Constant(Vec3::new(0.7, 0.5, 0.3));
    let textured = Scalar::Texture(data, Channel::Green);
    let rough =
        |u: f32, v: f32| Roughness { u: Scalar::Constant(u), v: Scalar::Constant(v), remap: false };
    let materials = [
        Material::Diffuse { reflectance: grey },
        Material::Diffuse { reflectance: color },
        Material::Diffuse { reflectance: Color::Constant(Vec3::ZERO) },
        Material::DiffuseTransmission {
            reflectance: grey,
            transmittance: Color::Constant(Vec3::splat(0.2)),
        },
        Material::Conductor {
            color: ConductorColor::Complex {
                eta: Color::Constant(Vec3::new(0.2, 0.9, 1.4)),
                k: Color::Constant(Vec3::new(3.9, 2.4, 1.6)),
            },
            roughness: rough(0.3, 0.1),
        },
        Material::Conductor {
            color: ConductorColor::Reflectance(grey),
            roughness: Roughness::SMOOTH,
        },
        Material::Dielectric { eta: 1.5, roughness: rough(0.2, 0.2) },
        Material::Dielectric { eta: 1.5, roughness: Roughness::SMOOTH },
        Material::Dielectric { eta: 0.7, roughness: Roughness { remap: true, ..rough(0.1, 0.3) } },
        Material::ThinDielectric { eta: 1.4 },
        Material::CoatedDiffuse { reflectance: color, eta: 1.5, roughness: rough(0.15, 0.15) },
        Material::CoatedDiffuse { reflectance: grey, eta: 1.33, roughness: Roughness::SMOOTH },
        Material::CoatedDiffuse { reflectance: grey, eta: 1.4, roughness: rough(0.0, 0.5) },
        Material::CoatedDiffuse {
            reflectance: grey,
            eta: 1.7,
            roughness: Roughness { u: textured, v: textured, remap: false },
        },
        Material::MetallicRoughness {
            base_color: grey,
            metallic: Scalar::Constant(0.4),
            roughness: Scalar::Constant(0.5),
            ior: 1.5,
            specular: Scalar::Constant(0.8),
            specular_color: Color::Constant(Vec3::new(0.9, 1.0, 0.7)),
            transmission: Scalar::Constant(0.3),
            double_sided: true,
        },
        Material::MetallicRoughness {
            base_color: color,
            metallic: textured,
            roughness: Scalar::Constant(0.0),
            ior: 1.4,
            specular: Scalar::Constant(1.0),
            specular_color: Color::Constant(Vec3::ONE),
            transmission: Scalar::Constant(0.5),
            double_sided: false,
        },
        Material::Mix { first: MaterialId(0), second: MaterialId(4), amount: textured },
        Material::Mix {
            first: MaterialId(6),
            second: MaterialId(10),
            amount: Scalar::Constant(0.3),
        },
        Material::Mix {
            first: MaterialId(2),
            second: MaterialId(5),
            amount: Scalar::Constant(0.6),
        },
    ];
    for material in materials {
        scene.add_material(material);
    }
    let mut corners = Vec::new();
    let mut normals = Vec::new();
    let mut uvs = Vec::new();
    let mut triangles = Vec::new();
    let mut stream = Stream::from_key(9);
    let mut point = |scale: f32| {
        scale * Vec3::new(stream.uniform() - 0.5, stream.uniform() - 0.5, stream.uniform() - 0.5)
    };
    for i in 0..60_u32 {
        let at = point(6.0);
        let p = [at, at + point(2.0), at + point(2.0)];
        let n = (p[1] - p[0]).cross(p[2] - p[0]).normalize();
        for corner in p {
            uvs.push(Vec2::new(corner.x, corner.y));
            normals.push((n + 0.4 * point(1.0)).normalize());
            corners.push(corner);
        }
        triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
    }
    let mesh = Mesh { positions: corners, normals, uvs, triangles };
    scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), MaterialId(10)));
    let lamp = |radiance: Color, two_sided: bool| Emission { radiance, scale: 2.5, two_sided };
    let shapes = [
        (
            Geometry::Sphere { center: Vec3::new(2.0, 1.0, 0.0), radius: 0.6 },
            lamp(grey, false),
            None,
        ),
        (
            Geometry::Sphere { center: Vec3::new(-2.0, 0.5, 1.0), radius: 0.4 },
            lamp(color, true),
            None,
        ),
        (
            Geometry::Sphere { center: Vec3::new(0.0, -2.0, 1.0), radius: 0.7 },
            lamp(grey, true),
            Some(Scalar::Texture(mask, Channel::Red)),
        ),
        (
            Geometry::Disk {
                center: Vec3::new(0.0, 2.0, 0.0),
                normal: Vec3::new(0.2, -1.0, 0.1).normalize(),
                radius: 0.8,
            },
            lamp(color, false),
            coins.then_some(Scalar::Constant(0.6)),
        ),
        (
            Geometry::Mesh(Arc::new(Mesh {
                positions: vec![
                    Vec3::new(-1.0, 3.0, -1.0),
                    Vec3::new(1.0, 3.0, -1.0),
                    Vec3::new(0.0, 3.0, 1.0),
                ],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            })),
            lamp(color, false),
            None,
        ),
    ];
    // What no ray meets, and emits all the same.
    let none = Some(Scalar::Constant(0.0));
    let unmet = [(0, false), (1, true), (3, false), (3, true), (4, true), (4, false)];
    let unmet = unmet
        .map(|(i, two_sided): (usize, bool)| (shapes[i].0.clone(), lamp(grey, two_sided), none));
    for (geometry, emission, alpha) in shapes.into_iter().chain(unmet) {
        let shape =
            Shape { emission: Some(emission), alpha, ..Shape::new(geometry, MaterialId(4)) };
        scene.add_shape(shape);
    }
    // A lookup of each texture, so that every wrap mode and encoding is compared.
    for number in 0..scene.textures.len() as u32 {
        let geometry = Geometry::Disk {
            center: Vec3::new(number as f32 - 4.0, -3.0, 2.0),
            normal: Vec3::Y,
            radius: 0.3,
        };
        let emission = lamp(Color::Texture(crate::scene::TextureId(number)), false);
        let shape = Shape { emission: Some(emission), ..Shape::new(geometry, MaterialId(0)) };
        scene.add_shape(shape);
    }
    let turned =
        Affine3A::from_rotation_translation(Quat::from_rotation_x(0.7), Vec3::new(0.5, 2.0, -1.0));
    let spot = |falloff| LightKind::Spot {
        intensity: Vec3::ONE,
        cos_inner: 0.9,
        cos_outer: -0.5,
        falloff,
    };
    let latitude = (sky, EnvironmentMapping::LatitudeLongitude);
    let octahedral = (sky, EnvironmentMapping::EqualAreaOctahedral);
    for (key, kind) in [
        LightKind::Point { intensity: Vec3::new(1.0, 2.0, 3.0) },
        spot(SpotFalloff::Smoothstep),
        spot(SpotFalloff::Quadratic),
        LightKind::Distant { irradiance: Vec3::ONE },
        LightKind::Environment { radiance: Vec3::splat(0.3), image: None },
        LightKind::Environment { radiance: Vec3::splat(0.2), image: Some(latitude) },
        LightKind::Environment { radiance: Vec3::splat(0.1), image: Some(octahedral) },
    ]
    .into_iter()
    .enumerate()
    {
        scene.lights.push(Light { to_world: Transform::Fixed(turned), kind, key: key as u64 });
    }
    scene
}

fn world(two_level: bool, coins: bool) -> Arc<World> {
    let options = crate::accel::BuildOptions { two_level: Some(two_level), ..Default::default() };
    let mut scene = scene(coins);
    if two_level {
        // Placements that turn, stretch and mirror.
        let object = scene.instances[0].object;
        let stretched = Affine3A::from_scale_rotation_translation(
            Vec3::new(0.5, -1.2, 0.8),
            Quat::from_rotation_y(1.0),
            Vec3::new(3.0, 0.0, 2.0),
        );
        scene.add_instance(object, Transform::Fixed(stretched), 99);
    }
    let world = World::new(scene, &options).unwrap();
    world.prepare_emitters().unwrap();
    Arc::new(world)
}

fn rays() -> (Vec<u32>, Vec<Ray>) {
    let mut random = Stream::from_key(6);
    let mut inputs = Vec::new();
    let mut rays = Vec::new();
    for i in 0..N {
        let mut point = |scale: f32| {
            scale
                * Vec3::new(random.uniform() - 0.5, random.uniform() - 0.5, random.uniform() - 0.5)
        };
        let origin = point(9.0);
        let mut direction = point(6.0) - origin;
        if i % 64 == 1 {
            direction = Vec3::X;
        }
        if i % 64 == 2 {
            direction = Vec3::new(0.0, -1.0, 0.0);
        }
        if i % 64 == 3 {
            direction *= 1e-9;
        }
        let t_max = if i % 3 == 0 { 1.0 } else { f32::INFINITY };
        rays.push(Ray { origin, direction, t_max });
        inputs.extend(bits(&origin.to_array()));
        inputs.extend(bits(&direction.to_array()));
        inputs.push(t_max.min(3.0e38).to_bits());
    }
    (inputs, rays)
}

/// Camera rays pass the backs of one-sided surfaces.
#[test]
fn camera_rays_agree() {
    let Some(gpu) = device() else { return };
    let (inputs, rays) = rays();
    let body = "
    fn test(i: u32) {
        let ray = Ray(input_vector(i, 0u), input_vector(i, 3u), input_float(i, 6u));
        let hit = camera_hit(NOW, ray);
        output(i, 0u, hit.primitive); output(i, 1u, hit.instance); output_float(i, 2u, hit.t);
    }";
    let mut scene = scene(false);
    assert!(!World::new(scene.clone(), &Default::default()).unwrap().has_one_sided);
    // The mesh of many triangles becomes one-sided.
    Arc::make_mut(&mut scene.objects[0]).shapes[0].material = MaterialId(15);
    let world = Arc::new(World::new(scene, &Default::default()).unwrap());
    assert!(world.has_one_sided);
    world.prepare_emitters().unwrap();
    let found = run(&gpu, &world, body, (&inputs, 7), 3);
    let (mut flips, mut passed, mut met) = (0, 0, 0);
    for (ray, f) in rays.iter().zip(found.chunks(3)) {
        let (any, seen) = (world.closest_hit(ray), world.camera_hit(ray));
        met += u32::from(any.is_some());
        passed += u32::from(any != seen);
        let there = seen.map_or((u32::MAX, u32::MAX), |h| (h.primitive, h.instance));
        flips += u32::from(there != (f[0], f[1]));
    }
    println!("of {met} rays {passed} pass a back, {flips} differ");
    assert!(passed > met / 8 && passed < met, "{passed} of {met}");
    assert!(flips <= 3, "{flips} rays of {} meet something else", rays.len());
}

/// Rays meet the same primitives, but for those that graze an edge or whose end lies within
/// rounding of a surface; what is there agrees.
#[test]
fn hits_and_what_is_there_agree() {
    let Some(gpu) = device() else { return };
    let (inputs, rays) = rays();
    let body = "
    fn test(i: u32) {
        let ray = Ray(input_vector(i, 0u), input_vector(i, 3u), input_float(i, 6u));
        let hit = closest_hit(NOW, ray);
        output_float(i, 0u, hit.t); output_float(i, 1u, hit.u); output_float(i, 2u, hit.v);
        output(i, 3u, hit.primitive); output(i, 4u, hit.instance);
        output(i, 5u, select(0u, 1u, occluded(NOW, ray)));
        if hit.primitive != MISS {
            let point = point_at(NOW, hit);
            output_vector(i, 6u, point.position); output_vector(i, 9u, point.error);
            output_vector(i, 12u, point.geometric_normal); output_vector(i, 15u, point.shading_normal);
            output_float(i, 18u, point.uv.x); output_float(i, 19u, point.uv.y);
            output(i, 20u, point.shape); output(i, 21u, point.element);
            let s = shape_of(NOW, hit);
            output(i, 22u, s.x); output(i, 23u, s.y);
            output_vector(i, 24u, tangent_at(NOW, hit, point.geometric_normal));
            output_vector(i, 27u, surface_origin(surface_at(NOW, hit, point), ray.direction));
        }
    }";
    for two_level in [false, true] {
        let world = world(two_level, false);
        let found = run(&gpu, &world, body, (&inputs, 7), 30);
        let (mut flips, mut hits, mut ends) = (0, 0, 0);
        for (i, (ray, f)) in rays.iter().zip(found.chunks(30)).enumerate() {
            let hit = world.closest_hit(ray);
            let same =
                hit.map_or((u32::MAX, u32::MAX), |h| (h.primitive, h.instance)) == (f[3], f[4]);
            let occluded = world.accel.occluded(ray, &world.alpha_mask());
            ends += u32::from(u32::from(occluded) != f[5]);
            if !same {
                flips += 1;
                continue;
            }
            let Some(hit) = hit else { continue };
            hits += 1;
            let scale = hit.t * ray.direction.length();
            close(&format!("t {i}"), float(f[0]), hit.t, 2e-4, 1e-3 / ray.direction.length());
            let there = Hit {
                t: float(f[0]),
                u: float(f[1]),
                v: float(f[2]),
                primitive: f[3],
                instance: f[4],
            };
            let point = world.accel.point(&there);
            let check = |what: &str, at: usize, wanted: Vec3, relative: f32| {
                let size = wanted.abs().max_element();
                for (k, w) in wanted.to_array().into_iter().enumerate() {
                    close(
                        &format!("{what} {i} of {scale}"),
                        float(f[at + k]),
                        w,
                        relative,
                        size.max(1e-3),
                    );
                }
            };
            check("position", 6, point.position, 2e-6);
            // The device's own bound holds here, too.
            let error = Vec3::new(float(f[9]), float(f[10]), float(f[11]));
            let off = (Vec3::new(float(f[6]), float(f[7]), float(f[8])) - point.position).abs();
            assert!(off.cmple(error + point.error).all(), "{i}: {off} against {error}");
            check("normal", 12, point.geometric_normal, 3e-6);
            check("shading normal", 15, point.shading_normal, 2e-5);
            check("uv", 18, point.uv.extend(float(f[20])), 1e-4);
            assert_eq!([f[20], f[21]], [point.shape, point.element]);
            assert_eq!([f[22], f[23]], [point.shape, point.element]);
            check("tangent", 24, world.accel.tangent(&there), 2e-3);
            let origin = Vec3::new(float(f[27]), float(f[28]), float(f[29]));
            let side = ray.direction.dot(point.geometric_normal)
                * (origin - point.position).dot(point.geometric_normal);
            assert!(side > 0.0, "{i}: the origin lies on the other side");
        }
        assert!(hits > N / 4, "{hits} hits");
        assert!(
            flips + ends <= 12,
            "{flips} of {N} rays meet something else, {ends} answers differ"
        );
    }
}

/// Rays that leave a surface never meet it again, and shadow rays between two surfaces meet
/// neither.
#[test]
fn no_ray_meets_the_surface_that_it_leaves() {
    let Some(gpu) = device() else { return };
    // A closed room at several scales, and spheres: every ray that leaves one of its own surfaces
    // hits another wall.
    for power in [-12, 0, 12] {
        let scale = f32::from(power as i16).exp2();
        let mut scene = Scene::new("room");
        let grey =
            scene.add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::ONE) });
        let corner = |i: u32| {
            let sign = |bit: u32| if i & bit == 0 { -1.0 } else { 1.3 };
            scale * (Vec3::new(sign(1), sign(2), sign(4)) + 0.3)
        };
        let positions = (0..8).map(corner).collect();
        let quads =
            [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        let triangles =
            quads.iter().flat_map(|q| [[q[0], q[1], q[2]], [q[0], q[2], q[3]]]).collect();
        let mesh = Mesh { positions, triangles, ..Mesh::default() };
        scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), grey));
        let center = scale * Vec3::new(0.5, 0.2, 0.1);
        scene.add_shape(Shape::new(Geometry::Sphere { center, radius: 0.4 * scale }, grey));
        let world = Arc::new(World::new(scene, &Default::default()).unwrap());
        let mut random = Stream::from_key(8);
        let inputs: Vec<u32> = (0..8 * N).map(|i| unit(&mut random, i).to_bits()).collect();
        let body = format!(
            "fn test(i: u32) {{
            let d = sample_uniform_sphere(vec2f(input_float(i, 0u), input_float(i, 1u)));
            let first = closest_hit(NOW, Ray({scale} * vec3f(0.45, 0.9, 0.3), d, FAR));
            let point = point_at(NOW, first);
            let surface = surface_at(NOW, first, point);
            let local = sample_cosine_hemisphere(vec2f(input_float(i, 2u), input_float(i, 3u)));
            // Half of them nearly along the surface.
            let flat_ = select(local, unit(vec3f(local.xy, 1e-4 * local.z)), (i & 1u) == 0u);
            let side = copysign(1.0, -dot3(d, surface.frame.normal));
            let out = unit(to_world(surface.frame, vec3f(flat_.xy, flat_.z * side)));
            let next = closest_hit(NOW, Ray(surface_origin(surface, out), out, FAR));
            output(i, 0u, first.primitive);
            output(i, 1u, next.primitive);
            output_float(i, 2u, next.t);
            let e = point_at(NOW, next);
            let end = offset_origin(e.position, e.geometric_normal * copysign(1.0, -dot3(out, e.geometric_normal)), e.error);
            let start = surface_origin(surface, out);
            output(i, 3u, select(0u, 1u, occluded(NOW, Ray(start, end - start, 1.0))));
        }}"
        );
        let found = run(&gpu, &world, &body, (&inputs, 8), 4);
        let (mut escaped, mut selfish, mut blocked) = (0, 0, 0);
        for f in found.chunks(4) {
            assert_ne!(f[0], u32::MAX, "the room is closed");
            escaped += usize::from(f[1] == u32::MAX);
            selfish += usize::from(f[0] == f[1]);
            blocked += usize::from(f[3] != 0);
        }
        // In a convex corner a grazing ray may pass between two walls' bounds; from the sphere none
        // comes back.
        assert!(escaped <= N / 1000, "2^{power}: {escaped} of {N} rays left the room");
        assert!(selfish == 0, "2^{power}: {selfish} of {N} rays met the surface that they left");
        assert!(blocked <= N / 1000, "2^{power}: {blocked} of {N} shadow rays met an end");
    }
}

const BSDF: &str = "
fn test(i: u32) {
    let shape = input(i, 0u);
    let bsdf = material_at(words[inputs.worlds[NOW].shapes + shape * SHAPE], vec2f(input_float(i, 1u), input_float(i, 2u)));
    let wo = input_vector(i, 3u);
    let wi = input_vector(i, 6u);
    let e = bsdf_evaluate(bsdf, wo, wi);
    output_vector(i, 0u, e.value); output_float(i, 3u, e.pdf);
    let draw = vec4<u32>(input(i, 9u), input(i, 10u), input(i, 11u), 0u);
    let s = bsdf_sample(bsdf, wo, draw);
    output(i, 4u, select(0u, 1u, s.valid));
    if s.valid {
        output_vector(i, 5u, s.wi); output_vector(i, 8u, s.value);
        output_float(i, 11u, s.pdf); output_float(i, 12u, s.eta);
        output(i, 13u, select(0u, 1u, s.delta) | select(0u, 2u, s.transmission));
    }
    output(i, 14u, select(0u, 1u, bsdf_is_black(bsdf)) | select(0u, 2u, bsdf_has_non_delta(bsdf)));
}";

/// A scene whose shape number i has material number i.
fn sampler() -> Arc<World> {
    let mut scene = scene(true);
    scene.objects.clear();
    scene.instances.clear();
    for material in 0..scene.materials.len() as u32 {
        let center = Vec3::new(3.0 * material as f32, 0.0, 0.0);
        scene.add_shape(Shape::new(Geometry::Sphere { center, radius: 1.0 }, MaterialId(material)));
    }
    Arc::new(World::new(scene, &Default::default()).unwrap())
}

fn bsdf_inputs(materials: u32) -> Vec<u32> {
    let mut random = Stream::from_key(12);
    let mut inputs = Vec::new();
    for i in 0..4 * N {
        let mut direction = |i: usize| {
            let v = warp::sample_uniform_sphere(Vec2::new(unit(&mut random, i), random.uniform()));
            if i.is_multiple_of(97) { Vec3::Z } else { v }
        };
        let (wo, wi) = (direction(i), direction(i / 7 + 1));
        inputs.push(i as u32 % materials);
        inputs.extend(bits(&[random.uniform() * 3.0 - 1.0, random.uniform() * 3.0 - 1.0]));
        inputs.extend(bits(&wo.to_array()));
        inputs.extend(bits(&wi.to_array()));
        inputs.extend([random.word(), random.word(), random.word()]);
    }
    inputs
}

/// Inputs for which evaluations or samples differ.
fn bsdf_differences(world: &World, inputs: &[u32], found: &[u32]) -> Vec<String> {
    let near = |a: f32, b: f32, relative: f32, scale: f32| {
        a == b || (a - b).abs() <= relative * b.abs().max(scale)
    };
    let mut wrong = Vec::new();
    for (i, (v, f)) in inputs.chunks(12).zip(found.chunks(15)).enumerate() {
        let uv = Vec2::new(float(v[1]), float(v[2]));
        let material = world.shapes[v[0] as usize].material;
        let bsdf = evaluate_material(&world.scene, material, uv);
        let at = |k: usize| Vec3::new(float(v[k]), float(v[k + 1]), float(v[k + 2]));
        let (wo, wi) = (at(3), at(6));
        let evaluation = bsdf.evaluate(wo, wi);
        // A microfacet's density at grazing angles magnifies the last bits of the half vector.
        let tolerance = 2e-3;
        for (k, found) in f[..3].iter().enumerate() {
            if !near(float(*found), evaluation.value[k], tolerance, 1e-5) {
                wrong.push(format!(
                    "{i}: material {}, value {} / {}",
                    material.0,
                    float(f[k]),
                    evaluation.value
                ));
            }
        }
        if !near(float(f[3]), evaluation.pdf, tolerance, 1e-5) {
            wrong.push(format!(
                "{i}: material {}, pdf {} / {}",
                material.0,
                float(f[3]),
                evaluation.pdf
            ));
        }
        let flags = u32::from(bsdf.is_black()) | u32::from(bsdf.has_non_delta()) << 1;
        if f[14] != flags {
            wrong.push(format!("{i}: material {}, flags {} / {flags}", material.0, f[14]));
        }
        match bsdf.sample(wo, [v[9], v[10], v[11], 0]) {
            Some(sample) if f[4] == 1 => {
                let there = Vec3::new(float(f[5]), float(f[6]), float(f[7]));
                let kind = u32::from(sample.delta) | u32::from(sample.transmission) << 1;
                // The value where the device's own direction is.
                let same = there.distance(sample.wi) < 1e-3
                    && f[13] == kind
                    && near(float(f[12]), sample.eta, 1e-5, 1.0);
                if !same {
                    wrong.push(format!(
                        "{i}: material {}, sample {there} / {}",
                        material.0, sample.wi
                    ));
                    continue;
                }
                let (value, pdf) = if sample.delta {
                    (sample.value, sample.pdf)
                } else {
                    let e = bsdf.evaluate(wo, there);
                    (e.value, e.pdf)
                };
                for k in 0..3 {
                    if !near(float(f[8 + k]), value[k], 1e-2, 1e-4) {
                        wrong.push(format!(
                            "{i}: material {}, sample's value {} / {value}",
                            material.0,
                            float(f[8 + k])
                        ));
                    }
                }
                if !near(float(f[11]), pdf, 1e-2, 1e-4) {
                    wrong.push(format!(
                        "{i}: material {}, sample's pdf {} / {pdf}",
                        material.0,
                        float(f[11])
                    ));
                }
            }
            None if f[4] == 0 => {}
            other => {
                wrong.push(format!("{i}: material {}, sampled {} / {other:?}", material.0, f[4]));
            }
        }
    }
    wrong
}

#[test]
fn every_lobe_agrees() {
    let Some(gpu) = device() else { return };
    let world = sampler();
    let inputs = bsdf_inputs(world.shapes.len() as u32);
    let found = run(&gpu, &world, BSDF, (&inputs, 12), 15);
    let wrong = bsdf_differences(&world, &inputs, &found);
    // Directions and densities at the very edge of a lobe may fall to either side.
    assert!(
        wrong.len() <= 16,
        "{} of {}:\n{}",
        wrong.len(),
        4 * N,
        wrong[..wrong.len().min(20)].join("\n")
    );
}

/// The control: one constant of one lobe off by half a percent.
#[test]
fn a_wrong_constant_in_a_lobe_is_found() {
    let Some(gpu) = device() else { return };
    let world = sampler();
    let inputs = bsdf_inputs(world.shapes.len() as u32);
    let found = run_changed(&gpu, &world, BSDF, (&inputs, 12), 15, |text| {
        assert!(text.contains("0.996 * below"));
        text.replace("0.996 * below", "0.991 * below")
    });
    let wrong = bsdf_differences(&world, &inputs, &found);
    assert!(wrong.len() > 200, "only {} differ", wrong.len());
}

#[test]
fn textures_agree() {
    let Some(gpu) = device() else { return };
    let world = world(false, true);
    let mut random = Stream::from_key(13);
    let mut inputs = Vec::new();
    for i in 0..N {
        let far = if i % 50 == 0 { 1e6 } else { 4.0 };
        inputs.extend(bits(&[(random.uniform() - 0.5) * far, (random.uniform() - 0.5) * far]));
    }
    // Lights hold colours and coverage: emission of each surface, its share that is sent, and
    // coverage's coin.
    let lights = world.lights.len() as u32;
    let body = format!(
        "fn test(i: u32) {{
        let uv = vec2f(input_float(i, 0u), input_float(i, 1u));
        let light = i % {lights}u;
        output_vector(i, 0u, light_emitted(NOW, light, uv, 1.0));
        output_vector(i, 3u, light_emitted(NOW, light, uv, -1.0));
    }}"
    );
    let found = run(&gpu, &world, &body, (&inputs, 2), 6);
    for (i, (v, f)) in inputs.chunks(2).zip(found.chunks(6)).enumerate() {
        let uv = Vec2::new(float(v[0]), float(v[1]));
        let light = i as u32 % lights;
        for (at, cos) in [(0, 1.0), (3, -1.0)] {
            let wanted = world.lights.emitted(&world.scene, light, uv, cos);
            for k in 0..3 {
                // Far away a texel's edge moves by the rounding of the coordinate.
                if uv.abs().max_element() < 10.0 {
                    close(
                        &format!("light {light} at {uv}"),
                        float(f[at + k]),
                        wanted[k],
                        2e-4,
                        1.0,
                    );
                }
            }
        }
    }
}

#[test]
fn lights_agree() {
    let Some(gpu) = device() else { return };
    let world = world(false, true);
    let (lights, scene) = (&world.lights, &*world.scene);
    let count = lights.len() as u32;
    let mut random = Stream::from_key(14);
    let mut inputs = Vec::new();
    for i in 0..4 * N {
        let at =
            5.0 * Vec3::new(random.uniform() - 0.5, random.uniform() - 0.5, random.uniform() - 0.5);
        inputs.extend(bits(&at.to_array()));
        inputs.extend(bits(&[unit(&mut random, i), unit(&mut random, i / 5)]));
        inputs.extend([random.word(), random.word()]);
    }
    let body = format!(
        "fn test(i: u32) {{
        let place = input_vector(i, 0u);
        let u = vec2f(input_float(i, 3u), input_float(i, 4u));
        let light = i % {count}u;
        output(i, 0u, choose_light(NOW, input(i, 5u), input(i, 6u)));
        output_float(i, 1u, choice_probability(NOW, light));
        let point = light_point_with(NOW, light, u);
        let emitter = light_emitter(NOW, point);
        output(i, 2u, select(0u, 1u, emitter.valid));
        output_vector(i, 3u, emitter.position); output_vector(i, 6u, emitter.normal);
        output_vector(i, 9u, emitter.radiance); output(i, 12u, emitter.kind);
        let arrival = emitter_towards(NOW, emitter, place);
        output(i, 13u, select(0u, 1u, arrival.valid && emitter.valid));
        output_vector(i, 14u, arrival.direction); output_vector(i, 17u, arrival.radiance);
        output_float(i, 20u, arrival.geometry);
        output_float(i, 21u, light_measure(NOW, point));
        output_float(i, 22u, uniform_density(NOW, point));
        output_float(i, 23u, light_density_towards(NOW, point, place, arrival.geometry));
        let end = shadow_end(NOW, emitter, place);
        output_vector(i, 24u, end.xyz); output_float(i, 27u, end.w);
        let incident = light_sample_towards(NOW, light, place, u);
        output(i, 28u, select(0u, 1u, incident.valid));
        output_vector(i, 29u, incident.direction); output_vector(i, 32u, incident.radiance);
        output_float(i, 35u, incident.pdf);
        let drawn = light_point_towards(NOW, light, place, u);
        output_float(i, 36u, drawn.uv.x); output_float(i, 37u, drawn.uv.y);
    }}"
    );
    let found = run(&gpu, &world, &body, (&inputs, 7), 38);
    let mut edges = 0;
    for (i, (v, f)) in inputs.chunks(7).zip(found.chunks(38)).enumerate() {
        let place = Vec3::new(float(v[0]), float(v[1]), float(v[2]));
        let u = Vec2::new(float(v[3]), float(v[4]));
        let light = i as u32 % count;
        let name = format!("{i}: light {light} at {u} from {place}");
        let check = |what: &str, at: usize, wanted: Vec3, relative: f32| {
            let scale = wanted.abs().max_element().max(1e-3);
            for (k, w) in wanted.to_array().into_iter().enumerate() {
                close(&format!("{what} {name}"), float(f[at + k]), w, relative, scale);
            }
        };
        assert_eq!(f[0], lights.choose(v[5], v[6]), "{name}");
        assert_eq!(f[1], lights.choice_probability(light).to_bits(), "{name}");
        let point = lights.point_with(light, u);
        let emitter = lights.emitter(scene, point);
        assert_eq!(f[2], u32::from(emitter.is_some()), "{name}");
        let Some(emitter) = emitter else { continue };
        let words: [u32; 11] = bytemuck::cast(emitter);
        for k in 0..6 {
            close(&format!("emitter {k} {name}"), float(f[3 + k]), float(words[k]), 1e-3, 1.0);
        }
        // At the edge of a checkerboard's square a point shows either colour; at a sphere's pole
        // any column of a texture.
        if (6..9).any(|k| (float(f[3 + k]) - float(words[k])).abs() > 1e-3) {
            edges += u32::from((1e-6..1.0 - 1e-6).contains(&u.x));
            continue;
        }
        assert_eq!(f[12], words[9], "{name}");
        // On the border of a texel either side's density is right; a third of the numbers lie on
        // borders.
        if (float(f[21]) / lights.measure(point) - 1.0).abs() > 2e-3 {
            assert!(words[9] == 5 && (u * 8.0).fract().abs().min_element() < 1e-3, "{name}");
            continue;
        }
        let arrival = emitter.towards(lights, place);
        if u32::from(arrival.is_some()) == f[13] {
            if let Some(arrival) = arrival {
                check("direction", 14, arrival.direction, 2e-5);
                check("radiance", 17, arrival.radiance, 2e-3);
                close(&format!("geometry {name}"), float(f[20]), arrival.geometry, 2e-3, 1e-2);
                let density = lights.density_towards(point, place, arrival.geometry);
                close(&format!("density {name}"), float(f[23]), density, 2e-3, 1e-2);
            }
        } else {
            edges += 1;
        }
        close(&format!("uniform {name}"), float(f[22]), lights.uniform_density(point), 2e-3, 1e-3);
        let end = lights.shadow_end(&emitter, place);
        assert_eq!(float(f[27]) != 0.0, end.is_some(), "{name}");
        if let Some(end) = end {
            check("end", 24, end, 1e-5);
        }
        let incident = lights.sample_towards(scene, light, place, u);
        if u32::from(incident.is_some()) == f[28] {
            if let Some(incident) = incident {
                check("towards", 29, incident.direction, 1e-3);
                check("incident", 32, incident.radiance, 5e-2);
                close(&format!("pdf {name}"), float(f[35]), incident.pdf, 5e-2, 1e-2);
            }
        } else {
            edges += 1;
        }
        let drawn = lights.point_towards(light, place, u);
        let apart = (Vec2::new(float(f[36]), float(f[37])) - drawn.uv).abs();
        // Azimuths wrap, and have no meaning at a pole.
        let wraps = apart.y > 0.99 || drawn.uv.x < 1e-4 || drawn.uv.x > 0.9999;
        assert!(apart.x < 1e-3 && (apart.y < 1e-3 || wraps), "{name}: {apart}");
    }
    assert!(edges <= 24, "{edges} of {} points are lit on one side only", 4 * N);
}

#[test]
fn environments_agree() {
    let Some(gpu) = device() else { return };
    let world = world(false, true);
    let environments: Vec<_> = world.lights.environments().collect();
    let mut random = Stream::from_key(15);
    let mut inputs = Vec::new();
    for i in 0..N {
        let d =
            warp::sample_uniform_sphere(Vec2::new(unit(&mut random, i), unit(&mut random, i / 4)));
        inputs.extend(bits(&d.to_array()));
        inputs.extend(bits(&[random.uniform(), random.uniform()]));
    }
    let n = environments.len() as u32;
    let body = format!(
        "fn test(i: u32) {{
        let environment = environment_number(NOW, i % {n}u);
        let d = input_vector(i, 0u);
        output_vector(i, 0u, environment_radiance(environment, d));
        output_float(i, 3u, environment_pdf(environment, d));
        output_vector(i, 4u, environment_invert(environment, d));
        output_vector(i, 7u, environment_sample(environment, vec2f(input_float(i, 3u), input_float(i, 4u))));
        output(i, 10u, environment_light(environment));
        output_vector(i, 11u, escaped_radiance(NOW, d));
    }}"
    );
    let found = run(&gpu, &world, &body, (&inputs, 5), 14);
    let mut edges = 0;
    for (i, (v, f)) in inputs.chunks(5).zip(found.chunks(14)).enumerate() {
        let (light, environment) = environments[i % environments.len()];
        let d = Vec3::new(float(v[0]), float(v[1]), float(v[2]));
        let radiance = environment.radiance(d);
        for k in 0..3 {
            close(&format!("radiance {i}"), float(f[k]), radiance[k], 2e-4, 0.1);
            close(
                &format!("escaped {i}"),
                float(f[11 + k]),
                world.escaped_radiance(d)[k],
                2e-4,
                0.1,
            );
        }
        let pdf = environment.pdf(d);
        let wanted = environment.invert(d);
        let inverse = Vec2::new(float(f[4]), float(f[5]));
        // At the edge of a texel a direction belongs to either side.
        let apart = (inverse - wanted.unwrap_or(inverse)).abs();
        let same = (float(f[3]) / pdf - 1.0).abs() < 1e-4
            && (apart.max_element() < 1e-3 || apart.y > 0.99);
        edges += u32::from(!same || wanted.is_some() != (f[6] != 0));
        let sample = environment.sample(Vec2::new(float(v[3]), float(v[4])));
        let there = Vec3::new(float(f[7]), float(f[8]), float(f[9]));
        assert!((sample - there).length() < 1e-4, "{i}: {there} / {sample}");
        assert_eq!(f[10], light);
    }
    assert!(edges <= 64, "{edges} of {N} directions differ");
}

/// A point of a light as BSDF sampling finds it, and rays of shadow that end there.
#[test]
fn points_found_by_rays_agree() {
    let Some(gpu) = device() else { return };
    let world = world(false, true);
    let (inputs, _) = rays();
    let body = "
    fn test(i: u32) {
        let ray = Ray(input_vector(i, 0u), input_vector(i, 3u), FAR);
        let hit = closest_hit(NOW, ray);
        output(i, 0u, hit.primitive);
        if hit.primitive != MISS {
            let point = point_at(NOW, hit);
            let light = light_of_surface(NOW, point.shape, point.element);
            output(i, 1u, light);
            output_float(i, 2u, hit.u); output_float(i, 3u, hit.v); output_float(i, 4u, hit.t);
            output(i, 7u, hit.instance);
            if light != NO_LIGHT {
                let p = light_point_at(NOW, light, hit, point.position);
                output_float(i, 5u, p.uv.x); output_float(i, 6u, p.uv.y);
            }
        }
    }";
    let found = run(&gpu, &world, body, (&inputs, 7), 8);
    let mut lit = 0;
    for f in found.chunks(8) {
        if f[0] == u32::MAX {
            continue;
        }
        let hit =
            Hit { t: float(f[4]), u: float(f[2]), v: float(f[3]), primitive: f[0], instance: f[7] };
        let point = world.accel.point(&hit);
        let light = world.lights.of_surface(point.shape, point.element);
        assert_eq!(f[1], light);
        if light != u32::MAX {
            lit += 1;
            let LightPoint { uv, .. } = world.lights.point_at(light, &hit, &point);
            let apart = (Vec2::new(float(f[5]), float(f[6])) - uv).abs();
            assert!(apart.x < 2e-4 && (apart.y < 2e-3 || apart.y > 0.99), "{uv} off by {apart}");
        }
    }
    assert!(lit > 100, "{lit}");
}
