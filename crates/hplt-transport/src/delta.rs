use hplt_basis::{Coefficients, Delta, Reconstruction};
use hplt_geom::{OrientedPoint, Progress, Rgb, parallel};

use crate::bounce::{self, Account, always_active, children_of, gather_level, merge};
use crate::{Detail, Error, Model, Oracle, Sender, Solution, TransportOptions};

/// V1, the original: unshot energy in delta encoding (Zollhöfer 2010, "Transport Operator").
///
/// ```text
/// unshot := direct;  per bounce:  new := 0;  active_0 := all of level 0
///    for l = 0..m:   for i in active_l:   α_i := gather(x_i, F_s[unshot]) - F_{l-1}[new](p_i)
///                    active_{l+1} := children of { i : the oracle refines |α_i| }
///    total += new;  unshot := new
/// ```
///
/// `reconstruction` reads senders, and what details are taken against: [`ExactShepard`](hplt_basis::ExactShepard) in the
/// original. Details mean something only to the reconstruction that they were made for: read by another, their errors
/// add up from bounce to bounce. Interruption keeps the bounces that are finished.
///
/// # Errors
/// When an option is out of range, a closed region has albedo 1, a value is not finite, or the bounces grow: delta rows have
/// negative weights, so nothing guarantees that they shrink.
pub fn transport_delta(
    model: &Model<'_>,
    direct: &Coefficients<Delta>,
    reconstruction: &dyn Reconstruction<Delta>,
    oracle: &dyn Oracle,
    options: &TransportOptions,
    progress: &dyn Progress,
) -> Result<Solution<Delta>, Error> {
    let level0 = |field: &Coefficients<Delta>| field.level(0).to_vec();
    let (indirect, report) = bounce::run(model, direct, options, progress, level0, |unshot, total, account| {
        let sender = Sender { coefficients: unshot, reconstruction, n_levels: options.sender_levels };
        let so_far = direct.plus(total);
        delta_bounce(model, &sender, &so_far, oracle, options, account, progress)
    })?;
    Ok(Solution { indirect, report })
}

fn delta_bounce(
    model: &Model<'_>,
    sender: &Sender<'_, Delta>,
    so_far: &Coefficients<Delta>,
    oracle: &dyn Oracle,
    options: &TransportOptions,
    account: &mut Account,
    progress: &dyn Progress,
) -> Result<Coefficients<Delta>, Error> {
    let basis = model.basis;
    let mut new = Coefficients::<Delta>::zeros(basis);
    let mut active = Vec::new();
    for level in 0..basis.n_levels() {
        active = merge(active, &always_active(basis, level));
        let (gathered, coverage) = gather_level(model, sender, level, &active, options, progress)?;
        account.enter(basis, level, &active, &gathered, coverage, options.n_rays)?;
        let points: Vec<OrientedPoint> = active.iter().map(|&i| basis.points(level)[i as usize]).collect();
        let inherited = field_at(model, &new, sender.reconstruction, level, &points);
        let before = field_at(model, so_far, sender.reconstruction, level + 1, &points);
        let mut refined = Vec::new();
        for (k, &function) in active.iter().enumerate() {
            let detail = gathered[k].irradiance - inherited[k];
            new.level_mut(level)[function as usize] = detail;
            let region = points[k].region.0 as usize;
            let total = before[k] + gathered[k].irradiance;
            let mean = account.regions[region].mean;
            if oracle.refine(&Detail { level, detail, noise: gathered[k].noise, total, mean }) {
                refined.push(function);
            }
        }
        active = children_of(basis, level, &refined);
    }
    Ok(new)
}

/// `F` cut to the `n_levels` coarsest levels, at `points`; zero for none.
fn field_at(
    model: &Model<'_>,
    field: &Coefficients<Delta>,
    reconstruction: &dyn Reconstruction<Delta>,
    n_levels: usize,
    points: &[OrientedPoint],
) -> Vec<Rgb> {
    if n_levels == 0 {
        return vec![Rgb::ZERO; points.len()];
    }
    const CHUNK: usize = 64;
    let chunks: Vec<&[OrientedPoint]> = points.chunks(CHUNK).collect();
    let values = parallel::map(
        chunks.len(),
        || (),
        |(), i| {
            let mut out = vec![Rgb::ZERO; chunks[i].len()];
            reconstruction.reconstruct(model.basis, field, n_levels, chunks[i], &mut out);
            out
        },
    );
    values.concat()
}
