//! The boiling filter: drops reservoirs that are far brighter than their tile's mean (Wyman and
//! Panteleev 2021). Biased.

use super::passes::Keys;
use super::policy::Policy;
use super::{Domain, Reuse, StoredReservoir};
use crate::counters::Counters;
use crate::pass::Band;

/// Width and height in pixels of the filter's tiles.
pub(crate) const TILE: u32 = 16;
/// Factor on the tile's mean at strength 1; at strength s it is 10 / s − 9.
const FACTOR: f32 = 10.0;

/// Factor on the tile's mean at a strength above 0.
pub(crate) fn limit(strength: f32) -> f32 {
    // At a strength of nearly 0 there is no limit, but the factor is a number.
    (FACTOR / strength - (FACTOR - 1.0)).min(f32::MAX)
}

impl<D: Domain, P: Policy> Reuse<'_, D, P> {
    /// Runs the pass over a band.
    pub(crate) fn boiling(&self, band: &mut Band<'_>) -> Counters {
        let (inputs, chains) = (self.domain.frame(), self.chains);
        let limit = limit(self.settings.boiling);
        let tiles = band.tiles(inputs.shot.size);
        let first = band.range.start as usize * band.width as usize;
        let records: &mut [D::Record] = band.take(inputs.id(Keys::<D::Record>::RESERVOIRS));
        // p̂ W: what a reservoir would show of luminance without visibility.
        let luminance = |record: &D::Record| record.target() * record.finished().weight.get();
        for tile in tiles {
            for chain in 0..chains {
                let places = || {
                    (0..tile.lanes())
                        .filter_map(|lane| tile.pixel(lane))
                        .map(|pixel| (pixel.index as usize - first) * chains + chain)
                };
                let (mut sum, mut count) = (0.0_f64, 0_u32);
                for at in places() {
                    let shown = luminance(&records[at]);
                    if shown > 0.0 {
                        sum += f64::from(shown);
                        count += 1;
                    }
                }
                let mean = (sum / f64::from(count.max(1))) as f32;
                for at in places() {
                    if luminance(&records[at]) > limit * mean {
                        records[at] = records[at].emptied();
                    }
                }
            }
        }
        Counters::default()
    }
}
