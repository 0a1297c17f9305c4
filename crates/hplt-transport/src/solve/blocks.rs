use hplt_geom::glam::DVec3;
use hplt_geom::parallel;

use super::Unknowns;
use crate::SparseRows;

/// The unknowns by component: one lane of scalars per component and channel, so that every component is solved as if it
/// were alone while all share each product.
#[derive(Debug, Clone)]
pub(crate) struct Blocks {
    component: Vec<u32>,
    n_components: usize,
    /// Shares of the mean; they sum to 1 in each component.
    share: Vec<f64>,
}

/// One scalar per component and channel.
pub(crate) type Lanes = Vec<DVec3>;

impl Blocks {
    pub fn new(unknowns: &Unknowns<'_>) -> Self {
        let n_components = unknowns.n_components;
        assert_eq!(unknowns.components.len(), unknowns.areas.len(), "one area per unknown");
        let mut total = vec![0.0f64; n_components];
        let mut count = vec![0.0f64; n_components];
        for (&component, &area) in unknowns.components.iter().zip(unknowns.areas) {
            assert!((component as usize) < n_components, "component {component} of {n_components}");
            assert!(area >= 0.0 && area.is_finite(), "area {area}: finite, not negative");
            total[component as usize] += f64::from(area);
            count[component as usize] += 1.0;
        }
        let share = unknowns.components.iter().zip(unknowns.areas).map(|(&component, &area)| {
            let c = component as usize;
            if total[c] > 0.0 { f64::from(area) / total[c] } else { 1.0 / count[c] }
        });
        Self { share: share.collect(), component: unknowns.components.to_vec(), n_components }
    }

    pub fn len(&self) -> usize {
        self.component.len()
    }

    pub fn n_components(&self) -> usize {
        self.n_components
    }

    /// The component of an unknown.
    pub fn of(&self, unknown: usize) -> usize {
        self.component[unknown] as usize
    }

    /// The weight of an unknown in the mean of its component.
    pub fn share(&self, unknown: usize) -> f64 {
        self.share[unknown]
    }

    /// The first row with an entry in another component.
    pub fn joined_by(&self, rows: &SparseRows) -> Option<usize> {
        if self.component.iter().all(|&c| c == self.component[0]) {
            return None;
        }
        let joins = |i: usize| rows.multiples(i).any(|(j, w)| w != DVec3::ZERO && self.of(i) != self.of(j as usize));
        parallel::map(rows.n_rows(), || (), |(), i| joins(i)).into_iter().position(|joins| joins)
    }

    /// Folds `f(i)` over the unknowns of each component, in order.
    pub fn fold(&self, init: DVec3, mut f: impl FnMut(DVec3, usize) -> DVec3) -> Lanes {
        let mut lanes = vec![init; self.n_components];
        let mut start = 0;
        while start < self.len() {
            // Neighbours mostly share a component: sum in a register for as long as they do.
            let component = self.component[start];
            let mut value = lanes[component as usize];
            let mut i = start;
            while i < self.len() && self.component[i] == component {
                value = f(value, i);
                i += 1;
            }
            lanes[component as usize] = value;
            start = i;
        }
        lanes
    }

    pub fn dot(&self, a: &[DVec3], b: &[DVec3]) -> Lanes {
        self.fold(DVec3::ZERO, |sum, i| sum + a[i] * b[i])
    }

    pub fn max_abs(&self, a: &[DVec3]) -> Lanes {
        self.fold(DVec3::ZERO, |max, i| max.max(a[i].abs()))
    }

    pub fn mean(&self, a: &[DVec3]) -> Lanes {
        self.fold(DVec3::ZERO, |sum, i| sum + a[i] * self.share[i])
    }

    /// `y_i += scale·x_i`, the scale of each unknown's lane.
    pub fn add_scaled(&self, y: &mut [DVec3], scale: &Lanes, x: &[DVec3]) {
        for (i, (y, x)) in y.iter_mut().zip(x).enumerate() {
            *y += scale[self.of(i)] * *x;
        }
    }
}

/// `a / b` per channel, 0 where `b` is 0.
pub(crate) fn ratio(a: DVec3, b: DVec3) -> DVec3 {
    map2(a, b, |a, b| if b == 0.0 { 0.0 } else { a / b })
}

pub(crate) fn map2(a: DVec3, b: DVec3, f: impl Fn(f64, f64) -> f64) -> DVec3 {
    DVec3::new(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z))
}
