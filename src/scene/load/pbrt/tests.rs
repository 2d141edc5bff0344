//! Small scenes as text, and the shared ones.

use glam::{Quat, Vec2, Vec3, Vec4};

use super::*;
use crate::scene::{
    Camera, Channel, Color, ConductorColor, EnvironmentMapping, Geometry, Image, ImageData,
    LightKind, Material, Mesh, Scalar, TextureKind, Wrap,
};

pub(super) fn load_text(text: &str) -> Result<Loaded> {
    from_bytes(text.as_bytes(), Path::new("scene.pbrt"))
}

#[test]
fn shared_scenes_have_the_shapes_and_triangles_of_their_notes() {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
    if !shared.exists() {
        println!("skipped: no {}", shared.display());
        return;
    }
    // Folder, shapes, triangles, analytic shapes, emitting shapes, film, depth.
    let scenes = [
        ("cornell-box", 8, 36, 0, 1, [1024, 1024], 66),
        ("living-room", 65, 143_163, 0, 0, [1280, 720], 66),
        ("veach-ajar", 22, 382_690, 0, 1, [1280, 720], 14),
        ("veach-bidir", 14, 11_544, 0, 2, [1024, 1024], 8),
        ("veach-mis", 9, 52, 3, 3, [1280, 720], 4),
        ("water-caustic", 10, 103_487, 0, 1, [1024, 1024], 10),
    ];
    for (name, shapes, triangles, analytic, emitters, film, depth) in scenes {
        let start = std::time::Instant::now();
        let loaded = load(&shared.join(name).join("scene.pbrt")).unwrap();
        let seconds = start.elapsed().as_secs_f32();
        let scene = loaded.scene;
        println!("{name}: {seconds} s, {:?}", loaded.warnings);
        let all: Vec<&Shape> = scene.objects.iter().flat_map(|o| &o.shapes).collect();
        let count =
            |g: &Geometry| if let Geometry::Mesh(mesh) = g { mesh.triangles.len() } else { 0 };
        assert_eq!(all.len(), shapes, "{name}");
        assert_eq!(all.iter().map(|s| count(&s.geometry)).sum::<usize>(), triangles, "{name}");
        assert_eq!(all.iter().filter(|s| count(&s.geometry) == 0).count(), analytic, "{name}");
        assert_eq!(all.iter().filter(|s| s.emission.is_some()).count(), emitters, "{name}");
        assert_eq!((scene.film, scene.depth, scene.name.as_str()), (film, depth, name));
        assert_eq!(scene.instances.len(), 1);
        // Only what these files are known to hold is warned of.
        assert!(
            loaded.warnings.iter().all(|w| w.contains("PixelFilter")),
            "{name}: {:?}",
            loaded.warnings
        );
    }
}

/// A scene of these directives after `WorldBegin`, with whatever it warned of but the dark.
pub(super) fn world(text: &str) -> (Scene, Vec<String>) {
    let mut loaded = load_text(&format!("Camera \"perspective\"\nWorldBegin\n{text}"))
        .unwrap_or_else(|e| panic!("{e}\n{text}"));
    loaded.warnings.retain(|warning| warning != DARK);
    (loaded.scene, loaded.warnings)
}

pub(super) const DARK: &str = "scene.pbrt: no light; all is black";

/// As [`world`], of a text that warns of nothing.
pub(super) fn quiet(text: &str) -> Scene {
    let (scene, warnings) = world(text);
    assert!(warnings.is_empty(), "{warnings:?}");
    scene
}

/// The message about a text whose first line is number 1.
pub(super) fn refusal(text: &str) -> String {
    // The prologue stands on the same line, in front.
    let error = load_text(&format!("WorldBegin {text}")).expect_err("is refused");
    error.to_string()
}

fn material(text: &str) -> Material {
    quiet(&format!("Material {text}")).materials[0]
}

pub(super) const TRIANGLE: &str = "Shape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ]\n";

pub(super) fn mesh(shape: &Shape) -> &Mesh {
    match &shape.geometry {
        Geometry::Mesh(mesh) => mesh,
        other => panic!("{other:?} is no mesh"),
    }
}

/// pbrt's normal of the first triangle.
fn normal(shape: &Shape) -> Vec3 {
    let mesh = mesh(shape);
    let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
    let n = (b - a).cross(c - a).normalize();
    if shape.reverse_orientation { -n } else { n }
}

fn close(a: Vec3, b: Vec3) -> bool {
    (a - b).abs().max_element() < 1e-5
}

#[test]
fn refusals_name_place_finding_and_what_is_allowed() {
    let cases = [
        ("\n  Shapes \"sphere\"", "scene.pbrt:2:3: found `Shapes`; known: Shape, Scale, "),
        ("\n[", "scene.pbrt:2:1: found `[`; allowed: a directive such as Shape"),
        (
            "\nTranslate 1 x 2",
            "scene.pbrt:2:13: found `x` as number 2 of 3; allowed: finite numbers",
        ),
        ("\nTranslate 1 2", "scene.pbrt:2:14: found the end of the file as number 3 of 3"),
        (
            "\nTransform [ 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2 ]",
            "scene.pbrt:2:1: the matrix's fourth column is [0, 0, 0, 2]",
        ),
        (
            "\nTransform [ 1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1 1",
            "scene.pbrt:2:45: found `1` after 16 numbers; allowed: `]`",
        ),
        ("\nRotate 3 0 0 0", "scene.pbrt:2:1: the axis of Rotate is 0 0 0"),
        ("\nLookAt 0 0 0 0 0 1 0 0 2", "scene.pbrt:2:1: LookAt has no direction"),
        ("\nAttributeEnd", "scene.pbrt:2:1: found AttributeEnd without AttributeBegin"),
        (
            "\nAttributeBegin\nTransformEnd",
            "scene.pbrt:3:1: found TransformEnd; allowed: the AttributeEnd of scene.pbrt:2:1",
        ),
        ("\n AttributeBegin", "scene.pbrt:2:2: found AttributeBegin without AttributeEnd"),
        (
            "\nActiveTransform Start",
            "scene.pbrt:2:17: found `Start`; allowed: StartTime, EndTime, All",
        ),
        (
            "\nCoordSysTransform \"cam\"",
            "scene.pbrt:2:1: no coordinate system \"cam\"; known: world",
        ),
        (
            "\nCamera \"perspective\"",
            "scene.pbrt:2:1: found Camera after WorldBegin; allowed: before it",
        ),
        ("\nShape \"cube\"", "scene.pbrt:2:1: Shape \"cube\"; known: "),
        (
            "\nShape \"sphere\" \"float radius\" \"1\"",
            "scene.pbrt:2:31: found \"1\" as a value of `float radius`; allowed: numbers",
        ),
        (
            "\nShape \"sphere\" \"float radius\" [ 1",
            "scene.pbrt:2:34: found the end of the file; allowed: a value of `radius`, or `]`",
        ),
        (
            "\nShape \"sphere\" \"float radius\" ]",
            "scene.pbrt:2:31: found `]`; allowed: a value of `radius`, or `[`",
        ),
        (
            "\nShape \"sphere\" \"float radius\" [ 1 2 ]",
            "scene.pbrt:2:16: `radius` has 2 values; allowed: one",
        ),
        (
            "\nShape \"sphere\" \"integer radius\" 1",
            "scene.pbrt:2:16: `radius` of Shape \"sphere\" is a `integer`; allowed: float",
        ),
        (
            "\nShape \"sphere\" \"flaot radius\" 1",
            "scene.pbrt:2:16: found the parameter type `flaot`; known: float, ",
        ),
        (
            "\nShape \"sphere\" \"radius\" 1",
            "scene.pbrt:2:16: found \"radius\"; allowed: \"type name\"",
        ),
        (
            "\nShape \"sphere\" \"float radius\" 1 \"float radius\" 2",
            "scene.pbrt:2:33: `radius` is given twice; allowed: once",
        ),
        (
            "\nShape \"sphere\" \"float radius\" -1",
            "scene.pbrt:2:16: `radius` is -1; allowed: more than 0",
        ),
        (
            "\nShape \"sphere\" \"float zmin\" 0.5",
            "scene.pbrt:2:16: a sphere cut at `zmin` 0.5; allowed: a full one",
        ),
        (
            "\nShape \"sphere\" \"float phimax\" 180",
            "scene.pbrt:2:16: `phimax` is 180; allowed: 360, the full turn",
        ),
        (
            "\nShape \"disk\" \"float innerradius\" 1",
            "scene.pbrt:2:14: `innerradius` is 1; allowed: from 0 to below `radius`, 1",
        ),
        ("\nShape \"trianglemesh\"", "scene.pbrt:2:1: a trianglemesh without `P`"),
        (
            "\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 ]",
            "scene.pbrt:2:22: `P` has 4 numbers; allowed: a multiple of 3",
        ),
        (
            "\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 1 1 ]",
            "scene.pbrt:2:1: Shape \"trianglemesh\" has 2 vertices and no `indices`",
        ),
        (
            "\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 1 1 1 0 0 ]\n\"integer indices\" [ 0 1 3 ]",
            "scene.pbrt:3:1: `indices` holds 3; allowed: 0 to 2 (3 vertices)",
        ),
        (
            "\nShape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 1 1 1 0 0 ]\n\"normal N\" [ 0 0 1 ]",
            "scene.pbrt:3:1: `N` has 1 values; allowed: one for each of 3 vertices",
        ),
        (
            "\nShape \"plymesh\" \"string filename\" \"none.ply\"",
            "scene.pbrt:2:17: \"none.ply\": none.ply: no such file",
        ),
        ("\nInclude \"none.pbrt\"", "scene.pbrt:2:1: \"none.pbrt\": none.pbrt: no such file"),
        (
            "\nScale 1 0 1 Shape \"sphere\"",
            "scene.pbrt:2:13: the current transformation is singular",
        ),
        ("\nMaterial \"glas\"", "scene.pbrt:2:1: material \"glas\"; known: "),
        (
            "\nMaterial \"glass\"",
            "scene.pbrt:2:1: material \"glass\" is pbrt-v3; allowed: pbrt-v4 (",
        ),
        (
            "\nMaterial \"diffuse\" \"rgb reflectance\" [ 0 2 0 ]",
            "scene.pbrt:2:20: `reflectance` is [0, 2, 0]; allowed in each channel: 0 to 1",
        ),
        (
            "\nMaterial \"diffuse\" \"texture reflectance\" \"a\"",
            "scene.pbrt:2:20: no spectrum texture \"a\"; known: none so far",
        ),
        (
            "\nMaterial \"conductor\" \"spectrum eta\" \"metal-Au-k2\"",
            "scene.pbrt:2:22: `eta` names the spectrum \"metal-Au-k2\"; known: metal-Au-k",
        ),
        (
            "\nMaterial \"conductor\" \"float roughness\" 2",
            "scene.pbrt:2:22: `roughness` is 2; allowed: 0 to 1",
        ),
        (
            "\nMaterial \"dielectric\" \"float eta\" 0",
            "scene.pbrt:2:23: `eta` is 0; allowed: more than 0",
        ),
        ("\nNamedMaterial \"x\"", "scene.pbrt:2:1: no material \"x\" so far; known: none so far"),
        ("\nMakeNamedMaterial \"x\"", "scene.pbrt:2:1: material \"x\" has no `type`; known: "),
        ("\nMaterial \"mix\"", "scene.pbrt:2:1: mix without two `materials`"),
        (
            "\nTexture \"a\" \"color\" \"constant\"",
            "scene.pbrt:2:1: found the texture type \"color\"; allowed: float, spectrum",
        ),
        (
            "\nTexture \"a\" \"float\" \"wrinkled\"",
            "scene.pbrt:2:1: Texture class \"wrinkled\"; known: ",
        ),
        (
            "\nTexture \"a\" \"float\" \"imagemap\"",
            "scene.pbrt:2:1: an imagemap without `filename`",
        ),
        (
            "\nTexture \"a\" \"float\" \"checkerboard\" \"string mapping\" \"planar\"",
            "scene.pbrt:2:36: `mapping` is \"planar\"; known: uv",
        ),
        (
            "\nTexture \"a\" \"float\" \"checkerboard\" \"integer dimension\" 3",
            "scene.pbrt:2:36: `dimension` is 3; allowed: 2",
        ),
        ("\nLightSource \"goniometric\"", "scene.pbrt:2:1: LightSource \"goniometric\"; known: "),
        (
            "\nLightSource \"point\" \"rgb I\" [ 1 -1 0 ]",
            "scene.pbrt:2:21: `I` is [1, -1, 0]; allowed in each channel: 0 or more",
        ),
        ("\nLightSource \"spot\" \"float coneangle\" 0", "scene.pbrt:2:20: `coneangle` is 0"),
        (
            "\nLightSource \"distant\" \"point3 from\" [ 0 0 1 ]",
            "scene.pbrt:2:1: `from` and `to` are both [0, 0, 1]",
        ),
        (
            "\nLightSource \"infinite\" \"point3 portal\" [ 0 0 1 ]",
            "scene.pbrt:2:24: `portal` of an infinite light; allowed: none",
        ),
        (
            "\nAreaLightSource \"sphere\"",
            "scene.pbrt:2:1: AreaLightSource \"sphere\"; allowed: diffuse",
        ),
        (
            "\nAreaLightSource \"diffuse\" \"float power\" 1",
            "scene.pbrt:2:27: `power` of an area light; allowed: `L` and `scale`",
        ),
        (
            "\nAreaLightSource \"diffuse\" \"blackbody L\" 0",
            "scene.pbrt:2:27: `L` is 0 kelvin; allowed: more than 0",
        ),
        ("\nObjectInstance \"a\"", "scene.pbrt:2:1: no object \"a\"; known: none so far"),
        ("\nObjectBegin \"a\" ObjectBegin \"b\"", "scene.pbrt:2:17: ObjectBegin inside an object"),
        ("\nAttribute \"shapes\"", "scene.pbrt:2:1: found Attribute \"shapes\"; known: shape, "),
        (
            "\nMediumInterface 1",
            "scene.pbrt:2:17: found `1`; allowed: a medium's name in quotation marks",
        ),
    ];
    let wrong: Vec<String> = cases
        .iter()
        .map(|(text, expected)| (refusal(text), expected))
        .filter(|(message, expected)| !message.starts_with(**expected))
        .map(|(message, expected)| format!("found    {message}\nexpected {expected}"))
        .collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn refusals_before_the_world() {
    let cases = [
        ("", "scene.pbrt: found the end of the file before WorldBegin"),
        ("Shape \"sphere\"", "scene.pbrt:1:1: found Shape before WorldBegin; allowed: after it"),
        (
            "Camera \"orthographic\"",
            "scene.pbrt:1:1: Camera \"orthographic\"; allowed: perspective",
        ),
        (
            "Camera \"perspective\" \"float fov\" 180",
            "scene.pbrt:1:22: `fov` is 180; allowed: degrees between 0 and 180",
        ),
        (
            "Camera \"perspective\" \"float screenwindow\" [ 0 1 0 1 ]",
            "scene.pbrt:1:22: `screenwindow` is [0.0, 1.0, 0.0, 1.0]",
        ),
        (
            "Camera \"perspective\" \"float frameaspectratio\" 1",
            "scene.pbrt:1:22: `frameaspectratio` is 1",
        ),
        (
            "Scale 1 2 1 Camera \"perspective\"",
            "scene.pbrt:1:13: the camera's transformation shears or stretches",
        ),
        (
            "Scale 1 0 1 Camera \"perspective\"",
            "scene.pbrt:1:13: the camera's transformation is singular",
        ),
        (
            "Film \"rgb\" \"integer xresolution\" 0",
            "scene.pbrt:1:12: `xresolution` is 0; allowed: more than 0",
        ),
        (
            "Film \"rgb\" \"integer xresolution\" 1.5",
            "scene.pbrt:1:34: found `1.5` as a value of `integer xresolution`",
        ),
        (
            "Integrator \"path\" \"integer maxdepth\" -1",
            "scene.pbrt:1:19: `maxdepth` is -1; allowed: 0 or more",
        ),
        (
            "TransformTimes 1 1",
            "scene.pbrt:1:1: TransformTimes 1 1; allowed: a start before the end",
        ),
    ];
    for (text, expected) in cases {
        let message = load_text(text).expect_err("is refused").to_string();
        assert!(message.starts_with(expected), "found    {message}\nexpected {expected}");
    }
}

#[test]
fn camera_film_and_depth() {
    let text = "Film \"rgb\" \"integer xresolution\" 80 \"integer yresolution\" [ 20 ]\nIntegrator \"volpath\" \"integer maxdepth\" 3\n\
        LookAt 1 2 3  1 2 8  0 1 0\nCamera \"perspective\" \"float fov\" 60\nWorldBegin";
    let loaded = load_text(text).unwrap();
    assert_eq!(loaded.warnings, [DARK]);
    let scene = loaded.scene;
    assert_eq!((scene.film, scene.depth, scene.name.as_str()), ([80, 20], 4, "scene"));
    // Left-handed: the right of the picture is +x when looking along +z with y up.
    let ray = scene.camera.rays(scene.film).ray(Vec2::new(79.5, 10.0));
    assert!(close(ray.origin, Vec3::new(1.0, 2.0, 3.0)) && ray.direction.x > 0.5, "{ray:?}");
    let top = scene.camera.rays(scene.film).ray(Vec2::new(40.0, 0.0)).direction;
    assert!(
        (top.y / top.z - 30.0_f32.to_radians().tan()).abs() < 1e-6,
        "the angle spans the shorter side: {top}"
    );

    let defaults = load_text("WorldBegin").unwrap();
    assert_eq!(
        defaults.warnings,
        ["scene.pbrt: no Camera: at the origin, along +z, 90 degrees", DARK]
    );
    assert_eq!((defaults.scene.film, defaults.scene.depth), ([1280, 720], 6));
    let Camera { fov, .. } = defaults.scene.camera;
    assert_eq!(fov, std::f32::consts::FRAC_PI_2);

    // A uniform scale changes nothing; half of the window is half of the tangent.
    let zoomed = "Film \"rgb\" \"integer xresolution\" 20 \"integer yresolution\" 20\nScale -2 2 2\n\
        Camera \"perspective\" \"float screenwindow\" [ -.5 .5 -.5 .5 ]\nWorldBegin";
    let camera = load_text(zoomed).unwrap().scene.camera;
    assert!((camera.fov - 2.0 * 0.5_f32.atan()).abs() < 1e-6, "{}", camera.fov);
    assert!(camera.to_world.at(0.0).matrix3.x_axis.x == -1.0);
}

#[test]
fn transformations_act_in_the_order_of_the_text() {
    let positions = |text: &str| {
        let scene = quiet(&format!("{text}\n{TRIANGLE}"));
        let mesh = mesh(&scene.objects[0].shapes[0]).clone();
        mesh.positions[1]
    };
    assert!(close(positions("Translate 1 2 3"), Vec3::new(2.0, 2.0, 3.0)));
    assert!(close(positions("Translate 1 0 0 Scale 2 2 2"), Vec3::new(3.0, 0.0, 0.0)));
    assert!(close(positions("Rotate 90 0 0 1"), Vec3::Y));
    assert!(close(positions("Translate 5 5 5 Identity"), Vec3::X));
    // Column by column: x goes to y.
    assert!(close(
        positions("Translate 9 9 9 Transform [ 0 1 0 0 -1 0 0 0 0 0 1 0 1 2 3 1 ]"),
        Vec3::new(1.0, 3.0, 3.0)
    ));
    assert!(close(
        positions("Translate 1 0 0 ConcatTransform [ 0 1 0 0 -1 0 0 0 0 0 1 0 0 0 0 1 ]"),
        Vec3::new(1.0, 1.0, 0.0)
    ));
    assert!(close(
        positions("Translate 1 0 0 CoordinateSystem \"a\" Identity CoordSysTransform \"a\""),
        Vec3::new(2.0, 0.0, 0.0)
    ));
    assert!(close(positions("AttributeBegin Translate 1 0 0 AttributeEnd"), Vec3::X));
    assert!(close(positions("TransformBegin Translate 1 0 0 TransformEnd"), Vec3::X));
    assert!(close(positions("LookAt 0 0 -5 0 0 0 0 1 0"), Vec3::new(1.0, 0.0, 5.0)));
    let loaded = load_text(&format!(
        "Translate 0 0 4 Camera \"perspective\" WorldBegin CoordSysTransform \"camera\" {TRIANGLE}"
    ))
    .unwrap();
    assert!(
        close(mesh(&loaded.scene.objects[0].shapes[0]).positions[0], Vec3::new(0.0, 0.0, -4.0)),
        "the world starts at the camera's space"
    );
}

#[test]
fn normals_follow_reverse_orientation_and_mirrors() {
    let find = |text: &str| normal(&quiet(&format!("{text}\n{TRIANGLE}")).objects[0].shapes[0]);
    assert!(close(find(""), Vec3::Z));
    assert!(close(find("ReverseOrientation"), -Vec3::Z));
    assert!(close(find("ReverseOrientation ReverseOrientation"), Vec3::Z));
    assert!(close(find("Scale -1 1 1"), Vec3::Z), "a mirror along the face leaves its normal");
    assert!(close(find("Scale 1 1 -1"), -Vec3::Z), "a mirror along the normal turns it");
    assert!(close(find("Scale 1 1 -1 ReverseOrientation"), Vec3::Z));

    let text = "Shape \"trianglemesh\" \"point3 P\" [ 0 0 0 1 0 0 0 1 0 ] \"normal N\" [ 0 0 2 0 1 1 0 0 1 ]";
    let stored = |prefix: &str| {
        mesh(&quiet(&format!("{prefix} {text}")).objects[0].shapes[0]).normals.clone()
    };
    assert_eq!(stored("")[0], Vec3::Z);
    assert_eq!(stored("ReverseOrientation")[0], -Vec3::Z);
    // Inverse transpose: stretching along z flattens normals in z.
    assert!(close(stored("Scale 1 1 2")[1], Vec3::new(0.0, 1.0, 0.5).normalize()));

    let sphere = quiet("ReverseOrientation Scale -1 1 1 Shape \"sphere\"");
    assert!(
        sphere.objects[0].shapes[0].reverse_orientation,
        "a sphere's normal is turned by ReverseOrientation alone"
    );
}

#[test]
fn spheres_and_disks() {
    let scene = quiet(
        "Translate 1 2 3 Rotate 90 1 0 0 Scale 2 2 -2 Shape \"sphere\" \"float radius\" 3 Shape \"disk\" \"float height\" 1",
    );
    let [sphere, disk] = &scene.objects[0].shapes[..] else { panic!("two shapes") };
    assert!(
        matches!(sphere.geometry, Geometry::Sphere { center, radius } if close(center, Vec3::new(1.0, 2.0, 3.0)) && radius == 6.0)
    );
    // z goes to −2 z, then to the other side by the turn: (x, y, z) → (x, −z, y).
    let Geometry::Disk { center, normal: axis, radius } = disk.geometry else { panic!("{disk:?}") };
    assert!(
        close(center, Vec3::new(1.0, 4.0, 3.0))
            && close(axis, Vec3::Y)
            && (radius - 2.0).abs() < 1e-6,
        "{disk:?}"
    );

    let (scene, warnings) = world("Scale 1 2 3 Shape \"sphere\"");
    assert!(
        warnings[0].contains(
            "Shape \"sphere\" is stretched by its transformation: triangles take its place"
        ),
        "{warnings:?}"
    );
    let ellipsoid = mesh(&scene.objects[0].shapes[0]);
    for (p, n) in ellipsoid.positions.iter().zip(&ellipsoid.normals) {
        let radial = *p / Vec3::new(1.0, 2.0, 3.0);
        assert!(
            (radial.length() - 1.0).abs() < 1e-5
                && close((radial / Vec3::new(1.0, 2.0, 3.0)).normalize(), *n)
        );
    }
    for t in &ellipsoid.triangles {
        let [a, b, c] = t.map(|i| ellipsoid.positions[i as usize]);
        assert!((b - a).cross(c - a).dot(a + b + c) > 0.0, "faces look outward");
    }
    let area = |mesh: &Mesh| {
        mesh.triangles
            .iter()
            .map(|t| t.map(|i| mesh.positions[i as usize]))
            .map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0)
            .sum::<f32>()
    };
    let (scene, _) = world("Scale 1 3 1 Shape \"disk\"");
    let disk = &scene.objects[0].shapes[0];
    assert!(
        close(normal(disk), Vec3::Z)
            && (area(mesh(disk)) / (3.0 * std::f32::consts::PI) - 1.0).abs() < 1e-3
    );
}

#[test]
fn flat_bilinear_patches_become_triangles() {
    let (scene, warnings) =
        world("Shape \"bilinearmesh\" \"point3 P\" [ 0 0 0 2 0 0 0 1 0 2 1 0 ]");
    assert_eq!(warnings.len(), 1);
    let shape = &scene.objects[0].shapes[0];
    assert_eq!((mesh(shape).triangles.len(), normal(shape)), (2, Vec3::Z));
    assert_eq!(mesh(shape).uvs, [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE]);
    let message = refusal("\nShape \"bilinearmesh\" \"point3 P\" [ 0 0 0 2 0 0 0 1 0 2 1 1 ]");
    assert!(message.starts_with("scene.pbrt:2:1: a curved patch of a bilinearmesh"), "{message}");
}

#[test]
fn materials() {
    assert!(
        matches!(material("\"diffuse\""), Material::Diffuse { reflectance: Color::Constant(c) } if c == Vec3::splat(0.5))
    );
    assert!(matches!(
        material("\"diffusetransmission\" \"rgb reflectance\" [ .5 .5 1 ] \"float scale\" .5"),
        Material::DiffuseTransmission { reflectance: Color::Constant(r), transmittance: Color::Constant(t) }
            if r == Vec3::new(0.25, 0.25, 0.5) && t == Vec3::splat(0.125)
    ));
    let conductor = material(
        "\"conductor\" \"spectrum eta\" \"metal-Ag-eta\" \"spectrum k\" \"metal-Ag-k\" \"float uroughness\" .1",
    );
    let Material::Conductor {
        color: ConductorColor::Complex { eta: Color::Constant(eta), k: Color::Constant(k) },
        roughness,
    } = conductor
    else {
        panic!("{conductor:?}")
    };
    assert_eq!((eta, k), (Vec3::new(0.155, 0.117, 0.138), Vec3::new(4.83, 3.12, 2.15)));
    assert!(
        matches!((roughness.u, roughness.v, roughness.remap), (Scalar::Constant(u), Scalar::Constant(v), true) if u == 0.1 && v == 0.0)
    );
    let reflectance = material(
        "\"conductor\" \"rgb reflectance\" [ .1 .2 .3 ] \"float roughness\" .2 \"bool remaproughness\" false",
    );
    assert!(matches!(
        reflectance,
        Material::Conductor { color: ConductorColor::Reflectance(Color::Constant(c)), roughness }
            if c == Vec3::new(0.1, 0.2, 0.3) && !roughness.remap && matches!(roughness.v, Scalar::Constant(v) if v == 0.2)
    ));
    assert!(matches!(
        material("\"conductor\""),
        Material::Conductor { color: ConductorColor::Complex { .. }, .. }
    ));
    assert!(
        matches!(material("\"dielectric\" \"float eta\" 1.33"), Material::Dielectric { eta, .. } if eta == 1.33)
    );
    assert!(
        matches!(material("\"thindielectric\""), Material::ThinDielectric { eta } if eta == 1.5)
    );
    assert!(
        matches!(material("\"coateddiffuse\""), Material::CoatedDiffuse { eta, .. } if eta == 1.5)
    );

    let (scene, warnings) = world("Material \"dielectric\" \"spectrum eta\" [ 500 1.5 600 1.6 ]");
    assert!(warnings[0].contains("there is no dispersion"), "{warnings:?}");
    assert!(
        matches!(scene.materials[0], Material::Dielectric { eta, .. } if (eta - 1.5876).abs() < 1e-6)
    );

    let text = "MakeNamedMaterial \"a\" \"string type\" \"diffuse\" MakeNamedMaterial \"b\" \"string type\" [ \"conductor\" ] \
        Material \"mix\" \"string materials\" [ \"a\" \"b\" ] \"float amount\" .25";
    let scene = quiet(&format!("{text} {TRIANGLE}"));
    assert!(matches!(
        scene.materials[2],
        Material::Mix { first: MaterialId(0), second: MaterialId(1), amount: Scalar::Constant(a) } if a == 0.25
    ));
    assert_eq!(scene.objects[0].shapes[0].material, MaterialId(2));
}

#[test]
fn an_interface_has_no_surface() {
    let scene = quiet(&format!("Material \"interface\" {TRIANGLE}"));
    assert!(scene.objects.is_empty() && scene.instances.is_empty());
    let (scene, warnings) =
        world(&format!("Material \"interface\" AreaLightSource \"diffuse\" {TRIANGLE}"));
    assert!(
        scene.objects.is_empty() && warnings[0].contains("the area light is ignored"),
        "{warnings:?}"
    );
}

#[test]
fn warnings_name_the_place_and_are_given_once() {
    let (_, warnings) = world(
        "Shape \"sphere\" \"float radios\" 1\nMakeNamedMedium \"m\"\nMediumInterface \"m\" \"\"\nMediumInterface \"\"",
    );
    assert_eq!(
        warnings,
        [
            "scene.pbrt:3:16: unknown parameter `radios` of Shape \"sphere\" is ignored; known: radius, zmin, alpha, zmax, phimax, \
             displacement, displacement.uvscale, displacement.edgelength"
                .to_string(),
            "scene.pbrt:4:1: media are ignored: light passes them unchanged".to_string(),
        ]
    );
    let (_, warnings) = world("Material \"diffuse\" \"string normalmap\" \"a.png\"");
    assert!(
        warnings[0]
            .contains("`normalmap` of Material \"diffuse\" is ignored: the surface stays smooth"),
        "{warnings:?}"
    );
}

#[test]
fn attribute_defaults_reach_the_directives_that_know_them() {
    let scene = quiet(
        "Attribute \"shape\" \"float radius\" 2 \"float height\" 1\nShape \"sphere\"\nShape \"sphere\" \"float radius\" 3",
    );
    let radii: Vec<f32> = scene.objects[0]
        .shapes
        .iter()
        .map(|s| if let Geometry::Sphere { radius, .. } = s.geometry { radius } else { 0.0 })
        .collect();
    assert_eq!(radii, [2.0, 3.0]);
    let scene = quiet(
        "AttributeBegin Attribute \"light\" \"float scale\" 2 LightSource \"point\" AttributeEnd LightSource \"point\"",
    );
    let intensity = |i: usize| {
        if let LightKind::Point { intensity } = scene.lights[i].kind { intensity.x } else { 0.0 }
    };
    assert_eq!((intensity(0), intensity(1)), (2.0, 1.0));
}

#[test]
fn lights() {
    let scene = quiet(
        "Translate 1 0 0 LightSource \"point\" \"rgb I\" [ 1 2 3 ] \"float scale\" 2 \"point3 from\" [ 0 1 0 ]\n\
         LightSource \"spot\" \"point3 from\" [ 0 0 5 ] \"point3 to\" [ 0 0 0 ] \"float coneangle\" 60 \"float conedeltaangle\" 30\n\
         LightSource \"distant\" \"point3 from\" [ 0 3 0 ] \"point3 to\" [ 0 0 0 ] \"rgb L\" [ 4 4 4 ]\n\
         LightSource \"infinite\" \"rgb L\" [ 1 2 3 ] \"float scale\" .5\n\
         LightSource \"infinite\" \"float illuminance\" 3.14159265\n\
         LightSource \"point\" \"float power\" 12.5663706",
    );
    let at = |i: usize| scene.lights[i].to_world.fixed();
    assert!(
        matches!(scene.lights[0].kind, LightKind::Point { intensity } if intensity == Vec3::new(2.0, 4.0, 6.0))
    );
    assert!(close(at(0).translation.into(), Vec3::new(1.0, 1.0, 0.0)));
    let LightKind::Spot { cos_inner, cos_outer, .. } = scene.lights[1].kind else {
        panic!("a spot")
    };
    assert!((cos_outer - 0.5).abs() < 1e-6 && (cos_inner - 0.75_f32.sqrt()).abs() < 1e-6);
    assert!(
        close(at(1).transform_vector3(Vec3::Z), -Vec3::Z)
            && close(at(1).translation.into(), Vec3::new(1.0, 0.0, 5.0))
    );
    assert!(
        matches!(scene.lights[2].kind, LightKind::Distant { irradiance } if irradiance == Vec3::splat(4.0))
    );
    assert!(close(at(2).transform_vector3(Vec3::Z), -Vec3::Y), "light travels from `from` to `to`");
    assert!(
        matches!(scene.lights[3].kind, LightKind::Environment { radiance, image: None } if radiance == Vec3::new(0.5, 1.0, 1.5))
    );
    assert!(
        matches!(scene.lights[4].kind, LightKind::Environment { radiance, .. } if (radiance.x - 1.0).abs() < 1e-6)
    );
    assert!(
        matches!(scene.lights[5].kind, LightKind::Point { intensity } if (intensity.x - 1.0).abs() < 1e-6)
    );
    let keys: Vec<u64> = scene.lights.iter().map(|l| l.key).collect();
    assert_eq!(keys, [0, 1, 2, 3, 4, 5]);
}

#[test]
fn area_lights_belong_to_their_attributes() {
    // All of them lie in one place, which is warned of.
    let (scene, _) = world(&format!(
        "AttributeBegin AreaLightSource \"diffuse\" \"rgb L\" [ 1 2 3 ] \"float scale\" 2 \"bool twosided\" true {TRIANGLE} AttributeEnd {TRIANGLE} \
         AreaLightSource \"diffuse\" \"rgb L\" [ 0 0 0 ] {TRIANGLE} AreaLightSource \"diffuse\" \"blackbody L\" [ 3000 ] {TRIANGLE}"
    ));
    let emission: Vec<_> = scene.objects[0].shapes.iter().map(|s| s.emission).collect();
    let first = emission[0].unwrap();
    assert!(
        first.two_sided
            && first.scale == 2.0
            && matches!(first.radiance, Color::Constant(c) if c == Vec3::new(1.0, 2.0, 3.0))
    );
    assert!(emission[1].is_none() && emission[2].is_none(), "no light, and a black one");
    let Color::Constant(warm) = emission[3].unwrap().radiance else { panic!("constant") };
    assert!(
        (crate::math::luminance(warm) - 1.0).abs() < 1e-3 && warm.x > warm.y && warm.y > warm.z,
        "{warm}"
    );
}

#[test]
fn textures_without_files() {
    let scene = quiet(
        "Texture \"c\" \"spectrum\" \"checkerboard\" \"rgb tex1\" [ 1 0 0 ] \"rgb tex2\" [ 0 0 1 ] \"float uscale\" 2 \"float udelta\" 1\n\
         Texture \"k\" \"float\" \"constant\" \"float value\" .25\n\
         Texture \"s\" \"spectrum\" \"scale\" \"texture tex\" \"c\" \"texture scale\" \"k\"\n\
         Texture \"f\" \"float\" \"checkerboard\" \"float tex1\" .75 \"texture tex2\" \"k\"\n\
         Material \"diffuse\" \"texture reflectance\" \"s\"\n\
         Material \"conductor\" \"texture roughness\" \"f\" \"rgb reflectance\" [ 1 1 1 ]\n\
         Material \"conductor\" \"texture roughness\" \"k\"\n\
         Shape \"sphere\" \"texture alpha\" \"f\" Shape \"sphere\" \"float alpha\" .5 Shape \"sphere\" \"float alpha\" 1",
    );
    let Material::Diffuse { reflectance } = scene.materials[0] else { panic!("diffuse") };
    // s = 2 u + 1: u = 0.1 is in square 1 (second), u = 0.6 in square 2 (first).
    assert_eq!(scene.color(reflectance, Vec2::new(0.1, 0.5)), Vec3::new(0.0, 0.0, 0.25));
    assert_eq!(scene.color(reflectance, Vec2::new(0.6, 0.5)), Vec3::new(0.25, 0.0, 0.0));
    let Material::Conductor { roughness, .. } = scene.materials[1] else { panic!("conductor") };
    assert_eq!(scene.scalar(roughness.u, Vec2::new(0.1, 0.1)), 0.75);
    assert_eq!(scene.scalar(roughness.u, Vec2::new(1.1, 0.1)), 0.25);
    assert!(
        matches!(scene.materials[2], Material::Conductor { roughness, .. } if matches!(roughness.u, Scalar::Constant(r) if r == 0.25))
    );
    let alphas: Vec<_> = scene.objects[0].shapes.iter().map(|s| s.alpha).collect();
    assert!(
        matches!(
            alphas[..],
            [Some(Scalar::Texture(_, Channel::Mean)), Some(Scalar::Constant(_)), None]
        ),
        "{alphas:?}"
    );
}

/// A folder that is removed at the end of a test.
pub(super) struct Folder(pub(super) PathBuf);

impl Folder {
    pub(super) fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("afterimage-{}-{name}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(super) fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, bytes).unwrap();
        path
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

#[test]
fn pictures_as_textures_and_environments() {
    let folder = Folder::new("pictures");
    let png = |name: &str, width: u32, pixels: &[[u8; 4]]| {
        let bytes: Vec<u8> = pixels.iter().flatten().copied().collect();
        let image =
            ::image::RgbaImage::from_raw(width, pixels.len() as u32 / width, bytes).unwrap();
        image.save(folder.0.join(name)).unwrap();
    };
    png("two.png", 1, &[[255, 0, 0, 255], [0, 0, 255, 255]]);
    png("cut.png", 1, &[[255, 255, 255, 255], [255, 255, 255, 0]]);
    png("sky.png", 2, &[[188, 188, 188, 255]; 2]);
    png("bad.png", 3, &[[0, 0, 0, 255]; 3]);
    let text = "WorldBegin Texture \"t\" \"spectrum\" \"imagemap\" \"string filename\" \"two.png\" \"string wrap\" \"clamp\" \"string filter\" \"ewa\"\n\
        Texture \"a\" \"float\" \"imagemap\" \"string filename\" \"cut.png\"\n\
        Material \"diffuse\" \"texture reflectance\" \"t\" Shape \"sphere\" \"texture alpha\" \"a\"\n\
        LightSource \"infinite\" \"string filename\" \"sky.png\" \"float scale\" 3";
    let scene = load(&folder.write("scene.pbrt", text.as_bytes())).unwrap().scene;
    let Material::Diffuse { reflectance } = scene.materials[0] else { panic!("diffuse") };
    assert_eq!(
        scene.color(reflectance, Vec2::new(0.5, 0.75)),
        Vec3::X,
        "the first row is at v = 1"
    );
    assert!(matches!(scene.textures[0].kind, TextureKind::Image { wrap: Wrap::Clamp, .. }));
    let alpha = scene.objects[0].shapes[0].alpha.unwrap();
    assert_eq!(
        [0.75, 0.25].map(|v| scene.scalar(alpha, Vec2::new(0.5, v))),
        [1.0, 0.0],
        "numbers of a transparent picture are its alpha"
    );
    let LightKind::Environment { radiance, image: Some((id, mapping)) } = scene.lights[0].kind
    else {
        panic!("environment")
    };
    assert_eq!((radiance, mapping), (Vec3::splat(3.0), EnvironmentMapping::LatitudeLongitude));
    let pixel: Vec4 = scene.images[id.index()].pixel(0, 0);
    assert!((pixel.x - 0.5029).abs() < 1e-4, "sRGB is decoded: {pixel}");

    let bad = "WorldBegin\nLightSource \"infinite\" \"string filename\" \"bad.png\"";
    let message = load(&folder.write("bad.pbrt", bad.as_bytes())).unwrap_err().to_string();
    assert!(
        message.contains("bad.pbrt:2:24: \"bad.png\" is 3 x 1 pixels; allowed: square"),
        "{message}"
    );
    folder.write("text.png", b"not a picture");
    let bad = "WorldBegin\nTexture \"a\" \"float\" \"imagemap\" \"string filename\" \"text.png\"";
    let message = load(&folder.write("bad.pbrt", bad.as_bytes())).unwrap_err().to_string();
    assert!(
        message.contains("bad.pbrt:2:32: \"text.png\": ")
            && message.ends_with("allowed: PNG, JPEG, TGA, HDR (Radiance), PFM, EXR"),
        "{message}"
    );
}

#[test]
fn included_files_and_circles() {
    let folder = Folder::new("include");
    folder.write(
        "parts/inner.pbrt",
        b"Include \"deeper.pbrt\"\nShape \"sphere\" \"float radius\" 0\n",
    );
    folder.write("parts/deeper.pbrt", b"Shape \"sphere\"\n");
    let main = folder.write("main.pbrt", b"WorldBegin\nInclude \"parts/inner.pbrt\"\n");
    let message = load(&main).unwrap_err().to_string();
    assert!(
        message.ends_with("parts/inner.pbrt:2:16: `radius` is 0; allowed: more than 0"),
        "{message}"
    );
    folder.write("parts/inner.pbrt", b"Include \"deeper.pbrt\"\nTranslate 1 0 0");
    let again = folder.write(
        "main.pbrt",
        b"WorldBegin\nInclude \"parts/inner.pbrt\" Include \"parts/inner.pbrt\"\n",
    );
    let scene = load(&again).unwrap().scene;
    let x: Vec<f32> = scene.objects[0]
        .shapes
        .iter()
        .map(|s| if let Geometry::Sphere { center, .. } = s.geometry { center.x } else { f32::NAN })
        .collect();
    assert_eq!(x, [0.0, 1.0], "the transformation goes on after the file");
    folder.write("parts/deeper.pbrt", b"Include \"../main.pbrt\"");
    let message = load(&again).unwrap_err().to_string();
    assert!(
        message.ends_with(
            "deeper.pbrt:1:1: \"../main.pbrt\" includes itself; allowed: no circle of files"
        ),
        "{message}"
    );
}

#[test]
fn moving_shapes_lights_and_camera() {
    let text = "TransformTimes 1 3\nActiveTransform EndTime Translate 0 0 -2 ActiveTransform All\nCamera \"perspective\"\nWorldBegin\n\
        Shape \"sphere\"\n\
        AttributeBegin ActiveTransform EndTime Translate 4 0 0 ActiveTransform All Shape \"sphere\" LightSource \"point\" AttributeEnd\n\
        AttributeBegin Translate 0 1 0 ActiveTransform StartTime Rotate 90 0 0 1 Shape \"sphere\" AttributeEnd";
    let loaded = load_text(text).unwrap();
    assert!(loaded.warnings.is_empty(), "{:?}", loaded.warnings);
    let scene = loaded.scene;
    assert_eq!(scene.time, [1.0, 3.0]);
    assert_eq!((scene.objects.len(), scene.instances.len()), (3, 3));
    let mut keys: Vec<u64> = scene.instances.iter().map(|i| i.key).collect();
    keys.sort_unstable();
    assert_eq!(keys, [0, 1, 2]);
    let find = |key: u64| scene.instances.iter().find(|i| i.key == key).unwrap().to_world.at(2.0);
    assert!(close(find(0).translation.into(), Vec3::ZERO), "the still one");
    assert!(close(find(1).translation.into(), Vec3::new(2.0, 0.0, 0.0)), "half-way");
    let turned = find(2);
    assert!(close(turned.translation.into(), Vec3::Y));
    assert!(close(
        turned.transform_vector3(Vec3::X),
        Quat::from_rotation_z(std::f32::consts::FRAC_PI_4) * Vec3::X
    ));
    assert!(close(scene.lights[0].to_world.at(2.0).translation.into(), Vec3::new(2.0, 0.0, 0.0)));
    assert!(
        close(scene.camera.to_world.at(2.0).translation.into(), Vec3::new(0.0, 0.0, 1.0)),
        "world to camera is what the text gives"
    );
    let message = load_text("WorldBegin\nActiveTransform EndTime Scale -1 1 1\nShape \"sphere\"")
        .unwrap_err()
        .to_string();
    assert!(
        message.starts_with(
            "scene.pbrt:3:1: the start and the end of the motion differ in shear or handedness"
        ),
        "{message}"
    );
}

#[test]
fn objects_are_shared_by_their_instances() {
    let scene = quiet(&format!(
        "Translate 0 0 1 ObjectBegin \"a\" Translate 1 0 0 {TRIANGLE} ActiveTransform EndTime Translate 0 2 0 {TRIANGLE} ObjectEnd\n\
         Shape \"sphere\" Identity Translate 0 5 0 ObjectInstance \"a\" Translate 0 5 0 ObjectInstance \"a\""
    ));
    assert_eq!((scene.objects.len(), scene.instances.len()), (3, 5));
    let world = |i: usize, time: f32| {
        let instance = &scene.instances[i];
        let object = &scene.objects[instance.object.index()];
        instance.to_world.at(time).transform_point3(mesh(&object.shapes[0]).positions[0])
    };
    assert!(close(world(0, 0.0), Vec3::new(1.0, 5.0, 1.0)), "{}", world(0, 0.0));
    assert!(
        close(world(1, 1.0), Vec3::new(1.0, 7.0, 1.0)),
        "the moving part of the first: {}",
        world(1, 1.0)
    );
    assert!(
        close(world(3, 0.5), Vec3::new(1.0, 11.0, 1.0)),
        "the moving part of the second: {}",
        world(3, 0.5)
    );
    assert_eq!(scene.instances[0].object, scene.instances[2].object);
}

#[test]
fn ply_files_beside_the_scene() {
    let folder = Folder::new("ply");
    let ply = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    folder.write("m/a.ply", ply.as_bytes());
    let main = folder.write(
        "scene.pbrt",
        b"WorldBegin Translate 0 0 2 Shape \"plymesh\" \"string filename\" \"m/a.ply\"",
    );
    let scene = load(&main).unwrap().scene;
    assert_eq!(mesh(&scene.objects[0].shapes[0]).positions[1], Vec3::new(1.0, 0.0, 2.0));
    assert!(
        scene.name.ends_with("-ply"),
        "a file called scene takes its folder's name: {}",
        scene.name
    );
    folder.write("m/a.ply", ply.replace("3 0 1 2", "3 0 1 3").as_bytes());
    let message = load(&main).unwrap_err().to_string();
    assert!(
        message.ends_with(
            "scene.pbrt:1:44: \"m/a.ply\": face 0 of the PLY file names vertex 3; allowed: 0 to 2"
        ),
        "{message}"
    );
}

#[test]
fn float_pictures_with_negative_light_are_cleaned() {
    let folder = Folder::new("negative");
    let pixels = [[-1.0, 0.5, 2.0, 1.0]; 4];
    let file = exr::prelude::Image::from_channels(
        (2, 2),
        exr::prelude::SpecificChannels::rgb(|p: exr::prelude::Vec2<usize>| {
            let [r, g, b, _]: [f32; 4] = pixels[p.x() + 2 * p.y()];
            (r, g, b)
        }),
    );
    use exr::prelude::WritableImage;
    file.write().to_file(folder.0.join("sky.exr")).unwrap();
    let main = folder.write(
        "scene.pbrt",
        b"WorldBegin LightSource \"infinite\" \"string filename\" \"sky.exr\"",
    );
    let loaded = load(&main).unwrap();
    assert!(
        loaded
            .warnings
            .iter()
            .any(|w| w.contains("\"sky.exr\" has negative pixels; they are taken as 0")),
        "{:?}",
        loaded.warnings
    );
    let Image { data: ImageData::Float(data), .. } = &*loaded.scene.images[0] else {
        panic!("floats")
    };
    assert_eq!(data[3], [0.0, 0.5, 2.0, 1.0]);
    assert!(matches!(
        loaded.scene.lights[0].kind,
        LightKind::Environment { image: Some((_, EnvironmentMapping::EqualAreaOctahedral)), .. }
    ));
}
