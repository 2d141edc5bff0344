//! The effort that fills a frame time.

/// What counts as meeting the budget: within 5 %.
const TOLERANCE: f64 = 0.05;
/// Measurements after which the best effort so far is taken.
const TRIES: usize = 10;
/// No budget needs more independent estimates a frame.
const MOST: u32 = 1 << 20;

/// Whether a frame of `ms` is within 5 % of `budget`.
pub(super) fn meets(ms: f64, budget: f64) -> bool {
    (ms - budget).abs() <= TOLERANCE * budget
}

/// A measured time of a number of steps.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Point {
    steps: u32,
    ms: f64,
}

/// The search for the effort whose median steady frame is nearest to a budget of milliseconds.
///
/// Efforts are whole numbers of steps. Time is close to linear in effort, so a secant through the
/// two measurements around the budget finds it; each step is kept strictly between them, so noise
/// cannot make it wander. The caller measures what [`Search::next`] names and says what it took, by
/// turns with other searches.
#[derive(Clone, Debug)]
pub(super) struct Search {
    budget: f64,
    /// Steps of an effort of 1, which is the least.
    unit: u32,
    next: Option<u32>,
    tries: usize,
    before: Option<Point>,
    below: Option<Point>,
    above: Option<Point>,
    best: Option<Point>,
}

impl Search {
    /// A search in steps of which an effort of 1 has `unit`, beginning there.
    pub(super) fn new(budget: f64, unit: u32) -> Self {
        Self {
            budget,
            unit,
            next: Some(unit),
            tries: 0,
            before: None,
            below: None,
            above: None,
            best: None,
        }
    }

    /// The steps to be measured next; `None`: the search is over.
    pub(super) fn next(&self) -> Option<u32> {
        self.next
    }

    /// The steps whose time came nearest to the budget.
    pub(super) fn best(&self) -> u32 {
        self.best.map_or(self.unit, |point| point.steps)
    }

    /// Takes the milliseconds of the steps that were to be measured.
    pub(super) fn measured(&mut self, ms: f64) {
        let Some(steps) = self.next.take() else { return };
        let point = Point { steps, ms };
        self.tries += 1;
        let distance = |point: &Point| (point.ms - self.budget).abs();
        if self.best.is_none_or(|best| distance(&point) < distance(&best)) {
            self.best = Some(point);
        }
        if distance(&point) <= self.enough() {
            return;
        }
        if ms < self.budget {
            self.before = self.below.replace(point);
        } else {
            self.above = Some(point);
        }
        self.next = self.guess().filter(|next| *next != steps && self.tries < TRIES);
    }

    /// How near is near enough: where steps are fine, a fifth of what meets the budget, so that
    /// noise leaves it met.
    fn enough(&self) -> f64 {
        let share = if self.unit > 1 { 0.2 * TOLERANCE } else { TOLERANCE };
        share * self.budget
    }

    /// The steps that the measurements so far point to; `None` where there is nothing between them.
    fn guess(&self) -> Option<u32> {
        let below = self.below?;
        let Some(above) = self.above else {
            // In proportion from one measurement; along the line through the last two, which finds
            // the fixed cost.
            let guess = match self.before {
                Some(before) if below.ms > before.ms => line(before, below, self.budget),
                _ => f64::from(below.steps) * self.budget / below.ms.max(1e-9),
            };
            let least = below.steps + 1;
            let most = below.steps.saturating_mul(64).max(least);
            return Some((guess.round() as u32).clamp(least, most).min(MOST.max(self.unit)));
        };
        if above.steps - below.steps <= 1 {
            return None;
        }
        let guess = line(below, above, self.budget).round() as u32;
        Some(guess.clamp(below.steps + 1, above.steps - 1))
    }
}

/// Where the line through two points has the time `ms`.
fn line(a: Point, b: Point, ms: f64) -> f64 {
    let slope = f64::from(b.steps - a.steps) / (b.ms - a.ms);
    f64::from(b.steps) + slope * (ms - b.ms)
}

/// Runs searches by turns: in every round `measure` gets all that are not over, as their number and
/// steps, and answers with their times, so that a change of the machine's speed meets all alike.
pub(super) fn by_turns<E>(
    searches: &mut [Search],
    mut measure: impl FnMut(&[(usize, u32)]) -> Result<Vec<f64>, E>,
) -> Result<(), E> {
    loop {
        let round: Vec<(usize, u32)> = searches
            .iter()
            .enumerate()
            .filter_map(|(number, search)| Some((number, search.next()?)))
            .collect();
        if round.is_empty() {
            return Ok(());
        }
        for ((number, _), ms) in round.iter().zip(measure(&round)?) {
            searches[*number].measured(ms);
        }
    }
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

    /// Steps and their time that a search finds, and its number of measurements.
    fn run(budget: f64, unit: u32, time: impl Fn(u32) -> f64) -> (u32, f64, usize) {
        let mut search = Search::new(budget, unit);
        let mut calls = 0;
        while let Some(steps) = search.next() {
            calls += 1;
            search.measured(time(steps));
        }
        (search.best(), time(search.best()), calls)
    }

    #[test]
    fn linear_times_are_met_in_few_measurements() {
        for (fixed, each, budget) in
            [(0.0, 1.0, 100.0), (30.0, 0.5, 100.0), (5.0, 10.0, 73.0), (0.1, 0.001, 50.0)]
        {
            let (effort, ms, calls) = run(budget, 1, |e| fixed + each * f64::from(e));
            let step = each / budget;
            assert!(meets(ms, budget) || step > 0.05, "{fixed} {each} {budget}: {effort} {ms}");
            assert!(calls <= 6, "{calls}");
        }
    }

    #[test]
    fn steps_of_a_hundredth_meet_any_budget_above_the_least() {
        for budget in [8.0, 10.0, 13.7, 99.0, 1234.5] {
            let (steps, ms, calls) = run(budget, 100, |s| 1.0 + 0.06 * f64::from(s));
            assert!((ms / budget - 1.0).abs() <= 0.011, "{budget}: {steps} steps take {ms}");
            assert!(steps >= 100 && calls <= 6, "{steps} {calls}");
        }
    }

    #[test]
    fn a_technique_that_is_too_slow_stays_at_one() {
        assert_eq!(run(10.0, 1, |e| 25.0 * f64::from(e)), (1, 25.0, 1));
        assert_eq!(run(10.0, 100, |s| 0.25 * f64::from(s)), (100, 25.0, 1));
    }

    #[test]
    fn coarse_steps_give_the_nearest() {
        assert_eq!(run(10.0, 1, |e| 6.0 * f64::from(e)).0, 2);
        assert_eq!(run(8.5, 1, |e| 6.0 * f64::from(e)).0, 1);
        assert!(!meets(12.0, 10.0) && meets(10.5, 10.0) && meets(9.5, 10.0));
    }

    #[test]
    fn noise_and_nonsense_end() {
        let jitter = |e: u32| f64::from(e) * if e.is_multiple_of(2) { 0.8 } else { 1.2 };
        assert!(run(1000.0, 1, jitter).2 <= TRIES);
        assert!(run(10.0, 1, |_| 0.0).2 <= TRIES);
        assert!(run(10.0, 100, |_| 1.0).2 <= TRIES);
    }

    #[test]
    fn a_machine_that_slows_down_meets_all_searches_alike() {
        // Every measurement of a technique takes as long as 2 % of the run's slowdown.
        let mut searches = vec![Search::new(100.0, 1); 3];
        let mut rounds = Vec::new();
        by_turns(&mut searches, |round| {
            let slowness = 1.0 + 0.02 * rounds.len() as f64;
            rounds.push(round.to_vec());
            Ok::<_, ()>(round.iter().map(|(_, e)| slowness * (3.0 + f64::from(*e))).collect())
        })
        .unwrap();
        assert!(rounds.len() > 1 && rounds.iter().all(|round| round.len() == 3), "{rounds:?}");
        let best: Vec<u32> = searches.iter().map(Search::best).collect();
        assert_eq!(best, [best[0]; 3]);
    }

    #[test]
    fn a_search_that_is_over_is_measured_no_more() {
        let mut searches = vec![Search::new(10.0, 1), Search::new(100.0, 1)];
        let mut sizes = Vec::new();
        by_turns(&mut searches, |round| {
            sizes.push(round.len());
            Ok::<_, ()>(round.iter().map(|(_, e)| 10.0 * f64::from(*e)).collect())
        })
        .unwrap();
        assert_eq!((sizes, searches[0].best(), searches[1].best()), (vec![2, 1], 1, 10));
    }

    #[test]
    fn percentiles() {
        assert_eq!(median_p99(&[3.0, 1.0, 2.0])[0], 2.0);
        assert_eq!(median_p99(&[1.0, 2.0])[0], 1.5);
        assert!(median_p99(&[])[0].is_nan());
    }
}
