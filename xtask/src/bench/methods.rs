//! The methods whose error is measured against their time, each at several budgets.

use super::engines::{ENGINES, Engine, Variant};
use super::measure::strings;
use super::scenes::{Case, Source};

/// Paths per point of the path tracer.
const PATHS: [u32; 5] = [256, 512, 1024, 2048, 4096];
/// Its seed: another than that of the reference, whose own noise it would share.
const PATHS_SEED: &str = "1";

/// Levels, rays per gather, rays of the final gather.
type Budget = [u32; 3];

const LINKS: [Budget; 6] = [[1, 32, 64], [2, 64, 64], [3, 128, 128], [3, 128, 512], [3, 256, 1024], [3, 256, 4096]];
const V1: [Budget; 5] = [[1, 32, 64], [2, 32, 128], [2, 64, 256], [3, 128, 512], [4, 256, 1024]];
const V3: [Budget; 5] = [[1, 32, 64], [2, 64, 128], [3, 128, 256], [4, 128, 512], [5, 256, 1024]];
/// Where the functions of a level are many.
const V1_LARGE: [Budget; 5] = [[1, 8, 64], [1, 16, 128], [1, 32, 256], [1, 64, 512], [2, 32, 1024]];
const V3_LARGE: [Budget; 5] = [[1, 16, 64], [1, 64, 128], [2, 64, 256], [2, 128, 512], [3, 256, 1024]];
/// Radii of the only level, per cent of the diagonal, beside the rays of [`LINKS`].
const RADII: [&str; 5] = ["8.5%", "4.25%", "2.125%", "1.0625%", "0.53125%"];

/// One method.
#[derive(Debug, Clone, PartialEq)]
pub struct Method {
    /// In legends.
    pub title: String,
    /// From the quickest.
    pub settings: Vec<Setting>,
}

/// One budget of a method.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// The flags that differ from one setting to the next.
    pub shown: String,
    /// The quantity that is varied, where it is a number.
    pub value: Option<f64>,
    /// Arguments of the command, without the points and without the table to write.
    pub command: Vec<String>,
}

/// What is switched off, or in its place.
struct Ablation {
    title: &'static str,
    engine: &'static str,
    /// Flags that take the place of the engine's.
    flags: &'static [(&'static str, &'static str)],
    budgets: Budgets,
}

/// How an ablation spends more.
#[derive(PartialEq, Eq)]
enum Budgets {
    /// As the engine does.
    Usual,
    /// The same without a final gather.
    Interpolated,
    /// One level of ever smaller functions.
    OneLevel,
}

const NOISE_AWARE: [(&str, &str); 3] =
    [("--threshold", "0"), ("--relative-threshold", "0.05"), ("--noise-factor", "2")];

const LINKS_ABLATIONS: [Ablation; 10] = [
    usual("plain bounces, no Krylov solver", "production", &[("--solver", "bounces")]),
    usual("Shepard links, not nearest", "production", &[("--reconstruction", "shepard")]),
    usual("refined everywhere, no oracle", "production", &[("--relative-threshold", "0"), ("--noise-factor", "0")]),
    usual("oracle blind to noise", "production", &[("--noise-factor", "0")]),
    Ablation { title: "one level, no hierarchy", engine: "production", flags: &[], budgets: Budgets::OneLevel },
    usual(
        "no links: rays anew for every bounce",
        "production",
        &[
            ("--variant", "absolute"),
            ("--reconstruction", "nearest"),
            ("--relative-threshold", "0.05"),
            ("--noise-factor", "2"),
        ],
    ),
    usual("no sight rays", "production", &[("--without", "sight")]),
    usual("direct light sampled, not exact", "production", &[("--without", "exact-light")]),
    Ablation { title: "no final gather", engine: "production", flags: &[], budgets: Budgets::Interpolated },
    // Gathers read no gradients.
    Ablation {
        title: "no final gather, no gradients",
        engine: "production",
        flags: &[("--without", "gradients")],
        budgets: Budgets::Interpolated,
    },
];

const PUBLISHED_ABLATIONS: [Ablation; 7] = [
    usual("V1, nearest, not Shepard", "v1", &[("--reconstruction", "nearest")]),
    usual("V1, senders of one level", "v1", &[("--sender-levels", "1")]),
    usual("V3, Shepard, not nearest", "v3", &[("--reconstruction", "shepard")]),
    usual("V3, senders of one level", "v3", &[("--sender-levels", "1")]),
    usual("V3, all bounces", "v3", &[("--bounces", "1000"), ("--tolerance", "0.1%")]),
    usual("V3, oracle aware of noise", "v3", &NOISE_AWARE),
    Ablation { title: "V3, no final gather", engine: "v3", flags: &[], budgets: Budgets::Interpolated },
];

const fn usual(title: &'static str, engine: &'static str, flags: &'static [(&'static str, &'static str)]) -> Ablation {
    Ablation { title, engine, flags, budgets: Budgets::Usual }
}

/// Every variant, and the path tracer.
pub fn variants(case: &Case, source: &Source) -> Vec<Method> {
    let engines = ENGINES.iter().filter(|e| e.id != "preview");
    engines.map(|engine| of_engine(engine, case, source)).chain([path_tracer(source)]).collect()
}

/// Links, and the path tracer.
pub fn beside_peers(case: &Case, source: &Source) -> Vec<Method> {
    let engines = ENGINES.iter().filter(|e| e.id == "production");
    engines.map(|engine| of_engine(engine, case, source)).chain([path_tracer(source)]).collect()
}

/// Links, and links with each of their parts switched off that has a flag.
pub fn links_ablations(case: &Case, source: &Source) -> Vec<Method> {
    with_ablations("production", &LINKS_ABLATIONS, case, source)
}

/// The published variants, and each of them with one part changed.
pub fn published_ablations(case: &Case, source: &Source) -> Vec<Method> {
    let (v1, v3) = PUBLISHED_ABLATIONS.split_at(2);
    [with_ablations("v1", v1, case, source), with_ablations("v3", v3, case, source)].concat()
}

/// The path tracer of the reference with as many paths per point as given.
pub fn path_tracer(source: &Source) -> Method {
    let setting = |paths: u32| {
        // An error that no number of paths reaches, so that all of them are traced.
        let mut command = strings(&["reference", &source.argument, "--seed", PATHS_SEED, "--error", "1e-9"]);
        command.extend(["--paths".into(), paths.to_string()]);
        Setting { shown: format!("--paths {paths}"), value: None, command }
    };
    Method { title: "path tracer".into(), settings: PATHS.map(setting).into() }
}

impl Method {
    /// The same with its first settings alone.
    pub fn truncated(mut self, n_settings: usize) -> Self {
        self.settings.truncate(n_settings);
        self
    }
}

fn with_ablations(engine: &str, ablations: &[Ablation], case: &Case, source: &Source) -> Vec<Method> {
    let engine = ENGINES.iter().filter(|e| e.id == engine).map(|engine| of_engine(engine, case, source).truncated(5));
    engine.chain(ablations.iter().filter_map(|ablation| of_ablation(ablation, case, source))).collect()
}

fn of_engine(engine: &Engine, case: &Case, source: &Source) -> Method {
    let settings = budgets(engine, case).iter().map(|b| gathered(engine, case, source, *b)).collect();
    Method { title: engine.title.split(", production").next().unwrap_or_default().into(), settings }
}

fn of_ablation(ablation: &Ablation, case: &Case, source: &Source) -> Option<Method> {
    let engine = ENGINES.iter().find(|e| e.id == ablation.engine)?;
    let budgets = &budgets(engine, case)[..5];
    let mut settings: Vec<Setting> = match ablation.budgets {
        Budgets::Usual => budgets.iter().map(|b| gathered(engine, case, source, *b)).collect(),
        Budgets::Interpolated => budgets.iter().map(|b| interpolated(engine, case, source, *b)).collect(),
        Budgets::OneLevel => RADII.iter().zip(budgets).map(|(r, b)| one_level(engine, case, source, (r, *b))).collect(),
    };
    for setting in &mut settings {
        ablation.flags.iter().for_each(|flag| put(&mut setting.command, *flag));
    }
    settings.dedup();
    Some(Method { title: ablation.title.into(), settings })
}

fn gathered(engine: &Engine, case: &Case, source: &Source, budget: Budget) -> Setting {
    let mut setting = interpolated(engine, case, source, budget);
    setting.gather(budget[2]);
    setting
}

fn interpolated(engine: &Engine, case: &Case, source: &Source, [levels, rays, _]: Budget) -> Setting {
    let [levels, rays] = [levels, rays].map(|n| n.to_string());
    points(engine, case, source, &["--levels", &levels, "--rays", &rays])
}

fn one_level(engine: &Engine, case: &Case, source: &Source, (radius, [_, rays, gather]): (&str, Budget)) -> Setting {
    let mut setting = points(engine, case, source, &["--levels", "1", "--radius", radius, "--rays", &rays.to_string()]);
    setting.gather(gather);
    setting
}

fn points(engine: &Engine, case: &Case, source: &Source, budget: &[&str]) -> Setting {
    let mut command = strings(&["points", &source.argument]);
    command.extend(engine.flags_at(case, budget));
    Setting { shown: budget.join(" "), value: None, command }
}

impl Setting {
    fn gather(&mut self, n_rays: u32) {
        let flag = ["--final-gather".to_owned(), n_rays.to_string()];
        self.shown = format!("{} {}", self.shown, flag.join(" "));
        self.command.extend(flag);
    }
}

/// Gives a flag its value, whether it had one or not.
fn put(command: &mut Vec<String>, (flag, value): (&str, &str)) {
    match command.iter().position(|part| part == flag) {
        Some(at) if at + 1 < command.len() => command[at + 1] = value.to_owned(),
        _ => command.extend([flag, value].map(str::to_owned)),
    }
}

fn budgets(engine: &Engine, case: &Case) -> &'static [Budget] {
    match (engine.variant, case.has_many_functions) {
        (Variant::V1, false) => &V1,
        (Variant::V1, true) => &V1_LARGE,
        (Variant::V3, false) => &V3,
        (Variant::V3, true) => &V3_LARGE,
        (Variant::Links, _) => &LINKS,
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::scenes::CASES;
    use super::*;

    fn all() -> Vec<Method> {
        let of = |case: &Case| {
            let source = case.source(Path::new("nowhere"));
            [variants(case, &source), links_ablations(case, &source), published_ablations(case, &source)].concat()
        };
        CASES.iter().flat_map(of).collect()
    }

    #[test]
    fn every_method_has_five_budgets_or_nearly_and_no_flag_twice() {
        for method in all() {
            // Without a final gather, budgets that differ in its rays alone are one.
            let least = if method.title.contains("no final gather") { 4 } else { 5 };
            assert!(method.settings.len() >= least, "{}: {}", method.title, method.settings.len());
            for setting in &method.settings {
                let mut flags: Vec<&String> = setting.command.iter().filter(|part| part.starts_with("--")).collect();
                let n_flags = flags.len();
                flags.sort();
                flags.dedup();
                assert_eq!(flags.len(), n_flags, "{}: {:?}", method.title, setting.command);
            }
        }
    }

    #[test]
    fn every_budget_does_more_than_the_last() {
        for (engine, case) in ENGINES.iter().flat_map(|e| CASES.iter().map(move |c| (e, c))) {
            for pair in budgets(engine, case).windows(2) {
                assert!((0..3).any(|i| pair[1][i] > pair[0][i]) && pair[1][2] >= pair[0][2], "{pair:?}");
            }
        }
    }

    #[test]
    fn every_ablation_differs_from_what_it_is_an_ablation_of() {
        let source = CASES[0].source(Path::new("nowhere"));
        for methods in [links_ablations(&CASES[0], &source), published_ablations(&CASES[0], &source)] {
            for (i, one) in methods.iter().enumerate() {
                for other in &methods[..i] {
                    assert_ne!(one.title, other.title);
                    assert!(one.settings.iter().all(|s| !other.settings.contains(s)), "{} {}", one.title, other.title);
                }
            }
        }
    }

    #[test]
    fn flags_are_replaced_and_not_repeated() {
        let mut command = strings(&["points", "--rays", "64"]);
        put(&mut command, ("--rays", "8"));
        put(&mut command, ("--levels", "2"));
        assert_eq!(command.join(" "), "points --rays 8 --levels 2");
    }
}
