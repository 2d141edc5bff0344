//! `Camera`, `Film`, `Integrator`.

use glam::{DAffine3, DVec3};

use super::motion::similarity;
use super::params::{Place, Type};
use super::{Builder, File, shorten};
use crate::error::Result;
use crate::scene::Camera;

impl Builder {
    pub(super) fn integrator(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let (_, params) = file.params("Integrator", place, &[])?;
        let depth = params.integer("maxdepth")?.unwrap_or(5);
        match u32::try_from(depth + 1) {
            // pbrt counts bounces, this crate path segments.
            Ok(segments) if depth >= 0 => self.scene.depth = segments,
            _ => {
                return params
                    .param_place("maxdepth")
                    .invalid(format!("`maxdepth` is {depth}; allowed: 0 or more"));
            }
        }
        Ok(())
    }

    pub(super) fn film(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let (kind, params) = file.params("Film", place, &[])?;
        if kind == "image" {
            let warning = super::of_version_3("Film \"image\"");
            self.warnings.add(format!("{place}: {warning}; what follows may mean something else"));
        }
        for (i, name) in ["xresolution", "yresolution"].into_iter().enumerate() {
            if let Some(pixels) = params.integer(name)? {
                match u32::try_from(pixels) {
                    Ok(pixels) if pixels > 0 => self.scene.film[i] = pixels,
                    _ => {
                        return params
                            .param_place(name)
                            .invalid(format!("`{name}` is {pixels}; allowed: more than 0"));
                    }
                }
            }
        }
        params.ignore(&["filename", "diagonal", "savefp16", "coordinatesystem"]);
        params.ignore_with(
            &["cropwindow", "pixelbounds"],
            "the whole picture is rendered",
            &mut self.warnings,
        );
        let sensor =
            ["sensor", "iso", "exposuretime", "whitebalance", "imagingratio", "maxcomponentvalue"];
        params.ignore_with(&sensor, "pixels hold scene-linear radiance", &mut self.warnings);
        params.finish(&mut self.warnings);
        Ok(())
    }

    pub(super) fn camera(&mut self, place: &Place, file: &mut File<'_>) -> Result<()> {
        let (kind, params) = file.params("Camera", place, &[])?;
        if kind != "perspective" {
            return place
                .unsupported(format!("Camera \"{}\"; allowed: perspective", shorten(&kind)));
        }
        let fov = params.float_or("fov", 90.0)?;
        if !(fov > 0.0 && fov < 180.0) {
            return params
                .param_place("fov")
                .invalid(format!("`fov` is {fov}; allowed: degrees between 0 and 180"));
        }
        let mut tangent = (0.5 * fov).to_radians().tan();
        let [width, height] = self.scene.film.map(f64::from);
        let aspect = match params.float("frameaspectratio")? {
            Some(ratio) if (ratio * height / width - 1.0).abs() > 1e-3 => {
                let message = format!(
                    "`frameaspectratio` is {ratio}; allowed: that of the film, {}, given before",
                    width / height
                );
                return params.param_place("frameaspectratio").unsupported(message);
            }
            _ => width / height,
        };
        if let Some(window) = params.numbers("screenwindow", &[Type::Float])? {
            let (half_width, half_height) = (aspect.max(1.0), (1.0 / aspect).max(1.0));
            // Any centred window of the film's shape is a change of the angle.
            let zoom = window.get(1).map_or(0.0, |right| right / half_width);
            let fits = window.len() == 4
                && zoom > 0.0
                && window
                    .iter()
                    .zip([-half_width, half_width, -half_height, half_height])
                    .all(|(given, side)| (given - zoom * side).abs() <= 1e-3 * zoom);
            if !fits {
                let message = format!(
                    "`screenwindow` is {window:?}; allowed: centred, in the film's shape, as -a a -b b"
                );
                return params.param_place("screenwindow").unsupported(message);
            }
            tangent *= zoom;
        }
        if params.float_or("lensradius", 0.0)? > 0.0 {
            let at = params.param_place("lensradius");
            self.warnings.add(format!(
                "{at}: `lensradius` is ignored: the camera is a pinhole, all is in focus"
            ));
        }
        params.ignore(&["focaldistance"]);
        params.ignore_with(
            &["shutteropen", "shutterclose"],
            "a frame shows one instant",
            &mut self.warnings,
        );
        params.finish(&mut self.warnings);

        let mut to_world = self.state.ctm.inverse();
        if !to_world.is_regular() || !self.state.ctm.is_regular() {
            return place.invalid("the camera's transformation is singular or not finite; allowed: one that has an inverse");
        }
        for end in &mut to_world.ends {
            let Some(scale) = similarity(end.matrix3) else {
                return place.unsupported("the camera's transformation shears or stretches; allowed: rotation, translation, mirror, uniform scale");
            };
            // A uniform scale changes no ray of a pinhole.
            *end *= DAffine3::from_scale(DVec3::splat(1.0 / scale));
        }
        self.coordinate_systems.insert("camera".to_string(), to_world);
        let fov = 2.0 * tangent.atan();
        self.scene.camera = Camera { to_world: self.placement(to_world, place)?, fov: fov as f32 };
        self.camera_seen = true;
        Ok(())
    }
}
