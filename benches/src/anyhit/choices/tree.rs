//! Trees that differ in one thing: how wide nodes are, which child comes first, whether large triangles are split.

use anyhow::Result;
use umbrage_accel::{BinaryTree, BuildQuality};
use umbrage_geom::{
    Aabb, TriangleMesh,
    glam::{DVec3, Vec3},
    kernel::{LANES, TriangleLanes},
};

/// Marks children that are leaves.
pub const LEAF: u32 = 1 << 31;

/// What decides which child a ray visits first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order {
    /// The largest box.
    BoxArea,
    /// Most area of triangles (`[Nah14]`, SATO).
    TriangleArea,
    /// Least cost for the probability to end there (`[Ize11]`, RTSAH; opacities make it the form for attenuating
    /// triangles).
    Termination,
}

/// Boxes of `W` children in rows, and what they are.
#[repr(C, align(64))]
pub struct Node<const W: usize> {
    /// Smallest x, largest x, smallest y, ..; empty boxes in slots that are not used.
    pub rows: [[f32; W]; 6],
    pub children: [u32; W],
}

/// Up to eight triangles, ready for either test.
pub struct Leaf {
    pub lanes: TriangleLanes,
    /// By corner, axis, lane; NaN after the last.
    pub corners: [[[f32; LANES]; 3]; 3],
    pub prims: [u32; LANES],
}

/// A tree of `W` children a node; node 0 is the root.
pub struct Tree<const W: usize> {
    pub nodes: Vec<Node<W>>,
    pub leaves: Vec<Leaf>,
}

/// Part of a triangle.
struct Reference {
    aabb: Aabb,
    prim: u32,
}

/// A subtree that has been laid out.
#[derive(Clone, Copy)]
struct Built {
    child: u32,
    aabb: Aabb,
    triangle_area: f64,
    /// Expected steps of a ray that enters.
    cost: f64,
    /// Probability that a ray that enters ends inside.
    stop: f64,
}

fn corners(mesh: &TriangleMesh, prim: u32) -> [Vec3; 3] {
    mesh.triangle(prim as usize).map(Vec3::from)
}

fn triangle_area(mesh: &TriangleMesh, prim: u32) -> f64 {
    let [a, b, c] = corners(mesh, prim).map(Vec3::as_dvec3);
    0.5 * (b - a).cross(c - a).length()
}

/// Boxes around the halves of a polygon on both sides of the plane in the middle of `aabb`'s longest axis.
fn halves(polygon: &[DVec3], aabb: &Aabb) -> [Vec<DVec3>; 2] {
    let size = aabb.size();
    let axis = (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0);
    let middle = f64::from(aabb.center()[axis]);
    let mut sides = [Vec::new(), Vec::new()];
    for (i, &a) in polygon.iter().enumerate() {
        let b = polygon[(i + 1) % polygon.len()];
        let (ha, hb) = (a[axis] - middle, b[axis] - middle);
        if ha <= 0.0 {
            sides[0].push(a);
        }
        if ha >= 0.0 {
            sides[1].push(a);
        }
        if ha * hb < 0.0 {
            let p = a + (b - a) * (ha / (ha - hb));
            sides.iter_mut().for_each(|side| side.push(p));
        }
    }
    sides
}

/// Triangles as references; with `split`, those with boxes of more than twice the mean area in as many as 16 parts, where
/// the two boxes of a cut have at most 0.8 of the area of the whole.
fn references(mesh: &TriangleMesh, split: bool) -> Vec<Reference> {
    let whole = |prim: u32| Aabb::from_points(&mesh.triangle(prim as usize));
    let count = mesh.triangles.len() as u32;
    let mean = (0..count).map(|prim| f64::from(whole(prim).area())).sum::<f64>() / f64::from(count);
    let mut references = Vec::new();
    for prim in 0..count {
        let polygon: Vec<DVec3> = corners(mesh, prim).map(Vec3::as_dvec3).into();
        let mut stack = vec![(polygon, whole(prim), 0)];
        while let Some((polygon, aabb, level)) = stack.pop() {
            let parts = if split && level < 4 && f64::from(aabb.area()) > 2.0 * mean {
                halves(&polygon, &aabb).map(|polygon| {
                    // A unit in the last place of room for what f64 rounds.
                    let around = polygon.iter().fold(Aabb::EMPTY, |b, p| b.with_point(p.as_vec3()));
                    let room = around.min.abs().max(around.max.abs()) * 2f32.powi(-22);
                    (
                        polygon,
                        Aabb {
                            min: (around.min - room).max(aabb.min),
                            max: (around.max + room).min(aabb.max),
                        },
                    )
                })
            } else {
                [(Vec::new(), Aabb::EMPTY), (Vec::new(), Aabb::EMPTY)]
            };
            let [a, b] = parts;
            if !a.0.is_empty() && !b.0.is_empty() && a.1.area() + b.1.area() < 0.8 * aabb.area() {
                stack.extend([(a.0, a.1, level + 1), (b.0, b.1, level + 1)]);
            } else {
                references.push(Reference { aabb, prim });
            }
        }
    }
    references
}

/// What a tree is built from.
struct Source<'a> {
    mesh: &'a TriangleMesh,
    references: Vec<Reference>,
    binary: BinaryTree,
    order: Order,
    opacity: &'a dyn Fn(u32) -> f32,
}

impl<const W: usize> Tree<W> {
    /// Over all triangles of `mesh`, which has some; `opacity` of a triangle is what [`Order::Termination`] expects.
    pub fn build(
        mesh: &TriangleMesh,
        order: Order,
        opacity: &dyn Fn(u32) -> f32,
        split: bool,
    ) -> Result<Self> {
        let references = references(mesh, split);
        let boxes: Vec<Aabb> = references.iter().map(|reference| reference.aabb).collect();
        let binary = BinaryTree::build(&boxes, BuildQuality::High)?;
        let source = Source { mesh, references, binary, order, opacity };
        let mut tree = Self { nodes: Vec::new(), leaves: Vec::new() };
        tree.node(&source, 0);
        Ok(tree)
    }

    /// Bytes of nodes and leaves, the corners counted once.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..])
            + self.leaves.len() * (size_of::<TriangleLanes>() + size_of::<[u32; LANES]>())
    }

    fn subtree(&mut self, source: &Source, index: u32) -> Built {
        let node = &source.binary.nodes[index as usize];
        if node.count as usize > LANES { self.node(source, index) } else { self.leaf(source, index) }
    }

    fn leaf(&mut self, source: &Source, index: u32) -> Built {
        let node = &source.binary.nodes[index as usize];
        let run = &source.binary.order[node.first as usize..(node.first + node.count) as usize];
        let mut leaf = Leaf {
            lanes: TriangleLanes::EMPTY,
            corners: [[[f32::NAN; LANES]; 3]; 3],
            prims: [u32::MAX; LANES],
        };
        let (mut area, mut pass) = (0.0, 1.0);
        for (lane, &reference) in run.iter().enumerate() {
            let prim = source.references[reference as usize].prim;
            let corners = source.mesh.triangle(prim as usize);
            leaf.lanes.set(lane, corners);
            for (rows, corner) in leaf.corners.iter_mut().zip(corners) {
                rows.iter_mut().zip(corner).for_each(|(row, x)| row[lane] = x);
            }
            leaf.prims[lane] = prim;
            let own = triangle_area(source.mesh, prim);
            area += own;
            // Mean shadows: half the area of a triangle, a quarter of a box's.
            let share = (2.0 * own / f64::from(node.aabb.area()).max(f64::MIN_POSITIVE)).min(1.0);
            pass *= 1.0 - share * f64::from((source.opacity)(prim));
        }
        self.leaves.push(leaf);
        let child = LEAF | (self.leaves.len() - 1) as u32;
        Built { child, aabb: node.aabb, triangle_area: area, cost: 1.0, stop: 1.0 - pass }
    }

    /// A node over the binary subtree `index`, opened at the largest boxes first.
    fn node(&mut self, source: &Source, index: u32) -> Built {
        let binary = &source.binary.nodes;
        let mut parts = vec![index];
        while parts.len() < W {
            let inner = |part: &&u32| binary[**part as usize].count as usize > LANES || **part == index;
            let area = |part: u32| binary[part as usize].aabb.area();
            let open = parts.iter().filter(inner).max_by(|a, b| area(**a).total_cmp(&area(**b))).copied();
            let Some(open) = open.filter(|&open| !binary[open as usize].is_leaf()) else { break };
            parts.retain(|&part| part != open);
            parts.extend(binary[open as usize].children);
        }
        let place = self.nodes.len();
        let empty = [f32::INFINITY, f32::NEG_INFINITY];
        let rows = [0, 1, 2, 3, 4, 5].map(|row| [empty[row % 2]; W]);
        self.nodes.push(Node { rows, children: [u32::MAX; W] });
        let mut built: Vec<Built> = parts.into_iter().map(|part| self.subtree(source, part)).collect();
        let key = |b: &Built| match source.order {
            Order::BoxArea => -f64::from(b.aabb.area()),
            Order::TriangleArea => -b.triangle_area,
            Order::Termination => b.cost / b.stop.max(f64::MIN_POSITIVE),
        };
        built.sort_by(|a, b| key(a).total_cmp(&key(b)));
        let aabb = binary[index as usize].aabb;
        // Nodes of one reference and no area are reached for certain.
        let share = |b: &Built| if aabb.area() > 0.0 { f64::from(b.aabb.area() / aabb.area()) } else { 1.0 };
        let (mut cost, mut pass) = (1.0, 1.0);
        for (slot, b) in built.iter().enumerate() {
            let node = &mut self.nodes[place];
            node.children[slot] = b.child;
            for axis in 0..3 {
                node.rows[2 * axis][slot] = b.aabb.min[axis];
                node.rows[2 * axis + 1][slot] = b.aabb.max[axis];
            }
            cost += pass * share(b) * b.cost;
            pass *= 1.0 - share(b) * b.stop;
        }
        let triangle_area = built.iter().map(|b| b.triangle_area).sum();
        Built { child: place as u32, aabb, triangle_area, cost, stop: 1.0 - pass }
    }
}
