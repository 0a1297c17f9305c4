use glam::Vec3;
use hplt_geom::OrientedPoint;
use hplt_kdtree::KdTree;

/// The functions of one level, for looking up the nearest one: six kd-trees, one for each direction of the axes, each over the
/// functions whose normals are not far from it. A leaf then holds functions that face the way the query does, and one descent
/// nearly always finds one.
#[derive(Debug)]
pub(crate) struct NearestIndex {
    directions: [Direction; 6],
}

#[derive(Debug, Default)]
struct Direction {
    tree: KdTree,
    /// By position in the tree's input.
    points: Vec<OrientedPoint>,
    functions: Vec<u32>,
}

/// A normal within 60° of a query's belongs to the direction of the query if its cosine with that is not below this: the
/// query's own is at least 1/√3.
const LEAST_COSINE: f32 = 0.05;
/// Least cosine between the normals of a query and of the function that answers.
const SAME_SIDE: f32 = 0.5;

impl NearestIndex {
    pub fn build(functions: &[OrientedPoint]) -> Self {
        let direction = |d: usize| {
            let axis = axis_of(d);
            let of_direction =
                (0..functions.len() as u32).filter(|&i| functions[i as usize].normal.dot(axis) >= LEAST_COSINE);
            let ids: Vec<u32> = of_direction.collect();
            let points: Vec<OrientedPoint> = ids.iter().map(|&i| functions[i as usize]).collect();
            let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
            Direction { tree: KdTree::build(&positions), points, functions: ids }
        };
        Self { directions: [0, 1, 2, 3, 4, 5].map(direction) }
    }

    /// A function near `query`, in its region, on its side and within sight of it, at most `reach` away; with `is_thorough`
    /// the nearest one where one descent finds none.
    pub fn nearest(&self, query: &OrientedPoint, reach: f32, is_thorough: bool) -> Option<u32> {
        let direction = &self.directions[direction_of(query.normal)];
        let accept = |id: u32| {
            let point = &direction.points[id as usize];
            query.normal.dot(point.normal) > SAME_SIDE && point.is_continued_at(query)
        };
        let found = direction.tree.approximate_nearest(query.position, accept);
        let near = found.filter(|&(_, distance_squared)| distance_squared <= reach * reach);
        let search = || if is_thorough { direction.tree.nearest(query.position, reach, accept) } else { None };
        near.or_else(search).map(|(id, _)| direction.functions[id as usize])
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
