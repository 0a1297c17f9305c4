//! When a reading of the field is a guess.

use glam::{DVec3, Vec3};
use hplt_basis::{Absolute, BasisOptions, Coefficients, Reconstruction, ShepardBasis};
use hplt_geom::{Bvh, BvhOptions, Material, OrientedPoint, PointHierarchy, PointLevel, RegionId, Rgb, SceneBuilder};
use hplt_reference::scenes::{self, Shape};
use hplt_transport::LayeredInSight;

/// A square of 2 m, that nothing is near.
fn floor() -> Bvh {
    let mut builder = SceneBuilder::new();
    let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.5)));
    let corner = |x: f64, z: f64| DVec3::new(x, 0.0, z);
    let corners = [corner(-1.0, -1.0), corner(-1.0, 1.0), corner(1.0, 1.0), corner(1.0, -1.0)];
    Shape::new().quad(corners).push_into(&mut builder, "floor", white);
    Bvh::build(&scenes::build(builder), BvhOptions::default()).0
}

/// The value at the origin, facing up, and whether it is a guess: read from functions of support 0.1 with these normals and values,
/// all as far away.
fn read(functions: &[(Vec3, f32)]) -> (f32, bool) {
    let place = |(i, &(normal, _)): (usize, &(Vec3, f32))| {
        let (sin, cos) = (i as f32 * std::f32::consts::TAU / functions.len() as f32).sin_cos();
        OrientedPoint::new(0.02 * Vec3::new(cos, 0.0, sin), normal.normalize(), RegionId(0)).with_area(1.0)
    };
    let level = PointLevel::new(0.05, functions.iter().enumerate().map(place).collect());
    let basis = ShepardBasis::build(PointHierarchy { levels: vec![level], n_regions: 1 }, BasisOptions::default());
    let values = functions.iter().map(|&(_, value)| Rgb::splat(value)).collect();
    let field = Coefficients::<Absolute>::from_levels(vec![values]);
    let query = OrientedPoint::new(Vec3::ZERO, Vec3::Y, RegionId(0));
    let mut out = [Rgb::ZERO];
    let caster = &floor();
    let coverage = LayeredInSight { caster, gradients: None }.reconstruct(&basis, &field, 1, &[query], &mut out);
    (out[0].x, coverage.nearest == 1)
}

#[test]
fn a_value_that_hangs_on_one_function_is_a_guess() {
    // As at a narrow bevel: one function faces the same way, all others are of the walls beside it and have next to no say.
    let [up, aside] = [Vec3::Y, Vec3::new(1.0, 0.05, 0.0)];
    for others in [2.0, 100.0] {
        let (value, is_guess) = read(&[(up, 2.0), (aside, others), (aside, others), (aside, others)]);
        assert!((value - 2.0).abs() < 0.02 * others && is_guess, "{value}");
    }
    // Two that face the same way are still a guess, three are not.
    assert!(read(&[(up, 2.0), (up, 2.0), (aside, 2.0)]).1);
    for values in [[1.0, 2.0, 3.0], [2.0; 3]] {
        let (value, is_guess) = read(&values.map(|value| (up, value)));
        assert!((value - 2.0).abs() < 1e-6 && !is_guess, "{value}");
    }
}
