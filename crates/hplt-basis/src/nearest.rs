use glam::Vec3;
use hplt_geom::OrientedPoint;

use crate::cells::{Key, Lists, touched_cells};
use crate::lanes::{self, Function};

/// The functions of one level, for looking up the nearest one: listed for every cell of a grid that they reach into, by the direction
/// of the axes that a query there faces.
#[derive(Debug)]
pub(crate) struct NearestIndex {
    lists: Lists,
    points: Vec<OrientedPoint>,
    functions: Vec<Function>,
    reach: f32,
}

/// A normal within 60° of a query's belongs to the direction of the query if its cosine with that is not below this: the
/// query's own is at least 1/√3.
const LEAST_COSINE: f32 = 0.05;
/// Least cosine between the normals of a query and of the function that answers.
const SAME_SIDE: f32 = 0.5;

impl NearestIndex {
    /// The index of functions that answer at most `reach` away.
    pub fn build(functions: &[OrientedPoint], reach: f32) -> Self {
        let cells_per_unit = 1.0 / reach;
        let mut entries = Vec::new();
        for (i, point) in functions.iter().enumerate() {
            let faced = (0..6).filter(|&d| point.normal.dot(axis_of(d)) >= LEAST_COSINE);
            let faced: Vec<u32> = faced.collect();
            touched_cells(point, (reach, reach), cells_per_unit, |cell| {
                entries.extend(faced.iter().map(|&facing| (Key::new(cell, point.region, facing), i as u32)));
            });
        }
        entries.sort_unstable();
        Self {
            lists: Lists::new(&entries, cells_per_unit),
            points: functions.to_vec(),
            functions: functions.iter().map(Function::of).collect(),
            reach,
        }
    }

    /// The nearest function to `query` that is in its region, on its side and within sight of it, unless it is out of reach; of several
    /// that are equally near the first.
    pub fn nearest(&self, query: &OrientedPoint) -> Option<u32> {
        let (mut nearest, mut least) = (None, self.reach * self.reach);
        for &function in self.lists.at(query, facing(query.normal)) {
            let point = &self.points[function as usize];
            let distance = (query.position - point.position).length_squared();
            if distance < least && query.normal.dot(point.normal) > SAME_SIDE && point.is_continued_at(query) {
                (nearest, least) = (Some(function), distance);
            }
        }
        nearest
    }

    /// [`nearest`](Self::nearest) for each of many queries, in a fraction of the time where many lie near each other.
    pub fn nearest_many(&self, queries: &[OrientedPoint]) -> Vec<Option<u32>> {
        let by_cell = self.lists.by_cell(queries, |query| facing(query.normal));
        let found = lanes::nearest(&self.functions, (self.reach, SAME_SIDE), &by_cell.columns, by_cell.groups);
        let mut out = vec![None; queries.len()];
        for (&query, &found) in by_cell.order.iter().zip(&found) {
            out[query as usize] = (found != lanes::NONE).then_some(found);
        }
        out
    }

    pub fn memory(&self) -> usize {
        self.lists.memory() + size_of_val(&self.points[..]) + size_of_val(&self.functions[..])
    }
}

fn axis_of(direction: u32) -> Vec3 {
    Vec3::AXES[direction as usize / 2] * if direction.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// The direction of the axes nearest to a normal.
fn facing(normal: Vec3) -> u32 {
    let size = normal.abs();
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    2 * axis as u32 + u32::from(normal[axis] < 0.0)
}
