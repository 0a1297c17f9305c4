//! What may be in a shaft: the walk without rays.

use std::ops::ControlFlow;

use super::triangle::Packet;
use super::wide::{Child, Node, WIDTH, WideTree};
use crate::{Blocker, Shaft};

/// Visits every triangle that may reach into `shaft`, until `visit` breaks.
pub(super) fn visit(tree: &WideTree, shaft: &Shaft, visit: &mut dyn FnMut(&Blocker) -> ControlFlow<()>) {
    if tree.nodes.is_empty() {
        return;
    }
    let mut stack = Vec::with_capacity(tree.stack_size());
    stack.push(Child::ROOT);
    while let Some(child) = stack.pop() {
        if child.is_leaf() {
            let packet = &tree.packets[child.packet_index()];
            let mut mask = triangles_in(packet, shaft);
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                let blocker = Blocker { corners: packet.corners(lane), is_masked: packet.is_masked(lane) };
                if visit(&blocker).is_break() {
                    return;
                }
            }
        } else {
            let node = &tree.nodes[child.node_index()];
            let mask = boxes_in(node, shaft);
            stack.extend((0..WIDTH).filter(|lane| mask >> lane & 1 != 0).map(|lane| node.children[lane]));
        }
    }
}

/// Which boxes of `node` may reach into the shaft, one bit each.
fn boxes_in(node: &Node, shaft: &Shaft) -> u32 {
    let mut is_in = [true; WIDTH];
    let (min, max) = (shaft.min.to_array(), shaft.max.to_array());
    for axis in 0..3 {
        for (lane, is_in) in is_in.iter_mut().enumerate() {
            *is_in &= (node.planes[axis][lane] <= max[axis]) & (node.planes[axis + 3][lane] >= min[axis]);
        }
    }
    for (normal, offset) in shaft.planes() {
        // The corner of each box that is farthest inwards.
        let normal = normal.to_array();
        let [x, y, z] = std::array::from_fn(|axis| &node.planes[if normal[axis] > 0.0 { axis + 3 } else { axis }]);
        for (lane, is_in) in is_in.iter_mut().enumerate() {
            let height = x[lane] * normal[0] + y[lane] * normal[1] + z[lane] * normal[2] + offset;
            *is_in &= height >= 0.0;
        }
    }
    bits(is_in)
}

/// Which triangles of `packet` may reach into the shaft, one bit each; those that several planes cut off together are among them.
fn triangles_in(packet: &Packet, shaft: &Shaft) -> u32 {
    let rows = packet.rows();
    let mut is_in = [true; Packet::LANES];
    let (min, max) = (shaft.min.to_array(), shaft.max.to_array());
    for axis in 0..3 {
        let [a, b, c] = std::array::from_fn(|corner| &rows[corner][axis]);
        for (lane, is_in) in is_in.iter_mut().enumerate() {
            let (low, high) = (a[lane].min(b[lane]).min(c[lane]), a[lane].max(b[lane]).max(c[lane]));
            *is_in &= (low <= max[axis]) & (high >= min[axis]);
        }
    }
    for (normal, offset) in shaft.planes() {
        let mut highest = [f32::NEG_INFINITY; Packet::LANES];
        for [x, y, z] in rows {
            for (lane, highest) in highest.iter_mut().enumerate() {
                let height = x[lane] * normal.x + y[lane] * normal.y + z[lane] * normal.z + offset;
                *highest = highest.max(height);
            }
        }
        is_in.iter_mut().zip(highest).for_each(|(is_in, highest)| *is_in &= highest >= 0.0);
    }
    bits(is_in)
}

fn bits(is_set: [bool; 8]) -> u32 {
    is_set.iter().enumerate().map(|(i, &b)| u32::from(b) << i).sum()
}
