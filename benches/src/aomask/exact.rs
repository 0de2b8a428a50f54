//! Method `mask` as an entry, and the part of the suite that measures it against single rays.

use super::{Case, measure, methods::bits, workload::Workload};
use crate::{entry::Entry, memory, rows::Output};
use anyhow::Result;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};
use umbrage_accel::Bvh;
use umbrage_aomask::{BackEnd, MaskCall, Outputs, Receiver};

/// Method `mask` on each back end with SIMD.
pub fn entries<'a>(case: &'a Case, workload: &'a Workload) -> Result<Vec<Box<dyn Entry<bool> + 'a>>> {
    let back_ends = BackEnd::ALL.into_iter().filter(|b| *b != BackEnd::Scalar && b.is_supported());
    back_ends
        .map(|back_end| -> Result<Box<dyn Entry<bool>>> {
            let masks = vec![0; workload.points.len() * workload.pattern.words()];
            let ao = vec![0.0; workload.points.len()];
            let one = ThreadPoolBuilder::new().num_threads(1).build()?;
            Ok(Box::new(MaskEntry {
                bvh: case.ours.bvh(),
                build_s: case.ours.build_s,
                back_end,
                workload,
                masks,
                ao,
                one,
                held: 0,
            }))
        })
        .collect()
}

/// Rows of `mask` against our own rays and peers, without the other mask methods.
pub fn rows(case: &Case, workload: &Workload, passes: usize, output: &mut Output) -> Result<()> {
    let (mut all, theirs) = measure::single_rays(case, workload)?;
    all.extend(entries(case, workload)?);
    all.extend(theirs);
    measure::rows_of(all, case, workload, passes, output, |_| json!({})).map(drop)
}

struct MaskEntry<'a> {
    bvh: &'a Bvh,
    build_s: f64,
    back_end: BackEnd,
    workload: &'a Workload,
    masks: Vec<u64>,
    ao: Vec<f32>,
    /// For runs on one thread.
    one: ThreadPool,
    /// Most bytes that the last run held beside hierarchy, receivers and outputs.
    held: usize,
}

impl Entry<bool> for MaskEntry<'_> {
    fn method(&self) -> &'static str {
        "mask"
    }

    fn mode(&self) -> String {
        format!("{:?}", self.back_end).to_lowercase()
    }

    fn build_s(&self) -> f64 {
        self.build_s
    }

    fn bytes(&self) -> usize {
        self.bvh.bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let before = memory::start();
        let Self { bvh, back_end, workload, masks, ao, one, .. } = self;
        pool.unwrap_or(one).install(|| {
            let outputs = Outputs::new(ao).with_masks(masks);
            let Workload { points, normals, options, pattern, .. } = workload;
            let receivers = Receiver::from_slices(points, normals, options.seed).expect("valid receivers");
            let call = MaskCall::new(bvh, pattern, &receivers, options).with_back_end(*back_end);
            call.answer(outputs, &mut |_| true).expect("valid receivers");
        });
        self.held = memory::peak_since(before);
    }

    fn counters(&self) -> Value {
        json!({ "held_bytes": self.held })
    }

    fn answers(&self) -> Vec<bool> {
        bits(&self.masks, self.workload.pattern.words(), self.workload.pattern.len())
    }
}
