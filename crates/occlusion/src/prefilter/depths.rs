//! Optical depths of triangles, in the order of leaves.

use umbrage_accel::Bvh;
use umbrage_geom::{OpticalDepth, kernel::TriangleBlock};

/// Optical depths by leaf and lane, so that a hit needs no index of its triangle.
#[derive(Clone, Debug)]
pub(crate) enum Depths {
    Uniform(OpticalDepth),
    /// Up to 256 different ones, and which of them each triangle has.
    Palette(Vec<OpticalDepth>, Vec<u8>),
    Each(Vec<OpticalDepth>),
}

impl Depths {
    /// For opacities in `[0, 1]`, one or one a triangle, and the hierarchy over the triangles.
    pub(crate) fn new(opacity: &[f32], bvh: &Bvh) -> Self {
        let mut different: Vec<u32> = opacity.iter().map(|a| a.to_bits()).collect();
        different.sort_unstable();
        different.dedup();
        let depth = |bits: u32| OpticalDepth::from_opacity(f32::from_bits(bits));
        if let [one] = different[..] {
            return Self::Uniform(depth(one));
        }
        let view = bvh.view();
        let mut bits = vec![0u32; opacity.len()];
        for leaf in 0..view.leaf_count() as u32 {
            let start = view.leaf(leaf).tag as usize;
            let prims = view.prims(leaf).iter().map(|&prim| opacity[prim as usize].to_bits());
            bits[start..].iter_mut().zip(prims).for_each(|(to, from)| *to = from);
        }
        if different.len() > 256 {
            return Self::Each(bits.into_iter().map(depth).collect());
        }
        let place = |bits: u32| different.binary_search(&bits).unwrap_or(0) as u8;
        let places = bits.into_iter().map(place).collect();
        Self::Palette(different.iter().map(|&bits| depth(bits)).collect(), places)
    }

    /// Of the triangle in `lane` of a leaf.
    #[inline(always)]
    pub(crate) fn of(&self, block: &TriangleBlock, lane: usize) -> OpticalDepth {
        let at = block.tag as usize + lane;
        match self {
            Self::Uniform(depth) => *depth,
            Self::Palette(palette, places) => palette[usize::from(places[at])],
            Self::Each(depths) => depths[at],
        }
    }

    pub(crate) fn bytes(&self) -> usize {
        match self {
            Self::Uniform(_) => 0,
            Self::Palette(palette, places) => size_of_val(&palette[..]) + places.len(),
            Self::Each(depths) => size_of_val(&depths[..]),
        }
    }
}
