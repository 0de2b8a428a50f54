//! Is a mesh the boundary of a solid? Edges, orientation, self-intersections (Djeu11, sections 3.1 and 3.2).
//!
//! Meshes are judged by position: vertices at exactly the same place count as one, because many files split vertices along
//! seams. Triangles with two corners at one place have no edges and no part in any of this.
//!
//! # What enclosing takes
//! A mesh is *well behaved* (Djeu11, section 3.1) if every edge has two faces that run along it in opposite directions and
//! no two triangles cut each other. For occlusion less is enough: let every triangle be given a turn of 1 (as it is), -1
//! (reversed) or 0 (left out), so that along every edge as many triangles run one way as the other. Then the turned triangles
//! are a closed surface, its winding number ([`crate::winding_number`]) is the same along every path that meets none of
//! them, and a segment from a point of winding number `w` to one of another number hits a triangle, however the surface may
//! cut itself. [`orient`] finds such turns, and where the edges are that don't balance.

mod intersect;

pub use intersect::self_intersections;

use crate::{
    Aabb, is_degenerate,
    mesh::{MeshError, validate_indices},
};
use glam::DVec3;

/// Most examples that a finding keeps.
pub const EXAMPLES: usize = 8;

/// How often something was found, and where first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding<T> {
    /// How often.
    pub count: u64,
    /// The first few places.
    pub examples: Vec<T>,
}

impl<T> Default for Finding<T> {
    fn default() -> Self {
        Self { count: 0, examples: Vec::new() }
    }
}

impl<T> Finding<T> {
    fn add(&mut self, example: T) {
        self.count += 1;
        if self.examples.len() < EXAMPLES {
            self.examples.push(example);
        }
    }
}

/// How triangles meet along edges; examples are the welded vertices of an edge.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Edges {
    /// Different edges.
    pub edges: u64,
    /// Edges of one triangle.
    pub boundary: Finding<[u32; 2]>,
    /// Edges of more than two triangles.
    pub non_manifold: Finding<[u32; 2]>,
    /// Edges whose two triangles run along them in the same direction, so that one has its outside where the other has its
    /// inside.
    pub inconsistent: Finding<[u32; 2]>,
}

impl Edges {
    /// Whether every edge has two triangles that agree on what is outside. (Triangles may still cut through each other.)
    pub fn closed(&self) -> bool {
        self.edges > 0 && self.boundary.count + self.non_manifold.count + self.inconsistent.count == 0
    }
}

/// Turns that make triangles a closed surface around something, as far as there are any; see the [module](self).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Orientation {
    /// Turn of each triangle: 1 as it is, -1 reversed, 0 left out.
    pub turns: Vec<i8>,
    /// Sets of triangles connected through edges of two triangles.
    pub components: u32,
    /// Components that face inwards as given, by their signed volume.
    pub inwards: u32,
    /// Components that no turns make consistent, like a Moebius strip.
    pub one_sided: u32,
    /// What is left unbalanced: welded vertices of edges, in the direction that too many turned triangles run, once for
    /// each that is too many. Empty for a closed surface.
    pub open: Vec<[u32; 2]>,
}

/// Everything that can be said about a mesh as the boundary of a solid.
#[derive(Clone, Debug, PartialEq)]
pub struct Audit {
    /// How triangles meet.
    pub edges: Edges,
    /// How they can be turned.
    pub orientation: Orientation,
    /// Pairs of triangles that meet elsewhere than in a common corner or edge.
    pub self_intersections: Finding<[u32; 2]>,
}

impl Audit {
    /// Djeu11, section 3.1, but for the side of the normals, which [`Orientation::turns`] put right.
    pub fn well_behaved(&self) -> bool {
        self.edges.closed() && self.self_intersections.count == 0
    }

    /// Whether the turned triangles are a closed surface, which is all that exact occlusion needs.
    pub fn encloses(&self) -> bool {
        self.orientation.closed()
    }
}

impl Orientation {
    /// Whether all edges balance, and there are any.
    pub fn closed(&self) -> bool {
        self.open.is_empty() && self.turns.iter().any(|&turn| turn != 0)
    }
}

/// All checks. Takes `O(n log n)` time for meshes whose triangles don't cut each other.
///
/// # Errors
/// [`MeshError::Index`].
pub fn audit(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Result<Audit, MeshError> {
    let welded = weld(positions);
    Ok(Audit {
        edges: edges(triangles, &welded)?,
        orientation: orient(positions, triangles, &welded)?,
        self_intersections: self_intersections(positions, triangles, &welded)?,
    })
}

/// For each vertex the first one at the same position.
pub fn weld(positions: &[[f32; 3]]) -> Vec<u32> {
    // Adding 0 makes -0 equal to 0.
    let key = |v: u32| positions[v as usize].map(|x| (x + 0.0).to_bits());
    let mut order: Vec<_> = (0..positions.len() as u32).map(|v| (key(v), v)).collect();
    order.sort_unstable();
    let mut first = vec![0; positions.len()];
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        group.iter().for_each(|&(_, v)| first[v as usize] = group[0].1);
    }
    first
}

/// A triangle's side: welded ends from small to large, the triangle, and whether it runs from large to small.
type Half = (u32, u32, u32, bool);

/// Sides of all triangles with three different corners, those of an edge together.
fn halves(triangles: &[[u32; 3]], welded: &[u32]) -> Vec<Half> {
    let mut halves = Vec::with_capacity(3 * triangles.len());
    for (t, triangle) in triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|v| welded[v as usize]);
        if a != b && b != c && c != a {
            halves.extend(
                [(a, b), (b, c), (c, a)].map(|(from, to)| (from.min(to), from.max(to), t as u32, from > to)),
            );
        }
    }
    halves.sort_unstable();
    halves
}

/// How `triangles` meet along edges.
///
/// # Errors
/// [`MeshError::Index`].
pub fn edges(triangles: &[[u32; 3]], welded: &[u32]) -> Result<Edges, MeshError> {
    validate_indices(triangles, welded.len())?;
    let mut report = Edges::default();
    for edge in halves(triangles, welded).chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        report.edges += 1;
        let ends = [edge[0].0, edge[0].1];
        match edge {
            [_] => report.boundary.add(ends),
            [a, b] if a.3 == b.3 => report.inconsistent.add(ends),
            [_, _] => {}
            _ => report.non_manifold.add(ends),
        }
    }
    Ok(report)
}

/// Turns triangles so that each component is consistent and faces outwards.
///
/// Djeu11, section 3.2 sends a ray from outside to find the side of the normals; the signed volume says the same of a
/// component that doesn't cut itself, and chooses well for others. Triangles without area have no side: the order of their
/// corners makes no difference, and components of nothing else get the turns that leave the fewest edges open.
///
/// # Errors
/// [`MeshError::Index`].
pub fn orient(
    positions: &[[f32; 3]],
    triangles: &[[u32; 3]],
    welded: &[u32],
) -> Result<Orientation, MeshError> {
    validate_indices(triangles, positions.len().min(welded.len()))?;
    let halves = halves(triangles, welded);
    let mut sets = ParitySets::new(triangles.len());
    for edge in halves.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        if let [a, b] = edge {
            sets.join(a.2, b.2, a.3 == b.3);
        }
    }
    let mut used = vec![false; triangles.len()];
    halves.iter().for_each(|half| used[half.2 as usize] = true);
    let members: Vec<Member> = (0..triangles.len())
        .filter(|&t| used[t])
        .map(|t| {
            let (root, reversed) = sets.find(t as u32);
            let corners = triangles[t].map(|v| positions[v as usize]);
            Member { triangle: t, root: root as usize, reversed, flat: is_degenerate(corners) }
        })
        .collect();
    // Of each component: its first triangle with area, or else its first triangle in the order of welded corners; turns are
    // relative to that.
    let mut reference: Vec<Option<bool>> = vec![None; triangles.len()];
    for member in members.iter().filter(|m| !m.flat) {
        reference[member.root].get_or_insert(member.reversed);
    }
    let flat_component: Vec<bool> = reference.iter().map(Option::is_none).collect();
    for member in members.iter().filter(|m| flat_component[m.root]) {
        let [a, b, c] = triangles[member.triangle].map(|v| welded[v as usize]);
        let odd = (a > b) ^ (b > c) ^ (a > c);
        reference[member.root].get_or_insert(member.reversed ^ odd);
    }

    let mut turns = vec![0i8; triangles.len()];
    let mut volumes = vec![0f64; triangles.len()];
    let bounds = Aabb::from_points(positions);
    let center = bounds.min.as_dvec3() * 0.5 + bounds.max.as_dvec3() * 0.5;
    let mut orientation = Orientation::default();
    for &Member { triangle: t, root, reversed, flat } in &members {
        turns[t] = if reference[root] == Some(reversed) { 1 } else { -1 };
        if !flat {
            let [a, b, c] = triangles[t].map(|v| DVec3::from(positions[v as usize].map(f64::from)) - center);
            volumes[root] += f64::from(turns[t]) * a.dot(b.cross(c));
        }
    }
    for &Member { triangle: t, root, .. } in &members {
        let (inwards, one_sided) = (volumes[root] < 0.0, sets.one_sided[root]);
        turns[t] *= if one_sided { 0 } else { 1 - 2 * i8::from(inwards) };
        if root == t {
            orientation.components += 1;
            orientation.one_sided += u32::from(one_sided);
            orientation.inwards += u32::from(inwards && !one_sided);
        }
    }
    balance(&halves, &members, &flat_component, &mut turns);
    for edge in halves.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let net: i32 = edge.iter().map(|half| runs(half, &turns)).sum();
        let (a, b) = (edge[0].0, edge[0].1);
        let direction = if net > 0 { [a, b] } else { [b, a] };
        orientation.open.extend(std::iter::repeat_n(direction, net.unsigned_abs() as usize));
    }
    orientation.turns = turns;
    Ok(orientation)
}

/// A triangle with three different corners.
struct Member {
    triangle: usize,
    /// Its component, and whether it is turned the other way than the component's root.
    root: usize,
    reversed: bool,
    /// Whether it has no area.
    flat: bool,
}

/// How a side runs along its edge, turned: 1 from the smaller to the larger vertex, -1 the other way, 0 if left out.
fn runs(half: &Half, turns: &[i8]) -> i32 {
    i32::from(turns[half.2 as usize]) * if half.3 { -1 } else { 1 }
}

/// Turns components without area, one after the other, as they are, over, or leaves them out: whatever leaves least open.
fn balance(halves: &[Half], members: &[Member], flat_component: &[bool], turns: &mut [i8]) {
    let mut component = vec![usize::MAX; turns.len()];
    members.iter().filter(|m| flat_component[m.root]).for_each(|m| component[m.triangle] = m.root);
    if component.iter().all(|&root| root == usize::MAX) {
        return;
    }
    // Sums of how sides run along each edge, and the sides of each flat component with their edges.
    let mut sums = Vec::new();
    let mut sides: Vec<(usize, usize, &Half)> = Vec::new();
    for (edge, all) in halves.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).enumerate() {
        sums.push(all.iter().map(|half| runs(half, turns)).sum::<i32>());
        let flat = all.iter().filter(|half| component[half.2 as usize] != usize::MAX);
        sides.extend(flat.map(|half| (component[half.2 as usize], edge, half)));
    }
    sides.sort_unstable_by_key(|&(component, edge, _)| (component, edge));
    for sides in sides.chunk_by(|a, b| a.0 == b.0) {
        let own: Vec<(usize, i32)> = sides
            .chunk_by(|a, b| a.1 == b.1)
            .map(|edge| (edge[0].1, edge.iter().map(|(_, _, half)| runs(half, turns)).sum()))
            .collect();
        let open =
            |turn: i32| own.iter().map(|&(edge, run)| (sums[edge] - run + turn * run).abs()).sum::<i32>();
        let turn = [1, -1, 0].into_iter().min_by_key(|&turn| open(turn)).unwrap_or(1);
        own.iter().for_each(|&(edge, run)| sums[edge] += (turn - 1) * run);
        let members = sides.iter().map(|(_, _, half)| half.2 as usize);
        let mut members: Vec<usize> = members.collect();
        members.sort_unstable();
        members.dedup();
        members.into_iter().for_each(|t| turns[t] *= turn as i8);
    }
}

/// Union-find of triangles, each with its turn relative to its parent.
struct ParitySets {
    parent: Vec<u32>,
    reversed: Vec<bool>,
    /// Of roots: whether two ways round disagree.
    one_sided: Vec<bool>,
}

impl ParitySets {
    fn new(len: usize) -> Self {
        Self { parent: (0..len as u32).collect(), reversed: vec![false; len], one_sided: vec![false; len] }
    }

    /// Root, and the turn relative to it.
    fn find(&mut self, t: u32) -> (u32, bool) {
        let (mut root, mut reversed) = (t, false);
        while self.parent[root as usize] != root {
            reversed ^= self.reversed[root as usize];
            root = self.parent[root as usize];
        }
        // Every member on the way points to the root from now on.
        let (mut at, mut rest) = (t, reversed);
        while self.parent[at as usize] != root && at != root {
            let (next, own) = (self.parent[at as usize], self.reversed[at as usize]);
            (self.parent[at as usize], self.reversed[at as usize]) = (root, rest);
            (at, rest) = (next, rest ^ own);
        }
        (root, reversed)
    }

    /// Says that two triangles are turned the same way, or opposite ways. The smaller root stays.
    fn join(&mut self, a: u32, b: u32, opposite: bool) {
        let ((root_a, turn_a), (root_b, turn_b)) = (self.find(a), self.find(b));
        let relative = turn_a ^ turn_b ^ opposite;
        if root_a == root_b {
            self.one_sided[root_a as usize] |= relative;
            return;
        }
        let (root, child) = (root_a.min(root_b), root_a.max(root_b));
        self.parent[child as usize] = root;
        self.reversed[child as usize] = relative;
        self.one_sided[root as usize] |= self.one_sided[child as usize];
    }
}

#[cfg(test)]
mod tests;
