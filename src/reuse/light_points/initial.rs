//! Fresh candidates of each pixel: where they come from, and what a pixel's reservoirs begin with.

use super::candidates::{Candidates, TILE, TileEntry, candidates, fill_tile};
use super::{Chosen, LightMeasure, LightPoints, Receiver, Record};
use crate::accel::HitFilter;
use crate::counters::Counters;
use crate::light::LightPoint;
use crate::math::rng::{Purpose, RandomSource};
use crate::pass::{Band, FrameInputs, Pixel, PrimaryHit};
use crate::path::finite_or_counted;
use crate::plan::{BufferKey, Plan};
use crate::resampling::Finished;
use crate::reuse::passes::{self, Keys, NORMALS};
use crate::reuse::policy::Policy;
use crate::reuse::surfaces::pack_normal;
use crate::reuse::{Control, Domain};

/// Width and height in pixels of the blocks that share a tile of light points.
const TILE_BLOCK: u32 = 8;

/// Light points made ahead.
pub(crate) const TILES: BufferKey<TileEntry> = BufferKey::new("light tiles");

/// Where the candidates of a band come from.
#[derive(Debug)]
pub(crate) struct Sources<'a> {
    inputs: &'a FrameInputs<'a>,
    candidates: Candidates<'a>,
    /// All tiles, and how many there are.
    tiles: &'a [TileEntry],
    count: u32,
    /// The block that the candidates' tile belongs to: neighbours in a row of pixels have the same.
    block: Option<u32>,
}

impl<'a> Sources<'a> {
    /// `candidates` without a tile, and `count` tiles.
    pub(crate) fn new(inputs: &'a FrameInputs<'a>, candidates: Candidates<'a>, count: u32) -> Self {
        let tiles = if count == 0 { &[] } else { inputs.at(TILES) };
        Self { inputs, candidates, tiles, count, block: None }
    }

    /// The candidates for a pixel, whose block of pixels shares a tile.
    #[inline]
    pub(crate) fn at(&mut self, pixel: Pixel) -> &Candidates<'a> {
        if self.count != 0 {
            let columns = self.inputs.shot.size[0].div_ceil(TILE_BLOCK);
            let block = pixel.y / TILE_BLOCK * columns + pixel.x / TILE_BLOCK;
            if self.block != Some(block) {
                // Which tile a block takes; the tiles' own numbers come from round 1 of the same
                // purpose.
                let mut random = self.inputs.stream(block, Purpose::LightTile, 0);
                let tile = random.index(self.count);
                let range = (tile * TILE) as usize..((tile + 1) * TILE) as usize;
                self.candidates.tile = Some(&self.tiles[range]);
                self.block = Some(block);
            }
        }
        &self.candidates
    }
}

/// A pixel's reservoir before it is stored.
struct Fresh {
    finished: Finished<LightPoint, LightMeasure>,
    target: f32,
    bits: u16,
    control: Control,
}

impl<F: HitFilter + Sync, const IN_TARGET: bool> LightPoints<'_, F, IN_TARGET> {
    /// Fills a band of light points made ahead.
    pub(crate) fn tiles(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let items = band.range.clone();
        let entries: &mut [TileEntry] = band.take(self.frame.id(TILES));
        for (item, entry) in items.zip(entries) {
            let mut random = self.frame.stream(item, Purpose::LightTile, 1);
            let words = [random.word(), random.word(), random.word(), random.word()];
            *entry = fill_tile(self.frame.world, words, &mut counters);
        }
        counters
    }

    /// Fills a band of reservoirs with fresh candidates, seen as the policy asks, and the normals
    /// that later passes compare.
    pub(crate) fn initial<P: Policy>(
        &self,
        policy: P,
        mut sources: Sources<'_>,
        band: &mut Band<'_>,
    ) -> Counters {
        let mut counters = Counters::default();
        let inputs = self.frame;
        let chains = inputs.shot.chains();
        let hits = inputs.read::<PrimaryHit>(Plan::HITS);
        let pixels = band.pixels();
        let records: &mut [Record] = band.take(inputs.id(Keys::<Record>::RESERVOIRS));
        let controls: &mut [Control] = band.take_some(inputs.plan.id(passes::CONTROLS));
        let normals: &mut [u32] = band.take_some(inputs.plan.id(NORMALS));
        for (local, pixel) in pixels.enumerate() {
            let own = local * chains as usize..(local + 1) * chains as usize;
            let mut any = false;
            let mut normal = 0;
            if let Some(hit) = hits[pixel.index as usize].get() {
                let receiver = self.receiver(hit, pixel);
                if !normals.is_empty() {
                    normal = pack_normal(self.normal(&receiver));
                }
                any = receiver.scatters();
                if any {
                    let (seeds, from) = (inputs.seeds(pixel.index), sources.at(pixel));
                    let each = from.lights + from.bsdf;
                    for chain in 0..chains {
                        let at = own.start + chain as usize;
                        let mut selection =
                            inputs.stream(pixel.index, Purpose::Selection, chain << 8);
                        let first = (seeds, chain * each);
                        let chosen =
                            candidates(&receiver, from, first, &mut selection, &mut counters);
                        let fresh = self.fresh(policy, &receiver, chosen, &mut counters);
                        records[at] = Record::new(&fresh.finished, fresh.target, 0, fresh.bits);
                        if P::CONTROL {
                            controls[at] = fresh.control;
                        }
                    }
                }
            }
            if !any {
                records[own.clone()].fill(Record::default());
                if P::CONTROL {
                    controls[own].fill(Control::default());
                }
            }
            if let Some(out) = normals.get_mut(local) {
                *out = normal;
            }
        }
        counters
    }

    /// The reservoir of a selected candidate, with what the policy keeps of its visibility.
    #[inline]
    fn fresh<P: Policy>(
        &self,
        policy: P,
        receiver: &Receiver<'_>,
        chosen: Option<Chosen>,
        counters: &mut Counters,
    ) -> Fresh {
        let target = chosen.map_or(0.0, |chosen| chosen.sight.target());
        let finished = chosen.map_or(Finished::empty(1.0), |chosen| chosen.finish(1.0));
        let mut fresh = Fresh { finished, target, bits: 0, control: Control::default() };
        if !P::TRACES_INITIAL {
            return fresh;
        }
        let Some(chosen) = chosen.filter(|_| finished.sample.is_some()) else {
            counters.shadow_rays_saved += 1;
            return fresh;
        };
        let seen = chosen.is_seen(receiver, self.filter, counters);
        if P::DROPS_OCCLUDED && !seen {
            fresh.finished = Finished::empty(1.0);
        }
        fresh.bits = policy.traced(0, seen);
        if P::CONTROL {
            let shown = if seen { finished.weight.get() } else { 0.0 };
            let shown = finite_or_counted(chosen.integrand() * shown, counters);
            fresh.control = Control::new(shown, seen);
        }
        fresh
    }
}
