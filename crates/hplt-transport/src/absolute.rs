use hplt_basis::{Absolute, Coefficients, Reconstruction};
use hplt_geom::{Progress, Rgb};

use crate::bounce::{self, Account, always_active, children_of, gather_level, merge};
use crate::{Detail, Error, Model, Oracle, Sender, Solution, TransportOptions};

/// V3, the optimised version: absolute encoding with push-down (Zollhöfer 2010, "Further Ideas").
///
/// ```text
/// unshot := direct;  per bounce:  active_0 := all of level 0
///    for l = 0..m:   α_i := gather(x_i, F^s[unshot])       for i in active_l
///                    α_i := Σ_parents weight·α             for all others (push-down)
///                    active_{l+1} := children of { i in active_l : the oracle refines |α_i - Σ_parents weight·α| }
///    total += new;  unshot := new
/// ```
///
/// Every level holds the whole field, so one level is enough to read it. `reconstruction` reads senders:
/// [`ApproximateNearest`](hplt_basis::ApproximateNearest) in the original. Interruption keeps the bounces that are finished.
///
/// # Errors
/// When an option is out of range, a closed region has albedo 1, or a value is not finite.
pub fn transport_absolute(
    model: &Model<'_>,
    direct: &Coefficients<Absolute>,
    reconstruction: &dyn Reconstruction<Absolute>,
    oracle: &dyn Oracle,
    options: &TransportOptions,
    progress: &dyn Progress,
) -> Result<Solution<Absolute>, Error> {
    let level0 = |field: &Coefficients<Absolute>| field.level(0).to_vec();
    let (indirect, report) = bounce::run(model, direct, options, progress, level0, |unshot, total, account| {
        let sender = Sender { coefficients: unshot, reconstruction, n_levels: options.sender_levels };
        absolute_bounce(model, &sender, [direct, total], oracle, options, account, progress)
    })?;
    Ok(Solution { indirect, report })
}

fn absolute_bounce(
    model: &Model<'_>,
    sender: &Sender<'_, Absolute>,
    so_far: [&Coefficients<Absolute>; 2],
    oracle: &dyn Oracle,
    options: &TransportOptions,
    account: &mut Account,
    progress: &dyn Progress,
) -> Result<Coefficients<Absolute>, Error> {
    let basis = model.basis;
    let mut new = Coefficients::<Absolute>::zeros(basis);
    let mut active = Vec::new();
    for level in 0..basis.n_levels() {
        active = merge(active, &always_active(basis, level));
        let gathered = gather_level(model, sender, level, &active, options, progress)?;
        account.enter(basis, level, &active, &gathered, options.n_rays)?;
        let mut values = match level {
            0 => vec![Rgb::ZERO; basis.n_functions(0)],
            _ => basis.parents(level).push_down(new.level(level - 1)),
        };
        let mut refined = Vec::new();
        for (k, &function) in active.iter().enumerate() {
            let i = function as usize;
            let detail = gathered[k].irradiance - values[i];
            values[i] = gathered[k].irradiance;
            let total = so_far[0].level(level)[i] + so_far[1].level(level)[i] + values[i];
            let mean = account.regions[basis.points(level)[i].region.0 as usize].mean;
            if oracle.refine(&Detail { level, detail, noise: gathered[k].noise, total, mean }) {
                refined.push(function);
            }
        }
        *new.level_mut(level) = values;
        active = children_of(basis, level, &refined);
    }
    Ok(new)
}
