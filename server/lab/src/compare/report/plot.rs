//! A curve as an inline SVG.

use std::fmt::Write as _;

use super::html::escape;
use super::layout::{Labels, Scale};
use crate::compare::section::{Axis, Column, Curve, Point};

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 340.0;
/// Left, top, right, bottom of the plotting area, pixels.
const AREA: [f64; 4] = [62.0, 12.0, 466.0, 292.0];
/// Number of colours in the page's style sheet.
const N_COLORS: usize = 7;

/// Names of the curve's series in the order of their first points, without printed figures.
pub(super) fn series(curve: &Curve) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for point in curve.points.iter().filter(|point| point.printed.is_none()) {
        if !point.series.is_empty() && !names.contains(&point.series.as_str()) {
            names.push(&point.series);
        }
    }
    names
}

/// The style's class for a series.
pub(super) fn color(names: &[&str], name: &str) -> String {
    match names.iter().position(|known| *known == name) {
        Some(i) => format!("c{}", i % N_COLORS),
        None => "c-none".to_owned(),
    }
}

/// The plot; empty if the curve has no axes.
pub(super) fn svg(curve: &Curve) -> String {
    let Some([x_axis, y_axis]) = curve.plot else {
        return String::new();
    };
    let names = series(curve);
    let value = |point: &Point, axis: Axis| {
        let cell = point.values.get(axis.column());
        cell.map_or(f64::NAN, crate::compare::Cell::number)
    };
    let scale = |axis, from, to| {
        let values: Vec<f64> = curve
            .points
            .iter()
            .map(|point| value(point, axis))
            .collect();
        Scale::new(matches!(axis, Axis::Log(_)), &values, from, to)
    };
    let [left, top, right, bottom] = AREA;
    let x_scale = scale(x_axis, left, right);
    let y_scale = scale(y_axis, bottom, top);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" role=\"img\" aria-label=\"{}\">\n",
        escape(&curve.title)
    );
    for (x, name) in x_scale.ticks() {
        let _ = writeln!(
            svg,
            "<path class=\"grid\" d=\"M{x:.1} {top}V{bottom}\"/>\
             <text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{name}</text>",
            bottom + 17.0
        );
    }
    for (y, name) in y_scale.ticks() {
        let _ = writeln!(
            svg,
            "<path class=\"grid\" d=\"M{left} {y:.1}H{right}\"/>\
             <text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"end\">{name}</text>",
            left - 6.0,
            y + 4.0
        );
    }
    let axis_name = |axis: Axis| {
        curve
            .columns
            .get(axis.column())
            .map(named)
            .unwrap_or_default()
    };
    let _ = writeln!(
        svg,
        "<text class=\"axis\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\">{}</text>\
         <text class=\"axis\" transform=\"translate(14 {:.1}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
        (left + right) / 2.0,
        HEIGHT - 8.0,
        escape(&axis_name(x_axis)),
        (top + bottom) / 2.0,
        escape(&axis_name(y_axis)),
    );

    let place = |point: &Point| {
        Some((
            x_scale.at(value(point, x_axis))?,
            y_scale.at(value(point, y_axis))?,
        ))
    };
    let lines = curve
        .points
        .iter()
        .filter(|point| point.printed.is_some() && place(point).is_none())
        .filter_map(|point| Some((x_scale.at(value(point, x_axis))?, point.label.as_str())));
    printed_lines(&mut svg, lines.collect());
    for name in &names {
        let line: Vec<String> = curve
            .points
            .iter()
            .filter(|point| point.series == *name && point.printed.is_none())
            .filter_map(place)
            .map(|(x, y)| format!("{x:.1},{y:.1}"))
            .collect();
        if curve.joined && line.len() > 1 {
            let class = color(&names, name);
            let _ = writeln!(
                svg,
                "<polyline class=\"line {class}\" points=\"{}\"/>",
                line.join(" ")
            );
        }
    }
    let placed: Vec<(&Point, (f64, f64))> = curve
        .points
        .iter()
        .filter_map(|point| Some((point, place(point)?)))
        .collect();
    let spots: Vec<(f64, f64)> = placed.iter().map(|(_, at)| *at).collect();
    let mut labels = Labels::new(&spots, AREA);
    for (point, (x, y)) in placed {
        let class = color(&names, &point.series);
        let marker = if point.printed.is_some() {
            format!(
                "<path class=\"printed\" d=\"M{x:.1} {:.1}l5 5l-5 5l-5 -5z\"",
                y - 5.0
            )
        } else if point.reference {
            format!("<circle class=\"reference {class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"5\"")
        } else {
            format!("<circle class=\"{class}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\"")
        };
        let _ = writeln!(
            svg,
            "{marker}><title>{}</title></{}>",
            escape(&told(curve, point)),
            if point.printed.is_some() {
                "path"
            } else {
                "circle"
            }
        );
        if let Some(label) = labels.place((x, y), &point.label) {
            let _ = writeln!(
                svg,
                "<text class=\"label\" x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"{}\">{}</text>",
                label.x,
                label.y,
                label.anchor,
                escape(&point.label)
            );
        }
    }
    svg + "</svg>\n"
}

/// A printed figure without an error is drawn as a line at its time. Names that would overlap are placed at
/// opposite ends of their lines.
fn printed_lines(svg: &mut String, mut lines: Vec<(f64, &str)>) {
    const LINE: f64 = 13.0;
    let [_, top, _, bottom] = AREA;
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut last = [f64::NEG_INFINITY; 2];
    for (x, name) in lines {
        let _ = writeln!(
            svg,
            "<path class=\"printed\" d=\"M{x:.1} {top}V{bottom}\"/>"
        );
        let Some(end) = (0..2).find(|&end| x - last[end] >= LINE) else {
            continue;
        };
        last[end] = x;
        let (y, anchor) = [(top + 2.0, "end"), (bottom - 4.0, "start")][end];
        let _ = writeln!(
            svg,
            "<text class=\"theirs\" transform=\"translate({:.1} {y:.1}) rotate(-90)\" \
             text-anchor=\"{anchor}\">{}</text>",
            x - 3.0,
            escape(name)
        );
    }
}

/// A column's name with its unit.
pub(super) fn named(column: &Column) -> String {
    match column.unit {
        "" => column.name.to_owned(),
        unit => format!("{}, {unit}", column.name),
    }
}

/// All values of a point, for a tooltip.
fn told(curve: &Curve, point: &Point) -> String {
    let mut text = if point.series.is_empty() {
        point.label.clone()
    } else {
        format!("{}, {}", point.series, point.label)
    };
    for (column, cell) in curve.columns.iter().zip(&point.values) {
        let _ = write!(text, "\n{}: {}", named(column), super::html::cell(cell));
    }
    text
}
