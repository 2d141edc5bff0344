//! Averaged, selected and corrected visibility on two lights and one or two pixels: each
//! estimator's exact mean, and what it claims of it.

use glam::Vec3;

use super::laws::{Ring, metropolis_rule};
use super::{assert_close, is_close};
use crate::math::rng::RandomSource;
use crate::resampling::{
    Claim, ContributionWeight, ControlVariate, Counting, Decoupled, DecoupledState, Estimator,
    Family, Finished, Identity, Input, Merges, Plain, Reservoir, Selected, SelectedState,
    WeightedVisibility, WithRadiance, WithVisibility, merge, metropolis, mutated_weight,
};
use crate::stats::{Enumerator, enumerate_f64, expectation};

/// What a pixel sees of two lights.
#[derive(Clone, Copy, Debug)]
struct Receiver {
    /// f, unshadowed.
    integrand: [Vec3; 2],
    /// p̂.
    target: [f32; 2],
    /// V.
    visible: [f32; 2],
}

impl Receiver {
    /// Grey light with p̂ = f.
    fn grey(integrand: [f32; 2], visible: [f32; 2]) -> Self {
        Self { integrand: integrand.map(Vec3::splat), target: integrand, visible }
    }

    /// F(y) per W: shadowed.
    fn shadowed(&self, light: usize) -> Vec3 {
        self.integrand[light] * self.visible[light]
    }
}

/// A pixel between two passes.
#[derive(Clone, Copy, Debug)]
struct Pixel {
    receiver: Receiver,
    finished: Finished<usize, Counting>,
    /// V̄.
    average: f32,
    /// What [`ControlVariate`] is given, and what it makes of it.
    decoupled: DecoupledState,
}

type Averaging = WithRadiance<WithVisibility<Plain<usize>>>;

impl Pixel {
    /// One uniform candidate and its shadow ray.
    fn initial(receiver: Receiver, confidence: f32, random: &mut impl RandomSource) -> Self {
        let light = random.index(2) as usize;
        let mut reservoir = Averaging::default();
        let weight = 2.0 * receiver.target[light];
        let carried = (((), receiver.visible[light]), receiver.shadowed(light) * 2.0);
        reservoir.stream(light, weight, carried, random);
        let finished = reservoir.finish(receiver.target[light], confidence);
        Self::of(receiver, &reservoir, finished, Vec3::ZERO)
    }

    fn of(
        receiver: Receiver,
        reservoir: &Averaging,
        finished: Finished<usize, Counting>,
        correction: Vec3,
    ) -> Self {
        Self {
            receiver,
            finished,
            average: reservoir.inner().visibility(),
            decoupled: DecoupledState { radiance: reservoir.radiance(), correction },
        }
    }

    /// What its sample contributes at another receiver.
    fn contribution(&self, receiver: &Receiver) -> Vec3 {
        let shadowed = self.finished.sample.map_or(Vec3::ZERO, |light| receiver.shadowed(light));
        shadowed * self.finished.weight.get()
    }

    /// Merges; the first `chained` of the others bring their V̄ and C̄, the rest get a fresh ray.
    /// `subtract` is where F̃ of a chain is taken.
    fn merge(
        &self,
        others: &[Self],
        chained: usize,
        family: Family,
        subtract: Subtract,
        random: &mut impl RandomSource,
    ) -> Self {
        let mut map = Identity::new(|&light: &usize, receiver: &Receiver| receiver.target[light]);
        fn input(pixel: &Pixel) -> Input<'_, usize, Receiver, Counting> {
            let target = pixel.finished.sample.map_or(0.0, |light| pixel.receiver.target[light]);
            Input { finished: pixel.finished, target, domain: &pixel.receiver }
        }
        let inputs: Vec<_> = others.iter().map(input).collect();
        let mut reservoir = Averaging::default();
        let merged = merge(
            &mut map,
            family,
            &input(self),
            inputs.as_slice(),
            &mut reservoir,
            random,
            |term| {
                let light = term.shifted.map_or(self.finished.sample, |s| Some(s.sample)).unwrap();
                let average = match term.input {
                    0 => self.average,
                    i if i <= chained => others[i - 1].average,
                    _ => self.receiver.visible[light],
                };
                (((), average), self.receiver.shadowed(light) * term.contribution)
            },
        );
        let total = merged.finished.confidence;
        let mut correction = Vec3::ZERO;
        for pixel in others[..chained].iter().chain([self]) {
            let earlier = match subtract {
                Subtract::WhereItWasMade => pixel.contribution(&pixel.receiver),
                Subtract::WhereItIsUsed => pixel.contribution(&self.receiver),
            };
            let share = pixel.finished.confidence / total;
            correction += (ControlVariate::radiance(&pixel.decoupled) - earlier) * share;
        }
        Self::of(self.receiver, &reservoir, merged.finished, correction)
    }

    /// This frame's candidate merged with this pixel as last frame's, at most `cap` frames old.
    fn next(
        &self,
        receiver: Receiver,
        (family, cap): (Family, f32),
        subtract: Subtract,
        random: &mut impl RandomSource,
    ) -> Self {
        let mut previous = *self;
        previous.finished.confidence = previous.finished.confidence.min(cap);
        let fresh = Self::initial(receiver, 1.0, random);
        fresh.merge(&[previous], 1, family, subtract, random)
    }

    /// As many frames of a still receiver, with confidence `confidence` after all.
    fn history(
        receiver: Receiver,
        frames: u32,
        confidence: f32,
        random: &mut impl RandomSource,
    ) -> Self {
        let mut pixel = Self::initial(receiver, 1.0, random);
        for _ in 1..frames {
            let how = (Family::Constant, f32::INFINITY);
            pixel = pixel.next(receiver, how, Subtract::WhereItWasMade, random);
        }
        pixel.finished.confidence = confidence;
        pixel
    }

    /// What the estimators show: V̄, the selected sample's V, all inputs, the control variate.
    fn shown(&self) -> [Vec3; 4] {
        let light = self.finished.sample.unwrap_or(0);
        let state = |visibility| SelectedState {
            integrand: self.receiver.integrand[light],
            visibility,
            weight: self.finished.weight.get(),
        };
        [
            WeightedVisibility::radiance(&state(self.average)),
            Selected::radiance(&state(self.receiver.visible[light])),
            Decoupled::radiance(&self.decoupled),
            ControlVariate::radiance(&self.decoupled),
        ]
    }
}

/// Where the sample that a chain's earlier estimate is compared with is evaluated.
#[derive(Clone, Copy, Debug)]
enum Subtract {
    WhereItWasMade,
    WhereItIsUsed,
}

const HERE: Subtract = Subtract::WhereItWasMade;

/// The means of [`Pixel::shown`].
fn means(mut run: impl FnMut(&mut Enumerator<f64>) -> Pixel) -> [[f64; 3]; 4] {
    let outcomes = enumerate_f64(|random| run(random).shown());
    [0, 1, 2, 3].map(|i| {
        [0, 1, 2].map(|channel| expectation(&outcomes, |shown| f64::from(shown[i][channel])))
    })
}

/// The same of grey light.
fn grey_means(run: impl FnMut(&mut Enumerator<f64>) -> Pixel) -> [f64; 4] {
    means(run).map(|rgb| rgb[0])
}

/// The claims in the order of [`Pixel::shown`].
fn claims(conditions: &Merges) -> [Claim; 4] {
    [
        WeightedVisibility::claim(conditions),
        Selected::claim(conditions),
        Decoupled::claim(conditions),
        ControlVariate::claim(conditions),
    ]
}

/// Reuse with nothing that could go wrong.
const SOUND: Merges = Merges {
    reuse: true,
    partition: true,
    streamed_partition: true,
    chained_weight_constant: true,
    still: true,
    target_proportional: true,
    own_visibility: true,
    drops_occluded: false,
    sample_blind: true,
};

/// That the ratio form has mean `ratio`, the others `others`, and that each claims to be right
/// exactly if it is.
#[track_caller]
fn check(conditions: Merges, found: [f64; 4], truth: f64, ratio: f64, others: f64) {
    check_each(conditions, found, truth, [ratio, others, others, others]);
}

/// The same with a mean for each.
#[track_caller]
fn check_each(conditions: Merges, found: [f64; 4], truth: f64, expected: [f64; 4]) {
    for ((claim, found), expected) in claims(&conditions).into_iter().zip(found).zip(expected) {
        assert!(is_close(found, expected), "{found:?} instead of {expected}: {claim}");
        assert_eq!(claim == Claim::Unbiased, is_close(expected, truth), "{found}: {claim}");
    }
}

// I = 1 and I = 3, with targets that are not proportional.
fn pixel_a() -> Receiver {
    Receiver::grey([1.0, 1.0], [1.0, 0.0])
}

fn pixel_b() -> Receiver {
    Receiver::grey([1.0, 3.0], [0.0, 1.0])
}

/// A history of some frames at one receiver, merged with fresh samples of others, all of
/// confidence 1.
fn after(own: (Receiver, u32), others: &[Receiver], family: Family) -> [f64; 4] {
    grey_means(|random| {
        let own = Pixel::history(own.0, own.1, 1.0, random);
        let others: Vec<_> = others.iter().map(|&r| Pixel::initial(r, 1.0, random)).collect();
        own.merge(&others, 0, family, HERE, random)
    })
}

#[test]
fn without_reuse_all_estimators_agree_and_are_exact() {
    let fresh = grey_means(|random| Pixel::initial(pixel_b(), 1.0, random));
    let nothing = Merges {
        reuse: false,
        partition: false,
        streamed_partition: false,
        chained_weight_constant: false,
        still: false,
        target_proportional: false,
        own_visibility: false,
        drops_occluded: true,
        sample_blind: false,
    };
    check(nothing, fresh, 3.0, 3.0, 3.0);
}

#[test]
fn weights_that_know_the_sample_bias_an_averaged_visibility() {
    let varying = Merges { chained_weight_constant: false, ..SOUND };
    for (family, conditions, ratio) in [
        (Family::Constant, SOUND, 1.0),
        (Family::InverseCount, SOUND, 1.0),
        (Family::Contribution, varying, 31.0 / 32.0),
        (Family::Balance, varying, 15.0 / 16.0),
        (Family::Pairwise, varying, 15.0 / 16.0),
        (Family::DefensivePairwise, varying, 31.0 / 32.0),
    ] {
        check(conditions, after((pixel_a(), 2), &[pixel_b()], family), 1.0, ratio, 1.0);
    }
}

#[test]
fn that_bias_grows_with_the_age_of_the_average() {
    let varying = Merges { chained_weight_constant: false, ..SOUND };
    for (frames, bias) in [(3, -1.0 / 12.0), (5, -0.1), (8, -7.0 / 64.0)] {
        let found = after((pixel_a(), frames), &[pixel_b()], Family::Balance);
        check(varying, found, 1.0, 1.0 + bias, 1.0);
    }
    // Of one frame it is no average yet.
    check(SOUND, after((pixel_a(), 1), &[pixel_b()], Family::Balance), 1.0, 1.0, 1.0);
}

/// Both pixels through initial, temporal and spatial passes; history is what came out of the last
/// one.
fn looped(frames: u32, cap: f32, family: Family, random: &mut impl RandomSource) -> [Pixel; 2] {
    let receivers = [pixel_a(), pixel_b()];
    let mut pixels: Option<[Pixel; 2]> = None;
    for _ in 0..frames {
        let temporal = [0, 1].map(|i| match pixels {
            None => Pixel::initial(receivers[i], 1.0, random),
            Some(before) => before[i].next(receivers[i], (Family::Constant, cap), HERE, random),
        });
        pixels =
            Some([0, 1].map(|i| temporal[i].merge(&[temporal[1 - i]], 0, family, HERE, random)));
    }
    pixels.unwrap()
}

#[test]
fn a_loop_of_two_pixels_has_the_bias_of_its_weights_from_the_second_frame() {
    let varying = Merges { chained_weight_constant: false, ..SOUND };
    for (cap, family, conditions, ratio) in [
        (20.0, Family::Constant, SOUND, [1.0, 3.0]),
        (20.0, Family::Balance, varying, [463.0 / 504.0, 1_956_963.0 / 680_680.0]),
        (20.0, Family::DefensivePairwise, varying, [19_775.0 / 20_592.0, 27_559.0 / 9360.0]),
        (1.0, Family::Balance, varying, [1861.0 / 2016.0, f64::NAN]),
        (1.0, Family::DefensivePairwise, varying, [15_701.0 / 16_320.0, f64::NAN]),
    ] {
        for pixel in [0, 1] {
            let truth = [1.0, 3.0][pixel];
            let first = grey_means(|random| looped(1, cap, family, random)[pixel]);
            check(SOUND, first, truth, truth, truth);
            let second = grey_means(|random| looped(2, cap, family, random)[pixel]);
            let ratio = if ratio[pixel].is_nan() { second[0] } else { ratio[pixel] };
            check(conditions, second, truth, ratio, truth);
        }
    }
}

/// One fresh sample with last frame's pixel of another receiver, at equal confidence.
fn moved(from: (Receiver, u32), to: Receiver, subtract: Subtract) -> [f64; 4] {
    grey_means(|random| {
        let before = Pixel::history(from.0, from.1, 1.0, random);
        before.next(to, (Family::Constant, 20.0), subtract, random)
    })
}

#[test]
fn a_chain_may_change_receivers_if_what_it_saw_and_its_weight_stay() {
    let now = pixel_a();
    let lags = Merges { still: false, ..SOUND };
    let everything = Receiver::grey([1.0, 1.0], [1.0, 1.0]);
    check(lags, moved((everything, 2), now, HERE), 1.0, 1.5, 1.0);
    let brighter = Receiver::grey([3.0, 3.0], [1.0, 0.0]);
    check(SOUND, moved((brighter, 2), now, HERE), 1.0, 1.0, 1.0);
    let steeper = Receiver::grey([1.0, 3.0], [1.0, 0.0]);
    let varying = Merges { chained_weight_constant: false, ..SOUND };
    check(varying, moved((steeper, 2), now, HERE), 1.0, 7.0 / 8.0, 1.0);
}

/// A merge by hand at [`pixel_a`]: inputs with MIS weights for both lights, a visibility for both,
/// or an average.
fn by_hand(inputs: &[(Pixel, [f32; 2], Option<f32>)], random: &mut impl RandomSource) -> Pixel {
    let receiver = pixel_a();
    let mut reservoir = Averaging::default();
    for (pixel, mis, average) in inputs {
        let Some(light) = pixel.finished.sample else { continue };
        let contribution = mis[light] * pixel.finished.weight.get();
        let visibility = average.unwrap_or(receiver.visible[light]);
        let carried = (((), visibility), receiver.shadowed(light) * contribution);
        reservoir.stream(light, contribution * receiver.target[light], carried, random);
    }
    let target = reservoir.selected().map_or(0.0, |light| receiver.target[light]);
    let finished = reservoir.finish(target, 1.0);
    Pixel::of(receiver, &reservoir, finished, Vec3::ZERO)
}

#[test]
fn a_chained_weight_may_vary_as_the_ratio_of_targets() {
    // Another receiver's history with m = p̂ of it / p̂ / 4: weights from 1/4 to 3/4, and exact.
    let steeper = Receiver::grey([1.0, 3.0], [1.0, 0.0]);
    let found = grey_means(|random| {
        let before = Pixel::history(steeper, 2, 1.0, random);
        let fresh = Pixel::initial(pixel_a(), 1.0, random);
        let inputs = [(before, [0.25, 0.75], Some(before.average)), (fresh, [0.75, 0.25], None)];
        by_hand(&inputs, random)
    });
    check(SOUND, found, 1.0, 1.0, 1.0);
}

#[test]
fn neighbours_with_fresh_rays_may_share_what_the_chain_leaves_if_they_cover_it() {
    let neighbours = [[1.0, 3.0], [2.0, 1.0]].map(|f| Receiver::grey(f, [0.0, 1.0]));
    let third = 1.0 / 3.0;
    let found = grey_means(|random| {
        let own = Pixel::history(pixel_a(), 3, 1.0, random);
        let [one, two] = neighbours.map(|r| Pixel::initial(r, 1.0, random));
        let inputs = [
            (own, [third; 2], Some(own.average)),
            (one, [2.0 * third / 3.0, 2.0 * third * 0.75], None),
            (two, [2.0 * third * 2.0 / 3.0, 2.0 * third / 4.0], None),
        ];
        by_hand(&inputs, random)
    });
    check(SOUND, found, 1.0, 1.0, 1.0);

    // Where all miss a light, constant weights lose it with any estimator, and others make the
    // chain's weight vary.
    let blind = Receiver::grey([0.0, 1.0], [1.0, 1.0]);
    let loses = Merges { partition: false, streamed_partition: false, ..SOUND };
    check(loses, after((pixel_a(), 2), &[blind], Family::Constant), 1.0, 0.5, 0.5);
    check(
        loses,
        after((pixel_a(), 2), &[blind; 2], Family::Constant),
        1.0,
        third.into(),
        third.into(),
    );
    // 1/Z is known after the selection only: what all inputs show together is still 1/M.
    let found = after((pixel_a(), 2), &[blind], Family::InverseCount);
    let conditions = Merges { chained_weight_constant: false, streamed_partition: false, ..SOUND };
    check_each(conditions, found, 1.0, [25.0 / 32.0, 1.0, 0.5, 0.5]);
    for family in Family::ALL.into_iter().filter(|f| f.terms_partition_unity()) {
        let found = after((pixel_a(), 2), &[blind], family);
        assert!(found[1..].iter().all(|&mean| is_close(mean, 1.0)), "{family:?}: {found:?}");
    }
}

#[test]
fn an_average_needs_a_target_proportional_to_the_integrand() {
    let receiver = Receiver { target: [1.0, 1.0], ..Receiver::grey([1.0, 3.0], [1.0, 0.0]) };
    let other = Receiver { target: [1.0, 3.0], ..receiver };
    let conditions = Merges { target_proportional: false, ..SOUND };
    // Even where nothing is chained.
    check(conditions, after((receiver, 1), &[other], Family::Constant), 1.0, 1.5, 1.0);
    check(conditions, after((receiver, 1), &[other], Family::Balance), 1.0, 22.0 / 15.0, 1.0);
}

#[test]
fn colour_leaks_from_an_average_and_from_nothing_else() {
    let red_and_green = [Vec3::new(3.0, 0.0, 0.0), Vec3::new(0.0, 3.0, 0.0)];
    let receiver = Receiver { integrand: red_and_green, ..pixel_a() };
    let other = Receiver { target: [1.0, 3.0], ..receiver };
    let run = |family| {
        means(|random| {
            let mut pixel = Pixel::initial(receiver, 1.0, random);
            for _ in 0..2 {
                pixel = pixel.next(receiver, (Family::Constant, 20.0), HERE, random);
                let neighbour = Pixel::initial(other, 1.0, random);
                pixel = pixel.merge(&[neighbour], 0, family, HERE, random);
            }
            pixel
        })
    };
    let constant = Merges { target_proportional: false, ..SOUND };
    let balance = Merges { chained_weight_constant: false, ..constant };
    for (family, conditions, leaked) in [
        (Family::Constant, constant, Some([9.0 / 5.0, 6.0 / 5.0])),
        (Family::Balance, balance, None),
    ] {
        let found = run(family);
        if let Some(leaked) = leaked {
            assert_close(found[0][0], leaked[0]);
            assert_close(found[0][1], leaked[1]);
        } else {
            // Not even the sum is right: three digits are known.
            assert!(
                (found[0][0] - 1.659).abs() < 5e-4 && (found[0][1] - 0.986).abs() < 5e-4,
                "{found:?}"
            );
        }
        assert!(matches!(claims(&conditions)[0], Claim::Biased(_)));
        for (claim, found) in claims(&conditions)[1..].iter().zip(&found[1..]) {
            assert_eq!(*claim, Claim::Unbiased);
            assert_close(found[0], 3.0);
            assert_close(found[1], 0.0);
        }
    }
}

#[test]
fn a_control_variate_is_exact_under_motion_if_it_subtracts_where_the_chain_was() {
    let before = Receiver::grey([1.0, 3.0], [1.0, 0.0]);
    let now = Receiver::grey([2.0, 1.0], [1.0, 1.0]);
    let run = |subtract, frames| {
        grey_means(|random| {
            let mut pixel = Pixel::history(before, 2, 2.0, random);
            for _ in 0..frames {
                pixel = pixel.next(now, (Family::Constant, 20.0), subtract, random);
            }
            pixel
        })
    };
    let moving = Merges { still: false, ..SOUND };
    check(moving, run(HERE, 1), 3.0, 23.0 / 12.0, 3.0);
    assert_close(run(HERE, 2)[3], 3.0);
    // Control: the same samples at the new receiver.
    assert_close(run(Subtract::WhereItIsUsed, 1)[3], 5.0 / 3.0);
    assert_close(run(Subtract::WhereItIsUsed, 2)[3], 2.0);
    // Where the ratio form is exact, it doubles.
    let brighter = Receiver::grey([3.0, 3.0], [1.0, 0.0]);
    assert_close(moved((brighter, 2), pixel_a(), Subtract::WhereItIsUsed)[3], 2.0);
}

#[test]
fn a_control_variate_is_exact_with_a_random_receiver_in_each_frame() {
    // 1, 1/2 and 3: 3/2 in the mean.
    let receivers =
        [pixel_a(), Receiver::grey([0.5, 1.0], [1.0, 0.0]), Receiver::grey([1.0, 2.0], [1.0, 1.0])];
    for family in [Family::Constant, Family::Balance] {
        let run = |subtract, frames| {
            grey_means(|random| {
                let mut at = random.index(3);
                let mut pixel = Pixel::initial(receivers[at as usize], 1.0, random);
                for _ in 1..frames {
                    let to = random.index(3);
                    // How much the chain counts depends on both receivers.
                    let cap = [20.0, 0.5, 1.0][(3 * at + to) as usize % 5 % 3];
                    let receiver = receivers[to as usize];
                    pixel = pixel.next(receiver, (family, cap), subtract, random);
                    at = to;
                }
                pixel
            })
        };
        for frames in [2, 3] {
            let found = run(HERE, frames);
            assert!(found[1..].iter().all(|&mean| is_close(mean, 1.5)), "{found:?}");
            // Control.
            let written = run(Subtract::WhereItIsUsed, frames)[3];
            assert!((written - 1.5).abs() > 0.01, "{written}");
        }
    }
}

#[test]
fn a_coefficient_or_confidence_that_knows_the_sample_is_biased() {
    let coefficient = |of: [f32; 2]| {
        let outcomes = enumerate_f64(|random| {
            let before = Pixel::history(pixel_a(), 2, 1.0, random);
            let fresh = Pixel::initial(pixel_a(), 1.0, random);
            let merged = fresh.merge(&[before], 1, Family::Constant, HERE, random);
            let earlier = ControlVariate::radiance(&before.decoupled);
            let difference = earlier - before.contribution(&before.receiver);
            let correction = difference * of[before.finished.sample.unwrap()];
            ControlVariate::radiance(&DecoupledState { correction, ..merged.decoupled }).x
        });
        expectation(&outcomes, |&shown| shown.into())
    };
    assert_close(coefficient([0.5, 0.5]), 1.0);
    assert_close(coefficient([0.5, 0.125]), 29.0 / 32.0);

    let knows = Merges { sample_blind: false, ..SOUND };
    let found = grey_means(|random| {
        let mut before = Pixel::history(pixel_a(), 2, 1.0, random);
        if before.finished.sample == Some(0) {
            before.finished.confidence = 2.0;
        }
        before.next(pixel_a(), (Family::Constant, 20.0), HERE, random)
    });
    // The weights of two frames are 2/3 or 1/2: 1 + (2/3 − 1/2) / 2.
    assert_close(found[1], 13.0 / 12.0);
    for (claim, mean) in claims(&knows).into_iter().zip(found) {
        assert!(matches!(claim, Claim::Biased(_)) && !is_close(mean, 1.0), "{mean}: {claim}");
    }
}

/// An initial sample that is dropped if occluded.
fn dropping(receiver: Receiver, dropped: f32, random: &mut impl RandomSource) -> Pixel {
    let mut pixel = Pixel::initial(receiver, 1.0, random);
    if pixel.average == 0.0 {
        pixel.finished = Finished::empty(dropped);
    }
    pixel
}

#[test]
fn a_dropped_sample_keeps_its_confidence() {
    let run = |dropped: f32| {
        grey_means(|random| {
            let [before, fresh] = [(); 2].map(|()| dropping(pixel_a(), dropped, random));
            // The core wants a canonical confidence above 0.
            let (canonical, other) =
                if fresh.finished.confidence > 0.0 { (fresh, before) } else { (before, fresh) };
            if canonical.finished.confidence == 0.0 {
                return canonical;
            }
            canonical.merge(&[other], 1, Family::Constant, HERE, random)
        })
    };
    check(SOUND, run(1.0), 1.0, 1.0, 1.0);
    let knows = Merges { sample_blind: false, ..SOUND };
    check(knows, run(0.0), 1.0, 1.5, 1.5);
}

#[test]
fn what_one_receiver_does_not_see_is_lost_to_one_that_does() {
    let open = Receiver::grey([1.0, 1.0], [1.0, 1.0]);
    for family in Family::ALL {
        let found = grey_means(|random| {
            let own = dropping(open, 1.0, random);
            let other = dropping(pixel_a(), 1.0, random);
            own.merge(&[other], 0, family, HERE, random)
        });
        let drops = Merges { drops_occluded: true, ..SOUND };
        // A contribution or balance weight that knows no visibility is 1/2; pairs leave the
        // canonical 3/4 of two.
        let kept = if family == Family::DefensivePairwise { 1.75 } else { 1.5 };
        check(drops, found, 2.0, kept, kept);
    }
}

#[test]
fn a_visibility_is_not_for_another_receiver() {
    // The neighbour's stored visibility instead of a ray.
    let open = Receiver::grey([1.0, 1.0], [1.0, 1.0]);
    let outcomes = enumerate_f64(|random| {
        let own = Pixel::initial(pixel_a(), 1.0, random);
        let other = Pixel::initial(open, 1.0, random);
        let merged = own.merge(&[other], 1, Family::Constant, HERE, random);
        // Two samples of equal weight: either is the selected one.
        let stored = if random.index(2) == 0 { own } else { other };
        let light = stored.finished.sample.unwrap();
        let weight = merged.finished.weight.get();
        let integrand = pixel_a().integrand[light];
        Selected::radiance(&SelectedState { integrand, visibility: stored.average, weight }).x
    });
    assert_close(expectation(&outcomes, |&shown| shown.into()), 1.5);
    let conditions = Merges { own_visibility: false, ..SOUND };
    assert!(matches!(Selected::claim(&conditions), Claim::Biased(_)));
}

#[test]
fn a_mutation_between_passes_keeps_the_average_right() {
    let receiver = Receiver::grey([1.0, 3.0], [1.0, 0.0]);
    let run = |keeps: bool| {
        grey_means(|random| {
            let mut before = Pixel::history(receiver, 2, 1.0, random);
            let mut ring = Ring { target: &receiver.target, acceptance: metropolis_rule };
            let old = before.finished.sample.unwrap();
            let new = metropolis(&mut ring, old, 3, random).state;
            let weight = before.finished.weight.get();
            let weight = mutated_weight(weight, receiver.target[old], receiver.target[new]);
            before.finished.sample = Some(new);
            before.finished.weight = ContributionWeight::new(weight);
            if !keeps {
                before.average = receiver.visible[new];
            }
            let [_, selected, decoupled, _] = before.shown();
            before.decoupled = DecoupledState { radiance: decoupled, correction: Vec3::ZERO };
            assert!(selected.is_finite());
            before.next(receiver, (Family::Constant, 20.0), HERE, random)
        })
    };
    check(SOUND, run(true), 1.0, 1.0, 1.0);
    // A fresh ray for the new sample would be right as well, only noisier.
    check(SOUND, run(false), 1.0, 1.0, 1.0);
}
