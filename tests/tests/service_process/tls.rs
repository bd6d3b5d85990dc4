//! Tests the service over TLS, with a certificate made for the test.

use std::path::{Path, PathBuf};

use super::{Service, refused, send, write_recording};

/// A self-signed certificate for this machine, and its key.
fn certificate(folder: &Path, name: &str) -> [PathBuf; 2] {
    let names = ["localhost".to_owned(), "127.0.0.1".to_owned()];
    let made = rcgen::generate_simple_self_signed(names).unwrap();
    let files = ["crt", "key"].map(|kind| folder.join(format!("{name}.{kind}")));
    std::fs::write(&files[0], made.cert.pem()).unwrap();
    std::fs::write(&files[1], made.signing_key.serialize_pem()).unwrap();
    files
}

#[test]
fn frames_go_over_tls_and_only_to_a_server_that_is_trusted() {
    let folder = tempfile::tempdir().unwrap();
    let recording = folder.path().join("wall");
    write_recording(&recording);
    let [cert, key] = certificate(folder.path(), "own");
    let [other, _] = certificate(folder.path(), "other");
    let path = |p: &Path| p.to_str().unwrap().to_owned();
    let service = Service::start(&["--tls-cert", &path(&cert), "--tls-key", &path(&key)]);
    assert!(
        service.url.starts_with("wss://127.0.0.1:"),
        "{}",
        service.url
    );
    // Connections that never begin a TLS handshake do not delay others, however many there are.
    let address = service.address();
    let silent = || std::net::TcpStream::connect(&address).unwrap();
    let _silent: Vec<_> = (0..200).map(|_| silent()).collect();
    let recording = path(&recording);
    let url = service.url.as_str();
    let (code, table, errors) = send(&[&recording, "--url", url, "--ca", &path(&cert)]);
    assert_eq!(code, Some(0), "{errors}");
    assert!(table.contains("latency"), "{table}");
    let plain = url.replace("wss:", "ws:");
    for (arguments, part) in [
        // Signed by no authority that this machine trusts, or by another than the given one.
        (vec![recording.as_str(), "--url", url], "certificate"),
        (
            vec![&recording, "--url", url, "--ca", &path(&other)],
            "certificate",
        ),
        (
            vec![&recording, "--url", url, "--ca", &path(&key)],
            "own.key",
        ),
        (
            vec![&recording, "--url", url, "--ca", "/nowhere.crt"],
            "/nowhere.crt",
        ),
        (
            vec![&recording, "--url", &plain, "--ca", &path(&cert)],
            "wss://",
        ),
        (vec![&recording, "--url", &plain], "ws://"),
    ] {
        let (code, _, errors) = send(&arguments);
        assert_eq!(code, Some(2), "{arguments:?}: {errors}");
        assert!(errors.contains(part), "{arguments:?}: {errors}");
        assert_eq!(errors.trim().lines().count(), 1, "{errors}");
    }
}

#[test]
fn certificates_and_keys_that_cannot_be_used_are_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let [cert, key] = certificate(folder.path(), "own");
    let [_, other] = certificate(folder.path(), "other");
    let empty = folder.path().join("empty.pem");
    std::fs::write(&empty, "nothing in here\n").unwrap();
    let path = |p: &Path| p.to_str().unwrap().to_owned();
    let (cert, key, other, empty) = (path(&cert), path(&key), path(&other), path(&empty));
    for (cert, key, part) in [
        ("/nowhere.crt", key.as_str(), "/nowhere.crt"),
        (&cert, "/nowhere.key", "/nowhere.key"),
        (&empty, &key, "empty.pem: expected a certificate"),
        (&key, &key, "own.key: expected a certificate"),
        (&cert, &empty, "empty.pem: expected a private key"),
        (&cert, &cert, "own.crt: expected a private key"),
        (
            &cert,
            &other,
            "other.key: expected the key of the certificate",
        ),
    ] {
        let arguments = [
            "--listen",
            "127.0.0.1:0",
            "--tls-cert",
            cert,
            "--tls-key",
            key,
        ];
        refused(&arguments, part);
    }
    refused(
        &["--listen", "127.0.0.1:0", "--tls-cert", &cert],
        "--tls-key",
    );
}
