//! x
use glam::Vec2;

/// x
#[derive(Debug, Clone)]
pub struct Guide {
    n: usize,
    /// density per cell, mean 1
    density: Vec<f32>,
}

impl Guide {
    /// x
    pub fn learn(at: &[Vec2], found: &[f32]) -> Self {
        let env = |k: &str, d: f32| std::env::var(k).ok().and_then(|s| s.parse().ok()).unwrap_or(d);
        let n = env("GN", 8.0) as usize;
        let uniform = env("GU", 0.3);
        let mut squares = vec![0.0f32; n * n];
        let mut count = vec![0.0f32; n * n];
        for (at, found) in at.iter().zip(found) {
            let i = ((at.x * n as f32) as usize).min(n - 1) + n * ((at.y * n as f32) as usize).min(n - 1);
            squares[i] += found * found;
            count[i] += 1.0;
        }
        let raw: Vec<f32> = squares.iter().zip(&count).map(|(s, c)| (s / c.max(1.0)).sqrt()).collect();
        let blur = env("GB", 0.5);
        let smooth: Vec<f32> = (0..n * n).map(|i| {
            let (x, y) = ((i % n) as i32, (i / n) as i32);
            let mut s = raw[i]; let mut w = 1.0;
            for (dx, dy) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
                let (x, y) = (x + dx, y + dy);
                if x >= 0 && y >= 0 && x < n as i32 && y < n as i32 { s += blur * raw[x as usize + n * y as usize]; w += blur; }
            }
            s / w
        }).collect();
        let mean = smooth.iter().sum::<f32>() / (n * n) as f32;
        let density = if mean > 0.0 { smooth.iter().map(|s| uniform + (1.0 - uniform) * s / mean).collect() } else { vec![1.0; n * n] };
        Self { n, density }
    }

    /// x
    pub fn warp(&self, u: Vec2) -> (Vec2, f32) {
        let n = self.n;
        let pick = |weights: &dyn Fn(usize) -> f32, u: f32| {
            let total: f32 = (0..n).map(weights).sum();
            let mut rest = u * total;
            for i in 0..n {
                let w = weights(i);
                if rest < w || i == n - 1 { return (i, (rest / w).clamp(0.0, 0.999_999_9)); }
                rest -= w;
            }
            unreachable!()
        };
        let (row, y) = pick(&|j| self.density[n * j..n * (j + 1)].iter().sum(), u.y);
        let (column, x) = pick(&|i| self.density[n * row + i], u.x);
        (Vec2::new(column as f32 + x, row as f32 + y) / n as f32, 1.0 / self.density[n * row + column])
    }
}
