//! pbrt-v4 text.

use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::Loaded;

pub(super) fn load(path: &Path) -> Result<Loaded> {
    from_bytes(&super::read(path)?, path)
}

pub(super) fn from_bytes(_bytes: &[u8], path: &Path) -> Result<Loaded> {
    Err(Error::unsupported("pbrt text is not read yet").with_path(path))
}
