//! Reading whole files: regular files only, and no more than was agreed.

use std::fs::File;
use std::io::{Read, Seek};
use std::path::Path;

use crate::Error;

/// Opens a regular file of at most `limit` bytes. Never blocks on a pipe or a device, since it does not open those.
pub(crate) fn open_regular(path: &Path, limit: u64) -> Result<(File, u64), Error> {
    let metadata = std::fs::metadata(path).map_err(|e| Error::read(path, e))?;
    refuse_irregular(&metadata).map_err(|e| e.in_file(path))?;
    let file = File::open(path).map_err(|e| Error::read(path, e))?;
    // The name may mean another file by now.
    let metadata = file.metadata().map_err(|e| Error::read(path, e))?;
    refuse_irregular(&metadata).map_err(|e| e.in_file(path))?;
    if metadata.len() > limit {
        return Err(Error::limit("", "LIMIT_FILE_SIZE", "bytes", metadata.len(), limit).in_file(path));
    }
    Ok((file, metadata.len()))
}

/// The bytes of a regular file of at most `limit` bytes, if `check` accepts its first 12 bytes and its length.
pub(crate) fn read_regular(
    path: &Path,
    limit: u64,
    check: impl FnOnce(&[u8], u64) -> Result<(), Error>,
) -> Result<Vec<u8>, Error> {
    let (mut file, length) = open_regular(path, limit)?;
    let mut head = Vec::new();
    (&mut file).take(12).read_to_end(&mut head).map_err(|e| Error::read(path, e))?;
    check(&head, length).map_err(|e| e.in_file(path))?;
    file.rewind().map_err(|e| Error::read(path, e))?;
    let mut bytes = Vec::new();
    let capacity = usize::try_from(length).unwrap_or(usize::MAX);
    if bytes.try_reserve_exact(capacity).is_err() {
        return Err(Error::limit("", "LIMIT_MEMORY", "bytes", length, 0).in_file(path));
    }
    file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(|e| Error::read(path, e))?;
    if bytes.len() as u64 > limit {
        return Err(Error::limit("", "LIMIT_FILE_SIZE", "bytes", bytes.len() as u64, limit).in_file(path));
    }
    Ok(bytes)
}

/// Accepts any file.
pub(crate) fn any_content(_: &[u8], _: u64) -> Result<(), Error> {
    Ok(())
}

fn refuse_irregular(metadata: &std::fs::Metadata) -> Result<(), Error> {
    if metadata.is_file() {
        return Ok(());
    }
    let what = if metadata.is_dir() { "a folder" } else { "a pipe, socket or device" };
    Err(Error::invalid("", "FILE_NOT_REGULAR", format!("is {what}; expected a regular file")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_large_and_missing_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read_regular(folder.path(), 100, any_content).unwrap_err().code(), "FILE_NOT_REGULAR");
        assert_eq!(read_regular(&folder.path().join("none"), 100, any_content).unwrap_err().code(), "FILE_UNREADABLE");
        let path = folder.path().join("file");
        std::fs::write(&path, [7; 101]).unwrap();
        assert_eq!(read_regular(&path, 100, any_content).unwrap_err().code(), "LIMIT_FILE_SIZE");
        assert_eq!(read_regular(&path, 101, any_content).unwrap().len(), 101);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn devices_are_refused_without_reading() {
        assert_eq!(read_regular(Path::new("/dev/zero"), 100, any_content).unwrap_err().code(), "FILE_NOT_REGULAR");
    }
}
