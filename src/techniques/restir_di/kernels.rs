//! The kernels: each walks over its band's pixels, with the policy and the coverage filter as types.

use glam::{Vec2, Vec3};

use super::{BOILING_TILE, MAX_NEIGHBOURS, RestirDi, TILE_BLOCK, buffer, kernel};
use crate::accel::{Hit, HitFilter};
use crate::counters::Counters;
use crate::direct::{
    Candidates, Chosen, Control, LightMeasure, LightPointMutator, LightPoints, Receiver, Record,
    Reused, TILE, TileEntry, Time, Visibility, candidates, fill_tile, pack_average, unpack_average,
};
use crate::light::LightPoint;
use crate::math::rng::{PathSeeds, Purpose, RandomSource, Stream, path_seed};
use crate::math::{octahedral_decode, octahedral_encode};
use crate::pass::{Band, FrameInputs, PrimaryHit};
use crate::path::{Limits, finite_or_counted, indirect_radiance, sampled, scattered_radiance};
use crate::plan::{BufferId, Plan};
use crate::resampling::{
    ContributionWeight, ControlVariate, DecoupledState, Estimator, Finished, Input, Merged, Others,
    Plain, Reservoir, Selected, SelectedState, ShiftMap, Shifted, WithRadiance, WithVisibility,
    metropolis, mutated_weight, spatial, temporal,
};
use crate::world::WithFilter;

/// The policies as numbers, for kernels that are compiled for one.
mod policy {
    pub(super) const TRACE: u8 = 0;
    pub(super) const IN_TARGET: u8 = 1;
    pub(super) const BITTERLI: u8 = 2;
    pub(super) const REUSE: u8 = 3;
    pub(super) const WIS: u8 = 4;
    pub(super) const CONTROL: u8 = 5;
}

/// Surfaces may be reused where the cosine between normals is at least this, and their distances differ by less than [`DEPTH`] of the own one
/// (Lin et al. 2022's values).
const COSINE: f32 = 0.5;
const DEPTH: f32 = 0.1;
/// Path seeds of other light are numbered from here on, candidates from 0.
const PATHS: u32 = 1 << 31;
/// Factor on the boiling filter's mean at strength 1; at strength s it is 10 / s − 9.
const BOILING: f32 = 10.0;

/// Factor on the boiling filter's mean at a strength above 0.
pub(super) fn boiling_limit(strength: f32) -> f32 {
    // Of a strength that is nearly 0 no limit, but a number.
    (BOILING / strength - (BOILING - 1.0)).min(f32::MAX)
}

/// Runs a kernel over a band.
pub(super) fn run(
    technique: &RestirDi,
    kernel: u32,
    inputs: &FrameInputs<'_>,
    band: &mut Band<'_>,
) -> Counters {
    struct Filtered<'a, 'b, 'c>(&'a RestirDi, u32, &'a FrameInputs<'b>, &'a mut Band<'c>);
    impl WithFilter for Filtered<'_, '_, '_> {
        type Output = Counters;

        fn run<F: HitFilter + Sync>(self, filter: F) -> Counters {
            let Self(technique, kernel, inputs, band) = self;
            let at = Kernels { technique, inputs, filter: &filter };
            match kernel {
                kernel::TILES => return at.tiles(band),
                kernel::RIS => return at.ris(band),
                kernel::PATHS => return at.paths::<false>(band),
                kernel::ALL_PATHS => return at.paths::<true>(band),
                kernel::BOILING => return at.boiling(band),
                _ => {}
            }
            match technique.visibility {
                Visibility::Trace => at.reuse::<{ policy::TRACE }, false>(kernel, band),
                Visibility::InTarget => at.reuse::<{ policy::IN_TARGET }, true>(kernel, band),
                Visibility::Bitterli => at.reuse::<{ policy::BITTERLI }, false>(kernel, band),
                Visibility::Reuse => at.reuse::<{ policy::REUSE }, false>(kernel, band),
                Visibility::Wis => at.reuse::<{ policy::WIS }, false>(kernel, band),
                Visibility::WisControlVariate => {
                    at.reuse::<{ policy::CONTROL }, false>(kernel, band)
                }
            }
        }
    }
    inputs.world.with_filter(Filtered(technique, kernel, inputs, band))
}

/// What all kernels need.
struct Kernels<'a, F> {
    technique: &'a RestirDi,
    inputs: &'a FrameInputs<'a>,
    filter: &'a F,
}

/// A pixel of a band.
#[derive(Clone, Copy)]
struct Pixel {
    index: u32,
    x: u32,
    y: u32,
}

/// A reservoir with its sample's target: where two frames have the same receiver, targets need not be evaluated again.
#[derive(Clone, Copy)]
struct Stored {
    point: LightPoint,
    target: f32,
}

/// The identity between a pixel and itself one frame ago.
struct Same;

impl ShiftMap for Same {
    type Sample = Stored;
    type Domain = ();
    type Integrand = f32;
    type Stratum = ();

    #[inline]
    fn shift(&mut self, sample: &Stored, (): &(), (): &()) -> Option<Shifted<Stored, f32>> {
        Some(Shifted { sample: *sample, integrand: sample.target, jacobian: 1.0 })
    }

    fn stratum(&self, _: &Stored) {}
}

/// The neighbours that fit; a receiver is made when a weight asks for it.
struct Neighbours<'s, 'a, F> {
    kernels: &'s Kernels<'a, F>,
    records: &'s [Record],
    hits: &'s [PrimaryHit],
    /// Pixel, and pixels away.
    found: &'s [(u32, u32)],
}

impl<'a, F: HitFilter + Sync> Others<LightPoint, Receiver<'a>, LightMeasure>
    for Neighbours<'_, 'a, F>
{
    type Domain<'s>
        = Receiver<'a>
    where
        Self: 's;

    #[inline]
    fn count(&self) -> usize {
        self.found.len()
    }

    #[inline]
    fn finished(&self, at: usize) -> Finished<LightPoint, LightMeasure> {
        self.records[self.found[at].0 as usize].finished()
    }

    #[inline]
    fn target(&self, at: usize) -> f32 {
        self.records[self.found[at].0 as usize].target
    }

    #[inline]
    fn domain(&self, at: usize) -> Receiver<'a> {
        let (index, _) = self.found[at];
        let width = self.kernels.inputs.shot.size[0];
        let hit = self.hits[index as usize].get().expect("a surface, since it has confidence");
        self.kernels.receiver(hit, Pixel { index, x: index % width, y: index / width })
    }
}

type Rich = WithRadiance<WithVisibility<Plain<LightPoint>>>;

/// Where a band's candidates come from.
struct Sources<'a> {
    candidates: Candidates<'a>,
    /// All tiles, and how many there are.
    tiles: &'a [TileEntry],
    count: u32,
    /// The block that the candidates' tile belongs to: its neighbours in a row of pixels have the same.
    block: Option<u32>,
}

/// What a pixel has after a merge.
struct Kept {
    record: Record,
    control: Control,
}

fn pixels(band: &Band<'_>) -> impl Iterator<Item = Pixel> + use<> {
    let (rows, width) = (band.range.clone(), band.width);
    rows.flat_map(move |y| (0..width).map(move |x| Pixel { index: y * width + x, x, y }))
}

/// A unit normal in 4 bytes; its error, 10⁻⁴, only decides which neighbours fit.
fn pack_normal(normal: Vec3) -> u32 {
    let p = octahedral_encode(normal) * 32767.0;
    u32::from(p.x.round() as i16 as u16) | u32::from(p.y.round() as i16 as u16) << 16
}

fn unpack_normal(word: u32) -> Vec3 {
    let at = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
    octahedral_decode(Vec2::new(at(word), at(word >> 16)))
}

impl<'a, F: HitFilter + Sync> Kernels<'a, F> {
    fn reuse<const P: u8, const IN_TARGET: bool>(
        &self,
        kernel: u32,
        band: &mut Band<'_>,
    ) -> Counters {
        let still = self.inputs.plan.constant("still") != 0;
        match kernel {
            kernel::INITIAL => self.initial::<P>(band),
            kernel::TEMPORAL if still && P != policy::CONTROL => self.temporal_still::<P>(band),
            kernel::TEMPORAL => self.temporal::<P, IN_TARGET>(band),
            kernel::MUTATE => self.mutate::<P, IN_TARGET>(band),
            kernel::SHADE => self.shade_only::<P>(band),
            round => self.spatial::<P, IN_TARGET>(round - kernel::SPATIAL, band),
        }
    }

    fn stream(&self, pixel: u32, purpose: Purpose, round: u32) -> Stream {
        Stream::new(self.inputs.shot.run, pixel, self.inputs.frame, purpose, round)
    }

    /// The buffer `name`, which the plan has where a kernel asks for it.
    fn id(&self, name: &str) -> BufferId {
        self.inputs.plan.buffer(name).expect("the plan has what its passes read")
    }

    fn direction(&self, pixel: Pixel) -> Vec3 {
        self.inputs.camera.ray(self.inputs.sample_position(pixel.x, pixel.y, 0)).direction
    }

    fn receiver(&self, hit: Hit, pixel: Pixel) -> Receiver<'a> {
        Receiver::new(self.inputs.world, hit, self.direction(pixel), Time::Now)
    }

    /// Where candidates come from; `effort` units of them.
    fn sources(&self, effort: u32) -> Sources<'a> {
        let plan = self.inputs.plan;
        let count = plan.constant("light tiles");
        Sources {
            candidates: Candidates {
                lights: self.technique.candidates,
                bsdf: plan.constant("bsdf samples"),
                rounds: effort,
                tile: None,
                surfaces: plan.constant("emitting surfaces") != 0,
            },
            tiles: if count == 0 { &[] } else { self.inputs.read(self.id(buffer::TILES)) },
            count,
            block: None,
        }
    }

    /// Candidates for a pixel, whose block of pixels shares a tile.
    #[inline]
    fn sources_at<'s>(&self, sources: &'s mut Sources<'a>, pixel: Pixel) -> &'s Candidates<'a> {
        if sources.count != 0 {
            let columns = self.inputs.shot.size[0].div_ceil(TILE_BLOCK);
            let block = pixel.y / TILE_BLOCK * columns + pixel.x / TILE_BLOCK;
            if sources.block != Some(block) {
                // Which tile a block takes; the tiles' own numbers come from round 1 of the same purpose.
                let tile = self.stream(block, Purpose::LightTile, 0).index(sources.count);
                let range = (tile * TILE) as usize..((tile + 1) * TILE) as usize;
                sources.candidates.tile = Some(&sources.tiles[range]);
                sources.block = Some(block);
            }
        }
        &sources.candidates
    }

    fn tiles(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let entries: &mut [TileEntry] = band.take(0);
        for (item, entry) in band.range.clone().zip(entries) {
            let mut random = self.stream(item, Purpose::LightTile, 1);
            let words = [random.word(), random.word(), random.word(), random.word()];
            *entry = fill_tile(self.inputs.world, words, &mut counters);
        }
        counters
    }

    fn ris(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (shot, hits) = (self.inputs.shot, self.inputs.read::<PrimaryHit>(Plan::HITS));
        let radiance: &mut [[f32; 3]] = band.take(0);
        let mut sources = self.sources(1);
        for (pixel, out) in pixels(band).zip(radiance) {
            let mut sum = Vec3::ZERO;
            if let Some(hit) = hits[pixel.index as usize].get() {
                let receiver = self.receiver(hit, pixel);
                if receiver.scatters() {
                    let sources = self.sources_at(&mut sources, pixel);
                    let seeds = PathSeeds::new(shot.run, pixel.index, self.inputs.frame);
                    let each = sources.lights + sources.bsdf;
                    for estimate in 0..shot.effort {
                        let mut selection = self.stream(pixel.index, Purpose::Selection, estimate);
                        let first = (seeds, estimate * each);
                        let chosen =
                            candidates(&receiver, sources, first, &mut selection, &mut counters);
                        sum += match chosen {
                            Some(chosen) if self.sees(&receiver, &chosen, &mut counters) => {
                                let weight = chosen.finish(1.0).weight.get();
                                finite_or_counted(chosen.integrand() * weight, &mut counters)
                            }
                            Some(_) => Vec3::ZERO,
                            None => {
                                counters.shadow_rays_saved += 1;
                                Vec3::ZERO
                            }
                        };
                    }
                }
            }
            *out = (sum / shot.effort as f32).to_array();
        }
        counters
    }

    #[inline]
    fn sees(&self, receiver: &Receiver<'_>, chosen: &Chosen, counters: &mut Counters) -> bool {
        receiver.sees(chosen.sight.arrival.direction, &chosen.emitter, self.filter, counters)
    }

    /// Whether a light point of this frame is seen, with its integrand: one shadow ray, none where the integrand is 0.
    #[inline]
    fn look(
        &self,
        receiver: &Receiver<'_>,
        point: LightPoint,
        counters: &mut Counters,
    ) -> (Vec3, bool) {
        match receiver.look(point) {
            Some((sight, emitter)) => {
                let direction = sight.arrival.direction;
                (sight.integrand, receiver.sees(direction, &emitter, self.filter, counters))
            }
            None => {
                counters.shadow_rays_saved += 1;
                (Vec3::ZERO, false)
            }
        }
    }

    fn initial<const P: u8>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (shot, hits) = (self.inputs.shot, self.inputs.read::<PrimaryHit>(Plan::HITS));
        let records: &mut [Record] = band.take(0);
        let mut slot = 1;
        let mut next = || {
            slot += 1;
            slot - 1
        };
        let controls: &mut [Control] =
            if P == policy::CONTROL { band.take(next()) } else { &mut [] };
        let normals: &mut [u32] = band.take(next());
        let mut sources = self.sources(shot.effort);
        for (local, pixel) in pixels(band).enumerate() {
            let (mut record, mut control, mut normal) = (Record::default(), Control::default(), 0);
            if let Some(hit) = hits[pixel.index as usize].get() {
                let receiver = self.receiver(hit, pixel);
                if !normals.is_empty() {
                    normal = pack_normal(receiver.surface().0.frame.normal);
                }
                if receiver.scatters() {
                    let seeds = PathSeeds::new(shot.run, pixel.index, self.inputs.frame);
                    let mut selection = self.stream(pixel.index, Purpose::Selection, 0);
                    let chosen = candidates(
                        &receiver,
                        self.sources_at(&mut sources, pixel),
                        (seeds, 0),
                        &mut selection,
                        &mut counters,
                    );
                    let target = chosen.map_or(0.0, |c| c.sight.target());
                    let mut finished = chosen.map_or(Finished::empty(1.0), |c| c.finish(1.0));
                    let mut kept = 0;
                    match chosen.filter(|_| finished.sample.is_some()) {
                        Some(chosen) if P != policy::TRACE => {
                            let seen = self.sees(&receiver, &chosen, &mut counters);
                            match P {
                                policy::IN_TARGET | policy::BITTERLI if !seen => {
                                    finished = Finished::empty(1.0);
                                }
                                policy::REUSE => kept = Reused::fresh(seen).pack(),
                                policy::WIS => kept = pack_average(f32::from(u8::from(seen))),
                                policy::CONTROL => {
                                    let shown = if seen { finished.weight.get() } else { 0.0 };
                                    let shown = chosen.integrand() * shown;
                                    let shown = finite_or_counted(shown, &mut counters);
                                    control = Control::new(shown, seen);
                                }
                                _ => {}
                            }
                        }
                        _ => counters.shadow_rays_saved += u64::from(P != policy::TRACE),
                    }
                    record = Record::new(&finished, target, 0, kept);
                }
            }
            records[local] = record;
            if P == policy::CONTROL {
                controls[local] = control;
            }
            if !normals.is_empty() {
                normals[local] = normal;
            }
        }
        counters
    }

    /// Temporal reuse where nothing moves: the same pixel, the same receiver, the targets that are stored.
    fn temporal_still<const P: u8>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let records: &mut [Record] = band.take(0);
        let history = self.history::<Record>(buffer::HISTORY, buffer::RESERVOIRS);
        let cap = self.technique.cap as f32;
        for (pixel, record) in pixels(band).zip(records) {
            let previous = self.aged(history[pixel.index as usize]);
            if record.confidence() == 0.0 || previous.confidence() == 0.0 {
                continue;
            }
            counters.temporal_merges += 1;
            let input = |record: &Record| {
                let Finished { sample, weight, confidence } = record.finished();
                let sample = sample.map(|point| Stored { point, target: record.target });
                Input {
                    finished: Finished { sample, weight, confidence },
                    target: record.target,
                    domain: &(),
                }
            };
            let mut reservoir = WithVisibility::<Plain<Stored>>::default();
            let averages = [record, &previous].map(|r| match P {
                policy::WIS => unpack_average(r.visibility()),
                _ => 0.0,
            });
            let merged = temporal(
                &mut Same,
                (self.technique.temporal_mis, cap),
                &input(record),
                &input(&previous),
                &mut reservoir,
                &mut self.stream(pixel.index, Purpose::Selection, 1),
                |term| ((), averages[term.input]),
            );
            counters.weights_rejected += u64::from(reservoir.rejected());
            let Finished { sample, weight, confidence } = merged.finished;
            let finished = Finished { sample: sample.map(|s| s.point), weight, confidence };
            let (age, kept) = self.inherited::<P>(record, &previous, merged.source, &reservoir);
            *record = Record::new(&finished, merged.target, age, kept);
        }
        counters
    }

    /// Age and visibility bits after a temporal merge.
    #[inline]
    fn inherited<const P: u8>(
        &self,
        record: &Record,
        previous: &Record,
        source: usize,
        reservoir: &WithVisibility<impl Reservoir>,
    ) -> (u32, u16) {
        let (age, kept) = match source {
            0 => (record.age(), record.visibility()),
            _ if P == policy::REUSE => {
                let moved = Reused::unpack(previous.visibility()).moved(1, 0);
                (previous.age() + 1, moved.pack())
            }
            _ => (previous.age() + 1, previous.visibility()),
        };
        (age, if P == policy::WIS { pack_average(reservoir.visibility()) } else { kept })
    }

    /// A record of the last frame, without its sample where that is too old.
    #[inline]
    fn aged(&self, previous: Record) -> Record {
        let max_age = self.technique.max_age;
        if max_age > 0 && previous.age() >= max_age { previous.emptied() } else { previous }
    }

    /// What the last frame left: a buffer of its own with spatial reuse, else the reservoirs' other half.
    fn history<T: bytemuck::Pod>(&self, with_spatial: &str, without: &str) -> &'a [T] {
        match self.inputs.plan.buffer(with_spatial) {
            Some(id) => self.inputs.read(id),
            None => self.inputs.read_previous(self.id(without)),
        }
    }

    fn temporal<const P: u8, const IN_TARGET: bool>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let records: &mut [Record] = band.take(0);
        let controls: &mut [Control] = if P == policy::CONTROL { band.take(1) } else { &mut [] };
        let hits = self.inputs.read::<PrimaryHit>(Plan::HITS);
        let history = self.history::<Record>(buffer::HISTORY, buffer::RESERVOIRS);
        let history_controls: &[Control] = if P == policy::CONTROL {
            self.history(buffer::HISTORY_CONTROLS, buffer::CONTROLS)
        } else {
            &[]
        };
        let still = self.inputs.plan.constant("still") != 0;
        let remap = self.inputs.motion.and_then(|motion| motion.lights.as_ref());
        let mut map = LightPoints::<F, IN_TARGET>::new(self.filter, remap);
        for (local, pixel) in pixels(band).enumerate() {
            let record = &mut records[local];
            let Some(hit) = hits[pixel.index as usize].get() else { continue };
            if record.confidence() == 0.0 {
                continue;
            }
            let receiver = self.receiver(hit, pixel);
            let found = if still {
                Some((pixel.index, None))
            } else {
                self.reproject(&receiver, &hit, pixel).map(|(at, before)| (at, Some(before)))
            };
            let Some((at, before)) = found else {
                counters.reuse_rejected += 1;
                continue;
            };
            let before = before.as_ref().unwrap_or(&receiver);
            let previous = self.aged(history[at as usize]);
            if previous.confidence() == 0.0 {
                continue;
            }
            counters.temporal_merges += 1;
            let canonical = input(record, &receiver);
            let past = input(&previous, before);
            let own_visible = P == policy::CONTROL && controls[local].visible();
            // The visibility of the history's sample here and now, once it was asked for.
            let mut past_visible = false;
            let mut reservoir = Rich::default();
            let averages = [record.visibility(), previous.visibility()].map(|bits| match P {
                policy::WIS => unpack_average(bits),
                _ => 0.0,
            });
            let merged = temporal(
                &mut map,
                (self.technique.temporal_mis, self.technique.cap as f32),
                &canonical,
                &past,
                &mut reservoir,
                &mut self.stream(pixel.index, Purpose::Selection, 1),
                |term| {
                    let mut shown = Vec3::ZERO;
                    if P == policy::CONTROL {
                        let (integrand, visible) = match &term.shifted {
                            None => (own_integrand(&receiver, &canonical), own_visible),
                            Some(shifted) if still => {
                                past_visible = history_controls[at as usize].visible();
                                (shifted.integrand, past_visible)
                            }
                            Some(shifted) => {
                                let (_, seen) = self.look(&receiver, shifted.sample, &mut counters);
                                past_visible = seen;
                                (shifted.integrand, seen)
                            }
                        };
                        if visible {
                            shown = integrand * term.contribution;
                        }
                    }
                    (((), averages[term.input]), shown)
                },
            );
            counters.weights_rejected += u64::from(reservoir.rejected());
            let (age, kept) =
                self.inherited::<P>(record, &previous, merged.source, reservoir.inner());
            if P == policy::CONTROL {
                // C = Σ m F W + a (C̄ − F̃), with F̃ the history's own contribution where C̄ was made.
                let past_control = history_controls[at as usize];
                let then = match past.finished.sample {
                    Some(point) if past_control.visible() => {
                        before.look(point).map_or(Vec3::ZERO, |(sight, _)| sight.integrand)
                            * past.finished.weight.get()
                    }
                    _ => Vec3::ZERO,
                };
                let capped = past.finished.confidence.min(self.technique.cap as f32);
                let share = capped / (capped + canonical.finished.confidence);
                let estimate = ControlVariate::radiance(&DecoupledState {
                    radiance: reservoir.radiance(),
                    correction: share * (past_control.estimate() - then),
                });
                let estimate = finite_or_counted(estimate, &mut counters);
                let visible = if merged.source == 0 { own_visible } else { past_visible };
                controls[local] = Control::new(estimate, visible);
            }
            *record = Record::new(&merged.finished, merged.target, age, kept);
        }
        counters + map.counters
    }

    /// The pixel of the last frame that saw a receiver's surface, and the receiver there; `None` where another surface was.
    fn reproject(
        &self,
        receiver: &Receiver<'_>,
        hit: &Hit,
        pixel: Pixel,
    ) -> Option<(u32, Receiver<'a>)> {
        let inputs = self.inputs;
        let (previous, motion) = (inputs.previous?, inputs.motion?);
        let then = motion.position(previous, inputs.world, hit)?;
        let moved = motion.projection.project(then)? - inputs.sample_position(pixel.x, pixel.y, 0);
        // Rounded to a neighbour with a probability in proportion to its overlap, so that no pixel keeps being missed.
        let mut random = self.stream(pixel.index, Purpose::TemporalRounding, 0);
        let x = (pixel.x as f32 + moved.x + random.uniform()).floor();
        let y = (pixel.y as f32 + moved.y + random.uniform()).floor();
        let [width, height] = inputs.shot.size;
        if !(x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32) {
            return None;
        }
        let (x, y) = (x as u32, y as u32);
        let at = y * width + x;
        let past = inputs.read_previous::<PrimaryHit>(Plan::HITS)[at as usize].get()?;
        let normals = inputs.read_previous::<u32>(self.id(buffer::NORMALS));
        let normal = receiver.surface().0.frame.normal;
        let distance = motion.projection.distance(then);
        let fits = normal.dot(unpack_normal(normals[at as usize])) >= COSINE
            && (past.t - distance).abs() < DEPTH * distance;
        let position = inputs.sample_position_in(inputs.frame.wrapping_sub(1), x, y, 0);
        let direction = motion.camera.ray(position).direction;
        fits.then(|| (at, Receiver::new(previous, past, direction, Time::Before)))
    }

    /// Drops reservoirs that are far brighter than their tile's mean (Wyman and Panteleev 2021's boiling filter). Biased.
    fn boiling(&self, band: &mut Band<'_>) -> Counters {
        let records: &mut [Record] = band.take(0);
        let width = band.width;
        let rows = band.range.end - band.range.start;
        let limit = boiling_limit(self.technique.boiling);
        for left in (0..width).step_by(BOILING_TILE as usize) {
            let lanes = || {
                (0..rows).flat_map(move |y| {
                    (left..(left + BOILING_TILE).min(width)).map(move |x| (y * width + x) as usize)
                })
            };
            let (mut sum, mut count) = (0.0_f64, 0_u32);
            for at in lanes() {
                let weight = shown_luminance(&records[at]);
                if weight > 0.0 {
                    sum += f64::from(weight);
                    count += 1;
                }
            }
            let mean = (sum / f64::from(count.max(1))) as f32;
            for at in lanes() {
                if shown_luminance(&records[at]) > limit * mean {
                    records[at] = records[at].emptied();
                }
            }
        }
        Counters::default()
    }

    fn mutate<const P: u8, const IN_TARGET: bool>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let records: &mut [Record] = band.take(0);
        let controls: &mut [Control] = if P == policy::CONTROL { band.take(1) } else { &mut [] };
        let hits = self.inputs.read::<PrimaryHit>(Plan::HITS);
        for (local, pixel) in pixels(band).enumerate() {
            let record = &mut records[local];
            let (Some(hit), Finished { sample: Some(point), weight, confidence }) =
                (hits[pixel.index as usize].get(), record.finished())
            else {
                continue;
            };
            let receiver = self.receiver(hit, pixel);
            let mut mutator = LightPointMutator::<F, IN_TARGET> {
                receiver: &receiver,
                filter: self.filter,
                large: self.technique.large_steps,
                counters: Counters::default(),
            };
            // It was drawn with a positive target, which only rounding can take from it.
            let Some(start) = mutator.start(point) else { continue };
            let mut random = self.stream(pixel.index, Purpose::Mutation, 0);
            let chain = metropolis(&mut mutator, start, self.technique.mutations, &mut random);
            counters = counters + mutator.counters;
            counters.mutations_accepted += u64::from(chain.accepted);
            if chain.accepted == 0 {
                continue;
            }
            let moved = mutated_weight(weight.get(), start.target(), chain.state.target());
            let finished: Finished<LightPoint, LightMeasure> = if moved > 0.0 {
                let weight = ContributionWeight::new(moved);
                Finished { sample: Some(chain.state.point), weight, confidence }
            } else {
                Finished::empty(confidence)
            };
            let mut kept = record.visibility();
            if P == policy::REUSE || P == policy::CONTROL {
                // What the ray to the old point said is not true of the new one. An average belongs to all samples and stays.
                let (_, seen) = self.look(&receiver, chain.state.point, &mut counters);
                if P == policy::REUSE {
                    kept = Reused::fresh(seen).pack();
                } else {
                    controls[local] = Control::new(controls[local].estimate(), seen);
                }
            }
            *record = Record::new(&finished, chain.state.target(), record.age(), kept);
        }
        counters
    }

    fn spatial<const P: u8, const IN_TARGET: bool>(
        &self,
        round: u32,
        band: &mut Band<'_>,
    ) -> Counters {
        let mut counters = Counters::default();
        let last = round + 1 == self.technique.rounds;
        let out: &mut [Record] = band.take(0);
        let mut slot = 1;
        let mut next = || {
            slot += 1;
            slot - 1
        };
        let control_out: &mut [Control] =
            if P == policy::CONTROL { band.take(next()) } else { &mut [] };
        let radiance: &mut [[f32; 3]] = if last { band.take(next()) } else { &mut [] };
        let from = match round {
            0 => buffer::RESERVOIRS,
            odd if odd % 2 == 1 => buffer::BOUNCE,
            _ => buffer::RESERVOIRS,
        };
        let records = self.inputs.read::<Record>(self.id(from));
        // Rounds before the last update the estimates in place; the last one reads them beside what it writes.
        let controls: &[Control] = if P == policy::CONTROL && last {
            self.inputs.read(self.id(buffer::CONTROLS))
        } else {
            &[]
        };
        let hits = self.inputs.read::<PrimaryHit>(Plan::HITS);
        let normals = self.inputs.read::<u32>(self.id(buffer::NORMALS));
        let mut map = LightPoints::<F, IN_TARGET>::new(self.filter, None);
        for (local, pixel) in pixels(band).enumerate() {
            let record = records[pixel.index as usize];
            let hit = hits[pixel.index as usize].get().filter(|_| record.confidence() > 0.0);
            let Some(hit) = hit else {
                out[local] = Record::default();
                if P == policy::CONTROL {
                    control_out[local] = Control::default();
                }
                if last {
                    radiance[local] = [0.0; 3];
                }
                continue;
            };
            let control = match P {
                policy::CONTROL if last => controls[pixel.index as usize],
                policy::CONTROL => control_out[local],
                _ => Control::default(),
            };
            let receiver = self.receiver(hit, pixel);
            let (kept, shown) = self.merge_neighbours::<P, IN_TARGET>(
                (round, pixel, &receiver),
                (&record, control),
                (records, hits, normals),
                &mut map,
                &mut counters,
            );
            out[local] = kept.record;
            if P == policy::CONTROL {
                control_out[local] = kept.control;
            }
            if last {
                radiance[local] = finite_or_counted(shown, &mut counters).to_array();
            }
        }
        counters + map.counters
    }

    /// Spatial reuse of one pixel: what it keeps, and what it shows.
    #[inline]
    fn merge_neighbours<const P: u8, const IN_TARGET: bool>(
        &self,
        (round, pixel, receiver): (u32, Pixel, &Receiver<'a>),
        (record, control): (&Record, Control),
        (records, hits, normals): (&[Record], &[PrimaryHit], &[u32]),
        map: &mut LightPoints<'a, F, IN_TARGET>,
        counters: &mut Counters,
    ) -> (Kept, Vec3) {
        let last = round + 1 == self.technique.rounds;
        let decoupled = last && self.technique.decoupled;
        let mut found = [(0_u32, 0_u32); MAX_NEIGHBOURS];
        let mut count = 0;
        let own = hits[pixel.index as usize].distance();
        let normal = unpack_normal(normals[pixel.index as usize]);
        let mut random = self.stream(pixel.index, Purpose::Neighbours, round);
        for _ in 0..self.technique.neighbours {
            let Some((at, distance)) = self.neighbour(pixel, &mut random) else {
                counters.reuse_rejected += 1;
                continue;
            };
            let fits = records[at as usize].confidence() > 0.0
                && (hits[at as usize].distance() - own).abs() < DEPTH * own
                && normal.dot(unpack_normal(normals[at as usize])) >= COSINE;
            if fits {
                found[count] = (at, distance);
                count += 1;
            } else {
                counters.reuse_rejected += 1;
            }
        }
        counters.spatial_merges += count as u64;
        let found = &found[..count];
        let others = Neighbours { kernels: self, records, hits, found };
        let canonical = input(record, receiver);
        let own_average = match P {
            policy::WIS => unpack_average(record.visibility()),
            _ => 0.0,
        };
        let mut seen = [false; MAX_NEIGHBOURS + 1];
        let mut own_stored = Reused::unpack(record.visibility());
        let mut rays = Counters::default();
        let mut reservoir = Rich::default();
        let merged = spatial(
            map,
            self.technique.mis,
            &canonical,
            &others,
            &mut reservoir,
            &mut self.stream(pixel.index, Purpose::Selection, 16 + round),
            |term| {
                let traced = match P {
                    policy::WIS | policy::CONTROL => true,
                    policy::IN_TARGET => false,
                    _ => decoupled,
                };
                let mut shown = Vec3::ZERO;
                let mut visibility = own_average;
                if let Some(shifted) = &term.shifted {
                    let visible = !traced || self.look(receiver, shifted.sample, &mut rays).1;
                    seen[term.input] = visible;
                    visibility = f32::from(u8::from(visible));
                    if (P == policy::CONTROL || decoupled) && visible {
                        shown = shifted.integrand * term.contribution;
                    }
                } else if P == policy::CONTROL || decoupled {
                    let visible = match P {
                        policy::CONTROL => control.visible(),
                        policy::IN_TARGET => true,
                        policy::REUSE => {
                            own_stored = self.stored(own_stored, receiver, &canonical, &mut rays);
                            own_stored.visible
                        }
                        _ => canonical
                            .finished
                            .sample
                            .is_some_and(|point| self.look(receiver, point, &mut rays).1),
                    };
                    seen[0] = visible;
                    if visible {
                        shown = own_integrand(receiver, &canonical) * term.contribution;
                    }
                }
                (((), visibility), shown)
            },
        );
        *counters = *counters + rays;
        counters.weights_rejected += u64::from(reservoir.rejected());
        let source = merged.source;
        let (mut age, mut kept) = (record.age(), record.visibility());
        if source > 0 {
            let (at, distance) = found[source - 1];
            let other = &records[at as usize];
            age = other.age();
            if P == policy::REUSE {
                kept = if decoupled {
                    Reused::fresh(seen[source]).pack()
                } else {
                    Reused::unpack(other.visibility()).moved(0, distance).pack()
                };
            }
        } else if P == policy::REUSE && decoupled {
            kept = own_stored.pack();
        }
        if P == policy::WIS {
            kept = pack_average(reservoir.inner().visibility());
        }
        let mut control_kept = control;
        if P == policy::CONTROL {
            // F̃ is the own sample's contribution: the receiver has not changed since C̄ was made.
            let then = if control.visible() {
                own_integrand(receiver, &canonical) * canonical.finished.weight.get()
            } else {
                Vec3::ZERO
            };
            let share = canonical.finished.confidence / merged.finished.confidence;
            let estimate = ControlVariate::radiance(&DecoupledState {
                radiance: reservoir.radiance(),
                correction: share * (control.estimate() - then),
            });
            let estimate = finite_or_counted(estimate, counters);
            let visible = if source == 0 { control.visible() } else { seen[source] };
            control_kept = Control::new(estimate, visible);
        }
        let mut shown = Vec3::ZERO;
        if last {
            shown = match P {
                policy::CONTROL => control_kept.estimate(),
                _ if decoupled => reservoir.radiance(),
                _ => self.shade::<P>(receiver, &merged, &mut kept, counters),
            };
        }
        let record = Record::new(&merged.finished, merged.target, age, kept);
        (Kept { record, control: control_kept }, shown)
    }

    /// f(Y) V W of a finished reservoir; a ray where the policy asks for one, whose outcome `kept` then holds.
    #[inline]
    fn shade<const P: u8>(
        &self,
        receiver: &Receiver<'_>,
        merged: &Merged<LightPoint, Vec3, LightMeasure>,
        kept: &mut u16,
        counters: &mut Counters,
    ) -> Vec3 {
        let Some(point) = merged.finished.sample else {
            counters.shadow_rays_saved += u64::from(P != policy::IN_TARGET && P != policy::WIS);
            return Vec3::ZERO;
        };
        let weight = merged.finished.weight.get();
        if P == policy::IN_TARGET || P == policy::WIS {
            let visibility = if P == policy::WIS { unpack_average(*kept) } else { 1.0 };
            // Known already where a neighbour's sample was chosen.
            let integrand = merged.integrand.or_else(|| Some(receiver.look(point)?.0.integrand));
            let integrand = integrand.unwrap_or(Vec3::ZERO);
            return Selected::radiance(&SelectedState { integrand, visibility, weight });
        }
        let Some((sight, emitter)) = receiver.look(point) else { return Vec3::ZERO };
        let stored = Reused::unpack(*kept);
        let visible = if P == policy::REUSE && self.usable(stored) {
            counters.shadow_rays_saved += 1;
            stored.visible
        } else {
            let direction = sight.arrival.direction;
            let visible = receiver.sees(direction, &emitter, self.filter, counters);
            if P == policy::REUSE {
                *kept = Reused::fresh(visible).pack();
            }
            visible
        };
        let visibility = f32::from(u8::from(visible));
        Selected::radiance(&SelectedState { integrand: sight.integrand, visibility, weight })
    }

    fn usable(&self, stored: Reused) -> bool {
        let RestirDi { visibility, visibility_age, visibility_distance, .. } = *self.technique;
        visibility == Visibility::Reuse && stored.usable(visibility_age, visibility_distance)
    }

    /// The stored outcome of the own sample, as old as it is, or a ray's where it may not be used.
    fn stored(
        &self,
        stored: Reused,
        receiver: &Receiver<'_>,
        canonical: &Input<'_, LightPoint, Receiver<'_>, LightMeasure>,
        counters: &mut Counters,
    ) -> Reused {
        if self.usable(stored) {
            return stored;
        }
        let sample = canonical.finished.sample;
        Reused::fresh(sample.is_some_and(|point| self.look(receiver, point, counters).1))
    }

    /// A pixel within the radius, with its distance; `None` outside of the picture or at the pixel itself.
    #[inline]
    fn neighbour(&self, pixel: Pixel, random: &mut Stream) -> Option<(u32, u32)> {
        let radius = self.technique.radius * random.uniform().sqrt();
        let (sin, cos) = crate::math::warp::sin_cos_turn(random.uniform());
        let (dx, dy) = ((radius * cos).round() as i64, (radius * sin).round() as i64);
        let (x, y) = (i64::from(pixel.x) + dx, i64::from(pixel.y) + dy);
        let [width, height] = self.inputs.shot.size.map(i64::from);
        let inside = (0..width).contains(&x) && (0..height).contains(&y) && (dx, dy) != (0, 0);
        inside.then(|| ((y * width + x) as u32, dx.abs().max(dy.abs()) as u32))
    }

    /// Shades what temporal reuse left, where there is no spatial pass.
    fn shade_only<const P: u8>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let radiance: &mut [[f32; 3]] = band.take(0);
        let records = self.inputs.read::<Record>(self.id(buffer::RESERVOIRS));
        let controls: &[Control] =
            if P == policy::CONTROL { self.inputs.read(self.id(buffer::CONTROLS)) } else { &[] };
        let hits = self.inputs.read::<PrimaryHit>(Plan::HITS);
        for (pixel, out) in pixels(band).zip(radiance) {
            let record = records[pixel.index as usize];
            let hit = hits[pixel.index as usize].get().filter(|_| record.confidence() > 0.0);
            let shown = match hit {
                None => Vec3::ZERO,
                Some(_) if P == policy::CONTROL => controls[pixel.index as usize].estimate(),
                Some(hit) => {
                    let merged = Merged {
                        finished: record.finished(),
                        target: record.target,
                        source: 0,
                        integrand: None,
                    };
                    let mut kept = record.visibility();
                    self.shade::<P>(&self.receiver(hit, pixel), &merged, &mut kept, &mut counters)
                }
            };
            *out = finite_or_counted(shown, &mut counters).to_array();
        }
        counters
    }

    /// The path tracer's share: all light, or what is left beside the resampled light, which is there already.
    fn paths<const ALL: bool>(&self, band: &mut Band<'_>) -> Counters {
        let mut counters = Counters::default();
        let (shot, hits) = (self.inputs.shot, self.inputs.read::<PrimaryHit>(Plan::HITS));
        let limits = Limits { depth: shot.depth, roulette_after: self.technique.roulette_after };
        let radiance: &mut [[f32; 3]] = band.take(0);
        for (pixel, out) in pixels(band).zip(radiance) {
            let mut sum = Vec3::ZERO;
            if let Some(hit) = hits[pixel.index as usize].get() {
                let primary = (self.direction(pixel), &hit);
                for sample in 0..shot.effort {
                    let number = if ALL { sample } else { PATHS + sample };
                    let seed = path_seed(shot.run, pixel.index, self.inputs.frame, number);
                    let world = self.inputs.world;
                    let path = if ALL {
                        scattered_radiance::<{ sampled::ONE }, F>(
                            world,
                            self.filter,
                            seed,
                            primary,
                            limits,
                            &mut counters,
                        )
                    } else {
                        indirect_radiance(world, self.filter, seed, primary, limits, &mut counters)
                    };
                    sum += finite_or_counted(path, &mut counters);
                }
            }
            // As `nee` does it, whose bits these are where there is one light.
            let mean = sum * (1.0 / shot.effort as f32);
            *out = if ALL { mean } else { Vec3::from(*out) + mean }.to_array();
        }
        counters
    }
}

/// A record as an input of a merge.
#[inline]
fn input<'d, 'a>(
    record: &Record,
    domain: &'d Receiver<'a>,
) -> Input<'d, LightPoint, Receiver<'a>, LightMeasure> {
    Input { finished: record.finished(), target: record.target, domain }
}

/// F of an input's own sample at its own receiver.
#[inline]
fn own_integrand(
    receiver: &Receiver<'_>,
    input: &Input<'_, LightPoint, Receiver<'_>, LightMeasure>,
) -> Vec3 {
    input
        .finished
        .sample
        .and_then(|point| receiver.look(point))
        .map_or(Vec3::ZERO, |(sight, _)| sight.integrand)
}

/// p̂ W: what a reservoir would show of luminance without visibility.
#[inline]
fn shown_luminance(record: &Record) -> f32 {
    record.target * record.finished().weight.get()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normals_come_back_to_a_ten_thousandth() {
        for n in [Vec3::X, -Vec3::Y, Vec3::Z, -Vec3::Z, Vec3::new(0.3, -0.8, -0.2).normalize()] {
            assert!((unpack_normal(pack_normal(n)) - n).length() < 2e-4, "{n}");
        }
    }
}
