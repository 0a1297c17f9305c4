//! The config file, and how it is put together with flags and presets.

use std::fmt::Write;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::exit::Failure;
use crate::lights::LightSpec;
use crate::sections::{RenderSection, RunSection, SceneSection, SolveSection};

/// A config file is refused beyond this size.
const MAX_BYTES: u64 = 1 << 20;

/// Everything that can be set, by table.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// How the scene is read.
    pub scene: SceneSection,
    /// How light is computed.
    pub solve: SolveSection,
    /// How pictures are made.
    pub render: RenderSection,
    /// How the program runs.
    pub run: RunSection,
    /// Lights that the scene file lacks.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub light: Vec<LightSpec>,
}

impl Config {
    /// The config in a TOML file. Environment files in it are relative to it.
    ///
    /// # Errors
    /// When the file cannot be read, is too large, or holds a key or value that is not known.
    pub fn load(path: &Path) -> Result<Self, Failure> {
        let shown = hplt_io::sanitized(&path.to_string_lossy());
        let fail = |what: String| Failure::usage(format!("{shown}: {what}"));
        let metadata = std::fs::metadata(path).map_err(|e| fail(format!("cannot be read: {e}")))?;
        if !metadata.is_file() {
            return Err(fail("is not a regular file; expected a TOML file".into()));
        }
        if metadata.len() > MAX_BYTES {
            return Err(fail(format!("{} bytes exceed the limit of {MAX_BYTES}", metadata.len())));
        }
        let text = std::fs::read_to_string(path).map_err(|e| fail(format!("cannot be read: {e}")))?;
        let config: Self = toml::from_str(&text).map_err(|e| fail(toml_problem(&text, &e)))?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let light = config.light.into_iter().map(|l| l.in_folder(folder)).collect();
        Ok(Self { light, ..config })
    }

    /// These values, and where one is not set that of `below`. Lights add up.
    pub fn or(self, below: Self) -> Self {
        Self {
            scene: self.scene.or(below.scene),
            solve: self.solve.or(below.solve),
            render: self.render.or(below.render),
            run: self.run.or(below.run),
            light: below.light.into_iter().chain(self.light).collect(),
        }
    }
}

/// The effective values as TOML, each with a comment that says where it comes from. Reads back to the same values.
pub fn with_origins(effective: &Config, flags: &Config, file: &Config) -> String {
    let tables = [flags, file].map(|config| toml::Table::try_from(config).unwrap_or_default());
    let mut out = String::new();
    for (table, values) in toml::Table::try_from(effective).unwrap_or_default() {
        let Some(values) = values.as_table() else { continue };
        let _ = writeln!(out, "[{table}]");
        for (key, value) in values {
            let is_set = |t: &toml::Table| t.get(&table).and_then(|t| t.get(key)).is_some();
            let origin = match (is_set(&tables[0]), is_set(&tables[1])) {
                (true, _) => "flag",
                (_, true) => "config file",
                _ => "default",
            };
            let _ = writeln!(out, "{key} = {value}  # {origin}");
        }
        out.push('\n');
    }
    for light in &effective.light {
        let origin = if flags.light.contains(light) { "flag" } else { "config file" };
        let _ = writeln!(out, "[[light]]  # {origin}\n{}", toml::to_string(light).unwrap_or_default());
    }
    out
}

/// What is wrong and where, in one line.
fn toml_problem(text: &str, error: &toml::de::Error) -> String {
    let message = error.message().lines().collect::<Vec<_>>().join("; ");
    match error.span() {
        Some(span) => {
            let line = text.as_bytes()[..span.start.min(text.len())].iter().filter(|&&b| b == b'\n').count() + 1;
            format!("line {line}: {message}")
        }
        None => message,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sections::{Preset, Variant};
    use crate::values::Radius;

    fn parse(text: &str) -> Result<Config, Failure> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("job.toml");
        std::fs::write(&path, text).unwrap();
        Config::load(&path)
    }

    const EXAMPLE: &str = r#"
        [solve]
        preset = "preview"
        radius = "8.5%"
        tolerance = 0.01
        seed = 7
        [render]
        size = "64x48"
        eye = [1, 2.5, 3]
        [[light]]
        kind = "sun"
        name = "morning"
        direction = [0.15, 1, 0.12]
        irradiance = [10, 10, 10]
        angular_radius = 0.27
        [[light]]
        kind = "environment"
        file = "sky.hdr"
    "#;

    #[test]
    fn a_file_is_read_and_returns() {
        let config = parse(EXAMPLE).unwrap();
        assert_eq!(config.solve.preset, Some(Preset::Preview));
        assert_eq!(config.solve.radius, Some(Radius::OfDiagonal(0.085)));
        assert_eq!(config.light.len(), 2);
        assert!(matches!(&config.light[0], LightSpec::Sun { name: Some(name), .. } if name == "morning"));
        assert!(matches!(&config.light[1], LightSpec::Environment { file, .. } if file.is_absolute()));
        assert_eq!(toml::from_str::<Config>(&toml::to_string(&config).unwrap()).unwrap(), config);
    }

    #[test]
    fn flags_win_over_the_file_and_origins_are_told() {
        let file = parse(EXAMPLE).unwrap();
        let mut flags = Config::default();
        flags.solve.seed = Some(9);
        flags.solve.variant = Some(Variant::Delta);
        let effective = flags.clone().or(file.clone());
        assert_eq!((effective.solve.seed, effective.solve.preset), (Some(9), Some(Preset::Preview)));
        let text = with_origins(&effective, &flags, &file);
        assert!(text.contains("seed = 9  # flag") && text.contains("radius = \"8.5%\"  # config file"), "{text}");
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), effective);
    }

    #[test]
    fn unknown_keys_wrong_types_and_duplicates_are_refused_with_their_line() {
        for (text, line) in [
            ("[solve]\nrayz = 5", "line 2"),
            ("[solv]\n", "line 1"),
            ("[solve]\nrays = \"many\"", "line 2"),
            ("[solve]\nseed = 1\nseed = 2", "line 3"),
            ("[solve]\nrays = 99999999999999999999", "line 2"),
            ("[[light]]\nkind = \"laser\"", "line 2"),
            ("[[light]]\nkind = \"sky\"\nradiance = [1, 1, 1]\nradiance2 = 3", "line 1"),
            ("[solve]\nradius = -1", "line 2"),
            ("[solve", "line 1"),
        ] {
            let failure = parse(text).unwrap_err();
            assert_eq!(failure.exit, crate::exit::Exit::Usage);
            assert!(failure.message.contains(line), "{text:?}: {failure}");
        }
        let nested = format!("a = {}1{}", "[".repeat(100_000), "]".repeat(100_000));
        assert!(parse(&nested).is_err());
    }
}
