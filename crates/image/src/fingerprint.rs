//! A hash of everything that decides about pixels, so that only shards of the same picture are joined.

use umbrage_scene::Scene;

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

    /// Adds the shape and the objects of a mesh.
    pub fn mesh(&mut self, mesh: &umbrage_geom::TriangleMesh) {
        self.words(mesh.positions.as_flattened().iter().map(|x| x.to_bits()));
        self.words(mesh.triangles.as_flattened().iter().copied());
        self.words(mesh.corner_normals.as_flattened().as_flattened().iter().map(|x| x.to_bits()));
        self.words(mesh.corner_uvs.as_flattened().as_flattened().iter().map(|x| x.to_bits()));
        self.bytes(format!("{:?}", mesh.objects).as_bytes());
    }

    /// Adds a scene with its settings.
    pub fn scene(&mut self, scene: &Scene) {
        let Scene { camera, meshes, instances, materials, lights, ambient, background, settings } = scene;
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
}
