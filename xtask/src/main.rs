//! Automation: `cargo xtask test`, `cargo xtask ci`, `cargo xtask bench`.
#![forbid(unsafe_code)]

mod bench;
mod ci;
mod shell;

use clap::{Parser, Subcommand};

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Tests, the full gate, and the benchmark tables of hplt")]
struct Args {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Run all tests.
    Test {
        /// Run the slow ones (`#[ignore]`), optimised as a release is, and nothing else.
        #[arg(long)]
        slow: bool,
    },
    /// The full gate: format, lints, feature matrix, docs, tests.
    Ci {
        /// Leave the tests out, where they have just run.
        #[arg(long)]
        skip_tests: bool,
    },
    /// Measure error and run time on the standard scenes and print them as a table.
    Bench(Box<bench::Options>),
}

fn main() -> anyhow::Result<()> {
    match Args::parse().task {
        Task::Test { slow: false } => ci::test(),
        Task::Test { slow: true } => ci::slow_tests(),
        Task::Ci { skip_tests } => ci::gate(skip_tests),
        Task::Bench(options) => bench::run(&options),
    }
}
