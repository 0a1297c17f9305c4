//! Wavefront OBJ and its material libraries. The `tobj` crate forms triangles out of lines that are checked first; the
//! libraries are read by our own parser. Polygons become fans, which is wrong for concave ones.

mod lines;
mod mtl;

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap};
use std::io::BufReader;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3};
use hplt_geom::radiometry::exitance_from_radiance;
use hplt_geom::{Material, MaterialId, MeshInput, Rgb, SceneBuilder, Sides, TextureSlot, UvTransform, Wrap};

use self::lines::{CheckedLines, State};
use self::mtl::Entry;
use crate::files::open_regular;
use crate::folder::Folder;
use crate::texture::{Decoded, TextureBudget, decode};
use crate::winding::winding_disagreements;
use crate::{Error, LoadOptions, LoadReport, Loaded, policy};

/// Albedo of triangles whose material is missing or says nothing.
const DEFAULT_ALBEDO: f32 = 0.5;

/// The scene in an OBJ file.
pub(crate) fn load(path: &Path, options: &LoadOptions) -> Result<Loaded, Error> {
    let (file, length) = open_regular(path, options.limits.file_bytes)?;
    if length == 0 {
        return Err(Error::invalid("", "EMPTY_FILE", "has 0 bytes"));
    }
    let folder = Folder::of(path, options.limits.total_bytes)?;
    let libraries = RefCell::new(Libraries { folder, options, n_read: 0, entries: Vec::new(), error: None });
    let report = RefCell::new(LoadReport::default());
    let state = RefCell::new(State::default());
    let mut lines = CheckedLines::new(BufReader::new(file), options, &state);
    let parse = tobj::LoadOptions { single_index: true, triangulate: true, ignore_points: true, ignore_lines: true };
    let parsed = tobj::load_obj_buf(&mut lines, &parse, |name| {
        libraries.borrow_mut().read(&name.to_string_lossy(), &mut report.borrow_mut())
    });
    drop(lines);
    let (mut state, libraries, mut report) = (state.into_inner(), libraries.into_inner(), report.into_inner());
    if let Some(error) = state.error.take().or(libraries.error) {
        return Err(error);
    }
    // Before the parser's own complaint, which does not know the line.
    state.check_indices()?;
    let (models, _) = match parsed {
        Ok(parsed) => parsed,
        Err(error) => {
            return Err(Error::invalid(format!("line {}", state.number), "OBJ_SYNTAX", error.to_string()));
        }
    };
    if state.n_lines_and_points > 0 {
        report.leave_out(format!("{} lines and points", state.n_lines_and_points));
    }
    if state.n_polygons > 0 {
        report.warn(format!("{} polygons of five corners or more are split as fans, as if convex", state.n_polygons));
    }
    let materials = Materials {
        entries: libraries.entries,
        folder: libraries.folder,
        options,
        known: BTreeMap::new(),
        images: BTreeMap::new(),
        budget: TextureBudget::default(),
    };
    let mut scene = SceneBuilder::new();
    push_models(models, materials, options, &mut scene, &mut report)?;
    Ok(Loaded { scene, report })
}

/// The material libraries that a file names.
struct Libraries<'a> {
    folder: Folder,
    options: &'a LoadOptions,
    n_read: u64,
    /// In the order in which the parser numbers materials.
    entries: Vec<Entry>,
    error: Option<Error>,
}

impl Libraries<'_> {
    /// What the parser needs to know of a library: the names of its materials.
    fn read(&mut self, name: &str, report: &mut LoadReport) -> tobj::MTLLoadResult {
        if self.error.is_some() {
            return Err(tobj::LoadError::OpenFileFailed);
        }
        let first = self.entries.len();
        if let Err(error) = self.read_line(name, report) {
            self.error = Some(error);
            return Err(tobj::LoadError::OpenFileFailed);
        }
        let new = &self.entries[first..];
        let named = |e: &Entry| tobj::Material { name: e.name.clone(), ..tobj::Material::default() };
        let materials = new.iter().map(named).collect();
        let by_name: HashMap<String, usize> = new.iter().enumerate().map(|(i, e)| (e.name.clone(), i)).collect();
        Ok((materials, by_name.into_iter().collect()))
    }

    /// A name may hold spaces, or a line several names.
    fn read_line(&mut self, line: &str, report: &mut LoadReport) -> Result<(), Error> {
        if self.read_library(line, report)? {
            return Ok(());
        }
        for name in line.split_whitespace() {
            if name == line || !self.read_library(name, report)? {
                report.warn(format!("material library \"{name}\" is missing"));
            }
        }
        Ok(())
    }

    /// Whether there is such a file.
    fn read_library(&mut self, name: &str, report: &mut LoadReport) -> Result<bool, Error> {
        let limits = &self.options.limits;
        self.n_read += 1;
        if self.n_read > limits.material_libraries {
            let (value, limit) = (self.n_read, limits.material_libraries);
            return Err(Error::limit("mtllib", "LIMIT_LIBRARIES", "material libraries", value, limit));
        }
        let bytes = match self.folder.read_name(name, limits.file_bytes) {
            Ok(bytes) => bytes,
            Err(error) if error.code() == "FILE_UNREADABLE" => return Ok(false),
            // A line of many names is too long to be one.
            Err(error) if error.code() == "INVALID_URI" && name.contains(' ') => return Ok(false),
            Err(error) => return Err(error.within("mtllib")),
        };
        let entries = mtl::parse(&bytes, limits, report);
        self.entries.extend(entries.map_err(|e| e.within(&format!("mtllib \"{}\"", crate::sanitized(name))))?);
        Ok(true)
    }
}

struct Materials<'a> {
    entries: Vec<Entry>,
    folder: Folder,
    options: &'a LoadOptions,
    /// By material and whether the mesh has texture coordinates.
    known: BTreeMap<(Option<usize>, bool), MaterialId>,
    images: BTreeMap<String, Decoded>,
    budget: TextureBudget,
}

impl Materials<'_> {
    fn get(
        &mut self,
        index: Option<usize>,
        has_uvs: bool,
        scene: &mut SceneBuilder,
        report: &mut LoadReport,
    ) -> Result<MaterialId, Error> {
        if let Some(&id) = self.known.get(&(index, has_uvs)) {
            return Ok(id);
        }
        let material = match index.and_then(|i| self.entries.get(i).cloned()) {
            Some(entry) => self.read(&entry, has_uvs, report)?,
            None => {
                report.warn(format!("triangles whose material is missing are grey, albedo {DEFAULT_ALBEDO}"));
                Material::diffuse("(no material)", Rgb::splat(DEFAULT_ALBEDO))
            }
        };
        let id = scene.push_material(material);
        self.known.insert((index, has_uvs), id);
        report.materials = self.known.len() as u64;
        (report.textures, report.texture_bytes) = (self.budget.n_images, self.budget.bytes);
        Ok(id)
    }

    fn read(&mut self, entry: &Entry, has_uvs: bool, report: &mut LoadReport) -> Result<Material, Error> {
        let name = crate::sanitized(&entry.name);
        let place = format!("material \"{name}\"");
        let mut material = Material::diffuse(name, Rgb::splat(DEFAULT_ALBEDO));
        match (entry.diffuse, &entry.diffuse_map) {
            (Some(diffuse), _) => material.albedo = Rgb::from(diffuse),
            (None, Some(_)) => material.albedo = Rgb::ONE,
            (None, None) => report.warn(format!("{place}: has no Kd; grey, albedo {DEFAULT_ALBEDO}")),
        }
        let without = if entry.emission_map.is_some() { [1.0; 3] } else { [0.0; 3] };
        material.exitance = exitance_from_radiance(Rgb::from(entry.emission.unwrap_or(without)));
        if self.options.one_sided {
            material.reflects = Sides::Front;
        }
        let mut brightest = Rgb::ONE;
        if let Some(map) = &entry.diffuse_map {
            let image = self.image(map).map_err(|e| e.within(&format!("{place}, map_Kd")))?;
            if has_uvs {
                brightest = image.brightest;
                material.albedo_texture = Some(slot(image));
            } else {
                material.albedo *= image.mean;
                report.warn(format!("{place}: a mesh has no texture coordinates; the mean of the texture is used"));
            }
        }
        if let Some(map) = entry.emission_map.as_ref().filter(|_| material.is_emissive()) {
            let image = self.image(map).map_err(|e| e.within(&format!("{place}, map_Ke")))?;
            if has_uvs {
                material.exitance_texture = Some(slot(image));
            } else {
                material.exitance *= image.mean;
            }
        }
        policy::apply(&mut material, brightest, self.options, report);
        Ok(material)
    }

    fn image(&mut self, name: &str) -> Result<&Decoded, Error> {
        if !self.images.contains_key(name) {
            let limits = &self.options.limits;
            let bytes = self.folder.read_name(name, limits.file_bytes)?;
            let image = decode(&bytes, limits, &mut self.budget)
                .map_err(|e| e.within(&format!("\"{}\"", crate::sanitized(name))))?;
            self.images.insert(name.to_owned(), image);
        }
        Ok(&self.images[name])
    }
}

fn slot(image: &Decoded) -> TextureSlot {
    TextureSlot { texture: image.texture.clone(), transform: UvTransform::default(), wrap: [Wrap::Repeat; 2] }
}

fn push_models(
    models: Vec<tobj::Model>,
    mut materials: Materials<'_>,
    options: &LoadOptions,
    scene: &mut SceneBuilder,
    report: &mut LoadReport,
) -> Result<(), Error> {
    for tobj::Model { mesh, name } in models {
        let vec3 = |a: &[f32]| a.as_chunks::<3>().0.iter().map(|&v| Vec3::from(v)).collect::<Vec<_>>();
        let vertices = vec3(&mesh.positions);
        // The parser drops normals or texture coordinates of a mesh that has them on some corners only.
        let per_vertex = |n: usize| n == vertices.len();
        let normals = Some(vec3(&mesh.normals)).filter(|n| per_vertex(n.len())).unwrap_or_default();
        // The origin of OBJ textures is at the bottom.
        let uvs: Vec<Vec2> = mesh.texcoords.as_chunks::<2>().0.iter().map(|&[u, v]| Vec2::new(u, 1.0 - v)).collect();
        let uvs = Some(uvs).filter(|uvs| per_vertex(uvs.len())).unwrap_or_default();
        let triangles = mesh.indices.as_chunks::<3>().0;
        let material = materials.get(mesh.material_id, !uvs.is_empty(), scene, report)?;
        let positions: Vec<DVec3> = vertices.iter().map(|v| v.as_dvec3() * options.length_scale).collect();
        let place = crate::sanitized(&name);
        let input =
            MeshInput { name: &place, positions: &positions, normals: &normals, uvs: &uvs, triangles, material };
        scene.push_mesh(input).map_err(Error::from)?;
        report.nodes += 1;
        report.instances += 1;
        report.triangles += triangles.len() as u64;
        report.vertices += vertices.len() as u64;
        report.note_rounding(&vertices, options.length_scale);
        report.winding_disagreements += winding_disagreements(&vertices, &normals, triangles);
    }
    Ok(())
}
