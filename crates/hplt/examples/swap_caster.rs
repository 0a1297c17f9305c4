//! A ray caster of your own: this one counts the rays on their way to the usual one. `hplt::reference::conformance` checks one.
mod pipeline;

use std::sync::atomic::{AtomicU64, Ordering};

use hplt::geom::{Bvh, Hit, Ray, RayCaster};

struct Counting<'a> {
    inner: &'a Bvh,
    n_rays: AtomicU64,
}

impl RayCaster for Counting<'_> {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        self.n_rays.fetch_add(rays.len() as u64, Ordering::Relaxed);
        self.inner.trace_nearest(rays, hits);
    }
    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        self.n_rays.fetch_add(rays.len() as u64, Ordering::Relaxed);
        self.inner.trace_occluded(rays, occluded);
    }
}

fn main() -> pipeline::Result<()> {
    let (scene, bvh) = pipeline::cornell();
    let mine = Counting { inner: &bvh, n_rays: AtomicU64::new(0) };
    pipeline::compare(&scene, &bvh, pipeline::Stages { caster: &mine, ..pipeline::Stages::usual(&bvh) })?;
    println!("{} rays", mine.n_rays.into_inner());
    Ok(())
}
