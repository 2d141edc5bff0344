//! Does the key of a stored reference have everything that decides it, and is a stale one never
//! used in silence?

use std::fs;
use std::sync::Mutex;

use glam::{Affine2, Affine3A, Vec2, Vec3};

use super::*;
use crate::experiment::{Host, LookAt, SceneMotion, SessionSettings};
use crate::scene::{
    Camera, Color, EnvironmentMapping, Geometry, Image, ImageData, Light, LightKind, Material,
    Mesh, Object, Roughness, Scene, Shape, Texture, TextureKind, Transform, Wrap,
};
use crate::techniques::Moving;

/// Hears remarks.
#[derive(Clone, Debug, Default)]
struct Notes(Arc<Mutex<Vec<String>>>);

impl Host for Notes {
    fn note(&self, text: &str) {
        self.0.lock().unwrap().push(text.to_string());
    }
}

/// A cache of its own, in which references of 16 frames are made.
struct Place {
    settings: ReferenceSettings,
    notes: Notes,
}

impl Place {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir()
            .join(format!("afterimage-reference-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        let settings = ReferenceSettings { file: None, seconds: 9.0, cache: Some(folder) };
        Self { settings, notes: Notes::default() }
    }

    fn session(&self, scene: Scene, settings: &SessionSettings) -> Session {
        Session::with_host(scene, settings, Arc::new(self.notes.clone())).unwrap()
    }

    /// The reference, where it came from, and what was said.
    fn obtain(&self, session: &Session, spec: &str) -> (Reference, String, Vec<String>) {
        let technique = session::technique(spec).unwrap();
        let made = obtain(session, &self.settings, &technique, f64::INFINITY).unwrap();
        let notes = std::mem::take(&mut *self.notes.0.lock().unwrap());
        (made.reference, made.info.source, notes)
    }

    fn files(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(self.settings.cache.as_ref().unwrap()).unwrap();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(self.settings.cache.as_ref().unwrap());
    }
}

/// Something of everything: a textured mesh, a glossy ball, a lamp, a point light, a sky.
fn scene() -> Scene {
    let mut scene = Scene::new("everything");
    let image = Image { width: 2, height: 1, data: ImageData::Srgb8(vec![[9, 90, 200, 255]; 2]) };
    let image = scene.add_image(image);
    let kind = TextureKind::Image { image, wrap: Wrap::Repeat, scale: 1.0, invert: false };
    let texture = scene.add_texture(Texture { kind, mapping: Affine2::IDENTITY });
    let paint = scene.add_material(Material::Diffuse { reflectance: Color::Texture(texture) });
    let roughness = Roughness::isotropic(0.3);
    let gloss = scene.add_material(Material::Dielectric { eta: 1.5, roughness });
    let mesh = Mesh {
        positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
        normals: vec![Vec3::Z; 3],
        uvs: vec![Vec2::ZERO, Vec2::X, Vec2::Y],
        triangles: vec![[0, 1, 2]],
    };
    scene.add_shape(Shape::new(Geometry::Mesh(Arc::new(mesh)), paint));
    let ball = Geometry::Sphere { center: Vec3::new(0.5, 0.5, 0.4), radius: 0.2 };
    scene.add_shape(Shape::new(ball, gloss));
    let lamp = Geometry::Disk { center: Vec3::new(0.0, 0.0, 2.0), normal: -Vec3::Z, radius: 0.2 };
    scene.add_shape(Shape::new(lamp, paint).emitting(Vec3::splat(3.0)));
    let at = |place: Vec3| Transform::Fixed(Affine3A::from_translation(place));
    let point = LightKind::Point { intensity: Vec3::ONE };
    scene.lights.push(Light { to_world: at(Vec3::new(1.0, 1.0, 1.5)), kind: point, key: 0 });
    let sky = Image { width: 2, height: 2, data: ImageData::Float(vec![[0.5; 4]; 4]) };
    let sky = scene.add_image(sky);
    let kind = LightKind::Environment {
        radiance: Vec3::splat(0.2),
        image: Some((sky, EnvironmentMapping::LatitudeLongitude)),
    };
    scene.lights.push(Light { to_world: at(Vec3::ZERO), kind, key: 1 });
    // From above, looking down (camera space: x right, y up, z forward).
    let eye = Vec3::new(0.4, 0.4, 1.5);
    let down =
        Affine3A::from_cols(Vec3::X.into(), Vec3::NEG_Y.into(), Vec3::NEG_Z.into(), eye.into());
    scene.camera = Camera { to_world: Transform::Fixed(down), fov: 0.7 };
    scene
}

fn settings() -> SessionSettings {
    SessionSettings { size: Some([4, 3]), depth: Some(3), ..SessionSettings::default() }
}

/// The scene with a change to its mesh.
fn with_mesh(scene: &mut Scene, change: impl FnOnce(&mut Mesh)) {
    let object = &scene.objects[0];
    let mut shapes = object.shapes.clone();
    let Geometry::Mesh(mesh) = &shapes[0].geometry else { panic!("the first shape is a mesh") };
    let mut mesh = (**mesh).clone();
    change(&mut mesh);
    shapes[0].geometry = Geometry::Mesh(Arc::new(mesh));
    scene.objects[0] = Arc::new(Object { name: String::new(), shapes });
}

/// The scene with a change to the shape that is first in object `at`.
fn with_shape(scene: &mut Scene, at: usize, change: impl FnOnce(&mut Shape)) {
    let mut shapes = scene.objects[at].shapes.clone();
    change(&mut shapes[0]);
    scene.objects[at] = Arc::new(Object { name: String::new(), shapes });
}

fn nudged(to_world: &mut Transform) {
    *to_world = Transform::Fixed(Affine3A::from_translation(1e-3 * Vec3::X) * to_world.fixed());
}

/// What is changed, by name, and how.
type Change = (&'static str, fn(&mut Scene));

/// One change each, and what it changes.
const CHANGES: [Change; 20] = [
    ("where the camera is", |s| nudged(&mut s.camera.to_world)),
    ("the camera's angle", |s| s.camera.fov = s.camera.fov.next_up()),
    ("a lamp's emission", |s| {
        with_shape(s, 2, |shape| shape.emission.as_mut().unwrap().scale += 1e-3);
    }),
    ("a lamp's size", |s| {
        with_shape(s, 2, |shape| {
            let Geometry::Disk { radius, .. } = &mut shape.geometry else { panic!() };
            *radius = radius.next_up();
        });
    }),
    ("a surface's side", |s| with_shape(s, 0, |shape| shape.reverse_orientation = true)),
    ("a surface's material", |s| {
        let gloss = s.objects[1].shapes[0].material;
        with_shape(s, 0, |shape| shape.material = gloss);
    }),
    ("a ball's size", |s| {
        with_shape(s, 1, |shape| {
            let Geometry::Sphere { radius, .. } = &mut shape.geometry else { panic!() };
            *radius = radius.next_down();
        });
    }),
    ("a corner", |s| with_mesh(s, |mesh| mesh.positions[1].z = 1e-3)),
    ("a normal", |s| with_mesh(s, |mesh| mesh.normals[2] = Vec3::new(0.6, 0.0, 0.8))),
    ("a texture coordinate", |s| with_mesh(s, |mesh| mesh.uvs[0].x = 0.25)),
    ("a triangle", |s| with_mesh(s, |mesh| mesh.triangles[0] = [0, 2, 1])),
    ("where an instance is", |s| nudged(&mut s.instances[1].to_world)),
    ("a roughness", |s| {
        s.materials[1] = Material::Dielectric { eta: 1.5, roughness: Roughness::isotropic(0.31) };
    }),
    ("a texture's mapping", |s| s.textures[0].mapping = Affine2::from_scale(Vec2::new(2.0, 1.0))),
    ("a texel", |s| {
        let data = ImageData::Srgb8(vec![[9, 90, 200, 255], [9, 90, 201, 255]]);
        s.images[0] = Arc::new(Image { width: 2, height: 1, data });
    }),
    ("an image's shape", |s| {
        let data = s.images[0].data.clone();
        s.images[0] = Arc::new(Image { width: 1, height: 2, data });
    }),
    ("a point light's power", |s| {
        s.lights[0].kind = LightKind::Point { intensity: Vec3::new(1.0, 1.0, 1.0_f32.next_up()) };
    }),
    ("where a light is", |s| nudged(&mut s.lights[0].to_world)),
    ("the sky's radiance", |s| {
        let LightKind::Environment { radiance, .. } = &mut s.lights[1].kind else { panic!() };
        radiance.x = 0.3;
    }),
    ("the sky's image", |s| {
        let mut data = vec![[0.5; 4]; 4];
        data[3][2] = 0.6;
        s.images[1] = Arc::new(Image { width: 2, height: 2, data: ImageData::Float(data) });
    }),
];

#[test]
fn every_input_alone_asks_for_another_reference() {
    let place = Place::new("key");
    let base = place.session(scene(), &settings());
    assert_eq!(place.obtain(&base, "nee").1, "made");
    assert_eq!(place.obtain(&base, "nee").1, "cache");

    // What a reference does not depend on.
    let mut renamed = scene();
    (renamed.name, renamed.film, renamed.depth) = ("other".into(), [7, 7], 60);
    let same = [
        place.session(renamed, &settings()),
        place.session(scene(), &SessionSettings { seed: 9, ..settings() }),
        place.session(scene(), &SessionSettings { fps: 60, ..settings() }),
    ];
    for session in &same {
        assert_eq!(place.obtain(session, "nee").1, "cache");
    }

    let mut known = place.files().len();
    assert_eq!(known, 1);
    let mut is_new = |what: &str, session: &Session, spec: &str| {
        let (_, source, notes) = place.obtain(session, spec);
        known += 1;
        assert!(source == "made" && place.files().len() == known, "{what}: {source}");
        assert!(notes.is_empty(), "{what}: {notes:?}");
    };
    for (what, change) in CHANGES {
        let mut changed = scene();
        change(&mut changed);
        is_new(what, &place.session(changed, &settings()), "nee");
    }
    let eye = Vec3::new(0.4, 0.3, 1.5);
    let look_at = LookAt::new(eye, Vec3::new(0.4, 0.4, 0.0), Vec3::Y).unwrap();
    for (what, changed) in [
        ("size", SessionSettings { size: Some([3, 4]), ..settings() }),
        ("depth", SessionSettings { depth: Some(2), ..settings() }),
        ("filter", SessionSettings { filter: Filter::Box, ..settings() }),
        ("view", SessionSettings { look_at: Some(look_at), ..settings() }),
    ] {
        is_new(what, &place.session(scene(), &changed), "nee");
    }
    for spec in ["bsdf", "nee:lights=all"] {
        is_new(spec, &base, spec);
    }
    // Of a scene that moves, every frame has its own, and what moves decides.
    for moving in [Moving::Camera, Moving::Light, Moving::Occluder] {
        let motion = Some(SceneMotion::new(moving, None).unwrap());
        let session = place.session(scene(), &SessionSettings { motion, ..settings() });
        for frame in [3, 4] {
            is_new(&format!("{moving:?}, {frame}"), &session.frozen(frame).unwrap(), "nee");
        }
    }
}

#[test]
fn a_stale_reference_is_never_used_in_silence() {
    let place = Place::new("stale");
    let bright = place.session(scene(), &settings());
    let mut dimmed = scene();
    with_shape(&mut dimmed, 2, |shape| shape.emission.as_mut().unwrap().scale *= 0.5);
    let dim = place.session(dimmed, &settings());
    let (of_bright, ..) = place.obtain(&bright, "nee");
    let bright_file = place.files().remove(0);
    let (of_dim, ..) = place.obtain(&dim, "nee");
    let dim_file = place.files().into_iter().find(|file| *file != bright_file).unwrap();
    assert_ne!(of_bright.picture(), of_dim.picture());

    // Another scene's under this one's name; a damaged one; one cut short.
    let right = fs::read(&dim_file).unwrap();
    let wrong = fs::read(&bright_file).unwrap();
    let mut damaged = right.clone();
    damaged[right.len() / 2] ^= 4;
    for (bytes, why) in [
        (&wrong[..], "another scene"),
        (&damaged[..], "checksum"),
        (&right[..right.len() - 8], "checksum"),
        (&right[..20], "short"),
    ] {
        fs::write(&dim_file, bytes).unwrap();
        let (reference, source, notes) = place.obtain(&dim, "nee");
        assert_eq!((source.as_str(), &reference), ("made", &of_dim), "{why}");
        assert!(notes.len() == 1 && notes[0].contains(why), "{why}: {notes:?}");
    }

    // Sound, of the right key, and not what is rendered now: four times as bright.
    let key = dim.key(&format!("nee effort {EFFORT} images {IMAGES}"));
    let cache = ReferenceCache::new(place.settings.cache.clone().unwrap());
    assert_eq!(cache.path(key), dim_file);
    let mut stale = Reference::new([4, 3]);
    for at in 0..32 {
        let mut picture = of_dim.picture();
        let gain = if at % 2 == 0 { 3.9 } else { 4.1 };
        picture.pixels.iter_mut().for_each(|pixel| *pixel *= gain);
        stale.add(&picture);
    }
    cache.store(key, &stale).unwrap();
    let (reference, source, notes) = place.obtain(&dim, "nee");
    assert_eq!((source.as_str(), &reference), ("made", &of_dim));
    assert!(notes.len() == 1 && notes[0].contains("differs"), "{notes:?}");
}

/// A reference that is continued gets frames of its own: the 17th and the 18th, each from a session
/// of its own, are not the same.
#[test]
fn a_continued_reference_is_not_the_same_frames_again() {
    let mut place = Place::new("continued");
    let settings = SessionSettings { size: Some([8, 8]), ..SessionSettings::default() };
    let session = place.session(scene(), &settings);
    place.settings.seconds = 0.0;
    let technique = session::technique("nee").unwrap();
    let next = || obtain(&session, &place.settings, &technique, 0.0).unwrap();
    let made = [next(), next(), next()];
    let sources = made.each_ref().map(|made| made.info.source.as_str());
    assert_eq!(sources, ["made", "cache, continued", "cache, continued"]);
    let [a, b, c] = made.map(|made| (made.reference.frames() as f32, made.reference.picture()));
    assert_eq!([a.0, b.0, c.0], [16.0, 17.0, 18.0]);
    let (mut differ, mut all) = (0, 0);
    for ((a, b), c) in a.1.pixels.iter().zip(&b.1.pixels).zip(&c.1.pixels) {
        let frames = [17.0 * *b - 16.0 * *a, 18.0 * *c - 17.0 * *b];
        let rounding = 1e-4 * c.max_element();
        differ += u32::from((frames[0] - frames[1]).abs().max_element() > rounding);
        all += u32::from(c.max_element() > 0.0);
    }
    assert!(all > 30 && 2 * differ > all, "{differ} of {all} pixels differ");
}
