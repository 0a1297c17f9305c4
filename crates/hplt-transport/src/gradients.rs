//! First-order reconstruction: how the field changes along the surface around each function.

use glam::{Mat2, Mat3, Vec2};
use hplt_basis::{Absolute, Coefficients, Weight};
use hplt_geom::{OrientedPoint, Rgb, parallel};
use hplt_sampling::{is_in_sight, warp};

use crate::Model;

/// Added to the matrix of a fit over the sum of its weights, in squares of a support: gradients that few or crowded neighbours say
/// little about stay small.
const RIDGE: f32 = 0.02;

/// The tangential gradients of a field at its functions, W/m² per scene unit.
///
/// Each is the plane of least squares through the values at the functions around that are in sight, weighted as they are at the
/// function. What the neighbours know includes what is hidden and what comes into view, which derivatives of a gather's own rays
/// (Křivánek et al., "Radiance Caching for Efficient Global Illumination Computation", 2005) leave out.
#[derive(Debug, Clone)]
pub struct Gradients {
    /// By level and function, rows are channels: times an offset it is the change.
    levels: Vec<Vec<Mat3>>,
}

impl Gradients {
    /// The gradients of `field`.
    pub fn fit(model: &Model<'_>, field: &Coefficients<Absolute>) -> Self {
        let of_level = |level: usize| {
            parallel::map(model.basis.n_functions(level), Vec::new, |weights, i| {
                gradient(model, field.level(level), (level, i), weights)
            })
        };
        Self { levels: (0..model.basis.n_levels()).map(of_level).collect() }
    }

    /// What the function `i` of `level`, which is at `center` and has this `value`, says at `query`: from 0 to twice the value.
    pub(crate) fn value(
        &self,
        (level, i): (usize, u32),
        center: &OrientedPoint,
        value: Rgb,
        query: &OrientedPoint,
    ) -> Rgb {
        let change = self.levels[level][i as usize] * (query.position - center.position);
        value + change.clamp(-value, value)
    }
}

fn gradient(model: &Model<'_>, values: &[Rgb], (level, i): (usize, usize), weights: &mut Vec<Weight>) -> Mat3 {
    let points = model.basis.points(level);
    let (center, support) = (&points[i], model.basis.support(level));
    let frame = warp::orthonormal_basis(center.normal);
    model.basis.raw_weights(level, center, weights);
    let mut matrix = Mat2::from_diagonal(Vec2::splat(RIDGE));
    let (mut sides, mut squares) = ([Vec2::ZERO; 3], Rgb::ZERO);
    for &Weight { function, weight } in &*weights {
        let other = &points[function as usize];
        if function as usize == i || !is_in_sight(model.caster, other, center, support) {
            continue;
        }
        let offset = (other.position - center.position) / support;
        let offset = Vec2::new(offset.dot(frame.x_axis), offset.dot(frame.y_axis));
        matrix += weight * Mat2::from_cols(offset * offset.x, offset * offset.y);
        let change = values[function as usize] - values[i];
        squares += weight * change * change;
        sides.iter_mut().zip(change.to_array()).for_each(|(side, change)| *side += weight * change * offset);
    }
    let inverse = matrix.inverse();
    let row = |channel: usize| {
        let slope = inverse * sides[channel];
        // What a plane does not explain is noise or detail, and it is trusted as far as it explains.
        let explained = slope.dot(sides[channel]) / squares[channel].max(f32::MIN_POSITIVE);
        let along = slope * (explained.clamp(0.0, 1.0) / support);
        along.x * frame.x_axis + along.y * frame.y_axis
    };
    Mat3::from_cols(row(0), row(1), row(2)).transpose()
}
