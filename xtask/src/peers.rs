//! How to install the libraries that `cargo xtask bench --peer` links.

use std::path::PathBuf;

/// Folders that linkers search by default.
const LIBRARY_FOLDERS: [&str; 8] = [
    "/usr/lib",
    "/usr/lib64",
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/local/lib",
    "/usr/local/lib64",
    "/opt/homebrew/lib",
    "/opt/local/lib",
];

const EMBREE: &str = "\
embree (feature `embree` of umbrage-benches): the system library libembree3, version 3.
  Debian 12, Ubuntu 22.04   sudo apt-get install libembree-dev
  Fedora                    sudo dnf install embree3-devel
  Arch                      embree3 from the AUR, for instance: yay -S embree3
  macOS                     sudo port install embree3, or the release below
Newer distributions package version 4 alone, which is another interface. Releases of version 3 for all systems are at
  https://github.com/RenderKit/embree/releases/tag/v3.13.5
Unpack one, then set LIBRARY_PATH (to link) and LD_LIBRARY_PATH (to run; on macOS DYLD_LIBRARY_PATH) to its lib folder.";

/// Prints how to install each peer and whether it is there.
pub fn print() {
    println!("{EMBREE}");
    match find(&["libembree3.so", "libembree3.dylib"]) {
        Some(path) => println!("Found: {}", path.display()),
        None => println!("Not found in the usual folders, nor in those of LIBRARY_PATH."),
    }
}

/// The first of the files `names` in a folder of `LIBRARY_PATH` or a usual one.
fn find(names: &[&str]) -> Option<PathBuf> {
    let variable = std::env::var_os("LIBRARY_PATH").unwrap_or_default();
    std::env::split_paths(&variable)
        .filter(|folder| !folder.as_os_str().is_empty())
        .chain(LIBRARY_FOLDERS.iter().map(PathBuf::from))
        .flat_map(|folder| names.iter().map(move |name| folder.join(name)))
        .find(|path| path.is_file())
}
