//! Budgets are kept or refused, and what cannot be seen well is said.

mod common;

use std::fmt::Write;

use common::{Folder, table};
use hplt_geom::glam::DVec3;
use hplt_reference::closed_forms;
use hplt_reference::scenes::geodesic_sphere;

/// A room of 1 m with a hole of the given width in its ceiling, as an OBJ file.
fn room_with_hole(width: f64) -> String {
    let (a, b) = (0.5 - 0.5 * width, 0.5 + 0.5 * width);
    let walls = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nv 0 1 0\nv 1 1 0\nv 1 1 1\nv 0 1 1\n";
    let hole = format!("v {a} 1 {a}\nv {b} 1 {a}\nv {b} 1 {b}\nv {a} 1 {b}\n");
    let faces = "f 1 4 3 2\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    // Four trapezia around the hole.
    let ceiling = "f 5 6 10 9\nf 6 7 11 10\nf 7 8 12 11\nf 8 5 9 12\n";
    format!("{walls}{hole}{faces}{ceiling}")
}

/// A12: a room that sees the sky through a hole of a few ten-thousandths of its walls says so; one with a skylight does not.
#[test]
fn a_tiny_opening_to_the_sky_is_announced() {
    let folder = Folder::new();
    let report = |width: f64| {
        folder.write("room.obj", room_with_hole(width));
        let rough = ["--levels", "2", "--rays", "64", "--sky", "1,1,1", "-o", "a.hplt", "--force", "--json"];
        folder.run(&[&["solve", "room.obj"], &rough[..]].concat()).ok().json()
    };
    let (tiny, skylight) = (report(0.05), report(0.6));
    let announced = |report: &serde_json::Value| report["warnings"].to_string().contains("portal under-sampled");
    assert!(announced(&tiny), "{tiny}");
    assert!(!announced(&skylight), "{skylight}");
    // The form factor of the walls to the hole: its area over theirs.
    let open = 0.05 * 0.05 / 6.0;
    let sky = &tiny["more"]["sky"];
    let [seen, most] = ["seen_share", "most_seen_share"].map(|key| sky[key].as_f64().unwrap());
    assert!(seen < 4.0 * open && open < 1.5 * most, "{sky}");
}

/// A room of 1 m whose floor and ceiling are two halves each, `gap` apart, as an OBJ file.
fn room_with_slits(gap: f64) -> String {
    let (a, b) = (0.5 - 0.5 * gap, 0.5 + 0.5 * gap);
    let walls = "v 0 0 0\nv 1 0 0\nv 1 0 1\nv 0 0 1\nv 0 1 0\nv 1 1 0\nv 1 1 1\nv 0 1 1\n";
    let slit = |y| format!("v {a} {y} 0\nv {b} {y} 0\nv {b} {y} 1\nv {a} {y} 1\n");
    let sides = "f 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let halves = "f 5 9 12 8\nf 10 6 7 11\nf 1 4 16 13\nf 14 15 3 2\n";
    format!("{walls}{}{}{sides}{halves}", slit(1), slit(0))
}

/// D18: a bright room with cracks in floor and ceiling says that it leaks; one that is closed, one with an opening, and one that reflects too
/// little for it to matter do not. What leaks is in the report of all that are not closed.
#[test]
fn a_room_with_cracks_says_that_it_leaks() {
    let folder = Folder::new();
    for (albedo, gap, is_announced) in
        [(0.98, 1.5e-3, true), (0.5, 1.5e-3, false), (0.98, 0.0, false), (0.98, 0.2, false)]
    {
        folder.write("room.obj", format!("mtllib wall.mtl\nusemtl wall\n{}", room_with_slits(gap)));
        folder.write("wall.mtl", format!("newmtl wall\nKd {albedo} {albedo} {albedo}\nKe 1 1 1\n"));
        let rough = ["solve", "room.obj", "--levels", "1", "--rays", "64", "-o", "a.hplt", "--force", "--json"];
        let report = folder.run(&rough).ok().json();
        let (leaks, warnings) = (&report["more"]["leaks"], report["warnings"].to_string());
        println!("albedo {albedo}, gap {gap}: {leaks} {warnings}");
        assert_eq!(warnings.contains("leaks:"), is_announced, "{warnings}");
        assert_eq!(leaks.is_null(), gap == 0.0, "{leaks}");
        let [rays, through_cracks] = ["rays", "through_cracks"].map(|k| leaks[k].as_u64().unwrap_or(0));
        // By reciprocity, the slits' share of the walls.
        let share = through_cracks as f64 / rays.max(1) as f64;
        let expected = if gap < 0.1 { gap / 3.0 } else { 0.0 };
        assert!((share - expected).abs() <= 0.4 * expected + 2e-5, "{share} for {expected}: {leaks}");
    }
}

/// E9: a span of time is kept to a tenth, or the report says that it was not.
#[test]
fn a_budget_of_time_is_kept_or_said_to_be_exceeded() {
    let folder = Folder::new();
    folder.run(&["sample-points", "gen:cornell", "-n", "200", "--seed", "5", "-o", "at.csv"]).ok();
    for asked in [0.5, 4.0] {
        let time = format!("{asked}s");
        let points =
            ["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv", "--force", "--json", "--time", &time];
        let started = std::time::Instant::now();
        let report = folder.run(&points).ok().json();
        let took = started.elapsed().as_secs_f64();
        let is_said = report["warnings"].to_string().contains("were asked for");
        println!("{asked} s asked for, {took:.2} s taken, said: {is_said}");
        // Starting and ending the process is not in what the command can plan.
        assert!(took <= 1.1 * asked + 0.3 || is_said, "{took} s of {asked}: {report}");
    }
}

/// E9: memory is kept to a tenth, or the work is refused before it begins.
#[cfg(target_os = "linux")]
#[test]
fn a_budget_of_memory_is_kept_or_refused() {
    let folder = Folder::new();
    let mut outcomes = Vec::new();
    for (mib, levels) in [(64, "2"), (64, "7"), (400, "5")] {
        let limit = format!("{mib}MiB");
        let args =
            ["solve", "gen:cornell", "-o", "a.hplt", "--force", "-q", "--levels", levels, "--max-memory", &limit];
        let mut child = folder.command(&args).spawn().unwrap();
        let mut most = 0u64;
        let code = loop {
            let status = std::fs::read_to_string(format!("/proc/{}/status", child.id())).unwrap_or_default();
            let peak =
                status.lines().find_map(|line| line.strip_prefix("VmHWM:")?.trim().strip_suffix(" kB")?.parse().ok());
            most = most.max(peak.unwrap_or(0));
            if let Some(status) = child.try_wait().unwrap() {
                break status.code();
            }
            std::thread::sleep(std::time::Duration::from_millis(2));
        };
        println!("{mib} MiB, {levels} levels: exit {code:?}, at most {} MiB", most >> 10);
        let is_kept = code == Some(0) && most <= (mib * 1024) * 11 / 10;
        assert!(code == Some(5) || is_kept, "{mib} MiB, {levels} levels: exit {code:?}, {} MiB", most >> 10);
        outcomes.push(code);
    }
    assert!(outcomes.contains(&Some(0)) && outcomes.contains(&Some(5)), "{outcomes:?}");
}

/// A sphere of radius 1 without the facets whose middle is above `1 - 2·fraction`, seen from inside, with its material, and the
/// fraction of its area that is open.
fn sphere_with_hole(folder: &Folder, fraction: f64, facets: usize, albedo: f64) -> f64 {
    let full = geodesic_sphere(1.0, facets);
    let mut open = full.mapped(|p| p);
    let middle = |t: &[u32; 3]| t.iter().map(|&v| full.positions[v as usize]).sum::<DVec3>().normalize();
    open.triangles.retain(|t| middle(t).y <= 1.0 - 2.0 * fraction);
    let mut text = String::from("mtllib wall.mtl\nusemtl wall\n");
    full.positions.iter().for_each(|p| writeln!(text, "v {} {} {}", p.x, p.y, p.z).unwrap());
    open.triangles.iter().for_each(|t| writeln!(text, "f {} {} {}", t[0] + 1, t[2] + 1, t[1] + 1).unwrap());
    folder.write("sphere.obj", text);
    folder.write("wall.mtl", format!("newmtl wall\nKd {albedo} {albedo} {albedo}\n"));
    let sensors = full.triangles.iter().step_by(full.triangles.len() / 150).filter(|t| middle(t).y < 0.5);
    let row = |t: &[u32; 3]| {
        let (p, n) = (t.iter().map(|&v| full.positions[v as usize]).sum::<DVec3>() / 3.0, -middle(t));
        format!("{},{},{},{},{},{}\n", p.x, p.y, p.z, n.x, n.y, n.z)
    };
    folder.write("at.csv", sensors.map(row).collect::<String>());
    1.0 - open.area() / full.area()
}

/// A12, with all bounces: what a sphere holds of the sky behind its hole is within the bound that the report states, or the report
/// warns, or what no ray found is below the most that may be there; behind a large hole it does not warn, and is within.
#[test]
fn light_behind_a_hole_is_within_its_bound_or_announced() {
    let holes =
        [(0.3, 20_480, 0.8), (1e-3, 20_480, 0.8), (1e-3, 20_480, 0.98), (2.5e-4, 20_480, 0.8), (6e-5, 81_920, 0.8)];
    for (fraction, facets, albedo) in holes {
        let folder = Folder::new();
        let may_warn = fraction < 0.1;
        let open = sphere_with_hole(&folder, fraction, facets, albedo);
        assert!(open > 0.0);
        let exact = closed_forms::cap_cavity_irradiance(open, albedo, 1.0);
        // The inside is far darker than the outside, and tolerances are relative to the mean of both.
        let how =
            ["--levels", "2", "--rays", "256", "--sky", "1,1,1", "--tolerance", "1e-5", "--out", "a.csv", "--json"];
        let report = folder.run(&[&["points", "sphere.obj", "--at", "at.csv"], &how[..]].concat()).ok().json();
        let (_, rows) = table(&folder.text("a.csv"));
        let mean = rows.iter().map(|row| row[13]).sum::<f64>() / rows.len() as f64;
        let bound = report["error"]["bound"].as_f64().unwrap_or(0.0);
        // Where no ray finds the hole, what may come through it is bounded.
        let sky = &report["more"]["sky"];
        let most = sky["most_seen_share"].as_f64().unwrap_or(0.0) * std::f64::consts::PI / (1.0 - albedo);
        let is_unseen_and_bounded = sky["seen"].as_u64() == Some(0) && mean == 0.0 && exact <= most;
        let is_announced = report["warnings"].to_string().contains("portal under-sampled");
        let off = (mean / exact - 1.0).abs();
        println!(
            "hole of {open:.2e}, albedo {albedo}: off by {:.2} %, bound {:.2} %, announced: {is_announced}; at most {most:.1e}, \
             exact {exact:.1e}",
            100.0 * off,
            100.0 * bound
        );
        assert!(
            off <= bound || is_announced || is_unseen_and_bounded,
            "{mean} for {exact}, bound {bound}: {}",
            report["warnings"]
        );
        assert!(
            may_warn || (!is_announced && off <= bound),
            "{mean} for {exact}, bound {bound}: {}",
            report["warnings"]
        );
        // Negative control: no light at all would not be within the bound.
        assert!(may_warn || bound < 1.0);
    }
}

/// A closed room of 3 m cut in cells, turned, its corners at `offset` rounded to 32 bits, as glTF; the node moves it by `shift`.
fn turned_room(folder: &Folder, offset: f64, shift: f64) {
    const N: i32 = 6;
    let turn = |p: DVec3| {
        let ((s, c), (u, v)) = (0.4f64.sin_cos(), 0.7f64.sin_cos());
        let q = DVec3::new(c * p.x + s * p.z, p.y, c * p.z - s * p.x);
        DVec3::new(q.x, v * q.y + u * q.z, v * q.z - u * q.y)
    };
    let corner = |i: [i32; 3]| turn(DVec3::from(i.map(f64::from)) * (3.0 / f64::from(N))) + offset;
    let (mut positions, mut n) = (Vec::new(), 0);
    for axis in 0..3 {
        for (side, a, b) in (0..2 * N * N).map(|k| (k % 2, k / 2 % N, k / 2 / N)) {
            let at = |da: i32, db: i32| {
                let mut i = [0; 3];
                (i[axis], i[(axis + 1) % 3], i[(axis + 2) % 3]) = (side * N, a + da, b + db);
                corner(i)
            };
            // Seen from inside, counter-clockwise.
            let quad = if side == 0 {
                [at(0, 0), at(1, 0), at(1, 1), at(0, 1)]
            } else {
                [at(0, 0), at(0, 1), at(1, 1), at(1, 0)]
            };
            for p in [0, 1, 2, 0, 2, 3].map(|k| quad[k]) {
                p.as_vec3().to_array().into_iter().for_each(|x| positions.extend(x.to_le_bytes()));
                n += 1;
            }
        }
    }
    let scene = serde_json::json!({
        "asset": { "version": "2.0" }, "scene": 0, "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "translation": [shift, shift, shift] }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "material": 0 }] }],
        "materials": [{ "emissiveFactor": [1.0, 1.0, 1.0], "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.5, 0.5, 1.0], "metallicFactor": 0.0 } }],
        "accessors": [{ "bufferView": 0, "componentType": 5126, "count": n, "type": "VEC3", "min": [-1e7, -1e7, -1e7], "max": [1e7, 1e7, 1e7] }],
        "bufferViews": [{ "buffer": 0, "byteLength": positions.len() }],
        "buffers": [{ "uri": "room.bin", "byteLength": positions.len() }],
    });
    folder.write("room.bin", positions);
    folder.write("room.gltf", scene.to_string());
}

/// D19: a mesh so far from its origin that its vertices are rounded to 6 cm is announced, with the figure, where functions are
/// smaller than that; and the room that is left of it is as closed and as bright as the one that was meant. D20: moved there by
/// its node it is not rounded, and not announced.
#[test]
fn coordinates_coarser_than_functions_are_announced() {
    let report = |offset: f64, shift: f64, radius: &str| {
        let folder = Folder::new();
        turned_room(&folder, offset, shift);
        let how = [
            "--levels",
            "2",
            "--rays",
            "32",
            "--radius",
            radius,
            "--tolerance",
            "1e-5",
            "-o",
            "a.hplt",
            "--ply",
            "a.ply",
            "--json",
        ];
        let report = folder.run(&[&["solve", "room.gltf"], &how[..]].concat()).ok().json();
        let warnings = report["warnings"].to_string();
        assert_eq!(report["links"]["escaped"].as_u64().unwrap(), 0, "a ray was lost: {report}");
        (warnings, irradiances(&folder.read("a.ply")))
    };
    let (far, values) = report(1e6, 0.0, "0.8");
    assert!(far.contains("coordinate quantum 6.250e-2 m vs radius 4.000e-1 m"), "{far}");
    let (near, as_meant) = report(0.0, 0.0, "0.8");
    let (moved, _) = report(0.0, 1e6, "0.8");
    let (rough, _) = report(1e6, 0.0, "2.5");
    for warnings in [near, moved, rough] {
        assert!(!warnings.contains("coordinate quantum"), "{warnings}");
    }
    let exact = as_meant[0];
    assert!(exact > 0.0 && values.len() > 50, "{exact} {}", values.len());
    let worst = |values: &[f32]| values.iter().map(|v| (v / exact - 1.0).abs()).fold(0.0, f32::max);
    let mean = values.iter().map(|v| f64::from(*v)).sum::<f64>() / values.len() as f64 / f64::from(exact);
    println!(
        "off by {:.1e} as meant, by {:.1e} as rounded, {:+.1e} on average",
        worst(&as_meant),
        worst(&values),
        mean - 1.0
    );
    // Walls that are no longer flat hide some of each other's functions; rays that meet such a place go on, and their light is noisy.
    assert!(worst(&as_meant) < 1e-5 && worst(&values) < 0.01 && (mean - 1.0).abs() < 3e-4);
}

/// The red irradiance of every point of a binary PLY file: the first of the last three numbers of a record.
fn irradiances(ply: &[u8]) -> Vec<f32> {
    let end = b"end_header\n";
    let start = ply.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let header = String::from_utf8_lossy(&ply[..start]);
    let n: usize = header.lines().find_map(|l| l.strip_prefix("element vertex ")).unwrap().trim().parse().unwrap();
    let names: Vec<&str> = header.lines().filter_map(|l| l.strip_prefix("property ")).collect();
    let size = |name: &&str| {
        if name.starts_with("float") || name.starts_with("int") || name.starts_with("uint") { 4 } else { 1 }
    };
    let at: usize = names.iter().take_while(|n| !n.ends_with(" irr_r")).map(size).sum();
    let record: usize = names.iter().map(size).sum();
    let number = |i: usize| f32::from_le_bytes(ply[start + i * record + at..][..4].try_into().unwrap());
    (0..n).map(number).collect()
}
