//! Error against time.

use super::budget::has_whole_efforts;
use super::contender::{Contender, judged_picture};
use super::{Comparison, Course, JudgedFrames};
use crate::Result;
use crate::experiment::calibrate::median_p99;
use crate::experiment::figures;
use crate::experiment::seeds::{SeedUse, seed};
use crate::experiment::session::Session;
use crate::frame::FrameLoop;
use crate::plan::Shot;
use crate::report::{Curve, CurvePoint, Sample};

/// Efforts of a curve beside `effort` itself: a quarter, a half and twice of it, or two and four
/// times an effort near 1; whole where that is all that a technique has.
fn other_efforts(effort: f32, whole: bool) -> Vec<f32> {
    let round = |wanted: f32| {
        let rounded = if whole { wanted.ceil() } else { (100.0 * wanted).round() / 100.0 };
        rounded.clamp(1.0, Shot::MOST_EFFORT)
    };
    let mut efforts = [0.25, 0.5, 2.0].map(|factor| round(factor * effort)).to_vec();
    efforts.dedup();
    efforts.retain(|other| *other != effort);
    // A line needs three points; four times the effort takes as long as all others together.
    if efforts.len() < 2 {
        efforts.push(round(4.0 * effort));
    }
    efforts
}

/// A point of a curve in the making.
struct Measured<'a> {
    contender: &'a Contender,
    effort: f32,
    frames: FrameLoop,
    judged: JudgedFrames,
    samples: Vec<Sample>,
}

impl<'a> Measured<'a> {
    fn new(
        session: &Session,
        contender: &'a Contender,
        effort: f32,
        judged: JudgedFrames,
    ) -> Result<Self> {
        let history = judged.accumulate || contender.frames.plan().keeps_history();
        // Without history a second frame gives the time and the picture.
        let frames = if history { judged.frames } else { judged.frames.min(2) };
        Ok(Self {
            contender,
            effort,
            frames: session.start(&contender.technique, effort, 0)?,
            judged: JudgedFrames { frames, ..judged },
            samples: Vec::new(),
        })
    }

    /// Renders one restart.
    fn restart(&mut self, session: &Session, index: u32, course: Course<'_>) -> Result<()> {
        // Efforts of a curve are more than a hundredth apart.
        let piece = ((100.0 * self.effort) as u32).wrapping_mul(4096).wrapping_add(index);
        let seed = seed(session.shot.run, SeedUse::Curve, self.contender.number, piece);
        let place = (self.effort, index);
        if let Some(sample) = course.kept.curve_restart(self.contender, place, seed)? {
            self.samples.push(sample);
            return Ok(());
        }
        let mut sample = Sample { seed, ..Sample::default() };
        self.frames.restart(seed);
        let picture = judged_picture(session, &mut self.frames, self.judged, |_, frame| {
            sample.ms.push(frame.milliseconds());
            sample.non_finite += frame.counters.non_finite;
        })?;
        sample.metrics.insert("relmse".to_string(), figures::relmse(&picture, course.truth)?);
        course.kept.store_curve_restart(self.contender, place, &sample)?;
        self.samples.push(sample);
        Ok(())
    }

    fn point(self) -> CurvePoint {
        let times: Vec<f64> = self.samples.iter().flat_map(Sample::steady).copied().collect();
        let relmse = self.samples.iter().map(|sample| sample.metrics["relmse"]).collect();
        CurvePoint {
            effort: self.effort,
            ms: median_p99(&times)[0],
            relmse: figures::over_restarts(&relmse),
            samples: self.samples,
        }
    }
}

impl Comparison {
    /// The curves of all techniques. The first other efforts of all are measured together, restart
    /// by restart and technique by technique, then the second ones: all points at once would keep
    /// as many loops in memory.
    pub(super) fn curves(
        &self,
        session: &Session,
        contenders: &[Contender],
        course: Course<'_>,
    ) -> Result<Vec<Curve>> {
        let others = |c: &Contender| other_efforts(c.effort, has_whole_efforts(c.frames.plan()));
        let efforts: Vec<Vec<f32>> = contenders.iter().map(others).collect();
        let steps: usize = efforts.iter().map(Vec::len).sum();
        let progress = session.host().begin("curve", steps as u64 * u64::from(self.curve_restarts));
        let mut curves: Vec<Curve> = contenders.iter().map(Contender::own_curve).collect();
        let most = efforts.iter().map(Vec::len).max().unwrap_or(0);
        for place in 0..most {
            let mut points = Vec::new();
            for (at, contender) in contenders.iter().enumerate() {
                if let Some(&effort) = efforts[at].get(place) {
                    points.push((at, Measured::new(session, contender, effort, course.judged)?));
                }
            }
            for index in 0..self.curve_restarts {
                for (_, point) in &mut points {
                    progress.say(&format!("{} at effort {}", point.contender.spec, point.effort));
                    point.restart(session, index, course)?;
                    progress.step();
                }
            }
            for (at, point) in points {
                curves[at].points.push(point.point());
            }
        }
        for curve in &mut curves {
            curve.points.sort_by(|a, b| a.effort.total_cmp(&b.effort));
        }
        Ok(curves)
    }
}

impl Contender {
    /// The curve with the point that the restarts themselves give.
    fn own_curve(&self) -> Curve {
        let relmse = self.metric("relmse");
        let point = (relmse.count() > 0).then(|| CurvePoint {
            effort: self.effort,
            ms: self.median(),
            relmse: figures::over_restarts(&relmse),
            samples: Vec::new(),
        });
        Curve { technique: self.spec.clone(), points: point.into_iter().collect() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_three_efforts_or_more() {
        for (effort, whole, others) in [
            (1.0, true, &[2.0, 4.0][..]),
            (1.0, false, &[2.0, 4.0]),
            (1.2, false, &[1.0, 2.4]),
            (2.0, true, &[1.0, 4.0]),
            (3.0, true, &[1.0, 2.0, 6.0]),
            (3.0, false, &[1.0, 1.5, 6.0]),
            (16.0, true, &[4.0, 8.0, 32.0]),
            (9.3, false, &[2.33, 4.65, 18.6]),
        ] {
            assert_eq!(other_efforts(effort, whole), others, "{effort}");
        }
    }
}
