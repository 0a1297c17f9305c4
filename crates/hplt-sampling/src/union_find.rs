/// Disjoint sets whose representative is always the lowest member.
#[derive(Debug, Clone, Default)]
pub(crate) struct UnionFind {
    parents: Vec<u32>,
}

impl UnionFind {
    pub(crate) fn new(n: usize) -> Self {
        Self { parents: (0..n as u32).collect() }
    }

    /// Adds a set of its own.
    pub(crate) fn push(&mut self) -> u32 {
        let id = self.parents.len() as u32;
        self.parents.push(id);
        id
    }

    pub(crate) fn find(&mut self, mut i: u32) -> u32 {
        while self.parents[i as usize] != i {
            let grandparent = self.parents[self.parents[i as usize] as usize];
            self.parents[i as usize] = grandparent;
            i = grandparent;
        }
        i
    }

    pub(crate) fn union(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parents[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_representative_is_the_lowest_member() {
        let mut sets = UnionFind::new(6);
        sets.union(5, 3);
        sets.union(4, 5);
        let new = sets.push();
        sets.union(new, 2);
        let found: Vec<u32> = (0..7).map(|i| sets.find(i)).collect();
        assert_eq!(found, [0, 1, 2, 3, 3, 3, 2]);
    }
}
