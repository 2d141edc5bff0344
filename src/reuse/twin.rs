//! The passes' twins for graphics processors: which WGSL they are made of, and its constants, for
//! any domain and policy.

use super::passes::{ControlPlace, Keys, NORMALS, Place, Round, kernel, mature};
use super::policy::{Policy, StoredOutcome, WithPolicy};
use super::{Settings, StoredReservoir, Taps, Visibility, boiling_limit};
use crate::plan::{BufferKey, Plan};
use crate::resampling::{Family, MERGE_WGSL, RESAMPLING_WGSL};
use crate::twin::{Module, Twin};

/// Outcomes of shadow rays that are used again, in WGSL; needs nothing.
pub const STORED_WGSL: Module = crate::wgsl!("policy/stored.wgsl");
/// Averages of visibility in WGSL; needs nothing.
pub const WIS_WGSL: Module = crate::wgsl!("policy/wis.wgsl");
/// The state of the control variate in WGSL; needs nothing.
pub const CONTROL_WGSL: Module = crate::wgsl!("control.wgsl");

/// What all passes share; [`DomainTwin::modules`] says the rest.
const SHARED: [Module; 6] = [
    RESAMPLING_WGSL,
    CONTROL_WGSL,
    STORED_WGSL,
    WIS_WGSL,
    crate::wgsl!("policy/policy.wgsl"),
    crate::wgsl!("reuse.wgsl"),
];
const SURFACES: Module = crate::wgsl!("surfaces.wgsl");

/// What a domain brings to the twins of the passes; the head of `reuse.wgsl` lists what its modules
/// declare.
pub(crate) struct DomainTwin {
    /// Samples, receivers and records.
    pub(crate) modules: Vec<Module>,
    /// The shift, for passes that merge.
    pub(crate) shift: Module,
    /// Moves of a sample.
    pub(crate) mutate: Module,
    /// Constants of the moves.
    pub(crate) mutate_constants: Vec<(&'static str, f64)>,
}

/// The parameters that twins depend on.
pub(crate) struct TwinSettings<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) settings: Settings,
    pub(crate) visibility: Visibility,
    /// The limits of [`Visibility::Reuse`].
    pub(crate) limits: StoredOutcome,
}

/// 0 or 1.
pub(crate) fn flag(holds: bool) -> f64 {
    f64::from(u8::from(holds))
}

/// The place of a buffer in a plan, 0 where the plan has none.
pub(crate) fn id<T>(plan: &Plan, key: BufferKey<T>) -> f64 {
    plan.id(key).map_or(0.0, |id| id.0 as f64)
}

/// The number of a family in WGSL.
fn number(family: Family) -> f64 {
    Family::ALL.iter().position(|known| *known == family).unwrap_or(0) as f64
}

/// A policy's constants as flags.
struct PolicyFlags;

impl WithPolicy for PolicyFlags {
    type Output = Vec<(&'static str, f64)>;

    fn with<P: Policy>(self, _: P) -> Self::Output {
        vec![
            ("TRACES_INITIAL", flag(P::TRACES_INITIAL)),
            ("DROPS_OCCLUDED", flag(P::DROPS_OCCLUDED)),
            ("TRACES_TERMS", flag(P::TRACES_TERMS)),
            ("SHADES_BY_RAY", flag(P::SHADES_BY_RAY)),
            ("KEEPS_OUTCOME", flag(P::KEEPS_OUTCOME)),
            ("CONTROL", flag(P::CONTROL)),
        ]
    }
}

/// What the twins of all passes have in common, the domain's own ones included: modules, the
/// policy, the reservoirs.
pub(crate) fn shared<R: StoredReservoir>(at: &TwinSettings<'_>, domain: &DomainTwin) -> Twin {
    let TwinSettings { plan, visibility, limits, .. } = *at;
    let mut flags = visibility.choose(limits, PolicyFlags);
    let names = Visibility::ALL.iter().enumerate();
    let names: Vec<(String, u32)> = names
        .map(|(number, policy)| (policy.name().to_uppercase().replace('-', "_"), number as u32))
        .collect();
    let policy = Visibility::ALL.iter().position(|policy| *policy == visibility);
    flags.push(("POLICY", policy.unwrap_or(0) as f64));
    flags.push(("STILL", flag(plan.still)));
    let mut constants = vec![("B_RESERVOIRS", id(plan, Keys::<R>::RESERVOIRS))];
    if keeps_control(at) {
        constants.push(("B_CONTROLS", id(plan, ControlPlace::Controls.control_key())));
    }
    if visibility == Visibility::Reuse {
        constants.push(("VISIBILITY_AGE", f64::from(limits.max_age)));
        constants.push(("VISIBILITY_DISTANCE", f64::from(limits.max_distance)));
    }
    let mut modules = SHARED.to_vec();
    modules.extend_from_slice(&domain.modules);
    Twin { kernel: "", modules, constants, flags, names }
}

/// Adds what compares surfaces.
pub(crate) fn with_surfaces(twin: &mut Twin, at: &TwinSettings<'_>) {
    twin.modules.push(SURFACES);
    twin.constants.push(("B_NORMALS", id(at.plan, NORMALS)));
    for (name, kinds) in
        [("XOR", &[Taps::Xor][..]), ("PAIRS", &[Taps::Pairs]), ("SWAPS", &[Taps::Xor, Taps::Pairs])]
    {
        twin.flags.push((name, flag(kinds.contains(&at.settings.taps))));
    }
}

fn keeps_control(at: &TwinSettings<'_>) -> bool {
    at.visibility == Visibility::WisControlVariate
}

/// The twin of a kernel of [`kernel`]; `None` for the domain's own.
pub(crate) fn twin<R: StoredReservoir>(
    kernel: u32,
    at: &TwinSettings<'_>,
    domain: &DomainTwin,
) -> Option<Twin> {
    let shared = shared::<R>(at, domain);
    Some(match kernel {
        kernel::INITIAL => return None,
        kernel::TEMPORAL => temporal::<R>(shared, at, domain),
        kernel::BOILING => boiling(shared, at),
        kernel::MUTATE => mutate(shared, domain),
        kernel::SHADE => shade(shared),
        _ => spatial::<R>(shared, at, domain, kernel - kernel::SPATIAL),
    })
}

fn temporal<R: StoredReservoir>(
    mut twin: Twin,
    at: &TwinSettings<'_>,
    domain: &DomainTwin,
) -> Twin {
    with_surfaces(&mut twin, at);
    let (plan, settings) = (at.plan, &at.settings);
    twin.kernel = "temporal";
    twin.modules.extend([MERGE_WGSL, domain.shift, crate::wgsl!("temporal.wgsl")]);
    twin.constants.extend([
        ("FAMILY", number(settings.temporal_mis)),
        ("CAP", f64::from(settings.cap)),
        ("MAX_AGE", f64::from(settings.max_age)),
        ("B_HISTORY", id(plan, Keys::<R>::at(Place::History))),
    ]);
    if keeps_control(at) {
        let history = id(plan, ControlPlace::History.control_key());
        twin.constants.push(("B_HISTORY_CONTROLS", history));
    }
    twin.flags.extend([
        // Where nothing moves, the stored targets serve both frames.
        ("STORED_TARGETS", flag(plan.still && !keeps_control(at))),
        ("OWN_HISTORY", flag(plan.id(Keys::<R>::at(Place::History)).is_none())),
    ]);
    twin
}

fn boiling(mut twin: Twin, at: &TwinSettings<'_>) -> Twin {
    twin.kernel = "boiling";
    twin.modules.push(crate::wgsl!("boiling.wgsl"));
    twin.constants.push(("BOILING_LIMIT", f64::from(boiling_limit(at.settings.boiling))));
    twin
}

fn mutate(mut twin: Twin, domain: &DomainTwin) -> Twin {
    twin.kernel = "mutate";
    twin.modules.extend([domain.mutate, crate::wgsl!("mutate.wgsl")]);
    twin.constants.extend_from_slice(&domain.mutate_constants);
    twin
}

fn shade(mut twin: Twin) -> Twin {
    twin.kernel = "shade";
    twin.modules.push(crate::wgsl!("shade.wgsl"));
    twin
}

fn spatial<R: StoredReservoir>(
    mut twin: Twin,
    at: &TwinSettings<'_>,
    domain: &DomainTwin,
    round: u32,
) -> Twin {
    struct TracesTerms;
    impl WithPolicy for TracesTerms {
        type Output = bool;

        fn with<P: Policy>(self, _: P) -> bool {
            P::TRACES_TERMS
        }
    }
    with_surfaces(&mut twin, at);
    let (plan, settings) = (at.plan, &at.settings);
    let round = Round::new(settings, round);
    let (control_from, control_to) = round.controls();
    let control = keeps_control(at);
    let in_target = at.visibility == Visibility::InTarget;
    let decoupled = round.last && settings.decoupled;
    let traces_terms = at.visibility.choose(at.limits, TracesTerms);
    twin.kernel = "spatial";
    twin.modules.extend([
        MERGE_WGSL,
        domain.shift,
        crate::wgsl!("shade.wgsl"),
        crate::wgsl!("spatial.wgsl"),
    ]);
    twin.constants.extend([
        ("FAMILY", number(settings.mis)),
        ("NEIGHBOURS", f64::from(settings.neighbours)),
        ("RADIUS", f64::from(settings.radius)),
        ("MATURE", f64::from(mature(settings, plan.still))),
        ("ROUND", f64::from(round.number)),
        ("B_FROM", id(plan, Keys::<R>::at(round.from))),
    ]);
    if let Some(place) = round.to {
        twin.constants.push(("B_TO", id(plan, Keys::<R>::at(place))));
    }
    if control {
        twin.constants.push(("B_CONTROL_FROM", id(plan, control_from.control_key())));
    }
    if let Some(place) = control_to.filter(|_| control) {
        twin.constants.push(("B_CONTROL_TO", id(plan, place.control_key())));
    }
    twin.flags.extend([
        ("LAST", flag(round.last)),
        ("KEPT", flag(round.to.is_some())),
        ("CONTROL_KEPT", flag(control && control_to.is_some())),
        ("DECOUPLED", flag(decoupled)),
        ("SHOWS", flag(control || decoupled)),
        ("TRACED", flag(traces_terms || (decoupled && !in_target))),
        ("TRACES_OWN", flag(decoupled && !control && !in_target)),
    ]);
    twin.names.push(("INPUTS".into(), settings.neighbours + 1));
    twin
}
