//! glTF 2.0: the crate `gltf` reads and checks the JSON, everything else is here.
//!
//! | glTF | here |
//! |---|---|
//! | mesh | [`Object`], one shape a primitive |
//! | node with a mesh, light or camera | [`Instance`](crate::scene::Instance), [`Light`], [`Camera`]; its key is the node's index |
//! | animated node | a [`Track`] of every [`Transform::Chain`] below it |
//!
//! glTF's space is right-handed and kept. Its cameras and lights look along −z with y up: a camera
//! is mirrored along its z (ours has x right, y up, z forward), a light turned by half a turn
//! around y. Their scale is dropped. Candela and lux are taken as W·sr⁻¹ and W·m⁻² without
//! conversion.

mod animation;
mod bytes;
mod json;
mod material;
mod pose;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{Affine3A, Mat3, Vec2, Vec3, Vec3A};
use gltf::json::extensions::scene::khr_lights_punctual::Type as LightType;
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, mesh};

use super::{Warnings, emits, normals};
use crate::error::{Error, Result};
use crate::scene::transform::is_regular;
use crate::scene::{
    Camera, Curve, Geometry, Interpolation, Light, LightKind, Loaded, Mesh, Object, ObjectId,
    Scene, Shape, SpotFalloff, Track, Transform,
};
use animation::Motions;
use bytes::Buffers;
use material::{Materials, Surface};
use pose::{Deformer, Pose, Rest, Vertices};

/// The longer side of the picture; glTF has a shape at most.
const LONGER_SIDE: f32 = 1280.0;

pub(super) fn load(path: &Path) -> Result<Loaded> {
    from_bytes(&super::read(path)?, path)
}

pub(super) fn from_bytes(bytes: &[u8], path: &Path) -> Result<Loaded> {
    read(bytes, path).map_err(|e| e.with_path(path))
}

fn read(bytes: &[u8], path: &Path) -> Result<Loaded> {
    let (text, binary) = bytes::split(bytes)?;
    let mut warnings = Warnings::of(path);
    let root = json::parse(text, &mut warnings)?;
    json::check(&root, &mut warnings)?;
    let buffers = Buffers::read(&root, binary, path)?;
    let motions = animation::read(&root, &buffers, &mut warnings)?;
    let rest = Rest::new(&root);
    let name = path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned());
    let mut scene = Scene::new(name);
    scene.time = motions.time;
    let materials = Materials {
        root: &root,
        buffers: &buffers,
        path,
        pictures: HashMap::new(),
        picture_bytes: 0,
    };
    let builder = Builder {
        root: &root,
        buffers: &buffers,
        motions: &motions,
        moving: motions.moving(&root),
        deformer: Deformer { root: &root, buffers: &buffers, rest: &rest },
        materials,
        path,
        surfaces: HashMap::new(),
        meshes: HashMap::new(),
        camera: None,
        scene,
        warnings,
    };
    builder.build()
}

struct Builder<'a> {
    root: &'a Root,
    buffers: &'a Buffers<'a>,
    motions: &'a Motions,
    /// Whether a node or one above it is animated.
    moving: Vec<bool>,
    deformer: Deformer<'a>,
    materials: Materials<'a>,
    path: &'a Path,
    /// By material index; `None` is glTF's default material.
    surfaces: HashMap<Option<usize>, Surface>,
    /// By mesh index, for each pose that it is shown in; `None` has nothing to show.
    meshes: HashMap<usize, Vec<(Pose, Option<ObjectId>)>>,
    /// Its node, and the picture's width over height if the file says so.
    camera: Option<(usize, Option<f32>)>,
    scene: Scene,
    warnings: Warnings,
}

impl Builder<'_> {
    fn build(mut self) -> Result<Loaded> {
        self.nodes()?;
        if self.scene.instances.is_empty() {
            self.warnings.add("scenes: nothing to show: no node with triangles");
        }
        match self.camera {
            Some((_, aspect)) => self.scene.film = film(aspect.unwrap_or(16.0 / 9.0)),
            None => {
                self.warnings.add("cameras: none in the scene; one is placed so that all is seen");
                self.scene.film = film(16.0 / 9.0);
                self.scene.camera = framing(&self.scene);
            }
        }
        if !emits(&self.scene) && self.scene.lights.is_empty() {
            self.warnings
                .add("materials, lights: nothing emits; a white sky of radiance 1 is added");
            let kind = LightKind::Environment { radiance: Vec3::ONE, image: None };
            let key = u64::MAX;
            self.scene.lights.push(Light { to_world: Transform::IDENTITY, kind, key });
        }
        self.scene.validate()?;
        super::warn_of_geometry(&self.scene, &mut self.warnings);
        Ok(Loaded { scene: self.scene, warnings: self.warnings.into_vec(self.path) })
    }

    fn nodes(&mut self) -> Result<()> {
        let root = self.root;
        let roots: Vec<usize> = match root.scene.and_then(|s| root.get(s)).or(root.scenes.first()) {
            Some(scene) => scene.nodes.iter().map(|n| n.value()).collect(),
            None => {
                let children = root.nodes.iter().flat_map(|n| n.children.iter().flatten());
                let mut is_child = vec![false; root.nodes.len()];
                children.for_each(|child| is_child[child.value()] = true);
                (0..root.nodes.len()).filter(|&n| !is_child[n]).collect()
            }
        };
        let mut seen = vec![false; root.nodes.len()];
        let mut stack: Vec<(usize, Vec<Track>)> = Vec::new();
        stack.extend(roots.into_iter().rev().map(|n| (n, Vec::new())));
        while let Some((n, mut tracks)) = stack.pop() {
            let place = format!("nodes[{n}]");
            if std::mem::replace(&mut seen[n], true) {
                let message = "is reached twice; allowed: every node has at most one parent";
                return Err(Error::invalid(message).at_json(place));
            }
            let node = &root.nodes[n];
            let local = animation::local(node, n, self.motions.by_node.get(&n))?;
            match (tracks.last_mut(), &local) {
                (Some(Track::Fixed(above)), Track::Fixed(below)) => *above *= *below,
                _ => tracks.push(local),
            }
            // Every node below holds a copy of what moves it.
            let children = node.children.iter().flatten();
            let copies = 1 + children.clone().count() as u64;
            self.buffers.spend(copies * tracks.iter().map(animation::keys).sum::<u64>(), &place)?;
            self.node(n, &tracks)?;
            let children: Vec<usize> = children.map(|child| child.value()).collect();
            stack.extend(children.into_iter().rev().map(|child| (child, tracks.clone())));
        }
        Ok(())
    }

    fn node(&mut self, n: usize, tracks: &[Track]) -> Result<()> {
        let node = &self.root.nodes[n];
        let place = format!("nodes[{n}]");
        if let Some(camera) = node.camera {
            self.camera(n, camera.value(), tracks)?;
        }
        let light = node.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref());
        if let Some(light) = light {
            self.light(n, light.light.value(), tracks)?;
        }
        let Some(mesh) = node.mesh else { return Ok(()) };
        let m = mesh.value();
        let pose = self.pose(n, m);
        // A skin's joints place its mesh, its node does not.
        let to_world = match pose.skin {
            Some(_) => Transform::IDENTITY,
            None => placement(tracks),
        };
        let links: &[Track] = match &to_world {
            Transform::Fixed(affine) => &[Track::Fixed(*affine)],
            Transform::Chain(tracks) => tracks,
        };
        for link in links {
            let Track::Fixed(affine) = link else { continue };
            if !affine.is_finite() || !affine.matrix3.determinant().is_finite() {
                let message = "has a placement too large for 32-bit floats";
                return Err(Error::invalid(message).at_json(place));
            }
            if !is_regular(affine) {
                self.warnings.add(format!("{place}: a scale of 0 hides it"));
                return Ok(());
            }
        }
        let known = self.meshes.get(&m).and_then(|all| all.iter().find(|(p, _)| *p == pose));
        let object = match known {
            Some((_, object)) => *object,
            None => {
                let object = self.object(m, &pose)?;
                self.meshes.entry(m).or_default().push((pose, object));
                object
            }
        };
        if let Some(object) = object {
            self.scene.add_instance(object, to_world, n as u64);
        }
        Ok(())
    }

    /// How mesh `m` is deformed where node `n` shows it.
    fn pose(&mut self, n: usize, m: usize) -> Pose {
        let node = &self.root.nodes[n];
        let mut weights = node.weights.as_ref().or(self.root.meshes[m].weights.as_ref());
        weights = weights.filter(|w| w.iter().any(|w| *w != 0.0 && w.is_finite()));
        let skin = node.skin.filter(|skin| self.root.get(*skin).is_some());
        if let Some(skin) = skin {
            let joints = &self.root.skins[skin.value()].joints;
            if joints.iter().any(|joint| self.moving[joint.value()]) {
                self.warnings.add(format!(
                    "nodes[{n}].skin: its joints are animated, which is not followed; the mesh keeps its rest pose"
                ));
            }
        }
        Pose { weights: weights.cloned().unwrap_or_default(), skin: skin.map(|skin| skin.value()) }
    }

    fn camera(&mut self, n: usize, c: usize, tracks: &[Track]) -> Result<()> {
        let at = |field: &str| format!("cameras[{c}].{field}");
        let Some(given) = &self.root.cameras[c].perspective else {
            self.warnings
                .add(format!("{}: not read; only perspective cameras are", at("orthographic")));
            return Ok(());
        };
        if let Some((first, _)) = self.camera {
            self.warnings
                .add(format!("nodes[{n}].camera: ignored; the camera of nodes[{first}] is used"));
            return Ok(());
        }
        if !(given.yfov > 0.0 && given.yfov < std::f32::consts::PI) {
            let message = format!("is {}; allowed: between 0 and π", given.yfov);
            return Err(Error::invalid(message).at_json(at("perspective.yfov")));
        }
        if let Some(aspect) = given.aspect_ratio
            && !(1.0 / LONGER_SIDE..=LONGER_SIDE).contains(&aspect)
        {
            let message = format!("is {aspect}; allowed: 1/{LONGER_SIDE} to {LONGER_SIDE}");
            return Err(Error::invalid(message).at_json(at("perspective.aspectRatio")));
        }
        // yfov spans the height; ours spans the shorter side.
        let shorter = given.aspect_ratio.unwrap_or(16.0 / 9.0).min(1.0);
        let fov = 2.0 * ((0.5 * given.yfov).tan() * shorter).atan();
        let flip = Mat3::from_diagonal(Vec3::new(1.0, 1.0, -1.0));
        if let Some(to_world) = self.rigid(n, tracks, flip)? {
            let links = if let Transform::Chain(links) = &to_world { &links[..] } else { &[] };
            let vanishes = |link: &Track| match link {
                Track::Trs { scale, .. } => passes_zero(scale),
                Track::Fixed(_) => false,
            };
            if links.iter().any(vanishes) {
                let message = "a scale of 0 above its camera leaves it without a direction";
                self.warnings.add(format!("nodes[{n}]: {message}; ignored"));
                return Ok(());
            }
            self.scene.camera = Camera { to_world, fov };
            self.camera = Some((n, given.aspect_ratio));
        }
        Ok(())
    }

    fn light(&mut self, n: usize, l: usize, tracks: &[Track]) -> Result<()> {
        let at = |field: &str| format!("extensions.KHR_lights_punctual.lights[{l}].{field}");
        let lights = self.root.extensions.as_ref().and_then(|e| e.khr_lights_punctual.as_ref());
        let Some(given) = lights.and_then(|lights| lights.lights.get(l)) else {
            let place = format!("nodes[{n}].extensions.KHR_lights_punctual.light");
            return Err(Error::invalid(format!("is {l}, which does not exist")).at_json(place));
        };
        material::not_negative(&given.color, &at("color"))?;
        material::not_negative(&[given.intensity], &at("intensity"))?;
        if given.range.is_some() {
            self.warnings.add(format!("{}: ignored; light reaches everywhere", at("range")));
        }
        let power = given.intensity * Vec3::from_array(given.color);
        let kind = match given.type_ {
            Checked::Valid(LightType::Point) => LightKind::Point { intensity: power },
            Checked::Valid(LightType::Directional) => LightKind::Distant { irradiance: power },
            Checked::Valid(LightType::Spot) => {
                let spot = given.spot.clone().unwrap_or_default();
                let (inner, outer) = (spot.inner_cone_angle, spot.outer_cone_angle);
                if !(inner >= 0.0 && inner < outer && outer <= std::f32::consts::FRAC_PI_2) {
                    let message = format!(
                        "has the cone angles {inner} and {outer}; allowed: 0 <= inner < outer <= π/2"
                    );
                    return Err(Error::invalid(message).at_json(at("spot")));
                }
                LightKind::Spot {
                    intensity: power,
                    cos_inner: inner.cos(),
                    cos_outer: outer.cos(),
                    falloff: SpotFalloff::Quadratic,
                }
            }
            Checked::Invalid => {
                let message = "allowed: directional, point, spot";
                return Err(Error::invalid(message).at_json(at("type")));
            }
        };
        let turn = Mat3::from_diagonal(Vec3::new(-1.0, 1.0, -1.0));
        if let Some(to_world) = self.rigid(n, tracks, turn)? {
            self.scene.lights.push(Light { to_world, kind, key: n as u64 });
        }
        Ok(())
    }

    /// The placement of a camera or a light: without scale, and `turn` from our axes to glTF's.
    /// `None` where a scale of 0 leaves no directions, which is warned of.
    fn rigid(&mut self, n: usize, tracks: &[Track], turn: Mat3) -> Result<Option<Transform>> {
        let place = format!("nodes[{n}]");
        let mut tracks = tracks.to_vec();
        // Its own scale moves nothing; one that passes 0 would hide it.
        if let Some(Track::Trs { scale, .. }) = tracks.last_mut()
            && passes_zero(scale)
        {
            *scale = Curve::constant(Vec3::ONE);
        }
        let to_world = placement(&tracks);
        let now = to_world.at(self.scene.time[0]);
        if !now.is_finite() {
            let message = "has a placement too large for 32-bit floats";
            return Err(Error::invalid(message).at_json(place));
        }
        let axes = [now.matrix3.x_axis, now.matrix3.y_axis, now.matrix3.z_axis];
        let forward = axes[2].try_normalize();
        let up = forward.and_then(|z| (axes[1] - z * z.dot(axes[1])).try_normalize());
        let lengths = axes.map(|axis| axis.length());
        let scale = (lengths[0] * lengths[1] * lengths[2]).cbrt();
        let (Some(z), Some(y), true) = (forward, up, 1.0 / scale < f32::INFINITY) else {
            let message = "a scale of 0 leaves its camera or light without a direction";
            self.warnings.add(format!("{place}: {message}; ignored"));
            return Ok(None);
        };
        let turn = Affine3A::from_mat3(turn);
        Ok(Some(match to_world {
            Transform::Fixed(_) => {
                let mut still = Affine3A::from_cols(y.cross(z), y, z, Vec3A::ZERO) * turn;
                still.translation = now.translation;
                Transform::Fixed(still)
            }
            Transform::Chain(mut tracks) => {
                if lengths.iter().any(|l| (l / scale - 1.0).abs() > 1e-3) {
                    let message = "a moving camera or light is scaled differently along its axes";
                    self.warnings.add(format!("{place}: {message}; its directions are skewed"));
                }
                tracks.push(Track::Fixed(Affine3A::from_scale(Vec3::splat(1.0 / scale)) * turn));
                Transform::Chain(tracks)
            }
        }))
    }

    fn object(&mut self, m: usize, pose: &Pose) -> Result<Option<ObjectId>> {
        let given = &self.root.meshes[m];
        let mut object =
            Object { name: given.name.clone().unwrap_or_default(), shapes: Vec::new() };
        for (p, primitive) in given.primitives.iter().enumerate() {
            let place = format!("meshes[{m}].primitives[{p}]");
            object.shapes.extend(self.shape(primitive, pose, &place)?);
        }
        Ok((!object.shapes.is_empty()).then(|| self.scene.add_object(object)))
    }

    fn surface(&mut self, index: Option<usize>) -> Result<Surface> {
        if let Some(&surface) = self.surfaces.get(&index) {
            return Ok(surface);
        }
        let surface = self.materials.surface(index, &mut self.scene, &mut self.warnings)?;
        self.surfaces.insert(index, surface);
        Ok(surface)
    }

    fn shape(
        &mut self,
        given: &mesh::Primitive,
        pose: &Pose,
        place: &str,
    ) -> Result<Option<Shape>> {
        let mode = match given.mode {
            Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)) => {
                mode
            }
            Checked::Valid(other) => {
                let other = if other == Mode::Points { "points" } else { "lines" };
                self.warnings
                    .add(format!("{place}.mode: {other} are not read; only triangles are"));
                return Ok(None);
            }
            Checked::Invalid => {
                return Err(Error::invalid("allowed: 0 to 6").at_json(format!("{place}.mode")));
            }
        };
        let attribute = |semantic| given.attributes.get(&Checked::Valid(semantic)).copied();
        let at = |name: &str| format!("{place}.attributes.{name}");
        let Some(positions) = attribute(Semantic::Positions) else {
            let message = "missing; the primitive shows nothing";
            self.warnings.add(format!("{}: {message}", at("POSITION")));
            return Ok(None);
        };
        let count = self.buffers.count(positions)?;
        let corners = match given.indices {
            Some(indices) => self.buffers.indices(indices)?,
            None => {
                self.buffers.spend(count as u64, place)?;
                (0..count as u32).collect()
            }
        };
        if let Some(i) = corners.iter().position(|&c| c as usize >= count) {
            let message = format!(
                "index {i} is {}; allowed: below {count}, the number of vertices",
                corners[i]
            );
            return Err(Error::invalid(message).at_json(format!("{place}.indices")));
        }
        let (Some(&first), Some(&last)) = (corners.iter().min(), corners.iter().max()) else {
            return Ok(None);
        };
        let mut triangles = triangles(mode, &corners);
        if triangles.is_empty() {
            self.warnings.add(format!("{place}: fewer than 3 vertices; ignored"));
            return Ok(None);
        }
        if mode == Mode::Triangles && !corners.len().is_multiple_of(3) {
            self.warnings.add(format!("{place}: the last triangle is incomplete; ignored"));
        }
        triangles.iter_mut().flatten().for_each(|c| *c -= first);
        // Primitives may share one large accessor; only what this one uses is copied.
        let used = first as usize..last as usize + 1;
        let same_count = |index: Index<gltf::json::Accessor>, name: &str| {
            let found = self.buffers.count(index)?;
            if found == count {
                return Ok(());
            }
            let message = format!("has {found} elements; allowed: {count}, as POSITION");
            Err(Error::invalid(message).at_json(at(name)))
        };
        let positions = self.buffers.floats::<3>(positions, Some(used.clone()))?;
        let mut normals = Vec::new();
        if let Some(index) = attribute(Semantic::Normals) {
            same_count(index, "NORMAL")?;
            normals = self.buffers.numbers::<3>(index, Some(used.clone()))?;
        }
        let mut vertices = Vertices {
            positions: positions.into_iter().map(Vec3::from_array).collect(),
            normals: normals.into_iter().map(Vec3::from_array).collect(),
        };
        self.deformer.apply(pose, given, &used, place, &mut vertices)?;
        let surface = self.surface(given.material.map(|material| material.value()))?;
        let mut uvs = Vec::new();
        if let Some(set) = surface.uv_set {
            let name = format!("TEXCOORD_{set}");
            match attribute(Semantic::TexCoords(set)) {
                Some(index) => {
                    let found = self.buffers.count(index)?;
                    if found != count {
                        let message =
                            format!("has {found} elements; allowed: {count}, as POSITION");
                        return Err(Error::invalid(message).at_json(at(&name)));
                    }
                    uvs = self.buffers.floats::<2>(index, Some(used.clone()))?;
                }
                None => self.warnings.add(format!(
                    "{}: missing, but the material has textures; every triangle shows half of them",
                    at(&name)
                )),
            }
        }
        if attribute(Semantic::Colors(0)).is_some() {
            self.warnings.add(format!("{}: vertex colours are ignored", at("COLOR_0")));
        }
        let mut mesh = Mesh {
            positions: vertices.positions,
            normals: Vec::new(),
            uvs: uvs.into_iter().map(Vec2::from_array).collect(),
            triangles,
        };
        if !vertices.normals.is_empty() {
            let unit = vertices.normals.iter().map(|n| n.try_normalize()).collect();
            if let Some(mut lost) = normals::set(&mut mesh, unit, false) {
                lost.first += used.start;
                self.warnings.add(format!("{}: {lost}", at("NORMAL")));
            }
        }
        let mut shape = Shape::new(Geometry::Mesh(Arc::new(mesh)), surface.material);
        shape.emission = surface.emission;
        shape.alpha = surface.alpha;
        Ok(Some(shape))
    }
}

/// The triangles of a list, a strip or a fan, all with the winding of the first one (glTF 2.0,
/// section 3.7.2.1).
fn triangles(mode: Mode, corners: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => corners
            .windows(3)
            .enumerate()
            .map(|(i, c)| if i % 2 == 0 { [c[0], c[1], c[2]] } else { [c[0], c[2], c[1]] })
            .collect(),
        Mode::TriangleFan => corners
            .get(1..)
            .unwrap_or_default()
            .windows(2)
            .map(|c| [c[0], c[1], corners[0]])
            .collect(),
        _ => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    }
}

/// Whether a scale is 0 along an axis at some time.
fn passes_zero(scale: &Curve<Vec3>) -> bool {
    let zero = |s: Vec3| s.abs().min_element() == 0.0;
    let turns = |a: Vec3, b: Vec3| (a.signum() * b.signum()).min_element() < 0.0;
    scale.keys.iter().any(|key| zero(key.1))
        || (scale.interpolation == Interpolation::Linear
            && scale.keys.windows(2).any(|w| turns(w[0].1, w[1].1)))
}

/// One matrix if nothing moves, else the chain.
fn placement(tracks: &[Track]) -> Transform {
    match tracks {
        [Track::Fixed(still)] => Transform::Fixed(*still),
        moving => Transform::Chain(moving.to_vec()),
    }
}

/// The picture for an aspect ratio of width over height.
fn film(aspect: f32) -> [u32; 2] {
    let shorter = |ratio: f32| ((LONGER_SIDE * ratio).round() as u32).max(1);
    if aspect >= 1.0 {
        [LONGER_SIDE as u32, shorter(1.0 / aspect)]
    } else {
        [shorter(aspect), LONGER_SIDE as u32]
    }
}

/// A camera that sees the whole scene at its first time, from the front (+z), a little from the
/// right and above.
fn framing(scene: &Scene) -> Camera {
    const FOV: f32 = 40.0 * std::f32::consts::PI / 180.0;
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let boxes: Vec<(Vec3, Vec3)> = scene.objects.iter().map(|object| bounds(object)).collect();
    for instance in &scene.instances {
        let to_world = instance.to_world.at(scene.time[0]);
        let (from, to) = boxes[instance.object.index()];
        for corner in 0..8_u32 {
            let pick = |bit: u32, a: f32, b: f32| if corner >> bit & 1 == 0 { a } else { b };
            let point =
                Vec3::new(pick(0, from.x, to.x), pick(1, from.y, to.y), pick(2, from.z, to.z));
            let point = to_world.transform_point3(point);
            low = low.min(point);
            high = high.max(point);
        }
    }
    let (mut center, mut radius) = (0.5 * low + 0.5 * high, (0.5 * high - 0.5 * low).length());
    if !(center.is_finite() && radius.is_finite() && radius > 0.0) {
        (center, radius) = (Vec3::ZERO, 1.0);
    }
    let back = Vec3::new(0.4, 0.3, 1.0).normalize();
    let forward = -back;
    let right = forward.cross(Vec3::Y).normalize();
    let up = right.cross(forward);
    let eye = center + back * (radius / (0.5 * FOV).sin());
    let to_world = Affine3A::from_cols(right.into(), up.into(), forward.into(), eye.into());
    Camera { to_world: Transform::Fixed(to_world), fov: FOV }
}

fn bounds(object: &Object) -> (Vec3, Vec3) {
    let mut bounds = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for shape in &object.shapes {
        if let Geometry::Mesh(mesh) = &shape.geometry {
            for triangle in &mesh.triangles {
                for &corner in triangle {
                    let p = mesh.positions[corner as usize];
                    bounds = (bounds.0.min(p), bounds.1.max(p));
                }
            }
        }
    }
    bounds
}

#[cfg(test)]
mod cases;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Channel, Color, Material, Scalar};
    use proptest::prelude::*;
    use std::path::PathBuf;

    /// Base64 of little-endian words.
    pub(super) fn data(words: &[u32]) -> String {
        const DIGITS: &[u8; 64] =
            b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
        let bytes: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        let mut text = String::from("data:application/octet-stream;base64,");
        for three in bytes.chunks(3) {
            let bits = three.iter().fold(0_u32, |bits, &b| bits << 8 | u32::from(b))
                << (8 * (3 - three.len()));
            for i in 0..=three.len() {
                text.push(DIGITS[(bits >> (18 - 6 * i) & 63) as usize] as char);
            }
        }
        text
    }

    pub(super) fn floats(values: &[f32]) -> Vec<u32> {
        values.iter().map(|v| v.to_bits()).collect()
    }

    /// A red pixel over a half-transparent green one, as PNG.
    pub(super) const PNG: &str = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAACCAYAAACZgbYnAAAADklEQVR4nGP4z8AARg0AEngDfiJRAKgAAAAASUVORK5CYII=";

    /// One triangle in z = 0 with (u, v), its indices, two keys of an animation; `rest` replaces
    /// `REST`.
    pub(super) fn file(nodes: &str, rest: &str) -> String {
        let mut words = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        words.extend(floats(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0]));
        words.extend([0, 1, 2]);
        words.extend(floats(&[1.0, 3.0]));
        words.extend(floats(&[0.0, 0.0, 0.0, 4.0, 0.0, 0.0]));
        let uri = data(&words);
        format!(
            r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{nodes}],
            "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
            "buffers":[{{"byteLength":104,"uri":"{uri}"}}],
            "bufferViews":[{{"buffer":0,"byteLength":36}},{{"buffer":0,"byteOffset":36,"byteLength":24}},
              {{"buffer":0,"byteOffset":60,"byteLength":12}},{{"buffer":0,"byteOffset":72,"byteLength":8}},
              {{"buffer":0,"byteOffset":80,"byteLength":24}}],
            "accessors":[{{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}},
              {{"bufferView":1,"componentType":5126,"count":3,"type":"VEC2"}},
              {{"bufferView":2,"componentType":5125,"count":3,"type":"SCALAR"}},
              {{"bufferView":3,"componentType":5126,"count":2,"type":"SCALAR"}},
              {{"bufferView":4,"componentType":5126,"count":2,"type":"VEC3"}}]{rest}}}"#
        )
    }

    pub(super) fn parse(text: &str) -> Result<Loaded> {
        from_bytes(text.as_bytes(), Path::new("t.gltf"))
    }

    fn message(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn a_triangle_is_read() {
        let loaded =
            parse(&file(r#"{"mesh":0,"translation":[1,2,3]}"#, r#","materials":[{}]"#)).unwrap();
        let scene = &loaded.scene;
        assert_eq!((scene.name.as_str(), scene.film, scene.instances.len()), ("t", [1280, 720], 1));
        assert_eq!(scene.instances[0].to_world.fixed().translation, Vec3A::new(1.0, 2.0, 3.0));
        let Geometry::Mesh(mesh) = &scene.objects[0].shapes[0].geometry else { panic!() };
        assert_eq!(mesh.positions, [Vec3::ZERO, Vec3::X, Vec3::Y]);
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        // Nothing emits and there is no camera: both are made up, and said.
        assert_eq!(loaded.warnings.len(), 2, "{:?}", loaded.warnings);
        assert!(matches!(scene.lights[0].kind, LightKind::Environment { image: None, .. }));
    }

    #[test]
    fn a_framed_scene_is_seen_whole_and_not_mirrored() {
        let loaded = parse(&file(r#"{"mesh":0,"scale":[9,4,1]}"#, r#","materials":[{}]"#)).unwrap();
        let see = |p| loaded.scene.camera.project(p, loaded.scene.film).unwrap();
        let (origin, right, top) = (see(Vec3::ZERO), see(9.0 * Vec3::X), see(4.0 * Vec3::Y));
        assert!(right.x > origin.x + 100.0 && top.y < origin.y - 100.0, "{origin} {right} {top}");
        for p in [origin, right, top] {
            assert!(p.cmpgt(Vec2::ZERO).all() && p.x < 1280.0 && p.y < 720.0, "{p}");
        }
    }

    #[test]
    fn a_camera_looks_along_minus_z_and_fov_spans_the_shorter_side() {
        let camera = |aspect: f32| {
            let rest = format!(
                r#","materials":[{{}}],"cameras":[{{"type":"perspective","perspective":{{"yfov":1.0,"aspectRatio":{aspect},"znear":0.1}}}}]"#
            );
            parse(&file(r#"{"camera":0,"translation":[0,0,5],"scale":[2,2,2]}"#, &rest))
                .unwrap()
                .scene
        };
        let wide = camera(2.0);
        assert_eq!((wide.film, wide.camera.fov), ([1280, 640], 1.0));
        // tan(yfov / 2) is half the height over the distance: the top edge at distance 5.
        let top = 5.0 * 0.5_f32.tan();
        let seen = wide.camera.project(Vec3::new(0.0, top, 0.0), wide.film).unwrap();
        assert!((seen - Vec2::new(640.0, 0.0)).length() < 1e-3, "{seen}");
        let seen = wide.camera.project(Vec3::X, wide.film).unwrap();
        assert!(seen.x > 640.0);
        let tall = camera(0.5);
        assert_eq!(tall.film, [640, 1280]);
        let seen = tall.camera.project(Vec3::new(0.0, top, 0.0), tall.film).unwrap();
        assert!((seen - Vec2::new(320.0, 0.0)).length() < 1e-3, "{seen}");
    }

    #[test]
    fn lights_shine_along_minus_z_of_their_node() {
        // A quarter turn around x takes -z to +y.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        for (kind, extra) in [("directional", ""), ("spot", r#","spot":{"outerConeAngle":0.5}"#)] {
            let rest = format!(
                r#","materials":[{{}}],"extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"{kind}","intensity":3,"color":[1,0.5,0]{extra}}}]}}}}"#
            );
            let node = format!(
                r#"{{"rotation":[{half},0,0,{half}],"translation":[0,7,0],"extensions":{{"KHR_lights_punctual":{{"light":0}}}}}}"#
            );
            let scene = parse(&file(&node, &rest)).unwrap().scene;
            assert_eq!(scene.lights.len(), 1);
            let to_world = scene.lights[0].to_world.fixed();
            let along = to_world.transform_vector3(Vec3::Z);
            assert!((along - Vec3::Y).length() < 1e-6, "{along}");
            assert!((to_world.matrix3.determinant() - 1.0).abs() < 1e-6);
            match scene.lights[0].kind {
                LightKind::Distant { irradiance: power }
                | LightKind::Spot { intensity: power, .. } => {
                    assert_eq!(power, Vec3::new(3.0, 1.5, 0.0));
                }
                _ => panic!("{kind}"),
            }
        }
    }

    #[test]
    fn animation_runs_down_the_hierarchy() {
        let nodes =
            r#"{"children":[1],"scale":[2,2,2]},{"children":[2]},{"mesh":0,"translation":[0,1,0]}"#;
        let animated = |interpolation: &str, path: &str| {
            file(
                nodes,
                &format!(
                    r#","materials":[{{}}],"animations":[{{"samplers":[{{"input":3,"output":4,"interpolation":"{interpolation}"}}],
                    "channels":[{{"sampler":0,"target":{{"node":1,"path":"{path}"}}}}]}}]"#
                ),
            )
        };
        let scene = parse(&animated("LINEAR", "translation")).unwrap().scene;
        assert_eq!(scene.time, [1.0, 3.0]);
        assert!(scene.moves());
        let at = |time: f32| scene.instances[0].to_world.at(time).transform_point3(Vec3::ZERO);
        assert_eq!([at(0.0), at(2.0), at(9.0)], [0.0, 4.0, 8.0].map(|x| Vec3::new(x, 2.0, 0.0)));
        let scene = parse(&animated("STEP", "translation")).unwrap().scene;
        assert_eq!(scene.instances[0].to_world.at(2.9).translation.x, 0.0);
        let text = message(&animated("CUBICSPLINE", "translation"));
        assert_eq!(
            text,
            "t.gltf: animations[0].samplers[0].output: 2 values for 2 keys; allowed: 3 a key"
        );
        let loaded = parse(&animated("LINEAR", "weights")).unwrap();
        assert!(!loaded.scene.moves());
        assert_eq!(
            loaded.warnings[0],
            "t.gltf: animations[0].channels[0].target.path: animated morph targets are not followed; the mesh \
             keeps its rest pose"
        );
    }

    #[test]
    fn a_node_that_is_its_own_ancestor_is_refused() {
        let text = message(&file(r#"{"children":[1]},{"children":[0]}"#, r#","materials":[{}]"#));
        assert_eq!(
            text,
            "t.gltf: nodes[0]: is reached twice; allowed: every node has at most one parent"
        );
    }

    #[test]
    fn materials_are_read() {
        let rest = r#","materials":[{"emissiveFactor":[1,0.5,0.25],"doubleSided":true,"alphaMode":"BLEND",
            "pbrMetallicRoughness":{"baseColorFactor":[0.5,0.25,0.125,0.75],"metallicFactor":0.5,"roughnessFactor":0.25},
            "normalTexture":{"index":0},
            "extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":8},"KHR_materials_ior":{"ior":1.4},
              "KHR_materials_specular":{"specularFactor":0.5,"specularColorFactor":[1,2,0.5]},
              "KHR_materials_transmission":{"transmissionFactor":0.25}}}],
            "textures":[{"source":0}],"images":[{"uri":"missing.png"}]"#;
        let loaded = parse(&file(r#"{"mesh":0}"#, rest)).unwrap();
        let shape = &loaded.scene.objects[0].shapes[0];
        let emission = shape.emission.unwrap();
        assert!(matches!(emission.radiance, Color::Constant(c) if c == Vec3::new(1.0, 0.5, 0.25)));
        assert!(emission.scale == 8.0 && emission.two_sided);
        assert!(matches!(shape.alpha, Some(Scalar::Constant(a)) if a == 0.75));
        let Material::MetallicRoughness {
            base_color,
            metallic,
            roughness,
            ior,
            specular,
            specular_color,
            transmission,
            double_sided,
        } = loaded.scene.materials[0]
        else {
            panic!()
        };
        assert!(matches!(base_color, Color::Constant(c) if c == Vec3::new(0.5, 0.25, 0.125)));
        assert!(
            matches!(metallic, Scalar::Constant(0.5))
                && matches!(roughness, Scalar::Constant(0.25))
        );
        assert!(ior == 1.4 && double_sided && matches!(specular, Scalar::Constant(0.5)));
        assert!(matches!(specular_color, Color::Constant(c) if c == Vec3::new(1.0, 2.0, 0.5)));
        assert!(matches!(transmission, Scalar::Constant(0.25)));
        assert!(
            loaded
                .warnings
                .iter()
                .any(|w| w == "t.gltf: materials[0].normalTexture: not read; ignored")
        );
    }

    /// Glass is as rough as its α, the square of glTF's roughness.
    #[test]
    fn the_roughness_of_glass_is_squared() {
        let rest = r#","materials":[{"pbrMetallicRoughness":{"metallicFactor":0,"roughnessFactor":0.5},
            "extensions":{"KHR_materials_ior":{"ior":1.4},"KHR_materials_volume":{"thicknessFactor":1},
              "KHR_materials_transmission":{"transmissionFactor":1}}}]"#;
        let loaded = parse(&file(r#"{"mesh":0}"#, rest)).unwrap();
        let Material::Dielectric { eta, roughness } = loaded.scene.materials[0] else {
            panic!("{:?}", loaded.scene.materials[0])
        };
        assert_eq!(eta, 1.4);
        assert_eq!(roughness, crate::scene::Roughness::isotropic(0.25));
    }

    #[test]
    fn textures_are_upright_and_masks_are_thresholds() {
        let rest = format!(
            r#","materials":[{{"alphaMode":"MASK","alphaCutoff":0.75,
            "pbrMetallicRoughness":{{"baseColorTexture":{{"index":0}},"baseColorFactor":[0.5,1,1,1]}}}}],
            "textures":[{{"source":0,"sampler":0}}],"samplers":[{{"wrapS":33071,"wrapT":33071}}],"images":[{{"uri":"{PNG}"}}]"#
        );
        let scene = parse(&file(r#"{"mesh":0}"#, &rest)).unwrap().scene;
        let Material::MetallicRoughness { base_color, .. } = scene.materials[0] else { panic!() };
        let (top, bottom) = (Vec2::new(0.5, 0.1), Vec2::new(0.5, 0.9));
        assert_eq!(scene.color(base_color, top), Vec3::new(0.5, 0.0, 0.0));
        assert_eq!(scene.color(base_color, bottom), Vec3::Y);
        let alpha = scene.objects[0].shapes[0].alpha.unwrap();
        assert!(matches!(alpha, Scalar::Texture(_, Channel::Red)));
        assert_eq!((scene.scalar(alpha, top), scene.scalar(alpha, bottom)), (1.0, 0.0));
    }

    #[test]
    fn refusals_name_the_json_path() {
        let node = r#"{"mesh":0}"#;
        let good = file(node, r#","materials":[{}]"#);
        for (from, to, expected) in [
            (
                r#""POSITION":0"#,
                r#""POSITION":77"#,
                "meshes[0].primitives[0].attributes.POSITION: is 77; allowed: below 5",
            ),
            (
                r#""indices":2"#,
                r#""indices":1"#,
                "accessors[1].type: is VEC2; allowed for indices: SCALAR",
            ),
            (
                r#""count":3,"type":"SCALAR""#,
                r#""count":4,"type":"SCALAR""#,
                "accessors[2]: 4 elements of 4 bytes, 4 apart, from byte 0 on do not fit into the 12 bytes of bufferViews[2]",
            ),
            (
                r#""byteLength":104"#,
                r#""byteLength":105"#,
                "buffers[0].byteLength: is 105, but there are 104 bytes",
            ),
            (r#""byteOffset":80,"byteLength":24"#, r#""byteOffset":84,"byteLength":24"#, ""),
            (r#""mesh":0"#, r#""mesh":4"#, "nodes[0].mesh: refers to what does not exist"),
            (
                r#""mesh":0"#,
                r#""mesh":0,"rotation":[0,0,0,0]"#,
                "nodes[0].rotation: is [0.0, 0.0, 0.0, 0.0]; allowed: a unit quaternion",
            ),
            (r#""version":"2.0""#, r#""version":"1.0""#, "asset.version: is `1.0`; allowed: 2.0"),
            (
                r#"[{}]"#,
                r#"[{"pbrMetallicRoughness":{"metallicFactor":2}}]"#,
                "materials[0].pbrMetallicRoughness.metallicFactor: is [2.0]; allowed: 0 to 1",
            ),
            (
                r#"[{}]"#,
                r#"[{"emissiveTexture":{"index":3},"emissiveFactor":[1,1,1]}]"#,
                "materials[0].emissiveTexture.index: refers to what does not exist",
            ),
            (
                r#"[{}]"#,
                r#"[{}],"extensionsRequired":["EXT_x"]"#,
                "extensionsRequired[0]: is `EXT_x`; allowed: KHR_lights_punctual",
            ),
        ] {
            let bad = good.replacen(from, to, 1);
            assert_ne!(bad, good);
            if expected.is_empty() {
                // A view that ends outside of its buffer, but that nothing reads.
                assert!(parse(&bad).is_ok());
                continue;
            }
            let text = message(&bad);
            assert!(
                text.starts_with(&format!("t.gltf: {expected}")),
                "{text}\nexpected {expected}"
            );
        }
        assert!(message("{").starts_with("t.gltf:1:1: not glTF 2.0:"), "{}", message("{"));
    }

    #[test]
    fn strips_and_fans_keep_the_winding() {
        assert_eq!(triangles(Mode::TriangleStrip, &[0, 1, 2, 3]), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(triangles(Mode::TriangleFan, &[0, 1, 2, 3]), [[1, 2, 0], [2, 3, 0]]);
        assert_eq!(triangles(Mode::Triangles, &[0, 1, 2, 3]), [[0, 1, 2]]);
        assert!(triangles(Mode::TriangleFan, &[]).is_empty());
    }

    #[test]
    fn files_beside_the_crate_load() {
        let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
        for (file, instances, emitters) in [
            ("cornell-box/scene.gltf", 8, 1),
            ("veach-mis/scene.gltf", 9, 3),
            ("veach-bidir/scene.gltf", 14, 2),
            ("veach-ajar/scene.gltf", 22, 1),
            ("gltf-kajiya/emissive-triangle/triangle.glb", 1, 1),
            ("gltf-kajiya/roughness-scale/scene.gltf", 10, 0),
        ] {
            let path = folder.join(file);
            if !path.exists() {
                println!("skipped: {file} is not there");
                continue;
            }
            let loaded = load(&path).unwrap_or_else(|e| panic!("{e}"));
            let scene = &loaded.scene;
            println!(
                "{file}: {} instances, film {:?}, {:?}",
                scene.instances.len(),
                scene.film,
                loaded.warnings
            );
            let found = scene.instances.iter().filter(|i| {
                scene.objects[i.object.index()].shapes.iter().any(|s| s.emission.is_some())
            });
            assert_eq!((scene.instances.len(), found.count()), (instances, emitters), "{file}");
        }
        let path = folder.join("cornell-box/scene.gltf");
        if path.exists() {
            // The red wall is at x = -1 and on the left of the picture.
            let scene = load(&path).unwrap().scene;
            let seen = scene.camera.project(Vec3::new(-1.0, 1.0, 0.0), scene.film).unwrap();
            assert!(seen.x < 640.0 && (scene.camera.fov - 0.340_339_2).abs() < 1e-6, "{seen}");
        }
    }

    fn rich() -> String {
        let rest = format!(
            r#","materials":[{{"emissiveFactor":[1,1,1],"emissiveTexture":{{"index":0}}}}],"textures":[{{"source":0}}],"images":[{{"uri":"{PNG}"}}],
            "cameras":[{{"type":"perspective","perspective":{{"yfov":1.0,"znear":0.1}}}}],
            "extensions":{{"KHR_lights_punctual":{{"lights":[{{"type":"point"}}]}}}},
            "animations":[{{"samplers":[{{"input":3,"output":4}}],"channels":[{{"sampler":0,"target":{{"node":0,"path":"scale"}}}}]}}]"#
        );
        file(
            r#"{"children":[1],"camera":0},{"mesh":0,"extensions":{"KHR_lights_punctual":{"light":0}}}"#,
            &rest,
        )
    }

    /// A binary glTF around `json`.
    fn binary(json: &str, chunk: &[u8]) -> Vec<u8> {
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend((28 + json.len() as u32 + chunk.len() as u32).to_le_bytes());
        bytes.extend((json.len() as u32).to_le_bytes());
        bytes.extend(b"JSON");
        bytes.extend(json.as_bytes());
        bytes.extend((chunk.len() as u32).to_le_bytes());
        bytes.extend(b"BIN\0");
        bytes.extend(chunk);
        bytes
    }

    #[test]
    fn binary_files_find_their_chunk() {
        let text = file(r#"{"mesh":0}"#, r#","materials":[{}]"#);
        let start = text.find(r#","uri""#).unwrap();
        let end = start + text[start..].find('}').unwrap();
        let json = format!("{}{}", &text[..start], &text[end..]);
        let mut chunk: Vec<u8> = floats(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0])
            .iter()
            .flat_map(|w| w.to_le_bytes())
            .collect();
        chunk.resize(60, 0);
        chunk.extend([0_u32, 1, 2].iter().flat_map(|w| w.to_le_bytes()));
        chunk.resize(104, 0);
        let scene = from_bytes(&binary(&json, &chunk), Path::new("t.glb")).unwrap().scene;
        let Geometry::Mesh(mesh) = &scene.objects[0].shapes[0].geometry else { panic!() };
        assert_eq!(mesh.positions[2], 2.0 * Vec3::Y);
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(512) })]

        #[test]
        fn any_bytes_give_a_result(bytes in prop::collection::vec(any::<u8>(), 0..200), glb in any::<bool>()) {
            let bytes = if glb { [&b"glTF\x02\0\0\0"[..], &bytes].concat() } else { bytes };
            let _ = from_bytes(&bytes, Path::new("no-such-folder/t.gltf"));
        }

        #[test]
        fn changed_files_give_a_result(
            edits in prop::collection::vec((any::<prop::sample::Index>(), prop::sample::select(b"0123456789-9e.,\"{}[]nul\xff ".to_vec())), 1..6),
        ) {
            let mut bytes = rich().into_bytes();
            for (at, byte) in edits {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if let Ok(loaded) = from_bytes(&bytes, Path::new("no-such-folder/t.gltf")) {
                let _ = loaded.scene.at(loaded.scene.time[0]);
            }
        }

        #[test]
        fn changed_numbers_give_a_result(at in any::<prop::sample::Index>(), number in prop::sample::select(vec!["-1", "0", "1", "3", "4", "255", "5121", "5123", "65536", "4294967295", "18446744073709551615", "1e39", "0.5"])) {
            let text = rich();
            let mut numbers = Vec::new();
            let bytes = text.as_bytes();
            for i in 1..bytes.len() {
                if bytes[i].is_ascii_digit() && matches!(bytes[i - 1], b':' | b',' | b'[') {
                    let end = i + bytes[i..].iter().take_while(|b| b.is_ascii_digit() || **b == b'.').count();
                    numbers.push(i..end);
                }
            }
            let mut changed = text.clone();
            changed.replace_range(at.get(&numbers).clone(), number);
            if let Ok(loaded) = parse(&changed) {
                let _ = loaded.scene.at(loaded.scene.time[0]);
            }
        }
    }
}
