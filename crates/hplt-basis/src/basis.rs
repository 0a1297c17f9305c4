use std::sync::OnceLock;

use hplt_geom::{OrientedPoint, PointHierarchy, PointLevel, Rgb, parallel};
use hplt_kdtree::KdTree;

use crate::cells::{LevelCells, MAX_FUNCTIONS};
use crate::kernel::distance_squared;
use crate::lanes::Function;
use crate::nearest::NearestIndex;
use crate::reconstruction::{FEW, combine, visit_coherently};
use crate::{Kernel, Parents};

/// The shape of the basis functions.
#[derive(Debug, Clone, Copy)]
pub struct BasisOptions {
    /// The support radius over the Poisson radius, `b/r`. At 2, coverage is guaranteed (`Σw ≥ 0.125`).
    pub support_factor: f32,
    /// The radial kernel.
    pub kernel: Kernel,
}

impl Default for BasisOptions {
    fn default() -> Self {
        Self { support_factor: 2.0, kernel: Kernel::Smoothstep }
    }
}

/// The weight of one function at a query point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weight {
    /// Index of the function within its level.
    pub function: u32,
    /// Its weight.
    pub weight: f32,
}

/// Points where the weights of a level sum to less are not covered by it: a sum this small is rounding noise at the rim of
/// a support, and dividing by it would amplify the noise.
pub const MIN_WEIGHT_SUM: f32 = 1e-6;

/// The shape that all functions of a level share.
#[derive(Debug, Clone, Copy)]
pub struct Footprint {
    pub(crate) support: f32,
    pub(crate) inverse_support: f32,
    pub(crate) kernel: Kernel,
}

impl Footprint {
    /// The support radius `b`, scene units: beyond this distance every weight is 0.
    pub fn support(&self) -> f32 {
        self.support
    }

    /// The kernel at this squared distance.
    #[inline]
    pub(crate) fn radial_weight(&self, distance_squared: f32) -> f32 {
        self.kernel.weight(distance_squared.sqrt() * self.inverse_support)
    }

    /// The unnormalised weight `w_i` at `query` of the function at `point`.
    #[inline]
    pub fn weight(&self, point: &OrientedPoint, query: &OrientedPoint) -> f32 {
        if !point.is_continued_at(query) {
            return 0.0;
        }
        let cosine = query.normal.dot(point.normal);
        self.radial_weight(distance_squared(query.position - point.position, point.normal)) * cosine * cosine
    }
}

/// Cosine between normals below which one side of a sheet is the back of the other.
const BEHIND: f32 = -0.5;

/// What a function must share with a query.
#[derive(Debug, Clone, Copy)]
enum Nearness {
    InSight,
    SameSide,
    NotBehind,
}

/// The Shepard bases of all levels of a hierarchy, with a kd-tree per level and the parents of every function.
#[derive(Debug)]
pub struct ShepardBasis {
    hierarchy: PointHierarchy,
    trees: Vec<KdTree>,
    parents: Vec<Parents>,
    options: BasisOptions,
    /// One per level whose functions have been evaluated for many queries at once.
    functions: Vec<OnceLock<Vec<Function>>>,
    /// One per level that has been read by [`blend`](Self::blend) and is not too large.
    cells: Vec<OnceLock<LevelCells>>,
    /// One per level, where some levels are not everywhere.
    nearest: Vec<NearestIndex>,
    /// How many of the coarsest levels are refined everywhere.
    pub(crate) n_whole: usize,
}

impl ShepardBasis {
    /// The bases on `hierarchy`. Builds a kd-tree per level and finds every function's parents, in parallel.
    pub fn build(hierarchy: PointHierarchy, options: BasisOptions) -> Self {
        let trees = hierarchy.levels.iter().map(tree_of).collect();
        let functions = hierarchy.levels.iter().map(|_| OnceLock::new()).collect();
        let cells = hierarchy.levels.iter().map(|_| OnceLock::new()).collect();
        let (parents, nearest) = (Vec::new(), Vec::new());
        let mut basis = Self { hierarchy, trees, parents, options, functions, cells, nearest, n_whole: 0 };
        basis.parents = (1..basis.n_levels()).map(|level| basis.find_parents(level)).collect();
        if basis.hierarchy.levels.iter().any(|level| !level.is_refined.is_empty()) {
            basis.nearest = (0..basis.n_levels()).map(|level| basis.index(level)).collect();
        }
        basis.n_whole = basis.count_whole();
        basis
    }

    /// The points.
    pub fn hierarchy(&self) -> &PointHierarchy {
        &self.hierarchy
    }

    /// The points of one level.
    pub fn points(&self, level: usize) -> &[OrientedPoint] {
        &self.hierarchy.levels[level].points
    }

    /// How many levels there are.
    pub fn n_levels(&self) -> usize {
        self.hierarchy.levels.len()
    }

    /// How many functions a level has.
    pub fn n_functions(&self, level: usize) -> usize {
        self.points(level).len()
    }

    /// The radius `b` of the supports of a level, scene units.
    pub fn support(&self, level: usize) -> f32 {
        self.options.support_factor * self.hierarchy.levels[level].poisson_radius
    }

    /// The kd-tree over the points of a level.
    pub fn tree(&self, level: usize) -> &KdTree {
        &self.trees[level]
    }

    /// The parents of the functions of `level`, which must not be 0.
    pub fn parents(&self, level: usize) -> &Parents {
        &self.parents[level - 1]
    }

    /// Replaces `weights` by the unnormalised `w_i` of every function of `level` that is positive at `query`, in the
    /// order of the tree, and returns their sum.
    pub fn raw_weights(&self, level: usize, query: &OrientedPoint, weights: &mut Vec<Weight>) -> f32 {
        weights.clear();
        let footprint = self.footprint(level);
        let points = self.points(level);
        let mut sum = 0.0;
        self.trees[level].within(query.position, footprint.support, |id, _| {
            let weight = footprint.weight(&points[id as usize], query);
            if weight > 0.0 {
                sum += weight;
                weights.push(Weight { function: id, weight });
            }
        });
        sum
    }

    /// The shape that all functions of a level share, for callers that find the functions themselves.
    pub fn footprint(&self, level: usize) -> Footprint {
        let support = self.support(level);
        Footprint { support, inverse_support: 1.0 / support, kernel: self.options.kernel }
    }

    /// Replaces `weights` by the basis functions `B_i` of `level` at `query`, which sum to 1, and returns true; or
    /// leaves it empty and returns false where no function covers the point.
    pub fn weights(&self, level: usize, query: &OrientedPoint, weights: &mut Vec<Weight>) -> bool {
        let sum = self.raw_weights(level, query, weights);
        if sum < MIN_WEIGHT_SUM {
            weights.clear();
            return false;
        }
        let inverse = 1.0 / sum;
        weights.iter_mut().for_each(|w| w.weight *= inverse);
        true
    }

    /// `Σ B_i α_i` over the functions of `level` at `query`, the `α` being `coefficients`; `None` where no function covers the
    /// point. The same as summing up [`weights`](Self::weights), but for rounding, in a fraction of the time on levels that are
    /// read often. `scratch` is for levels too large for that.
    pub(crate) fn blend(
        &self,
        level: usize,
        query: &OrientedPoint,
        coefficients: &[Rgb],
        scratch: &mut Vec<Weight>,
    ) -> Option<Rgb> {
        let Some(cells) = self.cells(level) else {
            return self.weights(level, query, scratch).then(|| combine(scratch, coefficients));
        };
        let (footprint, points) = (self.footprint(level), self.points(level));
        let (mut value, mut sum) = (Rgb::ZERO, 0.0);
        for &function in cells.at(query) {
            let weight = footprint.weight(&points[function as usize], query);
            value += coefficients[function as usize] * weight;
            sum += weight;
        }
        normalised((value, sum))
    }

    /// [`blend`](Self::blend) at each of many queries, in any order, with the same bits, in a fraction of the time where many lie
    /// near each other.
    pub(crate) fn blend_many(&self, level: usize, queries: &[OrientedPoint], coefficients: &[Rgb]) -> Vec<Option<Rgb>> {
        if let Some(cells) = self.cells(level).filter(|_| queries.len() >= FEW) {
            let sums = cells.sums(self.functions(level), &self.footprint(level), queries, coefficients);
            return sums.into_iter().map(normalised).collect();
        }
        let (mut out, mut scratch) = (vec![None; queries.len()], Vec::new());
        visit_coherently(queries, |i| out[i] = self.blend(level, &queries[i], coefficients, &mut scratch));
        out
    }

    /// What decides about the weights of the functions of a level.
    pub(crate) fn functions(&self, level: usize) -> &[Function] {
        self.functions[level].get_or_init(|| self.points(level).iter().map(Function::of).collect())
    }

    /// The functions of a level by cells, unless there are too many.
    fn cells(&self, level: usize) -> Option<&LevelCells> {
        let points = self.points(level);
        let build = || LevelCells::build(points, &self.footprint(level));
        (points.len() <= MAX_FUNCTIONS).then(|| self.cells[level].get_or_init(build))
    }

    /// The nearest function of `level` in the region of `query`, exactly: one within sight if there is any, else one on its
    /// side, else one that does not face the other way.
    pub fn nearest(&self, level: usize, query: &OrientedPoint) -> Option<u32> {
        let mut found = [Nearness::InSight, Nearness::SameSide, Nearness::NotBehind].into_iter();
        found.find_map(|nearness| self.nearest_as(level, query, nearness))
    }

    /// Level and index of the nearest function of the finest of `n_levels` levels that has one in the region of `query`: within
    /// sight on any level rather than on its side, on its side rather than one that does not face the other way.
    pub(crate) fn nearest_on_any_level(&self, n_levels: usize, query: &OrientedPoint) -> Option<(usize, u32)> {
        [Nearness::InSight, Nearness::SameSide, Nearness::NotBehind].into_iter().find_map(|nearness| {
            (0..n_levels).rev().find_map(|level| Some((level, self.nearest_as(level, query, nearness)?)))
        })
    }

    fn nearest_as(&self, level: usize, query: &OrientedPoint, nearness: Nearness) -> Option<u32> {
        let points = self.points(level);
        let accept = |p: &OrientedPoint| match nearness {
            Nearness::InSight => p.is_continued_at(query),
            Nearness::SameSide => p.region == query.region && p.normal.dot(query.normal) > 0.0,
            Nearness::NotBehind => p.region == query.region && p.normal.dot(query.normal) > BEHIND,
        };
        let found = self.trees[level].nearest(query.position, f32::INFINITY, |id| accept(&points[id as usize]));
        found.map(|(id, _)| id)
    }

    /// A function of `level` near `query`, in its region, within sight and with a normal within 60°: what one descent of the
    /// kd-tree finds, and the nearest one within a support where that is farther away.
    pub fn approximate_nearest(&self, level: usize, query: &OrientedPoint) -> Option<u32> {
        let points = self.points(level);
        let same_side = |id: u32| {
            let point = &points[id as usize];
            query.normal.dot(point.normal) > 0.5 && point.is_continued_at(query)
        };
        let (tree, support) = (self.tree(level), self.support(level));
        let found = tree.approximate_nearest(query.position, same_side);
        // A leaf that mixes walls may hold only a function of this side that is far away, or none.
        let near = found.filter(|&(_, distance_squared)| distance_squared <= support * support);
        near.or_else(|| tree.nearest(query.position, support, same_side)).map(|(id, _)| id)
    }

    /// [`approximate_nearest`](Self::approximate_nearest) of many, and the nearest of all that face about the same way where the level
    /// has an index.
    pub(crate) fn nearest_many(&self, level: usize, queries: &[OrientedPoint]) -> Vec<Option<u32>> {
        match self.nearest.get(level) {
            Some(index) if queries.len() >= FEW => index.nearest_many(self.functions(level), queries),
            Some(index) => queries.iter().map(|query| index.nearest(query)).collect(),
            None => queries.iter().map(|query| self.approximate_nearest(level, query)).collect(),
        }
    }

    fn index(&self, level: usize) -> NearestIndex {
        NearestIndex::build(self.points(level), self.support(level))
    }

    /// The index of function `i` of `level` among those of all levels, coarsest first.
    pub fn flat_index(&self, level: usize, i: u32) -> u32 {
        self.hierarchy.levels[..level].iter().map(|l| l.points.len() as u32).sum::<u32>() + i
    }

    /// Level and index there of the function with this [flat index](Self::flat_index).
    ///
    /// # Panics
    /// When there is none.
    pub fn level_of(&self, flat_index: u32) -> (usize, u32) {
        let mut i = flat_index;
        for (level, of_level) in self.hierarchy.levels.iter().enumerate() {
            match i.checked_sub(of_level.points.len() as u32) {
                Some(rest) => i = rest,
                None => return (level, i),
            }
        }
        panic!("function {flat_index} of {}", self.hierarchy.n_points())
    }

    /// Adds a finer level, which covers the surroundings of the functions of the finest level so far that `is_refined` says.
    pub fn push_level(&mut self, level: PointLevel, is_refined: Vec<bool>) {
        let finest = self.n_levels() - 1;
        assert_eq!(is_refined.len(), self.n_functions(finest), "one flag per function");
        self.hierarchy.levels[finest].is_refined = is_refined;
        self.trees.push(tree_of(&level));
        self.functions.push(OnceLock::new());
        self.cells.push(OnceLock::new());
        self.hierarchy.levels.push(level);
        for level in self.nearest.len()..self.n_levels() {
            self.nearest.push(self.index(level));
        }
        self.parents.push(self.find_parents(finest + 1));
        self.n_whole = self.count_whole();
    }

    /// Takes away all levels but the `n_levels` coarsest.
    pub fn truncate(&mut self, n_levels: usize) {
        self.hierarchy.levels.truncate(n_levels);
        self.trees.truncate(n_levels);
        self.functions.truncate(n_levels);
        self.cells.truncate(n_levels);
        self.parents.truncate(n_levels.saturating_sub(1));
        if let Some(finest) = self.hierarchy.levels.last_mut() {
            finest.is_refined = vec![false; finest.points.len()];
        }
        self.nearest.truncate(n_levels);
        self.n_whole = self.count_whole();
    }

    /// Bytes that trees, parents and points take.
    pub fn memory(&self) -> usize {
        let trees: usize = self.trees.iter().map(KdTree::memory).sum();
        let parents: usize = self.parents.iter().map(Parents::memory).sum();
        let nearest: usize = self.nearest.iter().map(NearestIndex::memory).sum();
        let cells: usize = self.cells.iter().filter_map(OnceLock::get).map(LevelCells::memory).sum();
        let functions: usize = self.functions.iter().filter_map(OnceLock::get).map(|f| size_of_val(&f[..])).sum();
        self.hierarchy.memory() + trees + parents + nearest + cells + functions
    }

    fn count_whole(&self) -> usize {
        let is_whole = |level: &&PointLevel| level.is_refined.iter().all(|&r| r);
        self.hierarchy.levels.iter().take_while(is_whole).count()
    }

    fn find_parents(&self, level: usize) -> Parents {
        let points = self.points(level);
        let rows = parallel::map(points.len(), Vec::new, |scratch, i| {
            if !self.weights(level - 1, &points[i], scratch) {
                scratch.extend(self.nearest(level - 1, &points[i]).map(|function| Weight { function, weight: 1.0 }));
            }
            scratch.clone()
        });
        Parents::from_rows(&rows, self.n_functions(level - 1))
    }
}

/// A weighted sum over the sum of the weights, where that is enough.
fn normalised((value, sum): (Rgb, f32)) -> Option<Rgb> {
    (sum >= MIN_WEIGHT_SUM).then(|| value * (1.0 / sum))
}

fn tree_of(level: &PointLevel) -> KdTree {
    KdTree::build(&level.points.iter().map(|p| p.position).collect::<Vec<_>>())
}
