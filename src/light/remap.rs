//! The same light in two frames: lights may appear, vanish and change their order.

use std::collections::HashMap;

use super::{Lights, NO_LIGHT};

/// Where each light of one frame stands in another frame's table, by host key.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LightRemap {
    to_current: Vec<u32>,
    to_previous: Vec<u32>,
}

impl LightRemap {
    /// The map between two tables; `None` if every light has the same place in both.
    #[must_use]
    pub fn new(previous: &Lights, current: &Lights) -> Option<Self> {
        let same = std::ptr::eq(previous, current)
            || (previous.len() == current.len()
                && (0..current.len() as u32)
                    .all(|light| previous.key(light) == current.key(light)));
        if same {
            return None;
        }
        let places = |lights: &Lights| -> HashMap<[u64; 2], u32> {
            (0..lights.len() as u32).map(|light| (lights.key(light), light)).collect()
        };
        let map = |from: &Lights, to: &HashMap<[u64; 2], u32>| -> Vec<u32> {
            let place = |light| to.get(&from.key(light)).copied().unwrap_or(NO_LIGHT);
            (0..from.len() as u32).map(place).collect()
        };
        Some(Self {
            to_current: map(previous, &places(current)),
            to_previous: map(current, &places(previous)),
        })
    }

    /// Place by light, of the previous frame's table in the current one and back; [`NO_LIGHT`]
    /// where there is none.
    #[cfg(feature = "gpu")]
    pub(crate) fn tables(&self) -> (&[u32], &[u32]) {
        (&self.to_current, &self.to_previous)
    }

    /// The place now of the previous frame's `light`.
    #[inline]
    #[must_use]
    pub fn to_current(&self, light: u32) -> Option<u32> {
        self.to_current.get(light as usize).copied().filter(|light| *light != NO_LIGHT)
    }

    /// The place in the previous frame of `light`.
    #[inline]
    #[must_use]
    pub fn to_previous(&self, light: u32) -> Option<u32> {
        self.to_previous.get(light as usize).copied().filter(|light| *light != NO_LIGHT)
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::scene::{Light, LightKind, Scene, Transform};

    fn lights(keys: &[u64]) -> Lights {
        let mut scene = Scene::new("keys");
        for &key in keys {
            let kind = LightKind::Point { intensity: Vec3::ONE };
            scene.lights.push(Light { to_world: Transform::IDENTITY, kind, key });
        }
        Lights::build(&scene, [Vec3::ZERO, Vec3::ONE])
    }

    #[test]
    fn lights_are_found_by_their_keys() {
        let (before, after) = (lights(&[7, 3, 9]), lights(&[9, 5, 7]));
        let remap = LightRemap::new(&before, &after).unwrap();
        assert_eq!([0, 1, 2].map(|i| remap.to_current(i)), [Some(2), None, Some(0)]);
        assert_eq!([0, 1, 2].map(|i| remap.to_previous(i)), [Some(2), None, Some(0)]);
        assert_eq!(LightRemap::new(&before, &before), None);
        // A map that is not its own inverse, with one that is gone and one that is new.
        let (before, after) = (lights(&[1, 2, 3, 4]), lights(&[2, 3, 1, 5]));
        let remap = LightRemap::new(&before, &after).unwrap();
        let places = [Some(2), Some(0), Some(1), None];
        assert_eq!([0, 1, 2, 3].map(|i| remap.to_current(i)), places);
        let places = [Some(1), Some(2), Some(0), None];
        assert_eq!([0, 1, 2, 3].map(|i| remap.to_previous(i)), places);
        assert_eq!(LightRemap::new(&before, &lights(&[])).unwrap().to_current(0), None);
    }
}
