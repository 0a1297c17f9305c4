use glam::{DVec3, Vec3};

/// How many triangles face away from the mean of their vertex normals.
pub(crate) fn winding_disagreements(positions: &[Vec3], normals: &[Vec3], triangles: &[[u32; 3]]) -> u64 {
    if normals.is_empty() {
        return 0;
    }
    let disagrees = |triangle: &&[u32; 3]| {
        let [a, b, c] = triangle.map(|v| positions[v as usize].as_dvec3());
        let mean: DVec3 = triangle.iter().map(|&v| normals[v as usize].as_dvec3()).sum();
        (b - a).cross(c - a).dot(mean) < 0.0
    };
    triangles.iter().filter(disagrees).count() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_wound_against_its_normals_counts() {
        let positions = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let triangles = [[0, 1, 2], [0, 2, 1]];
        assert_eq!(winding_disagreements(&positions, &[Vec3::Z; 3], &triangles), 1);
        assert_eq!(winding_disagreements(&positions, &[Vec3::NAN; 3], &triangles), 0);
        assert_eq!(winding_disagreements(&positions, &[], &triangles), 0);
    }
}
