use glam::Vec2;

use crate::texture::Tap;
use crate::{Rgb, Texture, UvTransform, Wrap};

/// Index of a material in its scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MaterialId(pub u32);

/// Which sides of a surface something applies to. The front is the counter-clockwise side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sides {
    /// The front only.
    Front,
    /// Front and back.
    #[default]
    Both,
}

impl Sides {
    /// Whether the given side is among them.
    #[inline]
    pub fn includes(self, is_front: bool) -> bool {
        is_front || self == Self::Both
    }
}

/// A texture as a material uses it.
#[derive(Debug, Clone, PartialEq)]
pub struct TextureSlot {
    /// The image.
    pub texture: Texture,
    /// Applied to the mesh's coordinates first.
    pub transform: UvTransform,
    /// What coordinates outside the unit square mean.
    pub wrap: [Wrap; 2],
}

impl TextureSlot {
    /// The texels around `uv`.
    #[inline]
    pub(crate) fn tap(&self, uv: Vec2) -> Tap {
        self.texture.tap(self.transform.apply(uv), self.wrap)
    }

    fn rgb(&self, uv: Vec2) -> Rgb {
        self.tap(uv).mix().truncate()
    }

    fn alpha(&self, uv: Vec2) -> f32 {
        self.tap(uv).mix().w
    }
}

/// Cuts away where `factor · alpha < cutoff` (glTF `alphaMode = MASK`).
#[derive(Debug, Clone, PartialEq)]
pub struct AlphaMask {
    /// Constant factor.
    pub factor: f32,
    /// Texture whose alpha channel is multiplied in.
    pub texture: Option<TextureSlot>,
    /// The cutoff.
    pub cutoff: f32,
}

impl AlphaMask {
    /// Whether the surface is there at `uv`.
    pub fn is_opaque(&self, uv: Vec2) -> bool {
        self.factor * self.texture.as_ref().map_or(1.0, |slot| slot.alpha(uv)) >= self.cutoff
    }
}

/// An ideal diffuse surface. Every surface blocks light on both sides, whatever it reflects.
#[derive(Debug, Clone, PartialEq)]
pub struct Material {
    /// Name in the scene file.
    pub name: String,
    /// Diffuse albedo `ρ` in `[0, 1]`.
    pub albedo: Rgb,
    /// Multiplied into `albedo`.
    pub albedo_texture: Option<TextureSlot>,
    /// Emitted exitance `M` in W/m², not negative.
    pub exitance: Rgb,
    /// Multiplied into `exitance`.
    pub exitance_texture: Option<TextureSlot>,
    /// The sides that reflect; a side that does not is black.
    pub reflects: Sides,
    /// The sides that emit.
    pub emits: Sides,
    /// Cut-outs.
    pub alpha: Option<AlphaMask>,
}

impl Material {
    /// A plain two-sided reflector.
    pub fn diffuse(name: impl Into<String>, albedo: Rgb) -> Self {
        Self {
            name: name.into(),
            albedo,
            albedo_texture: None,
            exitance: Rgb::ZERO,
            exitance_texture: None,
            reflects: Sides::Both,
            emits: Sides::Front,
            alpha: None,
        }
    }

    /// A reflector whose front also emits `exitance` W/m².
    pub fn emitter(name: impl Into<String>, albedo: Rgb, exitance: Rgb) -> Self {
        Self { exitance, ..Self::diffuse(name, albedo) }
    }

    /// The same in flat colours: the mean of each texture in its place, and surface where the alpha mask would cut it away.
    pub fn flattened(&self) -> Self {
        let mean = |slot: &Option<TextureSlot>| slot.as_ref().map_or(Rgb::ONE, |slot| slot.texture.mean());
        Self {
            name: self.name.clone(),
            albedo: self.albedo * mean(&self.albedo_texture),
            albedo_texture: None,
            exitance: self.exitance * mean(&self.exitance_texture),
            exitance_texture: None,
            alpha: None,
            ..*self
        }
    }

    /// Whether any part of the surface can emit.
    pub fn is_emissive(&self) -> bool {
        self.exitance.max_element() > 0.0
    }

    /// Whether a look-up needs texture coordinates.
    pub fn needs_uvs(&self) -> bool {
        self.albedo_texture.is_some()
            || self.exitance_texture.is_some()
            || self.alpha.as_ref().is_some_and(|mask| mask.texture.is_some())
    }

    /// The albedo of one side at `uv`.
    #[inline]
    pub fn albedo_at(&self, is_front: bool, uv: Vec2) -> Rgb {
        let plain = self.plain_albedo(is_front);
        self.albedo_texture.as_ref().filter(|_| plain != Rgb::ZERO).map_or(plain, |slot| plain * slot.rgb(uv))
    }

    /// The albedo of one side before its texture.
    #[inline]
    pub(crate) fn plain_albedo(&self, is_front: bool) -> Rgb {
        if self.reflects.includes(is_front) { self.albedo } else { Rgb::ZERO }
    }

    /// The emitted exitance of one side at `uv`.
    #[inline]
    pub fn exitance_at(&self, is_front: bool, uv: Vec2) -> Rgb {
        if !self.emits.includes(is_front) {
            return Rgb::ZERO;
        }
        self.exitance_texture.as_ref().map_or(self.exitance, |slot| self.exitance * slot.rgb(uv))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_flat_material_has_the_mean_colour_and_no_holes() {
        let texture = Texture::from_rgba8(2, 1, vec![[0, 0, 0, 0], [255, 255, 255, 255]]).unwrap();
        let slot = TextureSlot { texture, transform: UvTransform::default(), wrap: [Wrap::Repeat; 2] };
        let textured = Material {
            albedo_texture: Some(slot.clone()),
            exitance_texture: Some(slot.clone()),
            alpha: Some(AlphaMask { factor: 1.0, texture: Some(slot), cutoff: 0.5 }),
            emits: Sides::Both,
            ..Material::emitter("leaf", Rgb::new(0.8, 0.4, 0.0), Rgb::splat(3.0))
        };
        let flat =
            Material { emits: Sides::Both, ..Material::emitter("leaf", Rgb::new(0.4, 0.2, 0.0), Rgb::splat(1.5)) };
        assert_eq!(textured.flattened(), flat);
        assert_eq!(flat.flattened(), flat);
    }
}
