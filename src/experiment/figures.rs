//! The metrics of pictures, by their names in `results.json`.

use crate::Result;
use crate::metrics::{COVARIANCE_RESTARTS, Comparison, Guides, Picture, covariance_r8};
use crate::report::Figure;
use crate::stats::Moments;

/// The mean over restarts with Student's 95 % interval.
pub(crate) fn over_restarts(moments: &Moments) -> Figure {
    let (low, high) = moments.estimate().interval(0.95);
    let ci = (low.is_finite() && high.is_finite()).then_some([low, high]);
    Figure { mean: moments.mean(), ci }
}

/// All figures of one picture; those that need guides only where there are some, and none that is
/// undefined (a black reference).
pub(crate) fn of_picture(
    picture: &Picture,
    truth: &Picture,
    guides: Option<&Guides<'_>>,
) -> Result<Vec<(&'static str, f64)>> {
    let comparison = Comparison::new(picture, truth, None)?;
    let mut found = vec![
        ("mse", comparison.mse()),
        ("relmse", comparison.relmse()),
        ("relmse_trimmed", comparison.relmse_trimmed()),
        ("smape", comparison.smape()),
        ("rmspe", comparison.rmspe().value),
        ("rmspe_share", comparison.rmspe().share),
        ("flip", comparison.flip()),
        ("low_frequency_share", comparison.low_frequency_share()),
        ("g_2_1", comparison.g_2_1()),
    ];
    if let Some(guides) = guides {
        found.push(("relmse_denoised", comparison.relmse_denoised(guides)?));
    }
    found.retain(|(_, value)| value.is_finite());
    Ok(found)
}

/// The error that curves show.
pub(crate) fn relmse(picture: &Picture, truth: &Picture) -> Result<f64> {
    Ok(Comparison::new(picture, truth, None)?.relmse())
}

/// Rings of the error's spectrum, in equal steps up to half a cycle a pixel.
pub(crate) const RINGS: usize = 32;

/// Power of the error in [`RINGS`] rings; NaN where a ring is empty.
pub(crate) fn spectrum(picture: &Picture, truth: &Picture) -> Result<Vec<f64>> {
    Ok(Comparison::new(picture, truth, None)?.spectrum(None)?.radial(RINGS))
}

/// Restarts that [`covariance`] needs.
pub(crate) const COVARIANCE_NEEDS: u32 = COVARIANCE_RESTARTS as u32;

/// Covariance of neighbours over restarts.
pub(crate) fn covariance(pictures: &[Picture], truth: &Picture) -> Result<Figure> {
    let estimate = covariance_r8(pictures, truth, None)?;
    let (low, high) = estimate.interval(0.95);
    Ok(Figure {
        mean: estimate.mean,
        ci: (low.is_finite() && high.is_finite()).then_some([low, high]),
    })
}
