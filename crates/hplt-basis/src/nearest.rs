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
    reach: f32,
}

/// Least cosine between the normals of a query and of the function that answers,
const SAME_SIDE: f32 = 0.5;
/// and between that of the function and the direction of the axes that the query faces, which is within 55° of its own normal. Lower,
/// the lists are longer and gathers on Sponza take a tenth longer, for the same error.
const LEAST_COSINE: f32 = 0.05;

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
        Self { lists: Lists::new(&entries, cells_per_unit), points: functions.to_vec(), reach }
    }

    /// The nearest function to `query` that is in its region, on its side ([`SAME_SIDE`], [`LEAST_COSINE`]) and within sight of it,
    /// unless it is out of reach; of several that are equally near the first.
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

    /// [`nearest`](Self::nearest) of the `functions` of the level for each of many queries, in a fraction of the time where many lie
    /// near each other.
    pub fn nearest_many(&self, functions: &[Function], queries: &[OrientedPoint]) -> Vec<Option<u32>> {
        let by_cell = self.lists.by_cell(queries, |query| facing(query.normal));
        let found = lanes::nearest(functions, (self.reach, SAME_SIDE), &by_cell.columns, by_cell.groups);
        let mut out = vec![None; queries.len()];
        for (&query, &found) in by_cell.order.iter().zip(&found) {
            out[query as usize] = (found != lanes::NONE).then_some(found);
        }
        out
    }

    pub fn memory(&self) -> usize {
        self.lists.memory() + size_of_val(&self.points[..])
    }
}

fn axis_of(direction: u32) -> Vec3 {
    Vec3::AXES[direction as usize / 2] * if direction.is_multiple_of(2) { 1.0 } else { -1.0 }
}

/// The direction of the axes nearest to a normal.
fn facing(normal: Vec3) -> u32 {
    let axis = normal.abs().max_position();
    2 * axis as u32 + u32::from(normal[axis] < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::tests::{functions, queries};

    const REACH: f32 = 0.15;

    fn prepared(points: &[OrientedPoint]) -> Vec<Function> {
        points.iter().map(Function::of).collect()
    }

    /// The one that a look at all of them finds, one query at a time or many at once.
    #[test]
    fn the_index_finds_the_nearest_of_all() {
        let functions = functions(3000, 1);
        let index = NearestIndex::build(&functions, REACH);
        let nearest_of_all = |query: &OrientedPoint| {
            let axis = axis_of(facing(query.normal));
            assert!(axis.dot(query.normal) > 0.577);
            let is_on_side =
                |f: &OrientedPoint| f.normal.dot(query.normal) > SAME_SIDE && f.normal.dot(axis) >= LEAST_COSINE;
            let answers = |f: &OrientedPoint| f.is_continued_at(query) && is_on_side(f);
            let with_distance =
                |(i, f): (usize, &OrientedPoint)| ((query.position - f.position).length_squared(), i as u32);
            let all = functions.iter().enumerate().filter(|(_, f)| answers(f)).map(with_distance);
            let nearest = all.min_by(|a, b| a.0.total_cmp(&b.0));
            nearest.filter(|&(distance, _)| distance < REACH * REACH).map(|(_, i)| i)
        };
        let queries = queries();
        let expected: Vec<_> = queries.iter().map(nearest_of_all).collect();
        let one_by_one: Vec<_> = queries.iter().map(|query| index.nearest(query)).collect();
        assert_eq!(one_by_one, expected);
        assert_eq!(index.nearest_many(&prepared(&functions), &queries), expected);
        let n_found = expected.iter().flatten().count();
        assert!((1000..4000).contains(&n_found), "{n_found}");
    }

    /// A copy of a function changes nothing: of equals the first answers.
    #[test]
    fn of_equals_the_first_answers() {
        let once = functions(300, 1);
        let twice = [&once[..], &once[..]].concat();
        let (of_once, of_twice) = (NearestIndex::build(&once, REACH), NearestIndex::build(&twice, REACH));
        let queries = queries();
        let expected = of_once.nearest_many(&prepared(&once), &queries);
        assert_eq!(of_twice.nearest_many(&prepared(&twice), &queries), expected);
        for query in &queries {
            assert_eq!(of_twice.nearest(query), of_once.nearest(query));
        }
    }
}
