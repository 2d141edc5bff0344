//! The composer: modules become one text, without the lines that a kernel leaves out, and errors
//! find their way back to a module's file and line.
//!
//! Directives are comments, so that a text may be valid as a whole, too:
//!
//! | directive | its lines stay where |
//! |---|---|
//! | `//#if NAME`, `//#if !NAME` | the constant or flag is not 0, is 0 |
//! | `//#if NAME=A\|B` | it is one of these: numbers, or names of constants of type `u32` that a module declares |
//! | `//#else`, `//#endif` | the condition does not hold; always |
//!
//! A constant that a module declares and no pipeline sets is not known here: all of its branches
//! stay. A name that nobody declares is an error.

use std::collections::{HashMap, HashSet};

use crate::twin::Module;

/// A kernel's text, and where each of its lines comes from.
#[derive(Clone, Debug)]
pub(crate) struct Composed {
    pub(crate) text: String,
    pub(super) modules: Vec<Module>,
    /// For each line its module and the line there, from 1; `None`: the composer wrote it.
    pub(super) lines: Vec<Option<(usize, usize)>>,
}

impl Composed {
    /// `generated`, whose declarations directives may compare with, then what stays of `modules`;
    /// `known` are constants and flags with their values.
    ///
    /// # Errors
    /// A directive without its other half, or that asks for a name that is not declared, with its
    /// file and line.
    pub(crate) fn new(
        generated: &str,
        modules: &[Module],
        known: &HashMap<&str, f64>,
    ) -> Result<Self, String> {
        let mut composed =
            Self { text: String::new(), modules: modules.to_vec(), lines: Vec::new() };
        composed.generate(generated);
        let texts = || [generated].into_iter().chain(modules.iter().map(|module| module.text));
        let names = Names {
            known,
            numbers: texts().flat_map(str::lines).filter_map(number_of).collect(),
            declared: texts().flat_map(str::lines).filter_map(override_of).collect(),
        };
        for at in 0..modules.len() {
            composed.append(at, &names)?;
        }
        Ok(composed)
    }

    /// Appends lines of the composer's own.
    pub(crate) fn generate(&mut self, text: &str) {
        for line in text.lines() {
            self.push(line, None);
        }
    }

    fn push(&mut self, line: &str, origin: Option<(usize, usize)>) {
        self.text.push_str(line);
        self.text.push('\n');
        self.lines.push(origin);
    }

    fn append(&mut self, module: usize, names: &Names<'_>) -> Result<(), String> {
        let Module { text, .. } = self.modules[module];
        let place = |line: usize| format!("{}:{line}", self.modules[module].path());
        // For each open directive: whether its lines stay, and whether its other branch's do.
        let mut open: Vec<(bool, bool)> = Vec::new();
        let mut stay = Vec::new();
        for (at, line) in text.lines().enumerate() {
            let directive = line.trim_start().strip_prefix("//#");
            match directive.map(|d| d.split_once(' ').unwrap_or((d, ""))) {
                Some(("if", condition)) => {
                    let holds = names
                        .condition(condition.trim())
                        .map_err(|why| format!("{}: {why}", place(at + 1)))?;
                    open.push((holds.unwrap_or(true), !holds.unwrap_or(false)));
                }
                Some((word @ ("else" | "endif"), _)) => {
                    let Some((stays, other)) = open.pop() else {
                        return Err(format!("{}: an #{word} without an #if", place(at + 1)));
                    };
                    if word == "else" {
                        open.push((other, stays));
                    }
                }
                // Other comments are comments.
                _ if open.iter().all(|(stays, _)| *stays) => stay.push((line, at + 1)),
                _ => {}
            }
        }
        if !open.is_empty() {
            return Err(format!("{}: an #if has no #endif", place(text.lines().count())));
        }
        for (line, number) in stay {
            self.push(line, Some((module, number)));
        }
        Ok(())
    }

    /// The file and line, in the file's own numbers, of a line of the text, counted from 1.
    pub(crate) fn place(&self, line: usize) -> String {
        match line.checked_sub(1).and_then(|at| self.lines.get(at)) {
            Some(Some((module, number))) => format!("{}:{number}", self.modules[*module].path()),
            _ => format!("line {line}, which the composer wrote"),
        }
    }

    /// What a compiler says of a line of the text, with the place and the line itself in front of
    /// it. Listings of the text are left out: their numbers are those of no file.
    pub(crate) fn explain(&self, line: usize, message: &str) -> String {
        // The compiler begins with the kernel's name.
        let (_, message) = message.split_once(" error: ").unwrap_or(("", message));
        let said: Vec<&str> = message
            .lines()
            .filter(|line| !line.contains(['│', '┌']))
            .map(|line| line.trim().trim_start_matches("= "))
            .filter(|line| !line.is_empty())
            .collect();
        let shown = line.checked_sub(1).and_then(|at| self.text.lines().nth(at)).unwrap_or("");
        format!("{}: `{}`: {}", self.place(line), shown.trim(), said.join("; "))
    }
}

/// What directives may ask for.
struct Names<'a> {
    known: &'a HashMap<&'a str, f64>,
    /// Constants of the modules.
    numbers: HashMap<&'a str, u32>,
    /// Pipeline-overridable constants of the modules, with a value or without.
    declared: HashSet<&'a str>,
}

impl Names<'_> {
    /// Whether a condition holds; `None`: its constant has no value here.
    fn condition(&self, condition: &str) -> Result<Option<bool>, String> {
        if let Some(name) = condition.strip_prefix('!') {
            return Ok(self.value(name)?.map(|value| value == 0.0));
        }
        let Some((name, wanted)) = condition.split_once('=') else {
            return Ok(self.value(condition)?.map(|value| value != 0.0));
        };
        let value = self.value(name)?;
        let mut any = false;
        for wanted in wanted.split('|') {
            let number = match wanted.parse() {
                Ok(number) => number,
                Err(_) => *self
                    .numbers
                    .get(wanted)
                    .ok_or_else(|| format!("no constant is called `{wanted}`"))?,
            };
            any |= value == Some(f64::from(number));
        }
        Ok(value.map(|_| any))
    }

    fn value(&self, name: &str) -> Result<Option<f64>, String> {
        match self.known.get(name) {
            Some(value) => Ok(Some(*value)),
            None if self.declared.contains(name) => Ok(None),
            None => Err(format!("no constant or flag is called `{name}`")),
        }
    }
}

/// The name and value that a line declares as `const NAME: u32 = 5u;`.
fn number_of(line: &str) -> Option<(&str, u32)> {
    let (name, value) = line.strip_prefix("const ")?.split_once(": u32 = ")?;
    Some((name, value.strip_suffix("u;")?.parse().ok()?))
}

/// The name that a line declares as `override NAME: …`.
fn override_of(line: &str) -> Option<&str> {
    Some(line.strip_prefix("override ")?.split_once(':')?.0)
}
