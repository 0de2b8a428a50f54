//! `city`: streets, blocks of varied buildings with windows and ledges, parks.

use super::{
    Generated, Inputs,
    builder::{Builder, fit},
    random::{Stream, heading, rotate},
};
use std::f32::consts::TAU;
use umbrage_geom::glam::{Vec3, vec3};

const DEFAULT_TRIANGLES: f64 = 879_000.0;
/// From the middle of one street to that of the next.
const PITCH: f32 = 12.0;
/// Side of a block between its streets.
const BLOCK: f32 = 9.2;
const PAVEMENT: f32 = 0.12;

pub fn city(inputs: &Inputs) -> Generated {
    // Half of a larger budget makes the city larger, the other half its facades finer.
    let share = inputs.triangles as f64 / DEFAULT_TRIANGLES;
    let blocks = ((44.0 * share.sqrt()).round() as usize).max(5);
    let height = inputs.number("height") as f32;
    let build = |detail: f64| build(inputs.seed, blocks, height, detail as f32);
    fit(inputs.triangles, share.sqrt().sqrt(), 2.0, build).finish().into()
}

/// The corner blocks nearest the middle, in order of distance.
fn block_centers(count: usize) -> Vec<Vec3> {
    let reach = (count as f32).sqrt() as i32 + 2;
    let mut centers = Vec::new();
    for j in -reach..=reach {
        for i in -reach..=reach {
            centers.push([i, j]);
        }
    }
    // Ties are broken by position, so that the order is the same everywhere.
    centers.sort_by_key(|&[i, j]| (i * i + j * j, i, j));
    centers[..count].iter().map(|&[i, j]| vec3(i as f32, 0.0, j as f32) * PITCH).collect()
}

fn build(seed: u32, blocks: usize, height: f32, detail: f32) -> Builder {
    let centers = block_centers(blocks);
    let reach = centers.iter().map(|c| c.abs().max_element()).fold(0.0, f32::max) + PITCH;
    let mut ground = Builder::default();
    let mut buildings = Builder::default();
    let mut trees = Builder::default();
    ground.begin("ground");
    buildings.begin("buildings");
    trees.begin("trees");
    streets(&mut ground, reach);
    for (index, &center) in centers.iter().enumerate() {
        let mut random = Stream::new(seed, 0, index);
        let half = vec3(BLOCK / 2.0, 0.0, BLOCK / 2.0);
        ground.cuboid(center - half, center + half + Vec3::Y * PAVEMENT);
        // 1 in the middle, 0 at the edge of town.
        let central = (1.0 - center.length() / reach).max(0.0);
        if index > 2 && random.chance(0.12) {
            park(&mut trees, center, &mut random, detail);
        } else {
            block(&mut buildings, center, central, height, detail, &mut random);
            street_trees(&mut trees, center, &mut random, detail);
        }
    }
    buildings.append(ground);
    buildings.append(trees);
    buildings
}

/// The ground in squares as large as a pitch.
fn streets(out: &mut Builder, reach: f32) {
    let n = (2.0 * reach / PITCH).round().max(1.0) as i32;
    for j in 0..n {
        for i in 0..n {
            let min = vec3(i as f32 * PITCH - reach, 0.0, j as f32 * PITCH - reach);
            let (x, z) = (Vec3::X * PITCH, Vec3::Z * PITCH);
            out.face([min + z, min + z + x, min + x, min]);
        }
    }
}

/// A rectangle of ground and the height of its floors.
#[derive(Clone, Copy)]
struct Lot {
    min: Vec3,
    max: Vec3,
}

impl Lot {
    fn shrunk(self, by: f32) -> Self {
        let by = vec3(by, 0.0, by);
        Self { min: self.min + by, max: self.max - by }
    }

    fn size(self) -> Vec3 {
        self.max - self.min
    }
}

/// Cuts a block into one, two or four lots and builds on each.
fn block(out: &mut Builder, center: Vec3, central: f32, height: f32, detail: f32, random: &mut Stream) {
    let half = BLOCK / 2.0 - 0.7;
    let cuts: &[[f32; 4]] = match random.below(4) {
        0 => &[[-1.0, -1.0, 1.0, 1.0]],
        1 => &[[-1.0, -1.0, 0.1, 1.0], [0.1, -1.0, 1.0, 1.0]],
        2 => &[[-1.0, -1.0, 1.0, -0.1], [-1.0, -0.1, 0.2, 1.0], [0.2, -0.1, 1.0, 1.0]],
        _ => &[[-1.0, -1.0, 0.0, 0.0], [0.0, -1.0, 1.0, 0.1], [-1.0, 0.0, 0.0, 1.0], [0.0, 0.1, 1.0, 1.0]],
    };
    for c in cuts {
        let at = |x: f32, z: f32| center + vec3(x * half, PAVEMENT, z * half);
        let lot = Lot { min: at(c[0], c[1]), max: at(c[2], c[3]) }.shrunk(0.18);
        let tall = central * central * random.range(0.5, 1.2);
        if tall > 0.34 {
            tower(out, lot, height * (7.0 + 26.0 * tall), detail, random);
        } else if central > 0.22 || random.chance(0.4) {
            tenement(out, lot, height * random.range(2.6, 6.5), detail, random);
        } else {
            house(out, lot.shrunk(0.4), height, detail, random);
        }
    }
}

/// Windows of a facade.
#[derive(Clone, Copy)]
struct Windows {
    /// Width of a bay and height of a floor.
    bay: [f32; 2],
    /// Share of the bay that the opening takes, across and up.
    opening: [f32; 2],
    /// How deep the glass lies behind the wall.
    depth: f32,
    /// Whether each has a sill.
    sill: bool,
}

impl Windows {
    fn new(detail: f32, random: &mut Stream) -> Self {
        let bay = [random.range(0.6, 0.95) / detail, random.range(0.7, 0.9) / detail];
        let (opening, sill) = match random.below(3) {
            0 => ([0.5, 0.62], true),
            1 => ([0.86, 0.6], false),
            _ => ([0.62, 0.8], false),
        };
        Self { bay, opening, depth: 0.07, sill }
    }
}

/// Four walls with windows and a flat roof.
fn storeys(out: &mut Builder, lot: Lot, height: f32, windows: Windows) {
    let size = lot.size();
    let base = lot.min;
    let (x, z) = (Vec3::X, Vec3::Z);
    wall(out, base + z * size.z, x, size.x, height, windows);
    wall(out, base + z * size.z + x * size.x, -z, size.z, height, windows);
    wall(out, base + x * size.x, -x, size.x, height, windows);
    wall(out, base, z, size.z, height, windows);
    let top = base + Vec3::Y * height;
    out.face([top + z * size.z, top + z * size.z + x * size.x, top + x * size.x, top]);
}

/// A wall from `base` along `along`, seen from the side that `along x Y` points to.
fn wall(out: &mut Builder, base: Vec3, along: Vec3, width: f32, height: f32, windows: Windows) {
    let normal = along.cross(Vec3::Y);
    let columns = (width / windows.bay[0]).round().max(1.0);
    let rows = (height / windows.bay[1]).round().max(1.0);
    let (w, h) = (width / columns, height / rows);
    let frame = windows.opening.map(|share| 1.0 - share);
    let inset = [w * frame[0] * 0.5, h * frame[1] * 0.6, h * frame[1] * 0.4];
    for row in 0..rows as usize {
        for column in 0..columns as usize {
            let point = |x: f32, y: f32, inwards: f32| base + along * x + Vec3::Y * y - normal * inwards;
            // The same expression for the end of one bay and the start of the next, so that no crack opens.
            let [x0, x1] = [column, column + 1].map(|k| w * k as f32);
            let [y0, y1] = [row, row + 1].map(|k| h * k as f32);
            let (w0, w1, h0, h1) = (x0 + inset[0], x1 - inset[0], y0 + inset[1], y1 - inset[2]);
            let outer = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| out.vertex(point(x, y, 0.0)));
            let edges = [[w0, h0], [w1, h0], [w1, h1], [w0, h1]];
            let rim = edges.map(|[x, y]| out.vertex(point(x, y, 0.0)));
            let glass = edges.map(|[x, y]| out.vertex(point(x, y, windows.depth)));
            for i in 0..4 {
                let j = (i + 1) % 4;
                out.quad(outer[i], outer[j], rim[j], rim[i]);
                out.quad(rim[i], rim[j], glass[j], glass[i]);
            }
            out.quad(glass[0], glass[1], glass[2], glass[3]);
            if windows.sill {
                let corners =
                    |y: f32| [point(w0, y, 0.0), point(w1, y, 0.0), point(w1, y, -0.05), point(w0, y, -0.05)];
                let [a, b, c, d] = corners(h0 - 0.04);
                let [e, f, g, i] = corners(h0);
                out.hexahedron([a, b, c, d, e, f, g, i]);
            }
        }
    }
}

/// A slab that sticks out around a building at `y` above its foot.
fn ledge(out: &mut Builder, lot: Lot, y: f32, thickness: f32, out_by: f32) {
    let lot = lot.shrunk(-out_by);
    let top = vec3(lot.max.x, lot.min.y + y + thickness, lot.max.z);
    out.cuboid(lot.min + Vec3::Y * y, top);
}

/// A low wall around a flat roof.
fn parapet(out: &mut Builder, lot: Lot, y: f32) {
    let (low, high, t) = (lot.min.y + y, lot.min.y + y + 0.28, 0.12);
    let (a, b) = (lot.min, lot.max);
    out.cuboid(vec3(a.x, low, a.z), vec3(b.x, high, a.z + t));
    out.cuboid(vec3(a.x, low, b.z - t), vec3(b.x, high, b.z));
    out.cuboid(vec3(a.x, low, a.z + t), vec3(a.x + t, high, b.z - t));
    out.cuboid(vec3(b.x - t, low, a.z + t), vec3(b.x, high, b.z - t));
}

/// Machines, a stair house and now and then a water tank on a flat roof.
fn roof_clutter(out: &mut Builder, lot: Lot, y: f32, random: &mut Stream) {
    let lot = lot.shrunk(0.35);
    let size = lot.size();
    if size.x.min(size.z) < 1.0 {
        return;
    }
    for _ in 0..2 + random.below(4) {
        let half = vec3(random.range(0.12, 0.3), 0.0, random.range(0.12, 0.3));
        let place = lot.min + vec3(size.x * random.range(0.2, 0.8), y, size.z * random.range(0.2, 0.8));
        out.cuboid(place - half, place + half + Vec3::Y * random.range(0.2, 0.55));
    }
    if random.chance(0.35) {
        let place = lot.min + vec3(size.x * random.range(0.2, 0.8), y, size.z * random.range(0.2, 0.8));
        for k in 0..4 {
            let leg = place + heading(TAU * (k as f32 + 0.5) / 4.0) * 0.3;
            out.cuboid(leg - vec3(0.03, 0.0, 0.03), leg + vec3(0.03, 0.5, 0.03));
        }
        out.lathe(
            place,
            &[[0.0, 0.5], [0.4, 0.5], [0.4, 1.1], [0.0, 1.35]].map(|[r, h]: [f32; 2]| [r.max(0.01), h]),
            10,
        );
    }
}

/// Storeys that step back towards the top, with a mast.
fn tower(out: &mut Builder, lot: Lot, height: f32, detail: f32, random: &mut Stream) {
    let windows = Windows::new(detail, random);
    let tiers = 1 + random.below(3);
    let (mut lot, mut foot) = (lot, 0.0);
    let (ground, base) = (lot.min.y, 1.1);
    storeys(
        out,
        lot,
        base,
        Windows { bay: [windows.bay[0] * 1.6, base], opening: [0.8, 0.75], sill: false, ..windows },
    );
    ledge(out, lot, base, 0.1, 0.1);
    foot += base;
    for tier in 0..tiers {
        let rise = (height - foot) * if tier + 1 == tiers { 1.0 } else { random.range(0.45, 0.65) };
        lot.min.y = ground + foot;
        storeys(out, lot, rise, windows);
        ledge(out, lot, rise - 0.12, 0.12, 0.08);
        parapet(out, lot, rise);
        foot += rise;
        if tier + 1 == tiers {
            roof_clutter(out, lot, rise, random);
            if random.chance(0.4) {
                let top = (lot.min + lot.max) / 2.0;
                let mast = vec3(top.x, lot.min.y + rise, top.z);
                out.tube(&[mast, mast + Vec3::Y * 1.2, mast + Vec3::Y * 3.2], &[0.08, 0.05, 0.0], 5);
            }
        }
        lot = lot.shrunk(lot.size().x.min(lot.size().z) * random.range(0.1, 0.2));
    }
}

/// A block of flats: a tall ground floor, a string course now and then, a cornice, sometimes an inner yard wing.
fn tenement(out: &mut Builder, lot: Lot, height: f32, detail: f32, random: &mut Stream) {
    let windows = Windows::new(detail, random);
    let mut lot = lot;
    if random.chance(0.5) {
        // The yard side stays lower.
        let depth = lot.size().z * random.range(0.3, 0.45);
        let wing = Lot { min: lot.min, max: vec3(lot.max.x, lot.max.y, lot.min.z + depth) };
        let low = (height * random.range(0.4, 0.7)).max(1.2);
        storeys(out, wing, low, windows);
        parapet(out, wing, low);
        roof_clutter(out, wing, low, random);
        lot.min.z += depth;
    }
    let base = 1.0;
    storeys(
        out,
        lot,
        base,
        Windows { bay: [windows.bay[0] * 1.5, base], opening: [0.75, 0.8], sill: false, ..windows },
    );
    ledge(out, lot, base, 0.07, 0.07);
    let ground = lot.min.y;
    lot.min.y += base;
    let rise = (height - base).max(0.8);
    storeys(out, lot, rise, windows);
    for k in 1..3 {
        if random.chance(0.5) {
            ledge(out, lot, rise * k as f32 / 3.0, 0.05, 0.05);
        }
    }
    if random.chance(0.3) {
        pitched_roof(out, lot, rise, lot.size().z * 0.3);
    } else {
        ledge(out, lot, rise - 0.1, 0.14, 0.14);
        parapet(out, lot, rise);
        roof_clutter(out, lot, rise, random);
    }
    debug_assert!(lot.min.y > ground);
}

/// A gable roof with eaves, along the longer side.
fn pitched_roof(out: &mut Builder, lot: Lot, y: f32, rise: f32) {
    let lot = lot.shrunk(-0.15);
    let (a, b, low) = (lot.min, lot.max, lot.min.y + y);
    let high = low + rise;
    let along_x = lot.size().x >= lot.size().z;
    let eaves = [vec3(a.x, low, a.z), vec3(b.x, low, a.z), vec3(b.x, low, b.z), vec3(a.x, low, b.z)];
    let middle = (a + b) / 2.0;
    let ridge = if along_x {
        [vec3(a.x, high, middle.z), vec3(b.x, high, middle.z)]
    } else {
        [vec3(middle.x, high, a.z), vec3(middle.x, high, b.z)]
    };
    let v = eaves.map(|p| out.vertex(p));
    let [r, s] = ridge.map(|p| out.vertex(p));
    out.quad(v[0], v[1], v[2], v[3]);
    if along_x {
        out.quad(v[0], r, s, v[1]);
        out.quad(v[2], s, r, v[3]);
        out.triangle(v[0], v[3], r);
        out.triangle(v[2], v[1], s);
    } else {
        out.quad(v[1], r, s, v[2]);
        out.quad(v[3], s, r, v[0]);
        out.triangle(v[1], v[0], r);
        out.triangle(v[3], v[2], s);
    }
}

fn house(out: &mut Builder, lot: Lot, height: f32, detail: f32, random: &mut Stream) {
    let size = lot.size();
    let lot = Lot { min: lot.min + vec3(size.x * 0.15, 0.0, size.z * 0.15) * random.unit(), max: lot.max };
    let rise = height * if random.chance(0.5) { 0.9 } else { 1.7 };
    storeys(out, lot, rise, Windows { opening: [0.45, 0.55], sill: true, ..Windows::new(detail, random) });
    let roof = lot.size().x.min(lot.size().z) * 0.45;
    pitched_roof(out, lot, rise, roof);
    let chimney = lot.min + lot.size() * vec3(0.3, 0.0, 0.3) + Vec3::Y * rise;
    out.cuboid(chimney, chimney + vec3(0.25, roof * 1.1, 0.25));
}

fn tree(out: &mut Builder, place: Vec3, random: &mut Stream, detail: f32) {
    let size = random.range(0.7, 1.3);
    out.tube(&[place, place + Vec3::Y * size], &[0.07 * size, 0.05 * size], 5);
    let sides = ((7.0 * detail) as usize).clamp(5, 32);
    for _ in 0..3 {
        let center = place + Vec3::Y * (size * random.range(0.9, 1.4)) + random.direction() * (0.25 * size);
        let r = random.range(0.3, 0.5) * size;
        let rings = sides / 2 + 1;
        let profile: Vec<[f32; 2]> = (0..=rings)
            .map(|i| {
                let (s, c) = super::random::sin_cos(std::f32::consts::PI * i as f32 / rings as f32);
                [(s * r).max(0.01), -c * r]
            })
            .collect();
        out.lathe(center, &profile, sides);
    }
}

fn park(out: &mut Builder, center: Vec3, random: &mut Stream, detail: f32) {
    for _ in 0..18 {
        let place =
            center + vec3(random.signed(), 0.0, random.signed()) * (BLOCK * 0.42) + Vec3::Y * PAVEMENT;
        tree(out, place, random, detail);
    }
}

fn street_trees(out: &mut Builder, center: Vec3, random: &mut Stream, detail: f32) {
    for side in 0..4 {
        for k in 0..3 {
            if random.chance(0.45) {
                let edge = vec3((k as f32 - 1.0) * BLOCK * 0.33, PAVEMENT, BLOCK / 2.0 - 0.25);
                tree(out, center + rotate(edge, Vec3::Y, TAU * side as f32 / 4.0), random, detail * 0.8);
            }
        }
    }
}
