//! How many frames a technique needs to show that the scene has changed at once.
//!
//! The scene stands still until a light or an occluder jumps by its own diagonal. The step response
//! of a frame is how far the pixels that change have gone from the old scene's reference a to the
//! new one's b: s = Σ sign(b − a) (x − a) / Σ |b − a| over pixels whose luminance changes by more
//! than a tenth of the largest change. A technique whose every frame is unbiased has s = 1 in the
//! first frame, however much history it keeps.

use std::sync::Arc;

use glam::Vec3;

use super::reference::{self, ReferenceSettings};
use super::seeds::{SeedUse, seed};
use super::session::{self, Session};
use super::{figures, moving};
use crate::frame::{FrameLoop, Stage};
use crate::math::luminance;
use crate::picture::Picture;
use crate::plan::Shot;
use crate::scene::Scene;
use crate::stats::Moments;
use crate::techniques::Technique;
use crate::{Error, Result};

/// The share of the step that is waited for.
const REACHED: f64 = 0.9;
/// A pixel changes if its luminance does by this share of the largest change.
const CHANGES: f64 = 0.1;
/// Standard deviation of a reference's pixel, over the picture's mean.
const REFERENCE_ERROR: f64 = 0.03;

/// What changes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// All lights that have a surface.
    Light,
    /// The smallest surface that does not emit.
    Occluder,
}

/// How a technique's lag is measured.
#[derive(Clone, Debug)]
pub struct Lag {
    /// What jumps, by its own diagonal along x.
    pub change: Change,
    /// Frames before the change, at least 1.
    pub before: u32,
    /// Frames after it, at least 1.
    pub after: u32,
    /// Independent restarts.
    pub restarts: u32,
    /// Complete independent estimates a pixel and frame ([`Shot::effort`]).
    pub effort: f32,
    /// Where references come from; a file is refused, for a change has two.
    pub reference: ReferenceSettings,
}

impl Default for Lag {
    /// The lights jump after 30 frames; 30 frames of 20 restarts follow.
    fn default() -> Self {
        Self {
            change: Change::Light,
            before: 30,
            after: 30,
            restarts: 20,
            effort: 1.0,
            reference: ReferenceSettings::default(),
        }
    }
}

/// How a technique followed a change. Moments are over restarts.
#[derive(Debug)]
pub struct LagOutcome {
    /// Pixels that the change changes.
    pub changed_pixels: usize,
    /// Step response of the last frame before the change: 0 but for noise.
    pub steady: Moments,
    /// Step response of each frame after it; 1 is as new as any.
    pub response: Vec<Moments>,
    /// `relmse` of each frame after it, against the new scene's reference.
    pub error: Vec<Moments>,
}

impl LagOutcome {
    /// The first frame after the change, from 1, whose mean response is 90 % or more.
    #[must_use]
    pub fn frames(&self) -> Option<usize> {
        frames_to(REACHED, &self.response)
    }
}

/// The first frame, from 1, whose mean has gone far enough.
fn frames_to(share: f64, response: &[Moments]) -> Option<usize> {
    response.iter().position(|moments| moments.mean() >= share).map(|at| at + 1)
}

impl Lag {
    /// Measures a technique's lag on a session's scene as it stands at its start.
    ///
    /// # Errors
    /// An interruption; a scene without what shall jump, or that its jump does not change; whatever
    /// a loop or a reference refuses.
    pub fn run(&self, session: &Session, technique: &Arc<dyn Technique>) -> Result<LagOutcome> {
        if self.reference.file.is_some() {
            return Err(Error::usage(
                "a reference file is one picture, but a change has two: leave it out",
            ));
        }
        let old = still(session.stage.scene());
        let new = changed(&old, self.change)?;

        // A stage of its own: everything counts as moving, so no pass is left out before the
        // change.
        let stage = Stage::moving(old.clone())?;
        let shot = Shot { effort: self.effort as f32, ..session.shot };
        let mut frames =
            FrameLoop::with_backend(technique.clone(), &stage, shot, &session.backend)?;
        let [before, after] = self.references(session, [&old, &new], &mut frames)?;
        let step = Step::new(&before, &after)?;

        let progress = session.host().begin("restarts", u64::from(self.restarts));
        let mut response = vec![Moments::new(); self.after as usize];
        let mut error = response.clone();
        let mut steady = Moments::new();
        for index in 0..self.restarts {
            frames.restart(seed(session.shot.run, SeedUse::Restart, 0, index));
            for at in 0..self.before {
                session.check()?;
                let frame = frames.render_scene(old.clone())?;
                if at + 1 == self.before {
                    steady.push(step.response(&frame.picture()));
                }
            }
            for (response, error) in response.iter_mut().zip(&mut error) {
                session.check()?;
                let shown = frames.render_scene(new.clone())?.picture();
                response.push(step.response(&shown));
                error.push(figures::relmse(&shown, &after)?);
            }
            progress.step();
        }
        Ok(LagOutcome { changed_pixels: step.pixels.len(), steady, response, error })
    }

    /// References of both scenes.
    fn references(
        &self,
        session: &Session,
        scenes: [&Scene; 2],
        frames: &mut FrameLoop,
    ) -> Result<[Picture; 2]> {
        frames.restart(seed(session.shot.run, SeedUse::Pilot, 0, 0));
        let mean = frames.render_scene(scenes[0].clone())?.picture().mean_luminance();
        let error = REFERENCE_ERROR * mean;
        let variance = if error > 0.0 { error * error } else { f64::INFINITY };
        let nee = session::technique("nee")?;
        let of = |scene: &Scene| {
            let session = session.with_scene(scene.clone())?;
            let made = reference::obtain(&session, &self.reference, &nee, variance)?;
            Ok(made.reference.picture())
        };
        Ok([of(scenes[0])?, of(scenes[1])?])
    }
}

/// As at its start, an instance a shape, without motion.
fn still(scene: &Scene) -> Scene {
    let mut scene = moving::apart(&scene.at(scene.time[0]));
    scene.time = [0.0, 0.0];
    scene
}

/// After the jump.
fn changed(scene: &Scene, change: Change) -> Result<Scene> {
    let mut made = scene.clone();
    let all = 0..scene.instances.len();
    let things: Vec<usize> = match change {
        Change::Light => all.filter(|&at| moving::emits(scene, &scene.instances[at])).collect(),
        Change::Occluder => vec![moving::occluder(scene)?],
    };
    let path = things.iter().map(|&at| moving::diagonal(scene, at)).fold(0.0, f32::max) * Vec3::X;
    if things.is_empty() {
        return Err(Error::usage(
            "no surface of the scene emits; lights without a surface have no size to jump by: let an occluder jump instead",
        ));
    }
    for at in things {
        made.instances[at].to_world = moving::moved(&scene.instances[at].to_world, path);
    }
    Ok(made)
}

/// Where and how far the picture changes.
struct Step {
    pixels: Vec<ChangedPixel>,
    /// Σ |b − a|.
    size: f64,
}

/// A pixel that changes.
struct ChangedPixel {
    at: usize,
    /// Its luminance before the change.
    before: f64,
    /// The sign of its change.
    sign: f64,
}

impl Step {
    fn new(before: &Picture, after: &Picture) -> Result<Self> {
        let lum = |p: &Picture, at: usize| f64::from(luminance(p.pixels[at]));
        let change = |at: usize| lum(after, at) - lum(before, at);
        let count = before.pixels.len();
        let largest = (0..count).map(|at| change(at).abs()).fold(0.0, f64::max);
        if largest == 0.0 {
            return Err(Error::usage(
                "the change changes no pixel: choose another change or scene",
            ));
        }
        let pixels: Vec<ChangedPixel> = (0..count)
            .filter(|&at| change(at).abs() > CHANGES * largest)
            .map(|at| ChangedPixel { at, before: lum(before, at), sign: change(at).signum() })
            .collect();
        let size = pixels.iter().map(|pixel| change(pixel.at).abs()).sum();
        Ok(Self { pixels, size })
    }

    fn response(&self, shown: &Picture) -> f64 {
        let gone = |pixel: &ChangedPixel| {
            pixel.sign * (f64::from(luminance(shown.pixels[pixel.at])) - pixel.before)
        };
        self.pixels.iter().map(gone).sum::<f64>() / self.size
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Picture {
        Picture::new(values.len() as u32, 1, values.iter().map(|v| Vec3::splat(*v)).collect())
    }

    #[test]
    fn response_runs_from_before_to_after_over_pixels_that_change() {
        let (before, after) = (grey(&[1.0, 2.0, 5.0, 0.0]), grey(&[3.0, 1.0, 5.0, 0.01]));
        let step = Step::new(&before, &after).unwrap();
        assert_eq!(step.pixels.len(), 2, "0.01 is less than a tenth of 2");
        assert!(step.response(&before).abs() < 1e-6);
        assert!((step.response(&after) - 1.0).abs() < 1e-6);
        // Half of the way in one pixel, all of it in the other: (1 + 1) / 3. Other pixels do not
        // matter.
        let half = grey(&[2.0, 1.0, 900.0, 900.0]);
        assert!((step.response(&half) - 2.0 / 3.0).abs() < 1e-6);
        assert!(Step::new(&before, &before).is_err());
    }

    #[test]
    fn a_history_of_nine_tenths_takes_22_frames() {
        // 1 − 0.9^n ≥ 0.9 from n = 22; the mean over restarts counts, not a lucky one.
        let moments = |n: i32| -> Moments {
            let mean = 1.0 - 0.9_f64.powi(n);
            [mean - 0.3, mean + 0.3].into_iter().collect()
        };
        let response: Vec<Moments> = (1..=30).map(moments).collect();
        assert_eq!(frames_to(REACHED, &response), Some(22));
        assert_eq!(frames_to(REACHED, &response[..21]), None);
    }

    #[test]
    fn only_what_shall_jump_does() {
        let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/penumbra.pbrt");
        let scene = still(&crate::scene::load::load(&path).unwrap().scene);
        for (change, emits) in [(Change::Light, true), (Change::Occluder, false)] {
            let new = changed(&scene, change).unwrap();
            let moved: Vec<bool> = scene
                .instances
                .iter()
                .zip(&new.instances)
                .filter(|(a, b)| a.to_world.fixed() != b.to_world.fixed())
                .map(|(a, _)| moving::emits(&scene, a))
                .collect();
            assert_eq!(moved, [emits]);
        }
        assert!(changed(&Scene::new("empty"), Change::Light).unwrap_err().is_usage());
    }
}
