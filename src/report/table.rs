//! Tables for people and spreadsheets.

use std::fmt::Write as _;

use super::{Budget, BudgetKind, Figure, FrameTime, METRICS, Results, Row, SpectrumPoint};

/// A Markdown table, a row a technique, with the settings above it. A figure is bold only where it
/// is the lowest and its 95 % interval meets no other row's.
#[must_use]
pub fn markdown(results: &Results) -> String {
    table(results, &METRICS)
}

/// As [`markdown`], with the few columns that fit a terminal.
#[must_use]
pub fn summary(results: &Results) -> String {
    table(results, &["relmse", "flip", "ttuv"])
}

fn table(results: &Results, metrics: &[&'static str]) -> String {
    let metrics: Vec<&str> = metrics
        .iter()
        .copied()
        .filter(|m| results.rows.iter().any(|r| r.metrics.contains_key(*m)))
        .collect();
    let mut header: Vec<String> =
        ["technique", "claim", "effort", "ms/frame", "rays/px", "B/px"].map(String::from).into();
    header.extend(metrics.iter().map(|m| (*m).to_string()));
    header.push("bias".to_string());
    let body: Vec<Vec<String>> = results
        .rows
        .iter()
        .enumerate()
        .map(|(at, row)| {
            let mut cells = vec![
                format!("`{}`", row.technique),
                row.claim.to_string(),
                effort(row),
                milliseconds(row),
                figure(row.rays_per_pixel.values().sum()),
                figure(row.bytes_per_pixel),
            ];
            cells.extend(metrics.iter().map(|m| cell(results, at, m)));
            cells.push(bias(row));
            cells
        })
        .collect();
    let mut text = heading(results);
    text.push_str(&align(&header, &body));
    for note in notes(results) {
        let _ = writeln!(text, "\n{note}");
    }
    text
}

fn heading(results: &Results) -> String {
    let [width, height] = results.size;
    let (frames, restarts) = results.rows.first().map_or((0, 0), |r| (r.frames, r.restarts));
    let reference = &results.reference;
    let mut text = format!(
        "{} at {width}x{height}, depth {}, {} filter; frame {frames} after a cold start, {restarts} restarts, seed {}\n",
        results.scene, results.depth, results.filter, results.seed
    );
    let _ = write!(text, "reference: {}", reference.source);
    if let (Some(technique), Some(samples)) = (&reference.technique, reference.samples) {
        let _ = write!(text, ", `{technique}`, {samples} samples a pixel");
    }
    match reference.share_of_smallest_mse {
        Some(share) => {
            let _ =
                write!(text, "; its variance is {} % of the smallest mse", figure(100.0 * share));
        }
        None => text.push_str("; its noise is not known"),
    }
    text.push_str("\n\n");
    text
}

fn effort(row: &Row) -> String {
    let effort = row.budget.effort;
    if row.budget.over_budget { format!("{effort} (off budget)") } else { effort.to_string() }
}

/// The median with half of its interval, and how far it drifted.
fn milliseconds(row: &Row) -> String {
    let time = &row.ms_per_frame;
    let mut text = figure(time.median);
    if let Some([low, high]) = time.ci {
        let _ = write!(text, " ± {}", spread(0.5 * (high - low), time.median));
    }
    if let Some(drift) = time.drift() {
        let _ = write!(text, " (drift {:+.0} %)", 100.0 * drift);
    }
    text
}

fn cell(results: &Results, at: usize, metric: &str) -> String {
    let Some(this) = results.rows[at].metrics.get(metric) else { return "-".to_string() };
    let mut text = figure(this.mean);
    if let Some([low, high]) = this.ci {
        let _ = write!(text, " ± {}", spread(0.5 * (high - low), this.mean));
    }
    let wins = results.rows.len() > 1
        && results
            .rows
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != at)
            .filter_map(|(_, row)| row.metrics.get(metric))
            .all(|other: &Figure| this.mean < other.mean && this.apart(other));
    if wins { format!("**{text}**") } else { text }
}

fn bias(row: &Row) -> String {
    let Some(bias) = &row.bias else { return "-".to_string() };
    let mut text = format!("{} {:+.2} %", bias.verdict, 100.0 * bias.relative);
    if let Some([low, high]) = bias.ci {
        let _ = write!(text, " [{:+.2}, {:+.2}]", 100.0 * low, 100.0 * high);
    }
    if bias.tiles_rejected > 0 {
        let _ = write!(text, ", {} tiles", bias.tiles_rejected);
    }
    text
}

fn notes(results: &Results) -> Vec<String> {
    let mut notes = vec![
        "± is half of the 95 % interval over restarts (of ms/frame: of each restart's median); bold: lowest, and no other interval meets it."
            .to_string(),
    ];
    if results.resumed > 0 {
        notes.push(format!(
            "{} restarts, and the times that they took, are of an earlier run that was interrupted.",
            results.resumed
        ));
    }
    for row in &results.rows {
        if row.budget.over_budget {
            notes.push(format!(
                "`{}` is off the budget of {} ms by more than 5 %: its frames took {} ms (no effort fits, or the machine's speed changed).",
                row.technique,
                figure(row.budget.value),
                figure(row.ms_per_frame.median)
            ));
        }
    }
    for row in results.rows.iter().filter(|row| is_beside_budget(row)) {
        notes.push(format!(
            "`{}` keeps reservoirs, so its effort is whole: its frames took {} ms of {} ms. Compare `ttuv`, error times time.",
            row.technique,
            figure(row.ms_per_frame.median),
            figure(row.budget.value)
        ));
    }
    for row in &results.rows {
        let FrameTime { calibrated: Some(before), recalibrated: Some(after), .. } =
            row.ms_per_frame
        else {
            continue;
        };
        if row.ms_per_frame.drift().is_some() {
            notes.push(format!(
                "`{}` drifted: frames that took {} ms before its restarts took {} ms after them, so its time is not comparable to 5 %.",
                row.technique,
                figure(before),
                figure(after)
            ));
        }
    }
    if results.interrupted {
        notes.push("Stopped early: these are the restarts that were done.".to_string());
    }
    notes
}

/// Whether a technique with whole efforts is more than 5 % beside a frame time.
fn is_beside_budget(row: &Row) -> bool {
    let Budget { kind, value, .. } = row.budget;
    let off = (row.ms_per_frame.median - value).abs() > 0.05 * value;
    row.whole_effort && kind == BudgetKind::FrameTime && off
}

/// Pads the columns so that the table can be read as text.
pub(crate) fn align(header: &[String], body: &[Vec<String>]) -> String {
    let width = |column: usize| {
        body.iter()
            .map(|row| &row[column])
            .chain([&header[column]])
            .map(|c| c.chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let line = |cells: &[String]| {
        let mut text = String::from("|");
        for (cell, width) in cells.iter().zip(&widths) {
            let _ = write!(text, " {cell:width$} |");
        }
        text.push('\n');
        text
    };
    let mut text = line(header);
    text.push('|');
    for width in &widths {
        let _ = write!(text, "{}|", "-".repeat(width + 2));
    }
    text.push('\n');
    for row in body {
        text.push_str(&line(row));
    }
    text
}

/// Three significant digits, without an exponent where it reads well without.
#[must_use]
pub fn figure(value: f64) -> String {
    let size = value.abs();
    if !value.is_finite() || size == 0.0 {
        value.to_string()
    } else if !(1e-3..1e5).contains(&size) {
        format!("{value:.2e}")
    } else {
        let digits = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{value:.digits$}")
    }
}

/// A half width with as many decimals as `mean` is shown with.
fn spread(half: f64, mean: f64) -> String {
    let size = mean.abs();
    if !half.is_finite() || !(1e-3..1e5).contains(&size) {
        return format!("{half:.1e}");
    }
    let digits = (2 - size.log10().floor() as i32).max(0) as usize;
    // A spread that would round to nothing keeps a digit of its own.
    let digits =
        if half > 0.0 { digits.max((-half.log10().floor()).max(0.0) as usize) } else { digits };
    format!("{half:.digits$}")
}

/// Comma-separated values, a row a technique; each metric has its mean and both ends of its
/// interval.
#[must_use]
pub fn csv(results: &Results) -> String {
    let mut text = String::from(
        "technique,claim,backend,budget,budget_value,effort,over_budget,frames,restarts,ms_median,ms_low,ms_high,ms_p99,ms_first,ms_drift,rays_per_pixel,\
         bytes_per_pixel,bias_verdict,bias_relative,bias_low,bias_high,tiles_rejected",
    );
    for metric in METRICS {
        let _ = write!(text, ",{metric},{metric}_low,{metric}_high");
    }
    text.push('\n');
    for row in &results.rows {
        let kind = serde_json::to_value(row.budget.kind).unwrap_or_default();
        let _ = write!(
            text,
            "{},{},{},{},{},{},{},{},{},{}{},{},{},{},{},{}",
            quoted(&row.technique),
            row.claim,
            row.backend,
            kind.as_str().unwrap_or_default(),
            row.budget.value,
            row.budget.effort,
            row.budget.over_budget,
            row.frames,
            row.restarts,
            row.ms_per_frame.median,
            ends(row.ms_per_frame.ci),
            row.ms_per_frame.p99,
            row.ms_per_frame.first,
            row.ms_per_frame.drift().map_or(String::new(), |drift| drift.to_string()),
            row.rays_per_pixel.values().sum::<f64>(),
            row.bytes_per_pixel
        );
        match &row.bias {
            Some(b) => {
                let _ = write!(
                    text,
                    ",{},{}{},{}",
                    b.verdict,
                    b.relative,
                    ends(b.ci),
                    b.tiles_rejected
                );
            }
            None => text.push_str(",,,,,"),
        }
        for metric in METRICS {
            match row.metrics.get(metric) {
                Some(f) => {
                    let _ = write!(text, ",{}{}", f.mean, ends(f.ci));
                }
                None => text.push_str(",,,"),
            }
        }
        text.push('\n');
    }
    text
}

fn ends(ci: Option<[f64; 2]>) -> String {
    ci.map_or(",,".to_string(), |[low, high]| format!(",{low},{high}"))
}

/// A field that may hold commas (a technique's parameters).
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_string()
    }
}

/// The points of the error-against-time plot.
#[must_use]
pub fn curve_csv(results: &Results) -> String {
    let mut text = String::from("technique,effort,ms,relmse,relmse_low,relmse_high\n");
    for curve in &results.curves {
        for p in &curve.points {
            let _ = writeln!(
                text,
                "{},{},{},{}{}",
                quoted(&curve.technique),
                p.effort,
                p.ms,
                p.relmse.mean,
                ends(p.relmse.ci)
            );
        }
    }
    text
}

/// The error of every frame after a cold start.
#[must_use]
pub fn warmup_csv(results: &Results) -> String {
    let mut text = String::from("technique,frame,relmse,relmse_low,relmse_high\n");
    for warmup in &results.warmups {
        for (at, relmse) in warmup.relmse.iter().enumerate() {
            let technique = quoted(&warmup.technique);
            let _ = writeln!(text, "{technique},{},{}{}", at + 1, relmse.mean, ends(relmse.ci));
        }
    }
    text
}

/// The power of the error by frequency.
#[must_use]
pub fn spectrum_csv(results: &Results) -> String {
    let mut text = String::from("technique,cycles_per_pixel,power,power_low,power_high\n");
    for spectrum in &results.spectra {
        for SpectrumPoint { cycles, power } in &spectrum.points {
            let technique = quoted(&spectrum.technique);
            let _ = writeln!(text, "{technique},{cycles},{}{}", power.mean, ends(power.ci));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::super::results::tests::{results, row};
    use super::*;

    #[test]
    fn bold_needs_intervals_apart_from_all_others() {
        let far =
            markdown(&results(vec![row("a", 0.1, 0.01), row("b", 0.5, 0.1), row("c", 0.9, 0.1)]));
        assert!(far.contains("**0.100 ± 0.010**"), "{far}");
        assert_eq!(far.matches("**").count(), 2, "{far}");
        let near =
            markdown(&results(vec![row("a", 0.1, 0.01), row("b", 0.11, 0.01), row("c", 0.9, 0.1)]));
        assert!(!near.contains("**"), "{near}");
        let alone = markdown(&results(vec![row("a", 0.1, 0.01)]));
        assert!(!alone.contains("**"), "{alone}");
    }

    #[test]
    fn drift_and_whole_efforts_are_said_only_where_they_are() {
        let mut drifted = row("a", 0.1, 0.01);
        drifted.ms_per_frame.recalibrated = Some(11.0);
        let mut reuse = row("b", 0.2, 0.01);
        reuse.whole_effort = true;
        reuse.budget = Budget { kind: BudgetKind::FrameTime, value: 12.0, ..reuse.budget };
        let text = markdown(&results(vec![drifted, reuse.clone()]));
        assert!(
            text.contains("10.0 ± 0.5 (drift +10 %)") && text.contains("`a` drifted"),
            "{text}"
        );
        assert!(
            text.contains("`b` keeps reservoirs") && text.contains("10.0 ms of 12.0 ms"),
            "{text}"
        );
        assert!(!text.contains("off budget") && !text.contains("`b` drifted"), "{text}");
        // Within 5 % there is nothing to say.
        reuse.budget.value = 10.2;
        let text = markdown(&results(vec![row("a", 0.1, 0.01), reuse]));
        assert!(!text.contains("drift") && !text.contains("keeps reservoirs"), "{text}");
    }

    #[test]
    fn every_table_line_has_the_same_columns() {
        let text = markdown(&results(vec![
            row("a", 0.1, 0.01),
            row("restir:cap=5,mutations=2", 0.5, 0.1),
        ]));
        let counts: Vec<usize> =
            text.lines().filter(|l| l.starts_with('|')).map(|l| l.matches('|').count()).collect();
        assert_eq!(counts.len(), 4);
        assert!(counts.iter().all(|c| *c == counts[0]), "{text}");
    }

    #[test]
    fn csv_rows_have_as_many_fields_as_the_header() {
        let mut with_bias = row("b", 0.5, 0.1);
        with_bias.bias = Some(super::super::Bias {
            verdict: "pass".into(),
            relative: 0.001,
            ci: Some([0.0, 0.002]),
            tiles_rejected: 0,
        });
        let text = csv(&results(vec![row("a", 0.1, 0.01), with_bias]));
        let counts: Vec<usize> = text.lines().map(|l| l.split(',').count()).collect();
        assert_eq!(counts, [counts[0]; 3], "{text}");
        assert!(quoted("a:x=1,y=2").starts_with('"'));
    }

    #[test]
    fn warmup_and_spectrum_have_a_line_a_figure() {
        let figure = |mean: f64| Figure { mean, ci: Some([0.5 * mean, 2.0 * mean]) };
        let mut all = results(vec![row("a:x=1,y=2", 0.1, 0.01)]);
        all.warmups = vec![super::super::Warmup {
            technique: "a:x=1,y=2".into(),
            relmse: vec![figure(4.0), Figure { mean: 1.0, ci: None }],
        }];
        all.spectra = vec![super::super::ErrorSpectrum {
            technique: "b".into(),
            points: vec![SpectrumPoint { cycles: 0.25, power: figure(1.5) }],
        }];
        let lines: Vec<String> = warmup_csv(&all).lines().map(String::from).collect();
        assert_eq!(lines[1..], ["\"a:x=1,y=2\",1,4,2,8", "\"a:x=1,y=2\",2,1,,"]);
        assert_eq!(spectrum_csv(&all).lines().nth(1), Some("b,0.25,1.5,0.75,3"));
    }

    #[test]
    fn figures_have_three_digits() {
        for (value, text) in [
            (1234.5, "1234"),
            (12.345, "12.3"),
            (0.012345, "0.0123"),
            (1.2e-7, "1.20e-7"),
            (0.0, "0"),
            (2.0, "2.00"),
        ] {
            assert_eq!(figure(value), text);
        }
    }
}
