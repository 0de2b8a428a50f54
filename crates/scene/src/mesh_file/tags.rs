//! Subdivision tags of OBJ files, as OpenSubdiv's regression shapes have them: `t NAME INTEGERS/NUMBERS/WORDS`, then as many
//! values of each kind.
//!
//! Here: what the tags of a file say. Not here: where they stand in the file (`obj.rs`), what they do (crate `umbrage-reyes`).

use super::{
    ContentError,
    obj::{parse_float, parse_integer, quote, words},
};
use std::collections::HashSet;
use umbrage_geom::{BoundaryRule, CreaseMethod, PolygonMesh, mesh::MAX_ELEMENTS};

/// The tags that are obeyed.
const TAG_NAMES: [&[u8]; 5] =
    [b"crease", b"corner", b"interpolateboundary", b"creasemethod", b"facevaryinginterpolateboundary"];

/// What a vertex may be, counted from 0.
const VERTEX_INDICES: std::ops::Range<i64> = 0..MAX_ELEMENTS as i64;

/// Tags of a file, checked but for whether the vertices exist.
#[derive(Default)]
pub(super) struct Tags {
    creases: Vec<([u32; 2], f32)>,
    sharp_vertices: Vec<(u32, f32)>,
    /// Number of the line, and the rule; `None` is rule 0.
    boundary: Option<(usize, Option<BoundaryRule>)>,
    /// Number of the line, and the method.
    crease_method: Option<(usize, CreaseMethod)>,
    /// The first tag that is not implemented. It concerns only those who read polygons.
    unknown: Option<(usize, String)>,
}

/// The values of one tag.
struct Values {
    name: String,
    integers: Vec<i64>,
    numbers: Vec<f32>,
    words: Vec<String>,
}

impl Tags {
    /// Reads the tag whose name and values are `rest`, on line `line`.
    pub(super) fn read(&mut self, rest: &[u8], line: usize, is_comment: bool) -> Result<(), String> {
        let mut rest = words(rest);
        let name = rest.next().unwrap_or_default();
        let counts = counts(rest.next().unwrap_or_default());
        if !TAG_NAMES.contains(&name) {
            // A comment that starts with these letters need not be a tag.
            if !is_comment || counts.is_some() {
                let known = "crease, corner, interpolateboundary and creasemethod are";
                let message = format!("tag '{}' is not implemented, {known}", quote(name));
                self.unknown.get_or_insert((line, message));
            }
            return Ok(());
        }
        let values = Values::read(quote(name), counts, rest)?;
        match name {
            b"crease" => {
                let (vertices, sharpness) = values.sharpness(1)?;
                let ends = vertices.windows(2).map(|ends| [ends[0], ends[1]]);
                self.creases.extend(ends.zip(sharpness).filter(|(_, s)| *s > 0.0));
            }
            b"corner" => {
                let (vertices, sharpness) = values.sharpness(0)?;
                self.sharp_vertices.extend(vertices.into_iter().zip(sharpness).filter(|(_, s)| *s > 0.0));
            }
            b"interpolateboundary" => {
                let rule = match values.integers[..] {
                    [0] => None,
                    [1] => Some(BoundaryRule::EdgeAndCorner),
                    [2] => Some(BoundaryRule::EdgeOnly),
                    _ => return Err(values.expected("'1/0/0' and 0, 1 or 2")),
                };
                once(&mut self.boundary, line, rule, &values.name)?;
            }
            b"creasemethod" => {
                let method = match values.words.iter().map(String::as_str).collect::<Vec<_>>()[..] {
                    ["normal"] => CreaseMethod::Uniform,
                    ["chaikin"] => CreaseMethod::Chaikin,
                    _ => return Err(values.expected("'0/0/1' and 'normal' or 'chaikin'")),
                };
                once(&mut self.crease_method, line, method, &values.name)?;
            }
            // Corners of the texture's seams keep their place whatever the file says, which is rule 1.
            _ => match values.integers[..] {
                [1] => {}
                [0 | 2 | 3] => {
                    let message = format!("{} {} is not implemented, 1 is", values.name, values.integers[0]);
                    self.unknown.get_or_insert((line, message));
                }
                _ => return Err(values.expected("'1/0/0' and 0, 1, 2 or 3")),
            },
        }
        Ok(())
    }

    /// Puts the tags into the mesh of the same file.
    pub(super) fn apply(self, mesh: &mut PolygonMesh) -> Result<(), ContentError> {
        if let Some((line, message)) = self.unknown {
            return Err(ContentError::Line(line, message));
        }
        let count = mesh.positions.len();
        let tagged =
            self.creases.iter().flat_map(|(edge, _)| edge).chain(self.sharp_vertices.iter().map(|(v, _)| v));
        if let Some(vertex) = tagged.into_iter().find(|&&v| v as usize >= count) {
            return Err(ContentError::content(format!(
                "a tag names vertex {vertex}, but there are only {count} (from 0)"
            )));
        }
        match self.boundary {
            Some((_, Some(rule))) => mesh.boundary = rule,
            Some((line, None)) => {
                if let Some([a, b]) = boundary_edge(mesh) {
                    return Err(ContentError::Line(
                        line,
                        format!(
                            "interpolateboundary 0, which leaves out the faces at a boundary, is not implemented, 1 and 2 are; \
                             edge {a}-{b} (from 0) is a boundary"
                        ),
                    ));
                }
            }
            None => {}
        }
        if let Some((_, method)) = self.crease_method {
            mesh.crease_method = method;
        }
        mesh.creases = self.creases;
        mesh.sharp_vertices = self.sharp_vertices;
        Ok(())
    }
}

/// Stores what a tag says that may stand in a file once, or again with the same value.
fn once<T: PartialEq>(
    known: &mut Option<(usize, T)>,
    line: usize,
    value: T,
    name: &str,
) -> Result<(), String> {
    match known {
        Some((first, other)) if *other != value => {
            Err(format!("{name} tag differs from that of line {first}"))
        }
        Some(_) => Ok(()),
        None => {
            *known = Some((line, value));
            Ok(())
        }
    }
}

/// An edge that one face alone has.
fn boundary_edge(mesh: &PolygonMesh) -> Option<[u32; 2]> {
    let edges = || mesh.faces().flat_map(|f| (0..f.len()).map(move |i| [f[i], f[(i + 1) % f.len()]]));
    let all: HashSet<[u32; 2]> = edges().collect();
    edges().find(|[a, b]| !all.contains(&[*b, *a]))
}

/// The numbers of integers, numbers and words, such as `2/1/0`; the last may be left out.
fn counts(word: &[u8]) -> Option<[usize; 3]> {
    let mut parts = word.split(|&b| b == b'/');
    let mut next = || parts.next().map(|part| parse_integer(part).and_then(|n| usize::try_from(n).ok()));
    let counts = [next()??, next()??, next().unwrap_or(Some(0))?];
    parts.next().is_none().then_some(counts)
}

impl Values {
    fn read<'a>(
        name: String,
        counts: Option<[usize; 3]>,
        mut rest: impl Iterator<Item = &'a [u8]>,
    ) -> Result<Self, String> {
        let Some([integers, numbers, texts]) = counts else {
            return Err(format!("{name} tag without counts such as 2/1/0"));
        };
        let mut values = Self { name, integers: Vec::new(), numbers: Vec::new(), words: Vec::new() };
        let names_vertices = values.name == "crease" || values.name == "corner";
        for word in rest.by_ref().take(integers) {
            let integer = parse_integer(word).filter(|i| !names_vertices || VERTEX_INDICES.contains(i));
            let what = if names_vertices { "a vertex" } else { "an integer" };
            values.integers.push(integer.ok_or_else(|| values.wrong(word, what))?);
        }
        for word in rest.by_ref().take(numbers) {
            let number = parse_float(word).filter(|s| *s >= 0.0);
            values.numbers.push(number.ok_or_else(|| values.wrong(word, "a sharpness"))?);
        }
        values.words.extend(rest.by_ref().take(texts).map(quote));
        let found = [values.integers.len(), values.numbers.len(), values.words.len()];
        if found != [integers, numbers, texts] {
            return Err(format!(
                "{} tag has fewer values than its counts {integers}/{numbers}/{texts}",
                values.name
            ));
        }
        match rest.next() {
            Some(word) => Err(format!("{} tag: '{}' is more than its counts say", values.name, quote(word))),
            None => Ok(values),
        }
    }

    fn wrong(&self, word: &[u8], what: &str) -> String {
        format!("{} tag: '{}' is not {what}", self.name, quote(word))
    }

    fn expected(&self, what: &str) -> String {
        let found = [
            self.integers.iter().map(i64::to_string).collect::<Vec<_>>(),
            self.numbers.iter().map(f32::to_string).collect(),
            self.words.clone(),
        ];
        let counts = found.iter().map(|list| list.len().to_string()).collect::<Vec<_>>().join("/");
        format!("{} tag has '{counts}' and '{}', expected {what}", self.name, found.concat().join(" "))
    }

    /// Vertices, counted from 0, and one sharpness for each target: `spare` fewer than vertices.
    fn sharpness(&self, spare: usize) -> Result<(Vec<u32>, Vec<f32>), String> {
        let vertices: Vec<u32> = self.integers.iter().map(|&v| v as u32).collect();
        let targets = vertices.len().saturating_sub(spare);
        let sharpness = match self.numbers[..] {
            [s] => vec![s; targets],
            _ => self.numbers.clone(),
        };
        if targets == 0 || sharpness.len() != targets {
            let (vertices, numbers) = (vertices.len(), self.numbers.len());
            return Err(format!("{} tag with {vertices} vertices and {numbers} numbers", self.name));
        }
        Ok((vertices, sharpness))
    }
}

#[cfg(test)]
mod tests {
    use super::super::obj;
    use super::*;

    const TRIANGLE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nf 1 2 3\n";
    const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

    fn polygons(mesh: &str, tags: &str) -> Result<PolygonMesh, ContentError> {
        obj::parse(format!("{mesh}{tags}").as_bytes()).and_then(obj::Obj::into_polygons)
    }

    #[test]
    fn tags_are_read_from_comments_and_statements() {
        let text = "#t crease 2/1/0 0 1 2.5\nt corner 2/2/0 0 2 1 0\nt crease 3/2/0 0 1 2 1 3\n\
                    t interpolateboundary 1/0/0 1\n#t creasemethod 0/0/1 chaikin\n# t\n#t \n#t he best\n#total 5/5/5\n";
        let mesh = polygons(TRIANGLE, text).unwrap();
        assert_eq!(mesh.creases, [([0, 1], 2.5), ([0, 1], 1.0), ([1, 2], 3.0)]);
        assert_eq!(mesh.sharp_vertices, [(0, 1.0)]);
        assert_eq!(mesh.boundary, BoundaryRule::EdgeAndCorner);
        assert_eq!(mesh.crease_method, CreaseMethod::Chaikin);
    }

    #[test]
    fn rules_have_the_numbers_of_the_format() {
        let rules = |tags: &str| polygons(TRIANGLE, tags).map(|m| (m.boundary, m.crease_method)).unwrap();
        let absent = (BoundaryRule::EdgeOnly, CreaseMethod::Uniform);
        assert_eq!(rules(""), absent);
        assert_eq!(rules("t interpolateboundary 1/0/0 2\nt creasemethod 0/0/1 normal\n"), absent);
        assert_eq!(rules("t interpolateboundary 1/0/0 1\n").0, BoundaryRule::EdgeAndCorner);
        assert_eq!(
            rules("t interpolateboundary 1/0/0 1\nt interpolateboundary 1/0 1\n").1,
            CreaseMethod::Uniform
        );
        assert_eq!(rules("t facevaryinginterpolateboundary 1/0/0 1\n"), absent);
        // Rule 0 is about boundaries alone.
        assert_eq!(polygons(TETRAHEDRON, "t interpolateboundary 1/0/0 0\n").unwrap().boundary, absent.0);
    }

    #[test]
    fn what_is_wrong_or_not_implemented_is_an_error_of_its_line() {
        let cases = [
            ("t creasemethod 0/0/1 foo", "'foo', expected '0/0/1' and 'normal' or 'chaikin'"),
            ("#t creasemethod 0/0/1 foo", "'foo', expected"),
            ("t creasemethod 1/0/0 1", "'1/0/0' and '1', expected '0/0/1'"),
            ("t creasemethod 0/0/1", "fewer values than its counts 0/0/1"),
            ("t creasemethod chaikin", "without counts"),
            ("t interpolateboundary 1/0/0 3", "'3', expected '1/0/0' and 0, 1 or 2"),
            ("t interpolateboundary 1/0/0 -1", "expected"),
            ("t interpolateboundary 1/0/0 1.5", "'1.5' is not an integer"),
            ("t interpolateboundary 1/0/0", "fewer values"),
            ("t interpolateboundary 1/0/0 1 2", "'2' is more than its counts say"),
            ("t interpolateboundary 1/0/0 0", "edge 0-1 (from 0) is a boundary"),
            ("t crease 2/1/0 0 1 -2", "'-2' is not a sharpness"),
            ("t crease 2/1/0 0 1 nan", "'nan' is not a sharpness"),
            ("t crease 2/1/0 0 x 2", "'x' is not a vertex"),
            ("t crease 2/1/0 -1 1 2", "'-1' is not a vertex"),
            ("t crease 1/1/0 0 2", "1 vertices and 1 numbers"),
            ("t crease 3/3/0 0 1 2 1 1 1", "3 vertices and 3 numbers"),
            ("t corner 1/0/0 0", "1 vertices and 0 numbers"),
            ("t hole 1/0/0 0", "tag 'hole' is not implemented"),
            ("#t hole 1/0/0 0", "tag 'hole' is not implemented"),
            ("t vertexedit 2/3/3 0 1 0 0 0 a b c", "tag 'vertexedit' is not implemented"),
            ("t facevaryinginterpolateboundary 1/0/0 2", "2 is not implemented, 1 is"),
            ("t", "tag '' is not implemented"),
        ];
        for (tag, part) in cases {
            let Err(ContentError::Line(line, message)) = polygons(TRIANGLE, &format!("{tag}\n")) else {
                panic!("{tag} is no error of a line");
            };
            assert!(line == 5 && message.contains(part), "{tag}: {line}: {message}");
        }
        let twice = "t creasemethod 0/0/1 normal\nt creasemethod 0/0/1 chaikin\n";
        let error = polygons(TRIANGLE, twice).unwrap_err();
        assert!(matches!(error, ContentError::Line(6, m) if m.contains("differs from that of line 5")));
        let far = polygons(TRIANGLE, "t corner 1/1/0 3 1\n").unwrap_err();
        assert!(matches!(far, ContentError::Content(m) if m.contains("vertex 3")));
        // Triangles as they are need no tag.
        let plain = format!("{TRIANGLE}t hole 1/0/0 0\n");
        assert!(obj::parse(plain.as_bytes()).and_then(obj::Obj::into_triangles).is_ok());
    }
}
