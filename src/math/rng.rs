//! Random numbers by purpose: counter-based, so that a draw added to one step shifts no other
//! step's numbers.
//!
//! Two kinds are kept apart:
//!
//! - A **path seed** (`u64`) makes a path's integrand a function of its numbers. All draws along
//!   the path are random access: [`draw4`]`(seed, vertex, block)`. Blocks per vertex are fixed, so
//!   consumption never depends on a branch:
//!
//!   | block | numbers |
//!   |---|---|
//!   | [`BLOCK_SCATTER`] | lobe word, direction u, direction v, spare |
//!   | [`BLOCK_LIGHT`] | light index word, alias threshold word, light u, light v |
//!   | [`BLOCK_ROULETTE`] | roulette, three spare; never replayed |
//!   | [`BLOCK_LIGHTS`] + i | light u, light v, two spare, of light i where all are sampled |
//!
//! - Everything else (jitter, selection, neighbours, mutation, tile masks) draws from [`Stream`]s
//!   keyed by (run, pixel or tile, frame, purpose, round), never from a path seed.
//!
//! The generator is pcg4d (Jarzynski and Olano 2020, *Hash Functions for GPU Rendering*, JCGT
//! 9(3)): bit-equal in WGSL.

/// Block of [`draw4`] with the lobe and the direction of a scattering event.
pub const BLOCK_SCATTER: u32 = 0;
/// Block of [`draw4`] with the choice of a light and the point on it.
pub const BLOCK_LIGHT: u32 = 1;
/// Block of [`draw4`] with Russian roulette.
pub const BLOCK_ROULETTE: u32 = 2;

/// First block of [`draw4`] with a point on each light, for those who sample all of them.
pub const BLOCK_LIGHTS: u32 = 1 << 31;

/// Four hashed words of four counter words (Jarzynski and Olano 2020, `pcg4d`).
#[inline]
#[must_use]
pub fn pcg4d(v: [u32; 4]) -> [u32; 4] {
    let [mut x, mut y, mut z, mut w] =
        v.map(|c| c.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    x = x.wrapping_add(y.wrapping_mul(w));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    w = w.wrapping_add(y.wrapping_mul(z));
    x ^= x >> 16;
    y ^= y >> 16;
    z ^= z >> 16;
    w ^= w >> 16;
    x = x.wrapping_add(y.wrapping_mul(w));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    w = w.wrapping_add(y.wrapping_mul(z));
    [x, y, z, w]
}

/// A word as a float in [0, 1): its upper 24 bits times 2⁻²⁴, so that 1.0 never occurs.
#[inline]
#[must_use]
pub fn unit_float(word: u32) -> f32 {
    // 2^-24
    (word >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Four words of a path seed at a vertex (from 0 at the primary hit) and a block; pure, so any draw
/// can be replayed.
#[inline]
#[must_use]
pub fn draw4(seed: u64, vertex: u32, block: u32) -> [u32; 4] {
    let counters = [seed as u32, (seed >> 32) as u32, vertex, block];
    #[cfg(test)]
    recording::draw(counters);
    pcg4d(counters)
}

/// What a [`Stream`] is drawn for; each purpose has numbers of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Purpose {
    /// The path seed of a candidate.
    PathSeed = 1,
    /// The position of a sample inside its pixel.
    Jitter = 2,
    /// Which candidate a reservoir keeps.
    Selection = 3,
    /// Rounding of motion vectors.
    TemporalRounding = 4,
    /// Which neighbours a pixel asks.
    Neighbours = 5,
    /// Mutations of a chain.
    Mutation = 6,
    /// Masks and permutations of a tile.
    TileMask = 7,
    /// Light tiles sampled ahead.
    LightTile = 8,
    /// The exchange of neighbours that all pixels of a frame share.
    Taps = 9,
    /// Which pixels get one estimate more than others.
    Effort = 10,
    /// Which lobes of the previous frame a pixel reads.
    LobeReads = 11,
    /// Whether a chain of lobes moves.
    ChainAcceptance = 12,
}

/// A 64-bit hash of (run, cell, frame, purpose, round), where a cell is a pixel, tile or item
/// number.
///
/// Two rounds of [`pcg4d`] for run, cell and frame, so that every input bit reaches every output
/// bit; one for purpose and round, which are small. Run, cell and frame are distinct in the first
/// round's 128-bit state.
#[inline]
#[must_use]
pub fn stream_key(run: u64, cell: u32, frame: u32, purpose: Purpose, round: u32) -> u64 {
    second_round(pcg4d([run as u32, (run >> 32) as u32, cell, frame]), purpose, round)
}

#[inline]
fn second_round(a: [u32; 4], purpose: Purpose, round: u32) -> u64 {
    let b = pcg4d([a[0] ^ purpose as u32, a[1] ^ round, a[2], a[3]]);
    u64::from(b[0]) | u64::from(b[1]) << 32
}

/// The path seed of candidate number `candidate` of a pixel in a frame, of the white (independent)
/// seed field.
#[inline]
#[must_use]
pub fn path_seed(run: u64, pixel: u32, frame: u32, candidate: u32) -> u64 {
    stream_key(run, pixel, frame, Purpose::PathSeed, candidate)
}

/// The path seeds of one pixel in one frame: [`path_seed`] with the part that all candidates share
/// computed once.
#[derive(Clone, Copy, Debug)]
pub struct PathSeeds([u32; 4]);

impl PathSeeds {
    /// Of a pixel in a frame.
    #[inline]
    #[must_use]
    pub fn new(run: u64, pixel: u32, frame: u32) -> Self {
        Self(pcg4d([run as u32, (run >> 32) as u32, pixel, frame]))
    }

    /// Of candidate number `candidate`.
    #[inline]
    #[must_use]
    pub fn seed(self, candidate: u32) -> u64 {
        second_round(self.0, Purpose::PathSeed, candidate)
    }

    /// The pixel's stream for a purpose and round: [`Stream::new`] with the shared part computed
    /// once.
    #[inline]
    #[must_use]
    pub fn stream(self, purpose: Purpose, round: u32) -> Stream {
        let key = second_round(self.0, purpose, round);
        #[cfg(test)]
        recording::stream(key, purpose, round);
        Stream::from_key(key)
    }
}

/// The three draws that the resampling core asks for. An enumerating source forks on each (see
/// `stats`), so expectations can be computed exactly.
pub trait RandomSource {
    /// True with probability `weight / total`. `0 <= weight <= total`, `total` finite; `total == 0`
    /// is false.
    fn choose(&mut self, weight: f32, total: f32) -> bool;
    /// Uniform in `0..n`; `n > 0`.
    fn index(&mut self, n: u32) -> u32;
    /// Uniform in [0, 1).
    fn uniform(&mut self) -> f32;
}

/// A sequence of independent numbers for one purpose at one place.
#[derive(Clone, Debug)]
pub struct Stream {
    key: u64,
    counter: u32,
    words: [u32; 4],
    left: u32,
}

impl Stream {
    /// The stream of (run, cell, frame, purpose, round).
    #[inline]
    #[must_use]
    pub fn new(run: u64, cell: u32, frame: u32, purpose: Purpose, round: u32) -> Self {
        let key = stream_key(run, cell, frame, purpose, round);
        #[cfg(test)]
        recording::stream(key, purpose, round);
        Self::from_key(key)
    }

    /// The stream of a 64-bit key.
    #[inline]
    #[must_use]
    pub fn from_key(key: u64) -> Self {
        Self { key, counter: 0, words: [0; 4], left: 0 }
    }

    /// The next 32 random bits.
    #[inline]
    pub fn word(&mut self) -> u32 {
        if self.left == 0 {
            // The block index 0xA5 keeps streams and path draws apart even where a key equals a
            // seed.
            let counters = [self.key as u32, (self.key >> 32) as u32, self.counter, 0xA5];
            #[cfg(test)]
            recording::draw(counters);
            self.words = pcg4d(counters);
            self.counter = self.counter.wrapping_add(1);
            self.left = 4;
        }
        self.left -= 1;
        self.words[self.left as usize]
    }
}

impl RandomSource for Stream {
    #[inline]
    fn choose(&mut self, weight: f32, total: f32) -> bool {
        // The whole word: with 24 bits a candidate of probability 1e-8 would be taken six times too
        // often.
        let u = f64::from(self.word()) * (1.0 / 4_294_967_296.0);
        u * f64::from(total) < f64::from(weight)
    }

    #[inline]
    fn index(&mut self, n: u32) -> u32 {
        ((u64::from(self.word()) * u64::from(n)) >> 32) as u32
    }

    #[inline]
    fn uniform(&mut self) -> f32 {
        unit_float(self.word())
    }
}

impl rand_core::TryRng for Stream {
    type Error = core::convert::Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Self::Error> {
        Ok(self.word())
    }

    fn try_next_u64(&mut self) -> Result<u64, Self::Error> {
        Ok(u64::from(self.word()) | u64::from(self.word()) << 32)
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Self::Error> {
        for chunk in bytes.chunks_mut(4) {
            let word = self.word().to_le_bytes();
            chunk.copy_from_slice(&word[..chunk.len()]);
        }
        Ok(())
    }
}

/// What a thread draws, for tests that no number is drawn twice.
#[cfg(test)]
pub(crate) mod recording {
    use std::cell::{Cell, RefCell};
    use std::collections::HashSet;

    use super::Purpose;

    /// Counters of all draws, in order, and the keys of streams that many pixels share or ask for
    /// again by design.
    #[derive(Debug, Default)]
    pub(crate) struct Draws {
        pub(crate) draws: Vec<[u32; 4]>,
        shared: HashSet<u64>,
    }

    thread_local! {
        static REPLAYS: Cell<u32> = const { Cell::new(0) };
        static DRAWS: RefCell<Option<Draws>> = const { RefCell::new(None) };
    }

    /// What `work` draws on this thread, without shared streams.
    pub(crate) fn of(work: impl FnOnce()) -> Vec<[u32; 4]> {
        DRAWS.set(Some(Draws::default()));
        work();
        let Draws { draws, shared } = DRAWS.take().unwrap_or_default();
        let key = |draw: &[u32; 4]| u64::from(draw[0]) | u64::from(draw[1]) << 32;
        draws.into_iter().filter(|draw| !shared.contains(&key(draw))).collect()
    }

    /// While it lives, numbers are drawn again by design: a path is replayed.
    #[derive(Debug)]
    pub(crate) struct Replay(());

    impl Replay {
        pub(crate) fn begin() -> Self {
            REPLAYS.set(REPLAYS.get() + 1);
            Self(())
        }
    }

    impl Drop for Replay {
        fn drop(&mut self) {
            REPLAYS.set(REPLAYS.get() - 1);
        }
    }

    pub(super) fn draw(counters: [u32; 4]) {
        if REPLAYS.get() > 0 {
            return;
        }
        DRAWS.with_borrow_mut(|recorded| {
            if let Some(recorded) = recorded {
                recorded.draws.push(counters);
            }
        });
    }

    pub(super) fn stream(key: u64, purpose: Purpose, round: u32) {
        // A pixel's position is asked for by whoever needs it; the others are one for many pixels:
        // the exchange of a frame, the lattice's shift, a block's tile of light points.
        let shared = match purpose {
            Purpose::Jitter | Purpose::Taps | Purpose::Effort => true,
            Purpose::LightTile => round == 0,
            _ => false,
        };
        if shared {
            DRAWS.with_borrow_mut(|recorded| {
                if let Some(recorded) = recorded {
                    recorded.shared.insert(key);
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unit_float_is_below_one() {
        assert_eq!(unit_float(0), 0.0);
        assert!(unit_float(u32::MAX) < 1.0);
    }

    #[test]
    fn choose_is_never_true_for_zero_weight() {
        let mut s = Stream::from_key(7);
        assert!((0..10_000).all(|_| !s.choose(0.0, 1.0) && !s.choose(0.0, 0.0)));
        assert!((0..10_000).all(|_| s.choose(2.0, 2.0)));
    }

    #[test]
    fn path_seeds_are_those_of_one_candidate_at_a_time() {
        let seeds = PathSeeds::new(3 << 40 | 7, 12, 5);
        assert!((0..9).all(|i| seeds.seed(i) == path_seed(3 << 40 | 7, 12, 5, i)));
        let (mut shared, purpose) = (seeds.stream(Purpose::LobeReads, 3), Purpose::LobeReads);
        assert_eq!(shared.word(), Stream::new(3 << 40 | 7, 12, 5, purpose, 3).word());
    }

    #[test]
    fn one_flipped_input_bit_flips_half_of_the_output_bits() {
        // A coin gives 32 ± 0.06 on average over 64 bases and 112 bits. `round` counts, so its low
        // half is what matters: it passes through one round of the hash only, in which high bits do
        // not reach low ones.
        let mut flipped = 0u64;
        let mut n = 0u64;
        for base in 0..64u64 {
            let run = base.wrapping_mul(0x9E37_79B9_7F4A_7C15);
            let key =
                |run, cell, frame, round| stream_key(run, cell, frame, Purpose::Jitter, round);
            let reference = key(run, 5, 9, 2);
            for bit in 0..32 {
                let mut changed = vec![
                    key(run ^ (1 << bit), 5, 9, 2),
                    key(run, 5 ^ (1 << bit), 9, 2),
                    key(run, 5, 9 ^ (1 << bit), 2),
                ];
                if bit < 16 {
                    changed.push(key(run, 5, 9, 2 ^ (1 << bit)));
                }
                n += changed.len() as u64;
                flipped +=
                    changed.iter().map(|k| u64::from((k ^ reference).count_ones())).sum::<u64>();
            }
        }
        let mean = flipped as f64 / n as f64;
        assert!((mean - 32.0).abs() < 0.3, "mean flipped bits {mean}");
    }
}
