//! What happens to material values that light transport cannot use as they are; the same for every format.

use hplt_geom::{Material, Rgb};

use crate::{LoadOptions, LoadReport};

/// Clamps on request, and lowers albedos above the cap. `brightest` is the largest value of the albedo texture.
///
/// Values outside [0, 1] that are not clamped stay, so that building the scene names them in its error.
pub(crate) fn apply(material: &mut Material, brightest: Rgb, options: &LoadOptions, report: &mut LoadReport) {
    if options.policy.clamp_materials {
        let albedo = material.albedo.to_array().map(|a| if a > 1.0 { 1.0 } else { at_least_zero(a) });
        let exitance = material.exitance.to_array().map(|m| if m.is_finite() { at_least_zero(m) } else { 0.0 });
        let (albedo, exitance) = (Rgb::from(albedo), Rgb::from(exitance));
        if albedo != material.albedo || exitance != material.exitance {
            report.warn(format!("material \"{}\": values out of range are clamped", material.name));
            report.clamped_materials.push(material.name.clone());
            (material.albedo, material.exitance) = (albedo, exitance);
        }
    }
    let mut capped = false;
    for channel in 0..3 {
        let (albedo, texel) = (material.albedo[channel], brightest[channel]);
        if (0.0..=1.0).contains(&albedo) && albedo * texel > options.max_albedo {
            material.albedo[channel] = options.max_albedo / texel;
            capped = true;
        }
    }
    if capped {
        let cap = options.max_albedo;
        report.warn(format!("material \"{}\": albedo above {cap} is lowered to {cap}", material.name));
        report.capped_materials.push(material.name.clone());
    }
}

/// NaN becomes zero too.
fn at_least_zero(x: f32) -> f32 {
    if x > 0.0 { x } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hplt_geom::BuildPolicy;

    fn applied(albedo: Rgb, brightest: Rgb, clamp: bool) -> (Material, LoadReport) {
        let mut material = Material::diffuse("paint", albedo);
        material.exitance = if clamp { Rgb::new(-1.0, f32::INFINITY, 2.0) } else { Rgb::ZERO };
        let policy = BuildPolicy { clamp_materials: clamp, ..BuildPolicy::default() };
        let mut report = LoadReport::default();
        apply(&mut material, brightest, &LoadOptions { policy, ..LoadOptions::default() }, &mut report);
        (material, report)
    }

    #[test]
    fn the_cap_counts_factor_times_texture() {
        let (material, report) = applied(Rgb::new(1.0, 0.99, 0.5), Rgb::ONE, false);
        assert_eq!(material.albedo, Rgb::new(0.98, 0.98, 0.5));
        assert_eq!(report.capped_materials, ["paint"]);
        assert!(report.warnings[0].contains("\"paint\""));
        let (material, report) = applied(Rgb::ONE, Rgb::new(0.98, 0.5, 0.99), false);
        assert_eq!((material.albedo.x, material.albedo.y), (1.0, 1.0));
        assert!((material.albedo.z * 0.99 - 0.98).abs() < 1e-6);
        assert_eq!(report.capped_materials.len(), 1);
    }

    #[test]
    fn values_out_of_range_stay_unless_clamping_is_asked_for() {
        let (material, report) = applied(Rgb::new(1.5, -1.0, 0.5), Rgb::ONE, false);
        assert_eq!(material.albedo, Rgb::new(1.5, -1.0, 0.5));
        assert_eq!(report, LoadReport::default());
        let (material, report) = applied(Rgb::new(1.5, f32::NAN, 0.5), Rgb::ONE, true);
        assert_eq!(material.albedo, Rgb::new(0.98, 0.0, 0.5));
        assert_eq!(material.exitance, Rgb::new(0.0, 0.0, 2.0));
        assert_eq!((report.clamped_materials.len(), report.capped_materials.len()), (1, 1));
    }
}
