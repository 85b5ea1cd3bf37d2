//! Where a file of the operator's is, for the subcommands that change it: in the service's data folder, or where a flag says.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use super::Failure;
use super::files::create_private;

/// The data folder where nobody says another.
const DATA: &str = "data";

/// Such a place.
pub(super) struct OperatorPlace<'a> {
    /// As `--data` or its variable has it.
    data: Option<&'a Path>,
    /// As a flag or its variable has it.
    named: Option<&'a Path>,
    /// That flag.
    flag: &'static str,
    /// The file's name in a data folder.
    name: &'static str,
}

impl<'a> OperatorPlace<'a> {
    /// That of the keys.
    pub(super) fn of_keys(data: Option<&'a Path>, named: Option<&'a Path>) -> Self {
        Self { data, named, flag: "--keys", name: "keys.json" }
    }

    /// That of the webhook targets.
    pub(super) fn of_webhooks(data: Option<&'a Path>, named: Option<&'a Path>) -> Self {
        Self { data, named, flag: "--webhooks", name: "webhooks.json" }
    }

    /// The file.
    pub(super) fn path(&self) -> PathBuf {
        self.named.map_or_else(|| self.data().join(self.name), Path::to_owned)
    }

    fn data(&self) -> &Path {
        self.data.unwrap_or(Path::new(DATA))
    }

    /// Makes the data folder where something is to be put into it; whether there was none.
    pub(super) fn make(&self) -> Result<bool, Failure> {
        if self.named.is_some() {
            return Ok(false);
        }
        let made = !self.data().exists();
        create_private(self.data())?;
        Ok(made)
    }

    /// Fails where there is no data folder: what is looked for there may well be in another.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let data = self.data();
        let wrong = match fs::metadata(data) {
            _ if self.named.is_some() => return Ok(()),
            Err(error) if error.kind() == io::ErrorKind::NotFound => "there is no data folder",
            Ok(found) if !found.is_dir() => "this is no folder:",
            // One that cannot be looked at is told with its file.
            _ => return Ok(()),
        };
        let data = data.display();
        Err(Failure::new(format!("{wrong} {data}; give that of the service with --data, or ROSALINE_DATA")))
    }

    /// What a further command needs to be about the same file, with a space before it.
    pub(super) fn again(&self) -> String {
        match (self.named, self.data) {
            (Some(named), _) => format!(" {} {}", self.flag, named.display()),
            (None, Some(data)) => format!(" --data {}", data.display()),
            (None, None) => String::new(),
        }
    }

    /// For one who said no place: which it is now. For one whose data folder was `made`: that it was, as its name may be
    /// mistyped.
    pub(super) fn unsaid(&self, made: bool) -> Option<String> {
        if self.named.is_some() {
            return None;
        }
        let (data, path) = (self.data().display(), self.path());
        let path = path.display();
        match (self.data, made) {
            (Some(_), true) => Some(format!(
                "there was no data folder {data}, so it was made; start the service with --data {data}: one with another does \
                 not see what was added"
            )),
            (None, true) => Some(format!(
                "there was no data folder {data}, so it was made, and what was added is in {path}; a service with another \
                 --data does not see it"
            )),
            (None, false) => {
                Some(format!("what was added is in {path}; a service with another --data does not see it"))
            }
            (Some(_), false) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_is_not_there_is_told_and_made_only_for_something() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("nope");
        let place = |data, named| OperatorPlace::of_keys(Some(data), named);
        let said = place(&data, None).check().unwrap_err().message;
        assert!(said.contains("there is no data folder") && said.contains("--data"), "{said}");
        assert!(!data.exists());
        let named = folder.path().join("k.json");
        assert!(!place(&data, Some(&named)).make().unwrap());
        assert!(place(&data, Some(&named)).check().is_ok() && !data.exists());
        assert_eq!(place(&data, Some(&named)).again(), format!(" --keys {}", named.display()));
        assert!(place(&data, None).make().unwrap() && !place(&data, None).make().unwrap());
        assert!(place(&data, None).check().is_ok());
        fs::write(&named, "").unwrap();
        assert!(place(&named, None).check().unwrap_err().message.contains("no folder"));
    }
}
