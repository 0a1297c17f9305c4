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
const SLOPES: [f32; 3] = [0.25, 0.03, 0.004];
/// Neighbours tried at each slope.
const NEIGHBORS: [usize; 3] = [3, 2, 2];
/// The least cosine between the normals of a point and of a neighbour.
const MIN_NORMAL_COSINE: f32 = 0.2;
/// Rays of a point that no neighbour answers for.
const RESCUE_RAYS: u32 = 32;
/// Rays of a point whose neighbour is in the dark.
const DOUBT_RAYS: u32 = 4;
/// Points located by one task.
const CHUNK: usize = 256;

/// The regions of a scene.
#[derive(Debug, Clone)]
pub struct Regions {
    pub(crate) anchors: Anchors,
    pub(crate) labels: Vec<RegionId>,
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
                let locate =
                    |&(position, normal): &(Vec3, Vec3)| self.locate_one(scene, caster, Oriented { position, normal });
                chunk.iter().map(locate).collect::<Vec<_>>()
            },
        );
        located.concat()
    }

    pub(crate) fn locate_one(&self, scene: &Scene, caster: &dyn RayCaster, point: Oriented) -> RegionId {
        let mut n_rays = RESCUE_RAYS;
        if let Some(anchor) = self.anchors.join(caster, point, NEIGHBORS) {
            if self.labels[anchor as usize] != RegionId::DARK {
                return self.labels[anchor as usize];
            }
            // Through a crack a lit point, too, finds one in the dark. It is lit if anything else that it sees is.
            n_rays = DOUBT_RAYS;
        }
        let bits = point.position.to_array().map(f32::to_bits);
        let scramble = Stream::new(self.seed, Stage::Probe).word(bits[0], bits[1], bits[2]);
        for k in 0..n_rays {
            let label = match look(scene, caster, point, sobol_2d(k, scramble, 0).into()) {
                None => self.sky,
                Some(seen) => self.anchors.join(caster, seen, NEIGHBORS).map(|anchor| self.labels[anchor as usize]),
            };
            if let Some(label) = label.filter(|&label| label != RegionId::DARK) {
                return label;
            }
        }
        RegionId::DARK
    }
}

/// What a cosine-distributed ray from `point` sees; `None` when it leaves the scene.
pub(crate) fn look(scene: &Scene, caster: &dyn RayCaster, point: Oriented, u: [f32; 2]) -> Option<Oriented> {
    let direction = cosine_hemisphere(u.into(), point.normal);
    let origin = offset_origin(point.position, point.normal);
    let hit = caster.nearest(hplt_geom::Ray::new(origin, direction));
    (!hit.is_miss()).then(|| oriented(&scene.surface_at(&hit)))
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
        let (mut found, mut n) = ([u32::MAX; N], 0);
        while n < N {
            let accept =
                |id: u32| !found[..n].contains(&id) && self.normals[id as usize].dot(point.normal) > MIN_NORMAL_COSINE;
            let Some((id, _)) = self.tree.nearest(point.position, self.reach, accept) else { break };
            found[n] = id;
            n += 1;
        }
        (found, n)
    }

    /// A neighbour of `point` with a visible path to it: one that is found at once, or else the first of the nearest,
    /// trying `counts[i]` of them at slope `i`.
    pub(crate) fn join(&self, caster: &dyn RayCaster, point: Oriented, counts: [usize; 3]) -> Option<u32> {
        // Any point nearby will do, and one descent nearly always finds one.
        let agrees = |id: u32| self.normals[id as usize].dot(point.normal) > MIN_NORMAL_COSINE;
        let nearby = self.tree.approximate_nearest(point.position, agrees);
        if let Some((id, distance_squared)) = nearby
            && distance_squared <= self.reach * self.reach
            && is_joined(caster, point, self.get(id), SLOPES[0])
        {
            return Some(id);
        }
        let (neighbors, n) = self.neighbors::<3>(point);
        let mut all = (0..SLOPES.len()).flat_map(|s| neighbors[..n.min(counts[s])].iter().map(move |&id| (s, id)));
        all.find(|&(s, id)| is_joined(caster, point, self.get(id), SLOPES[s])).map(|(_, id)| id)
    }

    /// All of the nearest neighbours with a visible path to point `i`, itself excluded.
    pub(crate) fn joined_neighbors(&self, caster: &dyn RayCaster, i: u32) -> Vec<u32> {
        let point = self.get(i);
        let (neighbors, n) = self.neighbors::<5>(point);
        let others = neighbors[..n].iter().copied().filter(|&id| id != i);
        let is_joined = |&id: &u32| SLOPES.iter().any(|&slope| is_joined(caster, point, self.get(id), slope));
        others.filter(is_joined).collect()
    }
}
