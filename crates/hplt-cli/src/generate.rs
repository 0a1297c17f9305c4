//! `hplt gen`

use hplt_geom::BuildPolicy;
use hplt_io::write_glb;
use serde_json::json;

use crate::args::GenArgs;
use crate::builtin::{BUILTINS, build};
use crate::exit::{Exit, Failure};
use crate::outputs::{check_outputs, extension, to_stdout};
use crate::progress::say;
use crate::session::Ended;
use crate::values::human_count;

/// Writes a procedural scene, or lists them.
///
/// # Errors
/// When there is no such scene, or the file cannot be written.
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
    let (scene, _) = build(name, args.triangles)?
        .build(BuildPolicy::default())
        .map_err(|e| Failure::new(Exit::Bug, "GEN", format!("{name}: {e}")))?;
    let left_out = write_glb(output, &scene)?;
    if !args.output_flags.quiet {
        left_out.iter().for_each(|line| say(&format!("warning: {line}")));
        say(&format!("wrote     {shown}: {} triangles", human_count(scene.mesh().n_triangles() as u64)));
    }
    Ok(Ended::ok(json!({
        "command": "gen", "name": name, "triangles": scene.mesh().n_triangles(), "warnings": left_out, "outputs": [shown],
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
