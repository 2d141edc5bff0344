//! What a scene's picture depends on, as bytes for a cache key.
//!
//! The *loaded* scene is hashed, not its files: that covers every file it refers to, a generator's
//! output and a changed loader, and a comment in a file changes nothing.

use std::fmt::{Debug, Write as _};
use std::hash::Hasher;

use crate::scene::{Geometry, Image, ImageData, Mesh, Object, Scene, Shape};

/// Feeds everything but name, film and depth, which a run sets by itself.
pub(crate) fn feed(scene: &Scene, hasher: &mut dyn Hasher) {
    // Destructured without `..`, so that a new field cannot be forgotten.
    let Scene {
        name: _,
        film: _,
        depth: _,
        camera,
        objects,
        instances,
        materials,
        textures,
        images,
        lights,
        time,
    } = scene;
    text(hasher, &(camera, instances, materials, textures, lights, time));
    hasher.write_usize(objects.len());
    for object in objects {
        let Object { name: _, shapes } = &**object;
        hasher.write_usize(shapes.len());
        for shape in shapes {
            let Shape { geometry, material, emission, alpha, reverse_orientation } = shape;
            text(hasher, &(material, emission, alpha, reverse_orientation));
            match geometry {
                Geometry::Mesh(mesh) => {
                    let Mesh { positions, normals, uvs, triangles } = &**mesh;
                    bytes(hasher, bytemuck::cast_slice(positions));
                    bytes(hasher, bytemuck::cast_slice(normals));
                    bytes(hasher, bytemuck::cast_slice(uvs));
                    bytes(hasher, bytemuck::cast_slice(triangles));
                }
                other => text(hasher, other),
            }
        }
    }
    hasher.write_usize(images.len());
    for image in images {
        let Image { width, height, data } = &**image;
        hasher.write_u32(*width);
        hasher.write_u32(*height);
        match data {
            ImageData::Srgb8(data) => {
                hasher.write_u8(0);
                bytes(hasher, data.as_flattened());
            }
            ImageData::Linear8(data) => {
                hasher.write_u8(1);
                bytes(hasher, data.as_flattened());
            }
            ImageData::Float(data) => {
                hasher.write_u8(2);
                bytes(hasher, bytemuck::cast_slice(data));
            }
        }
    }
}

/// With its length, so that two neighbours cannot trade bytes.
fn bytes(hasher: &mut dyn Hasher, bytes: &[u8]) {
    hasher.write_usize(bytes.len());
    hasher.write(bytes);
}

/// By its debug form, which prints floats so that they read back exactly.
fn text(hasher: &mut dyn Hasher, value: &dyn Debug) {
    struct Feed<'a>(&'a mut dyn Hasher);
    impl std::fmt::Write for Feed<'_> {
        fn write_str(&mut self, s: &str) -> std::fmt::Result {
            self.0.write(s.as_bytes());
            Ok(())
        }
    }
    // Feeding a hasher cannot fail.
    let _ = write!(Feed(hasher), "{value:?}");
    hasher.write_u8(0xff);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::CacheKey;
    use crate::scene::{Color, Material, Transform};
    use glam::Vec3;
    use std::sync::Arc;

    fn scene() -> Scene {
        let mut scene = Scene::new("a");
        let material = scene
            .add_material(Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5)) });
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), material));
        scene.add_image(Image { width: 1, height: 1, data: ImageData::Srgb8(vec![[1, 2, 3, 4]]) });
        scene
    }

    fn key(scene: &Scene) -> CacheKey {
        CacheKey::of(|hasher| feed(scene, hasher))
    }

    #[test]
    fn any_content_changes_the_key_and_the_name_does_not() {
        let base = key(&scene());
        assert_eq!(base, key(&scene()));
        let mut renamed = scene();
        renamed.name = "b".into();
        assert_eq!(base, key(&renamed));

        let mut moved = scene();
        moved.camera.to_world =
            Transform::Fixed(glam::Affine3A::from_translation(Vec3::new(0.0, 0.0, 1e-30)));
        let mut darker = scene();
        darker.materials[0] =
            Material::Diffuse { reflectance: Color::Constant(Vec3::splat(0.5_f32.next_down())) };
        let mut bent = scene();
        let mesh = Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, 2.0 * Vec3::Y],
            triangles: vec![[0, 1, 2]],
            ..Mesh::default()
        };
        let material = bent.objects[0].shapes[0].material;
        bent.objects[0] = Arc::new(Object {
            name: String::new(),
            shapes: vec![Shape::new(Geometry::Mesh(Arc::new(mesh)), material)],
        });
        let mut repainted = scene();
        repainted.images[0] =
            Arc::new(Image { width: 1, height: 1, data: ImageData::Linear8(vec![[1, 2, 3, 4]]) });
        for other in [moved, darker, bent, repainted] {
            assert_ne!(base, key(&other));
        }
    }
}
