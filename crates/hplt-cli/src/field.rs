//! A solved light field in either encoding, read in every way that the commands need.

use std::sync::OnceLock;

use hplt_basis::{
    Absolute, ApproximateNearest, Coefficients, Delta, ExactShepard, Reconstruction, delta_from_absolute,
};
use hplt_geom::{Interrupted, OrientedPoint, Progress, RayCaster, Rgb, parallel};
use hplt_splat::{GBuffer, flatten_absolute, flatten_delta, splat_absolute, splat_delta, splat_flattened};
use hplt_transport::{
    ErrorEstimate, ErrorProbe, FieldView, FinalGather, FinalGatherOptions, Gradients, LayeredInSight,
    LayeredNearestInSight, Model, OpenAir, Reading, Sender, TransportOptions, TransportReport, estimate_error,
    final_gather_more, read_in_sight, transport_absolute, transport_delta,
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

/// How a field is read. What has no gradients and casts no rays anyway, because its finest level is everywhere, is read as published.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ReadOptions {
    /// By gathers.
    pub reconstruction: ReconstructionName,
    /// To first order, where it is looked at or measured.
    pub has_gradients: bool,
    /// On those functions alone that a ray finds in sight.
    pub has_sight_rays: bool,
}

/// A field in one encoding.
pub struct Encoded<E> {
    /// Direct irradiance, W/m².
    pub direct: Coefficients<E>,
    /// Indirect irradiance, W/m².
    pub indirect: Coefficients<E>,
    /// How gathers read it.
    sender: Reader<E>,
    /// How displays and sensors read it.
    display: Reader<E>,
    variant: Variant,
    options: ReadOptions,
    /// Standard errors of the indirect irradiance by the rays of each function, where they are known.
    noise: Option<Coefficients<Absolute>>,
    /// Of the indirect irradiance, once it is read to first order.
    gradients: OnceLock<Gradients>,
}

/// Makes a reconstruction, which may cast rays.
type Reader<E> = for<'a> fn(&'a dyn RayCaster, Option<&'a Gradients>) -> Box<dyn Reconstruction<E> + 'a>;

impl<E> Encoded<E>
where
    ExactShepard: Reconstruction<E>,
    ApproximateNearest: Reconstruction<E>,
{
    /// A field whose finest level is everywhere.
    fn uniform(fields: [Coefficients<E>; 2], reconstruction: ReconstructionName, variant: Variant) -> Self {
        let [direct, indirect] = fields;
        let exact: Reader<E> = |_, _| Box::new(ExactShepard);
        let sender = match reconstruction {
            ReconstructionName::Shepard => exact,
            ReconstructionName::Nearest => |_: &dyn RayCaster, _: Option<&Gradients>| Box::new(ApproximateNearest) as _,
        };
        let options = ReadOptions { reconstruction, has_gradients: false, has_sight_rays: false };
        Self { direct, indirect, sender, display: exact, variant, options, noise: None, gradients: OnceLock::new() }
    }
}

impl Encoded<Absolute> {
    /// A field whose finer levels are only where they are needed.
    fn layered([direct, indirect]: [Coefficients<Absolute>; 2], options: ReadOptions) -> Self {
        let exact: Reader<Absolute> = |caster, gradients| Box::new(LayeredInSight { caster, gradients });
        let sender: Reader<Absolute> = match options.reconstruction {
            ReconstructionName::Shepard => exact,
            ReconstructionName::Nearest => |caster, _| Box::new(LayeredNearestInSight { caster }),
        };
        let gradients = OnceLock::new();
        Self { direct, indirect, sender, display: exact, variant: Variant::Links, options, noise: None, gradients }
    }

    fn gradients(&self, model: &Model<'_>) -> Option<&Gradients> {
        let fit = || Gradients::fit(model, &self.indirect);
        self.options.has_gradients.then(|| self.gradients.get_or_init(fit))
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
                let read = delta_reconstruction(reconstruction);
                let solution = transport_delta(model, &direct, &*read, oracle, options, progress)?;
                let field = Encoded::uniform([direct, solution.indirect], reconstruction, variant);
                Ok((Self::Delta(field), solution.report))
            }
            _ => {
                let read = absolute_reconstruction(reconstruction);
                let solution = transport_absolute(model, &direct, &*read, oracle, options, progress)?;
                let field = Encoded::uniform([direct, solution.indirect], reconstruction, variant);
                Ok((Self::Absolute(field), solution.report))
            }
        }
    }

    /// What [`transport_links`](hplt_transport::transport_links) found.
    pub fn linked(
        direct: Coefficients<Absolute>,
        (indirect, noise): (Coefficients<Absolute>, Coefficients<Absolute>),
        options: ReadOptions,
    ) -> Self {
        Self::Absolute(Encoded { noise: Some(noise), ..Encoded::layered([direct, indirect], options) })
    }

    /// A field from its coefficients, direct and indirect, by level.
    pub fn from_levels([direct, indirect]: [Vec<Vec<Rgb>>; 2], variant: Variant, options: ReadOptions) -> Self {
        let reconstruction = options.reconstruction;
        match variant {
            Variant::Delta => {
                let fields = [direct, indirect].map(Coefficients::from_levels);
                Self::Delta(Encoded::uniform(fields, reconstruction, variant))
            }
            Variant::Absolute => {
                let fields = [direct, indirect].map(Coefficients::from_levels);
                Self::Absolute(Encoded::uniform(fields, reconstruction, variant))
            }
            Variant::Links => {
                Self::Absolute(Encoded::layered([direct, indirect].map(Coefficients::from_levels), options))
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
    pub fn direct_at(&self, model: &Model<'_>, points: &[OrientedPoint]) -> Vec<Rgb> {
        let readings = either!(self, f => f.read(model, Part::Direct, points));
        readings.iter().map(|reading| reading.irradiance).collect()
    }

    /// Indirect irradiance at points, interpolated, and how far that can be trusted.
    pub fn indirect_at(&self, model: &Model<'_>, points: &[OrientedPoint]) -> Vec<Reading> {
        either!(self, f => f.read(model, Part::Indirect, points))
    }

    /// Indirect irradiance through one more gather, or through more rays of it, at the points with these indices:
    /// [`final_gather_more`].
    ///
    /// # Errors
    /// When interrupted.
    pub fn gather(
        &self,
        (model, sender_levels): (&Model<'_>, usize),
        points: (&[OrientedPoint], &[usize]),
        found: &mut [FinalGather],
        options: FinalGatherOptions<'_>,
        progress: &dyn Progress,
    ) -> Result<(), Interrupted> {
        either!(self, f => {
            let reconstruction = &*(f.sender)(f.sight(model), None);
            let sender = Sender { coefficients: &f.indirect, reconstruction, n_levels: sender_levels };
            final_gather_more(model, &sender, points, found, options, progress)
        })
    }

    /// How far what is read from the field is from its own gather with fresh rays.
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
            let reconstruction = &*(f.sender)(f.sight(model), None);
            let sender = Sender { coefficients: &f.indirect, reconstruction, n_levels: sender_levels };
            estimate_error(model, &sender, probe, progress)
        })
    }

    /// Whether pictures evaluate the field where they look, whatever display is asked for: functions that end where others take over
    /// cannot be splatted one by one.
    pub fn is_evaluated(&self, display: Display) -> bool {
        self.variant() == Variant::Links && display != Display::FinalGather || display == Display::Evaluate
    }

    /// Indirect irradiance at every sample of a G-buffer, splatted: by level, or all levels as one where `is_flattened`.
    ///
    /// # Errors
    /// When interrupted.
    pub fn splat(
        &self,
        model: &Model<'_>,
        is_flattened: bool,
        gbuffer: &GBuffer,
        progress: &dyn Progress,
    ) -> Result<Vec<Rgb>, Interrupted> {
        let basis = model.basis;
        let splatted = match (is_flattened, self) {
            (false, Self::Delta(f)) => splat_delta(basis, &f.indirect, gbuffer, progress)?,
            (false, Self::Absolute(f)) => splat_absolute(basis, &f.indirect, gbuffer, progress)?,
            (true, Self::Delta(f)) => {
                splat_flattened(basis, &flatten_delta(basis, &f.indirect, 0.0), gbuffer, progress)?
            }
            (true, Self::Absolute(f)) => {
                // Above the rounding of sums of bounces, each pushed down by itself.
                let threshold = 1e-5 * f.indirect.max_abs();
                splat_flattened(basis, &flatten_absolute(basis, &f.indirect, threshold), gbuffer, progress)?
            }
        };
        Ok(splatted.irradiance)
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

/// Which light of a field.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Direct,
    Indirect,
}

impl<E> Encoded<E> {
    /// What tells which functions are in sight where the field is read.
    fn sight<'m>(&self, model: &Model<'m>) -> &'m dyn RayCaster {
        if self.options.has_sight_rays { model.caster } else { &OpenAir }
    }

    fn part(&self, part: Part) -> &Coefficients<E> {
        match part {
            Part::Direct => &self.direct,
            Part::Indirect => &self.indirect,
        }
    }
}

trait Read {
    fn read(&self, model: &Model<'_>, part: Part, points: &[OrientedPoint]) -> Vec<Reading>;
}

impl Read for Encoded<Delta> {
    fn read(&self, model: &Model<'_>, part: Part, points: &[OrientedPoint]) -> Vec<Reading> {
        interpolate(model, self.part(part), self.display, points)
    }
}

impl Read for Encoded<Absolute> {
    fn read(&self, model: &Model<'_>, part: Part, points: &[OrientedPoint]) -> Vec<Reading> {
        if self.variant != Variant::Links {
            return interpolate(model, self.part(part), self.display, points);
        }
        let model = &Model { caster: self.sight(model), ..*model };
        let (gradients, noise) = match part {
            Part::Direct => (None, None),
            Part::Indirect => (self.gradients(model), self.noise.as_ref()),
        };
        let field = FieldView { values: self.part(part), gradients, noise };
        read_in_sight(model, field, points)
    }
}

/// The field at points on all levels, in parallel, in order. Trusted wherever a function is in sight.
fn interpolate<E: Sync>(
    model: &Model<'_>,
    coefficients: &Coefficients<E>,
    reader: Reader<E>,
    points: &[OrientedPoint],
) -> Vec<Reading> {
    let n_levels = model.basis.n_levels();
    parallel::map(
        points.len(),
        || reader(model.caster, None),
        |reconstruction, i| {
            let mut value = [Rgb::ZERO];
            let point = std::slice::from_ref(&points[i]);
            let coverage = reconstruction.reconstruct(model.basis, coefficients, n_levels, point, &mut value);
            let is_seen = coverage.nearest + coverage.uncovered == 0;
            Reading { irradiance: value[0], spread: if is_seen { 0.0 } else { f32::INFINITY }, noise: 0.0 }
        },
    )
}
