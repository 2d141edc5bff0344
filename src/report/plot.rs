//! Error against time as an SVG drawing, log-log.

use plotters::prelude::*;

use super::{Curve, CurvePoint, Warmup};
use crate::{Error, Result};

/// Colours that people with any colour vision tell apart (Okabe and Ito 2008).
const COLORS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 0, 0),
];

/// The root of relMSE against milliseconds a frame, a line a technique with its 95 % band, and a
/// guide of slope −1/2 (what independent samples give). `None` where there is no positive point to
/// draw.
///
/// # Errors
/// Where the drawing library refuses.
pub fn error_time_svg(title: &str, curves: &[Curve]) -> Result<Option<String>> {
    plot(title, "milliseconds a frame", curves)
}

/// The root of relMSE of every frame after a cold start, drawn as [`error_time_svg`]; the guide is
/// what a mean of independent frames gives.
///
/// # Errors
/// Where the drawing library refuses.
pub fn warmup_svg(title: &str, warmups: &[Warmup]) -> Result<Option<String>> {
    let curves: Vec<Curve> = warmups
        .iter()
        .map(|warmup| Curve {
            technique: warmup.technique.clone(),
            points: (1..)
                .zip(&warmup.relmse)
                .map(|(frame, &relmse)| CurvePoint {
                    effort: 1.0,
                    ms: f64::from(frame),
                    relmse,
                    samples: Vec::new(),
                })
                .collect(),
        })
        .collect();
    plot(title, "frames since the cold start", &curves)
}

/// Root relMSE against anything.
fn plot(title: &str, across: &str, curves: &[Curve]) -> Result<Option<String>> {
    let lines: Vec<(&str, Vec<Point>)> = curves
        .iter()
        .map(|c| (c.technique.as_str(), points(c)))
        .filter(|(_, p)| !p.is_empty())
        .collect();
    let all = || lines.iter().flat_map(|(_, points)| points);
    let Some(first) = all().next() else { return Ok(None) };
    let range = |low: fn(&Point) -> f64, high: fn(&Point) -> f64, start: &Point| {
        all().fold((low(start), high(start)), |(a, b), p| (a.min(low(p)), b.max(high(p))))
    };
    let (left, right) = range(|p| p.ms, |p| p.ms, first);
    let (bottom, top) = range(|p| p.low, |p| p.high, first);
    let (left, right) = (left / 1.25, right * 1.25);
    let (bottom, top) = (bottom / 1.25, top * 1.25);

    let mut text = String::new();
    draw(&mut text, [title, across], &lines, [left, right, bottom, top])
        .map_err(|e| Error::invalid(format!("cannot draw the plot of errors: {e}")))?;
    Ok(Some(text))
}

/// A point of a line, in error rather than squared error.
struct Point {
    ms: f64,
    error: f64,
    low: f64,
    high: f64,
}

/// The points that a logarithmic plot can show.
fn points(curve: &Curve) -> Vec<Point> {
    let mut points: Vec<Point> = curve
        .points
        .iter()
        .filter(|p| {
            p.ms > 0.0 && p.ms.is_finite() && p.relmse.mean > 0.0 && p.relmse.mean.is_finite()
        })
        .map(|p| {
            let error = p.relmse.mean.sqrt();
            // An interval that reaches below zero has no logarithm there; it is drawn down to a
            // third of the error.
            let [low, high] = p.relmse.ci.map_or([error, error], |[low, high]| {
                [low.max(p.relmse.mean / 9.0).sqrt(), high.max(p.relmse.mean).sqrt()]
            });
            Point { ms: p.ms, error, low, high }
        })
        .collect();
    points.sort_by(|a, b| a.ms.total_cmp(&b.ms));
    points
}

type Drawn = std::result::Result<(), Box<dyn std::error::Error>>;

fn draw(
    text: &mut String,
    [title, across]: [&str; 2],
    lines: &[(&str, Vec<Point>)],
    range: [f64; 4],
) -> Drawn {
    let [left, right, bottom, top] = range;
    let root = SVGBackend::with_string(text, (720, 540)).into_drawing_area();
    root.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&root)
        .caption(title, ("sans-serif", 18))
        .margin(16)
        .x_label_area_size(44)
        .y_label_area_size(64)
        .build_cartesian_2d((left..right).log_scale(), (bottom..top).log_scale())?;
    chart
        .configure_mesh()
        .x_desc(across)
        .y_desc("root relMSE")
        .x_label_formatter(&|v| super::figure(*v))
        .y_label_formatter(&|v| super::figure(*v))
        .light_line_style(BLACK.mix(0.06))
        .bold_line_style(BLACK.mix(0.15))
        .draw()?;
    // The guide starts at the first line's first point, and is clipped by the chart.
    if let Some(start) = lines.first().and_then(|(_, points)| points.first()) {
        let end = right.min(start.ms * (start.error / bottom).powi(2));
        let at = |ms: f64| (ms, start.error * (start.ms / ms).sqrt());
        chart
            .draw_series(DashedLineSeries::new(
                [at(start.ms), at(end)],
                4,
                4,
                BLACK.mix(0.5).stroke_width(1),
            ))?
            .label("slope -1/2")
            .legend(|(x, y)| PathElement::new([(x, y), (x + 18, y)], BLACK.mix(0.5)));
    }
    for (at, (name, points)) in lines.iter().enumerate() {
        let color = COLORS[at % COLORS.len()];
        let band: Vec<(f64, f64)> = points
            .iter()
            .map(|p| (p.ms, p.high))
            .chain(points.iter().rev().map(|p| (p.ms, p.low)))
            .collect();
        chart.draw_series([Polygon::new(band, color.mix(0.18))])?;
        chart
            .draw_series(LineSeries::new(
                points.iter().map(|p| (p.ms, p.error)),
                color.stroke_width(2),
            ))?
            .label(*name)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 18, y)], color.stroke_width(2)));
        chart
            .draw_series(points.iter().map(|p| Circle::new((p.ms, p.error), 3, color.filled())))?;
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::LowerLeft)
        .background_style(WHITE.mix(0.8))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 13))
        .draw()?;
    root.present()?;
    drop(chart);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Figure;
    use super::*;

    fn curve(name: &str, values: &[(f64, f64)]) -> Curve {
        let points = values
            .iter()
            .map(|&(ms, mean)| CurvePoint {
                effort: 1.0,
                ms,
                relmse: Figure { mean, ci: Some([0.5 * mean, 1.5 * mean]) },
                samples: Vec::new(),
            })
            .collect();
        Curve { technique: name.into(), points }
    }

    #[test]
    fn draws_a_line_a_technique_with_labels_and_a_band() {
        let curves = [
            curve("nee", &[(10.0, 1.0), (20.0, 0.5), (40.0, 0.25)]),
            curve("bsdf", &[(8.0, 4.0), (16.0, 2.0)]),
        ];
        let svg = error_time_svg("cornell", &curves).unwrap().unwrap();
        for part in ["<svg", "nee", "bsdf", "slope -1/2", "root relMSE", "<polygon", "</svg>"] {
            assert!(svg.contains(part), "{part}");
        }
        assert!(!svg.contains("NaN"));
    }

    #[test]
    fn warmup_is_drawn_against_frames() {
        let figure = |mean: f64| Figure { mean, ci: None };
        let relmse = (1..=8).map(|n| figure(1.0 / f64::from(n))).collect();
        let warmups = [Warmup { technique: "mcmm".into(), relmse }];
        let svg = warmup_svg("cornell", &warmups).unwrap().unwrap();
        assert!(svg.contains("frames since") && svg.contains("mcmm") && !svg.contains("NaN"));
        assert!(warmup_svg("x", &[]).unwrap().is_none());
    }

    #[test]
    fn nothing_to_draw_is_no_plot_and_odd_points_are_left_out() {
        assert!(error_time_svg("x", &[]).unwrap().is_none());
        assert!(
            error_time_svg("x", &[curve("a", &[(1.0, 0.0), (f64::NAN, 1.0)])]).unwrap().is_none()
        );
        let one = error_time_svg("x", &[curve("a", &[(1.0, 0.5)])]).unwrap().unwrap();
        assert!(!one.contains("NaN") && !one.contains("inf"));
    }
}
