//! The real scenes: Cornell, Sponza and the scans, from the folder `HPLT_SCENES` or `../shared/scenes` beside the
//! checkout. A test whose scene is absent says that it is skipped, and notes it in the file `HPLT_SKIP_LOG`.
#![cfg(feature = "gltf")]

use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use hplt_geom::{Scene, SceneReport};
use hplt_io::{LoadOptions, LoadReport, load_scene};

fn scene_file(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("HPLT_SCENES")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/scenes"), PathBuf::from);
    let path = folder.join(name);
    if path.is_file() {
        return Some(path);
    }
    println!("skipped: {name} is not there");
    if let Some(log) = std::env::var_os("HPLT_SKIP_LOG") {
        let mut log = std::fs::OpenOptions::new().append(true).create(true).open(log).unwrap();
        log.write_all(format!("{name}\n").as_bytes()).unwrap();
    }
    None
}

fn built(path: &std::path::Path, options: &LoadOptions) -> (Scene, SceneReport, LoadReport) {
    let start = Instant::now();
    let loaded = load_scene(path, options).unwrap();
    let load = start.elapsed();
    let start = Instant::now();
    let (scene, report) = loaded.scene.build(options.policy).unwrap();
    println!("{}: load {:.1?}, build {:.1?}", path.file_name().unwrap().to_string_lossy(), load, start.elapsed());
    println!("{:#?}\n{report:?}", loaded.report);
    (scene, report, loaded.report)
}

#[cfg(feature = "obj")]
#[test]
fn both_cornell_boxes_agree() {
    let (Some(glb), Some(obj)) = (scene_file("cornell/cornell.glb"), scene_file("cornell/cornell.obj")) else { return };
    let (glb, _, report) = built(&glb, &LoadOptions::default());
    let (obj, _, _) = built(&obj, &LoadOptions { length_scale: 1e-3, ..LoadOptions::default() });
    assert_eq!((glb.mesh().n_triangles(), obj.mesh().n_triangles()), (36, 36));
    assert_eq!(report.left_out, Vec::<String>::new());
    let describe = |scene: &Scene| {
        let mut all: Vec<(String, [[i64; 3]; 3], [f32; 6])> = scene
            .mesh()
            .triangles()
            .iter()
            .enumerate()
            .map(|(t, corners)| {
                let material = scene.material(hplt_geom::TriangleId(t as u32));
                let corners = corners.map(|v| {
                    let world = scene.frame().world_from_scene_point(scene.mesh().positions()[v as usize]);
                    (world * 1e5).to_array().map(|x| x.round() as i64)
                });
                let [a, m] = [material.albedo, material.exitance];
                (material.name.clone(), corners, [a.x, a.y, a.z, m.x, m.y, m.z])
            })
            .collect();
        all.sort_by_key(|a| a.1);
        all
    };
    for (a, b) in describe(&glb).iter().zip(describe(&obj)) {
        assert_eq!((&a.0, a.1), (&b.0, b.1));
        for (x, y) in a.2.iter().zip(b.2) {
            assert!((x - y).abs() <= 1e-5 * y.max(1.0), "{a:?} {b:?}");
        }
    }
    let lit = glb.emissive_triangles().count();
    let exitance = glb.materials().iter().map(|m| m.exitance.x).fold(0.0, f32::max);
    assert_eq!(lit, 2);
    assert!((exitance - 17.0 * std::f32::consts::PI).abs() < 1e-3, "{exitance}");
    let area: f64 = glb.emissive_triangles().map(|t| glb.mesh().area(t)).sum::<f64>() * glb.frame().scale().powi(2);
    assert!((area - 0.01365).abs() < 1e-6, "{area}");
}

#[cfg(feature = "textures")]
#[test]
fn sponza_has_its_triangles_textures_cut_outs_and_cameras() {
    let Some(path) = scene_file("sponza/sponza.gltf") else { return };
    let (scene, dropped, report) = built(&path, &LoadOptions::default());
    assert_eq!(report.triangles, 262_267);
    assert_eq!(scene.mesh().n_triangles() as u64 + dropped.degenerate + dropped.duplicates, 262_267);
    assert!((1..=5).contains(&dropped.degenerate) && (60..=80).contains(&dropped.duplicates), "{dropped:?}");
    assert_eq!((report.textures, report.materials, scene.materials().len()), (24, 25, 25));
    let mut cut: Vec<&str> = scene.materials().iter().filter(|m| m.alpha.is_some()).map(|m| &m.name[..]).collect();
    cut.sort_unstable();
    assert_eq!(cut, ["chain", "leaf_thorn", "vase_plant"]);
    assert_eq!(report.camera_names, ["courtyard_west", "courtyard_east", "arcade", "gallery"]);
    let eye = scene.cameras()[0].eye;
    assert!((eye - glam::DVec3::new(-9.5, 1.7, -0.3)).length() < 1e-9);
    assert!(scene.cameras()[0].forward.x > 0.9 && !scene.is_lit());
    let (min, max) = scene.mesh().bounds().unwrap();
    let (min, max) = (scene.frame().world_from_scene_point(min), scene.frame().world_from_scene_point(max));
    assert!((min - glam::DVec3::new(-15.37, -1.01, -9.46)).abs().max_element() < 0.01, "{min}");
    assert!((max - glam::DVec3::new(14.40, 11.44, 8.84)).abs().max_element() < 0.01, "{max}");
    let albedo = mean_albedo(&scene);
    assert!((albedo - glam::DVec3::new(0.18, 0.16, 0.12)).abs().max_element() < 0.01, "{albedo}");
}

/// Area-weighted over the triangles, each with the mean of its material's texture.
#[cfg(feature = "textures")]
fn mean_albedo(scene: &Scene) -> glam::DVec3 {
    const N: u32 = 64;
    let texels = (0..N * N).map(|i| (glam::Vec2::new((i % N) as f32, (i / N) as f32) + 0.5) / N as f32);
    let mean = |m: &hplt_geom::Material| {
        texels.clone().map(|uv| m.albedo_at(true, uv).as_dvec3()).sum::<glam::DVec3>() / f64::from(N * N)
    };
    let means: Vec<glam::DVec3> = scene.materials().iter().map(mean).collect();
    let (mut sum, mut area) = (glam::DVec3::ZERO, 0.0);
    for t in (0..scene.mesh().n_triangles() as u32).map(hplt_geom::TriangleId) {
        sum += means[scene.mesh().material(t).0 as usize] * scene.mesh().area(t);
        area += scene.mesh().area(t);
    }
    sum / area
}

#[cfg(feature = "textures")]
#[test]
fn the_lit_sponza_has_one_emitter_under_its_roof() {
    let Some(path) = scene_file("sponza/sponza_lit.gltf") else { return };
    let (scene, _, report) = built(&path, &LoadOptions::default());
    assert_eq!(report.triangles, 262_269);
    let emitters: Vec<_> = scene.emissive_triangles().collect();
    assert_eq!(emitters.len(), 2);
    let material = scene.material(emitters[0]);
    assert_eq!((&material.name[..], material.albedo), ("roof_light", glam::Vec3::ZERO));
    let radiance = material.exitance / std::f32::consts::PI;
    assert!((radiance - glam::Vec3::new(20.0, 19.0, 17.6)).abs().max_element() < 1e-4, "{radiance}");
    assert!(scene.mesh().face_normal(emitters[0]).y < -0.999);
    let y = scene.frame().world_from_scene_point(scene.mesh().corners(emitters[0])[0]).y;
    assert!((y - 10.9).abs() < 1e-3);
}

#[test]
fn the_scans_have_their_triangles() {
    for (name, n, degenerate, duplicates) in
        [("stanford/dragon_871k.glb", 871_414, 108, 0), ("stanford/happy_100k.glb", 100_000, 0, 24)]
    {
        let Some(path) = scene_file(name) else { continue };
        let (scene, dropped, report) = built(&path, &LoadOptions::default());
        assert_eq!(report.triangles, n);
        assert_eq!(scene.mesh().n_triangles() as u64, n - dropped.degenerate - dropped.duplicates);
        assert!(dropped.degenerate >= degenerate && dropped.degenerate < 2 * degenerate + 10, "{dropped:?}");
        assert!(dropped.duplicates.abs_diff(duplicates) < 30, "{dropped:?}");
        assert_eq!(scene.materials()[0].albedo, glam::Vec3::splat(0.7));
    }
}
