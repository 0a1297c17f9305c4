use glam::{IVec3, Vec3};
use hplt_geom::{Extent, OrientedPoint, RegionId, Rgb};
use wide::f32x8;

use crate::Footprint;

/// Functions or queries that are looked at together.
const LANES: usize = 8;
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
    /// One per function.
    sights: Vec<Sight>,
}

/// A cell, as far as it is in one region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Key {
    cell: [i32; 3],
    region: RegionId,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    key: Key,
    first: u32,
    /// 0 where the slot is free.
    n_functions: u32,
}

/// Positions and normals, component by component.
#[derive(Debug, Clone, Copy)]
struct Lanes {
    position: [f32x8; 3],
    normal: [f32x8; 3],
}

impl Lanes {
    const EMPTY: Self = Self { position: [f32x8::ZERO; 3], normal: [f32x8::ZERO; 3] };

    #[inline]
    fn set(&mut self, lane: usize, point: &OrientedPoint) {
        for axis in 0..3 {
            self.position[axis].as_mut_array()[lane] = point.position[axis];
            self.normal[axis].as_mut_array()[lane] = point.normal[axis];
        }
    }

    /// The same point in every lane.
    #[inline]
    fn splat(position: Vec3, normal: Vec3) -> Self {
        Self { position: splat(position), normal: splat(normal) }
    }
}

/// Functions of a cell.
#[derive(Debug, Clone, Copy)]
struct Block {
    lanes: Lanes,
    below: f32x8,
    above: f32x8,
    sight_height: f32x8,
    /// The square of the largest of the inverse depths, and a little more: what is nearer than one over it is in sight.
    inverse_sight_squared: f32x8,
    function: [u32; LANES],
}

impl Block {
    /// Lanes that no query is in.
    const EMPTY: Self = Self {
        lanes: Lanes::EMPTY,
        below: f32x8::ZERO,
        above: f32x8::ZERO,
        sight_height: f32x8::ZERO,
        inverse_sight_squared: f32x8::ZERO,
        function: [0; LANES],
    };

    fn set(&mut self, lane: usize, function: u32, point: &OrientedPoint) {
        self.lanes.set(lane, point);
        self.below.as_mut_array()[lane] = point.extent.below;
        self.above.as_mut_array()[lane] = point.extent.above;
        self.sight_height.as_mut_array()[lane] = point.extent.sight_height;
        let inverse_sight = point.extent.inverse_depths.iter().fold(0.0, |largest: f32, d| largest.max(*d));
        self.inverse_sight_squared.as_mut_array()[lane] = SECTOR_MARGIN * inverse_sight * inverse_sight;
        self.function[lane] = function;
    }

    /// One of the functions, in every lane.
    #[inline]
    fn splat(&self, lane: usize) -> Self {
        let of = |x: &f32x8| f32x8::splat(x.as_array()[lane]);
        let Lanes { position: [x, y, z], normal: [nx, ny, nz] } = &self.lanes;
        Self {
            lanes: Lanes { position: [of(x), of(y), of(z)], normal: [of(nx), of(ny), of(nz)] },
            below: of(&self.below),
            above: of(&self.above),
            sight_height: of(&self.sight_height),
            inverse_sight_squared: of(&self.inverse_sight_squared),
            function: [self.function[lane]; LANES],
        }
    }

    /// The weights of the functions at the queries, lane by lane, as far as sight along the surface does not forbid, and a mask
    /// of where it may.
    #[inline]
    fn weights(&self, queries: &Lanes, free_height: f32x8, footprint: &Footprint) -> (f32x8, f32x8) {
        let offset = offset(queries, &self.lanes);
        let height = dot(offset, self.lanes.normal);
        let straight = dot(offset, offset);
        let cosine = dot(queries.normal, self.lanes.normal);
        let is_in_layer = height.simd_ge(-self.below) & height.simd_le(self.above);
        let is_there = cosine.simd_gt(f32x8::ZERO) & is_in_layer & free_height.simd_ge(self.sight_height);
        let weights = footprint.weights(straight + height * height * 8.0, cosine & is_there);
        let is_far = (straight * self.inverse_sight_squared).simd_gt(f32x8::ONE);
        (weights, is_far & weights.simd_gt(f32x8::ZERO))
    }
}

/// What a function's sight along the surface is measured in.
#[derive(Debug, Clone, Copy)]
struct Sight {
    tangent: Vec3,
    bitangent: Vec3,
    inverse_depths: [f32; hplt_geom::N_SECTORS],
}

impl Sight {
    fn of(point: &OrientedPoint) -> Self {
        let [tangent, _, bitangent, ..] = Extent::sector_directions(point.normal);
        Self { tangent, bitangent, inverse_depths: point.extent.inverse_depths }
    }

    /// [`Extent::contains`](hplt_geom::Extent::contains), as far as the tangent plane is concerned, of eight offsets.
    #[inline]
    fn reaches(&self, offset: [f32x8; 3]) -> f32x8 {
        let inverse_depth = |sector: usize| f32x8::splat(self.inverse_depths[sector]);
        let (x, y) = (dot(offset, splat(self.tangent)), dot(offset, splat(self.bitangent)));
        let (right, up) = (x.simd_ge(f32x8::ZERO), y.simd_ge(f32x8::ZERO));
        let along_x = right.bitselect(inverse_depth(0), inverse_depth(4));
        let along_y = up.bitselect(inverse_depth(2), inverse_depth(6));
        let above = right.bitselect(inverse_depth(1), inverse_depth(3));
        let below = right.bitselect(inverse_depth(7), inverse_depth(5));
        let diagonal = up.bitselect(above, below);
        let (x, y) = (x.abs(), y.abs());
        let is_along_x = x.simd_ge(y);
        let (long, short) = (is_along_x.bitselect(x, y), is_along_x.bitselect(y, x));
        let step = short * std::f32::consts::SQRT_2;
        ((long - short) * is_along_x.bitselect(along_x, along_y) + step * diagonal).simd_le(f32x8::ONE)
    }
}

#[inline]
fn splat(v: Vec3) -> [f32x8; 3] {
    [f32x8::splat(v.x), f32x8::splat(v.y), f32x8::splat(v.z)]
}

#[inline]
fn dot(a: [f32x8; 3], b: [f32x8; 3]) -> f32x8 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline]
fn offset(queries: &Lanes, functions: &Lanes) -> [f32x8; 3] {
    let (q, f) = (&queries.position, &functions.position);
    [q[0] - f[0], q[1] - f[1], q[2] - f[2]]
}

impl LevelCells {
    /// Those of a level whose functions stand at `points`.
    pub(crate) fn build(points: &[OrientedPoint], footprint: &Footprint) -> Self {
        let cells_per_unit = 2.0 / footprint.support();
        let mut entries: Vec<(Key, u32)> = Vec::new();
        for (i, point) in points.iter().enumerate() {
            touched_cells(point, footprint.support(), cells_per_unit, |cell| {
                entries.push((Key { cell: cell.to_array(), region: point.region }, i as u32));
            });
        }
        entries.sort_unstable();
        let groups: Vec<&[(Key, u32)]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let free = Slot { key: Key { cell: [0; 3], region: RegionId(0) }, first: 0, n_functions: 0 };
        let n_slots = (2 * groups.len()).next_power_of_two();
        let sights = points.iter().map(Sight::of).collect();
        let mut cells = Self { cells_per_unit, slots: vec![free; n_slots], blocks: Vec::new(), sights };
        for group in groups {
            let key = group[0].0;
            let mut slot = hash(key) & (n_slots - 1);
            while cells.slots[slot].n_functions > 0 {
                slot = (slot + 1) & (n_slots - 1);
            }
            cells.slots[slot] = Slot { key, first: cells.blocks.len() as u32, n_functions: group.len() as u32 };
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
        let Some(slot) = self.slot_of(query) else { return };
        let lanes = Lanes::splat(query.position, query.normal);
        let free_height = f32x8::splat(query.extent.free_height());
        for block in self.blocks_of(slot) {
            let (weights, may_be_hidden) = block.weights(&lanes, free_height, footprint);
            let (mut positive, may_be_hidden) =
                (weights.simd_gt(f32x8::ZERO).to_bitmask(), may_be_hidden.to_bitmask());
            while positive != 0 {
                let k = positive.trailing_zeros() as usize % LANES;
                positive &= positive - 1;
                let function = block.function[k];
                if may_be_hidden & 1 << k != 0 && !points[function as usize].is_continued_at(query) {
                    continue;
                }
                visit(function, weights.as_array()[k]);
            }
        }
    }

    /// `(Σ w_i α_i, Σ w_i)` at each of `queries`, the `α` being `coefficients`: the same bits as from
    /// [`visit_weights`](Self::visit_weights), with one look at a cell for all queries in it. Zero in dark regions.
    pub(crate) fn sums(
        &self,
        footprint: &Footprint,
        queries: &[OrientedPoint],
        coefficients: &[Rgb],
    ) -> Vec<(Rgb, f32)> {
        let mut keys = Vec::with_capacity(queries.len());
        for (i, query) in queries.iter().enumerate() {
            keys.extend(self.slot_of(query).map(|slot| (slot as u64) << 32 | i as u64));
        }
        keys.sort_unstable();
        let mut out = vec![(Rgb::ZERO, 0.0); queries.len()];
        for of_slot in keys.chunk_by(|a, b| a >> 32 == b >> 32) {
            let slot = (of_slot[0] >> 32) as usize;
            for keys in of_slot.chunks(LANES) {
                self.sum_together(slot, footprint, queries, coefficients, keys, &mut out);
            }
        }
        out
    }

    /// [`sums`](Self::sums) of some queries of the same cell, no more than there are lanes: those that the lower halves of
    /// `keys` name.
    #[inline]
    fn sum_together(
        &self,
        slot: usize,
        footprint: &Footprint,
        queries: &[OrientedPoint],
        coefficients: &[Rgb],
        keys: &[u64],
        out: &mut [(Rgb, f32)],
    ) {
        let (mut lanes, mut free_height) = (Lanes::EMPTY, f32x8::ZERO);
        for (lane, &key) in keys.iter().enumerate() {
            let query = &queries[key as u32 as usize];
            lanes.set(lane, query);
            free_height.as_mut_array()[lane] = query.extent.free_height();
        }
        let (mut value, mut sum) = ([f32x8::ZERO; 3], f32x8::ZERO);
        let n_functions = self.slots[slot].n_functions as usize;
        for (i, block) in self.blocks_of(slot).iter().enumerate() {
            for k in 0..LANES.min(n_functions - i * LANES) {
                let function = block.splat(k);
                let (mut weights, may_be_hidden) = function.weights(&lanes, free_height, footprint);
                let id = block.function[k] as usize;
                if may_be_hidden.any() {
                    let reaches = self.sights[id].reaches(offset(&lanes, &function.lanes));
                    weights = (may_be_hidden & !reaches).bitselect(f32x8::ZERO, weights);
                }
                let coefficient = splat(coefficients[id]);
                for channel in 0..3 {
                    value[channel] += coefficient[channel] * weights;
                }
                sum += weights;
            }
        }
        for (lane, &key) in keys.iter().enumerate() {
            let [r, g, b] = [0, 1, 2].map(|channel: usize| value[channel].as_array()[lane]);
            out[key as u32 as usize] = (Rgb::new(r, g, b), sum.as_array()[lane]);
        }
    }

    #[inline]
    fn blocks_of(&self, slot: usize) -> &[Block] {
        let Slot { first, n_functions, .. } = self.slots[slot];
        &self.blocks[first as usize..first as usize + (n_functions as usize).div_ceil(LANES)]
    }

    #[inline]
    fn slot_of(&self, query: &OrientedPoint) -> Option<usize> {
        let key = Key { cell: cell_at(query.position, self.cells_per_unit).to_array(), region: query.region };
        let mut i = hash(key) & (self.slots.len() - 1);
        while self.slots[i].n_functions > 0 {
            if self.slots[i].key == key {
                return Some(i);
            }
            i = (i + 1) & (self.slots.len() - 1);
        }
        None
    }

    pub(crate) fn memory(&self) -> usize {
        size_of_val(&self.slots[..]) + size_of_val(&self.blocks[..]) + size_of_val(&self.sights[..])
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
fn hash(key: Key) -> usize {
    let [x, y, z] = key.cell.map(|c| c as u32);
    let mixed =
        x.wrapping_mul(0x9E37_79B1).wrapping_add(y.wrapping_mul(0x85EB_CA77)).wrapping_add(z.wrapping_mul(0xC2B2_AE3D));
    let mixed = mixed.wrapping_add(key.region.0.wrapping_mul(0x1656_67B1));
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x27D4_EB2F);
    (mixed ^ (mixed >> 16)) as usize
}

#[cfg(test)]
mod tests {
    use hplt_geom::{N_SECTORS, PointHierarchy, PointLevel};

    use super::*;
    use crate::{BasisOptions, Kernel, ShepardBasis, Weight};

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
        let linear = Kernel::Custom(|h| (1.0 - h).max(0.0));
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
        let basis = basis(BasisOptions::default());
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
