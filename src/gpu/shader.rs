//! Kernels: which modules they are made of, with what the plan and the scene leave out as
//! constants.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use super::compose::Composed;
use super::entry;
use crate::error::{Error, Result};
use crate::plan::Domain;
use crate::twin::{Module, Twin};

/// WGSL that needs nothing of this crate's scene. Each text is part of a module: put together what
/// you need and add your own.
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
    /// Weighted reservoirs, MIS weights, mutated weights, as in [`crate::resampling`].
    pub const RESAMPLING: &str = crate::resampling::RESAMPLING_WGSL.text;
    /// [`crate::resampling::merge()`], and [`merge_history`](crate::resampling::merge_history) with
    /// one other input; its head says what a host adds.
    pub const MERGE: &str = crate::resampling::MERGE_WGSL.text;
    /// What visibility policies keep, as in [`crate::reuse`]: outcomes, averages, estimates.
    pub const VISIBILITY: &str = concat!(
        include_str!("../reuse/policy/stored.wgsl"),
        include_str!("../reuse/policy/wis.wgsl"),
        include_str!("../reuse/control.wgsl")
    );
}

/// What every kernel that knows the scene is made of.
const SCENE: [Module; 10] = [
    crate::wgsl!("../math/rng.wgsl"),
    crate::wgsl!("../math/math.wgsl"),
    crate::wgsl!("../math/warp.wgsl"),
    crate::wgsl!("scene.wgsl"),
    crate::wgsl!("../accel/accel.wgsl"),
    crate::wgsl!("../surface/bsdf.wgsl"),
    crate::wgsl!("../light/light.wgsl"),
    crate::wgsl!("../surface/surface.wgsl"),
    crate::wgsl!("../pass.wgsl"),
    crate::wgsl!("../path/path.wgsl"),
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
    pub(crate) one_sided: bool,
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
            one_sided: self.one_sided || other.one_sided,
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
            ("ONE_SIDED_SHAPES", flag(self.one_sided)),
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

/// A kernel before it is compiled.
#[derive(Clone, Debug)]
pub(crate) struct Shader {
    /// The kernel's function, which the entry point calls.
    pub(crate) name: &'static str,
    domain: Domain,
    modules: Vec<Module>,
    pub(crate) constants: Vec<Constant>,
    /// What directives may ask for besides.
    flags: Vec<Constant>,
    /// What the composer declares.
    names: Vec<(String, u32)>,
    stack: u32,
}

impl Shader {
    pub(crate) fn new(twin: &Twin, domain: Domain, scene: &SceneConstants) -> Self {
        let mut modules = SCENE.to_vec();
        modules.extend_from_slice(&twin.modules);
        let mut constants = scene.pairs();
        constants.extend_from_slice(&twin.constants);
        let flags = scene.flags().into_iter().chain(twin.flags.iter().copied()).collect();
        let (names, stack) = (twin.names.clone(), scene.stack);
        Self { name: twin.kernel, domain, modules, constants, flags, names, stack }
    }

    /// The whole module with its entry point, without what directives leave out.
    ///
    /// # Errors
    /// A directive without its other half, or with a name that nobody declares.
    pub(crate) fn compose(&self) -> Result<Composed> {
        let mut generated = format!("const STACK: u32 = {}u;\n", self.stack);
        for (name, value) in &self.names {
            generated.push_str(&format!("const {name}: u32 = {value}u;\n"));
        }
        generated.push_str(&entry::constants(self.domain));
        let known: HashMap<&str, f64> = self.constants.iter().chain(&self.flags).copied().collect();
        let mut composed = Composed::new(&generated, &self.modules, &known)
            .map_err(|why| Error::gpu(format!("kernel `{}`: {why}", self.name)))?;
        composed.generate(&entry::entry_point(self.domain, self.name));
        Ok(composed)
    }

    /// Different for different kernels.
    pub(crate) fn key(&self, source: &str) -> String {
        let mut hasher = DefaultHasher::new();
        source.hash(&mut hasher);
        format!("{} {:?} {:016x}", self.name, self.constants, hasher.finish())
    }
}
