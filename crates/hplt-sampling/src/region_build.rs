use glam::Vec3;
use hplt_geom::{
    Interrupted, LightShape, Progress, Ray, RayCaster, RegionId, Scene, SurfacePoint, offset_origin, parallel,
};

use crate::components::Components;
use crate::morton::morton_code;
use crate::random::{Stage, Stream};
use crate::regions::{Anchors, MAX_STEPS, Regions, SLOPES, look, oriented, sees};
use crate::sobol::sobol_2d;
use crate::surface::{SidePoint, SideSampler, point_on};
use crate::union_find::UnionFind;
use crate::visibility::Oriented;
use crate::warp::{cosine_hemisphere, uniform_cone};

const MIN_ANCHORS: usize = 4 << 10;
const MAX_ANCHORS: usize = 64 << 10;
/// Anchors on components that uniform sampling would miss, at most.
const MAX_EXTRA: usize = 64 << 10;
/// Rays of every anchor, in rounds. From the second round on the largest component is left out,
const RAYS: [u32; 3] = [4, 12, 32];
/// and the others cast together no more than this in a round: what less than a thousandth of them sees brings no light
/// worth the name.
const COMPONENT_RAYS: u32 = 1024;
/// Neighbours that are tried first.
const NEAREST_NEIGHBORS: usize = 2;
/// Rays from all emissive surfaces together, and from each light without a surface.
const EMISSION_RAYS: u32 = 8 << 10;
const LIGHT_RAYS: u32 = 4096;
/// Points on emissive surfaces that are kept: what sees one of them is not in the dark, whatever its neighbours are.
const MAX_LAMPS: usize = 32;
/// A dark component with fewer anchors than this may only be badly connected; nobody inherits from it.
const MIN_DARK_COMPONENT: usize = 6;
const STAGE: &str = "finding lit regions";

impl Regions {
    /// Finds the regions of `scene`. About a million rays.
    ///
    /// # Errors
    /// When cancelled.
    pub fn build(
        scene: &Scene,
        caster: &dyn RayCaster,
        seed: u64,
        progress: &dyn Progress,
    ) -> Result<Self, Interrupted> {
        Self::build_on(scene, caster, &Components::find(scene.mesh()), seed, progress)
    }

    /// As [`build`](Self::build), the components of the mesh being known.
    pub(crate) fn build_on(
        scene: &Scene,
        caster: &dyn RayCaster,
        components: &Components,
        seed: u64,
        progress: &dyn Progress,
    ) -> Result<Self, Interrupted> {
        let mut builder = Builder::new(scene, caster, components, seed);
        for round in 0..RAYS.len() {
            progress.check()?;
            progress.advance(STAGE, round as u64, RAYS.len() as u64);
            builder.probe(round as u32);
            if round == 0 {
                builder.light();
            }
        }
        progress.advance(STAGE, RAYS.len() as u64, RAYS.len() as u64);
        Ok(builder.finish())
    }
}

struct Builder<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    seed: u64,
    reach: f32,
    points: Vec<Oriented>,
    /// Points drawn uniformly come first.
    n_uniform: usize,
    sets: UnionFind,
    anchors: Anchors,
    is_lit: Vec<bool>,
    sees_sky: Vec<bool>,
    sky_is_lit: bool,
    /// Of the sides that emit.
    emissive: SideSampler,
    n_rays: u64,
}

/// What the rays of one anchor found.
#[derive(Default)]
struct Found {
    joined: Vec<u32>,
    unknown: Vec<Oriented>,
    sees_sky: bool,
}

impl<'a> Builder<'a> {
    fn new(scene: &'a Scene, caster: &'a dyn RayCaster, components: &Components, seed: u64) -> Self {
        let sampler = SideSampler::build(scene, |m, front| {
            m.reflects.includes(front) || m.is_emissive() && m.emits.includes(front)
        });
        let n = (MIN_ANCHORS + scene.mesh().n_triangles() / 32).min(MAX_ANCHORS);
        let (points, n_uniform) = draw_anchors(scene, caster, (&sampler, components), n, seed);
        // Several times the mean distance between uniform points.
        let reach = 8.0 * (sampler.area() / n as f64).sqrt() as f32;
        let positions: Vec<Oriented> =
            points.iter().map(|p| Oriented { position: p.position, normal: p.normal }).collect();
        let mut builder = Self {
            scene,
            caster,
            seed,
            reach,
            n_uniform,
            sets: UnionFind::new(points.len()),
            anchors: Anchors::build(&positions, reach),
            points: positions,
            is_lit: points.iter().map(|p| emits(scene, p)).collect(),
            sees_sky: vec![false; points.len()],
            sky_is_lit: sky_is_lit(scene),
            emissive: SideSampler::build(scene, |m, front| m.is_emissive() && m.emits.includes(front)),
            n_rays: points.len() as u64,
        };
        builder.join_neighbors(0);
        builder
    }

    /// Joins the points from `first` on to their neighbours. Paths between points that are known to be connected are not
    /// looked for: they would change nothing.
    fn join_neighbors(&mut self, first: usize) {
        let n = self.points.len() - first;
        let anchors = &self.anchors;
        let pairs_of = |i: u32| anchors.neighbors_of(i).map(move |other| (i, other)).collect::<Vec<_>>();
        let pairs = parallel::map(n, || (), |(), i| pairs_of((first + i) as u32));
        // The nearest ones first, which leave little to do.
        let (nearest, farther): (Vec<_>, Vec<_>) =
            pairs.iter().map(|pairs| pairs.split_at(pairs.len().min(NEAREST_NEIGHBORS))).unzip();
        let (nearest, farther) = (nearest.concat(), farther.concat());
        for (slope, pairs) in [(0, &nearest), (0, &farther)] {
            self.join_pairs(pairs, slope);
        }
        for slope in 1..SLOPES.len() {
            self.join_pairs(&[&nearest[..], &farther[..]].concat(), slope);
        }
    }

    /// Looks for paths between the pairs that are not connected yet.
    fn join_pairs(&mut self, pairs: &[(u32, u32)], slope: usize) {
        let open: Vec<_> = pairs.iter().copied().filter(|&(a, b)| self.sets.find(a) != self.sets.find(b)).collect();
        let joined = parallel::map(open.len(), || (), |(), k| self.anchors.are_joined(self.caster, open[k], slope));
        for (&(a, b), _) in open.iter().zip(&joined).filter(|(_, joined)| **joined) {
            self.sets.union(a, b);
        }
        self.n_rays += 2 * open.len() as u64;
    }

    /// Casts rays from the points whose turn it is (see [`RAYS`]), and joins each to what it sees. Points seen where there is
    /// no anchor become anchors.
    fn probe(&mut self, round: u32) {
        let chosen = self.choose(round);
        let roots: Vec<u32> = (0..self.points.len() as u32).map(|i| self.sets.find(i)).collect();
        let stream = Stream::new(self.seed, Stage::Regions);
        let found = parallel::map(
            chosen.len(),
            || (),
            |(), k| {
                let (i, n_rays) = chosen[k];
                let scramble = stream.word(i, round + 1, 0);
                let mut found = Found::default();
                for ray in 0..n_rays {
                    self.look_around(i, [ray, scramble], &roots, &mut found);
                }
                found
            },
        );
        self.n_rays += chosen.iter().map(|&(_, n_rays)| 2 * u64::from(n_rays)).sum::<u64>();
        let n_before = self.points.len();
        let limit = n_before + n_before / 4;
        for (&(i, _), found) in chosen.iter().zip(&found) {
            found.joined.iter().for_each(|&other| self.sets.union(i, other));
            self.sees_sky[i as usize] |= found.sees_sky;
            for &seen in &found.unknown {
                if self.points.len() < limit {
                    let new = self.push(seen);
                    self.sets.union(new, i);
                }
            }
        }
        self.accept_new(n_before);
    }

    /// Notes what anchor `i` is joined to by its ray `k`.
    fn look_around(&self, i: u32, [k, scramble]: [u32; 2], roots: &[u32], found: &mut Found) {
        let mut here = self.points[i as usize];
        let mut first = None;
        for step in 0..MAX_STEPS {
            let Some(seen) = look(self.scene, self.caster, here, sobol_2d(k, scramble, step).into()) else {
                found.sees_sky = true;
                return;
            };
            let guess = self.anchors.guess(seen);
            // Most rays stay where they are known to be: a path from there on would tell nothing.
            if guess.is_some_and(|guess| roots[guess as usize] == roots[i as usize]) {
                return;
            }
            if !sees(self.caster, seen, here) {
                break;
            }
            if let Some(other) = self.anchors.join_guessing(self.caster, seen, guess, [2, 1, 0]) {
                found.joined.push(other);
                return;
            }
            first.get_or_insert(seen);
            here = seen;
        }
        found.unknown.extend(first);
    }

    /// The points whose turn it is, and their numbers of rays.
    fn choose(&mut self, round: u32) -> Vec<(u32, u32)> {
        let n = self.points.len() as u32;
        let n_rays = RAYS[round as usize];
        if round == 0 {
            return (0..n).map(|i| (i, n_rays)).collect();
        }
        self.join_sky();
        let mut sizes = vec![0u32; n as usize];
        (0..n).for_each(|i| sizes[self.sets.find(i) as usize] += 1);
        let largest = (0..n).max_by_key(|&i| (sizes[i as usize], n - i));
        let rays_of =
            |root: u32| if Some(root) == largest { 0 } else { n_rays.min(COMPONENT_RAYS / sizes[root as usize]) };
        (0..n).map(|i| (i, rays_of(self.sets.find(i)))).filter(|&(_, n_rays)| n_rays > 0).collect()
    }

    fn push(&mut self, point: Oriented) -> u32 {
        self.points.push(point);
        self.is_lit.push(false);
        self.sees_sky.push(false);
        self.sets.push()
    }

    /// Makes points from `first` on known to the others.
    fn accept_new(&mut self, first: usize) {
        if self.points.len() > first {
            self.anchors = Anchors::build(&self.points, self.reach);
            self.join_neighbors(first);
        }
    }

    /// Points that see a sky that gives light are joined through it.
    fn join_sky(&mut self) -> Option<u32> {
        if !self.sky_is_lit {
            return None;
        }
        let mut first = None;
        for i in (0..self.points.len()).filter(|&i| self.sees_sky[i]) {
            let first = *first.get_or_insert(i as u32);
            self.sets.union(first, i as u32);
        }
        first
    }

    /// Marks what emitters and lights see.
    fn light(&mut self) {
        let seen = lit_surface(self.scene, self.caster, &self.emissive, self.seed);
        self.n_rays += 4 * seen.len() as u64;
        let joined =
            parallel::map(seen.len(), || (), |(), i| self.anchors.join(self.caster, oriented(&seen[i]), [3, 2, 2]));
        let n_before = self.points.len();
        for (seen, joined) in seen.iter().zip(joined) {
            let anchor = joined.unwrap_or_else(|| self.push(oriented(seen)));
            self.is_lit[anchor as usize] = true;
        }
        self.accept_new(n_before);
    }

    fn finish(mut self) -> Regions {
        let sky_member = self.join_sky();
        let n = self.points.len() as u32;
        let (mut lit, mut sizes) = (vec![false; n as usize], vec![0usize; n as usize]);
        for i in 0..n {
            let root = self.sets.find(i) as usize;
            sizes[root] += 1;
            lit[root] |= self.is_lit[i as usize];
        }
        if let Some(member) = sky_member {
            lit[self.sets.find(member) as usize] = true;
        }
        let (labels, n_regions) = self.number(&lit);
        let n_lit = labels[..self.n_uniform].iter().filter(|&&label| label != RegionId::DARK).count();
        let sky = sky_member.map(|member| labels[member as usize]);
        // Nobody inherits darkness from a point that may merely be badly connected.
        let mut keep: Vec<usize> = (0..n as usize)
            .filter(|&i| labels[i] != RegionId::DARK || sizes[self.sets.find(i as u32) as usize] >= MIN_DARK_COMPONENT)
            .collect();
        keep.sort_by_key(|&i| (morton_code(self.points[i].position), i));
        let points: Vec<Oriented> = keep.iter().map(|&i| self.points[i]).collect();
        let anchors = Anchors::build(&points, self.reach);
        let labels: Vec<RegionId> = keep.iter().map(|&i| labels[i]).collect();
        Regions {
            lamps: lamps(self.scene, self.caster, &self.emissive, (&anchors, &labels), self.seed),
            anchors,
            labels,
            n_regions,
            sky,
            n_rays: self.n_rays,
            lit_share: n_lit as f64 / self.n_uniform.max(1) as f64,
            seed: self.seed,
        }
    }

    /// Region ids in order of the first anchor; dark components all get the same.
    fn number(&mut self, lit: &[bool]) -> (Vec<RegionId>, u32) {
        let mut number_of = vec![RegionId::DARK; lit.len()];
        let mut n_regions = 0;
        let labels = (0..lit.len() as u32)
            .map(|i| {
                let root = self.sets.find(i) as usize;
                if lit[root] && number_of[root] == RegionId::DARK {
                    number_of[root] = RegionId(n_regions);
                    n_regions += 1;
                }
                number_of[root]
            })
            .collect();
        (labels, n_regions)
    }
}

/// Exposed points on the sides that the sampler knows, and how many of them are uniform: those come first, then one on
/// each side of every component that would otherwise go without.
fn draw_anchors(
    scene: &Scene,
    caster: &dyn RayCaster,
    (sampler, components): (&SideSampler, &Components),
    n: usize,
    seed: u64,
) -> (Vec<SidePoint>, usize) {
    let stream = Stream::new(seed, Stage::Regions);
    let extra = components.small_sides(sampler, n, 4.0, MAX_EXTRA);
    let exposed = |point: Option<SidePoint>| point.filter(|p| p.is_exposed(caster));
    let mut points: Vec<SidePoint> =
        parallel::map(n, || (), |(), i| exposed(sampler.sample(scene, stream.words(i as u32, 0, 0))))
            .into_iter()
            .flatten()
            .collect();
    let n_uniform = points.len();
    let on_extra = parallel::map(
        extra.len(),
        || (),
        |(), i| {
            let words = stream.words(i as u32, 0, 1);
            exposed(point_on(scene, extra[i], words[0], words[1]))
        },
    );
    points.extend(on_extra.into_iter().flatten());
    (points, n_uniform)
}

fn sky_is_lit(scene: &Scene) -> bool {
    let environment = scene.environment().is_some_and(|e| e.map().pixels().iter().any(|p| p.max_element() > 0.0));
    let is_sun = |shape: &LightShape| matches!(shape, LightShape::Directional { irradiance, .. } if irradiance.max_element() > 0.0);
    environment || scene.lights().iter().any(|light| is_sun(&light.shape))
}

fn emits(scene: &Scene, point: &SidePoint) -> bool {
    scene.material(point.triangle).exitance_at(point.is_front, point.uv).max_element() > 0.0
}

/// Some points on emissive surfaces whose region is known, which is lit.
fn lamps(
    scene: &Scene,
    caster: &dyn RayCaster,
    sampler: &SideSampler,
    (anchors, labels): (&Anchors, &[RegionId]),
    seed: u64,
) -> Vec<(Oriented, RegionId)> {
    let stream = Stream::new(seed, Stage::Emission);
    let n = if sampler.sides().is_empty() { 0 } else { MAX_LAMPS };
    let lamp = |i: usize| {
        let point = sampler.sample(scene, stream.words(i as u32, 0, 3)).filter(|p| emits(scene, p))?;
        let point = Oriented { position: point.position, normal: point.normal };
        let label = labels[anchors.join(caster, point, [3, 2, 2])? as usize];
        (label != RegionId::DARK).then_some((point, label))
    };
    parallel::map(n, || (), |(), i| lamp(i)).into_iter().flatten().collect()
}

/// Points that emissive surfaces and lights at a position see.
fn lit_surface(scene: &Scene, caster: &dyn RayCaster, sampler: &SideSampler, seed: u64) -> Vec<SurfacePoint> {
    let stream = Stream::new(seed, Stage::Emission);
    let n = if sampler.sides().is_empty() { 0 } else { EMISSION_RAYS.max((sampler.sides().len() as u32).min(1 << 20)) };
    let from_surfaces = parallel::map(
        n as usize,
        || (),
        |(), i| {
            // The first rays go out from every emissive side in turn, the rest by area.
            let words = stream.words(i as u32, 0, 0);
            let point = match sampler.sides().get(i) {
                Some(&side) => point_on(scene, side, words[2], words[3]),
                None => sampler.sample(scene, words),
            };
            let point = point.filter(|p| emits(scene, p) && p.is_exposed(caster))?;
            let direction = cosine_hemisphere(sobol_2d(i as u32, stream.word(0, 0, 1), 1), point.normal);
            see(scene, caster, Ray::new(offset_origin(point.position, point.normal), direction))
        },
    );
    let mut seen: Vec<SurfacePoint> = from_surfaces.into_iter().flatten().collect();
    for (id, light) in scene.lights().iter().enumerate() {
        let (position, axis, angle) = match &light.shape {
            LightShape::Point { position, intensity } if intensity.max_element() > 0.0 => {
                (*position, Vec3::Z, std::f32::consts::PI)
            }
            LightShape::Spot { position, direction, intensity, cos_outer, .. } if intensity.max_element() > 0.0 => {
                (*position, *direction, cos_outer.acos())
            }
            _ => continue,
        };
        let scramble = stream.word(id as u32, 0, 2);
        let rays = parallel::map(
            LIGHT_RAYS as usize,
            || (),
            |(), i| {
                let direction = uniform_cone(sobol_2d(i as u32, scramble, 0), axis, angle);
                see(scene, caster, Ray::new(position, direction))
            },
        );
        seen.extend(rays.into_iter().flatten());
    }
    seen
}

fn see(scene: &Scene, caster: &dyn RayCaster, ray: Ray) -> Option<SurfacePoint> {
    let hit = caster.nearest(ray);
    (!hit.is_miss()).then(|| scene.surface_at(&hit))
}
