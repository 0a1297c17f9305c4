//! The pipeline as a row of functions that a test can exchange, one at a time, for a wrong one.
//!
//! The product stays untouched: every hook is a place where its public interface calls back (rays, reconstruction) or where
//! a value passes from one stage to the next.

use hplt::basis::{Absolute, ApproximateNearest, Coefficients, Coverage, ExactShepard, Reconstruction, ShepardBasis};
use hplt::geom::{Bvh, Hit, OrientedPoint, PointHierarchy, Ray, RayCaster, Rgb, Scene, SceneBuilder};
use hplt::reference::scenes;
use hplt::transport::{Error, Solution, TransportOptions};

/// Finds the nearest hits of a batch of rays.
pub type Nearest = fn(&Bvh, &[Ray], &mut [Hit]);
/// Finds which of a batch of rays are blocked.
pub type Occluded = fn(&Bvh, &[Ray], &mut [bool]);
/// Reads a field at points, on so many of the coarsest levels.
pub type Read = fn(&ShepardBasis, &Coefficients<Absolute>, usize, &[OrientedPoint], &mut [Rgb]) -> Coverage;
/// Runs the transport, once or several times, and decides when it has converged.
pub type Run = fn(
    &TransportOptions,
    &dyn Fn(&TransportOptions) -> Result<Solution<Absolute>, Error>,
) -> Result<Solution<Absolute>, Error>;

/// The functions that the pipeline of [`Prepared`](crate::Prepared) consists of.
#[derive(Clone, Copy)]
pub struct Stages {
    /// What a scene goes through before it is built.
    pub input: fn(SceneBuilder) -> SceneBuilder,
    /// What the points go through before functions stand on them.
    pub points: fn(PointHierarchy) -> PointHierarchy,
    /// Nearest hits.
    pub nearest: Nearest,
    /// Shadow rays.
    pub occluded: Occluded,
    /// How gather rays read senders.
    pub senders: Read,
    /// How the solution is read at points.
    pub display: Read,
    /// The bounces and their stop rule.
    pub run: Run,
    /// What becomes of a finished irradiance on its way out.
    pub output: fn(&Scene, &Bvh, &OrientedPoint, Rgb) -> Rgb,
}

impl Stages {
    /// The product as it is.
    pub const SOUND: Self = Self {
        input: |builder| builder,
        points: |points| points,
        nearest: |bvh, rays, hits| bvh.trace_nearest(rays, hits),
        occluded: |bvh, rays, occluded| bvh.trace_occluded(rays, occluded),
        senders: |basis, field, n, queries, out| ApproximateNearest.reconstruct(basis, field, n, queries, out),
        display: |basis, field, n, queries, out| ExactShepard.reconstruct(basis, field, n, queries, out),
        run: |options, transport| transport(options),
        output: |_, _, _, irradiance| irradiance,
    };

    /// The finished scene of a builder.
    pub fn build(&self, builder: SceneBuilder) -> Scene {
        scenes::build((self.input)(builder))
    }
}

/// A BVH whose two queries can be exchanged.
pub struct StagedBvh {
    /// The sound one.
    pub bvh: Bvh,
    nearest: Nearest,
    occluded: Occluded,
}

impl StagedBvh {
    /// The queries of `stages` on `bvh`.
    pub fn new(bvh: Bvh, stages: &Stages) -> Self {
        Self { bvh, nearest: stages.nearest, occluded: stages.occluded }
    }
}

impl RayCaster for StagedBvh {
    fn trace_nearest(&self, rays: &[Ray], hits: &mut [Hit]) {
        (self.nearest)(&self.bvh, rays, hits);
    }

    fn trace_occluded(&self, rays: &[Ray], occluded: &mut [bool]) {
        (self.occluded)(&self.bvh, rays, occluded);
    }
}

/// A reading function as the product wants it.
pub struct StagedRead(pub Read);

impl Reconstruction<Absolute> for StagedRead {
    fn reconstruct(
        &self,
        basis: &ShepardBasis,
        coefficients: &Coefficients<Absolute>,
        n_levels: usize,
        queries: &[OrientedPoint],
        out: &mut [Rgb],
    ) -> Coverage {
        (self.0)(basis, coefficients, n_levels, queries, out)
    }
}
