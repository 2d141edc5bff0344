//! A scene ready for any number of runs.

use std::sync::Arc;

use crate::accel::BuildOptions;
use crate::error::Result;
use crate::plan::SceneFacts;
use crate::scene::Scene;
use crate::world::{World, bounds};

/// A scene ready for any number of runs: its facts and its first frame's world, built once.
#[derive(Clone, Debug)]
pub struct Stage {
    pub(super) scene: Arc<Scene>,
    pub(super) facts: SceneFacts,
    pub(super) first: Arc<World>,
}

impl Stage {
    /// Prepares a scene, which may move.
    ///
    /// # Errors
    /// Whatever [`Scene::validate`] refuses, and geometry that no acceleration structure can be
    /// built for.
    pub fn new(scene: Scene) -> Result<Self> {
        Self::with_options(scene, &BuildOptions::default())
    }

    /// Prepares a scene that the host will move from frame to frame
    /// ([`render_scene`](super::FrameLoop::render_scene)): everything counts as moving, and lights
    /// as coloured, since they may become so.
    ///
    /// # Errors
    /// As [`Stage::new`].
    pub fn moving(scene: Scene) -> Result<Self> {
        let mut stage = Self::with_options(
            scene,
            &BuildOptions { two_level: Some(true), ..BuildOptions::default() },
        )?;
        let facts = &mut stage.facts;
        (facts.moving_camera, facts.moving_lights, facts.moving_geometry) = (true, true, true);
        facts.grey_lights = false;
        Ok(stage)
    }

    /// As [`Stage::new`], with a choice of acceleration structure.
    ///
    /// # Errors
    /// As [`Stage::new`].
    pub fn with_options(scene: Scene, options: &BuildOptions) -> Result<Self> {
        scene.validate()?;
        // What moves must have a tree of its own, which later frames share.
        let moving = scene.instances.iter().any(|instance| instance.to_world.moves());
        let two_level = options.two_level.or(moving.then_some(true));
        let first = World::new(scene.at(scene.time[0]), &BuildOptions { two_level, ..*options })?;
        let mut counts = first.lights.counts();
        counts.add_hidden(&scene);
        let [low, high] = bounds(&first.scene);
        let diagonal = (high - low).length();
        let facts = SceneFacts { diagonal, ..SceneFacts::new(&scene, counts) };
        Ok(Self { scene: Arc::new(scene), facts, first: Arc::new(first) })
    }

    /// The scene, with its motion.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// What the scene contains.
    #[must_use]
    pub fn facts(&self) -> &SceneFacts {
        &self.facts
    }

    /// The world of the first frame.
    #[must_use]
    pub fn first_world(&self) -> &Arc<World> {
        &self.first
    }
}
