//! The stages of a frame, and the clock that times them.

/// A step of a frame; steps run in this order. Benches, timings, reports and client graphs derive from
/// [`Stage::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Builds the ghost surface from depth: connectivity, pyramid.
    Ghost,
    /// Emits, traces and sorts photons for caustics.
    Photons,
    /// Places instances relative to the camera and finds the tiles that virtual objects can affect.
    Plan,
    /// Finds the surface that each affected pixel shows.
    Primary,
    /// Ambient light that virtual objects occlude from real surfaces and reflect onto them.
    Ambient,
    /// Visibility of lights.
    Shadow,
    /// Mean filter over penumbra.
    ShadowFilter,
    /// Shading, secondary rays and compositing.
    Shade,
    /// Post passes: bloom and glare.
    Post,
    /// Converts linear light to 8-bit RGBA.
    Encode,
}

impl Stage {
    /// Every stage, in order.
    pub const ALL: [Self; 10] = [
        Self::Ghost,
        Self::Photons,
        Self::Plan,
        Self::Primary,
        Self::Ambient,
        Self::Shadow,
        Self::ShadowFilter,
        Self::Shade,
        Self::Post,
        Self::Encode,
    ];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ghost => "ghost",
            Self::Photons => "photons",
            Self::Plan => "plan",
            Self::Primary => "primary",
            Self::Ambient => "ambient",
            Self::Shadow => "shadow",
            Self::ShadowFilter => "shadow_filter",
            Self::Shade => "shade",
            Self::Post => "post",
            Self::Encode => "encode",
        }
    }
}

/// Nanoseconds since any fixed moment.
pub type Clock = fn() -> u64;

/// Times the stages of one frame.
pub(crate) struct StageTimes {
    clock: Clock,
    last: u64,
    /// Nanoseconds per stage, in the order of [`Stage::ALL`].
    pub(crate) ns: [u64; Stage::ALL.len()],
}

impl StageTimes {
    /// Starts the clock.
    pub(crate) fn start(clock: Clock) -> Self {
        Self {
            clock,
            last: clock(),
            ns: [0; Stage::ALL.len()],
        }
    }

    /// Adds the time since the last call to a stage.
    pub(crate) fn done(&mut self, stage: Stage) {
        let now = (self.clock)();
        self.ns[stage as usize] += now - self.last;
        self.last = now;
    }
}
