//! The current transformation at the start and at the end of the motion, and its conversion to
//! [`Transform`].

use glam::{Affine3A, DAffine3, DMat3, DQuat, DVec3, Quat, Vec3};

use crate::scene::{Curve, Interpolation, Track, Transform};

/// Relative difference below which two matrices from a text file, printed with six digits, count as
/// equal.
const TOLERANCE: f64 = 1e-4;

/// Local space to world at the two ends of the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ctm {
    pub(super) ends: [DAffine3; 2],
}

impl Ctm {
    pub(super) const IDENTITY: Self = Self { ends: [DAffine3::IDENTITY; 2] };

    pub(super) fn moves(&self) -> bool {
        self.ends[0] != self.ends[1]
    }

    /// `self` after `local`.
    pub(super) fn then(&self, local: DAffine3) -> Self {
        Self { ends: self.ends.map(|end| end * local) }
    }

    pub(super) fn inverse(&self) -> Self {
        Self { ends: self.ends.map(|end| end.inverse()) }
    }

    /// Whether every point has one image and one origin, in single precision.
    pub(super) fn is_regular(&self) -> bool {
        self.ends.iter().all(|end| {
            let m = end.matrix3;
            let columns = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
            let flat = m.determinant().abs() <= 1e-12 * columns.iter().product::<f64>();
            end.as_affine3a().is_finite() && end.inverse().as_affine3a().is_finite() && !flat
        })
    }

    /// As links, outermost first, with keys at `times`.
    ///
    /// pbrt interpolates translation, rotation and stretch of the polar decomposition M = T R S one
    /// by one; this does the same where S is a scale along the axes or does not change. `None`
    /// where S changes and shears.
    pub(super) fn to_transform(self, times: [f64; 2]) -> Option<Transform> {
        if !self.moves() {
            return Some(Transform::Fixed(single(self.ends[0])));
        }
        let [from, to] = self.ends.map(Polar::new);
        // The rotation goes the short way round.
        let to = Polar {
            rotation: if from.rotation.dot(to.rotation) < 0.0 { -to.rotation } else { to.rotation },
            ..to
        };
        let keys = |a: Vec3, b: Vec3| Curve {
            keys: if a == b {
                vec![(times[0] as f32, a)]
            } else {
                vec![(times[0] as f32, a), (times[1] as f32, b)]
            },
            interpolation: Interpolation::Linear,
        };
        let (first, second) =
            (from.rotation.as_quat().normalize(), to.rotation.as_quat().normalize());
        let mut rotation = vec![(times[0] as f32, first)];
        if first != second {
            rotation.push((times[1] as f32, second));
        }
        let translation = keys(from.translation.as_vec3(), to.translation.as_vec3());
        let rotation: Curve<Quat> = Curve { keys: rotation, interpolation: Interpolation::Linear };
        let constant_stretch = near(from.stretch, to.stretch);
        let scale = match (from.axis_scale(), to.axis_scale()) {
            (Some(a), Some(b)) => {
                let b = if constant_stretch { a } else { b };
                // A scale that changes sign is singular in between.
                if (a * b).min_element() <= 0.0 {
                    return None;
                }
                keys(a.as_vec3(), b.as_vec3())
            }
            _ if constant_stretch => Curve::constant(Vec3::ONE),
            _ => return None,
        };
        let sheared = from.axis_scale().is_none() || to.axis_scale().is_none();
        let mut tracks = vec![Track::Trs { translation, rotation, scale }];
        if sheared {
            tracks.push(Track::Fixed(single(DAffine3::from_mat3(from.stretch))));
        }
        Some(Transform::Chain(tracks))
    }
}

/// In single precision.
pub(super) fn single(affine: DAffine3) -> Affine3A {
    affine.as_affine3a()
}

/// The factor of a rotation, mirrored or not, with a uniform scale; `None` for anything else.
pub(super) fn similarity(m: DMat3) -> Option<f64> {
    let gram = m.transpose() * m;
    let square = (gram.x_axis.x + gram.y_axis.y + gram.z_axis.z) / 3.0;
    (square > 0.0 && near(gram, DMat3::from_diagonal(DVec3::splat(square)))).then(|| square.sqrt())
}

fn near(a: DMat3, b: DMat3) -> bool {
    let size = |m: DMat3| m.to_cols_array().iter().fold(0.0_f64, |s, v| s.max(v.abs()));
    size(a - b) <= TOLERANCE * size(a).max(size(b))
}

/// M = translation · rotation · stretch, with a symmetric stretch; a mirrored M has a negative
/// definite one.
struct Polar {
    translation: DVec3,
    rotation: DQuat,
    stretch: DMat3,
}

impl Polar {
    /// Higham's iteration: R ← (R + R⁻ᵀ) / 2 (Shoemake and Duff 1992).
    fn new(m: DAffine3) -> Self {
        let mut r = m.matrix3;
        // Newton's method: doubles its digits each round once near, halves the distance before.
        for _ in 0..128 {
            let next = 0.5 * (r + r.inverse().transpose());
            let moved = (next - r).to_cols_array().iter().fold(0.0_f64, |s, v| s.max(v.abs()));
            r = next;
            if moved < 1e-14 {
                break;
            }
        }
        if r.determinant() < 0.0 {
            r = -r;
        }
        let stretch = r.transpose() * m.matrix3;
        Self { translation: m.translation, rotation: DQuat::from_mat3(&r), stretch }
    }

    /// The diagonal, if there is nothing beside it.
    fn axis_scale(&self) -> Option<DVec3> {
        let s = self.stretch;
        let diagonal = DVec3::new(s.x_axis.x, s.y_axis.y, s.z_axis.z);
        near(s, DMat3::from_diagonal(diagonal)).then_some(diagonal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(ctm: Ctm) -> Transform {
        let transform = ctm.to_transform([1.0, 3.0]).expect("decomposes");
        for (time, end) in
            [(1.0, ctm.ends[0]), (3.0, ctm.ends[1]), (0.0, ctm.ends[0]), (9.0, ctm.ends[1])]
        {
            let at = transform.at(time);
            assert!(at.abs_diff_eq(single(end), 1e-4), "{at} is not {end} at {time}");
        }
        transform
    }

    #[test]
    fn ends_are_met_and_the_middle_is_the_mean() {
        let trs = |s: f64, angle: f64, x: f64| {
            DAffine3::from_scale_rotation_translation(
                DVec3::new(s, 2.0, 1.0),
                DQuat::from_rotation_y(angle),
                DVec3::new(x, 1.0, 0.0),
            )
        };
        let middle = check(Ctm { ends: [trs(1.0, 0.2, 0.0), trs(3.0, 1.0, 4.0)] }).at(2.0);
        assert!(middle.abs_diff_eq(single(trs(2.0, 0.6, 2.0)), 1e-5), "{middle}");
    }

    #[test]
    fn a_mirrored_and_a_sheared_matrix_move() {
        let mirror = DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0));
        let shear =
            DAffine3::from_mat3(DMat3::from_cols(DVec3::X, DVec3::new(0.5, 1.0, 0.0), DVec3::Z));
        let step = DAffine3::from_translation(DVec3::X);
        check(Ctm { ends: [mirror, step * mirror] });
        check(Ctm { ends: [shear, step * shear] });
        assert!(Ctm { ends: [DAffine3::IDENTITY, shear] }.to_transform([0.0, 1.0]).is_none());
        assert!(Ctm { ends: [DAffine3::IDENTITY, mirror] }.to_transform([0.0, 1.0]).is_none());
    }

    #[test]
    fn regularity_does_not_depend_on_size() {
        for scale in [1e-9, 1.0, 1e9] {
            assert!(Ctm::IDENTITY.then(DAffine3::from_scale(DVec3::splat(scale))).is_regular());
        }
        assert!(!Ctm::IDENTITY.then(DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0))).is_regular());
        assert!(!Ctm::IDENTITY.then(DAffine3::from_scale(DVec3::splat(1e-300))).is_regular());
    }
}
