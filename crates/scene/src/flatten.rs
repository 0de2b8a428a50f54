//! All instances of a scene as one mesh in world space.

use crate::Scene;
use umbrage_geom::{MeshObject, TriangleMesh};

impl Scene {
    /// Copies every instance into one mesh, moved to world space. Its objects are those of the instances' meshes in
    /// order, named `instance/object`, with the product of the object's and the material's opacity.
    ///
    /// Attributes are kept where every mesh has them; where only some have normals, the others get zeros, which stand for
    /// the triangle's own normal, and likewise white for colours.
    pub fn flatten(&self) -> TriangleMesh {
        let any =
            |has: fn(&TriangleMesh) -> bool| self.instances.iter().any(|i| has(&self.meshes[i.mesh].mesh));
        let keep_normals = any(|m| !m.corner_normals.is_empty());
        let keep_colors = any(|m| !m.vertex_colors.is_empty());
        let mut flat = TriangleMesh::default();
        for instance in &self.instances {
            let mut moved = self.meshes[instance.mesh].mesh.clone();
            moved.transform(&instance.world_from_object);
            if keep_normals && moved.corner_normals.is_empty() {
                moved.corner_normals = vec![[[0.0; 3]; 3]; moved.triangles.len()];
            }
            if keep_colors && moved.vertex_colors.is_empty() {
                moved.vertex_colors = vec![[1.0; 3]; moved.positions.len()];
            }
            let objects = moved.objects_or_whole().into_iter().zip(&instance.materials);
            moved.objects = objects
                .map(|(object, &material)| MeshObject {
                    name: format!("{}/{}", instance.name, object.name),
                    opacity: object.opacity * self.materials[material].opacity,
                    ..object
                })
                .collect();
            flat.append(&moved);
        }
        flat
    }
}
