//! The part of the glTF 2.0 schema that light transport needs. Everything else in a file is skipped without being stored.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Error as _, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};

use crate::{Error, Limits};

/// Entries that a list may have, so that an array of empty objects cannot grow a hundredfold in memory.
const MAX_ENTRIES: usize = 1_000_000;
/// Part of the message when a list has more.
const TOO_MANY: &str = "entries exceed the limit";

/// A list of at most [`MAX_ENTRIES`].
#[derive(Debug)]
pub(super) struct List<T>(Vec<T>);

impl<T> Default for List<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> std::ops::Deref for List<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.0
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Bounded<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Bounded<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an array")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<List<T>, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = seq.next_element()? {
                    if entries.len() == MAX_ENTRIES {
                        return Err(A::Error::custom(TOO_MANY));
                    }
                    entries.push(entry);
                }
                Ok(List(entries))
            }
        }
        deserializer.deserialize_seq(Bounded(PhantomData))
    }
}

/// Names and the accessors behind them, in the order of the file.
#[derive(Debug, Default)]
pub(super) struct Attributes(Vec<(String, u32)>);

impl Attributes {
    pub(super) fn get(&self, name: &str) -> Option<u32> {
        self.0.iter().find(|(n, _)| n == name).map(|(_, accessor)| *accessor)
    }

    pub(super) fn has_prefix(&self, prefix: &str) -> bool {
        self.0.iter().any(|(n, _)| n.starts_with(prefix))
    }
}

impl<'de> Deserialize<'de> for Attributes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Names;
        impl<'de> Visitor<'de> for Names {
            type Value = Attributes;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an object of accessor indices")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Attributes, A::Error> {
                let mut attributes = Attributes::default();
                while let Some((name, accessor)) = map.next_entry::<String, u32>()? {
                    if attributes.0.len() == 64 {
                        return Err(A::Error::custom("more than 64 attributes"));
                    }
                    if attributes.get(&name).is_some() {
                        return Err(A::Error::custom(format!("duplicate field `{name}`")));
                    }
                    attributes.0.push((name, accessor));
                }
                Ok(attributes)
            }
        }
        deserializer.deserialize_map(Names)
    }
}

/// Something that is there or not, whatever it holds.
#[derive(Debug)]
pub(super) struct Present;

impl<'de> Deserialize<'de> for Present {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        serde::de::IgnoredAny::deserialize(deserializer).map(|_| Self)
    }
}

macro_rules! objects {
    ($($(#[$meta:meta])* $name:ident { $($(#[$field_meta:meta])* $field:ident: $type:ty,)* })*) => {
        $(
            $(#[$meta])*
            #[derive(Debug, Default, Deserialize)]
            #[serde(default, rename_all = "camelCase")]
            pub(super) struct $name { $($(#[$field_meta])* pub(super) $field: $type,)* }
        )*
    };
}

objects! {
    Document {
        asset: Option<Asset>,
        scene: Option<u32>,
        extensions_used: List<String>,
        extensions_required: List<String>,
        accessors: List<Accessor>,
        animations: Option<Present>,
        buffers: List<Buffer>,
        buffer_views: List<BufferView>,
        cameras: List<Camera>,
        images: List<Image>,
        materials: List<Material>,
        meshes: List<Mesh>,
        nodes: List<Node>,
        samplers: List<Sampler>,
        scenes: List<Scene>,
        textures: List<Texture>,
        extensions: Option<DocumentExtensions>,
    }
    Asset { version: Option<String>, min_version: Option<String>, }
    DocumentExtensions {
        #[serde(rename = "KHR_lights_punctual")]
        lights: Option<Lights>,
    }
    Lights { lights: List<Light>, }
    Light {
        name: Option<String>,
        r#type: Option<String>,
        color: Option<[f64; 3]>,
        intensity: Option<f64>,
        range: Option<f64>,
        spot: Option<Spot>,
    }
    Spot { inner_cone_angle: Option<f64>, outer_cone_angle: Option<f64>, }
    Accessor {
        buffer_view: Option<u32>,
        byte_offset: u64,
        component_type: Option<u64>,
        normalized: bool,
        count: Option<u64>,
        r#type: Option<String>,
        sparse: Option<Box<Sparse>>,
    }
    Sparse { count: u64, indices: SparseIndices, values: SparseValues, }
    SparseIndices { buffer_view: Option<u32>, byte_offset: u64, component_type: u64, }
    SparseValues { buffer_view: Option<u32>, byte_offset: u64, }
    Buffer { uri: Option<String>, byte_length: Option<u64>, }
    BufferView { buffer: Option<u32>, byte_offset: u64, byte_length: Option<u64>, byte_stride: Option<u64>, }
    Camera { name: Option<String>, r#type: Option<String>, perspective: Option<Perspective>, }
    Perspective { yfov: Option<f64>, aspect_ratio: Option<f64>, }
    Image { uri: Option<String>, mime_type: Option<String>, buffer_view: Option<u32>, }
    Texture { sampler: Option<u32>, source: Option<u32>, extensions: Option<Box<TextureExtensions>>, }
    TextureExtensions {
        #[serde(rename = "KHR_texture_basisu")]
        basisu: Option<Present>,
        #[serde(rename = "EXT_texture_webp")]
        webp: Option<Present>,
        #[serde(rename = "EXT_texture_avif")]
        avif: Option<Present>,
        #[serde(rename = "MSFT_texture_dds")]
        dds: Option<Present>,
    }
    Sampler { wrap_s: Option<u64>, wrap_t: Option<u64>, }
    Material {
        name: Option<String>,
        pbr_metallic_roughness: Option<Pbr>,
        emissive_factor: Option<[f64; 3]>,
        emissive_texture: Option<TextureInfo>,
        alpha_mode: Option<String>,
        alpha_cutoff: Option<f64>,
        double_sided: bool,
        extensions: Option<Box<MaterialExtensions>>,
    }
    Pbr { base_color_factor: Option<[f64; 4]>, base_color_texture: Option<TextureInfo>, metallic_factor: Option<f64>, }
    MaterialExtensions {
        #[serde(rename = "KHR_materials_emissive_strength")]
        emissive_strength: Option<EmissiveStrength>,
        #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
        specular_glossiness: Option<SpecularGlossiness>,
        #[serde(rename = "KHR_materials_unlit")]
        unlit: Option<Present>,
        #[serde(rename = "KHR_materials_transmission")]
        transmission: Option<Present>,
    }
    EmissiveStrength { emissive_strength: Option<f64>, }
    SpecularGlossiness { diffuse_factor: Option<[f64; 4]>, diffuse_texture: Option<TextureInfo>, }
    TextureInfo { index: Option<u32>, tex_coord: u32, extensions: Option<Box<TextureInfoExtensions>>, }
    TextureInfoExtensions {
        #[serde(rename = "KHR_texture_transform")]
        transform: Option<TextureTransform>,
    }
    TextureTransform { offset: Option<[f64; 2]>, rotation: Option<f64>, scale: Option<[f64; 2]>, tex_coord: Option<u32>, }
    Mesh { name: Option<String>, primitives: List<Primitive>, }
    Primitive {
        attributes: Attributes,
        indices: Option<u32>,
        material: Option<u32>,
        mode: Option<u64>,
        targets: Option<Present>,
        extensions: Option<Box<PrimitiveExtensions>>,
    }
    PrimitiveExtensions {
        #[serde(rename = "KHR_draco_mesh_compression")]
        draco: Option<Present>,
    }
    Node {
        name: Option<String>,
        children: List<u32>,
        mesh: Option<u32>,
        camera: Option<u32>,
        skin: Option<u32>,
        matrix: Option<Box<[f64; 16]>>,
        translation: Option<Box<[f64; 3]>>,
        rotation: Option<Box<[f64; 4]>>,
        scale: Option<Box<[f64; 3]>>,
        extensions: Option<Box<NodeExtensions>>,
    }
    NodeExtensions {
        #[serde(rename = "KHR_lights_punctual")]
        light: Option<LightReference>,
        #[serde(rename = "EXT_mesh_gpu_instancing")]
        instancing: Option<Instancing>,
    }
    LightReference { light: Option<u32>, }
    Instancing { attributes: Attributes, }
    Scene { nodes: List<u32>, }
}

impl Document {
    /// The document in a JSON text.
    pub(super) fn parse(json: &[u8], limits: &Limits) -> Result<Self, Error> {
        let length = json.len() as u64;
        if length > limits.json_bytes {
            return Err(Error::limit("JSON", "LIMIT_JSON", "bytes", length, limits.json_bytes));
        }
        let items = count_items(json);
        if items > limits.json_items {
            return Err(Error::limit("JSON", "LIMIT_JSON", "objects and arrays", items, limits.json_items));
        }
        let document: Self = serde_json::from_slice(json).map_err(|e| json_error(&e, limits))?;
        if document.nodes.len() as u64 > limits.nodes {
            return Err(Error::limit("nodes", "LIMIT_NODES", "entries", document.nodes.len() as u64, limits.nodes));
        }
        Ok(document)
    }
}

fn json_error(error: &serde_json::Error, limits: &Limits) -> Error {
    let text = error.to_string();
    if text.starts_with(TOO_MANY) {
        let limit = limits.nodes.min(MAX_ENTRIES as u64);
        return Error::limit(format!("line {}", error.line()), "LIMIT_NODES", "entries", limit + 1, limit);
    }
    let code = if error.is_data() { "TYPE_MISMATCH" } else { "INVALID_JSON" };
    Error::invalid("JSON", code, crate::sanitized(&text))
}

/// Opening brackets outside strings.
fn count_items(json: &[u8]) -> u64 {
    let (mut items, mut in_string, mut escaped) = (0, false, false);
    for &byte in json {
        if in_string {
            match byte {
                _ if escaped => escaped = false,
                b'\\' => escaped = true,
                b'"' => in_string = false,
                _ => {}
            }
        } else {
            in_string = byte == b'"';
            items += u64::from(matches!(byte, b'{' | b'['));
        }
    }
    items
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(json: &str) -> &'static str {
        Document::parse(json.as_bytes(), &Limits::default()).map_or_else(|e| e.code(), |_| "ok")
    }

    #[test]
    fn malformed_and_oversized_texts_are_refused() {
        assert_eq!(code("{}"), "ok");
        assert_eq!(code("{} {}"), "INVALID_JSON");
        assert_eq!(code("\u{feff}{}"), "INVALID_JSON");
        assert_eq!(code(&format!("{{\"a\":{}", "[".repeat(100_000))), "INVALID_JSON");
        assert_eq!(code(r#"{"nodes":[{"mesh":-1}]}"#), "TYPE_MISMATCH");
        assert_eq!(code(r#"{"nodes":[],"nodes":[]}"#), "TYPE_MISMATCH");
        assert_eq!(code(r#"{"nodes":[{"scale":[1,2]}]}"#), "TYPE_MISMATCH");
        assert_eq!(code(r#"{"nodes":[{"scale":[1,2,1e999]}]}"#), "INVALID_JSON");
        assert_eq!(code(&format!("{{\"nodes\":[{}{{}}]}}", "{},".repeat(1_000_000))), "LIMIT_NODES");
        assert_eq!(code(&format!("{{\"x\":[{}[]]}}", "[],".repeat(8_000_000))), "LIMIT_JSON");
    }

    #[test]
    fn brackets_in_strings_are_not_counted() {
        assert_eq!(count_items(br#"{"[[\"[":["{"]}"#), 2);
    }
}
