//! Eight numbers side by side, for arithmetic that vector instructions do at once.
//!
//! Every operation is the scalar one, lane by lane: bits do not depend on how wide the vectors are.
//! Compiled for the target's base set; inside of `pulp`'s dispatch for what the CPU has.

use std::array::from_fn;
use std::ops::{Add, Div, Mul, Sub};

use glam::Vec3;

/// Numbers in a [`Lanes`].
pub(crate) const LANES: usize = 8;

/// Eight numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub(crate) struct Lanes(pub(crate) [f32; LANES]);

/// Eight truths: all bits of a lane, or none. No bool, whose tests would become branches.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C, align(32))]
pub(crate) struct Mask([u32; LANES]);

/// Eight vectors, by component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Lanes3 {
    /// First components.
    pub(crate) x: Lanes,
    /// Second components.
    pub(crate) y: Lanes,
    /// Third components.
    pub(crate) z: Lanes,
}

impl Mask {
    /// A truth a lane.
    #[inline(always)]
    pub(crate) fn of(mut truth: impl FnMut(usize) -> bool) -> Self {
        Self(from_fn(|i| if truth(i) { u32::MAX } else { 0 }))
    }

    /// Both.
    #[inline(always)]
    pub(crate) fn and(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] & other.0[i]))
    }

    /// The opposite.
    #[inline(always)]
    pub(crate) fn not(self) -> Self {
        Self(self.0.map(|bits| !bits))
    }

    /// Either.
    #[inline(always)]
    pub(crate) fn or(self, other: Self) -> Self {
        Self(from_fn(|i| self.0[i] | other.0[i]))
    }

    /// The lane's truth.
    #[inline(always)]
    pub(crate) fn get(self, lane: usize) -> bool {
        self.0[lane] != 0
    }

    /// Whether any is true.
    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        self.0.iter().fold(0, |any, bits| any | bits) != 0
    }

    /// Where true `yes`, else `no`.
    #[inline(always)]
    pub(crate) fn select(self, yes: Lanes, no: Lanes) -> Lanes {
        Lanes::of(|i| {
            f32::from_bits(yes.0[i].to_bits() & self.0[i] | no.0[i].to_bits() & !self.0[i])
        })
    }
}

impl Lanes {
    /// Zeros.
    pub(crate) const ZERO: Self = Self([0.0; LANES]);

    /// The same number in all lanes.
    #[inline(always)]
    pub(crate) fn splat(value: f32) -> Self {
        Self([value; LANES])
    }

    /// A number a lane.
    #[inline(always)]
    pub(crate) fn of(value: impl FnMut(usize) -> f32) -> Self {
        Self(from_fn(value))
    }

    /// Absolute values.
    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self::of(|i| self.0[i].abs())
    }

    /// Where it is neither infinite nor NaN.
    #[inline(always)]
    pub(crate) fn finite(self) -> Mask {
        self.abs().below(Self::splat(f32::INFINITY))
    }

    /// Where it is less; never, where either is NaN.
    #[inline(always)]
    pub(crate) fn below(self, other: Self) -> Mask {
        Mask::of(|i| self.0[i] < other.0[i])
    }

    /// Square roots.
    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self::of(|i| self.0[i].sqrt())
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $operator:tt) => {
        impl $trait for Lanes {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Self::of(|i| self.0[i] $operator other.0[i])
            }
        }

        impl $trait<f32> for Lanes {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: f32) -> Self {
                Self::of(|i| self.0[i] $operator other)
            }
        }
    };
}

operator!(Add, add, +);
operator!(Sub, sub, -);
operator!(Mul, mul, *);
operator!(Div, div, /);

impl Lanes3 {
    /// Zeros.
    pub(crate) const ZERO: Self = Self { x: Lanes::ZERO, y: Lanes::ZERO, z: Lanes::ZERO };

    /// x, y and z made alike.
    #[inline(always)]
    pub(crate) fn map(self, mut each: impl FnMut(Lanes) -> Lanes) -> Self {
        Self { x: each(self.x), y: each(self.y), z: each(self.z) }
    }

    /// Component by component.
    #[inline(always)]
    pub(crate) fn times(self, other: Self) -> Self {
        Self { x: self.x * other.x, y: self.y * other.y, z: self.z * other.z }
    }

    /// Dot products, in the order of [`Vec3::dot`].
    #[inline(always)]
    pub(crate) fn dot(self, other: Self) -> Lanes {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Dot products with one vector.
    #[inline(always)]
    pub(crate) fn dot_with(self, other: Vec3) -> Lanes {
        self.x * other.x + self.y * other.y + self.z * other.z
    }

    /// Differences from one vector.
    #[inline(always)]
    pub(crate) fn minus(self, other: Vec3) -> Self {
        Self { x: self.x - other.x, y: self.y - other.y, z: self.z - other.z }
    }

    /// The vector of a lane.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> Vec3 {
        Vec3::new(self.x.0[lane], self.y.0[lane], self.z.0[lane])
    }

    /// Changes the vector of a lane.
    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, [x, y, z]: [f32; 3]) {
        self.x.0[lane] = x;
        self.y.0[lane] = y;
        self.z.0[lane] = z;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lanes_have_the_bits_of_vectors() {
        let vectors: [Vec3; LANES] = from_fn(|i| {
            let i = i as f32;
            Vec3::new(0.3 + i, 1.7 - 0.3 * i, (0.9 * i).sin())
        });
        let mut lanes = Lanes3::ZERO;
        for (lane, vector) in vectors.iter().enumerate() {
            lanes.set(lane, vector.to_array());
        }
        let other = Vec3::new(0.1, -3.3, 0.7);
        let length = lanes.dot(lanes).sqrt();
        let unit = lanes.minus(other).map(|x| x / length);
        for (lane, vector) in vectors.iter().enumerate() {
            assert_eq!(lanes.get(lane), *vector);
            assert_eq!(length.0[lane], vector.length_squared().sqrt());
            assert_eq!(unit.get(lane), (*vector - other) / vector.length_squared().sqrt());
            assert_eq!(lanes.dot_with(other).0[lane], vector.dot(other));
            assert_eq!(lanes.times(unit).get(lane), *vector * unit.get(lane));
            assert_eq!((length + 1.0 - length * 2.0).0[lane], {
                let l = length.0[lane];
                l + 1.0 - l * 2.0
            });
        }
    }

    /// With every choice of features vectors are found where the machine has them: without `pulp`'s
    /// `x86-v3` all of it runs one lane at a time, with the same bits and in silence.
    #[cfg(target_arch = "x86_64")]
    #[test]
    fn vectors_are_used_where_the_machine_has_them() {
        if std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("fma")
            && std::arch::is_x86_feature_detected!("bmi2")
        {
            let arch = format!("{:?}", pulp::Arch::new());
            assert!(arch.starts_with('V'), "light samples run on `{arch}`");
        } else {
            println!("skipped: this machine has no AVX2");
        }
    }
}
