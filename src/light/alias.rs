//! Choice of one of many by weight in constant time (Walker 1974; Vose 1991), built in f64.

/// A discrete distribution over `0..len`.
///
/// Entries of weight 0 take part in nothing: adding one changes no draw.
#[derive(Clone, Debug, Default)]
pub struct AliasTable {
    /// One for each positive weight.
    slots: Vec<Slot>,
    probabilities: Vec<f32>,
}

#[derive(Clone, Copy, Debug)]
struct Slot {
    /// `own` is taken where the fraction's word lies below this share of 2³², else `alias`.
    threshold: u32,
    own: u32,
    alias: u32,
}

impl AliasTable {
    /// A table for non-negative finite `weights`; empty where their sum is 0.
    #[must_use]
    pub fn new(weights: &[f64]) -> Self {
        debug_assert!(weights.iter().all(|w| w.is_finite() && *w >= 0.0));
        let total: f64 = weights.iter().sum();
        if total <= 0.0 {
            return Self::default();
        }
        let positive: Vec<u32> =
            (0..weights.len() as u32).filter(|&i| weights[i as usize] > 0.0).collect();
        let n = positive.len();
        let mut scaled: Vec<f64> =
            positive.iter().map(|&i| weights[i as usize] / total * n as f64).collect();
        let (mut small, mut large): (Vec<usize>, Vec<usize>) =
            (0..n).partition(|&i| scaled[i] < 1.0);
        // What is left over by rounding keeps itself.
        let mut slots: Vec<Slot> =
            positive.iter().map(|&i| Slot { threshold: u32::MAX, own: i, alias: i }).collect();
        while let (Some(&s), Some(&l)) = (small.last(), large.last()) {
            small.pop();
            let share = scaled[s];
            slots[s].threshold = (share * 4_294_967_296.0) as u32;
            slots[s].alias = positive[l];
            scaled[l] -= 1.0 - share;
            if scaled[l] < 1.0 {
                large.pop();
                small.push(l);
            }
        }
        let probabilities = weights.iter().map(|w| (w / total) as f32).collect();
        Self { slots, probabilities }
    }

    /// Number of entries, those of weight 0 included; 0 where nothing can be drawn.
    #[must_use]
    pub fn len(&self) -> usize {
        self.probabilities.len()
    }

    /// Whether nothing can be drawn.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// The entry for 64 random bits; the table must not be empty. The product's upper word is the
    /// slot, its next 32 bits decide between slot and alias, so that a million entries still leave
    /// 2⁴⁴ levels for each.
    #[inline]
    #[must_use]
    pub fn sample(&self, index_word: u32, fraction_word: u32) -> u32 {
        let bits = u64::from(index_word) << 32 | u64::from(fraction_word);
        let product = u128::from(bits) * self.slots.len() as u128;
        let index = (product >> 64) as u32;
        let fraction = (product >> 32) as u32;
        let slot = self.slots[index as usize];
        if fraction < slot.threshold { slot.own } else { slot.alias }
    }

    /// The slots as words, three each: threshold, own entry, alias.
    #[cfg(feature = "gpu")]
    pub(crate) fn slot_words(&self) -> Vec<u32> {
        self.slots.iter().flat_map(|slot| [slot.threshold, slot.own, slot.alias]).collect()
    }

    /// Probability of an entry, in [0, 1].
    #[inline]
    #[must_use]
    pub fn probability(&self, index: u32) -> f32 {
        self.probabilities[index as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::Stream;
    use crate::stats::chi_square;

    #[test]
    fn empty_and_black_tables_draw_nothing() {
        assert!(AliasTable::new(&[]).is_empty());
        assert!(AliasTable::new(&[0.0, 0.0]).is_empty());
    }

    #[test]
    fn a_zero_weight_changes_no_draw() {
        let table = AliasTable::new(&[1.0, 5.0, 2.0]);
        let longer = AliasTable::new(&[0.0, 1.0, 5.0, 0.0, 2.0, 0.0]);
        let place = [1, 2, 4];
        let mut stream = Stream::from_key(2);
        for _ in 0..10_000 {
            let words = (stream.word(), stream.word());
            let (a, b) = (table.sample(words.0, words.1), longer.sample(words.0, words.1));
            assert_eq!(place[a as usize], b);
            assert_eq!(table.probability(a), longer.probability(b));
        }
        assert_eq!((longer.len(), longer.probability(5)), (6, 0.0));
    }

    /// Exactly, from the slots: each entry's share of all words is its weight, to the 32 bits of a
    /// threshold.
    #[test]
    fn slots_share_the_words_by_weight() {
        for n in [1_usize, 3, 17, 1000, 40_000] {
            let weights: Vec<f64> = (0..n)
                .map(|i| if i % 5 == 4 { 0.0 } else { 1.0 + 1e3 * ((i * i) as f64).sin().abs() })
                .collect();
            let table = AliasTable::new(&weights);
            let mut shares = vec![0.0; n];
            for slot in &table.slots {
                let own = f64::from(slot.threshold) / 4_294_967_296.0;
                shares[slot.own as usize] += own;
                shares[slot.alias as usize] += 1.0 - own;
            }
            let total: f64 = weights.iter().sum();
            let slots = table.slots.len() as f64;
            for (i, (share, weight)) in shares.iter().zip(&weights).enumerate() {
                let exact = weight / total * slots;
                // One unit of a threshold for each slot that an entry may be the alias of.
                let tolerance = 1e-6 * exact + 1e-9;
                assert!((share - exact).abs() <= tolerance, "{i} of {n}: {share} for {exact}");
                let stated = f64::from(table.probability(i as u32));
                assert!((stated * total - weight).abs() <= 1e-6 * weight, "{i} of {n}");
            }
        }
    }

    #[test]
    fn zero_weights_are_never_drawn() {
        let weights: Vec<f64> =
            (0..1000).map(|i| if i % 100 == 0 { 0.0 } else { 0.1 + f64::from(i % 7) }).collect();
        let table = AliasTable::new(&weights);
        let mut stream = Stream::from_key(1);
        for _ in 0..1_000_000 {
            let i = table.sample(stream.word(), stream.word());
            assert!(weights[i as usize] > 0.0, "drew {i}");
        }
    }

    /// α = 10⁻⁶ each; 10⁶ draws see 2 % of rms error in the density (control: weights off by 3 %).
    #[test]
    fn draws_follow_the_weights() {
        for n in [1_usize, 2, 100, 1000] {
            let weights: Vec<f64> = (0..n).map(|i| 2f64.powi(-((i % 40) as i32)) + 0.01).collect();
            let table = AliasTable::new(&weights);
            let mut stream = Stream::from_key(n as u64);
            let mut observed = vec![0_u64; n];
            for _ in 0..1_000_000 {
                observed[table.sample(stream.word(), stream.word()) as usize] += 1;
            }
            let result = chi_square(&observed, &weights);
            assert!(n == 1 || result.p > 1e-6, "n {n}: {result:?}");
            if n == 100 {
                let wrong: Vec<f64> = weights
                    .iter()
                    .enumerate()
                    .map(|(i, w)| w * if i % 2 == 0 { 1.03 } else { 0.97 })
                    .collect();
                assert!(chi_square(&observed, &wrong).p < 1e-6, "the control must fail");
            }
        }
    }

    #[test]
    fn probabilities_sum_to_one_over_forty_binary_orders() {
        let weights: Vec<f64> = (0..1000).map(|i| 2f64.powi(i % 40)).collect();
        let table = AliasTable::new(&weights);
        let sum: f64 = (0..1000).map(|i| f64::from(table.probability(i))).sum();
        assert!((sum - 1.0).abs() < 1e-6, "{sum}");
    }
}
