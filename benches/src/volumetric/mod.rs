//! Suite `volumetric`: opaque cells inside closed meshes, [Djeu11], chapters 3 and 4.

mod methods;
mod scene;

use self::{
    methods::{Call, Caster, Kind, ORDERS, Structures},
    scene::{Scene, Shadows},
};
use crate::rows::{Output, Timed, alternate, median, note, paired_speedup};
use anyhow::Result;

/// What to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Smaller images and fewer passes.
    pub quick: bool,
    /// Only scenes whose name contains this.
    pub only: Option<String>,
}

pub fn run(options: &Options, _output: &mut Output) -> Result<()> {
    for name in ["bunny_60k", "armadillo_86k", "dragon_871k", "spot"] {
        if options.only.as_ref().is_some_and(|only| !name.contains(only.as_str())) {
            continue;
        }
        let Some(mesh) = scene::closed_mesh(name, options.quick)? else { continue };
        let scene = scene::single(name, &mesh);
        note(name);
        let shadows = scene.shadows(1024, 20, if options.quick { 64 } else { 16 })?;
        let s = Structures::build(&scene)?;
        println!(
            "{name}: {} rays, bvh {:.2}s kd {:.2}s audit {:.3}s classify {:.3}s, {} MB, nodes {} occluders {} rate {:.2}",
            shadows.rays.len(),
            s.bvh_s,
            s.kd_s,
            s.audit_s,
            s.classify_s,
            s.kd.bytes() >> 20,
            s.kd.tree().node_count(),
            s.kd.occluders().len(),
            s.kd.occurrence_rate()
        );
        let mut casters = Vec::new();
        casters.push(Caster {
            method: "bvh".into(),
            call: Call::Single,
            build_s: s.bvh_s,
            bytes: s.bvh.bytes(),
            kind: Kind::Bvh(&s.bvh),
        });
        casters.push(Caster {
            method: "bvh16".into(),
            call: Call::Packets,
            build_s: s.bvh_s,
            bytes: s.bvh.bytes(),
            kind: Kind::Bvh(&s.bvh),
        });
        casters.push(Caster {
            method: "kd".into(),
            call: Call::Single,
            build_s: s.kd_s,
            bytes: s.kd.bytes(),
            kind: Kind::Kd(&s.kd, ORDERS[0].1, false, false),
        });
        for (n, o) in &ORDERS[1..] {
            for cached in [false, true] {
                casters.push(Caster {
                    method: format!("{n}{}", if cached { "+vc" } else { "" }),
                    call: Call::Single,
                    build_s: s.kd_s,
                    bytes: s.kd.bytes(),
                    kind: Kind::Kd(&s.kd, *o, true, cached),
                });
            }
        }
        casters.push(Caster {
            method: "kd p4".into(),
            call: Call::Packets,
            build_s: s.kd_s,
            bytes: s.kd.bytes(),
            kind: Kind::Kd(&s.kd, ORDERS[0].1, false, false),
        });
        casters.push(Caster {
            method: "qdbfs+vc p4".into(),
            call: Call::Packets,
            build_s: s.kd_s,
            bytes: s.kd.bytes(),
            kind: Kind::Kd(&s.kd, ORDERS[4].1, true, true),
        });
        casters.push(Caster {
            method: "solid+vc p4".into(),
            call: Call::Packets,
            build_s: s.kd_s,
            bytes: s.kd.bytes(),
            kind: Kind::Kd(&s.kd, ORDERS[5].1, true, true),
        });
        measure(&scene, &shadows, &casters);
    }
    Ok(())
}

fn measure(scene: &Scene, shadows: &Shadows, casters: &[Caster]) {
    let n = shadows.rays.len();
    let mut answers = vec![vec![false; n]; casters.len()];
    let mut runs: Vec<_> =
        casters.iter().zip(&mut answers).map(|(c, a)| move || c.run(scene, shadows, a)).collect();
    let mut timed: Vec<&mut dyn Timed> = runs.iter_mut().map(|r| r as &mut dyn Timed).collect();
    let times = alternate(3, &mut timed);
    drop(timed);
    drop(runs);
    for (i, c) in casters.iter().enumerate() {
        let k = c.counters(scene, shadows);
        let different = answers[i].iter().zip(&answers[0]).filter(|(a, b)| a != b).count();
        println!(
            "  {:<14} {:7.1} ns/ray  vs kd {:5.2}  diff {different} steps {:.1} tris {:.1} cell {:.2} vc {:.2} tri {:.2}",
            c.method,
            median(&times[i]) / n as f64 * 1e9,
            paired_speedup(&times[6], &times[i]),
            k.kd.steps as f64 / n as f64,
            k.kd.triangle_tests as f64 / n as f64,
            k.cell_hits as f64 / n as f64,
            k.cache_hits as f64 / n as f64,
            k.triangle_hits as f64 / n as f64
        );
    }
}
