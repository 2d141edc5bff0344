//! Node animation: curves for translation, rotation and scale.

use std::collections::BTreeMap;

use glam::{Affine3A, Mat4, Quat, Vec3};
use gltf::json::animation::{Interpolation as Given, Property, Sampler};
use gltf::json::validation::Checked;
use gltf::json::{Node, Root};

use super::super::Warnings;
use super::bytes::Buffers;
use crate::error::{Error, Result};
use crate::scene::{Curve, Interpolation, Track};

/// Straight pieces that stand for one piece of a cubic spline.
const PIECES: usize = 16;

/// What moves a node.
#[derive(Debug, Default)]
pub(super) struct Motion {
    translation: Option<Curve<Vec3>>,
    rotation: Option<Curve<Quat>>,
    scale: Option<Curve<Vec3>>,
    /// Where the curves come from, for messages.
    place: String,
}

/// All motions of a file by node, and the times between which anything moves.
#[derive(Debug, Default)]
pub(super) struct Motions {
    pub(super) by_node: BTreeMap<usize, Motion>,
    pub(super) time: [f32; 2],
}

impl Motions {
    /// Whether a node or one above it is animated, for all nodes.
    pub(super) fn moving(&self, root: &Root) -> Vec<bool> {
        let mut below = vec![false; root.nodes.len()];
        let mut stack: Vec<usize> = self.by_node.keys().copied().collect();
        while let Some(n) = stack.pop() {
            if !std::mem::replace(&mut below[n], true) {
                stack.extend(root.nodes[n].children.iter().flatten().map(|child| child.value()));
            }
        }
        below
    }
}

/// Reads all animations; they play at the same time, and where two drive the same property of a
/// node the first one counts.
pub(super) fn read(root: &Root, buffers: &Buffers<'_>, warnings: &mut Warnings) -> Result<Motions> {
    let mut motions = Motions::default();
    let mut time: Option<[f32; 2]> = None;
    for (a, animation) in root.animations.iter().enumerate() {
        for (c, channel) in animation.channels.iter().enumerate() {
            let place = format!("animations[{a}].channels[{c}]");
            let node = channel.target.node.value();
            if node >= root.nodes.len() {
                let message = format!("is {node}; allowed: below {}", root.nodes.len());
                return Err(Error::invalid(message).at_json(format!("{place}.target.node")));
            }
            let Checked::Valid(property) = channel.target.path else {
                let message = "allowed: translation, rotation, scale";
                return Err(Error::invalid(message).at_json(format!("{place}.target.path")));
            };
            let s = channel.sampler.value();
            let Some(sampler) = animation.samplers.get(s) else {
                let message = format!("is {s}; allowed: below {}", animation.samplers.len());
                return Err(Error::invalid(message).at_json(format!("{place}.sampler")));
            };
            if property == Property::MorphTargetWeights {
                warnings.add(format!(
                    "{place}.target.path: animated morph targets are not followed; the mesh keeps its rest pose"
                ));
                continue;
            }
            let motion = motions.by_node.entry(node).or_default();
            motion.place.clone_from(&place);
            let taken = match property {
                Property::Translation => motion.translation.is_some(),
                Property::Rotation => motion.rotation.is_some(),
                _ => motion.scale.is_some(),
            };
            if taken {
                warnings.add(format!(
                    "{place}: drives what an earlier channel drives already; ignored"
                ));
                continue;
            }
            let place = format!("animations[{a}].samplers[{s}]");
            let span = match property {
                Property::Rotation => {
                    let curve = curve::<4, Quat>(sampler, buffers, &place, warnings, |q| {
                        let length = q.iter().map(|x| x * x).sum::<f32>().sqrt();
                        (length > 0.0 && length.is_finite())
                            .then(|| Quat::from_array(q.map(|x| x / length)).normalize())
                    })?;
                    span(&motion.rotation.insert(curve).keys)
                }
                Property::Translation => {
                    let curve = curve::<3, Vec3>(sampler, buffers, &place, warnings, |v| {
                        Some(Vec3::from_array(v))
                    })?;
                    span(&motion.translation.insert(curve).keys)
                }
                _ => {
                    let curve = curve::<3, Vec3>(sampler, buffers, &place, warnings, |v| {
                        Some(Vec3::from_array(v))
                    })?;
                    span(&motion.scale.insert(curve).keys)
                }
            };
            time = Some(time.map_or(span, |t| [t[0].min(span[0]), t[1].max(span[1])]));
        }
    }
    motions.time = time.unwrap_or_default();
    Ok(motions)
}

fn span<T>(keys: &[(f32, T)]) -> [f32; 2] {
    [keys[0].0, keys[keys.len() - 1].0]
}

fn curve<const N: usize, T>(
    sampler: &Sampler,
    buffers: &Buffers<'_>,
    place: &str,
    warnings: &mut Warnings,
    value: impl Fn([f32; N]) -> Option<T>,
) -> Result<Curve<T>> {
    let input = format!("{place}.input");
    let output = format!("{place}.output");
    let times: Vec<f32> =
        buffers.floats::<1>(sampler.input, None)?.into_iter().map(|[t]| t).collect();
    if times.is_empty() {
        return Err(Error::invalid("no keys; allowed: at least one").at_json(input));
    }
    if let Some(i) = times.windows(2).position(|w| w[0] >= w[1]) {
        let message = format!(
            "key {} is at {} s, key {i} at {} s; allowed: strictly increasing times",
            i + 1,
            times[i + 1],
            times[i]
        );
        return Err(Error::invalid(message).at_json(input));
    }
    let given = match sampler.interpolation {
        Checked::Valid(given) => given,
        Checked::Invalid => {
            let message = "allowed: LINEAR, STEP, CUBICSPLINE";
            return Err(Error::invalid(message).at_json(format!("{place}.interpolation")));
        }
    };
    let values = buffers.floats::<N>(sampler.output, None)?;
    let per_key = if given == Given::CubicSpline { 3 } else { 1 };
    if values.len() != per_key * times.len() {
        let message =
            format!("{} values for {} keys; allowed: {per_key} a key", values.len(), times.len());
        return Err(Error::invalid(message).at_json(output));
    }
    let mut keys: Vec<(f32, [f32; N])> = Vec::new();
    if given == Given::CubicSpline {
        warnings.add(format!(
            "{place}: the cubic spline is replaced by {PIECES} straight pieces between keys"
        ));
        buffers.spend((PIECES * times.len()) as u64, place)?;
        for k in 0..times.len() {
            keys.push((times[k], values[3 * k + 1]));
            if k + 1 == times.len() {
                break;
            }
            let span = times[k + 1] - times[k];
            for piece in 1..PIECES {
                let t = piece as f32 / PIECES as f32;
                let time = times[k] + t * span;
                let bend = hermite(
                    values[3 * k + 1],
                    values[3 * k + 2].map(|d| d * span),
                    values[3 * k + 4],
                    values[3 * k + 3].map(|d| d * span),
                    t,
                );
                // Keys closer than PIECES roundings of time leave no room for all pieces.
                if keys[keys.len() - 1].0 < time && time < times[k + 1] {
                    keys.push((time, bend));
                }
            }
        }
    } else {
        keys.extend(times.into_iter().zip(values));
    }
    let keys = keys
        .into_iter()
        .map(|(time, given)| {
            let valid = if given.iter().all(|x| x.is_finite()) { value(given) } else { None };
            valid.map(|valid| (time, valid)).ok_or_else(|| {
                let message = format!(
                    "{given:?} at {time} s; allowed: finite vectors, quaternions above zero length"
                );
                Error::invalid(message).at_json(&output)
            })
        })
        .collect::<Result<_>>()?;
    let interpolation =
        if given == Given::Step { Interpolation::Step } else { Interpolation::Linear };
    Ok(Curve { keys, interpolation })
}

/// Cubic Hermite spline from `p` with tangent `m` at t = 0 to `q` with tangent `n` at t = 1 (glTF
/// 2.0, appendix C.5).
fn hermite<const N: usize>(p: [f32; N], m: [f32; N], q: [f32; N], n: [f32; N], t: f32) -> [f32; N] {
    let (t2, t3) = (t * t, t * t * t);
    std::array::from_fn(|i| {
        (2.0 * t3 - 3.0 * t2 + 1.0) * p[i]
            + (t3 - 2.0 * t2 + t) * m[i]
            + (3.0 * t2 - 2.0 * t3) * q[i]
            + (t3 - t2) * n[i]
    })
}

/// The placement of a node in its parent.
pub(super) fn local(node: &Node, index: usize, motion: Option<&Motion>) -> Result<Track> {
    let at = |field: &str| format!("nodes[{index}].{field}");
    let finite = |values: &[f32], field: &str| {
        if values.iter().all(|x| x.is_finite()) {
            return Ok(());
        }
        Err(Error::invalid(format!("is {values:?}; allowed: finite numbers")).at_json(at(field)))
    };
    if let Some(matrix) = &node.matrix {
        if let Some(motion) = motion {
            let message =
                "an animated node; allowed: translation, rotation and scale instead of a matrix";
            return Err(
                Error::invalid(format!("{message} ({})", motion.place)).at_json(at("matrix"))
            );
        }
        finite(matrix, "matrix")?;
        let affine = Mat4::from_cols_array(matrix);
        if affine.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
            let message = format!("has the last row {}; allowed: 0 0 0 1", affine.row(3));
            return Err(Error::invalid(message).at_json(at("matrix")));
        }
        return Ok(Track::Fixed(Affine3A::from_mat4(affine)));
    }
    let translation = node.translation.unwrap_or_default();
    let scale = node.scale.unwrap_or([1.0; 3]);
    let rotation = node.rotation.unwrap_or_default().0;
    finite(&translation, "translation")?;
    finite(&scale, "scale")?;
    finite(&rotation, "rotation")?;
    let length = rotation.iter().map(|x| x * x).sum::<f32>().sqrt();
    if !(length > 1e-6 && length.is_finite()) {
        let message = format!("is {rotation:?}; allowed: a unit quaternion");
        return Err(Error::invalid(message).at_json(at("rotation")));
    }
    let (translation, scale) = (Vec3::from_array(translation), Vec3::from_array(scale));
    let rotation = Quat::from_array(rotation.map(|x| x / length));
    Ok(match motion {
        None => Track::Fixed(Affine3A::from_scale_rotation_translation(
            scale,
            rotation.normalize(),
            translation,
        )),
        Some(motion) => Track::Trs {
            translation: motion.translation.clone().unwrap_or_else(|| Curve::constant(translation)),
            rotation: motion
                .rotation
                .clone()
                .unwrap_or_else(|| Curve::constant(rotation.normalize())),
            scale: motion.scale.clone().unwrap_or_else(|| Curve::constant(scale)),
        },
    })
}

/// The keys of a track, for bounding memory.
pub(super) fn keys(track: &Track) -> u64 {
    match track {
        Track::Fixed(_) => 1,
        Track::Trs { translation, rotation, scale } => {
            (translation.keys.len() + rotation.keys.len() + scale.keys.len()) as u64
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hermite_meets_values_and_tangents() {
        let at = |t: f32| hermite([1.0], [2.0], [5.0], [-3.0], t)[0];
        assert_eq!((at(0.0), at(1.0)), (1.0, 5.0));
        let h = 1e-3;
        assert!(((at(h) - at(0.0)) / h - 2.0).abs() < 0.02);
        assert!(((at(1.0) - at(1.0 - h)) / h + 3.0).abs() < 0.02);
    }
}
