//! Rungs: how a technique is tested part by part (`verify --ladder`).

/// What moves in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Moving {
    /// Nothing.
    Still,
    /// The camera.
    Camera,
    /// Lights, with or without a surface.
    Light,
    /// Surfaces that do not emit: all that the scene moves; in a still scene the smallest.
    Occluder,
    /// Everything that the scene moves; in a still one camera, lights and occluder.
    All,
}

impl Moving {
    /// Whether `thing` moves.
    #[must_use]
    pub fn has(self, thing: Self) -> bool {
        self == thing || self == Self::All
    }
}

/// A rung of a technique's ladder: parameters, and what moves. Each rung adds one part to those
/// before, as far as a line can, so that the first rung that fails names the part that is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rung {
    /// For people, and to choose it by.
    pub name: &'static str,
    /// Parameters as in a SPEC, `key=value,key=value`. They win over those of the SPEC that is
    /// tested.
    pub keys: &'static str,
    /// What moves in the scenes that it stands on.
    pub moving: Moving,
}

impl Rung {
    /// The rungs of a technique that has none of its own.
    pub const DEFAULT: &'static [Self] = &[
        Self::new("still", "", Moving::Still),
        Self::new("moving camera", "", Moving::Camera),
        Self::new("moving light", "", Moving::Light),
        Self::new("moving occluder", "", Moving::Occluder),
        Self::new("moving all", "", Moving::All),
    ];

    /// A rung, on a line.
    #[must_use]
    pub const fn new(name: &'static str, keys: &'static str, moving: Moving) -> Self {
        Self { name, keys, moving }
    }
}
