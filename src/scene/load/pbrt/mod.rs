//! pbrt-v4 text: directives to a [`Scene`]. What is read, approximated or refused stands in
//! `docs/scenes.md`.
//!
//! | file | part |
//! |---|---|
//! | `lexer` | tokens with their places |
//! | `params` | `"type name" value` lists |
//! | `motion` | the current transformation, fixed or moving |
//! | `spectrum` | spectra to RGB |
//! | `shape`, `material`, `texture`, `light`, `camera` | one kind of directive each |

mod camera;
mod lexer;
mod light;
mod material;
mod motion;
mod params;
mod shape;
mod spectrum;
mod texture;

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use glam::{DAffine3, DMat3, DMat4, DVec3, DVec4};

use self::lexer::{Kind, Lexer, Token, number, shorten, unescape};
use self::motion::Ctm;
use self::params::{Param, Params, Place, Type, Values};
use super::{Encoding, Warnings, emits, gunzip, read};
use crate::error::{Error, ErrorKind, Result, suggest};
use crate::scene::{
    ImageId, Instance, Loaded, MaterialId, Object, ObjectId, Scene, Shape, TextureId, Transform,
};

/// Files inside files.
const MAX_INCLUDE_DEPTH: usize = 32;

/// Bytes of text that a scene may include, with repetition: 8 GiB. A few files that include each
/// other's copies would go on for ever.
const MAX_INCLUDED_BYTES: u64 = 1 << 33;

/// What including a file costs at least, in bytes of [`MAX_INCLUDED_BYTES`]: it has to be opened.
const INCLUDE_BYTES: u64 = 4096;

/// Nested attributes.
const MAX_ATTRIBUTE_DEPTH: usize = 4096;

/// Bytes of placed objects: 4 GiB.
const MAX_INSTANCE_BYTES: u64 = 1 << 32;

/// What a file says that only pbrt-v3 understands.
fn of_version_3(what: impl std::fmt::Display) -> String {
    format!("{what} is pbrt-v3; allowed: pbrt-v4 (pbrt-v4's `pbrt --upgrade` translates files)")
}

const DIRECTIVES: [&str; 38] = [
    "Accelerator",
    "ActiveTransform",
    "AreaLightSource",
    "Attribute",
    "AttributeBegin",
    "AttributeEnd",
    "Camera",
    "ColorSpace",
    "ConcatTransform",
    "CoordSysTransform",
    "CoordinateSystem",
    "Film",
    "Identity",
    "Import",
    "Include",
    "Integrator",
    "LightSource",
    "LookAt",
    "MakeNamedMaterial",
    "MakeNamedMedium",
    "Material",
    "MediumInterface",
    "NamedMaterial",
    "ObjectBegin",
    "ObjectEnd",
    "ObjectInstance",
    "Option",
    "PixelFilter",
    "ReverseOrientation",
    "Rotate",
    "Sampler",
    "Scale",
    "Shape",
    "Texture",
    "Transform",
    "TransformTimes",
    "Translate",
    "WorldBegin",
];

pub(super) fn load(path: &Path) -> Result<Loaded> {
    from_bytes(&read(path)?, path)
}

pub(super) fn from_bytes(bytes: &[u8], path: &Path) -> Result<Loaded> {
    let mut builder = Builder::new(path);
    builder.run(bytes, Arc::from(path))?;
    builder.finish().map_err(|e| e.with_path(path))
}

/// What shapes and lights inherit.
#[derive(Clone, Debug)]
struct State {
    ctm: Ctm,
    /// Which ends transformations change.
    active: [bool; 2],
    surface: Surface,
    area_light: Option<Rc<Params>>,
    reverse_orientation: bool,
    defaults: Defaults,
}

/// Parameters set by `Attribute`.
#[derive(Clone, Debug, Default)]
struct Defaults {
    shape: Vec<Param>,
    light: Vec<Param>,
    material: Vec<Param>,
    texture: Vec<Param>,
}

/// The material of the shapes to come.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Surface {
    /// pbrt's grey, as long as no directive names another.
    Default,
    Material(MaterialId),
    /// No surface at all.
    Interface,
}

/// Shapes between `ObjectBegin` and `ObjectEnd`.
#[derive(Debug)]
struct OpenObject {
    name: String,
    shapes: Vec<Shape>,
    moving: Vec<Part>,
}

/// An object and where it stands in its parent.
#[derive(Clone, Debug)]
struct Part {
    object: ObjectId,
    to_parent: Transform,
}

/// Which directive opened a saved state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Opened {
    Attribute,
    Transform,
    Object,
}

struct Builder {
    scene: Scene,
    warnings: Warnings,
    /// The first file.
    path: PathBuf,
    /// Of the first file.
    folder: PathBuf,
    /// Those that are being read, each included by the one before it.
    files: Vec<PathBuf>,
    /// What is left of [`MAX_INCLUDED_BYTES`].
    included_bytes: u64,
    in_world: bool,
    state: State,
    stack: Vec<(Opened, State, Place)>,
    coordinate_systems: HashMap<String, Ctm>,
    times: [f64; 2],
    materials: HashMap<String, Surface>,
    default_material: Option<MaterialId>,
    float_textures: HashMap<String, TextureId>,
    color_textures: HashMap<String, TextureId>,
    images: HashMap<(PathBuf, Encoding, bool), ImageId>,
    shapes: Vec<Shape>,
    open_object: Option<OpenObject>,
    objects: HashMap<String, Vec<Part>>,
    next_key: u64,
    camera_seen: bool,
}

impl Builder {
    fn new(path: &Path) -> Self {
        let stem =
            |p: &Path| p.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default();
        // Collections keep one folder a scene, with a file of this name in each.
        let folder_name =
            path.parent().and_then(Path::file_name).map(|n| n.to_string_lossy().into_owned());
        let name = match (stem(path), folder_name) {
            (stem, Some(folder)) if stem == "scene" => folder,
            (stem, _) => stem,
        };
        let mut scene = Scene::new(name);
        // pbrt's defaults.
        scene.film = [1280, 720];
        scene.depth = 6;
        scene.camera.fov = std::f32::consts::FRAC_PI_2;
        Self {
            scene,
            warnings: Warnings::default(),
            path: path.to_path_buf(),
            folder: path.parent().map(Path::to_path_buf).unwrap_or_default(),
            files: Vec::new(),
            included_bytes: MAX_INCLUDED_BYTES,
            in_world: false,
            state: State {
                ctm: Ctm::IDENTITY,
                active: [true; 2],
                surface: Surface::Default,
                area_light: None,
                reverse_orientation: false,
                defaults: Defaults::default(),
            },
            stack: Vec::new(),
            coordinate_systems: HashMap::new(),
            times: [0.0, 1.0],
            materials: HashMap::new(),
            default_material: None,
            float_textures: HashMap::new(),
            color_textures: HashMap::new(),
            images: HashMap::new(),
            shapes: Vec::new(),
            open_object: None,
            objects: HashMap::new(),
            next_key: 1,
            camera_seen: false,
        }
    }

    /// Reads one file's directives.
    fn run(&mut self, bytes: &[u8], path: Arc<Path>) -> Result<()> {
        let unpacked = gunzip(bytes).map_err(|e| e.with_path(&path))?;
        let bytes = unpacked.as_deref().unwrap_or(bytes);
        let folder = self.folder.clone();
        let mut file = File::new(bytes, path.clone(), folder).map_err(|e| e.with_path(&path))?;
        self.files.push(path.to_path_buf());
        loop {
            let token = file.next()?;
            let place = file.place(&token);
            match token.kind {
                Kind::End => break,
                Kind::Word(directive) => {
                    self.directive(directive, &place, &mut file).map_err(|e| place.put(e))?;
                }
                other => {
                    return place.syntax(format!(
                        "found {}; allowed: a directive such as Shape",
                        other.describe()
                    ));
                }
            }
        }
        self.files.pop();
        Ok(())
    }

    fn directive(&mut self, directive: &str, place: &Place, file: &mut File<'_>) -> Result<()> {
        self.check_section(directive, place)?;
        match directive {
            "Identity" => self.set_transform(|_| DAffine3::IDENTITY),
            "Translate" => {
                let [x, y, z] = file.numbers()?;
                self.transform(DAffine3::from_translation(DVec3::new(x, y, z)));
            }
            "Scale" => {
                let [x, y, z] = file.numbers()?;
                self.transform(DAffine3::from_scale(DVec3::new(x, y, z)));
            }
            "Rotate" => {
                let [degrees, x, y, z] = file.numbers()?;
                let Some(axis) = DVec3::new(x, y, z).try_normalize() else {
                    return place.invalid("the axis of Rotate is 0 0 0; allowed: any other");
                };
                self.transform(DAffine3::from_axis_angle(axis, degrees.to_radians()));
            }
            "LookAt" => {
                let view = look_at(file.numbers()?, place)?;
                self.transform(view);
            }
            "Transform" => {
                let affine = matrix(file.matrix()?, place)?;
                self.set_transform(|_| affine);
            }
            "ConcatTransform" => {
                let affine = matrix(file.matrix()?, place)?;
                self.transform(affine);
            }
            "CoordinateSystem" => {
                let name = file.quoted("a name")?;
                self.coordinate_systems.insert(name, self.state.ctm);
            }
            "CoordSysTransform" => {
                let name = file.quoted("a name")?;
                let Some(ctm) = self.coordinate_systems.get(&name).copied() else {
                    let names = self.coordinate_systems.keys().map(String::as_str);
                    return place.invalid(format!(
                        "no coordinate system \"{}\"; {}",
                        shorten(&name),
                        list(&name, names)
                    ));
                };
                self.state.ctm = ctm;
            }
            "ActiveTransform" => {
                let token = file.next()?;
                self.state.active = match token.kind {
                    Kind::Word("StartTime") => [true, false],
                    Kind::Word("EndTime") => [false, true],
                    Kind::Word("All") => [true, true],
                    other => {
                        let message =
                            format!("found {}; allowed: StartTime, EndTime, All", other.describe());
                        return file.place(&token).syntax(message);
                    }
                };
            }
            "TransformTimes" => {
                let [start, end] = file.numbers()?;
                if start >= end {
                    return place.invalid(format!(
                        "TransformTimes {start} {end}; allowed: a start before the end"
                    ));
                }
                self.times = [start, end];
            }
            "ReverseOrientation" => self.state.reverse_orientation ^= true,
            "AttributeBegin" => self.open(Opened::Attribute, place)?,
            "AttributeEnd" => self.close(Opened::Attribute, place)?,
            "TransformBegin" => self.open(Opened::Transform, place)?,
            "TransformEnd" => self.close(Opened::Transform, place)?,
            "Attribute" => self.attribute(place, file)?,
            "Include" | "Import" => self.include(place, file)?,
            "WorldBegin" => self.world_begin(),
            "WorldEnd" => self
                .warnings
                .add_once("WorldEnd", format!("{place}: WorldEnd is ignored: pbrt-v4 has none")),
            "Option" => {
                let token = file.next()?;
                Param::parse(&mut file.lexer, token, &file.path)?;
            }
            "ColorSpace" => {
                let name = file.quoted("a colour space")?;
                if name != "srgb" {
                    let name = shorten(&name);
                    self.warnings.add(format!("{place}: ColorSpace \"{name}\" is ignored: rgb values are taken as sRGB primaries"));
                }
            }
            "Sampler" | "Accelerator" => {
                file.params(directive, place, &[])?;
            }
            "PixelFilter" => {
                let (kind, _) = file.params(directive, place, &[])?;
                if kind != "box" {
                    let warning = format!(
                        "{place}: PixelFilter \"{}\" is ignored: a pixel is the mean over its square",
                        shorten(&kind)
                    );
                    self.warnings.add_once("PixelFilter", warning);
                }
            }
            "Integrator" => self.integrator(place, file)?,
            "Film" => self.film(place, file)?,
            "Camera" => self.camera(place, file)?,
            "MakeNamedMedium" => {
                file.params(directive, place, &[])?;
                self.warn_of_media(place);
            }
            "MediumInterface" => {
                file.quoted("a medium's name")?;
                if matches!(file.peek()?.kind, Kind::Quoted(_)) {
                    file.quoted("a medium's name")?;
                }
                self.warn_of_media(place);
            }
            "Material" => {
                let (kind, params) =
                    file.params(directive, place, &self.state.defaults.material)?;
                self.state.surface = self.make_material(&kind, &params)?;
                params.finish(&mut self.warnings);
            }
            "MakeNamedMaterial" => self.make_named_material(place, file)?,
            "NamedMaterial" => {
                let name = file.quoted("a material's name")?;
                self.state.surface = self.named_material(&name, place)?;
            }
            "Texture" => self.make_texture(place, file)?,
            "AreaLightSource" => {
                let (kind, params) = file.params(directive, place, &self.state.defaults.light)?;
                if kind != "diffuse" {
                    return place.unsupported(format!(
                        "AreaLightSource \"{}\"; allowed: diffuse",
                        shorten(&kind)
                    ));
                }
                self.check_area_light(&params)?;
                params.finish(&mut self.warnings);
                self.state.area_light = Some(Rc::new(params));
            }
            "LightSource" => {
                let (kind, params) = file.params(directive, place, &self.state.defaults.light)?;
                self.make_light(&kind, &params)?;
                params.finish(&mut self.warnings);
            }
            "Shape" => {
                let (kind, params) = file.params(directive, place, &self.state.defaults.shape)?;
                self.make_shape(&kind, &params)?;
                params.finish(&mut self.warnings);
            }
            "ObjectBegin" => {
                let name = file.quoted("an object's name")?;
                if self.open_object.is_some() {
                    return place
                        .invalid("ObjectBegin inside an object; allowed: after its ObjectEnd");
                }
                self.open(Opened::Object, place)?;
                self.open_object =
                    Some(OpenObject { name, shapes: Vec::new(), moving: Vec::new() });
            }
            "ObjectEnd" => {
                self.close(Opened::Object, place)?;
                self.object_end();
            }
            "ObjectInstance" => {
                let name = file.quoted("an object's name")?;
                self.object_instance(&name, place)?;
            }
            other => {
                return place.syntax(format!(
                    "found {}; {}",
                    Kind::Word(other).describe(),
                    suggest(&shorten(other), &DIRECTIVES)
                ));
            }
        }
        Ok(())
    }

    /// Refuses directives on the wrong side of `WorldBegin`.
    fn check_section(&self, directive: &str, place: &Place) -> Result<()> {
        let before = matches!(
            directive,
            "Camera"
                | "Film"
                | "Sampler"
                | "Integrator"
                | "PixelFilter"
                | "Accelerator"
                | "TransformTimes"
                | "WorldBegin"
                | "Option"
        );
        let after = matches!(
            directive,
            "Shape"
                | "LightSource"
                | "AreaLightSource"
                | "ObjectBegin"
                | "ObjectEnd"
                | "ObjectInstance"
                | "Texture"
                | "Material"
                | "MakeNamedMaterial"
                | "NamedMaterial"
                | "ReverseOrientation"
        );
        if before && self.in_world {
            return place.syntax(format!("found {directive} after WorldBegin; allowed: before it"));
        }
        if after && !self.in_world {
            return place.syntax(format!("found {directive} before WorldBegin; allowed: after it"));
        }
        Ok(())
    }

    fn transform(&mut self, local: DAffine3) {
        self.set_transform(|end| end * local);
    }

    fn set_transform(&mut self, change: impl Fn(DAffine3) -> DAffine3) {
        for (end, active) in self.state.ctm.ends.iter_mut().zip(self.state.active) {
            if active {
                *end = change(*end);
            }
        }
    }

    fn open(&mut self, opened: Opened, place: &Place) -> Result<()> {
        if self.stack.len() >= MAX_ATTRIBUTE_DEPTH {
            return place.invalid(format!(
                "more than {MAX_ATTRIBUTE_DEPTH} nested attributes; allowed: as many"
            ));
        }
        self.stack.push((opened, self.state.clone(), place.clone()));
        Ok(())
    }

    fn close(&mut self, opened: Opened, place: &Place) -> Result<()> {
        match self.stack.last() {
            Some((kind, ..)) if *kind == opened => {}
            Some((kind, _, begin)) => {
                return place
                    .syntax(format!("found {opened:?}End; allowed: the {kind:?}End of {begin}"));
            }
            None => {
                return place.syntax(format!(
                    "found {opened:?}End without {opened:?}Begin; allowed: one for each"
                ));
            }
        }
        if let Some((_, saved, _)) = self.stack.pop() {
            if opened == Opened::Transform {
                self.state.ctm = saved.ctm;
                self.state.active = saved.active;
            } else {
                self.state = saved;
            }
        }
        Ok(())
    }

    fn attribute(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let (target, params) = file.param_list("Attribute")?;
        let defaults = &mut self.state.defaults;
        let list = match target.as_str() {
            "shape" => &mut defaults.shape,
            "light" => &mut defaults.light,
            "material" => &mut defaults.material,
            "texture" => &mut defaults.texture,
            "medium" => return Ok(()),
            other => {
                let known =
                    suggest(&shorten(other), &["shape", "light", "material", "medium", "texture"]);
                return place.syntax(format!("found Attribute \"{}\"; {known}", shorten(other)));
            }
        };
        for param in params {
            list.retain(|p| p.name != param.name);
            list.push(param);
        }
        Ok(())
    }

    fn include(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let name = file.quoted("a file name")?;
        let beside = place.path.parent().unwrap_or(Path::new("")).join(&name);
        let path = if beside.exists() { beside } else { self.folder.join(&name) };
        let same = |a: &Path, b: &Path| {
            a == b || matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
        };
        if self.files.iter().any(|open| same(open, &path)) {
            return place.invalid(format!(
                "\"{}\" includes itself; allowed: no circle of files",
                shorten(&name)
            ));
        }
        if self.files.len() >= MAX_INCLUDE_DEPTH {
            return place.invalid(format!(
                "more than {MAX_INCLUDE_DEPTH} files inside each other; allowed: as many"
            ));
        }
        let bytes = self.read_beside(&path, &name, place)?;
        let bytes = gunzip(&bytes).map_err(|e| e.with_path(&path))?.unwrap_or(bytes);
        let cost = (bytes.len() as u64).max(INCLUDE_BYTES);
        let Some(left) = self.included_bytes.checked_sub(cost) else {
            return place.invalid(format!(
                "the scene includes more than {MAX_INCLUDED_BYTES} bytes; allowed: as many, every file with at least {INCLUDE_BYTES}"
            ));
        };
        self.included_bytes = left;
        self.run(&bytes, Arc::from(path))
    }

    fn world_begin(&mut self) {
        self.in_world = true;
        self.state.ctm = Ctm::IDENTITY;
        self.state.active = [true; 2];
        self.coordinate_systems.insert("world".to_string(), Ctm::IDENTITY);
    }

    fn warn_of_media(&mut self, place: &Place) {
        self.warnings
            .add_once("media", format!("{place}: media are ignored: light passes them unchanged"));
    }

    /// A file that the scene refers to: beside the first file, as in pbrt, or else beside the file
    /// that names it.
    fn resolve(&self, name: &str, place: &Place) -> PathBuf {
        let first = self.folder.join(name);
        let beside = place.path.parent().unwrap_or(Path::new("")).join(name);
        if first.exists() || !beside.exists() { first } else { beside }
    }

    /// The bytes of `path`, called `name` in the scene at `place`.
    fn read_beside(&self, path: &Path, name: &str, place: &Place) -> Result<Vec<u8>> {
        read(path).map_err(|e| about_file(name, place, e))
    }

    fn object_end(&mut self) {
        if let Some(open) = self.open_object.take() {
            let mut parts = open.moving;
            if !open.shapes.is_empty() {
                let object =
                    self.scene.add_object(Object { name: open.name.clone(), shapes: open.shapes });
                parts.insert(0, Part { object, to_parent: Transform::IDENTITY });
            }
            self.objects.insert(open.name, parts);
        }
    }

    fn object_instance(&mut self, name: &str, place: &Place) -> Result<()> {
        if self.open_object.is_some() {
            return place.invalid("ObjectInstance inside an object; allowed: after its ObjectEnd");
        }
        let Some(parts) = self.objects.get(name).cloned() else {
            let known = list(name, self.objects.keys().map(String::as_str));
            return place.invalid(format!("no object \"{}\"; {known}", shorten(name)));
        };
        let placed = (self.scene.instances.len() + parts.len()) as u64;
        if placed * size_of::<Instance>() as u64 > MAX_INSTANCE_BYTES {
            return place.invalid(format!(
                "{placed} placed objects need more than {MAX_INSTANCE_BYTES} bytes; allowed: as many"
            ));
        }
        let to_world = self.current_transform(place)?;
        for part in parts {
            let key = self.take_key();
            self.scene.add_instance(part.object, concatenate(&to_world, &part.to_parent), key);
        }
        Ok(())
    }

    fn take_key(&mut self) -> u64 {
        self.next_key += 1;
        self.next_key - 1
    }

    /// The current transformation as a placement.
    fn current_transform(&self, place: &Place) -> Result<Transform> {
        self.placement(self.state.ctm, place)
    }

    fn placement(&self, ctm: Ctm, place: &Place) -> Result<Transform> {
        if !ctm.is_regular() {
            return place.invalid("the current transformation is singular or not finite; allowed: one that has an inverse");
        }
        match ctm.to_transform(self.times) {
            Some(transform) => Ok(transform),
            None => place.unsupported(
                "the start and the end of the motion differ in shear or handedness; allowed: translation, rotation, scale along the axes",
            ),
        }
    }

    fn finish(mut self) -> Result<Loaded> {
        if let Some((opened, _, place)) = self.stack.last() {
            return place.syntax(format!(
                "found {opened:?}Begin without {opened:?}End; allowed: one for each"
            ));
        }
        if !self.in_world {
            return Err(Error::syntax(
                "found the end of the file before WorldBegin; allowed: WorldBegin, then shapes and lights",
            ));
        }
        if !self.camera_seen {
            let file = self.path.display();
            self.warnings.add(format!("{file}: no Camera: at the origin, along +z, 90 degrees"));
        }
        if !self.shapes.is_empty() {
            let shapes = std::mem::take(&mut self.shapes);
            let object = self.scene.add_object(Object { name: String::new(), shapes });
            self.scene.add_instance(object, Transform::IDENTITY, 0);
        }
        if self.scene.moves() {
            self.scene.time = self.times.map(|t| t as f32);
        }
        if self.scene.lights.is_empty() && !emits(&self.scene) {
            let file = self.path.display();
            self.warnings.add(format!("{file}: no light; all is black"));
        }
        self.scene.validate()?;
        super::warn_of_geometry(&self.scene, self.warnings.about(&self.path));
        Ok(Loaded { scene: self.scene, warnings: self.warnings.into_vec(&self.path) })
    }
}

/// An error of the file called `name` in the scene at `place`, where both are named.
fn about_file(name: &str, place: &Place, error: Error) -> Error {
    let kind = if error.is_io() {
        ErrorKind::Io
    } else if error.is_unsupported() {
        ErrorKind::Unsupported
    } else if error.is_invalid() {
        ErrorKind::Invalid
    } else {
        ErrorKind::Syntax
    };
    place.put(Error::new(kind, format!("\"{}\": {error}", shorten(name))).with_source(error))
}

/// `outer` after `inner`, fixed where both are.
fn concatenate(outer: &Transform, inner: &Transform) -> Transform {
    use crate::scene::Track;
    let tracks = |t: &Transform| match t {
        Transform::Fixed(affine) => vec![Track::Fixed(*affine)],
        Transform::Chain(tracks) => tracks.clone(),
    };
    match (outer, inner) {
        (Transform::Fixed(a), Transform::Fixed(b)) => Transform::Fixed(*a * *b),
        _ => Transform::Chain([tracks(outer), tracks(inner)].concat()),
    }
}

/// "known: a, b", nearest first, at most a dozen.
fn list<'n>(given: &str, names: impl Iterator<Item = &'n str>) -> String {
    let mut names: Vec<&str> = names.collect();
    names.sort_unstable();
    names.truncate(1000);
    if names.is_empty() {
        return "known: none so far".to_string();
    }
    let known: Vec<String> = names.iter().map(|n| shorten(n)).collect();
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let text = suggest(&shorten(given), &known);
    match text.match_indices(", ").nth(11) {
        Some((end, _)) => format!("{}, …", &text[..end]),
        None => text,
    }
}

/// pbrt writes matrices transposed: the translation stands last.
fn matrix(m: [f64; 16], place: &Place) -> Result<DAffine3> {
    let columns = DMat4::from_cols_array(&m);
    let bottom = columns.row(3);
    if bottom != DVec4::W {
        return place.unsupported(format!(
            "the matrix's fourth column is {bottom}; allowed: 0 0 0 1 (an affine map)"
        ));
    }
    let columns =
        [columns.x_axis, columns.y_axis, columns.z_axis, columns.w_axis].map(|c| c.truncate());
    Ok(DAffine3::from_cols(columns[0], columns[1], columns[2], columns[3]))
}

/// World to camera.
fn look_at(numbers: [f64; 9], place: &Place) -> Result<DAffine3> {
    let [eye, target, up] =
        [0, 3, 6].map(|i| DVec3::new(numbers[i], numbers[i + 1], numbers[i + 2]));
    let frame = (target - eye).try_normalize().and_then(|forward| {
        // Left-handed: right = up × forward.
        let right = up.try_normalize()?.cross(forward);
        let right = if right.length() > 1e-10 { right.normalize() } else { return None };
        Some(DMat3::from_cols(right, forward.cross(right), forward))
    });
    match frame {
        Some(frame) => Ok(DAffine3::from_mat3_translation(frame, eye).inverse()),
        None => place.invalid("LookAt has no direction or an up vector along it; allowed: a target beside the eye, another up"),
    }
}

/// One file's tokens, with one of look-ahead.
struct File<'a> {
    lexer: Lexer<'a>,
    path: Arc<Path>,
    /// Of the first file.
    folder: PathBuf,
}

impl<'a> File<'a> {
    fn new(bytes: &'a [u8], path: Arc<Path>, folder: PathBuf) -> Result<Self> {
        Ok(Self { lexer: Lexer::new(bytes)?, path, folder })
    }

    fn place(&self, token: &Token<'_>) -> Place {
        Place { path: self.path.clone(), line: token.line, column: token.column }
    }

    fn next(&mut self) -> Result<Token<'a>> {
        self.lexer.next().map_err(|e| e.with_path(&self.path))
    }

    fn peek(&self) -> Result<Token<'a>> {
        self.lexer.clone().next().map_err(|e| e.with_path(&self.path))
    }

    /// A text in quotation marks.
    fn quoted(&mut self, what: &str) -> Result<String> {
        let token = self.next()?;
        match token.kind {
            Kind::Quoted(text) => Ok(unescape(text)),
            other => self
                .place(&token)
                .syntax(format!("found {}; allowed: {what} in quotation marks", other.describe())),
        }
    }

    /// Exactly N numbers.
    fn numbers<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for (i, value) in values.iter_mut().enumerate() {
            let token = self.next()?;
            let parsed = if let Kind::Word(word) = token.kind { number(word) } else { None };
            let Some(parsed) = parsed else {
                let message = format!(
                    "found {} as number {} of {N}; allowed: finite numbers",
                    token.kind.describe(),
                    i + 1
                );
                return self.place(&token).syntax(message);
            };
            *value = parsed;
        }
        Ok(values)
    }

    /// 16 numbers, in brackets or not.
    fn matrix(&mut self) -> Result<[f64; 16]> {
        let bracket = self.peek()?.kind == Kind::Open;
        if bracket {
            self.next()?;
        }
        let numbers = self.numbers()?;
        if bracket {
            let token = self.next()?;
            if token.kind != Kind::Close {
                let message =
                    format!("found {} after 16 numbers; allowed: `]`", token.kind.describe());
                return self.place(&token).syntax(message);
            }
        }
        Ok(numbers)
    }

    /// A quoted word and the parameters behind it.
    fn param_list(&mut self, directive: &str) -> Result<(String, Vec<Param>)> {
        let kind = self.quoted(&format!("the kind of {directive}"))?;
        let mut list = Vec::new();
        while let token @ Token { kind: Kind::Quoted(_), .. } = self.peek()? {
            self.next()?;
            let mut param = Param::parse(&mut self.lexer, token, &self.path)
                .map_err(|e| e.with_path(&self.path))?;
            self.read_spectrum(&mut param)?;
            list.push(param);
        }
        Ok((kind, list))
    }

    /// Puts the numbers of a file in the place of its name, where a spectrum is one: wavelengths
    /// and values, `#` before comments.
    fn read_spectrum(&self, param: &mut Param) -> Result<()> {
        let (Type::Spectrum, Values::Strings(names)) = (param.kind, &param.values) else {
            return Ok(());
        };
        let [name] = &names[..] else { return Ok(()) };
        let beside = self.path.parent().unwrap_or(Path::new(""));
        let known = ["glass-", "metal-", "stdillum-"].iter().any(|start| name.starts_with(start));
        let paths = [&*self.folder, beside].map(|folder| folder.join(name));
        let Some(path) = paths.iter().find(|path| !known && path.is_file()) else { return Ok(()) };
        let bytes = read(path).map_err(|e| about_file(name, &param.place, e))?;
        let text = String::from_utf8_lossy(&bytes);
        let lines = text.lines().filter_map(|line| line.split('#').next());
        let numbers: Option<Vec<f64>> = lines.flat_map(str::split_whitespace).map(number).collect();
        let Some(numbers) = numbers else {
            return param.place.invalid(format!(
                "\"{}\" holds more than numbers; allowed: wavelengths and values, comments after `#`",
                shorten(name)
            ));
        };
        param.values = Values::Numbers(numbers);
        Ok(())
    }

    /// A directive's kind and its parameters.
    fn params(
        &mut self,
        directive: &str,
        place: &Place,
        defaults: &[Param],
    ) -> Result<(String, Params)> {
        let (kind, list) = self.param_list(directive)?;
        let owner = format!("{directive} \"{}\"", shorten(&kind));
        Ok((kind, Params::new(owner, place.clone(), list, defaults)?))
    }
}

#[cfg(test)]
mod cases;
#[cfg(test)]
mod tests;
