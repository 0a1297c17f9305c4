use std::marker::PhantomData;

use hplt_geom::{OrientedPoint, Rgb, parallel};

use crate::{ExactShepard, Reconstruction, ShepardBasis, Weight};

/// Coefficients on finer levels are corrections to what the coarser levels say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delta;

/// Coefficients are the values themselves, on every level.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Absolute;

/// A field on a hierarchy: one RGB coefficient per function and level, W/m² of irradiance. The encoding is in the type.
#[derive(Debug, Clone, PartialEq)]
pub struct Coefficients<E> {
    levels: Vec<Vec<Rgb>>,
    encoding: PhantomData<fn() -> E>,
}

impl<E> Coefficients<E> {
    /// The zero field on `basis`.
    pub fn zeros(basis: &ShepardBasis) -> Self {
        Self::from_levels((0..basis.n_levels()).map(|l| vec![Rgb::ZERO; basis.n_functions(l)]).collect())
    }

    /// Coefficients by level, coarsest first.
    pub fn from_levels(levels: Vec<Vec<Rgb>>) -> Self {
        Self { levels, encoding: PhantomData }
    }

    /// How many levels there are.
    pub fn n_levels(&self) -> usize {
        self.levels.len()
    }

    /// The coefficients of a level.
    pub fn level(&self, level: usize) -> &[Rgb] {
        &self.levels[level]
    }

    /// The coefficients of a level, to write.
    pub fn level_mut(&mut self, level: usize) -> &mut Vec<Rgb> {
        &mut self.levels[level]
    }

    /// The largest magnitude of any coefficient in any channel.
    pub fn max_abs(&self) -> f32 {
        self.levels.iter().flatten().map(|c| c.abs().max_element()).fold(0.0, f32::max)
    }

    /// Whether every coefficient is finite.
    pub fn is_finite(&self) -> bool {
        self.levels.iter().flatten().all(|c| c.is_finite())
    }

    /// The sum of two fields in the same encoding.
    ///
    /// # Panics
    /// When they are on different hierarchies.
    pub fn plus(&self, other: &Self) -> Self {
        let mut sum = Self::from_levels(self.levels.clone());
        sum.add(other);
        sum
    }

    /// Adds another field in the same encoding.
    ///
    /// # Panics
    /// When they are on different hierarchies.
    pub fn add(&mut self, other: &Self) {
        assert_eq!(self.levels.len(), other.levels.len(), "levels");
        for (a, b) in self.levels.iter_mut().zip(&other.levels) {
            assert_eq!(a.len(), b.len(), "functions");
            a.iter_mut().zip(b).for_each(|(a, b)| *a += *b);
        }
    }
}

/// The delta encoding of a field: `α_i^0 = f_i`, `α_i^l = f_i - F_{l-1}(p_i)`. Cost: a range query per function and
/// coarser level.
pub fn delta_from_absolute(basis: &ShepardBasis, absolute: &Coefficients<Absolute>) -> Coefficients<Delta> {
    let mut delta = Coefficients::<Delta>::zeros(basis);
    for level in 0..basis.n_levels() {
        let inherited = coarser_field(basis, &delta, level);
        let details = absolute.level(level).iter().zip(&inherited).map(|(f, inherited)| *f - *inherited);
        *delta.level_mut(level) = details.collect();
    }
    delta
}

/// The values `f_i = α_i^l + F_{l-1}(p_i)` of a field in delta encoding; the inverse of [`delta_from_absolute`].
pub fn absolute_from_delta(basis: &ShepardBasis, delta: &Coefficients<Delta>) -> Coefficients<Absolute> {
    let mut absolute = Coefficients::<Absolute>::zeros(basis);
    for level in 0..basis.n_levels() {
        let inherited = coarser_field(basis, delta, level);
        let values = delta.level(level).iter().zip(&inherited).map(|(detail, inherited)| *detail + *inherited);
        *absolute.level_mut(level) = values.collect();
    }
    absolute
}

/// `F_{level-1}` at the points of `level`.
fn coarser_field(basis: &ShepardBasis, delta: &Coefficients<Delta>, level: usize) -> Vec<Rgb> {
    if level == 0 {
        return vec![Rgb::ZERO; basis.n_functions(0)];
    }
    const CHUNK: usize = 256;
    let points = basis.points(level);
    let chunks: Vec<&[OrientedPoint]> = points.chunks(CHUNK).collect();
    let values = parallel::map(
        chunks.len(),
        || (),
        |(), i| {
            let mut out = vec![Rgb::ZERO; chunks[i].len()];
            ExactShepard.reconstruct(basis, delta, level, chunks[i], &mut out);
            out
        },
    );
    values.concat()
}

/// The field whose values on the finest level are `finest`, and on coarser levels their averages over each function's
/// support, weighted by area and basis value: `f_i = Σ_j A_j B_i(p_j) f_j / Σ_j A_j B_i(p_j)`, so that light patches
/// smaller than a coarse function keep their power.
pub fn restrict(basis: &ShepardBasis, finest: Vec<Rgb>) -> Coefficients<Absolute> {
    let mut field = Coefficients::<Absolute>::zeros(basis);
    let Some(top) = basis.n_levels().checked_sub(1) else { return field };
    assert_eq!(finest.len(), basis.n_functions(top), "finest values");
    *field.level_mut(top) = finest;
    // Areas restrict with the values: a function without area anywhere below it takes a plain average.
    let mut area: Vec<f32> = basis.points(top).iter().map(|p| p.area.max(f32::MIN_POSITIVE)).collect();
    for level in (1..=top).rev() {
        let parents = basis.parents(level);
        let fine = field.level(level);
        let weight_to = |child: u32, parent: u32| {
            let of_parent = |w: &&Weight| w.function == parent;
            parents.of(child).iter().find(of_parent).map_or(0.0, |w| w.weight)
        };
        let coarse = parallel::map(
            basis.n_functions(level - 1),
            || (),
            |(), parent| {
                let (mut sum, mut total) = (glam::DVec3::ZERO, 0.0f64);
                for &child in parents.children(parent as u32) {
                    let w = f64::from(area[child as usize]) * f64::from(weight_to(child, parent as u32));
                    sum += fine[child as usize].as_dvec3() * w;
                    total += w;
                }
                if total > 0.0 { ((sum / total).as_vec3(), total as f32) } else { (Rgb::ZERO, f32::MIN_POSITIVE) }
            },
        );
        area = coarse.iter().map(|c| c.1).collect();
        *field.level_mut(level - 1) = coarse.into_iter().map(|c| c.0).collect();
    }
    field
}
