use glam::{Vec2, Vec3};

use super::accessor::{Accessor, Component};
use super::buffers::Buffers;
use super::extensions;
use super::json::{Document, Primitive};
use crate::winding::winding_disagreements;
use crate::{Error, Limits, LoadReport};

/// The triangles of a primitive, in the space of its mesh.
#[derive(Debug)]
pub(super) struct Triangles {
    pub(super) positions: Vec<Vec3>,
    /// Per vertex, or empty.
    pub(super) normals: Vec<Vec3>,
    /// Per vertex, or empty.
    pub(super) uvs: Vec<Vec2>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Triangles whose front faces away from the mean of their vertex normals.
    pub(super) winding_disagreements: u64,
}

/// How indices form triangles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Mode {
    List,
    Strip,
    Fan,
}

impl Mode {
    /// The mode of a primitive; `None` for points and lines.
    pub(super) fn of(primitive: &Primitive) -> Result<Option<Self>, Error> {
        match primitive.mode {
            Some(0..=3) => Ok(None),
            None | Some(4) => Ok(Some(Self::List)),
            Some(5) => Ok(Some(Self::Strip)),
            Some(6) => Ok(Some(Self::Fan)),
            Some(mode) => Err(Error::invalid("mode", "VALUE_NOT_IN_LIST", format!("{mode}; expected 0 to 6"))),
        }
    }

    /// Triangles that `n` indices form.
    pub(super) fn n_triangles(self, n: u64) -> u64 {
        if self == Self::List { n / 3 } else { n.saturating_sub(2) }
    }

    fn corners(self, i: usize) -> [usize; 3] {
        match self {
            Self::List => [3 * i, 3 * i + 1, 3 * i + 2],
            // Every other triangle of a strip would be wound the other way.
            Self::Strip if i % 2 == 1 => [i, i + 2, i + 1],
            Self::Strip => [i, i + 1, i + 2],
            Self::Fan => [i + 1, i + 2, 0],
        }
    }
}

/// Reads primitives through the checked accessors.
#[derive(Clone, Copy)]
pub(super) struct Reader<'a> {
    pub(super) document: &'a Document,
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) limits: &'a Limits,
}

impl Reader<'_> {
    /// How many triangles a primitive has; 0 when it is not made of triangles. Checks nothing but the count.
    pub(super) fn n_triangles(&self, primitive: &Primitive) -> Result<u64, Error> {
        let Some(mode) = Mode::of(primitive)? else { return Ok(0) };
        let Some(position) = primitive.attributes.get("POSITION") else { return Ok(0) };
        let accessor = primitive.indices.unwrap_or(position);
        let count = self.open(accessor, "indices")?.count() as u64;
        Ok(mode.n_triangles(count))
    }

    /// The triangles of a primitive that has positions, with the texture coordinates of `uv_set`.
    pub(super) fn read(
        &self,
        primitive: &Primitive,
        mode: Mode,
        position: u32,
        uv_set: Option<u32>,
        report: &mut LoadReport,
    ) -> Result<Triangles, Error> {
        let positions = self.attribute(position, "POSITION", 3)?;
        let normals = primitive.attributes.get("NORMAL").map(|a| self.attribute(a, "NORMAL", 3)).transpose()?;
        let uv_name = uv_set.map(|set| format!("TEXCOORD_{set}"));
        let uvs = uv_name.as_deref().and_then(|name| Some((name, primitive.attributes.get(name)?)));
        let uvs = uvs.map(|(name, a)| self.attribute(a, name, 2)).transpose()?;
        for (name, other) in [("NORMAL", &normals), ("TEXCOORD", &uvs)] {
            if let Some(other) = other
                && other.count() != positions.count()
            {
                let message = format!("{} elements; POSITION has {}", other.count(), positions.count());
                return Err(Error::invalid(name, "MESH_PRIMITIVE_UNEQUAL_ACCESSOR_COUNT", message));
            }
        }
        if primitive.attributes.has_prefix("COLOR_") {
            report.leave_out("vertex colours (COLOR_n)");
        }
        let indices = self.indices(primitive, positions.count())?;
        let n = indices.len();
        if mode == Mode::List && !n.is_multiple_of(3) {
            report.warn(format!("a primitive has {n} indices, not a multiple of 3; the last ones are ignored"));
        }
        let triangles: Vec<[u32; 3]> =
            (0..mode.n_triangles(n as u64) as usize).map(|i| mode.corners(i).map(|k| indices[k])).collect();
        Ok(gather(triangles, &positions, normals.as_ref(), uvs.as_ref()))
    }

    fn open(&self, index: u32, place: &str) -> Result<Accessor<'_>, Error> {
        Accessor::open(self.document, self.buffers, index, self.limits).map_err(|e| e.within(place))
    }

    /// An attribute of a vertex, of a type that the format allows for it.
    fn attribute(&self, index: u32, name: &str, dimensions: usize) -> Result<Accessor<'_>, Error> {
        let accessor = self.open(index, name)?;
        let quantized = extensions::uses(self.document, "KHR_mesh_quantization");
        let allowed = match (accessor.component, name) {
            (Component::F32, _) => true,
            (Component::U32, _) => false,
            (Component::I8 | Component::I16, "NORMAL") => quantized && accessor.normalized,
            (_, "NORMAL") => false,
            (Component::U8 | Component::U16, _) if name.starts_with("TEXCOORD") => quantized || accessor.normalized,
            _ => quantized,
        };
        if accessor.dimensions != dimensions || !allowed {
            let message = format!(
                "accessors[{index}] has {} numbers of type {:?}, normalized {}; expected {dimensions} numbers of a type \
                 that is allowed here",
                accessor.dimensions, accessor.component, accessor.normalized
            );
            return Err(Error::invalid(name, "MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT", message));
        }
        Ok(accessor)
    }

    /// Indices of vertices, all in range.
    fn indices(&self, primitive: &Primitive, n_vertices: usize) -> Result<Vec<u32>, Error> {
        let Some(index) = primitive.indices else { return Ok((0..n_vertices as u32).collect()) };
        let accessor = self.open(index, "indices")?;
        let is_unsigned = matches!(accessor.component, Component::U8 | Component::U16 | Component::U32);
        if accessor.dimensions != 1 || !is_unsigned || accessor.normalized {
            let message = format!("accessors[{index}] is not a plain unsigned integer per element");
            return Err(Error::invalid("indices", "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT", message));
        }
        let indices: Vec<u32> = (0..accessor.count()).map(|i| accessor.index(i)).collect();
        if let Some(bad) = indices.iter().position(|&v| v as usize >= n_vertices) {
            let value = indices[bad];
            let place = format!("indices, accessors[{index}], element {bad}");
            return Err(if value == accessor.component.restart() {
                let message = format!("{value} would restart the primitive, which the format forbids");
                Error::invalid(place, "ACCESSOR_INDEX_PRIMITIVE_RESTART", message)
            } else {
                Error::invalid(place, "ACCESSOR_INDEX_OOB", format!("{value}; there are {n_vertices} vertices"))
            });
        }
        Ok(indices)
    }
}

/// Reads the vertices that triangles use, and only those: many primitives may share one large buffer.
fn gather(
    mut triangles: Vec<[u32; 3]>,
    positions: &Accessor<'_>,
    normals: Option<&Accessor<'_>>,
    uvs: Option<&Accessor<'_>>,
) -> Triangles {
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    if used.len() < positions.count() / 4 {
        used.sort_unstable();
        used.dedup();
        for corner in triangles.iter_mut().flatten() {
            *corner = used.partition_point(|v| v < corner) as u32;
        }
    } else {
        let mut new_from_old = vec![0u32; positions.count()];
        for &v in &used {
            new_from_old[v as usize] = 1;
        }
        used.clear();
        for (old, new) in new_from_old.iter_mut().enumerate().filter(|(_, flag)| **flag == 1) {
            *new = used.len() as u32;
            used.push(old as u32);
        }
        for corner in triangles.iter_mut().flatten() {
            *corner = new_from_old[*corner as usize];
        }
    }
    let vec3 = |a: &Accessor<'_>| used.iter().map(|&v| Vec3::from(a.element::<3>(v as usize))).collect::<Vec<_>>();
    let positions = vec3(positions);
    let normals = normals.map(vec3).unwrap_or_default();
    let uvs = uvs.map(|a| used.iter().map(|&v| Vec2::from(a.element::<2>(v as usize))).collect()).unwrap_or_default();
    let winding_disagreements = winding_disagreements(&positions, &normals, &triangles);
    Triangles { positions, normals, uvs, triangles, winding_disagreements }
}
