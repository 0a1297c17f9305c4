//! Ordered traversal. The slab test is that of Ize ("Robust BVH Ray Traversal", JCGT 2013): the far distance is enlarged by
//! a few units in the last place, so that a box is never missed by rounding, and a zero direction component gives either an
//! infinity with the right sign or a NaN that leaves the interval as it is.

use glam::Vec3;

use super::alpha::Cutouts;
use super::batch::coherent_order;
use super::triangle::{Packet, PacketHits, Shear};
use super::wide::{Child, Node, WIDTH, WideTree};
use crate::{Hit, Ray};

/// Enlarges far distances. The slab test errs by 3 half-units in the last place and the triangle test by as many as 4
/// where its error grows with distance; this is 8 of them.
const WIDEN: f32 = 1.0 + 8.0 * f32::EPSILON;

/// What rays are traced against.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) tree: &'a WideTree,
    pub(super) cutouts: &'a Cutouts,
}

/// A child that is still to be visited, and where the ray enters it.
#[derive(Debug, Clone, Copy)]
struct Entry {
    t: f32,
    child: Child,
}

const NO_ENTRY: Entry = Entry { t: f32::INFINITY, child: Child::NONE };

/// A ray as the traversal uses it.
pub(super) struct Probe {
    shear: Shear,
    origin: [f32; 3],
    inverse: [f32; 3],
    /// Rows of [`Node::planes`] that the ray meets first, then those that it meets last, per axis.
    near: [usize; 3],
    far: [usize; 3],
    t_max: f32,
    /// Distances of the probe times this are distances of the ray.
    t_scale: f64,
}

impl Probe {
    /// `None` for a ray that is a miss by contract.
    #[inline(always)]
    fn new(ray: &Ray) -> Option<Self> {
        let longest = ray.direction.abs().max_element();
        // NaN fails every comparison.
        if !(ray.origin.is_finite() && ray.direction.is_finite() && longest > 0.0 && ray.t_max > 0.0) {
            return None;
        }
        let (direction, t_max, t_scale) =
            if (1e-6..1e6).contains(&longest) { (ray.direction, ray.t_max, 1.0) } else { rescaled(ray, longest) };
        let is_negative = direction.to_array().map(f32::is_sign_negative);
        Some(Self {
            shear: Shear::new(ray.origin, direction),
            origin: ray.origin.to_array(),
            inverse: direction.recip().to_array(),
            near: std::array::from_fn(|axis| if is_negative[axis] { axis + 3 } else { axis }),
            far: std::array::from_fn(|axis| if is_negative[axis] { axis } else { axis + 3 }),
            t_max,
            t_scale,
        })
    }

    fn ray_distance(&self, t: f32) -> f32 {
        if self.t_scale == 1.0 { t } else { ((f64::from(t) * self.t_scale) as f32).min(f32::MAX) }
    }
}

/// Direction and `t_max` with the direction scaled by a power of two to a length near 1, and that power, so that neither its
/// reciprocal nor the shear can overflow.
#[cold]
fn rescaled(ray: &Ray, longest: f32) -> (Vec3, f32, f64) {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    let t_scale = 1.0 / f64::from_bits(f64::from(longest).to_bits() & EXPONENT);
    let t_max = (f64::from(ray.t_max) / t_scale) as f32;
    ((ray.direction.as_dvec3() * t_scale).as_vec3(), t_max, t_scale)
}

/// The two vectorised operations. They are arguments, so that the same traversal can be compiled for several instruction
/// sets.
pub(super) struct Kernels<E, T> {
    /// See [`enter`].
    pub(super) enter: E,
    /// See [`test_packet`](super::triangle::test_packet).
    pub(super) test: T,
}

/// Traces a batch and gives the index of every ray and what it met: the nearest hit, or with `ANY` the first one found.
#[inline(always)]
pub(super) fn trace<const ANY: bool, E, T>(
    kernels: &Kernels<E, T>,
    target: Target<'_>,
    rays: &[Ray],
    mut give: impl FnMut(usize, Hit),
) where
    E: Fn(&Node, &Probe, f32) -> (u32, [f32; WIDTH]),
    T: Fn(&Packet, &Shear, f32) -> PacketHits,
{
    let mut stack = vec![NO_ENTRY; target.tree.stack_size()];
    let mut guess = Child::NONE;
    let order = coherent_order(rays);
    for i in 0..rays.len() {
        let i = order.as_ref().map_or(i, |order| order[i] as usize);
        let found = match Probe::new(&rays[i]) {
            Some(probe) if !target.tree.nodes.is_empty() => {
                walk::<ANY, E, T>(kernels, target, &probe, &mut guess, &mut stack)
            }
            _ => Hit::MISS,
        };
        give(i, found);
    }
}

/// What a ray meets. It begins with the leaf that is guessed, so that most of the tree is out of range from the start; the
/// guess becomes the leaf of the hit.
#[inline(always)]
fn walk<const ANY: bool, E, T>(
    kernels: &Kernels<E, T>,
    target: Target<'_>,
    probe: &Probe,
    guess: &mut Child,
    stack: &mut [Entry],
) -> Hit
where
    E: Fn(&Node, &Probe, f32) -> (u32, [f32; WIDTH]),
    T: Fn(&Packet, &Shear, f32) -> PacketHits,
{
    let mut best = Hit { t: probe.t_max, ..Hit::MISS };
    stack[0] = Entry { t: 0.0, child: Child::ROOT };
    let (mut child, mut n) = if *guess == Child::NONE { (Child::ROOT, 0) } else { (*guess, 1) };
    let (seed, mut tested) = (*guess, Child::NONE);
    loop {
        if child.is_leaf() {
            if child != tested && test_leaf::<ANY, E, T>(kernels, target, probe, child, &mut best) {
                *guess = child;
                if ANY {
                    return best;
                }
            }
            tested = seed;
        } else {
            let node = &target.tree.nodes[child.node_index()];
            let (mask, entry) = (kernels.enter)(node, probe, best.t * WIDEN);
            if mask != 0 {
                child = descend(node, mask, &entry, stack, &mut n);
                continue;
            }
        }
        let limit = best.t * WIDEN;
        loop {
            if n == 0 {
                return if best.is_miss() { Hit::MISS } else { Hit { t: probe.ray_distance(best.t), ..best } };
            }
            n -= 1;
            if ANY || stack[n].t <= limit {
                child = stack[n].child;
                break;
            }
        }
    }
}

/// Whether a leaf has a hit that is better than `best`, which becomes it; with `ANY`, whichever is found first.
#[inline(always)]
fn test_leaf<const ANY: bool, E, T>(
    kernels: &Kernels<E, T>,
    target: Target<'_>,
    probe: &Probe,
    leaf: Child,
    best: &mut Hit,
) -> bool
where
    E: Fn(&Node, &Probe, f32) -> (u32, [f32; WIDTH]),
    T: Fn(&Packet, &Shear, f32) -> PacketHits,
{
    let packet = &target.tree.packets[leaf.packet_index()];
    let hits = (kernels.test)(packet, &probe.shear, best.t);
    let mut is_better = false;
    for lane in set_bits(hits.mask) {
        if ANY && hits.t[lane] < best.t && !packet.is_masked(lane) {
            best.triangle = packet.id(lane);
            return true;
        }
        if hits.t[lane] > best.t {
            continue;
        }
        let hit = hits.hit(packet, lane);
        if wins(&hit, best) && is_there(target.cutouts, packet.is_masked(lane), &hit) {
            *best = hit;
            is_better = true;
            if ANY {
                break;
            }
        }
    }
    is_better
}

/// The nearest of the children whose bits are set, not none; the others go on the stack, the nearest on top.
#[inline(always)]
fn descend(node: &Node, mut mask: u32, entry: &[f32; WIDTH], stack: &mut [Entry], n: &mut usize) -> Child {
    let mut take = || {
        let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
        mask &= mask - 1;
        (Entry { t: entry[lane], child: node.children[lane] }, mask == 0)
    };
    let (a, is_last) = take();
    if is_last {
        return a.child;
    }
    let (b, is_last) = take();
    let (mut nearest, far) = if b.t < a.t { (b, a) } else { (a, b) };
    let first = *n;
    stack[first] = far;
    *n += 1;
    if is_last {
        return nearest.child;
    }
    loop {
        let (mut new, is_last) = take();
        if new.t < nearest.t {
            std::mem::swap(&mut new, &mut nearest);
        }
        let mut at = *n;
        while at > first && stack[at - 1].t < new.t {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = new;
        *n += 1;
        if is_last {
            return nearest.child;
        }
    }
}

/// The positions of the bits that are set, ascending.
#[inline(always)]
fn set_bits(mut mask: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (mask != 0).then(|| {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            lane
        })
    })
}

/// Whether `hit` is to be preferred: nearer, or as near and on the front where the other is not, or of a lower id.
#[inline(always)]
fn wins(hit: &Hit, best: &Hit) -> bool {
    if hit.t != best.t {
        return hit.t < best.t;
    }
    !best.is_miss() && (!hit.is_front, hit.triangle) < (!best.is_front, best.triangle)
}

#[inline(always)]
fn is_there(cutouts: &Cutouts, is_masked: bool, hit: &Hit) -> bool {
    !is_masked || cutouts.is_opaque_at(hit.triangle, hit.u, hit.v)
}

/// Which children the ray enters before `t_end`, one bit each, and where.
#[inline(always)]
pub(super) fn enter(node: &Node, probe: &Probe, t_end: f32) -> (u32, [f32; WIDTH]) {
    let mut entry = [0.0f32; WIDTH];
    let mut exit = [f32::INFINITY; WIDTH];
    for axis in 0..3 {
        let (near, far) = (&node.planes[probe.near[axis]], &node.planes[probe.far[axis]]);
        for lane in 0..WIDTH {
            let t_near = (near[lane] - probe.origin[axis]) * probe.inverse[axis];
            let t_far = (far[lane] - probe.origin[axis]) * probe.inverse[axis];
            // These keep what they have when the distance is NaN.
            entry[lane] = if t_near > entry[lane] { t_near } else { entry[lane] };
            exit[lane] = if t_far < exit[lane] { t_far } else { exit[lane] };
        }
    }
    let mut mask = 0;
    for lane in 0..WIDTH {
        mask |= u32::from(entry[lane] <= (exit[lane] * WIDEN).min(t_end)) << lane;
    }
    (mask, entry)
}

/// [`enter`] in AVX.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn enter_avx2(node: &Node, probe: &Probe, t_end: f32) -> (u32, [f32; WIDTH]) {
    use std::arch::x86_64::{
        __m256, _CMP_LE_OQ, _mm256_cmp_ps, _mm256_max_ps, _mm256_min_ps, _mm256_movemask_ps, _mm256_mul_ps,
        _mm256_set1_ps, _mm256_sub_ps,
    };
    let mut entry = _mm256_set1_ps(0.0);
    let mut exit = _mm256_set1_ps(f32::INFINITY);
    for axis in 0..3 {
        let origin = _mm256_set1_ps(probe.origin[axis]);
        let inverse = _mm256_set1_ps(probe.inverse[axis]);
        let distance =
            |row: usize| -> __m256 { _mm256_mul_ps(_mm256_sub_ps(bytemuck::cast(node.planes[row]), origin), inverse) };
        // Both return their second operand when the first is NaN.
        entry = _mm256_max_ps(distance(probe.near[axis]), entry);
        exit = _mm256_min_ps(distance(probe.far[axis]), exit);
    }
    let exit = _mm256_min_ps(_mm256_mul_ps(exit, _mm256_set1_ps(WIDEN)), _mm256_set1_ps(t_end));
    let mask = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit));
    (mask as u32, bytemuck::cast(entry))
}
