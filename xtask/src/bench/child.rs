//! The binary `hplt` as a child process: its JSON document and its peak of memory.

use std::io::Read;
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;
use std::time::Duration;

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
    /// Largest resident memory, bytes; `None` where the system does not say.
    pub peak_memory: Option<u64>,
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
        self.finish(command, also_good)
    }

    /// The same for a command that has no progress.
    ///
    /// # Errors
    /// As [`Hplt::ask`].
    pub fn ask_briefly(&self, arguments: &[String]) -> Result<Answer> {
        let mut command = Command::new(&self.binary);
        command.args(arguments).args(["--json", "--quiet"]).current_dir(root());
        self.finish(command, None)
    }

    fn finish(&self, mut command: Command, also_good: Option<i32>) -> Result<Answer> {
        let shown = show(&command);
        eprintln!("$ {shown}");
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("cannot start {}", self.binary.display()))?;
        let stdout = reader(child.stdout.take());
        let stderr = reader(child.stderr.take());
        let mut peak_memory = None;
        let status = loop {
            // The figure only grows, and is gone as soon as the process ends.
            peak_memory = peak_of(child.id()).max(peak_memory);
            if let Some(status) = child.try_wait()? {
                break status;
            }
            thread::sleep(Duration::from_millis(10));
        };
        let [stdout, stderr] = [stdout, stderr].map(|t| t.join().unwrap_or_default());
        if !status.success() && (also_good.is_none() || status.code() != also_good) {
            bail!("`{shown}` failed: {status}\n{}", stderr.trim_end());
        }
        let document = serde_json::from_str(&stdout)
            .with_context(|| format!("`{shown}` printed no JSON document\n{}", stderr.trim_end()))?;
        Ok(Answer { document, peak_memory })
    }
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

fn peak_of(process: u32) -> Option<u64> {
    parse_peak(&std::fs::read_to_string(format!("/proc/{process}/status")).ok()?)
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
    fn a_failing_child_is_shown_with_its_command_line() {
        let error = Hplt::at("cargo".into()).ask(&["no-such-command".into()], Some(NOT_CONVERGED)).err().unwrap();
        let text = format!("{error:#}");
        assert!(text.contains("no-such-command --json") && text.contains("failed"), "{text}");
    }

    #[test]
    fn a_child_without_a_document_is_an_error() {
        let mut command = Command::new("cargo");
        command.arg("--version");
        let error = Hplt::at("cargo".into()).finish(command, None).err().unwrap();
        assert!(format!("{error:#}").contains("`cargo --version` printed no JSON document"));
    }
}
