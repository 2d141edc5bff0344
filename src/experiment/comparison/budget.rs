//! The budget of a frame, and each technique's effort in it.

use std::sync::Arc;

use super::Spending;
use crate::Result;
use crate::experiment::calibrate::{calibrate, median_p99};
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::Session;
use crate::report::BudgetKind;
use crate::techniques::Technique;

/// Steady frames of a measurement of frame time.
const TIMED_FRAMES: u32 = 9;

/// What a frame may take, and what fits into it.
pub(super) struct Settled {
    pub(super) kind: BudgetKind,
    pub(super) value: f64,
    /// One a technique.
    pub(super) efforts: Vec<u32>,
}

/// Finds the budget and the efforts.
pub(super) fn settle(
    session: &Session,
    techniques: &[Arc<dyn Technique>],
    spending: Spending,
) -> Result<Settled> {
    if let Spending::Estimates(spp) = spending {
        let efforts = vec![spp; techniques.len()];
        return Ok(Settled { kind: BudgetKind::Spp, value: f64::from(spp), efforts });
    }
    let progress = session.host().begin("calibration", techniques.len() as u64);
    let time = |at: usize, effort: u32| {
        progress.say(&format!("{} at effort {effort}", techniques[at].spec()));
        let run = seed(session.shot.run, SeedUse::Calibration, at as u32, effort);
        steady_time(session, &techniques[at], effort, run)
    };
    let at_one = (0..techniques.len()).map(|at| time(at, 1)).collect::<Result<Vec<f64>>>()?;
    let value = match spending {
        Spending::Milliseconds(ms) => ms,
        _ => at_one.iter().copied().fold(0.0, f64::max),
    };
    let mut efforts = Vec::new();
    for (at, &first) in at_one.iter().enumerate() {
        let (effort, _) =
            calibrate(value, |effort| if effort == 1 { Ok(first) } else { time(at, effort) })?;
        efforts.push(effort);
        progress.step();
    }
    Ok(Settled { kind: BudgetKind::FrameTime, value, efforts })
}

/// Median milliseconds of frames after the first.
fn steady_time(
    session: &Session,
    technique: &Arc<dyn Technique>,
    effort: u32,
    run: u64,
) -> Result<f64> {
    let mut frames = session.start(technique, effort, run)?;
    session.next(&mut frames)?;
    let times = (0..TIMED_FRAMES)
        .map(|_| Ok(session.next(&mut frames)?.milliseconds()))
        .collect::<Result<Vec<f64>>>()?;
    Ok(median_p99(&times)[0])
}
