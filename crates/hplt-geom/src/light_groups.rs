use std::collections::BTreeMap;

use crate::{Error, LightShape, MaterialId, Rgb, Scene};

/// Index of a group of lights in its [`LightGroups`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct LightGroupId(pub u32);

/// The lights of a scene by name: what a change of lights addresses.
///
/// Emissive surfaces go by the name of their material, lights by their own, the environment by
/// [`Environment::name`](crate::Environment::name); equal names are one group. A nameless material becomes `emitter<k>` and a
/// nameless light `light<k>`, `k` its index. Materials come first, then lights, then the environment. What emits nothing is in
/// no group.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct LightGroups {
    names: Vec<String>,
    of_material: Vec<Option<LightGroupId>>,
    of_light: Vec<LightGroupId>,
    of_environment: Option<LightGroupId>,
}

impl LightGroups {
    /// The groups of a scene.
    pub fn of(scene: &Scene) -> Self {
        let mut is_used = vec![false; scene.materials().len()];
        scene.emissive_triangles().for_each(|t| is_used[scene.mesh().material(t).0 as usize] = true);
        let mut names = Names::default();
        let materials = scene.materials().iter().zip(is_used).enumerate();
        let of_material = materials.map(|(k, (m, is_used))| is_used.then(|| names.id(&m.name, "emitter", k))).collect();
        let of_light = scene.lights().iter().enumerate().map(|(k, l)| names.id(&l.name, "light", k)).collect();
        let of_environment = scene.environment().map(|e| names.id(e.name(), "environment", 0));
        Self { names: names.in_order, of_material, of_light, of_environment }
    }

    /// How many groups there are.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there is no light at all.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// The names, by [`LightGroupId`]; no two are equal.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The group of that name.
    pub fn find(&self, name: &str) -> Option<LightGroupId> {
        self.names.iter().position(|n| n == name).map(|i| LightGroupId(i as u32))
    }

    /// The group of an emissive material that some triangle has.
    pub fn of_material(&self, material: MaterialId) -> Option<LightGroupId> {
        self.of_material[material.0 as usize]
    }

    /// The group of a light, by its index in [`Scene::lights`].
    pub fn of_light(&self, light: usize) -> LightGroupId {
        self.of_light[light]
    }

    /// The group of the environment, if there is one.
    pub fn of_environment(&self) -> Option<LightGroupId> {
        self.of_environment
    }
}

#[derive(Default)]
struct Names {
    in_order: Vec<String>,
    known: BTreeMap<String, LightGroupId>,
}

impl Names {
    fn id(&mut self, name: &str, kind: &str, k: usize) -> LightGroupId {
        let name = if name.is_empty() { format!("{kind}{k}") } else { name.to_owned() };
        *self.known.entry(name).or_insert_with_key(|name| {
            self.in_order.push(name.clone());
            LightGroupId(self.in_order.len() as u32 - 1)
        })
    }
}

impl Scene {
    /// Multiplies the light of each group by its factor per channel. `groups` must be those of this scene as it was built: a
    /// group with factor 0 is none afterwards.
    ///
    /// # Errors
    /// When a factor or a product is negative or not finite; the scene is unchanged then.
    ///
    /// # Panics
    /// When there is not one factor per group.
    pub fn scale_lights(&mut self, groups: &LightGroups, factors: &[Rgb]) -> Result<(), Error> {
        assert_eq!(factors.len(), groups.len(), "one factor per group");
        let scaled = |value: Rgb, group: LightGroupId| {
            let factor = factors[group.0 as usize];
            let place = || format!("light group \"{}\", factor {factor}", groups.names[group.0 as usize]);
            let product = value * factor;
            for (factor, product) in factor.to_array().into_iter().zip(product.to_array()) {
                if !product.is_finite() || !factor.is_finite() {
                    return Err(Error::NotFinite { place: place(), value: product.into() });
                }
                if factor < 0.0 {
                    let expected = "a factor of 0 or more";
                    return Err(Error::OutOfRange { place: place(), value: factor.into(), expected });
                }
            }
            Ok(product)
        };
        let mut exitances: Vec<Rgb> = self.materials.iter().map(|m| m.exitance).collect();
        for (exitance, group) in exitances.iter_mut().zip(&groups.of_material) {
            if let Some(group) = *group {
                *exitance = scaled(*exitance, group)?;
            }
        }
        let mut lights = self.lights.clone();
        for (light, &group) in lights.iter_mut().zip(&groups.of_light) {
            match &mut light.shape {
                LightShape::Point { intensity: power, .. }
                | LightShape::Spot { intensity: power, .. }
                | LightShape::Directional { irradiance: power, .. } => *power = scaled(*power, group)?,
            }
        }
        let environment = match (&self.environment, groups.of_environment) {
            (Some(environment), Some(group)) => {
                let factor = scaled(Rgb::ONE, group)?;
                if factor == Rgb::ZERO { None } else { Some(environment.scaled(factor)?) }
            }
            _ => self.environment.clone(),
        };
        self.materials.iter_mut().zip(exitances).for_each(|(material, exitance)| material.exitance = exitance);
        (self.lights, self.environment) = (lights, environment);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::{BuildPolicy, Environment, Material, MeshInput, SceneBuilder};

    fn scene() -> Scene {
        let mut builder = SceneBuilder::new();
        let lamp = Material::emitter("lamp", Rgb::ZERO, Rgb::new(1.0, 2.0, 4.0));
        let materials = [
            Material::diffuse("wall", Rgb::splat(0.5)),
            lamp.clone(),
            Material { name: String::new(), ..lamp.clone() },
            lamp.clone(),
            Material { name: "unused".into(), ..lamp },
        ];
        for (i, material) in materials.into_iter().enumerate() {
            let (material, x, is_used) = (builder.push_material(material), i as f64, i < 4);
            let positions = [DVec3::new(x, 0.0, 0.0), DVec3::new(x, 1.0, 0.0), DVec3::new(x, 0.0, 1.0)];
            let triangles: &[[u32; 3]] = if is_used { &[[0, 1, 2]] } else { &[] };
            let mesh = MeshInput { name: "m", positions: &positions, normals: &[], uvs: &[], triangles, material };
            builder.push_mesh(mesh).unwrap();
        }
        builder.push_point_light("lamp", DVec3::ZERO, Rgb::splat(2.0));
        builder.push_directional_light("", Vec3::Y, Rgb::splat(3.0), 0.0);
        builder.set_environment(Environment::constant(Rgb::splat(0.5)).unwrap());
        builder.build(BuildPolicy::default()).unwrap().0
    }

    #[test]
    fn equal_names_are_one_group_and_nameless_lights_get_names() {
        let groups = LightGroups::of(&scene());
        assert_eq!(groups.names(), ["lamp", "emitter2", "light1", "sky"]);
        let of_materials: Vec<_> = (0..5).map(|i| groups.of_material(MaterialId(i)).map(|g| g.0)).collect();
        assert_eq!(of_materials, [None, Some(0), Some(1), Some(0), None]);
        assert_eq!((groups.of_light(0).0, groups.of_light(1).0), (0, 2));
        assert_eq!((groups.of_environment(), groups.find("sky")), (Some(LightGroupId(3)), Some(LightGroupId(3))));
        assert_eq!(groups.find("wall"), None);
    }

    #[test]
    fn factors_scale_all_lights_of_their_group_and_no_other() {
        let mut scaled = scene();
        let groups = LightGroups::of(&scaled);
        let factors = [Rgb::new(2.0, 0.5, 0.0), Rgb::ONE, Rgb::splat(3.0), Rgb::ZERO];
        scaled.scale_lights(&groups, &factors).unwrap();
        assert_eq!(scaled.materials()[1].exitance, Rgb::new(2.0, 1.0, 0.0));
        assert_eq!(scaled.materials()[2].exitance, Rgb::new(1.0, 2.0, 4.0));
        assert_eq!(scaled.materials()[4].exitance, Rgb::new(1.0, 2.0, 4.0));
        let before = scene();
        let expected = |factor: Rgb| match before.lights()[0].shape {
            LightShape::Point { position, intensity } => LightShape::Point { position, intensity: intensity * factor },
            _ => unreachable!(),
        };
        assert_eq!(scaled.lights()[0].shape, expected(factors[0]));
        assert!(matches!(scaled.lights()[1].shape,
            LightShape::Directional { irradiance, .. } if irradiance == Rgb::splat(9.0)));
        assert!(scaled.environment().is_none());
    }

    #[test]
    fn factors_that_no_light_can_have_leave_the_scene_as_it_was() {
        for bad in [-1.0, f32::NAN, f32::INFINITY, f32::MAX] {
            for i in 0..4 {
                let (mut scaled, groups) = (scene(), LightGroups::of(&scene()));
                let mut factors = [Rgb::splat(0.5); 4];
                factors[i].y = bad;
                // Half of f32::MAX is a radiance that a sky can have.
                let is_possible = i == 3 && bad == f32::MAX;
                assert_eq!(scaled.scale_lights(&groups, &factors).is_ok(), is_possible, "{bad} {i}");
                assert!(is_possible || scaled == scene());
            }
        }
    }
}
