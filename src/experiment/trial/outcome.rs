//! What a trial found: its stages, their ages, their verdicts.

use crate::Result;
use crate::experiment::bias;
use crate::plan::Plan;
use crate::report::Reference;
use crate::stats::{self, Part, Place, Restarts, Tolerance, Verdict, agreement};

/// A trial with all its stages.
#[derive(Debug)]
pub struct TrialOutcome {
    /// What ran.
    pub plan: Plan,
    /// The first stage, the second, or both.
    pub stages: Vec<StageOutcome>,
}

impl TrialOutcome {
    /// The stage that decided.
    #[must_use]
    pub fn last(&self) -> &StageOutcome {
        &self.stages[self.stages.len() - 1]
    }
}

/// Restarts that were judged.
#[derive(Debug)]
pub struct StageOutcome {
    /// 1 or 2: which seeds these are.
    pub stage: u32,
    /// What was found at each age.
    pub ages: Vec<AgeOutcome>,
    /// Over all parts of all ages.
    pub verdict: Verdict,
    /// How each part was tested.
    pub tolerance: Tolerance,
}

impl StageOutcome {
    /// Confidence of the interval that a pass places inside the margins.
    #[must_use]
    pub fn confidence(&self) -> f64 {
        1.0 - 2.0 * self.tolerance.equivalence_alpha
    }

    /// The part whose interval reaches farthest, of the image or of the tiles, with its age.
    #[must_use]
    pub fn worst(&self, image: bool) -> Option<(u32, &Part)> {
        let confidence = self.confidence();
        self.ages
            .iter()
            .flat_map(|age| age.parts.iter().map(move |part| (age.frames, part)))
            .filter(|(_, part)| (part.place == Place::Image) == image)
            .max_by(|(_, a), (_, b)| a.reach(confidence).total_cmp(&b.reach(confidence)))
    }
}

/// One age of one stage.
#[derive(Debug)]
pub struct AgeOutcome {
    /// Frames since the cold start.
    pub frames: u32,
    /// Pictures of this age.
    pub restarts: Restarts,
    /// The image and its tiles, in luminance and each channel; the image's luminance comes first.
    pub parts: Vec<Part>,
    /// One a part, judged together with those of all other ages.
    pub verdicts: Vec<Verdict>,
}

impl AgeOutcome {
    /// Over the parts of this age.
    #[must_use]
    pub fn verdict(&self) -> Verdict {
        self.verdicts.iter().copied().fold(Verdict::Pass, Verdict::and)
    }

    /// Luminance of the image.
    #[must_use]
    pub fn image(&self) -> &Part {
        &self.parts[0]
    }

    /// Number of tiles in which any quantity fails.
    #[must_use]
    pub fn tiles_failed(&self) -> usize {
        let mut tiles: Vec<Place> = self
            .parts
            .iter()
            .zip(&self.verdicts)
            .filter(|(part, verdict)| part.place != Place::Image && **verdict == Verdict::Fail)
            .map(|(part, _)| part.place)
            .collect();
        tiles.dedup();
        tiles.len()
    }
}

/// Judges all ages together.
pub(super) fn judge<'a>(
    found: Vec<Restarts>,
    frames: &[u32],
    of_age: impl Fn(usize) -> &'a Reference,
    tolerance: Tolerance,
) -> Result<StageOutcome> {
    let mut ages = Vec::new();
    for (at, (restarts, &frames)) in found.into_iter().zip(frames).enumerate() {
        let parts = restarts.parts(&bias::truth(of_age(at))?, &tolerance)?;
        ages.push(AgeOutcome { frames, restarts, parts, verdicts: Vec::new() });
    }
    let all: Vec<Part> = ages.iter().flat_map(|age| age.parts.iter().copied()).collect();
    let stats::Agreement { verdict, parts } = agreement(&all, &tolerance);
    let mut verdicts = parts.into_iter();
    for age in &mut ages {
        age.verdicts = verdicts.by_ref().take(age.parts.len()).collect();
    }
    Ok(StageOutcome { stage: 1, ages, verdict, tolerance })
}
