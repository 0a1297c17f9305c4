//! Owen-scrambled Sobol points.

use glam::Vec2;
use sobol_burley::sample_4d;

use crate::random::pcg4d;

/// Points per scrambled sequence. Beyond that, every further block of as many points is scrambled anew.
pub const BLOCK_SIZE: u32 = 1 << 16;

/// Point `index` of a two-dimensional Owen-scrambled Sobol sequence in `[0, 1)²` (Burley, "Practical Hash-based Owen
/// Scrambling", JCGT 10(4), 2020).
///
/// Different `seed_hash`es and different `pair`s of dimensions give independent scrambles and orders of the first two
/// Sobol dimensions ("padding"), because only these are stratified in every elementary interval. Use powers of two of
/// points: any aligned 2^k of them, up to [`BLOCK_SIZE`], are stratified. Beyond that each block is an independent
/// sequence, so the error falls like that of independent blocks.
pub fn sobol_2d(index: u32, seed_hash: u32, pair: u32) -> Vec2 {
    let block = index / BLOCK_SIZE;
    let seed = if block == 0 && pair == 0 { seed_hash } else { pcg4d([seed_hash, block, pair, 0])[0] };
    let [x, y, ..] = sample_4d(index % BLOCK_SIZE, 0, seed);
    Vec2::new(x, y)
}

/// Point `index` of a four-dimensional Owen-scrambled Sobol sequence in `[0, 1)⁴`. The first two coordinates are those of
/// [`sobol_2d`] with pair 0; the other two come at no cost and are stratified together with them, though not in every
/// elementary interval.
pub fn sobol_4d(index: u32, seed_hash: u32) -> [f32; 4] {
    let block = index / BLOCK_SIZE;
    let seed = if block == 0 { seed_hash } else { pcg4d([seed_hash, block, 0, 0])[0] };
    sample_4d(index % BLOCK_SIZE, 0, seed)
}
