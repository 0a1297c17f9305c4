use hplt_geom::BuildPolicy;

/// How a scene file is read. Physical defaults; see the crate's documentation for the policies behind them.
#[derive(Debug, Clone, PartialEq)]
pub struct LoadOptions {
    /// What to do about bad values that can be repaired; pass the same policy to `SceneBuilder::build`.
    pub policy: BuildPolicy,
    /// What is refused because of its size.
    pub limits: Limits,
    /// Whether single-sided materials are black on their back; otherwise both sides reflect.
    pub one_sided: bool,
    /// Albedos above this (and up to 1) are lowered to it, with a warning.
    pub max_albedo: f32,
    /// What the numbers of punctual lights mean.
    pub light_unit: LightUnit,
    /// Factor on all lengths, for files that are not in metres (0.001 for millimetres).
    pub length_scale: f64,
}

impl Default for LoadOptions {
    fn default() -> Self {
        Self {
            policy: BuildPolicy::default(),
            limits: Limits::default(),
            one_sided: false,
            max_albedo: 0.98,
            light_unit: LightUnit::Auto,
            length_scale: 1.0,
        }
    }
}

/// What the numbers of punctual lights in a file mean. Emissive surfaces are always taken as they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LightUnit {
    /// The same as `Radiometric`; the report says that it was assumed.
    #[default]
    Auto,
    /// Taken as they are: candela count as W/sr, lux as W/m².
    Radiometric,
    /// Divided by 683 lm/W, for exporters that multiplied watts by it (Blender's "standard" light export).
    Photometric,
}

impl LightUnit {
    /// The factor that turns a number from the file into W/sr or W/m².
    pub fn factor(self) -> f64 {
        match self {
            Self::Auto | Self::Radiometric => 1.0,
            Self::Photometric => 1.0 / 683.0,
        }
    }
}

/// Sizes beyond which a file is refused before anything is allocated for it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of one file.
    pub file_bytes: u64,
    /// Bytes of all files that a scene refers to.
    pub total_bytes: u64,
    /// Bytes of the JSON text of a glTF file.
    pub json_bytes: u64,
    /// Objects and arrays in that text.
    pub json_items: u64,
    /// Bytes of one line of an OBJ, MTL or point file.
    pub line_bytes: u64,
    /// Material libraries of an OBJ file.
    pub material_libraries: u64,
    /// Entries of any top-level array of a glTF file, nodes for one.
    pub nodes: u64,
    /// Generations of nodes.
    pub depth: u64,
    /// Meshes after instancing.
    pub instances: u64,
    /// Triangles after instancing.
    pub triangles: u64,
    /// Estimated bytes of the scene after instancing, without textures.
    pub scene_bytes: u64,
    /// Elements of an accessor that has no bytes behind it.
    pub zero_elements: u64,
    /// Texels of an image along one side.
    pub image_size: u64,
    /// Images that are decoded.
    pub images: u64,
    /// Bytes of all decoded textures together.
    pub texture_bytes: u64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            file_bytes: 4 << 30,
            total_bytes: 16 << 30,
            json_bytes: 512 << 20,
            json_items: 8_000_000,
            line_bytes: 1 << 20,
            material_libraries: 64,
            nodes: 1_000_000,
            depth: 1024,
            instances: 10_000_000,
            triangles: 200_000_000,
            scene_bytes: 32 << 30,
            zero_elements: 4 << 20,
            image_size: 16_384,
            images: 4096,
            texture_bytes: 4 << 30,
        }
    }
}
