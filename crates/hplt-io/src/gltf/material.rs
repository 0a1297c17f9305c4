use std::collections::BTreeMap;

use glam::{Mat2, Vec2};
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{AlphaMask, Material, MaterialId, Rgb, SceneBuilder, Sides, TextureSlot, UvTransform, Wrap};

use super::buffers::{Buffers, item, undefined};
use super::extensions::advice;
use super::json::{self, Document, TextureInfo};
use crate::texture::{Decoded, TextureBudget, decode};
use crate::{Error, LoadOptions, LoadReport, policy};

/// Albedo of triangles that have no material.
const DEFAULT_ALBEDO: f32 = 0.8;

/// The materials that the scene uses, each read when the first triangle needs it.
pub(super) struct Materials<'a> {
    document: &'a Document,
    buffers: &'a Buffers<'a>,
    options: &'a LoadOptions,
    /// By material index and whether the mesh has the texture coordinates that the material wants.
    known: BTreeMap<(Option<u32>, bool), MaterialId>,
    images: BTreeMap<u32, Decoded>,
    budget: TextureBudget,
}

/// A texture as a material uses it, with the facts about its picture.
struct Slot<'i> {
    slot: TextureSlot,
    image: &'i Decoded,
}

impl<'a> Materials<'a> {
    pub(super) fn new(document: &'a Document, buffers: &'a Buffers<'a>, options: &'a LoadOptions) -> Self {
        let (known, images, budget) = (BTreeMap::new(), BTreeMap::new(), TextureBudget::default());
        Self { document, buffers, options, known, images, budget }
    }

    /// The set of texture coordinates (`TEXCOORD_n`) that a material looks up; `None` when it has no texture.
    pub(super) fn uv_set(&self, index: Option<u32>) -> Result<Option<u32>, Error> {
        let Some(index) = index else { return Ok(None) };
        let material = item(&self.document.materials, index, "materials")?;
        let info = base_color(material).texture.or(material.emissive_texture.as_ref());
        Ok(info.map(uv_set_of))
    }

    /// The material at `index`; without `has_uvs`, its textures are replaced by their mean.
    pub(super) fn get(
        &mut self,
        index: Option<u32>,
        has_uvs: bool,
        scene: &mut SceneBuilder,
        report: &mut LoadReport,
    ) -> Result<MaterialId, Error> {
        if let Some(&id) = self.known.get(&(index, has_uvs)) {
            return Ok(id);
        }
        let material = match index {
            Some(index) => self.read(index, has_uvs, report)?,
            None => {
                report.warn(format!("triangles without a material are grey, albedo {DEFAULT_ALBEDO}"));
                Material::diffuse("(no material)", Rgb::splat(DEFAULT_ALBEDO))
            }
        };
        let id = scene.push_material(material);
        self.known.insert((index, has_uvs), id);
        report.materials = self.known.len() as u64;
        (report.textures, report.texture_bytes) = (self.budget.n_images, self.budget.bytes);
        Ok(id)
    }

    fn read(&mut self, index: u32, has_uvs: bool, report: &mut LoadReport) -> Result<Material, Error> {
        let source = item(&self.document.materials, index, "materials")?;
        let name = source.name.as_deref().filter(|n| !n.is_empty());
        let name = name.map_or_else(|| format!("material {index}"), crate::sanitized);
        let place = format!("materials[{index}] \"{name}\"");
        let base = base_color(source);
        for info in [base.texture, source.emissive_texture.as_ref()].into_iter().flatten() {
            self.load_image(info).map_err(|e| e.within(&place))?;
        }
        let base_slot = base.texture.map(|info| self.slot(info)).transpose().map_err(|e| e.within(&place))?;
        let glow_slot =
            source.emissive_texture.as_ref().map(|info| self.slot(info)).transpose().map_err(|e| e.within(&place))?;
        warn_about(source, &name, report);

        let mut material = Material::diffuse(name, Rgb::from(base.factor.map(|x| x as f32)));
        let strength = source.extensions.as_deref().and_then(|e| e.emissive_strength.as_ref());
        let strength = strength.and_then(|s| s.emissive_strength).unwrap_or(1.0);
        let radiance = source.emissive_factor.unwrap_or_default().map(|x| (x * strength) as f32);
        material.exitance = exitance_from_radiance(Rgb::from(radiance));
        material.reflects = if self.options.one_sided && !source.double_sided { Sides::Front } else { Sides::Both };
        material.emits = if source.double_sided { Sides::Both } else { Sides::Front };
        material.alpha = alpha_mask(source, base.alpha, base_slot.as_ref(), has_uvs, &place)?;

        let mut brightest = Rgb::ONE;
        if let Some(Slot { slot, image }) = base_slot {
            if has_uvs {
                brightest = image.brightest;
                material.albedo_texture = Some(slot);
            } else {
                material.albedo *= image.mean;
                report.warn(format!("{place}: a mesh has no texture coordinates; the mean of the texture is used"));
            }
        }
        if let Some(Slot { slot, image }) = glow_slot
            && material.is_emissive()
        {
            let same_set =
                base.texture.is_none_or(|b| Some(uv_set_of(b)) == source.emissive_texture.as_ref().map(uv_set_of));
            if has_uvs && same_set {
                material.exitance_texture = Some(slot);
            } else {
                material.exitance *= image.mean;
                report.warn(format!(
                    "{place}: the emissive texture has texture coordinates of its own; its mean is used"
                ));
            }
        }
        policy::apply(&mut material, brightest, self.options, report);
        Ok(material)
    }

    /// Decodes the picture of a texture unless it is there already.
    fn load_image(&mut self, info: &TextureInfo) -> Result<(), Error> {
        let (index, image) = image_of(self.document, info)?;
        if self.images.contains_key(&index) {
            return Ok(());
        }
        let place = format!("images[{index}]");
        let limits = &self.options.limits;
        let result = match (&image.uri, image.buffer_view) {
            (Some(uri), None) => self
                .buffers
                .external(uri)
                .and_then(|(_, bytes)| decode(&bytes, limits, &mut self.budget))
                .map_err(|e| e.within(&format!("{place}.uri"))),
            (None, Some(view)) => self.buffers.view(view).and_then(|view| decode(view.bytes, limits, &mut self.budget)),
            _ => Err(undefined("uri or bufferView")),
        };
        let decoded = result.map_err(|e| e.within(&place))?;
        self.images.insert(index, decoded);
        Ok(())
    }

    fn slot(&self, info: &TextureInfo) -> Result<Slot<'_>, Error> {
        let (index, _) = image_of(self.document, info)?;
        let image = self.images.get(&index).ok_or_else(|| undefined(&format!("images[{index}]")))?;
        let texture = item(&self.document.textures, info.index.unwrap_or(0), "textures")?;
        let wrap = match texture.sampler {
            Some(sampler) => {
                let sampler = item(&self.document.samplers, sampler, "samplers")?;
                [wrap(sampler.wrap_s)?, wrap(sampler.wrap_t)?]
            }
            None => [Wrap::Repeat; 2],
        };
        let slot = TextureSlot { texture: image.texture.clone(), transform: uv_transform(info)?, wrap };
        Ok(Slot { slot, image })
    }
}

struct BaseColor<'a> {
    factor: [f64; 3],
    alpha: f64,
    texture: Option<&'a TextureInfo>,
}

fn base_color(material: &json::Material) -> BaseColor<'_> {
    let glossy = material.extensions.as_deref().and_then(|e| e.specular_glossiness.as_ref());
    let (factor, texture) = match (&material.pbr_metallic_roughness, glossy) {
        (_, Some(glossy)) => (glossy.diffuse_factor, glossy.diffuse_texture.as_ref()),
        (Some(pbr), None) => (pbr.base_color_factor, pbr.base_color_texture.as_ref()),
        (None, None) => (None, None),
    };
    let [r, g, b, alpha] = factor.unwrap_or([1.0; 4]);
    BaseColor { factor: [r, g, b], alpha, texture }
}

fn warn_about(material: &json::Material, name: &str, report: &mut LoadReport) {
    let extensions = material.extensions.as_deref();
    let glossy = extensions.is_some_and(|e| e.specular_glossiness.is_some());
    let metallic = material.pbr_metallic_roughness.as_ref().and_then(|pbr| pbr.metallic_factor).unwrap_or(1.0);
    if metallic > 0.0 && !glossy {
        report.warn(format!(
            "material \"{name}\": metallic {metallic} is ignored; its base colour is its diffuse albedo"
        ));
    }
    if material.alpha_mode.as_deref() == Some("BLEND") {
        report.warn(format!("material \"{name}\": alphaMode BLEND is treated as opaque"));
    }
    if extensions.is_some_and(|e| e.unlit.is_some()) {
        report.warn(format!("material \"{name}\": unlit; treated as a diffuse reflector"));
    }
    if extensions.is_some_and(|e| e.transmission.is_some()) {
        report.warn(format!("material \"{name}\": transmission is ignored; treated as opaque"));
    }
}

/// The cut-out of a material; none where nothing is cut away.
fn alpha_mask(
    material: &json::Material,
    factor: f64,
    base: Option<&Slot<'_>>,
    has_uvs: bool,
    place: &str,
) -> Result<Option<AlphaMask>, Error> {
    match material.alpha_mode.as_deref() {
        None | Some("OPAQUE" | "BLEND") => return Ok(None),
        Some("MASK") => {}
        Some(other) => {
            let message = format!("\"{}\"; expected OPAQUE, MASK or BLEND", crate::sanitized(other));
            return Err(Error::invalid(format!("{place}, alphaMode"), "VALUE_NOT_IN_LIST", message));
        }
    }
    let cutoff = finite_f32(material.alpha_cutoff.unwrap_or(0.5), &format!("{place}, alphaCutoff"))?;
    let factor = finite_f32(factor, &format!("{place}, baseColorFactor[3]"))?;
    let texture = base.filter(|_| has_uvs);
    if factor * texture.map_or(1.0, |t| t.image.least_alpha) >= cutoff {
        return Ok(None);
    }
    Ok(Some(AlphaMask { factor, texture: texture.map(|t| t.slot.clone()), cutoff }))
}

/// The index and the entry of the picture behind a texture.
fn image_of<'a>(document: &'a Document, info: &TextureInfo) -> Result<(u32, &'a json::Image), Error> {
    let index = info.index.ok_or_else(|| undefined("texture index"))?;
    let texture = item(&document.textures, index, "textures")?;
    let place = format!("textures[{index}]");
    let Some(source) = texture.source else {
        let extensions = texture.extensions.as_deref();
        let needed = extensions.and_then(|e| {
            let candidates = [
                ("KHR_texture_basisu", &e.basisu),
                ("EXT_texture_webp", &e.webp),
                ("EXT_texture_avif", &e.avif),
                ("MSFT_texture_dds", &e.dds),
            ];
            candidates.into_iter().find(|(_, present)| present.is_some()).map(|(name, _)| name)
        });
        return Err(match needed {
            Some(name) => {
                let message = format!("needs {name}, which hplt does not read; {}", advice(name));
                Error::invalid(place, "UNSUPPORTED_EXTENSION", message)
            }
            None => undefined(&format!("{place}.source")),
        });
    };
    Ok((source, item(&document.images, source, "images").map_err(|e| e.within(&place))?))
}

fn uv_set_of(info: &TextureInfo) -> u32 {
    transform_of(info).and_then(|t| t.tex_coord).unwrap_or(info.tex_coord)
}

fn transform_of(info: &TextureInfo) -> Option<&json::TextureTransform> {
    info.extensions.as_deref()?.transform.as_ref()
}

/// `offset + rotation · scale · uv`, the rotation counter-clockwise seen with v downwards.
fn uv_transform(info: &TextureInfo) -> Result<UvTransform, Error> {
    let Some(transform) = transform_of(info) else { return Ok(UvTransform::default()) };
    let [sx, sy] = transform.scale.unwrap_or([1.0; 2]);
    let [ox, oy] = transform.offset.unwrap_or_default();
    let (sin, cos) = transform.rotation.unwrap_or(0.0).sin_cos();
    let place = "KHR_texture_transform";
    let number = |x: f64| finite_f32(x, place);
    let linear = Mat2::from_cols(
        Vec2::new(number(cos * sx)?, number(-sin * sx)?),
        Vec2::new(number(sin * sy)?, number(cos * sy)?),
    );
    Ok(UvTransform { linear, offset: Vec2::new(number(ox)?, number(oy)?) })
}

fn wrap(code: Option<u64>) -> Result<Wrap, Error> {
    match code {
        None | Some(10497) => Ok(Wrap::Repeat),
        Some(33071) => Ok(Wrap::Clamp),
        Some(33648) => Ok(Wrap::Mirror),
        Some(code) => {
            let message = format!("{code}; expected 10497, 33071 or 33648");
            Err(Error::invalid("sampler wrap", "VALUE_NOT_IN_LIST", message))
        }
    }
}

/// The number in single precision.
fn finite_f32(x: f64, place: &str) -> Result<f32, Error> {
    let single = x as f32;
    if single.is_finite() { Ok(single) } else { Err(Error::invalid(place, "VALUE_NOT_IN_RANGE", format!("{x}"))) }
}
