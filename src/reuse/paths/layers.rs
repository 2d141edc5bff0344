//! Pictures of what the reservoirs of paths hold.

use super::PathRecord;
use crate::resampling::Finished;
use crate::reuse::temporal::AROUND;

/// The reservoirs of a picture.
pub(crate) struct Kept<'a> {
    /// Width and height.
    pub(crate) size: [u32; 2],
    /// All reservoirs, those of a pixel side by side.
    pub(crate) records: &'a [PathRecord],
    /// Which of a pixel's is shown.
    pub(crate) shown: usize,
    /// The slots of [`crate::reuse::passes::SHIFTS`], those of a reservoir side by side; none where
    /// merges make their own shifts.
    pub(crate) shifts: &'a [[f32; 4]],
}

/// One number a pixel, by name:
///
/// | name | value |
/// |---|---|
/// | `reconnection` | r of the sample, 0 without one |
/// | `weight` | W |
/// | `confidence` | c |
/// | `age` | frames since the sample was fresh |
/// | `duplicates` | share of the 288 pixels around, as far as they are in the picture, with the same sample |
/// | `failure` | the reason of the first shift that is undefined ([`super::Failure::number`]); 0: none is |
/// | `acceptance` | share of the frame's shifts to neighbours that are defined; 0 without one |
pub(crate) fn layers(kept: &Kept<'_>) -> Vec<(&'static str, Vec<f32>)> {
    let pixels = kept.size[0] as usize * kept.size[1] as usize;
    let of = |each: &dyn Fn(usize) -> f32| (0..pixels).map(each).collect::<Vec<f32>>();
    let finished = |pixel: usize| kept.record(pixel).finished();
    let vertex = |pixel| {
        let Finished { sample, .. } = finished(pixel);
        sample.and_then(|sample| sample.reconnection).map_or(0.0, |at| at.vertex.into())
    };
    let mut all = vec![
        ("reconnection", of(&vertex)),
        ("weight", of(&|pixel| finished(pixel).weight.get())),
        ("confidence", of(&|pixel| kept.record(pixel).confidence())),
        ("age", of(&|pixel| kept.record(pixel).age() as f32)),
        ("duplicates", of(&|pixel| kept.duplicates(pixel))),
    ];
    if !kept.shifts.is_empty() {
        let slots = kept.shifts.len() / kept.records.len();
        let slots = |pixel: usize| &kept.shifts[kept.place(pixel) * slots..][..slots];
        let lost = |slot: &&[f32; 4]| slot[3] == 0.0 && slot[0] > 0.0;
        all.push((
            "failure",
            of(&|pixel| slots(pixel).iter().find(lost).map_or(0.0, |slot| slot[0])),
        ));
        all.push((
            "acceptance",
            of(&|pixel| {
                let defined = slots(pixel).iter().filter(|slot| slot[3] != 0.0).count();
                let made = defined + slots(pixel).iter().filter(lost).count();
                if made == 0 { 0.0 } else { defined as f32 / made as f32 }
            }),
        ));
    }
    all
}

impl Kept<'_> {
    /// Where the shown reservoir of a pixel is.
    fn place(&self, pixel: usize) -> usize {
        let pixels = self.size[0] as usize * self.size[1] as usize;
        pixel * (self.records.len() / pixels) + self.shown
    }

    fn record(&self, pixel: usize) -> &PathRecord {
        &self.records[self.place(pixel)]
    }

    fn duplicates(&self, pixel: usize) -> f32 {
        let [width, height] = self.size.map(i64::from);
        let (x, y) = (pixel as i64 % width, pixel as i64 / width);
        let reach = i64::from(AROUND / 2);
        let near = |at: i64, size: i64| (at - reach).max(0)..(at + reach + 1).min(size);
        let (mut same, mut all) = (0_u32, 0_u32);
        for row in near(y, height) {
            for other in near(x, width).map(|column| (row * width + column) as usize) {
                let others = other != pixel;
                all += u32::from(others);
                same += u32::from(others && self.record(pixel).is_same(self.record(other)));
            }
        }
        if all == 0 { 0.0 } else { same as f32 / all as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::LightPoint;
    use crate::resampling::ContributionWeight;
    use crate::reuse::paths::{Ending, PathSample};
    use glam::{Vec2, Vec3};

    fn record(sample: PathSample) -> PathRecord {
        let weight = ContributionWeight::new(2.0);
        PathRecord::new(&Finished { sample: Some(sample), weight, confidence: 3.0 }, 4)
    }

    fn path(seed: u64) -> PathRecord {
        let ending = Ending::Emitter;
        record(PathSample { seed, integrand: Vec3::ONE, last: 1, ending, reconnection: None })
    }

    fn point(light: u32) -> PathRecord {
        record(PathSample::direct(LightPoint { light, uv: Vec2::splat(0.5) }, Vec3::ONE))
    }

    /// Every number is that of its pixel: duplicates are the same path or light point, not the same
    /// seed of another kind, and not those farther away than the square reaches.
    #[test]
    fn layers_are_what_the_reservoirs_hold() {
        let mut row = [PathRecord::default(); 20];
        for (at, kept) in [(0, path(7)), (8, path(7)), (9, path(7)), (10, point(0)), (11, point(0))]
        {
            row[at] = kept;
        }
        (row[12], row[13]) = (path(0), point(1));
        let mut shifts = [[0.0; 4]; 40];
        (shifts[0], shifts[1]) = ([1.0, 1.0, 1.0, 0.5], [6.0, 0.0, 0.0, 0.0]);
        shifts[2] = [0.5, 0.5, 0.5, 2.0];
        let kept = Kept { size: [20, 1], records: &row, shown: 0, shifts: &shifts };
        let found = layers(&kept);
        let of = |name: &str| &found.iter().find(|(known, _)| *known == name).unwrap().1;
        assert_eq!(of("reconnection")[..11], [[0.0; 10].as_slice(), &[1.0]].concat());
        assert_eq!((of("weight")[0], of("weight")[1]), (2.0, 0.0));
        assert_eq!((of("confidence")[0], of("age")[0]), (3.0, 4.0));
        let duplicates = of("duplicates");
        assert_eq!(duplicates[0], 1.0 / 8.0);
        assert_eq!(duplicates[8], 2.0 / 16.0);
        assert_eq!(duplicates[9], 1.0 / 16.0);
        assert_eq!(duplicates[10], 1.0 / 16.0);
        assert_eq!((duplicates[12], duplicates[13], duplicates[1]), (0.0, 0.0, 0.0));
        assert_eq!(of("failure")[..3], [6.0, 0.0, 0.0]);
        assert_eq!(of("acceptance")[..3], [0.5, 1.0, 0.0]);
        let without = Kept { shifts: &[], ..kept };
        assert_eq!(layers(&without).len(), 5);
    }
}
