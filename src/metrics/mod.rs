//! Placeholder until the metrics land.
use glam::Vec3;
#[derive(Clone, Debug)]
pub struct Picture {
    pub width: u32,
    pub height: u32,
    pub pixels: Vec<Vec3>,
}
impl Picture {
    pub fn new(width: u32, height: u32, pixels: Vec<Vec3>) -> Self {
        Self { width, height, pixels }
    }
}
