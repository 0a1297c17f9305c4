use glam::Vec3;

/// A radial kernel: the weight at `h = d/b`, 1 at `h = 0`, 0 from `h = 1` on, falling in between.
#[derive(Debug, Clone, Copy, Default)]
pub enum Kernel {
    /// [`smoothstep`], which is computed for several functions at once.
    #[default]
    Smoothstep,
    /// Another one.
    Custom(fn(f32) -> f32),
}

impl Kernel {
    /// The weight at `h`.
    #[inline]
    pub fn weight(self, h: f32) -> f32 {
        match self {
            Self::Smoothstep => smoothstep(h),
            Self::Custom(kernel) => kernel(h),
        }
    }
}

/// The kernel `2h³ - 3h² + 1` of Lehtinen et al. 2008, section 4.
#[inline]
pub fn smoothstep(h: f32) -> f32 {
    if h < 1.0 { 1.0 - h * h * (3.0 - 2.0 * h) } else { 0.0 }
}

/// The square of `|Δ + 2 (Δ·n) n|`: distance in an ellipsoid whose axis along the unit normal `n` is shortened to a
/// third.
pub fn distance_squared(offset: Vec3, normal: Vec3) -> f32 {
    let height = offset.dot(normal);
    offset.length_squared() + 8.0 * height * height
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_falls_smoothly_from_one_to_zero() {
        assert_eq!((smoothstep(0.0), smoothstep(0.5), smoothstep(1.0), smoothstep(7.0)), (1.0, 0.5, 0.0, 0.0));
        assert!((1..100).all(|i| smoothstep(i as f32 / 100.0) < smoothstep((i - 1) as f32 / 100.0)));
    }

    #[test]
    fn heights_count_three_times() {
        let offset = Vec3::new(3.0, 0.0, 4.0);
        let expected = (offset + 2.0 * offset.z * Vec3::Z).length_squared();
        assert_eq!(distance_squared(offset, Vec3::Z), expected);
    }
}
