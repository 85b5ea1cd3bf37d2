//! The files that `rosaline keys` and `rosaline webhooks` change, and the links in their way.

use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use crate::keys::{keys, made, with};
use crate::service::{Service, problem, without_settings};

/// The keys' or the targets' file by a link to it, as some set-ups have it.
#[tokio::test]
async fn what_is_changed_through_a_link_is_changed_where_it_leads() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["real", "link"] {
        std::fs::create_dir(folder.path().join(name)).unwrap();
    }
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    for name in ["keys.json", "targets.json"] {
        std::os::unix::fs::symlink(format!("../real/{name}"), path(&format!("link/{name}"))).unwrap();
    }
    let (real, link) = (path("real/keys.json"), path("link/keys.json"));
    let data = Arc::new(tempfile::tempdir().unwrap());
    let output = keys(&data, &["add", "x", "--scope", "read", "--keys", &link]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("a symbolic link that leads nowhere"), "{said}");

    let key = made(&data, &["add", "carol", "--scope", "read", "--keys", &real]);
    let service = Service::start_on(data.clone(), &["--keys", &real]);
    assert_eq!(with(service.get("/v1/jobs"), &key).send().await.unwrap().status(), 200);
    assert!(keys(&data, &["revoke", "carol", "--keys", &link]).status.success());
    problem(with(service.get("/v1/jobs"), &key).send().await.unwrap(), 401, "unauthenticated").await;
    assert!(Path::new(&link).is_symlink());

    let webhooks = |words: &[&str], file: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        let output = command.arg("webhooks").args(words).args(["--webhooks", file]).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        String::from_utf8(output.stdout).unwrap()
    };
    let (real, link) = (path("real/targets.json"), path("link/targets.json"));
    webhooks(&["add", "pacs", "--url", "http://127.0.0.1:1/"], &real);
    webhooks(&["remove", "pacs"], &link);
    assert!(webhooks(&["list"], &real).is_empty() && Path::new(&link).is_symlink());
}

/// Root, in a folder of a user who has put links there.
#[test]
fn no_link_in_the_services_folder_leads_root_to_another_file() {
    use std::os::unix::fs::{MetadataExt, chown, lchown, symlink};
    let folder = tempfile::tempdir().unwrap();
    let (data, victim) = (folder.path().join("data"), folder.path().join("victim"));
    std::fs::create_dir(&data).unwrap();
    std::fs::write(&victim, "x").unwrap();
    let user = 65534;
    if chown(&data, Some(user), Some(user)).is_err() {
        eprintln!("skipped: only root may give a folder away");
        return;
    }
    let link = |target: &Path, name: &str| {
        symlink(target, data.join(name)).unwrap();
        lchown(data.join(name), Some(user), Some(user)).unwrap();
    };
    let run = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        let output = command.args(words).arg("--data").arg(&data).output().unwrap();
        (output.status.success(), String::from_utf8(output.stderr).unwrap())
    };
    let add = ["keys", "add", "z", "--scope", "read"];
    let unharmed = || {
        let found = std::fs::metadata(&victim).unwrap();
        assert_eq!((found.uid(), std::fs::read_to_string(&victim).unwrap().as_str()), (0, "x"));
        assert!(!folder.path().join("victim2").exists());
    };
    link(&victim, "keys.new");
    link(&folder.path().join("victim2"), "keys.lock");
    let (done, said) = run(&add);
    assert!(!done && said.contains("is a symbolic link; remove that"), "{said}");
    unharmed();
    std::fs::remove_file(data.join("keys.lock")).unwrap();
    assert!(run(&add).0);
    unharmed();
    assert_eq!(std::fs::metadata(data.join("keys.json")).unwrap().uid(), user);
    // A file of keys elsewhere, which the service's user could not change.
    std::fs::rename(data.join("keys.json"), folder.path().join("others.json")).unwrap();
    link(&folder.path().join("others.json"), "keys.json");
    let (done, said) = run(&["keys", "revoke", "z"]);
    assert!(!done && said.contains("link of user 65534; give the path of the file itself"), "{said}");
    // Names by the processes that come next.
    let load = std::fs::read_to_string("/proc/loadavg").unwrap();
    let last: u32 = load.split_whitespace().last().unwrap().parse().unwrap();
    for process in last..last + 1000 {
        link(&victim, &format!("doctor-{process}.probe"));
    }
    run(&["doctor"]);
    unharmed();
}

#[test]
fn a_data_folder_that_a_key_is_the_first_thing_in_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let said = |words: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
        without_settings(&mut command);
        let output = command.current_dir(folder.path()).args(words).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        assert_eq!(String::from_utf8(output.stdout).unwrap().lines().count(), 1);
        String::from_utf8(output.stderr).unwrap()
    };
    let (key, target) = (["keys", "add"], ["webhooks", "add"]);
    let (scope, url) = (["--scope", "read"], ["--url", "http://127.0.0.1:1/"]);
    for (words, more) in [(key, scope), (target, url)] {
        let add = |name: &str, data: &[&str]| said(&[&words[..], &[name], &more[..], data].concat());
        let first = add("a", &["--data", "new"]);
        assert!(
            first.contains("it was made") && first.contains("start the service with --data new"),
            "{first}"
        );
        assert_eq!(add("b", &["--data", "new"]), "");
        let unsaid = add("a", &[]);
        assert!(unsaid.contains("it was made") && unsaid.contains("is in data/"), "{unsaid}");
        let unsaid = add("b", &[]);
        assert!(!unsaid.contains("it was made") && unsaid.contains("is in data/"), "{unsaid}");
        for made in ["new", "data"] {
            std::fs::remove_dir_all(folder.path().join(made)).unwrap();
        }
    }
}
