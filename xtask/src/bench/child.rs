//! The binary `hplt` as a child process: its JSON document and its peak of memory.

use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::shell::{cargo, output, root, run, show};

/// Exit code of a run that did not reach its goal but wrote its results.
pub const NOT_CONVERGED: i32 = 6;

/// Where the binary is.
pub struct Hplt {
    binary: PathBuf,
}

/// What a command came back with.
pub struct Answer {
    /// Its JSON document.
    pub document: Value,
    /// What it took; nothing where the system does not say.
    pub usage: Usage,
    /// Wall-clock time from its start to its end.
    pub wall_seconds: f64,
}

/// What a process has taken so far.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Usage {
    /// Largest resident memory, bytes.
    pub peak_memory: Option<u64>,
    /// Seconds on processors, all threads together. Unlike wall-clock time it hardly depends on what else is running.
    pub processor_seconds: Option<f64>,
}

impl Hplt {
    /// Builds the release binary.
    ///
    /// # Errors
    /// When it does not build.
    pub fn build() -> Result<Self> {
        run(&mut cargo(&["build", "--release", "--package", "hplt-cli"]))?;
        let text = output(&mut cargo(&["metadata", "--no-deps", "--format-version", "1"]))?;
        let metadata: Value = serde_json::from_str(&text)?;
        let target = metadata["target_directory"].as_str().context("cargo metadata names no target directory")?;
        Ok(Self::at(PathBuf::from(target).join("release").join(format!("hplt{}", std::env::consts::EXE_SUFFIX))))
    }

    /// The binary at a path, which must be there.
    ///
    /// # Errors
    /// When it is not.
    pub fn found(path: &Path) -> Result<Self> {
        Ok(Self::at(path.canonicalize().with_context(|| format!("cannot find {}", path.display()))?))
    }

    /// A binary that is there already.
    pub fn at(binary: PathBuf) -> Self {
        Self { binary }
    }

    /// Runs a command to its end and reads the JSON document that it prints.
    ///
    /// # Errors
    /// With the command line and what the command said, when it fails: with another exit code than 0 and `also_good`, or
    /// without a document.
    pub fn ask(&self, arguments: &[String], also_good: Option<i32>) -> Result<Answer> {
        let mut command = Command::new(&self.binary);
        command.args(arguments).args(["--json", "--quiet", "--progress", "none"]).current_dir(root());
        finish(command, also_good)
    }

    /// The same for a command that has no progress.
    ///
    /// # Errors
    /// As [`Hplt::ask`].
    pub fn ask_briefly(&self, arguments: &[String]) -> Result<Answer> {
        let mut command = Command::new(&self.binary);
        command.args(arguments).args(["--json", "--quiet"]).current_dir(root());
        finish(command, None)
    }
}

/// Runs any command to its end and reads the JSON document that it prints.
///
/// # Errors
/// As [`Hplt::ask`].
pub fn finish(mut command: Command, also_good: Option<i32>) -> Result<Answer> {
    let shown = show(&command);
    eprintln!("$ {shown}");
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let start = Instant::now();
    let mut child = command.spawn().with_context(|| format!("cannot start `{shown}`"))?;
    let stdout = reader(child.stdout.take());
    let stderr = reader(child.stderr.take());
    let mut usage = Usage::default();
    let status = loop {
        // Both figures only grow, and are gone as soon as the process ends.
        usage = usage.or_later(child.id());
        if let Some(status) = child.try_wait()? {
            break status;
        }
        thread::sleep(Duration::from_millis(5));
    };
    let wall_seconds = start.elapsed().as_secs_f64();
    let processor = usage.processor_seconds.map(|s| format!(", {s:.1} s on processors")).unwrap_or_default();
    eprintln!("  {wall_seconds:.1} s{processor}");
    let [stdout, stderr] = [stdout, stderr].map(|t| t.join().unwrap_or_default());
    if !status.success() && (also_good.is_none() || status.code() != also_good) {
        bail!("`{shown}` failed: {status}\n{}", stderr.trim_end());
    }
    let document = serde_json::from_str(&stdout)
        .with_context(|| format!("`{shown}` printed no JSON document\n{}", stderr.trim_end()))?;
    Ok(Answer { document, usage, wall_seconds })
}

/// Reads a pipe to its end on a thread of its own, so that the child never waits for us.
fn reader(pipe: Option<impl Read + Send + 'static>) -> thread::JoinHandle<String> {
    thread::spawn(move || {
        let mut bytes = Vec::new();
        if let Some(mut pipe) = pipe {
            // A broken pipe shows as a document that ends early.
            let _ = pipe.read_to_end(&mut bytes);
        }
        String::from_utf8_lossy(&bytes).into_owned()
    })
}

impl Usage {
    /// What `process` has taken by now, where it can still be seen.
    fn or_later(self, process: u32) -> Self {
        let read = |name: &str| std::fs::read_to_string(format!("/proc/{process}/{name}")).ok();
        Self {
            peak_memory: read("status").and_then(|text| parse_peak(&text)).or(self.peak_memory),
            processor_seconds: read("stat").and_then(|text| parse_processor_seconds(&text)).or(self.processor_seconds),
        }
    }
}

/// What all children together have had of the processors, as far as they have ended, seconds.
pub fn processor_seconds_of_children() -> Option<f64> {
    parse_ticks(&std::fs::read_to_string("/proc/self/stat").ok()?, 13)
}

/// User and system time in the text of `/proc/PID/stat`.
fn parse_processor_seconds(stat: &str) -> Option<f64> {
    parse_ticks(stat, 11)
}

/// Two neighbouring times in the text of `/proc/PID/stat`, added up; `first` counts from behind the name of the program.
fn parse_ticks(stat: &str, first: usize) -> Option<f64> {
    // What programs see of the kernel's clock, on every Linux system.
    const TICKS_PER_SECOND: f64 = 100.0;
    // The name of the program, in parentheses, may hold anything.
    let mut after_name = stat.rsplit_once(')')?.1.split_whitespace().skip(first);
    let mut ticks = || after_name.next()?.parse::<f64>().ok();
    Some((ticks()? + ticks()?) / TICKS_PER_SECOND)
}

/// `VmHWM` in the text of `/proc/PID/status`, bytes.
fn parse_peak(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kibibytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(1024 * kibibytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_peak_is_read_from_the_status_of_a_process() {
        assert_eq!(parse_peak("Name:\thplt\nVmPeak:\t   99 kB\nVmHWM:\t    1536 kB\nThreads:\t2\n"), Some(1_572_864));
        assert_eq!(parse_peak("Name:\tzombie\nState:\tZ (zombie)\n"), None);
    }

    #[test]
    fn processor_time_is_user_and_system_time() {
        let stat = "4242 (a ) b) S 1 2 3 4 5 6 7 8 9 10 1250 75 0 0 20 0 3 0 100 200 300";
        assert_eq!(parse_processor_seconds(stat), Some(13.25));
        let with_children = stat.replace("1250 75 0 0 20", "1250 75 400 50 20");
        assert_eq!((parse_ticks(&with_children, 13), parse_ticks(stat, 13)), (Some(4.5), Some(0.0)));
        assert_eq!(parse_processor_seconds("4242 (a) S 1 2"), None);
    }

    #[test]
    fn children_that_have_ended_count() {
        let before = processor_seconds_of_children();
        let spins = ["-c", "i=0; while [ $i -lt 100000 ]; do i=$((i+1)); done"];
        Command::new("sh").args(spins).status().unwrap();
        // Where there is no /proc there is no figure.
        assert!(before.is_none_or(|before| processor_seconds_of_children().is_some_and(|after| after > before)));
    }

    #[test]
    fn a_failing_child_is_shown_with_its_command_line() {
        let error = Hplt::at("cargo".into()).ask(&["no-such-command".into()], Some(NOT_CONVERGED)).err().unwrap();
        let text = format!("{error:#}");
        assert!(text.contains("no-such-command --json") && text.contains("failed"), "{text}");
    }

    #[test]
    fn a_child_without_a_document_is_an_error() {
        let mut command = Command::new("cargo");
        command.arg("--version");
        let error = finish(command, None).err().unwrap();
        assert!(format!("{error:#}").contains("`cargo --version` printed no JSON document"));
    }
}
