//! The `.hplt` file: named arrays, each with a checksum.
//!
//! All numbers are little endian.
//!
//! ```text
//! header   8 bytes  89 48 50 4c 54 0d 0a 1a   ("\x89HPLT\r\n\x1a")
//!          u32      version, 1
//!          u32      number of sections
//!          u32      CRC-32 of the 16 bytes before
//! section  u32      kind: 0 text (UTF-8, lines "key\tvalue"), 1 f32, 2 u32
//!          u32      bytes of the name
//!          u64      bytes of the data
//!          u32      CRC-32 of the 16 bytes before
//!          …        name (UTF-8)
//!          …        data
//!          u32      CRC-32 of name and data
//! ```
//!
//! The first section is the metadata, with kind 0 and an empty name. The file ends with the last section.

use std::io::{BufReader, BufWriter, Read, Write};
use std::path::Path;

use bytemuck::Pod;

use crate::files::open_regular;
use crate::{Error, Limits, write_atomically};

const MAGIC: [u8; 8] = *b"\x89HPLT\r\n\x1a";
const VERSION: u32 = 1;
const MAX_SECTIONS: u32 = 65_536;
const MAX_NAME: u32 = 4096;
/// Bytes that are read at a time.
const PIECE: usize = 1 << 18;

/// The content of a solution file.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SolutionFile {
    /// Keys and values; neither holds a line break, keys hold no tab.
    pub metadata: Vec<(String, String)>,
    /// The arrays.
    pub sections: Vec<Section>,
}

/// One named array.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// The name.
    pub name: String,
    /// The numbers.
    pub data: SectionData,
}

/// The numbers of a section.
#[derive(Debug, Clone, PartialEq)]
pub enum SectionData {
    /// Floating point.
    F32(Vec<f32>),
    /// Unsigned integers.
    U32(Vec<u32>),
}

impl SolutionFile {
    /// The value of a key.
    pub fn value(&self, key: &str) -> Option<&str> {
        self.metadata.iter().find(|(k, _)| k == key).map(|(_, v)| &v[..])
    }

    /// The numbers of a section of floating point.
    ///
    /// # Errors
    /// When there is no such section.
    pub fn floats(&self, name: &str) -> Result<&[f32], Error> {
        match self.section(name)? {
            SectionData::F32(data) => Ok(data),
            SectionData::U32(_) => Err(Error::invalid(place(name), "SOLUTION_SECTION", "holds u32; expected f32")),
        }
    }

    /// The numbers of a section of unsigned integers.
    ///
    /// # Errors
    /// When there is no such section.
    pub fn integers(&self, name: &str) -> Result<&[u32], Error> {
        match self.section(name)? {
            SectionData::U32(data) => Ok(data),
            SectionData::F32(_) => Err(Error::invalid(place(name), "SOLUTION_SECTION", "holds f32; expected u32")),
        }
    }

    fn section(&self, name: &str) -> Result<&SectionData, Error> {
        let found = self.sections.iter().find(|s| s.name == name).map(|s| &s.data);
        found.ok_or_else(|| Error::invalid(place(name), "SOLUTION_SECTION", "is missing"))
    }
}

/// Writes a solution file, atomically.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written, or a key or value cannot be represented.
pub fn write_solution(path: &Path, solution: &SolutionFile) -> Result<(), Error> {
    write_atomically(path, |file| {
        let mut writer = BufWriter::new(file);
        write_all(&mut writer, solution)?;
        writer.flush()
    })
}

/// Reads a solution file. Nothing is allocated for a section before the file is known to be long enough.
///
/// # Errors
/// When the file cannot be read or differs in a single bit from what was written.
pub fn read_solution(path: &Path, limits: &Limits) -> Result<SolutionFile, Error> {
    let (file, length) = open_regular(path, limits.total_bytes)?;
    let mut reader = SectionReader { reader: BufReader::new(file), left: length };
    reader.read_file().map_err(|e| e.in_file(path))
}

fn write_all(writer: &mut impl Write, solution: &SolutionFile) -> std::io::Result<()> {
    let n_sections = solution.sections.len() + 1;
    if n_sections > MAX_SECTIONS as usize {
        return Err(std::io::Error::other("too many sections"));
    }
    let mut header = MAGIC.to_vec();
    header.extend(VERSION.to_le_bytes());
    header.extend((n_sections as u32).to_le_bytes());
    header.extend(crc32(&[&header]).to_le_bytes());
    writer.write_all(&header)?;
    let mut text = String::new();
    for (key, value) in &solution.metadata {
        if key.contains(['\t', '\n']) || value.contains('\n') {
            return Err(std::io::Error::other(format!("metadata {key:?} holds a separator")));
        }
        text += &format!("{key}\t{value}\n");
    }
    write_section(writer, 0, "", text.as_bytes())?;
    for Section { name, data } in &solution.sections {
        let (kind, words): (u32, &[u32]) = match data {
            SectionData::F32(v) => (1, bytemuck::cast_slice(v)),
            SectionData::U32(v) => (2, v),
        };
        let words: Vec<u32> = words.iter().map(|word| word.to_le()).collect();
        write_section(writer, kind, name, bytemuck::cast_slice(&words))?;
    }
    Ok(())
}

fn write_section(writer: &mut impl Write, kind: u32, name: &str, data: &[u8]) -> std::io::Result<()> {
    if name.len() > MAX_NAME as usize {
        return Err(std::io::Error::other("the name of a section is too long"));
    }
    let mut head = kind.to_le_bytes().to_vec();
    head.extend((name.len() as u32).to_le_bytes());
    head.extend((data.len() as u64).to_le_bytes());
    head.extend(crc32(&[&head]).to_le_bytes());
    writer.write_all(&head)?;
    writer.write_all(name.as_bytes())?;
    writer.write_all(data)?;
    writer.write_all(&crc32(&[name.as_bytes(), data]).to_le_bytes())
}

struct SectionReader<R> {
    reader: R,
    /// Bytes of the file that are not read yet.
    left: u64,
}

impl<R: Read> SectionReader<R> {
    fn read_file(&mut self) -> Result<SolutionFile, Error> {
        let header: Vec<u8> = self.read(20, "header")?;
        if header[..8] != MAGIC {
            return Err(Error::invalid("header", "SOLUTION_MAGIC", "is not a solution file"));
        }
        check_crc("header", &[&header[..16]], &header[16..])?;
        let version = u32_at(&header, 8);
        if version != VERSION {
            let message = format!("{version}; expected {VERSION}; solve again with this version");
            return Err(Error::invalid("header, version", "SOLUTION_VERSION", message));
        }
        let n_sections = u32_at(&header, 12);
        if !(1..=MAX_SECTIONS).contains(&n_sections) {
            let message = format!("{n_sections}; expected 1 to {MAX_SECTIONS}");
            return Err(Error::invalid("header, sections", "SOLUTION_CORRUPT", message));
        }
        let mut solution = SolutionFile::default();
        for i in 0..n_sections {
            let place = format!("section {i}");
            let (kind, name, length) = self.section_head(&place)?;
            match (i, kind) {
                (0, 0) => solution.metadata = metadata(&place, self.data(&place, &name, length)?)?,
                (1.., 1) => {
                    let data = SectionData::F32(self.words(&place, &name, length)?);
                    solution.sections.push(Section { name, data });
                }
                (1.., 2) => {
                    let data = SectionData::U32(self.words(&place, &name, length)?);
                    solution.sections.push(Section { name, data });
                }
                _ => {
                    return Err(Error::invalid(place, "SOLUTION_CORRUPT", format!("kind {kind} does not belong here")));
                }
            }
        }
        if self.left != 0 {
            return Err(Error::invalid("end", "SOLUTION_CORRUPT", format!("{} more bytes", self.left)));
        }
        Ok(solution)
    }

    /// Kind, name and bytes of the data.
    fn section_head(&mut self, place: &str) -> Result<(u32, String, u64), Error> {
        let head: Vec<u8> = self.read(20, place)?;
        check_crc(place, &[&head[..16]], &head[16..])?;
        let name_length = u32_at(&head, 4);
        if name_length > MAX_NAME {
            return Err(Error::invalid(place, "SOLUTION_CORRUPT", "the name is too long"));
        }
        let name = self.read(name_length.into(), place)?;
        let name =
            String::from_utf8(name).map_err(|_| Error::invalid(place, "SOLUTION_CORRUPT", "the name is not UTF-8"))?;
        Ok((u32_at(&head, 0), name, u64::from(u32_at(&head, 8)) | u64::from(u32_at(&head, 12)) << 32))
    }

    /// Data of `length` bytes, checked.
    fn data<T: Pod>(&mut self, place: &str, name: &str, length: u64) -> Result<Vec<T>, Error> {
        let mut data = self.room(length, place)?;
        let mut hasher = crc32fast::Hasher::new();
        hasher.update(name.as_bytes());
        // A piece is summed while it is in the cache.
        for piece in bytemuck::cast_slice_mut(&mut data).chunks_mut(PIECE) {
            self.reader.read_exact(piece).map_err(|_| self.truncated(length, place))?;
            hasher.update(piece);
        }
        self.left -= length;
        let crc: Vec<u8> = self.read(4, place)?;
        check_sum(place, hasher.finalize(), &crc)?;
        Ok(data)
    }

    /// Data of four bytes each.
    fn words<T: Pod>(&mut self, place: &str, name: &str, length: u64) -> Result<Vec<T>, Error> {
        if !length.is_multiple_of(4) {
            return Err(Error::invalid(place, "SOLUTION_CORRUPT", "its length is not a multiple of 4"));
        }
        let mut data = self.data(place, name, length)?;
        for word in bytemuck::cast_slice_mut::<T, u32>(&mut data) {
            *word = u32::from_le(*word);
        }
        Ok(data)
    }

    /// The next `n` bytes.
    fn read<T: Pod>(&mut self, n: u64, place: &str) -> Result<Vec<T>, Error> {
        let mut data = self.room(n, place)?;
        self.reader.read_exact(bytemuck::cast_slice_mut(&mut data)).map_err(|_| self.truncated(n, place))?;
        self.left -= n;
        Ok(data)
    }

    /// Zeros for the next `n` bytes, if the file has as many.
    fn room<T: Pod>(&self, n: u64, place: &str) -> Result<Vec<T>, Error> {
        if n > self.left {
            return Err(self.truncated(n, place));
        }
        let length = usize::try_from(n).map_err(|_| self.truncated(n, place))? / size_of::<T>();
        // Zeros that the system has ready, not written ones.
        bytemuck::allocation::try_zeroed_vec(length).map_err(|()| Error::limit(place, "LIMIT_MEMORY", "bytes", n, 0))
    }

    fn truncated(&self, n: u64, place: &str) -> Error {
        Error::invalid(place, "SOLUTION_TRUNCATED", format!("needs {n} bytes; the file has {} more", self.left))
    }
}

fn place(name: &str) -> String {
    format!("section \"{}\"", crate::sanitized(name))
}

fn check_crc(place: &str, parts: &[&[u8]], expected: &[u8]) -> Result<(), Error> {
    check_sum(place, crc32(parts), expected)
}

fn check_sum(place: &str, found: u32, expected: &[u8]) -> Result<(), Error> {
    let expected = u32_at(expected, 0);
    if found == expected {
        return Ok(());
    }
    let message = format!("checksum {found:08x}; the file says {expected:08x}");
    Err(Error::invalid(place, "SOLUTION_CORRUPT", message))
}

fn metadata(place: &str, data: Vec<u8>) -> Result<Vec<(String, String)>, Error> {
    let bad = || Error::invalid(place, "SOLUTION_CORRUPT", "is not a list of keys and values");
    let text = String::from_utf8(data).map_err(|_| bad())?;
    let lines = text.split_terminator('\n');
    lines.map(|l| l.split_once('\t').map(|(k, v)| (k.to_owned(), v.to_owned())).ok_or_else(bad)).collect()
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

/// CRC-32 (IEEE 802.3, as in PNG and zip) of the parts one after another.
fn crc32(parts: &[&[u8]]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    parts.iter().for_each(|part| hasher.update(part));
    hasher.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> SolutionFile {
        SolutionFile {
            metadata: vec![("hplt.seed".into(), "7".into()), ("scene".into(), "a\tb ü".into())],
            sections: vec![
                Section { name: "level 0".into(), data: SectionData::F32(vec![1.5, -0.0, f32::INFINITY, 1e-40]) },
                Section { name: "parents".into(), data: SectionData::U32(vec![0, u32::MAX, 3]) },
                Section { name: "empty".into(), data: SectionData::F32(vec![]) },
            ],
        }
    }

    fn encoded() -> Vec<u8> {
        let mut bytes = Vec::new();
        write_all(&mut bytes, &example()).unwrap();
        bytes
    }

    fn decoded(bytes: &[u8]) -> Result<SolutionFile, Error> {
        SectionReader { reader: bytes, left: bytes.len() as u64 }.read_file()
    }

    #[test]
    fn the_checksum_is_the_usual_one() {
        assert_eq!(crc32(&[b"123456789"]), 0xcbf4_3926);
        let text = b"The quick brown fox jumps over the lazy dog";
        assert_eq!(crc32(&[text]), 0x414f_a339);
        assert_eq!(crc32(&[&text[..13], &text[13..]]), 0x414f_a339);
    }

    #[test]
    fn a_solution_returns() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.hplt");
        write_solution(&path, &example()).unwrap();
        let read = read_solution(&path, &Limits::default()).unwrap();
        assert_eq!(read, example());
        assert_eq!(read.value("hplt.seed"), Some("7"));
        assert_eq!(read.integers("parents").unwrap(), [0, u32::MAX, 3]);
        assert_eq!(read.floats("parents").unwrap_err().code(), "SOLUTION_SECTION");
        assert_eq!(read.floats("none").unwrap_err().exit_code(), 9);
    }

    #[test]
    fn every_truncation_and_every_flipped_bit_is_noticed() {
        let bytes = encoded();
        for n in 0..bytes.len() {
            let error = decoded(&bytes[..n]).unwrap_err();
            assert_eq!(error.code(), "SOLUTION_TRUNCATED", "{n}: {error}");
        }
        for bit in 0..bytes.len() * 8 {
            let mut damaged = bytes.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let error = decoded(&damaged).unwrap_err();
            assert!(error.code().starts_with("SOLUTION_"), "{bit}: {error}");
        }
        let longer = [&bytes[..], &[0]].concat();
        assert_eq!(decoded(&longer).unwrap_err().code(), "SOLUTION_CORRUPT");
    }

    #[test]
    fn lying_lengths_with_right_checksums_are_refused_without_allocating() {
        for length in [1u64 << 63, u64::MAX, 1 << 40, 1000] {
            let mut bytes = encoded();
            bytes[28..36].copy_from_slice(&length.to_le_bytes());
            let crc = crc32(&[&bytes[20..36]]);
            bytes[36..40].copy_from_slice(&crc.to_le_bytes());
            assert_eq!(decoded(&bytes).unwrap_err().code(), "SOLUTION_TRUNCATED");
        }
        let mut bytes = encoded();
        bytes[8..12].copy_from_slice(&2u32.to_le_bytes());
        let crc = crc32(&[&bytes[..16]]);
        bytes[16..20].copy_from_slice(&crc.to_le_bytes());
        assert_eq!(decoded(&bytes).unwrap_err().code(), "SOLUTION_VERSION");
    }

    #[test]
    fn metadata_that_would_not_return_is_refused() {
        for (key, value) in [("a\tb", ""), ("a\nb", ""), ("a", "b\nc")] {
            let solution = SolutionFile { metadata: vec![(key.into(), value.into())], ..SolutionFile::default() };
            assert!(write_all(&mut Vec::new(), &solution).is_err());
        }
    }
}
