use std::collections::HashMap;

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{MaterialId, MeshInput, SceneBuilder};

/// A triangle mesh in the making, world space. Corners are counter-clockwise seen from the front.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shape {
    /// Vertex positions.
    pub positions: Vec<DVec3>,
    /// Shading normals per vertex, or empty.
    pub normals: Vec<Vec3>,
    /// Corner indices.
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    /// No triangles.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds one triangle.
    pub fn triangle(&mut self, corners: [DVec3; 3]) -> &mut Self {
        let first = self.positions.len() as u32;
        self.positions.extend(corners);
        self.triangles.push([first, first + 1, first + 2]);
        self
    }

    /// Adds a quadrilateral, split along the diagonal from corner 0 to corner 2.
    pub fn quad(&mut self, corners: [DVec3; 4]) -> &mut Self {
        let first = self.positions.len() as u32;
        self.positions.extend(corners);
        self.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
        self
    }

    /// Adds a quadrilateral of `n_u × n_v` cells, bilinear between the corners; `n_u` along the first edge.
    pub fn grid(&mut self, corners: [DVec3; 4], n_u: u32, n_v: u32) -> &mut Self {
        let [a, b, c, d] = corners;
        self.surface(n_u, n_v, |u, v| a.lerp(b, u).lerp(d.lerp(c, u), v))
    }

    /// Adds the graph of `position(u, v)` over `[0, 1]²` with `n_u × n_v` cells; its front is where `u` turns to `v`
    /// counter-clockwise.
    pub fn surface(&mut self, n_u: u32, n_v: u32, position: impl Fn(f64, f64) -> DVec3) -> &mut Self {
        let first = self.positions.len() as u32;
        for j in 0..=n_v {
            for i in 0..=n_u {
                self.positions.push(position(f64::from(i) / f64::from(n_u), f64::from(j) / f64::from(n_v)));
            }
        }
        let at = |i: u32, j: u32| first + j * (n_u + 1) + i;
        for j in 0..n_v {
            for i in 0..n_u {
                let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                // Alternate diagonals, so that bends look the same in both directions.
                if (i + j) % 2 == 0 {
                    self.triangles.extend([[a, b, c], [a, c, d]]);
                } else {
                    self.triangles.extend([[a, b, d], [b, c, d]]);
                }
            }
        }
        self
    }

    /// Adds a box that is seen from outside.
    pub fn cuboid(&mut self, min: DVec3, max: DVec3) -> &mut Self {
        for face in cuboid_faces(min, max) {
            self.quad(face);
        }
        self
    }

    /// Adds a box that is seen from inside.
    pub fn room(&mut self, min: DVec3, max: DVec3) -> &mut Self {
        for [a, b, c, d] in cuboid_faces(min, max) {
            self.quad([a, d, c, b]);
        }
        self
    }

    /// Adds another shape. Shading normals stay only when both have them.
    pub fn append(&mut self, other: &Self) -> &mut Self {
        let first = self.positions.len() as u32;
        let both = (self.positions.is_empty() || !self.normals.is_empty()) && !other.normals.is_empty();
        self.positions.extend_from_slice(&other.positions);
        if both {
            self.normals.extend_from_slice(&other.normals);
        } else {
            self.normals.clear();
        }
        self.triangles.extend(other.triangles.iter().map(|t| t.map(|v| v + first)));
        self
    }

    /// The shape with every position mapped; shading normals are dropped.
    pub fn mapped(&self, map: impl Fn(DVec3) -> DVec3) -> Self {
        Self {
            positions: self.positions.iter().map(|&p| map(p)).collect(),
            normals: Vec::new(),
            triangles: self.triangles.clone(),
        }
    }

    /// Gives every vertex the area-weighted mean normal of its triangles.
    pub fn smooth(&mut self) -> &mut Self {
        let mut sums = vec![DVec3::ZERO; self.positions.len()];
        for &triangle in &self.triangles {
            let [a, b, c] = triangle.map(|v| self.positions[v as usize]);
            let area_vector = (b - a).cross(c - a);
            for v in triangle {
                sums[v as usize] += area_vector;
            }
        }
        self.normals = sums.into_iter().map(|n| n.normalize_or_zero().as_vec3()).collect();
        self
    }

    /// Merges vertices at exactly the same position, and drops shading normals.
    pub fn weld(&mut self) -> &mut Self {
        let mut first_at = HashMap::with_capacity(self.positions.len());
        let mut positions = Vec::new();
        let mut target = Vec::with_capacity(self.positions.len());
        for &p in &self.positions {
            // Adding zero turns -0 into 0.
            let bits = (p + 0.0).to_array().map(f64::to_bits);
            target.push(*first_at.entry(bits).or_insert_with(|| {
                positions.push(p);
                positions.len() as u32 - 1
            }));
        }
        for triangle in &mut self.triangles {
            *triangle = triangle.map(|v| target[v as usize]);
        }
        self.positions = positions;
        self.normals.clear();
        self
    }

    /// The smallest box around all vertices; zero for no vertices.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let first = self.positions.first().copied().unwrap_or_default();
        self.positions.iter().fold((first, first), |(min, max), &p| (min.min(p), max.max(p)))
    }

    /// Total area, m².
    pub fn area(&self) -> f64 {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| self.positions[v as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        self.triangles.iter().map(area).sum()
    }

    /// Adds the shape to a scene.
    ///
    /// # Panics
    /// When `material` is not one of the builder's or an index is out of range.
    pub fn push_into(&self, builder: &mut SceneBuilder, name: &str, material: MaterialId) {
        let input = MeshInput {
            name,
            positions: &self.positions,
            normals: &self.normals,
            uvs: &[],
            triangles: &self.triangles,
            material,
        };
        if let Err(error) = builder.push_mesh(input) {
            panic!("procedural mesh: {error}");
        }
    }
}

/// The faces of a box, seen from outside: x-, x+, y-, y+, z-, z+.
pub(super) fn cuboid_faces(min: DVec3, max: DVec3) -> [[DVec3; 4]; 6] {
    let p = |x: usize, y: usize, z: usize| DVec3::new([min.x, max.x][x], [min.y, max.y][y], [min.z, max.z][z]);
    [
        [p(0, 0, 0), p(0, 0, 1), p(0, 1, 1), p(0, 1, 0)],
        [p(1, 0, 0), p(1, 1, 0), p(1, 1, 1), p(1, 0, 1)],
        [p(0, 0, 0), p(1, 0, 0), p(1, 0, 1), p(0, 0, 1)],
        [p(0, 1, 0), p(0, 1, 1), p(1, 1, 1), p(1, 1, 0)],
        [p(0, 0, 0), p(0, 1, 0), p(1, 1, 0), p(1, 0, 0)],
        [p(0, 0, 1), p(1, 0, 1), p(1, 1, 1), p(0, 1, 1)],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The signed volume by the divergence theorem; positive when the front is outside.
    fn volume(shape: &Shape) -> f64 {
        let part = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| shape.positions[v as usize]);
            a.dot(b.cross(c)) / 6.0
        };
        shape.triangles.iter().map(part).sum()
    }

    #[test]
    fn cuboids_face_outwards_and_rooms_inwards() {
        let (min, max) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(2.0, 4.0, 6.0));
        let mut shape = Shape::new();
        assert!((volume(shape.cuboid(min, max)) - 6.0).abs() < 1e-12);
        assert!((shape.area() - 22.0).abs() < 1e-12);
        assert!((volume(Shape::new().room(min, max)) + 6.0).abs() < 1e-12);
    }

    #[test]
    fn a_grid_has_the_front_of_its_quad() {
        let corners = [DVec3::ZERO, DVec3::X, DVec3::X + DVec3::Y, DVec3::Y];
        let mut grid = Shape::new();
        grid.grid(corners, 3, 5).smooth();
        assert_eq!(grid.triangles.len(), 30);
        assert!((grid.area() - 1.0).abs() < 1e-12);
        assert!(grid.normals.iter().all(|n| (*n - Vec3::Z).length() < 1e-6));
    }
}
