use std::cell::{OnceCell, RefCell};

use super::json::Document;
use crate::folder::{Folder, data_uri};
use crate::{Error, Limits};

/// The bytes of the buffers of a document, each read when it is first needed.
pub(super) struct Buffers<'a> {
    document: &'a Document,
    bin: Option<&'a [u8]>,
    folder: RefCell<Folder>,
    loaded: Vec<OnceCell<Vec<u8>>>,
    limits: &'a Limits,
}

/// The bytes of a buffer view.
#[derive(Debug, Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) stride: Option<usize>,
    /// Where it starts in its buffer.
    pub(super) offset: u64,
}

impl<'a> Buffers<'a> {
    pub(super) fn new(document: &'a Document, bin: Option<&'a [u8]>, folder: Folder, limits: &'a Limits) -> Self {
        let loaded = document.buffers.iter().map(|_| OnceCell::new()).collect();
        Self { document, bin, folder: RefCell::new(folder), loaded, limits }
    }

    /// The bytes of buffer view `index`.
    pub(super) fn view(&self, index: u32) -> Result<View<'_>, Error> {
        let place = format!("bufferViews[{index}]");
        let view = item(&self.document.buffer_views, index, "bufferViews")?;
        let buffer = view.buffer.ok_or_else(|| undefined(&format!("{place}.buffer")))?;
        let length = view.byte_length.ok_or_else(|| undefined(&format!("{place}.byteLength")))?;
        let bytes = self.buffer(buffer).map_err(|e| e.within(&place))?;
        let range = usize::try_from(view.byte_offset)
            .ok()
            .zip(view.byte_offset.checked_add(length).and_then(|end| usize::try_from(end).ok()));
        let bytes = range.and_then(|(start, end)| bytes.get(start..end)).ok_or_else(|| {
            let message = format!(
                "byteOffset {} + byteLength {length} exceed the {} bytes of buffers[{buffer}]",
                view.byte_offset,
                bytes.len()
            );
            Error::invalid(&place, "BUFFER_VIEW_TOO_LONG", message)
        })?;
        if let Some(stride) = view.byte_stride
            && !(4..=252).contains(&stride)
        {
            let message = format!("{stride}; expected 4 to 252");
            return Err(Error::invalid(format!("{place}.byteStride"), "VALUE_NOT_IN_RANGE", message));
        }
        Ok(View { bytes, stride: view.byte_stride.map(|s| s as usize), offset: view.byte_offset })
    }

    /// Bytes that an image refers to, and the media type of a data URI.
    #[cfg_attr(not(feature = "textures"), allow(dead_code, reason = "images are not read without the feature"))]
    pub(super) fn external(&self, uri: &str) -> Result<(Option<String>, Vec<u8>), Error> {
        if let Some(data) = data_uri(uri) {
            return data.map(|(media_type, data)| (Some(media_type.to_owned()), data));
        }
        self.folder.borrow_mut().read_uri(uri, self.limits.file_bytes).map(|data| (None, data))
    }

    /// The declared bytes of a buffer.
    fn buffer(&self, index: u32) -> Result<&[u8], Error> {
        let place = format!("buffers[{index}]");
        let buffer = item(&self.document.buffers, index, "buffers")?;
        let declared = buffer.byte_length.ok_or_else(|| undefined(&format!("{place}.byteLength")))?;
        let bytes = match (&buffer.uri, self.bin) {
            (None, Some(bin)) if index == 0 => bin,
            (None, _) => {
                let message = "has no uri and is not the binary chunk of a GLB file";
                return Err(Error::invalid(place, "BUFFER_MISSING_DATA", message));
            }
            (Some(uri), _) => self.read(index, uri).map_err(|e| e.within(&format!("{place}.uri")))?,
        };
        usize::try_from(declared).ok().and_then(|n| bytes.get(..n)).ok_or_else(|| {
            let message = format!("{declared}; there are {} bytes", bytes.len());
            Error::invalid(format!("{place}.byteLength"), "BUFFER_BYTE_LENGTH_MISMATCH", message)
        })
    }

    fn read(&self, index: u32, uri: &str) -> Result<&[u8], Error> {
        let cell = &self.loaded[index as usize];
        if let Some(bytes) = cell.get() {
            return Ok(bytes);
        }
        let bytes = self.external(uri)?.1;
        Ok(cell.get_or_init(|| bytes))
    }
}

/// Entry `index` of a top-level list.
pub(super) fn item<'a, T>(list: &'a [T], index: u32, name: &str) -> Result<&'a T, Error> {
    list.get(index as usize).ok_or_else(|| {
        let message = format!("does not exist; there are {}", list.len());
        Error::invalid(format!("{name}[{index}]"), "UNRESOLVED_REFERENCE", message)
    })
}

pub(super) fn undefined(place: &str) -> Error {
    Error::invalid(place, "UNDEFINED_PROPERTY", "is missing")
}
