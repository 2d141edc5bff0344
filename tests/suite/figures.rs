//! Is every figure of a comparison what its own pictures and times say? Everything is computed
//! again here, by other arithmetic: pictures are rendered anew from the seeds that `results.json`
//! holds, times are those that it holds, and formulas are written out from `docs/metrics.md`.

use std::collections::{BTreeMap, HashSet};
use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use afterimage::counters::Counters;
use afterimage::experiment::{
    Compared, Comparison, ReferenceSettings, SceneMotion, Session, SessionSettings, Spending,
    technique,
};
use afterimage::frame::{FrameLoop, Stage};
use afterimage::metrics;
use afterimage::pass::{Band, FrameInputs};
use afterimage::picture::Picture;
use afterimage::plan::{Elements, Plan, SceneFacts, Shot};
use afterimage::report::{Figure, Layer, Results, Row, Sample, read_exr, write_exr};
use afterimage::scene::load::load;
use afterimage::techniques::{Moving, Technique};
use glam::DVec3;

use crate::support::room;

/// A fresh folder, gone when the test passes.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("figures-{name}"));
        let _ = std::fs::remove_dir_all(&path);
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

/// Student's 97.5 % quantiles for so many restarts: `scipy.stats.t.ppf(0.975, n - 1)`, 1.17.
/// The normal one is 1.96.
fn student(restarts: usize) -> f64 {
    match restarts {
        2 => 12.706_204_736_174_71,
        3 => 4.302_652_729_749_464,
        30 => 2.045_229_642_132_703,
        _ => panic!("no quantile for {restarts} restarts"),
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The mean and its 95 % interval.
fn figure(values: &[f64]) -> (f64, [f64; 2]) {
    let (mean, n) = (mean(values), values.len() as f64);
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    let half = student(values.len()) * (variance / n).sqrt();
    (mean, [mean - half, mean + half])
}

/// The value below which a share of values lies, linear between neighbours.
fn percentile(values: &[f64], share: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let place = share * (sorted.len() - 1) as f64;
    let below = sorted[place.floor() as usize];
    below + place.fract() * (sorted[place.ceil() as usize] - below)
}

fn near(name: &str, found: f64, expected: f64, tolerance: f64) {
    let off = (found - expected).abs();
    assert!(off <= tolerance * expected.abs().max(1e-12), "{name}: {found}, but {expected}");
}

/// Values of one restart each, as a figure of them.
fn check(name: &str, found: &Figure, values: &[f64], tolerance: f64) {
    let (mean, [low, high]) = figure(values);
    near(name, found.mean, mean, tolerance);
    let [found_low, found_high] = found.ci.unwrap_or_else(|| panic!("{name} has no interval"));
    near(&format!("{name}, width"), found_high - found_low, high - low, 1e3 * tolerance);
    near(&format!("{name}, middle"), 0.5 * (found_low + found_high), mean, tolerance);
}

fn rgb(picture: &Picture, pixel: usize) -> DVec3 {
    picture.pixels[pixel].as_dvec3()
}

/// Rec. 709.
fn luminance(rgb: DVec3) -> f64 {
    0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z
}

/// Mean luminance of a picture.
fn brightness(picture: &Picture) -> f64 {
    (0..picture.pixels.len()).map(|i| luminance(rgb(picture, i))).sum::<f64>()
        / picture.pixels.len() as f64
}

/// (x − r)² / (r² + 10⁻² r̄²) of every pixel, averaged over channels.
fn relative_squares(picture: &Picture, reference: &Picture) -> Vec<f64> {
    let count = picture.pixels.len();
    let middle = (0..count).map(|i| rgb(reference, i).element_sum()).sum::<f64>();
    let floor = 1e-2 * (middle / (3 * count) as f64).powi(2);
    (0..count)
        .map(|i| {
            let (x, r) = (rgb(picture, i), rgb(reference, i));
            ((x - r) * (x - r) / (r * r + DVec3::splat(floor))).element_sum() / 3.0
        })
        .collect()
}

fn relmse(picture: &Picture, reference: &Picture) -> f64 {
    mean(&relative_squares(picture, reference))
}

/// Every metric of a picture by its formula in `docs/metrics.md`. FLIP and the denoiser, which are
/// tested by values of their own (`src/metrics`), are the library's.
fn metrics_of(picture: &Picture, compared: &Compared) -> BTreeMap<String, f64> {
    let reference = &compared.truth;
    let count = picture.pixels.len();
    let pairs: Vec<(f64, f64)> = (0..count)
        .flat_map(|i| {
            let (x, r) = (rgb(picture, i).to_array(), rgb(reference, i).to_array());
            (0..3).map(move |c| (x[c], r[c]))
        })
        .collect();
    let over = |error: &dyn Fn(f64, f64) -> f64| {
        mean(&pairs.iter().map(|&(x, r)| error(x, r)).collect::<Vec<f64>>())
    };
    let mut worst_last = relative_squares(picture, reference);
    worst_last.sort_by(f64::total_cmp);
    let kept = count - (0.001 * count as f64).floor() as usize;
    let floor = 1e-3 * mean(&pairs.iter().map(|p| p.1).collect::<Vec<f64>>());
    let defined: Vec<(f64, f64)> = pairs.iter().copied().filter(|p| p.1 > floor).collect();
    let percentages: Vec<f64> = defined.iter().map(|(x, r)| (x / r - 1.0).powi(2)).collect();
    let power = power(picture, reference);
    let low: f64 = power.iter().filter(|(f, _)| *f < 1.0 / 16.0).map(|(_, p)| p).sum();
    let all: f64 = power.iter().map(|(_, p)| p).sum();
    // The squared Gaussian of 2.1 pixels at a frequency.
    let gauss = |f: f64| (-4.0 * (PI * 2.1 * f).powi(2)).exp();
    let blurred: f64 = power.iter().map(|(f, p)| p * gauss(*f)).sum();
    let white: f64 = power.iter().map(|(f, _)| gauss(*f)).sum();
    let guides = metrics::Guides {
        albedo: &compared.guides.albedo,
        normal: &compared.guides.normal,
        depth: &compared.guides.depth,
    };
    let denoised = metrics::denoise(picture, &guides, None).unwrap();
    let flip = metrics::Comparison::new(picture, reference, None).unwrap().flip();
    let smape =
        |x: f64, r: f64| if x == r { 0.0 } else { 2.0 * (x - r).abs() / (x.abs() + r.abs()) };
    BTreeMap::from(
        [
            ("mse", over(&|x, r| (x - r) * (x - r))),
            ("relmse", relmse(picture, reference)),
            ("relmse_trimmed", mean(&worst_last[..kept])),
            ("smape", over(&smape)),
            ("rmspe", mean(&percentages).sqrt()),
            ("rmspe_share", defined.len() as f64 / pairs.len() as f64),
            ("flip", flip),
            ("low_frequency_share", low / all),
            ("g_2_1", blurred / white),
            ("relmse_denoised", relmse(&denoised, reference)),
        ]
        .map(|(name, value)| (name.to_string(), value)),
    )
}

/// Frequency and power of the luminance error, of white noise 1, at all frequencies but 0: Hann
/// window, mean removed, padded to powers of two; a plain discrete Fourier transform.
fn power(picture: &Picture, reference: &Picture) -> Vec<(f64, f64)> {
    let (width, height) = (picture.width as usize, picture.height as usize);
    let hann = |i: usize, n: usize| (PI * (i as f64 + 0.5) / n as f64).sin().powi(2);
    let window: Vec<f64> =
        (0..width * height).map(|i| hann(i % width, width) * hann(i / width, height)).collect();
    let error: Vec<f64> =
        (0..width * height).map(|i| luminance(rgb(picture, i) - rgb(reference, i))).collect();
    let sum: f64 = window.iter().zip(&error).map(|(w, e)| w * e).sum();
    let middle = sum / window.iter().sum::<f64>();
    let wave: Vec<f64> = window.iter().zip(&error).map(|(w, e)| w * (e - middle)).collect();
    let energy: f64 = wave.iter().map(|v| v * v).sum();
    let (columns, rows) = (width.next_power_of_two(), height.next_power_of_two());
    // Row by row, then column by column.
    let turn = |k: usize, i: usize, n: usize| (-2.0 * PI * (k * i) as f64 / n as f64).sin_cos();
    let mut half = vec![(0.0, 0.0); columns * height];
    for y in 0..height {
        for k in 0..columns {
            for x in 0..width {
                let (sin, cos) = turn(k, x, columns);
                half[y * columns + k].0 += wave[y * width + x] * cos;
                half[y * columns + k].1 += wave[y * width + x] * sin;
            }
        }
    }
    let cycles = |k: usize, n: usize| k.min(n - k) as f64 / n as f64;
    let mut found = Vec::new();
    for k in 0..columns {
        for j in 0..rows {
            let (mut re, mut im) = (0.0, 0.0);
            for y in 0..height {
                let ((a, b), (sin, cos)) = (half[y * columns + k], turn(j, y, rows));
                re += a * cos - b * sin;
                im += a * sin + b * cos;
            }
            let frequency = cycles(k, columns).hypot(cycles(j, rows));
            found.push((frequency, (re * re + im * im) / energy));
        }
    }
    // The first is the frequency 0.
    found.split_off(1)
}

/// Covariance of luminance with the pixels at most 8 away, over restarts, in squares of the
/// reference's mean luminance: what each restart adds to the mean.
fn covariances(pictures: &[Picture], reference: &Picture) -> Vec<f64> {
    let (width, height) = (reference.width as usize, reference.height as usize);
    let k = pictures.len() as f64;
    let value = |picture: &Picture, i: usize| luminance(rgb(picture, i));
    let means: Vec<f64> = (0..width * height)
        .map(|i| pictures.iter().map(|p| value(p, i)).sum::<f64>() / k)
        .collect();
    let scale = (k - 1.0) / k * brightness(reference).powi(2);
    let of = |picture: &Picture| {
        let deviation: Vec<f64> =
            (0..width * height).map(|i| value(picture, i) - means[i]).collect();
        let mut sum = 0.0;
        for i in 0..width * height {
            let (x, y) = (i % width, i / width);
            let (mut around, mut count) = (0.0, 0);
            for v in y.saturating_sub(8)..(y + 9).min(height) {
                for u in x.saturating_sub(8)..(x + 9).min(width) {
                    around += deviation[v * width + u];
                    count += 1;
                }
            }
            sum += deviation[i] * around / f64::from(count);
        }
        sum / (width * height) as f64 / scale
    };
    pictures.iter().map(of).collect()
}

/// What a restart's frames show and count, rendered again.
struct Again {
    pictures: Vec<Picture>,
    counters: Vec<Counters>,
}

impl Again {
    fn new(stage: &Stage, base: Shot, spec: &str, effort: f32, sample: &Sample) -> Self {
        let shot = Shot { effort, run: sample.seed, ..base };
        let mut frames = FrameLoop::new(technique(spec).unwrap(), stage, shot).unwrap();
        let mut again = Self { pictures: Vec::new(), counters: Vec::new() };
        for _ in &sample.ms {
            let frame = frames.render().unwrap();
            again.counters.push(frame.counters);
            again.pictures.push(frame.picture());
        }
        again
    }

    fn judged(&self) -> &Picture {
        &self.pictures[self.pictures.len() - 1]
    }
}

/// The frames after the cold start, or it alone.
fn steady<T: Clone>(frames: &[T]) -> Vec<T> {
    if frames.len() > 1 { frames[1..].to_vec() } else { frames.to_vec() }
}

/// A comparison and everything that was found, with its results as the file has them.
struct Found<'a> {
    session: &'a Session,
    compared: Compared,
    results: Results,
    folder: &'a Folder,
}

fn run<'a>(session: &'a Session, comparison: &Comparison, folder: &'a Folder) -> Found<'a> {
    let techniques = ["nee", "restir-di"].map(|spec| technique(spec).unwrap());
    let compared = comparison.run(session, &techniques).unwrap();
    compared.write(&folder.0).unwrap();
    let text = std::fs::read(folder.0.join("results.json")).unwrap();
    let results = serde_json::from_slice(&text).unwrap();
    Found { session, compared, results, folder }
}

impl Found<'_> {
    /// Asks every figure of a row for its value, and gives the judged pictures.
    fn row(&self, row: &Row) -> Vec<Picture> {
        let spec = &row.technique;
        let name = |figure: &str| format!("{figure} of {spec}");
        let (stage, shot) = (&self.session.stage, self.session.shot);
        let again: Vec<Again> = row
            .samples
            .iter()
            .map(|sample| Again::new(stage, shot, spec, row.budget.effort, sample))
            .collect();
        assert_eq!((row.restarts as usize, row.non_finite), (again.len(), 0), "{spec}");

        // Times are what they were; each frame's is the sum of its passes'.
        let times: Vec<f64> = row.samples.iter().flat_map(|sample| steady(&sample.ms)).collect();
        let firsts: Vec<f64> = row.samples.iter().map(|sample| sample.ms[0]).collect();
        let medians: Vec<f64> =
            row.samples.iter().map(|s| percentile(&steady(&s.ms), 0.5)).collect();
        let time = &row.ms_per_frame;
        near(&name("median"), time.median, percentile(&times, 0.5), 1e-12);
        near(&name("p99"), time.p99, percentile(&times, 0.99), 1e-12);
        near(&name("first"), time.first, percentile(&firsts, 0.5), 1e-12);
        let ci = Figure { mean: mean(&medians), ci: time.ci };
        check(&name("ms"), &ci, &medians, 1e-9);
        for pass in &row.passes {
            let of = |sample: &Sample| -> Vec<f64> {
                let found = sample.passes.iter().find(|other| other.name == pass.name);
                found.map_or(Vec::new(), |found| found.ms.clone())
            };
            let all: Vec<f64> = row.samples.iter().flat_map(of).collect();
            near(&name(&pass.name), pass.ms, percentile(&all, 0.5), 1e-12);
        }
        let in_passes: f64 =
            row.samples.iter().flat_map(|s| &s.passes).flat_map(|pass| &pass.ms).sum();
        near(&name("passes together"), in_passes, times.iter().sum(), 1e-9);

        // Work.
        let frames: Vec<Counters> = again.iter().flat_map(|a| steady(&a.counters)).collect();
        let pixels = (shot.size[0] * shot.size[1]) as usize;
        for (kind, found) in &row.rays_per_pixel {
            let counted: u64 = frames
                .iter()
                .flat_map(Counters::entries)
                .filter(|(other, _)| *other == format!("{kind}_rays"))
                .map(|(_, count)| count)
                .sum();
            near(&name(kind), *found, counted as f64 / (frames.len() * pixels) as f64, 1e-12);
        }
        assert!(row.rays_per_pixel["shadow"] > 0.0);
        let shot = Shot { effort: row.budget.effort, ..shot };
        let plan = technique(spec).unwrap().plan(stage.facts(), &shot);
        let bytes: f64 = plan
            .buffers
            .iter()
            .map(|buffer| {
                let elements = match buffer.elements {
                    Elements::Pixels => pixels as f64,
                    Elements::Items(count) => f64::from(count),
                };
                let copies = if buffer.history { 2.0 } else { 1.0 };
                copies * elements * f64::from(buffer.bytes)
            })
            .sum();
        near(&name("bytes"), row.bytes_per_pixel, bytes / pixels as f64, 1e-12);

        // Errors.
        let judged: Vec<Picture> = again.iter().map(|a| a.judged().clone()).collect();
        let errors: Vec<BTreeMap<String, f64>> =
            judged.iter().map(|picture| metrics_of(picture, &self.compared)).collect();
        for metric in errors[0].keys() {
            let values: Vec<f64> = errors.iter().map(|error| error[metric]).collect();
            check(&name(metric), &row.metrics[metric], &values, 1e-5);
            for (sample, value) in row.samples.iter().zip(&values) {
                near(&name(metric), sample.metrics[metric], *value, 1e-5);
            }
        }
        // Time to unit variance: relmse times seconds a frame.
        let values: Vec<f64> =
            errors.iter().map(|e| e["relmse"] * percentile(&times, 0.5) / 1000.0).collect();
        check(&name("ttuv"), &row.metrics["ttuv"], &values, 1e-5);
        if judged.len() >= 30 {
            let values = covariances(&judged, &self.compared.truth);
            check(&name("covariance_r8"), &row.metrics["covariance_r8"], &values, 1e-3);
        }
        assert_eq!(row.metrics.contains_key("covariance_r8"), judged.len() >= 30);

        // The difference of mean luminance, relative to the reference.
        let bias = row.bias.as_ref().unwrap();
        let truth = brightness(&self.compared.truth);
        let values: Vec<f64> = judged.iter().map(|p| brightness(p) / truth - 1.0).collect();
        let (relative, [low, high]) = figure(&values);
        assert!((bias.relative - relative).abs() < 1e-6, "{} but {relative}", bias.relative);
        let [found_low, found_high] = bias.ci.unwrap();
        if self.results.reference.variance.is_none() {
            assert!((found_low - low).abs() < 1e-5 && (found_high - high).abs() < 1e-5, "{bias:?}");
        } else {
            assert!(found_high - found_low > 0.0);
        }

        // Error of every frame.
        if let Some(warmup) = self.results.warmups.iter().find(|w| w.technique == *spec) {
            assert_eq!(warmup.relmse.len(), row.frames as usize);
            for (at, found) in warmup.relmse.iter().enumerate() {
                let of = |a: &Again| relmse(&a.pictures[at], &self.compared.truth);
                check(&name("warm-up"), found, &again.iter().map(of).collect::<Vec<_>>(), 1e-5);
            }
        }
        let spectrum = self.results.spectra.iter().find(|s| s.technique == *spec).unwrap();
        let powers: Vec<Vec<(f64, f64)>> =
            judged.iter().map(|picture| power(picture, &self.compared.truth)).collect();
        for point in &spectrum.points {
            let inside = |f: f64| f > point.cycles - 1.0 / 64.0 + 1e-9 && f <= point.cycles + 1e-9;
            let of = |power: &Vec<(f64, f64)>| {
                let ring = power.iter().filter(|(f, _)| inside(*f)).map(|(_, p)| *p);
                mean(&ring.collect::<Vec<f64>>())
            };
            let values: Vec<f64> = powers.iter().map(of).collect();
            check(&name("power"), &point.power, &values, 1e-4);
        }
        assert!(spectrum.points.len() > 20);
        judged
    }

    /// The points of a row's curve.
    fn curve(&self, row: &Row) {
        let curve = self.results.curves.iter().find(|c| c.technique == row.technique).unwrap();
        assert!(curve.points.len() >= 3);
        for point in &curve.points {
            let name = format!("{} at effort {}", row.technique, point.effort);
            if point.samples.is_empty() {
                assert_eq!(
                    (point.effort, point.relmse),
                    (row.budget.effort, row.metrics["relmse"])
                );
                assert_eq!(point.ms, row.ms_per_frame.median);
                continue;
            }
            let (stage, shot) = (&self.session.stage, self.session.shot);
            let errors: Vec<f64> = point
                .samples
                .iter()
                .map(|s| Again::new(stage, shot, &row.technique, point.effort, s))
                .map(|again| relmse(again.judged(), &self.compared.truth))
                .collect();
            check(&name, &point.relmse, &errors, 1e-5);
            let times: Vec<f64> = point.samples.iter().flat_map(|s| steady(&s.ms)).collect();
            near(&name, point.ms, percentile(&times, 0.5), 1e-12);
        }
    }

    /// Tables say what `results.json` says.
    fn tables(&self) {
        let read = |name: &str| std::fs::read_to_string(self.folder.0.join(name)).unwrap();
        let csv = read("table.csv");
        let lines: Vec<Vec<&str>> = csv.lines().map(|l| l.split(',').collect()).collect();
        let table = read("table.md");
        let cells: Vec<Vec<&str>> = table
            .lines()
            .filter(|line| line.starts_with('|'))
            .map(|line| line.trim_matches('|').split('|').map(str::trim).collect())
            .collect();
        for (at, row) in self.results.rows.iter().enumerate() {
            let time = &row.ms_per_frame;
            let [ms_low, ms_high] = time.ci.unwrap();
            let rays: f64 = row.rays_per_pixel.values().sum();
            let mut expected = vec![
                ("ms_median".to_string(), time.median),
                ("ms_low".to_string(), ms_low),
                ("ms_high".to_string(), ms_high),
                ("ms_p99".to_string(), time.p99),
                ("ms_first".to_string(), time.first),
                ("rays_per_pixel".to_string(), rays),
                ("bytes_per_pixel".to_string(), row.bytes_per_pixel),
                ("effort".to_string(), f64::from(row.budget.effort)),
                ("bias_relative".to_string(), row.bias.as_ref().unwrap().relative),
            ];
            let shown = row.metrics.iter().filter(|(name, _)| *name != "rmspe_share");
            for (name, figure) in shown.clone() {
                let [low, high] = figure.ci.unwrap();
                expected.push((name.clone(), figure.mean));
                expected.push((format!("{name}_low"), low));
                expected.push((format!("{name}_high"), high));
            }
            for (name, value) in expected {
                let column = lines[0].iter().position(|c| *c == name).unwrap();
                near(&name, lines[at + 1][column].parse().unwrap(), value, 1e-12);
            }
            // People get three digits, and half of the interval.
            let column = |name: &str| cells[0].iter().position(|c| *c == name).unwrap();
            let cell = |name: &str| cells[at + 2][column(name)].replace("**", "");
            near("effort", cell("effort").parse().unwrap(), row.budget.effort.into(), 1e-6);
            near("rays", cell("rays/px").parse().unwrap(), rays, 5.1e-3);
            near("bytes", cell("B/px").parse().unwrap(), row.bytes_per_pixel, 5.1e-3);
            let figures = shown.map(|(name, f)| (name.as_str(), f.mean, f.ci.unwrap()));
            let all = figures.chain([("ms/frame", time.median, [ms_low, ms_high])]);
            for (name, mean, [low, high]) in all {
                let text = cell(name);
                let (middle, half) = text.split_once(" ± ").unwrap();
                near(name, middle.parse().unwrap(), mean, 5.1e-3);
                let (half, expected): (f64, f64) = (half.parse().unwrap(), 0.5 * (high - low));
                let digit = 0.51 * 10.0_f64.powf((mean.abs().log10().floor() - 2.0).min(0.0));
                assert!((half - expected).abs() < digit.max(0.06 * expected), "{name}: {text}");
            }
        }
    }
}

fn settings(size: [u32; 2], depth: u32) -> SessionSettings {
    SessionSettings { size: Some(size), depth: Some(depth), ..SessionSettings::default() }
}

fn comparison(folder: &Folder, restarts: u32) -> Comparison {
    Comparison {
        spending: Spending::Estimates(2),
        frames: 3,
        restarts,
        curve_restarts: 0,
        reference: ReferenceSettings {
            file: None,
            seconds: 1.0,
            cache: Some(folder.0.join("cache")),
        },
        ..Comparison::default()
    }
}

/// 40 × 26 pixels, so that one of them is trimmed; effort 2; three restarts, whose Student interval
/// is 2.2 times as wide as a normal one.
#[test]
fn every_figure_is_what_pictures_and_times_say() {
    let folder = Folder::new("all");
    let session = Session::new(room(), &settings([40, 26], 3)).unwrap();
    let found = run(&session, &Comparison { curve_restarts: 2, ..comparison(&folder, 3) }, &folder);
    let mut seeds = HashSet::new();
    let mut smallest = f64::INFINITY;
    for row in &found.results.rows {
        assert_eq!((row.budget.value, row.budget.effort), (2.0, 2.0));
        // Without history the second frame has the law of all; with it the third is judged.
        let frames = if row.technique == "nee" { 2 } else { 3 };
        assert!(row.samples.iter().all(|s| s.ms.len() == frames && seeds.insert(s.seed)));
        found.row(row);
        found.curve(row);
        smallest = smallest.min(row.metrics["mse"].mean);
    }
    assert_eq!(found.results.warmups.len(), 1);
    found.tables();
    let reference = &found.results.reference;
    let share = reference.variance.unwrap() / smallest;
    near("share", reference.share_of_smallest_mse.unwrap(), share, 1e-12);

    // Pictures that are written are those that were judged.
    let exr = read_exr(&found.folder.0.join("reference.exr")).unwrap();
    let emission = exr.emission.unwrap();
    for (i, truth) in found.compared.truth.pixels.iter().enumerate() {
        let reflected = exr.picture.pixels[i] - emission.pixels[i];
        assert!((reflected - *truth).length() <= 1e-6 * (1.0 + exr.picture.pixels[i].length()));
    }
}

/// As many restarts as the covariance needs; a reference from a file, which counts as exact, so
/// that the interval of the bias is Student's.
#[test]
fn thirty_restarts_against_a_file() {
    let folder = Folder::new("file");
    let session = Session::new(room(), &settings([24, 34], 2)).unwrap();
    let shot = Shot { effort: 64.0, run: 77, ..session.shot };
    let mut frames = FrameLoop::new(technique("nee").unwrap(), &session.stage, shot).unwrap();
    let frame = frames.render().unwrap();
    let (picture, emission) = (frame.picture(), frame.emission());
    let mut all = picture.clone();
    all.pixels.iter_mut().zip(&emission.pixels).for_each(|(a, e)| *a += *e);
    let file = folder.0.join("truth.exr");
    let layers = [Layer::rgb("color", &all), Layer::rgb("emission", &emission)];
    write_exr(&file, [24, 34], &layers).unwrap();

    let mut comparison = comparison(&folder, 30);
    comparison.reference.file = Some(file);
    comparison.spending = Spending::Estimates(1);
    let found = run(&session, &comparison, &folder);
    for (a, b) in found.compared.truth.pixels.iter().zip(&picture.pixels) {
        assert!((*a - *b).length() <= 1e-6 * (1.0 + b.length()));
    }
    for row in &found.results.rows {
        found.row(row);
    }
    found.tables();
}

/// `nee` with a pause in every cold start.
#[derive(Debug)]
struct Cold(Arc<dyn Technique>);

const PAUSE: u64 = 250;

impl Technique for Cold {
    fn spec(&self) -> String {
        "cold".to_string()
    }

    fn validate(&self) -> afterimage::Result<()> {
        Ok(())
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        self.0.plan(facts, shot)
    }

    fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        if inputs.frame == 0 && band.range.start == 0 {
            std::thread::sleep(Duration::from_millis(PAUSE));
        }
        self.0.run(kernel, inputs, band)
    }
}

/// A cold frame takes [`PAUSE`] ms and a steady one a few: no budget, calibration or frame time is
/// that of cold frames, but `first`.
#[test]
fn cold_frames_calibrate_nothing() {
    let folder = Folder::new("cold");
    let session = Session::new(room(), &settings([16, 12], 2)).unwrap();
    let comparison = Comparison { spending: Spending::Slowest, ..comparison(&folder, 2) };
    let cold: Arc<dyn Technique> = Arc::new(Cold(technique("nee").unwrap()));
    // Threads of its own: those of all tests may be busy for longer than the pause.
    let threads = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    let results = threads.install(|| comparison.run(&session, &[cold])).unwrap().results;
    let row = &results.rows[0];
    let time = &row.ms_per_frame;
    let pause = PAUSE as f64;
    assert!(time.first >= pause, "{time:?}");
    let [before, after] = &time.calibrations;
    assert!(before.len() > 2 && after.len() == before.len());
    near("calibrated", time.calibrated.unwrap(), percentile(before, 0.5), 1e-12);
    near("recalibrated", time.recalibrated.unwrap(), percentile(after, 0.5), 1e-12);
    // Medians: on a busy machine a steady frame may wait as long.
    let quick =
        [row.budget.value, time.median, time.calibrated.unwrap(), time.recalibrated.unwrap()];
    assert!(quick.iter().all(|ms| *ms < 0.5 * pause), "{time:?}, {:?}", row.budget);
    check("ttuv", &row.metrics["ttuv"], &ttuvs(row), 1e-9);
}

fn ttuvs(row: &Row) -> Vec<f64> {
    let seconds = row.ms_per_frame.median / 1000.0;
    row.samples.iter().map(|sample| seconds * sample.metrics["relmse"]).collect()
}

/// Where a light moves, errors are against the judged frame's own reference: with those of the
/// frames before and after they would be half as large again, or more.
#[test]
fn a_moving_scene_is_judged_by_the_judged_frames_own_reference() {
    const FRAMES: u32 = 4;
    let folder = Folder::new("moving");
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
    let motion = Some(SceneMotion::new(Moving::Light, Some(0.05)).unwrap());
    let settings = SessionSettings { motion, ..settings([40, 26], 2) };
    let session = Session::new(load(&path).unwrap().scene, &settings).unwrap();
    let mut comparison = Comparison { frames: FRAMES, ..comparison(&folder, 3) };
    comparison.reference.seconds = 2.0;
    let found = run(&session, &comparison, &folder);

    // References of this test's own, of three frames.
    let reference = |index: u32| {
        let time = session.stage.scene().time[0] + index as f32 / session.shot.fps as f32;
        let stage = Stage::new(session.stage.scene().at(time)).unwrap();
        let shot = Shot { effort: 1024.0, run: 5, ..session.shot };
        FrameLoop::new(technique("nee").unwrap(), &stage, shot).unwrap().render().unwrap().picture()
    };
    let [before, own, after] = [FRAMES - 2, FRAMES - 1, FRAMES].map(reference);
    for row in &found.results.rows {
        assert!(row.samples.iter().all(|sample| sample.ms.len() == FRAMES as usize));
        let pictures = found.row(row);
        let against = |truth: &Picture| {
            mean(&pictures.iter().map(|p| relmse(p, truth)).collect::<Vec<f64>>())
        };
        let reported = row.metrics["relmse"].mean;
        // The rest of both references' noise.
        near(&row.technique, reported, against(&own), 0.1);
        for other in [&before, &after] {
            assert!(against(other) > 1.5 * reported, "{} or {reported}", against(other));
        }
    }
}
