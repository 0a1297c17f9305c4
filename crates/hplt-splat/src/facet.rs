use glam::Vec3;

/// Share of the distance between two points of one smooth piece of surface that their mean plane may be off it.
const SAME_PLANE: f32 = 0.1;

/// Least cosine between the normals of neighbours on one piece of surface, which may be round.
pub(crate) const SAME_NORMAL: f32 = 0.9;

/// A point of a surface.
#[derive(Clone, Copy)]
pub(crate) struct Facet {
    /// Scene space.
    pub position: Vec3,
    /// Geometric and shading, unit.
    pub normals: [Vec3; 2],
}

impl Facet {
    /// Whether `other` is on the smooth piece of surface around this one, on which normals differ by at most `least_cosine`. Surface may
    /// curve: the plane that must go through both is that between theirs.
    pub fn continues_at(&self, other: &Self, least_cosine: f32) -> bool {
        let offset = other.position - self.position;
        let normal = (self.normals[0] + other.normals[0]).normalize_or_zero();
        self.normals.iter().zip(other.normals).all(|(&a, b)| a.dot(b) >= least_cosine)
            && offset.dot(normal).abs() <= SAME_PLANE * offset.length()
    }
}
