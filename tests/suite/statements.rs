//! Why mutations make covariance fall: equations 11 and 17 of the supplemental of Sawhney et al.
//! (2024), in its own setting, by enumeration.
//!
//! Two pixels with targets p̂¹ and p̂² each take one sample from a source pixel with target p̂ₛ.
//! Both sources carry the same sample X with contribution weight W, as after temporal reuse of one
//! that had spread; each moves it by n mutations of its own. What a pixel shows is p̂ⁱ(Yⁱ) W′ⁱ. All
//! of it is in units of ‖p̂¹‖ ‖p̂²‖.

use std::fmt::Write as _;

use afterimage::math::rng::RandomSource;
use afterimage::resampling::{Mutator, Proposal, metropolis, mutated_weight};
use afterimage::stats::{enumerate_f64, expectation};

type States = [f64; 6];

/// p̂ₛ, and those of the pixels, whose ratios to it are large where it is small.
const SOURCE: States = [1.0, 2.0, 5.0, 6.0, 4.0, 2.0];
const PIXELS: [States; 2] = [[6.0, 3.0, 1.0, 1.0, 1.0, 2.0], [5.0, 2.0, 1.0, 1.0, 1.0, 3.0]];

fn normalized(target: &States) -> States {
    target.map(|value| value / target.iter().sum::<f64>())
}

/// How the source drew X, and the W that it has.
type Drawn = [(f64, f64); 6];

/// In proportion to p̂ₛ, with W = 1/p̄ₛ.
fn ideal() -> Drawn {
    normalized(&SOURCE).map(|density| (density, 1.0 / density))
}

/// By other densities; W is their inverse.
fn otherwise() -> Drawn {
    [0.1, 0.1, 0.2, 0.2, 0.2, 0.2].map(|density| (density, 1.0 / density))
}

/// A step to one of both neighbours on a ring.
struct Ring;

impl Mutator for Ring {
    type State = usize;

    fn propose(&mut self, &at: &usize, random: &mut impl RandomSource) -> Option<Proposal<usize>> {
        let to = (at + if random.index(2) == 0 { 1 } else { 5 }) % 6;
        Some(Proposal { state: to, acceptance: (SOURCE[to] / SOURCE[at]).min(1.0) as f32 })
    }
}

/// Mean of `of` over all that two chains of `steps` mutations make of X: W' and Y of both.
fn mean(drawn: &Drawn, steps: u32, of: impl Fn([(usize, f64); 2]) -> f64) -> f64 {
    let after = |x: usize, weight: f64| {
        enumerate_f64(|random| {
            let y = metropolis(&mut Ring, x, steps, random).state;
            let [before, there] = [x, y].map(|at| SOURCE[at] as f32);
            (y, f64::from(mutated_weight(weight as f32, before, there)))
        })
    };
    let each = drawn.iter().enumerate().map(|(x, (probability, weight))| {
        let chains = after(x, *weight);
        let pairs = |first| expectation(&chains, |second| of([first, *second]));
        probability * expectation(&chains, |first| pairs(*first))
    });
    each.sum()
}

/// Covariance of both pixels' estimates after `steps` mutations.
fn covariance(drawn: &Drawn, steps: u32) -> f64 {
    let [first, second] = PIXELS.map(|target| normalized(&target));
    mean(drawn, steps, |[(y, w), (z, v)]| (first[y] * w - 1.0) * (second[z] * v - 1.0))
}

/// Equation 17: without mutations.
fn without(drawn: &Drawn) -> f64 {
    let [first, second] = PIXELS.map(|target| normalized(&target));
    (0..6)
        .map(|x| drawn[x].0 * (first[x] * drawn[x].1 - 1.0) * (second[x] * drawn[x].1 - 1.0))
        .sum()
}

/// Equation 11: in the limit of many.
fn limit(drawn: &Drawn) -> f64 {
    let source = normalized(&SOURCE);
    (0..6).map(|x| drawn[x].0 * (source[x] * drawn[x].1 - 1.0).powi(2)).sum()
}

/// Without mutations it is equation 17, with many it comes to equation 11: nothing is left where
/// the source draws in proportion to its target, and every step leads there. Where it does not,
/// steps lead below equation 11 and back: that "every mutation is a step closer to the limit" is
/// not so. Each pixel's mean stays, and so does the variance of one that keeps its own sample.
#[test]
fn mutations_lead_from_equation_17_to_equation_11() {
    let close = |a: f64, b: f64| (a - b).abs() < 1e-6;
    for (drawn, eq17, eq11) in [(ideal(), 3.0238, 0.0), (otherwise(), 1.2253, 0.1375)] {
        let found = [without(&drawn), limit(&drawn)];
        assert!((found[0] - eq17).abs() < 1e-4 && (found[1] - eq11).abs() < 1e-4, "{found:?}");
        let steps: Vec<f64> = (0..=8).map(|steps| covariance(&drawn, steps)).collect();
        println!("{steps:.4?}");
        assert!(close(steps[0], without(&drawn)));
        assert!((steps[8] - eq11).abs() < 0.02 * (steps[0] - eq11).abs());
        let falls = steps.windows(2).all(|pair| pair[1] < pair[0]);
        let least = steps.iter().copied().fold(f64::MAX, f64::min);
        assert_eq!((falls, least < eq11), if eq11 == 0.0 { (true, false) } else { (false, true) });
        for steps in [0, 1, 3] {
            let own = normalized(&SOURCE);
            for pixel in PIXELS.map(|target| normalized(&target)) {
                assert!(close(mean(&drawn, steps, |[(y, w), _]| pixel[y] * w), 1.0));
            }
            let variance = mean(&drawn, steps, |[(y, w), _]| (own[y] * w - 1.0).powi(2));
            assert!(close(variance, limit(&drawn)), "{variance}");
        }
    }
}

/// The picture in `docs/mutations.md`.
fn picture() -> String {
    let [left, top, width, height] = [70.0, 30.0, 480.0, 250.0];
    let most = 3.2;
    let place =
        |steps: f64, value: f64| (left + width * steps / 8.0, top + height * (1.0 - value / most));
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 600 340\" width=\"600\" height=\"340\" font-family=\"Helvetica, Arial, 'DejaVu Sans', sans-serif\" font-size=\"13\" fill=\"#1d2733\">\n  <title>Covariance of two pixels against the number of mutations</title>\n  <rect width=\"600\" height=\"340\" fill=\"#fdfdfa\"/>\n",
    );
    for value in 0..=3 {
        let value = f64::from(value);
        let (x, y) = place(0.0, value);
        let end = left + width;
        let _ = writeln!(svg, "  <path d=\"M{x:.1},{y:.1} H{end:.1}\" stroke=\"#d9ded6\"/>");
        let (x, y) = (x - 10.0, y + 4.0);
        let _ =
            writeln!(svg, "  <text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"end\">{value}</text>");
    }
    for steps in 0..=8 {
        let (x, y) = place(f64::from(steps), 0.0);
        let y = y + 20.0;
        let _ = writeln!(
            svg,
            "  <text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"middle\">{steps}</text>"
        );
    }
    let _ = writeln!(
        svg,
        "  <text x=\"310\" y=\"325\" text-anchor=\"middle\">mutations between reuses, n</text>"
    );
    let curves = [
        ("X drawn in proportion to its target", "#1f6fb5", ideal(), 60),
        ("X drawn otherwise", "#c9700a", otherwise(), 82),
    ];
    for (name, colour, drawn, legend) in curves {
        let mut path = String::new();
        for steps in 0..=8 {
            let (x, y) = place(f64::from(steps), covariance(&drawn, steps));
            let _ = write!(path, "{}{x:.1},{y:.1}", if steps == 0 { "M" } else { " L" });
            let _ =
                writeln!(svg, "  <circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"{colour}\"/>");
        }
        let _ = writeln!(
            svg,
            "  <path d=\"{path}\" fill=\"none\" stroke=\"{colour}\" stroke-width=\"2\"/>"
        );
        let ((x, y), end) = (place(0.0, limit(&drawn)), left + width);
        let _ = writeln!(
            svg,
            "  <path d=\"M{x:.1},{y:.1} H{end:.1}\" stroke=\"{colour}\" stroke-dasharray=\"5 4\"/>"
        );
        let _ = writeln!(
            svg,
            "  <text x=\"250\" y=\"{legend}\" fill=\"{colour}\">{name}; dashed: the limit, equation 11</text>"
        );
    }
    svg.push_str("</svg>\n");
    svg
}

/// The picture in the documentation is this one. It is written anew where the environment says
/// `AFTERIMAGE_DRAW`.
#[test]
fn the_picture_is_of_these_numbers() {
    let place = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/images/mutations.svg");
    let picture = picture();
    if std::env::var_os("AFTERIMAGE_DRAW").is_some() {
        std::fs::write(&place, &picture).unwrap();
    }
    let kept = std::fs::read_to_string(&place).unwrap();
    assert!(kept == picture, "{} is of other numbers", place.display());
}
