use std::sync::{Arc, OnceLock};

use glam::{DVec3, Mat2, Vec2, Vec4};

use crate::Rgb;

/// An image that materials look up, four bytes a texel, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub struct Texture {
    width: u32,
    height: u32,
    texels: Arc<[[u8; 4]]>,
}

/// What a coordinate outside `[0, 1]` means.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Wrap {
    /// The image repeats.
    #[default]
    Repeat,
    /// Every other copy is mirrored.
    Mirror,
    /// The edge texel continues.
    Clamp,
}

/// `uv' = offset + rotation·scale·uv` (`KHR_texture_transform`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UvTransform {
    /// Rotation times scale.
    pub linear: Mat2,
    /// Offset.
    pub offset: Vec2,
}

impl Default for UvTransform {
    fn default() -> Self {
        Self { linear: Mat2::IDENTITY, offset: Vec2::ZERO }
    }
}

impl UvTransform {
    /// The transformed coordinate.
    pub fn apply(&self, uv: Vec2) -> Vec2 {
        self.linear * uv + self.offset
    }
}

impl Texture {
    /// A texture of `width × height` RGBA texels as stored in the file (colour is sRGB-encoded); `None` when it is
    /// empty or the count of texels does not fit.
    pub fn from_rgba8(width: u32, height: u32, texels: Vec<[u8; 4]>) -> Option<Self> {
        let fits = width > 0 && height > 0 && texels.len() as u64 == u64::from(width) * u64::from(height);
        fits.then(|| Self { width, height, texels: texels.into() })
    }

    /// Texels across and down.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Bytes that the texels take.
    pub fn memory(&self) -> usize {
        self.texels.len() * 4
    }

    /// The mean of all texels: linear RGB, each texel sRGB-decoded before it is added. Alpha has no say.
    pub fn mean(&self) -> Rgb {
        let table = srgb_table();
        let sum: DVec3 =
            self.texels.iter().map(|&[r, g, b, _]| Rgb::from([r, g, b].map(|c| table[c as usize])).as_dvec3()).sum();
        (sum / self.texels.len() as f64).as_vec3()
    }

    /// The bilinear interpolation at `uv` (origin at the top left): linear RGB, each texel sRGB-decoded before it is
    /// mixed, and alpha as stored over 255.
    #[inline]
    pub fn sample(&self, uv: Vec2, wrap: [Wrap; 2]) -> Vec4 {
        self.tap(uv, wrap).mix()
    }

    /// The texels that [`sample`](Self::sample) mixes.
    #[inline]
    pub(crate) fn tap(&self, uv: Vec2, wrap: [Wrap; 2]) -> Tap {
        let x = uv.x * self.width as f32 - 0.5;
        let y = uv.y * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let columns = [wrap_index(x0, self.width, wrap[0]), wrap_index(x0 + 1.0, self.width, wrap[0])];
        let rows = [wrap_index(y0, self.height, wrap[1]), wrap_index(y0 + 1.0, self.height, wrap[1])];
        let texels = rows.map(|row| columns.map(|column| self.texels[row * self.width as usize + column]));
        Tap { texels, at: Vec2::new(x - x0, y - y0) }
    }
}

/// Four neighbouring texels, and a place between them. Fetching them waits for memory, mixing them does not: where there are many, fetch
/// them first.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tap {
    /// By row and column.
    texels: [[[u8; 4]; 2]; 2],
    at: Vec2,
}

impl Tap {
    /// Linear RGB and alpha.
    #[inline]
    pub fn mix(&self) -> Vec4 {
        let table = srgb_table();
        let linear = |[r, g, b, a]: [u8; 4]| {
            Vec4::new(table[r as usize], table[g as usize], table[b as usize], f32::from(a) / 255.0)
        };
        let [top, bottom] =
            self.texels.map(|[left, right]| linear(left) * (1.0 - self.at.x) + linear(right) * self.at.x);
        top * (1.0 - self.at.y) + bottom * self.at.y
    }
}

/// The index of texel `i` (an integer in `f32`, any sign) in a row of `n`.
fn wrap_index(i: f32, n: u32, wrap: Wrap) -> usize {
    let size = n as f32;
    // Most are inside, and an integer remainder is much faster than a floating one.
    if (0.0..size).contains(&i) {
        return i as usize;
    }
    if wrap == Wrap::Repeat && i.abs() < 1e6 && n < 1 << 20 {
        return (i as i32).rem_euclid(n as i32) as usize;
    }
    let wrapped = match wrap {
        Wrap::Clamp => i,
        Wrap::Repeat => i.rem_euclid(size),
        Wrap::Mirror => {
            let m = i.rem_euclid(2.0 * size);
            if m < size { m } else { 2.0 * size - 1.0 - m }
        }
    };
    // Rounding in rem_euclid can reach the upper end for huge coordinates.
    wrapped.clamp(0.0, size - 1.0) as usize
}

fn srgb_table() -> &'static [f32; 256] {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|i| {
            let c = i as f64 / 255.0;
            let linear = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
            linear as f32
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_by_one() -> Texture {
        Texture::from_rgba8(2, 1, vec![[0, 0, 0, 255], [255, 255, 255, 0]]).unwrap()
    }

    #[test]
    fn bilinear_interpolation_mixes_linear_values() {
        let texture = two_by_one();
        let middle = texture.sample(Vec2::new(0.5, 0.5), [Wrap::Clamp; 2]);
        assert!((middle.x - 0.5).abs() < 1e-6 && (middle.w - 0.5).abs() < 1e-6);
        assert_eq!(texture.sample(Vec2::new(0.25, 0.5), [Wrap::Clamp; 2]).x, 0.0);
    }

    #[test]
    fn the_mean_is_of_linear_values_whatever_alpha_says() {
        assert_eq!(two_by_one().mean(), Rgb::splat(0.5));
        let reds = [0, 188].map(|r| [r, 255, 0, 255]);
        let mean = Texture::from_rgba8(1, 2, reds.into()).unwrap().mean();
        assert!((mean - Rgb::new(0.5 * 0.5028865, 1.0, 0.0)).abs().max_element() < 1e-5, "{mean}");
    }

    #[test]
    fn wrap_modes_differ_outside_the_unit_square() {
        let texture = two_by_one();
        let at = |x: f32, wrap| texture.sample(Vec2::new(x, 0.5), [wrap; 2]).x;
        assert_eq!(at(1.25, Wrap::Repeat), 0.0);
        assert_eq!(at(1.25, Wrap::Mirror), 1.0);
        assert_eq!(at(1.25, Wrap::Clamp), 1.0);
        assert!(at(1e30, Wrap::Repeat).is_finite() && at(-1e30, Wrap::Mirror).is_finite());
    }

    #[test]
    fn repeated_indices_are_remainders() {
        for n in [1u32, 2, 3, 7, 256, 1000] {
            for i in (-3000i32..3000).chain([-999_999, 999_999, 1_000_001, 16_000_001]) {
                let expected = i.rem_euclid(n as i32) as usize;
                assert_eq!(wrap_index(i as f32, n, Wrap::Repeat), expected, "{i} of {n}");
            }
        }
    }

    #[test]
    fn mid_grey_is_decoded_from_srgb() {
        let grey = Texture::from_rgba8(1, 1, vec![[188, 188, 188, 255]]).unwrap();
        let value = grey.sample(Vec2::ZERO, [Wrap::Repeat; 2]).x;
        assert!((value - 0.5028865).abs() < 1e-5, "{value}");
    }

    #[test]
    fn an_empty_texture_is_refused() {
        assert!(Texture::from_rgba8(0, 0, vec![]).is_none());
        assert!(Texture::from_rgba8(2, 2, vec![[0; 4]; 3]).is_none());
    }
}
