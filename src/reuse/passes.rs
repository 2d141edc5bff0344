//! Which passes of reuse run, which buffers they have, and which of them a round reads and writes:
//! all of it once, for plans, kernels and twins.

use super::policy::Policy;
use super::{Control, SpatialUse, StoredReservoir, Taps, boiling};
use crate::pass::FrameInputs;
use crate::plan::{BufferId, BufferKey, Builder, Domain, Elements, Grid, NewPass, Plan, Runs};
use crate::resampling::Family;

use super::parameters::Settings;

/// Packed normals of primary hits.
pub(crate) const NORMALS: BufferKey<u32> = BufferKey::new("normals");
/// Estimates beside the reservoirs.
pub(crate) const CONTROLS: BufferKey<Control> = BufferKey::new("controls");
const BOUNCE_CONTROLS: BufferKey<Control> = BufferKey::new("bounce controls");
const HISTORY_CONTROLS: BufferKey<Control> = BufferKey::new("history controls");

/// Shifts made once for two pixels ([`super::exchange`]).
pub(crate) const SHIFTS: BufferKey<[f32; 4]> = BufferKey::new("shifts");

/// Keys of the buffers of records.
pub(crate) struct Keys<R>(std::marker::PhantomData<R>);

impl<R> Keys<R> {
    /// This frame's reservoirs; their own history where the spatial result is not kept.
    pub(crate) const RESERVOIRS: BufferKey<R> = BufferKey::new("reservoirs");
    const BOUNCE: BufferKey<R> = BufferKey::new("bounce");
    const SECOND_BOUNCE: BufferKey<R> = BufferKey::new("second bounce");
    /// What the last spatial round leaves to the next frame.
    const HISTORY: BufferKey<R> = BufferKey::new("history");
    /// All of them.
    pub(crate) const ALL: [BufferKey<R>; 4] =
        [Self::RESERVOIRS, Self::BOUNCE, Self::SECOND_BOUNCE, Self::HISTORY];

    /// The key of a place.
    pub(crate) const fn at(place: Place) -> BufferKey<R> {
        match place {
            Place::Reservoirs => Self::RESERVOIRS,
            Place::Bounce => Self::BOUNCE,
            Place::SecondBounce => Self::SECOND_BOUNCE,
            Place::History => Self::HISTORY,
        }
    }
}

/// Where reservoirs lie between passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Where temporal reuse left them.
    Reservoirs,
    /// Between spatial rounds.
    Bounce,
    /// Between spatial rounds, where the reservoirs must stay as they are.
    SecondBounce,
    /// What the next frame takes.
    History,
}

/// Where estimates lie between passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ControlPlace {
    /// Where temporal reuse left them.
    Controls,
    /// Between spatial rounds, where the former must stay as they are.
    Bounce,
    /// What the next frame takes.
    History,
}

impl ControlPlace {
    /// The key of the buffer.
    pub(crate) const fn control_key(self) -> BufferKey<Control> {
        match self {
            Self::Controls => CONTROLS,
            Self::Bounce => BOUNCE_CONTROLS,
            Self::History => HISTORY_CONTROLS,
        }
    }
}

/// One round of spatial reuse: what it reads and writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Round {
    /// From 0.
    pub(crate) number: u32,
    /// Whether it is the last one, which shades.
    pub(crate) last: bool,
    /// Whose reservoirs are merged.
    pub(crate) from: Place,
    /// Where the result goes; `None`: it is shown and not kept.
    pub(crate) to: Option<Place>,
    kept: bool,
}

impl Round {
    /// Round `number` of the settings. Rounds before the last alternate between two places, the
    /// first of which reads what temporal reuse left.
    pub(crate) fn new(settings: &Settings, number: u32) -> Self {
        let last = number + 1 == settings.rounds;
        let kept = settings.spatial == SpatialUse::Feedback;
        let second = if kept { Place::Reservoirs } else { Place::SecondBounce };
        let even = number.is_multiple_of(2);
        let from = match number {
            0 => Place::Reservoirs,
            _ if even => second,
            _ => Place::Bounce,
        };
        let to = match (last, even) {
            (true, _) => kept.then_some(Place::History),
            (false, true) => Some(Place::Bounce),
            (false, false) => Some(second),
        };
        Self { number, last, from, to, kept }
    }

    /// Where the estimates come from, and where they go. A pixel reads its own only, so rounds
    /// before the last update them in place.
    pub(crate) fn controls(&self) -> (ControlPlace, Option<ControlPlace>) {
        let between = if self.kept { ControlPlace::Controls } else { ControlPlace::Bounce };
        let from = if self.number == 0 { ControlPlace::Controls } else { between };
        let to = match (self.last, self.kept) {
            (false, _) => Some(between),
            (true, true) => Some(ControlPlace::History),
            (true, false) => None,
        };
        (from, to)
    }
}

/// Frames of history from which a pixel takes nothing from its neighbours; 0: every pixel takes.
/// History grows old where anything moves, so there every pixel takes.
pub(crate) fn mature(settings: &Settings, still: bool) -> u32 {
    if still { settings.mature } else { 0 }
}

/// What the previous frame left: a buffer of its own where the spatial result is kept, else the
/// reservoirs' other half.
pub(super) fn history<'f, R: StoredReservoir>(inputs: &'f FrameInputs<'_>) -> &'f [R] {
    match inputs.plan.id(Keys::<R>::HISTORY) {
        Some(id) => inputs.read(id),
        None => inputs.at_previous(Keys::<R>::RESERVOIRS),
    }
}

/// The estimates of the previous frame; empty where none are kept.
pub(super) fn history_controls<'f>(inputs: &'f FrameInputs<'_>) -> &'f [Control] {
    match (inputs.plan.id(HISTORY_CONTROLS), inputs.plan.id(CONTROLS)) {
        (Some(id), _) => inputs.read(id),
        (None, Some(id)) => inputs.read_previous(id),
        (None, None) => &[],
    }
}

/// Numbers of the kernels of reuse; a technique's own are below.
pub(crate) mod kernel {
    /// The domain's candidates.
    pub(crate) const INITIAL: u32 = 8;
    /// See [`super::super::temporal`].
    pub(crate) const TEMPORAL: u32 = 9;
    /// See [`super::super::boiling`].
    pub(crate) const BOILING: u32 = 10;
    /// See [`super::super::mutate`].
    pub(crate) const MUTATE: u32 = 11;
    /// See [`super::super::shade`].
    pub(crate) const SHADE: u32 = 12;
    /// Round 0 of [`super::super::spatial`]; others follow.
    pub(crate) const SPATIAL: u32 = 16;
    /// Round 0 of [`super::super::exchange`]; others follow.
    pub(crate) const SHIFTS: u32 = 32;
}

/// What the initial pass and the shifts of a domain may take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Initial {
    /// Most bounce, shadow and emitter rays a chain, those of the policy not counted.
    pub(crate) rays: [u64; 3],
    /// Reservoirs of a chain.
    pub(crate) parts: u32,
    /// Most bounce rays of a shift; a shadow ray comes on top where p̂ contains visibility.
    pub(crate) shift_bounces: u64,
    /// More shadow rays of a shift between two frames.
    pub(crate) between_frames: u64,
    /// Whether shifts between pixels that swap their samples are made once for both.
    pub(crate) shares: bool,
}

/// The buffers of reuse in a plan.
struct Buffers {
    normals: Option<BufferId>,
    records: Vec<(Place, BufferId)>,
    controls: Vec<(ControlPlace, BufferId)>,
}

impl Buffers {
    /// Adds them. A place that several rounds write is one buffer.
    fn add<R: StoredReservoir, P: Policy>(
        plan: &mut Builder<'_>,
        settings: &Settings,
        chains: u32,
    ) -> Self {
        let still = plan.still();
        let (temporal, spatial) = (settings.cap > 0, settings.neighbours > 0);
        let moving_history = temporal && !still;
        if moving_history {
            plan.keep_history(Plan::HITS);
        }
        let normals = (spatial || moving_history)
            .then(|| plan.buffer(NORMALS, Elements::Pixels, moving_history));
        // Where the spatial result is not kept the reservoirs are their own history.
        let kept = spatial && settings.spatial == SpatialUse::Feedback;
        let mut places = vec![(Place::Reservoirs, temporal && !kept)];
        let mut control_places = vec![(ControlPlace::Controls, temporal && !kept)];
        for round in rounds(settings) {
            places.extend(round.to.map(|place| (place, false)));
            control_places.extend(round.controls().1.map(|place| (place, false)));
        }
        let mut records: Vec<(Place, BufferId)> = Vec::new();
        for (place, history) in places {
            if records.iter().all(|(known, _)| *known != place) {
                let key = Keys::<R>::at(place);
                records.push((place, plan.buffer_of(key, chains, Elements::Pixels, history)));
            }
        }
        let mut controls: Vec<(ControlPlace, BufferId)> = Vec::new();
        for (place, history) in control_places {
            if P::CONTROL && controls.iter().all(|(known, _)| *known != place) {
                let key = place.control_key();
                controls.push((place, plan.buffer_of(key, chains, Elements::Pixels, history)));
            }
        }
        Self { normals, records, controls }
    }

    /// The records of a place and the estimates of another, where the plan has them.
    fn at(&self, place: Option<Place>, control: Option<ControlPlace>) -> Vec<BufferId> {
        let records = self.records.iter().filter(|(known, _)| Some(*known) == place);
        let controls = self.controls.iter().filter(|(known, _)| Some(*known) == control);
        records.map(|(_, id)| *id).chain(controls.map(|(_, id)| *id)).collect()
    }
}

/// The rounds of spatial reuse.
fn rounds(settings: &Settings) -> impl Iterator<Item = Round> + use<> {
    let settings = *settings;
    let count = if settings.neighbours > 0 { settings.rounds } else { 0 };
    (0..count).map(move |number| Round::new(&settings, number))
}

/// Adds buffers and passes of reuse to a plan.
pub(crate) fn add<R: StoredReservoir, P: Policy>(
    plan: &mut Builder<'_>,
    settings: &Settings,
    initial: Initial,
) {
    plan.count_chains();
    let reservoirs = plan.shot.chains() * initial.parts;
    let buffers = Buffers::add::<R, P>(plan, settings, reservoirs);
    let still = plan.still();
    let chains = u64::from(reservoirs);
    let count = |ray: bool| u64::from(ray) * chains;
    let in_place = buffers.at(Some(Place::Reservoirs), Some(ControlPlace::Controls));

    let fresh = u64::from(plan.shot.chains());
    let [bounce, shadow, emitter] = initial.rays.map(|rays| rays * fresh);
    let mut writes = in_place.clone();
    writes.extend(buffers.normals);
    plan.pass(NewPass::pixels("initial", kernel::INITIAL, writes).rays(
        bounce,
        shadow + u64::from(P::TRACES_INITIAL) * fresh,
        emitter,
    ));
    if settings.cap > 0 {
        let shift = (1 + initial.between_frames) * count(P::IN_TARGET);
        let rays = if still { 0 } else { 2 * shift + count(P::CONTROL) };
        let pass = NewPass::pixels("temporal", kernel::TEMPORAL, in_place.clone());
        let bounces = if still { 0 } else { 2 * chains * initial.shift_bounces };
        plan.pass(NewPass { runs: Runs::WithHistory, ..pass.rays(bounces, rays, 0) });
        if still {
            plan.skip(
                "motion vectors, the previous frame's surfaces and lights",
                "nothing moves and the filter is a point",
            );
        }
    } else {
        plan.skip("temporal reuse", "the cap is 0");
    }
    if settings.boiling > 0.0 {
        let writes = buffers.at(Some(Place::Reservoirs), None);
        let grid = Grid::Fixed([0, 0]);
        let domain = Domain::Tiles { width: boiling::TILE, height: boiling::TILE, grid };
        plan.pass(NewPass { domain, ..NewPass::pixels("boiling", kernel::BOILING, writes) });
    }
    if settings.mutations > 0 {
        let steps = u64::from(settings.mutations);
        let rays = steps * count(P::IN_TARGET) + count(P::KEEPS_OUTCOME);
        // One replay, of all but the last bounce of a shift, and a bounce a step.
        let bounces = match initial.shift_bounces {
            0 => 0,
            bounces => (steps + bounces - 1) * chains,
        };
        plan.pass(NewPass::pixels("mutate", kernel::MUTATE, in_place).rays(bounces, rays, 0));
    }
    if settings.neighbours == 0 {
        plan.skip("spatial reuse", "no neighbours are asked for");
        let pass = NewPass::pixels("shade", kernel::SHADE, vec![Plan::RADIANCE]);
        plan.pass(pass.rays(0, count(P::SHADES_BY_RAY), 0));
    } else if settings.cap > 0 && mature(settings, still) > 0 {
        plan.skip("neighbours of pixels with history enough (`mature`)", "nothing moves");
    }
    let k = u64::from(settings.neighbours);
    let shares = initial.shares && settings.taps != Taps::Random;
    let shared = (shares && k > 0).then(|| {
        let slots = reservoirs * settings.neighbours;
        plan.buffer_of(SHIFTS, slots, Elements::Pixels, false)
    });
    for round in rounds(settings) {
        let mut writes = buffers.at(round.to, round.controls().1);
        writes.extend(round.last.then_some(Plan::RADIANCE));
        let mut merged = shifts(settings.mis, k);
        if let Some(shared) = shared {
            merged = shifts_of_others(settings.mis, k);
            let pass = NewPass::pixels("shifts", kernel::SHIFTS + round.number, vec![shared]);
            let rays = k * count(P::IN_TARGET);
            plan.pass(pass.rays(k * chains * initial.shift_bounces, rays, 0));
        }
        let terms = if P::IN_TARGET {
            merged
        } else {
            k * u64::from(P::TRACES_TERMS || (round.last && settings.decoupled))
        };
        let rays = terms * chains + count(P::SHADES_BY_RAY && round.last);
        let bounces = merged * chains * initial.shift_bounces;
        let kernel = kernel::SPATIAL + round.number;
        plan.pass(NewPass::pixels("spatial", kernel, writes).rays(bounces, rays, 0));
    }
}

/// Most shifts of a merge with `k` others.
fn shifts(family: Family, k: u64) -> u64 {
    match family {
        Family::Constant => k,
        Family::Balance => k * (k + 1),
        _ => 2 * k,
    }
}

/// Most of them between two of the others: all that is left where those from and to the canonical
/// receiver are known.
fn shifts_of_others(family: Family, k: u64) -> u64 {
    match family {
        Family::Balance => k * (k - 1),
        Family::InverseCount | Family::Contribution => k - 1,
        Family::Constant | Family::Pairwise | Family::DefensivePairwise => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each round reads what the one before wrote; the last one writes what the next frame reads,
    /// and where nothing is kept no round touches what temporal reuse left.
    #[test]
    fn rounds_hand_on_what_they_wrote() {
        for spatial in [SpatialUse::Feedback, SpatialUse::Display] {
            for rounds in 1..=8 {
                let settings = Settings { rounds, spatial, ..Settings::default() };
                let all: Vec<Round> = (0..rounds).map(|n| Round::new(&settings, n)).collect();
                assert_eq!(all[0].from, Place::Reservoirs);
                assert_eq!(all[0].controls().0, ControlPlace::Controls);
                for pair in all.windows(2) {
                    assert_eq!(pair[0].to, Some(pair[1].from));
                    assert_eq!(pair[0].controls().1, Some(pair[1].controls().0));
                    assert!(!pair[0].last);
                }
                for round in &all {
                    assert_ne!(round.to, Some(round.from), "a round reads others' pixels");
                }
                let last = all[all.len() - 1];
                let kept = spatial == SpatialUse::Feedback;
                assert_eq!((last.last, last.to), (true, kept.then_some(Place::History)));
                if !kept {
                    assert!(all.iter().all(|round| round.to != Some(Place::Reservoirs)));
                    let controls = Some(ControlPlace::Controls);
                    assert!(all.iter().all(|round| round.controls().1 != controls));
                }
            }
        }
    }
}
