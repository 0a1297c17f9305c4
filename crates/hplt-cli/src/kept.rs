//! What a solution file keeps for changes of light: links, and the light of each group of lights.

use hplt_geom::{LightGroups, PointHierarchy, Progress, Rgb, Scene};
use hplt_io::{Section, SectionData, SolutionFile};
use hplt_transport::{
    Error, GroupLight, Linked, Relighting, SolveOptions, SolvedGroup, SparseParts, SparseRows, System,
};

use crate::exit::Failure;
use crate::scene_hash::light_groups_hash;
use crate::solution::{flat, number, value, vectors};

/// More groups than this are not kept apart.
const MAX_GROUPS: usize = 1000;
/// Up to as many groups are solved beside links unasked: that takes a hundredth of the time and of the file, and makes a change of
/// light a matter of one sweep.
const FEW_GROUPS: usize = 16;

/// What `hplt solve` is to keep.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Keep {
    /// The links, for new solves.
    pub links: bool,
    /// The solution of every group of lights, for weighted sums.
    pub all_groups: bool,
}

impl Keep {
    /// Whether light is needed by group.
    pub fn is_any(self) -> bool {
        self.links || self.all_groups
    }

    /// Whether the solution of each of `n_groups` is kept.
    pub fn is_solved(self, n_groups: usize) -> bool {
        self.all_groups || (self.links && n_groups <= FEW_GROUPS)
    }

    /// Refuses scenes with too many groups to keep, before anything is computed.
    ///
    /// # Errors
    /// When there are too many, or none.
    pub fn check(self, scene: &Scene) -> Result<(), Failure> {
        match LightGroups::of(scene).len() {
            n if self.is_any() && n > MAX_GROUPS => {
                let message = format!("{n} groups of lights; expected {MAX_GROUPS} at most: equal names are one group");
                Err(Failure::usage(message))
            }
            _ => Ok(()),
        }
    }
}

/// Links and light by group.
#[derive(Debug, Clone, Default)]
pub struct Kept {
    /// The links, if they are kept.
    pub links: Option<SparseRows>,
    /// What bounds errors by them; empty where nothing beside them does.
    pub barrier: Vec<Rgb>,
    /// The light of each group.
    pub groups: Vec<GroupLight>,
}

impl Kept {
    /// What `keep` asks for, of freshly made links.
    ///
    /// # Errors
    /// Those of the solver.
    pub fn of(linked: &mut Linked, keep: Keep, solve: &SolveOptions, progress: &dyn Progress) -> Result<Self, Failure> {
        let groups = std::mem::take(&mut linked.groups);
        let links = std::mem::replace(&mut linked.links, SparseRows::new(0));
        let mut relighting = Relighting::new(links, System::of(linked.basis.hierarchy()), groups, progress)?;
        if keep.is_solved(relighting.groups().len()) {
            relighting.solve_groups(solve, progress)?;
        }
        let barrier = if keep.links { relighting.barrier() } else { Vec::new() };
        let (links, groups) = relighting.into_parts();
        Ok(Self { links: keep.links.then_some(links), barrier, groups })
    }

    /// Bytes of the links in a file.
    pub fn bytes_of_links(&self) -> u64 {
        let barrier = size_of_val(&self.barrier[..]) as u64;
        self.links.as_ref().map_or(0, |l| 8 * l.n_entries() as u64 + 28 * l.n_rows() as u64 + barrier)
    }

    /// Bytes of the light of groups in a file.
    pub fn bytes_of_groups(&self) -> u64 {
        let bytes = |g: &GroupLight| {
            let solved = g.solved.as_ref().map_or(0, |s| s.indirect.len() + s.error.len());
            (g.direct.len() + g.first_bounce.len() + solved) as u64 * size_of::<Rgb>() as u64
        };
        self.groups.iter().map(bytes).sum()
    }

    /// Adds it to a solution file.
    pub fn push_to(self, file: &mut SolutionFile, scene: &Scene, tolerance: f32) {
        let groups = LightGroups::of(scene);
        let mut push = |key: String, value: String| file.metadata.push((key, value));
        push("hplt.light_groups".into(), self.groups.len().to_string());
        push("hplt.light_groups_hash".into(), light_groups_hash(&groups, scene));
        push("hplt.solve_tolerance".into(), tolerance.to_string());
        for (k, group) in self.groups.iter().enumerate() {
            push(format!("hplt.light_group{k}"), hplt_io::sanitized(&group.name));
        }
        let mut push = |name: String, data: SectionData| file.sections.push(Section { name, data });
        for (k, group) in self.groups.into_iter().enumerate() {
            push(format!("group{k}.direct"), SectionData::F32(flat(group.direct.into_iter())));
            push(format!("group{k}.first_bounce"), SectionData::F32(flat(group.first_bounce.into_iter())));
            if let Some(solved) = group.solved {
                push(format!("group{k}.indirect"), SectionData::F32(flat(solved.indirect.into_iter())));
                push(format!("group{k}.error"), SectionData::F32(flat(solved.error.into_iter())));
            }
        }
        if let Some(links) = self.links {
            let SparseParts { lengths, entries, sums, .. } = links.into_parts();
            let halves = |sum: f64| [sum.to_bits() as u32, (sum.to_bits() >> 32) as u32];
            push("links.lengths".into(), SectionData::U32(lengths));
            push("links.entries".into(), SectionData::U32(entries));
            push("links.sums".into(), SectionData::U32(sums.into_iter().flat_map(halves).collect()));
            if !self.barrier.is_empty() {
                push("links.barrier".into(), SectionData::F32(flat(self.barrier.into_iter())));
            }
        }
    }

    /// What a solution file keeps; links and groups are taken out of it.
    ///
    /// # Errors
    /// When it is damaged. Nothing at all is no damage.
    pub fn take_from(
        file: &mut SolutionFile,
        hierarchy: &PointHierarchy,
        refuse: &impl Fn(String) -> Failure,
    ) -> Result<Self, Failure> {
        if file.value("hplt.light_groups").is_none() {
            return Ok(Self::default());
        }
        let n = hierarchy.n_points();
        let n_groups: usize = number(file, "hplt.light_groups").map_err(refuse)?;
        if n_groups > MAX_GROUPS {
            return Err(refuse(format!("{n_groups} groups of lights; expected {MAX_GROUPS} at most")));
        }
        let groups = (0..n_groups).map(|k| read_group(file, k, (n, hierarchy.n_regions as usize), refuse));
        let groups = groups.collect::<Result<Vec<_>, _>>()?;
        let links = match has(file, "links.entries") {
            true => Some(take_links(file, n).map_err(|e| e.into_failure(refuse))?),
            false => None,
        };
        let barrier = match has(file, "links.barrier") {
            true => read_vectors(file, "links.barrier", n, |x| x >= 0.0 && x.is_finite(), refuse)?,
            false => Vec::new(),
        };
        Ok(Self { links, barrier, groups })
    }
}

enum Broken {
    Section(hplt_io::Error),
    Links(Error),
}

impl Broken {
    fn into_failure(self, refuse: &impl Fn(String) -> Failure) -> Failure {
        match self {
            Self::Section(error) => error.into(),
            Self::Links(error) => refuse(error.to_string()),
        }
    }
}

fn read_group(
    file: &SolutionFile,
    k: usize,
    (n, n_regions): (usize, usize),
    refuse: &impl Fn(String) -> Failure,
) -> Result<GroupLight, Failure> {
    let name = value(file, &format!("hplt.light_group{k}")).map_err(refuse)?.to_owned();
    let read = |what: &str, n: usize, is_good: fn(f32) -> bool| {
        read_vectors(file, &format!("group{k}.{what}"), n, is_good, refuse)
    };
    let is_light = |x: f32| x >= 0.0 && x.is_finite();
    let solved = has(file, &format!("group{k}.indirect")).then(|| {
        // An error without bound is infinite.
        // Where next to no light is, a solver may find less than none.
        let (indirect, error) = (read("indirect", n, f32::is_finite)?, read("error", n_regions, |x| x >= 0.0)?);
        Ok::<_, Failure>(SolvedGroup { indirect, error })
    });
    Ok(GroupLight {
        name,
        direct: read("direct", n, is_light)?,
        first_bounce: read("first_bounce", n, is_light)?,
        solved: solved.transpose()?,
    })
}

fn has(file: &SolutionFile, section: &str) -> bool {
    file.sections.iter().any(|s| s.name == section)
}

/// The `n` vectors of a section, none of them damaged.
fn read_vectors(
    file: &SolutionFile,
    section: &str,
    n: usize,
    is_good: fn(f32) -> bool,
    refuse: &impl Fn(String) -> Failure,
) -> Result<Vec<Rgb>, Failure> {
    let floats = file.floats(section)?;
    if floats.len() != 3 * n {
        return Err(refuse(format!("{} numbers in section \"{section}\"; expected {}", floats.len(), 3 * n)));
    }
    match floats.iter().find(|x| !is_good(**x)) {
        Some(x) => Err(refuse(format!(
            "{x} in section \"{section}\"; expected finite numbers, of 0 or more where they are no solution"
        ))),
        None => Ok(vectors(floats)),
    }
}

fn take_links(file: &mut SolutionFile, n: usize) -> Result<SparseRows, Broken> {
    let lengths = file.integers("links.lengths").map_err(Broken::Section)?.to_vec();
    let sums = file.integers("links.sums").map_err(Broken::Section)?;
    let whole = |halves: &[u32]| f64::from_bits(u64::from(halves[0]) | u64::from(halves[1]) << 32);
    let problem = "they are not one row per function";
    if lengths.len() != n || sums.len() != 6 * n {
        return Err(Broken::Links(Error::Links { row: lengths.len(), problem }));
    }
    let sums = sums.chunks_exact(2).map(whole).collect();
    file.integers("links.entries").map_err(Broken::Section)?;
    let at = file.sections.iter().position(|s| s.name == "links.entries");
    let entries = match at.map(|at| file.sections.swap_remove(at).data) {
        Some(SectionData::U32(entries)) => entries,
        _ => Vec::new(),
    };
    let n_columns = u32::try_from(n).unwrap_or(u32::MAX);
    SparseRows::from_parts(SparseParts { n_columns, lengths, entries, sums }).map_err(Broken::Links)
}

/// The factors by which a relit solution multiplies the lights of its scene; `None` when it has not changed them.
///
/// # Errors
/// In words, when they are damaged, or belong to other groups than the scene has.
pub fn factors(file: &SolutionFile, groups: &LightGroups, scene: &Scene) -> Result<Option<Vec<Rgb>>, String> {
    if file.value("hplt.light_factor0").is_none() {
        return Ok(None);
    }
    let (found, expected) = (value(file, "hplt.light_groups_hash")?, light_groups_hash(groups, scene));
    if found != expected {
        let found = hplt_io::sanitized(found);
        return Err(format!("has other groups of lights, with hash {found}; the scene has {expected}; solve again"));
    }
    let factor = |k: usize| {
        let key = format!("hplt.light_factor{k}");
        let text = value(file, &key)?;
        let numbers: Option<Vec<f32>> = text.split(',').map(|x| x.parse().ok()).collect();
        match numbers.as_deref() {
            Some(&[r, g, b]) if [r, g, b].iter().all(|x| *x >= 0.0 && x.is_finite()) => Ok(Rgb::new(r, g, b)),
            _ => Err(format!("{key} is \"{}\"; expected three finite numbers of 0 or more", hplt_io::sanitized(text))),
        }
    };
    (0..groups.len()).map(factor).collect::<Result<Vec<_>, _>>().map(Some)
}
