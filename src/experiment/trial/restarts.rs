//! Independent restarts of a technique, looked at at every age of a trial.

use std::time::Instant;

use rayon::prelude::*;

use super::Running;
use super::counts::Counts;
use crate::Result;
use crate::experiment::bias;
use crate::experiment::kept::STORE_EVERY;
use crate::experiment::seeds::{SeedUse, seed};
use crate::frame::FrameLoop;
use crate::picture::Picture;
use crate::stats::Restarts;

/// Pixels up to which each thread renders restarts of its own. Threads that share a frame wait for
/// each other after every pass: with 64 × 64 pixels two of them made a seventh fewer restarts than
/// on their own; larger pictures have tasks enough, and a loop a thread would fill the caches.
const PIXELS_APART: usize = 1 << 15;
/// Bytes of pictures that may wait to be counted.
const WAITING: usize = 1 << 26;

impl Running<'_> {
    /// Renders restarts and looks at them at every age that they reach.
    pub(super) fn restarts(&self, seeds: SeedUse, counts: &Counts) -> Result<Vec<Restarts>> {
        self.more_restarts(seeds, counts, 0, Vec::new(), |_, _| Ok(()))
    }

    /// Goes on behind the first `next` restarts, whose sums are `found`. Restarts are counted in
    /// the order of their numbers, so that sums are the same for any number of threads and
    /// interruptions. `save` gets sums and their number now and then, and before an error is given.
    pub(super) fn more_restarts(
        &self,
        seeds: SeedUse,
        counts: &Counts,
        mut next: u32,
        mut found: Vec<Restarts>,
        mut save: impl FnMut(u32, &[Restarts]) -> Result<()>,
    ) -> Result<Vec<Restarts>> {
        let Self { session, technique, trial, ages, .. } = self;
        let total = counts.0[0];
        while found.len() < ages.len() {
            found.push(bias::restarts(session.shot.size)?);
        }
        let progress = session.host().begin("restarts", u64::from(total));
        progress.say(&technique.spec());
        progress.set(u64::from(next), u64::from(total));

        // A loop a thread for small pictures, and one for all threads else.
        let pixels = session.shot.pixels();
        let apart = session.device().is_none() && pixels <= PIXELS_APART;
        let threads = if apart { rayon::current_num_threads().min(total as usize) } else { 1 };
        let mut loops = Vec::new();
        for _ in 0..threads.max(1) {
            loops.push(session.start(technique, trial.effort, 0)?);
        }
        let waiting = loops.len() * ages.len() * pixels * size_of::<glam::Vec3>();
        let each = if loops.len() == 1 { 1 } else { (WAITING / waiting).clamp(1, 8) };

        let mut saved = Instant::now();
        let stride = loops.len();
        while next < total {
            let batch = next..total.min(next + (each * stride) as u32);
            // Restart i belongs to loop i modulo their number: fewer and fewer reach the later
            // ages, so neighbours take the same time.
            let rendered = loops
                .par_iter_mut()
                .enumerate()
                .map(|(at, frames)| {
                    let own = batch.clone().skip(at).step_by(stride);
                    own.map(|index| {
                        frames.restart(seed(session.shot.run, seeds, trial.number, index));
                        self.pictures(frames, counts.reached(index))
                    })
                    .collect()
                })
                .collect::<Result<Vec<Vec<_>>>>();
            let rendered = match rendered {
                Ok(rendered) => rendered,
                Err(error) => {
                    save(next, &found)?;
                    return Err(error);
                }
            };
            for index in 0..batch.len() {
                let pictures = &rendered[index % stride][index / stride];
                for (restarts, picture) in found.iter_mut().zip(pictures) {
                    restarts.push(&picture.pixels)?;
                }
                progress.step();
            }
            next = batch.end;
            if saved.elapsed() > STORE_EVERY {
                save(next, &found)?;
                saved = Instant::now();
            }
        }
        let bad: u64 = found.iter().map(Restarts::not_finite).sum();
        if bad > 0 {
            session
                .host()
                .note(&format!("warning: {bad} pixels of `{}` are not finite", technique.spec()));
        }
        Ok(found)
    }

    /// The pictures of a restart at the first `reached` ages.
    fn pictures(&self, frames: &mut FrameLoop, reached: usize) -> Result<Vec<Picture>> {
        let mut done = 0;
        self.ages[..reached]
            .iter()
            .map(|&age| {
                while done + 1 < age {
                    self.session.next(frames)?;
                    done += 1;
                }
                done += 1;
                Ok(self.session.next(frames)?.picture())
            })
            .collect()
    }
}
