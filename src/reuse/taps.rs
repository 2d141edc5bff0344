//! The neighbours that a pixel takes samples from in a round of spatial reuse.
//!
//! | kind | partners |
//! |---|---|
//! | [`Taps::Random`] | each pixel its own, uniformly over a disk |
//! | [`Taps::Xor`] | one exchange for all pixels of a frame |
//! | [`Taps::Pairs`] | in each block of pixels the pairs of a random permutation, anew for each frame |
//!
//! The last two are involutions: a pixel's partner has the pixel as its own partner of the same
//! number, so a shift between them serves both.
//!
//! Which pixels they are depends on fresh numbers alone (law 1 of [`super`]).

use super::parameters::Settings;
use super::{MAX_NEIGHBOURS, Taps};
use crate::math::rng::{Purpose, RandomSource, Stream, pcg4d};
use crate::math::warp::sin_cos_turn;
use crate::pass::{FrameInputs, Pixel};

/// A neighbour of a pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tap {
    /// The neighbour's pixel.
    pub(super) index: u32,
    /// How far away it is in pixels, along the axis where it is farther.
    pub(super) distance: u32,
    /// Which of the pixel's taps it is.
    pub(super) number: u32,
}

/// The offsets of one round of spatial reuse.
pub(super) struct Offsets {
    round: u32,
    count: u32,
    radius: f32,
    partners: Partners,
}

/// How taps are found.
enum Partners {
    /// By each pixel's own numbers.
    Random,
    /// Shift and mask of each tap.
    Exchanges([([u32; 2], [u32; 2]); MAX_NEIGHBOURS]),
    /// The blocks of each tap.
    Pairs([Blocks; MAX_NEIGHBOURS]),
}

impl Offsets {
    /// Those of a round of a frame.
    pub(super) fn new(inputs: &FrameInputs<'_>, settings: &Settings, round: u32) -> Self {
        let Settings { neighbours, radius, taps, .. } = *settings;
        let numbers = |tap: usize| inputs.stream(tap as u32, Purpose::Taps, round);
        let partners = match taps {
            Taps::Random => Partners::Random,
            Taps::Xor => {
                Partners::Exchanges(std::array::from_fn(|tap| exchange(&mut numbers(tap), radius)))
            }
            Taps::Pairs => {
                Partners::Pairs(std::array::from_fn(|tap| Blocks::new(&mut numbers(tap), radius)))
            }
        };
        Self { round, count: neighbours, radius, partners }
    }

    /// Calls `each` with every tap of a pixel, `None` where it lies outside of the picture or at
    /// the pixel itself.
    #[inline]
    pub(super) fn visit(
        &self,
        inputs: &FrameInputs<'_>,
        pixel: Pixel,
        mut each: impl FnMut(Option<Tap>),
    ) {
        let mut found = |away, number| each(tap(inputs.shot.size, pixel, away, number));
        match &self.partners {
            Partners::Random => {
                let mut random = inputs.stream(pixel.index, Purpose::Neighbours, self.round);
                for number in 0..self.count {
                    let radius = self.radius * random.uniform().sqrt();
                    let (sin, cos) = sin_cos_turn(random.uniform());
                    found([radius * cos, radius * sin].map(|d| d.round() as i32), number);
                }
            }
            Partners::Exchanges(exchanges) => {
                for (exchange, number) in exchanges.iter().zip(0..self.count) {
                    let ([sx, sy], [mx, my]) = exchange;
                    let partner = |at: u32, shift: &u32, mask: &u32| {
                        (at.wrapping_add(*shift) ^ mask).wrapping_sub(*shift).wrapping_sub(at)
                            as i32
                    };
                    found([partner(pixel.x, sx, mx), partner(pixel.y, sy, my)], number);
                }
            }
            Partners::Pairs(blocks) => {
                for (blocks, number) in blocks.iter().zip(0..self.count) {
                    found(blocks.away([pixel.x, pixel.y]), number);
                }
            }
        }
    }
}

/// Shift s and mask m of an exchange: x ↦ ((x + s) xor m) − s is its own inverse, so pixels
/// exchange their samples in pairs, and moves each coordinate by at most its mask. Masks are
/// uniform over the quarter of a disk of the radius.
fn exchange(random: &mut Stream, radius: f32) -> ([u32; 2], [u32; 2]) {
    let r = radius * random.uniform().sqrt();
    let (sin, cos) = sin_cos_turn(0.25 * random.uniform());
    let mask = [(r * cos).round() as u32, (r * sin).round() as u32];
    // A mask of zeros would leave every pixel with itself.
    let mask = if mask == [0, 0] { [1, 0] } else { mask };
    ([random.word(), random.word()], mask)
}

/// Pairs of pixels in square blocks.
///
/// A block has a side of 2ᵇ pixels and numbers of its own, which permute its pixels; those that
/// come to lie side by side are partners. Two pixels of a block are (side²)/3 apart in the mean of
/// squares, those of a disk radius²/2: with a side of the two powers of two around √1.5 radius,
/// drawn for each frame in the proportion that gives the disk's mean, the pairs are as far apart as
/// random taps. Blocks begin anywhere, so no pixel is on an edge in every frame.
#[derive(Clone, Copy)]
struct Blocks {
    /// b, at least 1 so that no pixel is alone.
    bits: u32,
    /// Where blocks begin.
    origin: [u32; 2],
    /// All blocks of a frame share these numbers.
    key: [u32; 2],
}

impl Blocks {
    fn new(random: &mut Stream, radius: f32) -> Self {
        let square = 1.5 * radius * radius;
        let bits = (square.max(4.0) as u32).ilog2() / 2;
        let smaller = (1_u32 << (2 * bits)) as f32;
        // The larger square has 4 times the smaller one's area.
        let larger = random.uniform() * 3.0 < square / smaller - 1.0;
        let bits = bits + u32::from(larger);
        let origin = [random.word(), random.word()];
        Self { bits, origin, key: [random.word(), random.word()] }
    }

    /// From a pixel to its partner.
    #[inline]
    fn away(&self, at: [u32; 2]) -> [i32; 2] {
        let [x, y] = [0, 1].map(|axis| at[axis].wrapping_add(self.origin[axis]));
        let mask = (1 << self.bits) - 1;
        let keys = pcg4d([x >> self.bits, y >> self.bits, self.key[0], self.key[1]]);
        let (mut a, mut b) = (x & mask, y & mask);
        // Each step changes one half by a function of the other, so it is undone by itself.
        let scramble = |half: u32, key: u32| {
            let hash = (half.wrapping_mul(0x9E37_79B9) ^ key).wrapping_mul(0x85EB_CA6B);
            hash >> (32 - self.bits)
        };
        a ^= scramble(b, keys[0]);
        b ^= scramble(a, keys[1]);
        a ^= scramble(b, keys[2]);
        b ^= scramble(a, keys[3]);
        a ^= 1;
        b ^= scramble(a, keys[3]);
        a ^= scramble(b, keys[2]);
        b ^= scramble(a, keys[1]);
        a ^= scramble(b, keys[0]);
        [a as i32 - (x & mask) as i32, b as i32 - (y & mask) as i32]
    }
}

/// The pixel (dx, dy) away, if it is another one of the picture.
#[inline]
fn tap([width, height]: [u32; 2], pixel: Pixel, [dx, dy]: [i32; 2], number: u32) -> Option<Tap> {
    let (x, y) = (i64::from(pixel.x) + i64::from(dx), i64::from(pixel.y) + i64::from(dy));
    let [across, down] = [width, height].map(i64::from);
    let inside = (0..across).contains(&x) && (0..down).contains(&y) && (dx, dy) != (0, 0);
    inside.then(|| Tap {
        index: (y * across + x) as u32,
        distance: dx.unsigned_abs().max(dy.unsigned_abs()),
        number,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Stage;
    use crate::plan::{Filter, Shot};
    use crate::scene::Scene;
    use crate::techniques::parse;

    /// Distances of neighbours are those of points spread uniformly over a disk: the mean of their
    /// squares is half the radius's, in all directions alike. Masks of exchanges, too. (A radius
    /// in proportion to u in place of its root has a third.)
    #[test]
    fn neighbours_are_spread_uniformly_over_a_disk() {
        const RADIUS: f32 = 200.0;
        let stage = Stage::new(Scene::new("empty")).unwrap();
        let shot = Shot {
            size: [1000, 1000],
            depth: 2,
            filter: Filter::Point,
            run: 3,
            effort: 1.0,
            fps: 30,
        };
        let spec = "restir-di:taps=random,neighbours=4";
        let plan = parse(spec).unwrap().plan(stage.facts(), &shot);
        let world = stage.first_world();
        let camera = world.scene.camera.rays(shot.size);
        let inputs = FrameInputs {
            world,
            previous: None,
            shot,
            plan: &plan,
            camera,
            motion: None,
            frame: 0,
            buffers: &[],
        };
        let settings =
            Settings { neighbours: 4, radius: RADIUS, taps: Taps::Random, ..Settings::default() };
        let mut means = [[0.0_f64; 3]; 2];
        let mut count = 0.0;
        for round in 0..2 {
            let offsets = Offsets::new(&inputs, &settings, round);
            for at in 0..20_000 {
                let (x, y) = (300 + at % 400, 300 + at / 400);
                offsets.visit(&inputs, Pixel { index: y * 1000 + x, x, y }, |tap| {
                    let Some(tap) = tap else { return };
                    let there = [(tap.index % 1000) as f64, (tap.index / 1000) as f64];
                    let [dx, dy] = [there[0] - f64::from(x), there[1] - f64::from(y)]
                        .map(|d| d / f64::from(RADIUS));
                    let farther = f64::from(RADIUS) * dx.abs().max(dy.abs());
                    assert!((f64::from(tap.distance) - farther).abs() < 1e-6);
                    means[0][0] += dx * dx + dy * dy;
                    means[0][1] += dx;
                    means[0][2] += dy;
                    count += 1.0;
                });
            }
        }
        let exchanges = 20_000;
        for key in 0..exchanges {
            let (_, mask) = exchange(&mut Stream::from_key(key), RADIUS);
            let [mx, my] = mask.map(|m| f64::from(m) / f64::from(RADIUS));
            means[1][0] += mx * mx + my * my;
            means[1][1] += mx * mx - my * my;
        }
        means[0].iter_mut().for_each(|mean| *mean /= count);
        means[1].iter_mut().for_each(|mean| *mean /= exchanges as f64);
        // Standard errors are 0.001 and 0.002.
        assert!((means[0][0] - 0.5).abs() < 0.005, "{means:?}");
        assert!(means[0][1].abs() < 0.01 && means[0][2].abs() < 0.01, "{means:?}");
        assert!((means[1][0] - 0.5).abs() < 0.01 && means[1][1].abs() < 0.015, "{means:?}");
    }

    /// Exchanges pair pixels: the partner's partner is the pixel itself, no farther away than the
    /// radius allows. The control, the same without the shift back, pairs nothing.
    #[test]
    fn exchanges_pair_the_pixels() {
        let mut farthest = 0.0_f32;
        for key in 0..200 {
            let mut random = Stream::from_key(key);
            let ([sx, _], [mx, my]) = exchange(&mut random, 16.0);
            assert!((mx, my) != (0, 0));
            farthest = farthest.max(((mx * mx + my * my) as f32).sqrt());
            let partner = |x: u32| (x.wrapping_add(sx) ^ mx).wrapping_sub(sx);
            let without = |x: u32| x.wrapping_add(sx) ^ mx;
            for x in 0..64 {
                assert_eq!(partner(partner(x)), x);
                let away = (partner(x).wrapping_sub(x) as i32).unsigned_abs();
                assert!(away <= mx, "{x} exchanges with a pixel {away} away, the mask is {mx}");
            }
            assert!(mx == 0 || (0..64).any(|x| without(without(x)) != x));
        }
        assert!((14.0..=17.0).contains(&farthest), "{farthest}");
    }

    /// Pairs are involutions without a fixed point; partners are as far apart as those of a disk in
    /// the mean of squares, in all directions alike, and pixels side by side have partners of their
    /// own. (Without the last step undone, nothing is paired.)
    #[test]
    fn pairs_are_involutions() {
        for radius in [1.0_f32, 2.0, 5.5, 16.0, 100.0] {
            let (mut squares, mut along, mut count, mut together) = (0.0, 0.0, 0.0_f64, 0.0);
            for key in 0..1000 {
                let blocks = Blocks::new(&mut Stream::from_key(key), radius);
                let mut last = [0, 0];
                for at in 0..256_u32 {
                    let here = [100 + at % 16, 50 + at / 16];
                    let [dx, dy] = blocks.away(here);
                    assert_ne!([dx, dy], [0, 0]);
                    let there = [here[0].wrapping_add_signed(dx), here[1].wrapping_add_signed(dy)];
                    assert_eq!(blocks.away(there), [-dx, -dy], "radius {radius}");
                    let [x, y] = [dx, dy].map(|d| f64::from(d) / f64::from(radius));
                    squares += x * x + y * y;
                    along += x * x - y * y;
                    together += f64::from(u8::from(last == [dx, dy]));
                    count += 1.0;
                    last = [dx, dy];
                }
            }
            let [squares, along] = [squares, along].map(|sum| sum / count);
            // A block of 2 by 2 is as small as blocks are.
            let expected = if radius < 2.0 { 4.0 / 3.0 } else { 0.5 };
            assert!((squares / expected - 1.0).abs() < 0.05, "radius {radius}: {squares}");
            // In a block of 2 by 2 four steps lead across in 6 of 16 cases, elsewhere in 5.
            let expected = if radius < 2.0 { 1.0 / 16.0 } else { 0.0 };
            assert!((along - expected).abs() < 0.03, "radius {radius}: {along}");
            if radius >= 16.0 {
                assert!(together / count < 0.02, "radius {radius}: {}", together / count);
            }
        }
    }
}
