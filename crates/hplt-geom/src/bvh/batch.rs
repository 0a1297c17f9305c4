//! The order in which the rays of a batch are traced. Rays of a gather share their origin: when neighbours in direction
//! follow each other, they find the same nodes and triangles in the nearest cache, and what one meets is a good guess for the
//! next one. Answers do not depend on the order.

use glam::Vec3;

use crate::{Ray, order_by_cell};

/// Batches below this are traced in the order given.
const FEW: usize = 16;
/// Bits per axis of the grid of directions.
const BITS: u32 = 5;
const N_CELLS: usize = 1 << (2 * BITS);

/// Indices of `rays`, neighbours in direction next to each other; `None` for the order given.
pub(super) fn coherent_order(rays: &[Ray]) -> Option<Vec<u32>> {
    if rays.len() < FEW {
        return None;
    }
    let cells: Vec<u16> = rays.iter().map(|ray| cell(ray.direction)).collect();
    let mut order = Vec::new();
    order_by_cell(&cells, &mut [0; N_CELLS], &mut order);
    Some(order)
}

/// The place of a direction on a Hilbert curve over the octahedral map (Engelhardt & Dachsbacher, "Octahedron Environment
/// Maps", VMV 2008); any cell for directions that are not finite.
fn cell(direction: Vec3) -> u16 {
    let d = direction / (direction.x.abs() + direction.y.abs() + direction.z.abs());
    let (mut x, mut y) = (d.x, d.y);
    if d.z < 0.0 {
        (x, y) = ((1.0 - d.y.abs()).copysign(d.x), (1.0 - d.x.abs()).copysign(d.y));
    }
    let side = (1 << BITS) as f32;
    // A cast from NaN gives 0.
    let column = |x: f32| (((x + 1.0) * (0.5 * side)) as usize).min((1 << BITS) - 1);
    HILBERT[(column(y) << BITS) | column(x)]
}

const HILBERT: [u16; N_CELLS] = hilbert();

/// The position of every cell of the grid on the Hilbert curve.
const fn hilbert() -> [u16; N_CELLS] {
    let mut table = [0; N_CELLS];
    let mut cell = 0;
    while cell < N_CELLS {
        let (mut x, mut y) = (cell & ((1 << BITS) - 1), cell >> BITS);
        let mut position = 0;
        let mut half = 1 << (BITS - 1);
        while half > 0 {
            let (right, up) = ((x & half != 0) as usize, (y & half != 0) as usize);
            position += half * half * ((3 * right) ^ up);
            if up == 0 {
                if right == 1 {
                    (x, y) = ((1 << BITS) - 1 - x, (1 << BITS) - 1 - y);
                }
                (x, y) = (y, x);
            }
            half /= 2;
        }
        table[cell] = position as u16;
        cell += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_on_the_curve_are_neighbours_on_the_grid() {
        let mut place = [(0i32, 0i32); N_CELLS];
        for (cell, &position) in HILBERT.iter().enumerate() {
            place[usize::from(position)] = ((cell % (1 << BITS)) as i32, (cell >> BITS) as i32);
        }
        assert!(place.windows(2).all(|w| (w[0].0 - w[1].0).abs() + (w[0].1 - w[1].1).abs() == 1));
    }

    #[test]
    fn an_order_names_every_ray_once() {
        let axes = [Vec3::X, Vec3::NEG_Z, Vec3::NAN, Vec3::ZERO, Vec3::new(1e30, -1e30, 3e38), Vec3::INFINITY];
        let rays: Vec<Ray> = (0..100).map(|i| Ray::new(Vec3::ZERO, axes[i % axes.len()])).collect();
        assert!(coherent_order(&rays[..FEW - 1]).is_none());
        for n in [FEW, 100] {
            let mut order = coherent_order(&rays[..n]).unwrap();
            order.sort_unstable();
            assert!(order.iter().copied().eq(0..n as u32));
        }
    }
}
