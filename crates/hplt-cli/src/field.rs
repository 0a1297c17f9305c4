//! A solved light field in either encoding, read in every way that the commands need.

use hplt_basis::{
    Absolute, ApproximateNearest, Coefficients, Coverage, Delta, ExactShepard, Layered, LayeredNearest, Reconstruction,
    ShepardBasis, delta_from_absolute,
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
    /// How gathers read it.
    reconstruction: Box<dyn Reconstruction<E>>,
    /// How displays and sensors read it.
    display: Box<dyn Reconstruction<E>>,
    variant: Variant,
}

impl<E> Encoded<E> {
    /// A field whose finest level is everywhere.
    fn uniform(fields: [Coefficients<E>; 2], reconstruction: Box<dyn Reconstruction<E>>, variant: Variant) -> Self
    where
        ExactShepard: Reconstruction<E>,
    {
        let [direct, indirect] = fields;
        Self { direct, indirect, reconstruction, display: Box::new(ExactShepard), variant }
    }
}

impl Encoded<Absolute> {
    /// A field whose finer levels are only where they are needed.
    fn layered([direct, indirect]: [Coefficients<Absolute>; 2], reconstruction: ReconstructionName) -> Self {
        let reconstruction: Box<dyn Reconstruction<Absolute>> = match reconstruction {
            ReconstructionName::Shepard => Box::new(Layered),
            ReconstructionName::Nearest => Box::new(LayeredNearest),
        };
        Self { direct, indirect, reconstruction, display: Box::new(Layered), variant: Variant::Links }
    }
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
                let field = Encoded::uniform([direct, solution.indirect], reconstruction, variant);
                Ok((Self::Delta(field), solution.report))
            }
            _ => {
                let reconstruction = absolute_reconstruction(reconstruction);
                let solution = transport_absolute(model, &direct, &*reconstruction, oracle, options, progress)?;
                let field = Encoded::uniform([direct, solution.indirect], reconstruction, variant);
                Ok((Self::Absolute(field), solution.report))
            }
        }
    }

    /// What [`transport_links`](hplt_transport::transport_links) found.
    pub fn linked(
        direct: Coefficients<Absolute>,
        indirect: Coefficients<Absolute>,
        reconstruction: ReconstructionName,
    ) -> Self {
        Self::Absolute(Encoded::layered([direct, indirect], reconstruction))
    }

    /// A field from its coefficients, direct and indirect, by level.
    pub fn from_levels(
        [direct, indirect]: [Vec<Vec<Rgb>>; 2],
        variant: Variant,
        reconstruction: ReconstructionName,
    ) -> Self {
        match variant {
            Variant::Delta => {
                let fields = [direct, indirect].map(Coefficients::from_levels);
                Self::Delta(Encoded::uniform(fields, delta_reconstruction(reconstruction), variant))
            }
            Variant::Absolute => {
                let fields = [direct, indirect].map(Coefficients::from_levels);
                Self::Absolute(Encoded::uniform(fields, absolute_reconstruction(reconstruction), variant))
            }
            Variant::Links => {
                Self::Absolute(Encoded::layered([direct, indirect].map(Coefficients::from_levels), reconstruction))
            }
        }
    }

    /// The encoding.
    pub fn variant(&self) -> Variant {
        either!(self, f => f.variant)
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

    /// Indirect irradiance at points by the exact expansion, and the indices of those that no function is in sight of.
    pub fn indirect_at(&self, basis: &ShepardBasis, points: &[OrientedPoint]) -> (Vec<Rgb>, Vec<usize>) {
        either!(self, f => interpolate(basis, &f.indirect, &*f.display, points))
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
            let reconstruction = &*f.reconstruction;
            let sender = Sender { coefficients: &f.indirect, reconstruction, n_levels: sender_levels };
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
        either!(self, f => {
            let reconstruction = &*f.reconstruction;
            let sender = Sender { coefficients: &f.indirect, reconstruction, n_levels: sender_levels };
            estimate_error(model, &sender, &f.indirect, &*f.display, probe, progress)
        })
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
        // Functions that end where others take over cannot be splatted one by one.
        let display = if self.variant() == Variant::Links { Display::Evaluate } else { display };
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
            (_, Self::Delta(f)) => return evaluate(basis, &f.indirect, &*f.display, gbuffer, progress),
            (_, Self::Absolute(f)) => return evaluate(basis, &f.indirect, &*f.display, gbuffer, progress),
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

/// The field at points on all levels, in parallel, in order; and the indices of points that no function is in sight of, whose
/// values are those of the nearest.
fn interpolate<E: Sync>(
    basis: &ShepardBasis,
    coefficients: &Coefficients<E>,
    reconstruction: &dyn Reconstruction<E>,
    points: &[OrientedPoint],
) -> (Vec<Rgb>, Vec<usize>) {
    const CHUNK: usize = 256;
    let read = |points: &[OrientedPoint], out: &mut [Rgb]| {
        let coverage = reconstruction.reconstruct(basis, coefficients, basis.n_levels(), points, out);
        coverage.nearest + coverage.uncovered == 0
    };
    let chunks: Vec<&[OrientedPoint]> = points.chunks(CHUNK).collect();
    let parts = parallel::map(
        chunks.len(),
        || (),
        |(), i| {
            let mut out = vec![Rgb::ZERO; chunks[i].len()];
            if read(chunks[i], &mut out) {
                return (out, Vec::new());
            }
            let is_unseen = |&k: &usize| !read(&chunks[i][k..=k], &mut [Rgb::ZERO]);
            let unseen: Vec<usize> = (0..chunks[i].len()).filter(is_unseen).map(|k| i * CHUNK + k).collect();
            (out, unseen)
        },
    );
    let (mut values, mut unseen) = (Vec::with_capacity(points.len()), Vec::new());
    for (part, of_part) in parts {
        values.extend(part);
        unseen.extend(of_part);
    }
    (values, unseen)
}
