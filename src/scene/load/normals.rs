//! Vertex normals that are none: what a file says wrongly at one vertex stays at that vertex.

use glam::{DVec3, Vec3};

use crate::scene::Mesh;

/// Vertices whose normals have no direction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Lost {
    /// The first of them.
    pub(super) first: usize,
    pub(super) count: usize,
    /// Of all vertices.
    pub(super) all: bool,
}

/// What became of the triangles at these vertices, for warnings.
impl std::fmt::Display for Lost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { first, count, all } = *self;
        let faces = "the triangles there have their faces' own";
        match count {
            1 => write!(f, "the normal of vertex {first} has no direction; {faces}"),
            _ if all => write!(f, "no normal has a direction; every face has its own"),
            _ => write!(
                f,
                "{count} normals, the first of vertex {first}, have no direction; {faces}"
            ),
        }
    }
}

/// Gives `mesh` these unit normals, one a vertex; `None` has no direction. Triangles at such a
/// vertex get three corners of their own, with the face's normal on the side of the corners that
/// have one; where none has, `turned` says whether the face's own is turned around. All other
/// triangles keep their corners.
pub(super) fn set(mesh: &mut Mesh, normals: Vec<Option<Vec3>>, turned: bool) -> Option<Lost> {
    debug_assert_eq!(normals.len(), mesh.positions.len());
    let count = normals.iter().filter(|n| n.is_none()).count();
    let first = normals.iter().position(Option::is_none);
    if count == normals.len() {
        mesh.normals = Vec::new();
        return first.map(|first| Lost { first, count, all: true });
    }
    // What no triangle reads any more has to be a unit vector all the same.
    mesh.normals = normals.iter().map(|n| n.unwrap_or(Vec3::Z)).collect();
    let first = first?;
    for i in 0..mesh.triangles.len() {
        let corners = mesh.triangles[i].map(|corner| corner as usize);
        if corners.iter().all(|corner| normals[*corner].is_some()) {
            continue;
        }
        let p = corners.map(|corner| mesh.positions[corner].as_dvec3());
        let face = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or(DVec3::Z);
        let side: f64 =
            corners.iter().filter_map(|c| normals[*c]).map(|n| n.as_dvec3().dot(face)).sum();
        let away = if side == 0.0 { turned } else { side < 0.0 };
        let normal = if away { -face } else { face }.as_vec3();
        let start = mesh.positions.len() as u32;
        for corner in corners {
            mesh.positions.push(mesh.positions[corner]);
            mesh.normals.push(normal);
            if let Some(uv) = mesh.uvs.get(corner).copied() {
                mesh.uvs.push(uv);
            }
        }
        mesh.triangles[i] = [start, start + 1, start + 2];
    }
    Some(Lost { first, count, all: false })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;

    #[test]
    fn one_normal_without_a_direction_flattens_the_triangles_at_its_vertex_and_no_other() {
        // A fan around vertex 0 of four triangles; vertex 4 has no normal.
        let mut mesh = Mesh {
            positions: [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]
                .map(|[x, y]| Vec3::new(x, y, 0.0))
                .to_vec(),
            normals: Vec::new(),
            uvs: (0..5).map(|i| Vec2::splat(i as f32)).collect(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 1]],
        };
        let tilted = Vec3::new(0.6, 0.0, -0.8);
        let normals = vec![Some(tilted), Some(-Vec3::Z), Some(-Vec3::Z), Some(tilted), None];
        let lost = set(&mut mesh, normals, false);
        assert_eq!(lost, Some(Lost { first: 4, count: 1, all: false }));
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3], [5, 6, 7], [8, 9, 10]]);
        assert_eq!(mesh.normals[..4], [tilted, -Vec3::Z, -Vec3::Z, tilted]);
        assert_eq!(mesh.normals[5..], [-Vec3::Z; 6], "on the side of the corners that have one");
        assert_eq!(mesh.positions[5..8], [0, 3, 4].map(|i: usize| mesh.positions[i]));
        assert_eq!(mesh.uvs[8..], [0.0, 4.0, 1.0].map(Vec2::splat));
        assert_eq!(
            lost.map(|l| l.to_string()).as_deref(),
            Some(
                "the normal of vertex 4 has no direction; the triangles there have their faces' own"
            )
        );
    }

    #[test]
    fn where_no_corner_tells_the_side_the_faces_own_is_turned_or_not() {
        for turned in [false, true] {
            let mut mesh = Mesh {
                positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z],
                triangles: vec![[0, 1, 2]],
                ..Mesh::default()
            };
            let lost = set(&mut mesh, vec![None, None, None, Some(Vec3::X)], turned).unwrap();
            assert_eq!((lost.first, lost.count, lost.all), (0, 3, false));
            assert_eq!(mesh.normals[4..], [if turned { -Vec3::Z } else { Vec3::Z }; 3]);
            let lost = set(&mut mesh, vec![None; 7], turned).unwrap();
            assert!(lost.all && mesh.normals.is_empty());
        }
    }
}
