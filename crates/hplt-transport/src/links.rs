use glam::DVec3;
use hplt_basis::{
    Absolute, BasisOptions, Coefficients, Coverage, Layered, LayeredScratch, Reconstruction, ShepardBasis, Weight,
};
use hplt_geom::{Interrupted, LightGroupId, OrientedPoint, PointHierarchy, Progress, RayCaster, Rgb, Scene, parallel};
use hplt_sampling::random::Stage;
use hplt_sampling::refined_level;

use crate::gather::{Counter, Groups};
use crate::paths::{Arrival, PathBuffers, PathSink, PathTracer};
use crate::sight::{OpenAir, nearest_in_sight};
use crate::solve::{SolveOptions, SolveReport, System, solve};
use crate::{
    Detail, DirectLight, Error, GroupLight, Oracle, SparseRows, Threshold, direct_irradiance,
    direct_irradiance_by_group,
};

/// More functions may not be refined: the candidates around them are numbered in 32 bits.
const MAX_FUNCTIONS: usize = 1 << 25;

/// What a link holds of the function that a ray met.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LinkPrecision {
    /// The nearest function: one entry per ray.
    #[default]
    Nearest,
    /// All functions around, with their weights: about ten entries per ray.
    Shepard,
}

/// How to link.
#[derive(Debug, Clone, PartialEq)]
pub struct LinkOptions {
    /// Seed of all rays and points.
    pub seed: u64,
    /// Rays per gather; a power of two.
    pub n_rays: u32,
    /// Levels at most.
    pub n_levels: usize,
    /// Where finer functions are made.
    pub threshold: Threshold,
    /// Precision of the links.
    pub precision: LinkPrecision,
    /// Whether a short ray decides if the function that a link would read is in sight. Without it the function's own extent does.
    pub has_sight_rays: bool,
    /// No level is added beyond this many functions; 2²⁵ at most.
    pub max_functions: usize,
    /// How the system is solved.
    pub solve: SolveOptions,
    /// Whether the light of each group of lights is kept apart, for [`Relighting`](crate::Relighting). No ray more is traced.
    pub by_group: bool,
}

impl LinkOptions {
    /// A quick look: a few per cent of error.
    pub fn preview() -> Self {
        Self {
            n_rays: 128,
            n_levels: 3,
            threshold: Threshold { absolute: 0.0, relative: 0.2, noise: 2.0 },
            ..Self::production()
        }
    }

    /// For results that are kept.
    pub fn production() -> Self {
        Self {
            seed: 0,
            n_rays: 512,
            n_levels: 4,
            threshold: Threshold { absolute: 0.0, relative: 0.05, noise: 2.0 },
            precision: LinkPrecision::Nearest,
            has_sight_rays: true,
            max_functions: 4_000_000,
            solve: SolveOptions::default(),
            by_group: false,
        }
    }

    fn check(&self) -> Result<(), Error> {
        let fail = |name, value, expected| Err(Error::Option { name, value, expected });
        if !self.n_rays.is_power_of_two() || self.n_rays < 8 || self.n_rays > 1 << 16 {
            return fail("n_rays", self.n_rays.into(), "a power of two in [8, 65536]");
        }
        if self.n_levels == 0 {
            return fail("n_levels", 0.0, "1 or more");
        }
        if !(1..=MAX_FUNCTIONS).contains(&self.max_functions) {
            return fail("max_functions", self.max_functions as f64, "1 to 2^25");
        }
        self.threshold.check()
    }
}

/// A hierarchy with the light on it, and the links that carried it.
#[derive(Debug)]
pub struct Linked {
    /// The function space: finer levels only where they are needed. Read it with [`Layered`].
    pub basis: ShepardBasis,
    /// Direct irradiance at the functions, W/m².
    pub direct: Coefficients<Absolute>,
    /// Indirect irradiance at the functions, all bounces, W/m².
    pub indirect: Coefficients<Absolute>,
    /// The standard error of the indirect irradiance at each function by its own rays, from replicate groups of them, W/m². An
    /// overestimate, as those groups are noisier than their share of all.
    pub noise: Coefficients<Absolute>,
    /// The part of it that arrives by one bounce, by flat index, W/m²: the right-hand side.
    pub first_bounce: Vec<Rgb>,
    /// The transport operator on flat indices.
    pub links: SparseRows,
    /// Direct and once reflected light by group of lights; empty unless [`LinkOptions::by_group`].
    pub groups: Vec<GroupLight>,
    /// What it took.
    pub report: LinkReport,
}

/// What linking did.
#[derive(Debug, Clone)]
pub struct LinkReport {
    /// Per level, coarsest first.
    pub levels: Vec<LinkedLevel>,
    /// Rays of gathers, and as many shadow rays at most per light.
    pub rays: u64,
    /// Gather rays that left the scene.
    pub escaped: u64,
    /// How hits were linked.
    pub coverage: Coverage,
    /// Entries of the operator.
    pub n_links: u64,
    /// Bytes of the operator.
    pub memory: usize,
    /// The last solve.
    pub solve: SolveReport,
    /// Whether it was interrupted before all levels were made.
    pub is_cut_short: bool,
}

/// One level.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkedLevel {
    /// Functions, all gathered.
    pub functions: u64,
    /// Those around which the next level continues.
    pub refined: u64,
    /// Seconds of placing, gathering and solving on the caller's clock.
    pub seconds: f64,
}

/// All bounces at once on functions that exist only where they are needed.
///
/// ```text
/// f = d + G f        d_i = (1/N) Σ_k ρ(y_k) E_direct(y_k)      G_ij = (1/N) Σ_k ρ(y_k) B_j(y_k)
/// ```
///
/// The unknowns `f` are the *indirect* irradiance at the functions. Direct light is sampled where rays land, so that no function
/// has to resolve a shadow edge, and what is left is smooth. Every receiver's rays are traced once and kept as a row of `G`.
/// A ray that meets surface which no function is in sight of goes on to the next. Level after level: place functions around those that `options.threshold` refines, gather, link, solve. The coarsest level
/// of `hierarchy` is where it begins; finer ones of it are not read.
///
/// # Errors
/// When an option is out of range, a closed region has albedo 1, a value is not finite, or the caller interrupts before the first
/// solve; later interruptions keep the levels that are finished.
pub fn transport_links(
    scene: &Scene,
    caster: &dyn RayCaster,
    mut hierarchy: PointHierarchy,
    light: &DirectLight<'_>,
    options: &LinkOptions,
    progress: &dyn Progress,
) -> Result<Linked, Error> {
    options.check()?;
    hierarchy.levels.truncate(1);
    let n_regions = hierarchy.n_regions as usize;
    let mut linker = Linker {
        scene,
        caster,
        light,
        options,
        // One group alone is all the light.
        n_groups: if options.by_group && light.groups().len() > 1 { light.groups().len() } else { 0 },
        progress,
        n_regions,
        basis: ShepardBasis::build(hierarchy, BasisOptions::default()),
        state: State::default(),
        levels: Vec::new(),
    };
    linker.begin()?;
    let mut is_cut_short = false;
    while let Some(refined) = linker.choose_refined() {
        match linker.add_level(refined) {
            Ok(()) => {}
            Err(Error::Interrupted(_)) => {
                is_cut_short = true;
                break;
            }
            Err(error) => return Err(error),
        }
    }
    linker.finish(is_cut_short)
}

/// What is known of the unknowns, by flat index.
#[derive(Debug, Default)]
struct State {
    rows: Vec<Vec<(u32, Rgb)>>,
    first_bounce: Vec<Rgb>,
    noise: Vec<Rgb>,
    direct: Vec<Rgb>,
    /// First bounce and direct light of each group that is kept apart.
    groups: Vec<[Vec<Rgb>; 2]>,
    indirect: Vec<Rgb>,
    escaped: u64,
    coverage: Coverage,
    solve: Option<SolveReport>,
}

/// What a level changes before it is solved, but for what it adds at the end of every list.
#[derive(Debug, Clone, Copy)]
struct Mark {
    n_functions: usize,
    escaped: u64,
    coverage: Coverage,
}

impl State {
    fn mark(&self) -> Mark {
        Mark { n_functions: self.rows.len(), escaped: self.escaped, coverage: self.coverage }
    }

    /// Forgets a level that was not solved. Indirect light is that of the last solve, so it needs nothing.
    fn return_to(&mut self, mark: Mark) {
        let n = mark.n_functions;
        self.rows.truncate(n);
        [&mut self.first_bounce, &mut self.noise, &mut self.direct].into_iter().for_each(|list| list.truncate(n));
        self.groups.iter_mut().flatten().for_each(|list| list.truncate(n));
        (self.escaped, self.coverage) = (mark.escaped, mark.coverage);
    }
}

struct Linker<'a> {
    scene: &'a Scene,
    caster: &'a dyn RayCaster,
    light: &'a DirectLight<'a>,
    options: &'a LinkOptions,
    progress: &'a dyn Progress,
    n_regions: usize,
    /// Groups of lights that are kept apart.
    n_groups: usize,
    basis: ShepardBasis,
    state: State,
    levels: Vec<LinkedLevel>,
}

/// What one receiver's rays found.
struct Row {
    links: Vec<(u32, Rgb)>,
    first_bounce: Rgb,
    /// The same by group of lights.
    by_group: Vec<Rgb>,
    noise: Rgb,
    escaped: u32,
    coverage: Coverage,
}

#[derive(Default)]
struct LinkScratch {
    paths: PathBuffers,
    row: RowAccumulator,
    expansion: Vec<Weight>,
    layered: LayeredScratch,
}

impl Linker<'_> {
    /// The two coarsest levels, which are everywhere: without the second nothing is known about the error of the first.
    fn begin(&mut self) -> Result<(), Error> {
        let started = self.progress.now();
        let n = self.basis.n_functions(0);
        if self.options.n_levels == 1 || n == 0 || n >= self.options.max_functions {
            self.gather(0)?;
            self.solve()?;
            return self.enter_level(0, started);
        }
        let everywhere = vec![true; n];
        self.push_level(everywhere)?;
        self.gather(0)?;
        self.gather(1)?;
        self.solve()?;
        self.enter_level(0, started)?;
        self.enter_level(1, self.progress.now())
    }

    fn enter_level(&mut self, level: usize, started: f64) -> Result<(), Error> {
        let flags = &self.basis.hierarchy().levels[level].is_refined;
        let refined = flags.iter().filter(|&&r| r).count() as u64;
        let functions = self.basis.n_functions(level) as u64;
        self.levels.push(LinkedLevel { functions, refined, seconds: self.progress.now() - started });
        Ok(())
    }

    fn push_level(&mut self, is_refined: Vec<bool>) -> Result<(), Interrupted> {
        let finest = self.basis.n_levels() - 1;
        let coarse = &self.basis.hierarchy().levels[finest];
        let id = (finest as u32 + 1, self.options.seed);
        let level = refined_level(self.scene, self.caster, coarse, &is_refined, id, self.progress)?;
        self.basis.push_level(level, is_refined);
        Ok(())
    }

    /// Which functions of the finest level are to be refined; `None` when none, or when there may be no more levels.
    fn choose_refined(&self) -> Option<Vec<bool>> {
        let level = self.basis.n_levels() - 1;
        let n_functions = self.basis.hierarchy().n_points();
        if level == 0 || level + 1 >= self.options.n_levels || n_functions >= self.options.max_functions {
            return None;
        }
        let field = self.coefficients(&self.state.indirect);
        let points = self.basis.points(level);
        let mut inherited = vec![Rgb::ZERO; points.len()];
        Layered.reconstruct(&self.basis, &field, level, points, &mut inherited);
        let means = self.region_means();
        let first = self.basis.flat_index(level, 0) as usize;
        let is_refined = |i: usize| {
            let indirect = self.state.indirect[first + i];
            self.options.threshold.refine(&Detail {
                level,
                detail: indirect - inherited[i],
                noise: self.state.noise[first + i],
                total: self.state.direct[first + i] + indirect,
                mean: means[points[i].region.0 as usize],
            })
        };
        let chosen: Vec<u32> = (0..points.len() as u32).filter(|&i| is_refined(i as usize)).collect();
        (!chosen.is_empty()).then(|| self.with_neighbours(level, &chosen))
    }

    /// Flags for the `chosen` functions of `level` and for those whose supports hold the centre of one: what is wrong at a
    /// point is wrong with all that say something there.
    fn with_neighbours(&self, level: usize, chosen: &[u32]) -> Vec<bool> {
        let points = self.basis.points(level);
        let mut flags = vec![false; points.len()];
        let mut weights = Vec::new();
        for &i in chosen {
            flags[i as usize] = true;
            self.basis.raw_weights(level, &points[i as usize], &mut weights);
            weights.iter().for_each(|w| flags[w.function as usize] = true);
        }
        flags
    }

    fn add_level(&mut self, refined: Vec<bool>) -> Result<(), Error> {
        let started = self.progress.now();
        let before = self.state.mark();
        let n_levels = self.basis.n_levels();
        let added = self.push_level(refined).map_err(Error::from);
        let done = added.and_then(|()| self.gather(n_levels)).and_then(|()| self.solve());
        if done.is_err() {
            self.state.return_to(before);
            self.basis.truncate(n_levels);
            return done;
        }
        self.levels[n_levels - 1].refined =
            self.basis.hierarchy().levels[n_levels - 1].is_refined.iter().filter(|&&r| r).count() as u64;
        self.enter_level(n_levels, started)
    }

    /// Gathers all functions of a level.
    fn gather(&mut self, level: usize) -> Result<(), Error> {
        let first = self.basis.flat_index(level, 0);
        self.gather_direct(level)?;
        let points = self.basis.points(level);
        let counter = Counter::new(self.progress, "links", points.len());
        let tracer = PathTracer {
            scene: self.scene,
            caster: self.caster,
            light: self.light,
            seed: self.options.seed,
            stage: Stage::Gather,
            rays: 0..self.options.n_rays,
            is_roulette: false,
            largest_support: self.basis.support(self.basis.coarsest_read(self.basis.n_levels())),
        };
        let rows = parallel::try_map(points.len(), LinkScratch::default, |scratch, i| {
            counter.step()?;
            Ok::<_, Interrupted>(self.row(&tracer, &points[i], first + i as u32, scratch))
        })?;
        for row in rows {
            self.state.rows.push(row.links);
            self.state.first_bounce.push(row.first_bounce);
            self.state.groups.iter_mut().zip(row.by_group).for_each(|(group, e)| group[0].push(e));
            self.state.noise.push(row.noise);
            self.state.escaped += u64::from(row.escaped);
            self.state.coverage += row.coverage;
        }
        Ok(())
    }

    fn gather_direct(&mut self, level: usize) -> Result<(), Interrupted> {
        let points = self.basis.points(level);
        let (light, caster, progress) = (self.light, self.caster, self.progress);
        if self.n_groups == 0 {
            self.state.direct.extend(direct_irradiance(light, caster, points, Stage::Direct, progress)?);
            return Ok(());
        }
        let (sum, by_group) = direct_irradiance_by_group(light, caster, points, Stage::Direct, progress)?;
        self.state.direct.extend(sum);
        self.state.groups.resize(self.n_groups, Default::default());
        self.state.groups.iter_mut().zip(by_group).for_each(|(group, direct)| group[1].extend(direct));
        Ok(())
    }

    fn row(&self, tracer: &PathTracer<'_>, receiver: &OrientedPoint, id: u32, scratch: &mut LinkScratch) -> Row {
        let LinkScratch { paths, row, expansion, layered } = scratch;
        row.begin(self.basis.hierarchy().n_points());
        let groups = Groups::new(self.options.n_rays);
        let mut sink = RowSink {
            linker: self,
            row,
            expansion,
            layered,
            groups,
            first_bounce: DVec3::ZERO,
            by_group: vec![DVec3::ZERO; self.n_groups],
            coverage: Coverage::default(),
        };
        let escaped = tracer.trace(receiver, id, paths, &mut sink);
        let RowSink { groups, first_bounce, by_group, coverage, .. } = sink;
        let mean = |sum: DVec3| (sum / f64::from(self.options.n_rays)).as_vec3();
        Row {
            links: scratch.row.finish(),
            first_bounce: mean(first_bounce),
            by_group: by_group.into_iter().map(mean).collect(),
            noise: groups.mean_and_noise().1,
            escaped,
            coverage,
        }
    }

    fn solve(&mut self) -> Result<(), Error> {
        let operator = self.operator();
        let system = System::of(self.basis.hierarchy());
        let (indirect, report) =
            solve(&operator, &self.state.first_bounce, &system.unknowns(), &self.options.solve, self.progress)?;
        self.state.indirect = indirect;
        self.state.solve = Some(report);
        Ok(())
    }

    fn operator(&self) -> SparseRows {
        let n_entries = self.state.rows.iter().map(Vec::len).sum();
        let mut operator = SparseRows::new(self.state.rows.len());
        operator.reserve(self.state.rows.len(), n_entries);
        self.state.rows.iter().for_each(|row| operator.push_row(row));
        operator
    }

    /// Area-weighted means of the irradiance on the coarsest level, by region.
    fn region_means(&self) -> Vec<Rgb> {
        let mut sums = vec![(DVec3::ZERO, 0.0f64); self.n_regions];
        for (i, point) in self.basis.points(0).iter().enumerate() {
            let area = f64::from(point.area.max(f32::MIN_POSITIVE));
            let (sum, total) = &mut sums[point.region.0 as usize];
            *sum += (self.state.direct[i] + self.state.indirect[i]).as_dvec3() * area;
            *total += area;
        }
        sums.into_iter().map(|(sum, total)| if total > 0.0 { (sum / total).as_vec3() } else { Rgb::ZERO }).collect()
    }

    fn coefficients(&self, flat: &[Rgb]) -> Coefficients<Absolute> {
        let mut rest = flat;
        let take = |level| {
            let (now, later) = rest.split_at(self.basis.n_functions(level));
            rest = later;
            now.to_vec()
        };
        Coefficients::from_levels((0..self.basis.n_levels()).map(take).collect())
    }

    fn finish(self, is_cut_short: bool) -> Result<Linked, Error> {
        let links = self.operator();
        let (direct, indirect) = (self.coefficients(&self.state.direct), self.coefficients(&self.state.indirect));
        let (groups, noise) = (self.groups(), self.coefficients(&self.state.noise));
        let Self { basis, state, levels, options, .. } = self;
        let report = LinkReport {
            levels,
            rays: links.n_rows() as u64 * u64::from(options.n_rays),
            escaped: state.escaped,
            coverage: state.coverage,
            n_links: links.n_entries() as u64,
            memory: links.memory(),
            solve: state.solve.expect("solved at least once"),
            is_cut_short,
        };
        Ok(Linked { basis, direct, indirect, noise, first_bounce: state.first_bounce, links, groups, report })
    }

    fn groups(&self) -> Vec<GroupLight> {
        let names = self.light.groups().names();
        if !self.options.by_group || names.is_empty() {
            return Vec::new();
        }
        let group = |name: &String, [first_bounce, direct]: [&Vec<Rgb>; 2]| GroupLight {
            name: name.clone(),
            direct: direct.clone(),
            first_bounce: first_bounce.clone(),
            solved: None,
        };
        match &self.state.groups[..] {
            [] => vec![group(&names[0], [&self.state.first_bounce, &self.state.direct])],
            groups => names.iter().zip(groups).map(|(name, [b, d])| group(name, [b, d])).collect(),
        }
    }
}

/// What the paths of one receiver find becomes its row.
struct RowSink<'a> {
    linker: &'a Linker<'a>,
    row: &'a mut RowAccumulator,
    expansion: &'a mut Vec<Weight>,
    layered: &'a mut LayeredScratch,
    groups: Groups,
    first_bounce: DVec3,
    /// The same by group of lights that is kept apart.
    by_group: Vec<DVec3>,
    coverage: Coverage,
}

impl PathSink for RowSink<'_> {
    fn add_direct(&mut self, ray: u32, irradiance: Rgb) {
        self.first_bounce += irradiance.as_dvec3();
        self.groups.add(ray, irradiance);
    }

    fn wants_groups(&self) -> bool {
        !self.by_group.is_empty()
    }

    fn add_direct_of(&mut self, group: LightGroupId, irradiance: Rgb) {
        self.by_group[group.0 as usize] += irradiance.as_dvec3();
    }

    fn read<'a>(&mut self, arrivals: &'a [Arrival], points: &[OrientedPoint], mut go_on: impl FnMut(&'a Arrival)) {
        let Linker { basis, options, state, .. } = self.linker;
        let n_levels = basis.n_levels();
        let sight: &dyn RayCaster = if options.has_sight_rays { self.linker.caster } else { &OpenAir };
        let found = nearest_in_sight(basis, sight, n_levels, points);
        for (arrival, good) in arrivals.iter().zip(found) {
            if good.is_none() && !arrival.is_last {
                go_on(arrival);
                continue;
            }
            match good {
                Some((level, i)) if options.precision == LinkPrecision::Nearest => {
                    self.expansion.clear();
                    self.expansion.push(Weight { function: basis.flat_index(level, i), weight: 1.0 });
                    self.coverage.queries += 1;
                }
                _ => {
                    basis.expand(n_levels, std::slice::from_ref(&arrival.point), self.layered, |_, expansion, found| {
                        self.expansion.clone_from(expansion);
                        self.coverage += found;
                    })
                }
            }
            let mut indirect = Rgb::ZERO;
            for w in &*self.expansion {
                self.row.add(w.function, arrival.throughput * (w.weight / options.n_rays as f32));
                let known = state.indirect.get(w.function as usize).copied().unwrap_or(Rgb::ZERO);
                indirect += known * w.weight;
            }
            self.groups.add(arrival.ray, arrival.throughput * indirect);
        }
    }
}

/// Adds up the links of one receiver by function.
#[derive(Default)]
struct RowAccumulator {
    /// By function; zero but for those in `touched`.
    sums: Vec<Rgb>,
    is_touched: Vec<bool>,
    touched: Vec<u32>,
}

impl RowAccumulator {
    fn begin(&mut self, n: usize) {
        self.sums.resize(n, Rgb::ZERO);
        self.is_touched.resize(n, false);
    }

    fn add(&mut self, function: u32, weight: Rgb) {
        let i = function as usize;
        if !std::mem::replace(&mut self.is_touched[i], true) {
            self.touched.push(function);
        }
        self.sums[i] += weight;
    }

    /// The row in ascending order; empty again afterwards.
    fn finish(&mut self) -> Vec<(u32, Rgb)> {
        self.touched.sort_unstable();
        let row = self.touched.iter().map(|&i| (i, std::mem::take(&mut self.sums[i as usize]))).collect();
        self.touched.iter().for_each(|&i| self.is_touched[i as usize] = false);
        self.touched.clear();
        row
    }
}
