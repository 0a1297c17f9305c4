//! `hplt compare`

use std::path::Path;

use hplt_geom::Rgb;
use hplt_io::{IrradianceRow, Limits, read_image, read_irradiance_csv};
use hplt_reference::metrics::{image_error, irradiance_error};
use serde_json::{Value, json};

use crate::args::{CompareArgs, Quantity};
use crate::exit::{Exit, Failure};
use crate::outputs::{extension, to_stdout};
use crate::progress::say;
use crate::session::Ended;
use crate::values::{Fraction, human_percent};

/// How far apart two points may be and still be the same row, relative to the size of their coordinates.
const SAME_PLACE: f64 = 1e-5;

/// A figure, and the largest that is allowed.
struct Figure {
    name: &'static str,
    value: f64,
    is_fraction: bool,
    limit: Option<Fraction>,
}

/// Compares two pictures or two tables.
///
/// # Errors
/// When an input cannot be read or the two do not belong together.
pub fn run(args: &CompareArgs) -> Result<Ended, Failure> {
    let kinds = (extension(&args.test), extension(&args.reference));
    let is_picture = |kind: &str| matches!(kind, "exr" | "png" | "hdr");
    let (what, n, figures) = match (kinds.0.as_str(), kinds.1.as_str()) {
        ("csv", "csv") => tables(args)?,
        (a, b) if is_picture(a) && is_picture(b) => pictures(args)?,
        (a, b) => {
            let message = format!("a .{a} and a .{b} file; expected two .csv, or two pictures (.exr, .png, .hdr)");
            return Err(Failure::usage(hplt_io::sanitized(&message)));
        }
    };
    let missed: Vec<&Figure> = figures.iter().filter(|f| f.limit.is_some_and(|l| f.value.abs() > l.0)).collect();
    report(args, what, n, &figures)?;
    for figure in &missed {
        let limit = figure.limit.map_or(0.0, |l| l.0);
        say(&format!(
            "beyond its limit: {} is {}; the limit is {}",
            figure.name,
            shown(figure.value, figure.is_fraction),
            shown(limit, figure.is_fraction)
        ));
    }
    let values: serde_json::Map<String, Value> =
        figures.iter().map(|f| (f.name.replace(' ', "_"), json!(f.value))).collect();
    let exit = if missed.is_empty() { Exit::Ok } else { Exit::NotConverged };
    let names: Vec<&str> = missed.iter().map(|f| f.name).collect();
    Ok(Ended { exit, report: json!({ "command": "compare", what: n, "figures": values, "beyond_limit": names }) })
}

/// The figures are the result, so they go to stdout, unless the JSON document does.
fn report(args: &CompareArgs, what: &str, n: usize, figures: &[Figure]) -> Result<(), Failure> {
    if args.output_flags.json {
        return Ok(());
    }
    to_stdout(|out| {
        writeln!(out, "{what:<24} {n}")?;
        figures.iter().try_for_each(|f| writeln!(out, "{:<24} {}", f.name, shown(f.value, f.is_fraction)))
    })
}

fn shown(value: f64, is_fraction: bool) -> String {
    if is_fraction { human_percent(value) } else { format!("{value:.4e}") }
}

fn tables(args: &CompareArgs) -> Result<(&'static str, usize, Vec<Figure>), Failure> {
    let [test, reference] = [&args.test, &args.reference].map(|path| read_irradiance_csv(path, &Limits::default()));
    let (test, reference) = (test?, reference?);
    check_places(&args.test, &test, &reference)?;
    let column = |row: &IrradianceRow| match args.quantity {
        Quantity::Total => row.total,
        Quantity::Direct => row.direct,
        Quantity::Indirect => row.indirect,
    };
    let values = |rows: &[IrradianceRow]| rows.iter().map(column).collect::<Vec<Rgb>>();
    let e = irradiance_error(&values(&test), &values(&reference)).map_err(|e| metric_failure(&args.test, &e))?;
    let figure = |name, value, limit| Figure { name, value, is_fraction: true, limit };
    let mut figures = vec![
        figure("mean", e.mean, args.max_mean),
        figure("median", e.median, None),
        figure("p95", e.p95, args.max_p95),
        figure("rms", e.rms, args.max_rms),
        figure("max", e.max, None),
        figure("bias", e.bias, args.max_bias),
        figure("chroma", e.chroma, None),
    ];
    figures.push(Figure { name: "mean reference", value: e.mean_reference, is_fraction: false, limit: None });
    if args.max_relmse.is_some() {
        return Err(Failure::usage(
            "--max-relmse is for pictures; expected --max-mean, --max-p95, --max-rms or --max-bias",
        ));
    }
    Ok(("points", e.n, figures))
}

fn check_places(path: &Path, test: &[IrradianceRow], reference: &[IrradianceRow]) -> Result<(), Failure> {
    let differs = |(a, b): (&IrradianceRow, &IrradianceRow)| {
        let scale = a.point.position.abs().max_element().max(1e-3);
        (a.point.position - b.point.position).length() > SAME_PLACE * scale
            || a.point.normal.dot(b.point.normal) < 1.0 - SAME_PLACE
    };
    match test.iter().zip(reference).position(differs) {
        Some(i) => {
            let path = hplt_io::sanitized(&path.to_string_lossy());
            let message = format!(
                "{path}: row {}: another point than in the reference; expected the same in the same order",
                i + 1
            );
            Err(Failure::new(Exit::Input, "POINTS_DIFFER", message))
        }
        None => Ok(()),
    }
}

fn pictures(args: &CompareArgs) -> Result<(&'static str, usize, Vec<Figure>), Failure> {
    let [test, reference] = [&args.test, &args.reference].map(|path| read_image(path, &Limits::default()));
    let (test, reference) = (test?, reference?);
    let e = image_error(&test, &reference).map_err(|e| metric_failure(&args.test, &e))?;
    let mean = mean_relative(test.pixels(), reference.pixels());
    if args.max_p95.is_some() {
        return Err(Failure::usage(
            "--max-p95 is for tables; expected --max-mean, --max-rms, --max-relmse or --max-bias",
        ));
    }
    let figure = |name, value, is_fraction, limit| Figure { name, value, is_fraction, limit };
    Ok((
        "pixels",
        e.n,
        vec![
            figure("mean", mean, true, args.max_mean),
            figure("rmse", e.rmse, false, args.max_rms),
            figure("relmse", e.rel_mse, false, args.max_relmse),
            figure("relmse trimmed", e.rel_mse_trimmed, false, None),
            figure("bias", e.bias, true, args.max_bias),
        ],
    ))
}

/// Mean relative error of the luminance of pixels, with the floor of tables.
fn mean_relative(test: &[Rgb], reference: &[Rgb]) -> f64 {
    irradiance_error(test, reference).map_or(f64::NAN, |e| e.mean)
}

fn metric_failure(path: &Path, error: &hplt_reference::Error) -> Failure {
    let exit = match error {
        hplt_reference::Error::NotFinite { .. } => Exit::NotFinite,
        _ => Exit::Input,
    };
    Failure::new(exit, "COMPARE", format!("{}: {error}", hplt_io::sanitized(&path.to_string_lossy())))
}
