//! Placeholder types until the acceleration structure lands.
#![expect(missing_docs, missing_debug_implementations, reason = "placeholder")]
use crate::Result;
use crate::scene::*;
use glam::*;
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
    pub t_max: f32,
}
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub t: f32,
    pub u: f32,
    pub v: f32,
    pub primitive: u32,
    pub instance: u32,
}
pub trait HitFilter {
    fn accept(&self, ray: &Ray, hit: &Hit) -> bool;
}
#[derive(Clone, Copy, Debug)]
pub struct AcceptAll;
impl HitFilter for AcceptAll {
    fn accept(&self, _: &Ray, _: &Hit) -> bool {
        true
    }
}
#[derive(Clone, Copy, Debug, Default)]
pub struct BuildOptions {}
#[derive(Clone, Debug)]
pub struct Accel;
#[derive(Clone, Copy, Debug)]
pub struct HitPoint {
    pub position: Vec3,
    pub error: Vec3,
    pub geometric_normal: Vec3,
    pub shading_normal: Vec3,
    pub dpdu: Vec3,
    pub uv: Vec2,
    pub shape: u32,
    pub element: u32,
    pub instance: u32,
}
impl Accel {
    pub fn build(_: &Scene, _: &BuildOptions) -> Result<Self> {
        todo!()
    }
    pub fn rebuild(&self, _: &Scene) -> Result<Self> {
        todo!()
    }
    pub fn closest_hit<F: HitFilter>(&self, _: &Ray, _: &F) -> Option<Hit> {
        todo!()
    }
    pub fn occluded<F: HitFilter>(&self, _: &Ray, _: &F) -> bool {
        todo!()
    }
    pub fn point(&self, _: &Hit) -> HitPoint {
        todo!()
    }
    pub fn point_under(&self, _: &Hit, _: Affine3A) -> Vec3 {
        todo!()
    }
}
pub fn triangle_orientation(_: &Mesh, _: usize, _: bool) -> f32 {
    1.0
}
