//! Connected parts of a mesh.

use glam::Vec3;
use hplt_geom::Mesh;

use crate::surface::{Side, SideSampler};
use crate::union_find::UnionFind;

const NONE: u32 = u32::MAX;

/// The connected components of a mesh: of triangles that share a vertex position.
#[derive(Debug)]
pub(crate) struct Components {
    /// The number of each triangle's component.
    pub of_triangle: Vec<u32>,
    /// How many there are.
    pub n: usize,
}

impl Components {
    /// Those of `mesh`, numbered by their first triangles.
    pub(crate) fn find(mesh: &Mesh) -> Self {
        let mut vertices = UnionFind::new(mesh.positions().len());
        for &[a, b, c] in mesh.triangles() {
            vertices.union(a, b);
            vertices.union(a, c);
        }
        weld(mesh.positions(), &mut vertices);
        let mut numbers = vec![NONE; mesh.positions().len()];
        let mut n = 0;
        let number_of = |t: &[u32; 3]| {
            let number = &mut numbers[vertices.find(t[0]) as usize];
            if *number == NONE {
                *number = n;
                n += 1;
            }
            *number
        };
        let of_triangle = mesh.triangles().iter().map(number_of).collect();
        Self { of_triangle, n: n as usize }
    }

    /// The sides to put an extra point on so that no part of the scene stays without: on each component that expects fewer
    /// than `enough` of `n_points` uniform points, the largest front side and the largest back side. At most `limit`.
    pub(crate) fn small_sides(&self, sampler: &SideSampler, n_points: usize, enough: f64, limit: usize) -> Vec<Side> {
        let mut areas = vec![[0.0f64; 2]; self.n];
        let mut largest = vec![[(0.0f64, usize::MAX); 2]; self.n];
        for (i, side) in sampler.sides().iter().enumerate() {
            let component = self.of_triangle[side.triangle.index()] as usize;
            let (face, area) = (usize::from(side.is_front), sampler.area_of(i));
            areas[component][face] += area;
            if area > largest[component][face].0 || largest[component][face].1 == usize::MAX {
                largest[component][face] = (area, i);
            }
        }
        let needed = enough * sampler.area() / n_points.max(1) as f64;
        let both = areas.iter().flatten().zip(largest.iter().flatten());
        let small = both.filter(|&(&area, &(_, side))| side != usize::MAX && area < needed);
        small.map(|(_, &(_, side))| sampler.sides()[side]).take(limit).collect()
    }
}

/// Joins vertices at the same position: an open-addressed table of the first vertex at each.
fn weld(positions: &[Vec3], vertices: &mut UnionFind) {
    let n_slots = (2 * positions.len()).next_power_of_two();
    let mut firsts = vec![NONE; n_slots];
    for (i, &position) in positions.iter().enumerate() {
        // Adding zero makes -0 and 0 one position.
        let [x, y, z] = (position + Vec3::ZERO).to_array().map(|c| u64::from(c.to_bits()));
        let mixed = (x ^ y.rotate_left(21) ^ z.rotate_left(42)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let mut slot = (mixed >> 32) as usize & (n_slots - 1);
        while firsts[slot] != NONE && positions[firsts[slot] as usize] != position {
            slot = (slot + 1) & (n_slots - 1);
        }
        if firsts[slot] == NONE {
            firsts[slot] = i as u32;
        } else {
            vertices.union(firsts[slot], i as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use hplt_geom::{BuildPolicy, Material, MeshInput, Rgb, SceneBuilder};

    use super::*;

    /// Two triangles that share an edge by position only, -0 against 0 included, one that touches nothing, and one that shares
    /// a vertex by index with the first.
    #[test]
    fn triangles_at_the_same_position_are_connected() {
        let corners = [
            [0.0, 0.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [1.0, -0.0, 0.0],
            [1.0, 1.0, 0.0],
            [0.0, 1.0, -0.0],
            [5.0, 0.0, 0.0],
            [6.0, 0.0, 0.0],
            [5.0, 1.0, 0.0],
            [-1.0, -1.0, 2.0],
            [-1.0, 0.0, 2.0],
        ];
        let positions = corners.map(DVec3::from);
        let mut builder = SceneBuilder::new();
        let material = builder.push_material(Material::diffuse("grey", Rgb::splat(0.5)));
        let triangles = [[0, 1, 2], [3, 4, 5], [6, 7, 8], [0, 9, 10]];
        let mesh =
            MeshInput { name: "four", positions: &positions, normals: &[], uvs: &[], triangles: &triangles, material };
        builder.push_mesh(mesh).unwrap();
        let (scene, _) = builder.build(BuildPolicy::default()).unwrap();
        let components = Components::find(scene.mesh());
        assert_eq!((components.of_triangle, components.n), (vec![0, 0, 1, 0], 2));
    }
}
