//! What all commands that light a scene do around their own work.

use serde_json::{Value, json};

use crate::args::Common;
use crate::estimate::{Estimate, available_threads};
use crate::exit::{Exit, Failure};
use crate::job::Run;
use crate::outputs::to_stdout;
use crate::progress::{Reporter, listen_for_signals, say};
use crate::sections::{ProgressMode, RenderSection};
use crate::settings::Settings;
use crate::values::{human_bytes, human_count};

/// How a command ended, and its report for `--json`.
pub struct Ended {
    /// The exit code.
    pub exit: Exit,
    /// The JSON document.
    pub report: Value,
}

impl Ended {
    /// A good end.
    pub fn ok(report: Value) -> Self {
        Self { exit: Exit::Ok, report }
    }
}

/// Resolves the settings, runs `work` on its own threads, says the summary, and finds the exit code.
///
/// # Errors
/// Those of the settings and of `work`.
pub fn session(
    command: &'static str,
    (common, render): (&Common, &RenderSection),
    scene: &str,
    work: impl FnOnce(&mut Run<'_>) -> Result<(), Failure> + Send,
) -> Result<Ended, Failure> {
    let settings = Settings::resolve(common, render)?;
    if common.print_config {
        return print_config(&settings, common.output.json);
    }
    listen_for_signals();
    let mode = settings.config.run.progress.unwrap_or(ProgressMode::Auto);
    let reporter = Reporter::start(mode, common.output.quiet, settings.config.run.max_time);
    let threads = settings.config.run.threads.unwrap_or_else(available_threads);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|e| Failure::new(Exit::Memory, "THREADS", format!("{threads} threads cannot be started: {e}")))?;
    let mut run = Run::new(command, &settings, &reporter);
    if common.dry_run {
        return dry_run(&mut run, scene, common.output.quiet);
    }
    let result = pool.install(|| work(&mut run));
    reporter.finish();
    result.map_err(|failure| reporter.why_stopped(failure))?;
    if !common.output.quiet && command != "info" {
        run.report.print(common.output.verbose);
    }
    let exit = match (run.report.converged, run.report.stop) {
        (_, "interrupted") => Exit::Interrupted,
        (true, _) => Exit::Ok,
        (false, _) => Exit::NotConverged,
    };
    Ok(Ended { exit, report: serde_json::to_value(&run.report).unwrap_or_default() })
}

impl Run<'_> {
    /// Refuses to go on to write when only converged results may be written and this one is not.
    ///
    /// # Errors
    /// When the settings are strict and the result is not converged.
    pub fn check_strict(&self) -> Result<(), Failure> {
        if !self.settings.strict || self.report.converged {
            return Ok(());
        }
        let exit = if self.report.stop == "interrupted" { Exit::Interrupted } else { Exit::NotConverged };
        let message =
            format!("{}: not converged ({}); --strict: nothing was written", self.report.scene, self.report.stop);
        Err(Failure::new(exit, "NOT_CONVERGED", message))
    }

    /// What files say about how they were made. Neither times nor threads, so that the same job gives the same bytes.
    pub fn metadata(&self) -> Vec<(String, String)> {
        let mut config = self.settings.config.clone();
        config.run = crate::sections::RunSection::default();
        let report = &self.report;
        let mut out = vec![
            ("hplt.version".to_owned(), report.version.to_owned()),
            ("hplt.command".to_owned(), report.command.to_owned()),
            ("hplt.scene".to_owned(), report.scene.clone()),
            ("hplt.scene_hash".to_owned(), report.scene_hash.clone()),
            ("hplt.seed".to_owned(), self.settings.transport.seed.to_string()),
            ("hplt.job".to_owned(), serde_json::to_string(&config).unwrap_or_default()),
            ("hplt.unit".to_owned(), "radiance W/(m2 sr), irradiance W/m2".to_owned()),
            ("hplt.converged".to_owned(), report.converged.to_string()),
            ("hplt.stop".to_owned(), report.stop.to_owned()),
        ];
        if let Some(bound) = report.truncation_bound {
            out.push(("hplt.truncation_bound".into(), bound.to_string()));
        }
        if let Some(error) = report.error {
            out.push(("hplt.error_mean".into(), error.mean.to_string()));
            out.push(("hplt.error_bound".into(), error.bound.to_string()));
            out.push(("hplt.error_p95".into(), error.p95.to_string()));
        }
        out
    }

    /// Notes that work after the solve was cut short.
    pub fn cut_short(&mut self) {
        let by_time = self.reporter.stop() == Some(crate::progress::Stop::TimeLimit);
        self.report.stop = if by_time { "time-limit" } else { "interrupted" };
        self.report.converged = false;
        self.report.warnings.push("stopped early: what is written is read from the solution as it is, coarsely".into());
    }
}

fn print_config(settings: &Settings, as_json: bool) -> Result<Ended, Failure> {
    if !as_json {
        to_stdout(|out| out.write_all(settings.with_origins.as_bytes()))?;
    }
    Ok(Ended::ok(serde_json::to_value(&settings.config).unwrap_or_default()))
}

/// Loads the scene and says what lighting it would take. Writes nothing.
fn dry_run(run: &mut Run<'_>, scene: &str, is_quiet: bool) -> Result<Ended, Failure> {
    let loaded = run.load(scene)?;
    let Some(scene) = &loaded.scene else {
        return Ok(Ended::ok(json!({ "command": run.report.command, "scene": loaded.name, "estimate": null })));
    };
    let estimate = Estimate::of(scene, run.settings);
    if !is_quiet {
        print_estimate(&estimate);
    }
    run.check_memory(scene)?;
    Ok(Ended::ok(json!({
        "command": run.report.command, "version": run.report.version, "scene": loaded.name, "dry_run": true,
        "triangles": scene.mesh().n_triangles(), "estimate": estimate, "settings": run.settings.config,
    })))
}

/// Says what was estimated.
pub fn print_estimate(estimate: &Estimate) {
    let counts: Vec<String> = estimate.points_per_level.iter().map(|&n| human_count(n)).collect();
    say(&format!("estimate  at most {} points ({})", human_count(estimate.points()), counts.join(", ")));
    say(&format!("          {} ({})", human_bytes(estimate.memory), estimate.parts_in_words()));
    let seconds = estimate.seconds;
    say(&format!("          about {:.0} to {:.0} s, rays being the least certain part", seconds / 3.0, 3.0 * seconds));
}
