//! The budget of a frame, and each technique's effort in it.

use std::sync::Arc;

use super::Spending;
use super::contender::Contender;
use crate::Result;
use crate::experiment::calibrate::{Search, by_turns, median_p99};
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::Session;
use crate::frame::FrameLoop;
use crate::plan::Plan;
use crate::report::BudgetKind;
use crate::techniques::Technique;

/// Turns of a measurement of frame times, and steady frames that a technique has in each.
const TURNS: usize = 3;
const FRAMES_A_TURN: usize = 3;

/// What a frame may take, and what fits into it.
#[derive(Clone, Debug)]
pub(super) struct Settled {
    pub(super) kind: BudgetKind,
    pub(super) value: f64,
    /// One a technique.
    pub(super) efforts: Vec<f32>,
}

/// Steps of an effort of 1 where efforts may have a fraction: a step is 1 % of the least effort.
const HUNDREDTHS: u32 = 100;

/// Whether a technique has whole efforts only: a pixel has that many chains of reservoirs, and what
/// is in one frame changes later ones, so that a pixel cannot have one more in some frames. A
/// technique that keeps lobes may take any number of steps in a frame.
pub(super) fn has_whole_efforts(plan: &Plan) -> bool {
    plan.chains
}

/// Finds the budget and the efforts. Techniques are measured by turns, so that a change of the
/// machine's speed meets all alike.
pub(super) fn settle(
    session: &Session,
    techniques: &[Arc<dyn Technique>],
    spending: Spending,
) -> Result<Settled> {
    let count = techniques.len();
    if let Spending::Estimates(spp) = spending {
        let efforts = vec![spp as f32; count];
        return Ok(Settled { kind: BudgetKind::Spp, value: f64::from(spp), efforts });
    }
    let unit = |technique: &Arc<dyn Technique>| {
        if has_whole_efforts(&session.plan(&**technique)) { 1 } else { HUNDREDTHS }
    };
    let units: Vec<u32> = techniques.iter().map(unit).collect();
    let effort = |number: usize, steps: u32| steps as f32 / units[number] as f32;
    let progress = session.host().begin("calibration", count as u64);
    let measure = |round: &[(usize, u32)]| -> Result<Vec<f64>> {
        progress.say(&format!("{} techniques by turns", round.len()));
        progress.set((count - round.len()) as u64, count as u64);
        let mut loops = Vec::new();
        for &(number, steps) in round {
            let run = seed(session.shot.run, SeedUse::Calibration, number as u32, steps);
            loops.push(session.start(&techniques[number], effort(number, steps), run)?);
        }
        let times = steady_times(session, &mut loops.iter_mut().collect::<Vec<_>>())?;
        Ok(times.iter().map(|times| median_p99(times)[0]).collect())
    };
    let ones: Vec<(usize, u32)> = units.iter().copied().enumerate().collect();
    let at_one = measure(&ones)?;
    let value = match spending {
        Spending::Milliseconds(ms) => ms,
        _ => at_one.iter().copied().fold(0.0, f64::max),
    };
    let mut searches: Vec<Search> = units.iter().map(|unit| Search::new(value, *unit)).collect();
    for (search, ms) in searches.iter_mut().zip(at_one) {
        search.measured(ms);
    }
    by_turns(&mut searches, measure)?;
    let efforts = searches.iter().enumerate().map(|(at, search)| effort(at, search.best()));
    let efforts = efforts.collect();
    Ok(Settled { kind: BudgetKind::FrameTime, value, efforts })
}

/// Milliseconds of steady frames of each technique at its effort, by turns: the calibration, and
/// what it is compared with when the run is over.
pub(super) fn times(session: &Session, contenders: &mut [Contender]) -> Result<Vec<Vec<f64>>> {
    let progress = session.host().begin("calibration", 1);
    progress.say("all techniques at their efforts");
    for Contender { frames, number, .. } in contenders.iter_mut() {
        // The search begins with 1 or 100 steps, so that no measurement of it has this number.
        frames.restart(seed(session.shot.run, SeedUse::Calibration, *number, 0));
    }
    let mut loops: Vec<&mut FrameLoop> = contenders.iter_mut().map(|c| &mut c.frames).collect();
    steady_times(session, &mut loops)
}

/// Milliseconds of the frames of each loop after its first, a few of each by turns.
fn steady_times(session: &Session, loops: &mut [&mut FrameLoop]) -> Result<Vec<Vec<f64>>> {
    for frames in loops.iter_mut() {
        session.next(frames)?;
    }
    let mut times = vec![Vec::new(); loops.len()];
    for _ in 0..TURNS {
        for (frames, times) in loops.iter_mut().zip(&mut times) {
            for _ in 0..FRAMES_A_TURN {
                times.push(session.next(frames)?.milliseconds());
            }
        }
    }
    Ok(times)
}
