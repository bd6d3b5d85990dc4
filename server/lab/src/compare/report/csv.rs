//! Tables for spreadsheets.

use crate::compare::section::{Block, Cell, Column, Section};

/// All curves of a section in one table, with a column for every quantity of any curve.
pub(in crate::compare) fn csv(section: &Section) -> String {
    let curves = || {
        section.blocks.iter().filter_map(|block| match block {
            Block::Curve(curve) => Some(curve),
            Block::Prose { .. } | Block::Pictures { .. } => None,
        })
    };
    let mut columns: Vec<&Column> = Vec::new();
    for column in curves().flat_map(|curve| &curve.columns) {
        if !columns.contains(&column) {
            columns.push(column);
        }
    }
    let mut header: Vec<String> = ["table", "series", "point", "reference", "source", "machine"]
        .map(str::to_owned)
        .to_vec();
    header.extend(columns.iter().map(|column| match column.unit {
        "" => column.name.to_owned(),
        unit => format!("{} [{unit}]", column.name),
    }));
    let mut table = ::csv::Writer::from_writer(Vec::new());
    // Writing to memory cannot fail: records have as many fields as the header.
    let _ = table.write_record(&header);
    for curve in curves() {
        for point in &curve.points {
            let printed = |field: fn(&super::super::Printed) -> &str| {
                point
                    .printed
                    .as_ref()
                    .map(field)
                    .unwrap_or_default()
                    .to_owned()
            };
            let mut cells = vec![
                curve.title.clone(),
                point.series.clone(),
                point.label.clone(),
                point.reference.to_string(),
                printed(|p| p.source),
                printed(|p| p.machine),
            ];
            for column in &columns {
                let at = curve.columns.iter().position(|c| c == *column);
                cells.push(match at.and_then(|at| point.values.get(at)) {
                    Some(Cell::Number(x)) if !x.is_nan() => x.to_string(),
                    Some(Cell::Text(text)) => text.clone(),
                    _ => String::new(),
                });
            }
            let _ = table.write_record(&cells);
        }
    }
    let bytes = table.into_inner().unwrap_or_default();
    String::from_utf8(bytes).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compare::Curve;

    #[test]
    fn curves_share_one_header() {
        let mut section = Section::new();
        let mut a = Curve::new("a", [("time", "ms"), ("error", "")]);
        a.point("s", "x, \"y\"", [1.5, 0.0]).reference();
        section.curve(a);
        let mut b = Curve::new("b", [("error", ""), ("verdict", "")]);
        b.point("", "z", [Cell::Number(f64::NAN), "fine".into()]);
        section.curve(b);
        assert_eq!(
            csv(&section),
            "table,series,point,reference,source,machine,time [ms],error,verdict\n\
             a,s,\"x, \"\"y\"\"\",true,,,1.5,0,\n\
             b,,z,false,,,,,fine\n"
        );
    }
}
