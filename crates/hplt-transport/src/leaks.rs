//! What leaves through cracks: a scene that is meant to be closed and is not loses light, the more the brighter its surfaces are.

use glam::Vec3;
use hplt_geom::parallel;
use hplt_geom::{Hit, Interrupted, OrientedPoint, Progress, Ray, RayCaster, RegionId, Rgb, Scene, offset_origin};
use hplt_sampling::random::{Stage, Stream};
use hplt_sampling::{sobol, warp};

/// The fewest rays of a point.
const LEAST_RAYS: usize = 64;
/// A point from which no smaller share of its rays leaves otherwise than through cracks stands in the open, and so does one from which
/// twice as many leave in whatever way.
const FEW: f64 = 1.0 / 16.0;
/// Widest opening that may be a crack, in diagonals of the scene.
const CRACK: f32 = 1.0 / 256.0;
/// Largest angle between a ray that leaves and those beside it, radians.
const BESIDE: f32 = 1.0 / 32.0;
/// Pairs of opposite rays around one that leaves.
const PAIRS: usize = 4;
/// Both sides of a crack are equally far away, as far as slanting surface allows.
const AS_FAR: f32 = 0.8;
/// Fewer rays from a region than this tell nothing about it.
const LEAST_FROM_REGION: u64 = 1024;
/// The least share of the light lost that is worth a warning.
const MUCH: f64 = 0.01;

/// What the enclosed surface of a region of the air loses through cracks. A ray leaves through a crack where rays beside it, on opposite
/// sides, both meet surface, equally far away and near to each other: cracks up to a thousandth of the scene's diagonal are seen, none
/// above four times that. Surface is enclosed from which less than a sixteenth of the rays leave by wider openings.
///
/// Not seen are wider openings, which may be windows, and cracks that lead to other surface instead of out of the scene. Openings
/// that are meant to be as narrow, as in a fine grating, are taken for cracks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leak {
    /// Where.
    pub region: RegionId,
    /// Points of the region that are enclosed.
    pub points: u64,
    /// Rays cast from there.
    pub rays: u64,
    /// How many of them left the scene.
    pub escaped: u64,
    /// How many of these left through cracks.
    pub through_cracks: u64,
    /// The mean albedo of what rays met, 0 for those that left, as seen from where rays leave through cracks; 0 where none do.
    pub returned: Rgb,
}

impl Leak {
    /// The share of the rays that leave through cracks.
    pub fn share(&self) -> f64 {
        self.through_cracks as f64 / self.rays.max(1) as f64
    }

    /// The share of the light that is lost by that, `leak/(1-ρ)`: light that is reflected often passes the cracks as often. Of the
    /// channel that is reflected most.
    pub fn lost(&self) -> f64 {
        (self.share() / (1.0 - f64::from(self.returned.max_element())).max(1e-9)).min(1.0)
    }

    /// Whether more than a hundredth of the light is lost, in a region large enough to tell.
    pub fn is_serious(&self) -> bool {
        self.rays >= LEAST_FROM_REGION && self.lost() > MUCH
    }
}

/// What leaves through cracks, region by region, of about `n_rays` rays from some or all of `points`, which are taken to be spread
/// evenly over the surface, as those of a level of functions are; empty where nothing is enclosed.
///
/// # Errors
/// When interrupted.
pub fn leaks(
    scene: &Scene,
    caster: &dyn RayCaster,
    points: &[OrientedPoint],
    n_rays: usize,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Vec<Leak>, Interrupted> {
    let stride = points.len().div_ceil((n_rays / LEAST_RAYS).max(1)).max(1);
    let n_points = points.len().div_ceil(stride);
    let rays_per_point = (n_rays / n_points.max(1)).max(LEAST_RAYS);
    let stream = Stream::new(seed, Stage::Probe);
    let leak = |(rays, occluded): &mut (Vec<Ray>, Vec<bool>), i: usize| {
        progress.check()?;
        let point = &points[i * stride];
        let origin = offset_origin(point.position, point.normal);
        let scramble = stream.word(i as u32, 0, 8);
        let ray = |k| Ray::new(origin, warp::cosine_hemisphere(sobol::sobol_2d(k, scramble, 0), point.normal));
        rays.clear();
        rays.extend((0..rays_per_point as u32).map(ray));
        occluded.clear();
        occluded.resize(rays.len(), false);
        caster.trace_occluded(rays, occluded);
        Ok::<_, Interrupted>(leak_of(scene, caster, point.region, rays, occluded))
    };
    let at_points = parallel::try_map(n_points, Default::default, leak)?;
    let mut found: Vec<Leak> = Vec::new();
    for leak in at_points.into_iter().flatten() {
        match found.iter_mut().find(|known| known.region == leak.region) {
            Some(known) => *known = known.and(&leak),
            None => found.push(leak),
        }
    }
    found.sort_by_key(|leak| leak.region.0);
    Ok(found)
}

impl Leak {
    fn and(&self, other: &Self) -> Self {
        let through_cracks = self.through_cracks + other.through_cracks;
        let share_of_other = other.through_cracks as f32 / through_cracks.max(1) as f32;
        Self {
            region: self.region,
            points: self.points + other.points,
            rays: self.rays + other.rays,
            escaped: self.escaped + other.escaped,
            through_cracks,
            returned: self.returned + (other.returned - self.returned) * share_of_other,
        }
    }
}

/// What leaves from one point; `None` in the open.
fn leak_of(scene: &Scene, caster: &dyn RayCaster, region: RegionId, rays: &[Ray], occluded: &[bool]) -> Option<Leak> {
    let few = FEW * rays.len() as f64;
    let escaping = || rays.iter().zip(occluded).filter(|(_, is_occluded)| !**is_occluded);
    let escaped = escaping().count() as u64;
    if escaped as f64 >= 2.0 * few {
        return None;
    }
    let mut through_cracks = 0;
    for (tried, (ray, _)) in (1..).zip(escaping()) {
        through_cracks += u64::from(is_through_crack(caster, ray, CRACK * scene.diagonal()));
        if (tried - through_cracks) as f64 >= few {
            return None;
        }
    }
    let returned = if through_cracks > 0 { returned(scene, caster, rays) } else { Rgb::ZERO };
    Some(Leak { region, points: 1, rays: rays.len() as u64, escaped, through_cracks, returned })
}

/// The mean albedo of what rays meet.
fn returned(scene: &Scene, caster: &dyn RayCaster, rays: &[Ray]) -> Rgb {
    let mut hits = vec![Hit::MISS; rays.len()];
    caster.trace_nearest(rays, &mut hits);
    let met = hits.iter().filter(|hit| !hit.is_miss());
    met.map(|hit| scene.albedo(&scene.surface_at(hit))).sum::<Rgb>() / rays.len() as f32
}

/// Whether `ray`, which leaves the scene, passes surface on two opposite sides, equally far away, and less than `width` apart.
fn is_through_crack(caster: &dyn RayCaster, ray: &Ray, width: f32) -> bool {
    let (x, y) = ray.direction.any_orthonormal_pair();
    let beside = |offset: Vec3| Ray::new(ray.origin, (ray.direction + offset).normalize());
    (0..PAIRS).any(|k| {
        let (sin, cos) = (std::f32::consts::PI * k as f32 / PAIRS as f32).sin_cos();
        let (offset, mut angle) = (x * cos + y * sin, BESIDE);
        // Nearer and nearer, until the pair is close enough to each other or one of it leaves too.
        loop {
            let mut hits = [Hit::MISS; 2];
            caster.trace_nearest(&[beside(offset * angle), beside(offset * -angle)], &mut hits);
            let [a, b] = hits.map(|hit| hit.t);
            if hits.iter().any(Hit::is_miss) || angle * (a + b) <= width {
                return a.max(b).is_finite() && a.min(b) >= AS_FAR * a.max(b);
            }
            angle *= 0.5;
        }
    })
}
