use glam::Vec3;

/// Planes of a shaft at most: sides of a polygon of six corners, and two more.
const MAX_PLANES: usize = 8;
/// Distance by which a shaft is fattened, over its largest coordinate, so that rounding never makes it miss anything.
const SLACK: f32 = 1e-6;

/// The solid that all segments from a point to a convex polygon fill (Haines & Wallace, "Shaft Culling for Efficient Ray-Traced
/// Radiosity", 1991), a little fattened. Scene space.
#[derive(Debug, Clone, Copy)]
pub struct Shaft {
    /// Unit normals, inwards, and offsets: inside is `normal·x + offset >= 0`.
    planes: [(Vec3, f32); MAX_PLANES],
    n_planes: usize,
    pub(crate) min: Vec3,
    pub(crate) max: Vec3,
    slack: f32,
}

impl Shaft {
    /// From `apex` to the convex `polygon` of 3 to 6 corners, either way round.
    pub fn new(apex: Vec3, polygon: &[Vec3]) -> Self {
        debug_assert!((3..=MAX_PLANES - 2).contains(&polygon.len()));
        let corners = || polygon.iter().copied().chain([apex]);
        let (min, max) = corners().fold((apex, apex), |(min, max), p| (min.min(p), max.max(p)));
        let slack = SLACK * min.abs().max(max.abs()).max_element();
        let mut shaft = Self {
            planes: [(Vec3::ZERO, 0.0); MAX_PLANES],
            n_planes: 0,
            min: min - Vec3::splat(slack),
            max: max + Vec3::splat(slack),
            slack,
        };
        let inside = polygon.iter().sum::<Vec3>() / polygon.len() as f32;
        for (i, &a) in polygon.iter().enumerate() {
            let b = polygon[(i + 1) % polygon.len()];
            let normal = (a - apex).cross(b - apex).normalize_or_zero();
            shaft.cut(apex, if normal.dot(inside - apex) < 0.0 { -normal } else { normal });
        }
        shaft
    }

    /// Leaves only what is on the side of the plane through `point` that `normal`, of unit length, points to. At most two such cuts.
    pub fn cut(&mut self, point: Vec3, normal: Vec3) {
        self.planes[self.n_planes] = (normal, -normal.dot(point));
        self.n_planes += 1;
    }

    pub(crate) fn planes(&self) -> impl Iterator<Item = (Vec3, f32)> + '_ {
        self.planes[..self.n_planes].iter().map(|&(normal, offset)| (normal, offset + self.slack))
    }
}
