//! A four-wide bounding volume hierarchy with padded `f32` boxes and `f64` triangle tests.

use hplt_geom::glam::{DVec3, Vec3, Vec4};
use hplt_geom::{Scene, TriangleId};

use super::tree_build::{Binary, Bounds, Item, build};
use super::triangle::{Crossing, ShearedRay, nearest_weights};

/// Added to every box on every side, scene units: twice the rounding of a box test within the scene.
const PADDING: f32 = 1e-6;
/// Widens the slabs for rays that start far away.
const SLACK: f32 = 1.0 + 1e-6;
/// Hits nearer than this are the surface that the ray left: rounding of an origin in `f64`, over the cosine of a grazing ray.
pub(super) const T_MIN: f64 = 1e-12;
/// Hits whose distances agree this well are the same place.
const TIE: f64 = 1e-12;
const EMPTY: u32 = u32::MAX;
const LEAF: u32 = 1 << 31;

#[derive(Debug)]
pub(super) struct Tree {
    nodes: Vec<Node>,
    triangles: Vec<LeafTriangle>,
}

#[derive(Debug, Clone, Copy)]
struct Node {
    min: [Vec4; 3],
    max: [Vec4; 3],
    /// A node index, or `LEAF | first << 2 | count - 1`, or `EMPTY`.
    children: [u32; 4],
    /// One bit per slot in use.
    used: u32,
}

#[derive(Debug, Clone, Copy)]
struct LeafTriangle {
    corners: [Vec3; 3],
    id: TriangleId,
    /// Whether an alpha mask has to be asked.
    masked: bool,
}

/// Where a ray meets the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct Meeting {
    pub(super) crossing: Crossing,
    pub(super) triangle: TriangleId,
}

/// A ray as the boxes see it.
struct BoxRay {
    origin: [Vec4; 3],
    inverse: [Vec4; 3],
}

impl Tree {
    pub(super) fn build(scene: &Scene) -> Self {
        let mesh = scene.mesh();
        let mut items: Vec<Item> = (0..mesh.n_triangles() as u32)
            .map(|triangle| {
                let [a, b, c] = mesh.corners(TriangleId(triangle));
                Item { bounds: Bounds { min: a.min(b).min(c), max: a.max(b).max(c) }, triangle }
            })
            .collect();
        let mut tree = Self { nodes: Vec::new(), triangles: Vec::with_capacity(items.len()) };
        if !items.is_empty() {
            let root = build(&mut items, 0);
            tree.flatten(&root, scene);
        }
        tree
    }

    pub(super) fn memory(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.triangles[..])
    }

    /// Appends the four-wide node that stands for `binary` and its children, and returns its index.
    fn flatten(&mut self, binary: &Binary, scene: &Scene) -> u32 {
        let index = self.nodes.len();
        let (min, max) = ([Vec4::INFINITY; 3], [Vec4::NEG_INFINITY; 3]);
        self.nodes.push(Node { min, max, children: [EMPTY; 4], used: 0 });
        for (slot, child) in widened(binary).into_iter().enumerate() {
            let bounds = child.bounds();
            let node = &mut self.nodes[index];
            for axis in 0..3 {
                node.min[axis][slot] = bounds.min[axis] - PADDING;
                node.max[axis][slot] = bounds.max[axis] + PADDING;
            }
            let code = match child {
                Binary::Leaf { triangles, .. } => self.push_leaf(triangles, scene),
                Binary::Inner { .. } => self.flatten(child, scene),
            };
            self.nodes[index].children[slot] = code;
            self.nodes[index].used |= 1 << slot;
        }
        index as u32
    }

    fn push_leaf(&mut self, triangles: &[u32], scene: &Scene) -> u32 {
        let first = self.triangles.len() as u32;
        for &t in triangles {
            let id = TriangleId(t);
            let masked = scene.material(id).alpha.is_some();
            self.triangles.push(LeafTriangle { corners: scene.mesh().corners(id), id, masked });
        }
        LEAF | first << 2 | (triangles.len() as u32 - 1)
    }

    fn leaf(&self, code: u32) -> &[LeafTriangle] {
        let first = ((code & !LEAF) >> 2) as usize;
        &self.triangles[first..=first + (code & 3) as usize]
    }

    /// The nearest crossing beyond [`T_MIN`] with any triangle but `skip`. Among equal distances the front-facing side
    /// wins, then the lowest id.
    pub(super) fn nearest(&self, scene: &Scene, origin: DVec3, direction: DVec3, skip: TriangleId) -> Option<Meeting> {
        let ray = ShearedRay::new(origin, direction);
        let boxes = BoxRay::new(origin, direction);
        let mut best: Option<Meeting> = None;
        let mut limit = f32::INFINITY;
        let mut stack = [(0u32, 0f32); 256];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let (code, near) = stack[height];
            if near > limit {
                continue;
            }
            if code & LEAF != 0 {
                for triangle in self.leaf(code) {
                    if triangle.id == skip {
                        continue;
                    }
                    let Some(crossing) = ray.cross(&triangle.corners) else { continue };
                    let meeting = Meeting { crossing, triangle: triangle.id };
                    if crossing.t > T_MIN && meeting.beats(best.as_ref()) && triangle.is_there(scene, &crossing) {
                        best = Some(meeting);
                        limit = (crossing.t as f32) * SLACK;
                    }
                }
                continue;
            }
            let node = &self.nodes[code as usize];
            let (mask, near) = boxes.enter(node, limit);
            height = push_sorted(&mut stack, height, node, mask, near);
        }
        best
    }

    /// Whether anything but the triangles `skip` crosses the open segment from `origin` to `origin + direction·t_max`.
    pub(super) fn is_occluded(
        &self,
        scene: &Scene,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
        skip: [TriangleId; 2],
    ) -> bool {
        let ray = ShearedRay::new(origin, direction);
        let boxes = BoxRay::new(origin, direction);
        let limit = t_max as f32 * SLACK;
        // The lower bound holds for directions of any length.
        let t_min = T_MIN / direction.length();
        let mut stack = [0u32; 256];
        let mut height = usize::from(!self.nodes.is_empty());
        while height > 0 {
            height -= 1;
            let code = stack[height];
            if code & LEAF != 0 {
                for triangle in self.leaf(code) {
                    if let Some(crossing) = ray.cross(&triangle.corners)
                        && crossing.t > t_min
                        && crossing.t < t_max
                        && !skip.contains(&triangle.id)
                        && triangle.is_there(scene, &crossing)
                    {
                        return true;
                    }
                }
                continue;
            }
            let node = &self.nodes[code as usize];
            let (mut mask, _) = boxes.enter(node, limit);
            while mask != 0 {
                stack[height] = node.children[mask.trailing_zeros() as usize];
                height += 1;
                mask &= mask - 1;
            }
        }
        false
    }

    /// The triangles within `distance` of a point, with the weights of their nearest points and the distance to it.
    pub(super) fn near(&self, point: DVec3, distance: f64) -> Vec<(TriangleId, (f64, f64), f64)> {
        let mut found = Vec::new();
        let mut stack = if self.nodes.is_empty() { Vec::new() } else { vec![0u32] };
        let p = point.as_vec3();
        let reach = distance as f32 + PADDING;
        while let Some(code) = stack.pop() {
            if code & LEAF != 0 {
                for triangle in self.leaf(code) {
                    let corners = triangle.corners.map(|c| c.as_dvec3());
                    let (u, v) = nearest_weights(point, corners);
                    let [a, b, c] = corners;
                    let d = (a * (1.0 - u - v) + b * u + c * v).distance(point);
                    if d <= distance {
                        found.push((triangle.id, (u, v), d));
                    }
                }
                continue;
            }
            let node = &self.nodes[code as usize];
            for slot in 0..4 {
                let inside =
                    |axis: usize| p[axis] >= node.min[axis][slot] - reach && p[axis] <= node.max[axis][slot] + reach;
                if node.children[slot] != EMPTY && (0..3).all(inside) {
                    stack.push(node.children[slot]);
                }
            }
        }
        found
    }
}

impl Meeting {
    fn beats(&self, other: Option<&Self>) -> bool {
        let Some(other) = other else { return true };
        let (mine, theirs) = (&self.crossing, &other.crossing);
        if (mine.t - theirs.t).abs() > TIE * theirs.t.max(T_MIN) {
            return mine.t < theirs.t;
        }
        (!mine.is_front, self.triangle) < (!theirs.is_front, other.triangle)
    }
}

impl LeafTriangle {
    fn is_there(&self, scene: &Scene, crossing: &Crossing) -> bool {
        if !self.masked {
            return true;
        }
        let uv = scene.mesh().uv_at(self.id, crossing.u as f32, crossing.v as f32);
        scene.material(self.id).alpha.as_ref().is_none_or(|mask| mask.is_opaque(uv))
    }
}

impl BoxRay {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        // Not zero, so that no slab gives a NaN.
        let inverse = |d: f64| {
            let d = d as f32;
            1.0 / if d.abs() < 1e-18 { 1e-18f32.copysign(d) } else { d }
        };
        Self {
            origin: origin.to_array().map(|o| Vec4::splat(o as f32)),
            inverse: direction.to_array().map(|d| Vec4::splat(inverse(d))),
        }
    }

    /// Which of a node's boxes the ray enters before `limit`, and where.
    #[inline]
    fn enter(&self, node: &Node, limit: f32) -> (u32, Vec4) {
        let mut near = Vec4::ZERO;
        let mut far = Vec4::splat(limit);
        for axis in 0..3 {
            let a = (node.min[axis] - self.origin[axis]) * self.inverse[axis];
            let b = (node.max[axis] - self.origin[axis]) * self.inverse[axis];
            near = near.max(a.min(b));
            far = far.min(a.max(b) * SLACK);
        }
        (near.cmple(far).bitmask() & node.used, near)
    }
}

/// Pushes the children in `mask`, the nearest on top.
#[inline]
fn push_sorted(stack: &mut [(u32, f32); 256], height: usize, node: &Node, mut mask: u32, near: Vec4) -> usize {
    let near = near.to_array();
    let mut top = height;
    while mask != 0 {
        let slot = mask.trailing_zeros() as usize;
        mask &= mask - 1;
        let entry = (node.children[slot], near[slot]);
        let mut i = top;
        while i > height && stack[i - 1].1 < entry.1 {
            stack[i] = stack[i - 1];
            i -= 1;
        }
        stack[i] = entry;
        top += 1;
    }
    top
}

/// Up to four descendants that together make up `binary`: the largest box is opened first.
fn widened(binary: &Binary) -> Vec<&Binary> {
    let mut parts = vec![binary];
    while parts.len() < 4 {
        let area = |part: &Binary| match part {
            Binary::Inner { bounds, .. } => bounds.half_area(),
            Binary::Leaf { .. } => -1.0,
        };
        let Some(widest) = (0..parts.len()).max_by(|&a, &b| area(parts[a]).total_cmp(&area(parts[b]))) else { break };
        let Binary::Inner { children, .. } = parts[widest] else { break };
        parts[widest] = &children[0];
        parts.push(&children[1]);
    }
    parts
}
