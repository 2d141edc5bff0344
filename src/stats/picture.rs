//! Is a picture right? Independent restarts against a reference, at three scales.
//!
//! | scale | sample | question |
//! |---|---|---|
//! | image | image mean of a restart | equivalence: is the relative bias surely below δ? |
//! | tile | tile mean of a restart | does any tile differ ([`Restarts::compare`])? is each surely right ([`Restarts::parts`])? |
//! | pixel | pixel of a restart | map of p-values, to look at |
//!
//! Pixels of one restart are correlated wherever samples are reused, so every variance is across
//! restarts, never across pixels or frames. Tile means are close to normal where pixels are not
//! (Jung, Hanika, Dachsbacher 2020). Per-pixel tests alone are weak: at 2·10⁶ samples a 256²
//! picture may be wrong by one standard deviation in every pixel and pass.

use glam::Vec3;

use super::{
    Equivalence, Estimate, KolmogorovSmirnov, Margin, Moments, Part, Place, Quantity, Tolerance,
    Verdict, benjamini_hochberg, equivalence, holm, ks_uniform, sidak_p, welch,
};
use crate::error::{Error, Result};
use crate::math::luminance;

/// Red, green, blue, luminance.
const QUANTITIES: usize = 4;
const LUMINANCE: usize = 3;

/// Rec. 709, as [`luminance`].
const LUMINANCE_WEIGHTS: [f64; 3] = [0.2126, 0.7152, 0.0722];

fn quantities(rgb: Vec3) -> [f64; QUANTITIES] {
    [rgb.x.into(), rgb.y.into(), rgb.z.into(), luminance(rgb).into()]
}

/// Size, tiles and mask that pictures must share to be compared.
#[derive(Clone, Debug, PartialEq)]
struct Layout {
    width: usize,
    height: usize,
    tile: usize,
    /// True where a pixel counts.
    mask: Option<Vec<bool>>,
}

impl Layout {
    fn columns(&self) -> usize {
        self.width.div_ceil(self.tile)
    }

    fn tiles(&self) -> usize {
        self.columns() * self.height.div_ceil(self.tile)
    }

    fn counts(&self, pixel: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask[pixel])
    }

    fn tile_of(&self, pixel: usize) -> usize {
        let (x, y) = (pixel % self.width, pixel / self.width);
        y / self.tile * self.columns() + x / self.tile
    }

    /// The pixels that count, with their tiles.
    fn pixels(&self) -> impl Iterator<Item = (usize, usize)> {
        (0..self.width * self.height).filter(|&i| self.counts(i)).map(|i| (i, self.tile_of(i)))
    }

    fn check(&self, what: &str, len: usize) -> Result<()> {
        let expected = self.width * self.height;
        if len == expected {
            return Ok(());
        }
        Err(Error::invalid(format!(
            "{what} of {len} values, but {} x {} pixels need {expected}",
            self.width, self.height
        )))
    }

    /// Sums and counts of every tile.
    fn tile_sums(
        &self,
        value: impl Fn(usize) -> [f64; QUANTITIES],
    ) -> Vec<([f64; QUANTITIES], u64)> {
        let mut sums = vec![([0.0; QUANTITIES], 0); self.tiles()];
        for (pixel, tile) in self.pixels() {
            let (sum, count) = &mut sums[tile];
            for (s, v) in sum.iter_mut().zip(value(pixel)) {
                *s += v;
            }
            *count += 1;
        }
        sums
    }
}

/// What can be compared: estimates at each scale. `None` where the mask leaves no pixel.
trait Side {
    fn image(&self, quantity: usize) -> Estimate;
    fn tile(&self, tile: usize, quantity: usize) -> Option<Estimate>;
    fn pixel(&self, pixel: usize) -> Estimate;
}

/// Moments over independent restarts of a picture: of the image, of each tile, of each pixel.
///
/// A restart is a whole run with seeds of its own, judged at one frame. Restarts of the same
/// picture may be gathered apart and [merged](Self::merge).
#[derive(Clone, Debug)]
pub struct Restarts {
    layout: Layout,
    image: [Moments; QUANTITIES],
    tiles: Vec<[Moments; QUANTITIES]>,
    pixels: Vec<[Moments; QUANTITIES]>,
    not_finite: u64,
}

impl Restarts {
    /// No restarts yet of a picture of `width` × `height` pixels in square tiles of `tile` pixels
    /// (32 is usual, smaller at the borders). `mask` is true where a pixel counts.
    ///
    /// # Errors
    ///
    /// If a size is 0, the mask has another size, or no pixel counts.
    pub fn new(width: usize, height: usize, tile: usize, mask: Option<Vec<bool>>) -> Result<Self> {
        if width == 0 || height == 0 || tile == 0 {
            return Err(Error::invalid(format!(
                "a picture of {width} x {height} pixels in tiles of {tile}, but all must be positive"
            )));
        }
        let layout = Layout { width, height, tile, mask };
        if let Some(mask) = &layout.mask {
            layout.check("a mask", mask.len())?;
            if !mask.contains(&true) {
                return Err(Error::invalid("a mask without any pixel, but one must count"));
            }
        }
        Ok(Self {
            image: Default::default(),
            tiles: vec![Default::default(); layout.tiles()],
            pixels: vec![Default::default(); width * height],
            not_finite: 0,
            layout,
        })
    }

    /// Adds a restart: linear RGB, rows from the top.
    ///
    /// # Errors
    ///
    /// If the number of pixels is wrong.
    pub fn push(&mut self, picture: &[Vec3]) -> Result<()> {
        self.layout.check("a picture", picture.len())?;
        for (i, &rgb) in picture.iter().enumerate().filter(|&(i, _)| self.layout.counts(i)) {
            self.not_finite += u64::from(!rgb.is_finite());
            push_all(&mut self.pixels[i], quantities(rgb));
        }
        let mut total = [0.0; QUANTITIES];
        let mut pixels = 0;
        let sums = self.layout.tile_sums(|i| quantities(picture[i]));
        for (moments, (sum, count)) in self.tiles.iter_mut().zip(sums) {
            if count > 0 {
                push_all(moments, sum.map(|s| s / count as f64));
            }
            total.iter_mut().zip(sum).for_each(|(t, s)| *t += s);
            pixels += count;
        }
        push_all(&mut self.image, total.map(|t| t / pixels as f64));
        Ok(())
    }

    /// Adds all restarts of another set.
    ///
    /// # Errors
    ///
    /// If size, tiles or mask differ.
    pub fn merge(&mut self, other: &Self) -> Result<()> {
        self.same_layout(other)?;
        let pairs = self.tiles.iter_mut().zip(&other.tiles);
        let pairs = pairs.chain(self.pixels.iter_mut().zip(&other.pixels));
        for (a, b) in pairs.chain([(&mut self.image, &other.image)]) {
            a.iter_mut().zip(b).for_each(|(a, b)| a.merge(b));
        }
        self.not_finite += other.not_finite;
        Ok(())
    }

    /// All sums, for [`Self::restore`].
    #[cfg(feature = "experiment")]
    pub(crate) fn state(&self) -> Vec<f64> {
        let moments = std::iter::once(&self.image).chain(&self.tiles).chain(&self.pixels);
        let state = moments.flatten().flat_map(Moments::state);
        std::iter::once(self.not_finite as f64).chain(state).collect()
    }

    /// Takes the sums of restarts of the same layout; `None` where it has another.
    #[cfg(feature = "experiment")]
    pub(crate) fn restore(mut self, state: &[f64]) -> Option<Self> {
        let (not_finite, sums) = state.split_first()?;
        let (sums, rest) = sums.as_chunks::<4>();
        let moments = std::iter::once(&mut self.image);
        let moments = moments.chain(&mut self.tiles).chain(&mut self.pixels).flatten();
        let mut count = 0;
        for (moments, sums) in moments.zip(sums) {
            *moments = Moments::from_state(*sums);
            count += 1;
        }
        self.not_finite = *not_finite as u64;
        let places = QUANTITIES * (1 + self.tiles.len() + self.pixels.len());
        (rest.is_empty() && sums.len() == places && count == places).then_some(self)
    }

    /// Mean of every pixel over restarts.
    #[cfg(feature = "experiment")]
    pub(crate) fn mean_picture(&self) -> Vec<Vec3> {
        let mean = |moments: &[Moments; QUANTITIES]| {
            Vec3::from_array([0, 1, 2].map(|channel| moments[channel].mean() as f32))
        };
        self.pixels.iter().map(mean).collect()
    }

    /// Number of restarts R.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.image[LUMINANCE].count()
    }

    /// Pixels that counted and were not finite, over all restarts.
    #[must_use]
    pub fn not_finite(&self) -> u64 {
        self.not_finite
    }

    /// Moments of the image's mean luminance.
    #[must_use]
    pub fn luminance(&self) -> &Moments {
        &self.image[LUMINANCE]
    }

    /// Moments of a pixel's red, green and blue.
    #[must_use]
    pub fn pixel(&self, index: usize) -> &[Moments] {
        &self.pixels[index][..LUMINANCE]
    }

    /// Standard deviation of every pixel's luminance, of one restart; 0 outside the mask.
    #[must_use]
    pub fn luminance_deviation(&self) -> Vec<f64> {
        let deviation = |m: &[Moments; QUANTITIES]| m[LUMINANCE].variance().sqrt();
        self.pixels
            .iter()
            .map(|m| if m[LUMINANCE].count() == 0 { 0.0 } else { deviation(m) })
            .collect()
    }

    /// Compares with a reference.
    ///
    /// # Errors
    ///
    /// If the sizes differ.
    pub fn compare(&self, reference: &Truth, criteria: &Criteria) -> Result<PictureTest> {
        self.layout.check("a reference", reference.mean.len())?;
        if reference.width != self.layout.width {
            return Err(Error::invalid(format!(
                "a reference {} pixels wide, but the picture has {}",
                reference.width, self.layout.width
            )));
        }
        let side = TruthSide::new(reference, &self.layout);
        Ok(compare(self, &side, &self.layout, criteria, self.count(), self.not_finite))
    }

    /// Compares with restarts of another technique, `other` in the role of the reference. Equal
    /// counts serve heavy tails best.
    ///
    /// # Errors
    ///
    /// If size, tiles or mask differ.
    pub fn compare_restarts(&self, other: &Self, criteria: &Criteria) -> Result<PictureTest> {
        self.same_layout(other)?;
        let not_finite = self.not_finite + other.not_finite;
        let count = self.count().min(other.count());
        Ok(compare(self, other, &self.layout, criteria, count, not_finite))
    }

    /// Every mean that must agree with the reference: luminance, red, green and blue of the image,
    /// then of each tile. Parts of several ages may be judged together by
    /// [`agreement`](super::agreement).
    ///
    /// # Errors
    ///
    /// If the sizes differ.
    pub fn parts(&self, reference: &Truth, tolerance: &Tolerance) -> Result<Vec<Part>> {
        self.layout.check("a reference", reference.mean.len())?;
        let side = TruthSide::new(reference, &self.layout);
        let floor = tolerance.tile_floor * side.image(LUMINANCE).mean.abs();
        let mut parts = Vec::new();
        let mut add = |place, delta, floor: f64, of: &dyn Fn(usize) -> Option<[Estimate; 2]>| {
            let Some([_, luminance]) = of(LUMINANCE) else { return };
            for (quantity, at) in [
                (Quantity::Luminance, LUMINANCE),
                (Quantity::Red, 0),
                (Quantity::Green, 1),
                (Quantity::Blue, 2),
            ] {
                let Some([test, truth]) = of(at) else { continue };
                let scale = truth.mean.abs().max(luminance.mean.abs()).max(floor);
                parts.push(Part { place, quantity, test: welch(&test, &truth), scale, delta });
            }
        };
        add(Place::Image, tolerance.image, 0.0, &|q| Some([Side::image(self, q), side.image(q)]));
        for tile in 0..self.layout.tiles() {
            let place = Place::Tile {
                x: tile % self.layout.columns() * self.layout.tile,
                y: tile / self.layout.columns() * self.layout.tile,
            };
            add(place, tolerance.tile, floor, &|q| {
                Some([Side::tile(self, tile, q)?, side.tile(tile, q)?])
            });
        }
        Ok(parts)
    }

    fn same_layout(&self, other: &Self) -> Result<()> {
        if self.layout == other.layout {
            return Ok(());
        }
        Err(Error::invalid("two sets of restarts, but size, tiles and mask must be the same"))
    }
}

fn push_all(moments: &mut [Moments; QUANTITIES], values: [f64; QUANTITIES]) {
    moments.iter_mut().zip(values).for_each(|(m, v)| m.push(v));
}

impl Side for Restarts {
    fn image(&self, quantity: usize) -> Estimate {
        self.image[quantity].estimate()
    }

    fn tile(&self, tile: usize, quantity: usize) -> Option<Estimate> {
        let moments = &self.tiles[tile][quantity];
        (moments.count() > 0).then(|| moments.estimate())
    }

    fn pixel(&self, pixel: usize) -> Estimate {
        self.pixels[pixel][LUMINANCE].estimate()
    }
}

/// A stored picture to compare with: means, and how well they are known.
///
/// Its pixels count as independent (path tracing without reuse). The variance of a pixel's
/// luminance is taken as the largest that its channels allow, (Σ wᵢ σᵢ)²: channels of one path are
/// strongly correlated, and the stored variance does not tell how strongly.
#[derive(Clone, Debug)]
pub struct Truth {
    width: usize,
    mean: Vec<Vec3>,
    variance: Option<Vec<Vec3>>,
    dof: f64,
}

impl Truth {
    /// A reference without any error: an analytic answer.
    ///
    /// # Errors
    ///
    /// If `mean` is not `width` × `height` finite values.
    pub fn exact(width: usize, height: usize, mean: Vec<Vec3>) -> Result<Self> {
        Self::build(width, height, mean, None, f64::INFINITY)
    }

    /// A mean of `dof + 1` runs, with the variance of that mean per pixel and channel.
    ///
    /// # Errors
    ///
    /// If a length is not `width` × `height`, a value is not finite, a variance is negative, or
    /// `dof` is below 1.
    pub fn with_variance(
        width: usize,
        height: usize,
        mean: Vec<Vec3>,
        variance: Vec<Vec3>,
        dof: f64,
    ) -> Result<Self> {
        Self::build(width, height, mean, Some(variance), dof)
    }

    fn build(
        width: usize,
        height: usize,
        mean: Vec<Vec3>,
        variance: Option<Vec<Vec3>>,
        dof: f64,
    ) -> Result<Self> {
        let pixels = width * height;
        if pixels == 0
            || mean.len() != pixels
            || variance.as_ref().is_some_and(|v| v.len() != pixels)
        {
            return Err(Error::invalid(format!(
                "a reference of {} means and {} variances, but {width} x {height} pixels need {pixels}",
                mean.len(),
                variance.map_or(pixels, |v| v.len())
            )));
        }
        if let Some(bad) = mean.iter().position(|m| !m.is_finite()) {
            return Err(Error::invalid(format!(
                "{} at pixel {bad} of a reference, but it must be finite",
                mean[bad]
            )));
        }
        let valid = |v: &Vec3| v.is_finite() && v.min_element() >= 0.0;
        if let Some(bad) = variance.as_ref().and_then(|v| v.iter().position(|v| !valid(v))) {
            return Err(Error::invalid(format!(
                "a variance at pixel {bad} of a reference that is negative or not finite"
            )));
        }
        if dof.is_nan() || dof < 1.0 {
            return Err(Error::invalid(format!(
                "{dof} degrees of freedom, but at least 1 is needed"
            )));
        }
        Ok(Self { width, mean, variance, dof })
    }

    fn pixel_variance(&self, pixel: usize) -> [f64; QUANTITIES] {
        let Some(variance) = &self.variance else {
            return [0.0; QUANTITIES];
        };
        let [r, g, b] = variance[pixel].to_array().map(f64::from);
        let [wr, wg, wb] = LUMINANCE_WEIGHTS;
        let deviation = wr * r.sqrt() + wg * g.sqrt() + wb * b.sqrt();
        [r, g, b, deviation * deviation]
    }
}

/// A reference's estimates over the tiles of a picture.
struct TruthSide<'a> {
    reference: &'a Truth,
    image: [Estimate; QUANTITIES],
    tiles: Vec<Option<[Estimate; QUANTITIES]>>,
}

impl<'a> TruthSide<'a> {
    fn new(reference: &'a Truth, layout: &Layout) -> Self {
        let means = layout.tile_sums(|i| quantities(reference.mean[i]));
        let variances = layout.tile_sums(|i| reference.pixel_variance(i));
        let squares = layout.tile_sums(|i| reference.pixel_variance(i).map(|v| v * v));
        let mut all = [([0.0; QUANTITIES], 0); 3];
        let mut tiles = Vec::with_capacity(means.len());
        for ((mean, variance), square) in means.into_iter().zip(variances).zip(squares) {
            let sums = [mean, variance, square];
            for (total, part) in all.iter_mut().zip(sums) {
                total.0.iter_mut().zip(part.0).for_each(|(t, p)| *t += p);
                total.1 += part.1;
            }
            tiles.push((mean.1 > 0).then(|| Self::estimates(sums, reference.dof)));
        }
        Self { reference, image: Self::estimates(all, reference.dof), tiles }
    }

    /// Mean of independent pixels: variance Σv / n², degrees of freedom (Σv)² / Σ(v²/ν)
    /// (Satterthwaite 1946).
    fn estimates(
        [(mean, count), (variance, _), (square, _)]: [([f64; QUANTITIES], u64); 3],
        dof: f64,
    ) -> [Estimate; QUANTITIES] {
        let n = count as f64;
        core::array::from_fn(|q| {
            let dof =
                if square[q] > 0.0 { dof * variance[q] * variance[q] / square[q] } else { dof };
            Estimate::with_variance(mean[q] / n, variance[q] / (n * n), dof)
        })
    }
}

impl Side for TruthSide<'_> {
    fn image(&self, quantity: usize) -> Estimate {
        self.image[quantity]
    }

    fn tile(&self, tile: usize, quantity: usize) -> Option<Estimate> {
        self.tiles[tile].map(|t| t[quantity])
    }

    fn pixel(&self, pixel: usize) -> Estimate {
        let variance = self.reference.pixel_variance(pixel)[LUMINANCE];
        let mean = luminance(self.reference.mean[pixel]).into();
        Estimate::with_variance(mean, variance, self.reference.dof)
    }
}

/// When a picture passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Criteria {
    /// δ of the image scale as a share of the reference's mean luminance; for a channel, of the
    /// larger of that and the channel's mean, so that a dark channel need not be known more
    /// accurately than the picture.
    pub delta: f64,
    /// Probability to pass a picture whose bias is exactly δ.
    pub equivalence_alpha: f64,
    /// Probability to fail an unbiased picture at the image scale, per quantity.
    pub difference_alpha: f64,
    /// Probability to reject any tile of an unbiased picture (Holm over tiles and quantities).
    pub tile_alpha: f64,
    /// Whether red, green and blue must agree too, or luminance alone.
    pub channels: bool,
}

impl Default for Criteria {
    /// δ = 0.5 % at α = 0.01; fails at 10⁻⁴ (image) and 10⁻³ (tiles); all channels.
    fn default() -> Self {
        Self {
            delta: 0.005,
            equivalence_alpha: 0.01,
            difference_alpha: 1e-4,
            tile_alpha: 1e-3,
            channels: true,
        }
    }
}

/// The comparison of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TileTest {
    /// Left column of the tile.
    pub x: usize,
    /// Upper row of the tile.
    pub y: usize,
    /// Difference of mean luminance, divided by the reference's luminance of this tile (infinite if
    /// that is 0 and the difference is not).
    pub relative: f64,
    /// Two-sided p of the difference of luminance.
    pub p: f64,
    /// Whether Holm's procedure rejects it in any tested quantity.
    pub rejected: bool,
    /// Whether a rejected quantity is too skewed for Student's law.
    pub heavy_tailed: bool,
}

/// The result of comparing a picture with a reference.
#[derive(Clone, Debug)]
pub struct PictureTest {
    /// Fail if the image or any tile fails or any pixel is not finite; pass if the image scale
    /// passes and no tile is rejected. A tile that is rejected but heavy-tailed is no proof:
    /// inconclusive.
    pub verdict: Verdict,
    /// Image scale, mean luminance.
    pub luminance: Equivalence,
    /// Image scale, red, green and blue; in the verdict only if [`Criteria::channels`].
    pub channels: [Equivalence; 3],
    /// The reference's mean luminance: divide differences and intervals by it for relative figures.
    pub reference_luminance: f64,
    /// Tiles where the mask leaves a pixel, row by row.
    pub tiles: Vec<TileTest>,
    /// Rejected tiles.
    pub tiles_rejected: usize,
    /// Smallest p of the tiles' luminance, corrected by Šidák: local bias lowers it.
    pub tiles_min_p: f64,
    /// Whether the tiles' p-values are uniform: a wrong variance or a broad bias bends them.
    /// Assumes independent tiles.
    pub tiles_uniform: KolmogorovSmirnov,
    /// Two-sided p of every pixel's luminance; NaN outside the mask.
    pub p_map: Vec<f64>,
    /// Pixels that differ at a false discovery rate of 5 %. For looking only: single pixels are too
    /// skewed to trust.
    pub pixels_flagged: usize,
    /// Restarts (the smaller number of two).
    pub restarts: u64,
    /// Pixels not finite.
    pub not_finite: u64,
}

impl PictureTest {
    /// Bias of the mean luminance as a share of the reference's.
    #[must_use]
    pub fn relative(&self) -> f64 {
        self.luminance.test.difference / self.reference_luminance
    }

    /// The (1 − 2α) interval of [`relative`](Self::relative).
    #[must_use]
    pub fn relative_interval(&self) -> (f64, f64) {
        let (low, high) = self.luminance.interval;
        (low / self.reference_luminance, high / self.reference_luminance)
    }
}

fn compare(
    test: &impl Side,
    reference: &impl Side,
    layout: &Layout,
    criteria: &Criteria,
    restarts: u64,
    not_finite: u64,
) -> PictureTest {
    let reference_luminance = reference.image(LUMINANCE).mean;
    let image = |q: usize| {
        let of_reference = reference.image(q);
        let margin = Margin {
            delta: criteria.delta * reference_luminance.abs().max(of_reference.mean.abs()),
            equivalence_alpha: criteria.equivalence_alpha,
            difference_alpha: criteria.difference_alpha,
        };
        equivalence(&welch(&test.image(q), &of_reference), &margin)
    };
    let luminance = image(LUMINANCE);
    let channels = [image(0), image(1), image(2)];

    let tested = if criteria.channels { 0..QUANTITIES } else { LUMINANCE..QUANTITIES };
    let mut tiles = Vec::new();
    let mut tests = Vec::new();
    for tile in 0..layout.tiles() {
        let pair = |q| Some(welch(&test.tile(tile, q)?, &reference.tile(tile, q)?));
        let Some(of_luminance) = pair(LUMINANCE) else { continue };
        let mean = reference.tile(tile, LUMINANCE).map_or(0.0, |e| e.mean);
        let difference = of_luminance.difference;
        tiles.push(TileTest {
            x: tile % layout.columns() * layout.tile,
            y: tile / layout.columns() * layout.tile,
            relative: if difference == 0.0 { 0.0 } else { difference / mean.abs() },
            p: of_luminance.p,
            rejected: false,
            heavy_tailed: false,
        });
        tests.extend(tested.clone().filter_map(pair));
    }
    let p: Vec<f64> = tests.iter().map(|t| t.p).collect();
    let per_tile = tested.len();
    let mut verdict = luminance.verdict;
    for (i, _) in
        holm(&p, criteria.tile_alpha).iter().enumerate().filter(|(_, rejected)| **rejected)
    {
        let tile = &mut tiles[i / per_tile];
        let heavy_tailed = tests[i].heavy_tailed();
        tile.rejected = true;
        tile.heavy_tailed |= heavy_tailed;
        verdict = verdict.and(if heavy_tailed { Verdict::Inconclusive } else { Verdict::Fail });
    }
    if criteria.channels {
        verdict = channels.iter().fold(verdict, |v, c| v.and(c.verdict));
    }
    if not_finite > 0 {
        verdict = Verdict::Fail;
    }

    let mut p_map = vec![f64::NAN; layout.width * layout.height];
    let mut counted = Vec::new();
    for (pixel, _) in layout.pixels() {
        p_map[pixel] = welch(&test.pixel(pixel), &reference.pixel(pixel)).p;
        counted.push(p_map[pixel]);
    }
    let tile_p: Vec<f64> = tiles.iter().map(|t| t.p).collect();
    PictureTest {
        verdict,
        luminance,
        channels,
        reference_luminance,
        tiles_rejected: tiles.iter().filter(|t| t.rejected).count(),
        tiles_min_p: sidak_p(tile_p.iter().copied().fold(1.0, f64::min), tile_p.len()),
        tiles_uniform: ks_uniform(&tile_p),
        tiles,
        pixels_flagged: benjamini_hochberg(&counted, 0.05).iter().filter(|f| **f).count(),
        p_map,
        restarts,
        not_finite,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};

    const SIZE: usize = 32;
    const PIXELS: usize = SIZE * SIZE;

    /// A picture of exponential noise around a gradient, times `bias(pixel)`; noise shared by pairs
    /// of pixels, as reuse does.
    fn picture(key: u64, bias: impl Fn(usize) -> Vec3) -> Vec<Vec3> {
        let mut stream = Stream::from_key(key);
        let mut shared = 1.0;
        (0..PIXELS)
            .map(|i| {
                if i % 2 == 0 {
                    // Mean of 64 exponentials: 12.5 % noise.
                    shared = (0..64).map(|_| -(1.0 - stream.uniform()).ln()).sum::<f32>() / 64.0;
                }
                truth(i) * shared * bias(i)
            })
            .collect()
    }

    fn truth(i: usize) -> Vec3 {
        Vec3::new(1.0, 0.5, 0.25) * (0.5 + (i % SIZE) as f32 / SIZE as f32)
    }

    fn restarts(count: u64, base: u64, bias: impl Fn(usize) -> Vec3) -> Restarts {
        let mut all = Restarts::new(SIZE, SIZE, 8, None).unwrap();
        for run in 0..count {
            all.push(&picture(base * 1000 + run, &bias)).unwrap();
        }
        all
    }

    fn exact() -> Truth {
        Truth::exact(SIZE, SIZE, (0..PIXELS).map(truth).collect()).unwrap()
    }

    #[test]
    fn an_unbiased_picture_passes() {
        let result =
            restarts(40, 1, |_| Vec3::ONE).compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!(result.verdict, Verdict::Pass, "{:?}", result.luminance);
        assert_eq!((result.tiles.len(), result.tiles_rejected, result.restarts), (16, 0, 40));
        assert!(result.tiles_uniform.p > 1e-3 && result.tiles_min_p > 1e-3);
        let (low, high) = result.relative_interval();
        assert!(low < 0.0 && high > 0.0 && high < 0.005);
    }

    #[test]
    fn one_percent_everywhere_fails() {
        // Standard error of the image mean: 12.5 % / sqrt(512 pairs * 40 restarts) = 0.09 %.
        let dark = restarts(40, 2, |_| Vec3::splat(0.99));
        let result = dark.compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!(result.luminance.verdict, Verdict::Fail);
        assert!((result.relative() + 0.01).abs() < 0.004, "{}", result.relative());
        assert!(result.tiles_uniform.p < 1e-3);
    }

    #[test]
    fn a_local_bias_that_cancels_is_found_by_its_tiles() {
        // Tile (8, 8) 8 % up, tile (16, 8) 8 % down, scaled to cancel in the image mean.
        let tile = |i: usize| (i % SIZE / 8, i / SIZE / 8);
        let lift = |i| match tile(i) {
            (1, 1) => Vec3::splat(1.08),
            (2, 1) => Vec3::splat(0.942),
            _ => Vec3::ONE,
        };
        let result = restarts(40, 3, lift).compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!(result.luminance.verdict, Verdict::Pass);
        assert_eq!(result.verdict, Verdict::Fail);
        let found: Vec<_> =
            result.tiles.iter().filter(|t| t.rejected).map(|t| (t.x, t.y)).collect();
        assert_eq!(found, [(8, 8), (16, 8)]);
        assert!(result.tiles_min_p < 1e-3);
    }

    #[test]
    fn a_shift_of_hue_fails_only_where_channels_count() {
        // Red +3 %, blue down so that luminance stays.
        let hue = |_| Vec3::new(1.03, 1.0, 1.0 - 0.03 * 0.2126 / (0.0722 * 0.25));
        let tinted = restarts(40, 4, hue);
        let all = tinted.compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!((all.luminance.verdict, all.verdict), (Verdict::Pass, Verdict::Fail));
        let only = Criteria { channels: false, ..Criteria::default() };
        assert_eq!(tinted.compare(&exact(), &only).unwrap().verdict, Verdict::Pass);
    }

    #[test]
    fn few_restarts_are_inconclusive() {
        let result = restarts(2, 5, |_| Vec3::ONE).compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!(result.verdict, Verdict::Inconclusive);
        assert_eq!(
            restarts(1, 5, |_| Vec3::ONE).compare(&exact(), &Criteria::default()).unwrap().verdict,
            Verdict::Inconclusive
        );
    }

    #[test]
    fn masked_pixels_do_not_count_and_bad_ones_do() {
        let mask: Vec<bool> = (0..PIXELS).map(|i| i % SIZE >= 8).collect();
        let mut all = Restarts::new(SIZE, SIZE, 8, Some(mask)).unwrap();
        for run in 0..40 {
            let broken = |i: usize| if i % SIZE < 8 { Vec3::NAN } else { Vec3::ONE };
            all.push(&picture(6000 + run, broken)).unwrap();
        }
        let result = all.compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!((result.verdict, result.tiles.len(), result.not_finite), (Verdict::Pass, 12, 0));
        assert!(result.p_map[0].is_nan() && result.p_map[8].is_finite());
        let deviation = all.luminance_deviation();
        // 12.5 % of the luminance 0.589 (0.5 + 8 / 32) at pixel 8.
        assert!(deviation[0] == 0.0 && (deviation[8] / (0.125 * 0.589 * 0.75) - 1.0).abs() < 0.4);

        let mut spot = restarts(20, 7, |_| Vec3::ONE);
        spot.push(&picture(1, |i| if i == 77 { Vec3::NAN } else { Vec3::ONE })).unwrap();
        let result = spot.compare(&exact(), &Criteria::default()).unwrap();
        assert_eq!((result.verdict, result.not_finite), (Verdict::Fail, 1));
    }

    #[test]
    fn noise_of_the_reference_counts() {
        // A reference 1 % off whose own standard error of the image mean is 0.5 % proves nothing;
        // an exact one does.
        let mean: Vec<Vec3> = (0..PIXELS).map(|i| truth(i) * 1.01).collect();
        let noise = 0.005 * (PIXELS as f32).sqrt();
        let variance = mean.iter().map(|m| (*m * noise).powf(2.0)).collect();
        let noisy = Truth::with_variance(SIZE, SIZE, mean.clone(), variance, 15.0).unwrap();
        let runs = restarts(40, 8, |_| Vec3::ONE);
        let verdict = |r: &Truth| runs.compare(r, &Criteria::default()).unwrap().verdict;
        assert_eq!(verdict(&noisy), Verdict::Inconclusive);
        assert_eq!(verdict(&Truth::exact(SIZE, SIZE, mean).unwrap()), Verdict::Fail);
    }

    #[test]
    fn two_techniques_compare_and_merging_equals_pushing() {
        // Standard error of the difference 0.08 %: unbiased pairs pass with probability 0.9999.
        let (a, b) = (restarts(100, 9, |_| Vec3::ONE), restarts(100, 10, |_| Vec3::ONE));
        assert_eq!(a.compare_restarts(&b, &Criteria::default()).unwrap().verdict, Verdict::Pass);
        let dark = restarts(100, 11, |_| Vec3::splat(0.98));
        let failed = dark.compare_restarts(&b, &Criteria::default()).unwrap();
        assert_eq!(failed.verdict, Verdict::Fail);

        let mut merged = restarts(10, 9, |_| Vec3::ONE);
        let mut rest = Restarts::new(SIZE, SIZE, 8, None).unwrap();
        for run in 10..100 {
            rest.push(&picture(9000 + run, |_| Vec3::ONE)).unwrap();
        }
        merged.merge(&rest).unwrap();
        assert_eq!(merged.count(), 100);
        let (x, y) = (merged.luminance(), a.luminance());
        assert!((x.variance() / y.variance() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn parts_are_image_and_tiles_with_their_scales() {
        let tolerance = Tolerance::of(0.005);
        let mut all = Restarts::new(SIZE, SIZE, 16, None).unwrap();
        for run in 0..40 {
            // The upper left quarter is nearly black; blue is a quarter of red.
            all.push(&picture(20_000 + run, |i| Vec3::splat(dim(i)))).unwrap();
        }
        let dark = Truth::exact(SIZE, SIZE, (0..PIXELS).map(|i| truth(i) * dim(i)).collect());
        let parts = all.parts(&dark.unwrap(), &tolerance).unwrap();
        assert_eq!(parts.len(), 4 + 4 * 4);
        let image = parts[0].scale;
        assert_eq!((parts[0].place, parts[0].delta), (Place::Image, 0.005));
        assert_eq!(parts[3].quantity, Quantity::Blue);
        assert_eq!(parts[3].scale, image, "a dark channel counts as the luminance");
        assert_eq!((parts[4].place, parts[4].delta), (Place::Tile { x: 0, y: 0 }, 0.01));
        assert!((parts[4].scale / image - 0.1).abs() < 1e-12, "a dark tile counts as a tenth");
        assert!(parts[8].scale > image);
    }

    fn dim(i: usize) -> f32 {
        if i % SIZE < 16 && i / SIZE < 16 { 1e-3 } else { 1.0 }
    }

    #[test]
    fn tiles_must_be_shown_to_be_equivalent_and_planted_bias_fails() {
        // Standard errors of 500 restarts: image 12.5 % / sqrt(512 · 500) = 0.025 %, tile of 128
        // pairs 0.05 %.
        let verdict = |count: u64, base: u64, bias: fn(usize) -> Vec3| {
            let mut all = Restarts::new(SIZE, SIZE, 16, None).unwrap();
            for run in 0..count {
                all.push(&picture(base * 10_000 + run, bias)).unwrap();
            }
            let parts = all.parts(&exact(), &Tolerance::of(0.005)).unwrap();
            super::super::agreement(&parts, &Tolerance::of(0.005)).verdict
        };
        assert_eq!(verdict(500, 30, |_| Vec3::ONE), Verdict::Pass);
        // 10 restarts: the tiles' interval is 5 times as wide as their margin; nothing differs,
        // nothing is shown.
        assert_eq!(verdict(10, 31, |_| Vec3::ONE), Verdict::Inconclusive);
        // 2 % in one tile is 0.5 % or less of the image; opposite signs cancel there altogether.
        let tiles = |i: usize| match (i % SIZE / 16, i / SIZE / 16) {
            (0, 0) => Vec3::splat(1.02),
            (0, 1) => Vec3::splat(0.98),
            _ => Vec3::ONE,
        };
        assert_eq!(verdict(500, 32, tiles), Verdict::Fail);
        // A blue cast of 3 %, a quarter of the luminance's mean of blue: only the channel shows it.
        assert_eq!(verdict(500, 33, |_| Vec3::new(1.0, 1.0, 1.03)), Verdict::Fail);
        assert_eq!(verdict(500, 34, |_| Vec3::splat(0.99)), Verdict::Fail);
    }

    #[test]
    fn false_alarms_stay_at_their_nominal_rate() {
        // 200 unbiased pictures of 10 restarts, tile_alpha = difference_alpha = 0.05 on luminance:
        // Holm keeps the tiles' family at 5 %, the image test adds at most 5 %: 20 +- 4.2, upper
        // bound 4.5 sigma.
        let criteria = Criteria {
            difference_alpha: 0.05,
            tile_alpha: 0.05,
            channels: false,
            ..Criteria::default()
        };
        let failed = (0..200)
            .filter(|k| {
                let result = restarts(10, 100 + k, |_| Vec3::ONE).compare(&exact(), &criteria);
                result.unwrap().verdict == Verdict::Fail
            })
            .count();
        assert!((1..=39).contains(&failed), "{failed} of 200");
    }

    #[test]
    fn wrong_sizes_are_refused() {
        assert!(Restarts::new(4, 4, 0, None).unwrap_err().is_invalid());
        assert!(Restarts::new(4, 4, 2, Some(vec![true; 3])).unwrap_err().is_invalid());
        assert!(Restarts::new(4, 4, 2, Some(vec![false; 16])).unwrap_err().is_invalid());
        let mut r = Restarts::new(4, 4, 2, None).unwrap();
        let message = r.push(&[Vec3::ONE; 3]).unwrap_err().to_string();
        assert_eq!(message, "a picture of 3 values, but 4 x 4 pixels need 16");
        let narrow = Truth::exact(2, 8, vec![Vec3::ONE; 16]).unwrap();
        assert!(r.compare(&narrow, &Criteria::default()).unwrap_err().is_invalid());
        assert!(Truth::exact(1, 1, vec![Vec3::NAN]).is_err());
    }

    /// Tiles of a picture that is not square are counted in rows from the upper left; none is split
    /// or mixed with another.
    #[test]
    fn tiles_stand_in_rows() {
        let layout = Layout { width: 5, height: 9, tile: 2, mask: None };
        assert_eq!((layout.columns(), layout.tiles()), (3, 15));
        for pixel in 0..45 {
            let (x, y) = (pixel % 5, pixel / 5);
            assert_eq!(layout.tile_of(pixel), y / 2 * 3 + x / 2, "({x}, {y})");
        }
    }
}
