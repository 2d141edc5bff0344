//! Functions of numbers: random words, frames, warps, reservoirs, what visibility keeps.

use glam::{Vec2, Vec3};

use super::{N, bits, close, device, empty, float, run, run_changed, unit, word};
use crate::math::rng::{
    PathSeeds, Purpose, RandomSource, Stream, draw4, path_seed, pcg4d, stream_key,
};
use crate::math::{Frame, luminance, octahedral_decode, octahedral_encode, offset_origin, warp};
use crate::resampling::{Plain, Reservoir, WithVisibility, mutated_weight};
use crate::reuse::{
    Control, Reused,
    policy::{pack_average, unpack_average},
};

fn split(key: u64) -> [u32; 2] {
    [key as u32, (key >> 32) as u32]
}

const RNG: &str = "
fn test(i: u32) {
    let v = vec4<u32>(input(i, 0u), input(i, 1u), input(i, 2u), input(i, 3u));
    let p = pcg4d(v);
    output(i, 0u, p.x); output(i, 1u, p.y); output(i, 2u, p.z); output(i, 3u, p.w);
    let d = draw4(v.xy, v.z, v.w);
    output(i, 4u, d.x); output(i, 5u, d.y); output(i, 6u, d.z); output(i, 7u, d.w);
    let k = stream_key(v.xy, v.z, v.w, PURPOSE_SELECTION, input(i, 4u));
    output(i, 8u, k.x); output(i, 9u, k.y);
    let s = path_seed(v.xy, v.z, v.w, input(i, 4u));
    output(i, 10u, s.x); output(i, 11u, s.y);
    var stream = stream_new(v.xy, v.z, v.w, PURPOSE_NEIGHBOURS, input(i, 4u));
    for (var k = 0u; k < 6u; k++) { output(i, 12u + k, stream_word(&stream)); }
    output_float(i, 18u, stream_uniform(&stream));
    output(i, 19u, stream_index(&stream, max(input(i, 5u), 1u)));
    output(i, 20u, select(0u, 1u, stream_choose(&stream, input_float(i, 6u), input_float(i, 7u))));
    let w = wide_product(v.x, v.y);
    output(i, 21u, w.x); output(i, 22u, w.y);
    let q = second_round(pcg4d(v), PURPOSE_PATH_SEED, input(i, 4u));
    output(i, 23u, q.x); output(i, 24u, q.y);
    output(i, 25u, select(0u, 1u, is_below(input(i, 8u), input_float(i, 6u), input_float(i, 7u))));
}";

fn rng_inputs() -> Vec<u32> {
    let mut random = Stream::from_key(1);
    let mut inputs = Vec::new();
    for i in 0..N {
        for k in 0..6 {
            inputs.push(word(&mut random, i + 5 * k));
        }
        // Weights from much smaller than the total to equal.
        let total = (random.uniform() * 60.0 - 30.0).exp2();
        let weight = match i % 8 {
            0 => total,
            1 => 0.0,
            2 => total * (1.0 - f32::EPSILON),
            _ => total * (-40.0 * random.uniform() * random.uniform()).exp2(),
        };
        inputs.extend(bits(&[weight, total]));
        // Words near the decision, where every bit counts.
        let share = (f64::from(weight) / f64::from(total) * 4_294_967_296.0).min(4_294_967_295.0);
        let near = (share as i64 + (i as i64 % 5) - 2).clamp(0, 4_294_967_295);
        inputs.push(near as u32);
    }
    inputs
}

#[test]
fn random_numbers_are_the_same_bits() {
    let Some(gpu) = device() else { return };
    let inputs = rng_inputs();
    let found = run(&gpu, &empty(), RNG, (&inputs, 9), 26);
    let mut undecided = 0;
    for (i, (v, f)) in inputs.chunks(9).zip(found.chunks(26)).enumerate() {
        let seed = u64::from(v[0]) | u64::from(v[1]) << 32;
        assert_eq!(f[..4], pcg4d([v[0], v[1], v[2], v[3]]), "{i}");
        assert_eq!(f[4..8], draw4(seed, v[2], v[3]), "{i}");
        assert_eq!(f[8..10], split(stream_key(seed, v[2], v[3], Purpose::Selection, v[4])), "{i}");
        assert_eq!(f[10..12], split(path_seed(seed, v[2], v[3], v[4])), "{i}");
        let mut stream = Stream::new(seed, v[2], v[3], Purpose::Neighbours, v[4]);
        let words: Vec<u32> = (0..6).map(|_| stream.word()).collect();
        assert_eq!(f[12..18], words, "{i}");
        assert_eq!(f[18], stream.uniform().to_bits(), "{i}");
        assert_eq!(f[19], stream.index(v[5].max(1)), "{i}");
        assert_eq!(f[20], u32::from(stream.choose(float(v[6]), float(v[7]))), "{i}");
        let product = u64::from(v[0]) * u64::from(v[1]);
        assert_eq!(f[21..23], [(product >> 32) as u32, product as u32], "{i}");
        assert_eq!(f[23..25], split(PathSeeds::new(seed, v[2], v[3]).seed(v[4])), "{i}");
        let u = f64::from(v[8]) * (1.0 / 4_294_967_296.0);
        let here = u * f64::from(float(v[7])) < f64::from(float(v[6]));
        // The product of 32 and 24 bits does not fit 53: where it is rounded to the weight itself,
        // either answer is right.
        if u * f64::from(float(v[7])) == f64::from(float(v[6])) {
            undecided += 1;
        } else {
            assert_eq!(f[25], u32::from(here), "{i}: {} of {}", float(v[6]), float(v[7]));
        }
    }
    assert!(undecided < N / 4, "{undecided}");
}

/// The control of the test above and of all that compare streams: another purpose is found at once.
#[test]
fn a_stream_of_another_purpose_is_found() {
    let Some(gpu) = device() else { return };
    let inputs = rng_inputs();
    let right = run(&gpu, &empty(), RNG, (&inputs, 9), 26);
    let wrong = run_changed(&gpu, &empty(), RNG, (&inputs, 9), 26, |text| {
        text.replace("PURPOSE_SELECTION: u32 = 3u", "PURPOSE_SELECTION: u32 = 4u")
    });
    let differ = right.chunks(26).zip(wrong.chunks(26)).filter(|(a, b)| a[8] != b[8]).count();
    assert!(differ > N - 2, "{differ} of {N} keys differ");
}

#[test]
fn frames_codes_and_offsets_agree() {
    let Some(gpu) = device() else { return };
    let mut random = Stream::from_key(2);
    let mut inputs = Vec::new();
    for i in 0..N {
        let mut n =
            warp::sample_uniform_sphere(Vec2::new(unit(&mut random, i), unit(&mut random, i / 2)));
        if i < 6 {
            n = [Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z][i];
        }
        let scale = (random.uniform() * 40.0 - 20.0).exp2();
        let v = scale
            * Vec3::new(random.uniform() - 0.5, random.uniform() - 0.5, random.uniform() - 0.5);
        let error = v.abs() * 1e-6;
        inputs.extend(bits(&n.to_array()));
        inputs.extend(bits(&v.to_array()));
        inputs.extend(bits(&error.to_array()));
    }
    let body = "
    fn test(i: u32) {
        let n = input_vector(i, 0u);
        let v = input_vector(i, 3u);
        let f = frame_from_normal(n);
        output_vector(i, 0u, f.tangent); output_vector(i, 3u, f.bitangent);
        output_vector(i, 6u, to_local(f, v)); output_vector(i, 9u, to_world(f, v));
        let p = octahedral_encode(n);
        output_float(i, 12u, p.x); output_float(i, 13u, p.y);
        output_vector(i, 14u, octahedral_decode(p));
        output_vector(i, 17u, offset_origin(v, n, input_vector(i, 6u)));
        output_float(i, 20u, luminance(v));
        output_vector(i, 21u, unit(v));
        let g = frame_from_normal_and_tangent(n, v);
        output_vector(i, 24u, g.tangent);
        output(i, 27u, select(0u, 1u, is_finite(v.x)) | select(0u, 2u, is_finite(v.x / (v.y - v.y))));
    }";
    let found = run(&gpu, &empty(), body, (&inputs, 9), 28);
    for (i, (v, f)) in inputs.chunks(9).zip(found.chunks(28)).enumerate() {
        let at = |k: usize| Vec3::new(float(v[k]), float(v[k + 1]), float(v[k + 2]));
        let (n, v, error) = (at(0), at(3), at(6));
        let frame = Frame::from_normal(n);
        let p = octahedral_encode(n);
        let tangent = Frame::from_normal_and_tangent(n, v).tangent;
        let decoded = octahedral_decode(p);
        let (local, world) = (frame.to_local(v), frame.to_world(v));
        let moved = offset_origin(v, n, error);
        let size = v.length();
        let check = |what: &str, at: usize, wanted: Vec3, scale: f32| {
            for (k, w) in wanted.to_array().into_iter().enumerate() {
                close(&format!("{what} {i}"), float(f[at + k]), w, 4e-6, scale);
            }
        };
        check("tangent", 0, frame.tangent, 1.0);
        check("bitangent", 3, frame.bitangent, 1.0);
        check("local", 6, local, size);
        check("world", 9, world, size);
        check("code", 12, p.extend(float(f[14])), 1.0);
        check("decoded", 14, decoded, 1.0);
        check("offset", 17, moved, 0.0);
        close("luminance", float(f[20]), luminance(v), 1e-6, size);
        check("unit", 21, v.normalize(), 1.0);
        check("tangent of two", 24, tangent, 1.0);
        assert_eq!(f[27] & 1, 1, "{i}");
    }
}

#[test]
fn warps_agree() {
    let Some(gpu) = device() else { return };
    let mut random = Stream::from_key(3);
    let mut inputs = Vec::new();
    for i in 0..N {
        let opening = (-20.0 * random.uniform()).exp2() * 2.0;
        inputs.extend(bits(&[unit(&mut random, i), unit(&mut random, i / 3), opening]));
    }
    let body = "
    fn test(i: u32) {
        let u = vec2f(input_float(i, 0u), input_float(i, 1u));
        let sc = sin_cos_turn(u.x);
        output_float(i, 0u, sc.x); output_float(i, 1u, sc.y);
        let d = sample_disk(u);
        output_float(i, 2u, d.x); output_float(i, 3u, d.y);
        let back = invert_disk(d);
        output_float(i, 4u, back.x); output_float(i, 5u, back.y);
        output_vector(i, 6u, sample_cosine_hemisphere(u));
        let s = sample_uniform_sphere(u);
        output_vector(i, 9u, s);
        let sphere = invert_uniform_sphere(s);
        output_float(i, 12u, sphere.x); output_float(i, 13u, sphere.y);
        output_vector(i, 14u, sample_uniform_cone(input_float(i, 2u), u));
        output_float(i, 17u, uniform_cone_pdf(input_float(i, 2u)));
        let b = sample_uniform_triangle(u);
        output_vector(i, 18u, b);
        let t = invert_uniform_triangle(b);
        output_float(i, 21u, t.x); output_float(i, 22u, t.y);
        output_float(i, 23u, turn_of(d.x, d.y));
        output_float(i, 24u, one_minus_z(s));
    }";
    let found = run(&gpu, &empty(), body, (&inputs, 3), 25);
    for (v, f) in inputs.chunks(3).zip(found.chunks(25)) {
        let u = Vec2::new(float(v[0]), float(v[1]));
        let opening = float(v[2]);
        let disk = warp::sample_disk(u);
        let back = warp::invert_disk(Vec2::new(float(f[2]), float(f[3])));
        let sphere = warp::sample_uniform_sphere(u);
        let on_device = Vec3::new(float(f[9]), float(f[10]), float(f[11]));
        let sphere_back = warp::invert_uniform_sphere(on_device);
        let (sin, cos) = warp::sin_cos_turn(u.x);
        let b = warp::sample_uniform_triangle(u);
        let t = warp::invert_uniform_triangle(b);
        let cone = warp::sample_uniform_cone(opening, u);
        let cosine = warp::sample_cosine_hemisphere(u);
        let mut wanted = vec![sin, cos, disk.x, disk.y, back.x, back.y];
        wanted.extend(cosine.to_array());
        wanted.extend(sphere.to_array());
        wanted.extend(sphere_back.to_array());
        wanted.extend(cone.to_array());
        wanted.push(warp::uniform_cone_pdf(opening));
        wanted.extend(b.to_array());
        wanted.extend(t.to_array());
        wanted.push(warp::turn_of(float(f[2]), float(f[3])));
        wanted.push(warp::one_minus_z(on_device));
        for (k, w) in wanted.iter().enumerate() {
            // A turn of almost 1 and one of 0 are the same place.
            let turn = matches!(k, 13 | 23) && (float(f[k]) - w).abs() > 0.999_99;
            // At a pole an azimuth means nothing.
            let pole = k == 13 && sphere.x.abs().max(sphere.y.abs()) < 1e-5;
            if !turn && !pole {
                close(&format!("warp {k} of {u}"), float(f[k]), *w, 3e-6, 1.0);
            }
        }
    }
}

#[test]
fn reservoirs_and_weights_agree() {
    let Some(gpu) = device() else { return };
    let mut random = Stream::from_key(4);
    let mut inputs = Vec::new();
    for i in 0..N {
        inputs.extend([random.word(), random.word()]);
        for k in 0..5 {
            let weight = match (i + k) % 11 {
                0 => 0.0,
                1 => f32::MAX,
                2 => 1e-30,
                3 => f32::NAN,
                4 => -1.0,
                _ => (random.uniform() * 30.0 - 15.0).exp2(),
            };
            inputs.push(weight.to_bits());
        }
        inputs.extend(bits(&[random.uniform(), random.uniform() + 1e-3, random.uniform() + 1e-3]));
    }
    let body = "
    fn test(i: u32) {
        var random = stream_from_key(vec2<u32>(input(i, 0u), input(i, 1u)));
        var r = reservoir_new();
        var selected = NONE;
        for (var k = 0u; k < 5u; k++) {
            if reservoir_stream(&r, input_float(i, 2u + k), f32(k) / 4.0, vec3f(0.0), &random) { selected = k; }
        }
        output(i, 0u, selected);
        output_float(i, 1u, r.weight_sum);
        output(i, 2u, r.rejected);
        output_float(i, 3u, reservoir_visibility(r));
        output_float(i, 4u, contribution_weight(r.weight_sum, input_float(i, 7u), 2.0));
        output_float(i, 5u, mutated_weight(input_float(i, 7u), input_float(i, 8u), input_float(i, 9u)));
        let p = Pairwise(input_float(i, 7u), input_float(i, 8u), (i & 1u) == 0u);
        output_float(i, 6u, pairwise_other(p, input_float(i, 8u), input_float(i, 9u), input_float(i, 7u)));
        output_float(i, 7u, pairwise_canonical_part(p, input_float(i, 8u), input_float(i, 9u), input_float(i, 8u)));
        output_float(i, 8u, pairwise_canonical_alone(p));
    }";
    let found = run(&gpu, &empty(), body, (&inputs, 10), 9);
    for (i, (v, f)) in inputs.chunks(10).zip(found.chunks(9)).enumerate() {
        let mut stream = Stream::from_key(u64::from(v[0]) | u64::from(v[1]) << 32);
        let mut reservoir = WithVisibility::<Plain<u32>>::default();
        for k in 0..5 {
            reservoir.stream(k, float(v[2 + k as usize]), ((), k as f32 / 4.0), &mut stream);
        }
        assert_eq!(f[0], reservoir.selected().unwrap_or(u32::MAX), "{i}");
        assert_eq!(f[1], reservoir.weight_sum().to_bits(), "{i}");
        assert_eq!(f[2], reservoir.rejected(), "{i}");
        close("visibility", float(f[3]), reservoir.visibility(), 1e-6, 1e-6);
        let [a, b, c] = [float(v[7]), float(v[8]), float(v[9])];
        let finished = reservoir.finish_scaled::<crate::resampling::Counting>(2.0, a, 1.0);
        // Smaller than the least normal number, a weight may be flushed.
        close("weight", float(f[4]), finished.weight.get(), 1e-6, f32::MIN_POSITIVE / 1e-6);
        close("mutated", float(f[5]), mutated_weight(a, b, c), 1e-6, 0.0);
        let pairs =
            crate::resampling::mis::Pairwise { canonical: a, others: b, defensive: i % 2 == 0 };
        close("other", float(f[6]), pairs.other(b, c, a), 1e-6, 0.0);
        close("part", float(f[7]), pairs.canonical_part(b, c, b), 1e-6, 0.0);
        close("alone", float(f[8]), pairs.canonical_alone(), 1e-6, 0.0);
    }
}

#[test]
fn what_visibility_keeps_is_the_same_bits() {
    let Some(gpu) = device() else { return };
    let mut random = Stream::from_key(5);
    let mut inputs = Vec::new();
    for i in 0..N {
        let scale = (random.uniform() * 200.0 - 100.0).exp2();
        let mut estimate = [0; 3].map(|_| scale * (random.uniform() * 2.0 - 1.0));
        if i % 64 == 0 {
            estimate = [0.0; 3];
        }
        if i % 64 == 1 {
            estimate = [1.0, -1.0, 0.5];
        }
        inputs.extend(bits(&estimate));
        inputs.extend([i as u32 & 1, word(&mut random, i) & 0xFFFF]);
        inputs.push(unit(&mut random, i).to_bits());
    }
    let body = "
    fn test(i: u32) {
        let c = control_new(input_vector(i, 0u), input(i, 3u) != 0u);
        output(i, 0u, c.x); output(i, 1u, c.y);
        output_vector(i, 2u, control_estimate(c));
        output(i, 5u, select(0u, 1u, control_visible(c)));
        let r = reused_moved(reused_unpack(input(i, 4u)), 3u, 5u);
        output(i, 6u, reused_pack(r));
        output(i, 7u, select(0u, 1u, reused_usable(r, 40u, 30u)));
        output(i, 8u, pack_average(input_float(i, 5u)));
        output_float(i, 9u, unpack_average(input(i, 4u)));
    }";
    let found = run(&gpu, &empty(), body, (&inputs, 6), 10);
    for (i, (v, f)) in inputs.chunks(6).zip(found.chunks(10)).enumerate() {
        let estimate = Vec3::new(float(v[0]), float(v[1]), float(v[2]));
        let control = Control::new(estimate, v[3] != 0);
        let words: [u32; 2] = bytemuck::cast(control);
        assert_eq!(f[..2], words, "{i}: {estimate}");
        assert_eq!(f[2..5], control.estimate().to_array().map(f32::to_bits), "{i}");
        assert_eq!(f[5], u32::from(control.visible()));
        let moved = Reused::unpack(v[4] as u16).moved(3, 5);
        assert_eq!(f[6], u32::from(moved.pack()), "{i}");
        assert_eq!(f[7], u32::from(moved.usable(40, 30)), "{i}");
        assert_eq!(f[8], u32::from(pack_average(float(v[5]))), "{i}");
        close("average", float(f[9]), unpack_average(v[4] as u16), 1e-7, 1e-7);
    }
}
