//! `Shape`: triangles, spheres, disks, placed or baked into world space.
//!
//! pbrt's normal of a surface is that of its own space, carried along by the transformation and
//! turned by `ReverseOrientation`. A mesh that is baked by a mirroring transformation therefore
//! gets `reverse_orientation` once more, since its winding is mirrored too; one that is placed by
//! its instance does not. Vertex normals are stored as pbrt uses them: already turned by
//! `ReverseOrientation`.

use std::f64::consts::{PI, TAU};
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec2, Vec3};

use super::light::emits;
use super::motion::similarity;
use super::params::{Params, Type};
use super::{Builder, Part, Surface, about_file, shorten};
use crate::error::{Result, suggest};
use crate::scene::load::{normals, ply};
use crate::scene::{Geometry, Mesh, Object, Scalar, Shape, Transform};

const KINDS: [&str; 5] = ["trianglemesh", "plymesh", "sphere", "disk", "bilinearmesh"];

/// Segments of a full circle where a sphere or a disk has to be turned into triangles.
const SEGMENTS: usize = 96;

impl Builder {
    pub(super) fn make_shape(&mut self, kind: &str, params: &Params) -> Result<()> {
        params.ignore_with(
            &["displacement", "displacement.edgelength"],
            "the surface stays smooth",
            &mut self.warnings,
        );
        params.ignore(&["displacement.uvscale"]);
        let geometry = match kind {
            "trianglemesh" => Geometry::Mesh(Arc::new(triangle_mesh(params)?)),
            "plymesh" => Geometry::Mesh(Arc::new(self.ply_mesh(params)?)),
            "bilinearmesh" => Geometry::Mesh(Arc::new(self.bilinear_mesh(params)?)),
            "sphere" => sphere(params)?,
            "disk" => self.disk(params)?,
            other => {
                return params.place.unsupported(format!(
                    "Shape \"{}\"; {}",
                    shorten(other),
                    suggest(&shorten(other), &KINDS)
                ));
            }
        };
        let alpha = match self.scalar(params, "alpha", 1.0)? {
            Scalar::Constant(value) if !(0.0..=1.0).contains(&value) => {
                return params
                    .param_place("alpha")
                    .invalid(format!("`alpha` is {value}; allowed: 0 to 1"));
            }
            Scalar::Constant(1.0) => None,
            alpha => Some(alpha),
        };
        let material = match self.state.surface {
            Surface::Material(id) => id,
            Surface::Default => self.default_material(),
            Surface::Interface => {
                if self.state.area_light.is_some() {
                    self.warnings.add(format!(
                        "{}: the area light is ignored: its surface is an interface",
                        params.place
                    ));
                }
                return Ok(());
            }
        };
        let emission = match self.state.area_light.clone() {
            Some(light) => Some(self.emission(&light)?).filter(|e| emits(&self.scene, e)),
            None => None,
        };
        let reverse_orientation = self.state.reverse_orientation;
        let shape = Shape { geometry, material, emission, alpha, reverse_orientation };
        self.place_shape(shape, params)
    }

    fn place_shape(&mut self, mut shape: Shape, params: &Params) -> Result<()> {
        let ctm = self.state.ctm;
        let mut to_parent = self.placement(ctm, &params.place)?;
        if !matches!(shape.geometry, Geometry::Mesh(_))
            && ctm.ends.iter().any(|end| similarity(end.matrix3).is_none())
        {
            let warning = format!(
                "{}: {} is stretched by its transformation: triangles take its place",
                params.place, params.owner
            );
            self.warnings.add(warning);
            shape.geometry = Geometry::Mesh(Arc::new(tessellate(&shape.geometry)));
        }
        if !ctm.moves() {
            bake(&mut shape, ctm.ends[0]);
            to_parent = Transform::IDENTITY;
        }
        if let Geometry::Mesh(mesh) = &shape.geometry {
            if mesh.triangles.is_empty() {
                self.warnings.add(format!(
                    "{}: {} has no triangles and is left out",
                    params.place, params.owner
                ));
                return Ok(());
            }
            if mesh.positions.iter().any(|p| !p.is_finite()) {
                return params.place.invalid(format!(
                    "{} has a vertex beyond single precision; allowed: finite ones",
                    params.owner
                ));
            }
        }
        if let Some(lost) = shape.set_normals(self.state.reverse_orientation) {
            let file = params.string("filename")?.map(|f| format!(" of \"{}\"", shorten(f)));
            self.warnings.add(format!(
                "{}: {}{}: {lost}",
                params.place,
                params.owner,
                file.unwrap_or_default()
            ));
        }
        match (&mut self.open_object, ctm.moves()) {
            (Some(open), false) => open.shapes.push(shape),
            (None, false) => self.shapes.push(shape),
            (open, true) => {
                let name = open.as_ref().map(|o| o.name.clone()).unwrap_or_default();
                let object = self.scene.add_object(Object { name, shapes: vec![shape] });
                match open {
                    Some(open) => open.moving.push(Part { object, to_parent }),
                    None => {
                        let key = self.take_key();
                        self.scene.add_instance(object, to_parent, key);
                    }
                }
            }
        }
        Ok(())
    }

    fn ply_mesh(&mut self, params: &Params) -> Result<Mesh> {
        let place = params.param_place("filename").clone();
        let Some(name) = params.string("filename")? else {
            return place.invalid(
                "a plymesh without `filename`; allowed: the name of a .ply or .ply.gz file",
            );
        };
        let path = self.resolve(name, &place);
        let bytes = self.read_beside(&path, name, &place)?;
        let read = ply::from_bytes(&bytes).map_err(|e| about_file(name, &place, e))?;
        for warning in read.warnings {
            self.warnings.add(format!("{place}: \"{}\": {warning}", shorten(name)));
        }
        Ok(read.mesh)
    }

    /// A disk, or the triangles of one with a hole.
    fn disk(&mut self, params: &Params) -> Result<Geometry> {
        let radius = params.positive_or("radius", 1.0)?;
        let height = params.float_or("height", 0.0)?;
        let inner = params.float_or("innerradius", 0.0)?;
        full_circle(params)?;
        let center = Vec3::new(0.0, 0.0, height as f32);
        let whole = Geometry::Disk { center, normal: Vec3::Z, radius: radius as f32 };
        if inner == 0.0 {
            return Ok(whole);
        }
        let place = params.param_place("innerradius");
        if !(0.0..radius).contains(&inner) {
            return place.invalid(format!(
                "`innerradius` is {inner}; allowed: from 0 to below `radius`, {radius}"
            ));
        }
        self.warnings.add(format!("{place}: the disk has a hole: triangles take its place"));
        let mut ring = tessellate(&whole);
        // Two rings of vertices; the second one, all in the centre, becomes the edge of the hole.
        for i in (1..ring.positions.len()).step_by(2) {
            let rim = ring.positions[i - 1] - center;
            ring.positions[i] = center + rim * (inner / radius) as f32;
        }
        let segments = 0..SEGMENTS as u32;
        ring.triangles.extend(segments.map(|i| [2 * i + 2, 2 * i + 3, 2 * i + 1]));
        Ok(Geometry::Mesh(Arc::new(ring)))
    }

    /// Flat patches as two triangles each.
    fn bilinear_mesh(&mut self, params: &Params) -> Result<Mesh> {
        let positions = points(params, "P", &[Type::Point3])?.unwrap_or_default();
        let indices = indices(params, 4, positions.len())?;
        let uvs = pairs(params, "uv")?;
        let normals = points(params, "N", &[Type::Normal])?;
        check_lengths(params, positions.len(), normals.as_deref(), uvs.as_deref())?;
        params.ignore(&["emissionfilename"]);
        let mut mesh = Mesh::default();
        for patch in indices.chunks_exact(4) {
            let corners = [0, 1, 2, 3].map(|i| patch[i] as usize);
            let p = corners.map(|c| positions[c].as_dvec3());
            let (a, b, c) = (p[1] - p[0], p[2] - p[0], p[3] - p[0]);
            // Flat if the fourth corner leaves the plane of the others by less than 10⁻⁴ of the
            // patch's size.
            let size = a.length().max(b.length()).max(c.length());
            if a.cross(b).normalize_or_zero().dot(c).abs() > 1e-4 * size {
                return params.place.unsupported(
                    "a curved patch of a bilinearmesh; allowed: flat ones, trianglemesh, plymesh",
                );
            }
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(corners.map(|c| positions[c]));
            let unit = [Vec2::ZERO, Vec2::X, Vec2::Y, Vec2::ONE];
            mesh.uvs.extend((0..4).map(|i| uvs.as_ref().map_or(unit[i], |uvs| uvs[corners[i]])));
            if let Some(normals) = &normals {
                mesh.normals.extend(corners.map(|c| normals[c]));
            }
            mesh.triangles.extend([[first, first + 1, first + 3], [first, first + 3, first + 2]]);
        }
        self.warnings.add(format!(
            "{}: the flat patches of bilinearmesh become two triangles each",
            params.place
        ));
        Ok(mesh)
    }
}

impl Shape {
    /// Makes vertex normals unit vectors, turned where asked. Triangles at a vertex whose normal
    /// has no direction get their faces' own.
    fn set_normals(&mut self, reverse: bool) -> Option<normals::Lost> {
        let Geometry::Mesh(mesh) = &mut self.geometry else { return None };
        if mesh.normals.is_empty() {
            return None;
        }
        let mesh = Arc::make_mut(mesh);
        let sign = if reverse { -1.0 } else { 1.0 };
        let unit = mesh
            .normals
            .iter()
            .map(|n| n.as_dvec3().try_normalize().map(|n| (sign * n).as_vec3()))
            .collect();
        normals::set(mesh, unit, self.reverse_orientation)
    }
}

fn triangle_mesh(params: &Params) -> Result<Mesh> {
    let Some(positions) = points(params, "P", &[Type::Point3])? else {
        return params
            .place
            .invalid("a trianglemesh without `P`; allowed: \"point3 P\" [ x y z … ]");
    };
    let indices = indices(params, 3, positions.len())?;
    let normals = points(params, "N", &[Type::Normal])?;
    let uvs = pairs(params, "uv")?;
    check_lengths(params, positions.len(), normals.as_deref(), uvs.as_deref())?;
    // Tangents only turn anisotropic highlights; face indices only matter to ptex.
    params.ignore(&["S", "faceIndices"]);
    let triangles = indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect();
    Ok(Mesh {
        positions,
        normals: normals.unwrap_or_default(),
        uvs: uvs.unwrap_or_default(),
        triangles,
    })
}

fn points(params: &Params, name: &'static str, kinds: &[Type]) -> Result<Option<Vec<Vec3>>> {
    let numbers = params.numbers(name, kinds)?;
    Ok(numbers.map(|n| n.chunks_exact(3).map(|p| DVec3::from_slice(p).as_vec3()).collect()))
}

fn pairs(params: &Params, name: &'static str) -> Result<Option<Vec<Vec2>>> {
    let numbers = params.numbers(name, &[Type::Point2, Type::Vector2])?;
    Ok(numbers.map(|n| n.chunks_exact(2).map(|p| Vec2::new(p[0] as f32, p[1] as f32)).collect()))
}

/// `indices`, or 0 1 2 … where a mesh has just one face and needs none.
fn indices(params: &Params, corners: usize, vertices: usize) -> Result<Vec<u32>> {
    let Some(numbers) = params.numbers("indices", &[Type::Integer])? else {
        if vertices == corners {
            return Ok((0..corners as u32).collect());
        }
        return params.place.invalid(format!("{} has {vertices} vertices and no `indices`; allowed: none only for {corners} vertices", params.owner));
    };
    let place = params.param_place("indices");
    if numbers.len() % corners != 0 {
        return place.invalid(format!(
            "`indices` has {} numbers; allowed: a multiple of {corners}",
            numbers.len()
        ));
    }
    if let Some(bad) = numbers.iter().find(|n| !(0.0..vertices as f64).contains(*n)) {
        return place.invalid(format!(
            "`indices` holds {bad}; allowed: 0 to {} ({vertices} vertices)",
            vertices.saturating_sub(1)
        ));
    }
    Ok(numbers.iter().map(|n| *n as u32).collect())
}

fn check_lengths(
    params: &Params,
    vertices: usize,
    normals: Option<&[Vec3]>,
    uvs: Option<&[Vec2]>,
) -> Result<()> {
    for (name, count) in [("N", normals.map(<[Vec3]>::len)), ("uv", uvs.map(<[Vec2]>::len))] {
        if let Some(count) = count.filter(|count| *count != vertices) {
            return params.param_place(name).invalid(format!(
                "`{name}` has {count} values; allowed: one for each of {vertices} vertices"
            ));
        }
    }
    Ok(())
}

fn sphere(params: &Params) -> Result<Geometry> {
    let radius = params.positive_or("radius", 1.0)?;
    for (name, full) in [("zmin", -radius), ("zmax", radius)] {
        let value = params.float_or(name, full)?;
        if value.abs() < radius || value * full < 0.0 {
            return params
                .param_place(name)
                .unsupported(format!("a sphere cut at `{name}` {value}; allowed: a full one"));
        }
    }
    full_circle(params)?;
    Ok(Geometry::Sphere { center: Vec3::ZERO, radius: radius as f32 })
}

fn full_circle(params: &Params) -> Result<()> {
    let degrees = params.float_or("phimax", 360.0)?;
    if degrees >= 360.0 {
        return Ok(());
    }
    params
        .param_place("phimax")
        .unsupported(format!("`phimax` is {degrees}; allowed: 360, the full turn"))
}

/// Moves a shape by a transformation that stays.
fn bake(shape: &mut Shape, by: DAffine3) {
    let normal_matrix = by.matrix3.inverse().transpose();
    let scale = similarity(by.matrix3).unwrap_or(1.0);
    match &mut shape.geometry {
        Geometry::Mesh(mesh) => {
            shape.reverse_orientation ^= by.matrix3.determinant() < 0.0;
            if by != DAffine3::IDENTITY {
                let mesh = Arc::make_mut(mesh);
                for p in &mut mesh.positions {
                    *p = by.transform_point3(p.as_dvec3()).as_vec3();
                }
                for n in &mut mesh.normals {
                    // In f64, so that a scale of 10³⁰ does not overflow on the way.
                    *n = (normal_matrix * n.as_dvec3()).normalize_or_zero().as_vec3();
                }
            }
        }
        Geometry::Sphere { center, radius } => {
            *center = by.transform_point3(center.as_dvec3()).as_vec3();
            *radius = (f64::from(*radius) * scale) as f32;
        }
        Geometry::Disk { center, normal, radius } => {
            *center = by.transform_point3(center.as_dvec3()).as_vec3();
            *normal = (normal_matrix * normal.as_dvec3()).normalize_or_zero().as_vec3();
            *radius = (f64::from(*radius) * scale) as f32;
        }
    }
}

/// A sphere or disk as triangles, with pbrt's texture coordinates.
fn tessellate(geometry: &Geometry) -> Mesh {
    let mut mesh = Mesh::default();
    let angle = |i: usize| TAU * i as f64 / SEGMENTS as f64;
    match geometry {
        Geometry::Mesh(mesh) => return Mesh::clone(mesh),
        Geometry::Sphere { center, radius } => {
            let rows = SEGMENTS / 2;
            for row in 0..=rows {
                // From the south pole upward.
                let theta = PI * (1.0 - row as f64 / rows as f64);
                for i in 0..=SEGMENTS {
                    let (sin_phi, cos_phi) = angle(i).sin_cos();
                    let n = DVec3::new(theta.sin() * cos_phi, theta.sin() * sin_phi, theta.cos());
                    mesh.positions.push((center.as_dvec3() + f64::from(*radius) * n).as_vec3());
                    mesh.normals.push(n.as_vec3());
                    mesh.uvs.push(Vec2::new(i as f32 / SEGMENTS as f32, row as f32 / rows as f32));
                }
            }
            let at = |row: usize, i: usize| (row * (SEGMENTS + 1) + i) as u32;
            for (row, i) in (0..rows).flat_map(|row| (0..SEGMENTS).map(move |i| (row, i))) {
                if row > 0 {
                    mesh.triangles.push([at(row, i), at(row, i + 1), at(row + 1, i + 1)]);
                }
                if row + 1 < rows {
                    mesh.triangles.push([at(row, i), at(row + 1, i + 1), at(row + 1, i)]);
                }
            }
        }
        Geometry::Disk { center, radius, .. } => {
            // Two rings: the centre once a segment, since u differs there.
            for i in 0..=SEGMENTS {
                let (sin_phi, cos_phi) = angle(i).sin_cos();
                let rim =
                    center.as_dvec3() + f64::from(*radius) * DVec3::new(cos_phi, sin_phi, 0.0);
                mesh.positions.extend([rim.as_vec3(), *center]);
                let u = i as f32 / SEGMENTS as f32;
                mesh.uvs.extend([Vec2::new(u, 0.0), Vec2::new(u, 1.0)]);
            }
            mesh.triangles.extend((0..SEGMENTS as u32).map(|i| [2 * i, 2 * i + 2, 2 * i + 1]));
        }
    }
    mesh
}
