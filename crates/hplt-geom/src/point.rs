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

/// A point on one side of the surface. 32 bytes, scene space.
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
