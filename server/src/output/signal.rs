//! Signals that end a command: SIGINT (Ctrl-C), SIGTERM, SIGHUP.

use super::draft::remove_all;
use super::terminal::tell;

/// From now on, a termination signal removes the drafts, prints one line and ends the process with 128 + the signal's
/// number, the convention of shells. A second signal ends it at once.
///
/// SIGHUP stays ignored if it was ignored already (`nohup`).
pub fn clean_up_on_signals() -> std::io::Result<()> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .build()?;
    std::thread::Builder::new()
        .name("signals".to_owned())
        .spawn(move || {
            let number = runtime.block_on(end_signal());
            // Removing may take a moment; a second signal does not wait for it.
            let insist = std::thread::Builder::new().name("signals-2".to_owned());
            let _ = insist.spawn(move || {
                let number = runtime.block_on(end_signal());
                std::process::exit(128 + number);
            });
            remove_all();
            tell("stopped; no incomplete files are left");
            std::process::exit(128 + number);
        })?;
    Ok(())
}

/// Waits for a termination signal and returns its number. SIGHUP is not included if it was ignored at the start.
#[cfg(unix)]
pub async fn end_signal() -> i32 {
    use tokio::signal::unix::{SignalKind, signal};
    let wait = async |kind: SignalKind, ignored: bool| match signal_unless(ignored, kind) {
        Some(mut signal) => {
            signal.recv().await;
            kind.as_raw_value()
        }
        None => std::future::pending().await,
    };
    fn signal_unless(ignored: bool, kind: SignalKind) -> Option<tokio::signal::unix::Signal> {
        (!ignored).then(|| signal(kind).ok()).flatten()
    }
    tokio::select! {
        number = wait(SignalKind::interrupt(), false) => number,
        number = wait(SignalKind::terminate(), false) => number,
        number = wait(SignalKind::hangup(), hangup_is_ignored()) => number,
    }
}

/// Waits for Ctrl-C; returns the number that its signal has on Unix.
#[cfg(not(unix))]
pub async fn end_signal() -> i32 {
    match tokio::signal::ctrl_c().await {
        Ok(()) => 2,
        Err(_) => std::future::pending().await,
    }
}

/// Whether the process was started with SIGHUP ignored, as far as Linux reports it.
#[cfg(unix)]
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    // SIGHUP is signal 1, the lowest bit.
    mask.is_some_and(|mask| mask & 1 != 0)
}
