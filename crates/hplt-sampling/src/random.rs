//! Counter-based random numbers: a pure function of seed, stage, point, ray and dimension.
//!
//! The mixing function is pcg4d (Jarzynski & Olano, "Hash Functions for GPU Rendering", JCGT 9(3), 2020, listing 4.2)
//! with one more round, without which counters in some arguments leave a pattern. It uses `u32` operations only, so that
//! a shader gives the same bits. It is not for secrets.

/// What a random number is used for. Numbers of different stages are independent.
///
/// The discriminants are part of the test vectors: they never change.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
#[non_exhaustive]
pub enum Stage {
    /// Candidates for basis functions.
    Candidates = 1,
    /// The coarse points that regions are made of.
    Regions = 2,
    /// Rays that look for what a point sees.
    Probe = 3,
    /// Gathers of indirect light.
    Gather = 4,
    /// Projection of direct light.
    Direct = 5,
    /// Positions within a pixel.
    Pixel = 6,
    /// Points and rays that measure errors.
    Error = 7,
    /// Points that measure the coverage of a hierarchy.
    Coverage = 8,
    /// Rays from emitters that find what is lit.
    Emission = 9,
    /// Final gathers at receivers.
    FinalGather = 10,
    /// Light sampled while shading for display.
    Shading = 11,
    /// The reference path tracer.
    Reference = 12,
}

/// The random numbers of one seed and stage.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stream {
    key: [u32; 4],
}

impl Stream {
    /// The stream of `seed` and `stage`.
    pub fn new(seed: u64, stage: Stage) -> Self {
        Self { key: pcg4d([seed as u32, (seed >> 32) as u32, stage as u32, 0x9E37_79B9]) }
    }

    /// Four independent words at once.
    pub fn words(&self, point: u32, ray: u32, dimension: u32) -> [u32; 4] {
        let [a, b, c, d] = self.key;
        pcg4d([point ^ a, ray ^ b, dimension ^ c, d])
    }

    /// The first of [`Stream::words`].
    pub fn word(&self, point: u32, ray: u32, dimension: u32) -> u32 {
        self.words(point, ray, dimension)[0]
    }
}

/// A random word: `Stream::new(seed, stage).word(point, ray, dimension)`.
pub fn hash(seed: u64, stage: Stage, point: u32, ray: u32, dimension: u32) -> u32 {
    Stream::new(seed, stage).word(point, ray, dimension)
}

/// The word as a number in `[0, 1)`, from its upper 24 bits: exact, and never 1.
pub fn unit_f32(word: u32) -> f32 {
    (word >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Two words as a number in `[0, 1)`, from their upper 53 bits.
pub fn unit_f64(high: u32, low: u32) -> f64 {
    let bits = (u64::from(high) << 32 | u64::from(low)) >> 11;
    bits as f64 * (1.0 / 9_007_199_254_740_992.0)
}

/// Mixes four words: a permutation of 128 bits.
pub fn pcg4d(v: [u32; 4]) -> [u32; 4] {
    let mut v = v.map(|c| c.wrapping_mul(1_664_525).wrapping_add(1_013_904_223));
    for _ in 0..3 {
        v = cross_mix(v).map(|c| c ^ (c >> 16));
    }
    v
}

fn cross_mix([mut x, mut y, mut z, mut w]: [u32; 4]) -> [u32; 4] {
    x = x.wrapping_add(y.wrapping_mul(w));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    w = w.wrapping_add(y.wrapping_mul(z));
    [x, y, z, w]
}
