//! Reading the field with rays that tell which functions have a say.
//!
//! What a function knows about its surroundings ([`Extent`](hplt_geom::Extent)) is what eight rays saw. That is enough to place
//! functions by; where a field is read for good, a short ray from the query to each function that is in doubt decides.

use hplt_basis::{
    Absolute, Coefficients, Coverage, LayeredNearest, LayeredScratch, Reconstruction, ShepardBasis, Weight,
};
use hplt_geom::radiometry::luminance;
use hplt_geom::{Hit, OrientedPoint, Ray, RayCaster, RegionId, Rgb, parallel};
use hplt_sampling::{is_in_sight, sight_line};

use crate::{Gradients, Model};

/// Functions that answer at least, for their spread to mean anything.
const LEAST_FUNCTIONS: usize = 3;
/// Weight below which a function does not count as one of those.
const LEAST_WEIGHT: f32 = 0.01;
/// Functions that differ by less than this of their mean agree.
const AGREEMENT: f32 = 0.03;
/// Free height over a query, in supports of the functions there, below which they are too coarse for it: light in a slit changes
/// over distances like its height.
pub(crate) const SLIT: f32 = 0.3;
/// Queries read by one task.
const CHUNK: usize = 256;
/// Share of the weights at least that must be in sight.
const LEAST_SHARE: f32 = 0.5;

/// [`Layered`](hplt_basis::Layered) on the functions that a ray finds in sight of the query.
#[derive(Clone, Copy)]
pub struct LayeredInSight<'a> {
    /// Casts the rays; [`OpenAir`] for none.
    pub caster: &'a dyn RayCaster,
    /// Those of the field that is read, for a first-order reconstruction.
    pub gradients: Option<&'a Gradients>,
}

/// [`LayeredNearest`](hplt_basis::LayeredNearest) where a ray finds the function in sight of the query.
#[derive(Clone, Copy)]
pub struct LayeredNearestInSight<'a> {
    /// Casts the ray; [`OpenAir`] for none.
    pub caster: &'a dyn RayCaster,
}

/// A caster whose rays meet nothing. In the place of the scene's own, where a field is read or [`Gradients`] are fitted, it switches sight
/// rays off: every function has a say whose [`Extent`](hplt_geom::Extent) reaches that far.
#[derive(Debug, Clone, Copy, Default)]
pub struct OpenAir;

impl RayCaster for OpenAir {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        assert_eq!(rays.len(), hits.len());
        hits.fill(Hit::MISS);
    }

    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        assert_eq!(rays.len(), occluded.len());
        occluded.fill(false);
    }
}

/// A value of the field, and how far it can be trusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// Irradiance, W/m².
    pub irradiance: Rgb,
    /// The weighted standard deviation of luminance between the functions that answered, W/m². Infinite where next to none were
    /// in sight, and in slits too narrow for them: then the value is a guess.
    pub spread: f32,
    /// The standard error of luminance that comes from the rays of the functions, W/m²; 0 where that is not known.
    pub noise: f32,
}

/// A field to read.
#[derive(Debug, Clone, Copy)]
pub struct FieldView<'a> {
    /// Irradiance at the functions, W/m².
    pub values: &'a Coefficients<Absolute>,
    /// Of `values`, for a first-order reconstruction.
    pub gradients: Option<&'a Gradients>,
    /// Standard errors of `values` by the rays of each function.
    pub noise: Option<&'a Coefficients<Absolute>>,
}

impl Reading {
    /// Exact black, in dark regions.
    const DARK: Self = Self { irradiance: Rgb::ZERO, spread: 0.0, noise: 0.0 };

    /// Whether the functions that answered differ by more than `tolerance` of `total`, the total irradiance or more, W/m².
    pub fn is_doubtful(&self, tolerance: f32, total: f32) -> bool {
        self.spread > tolerance * total
    }
}

impl Reconstruction<Absolute> for LayeredInSight<'_> {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let field = FieldView { values: coefficients, gradients: self.gradients, noise: None };
        let mut coverage = Coverage { queries: queries.len() as u64, ..Coverage::default() };
        read_levels((basis, self.caster), field, n_levels, queries, &mut LayeredScratch::default(), |i, reading| {
            coverage.nearest += u64::from(reading.spread == f32::INFINITY);
            out[i] = reading.irradiance;
        });
        coverage
    }
}

impl Reconstruction<Absolute> for LayeredNearestInSight<'_> {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = Coverage::default();
        let found = self.in_sight(basis, coefficients, n_levels, queries);
        for ((query, out), found) in queries.iter().zip(out).zip(found) {
            match found {
                Some((value, _)) => (*out, coverage.queries) = (value, coverage.queries + 1),
                None => {
                    let (query, out) = (std::slice::from_ref(query), std::slice::from_mut(out));
                    coverage += LayeredNearest.reconstruct(basis, coefficients, n_levels, query, out);
                }
            }
        }
        coverage
    }

    fn in_sight(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
    ) -> Vec<Option<(Rgb, f32)>> {
        let found = nearest_in_sight(basis, self.caster, n_levels, queries).into_iter();
        let read = |(level, i)| (coefficients.level(level)[i as usize], basis.support(level));
        found.map(|function| function.map(read)).collect()
    }
}

/// Reads the layered field of these coefficients at all `queries`, in order, to first order with its gradients. What is read at one does
/// not depend on the others; it is read faster where neighbours follow each other. The caster of `model` decides what is in sight;
/// [`OpenAir`] there for all. Runs in parallel.
pub fn read_in_sight(model: &Model<'_>, field: FieldView<'_>, queries: &[OrientedPoint]) -> Vec<Reading> {
    let (Model { basis, caster, .. }, n_levels) = (*model, model.basis.n_levels());
    let readings = parallel::map(queries.len().div_ceil(CHUNK), LayeredScratch::default, |scratch, chunk| {
        let queries = &queries[chunk * CHUNK..queries.len().min((chunk + 1) * CHUNK)];
        let mut readings = Vec::with_capacity(queries.len());
        read_levels((basis, caster), field, n_levels, queries, scratch, |_, reading| readings.push(reading));
        readings
    });
    readings.concat()
}

fn read_levels(
    (basis, caster): (&ShepardBasis, &dyn RayCaster),
    field: FieldView<'_>,
    n_levels: usize,
    queries: &[OrientedPoint],
    scratch: &mut LayeredScratch,
    mut visit: impl FnMut(usize, Reading),
) {
    basis.expand(n_levels, queries, scratch, |i, expansion, coverage| {
        let reading = match queries[i].region {
            RegionId::DARK => Reading::DARK,
            _ => read_expansion((basis, caster), field, &queries[i], expansion, coverage),
        };
        visit(i, reading);
    });
}

/// The value of a layered expansion on those of its functions that are in sight.
fn read_expansion(
    (basis, caster): (&ShepardBasis, &dyn RayCaster),
    FieldView { values, gradients, noise }: FieldView<'_>,
    query: &OrientedPoint,
    expansion: &mut Vec<Weight>,
    coverage: Coverage,
) -> Reading {
    let guess = |value| Reading { irradiance: value, spread: f32::INFINITY, noise: 0.0 };
    let value = |w: &Weight| {
        let (level, i) = basis.level_of(w.function);
        let value = values.level(level)[i as usize];
        gradients.map_or(value, |g| g.value((level, i), &basis.points(level)[i as usize], value, query))
    };
    let all: Rgb = expansion.iter().map(|w| value(w) * w.weight).sum();
    if coverage.nearest + coverage.uncovered > 0 {
        return guess(all);
    }
    let spread_of = |expansion: &[Weight], mean: Rgb, share: f32| {
        let square = |w: &Weight| (luminance(value(w)) - luminance(mean)).powi(2) * w.weight;
        (expansion.iter().map(square).sum::<f32>() / share).sqrt()
    };
    let noise_of = |expansion: &[Weight], share: f32| {
        let of = |w: &Weight, noise: &Coefficients<Absolute>| {
            let (level, i) = basis.level_of(w.function);
            (w.weight / share * luminance(noise.level(level)[i as usize])).powi(2)
        };
        noise.map_or(0.0, |noise| expansion.iter().map(|w| of(w, noise)).sum::<f32>().sqrt())
    };
    let sees = |w: &Weight| {
        let (level, i) = basis.level_of(w.function);
        is_in_sight(caster, &basis.points(level)[i as usize], query, basis.support(level))
    };
    let are_enough =
        |expansion: &[Weight]| expansion.iter().filter(|w| w.weight >= LEAST_WEIGHT).count() >= LEAST_FUNCTIONS;
    let first = expansion.iter().max_by(|a, b| a.weight.total_cmp(&b.weight));
    if first.is_some_and(|w| query.extent.free_height() < SLIT * basis.support(basis.level_of(w.function).0)) {
        return guess(all);
    }
    let spread = spread_of(expansion, all, 1.0);
    // Where all agree, one that is in sight is as good as all.
    if are_enough(expansion) && spread <= AGREEMENT * luminance(all) && first.is_some_and(sees) {
        return Reading { irradiance: all, spread, noise: noise_of(expansion, 1.0) };
    }
    expansion.retain(sees);
    let share: f32 = expansion.iter().map(|w| w.weight).sum();
    if share <= 0.0 {
        return guess(all);
    }
    let irradiance = expansion.iter().map(|w| value(w) * w.weight).sum::<Rgb>() / share;
    if share < LEAST_SHARE || !are_enough(expansion) {
        return guess(irradiance);
    }
    Reading { irradiance, spread: spread_of(expansion, irradiance, share), noise: noise_of(expansion, share) }
}

/// For each query level and index of the function that a gather ray reads there: the approximately nearest, if a ray finds it in sight.
pub(crate) fn nearest_in_sight(
    basis: &ShepardBasis,
    caster: &dyn RayCaster,
    n_levels: usize,
    queries: &[OrientedPoint],
) -> Vec<Option<(usize, u32)>> {
    let mut found = basis.layered_nearest(n_levels, queries);
    let (mut lines, mut of) = (Vec::new(), Vec::new());
    for (q, (query, function)) in queries.iter().zip(&found).enumerate() {
        let Some((level, i)) = *function else { continue };
        if let Some(line) = sight_line(&basis.points(level)[i as usize], query, basis.support(level)) {
            lines.push(line);
            of.push(q);
        }
    }
    let mut is_hidden = vec![false; lines.len()];
    caster.trace_occluded(&lines, &mut is_hidden);
    of.iter().zip(is_hidden).filter(|(_, is_hidden)| *is_hidden).for_each(|(&q, _)| found[q] = None);
    found
}
