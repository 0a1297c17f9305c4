//! Random numbers as a pure function of (seed, point, replicate, sample, dimension).

use hplt_geom::glam::DVec2;

/// Owen-scrambled Sobol points serve this many bounces; the stream serves the rest.
const SOBOL_BOUNCES: u32 = 2;
/// `sobol_burley` has this many points; then it goes on with another scrambling.
const SOBOL_LENGTH: u32 = 1 << 16;

/// The random numbers that one vertex of a path needs, each in `[0, 1)`.
#[derive(Debug, Clone, Copy)]
pub(super) struct VertexNumbers {
    pub(super) direction: DVec2,
    pub(super) emitter_pick: f64,
    pub(super) emitter: DVec2,
    pub(super) punctual_pick: f64,
    pub(super) distant: DVec2,
}

/// The random numbers of one path.
#[derive(Debug, Clone)]
pub(crate) struct PathNumbers {
    scrambling: u32,
    index: u32,
    stream: u64,
}

/// A well-mixed function of its arguments (the finaliser of SplitMix64, chained).
pub(super) fn hash(words: &[u64]) -> u64 {
    words.iter().fold(0x243f_6a88_85a3_08d3, |state, &word| mix(state ^ word.wrapping_mul(0x9e37_79b9_7f4a_7c15)))
}

fn mix(mut z: u64) -> u64 {
    z = z.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl PathNumbers {
    /// The numbers of sample `index` of the replicate whose key is `key`.
    pub(crate) fn new(key: u64, index: u64) -> Self {
        let epoch = index / u64::from(SOBOL_LENGTH);
        let scrambling = hash(&[key, epoch]) as u32;
        Self { scrambling, index: (index % u64::from(SOBOL_LENGTH)) as u32, stream: hash(&[key, index, 1]) }
    }

    /// The numbers of the vertex after `bounce` bounces.
    pub(super) fn vertex(&mut self, bounce: u32) -> VertexNumbers {
        let [a, b] = if bounce < SOBOL_BOUNCES {
            [2 * bounce, 2 * bounce + 1]
                .map(|set| sobol_burley::sample_4d(self.index, set, self.scrambling).map(f64::from))
        } else {
            [std::array::from_fn(|_| self.uniform()), std::array::from_fn(|_| self.uniform())]
        };
        VertexNumbers {
            direction: DVec2::new(a[0], a[1]),
            emitter_pick: a[2],
            punctual_pick: a[3],
            emitter: DVec2::new(b[0], b[1]),
            distant: DVec2::new(b[2], b[3]),
        }
    }

    /// The place within a pixel.
    pub(super) fn pixel(&self) -> DVec2 {
        let [x, y, _, _] = sobol_burley::sample_4d(self.index, 2 * SOBOL_BOUNCES, self.scrambling);
        DVec2::new(x.into(), y.into())
    }

    /// The next number of the stream.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.stream = self.stream.wrapping_add(0x9e37_79b9_7f4a_7c15);
        (mix(self.stream) >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_depend_on_every_argument() {
        let mut sums = [0.0; 4];
        for i in 0..4096 {
            let mut numbers = PathNumbers::new(7, i);
            let (near, far) = (numbers.vertex(0), numbers.vertex(5));
            for (sum, x) in sums.iter_mut().zip([near.direction.x, near.emitter.y, far.direction.x, far.distant.y]) {
                assert!((0.0..1.0).contains(&x));
                *sum += x / 4096.0;
            }
        }
        assert!(sums[..2].iter().all(|s| (s - 0.5).abs() < 1e-3), "{sums:?}");
        assert!(sums[2..].iter().all(|s| (s - 0.5).abs() < 0.02), "{sums:?}");
        let first = |key, index| PathNumbers::new(key, index).vertex(0).direction.x;
        assert!(first(1, 0) != first(2, 0) && first(1, 0) != first(1, 1) && first(1, 0) != first(1, 1 << 16));
    }
}
