use crate::{Error, Limits};

const MAGIC: &[u8] = b"glTF";
const JSON: [u8; 4] = *b"JSON";
const BIN: [u8; 4] = *b"BIN\0";

/// Refuses a file by its first bytes and its length, before all of it is read.
pub(super) fn check_head(head: &[u8], length: u64, limits: &Limits) -> Result<(), Error> {
    match u32_at(head, 8) {
        Some(declared) if head.starts_with(MAGIC) && u64::from(declared) != length => {
            let message = format!("{declared}; the file has {length} bytes");
            Err(Error::invalid("GLB header, length", "GLB_LENGTH_MISMATCH", message))
        }
        _ if !head.starts_with(MAGIC) && length > limits.json_bytes => {
            Err(Error::limit("JSON", "LIMIT_JSON", "bytes", length, limits.json_bytes))
        }
        _ => Ok(()),
    }
}

/// The JSON text and the binary chunk of a glTF file, text or container.
pub(super) fn split(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), Error> {
    if !bytes.starts_with(MAGIC) {
        return if bytes.is_empty() { Err(Error::invalid("", "EMPTY_FILE", "has 0 bytes")) } else { Ok((bytes, None)) };
    }
    let invalid = |place: &str, code, message: String| Err(Error::invalid(place, code, message));
    let (Some(version), Some(length)) = (u32_at(bytes, 4), u32_at(bytes, 8)) else {
        let message = format!("has {} bytes; expected 12", bytes.len());
        return invalid("GLB header", "GLB_UNEXPECTED_END_OF_HEADER", message);
    };
    if version != 2 {
        return invalid("GLB header, version", "GLB_INVALID_VERSION", format!("{version}; expected 2"));
    }
    if length as usize != bytes.len() {
        let message = format!("{length}; the file has {} bytes", bytes.len());
        return invalid("GLB header, length", "GLB_LENGTH_MISMATCH", message);
    }
    let (mut json, mut bin) = (None, None);
    let (mut at, mut i) = (12, 0);
    while at < bytes.len() {
        let place = format!("GLB chunk {i}");
        let (Some(length), Some(kind)) = (u32_at(bytes, at), bytes.get(at + 4..at + 8)) else {
            return invalid(&place, "GLB_UNEXPECTED_END_OF_CHUNK_HEADER", format!("{} bytes left", bytes.len() - at));
        };
        let (start, length) = (at + 8, length as usize);
        if !length.is_multiple_of(4) {
            let message = format!("{length} bytes; expected a multiple of 4");
            return invalid(&place, "GLB_CHUNK_LENGTH_UNALIGNED", message);
        }
        let Some(data) = start.checked_add(length).and_then(|end| bytes.get(start..end)) else {
            let message = format!("{length} bytes; the file has {} more", bytes.len() - start);
            return invalid(&place, "GLB_CHUNK_TOO_BIG", message);
        };
        if i == 0 && kind != JSON {
            return invalid(&place, "GLB_UNEXPECTED_FIRST_CHUNK", "is not JSON".into());
        }
        let slot = if kind == JSON { Some(&mut json) } else { (kind == BIN).then_some(&mut bin) };
        if let Some(slot) = slot
            && slot.replace(data).is_some()
        {
            return invalid(&place, "GLB_DUPLICATE_CHUNK", "a chunk of this kind came before".into());
        }
        if kind == BIN && i != 1 {
            return invalid(&place, "GLB_UNEXPECTED_BIN_CHUNK", "the binary chunk must be the second one".into());
        }
        at = start + length;
        i += 1;
    }
    let json = json.ok_or_else(|| Error::invalid("GLB", "GLB_UNEXPECTED_FIRST_CHUNK", "has no JSON chunk"))?;
    Ok((json, bin))
}

fn u32_at(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
        let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
        for (kind, data) in chunks {
            bytes.extend((data.len() as u32).to_le_bytes());
            bytes.extend(*kind);
            bytes.extend(*data);
        }
        let length = bytes.len() as u32;
        bytes[8..12].copy_from_slice(&length.to_le_bytes());
        bytes
    }

    #[test]
    fn chunks_are_found_and_unknown_ones_skipped() {
        let bytes = glb(&[(&JSON, b"{}  "), (&BIN, b"1234"), (b"ABCD", b"")]);
        assert_eq!(split(&bytes).unwrap(), (&b"{}  "[..], Some(&b"1234"[..])));
        assert_eq!(split(b"{}").unwrap(), (&b"{}"[..], None));
    }

    #[test]
    fn wrong_orders_are_named() {
        let code = |chunks: &[(&[u8; 4], &[u8])]| split(&glb(chunks)).unwrap_err().code();
        assert_eq!(code(&[]), "GLB_UNEXPECTED_FIRST_CHUNK");
        assert_eq!(code(&[(&BIN, b""), (&JSON, b"")]), "GLB_UNEXPECTED_FIRST_CHUNK");
        assert_eq!(code(&[(&JSON, b""), (&BIN, b""), (&BIN, b"")]), "GLB_DUPLICATE_CHUNK");
        assert_eq!(code(&[(&JSON, b""), (&JSON, b"")]), "GLB_DUPLICATE_CHUNK");
        assert_eq!(code(&[(&JSON, b""), (b"ABCD", b""), (&BIN, b"")]), "GLB_UNEXPECTED_BIN_CHUNK");
        assert_eq!(code(&[(&JSON, b"abc")]), "GLB_CHUNK_LENGTH_UNALIGNED");
    }

    #[test]
    fn every_truncation_is_an_error() {
        let bytes = glb(&[(&JSON, b"{}  "), (&BIN, b"1234")]);
        for n in 4..bytes.len() {
            assert!(split(&bytes[..n]).is_err(), "{n}");
        }
    }
}
