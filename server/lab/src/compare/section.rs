//! The result of an experiment: text, tables that may be drawn as plots, pictures, bounds.

use serde::Serialize;

use super::picture::Picture;

/// The result of an experiment, in reading order.
#[derive(Debug, Default, Serialize)]
pub struct Section {
    pub(super) blocks: Vec<Block>,
    pub(super) bounds: Vec<Bound>,
}

/// A piece of a section.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub(super) enum Block {
    Prose { text: String },
    Curve(Curve),
    Pictures { pictures: Vec<Picture> },
}

impl Section {
    /// An empty section.
    pub fn new() -> Self {
        Self::default()
    }

    /// A paragraph; words between backticks are set as code.
    pub fn prose(&mut self, text: impl Into<String>) {
        self.blocks.push(Block::Prose { text: text.into() });
    }

    /// A table; also drawn as a plot if [`Curve::plot`] was called.
    pub fn curve(&mut self, curve: Curve) {
        self.blocks.push(Block::Curve(curve));
    }

    /// Pictures side by side: usually reference, result, difference.
    pub fn pictures(&mut self, pictures: impl IntoIterator<Item = Picture>) {
        self.blocks.push(Block::Pictures {
            pictures: pictures.into_iter().collect(),
        });
    }

    /// Adds a bound that must hold.
    pub fn bound(&mut self, bound: Bound) {
        self.bounds.push(bound);
    }
}

/// A condition that must hold on every machine; never on a time.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Bound {
    /// The bounded quantity.
    pub what: String,
    /// The required value.
    pub expected: String,
    /// The measured value.
    pub got: String,
    /// Whether it holds.
    pub kept: bool,
}

impl Bound {
    /// A bound given by its texts.
    pub fn new(
        what: impl Into<String>,
        expected: impl Into<String>,
        got: impl Into<String>,
        kept: bool,
    ) -> Self {
        Self {
            what: what.into(),
            expected: expected.into(),
            got: got.into(),
            kept,
        }
    }

    /// `got <= most`; NaN breaks it.
    pub fn at_most(what: impl Into<String>, most: f64, got: f64, unit: &str) -> Self {
        let told = |x| with_unit(&number(x), unit);
        Self::new(
            what,
            format!("at most {}", told(most)),
            told(got),
            got <= most,
        )
    }

    /// `got >= least`; NaN breaks it.
    pub fn at_least(what: impl Into<String>, least: f64, got: f64, unit: &str) -> Self {
        let told = |x| with_unit(&number(x), unit);
        Self::new(
            what,
            format!("at least {}", told(least)),
            told(got),
            got >= least,
        )
    }

    /// A count that must be zero, and the number of trials.
    pub fn none_of(what: impl Into<String>, got: usize, of: usize) -> Self {
        let of = number(of as f64);
        Self::new(
            what,
            format!("0 of {of}"),
            format!("{got} of {of}"),
            got == 0,
        )
    }
}

fn with_unit(text: &str, unit: &str) -> String {
    match unit {
        "" => text.to_owned(),
        "%" | "x" => format!("{text}{unit}"),
        unit if unit.starts_with('/') => format!("{text}{unit}"),
        unit => format!("{text} {unit}"),
    }
}

/// A table of points with named columns, and how it is drawn.
#[derive(Debug, Clone, Serialize)]
pub struct Curve {
    pub(super) title: String,
    pub(super) columns: Vec<Column>,
    pub(super) points: Vec<Point>,
    pub(super) plot: Option<[Axis; 2]>,
    /// Whether points of a series are joined.
    pub(super) joined: bool,
}

/// A column's name and unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Column {
    pub(super) name: &'static str,
    /// Empty if the column has no unit.
    pub(super) unit: &'static str,
}

/// The column (by index) that an axis shows, and its scale.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// Linear, from zero.
    Linear(usize),
    /// Logarithmic; zero gets a lane of its own.
    Log(usize),
}

impl Axis {
    pub(super) fn column(self) -> usize {
        match self {
            Self::Linear(column) | Self::Log(column) => column,
        }
    }
}

/// A row of a [`Curve`].
#[derive(Debug, Clone, Serialize)]
pub struct Point {
    pub(super) series: String,
    pub(super) label: String,
    pub(super) values: Vec<Cell>,
    pub(super) reference: bool,
    pub(super) printed: Option<Printed>,
}

/// Content of a table cell.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Cell {
    /// A number; NaN if it is not known.
    Number(f64),
    /// Text.
    Text(String),
}

impl From<f64> for Cell {
    fn from(x: f64) -> Self {
        Self::Number(x)
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl Cell {
    pub(super) fn number(&self) -> f64 {
        match self {
            Self::Number(x) => *x,
            Self::Text(_) => f64::NAN,
        }
    }
}

/// Source of a figure that was printed elsewhere.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Printed {
    /// Authors, year, section or table.
    pub source: &'static str,
    /// The machine on which it was measured.
    pub machine: &'static str,
}

impl Curve {
    /// A table with the given columns, each a name and a unit (empty if there is none).
    pub fn new(
        title: impl Into<String>,
        columns: impl IntoIterator<Item = (&'static str, &'static str)>,
    ) -> Self {
        let column = |(name, unit)| Column { name, unit };
        Self {
            title: title.into(),
            columns: columns.into_iter().map(column).collect(),
            points: Vec::new(),
            plot: None,
            joined: true,
        }
    }

    /// Draws points of a series without a line through them.
    #[must_use]
    pub fn scattered(mut self) -> Self {
        self.joined = false;
        self
    }

    /// Draws one column over another; points of one series are joined in their order.
    #[must_use]
    pub fn plot(mut self, x: Axis, y: Axis) -> Self {
        self.plot = Some([x, y]);
        self
    }

    /// Adds a point. Values are in the order of the columns; missing values at the end are unknown.
    pub fn point(
        &mut self,
        series: impl Into<String>,
        label: impl Into<String>,
        values: impl IntoIterator<Item = impl Into<Cell>>,
    ) -> &mut Point {
        let mut values: Vec<Cell> = values.into_iter().map(Into::into).collect();
        values.resize(self.columns.len(), Cell::Number(f64::NAN));
        self.points.push(Point {
            series: series.into(),
            label: label.into(),
            values,
            reference: false,
            printed: None,
        });
        let last = self.points.len() - 1;
        &mut self.points[last]
    }
}

impl Point {
    /// Marks this point as the reference for the errors of the others.
    pub fn reference(&mut self) {
        self.reference = true;
    }

    /// Marks this point as a figure printed elsewhere.
    pub fn printed(&mut self, printed: Printed) {
        self.printed = Some(printed);
    }
}

/// Formats a number: three significant digits, counts in full.
pub fn number(x: f64) -> String {
    let size = x.abs();
    if x.is_nan() {
        return "–".to_owned();
    }
    if size.is_infinite() {
        return x.to_string();
    }
    if x == x.round() && size < 1e15 {
        return grouped(x);
    }
    if !(1e-3..1e6).contains(&size) {
        return format!("{x:.1e}");
    }
    // Digits before the decimal point, 1 for 0.0123.
    let whole = size.log10().floor() as i32;
    let decimals = (2 - whole).clamp(0, 5) as usize;
    if decimals == 0 {
        grouped(x.round())
    } else {
        format!("{x:.decimals$}")
    }
}

/// A whole number with its digits grouped by three, from five digits on.
fn grouped(x: f64) -> String {
    let digits = format!("{x:.0}");
    let n = digits.trim_start_matches('-').len();
    if n < 5 {
        return digits;
    }
    let mut told = String::new();
    let lead = digits.len() - n;
    for (i, digit) in digits.chars().enumerate() {
        if i > lead && (digits.len() - i) % 3 == 0 {
            told.push(',');
        }
        told.push(digit);
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_read_well() {
        for (x, told) in [
            (0.0, "0"),
            (7.0, "7"),
            (-7.25, "-7.25"),
            (1234.0, "1234"),
            (12345.6, "12,346"),
            (10_000_000.0, "10,000,000"),
            (-123_456.0, "-123,456"),
            (0.0123, "0.0123"),
            (1.5e-8, "1.5e-8"),
            (3.21987, "3.22"),
            (f64::NAN, "–"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(number(x), told, "{x}");
        }
    }

    #[test]
    fn bounds_are_broken_by_what_is_no_number() {
        assert!(Bound::at_most("error", 1.0, 1.0, "1/255").kept);
        assert!(!Bound::at_most("error", 1.0, 1.01, "1/255").kept);
        assert!(!Bound::at_most("error", 1.0, f64::NAN, "").kept);
        assert!(!Bound::at_least("speed", 1.0, f64::NAN, "x").kept);
        assert!(Bound::none_of("missed", 0, 10).kept);
        assert!(!Bound::none_of("missed", 1, 10).kept);
    }
}
