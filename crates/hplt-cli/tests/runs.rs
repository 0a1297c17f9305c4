//! Same bytes at any thread count, interruption, time limits, closed streams.

mod common;

use common::Folder;

#[test]
fn outputs_are_the_same_bytes_at_any_thread_count() {
    let folder = Folder::new();
    folder.run(&["sample-points", "gen:cornell", "-n", "40", "-o", "at.csv"]).ok();
    let mut first: Option<Vec<Vec<u8>>> = None;
    for threads in ["1", "2", "3"] {
        let quick = ["--threads", threads, "--levels", "2", "--rays", "32", "-q"];
        let run = |args: &[&str]| folder.run(&[args, &quick].concat()).ok();
        run(&["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv", "--final-gather", "32"]);
        run(&["render", "gen:cornell", "-o", "a.exr", "-o", "a.png", "--size", "32x32", "--variant", "delta"]);
        run(&["solve", "gen:cornell", "-o", "a.hplt", "--sky", "0.1,0.1,0.1"]);
        run(&["reference", "gen:cornell", "--at", "at.csv", "--out", "t.csv", "--error", "20%"]);
        let bytes: Vec<Vec<u8>> = ["a.csv", "a.exr", "a.png", "a.hplt", "t.csv"].map(|f| folder.read(f)).to_vec();
        match &first {
            None => first = Some(bytes),
            Some(first) => assert!(*first == bytes, "{threads} threads"),
        }
    }
    // The comparison can fail: another seed gives other bytes.
    let other = ["points", "gen:cornell", "--at", "at.csv", "--out", "a.csv", "--final-gather", "32", "--seed", "1"];
    folder.run(&[&other[..], &["--levels", "2", "--rays", "32"]].concat()).ok();
    assert!(first.unwrap()[0] != folder.read("a.csv"));
}

#[test]
fn out_of_time_before_the_first_result_is_said_and_nothing_is_written() {
    let folder = Folder::new();
    let ran = folder.run(&["render", "gen:cornell", "-o", "a.png", "--max-time", "1ms"]).fails(6, "TIME_LIMIT");
    assert!(folder.names().is_empty(), "{ran:?}");
}

#[test]
fn out_of_time_while_bouncing_writes_what_is_finished_and_marks_it() {
    let folder = Folder::new();
    let endless = ["--levels", "3", "--rays", "65536", "--tolerance", "none"];
    let render =
        ["render", "gen:furnace", "-o", "a.exr", "--size", "16x16", "--max-time", "4s", "--json", "--variant=absolute"];
    let started = std::time::Instant::now();
    let ran = folder.run(&[&render[..], &endless].concat());
    assert_eq!(ran.code, Some(6), "{ran:?}");
    assert!(started.elapsed().as_secs_f64() < 60.0);
    let report = ran.json();
    assert_eq!((report["stop"].as_str(), report["converged"].as_bool()), (Some("time-limit"), Some(false)));
    assert!(folder.read("a.exr").windows(10).any(|w| w == b"time-limit"));
}

#[cfg(unix)]
#[test]
fn an_interrupt_writes_what_is_finished_and_ends_with_130() {
    use std::process::{Command, Stdio};
    let folder = Folder::new();
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    let args = ["points", "gen:furnace", "--at", "at.csv", "--out", "a.csv", "--progress", "json", "--levels", "3"];
    let bouncing = "--variant=absolute";
    // The time limit only ends this test where interrupting fails.
    let endless = ["--rays", "65536", "--tolerance", "none", "--max-time", "60s", bouncing];
    let mut command = folder.command(&[&args[..], &endless].concat());
    let mut child = command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    // Once it bounces, it goes on for minutes.
    let mut stderr = std::io::BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("\"bounce\"") {
        line.clear();
        assert!(std::io::BufRead::read_line(&mut stderr, &mut line).unwrap() > 0, "ended by itself");
    }
    std::thread::sleep(std::time::Duration::from_millis(300));
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
    std::io::copy(&mut stderr, &mut std::io::sink()).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let (_, rows) = common::table(&folder.text("a.csv"));
    assert!(rows[0][12] > 0.99 && rows[0][12] < 2.01, "{rows:?}");
    assert_eq!(folder.names(), ["a.csv", "at.csv"]);
}

#[cfg(unix)]
#[test]
fn closed_streams_do_not_change_the_result() {
    use std::process::Command;
    let folder = Folder::new();
    folder.write("at.csv", "0.5,0,0.5,0,1,0\n");
    let hplt = env!("CARGO_BIN_EXE_hplt");
    let points = "points gen:furnace --at at.csv --levels 1 --rays 8";
    let shell = |script: &str| {
        let status = Command::new("sh").args(["-c", script]).current_dir(folder.root()).status().unwrap();
        status.code()
    };
    assert_eq!(shell(&format!("'{hplt}' {points} --out a.csv 2>/dev/null >/dev/null")), Some(0));
    assert_eq!(shell(&format!("'{hplt}' {points} --out b.csv -v --progress plain 2>&- >&-")), Some(0));
    assert_eq!(folder.read("a.csv"), folder.read("b.csv"));
    // A reader that goes away at once.
    let script = format!("{{ '{hplt}' sample-points gen:furnace -n 20000 2>/dev/null; echo $? >&3; }} 3>code | true");
    shell(&script);
    assert_eq!(folder.text("code").trim(), "0");
}

#[cfg(unix)]
#[test]
fn names_with_spaces_and_other_alphabets_work_in_the_c_locale() {
    let folder = Folder::new();
    folder.run(&["gen", "furnace", "-o", "ein Raum ü.glb"]).ok();
    let mut command = folder.command(&["info", "ein Raum ü.glb"]);
    let ran = common::Ran::from(command.env("LANG", "C").env("LC_ALL", "C").output().unwrap());
    assert!(ran.ok().stdout.contains("12 triangles"));
}

#[test]
fn progress_is_silent_without_a_terminal_and_one_document_a_line_when_asked() {
    let folder = Folder::new();
    let render = ["render", "gen:furnace", "-o", "a.png", "--size", "8x8", "-q"];
    assert_eq!(folder.tiny(&render).ok().stderr, "");
    let ran = folder.tiny(&[&render[..], &["--progress", "json"]].concat()).ok();
    assert!(ran.stderr.lines().count() > 0);
    for line in ran.stderr.lines() {
        let event: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(event["event"], "progress");
    }
}
