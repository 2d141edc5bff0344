//! Kernels: WGSL modules put together, with what the plan and the scene leave out as constants.

use std::hash::{DefaultHasher, Hash, Hasher};

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
    pub use crate::direct::VISIBILITY_WGSL as VISIBILITY;
    pub use crate::resampling::{MERGE_WGSL as MERGE, RESAMPLING_WGSL as RESAMPLING};
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
    fn pairs(&self) -> Vec<(&'static str, f64)> {
        let flag = |b: bool| f64::from(u8::from(b));
        vec![
            ("TWO_LEVEL", flag(self.two_level)),
            ("QUADRICS", flag(self.quadrics)),
            ("COVERAGE", flag(self.coverage)),
            ("TEXTURES", flag(self.textures)),
            ("ENVIRONMENTS", flag(self.environments)),
            ("ANISOTROPIC", flag(self.anisotropic)),
            ("MATERIALS", f64::from(self.materials)),
        ]
    }
}

/// A kernel before it is compiled.
#[derive(Clone, Debug)]
pub(crate) struct Kernel {
    pub(crate) entry: &'static str,
    modules: Vec<&'static str>,
    pub(crate) constants: Vec<(&'static str, f64)>,
    stack: u32,
}

impl Kernel {
    pub(crate) fn new(
        entry: &'static str,
        own: &[&'static str],
        constants: &[(&'static str, f64)],
        scene: &SceneConstants,
    ) -> Self {
        let mut modules = SCENE.to_vec();
        modules.extend_from_slice(own);
        let mut all = scene.pairs();
        all.extend_from_slice(constants);
        Self { entry, modules, constants: all, stack: scene.stack }
    }

    /// The whole module.
    pub(crate) fn source(&self) -> String {
        let mut text = format!("const STACK: u32 = {}u;\n\n", self.stack);
        for module in &self.modules {
            text.push_str(module);
            text.push('\n');
        }
        text
    }

    /// Different for different kernels.
    pub(crate) fn key(&self) -> String {
        let mut hasher = DefaultHasher::new();
        self.source().hash(&mut hasher);
        format!("{} {:?} {:016x}", self.entry, self.constants, hasher.finish())
    }
}
