//! Watertight ray-triangle intersection (Woop, Benthin, Wald 2013, "Watertight ray/triangle
//! intersection", JCGT 2(1)) in f64.
//!
//! | symbol | meaning |
//! |---|---|
//! | k | the axis of the largest direction component; i, j: the next two |
//! | s | shear: `(d_i / d_k, d_j / d_k, 1 / d_k)` |
//! | x, y, z | vertices relative to the origin, along i and j after the shear, along k before it |
//! | E | edge functions, one for the edge opposite each vertex; det = ΣE |
//!
//! Two deviations. The paper works in f32 and repeats in f64 where an edge function is zero; here
//! every vertex is sheared in f64, which one four-lane register does at once, so E needs no second
//! look and t is exact to f32's rounding. The axes i and j are not swapped for a negative `d_k`: no
//! test here depends on the winding.
//!
//! *Watertight*: an edge's two triangles shear the same vertices by the same operations and form
//! the same two rounded products with opposite signs, so at any edge one of them accepts (both at
//! E = 0). Nothing may be contracted into fused operations here.
//!
//! *No self-intersection*: let X, Y, Z be the largest |x|, |y|, |z| and u = 2⁻⁵³. A relative vertex
//! costs 1 rounding, its shear 2 more on terms up to 2X, E two products and a difference: |ΔE| ≤
//! 16u XY. With `t = Σ E z / (det d_k)` and |Σ E z| ≤ 3 max|E| Z, all of it is within
//! `2⁻⁴⁷ Z (XY + |det|) / |det d_k|` of the true quotient. A hit nearer than that bound is not told
//! from the origin's own surface and dropped (the test takes the sum of the three magnitudes for
//! each of X, Y, Z: cheaper, and at most 27 times more). A ray from `math::offset_origin` starts at
//! least 2⁻²⁵ of its coordinates off its surface, so it passes everything else.

use glam::DVec3;
#[cfg(target_arch = "x86_64")]
use pulp::x86::V3;

/// One primitive as the traversal reads it, by axis, in leaf order; `x[3]` tells the [`Kind`]. 48
/// bytes.
#[derive(Clone, Copy, Debug, Default, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(C, align(16))]
pub(super) struct Slot(pub(super) [[f32; 4]; 3]);

/// What a [`Slot`] holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Triangle,
    /// Centre in lanes 0 of the axes, radius in lane 1 of x.
    Sphere,
    /// As a sphere; normal in lanes 2.
    Disk,
    /// Slots `start .. start + count`, whose bits are in lanes 0 of x and y.
    Group,
}

impl Slot {
    pub(super) fn triangle(p: [glam::Vec3; 3]) -> Self {
        Self([
            [p[0].x, p[1].x, p[2].x, 0.0],
            [p[0].y, p[1].y, p[2].y, 0.0],
            [p[0].z, p[1].z, p[2].z, 0.0],
        ])
    }

    pub(super) fn sphere(center: glam::Vec3, radius: f32) -> Self {
        Self([[center.x, radius, 0.0, 1.0], [center.y, 0.0, 0.0, 0.0], [center.z, 0.0, 0.0, 0.0]])
    }

    pub(super) fn disk(center: glam::Vec3, normal: glam::Vec3, radius: f32) -> Self {
        Self([
            [center.x, radius, normal.x, 2.0],
            [center.y, 0.0, normal.y, 0.0],
            [center.z, 0.0, normal.z, 0.0],
        ])
    }

    pub(super) fn group(start: u32, count: u32) -> Self {
        Self([
            [f32::from_bits(start), 0.0, 0.0, 3.0],
            [f32::from_bits(count), 0.0, 0.0, 0.0],
            [0.0; 4],
        ])
    }

    #[inline(always)]
    pub(super) fn kind(&self) -> Kind {
        match self.0[0][3] {
            0.0 => Kind::Triangle,
            1.0 => Kind::Sphere,
            2.0 => Kind::Disk,
            _ => Kind::Group,
        }
    }

    /// Column `lane`: a vertex, a centre, a normal.
    #[inline(always)]
    pub(super) fn column(&self, lane: usize) -> DVec3 {
        DVec3::new(
            f64::from(self.0[0][lane]),
            f64::from(self.0[1][lane]),
            f64::from(self.0[2][lane]),
        )
    }

    #[inline(always)]
    pub(super) fn radius(&self) -> f64 {
        f64::from(self.0[0][1])
    }

    /// Start and count of a group.
    #[inline(always)]
    pub(super) fn range(&self) -> (u32, u32) {
        (self.0[0][0].to_bits(), self.0[1][0].to_bits())
    }
}

/// A ray in the form of the test, computed once.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleRay {
    axes: [usize; 3],
    /// The origin along i, j, k.
    origin: [f64; 3],
    shear: [f64; 3],
}

/// What the edge test leaves for [`TriangleRay::distance`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Edges {
    e: [f64; 4],
    x: [f64; 4],
    y: [f64; 4],
    z: [f64; 4],
}

impl TriangleRay {
    #[inline(always)]
    pub(super) fn new(origin: DVec3, direction: DVec3) -> Self {
        let (o, d) = (origin.to_array(), direction.to_array());
        let a = direction.abs();
        let k = if a.x > a.y {
            if a.x > a.z { 0 } else { 2 }
        } else if a.y > a.z {
            1
        } else {
            2
        };
        let (i, j) = ([1, 2, 0][k], [2, 0, 1][k]);
        let inverse = 1.0 / d[k];
        Self {
            axes: [i, j, k],
            origin: [o[i], o[j], o[k]],
            shear: [d[i] * inverse, d[j] * inverse, inverse],
        }
    }

    /// `(t, u, v)` from the edge functions, or `None` at t ≤ δ (see the module), beyond `limit`,
    /// and for an edge-on triangle.
    #[inline(always)]
    pub(super) fn distance(&self, edges: &Edges, limit: f64) -> Option<(f64, f64, f64)> {
        let Edges { e, x, y, z } = edges;
        let det = e[0] + e[1] + e[2];
        if det == 0.0 {
            return None;
        }
        let inverse = 1.0 / det;
        let sum = e[0] * z[0] + e[1] * z[1] + e[2] * z[2];
        let t = sum * (self.shear[2] * inverse);
        // t > δ, multiplied by |det d_k|: the bound needs no division.
        const BOUND: f64 = 1.0 / (1_u64 << 47) as f64;
        if t > 0.0 && t <= limit && sum.abs() > BOUND * total(z) * (total(x) * total(y) + det.abs())
        {
            Some((t, e[1] * inverse, e[2] * inverse))
        } else {
            None
        }
    }
}

/// At least the largest magnitude, and at most thrice: sums are cheaper than maxima, which must
/// tell NaNs apart.
#[inline(always)]
fn total(a: &[f64; 4]) -> f64 {
    a[0].abs() + a[1].abs() + a[2].abs()
}

/// The edge test, one lane at a time. `None`: the ray passes outside.
#[inline(always)]
pub(super) fn edges_portable(slot: &Slot, ray: &TriangleRay) -> Option<Edges> {
    let [i, j, k] = ray.axes;
    let (mut x, mut y, mut z) = ([0.0; 4], [0.0; 4], [0.0; 4]);
    for lane in 0..3 {
        z[lane] = f64::from(slot.0[k][lane]) - ray.origin[2];
        x[lane] = (f64::from(slot.0[i][lane]) - ray.origin[0]) - ray.shear[0] * z[lane];
        y[lane] = (f64::from(slot.0[j][lane]) - ray.origin[1]) - ray.shear[1] * z[lane];
    }
    let e = [x[2] * y[1] - y[2] * x[1], x[0] * y[2] - y[0] * x[2], x[1] * y[0] - y[1] * x[0], 0.0];
    let negative = e[0] < 0.0 || e[1] < 0.0 || e[2] < 0.0;
    let positive = e[0] > 0.0 || e[1] > 0.0 || e[2] > 0.0;
    (negative != positive).then_some(Edges { e, x, y, z })
}

/// [`edges_portable`] with the three vertices in the lanes of one register: same operations, same
/// bits. No closures: they would be compiled without the vector instructions.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
pub(super) fn edges_avx2(simd: V3, slot: &Slot, ray: &TriangleRay) -> Option<Edges> {
    use std::arch::x86_64::{_CMP_GT_OQ, _CMP_LT_OQ};
    let (avx, avx2) = (simd.avx, simd.avx2);
    let [i, j, k] = ray.axes;
    let origin = [
        avx._mm256_set1_pd(ray.origin[0]),
        avx._mm256_set1_pd(ray.origin[1]),
        avx._mm256_set1_pd(ray.origin[2]),
    ];
    let z = avx._mm256_sub_pd(avx._mm256_cvtps_pd(bytemuck::cast(slot.0[k])), origin[2]);
    let x = avx._mm256_sub_pd(avx._mm256_cvtps_pd(bytemuck::cast(slot.0[i])), origin[0]);
    let y = avx._mm256_sub_pd(avx._mm256_cvtps_pd(bytemuck::cast(slot.0[j])), origin[1]);
    let x = avx._mm256_sub_pd(x, avx._mm256_mul_pd(avx._mm256_set1_pd(ray.shear[0]), z));
    let y = avx._mm256_sub_pd(y, avx._mm256_mul_pd(avx._mm256_set1_pd(ray.shear[1]), z));
    // Lanes 1 2 0 3 and 2 0 1 3: the next vertex and the one after it.
    let (x1, y1) = (avx2._mm256_permute4x64_pd::<0xc9>(x), avx2._mm256_permute4x64_pd::<0xc9>(y));
    let (x2, y2) = (avx2._mm256_permute4x64_pd::<0xd2>(x), avx2._mm256_permute4x64_pd::<0xd2>(y));
    let e = avx._mm256_sub_pd(avx._mm256_mul_pd(x2, y1), avx._mm256_mul_pd(y2, x1));
    let zero = avx._mm256_set1_pd(0.0);
    let negative = avx._mm256_movemask_pd(avx._mm256_cmp_pd::<_CMP_LT_OQ>(e, zero)) & 7;
    let positive = avx._mm256_movemask_pd(avx._mm256_cmp_pd::<_CMP_GT_OQ>(e, zero)) & 7;
    if (negative == 0) == (positive == 0) {
        return None;
    }
    Some(Edges {
        e: bytemuck::cast(e),
        x: bytemuck::cast(x),
        y: bytemuck::cast(y),
        z: bytemuck::cast(z),
    })
}
