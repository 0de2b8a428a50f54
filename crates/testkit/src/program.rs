//! A program that is run in a folder of its own.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

/// An empty folder, removed in the end, in which a program runs. Everything unexpected panics, as tests want it.
pub struct Folder {
    folder: TempDir,
    program: &'static str,
}

impl Folder {
    /// A folder for `program`, usually `env!("CARGO_BIN_EXE_umbrage")`, with `files` of these names and texts.
    pub fn new(program: &'static str, files: &[(&str, &str)]) -> Self {
        let folder = Self { folder: tempfile::tempdir().expect("a folder for the test"), program };
        for (name, text) in files {
            folder.write(name, text);
        }
        folder
    }

    /// Where a file of the folder is.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root().join(name)
    }

    /// The folder.
    pub fn root(&self) -> &Path {
        self.folder.path()
    }

    /// Writes a file.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).expect("the folder can be written");
    }

    /// The bytes of a file.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// A file as JSON.
    pub fn json(&self, name: &str) -> serde_json::Value {
        serde_json::from_slice(&self.bytes(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Names of all files, sorted.
    pub fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.root()).expect("the folder can be read");
        let name = |entry: fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
        let mut names: Vec<String> = entries.map(|entry| name(entry.expect("an entry"))).collect();
        names.sort();
        names
    }

    /// The program with `arguments`, which are separated by blanks, ready to run in the folder.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(self.program);
        command.args(arguments.split_whitespace()).current_dir(self.root());
        command
    }

    /// Runs the program.
    pub fn run(&self, arguments: &str) -> Output {
        self.command(arguments).output().expect("the program runs")
    }

    /// Runs the program, which must succeed and print nothing but its standard output.
    pub fn ok(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments}: {error}");
        assert!(error.is_empty(), "{arguments} is not quiet: {error}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    }

    /// Runs the program, which must fail with exit code 2, one line with all of `words` (or a usage message), and no new file.
    pub fn fails(&self, arguments: &str, words: &[&str]) {
        let before = self.files();
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{arguments}: {error}");
        let usage = error.starts_with("error: ");
        assert!(usage || error.trim_end().lines().count() == 1, "{arguments}: not one line: {error}");
        for word in words {
            assert!(error.contains(word), "{arguments}: '{word}' is not in: {error}");
        }
        assert_eq!(self.files(), before, "{arguments} left something behind");
    }
}
