//! A plan in the making: what plans of all techniques have in common is written here once.

use super::{
    BufferId, BufferKey, BufferPlan, Claim, Domain, Elements, Filter, Kernel, Pass, Plan, Runs,
    SceneFacts, Shot, Skip,
};

/// A pass of the technique that is to be added.
#[derive(Clone, Debug)]
pub struct NewPass {
    /// For people and timings.
    pub name: &'static str,
    /// The technique's number of its kernel.
    pub kernel: u32,
    /// What one run owns.
    pub domain: Domain,
    /// Buffers of which it writes its own elements.
    pub writes: Vec<BufferId>,
    /// When it runs.
    pub runs: Runs,
    /// Most rays a pixel, by kind: see [`Plan::RAY_KINDS`].
    pub rays: [u64; 4],
}

impl NewPass {
    /// A pass over single pixels, in every frame, without rays.
    #[must_use]
    pub fn pixels(name: &'static str, kernel: u32, writes: Vec<BufferId>) -> Self {
        let (domain, runs) = (Domain::Pixels, Runs::Always);
        Self { name, kernel, domain, writes, runs, rays: [0; 4] }
    }

    /// The same pass with other rays.
    #[must_use]
    pub fn rays(self, bounce: u64, shadow: u64, emitter: u64) -> Self {
        Self { rays: [0, bounce, shadow, emitter], ..self }
    }
}

/// Makes a plan step by step; see the module's head.
#[derive(Debug)]
pub struct Builder<'a> {
    /// What the scene contains.
    pub facts: &'a SceneFacts,
    /// What is rendered.
    pub shot: &'a Shot,
    plan: Plan,
}

impl<'a> Builder<'a> {
    /// A plan with the buffers that every plan has, and no pass.
    #[must_use]
    pub fn new(technique: String, facts: &'a SceneFacts, shot: &'a Shot) -> Self {
        let plan = Plan {
            technique,
            passes: Vec::new(),
            buffers: Plan::standard_buffers(),
            skipped: Vec::new(),
            constants: Vec::new(),
            still: facts.is_still(shot),
            chains: false,
            emitters: false,
            claim: Claim::Unbiased,
        };
        Self { facts, shot, plan }
    }

    /// Whether every frame has the same receivers, lights and occluders.
    #[must_use]
    pub fn still(&self) -> bool {
        self.plan.still
    }

    /// Notes what is left out, and the fact that allows it.
    pub fn skip(&mut self, what: &'static str, because: &'static str) {
        self.plan.skipped.push(Skip { what, because });
    }

    /// Notes what no technique does where the scene does not ask for it.
    pub fn skip_coverage(&mut self) {
        if !self.facts.alpha {
            self.skip("coverage lookups at every hit", "no surface has a coverage mask");
        }
    }

    /// Adds a buffer of one `T` an element.
    pub fn buffer<T>(&mut self, key: BufferKey<T>, elements: Elements, history: bool) -> BufferId {
        self.buffer_of(key, 1, elements, history)
    }

    /// Adds a buffer of `count` elements of type `T` a pixel or item.
    pub fn buffer_of<T>(
        &mut self,
        key: BufferKey<T>,
        count: u32,
        elements: Elements,
        history: bool,
    ) -> BufferId {
        let bytes = count * size_of::<T>() as u32;
        self.plan.buffers.push(BufferPlan { name: key.name, bytes, elements, history });
        BufferId(self.plan.buffers.len() - 1)
    }

    /// Keeps the previous frame's contents of a buffer beside this frame's.
    pub fn keep_history(&mut self, id: BufferId) {
        self.plan.buffers[id.0].history = true;
    }

    /// Fixes a value for all frames.
    pub fn constant(&mut self, name: &'static str, value: u32) {
        self.plan.constants.push((name, value));
    }

    /// Lets the effort count chains of reservoirs.
    pub fn count_chains(&mut self) {
        self.plan.chains = true;
    }

    /// Lets kernels ask which emitters a ray meets.
    pub fn need_emitters(&mut self) {
        self.plan.emitters = true;
    }

    /// Adds the frame loop's pass of primary hits: once where they never change.
    pub fn primary_hits(&mut self) {
        let still = self.still();
        if still {
            self.skip("primary rays after the first frame", "nothing moves");
        }
        self.plan.passes.push(Pass {
            name: "primary hits",
            kernel: Kernel::PrimaryHits,
            domain: Domain::Pixels,
            writes: vec![Plan::HITS, Plan::EMISSION],
            runs: if still { Runs::Once } else { Runs::Always },
            rays: [1, 0, 0, 0],
        });
    }

    /// Adds a pass of the technique.
    pub fn pass(&mut self, pass: NewPass) {
        let NewPass { name, kernel, domain, writes, runs, rays } = pass;
        let kernel = Kernel::Technique(kernel);
        self.plan.passes.push(Pass { name, kernel, domain, writes, runs, rays });
    }

    /// The plan, with what it promises.
    #[must_use]
    pub fn finish(self, claim: Claim) -> Plan {
        Plan { claim, ..self.plan }
    }
}

impl SceneFacts {
    /// Whether every frame of a shot has the same receivers, lights and occluders.
    #[must_use]
    pub fn is_still(&self, shot: &Shot) -> bool {
        !self.moves() && shot.filter == Filter::Point
    }
}
