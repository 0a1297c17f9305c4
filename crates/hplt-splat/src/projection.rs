use glam::{DVec2, DVec3, Vec2, Vec3};
use hplt_geom::{Camera, Frame};

/// A camera and a raster in scene space: where points and spheres fall on the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    eye: DVec3,
    right: DVec3,
    up: DVec3,
    forward: DVec3,
    center: DVec2,
    /// Pixels per unit of slope.
    scale: f64,
    width: u32,
    height: u32,
}

/// A rectangle of pixels, upper bounds excluded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// First column and row.
    pub min: [u32; 2],
    /// One past the last column and row.
    pub max: [u32; 2],
}

impl PixelRect {
    /// How many pixels there are.
    pub fn area(&self) -> u64 {
        u64::from(self.max[0] - self.min[0]) * u64::from(self.max[1] - self.min[1])
    }

    /// Whether a pixel is inside.
    pub fn contains(&self, column: u32, row: u32) -> bool {
        (self.min[0]..self.max[0]).contains(&column) && (self.min[1]..self.max[1]).contains(&row)
    }

    pub(crate) fn intersection(&self, other: &Self) -> Option<Self> {
        let min = [self.min[0].max(other.min[0]), self.min[1].max(other.min[1])];
        let max = [self.max[0].min(other.max[0]), self.max[1].min(other.max[1])];
        (min[0] < max[0] && min[1] < max[1]).then_some(Self { min, max })
    }
}

impl Projection {
    /// The projection of `camera` onto a raster of `width` × `height` pixels; the twin of [`Camera::ray`].
    pub fn new(camera: &Camera, frame: &Frame, width: u32, height: u32) -> Self {
        Self {
            eye: frame.scene_from_world_point(camera.eye).as_dvec3(),
            right: camera.forward.cross(camera.up),
            up: camera.up,
            forward: camera.forward,
            center: DVec2::new(f64::from(width), f64::from(height)) * 0.5,
            scale: 0.5 * f64::from(height) / (0.5 * camera.vertical_fov).tan(),
            width,
            height,
        }
    }

    /// Pixels across.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Pixels down.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Distance along the view axis, scene units; negative behind the eye.
    pub fn depth(&self, point: Vec3) -> f32 {
        (point.as_dvec3() - self.eye).dot(self.forward) as f32
    }

    /// Where a point falls on the picture, in pixels from the top left; `None` behind the eye.
    pub fn pixel(&self, point: Vec3) -> Option<Vec2> {
        let p = self.camera_from_scene(point);
        let slope = DVec2::new(p.x, -p.y) / p.z;
        (p.z > 0.0).then(|| (self.center + slope * self.scale).as_vec2())
    }

    /// The smallest rectangle of pixels that contains every visible point of a sphere, padded by what rounding in the
    /// positions of samples can do; `None` when no part of the sphere is on the picture.
    ///
    /// Exact up to the padding, wherever the sphere is: in front of the eye, behind it, across its plane, or around it. The
    /// bounds of an axis are the two planes through the eye, parallel to the other axis, that touch the sphere.
    pub fn sphere_bounds(&self, center: Vec3, radius: f32) -> Option<PixelRect> {
        let c = self.camera_from_scene(center);
        // Samples are f32 points near a ray that left an f32 eye: a few units in the last place of either.
        let magnitude = 1.0 + self.eye.abs().max_element() + c.abs().max_element();
        let radius = f64::from(radius) + 4.0 * f64::from(f32::EPSILON) * magnitude;
        let [left, right] = slopes(c.x, c.z, radius)?;
        let [bottom, top] = slopes(c.y, c.z, radius)?;
        let (x0, x1) = pixels(self.center.x + left * self.scale, self.center.x + right * self.scale, self.width)?;
        let (y0, y1) = pixels(self.center.y - top * self.scale, self.center.y - bottom * self.scale, self.height)?;
        Some(PixelRect { min: [x0, y0], max: [x1, y1] })
    }

    fn camera_from_scene(&self, point: Vec3) -> DVec3 {
        let offset = point.as_dvec3() - self.eye;
        DVec3::new(offset.dot(self.right), offset.dot(self.up), offset.dot(self.forward))
    }
}

/// The range of slopes `x/z` over the part of a disc around `(x, z)` with `z > 0`; infinite where the disc reaches the
/// plane of the eye, `None` where it is behind.
fn slopes(x: f64, z: f64, radius: f64) -> Option<[f64; 2]> {
    if z + radius <= 0.0 {
        return None;
    }
    let tangent_squared = x * x + z * z - radius * radius;
    if tangent_squared <= 0.0 {
        return Some([f64::NEG_INFINITY, f64::INFINITY]);
    }
    // The direction (x, z) turned by ± the half-angle φ at which the disc is seen, tan φ = radius / tangent.
    let tangent = tangent_squared.sqrt();
    let (low, low_z) = (x * tangent - z * radius, z * tangent + x * radius);
    let (high, high_z) = (x * tangent + z * radius, z * tangent - x * radius);
    let min = if low_z > 0.0 { low / low_z } else { f64::NEG_INFINITY };
    let max = if high_z > 0.0 { high / high_z } else { f64::INFINITY };
    Some([min, max])
}

/// The pixels that `[min, max]` touches on an axis of `n` pixels.
fn pixels(min: f64, max: f64, n: u32) -> Option<(u32, u32)> {
    // A hundredth of a pixel for the rounding of ray directions.
    const PADDING: f64 = 0.01;
    let (min, max) = (min - PADDING, max + PADDING);
    if max < 0.0 || min >= f64::from(n) {
        return None;
    }
    let first = min.max(0.0) as u32;
    let last = max.min(f64::from(n - 1)) as u32;
    Some((first, last + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn projection() -> Projection {
        let camera = Camera::look_at(DVec3::ZERO, DVec3::new(0.0, 0.0, -1.0), DVec3::Y, 1.0).unwrap();
        Projection::new(&camera, &Frame { center: DVec3::ZERO, exponent: 0 }, 160, 90)
    }

    /// Points in a ball, dense on its surface.
    fn ball(center: Vec3, radius: f32) -> impl Iterator<Item = Vec3> {
        (0..4000).map(move |i| {
            let y = 1.0 - 2.0 * (i as f32 + 0.5) / 4000.0;
            let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
            let r = (1.0 - y * y).sqrt();
            center + Vec3::new(r * cos, y, r * sin) * radius * if i % 8 == 0 { 0.7 } else { 1.0 }
        })
    }

    /// Spheres in front, at the edges, across the plane of the eye, around the eye, behind.
    fn spheres() -> Vec<(Vec3, f32)> {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
            (state >> 8) as f32 / 16_777_216.0
        };
        let mut random = || (Vec3::new(next() - 0.5, next() - 0.5, next() - 0.6), 0.3 * next() * next() + 1e-3);
        (0..400).map(|_| random()).collect()
    }

    /// How many visible points of the ball a rectangle misses, and by how many pixels it is too large at most on a side
    /// that is not cut by the edge of the picture.
    fn missed_and_slack(p: &Projection, center: Vec3, radius: f32, rect: Option<PixelRect>) -> (usize, f32) {
        let (mut missed, mut low, mut high) = (0, Vec2::INFINITY, Vec2::NEG_INFINITY);
        for pixel in ball(center, radius).filter_map(|point| p.pixel(point)) {
            low = low.min(pixel);
            high = high.max(pixel);
            let on_picture = pixel.cmpge(Vec2::ZERO).all() && pixel.x < 160.0 && pixel.y < 90.0;
            let inside = rect.is_some_and(|r| r.contains(pixel.x as u32, pixel.y as u32));
            missed += usize::from(on_picture && !inside);
        }
        let Some(rect) = rect else { return (missed, 0.0) };
        let slack = |edge: u32, limit: u32, extent: f32| if edge == limit { 0.0 } else { (edge as f32 - extent).abs() };
        let sides = [
            slack(rect.min[0], 0, low.x),
            slack(rect.min[1], 0, low.y),
            slack(rect.max[0], 160, high.x),
            slack(rect.max[1], 90, high.y),
        ];
        (missed, sides.into_iter().fold(0.0, f32::max))
    }

    #[test]
    fn sphere_bounds_contain_the_sphere_and_are_tight_everywhere() {
        let p = projection();
        let mut kinds = [0; 3];
        for (center, radius) in spheres() {
            let rect = p.sphere_bounds(center, radius);
            let (missed, slack) = missed_and_slack(&p, center, radius, rect);
            assert_eq!(missed, 0, "{center} {radius} {rect:?}");
            let in_front = -center.z > radius * 1.2;
            kinds[if rect.is_none() { 0 } else { 1 + usize::from(in_front) }] += 1;
            if in_front && center.length() > 4.0 * radius {
                assert!(slack < 2.0, "{center} {radius} {rect:?}: {slack}");
            }
        }
        assert!(kinds.iter().all(|&k| k > 10), "{kinds:?}");
    }

    #[test]
    fn bounds_from_the_radius_over_the_depth_would_miss_points() {
        let p = projection();
        let naive = |center: Vec3, radius: f32| {
            let pixel = p.pixel(center)?;
            let r = radius / -center.z * p.scale as f32;
            let (x, y) = (
                pixels((pixel.x - r).into(), (pixel.x + r).into(), 160)?,
                pixels((pixel.y - r).into(), (pixel.y + r).into(), 90)?,
            );
            Some(PixelRect { min: [x.0, y.0], max: [x.1, y.1] })
        };
        let missed: usize = spheres().iter().map(|&(c, r)| missed_and_slack(&p, c, r, naive(c, r)).0).sum();
        assert!(missed > 100, "{missed}");
    }

    #[test]
    fn points_fall_where_camera_rays_go() {
        let eye = DVec3::new(5.0, 3.0, -2.0);
        let camera = Camera::look_at(eye, DVec3::new(4.0, 1.0, 3.0), DVec3::Y, 0.7).unwrap();
        let frame = Frame { center: DVec3::new(4.0, 2.0, 0.0), exponent: 3 };
        let p = Projection::new(&camera, &frame, 64, 48);
        for pixel in [Vec2::new(0.5, 0.5), Vec2::new(63.0, 1.25), Vec2::new(31.7, 40.1)] {
            let ray = camera.ray(&frame, 64, 48, pixel);
            let point = ray.origin + ray.direction * 0.8;
            assert!((p.pixel(point).unwrap() - pixel).length() < 1e-3);
            assert!(p.pixel(ray.origin - ray.direction).is_none());
        }
    }
}
