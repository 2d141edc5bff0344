//! What a scene needs ([`SceneFacts`]) and what a technique will therefore run ([`Plan`]): plain data, made once, printed by
//! `afterimage plan`.

use std::fmt;

use crate::light::LightCounts;
use crate::math::luminance;
pub use crate::resampling::Claim;
use crate::scene::{Color, LightKind, Material, MaterialId, Scalar, Scene};
use crate::surface::material::evaluate_material;

/// What a scene contains, as far as it decides what can be left out.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneFacts {
    /// Lights by kind; black ones apart.
    pub lights: LightCounts,
    /// Whether all emission is grey: a scalar visibility then loses no colour.
    pub grey_lights: bool,
    /// Whether any surface's emission is textured.
    pub textured_emission: bool,
    /// Whether some material has a perfectly specular lobe.
    pub delta_lobes: bool,
    /// Whether some material is glossy: neither diffuse nor perfectly specular.
    pub glossy_lobes: bool,
    /// Whether some material transmits.
    pub transmission: bool,
    /// Whether coverage lets rays through somewhere.
    pub alpha: bool,
    /// Whether the camera moves.
    pub moving_camera: bool,
    /// Whether a light without a surface, or an emitting instance, moves.
    pub moving_lights: bool,
    /// Whether an instance moves.
    pub moving_geometry: bool,
    /// Number of triangles, spheres and disks as placed.
    pub primitives: u64,
    /// Path segments that the file asks for.
    pub depth: u32,
}

impl SceneFacts {
    /// Reads the facts off a scene, which may move, and its light table's counts.
    #[must_use]
    pub fn new(scene: &Scene, lights: LightCounts) -> Self {
        let mut facts = Self {
            lights,
            grey_lights: true,
            textured_emission: false,
            delta_lobes: false,
            glossy_lobes: false,
            transmission: false,
            alpha: false,
            moving_camera: scene.camera.to_world.moves(),
            moving_lights: scene.lights.iter().any(|light| light.to_world.moves()),
            moving_geometry: false,
            primitives: 0,
            depth: scene.depth,
        };
        let grey =
            |rgb: glam::Vec3| (rgb - luminance(rgb)).abs().max_element() <= 1e-6 * luminance(rgb);
        for instance in &scene.instances {
            let moves = instance.to_world.moves();
            facts.moving_geometry |= moves;
            for shape in &scene.objects[instance.object.index()].shapes {
                facts.primitives += match &shape.geometry {
                    crate::scene::Geometry::Mesh(mesh) => mesh.triangles.len() as u64,
                    _ => 1,
                };
                facts.alpha |= shape
                    .alpha
                    .is_some_and(|alpha| !matches!(alpha, Scalar::Constant(a) if a >= 1.0));
                facts.add_material(scene, shape.material);
                if let Some(emission) = shape.emission {
                    facts.moving_lights |= moves;
                    match emission.radiance {
                        Color::Constant(rgb) => facts.grey_lights &= grey(rgb),
                        Color::Texture(_) => {
                            facts.textured_emission = true;
                            facts.grey_lights = false;
                        }
                    }
                }
            }
        }
        for light in &scene.lights {
            facts.grey_lights &= match light.kind {
                LightKind::Point { intensity } | LightKind::Spot { intensity, .. } => {
                    grey(intensity)
                }
                LightKind::Distant { irradiance } => grey(irradiance),
                LightKind::Environment { radiance, image } => image.is_none() && grey(radiance),
            };
        }
        facts
    }

    fn add_material(&mut self, scene: &Scene, id: MaterialId) {
        let textured = |scalar: &Scalar| !matches!(scalar, Scalar::Constant(_));
        let (rough, varies) = match &scene.materials[id.index()] {
            Material::Mix { first, second, .. } => {
                // Parts of a mix are not mixes, as validation has checked.
                self.add_material(scene, *first);
                return self.add_material(scene, *second);
            }
            Material::Diffuse { .. } => (false, false),
            Material::DiffuseTransmission { .. } => {
                self.transmission = true;
                (false, false)
            }
            Material::Conductor { roughness, .. } | Material::CoatedDiffuse { roughness, .. } => {
                (true, textured(&roughness.u) || textured(&roughness.v))
            }
            Material::Dielectric { roughness, .. } => {
                self.transmission = true;
                (true, textured(&roughness.u) || textured(&roughness.v))
            }
            Material::ThinDielectric { .. } => {
                self.transmission = true;
                (false, false)
            }
            Material::MetallicRoughness { roughness, transmission, .. } => {
                self.transmission |= !matches!(transmission, Scalar::Constant(0.0));
                self.glossy_lobes = true;
                (true, textured(roughness))
            }
        };
        // What is smooth enough for a delta is the lobes' own business; only roughness decides it, so any texture coordinates do.
        let bsdf = evaluate_material(scene, id, glam::Vec2::splat(0.5));
        self.delta_lobes |= varies || (0..bsdf.lobe_count()).any(|lobe| bsdf.is_delta(lobe));
        self.glossy_lobes |= rough && (varies || !bsdf.is_delta(0));
    }

    /// What another scene has that a plan made for this one may have left out; `None` if nothing.
    #[must_use]
    pub fn lacks(&self, other: &Self) -> Option<&'static str> {
        let (here, there) = (&self.lights, &other.lights);
        let surfaces = |counts: &LightCounts| counts.triangles + counts.quadrics;
        [
            (surfaces(here) == 0 && surfaces(there) > 0, "an emitting surface"),
            (here.delta == 0 && there.delta > 0, "a point, spot or distant light"),
            (here.environments == 0 && there.environments > 0, "an environment"),
            (!self.delta_lobes && other.delta_lobes, "a perfectly specular surface"),
            (!self.alpha && other.alpha, "a surface with coverage"),
        ]
        .into_iter()
        .find_map(|(lacks, what)| lacks.then_some(what))
    }

    /// Number of lights that can be drawn.
    #[must_use]
    pub fn light_count(&self) -> u32 {
        let LightCounts { triangles, quadrics, delta, environments, black: _ } = self.lights;
        triangles + quadrics + delta + environments
    }

    /// Whether any two frames can differ.
    #[must_use]
    pub fn moves(&self) -> bool {
        self.moving_camera || self.moving_lights || self.moving_geometry
    }

    /// Names and values, for people.
    #[must_use]
    pub fn entries(&self) -> Vec<(&'static str, String)> {
        let LightCounts { triangles, quadrics, delta, environments, black } = self.lights;
        vec![
            ("primitives", self.primitives.to_string()),
            ("emitting triangles", triangles.to_string()),
            ("emitting spheres and disks", quadrics.to_string()),
            ("point, spot and distant lights", delta.to_string()),
            ("environments", environments.to_string()),
            ("black lights", black.to_string()),
            ("grey lights only", self.grey_lights.to_string()),
            ("textured emission", self.textured_emission.to_string()),
            ("delta lobes", self.delta_lobes.to_string()),
            ("glossy lobes", self.glossy_lobes.to_string()),
            ("transmission", self.transmission.to_string()),
            ("coverage masks", self.alpha.to_string()),
            ("moving camera", self.moving_camera.to_string()),
            ("moving lights", self.moving_lights.to_string()),
            ("moving geometry", self.moving_geometry.to_string()),
            ("depth", self.depth.to_string()),
        ]
    }
}

/// Where in a pixel primary rays pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Filter {
    /// Through its centre, the same in every frame.
    Point,
    /// Anywhere, uniformly; drawn anew for every pixel, frame and sample.
    Box,
}

/// What is rendered, besides the scene and the technique.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shot {
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// Most segments of a path; 1 is directly visible emission only.
    pub depth: u32,
    /// Pixel filter.
    pub filter: Filter,
    /// Key of all random numbers; another run is an independent restart.
    pub run: u64,
    /// Complete independent estimates a frame, averaged.
    pub effort: u32,
    /// Frames a second of scene time.
    pub fps: u32,
}

impl Shot {
    /// Number of pixels.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.size[0] as usize * self.size[1] as usize
    }
}

/// A per-pixel or per-item buffer of the frame loop, by its place in [`Plan::buffers`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferId(pub usize);

/// Untyped state, the same bytes on every backend.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BufferPlan {
    /// For people and for bisecting.
    pub name: &'static str,
    /// Bytes an element; a multiple of 4.
    pub bytes: u32,
    /// Number of elements.
    pub elements: Elements,
    /// Whether last frame's contents are kept beside this frame's.
    pub history: bool,
}

/// How many elements a buffer has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elements {
    /// One a pixel.
    Pixels,
    /// A fixed number.
    Items(u32),
}

/// What one run of a pass's kernel owns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Domain {
    /// One pixel.
    Pixels,
    /// A tile of pixels whose lanes may exchange state; the grid starts at −origin.
    Tiles {
        /// Pixels across.
        width: u32,
        /// Pixels down.
        height: u32,
        /// Shift of the grid to the left and up.
        origin: [u32; 2],
    },
    /// One of n items.
    Items(u32),
}

/// Who runs a pass.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// The frame loop: primary hits.
    PrimaryHits,
    /// The technique, by a number of its own.
    Technique(u32),
}

/// One pass over a domain.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pass {
    /// For people and timings.
    pub name: &'static str,
    /// Who runs it.
    pub kernel: Kernel,
    /// What one run owns.
    pub domain: Domain,
    /// Buffers of which it writes its own elements.
    pub writes: Vec<BufferId>,
    /// When it runs.
    pub runs: Runs,
}

/// In which frames a pass runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Runs {
    /// In all.
    #[default]
    Always,
    /// In the first only, because its result never changes.
    Once,
    /// In all but the first, which has no history.
    WithHistory,
}

/// Something that a scene does not need.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skip {
    /// What is left out.
    pub what: &'static str,
    /// The fact that allows it.
    pub because: &'static str,
}

/// What a technique will run for a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The technique's SPEC.
    pub technique: String,
    /// In order.
    pub passes: Vec<Pass>,
    /// All state; the first three are always [`Plan::HITS`], [`Plan::RADIANCE`], [`Plan::EMISSION`].
    pub buffers: Vec<BufferPlan>,
    /// What is left out, and why.
    pub skipped: Vec<Skip>,
    /// Most rays a pixel and frame, by kind: see [`Plan::RAY_KINDS`].
    pub rays_per_pixel: [u64; 4],
    /// What kernels are specialised on: fixed for all frames, so that no ray asks.
    pub constants: Vec<(&'static str, u32)>,
    /// Whether kernels ask which emitters a ray meets ([`crate::world::World::emitters`]).
    pub emitters: bool,
    /// Whether the answer is exact in the mean.
    pub claim: Claim,
}

impl Plan {
    /// Primary hits: [`crate::accel::Hit`] as 20 bytes.
    pub const HITS: BufferId = BufferId(0);
    /// The frame's result without directly visible emission: 3 floats.
    pub const RADIANCE: BufferId = BufferId(1);
    /// Directly visible emission and sky: 3 floats.
    pub const EMISSION: BufferId = BufferId(2);

    /// Names of the kinds of rays.
    pub const RAY_KINDS: [&'static str; 4] = ["primary", "bounce", "shadow", "emitter"];

    /// A buffer by its name.
    #[must_use]
    pub fn buffer(&self, name: &str) -> Option<BufferId> {
        self.buffers.iter().position(|buffer| buffer.name == name).map(BufferId)
    }

    /// A constant by its name; 0 where the plan has none.
    #[must_use]
    pub fn constant(&self, name: &str) -> u32 {
        self.constants.iter().find(|(known, _)| *known == name).map_or(0, |(_, value)| *value)
    }

    /// Whether what was in earlier frames changes later ones.
    #[must_use]
    pub fn keeps_history(&self) -> bool {
        self.buffers.iter().any(|buffer| buffer.history)
            || self.passes.iter().any(|pass| pass.runs == Runs::WithHistory)
    }

    /// The buffers that every plan begins with.
    #[must_use]
    pub fn standard_buffers() -> Vec<BufferPlan> {
        let pixels =
            |name, bytes| BufferPlan { name, bytes, elements: Elements::Pixels, history: false };
        vec![pixels("hits", 20), pixels("radiance", 12), pixels("emission", 12)]
    }

    /// Bytes a pixel of all buffers, history counted twice, for a picture of `pixels` pixels.
    #[must_use]
    pub fn bytes_per_pixel(&self, pixels: usize) -> f64 {
        self.buffers
            .iter()
            .map(|buffer| {
                let copies = if buffer.history { 2.0 } else { 1.0 };
                let share = match buffer.elements {
                    Elements::Pixels => 1.0,
                    Elements::Items(n) => f64::from(n) / pixels as f64,
                };
                f64::from(buffer.bytes) * copies * share
            })
            .sum()
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "technique  {}", self.technique)?;
        writeln!(f, "claim      {}", self.claim)?;
        let rays: Vec<String> = Self::RAY_KINDS
            .iter()
            .zip(self.rays_per_pixel)
            .map(|(kind, most)| format!("{most} {kind}"))
            .collect();
        writeln!(f, "rays       at most {} a pixel and frame", rays.join(", "))?;
        writeln!(f, "passes")?;
        for pass in &self.passes {
            let domain = match pass.domain {
                Domain::Pixels => "pixels".to_string(),
                Domain::Tiles { width, height, .. } => format!("tiles of {width} x {height}"),
                Domain::Items(n) => format!("{n} items"),
            };
            let writes: Vec<&str> = pass.writes.iter().map(|id| self.buffers[id.0].name).collect();
            let runs = match pass.runs {
                Runs::Always => "",
                Runs::Once => ", first frame only",
                Runs::WithHistory => ", not in the first frame",
            };
            writeln!(f, "  {:<12} {domain}{runs}; writes {}", pass.name, writes.join(", "))?;
        }
        writeln!(f, "state")?;
        for buffer in &self.buffers {
            let per = match buffer.elements {
                Elements::Pixels => "a pixel".to_string(),
                Elements::Items(n) => format!("an item, {n} items"),
            };
            let history = if buffer.history { ", two frames" } else { "" };
            writeln!(f, "  {:<12} {} bytes {per}{history}", buffer.name, buffer.bytes)?;
        }
        if !self.constants.is_empty() {
            let constants: Vec<String> =
                self.constants.iter().map(|(name, value)| format!("{name} {value}")).collect();
            writeln!(f, "fixed\n  {}", constants.join(", "))?;
        }
        writeln!(f, "left out")?;
        for skip in &self.skipped {
            writeln!(f, "  {} (because {})", skip.what, skip.because)?;
        }
        if self.skipped.is_empty() {
            writeln!(f, "  nothing")?;
        }
        Ok(())
    }
}
