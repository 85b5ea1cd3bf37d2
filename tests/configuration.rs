//! The configuration file of `rosaline serve` and `rosaline doctor`.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

#[path = "common/service.rs"]
#[allow(dead_code, reason = "shared with the tests of the service, which use all of it")]
mod service;

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use serde_json::Value;
use service::{Service, without_settings};

fn rosaline(words: &[&str], variables: &[(&str, &str)]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.args(words).envs(variables.iter().copied()).output().unwrap()
}

/// The settings in force, as they are printed.
fn printed(words: &[&str], variables: &[(&str, &str)]) -> String {
    let output = rosaline(&[&["serve", "--print-config"], words].concat(), variables);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn file(text: &str) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rosaline.toml");
    std::fs::write(&path, text).unwrap();
    let path = path.to_str().unwrap().to_owned();
    (folder, path)
}

/// The keys and values of a file, those in remarks left out.
fn settings(text: &str) -> Vec<&str> {
    text.lines().filter(|line| !line.starts_with('#') && !line.is_empty()).collect()
}

#[tokio::test]
async fn a_service_has_the_limits_of_its_file() {
    let (_folder, path) = file("max-upload = 4096\nmax-queue = 7\nmax-run = \"2m\"\nlog-format = 'json'\n");
    let data = Arc::new(tempfile::tempdir().unwrap());
    for (words, variables) in [
        (vec!["--config", path.as_str()], vec![]),
        (vec![], vec![("ROSALINE_CONFIG", Path::new(path.as_str()))]),
    ] {
        let service = Service::start_in(data.clone(), &words, &variables);
        let limits: Value = service.get("/v1/limits").send().await.unwrap().json().await.unwrap();
        let found = ["upload_bytes", "queue", "run_seconds", "uploads"].map(|name| limits[name].clone());
        assert_eq!(found, [4096, 7, 120, 256].map(Value::from));
        assert!(service.log().lines().all(|line| line.starts_with('{')), "{}", service.log());
    }
}

#[test]
fn flags_go_before_variables_and_both_before_the_file() {
    let (_folder, path) =
        file("max-queue = 1\nmax-uploads = 1\nmax-jobs-each = 1\ninsecure = true\ngrace = \"9s\"\n");
    let words = ["--config", &path, "--max-queue", "3", "--grace=5s"];
    let text = printed(&words, &[("ROSALINE_MAX_QUEUE", "2"), ("ROSALINE_MAX_UPLOADS", "2")]);
    for (line, source) in [
        ("max-queue = 3", "flag"),
        ("grace = \"5s\"", "flag"),
        ("max-uploads = 2", "variable"),
        ("max-jobs-each = 1", "file"),
        ("insecure = true", "file"),
        ("validations = 2", "default"),
    ] {
        let place = text.find(&format!("\n{line}\n")).unwrap_or_else(|| panic!("{line}: {text}"));
        assert!(text[..place].ends_with(&format!("({source})")), "{line}: {text}");
    }
    // What is printed is such a file, and says the same.
    let (_folder, again) = file(&text);
    assert_eq!(settings(&printed(&["--config", &again], &[])), settings(&text));
}

#[test]
fn any_path_may_name_a_file_and_nothing_of_it_comes_after_the_flags() {
    use std::os::unix::ffi::OsStrExt;

    let (folder, _) = file("");
    let path = folder.path().join(std::ffi::OsStr::from_bytes(b"\xff.toml"));
    std::fs::write(
        &path,
        "max-queue = 7\njwt-issuer = \"007\"\njwt-audience = \"7\"\njwks = \"http://127.0.0.1:9/x\"\n",
    )
    .unwrap();
    let mut flag = std::ffi::OsString::from("--config=");
    flag.push(&path);
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    let output = command.args(["serve", "--print-config"]).arg(&flag).arg("--").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    for line in ["max-queue = 7", "jwt-issuer = \"007\"", "jwt-audience = 7"] {
        assert!(
            text.contains(&format!("\n{line}\n")),
            "{line}: {text} {}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    let (_folder, again) = file(&text);
    assert!(printed(&["--config", &again], &[]).contains("\njwt-issuer = \"007\"\n"));
}

#[test]
fn what_is_wrong_in_a_file_is_told_with_its_line() {
    for (text, line, what) in [
        ("workers = 2\n\nmax-uplaod = \"1GiB\"\n", 3, "there is no setting 'max-uplaod'"),
        ("[limits]\nmax-upload = \"1GiB\"\n", 1, "there is no setting 'limits'"),
        ("config = \"other.toml\"\n", 1, "there is no setting 'config'"),
        ("print-config = true\n", 1, "there is no setting 'print-config'"),
        ("workers = 2\nmax-upload = \"1 apple\"\n", 2, "a size is a whole number"),
        ("workers = 0\n", 1, "--workers <N>': give a whole number, 1 or more"),
        ("workers = -1\n", 1, "--workers"),
        ("workers = 1.5\n", 1, "'workers' is a text in quotes, or a whole number"),
        ("# the first\ninsecure = \"yes\"\n", 2, "'insecure' is true or false"),
        ("workers = 1\nworkers = 2\n", 2, "duplicate key"),
        ("workers = 1\nlisten =\n", 2, "no TOML"),
        ("workers = 1\nmax_upload = 1\n", 2, "there is no setting 'max_upload'; 'max-upload' is one"),
        ("ROSALINE_MAX_UPLOAD = 1\n", 1, "'max-upload' is one"),
        ("\ntls-cert = \"cert.pem\"\n", 2, "--tls-cert needs --tls-key beside it"),
        ("jwks = \"x\"\n", 1, "--jwks needs --jwt-issuer beside it"),
        ("jwt-issuer = \"x\"\njwks = \"x\"\n", 1, "--jwt-issuer needs --jwt-audience beside it"),
    ] {
        let (_folder, path) = file(text);
        for subcommand in ["serve", "doctor"] {
            let output = rosaline(&[subcommand, "--config", &path], &[]);
            let said = String::from_utf8(output.stderr).unwrap();
            assert_eq!((output.status.code(), said.lines().count()), (Some(1), 1), "{text}: {said}");
            assert!(
                said.contains(&format!("rosaline.toml, line {line}: ")) && said.contains(what),
                "{text}: {said}"
            );
        }
    }
    // What only a start, or a look at the machine, finds wrong; the doctor has findings beside it.
    for (text, lines, what) in [
        ("# for all\nlisten = 18081\n", &[2][..], "18081"),
        ("workers = 3\n\nthreads = 2\n", &[1, 3], "3 workers"),
    ] {
        let (_folder, path) = file(text);
        let lines: Vec<String> = lines.iter().map(|line| format!("{path}, line {line}")).collect();
        let blamed = lines.join(" and ") + ": ";
        for words in [&["serve"][..], &["serve", "--print-config"], &["doctor"]] {
            let output = rosaline(&[words, &["--config", &path]].concat(), &[]);
            let said = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
            let found = said.lines().find(|line| line.contains(&blamed));
            assert!(found.is_some_and(|line| line.contains(what)), "{words:?}: {said}");
        }
    }
    let (_folder, path) = file("workers = 3\nkeys = \"/nowhere/keys.json\"\n");
    for (words, blamed) in [
        (&["--threads", "2"][..], format!("{path}, line 1: 3 workers")),
        (&[], format!("{path}, line 2: the key file /nowhere/keys.json is not there")),
    ] {
        let output = rosaline(&[&["serve", "--config", &path], words].concat(), &[]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(said.contains(&blamed), "{said}");
    }
    let output = rosaline(&["serve", "--config", "/nowhere/rosaline.toml"], &[]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(said.contains("/nowhere/rosaline.toml cannot be read"), "{said}");
}

/// Half of a pair must not be passed over: a service would speak without TLS.
#[test]
fn what_belongs_together_is_wanted_together() {
    for (text, missing) in [
        ("tls-cert = \"cert.pem\"\n", "--tls-key"),
        ("jwt-issuer = \"https://a.example\"\n", "--jwt-audience"),
    ] {
        let (_folder, path) = file(text);
        let output = rosaline(&["serve", "--print-config", "--config", &path], &[]);
        assert!(
            !output.status.success() && String::from_utf8_lossy(&output.stderr).contains(missing),
            "{text}"
        );
    }
    let (folder, path) = file("tls-cert = \"cert.pem\"\n");
    let key = rcgen::KeyPair::generate().unwrap();
    let cert = rcgen::CertificateParams::new(vec!["a".to_owned()]).unwrap().self_signed(&key).unwrap();
    for (name, text) in [("cert.pem", cert.pem()), ("key.pem", key.serialize_pem())] {
        std::fs::write(folder.path().join(name), text).unwrap();
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_rosaline"));
    without_settings(&mut command);
    command.args(["serve", "--print-config", "--config", &path, "--tls-key", "key.pem"]);
    let output = command.current_dir(folder.path()).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(
        text.contains("\ntls-cert = \"cert.pem\"\n") && text.contains("\ntls-key = \"key.pem\"\n"),
        "{text}"
    );
}

/// What a service would not start with, though each value can be read: the settings are printed all the same.
#[test]
fn settings_that_a_service_would_not_start_with_are_refused_when_they_are_printed() {
    let tls = ["--tls-cert", "/nowhere/cert.pem", "--tls-key", "/nowhere/key.pem"];
    let issuer = ["--jwt-audience", "a", "--jwt-issuer"];
    for (words, what) in [
        (&["--listen", "nowhere"][..], "cannot listen on 'nowhere', which is no HOST:PORT"),
        (&["--listen", "127.0.0.1:99999"], "no HOST:PORT"),
        (&["--listen", ":8080"], "no HOST:PORT"),
        (&["--workers", "3", "--threads", "2"], "3 workers"),
        (&tls, "/nowhere/cert.pem cannot be read"),
        (&["--keys", "/nowhere/keys.json"], "/nowhere/keys.json is not there"),
        (&["--webhooks", "/nowhere/targets.json"], "/nowhere/targets.json is not there"),
        (
            &[&issuer[..], &["https://a.example", "--jwks", "/nowhere/jwks"]].concat(),
            "/nowhere/jwks cannot be read",
        ),
        (&[&issuer[..], &["ward"]].concat(), "say it with --jwks"),
    ] {
        let data = tempfile::tempdir().unwrap();
        let folder = data.path().join("data");
        for first in [&["serve", "--print-config"][..], &["serve"]] {
            let output = rosaline(&[first, words].concat(), &[("ROSALINE_DATA", folder.to_str().unwrap())]);
            let said = String::from_utf8(output.stderr).unwrap();
            let lines: Vec<&str> = said.lines().filter(|line| line.starts_with("rosaline: ")).collect();
            assert!(
                output.status.code() == Some(1) && lines.len() == 1 && lines[0].contains(what),
                "{what}: {said}"
            );
            assert_eq!(output.stdout.is_empty(), first.len() == 1, "{what}");
        }
        assert!(!folder.exists(), "nothing was done");
    }
}

/// Each can be read, and would let the service start and fail at everything, or do nothing.
#[test]
fn settings_that_cannot_work_are_refused() {
    let (none, rotation) = ("give 1s or more", "give 1KiB or more");
    let (collector, long) = ("base URL of a collector, by http or https", "36500d at most");
    for (key, value, what) in [
        ("max-run", "0s", none),
        ("keep-jobs", "0", none),
        ("upload-idle", "0m", none),
        ("head-timeout", "0", none),
        ("webhook-timeout", "0s", none),
        ("webhook-retry", "0s", none),
        ("grace", "40000d", long),
        ("head-timeout", "18446744073709551615", long),
        ("audit-rotate", "1", rotation),
        ("audit-rotate", "0", "a size is a whole number"),
        ("otlp", "ftp://x", collector),
        ("otlp", "127.0.0.1:4318", collector),
        ("otlp", "http://127.0.0.1:4318/?a=b", collector),
        ("webhook-attempts", "0", "1 or more"),
        ("validations", "0", "1 or more"),
        ("max-uploads", "0", "1 or more"),
        ("max-uploads-each", "0", "1 or more"),
        ("max-queue", "0", "1 or more"),
        ("max-jobs-each", "0", "1 or more"),
        ("max-crashes", "0", "1 or more"),
        ("max-triangles", "0", "1 or more"),
        ("max-upload", "0", "a size is a whole number"),
        ("min-free", "0", "a size is a whole number"),
        ("max-memory", "1MiB", "at least 64 MiB"),
    ] {
        let (_folder, path) = file(&format!("# the first\n{key} = \"{value}\"\n"));
        let flag = format!("--{key}={value}");
        for words in [&["serve"][..], &["serve", "--print-config"], &["doctor"]] {
            for (more, begin) in [
                (&[flag.as_str()][..], format!("rosaline: invalid value '{value}' for '--{key} ")),
                (&["--config", &path], format!("rosaline: {path}, line 2: invalid value '{value}'")),
            ] {
                let output = rosaline(&[words, more].concat(), &[]);
                let said = String::from_utf8(output.stderr).unwrap();
                assert_eq!((output.status.code(), said.lines().count()), (Some(1), 1), "{flag}: {said}");
                assert!(said.starts_with(&begin) && said.contains(what), "{flag}: {said}");
            }
        }
    }
    // What is a setting all the same: none of these, and no collector.
    for (key, value) in
        [("grace", "0"), ("keep-input", "0"), ("otlp", ""), ("otlp", "https://a.example/otlp")]
    {
        let text = printed(&[&format!("--{key}={value}")], &[]);
        assert!(text.contains(&format!("\n{key} = ")), "{text}");
    }
    let variable = rosaline(&["serve"], &[("OTEL_EXPORTER_OTLP_ENDPOINT", "ftp://x")]);
    let said = String::from_utf8(variable.stderr).unwrap();
    assert!(said.starts_with("rosaline: the variable OTEL_EXPORTER_OTLP_ENDPOINT: "), "{said}");
}

/// Not the file's line, which the flag or the variable goes before.
#[test]
fn what_is_wrong_is_blamed_on_what_says_it() {
    let (_folder, path) = file("workers = 2\ninsecure = true\nlog-format = \"text\"\ndata = \"x\"\n");
    let variable = |name: &str, text: &str| rosaline(&["serve", "--config", &path], &[(name, text)]);
    let flag = |word: &str| rosaline(&["serve", "--config", &path, word], &[]);
    let number = "give a whole number, 1 or more";
    for (output, begin, what) in [
        (variable("ROSALINE_WORKERS", ""), "the variable ROSALINE_WORKERS: ", number),
        (variable("ROSALINE_WORKERS", "two"), "the variable ROSALINE_WORKERS: ", number),
        (variable("ROSALINE_INSECURE", "maybe"), "the variable ROSALINE_INSECURE: ", "true, false"),
        (variable("ROSALINE_LOG_FORMAT", "xml"), "the variable ROSALINE_LOG_FORMAT: ", "text, json"),
        (variable("ROSALINE_DATA", ""), "the variable ROSALINE_DATA: ", "a value is required"),
        (variable("ROSALINE_LISTEN", ""), "the variable ROSALINE_LISTEN: ", "a value is required"),
        (variable("ROSALINE_GRACE", "1 week"), "the variable ROSALINE_GRACE: ", "whole number of seconds"),
        (flag("--workers=0"), "invalid value '0'", number),
        (flag("--workers=99999999999999999999"), "invalid value", "that is more than any"),
        (flag("--webhook-attempts=4294967296"), "invalid value", "that is more than any"),
        (flag("--insecure=false"), "--insecure takes no value", "leave it out"),
    ] {
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!((output.status.code(), said.lines().count()), (Some(1), 1), "{said}");
        assert!(said.starts_with(&format!("rosaline: {begin}")) && said.contains(what), "{begin}: {said}");
        assert!(!said.contains("line ") && !said.contains("non-zero") && !said.contains("digit"), "{said}");
    }
}

#[test]
fn the_documents_example_is_taken_as_it_is() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/rosaline.toml");
    // Its certificate is not here, which is said after the settings.
    let output = rosaline(&["serve", "--print-config", "--config", path.to_str().unwrap()], &[]);
    assert!(String::from_utf8(output.stderr).unwrap().contains("/etc/rosaline/cert.pem cannot be read"));
    let text = String::from_utf8(output.stdout).unwrap();
    let example = std::fs::read_to_string(&path).unwrap();
    let example = settings(&example);
    assert!(example.len() > 15, "{example:?}");
    for line in example {
        let line = line.replace('_', "");
        assert!(text.lines().any(|printed| printed.replace('_', "") == line), "{line}: {text}");
    }
}
