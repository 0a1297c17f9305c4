//! Hostile and merely unusual files: each is either read or refused with the expected code, in under a second, without a
//! panic and without large allocations. The files lie in `tests/corpus`; what cannot be stored there is made on the spot.
#![cfg(all(feature = "gltf", feature = "obj", feature = "textures"))]

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use hplt_geom::BuildPolicy;
use hplt_io::{Error, LoadOptions, LoadReport, load_scene};

/// File and code; `ok` when it must load and build.
const EXPECTED: &[(&str, &str)] = &[
    ("accessor_count_0.gltf", "VALUE_NOT_IN_RANGE"),
    ("accessor_offset_max.gltf", "ACCESSOR_TOO_LONG"),
    ("alpha_blend.gltf", "ok"),
    ("alpha_mask.gltf", "ok"),
    ("alpha_unknown.gltf", "VALUE_NOT_IN_LIST"),
    ("asset_min_version.gltf", "UNKNOWN_MAJOR_VERSION"),
    ("asset_missing.gltf", "UNDEFINED_PROPERTY"),
    ("asset_version_1.gltf", "UNKNOWN_MAJOR_VERSION"),
    ("base_color_1_0001.gltf", "VALUE_NOT_IN_RANGE"),
    ("base_color_1e300.gltf", "VALUE_NOT_FINITE"),
    ("base_color_2.gltf", "VALUE_NOT_IN_RANGE"),
    ("base_color_minus_1.gltf", "VALUE_NOT_IN_RANGE"),
    ("buffer_length_max.gltf", "BUFFER_BYTE_LENGTH_MISMATCH"),
    ("buffer_no_uri.gltf", "BUFFER_MISSING_DATA"),
    ("camera_fov_9.gltf", "VALUE_NOT_IN_RANGE"),
    ("camera_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("camera_orthographic.gltf", "ok"),
    ("component_type_5124.gltf", "VALUE_NOT_IN_LIST"),
    ("counts_differ.gltf", "MESH_PRIMITIVE_UNEQUAL_ACCESSOR_COUNT"),
    ("data_bad_base64.gltf", "INVALID_URI"),
    ("data_empty.gltf", "BUFFER_BYTE_LENGTH_MISMATCH"),
    ("data_no_comma.gltf", "INVALID_URI"),
    ("data_not_base64.gltf", "INVALID_URI"),
    ("data_wrong_mime.gltf", "ok"),
    ("emissive_minus_5.gltf", "VALUE_NOT_IN_RANGE"),
    ("emissive_strength_1e300.gltf", "VALUE_NOT_FINITE"),
    ("empty.glb", "EMPTY_FILE"),
    ("empty.gltf", "EMPTY_FILE"),
    ("empty.obj", "EMPTY_FILE"),
    ("glb_bin_short.glb", "BUFFER_BYTE_LENGTH_MISMATCH"),
    ("glb_chunk_header_cut.glb", "GLB_UNEXPECTED_END_OF_CHUNK_HEADER"),
    ("glb_chunk_max.glb", "GLB_CHUNK_TOO_BIG"),
    ("glb_chunk_too_long.glb", "GLB_CHUNK_TOO_BIG"),
    ("glb_chunk_unaligned.glb", "GLB_CHUNK_LENGTH_UNALIGNED"),
    ("glb_header_only.glb", "GLB_UNEXPECTED_FIRST_CHUNK"),
    ("glb_json_after_bin.glb", "GLB_UNEXPECTED_FIRST_CHUNK"),
    ("glb_length_4.glb", "GLB_LENGTH_MISMATCH"),
    ("glb_length_max.glb", "GLB_LENGTH_MISMATCH"),
    ("glb_magic.glb", "INVALID_JSON"),
    ("glb_no_bin.glb", "BUFFER_MISSING_DATA"),
    ("glb_trailing.glb", "GLB_LENGTH_MISMATCH"),
    ("glb_two_bin.glb", "GLB_DUPLICATE_CHUNK"),
    ("glb_version_1.glb", "GLB_INVALID_VERSION"),
    ("glb_version_3.glb", "GLB_INVALID_VERSION"),
    ("good.glb", "ok"),
    ("good.gltf", "ok"),
    ("good.obj", "ok"),
    ("image_0x0.gltf", "IMAGE_DATA_INVALID"),
    ("image_16384_short.gltf", "IMAGE_DATA_INVALID"),
    ("image_16bit.gltf", "ok"),
    ("image_1e9x1.gltf", "LIMIT_IMAGE"),
    ("image_1x1.gltf", "ok"),
    ("image_60000.gltf", "LIMIT_IMAGE"),
    ("image_animated.gltf", "ok"),
    ("image_gif.gltf", "IMAGE_UNRECOGNIZED_FORMAT"),
    ("image_missing.gltf", "FILE_UNREADABLE"),
    ("image_no_uv.gltf", "ok"),
    ("image_outside.gltf", "URI_OUTSIDE_ROOT"),
    ("image_text.gltf", "IMAGE_UNRECOGNIZED_FORMAT"),
    ("image_text_bomb.gltf", "ok"),
    ("image_truncated.gltf", "IMAGE_DATA_INVALID"),
    ("image_unused.gltf", "ok"),
    ("image_view_too_long.gltf", "BUFFER_VIEW_TOO_LONG"),
    ("image_wrong_mime.gltf", "ok"),
    ("index_oob.gltf", "ACCESSOR_INDEX_OOB"),
    ("index_restart_u16.gltf", "ACCESSOR_INDEX_PRIMITIVE_RESTART"),
    ("index_restart_u32.gltf", "ACCESSOR_INDEX_PRIMITIVE_RESTART"),
    ("index_restart_u8.gltf", "ACCESSOR_INDEX_PRIMITIVE_RESTART"),
    ("indices_float.gltf", "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT"),
    ("indices_i16.gltf", "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT"),
    ("indices_normalized.gltf", "MESH_PRIMITIVE_INDICES_ACCESSOR_INVALID_FORMAT"),
    ("instance_bomb.gltf", "NODE_PARENT_OVERRIDE"),
    ("instancing_12e6.gltf", "LIMIT_INSTANCES"),
    ("instancing_1e9.gltf", "LIMIT_MEMORY"),
    ("instancing_no_attribute.gltf", "UNDEFINED_PROPERTY"),
    ("instancing_triangles.gltf", "LIMIT_TRIANGLES"),
    ("json_1e999.gltf", "INVALID_JSON"),
    ("json_array.gltf", "TYPE_MISMATCH"),
    ("json_bom.gltf", "INVALID_JSON"),
    ("json_deep.gltf", "INVALID_JSON"),
    ("json_duplicate_key.gltf", "TYPE_MISMATCH"),
    ("json_huge_int.gltf", "TYPE_MISMATCH"),
    ("json_minus_0.gltf", "ok"),
    ("json_negative_count.gltf", "TYPE_MISMATCH"),
    ("json_null_string.gltf", "TYPE_MISMATCH"),
    ("json_string_count.gltf", "TYPE_MISMATCH"),
    ("json_trailing.gltf", "INVALID_JSON"),
    ("json_truncated.gltf", "INVALID_JSON"),
    ("json_utf16.gltf", "INVALID_JSON"),
    ("light_1e300.gltf", "VALUE_NOT_FINITE"),
    ("light_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("light_negative.gltf", "VALUE_NOT_IN_RANGE"),
    ("light_point.gltf", "ok"),
    ("light_spot_angles.gltf", "VALUE_NOT_IN_RANGE"),
    ("light_unknown.gltf", "VALUE_NOT_IN_LIST"),
    ("material_default.gltf", "ok"),
    ("material_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("material_none.gltf", "ok"),
    ("matrix_15.gltf", "TYPE_MISMATCH"),
    ("matrix_and_scale.gltf", "NODE_MATRIX_TRS"),
    ("matrix_perspective.gltf", "NODE_MATRIX_NON_TRS"),
    ("misaligned.gltf", "ACCESSOR_TOTAL_OFFSET_ALIGNMENT"),
    ("mode_0.gltf", "NO_SURFACE"),
    ("mode_1.gltf", "NO_SURFACE"),
    ("mode_2.gltf", "NO_SURFACE"),
    ("mode_3.gltf", "NO_SURFACE"),
    ("mode_4.gltf", "ok"),
    ("mode_5.gltf", "ok"),
    ("mode_6.gltf", "ok"),
    ("mode_7.gltf", "VALUE_NOT_IN_LIST"),
    ("names_hostile.gltf", "VALUE_NOT_IN_RANGE"),
    ("no_indices.gltf", "ok"),
    ("no_nodes.gltf", "NO_SURFACE"),
    ("no_position.gltf", "NO_SURFACE"),
    ("no_primitives.gltf", "NO_SURFACE"),
    ("node_child_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("node_cycle.gltf", "NODE_LOOP"),
    ("node_dag.gltf", "NODE_PARENT_OVERRIDE"),
    ("node_deep.gltf", "LIMIT_DEPTH"),
    ("node_root_has_parent.gltf", "SCENE_NON_ROOT_NODE"),
    ("node_root_twice.gltf", "DUPLICATE_ELEMENTS"),
    ("node_self.gltf", "NODE_LOOP"),
    ("node_two_scenes.gltf", "ok"),
    ("normalized_float.gltf", "ACCESSOR_NORMALIZED_INVALID"),
    ("obj_1e40.obj", "VALUE_NOT_IN_RANGE"),
    ("obj_colors_mixed.obj", "ok"),
    ("obj_concave.obj", "ok"),
    ("obj_crlf.obj", "ok"),
    ("obj_huge.obj", "OBJ_INDEX_OOB"),
    ("obj_huge_i64.obj", "OBJ_INDEX_OOB"),
    ("obj_inf.obj", "VALUE_NOT_FINITE"),
    ("obj_latin1_comment.obj", "ok"),
    ("obj_lines_only.obj", "NO_SURFACE"),
    ("obj_map_outside.obj", "URI_OUTSIDE_ROOT"),
    ("obj_min_i64.obj", "OBJ_INDEX_OOB"),
    ("obj_mtl_above_1.obj", "VALUE_NOT_IN_RANGE"),
    ("obj_mtl_kd_word.obj", "MTL_SYNTAX"),
    ("obj_mtl_ke_inf.obj", "VALUE_NOT_FINITE"),
    ("obj_mtl_ke_negative.obj", "VALUE_NOT_IN_RANGE"),
    ("obj_mtl_nan.obj", "VALUE_NOT_FINITE"),
    ("obj_mtl_negative.obj", "VALUE_NOT_IN_RANGE"),
    ("obj_mtllib_absolute.obj", "URI_OUTSIDE_ROOT"),
    ("obj_mtllib_device.obj", "URI_OUTSIDE_ROOT"),
    ("obj_mtllib_dotdot.obj", "URI_OUTSIDE_ROOT"),
    ("obj_mtllib_folder.obj", "FILE_NOT_REGULAR"),
    ("obj_mtllib_itself.obj", "ok"),
    ("obj_mtllib_many.obj", "LIMIT_LIBRARIES"),
    ("obj_mtllib_missing.obj", "ok"),
    ("obj_nan.obj", "VALUE_NOT_FINITE"),
    ("obj_negative.obj", "ok"),
    ("obj_negative_oob.obj", "OBJ_INDEX_OOB"),
    ("obj_no_faces.obj", "NO_SURFACE"),
    ("obj_nul.obj", "OBJ_SYNTAX"),
    ("obj_usemtl_empty.obj", "OBJ_SYNTAX"),
    ("obj_vn_oob.obj", "OBJ_INDEX_OOB"),
    ("obj_vt_oob.obj", "OBJ_INDEX_OOB"),
    ("obj_zero.obj", "OBJ_INDEX_OOB"),
    ("position_3e38.gltf", "VALUE_NOT_IN_RANGE"),
    ("position_accessor_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("position_nan.gltf", "VALUE_NOT_FINITE"),
    ("position_u16.gltf", "MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT"),
    ("position_vec2.gltf", "MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT"),
    ("required_draco.gltf", "UNSUPPORTED_EXTENSION"),
    ("required_meshopt.gltf", "UNSUPPORTED_EXTENSION"),
    ("required_texture.gltf", "UNSUPPORTED_EXTENSION"),
    ("required_unknown.gltf", "UNSUPPORTED_EXTENSION"),
    ("rotation_0.gltf", "ROTATION_NON_UNIT"),
    ("rotation_1e300.gltf", "ROTATION_NON_UNIT"),
    ("rotation_length_2.gltf", "ok"),
    ("rotation_null.gltf", "TYPE_MISMATCH"),
    ("scale_0.gltf", "NO_SURFACE"),
    ("scene_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("skin_morph_animation.gltf", "ok"),
    ("small_stride.gltf", "ACCESSOR_SMALL_BYTESTRIDE"),
    ("sparse_count_1e12.gltf", "VALUE_NOT_IN_RANGE"),
    ("sparse_count_4e9.gltf", "LIMIT_MEMORY"),
    ("sparse_count_u16.gltf", "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE"),
    ("sparse_count_u32.gltf", "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE"),
    ("sparse_count_u8.gltf", "ACCESSOR_SPARSE_COUNT_OUT_OF_RANGE"),
    ("sparse_oob_u16.gltf", "ACCESSOR_SPARSE_INDEX_OOB"),
    ("sparse_oob_u32.gltf", "ACCESSOR_SPARSE_INDEX_OOB"),
    ("sparse_oob_u8.gltf", "ACCESSOR_SPARSE_INDEX_OOB"),
    ("sparse_order_u16.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_order_u32.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_order_u8.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_repeat_u16.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_repeat_u32.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_repeat_u8.gltf", "ACCESSOR_SPARSE_INDICES_NON_INCREASING"),
    ("sparse_values_missing.gltf", "UNDEFINED_PROPERTY"),
    ("texture_basisu_only.gltf", "UNSUPPORTED_EXTENSION"),
    ("texture_missing.gltf", "UNRESOLVED_REFERENCE"),
    ("translation_1e300.gltf", "VALUE_NOT_IN_RANGE"),
    ("translation_overflow.gltf", "VALUE_NOT_FINITE"),
    ("type_mat4.gltf", "VALUE_NOT_IN_LIST"),
    ("unknown.gltf", "INVALID_JSON"),
    ("unlit.gltf", "ok"),
    ("uri_10kb.gltf", "INVALID_URI"),
    ("uri_absolute.gltf", "URI_OUTSIDE_ROOT"),
    ("uri_bad_percent.gltf", "INVALID_URI"),
    ("uri_dotdot.gltf", "URI_OUTSIDE_ROOT"),
    ("uri_drive.gltf", "URI_SCHEME_REFUSED"),
    ("uri_empty.gltf", "INVALID_URI"),
    ("uri_file.gltf", "URI_SCHEME_REFUSED"),
    ("uri_folder.gltf", "FILE_NOT_REGULAR"),
    ("uri_https.gltf", "URI_SCHEME_REFUSED"),
    ("uri_missing.gltf", "FILE_UNREADABLE"),
    ("uri_nul.gltf", "INVALID_URI"),
    ("uri_percent_dotdot.gltf", "URI_OUTSIDE_ROOT"),
    ("uri_percent_nul.gltf", "INVALID_URI"),
    ("uri_server.gltf", "URI_OUTSIDE_ROOT"),
    ("uri_unc.gltf", "INVALID_URI"),
    ("used_unknown.gltf", "ok"),
    ("uv_1e30.gltf", "ok"),
    ("uv_nan.gltf", "VALUE_NOT_FINITE"),
    ("view_offset_max.gltf", "BUFFER_VIEW_TOO_LONG"),
];

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus")
}

fn load_and_build(path: &Path) -> Result<LoadReport, Error> {
    let loaded = load_scene(path, &LoadOptions::default())?;
    loaded.scene.build(BuildPolicy::default())?;
    Ok(loaded.report)
}

fn code(path: &Path) -> &'static str {
    load_and_build(path).map_or_else(|e| e.code(), |_| "ok")
}

#[test]
fn every_file_is_read_or_refused_as_expected() {
    let mut wrong = Vec::new();
    for (name, expected) in EXPECTED {
        let path = corpus().join(name);
        let start = Instant::now();
        let result = load_and_build(&path);
        let time = start.elapsed();
        let found = result.as_ref().map_or_else(Error::code, |_| "ok");
        if found != *expected || time > Duration::from_secs(1) {
            wrong.push(format!("{name}: expected {expected}, found {found} in {time:?}: {:?}", result.err()));
            continue;
        }
        if let Err(error) = result {
            let text = error.to_string();
            assert!(!text.chars().any(char::is_control) && text.len() < 1500, "{name}: {text}");
            let exit_code = if error.code().starts_with("LIMIT_") { 4 } else { 3 };
            assert_eq!(error.exit_code(), exit_code, "{name}: {text}");
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    #[cfg(target_os = "linux")]
    {
        let status = std::fs::read_to_string("/proc/self/status").unwrap();
        let peak = status.lines().find(|l| l.starts_with("VmHWM")).unwrap();
        let kilobytes: u64 = peak.split_whitespace().nth(1).unwrap().parse().unwrap();
        assert!(kilobytes < 256 << 10, "{peak}");
    }
}

#[test]
fn every_scene_of_the_corpus_is_in_the_table() {
    let mut files: Vec<String> = std::fs::read_dir(corpus())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|name| !name.ends_with(".mtl"))
        .collect();
    files.sort();
    let table: Vec<&str> = EXPECTED.iter().map(|(name, _)| *name).collect();
    assert_eq!(files, table);
}

#[cfg(unix)]
#[test]
fn pipes_and_links_are_refused_without_waiting() {
    let folder = tempfile::tempdir().unwrap();
    let inside = folder.path().join("scene");
    std::fs::create_dir(&inside).unwrap();
    for name in ["pipe.glb", "pipe.obj", "pipe.bin", "pipe.mtl"] {
        assert!(std::process::Command::new("mkfifo").arg(inside.join(name)).status().unwrap().success());
    }
    let gltf = std::fs::read_to_string(corpus().join("uri_missing.gltf")).unwrap();
    let obj = std::fs::read_to_string(corpus().join("obj_mtllib_missing.obj")).unwrap();
    std::fs::write(folder.path().join("secret.bin"), [0; 100]).unwrap();
    std::os::unix::fs::symlink("../secret.bin", inside.join("link.bin")).unwrap();
    std::os::unix::fs::symlink("/dev/zero", inside.join("zero.glb")).unwrap();
    std::fs::write(inside.join("a.gltf"), gltf.replace("missing.bin", "pipe.bin")).unwrap();
    std::fs::write(inside.join("b.gltf"), gltf.replace("missing.bin", "link.bin")).unwrap();
    std::fs::write(inside.join("c.obj"), obj.replace("none.mtl", "pipe.mtl")).unwrap();
    for (name, expected) in [
        ("pipe.glb", "FILE_NOT_REGULAR"),
        ("pipe.obj", "FILE_NOT_REGULAR"),
        ("zero.glb", "FILE_NOT_REGULAR"),
        ("a.gltf", "FILE_NOT_REGULAR"),
        ("b.gltf", "URI_OUTSIDE_ROOT"),
        ("c.obj", "FILE_NOT_REGULAR"),
        ("none.glb", "FILE_UNREADABLE"),
        (".", "FILE_NOT_REGULAR"),
    ] {
        assert_eq!(code(&inside.join(name)), expected, "{name}");
    }
}

#[test]
fn huge_files_are_refused_before_they_are_read() {
    let folder = tempfile::tempdir().unwrap();
    for (name, gigabytes, expected) in [
        ("line.obj", 1, "LIMIT_LINE"),
        ("text.gltf", 1, "LIMIT_JSON"),
        ("five.gltf", 5, "LIMIT_FILE_SIZE"),
        ("five.obj", 5, "LIMIT_FILE_SIZE"),
    ] {
        let path = folder.path().join(name);
        let file = std::fs::File::create(&path).unwrap();
        file.set_len(gigabytes << 30).unwrap();
        let start = Instant::now();
        assert_eq!(code(&path), expected, "{name}");
        assert!(start.elapsed() < Duration::from_secs(1), "{name}");
    }
    // A container that lies about its length is not read either.
    let path = folder.path().join("lie.glb");
    std::fs::write(&path, b"glTF\x02\0\0\0\x20\0\0\0").unwrap();
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(1 << 30).unwrap();
    assert_eq!(code(&path), "GLB_LENGTH_MISMATCH");
}

#[test]
fn a_million_nodes_in_a_chain_or_a_row() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("nodes.gltf");
    let write = |nodes: &str| {
        std::fs::write(&path, format!("{{\"asset\":{{\"version\":\"2.0\"}},\"nodes\":[{nodes}{{}}]}}")).unwrap();
    };
    write(&(1..1_000_000).map(|i| format!("{{\"children\":[{i}]}},")).collect::<String>());
    assert_eq!(code(&path), "LIMIT_DEPTH");
    write(&"{},".repeat(1_000_000));
    assert_eq!(code(&path), "LIMIT_NODES");
    write(&"{},".repeat(999_999));
    assert_eq!(code(&path), "NO_SURFACE");
}

#[test]
fn polygons_with_many_corners() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("polygon.obj");
    for (n, expected) in [(100_000, "ok"), (1_000_000, "LIMIT_LINE")] {
        let mut text = String::from("v 0 0 0\nv 1 0 0\nv 0 1 0\nf");
        for i in 0..n {
            text += [" 1", " 2", " 3"][i % 3];
        }
        std::fs::write(&path, text).unwrap();
        assert_eq!(code(&path), expected);
    }
}

#[test]
fn material_policies_are_reported_by_name() {
    let report = |name: &str| load_and_build(&corpus().join(name)).unwrap();
    let says = |report: &LoadReport, text: &str| {
        report.warnings.iter().chain(&report.left_out).any(|line| line.contains(text))
    };
    let white = report("material_default.gltf");
    assert_eq!(white.capped_materials, ["white"]);
    assert!(says(&white, "\"white\": metallic 1") && says(&white, "0.98"), "{white:?}");
    assert!(says(&report("material_none.gltf"), "0.8"));
    assert!(says(&report("alpha_blend.gltf"), "BLEND"));
    assert!(says(&report("unlit.gltf"), "unlit"));
    assert!(says(&report("used_unknown.gltf"), "VENDOR_unknown"));
    assert!(says(&report("image_no_uv.gltf"), "no texture coordinates"));
    assert!(says(&report("camera_orthographic.gltf"), "orthographic"));
    assert!(says(&report("obj_mtllib_missing.obj"), "none.mtl") && says(&report("obj_mtllib_missing.obj"), "0.5"));
    assert!(says(&report("obj_concave.obj"), "fans"));
    let resting = report("skin_morph_animation.gltf");
    for text in ["skins", "animations", "morph", "COLOR_n"] {
        assert!(says(&resting, text), "{text}: {resting:?}");
    }
}

#[test]
fn bad_values_are_repaired_only_on_request() {
    for name in ["base_color_2.gltf", "base_color_1e300.gltf", "emissive_minus_5.gltf", "obj_mtl_nan.obj"] {
        let policy = BuildPolicy { clamp_materials: true, ..BuildPolicy::default() };
        let loaded = load_scene(&corpus().join(name), &LoadOptions { policy, ..LoadOptions::default() }).unwrap();
        assert_eq!(loaded.report.clamped_materials.len(), 1, "{name}");
        let (scene, _) = loaded.scene.build(policy).unwrap();
        assert!(scene.max_albedo() <= 0.98, "{name}");
    }
    let policy = BuildPolicy { drop_bad_triangles: true, ..BuildPolicy::default() };
    for name in ["position_nan.gltf", "obj_nan.obj", "obj_1e40.obj"] {
        let loaded = load_scene(&corpus().join(name), &LoadOptions { policy, ..LoadOptions::default() }).unwrap();
        // The only triangle is bad, so nothing is left.
        let error = Error::from(loaded.scene.build(policy).unwrap_err());
        assert_eq!(error.code(), "NO_SURFACE", "{name}");
    }
}
