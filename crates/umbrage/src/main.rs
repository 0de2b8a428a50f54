//! The `umbrage` program.

use std::process::ExitCode;

fn main() -> ExitCode {
    umbrage_render::cli::run()
}
