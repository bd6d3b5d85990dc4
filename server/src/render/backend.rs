//! Rendering backends.

use serde::{Deserialize, Serialize};

use super::error::RenderError;

/// A rendering backend. Any of them can be requested from an [`Engine`](super::Engine), which uses one of the
/// last two.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// The fastest available
    #[default]
    Auto,
    /// The processor
    Cpu,
    /// A graphics card; not in this build
    Gpu,
}

impl Backend {
    /// Name on the command line and in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Cpu => "cpu",
            Self::Gpu => "gpu",
        }
    }

    /// The backend that is used if this one is requested.
    pub fn resolve(self) -> Result<Self, RenderError> {
        match self {
            Self::Auto | Self::Cpu => Ok(Self::Cpu),
            Self::Gpu => Err(RenderError::NoGpu),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn auto_is_the_processor_and_a_gpu_is_an_error_that_says_what_to_do() {
        assert_eq!(Backend::Auto.resolve().unwrap(), Backend::Cpu);
        assert_eq!(Backend::Cpu.resolve().unwrap(), Backend::Cpu);
        let error = Backend::Gpu.resolve().unwrap_err().to_string();
        assert_eq!(
            error,
            "backend gpu: this build has no GPU backend; use auto or cpu"
        );
        for backend in [Backend::Auto, Backend::Cpu, Backend::Gpu] {
            let json = serde_json::to_string(&backend).unwrap();
            assert_eq!(json, format!("{:?}", backend.name()));
        }
    }
}
