//! The standard scenes, and what was published about theirs in 2010.

use std::path::{Path, PathBuf};

use super::published::{CORNELL, HAPPY, Published, SPONZA};
use crate::shell::root;

/// A scene of the tables.
pub struct Case {
    /// Short name: `--only`, names of files.
    pub id: &'static str,
    /// Name in tables.
    pub title: &'static str,
    /// Scene of the published row.
    pub published: &'static Published,
    /// Of the published variants: threshold, W/m².
    pub slides_threshold: &'static str,
    /// Flags of V1 and V3 in quick runs, in place of [`SLIDES_FLAGS`].
    pub quick_slides_flags: [&'static [&'static str]; 2],
    /// Ways of lighting it that quick runs have no time for.
    pub quick_leaves_out: &'static [&'static str],
    /// Standard error of the full reference, relative.
    pub reference_error: f64,
    /// The same of the quick one.
    pub quick_reference_error: f64,
    /// Paths per point at most of the quick one: what a few seconds allow.
    pub quick_reference_paths: u64,
    /// Whether its published variants have so many functions that curves begin with fewer levels.
    pub has_many_functions: bool,
    /// Whether no ray can leave it.
    pub is_closed: bool,
    file: Option<File>,
    builtin: &'static str,
}

struct File {
    path: &'static str,
    before: &'static str,
    after: &'static str,
    has_textures: bool,
}

/// What the published variants, V1 and V3, are run with beside preset and threshold.
pub const SLIDES_FLAGS: [&[&str]; 2] = [&[], &["--rays", "256"]];
const USUAL_QUICK_SLIDES: [&[&str]; 2] = [&["--levels", "4", "--rays", "128"]; 2];

/// All scenes.
pub const CASES: [Case; 3] = [
    Case {
        id: "cornell",
        title: "Cornell",
        published: &CORNELL,
        slides_threshold: "0.016",
        quick_slides_flags: USUAL_QUICK_SLIDES,
        quick_leaves_out: &[],
        reference_error: 0.003,
        quick_reference_error: 0.01,
        quick_reference_paths: 8192,
        has_many_functions: false,
        is_closed: false,
        file: None,
        builtin: "gen:cornell",
    },
    Case {
        id: "dragon",
        title: "Dragon room",
        published: &HAPPY,
        slides_threshold: "0.016",
        quick_slides_flags: USUAL_QUICK_SLIDES,
        quick_leaves_out: &["v1"],
        reference_error: 0.003,
        quick_reference_error: 0.01,
        quick_reference_paths: 8192,
        has_many_functions: false,
        is_closed: true,
        file: Some(File {
            path: "stanford/dragon_871k.glb",
            before: "gen:room-with=",
            after: ":1.5",
            has_textures: false,
        }),
        builtin: "gen:statue-room",
    },
    Case {
        id: "sponza",
        title: "Sponza",
        published: &SPONZA,
        slides_threshold: "0.15",
        quick_slides_flags: [&["--levels", "1", "--rays", "64"]; 2],
        quick_leaves_out: &["v1"],
        reference_error: 0.008,
        quick_reference_error: 0.02,
        quick_reference_paths: 8192,
        has_many_functions: true,
        is_closed: false,
        file: Some(File { path: "sponza/sponza_lit.gltf", before: "", after: "", has_textures: true }),
        builtin: "gen:colonnade",
    },
];

/// What is lit in place of a case.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Source {
    /// For the command line.
    pub argument: String,
    /// Names files that depend on it.
    pub id: String,
    /// For tables.
    pub title: String,
    /// Whether a procedural scene takes the place of a file that is not there.
    pub is_stand_in: bool,
    /// Whether it is a file with textures.
    pub has_textures: bool,
}

impl Case {
    /// The scene itself where its file lies in `folder`, else its stand-in.
    pub fn source(&self, folder: &Path) -> Source {
        let own = |argument, has_textures| Source {
            argument,
            id: self.id.into(),
            title: self.title.into(),
            is_stand_in: false,
            has_textures,
        };
        let Some(file) = &self.file else { return own(self.builtin.into(), false) };
        let path = folder.join(file.path);
        if path.is_file() {
            return own(format!("{}{}{}", file.before, path.display(), file.after), file.has_textures);
        }
        let name = self.builtin.trim_start_matches("gen:");
        Source {
            argument: self.builtin.into(),
            id: name.into(),
            title: format!("{} (stand-in: {name})", self.title),
            is_stand_in: true,
            has_textures: false,
        }
    }
}

impl Source {
    /// The same scene as everybody can light it: without textures, of which only the mean colours are left.
    pub fn flat(&self) -> Self {
        if !self.has_textures {
            return self.clone();
        }
        Self {
            argument: format!("gen:flat={}", self.argument),
            id: format!("{}-flat", self.id),
            title: format!("{} in flat colours", self.title),
            has_textures: false,
            ..self.clone()
        }
    }
}

/// The folder of scene files: as asked, else `HPLT_SCENES`, else `../shared/scenes` beside the checkout.
pub fn folder(asked: Option<&Path>) -> PathBuf {
    let beside = || root().join("..").join("shared").join("scenes");
    let folder = match asked {
        Some(path) => path.to_path_buf(),
        None => std::env::var_os("HPLT_SCENES").map_or_else(beside, PathBuf::from),
    };
    folder.canonicalize().unwrap_or(folder)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_file_gives_the_stand_in_and_its_title_says_so() {
        let nowhere = Path::new("no/such/folder");
        let sources: Vec<Source> = CASES.iter().map(|c| c.source(nowhere)).collect();
        assert_eq!(sources[0].argument, "gen:cornell");
        assert!(!sources[0].is_stand_in);
        for (source, name) in sources[1..].iter().zip(["statue-room", "colonnade"]) {
            assert_eq!((source.argument.as_str(), source.is_stand_in), (format!("gen:{name}").as_str(), true));
            assert!(source.title.contains(&format!("stand-in: {name}")), "{}", source.title);
        }
    }

    #[test]
    fn a_file_that_is_there_is_lit() {
        let folder = std::env::temp_dir().join(format!("hplt-bench-{}", std::process::id()));
        let path = folder.join("stanford/dragon_871k.glb");
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, "").unwrap();
        let source = CASES[1].source(&folder);
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(source.argument, format!("gen:room-with={}:1.5", path.display()));
        assert_eq!((source.id.as_str(), source.is_stand_in), ("dragon", false));
    }

    #[test]
    fn what_has_textures_is_another_scene_in_flat_colours() {
        let nowhere = Path::new("no/such/folder");
        assert!(CASES.iter().map(|c| c.source(nowhere)).all(|source| source.flat() == source));
        let textured = Source { argument: "hall.gltf".into(), has_textures: true, ..CASES[0].source(nowhere) };
        let flat = textured.flat();
        assert_eq!((flat.argument.as_str(), flat.id.as_str()), ("gen:flat=hall.gltf", "cornell-flat"));
        assert!(flat.title.contains("flat colours") && flat.flat() == flat);
    }

    #[test]
    fn ids_are_distinct() {
        let mut ids: Vec<&str> = CASES.iter().map(|c| c.id).collect();
        ids.dedup();
        assert_eq!(ids, ["cornell", "dragon", "sponza"]);
    }
}
