//! Entry points under measurement: a method, the way it is called, and the answers it gives.

use crate::rows::Timed;
use rayon::{ThreadPool, prelude::*};
use serde_json::{Value, json};
use umbrage_accel::brute;
use umbrage_geom::{OpticalDepth, Ray, TriangleMesh};

/// Opacity of every triangle in rows with semi-transparent triangles.
pub const ALPHA: f32 = 0.85;

/// Rays that a thread takes at a time.
pub const CHUNK: usize = 1 << 11;

/// Answer to one ray.
pub trait Answer: Copy + PartialEq + Send + Sync {
    /// Fraction of light blocked.
    fn occlusion(self) -> f64;

    /// The exact answer, from all triangles.
    fn brute(mesh: &TriangleMesh, ray: &Ray) -> Self;
}

impl Answer for bool {
    fn occlusion(self) -> f64 {
        f64::from(u8::from(self))
    }

    fn brute(mesh: &TriangleMesh, ray: &Ray) -> Self {
        brute::any_hit(&mesh.positions, &mesh.triangles, ray)
    }
}

impl Answer for OpticalDepth {
    fn occlusion(self) -> f64 {
        1.0 - f64::from(self.transmittance())
    }

    fn brute(mesh: &TriangleMesh, ray: &Ray) -> Self {
        let opacity = Self::from_opacity(ALPHA);
        brute::transmittance(&mesh.positions, &mesh.triangles, ray, |_| opacity)
    }
}

/// One way to answer all rays of a workload.
pub trait Entry<A> {
    /// Name of the method in rows; the fastest entry of a method counts.
    fn method(&self) -> &'static str;

    /// Which call, build and flags.
    fn mode(&self) -> String;

    /// Time to build the structure, seconds.
    fn build_s(&self) -> f64;

    /// Bytes of the structure.
    fn bytes(&self) -> usize;

    /// What has to be done before each pass and is not timed.
    fn prepare(&mut self) {}

    /// Answers all rays, on this thread or on all of `pool`.
    fn run(&mut self, pool: Option<&ThreadPool>);

    /// Answers of the last run; called right after it.
    fn answers(&self) -> Vec<A>;

    /// Work of a run, counted apart from the timing.
    fn counters(&self) -> Value {
        json!({})
    }
}

/// An entry with the threads it runs on; keeps the answers of its first pass.
pub struct OnThreads<'p, 'e, A> {
    pub entry: Box<dyn Entry<A> + 'e>,
    pub pool: Option<&'p ThreadPool>,
    pub answers: Option<Vec<A>>,
}

impl<A> Timed for OnThreads<'_, '_, A> {
    fn prepare(&mut self) {
        self.entry.prepare();
    }

    fn run(&mut self) {
        self.entry.run(self.pool);
    }

    fn finish(&mut self) {
        self.answers.get_or_insert_with(|| self.entry.answers());
    }
}

/// Calls `job` with all rays and answers, or with chunks on the threads of `pool`.
pub fn in_chunks<A: Send>(
    pool: Option<&ThreadPool>,
    rays: &[Ray],
    answers: &mut [A],
    job: impl Fn(&[Ray], &mut [A]) + Sync,
) {
    match pool {
        None => job(rays, answers),
        Some(pool) => pool.install(|| {
            rays.par_chunks(CHUNK)
                .zip(answers.par_chunks_mut(CHUNK))
                .for_each(|(rays, answers)| job(rays, answers));
        }),
    }
}
