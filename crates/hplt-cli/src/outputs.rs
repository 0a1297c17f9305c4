//! Where results go: which files may be replaced, and stdout.

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::path::Path;

use crate::exit::{Exit, Failure};

/// How much of an existing file is looked at.
const HEAD: u64 = 1 << 16;
/// What a file of ours says of itself near its beginning: PNG, EXR and GLB text, PLY comment, solution magic, CSV header.
const MARKS: [&[u8]; 5] = [b"hplt.version", b"made by hplt", b"\x89HPLT", b"x,y,z,nx,ny,nz\n", b"x,y,z,nx,ny,nz,Ed_r"];

/// Refuses, before anything is computed, outputs that would destroy something: inputs, files that hplt did not write (unless
/// `force`), and things that are no files; and outputs in folders that do not exist.
///
/// # Errors
/// With the first such output.
pub fn check_outputs(outputs: &[&Path], inputs: &[&Path], force: bool) -> Result<(), Failure> {
    for (i, output) in outputs.iter().enumerate() {
        let shown = hplt_io::sanitized(&output.to_string_lossy());
        let refuse = |what: &str| Failure::new(Exit::Output, "OUTPUT_REFUSED", format!("{shown}: {what}"));
        if outputs[..i].contains(output) {
            return Err(Failure::usage(format!("{shown}: given twice as an output")));
        }
        let folder = output.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
        if !folder.is_dir() {
            return Err(refuse("its folder does not exist; expected one that does"));
        }
        let Ok(metadata) = std::fs::metadata(output) else { continue };
        if !metadata.is_file() {
            return Err(refuse("exists and is not a regular file"));
        }
        if inputs.iter().any(|input| is_same_file(input, output)) {
            return Err(refuse("is an input of the same run; expected another name"));
        }
        if !force && metadata.len() > 0 && !is_ours(output) {
            return Err(refuse("exists and hplt did not write it; --force replaces it"));
        }
    }
    Ok(())
}

fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

fn is_ours(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    read.is_ok() && MARKS.iter().any(|mark| head.windows(mark.len()).any(|window| window == *mark))
}

/// Writes results to stdout. That nobody reads them to the end is no failure.
///
/// # Errors
/// When stdout cannot be written for another reason, a full disk for one.
pub fn to_stdout(write: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<(), Failure> {
    let mut out = std::io::BufWriter::new(std::io::stdout().lock());
    match write(&mut out).and_then(|()| out.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::new(Exit::Output, "OUTPUT_IO", format!("stdout: cannot be written: {error}")))
        }
        _ => Ok(()),
    }
}

/// The extension of a path in lower case.
pub fn extension(path: &Path) -> String {
    path.extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_our_own_files_are_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        let check = |force| check_outputs(&[&path], &[], force);
        assert!(check(false).is_ok());
        std::fs::write(&path, "").unwrap();
        assert!(check(false).is_ok());
        std::fs::write(&path, "x,y,z,nx,ny,nz,Ed_r,Ed_g\n").unwrap();
        assert!(check(false).is_ok());
        std::fs::write(&path, "my notes\n").unwrap();
        assert_eq!(check(false).unwrap_err().code, "OUTPUT_REFUSED");
        assert!(check(true).is_ok());
    }

    #[test]
    fn inputs_folders_and_missing_folders_are_refused_even_with_force() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.csv");
        std::fs::write(&path, "").unwrap();
        let same = folder.path().join(".").join("a.csv");
        assert_eq!(check_outputs(&[&path], &[&same], true).unwrap_err().exit, Exit::Output);
        assert_eq!(check_outputs(&[folder.path()], &[], true).unwrap_err().exit, Exit::Output);
        assert_eq!(check_outputs(&[&folder.path().join("no/a.csv")], &[], true).unwrap_err().exit, Exit::Output);
        assert_eq!(check_outputs(&[&path, &path], &[], true).unwrap_err().exit, Exit::Usage);
    }
}
