//! Light from infinity: radiance by direction, and directions drawn by radiance.
//!
//! Radiance is bilinear between texel centres; the density is constant over each texel's solid
//! angle and proportional to the exact mean luminance of the bilinear radiance there, so it is
//! positive wherever radiance is.

use std::f32::consts::{PI, TAU};
use std::sync::Arc;

use glam::{Mat3, Vec2, Vec3, Vec4Swizzles};

use crate::math::luminance;
use crate::scene::{EnvironmentMapping, Image};

/// An environment light, prepared for sampling.
#[derive(Clone, Debug)]
pub struct Environment {
    /// Factor on the image, or the radiance.
    pub radiance: Vec3,
    to_light: Mat3,
    to_world: Mat3,
    image: Option<Texels>,
}

#[derive(Clone, Debug)]
struct Texels {
    image: Arc<Image>,
    mapping: EnvironmentMapping,
    distribution: Grid,
}

/// A density over the unit square, constant on `width` × `height` cells; column by inverse CDF
/// inside a row by inverse CDF.
#[derive(Clone, Debug)]
struct Grid {
    width: usize,
    /// CDF of the rows: `height + 1` values from 0 to 1.
    rows: Vec<f32>,
    /// CDF of the columns of each row: `height · (width + 1)`.
    columns: Vec<f32>,
    /// Probability of each cell.
    cells: Vec<f32>,
}

impl Grid {
    fn new(weights: &[f64], width: usize, height: usize) -> Self {
        let total: f64 = weights.iter().sum();
        let cdf = |values: &mut dyn Iterator<Item = f64>, total: f64, out: &mut Vec<f32>| {
            let mut sum = 0.0;
            out.push(0.0);
            for value in values {
                sum += value;
                out.push(if total > 0.0 { (sum / total) as f32 } else { 0.0 });
            }
        };
        let mut rows = Vec::with_capacity(height + 1);
        let mut columns = Vec::with_capacity(height * (width + 1));
        let sums: Vec<f64> = weights.chunks(width).map(|row| row.iter().sum()).collect();
        cdf(&mut sums.iter().copied(), total, &mut rows);
        for (row, sum) in weights.chunks(width).zip(&sums) {
            cdf(&mut row.iter().copied(), *sum, &mut columns);
        }
        let mut grid = Self { width, rows, columns, cells: Vec::new() };
        // The probability of what the rounded tables really draw, so that density and draws agree
        // to the last bit.
        grid.cells = (0..width * height)
            .map(|i| {
                let (y, row) = (i / width, grid.row(i / width));
                (grid.rows[y + 1] - grid.rows[y]) * (row[i % width + 1] - row[i % width])
            })
            .collect();
        grid
    }

    fn row(&self, y: usize) -> &[f32] {
        &self.columns[y * (self.width + 1)..(y + 1) * (self.width + 1)]
    }

    /// The cell and the position inside it.
    fn sample(&self, u: Vec2) -> (usize, usize, Vec2) {
        let (y, v) = invert_cdf(&self.rows, u.y);
        let (x, u) = invert_cdf(self.row(y), u.x);
        (x, y, Vec2::new(u, v))
    }

    /// Inverse of [`Grid::sample`].
    fn invert(&self, x: usize, y: usize, inside: Vec2) -> Vec2 {
        let row = self.row(y);
        Vec2::new(
            row[x] + inside.x * (row[x + 1] - row[x]),
            self.rows[y] + inside.y * (self.rows[y + 1] - self.rows[y]),
        )
    }
}

/// The interval of a CDF that holds `u` in [0, 1), and the position inside it in [0, 1). Empty
/// intervals are never chosen.
fn invert_cdf(cdf: &[f32], u: f32) -> (usize, f32) {
    let u = u * cdf[cdf.len() - 1];
    let index = cdf.partition_point(|c| *c <= u).clamp(1, cdf.len() - 1) - 1;
    let width = cdf[index + 1] - cdf[index];
    (
        index,
        if width > 0.0 { ((u - cdf[index]) / width).min(1.0 - f32::EPSILON / 2.0) } else { 0.5 },
    )
}

impl Environment {
    /// An environment with light space rotated by the linear part of `to_world` (its inverse must
    /// exist).
    #[must_use]
    pub fn new(
        radiance: Vec3,
        to_world: Mat3,
        image: Option<(Arc<Image>, EnvironmentMapping)>,
    ) -> Self {
        let image = image.map(|(image, mapping)| {
            let (width, height) = (image.width as usize, image.height as usize);
            let mut weights = Vec::with_capacity(width * height);
            for y in 0..height {
                let solid_angle = match mapping {
                    EnvironmentMapping::LatitudeLongitude => {
                        let edge =
                            |y: usize| (std::f64::consts::PI * y as f64 / height as f64).cos();
                        edge(y) - edge(y + 1)
                    }
                    EnvironmentMapping::EqualAreaOctahedral => 1.0,
                };
                weights.extend((0..width).map(|x| {
                    // The mean over a texel of the bilinear interpolant: [1/8, 6/8, 1/8] of the
                    // texels along each axis.
                    let mut sum = 0.0;
                    for (dy, wy) in [(-1, 0.125), (0, 0.75), (1, 0.125)] {
                        for (dx, wx) in [(-1, 0.125), (0, 0.75), (1, 0.125)] {
                            let texel = fetch(&image, mapping, x as i64 + dx, y as i64 + dy);
                            sum += wx * wy * f64::from(luminance(texel * radiance));
                        }
                    }
                    sum * solid_angle
                }));
            }
            let distribution = Grid::new(&weights, width, height);
            Texels { image, mapping, distribution }
        });
        let to_light = to_world.inverse();
        // The inverse of what other directions are turned by, not `to_world` itself: samples and
        // densities then agree to the last bit.
        Self { radiance, to_light, to_world: to_light.inverse(), image }
    }

    /// Radiance from unit `direction`.
    #[must_use]
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        let Some(texels) = &self.image else { return self.radiance };
        let (width, height) = (texels.image.width as f32, texels.image.height as f32);
        let uv = to_square(texels.mapping, (self.to_light * direction).normalize());
        let position = uv * Vec2::new(width, height) - 0.5;
        let low = position.floor();
        let f = position - low;
        let (x, y) = (low.x as i64, low.y as i64);
        let at = |dx, dy| fetch(&texels.image, texels.mapping, x + dx, y + dy);
        let top = at(0, 0).lerp(at(1, 0), f.x);
        let bottom = at(0, 1).lerp(at(1, 1), f.x);
        self.radiance * top.lerp(bottom, f.y)
    }

    /// ∫ luminance dω over the sphere.
    #[must_use]
    pub fn total_luminance(&self) -> f64 {
        match &self.image {
            None => 4.0 * std::f64::consts::PI * f64::from(luminance(self.radiance)),
            Some(texels) => {
                let (width, height) = (texels.image.width as usize, texels.image.height as usize);
                let mut sum = 0.0;
                for y in 0..height {
                    let solid_angle = f64::from(solid_angle(texels, y));
                    let row: f64 = (0..width)
                        .map(|x| {
                            f64::from(luminance(
                                texels.image.pixel(x as u32, y as u32).xyz() * self.radiance,
                            ))
                        })
                        .sum();
                    sum += row * solid_angle;
                }
                sum
            }
        }
    }

    /// A unit direction for two uniform numbers; its density is [`Environment::pdf`].
    #[must_use]
    pub fn sample(&self, u: Vec2) -> Vec3 {
        let local = match &self.image {
            None => crate::math::warp::sample_uniform_sphere(u),
            Some(texels) => {
                let (x, y, inside) = texels.distribution.sample(u);
                from_cell(texels, x, y, inside)
            }
        };
        (self.to_world * local).normalize()
    }

    /// Density of [`Environment::sample`] per unit solid angle.
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        match &self.image {
            None => 1.0 / (4.0 * PI),
            Some(texels) => {
                let (x, y, _) = to_cell(texels, (self.to_light * direction).normalize());
                texels.distribution.cells[y * texels.distribution.width + x]
                    / solid_angle(texels, y)
            }
        }
    }

    /// From world to light space, and back.
    #[cfg(feature = "gpu")]
    pub(crate) fn maps(&self) -> (Mat3, Mat3) {
        (self.to_light, self.to_world)
    }

    /// The image, and how it covers the sphere.
    #[cfg(feature = "gpu")]
    pub(crate) fn image(&self) -> Option<(&Arc<Image>, EnvironmentMapping)> {
        self.image.as_ref().map(|texels| (&texels.image, texels.mapping))
    }

    /// The image's tables: cumulative rows, cumulative columns row by row, probabilities of cells.
    /// Empty without one.
    #[cfg(feature = "gpu")]
    pub(crate) fn tables(&self) -> [&[f32]; 3] {
        self.image.as_ref().map_or([&[]; 3], |texels| {
            let Grid { rows, columns, cells, .. } = &texels.distribution;
            [rows, columns, cells]
        })
    }

    /// The numbers that [`Environment::sample`] turns into `direction`; `None` where its density
    /// is 0.
    #[must_use]
    pub fn invert(&self, direction: Vec3) -> Option<Vec2> {
        let local = (self.to_light * direction).normalize();
        match &self.image {
            None => Some(crate::math::warp::invert_uniform_sphere(local)),
            Some(texels) => {
                let (x, y, inside) = to_cell(texels, local);
                let grid = &texels.distribution;
                (grid.cells[y * grid.width + x] > 0.0).then(|| grid.invert(x, y, inside))
            }
        }
    }
}

/// Solid angle of a texel in row `y`: `2π / width · (cos θ − cos θ')` between its edges, with the
/// difference as `2 sin((θ + θ') / 2) sin((θ' − θ) / 2)`: near a pole the cosines agree in most
/// digits.
fn solid_angle(texels: &Texels, y: usize) -> f32 {
    let (width, height) = (texels.image.width as f32, texels.image.height as f32);
    match texels.mapping {
        EnvironmentMapping::LatitudeLongitude => {
            let half = 0.5 * PI / height;
            let from_pole = y.min(texels.image.height as usize - 1 - y);
            2.0 * TAU / width * ((half * (2 * from_pole + 1) as f32).sin() * half.sin())
        }
        EnvironmentMapping::EqualAreaOctahedral => 2.0 * TAU / (width * height),
    }
}

/// sin²(θ/2) and cos²(θ/2) at a row's two edges: both are kept, so that neither pole loses digits.
struct Band {
    north_sin2: f32,
    south_sin2: f32,
    north_cos2: f32,
    south_cos2: f32,
}

impl Band {
    fn new(y: usize, height: f32) -> Self {
        let half = 0.5 * PI / height;
        let (sn, cn) = (half * y as f32).sin_cos();
        let (ss, cs) = (half * (y + 1) as f32).sin_cos();
        Self { north_sin2: sn * sn, south_sin2: ss * ss, north_cos2: cn * cn, south_cos2: cs * cs }
    }
}

/// The direction at a position inside a texel; uniform positions give uniform solid angle.
fn from_cell(texels: &Texels, x: usize, y: usize, inside: Vec2) -> Vec3 {
    let size = Vec2::new(texels.image.width as f32, texels.image.height as f32);
    match texels.mapping {
        EnvironmentMapping::LatitudeLongitude => {
            let band = Band::new(y, size.y);
            let sin2 = band.north_sin2 + inside.y * (band.south_sin2 - band.north_sin2);
            let cos2 = band.north_cos2 + inside.y * (band.south_cos2 - band.north_cos2);
            let (sin_phi, cos_phi) = (TAU * (x as f32 + inside.x) / size.x).sin_cos();
            let sin_theta = 2.0 * (sin2 * cos2).sqrt();
            Vec3::new(sin_theta * cos_phi, sin_theta * sin_phi, cos2 - sin2)
        }
        EnvironmentMapping::EqualAreaOctahedral => {
            octahedral_to_sphere((Vec2::new(x as f32, y as f32) + inside) / size)
        }
    }
}

/// The texel of a unit direction in light space and the position inside it: inverse of
/// [`from_cell`].
fn to_cell(texels: &Texels, direction: Vec3) -> (usize, usize, Vec2) {
    let (width, height) = (texels.image.width as usize, texels.image.height as usize);
    let position = to_square(texels.mapping, direction) * Vec2::new(width as f32, height as f32);
    let x = (position.x as usize).min(width - 1);
    let y = (position.y as usize).min(height - 1);
    let inside = match texels.mapping {
        EnvironmentMapping::LatitudeLongitude => {
            let band = Band::new(y, height as f32);
            let across = direction.x * direction.x + direction.y * direction.y;
            let t = if direction.z >= 0.0 {
                (0.5 * across / (1.0 + direction.z) - band.north_sin2)
                    / (band.south_sin2 - band.north_sin2)
            } else {
                (0.5 * across / (1.0 - direction.z) - band.north_cos2)
                    / (band.south_cos2 - band.north_cos2)
            };
            Vec2::new(position.x - x as f32, t.clamp(0.0, 1.0))
        }
        EnvironmentMapping::EqualAreaOctahedral => position - Vec2::new(x as f32, y as f32),
    };
    (x, y, inside)
}

/// Position in the image, in [0, 1]², of a unit direction in light space.
fn to_square(mapping: EnvironmentMapping, d: Vec3) -> Vec2 {
    match mapping {
        EnvironmentMapping::LatitudeLongitude => {
            let phi = d.y.atan2(d.x);
            let u = if phi < 0.0 { phi / TAU + 1.0 } else { phi / TAU };
            Vec2::new(u, d.x.hypot(d.y).atan2(d.z) / PI)
        }
        EnvironmentMapping::EqualAreaOctahedral => sphere_to_octahedral(d),
    }
}

/// Equal-area octahedral map of the sphere to [0, 1]² (Clarberg 2008, *Fast Equal-Area Mapping of
/// the (Hemi)Sphere using SIMD*).
fn sphere_to_octahedral(d: Vec3) -> Vec2 {
    let (x, y) = (d.x.abs(), d.y.abs());
    let across = x * x + y * y;
    // √(1 − |z|) without cancellation near the poles.
    let r = (across / (1.0 + d.z.abs())).sqrt();
    let phi = if across == 0.0 { 0.0 } else { y.atan2(x) * (2.0 / PI) };
    let v = phi * r;
    let (u, v) = if d.z < 0.0 { (1.0 - v, 1.0 - (r - v)) } else { (r - v, v) };
    0.5 * (Vec2::new(u.copysign(d.x), v.copysign(d.y)) + 1.0)
}

/// Inverse of [`sphere_to_octahedral`].
fn octahedral_to_sphere(p: Vec2) -> Vec3 {
    let (u, v) = (2.0 * p.x - 1.0, 2.0 * p.y - 1.0);
    let (au, av) = (u.abs(), v.abs());
    let signed = 1.0 - (au + av);
    let r = 1.0 - signed.abs();
    let phi = if r == 0.0 { 0.0 } else { ((av - au) / r + 1.0) * (PI / 4.0) };
    let z = (1.0 - r * r).copysign(signed);
    let (sin_phi, cos_phi) = phi.sin_cos();
    let across = r * (2.0 - r * r).max(0.0).sqrt();
    Vec3::new((cos_phi * across).copysign(u), (sin_phi * across).copysign(v), z)
}

/// A texel; indices beyond the border wrap as the mapping does.
fn fetch(image: &Image, mapping: EnvironmentMapping, x: i64, y: i64) -> Vec3 {
    let (width, height) = (i64::from(image.width), i64::from(image.height));
    let (x, y) = match mapping {
        EnvironmentMapping::LatitudeLongitude => (x.rem_euclid(width), y.clamp(0, height - 1)),
        EnvironmentMapping::EqualAreaOctahedral => {
            let (mut x, mut y) = (x, y);
            if x < 0 || x >= width {
                x = if x < 0 { -x - 1 } else { 2 * width - 1 - x };
                y = height - 1 - y;
            }
            if y < 0 || y >= height {
                y = if y < 0 { -y - 1 } else { 2 * height - 1 - y };
                x = width - 1 - x;
            }
            (x.clamp(0, width - 1), y.clamp(0, height - 1))
        }
    };
    image.pixel(x as u32, y as u32).xyz()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rng::{RandomSource, Stream};
    use crate::scene::ImageData;
    use glam::Quat;

    fn directions(n: usize) -> Vec<Vec3> {
        let mut stream = Stream::from_key(3);
        let mut all: Vec<Vec3> = (0..n)
            .map(|_| {
                crate::math::warp::sample_uniform_sphere(Vec2::new(
                    stream.uniform(),
                    stream.uniform(),
                ))
            })
            .collect();
        all.extend([Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z]);
        all
    }

    fn bumpy(width: u32, height: u32, mapping: EnvironmentMapping) -> Environment {
        let mut stream = Stream::from_key(11);
        let texels = (0..width * height)
            .map(|_| {
                let v = stream.uniform();
                let bright = if v > 0.9 { 30.0 * v } else { v };
                [bright, 0.5 * bright, 0.25, 1.0]
            })
            .collect();
        let image = Image { width, height, data: ImageData::Float(texels) };
        Environment::new(
            Vec3::ONE,
            Mat3::from_quat(Quat::from_rotation_x(0.7)),
            Some((Arc::new(image), mapping)),
        )
    }

    const BOTH: [EnvironmentMapping; 2] =
        [EnvironmentMapping::LatitudeLongitude, EnvironmentMapping::EqualAreaOctahedral];

    #[test]
    fn octahedral_map_inverts() {
        for d in directions(10_000) {
            let p = sphere_to_octahedral(d);
            assert!((0.0..=1.0).contains(&p.x) && (0.0..=1.0).contains(&p.y));
            assert!((octahedral_to_sphere(p) - d).length() < 2e-6, "{d} {p}");
        }
    }

    #[test]
    fn density_integrates_to_one_and_sampling_inverts() {
        for mapping in BOTH {
            let environment = bumpy(16, 16, mapping);
            // Uniform directions: E[4π pdf] = 1. The standard error is printed by the failing
            // assertion's bound: 4 of them.
            let mut sum = 0.0;
            let mut squares = 0.0;
            let all = directions(200_000);
            for d in &all {
                let value = f64::from(environment.pdf(*d)) * 4.0 * std::f64::consts::PI;
                sum += value;
                squares += value * value;
            }
            let n = all.len() as f64;
            let mean = sum / n;
            let error = ((squares / n - mean * mean) / n).sqrt();
            assert!(
                (mean - 1.0).abs() < 4.0 * error && error < 0.01,
                "{mapping:?}: {mean} ± {error}"
            );

            let mut stream = Stream::from_key(5);
            for _ in 0..20_000 {
                let u = Vec2::new(stream.uniform(), stream.uniform());
                let d = environment.sample(u);
                assert!((d.length() - 1.0).abs() < 1e-5);
                let back = environment.invert(d).unwrap();
                // Near a texel's edge rounding may name the neighbour; the numbers are still close.
                assert!((back - u).length() < 2e-3, "{mapping:?} {u} {back}");
            }
        }
    }

    /// Importance sampling estimates ∫L dω; without the Jacobian of the map the lat-long answer
    /// would be far off.
    #[test]
    fn estimate_of_total_radiance_matches_quadrature() {
        for mapping in BOTH {
            let environment = bumpy(32, 32, mapping);
            let uniform: f64 = directions(400_000)
                .iter()
                .map(|d| f64::from(luminance(environment.radiance(*d))))
                .sum::<f64>()
                / 400_006.0
                * 4.0
                * std::f64::consts::PI;
            let mut stream = Stream::from_key(9);
            let n = 200_000;
            let sampled: f64 = (0..n)
                .map(|_| {
                    let d = environment.sample(Vec2::new(stream.uniform(), stream.uniform()));
                    f64::from(luminance(environment.radiance(d)) / environment.pdf(d))
                })
                .sum::<f64>()
                / f64::from(n);
            assert!((sampled / uniform - 1.0).abs() < 0.01, "{mapping:?}: {sampled} {uniform}");
            let total = environment.total_luminance();
            assert!((sampled / total - 1.0).abs() < 0.03, "{mapping:?}: {sampled} {total}");
        }
    }

    /// Between the last column and the first there is no edge.
    #[test]
    fn a_sky_is_whole_at_its_seam() {
        let texels = (0..4 * 2).map(|i| [[1.0, 2.0, 3.0, 5.0][i % 4], 0.0, 0.0, 1.0]).collect();
        let image = Image { width: 4, height: 2, data: ImageData::Float(texels) };
        let mapping = EnvironmentMapping::LatitudeLongitude;
        let sky = Environment::new(Vec3::ONE, Mat3::IDENTITY, Some((Arc::new(image), mapping)));
        let at = |turn: f32| {
            let (y, x) = (TAU * turn).sin_cos();
            sky.radiance(Vec3::new(x, y, 0.0)).x
        };
        for (turn, wanted) in [(0.0, 3.0), (1e-6, 3.0), (-1e-6, 3.0), (0.0625, 2.0), (0.9375, 4.0)]
        {
            assert!((at(turn) - wanted).abs() < 1e-3, "{turn}: {}", at(turn));
        }
    }

    /// A row at a pole of a large picture: the cosines of its edges agree in most digits.
    #[test]
    fn texels_at_the_poles_have_their_solid_angles() {
        let (width, height) = (2, 16_384);
        let image = Image { width, height, data: ImageData::Float(vec![[1.0; 4]; 2 * 16_384]) };
        let mapping = EnvironmentMapping::LatitudeLongitude;
        let sky = Environment::new(Vec3::ONE, Mat3::IDENTITY, Some((Arc::new(image), mapping)));
        let texels = sky.image.as_ref().unwrap();
        let half = 0.5 * std::f64::consts::PI / f64::from(height);
        for y in [0, 1, 2, 5, 100, 8_191, 8_192, 16_379, 16_382, 16_383] {
            // cos a − cos b = 2 sin((a + b) / 2) sin((b − a) / 2), without cancellation.
            let from_pole = y.min(height - 1 - y);
            let middle = half * f64::from(2 * from_pole + 1);
            let wanted = 2.0 * std::f64::consts::PI * middle.sin() * half.sin();
            let found = f64::from(solid_angle(texels, y as usize));
            assert!((found / wanted - 1.0).abs() < 1e-5, "row {y}: {found} {wanted}");
        }
    }

    #[test]
    fn one_hot_texel_is_found_and_black_has_no_density() {
        for mapping in BOTH {
            let mut texels = vec![[0.0, 0.0, 0.0, 1.0]; 64 * 64];
            texels[20 * 64 + 33] = [1e6, 1e6, 1e6, 1.0];
            let image = Image { width: 64, height: 64, data: ImageData::Float(texels) };
            let environment =
                Environment::new(Vec3::ONE, Mat3::IDENTITY, Some((Arc::new(image), mapping)));
            let mut stream = Stream::from_key(1);
            for _ in 0..10_000 {
                let d = environment.sample(Vec2::new(stream.uniform(), stream.uniform()));
                assert!(environment.pdf(d) > 0.0);
            }
            for d in directions(20_000) {
                assert!(
                    environment.radiance(d) == Vec3::ZERO || environment.pdf(d) > 0.0,
                    "{mapping:?} {d}"
                );
            }
        }
    }
}
