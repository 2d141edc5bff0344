//! Shapes so far from the origin that 32-bit coordinates lose them.

use glam::Vec3;

use super::{Warnings, placed};
use crate::scene::{Geometry, Scene, Shape};

/// A shape is lost where neighbouring coordinates are more than this share of its size apart.
const SHARE: f64 = 1.0 / 256.0;

/// Relative distance of neighbouring numbers, at most.
const SPACING: f64 = f32::EPSILON as f64;

/// Warns of shapes that are lost, with the distance from which on they are.
pub(super) fn warn(scene: &Scene, warnings: &mut Warnings) {
    let (mut lost, mut all) = (0_usize, 0_usize);
    let mut first = None;
    let boxes: Vec<Vec<[Vec3; 2]>> =
        scene.objects.iter().map(|o| o.shapes.iter().map(bounds).collect()).collect();
    for (instance, to_world) in placed(scene) {
        let object = instance.object.index();
        for (s, [low, high]) in boxes[object].iter().enumerate() {
            let (mut from, mut to) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
            for corner in 0..8_u32 {
                let pick = |axis: u32| if corner >> axis & 1 == 0 { *low } else { *high };
                let p = Vec3::new(pick(0).x, pick(1).y, pick(2).z);
                let p = to_world.transform_point3(p);
                (from, to) = (from.min(p), to.max(p));
            }
            let size = (to.as_dvec3() - from.as_dvec3()).length();
            let distance = f64::from(from.abs().max(to.abs()).max_element());
            all += 1;
            // NaN compares false: a shape without extent cannot lose it.
            if size > 0.0 && distance.is_finite() && distance * SPACING > SHARE * size {
                lost += 1;
                first.get_or_insert((object, s, size, distance));
            }
        }
    }
    let Some((object, shape, size, distance)) = first else { return };
    let limit = SHARE * size / SPACING;
    let spacing = distance * SPACING;
    warnings.add(format!(
        "{lost} of {all} shapes lie too far from the origin for 32-bit coordinates, first shape {shape} of object \
         {object}: {distance:.3e} away these are {spacing:.1e} apart, which distorts its size of {size:.1e}; from a \
         distance of {limit:.1e} on it is lost. Move the scene to the origin"
    ));
}

/// In the object's space.
fn bounds(shape: &Shape) -> [Vec3; 2] {
    match &shape.geometry {
        Geometry::Mesh(mesh) => {
            let corners = mesh.triangles.iter().flatten().map(|c| mesh.positions[*c as usize]);
            corners.fold([Vec3::INFINITY, Vec3::NEG_INFINITY], |[low, high], p| {
                [low.min(p), high.max(p)]
            })
        }
        Geometry::Sphere { center, radius } | Geometry::Disk { center, radius, .. } => {
            [*center - *radius, *center + *radius]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::MaterialId;
    use std::path::Path;

    fn warnings(center: Vec3) -> Vec<String> {
        let mut scene = Scene::new("far");
        for radius in [0.5, 1e9] {
            scene.add_shape(Shape::new(Geometry::Sphere { center, radius }, MaterialId(0)));
        }
        let mut warnings = Warnings::of(Path::new("s.gltf"));
        warn(&scene, &mut warnings);
        warnings.into_vec(Path::new("s.gltf"))
    }

    #[test]
    fn shapes_that_32_bits_lose_are_said_with_the_distance_from_which_on() {
        // The box of the small ball has a diagonal of √3: limit 2¹⁵ √3.
        assert!(warnings(Vec3::new(5.0e4, 0.0, 0.0)).is_empty());
        assert_eq!(
            warnings(Vec3::new(0.0, -1.0e6, 0.0)),
            [
                "s.gltf: 1 of 2 shapes lie too far from the origin for 32-bit coordinates, first shape 0 of \
              object 0: 1.000e6 away these are 1.2e-1 apart, which distorts its size of 1.7e0; from a \
              distance of 5.7e4 on it is lost. Move the scene to the origin"
            ]
        );
    }
}
