//! The transfer curve of IEC 61966-2-1.

/// The linear value of an encoded byte.
pub fn linear_from_srgb(code: u8) -> f32 {
    let c = f64::from(code) / 255.0;
    let linear = if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) };
    linear as f32
}

/// The byte whose value is nearest to `linear` in `[0, 1]`, on the encoded scale.
#[cfg(feature = "png")]
pub(crate) fn encode(linear: f32) -> u8 {
    let x = f64::from(linear);
    let c = if x <= 0.0031308 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (c * 255.0 + 0.5).clamp(0.0, 255.0) as u8
}

#[cfg(all(test, feature = "png"))]
mod tests {
    use super::*;

    #[test]
    fn every_byte_returns_to_itself() {
        for code in 0..=255 {
            assert_eq!(encode(linear_from_srgb(code)), code);
        }
        assert!((linear_from_srgb(188) - 0.502_886_5).abs() < 1e-6);
    }
}
