#[cfg(any(feature = "gltf", feature = "obj"))]
use glam::Vec3;

use crate::error::sanitized;

/// Warnings beyond this many are only counted.
const MAX_WARNINGS: usize = 100;

/// What a scene file held, what was changed on the way in, and what was left out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct LoadReport {
    /// What the user should know, one line each, at most 100; safe to print.
    pub warnings: Vec<String>,
    /// Warnings that are not listed because there were too many.
    pub suppressed_warnings: u64,
    /// What the file holds and the scene does not, with the reason, one line each; safe to print.
    pub left_out: Vec<String>,
    /// Nodes (glTF) or objects and groups (OBJ) that are part of the scene.
    pub nodes: u64,
    /// Meshes after instancing.
    pub instances: u64,
    /// Triangles before degenerate ones and duplicates are dropped.
    pub triangles: u64,
    /// Vertices.
    pub vertices: u64,
    /// Materials that are used.
    pub materials: u64,
    /// Images decoded.
    pub textures: u64,
    /// Bytes of the decoded images.
    pub texture_bytes: u64,
    /// Punctual lights.
    pub lights: u64,
    /// Cameras.
    pub cameras: u64,
    /// Materials whose albedo was lowered to the cap.
    pub capped_materials: Vec<String>,
    /// Materials whose values were clamped into their range, on request.
    pub clamped_materials: Vec<String>,
    /// Triangles whose front disagrees with their vertex normals.
    pub winding_disagreements: u64,
    /// How finely the file places vertices where it places them most coarsely, m: the spacing of numbers of 32 bits at the largest
    /// coordinate. A surface far from the origin of its mesh is rounded to it.
    pub coordinate_quantum: f64,
    /// Names of the scene's cameras, safe to print; empty names for those that have none.
    pub camera_names: Vec<String>,
}

impl LoadReport {
    /// Takes note of how finely numbers of 32 bits place these vertices, which are then made larger by `scale`.
    #[cfg(any(feature = "gltf", feature = "obj"))]
    pub(crate) fn note_rounding(&mut self, positions: &[Vec3], scale: f64) {
        let largest = positions.iter().map(|p| p.abs().max_element()).filter(|x| x.is_finite()).fold(0.0, f32::max);
        let next = f32::from_bits(largest.to_bits() + 1);
        self.coordinate_quantum = self.coordinate_quantum.max((f64::from(next) - f64::from(largest)) * scale);
    }

    /// Adds a warning.
    pub(crate) fn warn(&mut self, warning: impl AsRef<str>) {
        push_bounded(&mut self.warnings, &mut self.suppressed_warnings, warning.as_ref());
    }

    /// Adds something that was left out.
    #[cfg(any(feature = "gltf", feature = "obj"))]
    pub(crate) fn leave_out(&mut self, what: impl AsRef<str>) {
        push_bounded(&mut self.left_out, &mut self.suppressed_warnings, what.as_ref());
    }
}

fn push_bounded(list: &mut Vec<String>, suppressed: &mut u64, text: &str) {
    if list.len() >= MAX_WARNINGS {
        *suppressed += 1;
        return;
    }
    let text = sanitized(text);
    if !list.contains(&text) {
        list.push(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_are_bounded_and_not_repeated() {
        let mut report = LoadReport::default();
        for i in 0..1000 {
            report.warn(format!("material {i}"));
            report.warn("metallic");
        }
        assert_eq!(report.warnings.len(), MAX_WARNINGS);
        assert_eq!(report.warnings.iter().filter(|w| *w == "metallic").count(), 1);
        assert!(report.suppressed_warnings >= 900);
    }
}
