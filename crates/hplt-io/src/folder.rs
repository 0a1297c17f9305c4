use std::path::{Path, PathBuf};

use crate::Error;
use crate::files::{any_content, read_regular};

/// Longest reference that is followed, in bytes.
const MAX_REFERENCE: usize = 4096;

/// The folder of a scene file: the only place from which the files it refers to are read.
#[derive(Debug)]
pub(crate) struct Folder {
    root: PathBuf,
    /// Bytes that may still be read.
    budget: u64,
    total: u64,
}

impl Folder {
    /// The folder that holds `scene`.
    pub(crate) fn of(scene: &Path, total_bytes: u64) -> Result<Self, Error> {
        let file = scene.canonicalize().map_err(|e| Error::read(scene, e))?;
        let root = file.parent().map_or_else(|| file.clone(), Path::to_path_buf);
        Ok(Self { root, budget: total_bytes, total: total_bytes })
    }

    /// The bytes of the file that `uri` means; percent-encoded as in glTF.
    #[cfg(feature = "gltf")]
    pub(crate) fn read_uri(&mut self, uri: &str, limit: u64) -> Result<Vec<u8>, Error> {
        check_text(uri)?;
        let path = percent_decoded(uri).ok_or_else(|| invalid(uri, "is not percent-encoded UTF-8"))?;
        if path.contains('\\') {
            return Err(invalid(uri, "has a backslash; expected \"/\" between folders"));
        }
        self.read_path(&path, limit)
    }

    /// The bytes of the file that `name` means, as written; backslashes separate folders too, as in MTL.
    #[cfg(feature = "obj")]
    pub(crate) fn read_name(&mut self, name: &str, limit: u64) -> Result<Vec<u8>, Error> {
        check_text(name)?;
        self.read_path(&name.replace('\\', "/"), limit)
    }

    fn read_path(&mut self, relative: &str, limit: u64) -> Result<Vec<u8>, Error> {
        check_text(relative)?;
        check_inside(relative)?;
        let wanted = self.root.join(relative);
        let path = wanted.canonicalize().map_err(|source| unreadable(relative, &source))?;
        if !path.starts_with(&self.root) {
            return Err(outside(relative));
        }
        let bytes = read_regular(&path, limit.min(self.budget), any_content).map_err(|e| match e {
            Error::Read { source, .. } => unreadable(relative, &source),
            Error::Limit { value, .. } if value <= limit => self.total_exceeded(relative, value),
            other => other.forget_file().within(&format!("\"{}\"", crate::sanitized(relative))),
        })?;
        self.budget -= bytes.len() as u64;
        Ok(bytes)
    }

    fn total_exceeded(&self, relative: &str, value: u64) -> Error {
        let place = format!("\"{}\"", crate::sanitized(relative));
        Error::limit(place, "LIMIT_FILE_SIZE", "bytes of all files", self.total - self.budget + value, self.total)
    }
}

/// The media type and the data of a `data:` reference; `None` for any other reference.
#[cfg(feature = "gltf")]
pub(crate) fn data_uri(uri: &str) -> Option<Result<(&str, Vec<u8>), Error>> {
    use base64::Engine;
    use base64::alphabet::STANDARD;
    use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

    let is_data = uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"));
    let rest = is_data.then(|| &uri[5..])?;
    let bad = |what: &str| Error::invalid("", "INVALID_URI", format!("data URI {what}"));
    let Some((head, body)) = rest.split_once(',') else {
        return Some(Err(bad("has no comma")));
    };
    let Some(media_type) = head.strip_suffix(";base64") else {
        return Some(Err(bad("is not base64")));
    };
    let config = GeneralPurposeConfig::new().with_decode_padding_mode(DecodePaddingMode::Indifferent);
    let decoded = GeneralPurpose::new(&STANDARD, config).decode(body);
    let media_type = media_type.split(';').next().unwrap_or("");
    Some(decoded.map(|data| (media_type, data)).map_err(|e| bad(&format!("has bad base64: {e}"))))
}

fn check_text(reference: &str) -> Result<(), Error> {
    if reference.is_empty() || reference.len() > MAX_REFERENCE {
        return Err(invalid(reference, &format!("has {} bytes; expected 1 to {MAX_REFERENCE}", reference.len())));
    }
    if reference.chars().any(char::is_control) {
        return Err(invalid(reference, "has control characters"));
    }
    let head = reference.split(['/', '\\', '?', '#']).next().unwrap_or("");
    if let Some((scheme, _)) = head.split_once(':') {
        let message =
            format!("\"{}\": scheme \"{scheme}\" is refused; expected a relative path", crate::sanitized(reference));
        return Err(Error::invalid("", "URI_SCHEME_REFUSED", crate::sanitized(&message)));
    }
    Ok(())
}

/// Whether the path stays inside by its letters alone; links are found later.
fn check_inside(relative: &str) -> Result<(), Error> {
    let mut depth = 0i64;
    for part in relative.split('/') {
        match part {
            ".." => depth -= 1,
            "" | "." => {}
            _ => depth += 1,
        }
        if depth < 0 {
            return Err(outside(relative));
        }
    }
    if relative.starts_with('/') || Path::new(relative).is_absolute() {
        return Err(outside(relative));
    }
    Ok(())
}

#[cfg(feature = "gltf")]
fn percent_decoded(uri: &str) -> Option<String> {
    let mut bytes = Vec::with_capacity(uri.len());
    let mut rest = uri.bytes();
    while let Some(byte) = rest.next() {
        if byte == b'%' {
            let digit = |b: Option<u8>| (b? as char).to_digit(16);
            bytes.push((digit(rest.next())? * 16 + digit(rest.next())?) as u8);
        } else {
            bytes.push(byte);
        }
    }
    String::from_utf8(bytes).ok()
}

fn invalid(reference: &str, message: &str) -> Error {
    Error::invalid("", "INVALID_URI", format!("\"{}\" {message}", crate::sanitized(reference)))
}

fn outside(reference: &str) -> Error {
    let message = format!("\"{}\" is outside the folder of the scene", crate::sanitized(reference));
    Error::invalid("", "URI_OUTSIDE_ROOT", message)
}

fn unreadable(reference: &str, source: &std::io::Error) -> Error {
    Error::invalid("", "FILE_UNREADABLE", format!("\"{}\" cannot be read: {source}", crate::sanitized(reference)))
}

#[cfg(all(test, feature = "gltf"))]
mod tests {
    use super::*;

    fn folder() -> (tempfile::TempDir, Folder) {
        let temporary = tempfile::tempdir().unwrap();
        std::fs::create_dir_all(temporary.path().join("in/textures")).unwrap();
        std::fs::write(temporary.path().join("secret"), "no").unwrap();
        std::fs::write(temporary.path().join("in/scene.gltf"), "").unwrap();
        std::fs::write(temporary.path().join("in/textures/a b.bin"), "yes").unwrap();
        let folder = Folder::of(&temporary.path().join("in/scene.gltf"), 100).unwrap();
        (temporary, folder)
    }

    #[test]
    fn relative_references_inside_the_folder_are_read() {
        let (_keep, mut folder) = folder();
        for uri in ["textures/a%20b.bin", "./textures/a b.bin", "textures/../textures/a%20b.bin", "textures//a%20b.bin"]
        {
            assert_eq!(folder.read_uri(uri, 10).unwrap(), b"yes", "{uri}");
        }
        let error = folder.read_uri("textures/a%20b.bin", 2).unwrap_err();
        assert_eq!((error.code(), error.exit_code()), ("LIMIT_FILE_SIZE", 4));
        folder.budget = 1;
        assert_eq!(folder.read_uri("textures/a%20b.bin", 10).unwrap_err().code(), "LIMIT_FILE_SIZE");
    }

    #[test]
    fn references_to_anywhere_else_are_refused() {
        let (_keep, mut folder) = folder();
        let long = "x".repeat(100_000);
        for (uri, code) in [
            ("../secret", "URI_OUTSIDE_ROOT"),
            ("%2e%2e/secret", "URI_OUTSIDE_ROOT"),
            ("%2e%2e%2fsecret", "URI_OUTSIDE_ROOT"),
            ("textures/../../secret", "URI_OUTSIDE_ROOT"),
            ("../in/textures/a%20b.bin", "URI_OUTSIDE_ROOT"),
            ("/etc/passwd", "URI_OUTSIDE_ROOT"),
            ("//server/share", "URI_OUTSIDE_ROOT"),
            ("\\\\server\\share", "INVALID_URI"),
            ("C:/windows", "URI_SCHEME_REFUSED"),
            ("C%3A/windows", "URI_SCHEME_REFUSED"),
            ("file:///etc/passwd", "URI_SCHEME_REFUSED"),
            ("https://example.org/a.bin", "URI_SCHEME_REFUSED"),
            ("a%00.bin", "INVALID_URI"),
            ("a\0.bin", "INVALID_URI"),
            ("%ff.bin", "INVALID_URI"),
            ("%f", "INVALID_URI"),
            ("", "INVALID_URI"),
            (&long, "INVALID_URI"),
            ("none.bin", "FILE_UNREADABLE"),
            ("textures", "FILE_NOT_REGULAR"),
        ] {
            let error = folder.read_uri(uri, 10).unwrap_err();
            assert_eq!(error.code(), code, "{error}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_inside_the_folder_only() {
        let (temporary, mut folder) = folder();
        let inside = temporary.path().join("in");
        std::os::unix::fs::symlink(temporary.path().join("secret"), inside.join("out.bin")).unwrap();
        std::os::unix::fs::symlink("textures/a b.bin", inside.join("ok.bin")).unwrap();
        std::os::unix::fs::symlink("/dev/zero", inside.join("zero.bin")).unwrap();
        assert_eq!(folder.read_uri("out.bin", 10).unwrap_err().code(), "URI_OUTSIDE_ROOT");
        assert_eq!(folder.read_uri("zero.bin", 10).unwrap_err().code(), "URI_OUTSIDE_ROOT");
        assert_eq!(folder.read_uri("ok.bin", 10).unwrap(), b"yes");
    }

    #[test]
    fn data_uris_are_decoded() {
        assert_eq!(data_uri("data:image/png;base64,AQID").unwrap().unwrap(), ("image/png", vec![1, 2, 3]));
        assert_eq!(data_uri("data:;base64,AQ").unwrap().unwrap(), ("", vec![1]));
        assert!(data_uri("data.bin").is_none());
        for uri in ["data:", "data:text/plain,abc", "data:;base64,A*==", "data:;base64,A"] {
            assert_eq!(data_uri(uri).unwrap().unwrap_err().code(), "INVALID_URI", "{uri}");
        }
    }
}
