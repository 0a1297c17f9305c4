//! The tests and the full gate.

use anyhow::{Context, Result};

use crate::shell::{answers, cargo, output, root, run};

/// Environment variable that names a file; tests append a line to it for every big scene that they miss.
const SKIP_LOG: &str = "HPLT_SKIP_LOG";

/// Runs all tests and counts those that were skipped for want of a scene.
pub fn test() -> Result<()> {
    let log = root().join("target").join("skipped-tests.txt");
    std::fs::create_dir_all(root().join("target"))?;
    std::fs::write(&log, "").with_context(|| format!("cannot write {}", log.display()))?;
    if answers(&mut cargo(&["nextest", "--version"])) {
        run(cargo(&["nextest", "run", "--workspace"]).env(SKIP_LOG, &log))?;
        run(&mut cargo(&["test", "--workspace", "--doc"]))?;
    } else {
        run(cargo(&["test", "--workspace"]).env(SKIP_LOG, &log))?;
    }
    let skipped = std::fs::read_to_string(&log).unwrap_or_default();
    let mut scenes: Vec<&str> = skipped.lines().collect();
    scenes.sort_unstable();
    println!("{} checks skipped for want of a scene file", scenes.len());
    scenes.dedup();
    scenes.iter().for_each(|scene| println!("  missing: {scene}"));
    Ok(())
}

/// Runs the tests that are marked as slow, in the build of the others, one at a time: some take gigabytes.
pub fn slow_tests() -> Result<()> {
    run(&mut cargo(&[
        "test",
        "--no-fail-fast",
        "--workspace",
        "--lib",
        "--tests",
        "--",
        "--ignored",
        "--nocapture",
        "--test-threads",
        "1",
    ]))
}

/// Format, lints, feature matrix, docs, tests.
pub fn gate(skip_tests: bool) -> Result<()> {
    run(&mut cargo(&["fmt", "--all", "--check"]))?;
    run(&mut cargo(&["clippy", "--workspace", "--all-targets", "--", "-D", "warnings"]))?;
    feature_matrix()?;
    run(cargo(&["doc", "--workspace", "--no-deps"]).env("RUSTDOCFLAGS", "-D warnings"))?;
    if !skip_tests {
        test()?;
    }
    Ok(())
}

/// Every library crate alone: without features, and with each feature alone.
fn feature_matrix() -> Result<()> {
    let text = output(&mut cargo(&["metadata", "--no-deps", "--format-version", "1"]))?;
    let metadata: serde_json::Value = serde_json::from_str(&text)?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    for package in packages {
        let name = package["name"].as_str().context("a package without a name")?;
        let Some(features) = package["features"].as_object().filter(|f| !f.is_empty()) else { continue };
        let without = ["clippy", "--quiet", "--package", name, "--no-default-features"];
        let deny = ["--", "-D", "warnings"];
        run(cargo(&without).args(deny))?;
        for feature in features.keys().filter(|f| *f != "default") {
            run(cargo(&without).args(["--features", feature]).args(deny))?;
        }
    }
    Ok(())
}
