//! Rows of a ladder on disk: what was judged stays judged.

use std::path::PathBuf;

use super::{Ladder, LadderRow, Task};
use crate::experiment::kept::{self, Keep};
use crate::experiment::session::Session;
use crate::report::CacheKey;
use crate::report::sealed::{Reader, Writer, seal, unseal};
use crate::stats::{MeanTest, Part, Place, Quantity, Verdict};
use crate::{Error, Result};

const VERDICTS: [Verdict; 3] = [Verdict::Pass, Verdict::Fail, Verdict::Inconclusive];
const QUANTITIES: [Quantity; 4] =
    [Quantity::Luminance, Quantity::Red, Quantity::Green, Quantity::Blue];

impl Ladder {
    /// The row of a rung that was judged already; none where no work is kept.
    pub(super) fn kept_row(&self, task: &Task<'_>, session: &Session) -> Result<Option<LadderRow>> {
        let Some(keep) = &self.trial.keep else { return Ok(None) };
        let (key, path) = self.row_file(task, session, keep)?;
        let (row, warning) = unseal(&path, key, |reader| read(reader, task, session))?;
        if let Some(warning) = warning {
            session.host().note(&format!("warning: {warning}"));
        }
        Ok(row)
    }

    pub(super) fn keep_row(
        &self,
        task: &Task<'_>,
        session: &Session,
        row: &LadderRow,
    ) -> Result<()> {
        let Some(keep) = &self.trial.keep else { return Ok(()) };
        let (key, path) = self.row_file(task, session, keep)?;
        let mut writer = Writer::default();
        write(&mut writer, row);
        seal(&path, key, &writer)
    }

    /// Forgets that a rung was judged.
    pub(super) fn forget_row(&self, task: &Task<'_>, session: &Session) -> Result<()> {
        let Some(keep) = &self.trial.keep else { return Ok(()) };
        let (_, path) = self.row_file(task, session, keep)?;
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(Error::io(path, e)),
            _ => Ok(()),
        }
    }

    fn row_file(
        &self,
        task: &Task<'_>,
        session: &Session,
        keep: &Keep,
    ) -> Result<(CacheKey, PathBuf)> {
        let trial = self.rung_trial(task, session, f64::INFINITY);
        let key = kept::key(
            session,
            &format!(
                "rung {} of {} effort {} ages {:?} delta {} restarts {:?} most {} number {} against {}",
                task.rung.name,
                task.technique.spec(),
                trial.effort,
                trial.ages,
                trial.delta,
                trial.restarts,
                trial.most,
                trial.number,
                trial.against(&*task.technique)?.spec()
            ),
        )?;
        Ok((key, keep.folder.join(format!("{key}.row"))))
    }
}

fn write(writer: &mut Writer, row: &LadderRow) {
    // Destructured without `..`, so that a new field cannot be forgotten. What the task says is
    // not written.
    let LadderRow {
        rung: _,
        technique: _,
        scene: _,
        claim: _,
        number: _,
        ages,
        verdict,
        worst_image,
        worst_tile,
        confidence,
        restarts,
        stage,
    } = row;
    writer.list(ages, |writer, age| writer.u32(*age));
    writer.u32(place_of(&VERDICTS, verdict));
    for worst in [worst_image, worst_tile] {
        writer.list(worst.as_slice(), |writer, (age, part)| {
            writer.u32(*age);
            write_part(writer, part);
        });
    }
    writer.f64(*confidence);
    restarts.iter().for_each(|count| writer.u64(*count));
    writer.u32(*stage);
}

fn read(reader: &mut Reader<'_>, task: &Task<'_>, session: &Session) -> Option<LadderRow> {
    let plan = session.plan(&*task.technique);
    let ages = reader.list(Reader::u32)?;
    let verdict = *VERDICTS.get(reader.u32()? as usize)?;
    let mut worst = || {
        let mut found = reader.list(|reader| Some((reader.u32()?, read_part(reader)?)))?;
        (found.len() < 2).then(|| found.pop())
    };
    let (worst_image, worst_tile) = (worst()?, worst()?);
    Some(LadderRow {
        rung: task.rung.name,
        technique: plan.technique,
        scene: task.session.scene.clone(),
        claim: plan.claim,
        ages,
        verdict,
        worst_image,
        worst_tile,
        confidence: reader.f64()?,
        restarts: [reader.u64()?, reader.u64()?],
        number: task.number,
        stage: reader.u32()?,
    })
}

fn place_of<T: PartialEq>(all: &[T], one: &T) -> u32 {
    all.iter().position(|other| other == one).unwrap_or(all.len()) as u32
}

fn write_part(writer: &mut Writer, part: &Part) {
    let Part { place, quantity, test, scale, delta } = part;
    match place {
        Place::Image => writer.list(&[] as &[u64], |writer, at| writer.u64(*at)),
        Place::Tile { x, y } => writer.list(&[*x, *y], |writer, at| writer.u64(*at as u64)),
    }
    writer.u32(place_of(&QUANTITIES, quantity));
    let MeanTest { difference, standard_error, dof, statistic, p, skewness, skewness_error } = test;
    for value in
        [difference, standard_error, dof, statistic, p, skewness, skewness_error, scale, delta]
    {
        writer.f64(*value);
    }
}

fn read_part(reader: &mut Reader<'_>) -> Option<Part> {
    let place = match reader.list(Reader::u64)?[..] {
        [] => Place::Image,
        [x, y] => Place::Tile { x: x as usize, y: y as usize },
        _ => return None,
    };
    let quantity = *QUANTITIES.get(reader.u32()? as usize)?;
    let test = MeanTest {
        difference: reader.f64()?,
        standard_error: reader.f64()?,
        dof: reader.f64()?,
        statistic: reader.f64()?,
        p: reader.f64()?,
        skewness: reader.f64()?,
        skewness_error: reader.f64()?,
    };
    Some(Part { place, quantity, test, scale: reader.f64()?, delta: reader.f64()? })
}
