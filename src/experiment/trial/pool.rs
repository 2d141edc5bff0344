//! References that trials of one run share.

use std::sync::Arc;
use std::time::Instant;

use super::Trial;
use crate::Result;
use crate::experiment::bias;
use crate::experiment::reference::{self, SourcedReference};
use crate::experiment::session::Session;
use crate::report::{CacheKey, Reference};
use crate::stats::{Restarts, Tolerance};
use crate::techniques::Technique;

/// The reference's standard error of any part, in margins.
const REFERENCE_ERROR: f64 = 0.1;

/// References that trials of one run share; empty at first.
#[derive(Debug, Default)]
pub struct ReferencePool {
    pub(super) known: Vec<(CacheKey, Arc<SourcedReference>)>,
}

impl ReferencePool {
    /// The reference for a session, whose every part is to be known to [`REFERENCE_ERROR`]. `like`
    /// has the parts.
    pub(super) fn obtain(
        &mut self,
        session: &Session,
        trial: &Trial,
        against: &Arc<dyn Technique>,
        like: &Restarts,
    ) -> Result<Arc<SourcedReference>> {
        let key = session.key(&against.spec());
        if let Some((_, made)) = self.known.iter().find(|(known, _)| *known == key) {
            return Ok(made.clone());
        }
        let tolerance = Tolerance::of(trial.delta);
        // A first guess from the image as a whole; a black one sets no target.
        let error = REFERENCE_ERROR * trial.delta * like.luminance().mean();
        let mut variance = error * error * session.shot.pixels() as f64;
        if variance.is_nan() || variance <= 0.0 {
            variance = f64::INFINITY;
        }
        let mut settings = trial.reference.clone();
        let begin = Instant::now();
        let mut made = reference::obtain(session, &settings, against, variance)?;
        // Dark tiles may need more, and then all of the picture gets it.
        for _ in 0..3 {
            let error = reference_error(like, &made.reference, &tolerance)? / REFERENCE_ERROR;
            settings.seconds = trial.reference.seconds - begin.elapsed().as_secs_f64();
            let Some(now) = made.reference.variance() else { break };
            if error < 1.1 || settings.seconds < 0.5 {
                break;
            }
            made = reference::obtain(session, &settings, against, now / (error * error))?;
        }
        let made = Arc::new(made);
        self.known.push((key, made.clone()));
        Ok(made)
    }
}

/// The largest standard error of a part that the reference alone causes, in margins.
fn reference_error(like: &Restarts, reference: &Reference, tolerance: &Tolerance) -> Result<f64> {
    let with = like.parts(&bias::truth(reference)?, tolerance)?;
    let without = like.parts(&bias::exact(reference)?, tolerance)?;
    Ok(with
        .iter()
        .zip(&without)
        .map(|(with, without)| {
            let square = with.test.standard_error.powi(2) - without.test.standard_error.powi(2);
            square.max(0.0).sqrt() / (with.delta * with.scale)
        })
        .filter(|error| error.is_finite())
        .fold(0.0, f64::max))
}
