//! Values with units, as flags and config files spell them.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// A Poisson radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Radius {
    /// In world units.
    World(f64),
    /// As a fraction of the scene's diagonal.
    OfDiagonal(f64),
}

/// A fraction, written as `0.3%` or `0.003`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fraction(pub f64);

/// A stop tolerance, or `none`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tolerance(pub Option<f64>);

/// A count of bytes: `8GB`, `512MiB`, `1e9`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bytes(pub u64);

/// A span of time: `90s`, `2m`, `1h`, `500ms`, or a number of seconds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seconds(pub f64);

/// The size of a picture: `640x480`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
}

/// Three numbers: `x,y,z`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Triple(pub [f64; 3]);

impl FromStr for Radius {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (number, is_percent) = match text.trim().strip_suffix('%') {
            Some(number) => (number, true),
            None => (text, false),
        };
        let value = positive(number, "a length above 0, in world units or with % of the scene's diagonal")?;
        Ok(if is_percent { Self::OfDiagonal(value / 100.0) } else { Self::World(value) })
    }
}

impl fmt::Display for Radius {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::World(length) => write!(f, "{length}"),
            Self::OfDiagonal(fraction) => write!(f, "{}%", percent(*fraction)),
        }
    }
}

impl FromStr for Fraction {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const EXPECTED: &str = "a fraction above 0, such as 0.3% or 0.003";
        match text.trim().strip_suffix('%') {
            Some(number) => Ok(Self(positive(number, EXPECTED)? / 100.0)),
            None => Ok(Self(positive(text, EXPECTED)?)),
        }
    }
}

impl fmt::Display for Fraction {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}%", percent(self.0))
    }
}

impl FromStr for Tolerance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text.trim() == "none" {
            return Ok(Self(None));
        }
        let Fraction(value) =
            text.parse().map_err(|_| format!("\"{text}\"; expected a fraction above 0, such as 0.1%, or none"))?;
        Ok(Self(Some(value)))
    }
}

impl fmt::Display for Tolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            None => f.write_str("none"),
            Some(value) => write!(f, "{}%", percent(value)),
        }
    }
}

impl FromStr for Bytes {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const EXPECTED: &str = "a size above 0, such as 8GB, 512MiB or 1e9";
        let text = text.trim();
        let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let factor = match text[number.len()..].to_ascii_lowercase().as_str() {
            "" | "b" => 1.0,
            "k" | "kb" => 1e3,
            "m" | "mb" => 1e6,
            "g" | "gb" => 1e9,
            "t" | "tb" => 1e12,
            "kib" => 1024.0,
            "mib" => 1024.0 * 1024.0,
            "gib" => 1024.0 * 1024.0 * 1024.0,
            "tib" => 1024.0f64.powi(4),
            _ => return Err(format!("\"{text}\"; expected {EXPECTED}")),
        };
        let bytes = positive(number, EXPECTED)? * factor;
        if bytes < 1.0 || bytes > u64::MAX as f64 {
            return Err(format!("\"{text}\"; expected {EXPECTED}"));
        }
        Ok(Self(bytes as u64))
    }
}

impl fmt::Display for Bytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

impl FromStr for Seconds {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const EXPECTED: &str = "a time above 0, such as 90s, 2m or 500ms";
        let text = text.trim();
        let number = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let factor = match &text[number.len()..] {
            "" | "s" => 1.0,
            "ms" => 1e-3,
            "m" | "min" => 60.0,
            "h" => 3600.0,
            _ => return Err(format!("\"{text}\"; expected {EXPECTED}")),
        };
        Ok(Self(positive(number, EXPECTED)? * factor))
    }
}

impl fmt::Display for Seconds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}s", self.0)
    }
}

impl FromStr for Size {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        const MAX_SIDE: usize = 16_384;
        let bad = || format!("\"{text}\"; expected WIDTHxHEIGHT in pixels, each from 1 to {MAX_SIDE}");
        let (width, height) = text.split_once(['x', 'X']).ok_or_else(bad)?;
        let side = |text: &str| match text.trim().parse::<usize>() {
            Ok(n) if (1..=MAX_SIDE).contains(&n) => Ok(n),
            _ => Err(bad()),
        };
        Ok(Self { width: side(width)?, height: side(height)? })
    }
}

impl fmt::Display for Size {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}x{}", self.width, self.height)
    }
}

impl FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let bad = || format!("\"{text}\"; expected three finite numbers with commas between them");
        let numbers = text.split(',').map(|t| t.trim().parse::<f64>()).collect::<Result<Vec<_>, _>>();
        let numbers: [f64; 3] = numbers.map_err(|_| bad())?.try_into().map_err(|_| bad())?;
        if numbers.iter().all(|x| x.is_finite()) { Ok(Self(numbers)) } else { Err(bad()) }
    }
}

impl fmt::Display for Triple {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [x, y, z] = self.0;
        write!(f, "{x},{y},{z}")
    }
}

/// `n` bytes for people: `1.3 GB`.
pub fn human_bytes(n: u64) -> String {
    let units = ["B", "kB", "MB", "GB", "TB", "PB", "EB"];
    let mut value = n as f64;
    let mut unit = 0;
    while value >= 999.5 && unit + 1 < units.len() {
        value /= 1000.0;
        unit += 1;
    }
    match unit {
        0 => format!("{n} B"),
        _ if value < 10.0 => format!("{value:.1} {}", units[unit]),
        _ => format!("{value:.0} {}", units[unit]),
    }
}

/// `n` with thin groups of three digits: `167 093`.
pub fn human_count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(digit);
    }
    out
}

/// A fraction in per cent: `0.83 %`.
pub fn human_percent(fraction: f64) -> String {
    let value = 100.0 * fraction;
    match value.abs() {
        x if x >= 99.5 => format!("{value:.0} %"),
        x if x >= 9.95 => format!("{value:.1} %"),
        x if x >= 0.1 || x == 0.0 => format!("{value:.2} %"),
        _ => format!("{value:.1e} %"),
    }
}

/// 100 times a fraction, without the tail that binary floating point adds (0.085 → 8.5).
fn percent(fraction: f64) -> f64 {
    let shown = 100.0 * fraction;
    let rounded = (shown * 1e9).round() / 1e9;
    if rounded == 0.0 { shown } else { rounded }
}

fn positive(text: &str, expected: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err(format!("\"{}\"; expected {expected}", text.trim())),
    }
}

/// A value of a config file: text, or a bare number.
#[derive(Deserialize)]
#[serde(untagged)]
enum Raw {
    Integer(i64),
    Number(f64),
    Text(String),
    List([f64; 3]),
}

impl fmt::Display for Raw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Integer(value) => write!(f, "{value}"),
            Self::Number(value) => write!(f, "{value}"),
            Self::Text(text) => f.write_str(text),
            Self::List([x, y, z]) => write!(f, "{x},{y},{z}"),
        }
    }
}

macro_rules! in_config_files {
    ($($kind:ty),*) => {$(
        impl<'de> Deserialize<'de> for $kind {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                Raw::deserialize(deserializer)?.to_string().parse().map_err(serde::de::Error::custom)
            }
        }

        impl Serialize for $kind {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }
    )*};
}

in_config_files!(Radius, Fraction, Tolerance, Bytes, Seconds, Size, Triple);

#[cfg(test)]
mod tests {
    use super::*;

    fn returns<T: FromStr<Err = String> + fmt::Display + PartialEq + fmt::Debug>(text: &str) -> T {
        let value: T = text.parse().unwrap();
        assert_eq!(value.to_string().parse::<T>().unwrap(), value, "{text}");
        value
    }

    #[test]
    fn values_with_units_are_read_and_return() {
        assert_eq!(returns::<Radius>("8.5%"), Radius::OfDiagonal(0.085));
        assert_eq!(returns::<Radius>("0.25"), Radius::World(0.25));
        assert_eq!(returns::<Fraction>("0.3%").0, 0.003);
        assert_eq!(returns::<Tolerance>("none").0, None);
        assert_eq!(returns::<Tolerance>("0.1%").0, Some(0.001));
        assert_eq!(returns::<Bytes>("8GB").0, 8_000_000_000);
        assert_eq!(returns::<Bytes>("512MiB").0, 512 << 20);
        assert_eq!(returns::<Seconds>("2m").0, 120.0);
        assert_eq!(returns::<Seconds>("500ms").0, 0.5);
        assert_eq!(returns::<Size>("640x480"), Size { width: 640, height: 480 });
        assert_eq!(returns::<Triple>("-1, 2.5,3e2").0, [-1.0, 2.5, 300.0]);
    }

    #[test]
    fn zero_negative_and_unknown_values_are_refused() {
        for text in ["0", "-1", "nan", "inf", "", "x", "0%"] {
            assert!(text.parse::<Radius>().is_err(), "{text}");
            assert!(text.parse::<Fraction>().is_err(), "{text}");
            assert!(text.parse::<Tolerance>().is_err(), "{text}");
            assert!(text.parse::<Bytes>().is_err(), "{text}");
            assert!(text.parse::<Seconds>().is_err(), "{text}");
            assert!(text.parse::<Size>().is_err(), "{text}");
            assert!(text.parse::<Triple>().is_err(), "{text}");
        }
        assert!("5parsecs".parse::<Seconds>().is_err() && "5XB".parse::<Bytes>().is_err());
        assert!("0x3".parse::<Size>().is_err() && "1,2,nan".parse::<Triple>().is_err());
    }

    #[test]
    fn numbers_for_people() {
        assert_eq!((human_bytes(12), human_bytes(1_250_000_000)), ("12 B".into(), "1.2 GB".into()));
        assert_eq!((human_count(7), human_count(1_167_093)), ("7".into(), "1 167 093".into()));
        assert_eq!((human_percent(0.0083), human_percent(1e-6)), ("0.83 %".into(), "1.0e-4 %".into()));
    }
}
