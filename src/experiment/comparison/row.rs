//! A technique's row of the results.

use std::collections::{BTreeMap, BTreeSet};

use super::JudgedFrames;
use super::budget::{Settled, has_whole_efforts};
use super::contender::Contender;
use crate::Result;
use crate::experiment::calibrate::{median_p99, meets};
use crate::experiment::session::Session;
use crate::experiment::{bias, figures};
use crate::picture::Picture;
use crate::plan;
use crate::report::{
    Budget, BudgetKind, Claim, ErrorSpectrum, Figure, FrameTime, PassSample, PassTime, Reference,
    Row, SpectrumPoint,
};
use crate::stats::Criteria;

impl Contender {
    pub(super) fn row(
        &self,
        session: &Session,
        budget: &Settled,
        judged: JudgedFrames,
        reference: &Reference,
        truth: &Picture,
    ) -> Result<Row> {
        let plan = self.frames.plan();
        let pixels = session.shot.pixels();
        let [median, p99] = median_p99(&self.times());
        let median_of = |times: &[f64]| median_p99(times)[0];
        let first: Vec<f64> = self.samples.iter().map(|sample| sample.ms[0]).collect();
        let medians = self.samples.iter().map(|sample| median_of(sample.steady())).collect();
        let calibrated = |at: usize| {
            let times = &self.calibrations[at];
            (!times.is_empty()).then(|| median_of(times))
        };
        let test = bias::judge(&self.restarts, reference, &Criteria::default())?;
        Ok(Row {
            technique: self.spec.clone(),
            budget: Budget {
                kind: budget.kind,
                value: budget.value,
                effort: self.effort,
                over_budget: budget.kind == BudgetKind::FrameTime
                    && !has_whole_efforts(plan)
                    && !meets(median, budget.value),
            },
            whole_effort: has_whole_efforts(plan),
            claim: claim(&plan.claim),
            backend: if self.frames.runs_on().is_some() { "gpu" } else { "cpu" }.to_string(),
            frames: judged.frames,
            restarts: self.restarts.count() as u32,
            ms_per_frame: FrameTime {
                median,
                p99,
                first: median_of(&first),
                ci: figures::over_restarts(&medians).ci,
                calibrated: calibrated(0),
                recalibrated: calibrated(1),
                calibrations: self.calibrations.clone(),
            },
            rays_per_pixel: self.rays(pixels),
            bytes_per_pixel: plan.bytes_per_pixel(pixels),
            passes: self.passes(),
            metrics: self.figures(median, truth)?,
            bias: Some(bias::report(&test)),
            non_finite: self.samples.iter().map(|sample| sample.non_finite).sum(),
            samples: self.samples.clone(),
        })
    }

    /// Rays a pixel of a steady frame, by kind.
    fn rays(&self, pixels: usize) -> BTreeMap<String, f64> {
        let frames: usize = self.samples.iter().map(|sample| sample.steady().len()).sum();
        let mut rays = BTreeMap::new();
        for (kind, count) in self.samples.iter().flat_map(|sample| &sample.rays) {
            *rays.entry(kind.clone()).or_insert(0) += count;
        }
        let each = (pixels * frames.max(1)) as f64;
        rays.into_iter().map(|(kind, count): (String, u64)| (kind, count as f64 / each)).collect()
    }

    /// Median time of each pass, in the order in which they run.
    fn passes(&self) -> Vec<PassTime> {
        let mut passes: Vec<(&str, Vec<f64>)> = Vec::new();
        for PassSample { name, ms } in self.samples.iter().flat_map(|sample| &sample.passes) {
            match passes.iter_mut().find(|(known, _)| known == name) {
                Some((_, times)) => times.extend(ms),
                None => passes.push((name, ms.clone())),
            }
        }
        let time = |(name, times): (&str, Vec<f64>)| PassTime {
            name: name.to_string(),
            ms: median_p99(&times)[0],
        };
        passes.into_iter().map(time).collect()
    }

    /// All metrics, those of time and of all restarts together included.
    fn figures(&self, milliseconds: f64, truth: &Picture) -> Result<BTreeMap<String, Figure>> {
        let names: BTreeSet<&String> =
            self.samples.iter().flat_map(|sample| sample.metrics.keys()).collect();
        let mut all: BTreeMap<String, Figure> = names
            .into_iter()
            .map(|name| (name.clone(), figures::over_restarts(&self.metric(name))))
            .collect();
        if let Some(relmse) = all.get("relmse").copied() {
            let seconds = milliseconds * 1e-3;
            let ci = relmse.ci.map(|ends| ends.map(|end| end * seconds));
            all.insert("ttuv".to_string(), Figure { mean: relmse.mean * seconds, ci });
        }
        if self.pictures.len() >= figures::COVARIANCE_NEEDS as usize {
            all.insert("covariance_r8".to_string(), figures::covariance(&self.pictures, truth)?);
        }
        Ok(all)
    }

    /// Power of the error by frequency.
    pub(super) fn spectrum(&self) -> ErrorSpectrum {
        let points = (1..)
            .zip(&self.rings)
            .map(|(ring, power)| SpectrumPoint {
                cycles: 0.5 * f64::from(ring) / figures::RINGS as f64,
                power: figures::over_restarts(power),
            })
            // Small pictures leave rings empty.
            .filter(|point| point.power.mean.is_finite())
            .collect();
        ErrorSpectrum { technique: self.spec.clone(), points }
    }
}

/// The plan's claim in the form of `results.json`.
pub(crate) fn claim(claim: &plan::Claim) -> Claim {
    match claim {
        plan::Claim::Unbiased => Claim::Unbiased,
        plan::Claim::Consistent => Claim::Consistent,
        plan::Claim::Biased(why) => Claim::Biased(why.clone()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn claims_keep_their_reason() {
        assert_eq!(claim(&plan::Claim::Biased("x".into())), Claim::Biased("x".into()));
        assert_eq!(claim(&plan::Claim::Unbiased), Claim::Unbiased);
    }
}
