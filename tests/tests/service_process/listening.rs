//! Tests names and addresses to listen on.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::process::Command;

use super::{PROGRAM, Service, refused, write_recording};

#[test]
fn localhost_is_both_its_addresses_and_needs_no_token() {
    let service = Service::of(Command::new(PROGRAM).args(["serve", "--listen", "localhost:0"]));
    let address = service.address();
    let (host, port) = address.rsplit_once(':').unwrap();
    assert_eq!(host, "127.0.0.1");
    let mut hosts = vec!["127.0.0.1"];
    // Some machines have no IPv6.
    if TcpListener::bind("[::1]:0").is_ok() {
        hosts.push("[::1]");
    }
    for host in hosts {
        let mut tcp = TcpStream::connect(format!("{host}:{port}")).unwrap();
        let request =
            format!("GET /healthz HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: close\r\n\r\n");
        tcp.write_all(request.as_bytes()).unwrap();
        let mut answer = String::new();
        tcp.read_to_string(&mut answer).unwrap();
        assert!(answer.starts_with("HTTP/1.1 200"), "{host}: {answer}");
    }
}

#[test]
fn a_hangup_ends_a_server_as_the_other_signals_do() {
    let mut service = Service::start(&[]);
    let pid = service.child.id().to_string();
    let killed = Command::new("kill").args(["-HUP", &pid]).status();
    assert!(killed.unwrap().success());
    assert!(service.child.wait().unwrap().success());
}

#[test]
fn a_recording_without_poses_is_served_as_the_flags_say() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let poses = folder.path().join("poses.txt");
    std::fs::rename(recording.join("groundtruth.txt"), &poses).unwrap();
    let [recording, poses] = [&recording, &poses].map(|path| path.to_str().unwrap());
    let listen = ["--listen", "127.0.0.1:0", "--recording", recording];
    refused(&listen, "--trajectory FILE takes them from elsewhere");
    refused(&listen, "--static takes the camera as at rest");
    let given = ["--trajectory", poses];
    for flags in [&["--static"][..], &given] {
        drop(Service::start(&[&listen[2..], flags].concat()));
    }
    // One trajectory cannot belong to two recordings.
    let two = [&listen[..], &given, &listen[2..]].concat();
    refused(&two, "expected one --recording, got 2");
}
