//! Says how much light is lost through cracks between surfaces that should meet.

use hplt_transport::{Leak, leaks};
use serde_json::json;

use crate::exit::Failure;
use crate::job::{Lit, Run};
use crate::values::human_percent;

/// Rays that look for cracks, as many as look for the sky.
const RAYS: usize = 1 << 16;

impl Run<'_> {
    /// Enters what enclosed surface loses through cracks, where that is most, and warns where it is much. Nothing is looked for
    /// where no ray has left the scene.
    ///
    /// # Errors
    /// When stopped.
    pub fn look_for_leaks(&mut self, lit: &Lit<'_>) -> Result<(), Failure> {
        if self.report.escaped() == 0 {
            return Ok(());
        }
        let (seed, reporter) = (self.settings.transport.seed, self.reporter);
        let found = self.stage("leaks", |_| leaks(lit.scene, &lit.bvh, lit.basis.points(0), RAYS, seed, reporter))?;
        // Serious ones first: a small region tells little.
        let order = |a: &&Leak, b: &&Leak| a.is_serious().cmp(&b.is_serious()).then(a.lost().total_cmp(&b.lost()));
        let Some(worst) = found.iter().max_by(order) else { return Ok(()) };
        let sum = |of: fn(&Leak) -> u64| found.iter().map(of).sum::<u64>();
        let (rays, escaped, through_cracks) = (sum(|l| l.rays), sum(|l| l.escaped), sum(|l| l.through_cracks));
        let row = json!({
            "rays": rays, "escaped": escaped, "through_cracks": through_cracks,
            "worst": {"region": worst.region.0, "rays": worst.rays, "share": worst.share(), "lost": worst.lost()},
        });
        self.report.more.insert("leaks".into(), row);
        self.report.warnings.extend(worst.is_serious().then(|| warning(worst)));
        Ok(())
    }
}

fn warning(leak: &Leak) -> String {
    format!(
        "leaks: {} of the rays of enclosed surface leave the scene through cracks, and {} of the light there is lost by that; do all \
         triangles meet?",
        human_percent(leak.share()),
        human_percent(leak.lost())
    )
}
