//! Kernels: WGSL modules put together, with what the plan and the scene leave out as constants.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use crate::error::{Error, Result};

/// WGSL that needs nothing of this crate's scene. Each text is part of a module: put together what you need and add your own.
///
/// | part | needs |
/// |---|---|
/// | [`RNG`] | – |
/// | [`RESAMPLING`] | [`RNG`] |
/// | [`MERGE`] | [`RESAMPLING`], and of the host what its head lists: a sample, inputs, a shift |
/// | [`VISIBILITY`] | – |
///
/// [`RNG`]: wgsl::RNG
/// [`RESAMPLING`]: wgsl::RESAMPLING
/// [`MERGE`]: wgsl::MERGE
/// [`VISIBILITY`]: wgsl::VISIBILITY
pub mod wgsl {
    /// Random numbers by purpose, bit-equal to [`crate::math::rng`].
    pub const RNG: &str = include_str!("../math/rng.wgsl");
    pub use crate::resampling::{MERGE_WGSL as MERGE, RESAMPLING_WGSL as RESAMPLING};
    pub use crate::reuse::light_points::VISIBILITY_WGSL as VISIBILITY;
}

/// What every kernel that knows the scene is made of.
const SCENE: [&str; 9] = [
    wgsl::RNG,
    include_str!("../math/math.wgsl"),
    include_str!("../math/warp.wgsl"),
    include_str!("scene.wgsl"),
    include_str!("../accel/accel.wgsl"),
    include_str!("../surface/bsdf.wgsl"),
    include_str!("../light/light.wgsl"),
    include_str!("../surface/surface.wgsl"),
    include_str!("../path/path.wgsl"),
];

/// A name and its value.
type Constant = (&'static str, f64);

/// What a scene does not need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SceneConstants {
    pub(crate) two_level: bool,
    pub(crate) quadrics: bool,
    pub(crate) coverage: bool,
    pub(crate) textures: bool,
    pub(crate) environments: bool,
    pub(crate) anisotropic: bool,
    /// One bit a kind of material.
    pub(crate) materials: u32,
    /// Entries of a traversal's stack.
    pub(crate) stack: u32,
}

impl SceneConstants {
    /// What either needs.
    pub(crate) fn or(&self, other: &Self) -> Self {
        Self {
            two_level: self.two_level || other.two_level,
            quadrics: self.quadrics || other.quadrics,
            coverage: self.coverage || other.coverage,
            textures: self.textures || other.textures,
            environments: self.environments || other.environments,
            anisotropic: self.anisotropic || other.anisotropic,
            materials: self.materials | other.materials,
            stack: self.stack.max(other.stack),
        }
    }

    fn pairs(&self) -> Vec<Constant> {
        let flag = |b: bool| f64::from(u8::from(b));
        vec![
            ("TWO_LEVEL", flag(self.two_level)),
            ("QUADRICS", flag(self.quadrics)),
            ("COVERAGE", flag(self.coverage)),
            ("TEXTURES", flag(self.textures)),
            ("ENVIRONMENTS", flag(self.environments)),
            ("ANISOTROPIC", flag(self.anisotropic)),
        ]
    }

    /// One flag a kind of material.
    fn flags(&self) -> Vec<Constant> {
        const KINDS: [&str; 8] = [
            "HAS_DIFFUSE",
            "HAS_DIFFUSE_TRANSMISSION",
            "HAS_CONDUCTOR",
            "HAS_DIELECTRIC",
            "HAS_THIN_DIELECTRIC",
            "HAS_COATED",
            "HAS_METALLIC",
            "HAS_MIX",
        ];
        let kinds = KINDS.iter().enumerate();
        kinds.map(|(kind, name)| (*name, f64::from(self.materials >> kind & 1))).collect()
    }
}

/// Appends `text` without the parts that constants leave out, so that drivers never see them: their compilers inline everything before they drop
/// anything, and take minutes over what is never run.
///
/// Directives are comments, so a text may be valid as a whole, too: `//#if NAME`, `//#if !NAME`, `//#if NAME=3|4`, `//#else`, `//#endif`. What asks
/// for a name without a value stays, with all of its branches.
pub(super) fn select(
    text: &str,
    known: &HashMap<&str, f64>,
    out: &mut String,
) -> std::result::Result<(), String> {
    // For each open directive: whether its lines stay, and whether its other branch does.
    let mut open: Vec<(bool, bool)> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let directive = line.trim_start().strip_prefix("//#");
        match directive.map(|d| d.split_once(' ').unwrap_or((d, ""))) {
            Some(("if", condition)) => {
                let holds = condition_holds(condition.trim(), known);
                open.push((holds.unwrap_or(true), !holds.unwrap_or(false)));
            }
            Some((word @ ("else" | "endif"), _)) => {
                let Some((stays, other)) = open.pop() else {
                    return Err(format!("line {}: an #{word} without an #if", number + 1));
                };
                if word == "else" {
                    open.push((other, stays));
                }
            }
            // Other comments are comments.
            _ if open.iter().all(|(stays, _)| *stays) => {
                out.push_str(line);
                out.push('\n');
            }
            _ => {}
        }
    }
    if open.is_empty() { Ok(()) } else { Err("an #if has no #endif".to_string()) }
}

/// `None`: not known.
fn condition_holds(condition: &str, known: &HashMap<&str, f64>) -> Option<bool> {
    if let Some(name) = condition.strip_prefix('!') {
        return known.get(name).map(|value| *value == 0.0);
    }
    match condition.split_once('=') {
        Some((name, values)) => {
            let value = known.get(name)?;
            Some(values.split('|').any(|v| v.parse() == Ok(*value)))
        }
        None => known.get(condition).map(|value| *value != 0.0),
    }
}

/// A kernel before it is compiled.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pub(crate) entry: &'static str,
    modules: Vec<&'static str>,
    pub(crate) constants: Vec<Constant>,
    /// What directives may ask besides.
    flags: Vec<Constant>,
    stack: u32,
}

impl Kernel {
    pub(crate) fn new(
        entry: &'static str,
        own: &[&'static str],
        (constants, flags): (&[Constant], &[Constant]),
        scene: &SceneConstants,
    ) -> Self {
        let mut modules = SCENE.to_vec();
        modules.extend_from_slice(own);
        let mut all = scene.pairs();
        all.extend_from_slice(constants);
        let flags = scene.flags().into_iter().chain(flags.iter().copied()).collect();
        Self { entry, modules, constants: all, flags, stack: scene.stack }
    }

    /// The whole module, without what `//#if` leaves out.
    ///
    /// # Errors
    /// An `//#else` or `//#endif` without its `//#if`, or the other way around.
    pub(crate) fn source(&self) -> Result<String> {
        let mut text = format!("const STACK: u32 = {}u;\n\n", self.stack);
        let known: HashMap<&str, f64> = self.constants.iter().chain(&self.flags).copied().collect();
        for module in &self.modules {
            select(module, &known, &mut text)
                .map_err(|why| Error::gpu(format!("kernel `{}`: {why}", self.entry)))?;
            text.push('\n');
        }
        Ok(text)
    }

    /// Different for different kernels.
    pub(crate) fn key(&self, source: &str) -> String {
        let mut hasher = DefaultHasher::new();
        source.hash(&mut hasher);
        format!("{} {:?} {:016x}", self.entry, self.constants, hasher.finish())
    }
}
