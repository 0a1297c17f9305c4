//! The error-time report: what every method reaches in which time, what each of their parts is worth, and how time grows.

mod html;
mod peers;
mod scaling;
mod section;

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};

use super::cells::{csv, table};
use super::curves::{Clock, curve};
use super::machine::Machine;
use super::measure::Bench;
use super::methods::{Method, beside_peers, links_ablations, published_ablations, variants};
use super::scenes::{CASES, Case, Source};
use super::truth::Truth;
pub use peers::Peers;
use section::{ERROR_OVER_TIME, LIT_ERROR_OVER_TIME, Section, csv_head};

/// Budgets of each method in a quick report.
const QUICK_BUDGETS: usize = 2;

/// A part of the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum Part {
    /// Error against time: every variant and the path tracer.
    Variants,
    /// Error against time: links with each of their parts switched off.
    Links,
    /// Error against time: the published variants with one part changed.
    Published,
    /// Time by triangles.
    Triangles,
    /// Time and error by levels.
    Levels,
    /// Time by points that are read from a kept solution.
    Receivers,
    /// Sweeps and time by albedo.
    Albedo,
    /// Time by threads.
    Threads,
    /// Error against time: links, the path tracer and the renderers of --peers, in flat colours.
    Peers,
}

const PARTS: [Part; 9] = [
    Part::Variants,
    Part::Links,
    Part::Published,
    Part::Triangles,
    Part::Levels,
    Part::Receivers,
    Part::Albedo,
    Part::Threads,
    Part::Peers,
];

/// What to measure.
pub struct Plan<'p> {
    /// With what.
    pub bench: &'p Bench<'p>,
    /// On which scenes, where a part has several.
    pub cases: &'p [(&'p Case, Source)],
    /// Which parts beside that of the peers; all where none is named.
    pub parts: &'p [Part],
    /// Whether sections that are not measured now stay as the last report had them.
    pub keeps_others: bool,
    /// Time of the pictures.
    pub clock: Clock,
    /// Other renderers, where they were asked for.
    pub peers: Option<Peers>,
    /// How the command was called, in words.
    pub mode: String,
}

/// Everything that is written.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// How the command was called, in words.
    pub mode: String,
    /// Seconds after which one run is cut short.
    pub limit_seconds: u64,
    /// Time of the pictures.
    pub clock: Clock,
    /// In order.
    pub sections: Vec<Section>,
}

/// Measures and writes `error-time.html`, `.json`, `.csv` and `.md`, anew after every section, since each takes minutes.
///
/// # Errors
/// When a file cannot be written; and at the end, when a command failed, with the sections that are missing for that.
pub fn measure(plan: &Plan<'_>) -> Result<()> {
    let folder = plan.bench.folder;
    let mut report = plan.start();
    let mut failures = Vec::new();
    for part in PARTS.into_iter().filter(|part| plan.measures(*part)) {
        for section in plan.jobs(part) {
            match section(plan) {
                Ok(section) => report.put(section),
                // The others took hours, or will.
                Err(problem) => failures.push(format!("part {part:?}: {problem:#}")),
            }
            report.write(folder)?;
        }
    }
    for name in ["html", "json", "csv", "md"] {
        eprintln!("wrote {}", folder.join(format!("error-time.{name}")).display());
    }
    if failures.is_empty() { Ok(()) } else { bail!("sections are missing: {}", failures.join("; ")) }
}

type Job<'p> = Box<dyn Fn(&Plan<'_>) -> Result<Section> + 'p>;

impl Plan<'_> {
    fn start(&self) -> Report {
        let new = Report {
            mode: self.mode.clone(),
            limit_seconds: self.bench.effort.limit_seconds,
            clock: self.clock,
            sections: Vec::new(),
        };
        if !self.keeps_others {
            return new;
        }
        let last = std::fs::read_to_string(self.bench.folder.join("error-time.json")).ok();
        let last: Option<Report> = last.and_then(|text| serde_json::from_str(&text).ok());
        // Sections of another effort would be compared with what they cannot be compared with.
        let sections = last.filter(|last| last.mode == self.mode).map_or(Vec::new(), |last| last.sections);
        Report { sections, ..new }
    }

    fn measures(&self, part: Part) -> bool {
        match part {
            Part::Peers => self.peers.is_some(),
            _ => self.parts.is_empty() || self.parts.contains(&part),
        }
    }

    /// One function for each section of a part.
    fn jobs(&self, part: Part) -> Vec<Job<'_>> {
        let by_case = |of: fn(&Plan<'_>, &Case, &Source) -> Result<Section>| -> Vec<Job<'_>> {
            let job = |(case, source)| -> Job<'_> { Box::new(move |plan: &Plan<'_>| of(plan, case, source)) };
            self.cases.iter().map(|(case, source)| job((*case, source))).collect()
        };
        match part {
            Part::Variants => by_case(variants_section),
            Part::Links => by_case(links_section),
            Part::Published => by_case(published_section),
            Part::Triangles => vec![Box::new(scaling::triangles)],
            Part::Levels => by_case(scaling::levels),
            Part::Receivers => by_case(scaling::receivers),
            Part::Albedo => vec![Box::new(scaling::albedo)],
            Part::Threads => by_case(scaling::threads),
            Part::Peers => by_case(peers_section),
        }
    }

    /// A method with as many budgets as there is time for.
    fn shortened(&self, method: Method) -> Method {
        if self.bench.effort.is_quick { method.truncated(QUICK_BUDGETS) } else { method }
    }

    fn section(&self, part: Part, source: Option<(&Case, &Source)>, title: &str, note: &str) -> Section {
        let name = format!("{part:?}").to_lowercase();
        let of_case = source.and_then(|(case, _)| CASES.iter().position(|c| c.id == case.id)).unwrap_or(0);
        Section {
            id: source.map_or(name.clone(), |(_, source)| format!("{name}-{}", source.id)),
            rank: [part as usize, of_case],
            title: source.map_or(title.to_owned(), |(_, source)| format!("{}: {title}", source.title)),
            note: note.to_owned(),
            machine: Machine::look(),
            varies: None,
            plots: Vec::new(),
            reference: None,
            curves: Vec::new(),
            remarks: Vec::new(),
        }
    }

    fn error_time(
        &self,
        part: Part,
        (case, source): (&Case, &Source),
        (title, note): (&str, &str),
        methods: Vec<Method>,
    ) -> Result<(Section, Truth)> {
        let truth = self.bench.truth(case, source)?;
        let mut section = self.section(part, Some((case, source)), title, note);
        section.plots.extend([ERROR_OVER_TIME, LIT_ERROR_OVER_TIME]);
        section.reference = Some(truth.standard_error);
        for method in methods {
            section.curves.push(curve(self.bench, source, &self.shortened(method), &truth)?);
        }
        Ok((section, truth))
    }
}

const ERROR_NOTE: &str = "Mean relative error of total irradiance at random reachable points, against a path tracer whose own error is in \
these figures. Time is that of the whole process, from reading the scene to the written table, without the solver's own error estimate.";

const PEER_NOTE: &str = " All methods light the same points of the same triangles in flat colours: where the file has textures, the mean \
colour of each takes its place, and cut-outs are filled. Mitsuba traces as many paths from every point as its setting says, with next-event estimation; Radiance is \
`rtrace -I` with its ambient cache. Their times leave out the interpreter, its imports and the conversion of the scene.";

fn variants_section(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    let note = format!("{ERROR_NOTE} All methods light the same points; ours read their solution by a final gather.");
    let methods = variants(case, source);
    Ok(plan.error_time(Part::Variants, (case, source), ("error against time", &note), methods)?.0)
}

fn links_section(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    let note = format!("{ERROR_NOTE} Each line is links with one part switched off, at the same budgets.");
    let methods = links_ablations(case, source);
    Ok(plan.error_time(Part::Links, (case, source), ("what the parts of links are worth", &note), methods)?.0)
}

fn published_section(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    let note = format!("{ERROR_NOTE} Each line is a published variant with one part changed, at the same budgets.");
    let title = "the published variants, changed";
    let methods = published_ablations(case, source);
    Ok(plan.error_time(Part::Published, (case, source), (title, &note), methods)?.0)
}

fn peers_section(plan: &Plan<'_>, case: &Case, source: &Source) -> Result<Section> {
    let peers = plan.peers.as_ref().context("no peers")?;
    let (flat, note) = (source.flat(), format!("{ERROR_NOTE}{PEER_NOTE}"));
    let methods = beside_peers(case, &flat);
    let (mut section, truth) =
        plan.error_time(Part::Peers, (case, &flat), ("beside other renderers", &note), methods)?;
    let (curves, remarks) = peers.curves(plan.bench, &flat, &truth)?;
    section.curves.extend(curves);
    section.remarks.extend(remarks);
    Ok(section)
}

impl Report {
    /// Puts a section in its place, instead of the one that was there.
    fn put(&mut self, section: Section) {
        self.sections.retain(|other| other.rank != section.rank);
        self.sections.push(section);
        self.sections.sort_by_key(|section| section.rank);
    }

    /// One line above everything.
    fn summary(&self) -> String {
        format!(
            "{}; every run is cut short after {} s, and what was cut short is left out and named.",
            self.mode, self.limit_seconds
        )
    }

    fn write(&self, folder: &Path) -> Result<()> {
        let write = |extension: &str, content: String| {
            let path = folder.join(format!("error-time.{extension}"));
            std::fs::write(&path, content).with_context(|| format!("cannot write {}", path.display()))
        };
        let rows: Vec<Vec<String>> = self.sections.iter().flat_map(Section::csv_rows).collect();
        write("json", format!("{}\n", serde_json::to_string_pretty(self)?))?;
        write("csv", csv(&csv_head(), &rows))?;
        write("md", self.markdown())?;
        write("html", html::page(self)?)
    }

    fn markdown(&self) -> String {
        let mut out = format!("# Error and time\n\n{}\n", self.summary());
        for section in &self.sections {
            let (head, rows) = section.table();
            let _ = write!(out, "\n## {}\n\n{}\n\n{}\n\n", section.title, section.note, circumstances(section));
            if !rows.is_empty() {
                out.push_str(&table(&head, &rows));
            }
            for line in section.left_out().iter().chain(&section.remarks) {
                let _ = write!(out, "\n{line}\n");
            }
        }
        out
    }
}

/// When, on what, of what.
fn circumstances(section: &Section) -> String {
    let m = &section.machine;
    let warning = m.warning().map(|w| format!(" {w}.")).unwrap_or_default();
    format!("{} on {} cores ({}), commit {}.{warning}", m.date, m.cores, m.cpu, m.commit)
}

#[cfg(test)]
pub mod tests {
    use super::section::tests::section;
    use super::*;

    /// A report of one section.
    pub fn report() -> Report {
        Report { mode: "quick".into(), limit_seconds: 35, clock: Clock::Wall, sections: vec![section()] }
    }

    #[test]
    fn all_four_files_have_the_same_data_and_json_comes_back() {
        let folder = std::env::temp_dir().join(format!("hplt-report-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        report().write(&folder).unwrap();
        let [html, json, csv, md] = ["html", "json", "csv", "md"]
            .map(|e| std::fs::read_to_string(folder.join(format!("error-time.{e}"))).unwrap());
        std::fs::remove_dir_all(&folder).unwrap();
        assert_eq!(serde_json::from_str::<Report>(&json).unwrap(), report());
        assert_eq!(csv.lines().count(), 1 + 3);
        for text in [&html, &md] {
            assert!(text.contains("0.40 %") && text.contains("1.00M") && text.contains("--levels 8"), "{text}");
        }
        assert!(csv.contains("0.004") && csv.contains("1000000"), "{csv}");
    }

    #[test]
    fn a_section_takes_the_place_of_its_former_self_and_keeps_the_order() {
        let mut report = report();
        report.put(Section { id: "variants-cornell".into(), rank: [0, 0], ..section() });
        report.put(Section { title: "anew".into(), ..section() });
        let order: Vec<(&str, &str)> = report.sections.iter().map(|s| (s.id.as_str(), s.title.as_str())).collect();
        assert_eq!(order, [("variants-cornell", "Triangles & time"), ("triangles", "anew")]);
    }

    #[test]
    fn parts_are_in_the_order_of_their_ranks() {
        assert!(PARTS.windows(2).all(|pair| (pair[0] as usize) < pair[1] as usize));
    }
}
