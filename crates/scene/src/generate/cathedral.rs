//! `cathedral`: the inside of a Gothic church: nave, aisles, columns, ribbed vaults, windows with tracery.
//!
//! The nave runs along z, the portal is at positive z and the apse at negative z; `masonry.rs` has the parts.

mod masonry;

use self::masonry::{Fineness, Outline, WallFrame, pointed_height, rib, tracery, vault, wall_with_opening};
use super::{
    Generated, Inputs,
    builder::{Builder, fit},
    random::{Stream, heading},
};
use std::f32::consts::PI;
use umbrage_geom::glam::{Vec3, vec3};

const DEFAULT_TRIANGLES: f64 = 77_000.0;
const BAY: f32 = 5.0;
/// Half width of the nave, to the axes of its columns.
const NAVE_HALF_WIDTH: f32 = 4.2;
/// Half width with the aisles, to the middle of the outer walls.
const AISLE_HALF_WIDTH: f32 = 8.4;
const WALL_THICKNESS: f32 = 0.7;
const ARCADE_SPRING: f32 = 5.2;
const AISLE_SPRING: f32 = 5.2;
const AISLE_RISE: f32 = 3.4;
const STRING_COURSE: f32 = 9.6;
const NAVE_SPRING: f32 = 11.5;
const NAVE_RISE: f32 = 5.2;
const ROOF: f32 = NAVE_SPRING + NAVE_RISE + 0.4;

/// The parts of the building, each an object.
struct Parts {
    floor: Builder,
    walls: Builder,
    columns: Builder,
    vaults: Builder,
    ribs: Builder,
    tracery: Builder,
    furniture: Builder,
    fine: Fineness,
    sides: usize,
    /// Squares along a side of a vault.
    cells: usize,
    bays: usize,
}

pub fn cathedral(inputs: &Inputs) -> Generated {
    let bays = inputs.number("bays") as usize;
    let share = inputs.triangles as f64 / DEFAULT_TRIANGLES;
    // Small budgets buy plainer stonework.
    let rich = inputs.triangles >= 50_000;
    let build = |detail: f64| build(inputs.seed, bays, detail, rich);
    fit(inputs.triangles, share.sqrt(), 1.4, build).finish().into()
}

fn build(seed: u32, bays: usize, detail: f64, rich: bool) -> Builder {
    let scaled = |x: f64, least: usize| ((x * detail).round() as usize).max(least);
    let part = |name: &str| {
        let mut builder = Builder::default();
        builder.begin(name);
        builder
    };
    let mut parts = Parts {
        floor: part("floor"),
        walls: part("walls"),
        columns: part("columns"),
        vaults: part("vaults"),
        ribs: part("ribs"),
        tracery: part("tracery"),
        furniture: part("furniture"),
        fine: Fineness { arc: scaled(8.0, 2), ring: scaled(18.0, 6), rich },
        sides: scaled(16.0, 5),
        // Even, so that the groins of the vaults run along edges.
        cells: 2 * scaled(7.0, 1),
        bays,
    };
    floor(&mut parts, detail);
    for bay in 0..bays {
        for side in [-1.0, 1.0] {
            bay_side(&mut parts, bay, side);
        }
        nave_vault(&mut parts, bay);
    }
    for line in 0..=bays {
        let z = parts.z(line);
        for side in [-1.0, 1.0] {
            column(&mut parts, vec3(side * NAVE_HALF_WIDTH, 0.0, z), side);
        }
        transverse_arches(&mut parts, line);
    }
    west_front(&mut parts);
    apse(&mut parts);
    furniture(seed, &mut parts);
    let mut all = parts.floor;
    for part in [parts.walls, parts.columns, parts.vaults, parts.ribs, parts.tracery, parts.furniture] {
        all.append(part);
    }
    all
}

impl Parts {
    /// Where the border before bay `line` lies; the portal's is the first.
    fn z(&self, line: usize) -> f32 {
        (self.bays as f32 / 2.0 - line as f32) * BAY
    }
}

/// Tiles of the nave and aisles, and the apse.
fn floor(parts: &mut Parts, detail: f64) {
    let (front, back) = (parts.z(0) + WALL_THICKNESS, parts.z(parts.bays));
    let columns = ((8.0 * detail) as usize).max(2);
    let rows = ((14.0 * detail) as usize).max(2);
    let width = 2.0 * AISLE_HALF_WIDTH + WALL_THICKNESS;
    let at = |i: usize, j: usize| {
        let (u, v) = (i as f32 / columns as f32, j as f32 / rows as f32);
        vec3((u - 0.5) * width, 0.0, front + (back - front) * v)
    };
    let out = &mut parts.floor;
    for j in 0..=rows {
        for i in 0..=columns {
            out.vertex(at(i, j));
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let a = (j * (columns + 1) + i) as u32;
            let d = a + columns as u32 + 1;
            out.quad(a, a + 1, d + 1, d);
        }
    }
    let center = out.vertex(vec3(0.0, 0.0, back));
    let rim = 4 * parts.fine.arc;
    let reach = NAVE_HALF_WIDTH + WALL_THICKNESS;
    let first = (0..=rim)
        .map(|k| out.vertex(vec3(0.0, 0.0, back) + heading(-PI * k as f32 / rim as f32) * reach))
        .min()
        .unwrap_or(center);
    for k in 0..rim as u32 {
        out.triangle(center, first + k, first + k + 1);
    }
}

/// One side of a bay: arcade and clerestory of the nave, the aisle's outer wall, its vault and buttress.
fn bay_side(parts: &mut Parts, bay: usize, side: f32) {
    let (z0, z1) = (parts.z(bay), parts.z(bay + 1));
    let middle = (z0 + z1) / 2.0;
    let inner =
        WallFrame::new(vec3(side * NAVE_HALF_WIDTH, 0.0, middle), vec3(-side, 0.0, 0.0), WALL_THICKNESS);
    let half = BAY / 2.0;
    // Arcade: the opening reaches down to the capitals.
    let arch = Outline::pointed(half - 0.55, ARCADE_SPRING, ARCADE_SPRING, parts.fine.arc);
    wall_with_opening(&mut parts.walls, &inner, [-half, ARCADE_SPRING], [half, STRING_COURSE], &arch);
    rib(
        &mut parts.ribs,
        &inner.path(&arch.points[..], 0.0),
        inner.normal,
        [0.13, WALL_THICKNESS * 0.5 + 0.1],
        false,
        parts.fine.rich,
    );
    let [course_low, course_high] = [STRING_COURSE - 0.12, STRING_COURSE + 0.1];
    let x = [
        side * (NAVE_HALF_WIDTH - WALL_THICKNESS * 0.5 - 0.12),
        side * (NAVE_HALF_WIDTH - WALL_THICKNESS * 0.5),
    ];
    parts.walls.cuboid(vec3(x[0].min(x[1]), course_low, z1), vec3(x[0].max(x[1]), course_high, z0));
    // Clerestory.
    let window = Outline::pointed(1.15, STRING_COURSE + 0.9, NAVE_SPRING + 1.0, parts.fine.arc);
    wall_with_opening(&mut parts.walls, &inner, [-half, STRING_COURSE], [half, ROOF], &window);
    tracery(&mut parts.tracery, &inner, 1.15, [STRING_COURSE + 0.9, NAVE_SPRING + 1.0], parts.fine);
    // Outer wall of the aisle.
    let outer =
        WallFrame::new(vec3(side * AISLE_HALF_WIDTH, 0.0, middle), vec3(-side, 0.0, 0.0), WALL_THICKNESS);
    let window = Outline::pointed(1.25, 1.9, 5.0, parts.fine.arc);
    wall_with_opening(&mut parts.walls, &outer, [-half, 0.0], [half, STRING_COURSE - 0.05], &window);
    tracery(&mut parts.tracery, &outer, 1.25, [1.9, 5.0], parts.fine);
    let aisle = vec3(side * (NAVE_HALF_WIDTH + AISLE_HALF_WIDTH) / 2.0, AISLE_SPRING, middle);
    let reach = [(AISLE_HALF_WIDTH - NAVE_HALF_WIDTH) / 2.0, half];
    vault(&mut parts.vaults, aisle, reach, AISLE_RISE, parts.cells);
    diagonal_ribs(parts, aisle, reach, AISLE_RISE);
    let foot = vec3(side * (AISLE_HALF_WIDTH + WALL_THICKNESS / 2.0), 0.0, z0);
    let end = foot + vec3(side * 1.3, STRING_COURSE - 1.0, 0.0);
    let [low, high] = [foot.min(end) - Vec3::Z * 0.4, foot.max(end) + Vec3::Z * 0.4];
    parts.walls.cuboid(low, high);
    // The aisle's roof leans against the nave.
    let eaves = vec3(side * (AISLE_HALF_WIDTH + WALL_THICKNESS), STRING_COURSE - 0.05, 0.0);
    let top = vec3(side * NAVE_HALF_WIDTH, STRING_COURSE + 0.8, 0.0);
    let [a, b] = if side > 0.0 { [z0, z1] } else { [z1, z0] };
    parts.vaults.face([eaves + Vec3::Z * a, eaves + Vec3::Z * b, top + Vec3::Z * b, top + Vec3::Z * a]);
}

fn nave_vault(parts: &mut Parts, bay: usize) {
    let center = vec3(0.0, NAVE_SPRING, (parts.z(bay) + parts.z(bay + 1)) / 2.0);
    vault(&mut parts.vaults, center, [NAVE_HALF_WIDTH, BAY / 2.0], NAVE_RISE, parts.cells);
    diagonal_ribs(parts, center, [NAVE_HALF_WIDTH, BAY / 2.0], NAVE_RISE);
    let boss = center + Vec3::Y * (NAVE_RISE - 0.35);
    let profile = [[0.02, 0.0], [0.28, 0.08], [0.3, 0.2], [0.2, 0.34]];
    parts.ribs.lathe(boss, &profile, parts.sides);
    // The gable roof above.
    let (z0, z1) = (parts.z(bay), parts.z(bay + 1));
    for side in [-1.0, 1.0] {
        let eaves = vec3(side * (NAVE_HALF_WIDTH + WALL_THICKNESS), ROOF - 0.3, 0.0);
        let ridge = vec3(0.0, ROOF + 4.0, 0.0);
        let [a, b] = if side > 0.0 { [z0, z1] } else { [z1, z0] };
        parts.vaults.face([
            eaves + Vec3::Z * a,
            eaves + Vec3::Z * b,
            ridge + Vec3::Z * b,
            ridge + Vec3::Z * a,
        ]);
    }
}

/// The two ribs below the groins of a vault.
fn diagonal_ribs(parts: &mut Parts, center: Vec3, reach: [f32; 2], rise: f32) {
    for sign in [-1.0, 1.0] {
        let n = 4 * parts.fine.arc;
        let path: Vec<Vec3> = (0..=n)
            .map(|k| {
                let t = 2.0 * k as f32 / n as f32 - 1.0;
                center + vec3(reach[0] * t, rise * pointed_height(t), reach[1] * t * sign)
            })
            .collect();
        let across = vec3(reach[1] * sign, 0.0, -reach[0]).normalize();
        rib(&mut parts.ribs, &path, across, [0.14, 0.11], false, parts.fine.rich);
    }
}

/// Arches across nave and aisles on the borders between bays.
fn transverse_arches(parts: &mut Parts, line: usize) {
    let z = parts.z(line);
    let aisle = (NAVE_HALF_WIDTH + AISLE_HALF_WIDTH) / 2.0;
    let spans = [
        (0.0, NAVE_HALF_WIDTH, NAVE_SPRING, NAVE_RISE, 0.26),
        (aisle, AISLE_HALF_WIDTH - aisle, AISLE_SPRING, AISLE_RISE, 0.2),
        (-aisle, AISLE_HALF_WIDTH - aisle, AISLE_SPRING, AISLE_RISE, 0.2),
    ];
    for (x, half, spring, rise, width) in spans {
        let n = 4 * parts.fine.arc;
        let path: Vec<Vec3> = (0..=n)
            .map(|k| {
                let t = 2.0 * k as f32 / n as f32 - 1.0;
                vec3(x + half * t, spring + rise * pointed_height(t), z)
            })
            .collect();
        rib(&mut parts.ribs, &path, Vec3::Z, [0.18, width], false, parts.fine.rich);
    }
}

/// A pier with base, capital and four thin shafts, and the shaft that carries the nave's vault.
fn column(parts: &mut Parts, foot: Vec3, side: f32) {
    let out = &mut parts.columns;
    let profile = [
        [0.82, 0.0],
        [0.82, 0.3],
        [0.7, 0.42],
        [0.66, 0.55],
        [0.5, 0.7],
        [0.46, 4.3],
        [0.54, 4.36],
        [0.5, 4.45],
        [0.56, 4.7],
        [0.78, 4.95],
        [0.84, 5.0],
        [0.84, ARCADE_SPRING],
    ];
    out.lathe(foot, &profile, parts.sides);
    let thin = (parts.sides / 2).max(4);
    for k in 0..4 {
        let at = foot + heading(PI * 0.5 * k as f32) * 0.5;
        out.lathe(at, &[[0.2, 0.5], [0.13, 0.65], [0.12, 4.4], [0.2, 4.75], [0.22, 4.9]], thin);
    }
    let shaft = foot - Vec3::X * (side * (WALL_THICKNESS * 0.5 + 0.02));
    let rise = [
        [0.24, ARCADE_SPRING],
        [0.16, ARCADE_SPRING + 0.25],
        [0.16, NAVE_SPRING - 0.8],
        [0.22, NAVE_SPRING - 0.7],
        [0.2, NAVE_SPRING - 0.5],
        [0.36, NAVE_SPRING - 0.05],
        [0.36, NAVE_SPRING + 0.15],
    ];
    out.lathe(shaft, &rise, thin.max(6));
    let respond = foot + Vec3::X * (side * (AISLE_HALF_WIDTH - NAVE_HALF_WIDTH - WALL_THICKNESS * 0.5));
    out.lathe(
        respond,
        &[[0.34, 0.0], [0.34, 0.4], [0.2, 0.6], [0.2, 4.5], [0.36, 5.0], [0.36, AISLE_SPRING]],
        thin.max(6),
    );
}

/// The wall at the portal with a rose window, the aisles' ends with windows.
fn west_front(parts: &mut Parts) {
    let arc = parts.fine.arc;
    let z = parts.z(0) + WALL_THICKNESS / 2.0;
    let front = WallFrame::new(vec3(0.0, 0.0, z), Vec3::NEG_Z, WALL_THICKNESS);
    let portal = Outline::pointed(1.5, 0.0, 2.6, arc);
    wall_with_opening(&mut parts.walls, &front, [-NAVE_HALF_WIDTH, 0.0], [NAVE_HALF_WIDTH, 7.2], &portal);
    rib(
        &mut parts.ribs,
        &front.path(&portal.points, WALL_THICKNESS / 2.0),
        front.normal,
        [0.16, 0.16],
        false,
        parts.fine.rich,
    );
    let rose = [0.0, 11.2];
    let radius = 2.9;
    let circle = Outline::circle(rose, radius, 8 * arc);
    wall_with_opening(&mut parts.walls, &front, [-NAVE_HALF_WIDTH, 7.2], [NAVE_HALF_WIDTH, ROOF], &circle);
    masonry::rose(&mut parts.tracery, &front, rose, radius, 12, parts.fine);
    for (z, outwards) in [(parts.z(0), 1.0), (parts.z(parts.bays), -1.0)] {
        gable(&mut parts.walls, z, outwards);
    }
    for side in [-1.0, 1.0] {
        for (z, normal) in [(z, Vec3::NEG_Z), (parts.z(parts.bays) - WALL_THICKNESS / 2.0, Vec3::Z)] {
            let end = WallFrame::new(
                vec3(side * (NAVE_HALF_WIDTH + AISLE_HALF_WIDTH) / 2.0, 0.0, z),
                normal,
                WALL_THICKNESS,
            );
            let half = (AISLE_HALF_WIDTH - NAVE_HALF_WIDTH) / 2.0;
            let window = Outline::pointed(1.1, 2.0, 5.0, arc);
            wall_with_opening(&mut parts.walls, &end, [-half, 0.0], [half, STRING_COURSE], &window);
            tracery(&mut parts.tracery, &end, 1.1, [2.0, 5.0], parts.fine);
        }
    }
}

/// The wall below the end of the nave's roof and the piers at the building's corners.
fn gable(out: &mut Builder, z: f32, outwards: f32) {
    let reach = NAVE_HALF_WIDTH + WALL_THICKNESS;
    let corners = [vec3(-reach, ROOF - 0.3, 0.0), vec3(reach, ROOF - 0.3, 0.0), vec3(0.0, ROOF + 4.0, 0.0)];
    for (depth, turned) in [(0.0, outwards > 0.0), (WALL_THICKNESS, outwards < 0.0)] {
        let v = corners.map(|p| out.vertex(p + Vec3::Z * (z + outwards * depth)));
        if turned { out.triangle(v[0], v[2], v[1]) } else { out.triangle(v[0], v[1], v[2]) }
    }
    for side in [-1.0, 1.0] {
        let [near, far] =
            [reach, 0.0].map(|x| vec3(side * x, if x > 0.0 { ROOF - 0.3 } else { ROOF + 4.0 }, z));
        let depth = Vec3::Z * (outwards * WALL_THICKNESS);
        let edge = [near, near + depth, far + depth, far];
        out.face(if side * outwards > 0.0 { [edge[3], edge[2], edge[1], edge[0]] } else { edge });
        let gap =
            [(AISLE_HALF_WIDTH + WALL_THICKNESS, -0.05), (NAVE_HALF_WIDTH, 0.8), (NAVE_HALF_WIDTH, -0.05)];
        let v = gap
            .map(|(x, y)| out.vertex(vec3(side * x, STRING_COURSE + y, z + outwards * WALL_THICKNESS * 0.5)));
        if side * outwards > 0.0 {
            out.triangle(v[0], v[1], v[2])
        } else {
            out.triangle(v[0], v[2], v[1])
        }
        for (x, top) in [(NAVE_HALF_WIDTH, ROOF - 0.1), (AISLE_HALF_WIDTH, STRING_COURSE - 0.05)] {
            let pier = vec3(side * x, 0.0, z + outwards * WALL_THICKNESS * 0.5);
            // Outside the rooms, so that only their outer corners show.
            let [near, far] = [
                pier + vec3(side * 0.3, 0.0, outwards * -0.3),
                pier + vec3(side * 0.75, top, outwards * 0.75),
            ];
            out.cuboid(near.min(far), near.max(far));
        }
    }
}

/// Five walls with tall windows on a half polygon, and their vault.
fn apse(parts: &mut Parts) {
    const FACES: usize = 5;
    let back = vec3(0.0, 0.0, parts.z(parts.bays));
    let corner = |k: usize| back + heading(-PI * k as f32 / FACES as f32) * NAVE_HALF_WIDTH;
    let n = 2 * parts.fine.arc;
    for k in 0..FACES {
        let (a, b) = (corner(k), corner(k + 1));
        let middle = (a + b) / 2.0;
        let inwards = (back - middle).normalize();
        let half = a.distance(b) / 2.0;
        let frame = WallFrame::new(middle - inwards * (WALL_THICKNESS / 2.0), inwards, WALL_THICKNESS);
        let window = Outline::pointed(half * 0.58, 2.6, NAVE_SPRING - 1.0, parts.fine.arc);
        // The outer faces overlap at the corners, so that no gap opens there.
        wall_with_opening(&mut parts.walls, &frame, [-half, 0.0], [half, NAVE_SPRING + 3.2], &window);
        tracery(&mut parts.tracery, &frame, half * 0.58, [2.6, NAVE_SPRING - 1.0], parts.fine);
        let rise = Vec3::Y * (NAVE_SPRING + 3.2);
        let [c, d] = [a, b].map(|p| back + (p - back) * 1.22 + rise);
        let peak = parts.vaults.vertex(back + Vec3::Y * (ROOF + 2.0));
        let [c, d] = [c, d].map(|p| parts.vaults.vertex(p));
        parts.vaults.triangle(c, d, peak);
        // A web of the vault from the wall to the keystone, its rim arched like the wall below.
        let web = |i: usize, j: usize| {
            let (u, v) = (i as f32 / n as f32, j as f32 / n as f32);
            let rim = a.lerp(b, u);
            let t = 2.0 * u - 1.0;
            let along = NAVE_RISE * pointed_height(1.0 - v);
            let arch = 2.6 * pointed_height(t) * (1.0 - v) * (1.0 - v);
            rim.lerp(back, v) + Vec3::Y * (NAVE_SPRING + along.max(arch))
        };
        let first = (0..=n).flat_map(|j| (0..=n).map(move |i| (i, j)));
        let first = first.map(|(i, j)| parts.vaults.vertex(web(i, j))).min().unwrap_or(0);
        for j in 0..n {
            for i in 0..n {
                let v = first + (j * (n + 1) + i) as u32;
                let above = v + n as u32 + 1;
                if j + 1 == n {
                    // All of the last row is the keystone.
                    parts.vaults.triangle(v + 1, v, above);
                } else {
                    parts.vaults.quad(v + 1, v, above, above + 1);
                }
            }
        }
    }
    for k in 0..=FACES {
        let outwards = (corner(k) - back).normalize();
        let post = [[0.5, 0.0], [0.5, NAVE_SPRING + 3.3]];
        parts.walls.lathe(corner(k) + outwards * 0.5, &post, (parts.sides / 2).max(5));
        let path: Vec<Vec3> = (0..=2 * n)
            .map(|i| {
                let v = i as f32 / (2 * n) as f32;
                corner(k).lerp(back, v) + Vec3::Y * (NAVE_SPRING + NAVE_RISE * pointed_height(1.0 - v))
            })
            .collect();
        let across = (corner(k) - back).normalize().cross(Vec3::Y);
        rib(&mut parts.ribs, &path, across, [0.14, 0.12], false, parts.fine.rich);
        let foot = corner(k) + (back - corner(k)).normalize() * 0.1;
        let thin = (parts.sides / 2).max(6);
        let profile = [[0.3, 0.0], [0.3, 0.4], [0.17, 0.55], [0.17, NAVE_SPRING - 0.5], [0.32, NAVE_SPRING]];
        parts.columns.lathe(foot, &profile, thin);
    }
}

/// Pews, slightly out of line, and an altar on steps.
fn furniture(seed: u32, parts: &mut Parts) {
    let altar = vec3(0.0, 0.0, parts.z(parts.bays) + 0.2);
    let out = &mut parts.furniture;
    let (first, last) = (BAY * (parts.bays as f32 / 2.0 - 0.8), -BAY * (parts.bays as f32 / 2.0 - 1.7));
    let rows = ((first - last) / 1.15).max(0.0) as usize;
    for row in 0..rows {
        for side in [-1.0f32, 1.0] {
            let mut random = Stream::new(seed, 0, row * 2 + usize::from(side > 0.0));
            let at = vec3(
                side * 1.95 + 0.05 * random.signed(),
                0.0,
                first - 1.15 * row as f32 + 0.06 * random.signed(),
            );
            let half = 1.15;
            out.cuboid(at + vec3(-half, 0.42, -0.22), at + vec3(half, 0.48, 0.2));
            out.cuboid(at + vec3(-half, 0.48, 0.2), at + vec3(half, 0.98, 0.26));
            for end in [-half, half] {
                let end = at + vec3(end, 0.0, 0.0);
                out.cuboid(end + vec3(-0.04, 0.0, -0.3), end + vec3(0.04, 1.05, 0.3));
            }
        }
    }
    for step in 0..3 {
        let (half, y) = (2.6 - 0.4 * step as f32, 0.16 * step as f32);
        out.cuboid(altar + vec3(-half, y, -half * 0.7), altar + vec3(half, y + 0.16, half * 0.7));
    }
    out.cuboid(altar + vec3(-1.0, 0.48, -0.45), altar + vec3(1.0, 1.4, 0.45));
    out.cuboid(altar + vec3(-1.15, 1.4, -0.55), altar + vec3(1.15, 1.52, 0.55));
}
