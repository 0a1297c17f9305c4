//! The command `hplt`.
fn main() {}
