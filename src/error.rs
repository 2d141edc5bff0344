//! The crate's one error type. Every message says what was given and what is allowed.

use std::fmt;
use std::path::{Path, PathBuf};

/// A result of a fallible operation of this crate.
pub type Result<T> = std::result::Result<T, Error>;

/// Why a scene, a parameter or a file was refused, and where.
///
/// The text reads `FILE:LINE:COLUMN: what was found, what is allowed` as far as each part is known.
/// The predicates tell the kinds apart; no other detail is part of the interface.
pub struct Error {
    inner: Box<Inner>,
}

struct Inner {
    kind: ErrorKind,
    message: String,
    path: Option<PathBuf>,
    place: Option<Place>,
    source: Option<Box<dyn std::error::Error + Send + Sync>>,
}

/// What went wrong, in the coarsest useful classes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ErrorKind {
    /// The operating system refused to read or write.
    Io,
    /// The bytes do not form the format that they claim to be.
    Syntax,
    /// Well formed, but outside what this crate reads.
    Unsupported,
    /// Well formed, but meaningless: a number out of range, an index to nothing.
    Invalid,
    /// An option or a technique's specification.
    Usage,
    /// A run was interrupted by the user.
    Interrupted,
    /// No graphics processor, one that lacks something, or one that failed.
    Gpu,
}

/// A position inside a file.
#[derive(Clone, Debug)]
enum Place {
    Line { line: u32, column: u32 },
    Json(String),
}

impl Error {
    pub(crate) fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        let inner = Inner { kind, message: message.into(), path: None, place: None, source: None };
        Self { inner: Box::new(inner) }
    }

    /// A value out of its range, an index to nothing.
    pub(crate) fn invalid(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Invalid, message)
    }

    /// A wrong option or specification.
    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Usage, message)
    }

    /// The file that the error is about, if it is about one.
    #[must_use]
    pub fn path(&self) -> Option<&Path> {
        self.inner.path.as_deref()
    }

    /// The line, from 1, in a text file.
    #[must_use]
    pub fn line(&self) -> Option<u32> {
        match self.inner.place {
            Some(Place::Line { line, .. }) => Some(line),
            _ => None,
        }
    }

    /// Whether the operating system refused a read or a write.
    #[must_use]
    pub fn is_io(&self) -> bool {
        self.inner.kind == ErrorKind::Io
    }

    /// Whether the bytes were not what they claimed to be.
    #[must_use]
    pub fn is_syntax(&self) -> bool {
        self.inner.kind == ErrorKind::Syntax
    }

    /// Whether the input is well formed but outside what this crate reads.
    #[must_use]
    pub fn is_unsupported(&self) -> bool {
        self.inner.kind == ErrorKind::Unsupported
    }

    /// Whether a value was out of range or an index pointed to nothing.
    #[must_use]
    pub fn is_invalid(&self) -> bool {
        self.inner.kind == ErrorKind::Invalid
    }

    /// Whether an option or a technique's specification was wrong.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        self.inner.kind == ErrorKind::Usage
    }

    /// A graphics processor that is not there, lacks something or failed.
    #[cfg(feature = "gpu")]
    pub(crate) fn gpu(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Gpu, message)
    }

    /// Whether there was no graphics processor, or one that lacks something or failed; the CPU can
    /// run the same.
    #[must_use]
    pub fn is_gpu(&self) -> bool {
        self.inner.kind == ErrorKind::Gpu
    }

    /// Whether the user stopped the run.
    #[must_use]
    pub fn is_interrupted(&self) -> bool {
        self.inner.kind == ErrorKind::Interrupted
    }
}

/// What only the readers and writers of files say.
#[cfg_attr(
    not(any(feature = "load", test)),
    expect(dead_code, reason = "only what reads and writes files makes these")
)]
impl Error {
    /// Something well formed that this crate does not read.
    pub(crate) fn unsupported(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Unsupported, message)
    }

    /// Bytes that are not what they claim to be.
    pub(crate) fn syntax(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Syntax, message)
    }

    /// A failed read or write of `path`.
    pub(crate) fn io(path: impl AsRef<Path>, error: std::io::Error) -> Self {
        let message = match error.kind() {
            std::io::ErrorKind::NotFound => "no such file".to_string(),
            _ => error.to_string(),
        };
        Self::new(ErrorKind::Io, message).with_path(path).with_source(error)
    }

    /// Adds the file, unless an inner call already named one.
    #[must_use]
    pub(crate) fn with_path(mut self, path: impl AsRef<Path>) -> Self {
        self.inner.path.get_or_insert_with(|| path.as_ref().to_path_buf());
        self
    }

    /// Adds line and column (both from 1), unless an inner call already did.
    #[must_use]
    pub(crate) fn at_line(mut self, line: u32, column: u32) -> Self {
        self.inner.place.get_or_insert(Place::Line { line, column });
        self
    }

    /// Adds a JSON path such as `materials[3].pbrMetallicRoughness`, unless an inner call already
    /// did.
    #[must_use]
    pub(crate) fn at_json(mut self, path: impl Into<String>) -> Self {
        self.inner.place.get_or_insert_with(|| Place::Json(path.into()));
        self
    }

    /// Keeps the error that caused this one.
    #[must_use]
    pub(crate) fn with_source(
        mut self,
        source: impl Into<Box<dyn std::error::Error + Send + Sync>>,
    ) -> Self {
        self.inner.source = Some(source.into());
        self
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(path) = &self.inner.path {
            write!(f, "{}", path.display())?;
            match &self.inner.place {
                Some(Place::Line { line, column }) => write!(f, ":{line}:{column}: ")?,
                Some(Place::Json(json)) => write!(f, ": {json}: ")?,
                None => write!(f, ": ")?,
            }
        } else {
            match &self.inner.place {
                Some(Place::Line { line, column }) => write!(f, "line {line}, column {column}: ")?,
                Some(Place::Json(json)) => write!(f, "{json}: ")?,
                None => {}
            }
        }
        f.write_str(&self.inner.message)
    }
}

impl fmt::Debug for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: {self}", self.inner.kind)
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        self.inner.source.as_deref().map(|e| e as &(dyn std::error::Error + 'static))
    }
}

/// The entry of `known` nearest to `given`, then all of them: the tail of every "unknown name"
/// message.
pub(crate) fn suggest(given: &str, known: &[&str]) -> String {
    let mut by_distance: Vec<&str> = known.to_vec();
    by_distance.sort_by_key(|name| strsim::damerau_levenshtein(given, name));
    format!("known: {}", by_distance.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn message_names_file_line_and_column() {
        let error = Error::syntax("found `]`, expected a number").at_line(3, 7).with_path("a.pbrt");
        assert_eq!(error.to_string(), "a.pbrt:3:7: found `]`, expected a number");
        assert!(error.is_syntax() && !error.is_io());
    }

    #[test]
    fn inner_place_wins() {
        let error =
            Error::invalid("x").at_line(3, 7).at_line(9, 9).with_path("inner").with_path("outer");
        assert_eq!(error.to_string(), "inner:3:7: x");
    }

    #[test]
    fn nearest_name_comes_first() {
        assert_eq!(suggest("ne", &["bsdf", "nee"]), "known: nee, bsdf");
    }
}
