//! Which pixels may share their samples: the pixel that saw a surface in the previous frame, and
//! those whose surfaces are similar.
//!
//! All of it depends on surfaces and fresh numbers alone (law 1 of [`super`]).

use glam::{Vec2, Vec3};

use super::passes::NORMALS;
use crate::accel::Hit;
use crate::math::rng::{Purpose, RandomSource};
use crate::math::{octahedral_decode, octahedral_encode};
use crate::pass::{FrameInputs, Pixel, PrimaryHit};
use crate::plan::Plan;

/// Surfaces are similar where the cosine between their normals is at least this, and their
/// distances differ by less than [`DEPTH`] of the own one (the values of Lin et al. 2022).
const COSINE: f32 = 0.5;
const DEPTH: f32 = 0.1;

/// Whether a surface at `distance` with unit `normal` is similar to another one.
#[inline]
fn similar(normal: Vec3, distance: f32, other_normal: Vec3, other_distance: f32) -> bool {
    normal.dot(other_normal) >= COSINE && (other_distance - distance).abs() < DEPTH * distance
}

/// A unit normal in 4 bytes; its error, 10⁻⁴, only decides which neighbours fit.
#[inline]
pub(crate) fn pack_normal(normal: Vec3) -> u32 {
    let p = octahedral_encode(normal) * 32767.0;
    u32::from(p.x.round() as i16 as u16) | u32::from(p.y.round() as i16 as u16) << 16
}

/// Inverse of [`pack_normal`].
#[inline]
fn unpack_normal(word: u32) -> Vec3 {
    let at = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
    octahedral_decode(Vec2::new(at(word), at(word >> 16)))
}

/// The pixel of the previous frame that saw the surface of a hit, with its hit there; `None` where
/// another surface was seen. `normal` is the hit's own.
///
/// The motion vector is position − p, with position the surface point's place in the previous
/// frame's picture and p this frame's sample position; it is rounded to a pixel with a probability
/// in proportion to its overlap, so that no pixel keeps being missed.
pub(super) fn reproject(
    inputs: &FrameInputs<'_>,
    hit: &Hit,
    normal: Vec3,
    pixel: Pixel,
) -> Option<(Pixel, Hit)> {
    let motion = inputs.motion?;
    let before = inputs.position_before(hit)?;
    let moved = motion.projection.project(before)? - inputs.sample_position(pixel.x, pixel.y, 0);
    let mut random = inputs.stream(pixel.index, Purpose::TemporalRounding, 0);
    let x = (pixel.x as f32 + moved.x + random.uniform()).floor();
    let y = (pixel.y as f32 + moved.y + random.uniform()).floor();
    let [width, height] = inputs.shot.size;
    if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
        return None;
    }
    let (x, y) = (x as u32, y as u32);
    let previous = Pixel { index: y * width + x, x, y };
    let at = previous.index as usize;
    let found = inputs.read_previous::<PrimaryHit>(Plan::HITS)[at].get()?;
    let normal_there = unpack_normal(inputs.at_previous(NORMALS)[at]);
    let distance = motion.projection.distance(before);
    similar(normal, distance, normal_there, found.t).then_some((previous, found))
}

/// The surfaces of a frame's pixels, for comparisons with one of them.
#[derive(Clone, Copy)]
pub(super) struct Similar<'a> {
    hits: &'a [PrimaryHit],
    normals: &'a [u32],
    distance: f32,
    normal: Vec3,
}

impl<'a> Similar<'a> {
    /// Comparisons with the surface at a pixel.
    #[inline]
    pub(super) fn new(hits: &'a [PrimaryHit], normals: &'a [u32], index: u32) -> Self {
        let at = index as usize;
        Self { hits, normals, distance: hits[at].distance(), normal: unpack_normal(normals[at]) }
    }

    /// Whether the surface at another pixel is similar as seen from here, and this one from there.
    #[inline]
    pub(super) fn both_ways(&self, index: u32) -> [bool; 2] {
        let at = index as usize;
        let (normal, distance) = (unpack_normal(self.normals[at]), self.hits[at].distance());
        [
            similar(self.normal, self.distance, normal, distance),
            similar(normal, distance, self.normal, self.distance),
        ]
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::Affine3A;

    use super::*;
    use crate::counters::Counters;
    use crate::error::Result;
    use crate::frame::{FrameLoop, Stage};
    use crate::pass::Band;
    use crate::plan::{BufferKey, Builder, Claim, Elements, Filter, NewPass, SceneFacts, Shot};
    use crate::scene::{Color, Geometry, Material, Scene, Shape, Transform};
    use crate::techniques::Technique;

    #[test]
    fn normals_come_back_to_a_ten_thousandth() {
        for n in [Vec3::X, -Vec3::Y, Vec3::Z, -Vec3::Z, Vec3::new(0.3, -0.8, -0.2).normalize()] {
            assert!((unpack_normal(pack_normal(n)) - n).length() < 2e-4, "{n}");
        }
    }

    /// Shows of each pixel which pixel of the previous frame had its surface, and how far the
    /// direction of that pixel's ray is from what it was said to be.
    #[derive(Debug)]
    struct Reprojected;

    const DIRECTIONS: BufferKey<[f32; 3]> = BufferKey::new("directions");

    impl Technique for Reprojected {
        fn spec(&self) -> String {
            "reprojected".into()
        }

        fn validate(&self) -> Result<()> {
            Ok(())
        }

        fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
            let mut plan = Builder::new(self.spec(), facts, shot);
            plan.primary_hits();
            plan.keep_history(Plan::HITS);
            let normals = plan.buffer(NORMALS, Elements::Pixels, true);
            let directions = plan.buffer(DIRECTIONS, Elements::Pixels, true);
            plan.pass(NewPass::pixels("surfaces", 0, vec![normals, directions]));
            plan.pass(NewPass::pixels("reprojected", 1, vec![Plan::RADIANCE]));
            plan.finish(Claim::Unbiased)
        }

        fn run(&self, kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
            let hits = inputs.read::<PrimaryHit>(Plan::HITS);
            let normal = |hit: &Hit| inputs.world.surface(hit).frame.normal;
            let pixels = band.pixels();
            if kernel == 0 {
                let normals: &mut [u32] = band.take(inputs.id(NORMALS));
                let directions: &mut [[f32; 3]] = band.take(inputs.id(DIRECTIONS));
                for ((pixel, out), direction) in pixels.zip(normals).zip(directions) {
                    let hit = hits[pixel.index as usize].get();
                    *out = hit.map_or(0, |hit| pack_normal(normal(&hit)));
                    *direction = inputs.primary_direction(pixel).to_array();
                }
                return Counters::default();
            }
            let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
            for (pixel, out) in pixels.zip(radiance) {
                let found = hits[pixel.index as usize]
                    .get()
                    .and_then(|hit| reproject(inputs, &hit, normal(&hit), pixel));
                *out = match found {
                    None => [-1.0; 3],
                    Some((there, _)) => {
                        let was = Vec3::from(inputs.at_previous(DIRECTIONS)[there.index as usize]);
                        let said = inputs.primary_direction_before(there).unwrap();
                        [there.x as f32, there.y as f32, (was - said).length()]
                    }
                };
            }
            Counters::default()
        }
    }

    const SIZE: [u32; 2] = [40, 20];

    /// Walls, each a disk by its centre, normal and radius, before a camera at the origin that
    /// looks along z and whose pixels are a unit wide at z = 10.
    fn walls(walls: &[(Vec3, Vec3, f32)]) -> Scene {
        let mut scene = Scene::new("walls");
        let reflectance = Color::Constant(Vec3::ONE);
        let white = scene.add_material(Material::Diffuse { reflectance });
        for (center, normal, radius) in walls {
            let (center, normal, radius) = (*center, normal.normalize(), *radius);
            scene.add_shape(Shape::new(Geometry::Disk { center, normal, radius }, white));
        }
        scene.camera.to_world = Transform::IDENTITY;
        scene.camera.fov = 2.0 * 1.0_f32.atan();
        scene
    }

    /// What each pixel of the second frame finds; the first is `before`.
    fn reprojected(before: Scene, now: Scene, filter: Filter) -> Vec<Vec3> {
        let stage = Stage::moving(before.clone()).unwrap();
        let shot = Shot { size: SIZE, depth: 2, filter, run: 5, effort: 1.0, fps: 30 };
        let mut frames = FrameLoop::new(Arc::new(Reprojected), &stage, shot).unwrap();
        frames.render_scene(before).unwrap();
        frames.render_scene(now).unwrap().picture().pixels
    }

    fn moved(affine: Affine3A) -> Transform {
        Transform::Fixed(affine)
    }

    /// A wall that moves 2.25 pixels to the right was 3 pixels to the left of a quarter of its
    /// pixels, and 2 of the others; columns stay.
    #[test]
    fn a_surface_is_looked_for_where_it_was() {
        let before = walls(&[(Vec3::Z * 10.0, Vec3::NEG_Z, 1000.0)]);
        let mut now = before.clone();
        now.instances[0].to_world = moved(Affine3A::from_translation(Vec3::X * 2.25));
        let mut steps = [0, 0];
        for (at, found) in reprojected(before, now, Filter::Point).iter().enumerate() {
            let (x, y) = ((at % 40) as f32, (at / 40) as f32);
            if x < 4.0 {
                continue;
            }
            let step = x - found.x;
            assert!((step == 2.0 || step == 3.0) && found.y == y, "({x}, {y}) was at {found}");
            steps[usize::from(step == 3.0)] += 1;
        }
        // 720 pixels, of which 180 +- 12.
        assert!((130..230).contains(&steps[1]), "{steps:?}");
    }

    /// A camera that goes back sees all surfaces farther away; they are compared with what they
    /// were at, from where the camera was.
    #[test]
    fn depths_are_compared_from_where_the_camera_was() {
        let before = walls(&[(Vec3::Z * 10.0, Vec3::NEG_Z, 1000.0)]);
        let mut now = before.clone();
        now.camera.to_world = moved(Affine3A::from_translation(Vec3::Z * -2.0));
        let middle = |found: &[Vec3]| {
            (0..800)
                .filter(|at| (10..30).contains(&(at % 40)) && (5..15).contains(&(at / 40)))
                .filter(|at| found[*at].x >= 0.0)
                .count()
        };
        assert_eq!(middle(&reprojected(before.clone(), now, Filter::Point)), 200);
        // The control: a wall that was another one's place.
        let mut other = before.clone();
        other.instances[0].key = 77;
        assert_eq!(middle(&reprojected(before, other, Filter::Point)), 0);
    }

    /// Along a corner that goes by, each wall finds itself, by the normals of the previous frame;
    /// the directions of the previous frame are what they are said to be, with its own places in
    /// the pixels.
    #[test]
    fn surfaces_are_compared_with_those_of_the_previous_frame() {
        // Steep enough to be told apart, and no steeper, since depths must be similar, too.
        let slope = 0.62;
        let corner = [-1.0, 1.0].map(|side| {
            let center = Vec3::new(500.0 * side, 0.0, 10.0 - 500.0 * slope);
            (center, Vec3::new(-slope * side, 0.0, -1.0), 1000.0)
        });
        let before = walls(&corner);
        for filter in [Filter::Point, Filter::Box] {
            let mut now = before.clone();
            now.camera.to_world = moved(Affine3A::from_translation(Vec3::X * 4.0));
            let found = reprojected(before.clone(), now, filter);
            let mut near = 0;
            for (at, found) in found.iter().enumerate() {
                let x = at % 40;
                // The corner is 4 pixels to the left of the middle now; what lies near it was
                // within the picture.
                if (12..24).contains(&x) && !(15..18).contains(&x) {
                    assert!(found.x >= 0.0, "{filter:?}: pixel {x} finds {found}");
                    assert!(found.z < 1e-6, "{filter:?}: a direction is off by {}", found.z);
                    near += 1;
                }
            }
            assert_eq!(near, 9 * 20);
        }
    }
}
