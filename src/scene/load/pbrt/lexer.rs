//! pbrt text to tokens, each with its line and column (both from 1; columns count characters).

use crate::error::{Error, Result};

/// A token and where it starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Token<'a> {
    pub(super) kind: Kind<'a>,
    pub(super) line: u32,
    pub(super) column: u32,
}

/// What a [`Token`] is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind<'a> {
    /// A directive, a number, `true` or `false`.
    Word(&'a str),
    /// The text between two quotation marks, escapes not yet replaced.
    Quoted(&'a str),
    /// `[`
    Open,
    /// `]`
    Close,
    /// The end of the file.
    End,
}

impl Kind<'_> {
    /// For messages.
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Word(text) => format!("`{}`", shorten(text)),
            Self::Quoted(text) => format!("\"{}\"", shorten(text)),
            Self::Open => "`[`".to_string(),
            Self::Close => "`]`".to_string(),
            Self::End => "the end of the file".to_string(),
        }
    }
}

/// At most 60 characters, so that no message repeats a whole binary file.
pub(super) fn shorten(text: &str) -> String {
    let mut chars = text.chars();
    let mut short: String = chars.by_ref().take(60).flat_map(char::escape_debug).collect();
    if chars.next().is_some() {
        short.push('…');
    }
    short
}

/// Reads tokens one after another.
#[derive(Clone, Debug)]
pub(super) struct Lexer<'a> {
    text: &'a str,
    at: usize,
    line: u32,
    column: u32,
}

impl<'a> Lexer<'a> {
    /// # Errors
    /// The bytes are not UTF-8.
    pub(super) fn new(bytes: &'a [u8]) -> Result<Self> {
        let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(Self { text, at: 0, line: 1, column: 1 }),
            Err(error) => {
                let good = String::from_utf8_lossy(&bytes[..error.valid_up_to()]);
                let line = good.matches('\n').count() + 1;
                let column = good.rsplit('\n').next().unwrap_or("").chars().count() + 1;
                let byte = bytes[error.valid_up_to()];
                let message = format!("found the byte {byte:#04x}; allowed: UTF-8 text");
                Err(Error::syntax(message).at_line(line as u32, column as u32))
            }
        }
    }

    fn peek(&self) -> Option<u8> {
        self.text.as_bytes().get(self.at).copied()
    }

    fn step(&mut self) {
        if let Some(byte) = self.peek() {
            self.at += 1;
            if byte == b'\n' {
                self.line += 1;
                self.column = 1;
            } else if byte & 0xc0 != 0x80 {
                // Continuation bytes of UTF-8 are no characters.
                self.column += 1;
            }
        }
    }

    /// The next token; [`Kind::End`] for ever at the end.
    ///
    /// # Errors
    /// A quotation mark without its partner on the same line.
    pub(super) fn next(&mut self) -> Result<Token<'a>> {
        loop {
            match self.peek() {
                Some(b'#') => {
                    while !matches!(self.peek(), None | Some(b'\n')) {
                        self.step();
                    }
                }
                Some(byte) if byte.is_ascii_whitespace() || byte == 0x0b => self.step(),
                _ => break,
            }
        }
        let (line, column) = (self.line, self.column);
        let kind = match self.peek() {
            None => Kind::End,
            Some(b'[') => {
                self.step();
                Kind::Open
            }
            Some(b']') => {
                self.step();
                Kind::Close
            }
            Some(b'"') => {
                self.step();
                let start = self.at;
                loop {
                    match self.peek() {
                        None | Some(b'\n') => {
                            let message =
                                "found a `\"` without a second one on its line; allowed: \"text\"";
                            return Err(Error::syntax(message).at_line(line, column));
                        }
                        Some(b'"') => break,
                        Some(b'\\') => {
                            self.step();
                            if self.peek() != Some(b'\n') {
                                self.step();
                            }
                        }
                        Some(_) => self.step(),
                    }
                }
                let text = &self.text[start..self.at];
                self.step();
                Kind::Quoted(text)
            }
            Some(_) => {
                let start = self.at;
                while !matches!(self.peek(), None | Some(b'[' | b']' | b'"' | b'#'))
                    && !self.peek().is_some_and(|b| b.is_ascii_whitespace() || b == 0x0b)
                {
                    self.step();
                }
                Kind::Word(&self.text[start..self.at])
            }
        };
        Ok(Token { kind, line, column })
    }
}

/// A quoted text with its escapes (`\"`, `\\`, `\n`, `\t`, …) replaced.
pub(super) fn unescape(text: &str) -> String {
    if !text.contains('\\') {
        return text.to_string();
    }
    let mut out = String::with_capacity(text.len());
    let mut chars = text.chars();
    while let Some(c) = chars.next() {
        match c {
            '\\' => match chars.next() {
                Some('n') => out.push('\n'),
                Some('r') => out.push('\r'),
                Some('t') => out.push('\t'),
                Some(other) => out.push(other),
                None => {}
            },
            c => out.push(c),
        }
    }
    out
}

/// A finite number in decimal notation: `1`, `+1`, `-.5`, `1.`, `1e-3`; `None` for anything else.
pub(super) fn number(word: &str) -> Option<f64> {
    let numeric = word.bytes().all(|b| b.is_ascii_digit() || b"+-.eE".contains(&b));
    let value = if numeric { word.parse::<f64>().ok()? } else { return None };
    // What pbrt stores is single precision.
    (value as f32).is_finite().then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn kinds(text: &str) -> Vec<Kind<'_>> {
        let mut lexer = Lexer::new(text.as_bytes()).unwrap();
        let mut list = Vec::new();
        loop {
            match lexer.next().unwrap().kind {
                Kind::End => return list,
                kind => list.push(kind),
            }
        }
    }

    #[test]
    fn tokens_need_no_white_space_between_them() {
        use Kind::{Close, Open, Quoted, Word};
        assert_eq!(
            kinds("Shape\"a b\"[1 .5]# x ] \n\"#\"[]"),
            [
                Word("Shape"),
                Quoted("a b"),
                Open,
                Word("1"),
                Word(".5"),
                Close,
                Quoted("#"),
                Open,
                Close
            ]
        );
    }

    #[test]
    fn positions_count_characters_and_lines() {
        let mut lexer = Lexer::new("# é\n  \"é\" [\r\n\tx".as_bytes()).unwrap();
        let places: Vec<_> =
            (0..4).map(|_| lexer.next().unwrap()).map(|t| (t.line, t.column)).collect();
        assert_eq!(places, [(2, 3), (2, 7), (3, 2), (3, 3)]);
    }

    #[test]
    fn numbers() {
        for (word, value) in
            [("1", 1.0), ("+1", 1.0), ("-.5", -0.5), ("2.", 2.0), ("1e-3", 1e-3), ("-0", 0.0)]
        {
            assert_eq!(number(word), Some(value), "{word}");
        }
        for word in ["", "-", ".", "e5", "nan", "inf", "0x10", "1e39", "1e999", "1f", "1,2", "true"]
        {
            assert_eq!(number(word), None, "{word}");
        }
    }

    #[test]
    fn escapes() {
        assert_eq!(unescape(r#"a\"b\\c\n"#), "a\"b\\c\n");
        assert_eq!(kinds(r#""a\"b" c"#), [Kind::Quoted(r#"a\"b"#), Kind::Word("c")]);
    }

    #[test]
    fn bad_text_is_refused_at_its_place() {
        let error = Lexer::new(b"ab\nc\xff").unwrap_err();
        assert_eq!(error.to_string(), "line 2, column 2: found the byte 0xff; allowed: UTF-8 text");
        let mut lexer = Lexer::new(b"  \"abc\n\"").unwrap();
        let error = lexer.next().unwrap_err().to_string();
        assert!(error.starts_with("line 1, column 3: found a `\"` without"), "{error}");
    }
}
