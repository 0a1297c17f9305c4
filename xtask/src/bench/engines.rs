//! The ways to light a scene that are measured.

use super::scenes::Case;

/// A way to light a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Engine {
    /// Short name: names of files, `--engine`.
    pub id: &'static str,
    /// Name in tables.
    pub title: &'static str,
    /// Which published variant it is.
    pub variant: Variant,
    preset: &'static str,
    flags: &'static [&'static str],
    quick_flags: &'static [&'static str],
}

/// What an engine is compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// Ours alone.
    Links,
    /// The original.
    V1,
    /// The optimised one.
    V3,
}

const V3_FLAGS: &[&str] = &["--variant", "absolute", "--reconstruction", "nearest", "--rays", "256"];
const QUICK_V3_FLAGS: &[&str] =
    &["--variant", "absolute", "--reconstruction", "nearest", "--rays", "128", "--levels", "4"];

/// All engines, in the order of the tables.
pub const ENGINES: [Engine; 4] = [
    Engine {
        id: "production",
        title: "links, production",
        variant: Variant::Links,
        preset: "production",
        flags: &[],
        quick_flags: &["--levels", "4", "--rays", "128"],
    },
    Engine {
        id: "preview",
        title: "links, preview",
        variant: Variant::Links,
        preset: "preview",
        flags: &[],
        quick_flags: &[],
    },
    Engine {
        id: "v1",
        title: "V1, original",
        variant: Variant::V1,
        preset: "slides",
        flags: &[],
        quick_flags: &["--levels", "4", "--rays", "128"],
    },
    Engine {
        id: "v3",
        title: "V3, optimised",
        variant: Variant::V3,
        preset: "slides",
        flags: V3_FLAGS,
        quick_flags: QUICK_V3_FLAGS,
    },
];

impl Engine {
    /// Flags of every command that lights a scene or reads the light.
    pub fn flags(&self, case: &Case, is_quick: bool) -> Vec<String> {
        let own = if is_quick { self.quick_flags } else { self.flags };
        self.with_flags(case, own)
    }

    /// The same with other flags in place of its own.
    pub fn with_flags(&self, case: &Case, own: &[&str]) -> Vec<String> {
        let mut flags = vec!["--preset", self.preset];
        if self.variant != Variant::Links {
            flags.extend(["--threshold", case.slides_threshold]);
        }
        flags.extend(own);
        flags.into_iter().map(str::to_owned).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::scenes::CASES;
    use super::*;

    #[test]
    fn the_published_variants_take_the_threshold_of_the_scene_and_links_none() {
        for engine in ENGINES {
            let flags = engine.flags(&CASES[2], false);
            let threshold = flags.windows(2).find(|pair| pair[0] == "--threshold").map(|pair| pair[1].as_str());
            assert_eq!(threshold, (engine.variant != Variant::Links).then_some("0.15"), "{}", engine.id);
        }
    }

    #[test]
    fn quick_runs_do_less() {
        for engine in ENGINES.iter().filter(|e| e.id != "preview") {
            let [full, quick] = [false, true].map(|quick| engine.flags(&CASES[0], quick).join(" "));
            assert!(quick.contains("--levels 4 --rays 128") || quick.contains("--rays 128 --levels 4"), "{quick}");
            assert!(!full.contains("--levels"), "{full}");
        }
    }
}
