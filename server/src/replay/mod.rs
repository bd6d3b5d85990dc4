//! Replays a recording: reads frames, writes composites as pictures or a film, and times and hashes into a
//! report.
//!
//! Reading frame n + 1 and writing frame n - 1 happen on other threads than rendering frame n, with short bounded
//! queues between them. With [`ReplayOptions::measure`] they wait while a frame is rendered, so that the measured
//! times are those of rendering alone.
//!
//! All output is first written beside its destination and moved there after the last frame, so an error leaves no
//! partial output and does not damage existing files.

mod error;
mod film;
mod output;
mod picture;
mod report;

pub use error::{FilmError, ReplayError};
pub use output::Output;
pub use picture::png_of;
pub use report::{FrameReport, LeftOut, Report, Summary};

use std::ops::{ControlFlow, Range};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::time::Instant;

use crate::frame::{BoxError, FrameSource, RgbdFrame};
use crate::render::{Aov, Backend, RenderError, Rendered, Stage};
use error::write_error;
use output::Writer;

use crate::output::Draft;

/// What the reader thread sends: a frame, or the reason why there is none.
enum Read {
    Frame(RgbdFrame),
    LeftOut(BoxError),
    Failed(BoxError),
}

/// Requested frames, half-open; frames left out when the recording was opened do not count. Either end may be
/// omitted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FrameRange {
    /// First frame.
    pub start: usize,
    /// One past the last; to the end if `None`.
    pub end: Option<usize>,
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected A..B with A < B, as in 0..60, got {text:?}");
        let (start, end) = text.split_once("..").ok_or_else(expected)?;
        let number = |text: &str| text.parse::<usize>().map_err(|_| expected());
        let range = Self {
            start: if start.is_empty() { 0 } else { number(start)? },
            end: if end.is_empty() {
                None
            } else {
                Some(number(end)?)
            },
        };
        match range.end {
            Some(end) if end <= range.start => Err(expected()),
            _ => Ok(range),
        }
    }
}

impl FrameRange {
    fn of(self, n_frames: usize) -> Result<Range<usize>, ReplayError> {
        if n_frames == 0 {
            return Err(ReplayError::Empty);
        }
        let end = self.end.unwrap_or(n_frames);
        if self.start >= n_frames || end > n_frames {
            return Err(ReplayError::Range {
                start: self.start,
                end,
                n_frames,
            });
        }
        Ok(self.start..end)
    }
}

/// What to replay and where to write it.
#[derive(Debug, Clone)]
pub struct ReplayOptions {
    /// Frames to replay.
    pub frames: FrameRange,
    /// AOVs to write; only into a folder.
    pub aovs: Vec<Aov>,
    /// Where to write composites.
    pub output: Output,
    /// Rendering backend, for the report.
    pub backend: Backend,
    /// Path of the JSON report.
    pub report: Option<PathBuf>,
    /// Read and write nothing while a frame is rendered, so that times are those of rendering alone.
    pub measure: bool,
}

/// A rendered frame for the writers.
struct Done {
    index: usize,
    time_ns: i64,
    rendered: Rendered,
}

/// Queue length between threads: one frame is being passed on, one waits.
const QUEUE: usize = 1;

/// Replays `source`, rendering each frame with `render`.
///
/// `progress(done, total)` is called before the first frame and after every frame; if it returns `Break`, the
/// replay stops with [`ReplayError::Stopped`].
pub fn run<S: FrameSource>(
    source: &mut S,
    mut render: impl FnMut(&RgbdFrame) -> Result<Rendered, BoxError>,
    options: &ReplayOptions,
    mut progress: impl FnMut(usize, usize) -> ControlFlow<()>,
) -> Result<Report, ReplayError> {
    let range = options.frames.of(source.n_frames())?;
    if let (Output::Film(path), false) = (&options.output, options.aovs.is_empty()) {
        return Err(ReplayError::FilmAov { path: path.clone() });
    }
    let writer = Writer::new(&options.output, &options.aovs)?;
    // Opened before rendering, so that a wrong path fails at once.
    let report_file = options.report.as_deref().map(report_file).transpose()?;

    // With `measure`, a lock that keeps readers and writers idle while a frame is rendered.
    let quiet = options.measure.then(|| RwLock::new(()));
    let quiet = quiet.as_ref();
    let total = range.len();
    let mut frames = Vec::with_capacity(total.min(1 << 16));
    let mut left_out: Vec<LeftOut> = Vec::new();

    let (read_ms, written) = std::thread::scope(|scope| {
        let (to_renderer, from_reader) = sync_channel(QUEUE);
        let reader = spawn(scope, "reader", {
            let range = range.clone();
            move || read(source, range, quiet, &to_renderer)
        })?;
        let (to_writers, from_renderer) = sync_channel::<Done>(QUEUE);
        let queue = Arc::new(Mutex::new(Some(from_renderer)));
        let writers = (0..writer.n_threads())
            .map(|_| {
                let (queue, writer) = (queue.clone(), &writer);
                spawn(scope, "writer", move || write(writer, quiet, &queue))
            })
            .collect::<Result<Vec<_>, _>>()?;
        drop(queue);

        let rendered = (|| {
            for (done, index) in range.clone().enumerate() {
                if progress(done, total).is_break() {
                    return Err(ReplayError::Stopped { index });
                }
                // The reader ends early only after it has sent an error.
                let frame = match from_reader.recv() {
                    Ok(Read::Frame(frame)) => frame,
                    Ok(Read::LeftOut(error)) => {
                        let reason = error.to_string();
                        left_out.push(LeftOut { index, reason });
                        // Every frame was left out, so the replay fails with the last reason.
                        if left_out.len() == total {
                            return Err(ReplayError::Frame {
                                index,
                                source: error,
                            });
                        }
                        continue;
                    }
                    Ok(Read::Failed(source)) => return Err(ReplayError::Frame { index, source }),
                    Err(_) => break,
                };
                let rendered = {
                    let _alone = quiet.map(|quiet| quiet.write());
                    render(&frame).map_err(|source| match source.downcast_ref() {
                        Some(RenderError::Cancelled) => ReplayError::Stopped { index },
                        _ => ReplayError::Render { index, source },
                    })?
                };
                frames.push(FrameReport::new(index, &rendered));
                let time_ns = frame.time_ns;
                let done = Done {
                    index,
                    time_ns,
                    rendered,
                };
                // A writer that has ended reports its own error.
                if to_writers.send(done).is_err() {
                    break;
                }
            }
            Ok(())
        })();
        // Ends the other threads, whichever of them failed.
        drop(from_reader);
        drop(to_writers);
        let mut written = Vec::new();
        let mut failure = rendered.err();
        for thread in writers {
            match joined(thread).and_then(|result| result) {
                Ok(times) => written.extend(times),
                Err(error) => failure = Some(failure.unwrap_or(error)),
            }
        }
        let read_ms = joined(reader);
        match failure {
            Some(error) => Err(error),
            None => Ok((read_ms?, written)),
        }
    })?;

    for frame in &mut frames {
        if let Some(&ms) = read_ms.get(frame.index - range.start) {
            frame.add_stage(report::READ, ms);
        }
    }
    for (index, ms) in written {
        if let Ok(at) = frames.binary_search_by_key(&index, |frame: &FrameReport| frame.index) {
            frames[at].add_stage(report::WRITE, ms);
        }
    }
    let report = Report::new(options.backend, frames, left_out);
    // All temporary files are complete before the first is moved into place; a report to a stream is written
    // last.
    let json = report.to_json();
    let write = |(path, file): &(&Path, Draft)| {
        let written = file.write(json.as_bytes());
        written.map_err(|error| write_error(path, error))
    };
    let (late, early) = match report_file {
        Some(file) if file.1.is_stream() => (Some(file), None),
        other => (None, other),
    };
    early.iter().try_for_each(write)?;
    writer.finish()?;
    late.iter().try_for_each(write)?;
    if let Some((path, file)) = early {
        file.commit().map_err(|error| write_error(path, error))?;
    }
    let _ = progress(total, total);
    Ok(report)
}

fn report_file(path: &Path) -> Result<(&Path, Draft), ReplayError> {
    let draft = Draft::file(path).map_err(|error| write_error(path, error))?;
    Ok((path, draft))
}

/// Reads frames until the renderer ends; returns the milliseconds for each.
fn read<S: FrameSource>(
    source: &mut S,
    range: Range<usize>,
    quiet: Option<&RwLock<()>>,
    to_renderer: &SyncSender<Read>,
) -> Vec<f64> {
    let mut times = Vec::with_capacity(range.len().min(1 << 16));
    for index in range {
        let frame = {
            let _busy = quiet.map(|quiet| quiet.read());
            let start = Instant::now();
            let frame = source.frame(index);
            times.push(start.elapsed().as_secs_f64() * 1e3);
            frame
        };
        let read = match frame {
            Ok(frame) => Read::Frame(frame),
            Err(error) if source.leaves_out(&error) => Read::LeftOut(error),
            Err(error) => Read::Failed(error),
        };
        let failed = matches!(read, Read::Failed(_));
        if to_renderer.send(read).is_err() || failed {
            break;
        }
    }
    times
}

/// Writes frames until there are no more; returns index and milliseconds of each. An error closes the queue for
/// the renderer and the other writers.
fn write(
    writer: &Writer,
    quiet: Option<&RwLock<()>>,
    queue: &Mutex<Option<Receiver<Done>>>,
) -> Result<Vec<(usize, f64)>, ReplayError> {
    let next = || {
        let queue = queue.lock().unwrap_or_else(PoisonError::into_inner);
        queue.as_ref().and_then(|queue| queue.recv().ok())
    };
    let mut times = Vec::new();
    while let Some(done) = next() {
        let _busy = quiet.map(|quiet| quiet.read());
        let start = Instant::now();
        if let Err(error) = writer.write(done.index, done.time_ns, &done.rendered) {
            *queue.lock().unwrap_or_else(PoisonError::into_inner) = None;
            return Err(error);
        }
        times.push((done.index, start.elapsed().as_secs_f64() * 1e3));
    }
    Ok(times)
}

fn spawn<'scope, 'env, T: Send + 'scope>(
    scope: &'scope std::thread::Scope<'scope, 'env>,
    name: &str,
    f: impl FnOnce() -> T + Send + 'scope,
) -> Result<std::thread::ScopedJoinHandle<'scope, T>, ReplayError> {
    std::thread::Builder::new()
        .name(name.to_owned())
        .spawn_scoped(scope, f)
        .map_err(|error| ReplayError::Threads(error.to_string()))
}

fn joined<T>(thread: std::thread::ScopedJoinHandle<'_, T>) -> Result<T, ReplayError> {
    let name = thread.thread().name().unwrap_or("thread").to_owned();
    thread
        .join()
        .map_err(|_| ReplayError::Threads(format!("the {name} panicked")))
}

#[cfg(test)]
mod tests;
