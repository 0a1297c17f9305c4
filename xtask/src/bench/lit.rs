//! The error where there is light, from the tables themselves.
//!
//! Files hold surface that light gets to through cracks alone, such as the insides of walls. A random point there counts as
//! much as any other, its error is almost always 0 or huge, and the mean over all points says little about the rest.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Serialize;

/// Points below this part of the mean irradiance are dark: the floor of all relative errors.
const FLOOR: f64 = 0.01;
/// Rec. 709.
const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// The error over the points above the floor.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct LitError {
    /// Mean relative error.
    pub mean: f64,
    /// Points above the floor.
    pub n_lit: usize,
    /// Points below it.
    pub n_dark: usize,
}

impl LitError {
    /// The error of one table against another of the same points.
    ///
    /// # Errors
    /// When a table cannot be read, lacks a column, or has another number of rows.
    pub fn of_files(test: &Path, reference: &Path) -> Result<Self> {
        Self::of(&read(test)?, &read(reference)?)
    }

    fn of(test: &[f64], reference: &[f64]) -> Result<Self> {
        check_lengths(test, reference)?;
        let floor = floor(reference);
        let lit = test.iter().zip(reference).filter(|(_, r)| **r >= floor && **r > 0.0);
        let errors: Vec<f64> = lit.map(|(t, r)| (t - r).abs() / r).collect();
        let mean = errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        Ok(Self { mean, n_lit: errors.len(), n_dark: reference.len() - errors.len() })
    }
}

/// Relative error at every point of a table, with the floor of all relative errors.
///
/// # Errors
/// As [`LitError::of_files`].
pub fn relative_errors(test: &Path, reference: &Path) -> Result<Vec<f64>> {
    relative(&read(test)?, &read(reference)?)
}

fn relative(test: &[f64], reference: &[f64]) -> Result<Vec<f64>> {
    check_lengths(test, reference)?;
    let floor = floor(reference).max(f64::MIN_POSITIVE);
    Ok(test.iter().zip(reference).map(|(t, r)| (t - r).abs() / r.max(floor)).collect())
}

fn floor(reference: &[f64]) -> f64 {
    FLOOR * reference.iter().sum::<f64>() / reference.len().max(1) as f64
}

fn check_lengths(test: &[f64], reference: &[f64]) -> Result<()> {
    if test.len() != reference.len() {
        bail!("{} points against {} of the reference", test.len(), reference.len());
    }
    Ok(())
}

fn read(path: &Path) -> Result<Vec<f64>> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    luminances(&text).with_context(|| format!("{} is no table of irradiance", path.display()))
}

/// Luminance of the total irradiance, row by row.
fn luminances(table: &str) -> Result<Vec<f64>> {
    let mut lines = table.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').map(str::trim).collect();
    let column = |name: &str| head.iter().position(|h| *h == name).with_context(|| format!("no column {name}"));
    let columns = [column("E_r")?, column("E_g")?, column("E_b")?];
    lines.map(|line| luminance(line, columns).with_context(|| format!("bad row \"{line}\""))).collect()
}

fn luminance(line: &str, columns: [usize; 3]) -> Option<f64> {
    let cells: Vec<&str> = line.split(',').collect();
    let value = |i: usize| cells.get(i)?.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    columns.into_iter().zip(LUMINANCE).map(|(i, weight)| Some(weight * value(i)?)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dark_points_are_counted_and_left_out() {
        let reference = [1.0, 2.0, 0.0, 0.001];
        let error = LitError::of(&[1.1, 1.8, 5.0, 0.5], &reference).unwrap();
        assert_eq!((error.n_lit, error.n_dark), (2, 2));
        assert!((error.mean - 0.1).abs() < 1e-12, "{error:?}");
        let worse = LitError::of(&[1.2, 1.8, 5.0, 0.5], &reference).unwrap();
        assert!(worse.mean > error.mean);
        assert!(LitError::of(&[1.0], &reference).is_err());
        assert_eq!(LitError::of(&[0.0], &[0.0]).unwrap().n_lit, 0);
    }

    #[test]
    fn dark_points_are_measured_against_the_floor() {
        let errors = relative(&[1.1, 0.02], &[1.0, 0.0]).unwrap();
        assert!((errors[0] - 0.1).abs() < 1e-12 && (errors[1] - 4.0).abs() < 1e-12, "{errors:?}");
        assert!(relative(&[1.0], &[]).is_err());
    }

    #[test]
    fn columns_are_found_by_name() {
        let table = "x,E_b,E_g,E_r\n9,1,1,1\n9,0,0,2\n";
        let found = luminances(table).unwrap();
        assert!((found[0] - 1.0).abs() < 1e-12 && (found[1] - 0.4252).abs() < 1e-12, "{found:?}");
        for bad in ["", "x,E_r,E_g\n1,2,3\n", "E_r,E_g,E_b\n1,2\n", "E_r,E_g,E_b\n1,2,nan\n"] {
            assert!(luminances(bad).is_err(), "{bad}");
        }
    }
}
