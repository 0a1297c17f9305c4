//! Checked access to the numbers in buffers. Everything is validated when an accessor is opened; reading cannot fail.

use super::buffers::{Buffers, View, item, undefined};
use super::json::{self, Document};
use crate::{Error, Limits};

/// The type of one number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

/// The elements of an accessor.
#[derive(Debug)]
pub(super) struct Accessor<'a> {
    pub(super) component: Component,
    pub(super) normalized: bool,
    /// Numbers per element.
    pub(super) dimensions: usize,
    count: usize,
    base: Base<'a>,
    sparse: Option<Sparse<'a>>,
}

#[derive(Debug)]
enum Base<'a> {
    Zero,
    Bytes { bytes: &'a [u8], stride: usize },
}

#[derive(Debug)]
struct Sparse<'a> {
    /// Strictly increasing.
    indices: Vec<u32>,
    values: &'a [u8],
}

impl Component {
    fn from_code(code: u64, place: &str) -> Result<Self, Error> {
        Ok(match code {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            _ => {
                let message = format!("{code}; expected 5120, 5121, 5122, 5123, 5125 or 5126");
                return Err(Error::invalid(format!("{place}.componentType"), "VALUE_NOT_IN_LIST", message));
            }
        })
    }

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The number at the start of `bytes`, mapped to [-1, 1] when `normalized`.
    fn read(self, bytes: &[u8], normalized: bool) -> f32 {
        let (value, scale) = match self {
            Self::F32 => return f32::from_bits(word(bytes)),
            Self::U32 => return word(bytes) as f32,
            Self::I8 => (f32::from(i8::from_le_bytes([bytes[0]])), 127.0),
            Self::U8 => (f32::from(bytes[0]), 255.0),
            Self::I16 => (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32767.0),
            Self::U16 => (f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65535.0),
        };
        if normalized { (value / scale).max(-1.0) } else { value }
    }

    fn read_index(self, bytes: &[u8]) -> u32 {
        match self {
            Self::U8 | Self::I8 => bytes[0].into(),
            Self::U16 | Self::I16 => u16::from_le_bytes([bytes[0], bytes[1]]).into(),
            Self::U32 | Self::F32 => word(bytes),
        }
    }

    /// The index that would mean "restart the strip".
    pub(super) fn restart(self) -> u32 {
        match self {
            Self::U8 | Self::I8 => u8::MAX.into(),
            Self::U16 | Self::I16 => u16::MAX.into(),
            Self::U32 | Self::F32 => u32::MAX,
        }
    }
}

impl<'a> Accessor<'a> {
    /// Opens accessor `index`.
    pub(super) fn open(
        document: &Document,
        buffers: &'a Buffers<'_>,
        index: u32,
        limits: &Limits,
    ) -> Result<Self, Error> {
        let place = format!("accessors[{index}]");
        let accessor = item(&document.accessors, index, "accessors")?;
        let code = accessor.component_type.ok_or_else(|| undefined(&format!("{place}.componentType")))?;
        let component = Component::from_code(code, &place)?;
        if accessor.normalized && matches!(component, Component::F32 | Component::U32) {
            let message = "true; expected an 8 or 16 bit componentType with it";
            return Err(Error::invalid(format!("{place}.normalized"), "ACCESSOR_NORMALIZED_INVALID", message));
        }
        let dimensions = dimensions(accessor, &place)?;
        let count = count(accessor, &place)?;
        let size = component.size() * dimensions;
        let base = match accessor.buffer_view {
            Some(view) => {
                let view = buffers.view(view).map_err(|e| e.within(&place))?;
                let (bytes, stride) = base_bytes(view, accessor.byte_offset, count, component, size, &place)?;
                Base::Bytes { bytes, stride }
            }
            None if count > limits.zero_elements => {
                return Err(Error::limit(place, "LIMIT_MEMORY", "elements without data", count, limits.zero_elements));
            }
            None => Base::Zero,
        };
        let count = usize::try_from(count).map_err(|_| too_long(&place, "does not fit into memory"))?;
        let sparse = accessor.sparse.as_deref().map(|s| open_sparse(s, buffers, count, component, size, &place));
        Ok(Self { component, normalized: accessor.normalized, dimensions, count, base, sparse: sparse.transpose()? })
    }

    /// How many elements there are.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The first `N` numbers of element `i`; zero for numbers that the element lacks.
    ///
    /// # Panics
    /// When `i` is not below [`Self::count`].
    pub(super) fn element<const N: usize>(&self, i: usize) -> [f32; N] {
        let size = self.component.size();
        let Some(bytes) = self.bytes(i) else { return [0.0; N] };
        std::array::from_fn(|k| {
            if k < self.dimensions { self.component.read(&bytes[k * size..], self.normalized) } else { 0.0 }
        })
    }

    /// Element `i` as an index.
    ///
    /// # Panics
    /// When `i` is not below [`Self::count`].
    pub(super) fn index(&self, i: usize) -> u32 {
        self.bytes(i).map_or(0, |bytes| self.component.read_index(bytes))
    }

    /// The bytes of element `i`; `None` means zero.
    fn bytes(&self, i: usize) -> Option<&[u8]> {
        assert!(i < self.count, "element {i} of {}", self.count);
        let size = self.component.size() * self.dimensions;
        if let Some(sparse) = &self.sparse
            && let Ok(k) = sparse.indices.binary_search(&(i as u32))
        {
            return Some(&sparse.values[k * size..][..size]);
        }
        match self.base {
            Base::Zero => None,
            Base::Bytes { bytes, stride } => Some(&bytes[i * stride..][..size]),
        }
    }
}

fn word(bytes: &[u8]) -> u32 {
    u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]])
}

fn dimensions(accessor: &json::Accessor, place: &str) -> Result<usize, Error> {
    let kind = accessor.r#type.as_deref().ok_or_else(|| undefined(&format!("{place}.type")))?;
    match kind {
        "SCALAR" => Ok(1),
        "VEC2" => Ok(2),
        "VEC3" => Ok(3),
        "VEC4" => Ok(4),
        _ => {
            let message = format!("\"{}\"; expected SCALAR, VEC2, VEC3 or VEC4", crate::sanitized(kind));
            Err(Error::invalid(format!("{place}.type"), "VALUE_NOT_IN_LIST", message))
        }
    }
}

fn count(accessor: &json::Accessor, place: &str) -> Result<u64, Error> {
    match accessor.count {
        None => Err(undefined(&format!("{place}.count"))),
        Some(count) if count == 0 || count > u64::from(u32::MAX) => {
            let message = format!("{count}; expected 1 to {}", u32::MAX);
            Err(Error::invalid(format!("{place}.count"), "VALUE_NOT_IN_RANGE", message))
        }
        Some(count) => Ok(count),
    }
}

/// The bytes from the first element on, and the distance between elements; as long as `count` elements need.
fn base_bytes<'a>(
    view: View<'a>,
    offset: u64,
    count: u64,
    component: Component,
    size: usize,
    place: &str,
) -> Result<(&'a [u8], usize), Error> {
    let stride = view.stride.unwrap_or(size);
    if stride < size {
        let message = format!("byteStride {stride} is less than the {size} bytes of an element");
        return Err(Error::invalid(place, "ACCESSOR_SMALL_BYTESTRIDE", message));
    }
    let alignment = component.size() as u64;
    if !offset.is_multiple_of(alignment) {
        let message = format!("{offset}; expected a multiple of {alignment}");
        return Err(Error::invalid(format!("{place}.byteOffset"), "ACCESSOR_OFFSET_ALIGNMENT", message));
    }
    let in_buffer = offset.checked_add(view.offset);
    if !in_buffer.is_some_and(|o| o.is_multiple_of(alignment)) || !(stride as u64).is_multiple_of(alignment) {
        let message = format!("elements do not start at multiples of {alignment} bytes in the buffer");
        return Err(Error::invalid(place, "ACCESSOR_TOTAL_OFFSET_ALIGNMENT", message));
    }
    let end = (stride as u64)
        .checked_mul(count - 1)
        .and_then(|n| n.checked_add(size as u64))
        .and_then(|n| n.checked_add(offset))
        .filter(|&end| end <= view.bytes.len() as u64);
    match (end.and_then(|e| usize::try_from(e).ok()), usize::try_from(offset)) {
        (Some(end), Ok(start)) => Ok((&view.bytes[start..end], stride)),
        _ => {
            let message = format!("count {count} at byteOffset {offset} needs more than {} bytes", view.bytes.len());
            Err(too_long(place, &message))
        }
    }
}

fn too_long(place: &str, message: &str) -> Error {
    Error::invalid(place, "ACCESSOR_TOO_LONG", message)
}

fn open_sparse<'a>(
    sparse: &json::Sparse,
    buffers: &'a Buffers<'_>,
    count: usize,
    component: Component,
    size: usize,
    place: &str,
) -> Result<Sparse<'a>, Error> {
    let place = format!("{place}.sparse");
    if sparse.count == 0 || sparse.count > count as u64 {
        let message = format!("{}; expected 1 to {count}", sparse.count);
        return Err(Error::invalid(format!("{place}.count"), "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE", message));
    }
    let packed = |view: Option<u32>, offset, component: Component, size, what: &str| {
        let place = format!("{place}.{what}");
        let view = view.ok_or_else(|| undefined(&format!("{place}.bufferView")))?;
        let view = View { stride: None, ..buffers.view(view).map_err(|e| e.within(&place))? };
        base_bytes(view, offset, sparse.count, component, size, &place).map(|(bytes, _)| bytes)
    };
    let indices_place = format!("{place}.indices");
    let kind = Component::from_code(sparse.indices.component_type, &indices_place)?;
    if !matches!(kind, Component::U8 | Component::U16 | Component::U32) {
        let message = "is not an unsigned integer type";
        return Err(Error::invalid(format!("{indices_place}.componentType"), "VALUE_NOT_IN_LIST", message));
    }
    let bytes = packed(sparse.indices.buffer_view, sparse.indices.byte_offset, kind, kind.size(), "indices")?;
    let indices: Vec<u32> = bytes.chunks_exact(kind.size()).map(|b| kind.read_index(b)).collect();
    if let Some(i) = indices.windows(2).position(|pair| pair[0] >= pair[1]) {
        let message = format!("entry {} is {} after {}", i + 1, indices[i + 1], indices[i]);
        return Err(Error::invalid(indices_place, "ACCESSOR_SPARSE_INDICES_NON_INCREASING", message));
    }
    if let Some(&last) = indices.last()
        && last as usize >= count
    {
        let message = format!("index {last}; the accessor has {count} elements");
        return Err(Error::invalid(indices_place, "ACCESSOR_SPARSE_INDEX_OOB", message));
    }
    let values = packed(sparse.values.buffer_view, sparse.values.byte_offset, component, size, "values")?;
    Ok(Sparse { indices, values })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::folder::Folder;

    /// Opens accessor 0 of a document whose only buffer holds `bytes`, and passes it on.
    fn with_accessor<T>(
        json: &str,
        bytes: &[u8],
        read: impl FnOnce(&Accessor<'_>) -> T,
    ) -> Result<T, (&'static str, String)> {
        let limits = Limits::default();
        let document = Document::parse(json.as_bytes(), &limits).unwrap();
        let folder = Folder::of(&std::env::temp_dir(), 0).unwrap();
        let buffers = Buffers::new(&document, Some(bytes), folder, &limits);
        let accessor = Accessor::open(&document, &buffers, 0, &limits);
        accessor.map(|a| read(&a)).map_err(|e| (e.code(), e.to_string()))
    }

    fn document(accessor: &str, length: usize, stride: &str) -> String {
        format!(
            r#"{{"accessors":[{{{accessor}}}],"buffers":[{{"byteLength":{length}}}],
               "bufferViews":[{{"buffer":0,"byteLength":{length}{stride}}}]}}"#
        )
    }

    /// The definition in the specification, straight from the bytes and in `f64`.
    fn slow_reference(bytes: &[u8], at: usize, code: u32, normalized: bool) -> f64 {
        let b = |k: usize| i64::from(bytes[at + k]);
        let unsigned16 = b(0) + 256 * b(1);
        let (value, max) = match code {
            5120 => (if b(0) > 127 { b(0) - 256 } else { b(0) } as f64, 127.0),
            5121 => (b(0) as f64, 255.0),
            5122 => (if unsigned16 > 32767 { unsigned16 - 65536 } else { unsigned16 } as f64, 32767.0),
            5123 => (unsigned16 as f64, 65535.0),
            5125 => return (unsigned16 + 65536 * (b(2) + 256 * b(3))) as f64,
            _ => return f32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]).into(),
        };
        if normalized { (value / max).max(-1.0) } else { value }
    }

    #[test]
    fn elements_equal_the_slow_reference_for_every_type_stride_and_offset() {
        let mut state = 1u32;
        let bytes: Vec<u8> = std::iter::repeat_with(|| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        })
        .take(4096)
        .map(|b| if b == 0x7f || b == 0xff { 0x80 } else { b })
        .collect();
        let mut checked = 0;
        for (code, size) in [(5120, 1), (5121, 1), (5122, 2), (5123, 2), (5125, 4), (5126, 4)] {
            for (kind, n) in [("SCALAR", 1), ("VEC2", 2), ("VEC3", 3), ("VEC4", 4)] {
                for (stride, offset, normalized) in [(None, 0, false), (Some(20), 8, true), (Some(16), 4, false)] {
                    let normalized = normalized && size < 4;
                    let stride_text = stride.map_or(String::new(), |s| format!(",\"byteStride\":{s}"));
                    let accessor = format!(
                        r#""bufferView":0,"byteOffset":{offset},"componentType":{code},"type":"{kind}","count":37,
                           "normalized":{normalized}"#
                    );
                    let json = document(&accessor, 4096, &stride_text);
                    let read = with_accessor(&json, &bytes, |a| (0..37).map(|i| a.element::<4>(i)).collect::<Vec<_>>())
                        .unwrap();
                    for (i, element) in read.iter().enumerate() {
                        for (k, &number) in element.iter().enumerate() {
                            let at = offset + i * stride.unwrap_or(n * size) + k * size;
                            let expected = if k < n { slow_reference(&bytes, at, code, normalized) } else { 0.0 };
                            assert!(
                                (f64::from(number) - expected).abs() <= 1e-7 * expected.abs(),
                                "{accessor} {i} {k}"
                            );
                            checked += 1;
                        }
                    }
                }
            }
        }
        assert_eq!(checked, 6 * 4 * 3 * 37 * 4);
    }

    #[test]
    fn sparse_elements_replace_the_base_or_zeros() {
        let floats: Vec<u8> = [1.0f32, 2.0, 3.0, 70.0, 80.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let bytes = [&floats[..], &[0, 2, 0, 0]].concat();
        let sparse = r#""componentType":5126,"type":"SCALAR","count":3,"sparse":{"count":2,
            "indices":{"bufferView":0,"byteOffset":20,"componentType":5121},"values":{"bufferView":0,"byteOffset":12}}"#;
        let read = |base: &str| {
            let json = document(&format!("{base}{sparse}"), 24, "");
            with_accessor(&json, &bytes, |a| (0..3).map(|i| a.element::<1>(i)[0]).collect::<Vec<_>>()).unwrap()
        };
        assert_eq!(read(r#""bufferView":0,"#), [70.0, 2.0, 80.0]);
        assert_eq!(read(""), [70.0, 0.0, 80.0]);
    }

    #[test]
    fn lies_are_refused_by_name() {
        let sparse = |count: u32, kind: u32, offset: u32| {
            format!(
                r#""bufferView":0,"componentType":5121,"type":"SCALAR","count":4,"sparse":{{"count":{count},
                   "indices":{{"bufferView":0,"byteOffset":{offset},"componentType":{kind}}},
                   "values":{{"bufferView":0}}}}"#
            )
        };
        let plain = |rest: &str| format!(r#""bufferView":0,"componentType":5126,"type":"VEC3",{rest}"#);
        for (accessor, stride, expected) in [
            (plain(r#""count":6"#), "", "ACCESSOR_TOO_LONG"),
            (plain(r#""count":0"#), "", "VALUE_NOT_IN_RANGE"),
            (plain(r#""count":4294967295"#), "", "ACCESSOR_TOO_LONG"),
            (plain(r#""count":1000000000000"#), "", "VALUE_NOT_IN_RANGE"),
            (plain(r#""count":1,"byteOffset":18446744073709551612"#), "", "ACCESSOR_TOO_LONG"),
            (plain(r#""count":1,"byteOffset":56"#), "", "ACCESSOR_TOO_LONG"),
            (plain(r#""count":1,"byteOffset":2"#), "", "ACCESSOR_OFFSET_ALIGNMENT"),
            (plain(r#""count":2"#), ",\"byteStride\":4", "ACCESSOR_SMALL_BYTESTRIDE"),
            (plain(r#""count":2"#), ",\"byteStride\":14", "ACCESSOR_TOTAL_OFFSET_ALIGNMENT"),
            (plain(r#""count":2"#), ",\"byteStride\":1000", "VALUE_NOT_IN_RANGE"),
            (plain(r#""count":2,"normalized":true"#), "", "ACCESSOR_NORMALIZED_INVALID"),
            (r#""componentType":5126,"type":"VEC3","count":4000000000"#.into(), "", "LIMIT_MEMORY"),
            (r#""bufferView":1,"componentType":5126,"type":"VEC3","count":1"#.into(), "", "UNRESOLVED_REFERENCE"),
            (r#""bufferView":0,"componentType":5124,"type":"VEC3","count":1"#.into(), "", "VALUE_NOT_IN_LIST"),
            (r#""bufferView":0,"componentType":5126,"type":"MAT4","count":1"#.into(), "", "VALUE_NOT_IN_LIST"),
            (r#""bufferView":0,"type":"VEC3","count":1"#.into(), "", "UNDEFINED_PROPERTY"),
            (sparse(0, 5121, 0), "", "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE"),
            (sparse(5, 5121, 0), "", "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE"),
            (sparse(2, 5121, 0), "", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
            (sparse(2, 5121, 1), "", "ACCESSOR_SPARSE_INDEX_OOB"),
            (sparse(2, 5126, 0), "", "VALUE_NOT_IN_LIST"),
            (sparse(2, 5123, 58), "", "ACCESSOR_TOO_LONG"),
            (sparse(2, 5125, 2), "", "ACCESSOR_OFFSET_ALIGNMENT"),
        ] {
            let mut bytes = vec![0; 60];
            bytes[2] = 200;
            let error = with_accessor(&document(&accessor, 60, stride), &bytes, |_| ()).unwrap_err();
            assert_eq!(error.0, expected, "{accessor}: {}", error.1);
        }
    }
}
