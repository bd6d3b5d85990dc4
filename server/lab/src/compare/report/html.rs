//! The report page: a single self-contained file without scripts, for light and dark mode and for phones.

use data_encoding::BASE64;
use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::plot;
use crate::compare::section::{Block, Bound, Cell, Curve, Point, number};
use crate::compare::{Finding, Picture, Printed, Report};

const STYLE: &str = include_str!("style.css");

/// The whole report.
pub(in crate::compare) fn html(report: &Report) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { "Ghostlight: speed against error" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                header {
                    h1 { "Speed against error" }
                    (head(report))
                }
                main {
                    @for finding in &report.findings { (section(finding)) }
                }
            }
        }
    };
    page.into_string()
}

/// The machine, the verdict, and the table of contents.
fn head(report: &Report) -> Markup {
    let machine = &report.machine;
    let mut facts = vec![
        ("processor", machine.cpu.clone()),
        (
            "threads",
            format!("{} of {}", report.settings.threads, machine.cores),
        ),
        ("backend", report.settings.backend.name().to_owned()),
        ("instructions", machine.instructions.clone()),
        ("system", machine.os.clone()),
        ("build", machine.build.to_owned()),
        ("date", machine.date.clone()),
        (
            "run",
            if report.settings.quick {
                "quick"
            } else {
                "full"
            }
            .to_owned(),
        ),
        ("recordings", report.settings.views.join(", ")),
    ];
    if let Some(commit) = &machine.commit {
        facts.insert(5, ("commit", commit.clone()));
    }
    let broken = report.broken();
    let n = report.n_bounds();
    html! {
        p {
            "Every approximation of Ghostlight " (machine.version)
            " as a point of time against error, with its reference beside it. Times are medians of \
             rounds in which all variants take turns: trust ratios within one table, not figures of \
             different runs."
        }
        dl.facts {
            @for (name, value) in facts {
                div { dt { (name) } dd { (value) } }
            }
        }
        @if !broken.is_empty() {
            div.verdict.broken {
                p { (broken.len()) " of " (n) " bounds do not hold:" }
                ul { @for line in &broken { li { (line) } } }
            }
        } @else if n > 0 {
            p.verdict.kept { "All " (n) " bounds are kept." }
        }
        nav {
            ol {
                @for finding in &report.findings {
                    li {
                        a href={ "#" (finding.name) } { (finding.title) } " " (badge(finding))
                        br;
                        span { (finding.question) }
                    }
                }
            }
        }
    }
}

fn badge(finding: &Finding) -> Markup {
    let bounds = &finding.section.bounds;
    html! {
        @if finding.failed.is_some() {
            b.broken { "failed" }
        } @else if bounds.iter().any(|bound| !bound.kept) {
            b.broken { "broken" }
        } @else if !bounds.is_empty() {
            b.kept { "kept" }
        }
    }
}

fn section(finding: &Finding) -> Markup {
    html! {
        section id=(finding.name) {
            h2 { (finding.title) }
            p.question { (finding.question) }
            @if let Some(failed) = &finding.failed {
                p.verdict.broken { "This could not be finished: " (failed) }
            }
            @if !finding.section.bounds.is_empty() { (bounds(&finding.section.bounds)) }
            @for block in &finding.section.blocks {
                @match block {
                    Block::Prose { text } => p { (prose(text)) },
                    Block::Curve(all) => (curve(all)),
                    Block::Pictures { pictures: all } => (pictures(all)),
                }
            }
            p.small {
                a href={ (finding.name) ".csv" } { (finding.name) ".csv" }
                " · took " (number(finding.seconds)) " s"
            }
        }
    }
}

fn bounds(bounds: &[Bound]) -> Markup {
    html! {
        div.scroll {
            table.bounds {
                thead {
                    tr { th { "must hold" } th { "expected" } th { "got" } th {} }
                }
                tbody {
                    @for bound in bounds {
                        @let word = if bound.kept { "kept" } else { "broken" };
                        tr {
                            td { (prose(&bound.what)) }
                            td { (bound.expected) }
                            td { (bound.got) }
                            td { b class=(word) { (word) } }
                        }
                    }
                }
            }
        }
    }
}

fn curve(curve: &Curve) -> Markup {
    let names = plot::series(curve);
    let several = names.len() > 1;
    let marked = |p: &Point| p.printed.is_some() || p.reference;
    html! {
        figure {
            figcaption { (prose(&curve.title)) }
            @if curve.plot.is_some() {
                div.plot {
                    (PreEscaped(plot::svg(curve)))
                    @if several || curve.points.iter().any(marked) { (legend(curve, &names)) }
                }
            }
            div.scroll {
                table {
                    thead {
                        tr {
                            th {}
                            @for column in &curve.columns { th { (plot::named(column)) } }
                        }
                    }
                    tbody {
                        @for point in curve.points.iter().filter(|point| point.printed.is_none()) {
                            (row(curve, point, &names))
                        }
                    }
                }
            }
            (printed(curve))
        }
    }
}

/// A point as a row of the table.
fn row(curve: &Curve, point: &Point, names: &[&str]) -> Markup {
    let several = names.len() > 1;
    let named = several && !point.series.is_empty() && point.series != point.label;
    html! {
        tr class=[point.reference.then_some("reference")] {
            th {
                @if several && curve.plot.is_some() { i class=(plot::color(names, &point.series)) {} }
                @if named { span { (point.series) } " " }
                (point.label)
            }
            @for value in &point.values {
                td class=[matches!(value, Cell::Text(_)).then_some("text")] { (cell(value)) }
            }
        }
    }
}

/// Figures printed elsewhere, grouped by source.
fn printed(curve: &Curve) -> Markup {
    let mut sources: Vec<Printed> = Vec::new();
    for printed in curve.points.iter().filter_map(|point| point.printed) {
        if !sources.contains(&printed) {
            sources.push(printed);
        }
    }
    let known = |point: &Point| {
        let known = curve.columns.iter().zip(&point.values);
        let known = known.filter(|(_, value)| !value.number().is_nan());
        let known: Vec<String> = known
            .map(|(column, value)| format!("{} {}", cell(value), column.unit))
            .collect();
        known.join(", ").trim().to_owned()
    };
    html! {
        @for source in sources {
            @let points = curve.points.iter().filter(|p| p.printed == Some(source));
            p.printed {
                "Printed by " (source.source) " (" (source.machine) "): "
                @for (i, point) in points.enumerate() {
                    @if i > 0 { "; " }
                    (point.label) ": " b { (known(point)) }
                }
                "."
            }
        }
    }
}

fn legend(curve: &Curve, names: &[&str]) -> Markup {
    html! {
        p.legend {
            @if names.len() > 1 {
                @for name in names {
                    span { i class=(plot::color(names, name)) {} (name) } " "
                }
            }
            @if curve.points.iter().any(|point| point.reference) {
                span { i.ring {} "reference" } " "
            }
            @if curve.points.iter().any(|point| point.printed.is_some()) {
                span { i.diamond {} "printed in a paper, its machine" }
            }
        }
    }
}

fn pictures(pictures: &[Picture]) -> Markup {
    html! {
        div.pictures {
            @for picture in pictures {
                figure {
                    img src={ "data:image/png;base64," (BASE64.encode(&picture.png)) }
                        width=(picture.width) height=(picture.height) alt=(picture.caption);
                    figcaption { (prose(&picture.caption)) }
                }
            }
        }
    }
}

/// A cell as text.
pub(super) fn cell(cell: &Cell) -> String {
    match cell {
        Cell::Number(x) => number(*x),
        Cell::Text(text) => text.clone(),
    }
}

/// Escapes the characters that have a meaning in HTML and SVG.
pub(super) fn escape(text: &str) -> String {
    html! { (text) }.into_string()
}

/// Text in which words between backticks are set as code.
fn prose(text: &str) -> Markup {
    html! {
        @for (i, part) in text.split('`').enumerate() {
            @if i % 2 == 0 { (part) } @else { code { (part) } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_stays_text() {
        assert_eq!(
            prose("a < b & `x > \"y\"`").into_string(),
            "a &lt; b &amp; <code>x &gt; &quot;y&quot;</code>"
        );
        assert_eq!(escape("<a href=\"b\">"), "&lt;a href=&quot;b&quot;&gt;");
    }
}
