//! What glTF files mean, on scenes of a few triangles made here.
#![cfg(all(feature = "gltf", feature = "textures"))]

use std::f32::consts::PI;

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::{BuildPolicy, LightShape, Scene, Sides, TriangleId};
use hplt_io::{LightUnit, LoadOptions, LoadReport, load_scene};

/// A quad in the plane z = 0, front towards +z.
const QUAD: [[f32; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

/// Arrays in one buffer, and the JSON of their accessors.
#[derive(Default)]
struct Bin {
    bytes: Vec<u8>,
    views: Vec<String>,
    accessors: Vec<String>,
}

impl Bin {
    fn push(&mut self, bytes: Vec<u8>, component: u32, kind: &str, count: usize, more: &str) -> usize {
        let offset = self.bytes.len();
        self.views.push(format!(r#"{{"buffer":0,"byteOffset":{offset},"byteLength":{}}}"#, bytes.len()));
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let view = self.views.len() - 1;
        self.accessors.push(format!(
            r#"{{"bufferView":{view},"componentType":{component},"type":"{kind}","count":{count}{more}}}"#
        ));
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let kind = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][N];
        self.push(values.iter().flatten().flat_map(|x| x.to_le_bytes()).collect(), 5126, kind, values.len(), "")
    }

    fn indices(&mut self, values: &[u16]) -> usize {
        self.push(values.iter().flat_map(|x| x.to_le_bytes()).collect(), 5123, "SCALAR", values.len(), "")
    }

    /// A GLB file; `rest` holds the other members of the document.
    fn glb(&self, rest: &str) -> Vec<u8> {
        let mut json = format!(
            r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],{rest}}}"#,
            self.bytes.len(),
            self.views.join(","),
            self.accessors.join(",")
        )
        .into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((28 + json.len() as u32 + self.bytes.len() as u32).to_le_bytes());
        for (kind, data) in [(b"JSON", &json), (b"BIN\0", &self.bytes)] {
            glb.extend((data.len() as u32).to_le_bytes());
            glb.extend(kind);
            glb.extend(data);
        }
        glb
    }
}

fn load_with(bin: &Bin, rest: &str, options: &LoadOptions) -> (Scene, LoadReport) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.glb");
    std::fs::write(&path, bin.glb(rest)).unwrap();
    let loaded = load_scene(&path, options).unwrap();
    (loaded.scene.build(BuildPolicy::default()).unwrap().0, loaded.report)
}

fn load(bin: &Bin, rest: &str) -> (Scene, LoadReport) {
    load_with(bin, rest, &LoadOptions::default())
}

/// The quad under a node, with more members for the node, the material and the document.
fn quad_scene(node: &str, material: &str, rest: &str) -> (Bin, String) {
    let mut bin = Bin::default();
    let position = bin.floats(&QUAD);
    let indices = bin.indices(&[0, 1, 2, 0, 2, 3]);
    let uv = bin.floats(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]);
    let other_uv = bin.floats(&[[0.25f32, 0.25]; 4]);
    let rest = format!(
        r#""nodes":[{{"mesh":0{node}}}],"materials":[{{"name":"m"{material}}}],"meshes":[{{"primitives":[{{"material":0,
           "indices":{indices},"attributes":{{"POSITION":{position},"TEXCOORD_0":{uv},"TEXCOORD_1":{other_uv}}}}}]}}]{rest}"#
    );
    (bin, rest)
}

fn world_corners(scene: &Scene, t: u32) -> [DVec3; 3] {
    scene.mesh().corners(TriangleId(t)).map(|p| scene.frame().world_from_scene_point(p))
}

fn world_area(scene: &Scene) -> f64 {
    let n = scene.mesh().n_triangles() as u32;
    (0..n).map(|t| scene.mesh().area(TriangleId(t))).sum::<f64>() * scene.frame().scale().powi(2)
}

#[test]
fn lists_strips_and_fans_with_and_without_indices_agree() {
    let strip_order: Vec<[f32; 3]> = [0, 1, 3, 2].map(|i: usize| QUAD[i]).to_vec();
    for (mode, positions, indices) in [
        (4, QUAD.to_vec(), Some(vec![0u16, 1, 2, 0, 2, 3])),
        (5, QUAD.to_vec(), Some(vec![0, 1, 3, 2])),
        (5, strip_order, None),
        (6, QUAD.to_vec(), Some(vec![0, 1, 2, 3])),
        (6, QUAD.to_vec(), None),
    ] {
        let mut bin = Bin::default();
        let position = bin.floats(&positions);
        let indices = indices.map_or(String::new(), |i| format!(r#","indices":{}"#, bin.indices(&i)));
        let rest = format!(
            r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"mode":{mode},"attributes":{{"POSITION":{position}}}{indices}}}]}}]"#
        );
        let (scene, report) = load(&bin, &rest);
        assert_eq!((scene.mesh().n_triangles(), report.triangles), (2, 2), "mode {mode}");
        assert!((0..2).all(|t| scene.mesh().face_normal(TriangleId(t)) == Vec3::Z), "mode {mode}");
        assert!((world_area(&scene) - 1.0).abs() < 1e-6);
    }
}

#[test]
fn mirrored_nodes_keep_their_fronts_and_flat_ones_vanish() {
    // Mirrored along z: the quad stays where it is and faces -z now, as the mirrored solid would.
    let (bin, rest) = quad_scene(r#","scale":[1,1,-1]"#, "", "");
    let (scene, _) = load(&bin, &rest);
    assert_eq!(scene.mesh().face_normal(TriangleId(0)), -Vec3::Z);
    // Mirrored along x: it still faces +z.
    let (bin, rest) = quad_scene(r#","scale":[-1,1,1]"#, "", "");
    let (scene, _) = load(&bin, &rest);
    assert_eq!(scene.mesh().face_normal(TriangleId(0)), Vec3::Z);
    assert!((world_area(&scene) - 1.0).abs() < 1e-6);
    let two = r#""nodes":[{"mesh":0},{"mesh":0,"scale":[0,1,1]}]"#;
    let (bin, rest) = quad_scene("", "", "");
    let (scene, report) = load(&bin, &rest.replace(r#""nodes":[{"mesh":0}]"#, two));
    assert_eq!((scene.mesh().n_triangles(), report.triangles), (2, 4));
    assert!(report.warnings.iter().any(|w| w.contains("flattens")), "{report:?}");
}

#[test]
fn small_detail_far_from_the_origin_is_kept() {
    let (bin, rest) = quad_scene(r#","scale":[0.001,0.001,0.001],"translation":[1000000,0,-1000000]"#, "", "");
    let (scene, report) = load(&bin, &rest);
    assert!((world_area(&scene) - 1e-6).abs() < 1e-12);
    assert!(report.coordinate_quantum < 1e-9 && report.warnings.iter().all(|w| !w.contains("far from")), "{report:?}");
    // And coordinates that are rounded already say so.
    let mut bin = Bin::default();
    let far: Vec<[f32; 3]> = QUAD.iter().map(|p| [p[0] + 1e6, p[1], p[2]]).collect();
    let position = bin.floats(&far);
    let rest = format!(
        r#""nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"mode":6,"attributes":{{"POSITION":{position}}}}}]}}]"#
    );
    let (_, report) = load(&bin, &rest);
    assert_eq!(report.coordinate_quantum, 0.0625);
    assert!(report.warnings.iter().any(|w| w.contains("far from its origin")), "{report:?}");
}

#[test]
fn instances_are_placed_by_translation_rotation_and_scale() {
    let mut bin = Bin::default();
    let position = bin.floats(&QUAD);
    let translation = bin.floats(&[[0.0f32, 0.0, 0.0], [10.0, 0.0, 0.0]]);
    // Identity, and 90° about z as normalised 16-bit integers.
    let half = (32767.0 * std::f32::consts::FRAC_1_SQRT_2).round() as i16;
    let rotation: Vec<u8> = [0, 0, 0, 32767, 0, 0, half, half].iter().flat_map(|x: &i16| x.to_le_bytes()).collect();
    let rotation = bin.push(rotation, 5122, "VEC4", 2, r#","normalized":true"#);
    let scale = bin.floats(&[[1.0f32, 1.0, 1.0], [2.0, 2.0, 2.0]]);
    let rest = format!(
        r#""extensionsUsed":["EXT_mesh_gpu_instancing"],"nodes":[{{"translation":[0,5,0],"mesh":0,"extensions":{{"EXT_mesh_gpu_instancing":
           {{"attributes":{{"TRANSLATION":{translation},"ROTATION":{rotation},"SCALE":{scale}}}}}}}}}],
           "meshes":[{{"primitives":[{{"mode":6,"attributes":{{"POSITION":{position}}}}}]}}]"#
    );
    let (scene, report) = load(&bin, &rest);
    assert_eq!((report.instances, report.triangles), (2, 4));
    assert!((world_area(&scene) - 5.0).abs() < 1e-5);
    let last = world_corners(&scene, 2);
    // A fan names its hub last.
    for (corner, expected) in last.iter().zip([[10.0, 7.0, 0.0], [8.0, 7.0, 0.0], [10.0, 5.0, 0.0]]) {
        assert!((corner - DVec3::from(expected)).length() < 1e-4, "{last:?}");
    }
    let lonely = LoadOptions { limits: hplt_io::Limits { instances: 1, ..Default::default() }, ..Default::default() };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("a.glb"), bin.glb(&rest)).unwrap();
    assert_eq!(load_scene(&folder.path().join("a.glb"), &lonely).unwrap_err().code(), "LIMIT_INSTANCES");
}

#[test]
fn quantised_positions_and_normals_are_decoded() {
    let mut bin = Bin::default();
    let positions: Vec<u8> =
        QUAD.iter().flat_map(|p| [p[0], p[1], p[2], 0.0]).map(|x| if x > 0.0 { 255 } else { 0 }).collect();
    let position = bin.push(positions, 5121, "VEC3", 4, r#","normalized":true"#);
    bin.views[0].insert_str(1, r#""byteStride":4,"#);
    let normals: Vec<u8> = std::iter::repeat_n([0u8, 0, 127, 0], 4).flatten().collect();
    let normal = bin.push(normals, 5120, "VEC3", 4, r#","normalized":true"#);
    bin.views[1].insert_str(1, r#""byteStride":4,"#);
    let rest = format!(
        r#""extensionsRequired":["KHR_mesh_quantization"],"extensionsUsed":["KHR_mesh_quantization"],"nodes":[{{"mesh":0,"scale":[3,3,3]}}],
           "meshes":[{{"primitives":[{{"mode":6,"attributes":{{"POSITION":{position},"NORMAL":{normal}}}}}]}}]"#
    );
    let (scene, report) = load(&bin, &rest);
    assert!((world_area(&scene) - 9.0).abs() < 1e-5);
    assert_eq!((scene.mesh().shading_normals()[0], report.winding_disagreements), (Vec3::Z, 0));
}

#[test]
fn sides_reflect_and_emit_by_policy() {
    let emission =
        r#","emissiveFactor":[1,0.5,0],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":4}}"#;
    let one_sided = LoadOptions { one_sided: true, ..LoadOptions::default() };
    for (double, options, reflects, emits) in [
        (false, &LoadOptions::default(), Sides::Both, Sides::Front),
        (true, &LoadOptions::default(), Sides::Both, Sides::Both),
        (false, &one_sided, Sides::Front, Sides::Front),
        (true, &one_sided, Sides::Both, Sides::Both),
    ] {
        let (bin, rest) = quad_scene("", &format!(r#","doubleSided":{double}{emission}"#), "");
        let (scene, _) = load_with(&bin, &rest, options);
        let material = &scene.materials()[0];
        assert_eq!((material.reflects, material.emits), (reflects, emits));
        assert!((material.exitance - PI * Vec3::new(4.0, 2.0, 0.0)).length() < 1e-5);
    }
}

#[test]
fn lights_shine_along_minus_z_of_their_node() {
    let rest = r#","extensionsUsed":["KHR_lights_punctual"],"extensions":{"KHR_lights_punctual":{"lights":[
        {"type":"point","color":[1,0.5,0],"intensity":683},{"type":"directional","intensity":2,"name":"sun"},
        {"type":"spot","intensity":3,"spot":{"innerConeAngle":0.25,"outerConeAngle":0.5}}]}}"#;
    let (bin, rest) = quad_scene("", "", rest);
    // Turned about x by -90°: -z becomes -y.
    let turned = r#""rotation":[-0.70710678118,0,0,0.70710678118]"#;
    let light = |i: u32| format!(r#","extensions":{{"KHR_lights_punctual":{{"light":{i}}}}}}}"#);
    let nodes = format!(
        r#""nodes":[{{"mesh":0}},{{"translation":[1,2,3]{},{{{turned}{},{{{turned},"scale":[5,5,5]{}]"#,
        light(0),
        light(1),
        light(2)
    );
    let rest = rest.replace(r#""nodes":[{"mesh":0}]"#, &nodes);
    let (scene, report) = load(&bin, &rest);
    assert_eq!(report.lights, 3);
    assert!(report.warnings.iter().any(|w| w.contains("assumed")));
    let square = scene.frame().scale().powi(2) as f32;
    let LightShape::Point { position, intensity } = scene.lights()[0].shape else { panic!() };
    assert!((scene.frame().world_from_scene_point(position) - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-6);
    assert!((intensity * square - Vec3::new(683.0, 341.5, 0.0)).length() < 1e-3);
    let LightShape::Directional { direction_to_light, irradiance, .. } = scene.lights()[1].shape else { panic!() };
    assert!((direction_to_light - Vec3::Y).length() < 1e-6 && irradiance == Vec3::splat(2.0));
    let LightShape::Spot { direction, cos_inner, cos_outer, .. } = scene.lights()[2].shape else { panic!() };
    assert!((direction + Vec3::Y).length() < 1e-6);
    assert!((cos_inner - 0.25f32.cos()).abs() < 1e-6 && (cos_outer - 0.5f32.cos()).abs() < 1e-6);

    let photometric = LoadOptions { light_unit: LightUnit::Photometric, ..LoadOptions::default() };
    let (scene, _) = load_with(&bin, &rest, &photometric);
    let LightShape::Point { intensity, .. } = scene.lights()[0].shape else { panic!() };
    assert!((intensity.x * square - 1.0).abs() < 1e-5);
}

/// A 2 × 2 picture: red, green; blue, white. Alpha is 0 for green.
fn picture() -> Vec<u8> {
    use image::ImageEncoder;
    let mut bytes = Vec::new();
    let texels = [255, 0, 0, 255, 0, 255, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255];
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    encoder.write_image(&texels, 2, 2, image::ExtendedColorType::Rgba8).unwrap();
    bytes
}

fn textured(info: &str, more: &str) -> (Scene, LoadReport) {
    let material =
        format!(r#","pbrMetallicRoughness":{{"metallicFactor":0,"baseColorTexture":{{"index":0{info}}}}}{more}"#);
    let (mut bin, rest) = quad_scene("", &material, r#","textures":[{"source":0}],"images":[{"bufferView":4}]"#);
    let picture = picture();
    bin.push(picture, 5121, "SCALAR", 1, "");
    load(&bin, &rest)
}

#[test]
fn textures_are_looked_up_from_the_top_left_and_capped() {
    let (scene, report) = textured("", "");
    let material = &scene.materials()[0];
    assert_eq!((report.textures, report.texture_bytes), (1, 16));
    for (u, v, expected) in
        [(0.25, 0.25, Vec3::X), (0.75, 0.25, Vec3::Y), (0.25, 0.75, Vec3::Z), (0.75, 0.75, Vec3::ONE)]
    {
        let albedo = material.albedo_at(true, Vec2::new(u, v));
        assert!((albedo - 0.98 * expected).length() < 1e-6, "{u} {v} {albedo}");
    }
    assert_eq!(report.capped_materials, ["m"]);
    assert_eq!(scene.mesh().uv_at(TriangleId(0), 0.0, 1.0), Vec2::ONE);
}

#[test]
fn texture_transforms_and_coordinate_sets_are_honoured() {
    // A quarter turn takes (u, v) to (v, -u); with the offset, the texel at (0.25, 0.75) comes from (0.75, 0.75).
    let turn = r#","extensions":{"KHR_texture_transform":{"rotation":1.57079632679,"offset":[0,1]}}"#;
    let (scene, _) = textured(turn, "");
    let albedo = scene.materials()[0].albedo_at(true, Vec2::new(0.25, 0.75));
    assert!((albedo - Vec3::splat(0.98)).length() < 1e-5, "{albedo}");
    let scale = r#","extensions":{"KHR_texture_transform":{"scale":[0.5,3],"offset":[0.5,0]}}"#;
    let (scene, _) = textured(scale, "");
    let albedo = scene.materials()[0].albedo_at(true, Vec2::new(0.5, 0.25));
    assert!((albedo - Vec3::splat(0.98)).length() < 1e-5, "{albedo}");
    for set in [r#","texCoord":1"#, r#","extensions":{"KHR_texture_transform":{"texCoord":1}}"#] {
        let (scene, _) = textured(set, "");
        assert_eq!(scene.mesh().uv_at(TriangleId(0), 0.5, 0.5), Vec2::splat(0.25));
    }
    // A set that the mesh lacks: the mean of the picture.
    let (scene, report) = textured(r#","texCoord":2"#, "");
    assert!((scene.materials()[0].albedo - Vec3::splat(0.5)).length() < 1e-6);
    assert!(!scene.mesh().has_uvs() && report.warnings.iter().any(|w| w.contains("mean")));
}

#[test]
fn cut_outs_follow_the_alpha_of_the_texture() {
    let (scene, _) = textured("", r#","alphaMode":"MASK","alphaCutoff":0.5"#);
    let alpha = scene.materials()[0].alpha.as_ref().unwrap();
    assert!(alpha.is_opaque(Vec2::splat(0.25)) && !alpha.is_opaque(Vec2::new(0.75, 0.25)));
    // Nothing is below the cutoff: nothing to ask on every ray.
    assert!(textured("", r#","alphaMode":"MASK","alphaCutoff":0"#).0.materials()[0].alpha.is_none());
}

#[test]
fn emissive_textures_multiply_or_give_their_mean() {
    let glow = |set: u32| {
        textured("", &format!(r#","emissiveFactor":[1,1,1],"emissiveTexture":{{"index":0,"texCoord":{set}}}"#))
    };
    let (scene, _) = glow(0);
    let exitance = scene.materials()[0].exitance_at(true, Vec2::splat(0.25));
    assert!((exitance - PI * Vec3::X).length() < 1e-5, "{exitance}");
    let (scene, report) = glow(1);
    let exitance = scene.materials()[0].exitance_at(true, Vec2::splat(0.25));
    assert!((exitance - PI * Vec3::splat(0.5)).length() < 1e-5, "{exitance}");
    assert!(report.warnings.iter().any(|w| w.contains("emissive texture")));
}
