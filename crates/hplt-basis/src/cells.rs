use glam::{IVec3, Vec3};
use hplt_geom::OrientedPoint;

use crate::Footprint;

/// Functions that are looked at together.
const LANES: usize = 8;
const NONE: u32 = u32::MAX;
/// Supports are taken a little larger than they are, so that rounding loses nothing.
const MARGIN: f32 = 1.001;
/// The square of what a step of length one in the worst direction counts as in the sum that
/// [`Extent::contains`](hplt_geom::Extent::contains) compares with 1, `1 + (√2 - 1)²`, and a little more.
const SECTOR_MARGIN: f32 = 1.18;
/// Levels of more functions have no cells, which would take too much memory.
pub(crate) const MAX_FUNCTIONS: usize = 16_384;

/// The functions of one level, listed for every cell of a grid that their supports touch: one look finds all functions at a
/// point, side by side in memory. For the coarse levels that rays read millions of times.
#[derive(Debug)]
pub(crate) struct LevelCells {
    cells_per_unit: f32,
    /// Open-addressed, a power of two of them.
    slots: Vec<Slot>,
    blocks: Vec<Block>,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    cell: IVec3,
    first: u32,
    /// 0 where the slot is free.
    n_blocks: u32,
}

/// What decides about the weights of some functions, component by component.
#[derive(Debug, Clone, Copy)]
struct Block {
    position: [[f32; LANES]; 3],
    normal: [[f32; LANES]; 3],
    below: [f32; LANES],
    above: [f32; LANES],
    sight_height: [f32; LANES],
    region: [u32; LANES],
    function: [u32; LANES],
    /// The square of the largest of the inverse depths, and a little more: what is nearer than one over it is in sight.
    inverse_sight_squared: [f32; LANES],
}

impl Block {
    /// Lanes that no query is in.
    const EMPTY: Self = Self {
        position: [[0.0; LANES]; 3],
        normal: [[0.0; LANES]; 3],
        below: [-1.0; LANES],
        above: [-1.0; LANES],
        sight_height: [0.0; LANES],
        region: [0; LANES],
        function: [NONE; LANES],
        inverse_sight_squared: [0.0; LANES],
    };

    fn set(&mut self, lane: usize, function: u32, point: &OrientedPoint) {
        for axis in 0..3 {
            self.position[axis][lane] = point.position[axis];
            self.normal[axis][lane] = point.normal[axis];
        }
        self.below[lane] = point.extent.below;
        self.above[lane] = point.extent.above;
        self.sight_height[lane] = point.extent.sight_height;
        self.region[lane] = point.region.0;
        self.function[lane] = function;
        let inverse_sight = point.extent.inverse_depths.iter().fold(0.0, |largest: f32, d| largest.max(*d));
        self.inverse_sight_squared[lane] = SECTOR_MARGIN * inverse_sight * inverse_sight;
    }

    /// The weights at `query` of the functions, as far as sight along the surface does not forbid, and whether it may. Without
    /// branches, for all lanes at once.
    #[inline]
    fn weights(&self, query: &OrientedPoint, footprint: &Footprint) -> ([f32; LANES], [bool; LANES]) {
        let (p, n, free_height) = (query.position, query.normal, query.extent.free_height());
        let (mut distances, mut cosines, mut may_be_hidden) = ([0.0; LANES], [0.0; LANES], [false; LANES]);
        for k in 0..LANES {
            let (x, y, z) = (p.x - self.position[0][k], p.y - self.position[1][k], p.z - self.position[2][k]);
            let (nx, ny, nz) = (self.normal[0][k], self.normal[1][k], self.normal[2][k]);
            let height = x * nx + y * ny + z * nz;
            let straight = x * x + y * y + z * z;
            let cosine = n.x * nx + n.y * ny + n.z * nz;
            let is_there = (cosine > 0.0) & (self.region[k] == query.region.0);
            let is_in_layer = (-self.below[k] <= height) & (height <= self.above[k]);
            let is_free = free_height >= self.sight_height[k];
            cosines[k] = if is_there & is_in_layer & is_free { cosine } else { 0.0 };
            distances[k] = straight + 8.0 * height * height;
            may_be_hidden[k] = straight * self.inverse_sight_squared[k] > 1.0;
        }
        (footprint.weights(distances, cosines), may_be_hidden)
    }
}

impl LevelCells {
    /// Those of a level whose functions stand at `points`.
    pub(crate) fn build(points: &[OrientedPoint], footprint: &Footprint) -> Self {
        let cells_per_unit = 2.0 / footprint.support();
        let mut entries: Vec<([i32; 3], u32)> = Vec::new();
        for (i, point) in points.iter().enumerate() {
            touched_cells(point, footprint.support(), cells_per_unit, |cell| entries.push((cell.to_array(), i as u32)));
        }
        entries.sort_unstable();
        let groups: Vec<&[([i32; 3], u32)]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let free = Slot { cell: IVec3::ZERO, first: 0, n_blocks: 0 };
        let n_slots = (2 * groups.len()).next_power_of_two();
        let mut cells = Self { cells_per_unit, slots: vec![free; n_slots], blocks: Vec::new() };
        for group in groups {
            let cell = IVec3::from(group[0].0);
            let mut slot = hash(cell) & (n_slots - 1);
            while cells.slots[slot].n_blocks > 0 {
                slot = (slot + 1) & (n_slots - 1);
            }
            let n_blocks = group.len().div_ceil(LANES) as u32;
            cells.slots[slot] = Slot { cell, first: cells.blocks.len() as u32, n_blocks };
            for of_block in group.chunks(LANES) {
                let mut block = Block::EMPTY;
                for (lane, &(_, function)) in of_block.iter().enumerate() {
                    block.set(lane, function, &points[function as usize]);
                }
                cells.blocks.push(block);
            }
        }
        cells
    }

    /// Calls `visit(function, weight)` for every function whose weight at `query` is positive, ascending.
    #[inline]
    pub(crate) fn visit_weights(
        &self,
        points: &[OrientedPoint],
        footprint: &Footprint,
        query: &OrientedPoint,
        mut visit: impl FnMut(u32, f32),
    ) {
        for block in self.blocks_at(query.position) {
            let (weights, may_be_hidden) = block.weights(query, footprint);
            let mut positive = (0..LANES).fold(0u32, |bits, k| bits | u32::from(weights[k] > 0.0) << k);
            while positive != 0 {
                let k = positive.trailing_zeros() as usize % LANES;
                positive &= positive - 1;
                let function = block.function[k];
                if may_be_hidden[k] && !points[function as usize].is_continued_at(query) {
                    continue;
                }
                visit(function, weights[k]);
            }
        }
    }

    #[inline]
    fn blocks_at(&self, position: Vec3) -> &[Block] {
        let cell = cell_at(position, self.cells_per_unit);
        let mut i = hash(cell) & (self.slots.len() - 1);
        loop {
            let slot = &self.slots[i];
            if slot.n_blocks == 0 {
                return &[];
            }
            if slot.cell == cell {
                return &self.blocks[slot.first as usize..(slot.first + slot.n_blocks) as usize];
            }
            i = (i + 1) & (self.slots.len() - 1);
        }
    }

    pub(crate) fn memory(&self) -> usize {
        size_of_val(&self.slots[..]) + size_of_val(&self.blocks[..])
    }
}

#[inline]
fn cell_at(position: Vec3, cells_per_unit: f32) -> IVec3 {
    let p = position * cells_per_unit;
    // floor(), without a call on processors that lack the instruction.
    let truncated = p.as_ivec3();
    truncated - IVec3::from(p.cmplt(truncated.as_vec3()))
}

/// Calls `visit` for all cells that the support of the function at `point` may touch: a sphere cut to a layer, since heights
/// count three times.
fn touched_cells(point: &OrientedPoint, support: f32, cells_per_unit: f32, mut visit: impl FnMut(IVec3)) {
    let reach = support * MARGIN;
    let (low, high) =
        (cell_at(point.position - reach, cells_per_unit), cell_at(point.position + reach, cells_per_unit));
    let half = 0.5 / cells_per_unit;
    let layer = (reach / 3.0 + half * point.normal.abs().element_sum()) * MARGIN;
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = IVec3::new(x, y, z);
                let offset = (cell.as_vec3() + 0.5) / cells_per_unit - point.position;
                let to_cell = (offset.abs() - half).max(Vec3::ZERO);
                if to_cell.length_squared() <= reach * reach && offset.dot(point.normal).abs() <= layer {
                    visit(cell);
                }
            }
        }
    }
}

#[inline]
fn hash(cell: IVec3) -> usize {
    let [x, y, z] = cell.to_array().map(|c| c as u32);
    let mixed =
        x.wrapping_mul(0x9E37_79B1).wrapping_add(y.wrapping_mul(0x85EB_CA77)).wrapping_add(z.wrapping_mul(0xC2B2_AE3D));
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x27D4_EB2F);
    (mixed ^ (mixed >> 16)) as usize
}

#[cfg(test)]
mod tests {
    use hplt_geom::{Extent, N_SECTORS, PointHierarchy, PointLevel, RegionId, Rgb};

    use super::*;
    use crate::{BasisOptions, ShepardBasis, Weight, smoothstep};

    /// Numbers in `[0, 1)`.
    fn numbers(mut state: u32) -> impl FnMut() -> f32 {
        move || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / 16_777_216.0
        }
    }

    /// Functions in two regions, in thin and thick layers, some with walls nearby; near the axes and across them.
    fn functions(n: usize, seed: u32) -> Vec<OrientedPoint> {
        let mut next = numbers(seed);
        let point = |_| {
            let position = Vec3::new(next(), next(), 0.2 * next()) - 0.5;
            let normal = match next() {
                x if x < 0.4 => Vec3::Z,
                x if x < 0.6 => -Vec3::X,
                _ => (Vec3::new(next(), next(), next()) - 0.5).normalize(),
            };
            let mut extent = Extent { below: 0.01 + 0.1 * next(), above: 0.01 + 0.1 * next(), ..Extent::OPEN };
            if next() < 0.5 {
                extent.inverse_depths = [(); N_SECTORS].map(|()| (20.0 * next() - 10.0).max(0.0));
                extent.sight_height = 0.01 * next();
            }
            OrientedPoint { extent, ..OrientedPoint::new(position, normal, RegionId(u32::from(next() < 0.3))) }
        };
        (0..n).map(point).collect()
    }

    fn basis(options: BasisOptions) -> ShepardBasis {
        let levels = vec![PointLevel::new(0.05, functions(3000, 1))];
        ShepardBasis::build(PointHierarchy { levels, n_regions: 2 }, options)
    }

    /// The cells find the functions that the kd-tree finds, with the same bits of weights, with the usual kernel and another.
    #[test]
    fn cells_give_the_weights_of_the_tree() {
        let linear = |h: f32| (1.0 - h).max(0.0);
        for options in [BasisOptions::default(), BasisOptions { kernel: linear, ..BasisOptions::default() }] {
            let basis = basis(options);
            let (footprint, points) = (basis.footprint(0), basis.points(0));
            let cells = LevelCells::build(points, &footprint);
            let (mut expected, mut n_found) = (Vec::new(), 0);
            for (i, query) in functions(4000, 2).into_iter().enumerate() {
                let free = Extent::of_query(if i % 2 == 0 { f32::INFINITY } else { 0.01 });
                let query = OrientedPoint { extent: free, ..query };
                basis.raw_weights(0, &query, &mut expected);
                expected.sort_by_key(|w| w.function);
                let mut found = Vec::new();
                cells.visit_weights(points, &footprint, &query, |function, weight| {
                    found.push(Weight { function, weight })
                });
                assert_eq!(found, expected, "{query:?}");
                n_found += found.len();
            }
            assert!(n_found > 10_000, "{n_found}");
        }
    }

    #[test]
    fn blends_are_weighted_sums() {
        let basis = basis(BasisOptions { kernel: smoothstep, ..BasisOptions::default() });
        let mut next = numbers(3);
        let coefficients: Vec<Rgb> = (0..3000).map(|_| Rgb::new(next(), next(), -next())).collect();
        let mut weights = Vec::new();
        let mut n_covered = 0;
        for query in functions(2000, 4) {
            let expected =
                basis.weights(0, &query, &mut weights).then(|| crate::reconstruction::combine(&weights, &coefficients));
            let blended = basis.blend(0, &query, &coefficients, &mut weights);
            assert_eq!(blended.is_some(), expected.is_some());
            if let (Some(blended), Some(expected)) = (blended, expected) {
                assert!(blended.abs_diff_eq(expected, 2e-6), "{blended} {expected}");
                n_covered += 1;
            }
        }
        assert!((100..2000).contains(&n_covered), "{n_covered}");
    }
}
