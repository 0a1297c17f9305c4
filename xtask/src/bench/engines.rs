//! The ways to light a scene that are measured.

use super::scenes::{Case, SLIDES_FLAGS};

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
    Engine { id: "v1", title: "V1, original", variant: Variant::V1, preset: "slides", flags: &[], quick_flags: &[] },
    Engine {
        id: "v3",
        title: "V3, optimised",
        variant: Variant::V3,
        preset: "slides",
        flags: &["--variant", "absolute", "--reconstruction", "nearest"],
        quick_flags: &["--variant", "absolute", "--reconstruction", "nearest"],
    },
];

impl Engine {
    /// Flags of every command that lights a scene or reads the light.
    pub fn flags(&self, case: &Case, is_quick: bool) -> Vec<String> {
        let of_case = if is_quick { case.quick_slides_flags } else { SLIDES_FLAGS };
        self.with_flags(
            case,
            if is_quick { self.quick_flags } else { self.flags },
            match self.variant {
                Variant::Links => &[],
                Variant::V1 => of_case[0],
                Variant::V3 => of_case[1],
            },
        )
    }

    /// The same at another budget.
    pub fn flags_at(&self, case: &Case, budget: &[&str]) -> Vec<String> {
        self.with_flags(case, self.flags, budget)
    }

    fn with_flags(&self, case: &Case, own: &[&str], more: &[&str]) -> Vec<String> {
        let mut flags = vec!["--preset", self.preset];
        if self.variant != Variant::Links {
            flags.extend(["--threshold", case.slides_threshold]);
        }
        flags.extend(own);
        flags.extend(more);
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
    fn quick_runs_do_less_and_no_flag_comes_twice() {
        for (engine, case) in ENGINES.iter().flat_map(|e| CASES.iter().map(move |c| (e, c))) {
            for is_quick in [false, true] {
                let flags = engine.flags(case, is_quick);
                let mut names: Vec<&String> = flags.iter().filter(|f| f.starts_with("--")).collect();
                let n_names = names.len();
                names.sort();
                names.dedup();
                assert_eq!(names.len(), n_names, "{flags:?}");
                let says_rays = flags.join(" ").contains("--rays");
                assert!(!is_quick || says_rays || engine.id == "preview", "{flags:?}");
            }
        }
    }
}
