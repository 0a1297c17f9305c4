use glam::Vec3;
use hplt_geom::OrientedPoint;
use hplt_kdtree::KdTree;

use crate::ShepardBasis;

/// The functions that nothing finer stands in for, of all levels together, for looking up the nearest one.
///
/// Six kd-trees, one for each direction of the axes, each over the functions whose normals are not far from it: a leaf then holds
/// functions that face the way the query does, and one descent nearly always finds one.
#[derive(Debug)]
pub(crate) struct FinestIndex {
    directions: [Direction; 6],
}

#[derive(Debug, Default)]
struct Direction {
    tree: KdTree,
    /// By position in the tree's input.
    points: Vec<OrientedPoint>,
    functions: Vec<(u8, u32)>,
}

/// A normal within 60° of a query's belongs to the direction of the query if its cosine with that is not below this: the
/// query's own is at least 1/√3.
const LEAST_COSINE: f32 = 0.05;
/// Least cosine between the normals of a query and of the function that answers.
const SAME_SIDE: f32 = 0.5;

impl FinestIndex {
    pub fn build(basis: &ShepardBasis) -> Self {
        let finest = basis.finest_functions();
        let direction = |d: usize| {
            let axis = axis_of(d);
            let mut direction = Direction::default();
            for &(level, i) in &finest {
                let point = basis.points(level as usize)[i as usize];
                if point.normal.dot(axis) >= LEAST_COSINE {
                    direction.points.push(point);
                    direction.functions.push((level, i));
                }
            }
            let positions: Vec<Vec3> = direction.points.iter().map(|p| p.position).collect();
            direction.tree = KdTree::build(&positions);
            direction
        };
        Self { directions: [0, 1, 2, 3, 4, 5].map(direction) }
    }

    /// Level and index of a function near `query`, in its region, on its side and within sight of it, at most `reach` away.
    pub fn nearest(&self, query: &OrientedPoint, reach: f32) -> Option<(usize, u32)> {
        let direction = &self.directions[direction_of(query.normal)];
        let accept = |id: u32| {
            let point = &direction.points[id as usize];
            query.normal.dot(point.normal) > SAME_SIDE && point.is_continued_at(query)
        };
        let found = direction.tree.approximate_nearest(query.position, accept);
        let near = found.filter(|&(_, distance_squared)| distance_squared <= reach * reach);
        let (id, _) = near.or_else(|| direction.tree.nearest(query.position, reach, accept))?;
        let (level, function) = direction.functions[id as usize];
        Some((level.into(), function))
    }

    pub fn memory(&self) -> usize {
        let of = |d: &Direction| d.tree.memory() + size_of_val(&d.points[..]) + size_of_val(&d.functions[..]);
        self.directions.iter().map(of).sum()
    }
}

fn axis_of(direction: usize) -> Vec3 {
    Vec3::AXES[direction / 2] * if direction.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// The direction of the axes nearest to a normal.
fn direction_of(normal: Vec3) -> usize {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    2 * axis + usize::from(normal[axis] < 0.0)
}

impl ShepardBasis {
    /// Level and index of every function that is not refined, or refined where no finer function is.
    fn finest_functions(&self) -> Vec<(u8, u32)> {
        let mut all = Vec::new();
        let mut weights = Vec::new();
        for level in 0..self.n_levels() {
            let is_last = level + 1 == self.n_levels();
            for (i, point) in self.points(level).iter().enumerate() {
                let is_refined = !is_last && self.hierarchy().levels[level].is_refined(i as u32);
                if !is_refined || !self.weights(level + 1, point, &mut weights) {
                    all.push((level as u8, i as u32));
                }
            }
        }
        all
    }
}
