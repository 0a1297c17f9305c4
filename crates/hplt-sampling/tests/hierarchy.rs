//! Poisson-disk hierarchies.
mod common;

use common::{Shapes, cornell};
use hplt_geom::{Bvh, Interrupted, NoProgress, OrientedPoint, Progress, Scene};
use hplt_kdtree::KdTree;
use hplt_sampling::poisson::{distance_squared, rejection_distance_squared};
use hplt_sampling::{Error, Hierarchy, HierarchyOptions, Radius, Warning, poisson_hierarchy, random_surface_points};

fn make(scene: &Scene, bvh: &Bvh, options: &HierarchyOptions) -> Hierarchy {
    poisson_hierarchy(scene, bvh, options, &NoProgress).unwrap()
}

fn small(n_levels: usize) -> HierarchyOptions {
    HierarchyOptions { n_levels, ..HierarchyOptions::slides() }
}

#[test]
fn cornell_has_the_published_number_of_functions_at_level_0() {
    let (scene, bvh) = cornell().build();
    let hierarchy = make(&scene, &bvh, &small(4));
    println!("{:?}", hierarchy.report);
    let n = hierarchy.report.points_per_level[0];
    assert!((180..300).contains(&n), "{n}");
}
