//! Placements, fixed or moving.

use glam::{Affine3A, Quat, Vec3};

/// Local space to world space at any time.
#[derive(Clone, Debug)]
pub enum Transform {
    /// The same at all times.
    Fixed(Affine3A),
    /// The product of its tracks, outermost first: `world = track₀(t) · track₁(t) · … · local`.
    Chain(Vec<Track>),
}

/// One link of a moving placement.
#[derive(Clone, Debug)]
pub enum Track {
    /// A link that does not move.
    Fixed(Affine3A),
    /// Translation · rotation · scale, each along its own curve.
    Trs {
        /// Translation in the parent's units.
        translation: Curve<Vec3>,
        /// Unit quaternions.
        rotation: Curve<Quat>,
        /// Scale factors.
        scale: Curve<Vec3>,
    },
}

/// How a [`Curve`] runs between its keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Interpolation {
    /// Holds the earlier key's value.
    Step,
    /// Straight lines; great-circle arcs for rotations.
    Linear,
}

/// Values at increasing times in seconds; constant before the first and after the last.
#[derive(Clone, Debug)]
pub struct Curve<T> {
    /// Times and values; never empty, times strictly increasing.
    pub keys: Vec<(f32, T)>,
    /// Between the keys.
    pub interpolation: Interpolation,
}

impl<T: Copy> Curve<T> {
    /// A curve that stays at one value.
    #[must_use]
    pub fn constant(value: T) -> Self {
        Self { keys: vec![(0.0, value)], interpolation: Interpolation::Step }
    }

    fn sample(&self, time: f32, between: impl Fn(T, T, f32) -> T) -> T {
        let next = self.keys.partition_point(|(t, _)| *t <= time);
        if next == 0 {
            return self.keys[0].1;
        }
        let (t0, from) = self.keys[next - 1];
        match self.keys.get(next) {
            Some(&(t1, to)) if self.interpolation == Interpolation::Linear => {
                between(from, to, (time - t0) / (t1 - t0))
            }
            _ => from,
        }
    }
}

impl Transform {
    /// Leaves everything where it is.
    pub const IDENTITY: Self = Self::Fixed(Affine3A::IDENTITY);

    /// Whether the placement depends on time.
    #[must_use]
    pub fn moves(&self) -> bool {
        match self {
            Self::Fixed(_) => false,
            Self::Chain(tracks) => tracks.iter().any(|track| match track {
                Track::Fixed(_) => false,
                Track::Trs { translation, rotation, scale } => {
                    translation.keys.len() > 1 || rotation.keys.len() > 1 || scale.keys.len() > 1
                }
            }),
        }
    }

    /// The placement at `time` seconds.
    #[must_use]
    pub fn at(&self, time: f32) -> Affine3A {
        match self {
            Self::Fixed(affine) => *affine,
            Self::Chain(tracks) => tracks.iter().fold(Affine3A::IDENTITY, |product, track| {
                product
                    * match track {
                        Track::Fixed(affine) => *affine,
                        Track::Trs { translation, rotation, scale } => {
                            Affine3A::from_scale_rotation_translation(
                                scale.sample(time, |a, b, t| a.lerp(b, t)),
                                rotation.sample(time, |a, b, t| a.slerp(b, t)),
                                translation.sample(time, |a, b, t| a.lerp(b, t)),
                            )
                        }
                    }
            }),
        }
    }

    /// The placement at `time` seconds; `None` while a scale of 0, which a curve may pass through,
    /// hides what is placed.
    #[must_use]
    pub fn shown_at(&self, time: f32) -> Option<Affine3A> {
        match self {
            Self::Fixed(affine) => Some(*affine),
            Self::Chain(_) => Some(self.at(time)).filter(is_regular),
        }
    }

    /// The placement of a scene that [`super::Scene::at`] returned.
    ///
    /// # Panics
    /// If the placement is a [`Transform::Chain`]; a renderer only ever sees fixed ones.
    #[inline]
    #[must_use]
    pub fn fixed(&self) -> Affine3A {
        match self {
            Self::Fixed(affine) => *affine,
            Self::Chain(_) => {
                panic!("a moving transform must be fixed by Scene::at before it is used")
            }
        }
    }
}

/// Whether a placement can be inverted. Relative to the columns' lengths, so that a scene in any
/// unit passes.
pub(crate) fn is_regular(affine: &Affine3A) -> bool {
    let m = [affine.matrix3.x_axis, affine.matrix3.y_axis, affine.matrix3.z_axis]
        .map(|c| Vec3::from(c).as_dvec3());
    let volume: f64 = m.iter().map(|c| c.length()).product();
    let determinant = m[0].dot(m[1].cross(m[2]));
    // Below it, a normal's direction drowns in the rounding of the matrix.
    affine.is_finite() && affine.inverse().is_finite() && determinant.abs() > 1e-12 * volume
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curve_is_clamped_and_linear_between_keys() {
        let translation = Curve {
            keys: vec![(1.0, Vec3::ZERO), (2.0, Vec3::X), (4.0, 3.0 * Vec3::X)],
            interpolation: Interpolation::Linear,
        };
        let chain = Transform::Chain(vec![
            Track::Fixed(Affine3A::from_translation(Vec3::Y)),
            Track::Trs {
                translation,
                rotation: Curve::constant(Quat::IDENTITY),
                scale: Curve::constant(Vec3::ONE),
            },
        ]);
        assert!(chain.moves());
        for (time, x) in [(0.0, 0.0), (1.5, 0.5), (2.0, 1.0), (3.0, 2.0), (9.0, 3.0)] {
            assert_eq!(
                chain.at(time).transform_point3(Vec3::ZERO),
                Vec3::new(x, 1.0, 0.0),
                "at {time}"
            );
        }
    }
}
