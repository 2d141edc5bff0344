//! What was done: counted exactly, and the same for any number of threads and on every backend.

macro_rules! counters {
    ($($(#[$doc:meta])* $name:ident,)*) => {
        /// Work that was done: exact and the same for any number of threads.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
        pub struct Counters {
            $($(#[$doc])* pub $name: u64,)*
        }

        impl Counters {
            /// Names and values, in a fixed order.
            #[must_use]
            pub fn entries(&self) -> Vec<(&'static str, u64)> {
                vec![$((stringify!($name), self.$name),)*]
            }

            /// From the lower words of the first [`IN_TWINS`] in the order of
            /// [`Counters::entries`], and their upper ones behind them.
            #[cfg(feature = "gpu")]
            pub(crate) fn from_words(words: &[u32]) -> Self {
                let count = IN_TWINS;
                let word = |at: usize| u64::from(words.get(at).copied().unwrap_or(0));
                let mut numbers = (0..count).map(|at| word(at) | word(count + at) << 32);
                Self { $($name: numbers.next().unwrap_or(0),)* }
            }
        }

        impl std::ops::Add for Counters {
            type Output = Self;

            fn add(self, other: Self) -> Self {
                Self { $($name: self.$name + other.$name,)* }
            }
        }
    };
}

/// Counters that twins on graphics processors have: those behind belong to paths, which have none
/// yet.
#[cfg(feature = "gpu")]
const IN_TWINS: usize = 17;

counters! {
    /// Rays from the camera.
    primary_rays,
    /// Rays that continue a path.
    bounce_rays,
    /// Rays that only ask for occlusion.
    shadow_rays,
    /// Rays that look for emitters alone.
    emitter_rays,
    /// Light samples that needed no ray: nothing emitted towards the receiver, or nothing
    /// scattered.
    shadow_rays_saved,
    /// Complete path estimates.
    paths,
    /// Light points that a pixel's own reservoir was offered.
    candidates,
    /// Light points made ahead, in tiles.
    tile_entries,
    /// Integrands evaluated at another pixel or frame.
    shifts,
    /// Of these, undefined or zero.
    shifts_failed,
    /// Pixels that took last frame's reservoir into account.
    temporal_merges,
    /// Neighbours' reservoirs that were taken into account.
    spatial_merges,
    /// Neighbours and histories that the surfaces ruled out.
    reuse_rejected,
    /// Mutations proposed.
    mutations,
    /// Mutations accepted.
    mutations_accepted,
    /// Candidates whose weight was not a finite number of at least 0. Always a bug.
    weights_rejected,
    /// Estimates that were not finite. Always a bug: they are counted and shown as black, never
    /// passed on.
    non_finite,
    /// Shifts of paths that failed since the replayed numbers scatter nothing there.
    failed_replay,
    /// Shifts of paths that failed since an earlier pair of vertices may be connected there.
    failed_earlier,
    /// Shifts of paths that failed since the path is shorter or longer there.
    failed_length,
    /// Shifts of paths that failed since the lobe does not scatter, or is not rough there.
    failed_lobe,
    /// Shifts of paths that failed since the vertices are too near.
    failed_near,
    /// Shifts of paths that failed since light would meet the back of a surface.
    failed_back,
    /// Shifts of paths that failed since something stands between.
    failed_occluded,
    /// Shifts of paths that failed since the light is not there.
    failed_light_gone,
    /// Shifts of paths that failed since the object is not there.
    failed_object_gone,
    /// Shifts of paths that failed since a product is not finite there.
    failed_not_finite,
    /// Directions that lobes drew.
    lobe_draws,
    /// Directions that lobes drew and that found light.
    lobe_hits,
    /// Moves of lobes' chains to another sample.
    chain_moves,
    /// Pixels that leave a lobe to the next frame.
    lobes,
    /// Scores of lobes that were not positive numbers: the sample is shown, and nothing learnt.
    scores_rejected,
}
