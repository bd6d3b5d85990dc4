use std::fs;
use std::path::Path;

use super::*;

fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

#[test]
fn a_file_appears_when_it_is_committed_and_not_otherwise() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/a.json");
    let draft = Draft::file(&path).unwrap();
    draft.write(b"half").unwrap();
    assert_eq!(names(folder.path()).len(), 1);
    drop(draft);
    assert!(names(folder.path()).is_empty());
    write_file(&path, b"whole").unwrap();
    assert_eq!(fs::read(&path).unwrap(), b"whole");
    assert_eq!(names(folder.path()), ["deep"]);
    assert_eq!(names(&folder.path().join("deep")), ["a.json"]);
}

#[test]
fn a_folder_takes_the_place_of_an_empty_one_only() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out");
    for _ in 0..2 {
        let draft = Draft::folder(&path).unwrap();
        fs::write(draft.path().join("x"), "").unwrap();
        draft.commit().unwrap();
        assert_eq!(names(&path), ["x"]);
        fs::remove_file(path.join("x")).unwrap();
    }
    fs::write(path.join("mine"), "").unwrap();
    assert!(Draft::folder(&path).unwrap().commit().is_err());
    assert_eq!(names(&path), ["mine"]);
    assert!(Draft::folder(&path.join("mine")).is_err());
    assert!(Draft::file(&path).is_err());
    assert_eq!(names(folder.path()), ["out"]);
}

#[test]
fn drafts_of_this_process_are_not_leftovers_and_those_of_nobody_are() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("film.mp4");
    let first = Draft::file(&path).unwrap();
    let second = Draft::file(&path).unwrap();
    assert!(first.path().exists() && first.path() != second.path());
    // A file and a folder of processes that have exited.
    let dead = [
        ".film.mp4.ghostlight-1-0.partial",
        ".frames.ghostlight-999999-7.partial",
    ];
    fs::write(folder.path().join(dead[0]), "half").unwrap();
    fs::create_dir_all(folder.path().join(dead[1]).join("mask")).unwrap();
    // Names that only look similar are kept.
    fs::write(folder.path().join(".mine.partial"), "").unwrap();
    let third = Draft::file(&folder.path().join("other.json")).unwrap();
    let left = names(folder.path());
    assert!(
        !left.iter().any(|name| dead.contains(&name.as_str())),
        "{left:?}"
    );
    assert_eq!(left.len(), 4, "{left:?}");
    drop((first, second, third));
    assert_eq!(names(folder.path()), [".mine.partial"]);
}

#[cfg(unix)]
mod unix {
    use super::*;
    use std::io::Read as _;
    use std::os::unix::fs::{FileTypeExt as _, PermissionsExt as _, symlink};

    fn is_link(path: &Path) -> bool {
        fs::symlink_metadata(path).unwrap().is_symlink()
    }

    #[test]
    fn links_are_followed_to_the_file_they_name() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir_all(at("disk")).unwrap();
        fs::create_dir_all(at("sub")).unwrap();
        fs::write(at("disk/r.json"), "old").unwrap();
        fs::set_permissions(at("disk/r.json"), fs::Permissions::from_mode(0o640)).unwrap();
        symlink("../disk/r.json", at("sub/one")).unwrap();
        symlink("one", at("sub/two")).unwrap();
        write_file(&at("sub/two"), b"new").unwrap();
        assert_eq!(fs::read(at("disk/r.json")).unwrap(), b"new");
        assert!(is_link(&at("sub/one")) && is_link(&at("sub/two")));
        let mode = fs::metadata(at("disk/r.json"))
            .unwrap()
            .permissions()
            .mode();
        assert_eq!(mode & 0o777, 0o640);
        // A link to a path that does not exist, and one to a folder.
        symlink("../disk/new.json", at("sub/three")).unwrap();
        write_file(&at("sub/three"), b"new").unwrap();
        assert!(is_link(&at("sub/three")) && at("disk/new.json").is_file());
        symlink("../disk/frames", at("sub/frames")).unwrap();
        Draft::folder(&at("sub/frames")).unwrap().commit().unwrap();
        assert!(is_link(&at("sub/frames")) && at("disk/frames").is_dir());
        // A loop of links.
        symlink("b", at("a")).unwrap();
        symlink("a", at("b")).unwrap();
        let error = write_file(&at("a"), b"").unwrap_err().to_string();
        assert!(error.contains("loop"), "{error}");
        assert_eq!(names(&at("sub")), ["frames", "one", "three", "two"]);
    }

    #[test]
    fn a_fifo_is_written_to_and_a_socket_refused() {
        let folder = tempfile::tempdir().unwrap();
        let fifo = folder.path().join("p");
        let made = std::process::Command::new("mkfifo").arg(&fifo).status();
        assert!(made.unwrap().success());
        let draft = Draft::file(&fifo).unwrap();
        assert!(draft.is_stream());
        let reader = std::thread::spawn({
            let fifo = fifo.clone();
            move || {
                let mut text = String::new();
                fs::File::open(fifo)
                    .unwrap()
                    .read_to_string(&mut text)
                    .unwrap();
                text
            }
        });
        draft.write(b"report").unwrap();
        draft.commit().unwrap();
        assert_eq!(reader.join().unwrap(), "report");
        assert!(fs::symlink_metadata(&fifo).unwrap().file_type().is_fifo());
        assert!(Draft::folder(&fifo).is_err());

        let socket = folder.path().join("s");
        let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
        let error = write_file(&socket, b"").unwrap_err().to_string();
        assert!(error.contains("socket"), "{error}");
        let from = folder.path().join("from");
        fs::write(&from, "x").unwrap();
        assert!(replace(&from, &fifo).is_err() && replace(&from, &socket).is_err());
        assert_eq!(names(folder.path()), ["from", "p", "s"]);
    }

    #[test]
    fn descriptors_are_known_by_their_names() {
        for (name, number) in [("/dev/fd/1", 1), ("/proc/self/fd/2", 2), ("/dev/fd/73", 73)] {
            assert_eq!(
                Target::of(Path::new(name)).unwrap(),
                Target::Descriptor(number)
            );
        }
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("out");
        symlink("/proc/self/fd/1", &link).unwrap();
        assert_eq!(Target::of(&link).unwrap(), Target::Descriptor(1));
        assert!(matches!(
            Target::of(&folder.path().join("1")).unwrap(),
            Target::File(_)
        ));
    }
}
