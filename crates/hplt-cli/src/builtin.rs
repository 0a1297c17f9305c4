//! The procedural scenes by name.

use hplt_geom::{Material, Rgb, SceneBuilder};
use hplt_reference::scenes;

use crate::exit::Failure;

/// A scene that is made, not loaded.
pub struct Builtin {
    /// Its name.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// Triangles when nobody asks; `None` when they cannot be chosen.
    pub triangles: Option<usize>,
    build: fn(usize) -> SceneBuilder,
}

/// All of them.
pub const BUILTINS: &[Builtin] = &[
    Builtin {
        name: "cornell",
        about: "the Cornell box, open in front",
        triangles: None,
        build: |_| scenes::cornell_box(),
    },
    Builtin {
        name: "cornell-closed",
        about: "the Cornell box with a white front wall",
        triangles: None,
        build: |_| scenes::cornell_box_closed(scenes::Front::White),
    },
    Builtin {
        name: "furnace",
        about: "a closed cube, albedo 0.5, exitance 1 everywhere: E = 2",
        triangles: None,
        build: |_| scenes::furnace_box(Rgb::splat(0.5), Rgb::ONE),
    },
    Builtin {
        name: "white-furnace",
        about: "the same with albedo 1: no finite solution",
        triangles: None,
        build: |_| scenes::furnace_box(Rgb::ONE, Rgb::ONE),
    },
    Builtin {
        name: "dark-room",
        about: "a closed cube, albedo 0.5, no light",
        triangles: None,
        build: |_| scenes::furnace_box(Rgb::splat(0.5), Rgb::ZERO),
    },
    Builtin {
        name: "spheres",
        about: "concentric spheres, radii 1 and 2, the inner one emits 1: B = 10/9 and 2/9",
        triangles: Some(5120),
        build: |n| {
            let inner = Material::emitter("inner", Rgb::splat(0.5), Rgb::ONE);
            scenes::concentric_spheres(1.0, 2.0, n / 2, inner, Material::diffuse("outer", Rgb::splat(0.5)))
        },
    },
    Builtin {
        name: "plates",
        about: "two facing unit squares at distance 1, the lower one emits 1",
        triangles: None,
        build: |_| scenes::parallel_plates(1.0),
    },
    Builtin {
        name: "corner",
        about: "two unit squares with a common edge, the horizontal one emits 1",
        triangles: None,
        build: |_| scenes::perpendicular_plates(1.0, 1.0),
    },
    Builtin {
        name: "two-rooms",
        about: "a lit and a dark room, a wall of 1 cm between them",
        triangles: None,
        build: |_| scenes::two_rooms(0.01),
    },
    Builtin {
        name: "nested-rooms",
        about: "a dark room inside a lit one",
        triangles: None,
        build: |_| scenes::nested_rooms(),
    },
    Builtin {
        name: "box-on-floor",
        about: "a box on the floor of a lit room",
        triangles: None,
        build: |_| scenes::box_on_floor(),
    },
    Builtin {
        name: "plane",
        about: "a square of 2 m, albedo 0.5, under a sky of radiance 1: B = pi/2",
        triangles: None,
        build: |_| scenes::plane_under_sky(2.0, Rgb::splat(0.5), Rgb::ONE),
    },
    Builtin {
        name: "statue-room",
        about: "a draped figure in a closed room, three cameras",
        triangles: Some(scenes::STATUE_TRIANGLES),
        build: scenes::statue_room,
    },
    Builtin {
        name: "colonnade",
        about: "a court between two storeys of columns, with drapes, four cameras",
        triangles: Some(scenes::COLONNADE_TRIANGLES),
        build: scenes::colonnade,
    },
    Builtin {
        name: "clutter",
        about: "500 random boxes and a room, a generalised furnace: B = 1 everywhere",
        triangles: None,
        build: |_| scenes::random_boxes_furnace(1),
    },
];

/// The scene `NAME` or `NAME:TRIANGLES`.
///
/// # Errors
/// When there is no such scene, or its triangles cannot be chosen.
pub fn from_spec(spec: &str) -> Result<SceneBuilder, Failure> {
    match spec.split_once(':') {
        Some((name, n)) => {
            let n = n.parse().map_err(|_| Failure::usage(format!("gen:{spec}: \"{n}\"; expected a count")))?;
            build(name, Some(n))
        }
        None => build(spec, None),
    }
}

/// The scene `name` with about `triangles` triangles.
///
/// # Errors
/// When there is no such scene, or its triangles cannot be chosen.
pub fn build(name: &str, triangles: Option<usize>) -> Result<SceneBuilder, Failure> {
    const MAX_TRIANGLES: usize = 20_000_000;
    let found = BUILTINS.iter().find(|b| b.name == name).ok_or_else(|| {
        let names: Vec<_> = BUILTINS.iter().map(|b| b.name).collect();
        let message =
            format!("no built-in scene \"{}\"; expected one of {}", hplt_io::sanitized(name), names.join(", "));
        Failure::usage(message)
    })?;
    let n = match (triangles, found.triangles) {
        (Some(_), None) => return Err(Failure::usage(format!("{name}: the number of triangles cannot be chosen"))),
        (Some(n), Some(_)) if !(100..=MAX_TRIANGLES).contains(&n) => {
            return Err(Failure::usage(format!("{name}: {n} triangles; expected 100 to {MAX_TRIANGLES}")));
        }
        (asked, default) => asked.or(default).unwrap_or(0),
    };
    Ok((found.build)(n))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_scene_builds() {
        for builtin in BUILTINS {
            let (scene, _) = from_spec(builtin.name).unwrap().build(hplt_geom::BuildPolicy::default()).unwrap();
            assert!(scene.mesh().n_triangles() > 0, "{}", builtin.name);
        }
    }

    #[test]
    fn unknown_names_and_counts_are_refused() {
        for spec in ["castle", "cornell:100", "spheres:x", "spheres:1", "spheres:99999999999"] {
            assert_eq!(from_spec(spec).unwrap_err().exit, crate::exit::Exit::Usage, "{spec}");
        }
        let (scene, _) = from_spec("spheres:1000").unwrap().build(hplt_geom::BuildPolicy::default()).unwrap();
        assert!((500..2000).contains(&scene.mesh().n_triangles()));
    }
}
