//! When a reading of the field is a guess.

use glam::{DVec3, Vec3};
use hplt_basis::{Absolute, BasisOptions, Coefficients, Reconstruction, ShepardBasis};
use hplt_geom::{
    Bvh, BvhOptions, Material, OrientedPoint, PointHierarchy, PointLevel, RayCaster, RegionId, Rgb, SceneBuilder,
};
use hplt_reference::scenes::{self, Shape};
use hplt_transport::{LayeredInSight, LayeredNearestInSight, OpenAir};

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

/// A thin wall stands between a query and bright functions on a step behind it, whose extents know nothing of it.
#[test]
fn light_leaks_through_a_thin_wall_where_no_ray_looks() {
    let mut builder = SceneBuilder::new();
    let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.5)));
    let corner = |y: f64, z: f64| DVec3::new(0.0, y, z);
    let corners = [corner(0.0, -1.0), corner(0.0, 1.0), corner(0.5, 1.0), corner(0.5, -1.0)];
    Shape::new().quad(corners).push_into(&mut builder, "wall", white);
    let scene = scenes::build(builder);
    let (wall, _) = Bvh::build(&scene, BvhOptions::default());
    let at = |x: f64, y: f64, z: f64| {
        let position = scene.frame().scene_from_world_point(DVec3::new(x, y, z));
        OrientedPoint::new(position, Vec3::Y, RegionId(0)).with_area(1.0)
    };
    let places = [-0.03, 0.0, 0.03];
    let points = places.map(|z| at(-0.03, 0.001, z)).into_iter().chain(places.map(|z| at(0.02, 0.01, z))).collect();
    let support = PointLevel::new(0.05 / scene.frame().scale() as f32, points);
    let basis = ShepardBasis::build(PointHierarchy { levels: vec![support], n_regions: 1 }, BasisOptions::default());
    let values = [[0.0; 3], [1.0; 3]].concat().into_iter().map(Rgb::splat).collect();
    let field = Coefficients::<Absolute>::from_levels(vec![values]);
    let read = |caster: &dyn RayCaster| {
        let mut out = [Rgb::ZERO];
        LayeredInSight { caster, gradients: None }.reconstruct(&basis, &field, 1, &[at(-0.01, 0.001, 0.0)], &mut out);
        out[0].x
    };
    let is_read = |caster: &dyn RayCaster| {
        LayeredNearestInSight { caster }.in_sight(&basis, &field, 1, &[at(-0.001, 0.001, 0.0)])[0].is_some()
    };
    assert_eq!(read(&wall), 0.0);
    assert!(read(&OpenAir) > 0.3, "{}", read(&OpenAir));
    assert!(!is_read(&wall) && is_read(&OpenAir));
}
