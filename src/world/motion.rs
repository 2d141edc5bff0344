//! What leads from one frame's world to the next one's.

use std::collections::HashMap;

use glam::Vec3;

use super::World;
use crate::accel::Hit;
use crate::light::LightRemap;
use crate::scene::{CameraRays, Projection};

/// How the previous frame was seen, and where its lights and instances are now.
#[derive(Clone, Debug)]
pub struct Motion {
    /// Primary rays of the previous frame.
    pub camera: CameraRays,
    /// Pixel positions in the previous frame.
    pub projection: Projection,
    /// Lights by host key; `None`: all at the same place in the table.
    pub lights: Option<LightRemap>,
    /// Instances by host key; `None`: all at the same place in the list.
    pub instances: Option<InstanceRemap>,
}

/// Where instances stand in two frames' lists, by host key, both ways.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceRemap {
    to_previous: Vec<u32>,
    to_current: Vec<u32>,
}

impl InstanceRemap {
    /// Between two lists of keys; `None` where they are the same.
    #[must_use]
    pub fn new(previous: &[u64], current: &[u64]) -> Option<Self> {
        (previous != current).then(|| Self {
            to_previous: places(current, previous),
            to_current: places(previous, current),
        })
    }

    /// For each instance of the current frame its place in the previous one, or `u32::MAX`.
    #[must_use]
    pub fn previous_places(&self) -> &[u32] {
        &self.to_previous
    }
}

/// For each of `keys` its place in `list`, or `u32::MAX`.
fn places(keys: &[u64], list: &[u64]) -> Vec<u32> {
    let known: HashMap<u64, u32> =
        list.iter().enumerate().map(|(place, key)| (*key, place as u32)).collect();
    keys.iter().map(|key| known.get(key).copied().unwrap_or(u32::MAX)).collect()
}

impl Motion {
    /// Between the worlds of two frames of `size` pixels.
    #[must_use]
    pub fn new(previous: &World, current: &World, size: [u32; 2]) -> Self {
        let keys = |world: &World| -> Vec<u64> {
            world.scene.instances.iter().map(|instance| instance.key).collect()
        };
        Self {
            camera: previous.scene.camera.rays(size),
            projection: previous.scene.camera.projection(size),
            lights: LightRemap::new(&previous.lights, &current.lights),
            instances: InstanceRemap::new(&keys(previous), &keys(current)),
        }
    }

    /// Where an instance of the current frame stands in the previous frame's list.
    #[inline]
    #[must_use]
    pub fn previous_instance(&self, instance: u32) -> Option<u32> {
        match &self.instances {
            None => Some(instance),
            Some(remap) => place(&remap.to_previous, instance),
        }
    }

    /// Where an instance of the previous frame stands in the current frame's list.
    #[inline]
    #[must_use]
    pub fn current_instance(&self, instance: u32) -> Option<u32> {
        match &self.instances {
            None => Some(instance),
            Some(remap) => place(&remap.to_current, instance),
        }
    }

    /// Where the surface point of a hit of `current` was in the previous frame.
    #[inline]
    #[must_use]
    pub fn position(&self, previous: &World, current: &World, hit: &Hit) -> Option<Vec3> {
        let place = self.previous_instance(hit.instance)?;
        let instance = previous.scene.instances.get(place as usize)?;
        Some(current.accel.point_under(hit, instance.to_world.fixed()))
    }
}

#[inline]
fn place(places: &[u32], instance: u32) -> Option<u32> {
    places.get(instance as usize).copied().filter(|place| *place != u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn instances_are_found_by_key_in_both_directions() {
        assert_eq!(InstanceRemap::new(&[3, 1], &[3, 1]), None);
        // A map that is not its own inverse.
        let (previous, current) = ([10, 11, 12, 15], [12, 13, 15, 10, 14]);
        let remap = InstanceRemap::new(&previous, &current).unwrap();
        assert_eq!(remap.previous_places(), [2, u32::MAX, 3, 0, u32::MAX]);
        let camera = crate::scene::Scene::new("empty").camera;
        let (rays, projection) = (camera.rays([1, 1]), camera.projection([1, 1]));
        let motion = Motion { camera: rays, projection, lights: None, instances: Some(remap) };
        for (at, key) in (0..).zip(previous) {
            let there = motion.current_instance(at);
            assert_eq!(there.map(|place| current[place as usize]), (key != 11).then_some(key));
            if let Some(place) = there {
                assert_eq!(motion.previous_instance(place), Some(at));
            }
        }
        assert_eq!([1, 4, 5].map(|place| motion.previous_instance(place)), [None; 3]);
        assert_eq!(
            [0, 2, 3].map(|place| motion.current_instance(place)),
            [Some(3), Some(0), Some(2)]
        );
    }
}
