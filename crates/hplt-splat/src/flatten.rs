use hplt_basis::{
    Absolute, Coefficients, Delta, ExactShepard, MIN_WEIGHT_SUM, Reconstruction, ShepardBasis, Weight,
    absolute_from_delta,
};
use hplt_geom::{OrientedPoint, RegionId, Rgb, parallel};

/// A field cut to the leaves of its refinement, each with its own radius and an absolute value.
///
/// ```text
/// F(p) = Σ_l T_l(p) Σ_{i leaf of level l} B_i^l(p) v_i        T_0 = 1,  T_{l+1} = T_l · Σ_{i refined on level l} B_i^l(p)
/// ```
///
/// The `B_i^l` are the Shepard functions themselves, so the leaf weights `T_l B_i^l` sum to 1 wherever every level covers the
/// surface, and change smoothly across the cut: the partition of unity of a level is shared out between its leaves and
/// what refines the others. A function is *refined* when a finer function whose support meets its own has detail, directly or
/// further down; it is in the cut when its support meets that of a refined function of the level above (all of level 0
/// is). Where the field has no detail, a leaf therefore reaches over nothing that it would blur, and where a leaf of a
/// level reaches, all details of finer levels are below the threshold.
///
/// Refined functions carry no value. Those whose support meets no leaf of their own level need not be drawn at all (`T` passes
/// unchanged); the others, *masks*, are drawn for the sake of their weights.
///
/// Rejected: leaves of all levels normalised against each other in one sum. Coarse leaves then bleed over the rim of refined
/// areas, however small the threshold.
#[derive(Debug, Clone, PartialEq)]
pub struct Flattened {
    pub(crate) levels: Vec<CutLevel>,
    pub(crate) values: Coefficients<Absolute>,
    report: FlattenReport,
}

/// Less than this share left open is rounding.
pub(crate) const CLOSED: f32 = 1e-5;

/// The functions of one level that are drawn, ascending, and which of them are leaves.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct CutLevel {
    pub functions: Vec<u32>,
    pub is_leaf: Vec<bool>,
    /// For every function of the level, whether it is in the cut and refined, drawn or not.
    refined: Vec<bool>,
}

/// What a cut consists of.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct FlattenReport {
    /// Functions of the hierarchy, per level.
    pub functions: Vec<u64>,
    /// Functions whose detail exceeds the threshold, per level.
    pub detailed: Vec<u64>,
    /// Leaves, per level.
    pub leaves: Vec<u64>,
    /// Refined functions that are drawn for their weights alone, per level.
    pub masks: Vec<u64>,
}

impl FlattenReport {
    /// Functions that are drawn.
    pub fn n_drawn(&self) -> u64 {
        self.leaves.iter().chain(&self.masks).sum()
    }
}

impl Flattened {
    /// What the cut consists of.
    pub fn report(&self) -> &FlattenReport {
        &self.report
    }

    /// The leaves of a level, ascending.
    pub fn leaves(&self, level: usize) -> impl Iterator<Item = u32> + '_ {
        let level = &self.levels[level];
        level.functions.iter().zip(&level.is_leaf).filter(|(_, is_leaf)| **is_leaf).map(|(function, _)| *function)
    }

    /// The flattened field at any points, W/m²; the twin of [`splat_flattened`](crate::splat_flattened) without a picture. Cost: a
    /// range query per level that is open at the point.
    pub fn evaluate(&self, basis: &ShepardBasis, queries: &[OrientedPoint]) -> Vec<Rgb> {
        parallel::map(queries.len(), Vec::new, |weights, i| self.at(basis, &queries[i], weights))
    }

    fn at(&self, basis: &ShepardBasis, query: &OrientedPoint, weights: &mut Vec<Weight>) -> Rgb {
        if query.region == RegionId::DARK {
            return Rgb::ZERO;
        }
        let (mut value, mut open) = (Rgb::ZERO, 1.0);
        for (level, cut) in self.levels.iter().enumerate() {
            basis.raw_weights(level, query, weights);
            // Functions that are in no cut are neither leaves nor refined; they only overlap where nothing is open.
            let is_refined = |w: &&Weight| cut.refined[w.function as usize];
            let refined: f32 = weights.iter().filter(is_refined).map(|w| w.weight).sum();
            let is_leaf = |w: &&Weight| cut.functions.binary_search(&w.function).is_ok_and(|i| cut.is_leaf[i]);
            let (mut sum, mut leaf) = (Rgb::ZERO, 0.0);
            for w in weights.iter().filter(is_leaf) {
                sum += self.value(level, w.function) * w.weight;
                leaf += w.weight;
            }
            if leaf > 0.0 && leaf + refined >= MIN_WEIGHT_SUM {
                value += sum * (open / (leaf + refined));
                open *= refined / (leaf + refined);
            }
            if open < CLOSED {
                return value;
            }
        }
        let mut rest = [Rgb::ZERO];
        ExactShepard.reconstruct(basis, &self.values, basis.n_levels(), &[*query], &mut rest);
        value + rest[0] * open
    }

    /// The value of a function, W/m².
    pub fn value(&self, level: usize, function: u32) -> Rgb {
        self.values.level(level)[function as usize]
    }
}

/// Flattens a field in delta encoding: details of at most `threshold` (W/m², largest channel) count as none.
///
/// The leaves carry `v_i = f_i + (F(x_i) - C(x_i))`: the function values `f_i = α_i + F_{l-1}(x_i)`, sharpened by what the cut with
/// those values, `C`, misses of the original `F` at their centres. Without that, every leaf level would smooth the coarser
/// levels once more. What is left at threshold 0 is the second order of that smoothing; a threshold `τ` adds at most about `τ` per
/// level left out. Cost: a few range queries per function.
pub fn flatten_delta(basis: &ShepardBasis, coefficients: &Coefficients<Delta>, threshold: f32) -> Flattened {
    let detailed = (0..basis.n_levels())
        .map(|level| coefficients.level(level).iter().map(|detail| exceeds(*detail, threshold)).collect())
        .collect();
    let mut flat = cut(basis, detailed, absolute_from_delta(basis, coefficients));
    let corrections: Vec<Vec<(u32, Rgb)>> = (0..basis.n_levels())
        .map(|level| {
            let leaves: Vec<u32> = flat.leaves(level).collect();
            let misses = parallel::map(leaves.len(), Vec::new, |weights, i| {
                let query = basis.points(level)[leaves[i] as usize];
                let mut original = [Rgb::ZERO];
                ExactShepard.reconstruct(basis, coefficients, basis.n_levels(), &[query], &mut original);
                original[0] - flat.at(basis, &query, weights)
            });
            leaves.into_iter().zip(misses).collect()
        })
        .collect();
    for (level, corrections) in corrections.into_iter().enumerate() {
        let values = flat.values.level_mut(level);
        corrections.into_iter().for_each(|(leaf, miss)| values[leaf as usize] += miss);
    }
    flat
}

/// Flattens a field in absolute encoding: what differs from the push-down of the coarser level by more than `threshold` (W/m²,
/// largest channel) is detail.
///
/// Parts that were filled by push-down alone are drawn by the functions that were gathered, without the smoothing of each push-down;
/// elsewhere the field is that of [`splat_absolute`](crate::splat_absolute). Rounding makes a threshold of exactly 0 find
/// detail where there is none in the mathematical sense: values that were not stored by
/// [`Parents::push_down`](hplt_basis::Parents::push_down) itself need a small positive one.
pub fn flatten_absolute(basis: &ShepardBasis, coefficients: &Coefficients<Absolute>, threshold: f32) -> Flattened {
    let detailed = |level: usize| -> Vec<bool> {
        let values = coefficients.level(level);
        if level == 0 {
            return vec![true; values.len()];
        }
        let inherited = basis.parents(level).push_down(coefficients.level(level - 1));
        values.iter().zip(&inherited).map(|(value, inherited)| exceeds(*value - *inherited, threshold)).collect()
    };
    let detailed = (0..basis.n_levels()).map(detailed).collect();
    cut(basis, detailed, coefficients.clone())
}

fn exceeds(detail: Rgb, threshold: f32) -> bool {
    detail.abs().max_element() > threshold
}

fn cut(basis: &ShepardBasis, detailed: Vec<Vec<bool>>, values: Coefficients<Absolute>) -> Flattened {
    let refined = refined_functions(basis, &detailed);
    let mut report = FlattenReport::default();
    let mut levels = Vec::new();
    // Everything on level 0 is in the cut; on finer levels, what the refined functions above reach.
    let mut in_cut = vec![true; detailed.first().map_or(0, Vec::len)];
    for level in 0..basis.n_levels() {
        if level > 0 {
            in_cut = reached(basis, level, level - 1, &refined[level - 1]);
        }
        let is_leaf: Vec<bool> = in_cut.iter().zip(&refined[level]).map(|(cut, refined)| *cut && !*refined).collect();
        let meets_leaf = reached(basis, level, level, &is_leaf);
        let mut drawn = CutLevel::default();
        for function in 0..is_leaf.len() {
            let is_mask = in_cut[function] && refined[level][function] && meets_leaf[function];
            if is_leaf[function] || is_mask {
                drawn.functions.push(function as u32);
                drawn.is_leaf.push(is_leaf[function]);
            }
        }
        drawn.refined = in_cut.iter().zip(&refined[level]).map(|(cut, refined)| *cut && *refined).collect();
        let count = |flags: &[bool]| flags.iter().filter(|flag| **flag).count() as u64;
        report.functions.push(detailed[level].len() as u64);
        report.detailed.push(count(&detailed[level]));
        report.leaves.push(count(&is_leaf));
        report.masks.push(drawn.functions.len() as u64 - count(&is_leaf));
        levels.push(drawn);
    }
    Flattened { levels, values, report }
}

/// Per level, whether a function meets one on the next level that has detail or is refined itself.
fn refined_functions(basis: &ShepardBasis, detailed: &[Vec<bool>]) -> Vec<Vec<bool>> {
    let mut refined: Vec<Vec<bool>> = detailed.iter().map(|level| vec![false; level.len()]).collect();
    for level in (1..detailed.len()).rev() {
        let alive: Vec<bool> = detailed[level].iter().zip(&refined[level]).map(|(a, b)| *a || *b).collect();
        refined[level - 1] = reached(basis, level - 1, level, &alive);
    }
    refined
}

/// For every function of `level`, whether its support meets that of a function of `other` whose flag is set.
fn reached(basis: &ShepardBasis, level: usize, other: usize, flags: &[bool]) -> Vec<bool> {
    let (points, others) = (basis.points(level), basis.points(other));
    let distance = basis.support(level) + basis.support(other);
    parallel::map(
        points.len(),
        || (),
        |(), i| {
            let meets = |id: u32| flags[id as usize] && others[id as usize].region == points[i].region;
            basis.tree(other).nearest(points[i].position, distance, meets).is_some()
        },
    )
}
