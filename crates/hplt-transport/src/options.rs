use hplt_basis::ShepardBasis;
use hplt_geom::{RayCaster, Scene};

use crate::{Error, Threshold};

/// What every stage of the transport reads.
#[derive(Clone, Copy)]
pub struct Model<'a> {
    /// Geometry, materials, lights.
    pub scene: &'a Scene,
    /// Casts rays against `scene`.
    pub caster: &'a dyn RayCaster,
    /// The function space.
    pub basis: &'a ShepardBasis,
}

/// How the bounces are computed.
#[derive(Debug, Clone, PartialEq)]
pub struct TransportOptions {
    /// Seed of all rays.
    pub seed: u64,
    /// Rays per gather; a power of two.
    pub n_rays: u32,
    /// How many of the coarsest levels senders are read from; clamped to what there is.
    pub sender_levels: usize,
    /// Bounces to compute at most.
    pub max_bounces: usize,
    /// Stop once the light still to come is below this fraction of the mean irradiance, in every region and channel.
    pub tolerance: f32,
    /// Where to refine.
    pub threshold: Threshold,
    /// Absolute variant: functions that a bounce does not gather take their share of what the earlier bounces found there,
    /// instead of the plain average of their parents ([`transport_absolute`](crate::transport_absolute)).
    pub shaped_push_down: bool,
}

impl TransportOptions {
    /// The published parameters (Zollhöfer 2010): 1024 rays, 3 sender levels, τ = 0.016 absolute, 3 bounces.
    pub fn slides() -> Self {
        Self {
            seed: 0,
            n_rays: 1024,
            sender_levels: 3,
            max_bounces: 3,
            tolerance: 0.0,
            threshold: Threshold { absolute: 0.016, relative: 0.0, noise: 0.0 },
            shaped_push_down: false,
        }
    }

    /// A quick look: a few per cent of error.
    pub fn preview() -> Self {
        Self {
            n_rays: 128,
            sender_levels: 5,
            max_bounces: 64,
            tolerance: 0.01,
            threshold: Threshold { absolute: 0.0, relative: 0.1, noise: 2.0 },
            shaped_push_down: true,
            ..Self::slides()
        }
    }

    /// For results that are kept: all bounces, about one per cent of error.
    pub fn production() -> Self {
        Self {
            n_rays: 1024,
            sender_levels: usize::MAX,
            max_bounces: 1000,
            tolerance: 1e-3,
            threshold: Threshold { absolute: 0.0, relative: 0.05, noise: 2.0 },
            shaped_push_down: true,
            ..Self::slides()
        }
    }

    pub(crate) fn check(&self) -> Result<(), Error> {
        let fail = |name, value, expected| Err(Error::Option { name, value, expected });
        if !self.n_rays.is_power_of_two() || self.n_rays < 8 || self.n_rays > 1 << 16 {
            return fail("n_rays", self.n_rays.into(), "a power of two in [8, 65536]");
        }
        if self.sender_levels == 0 {
            return fail("sender_levels", 0.0, "1 or more");
        }
        if self.max_bounces == 0 {
            return fail("max_bounces", 0.0, "1 or more");
        }
        if !(self.tolerance >= 0.0 && self.tolerance.is_finite()) {
            return fail("tolerance", self.tolerance.into(), "a finite number, 0 or more");
        }
        self.threshold.check()
    }
}
