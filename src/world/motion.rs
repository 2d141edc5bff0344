//! What leads from one frame's world to the next one's.

use std::collections::HashMap;
use std::sync::Arc;

use glam::Vec3;

use super::World;
use crate::accel::Hit;
use crate::light::LightRemap;
use crate::scene::{CameraRays, Instance, Object, Projection, Scene};

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

/// Where instances stand in two frames' lists, by host key, both ways. An instance whose object is
/// another in the other frame is not there: a primitive's number means another primitive.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceRemap {
    to_previous: Vec<u32>,
    to_current: Vec<u32>,
}

impl InstanceRemap {
    /// Between the instances of two scenes; `None` where all are at the same place in both lists.
    #[must_use]
    pub fn new(previous: &Scene, current: &Scene) -> Option<Self> {
        let same = |(was, is): (&Instance, &Instance)| {
            was.key == is.key && Arc::ptr_eq(object_of(previous, was), object_of(current, is))
        };
        let kept = previous.instances.len() == current.instances.len()
            && previous.instances.iter().zip(&current.instances).all(same);
        (!kept).then(|| Self {
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

fn object_of<'s>(scene: &'s Scene, instance: &Instance) -> &'s Arc<Object> {
    &scene.objects[instance.object.index()]
}

/// For each instance of a scene its place in another one's list, or `u32::MAX`.
fn places(of: &Scene, there: &Scene) -> Vec<u32> {
    let known: HashMap<u64, u32> = (0..).zip(&there.instances).map(|(at, i)| (i.key, at)).collect();
    let place = |instance: &Instance| {
        let at = *known.get(&instance.key)?;
        let found = &there.instances[at as usize];
        Arc::ptr_eq(object_of(of, instance), object_of(there, found)).then_some(at)
    };
    of.instances.iter().map(|instance| place(instance).unwrap_or(u32::MAX)).collect()
}

impl Motion {
    /// Between the worlds of two frames of `size` pixels.
    #[must_use]
    pub fn new(previous: &World, current: &World, size: [u32; 2]) -> Self {
        Self {
            camera: previous.scene.camera.rays(size),
            projection: previous.scene.camera.projection(size),
            lights: LightRemap::new(&previous.lights, &current.lights),
            instances: InstanceRemap::new(&previous.scene, &current.scene),
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
    use crate::scene::Transform;

    /// A scene of instances by their keys, all of one object.
    fn scene(keys: &[u64]) -> Scene {
        let mut scene = Scene::new("keys");
        let object = scene.add_object(Object::default());
        keys.iter().for_each(|key| scene.add_instance(object, Transform::IDENTITY, *key));
        scene
    }

    fn motion(instances: Option<InstanceRemap>) -> Motion {
        let camera = Scene::new("empty").camera;
        let (rays, projection) = (camera.rays([1, 1]), camera.projection([1, 1]));
        Motion { camera: rays, projection, lights: None, instances }
    }

    #[test]
    fn instances_are_found_by_key_in_both_directions() {
        let same = scene(&[3, 1]);
        assert_eq!(InstanceRemap::new(&same, &same.clone()), None);
        // A map that is not its own inverse.
        let keys = ([10, 11, 12, 15], [12, 13, 15, 10, 14]);
        let (previous, mut current) = (scene(&keys.0), scene(&keys.1));
        current.objects = previous.objects.clone();
        let remap = InstanceRemap::new(&previous, &current).unwrap();
        assert_eq!(remap.previous_places(), [2, u32::MAX, 3, 0, u32::MAX]);
        let motion = motion(Some(remap));
        for (at, key) in (0..).zip(keys.0) {
            let there = motion.current_instance(at);
            assert_eq!(there.map(|place| keys.1[place as usize]), (key != 11).then_some(key));
            if let Some(place) = there {
                assert_eq!(motion.previous_instance(place), Some(at));
            }
        }
        assert_eq!([1, 4, 5].map(|place| motion.previous_instance(place)), [None; 3]);
        assert_eq!([0, 2, 3].map(|at| motion.current_instance(at)), [Some(3), Some(0), Some(2)]);
    }

    #[test]
    fn another_object_under_a_key_is_another_thing() {
        let previous = scene(&[7, 8]);
        let mut current = previous.clone();
        let other = current.add_object(Object::default());
        current.instances[1].object = other;
        let motion = motion(InstanceRemap::new(&previous, &current));
        assert_eq!([0, 1].map(|place| motion.previous_instance(place)), [Some(0), None]);
        assert_eq!([0, 1].map(|place| motion.current_instance(place)), [Some(0), None]);
    }
}
