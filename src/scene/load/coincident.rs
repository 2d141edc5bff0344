//! Emitters that coincide with other surfaces. Which of two surfaces in one place a ray meets is
//! decided by rounding, while a shadow ray ends before its light's own surface and so before
//! whatever lies in it: light sampling then sees what no other ray may meet, and techniques differ.

use glam::{DVec2, DVec3, Vec3};

use super::{Warnings, placed};
use crate::scene::{Geometry, Scene};

/// Pairs of triangles that are looked at; beyond, nothing more is found.
const MAX_PAIRS: usize = 1 << 26;

/// A triangle in world space.
#[derive(Clone, Copy, Debug)]
struct Placed {
    corners: [DVec3; 3],
    low: DVec3,
    high: DVec3,
    /// Instance, object, shape, element.
    place: [usize; 4],
}

impl Placed {
    fn new(corners: [DVec3; 3], place: [usize; 4]) -> Self {
        let [a, b, c] = corners;
        Self { corners, low: a.min(b).min(c), high: a.max(b).max(c), place }
    }

    /// Whether both lie in one plane to rounding, and cover a common piece of it.
    fn coincides(&self, other: &Self) -> bool {
        let [a, b, c] = self.corners;
        let cross = (b - a).cross(c - a);
        let Some(normal) = cross.try_normalize() else { return false };
        let reach = self.low.abs().max(self.high.abs()).max_element();
        let tolerance = 4.0 * f64::from(f32::EPSILON) * reach;
        if other.corners.iter().any(|p| normal.dot(*p - a).abs() > tolerance) {
            return false;
        }
        // Along the axis that the plane faces most.
        let n = normal.abs();
        let flat = |p: DVec3| match n.max_element() {
            most if most == n.x => DVec2::new(p.y, p.z),
            most if most == n.y => DVec2::new(p.z, p.x),
            _ => DVec2::new(p.x, p.y),
        };
        let (mine, others) = (self.corners.map(flat), other.corners.map(flat));
        let margin = 1e-5 * (self.high - self.low).length().min((other.high - other.low).length());
        !separated(mine, others, margin) && !separated(others, mine, margin)
    }
}

/// Whether one of the first triangle's edges has all of the other beyond it, or less than a margin
/// on its side.
fn separated(a: [DVec2; 3], b: [DVec2; 3], margin: f64) -> bool {
    (0..3).any(|i| {
        let edge = a[(i + 1) % 3] - a[i];
        let Some(out) = edge.perp().try_normalize() else { return true };
        let inner = (a[(i + 2) % 3] - a[i]).dot(out);
        let out = if inner > 0.0 { -out } else { out };
        b.iter().all(|p| (*p - a[i]).dot(out) > -margin)
    })
}

/// Warns of the first emitter that coincides with another surface, and of how many do.
pub(super) fn warn(scene: &Scene, warnings: &mut Warnings) {
    let mut emitters = Vec::new();
    each(scene, |triangle, emits| {
        if emits {
            emitters.push(triangle);
        }
    });
    if emitters.is_empty() {
        return;
    }
    emitters.sort_by(|a, b| a.low.x.total_cmp(&b.low.x));
    let widest = emitters.iter().map(|e| e.high.x - e.low.x).fold(0.0, f64::max);
    let mut pairs = 0;
    let mut found = std::collections::BTreeMap::new();
    each(scene, |other, _| {
        let start = emitters.partition_point(|e| e.low.x < other.low.x - widest);
        let near = emitters[start..].iter().take_while(|e| e.low.x <= other.high.x);
        for emitter in near {
            pairs += 1;
            let meet = emitter.low.cmple(other.high).all() && other.low.cmple(emitter.high).all();
            if pairs < MAX_PAIRS
                && meet
                && emitter.place != other.place
                && emitter.coincides(&other)
            {
                found.entry(emitter.place).or_insert(other.place);
            }
        }
    });
    let Some((emitter, other)) = found.first_key_value() else { return };
    let name = |[_, object, shape, element]: [usize; 4]| {
        format!("triangle {element} of shape {shape} of object {object}")
    };
    warnings.add(format!(
        "{} emitting triangles coincide with other surfaces, first {} with {}: rays meet either by chance, light \
         sampling sees the emitter always. Move one of them",
        found.len(),
        name(*emitter),
        name(*other)
    ));
}

/// Visits all triangles that rays meet as they are placed, with whether they emit.
fn each(scene: &Scene, mut visit: impl FnMut(Placed, bool)) {
    for (i, (instance, to_world)) in placed(scene).enumerate() {
        let object = instance.object.index();
        for (s, shape) in scene.objects[object].shapes.iter().enumerate() {
            let Geometry::Mesh(mesh) = &shape.geometry else { continue };
            if shape.is_unmet() {
                continue;
            }
            let world = |p: Vec3| to_world.transform_point3(p).as_dvec3();
            for (element, corners) in mesh.triangles.iter().enumerate() {
                let corners = corners.map(|c| world(mesh.positions[c as usize]));
                visit(Placed::new(corners, [i, object, s, element]), shape.emission.is_some());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{MaterialId, Mesh, Shape};
    use std::path::Path;
    use std::sync::Arc;

    /// Half of a square [x, x + 1] × [0, 1] at height y.
    fn square(x: f32, y: f32) -> Shape {
        let positions = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let mesh = Mesh {
            positions: positions.map(|[u, v]| Vec3::new(x + u, y, v)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        Shape::new(Geometry::Mesh(Arc::new(mesh)), MaterialId(0))
    }

    fn found(shapes: &[Shape]) -> Vec<String> {
        let mut scene = Scene::new("coincident");
        shapes.iter().for_each(|shape| scene.add_shape(shape.clone()));
        let mut warnings = Warnings::of(Path::new("s.gltf"));
        warn(&scene, &mut warnings);
        warnings.into_vec(Path::new("s.gltf"))
    }

    #[test]
    fn emitters_in_other_surfaces_are_said() {
        let lamp = square(0.0, 1.0).emitting(Vec3::ONE);
        // Beside each other, above each other, crossing at a right angle: nothing in common.
        let mut wall = square(0.0, 1.0);
        if let Geometry::Mesh(mesh) = &mut wall.geometry {
            Arc::make_mut(mesh).positions.iter_mut().for_each(|p| *p = Vec3::new(0.5, p.x, p.z));
        }
        assert!(found(&[lamp.clone(), square(1.0, 1.0), square(0.0, 1.0001), wall]).is_empty());
        // Neither do two squares where neither emits.
        assert!(found(&[square(0.0, 1.0), square(0.5, 1.0)]).is_empty());
        let text = found(&[square(0.5, 1.0), lamp.clone()]);
        assert_eq!(
            text,
            [
                "s.gltf: 2 emitting triangles coincide with other surfaces, first triangle 0 of shape 0 of \
              object 1 with triangle 0 of shape 0 of object 0: rays meet either by chance, light sampling \
              sees the emitter always. Move one of them"
            ]
        );
        // What no ray meets is in nobody's way.
        let mut unmet = lamp;
        unmet.alpha = Some(crate::scene::Scalar::Constant(0.0));
        assert!(found(&[square(0.5, 1.0), unmet]).is_empty());
    }
}
