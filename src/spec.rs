//! Specifications: `name` or `name:key=value,key=value`, and the parameters that they set.
//!
//! A parameter is one [`Row`]: its key, what it does, the values that are allowed, and where it
//! lies in the technique's struct. Reading a SPEC, writing the canonical one, refusing what is out
//! of range and the lists for people all follow from the rows.

use std::ops::RangeInclusive;

use crate::error::{Error, Result, suggest};

/// A closed set of named values.
pub trait Choice: Copy + PartialEq + 'static {
    /// All values, in the order in which they are listed.
    const ALL: &'static [Self];

    /// The name in a SPEC.
    fn name(self) -> &'static str;

    /// The value's place in [`Choice::ALL`].
    fn place(self) -> usize {
        Self::ALL.iter().position(|value| *value == self).unwrap_or(0)
    }
}

impl Choice for bool {
    const ALL: &'static [Self] = &[false, true];

    fn name(self) -> &'static str {
        if self { "true" } else { "false" }
    }
}

/// One parameter of the technique `T`.
#[derive(Clone, Debug)]
pub struct Row<T: 'static> {
    /// The key in a SPEC.
    pub key: &'static str,
    /// What the parameter does, and what higher and lower values cost.
    pub about: &'static str,
    /// What it may be, and where it lies.
    pub field: Field<T>,
}

/// The values that a parameter may have, with the way to its field.
#[derive(Clone, Debug)]
pub enum Field<T: 'static> {
    /// A whole number.
    Integer(RangeInclusive<u32>, fn(&mut T) -> &mut u32),
    /// A number.
    Number(RangeInclusive<f32>, fn(&mut T) -> &mut f32),
    /// A number, or a name in place of it, which is `None`.
    Optional(&'static str, RangeInclusive<f32>, fn(&mut T) -> &mut Option<f32>),
    /// One of a set of names, by its place among them.
    Choice(fn() -> Vec<&'static str>, fn(&T) -> usize, fn(&mut T, usize)),
}

/// A [`Row`] of the technique `T`: `row!(T, "key", field: 0..=8, "about")` for whole numbers,
/// `row!(T, "key", number field: 0.0..=1.0, "about")` for numbers, `row!(T, "key", choice field:
/// Type, "about")` for names.
macro_rules! row {
    ($type:ty, $key:literal, number $($field:ident).+: $range:expr, $about:expr) => {
        $crate::spec::Row {
            key: $key,
            about: $about,
            field: $crate::spec::Field::Number($range, |technique: &mut $type| {
                &mut technique.$($field).+
            }),
        }
    };
    ($type:ty, $key:literal, optional $name:literal $($field:ident).+: $range:expr, $about:expr) => {
        $crate::spec::Row {
            key: $key,
            about: $about,
            field: $crate::spec::Field::Optional($name, $range, |technique: &mut $type| {
                &mut technique.$($field).+
            }),
        }
    };
    ($type:ty, $key:literal, choice $($field:ident).+: $choice:ty, $about:expr) => {
        $crate::spec::Row {
            key: $key,
            about: $about,
            field: $crate::spec::Field::Choice(
                || <$choice>::ALL.iter().map(|value| Choice::name(*value)).collect(),
                |technique: &$type| technique.$($field).+.place(),
                |technique: &mut $type, place| technique.$($field).+ = <$choice>::ALL[place],
            ),
        }
    };
    ($type:ty, $key:literal, $($field:ident).+: $range:expr, $about:expr) => {
        $crate::spec::Row {
            key: $key,
            about: $about,
            field: $crate::spec::Field::Integer($range, |technique: &mut $type| {
                &mut technique.$($field).+
            }),
        }
    };
}
pub(crate) use row;

impl<T: Clone> Row<T> {
    /// The parameter's value as a SPEC has it.
    fn text(&self, technique: &T) -> String {
        let mut copy = technique.clone();
        match &self.field {
            Field::Integer(_, field) => field(&mut copy).to_string(),
            Field::Number(_, field) => field(&mut copy).to_string(),
            Field::Optional(name, _, field) => match field(&mut copy) {
                Some(value) => value.to_string(),
                None => (*name).to_string(),
            },
            Field::Choice(names, get, _) => names()[get(technique)].to_string(),
        }
    }

    /// What is allowed, for people.
    fn allowed(&self) -> String {
        match &self.field {
            Field::Integer(range, _) => format!("[{}, {}]", range.start(), range.end()),
            Field::Number(range, _) => format!("[{}, {}]", range.start(), range.end()),
            Field::Optional(name, range, _) => {
                format!("{name} or [{}, {}]", range.start(), range.end())
            }
            Field::Choice(names, ..) => names().join(", "),
        }
    }

    fn out_of_range(&self, given: &str) -> Error {
        let range = |range: &RangeInclusive<f32>| format!("[{}, {}]", range.start(), range.end());
        let allowed = match &self.field {
            Field::Integer(..) => format!("an integer in {}", self.allowed()),
            Field::Optional(name, numbers, _) => {
                format!("`{name}` or a number in {}", range(numbers))
            }
            _ => format!("a number in {}", self.allowed()),
        };
        Error::usage(format!("`{}` is `{given}`, but must be {allowed}", self.key))
    }

    /// Sets the parameter to what a SPEC says.
    fn set(&self, technique: &mut T, text: &str) -> Result<()> {
        match &self.field {
            Field::Integer(range, field) => match text.parse() {
                Ok(value) if range.contains(&value) => *field(technique) = value,
                _ => return Err(self.out_of_range(text)),
            },
            Field::Number(range, field) => match text.parse() {
                Ok(value) if range.contains(&value) => *field(technique) = value,
                _ => return Err(self.out_of_range(text)),
            },
            Field::Optional(name, range, field) => match text.parse() {
                _ if text == *name => *field(technique) = None,
                Ok(value) if range.contains(&value) => *field(technique) = Some(value),
                _ => return Err(self.out_of_range(text)),
            },
            Field::Choice(names, _, set) => {
                let names = names();
                let place = names.iter().position(|name| *name == text).ok_or_else(|| {
                    Error::usage(format!(
                        "`{}` has no value `{text}`; {}",
                        self.key,
                        suggest(text, &names)
                    ))
                })?;
                set(technique, place);
            }
        }
        Ok(())
    }

    /// Refuses a value out of range; NaN is in no range.
    fn check(&self, technique: &T) -> Result<()> {
        let mut copy = technique.clone();
        let inside = match &self.field {
            Field::Integer(range, field) => range.contains(field(&mut copy)),
            Field::Number(range, field) => range.contains(field(&mut copy)),
            Field::Optional(_, range, field) => field(&mut copy).is_none_or(|x| range.contains(&x)),
            Field::Choice(..) => true,
        };
        if inside { Ok(()) } else { Err(self.out_of_range(&self.text(technique))) }
    }
}

/// `default` with the values of a SPEC in place of its own. Every key has a row
/// ([`crate::techniques::parse`] has checked that).
///
/// # Errors
/// A usage error that names the key, what was given and what is allowed.
pub fn build<T: Clone>(default: T, rows: &[Row<T>], values: &Values) -> Result<T> {
    let mut technique = default;
    for row in rows {
        if let Some((_, text)) = values.pairs.iter().find(|(key, _)| key == row.key) {
            row.set(&mut technique, text)?;
        }
    }
    Ok(technique)
}

/// The canonical SPEC: the name, and the parameters that differ from `default`.
pub fn write<T: Clone>(name: &str, default: &T, rows: &[Row<T>], technique: &T) -> String {
    let pairs: Vec<String> = rows
        .iter()
        .map(|row| (row, row.text(technique)))
        .filter(|(row, text)| *text != row.text(default))
        .map(|(row, text)| format!("{}={text}", row.key))
        .collect();
    if pairs.is_empty() { name.to_string() } else { format!("{name}:{}", pairs.join(",")) }
}

/// Refuses the first parameter whose value is not allowed.
///
/// # Errors
/// A usage error that names the key, what was given and what is allowed.
pub fn check<T: Clone>(rows: &[Row<T>], technique: &T) -> Result<()> {
    rows.iter().try_for_each(|row| row.check(technique))
}

/// The rows for people, with the values of `default`.
pub fn describe<T: Clone>(rows: &[Row<T>], default: &T) -> Vec<Parameter> {
    rows.iter()
        .map(|row| Parameter {
            key: row.key,
            about: row.about,
            allowed: row.allowed(),
            default: row.text(default),
        })
        .collect()
}

/// A parameter that a SPEC may set, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parameter {
    /// The key in a SPEC.
    pub key: &'static str,
    /// What it does, and what higher and lower values cost.
    pub about: &'static str,
    /// A range such as `[0, 8]`, or the names.
    pub allowed: String,
    /// The value where none is given.
    pub default: String,
}

/// The `key=value` pairs of a SPEC, each key once.
#[derive(Clone, Debug, Default)]
pub struct Values {
    pairs: Vec<(String, String)>,
}

impl Values {
    /// Reads what follows the name in `spec`; `known` are the keys of the technique `name`.
    pub(crate) fn parse(spec: &str, name: &str, rest: &str, known: &[&str]) -> Result<Self> {
        let mut values = Self::default();
        for pair in rest.split(',').filter(|pair| !pair.is_empty()) {
            let Some((key, value)) = pair.split_once('=') else {
                return Err(Error::usage(format!(
                    "`{pair}` in `{spec}` is not of the form key=value; {}",
                    suggest(pair, known)
                )));
            };
            if !known.contains(&key) {
                return Err(Error::usage(format!(
                    "`{name}` has no parameter `{key}`; {}",
                    suggest(key, known)
                )));
            }
            if values.get(key).is_some() {
                return Err(Error::usage(format!("`{key}` is given twice in `{spec}`")));
            }
            values.pairs.push((key.to_string(), value.to_string()));
        }
        Ok(values)
    }

    /// The text of a key's value.
    #[must_use]
    pub fn get(&self, key: &str) -> Option<&str> {
        self.pairs.iter().find(|(known, _)| known == key).map(|(_, text)| text.as_str())
    }
}
