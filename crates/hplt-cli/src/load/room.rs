//! A mesh from a file, on the floor of the closed Cornell room: `gen:room-with=FILE[:SCALE]`.

use std::path::Path;

use hplt_geom::glam::{DVec3, Vec3};
use hplt_geom::{Material, MaterialId, MeshInput, Scene, TriangleId};
use hplt_io::{LoadOptions, Loaded};
use hplt_reference::scenes;

use crate::exit::Failure;

/// Where the middle of the mesh stands, metres.
const PLACE: [f64; 2] = [0.278, 0.28];
/// Space for the mesh: width, height and depth of the room less a margin, metres.
const SPACE: [f64; 3] = [0.54, 0.53, 0.54];
/// Longest side of a mesh whose scale nobody gave, metres.
const LONGEST_SIDE: f64 = 0.3;

/// The room with the mesh of a file, upright as it is in the file, its lowest point on the floor. It takes the albedo of its
/// first material, without textures. Without a scale its longest side becomes 0.3 m.
///
/// # Errors
/// When the file cannot be used, or the mesh does not fit into the room.
pub fn load(spec: &str, options: &LoadOptions) -> Result<Loaded, Failure> {
    let (file, scale) = split(spec);
    let shown = hplt_io::sanitized(file);
    let Loaded { scene: builder, mut report } = hplt_io::load_scene(Path::new(file), options)?;
    let (scene, _) = builder.build(options.policy).map_err(|error| super::build_failure(&shown, error))?;
    let (positions, normals) = (world_positions(&scene), scene.mesh().shading_normals());
    let (min, max) = bounds(&positions);
    let scale = scale.unwrap_or(LONGEST_SIDE / (max - min).max_element());
    if !(scale > 0.0 && ((max - min) * scale).cmple(DVec3::from(SPACE)).all()) {
        let message =
            format!("gen:room-with={shown}: {} m at scale {scale}; expected to fit into {SPACE:?} m", max - min);
        return Err(Failure::usage(message));
    }
    let base = DVec3::new(0.5 * (min.x + max.x), min.y, 0.5 * (min.z + max.z));
    let place = DVec3::new(PLACE[0], 0.0, PLACE[1]);
    let placed: Vec<DVec3> = positions.iter().map(|p| (*p - base) * scale + place).collect();
    let mesh = MeshInput {
        name: "mesh",
        positions: &placed,
        normals,
        uvs: &[],
        triangles: scene.mesh().triangles(),
        material: MaterialId(0),
    };
    let material = Material::diffuse("mesh", scene.material(TriangleId(0)).albedo);
    let room = scenes::room_with(mesh, material).map_err(|error| super::build_failure(&shown, error))?;
    report.left_out.push(format!("{shown}: textures, lights and cameras; only the mesh is in the room"));
    Ok(Loaded { scene: room, report })
}

/// File and scale. A last part that is no number belongs to the name.
fn split(spec: &str) -> (&str, Option<f64>) {
    match spec.rsplit_once(':').map(|(file, scale)| (file, scale.parse())) {
        Some((file, Ok(scale))) => (file, Some(scale)),
        _ => (spec, None),
    }
}

fn world_positions(scene: &Scene) -> Vec<DVec3> {
    scene.mesh().positions().iter().map(|p: &Vec3| scene.frame().world_from_scene_point(*p)).collect()
}

fn bounds(positions: &[DVec3]) -> (DVec3, DVec3) {
    let start = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    positions.iter().fold(start, |(min, max), p| (min.min(*p), max.max(*p)))
}

#[cfg(test)]
mod tests {
    use hplt_geom::BuildPolicy;

    use super::*;
    use crate::exit::Exit;

    fn written_block() -> (tempfile::TempDir, String) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("block.obj");
        let corners = ["1 3 5", "5 3 5", "5 3 7", "1 3 7", "3 11 6"];
        let faces = ["1 2 3", "1 3 4", "1 5 2", "2 5 3", "3 5 4", "4 5 1"];
        let text: String =
            corners.iter().map(|c| format!("v {c}\n")).chain(faces.iter().map(|f| format!("f {f}\n"))).collect();
        std::fs::write(&path, text).unwrap();
        let path = path.to_string_lossy().into_owned();
        (folder, path)
    }

    /// Bounds of what stands in the room: the corners after those of walls and light.
    fn bounds_of_mesh(spec: &str) -> (DVec3, DVec3) {
        let (scene, _) = load(spec, &LoadOptions::default()).unwrap().scene.build(BuildPolicy::default()).unwrap();
        let last = scene.materials().len() - 1;
        let of_mesh = (0..scene.mesh().n_triangles() as u32)
            .map(TriangleId)
            .filter(|t| scene.mesh().material(*t) == MaterialId(last as u32));
        let corners: Vec<DVec3> =
            of_mesh.flat_map(|t| scene.mesh().corners(t)).map(|p| scene.frame().world_from_scene_point(p)).collect();
        assert_eq!(corners.len(), 18);
        bounds(&corners)
    }

    #[test]
    fn the_mesh_stands_in_the_middle_of_the_floor() {
        let (_folder, file) = written_block();
        for (spec, height) in [(file.clone(), 0.3), (format!("{file}:0.05"), 0.4)] {
            let (min, max) = bounds_of_mesh(&spec);
            let expected = (DVec3::new(0.278 - height / 4.0, 0.0, 0.28 - height / 8.0), height);
            assert!((min - expected.0).length() < 1e-6, "{min}");
            assert!((max.y - expected.1).abs() < 1e-6, "{max}");
        }
    }

    #[test]
    fn scales_that_do_not_fit_are_refused() {
        let (_folder, file) = written_block();
        for scale in ["0.1", "0", "-1", "nan", "inf"] {
            let error = load(&format!("{file}:{scale}"), &LoadOptions::default()).err().map(|f| f.exit);
            assert_eq!(error, Some(Exit::Usage), "{scale}");
        }
    }

    #[test]
    fn a_colon_in_the_name_of_the_file_is_not_a_scale() {
        assert_eq!(split("C:\\a.glb"), ("C:\\a.glb", None));
        assert_eq!(split("C:\\a.glb:1.5"), ("C:\\a.glb", Some(1.5)));
    }
}
