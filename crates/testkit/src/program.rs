//! The program as a user runs it, in a folder of its own.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

/// A temporary folder, and the program that runs in it.
pub struct ProgramFolder {
    folder: TempDir,
    program: PathBuf,
}

impl ProgramFolder {
    /// A folder with `files`, each a name and its content. Tests give `env!("CARGO_BIN_EXE_...")` for `program`.
    ///
    /// # Panics
    /// If files can't be written.
    pub fn new(program: impl Into<PathBuf>, files: &[(&str, &str)]) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let this = Self { folder, program: program.into() };
        files.iter().for_each(|(name, content)| this.write(name, content));
        this
    }

    /// The path of a file in the folder.
    pub fn path(&self, name: impl AsRef<Path>) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file.
    ///
    /// # Panics
    /// If that fails.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        fs::write(self.path(name), content).expect("a writable folder");
    }

    /// What a file holds.
    ///
    /// # Panics
    /// If it can't be read.
    pub fn bytes(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// Names of all files, sorted.
    ///
    /// # Panics
    /// If the folder can't be read.
    pub fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder.path()).expect("a readable folder");
        let name = |entry: std::io::Result<fs::DirEntry>| {
            entry.expect("a readable folder").file_name().to_string_lossy().into_owned()
        };
        let mut names: Vec<String> = entries.map(name).collect();
        names.sort();
        names
    }

    /// The program in the folder, to be given its environment; arguments are separated by blanks.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(&self.program);
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        command
    }

    /// Runs the program.
    ///
    /// # Panics
    /// If it can't be started.
    pub fn run(&self, arguments: &str) -> Output {
        self.command(arguments).output().expect("a program that starts")
    }

    /// Runs the program, which must succeed without a word on standard error. Its standard output.
    ///
    /// # Panics
    /// If it does not.
    pub fn ok(&self, arguments: &str) -> String {
        let output = self.run(arguments);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{arguments}: {error}");
        assert!(error.is_empty(), "{arguments} is not quiet: {error}");
        String::from_utf8(output.stdout).expect("text")
    }

    /// Runs the program, which must give one line with all of `words`, exit code 2, and no new file. The line.
    ///
    /// # Panics
    /// If it does not.
    pub fn fails(&self, arguments: &str, words: &[&str]) -> String {
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
        error
    }
}
