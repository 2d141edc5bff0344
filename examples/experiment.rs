//! Experiments from code: two techniques at equal effort, and a short trial of one, on a scene
//! built here.
//!
//! ```sh
//! cargo run --release --example experiment
//! ```

use afterimage::experiment::{
    Ages, Comparison, ReferencePool, ReferenceSettings, Session, SessionSettings, Spending, Trial,
    technique,
};
use afterimage::report::summary;
use afterimage::scene::{Camera, Color, Geometry, Material, Scene, Shape, Transform};
use glam::{Affine3A, Vec3};

/// A grey floor under a row of lamps of rising power, and a ball that shades some of them.
fn lamps() -> Scene {
    let mut scene = Scene::new("row of lamps");
    let reflectance = Color::Constant(Vec3::splat(0.5));
    let grey = scene.add_material(Material::Diffuse { reflectance });
    let floor = Geometry::Disk { center: Vec3::ZERO, normal: Vec3::Y, radius: 4.0 };
    scene.add_shape(Shape::new(floor, grey));
    let ball = Geometry::Sphere { center: Vec3::new(0.2, 0.6, 0.0), radius: 0.3 };
    scene.add_shape(Shape::new(ball, grey));
    for at in 0..12_u8 {
        let center = Vec3::new(0.25 * f32::from(at) - 1.4, 1.5, 0.3);
        let lamp = Shape::new(Geometry::Sphere { center, radius: 0.05 }, grey);
        scene.add_shape(lamp.emitting(Vec3::splat(5.0 * f32::from(at + 1))));
    }

    // Five metres up, looking straight down (camera space: x right, y up, z forward).
    let eye = Vec3::new(0.0, 5.0, 0.0);
    let down = Affine3A::from_cols(Vec3::X.into(), Vec3::Z.into(), Vec3::NEG_Y.into(), eye.into());
    scene.camera = Camera { to_world: Transform::Fixed(down), fov: 0.8 };
    scene
}

fn main() -> afterimage::Result<()> {
    let settings =
        SessionSettings { size: Some([64, 64]), depth: Some(2), ..SessionSettings::default() };
    let session = Session::new(lamps(), &settings)?;
    // References stay out of the user's cache.
    let cache = std::env::temp_dir().join("afterimage-example");
    let reference =
        ReferenceSettings { seconds: 10.0, cache: Some(cache), ..ReferenceSettings::default() };

    // Which has the smaller error with one estimate a pixel?
    let comparison = Comparison {
        spending: Spending::Estimates(1),
        frames: 8,
        restarts: 6,
        curve_restarts: 0,
        reference: reference.clone(),
        ..Comparison::default()
    };
    let compared = comparison.run(&session, &[technique("nee")?, technique("restir-di")?])?;
    println!("{}", summary(&compared.results));

    // Is the mean of its fifth frame right to two percent?
    let trial = Trial { ages: Ages::Given(vec![1, 5]), delta: 0.02, reference, ..Trial::quick() };
    let mut references = ReferencePool::default();
    let reuse = technique("restir-di")?;
    let outcome = trial.run(&session, &reuse, &mut references, |_, _| Ok(()))?;
    for age in &outcome.last().ages {
        println!(
            "`{}` in frame {}: bias {:+.2} %, {} restarts, {}",
            outcome.plan.technique,
            age.frames,
            100.0 * age.image().relative(),
            age.restarts.count(),
            age.verdict()
        );
    }
    Ok(())
}
