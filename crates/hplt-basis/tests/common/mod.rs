//! Points for bases to stand on.

use glam::Vec3;
use hplt_geom::{OrientedPoint, PointHierarchy, PointLevel, RegionId};

/// A small deterministic generator for test positions.
pub struct Noise(u64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// A number in `[0, 1)`.
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }
}

pub fn point(x: f32, z: f32, normal: Vec3, region: u32, area: f32) -> OrientedPoint {
    OrientedPoint::new(Vec3::new(x, 0.0, z), normal, RegionId(region)).with_area(area)
}

/// `n_levels` jittered grids over the unit square, `n`, `2n`, `4n` … cells across, `r` a cell wide.
pub fn plane(n: usize, n_levels: usize, normal: Vec3, region: u32) -> PointHierarchy {
    let mut noise = Noise::new(7);
    let levels = (0..n_levels).map(|l| {
        let cells = n << l;
        let size = 1.0 / cells as f32;
        let points = (0..cells * cells).map(|i| {
            let x = ((i % cells) as f32 + 0.3 + 0.4 * noise.next()) * size;
            let z = ((i / cells) as f32 + 0.3 + 0.4 * noise.next()) * size;
            point(x, z, normal, region, size * size)
        });
        PointLevel::new(size, points.collect())
    });
    PointHierarchy { levels: levels.collect(), n_regions: region + 1 }
}
