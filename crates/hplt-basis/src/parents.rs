use hplt_geom::{Rgb, parallel};

use crate::Weight;

/// For every function of a level its parents: the functions of the coarser level that overlap its centre, with their
/// basis values there. Rows sum to 1. A directed acyclic graph, not a tree.
#[derive(Debug, Clone, PartialEq)]
pub struct Parents {
    offsets: Vec<u32>,
    entries: Vec<Weight>,
    child_offsets: Vec<u32>,
    children: Vec<u32>,
}

impl Parents {
    pub(crate) fn from_rows(rows: &[Vec<Weight>], n_coarser: usize) -> Self {
        let mut offsets = Vec::with_capacity(rows.len() + 1);
        offsets.push(0);
        let mut entries = Vec::with_capacity(rows.iter().map(Vec::len).sum());
        for row in rows {
            entries.extend_from_slice(row);
            offsets.push(entries.len() as u32);
        }
        let mut child_offsets = vec![0u32; n_coarser + 1];
        for entry in &entries {
            child_offsets[entry.function as usize + 1] += 1;
        }
        for i in 0..n_coarser {
            child_offsets[i + 1] += child_offsets[i];
        }
        let mut next = child_offsets.clone();
        let mut children = vec![0; entries.len()];
        for (child, row) in rows.iter().enumerate() {
            for entry in row {
                let slot = &mut next[entry.function as usize];
                children[*slot as usize] = child as u32;
                *slot += 1;
            }
        }
        Self { offsets, entries, child_offsets, children }
    }

    /// The parents of `child` and their weights; empty when the child's region has no function on the coarser level.
    pub fn of(&self, child: u32) -> &[Weight] {
        let child = child as usize;
        &self.entries[self.offsets[child] as usize..self.offsets[child + 1] as usize]
    }

    /// The functions whose centre `parent` overlaps, ascending.
    pub fn children(&self, parent: u32) -> &[u32] {
        let parent = parent as usize;
        &self.children[self.child_offsets[parent] as usize..self.child_offsets[parent + 1] as usize]
    }

    /// The value that `child` inherits: `Σ weight·α` over its parents ("push-down").
    pub fn inherited(&self, child: u32, coarser: &[Rgb]) -> Rgb {
        self.of(child).iter().map(|w| coarser[w.function as usize] * w.weight).sum()
    }

    /// [`inherited`](Self::inherited) for every child.
    pub fn push_down(&self, coarser: &[Rgb]) -> Vec<Rgb> {
        parallel::map(self.offsets.len() - 1, || (), |(), child| self.inherited(child as u32, coarser))
    }

    /// Bytes.
    pub fn memory(&self) -> usize {
        size_of_val(&self.offsets[..])
            + size_of_val(&self.entries[..])
            + size_of_val(&self.child_offsets[..])
            + size_of_val(&self.children[..])
    }
}
