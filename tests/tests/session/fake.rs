//! A source and a renderer in memory, so that the tests observe the service alone.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::frame::{BoxError, ColorImage, DepthImage, FrameSource, RgbdFrame};
use ghostlight::memory::Budget;
use ghostlight::net::{
    Assets, Catalog, RecordingInfo, SceneInfo, SceneLoad, SceneRenderer, Unrendered,
};
use ghostlight::render::{
    Aov, AovImage, Checkpoint, FrameStats, Lowered, RenderSettings, Rendered, Stage,
};
use ghostlight_proto::control::{ObjectInfo, SceneChoice, Stands};
use ghostlight_proto::{Code, WireError};

pub(crate) const WIDTH: u32 = 32;
pub(crate) const HEIGHT: u32 = 24;

/// Frames of its recording, one every 20 ms.
pub(crate) const FRAMES: usize = 10;

#[derive(Default)]
pub(crate) struct Fake {
    /// How long a frame takes to render.
    pub(crate) render: Duration,
    /// Frames rendered, over all sessions.
    pub(crate) rendered: Arc<AtomicU64>,
    /// Endless frames begun, and endless frames cancelled, over all sessions.
    pub(crate) endless: Arc<AtomicU64>,
    pub(crate) given_up: Arc<AtomicU64>,
    /// Loads that were cancelled.
    pub(crate) stopped_loads: Arc<AtomicU64>,
}

/// Value of `glossy_samples` for which a frame never ends.
pub(crate) const ENDLESS: u32 = 64;

impl Catalog for Fake {
    fn recordings(&self) -> Vec<RecordingInfo> {
        let info = |name: &str| RecordingInfo {
            name: name.to_owned(),
            frames: FRAMES,
            width: WIDTH,
            height: HEIGHT,
            duration_s: 0.18,
        };
        vec![info("room"), info("hall")]
    }

    fn scenes(&self) -> Vec<SceneInfo> {
        let names = ["invert", "plain"];
        names
            .map(|name| SceneInfo {
                name: name.to_owned(),
            })
            .to_vec()
    }

    fn open(&self, recording: &str) -> Result<Box<dyn FrameSource>, WireError> {
        let shade = match recording {
            "room" => 40,
            "hall" => 90,
            _ => {
                return Err(WireError::new(
                    Code::NotFound,
                    "recording",
                    "room or hall",
                    recording,
                ));
            }
        };
        let times = (0..FRAMES as i64).map(|i| i * 20_000_000).collect();
        Ok(Box::new(Loop { shade, times }))
    }

    fn renderer(&self, _: &Budget) -> Result<Box<dyn SceneRenderer>, WireError> {
        Ok(Box::new(Inverter {
            name: None,
            invert: false,
            angle: 0.0,
            pixel: None,
            render: self.render,
            rendered: Arc::clone(&self.rendered),
            endless: Arc::clone(&self.endless),
            given_up: Arc::clone(&self.given_up),
            stopped_loads: Arc::clone(&self.stopped_loads),
        }))
    }
}

struct Loop {
    shade: u8,
    times: Vec<i64>,
}

impl FrameSource for Loop {
    fn n_frames(&self) -> usize {
        self.times.len()
    }

    fn time_ns(&self, index: usize) -> Option<i64> {
        self.times.get(index).copied()
    }

    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        let shade = self.shade + index as u8;
        let n = (WIDTH * HEIGHT) as usize;
        Ok(RgbdFrame {
            index: 0,
            time_ns: 0,
            color: ColorImage::filled(WIDTH, HEIGHT, [shade, shade, shade, 255]),
            depth: DepthImage::from_metres(WIDTH, HEIGHT, vec![1.0; n]),
            intrinsics: Intrinsics::new(30.0, 30.0, 15.5, 11.5, WIDTH, HEIGHT).unwrap(),
            pose: Pose::IDENTITY,
        })
    }
}

/// A renderer that inverts the picture. Its scenes are "invert" and "plain", [`SLOW`], and "misfit", which cannot
/// be placed in any frame; a document may name one mesh, an upload.
#[derive(Clone)]
struct Inverter {
    name: Option<String>,
    invert: bool,
    /// Whether placing the scene in the first frame fails.
    angle: f64,
    pixel: Option<[f64; 2]>,
    render: Duration,
    rendered: Arc<AtomicU64>,
    endless: Arc<AtomicU64>,
    given_up: Arc<AtomicU64>,
    stopped_loads: Arc<AtomicU64>,
}

impl Inverter {
    fn place_at(&mut self, object: &str, pixel: [f64; 2]) -> Result<(), WireError> {
        if object != "thing" {
            return Err(WireError::new(Code::Object, "object", "thing", object));
        }
        self.pixel = Some(pixel);
        Ok(())
    }
}

/// The load of a scene of this name takes until it is cancelled.
pub(crate) const SLOW: &str = "slow";

struct Loading(Inverter);

impl SceneLoad for Loading {
    fn name(&self) -> Option<String> {
        self.0.name.clone()
    }

    fn objects(&self) -> Vec<ObjectInfo> {
        self.0.objects()
    }

    fn run(
        self: Box<Self>,
        _frame: &RgbdFrame,
        _: &RenderSettings,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn SceneRenderer>, WireError> {
        while self.0.name.as_deref() == Some(SLOW) {
            if stop.load(Ordering::Relaxed) {
                self.0.stopped_loads.fetch_add(1, Ordering::Relaxed);
                return Err(WireError::new(Code::Scene, "scene", "wanted", "stopped"));
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        if self.0.name.as_deref() == Some("misfit") {
            let expected = "one that fits";
            return Err(WireError::new(Code::Scene, "scene", expected, "another"));
        }
        Ok(Box::new(self.0))
    }
}

impl SceneRenderer for Inverter {
    fn begin_scene(
        &mut self,
        scene: &SceneChoice,
        assets: &Assets,
    ) -> Result<Box<dyn SceneLoad>, WireError> {
        let (name, invert) = match scene {
            SceneChoice::Name(name)
                if ["invert", "plain", "misfit", SLOW].contains(&name.as_str()) =>
            {
                (Some(name.clone()), name != "plain")
            }
            SceneChoice::Name(name) => {
                return Err(WireError::new(
                    Code::NotFound,
                    "scene",
                    "invert or plain",
                    name,
                ));
            }
            SceneChoice::Document(document) => {
                let mesh = document.get("mesh").and_then(|m| m.as_str()).unwrap_or("");
                if !assets.contains_key(mesh) {
                    return Err(WireError::new(
                        Code::Scene,
                        "scene, mesh",
                        "an upload",
                        mesh,
                    ));
                }
                (None, true)
            }
        };
        Ok(Box::new(Loading(Self {
            name,
            invert,
            ..self.clone()
        })))
    }

    fn scene_name(&self) -> Option<String> {
        self.name.clone()
    }

    fn objects(&self) -> Vec<ObjectInfo> {
        vec![ObjectInfo {
            name: "thing".to_owned(),
            stands: self.pixel.map(|[u, v]| Stands {
                pose: ghostlight_proto::Pose {
                    translation: [u, v, 0.0],
                    ..ghostlight_proto::Pose::IDENTITY
                },
                turned: self.angle,
            }),
        }]
    }

    fn place(
        &mut self,
        object: &str,
        pixel: [f64; 2],
        _frame: &RgbdFrame,
        _: &RenderSettings,
    ) -> Result<Option<String>, WireError> {
        self.place_at(object, pixel).map(|()| None)
    }

    fn put_back(&mut self, object: &str, stands: &Stands) -> Result<(), WireError> {
        let [u, v, _] = stands.pose.translation;
        self.angle = stands.turned;
        self.place_at(object, [u, v])
    }

    fn turn(&mut self, object: &str, angle: f64) -> Result<(), WireError> {
        if object != "thing" {
            return Err(WireError::new(Code::Object, "object", "thing", object));
        }
        self.angle += angle;
        Ok(())
    }

    fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, Unrendered> {
        // Simulates work; nothing measures it. `glossy_samples` of 64 simulates a frame that never ends.
        let endless = settings.glossy_samples == ENDLESS;
        self.endless.fetch_add(endless.into(), Ordering::Relaxed);
        let begun = Instant::now();
        while endless || begun.elapsed() < self.render {
            if !checkpoint.go_on() {
                self.given_up.fetch_add(1, Ordering::Relaxed);
                return Err(Unrendered::Cancelled);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        self.rendered.fetch_add(1, Ordering::Relaxed);
        let mut color = frame.color.clone();
        if self.invert {
            for [r, g, b, _] in &mut color.rgba {
                (*r, *g, *b) = (255 - *r, 255 - *g, 255 - *b);
            }
        }
        // The object is one red pixel; turned by half a turn it is blue.
        if let Some([u, v]) = self.pixel {
            let at = v as usize * WIDTH as usize + u as usize;
            let seen = if self.angle == 0.0 {
                [255, 0, 0, 255]
            } else {
                [0, 0, 255, 255]
            };
            color.rgba[at] = seen;
        }
        let n = color.rgba.len();
        let aovs = aovs.iter().map(|&aov| {
            let image = match aov {
                Aov::Depth => AovImage::Gray16((0..n).map(|i| 1000 + i as u16).collect()),
                _ => AovImage::Gray8(vec![u8::from(self.invert) * 255; n]),
            };
            (aov, image)
        });
        Ok(Rendered {
            aovs: aovs.collect(),
            color,
            stage_ns: [1_000_000; Stage::ALL.len()],
            total_ns: 8_000_000,
            stats: FrameStats {
                pixels: n as u64,
                virtual_pixels: 7,
                ..FrameStats::default()
            },
            // Reports the time budget that it was given.
            lowered: Vec::from_iter(settings.budget_ms.filter(|&ms| ms > 0.0).map(|ms| Lowered {
                setting: "budget_ms",
                asked: "none".to_owned(),
                used: format!("{ms:.1}"),
            })),
        })
    }
}
