//! Bad input of every kind: one line, the right exit code, old outputs unharmed.

mod common;

use common::Folder;

#[test]
fn wrong_flags_are_usage_errors() {
    let folder = Folder::new();
    for flags in [
        &["--radius", "0"][..],
        &["--radius", "-1"],
        &["--radius", "nan"],
        &["--rays", "0"],
        &["--rays", "100"],
        &["--tolerance", "0"],
        &["--levels", "0"],
        &["--solver", "bounces", "--variant", "absolute"],
        &["--solver", "jacobi"],
        &["--threads", "0"],
        &["--max-memory", "0"],
        &["--max-time", "-1s"],
        &["--preset", "best"],
        &["--no-such-flag"],
        &["--sun", "0,0,0:1,1,1"],
        &["--sky", "1,1"],
        &["--sky", "-1,0,0"],
        &["--sky", "1,1,1", "--environment", "sky.exr"],
        &["--camera", "nine"],
        &["--eye", "0,0,0", "--target", "0,0,0"],
        &["--size", "0x9"],
        &["--fov", "0"],
        &["--doubtful-rays", "7"],
        &["--error", "0"],
        &["--error", "1%"],
    ] {
        let args = [&["render", "gen:cornell", "-o", "a.png", "--levels", "1", "--rays", "8"], flags].concat();
        // Given twice, clap complains, which is a usage error too.
        folder.run(&args).fails(2, "USAGE");
    }
    folder.run(&["render", "gen:castle", "-o", "a.png"]).fails(2, "USAGE");
    folder.run(&["render", "gen:cornell", "-o", "a.bmp"]).fails(2, "USAGE");
    folder.run(&["render", "gen:cornell"]).fails(2, "USAGE");
    folder.run(&["paint"]).fails(2, "USAGE");
    folder.run(&["points", "gen:cornell", "--at", "p.csv", "--json"]).fails(2, "USAGE");
    folder.run(&["points", "gen:cornell", "--at", "p.csv", "--final-gather", "7"]).fails(2, "USAGE");
    for flags in [["--error", "200%"], ["--time", "0s"], ["--time", "-1s"]] {
        folder.run(&[&["solve", "gen:cornell", "-o", "a.hplt"][..], &flags].concat()).fails(2, "USAGE");
    }
    let budget = ["points", "gen:cornell", "--at", "p.csv", "--error", "1%"];
    for flags in [["--variant", "delta"], ["--solution", "a.hplt"], ["--final-gather", "64"], ["--rays", "64"]] {
        folder.run(&[&budget[..], &flags].concat()).fails(2, "USAGE");
    }
    folder.run(&["sample-points", "gen:cornell", "-n", "0"]).fails(2, "USAGE");
    folder.run(&["gen", "cornell", "-o", "a.obj"]).fails(2, "USAGE");
    assert!(folder.names().is_empty());
}

#[test]
fn a_usage_error_is_one_json_document_too_when_json_is_asked_for() {
    let folder = Folder::new();
    let ran = folder.run(&["render", "gen:cornell", "-o", "a.png", "--json", "--no-such-flag"]).fails(2, "USAGE");
    assert_eq!(ran.json()["error"]["exit"], 2);
    let ran = folder.run(&["render", "none.glb", "-o", "a.png", "--json"]).fails(3, "FILE_UNREADABLE");
    assert_eq!(ran.json()["error"]["code"], "FILE_UNREADABLE");
}

#[test]
fn config_files_with_mistakes_are_refused_with_their_line() {
    let folder = Folder::new();
    let nested = format!("a = {}", "[".repeat(100_000));
    for text in [
        "[solve]\nrayz = 5\n",
        "[solv]\nrays = 8\n",
        "[solve]\nrays = \"many\"\n",
        "[solve]\nrays = 8\nrays = 16\n",
        "[solve]\nseed = 1e400\n",
        "[solve]\nrays = 7\n",
        "[run]\nmax-time = \"soon\"\n",
        "[[light]]\nkind = \"laser\"\n",
        "[[light]]\nkind = \"sky\"\nradiance = [1, 1, 1]\ncolor = 3\n",
        "\u{0}",
        &nested,
    ] {
        folder.write("job.toml", text);
        let ran = folder.run(&["render", "gen:cornell", "-o", "a.png", "--config", "job.toml"]).fails(2, "USAGE");
        assert!(text.contains("rays = 7") || ran.stderr.contains("job.toml"), "{ran:?}");
    }
    folder.run(&["render", "gen:cornell", "-o", "a.png", "--config", "none.toml"]).fails(2, "USAGE");
    folder.run(&["render", "gen:cornell", "-o", "a.png", "--config", "."]).fails(2, "USAGE");
}

#[test]
fn scenes_that_cannot_be_read_are_input_errors() {
    let folder = Folder::new();
    folder.write("empty.glb", "");
    folder.write("text.gltf", "hello");
    folder.write("bomb.gltf", r#"{"asset":{"version":"2.0"},"accessors":[{"componentType":5126,"count":1000000000000,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],"scenes":[{"nodes":[0]}]}"#);
    folder.write("away.gltf", r#"{"asset":{"version":"2.0"},"buffers":[{"byteLength":4,"uri":"../../etc/passwd"}],"bufferViews":[{"buffer":0,"byteLength":4}],"accessors":[{"bufferView":0,"componentType":5126,"count":3,"type":"VEC3"}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}],"nodes":[{"mesh":0}],"scenes":[{"nodes":[0]}]}"#);
    folder.write("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    for name in ["none.glb", ".", "empty.glb", "text.gltf", "bomb.gltf", "away.gltf", "nan.obj"] {
        let ran = folder.tiny(&["render", name, "-o", "a.png"]);
        assert!(matches!(ran.code, Some(3 | 4)), "{name}: {ran:?}");
        assert!(ran.stderr.starts_with("error[") && ran.stderr.lines().count() == 1, "{name}: {ran:?}");
        assert!(ran.stderr.contains(name), "{name}: {ran:?}");
    }
    folder.tiny(&["render", "nan.obj", "-o", "a.png"]).fails(3, "VALUE_NOT_FINITE");
    assert!(!folder.path("a.png").exists());
}

#[test]
fn a_scene_without_surface_is_refused_or_accepted_as_asked() {
    let folder = Folder::new();
    folder.write("empty.obj", "# nothing\n");
    folder.write("at.csv", "0,0,0,0,1,0\n");
    folder.tiny(&["render", "empty.obj", "-o", "a.png"]).fails(3, "NO_SURFACE");
    folder.tiny(&["render", "empty.obj", "-o", "a.png", "--allow-empty", "--size", "8x8"]).ok();
    let ran = folder.tiny(&["points", "empty.obj", "--at", "at.csv", "--allow-empty"]).ok();
    assert!(ran.stdout.lines().nth(1).unwrap().ends_with(",0,0,0,0,0,0,0,0,0"), "{ran:?}");
}

#[test]
fn albedos_out_of_range_are_refused_or_clamped_as_asked() {
    let folder = Folder::new();
    folder.write("a.mtl", "newmtl wall\nKd 2 0.5 0.5\nKe 1 1 1\n");
    folder.write("a.obj", "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl wall\nf 1 2 3\n");
    let ran = folder.tiny(&["info", "a.obj"]).fails(3, "VALUE_NOT_IN_RANGE");
    assert!(
        ran.stderr.contains("wall") && ran.stderr.contains('2') && ran.stderr.contains("--clamp-materials"),
        "{ran:?}"
    );
    folder.tiny(&["info", "a.obj", "--clamp-materials"]).ok();
}

#[test]
fn tables_with_mistakes_name_the_line() {
    let folder = Folder::new();
    for (text, line) in [
        ("x,y,z,nx,ny,nz\n0,0,0,0,1,0\n0,0,zero,0,1,0\n", "line 3"),
        ("0,0,0,0,0,0\n", "line 1"),
        ("0,0,0,0,nan,0\n", "line 1"),
        ("0,0,inf,0,1,0\n", "line 1"),
        ("1,2,3\n", "line 1"),
        ("x,y,nx,ny,nz\n", "line 1"),
    ] {
        folder.write("at.csv", text);
        let ran = folder.tiny(&["points", "gen:cornell", "--at", "at.csv"]);
        assert_eq!(ran.code, Some(3), "{ran:?}");
        assert!(ran.stderr.contains("at.csv") && ran.stderr.contains(line), "{ran:?}");
    }
}

#[test]
fn more_memory_than_allowed_is_refused_before_it_is_taken() {
    let folder = Folder::new();
    let render = ["render", "gen:cornell", "-o", "a.png"];
    let ran = folder.run(&[&render[..], &["--radius", "1e-6"]].concat()).fails(5, "LIMIT_MEMORY");
    assert!(ran.stderr.contains("--radius") && ran.stderr.contains("limit"), "{ran:?}");
    folder.run(&[&render[..], &["--max-memory", "1MB"]].concat()).fails(5, "LIMIT_MEMORY");
    folder.run(&[&render[..], &["--max-memory", "1MB", "--dry-run"]].concat()).fails(5, "LIMIT_MEMORY");
    assert!(folder.names().is_empty());
}

#[test]
fn a_closed_white_room_has_no_finite_solution() {
    let folder = Folder::new();
    folder.tiny(&["render", "gen:white-furnace", "-o", "a.png"]).fails(6, "NO_FINITE_SOLUTION");
    assert!(folder.names().is_empty());
}

#[test]
fn no_light_at_all_is_a_black_result_and_a_warning() {
    let folder = Folder::new();
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    let ran = folder.tiny(&["points", "gen:dark-room", "--at", "at.csv"]).ok();
    assert!(ran.stderr.contains("no light"), "{ran:?}");
    assert!(ran.stdout.lines().nth(1).unwrap().ends_with(",0,0,0,0,0,0,0,0,0"), "{ran:?}");
}

#[test]
fn too_few_bounces_are_marked_and_with_strict_nothing_is_written() {
    let folder = Folder::new();
    let render =
        ["render", "gen:furnace", "-o", "a.exr", "--size", "8x8", "--bounces", "2", "--json", "--variant=absolute"];
    let ran = folder.tiny(&[&render[..], &["--strict"]].concat()).fails(6, "NOT_CONVERGED");
    assert!(folder.names().is_empty() && ran.json()["error"]["exit"] == 6);
    let ran = folder.tiny(&render);
    assert_eq!((ran.code, ran.json()["converged"].as_bool()), (Some(6), Some(false)), "{ran:?}");
    let exr = folder.read("a.exr");
    assert!(exr.windows(11).any(|w| w == b"max-bounces"));
    folder.tiny(&[&render[..], &["--tolerance", "none"]].concat()).ok();
}

#[test]
fn outputs_that_would_destroy_something_are_refused_and_the_old_file_stays() {
    let folder = Folder::new();
    folder.write("notes.csv", "my notes\n");
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    let points = ["points", "gen:furnace", "--at", "at.csv", "--out"];
    folder.tiny(&[&points[..], &["notes.csv"]].concat()).fails(8, "OUTPUT_REFUSED");
    assert_eq!(folder.text("notes.csv"), "my notes\n");
    folder.tiny(&[&points[..], &["at.csv", "--force"]].concat()).fails(8, "OUTPUT_REFUSED");
    folder.tiny(&[&points[..], &["none/a.csv"]].concat()).fails(8, "OUTPUT_REFUSED");
    folder.tiny(&[&points[..], &["."]].concat()).fails(8, "OUTPUT_REFUSED");
    folder.tiny(&[&points[..], &["notes.csv", "--force"]].concat()).ok();
    folder.tiny(&[&points[..], &["notes.csv"]].concat()).ok();
    let before = folder.read("notes.csv");
    folder
        .tiny(&["points", "gen:white-furnace", "--at", "at.csv", "--out", "notes.csv"])
        .fails(6, "NO_FINITE_SOLUTION");
    assert_eq!(folder.read("notes.csv"), before);
}

#[cfg(unix)]
#[test]
fn a_folder_that_cannot_be_written_is_an_output_error() {
    use std::os::unix::fs::PermissionsExt;
    let folder = Folder::new();
    std::fs::create_dir(folder.path("locked")).unwrap();
    std::fs::set_permissions(folder.path("locked"), std::fs::Permissions::from_mode(0o555)).unwrap();
    // Root may write everywhere.
    if std::fs::write(folder.path("locked/probe"), "").is_ok() {
        return;
    }
    folder.tiny(&["render", "gen:furnace", "-o", "locked/a.png", "--size", "8x8"]).fails(8, "OUTPUT_IO");
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_output_error() {
    let folder = Folder::new();
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    let full = std::fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    let mut command = folder.command(&["points", "gen:furnace", "--at", "at.csv", "--levels", "1", "--rays", "8"]);
    let ran = common::Ran::from(command.stdout(full).output().unwrap());
    ran.fails(8, "OUTPUT_IO");
}
