//! Randomness: vectors that never change, avalanche, uniformity; Sobol stratification; densities of the warps.
use glam::{Vec2, Vec3};
use hplt_sampling::random::{Stage, Stream, hash, unit_f32, unit_f64};
use hplt_sampling::sobol::{BLOCK_SIZE, sobol_2d};
use hplt_sampling::warp::{self, Rectangle, SphericalRectangle, SphericalTriangle};

#[test]
fn test_vectors() {
    let cases = [
        (0u64, Stage::Candidates, 0u32, 0u32, 0u32),
        (1, Stage::Gather, 2, 3, 4),
        (u64::MAX, Stage::Direct, u32::MAX, u32::MAX, u32::MAX),
        (0x0123_4567_89AB_CDEF, Stage::Reference, 1_000_000, 255, 7),
    ];
    let words = cases.map(|(seed, stage, point, ray, dimension)| hash(seed, stage, point, ray, dimension));
    assert_eq!(words, VECTORS, "{words:#010x?}");
}

/// From a second implementation, in another language.
const VECTORS: [u32; 4] = [0x50DA_C379, 0x6AD7_78B1, 0xB9B1_3C17, 0x9879_7CF7];

/// Flipping any one bit of any argument flips every output bit with probability 1/2, within 5 standard deviations.
#[test]
fn one_flipped_bit_changes_half_of_the_output() {
    let n = 4_000u32;
    let sigma = (0.25 / f64::from(n)).sqrt();
    for argument in 0..4 {
        for bit in 0..32 {
            let mut flips = [0u32; 32];
            for i in 0..n {
                let mut a = [i, i.wrapping_mul(77), i % 13, 42];
                let before = hash(u64::from(a[3]), Stage::Gather, a[0], a[1], a[2]);
                a[argument] ^= 1 << bit;
                let changed = before ^ hash(u64::from(a[3]), Stage::Gather, a[0], a[1], a[2]);
                (0..32).for_each(|j| flips[j] += changed >> j & 1);
            }
            for count in flips {
                let share = f64::from(count) / f64::from(n);
                assert!((share - 0.5).abs() < 6.0 * sigma, "argument {argument}, bit {bit}: {share}");
            }
        }
    }
}

/// Pearson's chi-square of consecutive counters in 256 bins, for each argument and for the upper and the lower bits.
#[test]
fn consecutive_counters_are_uniform() {
    let n = 1 << 16;
    for (seed, shift) in [(0u64, 24), (1, 24), (u64::MAX, 24), (7, 0)] {
        for argument in 0..3 {
            let mut bins = [0f64; 256];
            for i in 0..n {
                let mut a = [5u32, 6, 7];
                a[argument] = i;
                bins[(hash(seed, Stage::Pixel, a[0], a[1], a[2]) >> shift & 255) as usize] += 1.0;
            }
            let expected = f64::from(n) / 256.0;
            let chi_square: f64 = bins.iter().map(|b| (b - expected).powi(2) / expected).sum();
            // 255 degrees of freedom: mean 255, sigma 22.6; five sigmas either side.
            assert!((142.0..368.0).contains(&chi_square), "argument {argument}: {chi_square}");
        }
    }
}

#[test]
fn stages_and_seeds_do_not_share_numbers() {
    let row = |seed, stage| (0..64).map(|i| hash(seed, stage, i, 0, 0)).collect::<Vec<_>>();
    let rows = [row(0, Stage::Gather), row(0, Stage::Direct), row(1, Stage::Gather), row(1 << 32, Stage::Gather)];
    for i in 0..rows.len() {
        for j in 0..i {
            assert!(rows[i].iter().all(|word| !rows[j].contains(word)));
        }
    }
    let words = Stream::new(3, Stage::Probe).words(1, 2, 3);
    assert_eq!(words[0], hash(3, Stage::Probe, 1, 2, 3));
}

#[test]
fn unit_numbers_stay_below_one() {
    assert!(unit_f32(u32::MAX) < 1.0 && unit_f64(u32::MAX, u32::MAX) < 1.0);
    assert_eq!((unit_f32(0), unit_f64(0, 0), unit_f32(1 << 31), unit_f64(1 << 31, 0)), (0.0, 0.0, 0.5, 0.5));
}

/// Every aligned power of two of points has one point per elementary interval, in both blocks and all pairs.
#[test]
fn sobol_points_are_stratified() {
    for (first, pair, seed) in
        [(0, 0, 1), (64, 1, 2), (BLOCK_SIZE - 256, 2, 3), (BLOCK_SIZE, 3, 4), (5 * BLOCK_SIZE, 0, 5)]
    {
        for log_columns in 0..=6 {
            let (columns, rows) = (1u32 << log_columns, 64u32 >> log_columns);
            let mut hit = [false; 64];
            for i in 0..64 {
                let p = sobol_2d(first + i, seed, pair);
                let cell = (p.x * columns as f32) as u32 * rows + (p.y * rows as f32) as u32;
                assert!(!std::mem::replace(&mut hit[cell as usize], true), "pair {pair}, {columns} columns");
            }
        }
    }
}

#[test]
fn sobol_scrambles_pairs_and_blocks_differ() {
    let p = sobol_2d(3, 1, 0);
    for other in [sobol_2d(3, 2, 0), sobol_2d(3, 1, 1), sobol_2d(3, 1, 2), sobol_2d(3 + BLOCK_SIZE, 1, 0)] {
        assert!((p - other).abs().max_element() > 1e-4);
    }
}

/// Midpoints of an n × n grid: their image must integrate like the density says.
fn grid(n: u32) -> impl Iterator<Item = Vec2> {
    let step = 1.0 / n as f32;
    (0..n * n).map(move |i| Vec2::new((i % n) as f32 + 0.5, (i / n) as f32 + 0.5) * step)
}

fn mean(n: u32, f: impl Fn(Vec2) -> f64) -> f64 {
    grid(n).map(f).sum::<f64>() / f64::from(n * n)
}

const AXES: [Vec3; 6] = [
    Vec3::Z,
    Vec3::NEG_Z,
    Vec3::X,
    Vec3::new(0.48, -0.6, 0.64),
    Vec3::new(1e-4, 0.0, -1.0),
    Vec3::new(-0.48, 0.64, -0.6),
];

#[test]
fn bases_are_orthonormal_and_right_handed() {
    for normal in AXES.map(Vec3::normalize) {
        let m = warp::orthonormal_basis(normal);
        assert!((m.transpose() * m).abs_diff_eq(glam::Mat3::IDENTITY, 1e-6));
        assert!((m.determinant() - 1.0).abs() < 1e-6);
        assert_eq!(m.z_axis, normal);
    }
}

#[test]
fn the_disc_is_uniform_and_round() {
    assert!((mean(256, |u| f64::from(warp::concentric_disc(u).length_squared())) - 0.5).abs() < 1e-4);
    assert!(grid(64).all(|u| warp::concentric_disc(u).length() <= 1.0 + 1e-6));
    let corner = warp::concentric_disc(Vec2::ONE);
    assert!((corner.length() - 1.0).abs() < 1e-6 && (corner.x - corner.y).abs() < 1e-6);
    assert_eq!(warp::concentric_disc(Vec2::splat(0.5)), Vec2::ZERO);
}

/// Moments of each distribution about its axis, and `E[1/pdf]` = the measure of the domain, on six axes.
#[test]
fn hemispheres_have_their_moments_and_densities_integrate_to_one() {
    for normal in AXES.map(Vec3::normalize) {
        let cosine = |u| warp::cosine_hemisphere(u, normal);
        assert!((mean(256, |u| cosine(u).dot(normal).into()) - 2.0 / 3.0).abs() < 1e-3);
        assert!(grid(64).all(|u| cosine(u).dot(normal) > 0.0 && (cosine(u).length() - 1.0).abs() < 1e-5));
        let uniform = |u| warp::uniform_hemisphere(u, normal);
        assert!((mean(256, |u| uniform(u).dot(normal).into()) - 0.5).abs() < 1e-4);
        assert!((mean(256, |u| f64::from(uniform(u).dot(normal)).powi(2)) - 1.0 / 3.0).abs() < 1e-4);
        // ∫ pdf_cosine dω over directions that are uniform in solid angle.
        let integral = mean(256, |u| {
            let cos = uniform(u).dot(normal);
            f64::from(warp::cosine_hemisphere_pdf_solid_angle(cos))
                / f64::from(warp::uniform_hemisphere_pdf_solid_angle(cos))
        });
        assert!((integral - 1.0).abs() < 1e-4, "{integral}");
    }
    assert_eq!(warp::cosine_hemisphere_pdf_solid_angle(-0.5), 0.0);
    assert_eq!(warp::uniform_hemisphere_pdf_solid_angle(-0.5), 0.0);
}

#[test]
fn rays_never_run_along_the_surface() {
    for u in [Vec2::ZERO, Vec2::new(0.5, 0.0), Vec2::new(0.0, 0.3), Vec2::new(0.999_999_94, 0.5)] {
        assert!(warp::cosine_hemisphere(u, Vec3::Z).z >= warp::MIN_COSINE);
    }
}

/// A cap is uniform when its height is; tiny cones keep the offset from the axis in proportion to the angle.
#[test]
fn cones_are_uniform_down_to_tiny_angles() {
    for angle in [1e-6f32, 4.65e-3, 0.3, 1.0, 3.0] {
        let lateral = |u| f64::from(warp::uniform_cone(u, Vec3::Z, angle).truncate().length_squared());
        let (a, half) = (f64::from(angle), f64::from(angle) / 2.0);
        // E[sin²θ] = 1 - E[z²] with z uniform on [cos a, 1]; as (h - h²/3) with h = 1 - cos a to stay exact.
        let h = 2.0 * half.sin().powi(2);
        let expected = h - h * h / 3.0;
        assert!((mean(256, lateral) / expected - 1.0).abs() < 1e-3, "{angle}");
        assert!(
            grid(64).all(|u| lateral(u).sqrt().asin()
                <= a.min(std::f64::consts::PI - a).max(1.6 * f64::from(a > 1.5)) * 1.000_01)
        );
        let integral = f64::from(warp::uniform_cone_pdf_solid_angle(angle)) * 2.0 * std::f64::consts::PI * h;
        assert!((integral - 1.0).abs() < 1e-6);
    }
}

#[test]
fn triangles_are_uniform() {
    let inside = |w: Vec2| w.x >= 0.0 && w.y >= 0.0 && w.x + w.y <= 1.0 + 1e-6;
    assert!(grid(128).all(|u| inside(warp::uniform_triangle(u))));
    let weight = |u: Vec2| {
        let w = warp::uniform_triangle(u);
        [w.x, w.y, 1.0 - w.x - w.y].map(f64::from)
    };
    for corner in 0..3 {
        assert!((mean(256, |u| weight(u)[corner]) - 1.0 / 3.0).abs() < 1e-4);
        assert!((mean(256, |u| weight(u)[corner].powi(2)) - 1.0 / 6.0).abs() < 1e-4);
    }
    assert!((mean(256, |u| weight(u)[0] * weight(u)[1]) - 1.0 / 12.0).abs() < 1e-4);
    assert_eq!(warp::uniform_triangle_pdf_area(0.25), 4.0);
}

/// Uniform over the solid angle of a triangle, near or far, wound either way: the area is that of van Oosterom & Strackee (1983),
/// every direction hits the triangle, and the mean cosine is the exact form factor.
#[test]
fn spherical_triangles_are_uniform_in_solid_angle() {
    let octant = [Vec3::X, 2.0 * Vec3::Y, 0.5 * Vec3::Z];
    let flat = [Vec3::new(-3.0, -1.0, 0.2), Vec3::new(4.0, -0.5, 0.2), Vec3::new(0.5, 5.0, 0.2)];
    let far = [Vec3::new(0.3, 0.0, 2.0), Vec3::new(0.9, 0.1, 2.1), Vec3::new(0.2, 0.7, 1.8)];
    for corners in [octant, flat, far] {
        let [a, b, c] = corners.map(|p| p.as_dvec3().normalize());
        let expected = 2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        let factor = hplt_geom::radiometry::polygon_form_factor(glam::DVec3::Z, &[a, b, c]).abs();
        for corners in [corners, [corners[0], corners[2], corners[1]]] {
            let seen = SphericalTriangle::new(corners).unwrap();
            assert!((seen.solid_angle() / expected - 1.0).abs() < 1e-5);
            let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
            let hits = |d: Vec3| {
                let p = d * (corners[0].dot(normal) / d.dot(normal));
                let edge = |i: usize| {
                    let side = (corners[(i + 1) % 3] - corners[i]).cross(p - corners[i]);
                    side.dot(normal) >= -1e-4 * normal.length_squared()
                };
                (0..3).all(edge)
            };
            assert!(grid(64).all(|u| hits(seen.sample(u))));
            // E = ∫ cosθ/π dω: the form factor, from its definition.
            let cosines = mean(256, |u| f64::from(warp::cosine_hemisphere_pdf_solid_angle(seen.sample(u).z)));
            assert!((cosines * expected / factor - 1.0).abs() < 1e-4, "{} {factor}", cosines * expected);
        }
    }
    assert_eq!(SphericalTriangle::new([Vec3::X, Vec3::Y, Vec3::X]), None);
    assert_eq!(SphericalTriangle::new([Vec3::X, Vec3::Y, Vec3::X + Vec3::Y]), None);
}

/// Uniform over the solid angle of a rectangle, near, far, and with the origin below its middle or beside it: the area is that of its
/// two triangles, every point is on it, and the mean cosine is the exact form factor.
#[test]
fn spherical_rectangles_are_uniform_in_solid_angle() {
    let turn = glam::Mat3::from_axis_angle(Vec3::new(0.6, 0.0, 0.8), 0.9);
    let around = (Vec3::new(-3.0, -1.0, 0.2), [5.0 * Vec3::X, 4.0 * Vec3::Y]);
    let beside = (Vec3::new(0.5, 0.3, 1.0), [0.2 * Vec3::Y, 3.0 * Vec3::X]);
    let far = (turn * Vec3::new(3.0, -2.0, 0.5), [turn * Vec3::X, turn * Vec3::Z]);
    for (corner, edges) in [around, beside, far] {
        let corners = [corner, corner + edges[0], corner + edges[0] + edges[1], corner + edges[1]];
        let directions = corners.map(|p| p.as_dvec3().normalize());
        let triangle =
            |[a, b, c]: [glam::DVec3; 3]| 2.0 * a.dot(b.cross(c)).abs().atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        let [a, b, c, d] = directions;
        let expected = triangle([a, b, c]) + triangle([a, c, d]);
        let up = directions.iter().sum::<glam::DVec3>().normalize();
        let factor = hplt_geom::radiometry::polygon_form_factor(up, &directions).abs();
        let eye = Vec3::new(0.25, -0.5, 1.5);
        let rectangle = Rectangle::new(corner + eye, edges).unwrap();
        let seen = SphericalRectangle::new(&rectangle, eye).unwrap();
        assert!((seen.solid_angle() / expected - 1.0).abs() < 1e-5);
        let sample = |u| {
            let shares = seen.sample(u);
            assert!([shares.x, shares.y].iter().all(|share| (0.0..=1.0).contains(share)), "{shares}");
            (corner + shares.x * edges[0] + shares.y * edges[1]).normalize()
        };
        let above = |d: Vec3| f64::from(warp::cosine_hemisphere_pdf_solid_angle(d.dot(up.as_vec3()).max(0.0)));
        let cosines = mean(256, |u| above(sample(u)));
        assert!((cosines * expected / factor - 1.0).abs() < 1e-4, "{} {factor}", cosines * expected);
    }
    assert_eq!(Rectangle::new(Vec3::Z, [Vec3::ZERO, Vec3::Y]), None);
    let rectangle = Rectangle::new(Vec3::X, [Vec3::X, Vec3::Y]).unwrap();
    // In its plane: beside it, at a corner, on a side and inside.
    for eye in [Vec3::ZERO, Vec3::X, Vec3::new(1.5, 0.0, 0.0), Vec3::new(1.5, 0.5, 0.0)] {
        assert_eq!(SphericalRectangle::new(&rectangle, eye), None, "{eye}");
    }
}
