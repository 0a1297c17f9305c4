//! A space-filling order.

use glam::Vec3;

/// The numbers below `n`, those whose positions (scene space) are neighbours next to each other.
pub fn coherent_order(n: usize, position: impl Fn(usize) -> Vec3) -> Vec<u32> {
    let mut keys: Vec<u64> = (0..n).map(|i| morton_code(position(i)) >> 31 << 32 | i as u64).collect();
    keys.sort_unstable();
    keys.into_iter().map(|key| key as u32).collect()
}

/// The position on a Morton curve through `[-1, 1)³`, 21 bits per axis; what lies outside is clamped.
pub(crate) fn morton_code(p: Vec3) -> u64 {
    let cell = ((p + Vec3::ONE) * (1 << 20) as f32).clamp(Vec3::ZERO, Vec3::splat(2_097_151.0));
    spread(cell.x as u64) | spread(cell.y as u64) << 1 | spread(cell.z as u64) << 2
}

/// Moves bit `i` of a 21-bit number to bit `3i`.
fn spread(mut x: u64) -> u64 {
    x = (x | x << 32) & 0x001F_0000_0000_FFFF;
    x = (x | x << 16) & 0x001F_0000_FF00_00FF;
    x = (x | x << 8) & 0x100F_00F0_0F00_F00F;
    x = (x | x << 4) & 0x10C3_0C30_C30C_30C3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbours_follow_each_other() {
        let order = coherent_order(1000, |i| Vec3::splat((i * 617 % 1000) as f32 / 1000.0));
        assert!(order.windows(2).all(|w| w[0] * 617 % 1000 < w[1] * 617 % 1000));
    }

    #[test]
    fn bits_are_interleaved() {
        assert_eq!(spread(0b1011), 0b001_000_001_001);
        assert_eq!(spread((1 << 21) - 1), 0x1249_2492_4924_9249);
        assert_eq!(morton_code(Vec3::NEG_ONE), 0);
        assert!(morton_code(Vec3::new(-1.0, -1.0, 0.0)) > morton_code(Vec3::new(-0.01, -0.01, -0.01)));
    }
}
