//! Scenes whose answer is known, rendered by every technique that claims to be unbiased for them.
//!
//! A noisy answer passes by TOST: |bias| < δ = 0.5 % at α = 10⁻³, over 64 restarts. The number of
//! paths comes from a pilot and the power formula n = ((z₁₋α + z₀.₉₉₉₅) 1.1 c/δ)² = 1.97·10⁶ c²,
//! where c is one path's standard deviation over the mean. So a true bias of 0 passes with 99.9 %,
//! one of 0.5 % with 0.1 %, and one of 0.52 % is called a difference (at 10⁻⁶) with 99 %. Truth ×
//! 1.01 must fail. Answers without noise are compared to a stated tolerance. Each test prints its
//! n, c, bias and half width:
//! `cargo test --release --test suite oracles -- --nocapture --test-threads 1`. A technique that
//! needs many paths, c > 1.8, is left out where `nee` needs few.
//!
//! | oracle | scene | c of `bsdf`, `nee` | n of `bsdf`, `nee` |
//! |---|---|---|---|
//! | O1 | closed sphere, closed box | 0.00; 0.00 to 0.34 | 1.6·10⁴; 1.6·10⁴ to 2.3·10⁵ |
//! | O2 | point light in a sphere | –; 0.14 to 0.70 | –; 4.9·10⁴ to 9.8·10⁵ |
//! | O3 | patch in a sphere, constant and varying ρ | 0.50 to 0.78; 0.37 to 0.57 | 5.1·10⁵ to 1.2·10⁶; 2.8·10⁵ to 6.5·10⁵ |
//! | O4 | concentric spheres | 0.17 to 0.50; 0.21 to 0.45 | 6.5·10⁴ to 4.9·10⁵; 9.8·10⁴ to 4.1·10⁵ |
//! | O5 | plates between mirrors | 0.57; 0.57 | 6.5·10⁵; 6.5·10⁵ |
//! | O6 | rectangle over a corner | 1.79; 0.54 to 1.40 | 6.4·10⁶; 5.7·10⁵ to 3.9·10⁶ |
//! | O7 | polygon across the horizon | 1.07; 0.80 | 2.3·10⁶; 1.3·10⁶ |
//! | O8 | disk, sphere | 0.63 to 1.40; 0.13 to 0.43 | 7.9·10⁵ to 3.9·10⁶; 4.9·10⁴ to 3.6·10⁵ |
//! | O9 | penumbra, 7 receivers | 0.58 to 1.25; 0.56 to 1.55 | 6.7·10⁵ to 3.1·10⁶; 6.4·10⁵ to 4.7·10⁶ |
//! | O10 | linear sky | 0.21 to 0.66; 0.29 to 0.51 | 9.8·10⁴ to 8.5·10⁵; 1.8·10⁵ to 5.2·10⁵ |
//! | O11 | GGX under a constant sky | 0.11 to 1.17; 0.28 to 0.81 | 3.3·10⁴ to 2.7·10⁶; 1.6·10⁵ to 1.3·10⁶ |
//! | O12 | glass slab | 0.28 to 0.96; 0.28 to 0.96 | 1.6·10⁵ to 1.8·10⁶; 1.6·10⁵ to 1.8·10⁶ |
//! | O13 | point, spot, distant lights; a mirror | no noise | |
//! | O14 | many lights | –; 0.13 | –; 3.3·10⁴ |
//! | O15 | von Mises–Fisher sky | –; 0.17 to 0.29 | –; 6.5·10⁴ to 1.6·10⁵ |
//!
//! F is a form factor: irradiance over π times the radiance of the source, so what a white Lambert
//! receiver reflects. Formulas: Howell, *A Catalog of Radiation Heat Transfer Configuration
//! Factors*; Lambert 1760 for polygons; Heitz 2014 for GGX.

use std::f64::consts::PI;

use afterimage::frame::Stage;
use afterimage::math::Frame;
use afterimage::plan::Shot;
use afterimage::scene::{
    Color, Emission, EnvironmentMapping, Geometry, Image, ImageData, LightKind, Roughness, Scene,
    Shape, SpotFalloff, Texture, TextureKind, Wrap,
};
use afterimage::scene::{Material, MaterialId, Scalar};
use glam::{Affine2, Affine3A, DVec2, DVec3, Vec3};

use crate::support::{
    against, along, assert_exact, assert_mean, assert_means, assert_same_mean, diffuse,
    environment, light, look_at, metal, picture, polygon, receiver, restarts, rounded, shot,
    sphere, unbiased,
};

/// Pixels of most tests: few, as all see the same point; enough for bands on two threads.
const SIZE: [u32; 2] = [16, 16];

fn direct() -> Shot {
    shot(SIZE, 2, 1)
}

/// Σ ratioᵏ over `terms` terms from k = 0.
fn geometric(ratio: f64, terms: u32) -> f64 {
    (0..terms).map(|k| ratio.powi(k as i32)).sum()
}

/// Form factor from a point at the origin with normal `n` to a convex polygon: Σ θᵢ n·Γᵢ / 2π, the
/// part below the horizon cut off.
fn form_factor(polygon: &[DVec3], n: DVec3) -> f64 {
    let mut above = Vec::new();
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = (a.dot(n), b.dot(n));
        if ha >= 0.0 {
            above.push(a);
        }
        if ha * hb < 0.0 {
            above.push(a + (b - a) * (ha / (ha - hb)));
        }
    }
    let sum: f64 = (0..above.len())
        .map(|i| {
            let (a, b) = (above[i].normalize(), above[(i + 1) % above.len()].normalize());
            let cross = a.cross(b);
            let angle = cross.length().atan2(a.dot(b));
            if angle == 0.0 { 0.0 } else { angle * n.dot(cross) / cross.length() }
        })
        .sum();
    sum.abs() / (2.0 * PI)
}

/// The part of a convex polygon inside another, both counter-clockwise (Sutherland and Hodgman
/// 1974).
fn intersection(subject: &[DVec2], clip: &[DVec2]) -> Vec<DVec2> {
    let mut inside = subject.to_vec();
    for (i, &a) in clip.iter().enumerate() {
        let edge = clip[(i + 1) % clip.len()] - a;
        let side = |p: DVec2| edge.perp_dot(p - a);
        let before = std::mem::take(&mut inside);
        for (k, &p) in before.iter().enumerate() {
            let q = before[(k + 1) % before.len()];
            if side(p) >= 0.0 {
                inside.push(p);
            }
            if side(p) * side(q) < 0.0 {
                inside.push(p + (q - p) * (side(p) / (side(p) - side(q))));
            }
        }
    }
    inside
}

/// A horizontal polygon at height `y` that emits downwards, given counter-clockwise in (z, x).
fn ceiling(scene: &mut Scene, corners: &[DVec2], y: f64, radiance: f32) {
    let black = diffuse(scene, 0.0);
    let corners: Vec<Vec3> =
        corners.iter().rev().map(|c| DVec3::new(c.y, y, c.x).as_vec3()).collect();
    scene.add_shape(Shape::new(polygon(&corners), black).emitting(Vec3::splat(radiance)));
}

/// A white receiver at `at` that faces up.
fn floor_at(scene: &mut Scene, at: Vec3) {
    let white = diffuse(scene, 1.0);
    receiver(scene, at, Vec3::Y, 0.96, white);
}

/// O1. L = Lₑ (ρ + … + ρᵈ⁻¹) in a closed sphere and in a closed box with a sphere in it, all alike.
/// Cosine sampling has no noise here.
#[test]
fn o1_furnace() {
    let (rho, emitted) = (0.5, 0.25);
    for depth in [2, 3, 6] {
        let truth = f64::from(emitted) * rho * geometric(rho, depth - 1);
        let mut round = Scene::new("O1 sphere");
        let material = diffuse(&mut round, rho as f32);
        round.add_shape(sphere(1.0, material).emitting(Vec3::splat(emitted)));
        round.camera = look_at(Vec3::new(0.125, 0.25, 0.375), Vec3::Z, 1.0);
        let mut square = Scene::new("O1 box");
        let material = diffuse(&mut square, rho as f32);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            for side in [axis, -axis] {
                let Frame { tangent: s, bitangent: t, normal } = Frame::from_normal(-side);
                let corner = |a: f32, b: f32| (s * a + t * b - normal) * 2.0;
                let corners =
                    [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
                square.add_shape(
                    Shape::new(polygon(&corners), material).emitting(Vec3::splat(emitted)),
                );
            }
        }
        let ball = Geometry::Sphere { center: Vec3::new(0.5, 0.25, 0.75), radius: 0.75 };
        square.add_shape(Shape::new(ball, material).emitting(Vec3::splat(emitted)));
        square.camera = look_at(Vec3::new(-1.5, 0.25, -1.0), Vec3::ZERO, 1.25);
        for scene in [round, square] {
            let stage = Stage::new(scene).unwrap();
            // Each of the few products and sums rounds once.
            assert_exact(&picture(&stage, "bsdf", shot([32, 32], depth, 4)), truth, 1e-6);
            for name in unbiased(&stage, &direct()) {
                assert_mean(&stage, name, shot(SIZE, depth, 1), truth);
            }
        }
    }
}

/// O2. A point light I at the centre of a sphere: ρ I / (π R²) · (1 + ρ + …). No noise without
/// Russian roulette, and the whole series with it.
#[test]
fn o2_point_light_in_a_sphere() {
    let (rho, intensity, radius) = (0.5, PI, 1.5);
    let mut scene = Scene::new("O2");
    let material = diffuse(&mut scene, rho as f32);
    scene.add_shape(sphere(radius as f32, material));
    light(
        &mut scene,
        LightKind::Point { intensity: Vec3::splat(intensity as f32) },
        Affine3A::IDENTITY,
    );
    scene.camera = look_at(Vec3::new(0.25, 0.5, 0.0), Vec3::Z, 1.0);
    let one = rho * intensity / (PI * radius * radius);
    let stage = Stage::new(scene.clone()).unwrap();
    for depth in [2, 3, 5] {
        let truth = one * geometric(rho, depth - 1);
        assert_exact(&picture(&stage, "nee:roulette=1000", shot([32, 32], depth, 2)), truth, 4e-6);
    }
    assert_mean(&stage, "nee:roulette=0", shot(SIZE, 40, 1), one / (1.0 - rho));
    assert_means(scene, shot(SIZE, 40, 1), one / (1.0 - rho));
}

/// A picture of one column: linear between its values, from the sphere's pole at +z to that at −z.
fn by_polar_angle(scene: &mut Scene, values: &[f32]) -> Color {
    let data = ImageData::Float(values.iter().map(|v| [*v, *v, *v, 1.0]).collect());
    let image = scene.add_image(Image { width: 1, height: values.len() as u32, data });
    let kind = TextureKind::Image { image, wrap: Wrap::Clamp, scale: 1.0, invert: false };
    Color::Texture(scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY }))
}

fn column_at(values: &[f32], theta: f64) -> f64 {
    let at = (theta / PI * values.len() as f64 - 0.5).clamp(0.0, values.len() as f64 - 1.0);
    let low = (at as usize).min(values.len() - 2);
    let f = at - low as f64;
    f64::from(values[low]) * (1.0 - f) + f64::from(values[low + 1]) * f
}

/// Mean over the sphere of a function of the polar angle.
fn sphere_mean(f: impl Fn(f64) -> f64) -> f64 {
    const N: usize = 200_000;
    let step = PI / N as f64;
    (0..N).map(|i| (i as f64 + 0.5) * step).map(|theta| f(theta) * theta.sin()).sum::<f64>()
        * 0.5
        * step
}

/// O3. Inside a sphere every point sees every other alike: E = π ⟨Lₑ⟩ (1 + ⟨ρ⟩ + …) for any
/// emission and, wherever seen, any ρ.
#[test]
fn o3_patch_in_a_sphere() {
    let emission = [0.25, 0.25, 2.0, 1.0, 0.25, 0.0, 0.5, 0.5];
    let varying = [0.2, 0.8, 0.5, 0.3];
    for (name, rho, depths) in [("O3", [0.6; 4], &[2, 4][..]), ("O3 varying", varying, &[4])] {
        let mut scene = Scene::new(name);
        let reflectance = by_polar_angle(&mut scene, &rho);
        let material = scene.add_material(Material::Diffuse { reflectance });
        let radiance = by_polar_angle(&mut scene, &emission);
        let mut shape = sphere(1.0, material);
        shape.emission = Some(Emission { radiance, scale: 1.0, two_sided: false });
        scene.add_shape(shape);
        let theta = 1.0;
        let seen = Vec3::new(f64::sin(theta) as f32, 0.0, f64::cos(theta) as f32);
        scene.camera = look_at(Vec3::new(0.25, 0.5, -0.25), seen, 1e-4);
        let mean_emission = sphere_mean(|theta| column_at(&emission, theta));
        let mean_rho = sphere_mean(|theta| column_at(&rho, theta));
        for &depth in depths {
            let truth = column_at(&rho, theta) * mean_emission * geometric(mean_rho, depth - 1);
            assert_means(scene.clone(), shot(SIZE, depth, 1), truth);
        }
    }
}

/// O4. Concentric spheres: many bounces with occlusion. Radiosities B₁ = E₁ + ρ₁ B₂, B₂ = E₂ + ρ₂
/// (F₂₁ B₁ + (1 − F₂₁) B₂), F₂₁ = (r₁/r₂)².
#[test]
fn o4_concentric_spheres() {
    let (rho, f21) = ([0.3, 0.6], 0.25);
    let step = |b: [f64; 2]| [rho[0] * b[1], rho[1] * (f21 * b[0] + (1.0 - f21) * b[1])];
    // Light after 1, 2, … scatterings, summed.
    let reflected = |emitted: [f64; 2], bounces: u32| {
        let (mut b, mut sum) = (emitted, [0.0; 2]);
        for _ in 0..bounces {
            b = step(b);
            sum = [sum[0] + b[0], sum[1] + b[1]];
        }
        sum
    };
    let all = reflected([1.0, 0.0], 200);
    assert!((all[0] + 1.0 - 1.089_108_9).abs() < 1e-7 && (all[1] - 0.297_029_7).abs() < 1e-7);
    let emitted = [1.0, 0.5];
    let shine = |radiosity: f64| Vec3::splat((radiosity / PI) as f32);
    for (depth, bounces, sides) in [(3, 2, 1..2), (60, 200, 0..2)] {
        for seen in sides {
            let mut scene = Scene::new(["O4 inner", "O4 outer"][seen]);
            let (inner, outer) = (diffuse(&mut scene, 0.3), diffuse(&mut scene, 0.6));
            let ball = Geometry::Sphere { center: Vec3::ZERO, radius: 0.5 };
            scene.add_shape(Shape::new(ball, inner).emitting(shine(emitted[0])));
            scene.add_shape(sphere(1.0, outer).emitting(shine(emitted[1])));
            let towards = [Vec3::ZERO, Vec3::new(1.0, 0.2, 0.1)][seen];
            scene.camera = look_at(Vec3::new(0.75, 0.0, 0.125), towards, 0.25);
            assert_means(scene, shot(SIZE, depth, 1), reflected(emitted, bounces)[seen] / PI);
        }
    }
}

/// O5. Parallel plates made endless by mirrors around them: B₁ = (E₁ + ρ₁ E₂)/(1 − ρ₁ ρ₂). A path
/// that is still between the mirrors after 400 segments has weight below 10⁻⁵.
#[test]
fn o5_parallel_plates_between_mirrors() {
    let (rho, emitted) = ([0.5, 0.4], [1.0, 0.5]);
    let mut scene = Scene::new("O5");
    let mirror = metal(&mut scene, 0.0);
    let plates = [diffuse(&mut scene, rho[0]), diffuse(&mut scene, rho[1])];
    let w = 2.0;
    let corner = |x: f32, y: f32, z: f32| Vec3::new(x * w, y, z * w);
    let [a, b, c, d] = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
    let low = [a, b, c, d].map(|(x, z)| corner(x, 0.0, z));
    let high = [a, d, c, b].map(|(x, z)| corner(x, 1.0, z));
    let shine = |e: f32| Vec3::splat(e / PI as f32);
    scene.add_shape(Shape::new(polygon(&low), plates[0]).emitting(shine(emitted[0])));
    scene.add_shape(Shape::new(polygon(&high), plates[1]).emitting(shine(emitted[1])));
    for (p, q) in [(a, b), (b, c), (c, d), (d, a)] {
        let wall = [
            corner(p.0, 0.0, p.1),
            corner(q.0, 0.0, q.1),
            corner(q.0, 1.0, q.1),
            corner(p.0, 1.0, p.1),
        ];
        scene.add_shape(Shape::new(polygon(&wall), mirror));
    }
    scene.camera = look_at(Vec3::new(0.3, 0.5, 0.2), Vec3::new(0.5, 0.0, 0.7), 0.1);
    let (rho, emitted) = (rho.map(f64::from), emitted.map(f64::from));
    let b = (emitted[0] + rho[0] * emitted[1]) / (1.0 - rho[0] * rho[1]);
    assert_means(scene, shot(SIZE, 400, 1), (b - emitted[0]) / PI);
}

/// O6. A rectangle a × b at height h over a corner.
#[test]
fn o6_rectangle_over_a_corner() {
    for (a, b, h, known) in [(1.0, 2.0, 1.5, Some(0.122_359_661_7)), (4.0, 6.0, 1.0, None)] {
        let (x, y): (f64, f64) = (a / h, b / h);
        let arm = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
        let f = (arm(x, y) + arm(y, x)) / (2.0 * PI);
        if let Some(known) = known {
            assert!((f - known).abs() < 1e-10);
        }
        let mut scene = Scene::new("O6");
        ceiling(
            &mut scene,
            &[DVec2::ZERO, DVec2::new(b, 0.0), DVec2::new(b, a), DVec2::new(0.0, a)],
            h,
            1.0,
        );
        floor_at(&mut scene, Vec3::ZERO);
        assert_means(scene, direct(), f);
    }
}

/// O7. A pentagon over a tilted receiver, partly below its horizon.
#[test]
fn o7_polygon_across_the_horizon() {
    let corners = [(-1.0, -1.5), (1.0, -2.0), (2.5, 0.0), (1.0, 2.0), (-1.0, 1.5)]
        .map(|(z, x)| DVec2::new(z, x));
    let n = DVec3::new(0.8, 0.6, 0.0);
    let points: Vec<DVec3> = corners.iter().map(|c| DVec3::new(c.y, 1.0, c.x)).collect();
    assert!(points.iter().any(|p| p.dot(n) < 0.0) && points.iter().any(|p| p.dot(n) > 0.0));
    let mut scene = Scene::new("O7");
    ceiling(&mut scene, &corners, 1.0, 1.0);
    let white = diffuse(&mut scene, 1.0);
    receiver(&mut scene, Vec3::ZERO, n.as_vec3(), 0.96, white);
    assert_means(scene, direct(), form_factor(&points, n));
}

/// O8. A disk on the axis, F = R²/(R² + h²), and a sphere above the horizon, F = (R/d)² cos θ.
#[test]
fn o8_disk_and_sphere() {
    let mut disk = Scene::new("O8 disk");
    let black = diffuse(&mut disk, 0.0);
    let geometry = Geometry::Disk { center: Vec3::Y, normal: -Vec3::Y, radius: 1.5 };
    disk.add_shape(Shape::new(geometry, black).emitting(Vec3::ONE));
    floor_at(&mut disk, Vec3::ZERO);
    assert_means(disk, direct(), 2.25 / 3.25);
    for distance in [1.5, 3.0] {
        let mut ball = Scene::new("O8 sphere");
        let black = diffuse(&mut ball, 0.0);
        let center = Vec3::new(0.6, 0.8, 0.0) * distance;
        let geometry = Geometry::Sphere { center, radius: 1.0 };
        ball.add_shape(Shape::new(geometry, black).emitting(Vec3::ONE));
        floor_at(&mut ball, Vec3::ZERO);
        let truth = 0.8 / f64::from(distance * distance);
        // The farther one is 0.2792526803 L/π.
        assert_means(ball, direct(), truth);
    }
}

/// O9. Exact penumbras: a square light, an occluder half way, receivers across its shadow. The
/// visible part is the light less the occluder's projection on it.
#[test]
fn o9_penumbra() {
    let rectangle = |low: DVec2, high: DVec2| {
        vec![low, DVec2::new(high.x, low.y), high, DVec2::new(low.x, high.y)]
    };
    let square = rectangle(DVec2::splat(-2.0), DVec2::splat(2.0));
    // In (z, x), as the light: an edge across the whole light, and a triangle inside its outline.
    let half_plane = rectangle(DVec2::new(-9.0, 0.0), DVec2::new(9.0, 9.0));
    let triangle = vec![DVec2::new(-0.75, -0.5), DVec2::new(0.75, -0.25), DVec2::new(0.25, 0.75)];
    for (name, occluder, xs) in [
        ("O9 edge", half_plane, &[-1.0, -0.5, 0.0, 0.5][..]),
        ("O9 triangle", triangle, &[-0.75, 0.0, 0.5][..]),
    ] {
        for &x in xs {
            let at = DVec2::new(0.0, x);
            let projected: Vec<DVec2> = occluder.iter().map(|c| at + (c - at) * 2.0).collect();
            let seen_from = |corners: &[DVec2]| {
                let around: Vec<DVec3> =
                    corners.iter().map(|c| DVec3::new(c.y - x, 1.0, c.x)).collect();
                form_factor(&around, DVec3::Y)
            };
            let hidden = intersection(&square, &projected);
            let truth = seen_from(&square) - seen_from(&hidden);
            assert!(truth > 0.05 && truth < 0.999 * seen_from(&square), "a penumbra: {truth}");
            let mut scene = Scene::new(format!("{name} at {x}"));
            ceiling(&mut scene, &square, 1.0, 1.0);
            let black = diffuse(&mut scene, 0.0);
            let corners: Vec<Vec3> =
                occluder.iter().map(|c| DVec3::new(c.y, 0.5, c.x).as_vec3()).collect();
            scene.add_shape(Shape::new(polygon(&corners), black));
            floor_at(&mut scene, Vec3::new(x as f32, 0.0, 0.0));
            assert_means(scene, direct(), truth);
        }
    }
}

/// A latitude–longitude image of a function of the direction.
fn sky(scene: &mut Scene, height: u32, radiance: impl Fn(DVec3) -> f64) {
    let width = 2 * height;
    let mut data = Vec::new();
    for y in 0..height {
        for x in 0..width {
            let theta = PI * (f64::from(y) + 0.5) / f64::from(height);
            let phi = 2.0 * PI * (f64::from(x) + 0.5) / f64::from(width);
            let d = DVec3::new(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos());
            let value = radiance(d) as f32;
            data.push([value, value, value, 1.0]);
        }
    }
    let image = scene.add_image(Image { width, height, data: ImageData::Float(data) });
    let image = Some((image, EnvironmentMapping::LatitudeLongitude));
    light(scene, LightKind::Environment { radiance: Vec3::ONE, image }, Affine3A::IDENTITY);
}

/// O10. Radiance 1 + a·ω: E(n) = π + (2π/3) a·n. Between texels 1/256 of a turn apart a bilinear
/// image is off by less than 10⁻⁴.
#[test]
fn o10_linear_sky() {
    for n in [Vec3::Z, Vec3::new(0.6, 0.0, -0.8), Vec3::new(-0.36, 0.48, 0.8)] {
        let a = DVec3::new(0.25, 0.5, 0.75);
        let mut scene = Scene::new("O10");
        sky(&mut scene, 128, |d| 1.0 + a.dot(d));
        let white = diffuse(&mut scene, 1.0);
        receiver(&mut scene, Vec3::ZERO, n, 0.96, white);
        assert_means(scene, direct(), 1.0 + 2.0 / 3.0 * a.dot(n.as_dvec3()));
    }
}

/// O11. GGX with F = 1 under a constant sky: the directional albedo, by quadrature over the visible
/// normals in the specification.
#[test]
fn o11_ggx_under_a_constant_sky() {
    for (alpha, by_cosine) in [
        (0.1, [0.988_316, 0.969_214, 0.883_456]),
        (0.25, [0.915_813, 0.857_264, 0.891_621]),
        (0.5, [0.687_849, 0.698_251, 0.860_105]),
        (1.0, [0.306_853, 0.450_694, 0.760_210]),
    ] {
        for (mu, truth) in [1.0, 0.5, 0.1].into_iter().zip(by_cosine) {
            let mut scene = Scene::new(format!("O11 {alpha} {mu}"));
            let material = metal(&mut scene, alpha);
            receiver(&mut scene, Vec3::ZERO, Vec3::Y, mu, material);
            environment(&mut scene, Vec3::ONE);
            assert_means(scene, direct(), truth);
        }
    }
}

/// O12. A slab of glass. With R the reflectance of one face, T = (1 − R)² (1 + R² + R⁴ …) = (1 −
/// R)/(1 + R) and ρ = R + (1 − R)² (R + R³ …) = 2 R/(1 + R); a depth cuts the series.
#[test]
fn o12_glass_slab() {
    let reflectance = |mu: f64| {
        let t = (1.0 - (1.0 - mu * mu) / 2.25).sqrt();
        let (s, p) = ((mu - 1.5 * t) / (mu + 1.5 * t), (1.5 * mu - t) / (1.5 * mu + t));
        0.5 * (s * s + p * p)
    };
    assert!((reflectance(0.5) - 0.089_186_7).abs() < 1e-7);
    let build = |mu: f32, below: f32, above: f32| {
        let mut scene = Scene::new(format!("O12 cosine {mu}"));
        let roughness = Roughness::SMOOTH;
        let glass = scene.add_material(Material::Dielectric { eta: 1.5, roughness });
        let black = diffuse(&mut scene, 0.0);
        let plane = |y: f32, up: bool, w: f32| {
            let mut corners = [(-w, -w), (-w, w), (w, w), (w, -w)].map(|(x, z)| Vec3::new(x, y, z));
            if !up {
                corners.reverse();
            }
            polygon(&corners)
        };
        scene.add_shape(Shape::new(plane(0.0, true, 64.0), glass));
        scene.add_shape(Shape::new(plane(-0.125, false, 64.0), glass));
        for (y, up, radiance) in [(-1.0, true, below), (1.0, false, above)] {
            if radiance > 0.0 {
                let shape = Shape::new(plane(y, up, 256.0), black);
                scene.add_shape(shape.emitting(Vec3::splat(radiance)));
            }
        }
        let from = Vec3::new(0.125 * (1.0 - mu * mu).sqrt(), 0.125 * mu, 0.0);
        scene.camera = look_at(from, Vec3::ZERO, 2e-6);
        scene
    };
    for mu in [1.0, 0.5] {
        let r = reflectance(f64::from(mu));
        for (depth, terms) in [(3, 1), (40, 40)] {
            let truth = (1.0 - r).powi(2) * geometric(r * r, terms);
            assert_means(build(mu, 1.0, 0.0), shot(SIZE, depth, 1), truth);
        }
    }
    let mu = 0.125;
    let r = reflectance(f64::from(mu));
    for (depth, terms) in [(2, 0), (6, 2), (40, 40)] {
        let truth = r + (1.0 - r).powi(2) * r * geometric(r * r, terms);
        assert_means(build(mu, 0.0, 1.0), shot(SIZE, depth, 1), truth);
    }
    // Between two equal lights nothing is lost, and there is no noise.
    let stage = Stage::new(build(mu, 0.5, 0.5)).unwrap();
    for technique in ["bsdf:roulette=1000", "nee:roulette=1000"] {
        assert_exact(&picture(&stage, technique, shot(SIZE, 60, 2)), 0.5, 1e-5);
    }
}

/// O13. Point, spot and distant lights on Lambert and GGX surfaces have no noise: one value against
/// the formula in f64.
#[test]
fn o13_delta_lights_without_noise() {
    let to_light = DVec3::new(0.48, 0.8, 0.36).normalize();
    let distance = 2.5;
    let position = (to_light * distance).as_vec3();
    let (n, mu) = (DVec3::Y, 0.6);
    // As `receiver` places its camera.
    let wo = n * mu + Frame::from_normal(Vec3::Y).tangent.as_dvec3() * (1.0 - mu * mu).sqrt();
    let ggx = |alpha: f64| {
        let a2 = alpha * alpha;
        let h = (wo + to_light).normalize();
        let cos2 = h.dot(n).powi(2);
        let d = a2 / (PI * (cos2 * (a2 - 1.0) + 1.0).powi(2));
        let (o, i) = (wo.dot(n), to_light.dot(n));
        let root = |c: f64| (a2 + (1.0 - a2) * c * c).sqrt();
        let g = 2.0 * o * i / (i * root(o) + o * root(i));
        d * g / (4.0 * o)
    };
    let lambert = 0.8 * to_light.dot(n) / PI;
    let towards = along(position, -to_light.as_vec3());
    let intensity = Vec3::splat(3.0);
    let aside = along(position, (-to_light + DVec3::new(0.2, 0.1, 0.0)).normalize().as_vec3());
    let cosine = f64::from(-aside.matrix3.z_axis.dot(to_light.as_vec3().into()));
    let s = (cosine - 0.9) / (0.99 - 0.9);
    let spot = |falloff| LightKind::Spot { intensity, cos_inner: 0.99, cos_outer: 0.9, falloff };
    let by_distance = 3.0 / (distance * distance);
    let lights = [
        ("point", LightKind::Point { intensity }, towards, by_distance),
        ("distant", LightKind::Distant { irradiance: Vec3::splat(1.5) }, towards, 1.5),
        ("spot, inner cone", spot(SpotFalloff::Smoothstep), towards, by_distance),
        ("spot", spot(SpotFalloff::Smoothstep), aside, by_distance * s * s * (3.0 - 2.0 * s)),
        ("spot", spot(SpotFalloff::Quadratic), aside, by_distance * s * s),
    ];
    for (name, kind, place, irradiance) in lights {
        for alpha in [None, Some(0.5), Some(0.1)] {
            let mut scene = Scene::new(format!("O13 {name}"));
            let (material, value): (MaterialId, f64) = match alpha {
                None => (diffuse(&mut scene, 0.8), lambert),
                Some(alpha) => (metal(&mut scene, alpha as f32), ggx(alpha)),
            };
            receiver(&mut scene, Vec3::ZERO, Vec3::Y, mu as f32, material);
            light(&mut scene, kind, place);
            let stage = Stage::new(scene).unwrap();
            for technique in unbiased(&stage, &direct()) {
                // The spot's edge turns the rounding of a cosine into 10⁻⁵ of its value, the narrow
                // lobe that of the half vector.
                let tolerance = rounded(technique, 1e-5);
                assert_exact(&picture(&stage, technique, direct()), irradiance * value, tolerance);
            }
        }
    }
}

/// O13. A perfect mirror shows a lamp as it is, and never a point light.
#[test]
fn o13_mirror_without_noise() {
    let mut scene = Scene::new("O13 mirror");
    let mirror = metal(&mut scene, 0.0);
    receiver(&mut scene, Vec3::ZERO, Vec3::Y, 0.5, mirror);
    environment(&mut scene, Vec3::splat(0.75));
    let shot = shot(SIZE, 2, 2);
    let stage = Stage::new(scene.clone()).unwrap();
    for technique in unbiased(&stage, &shot) {
        assert_exact(&picture(&stage, technique, shot), 0.75, 1e-6);
    }
    scene.lights.clear();
    light(
        &mut scene,
        LightKind::Point { intensity: Vec3::ONE },
        along(Vec3::new(1.0, 1.0, 0.0), Vec3::Y),
    );
    let stage = Stage::new(scene).unwrap();
    for technique in unbiased(&stage, &shot) {
        assert!(picture(&stage, technique, shot).pixels.iter().all(|p| *p == Vec3::ZERO));
    }
}

/// O14. N equal lights at one distance send what one of N times the strength sends. Equal powers
/// make the choice noiseless too.
#[test]
fn o14_many_lights_are_one() {
    const N: u32 = 7;
    let ring = |i: u32| {
        let (s, c) = (f64::from(i) * 2.0 * PI / f64::from(N)).sin_cos();
        DVec3::new(c, 1.25, s).as_vec3()
    };
    let build = |lights: u32, intensity: f32| {
        let mut scene = Scene::new("O14");
        floor_at(&mut scene, Vec3::ZERO);
        for i in 0..lights {
            light(
                &mut scene,
                LightKind::Point { intensity: Vec3::splat(intensity) },
                Affine3A::from_translation(ring(i)),
            );
        }
        Stage::new(scene).unwrap()
    };
    let squared = 1.0 + 1.25 * 1.25;
    let truth = f64::from(N) * 1.25 / (squared * f64::sqrt(squared)) / PI;
    for (lights, intensity) in [(N, 1.0), (1, N as f32)] {
        let stage = build(lights, intensity);
        for technique in unbiased(&stage, &direct()) {
            let shown = picture(&stage, technique, shot(SIZE, 2, 4));
            assert_exact(&shown, truth, rounded(technique, 2e-6));
        }
    }
    // Lamps of unequal size, so that the choice is not uniform: spheres of radius r with F = (r/d)²
    // cos θ each.
    let mut scene = Scene::new("O14 spheres");
    floor_at(&mut scene, Vec3::ZERO);
    let black = diffuse(&mut scene, 0.0);
    let mut truth = 0.0;
    for i in 0..N {
        let radius = [0.4, 0.2, 0.3, 0.4, 0.1, 0.4, 0.3][i as usize];
        let geometry = Geometry::Sphere { center: ring(i), radius };
        scene.add_shape(Shape::new(geometry, black).emitting(Vec3::ONE));
        truth += f64::from(radius * radius) / squared * 1.25 / squared.sqrt();
    }
    assert_means(scene, direct(), truth);
}

/// O15. A von Mises–Fisher lobe in the sky over a receiver at cosine c to its axis: E = c (coth κ −
/// 1/κ), less e^(−κ c) at the horizon.
#[test]
fn o15_vmf_sky() {
    for (kappa, cosine) in [(20.0_f64, 0.8), (100.0, 0.6)] {
        let axis = DVec3::new(0.48, 0.64, 0.6);
        let n = {
            let across = Frame::from_normal(axis.as_vec3()).tangent.as_dvec3();
            (axis * cosine + across * f64::sqrt(1.0 - cosine * cosine)).normalize()
        };
        let mut scene = Scene::new(format!("O15 {kappa}"));
        let norm = kappa / (2.0 * PI * (1.0 - (-2.0 * kappa).exp()));
        sky(&mut scene, 256, |d| norm * (kappa * (d.dot(axis) - 1.0)).exp());
        let white = diffuse(&mut scene, 1.0);
        receiver(&mut scene, Vec3::ZERO, n.as_vec3(), 0.96, white);
        let truth = cosine * (1.0 / kappa.tanh() - 1.0 / kappa) / PI;
        assert_means(scene, direct(), truth);
    }
}

/// The kit itself: too few paths are inconclusive, never a pass.
#[test]
fn too_few_paths_decide_nothing() {
    let mut scene = Scene::new("few");
    ceiling(&mut scene, &[DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y], 1.0, 1.0);
    floor_at(&mut scene, Vec3::ZERO);
    let stage = Stage::new(scene).unwrap();
    let sample = restarts(&stage, "bsdf", shot([2, 2], 2, 1), 64);
    assert_eq!(against(&sample, sample.mean()).verdict, afterimage::stats::Verdict::Inconclusive);
}

/// A lamp that half of the rays pass through sends half: what light sampling, which traces no ray
/// to the lamp's own surface, must know by itself. A ball that shines both ways also shows the
/// inside of its far cap through the near one: L/2 + L/4.
#[test]
fn a_lamp_with_coverage_sends_that_share_of_its_light() {
    let stage = |alpha: Option<Scalar>, lamp_radiance: f32, ball_radiance: f32| {
        let mut scene = Scene::new("veiled lamps");
        let grey = diffuse(&mut scene, 0.5);
        let c = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        let floor = [c(-2.0, 0.0, -2.0), c(-2.0, 0.0, 2.0), c(2.0, 0.0, 2.0), c(2.0, 0.0, -2.0)];
        scene.add_shape(Shape::new(polygon(&floor), grey));
        let lamp = [c(0.2, 1.0, -0.4), c(1.0, 1.0, -0.4), c(1.0, 1.0, 0.4), c(0.2, 1.0, 0.4)];
        let ball = Geometry::Sphere { center: c(-0.6, 0.8, 0.0), radius: 0.3 };
        let black = diffuse(&mut scene, 0.0);
        for (geometry, radiance, two_sided) in
            [(polygon(&lamp), lamp_radiance, false), (ball, ball_radiance, alpha.is_some())]
        {
            let mut shape = Shape::new(geometry, black).emitting(Vec3::splat(radiance));
            shape.alpha = alpha;
            shape.emission.as_mut().unwrap().two_sided = two_sided;
            scene.add_shape(shape);
        }
        scene.camera = look_at(c(0.0, 0.5, -1.5), c(0.0, 0.0, -0.2), 0.6);
        Stage::new(scene).unwrap()
    };
    let veiled = stage(Some(Scalar::Constant(0.5)), 4.0, 4.0);
    let whole = stage(None, 2.0, 3.0);
    for spec in ["bsdf", "nee", "nee:lights=all", "ris", "restir-di"] {
        let shot = shot([12, 8], 2, 1);
        assert_same_mean((&veiled, shot), (&whole, shot), spec);
    }
}
