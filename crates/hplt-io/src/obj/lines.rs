use std::cell::RefCell;
use std::io::{BufRead, Error as IoError, Read};

use crate::{Error, LoadOptions};

/// Bytes that a face takes on the way to a scene.
const BYTES_PER_CORNER: u64 = 160;

/// Hands the lines of an OBJ file on to a parser, each checked first, so that errors can name the line and the parser
/// meets neither endless lines nor numbers that mean nothing.
pub(super) struct CheckedLines<'a, R> {
    inner: R,
    options: &'a LoadOptions,
    /// What the parser gets of the current line, and how much of it was taken.
    line: Vec<u8>,
    taken: usize,
    state: &'a RefCell<State>,
}

/// What was found on the way.
#[derive(Debug, Default)]
pub(super) struct State {
    /// The first problem.
    pub(super) error: Option<Error>,
    pub(super) number: u64,
    /// Positions, texture coordinates and normals so far.
    counts: [i64; 3],
    /// The largest index into each, and its line.
    largest: [(i64, u64); 3],
    corners: u64,
    pub(super) n_lines_and_points: u64,
    pub(super) n_polygons: u64,
}

impl<'a, R: BufRead> CheckedLines<'a, R> {
    pub(super) fn new(inner: R, options: &'a LoadOptions, state: &'a RefCell<State>) -> Self {
        Self { inner, options, line: Vec::new(), taken: 0, state }
    }

    /// The next line, with the continuation lines that a backslash asks for; false at the end.
    fn advance(&mut self) -> Result<bool, Error> {
        let limit = self.options.limits.line_bytes;
        let mut raw = Vec::new();
        loop {
            let left = limit + 1 - raw.len() as u64;
            let read = (&mut self.inner).take(left).read_until(b'\n', &mut raw);
            let read = read.map_err(|e| Error::invalid("", "FILE_UNREADABLE", e.to_string()))?;
            if read > 0 {
                self.state.borrow_mut().number += 1;
            }
            if raw.len() as u64 > limit {
                return Err(Error::limit(self.place(), "LIMIT_LINE", "bytes", raw.len() as u64, limit));
            }
            if raw.is_empty() {
                return Ok(false);
            }
            let end = raw.trim_ascii_end().len();
            if read == 0 || end == 0 || raw[end - 1] != b'\\' {
                break;
            }
            raw.truncate(end - 1);
            raw.push(b' ');
        }
        let text = String::from_utf8_lossy(&raw);
        self.line = self.checked(text.trim())?.into_bytes();
        self.line.push(b'\n');
        self.taken = 0;
        Ok(true)
    }

    fn place(&self) -> String {
        format!("line {}", self.state.borrow().number)
    }

    fn syntax(&self, message: String) -> Error {
        Error::invalid(self.place(), "OBJ_SYNTAX", message)
    }

    /// The line as the parser gets it.
    fn checked(&mut self, line: &str) -> Result<String, Error> {
        if line.starts_with('#') {
            return Ok(String::new());
        }
        if line.chars().any(|c| c.is_control() && c != '\t') {
            return Err(self.syntax("has control characters".into()));
        }
        let mut words = line.split_whitespace();
        let Some(keyword) = words.next() else { return Ok(String::new()) };
        let rest: Vec<&str> = words.collect();
        match keyword {
            "v" => {
                self.state.borrow_mut().counts[0] += 1;
                self.checked_position(&rest)
            }
            "vt" => {
                self.state.borrow_mut().counts[1] += 1;
                Ok(line.to_owned())
            }
            "vn" => {
                self.state.borrow_mut().counts[2] += 1;
                Ok(line.to_owned())
            }
            "f" => self.check_face(&rest).map(|()| line.to_owned()),
            "l" | "p" => {
                self.state.borrow_mut().n_lines_and_points += 1;
                Ok(String::new())
            }
            "mtllib" | "usemtl" | "o" | "g" => Ok(format!("{keyword} {}", line[keyword.len()..].trim())),
            _ => Ok(String::new()),
        }
    }

    /// Three coordinates and perhaps a weight; colours are dropped.
    fn checked_position(&self, words: &[&str]) -> Result<String, Error> {
        if words.len() < 3 {
            return Err(self.syntax(format!("{} coordinates; expected 3", words.len())));
        }
        let n = if words.len() == 4 { 4 } else { 3 };
        for (word, axis) in words[..n].iter().zip(["x", "y", "z", "w"]) {
            let value: f64 =
                word.parse().map_err(|_| self.syntax(format!("{axis} is \"{}\"", crate::sanitized(word))))?;
            if axis == "w" && value == 0.0 {
                return Err(self.syntax("w is 0".into()));
            }
            let usable = value.is_finite() && value.abs() <= 1e18;
            if !usable && !self.options.policy.drop_bad_triangles {
                let code = if value.is_finite() { "VALUE_NOT_IN_RANGE" } else { "VALUE_NOT_FINITE" };
                let message = format!("{axis} is {value}; expected a number within ±1e18");
                return Err(Error::invalid(self.place(), code, message));
            }
        }
        Ok(format!("v {}", words[..n].join(" ")))
    }

    fn check_face(&self, corners: &[&str]) -> Result<(), Error> {
        let mut state = self.state.borrow_mut();
        let place = format!("line {}", state.number);
        for corner in corners {
            for (kind, word) in corner.split('/').enumerate() {
                if word.is_empty() && kind > 0 {
                    continue;
                }
                let index = word.parse::<i64>().ok().filter(|_| kind < 3).ok_or_else(|| {
                    let message = format!("corner \"{}\"; expected v, v/t, v//n or v/t/n", crate::sanitized(corner));
                    Error::invalid(&place, "OBJ_SYNTAX", message)
                })?;
                let count = state.counts[kind];
                if index == 0 || index.checked_add(count).is_none_or(|i| i < 0) {
                    let message = format!("index {index}; there are {count} so far, counted from 1");
                    return Err(Error::invalid(&place, "OBJ_INDEX_OOB", message));
                }
                if index > state.largest[kind].0 {
                    state.largest[kind] = (index, state.number);
                }
            }
        }
        match corners.len() {
            0 => return Err(Error::invalid(&place, "OBJ_SYNTAX", "a face without corners")),
            1 | 2 => state.n_lines_and_points += 1,
            3 | 4 => {}
            _ => state.n_polygons += 1,
        }
        state.corners += corners.len() as u64;
        let limits = &self.options.limits;
        if state.corners > 3 * limits.triangles {
            let limit = 3 * limits.triangles;
            return Err(Error::limit(place, "LIMIT_TRIANGLES", "corners", state.corners, limit));
        }
        if state.corners * BYTES_PER_CORNER > limits.scene_bytes {
            let bytes = state.corners * BYTES_PER_CORNER;
            return Err(Error::limit(place, "LIMIT_MEMORY", "bytes of geometry", bytes, limits.scene_bytes));
        }
        Ok(())
    }
}

impl State {
    /// Whether every index of the file points at something.
    pub(super) fn check_indices(&self) -> Result<(), Error> {
        for ((&(index, line), count), what) in
            self.largest.iter().zip(self.counts).zip(["positions", "texture coordinates", "normals"])
        {
            if index > count {
                let message = format!("index {index}; there are {count} {what}");
                return Err(Error::invalid(format!("line {line}"), "OBJ_INDEX_OOB", message));
            }
        }
        Ok(())
    }
}

impl<R: BufRead> BufRead for CheckedLines<'_, R> {
    fn fill_buf(&mut self) -> std::io::Result<&[u8]> {
        if self.taken == self.line.len() {
            self.line.clear();
            self.taken = 0;
            if let Err(error) = self.advance() {
                self.state.borrow_mut().error.get_or_insert(error);
                return Err(IoError::other("refused"));
            }
        }
        Ok(&self.line[self.taken..])
    }

    fn consume(&mut self, n: usize) {
        self.taken = (self.taken + n).min(self.line.len());
    }
}

impl<R: BufRead> Read for CheckedLines<'_, R> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let line = self.fill_buf()?;
        let n = line.len().min(buffer.len());
        buffer[..n].copy_from_slice(&line[..n]);
        self.consume(n);
        Ok(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &[u8]) -> Result<String, Error> {
        let options = LoadOptions::default();
        let state = RefCell::new(State::default());
        let mut out = String::new();
        let result = CheckedLines::new(text, &options, &state).read_to_string(&mut out);
        let mut state = state.into_inner();
        match (state.error.take(), result) {
            (Some(error), _) => Err(error),
            (None, Ok(_)) => state.check_indices().map(|()| out),
            (None, Err(error)) => panic!("{error}"),
        }
    }

    #[test]
    fn lines_are_cleaned_and_joined() {
        let text = b"# caf\xe9\r\nv 1 2 3 0.1 0.2 0.3\r\nv 1 \\\n 2 3\nmtllib\t my lib.mtl \nv 1 1 1\nf 1 2 \\\n3";
        let cleaned = "\nv 1 2 3\nv 1 2 3\nmtllib my lib.mtl\nv 1 1 1\nf 1 2  3\n";
        assert_eq!(read(text).unwrap(), cleaned);
    }

    #[test]
    fn problems_name_their_line() {
        let long = [b"v ", &[b'1'; 2_000_000][..]].concat();
        for (text, code, line) in [
            (&b"v 1 2 nan"[..], "VALUE_NOT_FINITE", 1),
            (b"\nv 1 2 inf", "VALUE_NOT_FINITE", 2),
            (b"v 1 2 1e40", "VALUE_NOT_IN_RANGE", 1),
            (b"v 1 2", "OBJ_SYNTAX", 1),
            (b"v 1 2 3 0", "OBJ_SYNTAX", 1),
            (b"v 1 2 drei", "OBJ_SYNTAX", 1),
            (b"v 1 2 3\0", "OBJ_SYNTAX", 1),
            (b"v 1 2 3\nf 1 0 1", "OBJ_INDEX_OOB", 2),
            (b"v 1 2 3\nf 1 -2 1", "OBJ_INDEX_OOB", 2),
            (b"v 1 2 3\nf 1 1 9999999999\n\n", "OBJ_INDEX_OOB", 2),
            (b"v 1 2 3\nf 1 1 99999999999999999999", "OBJ_SYNTAX", 2),
            (b"v 1 2 3\nf 1/1 1/1 1/1", "OBJ_INDEX_OOB", 2),
            (b"v 1 2 3\nf 1//1 1 1", "OBJ_INDEX_OOB", 2),
            (b"v 1 2 3\nf 1/1/1/1 1 1", "OBJ_SYNTAX", 2),
            (b"f", "OBJ_SYNTAX", 1),
            (&long, "LIMIT_LINE", 1),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.code(), code, "{error}");
            assert!(error.to_string().starts_with(&format!("line {line}: ")), "{error}");
        }
    }
}
