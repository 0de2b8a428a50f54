//! Which methods fit a mesh or a scene.

use super::{MeshReport, SceneReport, inspect_mesh, inspect_scene};
use serde::Serialize;
use std::fmt;
use umbrage_geom::TriangleMesh;
use umbrage_query::{AoMethod, Exactness, Method, SceneKind, ShadowMethod, View};
use umbrage_scene::Scene;

/// Whether a method fits, and what it promises.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MethodReport {
    /// Its name.
    pub name: &'static str,
    /// Whether it can answer.
    pub fits: bool,
    /// Why it can't, if it doesn't fit.
    pub reason: Option<&'static str>,
    /// Whether its answers are those of exact rays.
    pub exact: bool,
    /// Where its error comes from, if it is approximate; or what is to be expected of it here.
    pub remark: Option<&'static str>,
}

/// Every method, for one mesh or scene.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MethodReports {
    /// For rays to lights.
    pub shadows: Vec<MethodReport>,
    /// For the sky.
    pub ao: Vec<MethodReport>,
}

/// A report with the methods that fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection<R> {
    /// What is in the mesh or scene.
    #[serde(flatten)]
    pub report: R,
    /// Which methods fit, as a picture by a pinhole (or by the scene's camera) needs them.
    pub methods: MethodReports,
}

impl MethodReports {
    fn new(kind: &SceneKind, has_solids: bool) -> Self {
        let no_solids = "no object encloses space, so nothing ends rays early";
        let shadows = ShadowMethod::ALL.iter().map(|&method| {
            let mut report = report(method, kind);
            if report.fits && method.ends_rays_in_solids() && !has_solids {
                report.remark = Some(no_solids);
            }
            report
        });
        let ao = AoMethod::ALL.iter().map(|&method| report(method, kind));
        Self { shadows: shadows.collect(), ao: ao.collect() }
    }
}

fn report(method: impl Method, kind: &SceneKind) -> MethodReport {
    let reason = method.needs().unmet(kind);
    let remark = match method.exactness() {
        Exactness::Exact => None,
        Exactness::Approximate(error) => Some(error),
    };
    MethodReport { name: method.name(), fits: reason.is_none(), reason, exact: remark.is_none(), remark }
}

/// [`inspect_mesh`] with the methods that fit the mesh as `render` shows it, alone before a pinhole.
///
/// # Panics
/// As [`inspect_mesh`].
pub fn inspect_mesh_for_methods(mesh: &TriangleMesh) -> Inspection<MeshReport> {
    let report = inspect_mesh(mesh);
    let solids = report.objects.iter().any(|object| object.solid.encloses);
    let methods = MethodReports::new(&SceneKind::of_mesh(mesh, View::Pinhole), solids);
    Inspection { report, methods }
}

/// [`inspect_scene`] with the methods that fit a scene of the given kind: that before surfaces were divided.
///
/// # Panics
/// As [`inspect_scene`].
pub fn inspect_scene_for_methods(scene: &Scene, kind: &SceneKind) -> Inspection<SceneReport> {
    let report = inspect_scene(scene);
    let mut objects = report.meshes.iter().flat_map(|mesh| &mesh.mesh.objects);
    let solids = objects.any(|object| object.solid.encloses);
    let methods = MethodReports::new(kind, solids);
    Inspection { report, methods }
}

impl<R: fmt::Display> fmt::Display for Inspection<R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.report.fmt(f)?;
        for (heading, methods) in [("shadows", &self.methods.shadows), ("ao", &self.methods.ao)] {
            for (i, method) in methods.iter().enumerate() {
                let heading = if i == 0 { heading } else { "" };
                write!(f, "\n{heading:<11} {:<23} ", method.name)?;
                match method.reason {
                    Some(reason) => write!(f, "does not fit: {reason}")?,
                    None => write!(f, "fits, {}", if method.exact { "exact" } else { "approximate" })?,
                }
                if let (true, Some(remark)) = (method.fits, method.remark) {
                    write!(f, ": {remark}")?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use umbrage_geom::MeshObject;

    #[test]
    fn every_method_is_judged() {
        let mut mesh = TriangleMesh::new(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        )
        .unwrap();
        let opaque = inspect_mesh_for_methods(&mesh);
        assert_eq!(opaque.methods.shadows.len(), ShadowMethod::ALL.len());
        assert_eq!(opaque.methods.ao.len(), AoMethod::ALL.len());
        assert!(opaque.methods.shadows.iter().chain(&opaque.methods.ao).all(|method| method.fits));
        mesh.objects = vec![MeshObject { name: "veil".into(), triangles: 0..4, opacity: 0.5 }];
        let veil = inspect_mesh_for_methods(&mesh);
        let fits = |methods: &[MethodReport]| {
            methods.iter().filter(|method| method.fits).map(|method| method.name).collect::<Vec<_>>()
        };
        assert_eq!(fits(&veil.methods.shadows), ["bvh", "prefilter"]);
        let text = veil.to_string();
        assert!(
            text.contains("kd-volumetric:bfs       does not fit: some triangles are semi-transparent"),
            "{text}"
        );
        assert!(text.contains("\nao          rays                    fits, exact\n"), "{text}");
        let json = serde_json::to_value(&veil).unwrap();
        assert_eq!(
            (json["triangles"].as_u64(), &json["methods"]["ao"][0]["name"]),
            (Some(4), &"rays".into())
        );
        mesh.objects.clear();
        mesh.triangles.pop();
        let open = inspect_mesh_for_methods(&mesh).to_string();
        assert!(open.contains("bvh-volumetric          fits, exact: no object encloses space"), "{open}");
    }
}
