use std::fs::File;
use std::io::{Error as IoError, ErrorKind};
use std::path::Path;

use crate::Error;

/// Writes a file that either appears complete under its name or not at all; what was there before stays until then.
///
/// The content goes to a temporary file in the same folder, is flushed to the disk and renamed.
///
/// # Errors
/// [`Error::Write`] when the folder cannot be written, the target is not a regular file, or `content` fails.
pub fn write_atomically(
    path: &Path,
    content: impl FnOnce(&mut File) -> Result<(), std::io::Error>,
) -> Result<(), Error> {
    replace(path, content).map_err(|source| Error::write(path, source))
}

fn replace(path: &Path, content: impl FnOnce(&mut File) -> Result<(), IoError>) -> Result<(), IoError> {
    if std::fs::symlink_metadata(path).is_ok() && !std::fs::metadata(path)?.is_file() {
        return Err(IoError::new(ErrorKind::InvalidInput, "it exists and is not a regular file"));
    }
    let name = path.file_name().ok_or_else(|| IoError::new(ErrorKind::InvalidInput, "it has no file name"))?;
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(name.to_string_lossy().chars().take(60).collect::<String>());
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(".partial");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut temporary = builder.tempfile_in(folder)?;
    content(temporary.as_file_mut())?;
    temporary.as_file().sync_all()?;
    temporary.persist(path).map_err(|e| e.error)?;
    #[cfg(unix)]
    File::open(folder)?.sync_all()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn a_failed_write_keeps_the_old_file_and_leaves_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.txt");
        write_atomically(&path, |f| f.write_all(b"old")).unwrap();
        let error = write_atomically(&path, |f| {
            f.write_all(b"new")?;
            Err(IoError::other("disk full"))
        })
        .unwrap_err();
        assert_eq!((error.code(), error.exit_code()), ("OUTPUT_IO", 8));
        assert_eq!(std::fs::read(&path).unwrap(), b"old");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        write_atomically(&path, |f| f.write_all(b"new")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"new");
    }

    #[test]
    fn folders_and_missing_folders_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write_atomically(folder.path(), |_| Ok(())).is_err());
        assert!(write_atomically(&folder.path().join("none/out"), |_| Ok(())).is_err());
    }
}
