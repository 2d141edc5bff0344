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
    /// Primary rays then.
    pub camera: CameraRays,
    /// Pixel positions then.
    pub projection: Projection,
    /// Lights by host key; `None`: all at the same place in the table.
    pub lights: Option<LightRemap>,
    /// Place then of each instance, or `u32::MAX`, by host key; `None`: all at the same place in the list.
    pub instances: Option<Vec<u32>>,
}

impl Motion {
    /// Between the worlds of two frames of `size` pixels.
    #[must_use]
    pub fn new(previous: &World, current: &World, size: [u32; 2]) -> Self {
        let (then, now) = (&previous.scene.instances, &current.scene.instances);
        let same = then.len() == now.len() && then.iter().zip(now).all(|(a, b)| a.key == b.key);
        let instances = (!same).then(|| {
            let places: HashMap<u64, u32> =
                then.iter().enumerate().map(|(at, i)| (i.key, at as u32)).collect();
            now.iter().map(|i| places.get(&i.key).copied().unwrap_or(u32::MAX)).collect()
        });
        Self {
            camera: previous.scene.camera.rays(size),
            projection: previous.scene.camera.projection(size),
            lights: LightRemap::new(&previous.lights, &current.lights),
            instances,
        }
    }

    /// Where the surface point of a hit of `current` was in the previous frame.
    #[inline]
    #[must_use]
    pub fn position(&self, previous: &World, current: &World, hit: &Hit) -> Option<Vec3> {
        let now = hit.instance;
        let then = self.instances.as_ref().map_or(now, |places| places[now as usize]);
        let instance = previous.scene.instances.get(then as usize)?;
        Some(current.accel.point_under(hit, instance.to_world.fixed()))
    }
}
