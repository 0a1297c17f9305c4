use hplt_geom::PointHierarchy;

use super::Unknowns;

/// The unknowns of a hierarchy: one per function, level after level. Owns what [`Unknowns`] borrows.
#[derive(Debug, Clone, PartialEq)]
pub struct System {
    components: Vec<u32>,
    n_components: usize,
    areas: Vec<f32>,
}

impl System {
    /// Regions are components. The means over them are taken on the coarsest level, which is everywhere.
    pub fn of(hierarchy: &PointHierarchy) -> Self {
        let points =
            hierarchy.levels.iter().enumerate().flat_map(|(l, level)| level.points.iter().map(move |p| (l, p)));
        let (components, areas) = points.map(|(l, p)| (p.region.0, if l == 0 { p.area } else { 0.0 })).unzip();
        Self { components, n_components: hierarchy.n_regions as usize, areas }
    }

    /// What the solver reads.
    pub fn unknowns(&self) -> Unknowns<'_> {
        Unknowns { components: &self.components, n_components: self.n_components, areas: &self.areas }
    }

    /// How many unknowns there are.
    pub fn len(&self) -> usize {
        self.components.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.components.is_empty()
    }
}
