//! Orthonormal frames.

use glam::Vec3;

/// Three perpendicular unit vectors, right-handed: `tangent x bitangent = normal`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// First axis.
    pub tangent: Vec3,
    /// Second axis.
    pub bitangent: Vec3,
    /// Third axis, the one the frame was made from.
    pub normal: Vec3,
}

impl Frame {
    /// A frame around the unit vector `normal`, continuous but where `normal.z` changes sign.
    ///
    /// # Source
    /// Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017.
    #[inline]
    pub fn from_normal(normal: Vec3) -> Self {
        let sign = 1f32.copysign(normal.z);
        let a = -1.0 / (sign + normal.z);
        let b = normal.x * normal.y * a;
        Self {
            tangent: Vec3::new(1.0 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x),
            bitangent: Vec3::new(b, sign + normal.y * normal.y * a, -normal.y),
            normal,
        }
    }

    /// `local.x` along the tangent, `local.y` along the bitangent, `local.z` along the normal.
    ///
    /// The sum is taken in that order without fused operations, so that the bits are the same everywhere.
    #[inline]
    pub fn world_from_local(&self, local: Vec3) -> Vec3 {
        self.tangent * local.x + self.bitangent * local.y + self.normal * local.z
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn axes_are_orthonormal_and_right_handed(z in -1f32..=1.0, phi in 0f32..6.3) {
            let r = (1.0 - z * z).max(0.0).sqrt();
            let n = Vec3::new(r * phi.cos(), r * phi.sin(), z).normalize();
            let f = Frame::from_normal(n);
            for (a, b) in [(f.tangent, f.bitangent), (f.bitangent, n), (n, f.tangent)] {
                prop_assert!(a.dot(b).abs() < 1e-6);
                prop_assert!((a.length() - 1.0).abs() < 1e-6);
            }
            prop_assert!((f.tangent.cross(f.bitangent) - n).length() < 1e-6);
        }
    }

    #[test]
    fn poles_and_signed_zero_are_fine() {
        for z in [1.0, -1.0] {
            let f = Frame::from_normal(Vec3::new(0.0, -0.0, z));
            assert_eq!(f.tangent.cross(f.bitangent), f.normal);
        }
    }
}
