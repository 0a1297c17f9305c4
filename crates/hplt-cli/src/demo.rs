//! `hplt` without a command.

use clap::Parser;

use crate::args::{Cli, Command};
use crate::exit::{Exit, Failure};
use crate::progress::say;
use crate::render;
use crate::session::Ended;

const FOLDER: &str = "out";

/// Lights the Cornell box and writes a PNG and an EXR into a folder below the current one.
///
/// # Errors
/// With what stopped it.
pub fn run() -> Result<Ended, Failure> {
    std::fs::create_dir_all(FOLDER)
        .map_err(|e| Failure::new(Exit::Output, "OUTPUT_IO", format!("{FOLDER}: cannot be made: {e}")))?;
    let png = format!("{FOLDER}/cornell.png");
    let exr = format!("{FOLDER}/cornell.exr");
    let words = ["hplt", "render", "gen:cornell", "-o", &png, "-o", &exr];
    say(&format!("{}\n", words.join(" ")));
    let cli = Cli::try_parse_from(words).map_err(|e| Failure::new(Exit::Bug, "DEMO", e.to_string()))?;
    let Some(Command::Render(args)) = &cli.command else {
        return Err(Failure::new(Exit::Bug, "DEMO", "not a render"));
    };
    let ended = render::run(args)?;
    say(&format!("\nLook at {png} (or {exr}, with all layers). What else there is: hplt --help"));
    Ok(ended)
}
