use std::ops::{Add, Mul, Sub};

use hplt_geom::{Rgb, parallel};

use crate::GBuffer;

/// Pixels from one column or row of the lattice to the next.
const STEP: usize = 4;
/// Share of the light by which what is known of a block may differ from what is interpolated there.
const EVEN: f32 = 0.02;
/// Least cosine between the normals of pixels of one block.
const SAME_NORMAL: f32 = 0.98;
/// Share of the mean light below which light counts as that much.
const FLOOR: f32 = 0.01;

/// Light that arrives at a point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Arriving {
    /// Direct irradiance, W/m².
    pub direct: Rgb,
    /// Indirect irradiance, W/m².
    pub indirect: Rgb,
}

impl Arriving {
    /// Irradiance, W/m².
    pub fn total(&self) -> Rgb {
        self.direct + self.indirect
    }
}

impl Add for Arriving {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { direct: self.direct + other.direct, indirect: self.indirect + other.indirect }
    }
}

impl Sub for Arriving {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self { direct: self.direct - other.direct, indirect: self.indirect - other.indirect }
    }
}

impl Mul<f32> for Arriving {
    type Output = Self;

    fn mul(self, factor: f32) -> Self {
        Self { direct: self.direct * factor, indirect: self.indirect * factor }
    }
}

/// The light at the pixels of `gbuffer` that are wanted, zero at the others: read at every fourth pixel of every fourth row and in the
/// middle of the blocks between, and interpolated in blocks that see one smooth piece of surface in even light; where not, `read` at
/// every pixel.
///
/// A block is interpolated while all that is known of it is within 2 % of that: its middle, and what was read on its border for a
/// neighbour that is not. So what changes there is followed, however narrow it is, once it has been met.
/// `read` is called with pixels in ascending order, a few times, and returns the light at each.
///
/// # Errors
/// Those of `read`.
///
/// # Panics
/// When `is_wanted` has not one entry per pixel, or a pixel of background is wanted.
pub fn read_where_it_changes<E>(
    gbuffer: &GBuffer,
    is_wanted: &[bool],
    mut read: impl FnMut(&[usize]) -> Result<Vec<Arriving>, E>,
) -> Result<Vec<Arriving>, E> {
    assert_eq!(is_wanted.len(), gbuffer.n_pixels(), "one wish per pixel");
    let blocks = Block::all(gbuffer);
    let mut is_split = parallel::map(blocks.len(), || (), |(), i| !blocks[i].is_one_surface(gbuffer, is_wanted));
    let mut light: Vec<Option<Arriving>> = vec![None; gbuffer.n_pixels()];
    let mut due = vec![false; gbuffer.n_pixels()];
    for (block, &is_split) in blocks.iter().zip(&is_split) {
        let pixels: &mut dyn Iterator<Item = usize> =
            if is_split { &mut block.pixels() } else { &mut block.corners().into_iter().chain([block.middle()]) };
        pixels.for_each(|pixel| due[pixel] = is_wanted[pixel]);
    }
    let mut floor = None;
    loop {
        let pixels: Vec<usize> = (0..due.len()).filter(|&pixel| due[pixel]).collect();
        if pixels.is_empty() {
            break;
        }
        for (&pixel, found) in pixels.iter().zip(read(&pixels)?) {
            (light[pixel], due[pixel]) = (Some(found), false);
        }
        let floor = *floor.get_or_insert_with(|| FLOOR * mean(&light));
        let is_uneven = |i: usize| !is_split[i] && blocks[i].is_uneven(&light, floor);
        let uneven = parallel::map(blocks.len(), || (), |(), i| is_uneven(i));
        for (i, _) in uneven.iter().enumerate().filter(|(_, uneven)| **uneven) {
            is_split[i] = true;
            blocks[i].pixels().for_each(|pixel| due[pixel] = light[pixel].is_none());
        }
    }
    for (block, _) in blocks.iter().zip(&is_split).filter(|(_, is_split)| !**is_split) {
        block.interpolate(&mut light);
    }
    Ok(light.into_iter().map(Option::unwrap_or_default).collect())
}

/// The mean irradiance, by the largest channel, where it is known.
fn mean(light: &[Option<Arriving>]) -> f32 {
    let (sum, n) =
        light.iter().flatten().fold((0.0, 0.0), |(sum, n), l| (sum + f64::from(l.total().max_element()), n + 1.0));
    (sum / f64::max(n, 1.0)) as f32
}

/// Pixels between two columns and two rows of the lattice, with these.
struct Block {
    width: usize,
    columns: [usize; 2],
    rows: [usize; 2],
}

impl Block {
    fn all(gbuffer: &GBuffer) -> Vec<Self> {
        let width = gbuffer.width();
        let rows = spans(gbuffer.height());
        let row = |rows| spans(width).map(move |columns| Self { width, columns, rows });
        rows.flat_map(row).collect()
    }

    fn pixels(&self) -> impl Iterator<Item = usize> + use<> {
        let ([left, right], width) = (self.columns, self.width);
        (self.rows[0]..=self.rows[1]).flat_map(move |y| (left..=right).map(move |x| y * width + x))
    }

    /// Upper and lower left, upper and lower right.
    fn corners(&self) -> [usize; 4] {
        let at = |x: usize, y: usize| self.rows[y] * self.width + self.columns[x];
        [at(0, 0), at(0, 1), at(1, 0), at(1, 1)]
    }

    /// Whether all of it is wanted and on one smooth piece of surface.
    fn is_one_surface(&self, gbuffer: &GBuffer, is_wanted: &[bool]) -> bool {
        let first = |pixel: usize| gbuffer.facet(gbuffer.samples_of(pixel).start);
        let corner = first(self.corners()[0]);
        self.pixels().all(|pixel| is_wanted[pixel] && corner.continues_at(&first(pixel), SAME_NORMAL))
    }

    fn middle(&self) -> usize {
        let [x, y] = [self.columns, self.rows].map(|[from, to]| (from + to) / 2);
        y * self.width + x
    }

    /// Whether what is known of it is far from what its corners say.
    fn is_uneven(&self, light: &[Option<Arriving>], floor: f32) -> bool {
        let corners = self.corners().map(|pixel| light[pixel].expect("corners are read"));
        let mut known = self.pixels().filter_map(|pixel| Some((pixel, light[pixel]?.total())));
        known.any(|(pixel, total)| {
            let error = (bilinear(&corners, self.place(pixel)).total() - total).abs().max_element();
            error > EVEN * total.max_element().max(floor)
        })
    }

    /// Fills in what is not known of it, so that it passes through its corners and its middle.
    fn interpolate(&self, light: &mut [Option<Arriving>]) {
        let corners = self.corners().map(|pixel| light[pixel].expect("corners are read"));
        let middle = self.place(self.middle());
        let rise = light[self.middle()].expect("middles are read") - bilinear(&corners, middle);
        let bump = |[u, v]: [f32; 2]| u * (1.0 - u) * v * (1.0 - v);
        for pixel in self.pixels() {
            let place = self.place(pixel);
            let share = bump(place) / bump(middle).max(f32::MIN_POSITIVE);
            light[pixel].get_or_insert_with(|| bilinear(&corners, place) + rise * share);
        }
    }

    /// How far a pixel is from left to right and from top to bottom.
    fn place(&self, pixel: usize) -> [f32; 2] {
        let share = |[from, to]: [usize; 2], at: usize| (at - from) as f32 / (to - from).max(1) as f32;
        [share(self.columns, pixel % self.width), share(self.rows, pixel / self.width)]
    }
}

/// Between values at the corners of a square: upper and lower left, upper and lower right.
fn bilinear(corners: &[Arriving; 4], [across, down]: [f32; 2]) -> Arriving {
    let side = |upper: Arriving, lower: Arriving| upper + (lower - upper) * down;
    let (left, right) = (side(corners[0], corners[1]), side(corners[2], corners[3]));
    left + (right - left) * across
}

/// From one line of the lattice to the next, the last ending at the last of `n` pixels.
fn spans(n: usize) -> impl Iterator<Item = [usize; 2]> {
    let last = n.saturating_sub(1);
    (0..last.max(1)).step_by(STEP).map(move |from| [from, (from + STEP).min(last)])
}
