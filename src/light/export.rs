//! The table of emitters as words for a graphics processor: `gpu/wgsl/light.wgsl` reads what is
//! written here.

use glam::{Mat3, Vec3};

use super::{Environment, Lights, Surface, area};
use crate::accel::export::Words;
use crate::scene::{Color, EnvironmentMapping, Image, Scalar, SpotFalloff};

/// Words of a light.
const LIGHT: usize = 32;
const TWO_SIDED: u32 = 1;
const HOLLOW: u32 = 2;
const COVERAGE: u32 = 4;
const TEXTURED: u32 = 8;
const UNMET: u32 = 16;

/// Where the parts of a table begin, in words.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct LightWords {
    pub(crate) first_of_shape: u32,
    pub(crate) lights: u32,
    pub(crate) light_count: u32,
    pub(crate) alias_slots: u32,
    pub(crate) alias_count: u32,
    pub(crate) probabilities: u32,
    pub(crate) environments: u32,
    pub(crate) environment_count: u32,
}

/// How what lies elsewhere is named.
pub(crate) trait Names {
    /// Four words of a colour.
    fn color(&self, color: Color) -> [u32; 4];
    /// Two words of a number.
    fn scalar(&self, scalar: Scalar) -> [u32; 2];
    /// The header of an image.
    fn image(&self, image: &std::sync::Arc<Image>) -> u32;
}

fn put(words: &mut [u32], at: usize, v: Vec3) {
    words[at..at + 3].copy_from_slice(&v.to_array().map(f32::to_bits));
}

fn matrix(m: Mat3) -> [u32; 9] {
    m.to_cols_array().map(f32::to_bits)
}

impl Lights {
    /// Appends the table to `words`.
    pub(crate) fn export(&self, names: &impl Names, words: &mut Words) -> LightWords {
        let mut at = LightWords::default();
        let mut places = Vec::new();
        for (light, environment) in &self.environments {
            places.push(export_environment(environment, *light, names, words));
        }
        at.environment_count = places.len() as u32;
        at.environments = words.put(places.iter().copied());
        at.first_of_shape = words.put(self.first_of_shape.iter().copied());
        at.lights = words.at();
        at.light_count = self.lights.len() as u32;
        for light in &self.lights {
            let mut record = [0; LIGHT];
            record[2..6].copy_from_slice(&names.color(light.radiance));
            record[6] = light.scale.to_bits();
            let flag = |holds: bool, bit: u32| if holds { bit } else { 0 };
            let mut flags = flag(light.two_sided, TWO_SIDED)
                | flag(light.is_hollow(), HOLLOW)
                | flag(!light.met, UNMET);
            if let Some(coverage) = light.coverage {
                flags |= COVERAGE;
                record[7..9].copy_from_slice(&names.scalar(coverage));
            }
            let textured = matches!(light.radiance, Color::Texture(_))
                || matches!(light.coverage, Some(Scalar::Texture(..)));
            flags |= flag(textured, TEXTURED);
            record[1] = flags;
            // A light without extent has the measure of counting.
            record[9] = 1.0_f32.to_bits();
            match light.surface {
                Surface::Triangle { corner, edge1, edge2, normal, .. } => {
                    put(&mut record, 10, corner);
                    put(&mut record, 13, edge1);
                    put(&mut record, 16, edge2);
                    put(&mut record, 19, normal);
                    record[9] = area(light.surface).to_bits();
                }
                Surface::Sphere { center, radius, outward } => {
                    record[0] = 1;
                    put(&mut record, 10, center);
                    record[22] = radius.to_bits();
                    record[23] = outward.to_bits();
                    record[9] = area(light.surface).to_bits();
                }
                Surface::Disk { center, frame, radius } => {
                    record[0] = 2;
                    put(&mut record, 10, center);
                    put(&mut record, 13, frame.normal);
                    put(&mut record, 16, frame.tangent);
                    put(&mut record, 19, frame.bitangent);
                    record[22] = radius.to_bits();
                    record[9] = area(light.surface).to_bits();
                }
                Surface::Point { position } => {
                    record[0] = 3;
                    put(&mut record, 10, position);
                }
                Surface::Spot { position, axis, cos_inner, cos_outer, falloff } => {
                    record[0] = 4;
                    put(&mut record, 10, position);
                    put(&mut record, 13, axis);
                    record[22] = cos_inner.to_bits();
                    record[23] = cos_outer.to_bits();
                    record[24] = u32::from(falloff == SpotFalloff::Quadratic);
                }
                Surface::Distant { direction } => {
                    record[0] = 5;
                    put(&mut record, 10, direction);
                }
                Surface::Environment { index } => {
                    record[0] = 6;
                    record[24] = places[index as usize];
                }
            }
            for (corner, uv) in light.uvs.iter().enumerate() {
                record[25 + 2 * corner] = uv.x.to_bits();
                record[26 + 2 * corner] = uv.y.to_bits();
            }
            words.put(record);
        }
        let slots = self.table.slot_words();
        at.alias_count = slots.len() as u32 / 3;
        at.alias_slots = words.put(slots);
        let probability = |i| self.table.probability(i).to_bits();
        at.probabilities = words.put((0..self.table.len() as u32).map(probability));
        at
    }
}

fn export_environment(
    environment: &Environment,
    light: u32,
    names: &impl Names,
    words: &mut Words,
) -> u32 {
    let (to_light, to_world) = environment.maps();
    let mut record = [0; 29];
    put(&mut record, 0, environment.radiance);
    record[3] = u32::MAX;
    record[5..14].copy_from_slice(&matrix(to_light));
    record[14..23].copy_from_slice(&matrix(to_world));
    record[28] = light;
    if let Some((image, mapping)) = environment.image() {
        record[3] = names.image(image);
        record[4] = u32::from(mapping == EnvironmentMapping::EqualAreaOctahedral);
        for (place, table) in environment.tables().into_iter().enumerate() {
            record[23 + place] = words.put(table.iter().map(|v| v.to_bits()));
        }
        record[26] = image.width;
        record[27] = image.height;
    }
    words.put(record)
}
