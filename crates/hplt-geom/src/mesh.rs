use glam::{DVec3, Vec2, Vec3};

use crate::MaterialId;

/// Index of a triangle in its mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(transparent)]
pub struct TriangleId(pub u32);

impl TriangleId {
    /// No triangle.
    pub const NONE: Self = Self(u32::MAX);

    /// The index as `usize`.
    #[inline]
    pub fn index(self) -> usize {
        self.0 as usize
    }
}

/// All triangles of a scene, in scene space: finite, with an area, no exact duplicates.
#[derive(Debug, Clone, PartialEq)]
pub struct Mesh {
    pub(crate) positions: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    pub(crate) face_normals: Vec<Vec3>,
    pub(crate) materials: Vec<MaterialId>,
    /// Per vertex; empty when no material needs them.
    pub(crate) uvs: Vec<Vec2>,
    /// Per vertex, zero where the file has none; empty when it has none at all.
    pub(crate) shading_normals: Vec<Vec3>,
}

impl Mesh {
    /// How many triangles there are.
    pub fn n_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// Vertex positions.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Corner indices of every triangle.
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.triangles
    }

    /// The corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: TriangleId) -> [Vec3; 3] {
        self.triangles[triangle.index()].map(|v| self.positions[v as usize])
    }

    /// The unit normal of a triangle's front side.
    #[inline]
    pub fn face_normal(&self, triangle: TriangleId) -> Vec3 {
        self.face_normals[triangle.index()]
    }

    /// The material of a triangle.
    #[inline]
    pub fn material(&self, triangle: TriangleId) -> MaterialId {
        self.materials[triangle.index()]
    }

    /// The area of a triangle, scene units squared.
    pub fn area(&self, triangle: TriangleId) -> f64 {
        let [a, b, c] = self.corners(triangle);
        0.5 * doubled_area_vector(a, b, c).length()
    }

    /// The texture coordinates of a triangle's corners; zero when the mesh keeps none.
    #[inline]
    pub fn corner_uvs(&self, triangle: TriangleId) -> [Vec2; 3] {
        if self.uvs.is_empty() {
            return [Vec2::ZERO; 3];
        }
        self.triangles[triangle.index()].map(|v| self.uvs[v as usize])
    }

    /// Shading normals per vertex, zero where the file has none; empty when it has none at all.
    pub fn shading_normals(&self) -> &[Vec3] {
        &self.shading_normals
    }

    /// Whether texture coordinates are kept.
    pub fn has_uvs(&self) -> bool {
        !self.uvs.is_empty()
    }

    /// The point at barycentric weights `(1-u-v, u, v)`.
    #[inline]
    pub fn position_at(&self, triangle: TriangleId, u: f32, v: f32) -> Vec3 {
        interpolate(self.corners(triangle), u, v)
    }

    /// The texture coordinate at barycentric weights `(1-u-v, u, v)`.
    #[inline]
    pub fn uv_at(&self, triangle: TriangleId, u: f32, v: f32) -> Vec2 {
        let [a, b, c] = self.corner_uvs(triangle);
        a * (1.0 - u - v) + b * u + c * v
    }

    /// The interpolated shading normal, on the side of `face_normal`; `face_normal` itself where there is none or where
    /// the two differ by more than 60°.
    #[inline]
    pub fn shading_normal_at(&self, triangle: TriangleId, u: f32, v: f32) -> Vec3 {
        let face = self.face_normal(triangle);
        if self.shading_normals.is_empty() {
            return face;
        }
        let corners = self.triangles[triangle.index()].map(|i| self.shading_normals[i as usize]);
        if corners.contains(&Vec3::ZERO) {
            return face;
        }
        let normal = interpolate(corners, u, v).normalize_or_zero();
        let normal = if normal.dot(face) < 0.0 { -normal } else { normal };
        if normal.dot(face) > 0.5 { normal } else { face }
    }

    /// The smallest box around all triangles, scene space; `None` for an empty mesh.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut corners = self.triangles.iter().flatten().map(|&v| self.positions[v as usize]);
        let first = corners.next()?;
        Some(corners.fold((first, first), |(min, max), p| (min.min(p), max.max(p))))
    }

    /// Bytes that the mesh takes.
    pub fn memory(&self) -> usize {
        size_of_val(&self.positions[..])
            + size_of_val(&self.triangles[..])
            + size_of_val(&self.face_normals[..])
            + size_of_val(&self.materials[..])
            + size_of_val(&self.uvs[..])
            + size_of_val(&self.shading_normals[..])
    }
}

fn interpolate([a, b, c]: [Vec3; 3], u: f32, v: f32) -> Vec3 {
    a * (1.0 - u - v) + b * u + c * v
}

/// Twice the area times the unit front normal. In `f64` the edges of `f32` corners are exact.
pub(crate) fn doubled_area_vector(a: Vec3, b: Vec3, c: Vec3) -> DVec3 {
    (b.as_dvec3() - a.as_dvec3()).cross(c.as_dvec3() - a.as_dvec3())
}
