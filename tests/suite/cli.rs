//! Does the command keep its contract: options, exit statuses, messages, files?

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use afterimage::picture::Picture;
use afterimage::report::{Layer, Results, read_exr, write_exr};

/// A fresh folder for a test, with a cache of its own.
struct Place {
    folder: PathBuf,
}

impl Place {
    fn new(name: &str) -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("cli-{name}"));
        if folder.exists() {
            std::fs::remove_dir_all(&folder).unwrap();
        }
        std::fs::create_dir_all(&folder).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    fn command(&self, line: &str) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_afterimage"));
        command
            .args(line.split_whitespace())
            .current_dir(&self.folder)
            .env("XDG_CACHE_HOME", self.path("cache"));
        command
    }

    fn run(&self, line: &str) -> Ran {
        let Output { status, stdout, stderr } = self.command(line).output().unwrap();
        let text = |bytes| String::from_utf8(bytes).unwrap();
        Ran { status: status.code(), out: text(stdout), err: text(stderr) }
    }

    fn results(&self, folder: &str) -> Results {
        serde_json::from_slice(&std::fs::read(self.path(folder).join("results.json")).unwrap())
            .unwrap()
    }

    /// The only reference in the cache.
    fn cached(&self) -> PathBuf {
        let files = std::fs::read_dir(self.path("cache/afterimage")).unwrap();
        let mut files: Vec<PathBuf> = files
            .map(|file| file.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "reference"))
            .collect();
        assert_eq!(files.len(), 1, "{files:?}");
        files.remove(0)
    }
}

#[derive(Debug)]
struct Ran {
    status: Option<i32>,
    out: String,
    err: String,
}

impl Ran {
    fn done(self) -> Self {
        assert_eq!(self.status, Some(0), "{self:?}");
        self
    }
}

fn scene(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name).display().to_string()
}

fn cornell() -> String {
    scene("cornell.pbrt")
}

const TINY: &str =
    "--size 32x32 --depth 3 --frames 2 --restarts 3 --curve-restarts 2 --reference-time 2 --spp 1";

#[test]
fn help_teaches_by_example() {
    let place = Place::new("help");
    let commands =
        ["compare", "render", "verify", "lag", "inspect", "plan", "diff", "generate", "list"];
    let top = place.run("--help").done();
    for command in commands {
        assert!(top.out.contains(command), "{command} in {}", top.out);
        let help = place.run(&format!("{command} --help")).done();
        assert!(
            help.out.contains("Example") && help.out.contains(&format!("afterimage {command} ")),
            "{help:?}"
        );
    }
    assert!(place.run("--version").done().out.contains(env!("CARGO_PKG_VERSION")));
}

#[test]
fn wrong_input_is_status_two_and_one_line_that_lists_what_exists() {
    let place = Place::new("wrong");
    let moving = scene("moving.pbrt");
    let scene = cornell();
    std::fs::write(place.path("bad.exr"), b"no picture").unwrap();
    std::fs::write(place.path("bad.pbrt"), b"WorldBegin Shape \"cube\"").unwrap();
    std::fs::write(
        place.path("dark.pbrt"),
        b"Camera \"perspective\"\nWorldBegin\nShape \"sphere\"\n",
    )
    .unwrap();
    for (line, parts) in [
        (
            format!("render {scene} --technique ne"),
            vec!["no technique is called `ne`", "known: nee, ris, bsdf, mcmm, restir-di"],
        ),
        (
            format!("compare {scene} --techniques nee:rulette=1"),
            vec!["no parameter `rulette`", "known: roulette"],
        ),
        (format!("compare {scene} --techniques ;"), vec!["SPEC;SPEC"]),
        ("compare nowhere.pbrt".to_string(), vec!["nowhere.pbrt", "no such file"]),
        ("compare bad.pbrt".to_string(), vec!["bad.pbrt:1:"]),
        ("compare many-light:5".to_string(), vec!["many-lights"]),
        (format!("compare {scene} --spp 1 --frame-time 5"), vec!["--spp", "--frame-time"]),
        (format!("compare {scene} --size 0x4"), vec!["WIDTHxHEIGHT"]),
        (format!("compare {scene} --filter sinc"), vec!["sinc", "point, box"]),
        (format!("compare {scene} --backend quantum"), vec!["quantum", "cpu, gpu"]),
        #[cfg(feature = "gpu")]
        (format!("compare {scene} --adapter x"), vec!["--adapter", "--backend gpu"]),
        #[cfg(not(feature = "gpu"))]
        (format!("compare {scene} --backend gpu"), vec!["known: cpu"]),
        (format!("compare {scene} --reference bad.exr"), vec!["bad.exr"]),
        (format!("render {scene} --frames 1 --out x.png"), vec![".exr"]),
        (format!("inspect {scene} --technique nee --pixel 999,0 --size 8x8"), vec!["999,0", "8x8"]),
        ("diff bad.exr bad.exr".to_string(), vec!["bad.exr"]),
        ("generate many-lights:x".to_string(), vec!["many-lights:N"]),
        (format!("compare {} --warmup", moving), vec!["`warmup`", "does not move"]),
        (format!("verify nee {scene} --ages 0,5"), vec!["0,5", "1,5,20"]),
        (format!("verify nee {scene} --delta 0"), vec!["percent"]),
        (format!("verify nee {scene} --rungs still"), vec!["--ladder"]),
        (
            format!("verify nee {scene} --ladder --rungs sideways"),
            vec!["sideways", "moving camera"],
        ),
        (format!("verify ne {scene} --ladder"), vec!["no technique is called `ne`"]),
        (format!("verify nee {scene} --ladder --reference bad.exr"), vec!["--reference"]),
        ("verify nee --ladder".to_string(), vec!["no scene is given", "scenes/penumbra.pbrt"]),
        (format!("verify nee {scene} --ladder --motion light"), vec!["--motion", "ladder"]),
        (format!("compare {scene} --motion sideways"), vec!["sideways", "occluder", "(0, 0.1]"]),
        (format!("compare {scene} --motion light:0.5"), vec!["light:0.5", "(0, 0.1]"]),
        (format!("render {scene} --look-at 0,1,2"), vec!["0,1,2", "nine numbers"]),
        (format!("render {scene} --look-at 0,1,2,0,1,2,0,1,0"), vec!["target is its eye"]),
        (format!("render {scene} --look-at 0,1,2,0,5,2,0,1,0"), vec!["up vector"]),
        (format!("verify nee {scene} --look-at nan,1,2,0,5,2,0,1,0"), vec!["finite"]),
        ("render dark.pbrt --motion light".to_string(), vec!["no light that could move"]),
        (format!("lag {scene}"), vec!["--technique"]),
        ("lag many-lights:3 --technique ne".to_string(), vec!["known: nee, ris"]),
        (format!("lag {scene} --technique nee --reference bad.exr"), vec!["--reference"]),
        ("compar x".to_string(), vec!["compare"]),
        ("compare".to_string(), vec!["SCENE"]),
    ] {
        let ran = place.run(&line);
        assert_eq!(ran.status, Some(2), "{line}: {ran:?}");
        assert!(ran.out.is_empty(), "{line}: {ran:?}");
        let errors: Vec<&str> = ran.err.lines().filter(|l| !l.starts_with("warning: ")).collect();
        assert_eq!(errors.len(), 1, "{line}: {ran:?}");
        for part in parts {
            assert!(errors[0].contains(part), "`{part}` in {line}: {ran:?}");
        }
    }
}

#[test]
fn compare_writes_what_it_promises_and_uses_its_cache() {
    let place = Place::new("compare");
    let line = format!("compare {} {TINY} --out first", cornell());
    let ran = place.run(&line).done();
    for text in ["`nee`", "`bsdf`", "relmse", "ms/frame", "| unbiased"] {
        assert!(ran.out.contains(text), "{text} in {}", ran.out);
    }
    let folder = place.path("first");
    for name in
        "results.json table.md table.csv curve.csv error_time.svg spectrum.csv contact.png reference.exr reference.png nee.exr bsdf.png"
            .split(' ')
    {
        assert!(std::fs::metadata(folder.join(name)).unwrap().len() > 0, "{name}");
    }
    // The terminal gets the same heading and fewer columns.
    let table = std::fs::read_to_string(folder.join("table.md")).unwrap();
    let heading = |text: &str| text.lines().take(2).map(String::from).collect::<Vec<_>>();
    assert_eq!(heading(&table), heading(&ran.out));
    assert!(table.contains("smape") && !ran.out.contains("smape"), "{}", ran.out);

    let results = place.results("first");
    assert_eq!((results.schema, results.size, results.depth, results.seed), (1, [32, 32], 3, 1));
    let seventh = format!("compare {} {TINY} --techniques bsdf --seed 7 --out seventh", cornell());
    place.run(&seventh).done();
    assert_eq!(place.results("seventh").seed, 7);
    assert_eq!((results.filter.as_str(), results.reference.source.as_str()), ("point", "made"));
    assert!(results.command.starts_with("afterimage compare ") && !results.interrupted);
    assert_eq!(results.rows.len(), afterimage::techniques::REGISTRY.len());
    for row in &results.rows {
        assert_eq!((row.frames, row.restarts, row.budget.effort, row.non_finite), (2, 3, 1.0, 0));
        assert!(
            row.ms_per_frame.median > 0.0 && row.ms_per_frame.first > 0.0 && !row.passes.is_empty()
        );
        assert!(row.rays_per_pixel["bounce"] > 0.0 && row.bytes_per_pixel > 0.0);
        for name in "mse relmse relmse_trimmed smape rmspe flip ttuv low_frequency_share g_2_1 relmse_denoised".split(' ') {
            let figure = row.metrics[name];
            let [low, high] = figure.ci.unwrap();
            assert!(low <= figure.mean && figure.mean <= high && figure.mean > 0.0, "{name}: {figure:?}");
        }
        assert!(!row.metrics.contains_key("covariance_r8"), "it needs 30 restarts");
        assert!(row.bias.is_some());
    }
    assert!(results.curves.iter().all(|c| c.points.len() >= 3));
    for spectrum in &results.spectra {
        assert!(spectrum.points.len() > 10 && spectrum.points.iter().all(|p| p.power.mean > 0.0));
    }
    assert_eq!(results.spectra.len(), results.rows.len());
    // Three techniques keep history.
    assert_eq!(results.warmups.len(), 3);
    assert!(folder.join("warmup.csv").exists());
    // The picture with its emission apart can be judged again.
    let diff = place.run("diff first/nee.exr first/reference.exr --json").done();
    let diff: serde_json::Value = serde_json::from_str(&diff.out).unwrap();
    assert!(diff["relmse"].as_f64().unwrap() > 0.0 && diff["mean_ratio"].as_f64().unwrap() > 0.5);

    // The same again: the same pictures, the reference from the cache.
    let again = place.run(&line.replace("first", "second")).done();
    assert!(!again.err.contains("warning"), "{again:?}");
    let second = place.results("second");
    assert!(second.reference.source.starts_with("cache"), "{:?}", second.reference);
    let shown = |folder: &Path| read_exr(&folder.join("nee.exr")).unwrap().picture;
    assert_eq!(shown(&folder), shown(&place.path("second")));

    // A damaged entry is made anew, with a warning.
    let cached = place.cached();
    let mut bytes = std::fs::read(&cached).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&cached, bytes).unwrap();
    let third = place.run(&line.replace("first", "third")).done();
    assert!(third.err.contains("checksum") && third.err.contains("made anew"), "{third:?}");
    assert_eq!(place.results("third").reference.source, "made");
}

#[test]
fn frame_times_have_intervals_and_are_measured_again() {
    let place = Place::new("times");
    let line = format!(
        "compare {} --size 24x24 --depth 2 --frames 3 --restarts 4 --curve-restarts 1 --reference-time 2 --techniques nee;restir-di",
        cornell()
    );
    let ran = place.run(&format!("{line} --frame-time 6 --out timed")).done();
    assert!(ran.out.contains(" ± "), "{}", ran.out);
    let results = place.results("timed");
    assert_eq!(results.rows.iter().map(|row| row.whole_effort).collect::<Vec<_>>(), [false, true]);
    for row in &results.rows {
        let time = &row.ms_per_frame;
        let [low, high] = time.ci.unwrap();
        assert!(low < high && time.calibrated.unwrap() > 0.0 && time.recalibrated.unwrap() > 0.0);
        assert!(!(row.whole_effort && row.budget.over_budget), "{row:?}");
    }
    let csv = std::fs::read_to_string(place.path("timed/table.csv")).unwrap();
    assert!(csv.starts_with("technique,") && csv.contains(",ms_median,ms_low,ms_high,"), "{csv}");
    // With a number of estimates there is no time to keep, so none is measured again.
    place.run(&format!("{line} --spp 1 --out counted")).done();
    for row in &place.results("counted").rows {
        assert_eq!((row.ms_per_frame.calibrated, row.ms_per_frame.drift()), (None, None));
        assert!(row.ms_per_frame.ci.is_some());
    }
}

#[test]
fn warmup_is_written_where_it_is_asked_for() {
    let place = Place::new("warmup");
    place.run(&format!("compare {} {TINY} --warmup --out w", cornell())).done();
    let warmups = place.results("w").warmups;
    assert_eq!(warmups.len(), afterimage::techniques::REGISTRY.len());
    for warmup in &warmups {
        assert!(warmup.relmse.len() == 2 && warmup.relmse.iter().all(|f| f.mean > 0.0));
    }
    // Frame 2 is the one that is judged.
    let judged = place.results("w").rows[0].metrics["relmse"];
    assert_eq!(warmups[0].relmse[1], judged);
    let csv = std::fs::read_to_string(place.path("w/warmup.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 2 * warmups.len(), "{csv}");
    assert!(std::fs::read_to_string(place.path("w/warmup.svg")).unwrap().contains("frames since"));
}

/// The reference is `nee` again, with other seeds: no bias, so that margins alone decide.
const ITSELF: &str = "--against nee:roulette=60 --quick --reference-time 5 --check";

#[test]
fn verify_passes_within_wide_margins_and_decides_nothing_within_narrow_ones() {
    let place = Place::new("verify");
    let line = format!("verify nee {} --depth 2 --ages 1,3 {ITSELF}", cornell());
    let wide = place.run(&format!("{line} --delta 5")).done();
    assert!(wide.out.contains("verdict    pass") && !wide.out.contains("stage 2"), "{wide:?}");
    // Both ages are there, with an image and a tile each.
    for part in ["worst tile", "99.9 %", "seeds: restarts 0 to", "first against last age"] {
        assert!(wide.out.contains(part), "{part} in {wide:?}");
    }
    let narrow = place.run(&format!("{line} --delta 0.01 --restarts 24")).done();
    assert!(narrow.out.contains("verdict    inconclusive"), "{narrow:?}");
    assert!(narrow.out.contains("restarts 0 to 95"), "the second stage has four times as many");
}

#[test]
fn a_ladder_prints_and_writes_a_row_a_rung() {
    let place = Place::new("ladder");
    let line = format!(
        "verify nee {} --ladder --delta 10 --ages 1,3 --minutes 2 --out ladder.md {ITSELF}",
        scene("penumbra.pbrt")
    );
    let ran = place.run(&line).done();
    let rows: Vec<&str> = ran.out.lines().filter(|l| l.starts_with("| ")).skip(1).collect();
    assert_eq!(rows.len(), 5, "{ran:?}");
    for (row, rung) in rows.iter().zip(["still", "camera", "light", "occluder", "all"]) {
        assert!(row.contains(rung) && row.contains("| unbiased | 1, 3 | pass"), "{row}");
    }
    assert_eq!(std::fs::read_to_string(place.path("ladder.md")).unwrap(), ran.out);
    // A rung alone has the seeds, and so the figures, that it has among all. (The clock may give it
    // more restarts.)
    let alone =
        place.run(&line.replace("--ladder", "--ladder --rungs occluder --restarts 30")).done();
    let again = place.run(&line.replace("--ladder", "--ladder --restarts 30")).done();
    let row =
        |ran: &Ran| ran.out.lines().find(|l| l.contains("occluder |")).unwrap().replace(' ', "");
    assert_eq!(row(&alone), row(&again));
}

#[test]
fn a_ladders_plan_costs_nothing_and_its_rows_are_kept() {
    let place = Place::new("ladder-plan");
    let line = format!(
        "verify nee {} --ladder --rungs still --size 8x8 --ages 1 --delta 20 --reference-time 2",
        cornell()
    );
    let planned = place.run(&format!("{line} --plan")).done();
    assert!(
        planned.out.contains("minutes in all") && !planned.out.contains("verdict"),
        "{planned:?}"
    );
    assert!(planned.out.contains("1 rungs") || planned.out.contains("2 rungs"), "{planned:?}");
    let first = place.run(&line).done();
    assert!(first.out.contains("pass") && !first.out.contains("open"), "{first:?}");
    // Nothing is left to do; the rows are there all the same.
    assert!(place.run(&format!("{line} --plan")).done().out.contains("0 rungs"));
    let rows = |ran: &Ran| -> Vec<String> {
        ran.out.lines().filter(|line| line.starts_with('|')).map(String::from).collect()
    };
    assert_eq!(rows(&place.run(&line).done()), rows(&first));
    assert!(!place.run(&format!("{line} --fresh --plan")).done().out.contains("0 rungs"));
}

#[test]
fn motion_and_camera_are_part_of_the_scene_that_references_are_of() {
    let place = Place::new("motion");
    let line = format!(
        "compare {} --size 32x32 --depth 2 --spp 8 --restarts 12 --curve-restarts 0 --techniques nee --reference-time 4",
        cornell()
    );
    let moved = format!("{line} --motion light:0.05 --frames 5");
    let verdict = |folder: &str| place.results(folder).rows[0].bias.clone().unwrap().verdict;
    let cached = || std::fs::read_dir(place.path("cache/afterimage")).unwrap().count();

    // The reference is that of the frame that is judged; the first frame's is wrong for the fifth.
    place.run(&format!("{moved} --out fifth")).done();
    assert_ne!(verdict("fifth"), "fail");
    place.run(&format!("{moved} --frames 1 --out first").replace("--frames 5 ", "")).done();
    assert_ne!(verdict("first"), "fail");
    assert_eq!(cached(), 2);
    place.run(&format!("{moved} --reference first/reference.exr --out wrong")).done();
    assert_eq!(verdict("wrong"), "fail");
    assert!(place.results("fifth").command.contains("--motion light:0.05"));

    // Another speed and another camera are other pictures.
    for (more, known) in
        [("--motion light:0.04 --frames 5", 3), ("--look-at 0,1,-4,0,1,0,0,1,0", 4)]
    {
        let ran = place.run(&format!("{line} {more} --out other")).done();
        assert_eq!(cached(), known, "{more}");
        assert!(!ran.err.contains("warning"), "{ran:?}");
    }

    // What slides with the camera's picture: the lamp, which is seen without noise.
    let emission = |more: &str| {
        place.run(&format!("render {} --size 32x32 {more} --out shown.exr", cornell())).done();
        read_exr(&place.path("shown.exr")).unwrap().emission.unwrap()
    };
    let slid = "--filter point --motion camera:0.05";
    let [first, third] = [1, 3].map(|frame| emission(&format!("{slid} --frames {frame}")));
    assert_eq!(first, emission("--filter point --frames 1"), "the first frame is the file's");
    assert_ne!(first, third);
    // The file's own camera, given again.
    let own = "--look-at 0,1.6,-5.2,0,1.6,0,0,1,0";
    assert_eq!(first, emission(&format!("--filter point --frames 1 {own}")));

    let line = format!("verify nee {} --depth 2 --ages 1,3 --delta 10 {ITSELF}", cornell());
    let ran = place.run(&format!("{line} --motion occluder:0.02")).done();
    assert!(ran.out.contains("verdict    pass"), "{ran:?}");
}

#[test]
fn lag_without_history_is_one_frame() {
    let place = Place::new("lag");
    let line = format!(
        "lag {} --technique nee --size 32x32 --before 2 --after 3 --restarts 8 --reference-time 3",
        scene("penumbra.pbrt")
    );
    for change in ["light", "occluder"] {
        let ran = place.run(&format!("{line} --change {change}")).done();
        assert!(ran.out.contains("90 % of the step in frame 1\n"), "{ran:?}");
        let before = ran.out.lines().find(|l| l.trim_start().starts_with("before")).unwrap();
        let response: f64 = before.split_whitespace().nth(1).unwrap().parse().unwrap();
        assert!(response.abs() < 0.1, "{before}");
    }
}

#[test]
fn a_failed_verdict_is_status_one_only_where_check_asks() {
    let place = Place::new("check");
    // 16384 pixels x 6 restarts: the standard error of the image is below 0.5 %; a reference 10 %
    // too bright is far from that.
    let line = format!(
        "compare {} --size 64x64 --depth 3 --spp 4 --frames 1 --restarts 6 --curve-restarts 0 --techniques nee --reference-time 5",
        cornell()
    );
    place.run(&format!("{line} --out good --check")).done();
    let file = read_exr(&place.path("good/reference.exr")).unwrap();
    let emission = file.emission.unwrap();
    let pixels = file
        .picture
        .pixels
        .iter()
        .zip(&emission.pixels)
        .map(|(all, e)| (*all - *e) * 1.1 + *e)
        .collect();
    let wrong = Picture::new(64, 64, pixels);
    let layers = [Layer::rgb("color", &wrong), Layer::rgb("emission", &emission)];
    write_exr(&place.path("wrong.exr"), [64, 64], &layers).unwrap();
    let line = format!("{line} --reference wrong.exr --out bad");
    let ran = place.run(&line).done();
    assert!(ran.out.contains("fail -9"), "{ran:?}");
    assert_eq!(place.results("bad").rows[0].bias.as_ref().unwrap().verdict, "fail");
    assert_eq!(place.run(&format!("{line} --check")).status, Some(1));

    let verify = format!(
        "verify nee {} --quick --size 64x64 --depth 3 --restarts 16 --reference wrong.exr",
        cornell()
    );
    let ran = place.run(&verify).done();
    assert!(
        ran.out.contains("verdict    fail")
            && ran.out.contains("skewness")
            && ran.out.contains("--seed 1"),
        "{ran:?}"
    );
    assert_eq!(place.run(&format!("{verify} --check")).status, Some(1));
}

#[test]
fn render_writes_layers_that_do_not_depend_on_threads() {
    let place = Place::new("render");
    let line = format!("render {} --size 24x20 --depth 4 --spp 9", cornell());
    place.run(&format!("{line} --threads 1 --out a.exr")).done();
    place.run(&format!("{line} --threads 2 --out b.exr")).done();
    assert!(place.path("a.png").exists());
    let file = read_exr(&place.path("a.exr")).unwrap();
    assert_eq!(file.picture, read_exr(&place.path("b.exr")).unwrap().picture);
    assert_eq!([file.picture.width, file.picture.height], [24, 20]);
    let emission = file.emission.unwrap();
    assert!(
        emission.mean_luminance() > 0.0
            && file.picture.mean_luminance() > emission.mean_luminance()
    );
    // All layers by name, as other programs see them.
    let bytes = std::fs::read(place.path("a.exr")).unwrap();
    for layer in ["color", "albedo", "normal", "depth", "motion", "emission"] {
        assert!(bytes.windows(layer.len()).any(|w| w == layer.as_bytes()), "{layer}");
    }
}

/// `--spp 9` is a frame of 8 estimates and one of 1, each estimate of which counts alike: nine
/// times it less eight times the former is the ninth alone, which no pixel has negative. Another
/// `--seed` is another picture.
#[test]
fn estimates_that_are_left_over_count_alike() {
    let place = Place::new("rest");
    let render = |spp: u32, seed: u64| {
        let out = format!("{spp}-{seed}.exr");
        let size = "--size 24x20 --depth 4";
        let line = format!("render {} {size} --spp {spp} --seed {seed} --out {out}", cornell());
        place.run(&line).done();
        read_exr(&place.path(&out)).unwrap().picture
    };
    let [nine, eight, other] = [render(9, 1), render(8, 1), render(8, 2)];
    assert_ne!(eight, other);
    let mut lit = 0;
    for (nine, eight) in nine.pixels.iter().zip(&eight.pixels) {
        let ninth = 9.0 * *nine - 8.0 * *eight;
        let rounding = 1e-5 * eight.max_element();
        assert!(ninth.min_element() >= -rounding, "{nine} and {eight} leave {ninth}");
        lit += u32::from(ninth.max_element() > rounding);
    }
    assert!(lit > 100, "{lit} pixels are lit");
}

/// What is seen of lamps directly is no part of `diff`: a picture with its emission is the same as
/// the one without.
#[test]
fn diff_leaves_the_emission_out() {
    let place = Place::new("emission");
    place.run(&format!("render {} --size 24x20 --spp 1 --out all.exr", cornell())).done();
    let file = read_exr(&place.path("all.exr")).unwrap();
    let emission = file.emission.unwrap();
    assert!(emission.mean_luminance() > 0.0);
    let pixels = file.picture.pixels.iter().zip(&emission.pixels).map(|(a, e)| *a - *e).collect();
    let reflected = Picture::new(24, 20, pixels);
    write_exr(&place.path("reflected.exr"), [24, 20], &[Layer::rgb("color", &reflected)]).unwrap();
    let ran = place.run("diff all.exr reflected.exr --json").done();
    let found: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    assert_eq!(found["mse"].as_f64(), Some(0.0), "{found}");
    assert_eq!(found["mean_ratio"].as_f64(), Some(1.0), "{found}");
}

#[test]
fn render_says_where_light_is_beyond_numbers() {
    let place = Place::new("bright");
    let scene = |radiance: f32| {
        format!(
            "Camera \"perspective\"\nFilm \"rgb\"\nWorldBegin\nLightSource \"infinite\" \"rgb L\" \
             [{radiance} {radiance} {radiance}]\n"
        )
    };
    for (radiance, pixels) in [(1e38, Some("64 pixels are brighter")), (1e37, None)] {
        std::fs::write(place.path("sky.pbrt"), scene(radiance)).unwrap();
        let ran = place.run("render sky.pbrt --spp 8 --size 8x8").done();
        assert_eq!(ran.err.contains("warning"), pixels.is_some(), "{ran:?}");
        assert!(ran.err.contains(pixels.unwrap_or_default()), "{ran:?}");
    }
}

#[test]
fn a_depth_below_the_files_is_said() {
    let place = Place::new("depth");
    let text = "Camera \"perspective\"\nFilm \"rgb\"\nIntegrator \"path\" \"integer maxdepth\" 63\nWorldBegin\n\
                LightSource \"infinite\"\n";
    std::fs::write(place.path("sky.pbrt"), text).unwrap();
    for (depth, said) in [("", true), ("--depth 64", false), ("--depth 2", false)] {
        let ran = place.run(&format!("render sky.pbrt --spp 1 --size 8x8 {depth}")).done();
        let expected = "warning: sky.pbrt: paths end after 8 segments, the file asks for 64; `depth` sets another limit";
        assert_eq!(ran.err.lines().any(|line| line == expected), said, "{ran:?}");
    }
}

#[test]
fn plan_list_inspect_and_generate_speak() {
    let place = Place::new("speak");
    let scene = cornell();
    let plan = place.run(&format!("plan {scene} --technique nee --json")).done();
    let plan: serde_json::Value = serde_json::from_str(&plan.out).unwrap();
    assert_eq!((&plan["technique"], &plan["claim"]), (&"nee".into(), &"unbiased".into()));
    assert!(
        plan["passes"].as_array().unwrap().len() > 1
            && plan["bytes_per_pixel"].as_f64().unwrap() > 0.0
    );
    assert!(place.run(&format!("plan {scene} --technique nee")).done().out.contains("left out"));
    let measured =
        place.run(&format!("plan {scene} --technique nee --size 8x8 --measure 4")).done().out;
    for wanted in ["ns a pixel", "paths", "frame", "shadow_rays"] {
        assert!(measured.contains(wanted), "{wanted} in {measured}");
    }
    let techniques = place.run("list techniques").done().out;
    for wanted in ["nee: ", "lights=one", "restir-di: ", "cap=20"] {
        assert!(techniques.contains(wanted), "{wanted} in {techniques}");
    }
    assert!(place.run("list scenes").done().out.contains("many-lights:N"));
    let adapters = place.run("list adapters").done().out;
    assert!(adapters.starts_with("none: ") || adapters.contains(" ("), "{adapters}");
    let inspect = place
        .run(&format!("inspect {scene} --technique nee --pixel 8,12 --size 16x16 --samples 5"))
        .done();
    for text in ["albedo", "lights", "estimate", "skewness"] {
        assert!(inspect.out.contains(text), "{text} in {inspect:?}");
    }
    let lights = place.run("generate many-lights:3").done();
    assert!(lights.out.contains("WorldBegin"), "{lights:?}");
}

/// Ctrl-C in the middle of the restarts: what is done is written, whole, and nothing else is left.
#[cfg(unix)]
#[test]
fn an_interrupt_leaves_whole_files() {
    let place = Place::new("interrupt");
    let line = format!(
        "compare {} --size 32x32 --depth 3 --frames 2 --restarts 1000000 --spp 1 --reference-time 1 --out stopped",
        cornell()
    );
    let mut child =
        place.command(&line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // The reference is stored when it is done; the restarts follow.
    let begin = Instant::now();
    while !place.path("cache/afterimage").exists() && begin.elapsed() < Duration::from_secs(120) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was asked to");
        std::thread::sleep(Duration::from_millis(50));
    }
    std::thread::sleep(Duration::from_secs(2));
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{output:?}");
    let results = place.results("stopped");
    assert!(
        results.interrupted
            && results.rows.iter().all(|r| r.restarts > 0 && r.restarts < 1_000_000)
    );
    assert!(read_exr(&place.path("stopped/nee.exr")).is_ok());
    for folder in ["stopped", "cache/afterimage"] {
        for file in std::fs::read_dir(place.path(folder)).unwrap() {
            let name = file.unwrap().file_name().into_string().unwrap();
            assert!(!name.ends_with(".tmp"), "{name}");
        }
    }
}

/// Killed in the middle of the restarts: the same command goes on with those that are done.
#[cfg(unix)]
#[test]
fn a_killed_comparison_goes_on() {
    let place = Place::new("killed");
    let line = |restarts: u32| {
        format!(
            "compare {} --size 16x12 --depth 2 --frames 2 --restarts {restarts} --curve-restarts 0 \
             --techniques nee;ris --reference-time 1 --out killed",
            cornell()
        )
    };
    let mut child = place
        .command(&line(1_000_000))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let kept = || -> usize {
        let folders = std::fs::read_dir(place.path("cache/afterimage/kept")).into_iter().flatten();
        let files = folders.flat_map(|folder| std::fs::read_dir(folder.unwrap().path()).unwrap());
        files
            .filter(|file| {
                file.as_ref().unwrap().path().extension().is_some_and(|e| e == "restart")
            })
            .count()
    };
    let begin = Instant::now();
    while kept() < 12 && begin.elapsed() < Duration::from_secs(120) {
        assert!(child.try_wait().unwrap().is_none(), "it ended before it was killed");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(kept() >= 12 && !place.path("killed/results.json").exists());

    let ran = place.run(&line(5)).done();
    assert!(ran.out.contains("10 restarts, and the times that they took"), "{ran:?}");
    let results = place.results("killed");
    assert_eq!(results.resumed, 10);
    assert!(results.rows.iter().all(|row| row.restarts == 5 && row.samples.len() == 5));
    assert!(!place.path("cache/afterimage/kept").exists(), "what is done is forgotten");
}
