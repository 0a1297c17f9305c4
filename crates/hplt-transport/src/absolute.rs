use hplt_basis::{Absolute, Coefficients, Parents, Reconstruction};
use hplt_geom::{Progress, Rgb, parallel};

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
/// Later bounces are weak and hardly refined, yet their sum is not weak: pushed down plainly, they would fill every slit and
/// contact shadow that the first bounces resolved. With
/// [`shaped_push_down`](crate::TransportOptions::shaped_push_down) an ungathered function takes `inherited·T/T_inherited` per
/// channel, `T` being the indirect irradiance of the bounces before: the new light has the shape of the old.
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
        let (gathered, coverage) = gather_level(model, sender, level, &active, options, progress)?;
        account.enter(basis, level, &active, &gathered, coverage, options.n_rays)?;
        let mut values = match level {
            0 => vec![Rgb::ZERO; basis.n_functions(0)],
            _ if options.shaped_push_down => shaped(basis.parents(level), &new, so_far[1], level),
            _ => basis.parents(level).push_down(new.level(level - 1)),
        };
        let inherited = |function: u32| match level {
            0 => Rgb::ZERO,
            _ => basis.parents(level).inherited(function, new.level(level - 1)),
        };
        let mut refined = Vec::new();
        for (k, &function) in active.iter().enumerate() {
            let i = function as usize;
            let detail = gathered[k].irradiance - inherited(function);
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

/// The push-down of `new` to `level` in the shape of the field `before`.
fn shaped(parents: &Parents, new: &Coefficients<Absolute>, before: &Coefficients<Absolute>, level: usize) -> Vec<Rgb> {
    // No function is lit more than this many times better than its surroundings suggest.
    const MAX_RATIO: f32 = 2.0;
    let (new, coarse, fine) = (new.level(level - 1), before.level(level - 1), before.level(level));
    parallel::map(
        fine.len(),
        || (),
        |(), child| {
            let inherited = parents.inherited(child as u32, new);
            let expected = parents.inherited(child as u32, coarse);
            let ratio =
                |c: usize| if expected[c] > 0.0 { (fine[child][c] / expected[c]).clamp(0.0, MAX_RATIO) } else { 1.0 };
            inherited * Rgb::new(ratio(0), ratio(1), ratio(2))
        },
    )
}
