//! The watertight ray-triangle test of Woop, Benthin & Wald ("Watertight Ray/Triangle Intersection", JCGT 2013), eight
//! triangles at a time.
//!
//! Corners are stored in a canonical order, so that two triangles with the same corners report bit-equal distances
//! whatever their winding: coincident walls back to back then tie, and the tie rule decides.

use glam::Vec3;

use crate::{Hit, TriangleId};

/// Corner indices of the six orders; the odd half are mirrored.
const ORDERS: [[u8; 3]; 6] = [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [1, 0, 2], [2, 1, 0]];
const FIRST_MIRRORED: u32 = 3;

/// Eight triangles. Unused lanes are NaN, which no comparison accepts.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(32))]
pub(super) struct Packet {
    /// `corners[corner][axis][lane]`.
    corners: [[[f32; Self::LANES]; 3]; 3],
    meta: [u32; Self::LANES],
}

impl Packet {
    pub(super) const LANES: usize = 8;
    pub(super) const EMPTY: Self = Self { corners: [[[f32::NAN; Self::LANES]; 3]; 3], meta: [0; Self::LANES] };

    const ID_BITS: u32 = 28;
    const ID_MASK: u32 = (1 << Self::ID_BITS) - 1;
    const MASKED: u32 = 1 << 31;

    pub(super) fn set(&mut self, lane: usize, id: TriangleId, corners: [Vec3; 3], is_masked: bool) {
        assert!(id.0 <= Self::ID_MASK, "a scene has at most 200 million triangles");
        let order = canonical_order(corners);
        for (corner, &from) in ORDERS[order].iter().enumerate() {
            for (row, x) in self.corners[corner].iter_mut().zip(corners[from as usize].to_array()) {
                row[lane] = x;
            }
        }
        let masked = if is_masked { Self::MASKED } else { 0 };
        self.meta[lane] = id.0 | ((order as u32) << Self::ID_BITS) | masked;
    }

    pub(super) fn id(&self, lane: usize) -> TriangleId {
        TriangleId(self.meta[lane] & Self::ID_MASK)
    }

    pub(super) fn is_masked(&self, lane: usize) -> bool {
        self.meta[lane] & Self::MASKED != 0
    }

    /// Coordinates by corner, axis and lane.
    pub(super) fn rows(&self) -> &[[[f32; Self::LANES]; 3]; 3] {
        &self.corners
    }

    pub(super) fn corners(&self, lane: usize) -> [Vec3; 3] {
        self.corners.each_ref().map(|[x, y, z]| Vec3::new(x[lane], y[lane], z[lane]))
    }

    fn order(&self, lane: usize) -> u32 {
        (self.meta[lane] >> Self::ID_BITS) & 7
    }
}

/// Which of [`ORDERS`] sorts the corners by x, then y, then z.
fn canonical_order(corners: [Vec3; 3]) -> usize {
    let is_sorted = |order: &[u8; 3]| {
        let [a, b, c] = order.map(|i| corners[i as usize].to_array());
        a <= b && b <= c
    };
    ORDERS.iter().position(is_sorted).expect("finite corners can be sorted")
}

/// What the test needs to know of a ray.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shear {
    origin: [f32; 3],
    /// Axes; the last one is where the direction is longest.
    axes: [usize; 3],
    /// `d_x/d_z`, `d_y/d_z`, `1/d_z`.
    scale: [f32; 3],
}

impl Shear {
    #[inline(always)]
    pub(super) fn new(origin: Vec3, direction: Vec3) -> Self {
        let d = direction.to_array();
        let a = direction.abs();
        let z = if a.x >= a.y && a.x >= a.z {
            0
        } else if a.y >= a.z {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        let o = origin.to_array();
        Self { origin: [o[x], o[y], o[z]], axes: [x, y, z], scale: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]] }
    }
}

/// Results of a packet. Lane `i` is a hit when bit `i` of `mask` is set; its distance is then `t[i]`.
#[derive(Debug, Clone, Copy)]
pub(super) struct PacketHits {
    pub(super) mask: u32,
    pub(super) t: Lanes,
    /// Unnormalised barycentric weights in canonical order.
    weights: [Lanes; 3],
    det: Lanes,
}

type Lanes = [f32; Packet::LANES];

#[inline(always)]
fn zip(a: Lanes, b: Lanes, f: impl Fn(f32, f32) -> f32) -> Lanes {
    std::array::from_fn(|i| f(a[i], b[i]))
}

#[inline(always)]
fn edge(a: [Lanes; 3], b: [Lanes; 3]) -> Lanes {
    let p = zip(a[0], b[1], |x, y| x * y);
    let q = zip(a[1], b[0], |x, y| x * y);
    zip(p, q, |p, q| p - q)
}

/// Tests a ray against a packet. Hits at `0 <= t < t_end` or, so that the tie rule can be applied, `t == t_end` count.
#[inline(always)]
pub(super) fn test_packet(packet: &Packet, shear: &Shear, t_end: f32) -> PacketHits {
    let [a, b, c] = std::array::from_fn(|corner| sheared(&packet.corners[corner], shear));
    let u = edge(c, b);
    let v = edge(a, c);
    let w = edge(b, a);
    let det = zip(zip(u, v, |u, v| u + v), w, |s, w| s + w);
    let depth = |weight: Lanes, corner: [Lanes; 3]| zip(weight, corner[2], |x, z| x * z);
    let t_scaled = zip(zip(depth(u, a), depth(v, b), |x, y| x + y), depth(w, c), |s, z| s + z);
    // Adding zero turns -0 into 0.
    let t = zip(t_scaled, det, |t, det| t / det + 0.0);
    let mut hits = PacketHits { mask: 0, t, weights: [u, v, w], det };
    let mut unsure = 0;
    for i in 0..Packet::LANES {
        let inside = ((u[i] >= 0.0) & (v[i] >= 0.0) & (w[i] >= 0.0)) | ((u[i] <= 0.0) & (v[i] <= 0.0) & (w[i] <= 0.0));
        let on_edge = (u[i] == 0.0) | (v[i] == 0.0) | (w[i] == 0.0);
        let in_range = (t[i] >= 0.0) & (t[i] <= t_end) & (det[i] != 0.0);
        hits.mask |= u32::from(inside & in_range) << i;
        unsure |= u32::from(inside & on_edge) << i;
    }
    if unsure != 0 {
        settle(&mut hits, unsure, [a, b, c], t_end);
    }
    hits
}

/// [`test_packet`] in AVX.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
pub(super) fn test_packet_avx2(packet: &Packet, shear: &Shear, t_end: f32) -> PacketHits {
    use std::arch::x86_64::{
        __m256, _CMP_EQ_OQ, _CMP_GE_OQ, _CMP_LE_OQ, _CMP_NEQ_OQ, _mm256_add_ps, _mm256_and_ps, _mm256_cmp_ps,
        _mm256_div_ps, _mm256_max_ps, _mm256_min_ps, _mm256_movemask_ps, _mm256_mul_ps, _mm256_or_ps, _mm256_set1_ps,
        _mm256_setzero_ps, _mm256_sub_ps,
    };
    const NONE: Lanes = [0.0; Packet::LANES];
    let zero = _mm256_setzero_ps();
    let origin = shear.origin.map(|x| _mm256_set1_ps(x));
    let scale = shear.scale.map(|x| _mm256_set1_ps(x));
    let sheared = |corner: &[Lanes; 3]| -> [__m256; 3] {
        let local = |i: usize| _mm256_sub_ps(bytemuck::cast(corner[shear.axes[i]]), origin[i]);
        let z = local(2);
        let skew = |i: usize| _mm256_sub_ps(local(i), _mm256_mul_ps(scale[i], z));
        [skew(0), skew(1), _mm256_mul_ps(z, scale[2])]
    };
    let edge = |a: [__m256; 3], b: [__m256; 3]| _mm256_sub_ps(_mm256_mul_ps(a[0], b[1]), _mm256_mul_ps(a[1], b[0]));
    let [a, b, c] = [sheared(&packet.corners[0]), sheared(&packet.corners[1]), sheared(&packet.corners[2])];
    let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
    let least = _mm256_min_ps(_mm256_min_ps(u, v), w);
    let most = _mm256_max_ps(_mm256_max_ps(u, v), w);
    let inside = _mm256_or_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(least, zero), _mm256_cmp_ps::<_CMP_LE_OQ>(most, zero));
    let cast = |x: __m256| -> Lanes { bytemuck::cast(x) };
    if _mm256_movemask_ps(inside) == 0 {
        return PacketHits { mask: 0, t: NONE, weights: [NONE; 3], det: NONE };
    }
    let det = _mm256_add_ps(_mm256_add_ps(u, v), w);
    let t_scaled = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(u, a[2]), _mm256_mul_ps(v, b[2])), _mm256_mul_ps(w, c[2]));
    // Adding zero turns -0 into 0.
    let t = _mm256_add_ps(_mm256_div_ps(t_scaled, det), zero);
    let in_range =
        _mm256_and_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(t, zero), _mm256_cmp_ps::<_CMP_LE_OQ>(t, _mm256_set1_ps(t_end)));
    let hit = _mm256_and_ps(_mm256_and_ps(inside, in_range), _mm256_cmp_ps::<_CMP_NEQ_OQ>(det, zero));
    let is_zero = |x: __m256| _mm256_cmp_ps::<_CMP_EQ_OQ>(x, zero);
    let on_edge = _mm256_or_ps(_mm256_or_ps(is_zero(u), is_zero(v)), is_zero(w));
    let unsure = _mm256_movemask_ps(_mm256_and_ps(inside, on_edge)) as u32;
    let mut hits = PacketHits {
        mask: _mm256_movemask_ps(hit) as u32,
        t: cast(t),
        weights: [cast(u), cast(v), cast(w)],
        det: cast(det),
    };
    if unsure != 0 {
        settle(&mut hits, unsure, [a, b, c].map(|corner| corner.map(cast)), t_end);
    }
    hits
}

/// Corners relative to the ray, in the space where it runs along +z from the origin.
#[inline(always)]
fn sheared(corner: &[Lanes; 3], shear: &Shear) -> [Lanes; 3] {
    let local = |i: usize| corner[shear.axes[i]].map(|x| x - shear.origin[i]);
    let z = local(2);
    let skew = |i: usize| zip(local(i), z, |x, z| x - shear.scale[i] * z);
    [skew(0), skew(1), z.map(|z| z * shear.scale[2])]
}

/// Decides the lanes where a rounded edge function is zero: in `f64` the products are exact, hence the sign is.
#[cold]
#[inline(never)]
fn settle(hits: &mut PacketHits, unsure: u32, corners: [[Lanes; 3]; 3], t_end: f32) {
    for lane in (0..Packet::LANES).filter(|lane| unsure & (1 << lane) != 0) {
        hits.mask &= !(1 << lane);
        let [a, b, c] = corners.map(|corner| corner.map(|x| f64::from(x[lane])));
        let edge = |p: [f64; 3], q: [f64; 3]| p[0] * q[1] - p[1] * q[0];
        let (u, v, w) = (edge(c, b), edge(a, c), edge(b, a));
        let inside = u.min(v).min(w) >= 0.0 || u.max(v).max(w) <= 0.0;
        let det = u + v + w;
        if !inside || det == 0.0 {
            continue;
        }
        let t = ((u * a[2] + v * b[2] + w * c[2]) / det) as f32 + 0.0;
        if t >= 0.0 && t <= t_end {
            hits.mask |= 1 << lane;
            hits.t[lane] = t;
            hits.det[lane] = det.signum() as f32;
            for (weight, value) in hits.weights.iter_mut().zip([u, v, w]) {
                weight[lane] = (value / det.abs()) as f32;
            }
        }
    }
}

impl PacketHits {
    /// The hit in a lane whose bit is set.
    #[inline(always)]
    pub(super) fn hit(&self, packet: &Packet, lane: usize) -> Hit {
        let order = packet.order(lane);
        let det = self.det[lane];
        let mut weights = [0.0; 3];
        for (weight, &corner) in self.weights.iter().zip(&ORDERS[order as usize]) {
            weights[corner as usize] = weight[lane] / det;
        }
        Hit {
            t: self.t[lane],
            u: weights[1],
            v: weights[2],
            triangle: packet.id(lane),
            is_front: (det > 0.0) != (order >= FIRST_MIRRORED),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether a ray along +z through the origin hits the triangle with these corners in the plane z = 1.
    fn is_hit(corners: [[f32; 2]; 3]) -> bool {
        let mut packet = Packet::EMPTY;
        packet.set(0, TriangleId(0), corners.map(|[x, y]| Vec3::new(x, y, 1.0)), false);
        test_packet(&packet, &Shear::new(Vec3::ZERO, Vec3::Z), f32::INFINITY).mask == 1
    }

    #[test]
    fn an_edge_function_that_rounds_to_zero_is_decided_exactly() {
        // The ray passes the edge bc at a distance of about 2⁻²⁶, which the rounded products do not see.
        let e = 2f32.powi(-13);
        let (b, c) = ([-1.0, -(1.0 - e)], [1.0 + e, 1.0]);
        assert_eq!(c[0] * b[1] - c[1] * b[0], 0.0);
        assert!(is_hit([[1.0, -1.0], b, c]));
        assert!(!is_hit([[-1.0, 1.0], b, c]));
    }

    #[test]
    fn a_ray_exactly_through_an_edge_or_a_vertex_hits_all_its_triangles() {
        let (b, c) = ([-1.0, -1.0], [1.0, 1.0]);
        assert!(is_hit([[1.0, -1.0], b, c]) && is_hit([[-1.0, 1.0], b, c]));
        assert!(is_hit([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) && is_hit([[0.0, 0.0], [-1.0, 0.0], [0.0, -1.0]]));
        assert!(!is_hit([[0.5, 0.5], [1.0, 0.0], [0.0, 1.0]]));
        assert!(!is_hit([b, [0.0, 0.0], c]), "a triangle seen edge-on has no area");
    }
}
