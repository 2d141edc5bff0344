//! Small scenes as text, and the shared ones.

use super::*;
use crate::scene::Geometry;

fn load_text(text: &str) -> Result<Loaded> {
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

#[test]
fn an_unknown_directive_is_refused_at_its_place() {
    let error = load_text("WorldBegin\n  Shapes \"sphere\"\n").unwrap_err();
    assert!(error.is_syntax());
    let text = error.to_string();
    assert!(text.starts_with("scene.pbrt:2:3: found `Shapes`; known: Shape, Scale, "), "{text}");
}
