#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod candidate;
mod curve;
mod error;
mod measure;
mod options;
mod pictures;
pub mod plot;
mod question;
mod report;
mod study;
mod subject;
mod surfaces;
pub mod table;

pub use curve::{equal_error_time, fastest_within, pareto};
pub use error::StudyError;
pub use measure::run;
pub use options::{Per, StudyOptions};
pub use pictures::{Picture, Pictures};
pub use report::html;
pub use study::{Answers, Machine, Missing, Row, StructureMade, Study};
pub use subject::Subject;

/// Root mean square errors that a study says the best settings for.
pub const TARGET_ERRORS: [f64; 3] = [0.05, 0.02, 0.01];
