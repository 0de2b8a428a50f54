//! The table of generators: names, parameters, sizes.

use super::{
    GeneratorInfo, ParameterInfo, ParameterKind, bamboo, bush, cathedral, city, control, creature, knots,
    lumps, particles, shapes, stage, strands,
};

const fn number(
    name: &'static str,
    default: f64,
    min: f64,
    max: f64,
    meaning: &'static str,
) -> ParameterInfo {
    ParameterInfo { name, kind: ParameterKind::Number { default, min, max }, meaning }
}

const fn integer(
    name: &'static str,
    default: u32,
    min: u32,
    max: u32,
    meaning: &'static str,
) -> ParameterInfo {
    ParameterInfo { name, kind: ParameterKind::Integer { default, min, max }, meaning }
}

const fn choice(
    name: &'static str,
    options: &'static [&'static str],
    meaning: &'static str,
) -> ParameterInfo {
    ParameterInfo { name, kind: ParameterKind::Choice { options }, meaning }
}

/// What most generators have in common: open, seeded, of selectable size.
const OPEN_MESH: GeneratorInfo = GeneratorInfo {
    name: "",
    summary: "",
    parameters: &[],
    closed: false,
    default_triangles: 0,
    min_triangles: 1000,
    fixed: false,
    seeded: true,
    build: shapes::plane,
};

const CLOSED_MESH: GeneratorInfo = GeneratorInfo { closed: true, ..OPEN_MESH };

const CONTROL_MESH: GeneratorInfo =
    GeneratorInfo { fixed: true, seeded: false, min_triangles: 1, ..OPEN_MESH };

pub const GENERATORS: &[GeneratorInfo] = &[
    GeneratorInfo {
        name: "bush",
        summary: "a round bush of stems, twigs and many leaves",
        parameters: &[number("leaf-size", 1.0, 0.2, 5.0, "of the leaves, in proportion to the default")],
        default_triangles: 500_000,
        build: bush::bush,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "tentacles",
        summary: "curling tapered strands that grow on a disc of ground, like hair or sea anemones",
        parameters: &[number("curl", 1.0, 0.0, 3.0, "how far the tips roll up")],
        default_triangles: 3_800_000,
        build: strands::tentacles,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "bamboo",
        summary: "a grove of segmented bamboo culms with hanging leaves",
        parameters: &[number("spacing", 1.0, 0.3, 4.0, "between culms, in proportion to the default")],
        default_triangles: 5_200_000,
        min_triangles: 4000,
        build: bamboo::bamboo,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "particles",
        summary: "flat particles in a ball, all facing one direction; light comes from straight above",
        parameters: &[
            choice("mode", &["transmit", "block"], "edge-on to the light, or facing it"),
            number("coverage", 2.0, 0.01, 100.0, "area of all particles over that of the ball's silhouette"),
        ],
        default_triangles: 200_000,
        min_triangles: 4,
        build: particles::particles,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "hairball",
        summary: "a ball of long tangled hair",
        parameters: &[number("thickness", 1.0, 0.1, 5.0, "of the hairs, in proportion to the default")],
        default_triangles: 2_880_000,
        build: strands::hairball,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "city",
        summary: "streets and blocks of towers, flats and houses with windows and ledges",
        parameters: &[number("height", 1.0, 0.2, 4.0, "of the buildings, in proportion to the default")],
        default_triangles: 879_000,
        min_triangles: 20_000,
        build: city::city,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "cathedral",
        summary: "the inside of a Gothic church: columns, ribbed vaults, windows with tracery, pews",
        parameters: &[integer("bays", 6, 3, 20, "length of the nave, in bays of 5 units")],
        default_triangles: 77_000,
        min_triangles: 30_000,
        build: cathedral::cathedral,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "dragonish",
        summary: "closed: a winged four-legged creature with a curled tail",
        default_triangles: 100_000,
        min_triangles: 3000,
        build: creature::dragonish,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "rocks",
        summary: "closed: separate stones on the ground",
        parameters: &[integer("count", 40, 1, 400, "number of stones")],
        default_triangles: 120_000,
        min_triangles: 100,
        build: lumps::rocks,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "blob",
        summary: "closed: one lumpy star-shaped body, with texture coordinates",
        parameters: &[number("bumps", 1.0, 0.0, 1.5, "height of the bumps; 0 is a sphere")],
        default_triangles: 70_000,
        min_triangles: 12,
        build: lumps::blob,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "knots",
        summary: "closed: a long thin tube along a torus knot, thick nowhere",
        parameters: &[
            integer("turns", 7, 1, 20, "times around the hole's axis"),
            integer("windings", 17, 1, 40, "times through the hole; raised until coprime to the turns"),
            number("thickness", 0.6, 0.05, 0.9, "of the tube, as a fraction of where it would touch itself"),
        ],
        default_triangles: 200_000,
        min_triangles: 6000,
        build: knots::knots,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "stage",
        summary: "three closed characters under a tree with an open trunk and thousands of leaves, on a ground",
        default_triangles: 240_000,
        min_triangles: 10_000,
        build: stage::stage,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "plane",
        summary: "a rectangle of ground, with texture coordinates",
        parameters: &[
            number("width", 2.0, 1e-3, 1e6, "size along x"),
            number("depth", 2.0, 1e-3, 1e6, "size along z"),
        ],
        default_triangles: 2,
        min_triangles: 2,
        seeded: false,
        build: shapes::plane,
        ..OPEN_MESH
    },
    GeneratorInfo {
        name: "sphere",
        summary: "closed: a sphere of radius 1 on the ground, with texture coordinates",
        default_triangles: 19_200,
        min_triangles: 12,
        seeded: false,
        build: shapes::sphere,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "box",
        summary: "closed: a box on the ground, with texture coordinates",
        parameters: &[
            number("width", 1.0, 1e-3, 1e6, "size along x"),
            number("height", 1.0, 1e-3, 1e6, "size along y"),
            number("depth", 1.0, 1e-3, 1e6, "size along z"),
        ],
        default_triangles: 12,
        min_triangles: 12,
        seeded: false,
        build: shapes::cuboid,
        ..CLOSED_MESH
    },
    GeneratorInfo {
        name: "cube-sphere",
        summary: "control mesh of 6 quads: a cube, whose limit surface is nearly a sphere",
        closed: true,
        default_triangles: 12,
        build: control::cube_sphere,
        ..CONTROL_MESH
    },
    GeneratorInfo {
        name: "creased-cube",
        summary: "control mesh of 6 quads with creases around the top, down one edge and a sharp corner",
        parameters: &[number("sharpness", 2.5, 0.0, 10.0, "of the creases; 10 is infinite")],
        closed: true,
        default_triangles: 12,
        build: control::creased_cube,
        ..CONTROL_MESH
    },
    GeneratorInfo {
        name: "open-patch",
        summary: "control mesh of 15 quads with an outer boundary and a hole, with texture coordinates",
        default_triangles: 30,
        build: control::open_patch,
        ..CONTROL_MESH
    },
    GeneratorInfo {
        name: "star-tube",
        summary: "control mesh with a vertex of high valence, triangles, quads and one large polygon",
        parameters: &[integer("points", 5, 3, 30, "points of the star")],
        closed: true,
        default_triangles: 98,
        build: control::star_tube,
        ..CONTROL_MESH
    },
];
