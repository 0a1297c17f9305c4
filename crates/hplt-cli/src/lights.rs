//! Lights that a scene file lacks, from flags and config files.

use std::path::{Path, PathBuf};

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{Environment, Material, MeshInput, Rgb, SceneBuilder};
use hplt_io::Limits;
use serde::{Deserialize, Serialize};

use crate::exit::{Exit, Failure};

/// One light, in world space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum LightSpec {
    /// A parallelogram that emits uniformly along `edge1 × edge2` and reflects nothing.
    Rect {
        /// Name of its group of lights; without one it gets one of its own, after its kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
        /// One corner, m.
        corner: [f64; 3],
        /// From the corner along one side, m.
        edge1: [f64; 3],
        /// From the corner along the other side, m.
        edge2: [f64; 3],
        /// Radiance, W m⁻² sr⁻¹.
        radiance: [f32; 3],
    },
    /// A distant light; a disc when the angular radius is not zero.
    Sun {
        /// Name of its group of lights; without one it gets one of its own, after its kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
        /// From the scene towards the sun.
        direction: [f64; 3],
        /// Irradiance on a surface that faces the sun, W/m².
        irradiance: [f32; 3],
        /// Half-angle of the disc in degrees (the sun seen from Earth: 0.27).
        #[serde(default)]
        angular_radius: f32,
    },
    /// The same radiance from everywhere.
    Sky {
        /// Name of its group of lights; without one it gets one of its own, after its kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
        /// Radiance, W m⁻² sr⁻¹.
        radiance: [f32; 3],
    },
    /// An equirectangular map of radiance.
    Environment {
        /// Name of its group of lights; without one it gets one of its own, after its kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
        /// `.exr` or `.hdr`; in a config file relative to it.
        file: PathBuf,
    },
    /// A point light.
    Point {
        /// Name of its group of lights; without one it gets one of its own, after its kind.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        name: Option<String>,
        /// Position, m.
        position: [f64; 3],
        /// Radiant intensity, W/sr.
        intensity: [f32; 3],
    },
}

impl LightSpec {
    /// `[name=]x,y,z:ex,ey,ez:fx,fy,fz:r,g,b`.
    ///
    /// # Errors
    /// In words, when the text has another form.
    pub fn parse_rect(text: &str) -> Result<Self, String> {
        const FORM: &str = "[NAME=]x,y,z:ex,ey,ez:fx,fy,fz:r,g,b (corner, two edges, radiance)";
        let (name, text) = name_and_rest(text, FORM)?;
        let [corner, edge1, edge2, radiance] = parts(text, FORM)?;
        Ok(Self::Rect { name, corner, edge1, edge2, radiance: radiance.map(|x| x as f32) })
    }

    /// `[name=]dx,dy,dz:r,g,b` or `[name=]dx,dy,dz:r,g,b:degrees`.
    ///
    /// # Errors
    /// In words, when the text has another form.
    pub fn parse_sun(text: &str) -> Result<Self, String> {
        const FORM: &str = "[NAME=]dx,dy,dz:r,g,b[:degrees] (towards the sun, irradiance facing it, angular radius)";
        let (name, text) = name_and_rest(text, FORM)?;
        let (rest, angular_radius) = match text.splitn(3, ':').nth(2) {
            Some(degrees) => {
                let value: f32 = degrees.trim().parse().map_err(|_| format!("\"{text}\"; expected {FORM}"))?;
                (&text[..text.len() - degrees.len() - 1], value)
            }
            None => (text, 0.0),
        };
        let [direction, irradiance] = parts(rest, FORM)?;
        Ok(Self::Sun { name, direction, irradiance: irradiance.map(|x| x as f32), angular_radius })
    }

    /// `[name=]r,g,b`.
    ///
    /// # Errors
    /// In words, when the text has another form.
    pub fn parse_sky(text: &str) -> Result<Self, String> {
        const FORM: &str = "[NAME=]r,g,b (radiance)";
        let (name, text) = name_and_rest(text, FORM)?;
        let [radiance] = parts(text, FORM)?;
        Ok(Self::Sky { name, radiance: radiance.map(|x| x as f32) })
    }

    /// `[name=]x,y,z:r,g,b`.
    ///
    /// # Errors
    /// In words, when the text has another form.
    pub fn parse_point(text: &str) -> Result<Self, String> {
        const FORM: &str = "[NAME=]x,y,z:r,g,b (position, radiant intensity)";
        let (name, text) = name_and_rest(text, FORM)?;
        let [position, intensity] = parts(text, FORM)?;
        Ok(Self::Point { name, position, intensity: intensity.map(|x| x as f32) })
    }

    /// The same light, with a relative environment file taken from `folder`.
    pub fn in_folder(self, folder: &Path) -> Self {
        match self {
            Self::Environment { name, file } => Self::Environment { name, file: folder.join(file) },
            other => other,
        }
    }

    /// The name it was given.
    fn given_name(&self) -> Option<&str> {
        match self {
            Self::Rect { name, .. }
            | Self::Sun { name, .. }
            | Self::Sky { name, .. }
            | Self::Environment { name, .. }
            | Self::Point { name, .. } => name.as_deref(),
        }
    }

    fn kind(&self) -> &'static str {
        match self {
            Self::Rect { .. } => "lamp",
            Self::Sun { .. } => "sun",
            Self::Sky { .. } => "sky",
            Self::Environment { .. } => "environment",
            Self::Point { .. } => "point",
        }
    }
}

/// The names of lights, by which they are groups: as given, else after their kind: `lamp`, `lamp2`, …
fn names(lights: &[LightSpec]) -> Vec<String> {
    let name = |(i, light): (usize, &LightSpec)| match light.given_name() {
        Some(name) => name.to_owned(),
        None => {
            let is_alike = |l: &&LightSpec| l.given_name().is_none() && l.kind() == light.kind();
            match lights[..i].iter().filter(is_alike).count() {
                0 => light.kind().to_owned(),
                n => format!("{}{}", light.kind(), n + 1),
            }
        }
    };
    lights.iter().enumerate().map(name).collect()
}

/// Adds lights to a scene.
///
/// # Errors
/// When a value is out of range, there is more than one sky, or an environment file cannot be used.
pub fn add_lights(builder: &mut SceneBuilder, lights: &[LightSpec]) -> Result<(), Failure> {
    let skies = lights.iter().filter(|l| matches!(l, LightSpec::Sky { .. } | LightSpec::Environment { .. }));
    if skies.count() > 1 {
        return Err(Failure::usage("more than one sky or environment; expected one at most"));
    }
    for (i, (light, name)) in lights.iter().zip(names(lights)).enumerate() {
        add_light(builder, light, (&name, &format!("light {i} of flags and config")))?;
    }
    Ok(())
}

fn add_light(builder: &mut SceneBuilder, light: &LightSpec, (name, place): (&str, &str)) -> Result<(), Failure> {
    let invalid = |e: hplt_geom::Error| Failure::usage(format!("{place}: {e}"));
    if name.is_empty() {
        return Err(Failure::usage(format!("{place}: the name is empty; expected one")));
    }
    match light {
        LightSpec::Rect { corner, edge1, edge2, radiance, .. } => {
            add_rect(builder, (name, place), [corner, edge1, edge2], radiance)
        }
        LightSpec::Sun { direction, irradiance, angular_radius, .. } => {
            check_rgb(place, "irradiance", irradiance)?;
            let direction = unit(place, "direction", direction)?;
            if !(0.0..=45.0).contains(angular_radius) {
                let message = format!("{place}: angular radius {angular_radius}; expected 0 to 45 degrees");
                return Err(Failure::usage(message));
            }
            builder.push_directional_light(name, direction, Rgb::from(*irradiance), angular_radius.to_radians());
            Ok(())
        }
        LightSpec::Sky { radiance, .. } => {
            builder.set_environment(Environment::constant(Rgb::from(*radiance)).map_err(invalid)?.named(name));
            Ok(())
        }
        LightSpec::Environment { file, .. } => {
            builder.set_environment(hplt_io::load_environment(file, &Limits::default())?.named(name));
            Ok(())
        }
        LightSpec::Point { position, intensity, .. } => {
            check_rgb(place, "intensity", intensity)?;
            check_position(place, "position", position)?;
            builder.push_point_light(name, DVec3::from(*position), Rgb::from(*intensity));
            Ok(())
        }
    }
}

fn add_rect(
    builder: &mut SceneBuilder,
    (name, place): (&str, &str),
    [corner, edge1, edge2]: [&[f64; 3]; 3],
    radiance: &[f32; 3],
) -> Result<(), Failure> {
    check_rgb(place, "radiance", radiance)?;
    for (what, value) in [("corner", corner), ("edge1", edge1), ("edge2", edge2)] {
        check_position(place, what, value)?;
    }
    let [corner, edge1, edge2] = [corner, edge1, edge2].map(|v| DVec3::from(*v));
    if edge1.cross(edge2).length_squared() == 0.0 {
        return Err(Failure::usage(format!("{place}: the edges span no area; expected two that are not parallel")));
    }
    let exitance = exitance_from_radiance(Rgb::from(*radiance));
    let material = builder.push_material(Material::emitter(name, Rgb::ZERO, exitance));
    let mesh = MeshInput {
        name,
        positions: &[corner, corner + edge1, corner + edge1 + edge2, corner + edge2],
        normals: &[],
        uvs: &[],
        triangles: &[[0, 1, 2], [0, 2, 3]],
        material,
    };
    builder.push_mesh(mesh).map_err(|e| Failure::new(Exit::Limit, "LIMIT_SCENE", format!("{place}: {e}")))
}

fn check_rgb(name: &str, what: &str, value: &[f32; 3]) -> Result<(), Failure> {
    match value.iter().find(|x| !(**x >= 0.0 && x.is_finite())) {
        Some(x) => Err(Failure::usage(format!("{name}: {what} {x}; expected finite numbers of 0 or more"))),
        None => Ok(()),
    }
}

fn check_position(name: &str, what: &str, value: &[f64; 3]) -> Result<(), Failure> {
    match value.iter().find(|x| !(-1e18..=1e18).contains(*x)) {
        Some(x) => Err(Failure::usage(format!("{name}: {what} {x}; expected coordinates within ±1e18"))),
        None => Ok(()),
    }
}

fn unit(name: &str, what: &str, value: &[f64; 3]) -> Result<Vec3, Failure> {
    let found = DVec3::from(*value).try_normalize();
    found.map(|v| v.as_vec3()).ok_or_else(|| Failure::usage(format!("{name}: {what} has no length; expected one")))
}

/// The name before a `=`, if there is one.
fn name_and_rest<'t>(text: &'t str, form: &str) -> Result<(Option<String>, &'t str), String> {
    match text.split_once('=').map(|(name, rest)| (name.trim(), rest)) {
        Some(("", _)) => Err(format!("\"{text}\"; expected {form}")),
        Some((name, rest)) => Ok((Some(hplt_io::sanitized(name)), rest)),
        None => Ok((None, text)),
    }
}

/// Groups of three finite numbers with colons between them.
fn parts<const N: usize>(text: &str, form: &str) -> Result<[[f64; 3]; N], String> {
    let bad = || format!("\"{text}\"; expected {form}");
    let group = |group: &str| group.parse::<crate::values::Triple>().map(|t| t.0).map_err(|_| bad());
    let groups = text.split(':').map(group).collect::<Result<Vec<_>, _>>()?;
    groups.try_into().map_err(|_| bad())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lights_are_read_from_flags() {
        let rect = LightSpec::parse_rect("0,1,0:0.5,0,0:0,0,-0.5:10,9,8").unwrap();
        assert!(matches!(rect, LightSpec::Rect { edge2: [0.0, 0.0, -0.5], radiance: [10.0, 9.0, 8.0], .. }));
        let sun = LightSpec::parse_sun("0.15,1,0.12:10,10,10:0.27").unwrap();
        assert!(matches!(sun, LightSpec::Sun { angular_radius: 0.27, direction: [0.15, 1.0, 0.12], .. }));
        assert!(matches!(LightSpec::parse_sun("0,1,0:1,1,1").unwrap(), LightSpec::Sun { angular_radius: 0.0, .. }));
        for text in ["", "1,2", "0,1,0:1,1,1:x", "0,1,0:1,1,nan"] {
            assert!(LightSpec::parse_sun(text).is_err() && LightSpec::parse_rect(text).is_err(), "{text}");
        }
    }

    #[test]
    fn lights_have_the_name_that_they_were_given_or_one_after_their_kind() {
        let lights = [
            LightSpec::parse_sun("0,1,0:1,1,1").unwrap(),
            LightSpec::parse_sun("key light = 0,1,0:1,1,1:0.3").unwrap(),
            LightSpec::parse_sun("0,1,0:2,2,2").unwrap(),
            LightSpec::parse_point("0,1,0:2,2,2").unwrap(),
            LightSpec::parse_rect("desk=0,1,0:0,0,1:1,0,0:2,2,2").unwrap(),
            LightSpec::parse_rect("0,2,0:0,0,1:1,0,0:2,2,2").unwrap(),
            LightSpec::parse_sky("1,1,1").unwrap(),
        ];
        let expected = ["sun", "key light", "sun2", "point", "desk", "lamp", "sky"];
        assert_eq!(names(&lights), expected);
        let mut builder = SceneBuilder::new();
        add_lights(&mut builder, &lights).unwrap();
        let (scene, _) = builder.build(hplt_geom::BuildPolicy::default()).unwrap();
        let mut found = hplt_geom::LightGroups::of(&scene).names().to_vec();
        found.sort();
        let mut expected = expected.to_vec();
        expected.sort_unstable();
        assert_eq!(found, expected);
        assert!(LightSpec::parse_sky("=1,1,1").is_err() && LightSpec::parse_sky("a=b=1,1,1").is_err());
    }

    #[test]
    fn a_rectangle_emits_along_the_cross_product_of_its_edges() {
        let mut builder = SceneBuilder::new();
        let rect = LightSpec::parse_rect("0,1,0:0,0,1:1,0,0:2,2,2").unwrap();
        add_lights(&mut builder, &[rect]).unwrap();
        let (scene, _) = builder.build(hplt_geom::BuildPolicy::default()).unwrap();
        let triangle = scene.emissive_triangles().next().unwrap();
        assert!((scene.mesh().face_normal(triangle) - Vec3::Y).length() < 1e-6);
        assert!((scene.materials()[0].exitance.x - 2.0 * std::f32::consts::PI).abs() < 1e-5);
    }

    #[test]
    fn impossible_lights_are_usage_errors() {
        for light in [
            LightSpec::parse_sun("0,0,0:1,1,1").unwrap(),
            LightSpec::parse_sun("0,1,0:-1,1,1").unwrap(),
            LightSpec::parse_sun("0,1,0:1,1,1:90").unwrap(),
            LightSpec::parse_sky("-1,0,0").unwrap(),
            LightSpec::parse_rect("0,0,0:1,0,0:2,0,0:1,1,1").unwrap(),
        ] {
            let failure = add_lights(&mut SceneBuilder::new(), &[light]).unwrap_err();
            assert_eq!(failure.exit, Exit::Usage);
        }
        let skies = [LightSpec::parse_sky("1,1,1").unwrap(), LightSpec::parse_sky("1,1,1").unwrap()];
        assert_eq!(add_lights(&mut SceneBuilder::new(), &skies).unwrap_err().exit, Exit::Usage);
    }
}
