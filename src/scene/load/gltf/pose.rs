//! Deformed meshes in their rest pose: morph targets with the weights that the file gives, skins
//! with their joints where the nodes stand. What animations do to either is not followed.

use std::ops::Range;

use glam::{Affine3A, Mat4, Vec3, Vec3A};
use gltf::json::mesh::{Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Index, Root, Skin};

use super::animation;
use super::bytes::Buffers;
use crate::error::{Error, Result};
use crate::scene::Track;

/// How a placed mesh is deformed.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Pose {
    /// One a morph target; empty where all are 0.
    pub(super) weights: Vec<f32>,
    pub(super) skin: Option<usize>,
}

/// Positions and normals of a primitive's vertices.
#[derive(Debug)]
pub(super) struct Vertices {
    pub(super) positions: Vec<Vec3>,
    /// Of any length; empty where there are none.
    pub(super) normals: Vec<Vec3>,
}

/// Where every node stands in the world while nothing is animated.
pub(super) struct Rest(Vec<Affine3A>);

impl Rest {
    pub(super) fn new(root: &Root) -> Self {
        let mut parent = vec![None; root.nodes.len()];
        for (n, node) in root.nodes.iter().enumerate() {
            node.children.iter().flatten().for_each(|child| parent[child.value()] = Some(n));
        }
        // What is wrong with a node is said where the scene reaches it.
        let own = |(n, node)| match animation::local(node, n, None) {
            Ok(Track::Fixed(affine)) => affine,
            _ => Affine3A::IDENTITY,
        };
        let own: Vec<Affine3A> = root.nodes.iter().enumerate().map(own).collect();
        let mut world: Vec<Option<Affine3A>> = vec![None; own.len()];
        for n in 0..own.len() {
            // Up to the first ancestor that is known, then down again; a node that is its own
            // ancestor is refused elsewhere.
            let mut path = vec![n];
            while let Some(above) = path.last().and_then(|n| parent[*n])
                && world[path[path.len() - 1]].is_none()
                && path.len() <= own.len()
            {
                path.push(above);
            }
            let mut above = Affine3A::IDENTITY;
            for n in path.into_iter().rev() {
                above = *world[n].get_or_insert(above * own[n]);
            }
        }
        Self(world.into_iter().map(Option::unwrap_or_default).collect())
    }
}

/// Reads what deforms a primitive.
pub(super) struct Deformer<'a> {
    pub(super) root: &'a Root,
    pub(super) buffers: &'a Buffers<'a>,
    pub(super) rest: &'a Rest,
}

impl Deformer<'_> {
    /// Brings the vertices `used` of a primitive into a pose: first its morph targets, then its
    /// skin, which takes them to the world. `place` is the primitive's.
    pub(super) fn apply(
        &self,
        pose: &Pose,
        given: &Primitive,
        used: &Range<usize>,
        place: &str,
        vertices: &mut Vertices,
    ) -> Result<()> {
        let targets = given.targets.iter().flatten().zip(&pose.weights).enumerate();
        for (t, (target, &weight)) in targets.filter(|(_, (_, weight))| **weight != 0.0) {
            for (name, accessor, values) in [
                ("POSITION", target.positions, &mut vertices.positions),
                ("NORMAL", target.normals, &mut vertices.normals),
            ] {
                let Some(accessor) = accessor.filter(|_| !values.is_empty()) else { continue };
                let place = format!("{place}.targets[{t}].{name}");
                self.check_count(self.buffers.count(accessor)?, used, &place)?;
                let moves = self.buffers.floats::<3>(accessor, Some(used.clone()))?;
                for (value, by) in values.iter_mut().zip(moves) {
                    *value += weight * Vec3::from_array(by);
                }
            }
        }
        match pose.skin {
            Some(skin) => self.skin(skin, given, used, place, vertices),
            None => Ok(()),
        }
    }

    fn check_count(&self, found: usize, used: &Range<usize>, place: &str) -> Result<()> {
        if found >= used.end {
            return Ok(());
        }
        let message = format!("has {found} elements; allowed: as many as POSITION");
        Err(Error::invalid(message).at_json(place))
    }

    /// Σ wᵢ Jᵢ Bᵢ v over sets of four joints: J places the joint, B is its inverse bind matrix.
    fn skin(
        &self,
        skin: usize,
        given: &Primitive,
        used: &Range<usize>,
        place: &str,
        vertices: &mut Vertices,
    ) -> Result<()> {
        let joints = self.joints(&self.root.skins[skin])?;
        let mut sums = vec![(Mat4::ZERO, 0.0_f32); used.len()];
        for set in 0.. {
            let attribute = |semantic| given.attributes.get(&Checked::Valid(semantic)).copied();
            let (Some(numbers), Some(weights)) =
                (attribute(Semantic::Joints(set)), attribute(Semantic::Weights(set)))
            else {
                break;
            };
            let at = |name: &str| format!("{place}.attributes.{name}_{set}");
            for (accessor, name) in [(numbers, "JOINTS"), (weights, "WEIGHTS")] {
                self.check_count(self.buffers.count(accessor)?, used, &at(name))?;
            }
            let numbers = self.buffers.floats::<4>(numbers, Some(used.clone()))?;
            let weights = self.buffers.floats::<4>(weights, Some(used.clone()))?;
            for (i, (numbers, weights)) in numbers.iter().zip(&weights).enumerate() {
                for (number, weight) in numbers.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
                    let Some(joint) = joints.get(*number as usize) else {
                        let message = format!(
                            "element {} names joint {number}; allowed: below {}",
                            used.start + i,
                            joints.len()
                        );
                        return Err(Error::invalid(message).at_json(at("JOINTS")));
                    };
                    sums[i].0 += *joint * *weight;
                    sums[i].1 += weight;
                }
            }
        }
        for (i, (sum, weight)) in sums.into_iter().enumerate() {
            if weight <= 0.0 {
                continue;
            }
            let blend = Affine3A::from_mat4(sum * (1.0 / weight));
            vertices.positions[i] = blend.transform_point3(vertices.positions[i]);
            if let Some(normal) = vertices.normals.get_mut(i) {
                let turned = blend.matrix3.inverse().transpose() * Vec3A::from(*normal);
                *normal = turned.into();
            }
        }
        Ok(())
    }

    /// Where each joint takes the mesh.
    fn joints(&self, skin: &Skin) -> Result<Vec<Mat4>> {
        let inverse: Vec<[f32; 16]> = match skin.inverse_bind_matrices {
            Some(accessor) => self.buffers.floats::<16>(accessor, None)?,
            None => Vec::new(),
        };
        let place = |(j, joint): (usize, &Index<gltf::json::Node>)| {
            let bind = inverse.get(j).map_or(Mat4::IDENTITY, Mat4::from_cols_array);
            Mat4::from(self.rest.0[joint.value()]) * bind
        };
        Ok(skin.joints.iter().enumerate().map(place).collect())
    }
}
