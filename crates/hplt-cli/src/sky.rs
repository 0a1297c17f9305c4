//! Says how well the sky is found where openings are small.

use hplt_geom::{RayCaster, Scene};
use hplt_transport::{SkyView, sky_view};
use serde_json::json;

use crate::exit::Failure;
use crate::job::Run;
use crate::values::human_percent;

impl Run<'_> {
    /// Enters what enclosed surface sees of the sky, and warns where that is hard to find.
    ///
    /// # Errors
    /// When stopped.
    pub fn look_for_sky(&mut self, scene: &Scene, caster: &dyn RayCaster) -> Result<(), Failure> {
        let (seed, reporter) = (self.settings.transport.seed, self.reporter);
        let Some(view) = sky_view(scene, caster, seed, reporter)? else { return Ok(()) };
        if view.rays > 0 {
            let row = json!({
                "enclosed_share": view.enclosed_share, "rays": view.rays, "seen": view.seen,
                "seen_share": view.seen_share(), "standard_error": view.standard_error,
                "most_seen_share": view.most_seen_share(),
            });
            self.report.more.insert("sky".into(), row);
        }
        self.report.warnings.extend(view.is_under_sampled().then(|| warning(&view)));
        Ok(())
    }
}

fn warning(view: &SkyView) -> String {
    format!(
        "portal under-sampled: {} of the surface sees the sky in {} of its directions, and {} rays found it {} times; light from there is noisy",
        human_percent(view.enclosed_share),
        human_percent(view.seen_share()),
        view.rays,
        view.seen
    )
}
