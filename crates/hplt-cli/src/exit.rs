//! How a run ends: exit codes and the one line that says why.

use std::fmt;
use std::process::ExitCode;

/// The exit codes of `hplt`, one list for the whole tool.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Exit {
    /// The result is converged and complete.
    Ok = 0,
    /// A flag or a config file is wrong.
    Usage = 2,
    /// The scene or another input is invalid or cannot be read.
    Input = 3,
    /// An input is larger than a limit.
    Limit = 4,
    /// The run would need more memory than there is or than was allowed.
    Memory = 5,
    /// Not converged, no finite solution, out of time, or a comparison beyond its limit.
    NotConverged = 6,
    /// An output cannot be written; what was there before is unharmed.
    Output = 8,
    /// A solution file is damaged or belongs to something else.
    Solution = 9,
    /// A value that must be finite is not.
    NotFinite = 10,
    /// A bug.
    Bug = 101,
    /// Interrupted.
    Interrupted = 130,
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit as u8)
    }
}

/// Why a run stopped. Shown as `error[CODE]: file: where: what, value, limit; hint`.
#[derive(Debug, Clone, PartialEq)]
pub struct Failure {
    /// The exit code.
    pub exit: Exit,
    /// Stable name of the problem.
    pub code: &'static str,
    /// One line.
    pub message: String,
}

impl Failure {
    /// A failure.
    pub fn new(exit: Exit, code: &'static str, message: impl Into<String>) -> Self {
        Self { exit, code, message: message.into() }
    }

    /// A wrong flag or config value.
    pub fn usage(message: impl Into<String>) -> Self {
        Self::new(Exit::Usage, "USAGE", message)
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Whatever a message was made of, it stays on one line and cannot steer a terminal.
        let line = self.message.split_whitespace().collect::<Vec<_>>().join(" ");
        write!(f, "error[{}]: {}", self.code, line.replace(|c: char| c.is_control(), "?"))
    }
}

impl From<hplt_io::Error> for Failure {
    fn from(error: hplt_io::Error) -> Self {
        let exit = match error.exit_code() {
            4 if error.code() == "LIMIT_MEMORY" => Exit::Memory,
            4 => Exit::Limit,
            8 => Exit::Output,
            9 => Exit::Solution,
            _ => Exit::Input,
        };
        Self::new(exit, error.code(), error.to_string())
    }
}

impl From<hplt_transport::Error> for Failure {
    fn from(error: hplt_transport::Error) -> Self {
        use hplt_transport::Error as E;
        let message = error.to_string();
        match error {
            E::Interrupted(_) => Self::interrupted(),
            E::Option { .. } => Self::usage(message),
            E::NoFiniteSolution { .. } => Self::new(Exit::NotConverged, "NO_FINITE_SOLUTION", message),
            E::Diverging { .. } => Self::new(Exit::NotConverged, "DIVERGING", message),
            E::NotFinite { .. } => Self::new(Exit::NotFinite, "NOT_FINITE", message),
            _ => Self::new(Exit::Bug, "TRANSPORT", message),
        }
    }
}

impl From<hplt_geom::Interrupted> for Failure {
    fn from(_: hplt_geom::Interrupted) -> Self {
        Self::interrupted()
    }
}

impl Failure {
    /// Stopped before there was anything to write; [`crate::progress::Reporter::why_stopped`] refines it.
    pub fn interrupted() -> Self {
        Self::new(Exit::Interrupted, "INTERRUPTED", "interrupted before there was a result; nothing was written")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_is_one_harmless_line() {
        let failure = Failure::new(Exit::Input, "X", "a\nb\u{1b}[31m");
        assert_eq!(failure.to_string(), "error[X]: a b?[31m");
    }
}
