//! Results under the names of the dissertation's tables and figures.

use super::{
    Case,
    methods::{AUTO, Call, Caster},
    scene::Shadows,
};
use crate::rows::{Row, median};
use std::collections::BTreeMap;
use umbrage_accel::Counters;

/// What tables say of a scene.
struct SceneFacts {
    name: String,
    lights: usize,
    triangles: usize,
    generator_triangles: u32,
    generators: usize,
    occluders: usize,
    occurrence_rate: f64,
    rays: usize,
    audit_s: f64,
    classify_s: f64,
    test_rays_s: f64,
    kd_s: f64,
    solid_s: f64,
    /// Seconds of occluded and unoccluded rays: ray order, QDBFS with cache, with a guide.
    by_answer: [[f64; 2]; 3],
    /// For single rays and fans: whether `auto` has boxes, and its speed relative to the plain hierarchy.
    auto: [(bool, f64); 2],
    occluded: f64,
}

/// Everything printed at the end.
#[derive(Default)]
pub struct Tables {
    rows: Vec<(Row, Counters)>,
    scenes: Vec<SceneFacts>,
}

/// What the dissertation compares with ray order (figure 3.5).
const PUBLISHED: [&str; 4] = [
    "kd-volumetric:extended",
    "kd-volumetric:extended+cache",
    "kd-volumetric:qdbfs",
    "kd-volumetric:qdbfs+cache",
];
const BASELINE_METHOD: &str = "kd";
const FASTEST_METHOD: &str = "kd-volumetric:qdbfs+cache";
const GUIDED_METHOD: &str = "kd-volumetric:solid+guide";
const SPARSE_METHOD: &str = "kd-volumetric:extended-8+cache";

impl Tables {
    pub fn add(&mut self, row: Row, counters: Counters) {
        self.rows.push((row, counters));
    }

    /// Facts of a scene; times rays with and without an occluder apart.
    pub fn add_scene(&mut self, case: &Case, casters: &[Caster], answers: &[bool], passes: usize) {
        let s = case.structures;
        let mut by_answer = [[0.0; 2]; 3];
        for (k, wanted) in [true, false].into_iter().enumerate() {
            let part = only(case.shadows, answers, wanted);
            for (m, method) in [BASELINE_METHOD, FASTEST_METHOD, GUIDED_METHOD].into_iter().enumerate() {
                let find = |c: &&Caster| c.method == method && c.call == Call::Single;
                let caster = casters.iter().find(find).map(std::slice::from_ref);
                let case = Case { shadows: &part, ..*case };
                by_answer[m][k] =
                    caster.map_or(0.0, |caster| median(&case.time(caster, Vec::new(), passes).0[0]));
            }
        }
        self.scenes.push(SceneFacts {
            name: case.scene.name.clone(),
            lights: case.scene.lights.len(),
            triangles: case.scene.mesh.triangles.len(),
            generator_triangles: s.kd.solids().all().iter().map(|g| g.triangles).sum(),
            generators: s.kd.solids().all().len(),
            occluders: s.kd.occluders().len(),
            occurrence_rate: s.kd.occurrence_rate(),
            rays: case.shadows.rays.len(),
            audit_s: s.audit_s,
            classify_s: s.classify_s,
            test_rays_s: s.test_rays_s,
            kd_s: s.kd_s,
            solid_s: s.solid_s,
            by_answer,
            auto: [0, 1].map(|i| {
                let row = self.find(&case.scene.name, AUTO, ["single", "together"][i]);
                (s.auto[i].0.is_some(), row.map_or(1.0, |(row, _)| row.speedup))
            }),
            occluded: answers.iter().filter(|hit| **hit).count() as f64 / answers.len().max(1) as f64,
        });
    }

    fn find(&self, scene: &str, method: &str, call: &str) -> Option<&(Row, Counters)> {
        self.rows
            .iter()
            .find(|(row, _)| row.scene == scene && row.method == method && row.params["call"] == call)
    }

    /// A number of each kd method by scene, as one line a scene.
    fn figure(&self, title: &str, value: impl Fn(&Row, &Counters) -> f64) {
        println!("\n{title}");
        let mut lines: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for (row, counters) in self
            .rows
            .iter()
            .filter(|(row, _)| row.method.starts_with(BASELINE_METHOD) && row.params["call"] == "single")
        {
            let name = row.method.trim_start_matches("kd-volumetric:");
            lines.entry(&row.scene).or_default().push(format!("{name} {:.1}", value(row, counters)));
        }
        lines.iter().for_each(|(scene, values)| println!("  {scene:<18} {}", values.join("  ")));
    }

    pub fn print(&self) {
        self.print_single();
        self.print_points();
        let rays = |row: &Row| row.params["rays"].as_f64().unwrap_or(1.0);
        self.figure("Figure 3.5: ns a shadow ray", |row, _| row.time_s / rays(row) * 1e9);
        let counted = |c: &Counters| (c.misses + c.triangle_hits + c.cell_hits).max(1) as f64;
        self.figure("Figure 3.6: traversal steps a ray", |_, c| c.nodes as f64 / counted(c));
        self.figure("Figure 3.7: triangle tests a ray", |_, c| c.triangle_tests as f64 / counted(c));
        self.figure("Figure 3.8: box tests a ray", |_, c| c.box_tests as f64 / counted(c));
        self.figure("Mean area of found occluders, 1e-3 of the unit square", |_, c| {
            c.cell_area / c.cell_hits.max(1) as f64 * 1e3
        });
        for (figure, method) in [("3.10", FASTEST_METHOD), ("4.36", SPARSE_METHOD)] {
            println!("\nFigure {figure}: shadow rays of {method}, % miss / triangle / occluder");
            for scene in &self.scenes {
                if let Some((_, c)) = self.find(&scene.name, method, "single") {
                    let all = (c.misses + c.triangle_hits + c.cell_hits).max(1) as f64 / 100.0;
                    let [a, b, d] = [c.misses, c.triangle_hits, c.cell_hits].map(|n| n as f64 / all);
                    println!("  {:<18} {a:.1} / {b:.1} / {d:.1}", scene.name);
                }
            }
        }
        println!("\nMethod auto against the plain hierarchy: single rays, fans");
        for s in &self.scenes {
            let [single, fans] = s
                .auto
                .map(|(on, speed)| format!("{speed:.3} {:<10}", if on { "with boxes" } else { "without" }));
            println!("  {:<18} {single} {fans}", s.name);
        }
        println!("\nFigures 4.37 and 4.38: occurrence rate, % of leaves");
        self.scenes.iter().for_each(|s| println!("  {:<18} {:.1}", s.name, 100.0 * s.occurrence_rate));
    }

    fn print_single(&self) {
        println!(
            "\nTable 3.2, preprocessing: triangles, occluders, rays (thousands); its parts and the build of the tree (s)"
        );
        for s in &self.scenes {
            println!(
                "  {:<18} {:>7.1} {:>7.1} {:>8.1}  audit {:.3} flood {:.3} (test rays {:.3}) tree {:.3} boxes {:.3}",
                s.name,
                s.triangles as f64 / 1e3,
                s.occluders as f64 / 1e3,
                s.rays as f64 / 1e3,
                s.audit_s,
                s.classify_s,
                s.test_rays_s,
                s.kd_s,
                s.solid_s,
            );
        }
        for call in Call::ALL {
            self.print_savings(call.name());
        }
        println!(
            "\nTable 3.3: use of packets of four, % at leaves / all: ray order, fastest published order"
        );
        for s in &self.scenes {
            let (Some(a), Some(b)) = (
                self.find(&s.name, BASELINE_METHOD, "together"),
                self.fastest(&s.name, "together", |method| PUBLISHED.contains(&method)),
            ) else {
                continue;
            };
            let used = |row: &Row, key: &str| 100.0 * row.counters[key].as_f64().unwrap_or(0.0);
            let both = |row: &Row| {
                format!("{:.1} / {:.1}", used(row, "packet_use_at_leaves"), used(row, "packet_use"))
            };
            println!("  {:<18} {}   {}  {}", s.name, both(&a.0), both(b), b.method);
        }
        println!(
            "\nTable 3.4 and figure 3.9: ns an occluded ray, base, QDBFS with cache, with a guide; an unoccluded ray, the same; % occluded"
        );
        for s in &self.scenes {
            let count = [s.occluded, 1.0 - s.occluded].map(|share| (share * s.rays as f64).max(1.0));
            let line = |k: usize| {
                let ns = |times: &[f64; 2]| format!("{:.1}", times[k] / count[k] * 1e9);
                s.by_answer.iter().map(ns).collect::<Vec<_>>().join(" ")
            };
            println!("  {:<18} {}   {}   {:.1}%", s.name, line(0), line(1), 100.0 * s.occluded);
        }
    }

    /// The row of a scene's fastest method with occluders among those that `counts`.
    fn fastest(&self, scene: &str, call: &str, counts: impl Fn(&str) -> bool) -> Option<&Row> {
        let rows = self.rows.iter().map(|(row, _)| row).filter(|row| {
            row.scene == scene
                && row.params["call"] == call
                && row.method.starts_with("kd-volumetric")
                && counts(&row.method)
        });
        rows.max_by(|a, b| a.speedup.total_cmp(&b.speedup))
    }

    /// Table 3.2 by one call: ray order and the fastest of the published orders, and of all.
    fn print_savings(&self, call: &str) {
        println!(
            "\nTable 3.2, {call}: ns a ray in ray order (its speed over single rays); fastest published order, % saved; fastest of \
             all, % saved"
        );
        for s in &self.scenes {
            let Some((base, _)) = self.find(&s.name, BASELINE_METHOD, call) else { continue };
            let (Some(published), Some(any)) = (
                self.fastest(&s.name, call, |method| PUBLISHED.contains(&method)),
                self.fastest(&s.name, call, |_| true),
            ) else {
                continue;
            };
            let ns = |row: &Row| row.time_s / s.rays as f64 * 1e9;
            let over_single = base.counters["speedup_over_single"].as_f64().unwrap_or(1.0);
            let saved = |row: &Row| {
                let name = row.method.trim_start_matches("kd-volumetric:");
                format!("{:>6.1} {:>5.1}% {name:<14}", ns(row), 100.0 * (1.0 - 1.0 / row.speedup))
            };
            println!(
                "  {:<18} {:>6.1} ({over_single:.2})  {}  {}",
                s.name,
                ns(base),
                saved(published),
                saved(any)
            );
        }
    }

    fn print_points(&self) {
        println!(
            "\nTables 4.1, 4.2, 4.5 to 4.7: ns a ray under point lights, base, QDBFS, deferred intersection; % saved"
        );
        let points: Vec<&SceneFacts> = self.scenes.iter().filter(|s| s.name.contains("points")).collect();
        for s in &points {
            let find = |method| self.find(&s.name, method, "single").map(|(row, _)| row);
            let (Some(base), Some(bfs), Some(di)) =
                (find(BASELINE_METHOD), find(FASTEST_METHOD), find(SPARSE_METHOD))
            else {
                continue;
            };
            let ns = |row: &Row| row.time_s / s.rays as f64 * 1e9;
            let saved = |row: &Row| 100.0 * (1.0 - 1.0 / row.speedup);
            println!(
                "  {:<18} {:.1} {:.1} {:.1}   {:.1}% {:.1}%   preprocessing {:.3} s",
                s.name,
                ns(base),
                ns(bfs),
                ns(di),
                saved(bfs),
                saved(di),
                s.audit_s + s.classify_s
            );
        }
        println!(
            "\nTable 4.3: cache hits, rays ended by occluders, % of rays near generators (deferred intersection)"
        );
        for s in &points {
            if let Some((_, c)) = self.find(&s.name, SPARSE_METHOD, "single") {
                let all = c.cache_lookups.max(1) as f64 / 100.0;
                println!("  {:<18} {:.1} {:.1}", s.name, c.cache_hits as f64 / all, c.cell_hits as f64 / all);
            }
        }
        println!("\nTable 4.4: lights; triangles, of generators (thousands); generators");
        for s in &self.scenes {
            println!(
                "  {:<18} {:>3} {:>8.1} {:>8.1} {:>3}",
                s.name,
                s.lights,
                s.triangles as f64 / 1e3,
                f64::from(s.generator_triangles) / 1e3,
                s.generators
            );
        }
    }
}

/// The rays with one answer.
fn only(shadows: &Shadows, answers: &[bool], wanted: bool) -> Shadows {
    let mut part = Shadows { rays: Vec::new(), fans: Vec::new(), side: shadows.side };
    for fan in &shadows.fans {
        let start = part.rays.len() as u32;
        let range = fan.start as usize..fan.end as usize;
        let rays = shadows.rays[range.clone()].iter().zip(&answers[range]);
        part.rays.extend(rays.filter(|(_, hit)| **hit == wanted).map(|(ray, _)| *ray));
        if part.rays.len() as u32 > start {
            part.fans.push(super::scene::Fan { start, end: part.rays.len() as u32, ..*fan });
        }
    }
    part
}
