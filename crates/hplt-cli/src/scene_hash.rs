//! A fingerprint of everything in a scene that light depends on.

use hplt_geom::glam::Vec2;
use hplt_geom::{LightGroups, LightShape, Material, MaterialId, Rgb, Scene, TextureSlot, TriangleId, Wrap};

/// Sixteen hexadecimal digits: FNV-1a over geometry, materials, textures, lights and environment. Names and cameras do
/// not count. Two scenes that differ by accident have different fingerprints; it does not resist intent.
pub fn scene_hash(scene: &Scene) -> String {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    hash_geometry(&mut hash, scene);
    scene.materials().iter().for_each(|m| hash_material(&mut hash, m));
    for light in scene.lights() {
        hash_light(&mut hash, &light.shape);
    }
    if let Some(environment) = scene.environment() {
        let map = environment.map();
        hash.word(map.width() as u64);
        map.pixels().iter().for_each(|p| hash.rgb(*p));
    }
    format!("{:016x}", hash.0)
}

/// The same of the names of groups of lights and of what belongs to which.
pub fn light_groups_hash(groups: &LightGroups, scene: &Scene) -> String {
    let mut hash = Fnv(0xcbf2_9ce4_8422_2325);
    for name in groups.names() {
        hash.word(name.len() as u64);
        name.bytes().for_each(|b| hash.word(b.into()));
    }
    let id = |group: Option<hplt_geom::LightGroupId>| group.map_or(u64::MAX, |g| g.0.into());
    (0..scene.materials().len() as u32).for_each(|m| hash.word(id(groups.of_material(MaterialId(m)))));
    (0..scene.lights().len()).for_each(|l| hash.word(id(Some(groups.of_light(l)))));
    hash.word(id(groups.of_environment()));
    format!("{:016x}", hash.0)
}

struct Fnv(u64);

impl Fnv {
    fn word(&mut self, word: u64) {
        // Eight bytes at a time, with a shift that brings high bits down again.
        self.0 = (self.0 ^ word).wrapping_mul(0x0000_0100_0000_01b3);
        self.0 ^= self.0 >> 29;
    }

    fn floats(&mut self, values: &[f32]) {
        values.iter().for_each(|v| self.word(v.to_bits().into()));
    }

    fn rgb(&mut self, value: Rgb) {
        self.floats(&value.to_array());
    }
}

fn hash_geometry(hash: &mut Fnv, scene: &Scene) {
    let mesh = scene.mesh();
    let frame = scene.frame();
    frame.center.to_array().iter().for_each(|x| hash.word(x.to_bits()));
    hash.word(frame.exponent as u64);
    for (i, corners) in mesh.triangles().iter().enumerate() {
        let triangle = TriangleId(i as u32);
        for &corner in corners {
            hash.floats(&mesh.positions()[corner as usize].to_array());
        }
        if mesh.has_uvs() {
            mesh.corner_uvs(triangle).iter().for_each(|uv| hash.floats(&uv.to_array()));
        }
        hash.word(mesh.material(triangle).0.into());
    }
}

fn hash_material(hash: &mut Fnv, material: &Material) {
    hash.rgb(material.albedo);
    hash.rgb(material.exitance);
    hash.word(u64::from(material.reflects.includes(false)) << 1 | u64::from(material.emits.includes(false)));
    hash_texture(hash, material.albedo_texture.as_ref());
    hash_texture(hash, material.exitance_texture.as_ref());
    if let Some(mask) = &material.alpha {
        hash.floats(&[mask.factor, mask.cutoff]);
        hash_texture(hash, mask.texture.as_ref());
    }
}

fn hash_texture(hash: &mut Fnv, slot: Option<&TextureSlot>) {
    let Some(slot) = slot else { return hash.word(u64::MAX) };
    let (width, height) = slot.texture.size();
    hash.word(u64::from(width) << 32 | u64::from(height));
    hash.floats(&slot.transform.linear.to_cols_array());
    hash.floats(&slot.transform.offset.to_array());
    slot.wrap.iter().for_each(|w| hash.word(*w as u64));
    for row in 0..height {
        for column in 0..width {
            let uv = Vec2::new((column as f32 + 0.5) / width as f32, (row as f32 + 0.5) / height as f32);
            hash.floats(&slot.texture.sample(uv, [Wrap::Clamp; 2]).to_array());
        }
    }
}

fn hash_light(hash: &mut Fnv, shape: &LightShape) {
    match shape {
        LightShape::Point { position, intensity } => {
            hash.word(1);
            hash.floats(&position.to_array());
            hash.rgb(*intensity);
        }
        LightShape::Spot { position, direction, intensity, cos_inner, cos_outer } => {
            hash.word(2);
            hash.floats(&position.to_array());
            hash.floats(&direction.to_array());
            hash.rgb(*intensity);
            hash.floats(&[*cos_inner, *cos_outer]);
        }
        LightShape::Directional { direction_to_light, irradiance, angular_radius } => {
            hash.word(3);
            hash.floats(&direction_to_light.to_array());
            hash.rgb(*irradiance);
            hash.floats(&[*angular_radius]);
        }
        // A kind that this version does not know cannot be in a scene that it made; count it all the same.
        other => format!("{other:?}").bytes().for_each(|b| hash.word(b.into())),
    }
}

#[cfg(test)]
mod tests {
    use hplt_geom::glam::{DVec3, Vec3};
    use hplt_geom::{BuildPolicy, Environment, SceneBuilder};

    use super::*;

    fn hash(change: impl FnOnce(&mut SceneBuilder)) -> String {
        let mut builder = hplt_reference::scenes::cornell_box();
        change(&mut builder);
        scene_hash(&builder.build(BuildPolicy::default()).unwrap().0)
    }

    #[test]
    fn names_of_lights_count_in_the_hash_of_their_groups_alone() {
        let hashes = |change: &dyn Fn(&mut SceneBuilder)| {
            let mut builder = hplt_reference::scenes::cornell_box();
            builder.push_point_light("a", DVec3::splat(0.1), Rgb::ONE);
            builder.push_point_light("b", DVec3::splat(0.2), Rgb::ONE);
            change(&mut builder);
            let scene = builder.build(BuildPolicy::default()).unwrap().0;
            (scene_hash(&scene), light_groups_hash(&LightGroups::of(&scene), &scene))
        };
        let base = hashes(&|_| {});
        assert_eq!(base, hashes(&|b| b.materials_mut()[0].name = "renamed wall".into()));
        let renamed = hashes(&|b| b.materials_mut()[3].name = "lamp".into());
        let merged = hashes(&|b| b.materials_mut()[3].name = "a".into());
        assert!(renamed.0 == base.0 && renamed.1 != base.1 && merged.0 == base.0 && merged.1 != renamed.1);
    }

    #[test]
    fn anything_that_light_depends_on_changes_the_hash() {
        let base = hash(|_| {});
        assert_eq!(base, hash(|b| b.materials_mut()[0].name = "renamed".into()));
        let changed = [
            hash(|b| b.materials_mut()[0].albedo.x += 1e-6),
            hash(|b| b.materials_mut()[3].exitance.z *= 2.0),
            hash(|b| b.set_environment(Environment::constant(Rgb::ONE).unwrap())),
            hash(|b| b.push_point_light("p", DVec3::splat(0.1), Rgb::ONE)),
            hash(|b| b.push_directional_light("s", Vec3::Y, Rgb::ONE, 0.0)),
            hash(|b| b.push_directional_light("s", Vec3::Y, Rgb::ONE, 0.1)),
        ];
        for (i, hash) in changed.iter().enumerate() {
            assert!(*hash != base && !changed[..i].contains(hash), "change {i}");
        }
    }
}
