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

/// Heights along a point's normal between which surface counts as the same layer as the point's own: half-way to the next
/// surface above and below. It keeps parallel layers that face the same way apart: a lamp and the ceiling that it hangs
/// under, the folds of a curtain, the pages of a book. Scene units.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Slab {
    /// How far it reaches against the normal; positive.
    pub below: f32,
    /// How far it reaches along the normal; positive.
    pub above: f32,
}

impl Slab {
    /// Every height.
    pub const OPEN: Self = Self { below: f32::INFINITY, above: f32::INFINITY };

    /// Whether the slab reaches to `height`.
    pub fn contains(&self, height: f32) -> bool {
        -self.below <= height && height <= self.above
    }
}

/// A point on one side of the surface. 40 bytes, scene space.
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
    /// What belongs to the point's own layer; of no meaning for a query.
    pub slab: Slab,
}

impl OrientedPoint {
    /// A point that stands for no area, its slab open: a query, or a function still to be measured.
    pub const fn new(position: Vec3, normal: Vec3, region: RegionId) -> Self {
        Self { position, normal, region, area: 0.0, slab: Slab::OPEN }
    }

    /// The same point, standing for `area` of surface.
    pub const fn with_area(self, area: f32) -> Self {
        Self { area, ..self }
    }

    /// Whether `other` is in the same region, on the same side and in the same layer.
    pub fn is_continued_at(&self, other: &Self) -> bool {
        self.region == other.region
            && self.normal.dot(other.normal) > 0.0
            && self.slab.contains((other.position - self.position).dot(self.normal))
    }
}

/// One level: a maximal Poisson-disk set of oriented points.
#[derive(Debug, Clone, PartialEq)]
pub struct PointLevel {
    /// The Poisson radius `r`, scene units.
    pub poisson_radius: f32,
    /// The points, in a spatially coherent order.
    pub points: Vec<OrientedPoint>,
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
