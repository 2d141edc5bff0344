//! glTF 2.0.

use std::path::Path;

use crate::error::{Error, Result};
use crate::scene::Loaded;

pub(super) fn load(path: &Path) -> Result<Loaded> {
    from_bytes(&super::read(path)?, path)
}

pub(super) fn from_bytes(_bytes: &[u8], path: &Path) -> Result<Loaded> {
    Err(Error::unsupported("glTF is not read yet; allowed: .pbrt").with_path(path))
}
