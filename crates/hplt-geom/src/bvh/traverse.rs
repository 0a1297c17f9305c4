//! Ordered traversal. The slab test is that of Ize ("Robust BVH Ray Traversal", JCGT 2013): the far distance is enlarged by
//! a few units in the last place, so that a box is never missed by rounding, and a zero direction component gives either an
//! infinity with the right sign or a NaN that leaves the interval as it is.

use glam::Vec3;

use super::alpha::Cutouts;
use super::triangle::{Shear, test_packet};
use super::wide::{Child, Node, WIDTH, WideTree};
use crate::{Hit, Ray};

/// Enlarges far distances. The slab test errs by 3 half-units in the last place and the triangle test by as many as 4
/// where its error grows with distance; this is 8 of them.
const WIDEN: f32 = 1.0 + 8.0 * f32::EPSILON;

/// A child that is still to be visited, and where the ray enters it.
#[derive(Debug, Clone, Copy)]
struct Entry {
    t: f32,
    child: Child,
}

const NO_ENTRY: Entry = Entry { t: f32::INFINITY, child: Child::NONE };

/// A ray as the traversal uses it.
struct Probe {
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

pub(super) fn trace_nearest(tree: &WideTree, cutouts: &Cutouts, rays: &[Ray], hits: &mut [Hit]) {
    let mut stack = vec![NO_ENTRY; tree.stack_size()];
    for (ray, hit) in rays.iter().zip(hits) {
        *hit = Probe::new(ray).map_or(Hit::MISS, |probe| nearest(tree, cutouts, &probe, &mut stack));
    }
}

pub(super) fn trace_occluded(tree: &WideTree, cutouts: &Cutouts, rays: &[Ray], occluded: &mut [bool]) {
    let mut stack = vec![NO_ENTRY; tree.stack_size()];
    for (ray, is_occluded) in rays.iter().zip(occluded) {
        *is_occluded = Probe::new(ray).is_some_and(|probe| any(tree, cutouts, &probe, &mut stack));
    }
}

#[inline(always)]
fn nearest(tree: &WideTree, cutouts: &Cutouts, probe: &Probe, stack: &mut [Entry]) -> Hit {
    if tree.nodes.is_empty() {
        return Hit::MISS;
    }
    let mut best = Hit { t: probe.t_max, ..Hit::MISS };
    stack[0] = Entry { t: 0.0, child: Child::ROOT };
    let mut n = 1;
    while n > 0 {
        n -= 1;
        let Entry { t, child } = stack[n];
        if t > best.t * WIDEN {
            continue;
        }
        if child.is_leaf() {
            for packet in &tree.packets[child.packets()] {
                let hits = test_packet(packet, &probe.shear, best.t);
                let mut mask = hits.mask;
                while mask != 0 {
                    let lane = mask.trailing_zeros() as usize;
                    mask &= mask - 1;
                    if hits.t[lane] > best.t {
                        continue;
                    }
                    let hit = hits.hit(packet, lane);
                    if wins(&hit, &best) && is_there(cutouts, packet.is_masked(lane), &hit) {
                        best = hit;
                    }
                }
            }
            continue;
        }
        let node = &tree.nodes[child.node_index()];
        let (mut mask, entry) = enter(node, probe, best.t * WIDEN);
        let first = n;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let new = Entry { t: entry[lane], child: node.children[lane] };
            // Keep the nearest on top.
            let mut at = n;
            while at > first && stack[at - 1].t < new.t {
                stack[at] = stack[at - 1];
                at -= 1;
            }
            stack[at] = new;
            n += 1;
        }
    }
    if best.is_miss() { Hit::MISS } else { Hit { t: probe.ray_distance(best.t), ..best } }
}

#[inline(always)]
fn any(tree: &WideTree, cutouts: &Cutouts, probe: &Probe, stack: &mut [Entry]) -> bool {
    if tree.nodes.is_empty() {
        return false;
    }
    stack[0] = Entry { t: 0.0, child: Child::ROOT };
    let mut n = 1;
    while n > 0 {
        n -= 1;
        let child = stack[n].child;
        if child.is_leaf() {
            for packet in &tree.packets[child.packets()] {
                let hits = test_packet(packet, &probe.shear, probe.t_max);
                for lane in (0..4).filter(|lane| hits.mask & (1 << lane) != 0) {
                    let blocks = !packet.is_masked(lane) || is_there(cutouts, true, &hits.hit(packet, lane));
                    if hits.t[lane] < probe.t_max && blocks {
                        return true;
                    }
                }
            }
            continue;
        }
        let node = &tree.nodes[child.node_index()];
        let (mut mask, entry) = enter(node, probe, probe.t_max * WIDEN);
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            stack[n] = Entry { t: entry[lane], child: node.children[lane] };
            n += 1;
        }
    }
    false
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
fn enter(node: &Node, probe: &Probe, t_end: f32) -> (u32, [f32; WIDTH]) {
    let mut entry = [0.0f32; WIDTH];
    let mut exit = [t_end; WIDTH];
    for axis in 0..3 {
        let (near, far) = (&node.planes[probe.near[axis]], &node.planes[probe.far[axis]]);
        for lane in 0..WIDTH {
            let t_near = (near[lane] - probe.origin[axis]) * probe.inverse[axis];
            let t_far = (far[lane] - probe.origin[axis]) * probe.inverse[axis] * WIDEN;
            // These keep the second operand when the first is NaN.
            entry[lane] = if t_near > entry[lane] { t_near } else { entry[lane] };
            exit[lane] = if t_far < exit[lane] { t_far } else { exit[lane] };
        }
    }
    let mut mask = 0;
    for lane in 0..WIDTH {
        mask |= u32::from(entry[lane] <= exit[lane]) << lane;
    }
    (mask, entry)
}
