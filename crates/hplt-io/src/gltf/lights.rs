use glam::{DAffine3, DVec3};
use hplt_geom::{Camera, Error as SceneError, Rgb, SceneBuilder};

use super::buffers::{item, undefined};
use super::json::{self, Document};
use crate::{Error, LightUnit, LoadOptions, LoadReport};

/// Adds light `index` of `KHR_lights_punctual`, which shines along -z of its node.
pub(super) fn push_light(
    document: &Document,
    index: u32,
    node_name: Option<&str>,
    world_from_node: &DAffine3,
    options: &LoadOptions,
    scene: &mut SceneBuilder,
    report: &mut LoadReport,
) -> Result<(), Error> {
    let lights = document.extensions.as_ref().and_then(|e| e.lights.as_ref());
    let lights = lights.map_or(&[][..], |l| &l.lights);
    let light = item(lights, index, "extensions.KHR_lights_punctual.lights")?;
    let name = crate::sanitized(light.name.as_deref().or(node_name).unwrap_or(""));
    let place = format!("light {index} \"{name}\"");
    let power = power(light, options.light_unit);
    let position = world_from_node.translation;
    let direction = world_from_node.transform_vector3(DVec3::NEG_Z);
    // Components beyond the range of single precision would make the direction infinite.
    let direction = direction.try_normalize().unwrap_or(DVec3::ZERO).as_vec3();
    match light.r#type.as_deref() {
        Some("point") => scene.push_point_light(name, position, power),
        Some("directional") => scene.push_directional_light(name, -direction, power, 0.0),
        Some("spot") => {
            let (inner, outer) = cone(light, &place)?;
            scene.push_spot_light(name, position, direction, power, inner, outer);
        }
        Some(other) => {
            let message = format!("\"{}\"; expected point, spot or directional", crate::sanitized(other));
            return Err(Error::invalid(format!("{place}, type"), "VALUE_NOT_IN_LIST", message));
        }
        None => return Err(undefined(&format!("{place}, type"))),
    }
    if options.light_unit == LightUnit::Auto {
        report.warn("light unit: candela are read as W/sr and lux as W/m², one to one (assumed)");
    }
    if light.range.is_some() {
        report.leave_out("the range of lights; light has none");
    }
    report.lights += 1;
    Ok(())
}

fn power(light: &json::Light, unit: LightUnit) -> Rgb {
    let factor = light.intensity.unwrap_or(1.0) * unit.factor();
    Rgb::from(light.color.unwrap_or([1.0; 3]).map(|c| (c * factor) as f32))
}

fn cone(light: &json::Light, place: &str) -> Result<(f32, f32), Error> {
    let spot = light.spot.as_ref().ok_or_else(|| undefined(&format!("{place}, spot")))?;
    let inner = spot.inner_cone_angle.unwrap_or(0.0);
    let outer = spot.outer_cone_angle.unwrap_or(std::f64::consts::FRAC_PI_4);
    // Files round a right angle up as often as down.
    if 0.0 <= inner && inner < outer && outer <= std::f64::consts::FRAC_PI_2 + 1e-4 {
        return Ok((inner as f32, outer as f32));
    }
    let message = format!("inner {inner}, outer {outer}; expected 0 <= inner < outer <= π/2");
    Err(Error::invalid(format!("{place}, cone angles"), "VALUE_NOT_IN_RANGE", message))
}

/// Adds camera `index`, which looks along -z of its node with y up.
pub(super) fn push_camera(
    document: &Document,
    index: u32,
    node_name: Option<&str>,
    world_from_node: &DAffine3,
    scene: &mut SceneBuilder,
    report: &mut LoadReport,
) -> Result<(), Error> {
    let source = item(&document.cameras, index, "cameras")?;
    let name = crate::sanitized(source.name.as_deref().or(node_name).unwrap_or(""));
    let place = format!("cameras[{index}] \"{name}\"");
    match (source.r#type.as_deref(), &source.perspective) {
        (Some("perspective"), Some(perspective)) => {
            let yfov = perspective.yfov.ok_or_else(|| undefined(&format!("{place}, yfov")))?;
            match camera(world_from_node, yfov) {
                Ok(mut camera) => {
                    camera.name.clone_from(&name);
                    camera.aspect = perspective.aspect_ratio.filter(|a| a.is_finite() && *a > 0.0);
                    scene.push_camera(camera);
                    report.camera_names.push(name);
                    report.cameras += 1;
                }
                Err(error) => return Err(Error::from(error).within(&place)),
            }
        }
        (Some("orthographic"), _) => report.leave_out(format!("camera \"{name}\": orthographic")),
        (Some("perspective"), None) => return Err(undefined(&format!("{place}, perspective"))),
        (other, _) => {
            let message = format!("\"{}\"; expected perspective", crate::sanitized(other.unwrap_or("")));
            return Err(Error::invalid(format!("{place}, type"), "VALUE_NOT_IN_LIST", message));
        }
    }
    Ok(())
}

fn camera(world_from_node: &DAffine3, yfov: f64) -> Result<Camera, SceneError> {
    let eye = world_from_node.translation;
    let forward = world_from_node.transform_vector3(DVec3::NEG_Z).normalize_or_zero();
    let up = world_from_node.transform_vector3(DVec3::Y).normalize_or_zero();
    let mut camera = Camera::look_at(DVec3::ZERO, forward, up, yfov)?;
    if !eye.is_finite() {
        return Err(SceneError::NotFinite { place: "camera eye".into(), value: eye.x + eye.y + eye.z });
    }
    camera.eye = eye;
    Ok(camera)
}
