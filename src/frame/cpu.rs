//! Runs a pass on the threads of the current rayon pool.

use std::ops::Range;

use crate::counters::Counters;
use crate::pass::{Band, Buffer, MAX_WRITES, TileGrid};
use crate::plan::{Domain, Pass, Plan, Shot};

/// Rows of a task over single pixels: small enough to balance, large enough that rays of one task
/// stay near each other.
const ROWS_A_TASK: u32 = 4;
/// Items of a task.
const ITEMS_A_TASK: u32 = 64;

/// Cuts the pass's domain into tasks and runs `kernel` on each, with all buffers readable but those
/// that the pass writes.
///
/// The cut is a binary tree of disjoint mutable slices: no locks, no allocation a task, and sums in
/// an order that does not depend on threads.
pub(super) fn run_pass(
    pass: &Pass,
    plan: &Plan,
    (shot, frame): (&Shot, u32),
    buffers: &mut [Buffer],
    kernel: impl Fn(&[Buffer], &mut Band<'_>) -> Counters + Sync,
) -> Counters {
    let [width, height] = shot.size;
    let grid = match pass.domain {
        Domain::Pixels => Grid { first: ROWS_A_TASK, step: ROWS_A_TASK, end: height, width },
        Domain::Tiles { height: step, .. } => {
            let origin = tiles(pass.domain, shot, frame).map_or(0, |tiles| tiles.origin[1]);
            Grid { first: step - origin, step, end: height, width }
        }
        Domain::Items(n) => Grid { first: ITEMS_A_TASK, step: ITEMS_A_TASK, end: n, width: 1 },
    };
    let tiles = tiles(pass.domain, shot, frame);
    let mut owned: [Vec<u32>; MAX_WRITES] = Default::default();
    let mut stride = [0; MAX_WRITES];
    for (slot, id) in pass.writes.iter().enumerate() {
        owned[slot] = std::mem::take(&mut buffers[id.0].current);
        stride[slot] = (plan.buffers[id.0].bytes / 4) as usize * grid.width as usize;
    }
    let readable: &[Buffer] = buffers;
    let run = |rows: Range<u32>, slots: [&mut [u32]; MAX_WRITES]| {
        let mut band = Band::new(rows, grid.width, &pass.writes, slots);
        if let Some(tiles) = tiles {
            band = band.with_tiles(tiles);
        }
        kernel(readable, &mut band)
    };
    let counters =
        grid.run(0..grid.tasks(), owned.each_mut().map(Vec::as_mut_slice), &stride, &run);
    for (slot, id) in pass.writes.iter().enumerate() {
        buffers[id.0].current = std::mem::take(&mut owned[slot]);
    }
    counters
}

/// The grid of a pass over tiles in a frame.
fn tiles(domain: Domain, shot: &Shot, frame: u32) -> Option<TileGrid> {
    let Domain::Tiles { width, height, grid } = domain else { return None };
    let size = [width, height];
    Some(TileGrid { size, origin: grid.origin(size, shot.run, frame) })
}

/// Rows cut at `first`, `first + step`, …, `end`.
struct Grid {
    first: u32,
    step: u32,
    end: u32,
    width: u32,
}

impl Grid {
    fn tasks(&self) -> u32 {
        if self.end == 0 { 0 } else { 1 + self.end.saturating_sub(self.first).div_ceil(self.step) }
    }

    /// The first row of a task.
    fn row(&self, task: u32) -> u32 {
        if task == 0 { 0 } else { (self.first + (task - 1) * self.step).min(self.end) }
    }

    fn run(
        &self,
        tasks: Range<u32>,
        slices: [&mut [u32]; MAX_WRITES],
        stride: &[usize; MAX_WRITES],
        kernel: &(impl Fn(Range<u32>, [&mut [u32]; MAX_WRITES]) -> Counters + Sync),
    ) -> Counters {
        if tasks.is_empty() {
            return Counters::default();
        }
        if tasks.len() == 1 {
            return kernel(self.row(tasks.start)..self.row(tasks.end), slices);
        }
        let middle = tasks.start + tasks.len() as u32 / 2;
        let rows = (self.row(middle) - self.row(tasks.start)) as usize;
        let mut rest: [&mut [u32]; MAX_WRITES] = Default::default();
        let mut slot = 0;
        let head = slices.map(|slice| {
            let (head, tail) = slice.split_at_mut((rows * stride[slot]).min(slice.len()));
            rest[slot] = tail;
            slot += 1;
            head
        });
        let (a, b) = rayon::join(
            || self.run(tasks.start..middle, head, stride, kernel),
            || self.run(middle..tasks.end, rest, stride, kernel),
        );
        a + b
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::Purpose;
    use crate::plan::{BufferId, BufferPlan, Claim, Elements, Filter, Grid, Kernel};

    fn plan(elements: Elements) -> Plan {
        let buffer = |bytes| BufferPlan { name: "x", bytes, elements, history: false };
        Plan {
            technique: String::new(),
            passes: Vec::new(),
            buffers: vec![buffer(4), buffer(12)],
            skipped: Vec::new(),
            constants: Vec::new(),
            still: false,
            chains: false,
            emitters: false,
            claim: Claim::Unbiased,
        }
    }

    fn shot(size: [u32; 2]) -> Shot {
        Shot { size, depth: 2, filter: Filter::Point, run: 3, effort: 1.0, fps: 30 }
    }

    /// Over many frames: each pixel is in one tile, all of whose pixels are in one band, and grids
    /// begin everywhere.
    #[test]
    fn tiles_cover_the_picture_once_wherever_their_grid_begins() {
        for size in [[1, 1], [7, 3], [17, 23]] {
            let mut origins = std::collections::HashSet::new();
            for frame in 0..64 {
                let grid = Grid::PerFrame(Purpose::TileMask);
                origins.insert(grid.origin([5, 3], 3, frame));
                let pass = Pass {
                    name: "count",
                    kernel: Kernel::Technique(0),
                    domain: Domain::Tiles { width: 5, height: 3, grid },
                    writes: vec![BufferId(0)],
                    runs: crate::plan::Runs::Always,
                    rays: [0; 4],
                };
                let n = (size[0] * size[1]) as usize;
                let mut buffers =
                    vec![Buffer { current: vec![0; n], ..Buffer::default() }, Buffer::default()];
                let shot = shot(size);
                let at = (&shot, frame);
                run_pass(&pass, &plan(Elements::Pixels), at, &mut buffers, |_, band| {
                    let tiles = band.tiles(size);
                    let local = |pixel| band.local(pixel);
                    let places: Vec<Vec<usize>> = tiles
                        .map(|tile| {
                            assert_eq!(tile.lanes(), 15);
                            (0..15).filter_map(|lane| tile.pixel(lane)).map(local).collect()
                        })
                        .collect();
                    let own: &mut [u32] = band.take(BufferId(0));
                    places.into_iter().flatten().for_each(|place| own[place] += 1);
                    Counters::default()
                });
                assert!(buffers[0].current.iter().all(|count| *count == 1), "{size:?}");
            }
            assert_eq!(origins.len(), 15, "each of the 15 origins comes up in 64 frames");
        }
    }

    #[test]
    fn every_element_is_owned_exactly_once_in_every_domain() {
        for size in [[1, 1], [1, 9], [9, 1], [17, 23], [64, 64]] {
            for domain in [
                Domain::Pixels,
                Domain::Tiles { width: 8, height: 8, grid: Grid::Fixed([0, 0]) },
                Domain::Tiles { width: 8, height: 8, grid: Grid::Fixed([3, 5]) },
                Domain::Items(size[0] * size[1]),
            ] {
                let n = (size[0] * size[1]) as usize;
                let elements = if let Domain::Items(n) = domain {
                    Elements::Items(n)
                } else {
                    Elements::Pixels
                };
                let mut buffers = vec![
                    Buffer { current: vec![0; n], ..Buffer::default() },
                    Buffer { current: vec![0; 3 * n], ..Buffer::default() },
                ];
                let pass = Pass {
                    name: "count",
                    kernel: Kernel::Technique(0),
                    domain,
                    writes: vec![BufferId(0), BufferId(1)],
                    runs: crate::plan::Runs::Always,
                    rays: [0; 4],
                };
                let counters =
                    run_pass(&pass, &plan(elements), (&shot(size), 0), &mut buffers, |_, band| {
                        let first = band.range.start * band.width;
                        let length = (band.range.end - band.range.start) * band.width;
                        let one: &mut [u32] = band.take(BufferId(0));
                        let three: &mut [[u32; 3]] = band.take(BufferId(1));
                        assert_eq!((one.len(), three.len()), (length as usize, length as usize));
                        for (i, (a, b)) in one.iter_mut().zip(three).enumerate() {
                            *a += first + i as u32;
                            *b = [*a, 1, 1];
                        }
                        Counters { paths: u64::from(length), ..Counters::default() }
                    });
                assert_eq!(counters.paths, n as u64, "{size:?} {domain:?}");
                assert!(buffers[0].current.iter().enumerate().all(|(i, v)| *v == i as u32));
                assert!(
                    buffers[1].current.chunks(3).enumerate().all(|(i, v)| v == [i as u32, 1, 1])
                );
            }
        }
    }
}
