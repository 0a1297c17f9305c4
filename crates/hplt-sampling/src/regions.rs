//! Which connected part of the air a point of the surface faces, and whether light gets there.
//!
//! Distance says nothing about that: a floor runs on under a wall. So a point belongs to a region only when a path of
//! straight, unblocked segments leads to a point that is known to. [`Regions`] keeps such points, some tens of thousands,
//! spread over both sides of all surfaces (`region_build.rs`), and answers for any other point with about two short rays.

use glam::Vec3;
use hplt_geom::{RayCaster, RegionId, Scene, SurfacePoint, offset_origin, parallel};
use hplt_kdtree::KdTree;

use crate::random::{Stage, Stream};
use crate::sobol::sobol_2d;
use crate::visibility::{Oriented, is_joined};
use crate::warp::cosine_hemisphere;

/// Heights of paths over their lengths, tried in turn: over convex surfaces, and under low ceilings.
pub(crate) const SLOPES: [f32; 3] = [0.25, 0.03, 0.004];
/// Neighbours tried at each slope.
const NEIGHBORS: [usize; 3] = [3, 2, 2];
/// Points that an anchor may be joined to without more rays than those of the paths, itself included.
const N_NEIGHBORS: usize = 5;
/// The least cosine between the normals of a point and of a neighbour.
const MIN_NORMAL_COSINE: f32 = 0.2;

/// How hard a point that no neighbour answers for, or one in the dark, looks for light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Doubt {
    /// Rays, at most. Most are for points in the open, whose rays escape and tell nothing.
    n_rays: u32,
    /// How many of them have to end in the dark to decide where no neighbour answers,
    alone: u32,
    /// and where one does that is in the dark.
    in_company: u32,
}

impl Doubt {
    /// For the many points that functions are chosen from, each of which stands for others nearby.
    pub const LITTLE: Self = Self { n_rays: 16, alone: 4, in_company: 2 };
    /// For points that are asked for.
    pub const MUCH: Self = Self { n_rays: 256, alone: 8, in_company: 4 };
}

/// Surfaces that a ray of a point visits, each from the one before, until it comes to one that a neighbour answers for.
pub(crate) const MAX_STEPS: u32 = 3;
/// Points located by one task.
const CHUNK: usize = 256;

/// The regions of a scene.
#[derive(Debug, Clone)]
pub struct Regions {
    pub(crate) anchors: Anchors,
    pub(crate) labels: Vec<RegionId>,
    /// Points on emissive surfaces, and the regions that they light.
    pub(crate) lamps: Vec<(Oriented, RegionId)>,
    pub(crate) n_regions: u32,
    /// The region that is open to the sky, where the sky gives light.
    pub(crate) sky: Option<RegionId>,
    pub(crate) n_rays: u64,
    pub(crate) lit_share: f64,
    pub(crate) seed: u64,
}

impl Regions {
    /// The number of regions that light reaches; their ids are below this.
    pub fn n_regions(&self) -> u32 {
        self.n_regions
    }

    /// The points that the regions are made of.
    pub fn n_anchors(&self) -> usize {
        self.labels.len()
    }

    /// Rays cast to find the regions.
    pub fn n_rays(&self) -> u64 {
        self.n_rays
    }

    /// A first estimate of the share of all sides, by area, that light reaches.
    pub fn lit_share(&self) -> f64 {
        self.lit_share
    }

    /// Bytes that the regions take.
    pub fn memory(&self) -> usize {
        self.anchors.memory() + size_of_val(&self.labels[..])
    }

    /// The region of each point of the surface, given as position and unit normal (scene space):
    /// [`RegionId::DARK`] where no light gets, and where no visible path leads to a point whose region is known.
    ///
    /// Depends on nothing but the point. About two short rays per point where the surface is smooth, some dozens where
    /// it is not. Runs in parallel.
    pub fn locate(&self, scene: &Scene, caster: &dyn RayCaster, points: &[(Vec3, Vec3)]) -> Vec<RegionId> {
        let located = parallel::map(
            points.len().div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let chunk = &points[chunk * CHUNK..points.len().min((chunk + 1) * CHUNK)];
                let locate = |&(position, normal): &(Vec3, Vec3)| {
                    self.locate_one(scene, caster, Oriented { position, normal }, Doubt::MUCH)
                };
                chunk.iter().map(locate).collect::<Vec<_>>()
            },
        );
        located.concat()
    }

    pub(crate) fn locate_one(&self, scene: &Scene, caster: &dyn RayCaster, point: Oriented, doubt: Doubt) -> RegionId {
        let mut n_dark = doubt.alone;
        if let Some(anchor) = self.anchors.join(caster, point, NEIGHBORS) {
            if self.labels[anchor as usize] != RegionId::DARK {
                return self.labels[anchor as usize];
            }
            // Through a crack a lit point, too, finds one in the dark. It is lit if anything else that it sees is.
            n_dark = doubt.in_company;
        }
        let bits = point.position.to_array().map(f32::to_bits);
        let scramble = Stream::new(self.seed, Stage::Probe).word(bits[0], bits[1], bits[2]);
        for k in 0..doubt.n_rays {
            match self.walk(scene, caster, point, [k, scramble]) {
                Some(RegionId::DARK) => {
                    n_dark -= 1;
                    if n_dark == 0 {
                        break;
                    }
                }
                Some(label) => return label,
                None => {}
            }
        }
        self.lamps.iter().find(|(lamp, _)| faces(caster, *lamp, point)).map_or(RegionId::DARK, |&(_, label)| label)
    }

    /// Goes with ray `k` of the sequence `scramble` from `point` to what it sees, and on from there, until it comes to where an
    /// anchor is joined or leaves the scene. The region there, if known.
    fn walk(
        &self,
        scene: &Scene,
        caster: &dyn RayCaster,
        point: Oriented,
        [k, scramble]: [u32; 2],
    ) -> Option<RegionId> {
        let mut here = point;
        for step in 0..MAX_STEPS {
            let Some(seen) = look(scene, caster, here, sobol_2d(k, scramble, step).into()) else { return self.sky };
            let label = self.anchors.join(caster, seen, NEIGHBORS).map(|anchor| self.labels[anchor as usize]);
            if label == Some(RegionId::DARK) {
                return label;
            }
            if !sees(caster, seen, here) {
                return None;
            }
            if label.is_some() {
                return label;
            }
            here = seen;
        }
        None
    }
}

/// What a cosine-distributed ray from `point` sees; `None` when it leaves the scene.
pub(crate) fn look(scene: &Scene, caster: &dyn RayCaster, point: Oriented, u: [f32; 2]) -> Option<Oriented> {
    let direction = cosine_hemisphere(u.into(), point.normal);
    let origin = offset_origin(point.position, point.normal);
    let hit = caster.nearest(hplt_geom::Ray::new(origin, direction));
    (!hit.is_miss()).then(|| oriented(&scene.surface_at(&hit)))
}

/// Whether `a` sees `b`. Not so for a point met so close to where two surfaces cross that rounding put it on the other side of
/// one, from where a walk would go on in another room.
pub(crate) fn sees(caster: &dyn RayCaster, a: Oriented, b: Oriented) -> bool {
    let above = |p: Oriented| offset_origin(p.position, p.normal);
    !caster.is_occluded(hplt_geom::Ray::segment(above(a), above(b)))
}

/// Whether two points are in front of each other with nothing between.
fn faces(caster: &dyn RayCaster, a: Oriented, b: Oriented) -> bool {
    let offset = b.position - a.position;
    a.normal.dot(offset) > 0.0 && b.normal.dot(offset) < 0.0 && sees(caster, a, b)
}

pub(crate) fn oriented(point: &SurfacePoint) -> Oriented {
    Oriented { position: point.position, normal: point.normal }
}

/// Oriented points that others are joined to.
#[derive(Debug, Clone)]
pub(crate) struct Anchors {
    tree: KdTree,
    normals: Vec<Vec3>,
    positions: Vec<Vec3>,
    /// How far to look for a neighbour, scene units.
    reach: f32,
}

impl Anchors {
    pub(crate) fn build(points: &[Oriented], reach: f32) -> Self {
        let positions: Vec<Vec3> = points.iter().map(|p| p.position).collect();
        let normals = points.iter().map(|p| p.normal).collect();
        Self { tree: KdTree::build(&positions), normals, positions, reach }
    }

    fn memory(&self) -> usize {
        self.tree.memory() + size_of_val(&self.normals[..]) + size_of_val(&self.positions[..])
    }

    fn get(&self, i: u32) -> Oriented {
        Oriented { position: self.positions[i as usize], normal: self.normals[i as usize] }
    }

    /// Up to `N` nearest points within reach whose normals agree with `point`'s, nearest first.
    pub(crate) fn neighbors<const N: usize>(&self, point: Oriented) -> ([u32; N], usize) {
        let (found, n) = self.tree.few_nearest(point.position, self.reach, self.agreement_with(point));
        (found.map(|(id, _)| id), n)
    }

    fn agreement_with(&self, point: Oriented) -> impl Fn(u32) -> bool {
        move |id| self.normals[id as usize].dot(point.normal) > MIN_NORMAL_COSINE
    }

    /// A point near `point` that one descent finds, which is most often one that it is joined to.
    pub(crate) fn guess(&self, point: Oriented) -> Option<u32> {
        let nearby = self.tree.approximate_nearest(point.position, self.agreement_with(point));
        nearby.filter(|&(_, distance_squared)| distance_squared <= self.reach * self.reach).map(|(id, _)| id)
    }

    /// A neighbour of `point` with a visible path to it: one that is found at once, or else the first of the nearest,
    /// trying `counts[i]` of them at slope `i`.
    pub(crate) fn join(&self, caster: &dyn RayCaster, point: Oriented, counts: [usize; 3]) -> Option<u32> {
        // Any point nearby will do, and one descent nearly always finds one.
        let guess = self.guess(point);
        self.join_guessing(caster, point, guess, counts)
    }

    /// As [`join`](Self::join), with the [`guess`](Self::guess) at hand.
    pub(crate) fn join_guessing(
        &self,
        caster: &dyn RayCaster,
        point: Oriented,
        guess: Option<u32>,
        counts: [usize; 3],
    ) -> Option<u32> {
        if let Some(id) = guess
            && is_joined(caster, point, self.get(id), SLOPES[0])
        {
            return Some(id);
        }
        let (neighbors, n) = self.neighbors::<3>(point);
        let all = (0..SLOPES.len()).flat_map(|s| neighbors[..n.min(counts[s])].iter().map(move |&id| (s, id)));
        let mut untried = all.filter(|&(s, id)| s > 0 || Some(id) != guess);
        untried.find(|&(s, id)| is_joined(caster, point, self.get(id), SLOPES[s])).map(|(_, id)| id)
    }

    /// The nearest neighbours of point `i`, itself excluded.
    pub(crate) fn neighbors_of(&self, i: u32) -> impl Iterator<Item = u32> {
        let (neighbors, n) = self.neighbors::<N_NEIGHBORS>(self.get(i));
        neighbors.into_iter().take(n).filter(move |&id| id != i)
    }

    /// Whether there is a visible path between points `i` and `other`, at the slope with this number.
    pub(crate) fn are_joined(&self, caster: &dyn RayCaster, (i, other): (u32, u32), slope: usize) -> bool {
        is_joined(caster, self.get(i), self.get(other), SLOPES[slope])
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;
    use hplt_geom::{BuildPolicy, Bvh, BvhOptions, Material, MeshInput, NoProgress, Rgb, SceneBuilder};

    use super::*;

    /// A floor and a lamp over it that looks down.
    fn lit_floor() -> Scene {
        let mut builder = SceneBuilder::new();
        let grey = builder.push_material(Material::diffuse("grey", Rgb::splat(0.5)));
        let lamp = builder.push_material(Material::emitter("lamp", Rgb::ZERO, Rgb::ONE));
        let floor = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 0.0]].map(DVec3::from);
        let ceiling = [[-1.0, 1.0, -1.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 1.0]].map(DVec3::from);
        for (name, positions, material) in [("floor", &floor, grey), ("lamp", &ceiling, lamp)] {
            let triangles = [[0, 1, 2]];
            builder
                .push_mesh(MeshInput { name, positions, normals: &[], uvs: &[], triangles: &triangles, material })
                .unwrap();
        }
        builder.build(BuildPolicy::default()).unwrap().0
    }

    /// A wall in the open that sees the lit floor with one of a hundred rays or so, and nothing else: what is known around says that it
    /// is dark, and the other rays escape.
    #[test]
    fn points_in_the_open_look_for_light() {
        let scene = lit_floor();
        let bvh = Bvh::build(&scene, BvhOptions::fast()).0;
        let mut regions = Regions::build(&scene, &bvh, 1, &NoProgress).unwrap();
        let floor = scene.mesh().positions()[0].y;
        let points: Vec<Oriented> = (0..12u8)
            .map(|i| Vec3::new(1.5, floor + 0.5 + 0.05 * f32::from(i), 0.0))
            .map(|position| Oriented { position, normal: Vec3::NEG_X })
            .collect();
        let n_lit = |regions: &Regions, doubt| {
            let is_lit = |p: &&Oriented| regions.locate_one(&scene, &bvh, **p, doubt) != RegionId::DARK;
            points.iter().filter(is_lit).count()
        };
        regions.lamps.clear();
        assert_eq!(n_lit(&regions, Doubt::MUCH), points.len());
        assert!(n_lit(&regions, Doubt::LITTLE) < points.len());
    }

    /// Even where every neighbour is called dark.
    #[test]
    fn what_a_lamp_shines_on_is_lit() {
        let scene = lit_floor();
        let bvh = Bvh::build(&scene, BvhOptions::fast()).0;
        let mut regions = Regions::build(&scene, &bvh, 1, &NoProgress).unwrap();
        let at = |height: f32| (Vec3::new(-0.2, scene.mesh().positions()[0].y, 0.0), Vec3::Y * height);
        let labels = |regions: &Regions| regions.locate(&scene, &bvh, &[at(1.0), at(-1.0)]);
        let lit = labels(&regions)[0];
        assert_ne!(lit, RegionId::DARK);
        regions.labels.fill(RegionId::DARK);
        assert_eq!(labels(&regions), [lit, RegionId::DARK]);
        regions.lamps.clear();
        assert_eq!(labels(&regions), [RegionId::DARK; 2]);
    }
}
