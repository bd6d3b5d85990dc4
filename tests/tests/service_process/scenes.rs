//! Invalid scenes and placements, with the real renderer: each gives one error, and the picture stays as it was.

use futures_util::{SinkExt, StreamExt};
use ghostlight_proto::control::{Reply, State};
use ghostlight_proto::{AssetChunk, Composite, SUBPROTOCOL};
use serde_json::{Value, json};
use tokio_tungstenite::tungstenite::Message;
use tokio_tungstenite::tungstenite::client::ClientRequestBuilder;
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

use super::{Service, write_recording, write_recording_of, write_scene};

/// A viewer that owns its session.
struct Viewer {
    socket: WebSocketStream<MaybeTlsStream<tokio::net::TcpStream>>,
    state: Option<State>,
}

impl Viewer {
    async fn join(url: &str) -> Self {
        let request =
            ClientRequestBuilder::new(url.parse().unwrap()).with_sub_protocol(SUBPROTOCOL);
        let (socket, _) = connect_async(request).await.unwrap();
        let mut viewer = Self {
            socket,
            state: None,
        };
        let hello = json!({"type": "hello", "version": 1, "role": "viewer",
            "composite": {"image": "rgb8", "mask": "gray8"}});
        viewer.send(&hello).await;
        viewer
    }

    async fn send(&mut self, message: &Value) {
        let text = Message::text(message.to_string());
        self.socket.send(text).await.unwrap();
    }

    /// The next reply other than a state, or, for a composite, the number of pixels in its mask.
    async fn next(&mut self) -> Result<Reply, usize> {
        loop {
            match self.socket.next().await.unwrap().unwrap() {
                Message::Binary(bytes) => {
                    let composite = Composite::decode(&bytes).unwrap();
                    let drawn = composite.planes.mask.iter().filter(|&&m| m > 0).count();
                    let masked = !composite.planes.mask.is_empty();
                    self.send(&json!({"type": "credit"})).await;
                    if masked {
                        return Err(drawn);
                    }
                }
                Message::Text(text) => match Reply::parse(&text).unwrap() {
                    Reply::State(state) => self.state = Some(state),
                    reply => return Ok(reply),
                },
                _ => {}
            }
        }
    }

    /// Code of the error that answers a request; `done` if it succeeds.
    async fn ask(&mut self, mut request: Value) -> &'static str {
        request["id"] = 77.into();
        self.send(&request).await;
        loop {
            match self.next().await {
                Ok(Reply::Done(done)) if done.id == Some(77) => return "done",
                Ok(Reply::Error(error)) => {
                    assert_eq!(error.id, Some(77), "{error:?}");
                    assert!(!error.fatal && !error.got.contains("/tmp"), "{error:?}");
                    return error.code.name();
                }
                _ => {}
            }
        }
    }

    /// Number of pixels at which the next composite shows the object.
    async fn drawn(&mut self) -> usize {
        loop {
            if let Err(n) = self.next().await {
                return n;
            }
        }
    }
}

#[tokio::test]
async fn scenes_and_placements_that_cannot_be_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let scene = write_scene(folder.path());
    let path = |p: &std::path::Path| p.to_str().unwrap().to_owned();
    let service = Service::start(&[
        "--recording",
        &path(&recording),
        "--scene",
        &path(&scene),
        "--max-triangles",
        "6",
    ]);
    let mut viewer = Viewer::join(&service.url).await;
    let before = viewer.drawn().await;
    assert!(before > 100, "{before} pixels");
    // An upload that is not a mesh, and a mesh with too many triangles.
    let grid: String = (0..9)
        .map(|i| format!("v {i} 0 0\nv {i} 1 0\n"))
        .collect::<String>()
        + &(1..8)
            .map(|i| format!("f {} {} {}\n", 2 * i - 1, 2 * i, 2 * i + 1))
            .collect::<String>();
    for (upload, (name, content)) in [("noise.obj", "\u{1}\u{2} nothing"), ("grid.obj", &grid)]
        .into_iter()
        .enumerate()
    {
        let upload = upload as u32;
        let announce =
            json!({"type": "asset", "upload": upload, "name": name, "bytes": content.len()});
        viewer.send(&announce).await;
        let chunk = AssetChunk {
            upload,
            offset: 0,
            bytes: content.as_bytes(),
        };
        viewer
            .socket
            .send(Message::binary(chunk.encode().unwrap()))
            .await
            .unwrap();
    }
    let object = |fields: Value| {
        let mut object =
            json!({"name": "a", "mesh": "grid.obj", "place": {"pixel": [160, 120], "size_m": 0.3}});
        object
            .as_object_mut()
            .unwrap()
            .extend(fields.as_object().unwrap().clone());
        json!({"type": "scene", "scene": {"version": 1, "objects": [object]}})
    };
    let stands = |translation: [f64; 3]| {
        json!({"type": "place", "object": "pyramid",
        "stands": {"translation": translation, "quaternion": [0, 0, 0, 1]}})
    };
    for (request, code) in [
        (object(json!({"mesh": "absent.obj"})), "scene"),
        (object(json!({"mesh": "../pyramid.obj"})), "scene"),
        (object(json!({"mesh": "/etc/hostname"})), "scene"),
        (object(json!({"mesh": "noise.obj"})), "scene"),
        (object(json!({})), "too_large"),
        (object(json!({"materiel": {}})), "scene"),
        (
            object(json!({"place": {"pixel": [160, 120], "size_m": -1}})),
            "scene",
        ),
        (json!({"type": "scene", "scene": {"version": 9}}), "scene"),
        (
            json!({"type": "scene", "scene": {"version": 1, "environment": {"map": "absent.hdr"}}}),
            "scene",
        ),
        (json!({"type": "scene", "scene": "absent"}), "not_found"),
        (json!({"type": "play", "recording": "absent"}), "not_found"),
        (json!({"type": "play", "scene": "absent"}), "not_found"),
        (
            json!({"type": "place", "object": "cup", "pixel": [160, 120]}),
            "object",
        ),
        (
            json!({"type": "place", "object": "pyramid", "pixel": [-4000, 120]}),
            "object",
        ),
        (
            json!({"type": "turn", "object": "cup", "angle": 1}),
            "object",
        ),
        (stands([0.0, 0.0, 1e300]), "pose"),
        (
            json!({"type": "settings", "settings": {"shadows": {"samples": -9}}}),
            "settings",
        ),
    ] {
        assert_eq!(viewer.ask(request.clone()).await, code, "{request}");
        // The composite in flight may be older than the request.
        viewer.drawn().await;
        let after = viewer.drawn().await;
        assert!(
            after.abs_diff(before) < before / 5,
            "{request}: {before} pixels, then {after}"
        );
    }
    // Valid requests still work: to the side, turned, and back to the earlier pose.
    let stood = viewer.state.clone().unwrap().objects[0].stands.unwrap();
    for change in [
        json!({"type": "place", "object": "pyramid", "pixel": [250, 120]}),
        json!({"type": "turn", "object": "pyramid", "angle": 1e300}),
        json!({"type": "turn", "object": "pyramid", "angle": 0.5}),
    ] {
        assert_eq!(viewer.ask(change).await, "done");
    }
    let back = json!({"type": "place", "object": "pyramid", "stands": stood});
    assert_eq!(viewer.ask(back).await, "done");
    viewer.drawn().await;
    viewer.drawn().await;
    let again = viewer.state.clone().unwrap().objects[0].stands.unwrap();
    let far = |a: &[f64], b: &[f64]| a.iter().zip(b).any(|(a, b)| (a - b).abs() > 1e-9);
    assert!(
        !far(&again.pose.translation, &stood.pose.translation),
        "{again:?} {stood:?}"
    );
    assert!(
        !far(&again.pose.quaternion, &stood.pose.quaternion),
        "{again:?} {stood:?}"
    );
    assert!(viewer.drawn().await.abs_diff(before) < before / 5);
}

#[tokio::test]
async fn in_a_hole_an_object_is_put_nearby_and_that_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("hole");
    let units = (0..320 * 240).map(|i| if i % 320 < 60 { 0 } else { 10_000 });
    write_recording_of(&recording, &units.collect::<Vec<u16>>());
    let scene = write_scene(folder.path());
    let path = |p: &std::path::Path| p.to_str().unwrap().to_owned();
    let arguments = ["--recording", &path(&recording), "--scene", &path(&scene)];
    let service = Service::start(&arguments);
    let mut viewer = Viewer::join(&service.url).await;
    viewer.drawn().await;
    let mut place = async |u: i32| {
        let place = json!({"type": "place", "object": "pyramid", "pixel": [u, 120], "id": 5});
        viewer.send(&place).await;
        let note = loop {
            match viewer.next().await {
                Ok(Reply::Done(done)) if done.id == Some(5) => break done.note,
                Ok(Reply::Error(error)) => panic!("{error:?}"),
                _ => {}
            }
        };
        viewer.drawn().await;
        viewer.drawn().await;
        let stands = viewer.state.as_ref().unwrap().objects[0].stands.unwrap();
        (note, stands.pose.translation)
    };
    let (note, there) = place(60).await;
    assert_eq!(note, None);
    let (note, instead) = place(20).await;
    let note = note.unwrap();
    assert_eq!(note.split_whitespace().count(), 5, "{note}");
    // The nearest measured pixel is the first one outside the hole.
    assert!(
        (instead[0] - there[0]).abs() < 0.02,
        "{instead:?} {there:?}"
    );
    assert_eq!(place(200).await.0, None);
}

#[tokio::test]
async fn a_scene_brings_its_settings_and_the_next_goes_back() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let plain = write_scene(folder.path());
    let text = std::fs::read_to_string(&plain).unwrap();
    let bounces = text.replacen("{", r#"{"settings": {"max_bounces": 2}, "#, 1);
    let rich = folder.path().join("rich.json");
    std::fs::write(&rich, bounces).unwrap();
    let chosen = folder.path().join("settings.json");
    std::fs::write(&chosen, r#"{"max_bounces": 7}"#).unwrap();
    let path = |p: &std::path::Path| p.to_str().unwrap().to_owned();
    let arguments = [
        "--recording".to_owned(),
        path(&recording),
        "--scene".to_owned(),
        path(&rich),
        "--scene".to_owned(),
        path(&plain),
    ];
    let scene = |name: &str| json!({"type": "scene", "scene": name});
    let set = |n: u32| json!({"type": "settings", "settings": {"max_bounces": n}});
    for (fixed, expected) in [(false, [2, 5, 2, 3, 2, 3]), (true, [7, 7, 7, 3, 3, 3])] {
        let mut arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let file = path(&chosen);
        if fixed {
            arguments.extend(["--settings", &file]);
        }
        let service = Service::start(&arguments);
        let mut viewer = Viewer::join(&service.url).await;
        viewer.drawn().await;
        let mut got = Vec::new();
        for request in [
            None,
            Some(scene("pyramid")),
            Some(scene("rich")),
            Some(set(3)),
            Some(scene("rich")),
            Some(scene("pyramid")),
        ] {
            if let Some(request) = request {
                assert_eq!(viewer.ask(request).await, "done");
            }
            // States are sent independently of composites, and may arrive one or two composites later.
            let bounces = |viewer: &Viewer| {
                let state = viewer.state.as_ref().unwrap();
                state.settings["max_bounces"].as_u64().unwrap()
            };
            for _ in 0..10 {
                viewer.drawn().await;
                if bounces(&viewer) == expected[got.len()] {
                    break;
                }
            }
            got.push(bounces(&viewer));
        }
        // With --settings the scenes' own settings never apply, but a client's do.
        let fits = got == expected;
        assert!(fits, "fixed {fixed}: {got:?}, expected {expected:?}");
    }
}
