//! Hard cases: one list, each with a name, why it is hard, and the bound that it must keep.
//!
//! `cargo test` runs them all and names every one that fails; `ghostlight compare` shows what each measured. A
//! bound follows from rounding or from the geometry of the case, or is stated to be heuristic.

mod frames;
mod input;
pub mod kernels;
mod light;
mod maps;
mod mesh;
pub mod shapes;
mod wall;
pub mod watertight;

/// A hard case.
#[derive(Debug, Clone, Copy)]
pub struct HardCase {
    /// What is tested.
    pub name: &'static str,
    /// Why it is hard, in one sentence.
    pub why: &'static str,
    /// What must hold, and why.
    pub bound: &'static str,
    /// Runs the case; the error says what failed.
    pub check: fn(&Effort) -> Result<Measured, String>,
}

/// Amount of work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Effort {
    /// Rays aimed at edges and vertices of closed meshes.
    pub watertight_rays: u64,
}

impl Effort {
    /// Takes seconds, for every change.
    pub const QUICK: Self = Self {
        watertight_rays: 1_000_000,
    };
    /// The number of rays that the product claims.
    pub const FULL: Self = Self {
        watertight_rays: 100_000_000,
    };
}

/// The result of a case that holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Measured {
    /// In words, for people.
    pub got: String,
    /// Rays, pixels or inputs tried.
    pub trials: u64,
}

impl Measured {
    fn new(trials: u64, got: impl Into<String>) -> Self {
        Self {
            got: got.into(),
            trials,
        }
    }
}

/// The largest of several errors, each relative to its own bound.
#[derive(Debug, Default)]
struct Worst {
    trials: u64,
    /// Largest error in units of its bound.
    share: f64,
    broken: Option<String>,
}

impl Worst {
    /// Records an error; NaN breaks every bound.
    fn note(&mut self, error: f64, bound: f64, what: impl FnOnce() -> String) {
        self.trials += 1;
        let within = error <= bound;
        if !within && self.broken.is_none() {
            self.broken = Some(format!("{}: off by {error:.3e}, bound {bound:.3e}", what()));
        }
        if bound > 0.0 {
            self.share = self.share.max(error / bound);
        }
    }

    /// Records a condition that must hold.
    fn require(&mut self, holds: bool, what: impl FnOnce() -> String) {
        self.trials += 1;
        if !holds && self.broken.is_none() {
            self.broken = Some(what());
        }
    }

    /// The outcome, with the worst error as a share of its bound.
    fn bounded(self) -> Result<Measured, String> {
        let got = format!("worst at {:.2} of the bound", self.share);
        self.told(got)
    }

    /// The result in the given words.
    fn told(self, got: impl Into<String>) -> Result<Measured, String> {
        match self.broken {
            Some(broken) => Err(broken),
            None => Ok(Measured::new(self.trials, got)),
        }
    }
}

/// Every case, in the order of the report.
pub const CASES: &[HardCase] = &[
    wall::CENTRE,
    wall::AXES,
    wall::EDGES,
    wall::STARTS,
    wall::BORDER,
    wall::GRAZING,
    wall::RAYS,
    maps::NO_CRACKS,
    maps::STEPS,
    maps::HOLES,
    maps::SMALL,
    maps::RANGE,
    mesh::AXES,
    mesh::SLIVERS,
    mesh::FLAT,
    mesh::REPEATED,
    mesh::FAR,
    mesh::SCALES,
    mesh::TRANSFORMS,
    mesh::RAYS,
    mesh::VERTICES,
    watertight::NEAR,
    watertight::DISTANT,
    watertight::PLACED,
    frames::ORIGIN,
    frames::TURNED_ORIGIN,
    light::PENUMBRA,
    light::POINT,
    light::TOUCHING,
    light::WITHIN,
    input::DEPTH,
    input::CAMERA,
    input::POSE,
    input::SETTINGS,
    input::SCENE,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_keeps_its_bound() {
        let broken: Vec<String> = CASES
            .iter()
            .filter_map(|case| {
                let outcome = (case.check)(&Effort::QUICK);
                match &outcome {
                    Ok(measured) => {
                        println!("kept    {}: {}", case.name, measured.got);
                        assert!(measured.trials > 0, "{} tries nothing", case.name);
                    }
                    Err(what) => println!("BROKEN  {}: {what}", case.name),
                }
                outcome.err().map(|what| format!("{}: {what}", case.name))
            })
            .collect();
        assert!(broken.is_empty(), "{}", broken.join("\n"));
    }

    #[test]
    fn names_differ_and_everything_is_said() {
        for (i, case) in CASES.iter().enumerate() {
            assert!(
                CASES[..i].iter().all(|other| other.name != case.name),
                "{}",
                case.name
            );
            assert!(
                case.why.ends_with('.') && !case.bound.is_empty(),
                "{}",
                case.name
            );
        }
    }

    #[test]
    fn a_broken_bound_is_told() {
        let mut worst = Worst::default();
        worst.note(1.0, 2.0, || "fine".into());
        assert_eq!(worst.share, 0.5);
        worst.note(f64::NAN, 2.0, || "first".into());
        worst.note(3.0, 2.0, || "second".into());
        assert!(
            worst
                .bounded()
                .unwrap_err()
                .starts_with("first: off by NaN")
        );
        let mut worst = Worst::default();
        worst.require(false, || "not so".into());
        assert_eq!(worst.told("").unwrap_err(), "not so");
    }
}
