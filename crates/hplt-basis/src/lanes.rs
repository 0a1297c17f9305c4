//! Sums over functions, and the nearest of them, for as many queries at once as the processor's vectors have lanes. Every lane does
//! what [`Footprint::weight`] does, or [`OrientedPoint::is_continued_at`], in the same order, so that the bits are the same on every
//! processor.

use std::ops::Range;

use glam::Vec3;
use hplt_geom::{Extent, N_SECTORS, OrientedPoint, Rgb};
use pulp::{Arch, Simd, WithSimd};

use crate::{Footprint, Kernel, Weight};

/// The square of what a step of length one in the worst direction counts as in the sum that
/// [`Extent::contains`](hplt_geom::Extent::contains) compares with 1, `1 + (√2 - 1)²`, and a little more.
const SECTOR_MARGIN: f32 = 1.18;

/// What decides about the weights of a function.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Function {
    position: Vec3,
    normal: Vec3,
    extent: Extent,
    /// The square of the largest of the inverse depths, and a little more: what is nearer than one over it is in sight.
    inverse_sight_squared: f32,
    tangent: Vec3,
    bitangent: Vec3,
}

impl Function {
    pub fn of(point: &OrientedPoint) -> Self {
        let &OrientedPoint { position, normal, extent, .. } = point;
        let [tangent, _, bitangent, ..] = Extent::sector_directions(normal);
        let inverse_sight = extent.inverse_depths.iter().fold(0.0, |largest: f32, d| largest.max(*d));
        let inverse_sight_squared = SECTOR_MARGIN * inverse_sight * inverse_sight;
        Self { position, normal, extent, inverse_sight_squared, tangent, bitangent }
    }
}

/// Queries, component by component.
pub(crate) struct Columns {
    position: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    free_height: Vec<f32>,
}

impl Columns {
    pub fn new<'a>(queries: impl ExactSizeIterator<Item = &'a OrientedPoint>) -> Self {
        let column = || Vec::with_capacity(queries.len());
        let mut columns = Self {
            position: [column(), column(), column()],
            normal: [column(), column(), column()],
            free_height: column(),
        };
        for query in queries {
            for axis in 0..3 {
                columns.position[axis].push(query.position[axis]);
                columns.normal[axis].push(query.normal[axis]);
            }
            columns.free_height.push(query.extent.free_height());
        }
        columns
    }
}

/// `Σ w_i α_i`, channel by channel, and `Σ w_i` at all queries. Each of the `groups` has functions, in the order in which they are
/// summed, and a number of queries, which follow those of the group before.
pub(crate) fn sums(
    functions: &[Function],
    footprint: &Footprint,
    coefficients: &[Rgb],
    queries: &Columns,
    groups: Vec<(&[u32], usize)>,
) -> [Vec<f32>; 4] {
    let n_queries = queries.free_height.len();
    let mut out = [(); 4].map(|()| vec![0.0; n_queries]);
    Arch::new().dispatch(Sums { functions, footprint, coefficients, queries, groups, out: &mut out });
    out
}

struct Sums<'a> {
    functions: &'a [Function],
    footprint: &'a Footprint,
    coefficients: &'a [Rgb],
    queries: &'a Columns,
    groups: Vec<(&'a [u32], usize)>,
    out: &'a mut [Vec<f32>; 4],
}

impl WithSimd for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { functions, footprint, coefficients, queries, groups, out } = self;
        for_each(simd, queries, &groups, |ids, queries, lanes| {
            let zero = simd.splat_f32s(0.0);
            let (mut red, mut green, mut blue, mut sum) = (zero, zero, zero, zero);
            for &id in ids {
                let weights = weights(simd, &functions[id as usize], footprint, &queries);
                let coefficient = coefficients[id as usize];
                red = simd.add_f32s(red, simd.mul_f32s(simd.splat_f32s(coefficient.x), weights));
                green = simd.add_f32s(green, simd.mul_f32s(simd.splat_f32s(coefficient.y), weights));
                blue = simd.add_f32s(blue, simd.mul_f32s(simd.splat_f32s(coefficient.z), weights));
                sum = simd.add_f32s(sum, weights);
            }
            for (column, values) in out.iter_mut().zip([red, green, blue, sum]) {
                simd.partial_store_f32s(&mut column[lanes.clone()], values);
            }
        });
    }
}

/// Adds to the list of each query the functions of its group that have weight there, in the order of the group.
pub(crate) fn list_weights(
    functions: &[Function],
    footprint: &Footprint,
    queries: &Columns,
    groups: Vec<(&[u32], usize)>,
    lists: &mut [Vec<Weight>],
) {
    Arch::new().dispatch(ListWeights { functions, footprint, queries, groups, lists });
}

struct ListWeights<'a> {
    functions: &'a [Function],
    footprint: &'a Footprint,
    queries: &'a Columns,
    groups: Vec<(&'a [u32], usize)>,
    lists: &'a mut [Vec<Weight>],
}

impl WithSimd for ListWeights<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { functions, footprint, queries, groups, lists } = self;
        for_each(simd, queries, &groups, |ids, queries, lanes| {
            for &function in ids {
                let weights = weights(simd, &functions[function as usize], footprint, &queries);
                if simd.first_true_m32s(simd.greater_than_f32s(weights, simd.splat_f32s(0.0))) >= S::F32_LANES {
                    continue;
                }
                let weights = bytemuck::cast_slice::<S::f32s, f32>(std::slice::from_ref(&weights));
                for (list, &weight) in lists[lanes.clone()].iter_mut().zip(weights) {
                    if weight > 0.0 {
                        list.push(Weight { function, weight });
                    }
                }
            }
        });
    }
}

/// What [`nearest`] says where there is none.
pub(crate) const NONE: u32 = u32::MAX;

/// At each query the nearest function of those of its group that [continue](OrientedPoint::is_continued_at) there, that face
/// nearly the same way, by the least cosine between the normals, and that are less than `reach` away: the first if several are equally
/// near.
pub(crate) fn nearest(
    functions: &[Function],
    (reach, least_cosine): (f32, f32),
    queries: &Columns,
    groups: Vec<(&[u32], usize)>,
) -> Vec<u32> {
    let mut out = vec![NONE; queries.free_height.len()];
    Arch::new().dispatch(Nearest { functions, reach, least_cosine, queries, groups, out: &mut out });
    out
}

struct Nearest<'a> {
    functions: &'a [Function],
    reach: f32,
    least_cosine: f32,
    queries: &'a Columns,
    groups: Vec<(&'a [u32], usize)>,
    out: &'a mut [u32],
}

impl WithSimd for Nearest<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { functions, reach, least_cosine, queries, groups, out } = self;
        let least_cosine = simd.splat_f32s(least_cosine);
        for_each(simd, queries, &groups, |ids, queries, lanes| {
            let mut least = simd.splat_f32s(reach * reach);
            let mut nearest = simd.splat_u32s(NONE);
            for &id in ids {
                let function = &functions[id as usize];
                let offset = offset(simd, function, &queries);
                let distance = dot(simd, offset, offset);
                let is_nearer = simd.less_than_f32s(distance, least);
                if simd.first_true_m32s(is_nearer) >= S::F32_LANES {
                    continue;
                }
                let (is_there, _, cosine) = is_there(simd, function, &queries, offset);
                let is_facing = simd.greater_than_f32s(cosine, least_cosine);
                let is_in_sight = is_in_sight(simd, function, offset);
                let is_it = simd.and_m32s(simd.and_m32s(is_nearer, is_there), simd.and_m32s(is_facing, is_in_sight));
                least = simd.select_f32s(is_it, distance, least);
                nearest = simd.select_u32s(is_it, simd.splat_u32s(id), nearest);
            }
            simd.partial_store_u32s(&mut out[lanes], nearest);
        });
    }
}

/// Calls `visit` with the functions of each group and some of its queries, and which ones those are, until all have been visited.
#[inline(always)]
fn for_each<S: Simd>(
    simd: S,
    queries: &Columns,
    groups: &[(&[u32], usize)],
    mut visit: impl FnMut(&[u32], Lanes<S>, Range<usize>),
) {
    let mut first = 0;
    for &(ids, n_queries) in groups {
        let end = first + n_queries;
        while first < end {
            let lanes = first..end.min(first + S::F32_LANES);
            let load = |column: &Vec<f32>| simd.partial_load_f32s(&column[lanes.clone()]);
            let [x, y, z] = &queries.position;
            let [nx, ny, nz] = &queries.normal;
            let queries = Lanes {
                position: [load(x), load(y), load(z)],
                normal: [load(nx), load(ny), load(nz)],
                free_height: load(&queries.free_height),
            };
            visit(ids, queries, lanes.clone());
            first = lanes.end;
        }
    }
}

/// Queries that are looked at together.
struct Lanes<S: Simd> {
    position: [S::f32s; 3],
    normal: [S::f32s; 3],
    free_height: S::f32s,
}

/// [`Footprint::weight`].
#[inline(always)]
fn weights<S: Simd>(simd: S, function: &Function, footprint: &Footprint, queries: &Lanes<S>) -> S::f32s {
    let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
    let offset = offset(simd, function, queries);
    let straight = dot(simd, offset, offset);
    let (is_there, height, cosine) = is_there(simd, function, queries, offset);
    let depth = simd.mul_f32s(simd.mul_f32s(simd.splat_f32s(8.0), height), height);
    let radial = radial(simd, footprint, simd.add_f32s(straight, depth));
    let weights = simd.mul_f32s(simd.mul_f32s(radial, cosine), cosine);
    let weights = simd.select_f32s(is_there, weights, zero);
    let is_far = simd.greater_than_f32s(simd.mul_f32s(straight, simd.splat_f32s(function.inverse_sight_squared)), one);
    let may_be_hidden = simd.and_m32s(is_far, simd.greater_than_f32s(weights, zero));
    if simd.first_true_m32s(may_be_hidden) >= S::F32_LANES {
        return weights;
    }
    simd.select_f32s(is_in_sight(simd, function, offset), weights, zero)
}

/// From the function to the queries.
#[inline(always)]
fn offset<S: Simd>(simd: S, function: &Function, queries: &Lanes<S>) -> [S::f32s; 3] {
    let from = splat(simd, function.position);
    let [x, y, z] = queries.position;
    [simd.sub_f32s(x, from[0]), simd.sub_f32s(y, from[1]), simd.sub_f32s(z, from[2])]
}

/// Whether queries at these offsets are on the side and within the layer of the function, and below nothing that it has not seen; how
/// high above it they are; the cosine between the normals.
#[inline(always)]
fn is_there<S: Simd>(
    simd: S,
    function: &Function,
    queries: &Lanes<S>,
    offset: [S::f32s; 3],
) -> (S::m32s, S::f32s, S::f32s) {
    let Extent { below, above, sight_height, .. } = function.extent;
    let normal = splat(simd, function.normal);
    let height = dot(simd, offset, normal);
    let cosine = dot(simd, queries.normal, normal);
    let is_above = simd.greater_than_or_equal_f32s(height, simd.splat_f32s(-below));
    let is_below = simd.less_than_or_equal_f32s(height, simd.splat_f32s(above));
    let is_free = simd.greater_than_or_equal_f32s(queries.free_height, simd.splat_f32s(sight_height));
    let is_facing = simd.greater_than_f32s(cosine, simd.splat_f32s(0.0));
    (simd.and_m32s(simd.and_m32s(is_above, is_below), simd.and_m32s(is_free, is_facing)), height, cosine)
}

/// The kernel at these squared distances.
#[inline(always)]
fn radial<S: Simd>(simd: S, footprint: &Footprint, distances_squared: S::f32s) -> S::f32s {
    match footprint.kernel {
        Kernel::Smoothstep => {
            let one = simd.splat_f32s(1.0);
            let h = simd.mul_f32s(simd.sqrt_f32s(distances_squared), simd.splat_f32s(footprint.inverse_support));
            let h = simd.min_f32s(h, one);
            let slope = simd.sub_f32s(simd.splat_f32s(3.0), simd.mul_f32s(simd.splat_f32s(2.0), h));
            simd.sub_f32s(one, simd.mul_f32s(simd.mul_f32s(h, h), slope))
        }
        Kernel::Custom(_) => {
            let mut lanes = distances_squared;
            for lane in bytemuck::cast_slice_mut::<S::f32s, f32>(std::slice::from_mut(&mut lanes)) {
                *lane = footprint.radial_weight(*lane);
            }
            lanes
        }
    }
}

/// Whether nothing hides the offsets from the function along the surface, as [`Extent::contains`] has it.
#[inline(always)]
fn is_in_sight<S: Simd>(simd: S, function: &Function, offset: [S::f32s; 3]) -> S::m32s {
    let depths: &[f32; N_SECTORS] = &function.extent.inverse_depths;
    let zero = simd.splat_f32s(0.0);
    let (x, y) = (dot(simd, offset, splat(simd, function.tangent)), dot(simd, offset, splat(simd, function.bitangent)));
    let is_right = simd.greater_than_or_equal_f32s(x, zero);
    let is_up = simd.greater_than_or_equal_f32s(y, zero);
    let either =
        |mask, yes: usize, no: usize| simd.select_f32s(mask, simd.splat_f32s(depths[yes]), simd.splat_f32s(depths[no]));
    let (along_x, along_y) = (either(is_right, 0, 4), either(is_up, 2, 6));
    let diagonal = simd.select_f32s(is_up, either(is_right, 1, 3), either(is_right, 7, 5));
    let (x, y) = (simd.abs_f32s(x), simd.abs_f32s(y));
    let is_along_x = simd.greater_than_or_equal_f32s(x, y);
    let (long, short) = (simd.select_f32s(is_along_x, x, y), simd.select_f32s(is_along_x, y, x));
    let step = simd.mul_f32s(simd.splat_f32s(std::f32::consts::SQRT_2), short);
    let straight = simd.mul_f32s(simd.sub_f32s(long, short), simd.select_f32s(is_along_x, along_x, along_y));
    let part = simd.add_f32s(straight, simd.mul_f32s(step, diagonal));
    simd.less_than_or_equal_f32s(part, simd.splat_f32s(1.0))
}

#[inline(always)]
fn splat<S: Simd>(simd: S, v: Vec3) -> [S::f32s; 3] {
    [simd.splat_f32s(v.x), simd.splat_f32s(v.y), simd.splat_f32s(v.z)]
}

#[inline(always)]
fn dot<S: Simd>(simd: S, a: [S::f32s; 3], b: [S::f32s; 3]) -> S::f32s {
    let xy = simd.add_f32s(simd.mul_f32s(a[0], b[0]), simd.mul_f32s(a[1], b[1]));
    simd.add_f32s(xy, simd.mul_f32s(a[2], b[2]))
}

#[cfg(test)]
mod tests {
    use hplt_geom::RegionId;

    use super::*;
    use crate::cells::tests::numbers;

    /// One lane or many, whatever the processor has: the same bits.
    #[test]
    fn processors_agree_to_the_bit() {
        let mut next = numbers(5);
        let mut point = |i: usize| {
            let position = Vec3::new(next(), next(), 0.3 * next()) - 0.5;
            let normal = (Vec3::new(next(), next(), 2.0 * next()) - 0.3).normalize();
            let mut extent = Extent::of_query(0.5 * next());
            if i < 60 {
                extent.inverse_depths = [(); N_SECTORS].map(|()| (8.0 * next() - 3.0).max(0.0));
                extent.sight_height = 0.05 * next();
            }
            OrientedPoint { extent, ..OrientedPoint::new(position, normal, RegionId(0)) }
        };
        let points: Vec<OrientedPoint> = (0..160).map(&mut point).collect();
        let functions: Vec<Function> = points[..60].iter().map(Function::of).collect();
        let coefficients: Vec<Rgb> = points[..60].iter().map(|p| p.position + 1.0).collect();
        let queries = Columns::new(points[60..].iter());
        let ids: Vec<u32> = (0..60).collect();
        for kernel in [Kernel::Smoothstep, Kernel::Custom(|h| (1.0 - h).max(0.0))] {
            let footprint = Footprint { support: 0.6, inverse_support: 1.0 / 0.6, kernel };
            let groups = || vec![(&ids[..], 37), (&ids[10..], 1), (&ids[..40], 62)];
            let wide = sums(&functions, &footprint, &coefficients, &queries, groups());
            let mut narrow = [(); 4].map(|()| vec![0.0; 100]);
            let (functions, coefficients) = (&functions[..], &coefficients[..]);
            let (footprint, queries) = (&footprint, &queries);
            let sums = Sums { functions, footprint, coefficients, queries, groups: groups(), out: &mut narrow };
            sums.with_simd(pulp::Scalar::new());
            assert_eq!(wide, narrow);
            assert!(wide[3].iter().filter(|sum| **sum > 0.0).count() > 50, "{:?}", wide[3]);
        }
        let groups = || vec![(&ids[..], 37), (&ids[10..], 1), (&ids[..40], 62)];
        let (reach, least_cosine) = (0.4, 0.5);
        let wide = nearest(&functions, (reach, least_cosine), &queries, groups());
        let mut narrow = vec![NONE; 100];
        let (functions, queries, out) = (&functions[..], &queries, &mut narrow[..]);
        Nearest { functions, reach, least_cosine, queries, groups: groups(), out }.with_simd(pulp::Scalar::new());
        assert_eq!(wide, narrow);
        let n_found = wide.iter().filter(|found| **found != NONE).count();
        assert!((20..100).contains(&n_found), "{n_found}");
    }
}
