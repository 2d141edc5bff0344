//! The effort that fills a frame time.

use crate::Result;

/// What counts as meeting the budget: within 5 %.
const TOLERANCE: f64 = 0.05;
/// Measurements after which the best effort so far is taken.
const TRIES: usize = 10;
/// No budget asks for more independent estimates a frame.
const MOST: u32 = 1 << 20;

/// Whether a frame of `ms` is within 5 % of `budget`.
pub(crate) fn meets(ms: f64, budget: f64) -> bool {
    (ms - budget).abs() <= TOLERANCE * budget
}

/// The integer effort whose median steady frame, as `measure` gives it, is nearest to `budget` milliseconds, with that time.
///
/// Time is close to linear in effort, so a secant through the two measurements around the budget finds it; each step is kept
/// strictly between them, so noise cannot make it wander.
pub(crate) fn calibrate(
    budget: f64,
    mut measure: impl FnMut(u32) -> Result<f64>,
) -> Result<(u32, f64)> {
    let mut before: Option<(u32, f64)> = None;
    let mut below: Option<(u32, f64)> = None;
    let mut above: Option<(u32, f64)> = None;
    let mut best: Option<(u32, f64)> = None;
    let mut effort = 1_u32;
    for _ in 0..TRIES {
        let ms = measure(effort)?;
        if best.is_none_or(|(_, b)| (ms - budget).abs() < (b - budget).abs()) {
            best = Some((effort, ms));
        }
        if meets(ms, budget) {
            break;
        }
        if ms < budget {
            before = below;
            below = Some((effort, ms));
        } else {
            above = Some((effort, ms));
        }
        let next = match (below, above) {
            (None, _) => break,
            (Some((e, t)), None) => {
                // In proportion from one measurement; along the line through the last two, which finds the fixed cost.
                let guess = match before {
                    Some((d, s)) if t > s => {
                        f64::from(e) + f64::from(e - d) * (budget - t) / (t - s)
                    }
                    _ => f64::from(e) * budget / t.max(1e-9),
                };
                (guess.round() as u32).clamp(e + 1, e.saturating_mul(64).max(e + 1)).min(MOST)
            }
            (Some((e, t)), Some((f, u))) => {
                if f - e <= 1 {
                    break;
                }
                let guess = f64::from(e) + f64::from(f - e) * (budget - t) / (u - t);
                (guess.round() as u32).clamp(e + 1, f - 1)
            }
        };
        if next == effort {
            break;
        }
        effort = next;
    }
    Ok(best.unwrap_or((1, f64::NAN)))
}

/// The median of times, and their 99th percentile; NaN of none.
pub(crate) fn median_p99(times: &[f64]) -> [f64; 2] {
    if times.is_empty() {
        return [f64::NAN; 2];
    }
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let place = share * (sorted.len() - 1) as f64;
        let low = place.floor() as usize;
        let high = place.ceil() as usize;
        sorted[low] + (sorted[high] - sorted[low]) * (place - low as f64)
    };
    [at(0.5), at(0.99)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(budget: f64, time: impl Fn(u32) -> f64) -> (u32, f64, usize) {
        let mut calls = 0;
        let (effort, ms) = calibrate(budget, |e| {
            calls += 1;
            Ok(time(e))
        })
        .unwrap();
        (effort, ms, calls)
    }

    #[test]
    fn linear_times_are_met_in_few_measurements() {
        for (fixed, each, budget) in
            [(0.0, 1.0, 100.0), (30.0, 0.5, 100.0), (5.0, 10.0, 73.0), (0.1, 0.001, 50.0)]
        {
            let (effort, ms, calls) = run(budget, |e| fixed + each * f64::from(e));
            let step = each / budget;
            assert!(meets(ms, budget) || step > 0.05, "{fixed} {each} {budget}: {effort} {ms}");
            assert!(calls <= 6, "{calls}");
        }
    }

    #[test]
    fn a_technique_that_is_too_slow_stays_at_one() {
        assert_eq!(run(10.0, |e| 25.0 * f64::from(e)), (1, 25.0, 1));
    }

    #[test]
    fn coarse_steps_give_the_nearest() {
        assert_eq!(run(10.0, |e| 6.0 * f64::from(e)).0, 2);
        assert_eq!(run(8.5, |e| 6.0 * f64::from(e)).0, 1);
        assert!(!meets(12.0, 10.0) && meets(10.5, 10.0) && meets(9.5, 10.0));
    }

    #[test]
    fn noise_and_nonsense_end() {
        let jitter = |e: u32| f64::from(e) * if e.is_multiple_of(2) { 0.8 } else { 1.2 };
        assert!(run(1000.0, jitter).2 <= TRIES);
        assert!(run(10.0, |_| 0.0).2 <= TRIES);
        assert!(run(10.0, |_| 1.0).2 <= TRIES);
    }

    #[test]
    fn percentiles() {
        assert_eq!(median_p99(&[3.0, 1.0, 2.0])[0], 2.0);
        assert_eq!(median_p99(&[1.0, 2.0])[0], 1.5);
        assert!(median_p99(&[])[0].is_nan());
    }
}
