//! The machine and build of a measurement.

use std::path::Path;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

use fearless_simd::Level;
use serde::Serialize;

/// The machine, the build and the date.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Machine {
    /// Model name of the processor.
    pub cpu: String,
    /// Hardware threads.
    pub cores: usize,
    /// Instruction set of the ray kernels.
    pub instructions: String,
    /// Operating system.
    pub os: String,
    /// Version of this program.
    pub version: &'static str,
    /// `release`, or `debug`, whose times mean nothing.
    pub build: &'static str,
    /// Commit of the checkout in which the program was built, if it still exists.
    pub commit: Option<String>,
    /// UTC, as 2026-01-31.
    pub date: String,
}

impl Machine {
    /// This machine.
    pub fn here() -> Self {
        let level = format!("{:?}", Level::new());
        let level = level.split('(').next().unwrap_or_default().to_owned();
        Self {
            cpu: cpu().unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
            cores: std::thread::available_parallelism().map_or(1, usize::from),
            instructions: level,
            os: os(),
            version: env!("CARGO_PKG_VERSION"),
            build: if cfg!(debug_assertions) {
                "debug"
            } else {
                "release"
            },
            commit: option_env!("GHOSTLIGHT_COMMIT")
                .map(str::to_owned)
                .or_else(|| commit(Path::new(env!("CARGO_MANIFEST_DIR")))),
            date: today(),
        }
    }
}

fn cpu() -> Option<String> {
    let text = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_owned())
}

fn os() -> String {
    let name = std::fs::read_to_string("/etc/os-release")
        .ok()
        .and_then(|text| {
            let line = text
                .lines()
                .find_map(|line| line.strip_prefix("PRETTY_NAME="))?;
            Some(line.trim_matches('"').to_owned())
        });
    name.unwrap_or_else(|| std::env::consts::OS.to_owned())
}

/// Short commit of a checkout, with `+` if its files have changes.
fn commit(folder: &Path) -> Option<String> {
    let git = |args: &[&str]| {
        let output = Command::new("git")
            .arg("-C")
            .arg(folder)
            .args(args)
            .output()
            .ok()?;
        output.status.success().then_some(())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let hash = git(&["rev-parse", "--short=12", "HEAD"])?;
    let changed = git(&["status", "--porcelain", "--untracked-files=no"])?;
    Some(hash + if changed.is_empty() { "" } else { "+" })
}

fn today() -> String {
    let since = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let [y, m, d] = date_of_day((since.as_secs() / 86_400) as i64);
    format!("{y:04}-{m:02}-{d:02}")
}

/// Year, month and day of a day counted from 1970-01-01 (Hinnant, "chrono-compatible low-level date algorithms",
/// `civil_from_days`).
fn date_of_day(day: i64) -> [i64; 3] {
    let z = day + 719_468;
    let era = z.div_euclid(146_097);
    let of_era = z.rem_euclid(146_097);
    let year = (of_era - of_era / 1460 + of_era / 36_524 - of_era / 146_096) / 365;
    let of_year = of_era - (365 * year + year / 4 - year / 100);
    let m = (5 * of_year + 2) / 153;
    let month = if m < 10 { m + 3 } else { m - 9 };
    let first = i64::from(month <= 2);
    [
        year + era * 400 + first,
        month,
        of_year - (153 * m + 2) / 5 + 1,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_have_dates() {
        assert_eq!(date_of_day(0), [1970, 1, 1]);
        assert_eq!(date_of_day(11_016), [2000, 2, 29]);
        assert_eq!(date_of_day(20_454), [2026, 1, 1]);
        assert_eq!(date_of_day(-1), [1969, 12, 31]);
    }
}
