//! Rates of the direction maps and of the lobes: sample and evaluate, one thread, directions a
//! second.

use std::hint::black_box;

use afterimage::math::rng::{Stream, unit_float};
use afterimage::math::{vmf, warp};
use afterimage::surface::bsdf::{Bsdf, MetallicRoughness};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{Vec2, Vec3};

const COUNT: usize = 1024;

fn words() -> Vec<[u32; 4]> {
    let mut stream = Stream::from_key(1);
    (0..COUNT).map(|_| std::array::from_fn(|_| stream.word())).collect()
}

fn warps(c: &mut Criterion) {
    let points: Vec<Vec2> =
        words().iter().map(|w| Vec2::new(unit_float(w[0]), unit_float(w[1]))).collect();
    let mut group = c.benchmark_group("warps");
    group.throughput(Throughput::Elements(COUNT as u64));
    let mut row = |name: &str, map: &dyn Fn(&[Vec2]) -> Vec3| {
        group.bench_function(name, |b| b.iter(|| map(black_box(&points))));
    };
    row("cosine_hemisphere", &|p| p.iter().map(|u| warp::sample_cosine_hemisphere(*u)).sum());
    // The same density by polar coordinates, for comparison.
    row("cosine_hemisphere_polar", &|p| {
        p.iter()
            .map(|u| {
                let (s, c) = warp::sin_cos_turn(u.y);
                let r = u.x.sqrt();
                Vec3::new(r * c, r * s, (1.0 - u.x).sqrt())
            })
            .sum()
    });
    row("uniform_sphere", &|p| p.iter().map(|u| warp::sample_uniform_sphere(*u)).sum());
    row("uniform_cone", &|p| p.iter().map(|u| warp::sample_uniform_cone(1e-3, *u)).sum());
    row("uniform_triangle", &|p| p.iter().map(|u| warp::sample_uniform_triangle(*u)).sum());
    row("vmf", &|p| p.iter().map(|u| vmf::sample_vmf(100.0, *u)).sum());
}

fn lobes(c: &mut Criterion) {
    let words = words();
    let wo = Vec3::new(0.48, -0.36, 0.8);
    let alpha = Vec2::splat(0.3);
    let grey = Vec3::splat(0.5);
    let metallic = MetallicRoughness {
        base_color: grey,
        metallic: 0.2,
        roughness: 0.5,
        ior: 1.5,
        specular: 1.0,
        specular_color: Vec3::ONE,
        transmission: 0.0,
        double_sided: true,
    };
    let rows = [
        ("diffuse", Bsdf::diffuse(grey)),
        ("conductor", Bsdf::metal(grey, alpha)),
        ("mirror", Bsdf::metal(grey, Vec2::ZERO)),
        ("dielectric", Bsdf::dielectric(1.5, alpha)),
        ("glass", Bsdf::dielectric(1.5, Vec2::ZERO)),
        ("coated", Bsdf::coated_diffuse(grey, 1.5, alpha)),
        ("metallic_roughness", Bsdf::metallic_roughness(&metallic)),
    ];
    let mut group = c.benchmark_group("lobes");
    group.throughput(Throughput::Elements(COUNT as u64));
    for (name, bsdf) in rows {
        group.bench_function(format!("{name}/sample"), |b| {
            b.iter(|| {
                let bsdf = black_box(&bsdf);
                words
                    .iter()
                    .filter_map(|w| bsdf.sample(wo, *w))
                    .map(|s| s.value / s.pdf)
                    .sum::<Vec3>()
            });
        });
        let directions: Vec<Vec3> =
            words.iter().filter_map(|w| bsdf.sample(wo, *w)).map(|s| s.wi).collect();
        group.bench_function(format!("{name}/evaluate"), |b| {
            b.iter(|| {
                let bsdf = black_box(&bsdf);
                directions.iter().map(|wi| bsdf.evaluate(wo, *wi).value).sum::<Vec3>()
            });
        });
    }
}

criterion_group!(benches, warps, lobes);
criterion_main!(benches);
