//! What a run leaves behind: `results.json`, tables, plots, pictures, and the cache of references.
//!
//! | file | holds |
//! |---|---|
//! | `results.json` | [`Results`]: every figure, for scripts |
//! | `table.md`, `table.csv` | the same, for people and spreadsheets ([`markdown`], [`csv`]) |
//! | `curve.csv`, `error_time.svg` | error against time ([`curve_csv`], [`error_time_svg`]) |
//! | `warmup.csv`, `warmup.svg` | error against frames since a cold start ([`warmup_csv`], [`warmup_svg`]) |
//! | `spectrum.csv` | power of the error by frequency ([`spectrum_csv`]) |
//! | `contact.png`, `*.png` | pictures ([`ToneMap`], [`contact_sheet`]) |
//! | `*.exr` | scene-linear pictures with layers ([`write_exr`], [`read_exr`]) |
//!
//! All writes are atomic: a file is either the old one or the new one, whole.

mod atomic;
mod cache;
mod exr_file;
mod plot;
mod png;
mod results;
pub(crate) mod sealed;
mod table;

pub use atomic::write_atomic;
pub use cache::{CacheKey, Reference, ReferenceCache, default_cache_dir};
pub use exr_file::{ExrPicture, Layer, read_exr, write_exr};
pub use plot::{error_time_svg, warmup_svg};
pub use png::{Tile, ToneMap, contact_sheet, error_map, write_png};
pub use results::{
    Bias, Budget, BudgetKind, Claim, Curve, CurvePoint, ErrorSpectrum, Figure, FrameTime, METRICS,
    PassSample, PassTime, ReferenceInfo, Results, Row, SCHEMA, Sample, SpectrumPoint, Warmup,
};
#[cfg(feature = "cli")]
pub(crate) use table::align;
pub use table::{csv, curve_csv, figure, markdown, spectrum_csv, summary, warmup_csv};
