//! Passes over tiles whose lanes exchange state, with a technique that lives here.
//!
//! In every frame each lane of a tile shows what the lane opposite to it in the tile brings: with
//! an odd number of pixels, partial tiles at the edges and a grid that begins elsewhere in each
//! frame, an exchange through lanes outside of the picture is part of it.

use std::sync::Arc;

use afterimage::Result;
use afterimage::counters::Counters;
use afterimage::frame::{FrameLoop, Stage};
use afterimage::math::rng::Purpose;
use afterimage::pass::{Band, FrameInputs};
use afterimage::plan::{Builder, Claim, Domain, Grid, NewPass, Plan, SceneFacts, Shot};
use afterimage::techniques::Technique;
use rayon::ThreadPoolBuilder;

use crate::support::{bits, room, shot};

const TILE: [u32; 2] = [5, 3];

/// What a lane brings: its place in the tile and its pixel, if it has one.
fn brought(lane: u32, pixel: Option<u32>) -> [f32; 3] {
    [lane as f32, pixel.map_or(-1.0, |index| index as f32), 1.0]
}

#[derive(Debug)]
struct Opposite {
    grid: Grid,
}

impl Technique for Opposite {
    fn spec(&self) -> String {
        "opposite".into()
    }

    fn validate(&self) -> Result<()> {
        Ok(())
    }

    fn plan(&self, facts: &SceneFacts, shot: &Shot) -> Plan {
        let mut plan = Builder::new(self.spec(), facts, shot);
        let [width, height] = TILE;
        let domain = Domain::Tiles { width, height, grid: self.grid };
        let pass = NewPass::pixels("exchange", 0, vec![Plan::RADIANCE]);
        plan.pass(NewPass { domain, ..pass });
        plan.finish(Claim::Biased("it shows numbers of lanes".into()))
    }

    fn run(&self, _kernel: u32, inputs: &FrameInputs<'_>, band: &mut Band<'_>) -> Counters {
        let first = band.range.start * band.width;
        let tiles = band.tiles(inputs.shot.size);
        let radiance: &mut [[f32; 3]] = band.take(Plan::RADIANCE);
        for tile in tiles {
            // All lanes bring something, those outside of the picture among them.
            let lanes = tile.lanes();
            let state: Vec<[f32; 3]> = (0..lanes)
                .map(|lane| brought(lane, tile.pixel(lane).map(|pixel| pixel.index)))
                .collect();
            for lane in 0..lanes {
                if let Some(pixel) = tile.pixel(lane) {
                    let opposite = state[(lanes - 1 - lane) as usize];
                    radiance[(pixel.index - first) as usize] = opposite;
                }
            }
        }
        Counters::default()
    }
}

/// The same picture by the definition, pixel by pixel; the control mirrors in the grid's own rows
/// only when `origin` is right.
fn expected(size: [u32; 2], origin: [u32; 2]) -> Vec<[u32; 3]> {
    let [width, height] = TILE;
    let mut all = Vec::new();
    for y in 0..size[1] {
        for x in 0..size[0] {
            let (gx, gy) = (x + origin[0], y + origin[1]);
            let lane = gy % height * width + gx % width;
            let opposite = width * height - 1 - lane;
            // Where the opposite lane lies in the picture.
            let ox = i64::from(gx / width * width + opposite % width) - i64::from(origin[0]);
            let oy = i64::from(gy / height * height + opposite / width) - i64::from(origin[1]);
            let inside =
                (0..i64::from(size[0])).contains(&ox) && (0..i64::from(size[1])).contains(&oy);
            let pixel = inside.then(|| (oy * i64::from(size[0]) + ox) as u32);
            all.push(brought(opposite, pixel).map(f32::to_bits));
        }
    }
    all
}

#[test]
fn lanes_exchange_state_in_partial_tiles_wherever_the_grid_begins() {
    let stage = Stage::new(room()).unwrap();
    let pools = [1, 2, 64].map(|n| ThreadPoolBuilder::new().num_threads(n).build().unwrap());
    for size in [[1, 1], [13, 7], [33, 18]] {
        for grid in [Grid::Fixed([0, 0]), Grid::Fixed([3, 1]), Grid::PerFrame(Purpose::TileMask)] {
            for pool in &pools {
                pool.install(|| {
                    let shot = shot(size, 2, 1);
                    let technique = Arc::new(Opposite { grid });
                    let mut frames = FrameLoop::new(technique, &stage, shot).unwrap();
                    let mut moved = 0;
                    for frame in 0..6 {
                        let origin = grid.origin(TILE, shot.run, frame);
                        let shown = bits(&frames.render().unwrap().picture());
                        assert_eq!(shown, expected(size, origin), "{size:?} {grid:?} {frame}");
                        // The control: a grid that began one pixel farther would show.
                        let other = [(origin[0] + 1) % TILE[0], origin[1]];
                        moved += u32::from(shown != expected(size, other));
                    }
                    assert_eq!(moved, 6, "{size:?} {grid:?}");
                });
            }
        }
    }
}
