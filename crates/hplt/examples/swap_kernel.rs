//! A kernel of your own: Wendland's C² function (1995), steeper than the usual one.
mod pipeline;

use hplt::basis::Kernel;

fn wendland(h: f32) -> f32 {
    let rest = (1.0 - h).max(0.0);
    rest.powi(4) * (4.0 * h + 1.0)
}

fn main() -> pipeline::Result<()> {
    let (scene, bvh) = pipeline::cornell();
    pipeline::compare(
        &scene,
        &bvh,
        pipeline::Stages { kernel: Kernel::Custom(wendland), ..pipeline::Stages::usual(&bvh) },
    )
}
