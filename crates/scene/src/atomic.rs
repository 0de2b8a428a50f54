//! Files that appear whole or not at all.

use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Why an output file could not be written; an earlier file of that name is as it was.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}", .path.display())]
pub struct WriteError {
    /// The file that was asked for.
    pub path: PathBuf,
    /// What went wrong.
    pub source: io::Error,
}

/// What [`write_atomically`] hands to its callback: buffered, with `Write` and `Seek`.
pub type AtomicWriter<'a> = BufWriter<&'a mut File>;

/// Writes a file through a temporary one in the same folder that takes the name at the end, so that a write that fails or
/// is killed never destroys an earlier file.
///
/// Links are followed. Pipes and devices are written directly: there is nothing to protect in them.
///
/// # Errors
/// [`WriteError`], naming `path`, if the folder is missing or not writable, if `path` is a folder or read-only, or with
/// the error that `write` returned.
pub fn write_atomically<T>(
    path: &Path,
    write: impl FnOnce(&mut AtomicWriter<'_>) -> io::Result<T>,
) -> Result<T, WriteError> {
    write_inner(path, write).map_err(|source| WriteError { path: path.into(), source })
}

/// Finds out, before long work, whether [`write_atomically`] could write there now. Leaves nothing behind.
///
/// # Errors
/// [`WriteError`].
pub fn check_writable(path: &Path) -> Result<(), WriteError> {
    let check = || match destination(path)? {
        Destination::Direct(target) => File::options().write(true).open(target).map(drop),
        // Deleted when dropped.
        Destination::Replace { folder, .. } => temporary_in(&folder).map(drop),
    };
    check().map_err(|source| WriteError { path: path.into(), source })
}

fn write_inner<T>(path: &Path, write: impl FnOnce(&mut AtomicWriter<'_>) -> io::Result<T>) -> io::Result<T> {
    match destination(path)? {
        Destination::Direct(target) => fill(&mut File::options().write(true).open(target)?, write),
        Destination::Replace { target, folder } => {
            let mut temporary = temporary_in(&folder)?;
            let value = fill(temporary.as_file_mut(), write)?;
            temporary.persist(&target).map_err(|e| e.error)?;
            Ok(value)
        }
    }
}

/// What writing to a path means.
enum Destination {
    /// A pipe or device.
    Direct(PathBuf),
    /// A file, there or not.
    Replace { target: PathBuf, folder: PathBuf },
}

fn destination(path: &Path) -> io::Result<Destination> {
    // A link to nothing fails to resolve; it is replaced like a missing file.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.into());
    match fs::metadata(&target) {
        Ok(known) if known.is_dir() => {
            return Err(io::Error::new(io::ErrorKind::IsADirectory, "it is a folder"));
        }
        Ok(known) if !known.is_file() => return Ok(Destination::Direct(target)),
        Ok(known) if known.permissions().readonly() => {
            return Err(io::Error::new(io::ErrorKind::PermissionDenied, "the file there is read-only"));
        }
        _ => {}
    }
    if target.file_name().is_none() {
        return Err(io::Error::new(io::ErrorKind::InvalidInput, "it names no file"));
    }
    let folder =
        target.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_path_buf();
    match fs::metadata(&folder) {
        Ok(known) if !known.is_dir() => {
            Err(io::Error::other(format!("{} is not a folder", folder.display())))
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            Err(io::Error::new(error.kind(), format!("folder {} does not exist", folder.display())))
        }
        _ => Ok(Destination::Replace { target, folder }),
    }
}

fn temporary_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".umbrage-");
    #[cfg(unix)]
    {
        // The mode of any new file, less the process's mask; the default of 0600 would stay with the output.
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(fs::Permissions::from_mode(0o666));
    }
    builder.tempfile_in(folder).map_err(without_temporary_name)
}

fn fill<T>(file: &mut File, write: impl FnOnce(&mut AtomicWriter<'_>) -> io::Result<T>) -> io::Result<T> {
    let mut writer = BufWriter::with_capacity(1 << 16, file);
    let value = write(&mut writer)?;
    writer.flush()?;
    Ok(value)
}

/// The name of a temporary file that does not exist would only confuse.
fn without_temporary_name(error: io::Error) -> io::Error {
    if error.raw_os_error().is_some() { error } else { error.kind().into() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checking_finds_what_writing_would() {
        let folder = tempfile::tempdir().unwrap();
        check_writable(&folder.path().join("out.ply")).unwrap();
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
        for bad in [folder.path().to_path_buf(), folder.path().join("no/out.ply")] {
            let checked = check_writable(&bad).unwrap_err().to_string();
            assert_eq!(checked, write_atomically(&bad, |_| Ok(())).unwrap_err().to_string());
        }
    }

    #[test]
    fn a_failed_write_keeps_the_earlier_file_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("out.ply");
        write_atomically(&path, |w| w.write_all(b"first")).unwrap();
        let error = write_atomically(&path, |w| {
            w.write_all(b"second")?;
            Err::<(), _>(io::Error::other("no more ink"))
        })
        .unwrap_err();
        assert_eq!(error.to_string(), format!("cannot write {}: no more ink", path.display()));
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1);
    }

    #[test]
    fn missing_folders_and_folders_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("no/out.ply");
        let error = write_atomically(&missing, |_| Ok(())).unwrap_err().to_string();
        let expected = format!(
            "cannot write {}: folder {} does not exist",
            missing.display(),
            folder.path().join("no").display()
        );
        assert_eq!(error, expected);
        let error = write_atomically(folder.path(), |_| Ok(())).unwrap_err().to_string();
        assert!(error.ends_with(": it is a folder"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn links_are_followed_and_devices_survive() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write_atomically(&link, |w| w.write_all(b"new")).unwrap();
        assert_eq!(fs::read(&real).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        write_atomically(Path::new("/dev/null"), |w| w.write_all(b"gone")).unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }
}
