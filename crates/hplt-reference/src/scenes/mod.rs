//! Procedural scenes, as builders: world space, metres, y up, no file needed.
//!
//! Every function returns a [`SceneBuilder`] so that the caller can add lights, cameras or a mesh of its own;
//! [`build`] turns it into a [`Scene`].

mod basic;
mod colonnade;
mod cornell;
mod random;
mod shape;
mod statue;

pub use basic::{
    box_on_floor, cluttered_room, concentric_spheres, cube, furnace_box, geodesic_sphere, nested_rooms,
    parallel_plates, perpendicular_plates, plane_under_sky, random_boxes_furnace, single_sheet, sphere, torus,
    two_rooms,
};
pub use colonnade::{COLONNADE_TRIANGLES, colonnade};
pub use cornell::{Front, cornell_box, cornell_box_closed, room_with};
pub use shape::Shape;
pub use statue::{STATUE_TRIANGLES, statue_room};

use hplt_geom::{BuildPolicy, Scene, SceneBuilder};

/// The finished scene of a builder from this module.
///
/// # Panics
/// When the builder was given something invalid on top; the scenes themselves are valid.
pub fn build(builder: SceneBuilder) -> Scene {
    match builder.build(BuildPolicy::default()) {
        Ok((scene, _)) => scene,
        Err(error) => panic!("procedural scene: {error}"),
    }
}
