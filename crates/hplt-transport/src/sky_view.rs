//! How well rays find the sky: small openings are found by chance alone, and this tells when chance is not enough.

use glam::Vec2;
use hplt_geom::radiometry::luminance;
use hplt_geom::{Interrupted, Progress, Ray, RayCaster, Scene, TriangleId, offset_origin, parallel};
use hplt_sampling::random::{Stage, Stream, unit_f32, unit_f64};
use hplt_sampling::{sobol, warp};

const POINTS: usize = 1024;
const RAYS: u32 = 64;
/// A point that sees the sky by fewer of its rays is enclosed.
const FEW: u32 = RAYS / 16;
/// Enclosed surface below this share of all is not worth a word.
const LEAST_SHARE: f64 = 0.01;
/// Largest relative standard error of what it sees that is good enough.
const MOST_ERROR: f64 = 0.1;

/// What enclosed surface sees of the sky: that which sees it by less than a sixteenth of its directions, weighted by cosine, closed
/// hollows included. From 64 rays at each of 1024 random points, as many as a coarse solution casts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SkyView {
    /// The share of all reflecting sides, by area, that is enclosed.
    pub enclosed_share: f64,
    /// Rays cast from there.
    pub rays: u64,
    /// How many of them met the sky.
    pub seen: u64,
    /// Standard error of [`seen_share`](Self::seen_share), from the spread of the points.
    pub standard_error: f64,
}

impl SkyView {
    /// The share of its directions, weighted by cosine, by which enclosed surface sees the sky: its form factor to it.
    pub fn seen_share(&self) -> f64 {
        self.seen as f64 / self.rays.max(1) as f64
    }

    /// An upper bound of that share which holds with a confidence of 95 %: after Hanley & Lippman-Hand 1983, "If nothing goes wrong, is
    /// everything all right?", 3 over the number of rays where none met the sky.
    pub fn most_seen_share(&self) -> f64 {
        let none = 3.0 / self.rays.max(1) as f64;
        if self.seen == 0 { none.min(1.0) } else { (self.seen_share() + 1.645 * self.standard_error).max(none) }
    }

    /// Whether enclosed surface sees the sky, and through openings so small that these rays do not tell how much to within a
    /// tenth: solutions are noisy there, and single functions miss the openings altogether.
    pub fn is_under_sampled(&self) -> bool {
        self.seen > 0 && self.enclosed_share >= LEAST_SHARE && self.standard_error > MOST_ERROR * self.seen_share()
    }
}

/// What enclosed surface sees of the sky of `scene`; `None` where the sky is dark or nothing reflects. 65,536 rays.
///
/// # Errors
/// When interrupted.
pub fn sky_view(
    scene: &Scene,
    caster: &dyn RayCaster,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Option<SkyView>, Interrupted> {
    let is_lit = scene.environment().is_some_and(|e| e.map().pixels().iter().any(|p| luminance(*p) > 0.0));
    let (sides, total) = reflecting_sides(scene);
    if !is_lit || total <= 0.0 {
        return Ok(None);
    }
    let stream = Stream::new(seed, Stage::Probe);
    let counts = parallel::try_map(
        POINTS,
        || (),
        |(), i| {
            progress.check()?;
            let words = stream.words(i as u32, 0, 7);
            let at = unit_f64(words[0], words[1]) * total;
            let (triangle, is_front, _) = sides[sides.partition_point(|side| side.2 <= at).min(sides.len() - 1)];
            let uv = warp::uniform_triangle(Vec2::new(unit_f32(words[2]), unit_f32(words[3])));
            Ok::<_, Interrupted>(n_seen(scene, caster, (triangle, is_front), uv, stream.word(i as u32, 1, 7)))
        },
    )?;
    Ok(Some(view_of(&counts)))
}

/// Sides of triangles that reflect, with the running sum of their areas, and the whole of it, scene units squared.
fn reflecting_sides(scene: &Scene) -> (Vec<(TriangleId, bool, f64)>, f64) {
    let (mut sides, mut total) = (Vec::new(), 0.0);
    for triangle in (0..scene.mesh().n_triangles() as u32).map(TriangleId) {
        for is_front in [true, false] {
            if scene.material(triangle).reflects.includes(is_front) {
                total += scene.mesh().area(triangle);
                sides.push((triangle, is_front, total));
            }
        }
    }
    (sides, total)
}

/// How many of the cosine-distributed rays of a point of a side leave the scene.
fn n_seen(scene: &Scene, caster: &dyn RayCaster, (triangle, is_front): (TriangleId, bool), uv: Vec2, seed: u32) -> u32 {
    let normal = scene.mesh().face_normal(triangle) * if is_front { 1.0 } else { -1.0 };
    let origin = offset_origin(scene.mesh().position_at(triangle, uv.x, uv.y), normal);
    let ray = |k| Ray::new(origin, warp::cosine_hemisphere(sobol::sobol_2d(k, seed, 0), normal));
    let rays: Vec<Ray> = (0..RAYS).map(ray).collect();
    let mut occluded = vec![false; rays.len()];
    caster.trace_occluded(&rays, &mut occluded);
    occluded.iter().filter(|is_occluded| !**is_occluded).count() as u32
}

fn view_of(counts: &[u32]) -> SkyView {
    let enclosed: Vec<f64> = counts.iter().filter(|&&n| n < FEW).map(|&n| f64::from(n)).collect();
    let n = enclosed.len().max(1) as f64;
    let (sum, squares) = (enclosed.iter().sum::<f64>(), enclosed.iter().map(|k| k * k).sum::<f64>());
    let variance = (squares - sum * sum / n).max(0.0) / (n - 1.0).max(1.0);
    SkyView {
        enclosed_share: enclosed.len() as f64 / counts.len().max(1) as f64,
        rays: enclosed.len() as u64 * u64::from(RAYS),
        seen: sum as u64,
        standard_error: (variance / n).sqrt() / f64::from(RAYS),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_become_a_share_with_its_error() {
        let mut counts = vec![RAYS; 600];
        counts.extend((0..400).map(|i| u32::from(i % 100 == 0)));
        let view = view_of(&counts);
        assert_eq!((view.enclosed_share, view.rays, view.seen), (0.4, 400 * 64, 4));
        // Four of 400 points: Poisson, 50 %.
        assert!((view.standard_error / view.seen_share() - 0.5).abs() < 0.01, "{view:?}");
        assert!(view.is_under_sampled());
        assert!((view.most_seen_share() / view.seen_share() - 1.82).abs() < 0.02);
    }

    #[test]
    fn nothing_seen_is_a_bound_and_much_seen_is_no_warning() {
        let closed = view_of(&[0; 1024]);
        assert!(!closed.is_under_sampled() && closed.most_seen_share() == 3.0 / 65536.0);
        let open = view_of(&[RAYS; 1024]);
        assert!(!open.is_under_sampled() && open.rays == 0 && open.most_seen_share() == 1.0);
        let arcades: Vec<u32> = (0..1024).map(|i| if i % 2 == 0 { 40 } else { i / 2 % 4 }).collect();
        assert!(!view_of(&arcades).is_under_sampled());
    }
}
