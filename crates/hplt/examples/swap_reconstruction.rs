//! A reconstruction of your own: the exactly nearest function, so that pixels show the cells of the finest level.
mod pipeline;

use hplt::basis::{Absolute, Coefficients, Coverage, Reconstruction, ShepardBasis};
use hplt::geom::{OrientedPoint, Rgb};

struct Cells;

impl Reconstruction<Absolute> for Cells {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        let mut coverage = Coverage { queries: queries.len() as u64, ..Coverage::default() };
        for (query, out) in queries.iter().zip(out) {
            let nearest = basis.nearest(n_levels - 1, query);
            *out = nearest.map_or(Rgb::ZERO, |i| coefficients.level(n_levels - 1)[i as usize]);
            coverage.uncovered += u64::from(nearest.is_none());
        }
        coverage
    }
}

fn main() -> pipeline::Result<()> {
    let (scene, bvh) = pipeline::cornell();
    pipeline::compare(&scene, &bvh, pipeline::Stages { display: &Cells, ..pipeline::Stages::usual(&bvh) })
}
