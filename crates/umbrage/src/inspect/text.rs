//! Reports as text.

use super::{BoundsReport, EdgeReport, LightReport, MeshReport, SceneReport, SolidReport};
use std::fmt;

/// Instances that the text lists.
const MAX_LISTED_INSTANCES: usize = 20;

/// Bytes in units that are easy to read.
fn memory(bytes: u64) -> String {
    let units = ["KiB", "MiB", "GiB", "TiB"];
    if bytes < 1024 {
        return format!("{bytes} bytes");
    }
    let unit = ((bytes.ilog2() / 10) as usize).min(units.len());
    format!("{:.1} {}", bytes as f64 / 1024f64.powi(unit as i32), units[unit - 1])
}

impl fmt::Display for BoundsReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ([a, b, c], [x, y, z]) = (self.min, self.max);
        write!(f, "({a}, {b}, {c}) to ({x}, {y}, {z}), diagonal {}", self.diagonal as f32)
    }
}

impl fmt::Display for EdgeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.closed() {
            return write!(f, "closed, {} edges", self.edges);
        }
        write!(f, "not closed, {} edges", self.edges)?;
        for (count, what) in [
            (self.boundary, "at a boundary"),
            (self.non_manifold, "of more than two triangles"),
            (self.inconsistent, "with opposite orientations"),
        ] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for SolidReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match (self.well_behaved, self.encloses) {
            (true, _) => "well behaved",
            (_, true) if self.self_intersections > 0 => "encloses space, but cuts itself",
            (_, true) => "encloses space once some triangles are turned",
            _ => "encloses nothing",
        })?;
        write!(f, ", {} components", self.components)?;
        for (count, what) in [(self.inwards, "inside out"), (self.one_sided, "with one side")] {
            if count > 0 {
                write!(f, ", {count} {what}")?;
            }
        }
        let pair = |[a, b]: [u32; 2]| format!("{a}-{b}");
        for (what, examples) in [
            ("edges at a boundary", &self.boundary_examples),
            ("edges of more than two triangles", &self.non_manifold_examples),
            ("edges with opposite orientations", &self.inconsistent_examples),
            ("triangles that meet", &self.intersection_examples),
        ] {
            if !examples.is_empty() {
                write!(f, "; {what}")?;
                write_examples(f, examples, examples.len() as u64, pair)?;
            }
        }
        Ok(())
    }
}

impl fmt::Display for MeshReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let attributes = match (self.normals, self.uvs) {
            (true, true) => "normals and texture coordinates",
            (true, false) => "normals",
            (false, true) => "texture coordinates",
            (false, false) => "positions only",
        };
        writeln!(f, "triangles   {}", self.triangles)?;
        writeln!(f, "vertices    {}, {attributes}", self.vertices)?;
        writeln!(f, "memory      {}", memory(self.bytes))?;
        writeln!(f, "bounds      {}", self.bounds)?;
        if let (Some(shortest), Some(longest)) = (self.shortest_edge, self.longest_edge) {
            writeln!(f, "edges       {shortest:.6} to {longest:.6} long")?;
        }
        writeln!(f, "surface     {}", self.edges)?;
        write!(f, "degenerate  {} triangles", self.degenerate_triangles)?;
        write_examples(f, &self.degenerate_examples, self.degenerate_triangles, |t| t.to_string())?;
        write!(f, "\nduplicate   {} triangles", self.duplicate_triangles)?;
        write_examples(f, &self.duplicate_examples, self.duplicate_triangles, |[first, again]| {
            format!("{again} repeats {first}")
        })?;
        write!(f, ", {} vertices", self.duplicate_vertices)?;
        write!(f, "\nunused      {} vertices", self.unused_vertices)?;
        if let [object] = &self.objects[..] {
            write!(f, "\nsolid       {}", object.solid)?;
        }
        if self.objects.len() > 1 || self.objects.iter().any(|o| !o.name.is_empty() || o.opacity != 1.0) {
            write!(f, "\nobjects     {}", self.objects.len())?;
            for object in &self.objects {
                let name = if object.name.is_empty() { "(unnamed)" } else { &object.name };
                write!(f, "\n  {name}: {} triangles, opacity {}, ", object.triangles, object.opacity)?;
                write!(f, "{}, {}", object.edges, object.bounds)?;
                if object.degenerate_triangles > 0 {
                    write!(f, ", {} degenerate", object.degenerate_triangles)?;
                }
                if self.objects.len() > 1 {
                    write!(f, "; {}", object.solid)?;
                }
            }
        }
        Ok(())
    }
}

fn write_examples<T: Copy>(
    f: &mut fmt::Formatter<'_>,
    examples: &[T],
    count: u64,
    text: impl Fn(T) -> String,
) -> fmt::Result {
    if examples.is_empty() {
        return Ok(());
    }
    let shown: Vec<String> = examples.iter().map(|&e| text(e)).collect();
    let more = if count > examples.len() as u64 { ", ..." } else { "" };
    write!(f, " ({}{more})", shown.join(", "))
}

impl fmt::Display for SceneReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let LightReport { area, point, directional, ambient } = self.lights;
        writeln!(f, "triangles   {} stored, {} with instances", self.triangles, self.instanced_triangles)?;
        writeln!(f, "memory      {}", memory(self.bytes))?;
        writeln!(f, "bounds      {}", self.bounds)?;
        writeln!(f, "materials   {}", self.materials)?;
        let sky = if ambient { ", constant sky" } else { "" };
        write!(f, "lights      {area} area, {point} point, {directional} directional{sky}")?;
        for named in &self.meshes {
            write!(f, "\nmesh {}", named.name)?;
            for line in named.mesh.to_string().lines() {
                write!(f, "\n  {line}")?;
            }
        }
        write!(f, "\ninstances   {}", self.instances.len())?;
        for instance in self.instances.iter().take(MAX_LISTED_INSTANCES) {
            let mirrored = if instance.mirrored { ", mirrored" } else { "" };
            write!(f, "\n  {}: mesh {}, {} triangles, ", instance.name, instance.mesh, instance.triangles)?;
            write!(f, "{}{mirrored}, materials {}", instance.bounds, instance.materials.join(", "))?;
        }
        match self.instances.len().saturating_sub(MAX_LISTED_INSTANCES) {
            0 => Ok(()),
            more => write!(f, "\n  and {more} more (all are in the JSON)"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_has_units() {
        assert_eq!([0, 1023, 1024, 3 << 20].map(memory), ["0 bytes", "1023 bytes", "1.0 KiB", "3.0 MiB"]);
    }
}
