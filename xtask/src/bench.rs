//! Error and run time on the standard scenes.

use anyhow::Result;

/// What to measure.
#[derive(clap::Args)]
pub struct Options {
    /// Fewer points and a looser reference: under three minutes on two cores.
    #[arg(long)]
    quick: bool,
}

/// Runs the benchmark and prints the table.
pub fn run(options: &Options) -> Result<()> {
    let _ = options.quick;
    Ok(())
}
