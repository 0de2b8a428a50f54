//! The methods of `umbrage-aomask` as entries: one answer a ray, read off the masks.

use super::{Case, workload::Workload};
use crate::entry::Entry;
use anyhow::Result;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::{Value, json};
use std::time::Instant;
use umbrage_accel::Bvh;
use umbrage_aomask::{MaskTables, Outputs, Receiver, TableOptions, published::NodeMasks};

/// Masks of all receivers as answers of single rays.
pub fn bits(masks: &[u64], words: usize, rays: usize) -> Vec<bool> {
    masks.chunks(words).flat_map(|mask| (0..rays).map(|i| mask[i / 64] >> (i % 64) & 1 == 1)).collect()
}

/// The tables of a workload's pattern, with what it took to fill them.
pub struct Tables {
    tables: MaskTables,
    node_masks: NodeMasks,
    build_s: f64,
}

impl Tables {
    pub fn build(workload: &Workload, node_masks: NodeMasks, one: &ThreadPool) -> Result<Self> {
        let options = TableOptions::default().with_node_masks(node_masks);
        let start = Instant::now();
        let tables = one.install(|| MaskTables::new(workload.pattern.clone(), &options))?;
        Ok(Self { tables, node_masks, build_s: start.elapsed().as_secs_f64() })
    }

    /// Method `mask-table`.
    pub fn entry<'a>(&'a self, case: &'a Case, workload: &'a Workload) -> Result<Box<dyn Entry<bool> + 'a>> {
        let masks = vec![0; workload.points.len() * workload.pattern.words()];
        let ao = vec![0.0; workload.points.len()];
        let one = ThreadPoolBuilder::new().num_threads(1).build()?;
        Ok(Box::new(TableEntry { tables: self, bvh: case.ours.bvh(), workload, masks, ao, one }))
    }
}

struct TableEntry<'a> {
    tables: &'a Tables,
    bvh: &'a Bvh,
    workload: &'a Workload,
    masks: Vec<u64>,
    ao: Vec<f32>,
    /// For runs on one thread.
    one: ThreadPool,
}

impl Entry<bool> for TableEntry<'_> {
    fn method(&self) -> &'static str {
        "mask-table"
    }

    fn mode(&self) -> String {
        match self.tables.node_masks {
            NodeMasks::Circle => "circle",
            NodeMasks::Silhouette => "silhouette",
        }
        .into()
    }

    fn build_s(&self) -> f64 {
        self.tables.build_s
    }

    fn bytes(&self) -> usize {
        self.tables.tables.bytes()
    }

    fn run(&mut self, pool: Option<&ThreadPool>) {
        let Self { tables, bvh, workload, masks, ao, one } = self;
        pool.unwrap_or(one).install(|| {
            let outputs = Outputs::new(ao).with_masks(masks);
            let Workload { points, normals, options, .. } = workload;
            Receiver::from_slices(points, normals, options.seed)
                .and_then(|receivers| tables.tables.answer(bvh, &receivers, options, outputs, &mut |_| true))
                .expect("valid receivers");
        });
    }

    fn answers(&self) -> Vec<bool> {
        bits(&self.masks, self.workload.pattern.words(), self.workload.pattern.len())
    }

    fn counters(&self) -> Value {
        let Workload { points, normals, options, .. } = self.workload;
        let receivers: Vec<Receiver> = points
            .iter()
            .zip(normals)
            .enumerate()
            .map(|(i, (&p, &n))| {
                Receiver::new(i, p, n, Receiver::seed_of(p, n, options.seed)).expect("checked before")
            })
            .collect();
        let counters = self.tables.tables.count(self.bvh, &receivers, options).expect("checked before");
        json!({
            "nodes": counters.nodes,
            "box_tests": counters.box_tests,
            "node_masks": counters.node_masks,
            "culled_nodes": counters.culled_nodes,
            "triangle_tests": counters.triangle_tests,
            "triangles_after": counters.triangles_after,
            "planes": self.tables.tables.options().planes,
            "edges": self.tables.tables.options().edges,
        })
    }
}
