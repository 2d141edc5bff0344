//! Frames on a graphics processor.
//!
//! | file | holds |
//! |---|---|
//! | `runner` | a plan's passes on a device: state in one buffer, one submission a frame |
//! | `flight` | frames under way, from submission to reading back |

mod flight;
mod runner;

pub(super) use flight::Device;
#[cfg(test)]
pub(crate) use runner::{bind, twins};
