/// Replaces `order` by the indices of `cells`, lower cells first and equal ones in the order given: a counting sort. `ends` is scratch,
/// one number for each cell that there may be.
///
/// # Panics
/// When a cell is beyond `ends`.
pub fn order_by_cell(cells: &[u16], ends: &mut [u32], order: &mut Vec<u32>) {
    ends.fill(0);
    for &cell in cells {
        ends[usize::from(cell)] += 1;
    }
    let mut end = 0;
    for count in &mut *ends {
        end += std::mem::replace(count, end);
    }
    order.clear();
    order.resize(cells.len(), 0);
    for (i, &cell) in (0..).zip(cells) {
        let at = &mut ends[usize::from(cell)];
        order[*at as usize] = i;
        *at += 1;
    }
}
