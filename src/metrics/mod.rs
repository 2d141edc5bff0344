//! Errors of pictures against references (to come).

pub use crate::picture::Picture;
