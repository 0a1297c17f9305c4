use hplt_basis::{Coefficients, Coverage, Reconstruction, ShepardBasis};
use hplt_geom::{Interrupted, OrientedPoint, Progress, Rgb, parallel};

use crate::GBuffer;
use crate::counter::Counter;

/// Samples per unit of parallel work.
const CHUNK: usize = 1024;

/// The irradiance at every sample, W/m², and how the samples were answered: the per-pixel display. Reads all levels.
///
/// Cost: what `reconstruction` costs per sample. Zero for background, which counts as a query.
///
/// # Errors
/// When interrupted.
pub fn evaluate<E: Sync>(
    basis: &ShepardBasis,
    coefficients: &Coefficients<E>,
    reconstruction: &dyn Reconstruction<E>,
    gbuffer: &GBuffer,
    progress: &dyn Progress,
) -> Result<(Vec<Rgb>, Coverage), Interrupted> {
    let n = gbuffer.n_samples();
    let n_chunks = n.div_ceil(CHUNK);
    let counter = Counter::new(progress, "evaluate", n_chunks);
    let chunks = parallel::try_map(n_chunks, Vec::<OrientedPoint>::new, |queries, chunk| {
        counter.step()?;
        queries.clear();
        queries.extend((chunk * CHUNK..((chunk + 1) * CHUNK).min(n)).map(|i| gbuffer.query(i)));
        let mut out = vec![Rgb::ZERO; queries.len()];
        let coverage = reconstruction.reconstruct(basis, coefficients, basis.n_levels(), queries, &mut out);
        Ok((out, coverage))
    })?;
    let (mut irradiance, mut coverage) = (Vec::with_capacity(n), Coverage::default());
    for (values, part) in chunks {
        irradiance.extend(values);
        coverage += part;
    }
    Ok((irradiance, coverage))
}
