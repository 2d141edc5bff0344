//! A scene as it stands in a file or in a host's memory: shapes, materials, textures, lights,
//! camera, animation.
//!
//! | type | holds |
//! |---|---|
//! | [`Scene`] | everything; immutable while a frame is rendered |
//! | [`Object`] | shapes with one common local space; shared by its [`Instance`]s |
//! | [`Transform`] | a placement, fixed or moving; [`Scene::at`] gives the scene at one time, with fixed ones only |
//! | [`Loaded`] | a scene and the warnings of its loader |
//!
//! Conventions: radiance in W·sr⁻¹·m⁻² (scene-linear RGB, Rec. 709 primaries), lengths in scene
//! units, angles in radians. Ids are indices into the scene's own lists. Nothing here knows rays or
//! sampling.

mod camera;
mod generate;
mod image;
mod light;
#[cfg(feature = "load")]
pub mod load;
mod material;
mod shape;
mod texture;
pub(crate) mod transform;
mod validate;

use std::sync::Arc;

pub use camera::{Camera, CameraRay, CameraRays, Projection};
pub use generate::{generate, generate_pbrt, many_lights};

#[cfg(feature = "gpu")]
pub(crate) use image::srgb_table;
pub use image::{Image, ImageData};
pub use light::{EnvironmentMapping, Light, LightKind, SpotFalloff};
pub use material::{ConductorColor, Material, Roughness};
pub use shape::{Emission, Geometry, Instance, Mesh, Object, Shape};
pub use texture::{Channel, Color, Scalar, Texture, TextureKind, Wrap};
pub use transform::{Curve, Interpolation, Track, Transform};

macro_rules! id {
    ($($(#[$doc:meta])* $name:ident;)*) => {$(
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
        pub struct $name(pub u32);

        impl $name {
            /// As an index into the scene's list.
            #[inline]
            #[must_use]
            pub fn index(self) -> usize {
                self.0 as usize
            }
        }
    )*};
}

id! {
    /// A material of [`Scene::materials`].
    MaterialId;
    /// A texture of [`Scene::textures`].
    TextureId;
    /// An image of [`Scene::images`].
    ImageId;
    /// An object of [`Scene::objects`].
    ObjectId;
}

/// Everything that is rendered. See the module's table.
#[derive(Clone, Debug)]
pub struct Scene {
    /// For reports: a file's stem or a generator's name.
    pub name: String,
    /// The picture's shape in pixels as the file asks for it: width, height.
    pub film: [u32; 2],
    /// Path segments from the camera that the file asks for (1: emission seen directly, 2: direct
    /// light).
    pub depth: u32,
    /// The viewer.
    pub camera: Camera,
    /// Groups of shapes; a file's shapes outside any named object are one of them.
    pub objects: Vec<Arc<Object>>,
    /// Placements of objects.
    pub instances: Vec<Instance>,
    /// Surface materials.
    pub materials: Vec<Material>,
    /// Textures; one may refer to earlier ones only.
    pub textures: Vec<Texture>,
    /// Pictures that textures and environments read.
    pub images: Vec<Arc<Image>>,
    /// Lights without a surface: point, spot, distant, environment.
    pub lights: Vec<Light>,
    /// First and last time in seconds at which anything moves; equal in a still scene.
    pub time: [f32; 2],
}

impl Scene {
    /// An empty scene with a camera at the origin that looks along +z.
    #[must_use]
    pub fn new(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            film: [256, 256],
            depth: 8,
            camera: Camera::default(),
            objects: Vec::new(),
            instances: Vec::new(),
            materials: Vec::new(),
            textures: Vec::new(),
            images: Vec::new(),
            lights: Vec::new(),
            time: [0.0, 0.0],
        }
    }

    /// Adds a material.
    pub fn add_material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        MaterialId((self.materials.len() - 1) as u32)
    }

    /// Adds a texture.
    pub fn add_texture(&mut self, texture: Texture) -> TextureId {
        self.textures.push(texture);
        TextureId((self.textures.len() - 1) as u32)
    }

    /// Adds an image.
    pub fn add_image(&mut self, image: Image) -> ImageId {
        self.images.push(Arc::new(image));
        ImageId((self.images.len() - 1) as u32)
    }

    /// Adds an object without placing it.
    pub fn add_object(&mut self, object: Object) -> ObjectId {
        self.objects.push(Arc::new(object));
        ObjectId((self.objects.len() - 1) as u32)
    }

    /// Places an object. `key` must stay the same for the same thing in every frame and differ
    /// between instances.
    pub fn add_instance(&mut self, object: ObjectId, to_world: Transform, key: u64) {
        self.instances.push(Instance { object, to_world, key });
    }

    /// Adds one shape, placed as it stands, as an object of its own. Its key is the number of
    /// instances so far.
    pub fn add_shape(&mut self, shape: Shape) {
        let object = self.add_object(Object { name: String::new(), shapes: vec![shape] });
        self.add_instance(object, Transform::IDENTITY, self.instances.len() as u64);
    }

    /// Whether a material has no back: glTF's surfaces that are not double-sided, and mixes of two
    /// such. Camera rays pass such backs; all other rays meet them, and find them black.
    #[must_use]
    pub fn is_one_sided(&self, id: MaterialId) -> bool {
        match self.materials[id.index()] {
            Material::MetallicRoughness { double_sided, .. } => !double_sided,
            // Parts of a mix are not mixes, as validation checks.
            Material::Mix { first, second, .. } => [first, second].iter().all(|part| {
                let part = &self.materials[part.index()];
                matches!(part, Material::MetallicRoughness { double_sided: false, .. })
            }),
            _ => false,
        }
    }

    /// Whether the camera, an instance or a light moves.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.camera.to_world.moves()
            || self.instances.iter().any(|i| i.to_world.moves())
            || self.lights.iter().any(|l| l.to_world.moves())
    }

    /// The scene at `time` seconds, clamped to [`Scene::time`]: every transform is fixed, and
    /// instances and lights whose scale is 0 at that time are left out. Geometry and images are
    /// shared, not copied.
    #[must_use]
    pub fn at(&self, time: f32) -> Self {
        let time = time.clamp(self.time[0], self.time[1]);
        let mut scene = self.clone();
        scene.camera.to_world = Transform::Fixed(self.camera.to_world.at(time));
        let fix = |to_world: &mut Transform| match to_world.shown_at(time) {
            Some(now) => {
                *to_world = Transform::Fixed(now);
                true
            }
            None => false,
        };
        scene.instances.retain_mut(|instance| fix(&mut instance.to_world));
        scene.lights.retain_mut(|light| fix(&mut light.to_world));
        scene
    }
}

/// A scene with what its loader had to ignore or approximate.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// The scene, valid.
    pub scene: Scene,
    /// Each names the file and line or the JSON path, what was found, and what was done about it.
    /// Never repeated.
    pub warnings: Vec<String>,
}
