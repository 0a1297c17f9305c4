//! What each command promises, on tiny scenes.

mod common;

use common::{Folder, Ran, table};

const COLUMNS: &str = "x,y,z,nx,ny,nz,Ed_r,Ed_g,Ed_b,Ei_r,Ei_g,Ei_b,E_r,E_g,E_b";

#[test]
fn points_have_the_columns_and_the_values_of_a_furnace() {
    let folder = Folder::new();
    folder.write("at.csv", "x,y,z,nx,ny,nz\n0.5,0,0.5,0,1,0\n0.2,0.3,0,0,0,2\n0.5,0.5,0.5,0,1,0\n");
    for extra in [&[][..], &["--final-gather", "64"], &["--variant", "delta"]] {
        let args = ["points", "gen:furnace", "--at", "at.csv", "--out", "out.csv", "--tolerance", "1e-5"];
        let ran = folder.tiny(&[&args, extra].concat()).ok();
        assert!(ran.stdout.is_empty(), "{ran:?}");
        let (header, rows) = table(&folder.text("out.csv"));
        assert_eq!(header.join(","), COLUMNS);
        assert_eq!(rows.len(), 3);
        for row in &rows {
            // E = M/(1-ρ) = 2: 1 directly, 1 after reflections, for points on walls and in the air.
            for (column, expected) in [(6, 1.0), (9, 1.0), (12, 2.0), (14, 2.0)] {
                assert!((row[column] - expected).abs() < 2e-4, "{extra:?} {row:?}");
            }
        }
        assert_eq!(rows[1][..6], [0.2, 0.3, 0.0, 0.0, 0.0, 1.0], "order and unit normals");
    }
}

#[test]
fn points_without_an_output_go_to_stdout_and_nothing_else_does() {
    let folder = Folder::new();
    folder.write("at.csv", "0.5 0 0.5 0 1 0\n");
    for out in [&[][..], &["--out", "-"]] {
        let ran = folder.tiny(&[&["points", "gen:furnace", "--at", "at.csv"], out].concat()).ok();
        assert!(ran.stdout.starts_with(COLUMNS) && ran.stdout.lines().count() == 2, "{ran:?}");
    }
}

#[test]
fn where_no_light_gets_to_everything_is_exactly_zero() {
    let folder = Folder::new();
    // The room at x > 0 is dark, the one at x < 0 is lit.
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n0.9,0.5,0.5,0,1,0\n-0.5,0,0.5,0,1,0\n");
    let (_, rows) = table(&folder.tiny(&["points", "gen:two-rooms", "--at", "at.csv"]).ok().stdout);
    assert!(rows[0][6..].iter().chain(&rows[1][6..]).all(|&e| e == 0.0), "{rows:?}");
    assert!(rows[2][12] > 0.1, "{rows:?}");
}

#[test]
fn a_point_in_free_air_gets_light_from_its_own_side() {
    let folder = Folder::new();
    // Between the plates: up sees the black receiver, down the emitter.
    folder.write("at.csv", "0.5,1e-6,0.5,0,1,0\n0.5,0.5,0.5,0,1,0\n0.5,0.5,0.5,0,-1,0\n");
    let (_, rows) = table(&folder.tiny(&["points", "gen:plates", "--at", "at.csv"]).ok().stdout);
    assert_eq!(rows[1][12], 0.0, "{rows:?}");
    // A unit square at distance 1/2 under its centre: F = 0.5541.
    assert!((rows[2][12] - 0.5541).abs() < 2e-3, "{rows:?}");
}

#[test]
fn a_render_writes_what_is_asked_and_says_it_in_one_json_document() {
    let folder = Folder::new();
    let args = ["render", "gen:cornell", "-o", "a.png", "-o", "a.exr", "--size", "24x16", "--json"];
    let report = folder.tiny(&args).ok().json();
    assert_eq!(folder.names(), ["a.exr", "a.png"]);
    assert_eq!(report["outputs"], serde_json::json!(["a.png", "a.exr"]));
    assert_eq!((report["converged"].as_bool(), report["command"].as_str()), (Some(true), Some("render")));
    assert!(report["error"]["mean"].as_f64().unwrap() > 0.0);
    assert!(report["levels"].as_array().unwrap().len() == 2 && report["links"]["links"].as_u64().unwrap() > 0);
    assert!(report["stages"].as_array().unwrap().iter().any(|s| s["stage"] == "links"));
    let exr = folder.read("a.exr");
    for name in ["hplt.seed", "hplt.job", "hplt.error_mean", "indirect.R", "irradiance.G", "albedo.B", "N.X", "P.Z"] {
        assert!(exr.windows(name.len()).any(|w| w == name.as_bytes()), "{name}");
    }
}

/// Where the blocks stand on the floor functions differ, and rays know better.
#[test]
fn pixels_that_interpolation_cannot_be_trusted_at_are_gathered_on_request() {
    let folder = Folder::new();
    let view = ["--size", "24x24", "--eye", "0.278,0.4,0.05", "--target", "0.278,0,0.45", "--every-pixel"];
    let args = [&["render", "gen:cornell"], &view[..]].concat();
    let render = |name: &str, flags: &[&str]| {
        let report = folder.tiny(&[&args[..], &["-o", name, "--json"], flags].concat()).ok().json();
        let count = |key: &str| report["more"][key].as_u64().unwrap();
        (count("gathered"), count("patches"))
    };
    let (none, n_patches) = render("plain.exr", &[]);
    assert_eq!((none, n_patches), render("zero.exr", &["--doubtful-rays", "0"]));
    assert_eq!(folder.read("plain.exr"), folder.read("zero.exr"));
    let (some, _) = render("some.exr", &["--doubtful-rays", "1024"]);
    assert!(none == 0 && 0 < some && some < n_patches, "{some} of {n_patches}");
    let (all, _) = render("all.exr", &["--display", "final-gather", "--gather-rays", "1024"]);
    assert!(all >= n_patches, "{all}");
    let error =
        |name: &str| folder.run(&["compare", name, "all.exr", "--json"]).ok().json()["figures"]["mean"].as_f64();
    assert!(error("some.exr") < error("plain.exr"), "{:?} {:?}", error("some.exr"), error("plain.exr"));
}

/// A picture with more samples at edges alone is nearly one with as many everywhere.
#[test]
fn edges_take_more_samples_and_all_else_takes_one() {
    let folder = Folder::new();
    let render = |name: &str, flags: &[&str]| {
        let args = ["render", "gen:cornell", "--size", "64x64", "-o", name, "--json"];
        let report = folder.tiny(&[&args[..], flags].concat()).ok().json();
        ["samples", "read"].map(|key| report["more"][key].as_u64().unwrap())
    };
    let every = render("every.exr", &["--every-pixel"]);
    let some = render("some.exr", &[]);
    let one = render("one.exr", &["--samples", "1"]);
    assert_eq!((every[0], one[0]), (16 * 64 * 64, 64 * 64));
    assert!(one[0] < some[0] && some[0] < every[0] * 3 / 4 && some[1] < every[1], "{one:?} {some:?} {every:?}");
    let error = |name: &str| {
        let report = folder.run(&["compare", name, "every.exr", "--json"]).ok().json();
        report["figures"]["mean"].as_f64().unwrap()
    };
    let [some, one] = [error("some.exr"), error("one.exr")];
    assert!(some < 0.01 && one > 3.0 * some, "{some} {one}");
}

#[test]
fn all_displays_show_about_the_same_picture() {
    let folder = Folder::new();
    let view = ["--size", "24x24", "--eye", "0.28,0.27,0.05", "--target", "0.28,0.2,0.5", "--every-pixel"];
    let args = [&["render", "gen:cornell-closed"], &view[..]].concat();
    for variant in ["delta", "absolute"] {
        for display in ["evaluate", "splat", "flatten", "final-gather"] {
            let name = format!("{display}.exr");
            folder.tiny(&[&args[..], &["--variant", variant, "--display", display, "-o", &name]].concat()).ok();
        }
        for (other, limit) in [("splat", "0.4%"), ("flatten", "6%"), ("final-gather", "15%")] {
            let name = format!("{other}.exr");
            folder.run(&["compare", &name, "evaluate.exr", "--max-mean", limit]).ok();
        }
    }
}

#[test]
fn a_solution_gives_the_same_points_as_the_solve_that_it_keeps() {
    let folder = Folder::new();
    folder.tiny(&["sample-points", "gen:cornell", "-n", "30", "-o", "at.csv"]).ok();
    for variant in ["delta", "absolute"] {
        let solve = ["solve", "gen:cornell", "-o", "a.hplt", "--ply", "a.ply", "--variant", variant];
        folder.tiny(&solve).ok();
        folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv", "--variant", variant]).ok();
        let again = ["points", "gen:cornell", "--solution", "a.hplt", "--at", "at.csv", "--out", "b.csv"];
        folder.tiny(&again).ok();
        assert_eq!(folder.read("a.csv"), folder.read("b.csv"), "{variant}");
    }
    assert!(folder.read("a.ply").starts_with(b"ply\n"));
}

#[test]
fn a_solution_of_another_scene_or_a_damaged_one_is_refused() {
    let folder = Folder::new();
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    folder.tiny(&["solve", "gen:furnace", "-o", "a.hplt"]).ok();
    let with = |scene: &str, more: &[&str]| {
        folder.tiny(&[&["points", scene, "--at", "at.csv", "--solution", "a.hplt"], more].concat())
    };
    with("gen:furnace", &[]).ok();
    with("gen:dark-room", &[]).fails(9, "SOLUTION_MISMATCH");
    with("gen:furnace", &["--sky", "1,1,1"]).fails(9, "SOLUTION_MISMATCH");
    let mut bytes = folder.read("a.hplt");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    folder.write("a.hplt", &bytes);
    with("gen:furnace", &[]).fails(9, "SOLUTION_CORRUPT");
    folder.write("a.hplt", &bytes[..middle]);
    with("gen:furnace", &[]).fails(9, "SOLUTION_TRUNCATED");
    folder.write("a.hplt", "not a solution, but long enough to hold a header");
    with("gen:furnace", &[]).fails(9, "SOLUTION_MAGIC");
}

#[test]
fn the_reference_agrees_with_the_solver_and_tells_its_standard_error() {
    let folder = Folder::new();
    folder.run(&["sample-points", "gen:cornell", "-n", "12", "-o", "at.csv"]).ok();
    let ran = folder.run(&["reference", "gen:cornell", "--at", "at.csv", "--out", "t.csv", "--error", "5%", "--json"]);
    let report = ran.ok().json();
    assert!(report["standard_error"].is_null() && report["more"]["standard_error"]["max"].as_f64().unwrap() <= 0.05);
    let (header, rows) = table(&folder.text("t.csv"));
    assert_eq!(header.join(","), format!("{COLUMNS},SE_r,SE_g,SE_b"));
    assert!(rows.iter().all(|r| r.len() == 18 && r[15] > 0.0));
    let solver = ["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv", "--levels", "3", "--rays", "64"];
    folder.run(&solver).ok();
    folder.run(&["compare", "a.csv", "t.csv", "--max-mean", "12%", "--max-bias", "5%"]).ok();
    // The same with a factor of π: it must not pass.
    let wrong: Vec<String> = rows
        .iter()
        .map(|r| {
            r.iter()
                .enumerate()
                .map(|(i, x)| if i < 6 { x.to_string() } else { (x * std::f64::consts::PI).to_string() })
        })
        .map(|cells| cells.collect::<Vec<_>>().join(","))
        .collect();
    folder.write("wrong.csv", format!("{}\n{}\n", header.join(","), wrong.join("\n")));
    let ran = folder.run(&["compare", "wrong.csv", "t.csv", "--max-mean", "12%"]);
    assert_eq!(ran.code, Some(6), "{ran:?}");
}

#[test]
fn an_error_that_is_asked_for_is_reached_and_one_that_is_not_is_told() {
    let folder = Folder::new();
    folder.run(&["sample-points", "gen:cornell", "-n", "100", "--seed", "5", "-o", "at.csv"]).ok();
    folder.run(&["reference", "gen:cornell", "--at", "at.csv", "--out", "truth.csv", "--error", "1%"]).ok();
    let points = |out: &str, budget: &[&str]| {
        folder.run(&[&["points", "gen:cornell", "--at", "at.csv", "--out", out, "--json"], budget].concat())
    };
    let expected = |ran: &Ran| {
        let report: serde_json::Value = serde_json::from_str(&ran.stdout).unwrap();
        report["more"]["expected_error"].as_f64().unwrap()
    };
    let rough = points("rough.csv", &["--error", "8%"]).ok();
    let fine = points("fine.csv", &["--error", "1.5%"]).ok();
    assert!(expected(&rough) <= 0.08 && expected(&fine) <= 0.015, "{rough:?} {fine:?}");
    folder.run(&["compare", "rough.csv", "truth.csv", "--max-mean", "10%"]).ok();
    folder.run(&["compare", "fine.csv", "truth.csv", "--max-mean", "3%"]).ok();
    let hopeless = points("hopeless.csv", &["--error", "0.01%", "--time", "1ms"]);
    assert!(hopeless.code == Some(6) && hopeless.stderr.contains("was asked for"), "{hopeless:?}");
    assert!(folder.path("hopeless.csv").exists(), "what could be had is written");
}

#[test]
fn a_reference_picture_agrees_with_a_rendered_one() {
    let folder = Folder::new();
    // Down at the blocks: the lamp, seen, would hide everything else in the mean.
    let size = ["--size", "16x16", "--eye", "0.278,0.4,0.05", "--target", "0.278,0,0.45"];
    folder.run(&[&["reference", "gen:cornell", "-o", "t.exr", "--paths", "64"], &size[..]].concat()).ok();
    folder.run(&[&["render", "gen:cornell", "-o", "a.exr", "--levels", "4", "--rays", "64"], &size[..]].concat()).ok();
    folder.run(&["compare", "a.exr", "t.exr", "--max-mean", "10%", "--max-bias", "5%"]).ok();
    let ran = folder.run(&["compare", "a.exr", "t.exr", "--max-mean", "0.01%", "--json"]);
    assert_eq!((ran.code, ran.json()["beyond_limit"][0].as_str()), (Some(6), Some("mean")));
}

#[test]
fn comparing_a_file_with_itself_finds_no_error() {
    let folder = Folder::new();
    folder.write("at.csv", "0.2,0,0.3,0,1,0\n");
    folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv"]).ok();
    let report = folder.run(&["compare", "a.csv", "a.csv", "--json"]).ok().json();
    assert_eq!((report["figures"]["mean"].as_f64(), report["points"].as_u64()), (Some(0.0), Some(1)));
    folder.write("b.csv", folder.text("a.csv").replace("0.2,0,0.3", "0.2,0,0.4"));
    folder.run(&["compare", "b.csv", "a.csv"]).fails(3, "POINTS_DIFFER");
    folder.run(&["compare", "a.csv", "a.exr"]).fails(2, "USAGE");
}

#[test]
fn generated_files_light_like_the_scenes_that_they_hold() {
    let folder = Folder::new();
    folder.run(&["gen", "cornell", "-o", "a.glb"]).ok();
    folder.write("at.csv", "0.2,0,0.3,0,1,0\n0.3,0.3,0.5592,0,0,-1\n");
    folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv"]).ok();
    folder.tiny(&["points", "a.glb", "--at", "at.csv", "--out", "b.csv"]).ok();
    // Not the same bits: the file holds world coordinates in 32 bits, and the few rays of this run land elsewhere.
    folder.run(&["compare", "b.csv", "a.csv", "--max-mean", "6%"]).ok();
    assert!(folder.run(&["gen", "--list"]).ok().stdout.lines().any(|l| l.starts_with("cornell")));
}

#[test]
fn what_is_made_of_files_is_written_like_what_is_made_of_nothing() {
    let folder = Folder::new();
    folder.run(&["gen", "cornell", "-o", "a.glb"]).ok();
    for (name, triangles) in [("room-with=a.glb", "50 triangles"), ("flat=a.glb", "36 triangles")] {
        folder.run(&["gen", name, "-o", "b.glb", "--force"]).ok();
        let said = folder.run(&["info", "b.glb"]).ok().stdout;
        assert!(said.contains(triangles), "{name}: {said}");
    }
    folder.run(&["gen", "flat=none.glb", "-o", "c.glb"]).fails(3, "FILE_UNREADABLE");
    folder.run(&["gen", "flat=a.glb", "--triangles", "100", "-o", "c.glb"]).fails(2, "USAGE");
}

#[test]
fn info_tells_what_is_there_and_what_is_left_out() {
    let folder = Folder::new();
    let ran = folder.run(&["info", "gen:cornell"]).ok();
    for what in ["36 triangles", "2 emissive triangles", "camera", "left out", "estimate"] {
        assert!(ran.stdout.contains(what), "{what}: {ran:?}");
    }
    let report = folder.run(&["info", "gen:cornell", "--json", "--sun", "0,1,0:1,1,1", "--sky", "1,1,1"]).ok().json();
    assert_eq!((report["more"]["lights"].as_u64(), report["more"]["has_environment"].as_bool()), (Some(1), Some(true)));
}

#[test]
fn lights_come_from_flags_and_from_the_config() {
    let folder = Folder::new();
    folder.write("at.csv", "0,0,0,0,1,0\n");
    let points = |more: &[&str]| {
        let ran = folder.tiny(&[&["points", "gen:plane", "--at", "at.csv", "--one-sided"], more].concat()).ok();
        table(&ran.stdout).1[0][12]
    };
    let pi = std::f64::consts::PI;
    // The scene's own sky has radiance 1; a sky from a flag replaces it.
    assert!((points(&[]) - pi).abs() < 0.01);
    assert!((points(&["--sky", "2,2,2"]) - 2.0 * pi).abs() < 0.01);
    assert!((points(&["--sun", "0,1,1:2,2,2"]) - pi - 2f64.sqrt()).abs() < 0.01);
    assert!((points(&["--point-light", "0,2,0:8,8,8"]) - pi - 2.0).abs() < 0.01);
    folder.write("job.toml", "[[light]]\nkind = \"sun\"\ndirection = [0, 1, 0]\nirradiance = [3, 3, 3]\n");
    assert!((points(&["--config", "job.toml"]) - pi - 3.0).abs() < 0.01);
    // A unit square 1 m above, facing down, takes F of the sky away and brings M·F: F = 0.239456.
    let lamp = points(&["--rect-light", "-0.5,1,-0.5:1,0,0:0,0,1:1,1,1"]);
    assert!((lamp - pi).abs() < 0.02, "{lamp}");
}

#[test]
fn a_dry_run_and_a_printed_config_write_nothing() {
    let folder = Folder::new();
    let report = folder.tiny(&["render", "gen:cornell", "-o", "a.png", "--dry-run", "--json"]).ok().json();
    assert!(report["estimate"]["points_per_level"].as_array().unwrap().len() == 2);
    let config = folder.tiny(&["solve", "gen:cornell", "--print-config"]).ok().stdout;
    assert!(config.contains("rays = 16  # flag") && config.contains("seed = 0  # default"), "{config}");
    assert!(folder.names().is_empty());
    folder.write("job.toml", &config);
    folder.run(&["render", "gen:cornell", "--config", "job.toml", "--print-config"]).ok();
}

#[test]
fn without_a_command_the_cornell_box_is_meant() {
    // The demo itself takes its time; that the command it stands for exists and what it writes is tested here.
    let folder = Folder::new();
    let ran = folder.run(&["--help"]).ok();
    assert!(ran.stdout.contains("hplt render gen:cornell -o out/cornell.png -o out/cornell.exr"), "{ran:?}");
    for command in ["render", "solve", "points", "sample-points", "reference", "compare", "info", "gen"] {
        assert!(folder.run(&[command, "--help"]).ok().stdout.contains("Example"), "{command}");
    }
}

/// Every part that is switched off changes what it is about and nothing else, by little: the light is the same.
#[test]
fn parts_that_are_switched_off_change_the_light_by_little() {
    let folder = Folder::new();
    folder.run(&["sample-points", "gen:cornell", "-n", "300", "-o", "at.csv"]).ok();
    let light = |flags: &[&str]| {
        let args = ["points", "gen:cornell", "--at", "at.csv", "--doubtful-rays", "0", "--levels", "2", "--rays", "64"];
        table(&folder.run(&[&args, flags].concat()).ok().stdout).1
    };
    let changes = |rows: &[Vec<f64>], full: &[Vec<f64>], column: usize| {
        let sum = |rows: &[Vec<f64>]| rows.iter().map(|row| row[column]).sum::<f64>();
        let n = rows.iter().zip(full).filter(|(row, full)| row[column] != full[column]).count();
        (n, sum(rows) / sum(full) - 1.0)
    };
    let full = light(&[]);
    for (part, is_direct, is_indirect) in
        [("gradients", false, true), ("sight", false, true), ("exact-light", true, false)]
    {
        let rows = light(&["--without", part]);
        let [direct, indirect] = [6, 9].map(|column| changes(&rows, &full, column));
        println!("{part}: {direct:?} {indirect:?}");
        assert_eq!([direct.0 > 10, indirect.0 > 10], [is_direct, is_indirect], "{part}: {direct:?} {indirect:?}");
        assert!(direct.1.abs() < 0.02 && indirect.1.abs() < 0.05, "{part}: {direct:?} {indirect:?}");
    }
    folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--without", "everything"]).fails(2, "USAGE");
}
