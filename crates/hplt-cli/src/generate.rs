//! `hplt gen`

use hplt_geom::BuildPolicy;
use hplt_io::{LoadOptions, LoadReport, Loaded, write_glb};
use serde_json::json;

use crate::args::GenArgs;
use crate::builtin::{BUILTINS, build};
use crate::exit::Failure;
use crate::load::{build_failure, made};
use crate::outputs::{check_outputs, extension, to_stdout};
use crate::progress::say;
use crate::session::Ended;
use crate::values::human_count;

/// Writes a built-in scene, or lists them.
///
/// # Errors
/// When there is no such scene, a file that it is made of cannot be used, or its own cannot be written.
pub fn run(args: &GenArgs) -> Result<Ended, Failure> {
    if args.list {
        return list(args);
    }
    let (Some(name), Some(output)) = (&args.name, &args.output) else {
        return Err(Failure::usage("a name and --output; expected both, or --list"));
    };
    let shown = hplt_io::sanitized(&output.to_string_lossy());
    if extension(output) != "glb" {
        return Err(Failure::usage(format!("{shown}: unknown kind of scene file; expected .glb")));
    }
    check_outputs(&[output], &[], args.output_flags.force)?;
    let Loaded { scene, report } = match args.triangles {
        Some(_) => Loaded { scene: build(name, args.triangles)?, report: LoadReport::default() },
        None => made(name, &LoadOptions::default())?,
    };
    let (scene, _) = scene.build(BuildPolicy::default()).map_err(|e| build_failure(&hplt_io::sanitized(name), e))?;
    let warnings = [report.warnings, write_glb(output, &scene)?].concat();
    if !args.output_flags.quiet {
        warnings.iter().for_each(|line| say(&format!("warning: {line}")));
        say(&format!("wrote     {shown}: {} triangles", human_count(scene.mesh().n_triangles() as u64)));
    }
    Ok(Ended::ok(json!({
        "command": "gen", "name": name, "triangles": scene.mesh().n_triangles(), "warnings": warnings, "outputs": [shown],
    })))
}

fn list(args: &GenArgs) -> Result<Ended, Failure> {
    if !args.output_flags.json {
        to_stdout(|out| {
            BUILTINS.iter().try_for_each(|b| {
                let count =
                    b.triangles.map_or(String::new(), |n| format!(" [about {} triangles]", human_count(n as u64)));
                writeln!(out, "{:<16}{}{count}", b.name, b.about)
            })
        })?;
    }
    let scenes: Vec<_> =
        BUILTINS.iter().map(|b| json!({ "name": b.name, "about": b.about, "triangles": b.triangles })).collect();
    Ok(Ended::ok(json!({ "command": "gen", "scenes": scenes })))
}
