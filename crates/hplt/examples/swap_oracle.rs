//! An oracle of your own: refines by brightness alone, wherever the detail is visible beside the mean of the room, and never
//! beyond a given level.
mod pipeline;

use hplt::transport::{Detail, Oracle};

struct Visible {
    share_of_mean: f32,
    finest_level: usize,
}

impl Oracle for Visible {
    fn refine(&self, d: &Detail) -> bool {
        d.level < self.finest_level && d.detail.abs().cmpgt(d.mean * self.share_of_mean).any()
    }
}

fn main() -> pipeline::Result<()> {
    let (scene, bvh) = pipeline::cornell();
    let mine = Visible { share_of_mean: 0.2, finest_level: 3 };
    pipeline::compare(&scene, &bvh, pipeline::Stages { oracle: Some(&mine), ..pipeline::Stages::usual(&bvh) })
}
