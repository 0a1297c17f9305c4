//! Many emitters as a tree, so that a point chooses those that matter to it without looking at all of them.
//!
//! Importance after Conty Estévez & Kulla 2018, "Importance sampling of many lights with adaptive tree splitting", section 4: power over
//! squared distance times bounds on both cosines. The tree is split by the wider of position and orientation, as in Walter et al.
//! 2006, "Multidimensional lightcuts"; from the root, the most important nodes of a point are divided first, as in their cuts.

use glam::{DVec3, Vec3};
use hplt_geom::parallel;

use crate::emitters::Emitter;

/// Emitters of a leaf, at most.
const LEAF: usize = 4;
/// From so many emitters on, the two halves of a node are built in parallel.
const PARALLEL: usize = 1 << 14;
/// From this depth on, nodes are halved by number: no arrangement of emitters makes the tree deeper than this and the logarithm of
/// their number.
const MAX_UNEVEN_DEPTH: u32 = 48;
/// What a spread of normals is worth against one of positions, when a node is split: 1 stands for the spread of all positions.
const NORMAL_EXTENT: f64 = 0.25;
/// Nodes that a point divides at first, always the most important one: for one draw, and where it draws often.
const DIVIDED: [usize; 2] = [16, 64];
/// Draws from which on that is often.
const OFTEN: u32 = 16;
/// Least cosine in an importance that is not 0.
const LEAST_COSINE: f32 = 0.05;
/// Allowance for rounding in the decision that no member can light a point, relative to the lengths compared.
const SLACK: f32 = 1e-4;
/// Cones narrower than this cosine are also tested as planes, and the sine of such a cone, rounded up.
const NARROW: (f32, f32) = (1.0 - 1e-5, 5e-3);

/// What the tree is built from: emitters are moved about as a whole, so that memory is read in order.
#[derive(Clone, Copy)]
struct Member {
    id: u32,
    power: f32,
    /// Centre and normal.
    keys: [Vec3; 2],
    min: Vec3,
    max: Vec3,
}

impl Member {
    fn of(id: u32, emitter: &Emitter) -> Self {
        let bounds = |f: fn(Vec3, Vec3) -> Vec3, from| emitter.corners.iter().copied().fold(from, f);
        Self {
            id,
            power: emitter.power,
            keys: [emitter.corners.center(), emitter.normal],
            min: bounds(Vec3::min, Vec3::INFINITY),
            max: bounds(Vec3::max, Vec3::NEG_INFINITY),
        }
    }

    fn normal(&self) -> Vec3 {
        self.keys[1]
    }
}

/// A set of emitters as a point from afar sees it.
#[derive(Debug, Clone, Copy)]
struct Node {
    min: Vec3,
    max: Vec3,
    /// No normal is farther from `axis` than the angle of this cosine.
    axis: Vec3,
    cos_spread: f32,
    power: f32,
    /// Of an inner node: how many nodes after it the second child is; the first is the next node. Of a leaf: its first emitter.
    next: u32,
    /// Emitters of a leaf; 0 for an inner node.
    count: u32,
}

impl Node {
    fn of(members: &[Member]) -> (Self, Extents) {
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        let mut extents = Extents::default();
        let mut axis = Vec3::ZERO;
        for member in members {
            (min, max) = (min.min(member.min), max.max(member.max));
            extents.include(member);
            axis += member.normal();
        }
        let axis = axis.try_normalize().unwrap_or(Vec3::Z);
        let cos = members.iter().map(|member| member.normal().dot(axis)).fold(1.0, f32::min);
        let (cos_spread, power) = ((cos - 1e-6).max(-1.0), extents.power as f32);
        (Self { min, max, axis, cos_spread, power, next: 0, count: 0 }, extents)
    }

    /// About what its members bring to a point together, and 0 only where none of them brings anything.
    fn importance(&self, position: Vec3, normal: Vec3) -> f64 {
        let half = 0.5 * (self.max - self.min);
        let to = 0.5 * (self.min + self.max) - position;
        let (distance_squared, radius_squared) = (to.length_squared(), half.length_squared());
        let slack = SLACK * (distance_squared.sqrt() + radius_squared.sqrt());
        if normal.dot(to) + normal.abs().dot(half) < -slack {
            return 0.0;
        }
        let (narrow, sine) = NARROW;
        if self.cos_spread > narrow {
            let reach = self.axis.abs().dot(half) + (sine / SLACK) * slack;
            if reach < self.axis.dot(to) {
                return 0.0;
            }
        }
        let power = f64::from(self.power);
        if distance_squared <= radius_squared * (1.0 + SLACK) {
            return power / f64::from(radius_squared.max(f32::MIN_POSITIVE));
        }
        let direction = to / distance_squared.sqrt();
        let seen = Cosine::of_sine_squared(radius_squared / distance_squared);
        let leaving = Cosine::of(-self.axis.dot(direction)).less(Cosine::of(self.cos_spread)).less(seen).cos;
        if leaving < -SLACK.sqrt() {
            return 0.0;
        }
        let arriving = Cosine::of(normal.dot(direction)).less(seen).cos;
        power * f64::from(leaving.max(LEAST_COSINE) * arriving.max(LEAST_COSINE)) / f64::from(distance_squared)
    }
}

/// An angle between 0 and π.
#[derive(Clone, Copy)]
struct Cosine {
    cos: f32,
    sin: f32,
}

impl Cosine {
    fn of(cos: f32) -> Self {
        let cos = cos.clamp(-1.0, 1.0);
        Self { cos, sin: (1.0 - cos * cos).max(0.0).sqrt() }
    }

    /// Of an angle up to π/2.
    fn of_sine_squared(squared: f32) -> Self {
        Self { cos: (1.0 - squared).max(0.0).sqrt(), sin: squared.min(1.0).sqrt() }
    }

    /// The angle less another one, and 0 where that is larger.
    fn less(self, other: Self) -> Self {
        if self.cos >= other.cos {
            return Self { cos: 1.0, sin: 0.0 };
        }
        let cos = self.cos * other.cos + self.sin * other.sin;
        Self { cos, sin: (self.sin * other.cos - self.cos * other.sin).max(0.0) }
    }
}

/// How far the centres and normals of emitters are spread, as their power is.
#[derive(Default)]
struct Extents {
    power: f64,
    sum: [DVec3; 2],
    squares: [DVec3; 2],
}

impl Extents {
    fn include(&mut self, member: &Member) {
        let power = f64::from(member.power);
        self.power += power;
        for (k, value) in member.keys.into_iter().enumerate() {
            let value = value.as_dvec3();
            self.sum[k] += power * value;
            self.squares[k] += power * value * value;
        }
    }

    /// The key and its component that are spread the most, and the mean of that; `None` where nothing is spread.
    fn split(&self) -> Option<(usize, usize, f32)> {
        let means = self.sum.map(|sum| sum / self.power);
        let variances = [0, 1].map(|k| (self.squares[k] / self.power - means[k] * means[k]).max(DVec3::ZERO));
        let scales = [1.0, NORMAL_EXTENT * NORMAL_EXTENT * variances[0].element_sum()];
        let of = |(k, c): (usize, usize)| variances[k][c] * scales[k];
        let all = (0..2).flat_map(|k| (0..3).map(move |c| (k, c)));
        let (k, c) = all.reduce(|a, b| if of(b) > of(a) { b } else { a })?;
        (of((k, c)) > 0.0).then(|| (k, c, means[k][c] as f32))
    }
}

/// A tree over emitters that are kept in its order.
#[derive(Debug, Clone)]
pub(crate) struct LightTree {
    /// Depth first.
    nodes: Vec<Node>,
}

/// Nodes that hold every emitter once, except some that cannot light the point, each with its importance there.
pub(crate) type Cut = Vec<(u32, f64)>;

impl LightTree {
    /// A tree over `emitters`, which it puts into its order. About n·log n steps, the halves of large nodes in parallel.
    pub fn build(emitters: &mut Vec<Emitter>) -> Self {
        let mut members: Vec<Member> = (0..).zip(&*emitters).map(|(id, emitter)| Member::of(id, emitter)).collect();
        let mut nodes = Vec::new();
        if !members.is_empty() {
            grow(&mut members, (0, 0), &mut nodes);
        }
        *emitters = members.iter().map(|member| emitters[member.id as usize].clone()).collect();
        Self { nodes }
    }

    /// Replaces `cut` by some dozen nodes, finest where they matter most to a point that draws so often. `emitters` are those that
    /// the tree was built over.
    pub fn cut(&self, emitters: &[Emitter], point: (Vec3, Vec3), n_draws: u32, cut: &mut Cut) {
        cut.clear();
        if self.nodes.is_empty() {
            return;
        }
        cut.push((0, self.importance(emitters, 0, point)));
        for _ in 0..DIVIDED[usize::from(n_draws >= OFTEN)] {
            let is_inner = |at: u32| self.nodes[at as usize].count == 0;
            let inner = cut.iter().enumerate().filter(|(_, (at, importance))| *importance > 0.0 && is_inner(*at));
            let Some((most, &(at, _))) = inner.max_by(|a, b| a.1.1.total_cmp(&b.1.1)) else { break };
            let [first, second] = [at + 1, at + self.nodes[at as usize].next];
            cut[most] = (first, self.importance(emitters, first, point));
            cut.push((second, self.importance(emitters, second, point)));
        }
        cut.retain(|&(_, importance)| importance > 0.0);
    }

    /// The range of emitters of a leaf below node `at` that a point chooses with `u` in `[0, 1)`, the probability of that choice,
    /// and `u` made uniform again. `None` where no emitter there can light the point.
    pub fn descend(
        &self,
        emitters: &[Emitter],
        at: u32,
        point: (Vec3, Vec3),
        mut u: f64,
    ) -> Option<(std::ops::Range<usize>, f64, f64)> {
        let (mut at, mut probability) = (at, 1.0);
        loop {
            let node = self.nodes.get(at as usize)?;
            if node.count > 0 {
                return Some((node.emitters(), probability, u));
            }
            let [first, second] = self.shares(emitters, at, point)?;
            let is_first = u < first;
            let (share, below) = if is_first { (first, 0.0) } else { (second, first) };
            u = ((u - below) / share).clamp(0.0, 1.0 - f64::EPSILON);
            probability *= share;
            at += if is_first { 1 } else { node.next };
        }
    }

    /// The probabilities that a point goes on to each child of an inner node; `None` where neither can light it.
    fn shares(&self, emitters: &[Emitter], at: u32, point: (Vec3, Vec3)) -> Option<[f64; 2]> {
        let children = [at + 1, at + self.nodes[at as usize].next];
        let [first, second] = children.map(|child| self.importance(emitters, child, point));
        let sum = first + second;
        (sum > 0.0).then(|| [first / sum, second / sum])
    }

    fn importance(&self, emitters: &[Emitter], at: u32, (position, normal): (Vec3, Vec3)) -> f64 {
        match &self.nodes[at as usize] {
            leaf if leaf.count > 0 => emitters[leaf.emitters()].iter().map(|e| e.guide(position, normal)).sum(),
            inner => inner.importance(position, normal),
        }
    }
}

impl Node {
    fn emitters(&self) -> std::ops::Range<usize> {
        self.next as usize..(self.next + self.count) as usize
    }
}

/// Appends the nodes of `members` and puts these in their order. `first` is the number of emitters before them.
fn grow(members: &mut [Member], (first, depth): (u32, u32), nodes: &mut Vec<Node>) {
    let (node, extents) = Node::of(members);
    let at = nodes.len();
    if members.len() <= LEAF {
        nodes.push(Node { next: first, count: members.len() as u32, ..node });
        return;
    }
    nodes.push(node);
    let in_parallel = members.len() >= PARALLEL;
    let n_left = divide(members, &extents, depth);
    let (left, right) = members.split_at_mut(n_left);
    let (of_left, of_right) = ((first, depth + 1), (first + n_left as u32, depth + 1));
    if in_parallel {
        let apart = |members, of| {
            let mut nodes = Vec::new();
            grow(members, of, &mut nodes);
            nodes
        };
        let (left, right) = parallel::join(|| apart(left, of_left), || apart(right, of_right));
        nodes[at].next = 1 + left.len() as u32;
        nodes.extend(left);
        nodes.extend(right);
    } else {
        grow(left, of_left, nodes);
        nodes[at].next = (nodes.len() - at) as u32;
        grow(right, of_right, nodes);
    }
}

/// Sorts the members of the first child to the front and returns how many they are: at least one, and not all.
fn divide(members: &mut [Member], extents: &Extents, depth: u32) -> usize {
    let half = members.len() / 2;
    let Some((k, c, middle)) = extents.split() else { return half };
    let key = |member: &Member| member.keys[k][c];
    if depth < MAX_UNEVEN_DEPTH {
        let mut n_left = 0;
        for i in 0..members.len() {
            if key(&members[i]) < middle {
                members.swap(i, n_left);
                n_left += 1;
            }
        }
        if n_left > 0 && n_left < members.len() {
            return n_left;
        }
    }
    members.select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)).then(a.id.cmp(&b.id)));
    half
}

#[cfg(test)]
mod tests;
