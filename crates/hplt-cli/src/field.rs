//! A solved light field in either encoding, read in every way that the commands need.

use hplt_basis::{
    Absolute, ApproximateNearest, Coefficients, Coverage, Delta, ExactShepard, Reconstruction, ShepardBasis,
    delta_from_absolute,
};
use hplt_geom::{Interrupted, OrientedPoint, Progress, Rgb, parallel};
use hplt_splat::{GBuffer, evaluate, flatten_absolute, flatten_delta, splat_absolute, splat_delta, splat_flattened};
use hplt_transport::{
    ErrorEstimate, ErrorProbe, FinalGather, FinalGatherOptions, Model, Sender, TransportOptions, TransportReport,
    estimate_error, final_gather, transport_absolute, transport_delta,
};

use crate::exit::Failure;
use crate::sections::{Display, ReconstructionName, Variant};

/// Direct and indirect irradiance on a hierarchy.
pub enum Field {
    /// Corrections from level to level.
    Delta(Encoded<Delta>),
    /// Values on every level.
    Absolute(Encoded<Absolute>),
}

/// A field in one encoding.
pub struct Encoded<E> {
    /// Direct irradiance, W/m².
    pub direct: Coefficients<E>,
    /// Indirect irradiance, W/m².
    pub indirect: Coefficients<E>,
    reconstruction: Box<dyn Reconstruction<E>>,
}

/// Runs `$body` with `$encoded` bound to the field, whatever its encoding.
macro_rules! either {
    ($field:expr, $encoded:ident => $body:expr) => {
        match $field {
            Field::Delta($encoded) => $body,
            Field::Absolute($encoded) => $body,
        }
    };
}

impl Field {
    /// Bounces `direct` light through the scene: V1 or V3, as `variant` says.
    ///
    /// # Errors
    /// Those of the transport.
    pub fn solve(
        model: &Model<'_>,
        direct: Coefficients<Absolute>,
        (variant, reconstruction): (Variant, ReconstructionName),
        options: &TransportOptions,
        progress: &dyn Progress,
    ) -> Result<(Self, TransportReport), Failure> {
        let oracle = &options.threshold;
        match variant {
            Variant::Delta => {
                let direct = delta_from_absolute(model.basis, &direct);
                let reconstruction = delta_reconstruction(reconstruction);
                let solution = transport_delta(model, &direct, &*reconstruction, oracle, options, progress)?;
                let field = Encoded { direct, indirect: solution.indirect, reconstruction };
                Ok((Self::Delta(field), solution.report))
            }
            Variant::Absolute => {
                let reconstruction = absolute_reconstruction(reconstruction);
                let solution = transport_absolute(model, &direct, &*reconstruction, oracle, options, progress)?;
                let field = Encoded { direct, indirect: solution.indirect, reconstruction };
                Ok((Self::Absolute(field), solution.report))
            }
        }
    }

    /// A field from its coefficients, direct and indirect, by level.
    pub fn from_levels(
        [direct, indirect]: [Vec<Vec<Rgb>>; 2],
        variant: Variant,
        reconstruction: ReconstructionName,
    ) -> Self {
        match variant {
            Variant::Delta => Self::Delta(Encoded {
                direct: Coefficients::from_levels(direct),
                indirect: Coefficients::from_levels(indirect),
                reconstruction: delta_reconstruction(reconstruction),
            }),
            Variant::Absolute => Self::Absolute(Encoded {
                direct: Coefficients::from_levels(direct),
                indirect: Coefficients::from_levels(indirect),
                reconstruction: absolute_reconstruction(reconstruction),
            }),
        }
    }

    /// The encoding.
    pub fn variant(&self) -> Variant {
        match self {
            Self::Delta(_) => Variant::Delta,
            Self::Absolute(_) => Variant::Absolute,
        }
    }

    /// Direct and indirect coefficients of a level.
    pub fn level(&self, level: usize) -> [&[Rgb]; 2] {
        either!(self, f => [f.direct.level(level), f.indirect.level(level)])
    }

    /// Bytes of the coefficients.
    pub fn memory(&self) -> usize {
        let n: usize = either!(self, f => (0..f.direct.n_levels()).map(|l| f.direct.level(l).len()).sum());
        2 * n * size_of::<Rgb>()
    }

    /// Whether every coefficient is finite.
    pub fn is_finite(&self) -> bool {
        either!(self, f => f.direct.is_finite() && f.indirect.is_finite())
    }

    /// Direct irradiance at points, interpolated: coarse, but at once.
    pub fn direct_at(&self, basis: &ShepardBasis, points: &[OrientedPoint]) -> Vec<Rgb> {
        either!(self, f => interpolate(basis, &f.direct, &*f.reconstruction, points).0)
    }

    /// Indirect irradiance at points by the exact expansion, and how they were answered.
    pub fn indirect_at(&self, basis: &ShepardBasis, points: &[OrientedPoint]) -> (Vec<Rgb>, Coverage) {
        match self {
            Self::Delta(f) => interpolate(basis, &f.indirect, &ExactShepard, points),
            Self::Absolute(f) => interpolate(basis, &f.indirect, &ExactShepard, points),
        }
    }

    /// Indirect irradiance at points through one more gather.
    ///
    /// # Errors
    /// When interrupted.
    pub fn gather(
        &self,
        model: &Model<'_>,
        sender_levels: usize,
        points: &[OrientedPoint],
        options: FinalGatherOptions<'_>,
        progress: &dyn Progress,
    ) -> Result<Vec<FinalGather>, Interrupted> {
        either!(self, f => {
            let total = f.direct.plus(&f.indirect);
            let sender = Sender { coefficients: &total, reconstruction: &*f.reconstruction, n_levels: sender_levels };
            final_gather(model, &sender, points, options, progress)
        })
    }

    /// How far the interpolated field is from its own gather with fresh rays.
    ///
    /// # Errors
    /// When interrupted.
    pub fn error(
        &self,
        model: &Model<'_>,
        sender_levels: usize,
        probe: ErrorProbe<'_>,
        progress: &dyn Progress,
    ) -> Result<ErrorEstimate, Interrupted> {
        match self {
            Self::Delta(f) => error_of(model, f, &ExactShepard, sender_levels, probe, progress),
            Self::Absolute(f) => error_of(model, f, &ExactShepard, sender_levels, probe, progress),
        }
    }

    /// Indirect irradiance at every sample of a G-buffer; `display` must not be a final gather.
    ///
    /// # Errors
    /// When interrupted.
    pub fn show(
        &self,
        basis: &ShepardBasis,
        display: Display,
        gbuffer: &GBuffer,
        progress: &dyn Progress,
    ) -> Result<(Vec<Rgb>, Coverage), Interrupted> {
        let splatted = match (display, self) {
            (Display::Splat, Self::Delta(f)) => splat_delta(basis, &f.indirect, gbuffer, progress)?,
            (Display::Splat, Self::Absolute(f)) => splat_absolute(basis, &f.indirect, gbuffer, progress)?,
            (Display::Flatten, Self::Delta(f)) => {
                splat_flattened(basis, &flatten_delta(basis, &f.indirect, 0.0), gbuffer, progress)?
            }
            (Display::Flatten, Self::Absolute(f)) => {
                // Above the rounding of sums of bounces, each pushed down by itself.
                let threshold = 1e-5 * f.indirect.max_abs();
                splat_flattened(basis, &flatten_absolute(basis, &f.indirect, threshold), gbuffer, progress)?
            }
            (_, Self::Delta(f)) => return evaluate(basis, &f.indirect, &ExactShepard, gbuffer, progress),
            (_, Self::Absolute(f)) => return evaluate(basis, &f.indirect, &ExactShepard, gbuffer, progress),
        };
        Ok((splatted.irradiance, splatted.report.coverage))
    }
}

fn delta_reconstruction(name: ReconstructionName) -> Box<dyn Reconstruction<Delta>> {
    match name {
        ReconstructionName::Shepard => Box::new(ExactShepard),
        ReconstructionName::Nearest => Box::new(ApproximateNearest),
    }
}

fn absolute_reconstruction(name: ReconstructionName) -> Box<dyn Reconstruction<Absolute>> {
    match name {
        ReconstructionName::Shepard => Box::new(ExactShepard),
        ReconstructionName::Nearest => Box::new(ApproximateNearest),
    }
}

fn error_of<E>(
    model: &Model<'_>,
    field: &Encoded<E>,
    display: &dyn Reconstruction<E>,
    sender_levels: usize,
    probe: ErrorProbe<'_>,
    progress: &dyn Progress,
) -> Result<ErrorEstimate, Interrupted> {
    let total = field.direct.plus(&field.indirect);
    let sender = Sender { coefficients: &total, reconstruction: &*field.reconstruction, n_levels: sender_levels };
    estimate_error(model, &sender, &field.indirect, display, probe, progress)
}

/// The field at points on all levels, in parallel, in order.
fn interpolate<E: Sync>(
    basis: &ShepardBasis,
    coefficients: &Coefficients<E>,
    reconstruction: &dyn Reconstruction<E>,
    points: &[OrientedPoint],
) -> (Vec<Rgb>, Coverage) {
    const CHUNK: usize = 256;
    let chunks: Vec<&[OrientedPoint]> = points.chunks(CHUNK).collect();
    let parts = parallel::map(
        chunks.len(),
        || (),
        |(), i| {
            let mut out = vec![Rgb::ZERO; chunks[i].len()];
            let coverage = reconstruction.reconstruct(basis, coefficients, basis.n_levels(), chunks[i], &mut out);
            (out, coverage)
        },
    );
    let mut coverage = Coverage::default();
    let mut values = Vec::with_capacity(points.len());
    for (part, counts) in parts {
        values.extend(part);
        coverage += counts;
    }
    (values, coverage)
}
