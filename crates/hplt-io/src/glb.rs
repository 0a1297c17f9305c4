use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use glam::{DMat3, DQuat, DVec3, Vec3};
use hplt_geom::radiometry::radiance_from_radiosity;
use hplt_geom::{Camera, Light, LightShape, Material, Scene, Sides, TriangleId};
use serde_json::{Map, Value, json};

use crate::{Error, write_atomically};

/// Writes a scene as a GLB file: triangles, materials, punctual lights and cameras. Returns what the format (or this
/// writer) leaves out, one line each.
///
/// Vertices keep their bits: they are stored in scene space, under a node that carries the scene's frame. A scene
/// without textures, environment and suns loads back as it was, ordered by material and without unused materials; albedos
/// above the loader's cap return only if the cap is lifted.
///
/// # Errors
/// [`Error::Write`] when the file cannot be written or would exceed the 4 GiB of the format.
pub fn write_glb(path: &Path, scene: &Scene) -> Result<Vec<String>, Error> {
    let mut writer = Writer::default();
    writer.push_meshes(scene);
    writer.push_lights(scene);
    writer.push_cameras(scene);
    if scene.environment().is_some() {
        writer.left_out.push("the environment: glTF has none".into());
    }
    let bytes = writer.container().map_err(|e| Error::write(path, e))?;
    write_atomically(path, |file| file.write_all(&bytes))?;
    Ok(writer.left_out)
}

#[derive(Default)]
struct Writer {
    bin: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
    materials: Vec<Value>,
    primitives: Vec<Value>,
    nodes: Vec<Value>,
    cameras: Vec<Value>,
    lights: Vec<Value>,
    left_out: Vec<String>,
}

impl Writer {
    /// One mesh with a primitive per material, in the order of the materials' first triangles.
    fn push_meshes(&mut self, scene: &Scene) {
        let mesh = scene.mesh();
        let mut triangles_of: BTreeMap<u32, Vec<TriangleId>> = BTreeMap::new();
        for t in (0..mesh.n_triangles() as u32).map(TriangleId) {
            triangles_of.entry(mesh.material(t).0).or_default().push(t);
        }
        for (material, triangles) in triangles_of {
            let mut new_from_old = BTreeMap::new();
            let mut vertices = Vec::new();
            let mut indices = Vec::with_capacity(3 * triangles.len());
            for corner in triangles.iter().flat_map(|&t| mesh.triangles()[t.index()]) {
                let new = *new_from_old.entry(corner).or_insert_with(|| {
                    vertices.push(corner);
                    vertices.len() as u32 - 1
                });
                indices.push(new);
            }
            let mut attributes = Map::new();
            let positions: Vec<Vec3> = vertices.iter().map(|&v| mesh.positions()[v as usize]).collect();
            attributes.insert("POSITION".into(), self.push_vec3(&positions, true).into());
            if let Some(normals) = normals_of(scene, &vertices) {
                attributes.insert("NORMAL".into(), self.push_vec3(&normals, false).into());
            }
            let indices = self.push_indices(&indices);
            let material = self.push_material(&scene.materials()[material as usize]);
            self.primitives.push(json!({"attributes": attributes, "indices": indices, "material": material}));
        }
        let frame = scene.frame();
        self.nodes.push(json!({
            "name": "scene", "mesh": 0,
            "translation": frame.center.to_array(), "scale": [frame.scale(), frame.scale(), frame.scale()],
        }));
    }

    fn push_material(&mut self, material: &Material) -> usize {
        let Material { name, albedo, exitance, .. } = material;
        let mut value = json!({
            "name": name,
            "pbrMetallicRoughness": {
                "baseColorFactor": [albedo.x, albedo.y, albedo.z, 1.0], "metallicFactor": 0.0, "roughnessFactor": 1.0,
            },
            "doubleSided": material.emits == Sides::Both,
        });
        let radiance = radiance_from_radiosity(*exitance);
        let largest = radiance.max_element();
        if largest > 0.0 {
            // A power of two, so that the factor keeps its bits.
            let strength = f64::from(largest).log2().ceil().exp2();
            value["emissiveFactor"] = json!(radiance.to_array().map(|x| f64::from(x) / strength));
            value["extensions"] = json!({"KHR_materials_emissive_strength": {"emissiveStrength": strength}});
        }
        if material.reflects == Sides::Front {
            self.left_out.push(format!("material \"{}\": black back; load it with one_sided", crate::sanitized(name)));
        }
        if material.needs_uvs() || material.alpha.is_some() {
            self.left_out.push(format!("material \"{}\": textures and cut-outs", crate::sanitized(name)));
        }
        self.materials.push(value);
        self.materials.len() - 1
    }

    fn push_lights(&mut self, scene: &Scene) {
        let frame = scene.frame();
        // Intensity scales with the square of lengths.
        let unit = frame.scale() * frame.scale();
        for Light { name, shape } in scene.lights() {
            let (position, forward, light) = match *shape {
                LightShape::Point { position, intensity } => (position, DVec3::NEG_Z, power("point", intensity, unit)),
                LightShape::Spot { position, direction, intensity, cos_inner, cos_outer } => {
                    let mut light = power("spot", intensity, unit);
                    let (inner, outer) = (f64::from(cos_inner).acos(), f64::from(cos_outer).acos());
                    light["spot"] = json!({"innerConeAngle": inner, "outerConeAngle": outer});
                    (position, direction.as_dvec3(), light)
                }
                LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
                    if angular_radius > 0.0 {
                        self.left_out.push(format!("light \"{}\": its angular radius", crate::sanitized(name)));
                    }
                    (Vec3::ZERO, -direction_to_light.as_dvec3(), power("directional", irradiance, 1.0))
                }
                _ => {
                    self.left_out.push(format!("light \"{}\": of an unknown kind", crate::sanitized(name)));
                    continue;
                }
            };
            let mut light = light;
            light["name"] = json!(name);
            self.lights.push(light);
            self.nodes.push(json!({
                "name": name,
                "translation": frame.world_from_scene_point(position).to_array(),
                "rotation": DQuat::from_rotation_arc(DVec3::NEG_Z, forward.normalize_or(DVec3::NEG_Z)).to_array(),
                "extensions": {"KHR_lights_punctual": {"light": self.lights.len() - 1}},
            }));
        }
    }

    fn push_cameras(&mut self, scene: &Scene) {
        for Camera { name, eye, forward, up, vertical_fov, aspect } in scene.cameras() {
            let mut perspective = json!({"yfov": vertical_fov, "znear": 1e-3 * scene.frame().scale()});
            if let Some(aspect) = aspect {
                perspective["aspectRatio"] = json!(aspect);
            }
            self.cameras.push(json!({"name": name, "type": "perspective", "perspective": perspective}));
            let axes = DMat3::from_cols(forward.cross(*up), *up, -*forward).to_cols_array();
            let [x, y, z] = eye.to_array();
            let m = axes;
            self.nodes.push(json!({
                "name": name, "camera": self.cameras.len() - 1,
                "matrix": [m[0], m[1], m[2], 0.0, m[3], m[4], m[5], 0.0, m[6], m[7], m[8], 0.0, x, y, z, 1.0],
            }));
        }
    }

    fn push_vec3(&mut self, values: &[Vec3], with_bounds: bool) -> usize {
        let bytes = values.iter().flat_map(|v| v.to_array()).flat_map(f32::to_le_bytes);
        let view = self.push_view(bytes);
        let mut accessor = json!({"bufferView": view, "componentType": 5126, "count": values.len(), "type": "VEC3"});
        if let (true, Some(&first)) = (with_bounds, values.first()) {
            let bounds = values.iter().fold((first, first), |(min, max), v| (min.min(*v), max.max(*v)));
            accessor["min"] = json!(bounds.0.to_array());
            accessor["max"] = json!(bounds.1.to_array());
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn push_indices(&mut self, indices: &[u32]) -> usize {
        let view = self.push_view(indices.iter().flat_map(|i| i.to_le_bytes()));
        let accessor = json!({"bufferView": view, "componentType": 5125, "count": indices.len(), "type": "SCALAR"});
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// All content is made of four-byte numbers, so views stay aligned.
    fn push_view(&mut self, bytes: impl Iterator<Item = u8>) -> usize {
        let offset = self.bin.len();
        self.bin.extend(bytes);
        let view = json!({"buffer": 0, "byteOffset": offset, "byteLength": self.bin.len() - offset});
        self.views.push(view);
        self.views.len() - 1
    }

    fn container(&self) -> std::io::Result<Vec<u8>> {
        let roots: Vec<usize> = (0..self.nodes.len()).collect();
        let mut document = json!({
            "asset": {"version": "2.0", "generator": "hplt"},
            "scene": 0, "scenes": [{"nodes": roots}],
            "nodes": self.nodes, "meshes": [{"primitives": self.primitives}], "materials": self.materials,
            "accessors": self.accessors, "bufferViews": self.views, "buffers": [{"byteLength": self.bin.len()}],
        });
        let mut used = Vec::new();
        if !self.cameras.is_empty() {
            document["cameras"] = json!(self.cameras);
        }
        if !self.lights.is_empty() {
            document["extensions"] = json!({"KHR_lights_punctual": {"lights": self.lights}});
            used.push("KHR_lights_punctual");
        }
        if self.materials.iter().any(|m| m.get("extensions").is_some()) {
            used.push("KHR_materials_emissive_strength");
        }
        if !used.is_empty() {
            document["extensionsUsed"] = json!(used);
        }
        let mut text = serde_json::to_vec(&document)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let length = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(std::io::Error::other);
        let mut bytes = b"glTF\x02\0\0\0".to_vec();
        bytes.extend(length(12 + 8 + text.len() + 8 + self.bin.len())?);
        bytes.extend(length(text.len())?);
        bytes.extend(b"JSON");
        bytes.extend(text);
        bytes.extend(length(self.bin.len())?);
        bytes.extend(b"BIN\0");
        bytes.extend(&self.bin);
        Ok(bytes)
    }
}

/// Shading normals of the vertices; none when the scene keeps none, or one of them has none.
fn normals_of(scene: &Scene, vertices: &[u32]) -> Option<Vec<Vec3>> {
    let normals = scene.mesh().shading_normals();
    let normal = |&v: &u32| normals.get(v as usize).copied().filter(|n| *n != Vec3::ZERO);
    vertices.iter().map(normal).collect()
}

/// A light whose colour is relative to its intensity, a power of two.
fn power(kind: &str, value: Vec3, unit: f64) -> Value {
    let value = value.as_dvec3() * unit;
    let largest = value.max_element();
    let intensity = if largest > 0.0 { largest.log2().ceil().exp2() } else { 0.0 };
    let color = if intensity > 0.0 { value / intensity } else { DVec3::ZERO };
    json!({"type": kind, "intensity": intensity, "color": color.to_array()})
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LoadOptions, load_scene};
    use hplt_geom::{BuildPolicy, MeshInput, Rgb, SceneBuilder};

    fn scene() -> Scene {
        let mut builder = SceneBuilder::new();
        let red = builder.push_material(Material::diffuse("red \"wall\"", Rgb::new(0.63, 0.065, 0.05)));
        let glow =
            Material { emits: Sides::Both, ..Material::emitter("glow", Rgb::splat(0.2), Rgb::new(53.4, 3e-3, 12.0)) };
        let glow = builder.push_material(glow);
        let positions: Vec<DVec3> = (0..60)
            .map(|i| {
                DVec3::new((f64::from(i) * 1.7).sin() * 3.0 + 100.0, f64::from(i) / 7.0, (f64::from(i) * 0.3).cos())
            })
            .collect();
        let normals: Vec<Vec3> = positions.iter().map(|p| p.as_vec3().normalize()).collect();
        for (k, material) in [red, glow].into_iter().enumerate() {
            let triangles: Vec<[u32; 3]> = (0..28).map(|i| [i, i + 1 + k as u32, i + 2 + k as u32 * 9]).collect();
            let mesh = MeshInput {
                name: "m",
                positions: &positions,
                normals: if k == 0 { &normals } else { &[] },
                uvs: &[],
                triangles: &triangles,
                material,
            };
            builder.push_mesh(mesh).unwrap();
        }
        builder.push_point_light("bulb", DVec3::new(101.0, 2.0, 0.5), Rgb::new(10.0, 8.0, 0.0));
        builder.push_spot_light("spot", DVec3::new(99.0, 5.0, 0.0), Vec3::new(0.0, -1.0, 0.2), Rgb::ONE, 0.3, 0.6);
        builder.push_directional_light("sun", Vec3::new(0.1, 1.0, 0.3), Rgb::new(3.0, 2.0, 1.0), 0.0);
        let mut camera =
            Camera::look_at(DVec3::new(90.0, 3.0, 1.0), DVec3::new(100.0, 3.0, 0.0), DVec3::Y, 0.7).unwrap();
        (camera.name, camera.aspect) = ("front".into(), Some(1.5));
        builder.push_camera(camera);
        builder.build(BuildPolicy::default()).unwrap().0
    }

    fn returned(scene: &Scene) -> (Scene, Vec<String>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.glb");
        let left_out = write_glb(&path, scene).unwrap();
        let loaded = load_scene(&path, &LoadOptions::default()).unwrap();
        (loaded.scene.build(BuildPolicy::default()).unwrap().0, left_out)
    }

    fn close(a: Vec3, b: Vec3) -> bool {
        (a - b).abs().max_element() <= 4e-7 * b.abs().max_element()
    }

    #[test]
    fn a_scene_returns() {
        let before = scene();
        let (after, left_out) = returned(&before);
        assert_eq!(left_out, Vec::<String>::new());
        assert_eq!(after.mesh().n_triangles(), before.mesh().n_triangles());
        assert_eq!(after.frame().exponent, before.frame().exponent);
        for t in (0..before.mesh().n_triangles() as u32).map(TriangleId) {
            for (a, b) in after.mesh().corners(t).iter().zip(before.mesh().corners(t)) {
                assert!((a - b).abs().max_element() < 1e-7, "{a} {b}");
            }
            let normals = [&after, &before].map(|s| s.mesh().shading_normal_at(t, 0.3, 0.3));
            assert!((normals[0] - normals[1]).length() < 1e-5);
            let materials = [&after, &before].map(|s| s.material(t));
            assert_eq!((&materials[0].name, materials[0].albedo), (&materials[1].name, materials[1].albedo));
            assert!(close(materials[0].exitance, materials[1].exitance));
            assert_eq!((materials[0].emits, materials[0].reflects), (materials[1].emits, materials[1].reflects));
        }
        let (a, b) = (&after.cameras()[0], &before.cameras()[0]);
        assert!(a.name == b.name && a.aspect == b.aspect && a.vertical_fov == b.vertical_fov && a.eye == b.eye);
        assert!((a.forward - b.forward).length() < 1e-12 && (a.up - b.up).length() < 1e-12);
        assert_eq!(after.lights().len(), 3);
        for (a, b) in after.lights().iter().zip(before.lights()) {
            assert_eq!(a.name, b.name);
            let numbers = |shape: &LightShape| match *shape {
                LightShape::Point { position, intensity } => vec![position, intensity],
                LightShape::Spot { position, direction, intensity, cos_inner, cos_outer } => {
                    vec![position, direction, intensity, Vec3::new(cos_inner, cos_outer, 0.0)]
                }
                LightShape::Directional { direction_to_light, irradiance, .. } => vec![direction_to_light, irradiance],
                _ => vec![],
            };
            for (x, y) in numbers(&a.shape).into_iter().zip(numbers(&b.shape)) {
                assert!((x - y).length() < 1e-6 * y.length().max(1.0), "{a:?} {b:?}");
            }
        }
    }

    #[test]
    fn what_the_format_lacks_is_named() {
        let mut builder = SceneBuilder::new();
        let black_back = Material { reflects: Sides::Front, ..Material::diffuse("m", Rgb::splat(0.5)) };
        let material = builder.push_material(black_back);
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let triangles = [[0, 1, 2]];
        let mesh =
            MeshInput { name: "t", positions: &positions, normals: &[], uvs: &[], triangles: &triangles, material };
        builder.push_mesh(mesh).unwrap();
        builder.push_directional_light("sun", Vec3::Y, Rgb::ONE, 0.1);
        builder.set_environment(hplt_geom::Environment::constant(Rgb::ONE).unwrap());
        let (_, left_out) = returned(&builder.build(BuildPolicy::default()).unwrap().0);
        assert_eq!(left_out.len(), 3, "{left_out:?}");
    }
}
