//! A world as words: four arenas that kernels read.
//!
//! | arena | holds |
//! |---|---|
//! | nodes | trees over primitives; then, once a frame: placements, the tree over instances, the emitters' tree |
//! | geometry | primitives in leaf order and what a hit needs of them; then the emitters' |
//! | words | materials, textures' programs, tables; then, once a frame: shapes, lights, what leads from the previous frame |
//! | texels | images |
//!
//! The first part of each is written once and stays while the host keeps its objects, materials and
//! images. Of the second there are two where anything moves, for this frame and the previous one;
//! frames take turns.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::Arc;

use bytemuck::{Pod, Zeroable};

use super::Gpu;
use super::shader::SceneConstants;
use crate::accel::export::{NO_TREE, Quad, TreeArenas, Words, Written};
use crate::error::{Error, Result};
use crate::light::export::Names;
use crate::scene::{
    Color, ConductorColor, Image, ImageData, Material, Roughness, Scalar, Scene, TextureId,
    TextureKind, Wrap, srgb_table,
};
use crate::surface::bsdf::{NODES, index_cell, rows_of};
use crate::world::World;

/// Values that a texture's program may hold at once, as in `scene.wgsl`.
const TEXTURE_STACK: usize = 8;
/// Most words of a texture's program: textures that are used twice are written twice.
const TEXTURE_PROGRAM: usize = 4096;
const NONE: u32 = u32::MAX;

/// `World` of `scene.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct WorldRecord {
    pub(super) placements: u32,
    pub(super) top_nodes: u32,
    pub(super) top_order: u32,
    pub(super) top_reach: f32,
    pub(super) bottom_nodes: u32,
    pub(super) bottom_slots: u32,
    pub(super) bottom_cold: u32,
    pub(super) bottom_flags: u32,
    pub(super) bottom_reach: f32,
    pub(super) instances: u32,
    pub(super) first_of_shape: u32,
    pub(super) shapes: u32,
    pub(super) lights: u32,
    pub(super) light_count: u32,
    pub(super) alias_slots: u32,
    pub(super) alias_count: u32,
    pub(super) probabilities: u32,
    pub(super) environments: u32,
    pub(super) environment_count: u32,
    pub(super) emitter_placements: u32,
    pub(super) emitter_nodes: u32,
    pub(super) emitter_slots: u32,
    pub(super) emitter_cold: u32,
    pub(super) emitter_flags: u32,
    pub(super) emitter_reach: f32,
    pub(super) emitter_first: u32,
    padding: [u32; 2],
}

/// `CameraRays` of `scene.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct CameraRecord {
    pub(crate) origin: [f32; 4],
    pub(crate) corner: [f32; 4],
    pub(crate) right: [f32; 4],
    pub(crate) down: [f32; 4],
}

/// `Projection` of `scene.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ProjectionRecord {
    pub(crate) row_x: [f32; 4],
    pub(crate) row_y: [f32; 4],
    pub(crate) row_z: [f32; 4],
    pub(crate) origin: [f32; 4],
    pub(crate) scale: [f32; 4],
}

/// Buffers of a plan that kernels can address.
pub(crate) const MAX_BUFFERS: usize = 24;

/// `Inputs` of `scene.wgsl`: what a frame's kernels share.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Inputs {
    pub(crate) run: [u32; 2],
    pub(crate) frame: u32,
    pub(crate) effort: u32,
    pub(crate) size: [u32; 2],
    pub(crate) depth: u32,
    pub(crate) box_filter: u32,
    pub(crate) remap: [u32; 4],
    pub(crate) instances: [u32; 4],
    pub(crate) srgb: u32,
    pub(crate) extra_share: u32,
    pub(crate) padding: [u32; 2],
    pub(crate) camera: CameraRecord,
    pub(crate) camera_before: CameraRecord,
    pub(crate) projection: ProjectionRecord,
    pub(crate) worlds: [WorldRecord; 2],
    pub(crate) buffers: [[u32; 4]; MAX_BUFFERS],
}

/// What leads from the previous frame's lists to this one's.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Links<'a> {
    /// Place by light of the previous frame in this one, and back; `None`: the same.
    pub(crate) lights: Option<(&'a [u32], &'a [u32])>,
    /// Place then of each instance; `None`: the same.
    pub(crate) instances: Option<&'a [u32]>,
}

/// Where each material, texture and image lies.
#[derive(Debug, Default)]
struct Places {
    materials: Vec<u32>,
    textures: Vec<u32>,
    /// By address: images are compared by identity.
    images: HashMap<usize, u32>,
}

impl Names for Places {
    fn color(&self, color: Color) -> [u32; 4] {
        match color {
            Color::Constant(v) => [NONE, v.x.to_bits(), v.y.to_bits(), v.z.to_bits()],
            Color::Texture(id) => [self.textures[id.index()], 0, 0, 0],
        }
    }

    fn scalar(&self, scalar: Scalar) -> [u32; 2] {
        match scalar {
            Scalar::Constant(v) => [NONE, v.to_bits()],
            Scalar::Texture(id, channel) => [channel as u32, self.textures[id.index()]],
        }
    }

    fn image(&self, image: &Arc<Image>) -> u32 {
        self.images[&(Arc::as_ptr(image) as usize)]
    }
}

/// A scene's materials, textures and images, as they were written.
#[derive(Debug)]
struct Looks {
    places: Places,
    /// Kept so that images' addresses, which `places` holds, are not given away.
    images: Vec<Arc<Image>>,
    /// Of materials and textures, which the host may change in place.
    described: u64,
}

impl Looks {
    fn are_of(&self, scene: &Scene) -> bool {
        self.described == described(scene)
            && self.images.len() == scene.images.len()
            && self.images.iter().zip(&scene.images).all(|(a, b)| Arc::ptr_eq(a, b))
    }
}

/// What stays while objects, materials and images do.
#[derive(Debug, Default)]
struct Statics {
    written: Written,
    arenas: TreeArenas,
    words: Words,
    texels: Vec<u32>,
    srgb: u32,
    /// Headers of all images by address: looks share them.
    headers: HashMap<usize, u32>,
    looks: Vec<Looks>,
    /// One bit a kind of material.
    materials: u32,
    textured: bool,
}

impl Statics {
    fn new<'a>(worlds: impl Iterator<Item = &'a World>) -> Result<Self> {
        let mut statics = Self::default();
        statics.srgb = statics.words.put(srgb_table().iter().map(|v| v.to_bits()));
        for world in worlds {
            statics.written.add(&world.accel, &mut statics.arenas)?;
            if statics.looks_of(&world.scene).is_none() {
                statics.add_looks(&world.scene)?;
            }
        }
        Ok(statics)
    }

    fn looks_of(&self, scene: &Scene) -> Option<&Looks> {
        self.looks.iter().find(|looks| looks.are_of(scene))
    }

    fn add_looks(&mut self, scene: &Scene) -> Result<()> {
        let mut places = Places::default();
        let Self { words, texels, headers, .. } = self;
        for image in &scene.images {
            let address = Arc::as_ptr(image) as usize;
            if let Some(header) = headers.get(&address) {
                places.images.insert(address, *header);
                continue;
            }
            let at = texels.len() as u32;
            let format = match &image.data {
                ImageData::Srgb8(data) => {
                    texels.extend_from_slice(bytemuck::cast_slice(data));
                    0
                }
                ImageData::Linear8(data) => {
                    texels.extend_from_slice(bytemuck::cast_slice(data));
                    1
                }
                ImageData::Float(data) => {
                    texels.extend_from_slice(bytemuck::cast_slice(data));
                    2
                }
            };
            let header = words.put([format, at, image.width, image.height]);
            headers.insert(address, header);
            places.images.insert(address, header);
        }
        for number in 0..scene.textures.len() {
            let mut program = Vec::new();
            let id = TextureId(number as u32);
            let deepest = texture_program(scene, &places, id, &mut program);
            if deepest > TEXTURE_STACK || program.len() > TEXTURE_PROGRAM {
                return Err(Error::gpu(format!(
                    "texture {number} holds {deepest} values at once in {} words, at most {TEXTURE_STACK} in {TEXTURE_PROGRAM} are possible",
                    program.len()
                )));
            }
            let at = words.put([program.len() as u32]);
            words.put(program);
            places.textures.push(at);
        }
        for material in &scene.materials {
            let record = material_words(&places, material, words);
            self.materials |= 1 << record[0];
            places.materials.push(words.put(record));
        }
        // Parts of a mix stand before or after it, so their places are known only now.
        for (number, material) in scene.materials.iter().enumerate() {
            if let Material::Mix { first, second, .. } = material {
                let at = places.materials[number] as usize;
                words.data[at + 2] = places.materials[first.index()];
                words.data[at + 3] = places.materials[second.index()];
            }
        }
        self.textured |= !scene.textures.is_empty();
        let (images, described) = (scene.images.clone(), described(scene));
        self.looks.push(Looks { places, images, described });
        Ok(())
    }
}

/// A hash of what materials and textures say.
fn described(scene: &Scene) -> u64 {
    let mut hasher = DefaultHasher::new();
    format!("{:?} {:?}", scene.materials, scene.textures).hash(&mut hasher);
    hasher.finish()
}

/// Appends the postfix program of a texture; returns the most values it holds at once.
fn texture_program(scene: &Scene, places: &Places, id: TextureId, to: &mut Vec<u32>) -> usize {
    if to.len() > TEXTURE_PROGRAM {
        return 0;
    }
    let texture = &scene.textures[id.index()];
    let mapping = texture.mapping.to_cols_array().map(f32::to_bits);
    let color = |color: Color, to: &mut Vec<u32>| match color {
        Color::Constant(v) => {
            to.push(0);
            to.extend(v.extend(1.0).to_array().map(f32::to_bits));
            1
        }
        Color::Texture(id) => texture_program(scene, places, id, to),
    };
    match texture.kind {
        TextureKind::Constant(v) => {
            to.push(0);
            to.extend(v.to_array().map(f32::to_bits));
            1
        }
        TextureKind::Image { image, wrap, scale, invert } => {
            to.push(1);
            to.extend(mapping);
            let wrap = match wrap {
                Wrap::Repeat => 0,
                Wrap::Clamp => 1,
                Wrap::Black => 2,
                Wrap::Mirror => 3,
            };
            let header = places.image(&scene.images[image.index()]);
            to.extend([header, wrap, scale.to_bits(), u32::from(invert)]);
            1
        }
        TextureKind::Checkerboard { first, second } => {
            let deepest = color(first, to).max(1 + color(second, to));
            to.push(2);
            to.extend(mapping);
            deepest
        }
        TextureKind::Product { first, second } => {
            let deepest = texture_program(scene, places, first, to)
                .max(1 + texture_program(scene, places, second, to));
            to.push(3);
            deepest
        }
        TextureKind::Threshold { value, cutoff } => {
            let (deepest, channel) = match value {
                Scalar::Constant(v) => (color(Color::Constant(glam::Vec3::splat(v)), to), 0),
                Scalar::Texture(id, channel) => {
                    (texture_program(scene, places, id, to), channel as u32)
                }
            };
            to.extend([4, channel, cutoff.to_bits()]);
            deepest
        }
    }
}

/// Words of a material before its parameters, as in `bsdf.wgsl`.
const MATERIAL_HEAD: usize = 10;
/// A colour's channel.
const RGB: u32 = 5;

/// A material's words: kind, number of parameters, words of its own, parameters; what it needs
/// beside them is put before.
fn material_words(places: &Places, material: &Material, words: &mut Words) -> Vec<u32> {
    enum Parameter {
        Color(Color),
        Scalar(Scalar),
    }
    use Parameter::{Color as C, Scalar as S};
    let (kind, own, parameters) = match *material {
        Material::Diffuse { reflectance } => (0, vec![], vec![C(reflectance)]),
        Material::DiffuseTransmission { reflectance, transmittance } => {
            (1, vec![], vec![C(reflectance), C(transmittance)])
        }
        Material::Conductor { color, roughness: r } => {
            let (mode, first, second) = match color {
                ConductorColor::Complex { eta, k } => (0, eta, k),
                ConductorColor::Reflectance(c) => (1, c, c),
            };
            (2, vec![mode, r.remap.into()], vec![C(first), C(second), S(r.u), S(r.v)])
        }
        Material::Dielectric { eta, roughness: r } => {
            (3, vec![eta.to_bits(), r.remap.into()], vec![S(r.u), S(r.v)])
        }
        Material::ThinDielectric { eta } => (4, vec![eta.to_bits()], vec![]),
        Material::CoatedDiffuse { reflectance, eta, roughness: r } => {
            let alphas = coat_rows(r);
            let first = *alphas.start() as u32;
            let (lower, higher, weight) = index_cell(eta.max(1.0));
            let lower_at = words.put(rows_of(lower, alphas.clone()).iter().map(|v| v.to_bits()));
            let higher_at = if higher == lower {
                lower_at
            } else {
                words.put(rows_of(higher, alphas.clone()).iter().map(|v| v.to_bits()))
            };
            let rows = alphas.count() as u32;
            let table = [lower_at, higher_at, first, weight.to_bits(), rows];
            let mut own = vec![eta.to_bits(), r.remap.into()];
            own.extend(table);
            (5, own, vec![C(reflectance), S(r.u), S(r.v)])
        }
        Material::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            ior,
            specular,
            specular_color,
            transmission,
            double_sided,
        } => (
            6,
            vec![ior.to_bits(), double_sided.into()],
            vec![
                C(base_color),
                S(metallic),
                S(roughness),
                S(specular),
                C(specular_color),
                S(transmission),
            ],
        ),
        // Its parts' places are filled in when all are known.
        Material::Mix { first: _, second: _, amount } => (7, vec![0, 0], vec![S(amount)]),
    };
    let mut to = vec![kind, parameters.len() as u32];
    to.extend(own);
    to.resize(MATERIAL_HEAD, 0);
    for parameter in parameters {
        match parameter {
            C(Color::Texture(id)) => to.extend([places.textures[id.index()], RGB, 0, 0]),
            C(constant) => to.extend(places.color(constant)),
            S(Scalar::Texture(id, channel)) => {
                to.extend([places.textures[id.index()], channel as u32, 0, 0]);
            }
            S(Scalar::Constant(v)) => to.extend([NONE, v.to_bits(), 0, 0]),
        }
    }
    to
}

/// Rows of the table of rough interfaces that a coat may ask for: those around its roughness, all
/// where that is textured.
fn coat_rows(r: Roughness) -> std::ops::RangeInclusive<usize> {
    let (Scalar::Constant(u), Scalar::Constant(v)) = (r.u, r.v) else { return 0..=NODES - 1 };
    let alpha = |x: f32| if r.remap { x.max(0.0).sqrt() } else { x.max(0.0) };
    let alphas = glam::Vec2::new(alpha(u), alpha(v));
    let mean = crate::surface::bsdf::coat_alpha(alphas);
    let at = (mean.min(1.0).sqrt().sqrt() * (NODES - 1) as f32) as usize;
    // One more on either side, for the kernel's own rounding.
    let first = at.saturating_sub(1);
    first..=(at + 2).min(NODES - 1)
}

/// What changes from frame to frame.
#[derive(Debug)]
struct Dynamic {
    nodes: Vec<Quad>,
    geometry: Vec<Quad>,
    words: Vec<u32>,
    record: WorldRecord,
    remap: [u32; 4],
    instances: [u32; 4],
}

impl Dynamic {
    /// With its parts to lie at `base` (nodes, geometry, words).
    ///
    /// # Errors
    /// `None` inside: the world has something that `statics` has not.
    fn new(
        world: &World,
        statics: &Statics,
        base: [u32; 3],
        links: &Links<'_>,
    ) -> Result<Option<Self>> {
        let (Some(written), Some(looks)) =
            (statics.written.of(&world.accel), statics.looks_of(&world.scene))
        else {
            return Ok(None);
        };
        let mut record = WorldRecord::default();
        let mut nodes = Vec::new();
        let mut words = Words { base: base[2], data: Vec::new() };
        record.placements = base[0] + world.accel.export_placements(&written, &mut nodes);
        let (top, order, reach) = world.accel.export_top(&mut nodes)?;
        record.top_nodes = if top == NO_TREE { NO_TREE } else { base[0] + top };
        record.top_reach = reach;
        record.top_order = words.put(order.iter().copied());
        record.instances = world.scene.instances.len() as u32;
        if let Some(bottom) = written.first() {
            record.bottom_nodes = bottom.nodes;
            record.bottom_slots = bottom.slots;
            record.bottom_cold = bottom.cold;
            record.bottom_flags = bottom.flags;
            record.bottom_reach = bottom.reach;
        } else {
            record.bottom_nodes = NO_TREE;
        }
        record.emitter_nodes = NO_TREE;
        let mut arenas = TreeArenas { nodes, geometry: Vec::new() };
        if let Some(emitters) = world.emitters() {
            let (accel, first) = emitters.parts();
            let bottoms = accel.export_bottoms(&mut arenas)?;
            let placed = bottoms[0];
            record.emitter_nodes =
                if placed.nodes == NO_TREE { NO_TREE } else { base[0] + placed.nodes };
            record.emitter_slots = base[1] + placed.slots;
            record.emitter_cold = base[1] + placed.cold;
            record.emitter_flags = placed.flags;
            record.emitter_reach = placed.reach;
            record.emitter_placements =
                base[0] + accel.export_placements(&bottoms, &mut arenas.nodes);
            record.emitter_first = words.put(first.iter().copied());
        }
        record.shapes = words.at();
        for shape in &world.shapes {
            let alpha = shape.alpha.map_or([NONE, 0], |alpha| looks.places.scalar(alpha));
            let flags = u32::from(shape.alpha.is_some())
                | u32::from(shape.anisotropic) << 1
                | u32::from(shape.one_sided) << 2;
            words.put([looks.places.materials[shape.material.index()], alpha[0], alpha[1], flags]);
        }
        let lights = world.lights.export(&looks.places, &mut words);
        record.first_of_shape = lights.first_of_shape;
        record.lights = lights.lights;
        record.light_count = lights.light_count;
        record.alias_slots = lights.alias_slots;
        record.alias_count = lights.alias_count;
        record.probabilities = lights.probabilities;
        record.environments = lights.environments;
        record.environment_count = lights.environment_count;
        let mut remap = [NONE, 0, NONE, 0];
        if let Some((to_current, to_previous)) = links.lights {
            remap = [
                words.put(to_current.iter().copied()),
                to_current.len() as u32,
                words.put(to_previous.iter().copied()),
                to_previous.len() as u32,
            ];
        }
        let mut instances = [NONE, 0, 0, 0];
        if let Some(places) = links.instances {
            instances[0] = words.put(places.iter().copied());
        }
        Ok(Some(Self {
            nodes: arenas.nodes,
            geometry: arenas.geometry,
            words: words.data,
            record,
            remap,
            instances,
        }))
    }

    /// As [`Dynamic::new`], of a world that `statics` were made of.
    fn known(world: &World, statics: &Statics, base: [u32; 3], links: &Links<'_>) -> Result<Self> {
        Ok(Self::new(world, statics, base, links)?.expect("the statics were made of this world"))
    }

    fn lengths(&self) -> [u32; 3] {
        [self.nodes.len() as u32, self.geometry.len() as u32, self.words.len() as u32]
    }
}

/// A scene's arenas on a device.
#[derive(Debug)]
pub(crate) struct SceneBuffers {
    statics: Statics,
    buffers: [wgpu::Buffer; 4],
    /// Where each turn's second parts begin, and how much room they have.
    base: [[u32; 3]; 2],
    room: [u32; 3],
    records: [WorldRecord; 2],
    remap: [u32; 4],
    instances: [u32; 4],
    /// Whose turn it is.
    turn: usize,
    /// Whether the previous frame's world is this frame's.
    stayed: bool,
    /// Bytes that were sent to the device for the world of now.
    sent: u64,
    constants: SceneConstants,
    emitters: bool,
}

/// What kernels must know to show a world whose looks are among `statics`.
fn needed(world: &World, statics: &Statics) -> SceneConstants {
    let emitters = world.emitters().map_or(0, |emitters| emitters.parts().0.stack_entries());
    SceneConstants {
        two_level: world.accel.is_two_level(),
        quadrics: world.accel.has_quadrics(),
        coverage: world.has_alpha,
        textures: statics.textured,
        environments: world.lights.environments().next().is_some(),
        anisotropic: world.shapes.iter().any(|shape| shape.anisotropic),
        one_sided: world.has_one_sided,
        materials: statics.materials,
        stack: world.accel.stack_entries().max(emitters) as u32,
    }
}

impl SceneBuffers {
    /// Of a world that is shown alone.
    pub(crate) fn still(gpu: &Gpu, world: &World) -> Result<Self> {
        Self::new(gpu, (world, None), &Links::default(), None)
    }

    /// Of a world and the one before it, with room for what comes. Kernels will know what both
    /// need, and what `known` says.
    pub(crate) fn new(
        gpu: &Gpu,
        (world, previous): (&World, Option<&World>),
        links: &Links<'_>,
        known: Option<&SceneConstants>,
    ) -> Result<Self> {
        let statics = Statics::new(std::iter::once(world).chain(previous))?;
        let start = [
            statics.arenas.nodes.len() as u32,
            statics.arenas.geometry.len() as u32,
            statics.words.data.len() as u32,
        ];
        let now = Dynamic::known(world, &statics, start, links)?;
        let mut room = now.lengths();
        let mut base = [start; 2];
        let mut before = None;
        if let Some(previous) = previous {
            // Lights and instances may come: an eighth more.
            let needed = Dynamic::known(previous, &statics, start, &Links::default())?.lengths();
            for part in 0..3 {
                room[part] = room[part].max(needed[part]);
                room[part] += room[part] / 8 + 64;
                base[1][part] = start[part] + room[part];
            }
            before = Some(Dynamic::known(previous, &statics, base[1], &Links::default())?);
        }
        let turns = if previous.is_some() { 2 } else { 1 };
        let total = |part: usize| u64::from(start[part]) + turns * u64::from(room[part]);
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let buffers = [
            gpu.buffer("the scene's nodes", 16 * total(0), usage)?,
            gpu.buffer("the scene's geometry", 16 * total(1), usage)?,
            gpu.buffer("the scene's words", 4 * total(2), usage)?,
            gpu.buffer("the scene's texels", 4 * statics.texels.len() as u64, usage)?,
        ];
        let queue = gpu.queue();
        queue.write_buffer(&buffers[0], 0, bytemuck::cast_slice(&statics.arenas.nodes));
        queue.write_buffer(&buffers[1], 0, bytemuck::cast_slice(&statics.arenas.geometry));
        queue.write_buffer(&buffers[2], 0, bytemuck::cast_slice(&statics.words.data));
        queue.write_buffer(&buffers[3], 0, bytemuck::cast_slice(&statics.texels));
        let mut constants = needed(world, &statics);
        if let Some(previous) = previous {
            constants = constants.or(&needed(previous, &statics));
        }
        if let Some(known) = known {
            constants = constants.or(known);
        }
        let mut scene = Self {
            statics,
            buffers,
            base,
            room,
            records: [now.record; 2],
            remap: now.remap,
            instances: now.instances,
            turn: 0,
            stayed: false,
            sent: 0,
            constants,
            emitters: world.emitters().is_some(),
        };
        scene.sent = scene.write(gpu, 0, &now);
        if let Some(before) = before {
            scene.sent += scene.write(gpu, 1, &before);
            scene.records[1] = before.record;
        }
        gpu.check()?;
        // Their bytes are on the device; where they lie is all that is asked from now on.
        scene.statics.arenas = TreeArenas::default();
        scene.statics.words = Words::default();
        scene.statics.texels = Vec::new();
        Ok(scene)
    }

    /// Sends one turn's part; how many bytes that are.
    fn write(&self, gpu: &Gpu, turn: usize, part: &Dynamic) -> u64 {
        let [nodes, geometry, words] = self.base[turn].map(u64::from);
        let queue = gpu.queue();
        queue.write_buffer(&self.buffers[0], 16 * nodes, bytemuck::cast_slice(&part.nodes));
        queue.write_buffer(&self.buffers[1], 16 * geometry, bytemuck::cast_slice(&part.geometry));
        queue.write_buffer(&self.buffers[2], 4 * words, bytemuck::cast_slice(&part.words));
        let [nodes, geometry, words] = part.lengths().map(u64::from);
        16 * (nodes + geometry) + 4 * words
    }

    /// What changes, of a world that fits what is there; `None` where it does not.
    fn fitting(&self, world: &World, turn: usize, links: &Links<'_>) -> Result<Option<Dynamic>> {
        let part = Dynamic::new(world, &self.statics, self.base[turn], links)?;
        Ok(part.filter(|part| {
            part.lengths().iter().zip(self.room).all(|(needed, room)| *needed <= room)
                && self.constants.or(&needed(world, &self.statics)) == self.constants
        }))
    }

    /// The next frame's world takes its turn; the one of now becomes the previous one. False, and
    /// nothing changed: there is no room, or things changed that are written once; then all must be
    /// made anew.
    pub(crate) fn advance(&mut self, gpu: &Gpu, world: &World, links: &Links<'_>) -> Result<bool> {
        if world.only_camera {
            (self.remap, self.instances) = ([NONE, 0, NONE, 0], [NONE, 0, 0, 0]);
            (self.stayed, self.sent) = (true, 0);
            return Ok(true);
        }
        let next = 1 - self.turn;
        let part = self.fitting(world, next, links)?;
        let Some(part) = part.filter(|_| self.base[0] != self.base[1]) else { return Ok(false) };
        self.sent = self.write(gpu, next, &part);
        self.stayed = false;
        self.records[next] = part.record;
        (self.remap, self.instances) = (part.remap, part.instances);
        self.turn = next;
        Ok(true)
    }

    /// `world` is both this frame's and the previous one's. False, and nothing changed, as for
    /// [`SceneBuffers::advance`].
    pub(crate) fn reset(&mut self, gpu: &Gpu, world: &World) -> Result<bool> {
        let links = Links::default();
        let parts = [self.fitting(world, 0, &links)?, self.fitting(world, 1, &links)?];
        let [Some(first), Some(second)] = parts else { return Ok(false) };
        self.sent = self.write(gpu, 0, &first) + self.write(gpu, 1, &second);
        self.stayed = false;
        self.records = [first.record, second.record];
        (self.remap, self.instances) = (first.remap, first.instances);
        self.turn = 0;
        Ok(true)
    }

    /// What kernels must know.
    pub(crate) fn constants(&self) -> &SceneConstants {
        &self.constants
    }

    /// Whether the emitters' tree is there.
    pub(crate) fn has_emitters(&self) -> bool {
        self.emitters
    }

    /// The arenas, in the order of their bindings.
    pub(crate) fn buffers(&self) -> &[wgpu::Buffer; 4] {
        &self.buffers
    }

    /// Bytes that were sent to the device for the world of now.
    pub(crate) fn sent(&self) -> u64 {
        self.sent
    }

    /// Bytes on the device.
    pub(crate) fn bytes(&self) -> u64 {
        self.buffers.iter().map(wgpu::Buffer::size).sum()
    }

    /// Fills in where things are.
    pub(crate) fn describe(&self, inputs: &mut Inputs) {
        let before = if self.stayed { self.turn } else { 1 - self.turn };
        inputs.worlds = [self.records[self.turn], self.records[before]];
        inputs.remap = self.remap;
        inputs.instances = self.instances;
        inputs.srgb = self.statics.srgb;
    }
}
