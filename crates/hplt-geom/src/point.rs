use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// A connected part of the air: points of one region can exchange light, directly or by way of each other; points of
/// different regions cannot. Two sides of a wall between closed rooms are in different regions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Pod, Zeroable)]
#[repr(transparent)]
pub struct RegionId(pub u32);

impl RegionId {
    /// A region that no light reaches. Irradiance there is exactly zero.
    pub const DARK: Self = Self(u32::MAX);
}

/// Directions in the tangent plane along which [`Extent`] is measured: every 45°, from the first tangent on.
pub const N_SECTORS: usize = 8;

/// How far the surface around a point counts as the point's own, seen from the point. Scene units.
///
/// Along the normal it is a layer, half-way to the next surface above and below: that keeps parallel layers that face the
/// same way apart, a lamp and the ceiling that it hangs under, the folds of a curtain. In the tangent plane it is the
/// star-shaped polygon through what short rays just above the surface meet: a floor that runs on under a wall, or into a
/// box that stands on it, ends there.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Extent {
    /// How far it reaches against the normal; positive.
    pub below: f32,
    /// How far it reaches along the normal; positive.
    pub above: f32,
    /// How high above the surface the rays in the tangent plane ran; what is nearer to the surface than that they have not
    /// seen. 0 where there were none.
    pub sight_height: f32,
    /// One over the distance to what the ray along each sector direction meets; 0 where that is nothing.
    pub inverse_depths: [f32; N_SECTORS],
}

impl Extent {
    /// Everywhere.
    pub const OPEN: Self =
        Self { below: f32::INFINITY, above: f32::INFINITY, sight_height: 0.0, inverse_depths: [0.0; N_SECTORS] };

    /// That of a query with free air up to `height` above it, along its normal.
    pub const fn of_query(height: f32) -> Self {
        Self { above: 0.5 * height, ..Self::OPEN }
    }

    /// The height of the free air above the point, along its normal.
    pub fn free_height(&self) -> f32 {
        2.0 * self.above
    }

    /// The directions of the sectors around a unit `normal`.
    pub fn sector_directions(normal: Vec3) -> [Vec3; N_SECTORS] {
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        let between = std::f32::consts::FRAC_1_SQRT_2;
        let half = [tangent, between * (tangent + bitangent), bitangent, between * (bitangent - tangent)];
        [half[0], half[1], half[2], half[3], -half[0], -half[1], -half[2], -half[3]]
    }

    /// Whether `offset` from the point, whose unit normal is `normal`, is inside.
    #[inline]
    pub fn contains(&self, offset: Vec3, normal: Vec3) -> bool {
        let height = offset.dot(normal);
        -self.below <= height && height <= self.above && self.is_in_sight(offset, normal)
    }

    #[inline]
    fn is_in_sight(&self, offset: Vec3, normal: Vec3) -> bool {
        if self.inverse_depths.iter().fold(0.0, |largest: f32, d| largest.max(*d)) == 0.0 {
            return true;
        }
        let (tangent, bitangent) = normal.any_orthonormal_pair();
        self.part_of_sight(offset.dot(tangent), offset.dot(bitangent)) <= 1.0
    }

    /// How far an offset with these coordinates in the tangent plane goes, as a part of what is in sight in its direction; linear
    /// between the directions of the sectors.
    #[inline]
    fn part_of_sight(&self, x: f32, y: f32) -> f32 {
        let along_x = if x >= 0.0 { 0 } else { 4 };
        let along_y = if y >= 0.0 { 2 } else { 6 };
        let diagonal = match (x >= 0.0, y >= 0.0) {
            (true, true) => 1,
            (false, true) => 3,
            (false, false) => 5,
            (true, false) => 7,
        };
        // The offset as a sum of steps along the two directions beside it; the chord between the ends of those two rays is
        // where the steps, each over its ray's length, add up to one.
        let (x, y) = (x.abs(), y.abs());
        let (axis, long, short) = if x >= y { (along_x, x, y) } else { (along_y, y, x) };
        let step = std::f32::consts::SQRT_2 * short;
        (long - short) * self.inverse_depths[axis] + step * self.inverse_depths[diagonal]
    }

    /// Whether every offset between `low` and `high` is outside, and not so near to the edge that rounding would decide. In
    /// coordinates along the first and the third of the [sector directions](Self::sector_directions) and the normal.
    pub fn misses_box(&self, low: Vec3, high: Vec3) -> bool {
        high.z < -self.below || low.z > self.above || self.least_part_of_sight(low, high) > 1.0 + SIGHT_TOLERANCE
    }

    /// The least [`part_of_sight`](Self::part_of_sight) in a box. Being linear in every sector, it is at a corner of the box, where
    /// an edge crosses the direction of a sector, or at the point itself.
    fn least_part_of_sight(&self, low: Vec3, high: Vec3) -> f32 {
        let (x_in, y_in) = (|x: f32| x.clamp(low.x, high.x), |y: f32| y.clamp(low.y, high.y));
        let on_left_and_right =
            [low.x, high.x].into_iter().flat_map(|x| [low.y, high.y, y_in(0.0), y_in(x), y_in(-x)].map(|y| (x, y)));
        let on_the_others = [low.y, high.y].into_iter().flat_map(|y| [x_in(0.0), x_in(y), x_in(-y)].map(|x| (x, y)));
        let center = self.part_of_sight(x_in(0.0), y_in(0.0));
        on_left_and_right.chain(on_the_others).fold(center, |least, (x, y)| least.min(self.part_of_sight(x, y)))
    }
}

/// What rounding may make of a [`part_of_sight`](Extent::part_of_sight) about 1, and more.
const SIGHT_TOLERANCE: f32 = 1e-3;

/// A point on one side of the surface. 76 bytes, scene space.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct OrientedPoint {
    /// Position.
    pub position: Vec3,
    /// Unit normal, on the side that is meant.
    pub normal: Vec3,
    /// The region of the air that this side faces.
    pub region: RegionId,
    /// The area of surface that the point stands for, scene units squared; 0 where that has no meaning.
    pub area: f32,
    /// The surface around that is the point's own; of a query, only the free height counts, and open stands for not known.
    pub extent: Extent,
}

impl OrientedPoint {
    /// A point that stands for no area, its extent open: a query, or a function still to be measured.
    pub const fn new(position: Vec3, normal: Vec3, region: RegionId) -> Self {
        Self { position, normal, region, area: 0.0, extent: Extent::OPEN }
    }

    /// The same point, standing for `area` of surface.
    pub const fn with_area(self, area: f32) -> Self {
        Self { area, ..self }
    }

    /// Whether `other` is in the same region, on the same side and within the extent of this point, and not below something
    /// that the sight of this point passes over.
    #[inline]
    pub fn is_continued_at(&self, other: &Self) -> bool {
        self.region == other.region
            && self.normal.dot(other.normal) > 0.0
            && other.extent.free_height() >= self.extent.sight_height
            && self.extent.contains(other.position - self.position, self.normal)
    }
}

/// One level: a maximal Poisson-disk set of oriented points.
#[derive(Debug, Clone, PartialEq)]
pub struct PointLevel {
    /// The Poisson radius `r`, scene units.
    pub poisson_radius: f32,
    /// The points, in a spatially coherent order.
    pub points: Vec<OrientedPoint>,
    /// Whether the next finer level covers the surroundings of each point; empty when it covers everything.
    pub is_refined: Vec<bool>,
}

impl PointLevel {
    /// A level whose every point the next finer level, if any, covers.
    pub const fn new(poisson_radius: f32, points: Vec<OrientedPoint>) -> Self {
        Self { poisson_radius, points, is_refined: Vec::new() }
    }

    /// Whether the next finer level covers the surroundings of point `i`.
    pub fn is_refined(&self, i: u32) -> bool {
        self.is_refined.get(i as usize).copied().unwrap_or(true)
    }
}

/// Levels of points over the reachable surface, coarsest first, radii halving from level to level.
#[derive(Debug, Clone, PartialEq)]
pub struct PointHierarchy {
    /// The levels; at least one, none empty unless nothing is reachable.
    pub levels: Vec<PointLevel>,
    /// Regions that light reaches: region ids are below this.
    pub n_regions: u32,
}

impl PointHierarchy {
    /// Points on all levels together.
    pub fn n_points(&self) -> usize {
        self.levels.iter().map(|level| level.points.len()).sum()
    }

    /// Bytes that the points take.
    pub fn memory(&self) -> usize {
        self.n_points() * size_of::<OrientedPoint>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::test_scenes::Random;

    /// A box that is missed holds no offset inside.
    #[test]
    fn boxes_are_missed_where_all_of_them_is_outside() {
        let mut random = Random::new(1);
        let mut next = || random.unit();
        let (mut n_missed, mut n_touched) = (0, 0);
        for _ in 0..2000 {
            let inverse_depths = [(); N_SECTORS].map(|()| (12.0 * next() - 4.0).max(0.0));
            let extent = Extent { below: 0.3 * next(), above: 0.3 * next(), inverse_depths, ..Extent::OPEN };
            let normal = (Vec3::new(next(), next(), next()) - 0.5).normalize();
            let [tangent, _, bitangent, ..] = Extent::sector_directions(normal);
            let low = Vec3::new(next(), next(), next()) - 0.6;
            let size = 0.4 * Vec3::new(next(), next(), next());
            let touches = (0..200).any(|_| {
                let p = low + size * Vec3::new(next(), next(), next());
                extent.contains(p.x * tangent + p.y * bitangent + p.z * normal, normal)
            });
            let misses = extent.misses_box(low, low + size);
            assert!(!(misses && touches), "{extent:?} {low} {size}");
            n_missed += usize::from(misses);
            n_touched += usize::from(touches);
        }
        // What is neither is the price of rounding and of too few offsets.
        assert!(n_missed + n_touched > 1900 && n_missed > 300, "{n_missed} {n_touched}");
    }
}
