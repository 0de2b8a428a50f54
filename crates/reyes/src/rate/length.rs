//! How long the edges of a patch's micropolygons get at each rate, and the rate that keeps them short enough.

use crate::{
    patch::{Kind, Node, Speeds, TreeContext},
    surface::Patch,
};
use std::sync::OnceLock;

/// Most levels of refinement: a patch is diced into at most `2^12 x 2^12` cells.
pub const MAX_LEVEL: u8 = 12;

/// `2^-level`.
pub(crate) fn cell(level: u8) -> f64 {
    f64::from_bits((1023 - u64::from(level)) << 52)
}

/// Splits after which differences of control points bound derivatives; 2 leaves a few percent on curved patches.
const BOUND_SPLITS: u32 = 2;

/// What is known of an irregular patch at some level.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Level {
    /// Of all regular parts so far, in units of the whole patch.
    speeds: Speeds,
    /// Longest edge or diagonal of the irregular parts left.
    irregular: f64,
}

/// Lengths of a patch's micropolygon edges, found when asked for.
#[derive(Debug)]
pub(crate) enum Lengths {
    Regular(OnceLock<Speeds>),
    Irregular(Box<[OnceLock<Level>; MAX_LEVEL as usize + 1]>),
}

impl Lengths {
    pub(crate) fn new(regular: bool) -> Self {
        if regular { Self::Regular(OnceLock::new()) } else { Self::Irregular(Box::default()) }
    }
}

impl Patch {
    /// Bound on the longest edge or diagonal of the cells of the patch diced at `levels`.
    ///
    /// Irregular patches have no bound on derivatives around extraordinary vertices: there it is the length of the cells
    /// themselves, and the level the larger of the two.
    pub(crate) fn longest(&self, levels: [u8; 2], context: &TreeContext) -> f64 {
        match &self.lengths {
            Lengths::Regular(speeds) => self.speeds(speeds).longest(levels),
            Lengths::Irregular(known) => {
                let level = levels[0].max(levels[1]);
                let at = self.level(&known[..], level, context);
                at.speeds.longest([level; 2]).max(at.irregular)
            }
        }
    }

    /// Bound on the distance of the cells of the patch diced at `levels` from the limit surface; around extraordinary
    /// vertices, where derivatives have no bound, the size of a cell.
    pub(crate) fn deviation(&self, levels: [u8; 2], context: &TreeContext) -> f64 {
        match &self.lengths {
            Lengths::Regular(speeds) => self.speeds(speeds).deviation(levels),
            Lengths::Irregular(known) => {
                let at = self.level(&known[..], levels[0].max(levels[1]), context);
                at.speeds.deviation(levels).max(if at.irregular.is_finite() {
                    0.25 * at.irregular
                } else {
                    0.0
                })
            }
        }
    }

    fn speeds(&self, known: &OnceLock<Speeds>) -> Speeds {
        *known.get_or_init(|| match &self.root.kind {
            Kind::Regular(patch) => patch.speeds(BOUND_SPLITS),
            _ => Speeds::default(),
        })
    }

    fn level(&self, known: &[OnceLock<Level>], level: u8, context: &TreeContext) -> Level {
        *known[level as usize].get_or_init(|| {
            let before =
                if level > 0 { self.level(known, level - 1, context).speeds } else { Speeds::default() };
            let mut found = Level { speeds: before, irregular: 0.0 };
            measure(&self.root, 0, level, context, &mut found);
            found
        })
    }

    /// The coarsest levels along `u` and `v` at which no edge or diagonal is longer than `width`, at most `max_level`
    /// each; equal if `isotropic`. A width that is not positive gets `max_level`.
    pub(crate) fn levels_for(
        &self,
        width: f64,
        max_level: u8,
        isotropic: bool,
        context: &TreeContext,
    ) -> [u8; 2] {
        let least = self.least_level();
        let max_level = max_level.max(least);
        if width.is_nan() || width <= 0.0 {
            return [max_level; 2];
        }
        match &self.lengths {
            Lengths::Regular(speeds) if !isotropic => {
                anisotropic(&self.speeds(speeds), width, least, max_level)
            }
            _ => {
                let level = (least..max_level).find(|&l| self.longest([l; 2], context) <= width);
                [level.unwrap_or(max_level); 2]
            }
        }
    }

    /// Quadrilaterals beside other faces always have the middles of their edges as vertices.
    pub(crate) fn least_level(&self) -> u8 {
        u8::from(matches!(self.root.kind, Kind::Forked) || self.has_halves())
    }

    fn has_halves(&self) -> bool {
        self.links.iter().flatten().any(|link| link.meeting == crate::surface::Meeting::OtherIsHalf)
    }
}

/// The fewest cells, at most eight times as many along one parameter as along the other.
fn anisotropic(speeds: &Speeds, width: f64, least: u8, max_level: u8) -> [u8; 2] {
    let alone = |speed: f64| (least..max_level).find(|&l| speed * cell(l) <= width).unwrap_or(max_level);
    let mut levels = [alone(speeds.u), alone(speeds.v)];
    let shortest = levels[0].max(levels[1]).saturating_sub(3);
    levels = levels.map(|l| l.max(shortest));
    while speeds.longest(levels) > width && levels != [max_level; 2] {
        let steps = [speeds.u * cell(levels[0]), speeds.v * cell(levels[1])];
        let longer = usize::from(steps[1] > steps[0]);
        let axis = if levels[longer] < max_level { longer } else { 1 - longer };
        levels[axis] += 1;
        levels[1 - axis] = levels[1 - axis].max(levels[axis].saturating_sub(3));
    }
    levels
}

/// Adds regular nodes at depth `level` and irregular ones there, below `node` at `depth`.
fn measure(node: &Node, depth: u8, level: u8, context: &TreeContext, found: &mut Level) {
    match &node.kind {
        Kind::Regular(patch) if depth == level => {
            let own = patch.speeds(BOUND_SPLITS.saturating_sub(u32::from(depth)));
            found.speeds = found.speeds.max(own.of_whole(depth));
        }
        Kind::Regular(_) => {}
        Kind::Irregular(ring) if depth == level => {
            let [a, b, c, d] = [0, 1, 2, 3].map(|k| ring.limit(k, context.method));
            for (p, q) in [(a, b), (b, c), (c, d), (d, a), (a, c), (b, d)] {
                found.irregular = found.irregular.max(p.distance(q));
            }
        }
        // A forked node has no corners of its own; it is never diced as one cell.
        Kind::Forked if depth == level => found.irregular = f64::INFINITY,
        _ => {
            for child in node.split(context).iter() {
                measure(child, depth + 1, level, context, found);
            }
        }
    }
}
