use glam::Vec3;
use hplt_basis::{Footprint, ShepardBasis};
use hplt_geom::{Interrupted, OrientedPoint, Progress, RegionId, Rgb, parallel};

use crate::counter::Counter;
use crate::{GBuffer, PixelRect, Projection, SplatReport, Splatted};

/// Pixels along the side of a tile.
const TILE: u32 = 16;

/// The functions of one level that are to be drawn, sorted into tiles by the rectangles around their supports.
pub(crate) struct Bins<'a> {
    pub level: usize,
    pub footprint: Footprint,
    pub points: &'a [OrientedPoint],
    functions: &'a [u32],
    rects: Vec<Option<PixelRect>>,
    /// Positions in `functions`, ascending within every tile.
    entries: Vec<u32>,
    offsets: Vec<u32>,
}

impl<'a> Bins<'a> {
    /// Sorts the `functions` (ascending) of `level` into tiles.
    pub fn new(basis: &'a ShepardBasis, level: usize, functions: &'a [u32], projection: &Projection) -> Self {
        let (footprint, points) = (basis.footprint(level), basis.points(level));
        let rect = |(): &mut (), i: usize| {
            projection.sphere_bounds(points[functions[i] as usize].position, footprint.support())
        };
        let rects = parallel::map(functions.len(), || (), rect);
        let raster = Raster::of(projection);
        let mut offsets = vec![0u32; raster.n_tiles() + 1];
        for rect in rects.iter().flatten() {
            raster.tiles_in(rect).for_each(|tile| offsets[tile + 1] += 1);
        }
        for tile in 0..raster.n_tiles() {
            offsets[tile + 1] += offsets[tile];
        }
        let mut next = offsets.clone();
        let mut entries = vec![0; offsets[raster.n_tiles()] as usize];
        for (i, rect) in rects.iter().enumerate() {
            for tile in rect.iter().flat_map(|rect| raster.tiles_in(rect)) {
                entries[next[tile] as usize] = i as u32;
                next[tile] += 1;
            }
        }
        Self { level, footprint, points, functions, rects, entries, offsets }
    }

    fn count_into(&self, report: &mut SplatReport) {
        report.functions += self.functions.len() as u64;
        report.visible += self.rects.iter().flatten().count() as u64;
    }

    fn in_tile(&self, tile: usize) -> &[u32] {
        &self.entries[self.offsets[tile] as usize..self.offsets[tile + 1] as usize]
    }
}

/// The samples of one tile and the box around them.
#[derive(Default)]
pub(crate) struct Tile {
    index: usize,
    rect: Option<PixelRect>,
    /// Row by row, the samples of a pixel together.
    pub queries: Vec<OrientedPoint>,
    min: Vec3,
    max: Vec3,
    /// The first query of every pixel, row by row, and the end of all.
    firsts: Vec<usize>,
    pub report: SplatReport,
}

impl Tile {
    fn fill(&mut self, gbuffer: &GBuffer, raster: Raster, index: usize) {
        let rect = raster.rect(index);
        self.queries.clear();
        self.firsts.clear();
        for row in rect.min[1]..rect.max[1] {
            for pixel in row_pixels(gbuffer, &rect, row) {
                self.firsts.push(self.queries.len());
                self.queries.extend(gbuffer.samples_of(pixel).map(|i| gbuffer.query(i)));
            }
        }
        self.firsts.push(self.queries.len());
        (self.index, self.rect) = (index, Some(rect));
        (self.min, self.max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        self.report = SplatReport::default();
        self.report.coverage.queries = self.queries.len() as u64;
        for query in self.queries.iter().filter(|q| q.region != RegionId::DARK) {
            self.min = self.min.min(query.position);
            self.max = self.max.max(query.position);
        }
    }

    /// Calls `blend(sample, i, weight)` for every positive weight of every function, `i` being its position in
    /// `bins.functions`: functions ascending, and within each the samples ascending. What a GPU's rasteriser and blending
    /// do.
    pub fn draw(&mut self, bins: &Bins<'_>, mut blend: impl FnMut(usize, usize, f32)) {
        let Some(tile) = self.rect else { return };
        let support_squared = bins.footprint.support() * bins.footprint.support();
        let columns = (tile.max[0] - tile.min[0]) as usize;
        for &entry in bins.in_tile(self.index) {
            let function = &bins.points[bins.functions[entry as usize] as usize];
            // As a hierarchical depth test: nothing in this tile is near the function.
            let outside = function.position - function.position.clamp(self.min, self.max);
            if outside.length_squared() > support_squared {
                continue;
            }
            let Some(rect) = bins.rects[entry as usize].as_ref().and_then(|r| r.intersection(&tile)) else { continue };
            self.report.tiles += 1;
            for row in rect.min[1]..rect.max[1] {
                let first = (row - tile.min[1]) as usize * columns + (rect.min[0] - tile.min[0]) as usize;
                let last = first + (rect.max[0] - rect.min[0]) as usize;
                self.report.weights += (self.firsts[last] - self.firsts[first]) as u64;
                for sample in self.firsts[first]..self.firsts[last] {
                    let query = &self.queries[sample];
                    if (query.position - function.position).length_squared() > support_squared {
                        continue;
                    }
                    let weight = bins.footprint.weight(function, query);
                    if weight > 0.0 {
                        self.report.covered += 1;
                        blend(sample, entry as usize, weight);
                    }
                }
            }
        }
    }
}

/// Runs `shade(scratch, tile)` on every tile in parallel; it returns the irradiance of the tile's samples in order. Dark
/// samples become zero.
pub(crate) fn for_each_tile<S>(
    gbuffer: &GBuffer,
    bins: &[Bins<'_>],
    progress: &dyn Progress,
    scratch: impl Fn() -> S + Sync + Send,
    shade: impl Fn(&mut S, &mut Tile) -> Vec<Rgb> + Sync + Send,
) -> Result<Splatted, Interrupted> {
    let raster = Raster::of(gbuffer.projection());
    let counter = Counter::new(progress, "splat", raster.n_tiles());
    let tiles = parallel::try_map(
        raster.n_tiles(),
        || (scratch(), Tile::default()),
        |(scratch, tile), index| {
            counter.step()?;
            tile.fill(gbuffer, raster, index);
            let values = shade(scratch, tile);
            Ok((values, tile.report))
        },
    )?;
    let mut irradiance = vec![Rgb::ZERO; gbuffer.n_samples()];
    let mut report = SplatReport { surface_samples: gbuffer.n_surface_samples() as u64, ..SplatReport::default() };
    bins.iter().for_each(|b| b.count_into(&mut report));
    for (index, (values, part)) in tiles.into_iter().enumerate() {
        let rect = raster.rect(index);
        let mut values = values.into_iter();
        for row in rect.min[1]..rect.max[1] {
            let pixels = row_pixels(gbuffer, &rect, row);
            let samples = gbuffer.samples_of(pixels.start).start..gbuffer.samples_of(pixels.end - 1).end;
            irradiance[samples].iter_mut().zip(values.by_ref()).for_each(|(out, value)| *out = value);
        }
        report += part;
    }
    Ok(Splatted { irradiance, report })
}

/// The pixels of `rect`, which is not empty, in a row.
fn row_pixels(gbuffer: &GBuffer, rect: &PixelRect, row: u32) -> std::ops::Range<usize> {
    let start = row as usize * gbuffer.width();
    start + rect.min[0] as usize..start + rect.max[0] as usize
}

/// A picture cut into tiles, row by row.
#[derive(Clone, Copy)]
struct Raster {
    width: u32,
    height: u32,
    columns: u32,
    rows: u32,
}

impl Raster {
    fn of(projection: &Projection) -> Self {
        let (width, height) = (projection.width(), projection.height());
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    fn n_tiles(self) -> usize {
        self.columns as usize * self.rows as usize
    }

    fn rect(self, tile: usize) -> PixelRect {
        let (x, y) = (tile as u32 % self.columns * TILE, tile as u32 / self.columns * TILE);
        PixelRect { min: [x, y], max: [(x + TILE).min(self.width), (y + TILE).min(self.height)] }
    }

    fn tiles_in(self, rect: &PixelRect) -> impl Iterator<Item = usize> + use<> {
        let columns = rect.min[0] / TILE..rect.max[0].div_ceil(TILE);
        let rows = rect.min[1] / TILE..rect.max[1].div_ceil(TILE);
        rows.flat_map(move |y| columns.clone().map(move |x| y as usize * self.columns as usize + x as usize))
    }
}
