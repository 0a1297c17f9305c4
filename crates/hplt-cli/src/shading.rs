//! What a camera sees of a lit scene, and the light that arrives there: read where it changes, sampled more where there is an edge.

use hplt_geom::{Camera, OrientedPoint, Progress, Rgb};
use hplt_sampling::random::Stage;
use hplt_splat::{Arriving, Edges, GBuffer, GBufferOptions, Patches, read_where_it_changes, uneven, widened};
use hplt_transport::{DirectOptions, direct_irradiance};

use crate::exit::Failure;
use crate::indirect::{Gathered, indirect_light};
use crate::job::{Lit, Run};
use crate::sections::Display;
use crate::values::Size;

/// Surfaces in a pixel with an edge that share the shadow rays of a pixel, about.
const SURFACES_OF_AN_EDGE: u32 = 4;

/// Irradiance at the samples of a G-buffer, W/m².
pub struct Arrived {
    /// Straight from lights.
    pub direct: Vec<Rgb>,
    /// All else.
    pub indirect: Vec<Rgb>,
}

/// Looks at a lit scene, and shades what is seen.
///
/// One sample a pixel finds the edges of surfaces, textures and shadows; only there do more follow. Light is read where it changes from
/// pixel to pixel, once for each surface in a pixel, and direct light at every sample on the rim of a shadow. After an early stop all is
/// read from the field, with one sample a pixel.
///
/// # Errors
/// When stopped, and when there would be too many samples.
pub fn shade(run: &mut Run<'_>, lit: &Lit<'_>, camera: &Camera, size: Size) -> Result<(GBuffer, Arrived), Failure> {
    let settings = run.settings;
    let to_the_end = run.reporter.to_the_end();
    let progress: &dyn Progress = if lit.is_cut_short { &to_the_end } else { run.reporter };
    let samples_per_axis = if lit.is_cut_short { 1 } else { settings.samples as u32 };
    let is_everywhere = settings.every_pixel && !lit.is_cut_short;
    let (width, height) = (size.width as u32, size.height as u32);
    let options = GBufferOptions { width, height, samples_per_axis: 1, seed: settings.transport.seed };
    let looked = run.stage("g-buffer", |_| {
        let coarse = GBuffer::trace(lit.scene, &lit.bvh, camera, options, progress)?;
        let edges = Edges::of(&coarse);
        Ok((coarse, edges))
    });
    let (coarse, edges) = looked.map_err(splat_failure)?;
    let mut reader = Reader { run, lit, progress, n_read: 0, n_gathered: 0 };

    // Pixels that will be sampled anew are not read before.
    let is_left = |p: usize| coarse.is_background(p) || is_everywhere || samples_per_axis > 1 && edges.of_surface[p];
    let is_read: Vec<bool> = (0..coarse.n_pixels()).map(|p| !is_left(p)).collect();
    let of_pixels = read_where_it_changes(&coarse, &is_read, |pixels| reader.light(&coarse, pixels, 1))?;
    let rims = uneven(&coarse, &edges, &of_pixels);
    let has_edge = |p: usize| edges.of_surface[p] || edges.of_colour[p] || rims[p];
    let is_refined = |p: usize| is_everywhere || samples_per_axis > 1 && has_edge(p);
    let is_refined: Vec<bool> = (0..coarse.n_pixels()).map(is_refined).collect();
    let refined = reader.run.stage("g-buffer", |_| {
        let gbuffer = coarse.refined((lit.scene, &lit.bvh, camera), &is_refined, samples_per_axis, progress)?;
        let patches = Patches::of(&gbuffer);
        Ok((gbuffer, patches))
    });
    let (mut gbuffer, patches) = refined.map_err(splat_failure)?;
    reader.run.report.enter_memory("g-buffer", coarse.memory() + gbuffer.memory());

    let is_known = |i: &usize| is_read[patches.pixel(*i)] && patches.continues(*i, &gbuffer, &coarse);
    let (known, new): (Vec<usize>, Vec<usize>) = (0..patches.len()).partition(is_known);
    let middles: Vec<usize> = new.iter().map(|&i| patches.middle(i)).collect();
    let found = reader.light(&gbuffer, &middles, SURFACES_OF_AN_EDGE)?;
    let mut of_patches = vec![Arriving::default(); patches.len()];
    known.iter().for_each(|&i| of_patches[i] = of_pixels[patches.pixel(i)]);
    new.iter().zip(found).for_each(|(&i, found)| of_patches[i] = found);
    let of_samples = patches.spread(&of_patches, Arriving::default());
    let mut direct: Vec<Rgb> = of_samples.iter().map(|light| light.direct).collect();
    let mut indirect: Vec<Rgb> = of_samples.iter().map(|light| light.indirect).collect();

    let near_rims = widened(&coarse, &rims);
    let is_shared = |p: usize| !(is_refined[p] && (is_everywhere || near_rims[p]));
    let split: Vec<usize> = (0..patches.len()).filter(|&i| !is_shared(patches.pixel(i))).collect();
    let middles: Vec<usize> = split.iter().map(|&i| patches.middle(i)).collect();
    let mut regions = vec![None; patches.len()];
    split.iter().zip(reader.located(&gbuffer, &middles)).for_each(|(&i, point)| regions[i] = Some(point.region));
    let regions = patches.spread(&regions, None);
    let (singles, queries): (Vec<usize>, Vec<OrientedPoint>) = (0..gbuffer.n_samples())
        .filter_map(|i| Some((i, OrientedPoint { region: regions[i]?, ..gbuffer.query(i) })))
        .unzip();
    let found = reader.direct(&queries, samples_per_axis.pow(2))?;
    singles.iter().zip(found).for_each(|(&i, found)| direct[i] = found);

    if reader.is_splatted() {
        let regions = lit.regions.locate(lit.scene, &lit.bvh, &gbuffer.surface_points());
        gbuffer.set_regions(regions);
        let is_flattened = settings.display == Display::Flatten;
        let splat = |_: &Run<'_>| lit.field.splat(&lit.model(), is_flattened, &gbuffer, progress);
        indirect = reader.run.stage("indirect light of pixels", splat)?;
    }
    let Reader { run, n_read, n_gathered, .. } = reader;
    run.report.more.insert("samples".into(), gbuffer.n_samples().into());
    run.report.more.insert("patches".into(), patches.len().into());
    run.report.more.insert("read".into(), n_read.into());
    run.report.more.insert("singles".into(), singles.len().into());
    run.report.more.insert("gathered".into(), n_gathered.into());
    Ok((gbuffer, Arrived { direct, indirect }))
}

fn splat_failure(error: hplt_splat::Error) -> Failure {
    match error {
        hplt_splat::Error::Interrupted(_) => Failure::interrupted(),
        _ => Failure::usage(error.to_string()),
    }
}

/// Reads light at samples of a picture, and counts them.
struct Reader<'a, 'r, 's> {
    run: &'a mut Run<'r>,
    lit: &'a Lit<'s>,
    progress: &'a dyn Progress,
    n_read: usize,
    n_gathered: usize,
}

impl Reader<'_, '_, '_> {
    /// Whether indirect light is drawn instead of read.
    fn is_splatted(&self) -> bool {
        let display = self.run.settings.display;
        !self.lit.field.is_evaluated(display) && display != Display::FinalGather && !self.lit.is_cut_short
    }

    /// What arrives at samples, which are not background; `sharing` points share the rays of one.
    fn light(&mut self, gbuffer: &GBuffer, samples: &[usize], sharing: u32) -> Result<Vec<Arriving>, Failure> {
        let queries = self.located(gbuffer, samples);
        let direct = self.direct(&queries, sharing)?;
        let indirect = self.indirect(&queries, &direct)?;
        self.n_read += samples.len();
        let both = direct.into_iter().zip(indirect);
        Ok(both.map(|(direct, indirect)| Arriving { direct, indirect }).collect())
    }

    /// Samples as queries in their regions.
    fn located(&mut self, gbuffer: &GBuffer, samples: &[usize]) -> Vec<OrientedPoint> {
        let lit = self.lit;
        let points: Vec<_> = samples.iter().map(|&i| (gbuffer.positions()[i], gbuffer.normals()[i])).collect();
        let regions = self.run.stage("regions of pixels", |_| lit.regions.locate(lit.scene, &lit.bvh, &points));
        let query = |(&i, region)| OrientedPoint { region, ..gbuffer.query(i) };
        samples.iter().zip(regions).map(query).collect()
    }

    fn direct(&mut self, queries: &[OrientedPoint], sharing: u32) -> Result<Vec<Rgb>, Failure> {
        let (lit, progress) = (self.lit, self.progress);
        self.run.stage("direct light of pixels", |run| {
            if lit.is_cut_short {
                return Ok(lit.field.direct_at(&lit.model(), queries));
            }
            let base = run.settings.direct(DirectOptions::display());
            let sharing = sharing.next_power_of_two();
            let options = DirectOptions {
                light_samples: (base.light_samples / sharing).max(4),
                sky_samples: (base.sky_samples / sharing).max(16),
                ..base
            };
            let lights = lit.lights.with_options(options);
            Ok(direct_irradiance(&lights, &lit.bvh, queries, Stage::Shading, progress)?)
        })
    }

    /// Zero where it is drawn instead.
    fn indirect(&mut self, queries: &[OrientedPoint], direct: &[Rgb]) -> Result<Vec<Rgb>, Failure> {
        if self.is_splatted() {
            return Ok(vec![Rgb::ZERO; queries.len()]);
        }
        let (lit, settings, progress) = (self.lit, self.run.settings, self.progress);
        let how: (&Gathered<'_>, u32) = if lit.is_cut_short {
            // Nothing may take long any more.
            (&Gathered::Only(&|_| false), 0)
        } else if settings.display == Display::FinalGather {
            (&Gathered::All, settings.gather_rays)
        } else if settings.doubtful_rays == 0 {
            (&Gathered::Only(&|_| false), 0)
        } else {
            (&Gathered::Doubtful(&|_| false), settings.doubtful_rays)
        };
        let read = |_: &Run<'_>| indirect_light((lit, settings), queries, direct, how, progress);
        let found = self.run.stage("indirect light of pixels", read)?;
        self.n_gathered += found.n_gathered;
        Ok(found.irradiance)
    }
}
