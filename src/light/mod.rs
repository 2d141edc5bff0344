//! The emitters of a scene as one table: which one to ask, where on it, and how likely that was.
//!
//! | here | meaning |
//! |---|---|
//! | light | a triangle, sphere or disk that emits, or a point, spot, distant or environment light |
//! | [`LightPoint`] | a light and two numbers on it: what a sample keeps, so that it moves with its light |
//! | [`Incident`] | what such a point sends to a receiver |
//!
//! Measures: area on triangles, spheres and disks; solid angle on environments; counting on point,
//! spot and distant lights. [`Lights::sample_towards`] may draw by other densities than uniform
//! area (cones for spheres); what it reports is always the density per unit solid angle at the
//! receiver, or 1 for counting.

mod alias;
mod environment;
#[cfg(feature = "gpu")]
pub(crate) mod export;
mod point;
mod remap;

use std::f32::consts::PI;

use glam::{Vec2, Vec3};

pub use alias::AliasTable;
pub use environment::Environment;
pub(crate) use point::EmitterPoints;
pub use point::{Arrival, EmitterPoint};
pub use remap::LightRemap;

use crate::accel::{MAX_COORDINATE, triangle_orientation};
use crate::math::{Frame, luminance, warp};
use crate::scene::{Color, Emission, Geometry, LightKind, Scalar, Scene, SpotFalloff, Transform};

/// No light.
pub const NO_LIGHT: u32 = u32::MAX;

/// A light and a place on it, in coordinates of the light itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LightPoint {
    /// Index in the table.
    pub light: u32,
    /// In [0, 1)²; 0 for point, spot and distant lights.
    pub uv: Vec2,
}

/// What a light point sends to a receiver.
#[derive(Clone, Copy, Debug)]
pub struct Incident {
    /// Unit direction from the receiver to the light.
    pub direction: Vec3,
    /// Where a shadow ray ends, moved off the light's surface; `None`: at infinity.
    pub end: Option<Vec3>,
    /// Radiance towards the receiver; for point, spot and distant lights irradiance on a surface
    /// that faces them.
    pub radiance: Vec3,
    /// Density per unit solid angle at the receiver, given the light; 1 for lights without extent.
    pub pdf: f32,
    /// Whether no other technique can find this light.
    pub delta: bool,
}

/// The shape of a [`Light`], in world space.
#[derive(Clone, Copy, Debug)]
enum Surface {
    Triangle {
        corner: Vec3,
        edge1: Vec3,
        edge2: Vec3,
        normal: Vec3,
        area: f32,
    },
    /// `outward` is −1 where the emitting side is the inside.
    Sphere {
        center: Vec3,
        radius: f32,
        outward: f32,
    },
    Disk {
        center: Vec3,
        frame: Frame,
        radius: f32,
    },
    Point {
        position: Vec3,
    },
    Spot {
        position: Vec3,
        axis: Vec3,
        cos_inner: f32,
        cos_outer: f32,
        falloff: SpotFalloff,
    },
    Distant {
        direction: Vec3,
    },
    Environment {
        index: u32,
    },
}

#[derive(Clone, Copy, Debug)]
struct Light {
    surface: Surface,
    radiance: Color,
    scale: f32,
    two_sided: bool,
    /// Of its surface, where it is not 1: what a ray that meets the surface passes through, its
    /// points do not send.
    coverage: Option<Scalar>,
    /// Whether rays meet its surface: not where coverage is the number 0; it emits all the same.
    met: bool,
    /// Texture coordinates of a triangle's corners, where its emission or coverage is textured.
    uvs: [Vec2; 3],
    /// Instance or light key, shape, element: the same for the same light in every frame.
    key: [u64; 2],
}

/// How many lights of each kind a table holds, black ones left out.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LightCounts {
    /// Emitting triangles.
    pub triangles: u32,
    /// Emitting spheres and disks.
    pub quadrics: u32,
    /// What no ray meets: point, spot and distant lights, emitting surfaces without coverage.
    pub delta: u32,
    /// Environments.
    pub environments: u32,
    /// Emitters that emit nothing: never drawn, never asked.
    pub black: u32,
}

impl LightCounts {
    /// Counts the emitters that a scale of 0 hides at the first time of a scene, which may move:
    /// later frames may show them.
    pub fn add_hidden(&mut self, scene: &Scene) {
        let hidden = |to_world: &Transform| to_world.shown_at(scene.time[0]).is_none();
        for instance in scene.instances.iter().filter(|i| hidden(&i.to_world)) {
            for shape in &scene.objects[instance.object.index()].shapes {
                match &shape.geometry {
                    _ if shape.emission.is_none() => {}
                    Geometry::Mesh(mesh) if shape.is_unmet() => {
                        self.delta += mesh.triangles.len() as u32;
                    }
                    _ if shape.is_unmet() => self.delta += 1,
                    Geometry::Mesh(mesh) => self.triangles += mesh.triangles.len() as u32,
                    _ => self.quadrics += 1,
                }
            }
        }
        for light in scene.lights.iter().filter(|l| hidden(&l.to_world)) {
            match light.kind {
                LightKind::Environment { .. } => self.environments += 1,
                _ => self.delta += 1,
            }
        }
    }
}

/// All lights of a scene at one time.
#[derive(Clone, Debug, Default)]
pub struct Lights {
    lights: Vec<Light>,
    table: AliasTable,
    /// First light of each running shape number, or [`NO_LIGHT`].
    first_of_shape: Vec<u32>,
    environments: Vec<(u32, Environment)>,
    counts: LightCounts,
}

impl Lights {
    /// The lights of a scene with fixed transforms. `bounds` is the world's bounding box, from
    /// which light at infinity gets its power.
    #[must_use]
    pub fn build(scene: &Scene, bounds: [Vec3; 2]) -> Self {
        let mut lights = Self::default();
        let mut powers = Vec::new();
        for instance in &scene.instances {
            let to_world = instance.to_world.fixed();
            for (number, shape) in scene.objects[instance.object.index()].shapes.iter().enumerate()
            {
                let Some(emission) = shape.emission else {
                    lights.first_of_shape.push(NO_LIGHT);
                    continue;
                };
                let met = !shape.is_unmet();
                let first = if met { lights.lights.len() as u32 } else { NO_LIGHT };
                lights.first_of_shape.push(first);
                let sides = if emission.two_sided { 2.0 } else { 1.0 };
                let flip = if shape.reverse_orientation { -1.0 } else { 1.0 };
                let whole = |alpha: &Scalar| matches!(alpha, Scalar::Constant(a) if *a >= 1.0);
                let coverage = shape.alpha.filter(|alpha| met && !whole(alpha));
                let mut push = |surface, uvs, element: u64, mean: f32| {
                    lights.lights.push(Light {
                        surface,
                        radiance: emission.radiance,
                        scale: emission.scale,
                        two_sided: emission.two_sided,
                        coverage,
                        met,
                        uvs,
                        key: [instance.key, (number as u64) << 32 | element],
                    });
                    // The accelerator drops what lies beyond. `extent` is at most five times the
                    // farthest coordinate: what lies between is met by BSDF samples alone. NaN
                    // compares false.
                    let within = extent(surface).cmple(Vec3::splat(MAX_COORDINATE)).all();
                    let area = if within { f64::from(area(surface)) } else { 0.0 };
                    powers.push(sides * std::f64::consts::PI * area * f64::from(mean));
                };
                match &shape.geometry {
                    Geometry::Mesh(mesh) => {
                        let mirrored = to_world.matrix3.determinant() < 0.0;
                        for (element, corners) in mesh.triangles.iter().enumerate() {
                            let [a, b, c] = corners
                                .map(|i| to_world.transform_point3(mesh.positions[i as usize]));
                            let uvs = triangle_uvs(mesh, *corners);
                            let side =
                                triangle_orientation(mesh, element, shape.reverse_orientation)
                                    * if mirrored { -1.0 } else { 1.0 };
                            let (edge1, edge2) = (b - a, c - a);
                            // The square of an area leaves f32 for edges beyond 4 · 10⁹ or below
                            // 10⁻¹¹.
                            let cross = edge1.as_dvec3().cross(edge2.as_dvec3());
                            let surface = Surface::Triangle {
                                corner: a,
                                edge1,
                                edge2,
                                normal: cross.normalize_or_zero().as_vec3() * side,
                                area: (0.5 * cross.length()) as f32,
                            };
                            let mean = mean_emission(scene, &emission, uvs);
                            push(surface, uvs, element as u64, mean);
                        }
                    }
                    Geometry::Sphere { center, radius } => {
                        let radius = radius * to_world.matrix3.determinant().abs().cbrt();
                        let center = to_world.transform_point3(*center);
                        let mean = mean_emission(scene, &emission, DEFAULT_UVS);
                        let surface = Surface::Sphere { center, radius, outward: flip };
                        push(surface, DEFAULT_UVS, 0, mean);
                    }
                    Geometry::Disk { center, normal, radius } => {
                        let radius = radius * to_world.matrix3.determinant().abs().cbrt();
                        let inverse = to_world.matrix3.inverse();
                        let normal = (inverse.transpose() * *normal).normalize() * flip;
                        let mean = mean_emission(scene, &emission, DEFAULT_UVS);
                        let frame = Frame::from_normal(normal);
                        let surface = Surface::Disk {
                            center: to_world.transform_point3(*center),
                            frame,
                            radius,
                        };
                        push(surface, DEFAULT_UVS, 0, mean);
                    }
                }
            }
        }
        let world_radius = f64::from(0.5 * (bounds[1] - bounds[0]).length());
        let world_disk = std::f64::consts::PI * world_radius * world_radius;
        for light in &scene.lights {
            let to_world = light.to_world.fixed();
            let position = Vec3::from(to_world.translation);
            let axis = to_world.transform_vector3(Vec3::Z).normalize();
            let (surface, radiance, power) = match light.kind {
                LightKind::Point { intensity } => {
                    let power = 4.0 * std::f64::consts::PI * f64::from(luminance(intensity));
                    (Surface::Point { position }, intensity, power)
                }
                LightKind::Spot { intensity, cos_inner, cos_outer, falloff } => {
                    let power = std::f64::consts::PI
                        * f64::from(luminance(intensity))
                        * f64::from(2.0 - cos_inner - cos_outer);
                    (
                        Surface::Spot { position, axis, cos_inner, cos_outer, falloff },
                        intensity,
                        power,
                    )
                }
                LightKind::Distant { irradiance } => (
                    Surface::Distant { direction: -axis },
                    irradiance,
                    world_disk * f64::from(luminance(irradiance)),
                ),
                LightKind::Environment { radiance, image } => {
                    let image =
                        image.map(|(id, mapping)| (scene.images[id.index()].clone(), mapping));
                    let environment = Environment::new(radiance, to_world.matrix3.into(), image);
                    let power = world_disk * environment.total_luminance();
                    let index = lights.environments.len() as u32;
                    lights.environments.push((lights.lights.len() as u32, environment));
                    (Surface::Environment { index }, radiance, power)
                }
            };
            lights.lights.push(Light {
                surface,
                radiance: Color::Constant(radiance),
                scale: 1.0,
                two_sided: true,
                coverage: None,
                met: false,
                uvs: DEFAULT_UVS,
                key: [light.key, u64::MAX],
            });
            powers.push(power);
        }
        for (light, power) in lights.lights.iter().zip(&powers) {
            let count = match light.surface {
                _ if *power <= 0.0 => &mut lights.counts.black,
                Surface::Environment { .. } => &mut lights.counts.environments,
                _ if !light.met => &mut lights.counts.delta,
                Surface::Triangle { .. } => &mut lights.counts.triangles,
                Surface::Sphere { .. } | Surface::Disk { .. } => &mut lights.counts.quadrics,
                _ => &mut lights.counts.delta,
            };
            *count += 1;
        }
        lights.table = AliasTable::new(&powers);
        lights
    }

    /// How many lights of each kind there are.
    #[must_use]
    pub fn counts(&self) -> LightCounts {
        self.counts
    }

    /// Number of lights, black ones included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.lights.len()
    }

    /// Whether no light can be drawn.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.table.is_empty()
    }

    /// A light by power, for 64 random bits; the table must not be empty.
    #[inline]
    #[must_use]
    pub fn choose(&self, index_word: u32, fraction_word: u32) -> u32 {
        self.table.sample(index_word, fraction_word)
    }

    /// Probability of [`Lights::choose`] to take `light`.
    #[inline]
    #[must_use]
    pub fn choice_probability(&self, light: u32) -> f32 {
        if self.table.is_empty() { 0.0 } else { self.table.probability(light) }
    }

    /// The middle of a light's surface, or where a light without one stands; `None` at infinity.
    #[inline]
    #[must_use]
    pub fn center(&self, light: u32) -> Option<Vec3> {
        match self.lights.get(light as usize)?.surface {
            Surface::Triangle { corner, edge1, edge2, .. } => Some(corner + (edge1 + edge2) / 3.0),
            Surface::Sphere { center, .. } | Surface::Disk { center, .. } => Some(center),
            Surface::Point { position } | Surface::Spot { position, .. } => Some(position),
            Surface::Distant { .. } | Surface::Environment { .. } => None,
        }
    }

    /// A light's identity over frames.
    #[must_use]
    pub fn key(&self, light: u32) -> [u64; 2] {
        self.lights[light as usize].key
    }

    /// First light of every emitting shape that rays meet, in order.
    pub(crate) fn firsts(&self) -> Vec<u32> {
        self.first_of_shape.iter().copied().filter(|first| *first != NO_LIGHT).collect()
    }

    /// The light that a surface element is, or [`NO_LIGHT`]. `shape` is the running number,
    /// `element` the triangle in its mesh.
    #[inline]
    #[must_use]
    pub fn of_surface(&self, shape: u32, element: u32) -> u32 {
        match self.first_of_shape[shape as usize] {
            NO_LIGHT => NO_LIGHT,
            first => first + element,
        }
    }

    /// The environments, each with its index in the table.
    #[inline]
    pub fn environments(&self) -> impl Iterator<Item = (u32, &Environment)> {
        self.environments.iter().map(|(light, environment)| (*light, environment))
    }

    /// Emitted radiance of a surface light at texture coordinates `uv`, seen from where `cos_theta`
    /// is the cosine to its geometric normal.
    #[inline]
    #[must_use]
    pub fn emitted(&self, scene: &Scene, light: u32, uv: Vec2, cos_theta: f32) -> Vec3 {
        let light = &self.lights[light as usize];
        if cos_theta > 0.0 || (light.two_sided && cos_theta < 0.0) {
            scene.color(light.radiance, uv) * light.scale
        } else {
            Vec3::ZERO
        }
    }

    /// Density per unit solid angle at `from` with which [`Lights::sample_towards`] would draw the
    /// surface point `at` of `light`, the choice of the light left out. `cos_theta` is the cosine
    /// at the light's geometric normal.
    #[inline]
    #[must_use]
    pub fn pdf_towards(&self, light: u32, from: Vec3, at: Vec3, cos_theta: f32) -> f32 {
        self.density_from(light, from, (at - from).length_squared(), cos_theta)
    }

    #[inline]
    fn density_from(&self, light: u32, from: Vec3, squared: f32, cos_theta: f32) -> f32 {
        let record = &self.lights[light as usize];
        match record.cap(from) {
            Some((center, radius)) => {
                warp::uniform_cone_pdf(one_minus_cos_cone(from, center, radius))
            }
            None => per_solid_angle(area(record.surface), squared, cos_theta),
        }
    }
}

const DEFAULT_UVS: [Vec2; 3] = [Vec2::ZERO, Vec2::X, Vec2::ONE];

fn triangle_uvs(mesh: &crate::scene::Mesh, corners: [u32; 3]) -> [Vec2; 3] {
    if mesh.uvs.is_empty() { DEFAULT_UVS } else { corners.map(|i| mesh.uvs[i as usize]) }
}

fn mix_uvs(uvs: [Vec2; 3], b: Vec3) -> Vec2 {
    uvs[0] * b.x + uvs[1] * b.y + uvs[2] * b.z
}

/// Mean luminance of the emission over a triangle of texture space. Half of it is the texture's
/// mean over the unit square, so that bright texels between the probes never leave a light without
/// probability.
fn mean_emission(scene: &Scene, emission: &Emission, uvs: [Vec2; 3]) -> f32 {
    let at = |uv| luminance(scene.color(emission.radiance, uv));
    let mean = match emission.radiance {
        Color::Constant(radiance) => luminance(radiance),
        Color::Texture(_) => {
            const N: usize = 8;
            let cell = |i: usize| (i as f32 + 0.5) / N as f32;
            let (mut inside, mut whole) = (0.0, 0.0);
            for i in 0..N * N {
                let u = Vec2::new(cell(i % N), cell(i / N));
                inside += at(mix_uvs(uvs, warp::sample_uniform_triangle(u)));
                whole += at(u);
            }
            // Smallest normal number: a texture that is black at every probe still gets asked.
            0.5 * (inside + whole) / (N * N) as f32 + f32::MIN_POSITIVE
        }
    };
    mean * emission.scale
}

fn constant(light: &Light) -> Vec3 {
    match light.radiance {
        Color::Constant(value) => value,
        Color::Texture(_) => Vec3::ZERO,
    }
}

fn area(surface: Surface) -> f32 {
    match surface {
        Surface::Triangle { area, .. } => area,
        Surface::Sphere { radius, .. } => 4.0 * PI * radius * radius,
        Surface::Disk { radius, .. } => PI * radius * radius,
        _ => 0.0,
    }
}

fn extent(surface: Surface) -> Vec3 {
    match surface {
        Surface::Triangle { corner, edge1, edge2, .. } => corner.abs() + edge1.abs() + edge2.abs(),
        Surface::Sphere { center, radius, .. } | Surface::Disk { center, radius, .. } => {
            center.abs() + radius
        }
        _ => Vec3::ZERO,
    }
}

/// Uniform area as a density per unit solid angle: d² / (A |cos θ|).
#[inline]
fn per_solid_angle(area: f32, squared_distance: f32, cos_theta: f32) -> f32 {
    squared_distance / (area * cos_theta.abs())
}

/// Whether a receiver samples the sphere by the cone it fills. From the surface and inside, area
/// sampling is exact and finite.
#[inline]
fn outside_sphere(from: Vec3, center: Vec3, radius: f32) -> bool {
    (from - center).length_squared() > radius * radius * (1.0 + 16.0 * f32::EPSILON)
}

/// 1 − cos of the half angle of the cone that a sphere fills: sin² / (1 + cos), stable for small
/// ones.
#[inline]
fn one_minus_cos_cone(from: Vec3, center: Vec3, radius: f32) -> f32 {
    let sin2 = radius * radius / (center - from).length_squared();
    sin2 / (1.0 + (1.0 - sin2).max(0.0).sqrt())
}

/// A point of the visible cap, uniform in the solid angle it fills at `from`.
#[inline]
fn sample_sphere_cone(from: Vec3, center: Vec3, radius: f32, u: Vec2) -> Option<Vec3> {
    let to_center = center - from;
    let squared = to_center.length_squared();
    let frame = Frame::from_normal(to_center / squared.sqrt());
    let local = warp::sample_uniform_cone(one_minus_cos_cone(from, center, radius), u);
    // The angle at the sphere's centre between the receiver and the point: α = asin(sin θ / sin
    // θ_max) − θ.
    let sin2_theta = local.x * local.x + local.y * local.y;
    let sin_max = radius / squared.sqrt();
    let ratio2 = sin2_theta / (sin_max * sin_max);
    let cos_theta = local.z;
    let cos_alpha = sin2_theta / sin_max + cos_theta * (1.0 - ratio2).max(0.0).sqrt();
    let sin_alpha = (1.0 - cos_alpha * cos_alpha).max(0.0).sqrt();
    let azimuth = Vec2::new(local.x, local.y).normalize_or(Vec2::X);
    let normal =
        frame.to_world(Vec3::new(azimuth.x * sin_alpha, azimuth.y * sin_alpha, -cos_alpha));
    normal.is_finite().then(|| center + normal * radius)
}

impl Light {
    /// Centre and radius of a sphere that `from` sees from outside, so that points are drawn on the
    /// cap that faces it, in the cone it fills. `None` where points are drawn by area: on other
    /// shapes, from inside, where the far cap's inside shines through holes in the near one, and
    /// where no ray meets either.
    #[inline]
    fn cap(&self, from: Vec3) -> Option<(Vec3, f32)> {
        match self.surface {
            Surface::Sphere { center, radius, .. }
                if self.met
                    && outside_sphere(from, center, radius)
                    && (self.coverage.is_none() || !self.is_hollow()) =>
            {
                Some((center, radius))
            }
            _ => None,
        }
    }

    /// Whether it is a sphere whose inside shines.
    #[inline]
    fn is_hollow(&self) -> bool {
        matches!(self.surface, Surface::Sphere { outward, .. } if self.two_sided || outward < 0.0)
    }

    /// Texture coordinates of a point of a sphere light; anything where its emission is the same
    /// everywhere.
    #[inline]
    fn uv_on_sphere(&self, normal: Vec3) -> Vec2 {
        match (self.radiance, self.coverage) {
            (Color::Constant(_), None | Some(Scalar::Constant(_))) => Vec2::ZERO,
            _ => uv_on_sphere(normal),
        }
    }

    /// What a point of the surface sends, on average over coverage's coin.
    #[inline]
    fn sent(&self, scene: &Scene, uv: Vec2) -> Vec3 {
        let radiance = scene.color(self.radiance, uv) * self.scale;
        match self.coverage {
            None => radiance,
            // A texture may leave [0, 1]; a ray's coin takes what is above for 1 and what is below
            // for 0.
            Some(alpha) => radiance * scene.scalar(alpha, uv).clamp(0.0, 1.0),
        }
    }
}

/// Texture coordinates of a point on a sphere: azimuth from +x and polar angle from −z, as the
/// accelerator reports them.
fn uv_on_sphere(normal: Vec3) -> Vec2 {
    let phi = normal.y.atan2(normal.x);
    let u = if phi < 0.0 { phi / (2.0 * PI) + 1.0 } else { phi / (2.0 * PI) };
    Vec2::new(u, 1.0 - normal.x.hypot(normal.y).atan2(normal.z) / PI)
}

fn spot_falloff(cos_theta: f32, cos_inner: f32, cos_outer: f32, falloff: SpotFalloff) -> f32 {
    if cos_theta <= cos_outer {
        0.0
    } else if cos_theta >= cos_inner {
        1.0
    } else {
        let s = (cos_theta - cos_outer) / (cos_inner - cos_outer);
        match falloff {
            SpotFalloff::Smoothstep => s * s * (3.0 - 2.0 * s),
            SpotFalloff::Quadratic => s * s,
        }
    }
}
