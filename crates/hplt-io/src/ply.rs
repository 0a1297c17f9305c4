use std::io::{BufWriter, Write};
use std::path::Path;

use glam::Vec3;
use hplt_geom::Rgb;

use crate::{Error, write_atomically};

/// A point with its light, world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlyPoint {
    /// Position.
    pub position: Vec3,
    /// Unit normal.
    pub normal: Vec3,
    /// Area that it stands for, m².
    pub area: f32,
    /// Irradiance, W/m².
    pub irradiance: Rgb,
    /// Colour to show it in, sRGB.
    pub color: [u8; 3],
}

/// Writes points as binary little-endian PLY with the properties
/// `x y z nx ny nz area irr_r irr_g irr_b` (float) and `red green blue` (uchar).
///
/// # Errors
/// [`Error::Write`] when the file cannot be written.
pub fn write_ply(path: &Path, points: &[PlyPoint]) -> Result<(), Error> {
    write_atomically(path, |file| {
        let mut writer = BufWriter::new(file);
        writer.write_all(header(points.len()).as_bytes())?;
        for point in points {
            let PlyPoint { position, normal, area, irradiance, color } = point;
            let numbers = position.to_array().into_iter().chain(normal.to_array()).chain([*area]);
            for number in numbers.chain(irradiance.to_array()) {
                writer.write_all(&number.to_le_bytes())?;
            }
            writer.write_all(color)?;
        }
        writer.flush()
    })
}

fn header(n_points: usize) -> String {
    let mut header = format!("ply\nformat binary_little_endian 1.0\ncomment made by hplt\nelement vertex {n_points}\n");
    for name in ["x", "y", "z", "nx", "ny", "nz", "area", "irr_r", "irr_g", "irr_b"] {
        header += &format!("property float {name}\n");
    }
    for name in ["red", "green", "blue"] {
        header += &format!("property uchar {name}\n");
    }
    header + "end_header\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_takes_43_bytes_after_the_header() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.ply");
        let point = PlyPoint {
            position: Vec3::new(1.0, 2.0, 3.0),
            normal: Vec3::Y,
            area: 0.25,
            irradiance: Rgb::new(4.0, 5.0, 6.0),
            color: [7, 8, 255],
        };
        write_ply(&path, &[point; 3]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let text = b"end_header\n";
        let body = bytes.windows(text.len()).position(|w| w == text).unwrap() + text.len();
        assert!(String::from_utf8_lossy(&bytes[..body]).contains("element vertex 3\n"));
        assert_eq!(bytes.len() - body, 3 * 43);
        let second = &bytes[body + 43..][..43];
        let floats: Vec<f32> = second[..40].chunks(4).map(|c| f32::from_le_bytes(c.try_into().unwrap())).collect();
        assert_eq!(floats, [1.0, 2.0, 3.0, 0.0, 1.0, 0.0, 0.25, 4.0, 5.0, 6.0]);
        assert_eq!(second[40..], [7, 8, 255]);
    }
}
