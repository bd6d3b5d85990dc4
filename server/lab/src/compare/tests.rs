//! Runs the whole laboratory on trivial experiments.

use std::path::Path;

use super::*;

fn lab() -> Lab {
    Lab::new(LabOptions {
        quick: true,
        threads: 1,
        backend: ghostlight::render::Backend::Auto,
        home: Path::new(env!("CARGO_MANIFEST_DIR")).join("../.."),
        data: None,
        quiet: true,
    })
    .unwrap()
}

fn experiment(name: &'static str, run: fn(&mut Lab) -> Result<Section>) -> Experiment {
    Experiment {
        name,
        title: "A title",
        question: "Is it <so>?",
        run,
    }
}

fn kept(_: &mut Lab) -> Result<Section> {
    let mut section = Section::new();
    section.prose("Words & `code`.");
    let columns = [("time", "ms"), ("error", "1/255"), ("rays", "")];
    let mut curve = Curve::new("Curve", columns).plot(Axis::Log(0), Axis::Log(1));
    curve.point("fast", "5 rays", [1.0, 3.5, 5.0]);
    curve.point("fast", "20 rays", [3.0, 0.5, 20.0]);
    curve
        .point("", "4096 rays", [600.0, 0.0, 4096.0])
        .reference();
    curve
        .point("", "theirs", [32.0, f64::NAN, 20.0])
        .printed(Printed {
            source: "Someone 2012, Table 1",
            machine: "a card",
        });
    section.curve(curve);
    let image = ghostlight::frame::ColorImage::filled(4, 3, [9, 9, 9, 255]);
    section.pictures([Picture::new("Nothing", &image, None)?]);
    section.bound(Bound::at_most("error of 20 rays", 1.0, 0.5, "1/255"));
    Ok(section)
}

fn broken(_: &mut Lab) -> Result<Section> {
    let mut section = Section::new();
    section.bound(Bound::none_of("missed", 3, 10));
    Ok(section)
}

fn fails(_: &mut Lab) -> Result<Section> {
    anyhow::bail!("no such thing")
}

#[test]
fn names_are_file_names_and_differ() {
    for (i, experiment) in EXPERIMENTS.iter().enumerate() {
        let name = experiment.name;
        assert!(name.bytes().all(|b| b.is_ascii_lowercase()), "{name}");
        assert!(
            EXPERIMENTS[..i].iter().all(|other| other.name != name),
            "{name}"
        );
    }
}

#[test]
fn what_breaks_and_what_fails_is_told_and_the_rest_goes_on() {
    let experiments = [
        experiment("fails", fails),
        experiment("broken", broken),
        experiment("kept", kept),
    ];
    let report = run(&mut lab(), &experiments.each_ref()).unwrap();
    assert_eq!(
        report.broken(),
        [
            "fails: no such thing",
            "broken: missed: expected 0 of 10, got 3 of 10"
        ]
    );
    assert_eq!(report.n_bounds(), 2);
    let files = report.files().unwrap();
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(
        names,
        [
            "index.html",
            "compare.json",
            "fails.csv",
            "broken.csv",
            "kept.csv"
        ]
    );
    let page = String::from_utf8(files[0].1.clone()).unwrap();
    for told in [
        "no such thing",
        "got 3 of 10",
        "Is it &lt;so&gt;?",
        "<code>code</code>",
        "Printed by Someone 2012, Table 1 (a card): theirs: <b>32 ms, 20</b>",
        "data:image/png;base64,iVBOR",
        "<polyline",
    ] {
        assert!(page.contains(told), "{told}");
    }
    assert!(!page.contains("NaN") && !page.contains("<script"));
    let json: serde_json::Value = serde_json::from_slice(&files[1].1).unwrap();
    assert_eq!(json["findings"][0]["failed"], "no such thing");
    let points = &json["findings"][2]["section"]["blocks"][1]["points"];
    assert_eq!(points[2]["reference"], true);
    assert!(points[3]["values"][1].is_null());
    assert_eq!(json["settings"]["views"][0], "bundled desk");
}

#[test]
fn what_holds_holds() {
    let report = run(&mut lab(), &[&experiment("kept", kept)]).unwrap();
    assert!(report.broken().is_empty());
    let page = String::from_utf8(report.files().unwrap()[0].1.clone()).unwrap();
    assert!(page.contains("All 1 bounds are kept."));
}
