//! PLY meshes.

use crate::error::{Error, Result};
use crate::scene::Mesh;

pub(super) fn from_bytes(_bytes: &[u8]) -> Result<Mesh> {
    Err(Error::unsupported("PLY is not read yet"))
}
