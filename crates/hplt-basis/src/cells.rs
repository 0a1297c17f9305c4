use glam::{IVec3, Vec3};
use hplt_geom::{Extent, OrientedPoint, RegionId, Rgb};

use crate::Footprint;
use crate::lanes::{self, Columns, Function};

/// Supports are taken a little larger than they are, so that rounding loses nothing.
pub(crate) const MARGIN: f32 = 1.001;
/// Levels of more functions have no cells, which would take too much memory.
pub(crate) const MAX_FUNCTIONS: usize = 16_384;
/// Cells with this many functions on average are too large, as long as smaller ones have no more than so many entries.
const LONG_LIST: usize = 32;
const MAX_ENTRIES: usize = 1 << 20;

/// Functions listed for the cells of a grid.
#[derive(Debug)]
pub(crate) struct Lists {
    cells_per_unit: f32,
    /// Open-addressed, a power of two of them.
    slots: Vec<Slot>,
    /// The functions of each cell in turn.
    functions: Vec<u32>,
}

/// A cell, as far as it is in one region and, where that matters, of surface that faces one way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Key {
    cell: [i32; 3],
    region: RegionId,
    facing: u32,
}

#[derive(Debug, Clone, Copy)]
struct Slot {
    key: Key,
    first: u32,
    /// 0 where the slot is free.
    n_functions: u32,
}

impl Key {
    pub fn new(cell: IVec3, region: RegionId, facing: u32) -> Self {
        Self { cell: cell.to_array(), region, facing }
    }
}

impl Lists {
    /// The lists of these entries, which are sorted by their keys, in a grid of so many cells.
    pub fn new(entries: &[(Key, u32)], cells_per_unit: f32) -> Self {
        let n_keys = entries.chunk_by(|a, b| a.0 == b.0).count();
        let free = Slot { key: Key::new(IVec3::ZERO, RegionId(0), 0), first: 0, n_functions: 0 };
        let mut slots = vec![free; (2 * n_keys).next_power_of_two()];
        let mut first = 0;
        for group in entries.chunk_by(|a, b| a.0 == b.0) {
            let (key, n_functions) = (group[0].0, group.len() as u32);
            let mut slot = hash(key) & (slots.len() - 1);
            while slots[slot].n_functions > 0 {
                slot = (slot + 1) & (slots.len() - 1);
            }
            slots[slot] = Slot { key, first, n_functions };
            first += n_functions;
        }
        Self { cells_per_unit, slots, functions: entries.iter().map(|&(_, function)| function).collect() }
    }

    /// The list for a point that faces this way.
    #[inline]
    pub fn at(&self, query: &OrientedPoint, facing: u32) -> &[u32] {
        self.slot_of(query, facing).map_or(&[], |slot| self.of_slot(slot))
    }

    #[inline]
    fn of_slot(&self, slot: usize) -> &[u32] {
        let Slot { first, n_functions, .. } = self.slots[slot];
        &self.functions[first as usize..(first + n_functions) as usize]
    }

    #[inline]
    fn slot_of(&self, query: &OrientedPoint, facing: u32) -> Option<usize> {
        let key = Key::new(cell_at(query.position, self.cells_per_unit), query.region, facing);
        let mut i = hash(key) & (self.slots.len() - 1);
        while self.slots[i].n_functions > 0 {
            if self.slots[i].key == key {
                return Some(i);
            }
            i = (i + 1) & (self.slots.len() - 1);
        }
        None
    }

    /// Queries that have a list, those with the same list side by side.
    pub fn by_cell(&self, queries: &[OrientedPoint], facing: impl Fn(&OrientedPoint) -> u32) -> ByCell<'_> {
        let mut keys = Vec::with_capacity(queries.len());
        for (i, query) in queries.iter().enumerate() {
            keys.extend(self.slot_of(query, facing(query)).map(|slot| (slot as u64) << 32 | i as u64));
        }
        keys.sort_unstable();
        let order: Vec<u32> = keys.iter().map(|&key| key as u32).collect();
        let groups = keys.chunk_by(|a, b| a >> 32 == b >> 32);
        ByCell {
            columns: Columns::new(order.iter().map(|&i| &queries[i as usize])),
            groups: groups.map(|group| (self.of_slot((group[0] >> 32) as usize), group.len())).collect(),
            order,
        }
    }

    pub fn memory(&self) -> usize {
        size_of_val(&self.slots[..]) + size_of_val(&self.functions[..])
    }
}

/// Queries in the order of the cells that they are in.
pub(crate) struct ByCell<'a> {
    /// Which query comes when.
    pub order: Vec<u32>,
    /// In that order.
    pub columns: Columns,
    /// The functions listed for a cell, and how many of the queries are in it.
    pub groups: Vec<(&'a [u32], usize)>,
}

/// The functions of one level, listed for every cell of a grid that they may have weight in. For the coarse levels that rays read
/// millions of times.
#[derive(Debug)]
pub(crate) struct LevelCells {
    /// Ascending.
    lists: Lists,
}

impl LevelCells {
    /// Those of a level whose functions stand at `points`. Cells are halved until their lists are short.
    pub(crate) fn build(points: &[OrientedPoint], footprint: &Footprint) -> Self {
        let mut cells_per_unit = 2.0 / footprint.support();
        let mut entries = list(points, footprint, cells_per_unit);
        while mean_length(&entries) > LONG_LIST && entries.len() < MAX_ENTRIES / 3 {
            cells_per_unit *= 2.0;
            entries = list(points, footprint, cells_per_unit);
        }
        Self { lists: Lists::new(&entries, cells_per_unit) }
    }

    /// The functions that may have weight at `query`, ascending.
    #[inline]
    pub(crate) fn at(&self, query: &OrientedPoint) -> &[u32] {
        self.lists.at(query, 0)
    }

    /// `(Σ w_i α_i, Σ w_i)` at each of `queries`, the `α` being the `coefficients` of the `functions` of the level, each summed in
    /// ascending order of the functions. All queries in a cell are looked at together.
    pub(crate) fn sums(
        &self,
        functions: &[Function],
        footprint: &Footprint,
        queries: &[OrientedPoint],
        coefficients: &[Rgb],
    ) -> Vec<(Rgb, f32)> {
        let by_cell = self.lists.by_cell(queries, |_| 0);
        let sums = lanes::sums(functions, footprint, coefficients, &by_cell.columns, by_cell.groups);
        let mut out = vec![(Rgb::ZERO, 0.0); queries.len()];
        for (i, &query) in by_cell.order.iter().enumerate() {
            let [r, g, b, sum] = [0, 1, 2, 3].map(|column: usize| sums[column][i]);
            out[query as usize] = (Rgb::new(r, g, b), sum);
        }
        out
    }

    pub(crate) fn memory(&self) -> usize {
        self.lists.memory()
    }
}

/// The functions that may have weight in each cell, cell by cell, ascending.
fn list(points: &[OrientedPoint], footprint: &Footprint, cells_per_unit: f32) -> Vec<(Key, u32)> {
    // On one thread: whoever waits for others here could be given a task that waits for these very cells.
    let mut entries = Vec::new();
    for (i, point) in points.iter().enumerate() {
        // Heights count three times.
        let (reach, height) = (footprint.support(), footprint.support() / 3.0);
        touched_cells(point, (reach, height), cells_per_unit, |cell| {
            entries.push((Key::new(cell, point.region, 0), i as u32));
        });
    }
    entries.sort_unstable();
    entries
}

/// The mean length of the lists that the entries of all cells are in.
fn mean_length(entries: &[(Key, u32)]) -> usize {
    let squares: usize = entries.chunk_by(|a, b| a.0 == b.0).map(|of_cell| of_cell.len() * of_cell.len()).sum();
    squares / entries.len().max(1)
}

#[inline]
fn cell_at(position: Vec3, cells_per_unit: f32) -> IVec3 {
    let p = position * cells_per_unit;
    // floor(), without a call on processors that lack the instruction.
    let truncated = p.as_ivec3();
    truncated - IVec3::from(p.cmplt(truncated.as_vec3()))
}

/// Calls `visit` for all cells that are, in part, within `reach` of `point`, within `height` of its tangent plane and within its extent.
pub(crate) fn touched_cells(
    point: &OrientedPoint,
    (reach, height): (f32, f32),
    cells_per_unit: f32,
    mut visit: impl FnMut(IVec3),
) {
    let (reach, height) = (reach * MARGIN, height * MARGIN);
    let (low, high) =
        (cell_at(point.position - reach, cells_per_unit), cell_at(point.position + reach, cells_per_unit));
    let half = 0.5 * MARGIN / cells_per_unit;
    let [tangent, _, bitangent, ..] = Extent::sector_directions(point.normal);
    let axes = [tangent, bitangent, point.normal];
    let half_extents = Vec3::from(axes.map(|axis| half * axis.abs().element_sum()));
    let support = Vec3::new(reach, reach, height);
    for z in low.z..=high.z {
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let cell = IVec3::new(x, y, z);
                let offset = (cell.as_vec3() + 0.5) / cells_per_unit - point.position;
                let to_cell = (offset.abs() - half).max(Vec3::ZERO);
                let center = Vec3::from(axes.map(|axis| offset.dot(axis)));
                let (first, last) = (center - half_extents, center + half_extents);
                if to_cell.length_squared() > reach * reach || first.z > support.z || last.z < -support.z {
                    continue;
                }
                let in_support = |p: Vec3| p.clamp(-support, support);
                if !point.extent.misses_box(in_support(first), in_support(last)) {
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
    let mixed = mixed.wrapping_add(key.region.0.wrapping_mul(0x1656_67B1)).wrapping_add(key.facing << 10);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x27D4_EB2F);
    (mixed ^ (mixed >> 16)) as usize
}

#[cfg(test)]
pub(crate) mod tests {
    use hplt_geom::{N_SECTORS, PointHierarchy, PointLevel};

    use super::*;
    use crate::{BasisOptions, Kernel, ShepardBasis};

    /// Numbers in `[0, 1)`.
    pub(crate) fn numbers(mut state: u32) -> impl FnMut() -> f32 {
        move || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / 16_777_216.0
        }
    }

    /// Functions in two regions, in thin and thick layers, some with walls nearby; near the axes and across them.
    pub(crate) fn functions(n: usize, seed: u32) -> Vec<OrientedPoint> {
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

    /// The cells find the functions that the kd-tree finds.
    #[test]
    fn cells_have_the_functions_of_the_tree() {
        let basis = basis(BasisOptions::default());
        let cells = LevelCells::build(basis.points(0), &basis.footprint(0));
        let (mut expected, mut n_found) = (Vec::new(), 0);
        for query in queries() {
            basis.raw_weights(0, &query, &mut expected);
            let found = cells.at(&query);
            assert!(found.is_sorted() && expected.iter().all(|w| found.contains(&w.function)), "{query:?}");
            n_found += found.len();
        }
        assert!(n_found > 10_000, "{n_found}");
    }

    /// Whatever is at the rim of reach and height is in a cell that is touched, and every cell that is touched is that near.
    #[test]
    fn the_cells_touched_are_those_within_reach_and_height() {
        let (reach, height) = (0.1, 0.04);
        let (mut next, mut touched) = (numbers(6), Vec::new());
        let mut n_touched = 0;
        for point in functions(3000, 5) {
            let point = OrientedPoint { extent: Extent::OPEN, ..point };
            let cells_per_unit = 10.0 + 30.0 * next();
            touched.clear();
            touched_cells(&point, (reach, height), cells_per_unit, |cell| touched.push(cell));
            let normal = point.normal;
            for direction in [Vec3::X, Vec3::Y, Vec3::Z, normal, normal.any_orthonormal_vector()] {
                // A little inside, so that rounding does not decide.
                let length = 0.9999 * reach.min(height / direction.dot(normal).abs());
                for offset in [length * direction, -length * direction] {
                    assert!(touched.contains(&cell_at(point.position + offset, cells_per_unit)), "{point:?} {offset}");
                }
            }
            for cell in &touched {
                let corner = |i: i32| (cell + IVec3::new(i & 1, i >> 1 & 1, i >> 2)).as_vec3() / cells_per_unit;
                let nearest = point.position.clamp(corner(0), corner(7));
                assert!(nearest.distance(point.position) < 1.003 * reach, "{point:?} {cell}");
                let heights = [0, 1, 2, 3, 4, 5, 6, 7].map(|i| (corner(i) - point.position).dot(normal));
                assert!(heights.iter().any(|&h| h < 1.003 * height) && heights.iter().any(|&h| h > -1.003 * height));
            }
            n_touched += touched.len();
        }
        assert!(n_touched > 10_000, "{n_touched}");
    }

    /// Four bytes for a function in a list, and few for the cells.
    #[test]
    fn the_memory_of_lists_is_that_of_their_entries() {
        let key = |i: u32| Key::new(IVec3::new(i as i32 / 100, 0, 0), RegionId(0), 0);
        let entries: Vec<(Key, u32)> = (0..1000).map(|i| (key(i), i)).collect();
        let memory = Lists::new(&entries, 1.0).memory();
        assert!((4000 + 10 * size_of::<Key>()..6000).contains(&memory), "{memory}");
    }

    /// Cells are halved as often as the lists need it, and no more.
    #[test]
    fn crowded_cells_are_halved() {
        let basis = basis(BasisOptions::default());
        let footprint = basis.footprint(0);
        let usual = 2.0 / footprint.support();
        let mean_of = |points: &[OrientedPoint], cells_per_unit| mean_length(&list(points, &footprint, cells_per_unit));
        let crowd = LevelCells::build(basis.points(0), &footprint);
        assert!(
            crowd.lists.functions.len() < MAX_ENTRIES && crowd.lists.slots.len() <= 4 * crowd.lists.functions.len()
        );
        let halvings = (crowd.lists.cells_per_unit / usual).log2();
        assert!(halvings >= 1.0 && halvings.fract() == 0.0, "{halvings}");
        assert!(mean_of(basis.points(0), crowd.lists.cells_per_unit) <= LONG_LIST);
        assert!(mean_of(basis.points(0), 0.5 * crowd.lists.cells_per_unit) > LONG_LIST);
        let few: Vec<OrientedPoint> = basis.points(0).iter().step_by(20).copied().collect();
        assert_eq!(LevelCells::build(&few, &footprint).lists.cells_per_unit, usual);
        assert!(mean_of(&few, usual) <= LONG_LIST);
    }

    /// Many queries at once are answered as one by one, with the same bits, with the usual kernel and another.
    #[test]
    fn many_sums_are_single_sums() {
        let linear = Kernel::Custom(|h| (1.0 - h).max(0.0));
        let mut next = numbers(3);
        let coefficients: Vec<Rgb> = (0..3000).map(|_| Rgb::new(next(), next(), -next())).collect();
        for options in [BasisOptions::default(), BasisOptions { kernel: linear, ..BasisOptions::default() }] {
            let (basis, queries) = (basis(options), queries());
            let many = basis.blend_many(0, &queries, &coefficients);
            let mut n_covered = 0;
            for (query, value) in queries.iter().zip(many) {
                assert_eq!(value, basis.blend(0, query, &coefficients, &mut Vec::new()), "{query:?}");
                n_covered += usize::from(value.is_some());
            }
            assert!((100..4000).contains(&n_covered), "{n_covered}");
        }
    }

    pub(crate) fn queries() -> Vec<OrientedPoint> {
        let free = |i: usize| Extent::of_query(if i.is_multiple_of(2) { f32::INFINITY } else { 0.01 });
        functions(4000, 2)
            .into_iter()
            .enumerate()
            .map(|(i, query)| OrientedPoint { extent: free(i), ..query })
            .collect()
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
