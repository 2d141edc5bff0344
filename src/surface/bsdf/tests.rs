//! All lobes under one harness.
//!
//! Statistical tests use fixed seeds and α = 10⁻⁶ each; with 5·10⁴ samples on 20 × 20 cells a
//! relative density error of 7 % (rms) is found with probability 0.99, and an error of the
//! density's integral of 0.1 % in any case. `planted_errors_are_found` is the control.

use std::f32::consts::FRAC_1_PI;

use super::*;
use crate::math::rng::{RandomSource, Stream};
use crate::stats::{Grid, check_sphere};

const ALPHA: f64 = 1e-6;

fn direction(cosine: f32, turn: f32) -> Vec3 {
    let (s, c) = crate::math::warp::sin_cos_turn(turn);
    let sine = (1.0 - cosine * cosine).sqrt();
    Vec3::new(sine * c, sine * s, cosine)
}

fn gltf(metallic: f32, roughness: f32, transmission: f32) -> Bsdf {
    Bsdf::metallic_roughness(&MetallicRoughness {
        base_color: Vec3::new(0.9, 0.5, 0.2),
        metallic,
        roughness,
        ior: 1.5,
        specular: 1.0,
        specular_color: Vec3::ONE,
        transmission,
        double_sided: true,
    })
}

/// One of each family, at roughness `α_x` = `alpha`, `α_y` = `alpha` / `anisotropy`.
fn families(alpha: f32, anisotropy: f32) -> Vec<(&'static str, Bsdf)> {
    let a = Vec2::new(alpha, alpha / anisotropy);
    let grey = Vec3::new(0.8, 0.5, 0.1);
    let conductor = Bsdf::conductor(Vec3::new(0.2, 0.92, 1.1), Vec3::new(3.9, 2.45, 2.14), a);
    let coated = Bsdf::coated_diffuse(grey, 1.5, a);
    vec![
        ("diffuse", Bsdf::diffuse(grey)),
        ("diffuse transmission", Bsdf::diffuse_transmission(0.5 * grey, 0.4 * grey)),
        ("conductor", conductor),
        ("metal", Bsdf::metal(grey, a)),
        ("dielectric", Bsdf::dielectric(1.5, a)),
        ("thin dielectric", Bsdf::thin_dielectric(1.5)),
        ("coated", coated),
        ("metallic-roughness", gltf(0.3, alpha.sqrt(), 0.4)),
        ("mix", Bsdf::mix(&conductor, &coated, 0.3).unwrap()),
        ("mix with deltas", Bsdf::mix(&Bsdf::dielectric(1.5, Vec2::ZERO), &coated, 0.7).unwrap()),
    ]
}

/// Views from both sides: α, anisotropy, cosine and side.
fn views() -> Vec<Vec3> {
    [1.0, 0.7, 0.1, 1e-3, -0.7, -0.1]
        .into_iter()
        .enumerate()
        .map(|(i, cosine)| direction(cosine, 0.07 + 0.13 * i as f32))
        .collect()
}

/// α of the smoothest lobe.
fn finest(bsdf: &Bsdf) -> f32 {
    (0..bsdf.lobe_count()).map(|lobe| bsdf.lobe_roughness(lobe)).fold(1.0, f32::min)
}

fn lobe_pdf(bsdf: &Bsdf, lobe: u32, wo: Vec3, wi: Vec3) -> f32 {
    bsdf.evaluate_lobe(lobe, wo, wi).pdf / bsdf.lobe_probability(lobe, wo)
}

fn uniform2(stream: &mut Stream) -> Vec2 {
    Vec2::new(stream.uniform(), stream.uniform())
}

fn words(stream: &mut Stream) -> [u32; 4] {
    std::array::from_fn(|_| stream.word())
}

/// Directional albedo of one or all lobes over a regular grid of u: Σ over lobes of the mean of
/// value/pdf times the lobe's probability.
fn albedo(bsdf: &Bsdf, wo: Vec3, grid: u32) -> Vec3 {
    let mut sum = glam::DVec3::ZERO;
    for lobe in 0..bsdf.lobe_count() {
        let probability = bsdf.lobe_probability(lobe, wo);
        if probability == 0.0 {
            continue;
        }
        if bsdf.is_delta(lobe) {
            let delta = each!(bsdf, lobes => lobes.delta(lobe, wo)).unwrap();
            sum += delta.value.as_dvec3();
            continue;
        }
        let mut mean = glam::DVec3::ZERO;
        for i in 0..grid * grid {
            let u = Vec2::new((i % grid) as f32 + 0.5, (i / grid) as f32 + 0.5) / grid as f32;
            if let Some(wi) = bsdf.direction(lobe, wo, u) {
                let e = bsdf.evaluate_lobe(lobe, wo, wi);
                if e.pdf > 0.0 {
                    mean += (e.value / (e.pdf / probability)).as_dvec3();
                }
            }
        }
        sum += mean / f64::from(grid * grid);
    }
    sum.as_vec3()
}

#[test]
fn every_lobe_samples_its_density() {
    let mut failures = Vec::new();
    for (alpha, anisotropy) in [(0.1, 1.0), (0.5, 10.0), (1.0, 1.0)] {
        for (name, bsdf) in families(alpha, anisotropy) {
            // Mixes have no direction map of their own; Lambert does not depend on roughness; a
            // metal is a conductor.
            if name == "metal"
                || name.starts_with("mix")
                || (name.starts_with("diffuse") && alpha != 1.0)
            {
                continue;
            }
            for wo in views() {
                for lobe in (0..bsdf.lobe_count()).filter(|&lobe| !bsdf.is_delta(lobe)) {
                    let mut stream = Stream::from_key(u64::from(lobe) << 8 | 5);
                    let mut grid = Grid::new(20, 20, 50_000);
                    if name == "dielectric" && lobe == 1 {
                        // Its integral is tested by `refraction_densities_integrate_to_one`.
                        grid.integral_tolerance = 5e-3;
                    }
                    let check = check_sphere(
                        grid,
                        || {
                            let wi = bsdf.direction(lobe, wo, uniform2(&mut stream))?;
                            assert!(lobe_pdf(&bsdf, lobe, wo, wi) > 0.0, "{name} {wo} {wi}");
                            Some(wi)
                        },
                        // The floor is for cells that only the rim of a refraction lobe reaches,
                        // between the nodes of their quadrature; it adds 10⁻⁷ to the integral.
                        |wi| lobe_pdf(&bsdf, lobe, wo, wi).max(1e-8),
                    );
                    if !check.agrees(ALPHA) {
                        failures.push(format!(
                            "{name}, alpha {alpha}/{anisotropy}, lobe {lobe}, wo {wo}: {check}"
                        ));
                    }
                }
            }
        }
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn refraction_densities_integrate_to_one() {
    for alpha in [0.5, 1.0] {
        let bsdf = Bsdf::dielectric(1.5, Vec2::splat(alpha));
        for wo in views() {
            let n = 1_000;
            let mut sum = 0.0;
            for i in 0..n * n {
                let u = Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) / n as f32;
                let d = crate::math::warp::sample_uniform_hemisphere(u);
                let wi = Vec3::new(d.x, d.y, -d.z.copysign(wo.z));
                sum += f64::from(lobe_pdf(&bsdf, 1, wo, wi));
            }
            let integral = sum * std::f64::consts::TAU / f64::from(n * n);
            let mut stream = Stream::from_key(8);
            let draws = 100_000;
            let kept = (0..draws)
                .filter(|_| bsdf.direction(1, wo, uniform2(&mut stream)).is_some())
                .count() as f64
                / f64::from(draws);
            // 4.5 standard errors of the share of draws that are not totally reflected.
            let noise = 4.5 * (kept * (1.0 - kept) / f64::from(draws)).sqrt();
            assert!((integral - kept).abs() < 2e-3 + noise, "{alpha} {wo}: {integral} {kept}");
        }
    }
}

#[test]
fn samples_follow_the_marginal_density() {
    for (name, bsdf) in families(0.3, 2.0) {
        if !bsdf.has_non_delta() {
            continue;
        }
        for wo in views() {
            // Deltas are drawn too but not binned: the rest has the share of the other lobes.
            let share: f32 = (0..bsdf.lobe_count())
                .filter(|&lobe| !bsdf.is_delta(lobe))
                .map(|lobe| bsdf.lobe_probability(lobe, wo))
                .sum();
            let mut stream = Stream::from_key(17);
            let check = check_sphere(
                Grid::new(20, 20, 50_000),
                || {
                    loop {
                        match bsdf.sample(wo, words(&mut stream)) {
                            Some(sample) if sample.delta => {}
                            other => return other.map(|sample| sample.wi),
                        }
                    }
                },
                |wi| (bsdf.evaluate(wo, wi).pdf / share).max(1e-8),
            );
            assert!(check.agrees(ALPHA), "{name}, wo {wo}: {check}");
        }
    }
}

#[test]
fn planted_errors_are_found() {
    let bsdf = Bsdf::metal(Vec3::ONE, Vec2::splat(0.5));
    let wo = direction(0.7, 0.1);
    let check = |pdf: &dyn Fn(Vec3) -> f32| {
        let mut stream = Stream::from_key(5);
        check_sphere(
            Grid::new(20, 20, 200_000),
            || bsdf.direction(0, wo, uniform2(&mut stream)),
            pdf,
        )
        .agrees(ALPHA)
    };
    let right = |wi| bsdf.evaluate(wo, wi).pdf;
    assert!(check(&right));
    assert!(!check(&|wi| 1.01 * right(wi)), "pdf 1 % too large");
    assert!(!check(&|wi| right(wi) * wi.z.abs().sqrt()), "a wrong power of the cosine");
    assert!(!check(&|wi| wi.z.max(0.0) * FRAC_1_PI), "the density of another lobe");
}

#[test]
fn inversion_and_jacobian() {
    let mut stream = Stream::from_key(3);
    for alpha in [1e-3, 0.01, 0.1, 0.5, 1.0] {
        for anisotropy in [1.0, 10.0] {
            for (name, bsdf) in families(alpha, anisotropy) {
                let finest = finest(&bsdf).max(1e-4);
                for wo in views() {
                    for lobe in (0..bsdf.lobe_count()).filter(|&lobe| !bsdf.is_delta(lobe)) {
                        for _ in 0..20 {
                            let u = Vec2::new(0.02, 0.02) + 0.96 * uniform2(&mut stream);
                            let at = |u| bsdf.direction(lobe, wo, u);
                            let Some(wi) = at(u) else { continue };
                            let context =
                                || format!("{name} {alpha}/{anisotropy} lobe {lobe} wo {wo} u {u}");
                            assert!(wi.is_normalized(), "{} {wi} {}", context(), wi.length());
                            if wi.z.abs() < 1e-5 {
                                continue;
                            }
                            let back = bsdf.invert(lobe, wo, wi);
                            let back = back.unwrap_or_else(|| {
                                panic!("no inverse {} {wi} {:?}", context(), bsdf.evaluate(wo, wi))
                            });
                            let mut error = (back - u).abs();
                            error.x = error.x.min(1.0 - error.x);
                            // o + η i is known to 2⁻²³ or so, its direction by that over its
                            // length, slopes relative to α.
                            let eta = each!(&bsdf, lobes => lobes.eta(lobe, wo));
                            let reflected = wi.z * wo.z > 0.0 || name == "metallic-roughness";
                            let side = if reflected { wi.z.abs().copysign(wo.z) } else { wi.z };
                            let sum = (wo + eta * Vec3::new(wi.x, wi.y, side)).length().min(1.0);
                            let tolerance = 2e-5 + 2e-6 / (finest * sum);
                            assert!(
                                error.x * u.y.sqrt() < tolerance && error.y < tolerance,
                                "{}: {back}",
                                context()
                            );
                            if let Some(again) = at(back) {
                                let error = (again - wi).length();
                                assert!(error < 2e-6 + 2e-6 / sum, "{} {error} {sum}", context());
                            }
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn density_is_one_over_the_jacobian() {
    let mut stream = Stream::from_key(4);
    let mut tried = 0;
    for (name, bsdf) in families(0.4, 1.5) {
        for wo in views().into_iter().filter(|wo| wo.z.abs() > 0.05) {
            for lobe in (0..bsdf.lobe_count()).filter(|&lobe| !bsdf.is_delta(lobe)) {
                for _ in 0..50 {
                    let u = Vec2::splat(0.05) + 0.9 * uniform2(&mut stream);
                    let at = |x: f32, y: f32| {
                        bsdf.direction(lobe, wo, u + Vec2::new(x, y)).map(|d| d.as_dvec3())
                    };
                    // Central differences at h and h/2, extrapolated (Richardson).
                    let difference = |h: f32, axis: Vec2| {
                        let d = at(h * axis.x, h * axis.y)? - at(-h * axis.x, -h * axis.y)?;
                        Some(d / f64::from(2.0 * h))
                    };
                    let derivative = |axis| {
                        let h = 1.0 / 128.0;
                        let (wide, fine) = (difference(h, axis)?, difference(0.5 * h, axis)?);
                        Some((4.0 * fine - wide) / 3.0)
                    };
                    let (Some(wi), Some(dx), Some(dy)) =
                        (at(0.0, 0.0), derivative(Vec2::X), derivative(Vec2::Y))
                    else {
                        continue;
                    };
                    if wi.z.abs() < 0.1 {
                        continue;
                    }
                    // The concentric map has creases on its diagonals.
                    let centred = (u - 0.5).abs();
                    if (centred.x - centred.y).abs() < 0.02 || centred.min_element() < 0.02 {
                        continue;
                    }
                    let jacobian = dx.cross(dy).length();
                    let product = jacobian * f64::from(lobe_pdf(&bsdf, lobe, wo, wi.as_vec3()));
                    tried += 1;
                    assert!(
                        (product - 1.0).abs() < 5e-3,
                        "{name} lobe {lobe} wo {wo} u {u}: {product}"
                    );
                }
            }
        }
    }
    assert!(tried > 1_000, "{tried}");
}

/// Each lobe has the roughness of its own kind, whatever stands beside it.
#[test]
fn lobes_have_a_roughness_each() {
    let alpha = Vec2::new(0.3, 0.1);
    let of = |bsdf: Bsdf| -> Vec<f32> {
        (0..bsdf.lobe_count()).map(|lobe| bsdf.lobe_roughness(lobe)).collect()
    };
    let coated = Bsdf::coated_diffuse(Vec3::ONE, 1.5, alpha);
    let glass = Bsdf::dielectric(1.5, Vec2::ZERO);
    assert_eq!(of(Bsdf::diffuse(Vec3::ONE)), [1.0]);
    assert_eq!(of(coated), [0.1, 1.0]);
    assert_eq!(of(Bsdf::dielectric(1.5, alpha)), [0.1, 0.1]);
    assert_eq!(of(glass), [0.0, 0.0]);
    assert_eq!(of(gltf(0.3, 0.5, 0.4)), [0.25, 1.0, 0.25]);
    assert_eq!(of(Bsdf::mix(&glass, &coated, 0.5).unwrap()), [0.0, 0.0, 0.1, 1.0]);
}

#[test]
fn samples_lobes_and_totals_agree() {
    let mut stream = Stream::from_key(9);
    for alpha in [0.0, 1e-3, 0.1, 1.0] {
        for (name, bsdf) in families(alpha, 1.0) {
            for wo in views() {
                let count = bsdf.lobe_count();
                let total: f32 = (0..count).map(|lobe| bsdf.lobe_probability(lobe, wo)).sum();
                assert!((total - 1.0).abs() < 1e-6, "{name}: probabilities sum to {total}");
                for _ in 0..200 {
                    let Some(sample) = bsdf.sample(wo, words(&mut stream)) else { continue };
                    let BsdfSample { wi, value, pdf, lobe, delta, transmission, .. } = sample;
                    assert_eq!(transmission, wo.z * wi.z < 0.0, "{name}");
                    assert_eq!(delta, bsdf.is_delta(lobe.into()), "{name}");
                    let evaluated = bsdf.evaluate(wo, wi);
                    if delta {
                        let p = bsdf.lobe_probability(lobe.into(), wo);
                        assert!((pdf / p - 1.0).abs() < 1e-5, "{name}");
                        assert_eq!(bsdf.evaluate_lobe(lobe.into(), wo, wi), Evaluation::ZERO);
                    } else {
                        assert_eq!((value, pdf), (evaluated.value, evaluated.pdf), "{name}");
                    }
                    let both = bsdf.evaluate_with_lobe(lobe.into(), wo, wi);
                    let joint = bsdf.evaluate_lobe(lobe.into(), wo, wi).pdf;
                    assert_eq!(both, (evaluated, joint), "{name}");
                    let lobes = (0..count).map(|lobe| bsdf.evaluate_lobe(lobe, wo, wi));
                    let sum = lobes.fold(Evaluation::ZERO, |sum, lobe| Evaluation {
                        value: sum.value + lobe.value,
                        pdf: sum.pdf + lobe.pdf,
                    });
                    let scale = evaluated.value.max_element();
                    assert!(
                        (sum.value - evaluated.value).abs().max_element() <= 1e-5 * scale
                            && (sum.pdf - evaluated.pdf).abs() <= 1e-5 * evaluated.pdf,
                        "{name} {alpha}: {sum:?} {evaluated:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn light_paths_are_reversible() {
    let mut stream = Stream::from_key(11);
    for (name, bsdf) in families(0.4, 3.0) {
        for _ in 0..2_000 {
            let wo = crate::math::warp::sample_uniform_sphere(uniform2(&mut stream));
            let wi = crate::math::warp::sample_uniform_sphere(uniform2(&mut stream));
            let forward = bsdf.evaluate(wo, wi).value / wi.z.abs();
            let backward = bsdf.evaluate(wi, wo).value / wo.z.abs();
            // f(o, i)/η_o² = f(i, o)/η_i² across an interface.
            let ratio = match (name, wo.z > 0.0, wi.z > 0.0) {
                ("dielectric", true, false) => 1.0 / 2.25,
                ("dielectric", false, true) => 2.25,
                _ => 1.0,
            };
            let difference = (forward - ratio * backward).abs().max_element();
            // F and D amplify the rounding of h where it is nearly perpendicular to either
            // direction.
            let eta = if ratio == 1.0 {
                1.0
            } else if wo.z > 0.0 {
                1.5
            } else {
                1.0 / 1.5
            };
            let h = (wo + eta * wi).normalize();
            let grazing = wo.dot(h).abs().min(wi.dot(h).abs());
            assert!(
                difference <= (1e-4 + 1e-5 / grazing) * forward.max_element() + 1e-7,
                "{name}: wo {wo}, wi {wi}: {forward} {backward}"
            );
        }
    }
}

#[test]
fn microfacets_lose_the_known_share_of_light() {
    // Directional albedo for F = 1, height-correlated Smith; computed by double-precision
    // quadrature of the same integral, three of them also over directions. For α = 1, μ = 1 it is 1
    // − ln 2.
    let known = [
        (0.1, [0.988_316, 0.969_214, 0.883_456]),
        (0.25, [0.915_813, 0.857_264, 0.891_621]),
        (0.5, [0.687_849, 0.698_251, 0.860_105]),
        (1.0, [0.306_853, 0.450_694, 0.760_210]),
    ];
    for (alpha, albedos) in known {
        for (mu, expected) in [1.0, 0.5, 0.1].into_iter().zip(albedos) {
            let bsdf = Bsdf::metal(Vec3::ONE, Vec2::splat(alpha));
            let found = albedo(&bsdf, direction(mu, 0.0), 500).x;
            assert!((found - expected).abs() < 3e-4, "alpha {alpha}, mu {mu}: {found} {expected}");
        }
    }
}

#[test]
fn white_surfaces_keep_and_never_add_light() {
    let white = |metallic: f32, roughness: f32, transmission: f32| {
        Bsdf::metallic_roughness(&MetallicRoughness {
            base_color: Vec3::ONE,
            metallic,
            roughness,
            ior: 1.5,
            specular: 1.0,
            specular_color: Vec3::ONE,
            transmission,
            double_sided: true,
        })
    };
    for mu in [1.0, 0.7, 0.3, 0.1, 0.02, 1e-3] {
        let wo = direction(mu, 0.2);
        let exact = |bsdf: Bsdf, name: &str, tolerance: f32| {
            let found = albedo(&bsdf, wo, 200).x;
            assert!((found - 1.0).abs() < tolerance, "{name} at {mu}: {found}");
        };
        exact(Bsdf::diffuse(Vec3::ONE), "Lambert", 1e-6);
        let half = Vec3::splat(0.5);
        exact(Bsdf::diffuse_transmission(half, half), "Lambert transmission", 1e-6);
        // k = 8192 is not yet a perfect mirror at grazing angles.
        exact(Bsdf::metal(Vec3::ONE, Vec2::ZERO), "mirror", 2e-4);
        exact(Bsdf::thin_dielectric(1.5), "pane", 1e-6);
        for alpha in [0.0, 0.05, 0.3, 1.0] {
            let coated = Bsdf::coated_diffuse(Vec3::ONE, 1.5, Vec2::splat(alpha));
            exact(coated, &format!("coated, alpha {alpha}"), 2e-3);
        }
        for roughness in [0.0, 0.2, 0.5, 0.8, 1.0] {
            for (metallic, transmission) in [(0.0, 0.0), (1.0, 0.0), (0.5, 0.5), (0.0, 1.0)] {
                let found = albedo(&white(metallic, roughness, transmission), wo, 100).x;
                let name = format!("glTF {metallic} {roughness} {transmission} at {mu}");
                assert!(found < 1.0 + 2e-5, "{name}: {found}");
                // A control of the bound: a smooth white surface keeps nearly all.
                if roughness == 0.0 {
                    assert!(found > 1.0 - 5e-3, "{name}: {found}");
                }
            }
        }
        for alpha in [1e-3, 0.1, 0.5, 1.0] {
            let bsdf = Bsdf::dielectric(1.5, Vec2::splat(alpha));
            // Radiance is larger inside: count it with η².
            for (wo, eta) in [(wo, 1.5f32), (-wo, 1.0 / 1.5)] {
                let reflection = albedo_of_lobe(&bsdf, 0, wo);
                let refraction = albedo_of_lobe(&bsdf, 1, wo) * eta * eta;
                let found = reflection + refraction;
                assert!(found < 1.0 + 1e-3, "glass {alpha} at {mu}: {found}");
                assert!(alpha > 1e-3 || mu < 0.1 || found > 0.99, "glass {alpha} at {mu}: {found}");
            }
        }
    }
}

fn albedo_of_lobe(bsdf: &Bsdf, lobe: u32, wo: Vec3) -> f32 {
    let grid = 200;
    let mut sum = 0.0;
    for i in 0..grid * grid {
        let u = Vec2::new((i % grid) as f32 + 0.5, (i / grid) as f32 + 0.5) / grid as f32;
        if let Some(wi) = bsdf.direction(lobe, wo, u) {
            let e = bsdf.evaluate_lobe(lobe, wo, wi);
            if e.pdf > 0.0 {
                sum += f64::from(e.value.x / e.pdf * bsdf.lobe_probability(lobe, wo));
            }
        }
    }
    (sum / f64::from(grid * grid)) as f32
}

#[test]
fn slab_of_glass_passes_the_known_share() {
    // T = (1 − R)/(1 + R), ρ = 2R/(1 + R): R = 0.04 and, at 60 degrees, 0.0891867.
    for (mu, transmitted, reflected) in
        [(1.0, 0.923_076_9, 0.076_923_1), (0.5, 0.836_232_5, 0.163_767_5)]
    {
        let bsdf = Bsdf::dielectric(1.5, Vec2::ZERO);
        let step = |lobe: u32, wo: Vec3| {
            let sample = each!(&bsdf, lobes => lobes.delta(lobe, wo)).unwrap();
            (sample.wi, f64::from(sample.value.x))
        };
        let wo = direction(mu, 0.3);
        let (_, mirrored) = step(0, wo);
        let (inside, mut throughput) = step(1, wo);
        // The path goes down: at the lower face it is seen from above, from inside of the glass,
        // whose normal there points down.
        let (mut back, mut forth) = (mirrored, 0.0_f64);
        let view = -inside;
        let flipped = Vec3::new(view.x, view.y, -view.z);
        assert!(flipped.z < 0.0);
        for bounce in 0..200 {
            let (out, passed) = step(1, flipped);
            assert!((out.z.abs() - mu).abs() < 1e-5, "leaves parallel to where it came from");
            let (_, kept) = step(0, flipped);
            if bounce % 2 == 0 {
                forth += throughput * passed;
            } else {
                back += throughput * passed;
            }
            throughput *= kept;
        }
        assert!((forth - transmitted).abs() < 1e-5, "{forth}");
        assert!((back - reflected).abs() < 1e-5, "{back}");
        let pane = Bsdf::thin_dielectric(1.5);
        assert!((f64::from(pane.lobe_probability(1, wo)) - transmitted).abs() < 1e-6);
    }
}

#[test]
fn nothing_changes_at_the_smooth_threshold() {
    for wo in [1.0, 0.7, 0.1, -0.9].map(|mu| direction(mu, 0.1)) {
        let pair = |make: &dyn Fn(Vec2) -> Bsdf| {
            let (smooth, rough) = (make(Vec2::splat(0.999e-3)), make(Vec2::splat(1.001e-3)));
            assert_eq!((finest(&smooth), finest(&rough)), (0.0, 1.001e-3));
            let (a, b) = (albedo(&smooth, wo, 100), albedo(&rough, wo, 100));
            assert!((a - b).abs().max_element() < 1e-2 * a.max_element(), "{wo}: {a} {b}");
            assert_eq!(smooth.lobe_count(), rough.lobe_count());
        };
        pair(&|a| Bsdf::metal(Vec3::new(0.9, 0.5, 0.1), a));
        pair(&|a| Bsdf::dielectric(1.5, a));
        pair(&|a| Bsdf::coated_diffuse(Vec3::splat(0.5), 1.5, a));
    }
}

#[test]
fn extremes_stay_finite() {
    let a = |x: f32| Vec2::splat(x);
    let mut cases: Vec<(String, Bsdf)> = Vec::new();
    for alpha in [0.0, 1e-6, 1e-4, 1e-3, 0.5, 1.0] {
        for (name, bsdf) in families(alpha, 1.0) {
            cases.push((format!("{name} {alpha}"), bsdf));
        }
        for eta in [1.0, 1.0 + 1e-6, 1.0 - 1e-6, 1.002, 0.5, 4.0] {
            cases.push((format!("dielectric {alpha} {eta}"), Bsdf::dielectric(eta, a(alpha))));
        }
    }
    cases.push(("black".into(), Bsdf::diffuse(Vec3::ZERO)));
    cases.push(("black metal".into(), Bsdf::metal(Vec3::ZERO, a(0.3))));
    cases.push(("one-channel metal".into(), Bsdf::metal(Vec3::new(1.0, 1e-6, 0.0), a(0.3))));
    cases.push(("needle".into(), Bsdf::metal(Vec3::ONE, Vec2::new(1.0, 1e-3))));
    cases.push(("coat of index 1".into(), Bsdf::coated_diffuse(Vec3::ONE, 1.0, a(0.3))));
    cases.push(("dense coat".into(), Bsdf::coated_diffuse(Vec3::ONE, 30.0, a(0.3))));
    cases.push(("rough".into(), Bsdf::metal(Vec3::ONE, a(5.0))));
    let mut stream = Stream::from_key(21);
    for (name, bsdf) in cases {
        for cosine in [1.0, 0.745_356, 0.1, 1e-4, 1e-7, 1e-30, 0.0, -0.0, -1e-7, -0.745_356, -1.0] {
            let wo = direction(cosine, 0.3);
            for i in 0..300u32 {
                let mut words = words(&mut stream);
                if i % 3 == 0 {
                    words[1] = if i % 2 == 0 { 0 } else { u32::MAX };
                    words[2] = if i % 4 < 2 { 0 } else { u32::MAX };
                }
                let Some(sample) = bsdf.sample(wo, words) else { continue };
                assert!(cosine != 0.0, "{name}: nothing is seen edge-on");
                let weight = sample.value / sample.pdf;
                assert!(
                    sample.wi.is_normalized() && sample.pdf > 0.0 && sample.pdf.is_finite(),
                    "{name} at {cosine}: {sample:?}"
                );
                assert!(weight.is_finite() && weight.min_element() >= 0.0, "{name}: {sample:?}");
                // Apart from 1/η², a lobe's weight is at most 1 over its least probability.
                let weight = weight.max_element() * sample.eta * sample.eta;
                assert!(weight <= 25.0, "{name} at {cosine}: {sample:?}");
            }
            for _ in 0..50 {
                let wi = crate::math::warp::sample_uniform_sphere(uniform2(&mut stream));
                for wi in [wi, wo, -wo, Vec3::new(-wo.x, -wo.y, wo.z), Vec3::X] {
                    let e = bsdf.evaluate(wo, wi);
                    assert!(
                        e.value.is_finite() && e.pdf.is_finite() && e.value.min_element() >= 0.0,
                        "{name} at {cosine}, wi {wi}: {e:?}"
                    );
                    assert!(e.value == Vec3::ZERO || e.pdf > 0.0, "{name} at {cosine}, wi {wi}");
                }
            }
        }
    }
}

#[test]
fn rough_and_smooth_white_mirrors_have_bounded_weights() {
    let mut stream = Stream::from_key(2);
    for alpha in [1e-3, 0.1, 1.0] {
        let bsdf = Bsdf::metal(Vec3::ONE, Vec2::splat(alpha));
        for cosine in [1.0, 0.1, 1e-4, 1e-7] {
            for _ in 0..1_000 {
                if let Some(s) = bsdf.sample(direction(cosine, 0.9), words(&mut stream)) {
                    assert!((s.value / s.pdf).max_element() <= 1.0 + 1e-5, "{alpha} {cosine}");
                }
            }
        }
    }
}

#[test]
fn rare_lobes_are_chosen_as_often_as_stated() {
    // A mirror of weight 10⁻⁶ over Lambert: the lobe's words are exactly those below 10⁻⁶ · 2³².
    let mirror = Bsdf::metal(Vec3::ONE, Vec2::ZERO);
    let bsdf = Bsdf::mix(&mirror, &Bsdf::diffuse(Vec3::splat(0.5)), 1.0 - 1e-6).unwrap();
    let wo = direction(0.5, 0.0);
    let p = f64::from(bsdf.lobe_probability(0, wo));
    assert!((p / 1e-6 - 1.0).abs() < 0.06, "1 − 1e-6 in single precision: {p}");
    let edge = (p * 4_294_967_296.0) as u32;
    let chosen = |word: u32| bsdf.sample(wo, [word, 1 << 31, 1 << 30, 0]).unwrap();
    assert!(chosen(0).delta && chosen(edge - 1).delta);
    assert!(!chosen(edge + 1).delta && !chosen(u32::MAX).delta);
    // The joint density of the other lobe carries the rest of the probability.
    let wi = direction(0.8, 0.3);
    let joint = bsdf.evaluate_lobe(1, wo, wi).pdf;
    assert!((joint - (1.0 - 1e-6) * 0.8 * FRAC_1_PI).abs() < 1e-6);
}

#[test]
fn black_backs_and_black_surfaces() {
    let mut parameters = MetallicRoughness {
        base_color: Vec3::ONE,
        metallic: 0.5,
        roughness: 0.5,
        ior: 1.5,
        specular: 1.0,
        specular_color: Vec3::ONE,
        transmission: 0.5,
        double_sided: false,
    };
    let (front, back) = (direction(0.6, 0.1), direction(-0.6, 0.1));
    let one_sided = Bsdf::metallic_roughness(&parameters);
    assert!(one_sided.sample(back, [7, 1 << 31, 1 << 29, 0]).is_none());
    assert_eq!(one_sided.evaluate(back, direction(-0.5, 0.4)), Evaluation::ZERO);
    assert!(one_sided.evaluate(front, direction(0.5, 0.4)).pdf > 0.0);
    parameters.double_sided = true;
    let two_sided = Bsdf::metallic_roughness(&parameters);
    assert!(two_sided.evaluate(back, direction(-0.5, 0.4)).pdf > 0.0);
    assert!(Bsdf::diffuse(Vec3::ZERO).is_black() && !one_sided.is_black());
    assert!(Bsdf::metal(Vec3::ZERO, Vec2::ONE).is_black());
    let mix = Bsdf::mix(&Bsdf::diffuse(Vec3::ZERO), &Bsdf::diffuse(Vec3::ONE), 0.25).unwrap();
    assert!(!mix.is_black() && mix.lobe_probability(1, front) == 1.0);
    assert!(Bsdf::mix(&mix, &two_sided, 0.5).is_none());
}

#[test]
fn a_metal_of_one_colour_reflects_that_colour() {
    // Each channel alone, down to 10⁻⁶, at normal incidence.
    let color = Vec3::new(0.9, 1e-3, 1e-6);
    let smooth = Bsdf::metal(color, Vec2::ZERO);
    let found = smooth.sample(Vec3::Z, [0; 4]).unwrap().value;
    assert!(((found / color) - 1.0).abs().max_element() < 1e-3, "{found}");
    assert!((smooth.albedo() - color).abs().max_element() < 1e-5);
}

#[test]
fn reflection_probability_of_glass_is_near_the_reflected_share() {
    // The estimate only steers effort; a bad one wastes it.
    for alpha in [0.05, 0.3, 0.7] {
        let bsdf = Bsdf::dielectric(1.5, Vec2::splat(alpha));
        for mu in [0.9, 0.6, 0.3, -0.9, -0.7, -0.5, -0.2] {
            let wo = direction(mu, 0.0);
            let (r, p) = (albedo_of_lobe(&bsdf, 0, wo), bsdf.lobe_probability(0, wo));
            let eta2 = if mu > 0.0 { 2.25 } else { 1.0 / 2.25 };
            let t = albedo_of_lobe(&bsdf, 1, wo) * eta2;
            // Second moment of the weight of an ideal lobe choice is (r + t)².
            let moment = r * r / p + t * t / (1.0 - p);
            assert!(moment < 1.5 * (r + t) * (r + t), "{alpha} {mu}: {r} of {p}, {t}");
        }
    }
}

#[test]
fn lanes_have_the_bits_of_single_directions() {
    let mut stream = Stream::from_key(4);
    for (name, bsdf) in families(0.3, 2.0) {
        for wo in views() {
            let mut wi = Lanes3::ZERO;
            for lane in 0..LANES {
                let up = direction(2.0 * stream.uniform() - 1.0, stream.uniform());
                wi.set(lane, up.to_array());
            }
            let alive = Mask::of(|lane| lane % 3 != 1);
            let (value, pdf) = bsdf.evaluate_lanes(wo, &wi, alive);
            for lane in (0..LANES).filter(|lane| alive.get(*lane)) {
                let one = bsdf.evaluate(wo, wi.get(lane));
                let lanes = Evaluation { value: value.get(lane), pdf: pdf.0[lane] };
                assert_eq!(lanes, one, "{name}, {wo}");
            }
        }
    }
}
