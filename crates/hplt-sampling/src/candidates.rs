use hplt_geom::{Extent, Interrupted, OrientedPoint, Progress, RayCaster, RegionId, Scene, parallel};

use crate::Regions;
use crate::components::Components;
use crate::random::{Stage, Stream};
use crate::regions::Doubt;
use crate::surface::{Side, SidePoint, SideSampler, point_on};
use crate::visibility::{Oriented, free_height};

/// Candidates drawn by one task.
const CHUNK: usize = 512;
/// Tasks between two looks at the caller.
const TASKS: usize = 256;
/// A component that expects fewer candidates than this gets one on each side in any case.
const ENOUGH: f64 = 8.0;
/// So many draws per point wanted, and then it is given up.
const MAX_DRAWS_PER_POINT: usize = 256;
const STAGE: &str = "drawing candidates";

/// Points on the surface that light reaches, in order of priority.
pub(crate) struct Candidates<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    regions: &'a Regions,
    sampler: &'a SideSampler,
    seed: u64,
    points: Vec<OrientedPoint>,
    /// The range of points that are not part of the uniform sample.
    extra: std::ops::Range<usize>,
    n_drawn: usize,
    n_other: usize,
}

impl<'a> Candidates<'a> {
    pub(crate) fn new(
        scene: &'a Scene,
        caster: &'a dyn RayCaster,
        regions: &'a Regions,
        sampler: &'a SideSampler,
        seed: u64,
    ) -> Self {
        Self { scene, caster, regions, sampler, seed, points: Vec::new(), extra: 0..0, n_drawn: 0, n_other: 0 }
    }

    pub(crate) fn scene(&self) -> &'a Scene {
        self.scene
    }

    /// What casts the rays.
    pub(crate) fn caster(&self) -> &'a dyn RayCaster {
        self.caster
    }

    /// Draws until about `n` more are reachable.
    pub(crate) fn draw(&mut self, n: usize, progress: &dyn Progress) -> Result<(), Interrupted> {
        let (target, limit) = (self.points.len() + n, self.n_drawn + n * MAX_DRAWS_PER_POINT);
        let source = Source { regions: self.regions, stream: Stream::new(self.seed, Stage::Candidates), dimension: 0 };
        while self.points.len() < target && self.n_drawn < limit {
            progress.check()?;
            progress.advance(STAGE, self.points.len() as u64, target as u64);
            // Not much more than what is missing, judged by the yield so far.
            let kept = (self.points.len() - self.extra.len()).max(1) as f64 / self.n_drawn.max(1) as f64;
            let share = if self.n_drawn == 0 { self.regions.lit_share().clamp(0.01, 1.0) } else { kept };
            let missing = (target - self.points.len()) as f64 / share;
            let n_tasks = ((missing / CHUNK as f64).ceil() as usize).clamp(1, TASKS);
            let drawn =
                source.draw(self.scene, self.caster, self.sampler, self.n_drawn..self.n_drawn + n_tasks * CHUNK);
            self.n_drawn += n_tasks * CHUNK;
            self.points.extend(drawn);
        }
        Ok(())
    }

    /// Adds one candidate on each side of every component that the uniform ones may have missed.
    pub(crate) fn draw_on_small_components(&mut self, components: &Components) {
        let sides = components.small_sides(self.sampler, self.n_drawn, ENOUGH, usize::MAX);
        let source = Source { regions: self.regions, stream: Stream::new(self.seed, Stage::Candidates), dimension: 1 };
        let first = self.points.len();
        for start in (0..sides.len()).step_by(TASKS * CHUNK) {
            let ids = start..sides.len().min(start + TASKS * CHUNK);
            self.points.extend(source.draw_on(self.scene, self.caster, &sides, ids));
        }
        self.extra = first..self.points.len();
        self.n_other += sides.len();
    }

    /// Reachable points that are not candidates.
    pub(crate) fn fresh(&mut self, n: usize, round: u32) -> Vec<OrientedPoint> {
        let stream = (self.seed, Stage::Coverage, round);
        let (points, drawn) = random_points(self.scene, self.caster, self.regions, self.sampler, stream, n);
        self.n_other += drawn;
        points
    }

    pub(crate) fn points(&self) -> &[OrientedPoint] {
        &self.points
    }

    /// Whether point `i` is part of the uniform sample of the reachable area.
    pub(crate) fn is_uniform(&self, i: usize) -> bool {
        !self.extra.contains(&i)
    }

    pub(crate) fn n_drawn(&self) -> u64 {
        self.n_drawn as u64
    }

    /// About three rays for each.
    pub(crate) fn n_rays(&self) -> u64 {
        3 * (self.n_drawn + self.n_other) as u64
    }

    /// The share of the sides that reflect, by area, that light reaches.
    pub(crate) fn reachable_fraction(&self) -> f64 {
        (self.points.len() - self.extra.len()) as f64 / self.n_drawn.max(1) as f64
    }

    /// Scene units squared.
    pub(crate) fn reachable_area(&self) -> f64 {
        self.reachable_fraction() * self.sampler.area()
    }
}

/// `n` reachable points of the stream `(seed, stage, dimension)`, or fewer where hardly anything is reachable, and the
/// number of draws that it took.
pub(crate) fn random_points(
    scene: &Scene,
    caster: &dyn RayCaster,
    regions: &Regions,
    sampler: &SideSampler,
    (seed, stage, dimension): (u64, Stage, u32),
    n: usize,
) -> (Vec<OrientedPoint>, usize) {
    let source = Source { regions, stream: Stream::new(seed, stage), dimension };
    let (mut points, mut drawn) = (Vec::new(), 0);
    if regions.n_regions() == 0 || n == 0 {
        return (points, drawn);
    }
    let mut last_id = 0;
    while points.len() < n && drawn < n * MAX_DRAWS_PER_POINT {
        let share = regions.lit_share().clamp(0.01, 1.0);
        let missing = ((n - points.len()) as f64 / share).ceil() as usize;
        let batch = missing.div_ceil(CHUNK).clamp(1, TASKS) * CHUNK;
        for (id, point) in source.draw_with_ids(scene, caster, sampler, drawn..drawn + batch) {
            if points.len() < n {
                points.push(point);
                last_id = id + 1;
            }
        }
        drawn += batch;
    }
    // Draws after the last point that was taken do not count.
    let drawn = if points.len() == n { last_id } else { drawn };
    (points, drawn)
}

/// Where points come from.
struct Source<'a> {
    regions: &'a Regions,
    stream: Stream,
    dimension: u32,
}

impl Source<'_> {
    fn draw(
        &self,
        scene: &Scene,
        caster: &dyn RayCaster,
        sampler: &SideSampler,
        ids: std::ops::Range<usize>,
    ) -> Vec<OrientedPoint> {
        self.draw_with_ids(scene, caster, sampler, ids).into_iter().map(|(_, point)| point).collect()
    }

    /// Draw number and point, for those that are reachable.
    fn draw_with_ids(
        &self,
        scene: &Scene,
        caster: &dyn RayCaster,
        sampler: &SideSampler,
        ids: std::ops::Range<usize>,
    ) -> Vec<(usize, OrientedPoint)> {
        let chunks = parallel::map(
            ids.len().div_ceil(CHUNK),
            || (),
            |(), chunk| {
                let first = ids.start + chunk * CHUNK;
                let draw = |id: usize| {
                    let point =
                        sampler.sample(scene, self.stream.words(id as u32, (id >> 32) as u32, self.dimension))?;
                    Some((id, self.reachable(scene, caster, &point)?))
                };
                (first..ids.end.min(first + CHUNK)).filter_map(draw).collect::<Vec<_>>()
            },
        );
        chunks.concat()
    }

    /// One point on each of `sides[ids]`, where reachable.
    fn draw_on(
        &self,
        scene: &Scene,
        caster: &dyn RayCaster,
        sides: &[Side],
        ids: std::ops::Range<usize>,
    ) -> Vec<OrientedPoint> {
        let points = parallel::map(
            ids.len(),
            || (),
            |(), k| {
                let i = ids.start + k;
                let words = self.stream.words(i as u32, 0, self.dimension);
                self.reachable(scene, caster, &point_on(scene, sides[i], words[0], words[1])?)
            },
        );
        points.into_iter().flatten().collect()
    }

    fn reachable(&self, scene: &Scene, caster: &dyn RayCaster, point: &SidePoint) -> Option<OrientedPoint> {
        let SidePoint { position, normal, .. } = *point;
        let region = self.regions.locate_one(scene, caster, Oriented { position, normal }, Doubt::LITTLE);
        let is_reachable = region != RegionId::DARK && point.is_exposed(caster);
        is_reachable.then(|| {
            let extent = Extent::of_query(free_height(caster, position, normal));
            OrientedPoint { extent, ..OrientedPoint::new(position, normal, region) }
        })
    }
}
