use glam::Vec2;

use crate::{AlphaMask, Scene, TriangleId};

/// What alpha masks cut away, in a form that a hit test can ask. Empty when no material has a mask.
#[derive(Debug, Clone, Default)]
pub(super) struct Cutouts {
    /// Index into `masked` per triangle, or one of the two constants below; empty when no triangle is cut.
    entry: Vec<u32>,
    masked: Vec<MaskedTriangle>,
    masks: Vec<AlphaMask>,
}

#[derive(Debug, Clone, Copy)]
struct MaskedTriangle {
    mask: u32,
    uvs: [Vec2; 3],
}

const OPAQUE: u32 = u32::MAX;
const INVISIBLE: u32 = u32::MAX - 1;

/// What the mask of a material does to its triangles.
#[derive(Clone, Copy)]
enum Effect {
    None,
    CutsAll,
    Texture(u32),
}

impl Cutouts {
    pub(super) fn new(scene: &Scene) -> Self {
        let mut cutouts = Self::default();
        let effects: Vec<Effect> = scene.materials().iter().map(|m| cutouts.effect(m.alpha.as_ref())).collect();
        if effects.iter().all(|effect| matches!(effect, Effect::None)) {
            return cutouts;
        }
        let mesh = scene.mesh();
        for triangle in (0..mesh.n_triangles() as u32).map(TriangleId) {
            let entry = match effects[mesh.material(triangle).0 as usize] {
                Effect::None => OPAQUE,
                Effect::CutsAll => INVISIBLE,
                Effect::Texture(mask) => {
                    cutouts.masked.push(MaskedTriangle { mask, uvs: mesh.corner_uvs(triangle) });
                    cutouts.masked.len() as u32 - 1
                }
            };
            cutouts.entry.push(entry);
        }
        cutouts
    }

    fn effect(&mut self, mask: Option<&AlphaMask>) -> Effect {
        match mask {
            None => Effect::None,
            Some(mask) if mask.texture.is_none() => {
                if mask.is_opaque(Vec2::ZERO) {
                    Effect::None
                } else {
                    Effect::CutsAll
                }
            }
            Some(mask) => {
                self.masks.push(mask.clone());
                Effect::Texture(self.masks.len() as u32 - 1)
            }
        }
    }

    pub(super) fn is_invisible(&self, triangle: TriangleId) -> bool {
        self.entry.get(triangle.index()) == Some(&INVISIBLE)
    }

    pub(super) fn is_masked(&self, triangle: TriangleId) -> bool {
        self.entry.get(triangle.index()).is_some_and(|&entry| entry < INVISIBLE)
    }

    /// Whether the surface is there at barycentric weights `(1-u-v, u, v)` of a masked triangle.
    pub(super) fn is_opaque_at(&self, triangle: TriangleId, u: f32, v: f32) -> bool {
        let MaskedTriangle { mask, uvs: [a, b, c] } = self.masked[self.entry[triangle.index()] as usize];
        self.masks[mask as usize].is_opaque(a * (1.0 - u - v) + b * u + c * v)
    }

    pub(super) fn n_masked(&self) -> usize {
        self.masked.len()
    }

    pub(super) fn n_invisible(&self) -> usize {
        self.entry.iter().filter(|&&entry| entry == INVISIBLE).count()
    }

    pub(super) fn memory(&self) -> usize {
        size_of_val(&self.entry[..]) + size_of_val(&self.masked[..])
    }
}
