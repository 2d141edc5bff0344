//! Where candidates come from, settled once a plan: how many, from the light table or from tiles of
//! light points made ahead, with rays to emitters or without.

use super::candidates::{Candidates, TILE};
use super::initial::{Sources, TILES};
use crate::pass::FrameInputs;
use crate::plan::{Builder, Domain, Elements, NewPass, Plan};
use crate::spec::Choice;

/// Pixels for each light point made ahead, and lights from which that pays.
const PIXELS_A_TILE_ENTRY: usize = 4;
const LIGHTS_FOR_TILES: u32 = 1000;
/// Estimates of a pixel from which each draws from the light table. All of a pixel's estimates draw
/// from one tile in a frame, so their errors have a part in common, which more of them do not
/// lessen: on `many_lights`, error times time with 58 estimates was twice that with 2.
const ESTIMATES_WITHOUT_TILES: u32 = 8;

/// Path seeds of other light are numbered from here on, candidates from 0.
pub(crate) const PATHS: u32 = 1 << 31;

/// Names of the plan's constants.
const BSDF_SAMPLES: &str = "bsdf samples";
const EMITTING_SURFACES: &str = "emitting surfaces";
const LIGHT_TILES: &str = "light tiles";

/// Whether light points are made ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LightTiles {
    /// From 1,000 lights on, with fewer than 8 estimates or chains a pixel.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

impl Choice for LightTiles {
    const ALL: &'static [Self] = &[Self::Auto, Self::On, Self::Off];

    fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::On => "on",
            Self::Off => "off",
        }
    }
}

/// The candidates that a technique asks for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Supply {
    /// Light samples an estimate.
    pub(crate) candidates: u32,
    /// BSDF samples an estimate.
    pub(crate) bsdf: u32,
    /// Whether light points are made ahead.
    pub(crate) tiles: LightTiles,
}

/// The candidates that a plan grants, after the scene's lights are known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Supplied {
    /// Light samples an estimate.
    pub(crate) lights: u32,
    /// BSDF samples an estimate.
    pub(crate) bsdf: u32,
    /// Whether they need a ray to emitting surfaces.
    pub(crate) surfaces: bool,
    /// Tiles of light points made ahead; 0: light samples come from the light table.
    pub(crate) tiles: u32,
}

impl Supply {
    /// Settles where candidates come from, with `kernel` to make light points ahead. Gives the
    /// emitter rays of an estimate.
    pub(crate) fn plan(&self, plan: &mut Builder<'_>, kernel: u32) -> u64 {
        let counts = plan.facts.lights;
        let lights = plan.facts.light_count();
        let surfaces = counts.triangles + counts.quadrics > 0;
        let bsdf = if counts.delta < lights { self.bsdf } else { 0 };
        if self.bsdf > 0 && bsdf == 0 {
            plan.skip("BSDF samples", "no direction meets point, spot and distant lights");
        }
        if bsdf > 0 && !surfaces {
            plan.skip("rays of BSDF samples", "all other lights are environments");
        }
        let many_estimates = plan.shot.most_estimates() >= ESTIMATES_WITHOUT_TILES;
        let tiles = match self.tiles {
            LightTiles::On => true,
            LightTiles::Off => false,
            LightTiles::Auto => lights >= LIGHTS_FOR_TILES && !many_estimates,
        };
        let mut tile_count = 0;
        if tiles {
            let entries = plan.shot.pixels().div_ceil(PIXELS_A_TILE_ENTRY) as u32;
            tile_count = entries.div_ceil(TILE).max(1);
            let items = tile_count * TILE;
            let id = plan.buffer(TILES, Elements::Items(items), false);
            let domain = Domain::Items(items);
            plan.pass(NewPass { domain, ..NewPass::pixels("light tiles", kernel, vec![id]) });
        } else if self.tiles == LightTiles::Auto {
            plan.skip(
                "light points made ahead",
                if many_estimates {
                    "8 estimates of a pixel or more would share them"
                } else {
                    "there are fewer than 1,000 lights"
                },
            );
        }
        plan.constant(BSDF_SAMPLES, bsdf);
        plan.constant(EMITTING_SURFACES, surfaces.into());
        plan.constant(LIGHT_TILES, tile_count);
        if bsdf > 0 && surfaces {
            plan.need_emitters();
            u64::from(bsdf)
        } else {
            0
        }
    }

    /// The candidates of a plan that [`Supply::plan`] was a part of.
    pub(crate) fn supplied(&self, plan: &Plan) -> Supplied {
        let fixed = |name| plan.constant(name).expect("the plan fixes what its kernels ask for");
        Supplied {
            lights: self.candidates,
            bsdf: fixed(BSDF_SAMPLES),
            surfaces: fixed(EMITTING_SURFACES) != 0,
            tiles: fixed(LIGHT_TILES),
        }
    }

    /// The candidates of a frame.
    pub(crate) fn sources<'a>(&self, inputs: &'a FrameInputs<'a>) -> Sources<'a> {
        let Supplied { lights, bsdf, surfaces, tiles } = self.supplied(inputs.plan);
        Sources::new(inputs, Candidates { lights, bsdf, tile: None, surfaces }, tiles)
    }
}
