//! Parameter lists: `"type name" value`, with the place of each parameter for messages.

use std::cell::{Cell, RefCell};
use std::fmt;
use std::path::Path;
use std::sync::Arc;

use glam::DVec3;

use super::super::Warnings;
use super::lexer::{Kind, Lexer, Token, number, shorten, unescape};
use crate::error::{Error, Result, suggest};

/// A place in one of the files that make up a scene.
#[derive(Clone, Debug)]
pub(super) struct Place {
    pub(super) path: Arc<Path>,
    pub(super) line: u32,
    pub(super) column: u32,
}

impl Place {
    /// Adds this place to an error that has none.
    pub(super) fn put(&self, error: Error) -> Error {
        error.at_line(self.line, self.column).with_path(&self.path)
    }

    pub(super) fn unsupported<T>(&self, message: impl Into<String>) -> Result<T> {
        Err(self.put(Error::unsupported(message)))
    }

    pub(super) fn invalid<T>(&self, message: impl Into<String>) -> Result<T> {
        Err(self.put(Error::invalid(message)))
    }

    pub(super) fn syntax<T>(&self, message: impl Into<String>) -> Result<T> {
        Err(self.put(Error::syntax(message)))
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}", self.path.display(), self.line, self.column)
    }
}

/// The declared types, as written in the file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Type {
    Float,
    Integer,
    Bool,
    String,
    Point2,
    Vector2,
    Point3,
    Vector3,
    Normal,
    Rgb,
    Spectrum,
    Blackbody,
    Texture,
}

impl Type {
    const NAMES: [(&'static str, Self); 16] = [
        ("float", Self::Float),
        ("integer", Self::Integer),
        ("bool", Self::Bool),
        ("string", Self::String),
        ("point2", Self::Point2),
        ("vector2", Self::Vector2),
        ("point3", Self::Point3),
        ("point", Self::Point3),
        ("vector3", Self::Vector3),
        ("vector", Self::Vector3),
        ("normal", Self::Normal),
        ("normal3", Self::Normal),
        ("rgb", Self::Rgb),
        ("spectrum", Self::Spectrum),
        ("blackbody", Self::Blackbody),
        ("texture", Self::Texture),
    ];

    fn parse(text: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(name, _)| *name == text).map(|(_, kind)| *kind)
    }

    pub(super) fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, kind)| *kind == self).map_or("", |(name, _)| name)
    }

    /// How many numbers one value takes.
    fn numbers_per_value(self) -> usize {
        match self {
            Self::Point2 | Self::Vector2 => 2,
            Self::Point3 | Self::Vector3 | Self::Normal | Self::Rgb => 3,
            _ => 1,
        }
    }
}

/// The values of a [`Param`].
#[derive(Clone, Debug)]
pub(super) enum Values {
    Numbers(Vec<f64>),
    Strings(Vec<String>),
    Bools(Vec<bool>),
}

/// One parameter.
#[derive(Clone, Debug)]
pub(super) struct Param {
    pub(super) kind: Type,
    pub(super) name: String,
    pub(super) values: Values,
    pub(super) place: Place,
    used: Cell<bool>,
}

impl Param {
    /// Reads the value after the declaration `"type name"`, which is `token`.
    pub(super) fn parse(lexer: &mut Lexer<'_>, token: Token<'_>, path: &Arc<Path>) -> Result<Self> {
        let at = |t: &Token<'_>| Place { path: path.clone(), line: t.line, column: t.column };
        let place = at(&token);
        let Kind::Quoted(declaration) = token.kind else {
            return place
                .syntax(format!("found {}; allowed: \"type name\"", token.kind.describe()));
        };
        let mut words = declaration.split_whitespace();
        let (Some(kind), Some(name), None) = (words.next(), words.next(), words.next()) else {
            let found = shorten(declaration);
            return place.syntax(format!(
                "found \"{found}\"; allowed: \"type name\", for example \"float radius\""
            ));
        };
        let Some(parsed) = Type::parse(kind) else {
            let names: Vec<&str> = Type::NAMES.iter().map(|(name, _)| *name).collect();
            return place.syntax(format!(
                "found the parameter type `{}`; {}",
                shorten(kind),
                suggest(&shorten(kind), &names)
            ));
        };
        let mut reader = ValueReader { kind: parsed, name, values: None, place: &place };
        let first = lexer.next()?;
        match first.kind {
            Kind::Open => loop {
                let token = lexer.next()?;
                match token.kind {
                    Kind::Close => break,
                    Kind::Open | Kind::End => {
                        let message = format!(
                            "found {}; allowed: a value of `{name}`, or `]`",
                            token.kind.describe()
                        );
                        return at(&token).syntax(message);
                    }
                    _ => reader.push(token)?,
                }
            },
            Kind::Close | Kind::End => {
                let message = format!(
                    "found {}; allowed: a value of `{name}`, or `[`",
                    first.kind.describe()
                );
                return at(&first).syntax(message);
            }
            _ => reader.push(first)?,
        }
        let values = reader.values.unwrap_or(Values::Numbers(Vec::new()));
        if let Values::Numbers(numbers) = &values {
            let per_value = parsed.numbers_per_value();
            if numbers.len() % per_value != 0 {
                let message = format!(
                    "`{name}` has {} numbers; allowed: a multiple of {per_value}",
                    numbers.len()
                );
                return place.invalid(message);
            }
        }
        Ok(Self { kind: parsed, name: name.to_string(), values, place, used: Cell::new(false) })
    }

    pub(super) fn numbers(&self) -> &[f64] {
        match &self.values {
            Values::Numbers(numbers) => numbers,
            _ => &[],
        }
    }

    fn count(&self) -> usize {
        match &self.values {
            Values::Numbers(numbers) => numbers.len() / self.kind.numbers_per_value(),
            Values::Strings(strings) => strings.len(),
            Values::Bools(bools) => bools.len(),
        }
    }

    /// Exactly one value is there.
    pub(super) fn single(&self) -> Result<&Self> {
        match self.count() {
            1 => Ok(self),
            n => self.place.invalid(format!("`{}` has {n} values; allowed: one", self.name)),
        }
    }

    /// The one text.
    pub(super) fn text(&self) -> Result<&str> {
        match &self.values {
            Values::Strings(strings) if strings.len() == 1 => Ok(&strings[0]),
            _ => self.place.invalid(format!(
                "`{}` has {} values; allowed: one text in quotation marks",
                self.name,
                self.count()
            )),
        }
    }
}

/// Collects values of one type.
struct ValueReader<'p> {
    kind: Type,
    name: &'p str,
    values: Option<Values>,
    place: &'p Place,
}

impl ValueReader<'_> {
    fn push(&mut self, token: Token<'_>) -> Result<()> {
        let allowed = match (self.kind, token.kind) {
            (Type::String | Type::Texture | Type::Spectrum, Kind::Quoted(text)) => {
                match self.values.get_or_insert_with(|| Values::Strings(Vec::new())) {
                    Values::Strings(strings) => {
                        strings.push(unescape(text));
                        return Ok(());
                    }
                    _ => "numbers",
                }
            }
            (Type::String | Type::Texture, _) => "a text in quotation marks",
            (Type::Bool, Kind::Word(text) | Kind::Quoted(text)) => {
                if let (Some(value), Values::Bools(bools)) = (
                    match text {
                        "true" => Some(true),
                        "false" => Some(false),
                        _ => None,
                    },
                    self.values.get_or_insert_with(|| Values::Bools(Vec::new())),
                ) {
                    bools.push(value);
                    return Ok(());
                }
                "true, false"
            }
            (kind, Kind::Word(text)) => {
                let value = number(text).filter(|v| kind != Type::Integer || integral(*v));
                if let Some(value) = value
                    && let Values::Numbers(numbers) =
                        self.values.get_or_insert_with(|| Values::Numbers(Vec::new()))
                {
                    numbers.push(value);
                    return Ok(());
                }
                if kind == Type::Integer {
                    "integers from -2147483648 to 2147483647"
                } else {
                    "finite numbers"
                }
            }
            _ => "numbers",
        };
        let message = format!(
            "found {} as a value of `{} {}`; allowed: {allowed}",
            token.kind.describe(),
            self.kind.name(),
            self.name
        );
        Place { path: self.place.path.clone(), line: token.line, column: token.column }
            .syntax(message)
    }
}

fn integral(value: f64) -> bool {
    value.fract() == 0.0 && (f64::from(i32::MIN)..=f64::from(i32::MAX)).contains(&value)
}

/// The parameters of one directive.
#[derive(Clone, Debug)]
pub(super) struct Params {
    /// The directive, for messages: `Shape "sphere"`.
    pub(super) owner: String,
    /// Of the directive.
    pub(super) place: Place,
    list: Vec<Param>,
    /// Every name that was asked for: what is known.
    asked: RefCell<Vec<&'static str>>,
}

impl Params {
    /// Refuses a parameter that is given twice.
    pub(super) fn new(
        owner: String,
        place: Place,
        list: Vec<Param>,
        defaults: &[Param],
    ) -> Result<Self> {
        let mut names = std::collections::HashSet::new();
        for param in &list {
            if !names.insert(param.name.as_str()) {
                return param
                    .place
                    .invalid(format!("`{}` is given twice; allowed: once", param.name));
            }
        }
        let extra: Vec<Param> =
            defaults.iter().filter(|d| !names.contains(d.name.as_str())).cloned().collect();
        // Defaults of `Attribute` need not fit every directive that they reach.
        extra.iter().for_each(|param| param.used.set(true));
        drop(names);
        let list = list.into_iter().chain(extra).collect();
        Ok(Self { owner, place, list, asked: RefCell::new(Vec::new()) })
    }

    /// The parameter of this name, whatever its type.
    pub(super) fn find(&self, name: &'static str) -> Option<&Param> {
        let mut asked = self.asked.borrow_mut();
        if !asked.contains(&name) {
            asked.push(name);
        }
        let param = self.list.iter().find(|p| p.name == name)?;
        param.used.set(true);
        Some(param)
    }

    /// The parameter of this name, refused unless its type is one of `kinds`.
    pub(super) fn typed(&self, name: &'static str, kinds: &[Type]) -> Result<Option<&Param>> {
        match self.find(name) {
            Some(param) if !kinds.contains(&param.kind) => {
                let allowed: Vec<&str> = kinds.iter().map(|k| k.name()).collect();
                let message = format!(
                    "`{name}` of {} is a `{}`; allowed: {}",
                    self.owner,
                    param.kind.name(),
                    allowed.join(", ")
                );
                param.place.invalid(message)
            }
            other => Ok(other),
        }
    }

    pub(super) fn float(&self, name: &'static str) -> Result<Option<f64>> {
        let param = self.typed(name, &[Type::Float])?;
        param.map(|p| p.single().map(|p| p.numbers()[0])).transpose()
    }

    pub(super) fn float_or(&self, name: &'static str, default: f64) -> Result<f64> {
        Ok(self.float(name)?.unwrap_or(default))
    }

    /// A number above zero.
    pub(super) fn positive_or(&self, name: &'static str, default: f64) -> Result<f64> {
        let value = self.float_or(name, default)?;
        if value > 0.0 {
            return Ok(value);
        }
        self.param_place(name).invalid(format!("`{name}` is {value}; allowed: more than 0"))
    }

    pub(super) fn integer(&self, name: &'static str) -> Result<Option<i64>> {
        let param = self.typed(name, &[Type::Integer])?;
        param.map(|p| p.single().map(|p| p.numbers()[0] as i64)).transpose()
    }

    pub(super) fn bool_or(&self, name: &'static str, default: bool) -> Result<bool> {
        let Some(param) = self.typed(name, &[Type::Bool])? else { return Ok(default) };
        match &param.single()?.values {
            Values::Bools(bools) => Ok(bools[0]),
            _ => Ok(default),
        }
    }

    pub(super) fn string(&self, name: &'static str) -> Result<Option<&str>> {
        self.typed(name, &[Type::String])?.map(Param::text).transpose()
    }

    /// One of a closed set of words.
    pub(super) fn word_or(
        &self,
        name: &'static str,
        default: &'static str,
        allowed: &[&'static str],
    ) -> Result<&'static str> {
        let Some(given) = self.string(name)? else { return Ok(default) };
        match allowed.iter().find(|a| **a == given) {
            Some(word) => Ok(word),
            None => self.param_place(name).unsupported(format!(
                "`{name}` is \"{}\"; {}",
                shorten(given),
                suggest(&shorten(given), allowed)
            )),
        }
    }

    pub(super) fn point_or(&self, name: &'static str, default: DVec3) -> Result<DVec3> {
        let Some(param) = self.typed(name, &[Type::Point3, Type::Vector3])? else {
            return Ok(default);
        };
        Ok(DVec3::from_slice(param.single()?.numbers()))
    }

    /// Numbers of any length.
    pub(super) fn numbers(&self, name: &'static str, kinds: &[Type]) -> Result<Option<&[f64]>> {
        Ok(self.typed(name, kinds)?.map(Param::numbers))
    }

    /// Where a parameter stands, or its directive.
    pub(super) fn param_place(&self, name: &str) -> &Place {
        self.list.iter().find(|p| p.name == name).map_or(&self.place, |p| &p.place)
    }

    /// Whether the parameter is given; marks it as known.
    pub(super) fn has(&self, name: &'static str) -> bool {
        self.find(name).is_some()
    }

    /// Marks parameters that are known to change nothing here.
    pub(super) fn ignore(&self, names: &[&'static str]) {
        names.iter().for_each(|name| {
            self.find(name);
        });
    }

    /// Warns of each of `names` that is given.
    pub(super) fn ignore_with(&self, names: &[&'static str], why: &str, warnings: &mut Warnings) {
        for name in names {
            if let Some(param) = self.find(name) {
                warnings
                    .add(format!("{}: `{name}` of {} is ignored: {why}", param.place, self.owner));
            }
        }
    }

    /// Warns of every parameter that nothing asked for.
    pub(super) fn finish(&self, warnings: &mut Warnings) {
        let asked = self.asked.borrow();
        for param in self.list.iter().filter(|p| !p.used.get()) {
            let known = suggest(&shorten(&param.name), &asked);
            warnings.add(format!(
                "{}: unknown parameter `{}` of {} is ignored; {known}",
                param.place,
                shorten(&param.name),
                self.owner
            ));
        }
    }
}
