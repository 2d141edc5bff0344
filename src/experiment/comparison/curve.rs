//! Error against time.

use super::contender::{Contender, judged_picture};
use super::{Comparison, JudgedFrames};
use crate::Result;
use crate::experiment::calibrate::median_p99;
use crate::experiment::figures;
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::Session;
use crate::picture::Picture;
use crate::report::{Curve, CurvePoint};
use crate::stats::Moments;

/// Efforts of a curve through `effort`: a quarter of it to twice as much, or one to four times an effort of 1.
fn efforts_around(effort: u32) -> Vec<u32> {
    let mut efforts =
        vec![effort.div_ceil(4), effort.div_ceil(2), effort, effort.saturating_mul(2)];
    efforts.dedup();
    // A line needs three points; four times the effort takes as long as all others together.
    if efforts.len() < 3 {
        efforts.push(effort.saturating_mul(4));
    }
    efforts
}

impl Comparison {
    /// The curves of all techniques.
    pub(super) fn curves(
        &self,
        session: &Session,
        contenders: &[Contender],
        judged: JudgedFrames,
        truth: &Picture,
    ) -> Result<Vec<Curve>> {
        let steps: usize = contenders.iter().map(|c| efforts_around(c.effort).len() - 1).sum();
        let progress = session.host().begin("curve", steps as u64 * u64::from(self.curve_restarts));
        let mut curves = Vec::new();
        for contender in contenders {
            let history = judged.accumulate || contender.frames.plan().keeps_history();
            // Without history a second frame gives the time and the picture.
            let frames = if history { judged.frames } else { judged.frames.min(2) };
            let judged = JudgedFrames { frames, ..judged };
            let mut points = Vec::new();
            for effort in efforts_around(contender.effort) {
                if effort == contender.effort {
                    points.extend(contender.own_point());
                    continue;
                }
                progress.say(&format!("{} at effort {effort}", contender.spec));
                let mut frames = session.start(&contender.technique, effort, 0)?;
                let (mut times, mut moments) = (Vec::new(), Moments::new());
                for index in 0..self.curve_restarts {
                    let index = effort.wrapping_mul(4096).wrapping_add(index);
                    let run = seed(session.shot.run, SeedUse::Curve, contender.number, index);
                    frames.restart(run);
                    let picture = judged_picture(session, &mut frames, judged, |at, frame| {
                        if at > 0 || judged.frames == 1 {
                            times.push(frame.milliseconds());
                        }
                    })?;
                    moments.push(figures::relmse(&picture, truth)?);
                    progress.step();
                }
                let [ms, _] = median_p99(&times);
                points.push(CurvePoint { effort, ms, relmse: figures::over_restarts(&moments) });
            }
            curves.push(Curve { technique: contender.spec.clone(), points });
        }
        Ok(curves)
    }
}

impl Contender {
    /// The point that the restarts themselves give.
    fn own_point(&self) -> Option<CurvePoint> {
        let (_, moments) = self.metrics.iter().find(|(name, _)| *name == "relmse")?;
        let relmse = figures::over_restarts(moments);
        Some(CurvePoint { effort: self.effort, ms: self.median(), relmse })
    }
}
