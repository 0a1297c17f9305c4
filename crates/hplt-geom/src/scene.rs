use glam::{DVec3, Vec2, Vec3};

use crate::mesh::doubled_area_vector;
use crate::{
    Camera, Environment, Error, Frame, Hit, Light, LightShape, Material, MaterialId, Mesh, Ray, Rgb, TriangleId,
    offset_origin,
};

/// Coordinates beyond this are refused, m.
const MAX_COORDINATE: f64 = 1e18;
/// Triangles beyond this are refused.
const MAX_TRIANGLES: u64 = 200_000_000;

/// Everything that light transport needs to know: finite, in range, in scene space. Made by [`SceneBuilder`].
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    frame: Frame,
    mesh: Mesh,
    pub(crate) materials: Vec<Material>,
    pub(crate) lights: Vec<Light>,
    pub(crate) environment: Option<Environment>,
    cameras: Vec<Camera>,
}

/// A point on one side of a surface, as a ray finds it. Scene space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfacePoint {
    /// Position, from barycentric coordinates.
    pub position: Vec3,
    /// Unit geometric normal on the side that the ray arrives at.
    pub normal: Vec3,
    /// Unit shading normal on the same side; for display only.
    pub shading_normal: Vec3,
    /// The triangle.
    pub triangle: TriangleId,
    /// Whether the side is the front.
    pub is_front: bool,
    /// Texture coordinate; zero when none is kept.
    pub uv: Vec2,
}

impl Scene {
    /// The map between world and scene space.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The triangles.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The materials, by [`MaterialId`].
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// The material of a triangle.
    #[inline]
    pub fn material(&self, triangle: TriangleId) -> &Material {
        &self.materials[self.mesh.material(triangle).0 as usize]
    }

    /// The lights without a surface.
    pub fn lights(&self) -> &[Light] {
        &self.lights
    }

    /// The environment, if there is one.
    pub fn environment(&self) -> Option<&Environment> {
        self.environment.as_ref()
    }

    /// The cameras of the scene file.
    pub fn cameras(&self) -> &[Camera] {
        &self.cameras
    }

    /// Whether anything emits light.
    pub fn is_lit(&self) -> bool {
        self.environment.is_some() || !self.lights.is_empty() || self.emissive_triangles().next().is_some()
    }

    /// The triangles whose material emits.
    pub fn emissive_triangles(&self) -> impl Iterator<Item = TriangleId> + '_ {
        let emissive: Vec<bool> = self.materials.iter().map(Material::is_emissive).collect();
        (0..self.mesh.n_triangles() as u32).map(TriangleId).filter(move |&t| emissive[self.mesh.material(t).0 as usize])
    }

    /// The largest albedo of any material, before textures.
    pub fn max_albedo(&self) -> f32 {
        self.materials.iter().map(|m| m.albedo.max_element()).fold(0.0, f32::max)
    }

    /// The length of the diagonal of the box around all triangles, scene units.
    pub fn diagonal(&self) -> f32 {
        self.mesh.bounds().map_or(0.0, |(min, max)| (max - min).length())
    }

    /// The surface where a ray arrived.
    ///
    /// # Panics
    /// On a miss.
    #[inline]
    pub fn surface_at(&self, hit: &Hit) -> SurfacePoint {
        let Hit { triangle, u, v, is_front, .. } = *hit;
        let side = if is_front { 1.0 } else { -1.0 };
        SurfacePoint {
            position: self.mesh.position_at(triangle, u, v),
            normal: self.mesh.face_normal(triangle) * side,
            shading_normal: self.mesh.shading_normal_at(triangle, u, v) * side,
            triangle,
            is_front,
            uv: self.mesh.uv_at(triangle, u, v),
        }
    }

    /// The albedo of the side that a surface point is on.
    #[inline]
    pub fn albedo(&self, point: &SurfacePoint) -> Rgb {
        self.material(point.triangle).albedo_at(point.is_front, point.uv)
    }

    /// Replaces `out` by the [albedo](Self::albedo) of every point: faster than one by one, since textures are far away in memory.
    pub fn albedos(&self, points: &[SurfacePoint], out: &mut Vec<Rgb>) {
        /// Points whose texels are fetched together.
        const TOGETHER: usize = 64;
        out.clear();
        for points in points.chunks(TOGETHER) {
            let mut taps = [None; TOGETHER];
            for (tap, point) in taps.iter_mut().zip(points) {
                let slot = self.material(point.triangle).albedo_texture.as_ref();
                *tap = slot.map(|slot| slot.tap(point.uv));
            }
            out.extend(points.iter().zip(&taps).map(|(point, tap)| {
                let plain = self.material(point.triangle).plain_albedo(point.is_front);
                tap.map_or(plain, |tap| plain * tap.mix().truncate())
            }));
        }
    }

    /// The exitance of the side that a surface point is on.
    #[inline]
    pub fn exitance(&self, point: &SurfacePoint) -> Rgb {
        self.material(point.triangle).exitance_at(point.is_front, point.uv)
    }

    /// Bytes that textures take, each counted once per use.
    pub fn texture_memory(&self) -> usize {
        let slots = |m: &Material| {
            let alpha = m.alpha.as_ref().and_then(|mask| mask.texture.as_ref());
            [m.albedo_texture.as_ref(), m.exitance_texture.as_ref(), alpha]
                .into_iter()
                .flatten()
                .map(|slot| slot.texture.memory())
                .sum::<usize>()
        };
        self.materials.iter().map(slots).sum()
    }
}

impl SurfacePoint {
    /// A ray that leaves this side along `direction`.
    pub fn ray(&self, direction: Vec3) -> Ray {
        Ray::new(offset_origin(self.position, self.normal), direction)
    }
}

/// One mesh as it comes from a file, in world space.
#[derive(Debug, Clone, Copy)]
pub struct MeshInput<'a> {
    /// Name for error messages.
    pub name: &'a str,
    /// Vertex positions.
    pub positions: &'a [DVec3],
    /// Shading normals per vertex, or empty.
    pub normals: &'a [Vec3],
    /// Texture coordinates per vertex, or empty.
    pub uvs: &'a [Vec2],
    /// Corner indices, counter-clockwise seen from the front.
    pub triangles: &'a [[u32; 3]],
    /// The material of all of them.
    pub material: MaterialId,
}

/// What [`SceneBuilder::build`] does about bad input that it can repair.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct BuildPolicy {
    /// Drop triangles with a vertex that is not finite or beyond 1e18, instead of failing.
    pub drop_bad_triangles: bool,
    /// Clamp albedos into `[0, 1]` and exitances to 0 or more (NaN to 0), instead of failing.
    pub clamp_materials: bool,
}

/// What was dropped, merged or repaired on the way into a [`Scene`].
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SceneReport {
    /// Triangles with no area.
    pub degenerate: u64,
    /// Triangles with a vertex that is not finite or out of range.
    pub non_finite: u64,
    /// Triangles that repeat an earlier one exactly.
    pub duplicates: u64,
    /// Among `duplicates`, those whose material differs; the first one in the file is kept.
    pub duplicates_of_other_material: u64,
    /// Vertex normals that are zero, not finite or not of unit length.
    pub repaired_normals: u64,
    /// Names of the materials that were clamped.
    pub clamped_materials: Vec<String>,
}

/// Collects world-space input and turns it into a [`Scene`].
#[derive(Debug, Clone, Default)]
pub struct SceneBuilder {
    positions: Vec<DVec3>,
    normals: Vec<Vec3>,
    uvs: Vec<Vec2>,
    triangles: Vec<[u32; 3]>,
    triangle_materials: Vec<MaterialId>,
    materials: Vec<Material>,
    lights: Vec<WorldLight>,
    environment: Option<Environment>,
    cameras: Vec<Camera>,
    /// First vertex and name of every mesh, for error messages.
    meshes: Vec<(usize, String)>,
}

#[derive(Debug, Clone)]
struct WorldLight {
    light: Light,
    position: DVec3,
}

impl SceneBuilder {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a material.
    pub fn push_material(&mut self, material: Material) -> MaterialId {
        self.materials.push(material);
        MaterialId(self.materials.len() as u32 - 1)
    }

    /// The materials so far, to change.
    pub fn materials_mut(&mut self) -> &mut [Material] {
        &mut self.materials
    }

    /// Adds a mesh.
    ///
    /// # Errors
    /// When array lengths disagree, an index or the material is out of range, or there are too many vertices or
    /// triangles.
    pub fn push_mesh(&mut self, mesh: MeshInput<'_>) -> Result<(), Error> {
        let place = |what: &str| format!("mesh \"{}\", {what}", mesh.name);
        let n = mesh.positions.len();
        for (what, found) in [("normals", mesh.normals.len()), ("texture coordinates", mesh.uvs.len())] {
            if found != 0 && found != n {
                return Err(Error::LengthMismatch { place: place(what), found: found as u64, expected: n as u64 });
            }
        }
        if mesh.material.0 as usize >= self.materials.len() {
            return Err(Error::IndexOutOfRange {
                place: place("material"),
                index: mesh.material.0.into(),
                count: self.materials.len() as u64,
            });
        }
        let first = self.positions.len();
        let n_vertices = (first + n) as u64;
        if n_vertices >= u64::from(u32::MAX) {
            return Err(Error::Limit { place: place("vertices"), value: n_vertices, limit: u32::MAX.into() });
        }
        let n_triangles = (self.triangles.len() + mesh.triangles.len()) as u64;
        if n_triangles > MAX_TRIANGLES {
            return Err(Error::Limit { place: place("triangles"), value: n_triangles, limit: MAX_TRIANGLES });
        }
        for (i, triangle) in mesh.triangles.iter().enumerate() {
            if let Some(&index) = triangle.iter().find(|&&v| v as usize >= n) {
                return Err(Error::IndexOutOfRange {
                    place: place(&format!("triangle {i}")),
                    index: index.into(),
                    count: n as u64,
                });
            }
        }
        self.meshes.push((first, mesh.name.to_owned()));
        self.positions.extend_from_slice(mesh.positions);
        extend_or_pad(&mut self.normals, first, mesh.normals, n, Vec3::ZERO);
        extend_or_pad(&mut self.uvs, first, mesh.uvs, n, Vec2::ZERO);
        self.triangles.extend(mesh.triangles.iter().map(|t| t.map(|v| v + first as u32)));
        self.triangle_materials.resize(self.triangles.len(), mesh.material);
        Ok(())
    }

    /// Adds a point light: `intensity` in W/sr.
    pub fn push_point_light(&mut self, name: impl Into<String>, position: DVec3, intensity: Rgb) {
        let shape = LightShape::Point { position: Vec3::ZERO, intensity };
        self.lights.push(WorldLight { light: Light { name: name.into(), shape }, position });
    }

    /// Adds a spot light: `intensity` in W/sr on the axis, fading between the half-angles `inner` and `outer` (radians).
    pub fn push_spot_light(
        &mut self,
        name: impl Into<String>,
        position: DVec3,
        direction: Vec3,
        intensity: Rgb,
        inner: f32,
        outer: f32,
    ) {
        let shape = LightShape::Spot {
            position: Vec3::ZERO,
            direction: direction.normalize_or_zero(),
            intensity,
            cos_inner: inner.cos(),
            cos_outer: outer.cos(),
        };
        self.lights.push(WorldLight { light: Light { name: name.into(), shape }, position });
    }

    /// Adds a distant light: `irradiance` in W/m² on a surface that faces it, from a cone of half-angle
    /// `angular_radius` (radians, 0 for a parallel light).
    pub fn push_directional_light(
        &mut self,
        name: impl Into<String>,
        direction_to_light: Vec3,
        irradiance: Rgb,
        angular_radius: f32,
    ) {
        let direction_to_light = direction_to_light.normalize_or_zero();
        let shape = LightShape::Directional { direction_to_light, irradiance, angular_radius };
        self.lights.push(WorldLight { light: Light { name: name.into(), shape }, position: DVec3::ZERO });
    }

    /// Sets the environment.
    pub fn set_environment(&mut self, environment: Environment) {
        self.environment = Some(environment);
    }

    /// Adds a camera.
    pub fn push_camera(&mut self, camera: Camera) {
        self.cameras.push(camera);
    }

    /// The number of triangles so far.
    pub fn n_triangles(&self) -> usize {
        self.triangles.len()
    }

    /// The smallest box around all vertices so far that are finite, world space.
    pub fn bounds(&self) -> Option<(DVec3, DVec3)> {
        let mut finite = self.positions.iter().copied().filter(|p| is_usable(*p));
        let first = finite.next()?;
        Some(finite.fold((first, first), |(min, max), p| (min.min(p), max.max(p))))
    }

    /// Validates everything and maps it into scene space.
    ///
    /// # Errors
    /// On the first value that is not finite or out of range (unless `policy` repairs it), and when no triangle with an
    /// area is left.
    pub fn build(mut self, policy: BuildPolicy) -> Result<(Scene, SceneReport), Error> {
        let mut report = SceneReport::default();
        self.check_materials(policy, &mut report)?;
        self.check_lights()?;
        self.drop_unusable(policy, &mut report)?;
        let uvs_needed = self.check_uvs()?;
        let (min, max) = self.bounds_of_triangles().ok_or(Error::NoSurface)?;
        let frame = Frame::from_bounds(min, max);
        let positions: Vec<Vec3> = self.positions.iter().map(|&p| frame.scene_from_world_point(p)).collect();
        repair_normals(&mut self.normals, &mut report);
        let kept = distinct_triangles(&self, &positions, &mut report);
        if kept.is_empty() {
            return Err(Error::NoSurface);
        }
        let face_normals = kept
            .iter()
            .map(|&t| {
                let [a, b, c] = self.triangles[t].map(|v| positions[v as usize]);
                doubled_area_vector(a, b, c).normalize().as_vec3()
            })
            .collect();
        let mesh = Mesh {
            triangles: kept.iter().map(|&t| self.triangles[t]).collect(),
            materials: kept.iter().map(|&t| self.triangle_materials[t]).collect(),
            face_normals,
            positions,
            uvs: if uvs_needed { self.uvs } else { Vec::new() },
            shading_normals: self.normals,
        };
        let lights = self.lights.into_iter().map(|light| light.into_scene(&frame)).collect();
        let scene = Scene {
            frame,
            mesh,
            materials: self.materials,
            lights,
            environment: self.environment,
            cameras: self.cameras,
        };
        Ok((scene, report))
    }

    fn check_materials(&mut self, policy: BuildPolicy, report: &mut SceneReport) -> Result<(), Error> {
        for material in &mut self.materials {
            let mut clamped = false;
            for (channel, name) in ["red", "green", "blue"].iter().enumerate() {
                let albedo = material.albedo[channel];
                if !(0.0..=1.0).contains(&albedo) {
                    if !policy.clamp_materials {
                        let place = format!("material \"{}\", albedo, {name}", material.name);
                        return Err(number_error(place, albedo.into(), "an albedo in [0, 1]"));
                    }
                    // NaN fails both comparisons and becomes 0.
                    material.albedo[channel] = if albedo > 1.0 { 1.0 } else { 0.0 };
                    clamped = true;
                }
                let exitance = material.exitance[channel];
                if !(exitance >= 0.0 && exitance.is_finite()) {
                    if !policy.clamp_materials {
                        let place = format!("material \"{}\", emission, {name}", material.name);
                        return Err(number_error(place, exitance.into(), "a finite emission of 0 or more"));
                    }
                    material.exitance[channel] = 0.0;
                    clamped = true;
                }
            }
            if clamped {
                report.clamped_materials.push(material.name.clone());
            }
        }
        Ok(())
    }

    fn check_lights(&self) -> Result<(), Error> {
        for (i, WorldLight { light, position }) in self.lights.iter().enumerate() {
            let place = |what: &str| format!("light {i} \"{}\", {what}", light.name);
            if !is_usable(*position) {
                return Err(number_error(place("position"), position.x + position.y + position.z, "|x| <= 1e18"));
            }
            let (power, direction, angles) = match light.shape {
                LightShape::Point { intensity, .. } => (intensity, Vec3::Y, [0.0, 0.0]),
                LightShape::Spot { intensity, direction, cos_inner, cos_outer, .. } => {
                    if cos_outer > cos_inner {
                        let expected = "an inner angle that is not above the outer one";
                        return Err(number_error(place("cone angles"), cos_inner.into(), expected));
                    }
                    (intensity, direction, [cos_inner, cos_outer])
                }
                LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
                    if !(0.0..=1.5).contains(&angular_radius) {
                        let expected = "an angular radius in [0, 1.5] radians";
                        return Err(number_error(place("angular radius"), angular_radius.into(), expected));
                    }
                    (irradiance, direction_to_light, [0.0, 0.0])
                }
            };
            for value in power.to_array() {
                if !(value >= 0.0 && value.is_finite()) {
                    return Err(number_error(place("intensity"), value.into(), "a finite intensity of 0 or more"));
                }
            }
            if !(direction.is_finite() && direction != Vec3::ZERO) {
                return Err(number_error(place("direction"), direction.length().into(), "a direction of length 1"));
            }
            if let Some(angle) = angles.iter().find(|a| !a.is_finite()) {
                return Err(number_error(place("cone angles"), (*angle).into(), "finite angles"));
            }
        }
        Ok(())
    }

    /// Drops triangles with unusable vertices, or fails at the first.
    fn drop_unusable(&mut self, policy: BuildPolicy, report: &mut SceneReport) -> Result<(), Error> {
        let usable: Vec<bool> = self.positions.iter().map(|&p| is_usable(p)).collect();
        if usable.iter().all(|&u| u) {
            return Ok(());
        }
        if !policy.drop_bad_triangles
            && let Some(&bad) = self.triangles.iter().flatten().find(|&&v| !usable[v as usize])
        {
            let position = self.positions[bad as usize];
            let axis = (0..3).find(|&i| !is_usable(DVec3::splat(position[i]))).unwrap_or(0);
            let place = format!("{}, position.{}", self.vertex_place(bad as usize), ["x", "y", "z"][axis]);
            return Err(number_error(place, position[axis], "a coordinate within ±1e18"));
        }
        let keep: Vec<bool> = self.triangles.iter().map(|t| t.iter().all(|&v| usable[v as usize])).collect();
        report.non_finite = keep.iter().filter(|&&k| !k).count() as u64;
        let mut flags = keep.iter();
        self.triangles.retain(|_| *flags.next().unwrap_or(&false));
        let mut flags = keep.iter();
        self.triangle_materials.retain(|_| *flags.next().unwrap_or(&false));
        for (position, usable) in self.positions.iter_mut().zip(usable) {
            if !usable {
                *position = DVec3::ZERO;
            }
        }
        Ok(())
    }

    /// Whether any triangle needs texture coordinates; they must then be finite.
    fn check_uvs(&self) -> Result<bool, Error> {
        let needs: Vec<bool> = self.materials.iter().map(Material::needs_uvs).collect();
        let mut any = false;
        for (triangle, material) in self.triangles.iter().zip(&self.triangle_materials) {
            if !needs[material.0 as usize] || self.uvs.is_empty() {
                continue;
            }
            any = true;
            for &v in triangle {
                let uv = self.uvs[v as usize];
                if !uv.is_finite() {
                    let place = format!("{}, texture coordinate", self.vertex_place(v as usize));
                    return Err(Error::NotFinite { place, value: (uv.x + uv.y).into() });
                }
            }
        }
        Ok(any)
    }

    fn bounds_of_triangles(&self) -> Option<(DVec3, DVec3)> {
        let mut corners = self.triangles.iter().flatten().map(|&v| self.positions[v as usize]);
        let first = corners.next()?;
        Some(corners.fold((first, first), |(min, max), p| (min.min(p), max.max(p))))
    }

    fn vertex_place(&self, vertex: usize) -> String {
        let mesh = self.meshes.partition_point(|(first, _)| *first <= vertex).saturating_sub(1);
        self.meshes.get(mesh).map_or_else(
            || format!("vertex {vertex}"),
            |(first, name)| format!("mesh \"{name}\", vertex {}", vertex - first),
        )
    }
}

impl WorldLight {
    fn into_scene(mut self, frame: &Frame) -> Light {
        match &mut self.light.shape {
            LightShape::Point { position, intensity } | LightShape::Spot { position, intensity, .. } => {
                *position = frame.scene_from_world_point(self.position);
                *intensity = frame.scene_from_world_intensity(*intensity);
            }
            LightShape::Directional { .. } => {}
        }
        self.light
    }
}

fn is_usable(p: DVec3) -> bool {
    p.is_finite() && p.abs().max_element() <= MAX_COORDINATE
}

fn number_error(place: String, value: f64, expected: &'static str) -> Error {
    if value.is_finite() { Error::OutOfRange { place, value, expected } } else { Error::NotFinite { place, value } }
}

/// Appends `n` values, padding what came before or what is missing now; stays empty while nobody has values.
fn extend_or_pad<T: Copy>(all: &mut Vec<T>, first: usize, new: &[T], n: usize, pad: T) {
    if new.is_empty() && all.is_empty() {
        return;
    }
    all.resize(first, pad);
    all.extend_from_slice(new);
    all.resize(first + n, pad);
}

/// Makes vertex normals unit length; those that cannot be become zero, which means "none".
fn repair_normals(normals: &mut [Vec3], report: &mut SceneReport) {
    for normal in normals {
        if *normal == Vec3::ZERO {
            continue;
        }
        let length = normal.length();
        if (length - 1.0).abs() > 1e-2 || !length.is_finite() {
            report.repaired_normals += 1;
        }
        let unit = *normal / length;
        *normal = if unit.is_finite() && length > 0.0 { unit } else { Vec3::ZERO };
    }
}

/// Indices of the triangles that have an area and repeat no earlier one.
///
/// A repetition has the same corners in the same winding, or in the opposite winding when the earlier one already
/// stands for both sides: same material, reflecting on both sides, emitting on both or not at all.
///
/// Cost: a sort of hashes; independent of how many repetitions there are or how unlucky the hashes.
fn distinct_triangles(input: &SceneBuilder, positions: &[Vec3], report: &mut SceneReport) -> Vec<usize> {
    let corners = |t: u32| corner_bits(input.triangles[t as usize].map(|v| positions[v as usize]));
    let unordered = |t: u32| {
        let mut set = corners(t);
        set.sort_unstable();
        set
    };
    let mut keep = vec![true; input.triangles.len()];
    let mut by_hash: Vec<(u64, u32)> = Vec::with_capacity(input.triangles.len());
    for (t, triangle) in input.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| positions[v as usize]);
        let area = doubled_area_vector(a, b, c).length();
        if area.is_nan() || area <= 0.0 {
            report.degenerate += 1;
            keep[t] = false;
        } else {
            by_hash.push((hash(&unordered(t as u32)), t as u32));
        }
    }
    by_hash.sort_unstable();
    for same_hash in by_hash.chunk_by_mut(|x, y| x.0 == y.0).filter(|run| run.len() > 1) {
        same_hash.sort_unstable_by_key(|&(_, t)| (unordered(t), t));
        for same_corners in same_hash.chunk_by(|x, y| unordered(x.1) == unordered(y.1)) {
            // The first triangle of each winding that is kept, in the order of the file.
            let mut seen: [Option<u32>; 2] = [None; 2];
            for &(_, t) in same_corners {
                let winding = usize::from(rotated(corners(t)) != unordered(t));
                if repeats(input, t, seen[winding], seen[1 - winding], report) {
                    keep[t as usize] = false;
                } else {
                    seen[winding] = Some(t);
                }
            }
        }
    }
    (0..input.triangles.len()).filter(|&t| keep[t]).collect()
}

/// Whether triangle `t` repeats the one of the same or of the opposite winding, and counts it if so.
fn repeats(input: &SceneBuilder, t: u32, same: Option<u32>, opposite: Option<u32>, report: &mut SceneReport) -> bool {
    let material = |t: u32| input.triangle_materials[t as usize];
    if let Some(earlier) = same {
        report.duplicates += 1;
        report.duplicates_of_other_material += u64::from(material(earlier) != material(t));
        return true;
    }
    let m = &input.materials[material(t).0 as usize];
    let both_sides = m.reflects == crate::Sides::Both && (!m.is_emissive() || m.emits == crate::Sides::Both);
    let repeated = both_sides && opposite.is_some_and(|earlier| material(earlier) == material(t));
    report.duplicates += u64::from(repeated);
    repeated
}

/// The bits of the corners; adding zero turns -0 into 0.
fn corner_bits(corners: [Vec3; 3]) -> [[u32; 3]; 3] {
    corners.map(|p| (p + 0.0).to_array().map(f32::to_bits))
}

fn hash(corners: &[[u32; 3]; 3]) -> u64 {
    let mix = |h: u64, &word: &u32| (h ^ u64::from(word)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
    corners.iter().flatten().fold(0, mix)
}

/// The corners, rotated so that the smallest comes first; keeps the winding.
fn rotated(corners: [[u32; 3]; 3]) -> [[u32; 3]; 3] {
    let [a, b, c] = corners;
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or(corners)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangle(builder: &mut SceneBuilder, corners: [[f64; 3]; 3], material: MaterialId) {
        let positions = corners.map(DVec3::from);
        builder
            .push_mesh(MeshInput {
                name: "t",
                positions: &positions,
                normals: &[],
                uvs: &[],
                triangles: &[[0, 1, 2]],
                material,
            })
            .unwrap();
    }

    const UNIT: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn degenerate_and_repeated_triangles_are_dropped_and_counted() {
        let mut builder = SceneBuilder::new();
        let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.5)));
        let other = builder.push_material(Material::diffuse("other", Rgb::splat(0.2)));
        triangle(&mut builder, UNIT, white);
        triangle(&mut builder, [UNIT[1], UNIT[2], UNIT[0]], white);
        triangle(&mut builder, [UNIT[0], UNIT[2], UNIT[1]], white);
        triangle(&mut builder, UNIT, other);
        triangle(&mut builder, [UNIT[0], UNIT[1], UNIT[1]], white);
        triangle(&mut builder, [[0.0; 3], [1.0; 3], [2.0; 3]], white);
        let (scene, report) = builder.build(BuildPolicy::default()).unwrap();
        assert_eq!(scene.mesh().n_triangles(), 1);
        assert_eq!((report.duplicates, report.duplicates_of_other_material, report.degenerate), (3, 1, 2));
    }

    /// The definition, in quadratic time.
    fn slow_distinct(input: &SceneBuilder, positions: &[Vec3]) -> (Vec<usize>, u64, u64) {
        let bits = |t: usize| corner_bits(input.triangles[t].map(|v| positions[v as usize]));
        let (mut kept, mut duplicates, mut of_other): (Vec<usize>, u64, u64) = (Vec::new(), 0, 0);
        for t in 0..input.triangles.len() {
            let [a, b, c] = bits(t);
            if a == b || b == c || c == a {
                continue;
            }
            let material = input.triangle_materials[t];
            let find = |key| kept.iter().find(|&&k| rotated(bits(k)) == rotated(key)).copied();
            if let Some(earlier) = find([a, b, c]) {
                duplicates += 1;
                of_other += u64::from(input.triangle_materials[earlier] != material);
            } else if find([a, c, b]).is_some_and(|k| input.triangle_materials[k] == material && material.0 != 1) {
                duplicates += 1;
            } else {
                kept.push(t);
            }
        }
        (kept, duplicates, of_other)
    }

    #[test]
    fn repetitions_are_those_of_the_definition() {
        let mut builder = SceneBuilder::new();
        for name in ["a", "black back", "b"] {
            builder.push_material(Material::diffuse(name, Rgb::splat(0.5)));
        }
        builder.materials[1].reflects = crate::Sides::Front;
        // Five points in general position, so that most triangles occur many times; -0 is 0.
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.2, 1.0, 0.0], [-0.0, 0.3, 1.0], [-1.0, 0.5, 0.7]];
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) as usize
        };
        for _ in 0..300 {
            let corners = [points[next() % 5], points[next() % 5], points[next() % 5]];
            triangle(&mut builder, corners, MaterialId((next() % 3) as u32));
        }
        let positions: Vec<Vec3> = builder.positions.iter().map(|p| p.as_vec3()).collect();
        let mut report = SceneReport::default();
        let kept = distinct_triangles(&builder, &positions, &mut report);
        let (expected, duplicates, of_other) = slow_distinct(&builder, &positions);
        assert_eq!(kept, expected);
        assert_eq!((report.duplicates, report.duplicates_of_other_material), (duplicates, of_other));
        assert!(duplicates > 100 && of_other > 10 && kept.len() > 10, "{duplicates} {of_other} {}", kept.len());
    }

    #[test]
    fn back_to_back_sheets_of_different_materials_both_stay() {
        let mut builder = SceneBuilder::new();
        let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.5)));
        let black = builder.push_material(Material::diffuse("black", Rgb::ZERO));
        triangle(&mut builder, UNIT, white);
        triangle(&mut builder, [UNIT[0], UNIT[2], UNIT[1]], black);
        assert_eq!(builder.build(BuildPolicy::default()).unwrap().0.mesh().n_triangles(), 2);
    }

    #[test]
    fn bad_values_name_their_place_or_are_dropped_on_request() {
        let mut builder = SceneBuilder::new();
        let white = builder.push_material(Material::diffuse("white", Rgb::splat(0.5)));
        triangle(&mut builder, UNIT, white);
        triangle(&mut builder, [[0.0, f64::NAN, 0.0], UNIT[1], UNIT[2]], white);
        let error = builder.clone().build(BuildPolicy::default()).unwrap_err();
        assert_eq!(error.to_string(), "mesh \"t\", vertex 0, position.y: NaN is not finite; expected a finite number");
        let policy = BuildPolicy { drop_bad_triangles: true, ..BuildPolicy::default() };
        let (scene, report) = builder.build(policy).unwrap();
        assert_eq!((scene.mesh().n_triangles(), report.non_finite), (1, 1));
    }

    #[test]
    fn albedo_outside_0_1_is_an_error_or_clamped() {
        for (albedo, expected) in [(1.0001, 1.0), (f32::INFINITY, 1.0), (f32::NAN, 0.0), (-0.1, 0.0)] {
            let mut builder = SceneBuilder::new();
            let m = builder.push_material(Material::diffuse("paint", Rgb::new(0.5, albedo, 0.5)));
            triangle(&mut builder, UNIT, m);
            let error = builder.clone().build(BuildPolicy::default()).unwrap_err().to_string();
            assert!(error.starts_with("material \"paint\", albedo, green"), "{error}");
            let policy = BuildPolicy { clamp_materials: true, ..BuildPolicy::default() };
            let (scene, report) = builder.build(policy).unwrap();
            assert_eq!(scene.materials()[0].albedo.y, expected);
            assert_eq!(report.clamped_materials, ["paint"]);
        }
    }

    #[test]
    fn texture_coordinates_are_kept_only_where_a_texture_needs_them() {
        let mut builder = SceneBuilder::new();
        let m = builder.push_material(Material::diffuse("plain", Rgb::splat(0.5)));
        let positions = UNIT.map(DVec3::from);
        let mesh = MeshInput {
            name: "t",
            positions: &positions,
            normals: &[],
            uvs: &[Vec2::ZERO; 3],
            triangles: &[[0, 1, 2]],
            material: m,
        };
        builder.push_mesh(mesh).unwrap();
        assert!(!builder.build(BuildPolicy::default()).unwrap().0.mesh().has_uvs());
    }
}
