//! The command `hplt`: see `hplt --help`.
#![forbid(unsafe_code)]

mod args;
mod budget;
mod builtin;
mod camera;
mod compare;
mod config;
mod demo;
mod estimate;
mod exit;
mod field;
mod generate;
mod indirect;
mod info;
mod job;
mod kept;
mod leaks;
mod light_table;
mod lights;
mod load;
mod outputs;
mod picture;
mod points;
mod progress;
mod reference;
mod relight;
mod render;
mod report;
mod sample_points;
mod scene_hash;
mod sections;
mod session;
mod settings;
mod shading;
mod sky;
mod snap;
mod solution;
mod solve;
mod values;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;
use std::sync::Mutex;

use clap::Parser;
use serde_json::json;

use args::{Cli, Command};
use exit::{Exit, Failure};
use progress::say;
use session::Ended;

/// What the last panic said and where.
static PANIC: Mutex<String> = Mutex::new(String::new());

fn main() -> ExitCode {
    std::panic::set_hook(Box::new(remember));
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let as_json = cli.command.as_ref().is_some_and(|c| c.output().json);
    // The pool that a command makes for itself forwards panics of its workers to here.
    let result = catch_unwind(AssertUnwindSafe(|| run(&cli))).unwrap_or_else(|_| Err(bug()));
    let (exit, document) = match result {
        Ok(Ended { exit, report }) => (exit, report),
        Err(failure) => {
            say(&failure.to_string());
            (failure.exit, document(&failure))
        }
    };
    if as_json && let Err(failure) = outputs::to_stdout(|out| writeln!(out, "{document:#}")) {
        say(&failure.to_string());
        return failure.exit.into();
    }
    exit.into()
}

/// A failure as the JSON document of a run.
fn document(failure: &Failure) -> serde_json::Value {
    json!({ "error": { "code": failure.code, "exit": failure.exit as u8, "message": failure.message } })
}

fn run(cli: &Cli) -> Result<Ended, Failure> {
    match &cli.command {
        None => demo::run(),
        Some(Command::Render(args)) => render::run(args),
        Some(Command::Solve(args)) => solve::run(args),
        Some(Command::Relight(args)) => relight::run(args),
        Some(Command::Points(args)) => points::run(args),
        Some(Command::SamplePoints(args)) => sample_points::run(args),
        Some(Command::Reference(args)) => reference::run(args),
        Some(Command::Compare(args)) => compare::run(args),
        Some(Command::Info(args)) => info::run(args),
        Some(Command::Gen(args)) => generate::run(args),
    }
}

/// Help goes to stdout; what is wrong with the flags becomes one line.
fn usage(error: &clap::Error) -> ExitCode {
    if !error.use_stderr() {
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    let text = error.render().to_string();
    let wanted = |line: &&str| !line.is_empty() && !line.starts_with("Usage") && !line.starts_with("For more");
    let lines: Vec<&str> = text.lines().map(str::trim).filter(wanted).collect();
    let message = lines.join("; ");
    let message = message.strip_prefix("error: ").unwrap_or(&message);
    let failure = Failure::usage(format!("{message}; see hplt --help"));
    say(&failure.to_string());
    if std::env::args_os().any(|a| a == "--json") {
        // The exit code already says that something is wrong.
        let _ = outputs::to_stdout(|out| writeln!(out, "{:#}", document(&failure)));
    }
    Exit::Usage.into()
}

/// Keeps what a panic says instead of printing it: readers turn some panics into errors of their own.
fn remember(info: &std::panic::PanicHookInfo<'_>) {
    if let Ok(mut text) = PANIC.lock() {
        *text = info.to_string();
    }
}

fn bug() -> Failure {
    let text = PANIC.lock().map(|t| t.clone()).unwrap_or_default();
    Failure::new(Exit::Bug, "BUG", format!("internal error (please report): {text}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_a_bug_with_one_line_that_asks_for_a_report() {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(remember));
        let result = catch_unwind(|| panic!("two\nlines"));
        std::panic::set_hook(before);
        assert!(result.is_err());
        let failure = bug();
        let line = failure.to_string();
        assert!(failure.exit == Exit::Bug && line.contains("please report") && line.contains("two lines"), "{line}");
        assert_eq!(line.lines().count(), 1);
    }
}
