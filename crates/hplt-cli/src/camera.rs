//! Which camera a picture is taken with.

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{Camera, Ray, RayCaster, Scene};

use crate::exit::Failure;
use crate::sections::RenderSection;
use crate::values::Size;

/// Pixels across when nobody asks.
const DEFAULT_WIDTH: usize = 720;
/// Full vertical angle of view when nobody asks, degrees.
const DEFAULT_FOV: f64 = 45.0;

/// The camera that flags and config ask for, else the first of the scene, else one chosen automatically; and a line that
/// says which.
///
/// # Errors
/// When there is no such camera, or its values are impossible.
pub fn choose(scene: &Scene, caster: &dyn RayCaster, render: &RenderSection) -> Result<(Camera, String), Failure> {
    if let (Some(eye), Some(target)) = (render.eye, render.target) {
        let up = render.up.map_or(DVec3::Y, |u| DVec3::from(u.0));
        let fov = render.fov.unwrap_or(DEFAULT_FOV).to_radians();
        let camera = Camera::look_at(DVec3::from(eye.0), DVec3::from(target.0), up, fov)
            .map_err(|e| Failure::usage(e.to_string()))?;
        return Ok((camera, "from flags".into()));
    }
    let cameras = scene.cameras();
    let (mut camera, note) = match (&render.camera, cameras.first()) {
        (Some(name), _) => named(cameras, name)?,
        (None, Some(first)) => (first.clone(), format!("{} of the scene", described(0, first))),
        (None, None) => (automatic(scene, caster)?, "chosen automatically, the scene has none".into()),
    };
    if let Some(fov) = render.fov {
        camera.vertical_fov = fov.to_radians();
    }
    Ok((camera, note))
}

/// The size that is asked for, or one of the camera's aspect.
pub fn picture_size(camera: &Camera, asked: Option<Size>) -> Size {
    asked.unwrap_or_else(|| {
        let aspect = camera.aspect.filter(|a| a.is_finite() && (0.1..=10.0).contains(a)).unwrap_or(4.0 / 3.0);
        Size { width: DEFAULT_WIDTH, height: ((DEFAULT_WIDTH as f64 / aspect).round() as usize).max(1) }
    })
}

fn described(index: usize, camera: &Camera) -> String {
    match camera.name.is_empty() {
        true => format!("camera {index}"),
        false => format!("camera {index} \"{}\"", hplt_io::sanitized(&camera.name)),
    }
}

fn named(cameras: &[Camera], name: &str) -> Result<(Camera, String), Failure> {
    let by_name = cameras.iter().position(|c| c.name == name);
    let by_index = || name.parse::<usize>().ok().filter(|&i| i < cameras.len());
    match by_name.or_else(by_index) {
        Some(i) => Ok((cameras[i].clone(), described(i, &cameras[i]))),
        None => {
            let known: Vec<_> = cameras.iter().enumerate().map(|(i, c)| described(i, c)).collect();
            let known = if known.is_empty() { "none".into() } else { known.join(", ") };
            let name = hplt_io::sanitized(name);
            Err(Failure::usage(format!("--camera {name}: no such camera; the scene has: {known}")))
        }
    }
}

/// Inside a closed scene: from a place in the open towards where one sees farthest. Else from outside, from a corner above.
fn automatic(scene: &Scene, caster: &dyn RayCaster) -> Result<Camera, Failure> {
    let Some((min, max)) = scene.mesh().bounds() else {
        return Err(Failure::usage("there is nothing to look at"));
    };
    let frame = scene.frame();
    let (center, half) = ((min + max) * 0.5, (max - min) * 0.5);
    let impossible = |e: hplt_geom::Error| Failure::usage(format!("no automatic camera: {e}; use --eye and --target"));
    let (eye, target, fov) = match roomiest_place(scene, caster, center, half) {
        Some((eye, target)) => (eye, target, 65.0f64),
        None => {
            let direction = Vec3::new(0.55, 0.45, 0.7).normalize();
            let distance = 1.05 * half.length() / (0.5 * DEFAULT_FOV.to_radians()).sin() as f32;
            (center + direction * distance, center, DEFAULT_FOV)
        }
    };
    let world = |p: Vec3| frame.world_from_scene_point(p);
    Camera::look_at(world(eye), world(target), DVec3::Y, fov.to_radians()).map_err(impossible)
}

/// A place that is surrounded by surface, and the farthest point seen from it on its own height; `None` when from everywhere
/// one sees out.
fn roomiest_place(scene: &Scene, caster: &dyn RayCaster, center: Vec3, half: Vec3) -> Option<(Vec3, Vec3)> {
    const STEPS: [f32; 5] = [-0.8, -0.45, 0.0, 0.45, 0.8];
    let mut best: Option<(f32, Vec3, Vec3)> = None;
    for x in STEPS {
        for z in STEPS {
            for y in [-0.2f32, 0.2] {
                let eye = center + half * Vec3::new(x, y, z);
                let Some((distance, target)) = farthest_view(scene, caster, eye) else { continue };
                if best.is_none_or(|(most, ..)| distance > most) {
                    best = Some((distance, eye, target));
                }
            }
        }
    }
    best.map(|(_, eye, target)| (eye, target))
}

/// The sum of distances around the farthest direction seen from `eye`, and a point there; `None` unless nearly all
/// directions meet surface and nothing is too near.
fn farthest_view(scene: &Scene, caster: &dyn RayCaster, eye: Vec3) -> Option<(f32, Vec3)> {
    const N: usize = 24;
    let angle = |i: usize| std::f32::consts::TAU * i as f32 / N as f32;
    let distance = |i: usize, slope: f32| {
        let direction = Vec3::new(angle(i).cos(), slope, angle(i).sin()).normalize();
        let hit = caster.nearest(Ray::new(eye, direction));
        (!hit.is_miss()).then_some(hit.t)
    };
    let mut level = Vec::with_capacity(N);
    for i in 0..N {
        for slope in [-0.7, 0.7] {
            distance(i, slope)?;
        }
        level.push(distance(i, 0.0)?);
    }
    if level.iter().any(|&t| t < 0.04 * scene.diagonal()) {
        return None;
    }
    let around = |i: usize| level[(i + N - 1) % N] + level[i] + level[(i + 1) % N];
    let i = (0..N).max_by(|&a, &b| around(a).total_cmp(&around(b)))?;
    Some((around(i), eye + level[i] * Vec3::new(angle(i).cos(), -0.05, angle(i).sin())))
}

#[cfg(test)]
mod tests {
    use hplt_geom::{Bvh, BvhOptions};
    use hplt_reference::scenes;

    use super::*;

    #[test]
    fn a_closed_room_is_seen_from_inside_and_an_open_one_from_outside() {
        for (builder, inside) in [(scenes::two_rooms(0.01), true), (scenes::parallel_plates(1.0), false)] {
            let scene = scenes::build(builder);
            let (bvh, _) = Bvh::build(&scene, BvhOptions::fast());
            let (camera, note) = choose(&scene, &bvh, &RenderSection::default()).unwrap();
            assert!(note.contains("automatically"));
            let eye = scene.frame().scene_from_world_point(camera.eye);
            let (min, max) = scene.mesh().bounds().unwrap();
            assert_eq!(eye.cmpgt(min).all() && eye.cmplt(max).all(), inside);
        }
    }

    #[test]
    fn cameras_are_found_by_name_and_index() {
        let scene = scenes::build(scenes::cornell_box());
        let (bvh, _) = Bvh::build(&scene, BvhOptions::fast());
        let with = |name: &str| RenderSection { camera: Some(name.into()), ..RenderSection::default() };
        assert!(choose(&scene, &bvh, &with("0")).is_ok());
        assert!(choose(&scene, &bvh, &with("1")).unwrap_err().message.contains("no such camera"));
        let (camera, _) = choose(&scene, &bvh, &RenderSection::default()).unwrap();
        assert_eq!(picture_size(&camera, None), Size { width: 720, height: 720 });
    }
}
