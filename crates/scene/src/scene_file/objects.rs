//! `[materials]`, `[meshes]` and `[[objects]]`.

use super::fields::{FieldError, Fields, Value};
use super::placement;
use crate::generate::{GenerateError, ParameterValue, Parameters, generate};
use crate::mesh_file::{read_mesh, read_polygons};
use crate::scene::{Instance, Material, NamedMesh, Subdivision, SubdivisionRate};
use std::collections::{HashMap, HashSet};
use std::path::Path;
use toml::de::DeValue;
use umbrage_geom::glam::Affine3A;
use umbrage_geom::mesh::MAX_COORDINATE;
use umbrage_geom::{BoundaryRule, CreaseMethod, PolygonMesh, TriangleMesh};

/// Most times that `subdivide` halves a face.
const MAX_SURFACE_LEVEL: u32 = 12;

/// Most triangles over all instances, so that counts and bounds of a scene stay sane.
const MAX_SCENE_INSTANCES: usize = 1 << 22;

/// What the geometry part of a file says.
#[derive(Default)]
pub(super) struct Geometry {
    pub(super) meshes: Vec<NamedMesh>,
    pub(super) instances: Vec<Instance>,
    pub(super) materials: Vec<Material>,
    material_indices: HashMap<String, usize>,
    mesh_indices: HashMap<String, usize>,
    /// Names that objects were given, which defaults must avoid.
    given_names: HashSet<String>,
    names: HashSet<String>,
}

/// Reads materials, meshes and objects; mesh files are relative to `folder`.
pub(super) fn read(top: &Fields<'_>, folder: &Path) -> Result<Geometry, FieldError> {
    let mut geometry = Geometry::default();
    if let Some(materials) = top.table("materials")? {
        for entry in materials.entries() {
            let material = read_material(&entry)?;
            geometry.add_material(material);
        }
    }
    if let Some(meshes) = top.table("meshes")? {
        for entry in meshes.entries() {
            let mesh =
                read_mesh_table(&entry.table(format!("mesh '{}'", entry.key()))?, entry.key(), folder)?;
            geometry.mesh_indices.insert(entry.key().into(), geometry.meshes.len());
            geometry.meshes.push(mesh);
        }
    }
    let objects = top.value("objects").map_or(Ok(Vec::new()), |v| v.items())?;
    if objects.is_empty() {
        return Err(top.flaw("there are no objects: add [[objects]]"));
    }
    let mut tables = Vec::new();
    for (i, object) in objects.iter().enumerate() {
        let mut fields = object.table(format!("object {}", i + 1))?;
        if let Some(name) = fields.value("name") {
            let text = name.text()?;
            if !geometry.given_names.insert(text.into()) {
                return Err(name.flaw(format!("'{text}' is taken by another object")));
            }
            fields.what = format!("object '{text}'");
        }
        tables.push(fields);
    }
    for fields in &tables {
        geometry.add_object(fields, folder)?;
        fields.finish()?;
    }
    Ok(geometry)
}

fn read_material(entry: &Value<'_>) -> Result<Material, FieldError> {
    let fields = entry.table(format!("material '{}'", entry.key()))?;
    let mut material = Material { name: entry.key().into(), ..Material::default() };
    if let Some(albedo) = fields.value("albedo") {
        material.albedo = albedo.color()?;
        if material.albedo.iter().any(|&x| x > 1.0) {
            return Err(albedo.flaw("must be between 0 and 1"));
        }
    }
    if let Some(opacity) = fields.value("opacity") {
        material.opacity = opacity.number_in(0.0..=1.0)?;
    }
    fields.finish()?;
    Ok(material)
}

/// A table with `file`, or with `generator` and its parameters, and perhaps `subdivide`.
fn read_mesh_table(fields: &Fields<'_>, name: &str, folder: &Path) -> Result<NamedMesh, FieldError> {
    let subdivide = fields.value("subdivide");
    let surface = subdivide.as_ref().map(read_subdivide).transpose()?;
    let (mesh, control) = match (fields.value("file"), fields.value("generator")) {
        (Some(file), None) => {
            let read = match &surface {
                Some(_) => read_control_file(&file, folder)?,
                None => (read_mesh_file(&file, folder)?, None),
            };
            fields.finish()?;
            read
        }
        (None, Some(generator)) => generated(fields, &generator)?,
        _ => return Err(fields.flaw("needs either 'file' or 'generator'")),
    };
    let subdivision = match (surface, control, subdivide) {
        (Some(surface), Some(control), _) => Some(surface.of(control)),
        (Some(_), None, Some(key)) => return Err(key.flaw("needs a generator of control meshes")),
        _ => None,
    };
    Ok(NamedMesh { name: name.into(), mesh, subdivision })
}

/// What `subdivide` says. Rules that it does not name are those of the control mesh.
#[derive(Default)]
struct Subdivide {
    rate: SubdivisionRate,
    boundary: Option<BoundaryRule>,
    creases: Option<CreaseMethod>,
}

impl Subdivide {
    fn of(self, mut control: PolygonMesh) -> Subdivision {
        control.boundary = self.boundary.unwrap_or(control.boundary);
        control.crease_method = self.creases.unwrap_or(control.crease_method);
        Subdivision::new(control, self.rate)
    }
}

/// `subdivide`: a length in pixels, or a table.
fn read_subdivide(value: &Value<'_>) -> Result<Subdivide, FieldError> {
    let mut surface = Subdivide::default();
    match value.raw() {
        DeValue::Integer(_) | DeValue::Float(_) => surface.rate = SubdivisionRate::Pixels(value.positive()?),
        DeValue::Table(_) => {
            let fields = value.table("subdivide")?;
            match (fields.value("pixels"), fields.value("level")) {
                (Some(_), Some(_)) => return Err(fields.flaw("takes 'pixels' or 'level', not both")),
                (Some(pixels), None) => surface.rate = SubdivisionRate::Pixels(pixels.positive()?),
                (None, Some(level)) => {
                    surface.rate = SubdivisionRate::Level(level.whole(0..=MAX_SURFACE_LEVEL)? as u8);
                }
                (None, None) => {}
            }
            if let Some(boundary) = fields.value("boundary") {
                surface.boundary = Some(match boundary.text()? {
                    "edge-only" => BoundaryRule::EdgeOnly,
                    "edge-and-corner" => BoundaryRule::EdgeAndCorner,
                    _ => return Err(boundary.expected("'edge-only' or 'edge-and-corner'")),
                });
            }
            if let Some(creases) = fields.value("creases") {
                surface.creases = Some(match creases.text()? {
                    "uniform" => CreaseMethod::Uniform,
                    "chaikin" => CreaseMethod::Chaikin,
                    _ => return Err(creases.expected("'uniform' or 'chaikin'")),
                });
            }
            fields.finish()?;
        }
        _ => return Err(value.expected("a length in pixels or a table")),
    }
    Ok(surface)
}

fn read_mesh_file(file: &Value<'_>, folder: &Path) -> Result<TriangleMesh, FieldError> {
    let path = folder.join(file.text()?);
    read_mesh(&path).map_err(|e| file.flaw(format!("can't be used: {e}")))
}

/// Polygons, and their fans.
fn read_control_file(
    file: &Value<'_>,
    folder: &Path,
) -> Result<(TriangleMesh, Option<PolygonMesh>), FieldError> {
    let path = folder.join(file.text()?);
    let control = read_polygons(&path).map_err(|e| file.flaw(format!("can't be used: {e}")))?;
    let mesh = control.triangulate();
    let mesh = mesh.map_err(|e| file.flaw(format!("can't be used: {}: {e}", path.display())))?;
    Ok((mesh, Some(control)))
}

fn generated(
    fields: &Fields<'_>,
    generator: &Value<'_>,
) -> Result<(TriangleMesh, Option<PolygonMesh>), FieldError> {
    let mut parameters = Parameters::default();
    fields.whole_into("seed", 0..=u32::MAX, &mut parameters.seed)?;
    if let Some(triangles) = fields.value("triangles") {
        parameters.triangles = Some(triangles.whole(1..=u32::MAX)? as usize);
    }
    parameters.level = fields.value("level").map(|v| v.whole(0..=32)).transpose()?;
    for other in fields.others() {
        let value = match other.raw() {
            DeValue::String(text) => ParameterValue::Text(text.clone().into_owned()),
            DeValue::Integer(_) | DeValue::Float(_) => ParameterValue::Number(other.double()?),
            _ => return Err(other.expected("a number or a word")),
        };
        parameters.values.insert(other.key().into(), value);
    }
    match generate(generator.text()?, &parameters) {
        Ok(generated) => Ok((generated.mesh, generated.control)),
        Err(error) => {
            let culprit = match &error {
                GenerateError::UnknownParameter { parameter, .. }
                | GenerateError::OutOfRange { parameter, .. } => &parameter[..],
                _ => "generator",
            };
            let span = fields.key_span(culprit).unwrap_or_else(|| generator.span());
            Err(FieldError::new(span, format!("{}: {error}", fields.what)))
        }
    }
}

impl Geometry {
    fn add_material(&mut self, material: Material) {
        self.material_indices.insert(material.name.clone(), self.materials.len());
        self.materials.push(material);
    }

    fn add_object(&mut self, fields: &Fields<'_>, folder: &Path) -> Result<(), FieldError> {
        let mesh = self.object_mesh(fields, folder)?;
        let materials = self.object_materials(fields, mesh)?;
        let transforms = placement::read(fields)?;
        let name = match fields.value("name") {
            Some(name) => name.text()?.to_string(),
            None => self.default_name(mesh),
        };
        if self.instances.len() + transforms.len() > MAX_SCENE_INSTANCES {
            return Err(fields.flaw(format!("the scene has more than {MAX_SCENE_INSTANCES} instances")));
        }
        let bounds = self.meshes[mesh].mesh.bounds();
        for (i, world_from_object) in transforms.iter().enumerate() {
            if !crate::view::corners(bounds).iter().all(|c| stays_near(world_from_object, *c)) {
                return Err(fields.flaw(format!("its transform moves it beyond {MAX_COORDINATE:e}")));
            }
            let name = if transforms.len() == 1 { name.clone() } else { format!("{name}[{i}]") };
            if !self.names.insert(name.clone()) {
                return Err(fields.flaw(format!("the name '{name}' of its instance is taken")));
            }
            let materials = materials.clone();
            self.instances.push(Instance { name, mesh, world_from_object: *world_from_object, materials });
        }
        Ok(())
    }

    /// Index of the mesh an object names or brings along.
    fn object_mesh(&mut self, fields: &Fields<'_>, folder: &Path) -> Result<usize, FieldError> {
        let mesh = fields.required("mesh")?;
        let inline = match mesh.raw() {
            DeValue::String(name) => {
                return self.mesh_indices.get(&name[..]).copied().ok_or_else(|| {
                    let known = list(self.meshes.iter().map(|m| &m.name[..]));
                    mesh.flaw(format!("'{name}' is not one of the meshes ({known})"))
                });
            }
            DeValue::Table(_) => mesh.table(format!("{} mesh", fields.what))?,
            _ => return Err(mesh.expected("the name of a mesh, or a table with 'file' or 'generator'")),
        };
        let source = inline.value("file").or_else(|| inline.value("generator"));
        let stem = match &source {
            Some(source) => Path::new(source.text()?).file_stem().and_then(|s| s.to_str()).unwrap_or("mesh"),
            None => "mesh",
        };
        let name = first_free(stem, |name| self.mesh_indices.contains_key(name));
        let mesh = read_mesh_table(&inline, &name, folder)?;
        let index = self.meshes.len();
        self.mesh_indices.insert(name, index);
        self.meshes.push(mesh);
        Ok(index)
    }

    fn default_name(&self, mesh: usize) -> String {
        let taken = |name: &str| {
            self.given_names.contains(name)
                || self.names.contains(name)
                || self.names.contains(&format!("{name}[0]"))
        };
        first_free(&self.meshes[mesh].name, taken)
    }

    /// One material for each object of the mesh: the one `materials` gives it, else `material`, else the default.
    fn object_materials(&mut self, fields: &Fields<'_>, mesh: usize) -> Result<Vec<usize>, FieldError> {
        let parts = self.meshes[mesh].mesh.objects_or_whole();
        let mut chosen: Vec<Option<usize>> = match fields.value("material") {
            Some(value) => vec![Some(self.material(&value)?); parts.len()],
            None => vec![None; parts.len()],
        };
        if let Some(table) = fields.table("materials")? {
            for entry in table.entries() {
                let entry_material = self.material(&entry)?;
                let mut found = false;
                for (slot, _) in chosen.iter_mut().zip(&parts).filter(|(_, part)| part.name == entry.key()) {
                    *slot = Some(entry_material);
                    found = true;
                }
                if !found {
                    let known = list(parts.iter().map(|p| &p.name[..]));
                    let span = table.key_span(entry.key()).unwrap_or_else(|| entry.span());
                    let message =
                        format!("{}: its mesh has no object '{}' ({known})", fields.what, entry.key());
                    return Err(FieldError::new(span, message));
                }
            }
        }
        let needs_default = chosen.contains(&None);
        if needs_default && !self.material_indices.contains_key(&Material::default().name) {
            self.add_material(Material::default());
        }
        let default = self.material_indices.get(&Material::default().name).copied();
        Ok(chosen.into_iter().filter_map(|m| m.or(default)).collect())
    }

    fn material(&self, value: &Value<'_>) -> Result<usize, FieldError> {
        let name = value.text()?;
        self.material_indices.get(name).copied().ok_or_else(|| {
            let known = list(self.materials.iter().map(|m| &m.name[..]));
            value.flaw(format!("'{name}' is not one of the materials ({known})"))
        })
    }
}

fn stays_near(world_from_object: &Affine3A, corner: umbrage_geom::glam::Vec3) -> bool {
    world_from_object.transform_point3(corner).abs().max_element() <= MAX_COORDINATE
}

/// `stem`, or `stem-2` and so on.
fn first_free(stem: &str, taken: impl Fn(&str) -> bool) -> String {
    if !taken(stem) {
        return stem.into();
    }
    (2..).map(|i| format!("{stem}-{i}")).find(|name| !taken(name)).unwrap_or_default()
}

/// Names for an error, not too many.
fn list<'a>(names: impl Iterator<Item = &'a str>) -> String {
    const MAX_NAMES: usize = 12;
    let names: Vec<_> = names.collect();
    match names.len() {
        0 => "there are none".into(),
        n if n > MAX_NAMES => format!("{} and {} more", names[..MAX_NAMES].join(", "), n - MAX_NAMES),
        _ => names.join(", "),
    }
}
