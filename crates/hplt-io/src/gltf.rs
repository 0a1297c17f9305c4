//! glTF 2.0: text and containers. The JSON is parsed into our own types, and every number in a buffer is reached through
//! a reader that checks first; see the crate's documentation for what is read and what is left out.

mod accessor;
mod buffers;
mod container;
mod extensions;
mod json;
mod lights;
mod material;
mod nodes;
mod primitive;

use std::collections::BTreeMap;
use std::path::Path;

use glam::{DAffine3, DQuat, DVec3, Vec3};
use hplt_geom::{MeshInput, SceneBuilder};

use self::accessor::Accessor;
use self::buffers::{Buffers, item};
use self::json::{Document, Instancing, Primitive};
use self::material::Materials;
use self::nodes::Placed;
use self::primitive::{Mode, Reader, Triangles};
use crate::files::read_regular;
use crate::folder::Folder;
use crate::{Error, LoadOptions, LoadReport, Loaded};

/// Estimated bytes of a scene per triangle and per mesh, without textures.
const BYTES_PER_TRIANGLE: u64 = 160;
const BYTES_PER_INSTANCE: u64 = 160;

/// The default scene of a file.
pub(crate) fn load(path: &Path, options: &LoadOptions) -> Result<Loaded, Error> {
    let limits = &options.limits;
    let bytes = read_regular(path, limits.file_bytes, |head, length| container::check_head(head, length, limits))?;
    let folder = Folder::of(path, limits.total_bytes)?;
    load_bytes(&bytes, folder, options)
}

fn load_bytes(bytes: &[u8], folder: Folder, options: &LoadOptions) -> Result<Loaded, Error> {
    let (json, bin) = container::split(bytes)?;
    let document = Document::parse(json, &options.limits)?;
    check_version(&document)?;
    let mut report = LoadReport::default();
    extensions::check(&document, &mut report)?;
    let buffers = Buffers::new(&document, bin, folder, &options.limits);
    let reader = Reader { document: &document, buffers: &buffers, limits: &options.limits };
    let materials = Materials::new(&document, &buffers, options);
    let mut loader = Loader { reader, materials, options, scene: SceneBuilder::new(), report };
    loader.load()?;
    Ok(Loaded { scene: loader.scene, report: loader.report })
}

fn check_version(document: &Document) -> Result<(), Error> {
    let asset = document.asset.as_ref();
    let version = asset.and_then(|a| a.version.as_deref());
    let version = version.ok_or_else(|| buffers::undefined("asset.version"))?;
    let needed = asset.and_then(|a| a.min_version.as_deref()).unwrap_or(version);
    if version.starts_with("2.") && (needed == version || needed == "2.0") {
        return Ok(());
    }
    let message = format!("\"{}\"; expected \"2.0\"", crate::sanitized(needed));
    Err(Error::invalid("asset.version", "UNKNOWN_MAJOR_VERSION", message))
}

struct Loader<'a> {
    reader: Reader<'a>,
    materials: Materials<'a>,
    options: &'a LoadOptions,
    scene: SceneBuilder,
    report: LoadReport,
}

impl Loader<'_> {
    fn load(&mut self) -> Result<(), Error> {
        let document = self.reader.document;
        let placed = nodes::placed(document, &self.options.limits, &mut self.report)?;
        self.push_lights_and_cameras(&placed)?;
        // By mesh, so that each is decoded once and none is kept.
        let mut by_mesh: BTreeMap<u32, Vec<Placed>> = BTreeMap::new();
        for entry in placed {
            if let Some(mesh) = document.nodes[entry.node as usize].mesh {
                by_mesh.entry(mesh).or_default().push(entry);
            }
        }
        self.check_totals(&by_mesh)?;
        for (mesh, nodes) in by_mesh {
            let place = mesh_place(document, mesh);
            let primitives = &item(&document.meshes, mesh, "meshes")?.primitives;
            for (i, primitive) in primitives.iter().enumerate() {
                let place = format!("{place}, primitives[{i}]");
                self.push_primitive(primitive, &nodes, &place)?;
            }
        }
        if document.animations.is_some() {
            self.report.leave_out("animations; the scene is taken as it rests");
        }
        Ok(())
    }

    fn push_lights_and_cameras(&mut self, placed: &[Placed]) -> Result<(), Error> {
        let document = self.reader.document;
        let scale = self.options.length_scale;
        for entry in placed {
            let node = &document.nodes[entry.node as usize];
            let name = node.name.as_deref();
            let place = || nodes::place(document, entry.node);
            let world = scaled(&entry.world_from_node, scale);
            let light = node.extensions.as_deref().and_then(|e| e.light.as_ref());
            if let Some(light) = light {
                let index = light.light.ok_or_else(|| buffers::undefined("KHR_lights_punctual.light"))?;
                lights::push_light(document, index, name, &world, self.options, &mut self.scene, &mut self.report)
                    .map_err(|e| e.within(&place()))?;
            }
            if let Some(camera) = node.camera {
                lights::push_camera(document, camera, name, &world, &mut self.scene, &mut self.report)
                    .map_err(|e| e.within(&place()))?;
            }
            if node.skin.is_some() {
                self.report.leave_out("skins; meshes are taken in their bind pose");
            }
        }
        Ok(())
    }

    /// Counts instances and triangles before any of them is made.
    fn check_totals(&mut self, by_mesh: &BTreeMap<u32, Vec<Placed>>) -> Result<(), Error> {
        let document = self.reader.document;
        let limits = &self.options.limits;
        let (mut instances, mut triangles, mut bytes) = (0u64, 0u64, 0u64);
        for (&mesh, nodes) in by_mesh {
            let place = mesh_place(document, mesh);
            let mut per_instance = 0u64;
            let primitives = &item(&document.meshes, mesh, "meshes")?.primitives;
            for (i, primitive) in primitives.iter().enumerate() {
                let n = self.reader.n_triangles(primitive);
                per_instance += n.map_err(|e| e.within(&format!("{place}, primitives[{i}]")))?;
            }
            for entry in nodes {
                let copies = copies(&self.reader, entry.node)?.map_or(1, |copies| copies.n as u64);
                instances = instances.saturating_add(copies);
                triangles = triangles.saturating_add(copies.saturating_mul(per_instance));
                let meshes = copies.saturating_mul(primitives.len() as u64);
                bytes = bytes.saturating_add(meshes.saturating_mul(BYTES_PER_INSTANCE));
            }
        }
        bytes = bytes.saturating_add(triangles.saturating_mul(BYTES_PER_TRIANGLE));
        for (code, what, value, limit) in [
            ("LIMIT_INSTANCES", "instances", instances, limits.instances),
            ("LIMIT_TRIANGLES", "triangles", triangles, limits.triangles),
            ("LIMIT_MEMORY", "bytes of geometry", bytes, limits.scene_bytes),
        ] {
            if value > limit {
                return Err(Error::limit("scene", code, what, value, limit));
            }
        }
        (self.report.instances, self.report.triangles) = (instances, triangles);
        Ok(())
    }

    fn push_primitive(&mut self, primitive: &Primitive, nodes: &[Placed], place: &str) -> Result<(), Error> {
        let Some(mode) = Mode::of(primitive).map_err(|e| e.within(place))? else {
            self.report.leave_out(format!("{place}: points or lines"));
            return Ok(());
        };
        let Some(position) = primitive.attributes.get("POSITION") else {
            self.report.leave_out(format!("{place}: has no positions"));
            return Ok(());
        };
        if primitive.extensions.as_deref().is_some_and(|e| e.draco.is_some()) {
            self.report.warn(format!("{place}: read without Draco compression"));
        }
        if primitive.targets.is_some() {
            self.report.leave_out("morph targets; meshes are taken as they rest");
        }
        let uv_set = self.materials.uv_set(primitive.material).map_err(|e| e.within(place))?;
        let triangles = self.reader.read(primitive, mode, position, uv_set, &mut self.report);
        let triangles = triangles.map_err(|e| e.within(place))?;
        let has_uvs = !triangles.uvs.is_empty() || uv_set.is_none();
        let material = self.materials.get(primitive.material, has_uvs, &mut self.scene, &mut self.report);
        let material = material.map_err(|e| e.within(place))?;
        let reader = self.reader;
        for entry in nodes {
            let copies = copies(&reader, entry.node)?;
            for copy in 0..copies.as_ref().map_or(1, |c| c.n) {
                let local = copies.as_ref().map_or(Ok(DAffine3::IDENTITY), |c| c.transform(copy));
                let world = entry.world_from_node * local.map_err(|e| e.within(place))?;
                let world = scaled(&world, self.options.length_scale);
                self.push_instance(&triangles, &world, material, place)?;
            }
        }
        Ok(())
    }

    fn push_instance(
        &mut self,
        input: &Triangles,
        world: &DAffine3,
        material: hplt_geom::MaterialId,
        place: &str,
    ) -> Result<(), Error> {
        let m = world.matrix3;
        let determinant = m.determinant();
        if determinant == 0.0 {
            self.report.warn(format!("{place}: a transform flattens the mesh"));
        }
        let positions: Vec<DVec3> = input.positions.iter().map(|p| world.transform_point3(p.as_dvec3())).collect();
        // Cofactors turn normals like the inverse transpose does, and exist for every matrix.
        let sign = if determinant < 0.0 { -1.0 } else { 1.0 };
        let [x, y, z] = [m.y_axis.cross(m.z_axis), m.z_axis.cross(m.x_axis), m.x_axis.cross(m.y_axis)];
        let turn = |n: &Vec3| {
            let n = n.as_dvec3();
            let turned = (x * n.x + y * n.y + z * n.z) * sign;
            // What is no direction stays so, for the scene to count.
            turned.try_normalize().map_or(n.as_vec3() * 0.0, |t| (t * n.length()).as_vec3())
        };
        let normals: Vec<Vec3> = input.normals.iter().map(turn).collect();
        let mirrored: Vec<[u32; 3]>;
        let triangles = if determinant < 0.0 {
            mirrored = input.triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
            &mirrored
        } else {
            &input.triangles
        };
        let mesh =
            MeshInput { name: place, positions: &positions, normals: &normals, uvs: &input.uvs, triangles, material };
        self.scene.push_mesh(mesh).map_err(Error::from)?;
        self.report.vertices += positions.len() as u64;
        self.report.note_rounding(&input.positions, largest_scale(world));
        self.report.winding_disagreements += input.winding_disagreements;
        Ok(())
    }
}

/// How much longer a transform makes a step along an axis, at most.
fn largest_scale(transform: &DAffine3) -> f64 {
    let m = transform.matrix3;
    [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max)
}

/// The copies that a node makes of its mesh (`EXT_mesh_gpu_instancing`), if it does.
fn copies<'a>(reader: &'a Reader<'_>, node: u32) -> Result<Option<Copies<'a>>, Error> {
    let extensions = reader.document.nodes[node as usize].extensions.as_deref();
    let Some(instancing) = extensions.and_then(|e| e.instancing.as_ref()) else { return Ok(None) };
    Copies::open(reader, instancing)
        .map(Some)
        .map_err(|e| e.within(&format!("{}, EXT_mesh_gpu_instancing", nodes::place(reader.document, node))))
}

/// Transforms of the copies of a mesh.
struct Copies<'a> {
    n: usize,
    translation: Option<Accessor<'a>>,
    rotation: Option<Accessor<'a>>,
    scale: Option<Accessor<'a>>,
}

impl<'a> Copies<'a> {
    fn open(reader: &'a Reader<'_>, instancing: &Instancing) -> Result<Self, Error> {
        let open = |name: &str, dimensions: usize| -> Result<Option<Accessor<'a>>, Error> {
            let Some(index) = instancing.attributes.get(name) else { return Ok(None) };
            let accessor = Accessor::open(reader.document, reader.buffers, index, reader.limits);
            let accessor = accessor.map_err(|e| e.within(name))?;
            let is_fraction = name == "ROTATION" && accessor.normalized;
            if accessor.dimensions != dimensions || !(accessor.component == accessor::Component::F32 || is_fraction) {
                let message = format!("accessors[{index}] is of the wrong type");
                return Err(Error::invalid(name, "MESH_PRIMITIVE_ATTRIBUTES_ACCESSOR_INVALID_FORMAT", message));
            }
            Ok(Some(accessor))
        };
        let (translation, rotation, scale) = (open("TRANSLATION", 3)?, open("ROTATION", 4)?, open("SCALE", 3)?);
        let counts: Vec<usize> = [&translation, &rotation, &scale].into_iter().flatten().map(Accessor::count).collect();
        let n = counts.first().copied().ok_or_else(|| buffers::undefined("TRANSLATION, ROTATION or SCALE"))?;
        if let Some(other) = counts.iter().find(|&&c| c != n) {
            let message = format!("{n} and {other} elements; expected as many of each");
            return Err(Error::invalid("attributes", "MESH_PRIMITIVE_UNEQUAL_ACCESSOR_COUNT", message));
        }
        Ok(Self { n, translation, rotation, scale })
    }

    fn transform(&self, i: usize) -> Result<DAffine3, Error> {
        let vec3 = |a: &Option<Accessor<'_>>, default| {
            a.as_ref().map_or(default, |a| Vec3::from(a.element::<3>(i)).as_dvec3())
        };
        let rotation = match &self.rotation {
            Some(a) => nodes::unit_quaternion(a.element::<4>(i).map(f64::from))?,
            None => DQuat::IDENTITY,
        };
        let (scale, translation) = (vec3(&self.scale, DVec3::ONE), vec3(&self.translation, DVec3::ZERO));
        Ok(DAffine3::from_scale_rotation_translation(scale, rotation, translation))
    }
}

fn scaled(world: &DAffine3, scale: f64) -> DAffine3 {
    if scale == 1.0 { *world } else { DAffine3::from_scale(DVec3::splat(scale)) * *world }
}

fn mesh_place(document: &Document, mesh: u32) -> String {
    match document.meshes.get(mesh as usize).and_then(|m| m.name.as_deref()) {
        Some(name) => format!("meshes[{mesh}] \"{}\"", crate::sanitized(name)),
        None => format!("meshes[{mesh}]"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use hplt_geom::BuildPolicy;

    const GOOD: &[u8] = include_bytes!("../tests/corpus/good.glb");

    fn load_and_build(bytes: &[u8]) -> Result<(), Error> {
        let options = LoadOptions::default();
        let folder = Folder::of(&std::env::temp_dir(), 1000)?;
        let loaded = crate::load::guarded(|| load_bytes(bytes, folder, &options))?;
        loaded.scene.build(BuildPolicy::default())?;
        Ok(())
    }

    #[test]
    fn truncation_anywhere_is_an_error() {
        load_and_build(GOOD).unwrap();
        let text = container::split(GOOD).unwrap().0;
        for bytes in [GOOD, text] {
            for n in 0..bytes.len() - 1 {
                let error = load_and_build(&bytes[..n]).unwrap_err();
                assert_ne!(error.code(), "INTERNAL", "cut at {n}: {error}");
            }
        }
    }

    #[test]
    fn flipped_bits_never_panic() {
        let mut refused = 0;
        for bit in 0..GOOD.len() * 8 {
            let mut damaged = GOOD.to_vec();
            damaged[bit / 8] ^= 1 << (bit % 8);
            if let Err(error) = load_and_build(&damaged) {
                assert_ne!(error.code(), "INTERNAL", "bit {bit}: {error}");
                refused += 1;
            }
        }
        assert!(refused > GOOD.len() && refused < GOOD.len() * 8, "{refused}");
    }

    /// Pairs of random bytes, so that lengths, counts and offsets get large values too.
    #[test]
    fn random_damage_never_panics() {
        let mut state = 7u64;
        let mut next = move || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let digits = b"0123456789-.e[]{},:\"";
        for _ in 0..20_000 {
            let mut damaged = GOOD.to_vec();
            for _ in 0..1 + next() % 4 {
                let at = next() % damaged.len();
                damaged[at] = if next() % 2 == 0 { digits[next() % digits.len()] } else { next() as u8 };
            }
            if let Err(error) = load_and_build(&damaged) {
                assert_ne!(error.code(), "INTERNAL", "{error}: {:?}", String::from_utf8_lossy(&damaged));
            }
        }
    }
}
