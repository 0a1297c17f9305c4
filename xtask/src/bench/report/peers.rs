//! Other renderers at the same points: Mitsuba 3 and Radiance, where their Python wheels are installed.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use serde_json::Value;

use super::super::child::finish;
use super::super::curves::Curve;
use super::super::entry::{Entry, Errors};
use super::super::measure::{Bench, compare, shown, strings};
use super::super::scenes::Source;
use super::super::truth::Truth;
use crate::shell::{output, root};

/// A renderer whose sum is further off at its largest budget lights another scene, or is used wrongly: no time of it is believed.
const MOST_BIAS: f64 = 0.02;
/// Mitsuba's just-in-time compiler needs a library that its wheel does not bring.
const LLVM_VARIABLE: &str = "DRJIT_LIBLLVM_PATH";

struct Peer {
    id: &'static str,
    /// Paths per point, or ambient divisions.
    budgets: &'static [u32],
    unit: &'static str,
}

const PEERS: [Peer; 2] = [
    Peer { id: "mitsuba", budgets: &[16, 64, 256, 1024, 4096], unit: "paths" },
    Peer { id: "radiance", budgets: &[128, 256, 512, 1024, 2048], unit: "ambient divisions" },
];

/// The interpreter that has their wheels.
#[derive(Debug, Clone)]
pub struct Peers {
    python: PathBuf,
}

/// What a peer's run came to.
#[derive(Debug, PartialEq)]
enum Outcome {
    Done {
        version: String,
        seconds: f64,
        processor_seconds: f64,
    },
    Late,
    /// Not installed, or the scene cannot be handed over.
    Not(String),
}

impl Peers {
    /// Those that this interpreter finds.
    pub fn of(python: &Path) -> Self {
        Self { python: python.to_owned() }
    }

    /// A curve for each peer that is there and agrees with the reference, and a sentence for each that is not or does not.
    ///
    /// # Errors
    /// When a table cannot be compared.
    pub fn curves(&self, bench: &Bench<'_>, source: &Source, truth: &Truth) -> Result<(Vec<Curve>, Vec<String>)> {
        let (mut curves, mut remarks) = (Vec::new(), Vec::new());
        match exported(bench, source) {
            Ok(scene) => {
                for peer in &PEERS {
                    match self.curve(bench, peer, source, &scene, truth)? {
                        Ok(curve) => curves.push(curve),
                        Err(why) => remarks.push(format!("Left out: {}, {why}.", peer.id)),
                    }
                }
            }
            Err(why) => remarks.push(format!("No peers: {} cannot be handed over ({why:#}).", source.title)),
        }
        Ok((curves, remarks))
    }

    fn curve(
        &self,
        bench: &Bench<'_>,
        peer: &Peer,
        source: &Source,
        scene: &Path,
        truth: &Truth,
    ) -> Result<Result<Curve, String>> {
        let mut curve = Curve::empty(peer.id, &[]);
        curve.command = format!("peers.py --peer {} --scene {}", peer.id, shown(scene));
        let budgets = if bench.effort.is_quick { &peer.budgets[..2] } else { peer.budgets };
        for n in budgets {
            let shown_budget = format!("{n} {}", peer.unit);
            if !curve.left_out.is_empty() {
                curve.left_out.push(shown_budget);
                continue;
            }
            let out = bench.folder.join(format!("{}-peer.csv", source.id));
            let outcome = match self.ask(bench, peer, (scene, truth), &out, *n) {
                Ok(outcome) => outcome,
                Err(problem) => return Ok(Err(format!("it failed: {}", last_line(&format!("{problem:#}"))))),
            };
            match outcome {
                Outcome::Done { version, seconds, processor_seconds } => {
                    let (all, lit) = compare(bench.hplt, &out, truth)?;
                    let errors =
                        Errors { mean: all.mean, median: all.median, p95: all.p95, lit_mean: lit.mean, bias: all.bias };
                    curve.title = version;
                    curve.points.push(Entry {
                        budget: shown_budget,
                        value: None,
                        seconds,
                        processor_seconds: Some(processor_seconds),
                        runs: 1,
                        errors: Some(errors),
                        functions: None,
                        rays: None,
                        sweeps: None,
                        // That of the interpreter says nothing.
                        peak_memory: None,
                    });
                }
                Outcome::Late => curve.left_out.push(shown_budget),
                Outcome::Not(why) => return Ok(Err(why)),
            }
        }
        Ok(agreement(&curve).map(|()| curve))
    }

    fn ask(
        &self,
        bench: &Bench<'_>,
        peer: &Peer,
        (scene, truth): (&Path, &Truth),
        out: &Path,
        budget: u32,
    ) -> Result<Outcome> {
        let mut command = Command::new(&self.python);
        command.arg(root().join("benches").join("peers").join("peers.py")).args(["--peer", peer.id, "--scene"]);
        command.arg(scene).arg("--points").arg(&truth.points).arg("--out").arg(out);
        command.args(["--budget", &budget.to_string(), "--limit", &bench.effort.limit_seconds.to_string()]);
        if let Some(library) = llvm() {
            command.env(LLVM_VARIABLE, library);
        }
        Outcome::parse(&finish(command, None)?.document)
    }
}

impl Outcome {
    fn parse(document: &Value) -> Result<Self> {
        if let Some(why) = ["absent", "refused"].iter().find_map(|key| document[*key].as_str()) {
            return Ok(Self::Not(why.into()));
        }
        if !document["late"].is_null() {
            return Ok(Self::Late);
        }
        let seconds =
            |name: &str| document[name].as_f64().filter(|s| s.is_finite()).with_context(|| format!("no {name}"));
        Ok(Self::Done {
            version: document["version"].as_str().context("no version")?.into(),
            seconds: seconds("seconds")?,
            processor_seconds: seconds("processor_seconds")?,
        })
    }
}

/// Whether a peer lights the same scene: its sum is right at the end, and its error falls with its budget.
fn agreement(curve: &Curve) -> Result<(), String> {
    let errors: Vec<&Errors> = curve.points.iter().filter_map(|entry| entry.errors.as_ref()).collect();
    let [first, .., last] = errors[..] else {
        return Err("fewer than two budgets were done within the time limit".into());
    };
    if last.bias.abs() > MOST_BIAS {
        return Err(format!("it does not agree with the reference: its sum is off by {:+.2} %", 100.0 * last.bias));
    }
    if last.median >= first.median {
        return Err("its error does not fall with its budget".into());
    }
    Ok(())
}

/// The scene as a binary glTF file.
fn exported(bench: &Bench<'_>, source: &Source) -> Result<PathBuf> {
    let Some(name) = source.argument.strip_prefix("gen:") else { return Ok(PathBuf::from(&source.argument)) };
    let file = bench.folder.join(format!("{}-peer.glb", source.id));
    let command = strings(&["gen", name, "--force", "--output", &shown(&file)]);
    bench.hplt.ask_briefly(&command).context("hplt gen does not write it")?;
    Ok(file)
}

/// The compiler's own LLVM, unless another was chosen: old ones fail on the kernels of Mitsuba 3.9.
fn llvm() -> Option<PathBuf> {
    if std::env::var_os(LLVM_VARIABLE).is_some() {
        return None;
    }
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"])).ok()?;
    let files = std::fs::read_dir(Path::new(sysroot.trim()).join("lib")).ok()?;
    let mut found: Vec<PathBuf> =
        files.filter_map(|file| Some(file.ok()?.path())).filter(|path| is_llvm(path)).collect();
    found.sort();
    found.pop()
}

fn is_llvm(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Beside the library lies a linker script of a similar name.
    name.starts_with("libLLVM.so.")
}

fn last_line(text: &str) -> &str {
    text.trim().lines().next_back().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::super::super::entry::tests::entry;
    use super::*;

    #[test]
    fn every_outcome_is_told_from_the_others() {
        let parse = |document| Outcome::parse(&document);
        assert_eq!(parse(json!({ "absent": "no module" })).unwrap(), Outcome::Not("no module".into()));
        assert_eq!(parse(json!({ "refused": "a texture" })).unwrap(), Outcome::Not("a texture".into()));
        assert_eq!(parse(json!({ "late": 35.0 })).unwrap(), Outcome::Late);
        let done = parse(json!({ "version": "R 6", "seconds": 1.5, "processor_seconds": 3.0 })).unwrap();
        assert_eq!(done, Outcome::Done { version: "R 6".into(), seconds: 1.5, processor_seconds: 3.0 });
        assert!(parse(json!({ "version": "R 6" })).is_err() && parse(json!({})).is_err());
    }

    #[test]
    fn a_peer_that_lights_another_scene_is_not_believed() {
        let with = |mean, bias| {
            let mut entry = entry(1.0, mean);
            entry.errors.as_mut().unwrap().bias = bias;
            entry
        };
        let curve = |points| Curve { points, ..Curve::empty("peer", &[]) };
        assert!(agreement(&curve(vec![with(0.1, 0.05), with(0.02, 0.01)])).is_ok());
        assert!(agreement(&curve(vec![with(0.1, 0.05), with(0.02, -0.03)])).unwrap_err().contains("-3.00 %"));
        assert!(agreement(&curve(vec![with(0.1, 0.0), with(0.1, 0.0)])).unwrap_err().contains("does not fall"));
        assert!(agreement(&curve(vec![with(0.1, 0.0)])).is_err() && agreement(&curve(vec![])).is_err());
    }

    #[test]
    fn libraries_are_told_from_scripts() {
        assert!(is_llvm(Path::new("/lib/libLLVM.so.22.1-rust-1.95.0-stable")));
        assert!(!is_llvm(Path::new("/lib/libLLVM-22-rust-1.95.0-stable.so")) && !is_llvm(Path::new("/lib/libstd.so")));
    }

    #[test]
    fn the_last_line_says_why() {
        assert_eq!((last_line("a\nb\n"), last_line("")), ("b", ""));
    }
}
