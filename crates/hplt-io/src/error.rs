use std::path::Path;

use hplt_geom::Error as SceneError;

/// What can go wrong with a file. The text is one line: `file: place: what, value, limit; hint`.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The content of a file cannot be used.
    #[error("{}{message}", prefix(.file, .place))]
    Invalid {
        /// The file; empty for values that came from no file.
        file: String,
        /// Where in the file, for instance `accessors[0].count`; empty for the file as a whole.
        place: String,
        /// Stable name of the problem; the code of the Khronos glTF validator where it has one.
        code: &'static str,
        /// What was found and what was expected.
        message: String,
    },
    /// Something is larger than the loader accepts.
    #[error("{}{value} {what} exceed the limit of {limit}", prefix(.file, .place))]
    Limit {
        /// The file.
        file: String,
        /// Where in the file.
        place: String,
        /// Stable name of the limit.
        code: &'static str,
        /// What is counted, in the plural.
        what: &'static str,
        /// The value found.
        value: u64,
        /// The limit.
        limit: u64,
    },
    /// A file cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// An output cannot be written; whatever was there before is unharmed.
    #[error("{file}: cannot be written: {source}")]
    Write {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// A fault of this crate.
    #[error("{file}: internal error in loader (please report): {message}")]
    Internal {
        /// The file.
        file: String,
        /// What the panic said.
        message: String,
    },
}

impl Error {
    /// The stable name of the problem, for instance `ACCESSOR_INDEX_OOB` or `LIMIT_IMAGE`.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Invalid { code, .. } | Self::Limit { code, .. } => code,
            Self::Read { .. } => "FILE_UNREADABLE",
            Self::Write { .. } => "OUTPUT_IO",
            Self::Internal { .. } => "INTERNAL",
        }
    }

    /// The exit code of a program that stops here: 3 invalid input, 4 over a limit, 8 output, 9 solution file.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Invalid { code, .. } if code.starts_with("SOLUTION_") => 9,
            Self::Invalid { .. } | Self::Read { .. } | Self::Internal { .. } => 3,
            Self::Limit { .. } => 4,
            Self::Write { .. } => 8,
        }
    }

    /// A problem at `place`; the file is filled in by [`Error::in_file`].
    pub(crate) fn invalid(place: impl Into<String>, code: &'static str, message: impl Into<String>) -> Self {
        Self::Invalid { file: String::new(), place: place.into(), code, message: message.into() }
    }

    /// A limit that is exceeded at `place`.
    pub(crate) fn limit(
        place: impl Into<String>,
        code: &'static str,
        what: &'static str,
        value: u64,
        limit: u64,
    ) -> Self {
        Self::Limit { file: String::new(), place: place.into(), code, what, value, limit }
    }

    pub(crate) fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { file: shown(path), source }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { file: shown(path), source }
    }

    /// The same error, naming `path` unless it names a file already.
    pub(crate) fn in_file(mut self, path: &Path) -> Self {
        let (Self::Invalid { file, .. }
        | Self::Limit { file, .. }
        | Self::Read { file, .. }
        | Self::Write { file, .. }
        | Self::Internal { file, .. }) = &mut self;
        if file.is_empty() {
            *file = shown(path);
        }
        self
    }

    /// The same error without its file, for files that a scene refers to.
    #[cfg(any(feature = "gltf", feature = "obj"))]
    pub(crate) fn forget_file(mut self) -> Self {
        if let Self::Invalid { file, .. } | Self::Limit { file, .. } = &mut self {
            file.clear();
        }
        self
    }

    /// The same error, with `outer` put before its place.
    #[cfg(any(feature = "gltf", feature = "obj"))]
    pub(crate) fn within(mut self, outer: &str) -> Self {
        if let Self::Invalid { place, .. } | Self::Limit { place, .. } = &mut self {
            *place = if place.is_empty() { outer.to_owned() } else { format!("{outer}, {place}") };
        }
        self
    }
}

impl From<SceneError> for Error {
    fn from(error: SceneError) -> Self {
        let message = error.to_string();
        let code = match error {
            SceneError::NotFinite { .. } => "VALUE_NOT_FINITE",
            SceneError::OutOfRange { .. } => "VALUE_NOT_IN_RANGE",
            SceneError::IndexOutOfRange { .. } => "INDEX_OOB",
            SceneError::LengthMismatch { .. } => "LENGTH_MISMATCH",
            SceneError::NoSurface => "NO_SURFACE",
            SceneError::Limit { place, value, limit } => {
                return Self::limit(sanitized(&place), "LIMIT_SCENE", "items", value, limit);
            }
            _ => "SCENE",
        };
        Self::invalid("", code, sanitized(&message))
    }
}

/// `name` as it can be shown on a terminal: control characters and line breaks escaped, at most 200 bytes or so.
pub fn sanitized(name: &str) -> String {
    const MAX: usize = 200;
    let mut out = String::with_capacity(name.len().min(MAX));
    for c in name.chars() {
        if out.len() >= MAX {
            out.push('…');
            break;
        }
        if is_harmless(c) { out.push(c) } else { out.extend(c.escape_default()) }
    }
    out
}

/// Not a control character, nor one that changes the direction or the lines of the text around it.
fn is_harmless(c: char) -> bool {
    !c.is_control()
        && !matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{feff}')
}

fn shown(path: &Path) -> String {
    sanitized(&path.to_string_lossy())
}

fn prefix(file: &str, place: &str) -> String {
    match (file.is_empty(), place.is_empty()) {
        (true, true) => String::new(),
        (true, false) => format!("{place}: "),
        (false, true) => format!("{file}: "),
        (false, false) => format!("{file}: {place}: "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_one_line_with_file_place_value_and_limit() {
        let error = Error::limit("images[7]", "LIMIT_IMAGE", "pixels across", 60_000, 16_384);
        let error = error.in_file(Path::new("a\nb.gltf"));
        assert_eq!(error.to_string(), "a\\nb.gltf: images[7]: 60000 pixels across exceed the limit of 16384");
        assert_eq!((error.code(), error.exit_code()), ("LIMIT_IMAGE", 4));
    }

    #[test]
    fn names_from_files_cannot_steer_a_terminal() {
        assert_eq!(sanitized("a\u{1b}[31m\u{202e}b"), "a\\u{1b}[31m\\u{202e}b");
        assert!(sanitized(&"x".repeat(1_000_000)).len() < 210);
        assert_eq!(sanitized("Säule"), "Säule");
    }
}
