//! Changed lights from the command line: files, factors, and what is refused.

mod common;

use common::{Folder, table};
use hplt_io::{Limits, Section, SectionData, SolutionFile, read_solution, write_solution};
use serde_json::Value;

/// A closed box with a lamp of its own, a point light and another lamp on the floor.
const SCENE: [&str; 5] = [
    "gen:cornell-closed",
    "--point-light",
    "bulb=0.1,0.4,0.2:0.3,0.2,0.1",
    "--rect-light",
    "desk lamp=0.45,0.2,0.1:0,0.1,0:0,0,0.1:4,8,2",
];
const TIGHT: [&str; 2] = ["--tolerance", "1e-5"];
const AT: &str = "x,y,z,nx,ny,nz\n0.1,0,0.1,0,1,0\n0.05,0,0.5,0,1,0\n0.28,0.5488,0.1,0,-1,0\n0.3,0.2,0.5592,0,0,-1\n";

fn solve(folder: &Folder, extra: &[&str], name: &str) -> Value {
    let args = [&["solve"][..], &SCENE, &TIGHT, extra, &["-o", name, "--json", "--force"]].concat();
    folder.tiny(&args).ok().json()["more"].clone()
}

/// Direct, indirect and total irradiance at a few points.
fn light_at(folder: &Folder, scene: &[&str], extra: &[&str]) -> Vec<Vec<f64>> {
    folder.write("at.csv", AT);
    let args = [&["points"][..], scene, &TIGHT, &["--at", "at.csv"], extra].concat();
    let (_, rows) = table(&folder.tiny(&args).ok().stdout);
    rows.into_iter().map(|row| row[6..].to_vec()).collect()
}

fn from_solution(folder: &Folder, name: &str) -> Vec<Vec<f64>> {
    light_at(folder, &SCENE, &["--solution", name])
}

/// The largest difference over the mean of `b`.
fn difference(a: &[Vec<f64>], b: &[Vec<f64>]) -> f64 {
    let flat = |rows: &[Vec<f64>]| rows.concat();
    let mean = flat(b).iter().sum::<f64>() / flat(b).len() as f64;
    flat(a).iter().zip(flat(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / mean
}

#[test]
fn the_same_lights_are_the_same_light_and_the_file_returns_to_the_bit() {
    let folder = Folder::new();
    solve(&folder, &[], "plain.hplt");
    let kept = solve(&folder, &["--keep-links"], "room.hplt");
    assert_eq!(kept["kept"]["light_groups"], serde_json::json!(["light", "desk lamp", "bulb"]));
    assert_eq!(kept["file_bytes"], folder.read("room.hplt").len() as u64);
    let size = kept["kept"]["links_bytes"].as_u64().unwrap() + kept["kept"]["groups_bytes"].as_u64().unwrap();
    let more = (folder.read("room.hplt").len() - folder.read("plain.hplt").len()) as u64;
    assert!((size..size + 2000).contains(&more), "{size} {more}");
    assert_eq!(from_solution(&folder, "room.hplt"), from_solution(&folder, "plain.hplt"));
    let report = folder.run(&["relight", "room.hplt", "-o", "same.hplt", "--json", "--from-scratch"]).ok().json();
    assert!(report["method"] == "solve" && report["sweeps"].as_u64().unwrap() > 1);
    assert!(report["seconds"]["solve"].as_f64().is_some() && report["bound"].as_f64().unwrap() <= 1e-5);
    let same = difference(&from_solution(&folder, "same.hplt"), &from_solution(&folder, "room.hplt"));
    assert!(same < 4e-5, "{same}");
    folder.run(&["relight", "room.hplt", "-o", "three.hplt", "--from-scratch", "--threads", "3"]).ok();
    assert_eq!(folder.read("same.hplt"), folder.read("three.hplt"), "bits do not depend on threads");
    let proved = folder.run(&["relight", "room.hplt", "-o", "proved.hplt", "--set", "bulb=3", "--json"]).ok().json();
    assert!(proved["method"] == "solve" && proved["sweeps"] == 1, "few groups are solved unasked: {proved}");
}

#[test]
fn a_relit_solution_is_read_with_its_lights_direct_and_indirect() {
    let folder = Folder::new();
    solve(&folder, &["--keep-links"], "room.hplt");
    let before = from_solution(&folder, "room.hplt");
    let relit = |sets: &[&str]| {
        let flags: Vec<&str> = sets.iter().flat_map(|s| ["--set", s]).collect();
        folder.run(&[&["relight", "room.hplt", "-o", "new.hplt"], &flags[..]].concat()).ok();
        from_solution(&folder, "new.hplt")
    };
    // Twice the light is twice the light: of solver and of pictures.
    let twice = relit(&["light=2", "bulb=2", "desk lamp=2"]);
    let half: Vec<Vec<f64>> = twice.iter().map(|row| row.iter().map(|x| 0.5 * x).collect()).collect();
    assert!(difference(&half, &before) < 1e-4);
    // The bulb alone, whose light no choice of samples touches, against the scene that has nothing else; the rays are the same.
    let bulb = relit(&["light=0", "desk lamp=0", "bulb=1,2,0.5"]);
    let scaled = [&SCENE[..1], &["--point-light", "bulb=0.1,0.4,0.2:0.3,0.4,0.05"]].concat();
    let scaled = [&scaled[..], &["--rect-light", "0.45,0.2,0.1:0,0.1,0:0,0,0.1:0,0,0"]].concat();
    let direct = |rows: &[Vec<f64>]| rows.iter().map(|row| row[..3].to_vec()).collect::<Vec<_>>();
    let whole = light_at(&folder, &scaled, &[]);
    // The lamp under the ceiling is on in that scene: only the bulb's share of the direct light is known there.
    let without_bulb = relit(&["bulb=0", "desk lamp=0"]);
    let sum: Vec<Vec<f64>> =
        bulb.iter().zip(&without_bulb).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect()).collect();
    assert!(difference(&direct(&sum), &direct(&whole)) < 2e-2, "{:?} {:?}", direct(&sum), direct(&whole));
    assert!(difference(&sum, &whole) < 0.05, "{}", difference(&sum, &whole));
    // Negative control, and darkness.
    assert!(difference(&bulb, &before) > 0.1);
    let dark = relit(&["light=0", "desk lamp=0", "bulb=#000"]);
    assert!(dark.concat().iter().all(|x| *x == 0.0), "{dark:?}");
    // Colours.
    let red = relit(&["light=#f00", "desk lamp=1,0,0", "bulb=1,0,0"]);
    for (red, before) in red.iter().zip(&before) {
        assert!(red.iter().skip(1).step_by(3).chain(red.iter().skip(2).step_by(3)).all(|x| *x == 0.0));
        assert!((red[6] / before[6] - 1.0).abs() < 1e-4);
    }
}

#[test]
fn pictures_show_the_changed_lamp_itself() {
    let folder = Folder::new();
    let scene = ["gen:cornell"];
    folder.tiny(&[&["solve"][..], &scene, &["--keep-links", "-o", "room.hplt"]].concat()).ok();
    let change = ["relight", "room.hplt", "--set", "light=4", "--json", "--force", "-o", "bright.hplt"];
    let sweeps = |extra: &[&str]| folder.run(&[&change, extra].concat()).ok().json()["sweeps"].as_u64().unwrap();
    assert!(sweeps(&["--from-scratch"]) > 1);
    assert_eq!(sweeps(&[]), 1);
    let picture = |solution: &str, name: &str| {
        let args = [&["render"][..], &scene, &["--solution", solution, "--size", "24x16", "-o", name]].concat();
        folder.tiny(&args).ok();
    };
    picture("room.hplt", "a.exr");
    picture("bright.hplt", "b.exr");
    let report = folder.run(&["compare", "b.exr", "a.exr", "--json"]);
    let ratio = report.json();
    assert!(
        (ratio["figures"]["bias"].as_f64().unwrap() - 3.0).abs() < 1e-2,
        "four times as bright everywhere: {ratio}"
    );
}

#[test]
fn all_groups_need_no_links_and_are_a_sum() {
    let folder = Folder::new();
    solve(&folder, &["--keep-links", "--all-groups"], "both.hplt");
    let kept = solve(&folder, &["--all-groups"], "groups.hplt");
    assert_eq!(kept["kept"]["links_bytes"], 0);
    assert!(folder.read("groups.hplt").len() < folder.read("both.hplt").len());
    let change = ["--set", "light=0.25", "--set", "desk lamp=3", "--json"];
    let sum = folder.run(&[&["relight", "groups.hplt", "-o", "sum.hplt"], &change[..]].concat()).ok().json();
    let proved = folder.run(&[&["relight", "both.hplt", "-o", "proved.hplt"], &change[..]].concat()).ok().json();
    assert_eq!((sum["method"].as_str(), proved["method"].as_str()), (Some("sum"), Some("solve")));
    assert_eq!((sum["sweeps"].as_u64(), proved["sweeps"].as_u64()), (Some(0), Some(1)));
    let anew = [&["relight", "both.hplt", "-o", "solved.hplt", "--from-scratch"], &change[..]].concat();
    assert!(folder.run(&anew).ok().json()["sweeps"].as_u64() > Some(1));
    folder.run(&["relight", "groups.hplt", "-o", "a.hplt", "--from-scratch"]).fails(2, "USAGE");
    let solved = from_solution(&folder, "solved.hplt");
    for name in ["sum.hplt", "proved.hplt"] {
        assert!(difference(&from_solution(&folder, name), &solved) < 4e-5, "{name}");
    }
}

#[test]
fn wrong_changes_are_refused_with_the_names_that_there_are() {
    let folder = Folder::new();
    solve(&folder, &["--keep-links"], "room.hplt");
    let ran = folder.run(&["relight", "room.hplt", "--list"]).ok();
    assert_eq!(ran.stdout, "light\ndesk lamp\nbulb\n");
    let refused = |set: &[&str]| {
        let args = [&["relight", "room.hplt", "-o", "new.hplt"], set].concat();
        folder.run(&args).fails(2, "USAGE").stderr
    };
    let unknown = refused(&["--set", "lamp=0"]);
    assert!(["\"light\"", "\"desk lamp\"", "\"bulb\""].iter().all(|name| unknown.contains(name)), "{unknown}");
    for bad in ["bulb=-1", "bulb=nan", "bulb=inf", "bulb=1,2", "bulb", "bulb=#12"] {
        refused(&["--set", bad]);
    }
    refused(&["--set", "bulb=1", "--set", "bulb=2"]);
    refused(&["--threads", "0"]);
    folder.run(&["relight", "room.hplt", "--set", "bulb=1"]).fails(2, "USAGE");
    folder.run(&["relight", "room.hplt", "-o", "room.hplt", "--force"]).fails(8, "OUTPUT_REFUSED");
    folder.run(&["relight", "room.hplt", "--set", "bulb=3e38", "-o", "new.hplt"]).fails(10, "NOT_FINITE");
    assert_eq!(folder.names(), ["room.hplt"]);
    folder.run(&["relight", "room.hplt", "-o", "new.hplt"]).ok();
    folder.run(&["relight", "new.hplt", "-o", "newer.hplt"]).fails(9, "SOLUTION_MISMATCH");
    solve(&folder, &[], "plain.hplt");
    folder.run(&["relight", "plain.hplt", "-o", "newer.hplt"]).fails(9, "SOLUTION_NOT_KEPT");
    let delta = ["solve", "gen:cornell", "--variant", "delta", "--keep-links", "-o", "newer.hplt"];
    folder.tiny(&delta).fails(2, "USAGE");
    folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--solution", "new.hplt"]).fails(3, "FILE_UNREADABLE");
    folder.write("at.csv", AT);
    folder.tiny(&["points", "gen:cornell", "--at", "at.csv", "--solution", "new.hplt"]).fails(9, "SOLUTION_MISMATCH");
    // The same light under other names: factors would go to the wrong lamps.
    let renamed = SCENE.map(|flag| flag.strip_prefix("bulb=").unwrap_or(flag));
    let args = [&["points"][..], &renamed, &["--at", "at.csv", "--solution", "new.hplt"]].concat();
    folder.tiny(&args).fails(9, "SOLUTION_MISMATCH");
    let args = [&["points"][..], &renamed, &["--at", "at.csv", "--solution", "room.hplt"]].concat();
    folder.tiny(&args).ok();
}

fn floats<'f>(file: &'f mut SolutionFile, name: &str) -> &'f mut Vec<f32> {
    match &mut file.sections.iter_mut().find(|s| s.name == name).unwrap().data {
        SectionData::F32(data) => data,
        SectionData::U32(_) => panic!("{name} holds integers"),
    }
}

fn integers<'f>(file: &'f mut SolutionFile, name: &str) -> &'f mut Vec<u32> {
    match &mut file.sections.iter_mut().find(|s| s.name == name).unwrap().data {
        SectionData::U32(data) => data,
        SectionData::F32(_) => panic!("{name} holds floating point"),
    }
}

/// Puts a uniform barrier in place of that of the file, if it has one.
fn barrier(file: &mut SolutionFile, value: f32) -> &mut Vec<f32> {
    let n = floats(file, "group0.direct").len();
    file.sections.retain(|s| s.name != "links.barrier");
    let data = SectionData::F32(vec![value; n]);
    file.sections.push(Section { name: "links.barrier".into(), data });
    floats(file, "links.barrier")
}

fn text<'f>(file: &'f mut SolutionFile, key: &str) -> &'f mut String {
    &mut file.metadata.iter_mut().find(|(k, _)| k == key).unwrap().1
}

fn truncate_by_one<T>(data: &mut Vec<T>) {
    data.truncate(data.len() - 1);
}

type Damage = fn(&mut SolutionFile);

/// Files whose checksums are right and whose content is not, as somebody might make them who means harm.
#[test]
fn damaged_links_and_groups_are_refused() {
    let folder = Folder::new();
    solve(&folder, &["--keep-links", "--all-groups"], "room.hplt");
    let good = read_solution(&folder.path("room.hplt"), &Limits::default()).unwrap();
    let damages: &[(&str, Damage)] = &[
        ("a function that does not exist", |f| integers(f, "links.entries")[0] |= 0xffff),
        ("a function twice", |f| integers(f, "links.entries")[2] &= 0xffff_0000),
        ("one word less", |f| truncate_by_one(integers(f, "links.entries"))),
        ("one entry less", |f| integers(f, "links.entries").truncate(2)),
        ("no entries", |f| integers(f, "links.entries").clear()),
        ("other lengths", |f| integers(f, "links.lengths")[0] += 1),
        ("huge lengths", |f| integers(f, "links.lengths").fill(u32::MAX)),
        ("a row less", |f| truncate_by_one(integers(f, "links.lengths"))),
        ("a sum less", |f| truncate_by_one(integers(f, "links.sums"))),
        ("sums that are no numbers", |f| integers(f, "links.sums").fill(u32::MAX)),
        ("negative sums", |f| integers(f, "links.sums")[1] |= 1 << 31),
        ("sums of more than all light", |f| integers(f, "links.sums")[1] = 0x4000_0000),
        ("entries of another kind", |f| {
            let section = f.sections.iter_mut().find(|s| s.name == "links.entries").unwrap();
            section.data = SectionData::F32(vec![0.0; 2]);
        }),
        ("no sums", |f| f.sections.retain(|s| s.name != "links.sums")),
        ("a barrier of other length", |f| barrier(f, 1.0).truncate(3)),
        ("a barrier that is no number", |f| barrier(f, 1.0)[4] = f32::NAN),
        ("an infinite barrier", |f| barrier(f, f32::INFINITY).truncate(usize::MAX)),
        ("a negative barrier", |f| barrier(f, 1.0)[0] = -1.0),
        ("light that is no number", |f| floats(f, "group1.direct")[3] = f32::NAN),
        ("infinite light", |f| floats(f, "group0.first_bounce")[3] = f32::INFINITY),
        ("negative light", |f| floats(f, "group2.first_bounce")[0] = -1.0),
        ("a solution of other length", |f| truncate_by_one(floats(f, "group2.indirect"))),
        ("an error of other length", |f| floats(f, "group2.error").push(0.0)),
        ("an error that is no number", |f| floats(f, "group0.error")[0] = f32::NAN),
        ("a group without light", |f| f.sections.retain(|s| s.name != "group1.direct")),
        ("a group without a name", |f| f.metadata.retain(|(k, _)| k != "hplt.light_group1")),
        ("more groups", |f| *text(f, "hplt.light_groups") = "4".into()),
        ("many groups", |f| *text(f, "hplt.light_groups") = "18446744073709551615".into()),
        ("a tolerance that is no number", |f| *text(f, "hplt.solve_tolerance") = "nan".into()),
        ("another version", |f| *text(f, "hplt.version") = "0.0.0".into()),
        ("regions that do not exist", |f| integers(f, "level0.region")[0] = 7),
    ];
    for (what, damage) in damages {
        let mut file = good.clone();
        damage(&mut file);
        write_solution(&folder.path("bad.hplt"), &file).unwrap();
        let ran = folder.run(&["relight", "bad.hplt", "-o", "new.hplt"]);
        assert_eq!(ran.code, Some(9), "{what}: {ran:?}");
        assert!(ran.stderr.starts_with("error[SOLUTION_") && ran.stderr.lines().count() == 1, "{what}: {ran:?}");
    }
    assert_eq!(folder.names(), ["bad.hplt", "room.hplt"]);
    let bytes = folder.read("room.hplt");
    for n in [0, 19, bytes.len() / 2, bytes.len() - 1] {
        folder.write("bad.hplt", &bytes[..n]);
        folder.run(&["relight", "bad.hplt", "-o", "new.hplt"]).fails(9, "SOLUTION_TRUNCATED");
    }
    for at in [200, bytes.len() / 2, bytes.len() - 2000] {
        let mut flipped = bytes.clone();
        flipped[at] ^= 4;
        folder.write("bad.hplt", &flipped);
        assert_eq!(folder.run(&["relight", "bad.hplt", "-o", "new.hplt"]).code, Some(9), "{at}");
    }
    let mut harmless = good;
    write_solution(&folder.path("bad.hplt"), &harmless).unwrap();
    folder.run(&["relight", "bad.hplt", "-o", "new.hplt"]).ok();
    for wrong in [0.0, 1e-30, 2.0, f32::MAX] {
        barrier(&mut harmless, wrong);
        write_solution(&folder.path("bad.hplt"), &harmless).unwrap();
        folder.run(&["relight", "bad.hplt", "-o", "new.hplt", "--force"]).ok();
    }
}

#[test]
fn damaged_factors_are_refused_where_a_relit_solution_is_read() {
    let folder = Folder::new();
    folder.write("at.csv", AT);
    solve(&folder, &["--all-groups"], "room.hplt");
    folder.run(&["relight", "room.hplt", "--set", "bulb=2", "-o", "new.hplt"]).ok();
    let good = read_solution(&folder.path("new.hplt"), &Limits::default()).unwrap();
    let read = |name: &str| {
        let args = [&["points"][..], &SCENE, &["--at", "at.csv", "--solution", name]].concat();
        folder.tiny(&args)
    };
    for bad in ["-1,1,1", "nan,1,1", "1,inf,1", "1,1", "1,1,1,1", "", "x"] {
        let mut file = good.clone();
        *text(&mut file, "hplt.light_factor1") = bad.into();
        write_solution(&folder.path("bad.hplt"), &file).unwrap();
        read("bad.hplt").fails(9, "SOLUTION_MISMATCH");
    }
    let mut file = good;
    file.metadata.retain(|(key, _)| key != "hplt.light_factor2");
    write_solution(&folder.path("bad.hplt"), &file).unwrap();
    read("bad.hplt").fails(9, "SOLUTION_MISMATCH");
    read("new.hplt").ok();
}

#[test]
fn info_lists_the_groups_with_their_power() {
    let folder = Folder::new();
    let ran = folder.run(&[&["info"][..], &SCENE].concat()).ok();
    assert!(ran.stdout.contains("light group \"desk lamp\": 2 triangles, 0.0100 m2"), "{}", ran.stdout);
    let report = folder.run(&[&["info"][..], &SCENE, &["--json"]].concat()).ok().json();
    let power = report["more"]["light_groups"][2]["power"][0].as_f64().unwrap();
    assert!((power - 4.0 * std::f64::consts::PI * 0.3).abs() < 1e-5, "{power}");
}
