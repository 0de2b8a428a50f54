//! A hash of everything that decides about pixels, so that only shards of the same picture are joined.

use umbrage_geom::TriangleMesh;
use umbrage_scene::{Scene, Settings};

/// 64-bit FNV-1a: the same on every machine and in every version, which `std`'s hasher does not promise.
pub struct Fingerprint(u64);

impl Default for Fingerprint {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fingerprint {
    /// Adds bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        for &b in bytes {
            self.0 = (self.0 ^ u64::from(b)).wrapping_mul(0x100_0000_01b3);
        }
    }

    /// Adds 32-bit words.
    pub fn words(&mut self, words: impl IntoIterator<Item = u32>) {
        // Eight times fewer steps than bytewise, since meshes are large.
        for w in words {
            self.0 = (self.0 ^ u64::from(w)).wrapping_mul(0x100_0000_01b3);
            self.0 ^= self.0 >> 29;
        }
    }

    /// Adds rows of numbers, and how many there are: so that numbers of one list don't pass for those of the next.
    fn rows<const N: usize>(&mut self, rows: &[[f32; N]]) {
        self.bytes(&(rows.len() as u64).to_le_bytes());
        self.words(rows.as_flattened().iter().map(|x| x.to_bits()));
    }

    /// Adds all of a mesh: shape, normals, texture coordinates, colours and objects.
    pub fn mesh(&mut self, mesh: &TriangleMesh) {
        // Without `..`, so that a new field has to be added here.
        let TriangleMesh { positions, triangles, corner_normals, corner_uvs, vertex_colors, objects } = mesh;
        self.rows(positions);
        self.bytes(&(triangles.len() as u64).to_le_bytes());
        self.words(triangles.as_flattened().iter().copied());
        self.rows(corner_normals.as_flattened());
        self.rows(corner_uvs.as_flattened());
        self.rows(vertex_colors);
        self.bytes(format!("{objects:?}").as_bytes());
    }

    /// Adds a scene with its settings.
    pub fn scene(&mut self, scene: &Scene) {
        let Scene { camera, meshes, instances, materials, lights, ambient, background, settings } = scene;
        // Pictures don't depend on memory.
        let settings = Settings { grid_cache: Settings::default().grid_cache, ..settings.clone() };
        self.bytes(format!("{camera:?}{instances:?}{materials:?}{lights:?}").as_bytes());
        self.bytes(format!("{ambient:?}{background:?}{settings:?}").as_bytes());
        for named in meshes {
            self.mesh(&named.mesh);
            // Surfaces that are traced as such have nothing else of theirs in the mesh.
            if let Some(subdivision) = &named.subdivision {
                self.bytes(format!("{subdivision:?}").as_bytes());
            }
        }
    }

    /// The hash of all that was added.
    pub fn finish(&self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_counts() {
        let hash = |words: &[u32]| {
            let mut f = Fingerprint::default();
            f.words(words.iter().copied());
            f.finish()
        };
        assert_ne!(hash(&[1, 2]), hash(&[2, 1]));
        assert_ne!(hash(&[0]), hash(&[0, 0]));
        assert_ne!(hash(&[1 << 31]), hash(&[0]));
    }

    #[test]
    fn every_part_of_a_mesh_counts() {
        let plain =
            TriangleMesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let with = |change: fn(&mut TriangleMesh)| {
            let mut mesh = plain.clone();
            change(&mut mesh);
            let mut f = Fingerprint::default();
            f.mesh(&mesh);
            f.finish()
        };
        let all = [
            with(|_| {}),
            with(|m| m.positions[2][2] = 1.0),
            with(|m| m.triangles[0] = [1, 2, 0]),
            with(|m| m.corner_normals = vec![[[0.0, 0.0, 1.0]; 3]]),
            with(|m| m.corner_uvs = vec![[[0.5; 2]; 3]]),
            with(|m| m.vertex_colors = vec![[0.5; 3]; 3]),
            with(|m| m.vertex_colors = vec![[0.25; 3]; 3]),
            with(|m| m.corner_normals = vec![[[0.5; 3]; 3]]),
            with(|m| m.objects = m.objects_or_whole()),
        ];
        for (i, hash) in all.iter().enumerate() {
            assert!(!all[..i].contains(hash), "change {i} is not seen");
        }
    }
}
