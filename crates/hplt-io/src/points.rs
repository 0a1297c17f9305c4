use std::io::{BufWriter, Write};
use std::path::Path;

use glam::{DVec3, Vec3};
use hplt_geom::Rgb;

use crate::files::{any_content, read_regular};
use crate::{Error, Limits, write_atomically};

/// The columns that [`write_irradiance_csv`] writes, in order.
pub const IRRADIANCE_COLUMNS: [&str; 15] =
    ["x", "y", "z", "nx", "ny", "nz", "Ed_r", "Ed_g", "Ed_b", "Ei_r", "Ei_g", "Ei_b", "E_r", "E_g", "E_b"];

/// A place where irradiance is asked for, world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SensorPoint {
    /// Position.
    pub position: DVec3,
    /// Unit normal.
    pub normal: DVec3,
}

/// The irradiance at one place, W/m².
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IrradianceRow {
    /// The place.
    pub point: SensorPoint,
    /// Light that arrives straight from emitters.
    pub direct: Rgb,
    /// Light that arrives after one reflection or more.
    pub indirect: Rgb,
    /// All light.
    pub total: Rgb,
}

/// Sensor points from a table with a row `x,y,z,nx,ny,nz` each.
///
/// A first row with names is optional; with it, columns may stand in any order among others. Columns are separated by
/// commas, semicolons, tabs or spaces, so Radiance's `.pts` files are read too. Empty lines and lines that start with
/// `#` are skipped. Normals are brought to unit length.
///
/// # Errors
/// Naming line and column, when a number is missing, malformed, not finite or beyond 1e18, or a normal has no length.
pub fn read_points_csv(path: &Path, limits: &Limits) -> Result<Vec<SensorPoint>, Error> {
    let bytes = read_regular(path, limits.file_bytes, any_content)?;
    let table = Table::parse(&bytes, &IRRADIANCE_COLUMNS[..6], limits).map_err(|e| e.in_file(path))?;
    table.rows().map(|(line, row)| sensor_point(line, row)).collect::<Result<_, _>>().map_err(|e| e.in_file(path))
}

/// Writes the table of irradiance to a file, atomically; see [`write_irradiance_rows`].
///
/// # Errors
/// [`Error::Write`] when the file cannot be written.
pub fn write_irradiance_csv(path: &Path, rows: &[IrradianceRow]) -> Result<(), Error> {
    write_atomically(path, |file| {
        let mut writer = BufWriter::new(file);
        write_irradiance_rows(&mut writer, rows)?;
        writer.flush()
    })
}

/// Writes a row with the names [`IRRADIANCE_COLUMNS`] and a row per point; numbers have as many digits as it takes to
/// read the same bits back.
///
/// # Errors
/// Those of `writer`.
pub fn write_irradiance_rows(writer: &mut impl Write, rows: &[IrradianceRow]) -> std::io::Result<()> {
    writeln!(writer, "{}", IRRADIANCE_COLUMNS.join(","))?;
    for IrradianceRow { point, direct, indirect, total } in rows {
        for (i, value) in point.position.to_array().into_iter().chain(point.normal.to_array()).enumerate() {
            write!(writer, "{}{value}", if i == 0 { "" } else { "," })?;
        }
        for value in [direct, indirect, total].into_iter().flat_map(|rgb| rgb.to_array()) {
            write!(writer, ",{value}")?;
        }
        writeln!(writer)?;
    }
    Ok(())
}

/// A table of irradiance as [`write_irradiance_csv`] writes it. Irradiance may be infinite or NaN, so that a comparison
/// can find it.
///
/// # Errors
/// Naming line and column, as [`read_points_csv`].
pub fn read_irradiance_csv(path: &Path, limits: &Limits) -> Result<Vec<IrradianceRow>, Error> {
    let bytes = read_regular(path, limits.file_bytes, any_content)?;
    let read = |bytes: &[u8]| -> Result<Vec<IrradianceRow>, Error> {
        let table = Table::parse(bytes, &IRRADIANCE_COLUMNS, limits)?;
        table
            .rows()
            .map(|(line, row)| {
                let rgb = |first: usize| Vec3::new(row[first] as f32, row[first + 1] as f32, row[first + 2] as f32);
                let point = sensor_point(line, &row[..6])?;
                Ok(IrradianceRow { point, direct: rgb(6), indirect: rgb(9), total: rgb(12) })
            })
            .collect()
    };
    read(&bytes).map_err(|e| e.in_file(path))
}

/// Numbers by row, in the order of the columns asked for.
struct Table {
    n_columns: usize,
    values: Vec<f64>,
    lines: Vec<u64>,
}

impl Table {
    fn parse(bytes: &[u8], columns: &[&str], limits: &Limits) -> Result<Self, Error> {
        let mut table = Self { n_columns: columns.len(), values: Vec::new(), lines: Vec::new() };
        let mut order: Option<Vec<usize>> = None;
        let mut n_cells = columns.len();
        for (i, line) in bytes.split(|&b| b == b'\n').enumerate() {
            let number = i as u64 + 1;
            let place = || format!("line {number}");
            if line.len() as u64 > limits.line_bytes {
                return Err(Error::limit(place(), "LIMIT_LINE", "bytes", line.len() as u64, limits.line_bytes));
            }
            let text = std::str::from_utf8(line).map_err(|_| Error::invalid(place(), "TABLE_TEXT", "is not UTF-8"))?;
            let text = text.trim_start_matches('\u{feff}').trim();
            if text.is_empty() || text.starts_with('#') {
                continue;
            }
            let cells = cells(text);
            if order.is_none() {
                if cells[0].parse::<f64>().is_err() {
                    n_cells = cells.len();
                    order = Some(header_order(&cells, columns, number)?);
                    continue;
                }
                order = Some((0..columns.len()).collect());
            }
            if cells.len() != n_cells {
                let message = format!("{} columns; expected {n_cells} ({})", cells.len(), columns.join(","));
                return Err(Error::invalid(place(), "TABLE_COLUMNS", message));
            }
            for (&column, name) in order.iter().flatten().zip(columns) {
                let value = cells[column].parse().map_err(|_| {
                    let message = format!("\"{}\"; expected a number", crate::sanitized(cells[column]));
                    Error::invalid(format!("line {number}, column {} ({name})", column + 1), "TABLE_NUMBER", message)
                })?;
                table.values.push(value);
            }
            table.lines.push(number);
        }
        Ok(table)
    }

    /// Line number and values of every row.
    fn rows(&self) -> impl Iterator<Item = (u64, &[f64])> {
        self.lines.iter().copied().zip(self.values.chunks_exact(self.n_columns))
    }
}

fn cells(line: &str) -> Vec<&str> {
    let separator = [',', ';', '\t'].into_iter().find(|&c| line.contains(c));
    match separator {
        Some(separator) => line.split(separator).map(|cell| cell.trim().trim_matches('"')).collect(),
        None => line.split_whitespace().collect(),
    }
}

/// The position of each wanted column in the row of names.
fn header_order(header: &[&str], columns: &[&str], line: u64) -> Result<Vec<usize>, Error> {
    let place = || format!("line {line}");
    columns
        .iter()
        .map(|wanted| {
            let mut found = header.iter().enumerate().filter(|(_, name)| name == &wanted);
            match (found.next(), found.next()) {
                (Some((position, _)), None) => Ok(position),
                (None, _) => {
                    let message = format!("no column \"{wanted}\"; expected {}", columns.join(","));
                    Err(Error::invalid(place(), "TABLE_COLUMNS", message))
                }
                _ => Err(Error::invalid(place(), "TABLE_COLUMNS", format!("column \"{wanted}\" occurs twice"))),
            }
        })
        .collect()
}

fn sensor_point(line: u64, row: &[f64]) -> Result<SensorPoint, Error> {
    for (value, name) in row[..6].iter().zip(IRRADIANCE_COLUMNS) {
        if !value.is_finite() || value.abs() > 1e18 {
            let code = if value.is_finite() { "VALUE_NOT_IN_RANGE" } else { "VALUE_NOT_FINITE" };
            return Err(Error::invalid(format!("line {line}, {name}"), code, format!("{value}; expected |x| <= 1e18")));
        }
    }
    let position = DVec3::new(row[0], row[1], row[2]);
    let given = DVec3::new(row[3], row[4], row[5]);
    let normal = given.try_normalize().ok_or_else(|| {
        Error::invalid(format!("line {line}, normal"), "VALUE_NOT_IN_RANGE", "has no length; expected a direction")
    })?;
    // What is a unit vector already, to the precision of the file, keeps its bits.
    let normal = if (given.length() - 1.0).abs() < 1e-12 { given } else { normal };
    Ok(SensorPoint { position, normal })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(text: &str) -> Result<Vec<SensorPoint>, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.csv");
        std::fs::write(&path, text).unwrap();
        read_points_csv(&path, &Limits::default())
    }

    fn failure(text: &str) -> (String, &'static str) {
        let error = points(text).unwrap_err();
        let text = error.to_string();
        (text.split_once("points.csv: ").unwrap().1.to_owned(), error.code())
    }

    #[test]
    fn tables_with_and_without_names_and_radiance_files_are_read() {
        let expected = [SensorPoint { position: DVec3::new(1.0, 2.5, -3e-3), normal: DVec3::Y }];
        for text in [
            "x,y,z,nx,ny,nz\n1,2.5,-3e-3,0,1,0\n",
            "\u{feff}x,y,z,nx,ny,nz\r\n1,2.5,-3e-3,0,2,0\r\n\r\n",
            "1,2.5,-3e-3,0,1,0",
            "# sensors\n 1 2.5  -3e-3 0 1 0\n",
            "1\t2.5\t-3e-3\t0\t1\t0\n",
            "name;nx;ny;nz;x;y;z\na;0;1;0;1;2.5;-0.003\n",
        ] {
            assert_eq!(points(text).unwrap(), expected, "{text}");
        }
        assert_eq!(points("").unwrap(), []);
    }

    #[test]
    fn errors_name_line_and_column() {
        let (text, code) = failure("x,y,z,nx,ny,nz\n1,2,3,0,1,0\n1,2,drei,0,1,0\n");
        assert_eq!((&text[..], code), ("line 3, column 3 (z): \"drei\"; expected a number", "TABLE_NUMBER"));
        assert_eq!(failure("x,y,nx,ny,nz\n").1, "TABLE_COLUMNS");
        assert_eq!(failure("x,x,y,z,nx,ny,nz\n").1, "TABLE_COLUMNS");
        assert_eq!(failure("1 2 3 0 1\n"), ("line 1: 5 columns; expected 6 (x,y,z,nx,ny,nz)".into(), "TABLE_COLUMNS"));
        assert_eq!(failure("1 2 nan 0 1 0\n"), ("line 1, z: NaN; expected |x| <= 1e18".into(), "VALUE_NOT_FINITE"));
        assert_eq!(failure("1 2 1e19 0 1 0\n").1, "VALUE_NOT_IN_RANGE");
        assert_eq!(failure("1 2 3 0 0 0\n").1, "VALUE_NOT_IN_RANGE");
    }

    #[test]
    fn irradiance_returns_bit_by_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("e.csv");
        let rows: Vec<IrradianceRow> = (1..50)
            .map(|i| {
                let x = f64::from(i);
                let point = SensorPoint {
                    position: DVec3::new(x / 3.0, -x.sqrt(), 1e-9 * x),
                    normal: DVec3::new(x, 1.0, -2.0).normalize(),
                };
                let rgb = |k: f32| Vec3::new(k / 3.0, k * 1e-20, k * 1e20);
                IrradianceRow { point, direct: rgb(i as f32), indirect: rgb(0.1), total: rgb(i as f32 + 0.1) }
            })
            .collect();
        write_irradiance_csv(&path, &rows).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("x,y,z,nx,ny,nz,Ed_r,Ed_g,Ed_b,Ei_r,Ei_g,Ei_b,E_r,E_g,E_b\n"));
        assert_eq!(read_irradiance_csv(&path, &Limits::default()).unwrap(), rows);
        assert_eq!(read_points_csv(&path, &Limits::default()).unwrap()[3], rows[3].point);
        std::fs::write(&path, text.replace("E_b\n", "E_q\n")).unwrap();
        assert_eq!(read_irradiance_csv(&path, &Limits::default()).unwrap_err().code(), "TABLE_COLUMNS");
    }
}
